"""What a scenario sets up, before anything is followed: release, coast, grids, maps, targets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from driftcore.drawing import (
    GREEN,
    ORANGE,
    PLANE,
    PURPLE,
    SMALL,
    VERMILION,
    add_legend,
    draw_release,
    draw_shape,
    label_axes,
    new_figure,
    set_title,
    tones,
)
from driftcore.scenario import Scenario

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

    from driftcore.geographic import GeographicScenario
    from driftcore.maps import MapGrid

__all__ = ["set_up"]

Floats = NDArray[np.float64]

# Releases drawn to show how surely their places are known.
_PLACES = 300
# Degrees that are shown around a release with nothing else to show.
_MARGIN = 2.0


def set_up(
    scenario: Scenario | GeographicScenario,
    wind: Any = None,
    maps: MapGrid | None = None,
    targets: Mapping[str, Any] | None = None,
    ax: Axes | None = None,
) -> list[Artist]:
    """Draw what a forecast is of: release, coast, extents of grids, box of the maps, targets.

    Parameters
    ----------
    scenario : Scenario or GeographicScenario
        What is to be followed.
    wind, maps, targets
        As `driftcore.forecast` takes them; a wind that has a grid is drawn by its extent.
    ax : matplotlib.axes.Axes, optional
        Where to draw, on the real sea plain or cartopy's; left out, a new figure.

    Returns
    -------
    list of matplotlib.artist.Artist
        Land, boxes, targets, places of release; scale bar and north arrow on the real sea.
    """
    if isinstance(scenario, Scenario):
        return _plane(scenario, maps, targets, ax)
    return _sea(scenario, wind, maps, targets, ax)


def _plane(
    scenario: Scenario, maps: MapGrid | None, targets: Mapping[str, Any] | None, ax: Axes | None
) -> list[Artist]:
    axes = new_figure(PLANE).subplots() if ax is None else ax
    coast = scenario.coast
    shape = None if coast is None else {**coast.model_dump(), "side": scenario.side}
    artists = draw_shape(axes, shape)
    for name, rings in _rings(targets).items():
        artists += _target(axes, name, rings)
    if maps is not None:
        artists += _box(axes, (maps.x[0], maps.x[-1], maps.y[0], maps.y[-1]), "maps", ORANGE, "-.")
    artists += draw_release(axes, scenario.position)
    label_axes(axes, "x, eastward [scenario units]", "y, northward [scenario units]")
    axes.autoscale_view()
    axes.set_aspect("equal", adjustable="datalim")
    set_title(axes, f"{scenario.name}: a run of {scenario.duration_days:.1f} days")
    add_legend(axes, loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    return artists


def _sea(
    scenario: GeographicScenario,
    wind: Any,
    maps: MapGrid | None,
    targets: Mapping[str, Any] | None,
    ax: Axes | None,
) -> list[Artist]:
    from driftcore.coast import near_longitude
    from driftcore.map_drawing import (
        add_legend_below,
        add_scale_and_north,
        date_words,
        draw_land,
        in_degrees,
        map_axes,
        surroundings,
    )

    places = scenario.release.sample(0, _PLACES, 1).position
    middle = float(places[0, 0])
    places = np.column_stack([near_longitude(places[:, 0], middle), places[:, 1]])
    grids = {"tides": scenario.tides, "current": scenario.current, "wind": _gridded(wind)}
    boxes = {
        name: (grid.longitude[0], grid.longitude[-1], grid.latitude[0], grid.latitude[-1])
        for name, grid in grids.items()
        if grid is not None
    }
    if maps is not None:
        boxes["maps"] = maps.x[0], maps.x[-1], maps.y[0], maps.y[-1]
    # Grids of half the world say nothing of where to look.
    shown = [b for b in boxes.values() if b[1] - b[0] < 60] or [
        (*(places[0, 0] + [-_MARGIN, _MARGIN]), *(places[0, 1] + [-_MARGIN, _MARGIN]))
    ]
    rings = _rings(targets)
    corners = [np.array([[w, s], [e, n]], dtype=float) for w, e, s, n in shown]
    around = [*corners, places, *(ring for part in rings.values() for ring in part)]
    axes = map_axes(ax, surroundings(around))
    given = in_degrees(axes)
    artists = draw_land(axes, scenario.coast)
    looks = {
        "tides": (tones().blue, "-"),
        "current": (GREEN, "--"),
        "wind": (PURPLE, ":"),
        "maps": (ORANGE, "-."),
    }
    for name, box in boxes.items():
        artists += _box(axes, box, name, *looks[name], **given)
    for name, part in rings.items():
        artists += _target(axes, name, part, **given)
    if np.ptp(places, axis=0).max() > 0:
        artists += axes.plot(
            *places.T,
            linestyle="none",
            marker=".",
            markersize=2.0,
            color=VERMILION,
            zorder=4,
            label="places of release",
            **given,
        )
    artists += draw_release(axes, np.median(places, axis=0), **given)
    artists += add_scale_and_north(axes)
    start = date_words(scenario.start.astype("datetime64[ns]"))
    words = [f"{scenario.name}, {scenario.days:g} days from {start}"]
    missing = [n for n in ("tides", "current", "coast") if getattr(scenario, n) is None]
    words += [f"without {', '.join(missing)}"] if missing else []
    set_title(axes, "\n".join(words))
    add_legend_below(axes)
    return artists


def _gridded(wind: Any) -> Any:
    """Give what knows the grid of a wind: itself, or the record that it was fitted to."""
    held = getattr(wind, "gridded", wind)
    return held if hasattr(held, "longitude") and hasattr(held, "latitude") else None


def _rings(targets: Mapping[str, Any] | None) -> dict[str, list[Floats]]:
    """Give targets as rings of points, shape (n, 2)."""
    rings = {}
    for name, area in (targets or {}).items():
        given = getattr(area, "rings", (area,))
        points = [getattr(getattr(ring, "exterior", ring), "coords", ring) for ring in given]
        rings[name] = [np.asarray(ring, dtype=float) for ring in points]
    return rings


def _box(axes: Axes, box: Any, name: str, colour: str, style: str, **given: Any) -> list[Artist]:
    west, east, south, north = box
    return [
        *axes.plot(
            [west, east, east, west, west],
            [south, south, north, north, south],
            color=colour,
            linestyle=style,
            linewidth=1.4,
            zorder=3,
            label=f"extent of the {name}",
            **given,
        )
    ]


def _target(axes: Axes, name: str, rings: list[Floats], **given: Any) -> list[Artist]:
    artists: list[Artist] = []
    for ring in rings:
        artists += axes.fill(
            *ring.T,
            facecolor=VERMILION,
            edgecolor=VERMILION,
            alpha=0.35,
            zorder=2.5,
            label="_target" if artists else f"target {name}",
            **given,
        )
    longitude, latitude = rings[0].mean(axis=0)
    within = given["transform"]._as_mpl_transform(axes) if given else axes.transData
    artists.append(
        axes.text(
            longitude,
            latitude,
            name,
            transform=within,
            ha="center",
            va="center",
            fontsize=SMALL,
            color=tones().ink,
            zorder=5,
            clip_on=True,
        )
    )
    return artists
