"""Wind generators that are wrong in a known way: `driftcore.law` must find each of them out."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from driftcore.law import Simulator, simulator
from driftcore.record import Float, Integer, WindRecord
from driftcore.wind import LocalGridBootstrap, Mode

_SEED = 3


def bootstrap(mode: Mode, h: float, b: float | None = None) -> Callable[[WindRecord], Simulator]:
    """Give a bootstrap whose bandwidth or noise nothing justifies."""

    def fit(record: WindRecord) -> Simulator:
        return simulator(_fitted(record, mode, h, b), _SEED)

    return fit


def independent_draws(record: WindRecord) -> Simulator:
    """Give values of the record in any order."""
    random = np.random.default_rng(_SEED)

    def simulate(members: int, steps: int, _: int | None) -> tuple[Float, Integer]:
        row = random.integers(1, len(record), (members, steps))
        return record.velocity[row], row - 1

    return simulate


def the_record_itself(record: WindRecord) -> Simulator:
    """Give its seasons over and over; from one state there is only one way on."""
    first_rows = np.flatnonzero(np.diff(record.season, prepend=-1))

    def simulate(members: int, steps: int, start: int | None) -> tuple[Float, Integer]:
        first = np.resize(first_rows if start is None else start, members)
        row = (first[:, None] + np.arange(steps)) % len(record)
        return record.velocity[row], row - 1

    return simulate


def joined_seasons(record: WindRecord) -> Simulator:
    """Take the first row of a season for the successor of the last row of another."""
    # From this day on six summers glued together touch three years, which is no few seasons.
    step = np.timedelta64(round(3600 * record.step_h), "s")
    times = np.datetime64("2001-10-01", "s") + np.arange(len(record)) * step
    return simulator(_fitted(WindRecord(times, record.velocity, record.step_h, "glued")), _SEED)


def seldom_calm(record: WindRecord) -> Simulator:
    """Give half of the rows before a weak wind no weight."""
    fit = _fitted(record)
    after = np.hypot(*record.velocity[fit.row + 1].T)
    kept = (after > np.median(after)) | (np.arange(len(after)) % 2 > 0)
    catalogue = {
        name: getattr(fit, name)[kept] for name in ("states", "target", "row", "phase", "start")
    }
    return simulator(dataclasses.replace(fit, **catalogue), _SEED)


def no_spread(record: WindRecord) -> Simulator:
    """Let members of one state share all draws."""
    simulate_freely = simulator(_fitted(record), _SEED)

    def simulate(members: int, steps: int, start: int | None) -> tuple[Float, Integer]:
        if start is None:
            return simulate_freely(members, steps, None)
        values, drawn = simulate_freely(2, steps, start)
        return np.resize(values, (members, steps, 2)), np.resize(drawn, (members, steps))

    return simulate


WRONG: dict[str, Callable[[WindRecord], Simulator]] = {
    "independent draws": independent_draws,
    "nearest neighbour alone, residual": bootstrap("residual", h=1e-3),
    "nearest neighbour alone, lgb": bootstrap("lgb", h=1e-3, b=0.05),
    "the record itself": the_record_itself,
    "over-smoothing, lgb h = 0.5": bootstrap("lgb", h=0.5, b=0.0),
    "noise inflation, lgb b = 0.5": bootstrap("lgb", h=0.1, b=0.5),
    "joined seasons": joined_seasons,
    "biased weights": seldom_calm,
    "collapsed ensemble": no_spread,
}


def _fitted(
    record: WindRecord, mode: Mode = "residual", h: float = 0.4, b: float | None = None
) -> LocalGridBootstrap:
    return LocalGridBootstrap.fit(record, months=None, mode=mode, h=h, b=b)
