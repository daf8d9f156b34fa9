"""The Local Grid Bootstrap fitted to a wind record, and wind paths given by the user.

`LocalGridBootstrap.fit` subtracts the mean cycle of a record and keeps the remaining *anomalies* as
a catalogue of states and successors, from which the compiled core draws new winds
(docs/equations.md; Monbet & Marteau 2006; Monbet, Ailliot & Prevosto 2007).
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Self, TypeAlias, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore import _core
from driftcore.errors import RecordError, ScenarioError, warn
from driftcore.memory import require_room, require_room_for
from driftcore.record import (
    Float,
    Gaps,
    Integer,
    Source,
    WindRecord,
    listed,
    mean_cycle,
    read_record,
    rows_with_successor,
)
from driftcore.times import nanoseconds

Single: TypeAlias = NDArray[np.float32]
Mode = Literal["residual", "lgb"]

_LEAST_ROWS = 200
_FEW_SEASONS = 3
LARGEST_ORDER = 8

# The search of the bandwidths: geometric grids (for `lgb` below its limits), and how much of a
# long record is scored, or averaged over.
_BANDWIDTHS = 0.1 * 2.0 ** (np.arange(17) / 4)
WIDEST_RESIDUAL = 0.5
_LIMIT_SHARES = 2.0 ** (np.arange(-4, 1) / 2)
_SCORED_PAIRS = 5_000_000
_AVERAGED_PAIRS = 100_000_000
_LEAST_SCORED = 400
_SCORED_AT_ONCE = 32


@dataclass(frozen=True, eq=False)
class LocalGridBootstrap:
    """Resampler of a wind record: new series with its marginals, rose, memory and daily cycle.

    Made by `fit`. Row `i` of the catalogue is a state of the record that has a successor.

    Attributes
    ----------
    record : WindRecord
    mode : {"residual", "lgb"}
    h : float
        Bandwidth of the kernel, in units of the whitened states.
    b : float or None
        Noise of mode `lgb` as a share of the anomalies' standard deviation.
    order : int
        Markov order p.
    share, memory_h : float
        Small-scale share of the total standard deviation, and its memory [h].
    likelihood : structured ndarray with fields `h`, `b`, `log_likelihood`
        The candidates' mean log predictive density of a value [nats] when its whole season is
        left out, in mode `residual` also beyond the limit of `h`, and with `b` NaN. Empty where
        nothing was left to choose.
    states : ndarray, shape (n, 2p)
        Anomalies (X_j, X_{j-1}, ...) [m/s], newest first.
    target : ndarray, shape (n, 2)
        The successor X_{j+1} (`lgb`), or what the predictor misses of it, standardised
        (`residual`) [m/s].
    whitening : ndarray, shape (2p, 2p)
        `z = whitening @ y` has covariance 1 over the catalogue.
    predictor : ndarray, shape (2, 2p + 1)
        `[c, A]` of the least-squares one-step predictor `c + A y`; zero in mode `lgb`.
    noise : ndarray, shape (2, 2)
        `b L` with `L Lᵀ` the anomalies' covariance; zero in mode `residual`.
    row, phase : ndarray of int64, shape (n,)
        Row of X_j in the record, and its place in the cycle.
    start : ndarray of bool, shape (n,)
        Whether a simulation may begin at X_j: it needs a row before it in its segment.
    cycle : ndarray, shape (phases, 2)
        Mean cycle [m/s].
    """

    record: WindRecord
    mode: Mode
    h: float
    b: float | None
    order: int
    share: float
    memory_h: float
    likelihood: NDArray[np.void]
    states: Float
    target: Float
    whitening: Float
    predictor: Float
    noise: Float
    row: Integer
    phase: Integer
    start: NDArray[np.bool_]
    cycle: Float

    @classmethod
    def fit(
        cls,
        record: Source | WindRecord,
        months: Iterable[int] | None = (6, 7, 8),
        mode: Mode = "residual",
        h: float | None = None,
        b: float | None = None,
        order: int = 2,
        *,
        gaps: Gaps = "error",
        share: float = 0.1,
        memory_h: float = 3.0,
    ) -> Self:
        """Fit the bootstrap to a record.

        Given the present state `y*`, a catalogue row `J` is drawn with weight
        `exp(-|z* - z_J|² / 2h²)`; the next anomaly is `X_{J+1} + b L ξ` in mode `lgb` (the
        paper's), or `c + A y* + r_J` in mode `residual`, with the residuals
        `r_j = S (X_{j+1} - c - A y_j - m)`. A state far from all others is drawn too seldom, and
        there the wind changes most. So `m` and `S` are chosen such that what is drawn at the
        states of the record has mean zero and the covariance that least squares leave: the
        record's mean and variance are kept from one step to the next.

        Left out, `h` (and `b`) maximise the log-likelihood of each season given the others. The
        predictive density of mode `lgb` is the one it draws from, a mixture of Gaussians of
        covariance `b² L Lᵀ`. Mode `residual` draws residuals as they are, which has no density:
        they are smoothed by a Gaussian kernel in the plane of the whitened residuals, with
        Silverman's bandwidth `k^(-1/6)` for the `k = (Σw)² / Σw²` rows that count at `y*`.
        The likelihood looks one step ahead and would smooth more than a long series bears, so
        `h` and `b` stay below limits. In mode `lgb`, as a kernel step turns a lag-1 correlation
        ρ into ρ / (1 + h²) and the noise inflates the variance by b² / (1 - ρ²): `h² ρ` below
        one standard error of that correlation (jackknife over seasons), `b² ≤ 0.02 (1 - ρ²)`.
        In mode `residual`, `h ≤ 0.5`: of six real summers, h = 0.34, 0.4 and 0.48 continue the
        record in 16, 10 and 6 % of the draws, and for up to 23, 21 and 12 steps, but the
        quantiles of the simulated speeds err the more, the wider the kernel.

        Parameters
        ----------
        record : WindRecord or what `read_record` accepts
        months : iterable of int or None
            Calendar months to resample; None for all that the record has.
        mode : {"residual", "lgb"}
        h : float, optional
            Bandwidth, > 0.
        b : float, optional
            Noise, ≥ 0, of mode `lgb` only.
        order : int
            Markov order, 1 to 8.
        gaps : {"error", "segment"}
            See `read_record`; a `WindRecord` has settled it.
        share : float
            Small-scale share of the total standard deviation, in [0, 1).
        memory_h : float
            Memory of the small-scale part [h], > 0.

        Raises
        ------
        RecordError
            If the record does not serve, has fewer than 200 usable rows, or has a single season
            while `h` or `b` is left to choose.
        ScenarioError
            If another argument is out of its range.

        Warns
        -----
        DriftCoreWarning
            If the record has fewer than 3 seasons.
        """
        if mode not in get_args(Mode):
            raise ScenarioError(f"mode: {mode!r} is not accepted; use {listed(get_args(Mode))}")
        if mode == "residual" and b is not None:
            raise ScenarioError(f"b: {b!r} is given, but only mode 'lgb' adds noise; leave it out")
        order = _whole("order", order, 1, LARGEST_ORDER)
        h = None if h is None else _real("h", h, 0.0, math.inf, "a number above 0", open_low=True)
        b = None if b is None else _real("b", b, 0.0, math.inf, "a number of at least 0")
        if b == 0 and h is None:
            raise ScenarioError("b: without noise there is no density to choose h by; give h too")
        share = _real("share", share, 0.0, 1.0, "a number from 0 to below 1")
        memory_h = _real(
            "memory_h", memory_h, 0.0, math.inf, "a number of hours above 0", open_low=True
        )
        if not isinstance(record, WindRecord):
            record = read_record(record, months, gaps=gaps)
        elif months is not None:
            record = record.select(months)

        row = rows_with_successor(record, order)
        seasons = len(np.unique(record.season[row]))
        if len(row) < _LEAST_ROWS:
            raise RecordError(
                f"record: {len(row)} rows have {order - 1} row(s) before and one after them in "
                f"their segment; at least {_LEAST_ROWS} are needed ({record.describe()})"
            )
        if seasons < _FEW_SEASONS:
            warn(
                f"the wind record has {seasons} season(s): the forecast knows the variability "
                f"inside them, not between years ({record.describe()})"
            )
        phase, cycle = mean_cycle(record)
        anomaly = record.velocity - cycle[phase]
        states = np.concatenate([anomaly[row - lag] for lag in range(order)], axis=1)
        successor = anomaly[row + 1]
        whitening = _whitener(np.cov(states.T), "record: the wind's states")

        likelihood = np.empty(0, dtype=_LIKELIHOOD)
        if h is None or (mode == "lgb" and b is None):
            if seasons < 2:
                chosen = "h" if h is None else "b"
                raise RecordError(
                    f"{chosen}: it is chosen by leaving out one season of at least 2, and the "
                    f"record has {seasons}; give {chosen} or a longer record"
                )
            candidates = _candidates(mode, h, b, anomaly, record)
            likelihood = _score(candidates, mode, states, whitening, successor, record, row)
            bounded = likelihood
            if mode == "residual":
                bounded = likelihood[likelihood["h"] <= WIDEST_RESIDUAL]
            best = bounded[bounded["log_likelihood"].argmax()]
            h = float(best["h"])
            b = float(best["b"]) if mode == "lgb" else None

        predictor = np.zeros((2, 2 * order + 1))
        noise: Float = np.zeros((2, 2))
        if mode == "residual":
            predictor = _least_squares(states, successor)
            share_drawn = _drawn_share(states @ whitening.T, h, round(24 / record.step_h))
            target = _standardized(successor - _predict(predictor, states), share_drawn)
        else:
            target = successor
            noise = np.asarray((b or 0.0) * np.linalg.cholesky(np.cov(anomaly.T)), np.float64)
        return cls(
            record=record,
            mode=mode,
            h=h,
            b=b,
            order=order,
            share=share,
            memory_h=memory_h,
            likelihood=likelihood,
            states=states,
            target=target,
            whitening=whitening,
            predictor=predictor,
            noise=noise,
            row=row,
            phase=phase[row],
            start=(row > 0) & (record.segment[row] == record.segment[row - 1]),
            cycle=cycle,
        )

    @cached_property
    def core(self) -> _core.Bootstrap:
        """The compiled sampler."""
        return _core.Bootstrap(
            self.states,
            self.whitening,
            self.target,
            self.predictor,
            self.noise,
            self.row,
            self.phase,
            self.start,
            self.cycle,
            self.h,
        )

    @cached_property
    def standard_deviation(self) -> float:
        """Root of the mean variance of the record's components, daily cycle included [m/s]."""
        return float(np.sqrt(self.record.velocity.var(axis=0).mean()))

    @property
    def small_scale_sd(self) -> float:
        """Standard deviation of each component of the small-scale part [m/s].

        It is `share` of the standard deviation of both parts together.
        """
        return self.share * self.standard_deviation / math.sqrt(1 - self.share**2)

    @property
    def span_days(self) -> float:
        """Days after which a simulation leaves the season it stands for."""
        return self.record.span_days

    def weights(self, state: ArrayLike) -> Float:
        """Probability that each row of the catalogue is drawn at a state, (n,).

        Parameters
        ----------
        state : array_like, shape (2p,)
            Anomalies (X, …) [m/s], newest first.
        """
        whitened = np.atleast_2d(_real_array("state", state)) @ self.whitening.T
        weight = _kernel_weights(whitened, self.states @ self.whitening.T, self.h)[0]
        return np.asarray(weight / weight.sum(dtype=np.float64), np.float64)

    def config(self) -> dict[str, Any]:
        """Everything needed to fit again, in types that TOML has: absent keys were not set.

        `sha256` tells whether the record found later is the same.
        """
        settings = {
            "label": self.record.label,
            "synthetic": self.record.synthetic,
            "source": self.record.source,
            "sha256": self.record.sha256,
            "gaps": self.record.gaps,
            "months": list(self.record.months),
            "mode": self.mode,
            "h": self.h,
            "b": self.b,
            "order": self.order,
            "share": self.share,
            "memory_h": self.memory_h,
        }
        return {key: value for key, value in settings.items() if value is not None}

    def phase_before(self, phase: int, steps: int) -> int:
        """Phase of the mean cycle so many steps before another."""
        return (phase - steps) % len(self.cycle)

    @overload
    def sample(
        self, members: int, steps: int, seed: int, return_indices: Literal[False] = False
    ) -> Float: ...

    @overload
    def sample(
        self, members: int, steps: int, seed: int, return_indices: Literal[True]
    ) -> tuple[Float, Integer]: ...

    def sample(
        self, members: int, steps: int, seed: int, return_indices: bool = False
    ) -> Float | tuple[Float, Integer]:
        """Simulate the synoptic wind.

        Each member begins at a row of the record, and depends on `seed` and its number only.

        Parameters
        ----------
        members, steps : int
            At least 1; a step is the record's.
        seed : int
            From 0 to 2⁶⁴ - 1.
        return_indices : bool
            Also return the rows drawn.

        Returns
        -------
        values : ndarray, shape (members, steps, 2)
            Wind toward east and north [m/s], mean cycle included.
        indices : ndarray of int64, shape (members, steps)
            Row of the record whose successor made each value.

        Raises
        ------
        ScenarioError
            If an argument is out of its range.
        """
        members, steps = _whole("members", members, 1), _whole("steps", steps, 1)
        # Twice over, for the core hands over what it has gathered.
        require_room("members", float(members) * steps, 2 * 24, f"members' steps, {steps} each,")
        values, indices = self.core.sample(members, steps, _whole("seed", seed, 0, 2**64 - 1))
        return (values, indices) if return_indices else values

    def __getstate__(self) -> dict[str, Any]:
        # The compiled sampler is made again from the arrays in the process that needs it.
        return {key: value for key, value in self.__dict__.items() if key != "core"}

    def __repr__(self) -> str:
        noise = "" if self.b is None else f", b={self.b:.3g}"
        return (
            f"LocalGridBootstrap({self.record.describe()}; mode={self.mode!r}, h={self.h:.3g}"
            f"{noise}, order={self.order})"
        )


class WindPath:
    """Wind uniform in space, linear between knots.

    Parameters
    ----------
    times : array_like, shape (k,)
        Knots, strictly increasing, at least 2 [the scenario's time unit]; on a geographic scenario
        datetime64, UTC, and the velocity in m/s.
    velocity : array_like, shape (k, 2)
        Velocity toward x and y at the knots [the scenario's velocity unit].

    Raises
    ------
    ScenarioError
        If shapes, order or values do not fit, or a method is asked beyond the knots.
    """

    times: Float
    velocity: Float
    instants: NDArray[np.datetime64] | None
    """The knots, where they were given in UTC; `times` are then days from the first."""

    def __init__(self, times: ArrayLike, velocity: ArrayLike) -> None:
        self.instants = None
        if np.issubdtype(np.asarray(times).dtype, np.datetime64):
            if np.isnat(times).any() or not np.size(times):
                raise ScenarioError("times: must be UTC times, at least 2, none of them missing")
            self.instants = nanoseconds("times", times)
            times = (self.instants - self.instants.flat[0]) / np.timedelta64(1, "D")
        self.times = _real_array("times", times)
        self.velocity = _real_array("velocity", velocity)
        if self.times.ndim != 1 or len(self.times) < 2:
            raise ScenarioError(
                f"times: shape {self.times.shape} is not accepted; give at least 2 knots, (k,)"
            )
        if self.velocity.shape != (len(self.times), 2):
            raise ScenarioError(
                f"velocity: shape {self.velocity.shape} is not accepted; "
                f"{len(self.times)} times need ({len(self.times)}, 2)"
            )
        backward = np.flatnonzero(np.diff(self.times) <= 0)
        if backward.size:
            knot = int(backward[0]) + 1
            raise ScenarioError(
                f"times: knot {knot} ({self.times[knot]:g}) does not come after knot {knot - 1} "
                f"({self.times[knot - 1]:g}); times must increase strictly"
            )
        self.core = _core.WindPath(self.times, self.velocity)

    def at(self, t: ArrayLike) -> Float:
        """Wind at times `t` of any shape [velocity], shape `t.shape + (2,)`."""
        time = self._inside(t)
        return self.core.velocity(time.ravel()).reshape(*time.shape, 2)

    def mean(self, t: ArrayLike, window: float) -> Float:
        """Mean over `window` [time] centred at `t` [velocity], shape `t.shape + (2,)`."""
        window = _real("window", window, 0.0, math.inf, "a time above 0", open_low=True)
        time = self._inside(t, window / 2)
        return self.core.mean(time.ravel(), window).reshape(*time.shape, 2)

    def integral(self, t: ArrayLike) -> Float:
        """Integral from the first knot to `t` [length], shape `t.shape + (2,)`."""
        time = self._inside(t)
        return self.core.integral(time.ravel()).reshape(*time.shape, 2)

    def _inside(self, t: ArrayLike, margin: float = 0.0) -> Float:
        time = _real_array("t", t)
        first, last = self.times[0], self.times[-1]
        # Knots made by repeated addition end a rounding error off the time they stand for.
        margin -= 1e-9 * (last - first)
        outside = time[(time - margin < first) | (time + margin > last)]
        if outside.size:
            need = f" with {margin:g} on each side" if margin > 0 else ""
            raise ScenarioError(
                f"t: {outside.flat[0]:g}{need} is not covered by the path, "
                f"which is known on [{first:g}, {last:g}]"
            )
        return time

    def __repr__(self) -> str:
        first, last = self.times[0], self.times[-1]
        return f"WindPath({len(self.times)} knots on [{first:g}, {last:g}])"


class WindPaths:
    """Winds of an ensemble on common, regular knots, kept the way that the core steps through them.

    Parameters
    ----------
    times : array_like, shape (k,)
        Knots, equally spaced, at least 2 [the scenario's time unit].
    velocity : array_like, shape (members, k, 2)
        Velocity toward x and y at the knots [the scenario's velocity unit]. An array of single
        precision is kept as it is: it takes half the memory, and two thirds of the time where many
        members' winds have to be fetched.

    Raises
    ------
    ScenarioError
        If shapes, spacing or values do not fit.
    """

    times: Float

    def __init__(self, times: ArrayLike, velocity: ArrayLike) -> None:
        self.times = _real_array("times", times)
        single = getattr(velocity, "dtype", None) == np.float32
        values = _real_array("velocity", velocity, np.float32 if single else np.float64)
        if self.times.ndim != 1 or len(self.times) < 2:
            raise ScenarioError(
                f"times: shape {self.times.shape} is not accepted; give at least 2 knots, (k,)"
            )
        if values.ndim != 3 or not len(values) or values.shape[1:] != (len(self.times), 2):
            raise ScenarioError(
                f"velocity: shape {values.shape} is not accepted; "
                f"{len(self.times)} times need (members, {len(self.times)}, 2)"
            )
        spacing = float(self.times[-1] - self.times[0]) / (len(self.times) - 1)
        regular = self.times[0] + spacing * np.arange(len(self.times))
        if spacing <= 0 or np.abs(self.times - regular).max() > 1e-9 * spacing:
            raise ScenarioError("times: must be equally spaced and increase; else use WindPath")
        self._members = len(values)
        self.core = _core.WindPaths(float(self.times[0]), spacing, values)

    def __len__(self) -> int:
        return self._members

    def __repr__(self) -> str:
        first, last = self.times[0], self.times[-1]
        return f"WindPaths({len(self)} members, {len(self.times)} knots on [{first:g}, {last:g}])"


# Arguments


def _whole(field: str, value: int, low: int, high: int | None = None) -> int:
    bounds = f"at least {low}" if high is None else f"from {low} to {high}"
    try:
        number = operator.index(value)
    except TypeError:
        number = low - 1
    if isinstance(value, bool) or number < low or (high is not None and number > high):
        raise ScenarioError(f"{field}: {value!r} is not accepted; use a whole number {bounds}")
    return number


def _real(
    field: str, value: float, low: float, high: float, accepted: str, *, open_low: bool = False
) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not low <= number < high or (open_low and number == low):
        raise ScenarioError(f"{field}: {value!r} is not accepted; use {accepted}")
    return number


def _real_array(field: str, values: ArrayLike, dtype: type[np.floating] = np.float64) -> Float:
    require_room_for(field, values)
    try:
        array: Float = np.array(values, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"{field}: {error}; give an array of numbers") from error
    if not np.isfinite(array).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ScenarioError(
            f"{field}: {array[place]} at {place} is not accepted; give finite values"
        )
    array.flags.writeable = False
    return array


# Fitting

_LIKELIHOOD = np.dtype([("h", np.float64), ("b", np.float64), ("log_likelihood", np.float64)])


def _whitener(covariance: Float, name: str) -> Float:
    """Matrix `K` such that `K @ value` has covariance 1 if `value` has the one given, (d, d)."""
    if np.linalg.cond(covariance) > 1e12:
        raise RecordError(
            f"{name} do not vary in every direction (covariance of rank "
            f"{np.linalg.matrix_rank(covariance)} in {len(covariance)} dimensions); a bootstrap "
            "needs a varying wind"
        )
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)), np.float64)


def _least_squares(states: Float, successor: Float) -> Float:
    """`[c, A]` that minimises the misfit of `c + A y`, shape (2, 2p + 1)."""
    design = np.column_stack([np.ones(len(states)), states])
    fitted, *_ = np.linalg.lstsq(design, successor, rcond=None)
    return np.asarray(fitted.T, np.float64)


def _predict(predictor: Float, states: Float) -> Float:
    return predictor[:, 0] + states @ predictor[:, 1:].T


def _drawn_share(whitened: Float, h: float, per_day: int) -> Float:
    """Share of the draws that each row gets at the states of the record, (n,)."""
    share = np.zeros(len(whitened))
    stride = _stride(len(whitened), per_day, _AVERAGED_PAIRS)
    for rows in _batches(np.arange(0, len(whitened), stride)):
        weight = _kernel_weights(whitened[rows], whitened, h)
        share += (1 / weight.sum(axis=1)) @ weight
    return np.asarray(share / share.sum(), np.float64)


def _kernel_weights(whitened: Float, catalogue: Float, h: float) -> Single:
    """Weight of each row of a catalogue at each state, 1 for the nearest, (states, n)."""
    distance2 = _squared_distances(whitened, catalogue)
    distance2 -= distance2.min(axis=1, keepdims=True)
    return np.asarray(np.exp(distance2 / np.float32(-2 * h**2)))


def _standardized(residual: Float, share: Float) -> Float:
    """Residuals that have mean zero and their plain covariance if drawn with `share`, (n, 2)."""
    name = "record: the wind's changes"
    centered = residual - share @ residual
    drawn = _whitener((centered.T * share) @ centered, name)
    plain = _whitener(residual.T @ residual / len(residual), name)
    return np.asarray(centered @ (np.linalg.inv(plain) @ drawn).T, np.float64)


def _candidates(
    mode: Mode, h: float | None, b: float | None, anomaly: Float, record: WindRecord
) -> NDArray[np.void]:
    """Pairs (h, b) to compare; a value that was given is the only one."""
    bandwidths = _BANDWIDTHS
    factors = np.array([math.nan])
    if mode == "lgb":
        largest_h, largest_b = _limits(anomaly, record)
        bandwidths, factors = largest_h * _LIMIT_SHARES, largest_b * _LIMIT_SHARES
    pairs = [
        (h_tried, b_tried, math.nan)
        for h_tried in (bandwidths if h is None else [h])
        for b_tried in (factors if b is None else [b])
    ]
    return np.array(pairs, dtype=_LIKELIHOOD)


def _limits(anomaly: Float, record: WindRecord) -> tuple[float, float]:
    """Largest `h` and `b` of mode `lgb`, see `LocalGridBootstrap.fit`."""
    same = np.flatnonzero(record.segment[1:] == record.segment[:-1])
    products = anomaly[same] * anomaly[same + 1]
    squares = (anomaly[same] ** 2 + anomaly[same + 1] ** 2) / 2
    season = record.season[same]
    years = np.unique(season)
    # Jackknife: the correlation of all seasons but one, for each season.
    left_out = np.stack(
        [products[season != y].sum(axis=0) / squares[season != y].sum(axis=0) for y in years]
    )
    correlation = products.sum(axis=0) / squares.sum(axis=0)
    standard_error = np.sqrt((len(years) - 1) * left_out.var(axis=0))
    largest_h = np.sqrt(standard_error / np.abs(correlation)).min()
    largest_b = np.sqrt(0.02 * (1 - correlation**2)).min()
    return float(largest_h), float(largest_b)


def _score(
    candidates: NDArray[np.void],
    mode: Mode,
    states: Float,
    whitening: Float,
    successor: Float,
    record: WindRecord,
    row: Integer,
) -> NDArray[np.void]:
    """Fill in the mean log predictive density of each candidate, season by season left out."""
    season = record.season[row]
    whitened = states @ whitening.T
    stride = _stride(len(row), round(24 / record.step_h), _SCORED_PAIRS)
    scored = np.arange(0, len(row), stride)
    total = np.zeros(len(candidates))
    for year in np.unique(season):
        kept = season != year
        predictor = np.zeros((2, states.shape[1] + 1))
        if mode == "residual":
            predictor = _least_squares(states[kept], successor[kept])
        missed = successor - _predict(predictor, states)
        scale = _whitener(np.cov(missed[kept].T), "record: the wind's changes")
        missed = missed @ scale.T
        log_volume = np.log(np.linalg.det(scale) / (2 * np.pi))
        left_out = scored[season[scored] == year]
        for rows in _batches(left_out):
            distance2 = _squared_distances(whitened[rows], whitened[kept])
            distance2 -= distance2.min(axis=1, keepdims=True)
            missed2 = _squared_distances(missed[rows], missed[kept])
            for k, (h, b, _) in enumerate(candidates):
                log_density = _log_density(distance2, missed2, h, None if mode == "residual" else b)
                total[k] += log_density.sum(dtype=np.float64) + len(rows) * log_volume
    candidates["log_likelihood"] = total / len(scored)
    return candidates


def _log_density(distance2: Single, missed2: Single, h: float, b: float | None) -> Single:
    """Log density of a kernel mixture [nats] but for the volume of its metric, shape (m,).

    `distance2`, `missed2` (m, n): squared distances of states (0 for the nearest) and of
    outcomes; `b` is the outcomes' bandwidth, Silverman's rule for the rows that count if None.
    """
    exponent = distance2 / np.float32(-2 * h**2)
    weight = np.exp(exponent)
    mass = weight.sum(axis=1)
    if b is None:
        variance = (np.square(weight, out=weight).sum(axis=1) / mass**2) ** np.float32(1 / 3)
    else:
        variance = np.full_like(mass, b**2)
    exponent -= missed2 / (2 * variance[:, None])
    largest = exponent.max(axis=1)
    exponent -= largest[:, None]
    log_sum = np.log(np.exp(exponent, out=exponent).sum(axis=1))
    log_density: Single = log_sum + largest - np.log(mass * variance)
    return log_density


def _stride(rows: int, per_day: int, pairs: int) -> int:
    """Stride through the rows of a long record that are compared with all; it meets every hour."""
    stride = math.ceil(rows / max(_LEAST_SCORED, pairs / rows))
    while math.gcd(stride, per_day) > 1:
        stride += 1
    return stride


def _batches(rows: Integer) -> Iterator[Integer]:
    """Few enough rows at a time that their distances to a record stay in the cache."""
    for first in range(0, len(rows), _SCORED_AT_ONCE):
        yield rows[first : first + _SCORED_AT_ONCE]


def _squared_distances(left: Float, right: Float) -> Single:
    """Squared distances of the rows of two matrices, in single precision for speed."""
    products = left @ right.T
    squares = (left**2).sum(axis=1)[:, None] + (right**2).sum(axis=1)
    distances: Single = np.maximum(squares - 2 * products, 0.0).astype(np.float32)
    return distances
