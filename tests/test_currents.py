"""Currents made ready: land filled from the sea, regular times, the tide removed."""

import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from driftcore import RecordError
from driftcore.currents import Current, filled, from_netcdf
from driftcore.grids import VectorGrid, read_vector_grid

REAL = Path(__file__).parents[2] / "shared/data/grid"
HOUR = np.timedelta64(1, "h").astype("timedelta64[ns]")
START = np.datetime64("2020-03-01", "ns")
Floats = np.ndarray[Any, np.dtype[np.float64]]

LON = np.linspace(-6, -4, 9)
LAT = np.linspace(47, 49, 11)


def grid(u: Floats, v: Floats | None = None, step_h: float = 1, **changes: Any) -> VectorGrid:
    times = START + (np.arange(len(u)) * step_h * HOUR.astype(np.int64)).astype("timedelta64[ns]")
    values = {
        "times": times,
        "longitude": LON,
        "latitude": LAT,
        "u": u,
        "v": u.copy() if v is None else v,
        "label": "made here",
        "kind": "current",
    }
    return VectorGrid(**(values | changes))


def uniform(series: Floats) -> Floats:
    return np.broadcast_to(series[:, None, None], (len(series), len(LAT), len(LON))).copy()


# Land


def test_fill_is_harmonic_and_keeps_the_sea() -> None:
    """Against the mean of the four neighbours, weighed by the metric of the grid."""
    random = np.random.default_rng(1)
    values = random.normal(size=(3, len(LAT), len(LON)))
    gaps = np.zeros((len(LAT), len(LON)), bool)
    gaps[3:8, 2:6] = gaps[9:, :2] = True
    values[:, gaps] = np.nan
    values[1, 1, 7] = np.nan  # a mask of its own
    full = filled(values, LON, LAT)
    sea = ~np.isnan(values)
    np.testing.assert_array_equal(full[sea], values[sea])
    assert full.max() == np.nanmax(values)
    assert full.min() == np.nanmin(values)
    shape = (LAT[1] - LAT[0]) / (LON[1] - LON[0])
    for k, j, i in [(0, 5, 4), (2, 3, 2), (1, 1, 7)]:
        east = shape / np.cos(np.deg2rad(LAT[j]))
        north, south = (np.cos(np.deg2rad(LAT[[j, j + side]])).mean() / shape for side in (1, -1))
        around = (
            east * (full[k, j, i - 1] + full[k, j, i + 1])
            + north * full[k, j + 1, i]
            + south * full[k, j - 1, i]
        )
        np.testing.assert_allclose(full[k, j, i], around / (2 * east + north + south), rtol=1e-12)


def test_a_uniform_current_stays_uniform() -> None:
    u = uniform(np.array([0.3, -0.2]))
    u[:, LAT > 48] = np.nan
    current = Current.from_grid(grid(u))
    np.testing.assert_allclose(current.u, uniform(np.array([0.3, -0.2])), atol=1e-14)
    np.testing.assert_array_equal(current.land, (LAT > 48)[:, None] & (LON < 0))
    assert "45% of the cells are land" in current.describe()


def test_cells_dry_at_times_are_sea() -> None:
    u = uniform(np.array([0.3, 0.5]))
    u[1, 4, 4] = np.nan
    current = Current.from_grid(grid(u))
    assert not current.land.any()
    np.testing.assert_allclose(current.u[1], 0.5, atol=1e-14)
    assert "1 cells have no value at some times" in current.describe()


def test_a_step_without_values() -> None:
    u = uniform(np.array([0.3, np.nan]))
    with pytest.raises(RecordError, match="values: step 1 has none"):
        Current.from_grid(grid(u))


def test_a_wind_is_no_current() -> None:
    with pytest.raises(RecordError, match=r"kind: 'wind' is not accepted"):
        Current.from_grid(grid(uniform(np.ones(2)), kind="wind"))


def test_without_scipy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(RecordError, match=r'scipy is needed .* pip install "driftcore\[geo\]"'):
        Current.from_grid(grid(uniform(np.ones(2))))


# Times


def test_nearly_regular_times_are_interpolated() -> None:
    exact = np.arange(40) * 3.0
    known = exact + 0.1 * np.sin(np.arange(40))
    known[0] = 0
    times = START + (known * HOUR.astype(np.int64)).astype("timedelta64[ns]")
    current = Current.from_grid(grid(uniform(known / 100), times=times))
    assert current.step_h == 3
    # A linear function is interpolated exactly, and held beyond the last time.
    np.testing.assert_allclose(current.u[:, 0, 0], np.minimum(exact, known[-1]) / 100, atol=1e-9)
    assert "interpolated to regular steps" in current.describe()


def test_gaps_in_time_are_refused() -> None:
    made = grid(uniform(np.arange(6.0) / 10))
    times = made.times + HOUR * np.array([0, 0, 0, 5, 5, 5])
    with pytest.raises(
        RecordError, match=r"from 1 to 6 h; .*cdo inttime,2020-03-01,00:00:00,60minutes"
    ):
        Current.from_grid(grid(made.u.copy(), times=times))


# Tide


def tidal(hours: Floats) -> Floats:
    periods = {"M2": 12.4206, "S2": 12.0, "K1": 23.9345, "O1": 25.8193}
    return np.sum([np.cos(2 * np.pi * hours / p + k) for k, p in enumerate(periods.values())], 0)


@pytest.mark.parametrize("step_h", [0.5, 1, 2, 3])
def test_the_tide_is_removed(step_h: float) -> None:
    """Four constituents of 1 m/s: what is left is that of O1, and of no steady current anything."""
    hours = np.arange(0, 30 * 24, step_h)
    current = Current.from_grid(grid(uniform(tidal(hours) + 0.2), step_h=step_h)).detided()
    assert current.step_h == 24
    np.testing.assert_allclose(current.u, 0.2, atol=5e-4)
    assert "tide removed (Godin)" in current.describe()


@pytest.mark.parametrize(("every_d", "count"), [(1, 27), (7, 3)])
def test_what_is_slow_stays(every_d: int, count: int) -> None:
    """A ramp, at the middle of each day or week; the filter needs 35 h on each side."""
    hours = np.arange(30.0 * 24)
    current = Current.from_grid(grid(uniform(hours / 1000))).detided(every_d)
    assert len(current.times) == count
    assert current.step_h == 24 * every_d
    at = (current.times - START) / HOUR
    assert at[0] == 35 + (24 * every_d - 1) / 2
    np.testing.assert_allclose(current.u[:, 0, 0], at / 1000, rtol=1e-12)


def test_a_slow_oscillation_stays() -> None:
    hours = np.arange(40.0 * 24)
    slow = np.cos(2 * np.pi * hours / 240)
    current = Current.from_grid(grid(uniform(slow))).detided()
    at = (current.times - START) / HOUR
    # 0.9349: the product of the means over 24, 24, 25 hours and over the day, at this period.
    np.testing.assert_allclose(current.u[:, 0, 0], 0.9349 * np.cos(2 * np.pi * at / 240), atol=1e-4)


@pytest.mark.parametrize(("days", "step_h"), [(14, 1), (30, 6)])
def test_the_tide_is_not_resolved(days: int, step_h: float) -> None:
    made = grid(uniform(np.ones(int(days * 24 / step_h))), step_h=step_h)
    with pytest.raises(RecordError, match=r"time: the tide cannot be removed of .* every"):
        Current.from_grid(made).detided()


@pytest.mark.parametrize("every_d", [0, 1.5, True, 13])
def test_days_refused(every_d: Any) -> None:
    current = Current.from_grid(grid(uniform(np.ones(15 * 24 + 1))))
    with pytest.raises(RecordError, match=f"every_d: {every_d} is not accepted"):
        current.detided(every_d)


# Mean and scales


def test_mean_and_scales() -> None:
    """A plane wave that travels east over a steady current: all scales are known."""
    lon = np.arange(-6, 0, 0.05)
    lat = np.linspace(-1, 1, 41)  # at the equator a degree is a degree
    hours = np.arange(48.0)
    metres = np.deg2rad(lon) * 6_371_000
    wave = 2 * np.pi / np.deg2rad(2) / 6_371_000  # three waves
    phase = wave * metres - 2 * np.pi * hours[:, None] / 24
    v = np.broadcast_to(0.4 * np.sin(phase)[:, None], (48, len(lat), len(lon))).copy()
    u = np.full_like(v, 0.3)
    current = Current.from_grid(grid(u, v, longitude=lon, latitude=lat))
    np.testing.assert_allclose(current.mean().u, 0.3, atol=1e-12)
    np.testing.assert_allclose(current.mean().v, 0.0, atol=1e-12)
    scales = current.scales()
    rms = 0.4 / math.sqrt(2)
    assert scales.speed == pytest.approx(math.hypot(0.3, rms), rel=1e-3)
    assert scales.mean_speed == pytest.approx(0.3, rel=1e-3)
    assert scales.largest == pytest.approx(0.5, rel=1e-3)
    assert scales.length_km == pytest.approx(scales.speed / rms / wave / 1000, rel=0.02)
    assert scales.time_h == pytest.approx(24 / (2 * np.pi), rel=0.01)
    assert current.mean().scales().time_h == math.inf


# A file that nobody here wrote


@pytest.mark.parametrize("name", ["gridded_current.nc", "wa_RTOFS_global.nc"])
def test_real_currents(name: str) -> None:
    path = REAL / name
    if not path.is_file():
        pytest.skip(f"the file is not at {path}")
    read = read_vector_grid(path, "current")
    current = from_netcdf(path)
    sea = ~np.isnan(read.u)
    np.testing.assert_array_equal(current.u[sea], read.u[sea])
    np.testing.assert_array_equal(current.land, read.missing)
    for full, known in ((current.u, read.u), (current.v, read.v)):
        assert np.isfinite(full).all()
        assert (np.abs(full).max(axis=(1, 2)) <= np.nanmax(np.abs(known), axis=(1, 2))).all()
    assert 0.1 < current.scales().speed < 0.5
