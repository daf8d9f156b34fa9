"""A forecast as one page for whoever must decide: a file that asks for no network.

It knows datasets and what their methods estimate, and holds no science. All words that come from a
file pass through the template, which escapes them, or as data through JSON.
"""

from __future__ import annotations

import json
import math
import os
from base64 import b64encode
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from hashlib import sha256
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from driftcore.coast import near_longitude, place_name
from driftcore.configuration import read_toml
from driftcore.dataset import STATUSES, is_geographic
from driftcore.earth import KM_PER_DEGREE
from driftcore.errors import DriftCoreError, ScenarioError
from driftcore.files import check_writable, replacing
from driftcore.geographic import Scaling
from driftcore.map_drawing import surroundings
from driftcore.statistics import Probability, probability
from driftcore.words import how, set_up

if TYPE_CHECKING:
    import xarray as xr

    from driftcore.coast import LandCoast
    from driftcore.results import Forecast

__all__ = ["write"]

Floats = NDArray[np.float64]
# West, east, south, north.
_Box = tuple[float, float, float, float]

# What keeps the page small, however many members there are.
_MOST_CELLS, _MOST_PLACES, _MOST_PATHS, _MOST_POINTS = 100_000, 1500, 100, 160
_CURVE_POINTS, _CURVE_ROWS = 240, 8
_MAP_HEIGHT, _CURVE_HEIGHT = 580, 320  # px
# Rows shown of a coast divided into many stretches.
_MOST_STRETCHES = 16
_SECTORS = (
    "north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west",
)  # fmt: skip
_MONTHS = (
    "January", "February", "March", "April", "May", "June", "July", "August", "September",
    "October", "November", "December",
)  # fmt: skip
_FATES = {
    "afloat": "are still afloat at the end",
    "left_domain": "leave the area for which tide and current are known",
}
_LIMITS = (
    "The intervals tell what the number of simulated winds leaves unsure. They hold nothing of "
    "what is unsure about the climate of the wind, the tide, the current, the coast or the thing "
    "itself.",
    "Winds are resampled from the past: a climate. The weather of the day, which decides the first "
    "days, is in it only where the wind record says that it was handed over from a forecast.",
    "The thing is small. Waves act on it only through its wind factor or leeway.",
    "Whatever touches the coast stays there. A bay or an estuary narrower than the lines of the "
    "coast does not exist.",
)


def write(
    forecast: Forecast,
    path: str | os.PathLike[str],
    coast: LandCoast | None = None,
    overwrite: bool = False,
) -> None:
    """Write a forecast as one HTML file: in words, as a map, by stretch of the coast, in time.

    Parameters
    ----------
    forecast : Forecast
        On the real sea, or of the paper's case. With maps the page has a slider of their times.
    path : path
        File to write, ``.html``. It holds all that it needs and asks for no network.
    coast : LandCoast, optional
        Land to draw on the real sea; its stretches, if any, are those that strandings are summed
        up by. Default that of the forecast's configuration, or the land of the package.
    overwrite : bool
        Replace a file that is there.

    Raises
    ------
    OutputError
        The file exists and `overwrite` is not set, or it cannot be written.
    ScenarioError
        `forecast` is none, or the suffix is another.
    DriftCoreError
        Bokeh is missing.
    """
    if not hasattr(forecast, "dataset"):
        raise ScenarioError(
            f"forecast: {type(forecast).__name__} is not accepted; a Forecast, as "
            "driftcore.open_forecast reads it"
        )
    target = Path(path)
    if target.suffix.lower() not in (".html", ".htm"):
        raise ScenarioError(f"path: '{target}' is not accepted; a name that ends in .html")
    check_writable(target, overwrite)
    try:
        import bokeh  # noqa: F401  # met before any work
    except ImportError:
        raise DriftCoreError(
            'a report needs Bokeh, which is not installed: pip install "driftcore[report]"'
        ) from None
    page = _page(forecast, coast)
    with replacing(target, overwrite) as temporary:
        temporary.write_text(page, encoding="utf-8")


def _page(forecast: Forecast, coast: LandCoast | None) -> str:
    from bokeh.resources import Resources
    from jinja2 import Environment, PackageLoader
    from markupsafe import Markup

    case = _case(forecast, coast)
    figures: dict[str, Any] = {}
    figures["map"], scene = _map(case)
    if forecast.followed:
        figures["curve"] = _curve(case)
    data = resources.files("driftcore") / "data"
    scripts = [
        *Resources(mode="inline", components=["bokeh"], log_level="warn").js_raw,
        (data / "report.js").read_text(encoding="utf-8"),
    ]
    # The page runs these scripts, to the letter, and no other; and it loads nothing.
    hashes = " ".join(f"'sha256-{_hash(script)}'" for script in scripts)
    policy = (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; "
        "img-src data: blob:; font-src data:; base-uri 'none'; form-action 'none'"
    )
    environment = Environment(
        loader=PackageLoader("driftcore", "data"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html").render(
        **_content(case),
        stops=scene["stops"],
        figures=figures.keys(),
        policy=Markup(policy),  # noqa: S704  # ours
        style=Markup((data / "report.css").read_text(encoding="utf-8")),  # noqa: S704
        scripts=[Markup(script) for script in scripts],  # noqa: S704
        data=Markup(_json({"figures": figures, "scene": scene})),  # noqa: S704  # escaped there
    )


def _hash(script: str) -> str:
    return b64encode(sha256(script.encode()).digest()).decode()


def _json(values: Any) -> str:
    """Give JSON that no text in it can leave the element of."""
    text = json.dumps(values, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@dataclass
class _Case:
    """What differs between a forecast on the real sea and one of the paper's case."""

    forecast: Forecast
    days: float
    """Length of the run."""
    release: tuple[float, float]
    ends: Floats
    """Where each member stranded, shape (member, 2); NaN where it did not."""
    end_days: Floats
    """When, in days after the release."""
    paths: Floats
    """Shape (kept member, time, 2)."""
    kept: NDArray[np.int64]
    x: Floats | None = None
    """Edges of the maps' columns."""
    y: Floats | None = None
    map_days: Sequence[float] = ()
    coast: LandCoast | None = None
    doubts: list[str] = field(default_factory=list)

    @property
    def dataset(self) -> xr.Dataset:
        return self.forecast.dataset

    @property
    def geographic(self) -> bool:
        return is_geographic(self.dataset)

    @property
    def start(self) -> np.datetime64:
        return np.datetime64(self.dataset.attrs["start"], "ns")

    def date(self, day: float) -> str:
        """Give the date of a day after the release, where there is one."""
        if not self.geographic:
            return ""
        instant: datetime = (
            (self.start + np.timedelta64(round(day * 86_400), "s")).astype("datetime64[s]").item()
        )
        return f"{instant.day} {_MONTHS[instant.month - 1]} {instant:%Y, %H:%M} UTC"

    def when(self, day: float) -> str:
        """Give a day after the release in words, with its date."""
        date = self.date(day).partition(",")[0]
        return f"day {_days(day)}" + (f", {date}" if date else "")

    def place(self, x: float, y: float) -> str:
        if self.geographic:
            return place_name(x, y).replace(" ", "\u00a0")  # one word where lines break
        return f"({x:.3g}, {y:.3g})"

    def by(self, day: float) -> Any:
        """Give a day as the forecast's methods take times."""
        if self.geographic:
            return self.start + np.timedelta64(round(day * 86_400e9), "ns")
        return day / self.forecast.days_per_unit


def _case(forecast: Forecast, coast: LandCoast | None) -> _Case:
    dataset = forecast.dataset
    about = dataset.attrs
    unit = forecast.days_per_unit
    doubts = [] if "wind_synthetic" not in about or not about["wind_synthetic"] else [
        "The wind is of a synthetic climate, which says nothing about a real sea."
    ]  # fmt: skip
    kept = dataset["kept_member" if "kept_member" in dataset else "member"].values[:_MOST_PATHS]
    if not is_geographic(dataset):
        x, y = ((_edges(dataset[f"{a}_bounds"].values) if a in dataset else None) for a in "xy")
        return _Case(
            forecast,
            days=float(about["duration"]) * unit,
            release=tuple(json.loads(about["release"])),
            ends=dataset["stranding_position"].values,
            end_days=dataset["stranding_time"].values * unit,
            paths=dataset["position"].values[: len(kept)],
            kept=kept,
            x=x,
            y=y,
            map_days=[float(t) * unit for t in dataset["map_time"].values] if x is not None else (),
            doubts=[
                *doubts,
                "This is the paper's academic case: sea, coast and body are idealised, lengths and "
                "times have no unit; days are those of its tide of "
                f"{about['tide_period_h']:g} hours.",
                *_failures(forecast),
            ],
        )
    middle = [
        float(np.nanmedian(dataset[f"release_{a}"].values)) for a in ("longitude", "latitude")
    ]

    def degrees(name: str) -> Floats:
        places = [dataset[f"{name}{axis}"].values for axis in ("longitude", "latitude")]
        return np.stack([near_longitude(places[0], middle[0]), places[1]], axis=-1)

    start = np.datetime64(about["start"], "ns")
    day = np.timedelta64(1, "D")
    x = y = None
    if "presence" in dataset:
        x, y = (_edges(dataset[f"map_{a}_bounds"].values) for a in ("longitude", "latitude"))
        x = x + float(near_longitude(x.mean(), middle[0]) - x.mean())
    doubts += [f"{doubt[0].upper()}{doubt[1:]}." for doubt in _doubts(forecast)]
    return _Case(
        forecast,
        days=float(about["days"]),
        release=(middle[0], middle[1]),
        ends=degrees("stranding_"),
        end_days=(dataset["stranding_time"].values - start) / day,
        paths=degrees("")[: len(kept)],
        kept=kept,
        x=x,
        y=y,
        map_days=[] if x is None else ((dataset["map_time"].values - start) / day).tolist(),
        coast=_land(forecast, coast, doubts),
        doubts=[*doubts, *_failures(forecast)],
    )


def _land(forecast: Any, coast: LandCoast | None, doubts: list[str]) -> LandCoast:
    """Give the land to draw: what is asked for, or the forecast's own, or that of the package."""
    from driftcore.coast import LandCoast

    if coast is not None:
        return coast
    try:
        found: LandCoast | None = forecast.coast()
    except DriftCoreError as error:
        doubts.append(
            f"The coast of the scenario could not be read again ({error}). The map shows the land "
            "of the package, and strandings are summed up by direction."
        )
        found = None
    return LandCoast.default() if found is None else found


def _doubts(forecast: Forecast) -> Iterator[str]:
    """Say what no real forecast would have, and what averaging takes for small and is not."""
    from driftcore.geographic_configuration import GeographicConfiguration

    about = forecast.dataset.attrs
    text = forecast.configuration()
    if "kind" in read_toml(text):
        for doubt in GeographicConfiguration.from_toml(text).doubts():
            if not (about.get("wind_synthetic") and doubt.startswith("wind:")):
                yield doubt
    problems = Scaling(**{name: about[f"scaling_{name}"] for name in Scaling._fields}).problems()
    if problems and about["model"] != "full":
        yield (
            "averaging takes for small what here is not: "
            + "; ".join(problems)
            + '; compare with model = "full"'
        )


def _failures(forecast: Forecast) -> Iterator[str]:
    failed = forecast.counts["failed"]
    if failed:
        yield (
            f"{failed:,} of {forecast.dataset.sizes['member']:,} members failed: they could not be "
            "followed, and count nowhere."
        )


def _edges(bounds: Floats) -> Floats:
    return np.append(bounds[:, 0], bounds[-1, 1])


# Words.


def _number(value: float) -> str:
    """Write a number as people do: as many digits as matter."""
    size = abs(value)
    if size >= 10 or value == round(value):
        return f"{value:.0f}"
    return f"{value:.1f}" if size >= 0.1 else f"{value:.1g}"


def _days(day: float) -> str:
    """Write a day: nobody plans by tenths of one, but at first."""
    return f"{day:.0f}" if day >= 3 or day == round(day) else f"{day:.1f}"


def _percent(share: float) -> str:
    return _number(100 * share)


def _span(p: Probability) -> str:
    return f"{_percent(p.low)} to {_percent(p.high)}"


def _row(name: str, p: Probability, more: str = "") -> dict[str, Any]:
    """Give a row of a table of probabilities, whose bar runs over percents."""
    shares = {"p": p.estimate, "low": p.low, "high": p.high}
    return {
        "name": name,
        "percent": _percent(p.estimate),
        "span": _span(p),
        "more": more,
        **{key: round(100 * share, 3) for key, share in shares.items()},
    }


def _content(case: _Case) -> dict[str, Any]:
    """Give what the template tells."""
    forecast, about = case.forecast, case.dataset.attrs
    members = case.dataset.sizes["member"]
    text = forecast.configuration()
    stored = bool(read_toml(text))
    facts = [*set_up(forecast), *how(forecast)]
    from_when = f"from {case.date(0.0)} at {case.place(*case.release)}" if case.geographic else ""
    by = [_row(*entry) for entry in _coast_rows(case)]
    widest = max((row["high"] for row in by), default=1.0)
    return {
        "title": f"Where “{about['scenario']}” may come ashore",
        "subtitle": f"{_number(case.days)} days adrift {from_when}".strip(),
        "members": f"{members:,}",
        "geographic": case.geographic,
        "answers": list(_answers(case, by)),
        "doubts": case.doubts,
        "limits": _LIMITS,
        "coast_rows": by,
        "widest": widest,
        "by_stretch": bool(case.coast is not None and case.coast.stretches),
        "target_rows": [_row(*entry) for entry in _target_rows(case)],
        "curve_rows": list(_curve_rows(case)),
        "map_rows": list(_map_rows(case)),
        "paths": len(case.paths),
        "facts": facts,
        "sha256": about.get("wind_sha256"),
        "version": about["driftcore_version"],
        "seed": str(about["seed"]),
        "history": about["history"],
        "configuration": text if stored else None,
        "download": "data:application/toml;base64," + b64encode(text.encode()).decode(),
    }


def _answers(case: _Case, by: list[dict[str, Any]]) -> Iterator[tuple[str, str, str]]:
    """Give the key figures: what, the figure in words, and what it means."""
    forecast = case.forecast
    if not forecast.followed:
        yield "No answer", "no member could be followed", "Every simulated case failed."
        return
    p = forecast.stranding_probability()
    yield (
        "How likely ashore",
        f"{_percent(p.estimate)} of 100",
        f"In {_percent(p.estimate)} of 100 cases it strands within {_number(case.days)} days "
        f"({_span(p)}).",
    )
    early, middle, late = forecast.stranding_time_quantiles().values * forecast.days_per_unit
    if p.count:
        yield (
            "When",
            f"day {_days(early)} to {_days(late)}",
            "Nine in ten of those that strand do so within these days after the release; half of "
            f"them by {case.when(middle)}.",
        )
        first, *rest = sorted(by, key=lambda row: -row["p"])
        more = [f"{row['name']} {row['percent']}" for row in rest[:2] if row["p"]]
        yield (
            "Where most likely",
            first["name"] if case.coast is not None and case.coast.stretches else
            f"to the {first['name']}",
            f"There in {first['percent']} of 100 cases ({first['span']})"
            + (f"; then {', '.join(more)}." if more else "."),
        )  # fmt: skip
    told = []
    for status, words in _FATES.items():
        count = forecast.counts[status]
        if count or status == "afloat":
            q = probability(count, forecast.followed)
            told.append(f"{_percent(q.estimate)} of 100 {words} ({_span(q)})")
    failed = forecast.counts["failed"]
    told.append(f"{failed:,} could not be followed" if failed else "none failed")
    yield (
        "Otherwise",
        f"{_percent(1 - p.estimate)} of 100",
        f"{'; '.join(told)}.",
    )


def _coast_rows(case: _Case) -> Iterator[tuple[str, Probability, str]]:
    """Give strandings by stretch of the coast where it has any, else by direction."""
    forecast = case.forecast
    if not forecast.followed:
        return
    if case.coast is None or not case.coast.stretches:
        found = forecast.stranding_by_sector(len(_SECTORS))
        for name, share in zip(_SECTORS, found["probability"].values, strict=True):
            yield name, _share(share, forecast.followed), ""
        return
    stretches = case.coast.stretches
    table: xr.Dataset = forecast.stranding_by_stretch(case.coast)  # type: ignore[attr-defined]
    shares = table["probability"].values
    rows = np.arange(len(shares))
    if len(stretches) > _MOST_STRETCHES:
        # Many pieces of one length: those that catch most.
        rows = np.argsort(-shares, kind="stable")[:_MOST_STRETCHES]
        rows = rows[shares[rows] > 0]
    for k in rows:
        name = str(table["stretch"].values[k])
        days = table["time_quantile"].values[:, k]
        when = "" if np.isnan(days).any() else " – ".join(_days(d) for d in days)
        if len(stretches) > _MOST_STRETCHES and name in stretches:
            middle = stretches[name].interpolate(0.5, normalized=True)
            name = f"{name}, {case.place(middle.x, middle.y)}"
        yield name, _share(shares[k], forecast.followed), when


def _share(share: float, members: int) -> Probability:
    return probability(round(float(share) * members), members)


def _target_rows(case: _Case) -> Iterator[tuple[str, Probability]]:
    if "target" in case.dataset and case.forecast.followed:
        for name in case.dataset["target"].values:
            yield str(name), case.forecast.entry_probability(name)


def _curve_rows(case: _Case) -> Iterator[dict[str, Any]]:
    if case.forecast.followed:
        for day in np.linspace(0, case.days, _CURVE_ROWS + 1)[1:]:
            p = case.forecast.stranding_probability(by=case.by(day))
            yield _row(f"{_number(day)}", p, case.date(day))


def _map_rows(case: _Case) -> Iterator[dict[str, Any]]:
    """Tell of each map what its cells tell the eye."""
    followed = case.forecast.followed
    if case.x is None or case.y is None or not followed:
        return
    for day, presence, outside, ashore in zip(
        case.map_days,
        case.dataset["presence"].values,
        case.dataset["outside"].values,
        case.dataset["ashore"].values,
        strict=True,
    ):
        row, column = np.unravel_index(np.argmax(presence), presence.shape)
        most = _share(presence[row, column], followed)
        middle = [edges[k : k + 2].mean() for edges, k in ((case.x, column), (case.y, row))]
        yield {
            "day": _number(day),
            "date": case.date(day),
            "afloat": _percent(presence.sum()),
            "outside": _percent(outside),
            "ashore": _percent(ashore),
            "place": case.place(*middle) if most.count else "nowhere",
            "most": f"{_percent(most.estimate)} ({_span(most)})",
        }


# Charts.


def _figure(height: int, **options: Any) -> Any:
    """Give a figure whose colours are names, of which the page's style sheet says what they are."""
    from bokeh.plotting import figure

    plot: Any = figure(
        height=height,
        sizing_mode="stretch_width",
        toolbar_location=None,
        output_backend="canvas",
        min_border=6,
        **options,
    )
    _colour(plot, background_fill_color="sea", border_fill_color="page", outline_line_color="rule")
    for axis in plot.axis:
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = axis.major_label_text_font_size = "13px"
        _colour(
            axis,
            axis_label_text_color="ink",
            major_label_text_color="ink",
            axis_line_color="rule",
            major_tick_line_color="rule",
            minor_tick_line_color="rule",
        )
    for grid in plot.grid:
        _colour(grid, grid_line_color="grid")
    return plot


def _colour(model: Any, **names: str) -> None:
    model.tags = [names]


def _item(plot: Any, target: Any) -> Any:
    from bokeh.embed import json_item

    return json_item(plot, target)


def _curve(case: _Case) -> Any:
    """Draw the probability of having stranded by a day, and its interval."""
    from bokeh.models import ColumnDataSource, HoverTool, NumeralTickFormatter

    days = np.linspace(0.0, case.days, _CURVE_POINTS + 1)
    found = [case.forecast.stranding_probability(by=case.by(day)) for day in days]
    source = ColumnDataSource(
        {
            "day": days.round(4),
            "p": [round(100 * p.estimate, 3) for p in found],
            "low": [round(100 * p.low, 3) for p in found],
            "high": [round(100 * p.high, 3) for p in found],
            "text": [f"{_percent(p.estimate)} of 100 ({_span(p)})" for p in found],
            "date": [case.date(day) or f"day {_number(day)}" for day in days],
        }
    )
    plot = _figure(
        _CURVE_HEIGHT,
        x_axis_label="days after the release",
        y_axis_label="stranded by then, of 100",
        x_range=(0.0, case.days),
        y_range=(0.0, min(100.0, max(5.0, 108 * found[-1].high))),
        tools="",
    )
    plot.yaxis.formatter = NumeralTickFormatter(format="0.[0]")
    band = plot.varea("day", "low", "high", source=source, fill_alpha=0.3)
    line = plot.line("day", "p", source=source, line_width=2.5)
    _colour(band.glyph, fill_color="curve")
    _colour(line.glyph, line_color="curve")
    plot.add_tools(
        HoverTool(renderers=[line], mode="vline", tooltips=[("by", "@date"), ("stranded", "@text")])
    )
    return _item(plot, "curve")


@dataclass
class _Cells:
    """Cells of the maps where anything is, at each stop of the slider."""

    corner: tuple[float, float]
    size: tuple[float, float]
    columns: int
    stops: list[tuple[NDArray[np.int64], NDArray[np.int64]]]
    """Index of each cell, row by row, and how many members are there."""
    visits: bool
    """Whether the last stop is of the whole run."""

    def middles(self, index: NDArray[np.int64]) -> Floats:
        """Give the middles of cells, shape (n, 2)."""
        rows, columns = np.divmod(index, self.columns)
        places = np.stack([columns, rows], axis=-1) + 0.5
        return np.asarray(np.array(self.corner) + places * np.array(self.size))


def _cells(case: _Case) -> _Cells | None:
    """Give the members of each cell; cells are joined, two by two, until the page stays small."""
    if case.x is None or case.y is None or not case.forecast.followed:
        return None
    followed = case.forecast.followed
    counts, visited = (
        np.rint(case.dataset[name].values * followed).astype(np.int64)
        for name in ("presence", "visit")
    )
    steps = [edges[1] - edges[0] for edges in (case.x, case.y)]
    joined = 1
    while np.count_nonzero(counts) > _MOST_CELLS:
        joined *= 2
        for axis in (1, 2):
            counts = np.add.reduceat(counts, np.arange(0, counts.shape[axis], 2), axis)
    # Who visits two cells that are joined cannot be told from two that visit one each.
    maps = [*counts, visited] if joined == 1 else [*counts]
    stops = []
    for count in maps:
        index = np.flatnonzero(count)
        stops.append((index, count.ravel()[index]))
    return _Cells(
        corner=(float(case.x[0]), float(case.y[0])),
        size=(float(steps[0] * joined), float(steps[1] * joined)),
        columns=counts.shape[2],
        stops=stops,
        visits=joined == 1,
    )


def _map(case: _Case) -> tuple[Any, dict[str, Any]]:
    """Draw the map, and give what the page puts on it at each stop of its slider."""
    from bokeh.models import ColumnDataSource, LogColorMapper, PanTool, Range1d, WheelZoomTool
    from bokeh.palettes import YlGnBu9, interp_palette

    cells = _cells(case)
    visible = [case.ends, case.paths.reshape(-1, 2), np.array([case.release]), *_coast_lines(case)]
    if cells is not None:
        visible += [cells.middles(index) for index, _ in cells.stops]
    box = surroundings(visible)
    west, east, south, north = box
    limits = _around(box, case.geographic)
    names = ("longitude [° east]", "latitude [° north]")
    if not case.geographic:
        names = ("x [scenario units]", "y [scenario units]")
    plot = _figure(
        _MAP_HEIGHT,
        tools="",
        x_axis_label=names[0],
        y_axis_label=names[1],
        x_range=Range1d(start=west, end=east, bounds=limits[:2]),
        y_range=Range1d(start=south, end=north, bounds=limits[2:]),
        name="map",
    )
    columns: dict[str, Any] = {name: [] for name in ("x", "y", "p", "text", "place")}
    if cells is not None:
        palette = interp_palette(YlGnBu9, 64)
        mapper = LogColorMapper(palette=palette, low=1e-3, high=100.0, name="scale")
        # The rarest is nearest to the sea, by day as by night.
        mapper.tags = [{}, {"light": palette[::-1][6:], "dark": palette[6:]}]
        colour = {"field": "p", "transform": mapper}
        source = ColumnDataSource(columns, name="cells")
        width, height = cells.size
        look = {"fill_color": colour, "line_color": colour, "line_width": 0.6}
        drawn = plot.rect("x", "y", width, height, source=source, name="presence", **look)
        _tell(plot, drawn, [("here", "@text"), ("place", "@place")])
        _colour_bar(plot, mapper, _cell_words(case, cells))
    _draw_coast(plot, case, limits)
    _draw_paths(plot, case)
    source = ColumnDataSource({**columns, "size": []}, name="strandings")
    look = {"fill_alpha": 0.55, "line_width": 0.7, "name": "stranded"}
    drawn = plot.scatter("x", "y", size="size", source=source, **look)
    _colour(drawn.glyph, fill_color="stranded", line_color="edge")
    _tell(plot, drawn, [("strands", "@text"), ("place", "@place")])
    x, y = case.release
    release = ColumnDataSource({"x": [x], "y": [y], "place": [case.place(x, y)]})
    drawn = plot.scatter("x", "y", source=release, marker="star", size=20, line_width=1.2)
    _colour(drawn.glyph, fill_color="release", line_color="edge")
    _tell(plot, drawn, [("release", "@place")])
    pan, wheel = PanTool(), WheelZoomTool(modifiers={"ctrl": True})
    plot.add_tools(pan, wheel)
    plot.toolbar.active_drag, plot.toolbar.active_scroll = pan, wheel
    return _item(plot, "map"), _scene(case, cells, box)


def _scene(case: _Case, cells: _Cells | None, box: _Box) -> dict[str, Any]:
    """Give what the page puts on the map; a number of members is said once in words."""
    levels: dict[int, int] = {}

    def level(counts: NDArray[np.int64]) -> list[int]:
        return [levels.setdefault(count, len(levels)) for count in counts.tolist()]

    stops = list(_stops(case, cells))
    places, counts = _stranding_places(case, [day for day, *_ in stops])
    scene: dict[str, Any] = {
        "geographic": case.geographic,
        "km": KM_PER_DEGREE,
        "aspect": _shrink(box) if case.geographic else 1.0,
        "stops": [{"label": label, "words": words} for _, label, words in stops],
        "visits": cells is not None and cells.visits,
        "strandings": {
            "x": places[:, 0].round(4).tolist(),
            "y": places[:, 1].round(4).tolist(),
            "levels": [level(count) for count in counts],
        },
        "cells": None,
    }
    if cells is not None:
        scene["cells"] = {
            "corner": cells.corner,
            "size": cells.size,
            "columns": cells.columns,
            "stops": [
                {"steps": np.diff(index, prepend=0).tolist(), "levels": level(count)}
                for index, count in cells.stops
            ],
        }
    followed = case.forecast.followed
    known = [probability(count, followed) for count in levels]
    scene["levels"] = [
        [round(100 * p.estimate, 5), f"{_percent(p.estimate)} of 100 ({_span(p)})"] for p in known
    ]
    return scene


def _stops(case: _Case, cells: _Cells | None) -> Iterator[tuple[float, str, str]]:
    """Give the stops of the slider: the day, its name, and what the map then shows."""
    if cells is not None:
        for row, day in zip(_map_rows(case), case.map_days, strict=True):
            yield (
                day,
                f"Day {row['day']}" + (f", {row['date']}" if row["date"] else ""),
                f"{row['afloat']} of 100 are afloat on the map, {row['outside']} beyond it, "
                f"{row['ashore']} have stranded. Most likely it floats about {row['place']}: in "
                f"that cell in {row['most']} of 100 cases.",
            )
    words = "Every place where it strands within the run."
    if cells is not None and cells.visits:
        words = f"How likely it passes through each cell at any time. {words}"
    if cells is None or cells.visits:
        yield case.days, f"Whole run, {_number(case.days)} days", words


def _stranding_places(case: _Case, days: list[float]) -> tuple[Floats, list[NDArray[np.int64]]]:
    """Give places where members strand, near ones as one, and how many have by each day."""
    stranded = np.flatnonzero(np.isfinite(case.ends[:, 0]))
    ends, when = case.ends[stranded], case.end_days[stranded]
    if not len(ends):
        return np.zeros((0, 2)), [np.zeros(0, dtype=np.int64) for _ in days]
    size = max(float(np.ptp(ends, axis=0).max()), 1e-9) / 120
    while True:
        _, group = np.unique(np.floor(ends / size), axis=0, return_inverse=True)
        group = group.ravel()
        total = np.bincount(group)
        if len(total) <= _MOST_PLACES:
            break
        size *= 2
    middles = np.stack([np.bincount(group, ends[:, k]) / total for k in (0, 1)], axis=-1)
    # A hair more than the day, as times of maps and of strandings are rounded differently.
    return middles, [np.bincount(group[when <= day + 1e-9], minlength=len(total)) for day in days]


def _around(box: _Box, geographic: bool) -> _Box:
    """Give how far the map can be moved."""
    west, east, south, north = box
    wide, high = east - west, north - south
    if geographic:
        return west - wide, east + wide, max(south - high, -89.0), min(north + high, 89.0)
    return west - wide, east + wide, south - high, north + high


def _shrink(box: _Box) -> float:
    """Length of a degree of longitude, in degrees of latitude."""
    return math.cos(math.radians((box[2] + box[3]) / 2))


def _cell_words(case: _Case, cells: _Cells) -> str:
    if not case.geographic:
        return "of 100 cases, in a cell"
    middle = math.radians(cells.corner[1] + cells.size[1] / 2)
    width, height = (KM_PER_DEGREE * size for size in cells.size)
    across = _number(width * math.cos(middle))
    return f"of 100 cases, in a cell of {across} × {_number(height)} km"


def _tell(plot: Any, drawn: Any, tooltips: list[tuple[str, str]]) -> None:
    from bokeh.models import HoverTool

    plot.add_tools(HoverTool(renderers=[drawn], tooltips=tooltips))


def _colour_bar(plot: Any, mapper: Any, title: str) -> None:
    from bokeh.models import LogTicker, PrintfTickFormatter
    from bokeh.models.annotations import ColorBar

    bar = ColorBar(
        color_mapper=mapper,
        ticker=LogTicker(desired_num_ticks=6, num_minor_ticks=0),
        formatter=PrintfTickFormatter(format="%g"),
        height=10,
        title=title,
        title_text_font_style="normal",
        title_text_font_size="13px",
        major_label_text_font_size="13px",
    )
    _colour(
        bar,
        background_fill_color="page",
        title_text_color="ink",
        major_label_text_color="ink",
        bar_line_color="rule",
        major_tick_line_color="rule",
    )
    plot.add_layout(bar, "below")


def _draw_coast(plot: Any, case: _Case, limits: _Box) -> None:
    """Draw land on the real sea, the coast line of the paper's case."""
    if case.coast is None:
        lines = _coast_lines(case)
        drawn = plot.multi_line(
            [line[:, 0] for line in lines], [line[:, 1] for line in lines], line_width=2
        )
        _colour(drawn.glyph, line_color="shore")
        return
    import shapely

    whole = case.coast
    if whole.box is None:
        whole = whole.around(case.release[0])
    west, east, south, north = limits
    seen = shapely.intersection(whole.polygons, shapely.box(west, south, east, north))
    # Finer than that no screen shows it, before it is enlarged tenfold.
    seen = shapely.get_parts(shapely.simplify(seen, (east - west) / 20_000))
    seen = seen[
        (shapely.get_type_id(seen) == shapely.GeometryType.POLYGON) & (shapely.area(seen) > 0)
    ]
    rings = [
        [shapely.get_coordinates(ring).round(4) for ring in shapely.get_rings(p)] for p in seen
    ]
    drawn = plot.multi_polygons(
        *([[[ring[:, k].tolist() for ring in polygon]] for polygon in rings] for k in (0, 1)),
        line_width=0.8,
        name="land",
    )
    _colour(drawn.glyph, fill_color="land", line_color="shore")


def _coast_lines(case: _Case) -> list[Floats]:
    """Lines of the paper's coast; land is drawn otherwise."""
    if case.geographic:
        return []
    coast = json.loads(case.dataset.attrs.get("coast", "{}"))
    if coast.get("kind") == "circle":
        turn = np.linspace(0, 2 * np.pi, 361)
        unit = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        return [np.array(coast["center"]) + coast["radius"] * unit]
    rings = [np.asarray(ring, dtype=float) for ring in coast.get("rings", ())]
    return [np.concatenate([ring, ring[:1]]) for ring in rings]


def _draw_paths(plot: Any, case: _Case) -> None:
    """Draw kept members' paths, each up to where it stranded."""
    lines = []
    for path, member in zip(case.paths, case.kept, strict=True):
        every = max(1, math.ceil(len(path) / _MOST_POINTS))
        line = np.vstack([path[::every], case.ends[member]])
        lines.append(line[np.isfinite(line[:, 0])].round(4))
    if not lines:
        return
    status = case.dataset["status"].values[case.kept]
    for flag, name in enumerate(STATUSES):
        these = [line for line, fate in zip(lines, status, strict=True) if fate == flag]
        drawn = plot.multi_line(
            *([line[:, k].tolist() for line in these] for k in (0, 1)),
            line_width=1,
            line_alpha=0.45,
            name="paths",
        )
        _colour(drawn.glyph, line_color=name.replace("_", "-"))
