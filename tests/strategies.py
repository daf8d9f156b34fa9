"""Hypothesis strategies for winds, seas, initial states and scenarios.

Everything is in the paper's units: a run lasts at most 1, the tide period is ε, fields are O(1).
"""

from typing import Any, NamedTuple

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from reference import Floats, NaiveWind, RandomSea, random_sea


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Finite floats in [low, high], without subnormal ones."""
    return st.floats(low, high, allow_nan=False, allow_subnormal=False)


def vectors(low: float, high: float) -> st.SearchStrategy[tuple[float, float]]:
    """Pairs of numbers."""
    return st.tuples(numbers(low, high), numbers(low, high))


# Tide periods from the coarsest at which the expansions still mean something to three months.
epsilons = st.integers(10, 200).map(lambda tides: 1 / tides)
drags = numbers(0.25, 4.0)
# So near (1, 1) that an O(1) wind keeps the object in [-1, 3]², where random seas are O(1).
positions = vectors(0.5, 1.5)
velocities = vectors(-1.0, 1.0)
sides = st.sampled_from(["inside", "outside"])
seeds = st.integers(0, 2**32 - 1)


@st.composite
def winds(
    draw: st.DrawFn, start: float = -0.5, stop: float = 1.5, max_knots: int = 30
) -> NaiveWind:
    """Piecewise-linear winds whose path is exactly [start, stop], with unequal steps."""
    steps = draw(st.lists(numbers(0.1, 1.0), min_size=1, max_size=max_knots - 1))
    fractions = np.cumsum([0.0, *steps]) / np.sum(steps)
    knots = start + (stop - start) * fractions
    knots[-1] = stop
    velocity = draw(arrays(np.float64, (len(knots), 2), elements=numbers(-2.0, 2.0)))
    return NaiveWind(knots, velocity)


@st.composite
def seas(draw: st.DrawFn, max_harmonics: int = 4) -> RandomSea:
    """Random smooth seas, of up to four harmonics of the tide."""
    rng = np.random.default_rng(draw(seeds))
    return random_sea(rng, draw(st.integers(1, max_harmonics)), draw(epsilons))


class Run(NamedTuple):
    """What a trajectory needs."""

    sea: RandomSea
    wind: NaiveWind
    drag: float
    x: tuple[float, float]
    v: tuple[float, float]
    times: Floats


@st.composite
def runs(draw: st.DrawFn, max_tides: int = 3, max_times: int = 12) -> Run:
    """Runs of a few tides, for the reference spends some tenths of a second on each.

    Output times are distinct and increasing; the last is the end of the run.
    """
    sea = draw(seas())
    stop = min(1.0, sea.period * draw(st.integers(1, max_tides)))
    inner = draw(st.lists(st.integers(0, 999), max_size=max_times - 1, unique=True))
    times = stop * np.array([*sorted(inner), 1000]) / 1000
    # Two tides of margin on each side hold every window of the averaged models up to 2ε.
    wind = draw(winds(-2 * sea.period, stop + 2 * sea.period))
    return Run(sea, wind, draw(drags), draw(positions), draw(velocities), times)


@st.composite
def scenario_numbers(draw: st.DrawFn) -> dict[str, Any]:
    """Keyword arguments of ``driftcore.paper.scenario`` that are all accepted."""
    return {
        "epsilon": draw(epsilons),
        "x": draw(positions),
        "v": draw(velocities),
        "drag": draw(drags),
        "wind_unit": draw(numbers(0.5, 20.0)),
        "tide_period_h": draw(numbers(10.0, 26.0)),
    }
