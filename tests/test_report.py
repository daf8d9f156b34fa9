"""The page tells what the forecast holds, escapes what it is given, and works in a browser."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import driftcore as dc
from driftcore import cli
from driftcore.dataset import with_maps
from driftcore.report import _MOST_CELLS, _MOST_PLACES, _coast_lines

HOSTILE = '</script><img src=x onerror="alert(1)">{{ 7 * 7 }} & $$x$$'
SCENARIO = f"""
kind = "geographic"
name = '{HOSTILE}'
days = 20.0
[release]
coordinates = [-3.0, 46.7]
start = 2026-07-01T06:00:00
[object]
response_time_h = 1.0
wind_factor = 0.03
[tides]
kind = "none"
[coast.stretches]
'<b>Vendée</b>' = [-2.6, 46.2, -1.0, 47.05]
"elsewhere north" = [-5.3, 47.05, -1.0, 48.8]
[maps]
region = [-6.0, 44.0, -1.0, 48.0]
cell = 0.25
days = [5.0, 10.0, 20.0]
[targets]
'<i>box</i>' = [[-2.8, 46.4], [-2.2, 46.4], [-2.2, 47.0], [-2.8, 47.0]]
[ensemble]
members = 200
keep = 20
"""
# The gate sets it, so that a missing browser fails there.
REQUIRED = "DRIFTCORE_BROWSER"


class Elements(HTMLParser):
    """Elements of a page, and the text of those with an id."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.names: list[str] = []
        self.text: dict[str, str] = {}
        self.words = ""
        self._open: str | None = None
        self._hidden = False
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.append(tag)
        self._open = dict(attrs).get("id")
        self._hidden = tag in ("script", "style")

    def handle_data(self, data: str) -> None:
        if self._open is not None:
            self.text.setdefault(self._open, data)
        if not self._hidden:
            self.words += data


@pytest.fixture(scope="module")
def forecast() -> dc.GeographicForecast:
    made = dc.run(dc.GeographicConfiguration.from_toml(SCENARIO))
    assert isinstance(made, dc.GeographicForecast)
    assert 50 < made.counts["stranded"] < 195
    return made


@pytest.fixture(scope="module")
def plane() -> dc.Forecast:
    return dc.forecast(dc.paper.scenario(epsilon=1 / 50), members=80, keep=10)


@pytest.fixture(scope="module")
def path(forecast: dc.GeographicForecast, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("report") / "report.html"
    dc.report.write(forecast, target)
    return target


@pytest.fixture(scope="module")
def page(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def scene_of(page: str) -> Any:
    return json.loads(Elements(page).text["data"])["scene"]


def written(forecast: dc.Forecast, folder: Path, coast: dc.LandCoast | None = None) -> str:
    dc.report.write(forecast, folder / "page.html", coast)
    return (folder / "page.html").read_text(encoding="utf-8")


def test_the_map_is_that_of_the_dataset(forecast: dc.GeographicForecast, page: str) -> None:
    scene = scene_of(page)
    cells, share = scene["cells"], np.array([level[0] for level in scene["levels"]])
    maps = [*forecast.dataset["presence"].values, forecast.dataset["visit"].values]
    assert len(cells["stops"]) == len(scene["stops"]) == len(maps)
    for stop, expected in zip(cells["stops"], maps, strict=True):
        drawn = np.zeros(expected.size)
        drawn[np.cumsum(stop["steps"])] = share[stop["levels"]]
        np.testing.assert_allclose(drawn.reshape(expected.shape), 100 * expected, atol=1e-5)
    assert cells["corner"] == [-6.0, 44.0]
    assert cells["size"] == [0.25, 0.25]


def test_places_of_stranding_add_up(forecast: dc.GeographicForecast, page: str) -> None:
    scene = scene_of(page)
    share = np.array([level[0] for level in scene["levels"]])
    total = [share[levels].sum() for levels in scene["strandings"]["levels"]]
    days = [np.datetime64("2026-07-01T06:00") + np.timedelta64(d, "D") for d in (5, 10, 20, 20)]
    expected = [100 * forecast.stranding_probability(by=day).estimate for day in days]
    np.testing.assert_allclose(total, expected, atol=1e-3)
    middle = np.nanmean(forecast.dataset["stranding_longitude"].values)
    weights = share[scene["strandings"]["levels"][-1]]
    assert np.average(scene["strandings"]["x"], weights=weights) == pytest.approx(middle, abs=1e-3)


def test_the_words_hold_the_numbers(forecast: dc.GeographicForecast, page: str) -> None:
    words = " ".join(Elements(page).words.split())
    p = forecast.stranding_probability()
    middle = float(forecast.stranding_time_quantiles().sel(quantile=0.5))
    table = forecast.stranding_by_stretch(forecast.coast()).sel(stretch="<b>Vendée</b>")
    attributes = forecast.dataset.attrs
    for expected in (
        f"In {100 * p.estimate:.0f} of 100 cases it strands within 20 days "
        f"({100 * p.low:.0f} to {100 * p.high:.0f}).",
        f"half of them by day {middle:.0f}, ",
        f"{100 * float(table['low']):.0f} to {100 * float(table['high']):.0f}",
        "The wind is of a synthetic climate",
        "Tides: there are none.",
        "none failed",
        attributes["wind_label"],
        attributes["wind_sha256"],
        f"seed {attributes['seed']}",
        f"driftcore {dc.__version__}",
        "driftcore run scenario.toml -o out.nc",
        'kind = "geographic"',
    ):
        assert expected in words


def test_text_of_files_stays_text(page: str) -> None:
    elements = Elements(page)
    assert not {"img", "iframe", "object"} & set(elements.names)
    # Of ours: the figure in each answer; Bokeh twice, the page's own, and its data.
    assert elements.names.count("b") == 4
    assert elements.names.count("script") == 4
    assert f"Where “{HOSTILE}” may come ashore" in elements.words
    assert "<b>Vendée</b>" in elements.words
    assert "<i>box</i>" in elements.words
    assert "<" not in elements.text["data"]


def test_the_page_allows_its_own_scripts_alone(page: str) -> None:
    policy = page.split('Content-Security-Policy" content="')[1].split('"')[0]
    assert "default-src 'none'" in policy
    assert policy.count("'sha256-") == 3
    scripts = policy.split("script-src")[1].split(";")[0]
    assert "unsafe" not in scripts


def test_the_paper_case_has_a_page_too(plane: dc.Forecast, tmp_path: Path) -> None:
    page = written(plane, tmp_path)
    words = " ".join(Elements(page).words.split())
    p = plane.stranding_probability()
    assert f"In {100 * p.estimate:.0f} of 100 cases it strands within 26 days" in words
    assert "academic case" in words
    assert scene_of(page)["cells"] is None


def test_places_of_stranding_are_joined_where_there_are_many(
    plane: dc.Forecast, tmp_path: Path
) -> None:
    members, rng = 6000, np.random.default_rng(2)
    many = plane.dataset.isel(member=np.zeros(members, dtype=int)).drop_vars("member")
    many = many.assign_coords(member=np.arange(members))
    many["status"][:] = 1
    many["stranding_time"][:] = 0.5
    ends = rng.uniform(0, 2, (members, 2))
    many["stranding_position"][:] = ends
    scene = scene_of(written(dc.Forecast(many), tmp_path))
    places = scene["strandings"]
    assert 300 < len(places["x"]) <= _MOST_PLACES
    share = np.array([level[0] for level in scene["levels"]])[places["levels"][-1]]
    assert share.sum() == pytest.approx(100, abs=0.1)
    middle = [np.average(places[axis], weights=share) for axis in "xy"]
    assert middle == pytest.approx(ends.mean(axis=0).tolist(), abs=5e-3)


def test_a_plane_of_polygons_without_paths(tmp_path: Path) -> None:
    ring = [(0.8, 0.8), (1.2, 0.8), (1.2, 1.2), (0.8, 1.2)]
    scenario = dc.paper.scenario(coast=dc.Polygons(rings=[ring]))
    made = dc.forecast(scenario, dc.paper.default_wind(), members=60, keep=0)
    assert made.counts["stranded"] > 0
    page = written(made, tmp_path)
    assert f"In {100 * made.stranding_probability().estimate:.0f} of 100 cases it strands" in page
    case: Any = SimpleNamespace(geographic=False, dataset=made.dataset)
    (line,) = _coast_lines(case)
    np.testing.assert_array_equal(line, [*ring, ring[0]])


def test_what_averaging_takes_for_small_is_doubted(tmp_path: Path) -> None:
    short = SCENARIO.replace('kind = "none"', 'kind = "biscay"')
    short = short.replace("days = 20.0", "days = 1.0").replace("[5.0, 10.0, 20.0]", "[1.0]")
    configuration = dc.GeographicConfiguration.from_toml(short)
    with pytest.warns(dc.DriftCoreWarning, match="averaging takes for small"):
        made = dc.run(configuration)
    doubt = "Averaging takes for small what here is not: epsilon = 0.52 (a tide over the run)"
    assert doubt in " ".join(Elements(written(made, tmp_path)).words.split())
    full = short.replace("members = 200", 'members = 200\nmodel = "full"')
    made = dc.run(dc.GeographicConfiguration.from_toml(full))
    (tmp_path / "full").mkdir()
    assert "Averaging takes" not in Elements(written(made, tmp_path / "full")).words


def test_it_stays_small(plane: dc.Forecast, tmp_path: Path) -> None:
    members, rng = 10_000, np.random.default_rng(1)
    maps = dc.MapGrid(x=np.linspace(0, 2, 401), y=np.linspace(0, 2, 401), times=np.arange(20) / 20)
    cells = 400 * 400
    # Members scattered so widely that nearly each has a cell for itself, at every time.
    scattered = rng.integers(0, cells, (20, members))
    present = np.stack([np.bincount(places, minlength=cells) for places in scattered])
    arrived = np.concatenate([present, present[:1]])
    nobody = np.zeros(20, dtype=np.uint32)
    many = plane.dataset.isel(member=np.arange(members) % 80).drop_vars("member")
    many = with_maps(many, maps, [present.ravel(), arrived.ravel(), nobody, nobody])
    page = written(dc.Forecast(many.assign_coords(member=np.arange(members))), tmp_path)
    assert len(page.encode()) < 5e6
    scene = scene_of(page)
    stops = scene["cells"]["stops"]
    assert sum(len(stop["steps"]) for stop in stops) <= _MOST_CELLS
    share = np.array([level[0] for level in scene["levels"]])
    # Joined, they hold as many members as before.
    assert [share[stop["levels"]].sum() for stop in stops] == pytest.approx([100.0] * 20, abs=0.1)
    assert scene["cells"]["size"][0] > 0.005


def test_without_its_coast_it_says_so(forecast: dc.GeographicForecast, tmp_path: Path) -> None:
    lost = forecast.dataset.copy()
    lost.attrs["configuration"] = lost.attrs["configuration"].replace(
        'file = "natural-earth"', 'file = "/nowhere/coast.geojson"'
    )
    words = Elements(written(dc.GeographicForecast(lost), tmp_path)).words
    assert "could not be read again" in words
    assert "/nowhere/coast.geojson" in words
    assert "Direction" in words


def test_a_coast_of_ones_own(forecast: dc.GeographicForecast, tmp_path: Path) -> None:
    made = forecast.dataset.copy()
    made.attrs["configuration"] = "# made in Python"
    coast = dc.LandCoast.default().cut(-8, 0, 43, 49).divide(length_km=50)
    words = Elements(written(dc.GeographicForecast(made), tmp_path, coast)).words
    assert "It was made in Python" in words
    assert "Stretch of coast" in words
    # Names tell nothing of where it is: the middles do.
    table = forecast.stranding_by_stretch(coast)
    first = str(table["stretch"].values[int(table["probability"].values.argmax())])
    assert f"{first}, " in words


@pytest.mark.parametrize("fate", [0, 3])
def test_where_nothing_strands(forecast: dc.GeographicForecast, fate: int, tmp_path: Path) -> None:
    dataset = forecast.dataset.copy(deep=True)
    dataset["status"][:] = fate
    dataset["stranding_time"][:] = np.datetime64("NaT", "ns")
    for axis in ("longitude", "latitude"):
        dataset[f"stranding_{axis}"][:] = np.nan
    words = " ".join(Elements(written(dc.GeographicForecast(dataset), tmp_path)).words.split())
    if fate:
        assert "no member could be followed" in words
        assert "200 of 200 members failed" in words
    else:
        assert "In 0 of 100 cases it strands within 20 days (0 to 1.9)." in words


def test_over_the_dateline_the_map_runs_on(tmp_path: Path) -> None:
    release = dc.Release.point(179.9, -16.0, "2026-07-01T06:00")
    scenario = dc.GeographicScenario(
        release=release,
        days=6,
        drifter=dc.FloatingBody(response_time_h=1.0, wind_factor=0.03),
        coast=dc.LandCoast.default(),
    )
    maps = dc.MapGrid(x=np.linspace(-184, -176, 33), y=np.linspace(-20, -12, 33), times=(3, 6))
    forecast = dc.forecast(scenario, dc.paper.default_wind(), members=60, keep=5, maps=maps)
    scene = scene_of(written(forecast, tmp_path))
    assert scene["cells"]["corner"][0] == pytest.approx(176)
    x = scene["strandings"]["x"]
    assert len(x) > 5
    assert 178 < min(x) < 180 < max(x) < 182


def test_a_file_that_is_there_stays(forecast: dc.GeographicForecast, path: Path) -> None:
    before = path.read_bytes()
    with pytest.raises(dc.OutputError, match="exists"):
        dc.report.write(forecast, path)
    assert path.read_bytes() == before


def test_what_it_refuses(plane: dc.Forecast, tmp_path: Path) -> None:
    with pytest.raises(dc.ScenarioError, match=r"path: .*page.pdf' is not .* ends in .html"):
        dc.report.write(plane, tmp_path / "page.pdf")
    with pytest.raises(dc.ScenarioError, match=r"forecast: str is not .*open_forecast"):
        dc.report.write("out.nc", tmp_path / "page.html")  # type: ignore[arg-type]  # refused
    assert not list(tmp_path.iterdir())


def test_without_bokeh_it_names_the_extra(
    plane: dc.Forecast, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "bokeh", None)
    with pytest.raises(dc.DriftCoreError, match=r"driftcore\[report\]"):
        dc.report.write(plane, tmp_path / "page.html")
    assert not list(tmp_path.iterdir())


def test_the_command(plane: dc.Forecast, tmp_path: Path) -> None:
    plane.to_netcdf(tmp_path / "out.nc")
    run = CliRunner().invoke(cli.app, ["report", str(tmp_path / "out.nc")])
    assert run.exit_code == 0, run.output
    assert "report" not in run.output
    assert (tmp_path / "out.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    again = CliRunner().invoke(cli.app, ["report", str(tmp_path / "out.nc")])
    assert isinstance(again.exception, dc.OutputError)


# In a browser.


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    names = ("chromium", "chromium-browser", "google-chrome")
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        absent = "no Chromium is installed (Debian: apt-get install chromium)"
        if os.environ.get(REQUIRED) == "required":
            pytest.fail(absent)
        pytest.skip(absent)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        # Without its sandbox, for it has none for root.
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def opened(chromium: Any, path: Path) -> Iterator[Any]:
    """Give what opens a page; any word of the console and any request fails the test."""
    told: list[str] = []
    contexts = []

    def open_page(page: Path = path, **options: Any) -> Any:
        context = chromium.new_context(**options)
        contexts.append(context)
        tab = context.new_page()
        tab.on(
            "console",
            lambda m: told.append(m.text) if m.type in ("error", "warning", "assert") else None,
        )
        tab.on("pageerror", lambda error: told.append(str(error)))
        tab.on(
            "request",
            lambda request: (
                told.append(request.url)
                if request.url != page.as_uri() and not request.url.startswith(("data:", "blob:"))
                else None
            ),
        )
        tab.goto(page.as_uri())
        tab.wait_for_selector("html[data-ready]", state="attached")
        return tab

    yield open_page
    for context in contexts:
        context.close()
    assert told == []


def model(tab: Any, name: str, value: str) -> Any:
    """Value of a model of the charts."""
    find = "Bokeh.documents.flatMap(d => [...d.all_models]).find(m => m.name == name)"
    return tab.evaluate(f"name => {find}.{value}", name)


def test_the_slider_moves_by_keys(opened: Any, forecast: dc.GeographicForecast) -> None:
    tab = opened()
    for _ in range(6):
        tab.keyboard.press("Tab")
        if tab.evaluate("document.activeElement.id") == "time":
            break
    assert tab.evaluate("document.activeElement.id") == "time"
    outline = tab.evaluate("getComputedStyle(document.activeElement).outlineStyle")
    assert outline == "solid"
    seen = []
    for _ in range(4):
        words = tab.text_content("#words"), tab.text_content("#label")
        assert tab.get_attribute("#time", "aria-valuetext") == words[1]
        seen.append((model(tab, "cells", "data.p"), words, model(tab, "strandings", "data.p")))
        tab.keyboard.press("ArrowRight")
    for k, presence in enumerate(forecast.dataset["presence"].values):
        np.testing.assert_allclose(seen[k][0], 100 * presence[presence > 0], atol=1e-5)
    assert [words[1].split(",")[0] for _, words, _ in seen] == [
        "Day 5",
        "Day 10",
        "Day 20",
        "Whole run",
    ]
    assert sum(seen[0][2]) < sum(seen[1][2]) < sum(seen[2][2])


def test_a_tooltip_tells_the_probability(opened: Any) -> None:
    tab = opened()
    tab.locator("#map").scroll_into_view_if_needed()
    x, y, text = tab.evaluate(
        """() => {
            const data = Bokeh.documents.flatMap(d => [...d.all_models])
                .find(m => m.name == "cells").data;
            const most = data.p.indexOf(Math.max(...data.p));
            const view = [...Bokeh.index].find(v => v.model.name == "map");
            const box = view.el.getBoundingClientRect();
            return [
                box.x + view.frame.x_scale.compute(data.x[most]),
                box.y + view.frame.y_scale.compute(data.y[most]),
                data.text[most],
            ];
        }"""
    )
    tab.mouse.move(x - 3, y - 3)
    tab.mouse.move(x, y)
    tooltip = tab.locator(".bk-tooltip-content", has_text=text)
    tooltip.wait_for(timeout=5000)
    assert "of 100 (" in text


def test_the_map_moves_by_keys_and_buttons(opened: Any) -> None:
    tab = opened()

    def view() -> np.ndarray:
        ends = [model(tab, "map", f"{a}_range.{end}") for a in "xy" for end in ("start", "end")]
        return np.array(ends)

    whole = view()
    # A degree of longitude is as long as it is in the middle of the map.
    frame = tab.evaluate(
        """() => { const {width, height} = [...Bokeh.index].find(v => v.model.name == "map")
            .frame.bbox; return [width, height]; }"""
    )
    degrees = whole[1::2] - whole[::2]
    shrink = np.cos(np.radians(whole[2:].mean()))
    assert degrees[0] * shrink / frame[0] == pytest.approx(degrees[1] / frame[1], rel=0.02)
    tab.focus("#map")
    tab.keyboard.press("+")
    np.testing.assert_allclose(view()[1] - view()[0], degrees[0] / 1.5, rtol=1e-6)
    before = view()
    tab.keyboard.press("ArrowRight")
    assert (view()[:2] > before[:2]).all()
    tab.click("text=Show all")
    np.testing.assert_allclose(view(), whole, atol=1e-6)
    tab.get_by_label("paths of the first 20").check()
    assert model(tab, "paths", "visible")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("case", ["sea", "plane"])
def test_whoever_reads_otherwise_can(
    opened: Any, scheme: str, case: str, plane: dc.Forecast, path: Path, tmp_path: Path
) -> None:
    from axe_playwright_python.sync_playwright import Axe

    if case == "plane":
        path = tmp_path / "plane.html"
        dc.report.write(plane, path)
    tab = opened(path, color_scheme=scheme)
    tab.evaluate("document.querySelectorAll('details').forEach(d => { d.open = true; })")
    found = Axe().run(tab)
    assert found.violations_count == 0, found.generate_report()


def test_night_and_day(opened: Any) -> None:
    tab = opened(color_scheme="dark")
    colours = []
    for scheme in ("dark", "light"):
        tab.emulate_media(color_scheme=scheme)
        tab.wait_for_timeout(300)  # the charts follow when the browser tells of the change
        body = tab.evaluate("getComputedStyle(document.body).backgroundColor")
        colours.append((body, model(tab, "map", "background_fill_color")))
        assert model(tab, "scale", "palette.length") > 32
    assert colours == [("rgb(18, 24, 31)", "#16202b"), ("rgb(255, 255, 255)", "#f7fafd")]


def test_paper_is_in_daylight(opened: Any) -> None:
    tab = opened(color_scheme="dark")
    tab.focus("#time")
    tab.keyboard.press("ArrowRight")
    pdf = tab.pdf(prefer_css_page_size=True)
    assert pdf.startswith(b"%PDF")
    # A4 in points.
    assert b"/MediaBox [0 0 594.95996 841.91998]" in pdf or b"/MediaBox [0 0 595" in pdf
    # Nothing of the picture is as dark as the sea and the land at night.
    dark = tab.evaluate(
        """() => {
            const picture = document.querySelector("#map > canvas");
            const {data} = picture.getContext("2d")
                .getImageData(0, 0, picture.width, picture.height);
            let dark = 0;
            for (let k = 0; k < data.length; k += 4) dark += data[k] < 70 && data[k + 1] < 70;
            return dark / (data.length / 4);
        }"""
    )
    assert dark < 0.1
    assert model(tab, "map", "background_fill_color") == "#16202b"


def test_a_phone_shows_it_all(opened: Any) -> None:
    tab = opened(viewport={"width": 360, "height": 740}, has_touch=True, is_mobile=True)
    assert tab.evaluate("document.documentElement.scrollWidth") <= 360
    assert tab.locator("#map").bounding_box()["width"] > 300
    # One finger scrolls the page.
    assert not model(tab, "map", "toolbar.tools.find(t => t.type == 'PanTool').active")
