"""Currents and winds on a longitude-latitude grid, read from files of models and reanalyses.

One reader serves both: a file of u and v is found out by its CF attributes first and by the names
that the common producers use otherwise (docs/guide/data.md). What cannot be read without a guess
is refused, with what to state or to run first.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from glob import glob
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from driftcore.errors import RecordError, reading
from driftcore.netcdf import coder_of_times, open_netcdf
from driftcore.record import Float, Integer, listed
from driftcore.times import Times, nanoseconds

if TYPE_CHECKING:
    import xarray as xr

Kind = Literal["current", "wind"]
Path_: TypeAlias = "str | PathLike[str]"
GridSource: TypeAlias = "Path_ | Sequence[Path_] | xr.Dataset"
Region: TypeAlias = "tuple[float, float, float, float]"
Period: TypeAlias = "tuple[str | np.datetime64, str | np.datetime64]"

GUIDE = "docs/guide/data.md"

# East and north component, those that say most first. Names are compared in lower case.
_STANDARD_NAMES: dict[Kind, tuple[tuple[str, str], ...]] = {
    "current": (
        ("surface_eastward_sea_water_velocity", "surface_northward_sea_water_velocity"),
        ("eastward_sea_water_velocity", "northward_sea_water_velocity"),
        ("surface_x_sea_water_velocity", "surface_y_sea_water_velocity"),
        ("sea_water_x_velocity", "sea_water_y_velocity"),
        ("x_sea_water_velocity", "y_sea_water_velocity"),
        (
            "surface_geostrophic_eastward_sea_water_velocity",
            "surface_geostrophic_northward_sea_water_velocity",
        ),
    ),
    "wind": (("eastward_wind", "northward_wind"), ("x_wind", "y_wind")),
}
_ALIASES: dict[Kind, tuple[tuple[str, str], ...]] = {
    "current": (
        ("uo", "vo"),
        ("water_u", "water_v"),
        ("ugos", "vgos"),
        ("ucur", "vcur"),
        ("u_current", "v_current"),
        ("surf_u", "surf_v"),
        ("ssu", "ssv"),
        ("eastward_eulerian_current_velocity", "northward_eulerian_current_velocity"),
        ("u", "v"),
    ),
    "wind": (
        ("u10", "v10"),
        ("10u", "10v"),
        ("u10m", "v10m"),
        ("u_10m", "v_10m"),
        ("air_u", "air_v"),
        ("uas", "vas"),
        ("uwnd", "vwnd"),
        ("ugrd_10maboveground", "vgrd_10maboveground"),
        ("x_wind_10m", "y_wind_10m"),
        ("u", "v"),
    ),
}
_AXES = {
    "longitude": (("longitude", "lon", "nav_lon"), ("degrees_east", "degree_east")),
    "latitude": (("latitude", "lat", "nav_lat"), ("degrees_north", "degree_north")),
}
_TIME_NAMES = ("time", "valid_time", "time_counter", "ocean_time")
_LEVEL_NAMES = ("depth", "height", "lev", "level", "deptht", "depthu", "depthv", "z", "altitude")
_METRES = {"m", "metre", "metres", "meter", "meters"}

_METRES_PER_SECOND = {
    **dict.fromkeys(
        ("m/s", "m s-1", "m s**-1", "m s^-1", "m.s-1", "ms-1", "meter second-1", "m/sec"), 1.0
    ),
    **dict.fromkeys(
        ("meters/second", "meters per second", "metre second-1", "m sec-1", "meter/sec"), 1.0
    ),
    **dict.fromkeys(("cm/s", "cm s-1", "cm s**-1", "cm s^-1", "cm.s-1", "cm/sec"), 0.01),
    **dict.fromkeys(("km/h", "km h-1"), 1 / 3.6),
    **dict.fromkeys(("kt", "kts", "knot", "knots"), 1852 / 3600),
}
_UNITS_ACCEPTED = "'m/s', 'cm/s', 'km/h' or 'knots'"

# No sea surface current and no 10 m wind [m/s] is faster: what is, stands for a missing value.
_SPEED_LIMIT = {"current": 20.0, "wind": 110.0}
# Where the velocity is wanted [m], and how far from it a level may lie and still stand for it.
_HEIGHT_OF_WIND = 10.0
_LEVEL_TOLERANCE = 15.0
# Files round their axes, to 0.001 degrees for instance.
_AXIS_TOLERANCE = 0.02

_CALENDARS = ("standard", "gregorian", "proleptic_gregorian")
_SINCE = re.compile(
    r"\w+ since \d{1,4}-\d{1,2}-\d{1,2}([T ]+[\d:.]+)?"
    r"\s*(?P<zone>Z|UTC|GMT|[+-]\d{1,2}(:?\d{2})?)?",
    re.IGNORECASE,
)


@dataclass(frozen=True, eq=False)
class VectorGrid:
    """A velocity on a regular longitude-latitude grid.

    Attributes
    ----------
    times : ndarray of datetime64[ns], shape (nt,)
        UTC, strictly increasing.
    longitude, latitude : ndarray, shapes (nx,), (ny,)
        Equally spaced and strictly increasing [degrees]. The longitude is continuous: it begins
        in [-180, 180), and goes beyond 180 across the date line.
    u, v : ndarray, shape (nt, ny, nx)
        Velocity toward east and north [m/s]; both are NaN on land or where one is missing.
    label : str
        What the velocity is, in words for people.
    kind : {"current", "wind"}
    source : str or None
        Path or paths it was read from.
    notes : tuple of str
        What reading it decided or converted.
    """

    times: Times
    longitude: Float
    latitude: Float
    u: Float
    v: Float
    label: str
    kind: Kind
    source: str | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for array in (self.times, self.longitude, self.latitude, self.u, self.v):
            array.flags.writeable = False

    @cached_property
    def step_h(self) -> float | None:
        """Step [h] if the times are regular, else None."""
        steps = np.unique(np.diff(self.times))
        return float(steps[0] / np.timedelta64(1, "h")) if len(steps) == 1 else None

    @cached_property
    def missing(self) -> NDArray[np.bool_]:
        """Cells without a value at any time, shape (ny, nx): land, or outside the model."""
        return np.asarray(np.isnan(self.u).all(axis=0))

    @cached_property
    def sha256(self) -> str:
        """Digest of times [ns since 1970], axes and velocities, as little-endian bytes."""
        digest = hashlib.sha256(self.times.astype("<i8").tobytes())
        for values in (self.longitude, self.latitude, self.u, self.v):
            # One NaN for all: files differ in the bits of theirs.
            digest.update(np.where(np.isnan(values), np.nan, values).astype("<f8").tobytes())
        return digest.hexdigest()

    def describe(self) -> str:
        """Say in one line what the grid is, and what was decided in reading it."""
        first, last = (np.datetime_as_string(time, unit="m") for time in self.times[[0, -1]])
        step = f"every {self.step_h:g} h" if self.step_h else "at irregular steps"
        times = f"{first}Z" if len(self.times) == 1 else f"{step} from {first}Z to {last}Z"
        axes = ", ".join(
            f"{name} {axis[0]:g} to {axis[-1]:g} by {axis[1] - axis[0]:.4g}"
            for name, axis in (("longitude", self.longitude), ("latitude", self.latitude))
        )
        said = "".join(f"; {note}" for note in self.notes)
        return f"{self.label}: {self.kind}, {len(self.times)} time(s) {times}, {axes}{said}"


def read_vector_grid(
    source: GridSource,
    kind: Kind,
    *,
    names: tuple[str, str] | None = None,
    units: str | None = None,
    region: Region | None = None,
    period: Period | None = None,
    depth: float = 0.0,
    label: str | None = None,
) -> VectorGrid:
    """Read a current or a wind on a regular longitude-latitude grid.

    Parameters
    ----------
    source : path, glob pattern, sequence of paths, or xarray.Dataset
        NetCDF files, which are joined in time, or data in memory.
    kind : {"current", "wind"}
    names : (str, str), optional
        Variables toward east and north; found by standard name, then by common names, if left out.
    units : {"m/s", "cm/s", "km/h", "knots"}, optional
        Units of the values: needed where the file states none, and above what it states.
    region : (west, south, east, north), optional
        Part to keep [degrees], with the cells around it; west > east crosses the date line.
    period : (first, last), optional
        Times to keep, both ends included [UTC].
    depth : float
        Depth of a current [m] where the file has several levels; the nearest is taken. Of a wind
        it is the level nearest to 10 m.
    label : str, optional
        Words for the data; default: its attribute `title` or its file name.

    Returns
    -------
    VectorGrid

    Raises
    ------
    RecordError
        If the files, names, units, axes, times, levels or values do not serve.
    """
    if kind not in get_args(Kind):
        raise RecordError(f"kind: {kind!r} is not accepted; use {listed(get_args(Kind))}")
    if units is not None:
        _factor("units", units)
    box = None if region is None else _checked_region(region)
    window = None if period is None else _checked_period(period)
    opened, paths = _sources(source)
    parts: list[VectorGrid] = []
    for item in opened:
        name = str(item) if isinstance(item, Path) else "dataset"
        with reading(f"source: {name!r}"), _open(item) as dataset:
            reader = _Reader(dataset, kind, name)
            part = reader.read(names, units, box, window, depth)
        if part is not None:
            parts.append(part)
    if not parts:
        raise RecordError(f"period: {period!r} leaves no time of the data")
    merged = parts[0] if len(parts) == 1 else _joined(parts)
    return VectorGrid(
        merged.times,
        merged.longitude,
        merged.latitude,
        merged.u,
        merged.v,
        label or merged.label,
        kind,
        ", ".join(paths) or None,
        merged.notes,
    )


def read_wind_grid(
    source: GridSource,
    *,
    names: tuple[str, str] | None = None,
    units: str | None = None,
    region: Region | None = None,
    period: Period | None = None,
    label: str | None = None,
) -> VectorGrid:
    """Read a 10 m wind on a regular longitude-latitude grid: `read_vector_grid` of kind "wind".

    Raises
    ------
    RecordError
        If the data do not serve, or have values missing: a wind blows everywhere.
    """
    grid = read_vector_grid(
        source, "wind", names=names, units=units, region=region, period=period, label=label
    )
    gaps = np.argwhere(np.isnan(grid.u))
    if len(gaps):
        k, j, i = gaps[0]
        raise RecordError(
            f"values: {len(gaps)} of {grid.u.size} are missing, the first at {grid.times[k]}, "
            f"{grid.longitude[i]:g} E {grid.latitude[j]:g} N; give a region and a period without "
            "gaps, or fill them first, e.g. cdo fillmiss2 in.nc out.nc"
        )
    return grid


# Sources


def _sources(source: GridSource) -> tuple[list[Path | xr.Dataset], list[str]]:
    """Find what to open, in order, and the paths as they are shown."""
    if hasattr(source, "data_vars"):
        return [source], []  # type: ignore[list-item]
    if isinstance(source, str | PathLike):
        pattern = fspath(source)  # may be absolute, which Path.glob does not take
        with reading(f"source: {pattern!r}"):
            found = [pattern] if Path(pattern).exists() else sorted(glob(pattern))  # noqa: PTH207
        if not found:
            raise RecordError(f"source: there is no file {pattern!r}; give NetCDF files")
    elif isinstance(source, Iterable):
        found = [fspath(str(path)) for path in source]
        if not found:
            raise RecordError("source: the list of files is empty; give at least one")
    else:
        raise RecordError(
            f"source: {type(source).__name__} is not accepted; use a path, a glob pattern, a list "
            "of paths or an xarray Dataset"
        )
    return [Path(path) for path in found], found


def _open(item: Path | xr.Dataset) -> AbstractContextManager[xr.Dataset]:
    """Open lazily: packed values are decoded, times are not, as their units are judged first."""
    import xarray as xr

    if isinstance(item, Path):
        return open_netcdf(item, decode_times=False)
    return nullcontext(xr.decode_cf(item, decode_times=False))


def _joined(parts: list[VectorGrid]) -> VectorGrid:
    """Parts of one grid in the order of their times."""
    first = parts[0]
    for part in parts[1:]:
        for name in ("longitude", "latitude"):
            mine, other = getattr(first, name), getattr(part, name)
            if mine.shape != other.shape or np.abs(mine - other).max() > 1e-3 * (mine[1] - mine[0]):
                raise RecordError(
                    f"{name}: {part.label!r} has {len(other)} values from {other[0]:g} to "
                    f"{other[-1]:g}, {first.label!r} {len(mine)} from {mine[0]:g} to "
                    f"{mine[-1]:g}; files that are joined need one grid"
                )
    times = np.concatenate([part.times for part in parts])
    order = np.argsort(times, kind="stable")
    _require_once(times[order])
    u, v = (np.concatenate([getattr(part, c) for part in parts])[order] for c in "uv")
    notes = tuple(dict.fromkeys(note for part in parts for note in part.notes))
    if (np.diff(order) < 0).any():
        notes += ("the files were put in the order of their times",)
    label = f"{first.label} and {len(parts) - 1} more"
    return VectorGrid(
        times[order], first.longitude, first.latitude, u, v, label, first.kind, None, notes
    )


# One dataset


class _Reader:
    """Finds out what a dataset holds and takes the part that is asked for."""

    def __init__(self, dataset: xr.Dataset, kind: Kind, name: str) -> None:
        self.dataset = dataset
        self.kind: Kind = kind
        self.name = Path(name).name
        self.notes: list[str] = []

    def read(
        self,
        names: tuple[str, str] | None,
        units: str | None,
        box: Region | None,
        window: tuple[np.datetime64, np.datetime64] | None,
        depth: float,
    ) -> VectorGrid | None:
        """Read what `box` and `window` keep; None if that is no time."""
        names = self._names(names)
        u, v = (self.dataset[name] for name in names)
        self._require_one_grid(u, v)
        factors = [self._stated_factor(component, units) for component in (u, v)]
        x, y = self._axis(u, "longitude"), self._axis(u, "latitude")
        self._require_east_north(u)
        columns, longitude = _longitudes(np.asarray(x, np.float64), box)
        rows, latitude = _latitudes(np.asarray(y, np.float64), box)
        time_dim, times = self._times(u)
        order = np.argsort(times, kind="stable")
        _require_once(times[order])
        if (np.diff(order) < 0).any():
            self.notes.append("times were put in order")
        if window is not None:
            order = order[(times[order] >= window[0]) & (times[order] <= window[1])]
        if not len(order):
            return None
        chosen: dict[str, slice | Integer] = {
            str(x.dims[0]): _compact(columns),
            str(y.dims[0]): _compact(rows),
        }
        levels = self._level(u, {*chosen, time_dim}, depth)
        dims = [str(y.dims[0]), str(x.dims[0])]
        if time_dim is not None:
            chosen[time_dim] = _compact(order)
            dims.insert(0, time_dim)
        values = []
        for component, factor in zip((u, v), factors, strict=True):
            part = component.isel(levels).isel(chosen).transpose(*dims)
            array = np.array(part.values, np.float64) * factor
            values.append(array.reshape(len(order), len(latitude), len(longitude)))
        missing = np.isnan(values[0]) | np.isnan(values[1])
        for array in values:
            array[missing] = np.nan
        self._require_plausible(values, names, factors)
        title = str(self.dataset.attrs.get("title", "")).strip()
        label = title if title and title != "unknown" else self.name
        return VectorGrid(
            times[order],
            longitude,
            latitude,
            values[0],
            values[1],
            label,
            self.kind,
            None,
            tuple(dict.fromkeys(self.notes)),
        )

    # Components

    def _names(self, names: tuple[str, str] | None) -> tuple[str, str]:
        found = [str(name) for name in self.dataset.data_vars]
        if names is not None:
            absent = [name for name in names if name not in self.dataset.variables]
            if absent or len(names) != 2:
                raise RecordError(
                    f"names: {tuple(names)!r} is not accepted; give the components toward east "
                    f"and north, two of {listed(found)}"
                )
            return names[0], names[1]
        lower = {name.lower(): name for name in found}
        common = [(lower[u], lower[v]) for u, v in _ALIASES[self.kind] if u in lower and v in lower]
        for pair in _STANDARD_NAMES[self.kind]:
            east, north = (
                [name for name in found if self._attribute(name, "standard_name") == standard]
                for standard in pair
            )
            if len(east) == len(north) == 1:
                return east[0], north[0]
            if east and north:
                for pair_of_names in common:
                    if pair_of_names[0] in east and pair_of_names[1] in north:
                        return pair_of_names
                raise RecordError(
                    f"names: {listed([*east, *north])} all have the standard names {listed(pair)}; "
                    "say which, names=(east, north)"
                )
        other = {"current": "wind", "wind": "water"}[self.kind]
        for u, v in common:
            if not any(other in self._attribute(name, "standard_name") for name in (u, v)):
                return u, v
        raise RecordError(
            f"names: no {self.kind} is found among {listed(found) or 'no variables'} of "
            f"{self.name}; say which are the components toward east and north, "
            "names=(east, north)"
        )

    def _attribute(self, name: str, key: str) -> str:
        return str(self.dataset[name].attrs.get(key, "")).strip().lower()

    def _stated_factor(self, component: xr.DataArray, units: str | None) -> float:
        """Find what turns the values into m/s."""
        stated = _units_of(component)
        if units is not None:
            factor = _factor("units", units)
            if stated and _METRES_PER_SECOND.get(_plain(stated)) != factor:
                self.notes.append(f"taken as {units}, though {component.name} states {stated!r}")
            return factor
        if not stated:
            raise RecordError(
                f"units: {component.name!r} of {self.name} states none; say what they are, "
                f"units='m/s' (or {_UNITS_ACCEPTED})"
            )
        factor = _factor(f"units of {component.name!r}", stated)
        if factor != 1:
            self.notes.append(f"converted from {stated} to m/s")
        return factor

    def _require_plausible(
        self, values: list[Float], names: tuple[str, str], factors: list[float]
    ) -> None:
        if np.isnan(values[0]).all():
            raise RecordError(
                f"values: {names[0]!r} and {names[1]!r} have no value in the region and period"
            )
        limit = _SPEED_LIMIT[self.kind]
        for name, array, factor in zip(names, values, factors, strict=True):
            fastest = float(array.flat[np.nanargmax(np.abs(array))])
            if abs(fastest) > limit:
                raise RecordError(
                    f"values: {name!r} reaches {fastest / factor:g}, {fastest:g} m/s, faster than "
                    f"any {self.kind} ({limit:g} m/s); if that stands for a missing value, set "
                    f"its attribute _FillValue, e.g. ncatted -a _FillValue,{name},o,f,"
                    f"{fastest / factor:g} in.nc; if the units are others, say which, "
                    "units='cm/s'"
                )

    # Grid

    def _require_one_grid(self, u: xr.DataArray, v: xr.DataArray) -> None:
        dims = [str(dim) for dim in u.dims]
        terrain = [
            dim
            for dim in dims
            if dim in self.dataset.coords
            and re.search("_s_coord|sigma", self._attribute(dim, "standard_name"))
        ]
        if u.dims != v.dims:
            levels = " and terrain-following levels (" + ", ".join(terrain) + ")" if terrain else ""
            angle = " by the angle of the grid ('angle')" if "angle" in self.dataset else ""
            raise RecordError(
                f"grid: {u.name!r} has dimensions {tuple(dims)} and {v.name!r} "
                f"{tuple(map(str, v.dims))}: a staggered (C) grid{levels}, as ROMS and NEMO write "
                f"it; missing are both components at the same points, toward east and north, on "
                f"1-D longitude and latitude. First, in this order: take the uppermost level, "
                f"average to the cell centres, turn{angle} (lines for it: {GUIDE}, 'ROMS'), "
                f"then regrid: cdo remapbil,grid.txt turned.nc out.nc"
            )
        if terrain:
            raise RecordError(
                f"levels: {terrain[0]!r} follows the terrain; select the uppermost level first, "
                f"e.g. dataset.isel({terrain[0]}=-1), and give the dataset"
            )

    def _axis(self, component: xr.DataArray, which: str) -> xr.DataArray:
        """1-D longitude or latitude of a component."""
        names, units = _AXES[which]
        candidates = [
            self.dataset[name]
            for name in self.dataset.variables
            if set(self.dataset[name].dims) <= set(component.dims)
            and self.dataset[name].ndim
            and (
                self._attribute(str(name), "standard_name") == which
                or _units_of(self.dataset[name]).lower() in units
                or str(name).lower() in names
            )
        ]
        axes = [axis for axis in candidates if axis.ndim == 1]
        if axes:
            return axes[0]
        mapped = self._map(component)
        if candidates:
            found = candidates[0]
            shape = f"{found.name!r} has dimensions {tuple(map(str, found.dims))}"
        else:
            shape = f"{component.name!r} has dimensions {tuple(map(str, component.dims))}"
        along = f", a {mapped} map" if mapped else ""
        turn = (
            f"turn the components, which point along the axes of that grid, toward east and north "
            f"(lines for it: {GUIDE}, 'Curvilinear grids'), then "
            if mapped or self._attribute(str(component.name), "standard_name") in _ALONG_AXES
            else "make sure that the components point east and north, then "
        )
        raise RecordError(
            f"{which}: {shape}{along}; missing is a 1-D, regular {which}. First {turn}regrid: "
            "cdo remapbil,grid.txt turned.nc out.nc, or xesmf.Regridder(turned, target, "
            "'bilinear')"
        )

    def _map(self, component: xr.DataArray) -> str:
        """Name of the map projection of a component; none for longitude and latitude."""
        mapping = str(
            component.attrs.get("grid_mapping", component.encoding.get("grid_mapping", ""))
        ).strip()
        if mapping not in self.dataset.variables:
            return ""
        name = self._attribute(mapping, "grid_mapping_name")
        return "" if name == "latitude_longitude" else name

    def _require_east_north(self, component: xr.DataArray) -> None:
        mapped = self._map(component)
        if mapped:
            raise RecordError(
                f"grid: {component.name!r} is on a {mapped} map; turn the components toward east "
                f"and north and regrid first ({GUIDE}, 'Curvilinear grids')"
            )

    def _level(
        self, component: xr.DataArray, known: set[str | None], depth: float
    ) -> dict[str, int]:
        """Place along each dimension that is neither horizontal nor time."""
        chosen: dict[str, int] = {}
        for dim in (str(dim) for dim in component.dims if str(dim) not in known):
            axis = self.dataset[dim] if dim in self.dataset.coords else None
            vertical = axis is not None and (
                dim.lower() in _LEVEL_NAMES
                or str(axis.attrs.get("axis", "")).upper() == "Z"
                or "positive" in axis.attrs
            )
            if not vertical or axis is None:
                if component.sizes[dim] > 1:
                    raise RecordError(
                        f"dimensions: {component.name!r} has {component.sizes[dim]} of {dim!r}; "
                        f"select one first, e.g. dataset.isel({dim}=0), and give the dataset"
                    )
                chosen[dim] = 0
                continue
            units = _units_of(axis).lower()
            if component.sizes[dim] > 1 and units and units not in _METRES:
                raise RecordError(
                    f"levels: {dim!r} is in {units!r}; select one level first, e.g. "
                    f"dataset.isel({dim}=0), and give the dataset"
                )
            wanted = abs(depth) if self.kind == "current" else _HEIGHT_OF_WIND
            # Depths are given both as positive and as negative numbers.
            levels = np.abs(np.asarray(axis.values, np.float64))
            chosen[dim] = int(np.abs(levels - wanted).argmin())
            nearest = float(levels[chosen[dim]])
            if units in _METRES and abs(nearest - wanted) > _LEVEL_TOLERANCE:
                raise RecordError(
                    f"levels: {wanted:g} m is wanted and the nearest of {dim!r} is {nearest:g} m; "
                    "give data nearer to it" + (", or depth=" if self.kind == "current" else "")
                )
            self.notes.append(
                f"level {dim} = {float(axis.values[chosen[dim]]):g} {units or 'm'} "
                f"of {component.sizes[dim]}"
            )
        return chosen

    # Time

    def _times(self, component: xr.DataArray) -> tuple[str | None, Times]:
        """Dimension and UTC times; a time that is a scalar has no dimension."""
        candidates = [
            str(name)
            for name in self.dataset.variables
            if self.dataset[name].ndim <= 1
            and set(self.dataset[name].dims) <= set(component.dims)
            and (
                str(name).lower() in _TIME_NAMES
                or self._attribute(str(name), "standard_name") == "time"
                or str(self.dataset[name].attrs.get("axis", "")).upper() == "T"
            )
        ]
        # A dimension goes before a scalar, such as the start of a forecast beside its valid times.
        candidates.sort(key=lambda name: -self.dataset[name].ndim)
        if not candidates:
            raise RecordError(
                f"time: {component.name!r} of {self.name} has dimensions "
                f"{tuple(map(str, component.dims))} and no time; give it one, e.g. "
                "dataset.expand_dims(time=[np.datetime64('2024-06-01T00:00')])"
            )
        variable = self.dataset[candidates[0]]
        dim = str(variable.dims[0]) if variable.ndim else None
        values = np.atleast_1d(variable.values)
        if not values.size:
            raise RecordError(f"time: {candidates[0]!r} of {self.name} is empty; it needs a time")
        times = values if values.dtype.kind == "M" else self._decoded(variable, values)
        if np.isnat(times).any():
            raise RecordError(
                f"time: {int(np.isnat(times).sum())} of {len(times)} are missing; drop them, e.g. "
                f"dataset.dropna({dim!r})"
            )
        # Days counted in floating point are a rounding error off the full second.
        half = np.timedelta64(500, "ms")
        seconds = (nanoseconds("time", times, RecordError) + half).astype("datetime64[s]")
        return dim, seconds.astype("datetime64[ns]")

    def _decoded(self, variable: xr.DataArray, values: NDArray[np.generic]) -> Times:
        import pandas as pd
        import xarray as xr

        if values.dtype == object and hasattr(values[0], "isoformat"):
            calendar = getattr(values[0], "calendar", "standard")
            self._require_calendar(calendar)
            stamps = [str(value) for value in values]
            if getattr(values[0], "tzinfo", None) is not None:
                self.notes.append(f"times converted from {values[0].tzinfo} to UTC")
            parsed = pd.to_datetime(stamps, utc=True).tz_localize(None)
            return np.asarray(parsed.to_numpy(), "datetime64[us]")
        units = _units_of(variable)
        if "since" not in units.lower():
            raise RecordError(
                f"time: {variable.name!r} of {self.name} states "
                f"{f'units {units!r}' if units else 'no units'}; they must be like 'hours since "
                f"1970-01-01', e.g. ncatted -a units,{variable.name},o,c,'hours since 1970-01-01' "
                "in.nc"
            )
        self._require_calendar(str(variable.attrs.get("calendar", "standard")))
        since = _SINCE.fullmatch(" ".join(units.split()))
        of_file = str(
            variable.attrs.get("time_zone", variable.attrs.get("timezone", "UTC"))
        ).strip()
        if since is None or of_file.upper() not in ("UTC", "GMT", "Z", "+00:00", "+0000", "0"):
            stated = repr(units) if since is None else f"the zone {of_file!r}"
            raise RecordError(
                f"time: {variable.name!r} of {self.name} states {stated}; accepted are UTC and an "
                "offset in figures like 'hours since 1970-01-01 00:00:00 +01:00'; shift to UTC "
                "first, e.g. cdo shifttime,-1hour in.nc out.nc"
            )
        offset = since["zone"] or ""
        if offset.strip("+-0:") and offset.upper() not in ("Z", "UTC", "GMT"):
            self.notes.append(f"times converted from UTC{offset} to UTC")
        plain = xr.Variable(("t",), values, {"units": re.sub(r"(?i)\s*(UTC|GMT)\s*$", "", units)})
        try:
            decoded = xr.decode_cf(xr.Dataset({"t": plain}), decode_times=coder_of_times())
        except (ValueError, OverflowError) as error:
            reason = str(error).splitlines()[0]
            raise RecordError(
                f"time: units {units!r} of {variable.name!r} cannot be decoded: {reason}"
            ) from error
        return np.asarray(decoded["t"].values, "datetime64[us]")

    def _require_calendar(self, calendar: str) -> None:
        if calendar.strip().lower() not in _CALENDARS:
            raise RecordError(
                f"time: calendar {calendar!r} of {self.name} has days that no real one has, or "
                f"lacks some; accepted are {listed(_CALENDARS)}; convert first, e.g. "
                "dataset.convert_calendar('standard')"
            )


_ALONG_AXES = {
    name
    for pairs in _STANDARD_NAMES.values()
    for pair in pairs
    for name in pair
    if re.search("(^|_)[xy]_", name)
}


# Arguments


def _plain(units: str) -> str:
    return " ".join(units.strip().lower().split())


def _factor(field: str, units: str) -> float:
    try:
        return _METRES_PER_SECOND[_plain(units)]
    except (KeyError, AttributeError):
        raise RecordError(
            f"{field}: {units!r} is not accepted; use {_UNITS_ACCEPTED}"
            + ("" if field == "units" else ", as units= if the file is wrong")
        ) from None


def _units_of(variable: xr.DataArray) -> str:
    """Units as stated: the attribute, also misspelt, or in brackets as GrADS writes them."""
    for key in ("units", "unit", "Units", "Unit"):
        if str(variable.attrs.get(key, "")).strip():
            return str(variable.attrs[key]).strip()
    bracketed = re.search(r"[(\[]([^()\[\]]+)[)\]]\s*$", str(variable.attrs.get("long_name", "")))
    if bracketed and _plain(bracketed[1]) in _METRES_PER_SECOND:
        return bracketed[1].strip()
    return ""


def _checked_region(region: Region) -> Region:
    try:
        west, south, east, north = (float(value) for value in region)
    except (TypeError, ValueError):
        west = south = east = north = math.nan
    # Of west to east, 10 to -10 goes around the back of the Earth.
    east += 360.0 * (east < west)
    if not (-90 <= south < north <= 90 and west < east <= west + 360 and math.isfinite(west)):
        raise RecordError(
            f"region: {region!r} is not accepted; give (west, south, east, north) in degrees"
        )
    return west, south, east, north


def _checked_period(period: Period) -> tuple[np.datetime64, np.datetime64]:
    try:
        first, last = (np.datetime64(time) for time in period)
        # A last day or month is meant to its end.
        if np.datetime_data(last)[0] in ("Y", "M", "D"):
            last = (last + 1).astype("datetime64[us]") - np.timedelta64(1, "us")
    except (TypeError, ValueError) as error:
        raise RecordError(
            f"period: {period!r} is not accepted; give two UTC dates, ('2024-06-01', '2024-08-31')"
        ) from error
    first, last = nanoseconds("period", [first, last], RecordError)
    if not first <= last:
        raise RecordError(f"period: {period!r} is not accepted; the first must not be later")
    return first, last


def _require_once(times: Times) -> None:
    """Check that no time of a sorted axis occurs twice."""
    twice = np.flatnonzero(np.diff(times) == np.timedelta64(0))
    if twice.size:
        raise RecordError(
            f"time: {np.datetime_as_string(times[twice[0]], unit='m')}Z occurs more than once, one "
            f"of {twice.size}; keep one of each, e.g. dataset.drop_duplicates('time'), or leave "
            "out overlapping files"
        )


# Axes


def _longitudes(values: Float, box: Region | None) -> tuple[Integer, Float]:
    """Columns to take, in order, and their continuous longitude [degrees]."""
    _require_values("longitude", values)
    around = np.mod(values, 360.0)
    # 0 and 360, or -180 and 180, are one meridian: the first of them is kept.
    _, first = np.unique(np.round(around, 6) % 360, return_index=True)
    order = first[np.argsort(around[first])]
    sorted_ = around[order]
    gaps = np.diff(sorted_, append=sorted_[0] + 360)
    step = float(gaps.min())
    round_the_earth = bool(gaps.max() < 1.5 * step)
    if not round_the_earth:
        start = sorted_[(gaps.argmax() + 1) % len(order)]
    else:
        start = values[0] if box is None else box[0] - step * (1 - 1e-6)
    slack = 1e-6 * step
    continuous = np.mod(around - start + slack, 360) + start - slack
    order = order[np.argsort(continuous[order])]
    axis = continuous[order]
    if box is not None:
        west, _, east, _ = box
        if not round_the_earth:  # the turn of the region that is nearest to the data
            turn = 360 * np.round((axis[0] + axis[-1] - west - east) / 720)
            west, east = west + turn, east + turn
        inside = (axis > west - step * (1 - 1e-6)) & (axis < east + step * (1 - 1e-6))
        order, axis = order[inside], axis[inside]
        _require_left("region", box, "longitude", values, axis)
    axis = _regular("longitude", axis)
    return order, np.asarray(axis - 360 * np.floor((axis[0] + 180 + slack) / 360))


def _latitudes(values: Float, box: Region | None) -> tuple[Integer, Float]:
    """Rows to take, in order, and their latitude [degrees]."""
    _require_values("latitude", values)
    if np.abs(values).max() > 90 + 1e-6:
        raise RecordError(
            f"latitude: {values.min():g} to {values.max():g} is not accepted; it should be from "
            "-90 to 90 degrees"
        )
    order = np.argsort(values)
    axis = values[order]
    step = float(np.median(np.diff(axis)))
    if box is not None:
        inside = (axis > box[1] - step * (1 - 1e-6)) & (axis < box[3] + step * (1 - 1e-6))
        order, axis = order[inside], axis[inside]
        _require_left("region", box, "latitude", values, axis)
    return order, _regular("latitude", axis)


def _require_values(name: str, values: Float) -> None:
    if not np.isfinite(values).all() or len(values) < 2:
        raise RecordError(
            f"{name}: {len(values)} value(s), {int((~np.isfinite(values)).sum())} missing; at "
            "least 2, all finite, are needed"
        )


def _require_left(field: str, box: Region, name: str, values: Float, axis: Float) -> None:
    if len(axis) < 2:
        raise RecordError(
            f"{field}: {box} leaves {len(axis)} {name}(s) of the data, which go from "
            f"{values.min():g} to {values.max():g}; at least 2 are needed"
        )


def _regular(name: str, axis: Float) -> Float:
    """Equally spaced axis that the values stand for, up to their rounding."""
    if len(axis) < 2:
        raise RecordError(f"{name}: all values are one meridian; at least 2 are needed")
    regular = np.linspace(axis[0], axis[-1], len(axis))
    step = regular[1] - regular[0]
    if step <= 0 or np.abs(axis - regular).max() > _AXIS_TOLERANCE * step:
        steps = np.diff(axis)
        raise RecordError(
            f"{name}: its steps go from {steps.min():g} to {steps.max():g} degrees; a regular axis "
            "is needed; regrid first, e.g. cdo remapbil,grid.txt in.nc out.nc"
        )
    return regular


def _compact(index: Integer) -> slice | Integer:
    """Slice in place of consecutive numbers: it is read from a file far faster."""
    if len(index) == 1:
        return slice(int(index[0]), int(index[0]) + 1)
    steps = np.diff(index)
    if (steps == 1).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    if (steps == -1).all():
        return slice(int(index[0]), int(index[-1]) - 1 if index[-1] else None, -1)
    return index
