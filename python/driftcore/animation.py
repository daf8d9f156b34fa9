"""A forecast in motion: its maps, or its kept members, time after time.

`animate` gives matplotlib's animation, for a notebook; `save` writes it to a file.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftcore.dataset import is_geographic
from driftcore.drawing import (
    PLANE,
    STRANDED,
    add_legend,
    days_per_unit,
    draw_coast,
    draw_release,
    fates,
    json_attribute,
    label_plane,
    member_dim,
    new_figure,
    plot_extra,
    require,
    set_title,
    wind_words,
)
from driftcore.errors import DriftCoreError, ScenarioError
from driftcore.files import check_writable, replacing
from driftcore.map_drawing import (
    add_colour_bar,
    add_legend_below,
    add_scale_and_north,
    around,
    date_words,
    days_after,
    draw_land,
    in_degrees,
    map_axes,
    release_of,
    sea_dataset,
    surroundings,
)
from driftcore.plot_presence import (
    cells_of,
    draw_presence,
    map_without_cells,
    scale_of,
    words_at,
)
from driftcore.results import Forecast

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.animation import FuncAnimation
    from matplotlib.axes import Axes

    from driftcore.coast import LandCoast

__all__ = ["animate", "save"]

Floats = NDArray[np.float64]
Kind = Literal["maps", "members"]

_DPI = 120
_SUFFIXES = (".gif", ".mp4")
# Of a member's last positions, how many its tail shows, in shares of the run.
_TAIL = 1 / 30


class _Members(NamedTuple):
    """Where the kept members are when."""

    times: NDArray[Any]
    """Shape (time,)."""
    paths: Floats
    """Shape (member, time, 2), NaN where not adrift."""
    ends: Floats
    """Places of stranding, shape (member, 2)."""
    stranded_at: NDArray[Any]
    """Shape (member,)."""
    status: NDArray[Any]
    """Shape (member,)."""


def animate(
    forecast: Forecast | xr.Dataset,
    coast: LandCoast | None = None,
    kind: Kind | None = None,
    frames: int = 200,
    fps: float = 10.0,
    ax: Axes | None = None,
) -> FuncAnimation:
    """Animate a forecast.

    Parameters
    ----------
    forecast : Forecast or xarray.Dataset
        With maps, or with kept members.
    coast : LandCoast, optional
        Land to draw on the real sea; the paper's coast is in the forecast.
    kind : {"maps", "members"}, optional
        Maps of presence on one colour scale, or kept members as points by what becomes of them;
        default the maps where there are any.
    frames : int
        At most so many, evenly chosen from the times there are.
    fps : float
        Frames a second.
    ax : matplotlib.axes.Axes, optional
        Where to draw; left out, a new figure.

    Returns
    -------
    matplotlib.animation.FuncAnimation
        Each frame says its time: UTC and days on the real sea.

    Raises
    ------
    ScenarioError
        An argument is not accepted, or the forecast has neither maps nor kept members.
    """
    dataset = forecast.dataset if isinstance(forecast, Forecast) else forecast
    if not fps > 0:
        raise ScenarioError(f"fps: {fps!r} is not accepted; a number of frames a second above 0")
    if frames < 1:
        raise ScenarioError(f"frames: {frames!r} is not accepted; 1 or more")
    if kind is None:
        kind = "maps" if "presence" in dataset else "members"
    if kind not in ("maps", "members"):
        raise ScenarioError(f"kind: {kind!r} is not accepted; 'maps' or 'members'")
    if kind == "maps" and "presence" not in dataset:
        raise ScenarioError(
            "kind: 'maps' is not accepted: the forecast has none (`[maps]` in its scenario makes "
            "them); 'members'"
        )
    with plot_extra():
        from matplotlib.animation import FuncAnimation
    draw = _maps if kind == "maps" else _members
    axes, number, show = draw(dataset, coast, ax)
    figure: Any = axes.figure
    show(0)
    if ax is None:
        # Laid out once: no frame may shift the map.
        figure.canvas.draw()
        figure.set_layout_engine("none")
    chosen = np.unique(np.linspace(0, number - 1, min(frames, number)).round().astype(int))
    return FuncAnimation(
        figure, show, frames=chosen.tolist(), interval=1000 / fps, blit=False, repeat=True
    )


def save(
    forecast: Forecast | xr.Dataset,
    path: str | Path,
    coast: LandCoast | None = None,
    kind: Kind | None = None,
    frames: int = 200,
    fps: float = 10.0,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write the animation of a forecast, whole or not at all.

    Parameters
    ----------
    forecast, coast, kind, frames, fps
        As in `animate`.
    path : str or pathlib.Path
        ``.gif``, or ``.mp4`` for which ffmpeg is needed: the system's, or that of the package
        imageio-ffmpeg.
    overwrite : bool
        Replace a file that is there.
    progress : callable, optional
        Called with (frames done, frames).

    Returns
    -------
    pathlib.Path
        Of the file.

    Raises
    ------
    DriftCoreError
        There is no ffmpeg; the message says what brings it.
    OutputError
        The file exists and `overwrite` is not set, or it cannot be written.
    ScenarioError
        The suffix is another, or as in `animate`.
    """
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        raise ScenarioError(f"path: '{path}' is not accepted; a name that ends in .gif or .mp4")
    check_writable(path, overwrite)
    writer = _writer(path.suffix.lower(), fps)
    moving = animate(forecast, coast, kind, frames, fps)

    def told(done: int, of: int) -> None:
        if progress is not None:
            progress(done + 1, of)

    with replacing(path, overwrite) as temporary:
        moving.save(str(temporary), writer=writer, dpi=_DPI, progress_callback=told)
    return path


def _writer(suffix: str, fps: float) -> Any:
    with plot_extra():
        from matplotlib.animation import FFMpegWriter, PillowWriter
    if suffix == ".gif":
        return PillowWriter(fps=fps)  # type: ignore[arg-type]  # takes any number
    binary = _ffmpeg()

    class Writer(FFMpegWriter):
        """Runs the ffmpeg that was found, which matplotlib else takes from its settings."""

        @classmethod
        def bin_path(cls) -> str:
            """Give its path."""
            return binary

    return Writer(
        fps=fps,  # type: ignore[arg-type]  # takes any number
        codec="h264",
        extra_args=["-pix_fmt", "yuv420p"],
    )


def _ffmpeg() -> str:
    """Find ffmpeg."""
    found = shutil.which("ffmpeg")
    if found is not None:
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe  # type: ignore[import-untyped]  # has no types

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        raise DriftCoreError(
            'mp4 needs ffmpeg, which is not installed: pip install "driftcore[animation]", or '
            "name a .gif"
        ) from None


def _maps(
    dataset: xr.Dataset, coast: LandCoast | None, ax: Axes | None
) -> tuple[Axes, int, Callable[[int], Any]]:
    """Draw what stays; give the axes, the number of maps, and what draws one of them."""
    cells = cells_of(dataset)
    axes, _ = map_without_cells(dataset, cells, coast, ax)
    scale = scale_of(dataset, cells)
    drawn: list[Any] = []

    def show(index: int) -> list[Any]:
        first = not drawn
        for artist in drawn:
            artist.remove()
        drawn[:] = draw_presence(axes, dataset, cells, index, scale)
        if first:
            add_colour_bar(axes, drawn[0], cells.words)
        set_title(axes, words_at(dataset, index), wind_words(dataset), 60)
        return drawn

    return axes, dataset.sizes["map_time"], show


def _members(
    dataset: xr.Dataset, coast: LandCoast | None, ax: Axes | None
) -> tuple[Axes, int, Callable[[int], Any]]:
    """Draw what stays; give the axes, the number of times, and what draws one of them."""
    from matplotlib.collections import LineCollection

    sea = is_geographic(dataset)
    kept = _kept(dataset)
    axes, given = _around_members(dataset, kept, coast, ax)
    tail = max(1, round(_TAIL * len(kept.times)))
    points: dict[int, Any] = {}
    tails: Any = axes.add_collection(
        LineCollection([], colors=fates()[0][1], linewidths=0.6, alpha=0.5, zorder=2, **given),
        autolim=False,
    )
    for flag, (label, colour) in fates().items():
        if flag and not (kept.status == flag).any():
            continue
        (points[flag],) = axes.plot(
            [],
            [],
            linestyle="none",
            marker=".",
            markersize=5.0,
            markeredgewidth=0.0,
            color=colour,
            zorder=4 if flag == STRANDED else 3,
            label=label if flag else "adrift",
            **given,
        )
    legend = add_legend_below(axes) if sea else add_legend(axes, loc="upper right")
    for handle in legend.get_lines()[-len(points) :]:
        handle.set_markersize(9.0)

    def show(index: int) -> list[Any]:
        ashore = kept.stranded_at <= kept.times[index]
        here = np.where(ashore[:, None], kept.ends, kept.paths[:, index])
        # What will strand is adrift until it does.
        now = np.where(ashore, STRANDED, np.where(kept.status == STRANDED, 0, kept.status))
        before = kept.paths[:, max(0, index - tail) : index + 1]
        for flag, line in points.items():
            members = now == flag
            line.set_data(*here[members].T)
            if flag == 0:
                tails.set_segments(before[members])
        stranded = 100 * float(ashore.mean())
        set_title(
            axes,
            f"{_when(dataset, kept.times[index])}\n{stranded:.1f} % of {len(now):,} members ashore",
            wind_words(dataset),
            60,
        )
        return [*points.values(), tails]

    return axes, len(kept.times), show


def _kept(dataset: xr.Dataset) -> _Members:
    """Give the paths of the kept members."""
    if is_geographic(dataset):
        sea_dataset(dataset)
        dim = member_dim(dataset["longitude"])
        fate = dataset.sel(member=dataset[dim].values)
        paths = [around(dataset["longitude"].values, dataset), dataset["latitude"].values]
        ends = [
            around(fate["stranding_longitude"].values, dataset),
            fate["stranding_latitude"].values,
        ]
    else:
        require(dataset, "status", "stranding_position", "position")
        dim = member_dim(dataset["position"])
        fate = dataset.sel(member=dataset[dim].values)
        position = dataset["position"].transpose(dim, "time", "component").values
        paths, ends = list(np.moveaxis(position, -1, 0)), list(fate["stranding_position"].values.T)
    if not dataset.sizes[dim]:
        raise ScenarioError("forecast: no paths were kept; run it with keep above 0")
    return _Members(
        dataset["time"].values,
        np.stack(paths, axis=-1),
        np.stack(ends, axis=-1),
        fate["stranding_time"].values,
        fate["status"].values,
    )


def _around_members(
    dataset: xr.Dataset, kept: _Members, coast: LandCoast | None, ax: Axes | None
) -> tuple[Axes, dict[str, Any]]:
    """Draw coast and release around all that will be shown."""
    release: Any = json_attribute(dataset, "release") if not is_geographic(dataset) else None
    if is_geographic(dataset):
        release = release_of(dataset)
    points = [kept.paths.reshape(-1, 2), kept.ends, np.asarray(release)[None]]
    if is_geographic(dataset):
        axes = map_axes(ax, surroundings(points))
        given = in_degrees(axes)
        draw_land(axes, coast)
        draw_release(axes, release, **given)
        add_scale_and_north(axes)
        return axes, given
    if coast is not None:
        raise ScenarioError("coast: is not accepted in the paper's plane, whose forecast holds it")
    axes = new_figure(PLANE).subplots() if ax is None else ax
    draw_coast(axes, dataset)
    draw_release(axes, release)
    axes.update_datalim(np.concatenate(points)[np.isfinite(np.concatenate(points)).all(axis=1)])
    axes.autoscale_view()
    label_plane(axes, dataset["position"])
    return axes, {}


def _when(dataset: xr.Dataset, instant: Any) -> str:
    """Say what is shown and when."""
    name = dataset.attrs.get("scenario", "drift")
    if is_geographic(dataset):
        return f"{name}, {date_words(instant)}, {days_after(dataset, instant):.1f} days"
    days = days_per_unit(dataset)
    return f"{name}, time {instant:.3f}" + (f", {instant * days:.1f} days" if days else "")
