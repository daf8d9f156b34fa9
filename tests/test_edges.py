"""Where one case ends and the next begins, and what is taken when an argument is left out."""

import calendar
import inspect
import shutil
import warnings
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.special import logsumexp

import driftcore as dc
from driftcore import files
from driftcore.climate import synthetic_record
from driftcore.errors import DriftCoreWarning, OutputError, RecordError, ScenarioError
from driftcore.members import kept_of
from driftcore.scenario import EnsembleConfiguration, WindConfiguration
from driftcore.statistics import probability, wilson
from reference import Floats

CALM = dc.WindPath([-1.0, 2.0], np.zeros((2, 2)))


def noise(start: str, rows: int, step: str) -> pd.DataFrame:
    """Wind with a memory of some steps."""
    times = pd.date_range(start, periods=rows, freq=step, name="time")
    values = np.random.default_rng(rows).standard_normal((rows, 2))
    return pd.DataFrame(5 * values, times, ["u10", "v10"]).ewm(halflife=3).mean()


def summers(years: range, rows: int, step: str) -> dc.WindRecord:
    """So many rows of each summer, which differ from each other."""
    parts = [noise(f"{year}-06-01", rows + year - years[0], step)[:rows] for year in years]
    return dc.read_record(pd.concat(parts), gaps="segment")


# Intervals


@pytest.mark.parametrize("members", [1, 3, 49, 1000, 12_345])
def test_none_and_all_have_exact_bounds(members: int) -> None:
    low, high = wilson([0, members], members)
    assert (low[0], high[1]) == (0.0, 1.0)
    z2 = 1.959963984540054**2
    assert (high[0], low[1]) == pytest.approx((z2 / (members + z2), members / (members + z2)))


def test_intervals_grow_with_the_level() -> None:
    bounds = [probability(30, 100, level) for level in (0.5, 0.9, 0.95, 0.99)]
    assert [p.level for p in bounds] == [0.5, 0.9, 0.95, 0.99]
    for narrow, wide in pairwise(bounds):
        assert wide.low < narrow.low < 0.3 < narrow.high < wide.high
    assert probability(30, 100) == bounds[2]
    for refused in (0, -1):
        with pytest.raises(ScenarioError, match=f"members: {refused} is not accepted"):
            probability(0, refused)


# Records


@pytest.mark.parametrize("month", range(1, 13))
def test_months_are_as_long_as_in_the_calendar(month: int) -> None:
    days = calendar.monthrange(2001, month)[1]
    frame = pd.concat([noise(f"{year}-{month:02}-01", 4 * days, "6h") for year in (2001, 2002)])
    with pytest.warns(DriftCoreWarning, match="2 season"):
        fit = dc.LocalGridBootstrap.fit(frame, months=(month,), h=0.3)
    assert fit.span_days == days


def test_a_leap_year_has_two_28ths_of_february() -> None:
    """A year of record has the cycle of 365 days, whatever year it is."""
    frame = noise("2003-01-01", 4 * (365 + 366), "6h")
    with pytest.warns(DriftCoreWarning, match="season"):
        fit = dc.LocalGridBootstrap.fit(frame, months=None, h=0.3)
    times = pd.DatetimeIndex(fit.record.times[fit.row])
    months = [calendar.monthrange(2001, month)[1] for month in range(1, 13)]
    for time, phase in zip(times, fit.phase, strict=True):
        day = sum(months[: time.month - 1]) + min(time.day, months[time.month - 1]) - 1
        assert phase == 4 * day + time.hour // 6


def warned(record: pd.DataFrame) -> bool:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        dc.read_record(record)
    assert all(w.category is DriftCoreWarning and w.filename == __file__ for w in caught)
    return bool(caught)


@pytest.mark.parametrize(
    ("usual", "rare", "doubted"),
    [
        (12.45, 12.45, False),
        (12.55, 12.55, True),
        (5.0, 32.6, False),
        (5.0, 32.8, True),
    ],
)
def test_speeds_are_doubted_above_the_limits(usual: float, rare: float, doubted: bool) -> None:
    """12.5 m/s on average, 32.7 m/s for one hour in a thousand."""
    frame = noise("2001-06-01", 1000, "1h")
    frame["u10"], frame["v10"] = 0.0, usual
    frame.iloc[10:15] = [0.0, -rare]
    assert warned(frame) == doubted


@pytest.mark.parametrize(("speed", "doubted"), [(99.5, False), (100.0, False), (100.5, True)])
def test_a_single_speed_is_doubted_above_100(speed: float, doubted: bool) -> None:
    frame = noise("2001-06-01", 5000, "1h") / 10
    frame.iloc[77] = [0.6 * speed, -0.8 * speed]
    assert warned(frame) == doubted


def test_a_record_of_few_seasons_is_told_to_the_caller() -> None:
    with pytest.warns(DriftCoreWarning, match="season") as caught:
        dc.LocalGridBootstrap.fit(synthetic_record(2), h=0.3)
    assert caught[0].filename == __file__


@pytest.mark.parametrize(("rows", "enough"), [(201, False), (202, True)])
def test_two_hundred_rows_are_enough(rows: int, enough: bool) -> None:
    """Order 2 needs a row before and a row after each."""
    frame = synthetic_record(1)[:rows]
    if enough:
        with pytest.warns(DriftCoreWarning, match="1 season"):
            assert len(dc.LocalGridBootstrap.fit(frame, h=0.3).row) == 200
    else:
        with pytest.raises(RecordError, match="199 rows"):
            dc.LocalGridBootstrap.fit(frame, h=0.3)


def test_arguments_at_the_edge_of_their_range() -> None:
    frame = synthetic_record(3)
    bare = dc.LocalGridBootstrap.fit(frame, mode="lgb", h=0.3, b=0, share=0, order=8)
    assert (bare.small_scale_sd, bare.b, bare.order) == (0.0, 0.0, 8)
    for field, value in (("h", np.inf), ("memory_h", np.inf), ("share", 1)):
        with pytest.raises(ScenarioError, match=f"^{field}: "):
            dc.LocalGridBootstrap.fit(frame, **{"h": 0.3, field: value})


# The search of the bandwidths


def test_bandwidths_tried_by_the_paper_mode() -> None:
    """A quarter, 2^-3/2, ... of the limits, both of which are reached."""
    fit = dc.LocalGridBootstrap.fit(synthetic_record(4), mode="lgb")
    shares = 2.0 ** np.array([-2, -1.5, -1, -0.5, 0])
    tried = fit.likelihood
    assert len(tried) == 25
    for name in ("h", "b"):
        values = np.unique(tried[name])
        assert values / values[-1] == pytest.approx(shares)
    anomaly = fit.record.velocity - fit.cycle[np.arange(len(fit.record)) % 4]
    segment, season = fit.record.segment, fit.record.season
    pairs = [(k, k + 1) for k in range(len(segment) - 1) if segment[k] == segment[k + 1]]

    def correlation(kept: list[tuple[int, int]]) -> Floats:
        now, after = anomaly[[k for k, _ in kept]], anomaly[[k for _, k in kept]]
        return np.asarray(2 * (now * after).sum(0) / (now**2 + after**2).sum(0))

    rho = correlation(pairs)
    years = np.unique(season)
    without = [correlation([pair for pair in pairs if season[pair[0]] != y]) for y in years]
    error = np.sqrt((len(years) - 1) * np.var(without, axis=0))
    assert tried["h"].max() == pytest.approx(np.sqrt(error / rho).min())
    assert tried["b"].max() == pytest.approx(np.sqrt(0.02 * (1 - rho**2)).min())


def test_bandwidths_tried_by_default() -> None:
    tried = dc.LocalGridBootstrap.fit(synthetic_record(3)).likelihood["h"]
    assert tried == pytest.approx(0.1 * 2 ** (np.arange(17) / 4))


def test_a_long_hourly_record_is_scored_at_every_hour_of_the_day() -> None:
    """At every fifth row: 2,400 rows are too many for all, and 2, 3 and 4 divide the day."""
    fit = dc.LocalGridBootstrap.fit(summers(range(2001, 2004), 802, "1h"), mode="lgb", h=0.5)
    successor = fit.target
    season = fit.record.season[fit.row]
    z = fit.states @ fit.whitening.T
    for candidate in fit.likelihood[[0, -1]]:
        total = []
        for j in range(0, len(z), 5):
            kept = season != season[j]
            log_weight = -((z[kept] - z[j]) ** 2).sum(axis=1) / (2 * 0.5**2)
            covariance = candidate["b"] ** 2 * np.cov(successor[kept].T)
            gap = successor[j] - successor[kept]
            exponent = -0.5 * np.einsum("ni,ij,nj->n", gap, np.linalg.inv(covariance), gap)
            log_density = logsumexp(log_weight + exponent) - logsumexp(log_weight)
            total.append(log_density - np.log(2 * np.pi * np.sqrt(np.linalg.det(covariance))))
        assert candidate["log_likelihood"] == pytest.approx(np.mean(total), abs=2e-4)


def test_draws_of_a_long_hourly_record_are_averaged_at_every_hour_of_the_day() -> None:
    """At every fifth row, as above, where all pairs would be more than a hundred million."""
    fit = dc.LocalGridBootstrap.fit(summers(range(2001, 2007), 1802, "1h"), h=0.5)
    z = fit.states @ fit.whitening.T
    drawn = np.zeros(len(z))
    for state in z[::5]:
        weight = np.exp(-((z - state) ** 2).sum(axis=1) / (2 * 0.5**2))
        drawn += weight / weight.sum()
    # Other rows, such as every second, leave a mean of some 1e-4 m/s.
    assert np.abs(drawn @ fit.target).max() / drawn.sum() < 1e-6


# Wind paths


def test_paths_forgive_rounding_at_both_ends() -> None:
    """A billionth of the path's length, wherever its origin is."""
    for first in (-2.0, -1.0, 0.0, 5.0):
        path = dc.WindPath([first, first + 2.0], [[1.0, 0.0], [1.0, 2.0]])
        assert path.at([first - 1e-9, first + 2 + 1e-9]) == pytest.approx(
            np.array([[1.0, 0.0], [1.0, 2.0]]), abs=1e-8
        )
        for outside in (first - 1e-8, first + 2 + 1e-8):
            with pytest.raises(ScenarioError, match="is not covered by the path"):
                path.at(outside)


def test_every_window_of_a_record_as_long_as_a_run() -> None:
    record = summers(range(2001, 2003), 60, "6h")
    # 20 steps of 6 h: the run ends at the last of 21 values.
    scenario = dc.paper.scenario(epsilon=12.5 / 120, wind_unit=2.5)
    paths = dc.record_paths(scenario, record)
    assert len(paths) == 2 * (60 - 20)
    for path, first in zip(paths, [*range(40), *range(60, 100)], strict=True):
        assert path.times == pytest.approx(np.arange(21) / 20, abs=1e-15)
        assert np.array_equal(path.velocity, record.velocity[first : first + 21] / 2.5)
    # A run a little longer needs one value more.
    longer = dc.record_paths(dc.paper.scenario(epsilon=12.5 / 120.1), record)
    assert [len(path.times) for path in longer] == [22] * (2 * (60 - 21))
    assert (longer[0].times[-2], longer[0].times[-1]) == pytest.approx((120 / 120.1, 126 / 120.1))


def test_a_record_shorter_than_the_run_has_no_window() -> None:
    record = summers(range(2001, 2003), 60, "6h")
    whole = dc.record_paths(dc.paper.scenario(epsilon=12.5 / (59 * 6)), record)
    assert [len(path.times) for path in whole] == [60, 60]
    for hours in (59 * 6 + 1, 10_000):
        with pytest.raises(RecordError, match="no segment lasts the"):
            dc.record_paths(dc.paper.scenario(epsilon=12.5 / hours), record)


def test_the_knots_of_a_member(embedded_wind: dc.LocalGridBootstrap) -> None:
    """They begin three tides before the release, at a step of the record, and are fine."""
    scenario = dc.paper.scenario(epsilon=1 / 50, tide_period_h=12.5)
    hours = 625 * dc.member_path(scenario, embedded_wind, member=3).times
    # 3 tides are 37.5 h, 7 steps of 6 h; a hundredth of a tide is 0.125 h.
    assert hours[0] == pytest.approx(-42)
    assert np.diff(hours) == pytest.approx(0.125)
    # A window of 4 tides around a place half a tide beyond the end.
    assert 625 + 2.5 * 12.5 <= hours[-1] < 625 + 2.5 * 12.5 + 6
    coarse = dc.paper.scenario(epsilon=1 / 5, tide_period_h=660.0)
    hours = 3300 * dc.member_path(coarse, embedded_wind, member=3).times
    assert np.diff(hours) == pytest.approx(6)
    assert hours[0] == pytest.approx(-1980)


def test_synoptic_winds_begin_at_the_release(embedded_wind: dc.LocalGridBootstrap) -> None:
    fc = dc.forecast(dc.paper.scenario(), embedded_wind, members=2, seed=4).dataset
    steps = fc.sizes["wind_time"]
    drawn = embedded_wind.sample(2, 7 + steps, seed=4)
    assert np.array_equal(fc["wind_velocity"], drawn[:, 7:])
    last = 625 * fc["wind_time"].values[-1]
    assert 625 <= last < 625 + 12.5 + 6


def test_given_winds_are_kept_in_metres_per_second() -> None:
    path = dc.WindPath([-0.5, 1.5], [[1.0, 0.0], [-1.0, 2.0]])
    times = [0.0, 0.5, 1.0]
    fc = dc.forecast(dc.paper.scenario(wind_unit=4.0), [CALM, path], times=times).dataset
    assert fc["wind_time"].values.tolist() == times
    assert not fc["wind_velocity"][0].any()
    assert fc["wind_velocity"][1].values == pytest.approx(4 * path.at(times))


@pytest.fixture(scope="module")
def filed_wind(tmp_path_factory: pytest.TempPathFactory) -> dc.LocalGridBootstrap:
    """The wind of a file, short: soon fitted again."""
    path = tmp_path_factory.mktemp("record") / "wind.csv"
    synthetic_record(3).to_csv(path)
    return dc.LocalGridBootstrap.fit(path)


@pytest.mark.parametrize(
    ("how", "own"),
    [
        ({"model": "full"}, {"model": "mean-flow"}),
        ({"model": "mean-flow", "order": 2}, {"model": "mean-flow", "order": 2}),
        (
            {"model": "paper", "order": 0, "window": 0.3, "wind_terms": False},
            {"model": "paper", "order": 0, "window": 0.3, "wind_terms": False},
        ),
    ],
    ids=["full", "mean-flow", "paper"],
)
def test_a_member_followed_again(
    how: dict[str, Any], own: dict[str, Any], filed_wind: dc.LocalGridBootstrap
) -> None:
    """Closely, by the full model and by the forecast's own, or by mean-flow where that was it."""
    scenario = dc.paper.scenario(epsilon=1 / 10)
    fc = dc.forecast(scenario, filed_wind, members=3, seed=9, **how)
    full, averaged, path = dc.member_trajectories(fc, 2)
    expected = dc.member_path(scenario, filed_wind, 2, seed=9)
    assert np.array_equal(path.times, expected.times)
    assert np.array_equal(path.velocity, expected.velocity)
    times = full["time"].values
    assert times == pytest.approx(np.arange(401) / 400, abs=1e-15)
    exact = dc.trajectory(scenario, path, model="full", times=times, rtol=1e-10)
    assert full.position.equals(exact.position)
    other = dc.trajectory(scenario, path, times=times, **own)
    assert averaged.position.equals(other.position)
    assert averaged.velocity.equals(other.velocity)
    assert (full.attrs["model"], averaged.attrs["model"]) == ("full", own["model"])
    for name in ("wind_label", "wind_synthetic", "wind_sha256"):
        assert full.attrs[name] == averaged.attrs[name] == fc.dataset.attrs[name]


def test_what_no_trajectory_is_made_of() -> None:
    follow: dict[str, Any] = {"scenario": dc.paper.scenario(), "path": CALM, "times": [1.0]}
    with pytest.raises(ScenarioError, match="path: list is not accepted; give a WindPath"):
        dc.trajectory(**follow | {"path": [CALM], "model": "full"})
    with pytest.raises(ScenarioError, match="times: must be one finite number or a list of them"):
        dc.trajectory(**follow | {"times": "soon", "model": "full"})
    with pytest.raises(dc.DriftCoreError) as failed:
        dc.trajectory(**follow | {"scenario": dc.paper.scenario(v=(1e300, 0.0)), "model": "full"})
    assert not isinstance(failed.value, ScenarioError)


# Defaults


def defaults(function: Callable[..., Any]) -> dict[str, Any]:
    parameters = inspect.signature(function).parameters.values()
    return {p.name: p.default for p in parameters if p.default is not inspect.Parameter.empty}


def test_the_fit_has_the_defaults_of_a_configuration() -> None:
    configured = WindConfiguration().model_dump()
    found = defaults(dc.LocalGridBootstrap.fit)
    assert found == {name: configured[name] for name in found}
    fit = dc.LocalGridBootstrap.fit(synthetic_record(3), h=0.3)
    assert fit.record.months == (6, 7, 8)
    assert (fit.mode, fit.order, fit.share, fit.memory_h) == ("residual", 2, 0.1, 3.0)


def test_a_forecast_has_the_defaults_of_a_configuration(
    embedded_wind: dc.LocalGridBootstrap,
) -> None:
    configured = EnsembleConfiguration().model_dump()
    for name, value in defaults(dc.forecast).items():
        if name in configured and value is not None:
            assert value == configured[name], name
    assert dc.paper.scenario() == dc.Scenario()
    fc = dc.forecast(dc.paper.scenario(epsilon=1 / 10), embedded_wind, keep=0)
    assert fc.dataset.sizes["member"] == configured["members"]
    again = dc.RunConfiguration.from_toml(fc.configuration()).ensemble
    assert again.outputs_per_tide == configured["outputs_per_tide"]
    sectors = fc.stranding_by_sector()
    assert sectors["direction"].values.tolist() == (22.5 * np.arange(16)).tolist()
    assert fc.stranding_time_quantiles()["quantile"].values.tolist() == [0.05, 0.5, 0.95]


def test_the_paper_model_averages_over_half_a_tide_unless_told(
    embedded_wind: dc.LocalGridBootstrap,
) -> None:
    scenario = dc.paper.scenario(epsilon=1 / 20)
    path = dc.member_path(scenario, embedded_wind, 0)

    def followed(**how: Any) -> xr.Dataset:
        return dc.trajectory(scenario, path, model="paper", times=[0.5, 1.0], **how)

    half, quarter = followed(), followed(window=1 / 80)
    assert half.position.equals(followed(window=1 / 40).position)
    assert not half.position.equals(quarter.position)
    assert (half.attrs["window"], quarter.attrs["window"]) == (1 / 40, 1 / 80)
    assert half.attrs["wind_terms"] == 1
    assert followed(wind_terms=False).attrs["wind_terms"] == 0
    assert half.attrs["order"] == 1
    assert half.position.equals(followed(order=1).position)
    # Nothing averages the wind of the others.
    for model in ("full", "mean-flow"):
        attributes = dc.trajectory(scenario, path, model=model, times=[1.0]).attrs
        assert not {"window", "wind_terms"} & set(attributes)
    atol = dc.trajectory(scenario, path, model="full", times=[1.0], rtol=1e-5, atol=1e-5)
    alone = dc.trajectory(scenario, path, model="full", times=[1.0], rtol=1e-5)
    assert atol.position.equals(alone.position)


def test_the_synthetic_climate_says_that_it_is_one() -> None:
    frame = synthetic_record(years=1)
    assert frame.attrs["wind_synthetic"] == 1
    plain = pd.DataFrame(frame)
    plain.attrs = {}
    record = dc.read_record(plain)
    assert (record.synthetic, record.label) == (False, "wind record in memory")


# Files


@pytest.mark.parametrize("missing", [0, 1])
def test_a_file_needs_its_values_and_a_megabyte(
    missing: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fc = dc.forecast(dc.paper.scenario(), [CALM])
    free = fc.dataset.nbytes + 1_000_000 - missing
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    if missing:
        with pytest.raises(OutputError, match="are free"):
            fc.to_netcdf(tmp_path / "out.nc")
    else:
        fc.to_netcdf(tmp_path / "out.nc")
    assert (tmp_path / "out.nc").exists() == (not missing)


def test_a_folder_where_a_file_is(tmp_path: Path) -> None:
    target = tmp_path / "results"
    target.mkdir()
    (target / "sub").write_text("a file", encoding="utf-8")

    def fill() -> None:
        with files.filling(target, overwrite=True) as folder:
            (folder / "sub").mkdir()
            (folder / "sub" / "a.txt").touch()

    with pytest.raises(OutputError, match="sub: cannot be made"):
        fill()
    assert [path.name for path in tmp_path.rglob("*")] == ["results", "sub"]
    assert (target / "sub").read_text(encoding="utf-8") == "a file"


@pytest.mark.parametrize(
    ("first", "keep", "kept"), [(0, 4, 4), (2, 4, 2), (4, 4, 0), (9, 4, 0), (0, 50, 10), (3, 12, 9)]
)
def test_kept_are_the_members_below_a_number(first: int, keep: int, kept: int) -> None:
    assert kept_of(first, 10, keep) == kept
