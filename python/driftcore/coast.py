"""Land of the real world: polygons in longitude and latitude, read, repaired, cut to a region."""

from __future__ import annotations

import gzip
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore.errors import ScenarioError, need_geo, warn

if TYPE_CHECKING:
    import pyproj
    import shapely
    from shapely.geometry.base import BaseGeometry

Float = NDArray[np.float64]
Integer = NDArray[np.int64]
Geometries = NDArray[np.object_]
Resolution = Literal["50m"]
# West, east, south, north [degrees]; east is above west, above 180 beyond the dateline.
Box = tuple[float, float, float, float]

_CIRCLE = 360.0
_POINTS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")
_SHOWN = 3
# Sides in a line that is searched as one.
_PIECE = 64
# A side so long, straight in longitude and latitude, bends by less than a metre in a plane.
_STRAIGHT = 0.05


def geodesic() -> pyproj.Geod:
    """Give the ellipsoid that distances are measured on, WGS 84."""
    need_geo("pyproj")
    import pyproj

    return pyproj.Geod(ellps="WGS84")


def near_longitude(longitude: ArrayLike, reference: float) -> Float:
    """Give the same longitudes within 180 degrees of a reference; those that are stay as they are.

    Parameters
    ----------
    longitude : array_like
        Longitudes [degrees east], any turn.
    reference : float
        Longitude [degrees east] of the middle.
    """
    values = np.asarray(longitude, dtype=np.float64)
    return values - _CIRCLE * np.floor((values - reference) / _CIRCLE + 0.5)


@dataclass(frozen=True, eq=False)
class LandCoast:
    """Land polygons in longitude and latitude [degrees]; straight sides, holes are water.

    Made by `from_file`, `from_geometries` or `default`; cut to the region of a run with `cut`.

    Attributes
    ----------
    polygons : ndarray of shapely.Polygon, shape (n,)
        Valid polygons, with longitudes within 180 degrees of `reference`.
    names : tuple of str or None
        Name of each polygon, where there is one.
    label : str
        What the coast is, in words for people.
    reference : float
        Longitude [degrees east] in the middle.
    box : tuple of float or None
        West, east, south, north of the region it was cut to: nothing is known outside.
    stretches : mapping of str to shapely geometry
        Named stretches: areas, or lines along the coast.
    """

    polygons: Geometries
    names: tuple[str | None, ...]
    label: str
    reference: float = 0.0
    box: Box | None = None
    stretches: Mapping[str, BaseGeometry] = field(default_factory=dict)

    @classmethod
    def from_file(
        cls,
        path: str | PathLike[str],
        name_column: str | None = None,
        layer: str | None = None,
    ) -> LandCoast:
        """Read land polygons from GeoJSON, a Shapefile, a GeoPackage or what else GDAL reads.

        Parameters
        ----------
        path : path
            `.geojson`, `.json` (plain, or compressed as `.gz`): longitude and latitude unless
            the file names another reference system. Any other: read by pyogrio, and reprojected
            to longitude and latitude (EPSG:4326) where it is in another reference system.
        name_column : str, optional
            Property that holds the names of polygons.
        layer : str, optional
            Layer, where the file has several.

        Raises
        ------
        ScenarioError
            The file cannot be read, has no such layer or column, or holds no land polygons.

        Warns
        -----
        DriftCoreWarning
            A polygon was repaired, or the file does not say its reference system.
        """
        file = Path(path)
        try:
            there = file.exists()
        except (OSError, ValueError):  # too long a name
            there = False
        if not there:
            raise ScenarioError(f"path: '{file}' is not accepted; there is no such file")
        need_geo("shapely")
        suffixes = [suffix.lower() for suffix in file.suffixes[-2:] if suffix.lower() != ".gz"]
        if suffixes and suffixes[-1] in {".geojson", ".json"}:
            geometries, names, system = _read_geojson(file, name_column)
        else:
            geometries, names, system = _read_layer(file, name_column, layer)
        return cls.from_geometries(
            _in_degrees(geometries, system, file.name), names, label=file.name
        )

    @classmethod
    def from_geometries(
        cls,
        geometries: BaseGeometry | Iterable[BaseGeometry | None],
        names: Sequence[str | None] | None = None,
        label: str = "polygons given in Python",
    ) -> LandCoast:
        """Take land polygons from shapely.

        Parameters
        ----------
        geometries : geometry or iterable of geometries
            Polygons, multipolygons, or collections of them, in longitude and latitude [degrees].
            One that crosses the dateline may be split there, run on beyond 180, or jump.
        names : sequence of str, optional
            Name of each geometry.
        label : str
            What they are, in words for people.

        Raises
        ------
        ScenarioError
            There is no polygon, something else, or a coordinate is no longitude or latitude.

        Warns
        -----
        DriftCoreWarning
            A polygon crossed itself and was repaired.
        """
        need_geo("shapely", "scipy")
        import shapely

        given = [geometries] if isinstance(geometries, shapely.Geometry) else list(geometries)
        if names is not None and len(names) != len(given):
            raise ScenarioError(
                f"names: {len(names)} names are not accepted; there are {len(given)} geometries"
            )
        shapes = np.array(given, dtype=object)
        if not all(shape is None or isinstance(shape, shapely.Geometry) for shape in given):
            raise ScenarioError(f"{label}: is not accepted; it should hold shapely geometries")
        polygons, owner = _polygons(shapely.force_2d(shapes), label)
        _check_degrees(polygons, label)
        polygons, source = _repaired(_unwrapped(polygons, label), owner, label)
        if not len(polygons):
            raise ScenarioError(f"{label}: holds no polygon with an area; land should be polygons")
        labels = [None] * len(given) if names is None else list(names)
        whole = cls(polygons, tuple(labels[k] for k in source), label)
        return whole.around(0.0)

    @classmethod
    def default(cls, resolution: Resolution = "50m") -> LandCoast:
        """Give the land of the whole world that comes with driftcore: Natural Earth.

        Parameters
        ----------
        resolution : "50m"
            1:50 million, lines true to a kilometre or two; the Caspian Sea is the only lake.

        Raises
        ------
        ScenarioError
            There is no such resolution.
        """
        if resolution not in get_args(Resolution):
            known = " or ".join(repr(name) for name in get_args(Resolution))
            raise ScenarioError(f"resolution: {resolution!r} is not accepted; it should be {known}")
        file = resources.files("driftcore") / "data" / f"land_{resolution}.geojson.gz"
        with resources.as_file(file) as path:
            land = cls.from_file(path)
        return replace(land, label=f"Natural Earth, 1:{resolution[:-1]} million")

    def __len__(self) -> int:
        return len(self.polygons)

    def __repr__(self) -> str:
        cut = "" if self.box is None else f", box {self.box}"
        return f"<LandCoast {self.label}: {len(self)} polygons{cut}>"

    def around(self, longitude: float) -> LandCoast:
        """Give the same land with longitudes from `longitude` - 180 to `longitude` + 180.

        Polygons that the old seam had split are joined; those that the new one meets are split.
        Named stretches are left behind, for they belong to the region as it was.

        Raises
        ------
        ScenarioError
            The coast has been cut, or the longitude is not from -360 to 360.
        """
        import shapely

        _check_within("longitude", longitude, -_CIRCLE, _CIRCLE)
        if self.box is not None:
            raise ScenarioError(
                f"longitude: a coast cut to {self.box} cannot be turned; turn it before the cut"
            )
        west, east = longitude - 180, longitude + 180
        bounds = shapely.bounds(self.polygons).reshape(-1, 4)
        inside = (bounds[:, 0] >= west) & (bounds[:, 2] <= east)
        if inside.all() and longitude == self.reference:
            return self
        window = shapely.box(west, -90, east, 90)
        pieces, owner = [self.polygons[inside]], [np.flatnonzero(inside)]
        for turns in (-2, -1, 0, 1, 2):
            shift = turns * _CIRCLE
            here = ~inside & (bounds[:, 0] + shift < east) & (bounds[:, 2] + shift > west)
            moved = _shifted(self.polygons[here], shift)
            parts, of = _areas(shapely.intersection(moved, window))
            pieces.append(parts)
            owner.append(np.flatnonzero(here)[of])
        polygons, source = _joined(
            np.concatenate(pieces), np.concatenate(owner), self.names, seam=self.reference + 180
        )
        return replace(
            self,
            polygons=polygons,
            names=tuple(self.names[k] for k in source),
            reference=float(longitude),
            stretches={},
        )

    def cut(self, west: float, east: float, south: float, north: float) -> LandCoast:
        """Cut the land to the region of a run.

        Land is closed along the sides of the region: there it has sides that are no coast.

        Parameters
        ----------
        west, east, south, north : float
            Sides [degrees]. Over the dateline, east is below west or above 180: (170, -170) and
            (170, 190) are the same. Longitudes of the result run on from `west`.

        Raises
        ------
        ScenarioError
            The sides are no region, or the region is all land.
        """
        import shapely

        for name, value in (("west", west), ("east", east)):
            _check_within(name, value, -_CIRCLE, _CIRCLE)
        for name, value in (("south", south), ("north", north)):
            _check_within(name, value, -90, 90)
        east = east + _CIRCLE if east < west else east
        if not (west < east <= west + _CIRCLE and south < north):
            raise ScenarioError(
                f"region: west {west:g}, east {east:g}, south {south:g}, north {north:g} is not "
                "accepted; east should be above west by at most 360, and north above south"
            )
        if self.box is not None:
            middle = (west + east) / 2
            turn = float(near_longitude(middle, self.reference)) - middle
            west, east = west + turn, east + turn
            w, e, s, n = self.box
            if not (w <= west and east <= e and s <= south and north <= n):
                raise ScenarioError(
                    f"region: {(west, east, south, north)} is not accepted; the coast has been "
                    f"cut to {self.box} and is not known outside"
                )
            whole = self
        else:
            whole = self.around((west + east) / 2)
        region = shapely.box(west, south, east, north)
        bounds = shapely.bounds(whole.polygons).reshape(-1, 4)
        near = shapely.intersects(shapely.box(*bounds.T), region)
        within = shapely.covered_by(shapely.box(*bounds.T), region)
        crossing = np.flatnonzero(near & ~within)
        parts, of = _areas(shapely.intersection(whole.polygons[crossing], region))
        polygons = np.concatenate([whole.polygons[within], parts])
        source = np.concatenate([np.flatnonzero(within), crossing[of]])
        coast = replace(
            whole,
            polygons=polygons,
            names=tuple(whole.names[k] for k in source),
            box=(float(west), float(east), float(south), float(north)),
            stretches={},
        )
        if shapely.covers(coast._land, region).any():
            raise ScenarioError(
                f"region: west {west:g}, east {east:g}, south {south:g}, north {north:g} is not "
                f"accepted; it is all land of {self.label}"
            )
        return coast

    @cached_property
    def _land(self) -> Geometries:
        """Polygons that do not overlap: those that touch are one."""
        return _joined(self.polygons, np.arange(len(self.polygons)))[0]

    def rings(self) -> list[Float]:
        """Give the coast lines for the compiled core.

        Returns
        -------
        list of ndarray, shape (n, 2)
            Longitude and latitude [degrees] of closed rings whose last point is not repeated.
            A point is on land where an odd number of them surrounds it. Empty: there is no land.
        """
        import shapely

        rings = shapely.get_rings(self._land)
        coordinates, ring = shapely.get_coordinates(rings, return_index=True)
        parts = np.split(coordinates, np.flatnonzero(np.diff(ring)) + 1) if len(rings) else []
        return [np.ascontiguousarray(part[:-1]) for part in parts]

    @cached_property
    def _shore(self) -> tuple[shapely.STRtree, Integer]:
        """Short lines of the rings, to find the nearest among, and the polygon of each."""
        import shapely

        rings, polygon = shapely.get_rings(self.polygons, return_index=True)
        lines = [shapely.get_coordinates(ring) for ring in rings]
        pieces = [
            (line[k : k + _PIECE + 1], owner)
            for line, owner in zip(lines, polygon, strict=True)
            for k in range(0, len(line) - 1, _PIECE)
        ]
        drawn = [shapely.LineString(piece) for piece, _ in pieces]
        return shapely.STRtree(drawn), np.array([owner for _, owner in pieces], dtype=np.int64)

    def _points(self, points: ArrayLike) -> Geometries:
        import shapely

        values = np.asarray(points, dtype=np.float64)
        if values.ndim != 2 or values.shape[1] != 2 or not np.isfinite(values).all():
            raise ScenarioError(
                f"points: an array of shape {values.shape} is not accepted; it should be finite "
                "longitudes and latitudes [degrees], shape (n, 2)"
            )
        longitudes = near_longitude(values[:, 0], self.reference)
        return np.atleast_1d(np.asarray(shapely.points(longitudes, values[:, 1]), dtype=object))

    def polygon_of(self, points: ArrayLike) -> Integer:
        """Say on which polygon points of the coast lie: the one that holds them, or the nearest.

        Parameters
        ----------
        points : array_like, shape (n, 2)
            Longitude and latitude [degrees].

        Returns
        -------
        ndarray of int, shape (n,)
            Index into `polygons` and `names`; -1 where there is no land at all.
        """
        import shapely

        given = self._points(points)
        found = np.full(len(given), -1)
        if not len(self):
            return found
        polygon, point = shapely.STRtree(given).query(self.polygons, predicate="intersects")
        found[point] = polygon
        rest = found < 0
        tree, owner = self._shore
        found[rest] = owner[tree.nearest(given[rest])]
        return found

    def is_land(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Say which points, shape (n, 2) [degrees], lie on land or on its edge; shape (n,)."""
        import shapely

        given = self._points(points)
        land = np.zeros(len(given), dtype=bool)
        # The polygons are asked for the points, not the other way round: GEOS prepares the former.
        land[shapely.STRtree(given).query(self.polygons, predicate="intersects")[1]] = True
        return land

    def distance_to_sea_km(self, longitude: float, latitude: float) -> tuple[float, float]:
        """Measure how far a point on land is from the water, lakes included.

        Returns
        -------
        tuple of float
            Geodesic distance [km], 0 afloat; bearing of the nearest water [degrees from north].
            Sides of the region that the coast was cut to are no coast.
        """
        import shapely

        point = self._points([[longitude, latitude]])
        inside = shapely.intersects(self._land, point[0])
        if not inside.any():
            return 0.0, math.nan
        lines = [
            chain for ring in shapely.get_rings(self._land[inside]) for chain in self._open(ring)
        ]
        # True distance from its centre, so that the nearest point of the plane is the nearest.
        plane = _plane(longitude, latitude)
        fine = shapely.segmentize([shapely.LineString(line) for line in lines], _STRAIGHT)
        projected = shapely.transform(
            fine, lambda x: np.column_stack(plane.transform(x[:, 0], x[:, 1]))
        )
        origin = shapely.Point(0, 0)
        nearest = projected[np.argmin(shapely.distance(projected, origin))]
        x, y = shapely.get_coordinates(shapely.shortest_line(origin, nearest))[1]
        at = plane.transform(x, y, direction="INVERSE")
        bearing, _, metres = geodesic().inv(longitude, latitude, *at)
        return float(metres) / 1000, float(bearing % _CIRCLE)

    def check_afloat(self, points: ArrayLike, what: str = "the release") -> None:
        """Refuse points on land, shape (n, 2) [degrees].

        Raises
        ------
        ScenarioError
            A point is on land or outside the region; the message says how far the sea is.
        """
        values = np.asarray(points, dtype=np.float64)
        land = self.is_land(values)
        if self.box is not None:
            west, east, south, north = self.box
            longitudes = near_longitude(values[:, 0], self.reference)
            outside = (longitudes < west) | (longitudes > east)
            outside |= (values[:, 1] < south) | (values[:, 1] > north)
            if outside.any():
                raise ScenarioError(
                    f"{what} at {place_name(*values[outside][0])} is not accepted; it lies outside "
                    f"the region west {west:g}, east {east:g}, south {south:g}, north {north:g}"
                )
        if land.any():
            distance, bearing = self.distance_to_sea_km(*values[land][0])
            far = f"{distance:.1f} km from the sea toward {_POINTS[round(bearing / 45) % 8]}"
            share = "" if len(land) == 1 else f" ({land.sum()} of {len(land)} points do)"
            place = place_name(*values[land][0])
            raise ScenarioError(f"{what} at {place} is not accepted; it lies on land, {far}{share}")

    def with_stretches(
        self, stretches: Mapping[str, BaseGeometry | Box | tuple[BaseGeometry, float]]
    ) -> LandCoast:
        """Name stretches of coast.

        Parameters
        ----------
        stretches : mapping
            Name → a shapely polygon; or (west, east, south, north) [degrees]; or (line, km): what
            lies within so many km of a shapely line. Where they overlap, the first counts.

        Raises
        ------
        ScenarioError
            A stretch is none of these.
        """
        areas = {name: _stretch(name, value) for name, value in stretches.items()}
        return replace(self, stretches=areas)

    def divide(self, length_km: float) -> LandCoast:
        """Name stretches of equal length along each coast line.

        Parameters
        ----------
        length_km : float
            Length wanted [km]: each coast line has the whole number of equal stretches whose
            length is nearest, at least one. Sides of the region are no coast.

        Returns
        -------
        LandCoast
            Its stretches are called by the polygon's name, or "coast", and their number from 1 on.

        Raises
        ------
        ScenarioError
            The length is not above 0, or would make more than a million stretches.
        """
        import shapely

        _check_within("length_km", length_km, 1e-3, 1e5)
        geod = geodesic()
        measured: list[tuple[str, Float, Float, int]] = []
        for polygon in self._land:
            inside = self.polygon_of([polygon.representative_point().coords[0]])[0]
            name = self.names[inside] or "coast"
            for ring in shapely.get_rings(polygon):
                for line in self._open(ring):
                    steps = geod.inv(*line[:-1].T, *line[1:].T)[2]
                    along = np.concatenate([[0.0], np.cumsum(steps)]) / 1000
                    count = max(1, round(along[-1] / length_km))
                    measured.append((name, line, along, count))
        total = sum(count for *_, count in measured)
        if total > 1_000_000:
            raise ScenarioError(
                f"length_km: {length_km} is not accepted; it would make {total} stretches"
            )
        stretches: dict[str, BaseGeometry] = {}
        numbers: dict[str, int] = {}
        for name, line, along, count in measured:
            ends = np.linspace(0, along[-1], count + 1)
            corners = np.column_stack([np.interp(ends, along, x) for x in line.T])
            inner = np.searchsorted(along, ends)
            for k in range(count):
                numbers[name] = numbers.get(name, 0) + 1
                first, last = inner[k], inner[k + 1]
                middle = line[first:last][along[first:last] > ends[k]]
                piece = np.concatenate([corners[k : k + 1], middle, corners[k + 1 : k + 2]])
                stretches[f"{name} {numbers[name]}"] = shapely.LineString(piece)
        return replace(self, stretches=stretches)

    @property
    def stretch_names(self) -> tuple[str, ...]:
        """Names of the stretches, in their order."""
        return tuple(self.stretches)

    def stretch_of(self, points: ArrayLike) -> Integer:
        """Say on which stretch points of the coast lie.

        Parameters
        ----------
        points : array_like, shape (n, 2)
            Longitude and latitude [degrees].

        Returns
        -------
        ndarray of int, shape (n,)
            Index into `stretch_names`: the first area that holds the point, or the nearest of the
            lines that `divide` made; -1 where there is none.
        """
        import shapely

        given = self._points(points)
        found = np.full(len(given), -1)
        areas = np.array(list(self.stretches.values()), dtype=object)
        if not len(areas):
            return found
        if areas[0].geom_type == "LineString":
            return np.asarray(shapely.STRtree(areas).nearest(given), dtype=np.int64)
        area, point = shapely.STRtree(given).query(areas, predicate="intersects")
        # From the last to the first, which so has the last word.
        order = np.argsort(-area, kind="stable")
        found[point[order]] = area[order]
        return found

    def _open(self, ring: BaseGeometry) -> list[Float]:
        """Lines of a ring that are coast: all of it, or what the sides of the region leave."""
        import shapely

        points = shapely.get_coordinates(ring)
        if self.box is None:
            return [points]
        west, east, south, north = self.box
        x, y = points.T
        on = np.stack([x == west, x == east, y == south, y == north])
        side = (on[:, :-1] & on[:, 1:]).any(axis=0)
        if not side.any():
            return [points]
        # Begin with a side, so that no line is torn where the ring happens to begin.
        start = int(np.argmax(side))
        points = np.concatenate([points[start:-1], points[: start + 1]])
        side = np.roll(side, -start)
        edges = np.flatnonzero(np.diff(np.concatenate([[1], side, [1]])))
        return [points[a : b + 1] for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _stretch(name: str, value: Any) -> BaseGeometry:
    import shapely
    from shapely.geometry.base import BaseGeometry

    if isinstance(value, BaseGeometry):
        areas = [value]
    elif isinstance(value, tuple | list) and len(value) == 4:
        west, east, south, north = (float(side) for side in value)
        east = east + _CIRCLE if east < west else east
        areas = [shapely.box(west, south, east, north)] if south < north else []
    elif (
        isinstance(value, tuple | list)
        and len(value) == 2
        and isinstance(value[0], BaseGeometry)
        and value[1] > 0
    ):
        areas = [_buffered(*value)]
    else:
        areas = []
    kept = [a for a in areas if a.geom_type in {"Polygon", "MultiPolygon"} and a.area > 0]
    if not kept:
        raise ScenarioError(
            f"stretches.{name}: {value!r} is not accepted; it should be a shapely polygon, "
            "(west, east, south, north), or (a shapely line, km)"
        )
    area = shapely.make_valid(kept[0])
    # In each of the turns that a point may be seen in.
    turns = [_shifted(area, shift) for shift in (-_CIRCLE, 0.0, _CIRCLE)]
    return shapely.union_all(turns)


def _check_within(name: str, value: Any, low: float, high: float) -> None:
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    if not number or not low <= value <= high:
        raise ScenarioError(
            f"{name}: {value!r} is not accepted; it should be a number from {low:g} to {high:g}"
        )


def place_name(longitude: float, latitude: float) -> str:
    """Write a position as people do."""
    longitude = float(near_longitude(longitude, 0))
    east, north = "W" if longitude < 0 else "E", "S" if latitude < 0 else "N"
    return f"{abs(latitude):.4f} {north} {abs(longitude):.4f} {east}"


def _read_geojson(file: Path, name_column: str | None) -> tuple[Geometries, list[Any], str | None]:
    from shapely.geometry import shape

    try:
        data = file.read_bytes()
        document = json.loads(gzip.decompress(data) if file.suffix.lower() == ".gz" else data)
    except (OSError, EOFError, ValueError) as error:
        raise ScenarioError(f"{file}: cannot be read as GeoJSON: {error}") from None
    if not isinstance(document, dict):
        raise ScenarioError(f"{file}: cannot be read as GeoJSON: it holds no object")
    kind = document.get("type")
    if kind == "FeatureCollection":
        features = document.get("features") or []
        if not isinstance(features, list):
            raise ScenarioError(f"{file}: cannot be read as GeoJSON: features should be a list")
    else:
        bare = kind != "Feature"
        features = [{"geometry": document, "properties": {}} if bare else document]
    geometries, names = [], []
    for number, feature in enumerate(features):
        try:
            geometry = feature.get("geometry")
            geometries.append(None if geometry is None else shape(geometry))
            names.append((feature.get("properties") or {}).get(name_column))
        except Exception as error:
            raise ScenarioError(f"{file}: feature {number} is no geometry: {error}") from None
    if name_column is not None and not any(name is not None for name in names):
        known = sorted({key for f in features for key in f.get("properties") or {}})
        raise ScenarioError(_no_column(name_column, known))
    # RFC 7946 has longitude and latitude only; the GeoJSON before it could name another system.
    system = "OGC:CRS84"
    named = document.get("crs")
    if isinstance(named, dict) and isinstance(named.get("properties"), dict):
        system = str(named["properties"].get("name", system))
    return _array(geometries), names, system


def _read_layer(
    file: Path, name_column: str | None, layer: str | None
) -> tuple[Geometries, list[Any], str | None]:
    need_geo("pyogrio")
    import pyogrio  # type: ignore[import-untyped]  # has no types
    import shapely

    try:
        layers = [str(name) for name in pyogrio.list_layers(file)[:, 0]]
        if layer not in layers and (layer is not None or len(layers) != 1):
            raise ScenarioError(
                f"layer: {layer!r} is not accepted; {file.name} has {', '.join(map(repr, layers))}"
            )
        info = pyogrio.read_info(file, layer=layer)
        known = [str(name) for name in info["fields"]]
        if name_column is not None and name_column not in known:
            raise ScenarioError(_no_column(name_column, known))
        columns = [] if name_column is None else [name_column]
        meta, _, wkb, values = pyogrio.raw.read(file, layer=layer, columns=columns)
    except ScenarioError:
        raise
    except Exception as error:
        # GDAL answers a damaged file with whatever the damage leads it to.
        raise ScenarioError(f"{file}: cannot be read as a map: {error}") from None
    if wkb is None:
        raise ScenarioError(f"{file}: is a table without geometry; give a map of land polygons")
    names = [None] * len(wkb) if name_column is None else list(values[0])
    return np.asarray(shapely.from_wkb(wkb), dtype=object), names, meta["crs"]


def _no_column(name: str, known: list[str]) -> str:
    listed = ", ".join(known) or "none"
    return f"name_column: {name!r} is not accepted; the columns are: {listed}"


def _array(geometries: Sequence[Any]) -> Geometries:
    array = np.empty(len(geometries), dtype=object)
    array[:] = geometries
    return array


def _in_degrees(geometries: Geometries, system: str | None, label: str) -> Geometries:
    """Reproject to longitude and latitude where the reference system is another."""
    import shapely

    if system is None:
        warn(f"{label}: says no reference system; longitude and latitude in degrees are assumed")
        return geometries
    if system.upper() in {"EPSG:4326", "OGC:CRS84", "URN:OGC:DEF:CRS:OGC:1.3:CRS84"}:
        return geometries
    need_geo("pyproj")
    import pyproj

    try:
        change = pyproj.Transformer.from_crs(system, "EPSG:4326", always_xy=True)
    except pyproj.exceptions.CRSError as error:
        raise ScenarioError(f"{label}: unknown reference system {system!r}: {error}") from None
    return np.asarray(
        shapely.transform(
            shapely.force_2d(geometries), lambda x: np.column_stack(change.transform(*x.T))
        ),
        dtype=object,
    )


def _polygons(shapes: Geometries, label: str) -> tuple[Geometries, Integer]:
    """Polygons of all geometries, and the index of each one's geometry."""
    import shapely

    parts, owner = shapely.get_parts(shapes, return_index=True)
    while len(parts) and (shapely.get_type_id(parts) > 3).any():
        parts, inner = shapely.get_parts(parts, return_index=True)
        owner = owner[inner]
    full = ~shapely.is_empty(parts)
    parts, owner = parts[full], owner[full]
    other = np.flatnonzero(shapely.get_type_id(parts) != 3)
    if len(other):
        raise ScenarioError(
            f"{label}: feature {owner[other[0]]} is a {parts[other[0]].geom_type}, which is not "
            "accepted; land should be polygons"
        )
    if not len(parts):
        raise ScenarioError(f"{label}: holds no polygon; land should be polygons")
    return parts, owner


def _check_degrees(polygons: Geometries, label: str) -> None:
    import shapely

    # Those of holes too, which bounds of polygons leave out.
    coordinates = shapely.get_coordinates(polygons)
    if not (np.abs(coordinates) <= [_CIRCLE, 90]).all():
        bounds = [*coordinates.min(axis=0), *coordinates.max(axis=0)]
        shown = ", ".join(f"{value:g}" for value in bounds)
        raise ScenarioError(
            f"{label}: bounds {shown} are not accepted; they should be longitudes from -360 to "
            "360 and latitudes from -90 to 90 [degrees]"
        )


def _unwrapped(polygons: Geometries, label: str) -> Geometries:
    """Let rings that jump at the dateline run on beyond it."""
    import shapely

    coordinates, ring = shapely.get_coordinates(shapely.get_rings(polygons), return_index=True)
    steps = np.abs(np.diff(coordinates[:, 0]))
    jumping = (steps > 180) & (np.diff(ring) == 0)
    if not jumping.any():
        return polygons
    owner = shapely.get_rings(polygons, return_index=True)[1]
    result = polygons.copy()
    for k in np.unique(owner[ring[:-1][jumping]]):
        result[k] = shapely.Polygon(
            _run_on(polygons[k].exterior, label), [_run_on(r, label) for r in polygons[k].interiors]
        )
    return result


def _run_on(ring: BaseGeometry, label: str) -> Float:
    import shapely

    points = shapely.get_coordinates(ring)
    longitudes = np.unwrap(points[:, 0], period=_CIRCLE)
    if abs(longitudes[-1] - longitudes[0]) < 1 and np.ptp(longitudes) > 0:
        return np.column_stack([longitudes, points[:, 1]])
    steps = np.abs(np.diff(points[:, 0]))
    # Sides around the whole world, as where Antarctica runs along the pole, are meant so.
    if (steps[steps > 180] == _CIRCLE).all():
        return points
    raise ScenarioError(
        f"{label}: a ring around a pole, near {place_name(*points[0])}, is not accepted; it should "
        "run along the dateline to the pole, along the pole, and back"
    )


def _repaired(polygons: Geometries, owner: Integer, label: str) -> tuple[Geometries, Integer]:
    """Make polygons valid and free of repeated points; give the index of each one's geometry."""
    import shapely

    polygons = shapely.remove_repeated_points(polygons)
    broken = np.flatnonzero(~shapely.is_valid(polygons))
    if not len(broken):
        return polygons, owner
    reasons = shapely.is_valid_reason(polygons[broken[:_SHOWN]])
    shown = "; ".join(
        f"feature {owner[k]}: {reason}" for k, reason in zip(broken, reasons, strict=False)
    )
    more = f"; and {len(broken) - _SHOWN} more" if len(broken) > _SHOWN else ""
    warn(f"{label}: polygons were repaired by parity: {shown}{more}")
    parts, of = _areas(shapely.make_valid(polygons[broken]))
    sound = np.delete(np.arange(len(polygons)), broken)
    return np.concatenate([polygons[sound], parts]), np.concatenate(
        [owner[sound], owner[broken][of]]
    )


def _areas(shapes: Geometries) -> tuple[Geometries, Integer]:
    """Polygons among the parts of geometries, and the index of each one's geometry."""
    import shapely

    parts, owner = shapely.get_parts(np.atleast_1d(shapes), return_index=True)
    parts, inner = shapely.get_parts(parts, return_index=True)
    kept = (shapely.get_type_id(parts) == 3) & (shapely.area(parts) > 0)
    return parts[kept], owner[inner][kept]


def _joined(
    polygons: Geometries,
    owner: Integer,
    names: Sequence[str | None] | None = None,
    seam: float | None = None,
) -> tuple[Geometries, Integer]:
    """Join polygons that touch, of one name and at one meridian where these are given."""
    import shapely
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if len(polygons) < 2:
        return polygons, owner
    candidates = np.arange(len(polygons))
    if seam is not None:
        west, _, east, _ = shapely.bounds(polygons).T
        at = [np.abs(near_longitude(x - seam, 0)) < 1e-9 for x in (west, east)]
        candidates = np.flatnonzero(at[0] | at[1])
    tree = shapely.STRtree(polygons[candidates])
    a, b = candidates[tree.query(polygons[candidates], predicate="intersects")]
    kept = a < b
    if names is not None:
        labels = np.array([str(names[k]) for k in owner])
        kept &= labels[a] == labels[b]
    if not kept.any():
        return polygons, owner
    a, b = a[kept], b[kept]
    links = coo_array((np.ones(len(a)), (a, b)), shape=(len(polygons), len(polygons)))
    group = connected_components(links, directed=False)[1]
    touched = np.unique(group[a])
    alone = ~np.isin(group, touched)
    unions, sources = [polygons[alone]], [owner[alone]]
    for number in touched:
        members = np.flatnonzero(group == number)
        parts, _ = _areas(_array([shapely.union_all(polygons[members])]))
        unions.append(parts)
        sources.append(np.full(len(parts), owner[members[0]]))
    return np.concatenate(unions), np.concatenate(sources)


def _plane(longitude: float, latitude: float) -> pyproj.Transformer:
    """Give the plane [m] that shows distances and bearings from a point as they are."""
    need_geo("pyproj")
    import pyproj

    return pyproj.Transformer.from_crs(
        "EPSG:4326",
        f"+proj=aeqd +lon_0={longitude} +lat_0={latitude} +ellps=WGS84",
        always_xy=True,
    )


def _shifted(shapes: Any, degrees: float) -> Any:
    """Turn geometries eastward."""
    import shapely

    return shapely.transform(shapes, lambda x: x + np.array([degrees, 0.0]))


def _buffered(line: BaseGeometry, km: float) -> BaseGeometry:
    """Area within so many km of a line, in longitude and latitude."""
    import shapely

    centre = line.centroid
    plane = _plane(centre.x, centre.y)
    flat = shapely.transform(line, lambda x: np.column_stack(plane.transform(*x.T)))
    round_it = shapely.buffer(flat, 1000 * km, quad_segs=16)

    def back(x: Float) -> Float:
        longitude, latitude = plane.transform(x[:, 0], x[:, 1], direction="INVERSE")
        return np.column_stack([near_longitude(longitude, centre.x), latitude])

    return shapely.transform(round_it, back)
