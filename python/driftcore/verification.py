"""Whether probabilities came true: docs/equations.md (V1) to (V4).

Knows arrays only. `driftcore.hindcast` makes them; `driftcore.plot` draws them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore.errors import ScenarioError

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Draws of groups (of so few that they have fewer signs, all are taken), and of single cases.
_DRAWS, _CASE_DRAWS = 4096, 1000


@dataclass(frozen=True)
class Brier:
    """Brier score of probabilities, and its parts: docs/equations.md (V1).

    Attributes
    ----------
    score : float
        Mean squared error, `reliability - resolution + uncertainty`; 0 is best.
    reliability : float
        Squared distance of the probabilities from what happened at them; 0 is calibrated.
    resolution : float
        How far what happens differs from one probability to the next, within bins also.
    uncertainty : float
        Variance of what happened: the score of the base rate.
    """

    score: float
    reliability: float
    resolution: float
    uncertainty: float

    @property
    def skill(self) -> float:
        """Score saved of that of the base rate: 1 is best, 0 is no better."""
        return 1 - self.score / self.uncertainty if self.uncertainty else np.nan


def brier(probability: ArrayLike, happened: ArrayLike, bins: int | ArrayLike = 10) -> Brier:
    """Brier score, with its decomposition over bins of probability.

    Parameters
    ----------
    probability : array_like, any shape
        Forecast, from 0 to 1.
    happened : array_like of bool, same shape
        What came.
    bins : int or array_like
        Number of equal bins, or their edges from 0 to 1.

    Raises
    ------
    ScenarioError
        If shapes differ, nothing is given, or a value is out of range.

    Notes
    -----
    Murphy (1973), with the terms within bins of Stephenson, Coelho & Jolliffe (2008), so that the
    parts add up to the score whatever the bins.
    """
    p, o = _checked(probability, happened)
    place, _ = _binned(p, bins)
    n = np.bincount(place)
    n_safe = np.maximum(n, 1)
    p_mean, o_mean = ((np.bincount(place, x) / n_safe)[place] for x in (p, o))
    base = o.mean()
    within = p - p_mean
    return Brier(
        score=float(np.mean((p - o) ** 2)),
        reliability=float(np.mean((p_mean - o_mean) ** 2)),
        resolution=float(np.mean((o_mean - base) ** 2 - within**2 + 2 * within * (o - o_mean))),
        uncertainty=float(base * (1 - base)),
    )


def reliability(
    probability: ArrayLike,
    happened: ArrayLike,
    bins: int | ArrayLike = 10,
    groups: ArrayLike | None = None,
    *,
    level: float = 0.95,
    seed: int = 1,
) -> xr.Dataset:
    """How often events came that were forecast so, and how far chance takes that from calibration.

    Parameters
    ----------
    probability, happened, bins
        As in `brier`.
    groups : array_like, same shape, optional
        What each case belongs to: within a group cases may depend on each other (one summer, say),
        groups are independent. Left out, all cases are independent.
    level : float
        Probability that a calibrated forecast keeps inside the band, bin by bin.
    seed : int
        Of the draws.

    Returns
    -------
    xarray.Dataset
        By `bin`, the empty ones left out: `forecast` and `observed`, the mean probability and the
        share that happened; `low` and `high`, the band around `forecast`; `count`, `groups`. As
        attributes the parts of `brier`, and `p_value`: how often a calibrated forecast's
        `reliability` is as great, all bins together.

    Raises
    ------
    ScenarioError
        As `brier`, or if groups have another shape.

    Notes
    -----
    Consistency bars after Bröcker & Smith (2007). Of independent cases, what happens is drawn
    anew from the probabilities, docs/equations.md (V2). Of groups, each keeps what it has, and
    its deviation from the forecast is turned round or not, as a whole: a block bootstrap that
    has calibration built in and so few blocks to draw from that the ordinary one, which takes
    their scatter for known, gives bands too narrow (Cameron, Gelbach & Miller 2008, wild cluster
    bootstrap). Fewer than six groups cannot leave a band of 95 %.
    """
    import xarray as xr

    p, o = _checked(probability, happened)
    place, edges = _binned(p, bins)
    size = len(edges) - 1
    count = np.bincount(place, minlength=size)
    used = np.flatnonzero(count)
    random = np.random.default_rng(seed)
    chance: Floats
    if groups is None:
        chance = np.empty((_CASE_DRAWS, size))
        for k in range(_CASE_DRAWS):
            drawn = random.random(len(p)) < p
            chance[k] = np.bincount(place, drawn - p, size)
        within = count
    else:
        group, number = _grouped(groups, p.shape, np.shape(probability))
        cell = group * size + place
        sums = np.bincount(cell, o - p, number * size).reshape(number, size)
        chance = _signs(number, random) @ sums
        within = (np.bincount(cell, minlength=number * size).reshape(number, size) > 0).sum(axis=0)
    deviation = np.bincount(place, o - p, size)
    parts = brier(p, o, edges)
    mean = np.bincount(place, p, size)[used] / count[used]
    low, high = _band(chance[:, used], level) / count[used]
    return xr.Dataset(
        {
            "forecast": ("bin", mean),
            "observed": ("bin", mean + deviation[used] / count[used]),
            "low": ("bin", np.clip(mean + low, 0, 1)),
            "high": ("bin", np.clip(mean + high, 0, 1)),
            "count": ("bin", count[used]),
            "groups": ("bin", within[used]),
        },
        {"bin": (edges[used] + edges[used + 1]) / 2},
        {
            "brier": parts.score,
            "reliability": parts.reliability,
            "resolution": parts.resolution,
            "uncertainty": parts.uncertainty,
            "skill": parts.skill,
            "p_value": _p_value(deviation[used], chance[:, used], count[used]),
            "level": level,
            "cases": len(p),
            "independent": number if groups is not None else len(p),
            "unit": "case" if groups is None else "group",
        },
    )


def pit(
    members: ArrayLike,
    observed: ArrayLike,
    bins: int = 10,
    groups: ArrayLike | None = None,
    *,
    level: float = 0.95,
    seed: int = 1,
) -> xr.Dataset:
    """Probability integral transform: the rank of what happened among the members, in 0 to 1.

    Parameters
    ----------
    members : array_like, shape (..., members)
        Forecast; infinite where the event did not come before the end of the run.
    observed : array_like, shape (...)
        What happened, infinite likewise.
    bins : int
        Equal bins of the histogram, at least 2.
    groups, level, seed
        As in `reliability`.

    Returns
    -------
    xarray.Dataset
        `pit(case)`, uniform if the forecast is calibrated; `density(bin)`, 1 if so, with its band
        `low` and `high`; attribute `p_value` as in `reliability`, for all bins together.

    Raises
    ------
    ScenarioError
        If the shapes do not fit, there are no members, or a value is NaN.

    Notes
    -----
    docs/equations.md (V3). Among equal values the rank is drawn at random, which makes it uniform
    also where many are censored at the end of the run (Czado, Gneiting & Held 2009).
    """
    import xarray as xr

    ensemble, truth = np.asarray(members, dtype=float), np.asarray(observed, dtype=float)
    if ensemble.shape[:-1] != truth.shape or not ensemble.size:
        raise ScenarioError(
            f"members: shape {ensemble.shape} is not accepted; observed of shape {truth.shape} "
            "needs that and one more axis, of members"
        )
    if np.isnan(ensemble).any() or np.isnan(truth).any():
        raise ScenarioError("members: NaN is not accepted; infinity is, for what never came")
    if bins < 2:
        raise ScenarioError(f"bins: {bins} is not accepted; at least 2")
    random = np.random.default_rng(seed)
    below = (ensemble < truth[..., None]).sum(axis=-1).ravel()
    equal = (ensemble == truth[..., None]).sum(axis=-1).ravel()
    value = (below + random.random(below.shape) * (equal + 1)) / (ensemble.shape[-1] + 1)
    place = np.minimum((value * bins).astype(np.int64), bins - 1)
    expected = len(value) / bins
    if groups is None:
        share = np.full(bins, 1 / bins)
        chance = random.multinomial(len(value), share, _CASE_DRAWS) - expected
    else:
        group, number = _grouped(groups, value.shape, truth.shape)
        sums = np.bincount(group * bins + place, minlength=number * bins).reshape(number, bins)
        chance = _signs(number, random) @ (sums - sums.sum(axis=1, keepdims=True) / bins)
    deviation = np.bincount(place, minlength=bins) - expected
    low, high = _band(chance, level) / expected
    return xr.Dataset(
        {
            "pit": ("case", value),
            "density": ("bin", 1 + deviation / expected),
            "low": ("bin", np.maximum(1 + low, 0)),
            "high": ("bin", 1 + high),
        },
        {"bin": (np.arange(bins) + 0.5) / bins},
        {
            "p_value": _p_value(deviation, chance, np.full(bins, expected)),
            "level": level,
            "cases": len(value),
            "independent": number if groups is not None else len(value),
            "unit": "case" if groups is None else "group",
        },
    )


def crps(members: ArrayLike, observed: ArrayLike) -> Floats:
    """Fair continuous ranked probability score of an ensemble.

    Parameters
    ----------
    members : array_like, shape (members, ...)
        At least 2.
    observed : array_like, shape (...)

    Returns
    -------
    ndarray, shape (...)
        In the unit of what is forecast; 0 is best. docs/equations.md (V4): its mean does not
        depend on the number of members (Ferro 2014).
    """
    ordered, truth = np.sort(np.asarray(members, dtype=float), axis=0), np.asarray(observed)
    count = len(ordered)
    if count < 2 or ordered.shape[1:] != truth.shape:
        raise ScenarioError(
            f"members: shape {ordered.shape} is not accepted; observed of shape {truth.shape} "
            "needs an axis of at least 2 members before its own"
        )
    weight = (2 * np.arange(count) - count + 1).reshape(-1, *[1] * truth.ndim)
    between = 2 * (weight * ordered).sum(axis=0) / (count * (count - 1))
    return np.asarray(np.abs(ordered - truth).mean(axis=0) - between / 2)


def score_ratio(
    score: ArrayLike,
    reference: ArrayLike,
    groups: ArrayLike,
    *,
    level: float = 0.95,
    seed: int = 1,
) -> xr.Dataset:
    """Mean score as a share of a reference's, by pairs, with whole groups resampled.

    Parameters
    ----------
    score, reference : array_like, shape (cases, leads)
        Scores of the same cases.
    groups : array_like, shape (cases,)
        As in `reliability`.
    level, seed
        As in `reliability`.

    Returns
    -------
    xarray.Dataset
        `ratio(lead)` with its interval `low`, `high`.
    """
    import xarray as xr

    ours, theirs = np.asarray(score, dtype=float), np.asarray(reference, dtype=float)
    if ours.ndim != 2 or ours.shape != theirs.shape:
        raise ScenarioError(
            f"score: shapes {ours.shape} and {theirs.shape} are not accepted; (cases, leads), both"
        )
    group, number = _grouped(groups, ours.shape[:1], ours.shape[:1])
    member = (group == np.arange(number)[:, None]).astype(float)
    picked = np.random.default_rng(seed).multinomial(number, np.full(number, 1 / number), _DRAWS)
    drawn = (picked @ (member @ ours)) / (picked @ (member @ theirs))
    tail = (1 - level) / 2
    low, high = np.quantile(drawn, [tail, 1 - tail], axis=0)
    return xr.Dataset(
        {
            "ratio": ("lead", ours.sum(axis=0) / theirs.sum(axis=0)),
            "low": ("lead", low),
            "high": ("lead", high),
        },
        attrs={"level": level, "independent": number, "cases": len(ours)},
    )


# What chance does


def _signs(groups: int, random: np.random.Generator) -> Floats:
    """Signs of the groups, (draws, groups): all there are, or some of them."""
    if 2**groups <= _DRAWS:
        turned = np.arange(2**groups)[:, None] >> np.arange(groups) & 1
        return 1 - 2 * turned.astype(np.float64)
    drawn = random.choice(np.array([-1.0, 1.0]), (_DRAWS, groups))
    drawn[0] = 1  # what was seen is one of them
    return drawn


def _band(chance: NDArray[Any], level: float) -> Floats:
    """Bounds of the draws (draws, bins) bin by bin: no fewer than `level` of them lie within."""
    tail = (1 - level) / 2
    low = np.quantile(chance, tail, axis=0, method="lower")
    return np.stack([low, np.quantile(chance, 1 - tail, axis=0, method="higher")])


def _p_value(deviation: NDArray[Any], chance: NDArray[Any], count: NDArray[Any]) -> float:
    """Share of the draws whose squared deviations weigh as much as those seen."""
    weight = 1 / count
    seen = (deviation**2 * weight).sum()
    return float(np.mean((chance**2 * weight).sum(axis=1) >= seen * (1 - 1e-9)))


# Arguments


def _checked(probability: ArrayLike, happened: ArrayLike) -> tuple[Floats, Floats]:
    p, o = np.asarray(probability, dtype=float), np.asarray(happened, dtype=float)
    if p.shape != o.shape or not p.size:
        raise ScenarioError(
            f"happened: shape {o.shape} is not accepted; probability has shape {p.shape}, "
            "and both need the same one and at least one case"
        )
    outside = p[~((p >= 0) & (p <= 1))]
    if outside.size:
        raise ScenarioError(f"probability: {outside[0]:g} is not accepted; numbers from 0 to 1")
    neither = o[~((o == 0) | (o == 1))]
    if neither.size:
        raise ScenarioError(f"happened: {neither[0]:g} is not accepted; True or False")
    return p.ravel(), o.ravel()


def _binned(p: Floats, bins: int | ArrayLike) -> tuple[Integers, Floats]:
    """Bin of each probability, and the bins' edges."""
    edges = np.linspace(0, 1, bins + 1) if isinstance(bins, int) else np.asarray(bins, float)
    if len(edges) < 2 or edges[0] != 0 or edges[-1] != 1 or (np.diff(edges) <= 0).any():
        raise ScenarioError(
            f"bins: {bins!r} is not accepted; a number above 0, or edges that grow from 0 to 1"
        )
    return np.minimum(np.searchsorted(edges, p, side="right") - 1, len(edges) - 2), edges


def _grouped(
    groups: ArrayLike, flat: tuple[int, ...], shape: tuple[int, ...]
) -> tuple[Integers, int]:
    """Give the number of the group of each case, and how many there are."""
    if np.shape(groups) not in (flat, shape):
        raise ScenarioError(
            f"groups: shape {np.shape(groups)} is not accepted; one for each case, {shape}"
        )
    names, group = np.unique(np.ravel(groups), return_inverse=True)
    return group.ravel(), len(names)
