"""Maps and curves of a forecast on the real sea.

As in `driftcore.plot`: every function takes a forecast (or its dataset) and, if wished, the axes to
draw on, returns the artists that it drew and leaves matplotlib's global state alone. Maps are drawn
on plain axes, or on cartopy's where those are given: see `driftcore.map_drawing`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from driftcore.drawing import (
    GREEN,
    LABEL,
    ORANGE,
    PURPLE,
    SMALL,
    TIMES,
    VERMILION,
    add_legend,
    count_stranded,
    draw_cumulative,
    draw_fates,
    draw_release,
    faint_grid,
    label_axes,
    member_dim,
    new_figure,
    save_figures,
    set_title,
    share_stranded,
    tones,
    wind_words,
)
from driftcore.errors import ScenarioError
from driftcore.geographic_forecast import GeographicForecast
from driftcore.map_drawing import (
    COLOUR_BAR,
    add_colour_bar,
    add_legend_below,
    add_scale_and_north,
    around,
    draw_land,
    end_of,
    in_degrees,
    map_axes,
    release_of,
    sea_dataset,
    set_run_title,
    start_of,
    surroundings,
)
from driftcore.plot import running_estimate
from driftcore.plot_presence import presence_map
from driftcore.plot_setup import set_up
from driftcore.plot_wind import stranding_rose

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from driftcore.coast import LandCoast

__all__ = [
    "arrival_curve",
    "presence_map",
    "running_estimate",
    "save_all",
    "set_up",
    "spaghetti",
    "stranding_bars",
    "stranding_coast",
    "stranding_rose",
]

Floats = NDArray[np.float64]

_BAR_HEIGHT = 0.32  # in


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

    dataset = sea_dataset(forecast)
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
    lines = [np.column_stack([around(line[:, 0], dataset), line[:, 1]]) for line in lines]
    box = surroundings([*lines, release_of(dataset)[None]])
    if coast.box is not None:
        # The sides along which land was cut are no coast: out of sight.
        ends = zip(box, coast.box, (max, min, max, min), strict=True)
        west, east, south, north = (inner(a, b) for a, b, inner in ends)
        box = west, east, south, north
    axes = map_axes(ax, box, COLOUR_BAR)
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LogNorm

    _, followed = count_stranded(dataset)
    least = 100 / followed
    drawn = LineCollection(
        lines,
        cmap=tones().lines,
        norm=LogNorm(least, max(10 * least, percent.max(initial=0.0))),
        linewidths=3.5,
        capstyle="round",
        zorder=2,
        **in_degrees(axes),
    )
    drawn.set_array(percent[hit])
    artists: list[Artist] = [axes.add_collection(drawn, autolim=False)]
    artists += draw_land(axes, coast)
    artists += draw_release(axes, release_of(dataset), **in_degrees(axes))
    artists += add_scale_and_north(axes)
    length = _mean_length_km(stretches)
    add_colour_bar(axes, drawn, f"probability of stranding [% per stretch of {length:.0f} km]")
    set_run_title(axes, dataset)
    add_legend_below(axes)
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
    dataset = sea_dataset(forecast)
    _stretches(coast)
    table = GeographicForecast(dataset).stranding_by_stretch(coast)
    names = [str(name) for name in table["stretch"].values]
    if ax is None:
        ax = new_figure((TIMES[0], 1.4 + _BAR_HEIGHT * len(names))).subplots()
    percent, low, high = (100 * table[name].values for name in ("probability", "low", "high"))
    rows = np.arange(len(names))
    bars = ax.barh(rows, percent, height=0.62, color=tones().blue)
    errors = ax.errorbar(
        percent,
        rows,
        xerr=[percent - low, high - percent],
        fmt="none",
        ecolor=tones().ink,
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
                fontsize=SMALL,
                color=tones().muted,
            )
        )
    ax.set_yticks(rows, names)
    ax.set_ylim(len(names) - 0.4, -0.6)
    # Room for the words beside the longest bar.
    ax.set_xlim(0.0, max(1.3 * high.max(), 1e-9))
    label_axes(
        ax,
        "probability of stranding [%] and its 95 % interval (Wilson)\n"
        "beside it: days to the stranding, 5 % – 50 % – 95 % quantile",
        "",
    )
    faint_grid(ax)
    ax.grid(visible=False, axis="y")
    set_run_title(ax, dataset)
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
    dataset = sea_dataset(forecast)
    if members < 1:
        raise ScenarioError(f"members: {members} is not accepted; 1 or more")
    dim = member_dim(dataset["longitude"])
    if not dataset.sizes[dim]:
        raise ScenarioError("forecast: no paths were kept; run it with keep above 0")
    kept = dataset[["longitude", "latitude"]].isel({dim: slice(members)})
    paths = np.stack([around(kept["longitude"].values, dataset), kept["latitude"].values], axis=-1)
    fates = dataset.sel(member=kept[dim].values)
    ends = np.column_stack(
        [around(fates["stranding_longitude"].values, dataset), fates["stranding_latitude"].values]
    )
    axes = map_axes(ax, surroundings([paths.reshape(-1, 2), ends, release_of(dataset)[None]]))
    artists = draw_fates(axes, paths, ends, fates["status"].values, **in_degrees(axes))
    artists += draw_land(axes, coast)
    artists += draw_release(axes, release_of(dataset), **in_degrees(axes))
    artists += add_scale_and_north(axes)
    set_run_title(axes, dataset, f", {len(paths):,} drawn")
    for handle in add_legend_below(axes).get_lines():
        handle.set(alpha=1.0, linewidth=1.2)
    return artists


def arrival_curve(
    forecast: GeographicForecast | xr.Dataset,
    ax: Axes | None = None,
    label: str = "share stranded",
    target: str | None = None,
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
    target : str, optional
        Draw the probability of having entered this target instead.

    Returns
    -------
    list of matplotlib.artist.Artist
        Step line and band (percent against UTC), and the axis of days where it is new.

    Raises
    ------
    ScenarioError
        The forecast has no such target.

    Notes
    -----
    The band is Wilson's 95 % interval at each time, not one for the whole curve: what so many
    members leave unsure, not what is unsure about winds, currents and the thing itself.
    """
    dataset = sea_dataset(forecast)
    axes = new_figure(TIMES).subplots() if ax is None else ax
    from matplotlib.dates import AutoDateLocator, DateFormatter, date2num

    earlier = len(axes.lines)
    _, total = count_stranded(dataset)
    times, what, words = dataset["stranding_time"].values, "stranding", share_stranded(dataset)
    if target is not None:
        entered = GeographicForecast(dataset).entry_probability(target)
        words = f"{100 * entered.estimate:.1f} % entered {target}"
        times, what = dataset["entry_time"].sel(target=target).values, f"entering {target}"
    times = np.sort(times[~np.isnat(times)])
    start, end = start_of(dataset), end_of(dataset)
    curves = tones().blue, VERMILION, GREEN, PURPLE, ORANGE
    colour = curves[earlier % len(curves)]
    artists = draw_cumulative(axes, times, total, start, end, colour, label)
    if earlier:
        # It says of this band what the legend says of the first.
        artists[1].set_label("_band")
        set_title(axes, wind_words(dataset))
    else:
        axes.set_ylim(-2.0, 102.0)
        axes.set_xlim(start, end)  # type: ignore[arg-type]  # matplotlib takes numpy times
        locator = AutoDateLocator(minticks=4, maxticks=10)  # type: ignore[no-untyped-call]
        axes.xaxis.set_major_locator(locator)
        axes.xaxis.set_major_formatter(DateFormatter("%d %b"))  # type: ignore[no-untyped-call]
        first = date2num(start)  # type: ignore[no-untyped-call]
        upper = axes.secondary_xaxis("top", functions=(lambda t: t - first, lambda d: d + first))
        upper.set_xlabel("days after the release", fontsize=LABEL)
        upper.tick_params(labelsize=SMALL)
        artists.append(upper)
        label_axes(axes, f"time (UTC), {str(start)[:4]}", f"cumulative probability\nof {what} [%]")
        faint_grid(axes)
        set_title(
            axes,
            f"{dataset.attrs['scenario']}: {words}",
            wind_words(dataset),
        )
    add_legend(axes, loc="upper left")
    return artists


def save_all(
    forecast: GeographicForecast | xr.Dataset,
    folder: str | Path,
    coast: LandCoast | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write a forecast's figures as PNG files.

    Parameters
    ----------
    forecast : GeographicForecast or xarray.Dataset
        With some members kept.
    folder : str or pathlib.Path
        Where to write; made if it is absent.
    coast : LandCoast, optional
        Land to draw; where it is divided into stretches, strandings by stretch are drawn too.
    overwrite : bool
        Replace files that are there.

    Returns
    -------
    list of pathlib.Path
        ``paths.png``, ``arrival.png``, ``estimate.png``, ``stranding_rose.png``; with stretches
        ``stretches.png`` and, where they are lines, ``coast.png``; with maps ``presence_1.png``,
        …; in `folder`.

    Raises
    ------
    OutputError
        As `driftcore.plot.save_all`.
    ScenarioError
        The dataset is not a forecast on the real sea, or no member was kept.
    """
    dataset = sea_dataset(forecast)
    drawn = {
        "paths": spaghetti(dataset, coast),
        "arrival": arrival_curve(dataset),
        "estimate": running_estimate(dataset),
        "stranding_rose": stranding_rose(dataset),
    }
    if coast is not None and coast.stretches:
        drawn["stretches"] = stranding_bars(dataset, coast)
        if all(stretch.geom_type == "LineString" for stretch in coast.stretches.values()):
            drawn["coast"] = stranding_coast(dataset, coast)
    if "presence" in dataset:
        for k, time in enumerate(dataset["map_time"].values, start=1):
            drawn[f"presence_{k}"] = presence_map(dataset, time, coast)
    figures: dict[str, Any] = {name: artists[0].figure for name, artists in drawn.items()}
    return save_figures(figures, Path(folder), overwrite)


def _stretches(coast: LandCoast) -> list[Any]:
    if not coast.stretches:
        raise ScenarioError(
            "coast: it has no stretches; accepted is one of with_stretches(...) or divide(...)"
        )
    return list(coast.stretches.values())


def _mean_length_km(lines: list[Any]) -> float:
    from driftcore.coast import geodesic

    return float(np.mean([geodesic().geometry_length(line) for line in lines])) / 1e3
