"""Simulated winds have the law of their record, and wrong generators are found out."""

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import driftcore as dc
from driftcore import law
from driftcore.check import Check
from driftcore.climate import synthetic_record
from driftcore.errors import RecordError, ScenarioError
from driftcore.record import Integer, WindRecord, read_record
from driftcore.wrong_winds import WRONG, independent_draws, the_record_itself
from reference import Floats

SUMMER = (6, 7, 8)
STEPS = 368


def failures(statistics: list[Check]) -> set[str]:
    return {statistic.name for statistic in statistics if not statistic.passed}


# The two modes, on the embedded and on the real record


def test_the_default_has_the_law_of_the_embedded_record(
    embedded_wind: dc.LocalGridBootstrap,
) -> None:
    statistics = law.assess(embedded_wind)
    assert failures(statistics) == set()
    assert {s.name.split()[0] for s in statistics} == {f"T{k}" for k in range(1, 10)}


def test_the_default_has_the_law_of_the_real_record(belle_ile_csv: Path) -> None:
    """The longest of 200 seasons' runs along the record, an extreme, is 9 to 19, mostly 10."""
    assert failures(law.assess(dc.LocalGridBootstrap.fit(belle_ile_csv))) == set()


def test_the_paper_mode_has_the_law_of_the_embedded_record() -> None:
    """But copies long stretches: its narrow kernel often finds one row only."""
    paper_mode = dc.LocalGridBootstrap.fit(synthetic_record(), mode="lgb")
    assert failures(law.assess(paper_mode)) == law.COPIES


def test_the_paper_mode_has_the_law_of_the_real_record(belle_ile_csv: Path) -> None:
    paper_mode = dc.LocalGridBootstrap.fit(belle_ile_csv, mode="lgb")
    assert failures(law.assess(paper_mode)) == law.COPIES


def test_a_residual_mode_that_is_too_smooth(belle_ile_csv: Path) -> None:
    """A wide kernel forgets how changes depend on the state; the embedded climate has no such."""
    too_smooth = dc.LocalGridBootstrap.fit(belle_ile_csv, h=2.5)
    assert failures(law.assess(too_smooth)) == {law.QUANTILES, law.ROSE, law.PERSISTENCE}


# Wrong generators: what finds each out


@pytest.fixture(scope="module")
def record() -> WindRecord:
    return read_record(synthetic_record(years=6), months=SUMMER)


T2_T3 = {law.LAG_ONE, law.DEVIATION.format("u"), law.DEVIATION.format("v")}
SPREAD = {law.SPREAD.format("u"), law.SPREAD.format("v")}
FOUND_BY = {
    "independent draws": {
        law.SHORT_ACF,
        law.CROSS,
        law.PERSISTENCE,
        law.CHANGES,
        law.LAG_ONE,
        law.REPEATED,
    },
    "nearest neighbour alone, residual": law.COPIES | SPREAD,
    "nearest neighbour alone, lgb": law.COPIES,
    "the record itself": law.COPIES | SPREAD | {law.REPEATED},
    "over-smoothing, lgb h = 0.5": T2_T3 | {law.CHANGES, law.SHORT_ACF, law.REPEATED},
    "noise inflation, lgb b = 0.5": T2_T3 - {law.LAG_ONE} | SPREAD | {law.CHANGES},
    "joined seasons": {law.JOINED},
    "biased weights": T2_T3 - {law.LAG_ONE} | SPREAD | {law.QUANTILES, law.PERSISTENCE},
    "collapsed ensemble": SPREAD,
}


@pytest.mark.parametrize(("name", "wrong"), WRONG.items(), ids=WRONG.keys())
def test_wrong_generators_are_found_out(
    record: WindRecord, name: str, wrong: Callable[[WindRecord], law.Simulator]
) -> None:
    assert FOUND_BY[name] <= failures(law.assess(wrong(record), record))


# The sampler itself


def test_a_wrong_bandwidth_is_found_out(embedded_wind: dc.LocalGridBootstrap) -> None:
    wrong = dataclasses.replace(embedded_wind, h=1.03 * embedded_wind.h)
    wrong.__dict__["core"] = embedded_wind.core  # draws by another h
    assert failures(law.assess(wrong)) == {law.WEIGHTS}


class Entangled:
    """A sampler whose members depend on how many are simulated with them."""

    def __init__(self, core: Any) -> None:
        self.core = core
        self.draws_at = core.draws_at

    def sample(
        self, members: int, steps: int, seed: int, first_member: int = 0
    ) -> tuple[Floats, Integer]:
        values, rows = self.core.sample(members, steps, seed, first_member=first_member)
        return values[::-1], rows[::-1]


def test_entangled_members_are_found_out(
    embedded_wind: dc.LocalGridBootstrap, monkeypatch: pytest.MonkeyPatch
) -> None:
    same = dc.forecast(dc.paper.scenario(), embedded_wind, members=2)
    monkeypatch.setattr(law, "forecast", lambda *_, **__: same)
    wrong = dataclasses.replace(embedded_wind)
    wrong.__dict__["core"] = Entangled(embedded_wind.core)
    assert failures(law.assess(wrong)) == {law.STREAMS}


def test_threads_that_matter_are_found_out(
    embedded_wind: dc.LocalGridBootstrap, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forecast(*wind: Any, threads: int, seed: int, **options: Any) -> dc.Forecast:
        return dc.forecast(*wind, seed=seed + (threads == 3), **options)

    monkeypatch.setattr(law, "forecast", forecast)
    assert failures(law.assess(embedded_wind)) == {law.STREAMS}


def test_the_record_itself_has_its_own_law(record: WindRecord) -> None:
    """Copying passes T1 to T3: it takes T4 to T6 to see it."""
    statistics = law.assess(the_record_itself(record), record, seasons=6)
    # Each summer begins after the end of another.
    assert failures(statistics) == law.COPIES | SPREAD | {law.REPEATED, law.JOINED}
    for statistic in statistics:
        if statistic.name[:2] in ("T1", "T2", "T3"):
            assert abs(statistic.measured) < 1e-9


# The statistics


def test_lag_one_by_definition(record: WindRecord) -> None:
    simulated, _ = independent_draws(record)(200, STEPS, None)
    summers = record.velocity.reshape(6, STEPS, 2)

    def correlation(wind: Floats) -> Floats:
        anomaly = wind - wind.mean(axis=(0, 1))
        lagged = (anomaly[:, 1:] * anomaly[:, :-1]).mean(axis=(0, 1))
        return np.asarray(lagged / anomaly.var(axis=(0, 1)))

    random = np.random.default_rng(7)
    resampled = [correlation(summers[random.integers(6, size=6)]) for _ in range(3000)]
    z = (correlation(simulated) - correlation(summers)) / np.std(resampled, axis=0)
    found = law.assess(independent_draws(record), record)
    measured = next(s.measured for s in found if s.name == law.LAG_ONE)
    # 1,000 and 3,000 replicates tell a standard error to 2 %; the draws differ.
    assert measured == pytest.approx(abs(z).max(), rel=0.1)


def test_gaps_and_short_segments_do_not_matter(record: WindRecord) -> None:
    """Pairs are counted inside segments only: z stays low where a tenth of the rows is gone."""
    frame = synthetic_record(years=6)
    kept = np.arange(len(frame)) % 40 > 3
    gappy = read_record(frame[kept], months=SUMMER, gaps="segment")
    assert gappy.segment[-1] > 50

    def simulate(members: int, steps: int, start: int | None) -> tuple[Floats, Integer]:
        values, drawn = the_record_itself(record)(members, steps, start)
        return values, 0 * drawn  # rows of another record

    statistics = law.assess(simulate, gappy, seasons=6)
    for statistic in statistics:
        if statistic.name[:2] in ("T1", "T2"):
            assert statistic.passed, statistic


def test_records_of_any_months_and_step() -> None:
    """Two hours' step, all year: one segment, cut into seasons."""
    times = pd.date_range("2001-01-01", "2006-12-31 22:00", freq="2h", name="time")
    noise = np.random.default_rng(3).standard_normal((len(times), 2))
    frame = pd.DataFrame(noise, times, ["u10", "v10"]).ewm(halflife=6).mean()
    year = read_record(frame)
    assert year.segment[-1] == 0
    statistics = law.assess(independent_draws(year), year, seasons=20)
    assert law.LAG_ONE in failures(statistics)
    assert not {law.QUANTILES, law.ROSE} & failures(statistics)


def test_limits_shrink_with_the_number_of_seasons() -> None:
    for name in (law.QUANTILES, law.ROSE, law.LONG_ACF, law.LAG_ONE):
        limits = [law.limit(name, seasons) for seasons in (6, 8, 10, 14, 17, 20, 60)]
        assert all(a >= b for a, b in pairwise(limits))
        assert limits[-1] == limits[-2] == limits[-3]
    assert law.limit(law.ROSE, 17) == 3.7


def test_limits_can_be_found_again(record: WindRecord) -> None:
    """Roughly: of few replicates the greatest z stands for the 99 % quantile, and has no limit."""
    found = law.calibrate(dc.LocalGridBootstrap.fit(record, h=0.4), seasons=6, replicates=12)
    for name, largest in found.items():
        assert 0.25 * law.limit(name, 6) < largest < 4 * law.limit(name, 6)


def test_what_cannot_be_assessed(embedded_wind: dc.LocalGridBootstrap) -> None:
    with pytest.raises(ScenarioError, match="record: it is left out"):
        law.assess(law.simulator(embedded_wind, 1))
    short = read_record(synthetic_record(years=3), months=SUMMER)
    with pytest.raises(RecordError, match=r"3 season\(s\) tell no standard errors; at least 6"):
        law.assess(independent_draws(short), short)
