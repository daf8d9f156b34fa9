"""Wind records: regular series of 10 m wind, read and checked, cut to the months of a season."""

from __future__ import annotations

import hashlib
import math
import operator
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from driftcore.errors import RecordError, reading, warn
from driftcore.netcdf import open_netcdf
from driftcore.times import Times

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Float: TypeAlias = NDArray[np.float64]
Integer: TypeAlias = NDArray[np.int64]
Source: TypeAlias = "str | PathLike[str] | pd.DataFrame | xr.Dataset"
Gaps = Literal["error", "segment"]

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
# Fewer rows are no climate: a gale fills a forecast of days.
_LEAST_JUDGED = 400

_SEASON_MONTHS = 4


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

    @property
    def span_days(self) -> float:
        """Days of the longest run of consecutive months in the record; infinite for all twelve."""
        if len(self.months) == 12:
            return math.inf
        runs = (_run(self.months, month) for month in self.months)
        return float(max(sum(_MONTH_DAYS[month - 1] for month in run) for run in runs))

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
        raise RecordError(f"gaps: {gaps!r} is not accepted; use {listed(get_args(Gaps))}")
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


def mean_cycle(record: WindRecord) -> tuple[Integer, Float]:
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


def phase_of_day(record: WindRecord, day: np.datetime64) -> int:
    """Phase of the mean cycle at the midnight of a day, of whatever year."""
    phase, _ = mean_cycle(record)
    of_day = record.times - record.times.astype("datetime64[D]")
    # Of a record whose first hour of the day is not 0: the nearest one.
    rows = np.flatnonzero(of_day == of_day.min())
    days = np.abs(day_of_year(record.times[rows]) - day_of_year(np.array([day])))
    return int(phase[rows[np.argmin(np.minimum(days, 365 - days))]])


def rows_with_successor(record: WindRecord, order: int) -> Integer:
    """Rows with `order - 1` rows before and one after them in their segment."""
    rows = np.arange(order - 1, len(record) - 1)
    same = record.segment[rows - (order - 1)] == record.segment[rows + 1]
    kept: Integer = rows[same]
    return kept


def listed(names: Iterable[object]) -> str:
    """Word a list of names, each in quotes."""
    return ", ".join(repr(name) for name in names)


# Calendar


def day_of_year(times: Times) -> Integer:
    """Day of a year of 365 days, 0 to 364; 29 February counts as the 28th."""
    return _calendar(times)[1]


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
        source = read_file(path)
    if isinstance(source, pd.DataFrame):
        return path, source, {}
    if hasattr(source, "data_vars"):
        return path, *_flatten(source)
    raise RecordError(
        f"source: {type(source).__name__} is not accepted; use the path of a CSV or NetCDF file, "
        "a pandas DataFrame or an xarray Dataset"
    )


def read_file(path: str) -> pd.DataFrame | xr.Dataset:
    """Open a CSV or NetCDF file; `RecordError` if that fails."""
    with reading(f"source: {path!r}"):
        if not Path(path).is_file():
            raise RecordError(f"source: there is no file {path!r}; give a CSV or NetCDF file")
        if Path(path).suffix in (".nc", ".nc4"):
            with open_netcdf(Path(path)) as dataset:
                return dataset.load()
        import pandas as pd

        return pd.read_csv(path)


def _flatten(dataset: xr.Dataset) -> tuple[pd.DataFrame, Mapping[str, str]]:
    """Table and stated units of the components of a dataset that has no dimension but time."""
    dataset = dataset[list(_component_names(dataset.data_vars))].reset_coords(drop=True)
    others = {str(name): size for name, size in dataset.sizes.items() if name not in _TIME_NAMES}
    if set(others.values()) - {1}:
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
        f"columns: found {listed(present) or 'none'}; "
        "the wind must be in 'u10' and 'v10', or 'u' and 'v' [m/s]"
    )


def _utc_times(table: pd.DataFrame) -> Times:
    import pandas as pd

    name = next((name for name in _TIME_NAMES if name in table.columns), None)
    axis: Any = table.index if name is None else table[name]
    if pd.api.types.is_numeric_dtype(axis.dtype):
        place = f"column {name!r}" if name else f"index (there is no column {listed(_TIME_NAMES)})"
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
    except (TypeError, ValueError, OverflowError) as error:
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
    elif speed.size >= _LEAST_JUDGED:
        mean, rare = speed.mean(), np.quantile(speed, 0.999)
        if mean > _MEAN_SPEED_LIMIT or rare > _RARE_SPEED_LIMIT:
            doubts.append(
                f"mean speed {mean:.3g} and 99.9 % quantile {rare:.3g} look like knots "
                f"(limits {_MEAN_SPEED_LIMIT} and {_RARE_SPEED_LIMIT})"
            )
    if doubts:
        warn(f"wind record: {'; '.join(doubts)}; the values are taken as m/s")
