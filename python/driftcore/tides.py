"""Tidal currents by constituent: read from an atlas, fitted to a current, or analytic.

One convention holds everywhere (docs/equations.md (26)): the current toward east or north at the
time `t` is

`Σ_k Re[f_k(t) c_k exp(i(V_k(t) + u_k(t)))]`, `c_k = A_k exp(−i G_k)`,

with the amplitude `A_k`, the Greenwich phase lag `G_k`, the equilibrium argument `V_k` at
Greenwich, and the nodal factor `f_k` and angle `u_k`. Arguments and nodal corrections are those of
pyTMD, after Schureman (1958) as the FES atlases use them.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore.earth import RADIUS_M
from driftcore.errors import DriftCoreError, DriftCoreWarning, RecordError, ScenarioError, reading
from driftcore.netcdf import open_netcdf
from driftcore.record import listed

if TYPE_CHECKING:
    from types import ModuleType

    import xarray as xr

Float: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
Times: TypeAlias = NDArray[np.datetime64]
Source: TypeAlias = "str | PathLike[str] | xr.Dataset"
Region: TypeAlias = tuple[float, float, float, float]

_DIMS = ("constituent", "latitude", "longitude")
_NODAL = "FES"
_OTHER_NAMES = {
    "E2": "EPS2",
    "LA2": "LAMBDA2",
    "LAM2": "LAMBDA2",
    "LDA2": "LAMBDA2",
    "RO1": "RHO1",
    "SIG1": "SIGMA1",
    "THE1": "THETA1",
}
# What `fit` tries, the more important first. S1 is left out: more weather than tide, and authors
# differ about its argument.
_RANKED = (
    *("M2", "S2", "N2", "K1", "O1", "K2", "P1", "Q1", "M4", "MS4", "NU2", "MN4"),
    *("MU2", "2N2", "L2", "T2", "M6", "2MS6", "J1", "M3", "MK3", "OO1", "LAMBDA2"),
)
# A normal matrix per value with a smaller eigenvalue (0.5 when all is well separated) makes
# standard errors more than seven times as large as they need be: the gaps hide a constituent.
_LEAST_EIGENVALUE = 0.01
# The strongest tidal currents of the world's straits run at about 10 m/s.
_FASTEST = 15.0
_PLACES_AT_ONCE = 512  # bounds the memory of a fit
_EARTH_ROTATION = 7.292e-5  # rad/s
_GRAVITY = 9.81  # m/s²


# Astronomy


def _pytmd() -> ModuleType:
    try:
        # Its import turns off every UserWarning of the process, ours too.
        with warnings.catch_warnings():
            from pyTMD import constituents
    except ImportError as error:
        raise DriftCoreError(
            f'tides need {error.name}, which is not installed: pip install "driftcore[geo]"'
        ) from error
    return constituents  # type: ignore[no-any-return]


def _standard_name(name: object) -> str:
    text = name.decode() if isinstance(name, bytes) else str(name)
    text = text.strip("\x00 \t").upper()
    return _OTHER_NAMES.get(text, text)


def _known(name: str) -> bool:
    try:
        _pytmd().coefficients_table([name.lower()], corrections=_NODAL)
    except ValueError:
        return False
    return True


def _ids(names: Iterable[str]) -> list[str]:
    return [name.lower() for name in names]


def _species(names: Sequence[str]) -> NDArray[np.int64]:
    """Cycles per lunar day, the first Doodson number: 0 for long periods."""
    table = _pytmd().coefficients_table(_ids(names), corrections=_NODAL)
    return np.asarray(table[0], dtype=np.int64)


def _frequency(names: Sequence[str]) -> Float:
    """Angular frequency [rad/s]."""
    return np.asarray(_pytmd().frequency(_ids(names), corrections=_NODAL), dtype=float)


def _arguments(names: Sequence[str], times: Times) -> tuple[Complex, Complex]:
    """Nodal factors `f e^{iu}` and equilibrium arguments `e^{iV}`, each (time, constituent)."""
    days = (times - np.datetime64("1858-11-17")) / np.timedelta64(1, "D")
    angle, factor, argument = _pytmd().arguments(days, _ids(names), corrections=_NODAL)
    return factor * np.exp(1j * angle), np.exp(1j * np.radians(argument))


def _checked_times(name: str, times: ArrayLike) -> Times:
    values = np.asarray(times)
    if values.dtype.kind != "M" or np.isnat(values).any():
        raise ScenarioError(
            f"{name}: {np.atleast_1d(values).ravel()[:1]} is not accepted; give datetime64, UTC"
        )
    return values


def _refuse_unknown(names: Iterable[str]) -> None:
    for name in names:
        if not _known(name):
            raise ScenarioError(
                f"constituents: {name!r} is not known; use names such as {listed(_RANKED[:5])}"
            )


def _checked_constituents(names: Iterable[object]) -> list[str]:
    """Give the standard names of the constituents, none twice, unknown or of long period."""
    found = [_standard_name(name) for name in names]
    if not found:
        raise ScenarioError("constituents: none is given; name at least one, such as 'M2'")
    for name in found:
        if found.count(name) > 1:
            raise ScenarioError(f"constituents: {name!r} occurs twice; give each once")
    _refuse_unknown(found)
    for name, species in zip(found, _species(found), strict=True):
        if species == 0:
            raise ScenarioError(
                f"constituents: {name!r} has a long period; it is slow enough to be part of the "
                "residual current, leave it out here"
            )
    return found


# The atlas


@dataclass(frozen=True, eq=False)
class TidalAtlas:
    """Complex tidal currents by constituent on a regular grid of longitude and latitude.

    The convention is that of this module. Constituents of long period (species 0) are refused:
    a current that changes over days belongs to the residual current.

    Parameters
    ----------
    dataset : xarray.Dataset
        Complex `u` and `v`, dims (constituent, latitude, longitude) in any order [m/s, toward
        east and north], NaN on land. Coordinates: `constituent`, standard names such as "M2";
        `latitude` and `longitude` [degrees], regular and strictly increasing (a longitude may lie
        outside ±180 so that the axis does not jump).

    Raises
    ------
    ScenarioError
        A variable, dimension or coordinate is missing, a constituent is unknown, given twice or
        of long period, an axis is irregular, values are real or infinite, some constituents are
        missing where others are given, or all is land.

    Examples
    --------
    >>> import numpy as np
    >>> from driftcore import tides
    >>> atlas = tides.biscay()
    >>> atlas.reference
    'M2'
    >>> atlas.velocity(np.datetime64("2026-07-01T12:00"), -4.0, 47.0).shape
    (2,)
    """

    dataset: xr.Dataset

    def __post_init__(self) -> None:
        object.__setattr__(self, "dataset", _checked_atlas(self.dataset))

    @property
    def constituents(self) -> tuple[str, ...]:
        """Standard names, in the order of the dataset."""
        return tuple(self.dataset["constituent"].values.tolist())

    @property
    def latitude(self) -> Float:
        """Latitudes of the grid [degrees north], increasing."""
        return np.asarray(self.dataset["latitude"].values)

    @property
    def longitude(self) -> Float:
        """Longitudes of the grid [degrees east], increasing."""
        return np.asarray(self.dataset["longitude"].values)

    @property
    def reference(self) -> str:
        """The constituent with the largest current; a run counts its tides by its species."""
        return str(self.scales()["maximum"].idxmax("constituent").item())

    def constituents_at(self, time: np.datetime64, reference: np.datetime64) -> xr.Dataset:
        """Frequencies and complex factors for a run: `Re[c_k factor_k e^{iω_k(t − reference)}]`.

        Parameters
        ----------
        time : numpy.datetime64
            Middle of the run, UTC: nodal corrections change over years and are taken from here.
        reference : numpy.datetime64
            Origin of the time of the run, UTC.

        Returns
        -------
        xarray.Dataset
            By `constituent`: `frequency` ω [rad/s], `species` (1 diurnal, 2 semidiurnal, 4
            quarter-diurnal, …) and complex `factor` f e^{i(V(reference) + u)}, f and u at `time`.

        Raises
        ------
        ScenarioError
            A time is not a datetime64.
        """
        import xarray as xr

        names = self.constituents
        nodal, _ = _arguments(names, np.atleast_1d(_checked_times("time", time)))
        _, equilibrium = _arguments(names, np.atleast_1d(_checked_times("reference", reference)))
        return xr.Dataset(
            {
                "frequency": ("constituent", _frequency(names), {"units": "rad s-1"}),
                "species": ("constituent", _species(names), {"units": "1"}),
                "factor": ("constituent", nodal[0] * equilibrium[0], {"units": "1"}),
            },
            {"constituent": list(names)},
        )

    def velocity(
        self,
        times: ArrayLike,
        longitude: ArrayLike,
        latitude: ArrayLike,
        *,
        method: Literal["linear", "nearest"] = "linear",
    ) -> Float:
        """Predict the tidal current at points, equation (26) term by term.

        Parameters
        ----------
        times : array_like of datetime64
            UTC.
        longitude, latitude : array_like
            Places [degrees], broadcast against the times; longitudes 360° apart are the same.
        method : {"linear", "nearest"}
            Bilinear between the grid points, or the nearest of them.

        Returns
        -------
        ndarray, shape (…, 2)
            Toward east and north [m/s]; NaN where a grid point used is on land.

        Raises
        ------
        ScenarioError
            A time is not a datetime64, or a place lies outside the grid.
        """
        moments = _checked_times("times", times)
        u, v = (self.dataset[name].values for name in "uv")
        rows, columns = (
            _neighbours(name, self.dataset[name].values, values, method)
            for name, values in (
                ("latitude", np.asarray(latitude, dtype=float)),
                ("longitude", _turned(np.asarray(longitude, dtype=float), self.longitude)),
            )
        )
        shape = np.broadcast_shapes(moments.shape, rows[0][0].shape, columns[0][0].shape)
        nodal, equilibrium = _arguments(self.constituents, moments.ravel())
        phasors = (nodal * equilibrium).reshape(*moments.shape, -1)
        current = np.zeros((*shape, 2))
        for row, row_weight in rows:
            for column, column_weight in columns:
                weight = row_weight * column_weight
                for component, c in enumerate((u, v)):
                    amplitudes = np.moveaxis(c, 0, -1)[row, column]
                    value = np.einsum("...k,...k->...", amplitudes, phasors).real
                    # A grid point that does not count may be on land.
                    current[..., component] += np.where(weight > 0, weight * value, 0)
        return current

    def sel_region(self, west: float, east: float, south: float, north: float) -> TidalAtlas:
        """Keep the grid points of a region, and the next ones around it, so that it is covered.

        Parameters
        ----------
        west, east, south, north : float
            Bounds [degrees]; longitudes 360° apart are the same, and those of the result
            continue from `west`.

        Raises
        ------
        ScenarioError
            The bounds are out of order, or no grid point is inside.
        """
        rows, columns, eastward = _region_indices(
            self.latitude, self.longitude, (west, east, south, north)
        )
        cut = self.dataset.isel(latitude=rows, longitude=columns)
        return TidalAtlas(cut.assign_coords(longitude=eastward))

    def scales(self) -> xr.Dataset:
        """Largest current over a tide (semi-major axis of the ellipse) by constituent.

        Returns
        -------
        xarray.Dataset
            `maximum` over the sea and `mean` over its area [m/s], by `constituent`.
        """
        import xarray as xr

        u, v = self.dataset["u"], self.dataset["v"]
        # u and v add up to two rotating vectors; where they meet, the current is largest.
        speed = (abs(u + 1j * v) + abs(u - 1j * v)) / 2
        area = xr.zeros_like(self.dataset["latitude"]) + np.cos(np.radians(self.latitude))
        over = ("latitude", "longitude")
        scales = xr.Dataset({"maximum": speed.max(over), "mean": speed.weighted(area).mean(over)})
        for variable in scales.values():
            variable.attrs["units"] = "m s-1"
        return scales

    def __repr__(self) -> str:
        maximum = self.scales()["maximum"].to_series().nlargest(4)
        currents = ", ".join(f"{name} {speed:.2g} m/s" for name, speed in maximum.items())
        if others := len(self.constituents) - len(maximum):
            currents += f", {others} more"
        south, north = self.latitude[[0, -1]]
        west, east = self.longitude[[0, -1]]
        return (
            f"TidalAtlas({currents} at most; {len(self.latitude)} × {len(self.longitude)} points, "
            f"longitude {west:g} to {east:g}, latitude {south:g} to {north:g})"
        )


def _checked_atlas(dataset: xr.Dataset) -> xr.Dataset:
    for name in "uv":
        if name not in dataset:
            raise ScenarioError(f"dataset: variable {name!r} is missing; it needs u and v")
        if set(dataset[name].dims) != set(_DIMS):
            raise ScenarioError(
                f"{name}: dimensions {dataset[name].dims} are not accepted; it needs {_DIMS}"
            )
        if dataset[name].dtype.kind != "c":
            raise ScenarioError(
                f"{name}: values of type {dataset[name].dtype} are not accepted; they must be "
                "complex, amplitude · exp(−i · Greenwich phase lag)"
            )
    for name in _DIMS:
        if name not in dataset.coords:
            raise ScenarioError(f"dataset: dimension {name!r} has no coordinate")
    names = _checked_constituents(dataset["constituent"].values)
    checked = dataset[["u", "v"]].transpose(*_DIMS).astype(complex)
    checked = checked.assign_coords(constituent=names)
    for name in ("latitude", "longitude"):
        _checked_axis(name, checked[name].values)
    if max(np.isinf(checked[name]).any() for name in "uv"):
        raise ScenarioError("dataset: holds infinite values; land is NaN")
    sea = checked["u"].notnull() & checked["v"].notnull()
    wet = sea.all("constituent")
    if bool((sea.any("constituent") & ~wet).any()):
        raise ScenarioError(
            "dataset: at some places only a part of the constituents is given; make them all NaN"
        )
    if not bool(wet.any()):
        raise ScenarioError("dataset: has no value that is not NaN; all is land")
    checked = checked.where(wet)
    checked["u"].attrs = {"long_name": "complex eastward tidal current", "units": "m s-1"}
    checked["v"].attrs = {"long_name": "complex northward tidal current", "units": "m s-1"}
    checked["latitude"].attrs = {"standard_name": "latitude", "units": "degrees_north"}
    checked["longitude"].attrs = {"standard_name": "longitude", "units": "degrees_east"}
    checked.attrs = {**dataset.attrs, "phase": "amplitude * exp(-i * Greenwich phase lag)"}
    return checked


# Axes


def _checked_axis(name: str, values: NDArray[Any], tolerance: float = 1e-6) -> None:
    """Refuse an axis that is not regular and increasing, up to a share of its step."""
    steps = np.diff(np.asarray(values, dtype=float))
    # One point stands alone; of two or more, no step differs from the others.
    if len(steps) and not (steps.min() > 0 and np.ptp(steps) <= tolerance * steps.mean()):
        raise ScenarioError(
            f"{name}: steps from {steps.min():g} to {steps.max():g} are not accepted; the axis "
            "must be regular and increasing"
        )


def _turned(values: Float, axis: Float) -> Float:
    """Longitudes, each by the turns that bring it nearest to the middle of an axis."""
    start = (axis[0] + axis[-1]) / 2 - 180
    return np.asarray(start + np.mod(values - start, 360))


def _neighbours(
    name: str, axis: Float, values: Float, method: str
) -> tuple[tuple[NDArray[np.int64], Float], tuple[NDArray[np.int64], Float]]:
    """Grid lines below and above places on an axis, with their weights."""
    step = np.diff(axis).mean() if len(axis) > 1 else 1.0
    position = (values - axis[0]) / step
    outside = ~((position >= -1e-6) & (position <= len(axis) - 1 + 1e-6))
    if outside.any():
        raise ScenarioError(
            f"{name}: {values[outside].flat[0]:g} is outside the grid; "
            f"it covers {axis[0]:g} to {axis[-1]:g}"
        )
    if method == "nearest":
        position = np.round(position)
    below = np.clip(np.floor(position), 0, max(len(axis) - 2, 0)).astype(np.int64)
    weight = np.clip(position - below, 0, 1)
    return (below, 1 - weight), (np.minimum(below + 1, len(axis) - 1), weight)


def _region_indices(
    latitude: Float, longitude: Float, region: Region, steps: int = 1
) -> tuple[NDArray[np.int64], NDArray[np.int64], Float]:
    """Rows and columns less than some steps outside a region, and the columns' longitudes."""
    west, east, south, north = region
    if not (west < east <= west + 360 and south < north):
        raise ScenarioError(
            f"region: {region} is not accepted; give (west, east, south, north) with west < east "
            "≤ west + 360 and south < north"
        )
    margin = steps * _step(latitude)
    rows = np.flatnonzero((latitude > south - margin) & (latitude < north + margin))
    margin = min(steps * _step(longitude), (360 - (east - west)) / 2 + 1e-6)
    start = west - margin + 1e-9
    # A global axis may hold both 0 and 360.
    eastward, columns = np.unique(
        np.round(start + np.mod(longitude - start, 360), 9), return_index=True
    )
    columns, eastward = columns[eastward < east + margin], eastward[eastward < east + margin]
    if not (len(rows) and len(columns)):
        raise ScenarioError(
            f"region: {region} has no grid point; the grid covers longitude {longitude[0]:g} to "
            f"{longitude[-1]:g}, latitude {latitude[0]:g} to {latitude[-1]:g}"
        )
    return rows, columns, eastward


def _step(axis: Float) -> float:
    return float(axis[-1] - axis[0]) / (len(axis) - 1) if len(axis) > 1 else 1e-6


# Reading an atlas


_PARTS = {
    "amplitude": "{0}a {0}amp {0}_amplitude {0}_amp {0}_a amplitude_{0} amp_{0}",
    "phase": "{0}g {0}p {0}pha {0}phase {0}_phase {0}_pha {0}_g {0}_p phase_{0} pha_{0}",
    "real": "{0}re {0}_real {0}_re real_{0}",
    "imag": "{0}im {0}_imag {0}_im {0}_imaginary imag_{0}",
}
_DIRECTIONS = {
    "u": r"eastward|zonal|\bu\b|\bx velocity|\beast",
    "v": r"northward|meridional|\bv\b|\by velocity|\bnorth",
}
_AXES = {
    "latitude": ("lat_{0}", "latitude", "lat", "nav_lat"),
    "longitude": ("lon_{0}", "longitude", "lon", "nav_lon"),
}
_CONSTITUENT_NAMES = ("constituent", "constituents", "con", "cons", "tidal_constituents")
_ROLES = tuple(f"{component}_{part}" for component in "uv" for part in _PARTS)
_VELOCITIES = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3}
_TRANSPORTS = {"m2/s": 1.0, "cm2/s": 1e-4}
_ANGLES = {"degree": 1.0, "deg": 1.0, "°": 1.0, "radian": 180 / math.pi, "rad": 180 / math.pi}


def from_atlas(
    source: Source | Sequence[Source] | Mapping[str, Source | Sequence[Source]],
    names: Mapping[str, str] | None = None,
    *,
    constituents: Iterable[str] | None = None,
    region: Region | None = None,
    units: str | None = None,
    phase_units: str | None = None,
    depth: xr.DataArray | None = None,
) -> TidalAtlas:
    """Read a tidal atlas of currents: amplitude and Greenwich phase lag, or real and imaginary.

    Amplitude and phase become one complex number at once: phases are never interpolated. Phases
    must be lags at Greenwich, as in FES and TPXO; nothing in a file tells others apart. Real and
    imaginary parts are those of `A exp(−iG)`, as in TPXO. Where all values are zero or any is
    missing is land. Components on the staggered points of a C-grid are brought to the points
    between (linear; a closed face carries no flow).

    Parameters
    ----------
    source : path or xarray.Dataset, sequence of them, or mapping
        One file with a dimension of constituents; or files of one constituent (and one or both
        components) each, named by a variable `con` inside or by their file name ("m2.nc",
        "u_m2_tpxo9.nc"); or a mapping of constituents to their file or files.
    names : mapping, optional
        Variables by role: "u_amplitude", "u_phase", "u_real", "u_imag", the same for v, and
        "latitude", "longitude". By default found by CF attributes and common names.
    constituents : iterable of str, optional
        Those wanted; by default all but the long periods, which are part of the residual current.
    region : (west, east, south, north), optional
        Bounds [degrees], covered with one grid step around; only this part is read.
    units : str, optional
        Units of amplitudes, real and imaginary parts, over what the file states: "m/s", "cm/s",
        "mm/s", or of transports "m2/s", "cm2/s".
    phase_units : str, optional
        "degrees" or "radians", over what the file states.
    depth : xarray.DataArray, optional
        Water depth [m] on latitude and longitude, to turn transports into velocities; linear
        between its points.

    Returns
    -------
    TidalAtlas

    Raises
    ------
    RecordError
        A file cannot be read, a component, phase, unit or name is missing or ambiguous, an axis
        is irregular, or a value is impossible.
    ScenarioError
        An argument is not accepted, or a constituent is unknown or not in the atlas.

    Warns
    -----
    DriftCoreWarning
        If constituents of long period are left out, or if phases in degrees look like radians.
    """
    _pytmd()
    for role in names or {}:
        if role not in (*_ROLES, *_AXES):
            raise ScenarioError(f"names: {role!r} is not accepted; use {listed((*_ROLES, *_AXES))}")
    wanted = None if constituents is None else _checked_constituents(constituents)
    reader = _Reader(dict(names or {}), region, units, phase_units, wanted)
    with ExitStack() as stack:
        for label, name, dataset in _opened(source, stack):
            with reading(label):
                reader.read(label, name, dataset)
    atlas = _on_one_grid(*reader.components(), reader.depth(depth))
    fastest = max(float(abs(atlas[name]).max()) for name in "uv")
    if fastest > _FASTEST:
        raise RecordError(
            f"source: an amplitude of {fastest:.3g} m/s is not accepted, no tide runs faster than "
            f"{_FASTEST:g} m/s; state the units with units="
        )
    if reader.long_periods:
        warnings.warn(
            f"constituents of long period are left out: {listed(sorted(reader.long_periods))}; "
            "they belong to the residual current",
            DriftCoreWarning,
            stacklevel=2,
        )
    return TidalAtlas(atlas) if region is None else TidalAtlas(atlas).sel_region(*region)


def _opened(
    source: Source | Sequence[Source] | Mapping[str, Source | Sequence[Source]], stack: ExitStack
) -> Iterator[tuple[str, str | None, xr.Dataset]]:
    """Label, constituent (where the mapping or the file name tells) and content of each file."""
    import xarray as xr

    groups: list[tuple[str | None, Any]]
    if isinstance(source, Mapping) and not isinstance(source, xr.Dataset):
        groups = [(_checked_constituents([name])[0], item) for name, item in source.items()]
    else:
        groups = [(None, source)]
    for name, group in groups:
        alone = isinstance(group, str | PathLike | xr.Dataset)
        for item in [group] if alone else group:
            if isinstance(item, xr.Dataset):
                yield "source", name, item
                continue
            path = Path(fspath(item))
            words = [_standard_name(word) for word in re.split(r"[\W_]+", path.stem)]
            told = {word for word in words if _known(word)}
            with reading(f"{path}:", " as NetCDF"):
                dataset = stack.enter_context(open_netcdf(path, decode_times=False))
            yield str(path), name or (told.pop() if len(told) == 1 else None), dataset


class _Reader:
    """Collects complex currents by component and constituent from one file after the other."""

    def __init__(
        self,
        names: dict[str, str],
        region: Region | None,
        units: str | None,
        phase_units: str | None,
        wanted: list[str] | None,
    ) -> None:
        self.names = names
        self.region = region
        self.units = units
        self.phase_units = phase_units
        self.wanted = wanted
        self.found: dict[str, dict[str, xr.DataArray]] = {"u": {}, "v": {}}
        self.held: set[str] = set()
        self.long_periods: set[str] = set()
        self.transport = False

    def read(self, label: str, name: str | None, dataset: xr.Dataset) -> None:
        """Take the components that a file holds."""
        for component in "uv":
            variables = self._variables(label, dataset, component)
            if variables is None:
                continue
            fields = [
                self._by_constituent(label, name, dataset, self._cut(label, dataset, v, component))
                for v in variables[1]
            ]
            if not fields[0].size:  # nothing that is wanted
                continue
            factor = self._velocity_factor(label, dataset, variables[1][0])
            if variables[0] == "amplitude":
                amplitude, phase = fields
                if bool((amplitude < 0).any()):
                    raise RecordError(
                        f"{label}: {variables[1][0]!r} holds negative values, it is no amplitude"
                    )
                lag = np.radians(self._degrees(label, dataset, variables[1][1], phase))
                values = factor * amplitude * np.exp(-1j * lag)
            else:
                values = factor * (fields[0] + 1j * fields[1])
            for k, one in enumerate(values["constituent"].values.tolist()):
                if one in self.found[component]:
                    raise RecordError(f"{label}: {component} of {one} was given before")
                self.found[component][one] = values.isel(constituent=k, drop=True)

    def components(self) -> tuple[xr.DataArray, xr.DataArray]:
        """Give both components, (constituent, latitude, longitude), as far as they were found."""
        import xarray as xr

        if absent := sorted(set(self.wanted or ()) - self.held) if self.held else []:
            raise ScenarioError(
                f"constituents: {listed(absent)} not in the atlas; it has "
                f"{listed(sorted(self.held))}"
            )
        if self.held and self.held == self.long_periods:
            raise RecordError(
                f"source: has none but constituents of long period: {listed(sorted(self.held))}"
            )
        u, v = (self.found[component] for component in "uv")
        for name, one, other in (("u", u, v), ("v", v, u)):
            if not one:
                raise RecordError(
                    f"source: {name} is not found; name its variables with "
                    f'names={{"{name}_amplitude": …, "{name}_phase": …}} (or _real, _imag)'
                )
            if missing := sorted(set(other) - set(one)):
                raise RecordError(f"source: {name} of {listed(missing)} is not found")
        chosen = self.wanted or list(u)
        try:
            return tuple(  # type: ignore[return-value]
                xr.concat([part[one] for one in chosen], "constituent", join="exact").assign_coords(
                    constituent=chosen
                )
                for part in (u, v)
            )
        except ValueError as error:
            raise RecordError("source: its files have different grids; give one grid") from error

    def depth(self, depth: xr.DataArray | None) -> xr.DataArray | None:
        """Check that a depth is given where it is needed, and only there."""
        if not self.transport:
            if depth is not None:
                raise ScenarioError("depth: is not accepted, the atlas states velocities")
            return None
        if depth is None:
            raise RecordError(
                "source: holds transports (m2/s), not velocities; give the water depth of the "
                "atlas with depth=, or velocities"
            )
        cut = self._cut("depth", depth.to_dataset(name="depth"), "depth", "z").squeeze(drop=True)
        if set(cut.dims) != {"latitude", "longitude"}:
            raise ScenarioError(
                f"depth: dimensions {depth.dims} are not accepted; give latitude and longitude"
            )
        return cut

    def _variables(
        self, label: str, dataset: xr.Dataset, component: str
    ) -> tuple[str, tuple[str, str]] | None:
        forms = [("amplitude", "phase"), ("real", "imag")]
        told = [f for f in forms if any(f"{component}_{part}" in self.names for part in f)]
        incomplete = None
        for form in told or forms:
            first, second = (self._variable(label, dataset, component, part) for part in form)
            if first and second:
                return form[0], (first, second)
            if first or second:
                incomplete = form[1] if first else form[0], first or second
        if incomplete:
            raise RecordError(
                f"{label}: has {incomplete[1]!r} but no {incomplete[0]} for {component}; a tide "
                f'needs both, name it with names={{"{component}_{incomplete[0]}": …}}'
            )
        return None

    def _variable(self, label: str, dataset: xr.Dataset, component: str, part: str) -> str | None:
        role = f"{component}_{part}"
        if role in self.names:
            return self.names[role] if self.names[role] in dataset else None
        aliases = _PARTS[part].format(component).split()
        variables = [str(name) for name in dataset.data_vars]
        hits = [name for name in variables if name.lower() in aliases]
        for name in variables if not hits else ():
            attributes = dataset[name].attrs
            words = f"{attributes.get('standard_name', '')} {attributes.get('long_name', '')}"
            words = words.replace("_", " ").lower()
            if re.search(_DIRECTIONS[component], words) and re.search(rf"\b{part}", words):
                hits.append(name)
        if len(hits) > 1:
            raise RecordError(
                f"{label}: {role} may be {listed(hits)}; choose with names={{{role!r}: …}}"
            )
        return hits[0] if hits else None

    def _cut(self, label: str, dataset: xr.Dataset, variable: str, component: str) -> xr.DataArray:
        """One variable on increasing latitude and continuous longitude, only the region of it."""
        rows, latitude = self._axis(label, dataset, variable, "latitude", component)
        columns, longitude = self._axis(label, dataset, variable, "longitude", component)
        if rows == columns:
            raise RecordError(
                f"{label}: latitude and longitude both run along {rows!r}; give a regular grid"
            )
        field = dataset[variable].drop_vars(dataset[variable].coords.keys() & {rows, columns})
        field = field.drop_vars([name for name in field.coords if name not in field.dims])
        field = field.rename({rows: "latitude", columns: "longitude"})
        for role, values in (("latitude", latitude), ("longitude", longitude)):
            if not len(values):
                raise RecordError(f"{label}: {role} has no value")
        if latitude[-1] < latitude[0]:
            latitude, field = latitude[::-1], field.isel(latitude=slice(None, None, -1))
        longitude = np.unwrap(longitude, period=360)
        if longitude[-1] < longitude[0]:
            longitude, field = longitude[::-1], field.isel(longitude=slice(None, None, -1))
        axes = {"latitude": latitude, "longitude": longitude}
        for role, values in axes.items():
            try:
                # Single precision leaves a thousandth of a step of 1/30°.
                _checked_axis(role, values, tolerance=0.02)
            except ScenarioError as error:
                raise RecordError(f"{label}: {error}") from error
            axes[role] = np.linspace(values[0], values[-1], len(values))
        if self.region is not None:
            # One step more, since a staggered grid loses one.
            kept, across, eastward = _region_indices(
                axes["latitude"], axes["longitude"], self.region, steps=2
            )
            field = field.isel(latitude=kept, longitude=across)
            axes = {"latitude": axes["latitude"][kept], "longitude": eastward}
        return field.assign_coords(axes)

    def _axis(
        self, label: str, dataset: xr.Dataset, variable: str, role: str, component: str
    ) -> tuple[str, Float]:
        """Dimension and values of an axis; a 2-D one must be constant along the other dimension."""
        by_name = {str(name).lower(): str(name) for name in dataset.variables}
        tried = [self.names[role]] if role in self.names else [
            *(alias.format(component) for alias in _AXES[role]),
            *(n for n in by_name if dataset[by_name[n]].attrs.get("standard_name") == role),
        ]  # fmt: skip
        for name in tried:
            axis = dataset.get(by_name.get(name.lower(), ""))
            if (
                axis is None
                or axis.ndim not in (1, 2)
                or not set(axis.dims) <= set(dataset[variable].dims)
            ):
                continue
            values = np.asarray(axis.values, dtype=float)
            if axis.ndim == 1:
                return str(axis.dims[0]), values
            for along in (0, 1):
                if np.ptp(values, axis=1 - along).max() < 1e-6:
                    return str(axis.dims[along]), values.take(0, axis=1 - along)
            raise RecordError(f"{label}: {axis.name!r} is curvilinear; give a regular grid")
        raise RecordError(
            f"{label}: {variable!r} has no {role}; name it with names={{{role!r}: …}}"
        )

    def _by_constituent(
        self, label: str, name: str | None, dataset: xr.Dataset, field: xr.DataArray
    ) -> xr.DataArray:
        """Read a field, (constituent, latitude, longitude): those wanted, no long periods."""
        extra = [str(dim) for dim in field.dims if dim not in ("latitude", "longitude")]
        by_name = {str(n).lower(): str(n) for n in dataset.variables}
        labels = [dataset[by_name[n]] for n in _CONSTITUENT_NAMES if n in by_name]
        along = [dim for dim in extra if any(dim in one.dims[:1] for one in labels)]
        along = along or [dim for dim in extra if field.sizes[dim] > 1 or dim in dataset.coords]
        held: list[str | None]
        if len(along) > 1 or any(field.sizes[dim] > 1 for dim in extra if dim not in along):
            raise RecordError(
                f"{label}: {field.name!r} has the dimensions {extra} besides latitude and "
                "longitude; select one value of all but the constituents"
            )
        if along:
            told = [one for one in labels if one.dims[:1] == (along[0],)]
            told = told or ([dataset[along[0]]] if along[0] in dataset.coords else [])
            held = _labels(label, told[0] if told else None, along[0], field.sizes[along[0]])
        else:
            inside = [_labels(label, one.expand_dims("_"), "_", 1)[0] for one in labels[:1]]
            held = [name or (inside[0] if inside else None)]
        if None in held:
            raise RecordError(
                f"{label}: does not tell its constituent; give a mapping, "
                '{"M2": file, "S2": [eastward file, northward file]}'
            )
        names = [str(one) for one in held]
        _refuse_unknown(names)
        species = _species(names)
        self.held |= set(names)
        self.long_periods |= {n for n, s in zip(names, species, strict=True) if s == 0}
        chosen = [
            k
            for k, one in enumerate(names)
            if species[k] and (self.wanted is None or one in self.wanted)
        ]
        field = field.squeeze([dim for dim in extra if dim not in along], drop=True)
        if along:
            field = field.drop_vars(along, errors="ignore").rename({along[0]: "constituent"})
        else:
            field = field.expand_dims("constituent")
        field = field.isel(constituent=chosen)
        field = field.assign_coords(constituent=[names[k] for k in chosen])
        return field.transpose(*_DIMS).astype(float).compute()

    def _velocity_factor(self, label: str, dataset: xr.Dataset, variable: str) -> float:
        """Tell what brings the values to m/s (transports to m²/s)."""
        stated = self.units or dataset[variable].attrs.get("units")
        accepted = {**_VELOCITIES, **_TRANSPORTS}
        if stated is None:
            raise RecordError(
                f"{label}: {variable!r} states no units; state them with units=, one of "
                f"{listed(accepted)}"
            )
        unit = _plain_unit(str(stated))
        if unit not in accepted:
            raise RecordError(
                f"{label}: units {stated!r} of {variable!r} are not accepted; state them with "
                f"units=, one of {listed(accepted)}"
            )
        self.transport |= unit in _TRANSPORTS
        return accepted[unit]

    def _degrees(
        self, label: str, dataset: xr.Dataset, variable: str, phase: xr.DataArray
    ) -> xr.DataArray:
        stated = self.phase_units or dataset[variable].attrs.get("units")
        unit = str(stated).strip().lower().removesuffix("s")
        if unit not in _ANGLES:
            raise RecordError(
                f"{label}: units {stated!r} of the phase {variable!r} are not accepted; state "
                'them with phase_units="degrees" or "radians"'
            )
        largest = float(abs(phase).max())
        full_circle = 2 * math.pi * (1 + 1e-6)
        if _ANGLES[unit] != 1 and largest > full_circle:
            raise RecordError(
                f"{label}: a phase of {largest:.4g} in {variable!r} is no radian; state the units "
                'with phase_units="degrees"'
            )
        if _ANGLES[unit] == 1 and phase.size > 3 and 0 < largest <= full_circle:
            warnings.warn(
                f"{label}: no phase in {variable!r} is above {largest:.3g}°; if they are radians, "
                'say phase_units="radians"',
                DriftCoreWarning,
                stacklevel=4,
            )
        return phase * _ANGLES[unit]


def _labels(label: str, labels: xr.DataArray | None, dim: str, size: int) -> list[str | None]:
    """Names of the constituents along a dimension."""
    if labels is not None:
        values = labels.values
        if values.dtype.kind in "SU" and values.ndim == 2:  # characters
            return [_standard_name(b"".join(row.astype("S1"))) for row in values]
        if values.ndim == 1 and values.dtype.kind in "OSUT":
            return [_standard_name(value) for value in values]
        meanings = str(labels.attrs.get("flag_meanings", "")).split()
        flags = np.atleast_1d(labels.attrs.get("flag_values", np.arange(len(meanings)))).tolist()
        if values.ndim == 1 and set(values.tolist()) <= set(flags) and meanings:
            return [_standard_name(meanings[flags.index(value)]) for value in values.tolist()]
    raise RecordError(
        f"{label}: the {size} constituents along {dim!r} have no names; give them with "
        f'dataset.assign_coords(constituent=("{dim}", ["M2", …]))'
    )


def _plain_unit(text: str) -> str:
    """Bring the spellings of a velocity or a transport to "m/s", "cm2/s", …."""
    text = re.sub(r"centi\s*", "c", text.strip().lower())
    text = re.sub(r"milli\s*", "m", text)
    text = re.sub(r"met(er|re)s?", "m", text)
    text = re.sub(r"sec(ond)?s?", "s", text)
    text = re.sub(r"\s*(/|\bper\b)\s*", "/", text)
    text = re.sub(r"[\s.^*()]", "", text)
    return re.sub(r"(?<!/)s-1$", "/s", text)


def _on_one_grid(u: xr.DataArray, v: xr.DataArray, depth: xr.DataArray | None) -> xr.Dataset:
    """Both components on one grid, transports over their depth, land as NaN."""
    import xarray as xr

    staggered = any(not np.array_equal(u[axis], v[axis]) for axis in ("latitude", "longitude"))
    if staggered:
        # The points of a C-grid where u and v both lie between two of their own.
        latitude = _within("latitude", u["latitude"].values, v["latitude"].values)
        longitude = _within("longitude", v["longitude"].values, u["longitude"].values)
        u, v = (part.fillna(0).interp(latitude=latitude, longitude=longitude) for part in (u, v))
    wet = ((u != 0) | (v != 0)).any("constituent") & (u.notnull() & v.notnull()).all("constituent")
    atlas = xr.Dataset({"u": u, "v": v}).where(wet)
    if depth is not None:
        places = {
            "latitude": atlas["latitude"].values,
            "longitude": _turned(atlas["longitude"].values, depth["longitude"].values),
        }
        depth = depth.interp(places).assign_coords(longitude=atlas["longitude"])
        atlas = atlas / depth.where(depth > 0)
    if not bool(atlas["u"].notnull().any()):
        raise RecordError("source: has no value that is neither missing nor zero; all is land")
    return atlas


def _within(name: str, inner: Float, outer: Float) -> Float:
    """Points of one axis of a staggered grid that lie between points of the other."""
    step = _step(outer)
    between = np.mod((inner - outer[0]) / step, 1)
    kept = inner[(inner >= outer[0]) & (inner <= outer[-1])]
    if len(kept) < 2 or abs(_step(inner) / step - 1) > 0.01 or abs(between - 0.5).max() > 0.1:
        raise RecordError(
            f"source: the {name} axes of u and v are no staggered grid; give one grid"
        )
    return np.asarray(kept)


# Fitting a current


@dataclass(frozen=True, eq=False)
class TidalFit:
    """What `fit` finds in a current.

    Attributes
    ----------
    atlas : TidalAtlas
        The tide, NaN where there were too few values.
    residual : xarray.Dataset
        `u` and `v` (time, latitude, longitude) without the tide [m/s]: mean, trend and all else.
    standard_error : xarray.Dataset
        `u` and `v` (constituent, latitude, longitude): standard error [m/s] of the amplitudes,
        if what is left has no memory. A residual current has some, then it is a lower bound.
    explained : xarray.DataArray
        Share of the variance of the current (both components) that the tide makes (latitude,
        longitude).
    """

    atlas: TidalAtlas
    residual: xr.Dataset
    standard_error: xr.Dataset
    explained: xr.DataArray

    def __repr__(self) -> str:
        share = float(self.explained.median())
        return f"TidalFit(explains {share:.1%} of the variance (median), {self.atlas!r})"


def fit(
    dataset: xr.Dataset,
    constituents: Iterable[str] | None = None,
    minimum_rayleigh: float = 1.0,
) -> TidalFit:
    """Find the tide in a current by least squares, docs/equations.md (28)–(29).

    Mean, linear trend and all constituents are fitted together at each place, nodal corrections
    at each time. Mean and trend stay in the residual.

    Parameters
    ----------
    dataset : xarray.Dataset
        `u` and `v` toward east and north [m/s, or with the attribute `units` cm/s], dims time and,
        where they are more than one place, latitude and longitude; all three as coordinates. Times
        in UTC may be irregular; missing values are NaN (at either component: both are left out).
    constituents : iterable of str, optional
        Those to fit. By default as many of a ranked list of 23 as the record tells apart.
    minimum_rayleigh : float
        Least number of cycles, over the length of the record, by which two constituents (and each
        of them and the mean) must differ.

    Returns
    -------
    TidalFit

    Raises
    ------
    RecordError
        A variable, dimension, coordinate or unit does not serve, or no place has enough values.
    ScenarioError
        A constituent is unknown, of long period, or not told apart from another by the length of
        the record or the step; `minimum_rayleigh` is not positive.

    Warns
    -----
    DriftCoreWarning
        If places with some values have too few, or gaps that hide a constituent; they are left
        out.
    """
    import xarray as xr

    if not (math.isfinite(minimum_rayleigh) and minimum_rayleigh > 0):
        raise ScenarioError(
            f"minimum_rayleigh: {minimum_rayleigh!r} is not accepted; give a number above 0"
        )
    asked = None if constituents is None else _checked_constituents(constituents)
    current = _checked_current(dataset)
    times = current["time"].values
    names = _told_apart(times, asked, minimum_rayleigh)
    nodal, equilibrium = _arguments(names, times)
    phasors = nodal * equilibrium
    hours = (times - times[0]) / np.timedelta64(1, "h")
    # Re[c E] = Re c Re E − Im c Im E; time is scaled so that the matrix is well conditioned.
    trend = (hours - hours.mean()) / (np.ptp(hours) / 2)
    design = np.column_stack([np.ones_like(trend), trend, phasors.real, -phasors.imag])
    shape = current["u"].shape[1:]
    u, v = (current[name].values.reshape(len(times), -1) for name in "uv")
    places = u.shape[1]
    fitted: Complex = np.empty((design.shape[1], places), complex)
    errors, explained = np.empty((2, len(names), places)), np.empty(places)
    left_out = 0
    for first in range(0, places, _PLACES_AT_ONCE):
        block = slice(first, first + _PLACES_AT_ONCE)
        # Both components at once: the equations are real, so u and v are a real and imaginary part.
        values = u[:, block] + 1j * v[:, block]
        fitted[:, block], inverse = _least_squares(design, values)
        count = np.isfinite(values).sum(axis=0)
        left_out += int(((count > 0) & np.isnan(fitted[0, block])).sum())
        freedom = np.maximum(count - design.shape[1], 1)
        misfit = values - design @ fitted[:, block]
        # Of a cosine and a sine amplitude, the root mean square.
        inverse = (inverse[2:].reshape(2, len(names), -1)).mean(axis=0)
        for component, part in enumerate((misfit.real, misfit.imag)):
            variance = np.nansum(part**2, axis=0) / freedom
            errors[component, :, block] = np.sqrt(inverse * variance)
        residual = values - design[:, 2:] @ fitted[2:, block]
        with np.errstate(invalid="ignore"):  # a current at rest has no variance to share
            explained[block] = 1 - _variance(residual, count) / _variance(values, count)
        explained[block][np.isnan(fitted[0, block])] = np.nan
        u[:, block], v[:, block] = residual.real, residual.imag
    if np.isnan(fitted).all():
        raise RecordError(
            f"dataset: no place has values enough for {len(fitted)} coefficients; ask for fewer "
            "constituents"
        )
    if left_out:
        warnings.warn(
            f"{left_out} places with too few values, or gaps that hide a constituent, are left out",
            DriftCoreWarning,
            stacklevel=2,
        )

    axes = {name: current[name] for name in ("latitude", "longitude")}

    def by_constituent(u: NDArray[Any], v: NDArray[Any]) -> xr.Dataset:
        grids = {"u": u.reshape(-1, *shape), "v": v.reshape(-1, *shape)}
        return xr.Dataset(
            {name: (_DIMS, grid, {"units": "m s-1"}) for name, grid in grids.items()},
            {"constituent": names, **axes},
        )

    cosine, sine = np.split(fitted[2:], 2)
    return TidalFit(
        TidalAtlas(by_constituent(cosine.real + 1j * sine.real, cosine.imag + 1j * sine.imag)),
        xr.Dataset(
            {
                name: (current[name].dims, part.reshape(current[name].shape), {"units": "m s-1"})
                for name, part in (("u", u), ("v", v))
            },
            current.coords,
        ),
        by_constituent(*errors),
        xr.DataArray(
            explained.reshape(shape),
            axes,
            ("latitude", "longitude"),
            name="explained",
            attrs={"units": "1", "long_name": "share of the variance that the tide makes"},
        ),
    )


def _variance(values: Complex, count: NDArray[np.int64]) -> Float:
    """Variance over time of both components together, missing values aside."""
    count = np.maximum(count, 1)
    mean = np.nansum(values, axis=0) / count
    return np.asarray(np.nansum(abs(values - mean) ** 2, axis=0) / count)


def _checked_current(dataset: xr.Dataset) -> xr.Dataset:
    """`u` and `v` (time, latitude, longitude) in m/s, checked."""
    dims = ("time", "latitude", "longitude")
    for name in (*"uv", *dims):
        if name not in dataset.variables or (name in dims and name not in dataset.coords):
            what = "variable" if name in "uv" else "coordinate"
            raise RecordError(f"dataset: {what} {name!r} is missing; it needs u, v and {dims}")
    current = dataset[["u", "v"]]
    for name in ("latitude", "longitude"):
        if name not in current.dims and current[name].ndim == 0:
            current = current.expand_dims(name)
    for name in "uv":
        if set(current[name].dims) != set(dims):
            raise RecordError(
                f"{name}: dimensions {dataset[name].dims} are not accepted; it needs {dims}, the "
                "last two may be single places"
            )
        unit = _plain_unit(str(dataset[name].attrs.get("units", "m/s")))
        if unit not in _VELOCITIES:
            raise RecordError(
                f"{name}: units {dataset[name].attrs['units']!r} are not accepted; use "
                f"{listed(_VELOCITIES)}"
            )
        values = np.array(current[name].transpose(*dims).values, dtype=float, order="C")
        current[name] = dims, _VELOCITIES[unit] * values
        if np.isinf(current[name]).any():
            raise RecordError(f"{name}: holds infinite values; missing values are NaN")
    try:
        times = _checked_times("time", current["time"].values)
        for name in ("latitude", "longitude"):
            _checked_axis(name, current[name].values)
    except ScenarioError as error:
        raise RecordError(str(error)) from error
    if len(np.unique(times)) < 3:
        raise RecordError(f"time: {len(times)} values are not accepted; it needs at least 3")
    return current.drop_vars(set(current.coords) - set(dims))


def _told_apart(times: Times, asked: list[str] | None, minimum_rayleigh: float) -> list[str]:
    """Constituents that a record of this length and step tells apart (Rayleigh, Nyquist)."""
    moments = np.unique(times)
    step = np.median(np.diff(moments)) / np.timedelta64(1, "s")
    length = (moments[-1] - moments[0]) / np.timedelta64(1, "s") + step
    candidates = list(_RANKED) if asked is None else asked
    chosen: dict[str, float] = {"mean": 0.0}
    for name, frequency in zip(candidates, _frequency(candidates), strict=True):
        if frequency >= math.pi / step:
            if asked is not None:
                raise ScenarioError(
                    f"constituents: {name!r} has {2 * math.pi / frequency / 3600:.3g} h, less than "
                    f"two steps of {step / 3600:.3g} h; leave it out"
                )
            continue
        nearest = min(chosen, key=lambda other: abs(chosen[other] - frequency))
        needed = 2 * math.pi * minimum_rayleigh / abs(chosen[nearest] - frequency)
        if needed <= length * (1 + 1e-9):
            chosen[name] = frequency
        elif asked is not None:
            raise ScenarioError(
                f"constituents: {nearest!r} and {name!r} are not told apart by a record of "
                f"{length / 86400:.4g} days; it takes {needed / 86400:.4g} days (minimum_rayleigh "
                f"{minimum_rayleigh:g}), leave one out"
            )
    del chosen["mean"]
    if asked is None and "M2" not in chosen:
        raise ScenarioError(
            f"dataset: {length / 3600:.3g} h with steps of {step / 3600:.3g} h do not tell M2 "
            "(12.4 h) from the mean; use a longer record, or name the constituents"
        )
    return list(chosen)


def _least_squares(design: Float, values: Complex) -> tuple[Complex, Float]:
    """Coefficients and diagonal of the inverse normal matrix, each (column, place).

    Places with one pattern of gaps share one matrix. The few missing rows are taken off the
    matrix of the whole record. NaN where the rows left do not determine the coefficients.
    """
    good = np.isfinite(values)
    right = design.T @ np.where(good, values, 0)
    whole = design.T @ design
    coefficients: Complex = np.full(right.shape, complex(np.nan, np.nan))
    diagonal: Float = np.full(right.shape, np.nan)
    _, pattern = np.unique(np.packbits(good, axis=0), axis=1, return_inverse=True)
    order = np.argsort(pattern.ravel(), kind="stable")
    for places in np.split(order, np.flatnonzero(np.diff(pattern.ravel()[order])) + 1):
        there = good[:, places[0]]
        count = int(there.sum())
        if 2 * count > len(design):
            normal = whole - design[~there].T @ design[~there]
        else:
            normal = design[there].T @ design[there]
        if count <= design.shape[1] or np.linalg.eigvalsh(normal / count)[0] < _LEAST_EIGENVALUE:
            continue
        inverse = np.linalg.inv(normal)
        coefficients[:, places] = inverse @ right[:, places]
        diagonal[:, places] = np.diag(inverse)[:, None]
    return coefficients, diagonal


# Analytic tides


def kelvin_wave(
    longitude: ArrayLike,
    latitude: ArrayLike,
    levels: Mapping[str, complex] | None = None,
    *,
    depth: float = 100.0,
    heading: float = 0.0,
    origin: tuple[float, float] | None = None,
) -> TidalAtlas:
    """Kelvin waves along a straight coast in a sea of one depth, equation (30).

    `η = a exp(−|f| n/c − i k s)`, `U = η √(g/H)` along the coast, `c = √(gH)`, `k = ω/c`; the
    coast is to the right of the wave in the northern hemisphere, behind it is land. Gill (1982),
    chapter 10.

    Parameters
    ----------
    longitude, latitude : array_like, shapes (m,) and (n,)
        Axes of the grid [degrees], regular and increasing.
    levels : mapping of str to complex, optional
        Level at the origin by constituent, amplitude · exp(−i · Greenwich lag) [m]; default: M2 of
        1 m and lag 0.
    depth : float
        Water depth [m].
    heading : float
        Where the wave runs to [degrees clockwise from north].
    origin : (longitude, latitude), optional
        A point of the coast [degrees], where the plane touches the globe; default: the middle of
        the grid.

    Raises
    ------
    ScenarioError
        An axis, a constituent or a number is not accepted.
    """
    plane = _Plane(longitude, latitude, levels, depth, heading, origin)
    offshore = plane.left * math.copysign(1, plane.rotation)
    decay = np.exp(-abs(plane.rotation) * offshore / plane.speed)
    return plane.atlas(
        lambda level, omega: (
            level * plane.ratio * decay * np.exp(-1j * omega / plane.speed * plane.along),
            0j * decay,
        ),
        offshore >= 0,
    )


def progressive_wave(
    longitude: ArrayLike,
    latitude: ArrayLike,
    levels: Mapping[str, complex] | None = None,
    *,
    depth: float = 100.0,
    heading: float = 0.0,
    origin: tuple[float, float] | None = None,
) -> TidalAtlas:
    """Plane waves on an open rotating sea of one depth (Sverdrup, Poincaré), equation (31).

    `η = a exp(−i k s)`, `U = η ω/(kH)` along and `i U f/ω` to the left of the heading, with
    `ω² = f² + gH k²`. Gill (1982), chapter 8; LeBlond & Mysak (1978), chapter 3. Parameters as in
    `kelvin_wave`.

    Raises
    ------
    ScenarioError
        As in `kelvin_wave`, and if a constituent is slower than the inertial frequency: it does
        not propagate.
    """
    plane = _Plane(longitude, latitude, levels, depth, heading, origin)

    def current(level: complex, omega: float) -> tuple[Complex, Complex]:
        if omega <= abs(plane.rotation):
            raise ScenarioError(
                f"levels: a constituent of {omega:.3g} rad/s does not propagate where the inertial "
                f"frequency is {abs(plane.rotation):.3g} rad/s; use a kelvin_wave"
            )
        k = math.sqrt(omega**2 - plane.rotation**2) / plane.speed
        along = level * omega / (k * plane.depth) * np.exp(-1j * k * plane.along)
        return along, 1j * plane.rotation / omega * along

    return plane.atlas(current)


def standing_wave(
    longitude: ArrayLike,
    latitude: ArrayLike,
    levels: Mapping[str, complex] | None = None,
    *,
    depth: float = 100.0,
    heading: float = 0.0,
    origin: tuple[float, float] | None = None,
) -> TidalAtlas:
    """Standing waves before a wall at the origin, without rotation, equation (32).

    `η = a cos ks`, `U = −i a √(g/H) sin ks` along the heading, `k = ω/√(gH)`: two waves that run
    against each other. Gill (1982), chapter 5. Parameters as in `kelvin_wave`; there is no land.

    Raises
    ------
    ScenarioError
        As in `kelvin_wave`.
    """
    plane = _Plane(longitude, latitude, levels, depth, heading, origin)
    return plane.atlas(
        lambda level, omega: (
            -1j * level * plane.ratio * np.sin(omega / plane.speed * plane.along),
            0j * plane.along,
        )
    )


def amphidrome(
    longitude: ArrayLike,
    latitude: ArrayLike,
    levels: Mapping[str, complex] | None = None,
    *,
    width: float,
    depth: float = 100.0,
    heading: float = 0.0,
    origin: tuple[float, float] | None = None,
) -> TidalAtlas:
    """Two Kelvin waves that pass each other in a channel, with amphidromic points, equation (33).

    `η = a [exp(−n/R − iks) + exp(−(b − n)/R + iks)]`, `U = √(g/H) a [exp(−n/R − iks) −
    exp(−(b − n)/R + iks)]`, `R = c/|f|`. Amphidromic points lie in the middle, `n = b/2`, where
    `cos ks = 0`. Taylor (1922), without the waves that reflection at a head of the channel adds;
    LeBlond & Mysak (1978), chapter 5. Parameters as in `kelvin_wave`; the origin is a point of the
    coast to the right of the heading, `width` that of the channel [m].

    Raises
    ------
    ScenarioError
        As in `kelvin_wave`.
    """
    _positive("width", width)
    plane = _Plane(longitude, latitude, levels, depth, heading, origin)
    across = plane.left * math.copysign(1, plane.rotation)
    radius = plane.speed / abs(plane.rotation)

    def current(level: complex, omega: float) -> tuple[Complex, Complex]:
        phase = 1j * omega / plane.speed * plane.along
        there = np.exp(-across / radius - phase)
        back = np.exp(-(width - across) / radius + phase)
        return level * plane.ratio * (there - back), 0 * phase

    return plane.atlas(current, (across >= 0) & (across <= width))


class _Plane:
    """A grid on the plane that touches the globe at the origin, and what waves on it share."""

    def __init__(
        self,
        longitude: ArrayLike,
        latitude: ArrayLike,
        levels: Mapping[str, complex] | None,
        depth: float,
        heading: float,
        origin: tuple[float, float] | None,
    ) -> None:
        _positive("depth", depth)
        self.longitude = np.asarray(longitude, dtype=float)
        self.latitude = np.asarray(latitude, dtype=float)
        self.levels = {"M2": 1.0} if levels is None else dict(levels)
        self.depth = depth
        self.speed = math.sqrt(_GRAVITY * depth)
        self.ratio = math.sqrt(_GRAVITY / depth)
        for name, axis in (("longitude", self.longitude), ("latitude", self.latitude)):
            if axis.ndim != 1 or not axis.size:
                raise ScenarioError(f"{name}: shape {axis.shape} is not accepted; give an axis")
        middle = origin or (self.longitude.mean(), self.latitude.mean())
        self.rotation = 2 * _EARTH_ROTATION * math.sin(math.radians(middle[1]))
        if self.rotation == 0:
            raise ScenarioError("origin: the equator is not accepted, the wave needs rotation")
        x = _metres(self.longitude - middle[0]) * math.cos(math.radians(middle[1]))
        y = _metres(self.latitude - middle[1])[:, None]
        self.ahead = np.array([math.sin(math.radians(heading)), math.cos(math.radians(heading))])
        self.along = self.ahead[0] * x + self.ahead[1] * y
        self.left = -self.ahead[1] * x + self.ahead[0] * y

    def atlas(
        self,
        current: Callable[[complex, float], tuple[Complex, Complex]],
        sea: NDArray[np.bool_] | None = None,
    ) -> TidalAtlas:
        """Atlas of the current along the heading and to its left that belongs to each level."""
        names = _checked_constituents(self.levels)
        pairs = zip(self.levels.values(), _frequency(names), strict=True)
        along, left = (np.array(part) for part in zip(*(current(*p) for p in pairs), strict=True))
        land = False if sea is None else ~sea
        return _atlas(
            names,
            self.longitude,
            self.latitude,
            np.where(land, np.nan, self.ahead[0] * along - self.ahead[1] * left),
            np.where(land, np.nan, self.ahead[1] * along + self.ahead[0] * left),
        )


def _atlas(
    names: Sequence[str], longitude: Float, latitude: Float, u: Complex, v: Complex
) -> TidalAtlas:
    import xarray as xr

    coordinates = {"constituent": list(names), "latitude": latitude, "longitude": longitude}
    return TidalAtlas(xr.Dataset({"u": (_DIMS, u), "v": (_DIMS, v)}, coordinates))


def _metres(degrees: Float) -> Float:
    return np.asarray(RADIUS_M * np.radians(degrees))


def _positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ScenarioError(f"{name}: {value!r} is not accepted; give a number of metres above 0")


# Level at Belle-Île: amplitude [m] and Greenwich phase lag [degrees].
_BISCAY_LEVELS = {"M2": (1.60, 99.0), "S2": (0.59, 132.0), "N2": (0.33, 80.0)}
_BELLE_ILE_LATITUDE = 47.3
_SHELF_DEPTH, _OCEAN_DEPTH = 110.0, 4500.0  # m
_SLOPE_WIDTH, _COAST_WIDTH = 20e3, 20e3  # m


def biscay(step: float = 0.125) -> TidalAtlas:
    """Return an idealised tide of the Bay of Biscay: M2, S2 and N2, 10° W to 0°, 43 to 50° N.

    **This is no tide atlas.** It is a formula, equation (34), whose currents have realistic sizes
    and phases for examples and trials: do not forecast a real drift with it. A Kelvin wave of the
    deep ocean runs northward along a smooth coast (roughly the French one) over a shelf (roughly
    its own: 60 km wide in the south, 200 km in the north, 110 m deep), and the shelf is filled and
    emptied from the ocean, which sets its currents (Clarke & Battisti 1981; for this shelf Le Cann
    1990). Those of M2 are 5–8 cm/s in the deep ocean and 0.1–0.24 m/s on the outer shelf; levels
    at Belle-Île are 1.60 m (M2), 0.59 m (S2) and 0.33 m (N2), from a hindcast. The field is
    smooth and goes on over the land, so that any coast can be laid over it. Neither the Spanish
    coast nor the Channel is in it.

    Parameters
    ----------
    step : float
        Spacing of the grid [degrees], 0.1 to 0.25 (the edge of the shelf is 20 km wide).

    Raises
    ------
    ScenarioError
        The step is outside 0.1 to 0.25, or does not divide 7° and 10°.
    """
    rows, columns = round(7 / step) if step else 0, round(10 / step) if step else 0
    if not (
        0.1 <= step <= 0.25 and math.isclose(rows * step, 7) and math.isclose(columns * step, 10)
    ):
        raise ScenarioError(
            f"step: {step!r} is not accepted; it is 0.1 to 0.25 and divides 1, such as 0.125"
        )
    longitude = np.linspace(-10, 0, columns + 1)
    latitude = np.linspace(43, 50, rows + 1)
    y = latitude[:, None]
    coast = -1.2 - 1.9 * (1 + np.tanh(y - 47.2))
    shelf = 60e3 + 70e3 * (1 + np.tanh((y - 45.3) / 0.7))
    west = _metres(coast - longitude) * np.cos(np.radians(y))
    # The distance from the coast, smoothly zero behind it.
    offshore = (west + np.hypot(west, _COAST_WIDTH)) / 2
    # Share of the water column that is not there, 1 − H/H₀, and its integral from the coast.
    steepness = (offshore - shelf) / _SLOPE_WIDTH
    missing = (1 - _SHELF_DEPTH / _OCEAN_DEPTH) * (1 - np.tanh(steepness)) / 2
    filled = (
        (1 - _SHELF_DEPTH / _OCEAN_DEPTH)
        / 2
        * (offshore - _SLOPE_WIDTH * np.log(np.cosh(steepness) / np.cosh(shelf / _SLOPE_WIDTH)))
    )
    speed = math.sqrt(_GRAVITY * _OCEAN_DEPTH)
    rotation = 2 * _EARTH_ROTATION * math.sin(math.radians(_BELLE_ILE_LATITUDE))
    names = list(_BISCAY_LEVELS)
    u, v = [], []
    for name, omega in zip(names, _frequency(names), strict=True):
        amplitude, lag = _BISCAY_LEVELS[name]
        level = amplitude * np.exp(
            -1j * math.radians(lag)
            - rotation * offshore / speed
            - 1j * omega / speed * _metres(y - _BELLE_ILE_LATITUDE)
        )
        u.append(1j * omega * level * filled / (_OCEAN_DEPTH * (1 - missing)))
        v.append(level * math.sqrt(_GRAVITY / _OCEAN_DEPTH))
    return _atlas(names, longitude, latitude, np.array(u), np.array(v))
