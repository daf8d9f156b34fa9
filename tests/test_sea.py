"""Sea fields of the core against their definitions, and the refusals of `HarmonicSea`."""

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from hypothesis import given

import driftcore as dc
from driftcore import _core
from driftcore.errors import ScenarioError
from reference import Complexes, Floats, PaperSea, RandomSea, Sea, random_sea
from strategies import epsilons, seas, seeds

DIMS = ("harmonic", "time", "x", "y", "component")
SPACE = np.linspace(-1.0, 3.0, 6)
TIME = np.linspace(0.0, 1.0, 5)


def amplitudes(values: Complexes, first: int, space: Floats, time: Floats) -> xr.DataArray:
    """Amplitudes (J, time, x, y, 2) of harmonics ``first``, ``first`` + 1, ... on a square grid."""
    coordinates = {
        "harmonic": np.arange(first, first + len(values)),
        "time": time,
        "x": space,
        "y": space,
        "component": ["x", "y"],
    }
    return xr.DataArray(values, coordinates, DIMS)


def harmonic_sea(sea: RandomSea, space: Floats = SPACE, time: Floats = TIME) -> dc.HarmonicSea:
    """The same field from its values on a grid, where cubic splines reproduce it."""
    tide, perturbation = sea.sample_on_grid(space, space, time)
    return dc.HarmonicSea(
        amplitudes(tide, 1, space, time), amplitudes(perturbation / sea.period, 0, space, time)
    )


def compiled(sea: dc.HarmonicSea | dc.AcademicSea, period: float) -> _core.Sea:
    return sea.core(period, period, 1.0)


def largest_difference(core: _core.Sea, sea: Sea, times: Floats, places: Floats) -> float:
    expected = np.array([sea.velocity(t, x) for t, x in zip(times, places, strict=True)])
    return float(np.abs(core.velocity(times, places) - expected).max())


# Values


@given(sea=seas(), seed=seeds)
def test_splines_reproduce_cubic_harmonics(sea: RandomSea, seed: int) -> None:
    rng = np.random.default_rng(seed)
    times, places = rng.uniform(0, 1, 20), rng.uniform(-1, 3, (20, 2))
    difference = largest_difference(compiled(harmonic_sea(sea), sea.period), sea, times, places)
    assert difference < 1e-10  # of velocities up to about 100 in the corners


@given(sea=seas(), seed=seeds)
def test_without_a_time_axis_the_harmonics_are_constant(sea: RandomSea, seed: int) -> None:
    constant = (np.arange(4) == 0)[:, None, None, None, None]  # the power 0 of t alone
    frozen = RandomSea(sea.period, sea.z * constant, sea.p * constant)
    tide, perturbation = (
        amplitudes(values, first, SPACE, TIME[:1]).isel(time=0, drop=True)
        for values, first in zip(frozen.sample_on_grid(SPACE, SPACE, TIME[:1]), (1, 0), strict=True)
    )
    rng = np.random.default_rng(seed)
    times, places = rng.uniform(0, 1, 20), rng.uniform(-1, 3, (20, 2))
    core = compiled(dc.HarmonicSea(tide, perturbation / sea.period), sea.period)
    assert largest_difference(core, frozen, times, places) < 1e-10


def test_dimensions_may_come_in_any_order() -> None:
    sea = random_sea(np.random.default_rng(5), 2, 0.1)
    tide, perturbation = sea.sample_on_grid(SPACE, SPACE, TIME)
    turned = dc.HarmonicSea(
        amplitudes(tide, 1, SPACE, TIME).transpose("y", "component", "x", "harmonic", "time"),
        amplitudes(perturbation / 0.1, 0, SPACE, TIME).transpose(*reversed(DIMS)),
    )
    rng = np.random.default_rng(6)
    times, places = rng.uniform(0, 1, 9), rng.uniform(-1, 3, (9, 2))
    expected = compiled(harmonic_sea(sea), 0.1).velocity(times, places)
    assert np.array_equal(compiled(turned, 0.1).velocity(times, places), expected)


def test_without_a_perturbation_it_is_zero() -> None:
    sea = random_sea(np.random.default_rng(7), 3, 0.05)
    tide_alone = RandomSea(0.05, sea.z, 0 * sea.p)
    tide, _ = sea.sample_on_grid(SPACE, SPACE, TIME)
    core = compiled(dc.HarmonicSea(amplitudes(tide, 1, SPACE, TIME)), 0.05)
    rng = np.random.default_rng(8)
    assert (
        largest_difference(core, tide_alone, rng.uniform(0, 1, 9), rng.uniform(-1, 3, (9, 2)))
        < 1e-10
    )


def test_splines_converge_with_the_fourth_power_of_the_spacing() -> None:
    def error(points: int) -> float:
        space = np.linspace(0, 2, points)
        x, y = np.meshgrid(space, space, indexing="ij")
        wave = np.stack([np.exp(1j * (2 * x + y)), np.cos(x) * np.sin(3 * y) + 0j], axis=-1)
        field = dc.HarmonicSea(amplitudes(wave[None, None], 1, space, np.zeros(1)))
        places = np.random.default_rng(9).uniform(0, 2, (200, 2))
        px, py = places.T
        exact = np.stack([np.cos(2 * px + py), np.cos(px) * np.sin(3 * py)], axis=-1)
        found = compiled(field, 0.1).velocity(np.zeros(200), places)
        return float(np.abs(found - exact).max())

    assert np.log2(error(21) / error(41)) == pytest.approx(4, abs=0.5)


@given(epsilon=epsilons, seed=seeds)
def test_academic_sea_is_the_paper_s(epsilon: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    times, places = rng.uniform(0, 1, 20), rng.uniform(-1, 3, (20, 2))
    core = compiled(dc.AcademicSea(), epsilon)
    assert largest_difference(core, PaperSea(epsilon), times, places) < 1e-11


# Refusals


def grid(first: int = 1, harmonics: int = 2) -> xr.DataArray:
    shape = (harmonics, len(TIME), len(SPACE), len(SPACE), 2)
    return amplitudes(np.ones(shape, dtype=np.complex128), first, SPACE, TIME)


def spoilt(value: complex) -> xr.DataArray:
    field = grid()
    field[1, 2, 3, 4, 0] = value
    return field


def moved(axis: str, change: Callable[[Floats], Floats]) -> xr.DataArray:
    field = grid()
    return field.assign_coords({axis: change(field[axis].to_numpy())})


@pytest.mark.parametrize(
    ("tide", "message"),
    [
        (grid().isel(x=0), "Z: dimensions .* it needs harmonic, component, y, x"),
        (grid().isel(harmonic=0), "Z: dimensions"),
        (grid().isel(component=0), "Z: dimensions"),
        (grid().expand_dims(depth=[0.0]), "Z: dimensions .*depth"),
        (grid().drop_vars("x"), "Z: dimension x has no coordinate"),
        (grid().drop_vars("time"), "Z: dimension time has no coordinate"),
        (grid(first=0), r"Z: harmonics \[0, 1\] are not accepted; expected \[1, 2\]"),
        (grid(first=2), r"Z: harmonics \[2, 3\] are not accepted; expected \[1, 2\]"),
        (grid().isel(harmonic=[1, 0]), r"Z: harmonics \[2, 1\]"),
        (grid().isel(component=[1, 0]), 'Z: components must be "x", "y"'),
        (grid().assign_coords(component=["u", "v"]), 'Z: components must be "x", "y"'),
        (spoilt(np.nan), "Z: .*not finite"),
        (spoilt(complex(0, np.inf)), "Z: .*not finite"),
        (moved("x", lambda x: x**3), "x axis: .*regular and increasing"),
        (moved("y", lambda y: y[::-1].copy()), "y axis: .*regular and increasing"),
        (moved("time", lambda t: t**2), "time axis: .*regular and increasing"),
        (moved("x", np.zeros_like), "x axis: .*regular and increasing"),
        (grid().isel(x=slice(3)), "x axis: 3 points .*at least 4"),
        (grid().isel(time=slice(2)), "time axis: 2 points .*at least 4"),
    ],
)
def test_bad_tides_are_refused(tide: xr.DataArray, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        dc.HarmonicSea(tide)


@pytest.mark.parametrize(
    ("perturbation", "message"),
    [
        (grid(first=1), r"N: harmonics \[1, 2\] are not accepted; expected \[0, 1\]"),
        (grid(first=0).isel(y=slice(5)), "N: its y axis differs from that of Z"),
        (grid(first=0).assign_coords(x=SPACE + 1e-3), "N: its x axis differs from that of Z"),
        (grid(first=0).isel(time=0, drop=True), "N: its time axis differs from that of Z"),
        (grid(first=0).isel(component=0), "N: dimensions"),
        (grid(first=0) * np.nan, "N: .*not finite"),
    ],
)
def test_bad_perturbations_are_refused(perturbation: xr.DataArray, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        dc.HarmonicSea(grid(), perturbation)


CALM = dc.WindPath([-1.0, 2.0], np.zeros((2, 2)))


def drift(sea: dc.HarmonicSea, position: tuple[float, float] = (1.0, 1.0)) -> xr.Dataset:
    scenario = dc.Scenario(epsilon=0.1, position=position, velocity=(4, 0), sea=sea, coast=None)
    return dc.trajectory(scenario, CALM, model="full", times=[0.0, 1.0])


@pytest.mark.parametrize("time", [TIME + 0.1, TIME - 0.1, 0.9 * TIME])
def test_the_time_axis_must_cover_the_run(time: Floats) -> None:
    sea = dc.HarmonicSea(grid().assign_coords(time=time))
    with pytest.raises(ScenarioError, match=r"time axis covers .* the run needs \[0, 1\]"):
        drift(sea)


def test_the_release_must_lie_on_the_grid() -> None:
    with pytest.raises(ScenarioError, match=r"\(3\.5, 1\) lies outside"):
        drift(dc.HarmonicSea(0 * grid()), position=(3.5, 1.0))


def test_a_single_trajectory_must_stay_on_the_grid() -> None:
    with pytest.raises(ScenarioError, match="lies outside"):
        drift(dc.HarmonicSea(0 * grid()))  # by drag alone it comes to rest at x = 5 - 4/e
