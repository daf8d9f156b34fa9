"""A tidal atlas, and the current that it predicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from driftcore.errors import ScenarioError
from driftcore.tides.axes import checked_axis, neighbours, region_indices, turned
from driftcore.tides.constituents import (
    Complex,
    Float,
    arguments,
    checked_constituents,
    checked_times,
    frequency_of,
    species_of,
)

if TYPE_CHECKING:
    import xarray as xr

DIMS = ("constituent", "latitude", "longitude")


@dataclass(frozen=True, eq=False)
class TidalAtlas:
    """Complex tidal currents by constituent on a regular grid of longitude and latitude.

    The convention is that of `driftcore.tides`. Constituents of long period (species 0) are
    refused: a current that changes over days belongs to the residual current.

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
        nodal, _ = arguments(names, np.atleast_1d(checked_times("time", time)))
        _, equilibrium = arguments(names, np.atleast_1d(checked_times("reference", reference)))
        return xr.Dataset(
            {
                "frequency": ("constituent", frequency_of(names), {"units": "rad s-1"}),
                "species": ("constituent", species_of(names), {"units": "1"}),
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
        moments = checked_times("times", times)
        u, v = (self.dataset[name].values for name in "uv")
        rows, columns = (
            neighbours(name, self.dataset[name].values, values, method)
            for name, values in (
                ("latitude", np.asarray(latitude, dtype=float)),
                ("longitude", turned(np.asarray(longitude, dtype=float), self.longitude)),
            )
        )
        shape = np.broadcast_shapes(moments.shape, rows[0][0].shape, columns[0][0].shape)
        nodal, equilibrium = arguments(self.constituents, moments.ravel())
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
        rows, columns, eastward = region_indices(
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

        speed = self._largest()
        area = xr.zeros_like(self.dataset["latitude"]) + np.cos(np.radians(self.latitude))
        over = ("latitude", "longitude")
        scales = xr.Dataset({"maximum": speed.max(over), "mean": speed.weighted(area).mean(over)})
        for variable in scales.values():
            variable.attrs["units"] = "m s-1"
        return scales

    def _largest(self) -> xr.DataArray:
        """Largest current over a tide at each place [m/s]."""
        u, v = self.dataset["u"], self.dataset["v"]
        # They add up to two rotating vectors; where these meet, the current is largest.
        return (abs(u + 1j * v) + abs(u - 1j * v)) / 2

    def __repr__(self) -> str:
        maximum = self._largest().max(("latitude", "longitude")).to_series().nlargest(4)
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
        if set(dataset[name].dims) != set(DIMS):
            raise ScenarioError(
                f"{name}: dimensions {dataset[name].dims} are not accepted; it needs {DIMS}"
            )
        if dataset[name].dtype.kind != "c":
            raise ScenarioError(
                f"{name}: values of type {dataset[name].dtype} are not accepted; they must be "
                "complex, amplitude · exp(−i · Greenwich phase lag)"
            )
    for name in DIMS:
        if name not in dataset.coords:
            raise ScenarioError(f"dataset: dimension {name!r} has no coordinate")
    names = checked_constituents(dataset["constituent"].values)
    checked = dataset[["u", "v"]].transpose(*DIMS).astype(complex)
    checked = checked.assign_coords(constituent=names)
    for name in ("latitude", "longitude"):
        checked_axis(name, checked[name].values)
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


def atlas_of(
    names: Sequence[str], longitude: Float, latitude: Float, u: Complex, v: Complex
) -> TidalAtlas:
    """Make an atlas of complex currents, (constituent, latitude, longitude), by arrays."""
    import xarray as xr

    coordinates = {"constituent": list(names), "latitude": latitude, "longitude": longitude}
    return TidalAtlas(xr.Dataset({"u": (DIMS, u), "v": (DIMS, v)}, coordinates))
