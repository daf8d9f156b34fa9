"""Maps of the real sea: axes, land, scale and north, on plain axes and on cartopy's.

Maps need no map library: a degree of longitude is drawn cos(latitude) as long as one of latitude,
so that directions and the scale bar are true in the middle of the map. Axes of cartopy
(``projection=...``) are taken as they are, in any projection; nothing is downloaded for them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from driftcore.coast import near_longitude
from driftcore.drawing import (
    LABEL,
    SMALL,
    add_legend,
    label_axes,
    new_figure,
    paper,
    require,
    set_title,
    share_stranded,
    tones,
    wind_words,
)
from driftcore.earth import KM_PER_DEGREE
from driftcore.results import Forecast

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.legend import Legend

    from driftcore.coast import LandCoast

Floats = NDArray[np.float64]
# West, east, south, north [degrees].
Box = tuple[float, float, float, float]

_MAP_WIDTH, _MAP_HEIGHT = 5.0, 4.6  # in, at most
_AROUND, COLOUR_BAR = (0.9, 1.6), 0.8  # in, what title, labels and legend take


def sea_dataset(forecast: Forecast | xr.Dataset) -> xr.Dataset:
    """Give the dataset of a forecast on the real sea."""
    dataset = forecast.dataset if isinstance(forecast, Forecast) else forecast
    require(dataset, "status", "stranding_time", "stranding_longitude", "stranding_latitude")
    return dataset


def start_of(dataset: xr.Dataset) -> np.datetime64:
    """Earliest release."""
    return np.datetime64(dataset.attrs["start"], "ns")


def end_of(dataset: xr.Dataset) -> np.datetime64:
    """End of the run."""
    return start_of(dataset) + _days(dataset.attrs["days"])


def _days(number: Any) -> np.timedelta64:
    return np.timedelta64(round(float(number) * 86_400e6), "us")


def days_after(dataset: xr.Dataset, instant: np.datetime64) -> float:
    """Give days after the earliest release."""
    return float((instant - start_of(dataset)) / np.timedelta64(1, "D"))


def date_words(instant: np.datetime64) -> str:
    """Write an instant as people do."""
    return str(instant.astype("datetime64[m]")).replace("T", " ") + " UTC"


def release_of(dataset: xr.Dataset) -> Floats:
    """Middle of the releases: longitude and latitude [degrees]."""
    longitude = dataset["release_longitude"].values
    known = longitude[np.isfinite(longitude)]
    if len(known):  # either side of the dateline
        longitude = near_longitude(longitude, float(known[0]))
    return np.array([np.nanmedian(longitude), np.nanmedian(dataset["release_latitude"].values)])


def around(longitude: Any, dataset: xr.Dataset) -> Floats:
    """Give longitudes in the turn around the release, so that no path jumps at the dateline."""
    return near_longitude(longitude, float(release_of(dataset)[0]))


def surroundings(groups: list[Floats]) -> Box:
    """Box around points, with a margin."""
    points = np.concatenate(groups)
    (west, south), (east, north) = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    margin = max(0.06 * max(east - west, north - south), 0.05)
    return west - margin, east + margin, max(south - margin, -90.0), min(north + margin, 90.0)


def in_degrees(axes: Axes) -> dict[str, Any]:
    """Give the keywords by which axes take longitude and latitude: cartopy's need one."""
    if not hasattr(axes, "set_extent"):
        return {}
    from cartopy.crs import PlateCarree  # type: ignore[import-untyped]  # has no types

    return {"transform": PlateCarree()}


def map_axes(axes: Axes | None, box: Box, beside: float = 0.0) -> Axes:
    """Axes of a map, true to scale in its middle; so much [in] is kept free beside it."""
    west, east, south, north = box
    aspect = 1 / math.cos(math.radians((south + north) / 2))
    if axes is None:
        wide = (east - west) / (north - south) / aspect
        height = min(_MAP_HEIGHT, _MAP_WIDTH / wide)
        # The title needs its width, however narrow the map.
        width = max(height * wide + _AROUND[0] + beside, _MAP_WIDTH)
        axes = new_figure((width, height + _AROUND[1])).subplots()
    geo: Any = axes
    if given := in_degrees(axes):
        geo.set_extent(box, crs=given["transform"])
        lines = geo.gridlines(
            draw_labels={"bottom": "x", "left": "y"},
            x_inline=False,
            y_inline=False,
            color=tones().grid,
            linewidth=0.5,
            zorder=0.3,
        )
        lines.xlabel_style = lines.ylabel_style = {"size": SMALL}
        return axes
    axes.set_xlim(west, east)
    axes.set_ylim(south, north)
    axes.set_aspect(aspect)
    axes.xaxis.set_major_formatter(lambda value, _: _degrees(value, "EW"))
    axes.yaxis.set_major_formatter(lambda value, _: _degrees(value, "NS"))
    label_axes(axes, "longitude", "latitude")
    return axes


def _degrees(value: float, sides: str) -> str:
    turned = (value + 180) % 360 - 180 if sides == "EW" else value
    side = "" if turned == 0 else f" {sides[int(turned < 0)]}"
    return f"{abs(round(turned, 6)):g}°{side}"


def draw_land(axes: Axes, coast: LandCoast | None) -> list[Artist]:
    """Draw the land of a view, holes left open."""
    if coast is None:
        return []
    import shapely
    from matplotlib.collections import PathCollection
    from matplotlib.path import Path

    geo: Any = axes
    given = in_degrees(axes)
    if given:
        west, east, south, north = geo.get_extent(given["transform"])
    else:
        (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    if west < coast.reference - 180 or east > coast.reference + 180:
        coast = coast.around((west + east) / 2)
    polygons = coast.polygons
    bounds = shapely.bounds(polygons).reshape(-1, 4)
    seen = (
        (bounds[:, 0] < east)
        & (bounds[:, 2] > west)
        & (bounds[:, 1] < north)
        & (bounds[:, 3] > south)
    )
    hues: dict[str, Any] = {"facecolor": tones().land, "edgecolor": tones().shore}
    look: dict[str, Any] = {"linewidth": 0.6, "zorder": 0.5}
    if given:
        return [geo.add_geometries(polygons[seen], given["transform"], **hues, **look)]
    paths = [
        Path.make_compound_path(
            *(Path(shapely.get_coordinates(ring), closed=True) for ring in shapely.get_rings(land))
        )
        for land in shapely.orient_polygons(polygons[seen])
    ]
    land = PathCollection(paths, **hues, **look)
    return [axes.add_collection(land, autolim=False)]


def _place(axes: Any, x: float, y: float) -> Floats:
    """Longitude and latitude of a point of the axes."""
    given = in_degrees(axes)
    return np.array(given["transform"].transform_point(x, y, axes.projection) if given else (x, y))


def _point(axes: Any, longitude: float, latitude: float) -> Floats:
    """Point of the axes at a longitude and latitude."""
    given = in_degrees(axes)
    if not given:
        return np.array([longitude, latitude])
    return np.array(axes.projection.transform_point(longitude, latitude, given["transform"]))


def add_scale_and_north(axes: Axes) -> list[Artist]:
    """Draw a bar of a round length at the lower left, and an arrow to the north."""
    from matplotlib.patheffects import withStroke

    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    middle = (bottom + top) / 2
    # A tenth of the middle: near enough for a projection to be true, and a parallel straight.
    ends = [_place(axes, left + share * (right - left), middle) for share in (0.45, 0.55)]
    (east, north), latitude = ends[1] - ends[0], math.radians((ends[0] + ends[1])[1] / 2)
    east = (east + 180) % 360 - 180
    per_unit = math.hypot(east * math.cos(latitude), north) / (0.1 * (right - left))
    per_unit *= KM_PER_DEGREE  # km in a unit of the axes
    longest = (right - left) * per_unit / 4
    ten = 10.0 ** math.floor(math.log10(longest))
    length = max(ten * step for step in (1, 2, 5) if ten * step <= longest)
    x, y = left + 0.05 * (right - left), bottom + 0.045 * (top - bottom)
    over: dict[str, Any] = {"zorder": 6, "color": tones().ink}
    halo = [withStroke(linewidth=2.5, foreground=paper())]
    (bar,) = axes.plot(
        [x, x + length / per_unit],
        [y, y],
        linewidth=2.0,
        solid_capstyle="butt",
        path_effects=[withStroke(linewidth=4.0, foreground=paper())],
        **over,
    )
    words = axes.annotate(
        f"{length:g} km",
        (x + length / per_unit / 2, y),
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        fontsize=SMALL,
        path_effects=halo,
        **over,
    )
    at = np.array([left + 0.055 * (right - left), bottom + 0.92 * (top - bottom)])
    longitude, latitude_here = _place(axes, *at)
    north_of_it = _point(axes, longitude, min(latitude_here + 0.1, 90.0))
    toward = (north_of_it - at) / np.hypot(*(north_of_it - at))
    arrow = axes.annotate(
        "N",
        (0.055, 0.965),
        xytext=tuple(-27.0 * toward),
        xycoords="axes fraction",
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=LABEL,
        path_effects=halo,
        arrowprops={
            "arrowstyle": "-|>",
            "color": tones().ink,
            "linewidth": 1.2,
            "shrinkB": 0,
            "path_effects": halo,
        },
        **over,
    )
    return [bar, words, arrow]


def add_colour_bar(axes: Axes, drawn: Any, words: str) -> None:
    """Add a logarithmic colour bar with plain numbers."""
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
    bar.set_label(words, fontsize=LABEL)
    bar.ax.tick_params(labelsize=SMALL)


def set_run_title(axes: Axes, dataset: xr.Dataset, more: str = "") -> None:
    """Say what was followed from when on, what became of it, and under which wind."""
    attributes = dataset.attrs
    what = (
        f"{attributes['scenario']}, {attributes['days']:g} days from "
        f"{date_words(start_of(dataset))}"
    )
    set_title(axes, f"{what}\n{share_stranded(dataset)}{more}", wind_words(dataset), 60)


def add_legend_below(axes: Axes) -> Legend:
    """Add a legend where it hides nothing."""
    return add_legend(
        axes,
        loc="upper center",
        bbox_to_anchor=(0.5, -0.1),
        ncols=4,
        columnspacing=1.2,
        handlelength=1.6,
    )
