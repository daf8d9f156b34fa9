"""Any floating body: order of the expansion, the full model, and motions known in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cache
from itertools import product
from typing import Literal

import numpy as np
import pytest
import xarray as xr

import driftcore as dc
from driftcore import _core
from driftcore.objects import LeewayLine
from driftcore.sea import spline_axis, spline_coefficients
from reference import Body, Complexes, Floats, GriddedCurrent, GriddedTide, NaiveWind, full_body

RADIUS = 6_371_008.8
AXIS = np.linspace(-2.0, 4.0, 61)
# Two constituents of one species: M2 and S2.
RATIO = 12.4206 / 12
BODIES = [
    (tau, alpha) for tau, alpha in product((0, 0.02, 0.2, 1), (0.05, 0.5, 1)) if tau or alpha < 1
]


def amplitudes() -> tuple[Complexes, Complexes]:
    """Amplitudes of two constituents, nonlinear in x and y and of no common phase."""
    x, y = np.meshgrid(AXIS, AXIS, indexing="ij")

    def wave(a: float, b: float, phase: float) -> Complexes:
        return np.asarray(
            a * np.sin(0.8 * x + b * y + phase) + 1j * b * np.cos(0.6 * y - a * x + 2 * phase)
        )

    first = np.stack([wave(1.0, 0.7, 0.1), wave(0.8, -0.6, 0.5)], axis=-1)
    second = np.stack([wave(0.5, 0.4, 0.9), wave(-0.4, 0.5, 1.3)], axis=-1)
    return first, second


def residual(epsilon: float, t: Floats) -> Floats:
    """A current (nt, nx, ny, 2) of the size of epsilon that changes slowly."""
    t, x, y = np.meshgrid(t, AXIS, AXIS, indexing="ij")
    u, v = 0.6 + 0.3 * np.sin(y + t), -0.4 + 0.3 * np.cos(x - 2 * t)
    return epsilon * np.stack([u, v], axis=-1)


def gridded(
    period: float, t: Floats, fields: Complexes, constituents: list[tuple[float, int]]
) -> _core.Sea:
    """Compiled sea from values (nt, nx, ny, channels)."""
    axes = [spline_axis(name, values) for name, values in (("x", AXIS), ("y", AXIS), ("time", t))]
    coefficients = np.swapaxes(fields, 1, 2).astype(complex)
    for dimension in range(3):
        coefficients = spline_coefficients(coefficients, dimension)
    coefficients = np.ascontiguousarray(coefficients)
    if not constituents:
        return _core.Sea.gridded(period, axes, 0, coefficients)
    return _core.Sea.constituents(period, axes, constituents, coefficients)


def frequencies(period: float) -> tuple[float, float]:
    return 2 * math.pi / period, 2 * math.pi / period * RATIO


@cache
def nonlinear_sea(epsilon: float) -> _core.Sea:
    """Two constituents and a steady residual current on one grid."""
    steady = np.zeros(1)
    fields = np.concatenate([*amplitudes(), residual(epsilon, steady)[0]], axis=-1)
    lines = [(omega, 2) for omega in frequencies(epsilon)]
    return gridded(epsilon, steady, fields[None], lines)


def fleet(sea: _core.Sea, bodies: Floats, *, velocity: Floats | None = None) -> _core.Fleet:
    """One body on the plane, released at time 0 from (1, 1), for one unit of time."""
    place = np.array([[1.0, 1.0]])
    start = None if velocity is None else velocity[None]
    return _core.Fleet(sea, None, None, 1.0, 0, np.zeros(1), place, start, bodies[None], 0.0, 1)


def row(body: Body) -> Floats:
    """A body as the core takes it; it never jibes."""
    lines = (*body.downwind, *body.crosswind, *body.crosswind)
    return np.array([body.response, body.slip, *lines, *body.surface_current])


FULL = _core.Solver.full(True, 1e-10, 1e-11, None)
AVERAGED = _core.Solver.mean_flow(1, 1e-10, 1e-11, None)


# Order


def random_winds(count: int) -> list[_core.WindPath]:
    times = np.linspace(0, 1, 26)
    return [
        _core.WindPath(
            times, [0.3, -0.4] + 0.7 * np.random.default_rng(seed).standard_normal((26, 2))
        )
        for seed in range(count)
    ]


def largest_errors(epsilon: float, response: float, slip: float) -> Floats:
    """Largest differences of position and velocity over the run and some winds."""
    body = row(Body(response, slip, downwind=(slip, 0.0)))
    drift = fleet(nonlinear_sea(epsilon), body, velocity=np.zeros(2))
    # Often enough in a tide: a few times would say at which phase they fell.
    times = np.linspace(0, 1, round(25 / epsilon) + 1)
    largest = np.zeros(2)
    for wind in random_winds(3):
        paths = [drift.trajectory(wind, solver, times)[0][:2] for solver in (FULL, AVERAGED)]
        errors = [np.linalg.norm(a - b, axis=1).max() for a, b in zip(*paths, strict=True)]
        largest = np.maximum(largest, errors)
    return largest


@pytest.mark.parametrize(("response", "slip"), BODIES)
def test_the_error_falls_with_the_square_of_epsilon(response: float, slip: float) -> None:
    # A body that answers within a tide or two is asked where epsilon is small enough: from 1/50 to
    # 1/100 the slopes for a response of 0.02 are 1.65 to 1.9, since ωτ there goes from 6 to 13.
    epsilon = {0: 1 / 100, 0.02: 1 / 200}.get(response, 1 / 50)
    errors = [largest_errors(e, response, slip) for e in (epsilon, epsilon / 2)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx([2, 2], abs=0.2)


@pytest.mark.parametrize("slip", [0.05, 0.5, 1])
def test_the_order_is_uniform_in_the_response(slip: float) -> None:
    """With the response a fixed number of tides slopes are 2 at once; no response is worse."""
    tides = np.array([0.1, 1, 10, 50])
    coarse, fine = (
        np.array([largest_errors(e, n * e, slip)[0] for n in tides]) for e in (1 / 50, 1 / 100)
    )
    assert np.log2(coarse / fine) == pytest.approx(np.full(4, 2), abs=0.2)
    assert (fine < 0.08 * (1 / 100) ** 2).all()


def test_other_models_are_refused() -> None:
    drift = fleet(nonlinear_sea(0.1), row(Body()))
    for solver in (
        _core.Solver.mean_flow(2, 1e-8, 1e-8, None),
        _core.Solver.paper(1, 0.05, False, 1e-8, 1e-8, None),
    ):
        with pytest.raises(ValueError, match=r"others? (bodies )?have .*order 1"):
            drift.trajectory(random_winds(1)[0], solver, np.ones(1))


# The full model


@pytest.mark.parametrize(
    "body",
    [
        Body(0, 0.3, (0.02, 0.01), (0.03, -0.02), (0.02, 0.004)),
        Body(0, 0, (0.05, 0.0), (-0.03, 0.01), (0.01, -0.002)),
        Body(0.05, 0.5, (0.5, 0.0), (0.1, 0.02), (0.02, 0.003)),
        Body(2, 1, (1.0, 0.0)),
    ],
    ids=["answers-at-once", "leeway", "answers-late", "paper"],
)
def test_the_full_model_is_the_reference_s(body: Body) -> None:
    epsilon, rng = 0.2, np.random.default_rng(11)
    t = np.linspace(-0.2, 1.2, 8)
    lines = list(zip(frequencies(epsilon), amplitudes(), strict=True))
    tide, current = GriddedTide(AXIS, AXIS, lines), GriddedCurrent(t, AXIS, AXIS, residual(1, t))
    both = np.concatenate(amplitudes(), axis=-1)[None]
    sea = _core.Sea.sum(
        [
            gridded(epsilon, np.zeros(1), both, [(omega, 2) for omega, _ in lines]),
            gridded(epsilon, t, residual(1, t), []),
        ]
    )
    knots, velocity = np.linspace(0, 1, 6), rng.standard_normal((6, 2))
    start, times = np.array([0.3, -0.2]), np.linspace(0, 1, 9)
    solver = _core.Solver.full(True, 1e-12, 1e-13, None)
    (position, speed, *_), _ = fleet(sea, row(body), velocity=start).trajectory(
        _core.WindPath(knots, velocity), solver, times
    )
    expected = full_body(
        lambda t, x: tide.velocity(t, x) + current.velocity(t, x),
        NaiveWind(knots, velocity), body, (1.0, 1.0), start, times, step=epsilon / 20,
    )  # fmt: skip
    assert np.abs(position - expected.position).max() < 1e-9
    assert np.abs(speed - expected.velocity).max() < 1e-8


# Response


def still_grid(period: float, c: Complexes) -> _core.Sea:
    """A current uniform in space of one constituent of amplitude `c` (2,)."""
    axes = [(0.0, 1.0, 1)] * 3
    omega = 2 * math.pi / period
    return _core.Sea.constituents(period, axes, [(omega, 2)], c.reshape(1, 1, 1, 2))


@pytest.mark.parametrize("solver", [FULL, AVERAGED], ids=["full", "averaged"])
@pytest.mark.parametrize(("tides", "slip"), [(0, 0.4), (0.05, 1), (0.2, 0.5), (1, 1), (0.3, 1.5)])
def test_a_body_answers_the_tide_by_its_factor(
    solver: _core.Solver, tides: float, slip: float
) -> None:
    """Its excursion is |r| times that of the water, and turned by the argument of r."""
    period, c = 0.04, np.array([1.0 + 0.5j, -0.3 + 0.2j])
    omega, response = 2 * math.pi / period, tides * period
    calm = _core.WindPath(np.array([0.0, 1.0]), np.zeros((2, 2)))
    # What is left of the release decays within 14 responses at least.
    times = np.linspace(0.56, 1.0, 441)
    drift = fleet(still_grid(period, c), row(Body(response, slip)))
    (position, velocity, *_), _ = drift.trajectory(calm, solver, times)
    design = np.column_stack([np.ones_like(times), np.cos(omega * times), -np.sin(omega * times)])
    r = 1 - slip / (1 + 1j * omega * response)
    for found, amplitude in ((position, c / (1j * omega)), (velocity, c)):
        fit, rest, *_ = np.linalg.lstsq(design, found)
        assert fit[1] + 1j * fit[2] == pytest.approx(r * amplitude, abs=2e-6 * abs(c).max())
        assert rest.max() < 1e-10


# Stokes drift

RELEASED = "2026-07-01T00:00"
START = np.datetime64(RELEASED)
DEPTH, LATITUDE = 20.0, 45.0
SPEED = math.sqrt(9.81 * DEPTH)
CORIOLIS = 2 * 7.292e-5 * math.sin(math.radians(LATITUDE))
WATER = dc.FloatingBody(response_time_h=0, wind_factor=0)


class Wave:
    """Water set adrift in waves that run north, at their origin or west of it."""

    def __init__(
        self,
        make: Callable[..., dc.tides.TidalAtlas],
        levels: Mapping[str, float],
        *,
        days: float,
        west: float = 0.0,
        north: float = 0.0,
    ) -> None:
        longitude, latitude = -5 - west, LATITUDE + north
        around = np.arange(-12, 13) * 0.1
        atlas = make(
            longitude + around, latitude + around, levels, depth=DEPTH, origin=(-5.0, LATITUDE)
        )
        release = dc.Release.point(longitude, latitude, RELEASED)
        self.days = days
        self.scenario = dc.GeographicScenario(release, days, WATER, tides=atlas)
        middle = START + np.timedelta64(round(days * 12), "h")
        self.lines = atlas.constituents_at(middle, START)
        self.omega = self.lines["frequency"].values

    def path(self, model: Literal["full", "mean-flow"], every_h: float = 1.0) -> xr.Dataset:
        hours = np.arange(0, self.days * 24 + 1e-9, every_h)
        times = START + (hours * 3600).astype("timedelta64[s]")
        calm = dc.WindPath([START, START + np.timedelta64(1000, "D")], np.zeros((2, 2)))
        return dc.trajectory(self.scenario, calm, model=model, times=times, rtol=1e-10)


def seconds(path: xr.Dataset) -> Floats:
    return np.asarray((path["time"].values - START) / np.timedelta64(1, "s"))


def mean_speed(path: xr.Dataset, omega: Floats) -> float:
    """Northward speed [m/s]: a straight line beneath tides of frequencies ω and their sums."""
    t = seconds(path)
    metres = np.radians(path["latitude"].values - path["latitude"].values[0]) * RADIUS
    sums = {
        *omega,
        *np.add.outer(omega, omega).ravel(),
        *abs(np.subtract.outer(omega, omega)).ravel(),
    }
    waves = [f(s * t) for s in sums if s for f in (np.cos, np.sin)]
    return float(np.linalg.lstsq(np.column_stack([np.ones_like(t), t, *waves]), metres)[0][1])


@pytest.mark.parametrize("wave", ["progressive", "kelvin"])
def test_a_travelling_wave_carries_water_along(wave: str) -> None:
    """By U²/2c at order 1, and by c - √(c² - U²), the mean of X' = U cos(ωt - kX), in full."""
    level, west = 2.0, 0.5
    if wave == "kelvin":
        tide = Wave(dc.tides.kelvin_wave, {"M2": level}, days=10, west=west)
        speed = SPEED
        offshore = math.radians(west) * math.cos(math.radians(LATITUDE)) * 6.371e6
        current = level * math.sqrt(9.81 / DEPTH) * math.exp(-CORIOLIS * offshore / speed)
    else:
        tide = Wave(dc.tides.progressive_wave, {"M2": level}, days=10)
        k = math.sqrt(tide.omega[0] ** 2 - CORIOLIS**2) / SPEED
        speed, current = tide.omega[0] / k, level * tide.omega[0] / (k * DEPTH)
    current *= abs(tide.lines["factor"].values[0])
    stokes = tide.path("mean-flow")["mean_northward_velocity"].values
    assert stokes == pytest.approx(np.full(len(stokes), current**2 / (2 * speed)), rel=1e-4)
    exact = speed - math.sqrt(speed**2 - current**2)
    assert exact > 1.001 * stokes[0]
    doppler = tide.omega * (1 - exact / speed)
    assert mean_speed(tide.path("full", 0.25), doppler) == pytest.approx(exact, rel=2e-4)


@pytest.mark.parametrize("north", [0.0, 0.15, 0.4])
def test_a_standing_wave_carries_nothing(north: float) -> None:
    tide = Wave(dc.tides.standing_wave, {"M2": 0.4, "K1": 0.2}, days=30, north=north)
    assert np.abs(tide.path("mean-flow")["mean_northward_velocity"].values).max() < 1e-12
    # What a travelling wave of this current would do is 1e-3 m/s and more.
    full = tide.path("full", 0.25)
    assert abs(mean_speed(full, tide.omega)) < 1e-5


def test_the_stokes_drift_beats_from_springs_to_neaps() -> None:
    """½ Σ_kl U_k U_l cos((ω_k - ω_l)t + φ_k - φ_l)/c over pairs of one species."""
    levels = {"M2": 0.3, "S2": 0.15, "K1": 0.1}
    tide = Wave(dc.tides.kelvin_wave, levels, days=59)
    c = np.array(list(levels.values())) * tide.lines["factor"].values * math.sqrt(9.81 / DEPTH)
    species = tide.lines["species"].values
    averaged = tide.path("mean-flow")
    t = seconds(averaged)
    expected = np.zeros(len(t))
    for k, n in product(range(3), repeat=2):
        if species[k] == species[n]:
            beat = c[k] * np.conj(c[n]) * np.exp(1j * (tide.omega[k] - tide.omega[n]) * t)
            expected += tide.omega[k] / tide.omega[n] * beat.real / (2 * SPEED)
    found = averaged["mean_northward_velocity"].values
    assert found == pytest.approx(expected, rel=0.01)


# Leeway


def own_leeway(jibing_per_hour: float) -> dc.Leeway:
    """3 % and 5 cm/s downwind, 1.5 % and 4 cm/s to the right or 2 % and 1 cm/s to the left."""
    return dc.Leeway(
        category="measured",
        downwind=LeewayLine(slope_percent=3, offset_cm_s=5),
        right=LeewayLine(slope_percent=1.5, offset_cm_s=4),
        left=LeewayLine(slope_percent=-2, offset_cm_s=-1),
        jibing_per_hour=jibing_per_hour,
    )


def steady(wind: tuple[float, float], days: float) -> dc.WindPath:
    return dc.WindPath([START, START + np.timedelta64(round(days * 24) + 1, "h")], [wind, wind])


@pytest.mark.parametrize("model", ["full", "mean-flow"])
def test_leeway_of_a_steady_wind_is_a_rhumb_line(model: Literal["full", "mean-flow"]) -> None:
    wind, days, members = (6.0, 8.0), 10, 40
    drifter = own_leeway(0.0)
    release = dc.Release.point(-20.0, 30.0, RELEASED)
    scenario = dc.GeographicScenario(release, days, drifter)
    paths = [steady(wind, days)] * members
    forecast = dc.forecast(scenario, paths, model=model, seed=4, rtol=1e-10).dataset
    right = drifter.uniforms(4, 0, members)[:, 0] < 0.5
    assert 8 < right.sum() < 32
    # 10 m/s toward (0.6, 0.8), whose right is (0.8, -0.6): worked out by hand.
    velocity = np.where(
        right[:, None],
        0.35 * np.array([0.6, 0.8]) + 0.19 * np.array([0.8, -0.6]),
        0.35 * np.array([0.6, 0.8]) - 0.21 * np.array([0.8, -0.6]),
    )
    t = np.asarray((forecast["time"].values - START) / np.timedelta64(1, "s"))
    north = math.radians(30) + velocity[:, 1:] * t / RADIUS
    # A rhumb line is straight where latitudes are those of Mercator.
    mercator = np.arctanh(np.sin(north)) - math.atanh(0.5)
    east = math.radians(-20) + velocity[:, :1] / velocity[:, 1:] * mercator
    assert forecast["latitude"].values == pytest.approx(np.degrees(north), abs=1e-8)
    assert forecast["longitude"].values == pytest.approx(np.degrees(east), abs=1e-8)


def test_a_jibe_changes_the_side_at_the_rate_given() -> None:
    rate, days, members = 0.04, 20, 200
    drifter = own_leeway(rate)
    release = dc.Release.point(-20.0, 10.0, RELEASED)
    scenario = dc.GeographicScenario(release, days, drifter)
    times = START + np.arange(0, days * 24 * 4 + 1) * np.timedelta64(15, "m")
    # Toward north at 10 m/s: the right is east, by 0.19 m/s, the left west, by 0.21 m/s.
    runs = [
        dc.forecast(
            scenario, [steady((0.0, 10.0), days)] * members, model="full", times=times, seed=9,
            rtol=1e-9, chunk=chunk, threads=threads,
        ).dataset
        for chunk, threads in ((200, 2), (37, 1))
    ]  # fmt: skip
    assert runs[0].equals(runs[1])
    latitude = np.radians(runs[0]["latitude"].values)
    mercator = np.diff(np.arctanh(np.sin(latitude)), axis=1)
    east = np.diff(np.radians(runs[0]["longitude"].values), axis=1) / mercator * 0.35
    side = np.where(np.abs(east - 0.19) < 1e-4, 1, np.where(np.abs(east + 0.21) < 1e-4, -1, 0))
    assert (
        side[:, 0] == np.where(drifter.uniforms(9, 0, members)[:, 0] < 0.5, 1, -1)
    ).mean() > 0.97
    # A quarter of an hour without a jibe has probability e^(-rate/4), whatever was before.
    jibed, p = side == 0, 1 - math.exp(-rate / 4)
    assert ((east < 0.19 + 1e-4) & (east > -0.21 - 1e-4)).all()
    number, spread = jibed.sum(axis=1), math.sqrt(side.shape[1] * p * (1 - p))
    assert abs(number.mean() - side.shape[1] * p) < 4 * spread / math.sqrt(members)
    assert number.std() == pytest.approx(spread, rel=0.2)
    # The times of the jibes are even over the run, and sides change each time.
    half = jibed[:, : side.shape[1] // 2].sum() / jibed.sum()
    assert abs(half - 0.5) < 4 * 0.5 / math.sqrt(jibed.sum())
    alone = jibed[:, 1:-1] & (side[:, :-2] != 0) & (side[:, 2:] != 0)
    changed = (side[:, :-2] == -side[:, 2:])[alone]
    assert changed.mean() > 0.97  # two within a quarter of an hour: rate/8 = 0.5 % of them
