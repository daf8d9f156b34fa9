"""Winds of the real sea: on a grid and drawn by patterns, against paths, SciPy and each other."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline

import driftcore as dc
from driftcore.grids import VectorGrid
from test_wind_fields import LAT, LON, weather

_GRID = Path(__file__).parents[2] / "shared/data/grid"
_HOUR = np.timedelta64(1, "h")


def scenario(days: float = 5.0, **changes: object) -> dc.GeographicScenario:
    values: dict[str, object] = {
        "release": dc.Release.point(-4.1, 47.5, "2026-07-01T06:00"),
        "days": days,
        "drifter": dc.FloatingBody(response_time_h=0.0, wind_factor=0.03),
        **changes,
    }
    return dc.GeographicScenario(**values)  # type: ignore[arg-type]


def blowing(hours: int = 240, step_h: int = 6) -> VectorGrid:
    """A wind that turns with time and is linear in longitude and latitude."""
    times = np.datetime64("2026-06-30", "ns") + np.arange(0, hours + 1, step_h) * _HOUR
    longitude, latitude = np.linspace(-8, 0, 9), np.linspace(44, 51, 8)
    turn = 0.1 * np.arange(len(times))[:, None, None]
    x, y = np.meshgrid(longitude + 4, latitude - 47)
    u, v = 6 * np.cos(turn) + 0.5 * x + 0 * y, 4 * np.sin(turn) - 0.3 * y + 0 * x
    return VectorGrid(times, longitude, latitude, u, v, "made", "wind")


def test_uniform_wind_on_a_grid_is_a_path() -> None:
    grid = blowing()
    uniform = dataclasses.replace(grid, u=0 * grid.u + grid.u[:, :1, :1], v=0 * grid.v + 3.0)
    path = dc.WindPath(grid.times, np.column_stack([uniform.u[:, 0, 0], uniform.v[:, 0, 0]]))
    times = scenario().start + np.arange(0, 121, 12) * _HOUR
    for model in ("full", "mean-flow"):
        by_grid, by_path = (
            dc.trajectory(scenario(), wind, model=model, times=times)  # type: ignore[arg-type]
            for wind in (uniform, path)
        )
        np.testing.assert_allclose(by_grid["longitude"], by_path["longitude"], atol=1e-10)
        np.testing.assert_allclose(by_grid["latitude"], by_path["latitude"], atol=1e-10)


def test_wind_that_varies_in_space_moves_as_scipy_says() -> None:
    grid, run = blowing(), scenario()
    days = run.since_origin(grid.times)
    rate = np.degrees(86_400 / 6_371_008.8)

    def rates(t: float, x: np.ndarray) -> list[float]:
        turn = 0.1 * (t - days[0]) / 0.25
        # Linear in time between the knots, which the cosine is not.
        k = int(np.clip((t - days[0]) // 0.25, 0, len(days) - 2))
        share = turn / 0.1 - k
        cos = (1 - share) * np.cos(0.1 * k) + share * np.cos(0.1 * (k + 1))
        sin = (1 - share) * np.sin(0.1 * k) + share * np.sin(0.1 * (k + 1))
        u, v = 6 * cos + 0.5 * (x[0] + 4), 4 * sin - 0.3 * (x[1] - 47)
        return [0.03 * rate * u / np.cos(np.radians(x[1])), 0.03 * rate * v]

    place = np.array([-4.1, 47.5])
    start = float(run.since_origin(run.start))
    for first in np.arange(start, run.duration - 1e-9, 0.25):
        solved = solve_ivp(
            rates, (first, first + 0.25), place, method="DOP853", rtol=1e-11, atol=1e-12
        )
        place = solved.y[:, -1]
    found = dc.trajectory(run, grid, model="full", times=[run.end], rtol=1e-10)
    assert found["longitude"].item() == pytest.approx(place[0], abs=1e-8)
    assert found["latitude"].item() == pytest.approx(place[1], abs=1e-8)


def test_drift_between_ocean_and_weather_models_is_scipys_within_a_metre() -> None:
    if not _GRID.is_dir():
        pytest.skip(f"the HYCOM and GFS files are not at {_GRID}")
    current = dc.currents.from_netcdf(_GRID / "gridded_current.nc")
    wind = dc.read_wind_grid(_GRID / "GFS_Global_0p25deg.nc")
    # The wind file ends 12 hours before the current: its last field goes on.
    more = wind.times[-1] + 3 * _HOUR * np.arange(1, 5)
    wind = dataclasses.replace(
        wind,
        times=np.concatenate([wind.times, more]),
        u=np.concatenate([wind.u, np.repeat(wind.u[-1:], 4, axis=0)]),
        v=np.concatenate([wind.v, np.repeat(wind.v[-1:], 4, axis=0)]),
    )
    run = scenario(
        days=2.0,
        release=dc.Release.point(-125.1, 48.1, str(current.times[0])),
        current=current,
    )
    with pytest.warns(dc.DriftCoreWarning, match="does not cover that of the sea"):
        found = dc.trajectory(run, wind, model="full", times=[run.end], rtol=1e-9)

    def interpolated(grid: VectorGrid, fields: np.ndarray, order: int):  # type: ignore[no-untyped-def]
        seconds = (grid.times - run.origin) / np.timedelta64(1, "s")
        in_time = make_interp_spline(seconds, fields, k=order, axis=0)

        def at(t: float, longitude: float, latitude: float) -> np.ndarray:
            row = make_interp_spline(grid.latitude, in_time(t), k=3, axis=0)(latitude)
            return np.asarray(make_interp_spline(grid.longitude, row, k=3, axis=0)(longitude))

        return at

    shrink = np.cos(np.radians(current.latitude))[:, None]
    water = interpolated(current, np.stack([current.u / shrink, current.v], axis=-1), 3)
    air = interpolated(wind, np.stack([wind.u, wind.v], axis=-1), 1)

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        blown = air(t, *x) / [np.cos(np.radians(x[1])), 1]
        return np.asarray(np.degrees((0.97 * water(t, *x) + 0.03 * blown) / 6_371_008.8))

    place = np.array([-125.1, 48.1])
    start = (run.start - run.origin) / np.timedelta64(1, "s")
    for first in start + 10_800 * np.arange(16):
        solved = solve_ivp(
            rates, (first, first + 10_800), place, method="DOP853", rtol=1e-9, atol=1e-11
        )
        place = solved.y[:, -1]
    apart = [
        (found["longitude"].item() - place[0]) * np.cos(np.radians(place[1])),
        found["latitude"].item() - place[1],
    ]
    assert np.hypot(*apart) * 111_195 < 1.0


def test_a_grid_is_one_wind_for_all_members() -> None:
    grid, run = blowing(), scenario()
    found = dc.forecast(run, grid, members=3, seed=2).dataset
    assert found.attrs["wind_label"] == grid.describe()
    np.testing.assert_array_equal(found["longitude"][0], found["longitude"][2])
    alone = dc.trajectory(run, grid, model="mean-flow", times=found["time"].values)
    np.testing.assert_allclose(found["longitude"][1], alone["longitude"], atol=1e-6)


@pytest.fixture(scope="module")
def fields() -> dc.FieldBootstrap:
    return dc.FieldBootstrap.fit(weather(8), h=0.4)


def test_members_own_their_winds(fields: dc.FieldBootstrap) -> None:
    run = scenario(days=8.0)
    long = dc.forecast(run, fields, members=40, seed=3, chunk=40).dataset
    short = dc.forecast(run, fields, members=25, seed=3, chunk=7, threads=1).dataset
    np.testing.assert_array_equal(long["longitude"][:25], short["longitude"])
    full = dc.forecast(run, fields, members=25, seed=3, model="full").dataset
    # No sea: both models are exact but for the small scale's path inside a step.
    np.testing.assert_allclose(full["longitude"][:, -1], short["longitude"][:, -1], atol=2e-5)


def test_drawn_fields_drive_members_as_their_patterns_say(fields: dc.FieldBootstrap) -> None:
    still = dataclasses.replace(fields, bootstrap=dataclasses.replace(fields.bootstrap, share=0.0))
    run = scenario(days=4.0)
    found = dc.forecast(run, still, members=3, seed=9, keep=3).dataset
    steps = 4 * 4 + 3
    sample = still.sample(3, steps, 9, first_member=0, phase=0)
    times = run.origin + np.arange(steps) * 6 * _HOUR
    for member in range(3):
        u, v = still.fields(sample, member)
        grid = VectorGrid(times, LON, LAT, u, v, "one member", "wind")
        alone = dc.trajectory(run, grid, model="mean-flow", times=found["time"].values)
        np.testing.assert_allclose(found["longitude"][member], alone["longitude"], atol=1e-5)


def test_refusals() -> None:
    grid, run = blowing(), scenario()
    with pytest.raises(dc.ScenarioError, match=r"wind: it covers .* the run needs"):
        dc.forecast(run, dataclasses.replace(grid, times=grid.times + 96 * _HOUR), members=2)
    with pytest.raises(dc.ScenarioError, match="read it as a wind"):
        dc.forecast(run, dataclasses.replace(grid, kind="current"), members=2)
    far = dataclasses.replace(grid, longitude=grid.longitude + 30)
    with pytest.raises(dc.ScenarioError, match="and not the release"):
        dc.forecast(run, far, members=2)
    with pytest.raises(dc.ScenarioError, match="datetime64"):
        dc.forecast(run, [dc.WindPath([0, 9], [[1, 0], [1, 0]])])
    for few in (1, [0, 1, 2, 4]):
        rows = np.atleast_1d(few)
        part = dataclasses.replace(grid, times=grid.times[rows], u=grid.u[rows], v=grid.v[rows])
        with pytest.raises(dc.ScenarioError, match="its times are not regular; at least two, eq"):
            dc.forecast(run, part, members=2)
    hole = grid.u.copy()
    hole[0, 0, 0] = np.nan
    with pytest.raises(dc.ScenarioError, match="missing values"):
        dc.forecast(run, dataclasses.replace(grid, u=hole, v=hole), members=2)
