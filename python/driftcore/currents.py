"""Currents of ocean models, made ready to be drifted in: no gap on land, regular in time, no tide.

Next to the coast a velocity is interpolated between sea and land, where a model has none. There it
is continued from the sea by Laplace's equation, which adds no extremum. What strands is up to the
coast alone: a land cell of a current is some kilometres wide and never stops anything.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from driftcore.earth import RADIUS_M
from driftcore.errors import RecordError
from driftcore.grids import GridSource, Period, Region, VectorGrid, read_vector_grid
from driftcore.record import Float
from driftcore.times import Times

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_HOUR = np.timedelta64(1, "h")
_MINUTE = np.timedelta64(1, "m")

# How far from a regular axis a time may lie [steps] to be interpolated to it.
_NEARLY_REGULAR = 0.1
_LONGEST_STEP_H = 3.0
_LEAST_RECORD_D = 15.0

# Running means over 24, 24 and 25 hours, one after the other (Godin 1972, The Analysis of Tides):
# of M2 they leave 8e-6, of O1 2e-4, of a period of 10 days 0.95.
_GODIN = np.convolve(np.convolve(np.ones(24) / 24, np.ones(24) / 24), np.ones(25) / 25)


class Scales(NamedTuple):
    """Typical size and change of a current over its sea cells."""

    speed: float
    """Root mean square speed [m/s]."""
    mean_speed: float
    """Root mean square speed of the mean over time [m/s]."""
    largest: float
    """Largest speed [m/s]."""
    length_km: float
    """Speed over the velocity's gradient, both as root mean square [km]; infinite if uniform."""
    time_h: float
    """Deviation from the mean over its rate of change, both as root mean square [h]; infinite if
    the current is steady."""


@dataclass(frozen=True, eq=False)
class Current(VectorGrid):
    """A current without gaps: a `VectorGrid` of regular times, its land cells filled.

    Attributes
    ----------
    land : ndarray of bool, shape (ny, nx)
        Cells where the source has no velocity at any time: filled here, so that one can
        interpolate next to the coast. Nothing strands by it.
    """

    land: NDArray[np.bool_] = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.land.flags.writeable = False

    @classmethod
    def from_grid(cls, grid: VectorGrid) -> Self:
        """Fill a grid's gaps and make its times regular.

        Raises
        ------
        RecordError
            If it is no current, its times are too irregular to interpolate them, or scipy is
            missing.
        """
        if grid.kind != "current":
            raise RecordError(f"kind: {grid.kind!r} is not accepted; a current is needed")
        _require_scipy()
        land = grid.missing
        u, v = (
            filled(grid.u, grid.longitude, grid.latitude),
            filled(grid.v, grid.longitude, grid.latitude),
        )
        times, resample = _regular_times(grid.times)
        notes = grid.notes
        if land.any():
            notes += (f"{land.mean():.0%} of the cells are land and filled from the sea",)
        flickering = int((np.isnan(grid.u).any(axis=0) & ~land).sum())
        if flickering:
            notes += (f"{flickering} cells have no value at some times and were filled",)
        if resample is not None:
            notes += ("times were interpolated to regular steps",)
            u, v = _combined(resample, u), _combined(resample, v)
        return cls(
            times,
            grid.longitude,
            grid.latitude,
            u,
            v,
            grid.label,
            grid.kind,
            grid.source,
            notes,
            land=land,
        )

    def detided(self, every_d: int = 1) -> Self:
        """Remove the tide by Godin's filter and keep means over whole days.

        Running means of 24, 24 and 25 h; steps of more than 1 h are interpolated linearly first.
        The filter needs 36 h on each side, by which the record becomes shorter.

        Parameters
        ----------
        every_d : int
            Days between the times kept, and averaged over: 1 for daily, 7 for weekly values.

        Raises
        ------
        RecordError
            If the step is above 3 h (the tide is not resolved), or the record is shorter than 15
            days or than what `every_d` needs.
        """
        if isinstance(every_d, bool) or not isinstance(every_d, int) or every_d < 1:
            raise RecordError(f"every_d: {every_d!r} is not accepted; use a number of whole days")
        step, days = self.step_h, self._span_h / 24
        if step is None or step > _LONGEST_STEP_H or days < _LEAST_RECORD_D:
            every = "a single time" if step is None else f"every {step:g} h"
            raise RecordError(
                f"time: the tide cannot be removed of {days:g} days {every}; at least "
                f"{_LEAST_RECORD_D:g} days every {_LONGEST_STEP_H:g} h or less are needed. Give "
                "daily means of the model, which hold little tide, or a longer record"
            )
        times, weights = _godin(self.times, every_d)
        return dataclasses.replace(
            self,
            times=times,
            u=_combined(weights, self.u),
            v=_combined(weights, self.v),
            notes=(*self.notes, f"tide removed (Godin), means of {every_d} day(s)"),
        )

    def mean(self) -> Self:
        """Mean over time, as a current of one time in the middle of the record."""
        middle = self.times[0] + (self.times[-1] - self.times[0]) // 2
        return dataclasses.replace(
            self,
            times=np.array([middle]),
            u=self.u.mean(axis=0, keepdims=True),
            v=self.v.mean(axis=0, keepdims=True),
            notes=(*self.notes, f"mean of {len(self.times)} times"),
        )

    def scales(self) -> Scales:
        """Find typical speeds, length and time of the sea cells, weighted by their area."""
        area = np.cos(np.deg2rad(self.latitude))[:, None] * ~self.land
        velocity = np.stack([self.u, self.v])

        def square(values: Float) -> float:
            return float((values**2 * area).sum(axis=(-2, -1)).mean(axis=1).sum() / area.sum())

        dy = np.deg2rad(self.latitude[1] - self.latitude[0]) * RADIUS_M
        dx = np.deg2rad(self.longitude[1] - self.longitude[0]) * RADIUS_M
        along_y, along_x = map(np.asarray, np.gradient(velocity, dy, dx, axis=(2, 3)))
        along_x /= np.maximum(np.cos(np.deg2rad(self.latitude)), 1e-3)[:, None]
        gradient2 = square(np.asarray(along_x)) + square(np.asarray(along_y))
        mean = velocity.mean(axis=1, keepdims=True)
        rate2 = 0.0
        if len(self.times) > 1:
            step_h = self._span_h / (len(self.times) - 1)
            rate2 = square(np.diff(velocity, axis=1) / step_h)
        return Scales(
            math.sqrt(square(velocity)),
            math.sqrt(square(mean)),
            float(np.hypot(self.u, self.v)[:, ~self.land].max()),
            _root_of_ratio(square(velocity), gradient2) / 1000,
            _root_of_ratio(square(velocity - mean), rate2),
        )

    @property
    def _span_h(self) -> float:
        return float((self.times[-1] - self.times[0]) / _HOUR)


def from_netcdf(
    source: GridSource,
    *,
    names: tuple[str, str] | None = None,
    units: str | None = None,
    region: Region | None = None,
    period: Period | None = None,
    depth: float = 0.0,
    label: str | None = None,
) -> Current:
    """Read a current and make it ready for a drift: `read_vector_grid`, then `Current.from_grid`.

    Parameters and errors are theirs.
    """
    return Current.from_grid(
        read_vector_grid(
            source,
            "current",
            names=names,
            units=units,
            region=region,
            period=period,
            depth=depth,
            label=label,
        )
    )


def _require_scipy() -> None:
    try:
        import scipy  # noqa: F401
    except ImportError:
        raise RecordError(
            'scipy is needed to make a current ready: pip install "driftcore[geo]"'
        ) from None


def _root_of_ratio(above: float, below: float) -> float:
    return math.sqrt(above / below) if below else math.inf


def filled(values: Float, longitude: Float, latitude: Float) -> Float:
    """Continue values into their gaps by Laplace's equation, no flux across the edge of the grid.

    Parameters
    ----------
    values : ndarray, shape (nt, ny, nx)
        With NaN in the gaps.
    longitude, latitude : ndarray, shapes (nx,), (ny,)
        Regular axes [degrees].

    Raises
    ------
    RecordError
        If a time has no value at all, or scipy is missing.
    """
    gaps = np.isnan(values).reshape(len(values), -1)
    if not gaps.any():
        return values
    empty = np.flatnonzero(gaps.all(axis=1))
    if empty.size:
        raise RecordError(
            f"values: step {int(empty[0])} has none, one of {empty.size}; leave it out, by period= "
            "or a list of other files"
        )
    _require_scipy()
    from scipy.sparse.linalg import splu

    flat = values.reshape(len(values), -1).copy()
    laplacian = _laplacian(longitude, latitude)
    # Land is the same at all times of most models: one factorisation serves them all.
    masks, group = np.unique(np.packbits(gaps, axis=1), axis=0, return_inverse=True)
    for k in range(len(masks)):
        rows = np.flatnonzero(group == k)
        gap = np.flatnonzero(gaps[rows[0]])
        known = np.flatnonzero(~gaps[rows[0]])
        if not gap.size:
            continue
        of_gap = laplacian[gap]
        inflow = of_gap[:, known] @ flat[np.ix_(rows, known)].T
        flat[np.ix_(rows, gap)] = splu(of_gap[:, gap].tocsc()).solve(-inflow).T
    return flat.reshape(values.shape)


def _laplacian(longitude: Float, latitude: Float) -> csr_array:
    """Laplacian of a grid of nx * ny cells, row by row of the latitude, times their area."""
    from scipy.sparse import coo_array

    nx, ny = len(longitude), len(latitude)
    cell = np.arange(nx * ny).reshape(ny, nx)
    shrink = np.maximum(np.cos(np.deg2rad(latitude)), 1e-3)
    shape = (latitude[1] - latitude[0]) / (longitude[1] - longitude[0])
    # Conductance of the edge between neighbours: its length over their distance.
    eastward = np.broadcast_to((shape / shrink)[:, None], (ny, nx - 1))
    northward = np.broadcast_to(((shrink[1:] + shrink[:-1]) / 2 / shape)[:, None], (ny - 1, nx))
    a = np.concatenate([cell[:, :-1].ravel(), cell[:-1].ravel()])
    b = np.concatenate([cell[:, 1:].ravel(), cell[1:].ravel()])
    c = np.concatenate([eastward.ravel(), northward.ravel()])
    entries = np.concatenate([-c, -c, c, c])
    places = (np.concatenate([a, b, a, b]), np.concatenate([b, a, a, b]))
    return coo_array((entries, places), shape=(nx * ny, nx * ny)).tocsr()


def _combined(weights: csr_array, values: Float) -> Float:
    """Weigh values (nt, ny, nx) over time with weights (n, nt)."""
    sums = weights @ values.reshape(len(values), -1)
    return np.asarray(sums).reshape(weights.shape[0], *values.shape[1:])


def _regular_times(times: Times) -> tuple[Times, csr_array | None]:
    """Regular times, and the weights that interpolate to them if the given ones are not."""
    steps = np.diff(times)
    if len(np.unique(steps)) <= 1:
        return times, None
    step = np.median(steps.astype(np.int64)).astype("timedelta64[ns]")
    if step >= 10 * _MINUTE:
        step = np.round(step / _MINUTE).astype(np.int64) * _MINUTE
    place = (times - times[0]) / step
    count = int(np.floor(place[-1] + _NEARLY_REGULAR)) + 1
    if len(times) != count or np.abs(place - np.arange(count)).max() > _NEARLY_REGULAR:
        hours = np.array([steps.min(), steps.max()]) / _HOUR
        raise RecordError(
            f"time: the steps go from {hours[0]:g} to {hours[1]:g} h; regular ones are needed; "
            f"interpolate first, e.g. cdo inttime,{np.datetime_as_string(times[0], unit='D')},"
            f"{str(times[0])[11:19]},{round(step / _HOUR * 60)}minutes in.nc out.nc, or leave the "
            "part with the gap out by period="
        )
    regular = times[0] + np.arange(count) * step
    return regular, _interpolation(times, regular)


def _interpolation(times: Times, wanted: Times) -> csr_array:
    """Weights (n, nt) of the linear interpolation from `times` to `wanted`; constant beyond."""
    from scipy.sparse import csr_array

    at = (wanted - times[0]) / _HOUR
    known = (times - times[0]) / _HOUR
    before = np.clip(np.searchsorted(known, at, side="right") - 1, 0, len(known) - 2)
    share = np.clip((at - known[before]) / np.diff(known)[before], 0.0, 1.0)
    rows = np.arange(len(at))
    return csr_array(
        (
            np.concatenate([1 - share, share]),
            (np.concatenate([rows, rows]), np.concatenate([before, before + 1])),
        ),
        shape=(len(at), len(known)),
    )


def _godin(times: Times, every_d: int) -> tuple[Times, csr_array]:
    """Middles of the days kept, and the weights (n, nt) of Godin's filter and the means there."""
    from scipy.sparse import csr_array

    hourly = np.arange(times[0], times[-1] + np.timedelta64(1, "ns"), _HOUR)
    days = (len(hourly) - len(_GODIN) + 1) // 24
    count = days // every_d
    if count < 1:
        raise RecordError(
            f"every_d: {every_d} is not accepted; the record has {max(days, 0)} whole day(s) "
            "inside the reach of the filter"
        )
    # The filter at each hour of the first day, and the mean of it over the days: one kernel.
    kernel = np.convolve(_GODIN, np.ones(24 * every_d) / (24 * every_d))
    first = 24 * every_d * np.arange(count)
    places = first[:, None] + np.arange(len(kernel))
    filter_ = csr_array(
        (
            np.tile(kernel, count),
            (np.repeat(np.arange(count), len(kernel)), places.ravel()),
        ),
        shape=(count, len(hourly)),
    )
    middle = hourly[first] + np.timedelta64((len(kernel) - 1) * 1800, "s")
    return middle.astype("datetime64[ns]"), (filter_ @ _interpolation(times, hourly)).tocsr()
