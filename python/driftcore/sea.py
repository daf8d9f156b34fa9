"""What the sea is made of: the paper's academic fields, or harmonics on a grid."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from driftcore.configuration import Configuration
from driftcore.errors import ScenarioError

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    from driftcore import _core

Pair = tuple[float, float]


class SeparableCurrent(Configuration):
    """One part of the academic sea, paper section 4.1.

    `x_axis · (mean + modulation · wave(2π · cycles · t)) · Σ_j s_j sin(2πjθ)`.
    """

    mean: float = Field(default=2.0, description="mean strength")
    modulation: float = Field(default=1.0, description="strength of the slow modulation")
    wave: Literal["sin", "cos"] = Field(default="sin", description="shape of the slow modulation")
    cycles: float = Field(default=3.0, description="cycles of the modulation per unit of time")
    proportional_to: Literal["x", "y"] = Field(
        default="x", description="component of the position that the current grows with"
    )
    harmonics: Annotated[tuple[Pair, ...], Field(min_length=1)] = Field(
        default=((1.0, 0.5), (0.25, 0.0)), description="sine amplitudes (x, y) of harmonics 1, 2, …"
    )

    def _arguments(self) -> tuple[tuple[float, float, float, float, int], NDArray[np.float64]]:
        phase = 0.0 if self.wave == "sin" else math.pi / 2
        axis = "xy".index(self.proportional_to)
        numbers = (self.mean, self.modulation, self.cycles, phase, axis)
        return numbers, np.array(self.harmonics, dtype=float)


class AcademicSea(Configuration):
    """The sea of the paper's experiments: tide `M` and residual current `N`, `m = M + εN`."""

    kind: Literal["academic"] = "academic"
    tide: SeparableCurrent = Field(default=SeparableCurrent(), description="M")
    residual: SeparableCurrent = Field(
        default=SeparableCurrent(wave="cos", proportional_to="y", harmonics=((1.0, 1.0),)),
        description="N, multiplied by epsilon",
    )

    def core(self, period: float, epsilon: float, duration: float) -> _core.Sea:
        """Build the compiled field; `period` and `duration` in scenario time."""
        from driftcore import _core

        del duration  # analytic: no end in time
        return _core.Sea.academic(
            period, self.tide._arguments(), self.residual._arguments(), epsilon
        )


class HarmonicSea:
    """A sea from harmonics of the tidal phase on a regular grid.

    `M = Σ_j Re[Z_j e^{2πijθ}]`, `N = N_0 + Σ_j Re[N_j e^{2πijθ}]`, `m = M + εN`
    (docs/equations.md (3)). Between grid points the amplitudes are cubic splines (not-a-knot), so
    that their gradients and second derivatives are continuous.

    Parameters
    ----------
    Z : xarray.DataArray
        Complex amplitudes, dims (harmonic, component, y, x) or (harmonic, component, time, y, x)
        in any order, with coordinates: harmonic 1…J, component "x", "y", regular increasing time,
        y and x in scenario units.
    N : xarray.DataArray, optional
        The same on the same grid, harmonic from 0 (the mean, real) upward.

    Raises
    ------
    ScenarioError
        A dimension or coordinate is missing, an axis is irregular or shorter than 4 points, or a
        value is not finite.
    """

    def __init__(self, Z: xr.DataArray, N: xr.DataArray | None = None) -> None:  # noqa: N803 (the equations' letters)
        import xarray as xr

        self._tide = _arranged("Z", Z, first_harmonic=1)
        if N is None:
            mean = xr.zeros_like(self._tide.isel(harmonic=slice(0, 1)))
            N = mean.assign_coords(harmonic=[0])  # noqa: N806
        self._residual = _arranged("N", N, first_harmonic=0)
        for axis in ("time", "y", "x"):
            if not np.array_equal(self._tide[axis], self._residual[axis]):
                raise ScenarioError(f"N: its {axis} axis differs from that of Z; give one grid")
        self._axes = [spline_axis(axis, self._tide[axis].values) for axis in ("x", "y", "time")]

    def core(self, period: float, epsilon: float, duration: float) -> _core.Sea:
        """Build the compiled field; `period` and `duration` in scenario time."""
        from driftcore import _core

        start, step, count = self._axes[2]
        slack = 1e-9 * duration
        end = start + (count - 1) * step
        if count > 1 and not (start <= slack and end >= duration - slack):
            raise ScenarioError(
                f"Z: its time axis covers [{start:g}, {end:g}]; the run needs [0, {duration:g}]"
            )
        fields = [self._tide, epsilon * self._residual]
        channels = [
            field.stack(channel=("harmonic", "component")).transpose("time", "y", "x", "channel")
            for field in fields
        ]
        coefficients = np.concatenate([c.values for c in channels], axis=-1)
        for dimension in range(3):
            coefficients = spline_coefficients(coefficients, dimension)
        return _core.Sea.gridded(
            period, self._axes, self._tide.sizes["harmonic"], np.ascontiguousarray(coefficients)
        )

    def __repr__(self) -> str:
        sizes = self._tide.sizes
        return (
            f"HarmonicSea({sizes['harmonic']} tide harmonics on {sizes['y']} × {sizes['x']} "
            f"points, {sizes['time']} times)"
        )


def _arranged(name: str, field: xr.DataArray, first_harmonic: int) -> xr.DataArray:
    if "time" not in field.dims:
        field = field.expand_dims(time=[0.0])
    expected = {"harmonic", "component", "time", "y", "x"}
    if set(field.dims) != expected:
        raise ScenarioError(
            f"{name}: dimensions {tuple(field.dims)} are not accepted; "
            f"it needs harmonic, component, y, x and, if it changes slowly, time"
        )
    for dimension in expected:
        if dimension not in field.coords:
            raise ScenarioError(f"{name}: dimension {dimension} has no coordinate")
    numbers = list(range(first_harmonic, first_harmonic + field.sizes["harmonic"]))
    if field["harmonic"].values.tolist() != numbers:
        found = field["harmonic"].values.tolist()
        raise ScenarioError(f"{name}: harmonics {found} are not accepted; expected {numbers}")
    if field["component"].values.tolist() != ["x", "y"]:
        raise ScenarioError(f'{name}: components must be "x", "y"')
    field = field.transpose("harmonic", "component", "time", "y", "x").astype(complex)
    if not np.isfinite(field.values).all():
        raise ScenarioError(f"{name}: holds values that are not finite; fill them first")
    return field


def spline_axis(name: str, values: NDArray[Any]) -> tuple[float, float, int]:
    """Give start, step and number of points of a regular axis.

    Raises
    ------
    ScenarioError
        It is not regular, or has 2 or 3 points.
    """
    count = len(values)
    if count == 1:
        return float(values[0]), 1.0, 1
    steps = np.diff(values.astype(float))
    if count < 4 or (steps <= 0).any() or np.ptp(steps) > 1e-6 * abs(steps[0]):
        raise ScenarioError(
            f"{name} axis: {count} points are not accepted; it must be regular and increasing, "
            "with 1 point or at least 4"
        )
    return float(values[0]), float(values[-1] - values[0]) / (count - 1), count


def spline_coefficients(values: NDArray[Any], axis: int) -> NDArray[Any]:
    """Coefficients of the uniform cubic B-spline through `values` along `axis`, not-a-knot.

    `n` values give `n + 2` coefficients; one value is its own coefficient.
    """
    count = values.shape[axis]
    if count == 1:
        return values
    matrix = np.zeros((count + 2, count + 2))
    rows = np.arange(count)
    for offset, weight in enumerate((1 / 6, 4 / 6, 1 / 6)):
        matrix[rows, rows + offset] = weight
    # The third derivative does not jump at the second and the last but one point.
    matrix[count, :5] = matrix[count + 1, -5:] = (1, -4, 6, -4, 1)
    shape = list(values.shape)
    shape[axis] = 2
    right = np.concatenate([values, np.zeros(shape, dtype=values.dtype)], axis=axis)
    solved = np.linalg.solve(matrix, np.moveaxis(right, axis, 0).reshape(count + 2, -1))
    shape[axis] = count + 2
    moved = [shape[axis], *(n for k, n in enumerate(shape) if k != axis)]
    return np.moveaxis(solved.reshape(moved), 0, axis)
