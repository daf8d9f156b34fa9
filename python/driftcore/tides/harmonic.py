"""Harmonic analysis: the tide in a current, by least squares."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from driftcore.errors import RecordError, ScenarioError, warn
from driftcore.record import listed
from driftcore.tides.atlas import DIMS, TidalAtlas
from driftcore.tides.axes import checked_axis
from driftcore.tides.constituents import (
    RANKED,
    Complex,
    Float,
    Times,
    arguments,
    checked_constituents,
    checked_times,
    frequency_of,
)
from driftcore.tides.units import VELOCITIES, plain_unit

if TYPE_CHECKING:
    import xarray as xr

# A normal matrix per value with a smaller eigenvalue (0.5 when all is well separated) makes
# standard errors more than seven times as large as they need be: the gaps hide a constituent.
_LEAST_EIGENVALUE = 0.01
_PLACES_AT_ONCE = 512  # bounds the memory of a fit


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
    asked = None if constituents is None else checked_constituents(constituents)
    current = _checked_current(dataset)
    times = current["time"].values
    names = _told_apart(times, asked, minimum_rayleigh)
    nodal, equilibrium = arguments(names, times)
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
        warn(
            f"{left_out} places with too few values, or gaps that hide a constituent, are left out"
        )

    axes = {name: current[name] for name in ("latitude", "longitude")}

    def by_constituent(u: NDArray[Any], v: NDArray[Any]) -> xr.Dataset:
        grids = {"u": u.reshape(-1, *shape), "v": v.reshape(-1, *shape)}
        return xr.Dataset(
            {name: (DIMS, grid, {"units": "m s-1"}) for name, grid in grids.items()},
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
        unit = plain_unit(str(dataset[name].attrs.get("units", "m/s")))
        if unit not in VELOCITIES:
            raise RecordError(
                f"{name}: units {dataset[name].attrs['units']!r} are not accepted; use "
                f"{listed(VELOCITIES)}"
            )
        values = np.array(current[name].transpose(*dims).values, dtype=float, order="C")
        current[name] = dims, VELOCITIES[unit] * values
        if np.isinf(current[name]).any():
            raise RecordError(f"{name}: holds infinite values; missing values are NaN")
    try:
        times = checked_times("time", current["time"].values)
        for name in ("latitude", "longitude"):
            checked_axis(name, current[name].values)
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
    candidates = list(RANKED) if asked is None else asked
    chosen: dict[str, float] = {"mean": 0.0}
    for name, frequency in zip(candidates, frequency_of(candidates), strict=True):
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
