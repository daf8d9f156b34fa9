"""Wind fields resampled: their components, the law in space and time, and what is refused."""

import dataclasses
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.signal import lfilter

import driftcore as dc
from driftcore import RecordError, ScenarioError
from driftcore.grids import VectorGrid
from driftcore.wind_fields import (
    CORRELATION,
    FIELD_DEVIATION,
    SHARE,
    FieldBootstrap,
    GriddedWindRecord,
    assess,
)

Floats = np.ndarray[Any, np.dtype[np.float64]]

LON, LAT = np.linspace(-6, -2, 6), np.linspace(46, 49, 5)
SUMMER_H = 92 * 24


def autoregression(
    random: np.random.Generator, count: int, steps: int, step_h: float, memory_h: float
) -> Floats:
    """Stationary series of order 2, of variance 1, smooth over 3 h, (count, steps)."""
    a, b = np.exp(-step_h / memory_h), np.exp(-step_h / 3)
    spin_up = round(20 * memory_h / step_h)
    noise = random.normal(size=(count, spin_up + steps))
    variance = (1 + a * b) / ((1 - a * b) * ((1 + a * b) ** 2 - (a + b) ** 2))
    series = lfilter([1], [1, -a - b, a * b], noise)[:, spin_up:] / np.sqrt(variance)
    return np.asarray(series, np.float64)


def weather(years: int, step_h: int = 6, seed: int = 1) -> VectorGrid:
    """Summers of a wind that is nearly uniform, and of gradients that follow and lead it.

    A sea breeze, stronger in the east, blows on top.
    """
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.linspace(-1, 1, len(LON)), np.linspace(-1, 1, len(LAT)))
    steps, lag = SUMMER_H // step_h, max(1, 6 // step_h)
    hours = np.arange(steps) * step_h
    u, v, times = [], [], []
    for year in range(2001, 2001 + years):
        base = autoregression(random, 2, steps + 2 * lag, step_h, 36) * [[4.3], [3.2]]
        base[1] += 0.3 * base[0]
        own = 0.5 * autoregression(random, 4, steps, step_h, 12)
        early, now, late = base[:, : -2 * lag], base[:, lag:-lag], base[:, 2 * lag :]
        slopes = own + np.stack([0.15 * early[0], 0.15 * late[1], np.zeros(steps), np.zeros(steps)])
        field = slopes[:, :, None, None]
        breeze = 1.5 * np.cos(2 * np.pi * (hours - 18) / 24)[:, None, None] * (1 + 0.3 * x)
        u.append(2 + now[0, :, None, None] * (1 + 0.1 * y) + field[0] * x + field[2] * y + breeze)
        v.append(-1 + now[1, :, None, None] * (1 - 0.1 * y) + field[1] * x + field[3] * y)
        times.append(np.datetime64(f"{year}-06-01", "ns") + hours * np.timedelta64(1, "h"))
    joined = (np.concatenate(parts) for parts in (times, u, v))
    when, east, north = joined
    return VectorGrid(when, LON, LAT, east, north, "weather", "wind")


@pytest.fixture(scope="module")
def fitted() -> FieldBootstrap:
    return FieldBootstrap.fit(weather(8), h=0.4)


# The record and its components


def test_record_is_cut_and_checked() -> None:
    grid = weather(2)
    record = GriddedWindRecord.from_grid(grid, (7,))
    assert record.record.months == (7,)
    assert record.velocity.shape == (2 * 31 * 4, 2, 5, 6)
    july = np.isin(grid.times.astype("datetime64[M]").astype(int) % 12, [6])
    np.testing.assert_array_equal(record.velocity[:, 1], grid.v[july])


def test_cycle_is_the_mean_day_of_each_cell() -> None:
    grid = weather(3, step_h=3)
    record = GriddedWindRecord.from_grid(grid, (6, 7, 8))
    at_18 = grid.times.astype("datetime64[h]").astype(int) % 24 == 18
    np.testing.assert_allclose(record.cycle[6, 0], grid.u[at_18].mean(axis=0), rtol=1e-12)
    # The breeze in the east has 13/7 times the amplitude of that in the west.
    amplitude = np.ptp(record.cycle[:, 0], axis=0).mean(axis=0)
    assert amplitude[-1] / amplitude[0] == pytest.approx(13 / 7, rel=0.25)
    for phase in range(8):
        rows = record.phase == phase
        np.testing.assert_allclose(record.anomaly[rows].mean(axis=0), 0, atol=1e-12)


def test_components_rebuild_the_record() -> None:
    record = GriddedWindRecord.from_grid(weather(2), (6, 7, 8))
    patterns, scores, share = record.components(60)
    rebuilt = np.tensordot(scores, patterns, axes=1)
    np.testing.assert_allclose(rebuilt, record.anomaly, atol=1e-9)
    assert share.sum() == pytest.approx(1, abs=1e-12)
    assert (np.diff(share) <= 1e-15).all()
    # Patterns are orthogonal with the area as weight, so scores are uncorrelated.
    area = np.cos(np.deg2rad(LAT))[:, None] * np.ones(len(LON))
    products = np.einsum("kcyx,lcyx,yx->kl", patterns, patterns, area / area.sum())
    np.testing.assert_allclose(products, np.eye(60), atol=1e-9)
    covariance = scores.T @ scores
    np.testing.assert_allclose(
        covariance, np.diag(np.diag(covariance)), atol=1e-8 * covariance[0, 0]
    )


def test_components_of_a_short_record_of_many_cells() -> None:
    """Fewer rows than values: the smaller side is decomposed."""
    record = GriddedWindRecord.from_grid(weather(1), (6, 7, 8))
    short = dataclasses.replace(
        record,
        record=dataclasses.replace(
            record.record,
            times=record.record.times[:40].copy(),
            velocity=record.record.velocity[:40].copy(),
        ),
        velocity=record.velocity[:40],
    )
    patterns, scores, _ = short.components(36)  # 40 rows less four means of the day
    np.testing.assert_allclose(np.tensordot(scores, patterns, axes=1), short.anomaly, atol=1e-9)


def test_components_by_share() -> None:
    record = GriddedWindRecord.from_grid(weather(2), (6, 7, 8))
    share = record.components(20).share
    for wanted in (0.5, 0.9, 0.995):
        found = record.components(wanted).share
        assert found.sum() >= wanted > found[:-1].sum()
        np.testing.assert_array_equal(found, share[: len(found)])
    for wrong in (0, 1.0, -0.1, 61, 2.5, True):
        with pytest.raises(ScenarioError, match=f"components: {wrong} is not accepted"):
            record.components(wrong)


def uniform(step_h: int = 6, years: int = 3) -> VectorGrid:
    grid = weather(years, step_h)
    u, v = (np.broadcast_to(f[:, :1, :1], f.shape).copy() for f in (grid.u, grid.v))
    return dataclasses.replace(grid, u=u, v=v)


def test_a_uniform_wind_is_two_components() -> None:
    """Then the fields are those of the bootstrap of the one wind, but for the frame of axes."""
    grid = uniform()
    wind = FieldBootstrap.fit(grid, h=0.4)
    assert wind.patterns.shape == (2, 2, 5, 6)
    assert wind.share == pytest.approx(1, abs=1e-12)
    u, _ = wind.fields(wind.sample(2, 30, 5), 1)
    np.testing.assert_allclose(u, np.broadcast_to(u[:, :1, :1], u.shape), atol=1e-9)
    series = dataclasses.replace(
        wind.gridded.record, velocity=np.stack([grid.u[:, 0, 0], grid.v[:, 0, 0]], axis=1)
    )
    plain = dc.LocalGridBootstrap.fit(series, None, h=0.4)
    frame = wind.patterns[:, :, 0, 0].T  # (u, v) @ frame are the components
    for row in (3, 500, 900):
        u_v = plain.states[row : row + 2].mean(axis=0)
        turned = (u_v.reshape(2, 2) @ frame).ravel()
        np.testing.assert_allclose(wind.bootstrap.weights(turned), plain.weights(u_v), atol=1e-5)


# Samples


def test_sample_against_a_plain_loop(fitted: FieldBootstrap) -> None:
    """The components from the draws of the bootstrap, equation by equation."""
    members, steps, seed = 3, 40, 11
    others, bootstrap = fitted.others, fitted.bootstrap
    reach, order = others.reach, bootstrap.order
    assert reach == 2
    assert len(fitted.shares) > 2
    sample = fitted.sample(members, steps, seed)
    values, drawn = bootstrap.sample(members, steps + 2 * reach, seed, return_indices=True)
    np.testing.assert_array_equal(sample.indices, drawn[:, reach:-reach])
    np.testing.assert_allclose(sample.components[..., :2], values[:, reach:-reach], atol=1e-9)
    for m in range(members):
        row = others.start[others.start >= drawn[m, 0] + 1][0]
        past = [others.noise[row - lag] for lag in range(order)]
        for t in range(steps):
            if t:
                known = np.concatenate([[1.0], *past])
                place = int(np.flatnonzero(bootstrap.row == drawn[m, reach + t])[0])
                past = [others.memory @ known + others.missed[place], *past[:-1]]
            around = np.concatenate([[1.0], values[m, t : t + 2 * reach + 1].ravel()])
            np.testing.assert_allclose(
                sample.components[m, t, 2:], others.response @ around + past[0], atol=1e-9
            )


def test_phases_follow_the_clock(fitted: FieldBootstrap) -> None:
    sample = fitted.sample(5, 9, 3)
    np.testing.assert_array_equal(np.diff(sample.phase, axis=1) % 4, 1)
    # Drawn rows are of any hour; the cycle is that of the clock, not theirs.
    u, _ = fitted.fields(sample, 2)
    anomaly = np.tensordot(sample.components[2], fitted.patterns, axes=1)[:, 0]
    np.testing.assert_allclose(u - anomaly, fitted.gridded.cycle[sample.phase[2], 0], atol=1e-12)


def test_a_member_depends_on_its_number_only(fitted: FieldBootstrap) -> None:
    whole, part = fitted.sample(6, 30, 4), fitted.sample(2, 30, 4)
    longer = fitted.sample(2, 50, 4)
    for all_, few, more in zip(whole, part, longer, strict=True):
        np.testing.assert_array_equal(all_[:2], few)
        np.testing.assert_array_equal(more[:, :30], few)
    again = pickle.loads(pickle.dumps(fitted)).sample(2, 30, 4)  # noqa: S301 - made here
    np.testing.assert_array_equal(again.components, part.components)
    assert not np.array_equal(fitted.sample(2, 30, 5).indices, part.indices)


def test_velocity_is_linear_between_nodes(fitted: FieldBootstrap) -> None:
    sample = fitted.sample(2, 12, 1)
    u, v = fitted.fields(sample, 1)
    nodes = fitted.velocity(sample, 1, 6.0 * 5, LON[None, :], LAT[:, None])
    np.testing.assert_allclose(nodes, np.stack([u[5], v[5]], axis=-1), atol=1e-12)
    turned = fitted.velocity(sample, 1, 6.0 * 5, LON[None, :] + 360, LAT[:, None])
    np.testing.assert_allclose(turned, nodes, atol=1e-9)
    reference = xr.DataArray(
        u, {"t": 6.0 * np.arange(12), "y": LAT, "x": LON}, dims=("t", "y", "x")
    ).interp(t=21.7, y=47.123, x=-4.321)
    found = fitted.velocity(sample, 1, 21.7, -4.321, 47.123)
    assert found[0] == pytest.approx(float(reference), abs=1e-12)
    series = fitted.series(sample, 2, 3)
    np.testing.assert_allclose(series[1], np.stack([u[:, 2, 3], v[:, 2, 3]], axis=1), atol=1e-12)


@pytest.mark.parametrize(
    ("field", "where"),
    [
        ("time_h", (66.1, -4, 47)),
        ("time_h", (-0.1, -4, 47)),
        ("longitude", (6, -1.9, 47)),
        ("latitude", (6, -4, 49.1)),
        ("latitude", (6, -4, np.nan)),
    ],
)
def test_velocity_beyond_the_fields(
    fitted: FieldBootstrap, field: str, where: tuple[float, float, float]
) -> None:
    with pytest.raises(ScenarioError, match=f"{field}: .* is not covered"):
        fitted.velocity(fitted.sample(1, 12, 1), 0, *where)


# Law


@pytest.mark.parametrize(("step_h", "years"), [(1, 6), (3, 8), (6, 12)])
def test_sampled_fields_have_the_law_of_the_record(step_h: int, years: int) -> None:
    checks = assess(FieldBootstrap.fit(weather(years, step_h), h=0.475))
    assert [(c.name, c.measured, c.required) for c in checks if not c.passed] == []
    assert {SHARE, CORRELATION, FIELD_DEVIATION} < {c.name for c in checks}
    assert {c.name.split()[0] for c in checks} >= {f"T{k}" for k in range(1, 8)}


def test_components_keep_their_memory_and_lags(fitted: FieldBootstrap) -> None:
    """Lagged correlations of all with all, up to a day; 0.1 is two standard errors of a record.

    In this weather one gradient follows the wind by 6 h and one leads it.
    """

    def correlation(series: Floats, lag: int) -> Floats:
        normal = (series - series.mean((0, 1))) / series.std((0, 1))
        before, after = normal[:, : normal.shape[1] - lag], normal[:, lag:]
        return np.einsum("mtk,mtl->kl", before, after) / before.shape[0] / before.shape[1]

    sampled = fitted.sample(60, 368, 1).components
    record = fitted.scores.reshape(8, 368, -1)
    lags = [(correlation(sampled, lag), correlation(record, lag)) for lag in range(5)]
    for found, expected in lags:
        np.testing.assert_allclose(found, expected, atol=0.1)
    # What is there to be kept: all have a memory, and some lag is not the same both ways.
    assert np.diag(lags[1][1]).min() > 0.3
    assert max(np.abs(expected - expected.T).max() for _, expected in lags) > 0.2


def test_torn_fields_are_found_out(fitted: FieldBootstrap) -> None:
    """Patterns that change their sign at the centre."""
    torn = dataclasses.replace(fitted, patterns=fitted.patterns * np.sign(LON - LON.mean()))
    assert CORRELATION in {c.name for c in assess(torn, seasons=20) if not c.passed}


def test_paper_mode() -> None:
    wind = FieldBootstrap.fit(weather(4), mode="lgb")
    assert wind.bootstrap.mode == "lgb"
    u, _ = wind.fields(wind.sample(1, 400, 2), 0)
    assert u.std() == pytest.approx(wind.gridded.velocity[:, 0].std(), rel=0.2)


def test_small_scale_part_is_a_share_of_all(fitted: FieldBootstrap) -> None:
    ratio = fitted.small_scale_sd / fitted.gridded.standard_deviation
    assert ratio == pytest.approx(0.1 / np.sqrt(0.99))
    assert fitted.gridded.standard_deviation == pytest.approx(
        np.sqrt(fitted.gridded.velocity.var(axis=0).mean()), rel=0.01
    )


# Files, and what is refused


def test_from_files(tmp_path: Path) -> None:
    grid = weather(3)
    dims = ("valid_time", "latitude", "longitude")
    dataset = xr.Dataset(
        {
            name: (dims, values[:, ::-1], {"units": "m s**-1"})
            for name, values in (("u10", grid.u), ("v10", grid.v))
        },
        {"valid_time": grid.times, "latitude": LAT[::-1], "longitude": LON + 360},
    )
    for year in (2001, 2002, 2003):
        part = dataset.sel(valid_time=str(year))
        part.to_netcdf(tmp_path / f"era5_{year}.nc", engine="h5netcdf")
    wind = FieldBootstrap.fit(str(tmp_path / "era5_*.nc"), h=0.4)
    np.testing.assert_allclose(
        wind.sample(1, 9, 1).components,
        FieldBootstrap.fit(grid, h=0.4).sample(1, 9, 1).components,
        atol=1e-6,
    )


def test_a_record_read_before_serves_as_well(fitted: FieldBootstrap) -> None:
    again = FieldBootstrap.fit(GriddedWindRecord.from_grid(weather(8), (6, 7, 8)), h=0.4)
    np.testing.assert_array_equal(
        again.sample(2, 9, 1).components, fitted.sample(2, 9, 1).components
    )
    assert repr(fitted) == f"FieldBootstrap({fitted.bootstrap!r}, share={fitted.share:.3f})"


def test_gaps_between_summers_need_months() -> None:
    with pytest.raises(RecordError, match="time: gap of"):
        FieldBootstrap.fit(weather(2), None)


def test_a_current_is_no_wind() -> None:
    with pytest.raises(RecordError, match=r"kind: 'current' is not accepted"):
        FieldBootstrap.fit(dataclasses.replace(weather(1), kind="current"))


def test_a_cell_without_wind() -> None:
    grid = weather(1)
    u = grid.u.copy()
    u[:, 0, 0] = np.nan
    with pytest.raises(RecordError, match="values: 1 cells have none"):
        GriddedWindRecord.from_grid(dataclasses.replace(grid, u=u))


def test_no_wind_at_all() -> None:
    grid = weather(1)
    calm = dataclasses.replace(grid, u=np.zeros_like(grid.u), v=np.zeros_like(grid.v))
    with pytest.raises(RecordError, match="does not vary"):
        GriddedWindRecord.from_grid(calm, (6, 7, 8)).components()


def test_too_short_for_its_components() -> None:
    """Independent winds in every cell need as many components as a short record cannot tell."""
    grid = weather(3)
    random = np.random.default_rng(1)
    u, v = random.normal(size=(2, *grid.u.shape))
    with pytest.warns(dc.DriftCoreWarning, match=r"components carry 0\.\d+ of the wind's variance"):
        wind = FieldBootstrap.fit(dataclasses.replace(grid, u=u, v=v), h=0.4)
    assert len(wind.shares) == 3 * 368 // 40


@pytest.mark.filterwarnings("ignore:the wind record has 1 season")
def test_components_that_grow_are_refused() -> None:
    """A gradient that swells through the only summer has no stationary memory."""
    grid = weather(1)
    growing = np.exp(np.arange(len(grid.times)) / 20)
    growing *= 4 / growing[-1]
    u = grid.u.mean(axis=(1, 2), keepdims=True) + growing[:, None, None] * np.linspace(-1, 1, 6)
    u = np.broadcast_to(u, grid.u.shape).copy()
    v = np.broadcast_to(grid.v.mean(axis=(1, 2), keepdims=True), u.shape).copy()
    with pytest.raises(RecordError, match=r"the noise of its components grows \(1\.0\d+ a step\)"):
        FieldBootstrap.fit(dataclasses.replace(grid, u=u, v=v), carried=3, h=0.4)
