"""Estimates from counts, each with its interval, and tests of whether two laws are one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore.errors import ScenarioError

_LEAST_EXPECTED = 8
# Kolmogorov's distribution function is below 1e-12 there.
_ALWAYS_REACHED = 0.2


class Interval:
    """What has an estimate and bounds: `estimate`, `low` and `high`."""

    estimate: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Half the width of the interval."""
        return (self.high - self.low) / 2

    def __str__(self) -> str:
        return f"{self.estimate:.3f} [{self.low:.3f}, {self.high:.3f}]"


@dataclass(frozen=True)
class Probability(Interval):
    """A probability estimated from independent members.

    Attributes
    ----------
    estimate : float
        Share of the members.
    low, high : float
        Wilson interval at `level` (Wilson 1927; docs/equations.md (25)).
    count, members : int
        The members in question, and all of them.
    level : float
        Confidence level of the interval.
    """

    estimate: float
    low: float
    high: float
    count: int
    members: int
    level: float = 0.95


def wilson_center(count: float, members: int, level: float = 0.95) -> float:
    """Give the middle of the Wilson interval: a share that is neither 0 nor 1."""
    return float(_wilson(np.asarray(count / members), members, deviations(level))[0])


def wilson(
    count: ArrayLike, members: int, level: float = 0.95
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bounds of the Wilson interval for `count` successes among `members` trials.

    Parameters
    ----------
    count : array_like of shape (...)
        Successes.
    members : int
        Trials, above 0.
    level : float
        Confidence level.

    Returns
    -------
    low, high : ndarray of shape (...)
        Bounds, within [0, 1]. Source: Wilson (1927); docs/equations.md (25).
    """
    share = np.asarray(count, dtype=float) / members
    center, half = _wilson(share, members, deviations(level))
    # At 0 and at all the exact bounds are 0 and 1; rounding must not leave them.
    low = np.where(share == 0, 0.0, center - half)
    high = np.where(share == 1, 1.0, center + half)
    return low, high


def members_needed(share: float, half_width: float, level: float = 0.95) -> int:
    """Give the members for which the Wilson interval is so narrow.

    Parameters
    ----------
    share : float
        Of them that are counted, as far as it is known.
    half_width : float
        Half the width wanted, between 0 and 1/2.
    level : float
        Confidence level.

    Returns
    -------
    int
        The least number. Source: docs/equations.md (51).
    """
    variance, square = share * (1 - share), half_width**2
    # Of z²/N, of which the half-width is a rising function.
    spread = float(np.roots([0.25 - square, variance - 2 * square, -square]).real.max())
    return math.ceil(deviations(level) ** 2 / spread)


def standard_error(count: ArrayLike, members: int) -> NDArray[np.float64]:
    """Half-width of the Wilson interval at one standard deviation, for `count` of `members`.

    The binomial standard error for large counts; unlike that it is not 0 where the count is.
    """
    return _wilson(np.asarray(count, dtype=float) / members, members, 1.0)[1]


def deviations(level: float) -> float:
    """Give the standard deviations about the mean that hold a share of the normal law."""
    return NormalDist().inv_cdf(0.5 + level / 2)


def _wilson(
    share: NDArray[np.float64], members: int, z: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre and half-width of the Wilson interval at `z` standard deviations."""
    spread = z**2 / members
    center = (share + spread / 2) / (1 + spread)
    return center, np.sqrt(spread * (share * (1 - share) + spread / 4)) / (1 + spread)


def quantile_interval(
    values: ArrayLike, levels: ArrayLike, level: float = 0.95
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bounds of the quantiles of what a sample is drawn from, whatever its law.

    Parameters
    ----------
    values : array_like of shape (n,)
        The sample.
    levels : array_like of shape (q,)
        Of the quantiles, within [0, 1].
    level : float
        Confidence level.

    Returns
    -------
    low, high : ndarray of shape (q,)
        Values of the sample; NaN where it is too small to tell. Source: Woodruff (1952);
        docs/equations.md (47).
    """
    ordered, shares = np.sort(values), np.asarray(levels, dtype=float)
    size = len(ordered)
    half = deviations(level) * np.sqrt(size * shares * (1 - shares)) + 0.5
    # Ranks count from 1; the NaN on either side stand for what lies beyond the sample.
    known = np.concatenate([[np.nan], ordered, [np.nan]])
    low = np.ceil(size * shares - half).clip(0, size + 1).astype(int)
    high = (np.floor(size * shares + half) + 1).clip(0, size + 1).astype(int)
    return known[low], known[high]


def paired_difference(
    gained: int, lost: int, pairs: int, level: float = 0.95
) -> tuple[float, float]:
    """Bounds of the difference of two probabilities that were counted on the same members.

    Parameters
    ----------
    gained, lost : int
        Members with the first event alone, and with the second alone.
    pairs : int
        All members, above 0.
    level : float
        Confidence level.

    Returns
    -------
    low, high : float
        Bounds, within [-1, 1]: the score interval. Unlike a normal one it keeps a width where no
        member tells the two apart. Source: Tango (1998); docs/equations.md (48).
    """
    z, estimate = deviations(level), (gained - lost) / pairs

    def score(difference: float) -> float:
        """Give by how many standard deviations what was counted exceeds a difference."""
        b = (2 * pairs - gained + lost) * difference - gained - lost
        product = difference * (1 - difference)
        of_lost = (math.sqrt(b * b + 8 * pairs * lost * product) - b) / (4 * pairs)
        variance = (2 * of_lost + product) / pairs
        # None is left at -1, at 1, and where none was seen at 0.
        apart = estimate - difference
        return apart / math.sqrt(variance) if variance > 0 else math.copysign(math.inf, apart)

    def bound(end: float) -> float:
        inside, outside = estimate, end
        for _ in range(60):
            middle = (inside + outside) / 2
            if abs(score(middle)) <= z:
                inside = middle
            else:
                outside = middle
        return outside

    return bound(-1.0), bound(1.0)


def probability(count: int, members: int, level: float = 0.95) -> Probability:
    """Give the share `count / members` with its Wilson interval."""
    if members <= 0:
        raise ScenarioError(f"members: {members} is not accepted; no member could be followed")
    low, high = wilson(count, members, level)
    return Probability(count / members, float(low), float(high), count, members, level)


def chi_square(counts: ArrayLike, expected: ArrayLike) -> tuple[float, int]:
    """Pearson's statistic and its degrees of freedom, for counts of the same total as expected.

    Neighbours in size are counted together, from the smallest expectations on, until eight are
    expected: with fewer the statistic has not the law of χ².

    Parameters
    ----------
    counts, expected : array_like of shape (n,)
        What was counted, and the mean of it.
    """
    observed, mean = np.asarray(counts, dtype=float), np.asarray(expected, dtype=float)
    group = np.zeros(len(mean), dtype=np.int64)
    last, gathered = 0, 0.0
    for k in np.argsort(mean):
        group[k] = last
        gathered += mean[k]
        if gathered >= _LEAST_EXPECTED:
            last, gathered = last + 1, 0.0
    # What is left over joins the group before.
    group = np.minimum(group, max(last - 1, 0))
    observed, mean = np.bincount(group, observed), np.bincount(group, mean)
    return float(((observed - mean) ** 2 / mean).sum()), len(mean) - 1


def chi_square_p(statistic: float, freedom: int) -> float:
    """Probability that χ² of `freedom` degrees is as large: the sum that Γ(freedom/2, ·) is."""
    half = statistic / 2
    if half <= 0:
        return 1.0
    powers = np.arange(freedom % 2 / 2, freedom / 2)
    terms = [math.exp(a * math.log(half) - half - math.lgamma(a + 1)) for a in powers]
    return (math.erfc(math.sqrt(half)) if freedom % 2 else 0.0) + math.fsum(terms)


def kolmogorov_smirnov(one: ArrayLike, other: ArrayLike) -> float:
    """p-value of the two-sample test by Kolmogorov and Smirnov, from its limit for large samples.

    Values may be infinite and may be equal, which makes the test cautious.
    """
    first, second = np.sort(one), np.sort(other)
    places = np.concatenate([first, second])
    below = [np.searchsorted(x, places, side="right") / len(x) for x in (first, second)]
    size = len(first) * len(second) / len(places)
    distance = np.sqrt(size) * np.abs(below[0] - below[1]).max()
    if distance < _ALWAYS_REACHED:  # where the series below converges slowly
        return 1.0
    k = np.arange(1, 101)
    return float(2 * ((-1.0) ** (k - 1) * np.exp(-2 * (k * distance) ** 2)).sum())
