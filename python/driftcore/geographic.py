"""What is forecast on the real sea: releases, objects, tides, currents and coasts on the sphere."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from driftcore.earth import RADIUS_M
from driftcore.errors import ScenarioError, warn
from driftcore.objects import FloatingBody, Leeway
from driftcore.releases import Release, Releases
from driftcore.times import nanoseconds

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from driftcore import _core
    from driftcore.coast import LandCoast
    from driftcore.currents import Current
    from driftcore.tides import TidalAtlas

    Floats = NDArray[np.float64]

_DAY = np.timedelta64(86_400_000_000_000, "ns")
_SECONDS_PER_DAY = 86_400.0
# Degrees a day on a great circle for each m/s: rust/src/geometry.rs.
_DEGREES = math.degrees(_SECONDS_PER_DAY / RADIUS_M)
# The principal lunar tide, where a scenario has none: it still says how long a step may be.
_M2_DAYS = 0.517525
# Beyond these the ordering that averaging needs is in doubt.
_LARGEST_EPSILON = 0.1
_LARGEST_STEEPNESS = 0.2
# Days beyond the run that the coast is kept for, so that its cut edge is out of reach.
_COAST_MARGIN = 1.0


class Scaling(NamedTuple):
    """The paper's scaling of a scenario: what averaging takes for small."""

    epsilon: float
    """Tide period over the run."""
    tide: float
    """Largest tidal current [m/s]."""
    residual: float
    """Largest residual current [m/s]."""
    excursion_km: float
    """Largest tidal excursion, from the middle to the end [km]."""
    steepness: float
    """Change of the tidal current over the excursion, as a share of the current."""
    unit_length_km: float
    """What the tidal current would cover in the run [km]."""

    def problems(self) -> list[str]:
        """Say what is not small."""
        found = []
        if self.tide and self.epsilon > _LARGEST_EPSILON:
            found.append(f"epsilon = {self.epsilon:.2g} (a tide over the run)")
        if self.steepness > _LARGEST_STEEPNESS:
            found.append(
                f"the tidal current changes by {self.steepness:.0%} over its own excursion of "
                f"{self.excursion_km:.1f} km"
            )
        if self.tide and self.residual > self.tide:
            found.append(
                f"the residual current ({self.residual:.2g} m/s) exceeds the tide "
                f"({self.tide:.2g} m/s)"
            )
        return found


@dataclass(frozen=True, eq=False)
class GeographicScenario:
    """Things adrift on the real sea, in degrees, metres per second and UTC.

    Parameters
    ----------
    release : Release or Releases
        Where and when.
    days : float
        Length of the run, from the earliest release on [d].
    drifter : FloatingBody or Leeway
        What is adrift.
    tides : TidalAtlas, optional
        Tidal currents.
    current : Current, optional
        Residual current; it must cover the run, or be a mean of one time.
    coast : LandCoast, optional
        Where it may strand; nowhere if absent.
    wind_current : tuple of float
        Surface current that the wind drives, as a share of the wind's speed, and its angle to the
        right of the wind [degrees]: the wind-driven part of the paper's N.
    name : str
        A name for people.

    Raises
    ------
    ScenarioError
        A value is not accepted, the grids do not cover the release, or it lies on land.
    """

    release: Release | Releases
    days: float
    drifter: FloatingBody | Leeway
    tides: TidalAtlas | None = None
    current: Current | None = None
    coast: LandCoast | None = None
    wind_current: tuple[float, float] = (0.0, 0.0)
    name: str = "drift"
    wind_unit: float = field(default=1.0, init=False)
    hours_per_unit: float = field(default=24.0, init=False)

    def __post_init__(self) -> None:
        days = self.days
        if not (isinstance(days, int | float) and math.isfinite(days) and 0 < days <= 36_525):
            raise ScenarioError(f"days: {days!r} is not accepted; a number above 0, to 36525")
        if not isinstance(self.drifter, FloatingBody | Leeway):
            raise ScenarioError(
                f"drifter: {type(self.drifter).__name__} is not accepted; a FloatingBody or Leeway"
            )
        share, angle = self.wind_current
        if not (0 <= share < 1 and math.isfinite(angle)):
            raise ScenarioError(
                f"wind_current: {self.wind_current!r} is not accepted; a share of the wind from 0 "
                "to below 1, and an angle in degrees"
            )
        # Refused where it has no such time.
        _ = self.end
        places = self._relative(self._some_places)
        west, east, south, north = self.domain
        outside = (
            (places[:, 0] < west)
            | (places[:, 0] > east)
            | (places[:, 1] < south)
            | (places[:, 1] > north)
        )
        if outside.any():
            longitude, latitude = places[np.argmax(outside)] + np.array(self.reference)
            raise ScenarioError(
                f"release: ({longitude:.4f}, {latitude:.4f}) lies outside the data, which cover "
                f"longitudes {west + self.reference[0]:.2f} to {east + self.reference[0]:.2f}, "
                f"latitudes {south + self.reference[1]:.2f} to {north + self.reference[1]:.2f}"
            )
        if self.coast is not None:
            self.coast.around(self.reference[0]).check_afloat(places + np.array(self.reference))
        if self.current is not None and len(self.current.times) > 1:
            first, last = self.current.times[[0, -1]]
            # An uncertain time may be before the start, but never before the origin.
            uncertain = any(release.time_error_h > 0 for release in self._releases)
            needed = self.origin if uncertain else self.start
            if first > needed or last < self.end:
                shown = np.datetime_as_string([first, last, needed, self.end], unit="m")
                raise ScenarioError(
                    f"current: it covers {shown[0]} to {shown[1]}; the run needs {shown[2]} to "
                    f"{shown[3]}; give current.mean() (in TOML: mean = true) to use its mean"
                )

    @cached_property
    def _some_places(self) -> Floats:
        """Release positions of some members, longitude and latitude."""
        return self.release.sample(0, 64, 0).position

    def _relative(self, places: Floats) -> Floats:
        """Positions (n, 2) relative to the reference, the short way around the globe."""
        offset = places - np.array(self.reference)
        offset[:, 0] -= 360 * np.round(offset[:, 0] / 360)
        return np.asarray(offset)

    @cached_property
    def reference(self) -> tuple[float, float]:
        """Longitude and latitude that the coordinates of a run are counted from."""
        longitude, latitude = self._some_places[0]
        return round(float(longitude), 1), round(float(latitude), 1)

    @property
    def _releases(self) -> tuple[Release, ...]:
        release = self.release
        return (release,) if isinstance(release, Release) else release.releases

    @cached_property
    def start(self) -> np.datetime64:
        """Earliest release, UTC."""
        starts = [np.datetime64(r.start.replace(tzinfo=None), "us") for r in self._releases]
        earliest: np.datetime64 = nanoseconds("release", starts).min()
        return earliest

    @cached_property
    def origin(self) -> np.datetime64:
        """Midnight before it, UTC: time 0 of the run, so that the wind has its time of the day."""
        midnight: np.datetime64 = self.start.astype("datetime64[D]").astype("datetime64[ns]")
        return midnight

    @property
    def end(self) -> np.datetime64:
        """End of the run, UTC."""
        length = np.timedelta64(round(self.days * 86_400e6), "us")
        end: np.datetime64 = nanoseconds("days", self.start.astype("datetime64[us]") + length).max()
        return end

    @cached_property
    def duration(self) -> float:
        """Time of the end, from the origin [d]."""
        return float(self.since_origin(self.end))

    @property
    def duration_days(self) -> float:
        """The same, as the wind asks for it [d]."""
        return self.duration

    def since_origin(self, times: Any) -> Any:
        """Days since the origin."""
        return (np.asarray(times, dtype="datetime64[ns]") - self.origin) / _DAY

    def instants(self, days: Floats) -> NDArray[np.datetime64]:
        """Give times so many days after the origin, UTC, to the microsecond; NaT where NaN."""
        microseconds = np.where(np.isnan(days), 0, np.round(days * 86_400e6)).astype(np.int64)
        times = self.origin + microseconds.astype("timedelta64[us]")
        return np.where(np.isnan(days), np.datetime64("NaT", "ns"), times)

    @property
    def period(self) -> float:
        """Period of the largest tidal constituent [d]."""
        if self.tides is None:
            return _M2_DAYS
        constituents = self._constituents
        index = list(self.tides.constituents).index(self.tides.reference)
        return 2 * math.pi / (float(constituents["frequency"][index]) * _SECONDS_PER_DAY)

    @property
    def epsilon(self) -> float:
        """Tide period over the length of the run."""
        return self.period / self.days

    @cached_property
    def _constituents(self) -> Any:
        assert self.tides is not None  # noqa: S101 (asked only where there are tides)
        middle = self.start + (self.end - self.start) // 2
        return self.tides.constituents_at(middle, self.origin)

    @property
    def domain(self) -> tuple[float, float, float, float]:
        """West, east, south and north end of the data, relative to the reference [degrees]."""
        boxes = [
            (*self.offsets(grid.longitude)[[0, -1]], *(grid.latitude - self.reference[1])[[0, -1]])
            for grid in (self.tides, self.current)
            if grid is not None
        ]
        west, east, south, north = zip(*boxes, (-180, 180, -90, 90), strict=True)
        return max(west), min(east), max(south), min(north)

    def offsets(self, longitude: Floats) -> Floats:
        """Give longitudes relative to the reference, in the turn whose middle is nearest."""
        offset = longitude - self.reference[0]
        offset -= 360 * np.round((offset[0] + offset[-1]) / 720)
        return np.asarray(offset)

    def core_sea(self) -> _core.Sea:
        """Build the compiled sea: rates of the coordinates in degrees a day."""
        from driftcore import _core
        from driftcore.currents import filled
        from driftcore.sea import spline_axis, spline_coefficients

        def splines(fields: NDArray[Any], latitude: Floats) -> Any:
            """Spline coefficients (time, y, x, channel) of (time, y, x, channel) in m/s."""
            metric = np.stack([_DEGREES / np.cos(np.radians(latitude)), 0 * latitude + _DEGREES])
            scaled = fields * np.tile(metric, (fields.shape[-1] // 2, 1)).T[:, None, :]
            for dimension in range(3):
                scaled = spline_coefficients(scaled, dimension)
            return np.ascontiguousarray(scaled, dtype=complex)

        def axes(longitude: Floats, latitude: Floats, times: Floats) -> list[Any]:
            x, y = self.offsets(longitude), latitude - self.reference[1]
            return [
                spline_axis("longitude", x),
                spline_axis("latitude", y),
                spline_axis("time", times),
            ]

        seas = []
        if self.tides is not None:
            dataset, constituents = self.tides.dataset, self._constituents
            factor = constituents["factor"].values[:, None, None]
            longitude, latitude = self.tides.longitude, self.tides.latitude
            channels = []
            for k in range(len(factor)):
                for name in ("u", "v"):
                    amplitude = dataset[name].values[k] * factor[k]
                    parts = np.stack([amplitude.real, amplitude.imag])
                    real, imaginary = filled(parts, longitude, latitude)
                    channels.append(real + 1j * imaginary)
            fields = np.stack(channels, axis=-1)[None]
            lines = [
                (float(frequency) * _SECONDS_PER_DAY, int(species))
                for frequency, species in zip(
                    constituents["frequency"].values, constituents["species"].values, strict=True
                )
            ]
            grid = axes(longitude, latitude, np.zeros(1))
            coefficients = splines(fields, latitude)
            seas.append(_core.Sea.constituents(self.period, grid, lines, coefficients))
        if self.current is not None:
            current = self.current
            times = self.since_origin(current.times) if len(current.times) > 1 else np.zeros(1)
            grid = axes(current.longitude, current.latitude, times)
            fields = np.stack([current.u, current.v], axis=-1)
            coefficients = splines(fields, current.latitude)
            seas.append(_core.Sea.gridded(self.period, grid, 0, coefficients))
        if not seas:
            nowhere: list[Any] = [(0.0, 1.0, 1)] * 3
            still = np.zeros((1, 1, 1, 2), dtype=complex)
            seas.append(_core.Sea.gridded(self.period, nowhere, 0, still))
        return _core.Sea.sum(seas) if len(seas) > 1 else seas[0]

    def core_coast(self) -> _core.Coast | None:
        """Build the compiled coast, in the coordinates of the run."""
        from driftcore import _core

        if self.coast is None:
            return None
        rings = [ring - np.array(self.reference) for ring in self.near_coast.rings()]
        return _core.Coast.polygons(rings, False) if rings else None

    @cached_property
    def near_coast(self) -> LandCoast:
        """The coast around the data."""
        assert self.coast is not None  # noqa: S101 (asked only where there is a coast)
        coast = self.coast.around(self.reference[0])
        if self.tides is None and self.current is None:
            return coast
        (west, east, south, north), (longitude, latitude) = self.domain, self.reference
        margin = _COAST_MARGIN
        return coast.cut(
            west + longitude - margin,
            east + longitude + margin,
            max(south + latitude - margin, -90.0),
            min(north + latitude + margin, 90.0),
        )

    def core_fleet(
        self, sea: _core.Sea, coast: _core.Coast | None, first: int, count: int, seed: int
    ) -> tuple[_core.Fleet, Floats, Floats]:
        """Build the compiled bodies `first` … `first + count - 1`.

        Returns
        -------
        fleet, positions, times
            Positions (count, 2) relative to the reference, times (count,) since the origin [d].
        """
        from driftcore import _core

        places, instants, _ = self.release.sample(first, count, seed)
        positions = self._relative(places)
        times = np.clip(self.since_origin(instants), 0.0, None)
        if times.max() >= self.duration:
            raise ScenarioError(
                f"release: one is at {self.instants(times).max()}, after the end of the run"
            )
        fleet = _core.Fleet(
            sea,
            coast,
            self.reference[1],
            self.duration,
            first,
            times,
            np.ascontiguousarray(positions),
            None,
            self._bodies(first, count, seed),
            self._jibing_rate,
            seed,
        )
        return fleet, positions, times

    @property
    def _jibing_rate(self) -> float:
        return 24 * self.drifter.jibing_per_hour if isinstance(self.drifter, Leeway) else 0.0

    def _bodies(self, first: int, count: int, seed: int) -> Floats:
        """Columns as `_core.Fleet` takes them."""
        bodies = np.zeros((count, 10))
        uniforms = self.drifter.uniforms(seed, first, count)
        if isinstance(self.drifter, Leeway):
            bodies[:, 2:6] = self.drifter.sample(uniforms)
            bodies[:, 6:8] = self.drifter.sample(uniforms, jibed=True)[:, 2:]
        else:
            response, factor = self.drifter.sample(uniforms).T
            bodies[:, 0], bodies[:, 1], bodies[:, 2] = response / _SECONDS_PER_DAY, factor, factor
        share, angle = self.wind_current
        bodies[:, 8] = share * math.cos(math.radians(angle))
        bodies[:, 9] = share * math.sin(math.radians(angle))
        return bodies

    def _repr_html_(self) -> str:
        from driftcore.html import scenario_table

        return scenario_table(self)

    @cached_property
    def scaling(self) -> Scaling:
        """The paper's scaling: how small is what averaging takes for small."""
        tide = excursion = steepness = 0.0
        if self.tides is not None:
            constituents = self._constituents
            scales = self.tides.scales()["maximum"].values
            omega = constituents["frequency"].values
            tide, excursion = float(scales.sum()), float((scales / omega).sum())
            steepness = self._steepness(omega)
        residual = 0.0 if self.current is None else self.current.scales().largest
        return Scaling(
            epsilon=self.epsilon,
            tide=tide,
            residual=residual,
            excursion_km=excursion / 1e3,
            steepness=steepness,
            unit_length_km=tide * self.days * _SECONDS_PER_DAY / 1e3,
        )

    def _steepness(self, omega: Floats) -> float:
        """`Σ|∇Z_k|/ω_k` at its 99th percentile over the sea."""
        assert self.tides is not None  # noqa: S101 (asked only where there are tides)
        metre = 1 / math.radians(1) / RADIUS_M
        total: Any = 0.0
        for name in ("u", "v"):
            values = self.tides.dataset[name].values
            north = np.gradient(values, self.tides.latitude, axis=1) * metre
            east = np.gradient(values, self.tides.longitude, axis=2) * metre
            east = east / np.cos(np.radians(self.tides.latitude))[:, None]
            total = total + np.abs(north) ** 2 + np.abs(east) ** 2
        steep = (np.sqrt(total) / omega[:, None, None]).sum(axis=0)
        return float(np.nanquantile(steep, 0.99))

    def warn(self) -> None:
        """Say where the ordering that averaging needs does not hold."""
        problems = self.scaling.problems()
        if problems:
            warn(
                "averaging takes for small what here is not: "
                + "; ".join(problems)
                + '; compare with model="full"'
            )

    def describe(self) -> dict[str, Any]:
        """Attributes that tell a reader what was followed where."""
        scaling = {f"scaling_{name}": value for name, value in self.scaling._asdict().items()}
        return {
            "scenario": self.name,
            "start": str(self.start),
            "days": self.days,
            "release": self.release.describe(),
            "drifter": self.drifter.to_toml(),
            "tides": repr(self.tides) if self.tides is not None else "none",
            "current": self.current.describe() if self.current is not None else "none",
            "coast": repr(self.coast) if self.coast is not None else "none",
            "wind_current": list(self.wind_current),
            "tide_period_h": 24 * self.period,
            **scaling,
        }
