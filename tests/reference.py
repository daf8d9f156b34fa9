"""Naive NumPy/SciPy reference of every numerical function of driftcore.

Nothing here imports driftcore: each function restates one equation of Ailliot, Frénod & Monbet,
"Long term object drift forecast in the ocean with tide and wind" (2006), cited as "(3.10)", or of
its mean-flow counterpart, as plainly as possible, and pays for it in speed. Averages over the tidal
phase are quadratures, never closed forms; integrations stop at every kink of the wind.

Notation of the paper: ``M(t, θ, x)`` tide and ``N(t, θ, x)`` perturbation, 1-periodic in
``θ = t/ε``; sea velocity ``m = M + εN``; wind ``W``; drag rate ``Λ``; ``<·>`` the mean over θ.
Times, lengths and velocities are in any consistent units, and ``ε`` is the tide period in them.
A run starts at time 0 from position ``x`` and velocity ``v``; ``times`` are increasing and ≥ 0.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp
from scipy.interpolate import NdBSpline, RectBivariateSpline, make_interp_spline

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]

Point = Sequence[float] | Floats

PHASES = np.arange(64) / 64  # the trapezoid rule is exact up to harmonic 63
GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(5)  # on [-1, 1]


class Path(NamedTuple):
    """Position and velocity (time, 2), and the slow path beneath them in an averaged model."""

    position: Floats
    velocity: Floats
    mean_position: Floats = np.empty((0, 2))
    mean_velocity: Floats = np.empty((0, 2))


# Sea fields


class D(NamedTuple):
    """Orders of a partial derivative."""

    t: int = 0
    theta: int = 0
    x: int = 0
    y: int = 0


VALUE, RATE, PHASE_RATE = D(), D(t=1), D(theta=1)

Derivatives = Callable[[D], Floats]  # of one field at one place: a field (..., 2) and derivatives


class Sea(ABC):
    """Tide M and perturbation N with exact derivatives."""

    period: float

    @abstractmethod
    def tide(self, t: float, theta: Floats, x: Floats, d: D = VALUE) -> Floats:
        """M(t, θ, x) or a derivative (n, 2)."""

    @abstractmethod
    def perturbation(self, t: float, theta: Floats, x: Floats, d: D = VALUE) -> Floats:
        """N(t, θ, x) or a derivative (n, 2)."""

    def velocity(self, t: float, x: Floats) -> Floats:
        """Sea velocity (2,) m(t, x) = M + εN, (2.6)."""
        at = (t, np.array([t / self.period]), x)
        return np.asarray(self.tide(*at)[0] + self.period * self.perturbation(*at)[0])


class PaperSea(Sea):
    """The fields (4.1) and (4.2); ``period`` is the paper's ε."""

    def __init__(self, epsilon: float) -> None:
        self.period = epsilon

    def tide(self, t: float, theta: Floats, x: Floats, d: D = VALUE) -> Floats:
        """(2 + sin 6πt) x₁ (sin 2πθ + ¼ sin 4πθ, ½ sin 2πθ), (4.1)."""
        amplitude = 2.0 * (d.t == 0) + sine(6 * np.pi, t, d.t)
        first, second = sine(2 * np.pi, theta, d.theta), sine(4 * np.pi, theta, d.theta)
        x1 = (x[0], 1.0, 0.0)[min(d.x, 2)] * (d.y == 0)
        return amplitude * x1 * np.stack([first + second / 4, first / 2], axis=-1)

    def perturbation(self, t: float, theta: Floats, x: Floats, d: D = VALUE) -> Floats:
        """(2 + cos 6πt) x₂ (sin 2πθ, sin 2πθ), (4.2)."""
        amplitude = 2.0 * (d.t == 0) + sine(6 * np.pi, t + 1 / 12, d.t)
        x2 = (x[1], 1.0, 0.0)[min(d.y, 2)] * (d.x == 0)
        return amplitude * x2 * np.stack([sine(2 * np.pi, theta, d.theta)] * 2, axis=-1)


class RandomSea(Sea):
    """Harmonics that are cubic polynomials of t - ½, x - 1, y - 1 (so cubic splines are exact).

    Parameters
    ----------
    tide : complex (4, 4, 4, J, 2)
        Coefficients [power of t, of x, of y, harmonic j - 1, component] of Z_j in
        M = Σ_j Re[Z_j e^{2πijθ}].
    perturbation : complex (4, 4, 4, J + 1, 2)
        The same of P_j in εN = P_0 + Σ_j Re[P_j e^{2πijθ}]; P_0 is real.
    """

    def __init__(self, period: float, tide: Complexes, perturbation: Complexes) -> None:
        self.period, self.z, self.p = period, tide, perturbation

    def tide(self, t: float, theta: Floats, x: Floats, d: D = VALUE) -> Floats:
        """Σ_j Re[Z_j e^{2πijθ}]."""
        return harmonic_sum(1, polynomial(self.z, t, x, d), theta, d.theta)

    def perturbation(self, t: float, theta: Floats, x: Floats, d: D = VALUE) -> Floats:
        """{P_0 + Σ_j Re[P_j e^{2πijθ}]}/ε."""
        return harmonic_sum(0, polynomial(self.p, t, x, d), theta, d.theta) / self.period

    def sample_on_grid(self, x: Floats, y: Floats, t: Floats) -> tuple[Complexes, Complexes]:
        """Z (J, time, x, y, 2) and P (J + 1, time, x, y, 2) on a grid."""
        grid = [powers_of(s, 0) for s in (t - 0.5, x - 1, y - 1)]
        z, p = (np.einsum("abcjk,at,bx,cy->jtxyk", c, *grid) for c in (self.z, self.p))
        return z, p


def random_sea(rng: np.random.Generator, harmonics: int, period: float) -> RandomSea:
    """Smooth O(1) fields over t in [0, 1], x in [-1, 3]²; M and N do not depend on ``period``."""
    power = np.arange(4)
    decay = 0.5 ** np.add.outer(np.add.outer(power, 2 * power), 2 * power)[..., None, None]
    real, imaginary = rng.standard_normal((2, 4, 4, 4, 2 * harmonics + 1, 2))
    imaginary[..., harmonics, :] = 0  # P_0
    c = np.asarray(decay * (real + 1j * imaginary), dtype=np.complex128)
    tide = np.asarray(c[..., :harmonics, :] / np.arange(1, harmonics + 1)[:, None])
    return RandomSea(period, tide, np.asarray(period * c[..., harmonics:, :]))


def sine(rate: float, s: npt.ArrayLike, derivative: int) -> Floats:
    """Derivative of sin(rate · s) with respect to s."""
    return np.asarray(rate**derivative * np.sin(rate * np.asarray(s) + derivative * np.pi / 2))


def powers_of(s: npt.ArrayLike, derivative: int) -> Floats:
    """(4, ...): 1, s, s², s³, or their first or second derivative."""
    factor = np.array([[1, 1, 1, 1], [0, 1, 2, 3], [0, 0, 2, 6]])[derivative]
    exponent = np.maximum(np.arange(4) - derivative, 0)
    return np.asarray(factor * np.power.outer(np.asarray(s), exponent)).T


def polynomial(c: npt.NDArray[Any], t: float, x: Floats, d: D) -> npt.NDArray[Any]:
    """Σ c[a, b, c] (t - ½)^a (x - 1)^b (y - 1)^c, or a derivative of it."""
    for s, order in ((t - 0.5, d.t), (x[0] - 1, d.x), (x[1] - 1, d.y)):
        c = (powers_of(s, order) @ c.reshape(4, -1)).reshape(c.shape[1:])
    return c


def harmonic_sum(first: int, z: Complexes, theta: Floats, derivative: int) -> Floats:
    """Derivative in θ of Σ_j Re[z_j e^{2πijθ}], j from ``first``: z (J, 2) -> (n, 2)."""
    rate = 2j * np.pi * np.arange(first, first + len(z))
    return np.real(np.exp(np.multiply.outer(theta, rate)) @ (rate[:, None] ** derivative * z))


def harmonics(field: Derivatives, count: int, d: D = VALUE) -> Complexes:
    """Mean and Z_1 ... Z_count (count + 1, 2) of a field at PHASES by its Fourier integrals."""
    waves = np.exp(-2j * np.pi * np.multiply.outer(np.arange(count + 1), PHASES))
    z = waves @ field(d) / len(PHASES)
    return np.concatenate([z[:1], 2 * z[1:]])


def gradient(field: Derivatives) -> Floats:
    """(..., 2, 2) [component, direction]."""
    return np.stack([field(D(x=1)), field(D(y=1))], axis=-1)


def hessian(field: Derivatives) -> Floats:
    """(..., 2, 2, 2) [component, direction, direction]."""
    xx, xy, yy = field(D(x=2)), field(D(x=1, y=1)), field(D(y=2))
    return np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], axis=-1)


# Winds


class Wind(ABC):
    """A wind smooth between ``knots``."""

    knots: Floats = np.empty(0)

    @abstractmethod
    def __call__(self, t: float, x: Floats, d: D = VALUE) -> Floats:
        """W(t, x) (2,) or a derivative."""


class CubicWind(Wind):
    """A wind varying in space: real coefficients (4, 4, 4, 2) of ``polynomial``."""

    def __init__(self, coefficients: Floats) -> None:
        self.coefficients = coefficients

    def __call__(self, t: float, x: Floats, d: D = VALUE) -> Floats:
        """W(t, x) (2,) or a derivative."""
        return polynomial(self.coefficients, t, x, d)


class NaiveWind(Wind):
    """A wind uniform in space, linear between its knots: times (k,), velocity (k, 2)."""

    def __init__(self, times: npt.ArrayLike, velocity: npt.ArrayLike) -> None:
        self.knots = np.asarray(times, dtype=float)
        self.velocity = np.asarray(velocity, dtype=float)

    def __call__(self, t: float, x: Floats, d: D = VALUE) -> Floats:
        """W(t) (2,), whose derivatives in space vanish."""
        return self.value(t) if d == VALUE else np.zeros_like(x)

    def value(self, t: npt.ArrayLike) -> Floats:
        """W(t) (..., 2)."""
        t = np.asarray(t, dtype=float)
        if t.min() < self.knots[0] or t.max() > self.knots[-1]:
            raise ValueError(f"times {t.min()} to {t.max()} leave the path")
        return np.stack([np.interp(t, self.knots, w) for w in self.velocity.T], axis=-1)

    def integral(self, start: float, stop: float) -> Floats:
        """∫ W from ``start`` to ``stop``: the trapezoid rule over knots and ends is exact."""
        inside = self.knots[(self.knots > start) & (self.knots < stop)]
        nodes = np.concatenate([[start], inside, [stop]])
        return np.asarray(np.trapezoid(self.value(nodes), nodes, axis=0))

    def cumulative(self, t: npt.ArrayLike) -> Floats:
        """∫ W from the first knot to each t (..., 2): the trapezoids of ``integral``, summed."""
        t = np.asarray(t, dtype=float)
        cells = np.diff(self.knots)[:, None] * (self.velocity[1:] + self.velocity[:-1]) / 2
        before = np.concatenate([np.zeros((1, 2)), np.cumsum(cells, axis=0)])
        i = np.searchsorted(self.knots, t, side="right") - 1
        width = (t - self.knots[i])[..., None]
        return np.asarray(before[i] + width * (self.velocity[i] + self.value(t)) / 2)

    def mean(self, t: Floats, window: float) -> Floats:
        """<W>(t) (..., 2) over the centred window p, (3.14)."""
        return (self.cumulative(t + window / 2) - self.cumulative(t - window / 2)) / window

    def departure(self, t: Floats, period: float, window: float) -> Floats:
        """B_W(t) = (1/ε) ∫ W from ε⌊t/ε⌋ to t, less (t/ε - ⌊t/ε⌋) <W>(t), after (3.15)."""
        cell = np.floor(t / period)
        run = (self.cumulative(t) - self.cumulative(period * cell)) / period
        return np.asarray(run - np.asarray(t / period - cell)[..., None] * self.mean(t, window))

    def mean_departure(self, t: Floats, period: float, window: float) -> Floats:
        """<B_W>(t) = (1/ε) ∫ B_W from t - ε/2 to t + ε/2, at each t (..., 2).

        B_W is a cubic between knots, knots shifted by ±p/2 and whole tides, where the two-point
        Gauss rule is exact.
        """
        low, high = t.min() - period / 2, t.max() + period / 2
        tides = period * np.arange(np.floor(low / period), np.ceil(high / period) + 1)
        kinks = np.concatenate([self.knots, both_sides(self.knots, window / 2), tides])
        cuts = np.unique(np.append(kinks[(kinks > low) & (kinks < high)], low))

        def piece(start: Floats, stop: Floats) -> Floats:
            middle, half = (start + stop) / 2, (stop - start) / 2
            nodes = middle + np.multiply.outer([-1, 1], half / np.sqrt(3))
            return np.asarray(half[..., None] * self.departure(nodes, period, window).sum(axis=0))

        def cumulative(t: Floats) -> Floats:
            i = np.searchsorted(cuts, t, side="right") - 1
            return np.asarray(before[i] + piece(cuts[i], t))

        steps = piece(cuts[:-1], cuts[1:])
        before = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        return (cumulative(t + period / 2) - cumulative(t - period / 2)) / period

    def departure_rate(self, t: Floats, period: float, window: float) -> Floats:
        """<∂ₜB_W>(t) = {B_W(t + ε/2) - B_W(t - ε/2)}/ε: the derivative of <B_W>."""
        after = self.departure(t + period / 2, period, window)
        return (after - self.departure(t - period / 2, period, window)) / period


def both_sides(knots: Floats, shift: float) -> Floats:
    """Knots displaced by minus and plus ``shift``."""
    return np.concatenate([knots - shift, knots + shift])


# The full model


def full_4d(
    sea: Sea, wind: Wind, drag: float, x: Point, v: Point, times: Floats,
    rtol: float = 1e-12, atol: float = 1e-13,
) -> Path:  # fmt: skip
    """(2.8)-(2.9) as printed, total derivative expanded, with the drag rate of (2.2)."""
    eps = sea.period

    def rhs(t: float, state: Floats) -> Floats:
        x, v = state[:2], state[2:]
        theta = np.array([t / eps])
        m, n = (partial(field, t, theta, x) for field in (sea.tide, sea.perturbation))
        leading = m(PHASE_RATE) / eps + m(RATE) + n(PHASE_RATE) + gradient(m) @ v
        small = eps * (n(RATE) + gradient(n) @ v)
        return np.concatenate([v, (leading + small)[0] + drag * (wind(t, x) - v)])

    start = np.array([*x, *v], dtype=float)
    states = dop853(rhs, start, times, wind.knots, eps / 20, rtol, atol)
    return Path(states[:, :2], states[:, 2:])


def full_general(
    sea: Sea, wind: Callable[[float, Floats], Floats], x: Point, v: Point,
    times: Floats, response_time: float = 1.0, wind_factor: float = 1.0,
    knots: npt.ArrayLike = (), rtol: float = 1e-12, atol: float = 1e-13,
) -> Path:  # fmt: skip
    """X' = m + U, U' = (α(W - m) - U)/τ for a wind W(t, x) smooth between ``knots``.

    α = 1, τ = 1/Λ is (2.1)-(2.2) with U = V - m; τ = 0 is X' = (1 - α)m + αW, whatever ``v``.
    """

    def rhs(t: float, state: Floats) -> Floats:
        current = sea.velocity(t, state[:2])
        target = wind_factor * (wind(t, state[:2]) - current)
        if response_time == 0:
            return current + target
        return np.concatenate([current + state[2:], (target - state[2:]) / response_time])

    start = np.asarray(x, dtype=float)
    if response_time > 0:
        start = np.append(start, v - sea.velocity(0.0, start))
    knots = np.asarray(knots, dtype=float)
    states = dop853(rhs, start, times, knots, sea.period / 20, rtol, atol)
    velocity = [rhs(t, state)[:2] for t, state in zip(times, states, strict=True)]
    return Path(states[:, :2], np.array(velocity))


class Body(NamedTuple):
    """A floating body: X' = m + U, U' = (F(W) - αm - U)/τ, where the wind also drives the water.

    Lines are (slope, offset) of the wind's speed; crosswind is to the right of the wind.
    """

    response: float = 0.0
    slip: float = 0.0
    downwind: tuple[float, float] = (0.0, 0.0)
    crosswind: tuple[float, float] = (0.0, 0.0)
    surface_current: tuple[float, float] = (0.0, 0.0)

    def leeway(self, wind: Floats) -> Floats:
        """F(W) (2,)."""
        speed = np.hypot(*wind)
        if speed == 0:
            return np.zeros(2)
        lines = [slope * speed + offset for slope, offset in (self.downwind, self.crosswind)]
        return turned(wind / speed, *lines)


def turned(along: Floats, ahead: float, right: float) -> Floats:
    """``ahead`` of a vector (2,) and ``right`` of the same turned to its right."""
    return ahead * along + right * np.array([along[1], -along[0]])


class GriddedTide:
    """Constituents (frequency, (nx, ny, 2) complex) on a grid, by SciPy's bicubic splines."""

    def __init__(self, x: Floats, y: Floats, constituents: Sequence[tuple[float, Complexes]]):
        self.constituents = [
            [omega, *(RectBivariateSpline(x, y, f(c)) for c in z.T.swapaxes(1, 2) for f in PARTS)]
            for omega, z in constituents
        ]

    def velocity(self, t: float, x: Floats) -> Floats:
        """Σ_k Re[c_k e^{iω_k t}] (2,)."""
        total = np.zeros(2)
        for omega, *splines in self.constituents:
            real0, imaginary0, real1, imaginary1 = (float(s(*x)[0, 0]) for s in splines)
            c = np.array([real0 + 1j * imaginary0, real1 + 1j * imaginary1])
            total += np.real(c * np.exp(1j * omega * t))
        return total


PARTS = (np.real, np.imag)


class GriddedCurrent:
    """A current (nt, nx, ny, 2) on a grid, by SciPy's tricubic splines."""

    def __init__(self, t: Floats, x: Floats, y: Floats, values: Floats) -> None:
        knots = []
        for axis, points in enumerate((t, x, y)):
            spline = make_interp_spline(points, values, axis=axis)
            knots.append(spline.t)
            values = np.moveaxis(spline.c, 0, axis)
        self.spline = NdBSpline(tuple(knots), values, 3)

    def velocity(self, t: float, x: Floats) -> Floats:
        """R(t, x) (2,)."""
        return np.asarray(self.spline([t, *x]))


def full_body(
    water: Callable[[float, Floats], Floats], wind: NaiveWind, body: Body, x: Point, v: Point,
    times: Floats, step: float, rtol: float = 1e-11, atol: float = 1e-13,
) -> Path:  # fmt: skip
    """Drift of a body released at time 0 with velocity ``v`` (where τ > 0), on the plane."""

    def rhs(t: float, state: Floats) -> Floats:
        now = wind.value(t)
        current = water(t, state[:2]) + turned(now, *body.surface_current)
        target = body.leeway(now) - body.slip * current
        if body.response == 0:
            return current + target
        return np.concatenate([current + state[2:], (target - state[2:]) / body.response])

    start = np.asarray(x, dtype=float)
    if body.response > 0:
        current = water(0.0, start) + turned(wind.value(0.0), *body.surface_current)
        start = np.concatenate([start, v - current])
    states = dop853(rhs, start, times, wind.knots, step, rtol, atol)
    velocity = [rhs(t, state)[:2] for t, state in zip(times, states, strict=True)]
    return Path(states[:, :2], np.array(velocity))


def dop853(
    rhs: Callable[[float, Floats], Floats], state: Floats, times: Floats, knots: Floats,
    step: float, rtol: float, atol: float,
) -> Floats:  # fmt: skip
    """States (time, n) at ``times``, restarted, with ``step``, at every knot and output time."""
    t, states = 0.0, {0.0: state}
    for stop in np.union1d(knots[(knots > 0) & (knots < times[-1])], times[times > 0]):
        h = min(step, stop - t)
        leg = solve_ivp(rhs, (t, stop), state, "DOP853", rtol=rtol, atol=atol, first_step=h)
        t, state = float(stop), leg.y[:, -1]
        states[t] = state
    return np.array([states[float(t)] for t in times])


# Averaged models


def steps_and_stages(times: Floats, kinks: Floats, step: float) -> tuple[Floats, Floats]:
    """Step ends (n + 1,) from 0 through all kinks and output times, and RK4 stage times (n, 3).

    The first and last stage are pulled inwards by 1e-7 of a step: <∂ₜB_W> jumps at half tides.
    """
    even = np.linspace(0, times[-1], int(np.ceil(times[-1] / step)) + 1)
    ends = np.union1d(np.union1d(even, times), kinks[(kinks > 0) & (kinks < times[-1])])
    # A kink within rounding of another step end is that end; every output time stays.
    ends = ends[(np.diff(ends, prepend=-1.0) > 1e-9 * step) | np.isin(ends, times)]
    return ends, ends[:-1, None] + np.multiply.outer(np.diff(ends), [1e-7, 0.5, 1 - 1e-7])


def rk4(rhs: Callable[[int, int, Floats], Floats], state: Floats, ends: Floats) -> Floats:
    """States (n + 1, m) at the step ends; ``rhs(step, stage, state)`` with stages 0, 1, 2."""
    states = [state]
    for i, h in enumerate(np.diff(ends)):
        k1 = rhs(i, 0, state)
        k2 = rhs(i, 1, state + h / 2 * k1)
        k3 = rhs(i, 1, state + h / 2 * k2)
        k4 = rhs(i, 2, state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        states.append(state)
    return np.array(states)


def integral_from_zero(sample: Callable[[Floats], Floats]) -> Floats:
    """∫₀^θ at PHASES (64, ...) by the five-point Gauss rule between neighbouring phases."""
    values = sample(np.add.outer(PHASES, (GAUSS_NODES + 1) / 128).ravel())
    cells = np.tensordot(GAUSS_WEIGHTS / 128, values.reshape(64, 5, *values.shape[1:]), (0, 1))
    return np.cumsum(cells, axis=0) - cells


def stroboscopic(
    sea: Sea, wind: NaiveWind, x: Point, v: Point, drag: float, times: Floats,
    order: int, window: float, wind_terms: bool = True, step: float | None = None,
) -> Path:  # fmt: skip
    """The paper's expansion (3.4)-(3.11), order 0 or 1, for a wind uniform in space.

    (3.11) is corrected (``<∫∇M>U⁰``, not ``<∫M>U⁰``) and the drag rate carried through: the
    appendix's B¹ becomes N - N(0) + Λ(B_W - A¹) with A¹ = ∫₀^θ M. U⁰(0) = v - M(0, 0, x).
    ``wind_terms=False`` leaves B_W out; ``step`` (default ε/40) bounds the Runge-Kutta step.
    Slow path: Y⁰ + εY¹ and U⁰ + εU¹.
    """
    x, eps, zero = np.asarray(x, dtype=float), sea.period, np.array([0.0])
    kinks = both_sides(wind.knots, window / 2)
    if wind_terms:
        half_tides = eps * (np.arange(np.ceil(times[-1] / eps)) + 0.5)
        kinks = np.concatenate(
            [kinks, *(both_sides(k, eps / 2) for k in (kinks, wind.knots)), half_tides]
        )
    ends, stages = steps_and_stages(times, kinks, step or eps / 40)
    wind_mean = wind.mean(stages, window)
    b_wind = b_wind_rate = np.zeros_like(wind_mean)
    if wind_terms:
        b_wind = wind.mean_departure(stages, eps, window)
        b_wind_rate = wind.departure_rate(stages, eps, window)

    def rhs(i: int, stage: int, state: Floats) -> Floats:
        y0, u0, _, u1 = state.reshape(4, 2)
        u0_rate = drag * (wind_mean[i, stage] - u0)  # (3.9)
        if order == 0:
            return np.concatenate([u0, u0_rate, np.zeros(4)])
        t = stages[i, stage]
        a = integral_from_zero(lambda theta: sea.tide(t, theta, y0))
        a_rate = integral_from_zero(lambda theta: sea.tide(t, theta, y0, RATE)).mean(axis=0)
        a_gradient = integral_from_zero(
            lambda theta: gradient(partial(sea.tide, t, theta, y0))
        ).mean(axis=0)
        m_gradient = gradient(partial(sea.tide, t, PHASES, y0))
        stokes = np.einsum("kij,kj->ki", m_gradient, a).mean(axis=0)
        n_mean = sea.perturbation(t, PHASES, y0).mean(axis=0)
        start = partial(sea.perturbation, t, zero, y0)
        n, n_rate, n_gradient = start(VALUE)[0], start(RATE)[0], gradient(start)[0]
        b = n_mean - n + drag * (b_wind[i, stage] - a.mean(axis=0))
        y1_rate = stokes + u1 + b - a_gradient @ u0 - a_rate  # (3.10)
        u1_rate = (  # (3.11)
            -drag * (stokes + u1 + b)
            + (n_gradient + drag * a_gradient) @ u0
            + (n_rate - drag * b_wind_rate[i, stage] + drag * a_rate)
        )
        return np.concatenate([u0, u0_rate, y1_rate, u1_rate])  # u0: (3.8)

    def reconstruct(t: float, state: Floats) -> tuple[Floats, Floats]:
        y0, u0, y1, u1 = state.reshape(4, 2)
        theta = np.array([t / eps])
        m, m_gradient = sea.tide(t, theta, y0)[0], gradient(partial(sea.tide, t, theta, y0))[0]
        if order == 0:
            return y0, m + u0  # (3.4), (3.5)
        nodes, weights = np.polynomial.legendre.leggauss(40)
        half = (theta - np.floor(theta)) / 2
        a = half * (weights @ sea.tide(t, half * (nodes + 1), y0))
        n = sea.perturbation(t, theta, y0)[0] - sea.perturbation(t, zero, y0)[0]
        b = wind.departure(np.asarray(t), eps, window) if wind_terms else zero
        x1 = y1 + a  # (3.6)
        v1 = m_gradient @ x1 + u1 + n + drag * (b - a)  # (3.7)
        return y0 + eps * x1, m + u0 + eps * v1

    u = v - sea.tide(0.0, zero, x)[0]
    states = rk4(rhs, np.concatenate([x, u, np.zeros(4)]), ends)[np.searchsorted(ends, times)]
    position, velocity = zip(*map(reconstruct, times, states), strict=True)
    slow = states[:, :4] + eps * states[:, 4:]
    return Path(np.array(position), np.array(velocity), slow[:, :2], slow[:, 2:])


def antiderivative(samples: Floats) -> Floats:
    """Zero-mean antiderivative ∫~ in θ of samples (64, ...) at evenly spaced phases."""
    rate = 2j * np.pi * np.fft.fftfreq(64, 1 / 64)
    rate[0] = np.inf  # of the mean, nothing
    return np.real(np.fft.ifft((np.fft.fft(samples, axis=0).T / rate).T, axis=0))


def mean_flow_terms(
    sea: Sea, wind: Wind, drag: float, t: float, y: Floats, q: Floats, order: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Near-identity averaging of X' = M + εN + Q - ΛX, Q' = ΛW(t, X), zero means in θ.

    X = Y + a and Q = Q̄ + q₂; at one (t, Y, Q̄): a = a₁ (+ a₂), q₂, Y' and Q̄', each (2,).
    """
    eps, theta = sea.period, t / sea.period + PHASES  # sample 0 is the present phase
    flow = q - drag * y  # F
    m, n = (partial(field, t, theta, y) for field in (sea.tide, sea.perturbation))
    m_gradient = gradient(m)
    a1 = eps * antiderivative(m(VALUE))
    stokes = np.einsum("kij,kj->ki", m_gradient, a1)
    rate = flow + stokes.mean(axis=0) + eps * n(VALUE).mean(axis=0)  # F + f₁
    if order == 1:
        return a1[0], np.zeros(2), rate, drag * wind(t, y)
    a1_gradient = eps * antiderivative(m_gradient)
    a1_rate = eps * antiderivative(m(RATE))
    # The antiderivative ignores the means that the equation for a₂ subtracts.
    a2 = eps * antiderivative(stokes - drag * a1 + eps * n(VALUE) - a1_rate - a1_gradient @ flow)
    f2 = (
        np.einsum("kij,kj->ki", m_gradient, a2)
        + np.einsum("kijl,kj,kl->ki", hessian(m), a1, a1) / 2
        + eps * np.einsum("kij,kj->ki", gradient(n), a1)
    )
    q2 = eps * drag * antiderivative(a1 @ gradient(partial(wind, t, y)).T)
    curvature = np.einsum("ijl,kj,kl->ki", hessian(partial(wind, t, y)), a1, a1).mean(axis=0) / 2
    return (a1 + a2)[0], q2[0], rate + f2.mean(axis=0), drag * (wind(t, y) + curvature)


def mean_flow(
    sea: Sea, wind: Wind, x: Point, v: Point, drag: float, times: Floats,
    order: int, step: float | None = None,
) -> Path:  # fmt: skip
    """Mean-flow expansion of order 1 or 2; slow path Y and Y'; ``step`` as in stroboscopic."""
    ends, stages = steps_and_stages(times, wind.knots, step or sea.period / 40)

    def terms(t: float, state: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        return mean_flow_terms(sea, wind, drag, t, state[:2], state[2:], order)

    def rhs(i: int, stage: int, state: Floats) -> Floats:
        return np.concatenate(terms(stages[i, stage], state)[2:])

    x = np.asarray(x, dtype=float)
    start = np.concatenate([x, v - sea.velocity(0.0, x) + drag * x])  # X(0), Q(0) = V - m + ΛX
    state = start
    for _ in range(200):  # contracts like ε|∇M|
        state = start - np.concatenate(terms(0.0, state)[:2])
    states = rk4(rhs, state, ends)[np.searchsorted(ends, times)]
    now = [np.array(terms(t, state)) for t, state in zip(times, states, strict=True)]
    a, q2, rate, _ = np.stack(now, axis=1)
    position = states[:, :2] + a
    current = np.array([sea.velocity(t, p) for t, p in zip(times, position, strict=True)])
    return Path(position, current + states[:, 2:] + q2 - drag * position, states[:, :2], rate)


# Stochastic wind


def lgb_weights(states: Floats, whitening: Floats, h: float, y: Floats) -> Floats:
    """Kernel weights (n,), summing to 1, of the catalogue states (n, d) seen from state y (d,)."""
    squares = np.sum(((states - y) @ whitening.T) ** 2, axis=1)
    w = np.exp(-(squares - squares.min()) / (2 * h**2))
    return np.asarray(w / w.sum())


def lgb_step(
    weights: Floats, u: float, y: Floats, target: Floats, predictor: Floats, noise: Floats,
    xi: Floats,
) -> tuple[int, Floats]:  # fmt: skip
    """Row drawn by the inverse distribution function at u in [0, 1), and the next state (d,).

    The next anomaly is c + A y + target[row] + noise ξ with predictor = [c | A]; states hold the
    newest anomaly first.
    """
    row = min(int(np.searchsorted(np.cumsum(weights), u, side="right")), len(weights) - 1)
    anomaly = predictor[:, 0] + predictor[:, 1:] @ y + target[row] + noise @ xi
    return row, np.concatenate([anomaly, y[:-2]])


def ar1_path(w0: npt.ArrayLike, a: float, sigma: float, normals: Floats) -> Floats:
    """w_k = a w_{k-1} + σ E_k, (4.3): normals (n, ...) -> path (n + 1, ...) from w0 (...)."""
    path = [np.asarray(w0, dtype=float)]
    for e in normals:
        path.append(a * path[-1] + sigma * e)
    return np.array(path)


def ar1_moments(n: int, a: float, sigma: float, step: float) -> tuple[Floats, Floats]:
    """Mean (2,) per unit w_0 and covariance (2, 2) of (w_n, ∫) by the closed form.

    ∫ is the integral over n steps of the linear interpolation of the path.
    """
    alpha, once, twice = 1 / (1 - a), (1 - a**n) / (1 - a), (1 - a ** (2 * n)) / (1 - a**2)
    beta = alpha - 0.5
    mean = np.array([a**n, step * (0.5 + a * (1 - a ** (n - 1)) / (1 - a) + a**n / 2)])
    cross = step * (alpha * once - beta * twice)
    area = step**2 * (n * alpha**2 - 2 * alpha * beta * once + beta**2 * twice)
    return mean, sigma**2 * np.array([[twice, cross], [cross, area]])


def ar1_joint(n: int, a: float, sigma: float, step: float) -> tuple[Floats, Floats]:
    """Mean (n + 1,) per unit w_0 and covariance (n + 1, n + 1) of (w_1, ..., w_n, ∫).

    Every w_i is aⁱ w_0 + σ Σ_{k ≤ i} a^{i-k} E_k and the integral a sum of them: one matrix.
    """
    lag = np.subtract.outer(np.arange(n), np.arange(n))
    response = np.where(lag >= 0, a ** np.maximum(lag, 0), 0.0)  # of w_i to σE_k
    rows = np.vstack([np.eye(n), step * np.append(np.ones(n - 1), 0.5)])
    mean = rows @ a ** np.arange(1.0, n + 1) + np.append(np.zeros(n), step / 2)
    return mean, sigma**2 * rows @ response @ response.T @ rows.T


def ar1_bridge(
    n: int, a: float, sigma: float, step: float, w0: float, wn: float, area: float
) -> tuple[Floats, Floats]:
    """Mean (n - 1,) and covariance of the inner path w_1 ... w_{n-1} given w_0, w_n and ∫."""
    mean, covariance = ar1_joint(n, a, sigma, step)
    cross, inner = covariance[: n - 1, n - 1 :], covariance[: n - 1, : n - 1]
    gain = cross @ np.linalg.inv(covariance[n - 1 :, n - 1 :])
    surprise = np.array([wn, area]) - mean[n - 1 :] * w0
    return mean[: n - 1] * w0 + gain @ surprise, inner - gain @ cross.T


# Coasts and statistics


class Circle(NamedTuple):
    """A circular coast."""

    center: tuple[float, float]
    radius: float


def encloses(coast: Circle | list[Floats], p: Floats) -> bool:
    """Whether p (2,) is inside the circle, or inside an odd number of rings (k, 2)."""
    if isinstance(coast, Circle):
        return bool(np.hypot(*(p - coast.center)) < coast.radius)
    crossings = 0
    for ring in coast:
        for (x0, y0), (x1, y1) in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            if (y0 > p[1]) != (y1 > p[1]):
                crossings += p[0] < x0 + (p[1] - y0) / (y1 - y0) * (x1 - x0)
    return crossings % 2 == 1


def first_crossing(
    times: Floats, positions: Floats, coast: Circle | list[Floats], side: str
) -> tuple[float, Floats] | None:
    """First time and position ashore on the path linear between dense samples, else None.

    ``side`` says where the water is: "inside" or "outside" the coast.
    """

    def ashore(p: Floats) -> bool:
        return encloses(coast, p) != (side == "inside")

    i = next((i for i, p in enumerate(positions) if ashore(p)), None)
    if i is None:
        return None
    if i == 0:
        return float(times[0]), positions[0]
    leg, duration = positions[i] - positions[i - 1], times[i] - times[i - 1]
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if ashore(positions[i - 1] + middle * leg) else (middle, high)
    return float(times[i - 1] + high * duration), positions[i - 1] + high * leg


def wilson_interval(count: int, total: int, level: float = 0.95) -> tuple[float, float]:
    """Wilson's score interval: the p with |count/total - p| = z √{p(1 - p)/total}."""
    z, n, p = NormalDist().inv_cdf((1 + level) / 2), total, count / total
    centre, half = p + z**2 / (2 * n), z * np.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    return float((centre - half) / (1 + z**2 / n)), float((centre + half) / (1 + z**2 / n))
