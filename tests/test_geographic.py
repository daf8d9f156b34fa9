"""Forecasts on the sphere: distances, the date line, releases, refusals, and averaged against full.

The sphere has the mean radius of the earth. Distances on it differ from those on WGS84 by up to
0.56 % (a degree of latitude at the equator), which no drift is known to.
"""

from __future__ import annotations

import datetime
import math
from typing import Any, Literal

import numpy as np
import pandas as pd
import pyproj
import pytest
import shapely
import xarray as xr

import driftcore as dc
from driftcore.currents import Current
from driftcore.errors import DriftCoreWarning, ScenarioError
from driftcore.geographic import Scaling
from reference import Floats

RADIUS = 6_371_008.8
SPHERE, WGS84 = pyproj.Geod(a=RADIUS, b=RADIUS), pyproj.Geod(ellps="WGS84")
RELEASED = "2026-07-01T06:00"
START = np.datetime64(RELEASED, "ns")
DAY, HOUR = np.timedelta64(1, "D"), np.timedelta64(1, "h")
WATER = dc.FloatingBody(response_time_h=0, wind_factor=0)
LIGHT = dc.FloatingBody(response_time_h=0, wind_factor=0.03)
Model = Literal["full", "mean-flow"]
# What averaging takes for small is not small in runs as short as those of most tests here.
pytestmark = pytest.mark.filterwarnings("ignore:averaging takes for small")


def current(longitude: Floats, latitude: Floats, u: Any, v: Any, times: Any = (START,)) -> Current:
    """A current of one velocity, or of one at each time."""
    shape = (len(times), len(latitude), len(longitude))
    u, v = (np.broadcast_to(np.reshape(w, (-1, 1, 1)), shape).copy() for w in (u, v))
    stamps = np.array(times, dtype="datetime64[ns]")
    sea = np.zeros(shape[1:], dtype=bool)
    return Current(stamps, longitude, latitude, u, v, "given", "current", land=sea)


def around(middle: float, width: float = 10.0, points: int = 41) -> Floats:
    return np.linspace(middle - width, middle + width, points)


def steady(
    wind: tuple[float, float], days: float = 100, start: np.datetime64 = START
) -> dc.WindPath:
    return dc.WindPath([start - DAY, start + np.timedelta64(round(days * 24), "h")], [wind, wind])


def hourly(days: float) -> np.ndarray[Any, np.dtype[np.datetime64]]:
    return START + np.arange(round(days * 24) + 1) * HOUR


# Metric


@pytest.mark.parametrize("latitude", [-60.0, 0.0, 45.0, 70.0, 85.0])
@pytest.mark.parametrize("toward", ["east", "north"])
@pytest.mark.parametrize("by", ["wind", "current"])
def test_a_day_s_way_is_that_of_pyproj(latitude: float, toward: str, by: str) -> None:
    velocity = (0.5, 0.0) if toward == "east" else (0.0, 0.5)
    release = dc.Release.point(10.0, latitude, RELEASED)
    if by == "wind":
        paper = dc.FloatingBody(response_time_h=0, wind_factor=1)
        scenario, wind = dc.GeographicScenario(release, 1, paper), steady(velocity)
    else:
        grid = current(around(10, 6), around(latitude, 3, 61), *velocity)
        scenario, wind = dc.GeographicScenario(release, 1, WATER, current=grid), steady((0, 0))
    path = dc.trajectory(scenario, wind, model="full", times=hourly(1), rtol=1e-10)
    longitude, at = path["longitude"].values, path["latitude"].values
    seconds = np.arange(25) * 3600.0
    bearing, _, step = SPHERE.inv(longitude[:-1], at[:-1], longitude[1:], at[1:])
    assert np.cumsum(step) == pytest.approx(0.5 * seconds[1:], rel=1e-6)
    # A parallel is no geodesic: in an hour it bends by its share of a degree.
    bend = np.ptp(longitude) / 24 + 1e-4
    assert (
        np.abs((np.asarray(bearing) + 180) % 360 - 180 - (90 if toward == "east" else 0)).max()
        < bend
    )
    velocities = path[["eastward_velocity", "northward_velocity"]].to_array().values
    assert velocities == pytest.approx(np.tile(velocity, (25, 1)).T, abs=1e-6)
    on_wgs84 = WGS84.line_length(longitude, at)
    assert on_wgs84 == pytest.approx(0.5 * 86_400, rel=0.0057)
    assert abs(on_wgs84 / (0.5 * 86_400) - 1) > 1e-4


def test_a_run_at_70_north_follows_the_rhumb_line() -> None:
    u, v, days = 0.6, -0.3, 10
    grid = current(around(-5, 20, 81), around(70, 8, 161), u, v)
    release = dc.Release.point(-5, 70, RELEASED)
    scenario = dc.GeographicScenario(release, days, WATER, current=grid)
    path = dc.trajectory(scenario, steady((0, 0)), model="full", times=hourly(days), rtol=1e-10)
    latitude = math.radians(70) + v * np.arange(days * 24 + 1) * 3600 / RADIUS
    mercator = np.arctanh(np.sin(latitude)) - math.atanh(math.sin(math.radians(70)))
    assert path["latitude"].values == pytest.approx(np.degrees(latitude), abs=1e-8)
    assert path["longitude"].values == pytest.approx(-5 + np.degrees(u / v * mercator), abs=1e-6)


def at_longitude(middle: float, model: Model) -> dc.GeographicForecast:
    """A drift toward east through an island's waters, with maps and a target, at any longitude."""

    def turned(longitude: Any) -> Any:
        return (np.asarray(longitude, dtype=float) + middle + 180) % 360 - 180

    island = shapely.Polygon(
        [(middle + x, y) for x, y in [(0.6, -0.1), (0.9, -0.1), (0.9, 0.05), (0.6, 0.05)]]
    )
    releases = dc.Releases(
        [
            dc.Release.disc(float(turned(-0.05)), 0.0, 8000, RELEASED),
            dc.Release.point(float(turned(0.1)), 0.0, (RELEASED, "2026-07-02T06:00")),
        ]
    )
    scenario = dc.GeographicScenario(
        releases, 6, LIGHT,
        tides=dc.tides.kelvin_wave(
            around(middle, 4), around(0, 4), depth=50, origin=(middle + 5, 20)
        ),
        current=current(around(middle, 4), around(0, 4), 0.15, 0.0),
        coast=dc.LandCoast.from_geometries(island),
    )  # fmt: skip
    grid = dc.MapGrid(
        x=np.linspace(-1, 2, 13) + middle, y=np.linspace(-1, 1, 9), times=(0.5, 2, 4, 6)
    )
    ring = np.column_stack([turned([0.4, 0.5, 0.5, 0.4]), [-0.5, -0.5, 0.5, 0.5]])
    # Their own wind for each, so that one path does not stand for all.
    winds = [steady((x, y)) for x, y in np.random.default_rng(2).normal(0, 2, (60, 2))]
    return dc.forecast(
        scenario, winds, model=model, maps=grid, targets={"strip": ring}, threads=2, rtol=1e-9
    )


@pytest.mark.parametrize("model", ["full", "mean-flow"])
def test_the_date_line_is_a_longitude_like_others(model: Model) -> None:
    here, there = (at_longitude(middle, model).dataset for middle in (0.0, 180.0))
    assert (here["status"] == there["status"]).all()
    stranded = here["status"].values == 1
    assert 5 < stranded.sum() < 55
    for name in ("longitude", "stranding_longitude", "release_longitude"):
        shift = (there[name].values - here[name].values) % 360
        assert np.nanmax(np.abs(shift - 180)) < 1e-6
        values = there[name].values[np.isfinite(there[name].values)]
        assert values.min() >= -180
        assert values.max() < 180
    assert (there["longitude"].values > 179).any()
    assert (there["longitude"].values < -179).any()
    for name in ("presence", "arrival", "visit", "outside", "ashore"):
        assert np.array_equal(here[name].values, there[name].values)
    gap = (here["entry_time"] - there["entry_time"]).values
    assert np.array_equal(np.isnat(here["entry_time"].values), np.isnat(there["entry_time"].values))
    assert np.abs(gap[~np.isnat(gap)]).max() < np.timedelta64(1, "s")
    assert (~np.isnat(gap)).sum() > 20


# Releases


def test_nobody_is_adrift_before_the_release() -> None:
    window = (RELEASED, "2026-07-04T06:00")
    releases = dc.Releases(
        [dc.Release.point(-5, 46, window), dc.Release.disc(-7, 45, 2000, "2026-07-02T12:00")],
        [2, 1],
    )
    scenario = dc.GeographicScenario(releases, 6, LIGHT, tides=dc.tides.biscay())
    forecast = dc.forecast(scenario, [steady((3, 1))] * 60, model="full").dataset
    times, released = forecast["time"].values, forecast["release_time"].values
    assert times[0] == START
    adrift = times[None, :] >= released[:, None]
    for name in ("longitude", "latitude"):
        assert np.array_equal(np.isfinite(forecast[name].values), adrift)
    second = np.abs(forecast["release_longitude"].values + 7) < 1
    assert abs(second.sum() - 20) <= 1
    assert (released[second] == np.datetime64("2026-07-02T12:00")).all()
    assert (released[~second] >= START).all()
    assert np.ptp(released[~second]) > np.timedelta64(2, "D")
    # 3-hourly output: the first position is within three hours of the release.
    first = adrift.argmax(axis=1)
    row = np.arange(60)
    _, _, metres = SPHERE.inv(
        forecast["release_longitude"].values, forecast["release_latitude"].values,
        forecast["longitude"].values[row, first], forecast["latitude"].values[row, first],
    )  # fmt: skip
    seconds = (times[first] - released) / np.timedelta64(1, "s")
    assert (np.asarray(metres) <= 0.6 * seconds + 1e-3).all()
    assert np.asarray(metres).max() > 100


def biscay(days: float = 20, **options: Any) -> dc.GeographicScenario:
    return dc.GeographicScenario(
        **{
            "release": dc.Release.disc(-4.1, 47.2, 1000, RELEASED),
            "days": days,
            "drifter": dc.objects.leeway("PIW-1"),
            "tides": dc.tides.biscay(),
            "coast": dc.LandCoast.default(),
            **options,
        }
    )


@pytest.mark.parametrize("model", ["full", "mean-flow"])
def test_members_do_not_depend_on_how_many_follow_or_on_whom(
    embedded_wind: dc.LocalGridBootstrap, model: Model
) -> None:
    def run(members: int, **options: Any) -> xr.Dataset:
        return dc.forecast(
            biscay(4), embedded_wind, members=members, model=model, seed=7, **options
        ).dataset

    whole = run(150, threads=2, chunk=64)
    assert whole.equals(run(150, threads=1, chunk=150))
    part = run(100, threads=1, chunk=33)
    assert whole.isel(member=slice(100)).equals(part)
    few = run(150, threads=2, keep=20)
    for name in ("longitude", "latitude"):
        assert np.array_equal(few[name].values, whole[name].values[:20])
    assert few["status"].equals(whole["status"])


def test_maps_and_targets_add_up(embedded_wind: dc.LocalGridBootstrap) -> None:
    maps = dc.MapGrid(
        x=np.arange(-8, -0.9, 0.5), y=np.arange(43.5, 49.1, 0.5), times=(1, 5, 10, 20)
    )
    strip = shapely.box(-4.6, 46.0, -3.0, 46.9)
    hours = START + np.arange(0, 20 * 24 + 1) * HOUR
    forecast = dc.forecast(
        biscay(20, drifter=LIGHT), embedded_wind, members=300, maps=maps, times=hours,
        targets={"strip": strip},
    )  # fmt: skip
    dataset = forecast.dataset
    status, when = dataset["status"].values, dataset["stranding_time"].values
    assert 20 < (status == 1).sum() < 280
    presence = dataset["presence"].values * 300
    longitude, latitude = dataset["longitude"].values, dataset["latitude"].values
    for k, day in enumerate(maps.times):
        at = int(day * 24)
        counts, *_ = np.histogram2d(latitude[:, at], longitude[:, at], [maps.y, maps.x])
        assert np.array_equal(np.round(presence[k]), counts)
        outside = int(np.round(dataset["outside"].values[k] * 300))
        ashore = int((when <= START + np.timedelta64(int(day * 24), "h")).sum())
        left = int(np.isnan(longitude[:, at]).sum()) - ashore
        assert presence[k].sum() + outside + ashore + left == pytest.approx(300)
        assert round(dataset["ashore"].values[k] * 300) == ashore
    assert (dataset["map_time"].values == START + np.array([1, 5, 10, 20]) * DAY).all()
    for name, edges in (("map_longitude", maps.x), ("map_latitude", maps.y)):
        bounds = dataset[dataset[name].attrs["bounds"]].values
        assert np.array_equal(bounds, np.column_stack([edges[:-1], edges[1:]]))
        assert dataset[name].values == pytest.approx(bounds.mean(axis=1))
    assert (dataset["map_time_bounds"].values[1] == START + np.array([1, 5]) * DAY).all()

    inside = shapely.contains_xy(strip, longitude, latitude)
    entered = dataset["entry_time"].values[:, 0]
    seen = inside.any(axis=1)
    assert 30 < seen.sum() < 300
    assert (~np.isnat(entered[seen])).all()
    late = hours[inside.argmax(axis=1)] - entered
    assert (late[seen] >= -np.timedelta64(1, "s")).all()
    # Tides carry some in and out between two hours; none is seen later than its entry by a day.
    assert np.median(late[seen]) < HOUR
    probability = forecast.entry_probability("strip")
    assert probability.estimate == (~np.isnat(entered)).mean()
    half = START + 10 * DAY
    assert forecast.entry_probability("strip", half).estimate == (entered <= half).mean()
    assert forecast.stranding_probability(half).estimate == (when <= half).mean()


def test_leaving_the_data_is_a_status() -> None:
    grid = current(around(0, 1), around(0, 1), 0.5, 0.0)
    scenario = dc.GeographicScenario(dc.Release.point(0, 0, RELEASED), 5, WATER, current=grid)
    forecast = dc.forecast(scenario, [steady((0, 0))], model="full", times=hourly(5))
    assert forecast.counts["left_domain"] == 1
    # 111.2 km at 0.5 m/s are 61.8 hours; the last step before the edge may be an hour or two long.
    afloat = np.isfinite(forecast.dataset["longitude"].values[0]).sum()
    assert 59 <= afloat <= 62
    pole = dc.GeographicScenario(dc.Release.point(0, 88.9, RELEASED), 5, LIGHT)
    assert dc.forecast(pole, [steady((0, 20))], model="full").counts["left_domain"] == 1


def test_a_trajectory_that_leaves_the_data_is_an_error() -> None:
    still = current(around(0, 1), around(0, 1), [0.0], [0.0])
    scenario = dc.GeographicScenario(
        dc.Release.point(0.5, 0, RELEASED), 5, LIGHT, current=still.mean()
    )
    with pytest.raises(dc.DriftCoreError, match=r"lies outside the domain of the sea field"):
        dc.trajectory(scenario, steady((20, 0)), model="full", times=hourly(5))


def test_a_trajectory_that_cannot_be_so_exact_is_an_error() -> None:
    with pytest.raises(dc.DriftCoreError, match=r"integration failed at t = .*: "):
        dc.trajectory(
            biscay(5), steady((20, 0)), model="full", times=hourly(5), rtol=1e-300, atol=1e-300
        )


# Times


def test_a_trajectory_begins_with_its_release() -> None:
    """The first member is set adrift at a time of its own."""
    release = dc.Release.point(-5, 46, (START, START + DAY))
    scenario = dc.GeographicScenario(release, 2, LIGHT)
    own = dc.forecast(scenario, [steady((3, 1))]).dataset["release_time"].values[0]
    assert START < own < START + DAY
    with pytest.raises(ScenarioError, match="the release is at"):
        dc.trajectory(scenario, steady((3, 1)), model="full", times=[START])
    path = dc.trajectory(scenario, steady((3, 1)), model="full", times=[own, own + HOUR])
    assert float(path["longitude"][0]) == pytest.approx(-5)
    assert float(path["longitude"][1]) > -5


def test_times_with_a_zone_are_converted() -> None:
    zone = datetime.timezone(datetime.timedelta(hours=2))
    local = datetime.datetime(2026, 7, 1, 8, tzinfo=zone)
    scenario = dc.GeographicScenario(dc.Release.point(-5, 46, local), 2, LIGHT)
    assert scenario.start == START
    for times in (
        [local, local + datetime.timedelta(days=1)],
        pd.DatetimeIndex([local, local + datetime.timedelta(days=1)]),
        ["2026-07-01T08:00+02:00", "2026-07-02T06:00Z"],
        np.array([START, START + DAY]),
    ):
        forecast = dc.forecast(scenario, [steady((3, 1))], times=times)
        assert (forecast.dataset["time"].values == [START, START + DAY]).all()
        path = dc.trajectory(scenario, steady((3, 1)), model="full", times=times)
        assert (path["time"].values == [START, START + DAY]).all()
    assert forecast.stranding_probability(local).estimate == 0


def test_the_wind_has_its_time_of_the_day(embedded_wind: dc.LocalGridBootstrap) -> None:
    """A release at 06 UTC drifts with the mean wind of 06 UTC, and at 18 UTC with that of 18."""
    members, days, share = 400, 20, 0.03
    scenario = dc.GeographicScenario(dc.Release.point(-20, 10, RELEASED), days, LIGHT)
    times = START + np.arange(0, days * 24 + 1, 6) * HOUR
    forecast = dc.forecast(scenario, embedded_wind, members=members, times=times, seed=3).dataset
    latitude = np.radians(forecast["latitude"].values)
    north = np.diff(latitude, axis=1) * RADIUS
    east = np.diff(np.radians(forecast["longitude"].values), axis=1) * RADIUS
    east *= np.cos(0.5 * (latitude[:, 1:] + latitude[:, :-1]))
    found = np.stack([east, north], axis=-1) / (share * 6 * 3600)
    record = embedded_wind.record
    hour = ((record.times - record.times.astype("datetime64[D]")) / HOUR).astype(int)
    cycle = np.array([record.velocity[hour == h].mean(axis=0) for h in (0, 6, 12, 18)])
    # From 06 to 12, from 12 to 18, ...: the wind is linear between.
    legs = np.array([(cycle[(k + 1) % 4] + cycle[(k + 2) % 4]) / 2 for k in range(4)])
    by_leg = found.reshape(members, days, 4, 2).mean(axis=(0, 1))
    assert np.ptp(legs[:, 0]) > 1
    # The mean over the day varies with the weather, how it goes over the day does not.
    assert by_leg - by_leg.mean(axis=0) == pytest.approx(legs - legs.mean(axis=0), abs=0.15)
    assert by_leg.mean(axis=0) == pytest.approx(legs.mean(axis=0), abs=0.35)


# Refusals and warnings


def test_a_release_on_land_is_refused_with_the_distance() -> None:
    with pytest.raises(ScenarioError, match=r"lies on land, \d+\.\d km from the sea toward"):
        biscay(release=dc.Release.point(-1.5, 48.1, RELEASED))


def test_a_release_after_the_end_is_refused() -> None:
    """The run lasts from the earliest release; one an hour before its end may be later by law."""
    release = dc.Release.point(-5, 46, (START, START + 2 * DAY), time_error_h=12)
    scenario = biscay(2.1, release=release)
    with pytest.raises(ScenarioError, match=r"release: one is at 2026-07-03.*, after the end"):
        dc.forecast(scenario, [steady((0, 0))] * 500, model="full")


def test_what_is_not_small_is_said() -> None:
    scaling = Scaling(
        epsilon=0.01, tide=0.5, residual=0.2, excursion_km=4.0, steepness=0.1, unit_length_km=500
    )
    assert scaling.problems() == []
    steep = scaling._replace(steepness=1.5).problems()
    assert steep == ["the tidal current changes by 150% over its own excursion of 4.0 km"]
    fast = scaling._replace(residual=0.7).problems()
    assert fast == ["the residual current (0.7 m/s) exceeds the tide (0.5 m/s)"]
    few = scaling._replace(epsilon=0.5).problems()
    assert few == ["epsilon = 0.5 (a tide over the run)"]
    # Where there is no tide nothing is averaged.
    assert scaling._replace(tide=0.0, epsilon=0.5, residual=0.7).problems() == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"release": dc.Release.point(3, 47, RELEASED), "coast": None}, "lies outside the data"),
        ({"days": 0}, "days: 0 is not accepted"),
        ({"days": math.nan}, "days: nan is not accepted"),
        ({"drifter": "PIW-1"}, "drifter: str is not accepted"),
        ({"wind_current": (1.5, 0)}, "wind_current"),
    ],
)
def test_bad_scenarios_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        biscay(**options)


def test_a_current_must_cover_the_run_and_no_more() -> None:
    release = dc.Release.point(0, 0, RELEASED)
    grid = (around(0, 3), around(0, 3), [0.1] * 21, [0.0] * 21)

    def scenario(first: str, **options: Any) -> dc.GeographicScenario:
        times = np.datetime64(first) + np.arange(21) * 6 * HOUR
        given = current(*grid, times=times)
        return dc.GeographicScenario(
            **{"release": release, "days": 5, "drifter": WATER, "current": given, **options}
        )

    assert scenario(RELEASED).end == START + 5 * DAY
    for first in ("2026-07-01T07:00", "2026-07-01T05:00"):
        with pytest.raises(ScenarioError, match=r"current: it covers .* give current\.mean"):
            scenario(first)
    uncertain = dc.Release.point(0, 0, RELEASED, time_error_h=1)
    with pytest.raises(ScenarioError, match="the run needs 2026-07-01T00:00"):
        scenario(RELEASED, release=uncertain)
    steady_current = current(*grid, times=START + np.arange(21) * HOUR).mean()
    dc.GeographicScenario(release, 5, WATER, current=steady_current)


@pytest.mark.parametrize(
    ("wind", "options", "message"),
    [
        (None, {}, "wind: is missing"),
        ([], {}, "wind: list is not accepted"),
        ("record.csv", {}, "wind: str is not accepted"),
        ([dc.WindPath([0, 30], np.zeros((2, 2)))], {}, "needs datetime64"),
        ([steady((0, 0), 10)], {}, "path: it covers .* the run needs"),
        ([steady((0, 0), 30, START + 2 * DAY)], {}, "path: it covers .* the run needs"),
        ([steady((0, 0))], {"members": 2}, "members: 2 is not accepted; 1 paths were given"),
        ([steady((0, 0))], {"order": 2}, "'mean-flow' of order 2 is not accepted"),
        ([steady((0, 0))], {"model": "paper"}, "'paper' of order 1 is not accepted"),
        ([steady((0, 0))], {"times": [START - DAY]}, "times: .* the run covers"),
        ([steady((0, 0))], {"times": [0.5]}, "times: must be UTC"),
        ([steady((0, 0))], {"times": [START + DAY, START]}, "times: must increase"),
        ([steady((0, 0))], {"targets": {"a": [[0, 0, 0]]}}, "targets.a"),
        ([steady((0, 0))], {"window": 0.1}, "window: 0.1 is not accepted on a geographic sce"),
        ([steady((0, 0))], {"wind_terms": False}, 'wind_terms: only the model "paper" has them'),
        ([steady((0, 0))], {"first_member": 1}, "first_member: 1 is not accepted; 1 paths were"),
        ([steady((0, 0))], {"threads": 1025}, "threads: 1025 is not accepted; at most 1024"),
        (
            [steady((0, 0))],
            {"maps": dc.MapGrid(x=(-6, -5), y=(45, 46), times=(1000.0,))},
            "maps.times: 1000.* is not accepted",
        ),
    ],
)
def test_bad_runs_are_refused_before_any_work(
    wind: Any, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        dc.forecast(biscay(), wind, **options)


def test_what_is_followed_is_a_scenario_under_a_wind() -> None:
    with pytest.raises(ScenarioError, match="scenario: str is not accepted; a Scenario or Geogr"):
        dc.forecast("biscay", [steady((0, 0))])  # type: ignore[call-overload]
    with pytest.raises(ScenarioError, match="path: list is not accepted; give a WindPath"):
        dc.trajectory(biscay(), [1.0], model="full", times=[START])  # type: ignore[arg-type]


def test_a_time_that_is_none_is_refused() -> None:
    forecast = dc.forecast(biscay(1), [steady((0, 0))], model="full")
    for by in ("soon", 5, "NaT"):
        with pytest.raises(ScenarioError, match="by: must be UTC times"):
            forecast.stranding_probability(by)


def test_an_unknown_object_names_the_nearest() -> None:
    with pytest.raises(ScenarioError, match="did you mean PIW-1 "):
        dc.objects.leeway("PIW1")


def test_a_wind_of_another_season_is_warned_of(embedded_wind: dc.LocalGridBootstrap) -> None:
    winter = biscay(2, release=dc.Release.point(-5, 46, "2026-01-10T06:00"))
    with pytest.warns(
        DriftCoreWarning, match=r"starts in month 1, .* resampled from months 6, 7, 8"
    ):
        dc.forecast(winter, embedded_wind, members=2, model="full")


# Averaged against full

BODIES: dict[str, dc.FloatingBody | dc.Leeway] = {
    "at-once": LIGHT,
    "6-hours": dc.FloatingBody(response_time_h=6, wind_factor=0.03),
    "10-days": dc.FloatingBody(response_time_h=240, wind_factor=0.03),
    "person": dc.objects.leeway("PIW-1"),
    "container": dc.objects.leeway("CONTAINER-2"),
}


@pytest.mark.parametrize("name", BODIES)
def test_averaging_changes_a_bay_of_biscay_drift_by_less_than_its_order(
    embedded_wind: dc.LocalGridBootstrap, name: str
) -> None:
    scenario = biscay(60, drifter=BODIES[name])
    averaged, full = (
        dc.forecast(scenario, embedded_wind, members=100, model=model, seed=2).dataset
        for model in ("mean-flow", "full")
    )
    assert scenario.scaling.epsilon == pytest.approx(1 / 116, rel=0.01)
    unit_km = scenario.scaling.epsilon**2 * scenario.scaling.unit_length_km
    assert unit_km == pytest.approx(0.145, rel=0.01)
    _, _, metres = SPHERE.inv(
        *(d[name].values for d in (averaged, full) for name in ("longitude", "latitude"))
    )
    largest = np.nanmax(np.asarray(metres), axis=1) / 1000
    # The leeway of a light wind is no linear function of it, and the coarse wind of the averaged
    # model lacks what is faster than 6 h: on the same fine winds all errors are below 0.8 km.
    median, most = (1.2, 4) if isinstance(scenario.drifter, dc.FloatingBody) else (5, 20)
    assert np.median(largest) < median * unit_km
    assert largest.max() < most * unit_km
    assert (averaged["status"].values == full["status"].values).mean() >= 0.99
    ashore = (averaged["status"].values == 1) & (full["status"].values == 1)
    assert 20 < ashore.sum() < 95
    apart = np.abs((averaged["stranding_time"] - full["stranding_time"]).values[ashore]) / HOUR
    assert np.median(apart) < 1


def test_times_beyond_nanoseconds() -> None:
    far = np.datetime64("2300-01-01", "us")
    with pytest.raises(dc.ScenarioError, match="times: 2300-01-01 is not accepted"):
        dc.WindPath([START.astype("datetime64[us]"), far], [(0, 0), (1, 0)])
    release = dc.Release(coordinates=(-5, 48.5), start="2300-01-01T00:00Z")
    with pytest.raises(dc.ScenarioError, match="release: 2300-01-01 is not accepted"):
        dc.GeographicScenario(release, 10, WATER)
    release = dc.Release(coordinates=(-5, 48.5), start="2261-12-01T00:00Z")
    with pytest.raises(dc.ScenarioError, match="days: 2262-01-10 is not accepted"):
        dc.GeographicScenario(release, 40, WATER)
