"""The small-scale wind, sampled coarsely, beside its path simulated step by step.

The core draws two numbers per synoptic step, exactly in law (docs/equations.md (22)-(24)). Here the
same law is simulated in the plainest way, step after step, to be compared with.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from driftcore import paper
from driftcore.ensemble_winds import member_path
from driftcore.forecast import forecast
from driftcore.record import Float
from driftcore.results import Forecast
from driftcore.wind import LocalGridBootstrap, WindPath

_EPSILON = 1 / 50
_PATHS_AT_ONCE = 200
_UPPER = np.triu_indices(2)


@dataclass(frozen=True)
class SmallScale:
    """A small-scale wind under a tide.

    Attributes
    ----------
    share : float
        Of the total standard deviation.
    memory_h, tide_period_h : float
        Memory and tide period [h].
    """

    share: float
    memory_h: float
    tide_period_h: float = 12.5

    def of(self, wind: LocalGridBootstrap) -> LocalGridBootstrap:
        """Give a fitted wind this small scale."""
        return dataclasses.replace(wind, share=self.share, memory_h=self.memory_h)

    def substeps(self, step_h: float) -> int:
        """Fine steps, of a hundredth of a tide at most, in a synoptic step."""
        return math.ceil(100 * step_h / self.tide_period_h)

    def simulated(self, paths: int, steps: int, step_h: float, seed: int) -> Float:
        """Simulate paths of standard deviation 1 by (4.3) of the paper, (steps + 1, paths).

        Parameters
        ----------
        paths, steps : int
            Number of paths, and of fine steps.
        step_h : float
            Synoptic step [h].
        seed : int
            Of the draws.
        """
        a = math.exp(-step_h / self.substeps(step_h) / self.memory_h)
        path = np.random.default_rng(seed).standard_normal((steps + 1, paths))
        for k in range(steps):
            path[k + 1] = a * path[k] + math.sqrt(1 - a**2) * path[k + 1]
        return path


@dataclass(frozen=True)
class Moments:
    """Moments of the value after a synoptic step and of the integral over it [h].

    Attributes
    ----------
    mean : ndarray of shape (2,)
        Per unit of the value at the start.
    covariance : ndarray of shape (2, 2)
        Of what the start does not determine.
    mean_error, covariance_error : ndarray
        Standard errors of both.
    """

    mean: Float
    covariance: Float
    mean_error: Float
    covariance_error: Float

    @classmethod
    def of(cls, cells: Float, step_h: float) -> Moments:
        """Find them from paths over one synoptic step each, both ends included, (cells, n + 1)."""
        start = cells[:, 0]
        integral = np.trapezoid(cells, dx=step_h / (cells.shape[1] - 1), axis=1)
        found = np.stack([cells[:, -1], integral])
        mean = found @ start / (start @ start)
        new = found - mean[:, None] * start
        covariance = new @ new.T / len(start)
        variance = np.diag(covariance)
        return cls(
            mean,
            covariance,
            np.sqrt(variance / (start @ start)),
            np.sqrt((np.outer(variance, variance) + covariance**2) / len(start)),
        )

    def listed(self) -> Float:
        """Means of value and integral, variance of the value, covariance, variance of the other."""
        return np.concatenate([self.mean, self.covariance[_UPPER]])

    def z_scores(self, other: Moments) -> Float:
        """Differences of what `listed` gives, in standard errors."""
        mine, theirs = (
            np.concatenate([m.mean_error, m.covariance_error[_UPPER]]) for m in (self, other)
        )
        return np.asarray((self.listed() - other.listed()) / np.hypot(mine, theirs))


def member_cells(wind: LocalGridBootstrap, law: SmallScale, members: int, seed: int) -> Float:
    """Small scale of members, its deviation being 1, cut at the synoptic steps, (cells, n + 1)."""
    scenario = paper.scenario(_EPSILON, tide_period_h=law.tide_period_h)
    with_it, without = law.of(wind), dataclasses.replace(wind, share=0.0)

    def velocity(wind: LocalGridBootstrap) -> Float:
        paths = [member_path(scenario, wind, member, seed) for member in range(members)]
        return np.array([path.velocity for path in paths]) * scenario.wind_unit

    small = (velocity(with_it) - velocity(without)) / with_it.small_scale_sd
    n = law.substeps(wind.record.step_h)
    steps = (small.shape[1] - 1) // n
    windows = np.lib.stride_tricks.sliding_window_view(small, n + 1, axis=1)
    return np.moveaxis(windows[:, : steps * n : n], 2, 1).reshape(-1, n + 1)


def brute_force_cells(law: SmallScale, cells: int, step_h: float, seed: int) -> Float:
    """Simulate the same step by step, (cells, n + 1)."""
    return law.simulated(cells, law.substeps(step_h), step_h, seed).T


def coarse_strandings(
    wind: LocalGridBootstrap, law: SmallScale, members: int, seed: int = 3
) -> Float:
    """Stranding times (members,) by mean-flow of order 1 on coarse winds; infinite if afloat."""
    scenario = paper.scenario(_EPSILON, tide_period_h=law.tide_period_h)
    return _until_stranded(forecast(scenario, law.of(wind), members=members, seed=seed, keep=0))


def brute_force_strandings(
    wind: LocalGridBootstrap, law: SmallScale, members: int, seed: int = 17
) -> Float:
    """Give the same under other winds, their small scale simulated step by step."""
    scenario = paper.scenario(_EPSILON, tide_period_h=law.tide_period_h)
    step_h = wind.record.step_h
    step = step_h / scenario.hours_per_unit
    steps, n = math.ceil(scenario.duration / step), law.substeps(step_h)
    place = np.arange(steps * n + 1) / n
    strandings = []
    for first in range(0, members, _PATHS_AT_ONCE):
        count = min(_PATHS_AT_ONCE, members - first)
        # Each part has draws of its own, and none is that of a member.
        slow = wind.sample(count, steps + 1, seed + first)
        small = law.simulated(2 * count, steps * n, step_h, seed + first).reshape(-1, count, 2)
        paths = []
        for member in range(count):
            synoptic = [np.interp(place, np.arange(steps + 1), w) for w in slow[member].T]
            velocity = np.transpose(synoptic) + law.of(wind).small_scale_sd * small[:, member]
            paths.append(WindPath(place * step, velocity / scenario.wind_unit))
        strandings.append(_until_stranded(forecast(scenario, paths, keep=0)))
    return np.concatenate(strandings)


def _until_stranded(forecast: Forecast) -> Float:
    times = forecast.dataset["stranding_time"].to_numpy()
    return np.asarray(np.nan_to_num(times, nan=np.inf))
