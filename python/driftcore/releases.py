"""Where and when things are set adrift: places, times, and how surely they are known."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import UTC, datetime
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, NonNegativeFloat, PositiveFloat, field_validator, model_validator

from driftcore.coast import geodesic, near_longitude, place_name
from driftcore.configuration import Configuration
from driftcore.draws import Stream, member_uniforms
from driftcore.errors import ScenarioError, need_geo
from driftcore.times import Times

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

Float = NDArray[np.float64]
Integer = NDArray[np.int64]
Kind = Literal["point", "line", "polygon"]
Position = tuple[Annotated[float, Field(ge=-360, le=360)], Annotated[float, Field(ge=-90, le=90)]]

# Uniform numbers of a member, in this order; see `Release._sampled`.
_DRAWS = 9
_SECOND = np.timedelta64(1_000_000, "us")
# Sides of a polygon are straight in longitude and latitude; in the plane of equal areas they bend.
# Cut in so many parts, what is left of the bend is 1/4096 of it.
_PARTS_OF_A_SIDE = 64
_CENTURY_H = 876_600


class Released(NamedTuple):
    """What members start from.

    Attributes
    ----------
    position : ndarray, shape (n, 2)
        Longitude, from -180 to 180, and latitude [degrees].
    time : ndarray of datetime64[us], shape (n,)
        UTC.
    release : ndarray of int, shape (n,)
        Which release each member belongs to.
    """

    position: Float
    time: Times
    release: Integer


def _utc(value: Any) -> datetime:
    """Give a time in UTC, without a zone: what has none is UTC."""
    time = value
    if isinstance(value, str):
        try:
            time = datetime.fromisoformat(value.strip())
        except ValueError:
            time = None
    # NaT of pandas is a datetime that differs from itself.
    if not isinstance(time, datetime) or time != time:
        raise ValueError(
            f"{value!r} is not accepted; it should be a time: a datetime or ISO 8601 text, UTC "
            "where it names no zone"
        )
    if time.tzinfo is not None:
        time = time.astimezone(UTC)
    return datetime.combine(time.date(), time.time())


class Release(Configuration):
    """Things set adrift at a place and a time, either known or uncertain.

    Made by `point`, `disc`, `line`, `polygon` or `from_geometry`. A member's place is drawn on the
    point, along the line (evenly by length) or in the polygon (evenly by area); then moved evenly
    within `radius_m`; then by its error, whose law is normal, the same in all directions. Its time
    is drawn evenly from `start` to `end`; then moved by its error, normal too.
    """

    kind: Kind = Field(default="point", description='"point", "line" or "polygon"')
    coordinates: Annotated[
        tuple[Annotated[tuple[Position, ...], Field(min_length=1)], ...], Field(min_length=1)
    ] = Field(
        description="[longitude, latitude] of a point, a list of them of a line or a polygon; or a "
        "list of such lists: several lines, or the rings of a polygon, by parity"
    )
    start: datetime = Field(description="time of the release, or the first of a window; UTC")
    end: datetime | None = Field(default=None, description="last time of the window; UTC")
    radius_m: Annotated[float, Field(ge=0, le=1e6)] = Field(
        default=0.0, description="released evenly within this distance of the place [m]"
    )
    position_error_m: Annotated[float, Field(ge=0, le=1e6)] = Field(
        default=0.0, description="the place is known to this distance [m]"
    )
    time_error_h: Annotated[float, Field(ge=0, le=_CENTURY_H)] = Field(
        default=0.0, description="the time is known to ± this [h]"
    )
    contained_percent: Annotated[float, Field(gt=0, lt=100)] = Field(
        default=95.0, description="how often the truth lies within these errors [%]"
    )
    name: str | None = Field(default=None, description="a name for people")

    @classmethod
    def point(
        cls, longitude: float, latitude: float, time: Any, radius_m: float = 0.0, **options: Any
    ) -> Release:
        """Release at a point, or evenly within a distance of it.

        Parameters
        ----------
        longitude, latitude : float
            [degrees]
        time : time or pair of times
            An instant, or the first and last of a window: datetime, numpy or pandas times, or
            ISO 8601 text; UTC where they name no zone.
        radius_m : float
            [m]
        **options
            Other fields of `Release`.
        """
        return cls._made("point", [[(longitude, latitude)]], time, radius_m=radius_m, **options)

    @classmethod
    def disc(
        cls, longitude: float, latitude: float, radius_m: PositiveFloat, time: Any, **options: Any
    ) -> Release:
        """Release evenly by area within `radius_m` of a point: see `point`."""
        return cls.point(longitude, latitude, time, radius_m, **options)

    @classmethod
    def line(cls, points: Any, time: Any, **options: Any) -> Release:
        """Release evenly by length along a line of geodesics through points, shape (n, 2)."""
        return cls._made("line", [points], time, **options)

    @classmethod
    def polygon(cls, points: Any, time: Any, **options: Any) -> Release:
        """Release evenly by area in a polygon of points, shape (n, 2): it closes itself.

        Its sides are straight in longitude and latitude; it holds no pole.
        """
        return cls._made("polygon", [points], time, **options)

    @classmethod
    def from_geometry(cls, geometry: BaseGeometry, time: Any, **options: Any) -> Release:
        """Release on a shapely point, line or polygon, or several lines or polygons.

        Raises
        ------
        ScenarioError
            The geometry is another, empty, or a polygon that crosses itself.
        """
        import shapely

        kinds: dict[str, Kind] = {
            "Point": "point",
            "LineString": "line",
            "MultiLineString": "line",
            "Polygon": "polygon",
            "MultiPolygon": "polygon",
        }
        kind = getattr(geometry, "geom_type", None)
        if kind not in kinds or geometry.is_empty:
            shown = repr(geometry) if kind not in kinds else f"an empty {kind}"
            raise ScenarioError(
                f"geometry: {shown} is not accepted; it should be one of {', '.join(kinds)}"
            )
        if kinds[kind] == "polygon" and not geometry.is_valid:
            reason = shapely.is_valid_reason(geometry)
            raise ScenarioError(f"geometry: {reason}: is not accepted; repair it by make_valid")
        flat = shapely.force_2d(geometry)
        parts = shapely.get_parts(flat)
        lines = shapely.get_rings(parts) if kinds[kind] == "polygon" else parts
        rings = [shapely.get_coordinates(line) for line in lines]
        return cls._made(kinds[kind], rings, time, **options)

    @classmethod
    def _made(cls, kind: Kind, parts: Any, time: Any, **options: Any) -> Release:
        window = isinstance(time, tuple | list)
        if window and len(time) != 2:
            raise ScenarioError(
                f"time: {time!r} is not accepted; it should be an instant, or the first and last "
                "of a window"
            )
        start, end = time if window else (time, None)
        return cls(kind=kind, coordinates=parts, start=start, end=end, **options)

    @model_validator(mode="before")
    @classmethod
    def _times_of_numpy(cls, values: Any) -> Any:
        """Before the base makes plain numbers of them, to which NumPy's nanoseconds would turn."""
        if not isinstance(values, dict):
            return values
        return {
            name: value.astype("datetime64[us]").item()
            if isinstance(value, np.datetime64)
            else value
            for name, value in values.items()
        }

    @field_validator("coordinates", mode="before")
    @classmethod
    def _of_one_part(cls, value: Any) -> Any:
        """Take a point for a part of one point, and a list of points for the only part."""
        depth, inner = 0, value
        while isinstance(inner, tuple) and inner:
            depth, inner = depth + 1, inner[0]
        # Of numbers: a point is one list deep, a part two, several parts three.
        for _ in range(3 - depth if depth else 0):
            value = (value,)
        return value

    def in_toml(self, name: str) -> Any:
        """Give the value of a field, the coordinates without lists of one."""
        value = super().in_toml(name)
        if name == "coordinates" and len(value) == 1:
            return value[0][0] if self.kind == "point" else value[0]
        return value

    @field_validator("start", mode="before")
    @classmethod
    def _start_in_utc(cls, value: Any) -> datetime:
        return _utc(value)

    @field_validator("end", mode="before")
    @classmethod
    def _end_in_utc(cls, value: Any) -> datetime | None:
        return None if value is None else _utc(value)

    @model_validator(mode="after")
    def _is_a_place_and_a_time(self) -> Release:
        if self.end is not None and self.end < self.start:
            raise ValueError(
                f"end: {self.end} is not accepted; it should not be before start = {self.start}"
            )
        least = {"point": 1, "line": 2, "polygon": 3}[self.kind]
        for k, part in enumerate(self.coordinates):
            count = len(set(part))
            if count < least or (self.kind == "point" and len(self.coordinates) + len(part) > 2):
                raise ValueError(
                    f"coordinates.{k}: {count} different points are not accepted; a {self.kind} "
                    f"has {'one' if least == 1 else f'at least {least}'}"
                )
        if self.kind == "polygon":
            _triangles(self.coordinates)
        return self

    def describe(self) -> str:
        """Say in one line where and when."""
        points = [point for part in self.coordinates for point in part]
        where = place_name(*points[0])
        if self.kind != "point":
            where = f"a {self.kind} of {len(points)} points from {where}"
        if self.radius_m:
            where += f", within {self.radius_m:g} m"
        if self.position_error_m:
            where += f", known to {self.position_error_m:g} m"
        time = f"{self.start:%Y-%m-%d %H:%M}"
        if self.end is not None:
            time += f" to {self.end:%Y-%m-%d %H:%M}"
        known = f", known to {self.time_error_h:g} h" if self.time_error_h else ""
        return f"{where}; {time} UTC{known}"

    def sample(self, first: int, count: int, seed: int) -> Released:
        """Give place and time of some members: those of a run with this release alone.

        A member's draws depend on the seed and its number only.

        Parameters
        ----------
        first, count : int
            The members `first` … `first + count - 1`.
        seed : int
            From 0 to 2⁶⁴ - 1.
        """
        return Releases([self]).sample(first, count, seed)

    def _sampled(self, uniforms: Float) -> tuple[Float, Times]:
        """Places and times from uniform numbers, shape (n, 9)."""
        need_geo("scipy")
        from scipy.special import ndtri

        place, (spread, toward), (error, error_toward) = (
            uniforms[:, :3],
            uniforms[:, 3:5].T,
            uniforms[:, 5:7].T,
        )
        at = self._placed(place)
        at = _moved(at, self.radius_m * np.sqrt(spread), 360 * toward)
        # In two dimensions a share p of a normal law lies within σ√(-2 ln(1-p)) (Rayleigh).
        share = self.contained_percent / 100
        radius = self.position_error_m * np.sqrt(np.log1p(-error) / np.log1p(-share))
        at = _moved(at, radius, 360 * error_toward)
        at[:, 0] = near_longitude(at[:, 0], 0.0)
        window = 0.0 if self.end is None else (self.end - self.start).total_seconds()
        sigma = self.time_error_h * 3600 / ndtri((1 + share) / 2)
        seconds = window * uniforms[:, 7] + sigma * ndtri(uniforms[:, 8])
        micro = np.rint(seconds * 1e6).astype("timedelta64[us]")
        return at, np.datetime64(self.start, "us") + micro

    def _placed(self, uniforms: Float) -> Float:
        """Points on the place itself, shape (n, 2), from uniform numbers, shape (n, 3)."""
        if self.kind == "point":
            return np.tile(np.array(self.coordinates[0][0], dtype=np.float64), (len(uniforms), 1))
        if self.kind == "line":
            geod = geodesic()
            parts = [np.array(part, dtype=np.float64) for part in self.coordinates]
            starts = np.concatenate([part[:-1] for part in parts])
            ends = np.concatenate([part[1:] for part in parts])
            bearing, _, length = geod.inv(*starts.T, *ends.T)
            side, rest = _picked(uniforms[:, 0], length)
            x, y = starts[side].T
            lon, lat, _ = geod.fwd(x, y, bearing[side], rest * length[side])
            return np.column_stack([lon, lat])
        triangles, plane, middle = _triangles(self.coordinates)
        edge, other = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
        area = np.abs(edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0])
        which, _ = _picked(uniforms[:, 0], area)
        # Evenly in a triangle: the square folded along its diagonal.
        a, b = uniforms[:, 1:2], uniforms[:, 2:3]
        folded = a + b > 1
        a, b = np.where(folded, 1 - a, a), np.where(folded, 1 - b, b)
        at = triangles[which, 0] + a * edge[which] + b * other[which]
        lon, lat = plane.transform(at[:, 0], at[:, 1], direction="INVERSE")
        return np.column_stack([lon + middle, lat])


class Releases(Configuration):
    """Several releases of one run; members are dealt to them in proportion to their weights.

    Which release a member belongs to depends on its number and the weights alone: any run of
    members, long or short, holds each release close to its share.
    """

    releases: Annotated[tuple[Release, ...], Field(min_length=1)] = Field(
        description="each a release"
    )
    weights: tuple[NonNegativeFloat, ...] | None = Field(
        default=None, description="relative number of members of each; equal if absent"
    )

    def __init__(self, releases: Iterable[Release], weights: Iterable[float] | None = None) -> None:
        given = None if weights is None else tuple(weights)
        super().__init__(releases=tuple(releases), weights=given)

    @model_validator(mode="after")
    def _weights_fit(self) -> Releases:
        weights = self.weights
        if weights is not None and (len(weights) != len(self.releases) or not sum(weights) > 0):
            raise ValueError(
                f"weights: {list(weights)} is not accepted; it should be one number for each of "
                f"the {len(self.releases)} releases, not all 0"
            )
        return self

    def describe(self) -> str:
        """Say in one line where and when."""
        more = len(self.releases) - 1
        return self.releases[0].describe() + (f"; and {more} more" if more else "")

    def release_of(self, first: int, count: int) -> Integer:
        """Say which release each member belongs to, shape (count,)."""
        shares = np.ones(len(self.releases)) if self.weights is None else np.array(self.weights)
        # Multiples of the golden ratio modulo 1 fill the interval as evenly as can be (Knuth,
        # The Art of Computer Programming 3, 6.4); integers modulo 2⁶⁴ do it without rounding.
        golden = np.uint64(0x9E3779B97F4A7C15)
        members = np.arange(count, dtype=np.uint64) + np.uint64(first)
        return _picked((members * golden).astype(np.float64) * 2.0**-64, shares)[0]

    def sample(self, first: int, count: int, seed: int) -> Released:
        """Give place, time and release of some members.

        A member's draws depend on the seed and its number only.

        Parameters
        ----------
        first, count : int
            The members `first` … `first + count - 1`.
        seed : int
            From 0 to 2⁶⁴ - 1.

        Raises
        ------
        ScenarioError
            A number is not one of those.
        """
        uniforms = member_uniforms(seed, first, count, _DRAWS, Stream.RELEASE)
        dealt = self.release_of(first, count)
        position = np.empty((count, 2))
        time = np.empty(count, dtype="datetime64[us]")
        for k, release in enumerate(self.releases):
            mine = dealt == k
            if mine.any():
                position[mine], time[mine] = release._sampled(uniforms[mine])
        return Released(position, time, dealt)


def _picked(uniforms: Float, weights: Float) -> tuple[Integer, Float]:
    """Pick by weights; give the indices, and how far into their weight the numbers reach."""
    ends = np.cumsum(weights)
    reached = uniforms * ends[-1]
    # Rounding may carry the largest number to the end itself; what weighs nothing is never picked.
    last = int(np.flatnonzero(weights)[-1])
    index = np.minimum(np.searchsorted(ends, reached, side="right"), last)
    rest = (reached - (ends - weights)[index]) / weights[index]
    return index.astype(np.int64), np.clip(rest, 0.0, 1.0)


def _moved(points: Float, metres: Float, bearing: Float) -> Float:
    """Move points, shape (n, 2), along geodesics; those not moved stay to the last bit."""
    moved = points.copy()
    away = metres > 0
    if away.any():
        x, y = points[away].T
        lon, lat, _ = geodesic().fwd(x, y, bearing[away], metres[away])
        moved[away] = np.column_stack([lon, lat])
    return moved


@lru_cache(maxsize=64)
def _triangles(rings: tuple[tuple[Position, ...], ...]) -> tuple[Float, Any, float]:
    """Cut a polygon into triangles, shape (n, 3, 2), in a plane of equal areas.

    Returns
    -------
    tuple
        Triangles [m]; the plane; the longitude [degrees] of its middle.
    """
    need_geo("shapely", "pyproj")
    import pyproj
    import shapely

    middle = float(np.unwrap([lon for lon, _ in rings[0]], period=360).mean())
    shape: BaseGeometry = shapely.Polygon()
    for ring in rings:
        points = np.array(ring)
        longitude = np.unwrap(points[:, 0], period=360) - middle
        longitude -= 360 * np.rint(longitude.mean() / 360)
        if abs(longitude[-1] - longitude[0]) > 180:
            raise ValueError("coordinates: a polygon around a pole is not accepted; use a disc")
        outline = shapely.Polygon(np.column_stack([longitude, points[:, 1]]))
        if not outline.is_valid:
            raise ValueError(
                f"coordinates: {shapely.is_valid_reason(outline)} (longitudes from {middle:g}) is "
                "not accepted; the polygon should not cross itself"
            )
        shape = shape.symmetric_difference(outline)
    west, south, east, north = shape.bounds
    fine = shapely.segmentize(shape, max(east - west, north - south) / _PARTS_OF_A_SIDE)
    plane = pyproj.Transformer.from_crs("EPSG:4326", "+proj=cea +ellps=WGS84", always_xy=True)
    flat = shapely.transform(fine, lambda x: np.column_stack(plane.transform(x[:, 0], x[:, 1])))
    try:
        parts = shapely.get_parts(shapely.constrained_delaunay_triangles(flat))
    except shapely.GEOSException as error:
        raise ValueError(
            f"coordinates: a polygon with bounds {shape.bounds} (longitudes from {middle:g}) is "
            f"not accepted, it has no even area: {error}"
        ) from None
    return shapely.get_coordinates(parts).reshape(-1, 4, 2)[:, :3], plane, middle
