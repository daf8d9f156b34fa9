"""Tidal atlases read from NetCDF files."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from driftcore.errors import RecordError, ScenarioError, reading, warn
from driftcore.netcdf import open_netcdf
from driftcore.record import listed
from driftcore.tides.atlas import DIMS, TidalAtlas
from driftcore.tides.axes import Region, checked_axis, region_indices, step_of, turned
from driftcore.tides.constituents import (
    Float,
    checked_constituents,
    is_known,
    pytmd,
    refuse_unknown,
    species_of,
    standard_name,
)
from driftcore.tides.units import TRANSPORTS, VELOCITIES, plain_unit

if TYPE_CHECKING:
    import xarray as xr

Source: TypeAlias = "str | PathLike[str] | xr.Dataset"

# The strongest tidal currents of the world's straits run at about 10 m/s.
_FASTEST = 15.0


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
    pytmd()
    for role in names or {}:
        if role not in (*_ROLES, *_AXES):
            raise ScenarioError(f"names: {role!r} is not accepted; use {listed((*_ROLES, *_AXES))}")
    wanted = None if constituents is None else checked_constituents(constituents)
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
        warn(
            f"constituents of long period are left out: {listed(sorted(reader.long_periods))}; "
            "they belong to the residual current"
        )
    return TidalAtlas(atlas) if region is None else TidalAtlas(atlas).sel_region(*region)


def _opened(
    source: Source | Sequence[Source] | Mapping[str, Source | Sequence[Source]], stack: ExitStack
) -> Iterator[tuple[str, str | None, xr.Dataset]]:
    """Label, constituent (where the mapping or the file name tells) and content of each file."""
    import xarray as xr

    groups: list[tuple[str | None, Any]]
    if isinstance(source, Mapping) and not isinstance(source, xr.Dataset):
        groups = [(checked_constituents([name])[0], item) for name, item in source.items()]
    else:
        groups = [(None, source)]
    for name, group in groups:
        alone = isinstance(group, str | PathLike | xr.Dataset)
        for item in [group] if alone else group:
            if isinstance(item, xr.Dataset):
                yield "source", name, item
                continue
            path = Path(fspath(item))
            words = [standard_name(word) for word in re.split(r"[\W_]+", path.stem)]
            told = {word for word in words if is_known(word)}
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
                checked_axis(role, values, tolerance=0.02)
            except ScenarioError as error:
                raise RecordError(f"{label}: {error}") from error
            axes[role] = np.linspace(values[0], values[-1], len(values))
        if self.region is not None:
            # One step more, since a staggered grid loses one.
            kept, across, eastward = region_indices(
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
        refuse_unknown(names)
        species = species_of(names)
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
        return field.transpose(*DIMS).astype(float).compute()

    def _velocity_factor(self, label: str, dataset: xr.Dataset, variable: str) -> float:
        """Tell what brings the values to m/s (transports to m²/s)."""
        stated = self.units or dataset[variable].attrs.get("units")
        accepted = {**VELOCITIES, **TRANSPORTS}
        if stated is None:
            raise RecordError(
                f"{label}: {variable!r} states no units; state them with units=, one of "
                f"{listed(accepted)}"
            )
        unit = plain_unit(str(stated))
        if unit not in accepted:
            raise RecordError(
                f"{label}: units {stated!r} of {variable!r} are not accepted; state them with "
                f"units=, one of {listed(accepted)}"
            )
        self.transport |= unit in TRANSPORTS
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
            warn(
                f"{label}: no phase in {variable!r} is above {largest:.3g}°; if they are radians, "
                'say phase_units="radians"'
            )
        return phase * _ANGLES[unit]


def _labels(label: str, labels: xr.DataArray | None, dim: str, size: int) -> list[str | None]:
    """Names of the constituents along a dimension."""
    if labels is not None:
        values = labels.values
        if values.dtype.kind in "SU" and values.ndim == 2:  # characters
            return [standard_name(b"".join(row.astype("S1"))) for row in values]
        if values.ndim == 1 and values.dtype.kind in "OSUT":
            return [standard_name(value) for value in values]
        meanings = str(labels.attrs.get("flag_meanings", "")).split()
        flags = np.atleast_1d(labels.attrs.get("flag_values", np.arange(len(meanings)))).tolist()
        if values.ndim == 1 and set(values.tolist()) <= set(flags) and meanings:
            return [standard_name(meanings[flags.index(value)]) for value in values.tolist()]
    raise RecordError(
        f"{label}: the {size} constituents along {dim!r} have no names; give them with "
        f'dataset.assign_coords(constituent=("{dim}", ["M2", …]))'
    )


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
            "longitude": turned(atlas["longitude"].values, depth["longitude"].values),
        }
        depth = depth.interp(places).assign_coords(longitude=atlas["longitude"])
        atlas = atlas / depth.where(depth > 0)
    if not bool(atlas["u"].notnull().any()):
        raise RecordError("source: has no value that is neither missing nor zero; all is land")
    return atlas


def _within(name: str, inner: Float, outer: Float) -> Float:
    """Points of one axis of a staggered grid that lie between points of the other."""
    step = step_of(outer)
    between = np.mod((inner - outer[0]) / step, 1)
    kept = inner[(inner >= outer[0]) & (inner <= outer[-1])]
    if len(kept) < 2 or abs(step_of(inner) / step - 1) > 0.01 or abs(between - 0.5).max() > 0.1:
        raise RecordError(
            f"source: the {name} axes of u and v are no staggered grid; give one grid"
        )
    return np.asarray(kept)
