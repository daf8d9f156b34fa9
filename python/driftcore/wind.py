"""Wind records, the Local Grid Bootstrap fitted to them, and wind paths given by the user.

A record is a regular series of 10 m wind. `LocalGridBootstrap.fit` subtracts its mean cycle and
keeps the remaining *anomalies* as a catalogue of states and successors, from which the compiled
core draws new winds (docs/equations.md; Monbet & Marteau 2006; Monbet, Ailliot & Prevosto 2007).
"""

from __future__ import annotations

import hashlib
import math
import operator
import warnings
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeAlias, get_args, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore import _core
from driftcore.errors import DriftCoreWarning, RecordError, ScenarioError

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Float: TypeAlias = NDArray[np.float64]
Single: TypeAlias = NDArray[np.float32]
Integer: TypeAlias = NDArray[np.int64]
Times: TypeAlias = NDArray[np.datetime64]
Source: TypeAlias = "str | PathLike[str] | pd.DataFrame | xr.Dataset"
Gaps = Literal["error", "segment"]
Mode = Literal["residual", "lgb"]

_HOUR = np.timedelta64(3600, "s")
_TIME_NAMES = ("time", "valid_time")
_COMPONENT_NAMES = (("u10", "v10"), ("u", "v"))
_METRES_PER_SECOND = {"m s-1", "m s**-1", "m s^-1", "m/s", "m.s-1", "ms-1", "meter second-1"}
_MONTH_DAYS = (31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31)

# What no wind over the sea in m/s exceeds, but the same wind in knots (1.94 times more) often
# does. Reanalyses put the windiest seas at a yearly mean of 12 m/s and a thousandth of hours
# above 28 m/s; one hour in a thousand at hurricane force (Beaufort 12) is found nowhere.
_MEAN_SPEED_LIMIT = 12.5
_RARE_SPEED_LIMIT = 32.7
_ANY_SPEED_LIMIT = 100.0

_LEAST_ROWS = 200
_FEW_SEASONS = 3
_SEASON_MONTHS = 4
_LARGEST_ORDER = 8

# The search of the bandwidths: geometric grids (for `lgb` below its limits), and how much of a
# long record is scored, or averaged over.
_BANDWIDTHS = 0.1 * 2.0 ** (np.arange(17) / 4)
_WIDEST_RESIDUAL = 0.5
_LIMIT_SHARES = 2.0 ** (np.arange(-4, 1) / 2)
_SCORED_PAIRS = 5_000_000
_AVERAGED_PAIRS = 100_000_000
_LEAST_SCORED = 400
_SCORED_AT_ONCE = 32


@dataclass(frozen=True, eq=False)
class WindRecord:
    """A wind record that passed every check of `read_record`, cut to the months chosen.

    Attributes
    ----------
    times : ndarray of datetime64[s], shape (n,)
        UTC, increasing, regular inside each segment.
    velocity : ndarray, shape (n, 2)
        Velocity toward east and north [m/s].
    step_h : float
        Step [h] inside the segments; it divides the day.
    label : str
        What the record is, in words for people.
    synthetic : bool
        Whether the values were made by a model of a climate instead of observed or analysed.
    source : str or None
        Path of the file the record was read from.
    gaps : str
        How gaps were met when it was read.
    """

    times: Times
    velocity: Float
    step_h: float
    label: str
    synthetic: bool = False
    source: str | None = None
    gaps: Gaps = "error"

    def __post_init__(self) -> None:
        self.times.flags.writeable = False
        self.velocity.flags.writeable = False

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def segment(self) -> Integer:
        """Segment of each row, shape (n,): rows of one segment follow each other by one step."""
        breaks = np.diff(self.times) != self.step_h * _HOUR
        return np.concatenate([[0], np.cumsum(breaks)]).astype(np.int64)

    @cached_property
    def months(self) -> tuple[int, ...]:
        """Calendar months that occur in the record."""
        return tuple(int(month) for month in np.unique(_calendar(self.times)[0]))

    @cached_property
    def season(self) -> Integer:
        """Year in which the season of each row began, shape (n,): what validation leaves out."""
        month, _ = _calendar(self.times)
        year = self.times.astype("datetime64[Y]").astype(np.int64) + 1970
        return year - (month < _season_start(self.months))

    @cached_property
    def sha256(self) -> str:
        """Digest of the times [s since 1970] and the velocities, as little-endian bytes."""
        digest = hashlib.sha256(self.times.astype("<i8").tobytes())
        digest.update(self.velocity.astype("<f8").tobytes())
        return digest.hexdigest()

    def select(self, months: Iterable[int]) -> WindRecord:
        """Keep the rows of some calendar months; each contiguous block becomes a segment.

        Raises
        ------
        RecordError
            If a month is not an integer from 1 to 12, or no row is left.
        """
        return self._keep(_chosen(self.times, _checked_months(months)))

    def _keep(self, rows: NDArray[np.bool_]) -> WindRecord:
        return WindRecord(
            self.times[rows],
            self.velocity[rows],
            self.step_h,
            self.label,
            self.synthetic,
            self.source,
            self.gaps,
        )

    def describe(self) -> str:
        """Say in one line what the record is."""
        first, last = (_stamp(time) for time in self.times[[0, -1]])
        months = ", ".join(map(str, self.months))
        return (
            f"{self.label}: {len(self)} rows every {self.step_h:g} h from {first} to {last}, "
            f"months {months}, {self.segment[-1] + 1} segment(s)"
        )


def read_record(
    source: Source,
    months: Iterable[int] | None = None,
    *,
    gaps: Gaps = "error",
    label: str | None = None,
) -> WindRecord:
    """Read and check a wind record.

    Parameters
    ----------
    source : path, pandas.DataFrame or xarray.Dataset
        A CSV (also compressed) or NetCDF file, or data in memory, with the components `u10, v10`
        or `u, v` [m/s, toward east and north]. The time axis is a column, an index or a dimension
        `time` or `valid_time`; without a zone it is UTC, with one it is converted to UTC.
    months : iterable of int, optional
        Calendar months to keep (1 to 12); all when left out. Only rows of these months need to be
        finite and without gaps.
    gaps : {"error", "segment"}
        Refuse a record with missing rows, or cut it there. Gaps are never bridged.
    label : str, optional
        Words for the record; default: its attribute `wind_label` or its file name.

    Returns
    -------
    WindRecord

    Raises
    ------
    RecordError
        If the file, the columns, the time axis, the values or the months do not serve.

    Warns
    -----
    DriftCoreWarning
        If the speeds are those of knots rather than m/s (mean above 12.5, or one value in a
        thousand above 32.7; judged over all months of the source), if one is above 100, or if
        `units` are stated and are not m/s. Knots of a calm season alone pass unseen: doubled,
        they are the wind of a stormy sea.
    """
    if gaps not in get_args(Gaps):
        raise RecordError(f"gaps: {gaps!r} is not accepted; use {_listed(get_args(Gaps))}")
    chosen_months = None if months is None else _checked_months(months)
    path, table, units = _as_table(source)
    components = _component_names(table.columns)
    times = _utc_times(table)
    velocity = np.stack([_numbers(table, name) for name in components], axis=1)

    backward = np.flatnonzero(np.diff(times) <= np.timedelta64(0))
    if backward.size:
        row = int(backward[0]) + 1
        fault = "repeats" if times[row] == times[row - 1] else "is earlier than"
        raise RecordError(
            f"time: row {row} ({_stamp(times[row])}) {fault} the row before it "
            f"({_stamp(times[row - 1])}); times must increase"
        )
    if len(times) < 2:
        raise RecordError(f"time: the record has {len(times)} row(s); at least 2 are needed")
    steps, counts = np.unique(np.diff(times), return_counts=True)
    step = steps[counts.argmax()]
    if np.timedelta64(86400, "s") % step != np.timedelta64(0):
        raise RecordError(
            f"time: the step is {step / _HOUR:g} h; accepted are steps that divide 24 h"
        )

    kept = np.full(len(times), True)
    if chosen_months is not None:
        kept = _chosen(times, chosen_months)
    _require_finite(times, velocity, kept, components)
    _require_regular(times, step, kept, chosen_months, gaps)
    _warn_of_units(velocity, units)
    attributes = table.attrs
    default_label = "wind record in memory" if path is None else Path(path).name
    return WindRecord(
        times=times,
        velocity=velocity,
        step_h=float(step / _HOUR),
        label=label or str(attributes.get("wind_label", default_label)),
        synthetic=bool(attributes.get("wind_synthetic", False)),
        source=path,
        gaps=gaps,
    )._keep(kept)


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
            raise ScenarioError(f"mode: {mode!r} is not accepted; use {_listed(get_args(Mode))}")
        if mode == "residual" and b is not None:
            raise ScenarioError(f"b: {b!r} is given, but only mode 'lgb' adds noise; leave it out")
        order = _whole("order", order, 1, _LARGEST_ORDER)
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

        row = _rows_with_successor(record, order)
        seasons = len(np.unique(record.season[row]))
        if len(row) < _LEAST_ROWS:
            raise RecordError(
                f"record: {len(row)} rows have {order - 1} row(s) before and one after them in "
                f"their segment; at least {_LEAST_ROWS} are needed ({record.describe()})"
            )
        if seasons < _FEW_SEASONS:
            warnings.warn(
                f"the wind record has {seasons} season(s): the forecast knows the variability "
                f"inside them, not between years ({record.describe()})",
                DriftCoreWarning,
                stacklevel=2,
            )
        phase, cycle = _mean_cycle(record)
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
                bounded = likelihood[likelihood["h"] <= _WIDEST_RESIDUAL]
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

    @property
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
        """Days of the longest run of consecutive months in the record; infinite for all twelve.

        A simulation that lasts longer leaves the season it stands for.
        """
        months = self.record.months
        if len(months) == 12:
            return math.inf
        runs = (_run(months, month) for month in months)
        return float(max(sum(_MONTH_DAYS[month - 1] for month in run) for run in runs))

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
        values, indices = self.core.sample(
            _whole("members", members, 1),
            _whole("steps", steps, 1),
            _whole("seed", seed, 0, 2**64 - 1),
        )
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
        Knots, strictly increasing, at least 2 [the scenario's time unit].
    velocity : array_like, shape (k, 2)
        Velocity toward x and y at the knots [the scenario's velocity unit].

    Raises
    ------
    ScenarioError
        If shapes, order or values do not fit, or a method is asked beyond the knots.
    """

    times: Float
    velocity: Float

    def __init__(self, times: ArrayLike, velocity: ArrayLike) -> None:
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
        Velocity toward x and y at the knots [the scenario's velocity unit].

    Raises
    ------
    ScenarioError
        If shapes, spacing or values do not fit.
    """

    times: Float

    def __init__(self, times: ArrayLike, velocity: ArrayLike) -> None:
        self.times = _real_array("times", times)
        values = _real_array("velocity", velocity)
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

    def __getitem__(self, member: int) -> WindPath:
        if not 0 <= member < len(self):
            raise IndexError(member)
        return WindPath(self.times, self.core.velocity(member))

    def __repr__(self) -> str:
        first, last = self.times[0], self.times[-1]
        return f"WindPaths({len(self)} members, {len(self.times)} knots on [{first:g}, {last:g}])"


# Arguments


def _listed(names: Iterable[object]) -> str:
    return ", ".join(repr(name) for name in names)


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


def _real_array(field: str, values: ArrayLike) -> Float:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"{field}: {error}; give an array of numbers") from error
    if not np.isfinite(array).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ScenarioError(
            f"{field}: {array[place]} at {place} is not accepted; give finite values"
        )
    array.flags.writeable = False
    return array


# Calendar


def _calendar(times: Times) -> tuple[Integer, Integer]:
    """Month (1 to 12) and day of a year of 365 days (0 to 364; 29 February counts as the 28th)."""
    months = times.astype("datetime64[M]")
    month = months.astype(np.int64) % 12 + 1
    day = (times.astype("datetime64[D]") - months.astype("datetime64[D]")).astype(np.int64)
    length = np.array(_MONTH_DAYS)
    return month, (np.cumsum(length) - length)[month - 1] + np.minimum(day, length[month - 1] - 1)


def _run(months: Sequence[int], first: int) -> list[int]:
    """Consecutive calendar months from `first` on, as far as all belong to `months`."""
    run: list[int] = []
    while len(run) < 12 and (first + len(run) - 1) % 12 + 1 in months:
        run.append((first + len(run) - 1) % 12 + 1)
    return run


def _season_start(months: Sequence[int]) -> int:
    """First month of the season: the one that follows the longest pause, January without any."""
    pauses = sorted(set(range(1, 13)) - set(months))
    if not pauses:
        return 1
    longest = max((_run(pauses, month) for month in pauses), key=len)
    return longest[-1] % 12 + 1


def _checked_months(months: Iterable[int]) -> tuple[int, ...]:
    try:
        chosen = tuple(sorted({operator.index(month) for month in months}))
    except TypeError as error:
        raise RecordError(
            f"months: {months!r} is not accepted; use a sequence of whole numbers from 1 to 12"
        ) from error
    if not chosen or not 1 <= chosen[0] <= chosen[-1] <= 12:
        raise RecordError(f"months: {chosen} is not accepted; use whole numbers from 1 to 12")
    return chosen


def _chosen(times: Times, months: tuple[int, ...]) -> NDArray[np.bool_]:
    """Rows in the months chosen; `RecordError` if there is none."""
    month, _ = _calendar(times)
    rows = np.isin(month, months)
    if not rows.any():
        raise RecordError(
            f"months: {months} leaves no row of the record, which has months "
            f"{tuple(int(m) for m in np.unique(month))}"
        )
    return rows


def _stamp(time: np.datetime64) -> str:
    return f"{np.datetime_as_string(time, unit='m')}Z"


# Reading


def _as_table(source: Source) -> tuple[str | None, pd.DataFrame, Mapping[str, str]]:
    """Path (where there is one), table with time as a column or index, and units stated."""
    import pandas as pd  # costs half a second: only those who read a record pay it

    path = None
    if isinstance(source, str | PathLike):
        path = fspath(source)
        source = _read_file(path)
    if isinstance(source, pd.DataFrame):
        return path, source, {}
    if hasattr(source, "data_vars"):
        return path, *_flatten(source)
    raise RecordError(
        f"source: {type(source).__name__} is not accepted; use the path of a CSV or NetCDF file, "
        "a pandas DataFrame or an xarray Dataset"
    )


def _read_file(path: str) -> pd.DataFrame | xr.Dataset:
    if not Path(path).is_file():
        raise RecordError(f"source: there is no file {path!r}; give a CSV or NetCDF file")
    try:
        if Path(path).suffix in (".nc", ".nc4"):
            import xarray as xr

            with xr.open_dataset(path) as dataset:
                return dataset.load()
        import pandas as pd

        return pd.read_csv(path)
    except (OSError, ValueError) as error:  # their own kinds of error are ValueErrors
        reason = str(error).splitlines()[0]
        raise RecordError(f"source: {path!r} cannot be read: {reason}") from error


def _flatten(dataset: xr.Dataset) -> tuple[pd.DataFrame, Mapping[str, str]]:
    """Table and stated units of the components of a dataset that has no dimension but time."""
    dataset = dataset[list(_component_names(dataset.data_vars))].reset_coords(drop=True)
    others = {str(name): size for name, size in dataset.sizes.items() if name not in _TIME_NAMES}
    if max(others.values(), default=1) > 1:
        raise RecordError(
            f"dimensions: the dataset also has {others}; select one point, e.g. "
            "dataset.sel(latitude=47.4, longitude=-3.1, method='nearest')"
        )
    dataset = dataset.isel(dict.fromkeys(others, 0), drop=True)
    if not dataset.sizes:
        raise RecordError(f"time: the dataset has no dimension {' or '.join(_TIME_NAMES)}")
    units = {str(name): str(dataset[name].attrs.get("units", "")) for name in dataset.data_vars}
    table = dataset.to_dataframe()
    table.attrs = dict(dataset.attrs)
    return table, units


def _component_names(found: Iterable[Hashable]) -> tuple[str, str]:
    present = list(found)
    for names in _COMPONENT_NAMES:
        if all(name in present for name in names):
            return names
    raise RecordError(
        f"columns: found {_listed(present) or 'none'}; "
        "the wind must be in 'u10' and 'v10', or 'u' and 'v' [m/s]"
    )


def _utc_times(table: pd.DataFrame) -> Times:
    import pandas as pd

    name = next((name for name in _TIME_NAMES if name in table.columns), None)
    axis: Any = table.index if name is None else table[name]
    if pd.api.types.is_numeric_dtype(axis.dtype):
        place = f"column {name!r}" if name else f"index (there is no column {_listed(_TIME_NAMES)})"
        raise RecordError(
            f"time: the {place} holds numbers; accepted are dates like 1994-06-01T06:00:00Z"
        )
    # A zone is converted, its absence means UTC. Only ISO 8601: 01/06/1994 has two readings.
    parsed = pd.to_datetime(axis, utc=True, format="ISO8601", errors="coerce")
    times = pd.DatetimeIndex(parsed).tz_localize(None)
    missing = np.flatnonzero(times.isna())
    if missing.size:
        row = int(missing[0])
        raise RecordError(
            f"time: row {row} is {np.asarray(axis)[row]!r}, one of {missing.size} that are no "
            "date; accepted are dates of the standard calendar, like 1994-06-01T06:00:00Z"
        )
    # NetCDF files that count days in floating point are a rounding error off the full second.
    return times.round("s").to_numpy().astype("datetime64[s]")


def _numbers(table: pd.DataFrame, name: str) -> Float:
    try:
        return np.asarray(table[name], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordError(f"{name}: {error}; accepted are numbers in m/s") from error


def _require_finite(
    times: Times, velocity: Float, kept: NDArray[np.bool_], names: tuple[str, str]
) -> None:
    bad = ~np.isfinite(velocity) & kept[:, None]
    if not bad.any():
        return
    row, component = (int(i) for i in np.argwhere(bad)[0])
    raise RecordError(
        f"{names[component]}: row {row} ({_stamp(times[row])}) is {velocity[row, component]}, one "
        f"of {int(bad.any(axis=1).sum())} row(s) that are not finite; drop them and pass "
        "gaps='segment' to cut the record there"
    )


def _require_regular(
    times: Times,
    step: np.timedelta64,
    kept: NDArray[np.bool_],
    months: tuple[int, ...] | None,
    gaps: Gaps,
) -> None:
    """Check the axis where both ends of a jump, or the rows it skips, are in the months kept."""
    jumps = np.diff(times)
    for row in np.flatnonzero(jumps != step):
        jump, before = jumps[row], _stamp(times[row])
        if jump % step != np.timedelta64(0):
            if kept[row] or kept[row + 1]:
                raise RecordError(
                    f"time: irregular step of {jump / _HOUR:g} h after row {row} ({before}); the "
                    f"record's step is {step / _HOUR:g} h and gaps must be whole steps of it"
                )
        elif gaps == "error":
            skipped = np.arange(times[row] + step, times[row + 1], step)
            if months is None or np.isin(_calendar(skipped)[0], months).any():
                raise RecordError(
                    f"time: gap of {jump / _HOUR:g} h after row {row} ({before}) where the step is "
                    f"{step / _HOUR:g} h; name the months it is meant to cover, or pass "
                    "gaps='segment' to cut the record there"
                )


def _warn_of_units(velocity: Float, units: Mapping[str, str]) -> None:
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    speed = speed[np.isfinite(speed)]
    doubts = [
        f"{name} states units {unit!r}"
        for name, unit in units.items()
        if unit and unit.strip() not in _METRES_PER_SECOND
    ]
    if speed.max(initial=0.0) > _ANY_SPEED_LIMIT:
        doubts.append(f"a speed of {speed.max():g} looks like a missing value")
    elif speed.size:
        mean, rare = speed.mean(), np.quantile(speed, 0.999)
        if mean > _MEAN_SPEED_LIMIT or rare > _RARE_SPEED_LIMIT:
            doubts.append(
                f"mean speed {mean:.3g} and 99.9 % quantile {rare:.3g} look like knots "
                f"(limits {_MEAN_SPEED_LIMIT} and {_RARE_SPEED_LIMIT})"
            )
    if doubts:
        warnings.warn(
            f"wind record: {'; '.join(doubts)}; the values are taken as m/s",
            DriftCoreWarning,
            stacklevel=3,
        )


# Fitting

_LIKELIHOOD = np.dtype([("h", np.float64), ("b", np.float64), ("log_likelihood", np.float64)])


def _mean_cycle(record: WindRecord) -> tuple[Integer, Float]:
    """Phase of each row (n,) and mean cycle [m/s] (phases, 2) of a record.

    The cycle is the mean day; where the months span more than a season it also has one annual
    harmonic, and runs through the days of those months in the order of the season.
    """
    _, day = _calendar(record.times)
    per_day = round(24 / record.step_h)
    of_day = record.times - record.times.astype("datetime64[D]")
    slot = (of_day / (record.step_h * _HOUR)).astype(np.int64)  # also if the first is not at 00 UTC
    empty = np.flatnonzero(np.bincount(slot, minlength=per_day) == 0)
    if empty.size:
        hour = empty[0] * record.step_h
        raise RecordError(
            f"time: no row from {hour:g} to {hour + record.step_h:g} h UTC of any day; "
            "the mean day needs every step of it"
        )
    if len(record.months) <= _SEASON_MONTHS:
        cycle = np.stack([record.velocity[slot == k].mean(axis=0) for k in range(per_day)])
        return slot, cycle

    first = sum(_MONTH_DAYS[: _season_start(record.months) - 1])
    days = (np.arange(365) + first) % 365
    month_of_day = np.repeat(np.arange(1, 13), _MONTH_DAYS)
    days = days[np.isin(month_of_day[days], record.months)]
    place = np.zeros(365, dtype=np.int64)
    place[days] = np.arange(len(days))

    def design(day: Integer, slot: Integer) -> Float:
        angle = 2 * np.pi * (day + slot / per_day) / 365
        harmonic = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.concatenate([np.eye(per_day)[slot], harmonic], axis=1)

    fitted, *_ = np.linalg.lstsq(design(day, slot), record.velocity, rcond=None)
    table = design(np.repeat(days, per_day), np.tile(np.arange(per_day), len(days)))
    return place[day] * per_day + slot, table @ fitted


def _rows_with_successor(record: WindRecord, order: int) -> Integer:
    """Rows with `order - 1` rows before and one after them in their segment."""
    rows = np.arange(order - 1, len(record) - 1)
    same = record.segment[rows - (order - 1)] == record.segment[rows + 1]
    kept: Integer = rows[same]
    return kept


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
        distance2 = _squared_distances(whitened[rows], whitened)
        distance2 -= distance2.min(axis=1, keepdims=True)
        weight = np.exp(distance2 / np.float32(-2 * h**2))
        share += (1 / weight.sum(axis=1)) @ weight
    return np.asarray(share / share.sum(), np.float64)


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
