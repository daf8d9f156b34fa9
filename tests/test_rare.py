"""Rare events by splitting: branches keep their past, the estimate is unbiased."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import driftcore as dc
from driftcore import _core
from driftcore.compiled import scenario_core, solver_of
from driftcore.ensemble_winds import Resampled
from driftcore.members import Fates
from driftcore.rare import _interval


def square(x: float, y: float, half: float) -> list[tuple[float, float]]:
    return [(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)]


def scenario(radius: float, duration: float = 0.3) -> dc.Scenario:
    """Return the paper's case, but shorter."""
    case = dc.paper.scenario(coast=dc.Circle(radius=radius))
    return case.model_copy(update={"duration": duration})


class Follower:
    """Follows particles of the paper's case under the embedded climate, of seed 4."""

    def __init__(
        self, case: dc.Scenario, model: str, rtol: float = 1e-6, order: int | None = None
    ) -> None:
        _, self.solver = solver_of(case, model, order, None, True, "B", rtol, None)
        self.winds = Resampled(case, dc.paper.default_wind(), self.solver, 4)
        self.core = scenario_core(case)
        self.step = 6.0 / case.hours_per_unit
        self.parts = round(case.duration / case.period)
        self.last = math.ceil(case.duration / self.step - 1e-9) - 1
        self.times = np.append(np.arange(1, self.last + 1) * self.step, case.duration)

    def roots(self, members: list[int]) -> _core.Particles:
        return _core.Particles(np.array(members, dtype=np.uint64), self.parts)

    def follow(self, particles: _core.Particles, count: int) -> Fates:
        area = [_core.Coast.polygons([np.array(AREA)], False)]
        fates = Fates.empty(count, count, len(self.times), 1)
        winds = (*self.winds.core, particles)
        failure = self.core.run(winds, self.solver, 0, self.times, count, fates, 1, area)
        assert failure is None
        return fates


def branched(
    parents: _core.Particles, places: list[int], steps: list[int], members: list[int]
) -> _core.Particles:
    return parents.branched(np.array(places), np.array(steps), np.array(members, dtype=np.uint64))


AREA = square(1.035, 1.025, 0.01)


@pytest.mark.parametrize(("model", "tolerance"), [("mean-flow", 1e-7), ("full", 1e-12)])
def test_a_branch_keeps_its_past(model: str, tolerance: float) -> None:
    """The position at a synoptic step tells of later wind no more than the integration errs."""

    def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.hypot(*(a - b).T)

    case = scenario(1.0)
    follower = Follower(case, model)
    roots = follower.roots([3, 50])
    children = branched(roots, [0], [10], [50])
    grandchildren = branched(children, [0], [20], [51])
    root, other = follower.follow(roots, 2).position
    (child,) = follower.follow(children, 1).position
    (grandchild,) = follower.follow(grandchildren, 1).position
    wind = dc.paper.default_wind()
    plain = dc.forecast(case, wind, members=4, seed=4, model=model, times=follower.times).dataset  # type: ignore[arg-type]
    # On another grid of steps, each within 1e-6.
    assert apart(root, plain["position"][3].to_numpy()).max() < 1e-6

    for one, two, step in ((root, child, 10), (child, grandchild, 20), (child, other, 0)):
        assert apart(one, two)[:step].max(initial=0.0) < tolerance
        assert apart(one, two)[step] > 1e-6


@pytest.mark.parametrize(
    ("model", "order", "rtol", "shorter"),
    [
        ("mean-flow", 1, 1e-6, True),
        ("full", None, 1e-6, True),
        # Steps of these errors are not common to all: members are followed alone.
        ("mean-flow", 1, 1e-12, False),
        ("mean-flow", 2, 1e-6, False),
    ],
)
def test_to_go_on_is_to_begin_again(
    model: str, order: int | None, rtol: float, shorter: bool
) -> None:
    """Branches of followed parents, and those of parents nobody followed, have the same bits."""
    follower = Follower(scenario(0.07), model, rtol, order)
    count, rng = 100, np.random.default_rng(1)
    places, older = rng.integers(count, size=(2, count))
    first = rng.integers(1, follower.last, count)
    second = np.minimum(first[older] + rng.integers(0, 6, count), follower.last)
    fates, followed = [], []
    for known in (True, False):
        particles = follower.roots(list(range(count)))
        if known:
            follower.follow(particles, count)
        particles = branched(particles, list(places), list(first), list(range(100, 200)))
        if known:
            follower.follow(particles, count)
        particles = branched(particles, list(older), list(second), list(range(200, 300)))
        fates.append(follower.follow(particles, count))
        followed.append(particles.followed())
    later = np.arange(len(follower.times)) >= second[:, None]
    gone_on, begun_again = (fate.position[later] for fate in fates)
    assert np.array_equal(gone_on, begun_again, equal_nan=True)
    gone_on, begun_again = fates
    for mine, theirs in (
        (gone_on.stranding_time, begun_again.stranding_time),
        (gone_on.entry_time[:, 0], begun_again.entry_time[:, 0]),
    ):
        late = theirs > second * follower.step
        assert late.sum() > 1
        assert np.array_equal(mine[late], theirs[late])
    if shorter:
        assert followed[0] < 0.8 * followed[1] == pytest.approx(0.8 * count)
    else:
        assert followed[0] > 0.99 * count


OFTEN = scenario(0.13)


@pytest.fixture(scope="module")
def plain() -> dc.Forecast:
    wind = dc.paper.default_wind()
    return dc.forecast(OFTEN, wind, members=60_000, seed=5, keep=0, targets={"area": AREA})


@pytest.mark.parametrize(
    "asked",
    [
        {},
        {"event": AREA},
        {"event": dc.Polygons(rings=(AREA,)), "levels": [-0.09, -0.05, -0.02]},
        {"model": "full"},
    ],
    ids=["stranding", "area", "importance given", "full"],
)
def test_the_estimate_is_unbiased(plain: dc.Forecast, asked: dict[str, Any]) -> None:
    """The mean of 150 replicates of 20 members, which each err by their own size, is right."""
    wind = dc.paper.default_wind()
    if "levels" in asked:

        def importance(times: np.ndarray, positions: np.ndarray) -> np.ndarray:
            assert positions.shape[1:] == (len(times), 2)
            return -np.abs(positions - [1.035, 1.025]).max(axis=2)

        asked = {**asked, "importance": importance}
    found = dc.rare_probability(OFTEN, wind, particles=20, replicates=150, seed=6, **asked)
    event = "event" in asked
    counted = plain.entry_probability("area") if event else plain.stranding_probability()
    error = math.hypot(
        found.standard_error, math.sqrt(counted.estimate * (1 - counted.estimate) / counted.members)
    )
    assert abs(found.estimate - counted.estimate) < 3 * error
    assert found.low < found.estimate < found.high
    assert error < counted.estimate / 5
    assert len(found.levels) >= 1
    assert (np.diff(found.levels) > 0).all()
    assert found.conditional.prod() == pytest.approx(found.estimate)
    assert found.followed > 150 * 20


def test_rare_is_reached_at_a_small_cost() -> None:
    """At 1e-5 a few thousand members stand for many times as many; a seed is a result."""
    wind = dc.paper.default_wind()
    case = scenario(0.17)
    found = dc.rare_probability(case, wind, particles=100, replicates=20, seed=3)
    assert 1e-7 < found.estimate < 1e-4
    assert found.plain_members > 20 * found.followed
    assert found.high < 5 * found.low
    again = dc.rare_probability(case, wind, particles=100, replicates=20, seed=3, threads=1)
    assert np.array_equal(again.replicates, found.replicates)
    assert str(found) == f"{found.estimate:.3g} [{found.low:.3g}, {found.high:.3g}]"


def test_plain_members_have_the_same_standard_error() -> None:
    def of(*replicates: float) -> dc.RareProbability:
        values = np.array(replicates)
        mean = float(values.mean())
        return dc.RareProbability(mean, 0.0, 1.0, values, np.zeros(0), np.zeros(1), 100)

    found = of(0.1, 0.2, 0.3)
    assert found.standard_error == pytest.approx(0.1 / math.sqrt(3))
    assert found.plain_members == pytest.approx(0.2 * 0.8 / (0.01 / 3))
    assert found.level == 0.95
    # Without spread none compares.
    assert math.isnan(of(0.0, 0.0).plain_members)


def test_an_importance_that_tells_nothing_leaves_a_plain_ensemble() -> None:
    found = dc.rare_probability(
        OFTEN,
        particles=60,
        replicates=10,
        importance=lambda times, positions: np.zeros((len(positions), len(times))),
    )
    plain = dc.forecast(OFTEN, dc.paper.default_wind(), members=2000, seed=8, keep=0)
    share = plain.stranding_probability().estimate
    assert (found.levels.tolist(), found.conditional[0]) == ([0.0], 1.0)
    # 600 members of a run and 2000 of another: four standard errors.
    error = math.sqrt(share * (1 - share) * (1 / 600 + 1 / 2000))
    assert abs(found.estimate - share) < 4 * error


def test_intervals_are_those_of_student() -> None:
    """Of replicates 1, 2, 3, 4, 5: mean 3, standard error sqrt(1/2), t of 4 degrees 2.776."""
    estimates = np.arange(1.0, 6.0)
    low, high = _interval(1e-3 * estimates)
    expected = 3e-3 * np.exp(2.776 * math.sqrt(0.5) / 3 * np.array([-1, 1]))
    assert np.allclose([low, high], expected, rtol=3e-3)
    with pytest.warns(dc.DriftCoreWarning, match="none of 5 replicates reached the event"):
        assert _interval(np.zeros(5)) == (0.0, 1.0)


def test_what_cannot_happen_is_told() -> None:
    with pytest.raises(dc.DriftCoreError, match="came no nearer to it"):
        dc.rare_probability(
            OFTEN,
            event=square(9.0, 9.0, 0.1),
            particles=20,
            importance=lambda times, positions: np.zeros((len(positions), len(times))),
        )


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"model": "paper"}, "model: 'paper' is not accepted; its window reaches"),
        ({"wind": [1]}, "wind: list is not accepted; branches are drawn from"),
        ({"event": "fire"}, "event: 'fire' is not accepted; 'stranding', or an area"),
        ({"event": [(0, 0)]}, "event"),
        ({"particles": 3}, "particles: 3 is not accepted; a whole number from 20 up"),
        ({"replicates": 1}, "replicates: 1 is not accepted; a whole number from 5 up"),
        ({"seed": -1}, "seed: -1 is not accepted"),
        ({"levels": [1, 1]}, r"levels: \[1, 1\] is not accepted; finite numbers that increase"),
        ({"scenario": "paper"}, "scenario: str is not accepted; rare events are estimated on the"),
        ({"scenario": scenario(1.0, 0.015)}, "scenario.duration: 0.015 is not accepted"),
        ({"scenario": dc.paper.scenario(coast=None)}, "event: 'stranding' is not accepted; the"),
        (
            {"importance": lambda times, _: times},
            r"importance: a result of shape \(14,\) is not accepted",
        ),
    ],
)
def test_what_is_not_accepted_is_named(asked: dict[str, Any], message: str) -> None:
    case = asked.pop("scenario", OFTEN)
    with pytest.raises(dc.ScenarioError, match=message):
        dc.rare_probability(case, **{"particles": 20, "replicates": 5, **asked})
