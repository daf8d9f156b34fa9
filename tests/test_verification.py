"""Whether probabilities came true: by hand, in law, and for summers that were left out."""

from functools import lru_cache
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.lines import Line2D

import driftcore as dc
from driftcore import hindcast, plot, verification
from driftcore.climate import synthetic_record

Floats = np.ndarray[Any, np.dtype[np.float64]]

REPEATS = 200
SUMMERS = 6
CENTER = (1.0, 1.0)


# By hand


def test_brier_by_hand() -> None:
    found = verification.brier([0.2, 0.2, 0.8, 0.8], [False, True, True, True], bins=2)
    assert found.score == pytest.approx(0.19)
    assert found.reliability == pytest.approx(0.065)
    assert found.resolution == pytest.approx(0.0625)
    assert found.uncertainty == pytest.approx(0.1875)
    assert found.skill == pytest.approx(1 - 0.19 / 0.1875)


@pytest.mark.parametrize("bins", [1, 3, 10, [0.0, 0.05, 0.5, 1.0]])
def test_parts_of_brier_add_up_whatever_the_bins(bins: Any) -> None:
    random = np.random.default_rng(1)
    p = random.random(500)
    found = verification.brier(p, random.random(500) < p**2, bins)
    total = found.reliability - found.resolution + found.uncertainty
    assert found.score == pytest.approx(total, abs=1e-14)


def test_parts_of_brier_where_each_case_has_its_bin() -> None:
    """Ten bins by default, and here a case in each of three: what happens is told apart wholly."""
    found = verification.brier([0.05, 0.55, 0.95], [False, True, True])
    assert found == verification.brier([0.05, 0.55, 0.95], [False, True, True], 10)
    assert found.reliability == pytest.approx((0.05**2 + 0.45**2 + 0.05**2) / 3)
    assert found.resolution == pytest.approx(2 / 9)
    # The edge at 0.9 is one of ten bins and none of nine.
    p, happened = np.array([0.895, 0.905]), [False, True]
    assert verification.brier(p, happened).resolution == pytest.approx(0.25)


def test_reliability_by_hand() -> None:
    p = np.array([0.0, 0.1, 0.1, 0.9, 1.0])
    found = verification.reliability(p, [0, 0, 1, 1, 1], bins=5)
    np.testing.assert_allclose(found["bin"], [0.1, 0.9])  # the edge 1 belongs to the last bin
    np.testing.assert_allclose(found["forecast"], [0.2 / 3, 0.95])
    np.testing.assert_allclose(found["observed"], [1 / 3, 1])
    np.testing.assert_array_equal(found["count"], [3, 2])


def test_band_of_groups_is_the_turned_deviations() -> None:
    """Two groups deviate by 0.5 and 0.1: four signs, of which the seen one is the largest."""
    p = np.full(20, 0.5)
    happened = np.array([True] * 10 + [True] * 6 + [False] * 4)
    found = verification.reliability(p, happened, 1, np.repeat([1999, 2003], 10))
    assert found["observed"].item() == pytest.approx(0.8)
    assert found["low"].item() == pytest.approx(0.5 - 0.3)
    assert found["high"].item() == pytest.approx(0.5 + 0.3)
    assert found.attrs["p_value"] == 0.5
    assert found["groups"].item() == 2


def test_rank_by_hand() -> None:
    members = np.tile([3.0, 1.0, np.inf, 2.0], (400, 1))
    for truth, low, high in ((2.5, 0.4, 0.6), (0.5, 0.0, 0.2), (2.0, 0.2, 0.6), (np.inf, 0.6, 1.0)):
        found = verification.pit(members, np.full(400, truth))["pit"].to_numpy()
        assert low <= found.min() < low + 0.01
        assert high - 0.01 < found.max() < high


def test_crps_by_hand() -> None:
    members = np.array([[0.0], [2.0]])
    assert verification.crps(members, np.array([1.0])) == 0.0
    assert verification.crps(members, np.array([3.0])) == 1.0
    # Of a Gaussian and its mean: sd (√2 − 1) / √π.
    drawn = np.random.default_rng(2).standard_normal((20, 20_000))
    expected = (np.sqrt(2) - 1) / np.sqrt(np.pi)
    assert verification.crps(drawn, np.zeros(20_000)).mean() == pytest.approx(expected, abs=0.005)


def test_score_ratio_by_hand() -> None:
    reference = np.array([[1.0, 2.0], [3.0, 2.0], [1.0, 2.0]])
    score = reference * [0.5, 1.0]
    score[0, 1] = 8.0
    found = verification.score_ratio(score, reference, [1, 2, 2])
    np.testing.assert_allclose(found["ratio"], [0.5, 2.0])
    # Either group alone is drawn half of the time.
    np.testing.assert_allclose(found["low"], [0.5, 1.0])
    np.testing.assert_allclose(found["high"], [0.5, 4.0])


# In law


def independent(seed: int, cases: int = 600) -> tuple[Floats, Floats]:
    random = np.random.default_rng(seed)
    p = random.beta(0.5, 0.8, cases)
    return p, (random.random(cases) < p).astype(float)


def in_summers(seed: int, summers: int = SUMMERS, cases: int = 60) -> tuple[Floats, ...]:
    """Calibrated cases that share half of their chance with the others of their summer."""
    random = np.random.default_rng(seed)
    p = np.linspace(0.05, 0.95, cases)
    limit = np.array([NormalDist().inv_cdf(x) for x in p])
    shared, own = random.standard_normal((summers, 1)), random.standard_normal((summers, cases))
    happened = np.sqrt(0.5) * shared + np.sqrt(0.5) * own < limit
    groups = np.broadcast_to(np.arange(summers)[:, None], happened.shape)
    return np.broadcast_to(p, happened.shape), happened.astype(float), groups


def test_calibrated_passes_and_overconfident_fails() -> None:
    alarms, found_out = 0, 0
    for seed in range(40):
        p, happened = independent(seed)
        odds = p**2
        sure = odds / (odds + (1 - p) ** 2)
        alarms += verification.reliability(p, happened).attrs["p_value"] <= 0.05
        found_out += verification.reliability(sure, happened).attrs["p_value"] <= 0.05
    assert alarms <= 6  # 5 % of 40, and 2.9 standard errors
    assert found_out == 40


def test_bars_hold_what_they_say() -> None:
    runs = [verification.reliability(*independent(seed)) for seed in range(60)]
    inside = [((run["observed"] >= run["low"]) & (run["observed"] <= run["high"])) for run in runs]
    assert np.concatenate(inside).mean() > 0.94


def test_six_dependent_summers_are_no_false_alarm() -> None:
    """A band of independent cases would reject many calibrated forecasts; that of summers, few."""
    alarms = np.zeros(2)
    for seed in range(REPEATS):
        p, happened, groups = in_summers(seed)
        alarms[0] += verification.reliability(p, happened, 5, groups).attrs["p_value"] <= 0.05
        if seed < 40:
            alarms[1] += verification.reliability(p, happened, 5).attrs["p_value"] <= 0.05
    # Of the 64 signs, two have no greater statistic: 3 %, and 2 standard errors.
    assert alarms[0] / REPEATS <= 0.055
    assert alarms[1] / 40 > 0.3


def test_summers_find_what_is_wrong() -> None:
    found = []
    for seed in range(40):
        p, happened, groups = in_summers(seed, summers=20)
        found.append(verification.reliability(p**2, happened, 5, groups).attrs["p_value"])
    assert np.mean(np.array(found) <= 0.05) > 0.7


@pytest.mark.parametrize("grouped", [False, True])
def test_ranks_of_censored_times(grouped: bool) -> None:
    random = np.random.default_rng(4)
    members, truth = random.exponential(size=(800, 50)), random.exponential(size=800)
    groups = np.arange(800) if grouped else None

    def p_value(scale: float) -> float:
        cut = [np.where(x > 1, np.inf, x) for x in (members * scale, truth)]  # 37 % afloat
        return float(verification.pit(*cut, groups=groups).attrs["p_value"])

    assert p_value(1.0) > 0.05
    assert p_value(0.7) < 0.01


# Summers left out


@lru_cache
def record(summers: int = SUMMERS) -> dc.WindRecord:
    return dc.read_record(synthetic_record(summers, seed=5), (6, 7, 8))


@lru_cache
def climate() -> dc.LocalGridBootstrap:
    return dc.LocalGridBootstrap.fit(synthetic_record(8), h=0.4)


def left_out(record: dc.WindRecord) -> xr.Dataset:
    """Events and stranding times of each summer, forecast from the others."""
    scenarios = [dc.paper.scenario(x=place) for place in ((1.0, 1.0), (1.12, 1.0), (1.0, 0.88))]
    square = [(1.05, 0.8), (1.2, 0.8), (1.2, 0.95), (1.05, 0.95)]
    folds = hindcast.leave_one_season_out(record, h=0.4)
    parts = [
        hindcast.hindcast(
            scenarios, season, climate, every_days=16, members=100, targets={"square": square}
        )
        for season, climate in folds
    ]
    found = xr.concat(parts, "release")
    return hindcast.events(found, (0.5, 1.0), 4, CENTER).assign(
        found[["stranding_time", "observed_stranding_time"]]
    )


def require_calibrated(found: xr.Dataset) -> None:
    p, happened = found["probability"].to_numpy(), found["happened"].to_numpy()
    assert p.shape == (3, 5 * SUMMERS, 8)
    assert np.ptp(p) > 0.9
    groups = np.broadcast_to(found["season"].to_numpy()[:, None], p.shape)
    calibrated = verification.reliability(p, happened, 5, groups)
    assert (calibrated["observed"] >= calibrated["low"]).all()
    assert (calibrated["observed"] <= calibrated["high"]).all()
    assert calibrated.attrs["p_value"] > 0.05
    assert calibrated.attrs["skill"] > 0.2
    times = (found["stranding_time"], found["observed_stranding_time"])
    assert verification.pit(*times, 5, groups[..., 0]).attrs["p_value"] > 0.05
    # The same check refuses forecasts of the opposite.
    opposite = verification.reliability(1 - p, happened, 5, groups)
    assert opposite.attrs["p_value"] <= 0.05


def test_events_by_hand() -> None:
    """Four members as seen from (1, 1): north at 0.2, east at 0.4, afloat, and west at 0.6."""
    inf, nan = np.inf, np.nan
    dims = ("scenario", "release", "member")
    place = [[1.0, 1.5], [1.5, 1.0], [nan, nan], [0.5, 1.0]]
    entry = [[0.1], [inf], [0.3], [0.5]]
    hindcasts = xr.Dataset(
        {
            "stranding_time": (dims, [[[0.2, 0.4, inf, 0.6]]]),
            "stranding_position": ((*dims, "component"), [[place]]),
            "entry_time": ((*dims, "target"), [[entry]]),
            "observed_stranding_time": (dims[:2], [[0.4]]),
            "observed_stranding_position": ((*dims[:2], "component"), [[[1.0, 0.5]]]),
            "observed_entry_time": ((*dims[:2], "target"), [[[inf]]]),
        },
        {"target": ["port"]},
    )
    found = hindcast.events(hindcasts, (0.4, 1.0), 4, CENTER).isel(scenario=0, release=0)
    told = {
        str(event.values): (float(p), bool(o))
        for event, p, o in zip(found["event"], found["probability"], found["happened"], strict=True)
    }
    assert told == {
        "stranded by 0.4": (0.5, True),
        "stranded by 1": (0.75, True),
        "stranded toward 0°": (0.25, False),
        "stranded toward 90°": (0.25, False),
        "stranded toward 180°": (0.0, True),
        "stranded toward 270°": (0.25, False),
        "entered port by 0.4": (0.5, False),
        "entered port by 1": (0.75, False),
    }


@pytest.mark.parametrize("step_h", [1, 6])
def test_releases_have_a_day_before_them_and_a_run_after_them(step_h: int) -> None:
    times = np.datetime64("2001-06-01", "s") + np.arange(0, 6 * 24, step_h) * np.timedelta64(1, "h")
    of_six_days = dc.WindRecord(times, np.zeros((len(times), 2)), step_h, "six days")
    per_day = 24 // step_h
    for days, every, expected in ((2, 1, [1, 2, 3]), (2, 2, [1, 3]), (3, 1, [1, 2]), (4, 1, [1])):
        rows = hindcast._releases(of_six_days, days * per_day + 1, every)
        assert (rows / per_day).tolist() == expected


def test_one_summer_left_out_is_calibrated() -> None:
    require_calibrated(left_out(record()))


def test_one_real_summer_left_out_is_calibrated(belle_ile_csv: Path) -> None:
    require_calibrated(left_out(dc.read_record(belle_ile_csv, (6, 7, 8))))


def test_a_fold_does_not_know_its_summer() -> None:
    folds = list(hindcast.leave_one_season_out(record(4), h=0.4))
    assert [int(season.season[0]) for season, _ in folds] == [2001, 2002, 2003, 2004]
    for season, fitted in folds:
        assert len(season) + len(fitted.record) == len(record(4))
        assert not np.isin(season.times, fitted.record.times).any()


def test_what_came_is_the_run_under_the_record() -> None:
    scenario = dc.paper.scenario(x=(1.12, 1.0))
    summer = next(hindcast.leave_one_season_out(record(4), h=0.4))[0]
    found = hindcast.hindcast(
        [scenario], summer, climate(), every_days=20, members=2, times=[0.1, 0.2]
    ).isel(scenario=0)
    paths = dc.record_paths(scenario, summer)
    rows = np.flatnonzero(np.isin(summer.times, found["release"].values.astype("datetime64[s]")))
    alone = dc.forecast(scenario, [paths[row] for row in rows], times=[0.1, 0.2]).dataset
    times = alone["stranding_time"].to_numpy()
    came = found["observed_stranding_time"]
    # The core chooses its steps for the winds that it is given together.
    np.testing.assert_allclose(came, np.nan_to_num(times, nan=np.inf), rtol=1e-5)
    np.testing.assert_allclose(
        found["observed_position"].transpose("release", "time", "component"),
        alone["position"],
        rtol=1e-5,
    )
    place = np.round(np.array([0.1, 0.2]) * scenario.hours_per_unit / 6).astype(int)
    np.testing.assert_array_equal(found["observed_wind"][0], summer.velocity[rows[0] + place])


def test_forecasts_from_the_present_know_the_past_only() -> None:
    row, steps = 40, 30
    summer = record()
    wind = hindcast.from_present(climate(), summer, row, 3, steps, 1)
    np.testing.assert_allclose(wind[:, 0], np.tile(summer.velocity[row], (3, 1)))
    changed = summer.velocity.copy()
    changed[row + 1 :] += 5.0
    changed[: row - 2] += 5.0
    other = dc.WindRecord(summer.times, changed, summer.step_h, "changed")
    np.testing.assert_array_equal(wind, hindcast.from_present(climate(), other, row, 3, steps, 1))


def test_forecasts_of_the_climate_know_the_time_of_the_day_only() -> None:
    """Members of the climate begin with any wind that it has at midnight."""
    summer, row = record(), 40
    assert str(summer.times[row])[11:16] == "00:00"
    wind = hindcast.from_climate(climate(), summer, row, 4000, 5, 1)
    assert wind.shape == (4000, 5, 2)
    np.testing.assert_array_equal(wind, hindcast.from_climate(climate(), summer, 80, 4000, 5, 1))
    known = climate().record
    hours = (known.times - known.times.astype("datetime64[D]")).astype("timedelta64[h]")
    for step in range(5):
        now = known.velocity[hours.astype(int) == 6 * step % 24]
        # Four standard errors of 4000 independent members, and as much again of the record's.
        error = 8 * now.std(axis=0) / np.sqrt(4000)
        assert (np.abs(wind[:, step].mean(axis=0) - now.mean(axis=0)) < error).all()


# Figures


def test_figures() -> None:
    p = np.repeat([0.1, 0.5, 0.9], 100)
    happened = np.concatenate([np.arange(100) < count for count in (10, 95, 90)])
    artists = plot.reliability_diagram(verification.reliability(p, happened))
    points = {a.get_label(): a for a in artists if isinstance(a, Line2D)}
    np.testing.assert_allclose(points["within"].get_xdata(), [0.1, 0.9])
    np.testing.assert_allclose(points["outside"].get_ydata(), [0.95])
    random = np.random.default_rng(5)
    ranks = verification.pit(random.random((200, 9)), random.random(200), bins=5)
    bars = plot.pit_histogram(ranks)[:5]
    np.testing.assert_allclose([bar.get_height() for bar in bars], ranks["density"])  # type: ignore[attr-defined]
    ratio = verification.score_ratio(np.ones((4, 3)), np.full((4, 3), 2.0), np.arange(4))
    lines = plot.score_ratios({"one": ratio.assign_coords(lead=[1, 2, 3])}, "lead", "ratio")
    np.testing.assert_allclose(lines[-1].get_ydata(), 0.5)  # type: ignore[attr-defined]
    with pytest.raises(dc.ScenarioError, match="density: not in the dataset"):
        plot.pit_histogram(ratio)


# Refused


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: verification.brier([0.1], [1, 0]), r"happened: shape \(2,\) is not accepted"),
        (lambda: verification.brier([], []), "at least one case"),
        (lambda: verification.brier([1.1], [1]), "probability: 1.1 is not accepted"),
        (lambda: verification.brier([np.nan], [1]), "probability: nan is not accepted"),
        (lambda: verification.brier([0.1], [2]), "happened: 2 is not accepted"),
        (lambda: verification.brier([0.1], [1], 0), "bins: 0 is not accepted"),
        (lambda: verification.brier([0.1], [1], [0, 0.5]), "edges that grow from 0 to 1"),
        (lambda: verification.reliability([0.1], [1], 5, [1, 2]), "groups: shape"),
        (lambda: verification.pit([[1.0]], [1.0, 2.0]), "members: shape"),
        (lambda: verification.pit([[np.nan]], [1.0]), "NaN is not accepted"),
        (lambda: verification.pit([[1.0]], [1.0], 1), "bins: 1 is not accepted"),
        (lambda: verification.crps([[1.0]], [1.0]), "at least 2 members"),
        (lambda: verification.score_ratio([1.0], [1.0], [1]), "score: shapes"),
        (
            lambda: hindcast.hindcast(
                [dc.paper.scenario(), dc.paper.scenario(wind_unit=4)], record(), climate()
            ),
            "scenarios: different lengths or units",
        ),
        (
            lambda: hindcast.hindcast([dc.paper.scenario()], record(), climate(), every_days=0),
            "every_days: 0 is not accepted",
        ),
        (
            lambda: hindcast.hindcast([dc.paper.scenario(1 / 200)], record(), climate()),
            "record: no segment is as long as a day and a run",
        ),
        (lambda: next(hindcast.leave_one_season_out(record(1))), "a single season"),
    ],
)
def test_refused(call: Any, message: str) -> None:
    with pytest.raises((dc.ScenarioError, dc.RecordError), match=message):
        call()
