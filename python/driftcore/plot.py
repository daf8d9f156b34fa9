"""Figures of a forecast, and of a trajectory beside its average.

Every function takes datasets (and, if wished, the axes or the figure to draw on), returns the
artists that it drew and leaves matplotlib's global state alone: nothing is shown, no default is
changed, and a figure made here belongs to no window, so that all of it works without a display.
The figure of ``artists = trajectories(dataset)`` is ``artists[0].figure``.

`trajectories` and `roses` are the paper's Figures 3 and 4; `plane`, `time_series` and
`velocity_series` its Figures 1, 2 and 2-1 (Ailliot, Frénod & Monbet 2006). For compass directions
the first component points east and the second north. `convergence` takes numbers.
"""

from __future__ import annotations

import json
import textwrap
from contextlib import contextmanager
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from driftcore.errors import DriftCoreError, OutputError, ScenarioError
from driftcore.files import check_writable, replacing
from driftcore.statistics import wilson

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.legend import Legend
    from numpy.typing import ArrayLike

__all__ = [
    "convergence",
    "likelihood",
    "pit_histogram",
    "plane",
    "reliability_diagram",
    "roses",
    "save_all",
    "save_member",
    "score_ratios",
    "stranding_rose",
    "stranding_times",
    "time_series",
    "trajectories",
    "velocity_series",
    "wind_rose",
]

Floats = NDArray[np.float64]

# Okabe & Ito (2008): hues that the common kinds of colour blindness keep apart.
_BLUE, _ORANGE, _VERMILION, _GREEN, _PURPLE = (
    "#0072B2",
    "#E69F00",
    "#D55E00",
    "#009E73",
    "#CC79A7",
)
_INK, _LAND, _SHORE = "#222222", "#E9E4D9", "#6B6252"
_SKY = "#56B4E9"
# Flag of the variable `status`: legend entry and colour of the path.
_FATES = {
    0: ("afloat at the end", _ORANGE),
    1: ("stranded", _BLUE),
    2: ("left the domain", _GREEN),
    3: ("failed", _PURPLE),
}
_STRANDED, _FAILED = 1, 3

_SECTORS = 16
_SPEED_CLASSES = (0.0, 3.0, 6.0, 9.0)  # m/s, four as in the paper; summer winds fill them all

_WIDTH = 7.0  # in, two columns of a journal
_TRAJECTORIES, _ROSES, _ROSE = (_WIDTH, 4.9), (_WIDTH, 4.9), (4.2, 4.9)
_TIMES, _SERIES = (_WIDTH, 3.8), (_WIDTH, 6.0)
_SQUARE = (4.2, 4.2)
_TITLE, _LABEL, _SMALL, _TINY = 9.5, 9.0, 8.0, 6.5  # pt
_DPI = 200
_TIME_LABEL = "time [scenario units]"


class Wind(Protocol):
    """The wind along a trajectory, in the scenario's units."""

    def at(self, t: Floats) -> Floats:
        """Wind velocity at the times `t` of shape ``(n,)``: shape ``(n, 2)``."""

    def mean(self, t: Floats, window: float) -> Floats:
        """Mean wind velocity over ``[t - window/2, t + window/2]``: shape ``(n, 2)``."""


def trajectories(dataset: xr.Dataset, ax: Axes | None = None, limit: int = 100) -> list[Artist]:
    """Draw kept members' paths, the coast, the release and the stranding points.

    Parameters
    ----------
    dataset : xarray.Dataset
        Forecast. Without kept paths (``position``) the stranding points are drawn alone.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure 7 in wide.
    limit : int
        Draw at most this many members, the first ones.

    Returns
    -------
    list of matplotlib.artist.Artist
        Coast, one ``LineCollection`` per fate, stranding points and release, where there are any.

    Raises
    ------
    ScenarioError
        `limit` is below 1, the dataset is not a forecast, or its coast is of an unknown kind.

    Notes
    -----
    The paper's Figure 3. A stranded path is drawn up to its stranding point, which in general
    lies between two output times. Land is shaded; polygons do not widen the view.
    """
    _need(dataset, "status", "stranding_position")
    if limit < 1:
        raise ScenarioError(f"limit: got {limit} members to draw, accepted are 1 or more")
    axes = _figure(_TRAJECTORIES).subplots() if ax is None else ax
    members, paths = _kept_paths(dataset, limit)
    status = dataset["status"].sel(member=members).to_numpy()
    ends = _values(dataset["stranding_position"].sel(member=members))

    artists = _draw_coast(axes, dataset)
    artists += _draw_fates(axes, paths, ends, status)
    release = _json_attribute(dataset, "release")
    if release is not None:
        artists += _draw_release(axes, release)

    _plane_labels(axes, dataset["stranding_position"])
    _title(axes, f"{_share_stranded(dataset)}, {len(members):,} drawn", _wind_words(dataset))
    if artists:
        legend = _legend(axes, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
        for handle in legend.get_lines():
            handle.set(alpha=1.0, linewidth=1.2)
    return artists


def wind_rose(
    dataset: xr.Dataset,
    ax: Axes | None = None,
    speed_classes: Sequence[float] = _SPEED_CLASSES,
) -> list[Artist]:
    """Draw how often the kept members' wind blows from where, and how strongly.

    Parameters
    ----------
    dataset : xarray.Dataset
        Forecast with ``wind_velocity`` (m/s, the velocity the air moves toward).
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
    artists, title = _draw_wind_rose(axes, dataset, speed_classes)
    _title(axes, title, _wind_words(dataset), width=50)
    return artists


def stranding_rose(dataset: xr.Dataset, ax: Axes | None = None) -> list[Artist]:
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
    artists, title = _draw_stranding_rose(axes, dataset)
    _title(axes, title, _wind_words(dataset), width=50)
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
    figure = _figure(_ROSES) if fig is None else fig
    left, right = figure.subplots(1, 2, subplot_kw=_rose_projection())
    wind, wind_title = _draw_wind_rose(left, dataset, _SPEED_CLASSES)
    strandings, stranding_title = _draw_stranding_rose(right, dataset)
    _title(left, wind_title)
    _title(right, stranding_title)
    figure.suptitle("\n".join(_wrapped(_wind_words(dataset), 95)), fontsize=_TITLE)
    return wind + strandings


def stranding_times(dataset: xr.Dataset, ax: Axes | None = None) -> list[Artist]:
    """Draw the cumulative probability of stranding against time, with its sampling error.

    Parameters
    ----------
    dataset : xarray.Dataset
        Forecast.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure 7 in wide.

    Returns
    -------
    list of matplotlib.artist.Artist
        Step line and band (percent against scenario time), and the axis in days where the
        attributes ``tide_period_h`` and ``epsilon`` say how long a unit lasts.

    Raises
    ------
    ScenarioError
        The dataset is not a forecast.

    Notes
    -----
    The share of the members that could be followed; those that left the domain count as not
    stranded. The band is Wilson's 95 % interval at each time, not one for the whole curve.
    """
    _need(dataset, "status", "stranding_time")
    axes = _figure(_TIMES).subplots() if ax is None else ax
    _, total = _count_stranded(dataset)
    times = dataset["stranding_time"].to_numpy()
    times = np.sort(times[np.isfinite(times)])
    end = float(dataset.attrs.get("duration", times[-1] if len(times) else 1.0))
    artists = _draw_cumulative(axes, times, total, 0.0, end, _BLUE, "share stranded")
    axes.set_xlim(0.0, end)
    axes.set_ylim(-2.0, 102.0)
    _labels(axes, _TIME_LABEL, "cumulative probability\nof stranding [%]")
    _grid(axes)
    _title(axes, _share_stranded(dataset), _wind_words(dataset))
    # The curve rises: past half at half-time it leaves the lower right free, else the upper left.
    early = np.searchsorted(times, end / 2, side="right") > total / 2
    _legend(axes, loc="lower right" if early else "upper left")
    return [*artists, *_days_axis(axes, dataset)]


def time_series(
    full: xr.Dataset,
    averaged: xr.Dataset,
    path: Wind,
    fig: Figure | None = None,
    component: str = "x",
) -> list[Artist]:
    """Draw wind, position and position error against time, the paper's Figure 2.

    Parameters
    ----------
    full, averaged : xarray.Dataset
        Trajectories at the same times, from the full model and from an averaged one (which has
        ``mean_position``).
    path : Wind
        The wind that both were computed with.
    fig : matplotlib.figure.Figure, optional
        Empty figure to draw on; left out, a new one 7 in wide.
    component : str
        The component shown of wind and position; the error is the norm over both.

    Returns
    -------
    list of matplotlib.artist.Artist
        Wind, position (solid), mean position (dashed), error, and its scale ``epsilon ** 2``
        where the attributes give ``epsilon``.

    Raises
    ------
    ScenarioError
        A variable is absent, the times differ, or `component` is unknown.
    """
    t, index = _common_times(full, averaged, "position", component)
    wind = np.asarray(path.at(t))
    return _draw_series(full, averaged, "position", index, wind, f"wind, {component}", fig)


def velocity_series(
    full: xr.Dataset,
    averaged: xr.Dataset,
    path: Wind,
    fig: Figure | None = None,
    component: str = "x",
) -> list[Artist]:
    """Draw smoothed wind, velocity and velocity error against time, the paper's Figure 2-1.

    Parameters
    ----------
    full, averaged : xarray.Dataset
        Trajectories at the same times, from the full model and from an averaged one (which has
        ``mean_velocity``). The wind is smoothed over the attribute ``window`` of `averaged`,
        half a tide (``epsilon / 2``) where there is none.
    path : Wind
        The wind that both were computed with; it covers the run and half a window around it.
    fig : matplotlib.figure.Figure, optional
        Empty figure to draw on; left out, a new one 7 in wide.
    component : str
        The component shown of wind and velocity; the error is the norm over both.

    Returns
    -------
    list of matplotlib.artist.Artist
        Smoothed wind, velocity (solid), mean velocity (dashed), error, and its scale
        ``epsilon ** 2`` where the attributes give ``epsilon``.

    Raises
    ------
    ScenarioError
        A variable is absent, the times differ, `component` is unknown, or neither ``window`` nor
        ``epsilon`` is among the attributes.
    """
    t, index = _common_times(full, averaged, "velocity", component)
    attrs = averaged.attrs
    if "window" not in attrs and "epsilon" not in attrs:
        raise ScenarioError(
            "window: absent from the attributes of the averaged trajectory, and so is epsilon;"
            " accepted is a positive time in either"
        )
    window = float(attrs.get("window", attrs.get("epsilon", 0.0) / 2))
    wind, label = np.asarray(path.mean(t, window)), f"smoothed wind, {component}"
    return _draw_series(full, averaged, "velocity", index, wind, label, fig)


def plane(full: xr.Dataset, averaged: xr.Dataset, ax: Axes | None = None) -> list[Artist]:
    """Draw a trajectory and its average in the plane, the paper's Figure 1.

    Parameters
    ----------
    full, averaged : xarray.Dataset
        Trajectories from the full model and from an averaged one (which has ``mean_position``).
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure 7 in wide.

    Returns
    -------
    list of matplotlib.artist.Artist
        Full trajectory (solid), reconstruction (dotted), average path (dashed), release.

    Raises
    ------
    ScenarioError
        A variable is absent.
    """
    _need(full, "position")
    _need(averaged, "position", "mean_position")
    axes = _figure(_TRAJECTORIES).subplots() if ax is None else ax
    solid = _values(full["position"])
    curves = [
        (solid, "-", _ORANGE, 1.8, "full model"),
        (_values(averaged["position"]), ":", _INK, 1.2, "reconstruction"),
        (_values(averaged["mean_position"]), "--", _BLUE, 1.5, "average path"),
    ]
    artists: list[Artist] = []
    for points, style, colour, width, label in curves:
        artists += axes.plot(*points.T, linestyle=style, color=colour, linewidth=width, label=label)
    artists += _draw_release(axes, solid[0])
    _plane_labels(axes, full["position"])
    _title(axes, _model_words(averaged), _wind_words(full))
    _legend(axes, loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0)
    return artists


def convergence(
    curves: Mapping[str, tuple[ArrayLike, ArrayLike]],
    x_label: str,
    y_label: str,
    ax: Axes | None = None,
) -> list[Artist]:
    """Draw errors against what they shrink with, on logarithmic axes.

    Parameters
    ----------
    curves : mapping of str to pairs of array_like
        By legend entry: abscissas and errors, shape ``(k,)`` each and above 0.
    x_label, y_label : str
        What the axes show.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure 7 in wide.

    Returns
    -------
    list of matplotlib.artist.Artist
        One line per curve: up to eight differ in colour and marker.
    """
    axes = _figure(_TIMES).subplots() if ax is None else ax
    colours = (_INK, _VERMILION, _ORANGE, _PURPLE, _GREEN, _BLUE, _SKY, _SHORE)
    artists: list[Artist] = []
    for k, (label, (x, error)) in enumerate(curves.items()):
        artists += axes.loglog(
            np.asarray(x),
            np.asarray(error),
            color=colours[k % len(colours)],
            marker="osD^vP*X"[k % len(colours)],
            # Hollow: curves that coincide show each other.
            markerfacecolor="none",
            markersize=4.0 + 0.8 * (k % 3),
            linewidth=1.0,
            label=label,
        )
    _labels(axes, x_label, y_label)
    _grid(axes)
    _legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.2), borderaxespad=0.0)
    return artists


def likelihood(
    curves: Mapping[str, tuple[ArrayLike, ArrayLike]],
    chosen: Mapping[str, tuple[float, float]],
    x_label: str,
    y_label: str,
    ax: Axes | None = None,
) -> list[Artist]:
    """Draw log-likelihoods against a parameter on a logarithmic axis, with what was chosen.

    Parameters
    ----------
    curves : mapping of str to pairs of array_like
        By legend entry: parameters above 0 and log-likelihoods [nats], shape ``(k,)`` each.
    chosen : mapping of str to pairs of float
        By the same: the point to mark.
    x_label, y_label : str
        What the axes show.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure 7 in wide.

    Returns
    -------
    list of matplotlib.artist.Artist
        A line and a mark per curve.
    """
    axes = _figure(_TIMES).subplots() if ax is None else ax
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator

    artists: list[Artist] = []
    for (label, curve), colour in zip(curves.items(), (_BLUE, _VERMILION, _GREEN), strict=False):
        x, values = map(np.asarray, curve)
        style: dict[str, Any] = {"color": colour, "linewidth": 1.0}
        artists += axes.semilogx(x, values, marker="o", markersize=3.0, label=label, **style)
        artists += axes.plot(*chosen[label], marker="*", markersize=11.0, **style)
    # A factor of ten or less has room for plain numbers.
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.xaxis.set_minor_locator(NullLocator())
    _labels(axes, x_label, y_label)
    _grid(axes)
    _legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.2), borderaxespad=0.0)
    return artists


def reliability_diagram(dataset: xr.Dataset, ax: Axes | None = None) -> list[Artist]:
    """Draw how often events came against how often they were forecast to, and chance's bars.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `driftcore.verification.reliability` gives it.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new square figure.

    Returns
    -------
    list of matplotlib.artist.Artist
        Diagonal, consistency bars, points within them and points outside, and the bars of the
        inset, which counts the cases.
    """
    _need(dataset, "forecast", "observed", "low", "high", "count")
    axes = _figure(_SQUARE).subplots() if ax is None else ax
    forecast, observed, low, high, count = (
        dataset[name].to_numpy() for name in ("forecast", "observed", "low", "high", "count")
    )
    outside = (observed < low) | (observed > high)
    artists: list[Artist] = [*axes.plot([0, 1], [0, 1], color=_INK, linewidth=0.8, linestyle="--")]
    bars = axes.vlines(forecast, low, high, color=_SKY, linewidth=6.0, alpha=0.6)
    bars.set_label(f"{100 * dataset.attrs['level']:g} % if calibrated")
    artists.append(bars)
    for rows, colour, marker, label in (
        (~outside, _BLUE, "o", "within"),
        (outside, _VERMILION, "D", "outside"),
    ):
        if rows.any():
            artists += axes.plot(
                forecast[rows],
                observed[rows],
                linestyle="none",
                marker=marker,
                markersize=4.5,
                color=colour,
                label=label,
            )
    fifths = np.arange(6) / 5
    axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), aspect="equal", xticks=fifths, yticks=fifths)
    _labels(axes, "forecast probability", "share that happened")
    _grid(axes)
    _legend(axes, loc="upper left", borderaxespad=0.2, handletextpad=0.4)
    inset = axes.inset_axes((0.62, 0.09, 0.35, 0.2))
    artists += inset.bar(dataset["bin"].to_numpy(), count, width=0.08, color=_SHORE)
    inset.set_yscale("log")
    inset.set(xlim=(0, 1), xticks=[0, 1], ylim=(max(1.0, count.min() / 3), count.max() * 2))
    inset.tick_params(labelsize=_TINY, length=2, pad=1)
    inset.minorticks_off()
    inset.set_title("cases", fontsize=_TINY, pad=2)
    for side in ("top", "right"):
        inset.spines[side].set_visible(False)
    return artists


def pit_histogram(dataset: xr.Dataset, ax: Axes | None = None) -> list[Artist]:
    """Draw the histogram of the probability integral transform and chance's bars around 1.

    Parameters
    ----------
    dataset : xarray.Dataset
        As `driftcore.verification.pit` gives it.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure 7 in wide.

    Returns
    -------
    list of matplotlib.artist.Artist
        Bars, the line of a calibrated forecast, and the consistency bars.
    """
    _need(dataset, "density", "low", "high")
    axes = _figure(_TIMES).subplots() if ax is None else ax
    middle, density, low, high = (
        dataset[name].to_numpy() for name in ("bin", "density", "low", "high")
    )
    artists: list[Artist] = [
        *axes.bar(middle, density, width=1 / len(middle), color=_LAND, edgecolor=_SHORE, zorder=1)
    ]
    artists.append(axes.axhline(1.0, color=_INK, linewidth=0.8, linestyle="--"))
    bars = axes.vlines(middle, low, high, color=_SKY, linewidth=6.0, alpha=0.7, zorder=2)
    bars.set_label(f"{100 * dataset.attrs['level']:g} % if calibrated")
    artists.append(bars)
    axes.set(xlim=(-0.02, 1.02), ylim=(0, 1.3 * max(density.max(), high.max())))
    axes.set_xticks(np.arange(6) / 5)
    _labels(axes, "rank among the members", "density")
    _legend(axes, loc="upper left", borderaxespad=0.2)
    return artists


def score_ratios(
    curves: Mapping[str, xr.Dataset],
    x_label: str,
    y_label: str,
    ax: Axes | None = None,
) -> list[Artist]:
    """Draw a score as a share of the reference's by lead, with its interval.

    Parameters
    ----------
    curves : mapping of str to xarray.Dataset
        By legend entry, as `driftcore.verification.score_ratio` gives them; coordinate `lead`.
    x_label, y_label : str
        What the axes show.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure 7 in wide.

    Returns
    -------
    list of matplotlib.artist.Artist
        The reference's line, and a band and a line per curve: up to three differ.
    """
    axes = _figure(_TIMES).subplots() if ax is None else ax
    artists: list[Artist] = [axes.axhline(1.0, color=_INK, linewidth=0.8)]
    looks = zip((_BLUE, _VERMILION, _GREEN), ("-", "--", "-."), strict=True)
    for (label, curve), (colour, style) in zip(curves.items(), looks, strict=False):
        _need(curve, "ratio", "low", "high")
        lead = curve["lead"].to_numpy()
        artists.append(
            axes.fill_between(lead, curve["low"], curve["high"], color=colour, alpha=0.2, lw=0)
        )
        artists += axes.plot(lead, curve["ratio"], style, color=colour, linewidth=1.4, label=label)
        axes.set_xlim(0.0, lead[-1])
    axes.set_ylim(bottom=0.0)
    _labels(axes, x_label, y_label)
    _grid(axes)
    _legend(axes, loc="lower right")
    return artists


def save_all(dataset: xr.Dataset, folder: str | Path, overwrite: bool = False) -> list[Path]:
    """Write a forecast's figures as PNG files of 200 dots per inch.

    Parameters
    ----------
    dataset : xarray.Dataset
        Forecast.
    folder : str or pathlib.Path
        Where to write; made if it is absent.
    overwrite : bool
        Replace files that are there.

    Returns
    -------
    list of pathlib.Path
        ``trajectories.png``, ``roses.png`` and ``stranding_times.png`` in `folder`.

    Raises
    ------
    OutputError
        A file is there and `overwrite` is false, or one cannot be written. A file that is not
        written whole does not appear, and one that was there stays.
    ScenarioError
        The dataset is not a forecast.
    """
    paths, rose_pair, times = _figure(_TRAJECTORIES), _figure(_ROSES), _figure(_TIMES)
    trajectories(dataset, ax=paths.subplots())
    roses(dataset, fig=rose_pair)
    stranding_times(dataset, ax=times.subplots())
    figures = {"trajectories": paths, "roses": rose_pair, "stranding_times": times}
    return _save(figures, Path(folder), overwrite)


def save_member(
    full: xr.Dataset,
    averaged: xr.Dataset,
    path: Wind,
    folder: str | Path,
    overwrite: bool = False,
) -> list[Path]:
    """Write the figures of one member, followed by the full and by an averaged model.

    Parameters
    ----------
    full, averaged, path
        As in `time_series`.
    folder, overwrite
        As in `save_all`.

    Returns
    -------
    list of pathlib.Path
        ``member_plane.png``, ``member_position.png`` and ``member_velocity.png`` in `folder`.

    Raises
    ------
    OutputError, ScenarioError
        As in `save_all` and `time_series`.
    """
    in_plane, position, velocity = _figure(_TRAJECTORIES), _figure(_SERIES), _figure(_SERIES)
    plane(full, averaged, ax=in_plane.subplots())
    time_series(full, averaged, path, fig=position)
    velocity_series(full, averaged, path, fig=velocity)
    figures = {
        "member_plane": in_plane,
        "member_position": position,
        "member_velocity": velocity,
    }
    return _save(figures, Path(folder), overwrite)


def _save(figures: dict[str, Figure], folder: Path, overwrite: bool) -> list[Path]:
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
        figure.savefig(image, dpi=_DPI, format="png")
    for path, image in zip(paths, images, strict=True):
        with replacing(path, overwrite) as unfinished:
            unfinished.write_bytes(image.getvalue())
    return paths


@contextmanager
def _plot_extra() -> Iterator[None]:
    """Say how to install what a figure needs where an import inside the block fails."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise DriftCoreError(
            f'figures need {error.name}, which is not installed: pip install "driftcore[plot]"'
        ) from error


def _figure(size: tuple[float, float]) -> Figure:
    """Make an empty figure of `size` (in) outside pyplot: no window, no global list."""
    with _plot_extra():
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    figure = Figure(figsize=size, layout="compressed")
    FigureCanvasAgg(figure)
    return figure


def _rose_projection() -> dict[str, Any]:
    """Give the keywords that make a figure's new axes wind roses."""
    with _plot_extra():
        from windrose import WindroseAxes  # type: ignore[import-untyped] # ships no type hints
    return {"projection": WindroseAxes.name}


def _rose_axes(ax: Axes | None) -> Axes:
    """Take or make axes for a rose."""
    keywords = _rose_projection()
    if ax is None:
        ax = _figure(_ROSE).add_subplot(**keywords)
    if ax.name != keywords["projection"]:
        raise ScenarioError(
            f"ax: got projection {ax.name!r}, accepted is {keywords['projection']!r}"
        )
    return ax


def _prepare_rose(axes: Axes) -> None:
    """Draw compass points and a faint grid."""
    axes.set_xticks(np.radians(np.arange(0, 360, 45)), ["E", "NE", "N", "NW", "W", "SW", "S", "SE"])
    axes.tick_params(axis="x", labelsize=_LABEL)
    axes.grid(color="0.7", linewidth=0.5)
    axes.spines["polar"].set(color="0.7", linewidth=0.5)


def _draw_wind_rose(
    axes: Axes, dataset: xr.Dataset, speed_classes: Sequence[float]
) -> tuple[list[Artist], str]:
    """Draw `wind_rose` and word its title."""
    classes = np.asarray(speed_classes, dtype=float)
    if classes.ndim != 1 or not classes.size or classes[0] != 0 or not (np.diff(classes) > 0).all():
        raise ScenarioError(
            f"speed_classes: got {speed_classes}, accepted are bounds [m/s] increasing from 0"
        )
    _prepare_rose(axes)
    title = "Where the wind blows from"
    wind = np.empty((0, 2))
    if "wind_velocity" in dataset:
        wind = _finite(_values(dataset["wind_velocity"]).reshape(-1, 2))
    if not len(wind):
        return [_note(axes, "no wind kept\nin this forecast")], title

    from matplotlib import colormaps

    speed = np.hypot(*wind.T)
    # Dark is strong; the palest end of the map would not show on white paper.
    colours = [tuple(c) for c in colormaps["viridis_r"](np.linspace(0.05, 1.0, len(classes)))]
    bars = _draw_bars(axes, _bearing(-wind), speed, classes, colours)
    bounds = [f"{low:g} to {high:g}" for low, high in pairwise(classes)]
    _rose_legend(axes, bars[: len(classes)], [*bounds, f"≥ {classes[-1]:g}"], "wind speed [m/s]")

    members = dataset.sizes[_member_dim(dataset["wind_velocity"])]
    calm = 100 * np.mean(speed == 0)
    title += f"\n{len(wind):,} values, {_counted(members)}"
    return bars, title + (f", calm {calm:.1f} %" if calm else "")


def _draw_stranding_rose(axes: Axes, dataset: xr.Dataset) -> tuple[list[Artist], str]:
    """Draw `stranding_rose` and word its title."""
    _need(dataset, "status", "stranding_position")
    coast = _json_attribute(dataset, "coast")
    if coast is not None and coast.get("kind") == "circle":
        origin, place = coast["center"], "the circle's centre"
    else:
        origin, place = _json_attribute(dataset, "release"), "the release"
    if origin is None:
        raise ScenarioError("release: absent from the attributes, accepted is JSON such as [1, 1]")

    _prepare_rose(axes)
    title = f"Stranding points seen from {place}\n{_share_stranded(dataset)}"
    # Members that do not strand have no bearing (NaN): windrose counts them in the total alone.
    followed = dataset["stranding_position"][dataset["status"].to_numpy() != _FAILED]
    bearing = _bearing(_values(followed) - np.asarray(origin))
    if np.isnan(bearing).all():
        return [_note(axes, "no stranding points")], title
    bars = _draw_bars(axes, bearing, np.zeros(len(bearing)), np.zeros(1), [_BLUE])
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
        edgecolor=_INK,
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
        fontsize=_SMALL,
        ha="center",
        va="center",
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.0},
    )
    return bars


def _draw_series(
    full: xr.Dataset,
    averaged: xr.Dataset,
    name: str,
    index: int,
    wind: Floats,
    wind_label: str,
    fig: Figure | None,
) -> list[Artist]:
    """Draw the three panels of `time_series` and `velocity_series` for the variable `name`."""
    figure = _figure(_SERIES) if fig is None else fig
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    t = full["time"].to_numpy()
    solid, reconstruction = _values(full[name]), _values(averaged[name])
    mean = _values(averaged[f"mean_{name}"])
    component = str(full["component"].to_numpy()[index])

    artists: list[Artist] = [*top.plot(t, wind[:, index], color=_INK, linewidth=0.8)]
    artists += middle.plot(t, solid[:, index], color=_ORANGE, linewidth=1.2, label="full model")
    artists += middle.plot(
        t, mean[:, index], color=_BLUE, linewidth=1.4, linestyle="--", label="average"
    )
    error = np.linalg.norm(solid - reconstruction, axis=1)
    artists += bottom.plot(
        t, error, color=_VERMILION, linewidth=0.9, label="norm of full model minus reconstruction"
    )
    epsilon = averaged.attrs.get("epsilon")
    if epsilon is not None:
        artists.append(
            bottom.axhline(
                float(epsilon) ** 2, color=_INK, linewidth=1.2, linestyle=":", label="ε²"
            )
        )
    bottom.set_ylim(bottom=0.0)
    bottom.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3), useMathText=True)
    bottom.yaxis.get_offset_text().set_fontsize(_SMALL)

    units = _speed_units(full) if name == "velocity" else _units(full[name])
    _labels(top, "", f"{wind_label}\n[{_speed_units(full)}]")
    _labels(middle, "", f"{name}, {component}\n[{units}]")
    _labels(bottom, _TIME_LABEL, f"{name} error\n[{units}]")
    top.set_xlim(t[0], t[-1])
    for panel in (top, middle, bottom):
        _grid(panel)
    for panel in (middle, bottom):
        # Above the panel, where it hides no part of a curve that fills the panel.
        _legend(panel, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0.0, ncols=2)
    artists += _days_axis(top, full)
    figure.align_ylabels()
    words = (_model_words(averaged), _wind_words(full))
    figure.suptitle("\n".join(w for w in words if w), fontsize=_TITLE)
    return artists


def _draw_coast(axes: Axes, dataset: xr.Dataset) -> list[Artist]:
    """Draw the coast of the attributes, land shaded."""
    coast = _json_attribute(dataset, "coast")
    if coast is None:
        return []
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Circle
    from matplotlib.path import Path as Outline

    within, around = _LAND, "white"
    if coast.get("side") == "inside":
        within, around = around, within
        axes.set_facecolor(around)
    look: dict[str, Any] = {
        "edgecolor": _SHORE,
        "linewidth": 1.2,
        "zorder": 0.5,
        "label": "coast",
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


def _draw_fates(axes: Axes, paths: Floats, ends: Floats, status: NDArray[Any]) -> list[Artist]:
    """Draw paths (member, time, 2) up to where they stranded (member, 2), a hue for each fate."""
    from matplotlib.collections import LineCollection

    artists: list[Artist] = []
    for flag, (label, colour) in _FATES.items():
        lines = [
            _finite(np.vstack((path, end)))
            for path, end in zip(paths[status == flag], ends[status == flag], strict=True)
        ]
        if any(len(line) > 1 for line in lines):
            # The rarer a fate, the nearer the top, where its few paths are not hidden.
            height = 3.0 - float(np.mean(status == flag))
            drawn = LineCollection(lines, colors=colour, linewidths=0.5, alpha=0.4, zorder=height)
            drawn.set_label(label)
            artists.append(axes.add_collection(drawn))
    points = _finite(ends)
    if len(points):
        artists += axes.plot(
            *points.T,
            linestyle="none",
            marker="*",
            markersize=6.5,
            markerfacecolor=_VERMILION,
            markeredgecolor=_INK,
            markeredgewidth=0.3,
            zorder=4,
            label="stranding point",
        )
    return artists


def _draw_cumulative(
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
        alpha=0.22,
        linewidth=0,
        label="95 % interval (Wilson)",
    )
    return [*line, band]


def _draw_release(axes: Axes, point: Sequence[float] | Floats) -> list[Artist]:
    return [
        *axes.plot(
            *point,
            linestyle="none",
            marker="o",
            markersize=6,
            markerfacecolor="white",
            markeredgecolor=_INK,
            markeredgewidth=1.2,
            zorder=5,
            label="release",
        )
    ]


def _need(dataset: xr.Dataset, *names: str) -> None:
    """Check that the variables that a figure draws are there."""
    for name in names:
        if name not in dataset:
            raise ScenarioError(
                f"{name}: not in the dataset, accepted is one that holds {', '.join(names)}"
            )


def _common_times(
    full: xr.Dataset, averaged: xr.Dataset, name: str, component: str
) -> tuple[Floats, int]:
    """Check that two trajectories can be compared; give their times and the component's index."""
    _need(full, name)
    _need(averaged, name, f"mean_{name}")
    t, other = full["time"].to_numpy(), averaged["time"].to_numpy()
    if t.shape != other.shape or not np.allclose(t, other):
        raise ScenarioError(
            f"time: {len(t)} times of the full model and {len(other)} of the averaged one differ,"
            " accepted are the same times"
        )
    names = [str(c) for c in full["component"].to_numpy()]
    if component not in names:
        raise ScenarioError(f"component: got {component!r}, accepted are {names}")
    return t, names.index(component)


def _json_attribute(dataset: xr.Dataset, name: str) -> Any:
    """Read an attribute of JSON text; ``None`` where it is absent."""
    text = dataset.attrs.get(name)
    if text is None:
        return None
    try:
        return json.loads(text)
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"{name}: got {text!r}, accepted is JSON text ({error})") from error


def _member_dim(variable: xr.DataArray) -> str:
    """Name the dimension that counts members: not all are kept in every forecast."""
    return "kept_member" if "kept_member" in variable.dims else "member"


def _kept_paths(dataset: xr.Dataset, limit: int) -> tuple[NDArray[np.int64], Floats]:
    """Give the first kept members and their paths, shape ``(members, times, 2)``."""
    if "position" not in dataset:
        members = dataset["status"]["member"][:limit].to_numpy()
        return members, np.empty((len(members), 0, 2))
    dim = _member_dim(dataset["position"])
    position = dataset["position"].isel({dim: slice(limit)})
    return position[dim].to_numpy(), _values(position.transpose(dim, "time", "component"))


def _values(variable: xr.DataArray) -> Floats:
    """Give the values as floats, with the components on the last axis."""
    return variable.transpose(..., "component").to_numpy().astype(float)


def _finite(points: Floats) -> Floats:
    """Keep the points, shape ``(n, 2)``, both of whose components are known."""
    return points[np.isfinite(points).all(axis=1)]


def _bearing(vectors: Floats) -> Floats:
    """Give directions in degrees from north, clockwise; NaN for a vector of no length."""
    east, north = vectors.T
    bearing = np.degrees(np.arctan2(east, north)) % 360.0
    return np.where(np.hypot(east, north) > 0, bearing, np.nan)


def _count_stranded(dataset: xr.Dataset) -> tuple[int, int]:
    """Count the members stranded and those that could be followed: all but the failed ones."""
    status = dataset["status"].to_numpy()
    followed = int(np.count_nonzero(status != _FAILED))
    if not followed:
        raise ScenarioError(
            f"status: none of {_counted(status.size)} could be followed, accepted are 1 or more"
        )
    return int(np.count_nonzero(status == _STRANDED)), followed


def _share_stranded(dataset: xr.Dataset) -> str:
    stranded, followed = _count_stranded(dataset)
    share = f"{stranded:,} of {_counted(followed)} stranded ({100 * stranded / followed:.1f} %)"
    failed = dataset.sizes["member"] - followed
    return share + (f", {failed:,} failed" if failed else "")


def _counted(members: int) -> str:
    return f"{members:,} member" + ("s" if members != 1 else "")


def _wind_words(dataset: xr.Dataset) -> str:
    """Say which wind the dataset was computed with, and that it is synthetic where it is."""
    label = str(dataset.attrs.get("wind_label", "")).strip()
    if dataset.attrs.get("wind_synthetic", 0) and "synthetic" not in label.lower():
        label = f"{label} (synthetic)" if label else "synthetic"
    return f"Wind: {label}" if label else ""


def _model_words(dataset: xr.Dataset) -> str:
    """Say which averaged model a trajectory comes from."""
    words = [f"{dataset.attrs['model']} model"] if "model" in dataset.attrs else []
    words += [f"order {dataset.attrs['order']}"] if "order" in dataset.attrs else []
    words += [f"ε = {dataset.attrs['epsilon']:g}"] if "epsilon" in dataset.attrs else []
    return "Full and averaged trajectory" + (f" ({', '.join(words)})" if words else "")


def _units(variable: xr.DataArray) -> str:
    units = str(variable.attrs.get("units", "1"))
    return "scenario units" if units == "1" else units


def _speed_units(dataset: xr.Dataset) -> str:
    """Name the unit of speed: the dimensionless scenario's is its wind unit."""
    units = _units(dataset["velocity"])
    wind_unit = dataset.attrs.get("wind_unit")
    if units == "scenario units" and wind_unit is not None:
        return f"unit: {wind_unit:g} m/s"
    return units


def _plane_labels(axes: Axes, variable: xr.DataArray) -> None:
    """Label axes that show positions, to the same scale in both directions."""
    points = {"x": "x, eastward", "y": "y, northward"}
    across, up = (points.get(str(c), str(c)) for c in variable["component"].to_numpy())
    units = _units(variable)
    _labels(axes, f"{across} [{units}]", f"{up} [{units}]")
    axes.set_aspect("equal", adjustable="datalim")


def _labels(axes: Axes, across: str, up: str) -> None:
    axes.set_xlabel(across, fontsize=_LABEL)
    axes.set_ylabel(up, fontsize=_LABEL)
    axes.tick_params(labelsize=_SMALL)


def _grid(axes: Axes) -> None:
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def _days_axis(axes: Axes, dataset: xr.Dataset) -> list[Artist]:
    """Add an upper axis in days where the attributes say how long a unit of time is."""
    if not {"tide_period_h", "epsilon"} <= set(dataset.attrs):
        return []
    days = float(dataset.attrs["tide_period_h"]) / float(dataset.attrs["epsilon"]) / 24
    upper = axes.secondary_xaxis(
        "top", functions=(lambda t: np.multiply(t, days), lambda d: np.divide(d, days))
    )
    upper.set_xlabel("time [days]", fontsize=_LABEL)
    upper.tick_params(labelsize=_SMALL)
    return [upper]


def _title(axes: Axes, title: str, wind: str = "", width: int = 70) -> None:
    """Set a title with words about the wind below it."""
    axes.set_title("\n".join((title, *_wrapped(wind, width))), fontsize=_TITLE)


def _wrapped(words: str, width: int) -> list[str]:
    """Break into as few lines of `width` characters as hold the words, of about one length."""
    count = len(textwrap.wrap(words, width))
    attempts = (textwrap.wrap(words, narrower) for narrower in range(1, width + 1))
    return next(lines for lines in attempts if len(lines) == count)


def _legend(axes: Axes, **keywords: Any) -> Legend:
    """Add a legend without a frame in the small print's size."""
    from matplotlib.axes import Axes

    # The base class's method: windrose replaces it by one that takes neither handles nor labels.
    return Axes.legend(axes, fontsize=_SMALL, title_fontsize=_SMALL, frameon=False, **keywords)


def _rose_legend(axes: Axes, bars: Sequence[Artist], labels: Sequence[str], title: str) -> None:
    _legend(
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


def _note(axes: Axes, words: str) -> Artist:
    """Say in the middle of empty axes why they are empty."""
    axes.set_yticks([])
    return axes.text(
        0.5,
        0.5,
        words,
        transform=axes.transAxes,
        ha="center",
        va="center",
        fontsize=_LABEL,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 4.0},
    )
