"""Simulated winds have the law of their record, and wrong generators are found out.

That draws follow the weights (T9) and that streams do not depend on members or threads (T8) is
tested in test_bootstrap.py and test_forecast.py.
"""

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import driftcore as dc
from driftcore import law
from driftcore.check import Check
from driftcore.climate import synthetic_record
from driftcore.errors import RecordError, ScenarioError
from driftcore.record import Integer, WindRecord, read_record
from driftcore.wind import Mode
from reference import Floats

SUMMER = (6, 7, 8)
STEPS = 368
COPYING = {law.CONTINUED, law.LONGEST}


def failures(statistics: list[Check]) -> set[str]:
    return {statistic.name for statistic in statistics if not statistic.passed}


# The two modes, on the embedded and on the real record


def test_the_default_has_the_law_of_the_embedded_record(
    embedded_wind: dc.LocalGridBootstrap,
) -> None:
    statistics = law.assess(embedded_wind)
    assert failures(statistics) == set()
    assert {s.name.split()[0] for s in statistics} == {f"T{k}" for k in range(1, 8)}


def test_the_default_has_the_law_of_the_real_record(belle_ile_csv: Path) -> None:
    assert failures(law.assess(dc.LocalGridBootstrap.fit(belle_ile_csv))) == set()


def test_the_paper_mode_has_the_law_of_the_embedded_record() -> None:
    """But copies long stretches: its narrow kernel often finds one row only."""
    paper_mode = dc.LocalGridBootstrap.fit(synthetic_record(), mode="lgb")
    assert failures(law.assess(paper_mode)) == COPYING


def test_the_paper_mode_has_the_law_of_the_real_record(belle_ile_csv: Path) -> None:
    paper_mode = dc.LocalGridBootstrap.fit(belle_ile_csv, mode="lgb")
    assert failures(law.assess(paper_mode)) == COPYING


def test_a_residual_mode_that_is_too_smooth(belle_ile_csv: Path) -> None:
    """A wide kernel forgets how changes depend on the state; the embedded climate has no such."""
    too_smooth = dc.LocalGridBootstrap.fit(belle_ile_csv, h=2.5)
    assert failures(law.assess(too_smooth)) == {law.QUANTILES, law.ROSE, law.PERSISTENCE}


# Wrong generators: what finds each out


@pytest.fixture(scope="module")
def record() -> WindRecord:
    return read_record(synthetic_record(years=6), months=SUMMER)


def bootstrap(
    mode: Mode, h: float, b: float | None = None
) -> Callable[[WindRecord], law.Simulator]:
    def fit(record: WindRecord) -> law.Simulator:
        return law.simulator(dc.LocalGridBootstrap.fit(record, mode=mode, h=h, b=b), seed=1)

    return fit


def independent_draws(record: WindRecord) -> law.Simulator:
    random = np.random.default_rng(1)

    def simulate(members: int, steps: int, _: int | None) -> tuple[Floats, Integer]:
        row = random.integers(1, len(record), (members, steps))
        return record.velocity[row], row - 1

    return simulate


def the_record_itself(record: WindRecord) -> law.Simulator:
    """Its summers over and over; from one state there is only one way on."""

    def simulate(members: int, steps: int, start: int | None) -> tuple[Floats, Integer]:
        first = np.arange(members) % 6 * STEPS if start is None else np.full(members, start)
        row = (first[:, None] + np.arange(steps)) % len(record)
        return record.velocity[row], row - 1

    return simulate


def joined_summers(record: WindRecord) -> law.Simulator:
    times = np.datetime64("2001-06-01", "s") + np.arange(len(record)) * np.timedelta64(6, "h")
    glued = WindRecord(times, record.velocity, record.step_h, "glued")
    with pytest.warns(dc.DriftCoreWarning, match="season"):
        return law.simulator(dc.LocalGridBootstrap.fit(glued, months=None, h=0.4), seed=1)


def seldom_calm(record: WindRecord) -> law.Simulator:
    """Weights that are zero for half of the rows before a weak wind."""
    fit = dc.LocalGridBootstrap.fit(record, h=0.4)
    after = np.hypot(*record.velocity[fit.row + 1].T)
    kept = (after > np.median(after)) | (np.arange(len(after)) % 2 > 0)
    catalogue = {
        name: getattr(fit, name)[kept] for name in ("states", "target", "row", "phase", "start")
    }
    return law.simulator(dataclasses.replace(fit, **catalogue), seed=1)


def no_spread(record: WindRecord) -> law.Simulator:
    """Members of one state share all draws."""
    fit = dc.LocalGridBootstrap.fit(record, h=0.4)

    def simulate(members: int, steps: int, start: int | None) -> tuple[Floats, Integer]:
        if start is None:
            return fit.sample(members, steps, 1, return_indices=True)
        values, drawn = law.simulator(fit, seed=1)(2, steps, start)
        return np.resize(values, (members, steps, 2)), np.resize(drawn, (members, steps))

    return simulate


T2_T3 = {law.LAG_ONE, law.DEVIATION.format("u"), law.DEVIATION.format("v")}
SPREAD = {law.SPREAD.format("u"), law.SPREAD.format("v")}
WRONG: list[tuple[Callable[[WindRecord], law.Simulator], set[str]]] = [
    (
        independent_draws,
        {law.SHORT_ACF, law.CROSS, law.PERSISTENCE, law.CHANGES, law.LAG_ONE, law.REPEATED},
    ),
    (bootstrap("residual", h=1e-3), COPYING | SPREAD),
    (bootstrap("lgb", h=1e-3, b=0.05), COPYING),
    (the_record_itself, COPYING | SPREAD | {law.REPEATED}),
    (bootstrap("lgb", h=0.5, b=0.0), T2_T3 | {law.CHANGES, law.SHORT_ACF, law.REPEATED}),
    (bootstrap("lgb", h=0.1, b=0.5), T2_T3 - {law.LAG_ONE} | SPREAD | {law.CHANGES}),
    (joined_summers, {law.JOINED}),
    (seldom_calm, T2_T3 - {law.LAG_ONE} | SPREAD | {law.QUANTILES, law.PERSISTENCE}),
    (no_spread, SPREAD),
]


@pytest.mark.parametrize(
    ("wrong", "found_by"),
    WRONG,
    ids=[
        "independent draws",
        "residual that copies",
        "lgb that copies",
        "the record itself",
        "lgb too smooth",
        "lgb with too much noise",
        "joined summers",
        "biased weights",
        "collapsed ensemble",
    ],
)
def test_wrong_generators_are_found_out(
    record: WindRecord, wrong: Callable[[WindRecord], law.Simulator], found_by: set[str]
) -> None:
    assert found_by <= failures(law.assess(wrong(record), record))


def test_the_record_itself_has_its_own_law(record: WindRecord) -> None:
    """Copying passes T1 to T3: it takes T4 to T6 to see it."""
    statistics = law.assess(the_record_itself(record), record, seasons=6)
    # Each summer begins after the end of another.
    assert failures(statistics) == COPYING | SPREAD | {law.REPEATED, law.JOINED}
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
