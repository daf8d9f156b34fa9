"""Probabilities of an exact model from many members of a cheap one: docs/equations.md (49)–(50)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import process_time
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from driftcore.dataset import STATUSES
from driftcore.errors import ScenarioError
from driftcore.forecast import forecast
from driftcore.members import Progress, checked_count
from driftcore.paper import default_wind
from driftcore.scenario import Scenario
from driftcore.statistics import Interval, deviations, paired_difference, probability, wilson_center

if TYPE_CHECKING:
    import xarray as xr

    from driftcore.geographic import GeographicScenario

Event = Literal["stranding"] | Callable[["xr.Dataset"], Any]
Flags = NDArray[np.bool_]

# What a level may differ in: how the same members are followed, not what happens to them.
_OF_A_LEVEL = ("model", "order", "window", "wind_terms", "rtol", "atol", "steps_per_tide")
# Halving the distance to the sizes sought, each.
_ITERATIONS = 50
TWO_LEVELS: tuple[Mapping[str, Any], ...] = ({"model": "mean-flow"}, {"model": "full"})


@dataclass(frozen=True)
class MultifidelityProbability(Interval):
    """A probability of the last, dearest level.

    Attributes
    ----------
    estimate : float
        Without bias, whatever the cheaper levels are; so it may lie outside [0, 1] by a little.
    low, high : float
        Interval at `level`, within [0, 1]: docs/equations.md (50).
    level : float
        Confidence level of the interval.
    members : tuple of int
        Members followed by each level: those of a level are the first of the level before.
    followed : tuple of int
        Of them, those that did not fail, there and on the level before.
    count : int
        Members of the first level that made the event.
    gained, lost : tuple of int
        For each further level, members that made it there alone, and on the level before alone.
    seconds : tuple of float
        CPU time of each level, of all threads, as measured.
    """

    estimate: float
    low: float
    high: float
    level: float
    members: tuple[int, ...]
    followed: tuple[int, ...]
    count: int
    gained: tuple[int, ...]
    lost: tuple[int, ...]
    seconds: tuple[float, ...]

    @property
    def disagreement(self) -> tuple[float, ...]:
        """Share of the members that each further level tells apart from the level before."""
        both = zip(self.gained, self.lost, self.followed[1:], strict=True)
        return tuple((gained + lost) / pairs for gained, lost, pairs in both)

    @property
    def cost(self) -> tuple[float, ...]:
        """CPU time of a member on each level, in units of the last."""
        each = [time / members for time, members in zip(self.seconds, self.members, strict=True)]
        return tuple(time / each[-1] for time in each)

    @property
    def saving(self) -> float:
        """How many times dearer an interval as narrow as this is by the last level alone."""
        p = min(max(self.estimate, 0.0), 1.0)
        alone = p * (1 - p) * (deviations(self.level) / self.half_width) ** 2
        return alone / math.fsum(np.multiply(self.cost, self.members))

    def allocation(
        self, *, precision: float | None = None, seconds: float | None = None
    ) -> tuple[int, ...]:
        """Choose how many members each level should follow, from this run as a pilot.

        Parameters
        ----------
        precision : float
            Half-width of the interval wanted, at this run's `level`.
        seconds : float
            Or CPU time to be spent.

        Returns
        -------
        tuple of int
            For `members` of another run, best with another seed: what the pilot happened to show
            then cannot bias the result. Source: docs/equations.md (49), with the widths of (50) for
            standard errors, and shares moved to Wilson's centre, above 0 where none was seen.

        Raises
        ------
        ScenarioError
            Not one of the two is given, or it is not above 0.
        """
        given = {"precision": precision, "seconds": seconds}
        named = [(name, value) for name, value in given.items() if value is not None]
        if len(named) != 1:
            raise ScenarioError("precision, seconds: give one of the two")
        name, wanted = named[0]
        if not (math.isfinite(wanted) and wanted > 0):
            raise ScenarioError(f"{name}: {wanted!r} is not accepted; a finite number above 0 is")
        z = deviations(self.level)
        counts = [self.count, *np.add(self.gained, self.lost)]
        shares = np.array(
            [wilson_center(k, n, self.level) for k, n in zip(counts, self.followed, strict=True)]
        )
        costs = np.divide(self.seconds, self.members)
        sizes = np.array(self.followed, dtype=float)
        for _ in range(_ITERATIONS):
            # Of rare disagreements the interval is wider than their variance tells, the more so
            # the fewer members there are.
            widths = z / (2 * sizes) + np.sqrt(shares / sizes + (z / (2 * sizes)) ** 2)
            variances = sizes * widths**2
            variances[0] = shares[0] * (1 - shares[0])
            scale = np.sqrt(variances * costs).sum()
            scale = wanted / scale if precision is None else scale * (z / precision) ** 2
            sizes = np.ceil(scale * np.sqrt(variances / costs))
        # A level follows all members of the next.
        return tuple(np.maximum.accumulate(sizes[::-1])[::-1].astype(int).tolist())


def multifidelity_probability(
    scenario: Scenario | GeographicScenario,
    wind: Any = None,
    *,
    members: Sequence[int] = (10_000, 1_000),
    levels: Sequence[Mapping[str, Any]] = TWO_LEVELS,
    event: Event = "stranding",
    targets: Mapping[str, Any] | None = None,
    seed: int = 1,
    threads: int | None = None,
    level: float = 0.95,
    progress: Progress | None = None,
) -> MultifidelityProbability:
    """Estimate a probability of the last level, from a cheap level corrected by dearer ones.

    The first level follows many members; each further one follows the first of them again, under
    the same winds, and corrects by what it tells apart: multilevel Monte Carlo with nested samples
    (Giles 2008; Peherstorfer, Willcox & Gunzburger 2016), docs/equations.md (49).

    Parameters
    ----------
    scenario, wind, targets, seed, threads
        As in `forecast`.
    members : sequence of int
        How many each level follows, not increasing.
    levels : sequence of mapping
        How each level follows its members, from the cheapest to the one that counts: `model`,
        `order`, `window`, `wind_terms`, `rtol`, `atol`, `steps_per_tide` of `forecast`. They follow
        one and the same problem; another ε is another one, with another number of tides and winds
        of other lengths, and so no level.
    event : "stranding" or callable
        What the probability is of: having stranded by the end of the run, or a function that gives
        a bool for each member of a forecast's dataset (in which no trajectories are kept), e.g.
        `lambda data: data["stranding_time"] <= 0.5`.
    level : float
        Confidence level of the interval.
    progress : callable, optional
        Called with (members done, members), all levels together.

    Returns
    -------
    MultifidelityProbability
        With what was measured on the way: disagreements, CPU time, and the saving.

    Raises
    ------
    ScenarioError
        An argument is not accepted, or no member could be followed.
    """
    sizes = _checked(members, levels)
    if not (isinstance(level, float) and 0 < level < 1):
        raise ScenarioError(f"level: {level!r} is not accepted; a number between 0 and 1 is")
    if event != "stranding" and not callable(event):
        raise ScenarioError(
            f'event: {event!r} is not accepted; "stranding", or a function of the dataset'
        )
    if wind is None and isinstance(scenario, Scenario):
        wind = default_wind()  # fitted before the clock starts
    flags: list[Flags] = []
    followed: list[Flags] = []
    seconds = []
    for k, (size, options) in enumerate(zip(sizes, levels, strict=True)):

        def told(done: int, _: int, before: int = sum(sizes[:k])) -> None:
            if progress is not None:
                progress(before + done, sum(sizes))

        start = process_time()
        found = forecast(
            scenario,
            wind,
            members=size,
            keep=0,
            seed=seed,
            targets=targets,
            threads=threads,
            progress=told,
            **options,
        ).dataset
        seconds.append(process_time() - start)
        flags.append(_happened(event, found))
        followed.append(found["status"].values != STATUSES.index("failed"))
    return _combined(flags, followed, seconds, level)


def _checked(members: Sequence[int], levels: Sequence[Mapping[str, Any]]) -> list[int]:
    if len(levels) < 2:
        raise ScenarioError(f"levels: {len(levels)} is not accepted; two or more are")
    for k, options in enumerate(levels):
        unknown = [name for name in options if name not in _OF_A_LEVEL]
        if unknown:
            raise ScenarioError(
                f"levels.{k}.{unknown[0]}: is not accepted; a level may have "
                f"{', '.join(_OF_A_LEVEL)}"
            )
    sizes = [] if isinstance(members, int) else [checked_count("members", n) for n in members]
    if len(sizes) != len(levels) or sizes != sorted(sizes, reverse=True):
        raise ScenarioError(
            f"members: {members!r} is not accepted; {len(levels)} numbers, one for each level, "
            "none greater than the one before"
        )
    return sizes


def _happened(event: Event, found: xr.Dataset) -> Flags:
    if not callable(event):
        flags: Flags = found["status"].values == STATUSES.index("stranded")
        return flags
    flags = np.asarray(event(found))
    if flags.dtype != np.bool_ or flags.shape != (found.sizes["member"],):
        raise ScenarioError(
            f"event: gave {flags.dtype} of shape {flags.shape}; it must give a bool for each of "
            f"{found.sizes['member']} members"
        )
    return flags


def _combined(
    flags: list[Flags], followed: list[Flags], seconds: list[float], level: float
) -> MultifidelityProbability:
    """Count what happened on each level, and on it and the level before."""
    members = int(followed[0].sum())
    count = int(flags[0][followed[0]].sum())
    # Each level's part by member, 0 for members that failed: for the covariances alone.
    steps = [np.where(followed[0], flags[0] - count / max(1, members), 0.0)]
    pairs, covariance = [], 0.0
    for k in range(1, len(flags)):
        size = len(flags[k])
        both = followed[k] & followed[k - 1][:size]
        now, before = flags[k] & both, flags[k - 1][:size] & both
        gained, lost = int((now & ~before).sum()), int((before & ~now).sum())
        pairs.append((gained, lost, int(both.sum())))
        if not both.any():
            raise ScenarioError(f"members: of {size} on level {k} none could be followed")
        difference = now.astype(float) - before
        steps.append(np.where(both, difference - difference[both].mean(), 0.0))
        covariance += sum(float(np.mean(steps[k] * s[:size])) / len(s) for s in steps[:-1])
    # Of two levels it is never above 0, and to leave it out is on the safe side.
    estimate, low, high = combined_probability(count, members, pairs, max(0.0, covariance), level)
    return MultifidelityProbability(
        estimate=estimate,
        low=low,
        high=high,
        level=level,
        members=tuple(len(f) for f in flags),
        followed=(members, *(p[2] for p in pairs)),
        count=count,
        gained=tuple(p[0] for p in pairs),
        lost=tuple(p[1] for p in pairs),
        seconds=tuple(seconds),
    )


def combined_probability(
    count: int,
    members: int,
    pairs: Sequence[tuple[int, int, int]],
    covariance: float = 0.0,
    level: float = 0.95,
) -> tuple[float, float, float]:
    """Give estimate (49) and interval (50) of the last level from what was counted.

    Parameters
    ----------
    count, members : int
        Members of the first level that made the event, and all of them.
    pairs : sequence of (int, int, int)
        For each further level, members that made the event there alone, on the level before alone,
        and all that both followed.
    covariance : float
        Of the levels' parts of the estimate, summed over the pairs of levels.
    level : float
        Confidence level.

    Returns
    -------
    estimate, low, high : float
        The bounds within [0, 1].
    """
    first = probability(count, members, level)
    parts = [(first.estimate, first.low, first.high)]
    for gained, lost, both in pairs:
        bounds = paired_difference(gained, lost, both, level)
        parts.append(((gained - lost) / both, *bounds))
    estimate = math.fsum(part[0] for part in parts)
    shared = deviations(level) * math.sqrt(2 * covariance)
    low = estimate - math.hypot(shared, *(part[0] - part[1] for part in parts))
    high = estimate + math.hypot(shared, *(part[2] - part[0] for part in parts))
    return estimate, min(max(low, 0.0), 1.0), min(max(high, 0.0), 1.0)
