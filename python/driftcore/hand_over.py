"""From today's wind forecast to the climate: docs/equations.md (43) and (44)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property, partial
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from driftcore import _core
from driftcore.errors import RecordError, ScenarioError
from driftcore.grids import VectorGrid
from driftcore.record import (
    Float,
    Source,
    WindRecord,
    mean_cycle,
    phase_of_day,
    read_file,
    read_record,
)
from driftcore.times import Times
from driftcore.wind import LocalGridBootstrap, _real, _whitener, _whole

if TYPE_CHECKING:
    ForecastSource = Source | VectorGrid | Sequence[Source | VectorGrid]
    Skill = float | Mapping[str, Any]

_HOUR = np.timedelta64(3600, "s")
_MEMBER_NAMES = ("member", "number", "realization", "ensemble_member")
_LONGEST_STEP_H = 6.0
_HALF_LIFE_H = 168.0


class HandOver:
    """Winds that follow today's forecast first, and the climate in the end.

    Up to the horizon the synoptic wind of each member is the forecast, drawn toward the climate's
    mean as its skill decays, plus errors of its own that grow to the climate's variance; from its
    last states the bootstrap goes on. The small scale, which forecasts do not resolve, is added at
    all leads as to any bootstrap (a bootstrap fitted with `share=0` has none). See
    docs/guide/hand_over.md.

    Parameters
    ----------
    forecast : path, pandas.DataFrame, xarray.Dataset, VectorGrid, or a sequence of them
        The 10 m wind at a point, as `read_record` accepts it: `u10`, `v10` [m/s], UTC where no
        zone is named. Several forecasts, the members of an ensemble, are given one by one or by a
        column or dimension `member`, `number`, `realization` or `ensemble_member`; member `k` of
        a drift gets forecast `k` modulo their number. A forecast has no bias: correct it before.
        Its steps may change; they are at most 6 h or the record's. It is interpolated linearly
        to the steps of the record.
    climatology : LocalGridBootstrap
        What goes on from it.
    skill : float, mapping or pandas.DataFrame, optional
        Correlation r of forecast and truth by lead, in [0, 1], never increasing: a number for all
        leads; `{"half_life_h": H}` for `r = 2^(-(τ/H)²)`; or a table with `lead_h` and `r`, linear
        between its rows, that reaches the horizon. Of an ensemble: that correlation of one of its
        members, divided by that of two of them, which is 1 if the ensemble is reliable. Default:
        half-life 168 h for one forecast; 1 for an ensemble.
    at : (longitude, latitude), optional
        Point to take from a `VectorGrid`, linear between its nodes [degrees].
    issued : time, optional
        When the lead is 0, UTC; default the forecast's first time.
    horizon_h : float, optional
        Lead up to which the forecast is followed [h]; default all of it.

    Attributes
    ----------
    climatology : LocalGridBootstrap
    label : str
        What the forecast is, in words for people.
    times : ndarray of datetime64[s], shape (t,)
        Times of the forecast, UTC.
    velocity : ndarray, shape (forecasts, t, 2)
        [m/s]
    issued, horizon : datetime64[s]
        Time of lead 0, and last time that is handed over, UTC.

    Raises
    ------
    RecordError
        If the forecast cannot be read, its members' times differ, or a step is too long.
    ScenarioError
        If another argument is not accepted, or the horizon is less than the bootstrap's order of
        steps after the forecast's first time.

    Notes
    -----
    The default is a round figure. The anomaly correlation of the height of 500 hPa falls below 0.6
    after about eight days in the forecasts of the best centres (Bauer, Thorpe & Brunet 2015), and
    the wind near the surface is predicted less far: with H = 7 days, r is 0.99 after 1 day, 0.88
    after 3, 0.70 after 5 and 0.24 after 10. Measure that of your own forecasts at your own place.
    """

    climatology: LocalGridBootstrap
    label: str
    times: Times
    velocity: Float
    issued: np.datetime64
    horizon: np.datetime64

    def __init__(
        self,
        forecast: ForecastSource,
        climatology: LocalGridBootstrap,
        skill: Skill | None = None,
        *,
        at: tuple[float, float] | None = None,
        issued: Any = None,
        horizon_h: float | None = None,
    ) -> None:
        if not isinstance(climatology, LocalGridBootstrap):
            raise ScenarioError(
                f"climatology: {type(climatology).__name__} is not accepted; a fitted "
                "LocalGridBootstrap"
            )
        self.climatology = climatology
        try:
            records = [read_record(part, gaps="segment") for part in _parts(forecast, at)]
        except RecordError as error:
            raise RecordError(f"forecast: {error}") from error
        self.times = _common_times(records, max(_LONGEST_STEP_H, climatology.record.step_h))
        self.label = records[0].label
        self.velocity = np.stack([record.velocity for record in records])
        self.velocity.flags.writeable = False
        self.issued = self.times[0] if issued is None else _instant("issued", issued)
        if self.issued > self.times[0]:
            raise ScenarioError(
                f"issued: {self.issued} is not accepted; the forecast begins before, at "
                f"{self.times[0]}"
            )
        self.horizon = self.times[-1]
        if horizon_h is not None:
            lead = _real("horizon_h", horizon_h, 0.0, math.inf, "hours above 0", open_low=True)
            self.horizon = self.issued + np.timedelta64(round(lead * 3600), "s")
            if self.horizon > self.times[-1]:
                raise ScenarioError(
                    f"horizon_h: {horizon_h:g} is not accepted; the forecast ends "
                    f"{self._leads(self.times[-1]):g} h after it was issued"
                )
        needed = climatology.order * climatology.record.step_h
        if (self.horizon - self.times[0]) / _HOUR < needed:
            raise ScenarioError(
                f"forecast: it is followed from {self.times[0]} to {self.horizon}; a bootstrap of "
                f"order {climatology.order} needs at least {needed:g} h to go on from"
            )
        if skill is None:
            skill = {"half_life_h": _HALF_LIFE_H} if len(records) == 1 else 1.0
        self._skill, self._skill_words = _skill(skill, float(self._leads(self.horizon)))

    def correlation(self, times: Any) -> Float:
        """Skill r at UTC times, that at lead 0 before the forecast was issued."""
        return self._skill(np.maximum(self._leads(times), 0.0))

    def require(self, start: np.datetime64) -> None:
        """Raise `ScenarioError` unless the forecast covers the release of a run."""
        if not self.times[0] <= start <= self.horizon:
            raise ScenarioError(
                f"forecast: it is followed from {self.times[0]} to {self.horizon}; the release at "
                f"{start} must lie between"
            )

    def core(self, origin: np.datetime64, lead_in: int) -> _core.HandOver:
        """Give what members begin with, so many steps of the record before a midnight.

        Before its first time the forecast is that of its first time.
        """
        climatology = self.climatology
        first = origin.astype("datetime64[s]") - lead_in * self._step
        steps = np.arange((self.horizon - first) // self._step + 1)
        knots = first + steps * self._step
        phase = phase_of_day(climatology.record, origin) - lead_in + steps
        place = np.interp(self._leads(knots), self._leads(self.times), np.arange(len(self.times)))
        before = np.minimum(place.astype(np.int64), len(self.times) - 2)
        share = (place - before)[:, None]
        forecast = (1 - share) * self.velocity[:, before] + share * self.velocity[:, before + 1]
        anomaly = forecast - climatology.cycle[phase % len(climatology.cycle)]
        r = self.correlation(knots)
        return _core.HandOver(r[:, None] * anomaly, np.sqrt(1 - r**2), *self._errors)

    def sample(self, members: int, steps: int, seed: int) -> tuple[Times, Float]:
        """Simulate the synoptic wind from the forecast's beginning on.

        Parameters
        ----------
        members, steps : int
            At least 1; a step is the record's.
        seed : int
            From 0 to 2⁶⁴ - 1.

        Returns
        -------
        times : ndarray of datetime64[s], shape (steps,)
            UTC, from the first step of the record that the forecast covers.
        values : ndarray, shape (members, steps, 2)
            Wind toward east and north [m/s].

        Raises
        ------
        ScenarioError
            If an argument is out of its range.
        """
        climatology = self.climatology
        midnight = self.times[0].astype("datetime64[D]")
        skipped = int(-((midnight - self.times[0]) // self._step))
        phase = phase_of_day(climatology.record, midnight)
        steps = _whole("steps", steps, 1)
        values, _ = climatology.core.sample(
            _whole("members", members, 1),
            steps,
            _whole("seed", seed, 0, 2**64 - 1),
            phase=climatology.phase_before(phase, -skipped),
            hand_over=self.core(midnight, -skipped),
        )
        return midnight + (skipped + np.arange(steps)) * self._step, values

    def describe(self) -> str:
        """Say in one line what is handed over."""
        return (
            f"{self.label}: {len(self.velocity)} forecast(s) issued {self.issued}Z, followed from "
            f"{self.times[0]}Z to {self.horizon}Z; skill {self._skill_words}"
        )

    def __repr__(self) -> str:
        return f"HandOver({self.describe()}; then {self.climatology!r})"

    @property
    def _step(self) -> np.timedelta64:
        return np.timedelta64(round(self.climatology.record.step_h * 3600), "s")

    def _leads(self, times: Any) -> Any:
        """Hours since the forecast was issued."""
        return (times - self.issued) / _HOUR

    @cached_property
    def _errors(self) -> tuple[list[list[float]], list[list[float]], list[list[float]]]:
        """Lag-one matrix of the errors, root of their innovations' covariance, and of their own."""
        record = self.climatology.record
        phase, cycle = mean_cycle(record)
        anomaly = record.velocity - cycle[phase]
        same = np.flatnonzero(record.segment[1:] == record.segment[:-1])
        joint = np.cov(np.concatenate([anomaly[same + 1], anomaly[same]], axis=1).T)
        later, earlier = (_whitener(joint[k : k + 2, k : k + 2], "record") for k in (0, 2))
        # Whitened each by itself, its singular values are canonical correlations: below 1.
        memory = later @ joint[:2, 2:] @ earlier.T
        innovation = np.linalg.cholesky(np.eye(2) - memory @ memory.T)
        scale = np.linalg.cholesky(np.cov(anomaly.T))
        memory = scale @ memory @ np.linalg.inv(scale)
        return memory.tolist(), (scale @ innovation).tolist(), scale.tolist()


# Skill


def _skill(skill: Skill, horizon_h: float) -> tuple[Callable[[Float], Float], str]:
    """Skill by lead [h], and words for it."""
    table: Any = skill if hasattr(skill, "keys") else {}
    names = set(table.keys())
    if names == {"half_life_h"}:
        half = table["half_life_h"]
        half = _real("skill.half_life_h", half, 0.0, math.inf, "hours above 0", open_low=True)
        return partial(_decaying, half), f"of half-life {half:g} h"
    if names >= {"lead_h", "r"}:
        lead_h, r = (_column(name, table[name]) for name in ("lead_h", "r"))
        if len(lead_h) != len(r) or not len(r) or (np.diff(lead_h) <= 0).any():
            raise ScenarioError("skill: lead_h must increase, with an r for each")
        if lead_h[-1] < horizon_h:
            raise ScenarioError(
                f"skill: its last lead, {lead_h[-1]:g} h, is not accepted; the horizon is "
                f"{horizon_h:g} h: go on, or give horizon_h"
            )
        words = f"{r[0]:g} to {r[-1]:g} at leads of {lead_h[0]:g} to {lead_h[-1]:g} h"
    else:
        try:
            r = np.array([float(skill)])  # type: ignore[arg-type]
        except (TypeError, ValueError):
            raise ScenarioError(
                f"skill: {skill!r} is not accepted; a number from 0 to 1, "
                "{'half_life_h': hours}, or a table with 'lead_h' and 'r'"
            ) from None
        lead_h, words = np.zeros(1), f"{r[0]:g}"
    outside = r[~((r >= 0) & (r <= 1))]
    if outside.size:
        raise ScenarioError(f"skill: {outside[0]:g} is not accepted; numbers from 0 to 1")
    growing = np.flatnonzero(np.diff(r) > 0)
    if growing.size:
        k = int(growing[0])
        raise ScenarioError(
            f"skill: {r[k + 1]:g} after {r[k]:g} is not accepted; it must not increase"
        )
    return partial(_tabulated, lead_h, r), words


def _decaying(half_life_h: float, lead_h: Float) -> Float:
    return np.exp2(-((lead_h / half_life_h) ** 2))


def _tabulated(table_h: Float, r: Float, lead_h: Float) -> Float:
    return np.asarray(np.interp(lead_h, table_h, r))


def _column(name: str, values: ArrayLike) -> Float:
    try:
        column = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        column = np.full(1, np.nan)
    if column.ndim != 1 or not np.isfinite(column).all():
        raise ScenarioError(f"skill.{name}: must be a list of numbers")
    return column


# Reading


def _parts(forecast: Any, at: tuple[float, float] | None) -> Iterator[Any]:
    """Forecasts one by one, each as `read_record` accepts it."""
    if isinstance(forecast, str | PathLike):
        path = fspath(forecast)
        forecast = read_file(path)
        forecast.attrs.setdefault("wind_label", Path(path).name)
    if isinstance(forecast, VectorGrid):
        yield _at_point(forecast, at)
    elif isinstance(forecast, list | tuple):
        if not forecast:
            raise RecordError("the list is empty")
        for part in forecast:
            yield from _parts(part, at)
    elif hasattr(forecast, "data_vars"):
        name = next((name for name in _MEMBER_NAMES if name in forecast.dims), None)
        members = 1 if name is None else forecast.sizes[name]
        yield from (forecast if name is None else forecast.isel({name: k}) for k in range(members))
    else:
        columns = getattr(forecast, "columns", ())
        name = next((name for name in _MEMBER_NAMES if name in columns), None)
        yield from [forecast] if name is None else (part for _, part in forecast.groupby(name))


def _at_point(grid: VectorGrid, at: tuple[float, float] | None) -> Any:
    """Wind at a point of a grid, linear between the nodes."""
    import pandas as pd

    if at is None or grid.kind != "wind":
        raise ScenarioError("forecast: of a VectorGrid of winds, give at=(longitude, latitude)")
    west = grid.longitude[0]
    longitude, latitude = (float(value) for value in at)
    longitude = (longitude - west + 1e-9) % 360 + west - 1e-9
    wind = np.stack([grid.u, grid.v], axis=-1)
    for name, place, axis in (
        ("latitude", latitude, grid.latitude),
        ("longitude", longitude, grid.longitude),
    ):
        if not axis[0] - 1e-9 <= place <= axis[-1] + 1e-9:
            raise ScenarioError(
                f"at: {name} {place:g} is not accepted; the grid covers {axis[0]:g} to {axis[-1]:g}"
            )
        node = float(np.interp(place, axis, np.arange(len(axis))))
        below = min(int(node), len(axis) - 2)
        wind = (1 - (node - below)) * wind[:, below] + (node - below) * wind[:, below + 1]
    table = pd.DataFrame({"u10": wind[:, 0], "v10": wind[:, 1]}, pd.DatetimeIndex(grid.times))
    table.attrs["wind_label"] = grid.label
    return table


def _common_times(records: list[WindRecord], longest_h: float) -> Times:
    """Give the times of all forecasts, which must be the same."""
    times = records[0].times
    for k, record in enumerate(records):
        if not np.array_equal(record.times, times):
            raise RecordError(
                f"forecast: number {k} is for {len(record)} times from {record.times[0]} to "
                f"{record.times[-1]}; the first is for {len(times)} from {times[0]} to {times[-1]}"
            )
    step = np.diff(times).max() / _HOUR
    if step > longest_h:
        raise RecordError(
            f"forecast: time: a step of {step:g} h is not accepted; at most {longest_h:g} h"
        )
    return times


def _instant(field: str, value: Any) -> np.datetime64:
    import pandas as pd

    try:
        time = pd.to_datetime(value, utc=True)
        return np.datetime64(time.tz_localize(None), "s")
    except (TypeError, ValueError, AttributeError):
        raise ScenarioError(f"{field}: {value!r} is not accepted; a time, UTC") from None
