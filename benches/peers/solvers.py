"""The paper's full system solved by driftcore and by its peers: the jobs of `worker.py`.

Every peer but driftcore gets equations (2.8)-(2.9) as the paper prints them, the total derivative
written out: four unknowns, and a factor 1/ε in the right-hand side. All follow the same bodies,
released at rest at (1, 1), from t = 0 to 1 under the same winds in memory, linear between knots
ε/100 apart. Laying winds out as a solver likes them is preparation and not timed, as is compiling.

A peer is made from the folder of the winds and called with (members, setting); the setting is its
tolerance, or how many steps a tide it takes. It gives a job, which returns the positions at t = 1
and how often the right-hand side was evaluated for one trajectory.
"""

from __future__ import annotations

import ctypes
import json
import math
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

EPSILON = 1 / 50
KNOTS = 5000  # intervals between knots: a hundred in each tide
TIMES = np.arange(KNOTS + 1) / KNOTS
START = (1.0, 1.0, 0.0, 0.0)

Job = Callable[[], tuple[list[list[float]], float | None]]
Peer = Callable[[int, Any], Job]


def body(sin: Any, cos: Any) -> Any:
    """Give the right-hand side of (2.8)-(2.9) with Λ = 1 in terms of somebody's sine and cosine."""

    def rates(t, x, y, u, v, wind_x, wind_y):
        omega, slow = 2 * math.pi / EPSILON, 6 * math.pi * t
        sin_1, cos_1, sin_slow, cos_slow = sin(omega * t), cos(omega * t), sin(slow), cos(slow)
        a, a_rate = 2 + sin_slow, 6 * math.pi * cos_slow
        b, b_rate = 2 + cos_slow, -6 * math.pi * sin_slow
        # sin 4πθ / 4 and its derivative by the double angle
        wave, wave_rate = sin_1 + sin_1 * cos_1 / 2, omega * (cos_1 + 0.5 - sin_1 * sin_1)
        tide, tide_change = a * x, a_rate * x + a * u
        residual = EPSILON * (omega * b * y * cos_1 + (b_rate * y + b * v) * sin_1)
        u_rate = tide * wave_rate + tide_change * wave + residual + wind_x - u
        v_rate = (tide * omega * cos_1 + tide_change * sin_1) / 2 + residual + wind_y - v
        return u, v, u_rate, v_rate

    return rates


def sea(t: Any, x: Any, y: Any) -> Any:
    """Give the paper's current (2, ...) at times and places, (4.1)-(4.2)."""
    angle, slow = 2 * np.pi * t / EPSILON, 6 * np.pi * t
    tide = (2 + np.sin(slow)) * x
    residual = EPSILON * (2 + np.cos(slow)) * y * np.sin(angle)
    wave = np.sin(angle) + np.sin(2 * angle) / 4
    return np.stack([tide * wave + residual, tide * np.sin(angle) / 2 + residual])


def load_winds(folder: str, members: int) -> Any:
    """Winds (members, knots, 2) of the first members, mapped from the file."""
    return np.load(Path(folder) / "winds.npy", mmap_mode="r")[:members]


def scipy_rk45(folder: str) -> Peer:
    """`solve_ivp`, method RK45, tolerance `setting`."""
    from scipy.integrate import solve_ivp

    rates = body(math.sin, math.cos)

    def follow(wind: Any, tolerance: float) -> Any:
        knots_x, knots_y = wind[:, 0].tolist(), wind[:, 1].tolist()

        def rhs(t: float, state: Any) -> Any:
            knot = min(int(t * KNOTS), KNOTS - 1)
            part = t * KNOTS - knot
            wind_x = knots_x[knot] + part * (knots_x[knot + 1] - knots_x[knot])
            wind_y = knots_y[knot] + part * (knots_y[knot + 1] - knots_y[knot])
            return rates(t, *state.tolist(), wind_x, wind_y)

        return solve_ivp(rhs, (0.0, 1.0), START, method="RK45", rtol=tolerance, atol=tolerance)

    def peer(members: int, setting: Any) -> Job:
        winds = np.array(load_winds(folder, members))

        def job() -> Any:
            solutions = [follow(wind, setting) for wind in winds]
            count = sum(solution.nfev for solution in solutions)
            return [s.y[:2, -1].tolist() for s in solutions], count / members

        return job

    return peer


def numba_dopri5(folder: str) -> Peer:
    """Adaptive Dormand-Prince compiled by numba, tolerance `setting`; see `_dopri5`."""
    import numba

    rates = numba.njit(body(math.sin, math.cos))
    integrate = numba.njit(_dopri5(rates))

    def follow(winds, tolerance, positions):
        count = 0
        for m in range(len(winds)):
            positions[m, 0], positions[m, 1], evaluations = integrate(winds[m], tolerance)
            count += evaluations
        return count

    follow = numba.njit(follow)

    def peer(members: int, setting: Any) -> Job:
        winds, positions = np.array(load_winds(folder, members)), np.empty((members, 2))
        follow(winds[:1], 1e-3, positions)  # compiles

        def job() -> Any:
            count = follow(winds, setting, positions)
            return positions.tolist(), count / members

        return job

    return peer


def _dopri5(rates: Any) -> Any:
    """Dormand & Prince (1980) with the step control of Hairer, Nørsett & Wanner, II.4."""
    nodes = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
    weights = np.zeros((7, 6))
    weights[1, :1] = [1 / 5]
    weights[2, :2] = [3 / 40, 9 / 40]
    weights[3, :3] = [44 / 45, -56 / 15, 32 / 9]
    weights[4, :4] = [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729]
    weights[5, :5] = [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656]
    weights[6, :6] = [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84]
    fourth = [5179 / 57600, 0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40]
    error_weights = np.append(weights[6], 0) - np.array(fourth)

    def integrate(wind, tolerance):
        state, trial, stage = np.array(START), np.empty(4), np.empty((7, 4))
        t, h, count, first = 0.0, 1 / KNOTS, 0, 0
        while t < 1:
            h = min(h, 1 - t)
            for s in range(first, 7):
                for i in range(4):
                    trial[i] = state[i]
                    for r in range(s):
                        trial[i] += h * weights[s, r] * stage[r, i]
                at = t + nodes[s] * h
                knot = min(int(at * KNOTS), KNOTS - 1)
                part = at * KNOTS - knot
                wind_x = wind[knot, 0] + part * (wind[knot + 1, 0] - wind[knot, 0])
                wind_y = wind[knot, 1] + part * (wind[knot + 1, 1] - wind[knot, 1])
                x, y, u, v = trial
                stage[s, 0], stage[s, 1], stage[s, 2], stage[s, 3] = rates(
                    at, x, y, u, v, wind_x, wind_y
                )
                count += 1
            square = 0.0
            for i in range(4):
                error = 0.0
                for s in range(7):
                    error += h * error_weights[s] * stage[s, i]
                scale = tolerance * (1 + max(abs(state[i]), abs(trial[i])))
                square += (error / scale) ** 2 / 4
            if square <= 1:
                t = 1.0 if h == 1 - t else t + h
                state[:] = trial
                stage[0] = stage[6]
            first = 1  # the last stage of a step is the first of the next
            h *= min(5.0, max(0.2, 0.9 * max(square, 1e-20) ** -0.1))
        return state[0], state[1], count

    return integrate


def odeint(folder: str) -> Peer:
    """Boost odeint, controlled runge_kutta_dopri5 of tolerance `setting`; RK4 on the knots if 0."""
    library = ctypes.CDLL(str(Path(folder) / "odeint.so"))
    library.solve.argtypes = [ctypes.c_double] * 2 + [ctypes.c_void_p] + [ctypes.c_size_t] * 2
    library.solve.argtypes = [*library.solve.argtypes, ctypes.c_void_p]
    library.solve.restype = ctypes.c_size_t

    def peer(members: int, setting: Any) -> Job:
        winds, positions = np.array(load_winds(folder, members)), np.empty((members, 2))

        def job() -> Any:
            count = library.solve(
                EPSILON, setting, winds.ctypes.data, members, KNOTS, positions.ctypes.data
            )
            return positions.tolist(), count / members

        return job

    return peer


def rust_lanes(folder: str) -> Peer:
    """RK4 on the knots in Rust, sixteen members at a time: `rk4_lanes.rs`."""
    library = ctypes.CDLL(str(Path(folder) / "rust-lanes.so"))
    library.solve.argtypes = [ctypes.c_double, ctypes.c_void_p, *[ctypes.c_size_t] * 2]
    library.solve.argtypes = [*library.solve.argtypes, ctypes.c_void_p]
    library.solve.restype = None

    def peer(members: int, setting: Any) -> Job:
        del setting
        width = 16
        blocks = -(-members // width)
        winds = np.zeros((blocks * width, KNOTS + 1, 2))
        winds[:members] = load_winds(folder, members)
        winds = winds.reshape(blocks, width, KNOTS + 1, 2)
        lanes = np.ascontiguousarray(winds.transpose(0, 2, 3, 1))
        out = np.empty((blocks, 2, width))

        def job() -> Any:
            library.solve(EPSILON, lanes.ctypes.data, blocks, KNOTS + 1, out.ctypes.data)
            positions = out.transpose(0, 2, 1).reshape(-1, 2)[:members]
            return positions.tolist(), 4 * KNOTS

        return job

    return peer


def jax_rk4(folder: str) -> Peer:
    """`jax.lax.scan` of RK4 on the knots, vmapped and jitted."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    rates = body(jnp.sin, jnp.cos)
    h = 1 / KNOTS

    def step(state: Any, at: Any) -> Any:
        k, start, end = at
        t = k * h
        middle = 0.5 * (start[0] + end[0]), 0.5 * (start[1] + end[1])

        def moved(length: float, rate: Any) -> Any:
            return tuple(s + length * r for s, r in zip(state, rate, strict=True))

        k1 = rates(t, *state, *start)
        k2 = rates(t + h / 2, *moved(h / 2, k1), *middle)
        k3 = rates(t + h / 2, *moved(h / 2, k2), *middle)
        k4 = rates(t + h, *moved(h, k3), *end)
        mean = [(a + 2 * (b + c) + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)]
        return moved(h, mean), None

    def follow(wind: Any) -> Any:
        start, end = (w[:-1] for w in wind), (w[1:] for w in wind)
        inputs = (jnp.arange(KNOTS), tuple(start), tuple(end))
        return jax.lax.scan(step, tuple(map(jnp.asarray, START)), inputs)[0][:2]

    solve = jax.jit(jax.vmap(follow, in_axes=1))

    def peer(members: int, setting: Any) -> Job:
        del setting
        # Members last: they are what JAX turns into vectors, and no axis moves in the job.
        winds = np.moveaxis(load_winds(folder, members), 0, 2)
        wind = tuple(jax.device_put(np.ascontiguousarray(winds[:, i])) for i in (0, 1))
        jax.block_until_ready(solve(wind))  # compiles

        def job() -> Any:
            return np.stack(solve(wind), axis=-1).tolist(), 4 * KNOTS

        return job

    return peer


def diffrax_dopri5(folder: str) -> Peer:
    """Dopri5 of diffrax, vmapped and jitted, tolerance `setting`; stepping to the knots if 0."""
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    rates = body(jnp.sin, jnp.cos)

    def field(t: Any, state: Any, wind: Any) -> Any:
        knot = jnp.minimum((t * KNOTS).astype(int), KNOTS - 1)
        part = t * KNOTS - knot
        return rates(t, *state, *(w[knot] + part * (w[knot + 1] - w[knot]) for w in wind))

    def follow(wind: Any, tolerance: Any) -> Any:
        adaptive = tolerance is not None
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(field),
            diffrax.Dopri5(),
            t0=0.0,
            t1=1.0,
            dt0=1 / KNOTS if adaptive else None,
            y0=tuple(map(jnp.asarray, START)),
            args=wind,
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance)
            if adaptive
            else diffrax.StepTo(ts=jnp.arange(KNOTS + 1) / KNOTS),
            max_steps=None,  # a plain loop: nothing is kept for a backward pass
        )
        x, y, *_ = solution.ys
        return x[-1], y[-1], solution.stats["num_steps"]

    solve = jax.jit(jax.vmap(follow, in_axes=(0, None)))

    def peer(members: int, setting: Any) -> Job:
        winds = np.array(load_winds(folder, members))
        wind = tuple(jax.device_put(np.ascontiguousarray(winds[..., i])) for i in (0, 1))
        tolerance = float(setting) if setting else None
        jax.block_until_ready(solve(wind, tolerance and 1e-2))  # compiles

        def job() -> Any:
            x, y, steps = solve(wind, tolerance)
            # The last stage of a step is the first of the next.
            return np.stack([x, y], axis=-1).tolist(), 1 + 6 * float(np.mean(steps))

        return job

    return peer


def driftcore_full(option: str, folder: str) -> Peer:
    """`driftcore.forecast`, full model, `setting` being its `rtol` or its `steps_per_tide`."""
    import driftcore as dc

    def peer(members: int, setting: Any) -> Job:
        winds = dc.WindPaths(TIMES, load_winds(folder, members))
        count = None  # steps common to all members, and more for some
        if option == "steps_per_tide":
            count = 6 * setting / EPSILON  # of Dormand-Prince

        def job() -> Any:
            return driftcore_positions(winds, members, {option: setting}).tolist(), count

        return job

    return peer


def driftcore_drawn(folder: str) -> Peer:
    """Give `driftcore.forecast` by the same steps of one length, drawing the same winds itself."""
    del folder
    import driftcore as dc

    climate = dc.paper.default_wind()

    def peer(members: int, setting: Any) -> Job:
        def job() -> Any:
            found = driftcore_positions(climate, members, {"steps_per_tide": setting})
            return found.tolist(), 6 * setting / EPSILON

        return job

    return peer


def driftcore_scenario() -> Any:
    """Give the paper's case without its coast."""
    import driftcore as dc

    return dc.paper.scenario(EPSILON, coast=None)


def driftcore_positions(wind: Any, members: int, options: dict[str, Any]) -> Any:
    """Give the positions (members, 2) at t = 1 by driftcore's full model."""
    import driftcore as dc

    forecast = dc.forecast(
        driftcore_scenario(),
        wind,
        model="full",
        members=members,
        times=[1.0],
        keep=members,
        threads=1,
        **options,
    )
    return forecast.dataset["position"].values.reshape(members, 2)


PEERS: dict[str, Callable[[str], Peer]] = {
    "driftcore-fixed": partial(driftcore_full, "steps_per_tide"),
    "driftcore": partial(driftcore_full, "rtol"),
    "driftcore-drawn": driftcore_drawn,
    "rust-lanes": rust_lanes,
    "jax": jax_rk4,
    "odeint": odeint,
    "numba": numba_dopri5,
    "diffrax": diffrax_dopri5,
    "scipy": scipy_rk45,
}


def prepare(folder: str, members: int) -> dict[str, Any]:
    """Draw the winds, solve for the reference, and check it.

    Writes `winds.npy` (members, knots, 2). Returns the reference, positions (members, 2) at t = 1
    by driftcore at a relative tolerance of 1e-12, and how far the first of them is from SciPy's
    DOP853 on rewrite B, `docs/equations.md` (6).
    """
    import driftcore as dc

    scenario, climate = driftcore_scenario(), dc.paper.default_wind()
    winds = np.empty((members, KNOTS + 1, 2))
    for member in range(members):
        path = dc.member_path(scenario, climate, member)
        release = int(np.argmin(np.abs(path.times)))
        times = path.times[release : release + KNOTS + 1]
        if not np.allclose(times, TIMES, rtol=0, atol=1e-9):
            raise ValueError("the wind's knots are not ε/100 apart from the release on")
        winds[member] = path.velocity[release : release + KNOTS + 1]
    np.save(Path(folder) / "winds.npy", winds)
    solver: Any = {"model": "full", "times": [1.0], "rtol": 1e-12}
    paths = (dc.WindPath(TIMES, wind) for wind in winds)
    found = [dc.trajectory(scenario, path, **solver).position.values[0] for path in paths]
    check = float(np.abs(found[0] - rewritten(winds[0])).max())
    return {"reference": np.array(found).tolist(), "check": check}


def rewritten(wind: Any) -> Any:
    """Position (2,) at t = 1 by SciPy's DOP853 on P = X - ∬W, the wind's integrals being exact."""
    from scipy.integrate import solve_ivp

    h = 1 / KNOTS
    once = np.vstack([np.zeros(2), np.cumsum(h * (wind[1:] + wind[:-1]) / 2, axis=0)])
    cells = h * once[:-1] + h**2 * (2 * wind[:-1] + wind[1:]) / 6
    twice = np.vstack([np.zeros(2), np.cumsum(cells, axis=0)])

    def integral(t: float) -> Any:
        knot = min(int(t * KNOTS), KNOTS - 1)
        s, slope = t - knot * h, (wind[knot + 1] - wind[knot]) / h
        return twice[knot] + s * once[knot] + s**2 * wind[knot] / 2 + s**3 * slope / 6

    start = np.array(START[:2])
    invariant = start - sea(0.0, *start)

    def rhs(t: float, p: Any) -> Any:
        x = p + integral(t)
        return sea(t, *x) + invariant - x

    options = {"rtol": 1e-12, "atol": 1e-13, "max_step": EPSILON / 20}
    return solve_ivp(rhs, (0.0, 1.0), start, method="DOP853", **options).y[:, -1] + integral(1.0)


if __name__ == "__main__":
    print(json.dumps(prepare(sys.argv[1], int(sys.argv[2]))))
