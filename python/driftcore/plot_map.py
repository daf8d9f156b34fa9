"""Maps and curves of a forecast on the real sea.

As in `driftcore.plot`: every function takes a forecast (or its dataset) and, if wished, the axes to
draw on, returns the artists that it drew and leaves matplotlib's global state alone. Maps need no
map library: a degree of longitude is drawn cos(latitude) as long as one of latitude, so that
directions and the scale bar are true in the middle of the map.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from driftcore.errors import ScenarioError
from driftcore.geographic import _EARTH_RADIUS
from driftcore.geographic_forecast import GeographicForecast
from driftcore.plot import (
    _BLUE,
    _GREEN,
    _INK,
    _LABEL,
    _LAND,
    _ORANGE,
    _PURPLE,
    _SHORE,
    _SMALL,
    _TIMES,
    _VERMILION,
    _count_stranded,
    _draw_cumulative,
    _draw_fates,
    _draw_release,
    _figure,
    _grid,
    _labels,
    _legend,
    _member_dim,
    _need,
    _save,
    _share_stranded,
    _title,
    _wind_words,
)

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.legend import Legend

    from driftcore.coast import LandCoast

__all__ = [
    "arrival_curve",
    "presence_map",
    "save_all",
    "spaghetti",
    "stranding_bars",
    "stranding_coast",
]

Floats = NDArray[np.float64]
# West, east, south, north [degrees].
_Box = tuple[float, float, float, float]

_MAP_WIDTH, _MAP_HEIGHT = 5.0, 4.6  # in, at most
_AROUND, _COLOUR_BAR = (0.9, 1.6), 0.8  # in, what title, labels and legend take
_BAR_HEIGHT = 0.32  # in
# Both are read with any kind of colour blindness; the first begins near white, for cells where
# hardly anything is, the second does not, for lines on land.
_CELLS, _LINES = "YlGnBu", "viridis_r"
_KM_PER_DEGREE = math.radians(1) * _EARTH_RADIUS / 1e3
_CURVES = (_BLUE, _VERMILION, _GREEN, _PURPLE, _ORANGE)
# Shares of the afloat probability within the contours, and their lines.
_CONTOURS = {0.5: "solid", 0.9: "dashed"}


def presence_map(
    forecast: GeographicForecast | xr.Dataset,
    time: Any,
    coast: LandCoast | None = None,
    ax: Axes | None = None,
) -> list[Artist]:
    """Draw how probably the thing is afloat where at a time, and the smallest areas that hold it.

    Parameters
    ----------
    forecast : GeographicForecast or xarray.Dataset
        With maps.
    time : float or time
        One of the times of its maps: days after the earliest release, or UTC.
    coast : LandCoast, optional
        Land to draw.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure.

    Returns
    -------
    list of matplotlib.artist.Artist
        Cells (percent per 100 km², on a logarithmic scale that begins at one member in the
        smallest cell; empty cells are blank), contours, land, release, scale bar, north arrow.

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
    dataset = _dataset(forecast)
    _need(dataset, "presence", "map_longitude_bounds", "map_latitude_bounds")
    instant = _map_time(dataset, time)
    now = dataset.sel(map_time=instant)
    x, y = (_edges(dataset[f"map_{axis}_bounds"].values) for axis in ("longitude", "latitude"))
    presence = now["presence"].values
    _, followed = _count_stranded(dataset)
    # Percent per 100 km².
    per_area = 1e4 / _areas_km2(x, y)[:, None]
    density = np.ma.masked_equal(presence * per_area, 0.0)

    axes = _map_axes(ax, (x[0], x[-1], y[0], y[-1]), _COLOUR_BAR)
    from matplotlib.colors import LogNorm

    least = float(per_area.min()) / followed
    greatest = float(density.max()) if density.count() else least
    mesh = axes.pcolormesh(
        x,
        y,
        density,
        cmap=_CELLS,
        norm=LogNorm(least, max(greatest, 10 * least)),
        zorder=0.4,
        rasterized=True,
    )
    artists: list[Artist] = [mesh]
    smooth, levels = _densest(presence, float(now["outside"]))
    for share, level in levels.items():
        look: dict[str, Any] = {"colors": _INK, "linestyles": _CONTOURS[share], "linewidths": 1.1}
        # Unlike cells, contours on a fringe of no members close at the edge of the map.
        around = [np.concatenate([[e[0]], (e[1:] + e[:-1]) / 2, [e[-1]]]) for e in (x, y)]
        artists.append(axes.contour(*around, np.pad(smooth, 1), levels=[level], zorder=3, **look))
        axes.plot(
            [], [], color=_INK, linestyle=_CONTOURS[share], linewidth=1.1, label=_holds(share)
        )
    artists += _draw_land(axes, coast)
    artists += _draw_release(axes, _release(dataset))
    artists += _scale_and_north(axes)
    _colour_bar(axes, mesh, "probability of being afloat there [% per 100 km²]")
    what = f"{dataset.attrs['scenario']}, {_date(instant)}, {_days(dataset, instant):g} days"
    afloat = float(presence.sum() + now["outside"])
    beyond = f" ({100 * float(now['outside']):.1f} % beyond the map)" if now["outside"] else ""
    _title(
        axes,
        f"{what} after the release\n"
        f"{100 * afloat:.1f} % afloat{beyond}, {100 * float(now['ashore']):.1f} % ashore",
        _wind_words(dataset),
        60,
    )
    _legend_below(axes)
    return artists


def stranding_coast(
    forecast: GeographicForecast | xr.Dataset, coast: LandCoast, ax: Axes | None = None
) -> list[Artist]:
    """Draw the coast coloured by the probability of stranding on each stretch.

    Parameters
    ----------
    forecast : GeographicForecast or xarray.Dataset
        Any.
    coast : LandCoast
        Divided into stretches of equal length: ``coast.cut(...).divide(length_km)``.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure.

    Returns
    -------
    list of matplotlib.artist.Artist
        Stretches where any member stranded (percent, on a logarithmic scale that begins at one
        member), from the least to the most probable; land, release, scale bar, north arrow.

    Raises
    ------
    ScenarioError
        The coast has no stretches, or they are areas: see `stranding_bars`.
    """
    import shapely

    dataset = _dataset(forecast)
    stretches = _stretches(coast)
    if any(stretch.geom_type != "LineString" for stretch in stretches):
        raise ScenarioError(
            "coast: its stretches are areas, which have no line to colour; accepted is one that "
            "divide(length_km) made, or draw stranding_bars"
        )
    table = GeographicForecast(dataset).stranding_by_stretch(coast)
    percent = 100 * table["probability"].values[: len(stretches)]
    # The more a stretch has caught the higher it lies, so that none hides one that counts.
    hit = np.argsort(percent, kind="stable")[np.count_nonzero(percent == 0) :]
    lines = [shapely.get_coordinates(stretches[k]) for k in hit]
    box = _surroundings([*lines, _release(dataset)[None]])
    if coast.box is not None:
        # The sides along which land was cut are no coast: out of sight.
        ends = zip(box, coast.box, (max, min, max, min), strict=True)
        west, east, south, north = (inner(a, b) for a, b, inner in ends)
        box = west, east, south, north
    axes = _map_axes(ax, box, _COLOUR_BAR)
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LogNorm

    _, followed = _count_stranded(dataset)
    least = 100 / followed
    drawn = LineCollection(
        lines,
        cmap=_LINES,
        norm=LogNorm(least, max(10 * least, percent.max(initial=0.0))),
        linewidths=3.5,
        capstyle="round",
        zorder=2,
    )
    drawn.set_array(percent[hit])
    artists: list[Artist] = [axes.add_collection(drawn, autolim=False)]
    artists += _draw_land(axes, coast)
    artists += _draw_release(axes, _release(dataset))
    artists += _scale_and_north(axes)
    length = _mean_length_km(stretches)
    _colour_bar(axes, drawn, f"probability of stranding [% per stretch of {length:.0f} km]")
    _run_title(axes, dataset)
    _legend_below(axes)
    return artists


def stranding_bars(
    forecast: GeographicForecast | xr.Dataset, coast: LandCoast, ax: Axes | None = None
) -> list[Artist]:
    """Draw the probability of stranding on each stretch, with intervals and the days it takes.

    Parameters
    ----------
    forecast : GeographicForecast or xarray.Dataset
        Any.
    coast : LandCoast
        With stretches, of names or of equal length.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure.

    Returns
    -------
    list of matplotlib.artist.Artist
        Bars in percent from the first stretch at the top to "elsewhere", their Wilson 95 %
        intervals, and in words the 5 %, 50 % and 95 % quantiles of the days to the stranding.

    Raises
    ------
    ScenarioError
        The coast has no stretches.
    """
    dataset = _dataset(forecast)
    _stretches(coast)
    table = GeographicForecast(dataset).stranding_by_stretch(coast)
    names = [str(name) for name in table["stretch"].values]
    if ax is None:
        ax = _figure((_TIMES[0], 1.4 + _BAR_HEIGHT * len(names))).subplots()
    percent, low, high = (100 * table[name].values for name in ("probability", "low", "high"))
    rows = np.arange(len(names))
    bars = ax.barh(rows, percent, height=0.62, color=_BLUE)
    errors = ax.errorbar(
        percent,
        rows,
        xerr=[percent - low, high - percent],
        fmt="none",
        ecolor=_INK,
        elinewidth=1.0,
        capsize=2.5,
    )
    artists: list[Artist] = [*bars, *errors.lines[2], *errors.lines[1]]
    for row, days in enumerate(table["time_quantile"].values.T):
        words = "none" if np.isnan(days).all() else "{:.0f} – {:.0f} – {:.0f} d".format(*days)
        artists.append(
            ax.annotate(
                words,
                (high[row], row),
                xytext=(5, 0),
                textcoords="offset points",
                va="center",
                fontsize=_SMALL,
                color="0.35",
            )
        )
    ax.set_yticks(rows, names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    # Room for the words beside the longest bar.
    ax.set_xlim(0.0, max(1.3 * high.max(), 1e-9))
    _labels(
        ax,
        "probability of stranding [%] and its 95 % interval (Wilson)\n"
        "beside it: days to the stranding, 5 % – 50 % – 95 % quantile",
        "",
    )
    _grid(ax)
    ax.grid(visible=False, axis="y")
    _run_title(ax, dataset)
    return artists


def spaghetti(
    forecast: GeographicForecast | xr.Dataset,
    coast: LandCoast | None = None,
    members: int = 200,
    ax: Axes | None = None,
) -> list[Artist]:
    """Draw kept members' paths in a hue for each fate, and where they stranded.

    Parameters
    ----------
    forecast : GeographicForecast or xarray.Dataset
        With paths (``keep`` above 0).
    coast : LandCoast, optional
        Land to draw.
    members : int
        At most so many members, the first ones.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure.

    Returns
    -------
    list of matplotlib.artist.Artist
        A ``LineCollection`` for each fate there is, stranding points, land, release, scale bar,
        north arrow. A stranded path ends at its stranding point.

    Raises
    ------
    ScenarioError
        `members` is below 1, or no paths were kept.
    """
    dataset = _dataset(forecast)
    if members < 1:
        raise ScenarioError(f"members: {members} is not accepted; 1 or more")
    dim = _member_dim(dataset["longitude"])
    if not dataset.sizes[dim]:
        raise ScenarioError("forecast: no paths were kept; run it with keep above 0")
    kept = dataset[["longitude", "latitude"]].isel({dim: slice(members)})
    paths = np.stack([kept["longitude"].values, kept["latitude"].values], axis=-1)
    fates = dataset.sel(member=kept[dim].values)
    ends = np.column_stack(
        [fates["stranding_longitude"].values, fates["stranding_latitude"].values]
    )
    axes = _map_axes(ax, _surroundings([paths.reshape(-1, 2), ends, _release(dataset)[None]]))
    artists = _draw_fates(axes, paths, ends, fates["status"].values)
    artists += _draw_land(axes, coast)
    artists += _draw_release(axes, _release(dataset))
    artists += _scale_and_north(axes)
    _run_title(axes, dataset, f", {len(paths):,} drawn")
    for handle in _legend_below(axes).get_lines():
        handle.set(alpha=1.0, linewidth=1.2)
    return artists


def arrival_curve(
    forecast: GeographicForecast | xr.Dataset,
    ax: Axes | None = None,
    label: str = "share stranded",
) -> list[Artist]:
    """Draw the probability of having stranded by a time, with its sampling error.

    Parameters
    ----------
    forecast : GeographicForecast or xarray.Dataset
        Any.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure. On axes that hold a curve already another is added
        in another hue.
    label : str
        What the legend calls the curve.

    Returns
    -------
    list of matplotlib.artist.Artist
        Step line and band (percent against UTC), and the axis of days where it is new.

    Notes
    -----
    The band is Wilson's 95 % interval at each time, not one for the whole curve: what so many
    members leave unsure, not what is unsure about winds, currents and the thing itself.
    """
    dataset = _dataset(forecast)
    axes = _figure(_TIMES).subplots() if ax is None else ax
    from matplotlib.dates import AutoDateLocator, DateFormatter, date2num

    earlier = len(axes.lines)
    _, total = _count_stranded(dataset)
    times = dataset["stranding_time"].values
    times = np.sort(times[~np.isnat(times)])
    start, end = _start(dataset), _end(dataset)
    colour = _CURVES[earlier % len(_CURVES)]
    artists = _draw_cumulative(axes, times, total, start, end, colour, label)
    if earlier:
        # It says of this band what the legend says of the first.
        artists[1].set_label("_band")
        _title(axes, _wind_words(dataset))
    else:
        axes.set_ylim(-2.0, 102.0)
        axes.set_xlim(start, end)  # type: ignore[arg-type]  # matplotlib takes numpy times
        locator = AutoDateLocator(minticks=4, maxticks=10)  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(DateFormatter("%d %b"))  # type: ignore[no-untyped-call]
        first = date2num(start)  # type: ignore[no-untyped-call]
        upper = axes.secondary_xaxis("top", functions=(lambda t: t - first, lambda d: d + first))
        upper.set_xlabel("days after the release", fontsize=_LABEL)
        upper.tick_params(labelsize=_SMALL)
        artists.append(upper)
        _labels(axes, f"time (UTC), {str(start)[:4]}", "cumulative probability\nof stranding [%]")
        _grid(axes)
        _title(
            axes,
            f"{dataset.attrs['scenario']}: {_share_stranded(dataset)}",
            _wind_words(dataset),
        )
    _legend(axes, loc="upper left")
    return artists


def save_all(
    forecast: GeographicForecast | xr.Dataset,
    folder: str | Path,
    coast: LandCoast | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write a forecast's figures as PNG files: paths, arrival, and a map of each map time.

    Parameters
    ----------
    forecast : GeographicForecast or xarray.Dataset
        With some members kept.
    folder : str or pathlib.Path
        Where to write; made if it is absent.
    coast : LandCoast, optional
        Land to draw.
    overwrite : bool
        Replace files that are there.

    Returns
    -------
    list of pathlib.Path
        ``paths.png``, ``arrival.png`` and, with maps, ``presence_1.png``, … in `folder`.

    Raises
    ------
    OutputError
        As `driftcore.plot.save_all`.
    ScenarioError
        The dataset is not a forecast on the real sea, or no member was kept.
    """
    dataset = _dataset(forecast)
    drawn = {"paths": spaghetti(dataset, coast), "arrival": arrival_curve(dataset)}
    if "presence" in dataset:
        for k, time in enumerate(dataset["map_time"].values, start=1):
            drawn[f"presence_{k}"] = presence_map(dataset, time, coast)
    figures: dict[str, Any] = {name: artists[0].figure for name, artists in drawn.items()}
    return _save(figures, Path(folder), overwrite)


def _dataset(forecast: GeographicForecast | xr.Dataset) -> xr.Dataset:
    dataset = forecast.dataset if isinstance(forecast, GeographicForecast) else forecast
    _need(dataset, "status", "stranding_time", "stranding_longitude", "stranding_latitude")
    return dataset


def _start(dataset: xr.Dataset) -> np.datetime64:
    return np.datetime64(dataset.attrs["start"], "ns")


def _end(dataset: xr.Dataset) -> np.datetime64:
    end: np.datetime64 = _start(dataset) + np.timedelta64(
        round(float(dataset.attrs["days"]) * 86_400e6), "us"
    )
    return end


def _days(dataset: xr.Dataset, instant: np.datetime64) -> float:
    return float((instant - _start(dataset)) / np.timedelta64(1, "D"))


def _date(instant: np.datetime64) -> str:
    return str(instant.astype("datetime64[m]")).replace("T", " ") + " UTC"


def _map_time(dataset: xr.Dataset, time: Any) -> np.datetime64:
    """Give the time of the maps that is meant."""
    times = dataset["map_time"].values
    try:
        if isinstance(time, int | float | np.number):
            wanted = _start(dataset) + np.timedelta64(round(float(time) * 86_400e6), "us")
        else:
            wanted = np.datetime64(time, "ns")
    except ValueError:
        wanted = np.datetime64("NaT")
    near = np.flatnonzero(np.abs(times - wanted) < np.timedelta64(1, "s"))
    if not len(near):
        known = ", ".join(f"{_days(dataset, t):g} ({_date(t)})" for t in times)
        raise ScenarioError(f"time: {time!r} is not accepted; the maps are of {known}")
    found: np.datetime64 = times[near[0]]
    return found


def _edges(bounds: Floats) -> Floats:
    return np.append(bounds[:, 0], bounds[-1, 1])


def _areas_km2(x: Floats, y: Floats) -> Floats:
    """Areas of the cells of a column on the sphere."""
    bands = np.diff(np.sin(np.radians(y)))
    return np.asarray(math.radians(x[1] - x[0]) * bands * (_EARTH_RADIUS / 1e3) ** 2)


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


def _holds(share: float) -> str:
    return f"{100 * share:g} % of those afloat"


def _release(dataset: xr.Dataset) -> Floats:
    """Middle of the releases."""
    places = [dataset[f"release_{name}"].values for name in ("longitude", "latitude")]
    return np.array([np.nanmedian(values) for values in places])


def _stretches(coast: LandCoast) -> list[Any]:
    if not coast.stretches:
        raise ScenarioError(
            "coast: it has no stretches; accepted is one of with_stretches(...) or divide(...)"
        )
    return list(coast.stretches.values())


def _mean_length_km(lines: list[Any]) -> float:
    from driftcore.coast import geodesic

    return float(np.mean([geodesic().geometry_length(line) for line in lines])) / 1e3


def _surroundings(groups: list[Floats]) -> _Box:
    """Box around points, with a margin."""
    points = np.concatenate(groups)
    (west, south), (east, north) = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    margin = max(0.06 * max(east - west, north - south), 0.05)
    return west - margin, east + margin, max(south - margin, -90.0), min(north + margin, 90.0)


def _map_axes(axes: Axes | None, box: _Box, beside: float = 0.0) -> Axes:
    """Axes of a map, true to scale in its middle; so much [in] is kept free beside it."""
    west, east, south, north = box
    aspect = 1 / math.cos(math.radians((south + north) / 2))
    if axes is None:
        wide = (east - west) / (north - south) / aspect
        height = min(_MAP_HEIGHT, _MAP_WIDTH / wide)
        # The title needs its width, however narrow the map.
        width = max(height * wide + _AROUND[0] + beside, _MAP_WIDTH)
        axes = _figure((width, height + _AROUND[1])).subplots()
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    axes.set_aspect(aspect)
    axes.xaxis.set_major_formatter(lambda value, _: _degrees(value, "EW"))
    axes.yaxis.set_major_formatter(lambda value, _: _degrees(value, "NS"))
    _labels(axes, "longitude", "latitude")
    return axes


def _run_title(axes: Axes, dataset: xr.Dataset, more: str = "") -> None:
    """Say what was followed from when on, what became of it, and under which wind."""
    attributes = dataset.attrs
    what = f"{attributes['scenario']}, {attributes['days']:g} days from {_date(_start(dataset))}"
    _title(axes, f"{what}\n{_share_stranded(dataset)}{more}", _wind_words(dataset), 60)


def _legend_below(axes: Axes) -> Legend:
    """Add a legend where it hides nothing."""
    return _legend(
        axes,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.1),
        ncols=4,
        columnspacing=1.2,
        handlelength=1.6,
    )


def _degrees(value: float, sides: str) -> str:
    turned = (value + 180) % 360 - 180 if sides == "EW" else value
    side = "" if turned == 0 else f" {sides[int(turned < 0)]}"
    return f"{abs(round(turned, 6)):g}°{side}"


def _draw_land(axes: Axes, coast: LandCoast | None) -> list[Artist]:
    """Draw the land of a view, holes left open."""
    if coast is None:
        return []
    import shapely
    from matplotlib.collections import PathCollection
    from matplotlib.path import Path

    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    polygons = shapely.orient_polygons(coast.polygons)
    bounds = shapely.bounds(polygons).reshape(-1, 4)
    seen = (
        (bounds[:, 0] < east)
        & (bounds[:, 2] > west)
        & (bounds[:, 1] < north)
        & (bounds[:, 3] > south)
    )
    paths = [
        Path.make_compound_path(
            *(Path(shapely.get_coordinates(ring), closed=True) for ring in shapely.get_rings(land))
        )
        for land in polygons[seen]
    ]
    land = PathCollection(paths, facecolors=_LAND, edgecolors=_SHORE, linewidths=0.6, zorder=0.5)
    return [axes.add_collection(land, autolim=False)]


def _scale_and_north(axes: Axes) -> list[Artist]:
    """Draw a bar of a round length at the lower left, and an arrow to the north."""
    from matplotlib.patheffects import withStroke

    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    per_degree = _KM_PER_DEGREE * math.cos(math.radians((south + north) / 2))
    longest = (east - west) * per_degree / 4
    ten = 10.0 ** math.floor(math.log10(longest))
    length = max(ten * step for step in (1, 2, 5) if ten * step <= longest)
    x, y = west + 0.05 * (east - west), south + 0.045 * (north - south)
    over: dict[str, Any] = {"zorder": 6, "color": _INK}
    halo = [withStroke(linewidth=2.5, foreground="white")]
    (bar,) = axes.plot(
        [x, x + length / per_degree], [y, y], linewidth=2.0, solid_capstyle="butt", **over
    )
    words = axes.annotate(
        f"{length:g} km",
        (x + length / per_degree / 2, y),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        fontsize=_SMALL,
        path_effects=halo,
        **over,
    )
    arrow = axes.annotate(
        "N",
        (0.055, 0.965),
        xytext=(0.055, 0.875),
        xycoords="axes fraction",
        ha="center",
        va="center",
        fontsize=_LABEL,
        arrowprops={"arrowstyle": "-|>", "color": _INK, "linewidth": 1.2, "shrinkB": 0},
        **over,
    )
    return [bar, words, arrow]


def _colour_bar(axes: Axes, drawn: Any, words: str) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    bar = axes.figure.colorbar(
        drawn,
        ax=axes,
        shrink=0.85,
        pad=0.02,
        ticks=LogLocator(subs=(1.0, 2.0, 5.0)),
        format=FuncFormatter(lambda value, _: f"{value:g}"),
    )
    bar.ax.yaxis.set_minor_formatter(NullFormatter())
    bar.set_label(words, fontsize=_LABEL)
    bar.ax.tick_params(labelsize=_SMALL)
