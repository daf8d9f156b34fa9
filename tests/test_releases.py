"""Releases: their laws in space and time, members that stay themselves, and what is refused."""

from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import numpy as np
import pandas as pd
import pyproj
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import driftcore as dc
from driftcore.releases import Release, Releases

DAY = "2024-06-01T12:00"
MEMBERS = 10_000
# Fixed seeds: a right law fails a test at this level once in a thousand choices of the seed.
LEVEL = 1e-3
GEOD = pyproj.Geod(ellps="WGS84")

FIJI = [(179, -18), (-179, -18), (-179, -17), (179, -17)]
ALL = Releases(
    [
        Release.point(-3, 47, DAY, position_error_m=2000, time_error_h=1),
        Release.disc(179.99, -17, 5000, (DAY, "2024-06-02")),
        Release.line([(-4, 47), (-3, 48), (-2, 48)], DAY, radius_m=100),
        Release.polygon(FIJI, DAY),
    ],
    [3, 1, 2, 0.5],
)


def distances(release: Release, longitude: float, latitude: float) -> tuple[Any, Any]:
    """Distances [m] and bearings [degrees] of members from a point, as pyproj measures them."""
    position = release.sample(0, MEMBERS, 1).position
    start = np.full((MEMBERS, 2), (longitude, latitude))
    bearing, _, metres = GEOD.inv(*start.T, *position.T)
    return metres, bearing % 360


def test_a_point_is_where_and_when_it_was_said() -> None:
    position, time, release = Release.point(-3.25, 47.5, DAY).sample(5, 7, 1)
    assert (position == [-3.25, 47.5]).all()
    assert (time == np.datetime64("2024-06-01T12:00")).all()
    assert (release == 0).all()


# At the dateline, at a few kilometres from a pole, and at the pole itself.
@pytest.mark.parametrize(("longitude", "latitude"), [(-3, 47), (180, -17), (12, 89.97), (0, -90)])
def test_a_disc_is_even_by_area(longitude: float, latitude: float) -> None:
    release = Release.disc(longitude, latitude, 8000, DAY)
    metres, bearing = distances(release, longitude, latitude)
    assert stats.kstest((metres / 8000) ** 2, "uniform").pvalue > LEVEL
    assert stats.kstest(bearing / 360, "uniform").pvalue > LEVEL
    position = release.sample(0, MEMBERS, 1).position
    assert (np.abs(position) <= [180, 90]).all()


@pytest.mark.parametrize("percent", [50, 95])
def test_a_position_error_contains_what_it_says(percent: float) -> None:
    release = Release.point(-3, 47, DAY, position_error_m=1000, contained_percent=percent)
    metres, _ = distances(release, -3, 47)
    share = percent / 100
    sigma = 1000 / np.sqrt(-2 * np.log(1 - share))
    assert stats.kstest(metres, stats.rayleigh(scale=sigma).cdf).pvalue > LEVEL
    # Four standard deviations of a share.
    assert abs((metres < 1000).mean() - share) < 4 * np.sqrt(share * (1 - share) / MEMBERS)


def test_a_line_is_even_by_length_along_geodesics() -> None:
    points = np.array([(170.0, 60), (-175, 65), (-170, 60)])
    position = Release.line(points, DAY).sample(0, MEMBERS, 1).position
    sides = GEOD.inv(*points[:-1].T, *points[1:].T)[2]
    start = np.broadcast_to(points[:, None], (3, MEMBERS, 2))
    away = np.array([GEOD.inv(*at.T, *position.T)[2] for at in start])
    first = np.abs(away[0] + away[1] - sides[0]) < 1e-3  # [m] on the first geodesic
    second = np.abs(away[1] + away[2] - sides[1]) < 1e-3
    assert (first ^ second).all()
    along = np.where(first, away[0], sides[0] + away[1])
    assert stats.kstest(along / sides.sum(), "uniform").pvalue > LEVEL


def test_a_polygon_is_even_by_area_over_the_dateline_and_around_holes() -> None:
    position = Release.polygon(FIJI, DAY).sample(0, MEMBERS, 1).position
    east = position[:, 0] % 360
    assert stats.kstest(east, stats.uniform(179, 2).cdf).pvalue > LEVEL
    # By area: in the sine of latitude, to 1e-4 on so narrow a belt of the ellipsoid.
    sine = np.sin(np.radians(position[:, 1]))
    low, high = np.sin(np.radians([-18, -17]))
    assert stats.kstest((sine - low) / (high - low), "uniform").pvalue > LEVEL

    ring = shapely.Point(0, 50).buffer(2) - shapely.Point(0, 50).buffer(1)
    two = shapely.union_all([ring, shapely.box(10, 50, 10.5, 50.5)])
    position = Release.from_geometry(two, DAY).sample(0, MEMBERS, 1).position
    assert shapely.covers(two.buffer(1e-4), shapely.points(position)).all()
    area, of_two = (abs(GEOD.geometry_area_perimeter(x)[0]) for x in (two.geoms[1], two))
    share = min(area / of_two, 1 - area / of_two)
    inside = shapely.covers(two.geoms[1].buffer(1e-4), shapely.points(position)).mean()
    assert abs(min(inside, 1 - inside) - share) < 4 * np.sqrt(share * (1 - share) / MEMBERS)


def test_sides_of_a_polygon_are_straight_in_longitude_and_latitude() -> None:
    triangle = [(0, 40), (20, 40), (20, 60)]
    position = Release.polygon(triangle, DAY).sample(0, MEMBERS, 1).position
    # The bend of 20 degrees in the plane of equal areas, without cutting the sides, is 0.9.
    assert (position[:, 1] - 40 <= position[:, 0] + 1e-3).all()


def test_windows_and_uncertain_times_have_their_laws() -> None:
    window = Release.point(0, 0, (DAY, "2024-06-03T12:00"))
    hours = (window.sample(0, MEMBERS, 1).time - np.datetime64(DAY)) / np.timedelta64(1, "h")
    assert stats.kstest(hours / 48, "uniform").pvalue > LEVEL
    unsure = Release.point(0, 0, DAY, time_error_h=6, contained_percent=50)
    hours = (unsure.sample(0, MEMBERS, 1).time - np.datetime64(DAY)) / np.timedelta64(1, "h")
    sigma = 6 / stats.norm.ppf(0.75)
    assert stats.kstest(hours, stats.norm(0, sigma).cdf).pvalue > LEVEL


@pytest.mark.parametrize(
    "time",
    [
        "2024-06-01T12:00",
        "2024-06-01T12:00Z",
        "2024-06-01T14:00+02:00",
        datetime(2024, 6, 1, 12),
        datetime(2024, 6, 1, 12, tzinfo=UTC),
        datetime(2024, 6, 1, 7, tzinfo=timezone(timedelta(hours=-5))),
        np.datetime64("2024-06-01T12:00"),
        np.datetime64("2024-06-01T12:00", "ns"),
        pd.Timestamp("2024-06-01T14:00", tz="Europe/Paris"),
    ],
)
def test_times_are_utc(time: Any) -> None:
    release = Release.point(0, 0, time)
    assert release == Release.point(0, 0, DAY)
    assert release.sample(0, 1, 1).time[0] == np.datetime64("2024-06-01T12:00")


@given(st.integers(0, 2**64 - 1), st.integers(0, 10**12), st.integers(0, 60), st.integers(0, 60))
def test_members_do_not_depend_on_chunks(seed: int, first: int, left: int, right: int) -> None:
    whole = ALL.sample(first, left + right, seed)
    parts = [ALL.sample(first, left, seed), ALL.sample(first + left, right, seed)]
    for all_at_once, chunk, rest in zip(whole, *parts, strict=True):
        np.testing.assert_array_equal(all_at_once, np.concatenate([chunk, rest]))


def test_seeds_differ_and_draws_are_not_shared() -> None:
    one, two = (ALL.sample(0, 500, seed) for seed in (1, 2))
    assert not (one.position == two.position).all(axis=1).any()
    np.testing.assert_array_equal(one.release, two.release)


@given(
    st.lists(st.floats(0.01, 100), min_size=1, max_size=6),
    st.integers(0, 10**15),
    st.integers(1, 2000),
)
def test_any_run_of_members_holds_the_shares(weights: list[float], first: int, count: int) -> None:
    releases = Releases([Release.point(0, 0, DAY)] * len(weights), weights)
    dealt = np.bincount(releases.release_of(first, count), minlength=len(weights))
    shares = np.array(weights) / np.sum(weights)
    # Kesten's bounded remainders do not hold for every interval; the discrepancy of the golden
    # ratio is below log(n)/log(golden ratio) + 2 on any interval, twice that for its two ends.
    assert np.abs(dealt - count * shares).max() < 2 * (np.log(count + 1) / np.log(1.618) + 2)


def test_a_release_without_weight_gets_no_member() -> None:
    releases = Releases([Release.point(k, 0, DAY) for k in range(3)], [0, 1, 0])
    assert (releases.release_of(0, 10_000) == 1).all()


@pytest.mark.parametrize("release", ALL.releases)
def test_releases_go_through_toml(release: Release) -> None:
    assert Release.from_toml(release.to_toml()) == release
    assert release.replace(name="x").name == "x"


def test_geometries_of_shapely_are_the_same_releases() -> None:
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    for made, expected in [
        (Release.from_geometry(shapely.Point(3, 4, 7), DAY), Release.point(3, 4, DAY)),
        (Release.from_geometry(shapely.LineString(square), DAY), Release.line(square, DAY)),
        (
            Release.from_geometry(shapely.Polygon(square), DAY),
            Release.polygon([*square, square[0]], DAY),
        ),
    ]:
        assert made == expected


BOW_TIE = [(0, 0), (1, 1), (1, 0), (0, 1)]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Release.point(0, 95, DAY), r"coordinates.0.0.1: 95 is not accepted"),
        (lambda: Release.point("3 W", 0, DAY), "coordinates.0.0.0: '3 W' is not accepted"),
        (lambda: Release.point(np.nan, 0, DAY), "coordinates.0.0.0: nan is not accepted"),
        (lambda: Release.disc(0, 0, -1, DAY), "radius_m: -1 is not accepted"),
        (lambda: Release.point(0, 0, "noon"), "start: 'noon' is not accepted; it should be a time"),
        (lambda: Release.point(0, 0, 2024), "start: 2024 is not accepted; it should be a time"),
        (lambda: Release.point(0, 0, pd.NaT), "start: NaT is not accepted"),
        (lambda: Release.point(0, 0, np.datetime64("NaT")), "start: None is not accepted"),
        (lambda: Release.point(0, 0, (DAY, "2024-05-01")), "end: 2024-05-01 .* before start"),
        (lambda: Release.point(0, 0, (DAY, DAY, DAY)), "time: .*should be an instant, or the fir"),
        (lambda: Release.point(0, 0, DAY, contained_percent=100), "contained_percent: 100 is not"),
        (lambda: Release.point(0, 0, DAY, radius=1), "radius: unknown key; did you mean 'radius_m"),
        (lambda: Release.line([(0, 0), (0, 0)], DAY), "coordinates.0: 1 different points are not"),
        (lambda: Release.polygon(BOW_TIE, DAY), r"coordinates: Self-intersection.*cross itself"),
        (lambda: Release.polygon([(0, 80), (120, 80), (240, 80)], DAY), "around a pole is not"),
        (
            lambda: Release(kind="point", coordinates=[[(0, 0), (1, 1)]], start=DAY),
            "coordinates.0: 2 different points are not accepted; a point has one",
        ),
        (
            lambda: Release.from_geometry(shapely.MultiPoint([(0, 0)]), DAY),
            "geometry: <MULTIPOINT .* is not accepted; it should be one of Point",
        ),
        (lambda: Release.from_geometry(shapely.Polygon(), DAY), "geometry: an empty Polygon is"),
        (
            lambda: Release.from_geometry(shapely.Polygon(BOW_TIE), DAY),
            r"geometry: Self-intersection.*make_valid",
        ),
        (lambda: Releases([]), r"releases: \[\] is not accepted"),
        (lambda: Releases(ALL.releases, [1, 2]), "weights: .*one number for each of the 4 rel"),
        (lambda: Releases(ALL.releases, [0, 0, 0, 0]), "weights: .* not all 0"),
        (lambda: Releases(ALL.releases, [1, 1, 1, -1]), "weights.3: -1 is not accepted"),
        (lambda: ALL.sample(0, -1, 1), "count: -1 is not accepted"),
        (lambda: ALL.sample(0, 1, 2**64), "seed: 18446744073709551616 is not accepted"),
    ],
)
def test_what_is_no_release_is_refused(make: Any, message: str) -> None:
    with pytest.raises(dc.ScenarioError, match=message):
        make()


def test_words_say_where_when_and_how_well_it_is_known() -> None:
    assert Release.point(-3, 47, DAY).describe() == ("47.0000 N 3.0000 W; 2024-06-01 12:00 UTC")
    wide = Release.polygon(FIJI, (DAY, "2024-06-02"), position_error_m=300, time_error_h=1)
    words = wide.describe()
    assert words.startswith("a polygon of 4 points from 18.0000 S 179.0000 E, known to 300 m; 2024")
    assert words.endswith("2024-06-01 12:00 to 2024-06-02 00:00 UTC, known to 1 h")


def test_a_corner_at_the_pole_is_refused() -> None:
    with pytest.raises(dc.ScenarioError, match=r"coordinates: .* it has no even area"):
        Release.polygon([(-4.2, 90.0), (-4.0, 47.1), (-4.0, 47.3)], DAY)
