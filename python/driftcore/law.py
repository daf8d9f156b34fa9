"""Does a simulated wind have the law of its record? Acceptance statistics of a wind generator.

Many simulated seasons are compared with the record, which is short: differences are measured in
standard errors of the record, found by drawing whole seasons of it with replacement.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import ArrayLike

from driftcore import paper
from driftcore.check import Check
from driftcore.errors import RecordError, ScenarioError
from driftcore.forecast import forecast
from driftcore.record import Float, Integer, WindRecord, mean_cycle, rows_with_successor
from driftcore.statistics import chi_square, chi_square_p
from driftcore.wind import LARGEST_ORDER, LocalGridBootstrap

Simulator: TypeAlias = Callable[[int, int, int | None], tuple[Float, Integer]]
"""From (members, steps, start) to winds (members, steps, 2) [m/s], mean cycle included, and the
record's rows whose successors made them (members, steps); members begin at the row `start` of the
record, or at rows of their own choice if it is None."""

Families: TypeAlias = dict[str, Float]
# Sums over a piece of the record or a member, and the number of terms, (rows, features) each.
Sums: TypeAlias = dict[str, tuple[Float, Float]]

_LEVELS = (0.02, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.98)
_SPEED_CLASSES = (0.25, 0.5, 0.75)
_PERSISTENCE_LEVELS = (0.1, 0.25, 0.5, 0.75, 0.9)
_SECTORS = 16
_LEAST_SHARE = 0.01
_SHORT_DAYS, _LONG_DAYS = 3, 10
_SPREAD_DAYS = (28, 32)
_REPLICATES = 1000

QUANTILES = "T1 quantiles of u, v, speed"
SHORT_ACF = "T1 autocorrelation of u, v, speed below 3 d"
LONG_ACF = "T1 autocorrelation of u, v, speed from 3 to 10 d"
CROSS = "T1 cross-correlation of u and v"
ROSE = "T1 wind rose"
PERSISTENCE = "T1 persistence of speeds"
CHANGES = "T1 changes in a step"
LAG_ONE = "T2 autocorrelation at one step"
DEVIATION = "T3 standard deviation of {}, relative error"
CONTINUED = "T4 share of draws that continue the record"
LONGEST = "T4 longest run of such draws"
REPEATED = "T5 share of values found in the record"
SPREAD = "T6 standard deviation of {} 30 d after one state, relative error"
JOINED = "T7 draws of a row without successor"
STREAMS = "T8 values that another split, length or number of threads changes"
WEIGHTS = "T9 p-value of the rows drawn at fixed states"
# The families of T1 and T2, in a word.
FAMILIES = {
    "quantiles": QUANTILES,
    "autocorrelation below 3 d": SHORT_ACF,
    "from 3 to 10 d": LONG_ACF,
    "cross-correlation": CROSS,
    "rose": ROSE,
    "persistence": PERSISTENCE,
    "changes": CHANGES,
    "one step": LAG_ONE,
}
COPIES = frozenset({CONTINUED, LONGEST})

# As many as tell standard errors well.
MANY_SEASONS = 17
# Largest |z| accepted of a record of 6, 10, and 17 or more seasons. For few seasons, whose standard
# errors are poor themselves, it is the 99 % quantile of what `calibrate` finds for the embedded
# climate, `calibrate(driftcore.paper.default_wind(), seasons)`. The last column is stricter than
# that (quantiles: 4.6), as may be asked of a generator that was fitted to the record.
_SEASONS = (6, 10, MANY_SEASONS)
_LIMITS: dict[str, tuple[float, float, float]] = {
    QUANTILES: (8.3, 6.2, 3.0),
    SHORT_ACF: (10.1, 5.7, 3.0),
    LONG_ACF: (10.8, 6.7, 6.0),
    CROSS: (8.3, 4.7, 3.0),
    ROSE: (11.7, 6.8, 3.7),
    PERSISTENCE: (8.0, 5.8, 3.0),
    CHANGES: (6.7, 4.8, 3.7),
    LAG_ONE: (4.8, 3.6, 3.0),
}
_LARGEST_DEVIATION = 0.04
_LARGEST_CONTINUED = 0.15
_LONGEST_RUN = 12
_LARGEST_SPREAD_ERROR = 0.1
_LEAST_P = 0.001
_FIXED_STATES, _DRAWS = 8, 20_000


def simulator(wind: LocalGridBootstrap, seed: int) -> Simulator:
    """Give a fitted bootstrap as a `Simulator`.

    Members that begin at one row come from a copy of the fit that knows no other start.
    """

    def simulate(members: int, steps: int, start: int | None) -> tuple[Float, Integer]:
        source = wind
        if start is not None:
            source = dataclasses.replace(wind, start=wind.row == start)
        return source.sample(members, steps, seed, return_indices=True)

    return simulate


def assess(
    wind: LocalGridBootstrap | Simulator,
    record: WindRecord | None = None,
    *,
    seasons: int = 200,
    seed: int = 4,
) -> list[Check]:
    """Measure T1 to T9: whether a generator has the law of a record and does not copy it.

    T1 and T2 compare shares and correlations: of the record's quantiles (how often a simulated
    value is below), the rose of 16 sectors and 4 classes of speed, speeds that stay above or
    below a level for a step and for a day, changes |ΔW| in a step, auto- and cross-correlations.
    T6 follows members from the windiest state of the record, 28 to 32 days later. T8 and T9 are
    measured of a bootstrap alone, whose members, threads and weights are known: the same members
    are simulated otherwise, and rows drawn at fixed states are counted.

    Parameters
    ----------
    wind : LocalGridBootstrap or Simulator
    record : WindRecord, optional
        What the generator is to resemble; by default the record that a bootstrap was fitted to.
    seasons : int
        Simulated seasons, as long as the record's.
    seed : int
        Of a bootstrap's simulations, and of the seasons drawn for the standard errors. T4's longest
        run is an extreme: of a record of 6 seasons it is beyond 12 with about one seed in ten.

    Returns
    -------
    list of Check
        Named by this module, T1 to T9 number the tests. For T1 and T2 the largest of the family's
        |z|; T3 and T6 have a sign.

    Raises
    ------
    RecordError
        If the record has fewer than 6 seasons: too few for standard errors.
    ScenarioError
        If `record` is missing.
    """
    if isinstance(wind, LocalGridBootstrap):
        record = wind.record if record is None else record
        simulate = simulator(wind, seed)
    else:
        simulate = wind
    if record is None:
        raise ScenarioError("record: it is left out, but only a fitted bootstrap has its own")
    pieces, seasons_of_pieces = _pieces(record)
    years = np.unique(seasons_of_pieces)
    values, drawn = simulate(seasons, round(len(record) / len(years)), None)
    scores = _scores(pieces, seasons_of_pieces, values, record.step_h, seed)
    of_bootstrap = []
    if isinstance(wind, LocalGridBootstrap):
        of_bootstrap = [_streams(wind, seed), _weights(wind, seed)]
    return [
        *(
            Check(name, float(np.abs(z).max(initial=0)), limit(name, len(years)))
            for name, z in scores.items()
        ),
        *_deviations(values, record),
        *_copies(values, drawn, record),
        *_spread(simulate, record),
        *of_bootstrap,
    ]


def limit(name: str, seasons: int) -> float:
    """Largest |z| of T1 or T2 that is accepted of a record of so many seasons.

    Between the numbers of seasons that were studied it is interpolated in 1 / seasons.
    """
    shares = [-1 / studied for studied in _SEASONS]
    return float(np.interp(-1 / seasons, shares, _LIMITS[name]))


def calibrate(
    wind: LocalGridBootstrap, seasons: int, replicates: int = 800, seed: int = 1
) -> dict[str, float]:
    """Find the largest |z| of T1 and T2 that a record of the very law of a generator shows.

    Records of `seasons` seasons and simulations of 200, all drawn from `wind`, are compared as in
    `assess`: a parametric bootstrap.

    Returns
    -------
    dict
        Name of the statistic to the 99 % quantile over the replicates.
    """
    steps = round(len(wind.record) / len(np.unique(wind.record.season)))
    pool = wind.sample(seasons * replicates + 400, steps, seed)
    random = np.random.default_rng(seed)
    largest: dict[str, list[float]] = {}
    for replicate in range(replicates):
        chosen = random.choice(len(pool), seasons + 200, replace=False)
        record, simulated = pool[chosen[:seasons]], pool[chosen[seasons:]]
        scores = _scores(record, np.arange(seasons), simulated, wind.record.step_h, replicate)
        for name, z in scores.items():
            largest.setdefault(name, []).append(float(np.abs(z).max(initial=0)))
    return {name: float(np.quantile(values, 0.99)) for name, values in largest.items()}


# T1 and T2


def _pieces(record: WindRecord) -> tuple[Float, Integer]:
    """Stretches of one segment and season (pieces, steps, 2), filled up with NaN; their seasons."""
    first = np.flatnonzero(
        (np.diff(record.segment, prepend=-1) != 0)
        | (np.diff(record.season, prepend=record.season[0] - 1) != 0)
    )
    parts = np.split(record.velocity, first[1:])
    pieces = np.full((len(parts), max(map(len, parts)), 2), np.nan)
    for piece, part in zip(pieces, parts, strict=True):
        piece[: len(part)] = part
    return pieces, record.season[first]


def _scores(pieces: Float, season: Integer, simulated: Float, step_h: float, seed: int) -> Families:
    """Compare by family: (simulated - record) / standard error."""
    yardstick = _Yardstick(pieces, step_h)
    years = np.unique(season)
    if len(years) < _SEASONS[0]:
        raise RecordError(
            f"record: {len(years)} season(s) tell no standard errors; at least "
            f"{_SEASONS[0]} are needed"
        )
    belongs = (season == years[:, None]).astype(np.float64)
    of_years = {
        name: (belongs @ total, belongs @ count)
        for name, (total, count) in yardstick.sums(pieces).items()
    }
    every = np.ones(len(years))
    times_drawn = np.random.default_rng(seed).multinomial(
        len(years), every / len(years), size=_REPLICATES
    )
    found = yardstick.families(of_years, every)
    resampled = yardstick.families(of_years, times_drawn.astype(np.float64))
    expected = yardstick.families(yardstick.sums(simulated), np.ones(len(simulated)))
    scores = {}
    for name, values in found.items():
        error = resampled[name].std(axis=0)
        if name in of_years:
            # No share is known better than by one count.
            error = np.maximum(error, 1 / np.maximum(of_years[name][1].sum(axis=0), 1))
        scores[name] = (expected[name] - values) / error
    return scores


class _Yardstick:
    """What is compared: thresholds, classes and lags that suit a record.

    Quantiles are compared as the shares of values below those of the record, which differ from
    it by the same number of standard errors, and whose sums over seasons can be added up.
    """

    def __init__(self, pieces: Float, step_h: float) -> None:
        self.day = max(1, round(24 / step_h))
        values = _with_speed(pieces)
        self.mean, self.deviation = np.nanmean(values, (0, 1)), np.nanstd(values, (0, 1))
        self.below = [_thresholds(values[..., k], _LEVELS) for k in range(3)]
        self.changes = _thresholds(_changes(pieces), _LEVELS)
        self.classes = _thresholds(values[..., 2], _SPEED_CLASSES)
        self.speeds = _thresholds(values[..., 2], _PERSISTENCE_LEVELS)
        stride = max(1, self.day // 4)
        longest = min(_LONG_DAYS * self.day, pieces.shape[1] - 1)
        self.lags = np.union1d([0, 1], np.arange(stride, longest + 1, stride))
        self.short = self.lags < _SHORT_DAYS * self.day
        # Cells of the rose that the record rarely meets count as one.
        cell = self._cells(pieces)
        share = np.bincount(cell[cell >= 0]) / np.isfinite(pieces[..., 0]).sum()
        common = np.flatnonzero(share >= _LEAST_SHARE)
        self.cell = np.full(_SECTORS * (len(_SPEED_CLASSES) + 1), len(common))
        self.cell[common] = np.arange(len(common))

    def _cells(self, wind: Float) -> Integer:
        """Cell of the rose of each value: sector it blows from and class of speed; -1 for NaN."""
        u, v = np.moveaxis(wind, -1, 0)
        bearing = np.nan_to_num(np.arctan2(-u, -v)) / (2 * np.pi)
        sector = np.round(bearing * _SECTORS).astype(np.int64) % _SECTORS
        speed = np.searchsorted(self.classes, np.hypot(u, v))
        return np.where(np.isfinite(u), sector * (len(self.classes) + 1) + speed, -1)

    def sums(self, wind: Float) -> Sums:
        """Give sums and numbers of terms of all features, for each row of (rows, steps, 2)."""
        values = _with_speed(wind)
        known = np.isfinite(values[..., 2])
        number = known.sum(axis=1, dtype=np.float64)[:, None]

        below = [(values[..., k, None] < self.below[k]).sum(axis=1) for k in range(3)]
        cell = self._cells(wind)
        cell = np.where(known, self.cell[cell], -1)
        rose = [(cell == k).sum(axis=1) for k in range(self.cell.max() + 1)]
        changes = _changes(wind)
        changed = (changes[..., None] < self.changes).sum(axis=1)

        stayed, entered = [], []
        for level in self.speeds:
            for side in (values[..., 2] > level, values[..., 2] <= level):
                for steps in (1, self.day):
                    window = sliding_window_view(side, steps + 1, axis=1)
                    stayed.append(window.all(axis=-1).sum(axis=1))
                    entered.append((window[..., 0] & known[:, steps:]).sum(axis=1))

        normal = np.where(known[..., None], (values - self.mean) / self.deviation, 0.0)
        products, crossed, pairs = [], [], []
        for lag in self.lags:
            before, after = normal[:, : normal.shape[1] - lag], normal[:, lag:]
            products.append(np.einsum("rtk,rtk->rk", before, after))
            crossed.append(np.einsum("rtk,rtk->rk", before[..., :2], after[..., 1::-1]))
            pairs.append((known[:, : known.shape[1] - lag] & known[:, lag:]).sum(axis=1))
        paired = np.stack(pairs, axis=1).astype(np.float64)
        return {
            QUANTILES: _sums(np.concatenate(below, axis=1), number),
            ROSE: _sums(np.stack(rose, axis=1), number),
            PERSISTENCE: _sums(np.stack(stayed, axis=1), np.stack(entered, axis=1)),
            CHANGES: _sums(changed, np.isfinite(changes).sum(axis=1)[:, None]),
            "mean": _sums(normal.sum(axis=1), number),
            "product": _sums(np.concatenate(products, axis=1), np.repeat(paired, 3, axis=1)),
            "crossed": _sums(np.concatenate(crossed, axis=1), np.repeat(paired, 2, axis=1)),
        }

    def families(self, sums: Sums, weights: Float) -> Families:
        """Statistics of rows taken as often as `weights` (..., rows) say, (..., n) by family."""
        of = {
            name: (weights @ total) / np.maximum(weights @ count, 1)
            for name, (total, count) in sums.items()
        }
        mean, shape = of.pop("mean"), weights.shape[:-1]
        product = of.pop("product").reshape(*shape, len(self.lags), 3)
        crossed = of.pop("crossed").reshape(*shape, len(self.lags), 2)
        covariance = product - mean[..., None, :] ** 2
        variance = covariance[..., :1, :]
        correlation = covariance / variance
        cross = (crossed - (mean[..., 0] * mean[..., 1])[..., None, None]) / np.sqrt(
            variance[..., :1] * variance[..., 1:2]
        )
        short = self.short & (self.lags > 0)
        return of | {
            SHORT_ACF: correlation[..., short, :].reshape(*shape, -1),
            LONG_ACF: correlation[..., ~self.short, :].reshape(*shape, -1),
            CROSS: cross[..., self.short, :].reshape(*shape, -1),
            LAG_ONE: correlation[..., self.lags == 1, :2].reshape(*shape, -1),
        }


def _sums(total: ArrayLike, count: ArrayLike) -> tuple[Float, Float]:
    total = np.asarray(total, np.float64)
    return total, np.broadcast_to(np.asarray(count, np.float64), total.shape)


def _with_speed(wind: Float) -> Float:
    """Components and speed, (..., 3)."""
    return np.concatenate([wind, np.hypot(wind[..., :1], wind[..., 1:])], axis=-1)


def _changes(wind: Float) -> Float:
    """|ΔW| from each step to the next, (rows, steps - 1)."""
    return np.asarray(np.hypot(*np.moveaxis(np.diff(wind, axis=1), -1, 0)))


def _thresholds(values: Float, levels: tuple[float, ...]) -> Float:
    """Quantiles of a record, moved half-way to its next value: it may be rounded to 0.1 m/s."""
    known = np.unique(values[np.isfinite(values)])
    place = np.searchsorted(known, np.nanquantile(values, levels), side="right")
    place = np.clip(place, 1, len(known) - 1)
    return np.asarray((known[place - 1] + known[place]) / 2)


# T3 to T7


def _deviations(values: Float, record: WindRecord) -> list[Check]:
    error = values.std(axis=(0, 1)) / record.velocity.std(axis=0) - 1
    return [
        Check.within(DEVIATION.format(name), float(e), _LARGEST_DEVIATION)
        for name, e in zip("uv", error, strict=True)
    ]


def _copies(values: Float, drawn: Integer, record: WindRecord) -> list[Check]:
    continued = np.diff(drawn, axis=1) == 1
    run = np.zeros(len(drawn), dtype=np.int64)
    longest = 0
    for step in continued.T:
        run = (run + 1) * step
        longest = max(longest, int(run.max()))
    # A member begins at a value of the record; none should follow.
    repeated = np.isin(_keys(values[:, 1:]), _keys(record.velocity)).mean()
    last = np.diff(record.segment, append=-1) != 0
    return [
        Check(CONTINUED, float(continued.mean()), _LARGEST_CONTINUED),
        Check(LONGEST, longest, _LONGEST_RUN),
        Check(REPEATED, float(repeated), 0.0),
        Check(JOINED, int(last[drawn].sum()), 0),
    ]


def _keys(values: Float) -> Integer:
    """One integer for each pair (..., 2), the same if both agree to a millionth of a m/s."""
    whole = np.round(values * 1e6).astype(np.int64)
    return np.asarray((whole[..., 0] << 32) + whole[..., 1])


def _spread(simulate: Simulator, record: WindRecord, members: int = 200) -> list[Check]:
    """T6, over whole days around day 30: 200 members at one hour tell 5 % only."""
    speed = np.hypot(*record.velocity.T)
    candidates = rows_with_successor(record, LARGEST_ORDER)
    start = int(candidates[speed[candidates].argmax()])
    first, stop = (days * max(1, round(24 / record.step_h)) for days in _SPREAD_DAYS)
    values, _ = simulate(members, stop, start)
    phase, cycle = mean_cycle(record)
    climate = (record.velocity - cycle[phase]).var(axis=0)
    reached = values[:, first:].var(axis=0, ddof=1).mean(axis=0)
    error = np.sqrt(reached / climate) - 1
    return [
        Check.within(SPREAD.format(name), float(e), _LARGEST_SPREAD_ERROR)
        for name, e in zip("uv", error, strict=True)
    ]


# T8 and T9


def _streams(wind: LocalGridBootstrap, seed: int) -> Check:
    """T8: members one by one or in parts, shorter, and in forecasts on one to three threads."""
    members, steps = 12, 120
    whole = wind.core.sample(members, steps, seed)
    different = 0
    for size in (1, 5):
        for first in range(0, members, size):
            count = min(size, members - first)
            part = wind.core.sample(count, steps // size, seed, first_member=first)
            for simulated, expected in zip(part, whole, strict=True):
                own = expected[first : first + count, : steps // size]
                different += int((simulated != own).sum())
    alone, *others = (
        forecast(paper.scenario(), wind, members=members, seed=seed, threads=n, chunk=13 - 4 * n)
        for n in (1, 2, 3)
    )
    for name, variable in alone.dataset.data_vars.items():
        for other in others:
            values, same = variable.to_numpy(), other.dataset[name].to_numpy()
            different += int(((values != same) & ((values == values) | (same == same))).sum())
    return Check(STREAMS, different, 0)


def _weights(wind: LocalGridBootstrap, seed: int) -> Check:
    """T9, between states of the record, where a chain that does not copy it is."""
    statistic, freedom = 0.0, 0
    for row in np.linspace(1, len(wind.states) - 1, _FIXED_STATES).astype(int):
        state = wind.states[row - 1 : row + 1].mean(axis=0)
        drawn = wind.core.draws_at(state, _DRAWS, seed + int(row))
        counts = np.bincount(np.searchsorted(wind.row, drawn), minlength=len(wind.row))
        found = chi_square(counts, _DRAWS * wind.weights(state))
        statistic, freedom = statistic + found[0], freedom + found[1]
    return Check(WEIGHTS, chi_square_p(statistic, freedom), 1.0, _LEAST_P)
