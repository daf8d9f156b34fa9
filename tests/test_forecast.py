"""Forecasts and trajectories: what the datasets hold, statistics, repeatability, fates."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import driftcore as dc
from driftcore.climate import synthetic_record
from driftcore.errors import DriftCoreWarning, OutputError, ScenarioError
from driftcore.forecast import forecast
from driftcore.results import Forecast, open_forecast
from driftcore.statistics import quantile_interval
from driftcore.trajectories import trajectory
from reference import Floats, wilson_interval

AFLOAT, STRANDED, LEFT_DOMAIN, FAILED = range(4)
SQUARE = dc.Polygons(rings=(((0.8, 0.8), (1.2, 0.8), (1.2, 1.2), (0.8, 1.2)),))
CALM = dc.WindPath([-1.0, 2.0], np.zeros((2, 2)))


@pytest.fixture(scope="module")
def ensemble(embedded_wind: dc.LocalGridBootstrap) -> Forecast:
    """The paper's case with 300 members, all kept."""
    return forecast(dc.paper.scenario(), embedded_wind, members=300)


def values(fc: Forecast, name: str) -> Floats:
    return np.asarray(fc.dataset[name].values)


def same(left: Forecast, right: Forecast) -> bool:
    """Bit by bit, NaN included; the attributes tell the time of making."""
    return bool(left.dataset.equals(right.dataset))


def again(fc: Forecast) -> Forecast:
    """Run a forecast again from its own configuration."""
    return dc.run(dc.RunConfiguration.from_toml(fc.configuration()))


# The dataset


def test_dataset_follows_the_conventions(ensemble: Forecast) -> None:
    dataset = ensemble.dataset
    status = dataset["status"]
    assert status.dtype == np.int8
    assert status.attrs["flag_values"].tolist() == [AFLOAT, STRANDED, LEFT_DOMAIN, FAILED]
    assert status.attrs["flag_values"].dtype == status.dtype
    assert status.attrs["flag_meanings"] == "afloat stranded left_domain failed"
    assert dataset["member"].attrs["cf_role"] == "trajectory_id"
    assert dataset["component"].values.tolist() == ["x", "y"]
    assert all("long_name" in variable.attrs for variable in dataset.data_vars.values())
    assert all("units" in dataset[name].attrs for name in set(dataset.data_vars) - {"status"})

    attributes = dataset.attrs
    assert attributes["Conventions"] == "CF-1.11"
    assert attributes["featureType"] == "trajectory"
    assert attributes["title"] == "Drift forecast: paper, 300 members"
    assert attributes["source"] == f"driftcore {dc.__version__}"
    assert (attributes["model"], attributes["order"]) == ("mean-flow", 1)
    assert (attributes["seed"], attributes["members"]) == (1, 300)
    assert "synthetic" in attributes["wind_label"]
    assert attributes["wind_synthetic"] == 1
    assert json.loads(attributes["release"]) == [1.0, 1.0]
    circle = {"kind": "circle", "center": [1.0, 1.0], "radius": 0.3, "side": "inside"}
    assert json.loads(attributes["coast"]) == circle
    assert {name: attributes[name] for name in ("epsilon", "tide_period_h", "wind_unit")} == {
        "epsilon": 1 / 50,
        "tide_period_h": 12.5,
        "wind_unit": 3.0,
    }


def test_what_is_known_of_a_member_fits_its_status(ensemble: Forecast) -> None:
    stranded = values(ensemble, "status") == STRANDED
    time, place = values(ensemble, "stranding_time"), values(ensemble, "stranding_position")
    assert set(values(ensemble, "status")) == {AFLOAT, STRANDED}
    assert np.array_equal(np.isfinite(time), stranded)
    assert np.array_equal(np.isfinite(place).all(axis=1), stranded)
    assert np.array_equal(np.isnan(place).all(axis=1), ~stranded)
    assert ((time[stranded] > 0) & (time[stranded] <= 1)).all()


def test_strandings_lie_on_the_circle(ensemble: Forecast) -> None:
    place = values(ensemble, "stranding_position")
    place = place[np.isfinite(place[:, 0])]
    assert len(place) > 100
    assert np.abs(np.hypot(*(place - 1).T) - 0.3).max() < 1e-12


def test_positions_end_at_the_coast(ensemble: Forecast) -> None:
    position, output = values(ensemble, "position"), values(ensemble, "time")
    time = np.nan_to_num(values(ensemble, "stranding_time"), nan=np.inf)
    adrift = output <= time[:, None]
    assert np.array_equal(np.isfinite(position).all(axis=-1), adrift)
    assert np.array_equal(np.isnan(position).all(axis=-1), ~adrift)
    assert (np.hypot(*(position[adrift] - 1).T) <= 0.3 + 1e-12).all()
    assert (position[:, 0] == 1.0).all()


def test_positions_are_kept_eight_times_a_tide_or_when_asked(
    ensemble: Forecast, embedded_wind: dc.LocalGridBootstrap
) -> None:
    assert values(ensemble, "time") == pytest.approx(np.arange(401) / 400, abs=1e-15)
    asked = forecast(dc.paper.scenario(), embedded_wind, members=20, times=[0.1, 0.25])
    assert np.array_equal(
        values(asked, "position"), values(ensemble, "position")[:20, [40, 100]], equal_nan=True
    )


@pytest.mark.parametrize("model", ["full", "mean-flow"])
def test_the_end_of_the_run_is_kept(model: Any, embedded_wind: dc.LocalGridBootstrap) -> None:
    """Also where the steps add up to less than the run by rounding: 49 times 1/49."""
    scenario = dc.paper.scenario(epsilon=1 / 49, coast=None)
    fc = forecast(scenario, embedded_wind, members=17, model=model, times=[1.0])
    assert np.isfinite(values(fc, "position")).all()


def test_kept_winds_are_those_of_the_bootstrap(
    ensemble: Forecast, embedded_wind: dc.LocalGridBootstrap
) -> None:
    wind, output = values(ensemble, "wind_velocity"), values(ensemble, "wind_time")
    assert np.diff(output) == pytest.approx(6 / 12.5 / 50)
    assert output[0] == 0.0
    assert output[-1] >= 1.0
    drawn = embedded_wind.sample(300, 50 + len(output), seed=1)
    # The winds begin some steps before the release.
    lead = next(k for k in range(50) if np.array_equal(drawn[:, k : k + len(output)], wind))
    assert lead > 0


def test_keeping_fewer_members(embedded_wind: dc.LocalGridBootstrap, ensemble: Forecast) -> None:
    few = forecast(dc.paper.scenario(), embedded_wind, members=20, keep=5).dataset
    assert few["position"].dims == ("kept_member", "time", "component")
    assert few["wind_velocity"].dims == ("kept_member", "wind_time", "component")
    assert few["kept_member"].values.tolist() == [0, 1, 2, 3, 4]
    assert few.sizes["member"] == 20
    assert np.array_equal(few["position"].values, values(ensemble, "position")[:5], equal_nan=True)
    none = forecast(dc.paper.scenario(), embedded_wind, members=3, keep=0).dataset
    assert none.sizes["kept_member"] == 0


@pytest.mark.parametrize("keep", [1000, 2, 0])
def test_files_give_the_same_back(
    keep: int, embedded_wind: dc.LocalGridBootstrap, tmp_path: Path
) -> None:
    before = forecast(dc.paper.scenario(), embedded_wind, members=4, keep=keep, seed=2**64 - 1)
    before.to_netcdf(tmp_path / "forecast.nc")
    after = open_forecast(str(tmp_path / "forecast.nc"))
    assert after.dataset.identical(before.dataset)
    assert {name: v.dtype for name, v in after.dataset.variables.items()} == {
        name: v.dtype for name, v in before.dataset.variables.items()
    }
    assert int(after.dataset.attrs["seed"]) == 2**64 - 1
    with xr.open_dataset(tmp_path / "forecast.nc", decode_cf=False) as raw:
        # CF 2.5.1: coordinates have no missing values.
        assert not any("_FillValue" in raw[name].attrs for name in raw.coords)


def test_files_are_not_overwritten_unasked(ensemble: Forecast, tmp_path: Path) -> None:
    path = tmp_path / "forecast.nc"
    path.write_text("precious", encoding="utf-8")
    with pytest.raises(OutputError, match=r"forecast\.nc: exists"):
        ensemble.to_netcdf(path)
    assert path.read_text(encoding="utf-8") == "precious"
    ensemble.to_netcdf(path, overwrite=True)
    assert same(open_forecast(path), ensemble)
    assert [file.name for file in tmp_path.iterdir()] == ["forecast.nc"]


# Statistics


def test_counts(ensemble: Forecast) -> None:
    status = values(ensemble, "status").tolist()
    names = ("afloat", "stranded", "left_domain", "failed")
    assert ensemble.counts == {name: status.count(flag) for flag, name in enumerate(names)}
    assert ensemble.followed == 300


@pytest.mark.parametrize("by", [None, 0.0, 0.5, 0.8, 1.0])
def test_stranding_probability(ensemble: Forecast, by: float | None) -> None:
    times = [t for t in values(ensemble, "stranding_time") if math.isfinite(t)]
    count = len([t for t in times if by is None or t <= by])
    p = ensemble.stranding_probability(by)
    assert (p.count, p.members, p.estimate) == (count, 300, count / 300)
    assert (p.low, p.high) == pytest.approx(wilson_interval(count, 300), abs=1e-15)
    assert 0 <= p.low <= p.estimate <= p.high <= 1


@pytest.mark.parametrize("sectors", [1, 4, 16])
def test_sectors_are_centred_on_north_and_share_the_strandings(
    ensemble: Forecast, sectors: int
) -> None:
    counts = [0] * sectors
    for x, y in values(ensemble, "stranding_position"):
        if math.isfinite(x):
            clockwise = math.degrees(math.atan2(x - 1, y - 1)) % 360
            counts[math.floor((clockwise + 180 / sectors) / (360 / sectors)) % sectors] += 1
    found = ensemble.stranding_by_sector(sectors)
    assert found["direction"].values.tolist() == [360 / sectors * k for k in range(sectors)]
    assert (found["probability"].values * 300).round(9).tolist() == counts
    total = found["probability"].sum().item()
    assert total == pytest.approx(ensemble.stranding_probability().estimate, abs=1e-14)
    for k, count in enumerate(counts):
        interval = (found["low"].values[k], found["high"].values[k])
        assert interval == pytest.approx(wilson_interval(count, 300), abs=1e-15)


def test_stranding_time_quantiles(ensemble: Forecast) -> None:
    times = sorted(t for t in values(ensemble, "stranding_time") if math.isfinite(t))
    quantiles = ensemble.stranding_time_quantiles((0.0, 0.3, 1.0))
    place = 0.3 * (len(times) - 1)
    below, share = int(place), place - int(place)
    expected = [times[0], (1 - share) * times[below] + share * times[below + 1], times[-1]]
    assert quantiles.values == pytest.approx(expected, abs=1e-15)
    assert quantiles["quantile"].values.tolist() == [0.0, 0.3, 1.0]
    low, high = quantile_interval(times, [0.0, 0.3, 1.0])
    assert quantiles["low"].values == pytest.approx(low, nan_ok=True)
    assert quantiles["high"].values == pytest.approx(high, nan_ok=True)
    assert low[1] < quantiles.values[1] < high[1]


def test_nothing_stranded_has_no_quantiles() -> None:
    fc = forecast(dc.paper.scenario(), [CALM])
    assert np.isnan(fc.stranding_time_quantiles().values).all()
    assert fc.stranding_probability().estimate == 0
    assert fc.stranding_by_sector(4)["probability"].values.tolist() == [0, 0, 0, 0]


# Repeatability


@pytest.mark.parametrize("how", [{"threads": 1}, {"threads": 2}, {"chunk": 7}, {"chunk": 1000}])
def test_threads_and_chunks_change_nothing(
    how: dict[str, Any], ensemble: Forecast, embedded_wind: dc.LocalGridBootstrap
) -> None:
    assert same(forecast(dc.paper.scenario(), embedded_wind, members=300, **how), ensemble)


def test_one_by_one_is_as_all_at_once(embedded_wind: dc.LocalGridBootstrap) -> None:
    scenario = dc.paper.scenario()
    for model in ("full", "paper", "mean-flow"):
        options: dict[str, Any] = {"members": 9, "model": model}
        one_by_one = forecast(scenario, embedded_wind, chunk=1, threads=1, **options)
        assert same(one_by_one, forecast(scenario, embedded_wind, chunk=9, threads=2, **options))


def test_first_members_are_those_of_a_smaller_run(
    ensemble: Forecast, embedded_wind: dc.LocalGridBootstrap
) -> None:
    smaller = forecast(dc.paper.scenario(), embedded_wind, members=100)
    assert smaller.dataset.equals(ensemble.dataset.isel(member=slice(100)))


def test_seeds_differ(ensemble: Forecast, embedded_wind: dc.LocalGridBootstrap) -> None:
    other = forecast(dc.paper.scenario(), embedded_wind, members=9, seed=2)
    difference = values(other, "wind_velocity") - values(ensemble, "wind_velocity")[:9]
    assert (np.abs(difference).max(axis=(1, 2)) > 1).all()


def test_progress_counts_to_the_end(embedded_wind: dc.LocalGridBootstrap) -> None:
    calls: list[tuple[int, int]] = []
    forecast(
        dc.paper.scenario(),
        embedded_wind,
        members=7,
        chunk=3,
        progress=lambda done, members: calls.append((done, members)),
    )
    assert calls == [(3, 7), (6, 7), (7, 7)]


@pytest.fixture(scope="module")
def filed_wind(tmp_path_factory: pytest.TempPathFactory) -> dc.LocalGridBootstrap:
    """The wind of a file, short: fitted at once."""
    path = tmp_path_factory.mktemp("record") / "wind.csv"
    synthetic_record(3).to_csv(path)
    return dc.LocalGridBootstrap.fit(path)


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"model": "full", "seed": 2**63},
        {"model": "paper", "order": 0, "window": 0.013, "wind_terms": False},
        {"model": "mean-flow", "order": 2, "rtol": 1e-6, "keep": 2},
    ],
)
def test_the_configuration_repeats_the_run(
    how: dict[str, Any], filed_wind: dc.LocalGridBootstrap
) -> None:
    scenario = dc.paper.scenario(x=(1.1, 0.9), v=(0.3, -0.2), drag=1.5, coast=SQUARE)
    fc = forecast(scenario, filed_wind, members=4, **how)
    assert same(again(fc), fc)


def test_the_configuration_repeats_a_run_without_coast(
    embedded_wind: dc.LocalGridBootstrap,
) -> None:
    """Also on the embedded climate, which has a name instead of a file."""
    fc = forecast(dc.paper.scenario(coast=None), embedded_wind, members=2)
    assert "coast" not in fc.dataset.attrs
    assert fc.counts["afloat"] == 2
    assert same(again(fc), fc)


# Fates


def test_full_and_mean_flow_strand_alike(embedded_wind: dc.LocalGridBootstrap) -> None:
    scenario = dc.paper.scenario(epsilon=1 / 50)
    full = forecast(scenario, embedded_wind, members=800, model="full")
    averaged = forecast(scenario, embedded_wind, members=800, model="mean-flow", order=1)
    assert np.array_equal(values(full, "wind_velocity"), values(averaged, "wind_velocity"))
    assert (values(full, "status") != values(averaged, "status")).sum() <= 1
    later = np.abs(values(full, "stranding_time") - values(averaged, "stranding_time"))
    later = later[np.isfinite(later)]
    assert len(later) > 400
    assert (later <= 5e-4).mean() >= 0.97
    assert later.max() <= scenario.epsilon


@pytest.mark.parametrize(("side", "start"), [("inside", (1.0, 1.0)), ("outside", (0.7, 1.1))])
def test_polygons_strand_on_their_edges(
    side: Any, start: tuple[float, float], embedded_wind: dc.LocalGridBootstrap
) -> None:
    scenario = dc.paper.scenario(x=start, coast=SQUARE, side=side)
    fc = forecast(scenario, embedded_wind, members=40)
    place, position = values(fc, "stranding_position"), values(fc, "position")
    place = place[np.isfinite(place[:, 0])]
    assert len(place) >= 5
    assert np.abs(place - 1).max(axis=1) == pytest.approx(0.2, abs=1e-12)
    depth = np.abs(position[np.isfinite(position[..., 0])] - 1).max(axis=1)
    assert depth.max() <= 0.2 + 1e-12 if side == "inside" else depth.min() >= 0.2 - 1e-12


@pytest.mark.parametrize("side", ["inside", "outside"])
@pytest.mark.parametrize(
    ("coast", "start"),
    [(dc.Circle(radius=0.25), (1.25, 1.0)), (SQUARE, (1.2, 1.0)), (SQUARE, (1.2, 1.2))],
)
def test_a_release_on_the_coast_line_is_stranded_at_once(
    side: Any, coast: Any, start: tuple[float, float], embedded_wind: dc.LocalGridBootstrap
) -> None:
    fc = forecast(dc.paper.scenario(x=start, coast=coast, side=side), embedded_wind, members=3)
    assert fc.counts["stranded"] == 3
    assert values(fc, "stranding_time").tolist() == [0, 0, 0]
    assert values(fc, "stranding_position") == pytest.approx(np.array([start] * 3), abs=1e-15)
    assert np.isnan(values(fc, "position")[:, 1:]).all()


def uniform_sea() -> dc.HarmonicSea:
    """A tide that is the same everywhere on the square from -1 to 3."""
    axis = np.linspace(-1.0, 3.0, 6)
    amplitude = xr.DataArray(
        np.ones((1, 2, 6, 6), complex),
        {"harmonic": [1], "component": ["x", "y"], "y": axis, "x": axis},
    )
    return dc.HarmonicSea(amplitude)


@pytest.mark.parametrize("model", ["full", "paper", "mean-flow"])
def test_leaving_the_domain_is_a_fate(model: Any) -> None:
    scenario = dc.Scenario(sea=uniform_sea(), coast=None, velocity=(20.0, 0.0), epsilon=1 / 20)
    fc = forecast(scenario, [CALM, CALM], model=model)
    assert values(fc, "status").tolist() == [LEFT_DOMAIN, LEFT_DOMAIN]
    assert fc.followed == 2
    assert fc.stranding_probability().estimate == 0
    position = values(fc, "position")
    position = position[np.isfinite(position[..., 0])]
    assert len(position) > 2
    assert position[:, 0].max() <= 3.0 + 1e-9


def test_failed_members_are_told_and_not_counted() -> None:
    """A wind that no step size follows spoils its own member only."""
    east = dc.WindPath([0.0, 1.1], [[2.0, 0.0], [2.0, 0.0]])
    absurd = dc.WindPath([-1.0, 2.0], [[1e300, 0.0], [1e300, 0.0]])
    with pytest.warns(DriftCoreWarning, match="1 of 3 members failed; member 1: ") as caught:
        fc = forecast(dc.paper.scenario(), [east, absurd, CALM], model="full")
    assert caught[0].filename == __file__
    assert values(fc, "status").tolist() == [STRANDED, FAILED, AFLOAT]
    assert np.isnan(values(fc, "position")[1]).all()
    p = fc.stranding_probability()
    assert (p.count, p.members) == (1, 2)
    assert fc.stranding_by_sector(4)["probability"].values.tolist() == [0, 0.5, 0, 0]
    assert "0.500" in repr(fc)


def test_all_failed_has_no_probability() -> None:
    with pytest.warns(DriftCoreWarning, match="1 of 1 members failed"):
        fc = forecast(dc.paper.scenario(v=(1e300, 0.0)), [CALM])
    assert fc.followed == 0
    assert "unknown" in repr(fc)
    with pytest.raises(ValueError, match="no member could be followed"):
        fc.stranding_probability()


def test_a_run_beyond_the_season_is_told(embedded_wind: dc.LocalGridBootstrap) -> None:
    with pytest.warns(DriftCoreWarning, match="lasts 104 days, the months chosen 92"):
        forecast(dc.paper.scenario(1 / 200), embedded_wind, members=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        forecast(dc.paper.scenario(1 / 176), embedded_wind, members=1)


# Given winds


def test_given_paths_are_followed_one_member_each(embedded_wind: dc.LocalGridBootstrap) -> None:
    scenario = dc.paper.scenario()
    paths = [dc.member_path(scenario, embedded_wind, k) for k in range(4)]
    drawn = forecast(scenario, embedded_wind, members=4, model="full")
    given = forecast(scenario, paths, model="full")
    for name in ("status", "stranding_time", "stranding_position", "position"):
        # Drawn winds step together, given ones each for themselves: errors of 1e-8, more in time
        # where the coast is grazed.
        np.testing.assert_allclose(values(given, name), values(drawn, name), atol=1e-6)
    assert given.dataset.attrs["wind_synthetic"] == 0
    assert "4 wind paths" in given.dataset.attrs["wind_label"]


# Refusals

TRAJECTORIES: dict[str, tuple[dict[str, Any], str]] = {
    "model": ({"model": "ful"}, "model: 'ful' is not accepted; one of full, paper, mean-flow"),
    "order": ({"model": "mean-flow", "order": 3}, "order: 3 is not accepted"),
    "order 0": ({"model": "mean-flow", "order": 0}, "order: 0 is not accepted for model"),
    "order of none": ({"order": 1}, "model 'full'; it is exact and has no order"),
    "window of none": ({"window": 0.01}, "window: model 'full' has none"),
    "window": ({"model": "paper", "window": 0.0}, "window: 0.0 is not accepted"),
    "window NaN": ({"model": "paper", "window": np.nan}, "window: nan is not accepted"),
    "wide window": ({"model": "paper", "window": 5.0}, r"wind path: covers \[-1, 2\], but"),
    "rtol": ({"rtol": -1.0}, "rtol: -1.0 is not accepted"),
    "atol": ({"atol": 0.0}, "atol: 0.0 is not accepted"),
    "formulation": ({"formulation": "C"}, "formulation: 'C' is not accepted"),
    "no times": ({"times": []}, "times: must be one finite number or a list"),
    "times NaN": ({"times": [0, np.nan]}, "times: must be one finite number or a list"),
    "times back": ({"times": [1.0, 0.0]}, "times: must increase"),
    "times beyond": ({"times": [0.0, 2.0]}, r"times: \[0, 2\] is not accepted; the run covers"),
    "short path": ({"path": dc.WindPath([0, 0.5], np.zeros((2, 2)))}, r"covers \[0, 0.5\], but"),
    "late path": ({"path": dc.WindPath([0.1, 2], np.zeros((2, 2)))}, r"needs \[0, 1\]"),
    "ashore": ({"scenario": dc.paper.scenario(x=(5, 5))}, r"position: \(5, 5\) lies outside the"),
}


@pytest.mark.parametrize(("how", "message"), TRAJECTORIES.values(), ids=TRAJECTORIES.keys())
def test_refused_trajectories(how: dict[str, Any], message: str) -> None:
    accepted: dict[str, Any] = {
        "scenario": dc.paper.scenario(),
        "path": CALM,
        "model": "full",
        "times": [0.0, 1.0],
    }
    with pytest.raises(ScenarioError, match=message):
        trajectory(**{**accepted, **how})


FORECASTS: dict[str, tuple[dict[str, Any], str]] = {
    "members": ({"members": 0}, "members: 0 is not accepted"),
    "negative members": ({"members": -1}, "members: -1 is not accepted"),
    "half a member": ({"members": 2.5}, "members: 2.5 is not accepted"),
    "members in words": ({"members": "2"}, "members: '2' is not accepted"),
    "endless members": ({"members": 10**30}, "members: 10+ is not accepted"),
    "seed": ({"seed": -1}, "seed: -1 is not accepted"),
    "large seed": ({"seed": 2**64}, "seed: 18446744073709551616 is not accepted"),
    "keep": ({"keep": -1}, "keep: -1 is not accepted"),
    "chunk": ({"chunk": 0}, "chunk: 0 is not accepted"),
    "threads": ({"threads": 0}, "threads: 0 is not accepted"),
    "rtol": ({"rtol": 0.5}, "rtol: 0.5 is not accepted"),
    "wind terms": ({"wind_terms": "no"}, "wind_terms: 'no' is not accepted"),
    "wide window": ({"model": "paper", "window": 0.2}, r"windows up to 0.08 \(4 tides\)"),
    "wind": ({"wind": "wind.csv"}, "wind: str is not accepted; a fitted LocalGridBootstrap"),
    "no winds": ({"wind": []}, "wind: the list of paths is empty"),
    "short wind": ({"wind": [dc.WindPath([0, 0.5], np.zeros((2, 2)))]}, "wind: path 0 covers"),
    "more winds": ({"wind": [CALM], "members": 2}, "members: 2 is not accepted; 1 paths"),
    "outside": ({"scenario": dc.paper.scenario(side="outside")}, "lies within the coast line"),
}


@pytest.mark.parametrize(("how", "message"), FORECASTS.values(), ids=FORECASTS.keys())
def test_refused_forecasts(
    how: dict[str, Any], message: str, embedded_wind: dc.LocalGridBootstrap
) -> None:
    accepted: dict[str, Any] = {"scenario": dc.paper.scenario(), "wind": embedded_wind}
    with pytest.raises(ScenarioError, match=message):
        forecast(**{**accepted, **how})


def test_widest_window_that_is_accepted(embedded_wind: dc.LocalGridBootstrap) -> None:
    fc = forecast(dc.paper.scenario(), embedded_wind, members=1, model="paper", window=0.08)
    assert fc.counts["failed"] == 0


def test_refused_sectors(ensemble: Forecast) -> None:
    with pytest.raises(ScenarioError, match="sectors: 0 is not accepted"):
        ensemble.stranding_by_sector(0)
