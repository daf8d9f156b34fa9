"""Probabilities of rare events by multilevel splitting: docs/equations.md (52)–(54).

Winds are drawn one synoptic step after the other, so that a run may be *branched*: the branch keeps
its wind up to a step and draws new numbers after it; it is followed from there on. Members that
come nearer to the event than the others are branched, those that do not are given up; each level so
passed multiplies the estimate by the share that passed it. Whatever levels and importance are
chosen, the estimate is unbiased; they decide how far it spreads.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore import _core
from driftcore.compiled import area_core, scenario_core, solver_of
from driftcore.ensemble_winds import Resampled
from driftcore.errors import DriftCoreError, ScenarioError, warn
from driftcore.members import Fates, checked_count, default_threads, warn_of_failures
from driftcore.scenario import Circle, ModelName, Polygons, Scenario, area_of
from driftcore.wind import LocalGridBootstrap

Floats = NDArray[np.float64]
Importance = Callable[[Floats, Floats], ArrayLike]

# Share of the members that passes each level which the pilot run chooses.
_PASSING = 0.2
# A pilot run that needs more levels than these comes no nearer: 0.2 to this power is 1e-70.
_MOST_LEVELS = 100
# The default importance forecasts to so many later times; it is learned from no fewer members than
# these, and sees a circle with so many corners.
_HORIZONS = 5
_LEAST_LEARNED = 50
_CORNERS = 16
# With fewer the interval of Student's t is too wide to be of use.
_LEAST_REPLICATES = 5
_LEAST_PARTICLES = 20
# The pilot run has the members of a tenth of the replicates, but these at least.
_LEAST_PILOT = 500
_LEAST_PARTS = 2
# Members followed at once, about: what is kept of them to be branched from takes some 12 kB each.
_TOGETHER = 2000


@dataclass(frozen=True)
class RareProbability:
    """A small probability estimated by splitting.

    Attributes
    ----------
    estimate : float
        Mean of the replicates: unbiased.
    low, high : float
        Interval at `level`, by Student's t of the replicates on the logarithm of their mean.
    replicates : ndarray of shape (replicates,)
        Independent unbiased estimates.
    levels : ndarray of shape (levels,)
        Values of the importance at which members were branched.
    conditional : ndarray of shape (levels + 1,)
        Share of the members, of all replicates, that passed each level, and at last the event.
    followed : float
        What was followed, in whole runs: each member counts with the share of the steps of a run
        from where it began (at its release, or as a branch) to the end, whether it strands before
        or not; two runs where one of the steps that members share was not exact enough. The pilot
        run is included.
    level : float
        Confidence level of the interval.
    """

    estimate: float
    low: float
    high: float
    replicates: Floats
    levels: Floats
    conditional: Floats
    followed: float
    level: float = 0.95

    @cached_property
    def standard_error(self) -> float:
        """Standard error of the estimate, from the spread of the replicates."""
        return float(self.replicates.std(ddof=1)) / math.sqrt(len(self.replicates))

    @property
    def plain_members(self) -> float:
        """Members that a plain ensemble needs for the same standard error."""
        if self.standard_error == 0:
            return math.nan
        return self.estimate * (1 - self.estimate) / self.standard_error**2

    def __str__(self) -> str:
        return f"{self.estimate:.3g} [{self.low:.3g}, {self.high:.3g}]"


def rare_probability(
    scenario: Scenario,
    wind: LocalGridBootstrap | None = None,
    *,
    event: str | ArrayLike | Polygons = "stranding",
    importance: Importance | None = None,
    levels: Sequence[float] | None = None,
    particles: int = 500,
    replicates: int = 20,
    seed: int = 1,
    model: ModelName = "mean-flow",
    order: int | None = None,
    rtol: float = 1e-6,
    atol: float | None = None,
    threads: int | None = None,
) -> RareProbability:
    """Estimate the probability of stranding, or of entering an area, where it is small.

    Parameters
    ----------
    scenario : Scenario
        The body, its release, the sea and the coast, on the plane.
    wind : LocalGridBootstrap, optional
        The fitted wind; default `driftcore.paper.default_wind()`, a synthetic climate.
    event : "stranding", array_like of shape (n, 2), or Polygons
        What is asked for by the end of the run: stranding, or entering an area before that.
    importance : callable, optional
        Of the times [scenario time], shape (times,), and the positions then, shape (members, times,
        2), NaN once stranded: how near to the event each member is then, shape (members, times).
        Only the order of its values matters. Default: how likely about the event is from there
        on, as a pilot run of other members taught (docs/equations.md (53)); it costs less than one
        that is given, which takes the positions to be written down.
    levels : sequence of float, optional
        Increasing values of the importance at which members are branched. Default: chosen by the
        pilot run so that a fifth passes each.
    particles : int
        Members of each replicate.
    replicates : int
        Independent repetitions, from which the interval comes.
    seed : int
        From 0 to 2⁶⁴ − 1.
    model, order, rtol, atol, threads
        As in `driftcore.forecast`; the model `"paper"` looks ahead into the wind and is refused.

    Returns
    -------
    RareProbability
        Estimate, interval, levels and cost.

    Raises
    ------
    ScenarioError
        An argument is not accepted.
    DriftCoreError
        The pilot run came no nearer to the event.
    """
    if not isinstance(scenario, Scenario):
        raise ScenarioError(
            f"scenario: {type(scenario).__name__} is not accepted; rare events are estimated on "
            "the plane, of a driftcore.Scenario"
        )
    if wind is None:
        from driftcore.paper import default_wind

        wind = default_wind()
    if not isinstance(wind, LocalGridBootstrap):
        raise ScenarioError(
            f"wind: {type(wind).__name__} is not accepted; branches are drawn from a fitted "
            "LocalGridBootstrap"
        )
    if model == "paper":
        raise ScenarioError(
            "model: 'paper' is not accepted; its window reaches into wind that is not drawn yet, "
            "so that a branch would not keep its past"
        )
    particles = checked_count("particles", particles, least=_LEAST_PARTICLES)
    replicates = checked_count("replicates", replicates, least=_LEAST_REPLICATES)
    checked_count("seed", seed, least=0)
    threads = checked_count("threads", default_threads() if threads is None else threads)
    _, solver = solver_of(scenario, model, order, None, True, "B", rtol, atol)
    area = _area_of(event)
    if area is None and scenario.coast is None:
        raise ScenarioError("event: 'stranding' is not accepted; the scenario has no coast")
    splitting = _Splitting(scenario, wind, solver, seed, area, importance, threads)
    pilot = None
    if levels is None or importance is None:
        pilot = _Swarm(splitting, max(_LEAST_PILOT, particles * replicates // 10), 1)
    if levels is None:
        assert pilot is not None  # noqa: S101 (for the type checker)
        thresholds = splitting.choose_levels(pilot)
    else:
        thresholds = np.asarray(levels, dtype=float)
        if (
            thresholds.ndim != 1
            or not np.isfinite(thresholds).all()
            or ((np.diff(thresholds) <= 0).any())
        ):
            raise ScenarioError(f"levels: {levels!r} is not accepted; finite numbers that increase")
    shares = splitting.run(thresholds, particles, replicates)
    splitting.warn()
    estimates = shares.prod(axis=1)
    estimate = float(estimates.mean())
    low, high = _interval(estimates)
    # Of all replicates: each has its weight, the share that passed the levels before.
    weight = np.cumprod(np.column_stack([np.ones(replicates), shares]), axis=1).mean(axis=0)
    with np.errstate(invalid="ignore"):
        conditional = weight[1:] / weight[:-1]
    return RareProbability(
        estimate, low, high, estimates, thresholds, conditional, splitting.followed
    )


class _Splitting:
    """Members that are followed and branched; none of their numbers is used twice."""

    def __init__(
        self,
        scenario: Scenario,
        wind: LocalGridBootstrap,
        solver: _core.Solver,
        seed: int,
        area: Polygons | None,
        importance: Importance | None,
        threads: int,
    ) -> None:
        self.scenario, self.solver, self.threads = scenario, solver, threads
        self.compiled = scenario_core(scenario)
        self.winds = Resampled(scenario, wind, solver, seed)
        self.area = area
        self.areas = [] if area is None else [area_core("event", area.rings)]
        step = wind.record.step_h / scenario.hours_per_unit
        # Members are branched between parts of the run of about a tide. What is known at the end of
        # one depends on the wind up to the synoptic step after it.
        self.parts = round(scenario.duration / max(scenario.period, step))
        if self.parts < _LEAST_PARTS:
            raise ScenarioError(
                f"scenario.duration: {scenario.duration:g} is not accepted; a run is branched "
                f"between parts of {max(scenario.period, step):g}, and has {_LEAST_PARTS} at least"
            )
        self.ends = scenario.duration * (np.arange(1, self.parts + 1) / self.parts)
        self.times = self.ends[:-1]
        self.branch = np.ceil(self.times / step - 1e-9).astype(np.int64)
        self.importance = importance
        # Learned by the pilot run where no importance is given.
        self.approach: _Approach | None = None
        self.named = 0
        self.followed = 0.0
        self.failure: str | None = None
        self.failed: list[NDArray[np.int8]] = []

    def choose_levels(self, swarm: _Swarm) -> Floats:
        """Levels that about a fifth of the members of a pilot run pass each."""
        particles = swarm.particles
        rng = self._choices("pilot")
        levels: list[float] = []
        while True:
            reached = np.sort(swarm.past.scores.max(axis=1))
            level = float(reached[math.floor((1 - _PASSING) * particles)])
            if level == math.inf:
                return np.array(levels)
            stuck = level == -math.inf or (bool(levels) and level <= levels[-1])
            if stuck and reached[-1] == math.inf:
                return np.array(levels)
            if stuck or len(levels) == _MOST_LEVELS:
                raise DriftCoreError(
                    f"event: the pilot run of {particles} members came no nearer to it than an "
                    f"importance of {level:.6g}, after {len(levels)} levels; more particles or "
                    "another importance may, or it cannot happen"
                )
            levels.append(level)
            swarm.pass_level(level, level, rng)

    def run(self, levels: Floats, particles: int, replicates: int) -> Floats:
        """Shares that pass each level and the event, shape (replicates, levels + 1)."""
        levels = np.append(levels, math.inf)
        rng = self._choices("run")
        together = max(1, _TOGETHER // particles)
        parts = []
        for first in range(0, replicates, together):
            count = min(together, replicates - first)
            swarm = _Swarm(self, particles, count, levels[0])
            shares = [swarm.pass_level(*pair, rng) for pair in itertools.pairwise(levels)]
            happened = np.isposinf(swarm.past.scores[:, -1]).reshape(count, particles)
            # A replicate that died out contributes 0 whatever it is counted as after that.
            parts.append(np.column_stack([*shares, happened.mean(axis=1)]))
        return np.concatenate(parts)

    def follow(self, particles: _core.Particles, past: _Past, least: float) -> None:
        """Follow particles, and write down what comes after their past.

        What is scored below `least` may be left at -inf.
        """
        count = len(past.known)
        kept = 0 if self.importance is None else count
        fates = Fates.empty(count, kept, self.parts, len(self.areas))
        winds = (*self.winds.core, particles)
        failure = self.compiled.run(
            winds, self.solver, 0, self.ends, kept, fates, self.threads, self.areas
        )
        self.failure = self.failure or failure
        self.failed.append(fates.status)
        self.followed += particles.followed()
        if self.importance is None:
            seen = particles.seen()
            if self.approach is None:
                self.approach = self._learned(seen)
            self.approach.look(seen, past, least)
        else:
            later = np.arange(len(self.times)) >= past.known[:, None]
            past.positions[later] = fates.position[:, :-1][later]
            scores = np.asarray(self.importance(self.times, past.positions), dtype=float)
            if scores.shape != later.shape:
                raise ScenarioError(
                    f"importance: a result of shape {scores.shape} is not accepted; one value for "
                    f"each member and time, {later.shape}, is"
                )
            past.scores[:, :-1][later] = np.where(np.isnan(scores), -np.inf, scores)[later]
        happened = fates.entry_time[:, 0] if self.areas else fates.stranding_time
        past.scores[happened[:, None] <= np.append(self.times, np.inf)] = np.inf

    def _learned(self, seen: Floats) -> _Approach:
        scenario = self.scenario
        area = self.area or scenario.coast
        assert area is not None  # noqa: S101 (for the type checker: the event has an area)
        return _Approach(area, self.area is None and scenario.side == "inside", seen)

    def nothing_known(self, particles: int) -> _Past:
        """Past of particles at the release."""
        # Positions are kept where an importance asks for them.
        times = 0 if self.importance is None else len(self.times)
        return _Past(
            np.full((particles, times, 2), np.nan),
            np.full((particles, self.parts), -np.inf),
            np.zeros(particles, dtype=np.intp),
        )

    def new_members(self, count: int) -> NDArray[np.uint64]:
        """Members nobody has been yet."""
        self.named += count
        return np.arange(self.named - count, self.named, dtype=np.uint64)

    def _choices(self, name: str) -> np.random.Generator:
        """Random numbers that choose who is branched."""
        return np.random.default_rng([self.winds.seed, *name.encode()])

    def warn(self) -> None:
        """Warn where members failed: they count as not reaching the event."""
        warn_of_failures(np.concatenate(self.failed), self.failure)
        self.winds.warn()


@dataclass(frozen=True)
class _Past:
    """What is known of particles at the times at which they may be branched.

    `positions`, of shape (particles, times, 2), NaN once stranded (no times where nobody asks), and
    `scores`, of shape (particles, times + 1), infinite once the event has happened; the last is of
    the end. Of the first `known` times, shape (particles,), a branch has its parent's.
    """

    positions: Floats
    scores: Floats
    known: NDArray[np.intp]

    def until(self, places: NDArray[np.intp], known: NDArray[np.intp]) -> _Past:
        """Return what branches of some particles know."""
        scores = self.scores[places]
        scores[np.arange(scores.shape[1]) >= known[:, None]] = -np.inf
        return _Past(self.positions[places], scores, known)

    def put(self, places: NDArray[np.intp], other: _Past) -> None:
        """Put the past of others to some places."""
        self.positions[places], self.scores[places] = other.positions, other.scores


class _Swarm:
    """The members of some replicates, as many of each, and what they have come to."""

    def __init__(
        self, splitting: _Splitting, particles: int, replicates: int, least: float = -math.inf
    ) -> None:
        """Follow them from the release; scores below `least` do not matter."""
        self.splitting, self.particles, self.replicates = splitting, particles, replicates
        members = splitting.new_members(particles * replicates)
        self.members = _core.Particles(members, splitting.parts)
        self.past = splitting.nothing_known(len(members))
        splitting.follow(self.members, self.past, least)

    def pass_level(self, level: float, least: float, rng: np.random.Generator) -> Floats:
        """Replace who did not reach the level by branches of who did; give their shares.

        Scores of the branches below `least` do not matter.
        """
        reached = (self.past.scores >= level).reshape(self.replicates, self.particles, -1)
        passed = np.asarray(reached.any(axis=2))
        given_up, parents = [], []
        for replicate in range(self.replicates):
            who = passed[replicate]
            places = np.flatnonzero(who)
            if not len(places):
                continue  # died out
            lost = np.flatnonzero(~who)
            # As many branches of each, and the odd ones by lot.
            shuffled = np.resize(rng.permutation(places), len(lost))
            given_up.append(lost + replicate * self.particles)
            parents.append(shuffled + replicate * self.particles)
        if given_up:
            self._branch(np.concatenate(given_up), np.concatenate(parents), level, least)
        return np.asarray(passed.mean(axis=1))

    def _branch(
        self, given_up: NDArray[np.intp], parents: NDArray[np.intp], level: float, least: float
    ) -> None:
        first = (self.past.scores[parents] >= level).argmax(axis=1)
        # Those who begin together are followed side by side.
        order = np.argsort(first, kind="stable")
        given_up, parents, first = given_up[order], parents[order], first[order]
        # Whose event has happened by then has no more to come.
        over = np.isposinf(self.past.scores[parents, first])
        self.past.scores[given_up[over]] = self.past.scores[parents[over]]
        given_up, parents, first = given_up[~over], parents[~over], first[~over]
        fresh = self.splitting.new_members(len(given_up))
        branches = self.members.branched(parents, self.splitting.branch[first], fresh)
        past = self.past.until(parents, first + 1)
        self.splitting.follow(branches, past, least)
        self.members = self.members.replaced(given_up, branches)
        self.past.put(given_up, past)


def _area_of(event: str | ArrayLike | Polygons) -> Polygons | None:
    """Area of an event; none of stranding."""
    if isinstance(event, str):
        if event != "stranding":
            raise ScenarioError(f"event: {event!r} is not accepted; 'stranding', or an area")
        return None
    try:
        return area_of("event", event)
    except ValueError as error:
        raise ScenarioError(str(error)) from None


class _Forecast(NamedTuple):
    """Where members will be at a later time, in coordinates in which the error has variance 1."""

    weights: NDArray[Any]
    area: _core.Coast
    # A ball around the area, or one that the coast encloses.
    center: NDArray[Any]
    radius: float
    # What is less likely in an area smaller than the spread.
    missing: float


class _Approach:
    """Importance learned from a plain run: docs/equations.md (53).

    From where a member is, how the wind has blown until then and how it blows, a linear regression
    tells where it will be later, and how far that spreads. The nearest approach is told by the
    logarithm of about the probability that the Gaussian forecast has in the area.
    """

    def __init__(self, area: Circle | Polygons, inside: bool, seen: Floats) -> None:
        """`seen` is of the plain run, shape (parts, members, 6), NaN once stranded."""
        self.inside = inside
        self.rings = (
            [_ring(area)] if isinstance(area, Circle) else [np.array(r) for r in area.rings]
        )
        last = len(seen) - 1
        self.forecasts: list[list[_Forecast]] = []
        for k in range(last):
            later = np.unique(np.linspace(k, last, _HORIZONS + 1).round().astype(int))
            learned = [self._learned(seen[k], seen[j]) for j in later[later > k]]
            self.forecasts.append([forecast for forecast in learned if forecast is not None])

    def _learned(self, now: Floats, then: Floats) -> _Forecast | None:
        adrift = np.isfinite(now[:, 0]) & np.isfinite(then[:, 0])
        known, then = _regressors(now[adrift]), then[adrift, :2]
        if len(known) < _LEAST_LEARNED:
            return None
        weights = np.linalg.lstsq(known, then, rcond=None)[0]
        missed = then - known @ weights
        whiten = np.linalg.inv(np.linalg.cholesky(missed.T @ missed / len(known))).T
        weights = weights @ whiten
        rings = [np.ascontiguousarray(ring @ whiten) for ring in self.rings]
        area, corners = _core.Coast.polygons(rings, self.inside), np.concatenate(rings)
        center = corners.mean(axis=0)
        if self.inside:  # beyond a coast there is no end
            return _Forecast(weights, area, center, area.clearance(*center), 0.0)
        radius = float(np.hypot(*(corners - center).T).max())
        size = sum(map(_enclosed, rings)) / math.pi
        return _Forecast(weights, area, center, radius, math.log1p(2 / size))

    def look(self, seen: Floats, past: _Past, least: float) -> None:
        """Give the scores of the times not known yet; those below `least` may be left at -inf."""
        for k, forecasts in enumerate(self.forecasts):
            who = np.flatnonzero((past.known <= k) & np.isfinite(seen[k, :, 0]))
            if not (len(who) and forecasts):
                continue
            weights, areas, centers, radii, missing = zip(*forecasts, strict=True)
            places = _regressors(seen[k, who]) @ np.hstack(weights)
            places = places.reshape(len(who), len(forecasts), 2)
            apart = np.hypot(*np.moveaxis(places - np.array(centers), 2, 0)) - radii
            # Nearer to the area than to the ball nobody is.
            bound = _log_probability(-apart if self.inside else apart) - missing
            for j, area in enumerate(areas):
                near = np.flatnonzero(bound[:, j] >= least)
                distance = area.clearances(np.ascontiguousarray(places[near, j]))
                score = _log_probability(distance) - missing[j]
                past.scores[who[near], k] = np.maximum(past.scores[who[near], k], score)


def _log_probability(distance: Floats) -> Floats:
    """Of a Gaussian beyond a line, about."""
    return np.asarray(-distance * abs(distance) / 2)


def _regressors(seen: Floats) -> Floats:
    return np.column_stack([np.ones(len(seen)), seen])


def _ring(circle: Circle) -> Floats:
    angle = np.linspace(0, 2 * math.pi, _CORNERS, endpoint=False)
    return circle.center + circle.radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _enclosed(ring: Floats) -> float:
    """Area that a ring encloses."""
    (x, y), (x1, y1) = ring.T, np.roll(ring, -1, axis=0).T
    return float(abs((x * y1 - x1 * y).sum())) / 2


def _interval(estimates: Floats, level: float = 0.95) -> tuple[float, float]:
    """Student's interval of a mean, on its logarithm: estimates near 0 are skewed.

    Source: docs/equations.md (54); the quantile by Abramowitz & Stegun (1964),
    26.7.5, to 0.3 % from 4 degrees of freedom on.
    """
    mean = float(estimates.mean())
    if mean == 0:
        warn(
            f"none of {len(estimates)} replicates reached the event: nothing is known of its "
            "probability; more particles are needed"
        )
        return 0.0, 1.0
    z, freedom = NormalDist().inv_cdf(0.5 + level / 2), len(estimates) - 1
    t = (
        z
        + (z**3 + z) / (4 * freedom)
        + (5 * z**5 + 16 * z**3 + 3 * z) / (96 * freedom**2)
        + (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / (384 * freedom**3)
    )
    spread = float(estimates.std(ddof=1)) / math.sqrt(len(estimates)) / mean
    return mean * math.exp(-t * spread), min(1.0, mean * math.exp(t * spread))
