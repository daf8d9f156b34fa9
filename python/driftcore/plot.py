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

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from driftcore.drawing import (
    FAILED,
    GREEN,
    ORANGE,
    PLANE,
    PURPLE,
    SKY,
    SMALL,
    STRANDED,
    TIME_LABEL,
    TIMES,
    TITLE,
    VERMILION,
    WIDTH,
    add_legend,
    components,
    count_stranded,
    days_axis,
    draw_coast,
    draw_cumulative,
    draw_fates,
    draw_release,
    faint_grid,
    json_attribute,
    kept_paths,
    label_axes,
    label_plane,
    new_figure,
    require,
    save_figures,
    set_title,
    share_stranded,
    tones,
    units_of,
    wind_words,
)
from driftcore.errors import ScenarioError
from driftcore.plot_presence import presence_map
from driftcore.plot_setup import set_up
from driftcore.plot_verification import pit_histogram, reliability_diagram, score_ratios
from driftcore.plot_wind import ROSES, roses, stranding_rose, wind_law, wind_rose
from driftcore.results import Forecast
from driftcore.statistics import wilson

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

__all__ = [
    "convergence",
    "likelihood",
    "pit_histogram",
    "plane",
    "presence_map",
    "reliability_diagram",
    "roses",
    "running_estimate",
    "save_all",
    "save_member",
    "score_ratios",
    "set_up",
    "stranding_rose",
    "stranding_times",
    "time_series",
    "trajectories",
    "velocity_series",
    "wind_law",
    "wind_rose",
]

Floats = NDArray[np.float64]

_SERIES = (WIDTH, 6.0)


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
    require(dataset, "status", "stranding_position")
    if limit < 1:
        raise ScenarioError(f"limit: got {limit} members to draw, accepted are 1 or more")
    axes = new_figure(PLANE).subplots() if ax is None else ax
    members, paths = kept_paths(dataset, limit)
    status = dataset["status"].sel(member=members).to_numpy()
    ends = components(dataset["stranding_position"].sel(member=members))

    artists = draw_coast(axes, dataset)
    artists += draw_fates(axes, paths, ends, status)
    release = json_attribute(dataset, "release")
    if release is not None:
        artists += draw_release(axes, release)

    label_plane(axes, dataset["stranding_position"])
    set_title(axes, f"{share_stranded(dataset)}, {len(members):,} drawn", wind_words(dataset))
    if artists:
        legend = add_legend(axes, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
        for handle in legend.get_lines():
            handle.set(alpha=1.0, linewidth=1.2)
    return artists


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
    require(dataset, "status", "stranding_time")
    axes = new_figure(TIMES).subplots() if ax is None else ax
    _, total = count_stranded(dataset)
    times = dataset["stranding_time"].to_numpy()
    times = np.sort(times[np.isfinite(times)])
    end = float(dataset.attrs.get("duration", times[-1] if len(times) else 1.0))
    artists = draw_cumulative(axes, times, total, 0.0, end, tones().blue, "share stranded")
    axes.set_xlim(0.0, end)
    axes.set_ylim(-2.0, 102.0)
    label_axes(axes, TIME_LABEL, "cumulative probability\nof stranding [%]")
    faint_grid(axes)
    set_title(axes, share_stranded(dataset), wind_words(dataset))
    # The curve rises: past half at half-time it leaves the lower right free, else the upper left.
    early = np.searchsorted(times, end / 2, side="right") > total / 2
    add_legend(axes, loc="lower right" if early else "upper left")
    return [*artists, *days_axis(axes, dataset)]


def running_estimate(
    forecast: Forecast | xr.Dataset,
    ax: Axes | None = None,
    checkpoints: Sequence[int] | None = None,
) -> list[Artist]:
    """Draw how the probability of stranding settles as members are added, with its interval.

    Parameters
    ----------
    forecast : Forecast or xarray.Dataset
        Any, of the paper's case or on the real sea.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure 7 in wide.
    checkpoints : sequence of int, optional
        Numbers of members, from 1 on, at which the estimate is marked with its interval; default 1,
        2 and 5 times the powers of ten, and all.

    Returns
    -------
    list of matplotlib.artist.Artist
        Line and band (percent against members), marks and their intervals.

    Raises
    ------
    ScenarioError
        The dataset is not a forecast, or a checkpoint is beyond its members.

    Notes
    -----
    Members in the order of their numbers, failed ones left out. The intervals are Wilson's of 95 %
    at each number of members by itself: to stop as soon as one of them pleases makes it too narrow.
    """
    dataset = forecast.dataset if isinstance(forecast, Forecast) else forecast
    require(dataset, "status")
    _, followed = count_stranded(dataset)
    status = dataset["status"].to_numpy()
    hits = np.cumsum(status[status != FAILED] == STRANDED)
    if checkpoints is None:
        powers = 10 ** np.arange(1, 10)
        marks = np.union1d((powers[:, None] * [1, 2, 5]).ravel(), followed)
        marks = marks[marks <= followed]
    else:
        marks = np.asarray(checkpoints)
        if not len(marks) or marks.min() < 1 or marks.max() > followed:
            raise ScenarioError(
                f"checkpoints: {list(checkpoints)} are not accepted; numbers of members from 1 to "
                f"{followed}"
            )
    # As many points as a logarithmic axis shows.
    first = min(10, followed)
    numbers = np.unique(np.geomspace(first, followed, 600).round().astype(int))
    axes = new_figure(TIMES).subplots() if ax is None else ax
    share, low, high = (_settling(hits, numbers)[k] for k in range(3))
    artists: list[Artist] = [
        *axes.plot(numbers, share, color=tones().blue, linewidth=1.4, label="running estimate"),
        axes.fill_between(
            numbers,
            low,
            high,
            color=tones().blue,
            alpha=tones().veil,
            linewidth=0,
            label="95 % interval (Wilson)",
        ),
    ]
    share, low, high = _settling(hits, marks)
    bars = axes.errorbar(
        marks,
        share,
        yerr=[share - low, high - share],
        fmt="o",
        markersize=3.5,
        color=tones().ink,
        elinewidth=1.0,
        capsize=2.5,
        label="at checkpoints",
    )
    artists += [bars.lines[0], *bars.lines[1], *bars.lines[2]]
    axes.axhline(share[-1], color=tones().muted, linewidth=0.8, linestyle=":", zorder=0.5)
    axes.set_xscale("log")
    axes.set_xlim(first, max(followed * 1.05, first + 1))
    label_axes(axes, "members", "probability of stranding [%]")
    faint_grid(axes)
    words = f"{share_stranded(dataset)}; 95 % interval {low[-1]:.1f} to {high[-1]:.1f} %"
    set_title(axes, words, wind_words(dataset))
    # Where the narrow end of the band leaves room.
    above = 2 * share[-1] > sum(axes.get_ylim())
    add_legend(axes, loc="lower right" if above else "upper right")
    return artists


def _settling(hits: NDArray[Any], members: NDArray[Any]) -> tuple[Floats, Floats, Floats]:
    """Give the share of hits among the first members and its interval, in percent."""
    found = [wilson(hits[number - 1], int(number)) for number in members]
    low, high = np.array(found).T
    return 100 * hits[members - 1] / members, 100 * low, 100 * high


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
    require(full, "position")
    require(averaged, "position", "mean_position")
    axes = new_figure(PLANE).subplots() if ax is None else ax
    solid = components(full["position"])
    curves = [
        (solid, "-", ORANGE, 1.8, "full model"),
        (components(averaged["position"]), ":", tones().ink, 1.2, "reconstruction"),
        (components(averaged["mean_position"]), "--", tones().blue, 1.5, "average path"),
    ]
    artists: list[Artist] = []
    for points, style, colour, width, label in curves:
        artists += axes.plot(*points.T, linestyle=style, color=colour, linewidth=width, label=label)
    artists += draw_release(axes, solid[0])
    label_plane(axes, full["position"])
    set_title(axes, _model_words(averaged), wind_words(full))
    add_legend(axes, loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0)
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
    axes = new_figure(TIMES).subplots() if ax is None else ax
    colours = (tones().ink, VERMILION, ORANGE, PURPLE, GREEN, tones().blue, SKY, tones().shore)
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
    label_axes(axes, x_label, y_label)
    faint_grid(axes)
    add_legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.2), borderaxespad=0.0)
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
    axes = new_figure(TIMES).subplots() if ax is None else ax
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator

    artists: list[Artist] = []
    for (label, curve), colour in zip(
        curves.items(), (tones().blue, VERMILION, GREEN), strict=False
    ):
        x, values = map(np.asarray, curve)
        style: dict[str, Any] = {"color": colour, "linewidth": 1.0}
        artists += axes.semilogx(x, values, marker="o", markersize=3.0, label=label, **style)
        artists += axes.plot(*chosen[label], marker="*", markersize=11.0, **style)
    # A factor of ten or less has room for plain numbers.
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.xaxis.set_minor_locator(NullLocator())
    label_axes(axes, x_label, y_label)
    faint_grid(axes)
    add_legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.2), borderaxespad=0.0)
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
        ``trajectories.png``, ``roses.png``, ``stranding_times.png``, ``estimate.png`` and, with
        maps, ``presence_1.png``, … in `folder`.

    Raises
    ------
    OutputError
        A file is there and `overwrite` is false, or one cannot be written. A file that is not
        written whole does not appear, and one that was there stays.
    ScenarioError
        The dataset is not a forecast.
    """
    paths, rose_pair = new_figure(PLANE), new_figure(ROSES)
    times, estimate = new_figure(TIMES), new_figure(TIMES)
    trajectories(dataset, ax=paths.subplots())
    roses(dataset, fig=rose_pair)
    stranding_times(dataset, ax=times.subplots())
    running_estimate(dataset, ax=estimate.subplots())
    figures = {
        "trajectories": paths,
        "roses": rose_pair,
        "stranding_times": times,
        "estimate": estimate,
    }
    if "presence" in dataset:
        for k, time in enumerate(dataset["map_time"].values, start=1):
            figures[f"presence_{k}"] = figure = new_figure(PLANE)
            presence_map(dataset, time, ax=figure.subplots())
    return save_figures(figures, Path(folder), overwrite)


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
    in_plane, position, velocity = new_figure(PLANE), new_figure(_SERIES), new_figure(_SERIES)
    plane(full, averaged, ax=in_plane.subplots())
    time_series(full, averaged, path, fig=position)
    velocity_series(full, averaged, path, fig=velocity)
    figures = {
        "member_plane": in_plane,
        "member_position": position,
        "member_velocity": velocity,
    }
    return save_figures(figures, Path(folder), overwrite)


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
    figure = new_figure(_SERIES) if fig is None else fig
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    t = full["time"].to_numpy()
    solid, reconstruction = components(full[name]), components(averaged[name])
    mean = components(averaged[f"mean_{name}"])
    component = str(full["component"].to_numpy()[index])

    artists: list[Artist] = [*top.plot(t, wind[:, index], color=tones().ink, linewidth=0.8)]
    artists += middle.plot(t, solid[:, index], color=ORANGE, linewidth=1.2, label="full model")
    artists += middle.plot(
        t, mean[:, index], color=tones().blue, linewidth=1.4, linestyle="--", label="average"
    )
    error = np.linalg.norm(solid - reconstruction, axis=1)
    artists += bottom.plot(
        t, error, color=VERMILION, linewidth=0.9, label="norm of full model minus reconstruction"
    )
    epsilon = averaged.attrs.get("epsilon")
    if epsilon is not None:
        artists.append(
            bottom.axhline(
                float(epsilon) ** 2, color=tones().ink, linewidth=1.2, linestyle=":", label="ε²"
            )
        )
    bottom.set_ylim(bottom=0.0)
    bottom.ticklabel_format(axis="y", style="sci", scilimits=(-2, 3), useMathText=True)
    bottom.yaxis.get_offset_text().set_fontsize(SMALL)

    units = _speed_units(full) if name == "velocity" else units_of(full[name])
    label_axes(top, "", f"{wind_label}\n[{_speed_units(full)}]")
    label_axes(middle, "", f"{name}, {component}\n[{units}]")
    label_axes(bottom, TIME_LABEL, f"{name} error\n[{units}]")
    top.set_xlim(t[0], t[-1])
    for panel in (top, middle, bottom):
        faint_grid(panel)
    for panel in (middle, bottom):
        # Above the panel, where it hides no part of a curve that fills the panel.
        add_legend(panel, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0.0, ncols=2)
    artists += days_axis(top, full)
    figure.align_ylabels()
    words = (_model_words(averaged), wind_words(full))
    figure.suptitle("\n".join(w for w in words if w), fontsize=TITLE)
    return artists


def _common_times(
    full: xr.Dataset, averaged: xr.Dataset, name: str, component: str
) -> tuple[Floats, int]:
    """Check that two trajectories can be compared; give their times and the component's index."""
    require(full, name)
    require(averaged, name, f"mean_{name}")
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


def _model_words(dataset: xr.Dataset) -> str:
    """Say which averaged model a trajectory comes from."""
    words = [f"{dataset.attrs['model']} model"] if "model" in dataset.attrs else []
    words += [f"order {dataset.attrs['order']}"] if "order" in dataset.attrs else []
    words += [f"ε = {dataset.attrs['epsilon']:g}"] if "epsilon" in dataset.attrs else []
    return "Full and averaged trajectory" + (f" ({', '.join(words)})" if words else "")


def _speed_units(dataset: xr.Dataset) -> str:
    """Name the unit of speed: the dimensionless scenario's is its wind unit."""
    units = units_of(dataset["velocity"])
    wind_unit = dataset.attrs.get("wind_unit")
    if units == "scenario units" and wind_unit is not None:
        return f"unit: {wind_unit:g} m/s"
    return units
