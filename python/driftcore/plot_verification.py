"""Figures of how past forecasts did: `driftcore.verification` gives what they draw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from driftcore.drawing import (
    GREEN,
    SKY,
    TIMES,
    VERMILION,
    add_legend,
    faint_grid,
    label_axes,
    new_figure,
    require,
    tones,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

_SQUARE = (4.2, 4.2)
_TINY = 6.5  # pt


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
    require(dataset, "forecast", "observed", "low", "high", "count")
    axes = new_figure(_SQUARE).subplots() if ax is None else ax
    forecast, observed, low, high, count = (
        dataset[name].to_numpy() for name in ("forecast", "observed", "low", "high", "count")
    )
    outside = (observed < low) | (observed > high)
    artists: list[Artist] = [
        *axes.plot([0, 1], [0, 1], color=tones().ink, linewidth=0.8, linestyle="--")
    ]
    bars = axes.vlines(forecast, low, high, color=SKY, linewidth=6.0, alpha=0.6)
    bars.set_label(f"{100 * dataset.attrs['level']:g} % if calibrated")
    artists.append(bars)
    for rows, colour, marker, label in (
        (~outside, tones().blue, "o", "within"),
        (outside, VERMILION, "D", "outside"),
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
    label_axes(axes, "forecast probability", "share that happened")
    faint_grid(axes)
    add_legend(axes, loc="upper left", borderaxespad=0.2, handletextpad=0.4)
    inset = axes.inset_axes((0.62, 0.09, 0.35, 0.2))
    artists += inset.bar(dataset["bin"].to_numpy(), count, width=0.08, color=tones().shore)
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
    require(dataset, "density", "low", "high")
    axes = new_figure(TIMES).subplots() if ax is None else ax
    middle, density, low, high = (
        dataset[name].to_numpy() for name in ("bin", "density", "low", "high")
    )
    artists: list[Artist] = [
        *axes.bar(
            middle,
            density,
            width=1 / len(middle),
            color=tones().land,
            edgecolor=tones().shore,
            zorder=1,
        )
    ]
    artists.append(axes.axhline(1.0, color=tones().ink, linewidth=0.8, linestyle="--"))
    bars = axes.vlines(middle, low, high, color=SKY, linewidth=6.0, alpha=0.7, zorder=2)
    bars.set_label(f"{100 * dataset.attrs['level']:g} % if calibrated")
    artists.append(bars)
    axes.set(xlim=(-0.02, 1.02), ylim=(0, 1.3 * max(density.max(), high.max())))
    axes.set_xticks(np.arange(6) / 5)
    label_axes(axes, "rank among the members", "density")
    add_legend(axes, loc="upper left", borderaxespad=0.2)
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
    axes = new_figure(TIMES).subplots() if ax is None else ax
    artists: list[Artist] = [axes.axhline(1.0, color=tones().ink, linewidth=0.8)]
    looks = zip((tones().blue, VERMILION, GREEN), ("-", "--", "-."), strict=True)
    for (label, curve), (colour, style) in zip(curves.items(), looks, strict=False):
        require(curve, "ratio", "low", "high")
        lead = curve["lead"].to_numpy()
        artists.append(
            axes.fill_between(lead, curve["low"], curve["high"], color=colour, alpha=0.2, lw=0)
        )
        artists += axes.plot(lead, curve["ratio"], style, color=colour, linewidth=1.4, label=label)
        axes.set_xlim(0.0, lead[-1])
    axes.set_ylim(bottom=0.0)
    label_axes(axes, x_label, y_label)
    faint_grid(axes)
    add_legend(axes, loc="lower right")
    return artists
