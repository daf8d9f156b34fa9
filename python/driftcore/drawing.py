"""What all figures share: hues, sizes and words, and what is drawn in the same way everywhere.

Nothing here is shown, no default of matplotlib is changed, and a figure made here belongs to no
window, so that all of it works without a display. Hues follow the style in force when a figure is
drawn: on a dark one what is dark on paper becomes light.
"""

from __future__ import annotations

import json
import textwrap
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftcore.dataset import wind_label
from driftcore.errors import DriftCoreError, OutputError, ScenarioError
from driftcore.files import check_writable, replacing
from driftcore.statistics import wilson

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend

Floats = NDArray[np.float64]

# Okabe & Ito (2008): hues that the common kinds of colour blindness keep apart.
ORANGE, VERMILION, GREEN, PURPLE, SKY = "#E69F00", "#D55E00", "#009E73", "#CC79A7", "#56B4E9"
STRANDED, FAILED = 1, 3

WIDTH = 7.0  # in, two columns of a journal
PLANE, TIMES = (WIDTH, 4.9), (WIDTH, 3.8)
TITLE, LABEL, SMALL = 9.5, 9.0, 8.0  # pt
DPI = 200
TIME_LABEL = "time [scenario units]"


class Tones(NamedTuple):
    """Hues that depend on whether the page is light or dark."""

    ink: str
    """What is written and drawn."""
    muted: str
    """What is written in passing."""
    grid: str
    land: str
    shore: str
    blue: str
    """The first hue of data."""
    cells: str
    """Colour map of areas: nothing fades into the page. Read with any kind of colour blindness."""
    lines: str
    """Colour map of lines and bars, which stand out wherever they lie."""
    veil: float
    """Opacity of bands."""


_LIGHT = Tones(
    "#222222", "0.35", "0.9", "#E9E4D9", "#6B6252", "#0072B2", "YlGnBu", "viridis_r", 0.25
)
_DARK = Tones("#EEEEEE", "0.7", "0.25", "#3B372F", "#A39A86", SKY, "YlGnBu_r", "viridis", 0.4)


def tones() -> Tones:
    """Give the hues that suit the style in force: dark where its text is light."""
    from matplotlib import colors, rcParams

    brightness = np.dot(colors.to_rgb(rcParams["text.color"]), (0.299, 0.587, 0.114))
    return _DARK if brightness > 0.5 else _LIGHT


def paper() -> Any:
    """Give the hue of empty axes in the style in force."""
    from matplotlib import rcParams

    return rcParams["axes.facecolor"]


def fates() -> dict[int, tuple[str, str]]:
    """Give by flag of the variable `status` its legend entry and its hue."""
    return {
        0: ("afloat at the end", ORANGE),
        STRANDED: ("stranded", tones().blue),
        2: ("left the domain", GREEN),
        FAILED: ("failed", PURPLE),
    }


def check_picture(path: Path, overwrite: bool) -> None:
    """Refuse, before any long work, a picture that could not be written.

    Raises
    ------
    OutputError
        As `driftcore.files.check_writable`, or the name does not end in .png.
    """
    if path.suffix != ".png":
        raise OutputError(f"{path}: is not accepted; a picture's name ends in .png")
    check_writable(path, overwrite)


def save_figures(figures: dict[str, Figure], folder: Path, overwrite: bool) -> list[Path]:
    """Write figures as PNG files, after all of them are rendered: a failure leaves the folder."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made a folder: {error.strerror}") from None
    paths = [folder / f"{name}.png" for name in figures]
    for path in paths:
        check_writable(path, overwrite)
    images = [BytesIO() for _ in figures]
    for figure, image in zip(figures.values(), images, strict=True):
        figure.savefig(image, dpi=DPI, format="png")
    for path, image in zip(paths, images, strict=True):
        with replacing(path, overwrite) as unfinished:
            unfinished.write_bytes(image.getvalue())
    return paths


@contextmanager
def plot_extra() -> Iterator[None]:
    """Say how to install what a figure needs where an import inside the block fails."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise DriftCoreError(
            f'figures need {error.name}, which is not installed: pip install "driftcore[plot]"'
        ) from error


def new_figure(size: tuple[float, float]) -> Figure:
    """Make an empty figure of `size` (in) outside pyplot: no window, no global list."""
    with plot_extra():
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    figure = Figure(figsize=size, layout="compressed")
    FigureCanvasAgg(figure)
    return figure


def draw_coast(axes: Axes, dataset: xr.Dataset, outline: bool = False) -> list[Artist]:
    """Draw the coast of the attributes, land shaded; or its line alone, over what is there."""
    return draw_shape(axes, json_attribute(dataset, "coast"), outline)


def draw_shape(axes: Axes, coast: dict[str, Any] | None, outline: bool = False) -> list[Artist]:
    """Draw a coast of the paper's plane, as a dictionary."""
    if coast is None:
        return []
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Circle
    from matplotlib.path import Path as Outline

    within, around = tones().land, paper()
    if outline:
        within = around = "none"
    elif coast.get("side") == "inside":
        within, around = around, within
        axes.set_facecolor(around)
    look: dict[str, Any] = {
        "edgecolor": tones().shore,
        "linewidth": 1.2,
        "zorder": 0.7 if outline else 0.5,
        "label": "_coast" if outline else "coast",
    }
    match coast.get("kind"):
        case "circle":
            circle = Circle(coast["center"], coast["radius"], facecolor=within, **look)
            return [axes.add_patch(circle)]
        case "polygons":
            rings = [np.asarray(ring, dtype=float) for ring in coast["rings"]]
            starts = np.array([ring[0] for ring in rings])
            holds = np.array([Outline(ring).contains_points(starts) for ring in rings])
            np.fill_diagonal(holds, val=False)
            # A ring within a ring is a lake in land, or an island in the sea: paint it later.
            depth = holds.sum(axis=0)
            order = np.argsort(depth, kind="stable")
            colours = [around if depth[k] % 2 else within for k in order]
            polygons = PolyCollection([rings[k] for k in order], facecolors=colours, **look)
            return [axes.add_collection(polygons, autolim=False)]
        case kind:
            raise ScenarioError(f"coast: got kind {kind!r}, accepted are 'circle' and 'polygons'")


def draw_fates(
    axes: Axes, paths: Floats, ends: Floats, status: NDArray[Any], **given: Any
) -> list[Artist]:
    """Draw paths (member, time, 2) up to where they stranded (member, 2), a hue for each fate."""
    from matplotlib.collections import LineCollection

    artists: list[Artist] = []
    for flag, (label, colour) in fates().items():
        lines = [
            finite(np.vstack((path, end)))
            for path, end in zip(paths[status == flag], ends[status == flag], strict=True)
        ]
        if any(len(line) > 1 for line in lines):
            # The rarer a fate, the nearer the top, where its few paths are not hidden.
            height = 3.0 - float(np.mean(status == flag))
            drawn = LineCollection(
                lines, colors=colour, linewidths=0.5, alpha=0.4, zorder=height, **given
            )
            drawn.set_label(label)
            artists.append(axes.add_collection(drawn))
    points = finite(ends)
    if len(points):
        artists += axes.plot(
            *points.T,
            linestyle="none",
            marker="*",
            markersize=6.5,
            markerfacecolor=VERMILION,
            markeredgecolor=tones().ink,
            markeredgewidth=0.3,
            zorder=4,
            label="stranding point",
            **given,
        )
    return artists


def draw_cumulative(
    axes: Axes, times: NDArray[Any], total: int, start: Any, end: Any, colour: str, label: str
) -> list[Artist]:
    """Draw the share of `total` whose sorted times have come, in percent, and its interval."""
    # The curve is known up to the end of the run, also before the first and after the last event.
    t = np.concatenate(([start], times, [end]))
    count = np.concatenate(([0.0], np.arange(1.0, len(times) + 1), [float(len(times))]))
    low, high = wilson(count, total)
    line = axes.step(t, 100 * count / total, where="post", color=colour, linewidth=1.4, label=label)
    band = axes.fill_between(
        t,
        100 * low,
        100 * high,
        step="post",
        color=colour,
        alpha=tones().veil,
        linewidth=0,
        label="95 % interval (Wilson)",
    )
    return [*line, band]


def draw_release(axes: Axes, point: Sequence[float] | Floats, **given: Any) -> list[Artist]:
    """Draw where things are set adrift."""
    return [
        *axes.plot(
            *point,
            linestyle="none",
            marker="o",
            markersize=6,
            markerfacecolor=paper(),
            markeredgecolor=tones().ink,
            markeredgewidth=1.2,
            zorder=5,
            label="release",
            **given,
        )
    ]


def require(dataset: xr.Dataset, *names: str) -> None:
    """Check that the variables that a figure draws are there."""
    for name in names:
        if name not in dataset:
            raise ScenarioError(
                f"{name}: not in the dataset, accepted is one that holds {', '.join(names)}"
            )


def json_attribute(dataset: xr.Dataset, name: str) -> Any:
    """Read an attribute of JSON text; ``None`` where it is absent."""
    text = dataset.attrs.get(name)
    if text is None:
        return None
    try:
        return json.loads(text)
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"{name}: got {text!r}, accepted is JSON text ({error})") from error


def member_dim(variable: xr.DataArray) -> str:
    """Name the dimension that counts members: not all are kept in every forecast."""
    return "kept_member" if "kept_member" in variable.dims else "member"


def kept_paths(dataset: xr.Dataset, limit: int) -> tuple[NDArray[np.int64], Floats]:
    """Give the first kept members and their paths, shape ``(members, times, 2)``."""
    if "position" not in dataset:
        members = dataset["status"]["member"][:limit].to_numpy()
        return members, np.empty((len(members), 0, 2))
    dim = member_dim(dataset["position"])
    position = dataset["position"].isel({dim: slice(limit)})
    return position[dim].to_numpy(), components(position.transpose(dim, "time", "component"))


def components(variable: xr.DataArray) -> Floats:
    """Give the values as floats, with the components on the last axis."""
    return variable.transpose(..., "component").to_numpy().astype(float)


def finite(points: Floats) -> Floats:
    """Keep the points, shape ``(n, 2)``, both of whose components are known."""
    return points[np.isfinite(points).all(axis=1)]


def count_stranded(dataset: xr.Dataset) -> tuple[int, int]:
    """Count the members stranded and those that could be followed: all but the failed ones."""
    status = dataset["status"].to_numpy()
    followed = int(np.count_nonzero(status != FAILED))
    if not followed:
        raise ScenarioError(
            f"status: none of {counted(status.size)} could be followed, accepted are 1 or more"
        )
    return int(np.count_nonzero(status == STRANDED)), followed


def share_stranded(dataset: xr.Dataset) -> str:
    """Say how many members stranded."""
    stranded, followed = count_stranded(dataset)
    share = f"{stranded:,} of {counted(followed)} stranded ({100 * stranded / followed:.1f} %)"
    failed = dataset.sizes["member"] - followed
    return share + (f", {failed:,} failed" if failed else "")


def counted(members: int) -> str:
    """Say how many members, in one or more."""
    return f"{members:,} member" + ("s" if members != 1 else "")


def wind_words(dataset: xr.Dataset) -> str:
    """Say which wind the dataset was computed with."""
    label = wind_label(dataset)
    return f"Wind: {label}" if label else ""


def units_of(variable: xr.DataArray) -> str:
    """Name the unit of a variable."""
    units = str(variable.attrs.get("units", "1"))
    return "scenario units" if units == "1" else units


def label_plane(axes: Axes, variable: xr.DataArray) -> None:
    """Label axes that show positions, to the same scale in both directions."""
    points = {"x": "x, eastward", "y": "y, northward"}
    across, up = (points.get(str(c), str(c)) for c in variable["component"].to_numpy())
    units = units_of(variable)
    label_axes(axes, f"{across} [{units}]", f"{up} [{units}]")
    axes.set_aspect("equal", adjustable="datalim")


def label_axes(axes: Axes, across: str, up: str) -> None:
    """Label both axes."""
    axes.set_xlabel(across, fontsize=LABEL)
    axes.set_ylabel(up, fontsize=LABEL)
    axes.tick_params(labelsize=SMALL)


def faint_grid(axes: Axes) -> None:
    """Draw a grid behind the data."""
    axes.grid(color=tones().grid, linewidth=0.6)
    axes.set_axisbelow(True)


def days_per_unit(dataset: xr.Dataset) -> float | None:
    """Give the days in a unit of scenario time, where the attributes tell."""
    if not {"tide_period_h", "epsilon"} <= set(dataset.attrs):
        return None
    return float(dataset.attrs["tide_period_h"]) / float(dataset.attrs["epsilon"]) / 24


def days_axis(axes: Axes, dataset: xr.Dataset) -> list[Artist]:
    """Add an upper axis in days where the attributes say how long a unit of time is."""
    days = days_per_unit(dataset)
    if days is None:
        return []
    upper = axes.secondary_xaxis(
        "top", functions=(lambda t: np.multiply(t, days), lambda d: np.divide(d, days))
    )
    upper.set_xlabel("time [days]", fontsize=LABEL)
    upper.tick_params(labelsize=SMALL)
    return [upper]


def set_title(axes: Axes, title: str, wind: str = "", width: int = 70) -> None:
    """Set a title with words about the wind below it."""
    axes.set_title("\n".join((title, *wrapped(wind, width))), fontsize=TITLE)


def wrapped(words: str, width: int) -> list[str]:
    """Break into as few lines of `width` characters as hold the words, of about one length."""
    count = len(textwrap.wrap(words, width))
    attempts = (textwrap.wrap(words, narrower) for narrower in range(1, width + 1))
    return next(lines for lines in attempts if len(lines) == count)


def add_legend(axes: Axes, **keywords: Any) -> Legend:
    """Add a legend without a frame in the small print's size."""
    from matplotlib.axes import Axes

    # The base class's method: windrose replaces it by one that takes neither handles nor labels.
    return Axes.legend(axes, fontsize=SMALL, title_fontsize=SMALL, frameon=False, **keywords)


def note(axes: Axes, words: str) -> Artist:
    """Say in the middle of empty axes why they are empty."""
    axes.set_yticks([])
    return axes.text(
        0.5,
        0.5,
        words,
        transform=axes.transAxes,
        ha="center",
        va="center",
        fontsize=LABEL,
        bbox={"facecolor": paper(), "edgecolor": "none", "pad": 4.0},
    )
