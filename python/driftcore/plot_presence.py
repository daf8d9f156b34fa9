"""Maps of where the members are at a time: on the real sea, and in the paper's plane."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftcore.dataset import is_geographic
from driftcore.drawing import (
    PLANE,
    add_legend,
    count_stranded,
    days_per_unit,
    draw_coast,
    draw_release,
    json_attribute,
    label_axes,
    new_figure,
    paper,
    require,
    set_title,
    tones,
    wind_words,
)
from driftcore.earth import KM_PER_DEGREE
from driftcore.errors import ScenarioError
from driftcore.map_drawing import (
    COLOUR_BAR,
    add_colour_bar,
    add_legend_below,
    add_scale_and_north,
    date_words,
    days_after,
    draw_land,
    in_degrees,
    map_axes,
    release_of,
    start_of,
)
from driftcore.results import Forecast

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from driftcore.coast import LandCoast

__all__ = ["presence_map"]

Floats = NDArray[np.float64]

# Shares of the afloat probability within the contours, and their lines.
_CONTOURS = {0.5: "solid", 0.9: "dashed"}


class Cells(NamedTuple):
    """The cells of a forecast's maps."""

    x: Floats
    """Edges of the columns."""
    y: Floats
    """Edges of the rows."""
    percent: Floats
    """What turns a share of the members in a cell into what is drawn, shape (rows, 1)."""
    words: str
    """What is drawn."""


def presence_map(
    forecast: Forecast | xr.Dataset,
    time: Any,
    coast: LandCoast | None = None,
    ax: Axes | None = None,
) -> list[Artist]:
    """Draw how probably the thing is afloat where at a time, and the smallest areas that hold it.

    Parameters
    ----------
    forecast : Forecast or xarray.Dataset
        With maps.
    time : float or time
        One of the times of its maps: days after the earliest release, or UTC; scenario time in the
        paper's case.
    coast : LandCoast, optional
        Land to draw on the real sea; the paper's coast is in the forecast.
    ax : matplotlib.axes.Axes, optional
        Where to draw, plain or cartopy's; left out, a new figure.

    Returns
    -------
    list of matplotlib.artist.Artist
        Cells (percent per 100 km², in the paper's case per cell, on a logarithmic scale that begins
        at one member in the smallest cell; empty cells are blank), contours, land, release; scale
        bar and north arrow of the real sea.

    Raises
    ------
    ScenarioError
        The forecast has no maps, or none of this time.

    Notes
    -----
    The contours bound the cells that hold 50 % and 90 % of all members then afloat: those where
    the counts, smoothed by (1, 2, 1)/4 twice each way, are densest, until the counts themselves
    add up. Where too many are beyond the map a contour is left out.
    """
    dataset = forecast.dataset if isinstance(forecast, Forecast) else forecast
    cells = cells_of(dataset)
    index = _index(dataset, time)
    axes, artists = map_without_cells(dataset, cells, coast, ax)
    drawn = draw_presence(axes, dataset, cells, index, scale_of(dataset, cells, index))
    add_colour_bar(axes, drawn[0], cells.words)
    set_title(axes, words_at(dataset, index), wind_words(dataset), 60)
    return drawn + artists


def cells_of(dataset: xr.Dataset) -> Cells:
    """Give the cells of a forecast's maps."""
    sea = is_geographic(dataset)
    names = ("map_longitude", "map_latitude") if sea else ("x", "y")
    require(dataset, "status", "presence", *(f"{name}_bounds" for name in names))
    x, y = (_edges(dataset[f"{name}_bounds"].values) for name in names)
    if sea:
        # Percent per 100 km².
        percent = 1e4 / _areas_km2(x, y)[:, None]
        return Cells(x, y, percent, "probability of being afloat there [% per 100 km²]")
    size = f"{x[1] - x[0]:.3g} x {y[1] - y[0]:.3g}"
    words = f"probability of being afloat there\n[% per cell of {size} scenario units]"
    return Cells(x, y, np.full((len(y) - 1, 1), 100.0), words)


def scale_of(dataset: xr.Dataset, cells: Cells, index: int | slice = slice(None)) -> Any:
    """Give a logarithmic scale that holds the maps of some times, from one member on."""
    from matplotlib.colors import LogNorm

    _, followed = count_stranded(dataset)
    least = float(cells.percent.min()) / followed
    greatest = float((dataset["presence"].values[index] * cells.percent).max())
    return LogNorm(least, max(greatest, 10 * least))


def map_without_cells(
    dataset: xr.Dataset, cells: Cells, coast: LandCoast | None, ax: Axes | None
) -> tuple[Axes, list[Artist]]:
    """Draw what does not change in time."""
    x, y = cells.x, cells.y
    if is_geographic(dataset):
        axes = map_axes(ax, (x[0], x[-1], y[0], y[-1]), COLOUR_BAR)
        artists = draw_land(axes, coast)
        artists += draw_release(axes, release_of(dataset), **in_degrees(axes))
        artists += add_scale_and_north(axes)
        _name_contours(axes)
        add_legend_below(axes)
        return axes, artists
    if coast is not None:
        raise ScenarioError("coast: is not accepted in the paper's plane, whose forecast holds it")
    axes = new_figure(PLANE).subplots() if ax is None else ax
    artists = draw_coast(axes, dataset) + draw_coast(axes, dataset, outline=True)
    release = json_attribute(dataset, "release")
    if release is not None:
        artists += draw_release(axes, release)
    label_axes(axes, "x, eastward [scenario units]", "y, northward [scenario units]")
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])
    axes.set_aspect("equal")
    _name_contours(axes)
    add_legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=4)
    return axes, artists


def _name_contours(axes: Axes) -> None:
    """Put the contours into the legend."""
    for share, style in _CONTOURS.items():
        look: dict[str, Any] = {"color": tones().ink, "linestyle": style, "linewidth": 1.1}
        axes.plot([], [], label=f"{100 * share:g} % of those afloat", **look)


def draw_presence(
    axes: Axes, dataset: xr.Dataset, cells: Cells, index: int, scale: Any
) -> list[Artist]:
    """Draw cells and contours of the map of one time."""
    from matplotlib.patheffects import withStroke

    presence = dataset["presence"].values[index]
    given = in_degrees(axes)
    artists: list[Artist] = [
        axes.pcolormesh(
            cells.x,
            cells.y,
            np.ma.masked_equal(presence * cells.percent, 0.0),
            cmap=tones().cells,
            norm=scale,
            # Land lies over cells; in the plane the sea is painted, and cells lie over it.
            zorder=0.4 if is_geographic(dataset) else 0.6,
            rasterized=True,
            **given,
        )
    ]
    smooth, levels = _densest(presence, float(dataset["outside"].values[index]))
    # Unlike cells, contours on a fringe of no members close at the edge of the map.
    fringe = [np.concatenate([[e[0]], (e[1:] + e[:-1]) / 2, [e[-1]]]) for e in (cells.x, cells.y)]
    for share, level in levels.items():
        lines = axes.contour(
            *fringe,
            np.pad(smooth, 1),
            levels=[level],
            colors=tones().ink,
            linestyles=_CONTOURS[share],
            linewidths=1.1,
            zorder=3,
            **given,
        )
        lines.set_path_effects([withStroke(linewidth=2.4, foreground=paper())])
        artists.append(lines)
    return artists


def words_at(dataset: xr.Dataset, index: int) -> str:
    """Say what is where at the time of a map."""
    now = dataset[["presence", "outside", "ashore"]].isel(map_time=index)
    instant = dataset["map_time"].values[index]
    name = dataset.attrs.get("scenario", "drift")
    if is_geographic(dataset):
        what = f"{name}, {date_words(instant)}, {days_after(dataset, instant):g} days"
    else:
        what = f"{name}, time {instant:g}"
        days = days_per_unit(dataset)
        what += f", {instant * days:.1f} days" if days else ""
    outside = float(now["outside"])
    afloat = float(now["presence"].sum()) + outside
    beyond = f" ({100 * outside:.1f} % beyond the map)" if outside else ""
    return (
        f"{what} after the release\n"
        f"{100 * afloat:.1f} % afloat{beyond}, {100 * float(now['ashore']):.1f} % ashore"
    )


def _index(dataset: xr.Dataset, time: Any) -> int:
    """Give the index of the map that is meant."""
    times = dataset["map_time"].values
    if is_geographic(dataset):
        try:
            if isinstance(time, int | float | np.number):
                wanted = start_of(dataset) + np.timedelta64(round(float(time) * 86_400e6), "us")
            else:
                wanted = np.datetime64(time, "ns")
        except ValueError:
            wanted = np.datetime64("NaT")
        near = np.flatnonzero(np.abs(times - wanted) < np.timedelta64(1, "s"))
        known = ", ".join(f"{days_after(dataset, t):g} ({date_words(t)})" for t in times)
    else:
        number = time if isinstance(time, int | float | np.number) else np.nan
        near = np.flatnonzero(np.abs(times - number) < 1e-9 * times[-1])
        known = ", ".join(f"{t:g}" for t in times)
    if not len(near):
        raise ScenarioError(f"time: {time!r} is not accepted; the maps are of {known}")
    return int(near[0])


def _edges(bounds: Floats) -> Floats:
    return np.append(bounds[:, 0], bounds[-1, 1])


def _areas_km2(x: Floats, y: Floats) -> Floats:
    """Areas of the cells of a column on the sphere."""
    bands = np.diff(np.sin(np.radians(y)))
    return np.asarray((x[1] - x[0]) * np.degrees(bands) * KM_PER_DEGREE**2)


def _densest(presence: Floats, outside: float) -> tuple[Floats, dict[float, float]]:
    """Give a smoothed map, and above which of its values so much of the presence lies."""
    smooth = presence
    for axis in (0, 1):
        for _ in range(2):
            padded = np.pad(smooth, [(1, 1) if a == axis else (0, 0) for a in (0, 1)])
            parts = [np.take(padded, np.arange(smooth.shape[axis]) + k, axis) for k in range(3)]
            smooth = (parts[0] + 2 * parts[1] + parts[2]) / 4
    order = np.argsort(-smooth, axis=None)
    held = np.cumsum(presence.ravel()[order])
    levels = {}
    for share in _CONTOURS:
        needed = share * (held[-1] + outside)
        if 0 < needed <= held[-1]:
            last = int(np.searchsorted(held, needed * (1 - 1e-12)))
            levels[share] = float(smooth.ravel()[order[last]])
    return smooth, levels
