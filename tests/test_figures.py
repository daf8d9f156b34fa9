"""Figures of estimates, winds and set-ups; on dark pages, and on cartopy's axes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text

import driftcore as dc
from driftcore import plot, plot_map
from driftcore.climate import synthetic_record
from driftcore.coast import geodesic
from driftcore.drawing import tones
from driftcore.statistics import wilson

SQUARE = [(-2, 44), (-2, 49), (0, 49), (0, 44)]


@pytest.fixture(autouse=True)
def untouched() -> Any:
    """Neither defaults nor pyplot's list of figures are touched."""
    before = dict(mpl.rcParams)
    yield
    assert dict(mpl.rcParams) == before
    assert not plt.get_fignums()


@pytest.fixture(scope="module")
def coast() -> dc.LandCoast:
    shapely = pytest.importorskip("shapely")
    return dc.LandCoast.from_geometries(shapely.Polygon(SQUARE), label="straight")


@pytest.fixture(scope="module")
def sea(small_wind: dc.LocalGridBootstrap, coast: dc.LandCoast) -> dc.GeographicForecast:
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-3, 46.7, "2026-07-01T06:00", radius_m=1000),
        days=10,
        drifter=dc.FloatingBody(response_time_h=1.0, wind_factor=0.03),
        coast=coast,
        name="a crate",
    )
    made = dc.forecast(
        scenario,
        small_wind,
        members=60,
        keep=20,
        maps=dc.MapGrid(x=np.linspace(-5, -1, 21), y=np.linspace(44.5, 48.5, 21), times=(5, 10)),
        targets={"gate": [[-2.6, 46], [-2.4, 46], [-2.4, 47], [-2.6, 47]]},
    )
    assert isinstance(made, dc.GeographicForecast)
    return made


@pytest.fixture(scope="module")
def plane(small_wind: dc.LocalGridBootstrap) -> dc.Forecast:
    grid = tuple(np.linspace(0.65, 1.35, 15))
    maps = dc.MapGrid(x=grid, y=grid, times=(0.5, 1.0))
    return dc.forecast(dc.paper.scenario(), small_wind, members=60, keep=10, maps=maps)


def words(artists: list[Any]) -> str:
    figure = artists[0].figure
    figure.canvas.draw()
    return "\n".join(text.get_text() for text in figure.findobj(Text))


def test_the_running_estimate_is_that_of_the_first_members(plane: dc.Forecast) -> None:
    artists: list[Any] = plot.running_estimate(plane, checkpoints=[10, 25, 60])
    line, band, marks, *_ = artists
    stranded = np.cumsum(plane.dataset["status"].values == 1)
    members = line.get_xdata()
    assert members.tolist() == list(range(10, 61))
    np.testing.assert_allclose(line.get_ydata(), 100 * stranded[members - 1] / members)
    low, high = wilson(stranded[9], 10)
    at_ten = band.get_paths()[0].vertices
    at_ten = at_ten[at_ten[:, 0] == 10, 1] / 100
    assert (at_ten.min(), at_ten.max()) == pytest.approx((float(low), float(high)))
    assert marks.get_xdata().tolist() == [10, 25, 60]
    p = plane.stranding_probability()
    assert f"95 % interval {100 * p.low:.1f} to {100 * p.high:.1f} %" in words(artists)
    for wrong in ([], [0], [61]):
        with pytest.raises(dc.ScenarioError, match=r"checkpoints: .* from 1 to 60"):
            plot.running_estimate(plane, checkpoints=wrong)


def test_the_running_estimate_leaves_out_failed_members(plane: dc.Forecast) -> None:
    dataset = plane.dataset.copy(deep=True)
    dataset["status"].values[:50] = 3
    artists: list[Any] = plot.running_estimate(dataset)
    share = np.mean(dataset["status"].values[50:] == 1)
    assert artists[0].get_xdata().tolist() == [10]
    assert artists[0].get_ydata() == pytest.approx([100 * share])


def test_presence_in_the_plane_is_in_percent_of_the_members(plane: dc.Forecast) -> None:
    artists = plot.presence_map(plane, 0.5)
    (mesh,) = [a for a in artists if isinstance(a, QuadMesh)]
    presence = plane.dataset["presence"].isel(map_time=0).values
    drawn: Any = mesh.get_array()
    np.testing.assert_allclose(drawn.filled(0.0), 100 * presence)
    np.testing.assert_array_equal(np.ma.getmaskarray(drawn), presence == 0)
    said = words(artists)
    assert all(w in said for w in ("time 0.5, 13.0 days", "0.05 x 0.05", "synthetic", "release"))
    with pytest.raises(dc.ScenarioError, match=r"time: 0.7 is not accepted; .* 0.5, 1"):
        plot.presence_map(plane, 0.7)


def test_the_plane_takes_no_land(plane: dc.Forecast, coast: dc.LandCoast) -> None:
    with pytest.raises(dc.ScenarioError, match="coast: is not accepted"):
        plot.presence_map(plane, 0.5, coast)


def test_a_record_lies_within_its_own_winds() -> None:
    wind = dc.LocalGridBootstrap.fit(synthetic_record(6), h=0.3)
    artists: list[Any] = plot.wind_law(wind, records=10)
    record = wind.record
    speeds, sectors, _, memory = artists[0].figure.axes
    line = next(a for a in speeds.lines if a.get_label() == "the record")
    speed = np.hypot(*record.velocity.T)
    x, above = line.get_data()
    np.testing.assert_allclose(above, [100 * np.mean(speed > value) for value in x])
    rose = next(a for a in sectors.lines if a.get_label() == "the record").get_ydata()
    assert rose[:-1].sum() == pytest.approx(100)
    assert rose[0] == rose[-1]
    from_north = np.degrees(np.arctan2(*-record.velocity.T)) % 360
    assert rose[4] == pytest.approx(100 * np.mean(np.abs(from_north - 90) < 11.25))
    u = record.velocity[:, 0] - record.velocity[:, 0].mean()
    seasons = u.reshape(6, -1)
    lagged = np.mean(seasons[:, :-4] * seasons[:, 4:]) / np.mean(u**2)
    days, correlation = next(a for a in memory.lines if a.get_label() == "the record, u").get_data()
    assert correlation[np.flatnonzero(days == 1.0)[0]] == pytest.approx(lagged)
    assert "90 % and median of 10 simulated" in words(artists)
    with pytest.raises(dc.ScenarioError, match="records: 1 is not accepted"):
        plot.wind_law(wind, records=1)


def test_a_rose_of_a_record_and_of_strandings_at_sea(
    sea: dc.GeographicForecast, small_wind: dc.LocalGridBootstrap
) -> None:
    record = small_wind.record
    bars: list[Any] = plot.wind_rose(record)
    assert sum(bar.get_height() for bar in bars) == pytest.approx(100)
    assert f"{len(record):,} values every 6 h" in words(bars)
    assert "synthetic" in words(bars)
    strandings: list[Any] = plot_map.stranding_rose(sea)
    lengths = [bar.get_height() for bar in strandings]
    table = sea.stranding_by_sector(16)["probability"].values
    np.testing.assert_allclose(lengths, 100 * table, atol=1e-12)


def test_the_curve_of_a_target(sea: dc.GeographicForecast) -> None:
    line, *_ = plot_map.arrival_curve(sea, target="gate")
    p = sea.entry_probability("gate")
    assert 0 < p.estimate < 1
    assert line.get_ydata()[-1] == pytest.approx(100 * p.estimate)
    assert f"{100 * p.estimate:.1f} % entered gate" in words([line])
    with pytest.raises(dc.ScenarioError, match="target: 'moon'"):
        plot_map.arrival_curve(sea, target="moon")


def test_the_set_up_at_sea(coast: dc.LandCoast) -> None:
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-3.5, 46.7, "2026-07-01T06:00", radius_m=2000),
        days=10,
        drifter=dc.FloatingBody(response_time_h=1.0, wind_factor=0.03),
        tides=dc.tides.biscay(),
        coast=coast,
        name="a crate",
    )
    maps = dc.MapGrid(x=(-5.0, -4.0, -3.0), y=(45.0, 46.0, 47.0), times=(1.0,))
    artists: list[Any] = plot_map.set_up(scenario, None, maps, {"gate": SQUARE})
    boxes = {a.get_label(): np.array(a.get_data()) for a in artists if hasattr(a, "get_data")}
    assert boxes["extent of the maps"].min(axis=1).tolist() == [-5, 45]
    assert boxes["extent of the maps"].max(axis=1).tolist() == [-3, 47]
    longitude = scenario.tides.longitude if scenario.tides else np.zeros(1)
    assert boxes["extent of the tides"][0].min() == longitude[0]
    assert np.abs(boxes["places of release"][0] + 3.5).max() < 0.03
    said = words(artists)
    assert all(w in said for w in ("a crate, 10 days", "without current", "target gate", " km"))


def test_the_set_up_of_the_plane() -> None:
    maps = dc.MapGrid(x=(0.6, 1.0, 1.4), y=(0.6, 1.0, 1.4), times=(1.0,))
    cove = [[1.1, 1.1], [1.2, 1.1], [1.2, 1.2]]
    artists: list[Any] = plot.set_up(dc.paper.scenario(), None, maps, {"cove": cove})
    said = words(artists)
    assert all(w in said for w in ("a run of 26.0 days", "target cove", "extent of the maps"))


@pytest.mark.filterwarnings("error")
def test_cartopys_axes_show_the_same_places(
    sea: dc.GeographicForecast, coast: dc.LandCoast, monkeypatch: pytest.MonkeyPatch
) -> None:
    crs = pytest.importorskip("cartopy.crs")
    monkeypatch.setattr("socket.socket.connect", lambda *_: pytest.fail("a download"))
    degrees, projection = crs.PlateCarree(), crs.LambertConformal(-30, 46)
    figure = Figure()
    divided = coast.cut(-6.0, -0.2, 44.2, 48.8).divide(length_km=25)
    draws = [
        lambda ax: plot_map.presence_map(sea, 5, coast, ax),
        lambda ax: plot_map.spaghetti(sea, coast, ax=ax),
        lambda ax: plot_map.stranding_coast(sea, divided, ax),
    ]
    for number, draw in enumerate(draws):
        axes: Any = figure.add_subplot(1, 3, number + 1, projection=projection)
        artists = draw(axes)
        assert all(artist.axes is axes for artist in artists)
        (bar,) = [line for line in axes.lines if line.get_linewidth() == 2.0]
        ends = [degrees.transform_point(x, y, projection) for x, y in bar.get_xydata()]
        (scale,) = [t.get_text() for t in axes.texts if t.get_text().endswith(" km")]
        length = float(scale.split()[0])
        assert geodesic().inv(*ends[0], *ends[1])[2] == pytest.approx(1e3 * length, rel=0.02)
        (release,) = [line for line in axes.lines if line.get_label() == "release"]
        shown = release.get_transform().transform(release.get_xydata())[0]
        expected = axes.transData.transform(projection.transform_point(-3, 46.7, degrees))
        np.testing.assert_allclose(shown, expected, atol=2.0)
        # North of the middle of the projection is up; here, far east of it, it leans to the left.
        (arrow,) = [t for t in axes.texts if t.get_text() == "N"]
        assert arrow.get_position()[0] > 5


def test_dark_pages_have_light_ink(sea: dc.GeographicForecast, plane: dc.Forecast) -> None:
    light = tones()
    with plt.style.context("dark_background"):
        dark = tones()
        figures = [
            plot_map.presence_map(sea, 5),
            plot_map.spaghetti(sea),
            plot_map.arrival_curve(sea),
            plot.presence_map(plane, 0.5),
            plot.trajectories(plane.dataset),
            plot.roses(plane.dataset),
            plot.running_estimate(plane),
        ]
        for artists in figures:
            figure: Any = artists[0].figure
            figure.canvas.draw()
            image = np.asarray(figure.canvas.buffer_rgba())[..., :3]
            # A page that is mostly dark and yet holds something bright.
            assert np.median(image) < 100
            assert image.max() > 200
    assert max(to_rgb(light.ink)) < 0.3 < 0.7 < min(to_rgb(dark.ink))
    assert light.cells != dark.cells


def test_figures_are_written_with_stretches(
    sea: dc.GeographicForecast, coast: dc.LandCoast, tmp_path: Path
) -> None:
    written = plot_map.save_all(sea, tmp_path, coast.cut(-6.0, -0.2, 44.2, 48.8).divide(100))
    assert {"stretches.png", "coast.png"} <= {path.name for path in written}


def test_paths_do_not_jump_at_the_dateline(sea: dc.GeographicForecast) -> None:
    dataset = sea.dataset.copy(deep=True)
    for name in ("longitude", "stranding_longitude", "release_longitude"):
        dataset[name].values[:] = (dataset[name].values + 183 + 180) % 360 - 180
    artists: list[Any] = plot_map.spaghetti(dataset)
    west, east = artists[0].axes.get_xlim()
    assert east - west < 10
    assert "180°" in words(artists)


def test_the_guide_shows_small_pictures_that_the_example_draws() -> None:
    root = Path(__file__).parents[1]
    guide = root / "docs/guide/pictures.md"
    shown = {
        (guide.parent / part.split(")")[0]).resolve()
        for part in guide.read_text(encoding="utf-8").split("](")
        if part.split(")")[0].endswith(".png")
    }
    assert shown == set((root / "docs/figures/pictures").resolve().iterdir())
    example = (root / "examples/pictures.py").read_text(encoding="utf-8")
    for path in shown:
        assert path.stat().st_size < 150_000
        assert f'"{path.stem}": plot' in example
