"""Maps draw the forecast they are given, say what it is, and leave nothing else behind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
import shapely
import xarray as xr
from matplotlib.collections import LineCollection, PathCollection, QuadMesh
from matplotlib.container import BarContainer
from matplotlib.contour import QuadContourSet
from matplotlib.text import Text
from typer.testing import CliRunner

import driftcore as dc
from driftcore import cli, map_drawing, plot_map, plot_presence
from driftcore.statistics import wilson

# A coast along 2° W with a bay, and a lake behind it.
LAND = shapely.Polygon(
    [(-2, 44), (-2, 46), (-1.5, 46), (-1.5, 46.5), (-2, 46.5), (-2, 49), (0, 49), (0, 44)],
    holes=[[(-1, 45), (-0.5, 45), (-0.5, 45.5), (-1, 45.5)]],
)
COAST = dc.LandCoast.from_geometries(LAND, label="straight")
CUT = COAST.cut(-6.0, -0.2, 44.2, 48.8)
BOXES = {"south": (-2.5, -1, 44, 46), "north": (-2.5, -1, 46, 47.5), "far": (-9, -8, 44, 49)}


@pytest.fixture(autouse=True)
def untouched() -> Any:
    """Neither defaults nor pyplot's list of figures are touched."""
    before = dict(mpl.rcParams)
    yield
    assert dict(mpl.rcParams) == before
    assert not plt.get_fignums()


@pytest.fixture(scope="module")
def forecast(embedded_wind: dc.LocalGridBootstrap) -> dc.GeographicForecast:
    """Some strand within the run and some do not."""
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-3, 46.7, "2026-07-01T06:00", radius_m=1000),
        days=15,
        drifter=dc.FloatingBody(response_time_h=1.0, wind_factor=0.03),
        coast=COAST,
        name="a crate",
    )
    made = dc.forecast(
        scenario,
        embedded_wind,
        members=60,
        keep=30,
        maps=dc.MapGrid(x=np.linspace(-5, -1, 21), y=np.linspace(44.5, 48.5, 21), times=(5, 10)),
    )
    assert isinstance(made, dc.GeographicForecast)
    assert 5 < made.counts["stranded"] < 55
    return made


def words(artist: Any) -> str:
    artist.figure.canvas.draw()
    return "\n".join(text.get_text() for text in artist.figure.findobj(Text))


def only(artists: list[Any], kind: type) -> Any:
    (found,) = [artist for artist in artists if isinstance(artist, kind)]
    return found


def test_presence_is_that_of_the_dataset_by_area(forecast: dc.GeographicForecast) -> None:
    mesh = only(plot_map.presence_map(forecast, 5, COAST), QuadMesh)
    presence = forecast.dataset["presence"].isel(map_time=0).values
    drawn = mesh.get_array()
    np.testing.assert_array_equal(np.ma.getmaskarray(drawn), presence == 0)
    # On the sphere, cell by cell.
    radius = 6371.0088
    south, north = np.radians(forecast.dataset["map_latitude_bounds"].values).T
    area = radius**2 * np.radians(0.2) * (np.sin(north) - np.sin(south))
    np.testing.assert_allclose(drawn.filled(0.0), 100 * presence / (area[:, None] / 100), rtol=1e-6)
    corners = mesh.get_coordinates()
    np.testing.assert_allclose(corners[0, :, 0], np.linspace(-5, -1, 21))
    np.testing.assert_allclose(corners[:, 0, 1], np.linspace(44.5, 48.5, 21))


@pytest.mark.parametrize("index", [0, 1])
def test_contours_hold_what_they_say(forecast: dc.GeographicForecast, index: int) -> None:
    now = forecast.dataset.isel(map_time=index)
    artists = plot_map.presence_map(forecast, now["map_time"].values)
    contours = [artist for artist in artists if isinstance(artist, QuadContourSet)]
    smooth, levels = plot_presence._densest(now["presence"].values, float(now["outside"]))
    assert [contour.levels[0] for contour in contours] == list(levels.values())
    afloat = float(now["presence"].sum() + now["outside"])
    for share, level in levels.items():
        within = now["presence"].values[smooth >= level].sum() / afloat
        fewer = now["presence"].values[smooth > level].sum() / afloat
        assert fewer < share <= within + 1e-12


def test_contours_of_known_regions() -> None:
    presence = np.zeros((11, 11))
    presence[5, 5], presence[5, 1] = 0.6, 0.2
    _, levels = plot_presence._densest(presence, outside=0.0)
    # Where 90 % are needed, the lesser peak belongs to it: half of 0.8 is at the greater one.
    assert levels[0.5] == pytest.approx(0.6 * 0.375**2)
    assert levels[0.9] == pytest.approx(0.2 * 0.375**2)
    _, levels = plot_presence._densest(presence, outside=0.2)
    assert list(levels) == [0.5]
    assert plot_presence._densest(0 * presence, outside=0.0)[1] == {}


def test_a_map_says_what_it_is(forecast: dc.GeographicForecast) -> None:
    artists = plot_map.presence_map(forecast, 10, COAST)
    axes = artists[0].axes
    text = words(artists[0])
    now = forecast.dataset.isel(map_time=1)
    for expected in (
        "a crate, 2026-07-11 06:00 UTC, 10 days after the release",
        f"{100 * float(now['ashore']):.1f} % ashore",
        "synthetic",
        "50 % of those afloat",
        "release",
        "longitude",
        "3° W",
        "46° N",
        "50 km",
        "N",
        "[% per 100 km²]",
    ):
        assert expected in text
    assert axes.get_aspect() == pytest.approx(1 / np.cos(np.radians(46.5)))


def test_the_scale_bar_is_true(forecast: dc.GeographicForecast) -> None:
    from driftcore.coast import geodesic

    artists = plot_map.presence_map(forecast, 10)
    (bar,) = [line for line in artists[0].axes.lines if line.get_linewidth() == 2.0]
    west, east = bar.get_xdata()
    assert geodesic().inv(west, 46.5, east, 46.5)[2] == pytest.approx(50e3, rel=5e-3)


def test_a_lake_is_no_land(forecast: dc.GeographicForecast) -> None:
    artists = plot_map.spaghetti(forecast, COAST)
    land = artists[[isinstance(a, PathCollection) for a in artists].index(True)]
    (path,) = land.get_paths()
    assert path.contains_point((-1.7, 45.2))
    axes = artists[0].axes
    axes.set_xlim(-2.5, -0.3)
    axes.set_ylim(44.5, 46.5)
    image = np.asarray(_drawn(axes))
    assert _colour(axes, image, -0.75, 45.25) == (255, 255, 255)
    assert _colour(axes, image, -1.7, 45.25) == (0xE9, 0xE4, 0xD9)


def test_land_is_drawn_beyond_the_dateline() -> None:
    """Where the view runs over it, in whichever turn the land is told."""
    land = dc.LandCoast.from_geometries(shapely.box(-176, -18, -174, -16))
    axes = map_drawing.new_figure((6, 6)).subplots()
    axes.set_xlim(178, 188)
    axes.set_ylim(-22, -12)
    map_drawing.draw_land(axes, land)
    image = np.asarray(_drawn(axes))
    assert _colour(axes, image, 185, -17) == (0xE9, 0xE4, 0xD9)
    assert _colour(axes, image, 180, -17) == (255, 255, 255)


def _drawn(axes: Any) -> Any:
    axes.figure.canvas.draw()
    return axes.figure.canvas.buffer_rgba()


def _colour(axes: Any, image: Any, longitude: float, latitude: float) -> tuple[int, ...]:
    column, row = axes.transData.transform((longitude, latitude))
    red, green, blue, _ = image[image.shape[0] - 1 - int(row), int(column)]
    return int(red), int(green), int(blue)


def test_times_of_a_map(forecast: dc.GeographicForecast) -> None:
    by_days = plot_map.presence_map(forecast, 10.0)[0].get_array()
    by_text = plot_map.presence_map(forecast.dataset, "2026-07-11T06:00")[0].get_array()
    np.testing.assert_array_equal(by_days, by_text)
    for wrong in (7, "2026-07-11", "soon"):
        with pytest.raises(dc.ScenarioError, match=r"time: .* 5 \(2026-07-06 06:00 UTC\), 10 "):
            plot_map.presence_map(forecast, wrong)


def test_the_coast_has_the_colour_of_its_probability(forecast: dc.GeographicForecast) -> None:
    divided = CUT.divide(length_km=25)
    artists = plot_map.stranding_coast(forecast, divided)
    drawn = only(artists, LineCollection)
    table = forecast.stranding_by_stretch(divided)["probability"].values[:-1]
    hit = table > 0
    assert 1 < hit.sum() < len(hit)
    np.testing.assert_allclose(drawn.get_array(), np.sort(100 * table[hit]))
    lines = {tuple(map(tuple, segment)) for segment in drawn.get_segments()}
    expected = np.array(list(divided.stretches.values()), dtype=object)[hit]
    assert lines == {tuple(line.coords) for line in expected}
    west, east = artists[0].axes.get_xlim()
    assert -6.0 <= west < east <= -0.2
    assert "% per stretch of 25 km" in words(artists[0]) or "24 km" in words(artists[0])


def test_bars_and_their_intervals(forecast: dc.GeographicForecast) -> None:
    coast = COAST.with_stretches(BOXES)
    artists = plot_map.stranding_bars(forecast, coast)
    axes = artists[0].axes
    bars = axes.containers[[isinstance(c, BarContainer) for c in axes.containers].index(True)]
    table = forecast.stranding_by_stretch(coast)
    np.testing.assert_allclose([b.get_width() for b in bars], 100 * table["probability"].values)
    (lines,) = [a for a in artists if isinstance(a, LineCollection)]
    ends = np.array([segment[:, 0] for segment in lines.get_segments()]) / 100
    np.testing.assert_allclose(ends, np.stack([table["low"], table["high"]], axis=1))
    assert [label.get_text() for label in axes.get_yticklabels()] == [*BOXES, "elsewhere"]
    text = words(artists[0])
    five, half, most = table["time_quantile"].sel(stretch="north").values
    assert f"{five:.0f} – {half:.0f} – {most:.0f} d" in text
    assert "none" in text
    assert "95 % interval (Wilson)" in text


def test_paths_end_where_they_strand(forecast: dc.GeographicForecast) -> None:
    dataset = forecast.dataset
    artists = plot_map.spaghetti(forecast, members=20)
    fates = {a.get_label(): a for a in artists if isinstance(a, LineCollection)}
    first = dataset.isel(member=slice(20))
    stranded = np.flatnonzero(first["status"].values == 1)
    lines = fates["stranded"].get_segments()
    assert len(lines) == len(stranded)
    assert len(fates["afloat at the end"].get_segments()) == 20 - len(stranded)
    for line, member in zip(lines, stranded, strict=True):
        row = dataset.isel(member=member)
        place = [float(row["stranding_longitude"]), float(row["stranding_latitude"])]
        np.testing.assert_array_equal(line[-1], place)
        path = dataset.isel(kept_member=member)["longitude"].values
        np.testing.assert_array_equal(line[:-1, 0], path[np.isfinite(path)])
    assert "20 drawn" in words(artists[0])


def test_the_curve_is_the_probability_by_time(forecast: dc.GeographicForecast) -> None:
    line, band, *_ = plot_map.arrival_curve(forecast)
    times, percent = line.get_xdata(), line.get_ydata()
    for day in (3, 7, 15):
        by = np.datetime64("2026-07-01T06:00", "ns") + np.timedelta64(day, "D")
        known = percent[np.searchsorted(times, by, side="right") - 1]
        assert known / 100 == pytest.approx(forecast.stranding_probability(by=by).estimate)
    low, high = wilson(forecast.counts["stranded"], 60)
    heights = band.get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx(100 * float(high))
    last = band.get_paths()[0].vertices[:, 0] == line.axes.get_xlim()[1]
    assert heights[last].min() == pytest.approx(100 * float(low))
    text = words(line)
    assert "a crate: " in text
    assert "days after the release" in text
    assert "95 % interval (Wilson)" in text


def test_a_second_curve_has_another_hue(forecast: dc.GeographicForecast) -> None:
    first, *_ = plot_map.arrival_curve(forecast, label="one")
    second, *_ = plot_map.arrival_curve(forecast, first.axes, label="two")
    assert second.axes is first.axes
    assert first.get_color() != second.get_color()
    labels = [text.get_text() for text in first.axes.get_legend().get_texts()]
    assert labels == ["one", "95 % interval (Wilson)", "two"]


def test_a_file_draws_the_same(forecast: dc.GeographicForecast, tmp_path: Any) -> None:
    forecast.to_netcdf(tmp_path / "f.nc")
    back = dc.open_forecast(tmp_path / "f.nc")
    one = plot_map.presence_map(forecast, 5)[0].get_array()
    np.testing.assert_array_equal(one, plot_map.presence_map(back.dataset, 5)[0].get_array())


def test_nothing_stranded_is_drawn_too(forecast: dc.GeographicForecast) -> None:
    calm = forecast.dataset.copy(deep=True)
    calm["status"].values[:] = 0
    calm["stranding_time"].values[:] = np.datetime64("NaT")
    for name in ("stranding_longitude", "stranding_latitude"):
        calm[name].values[:] = np.nan
    assert not plot_map.stranding_coast(calm, CUT.divide(25))[0].get_segments()
    line, *_ = plot_map.arrival_curve(calm)
    assert not line.get_ydata().any()
    assert "none" in words(plot_map.stranding_bars(calm, COAST.with_stretches(BOXES))[0])


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda f: plot_map.spaghetti(f, members=0), "members: 0 is not accepted"),
        (lambda f: plot_map.spaghetti(f.dataset.isel(kept_member=slice(0))), "forecast: no paths"),
        (lambda f: plot_map.stranding_coast(f, COAST), "coast: it has no stretches"),
        (lambda f: plot_map.stranding_bars(f, COAST), "coast: it has no stretches"),
        (
            lambda f: plot_map.stranding_coast(f, COAST.with_stretches(BOXES)),
            "coast: its stretches are areas",
        ),
        (lambda f: plot_map.presence_map(f.dataset.drop_vars("presence"), 5), "presence: not in"),
        (lambda _: plot_map.arrival_curve(xr.Dataset()), "status: not in the dataset"),
    ],
)
def test_what_cannot_be_drawn_is_refused(
    forecast: dc.GeographicForecast, draw: Any, message: str
) -> None:
    with pytest.raises(dc.ScenarioError, match=message):
        draw(forecast)


def test_the_guide_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (Path(__file__).parents[1] / "docs/guide/lost_container.md").read_text("utf-8")
    lines = text.split("<!-- lost container -->\n```python\n")[1].split("```\n<!-- end -->")[0]
    assert "members=10_000" in lines
    monkeypatch.chdir(tmp_path)
    held: dict[str, Any] = {}
    exec(lines.replace("members=10_000", "members=30"), held)  # noqa: S102
    assert held["forecast"].followed == 30
    assert isinstance(dc.open_forecast("container.nc"), dc.GeographicForecast)
    assert Path("day_20.png").stat().st_size > 10_000


def test_all_figures_are_written(forecast: dc.GeographicForecast, tmp_path: Path) -> None:
    maps = forecast.dataset.sizes["map_time"]
    always = {"paths.png", "arrival.png", "estimate.png", "stranding_rose.png"}
    expected = {*always, *(f"presence_{k}.png" for k in range(1, maps + 1))}
    assert {path.name for path in plot_map.save_all(forecast, tmp_path)} == expected
    assert {path.name for path in tmp_path.iterdir()} == expected
    with pytest.raises(dc.OutputError, match="exists"):
        plot_map.save_all(forecast, tmp_path)


def test_the_command_draws_them(forecast: dc.GeographicForecast, tmp_path: Path) -> None:
    forecast.to_netcdf(tmp_path / "out.nc")
    arguments = ["plot", str(tmp_path / "out.nc"), "-o", str(tmp_path / "figures"), "-q"]
    assert CliRunner().invoke(cli.app, arguments).exit_code == 0
    assert (tmp_path / "figures/paths.png").stat().st_size > 10_000
