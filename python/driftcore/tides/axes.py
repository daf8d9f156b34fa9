"""Regular axes of longitude and latitude: checked, looked up, cut to a region."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from driftcore.errors import ScenarioError

Float: TypeAlias = NDArray[np.float64]
Region: TypeAlias = tuple[float, float, float, float]


def checked_axis(name: str, values: NDArray[Any], tolerance: float = 1e-6) -> None:
    """Refuse an axis that is not regular and increasing, up to a share of its step."""
    steps = np.diff(np.asarray(values, dtype=float))
    # One point stands alone; of two or more, no step differs from the others.
    if len(steps) and not (steps.min() > 0 and np.ptp(steps) <= tolerance * steps.mean()):
        raise ScenarioError(
            f"{name}: steps from {steps.min():g} to {steps.max():g} are not accepted; the axis "
            "must be regular and increasing"
        )


def turned(values: Float, axis: Float) -> Float:
    """Longitudes, each by the turns that bring it nearest to the middle of an axis."""
    start = (axis[0] + axis[-1]) / 2 - 180
    return np.asarray(start + np.mod(values - start, 360))


def neighbours(
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


def region_indices(
    latitude: Float, longitude: Float, region: Region, steps: int = 1
) -> tuple[NDArray[np.int64], NDArray[np.int64], Float]:
    """Rows and columns less than some steps outside a region, and the columns' longitudes."""
    west, east, south, north = region
    if not (west < east <= west + 360 and south < north):
        raise ScenarioError(
            f"region: {region} is not accepted; give (west, east, south, north) with west < east "
            "≤ west + 360 and south < north"
        )
    margin = steps * step_of(latitude)
    rows = np.flatnonzero((latitude > south - margin) & (latitude < north + margin))
    margin = min(steps * step_of(longitude), (360 - (east - west)) / 2 + 1e-6)
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


def step_of(axis: Float) -> float:
    """Give the step of a regular axis; of one point alone next to nothing."""
    return float(axis[-1] - axis[0]) / (len(axis) - 1) if len(axis) > 1 else 1e-6
