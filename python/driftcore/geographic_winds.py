"""Winds of an ensemble on the real sea, uniform or varying in space, for the compiled core."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from driftcore import _core
from driftcore.ensemble_winds import Resampled, substeps_of
from driftcore.errors import ScenarioError, warn
from driftcore.grids import VectorGrid
from driftcore.hand_over import HandOver
from driftcore.record import WindRecord, phase_of_day
from driftcore.sea import spline_axis, spline_coefficients
from driftcore.wind import LocalGridBootstrap, WindPath
from driftcore.wind_fields import FieldBootstrap

if TYPE_CHECKING:
    from driftcore.geographic import GeographicScenario

    GeographicWind = (
        LocalGridBootstrap | HandOver | FieldBootstrap | VectorGrid | Sequence[WindPath]
    )

Floats = NDArray[np.float64]


class Winds(Protocol):
    """What gives each chunk of members its wind."""

    members: int | None
    """Number of members that there are winds for; any, if None."""

    def core(self, first: int, count: int) -> Any:
        """Winds of the members `first` … `first + count - 1`, for the compiled core."""

    def attributes(self) -> dict[str, Any]:
        """Attributes that tell a reader where the wind is from."""


def winds_of(
    scenario: GeographicScenario, wind: GeographicWind | None, solver: _core.Solver, seed: int
) -> Winds:
    """Give the winds of an ensemble.

    Raises
    ------
    ScenarioError
        It is none of the winds known, or does not cover the run.
    """
    if wind is None:
        raise ScenarioError("wind: is missing; the real sea needs a wind of its own")
    if isinstance(wind, LocalGridBootstrap):
        return _Uniform(scenario, wind, solver, seed)
    if isinstance(wind, HandOver):
        return _HandedOver(scenario, wind, solver, seed)
    if isinstance(wind, FieldBootstrap):
        return _Fields(scenario, wind, seed)
    if isinstance(wind, VectorGrid):
        return _Grid(scenario, wind)
    if isinstance(wind, Sequence) and len(wind) and all(isinstance(w, WindPath) for w in wind):
        return _Paths(scenario, wind)
    raise ScenarioError(
        f"wind: {type(wind).__name__} is not accepted; a fitted LocalGridBootstrap or "
        "FieldBootstrap, a HandOver, a VectorGrid of winds, or a list of WindPath with datetime64 "
        "times"
    )


class _Uniform:
    """Drawn by a bootstrap, uniform in space."""

    members: int | None = None

    def __init__(
        self,
        scenario: GeographicScenario,
        wind: LocalGridBootstrap,
        solver: _core.Solver,
        seed: int,
    ) -> None:
        phase = _phase(wind.record, scenario)
        self.resampled = Resampled(scenario, wind, solver, seed, phase)
        self.resampled.warn()

    def core(self, first: int, count: int) -> Any:
        del first, count  # drawn by (seed, member)
        return self.resampled.core

    def attributes(self) -> dict[str, Any]:
        return self.resampled.attributes()


class _HandedOver:
    """A forecast first, then drawn by a bootstrap; uniform in space."""

    members: int | None = None

    def __init__(
        self, scenario: GeographicScenario, wind: HandOver, solver: _core.Solver, seed: int
    ) -> None:
        wind.require(scenario.start)
        climatology, origin = wind.climatology, scenario.origin
        phase = _phase(climatology.record, scenario)
        self.wind = wind
        self.resampled = Resampled(
            scenario, climatology, solver, seed, phase, lambda steps: wind.core(origin, steps)
        )
        self.resampled.warn()

    def core(self, first: int, count: int) -> Any:
        del first, count  # drawn by (seed, member)
        return self.resampled.core

    def attributes(self) -> dict[str, Any]:
        return {**self.resampled.attributes(), "wind_forecast": self.wind.describe()}


class _Paths:
    """Given one by one, uniform in space."""

    def __init__(self, scenario: GeographicScenario, paths: Sequence[WindPath]) -> None:
        self.members: int | None = len(paths)
        self.paths = [core_path(scenario, path) for path in paths]

    def core(self, first: int, count: int) -> Any:
        del first, count  # known by the member's number
        return self.paths

    def attributes(self) -> dict[str, Any]:
        return {"wind_label": f"{self.members} wind paths given in Python"}


class _Patterns:
    """Patterns in the coordinates of a run."""

    def __init__(
        self, scenario: GeographicScenario, longitude: Floats, latitude: Floats, patterns: Floats
    ) -> None:
        """`patterns` has the shape (pattern, component, latitude, longitude)."""
        x, y = scenario.offsets(longitude), latitude - scenario.reference[1]
        west, east, south, north = scenario.domain
        if x[0] > 0 or x[-1] < 0 or y[0] > 0 or y[-1] < 0:
            raise ScenarioError(
                f"wind: its grid covers longitudes {longitude[0]:g} to {longitude[-1]:g}, "
                f"latitudes {latitude[0]:g} to {latitude[-1]:g}, and not the release"
            )
        has_sea = scenario.tides is not None or scenario.current is not None
        if has_sea and (x[0] > west or x[-1] < east or y[0] > south or y[-1] < north):
            warn(
                "the wind's grid does not cover that of the sea: who leaves it has left the domain"
            )
        self.axes: list[Any] = [spline_axis("longitude", x), spline_axis("latitude", y)]
        values = patterns.transpose(2, 3, 0, 1)
        for dimension in range(2):
            values = spline_coefficients(values, dimension)
        self.coefficients = np.ascontiguousarray(values)

    def winds(
        self,
        times: tuple[float, float],
        first: int,
        amplitudes: Floats,
        small_scale: tuple[float, float, int, int] | None = None,
    ) -> _core.FieldWinds:
        amplitudes = np.ascontiguousarray(amplitudes)
        return _core.FieldWinds(self.axes, self.coefficients, times, first, amplitudes, small_scale)


class _Grid:
    """One wind for all members, given on a grid: a forecast."""

    members: int | None = None

    def __init__(self, scenario: GeographicScenario, grid: VectorGrid) -> None:
        if grid.kind != "wind":
            raise ScenarioError(f"wind: a {grid.kind} is not accepted; read it as a wind")
        if not (np.isfinite(grid.u).all() and np.isfinite(grid.v).all()):
            raise ScenarioError("wind: it has missing values; give a region and period without")
        times = scenario.since_origin(grid.times)
        start, end = float(scenario.since_origin(scenario.start)), scenario.duration
        step = float(times[-1] - times[0]) / max(1, len(times) - 1)
        regular = times[0] + step * np.arange(len(times))
        if len(times) < 2 or np.abs(times - regular).max() > 1e-6 * step:
            raise ScenarioError("wind: its times are not regular; at least two, equally spaced")
        if times[0] > start + 1e-9 or times[-1] < end - 1e-9:
            raise ScenarioError(
                f"wind: it covers {grid.times[0]} to {grid.times[-1]}; the run needs "
                f"{scenario.start} to {scenario.end}"
            )
        # Each time is a pattern of its own.
        fields = np.stack([grid.u, grid.v], axis=1)
        patterns = _Patterns(scenario, grid.longitude, grid.latitude, fields)
        self.winds = patterns.winds((float(times[0]), step), 0, np.eye(len(times))[None])
        self.label = grid.describe()

    def core(self, first: int, count: int) -> Any:
        del first, count  # one for all
        return self.winds

    def attributes(self) -> dict[str, Any]:
        return {"wind_label": self.label}


class _Fields:
    """Drawn by a bootstrap of whole fields."""

    members: int | None = None

    def __init__(self, scenario: GeographicScenario, wind: FieldBootstrap, seed: int) -> None:
        record = wind.gridded.record
        self.wind, self.seed = wind, seed
        self.step = record.step_h / 24
        self.phase = _phase(record, scenario)
        self.steps = math.ceil(scenario.duration / self.step - 1e-9) + 1
        substeps = substeps_of(self.step, scenario.period)
        self.small_scale = (
            (wind.small_scale_sd, wind.bootstrap.memory_h / 24, substeps, seed)
            if wind.small_scale_sd > 0
            else None
        )
        gridded = wind.gridded
        fields = np.concatenate([gridded.cycle, wind.patterns])
        self.patterns = _Patterns(scenario, gridded.longitude, gridded.latitude, fields)

    def core(self, first: int, count: int) -> Any:
        sample = self.wind.sample(
            count, self.steps, self.seed, first_member=first, phase=self.phase
        )
        of_cycle = np.eye(len(self.wind.gridded.cycle))[sample.phase]
        amplitudes = np.concatenate([of_cycle, sample.components], axis=2)
        return self.patterns.winds((0.0, self.step), first, amplitudes, self.small_scale)

    def attributes(self) -> dict[str, Any]:
        record = self.wind.gridded.record
        return {"wind_label": record.label, "wind_sha256": record.sha256}


def core_path(scenario: GeographicScenario, path: WindPath) -> _core.WindPath:
    """Give a path of UTC times in the time of the run.

    Raises
    ------
    ScenarioError
        It is no path, or its times are numbers.
    """
    if not isinstance(path, WindPath):
        raise ScenarioError(f"path: {type(path).__name__} is not accepted; give a WindPath")
    if path.instants is None:
        raise ScenarioError("path: its times are numbers; a geographic scenario needs datetime64")
    first, last = path.instants[[0, -1]]
    if first > scenario.start or last < scenario.end:
        raise ScenarioError(
            f"path: it covers {first} to {last}; the run needs {scenario.start} to {scenario.end}"
        )
    return _core.WindPath(scenario.since_origin(path.instants), path.velocity)


def _phase(record: WindRecord, scenario: GeographicScenario) -> int:
    """Give the phase of the mean cycle of a wind at the origin of a run."""
    month = int(scenario.start.astype("datetime64[M]").astype(int)) % 12 + 1
    if month not in record.months:
        warn(
            f"the run starts in month {month}, the wind was resampled from months "
            f"{', '.join(map(str, record.months))}"
        )
    return phase_of_day(record, scenario.origin)
