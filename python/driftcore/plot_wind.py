"""Figures of the wind: roses, and a record beside what is simulated from it.

As in `driftcore.plot`, whose part this is. For compass directions the first component points east
and the second north.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from driftcore.dataset import is_geographic
from driftcore.drawing import (
    FAILED,
    LABEL,
    SMALL,
    TITLE,
    VERMILION,
    WIDTH,
    add_legend,
    components,
    counted,
    faint_grid,
    finite,
    json_attribute,
    label_axes,
    member_dim,
    new_figure,
    note,
    paper,
    plot_extra,
    require,
    set_title,
    share_stranded,
    tones,
    wind_words,
    wrapped,
)
from driftcore.errors import ScenarioError
from driftcore.record import WindRecord
from driftcore.results import Forecast

if TYPE_CHECKING:
    from collections.abc import Sequence

    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from driftcore.wind import LocalGridBootstrap

__all__ = ["roses", "stranding_rose", "wind_law", "wind_rose"]

Floats = NDArray[np.float64]

_SECTORS = 16
_SPEED_CLASSES = (0.0, 3.0, 6.0, 9.0)  # m/s, four as in the paper; summer winds fill them all
ROSES, _ROSE = (WIDTH, 4.9), (4.2, 4.9)  # in
_LAW = (WIDTH, 5.6)
# Simulated records, and the share of them within the bands.
_RECORDS, _WITHIN = 20, 0.9
_LAG_DAYS = 10


def wind_rose(
    dataset: Forecast | xr.Dataset | WindRecord,
    ax: Axes | None = None,
    speed_classes: Sequence[float] = _SPEED_CLASSES,
) -> list[Artist]:
    """Draw how often the wind blows from where, and how strongly.

    Parameters
    ----------
    dataset : Forecast, xarray.Dataset or WindRecord
        Forecast with ``wind_velocity`` of its kept members (m/s, the velocity the air moves
        toward), or a record: on the real sea a forecast keeps no wind, but
        ``driftcore.LocalGridBootstrap.record`` has it.
    ax : windrose.WindroseAxes, optional
        Where to draw (``projection="windrose"``); left out, a new figure.
    speed_classes : sequence of float
        Lower bounds of the speed classes (m/s), increasing from 0.

    Returns
    -------
    list of matplotlib.artist.Artist
        Bars, sector by sector from north clockwise, in each from the slowest class to the
        fastest; radii in percent of all wind values. A note instead where no wind was kept.

    Raises
    ------
    ScenarioError
        `ax` is not a wind rose, or `speed_classes` do not increase from 0.

    Notes
    -----
    The paper's Figure 4, left. A calm (speed 0) has no direction: it counts in the total and is
    named in the title.
    """
    axes = _rose_axes(ax)
    if isinstance(dataset, WindRecord):
        words = f"{len(dataset):,} values every {dataset.step_h:g} h"
        label = f"{dataset.label} (synthetic)" if dataset.synthetic else dataset.label
        artists, title = _draw_winds(axes, dataset.velocity, words, speed_classes)
        set_title(axes, title, f"Wind: {label}", width=50)
        return artists
    dataset = dataset.dataset if isinstance(dataset, Forecast) else dataset
    artists, title = _draw_wind_rose(axes, dataset, speed_classes)
    set_title(axes, title, wind_words(dataset), width=50)
    return artists


def stranding_rose(dataset: Forecast | xr.Dataset, ax: Axes | None = None) -> list[Artist]:
    """Draw where members strand: their share by the direction of the stranding point.

    Parameters
    ----------
    dataset : xarray.Dataset
        Forecast.
    ax : windrose.WindroseAxes, optional
        Where to draw (``projection="windrose"``); left out, a new figure.

    Returns
    -------
    list of matplotlib.artist.Artist
        One bar per sector, from north clockwise; radii in percent of *all* members that could be
        followed, so that the bars add up to the stranded share. A note where none strands.

    Raises
    ------
    ScenarioError
        `ax` is not a wind rose, or the dataset is not a forecast or names no release.

    Notes
    -----
    The paper's Figure 4, right. Directions are seen from the centre of a circular coast, from the
    release otherwise.
    """
    axes = _rose_axes(ax)
    dataset = dataset.dataset if isinstance(dataset, Forecast) else dataset
    artists, title = _draw_stranding_rose(axes, dataset)
    set_title(axes, title, wind_words(dataset), width=50)
    return artists


def roses(dataset: xr.Dataset, fig: Figure | None = None) -> list[Artist]:
    """Draw `wind_rose` and `stranding_rose` side by side, the paper's Figure 4.

    Parameters
    ----------
    dataset : xarray.Dataset
        Forecast.
    fig : matplotlib.figure.Figure, optional
        Empty figure to draw on; left out, a new one 7 in wide.

    Returns
    -------
    list of matplotlib.artist.Artist
        Those of `wind_rose`, then those of `stranding_rose`.

    Raises
    ------
    ScenarioError
        As `stranding_rose`.
    """
    figure = new_figure(ROSES) if fig is None else fig
    left, right = figure.subplots(1, 2, subplot_kw=_rose_projection())
    wind, wind_title = _draw_wind_rose(left, dataset, _SPEED_CLASSES)
    strandings, stranding_title = _draw_stranding_rose(right, dataset)
    set_title(left, wind_title)
    set_title(right, stranding_title)
    figure.suptitle("\n".join(wrapped(wind_words(dataset), 95)), fontsize=TITLE)
    return wind + strandings


def wind_law(
    wind: LocalGridBootstrap,
    records: int = _RECORDS,
    seed: int = 1,
    fig: Figure | None = None,
) -> list[Artist]:
    """Draw a wind record beside simulated records of its length, as one of which it should pass.

    Parameters
    ----------
    wind : LocalGridBootstrap
        Fitted to the record.
    records : int
        Number of simulated records.
    seed : int
        Of the simulation.
    fig : matplotlib.figure.Figure, optional
        Empty figure to draw on; left out, a new one 7 in wide.

    Returns
    -------
    list of matplotlib.artist.Artist
        For each panel the band that holds 90 % of the simulated records, their median and the
        record: time above a speed, time by sector that the wind blows from, changes in a step
        [percent]; autocorrelation of u, and of v.

    Raises
    ------
    ScenarioError
        `records` is below 2.

    Notes
    -----
    The bands hold at each abscissa by itself: of many abscissas one in ten may lie outside. What is
    required is measured by `driftcore.law.assess`.
    """
    from driftcore.law import _pieces

    if records < 2:
        raise ScenarioError(f"records: {records} is not accepted; 2 or more")
    record = wind.record
    pieces, _ = _pieces(record)
    seasons = len(np.unique(record.season))
    steps = round(len(record) / seasons)
    simulated = wind.sample(records * seasons, steps, seed).reshape(records, seasons, steps, 2)

    figure = new_figure(_LAW) if fig is None else fig
    (speeds, sectors), (changes, memory) = figure.subplots(2, 2)
    artists: list[Artist] = []

    def beside(axes: Axes, x: Floats, of: Any, hue: str | None = None, of_what: str = "") -> None:
        """Draw a statistic of arrays (seasons, steps, 2), of the record and of simulated ones."""
        colour = hue or tones().blue
        found = np.array([of(one) for one in simulated])
        outside = (1 - _WITHIN) / 2
        low, middle, high = np.quantile(found, [outside, 0.5, 1 - outside], axis=0)
        words = f"{100 * _WITHIN:.0f} % and median of {records} simulated{of_what}"
        artists.append(
            axes.fill_between(
                x, low, high, color=colour, alpha=tones().veil, linewidth=0, label=words
            )
        )
        artists.extend(axes.plot(x, middle, color=colour, linewidth=1.0, linestyle="--"))
        artists.extend(
            axes.plot(
                x, of(pieces), color=hue or VERMILION, linewidth=1.3, label=f"the record{of_what}"
            )
        )

    speed = np.hypot(*record.velocity.T)
    grid = np.linspace(0.0, speed.max(), 60)
    beside(speeds, grid, lambda w: _above(np.hypot(w[..., 0], w[..., 1]), grid))
    # Less than one value of the record is no number of its own.
    speeds.set_yscale("log")
    speeds.set_ylim(100 / len(record), 130)
    label_axes(speeds, "speed [m/s]", "time above it [%]")
    beside(sectors, np.arange(_SECTORS + 1) * 360.0 / _SECTORS, _by_sector)
    sectors.set_xticks(np.arange(0, 361, 90), ["N", "E", "S", "W", "N"])
    sectors.set_ylim(bottom=0.0)
    label_axes(sectors, "direction the wind blows from", f"time, of {_SECTORS} sectors [%]")
    step = np.linspace(0.0, float(np.nanmax(_steps(pieces))), 60)
    beside(changes, step, lambda w: _above(_steps(w), step))
    changes.set_yscale("log")
    changes.set_ylim(100 / len(record), 130)
    label_axes(changes, f"change in {record.step_h:g} h [m/s]", "changes above it [%]")
    most = min(round(24 * _LAG_DAYS / record.step_h), steps - 1)
    lags = np.arange(0, most + 1, max(1, round(6 / record.step_h)))
    for k, hue in enumerate((tones().blue, VERMILION)):
        beside(
            memory,
            lags * record.step_h / 24,
            lambda w, k=k: _memory(w[..., k], lags),
            hue,
            f", {'uv'[k]}",
        )
    memory.axhline(0.0, color=tones().muted, linewidth=0.6)
    label_axes(memory, "lag [days]", "autocorrelation of u and v")
    for axes in (speeds, sectors, changes, memory):
        faint_grid(axes)
    figure.legend(
        *speeds.get_legend_handles_labels(),
        loc="outside lower center",
        ncols=2,
        fontsize=SMALL,
        frameon=False,
    )
    add_legend(memory, loc="upper right")
    fitted = f"h = {wind.h:.3g}" + ("" if wind.b is None else f", b = {wind.b:.3g}")
    words = f"{record.describe()}; mode {wind.mode}, {fitted}"
    figure.suptitle("\n".join(wrapped(words, 95)), fontsize=TITLE)
    return artists


def _above(values: Floats, thresholds: Floats) -> Floats:
    """Percentage of the known values above thresholds."""
    known = np.sort(values[np.isfinite(values)])
    return np.asarray(100 * (1 - np.searchsorted(known, thresholds, side="right") / len(known)))


def _by_sector(wind: Floats) -> Floats:
    """Percentage of the winds that blow from each sector, clockwise from north to north again."""
    bearing = _bearing(-finite(wind.reshape(-1, 2)))
    known = bearing[np.isfinite(bearing)]
    sector = np.round(known / (360 / _SECTORS)).astype(int) % _SECTORS
    share = 100 * np.bincount(sector, minlength=_SECTORS) / len(known)
    return np.append(share, share[0])


def _steps(wind: Floats) -> Floats:
    """Sizes of the changes in a step."""
    change = np.diff(wind, axis=1)
    return np.asarray(np.hypot(change[..., 0], change[..., 1]))


def _memory(values: Floats, lags: NDArray[np.int64]) -> Floats:
    """Autocorrelation of a component (seasons, steps) about its mean, NaN left out."""
    anomaly = values - np.nanmean(values)
    variance = np.nanmean(anomaly**2)
    length = values.shape[1]
    products = [np.nanmean(anomaly[:, : length - lag] * anomaly[:, lag:]) for lag in lags]
    return np.array(products) / float(variance)


def _rose_projection() -> dict[str, Any]:
    """Give the keywords that make a figure's new axes wind roses."""
    with plot_extra():
        from windrose import WindroseAxes  # type: ignore[import-untyped] # ships no type hints
    return {"projection": WindroseAxes.name}


def _rose_axes(ax: Axes | None) -> Axes:
    """Take or make axes for a rose."""
    keywords = _rose_projection()
    if ax is None:
        ax = new_figure(_ROSE).add_subplot(**keywords)
    if ax.name != keywords["projection"]:
        raise ScenarioError(
            f"ax: got projection {ax.name!r}, accepted is {keywords['projection']!r}"
        )
    return ax


def _prepare_rose(axes: Axes) -> None:
    """Draw compass points and a faint grid."""
    axes.set_xticks(np.radians(np.arange(0, 360, 45)), ["E", "NE", "N", "NW", "W", "SW", "S", "SE"])
    axes.tick_params(axis="x", labelsize=LABEL)
    axes.grid(color=tones().muted, linewidth=0.4)
    axes.spines["polar"].set(color=tones().muted, linewidth=0.4)


def _draw_wind_rose(
    axes: Axes, dataset: xr.Dataset, speed_classes: Sequence[float]
) -> tuple[list[Artist], str]:
    """Draw `wind_rose` of a forecast and word its title."""
    wind, words = np.empty((0, 2)), ""
    if "wind_velocity" in dataset:
        wind = finite(components(dataset["wind_velocity"]).reshape(-1, 2))
        members = dataset.sizes[member_dim(dataset["wind_velocity"])]
        words = f"{len(wind):,} values, {counted(members)}"
    return _draw_winds(axes, wind, words, speed_classes)


def _draw_winds(
    axes: Axes, wind: Floats, words: str, speed_classes: Sequence[float]
) -> tuple[list[Artist], str]:
    """Draw winds, shape (n, 2), as a rose, and word its title."""
    classes = np.asarray(speed_classes, dtype=float)
    if classes.ndim != 1 or not classes.size or classes[0] != 0 or not (np.diff(classes) > 0).all():
        raise ScenarioError(
            f"speed_classes: got {speed_classes}, accepted are bounds [m/s] increasing from 0"
        )
    _prepare_rose(axes)
    title = "Where the wind blows from"
    if not len(wind):
        return [note(axes, "no wind kept\nin this forecast")], title

    from matplotlib import colormaps

    speed = np.hypot(*wind.T)
    # What is strong stands out; the other end of the map would not show on the page.
    colours = [tuple(c) for c in colormaps[tones().lines](np.linspace(0.05, 1.0, len(classes)))]
    bars = _draw_bars(axes, _bearing(-wind), speed, classes, colours)
    bounds = [f"{low:g} to {high:g}" for low, high in pairwise(classes)]
    _rose_legend(axes, bars[: len(classes)], [*bounds, f"≥ {classes[-1]:g}"], "wind speed [m/s]")
    calm = 100 * np.mean(speed == 0)
    return bars, f"{title}\n{words}" + (f", calm {calm:.1f} %" if calm else "")


def _draw_stranding_rose(axes: Axes, dataset: xr.Dataset) -> tuple[list[Artist], str]:
    """Draw `stranding_rose` and word its title."""
    if is_geographic(dataset):
        return _draw_stranded(axes, dataset, _sea_bearing(dataset), "the release")
    require(dataset, "status", "stranding_position")
    coast = json_attribute(dataset, "coast")
    if coast is not None and coast.get("kind") == "circle":
        origin, place = coast["center"], "the circle's centre"
    else:
        origin, place = json_attribute(dataset, "release"), "the release"
    if origin is None:
        raise ScenarioError("release: absent from the attributes, accepted is JSON such as [1, 1]")

    followed = dataset["stranding_position"][dataset["status"].to_numpy() != FAILED]
    return _draw_stranded(axes, dataset, _bearing(components(followed) - np.asarray(origin)), place)


def _sea_bearing(dataset: xr.Dataset) -> Floats:
    """Give the directions of the stranding points from their releases."""
    from driftcore.geographic_forecast import GeographicForecast

    forecast = GeographicForecast(dataset)
    bearing = np.full(forecast.followed, np.nan)
    found = _bearing(forecast._places())
    bearing[: len(found)] = found
    return bearing


def _draw_stranded(
    axes: Axes, dataset: xr.Dataset, bearing: Floats, place: str
) -> tuple[list[Artist], str]:
    """Draw how many of the members that could be followed have which bearing."""
    _prepare_rose(axes)
    title = f"Stranding points seen from {place}\n{share_stranded(dataset)}"
    # Members that do not strand have no bearing (NaN): windrose counts them in the total alone.
    if np.isnan(bearing).all():
        return [note(axes, "no stranding points")], title
    bars = _draw_bars(axes, bearing, np.zeros(len(bearing)), np.zeros(1), [tones().blue])
    _rose_legend(axes, bars[:1], ["stranded"], "share of all members")
    return bars, title


def _draw_bars(
    axes: Any, bearing: Floats, value: Floats, classes: Floats, colours: Sequence[Any]
) -> list[Artist]:
    """Draw the percentage of values by `bearing` (degrees from north, clockwise) and class."""
    from matplotlib.ticker import MaxNLocator

    before = len(axes.patches)
    axes.bar(
        bearing,
        value,
        bins=classes,
        nsector=_SECTORS,
        normed=True,
        opening=0.86,
        colors=colours,
        edgecolor=tones().ink,
        linewidth=0.3,
    )
    bars = list(axes.patches[before:])
    lengths = np.reshape([bar.get_height() for bar in bars], (_SECTORS, -1)).sum(axis=1)
    # windrose cuts the longest bar into five rings; round percentages read better. Their labels
    # go between the two neighbouring sectors with the shortest bars.
    rings = MaxNLocator(nbins=4, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, lengths.max())[1:]
    gap = int(np.argmin(np.maximum(lengths, np.roll(lengths, -1)))) + 0.5
    axes.set_rmax(rings[-1])
    axes.spines["polar"].set_visible(False)  # the last ring, which makes room for its label
    axes.set_rgrids(
        rings,
        [f"{ring:g} %" for ring in rings],
        angle=(90.0 - gap * 360.0 / _SECTORS) % 360.0,
        fontsize=SMALL,
        ha="center",
        va="center",
        bbox={"facecolor": paper(), "edgecolor": "none", "pad": 1.0},
    )
    return bars


def _bearing(vectors: Floats) -> Floats:
    """Give directions in degrees from north, clockwise; NaN for a vector of no length."""
    east, north = vectors.T
    bearing = np.degrees(np.arctan2(east, north)) % 360.0
    return np.where(np.hypot(east, north) > 0, bearing, np.nan)


def _rose_legend(axes: Axes, bars: Sequence[Artist], labels: Sequence[str], title: str) -> None:
    add_legend(
        axes,
        handles=bars,
        labels=labels,
        title=title,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.1),
        ncols=len(labels),
        columnspacing=1.0,
        handlelength=1.2,
    )
