"""Estimates from counts, each with its interval."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore.errors import ScenarioError


@dataclass(frozen=True)
class Probability:
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

    def __str__(self) -> str:
        return f"{self.estimate:.3f} [{self.low:.3f}, {self.high:.3f}]"


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
    z = NormalDist().inv_cdf(0.5 + level / 2)
    share = np.asarray(count, dtype=float) / members
    spread = z**2 / members
    center = (share + spread / 2) / (1 + spread)
    half = np.sqrt(spread * (share * (1 - share) + spread / 4)) / (1 + spread)
    # At 0 and at all the exact bounds are 0 and 1; rounding must not leave them.
    low = np.where(share == 0, 0.0, center - half)
    high = np.where(share == 1, 1.0, center + half)
    return low, high


def probability(count: int, members: int, level: float = 0.95) -> Probability:
    """Give the share `count / members` with its Wilson interval."""
    if members <= 0:
        raise ScenarioError(f"members: {members} is not accepted; no member could be followed")
    low, high = wilson(count, members, level)
    return Probability(count / members, float(low), float(high), count, members, level)
