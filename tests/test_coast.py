"""Coasts: read, repaired, cut, and asked, with distances as pyproj measures them."""

import gzip
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pyproj
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

import driftcore as dc
from driftcore.coast import LandCoast, near_longitude

GEOD = pyproj.Geod(ellps="WGS84")
SHARED = Path(__file__).parents[2] / "shared/data/coast"

# Land with a lake, and an island.
MAINLAND = shapely.box(-4, 46, -1, 49) - shapely.box(-3, 47, -2, 48)
ISLAND = shapely.box(-6, 46, -5, 47)
LAND = [MAINLAND, ISLAND]
NAMES = ["mainland", "island"]


@pytest.fixture(scope="module")
def world() -> LandCoast:
    return LandCoast.default()


@pytest.fixture
def coast() -> LandCoast:
    return LandCoast.from_geometries(LAND, NAMES)


def parity(rings: list[Any], longitude: float, latitude: float) -> bool:
    """Whether an odd number of rings surrounds a point: crossings of a ray to the east."""
    crossings = 0
    for ring in rings:
        (x, y), (u, v) = ring.T, np.roll(ring, -1, axis=0).T
        spans = (y > latitude) != (v > latitude)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossings += np.sum(spans & (longitude < x + (latitude - y) / (v - y) * (u - x)))
    return bool(crossings % 2)


def write(path: Path, layer: str | None = None, crs: str | None = "EPSG:4326", **more: Any) -> None:
    shapes = more.pop("shapes", LAND)
    pyogrio.raw.write(
        path,
        geometry=shapely.to_wkb(np.array(shapes)),
        field_data=[np.array(NAMES[: len(shapes)], dtype=object)],
        fields=np.array(["name"], dtype=object),
        geometry_type="Unknown" if path.suffix == ".gpkg" else "Polygon",
        crs=crs,
        layer=layer,
        **more,
    )


def features(*shapes: Any, names: list[str] = NAMES, **more: Any) -> dict[str, Any]:
    return {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": {"name": name},
                "geometry": shapely.geometry.mapping(shape),
            }
            for shape, name in zip(shapes, names, strict=False)
        ],
        **more,
    }


def same_land(one: LandCoast, other: LandCoast, tolerance: float = 0.0) -> bool:
    difference = shapely.symmetric_difference(
        shapely.union_all(one.polygons), shapely.union_all(other.polygons)
    )
    return bool(difference.area <= tolerance)


def test_every_kind_of_file_gives_the_same_land(tmp_path: Path, coast: LandCoast) -> None:
    text = json.dumps(features(*LAND))
    (tmp_path / "land.geojson").write_text(text)
    (tmp_path / "land.geojson.gz").write_bytes(gzip.compress(text.encode()))
    write(tmp_path / "land.shp")
    write(tmp_path / "land.gpkg")
    for name in ("land.geojson", "land.geojson.gz", "land.shp", "land.gpkg"):
        read = LandCoast.from_file(tmp_path / name, name_column="name")
        assert same_land(read, coast), name
        assert read.names == ("mainland", "island")
        assert read.label == name
    assert LandCoast.from_file(tmp_path / "land.shp").names == (None, None)
    single = shapely.geometry.mapping(shapely.GeometryCollection(LAND))
    (tmp_path / "bare.json").write_text(json.dumps(single))
    assert same_land(LandCoast.from_file(tmp_path / "bare.json"), coast)


@pytest.mark.parametrize("name", ["land.gpkg", "land.shp", "land.geojson"])
def test_other_reference_systems_are_reprojected(
    tmp_path: Path, coast: LandCoast, name: str
) -> None:
    lambert = "EPSG:2154"
    there = pyproj.Transformer.from_crs("EPSG:4326", lambert, always_xy=True)
    shapes = [shapely.transform(x, lambda p: np.column_stack(there.transform(*p.T))) for x in LAND]
    if name.endswith("geojson"):
        system = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::2154"}}
        (tmp_path / name).write_text(json.dumps(features(*shapes, crs=system)))
    else:
        write(tmp_path / name, crs=lambert, shapes=shapes)
    # Straight sides stay corners joined straight: 1e-8 degrees there and back, along 30 degrees.
    assert same_land(LandCoast.from_file(tmp_path / name), coast, tolerance=1e-6)


def test_a_missing_reference_system_is_said(tmp_path: Path, coast: LandCoast) -> None:
    with pytest.warns(UserWarning, match="crs"):  # of pyogrio, on writing
        write(tmp_path / "land.shp", crs=None)
    with pytest.warns(dc.DriftCoreWarning, match=r"land.shp: says no reference system; longitude"):
        assert same_land(LandCoast.from_file(tmp_path / "land.shp"), coast)


def test_layers_are_chosen_by_name(tmp_path: Path, coast: LandCoast) -> None:
    path = tmp_path / "map.gpkg"
    write(path, layer="land")
    write(path, layer="parks", shapes=[ISLAND], append=True)
    assert same_land(LandCoast.from_file(path, layer="land"), coast)
    for layer in (None, "sea"):
        with pytest.raises(dc.ScenarioError, match=f"layer: {layer!r} is .* 'land', 'parks'"):
            LandCoast.from_file(path, layer=layer)


def test_rings_tell_land_by_parity(coast: LandCoast) -> None:
    rings = coast.rings()
    assert len(rings) == 3
    assert all(ring.flags.c_contiguous and (ring[0] != ring[-1]).any() for ring in rings)
    points = np.random.default_rng(1).uniform([-7, 45], [0, 50], (300, 2))
    land = coast.is_land(points)
    np.testing.assert_array_equal(land, [parity(rings, *point) for point in points])
    np.testing.assert_array_equal(
        land, shapely.contains_xy(shapely.union_all(LAND), points[:, 0], points[:, 1])
    )
    assert 0 < land.sum() < 300


def test_land_that_overlaps_or_touches_has_one_coast_line() -> None:
    overlapping = [shapely.box(0, 0, 2, 2), shapely.box(1, 1, 3, 3), shapely.box(3, 0, 4, 4)]
    coast = LandCoast.from_geometries(overlapping, ["a", "b", "c"])
    assert len(coast) == 3  # by name
    (ring,) = coast.rings()  # but of one piece
    assert shapely.equals(shapely.Polygon(ring), shapely.union_all(overlapping))
    assert parity([ring], 1.5, 1.5)
    assert [coast.names[k] for k in coast.polygon_of([[0, 0], [3.9, 4.1]])] == ["a", "c"]


def test_a_bow_tie_is_repaired_and_said() -> None:
    tie = shapely.Polygon([(0, 0), (2, 2), (2, 0), (0, 2)])
    with pytest.warns(dc.DriftCoreWarning, match=r"repaired by parity: feature 1: Self-inter.*1 1"):
        coast = LandCoast.from_geometries([ISLAND, tie], ["island", "tie"])
    assert coast.names == ("island", "tie", "tie")
    np.testing.assert_array_equal(
        coast.is_land([[0.5, 1], [1.5, 1], [1, 0.2], [1, 1.8]]), [True, True, False, False]
    )
    assert shapely.is_valid(coast.polygons).all()


def test_repeated_points_and_heights_are_dropped() -> None:
    corners = [(0, 0, 5), (1, 0, 5), (1, 0, 6), (1, 1, 5), (0, 1, 5), (0, 1, 5)]
    (ring,) = LandCoast.from_geometries(shapely.Polygon(corners)).rings()
    np.testing.assert_array_equal(ring, [[0, 0], [1, 0], [1, 1], [0, 1]])


CHUKOTKA = {
    "split": shapely.MultiPolygon([shapely.box(170, 62, 180, 70), shapely.box(-180, 62, -170, 70)]),
    "beyond": shapely.box(170, 62, 190, 70),
    "beyond to the west": shapely.box(-190, 62, -170, 70),
    "jumping": shapely.Polygon([(170, 62), (-170, 62), (-170, 70), (170, 70)]),
    "jumping at it": shapely.Polygon(
        [(170, 62), (180, 62), (-180, 62), (-170, 62), (-170, 70), (170, 70)]
    ),
}


@pytest.mark.parametrize("way", CHUKOTKA)
def test_land_over_the_dateline_is_one_however_written(way: str) -> None:
    coast = LandCoast.from_geometries(CHUKOTKA[way], ["Chukotka"])
    points = [[175, 66], [-175, 66], [180, 66], [-180, 66], [185, 66], [-10, 66], [165, 66]]
    np.testing.assert_array_equal(coast.is_land(points), [True] * 5 + [False] * 2)
    for region in (coast.cut(160, 200, 60, 72), coast.cut(160, -160, 60, 72)):
        (polygon,) = region.polygons
        assert polygon.bounds == (170, 62, 190, 70)
        assert region.names == ("Chukotka",)
        (ring,) = region.rings()
        assert len(ring) >= 4
        np.testing.assert_array_equal(region.is_land(points), [True] * 5 + [False] * 2)
    assert len(coast.polygons) == 2  # split at ±180 again


def test_land_around_a_pole_is_closed_along_it() -> None:
    """As plane maps have Antarctica, and as an ice cap ends at a parallel."""
    shore = [(longitude, -70 + 5 * (longitude % 100 == 0)) for longitude in range(-180, 181, 20)]
    coast = LandCoast.from_geometries(shapely.Polygon([(-180, -90), *shore, (180, -90)]))
    points = [[0, -89.9], [179, -71], [-179, -71], [0, -66], [10, -64], [40, -69]]
    np.testing.assert_array_equal(coast.is_land(points), [True] * 4 + [False] * 2)


def test_collections_in_collections_are_taken_apart() -> None:
    nested = shapely.GeometryCollection([shapely.GeometryCollection([ISLAND]), MAINLAND])
    coast = LandCoast.from_geometries([shapely.box(5, 46, 6, 47), nested], ["east", "west"])
    assert coast.names == ("east", "west", "west")
    np.testing.assert_array_equal(
        coast.is_land([[5.5, 46.5], [-5.5, 46.5], [-1.5, 46.5], [-2.5, 47.5]]),
        [True, True, True, False],
    )


def test_the_whole_world_can_be_turned(world: LandCoast) -> None:
    turned = world.around(180)
    assert shapely.is_valid(turned.polygons).all()
    assert np.isclose(shapely.area(turned.polygons).sum(), shapely.area(world.polygons).sum())
    points = np.random.default_rng(2).uniform([-180, -90], [180, 90], (2000, 2))
    np.testing.assert_array_equal(world.is_land(points), turned.is_land(points))
    # 29 % of the Earth is land.
    weights = np.cos(np.radians(points[:, 1]))
    assert np.isclose(np.average(world.is_land(points), weights=weights), 0.29, atol=0.03)


def test_known_places(world: LandCoast) -> None:
    named = {
        "Fiji, Viti Levu": (178.0, -17.8, True),
        "Fiji, across the dateline": (-179.9, -16.7, False),
        "Chukotka, west of 180": (178.0, 67.0, True),
        "Chukotka, east of 180": (-175.0, 66.5, True),
        "Caspian Sea": (50.5, 42.0, False),
        "Bay of Biscay": (-5.0, 45.0, False),
        "South Pole": (0.0, -89.95, True),
        "North Pole": (0.0, 90.0, False),
    }
    values = np.array(list(named.values()))
    land = dict(zip(named, world.is_land(values[:, :2]), strict=True))
    assert land == {name: bool(value[2]) for name, value in named.items()}
    fiji = world.cut(175, -175, -20, -15)
    assert fiji.polygons.size > 5
    bounds = shapely.total_bounds(fiji.polygons)
    assert 175 <= bounds[0] < 178
    assert 180 < bounds[2] <= 185


def test_the_bundled_land_is_that_of_the_bay(world: LandCoast) -> None:
    path = SHARED / "natural_earth_50m_biscay_land.geojson"
    if not path.is_file():
        pytest.skip(f"the land of the Bay of Biscay is not at {path}")
    other = LandCoast.from_file(path)
    bay = world.cut(-8, 2, 43, 50.5)
    # Another edition on another grid (0.004 degrees): a thousandth of 30 square degrees.
    assert same_land(bay, other, tolerance=0.03)
    assert len(bay) == len(other)


def test_a_cut_keeps_what_is_inside(coast: LandCoast) -> None:
    region = coast.cut(-5.5, 0, 45, 47.5)
    assert same_land(
        region, LandCoast.from_geometries(shapely.union_all(LAND) & shapely.box(-5.5, 45, 0, 47.5))
    )
    assert region.box == (-5.5, 0.0, 45.0, 47.5)
    assert same_land(region.cut(-5, -1, 45, 46.5), coast.cut(-5, -1, 45, 46.5))
    assert same_land(region.cut(355, 359, 45, 46.5), coast.cut(-5, -1, 45, 46.5))
    assert coast.cut(10, 20, 45, 50).rings() == []
    with pytest.raises(dc.ScenarioError, match=r"has been cut to .* and is not known outside"):
        region.cut(-7, 0, 45, 47)
    with pytest.raises(dc.ScenarioError, match="turn it before the cut"):
        region.around(180)


@pytest.mark.parametrize(
    ("sides", "message"),
    [
        ((0, 400, 0, 1), "east: 400 is not accepted; it should be a number from -360 to 360"),
        ((0, 1, -91, 1), "south: -91 is not accepted"),
        (("w", 1, 0, 1), "west: 'w' is not accepted"),
        ((0, 1, 5, 5), "region: west 0, east 1, south 5, north 5 is not accepted"),
        ((1, 1, 0, 5), "region: west 1, east 1, .* east should be above west"),
        ((-3.9, -3.5, 46.1, 48.9), "it is all land of polygons given in Python"),
    ],
)
def test_what_is_no_region_is_refused(coast: LandCoast, sides: Any, message: str) -> None:
    with pytest.raises(dc.ScenarioError, match=message):
        coast.cut(*sides)


@pytest.mark.parametrize(
    ("longitude", "latitude", "bearing"), [(-3.9, 48.5, 270), (-1.3, 46.5, 90), (-3.4, 46.1, 180)]
)
def test_the_way_to_the_sea_is_the_shortest_geodesic(
    coast: LandCoast, longitude: float, latitude: float, bearing: float
) -> None:
    km, toward = coast.distance_to_sea_km(longitude, latitude)
    ring = coast.rings()
    fine = [
        shapely.get_coordinates(shapely.segmentize(shapely.LinearRing(line), 1e-3)) for line in ring
    ]
    shore = np.concatenate(fine)
    metres = GEOD.inv(*np.full_like(shore, (longitude, latitude)).T, *shore.T)[2]
    # Metres: the shore is sampled every 1e-3 degrees here, and cut into straight sides there.
    assert km == pytest.approx(metres.min() / 1000, abs=2e-3)
    assert toward == pytest.approx(bearing, abs=2)


def test_land_is_refused_with_the_way_to_the_sea(world: LandCoast) -> None:
    bay = world.cut(-8, 2, 43, 50.5)
    km, bearing = bay.distance_to_sea_km(-1.0, 44.5)
    lon, lat, _ = GEOD.fwd(-1.0, 44.5, bearing, 1001 * km)
    assert not bay.is_land([[lon, lat]])[0]
    lon, lat, _ = GEOD.fwd(-1.0, 44.5, bearing, 999 * km)
    assert bay.is_land([[lon, lat]])[0]
    with pytest.raises(
        dc.ScenarioError,
        match=rf"the release at 44.5000 N 1.0000 W .* lies on land, {km:.1f} km from the sea to",
    ):
        bay.check_afloat([[-5, 46], [-1.0, 44.5]])
    with pytest.raises(
        dc.ScenarioError, match=r"the buoy at 40.0000 N 5.0000 W .* outside the reg"
    ):
        bay.check_afloat([[-5, 40]], what="the buoy")
    bay.check_afloat([[-5, 46], [355, 46]])
    assert bay.distance_to_sea_km(-5, 46)[0] == 0
    # The side of the region, 0.1 degrees away, is no coast.
    assert bay.distance_to_sea_km(1.9, 47)[0] > 100


def test_the_way_to_the_sea_over_the_dateline(world: LandCoast) -> None:
    chukotka = world.cut(170, 190, 60, 72)
    # Whichever turn the longitude is in.
    km, bearing = chukotka.distance_to_sea_km(180, 68)
    assert chukotka.distance_to_sea_km(-180, 68) == pytest.approx((km, bearing))
    lon, lat, _ = GEOD.fwd(180, 68, bearing, 1000 * km)
    shore = shapely.union_all(world.cut(165, 195, 55, 75).polygons).boundary
    at = shapely.Point(near_longitude(lon, 180), lat)
    # [degrees] 1e-6 is a decimetre.
    assert shore.distance(at) < 1e-5


def test_a_missing_library_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(
        dc.DriftCoreError, match=r'shapely, which is .* pip install "driftcore\[geo'
    ):
        LandCoast.from_geometries(LAND)


def test_a_point_of_the_coast_lies_on_the_nearest_polygon(coast: LandCoast) -> None:
    at = coast.polygon_of([[-1, 47], [-5.001, 46.5], [354, 46.5], [-2.5, 47.5]])
    assert [coast.names[k] for k in at] == ["mainland", "island", "island", "mainland"]
    points = np.random.default_rng(3).uniform([-7, 45], [0, 50], (200, 2))
    away = shapely.distance(coast.polygons[:, None], shapely.points(points))
    chosen = away[coast.polygon_of(points), np.arange(200)]
    np.testing.assert_allclose(chosen, away.min(axis=0), rtol=0, atol=1e-12)
    nowhere = coast.cut(10, 20, 45, 50)
    assert nowhere.polygon_of([[12, 46]]) == -1
    assert not nowhere.is_land([[12, 46]])[0]


def test_named_stretches(coast: LandCoast) -> None:
    named = coast.with_stretches(
        {
            "south": (-7, 0, 45, 46.5),
            "west": shapely.box(-7, 45, -4.5, 50),
            "line": (shapely.LineString([(-1, 46), (-1, 49)]), 20),
        }
    )
    assert named.stretch_names == ("south", "west", "line")
    width = 1000 * np.array([19.9, 20.1])
    lon, lat, _ = GEOD.fwd([-1, -1], [48, 48], [90, 90], width)
    points = [[-6, 46.2], [-6, 46.8], [354, 46.8], [-3, 48.8], *zip(lon, lat, strict=True)]
    np.testing.assert_array_equal(named.stretch_of(points), [0, 1, 1, -1, 2, -1])
    assert (coast.stretch_of(points) == -1).all()
    over = coast.with_stretches({"dateline": (170, -170, 0, 1)})
    np.testing.assert_array_equal(over.stretch_of([[175, 0.5], [-175, 0.5], [0, 0.5]]), [0, 0, -1])


@given(st.floats(5, 500))
def test_equal_stretches_cover_the_coast(length_km: float) -> None:
    coast = LandCoast.from_geometries(LAND, NAMES).divide(length_km)
    lengths = np.array([GEOD.geometry_length(line) for line in coast.stretches.values()]) / 1000
    names = np.array([name.split()[0] for name in coast.stretch_names])
    rings = shapely.get_rings(np.array(LAND))
    whole = sum(GEOD.geometry_length(ring) for ring in rings) / 1000
    assert lengths.sum() == pytest.approx(whole, rel=1e-4)
    island = lengths[names == "island"]
    assert np.ptp(island) < 1e-3 * island.mean()
    assert len(island) == max(1, round(island.sum() / length_km))
    lines = list(coast.stretches.values())
    middles = shapely.get_coordinates(shapely.line_interpolate_point(lines, 0.5, normalized=True))
    np.testing.assert_array_equal(coast.stretch_of(middles), np.arange(len(middles)))


def test_sides_of_the_region_belong_to_no_stretch(coast: LandCoast) -> None:
    region = coast.cut(-3.5, 0, 46.5, 48.5).divide(1000)
    drawn = shapely.union_all(list(region.stretches.values()))
    lake = shapely.LinearRing(MAINLAND.interiors[0].coords)
    shore = shapely.LineString([(-1, 46.5), (-1, 48.5)])
    assert drawn.symmetric_difference(shapely.union_all([lake, shore])).length < 1e-9


@pytest.mark.parametrize(
    ("stretch", "shown"),
    [
        ((0, 1, 2, 1), "0, 1, 2, 1"),
        ((0, 1), "0, 1"),
        ((shapely.LineString([(0, 0), (1, 1)]), 0), "LINESTRING"),
        (shapely.Point(0, 0), "POINT"),
        ("x", "'x'"),
    ],
)
def test_what_is_no_stretch_is_refused(coast: LandCoast, stretch: Any, shown: str) -> None:
    with pytest.raises(dc.ScenarioError, match=rf"stretches.here: .*{shown}.* is not accepted; it"):
        coast.with_stretches({"here": stretch})
    for length in (0, -1, "long", np.nan):
        with pytest.raises(dc.ScenarioError, match=f"length_km: {length!r} is not accepted"):
            coast.divide(length)
    with pytest.raises(
        dc.ScenarioError,
        match=r"length_km: 0\.001 is not accepted; it would make 1[0-9]{6} ",
    ):
        coast.divide(1e-3)


@given(st.floats(-400, 400), st.floats(-360, 360))
def test_near_longitudes(longitude: float, reference: float) -> None:
    near = near_longitude(longitude, reference)
    assert near - reference + 1e-9 >= -180
    assert near - reference - 1e-9 <= 180
    assert np.isclose((near - longitude) / 360, np.rint((near - longitude) / 360), atol=1e-12)
    if -180 <= longitude - reference < 180:
        assert near == longitude


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("none.geojson", None, "path: .* is not accepted; there is no such file"),
        ("bad.geojson", "{", "bad.geojson: cannot be read as GeoJSON"),
        ("bad.geojson.gz", "{", "cannot be read as GeoJSON"),
        ("list.geojson", "[1]", "list.geojson: cannot be read as GeoJSON: it holds no object"),
        (
            "text.geojson",
            json.dumps({"type": "FeatureCollection", "features": "land"}),
            "text.geojson: cannot be read as GeoJSON: features should be a list",
        ),
        ("long" * 100 + ".geojson", None, "path: .* is not accepted; there is no such file"),
        ("bad.gpkg", "text", "bad.gpkg: cannot be read as a map"),
        ("empty.geojson", json.dumps(features()), "empty.geojson: holds no polygon"),
        (
            "line.geojson",
            json.dumps(features(ISLAND, shapely.LineString([(0, 0), (1, 1)]))),
            "line.geojson: feature 1 is a LineString, which is not accepted; land should be poly",
        ),
        (
            "metres.geojson",
            json.dumps(features(shapely.box(100000, 6000000, 200000, 6100000))),
            r"metres.geojson: bounds 100000, 6e\+06, 200000, 6.1e\+06 are not accepted",
        ),
        (
            "hole.geojson",
            json.dumps(features(MAINLAND)).replace("[-2.0, 47.0]", "[-2.0, Infinity]"),
            "hole.geojson: bounds -4, 46, -1, inf are not accepted",
        ),
        (
            "torn.geojson",
            json.dumps(features(ISLAND)).replace('"Polygon"', '"Pentagon"'),
            "torn.geojson: feature 0 is no geometry",
        ),
        (
            "system.geojson",
            json.dumps(features(ISLAND, crs={"properties": {"name": "EPSG:0"}})),
            "system.geojson: unknown reference system 'EPSG:0'",
        ),
    ],
)
def test_what_is_no_land_is_refused(
    tmp_path: Path, name: str, content: str | None, message: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(dc.ScenarioError, match=message):
        LandCoast.from_file(tmp_path / name)


def test_a_table_is_no_map(tmp_path: Path) -> None:
    (tmp_path / "wind.csv").write_text("time,u10,v10\n2026-07-01,1,2\n")
    with pytest.raises(dc.ScenarioError, match=r"wind.csv: is a table without geometry"):
        LandCoast.from_file(tmp_path / "wind.csv")


def test_what_is_no_column_geometry_or_point_is_refused(tmp_path: Path, coast: LandCoast) -> None:
    write(tmp_path / "land.shp")
    (tmp_path / "land.geojson").write_text(json.dumps(features(*LAND)))
    for name in ("land.shp", "land.geojson"):
        with pytest.raises(dc.ScenarioError, match=r"name_column: 'nom' is .* columns are: name"):
            LandCoast.from_file(tmp_path / name, name_column="nom")
    with pytest.raises(dc.ScenarioError, match="names: 1 names are not accepted; there are 2"):
        LandCoast.from_geometries(LAND, ["one"])
    with pytest.raises(dc.ScenarioError, match="it should hold shapely geometries"):
        LandCoast.from_geometries([(0, 0)])  # type: ignore[list-item]  # what is refused
    flat = shapely.Polygon([(0, 0), (1, 1), (2, 2)])
    with (
        pytest.warns(dc.DriftCoreWarning, match="repaired"),
        pytest.raises(dc.ScenarioError, match="holds no polygon with an area"),
    ):
        LandCoast.from_geometries(flat)
    pole = [(0, 80), (120, 80), (-120, 80)]
    with pytest.raises(dc.ScenarioError, match=r"a ring around a pole, near 80.0000 N 0.0000 E"):
        LandCoast.from_geometries(shapely.Polygon(pole))
    with pytest.raises(dc.ScenarioError, match=r"resolution: '1m' is .* should be '50m'"):
        LandCoast.default("1m")  # type: ignore[arg-type]  # what is refused
    for points in ([1, 2], [[1, 2, 3]], [[np.nan, 1]]):
        with pytest.raises(dc.ScenarioError, match="points: an array of shape"):
            coast.is_land(points)
    with pytest.raises(dc.ScenarioError, match="longitude: nan is not accepted"):
        coast.around(np.nan)


def test_a_million_points_take_seconds() -> None:
    rng = np.random.default_rng(1)
    angle = np.linspace(0, 2 * np.pi, 200_001)[:-1]
    wave = sum(rng.uniform(0, 1 / k) * np.sin(k * angle + rng.uniform(0, 6)) for k in (3, 50, 900))
    shape = (1 + 0.1 * wave)[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    begun = time.perf_counter()
    islands = [shapely.Polygon(3 * shape + [8 * k, 45]) for k in range(-2, 3)]
    coast = LandCoast.from_geometries(islands).cut(-20, 20, 40, 50)
    rings = coast.rings()
    land = coast.is_land(rng.uniform([-20, 40], [20, 50], (10_000, 2)))
    km, _ = coast.distance_to_sea_km(0, 45)
    at = coast.polygon_of(np.concatenate(rings)[::1000] + np.array([0, 1e-7]))
    # 0.6 s alone on two cores, of which neighbours may take most. What asks every point
    # of a polygon for each point of the coast takes longer.
    assert time.perf_counter() - begun < 20
    assert sum(map(len, rings)) > 900_000
    assert 0.2 < land.mean() < 0.6
    assert 100 < km < 400
    assert set(at) == set(range(5))
