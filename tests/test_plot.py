"""Figures draw the data they are given, say what it is, and leave nothing else behind."""

from __future__ import annotations

import json
import pathlib
import sys
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle
from matplotlib.text import Text
from numpy.typing import NDArray

from driftcore import plot
from driftcore.dataset import with_maps
from driftcore.errors import DriftCoreError, OutputError, ScenarioError
from driftcore.maps import MapGrid

if TYPE_CHECKING:
    from io import BytesIO
    from pathlib import Path

Floats = NDArray[np.float64]

CIRCLE = {"kind": "circle", "center": [1.0, 1.0], "radius": 0.3, "side": "inside"}
POLYGONS = {
    "kind": "polygons",
    "rings": [[[-9.0, -9.0], [9.0, -9.0], [9.0, 0.7], [-9.0, 0.7]], [[5, 5], [6, 5], [6, 6]]],
    "side": "outside",
}
FILES = ["trajectories.png", "roses.png", "stranding_times.png", "estimate.png"]


def make_forecast(
    members: int = 40,
    kept: int | None = None,
    stranded: float = 0.5,
    coast: dict[str, Any] | None = CIRCLE,
    **attrs: Any,
) -> xr.Dataset:
    """Make straight paths from (1, 1): the first ones reach the circle, the others half of it."""
    rng = np.random.default_rng(7)
    kept = members if kept is None else kept
    strands = np.arange(members) < round(stranded * members)
    angle = rng.uniform(-np.pi, np.pi, members)
    heading = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    time = np.linspace(0.0, 1.0, 21)
    arrival = np.where(strands, rng.uniform(0.2, 0.9, members), np.nan)
    rate = np.where(strands, 0.3 / arrival, 0.15)
    position = 1.0 + (rate[:, None] * time)[..., None] * heading[:, None, :]
    position[time > arrival[:, None]] = np.nan
    dim = "member" if kept == members else "kept_member"
    dataset = xr.Dataset(
        {
            "status": ("member", strands.astype("int8")),
            "stranding_time": ("member", arrival),
            "stranding_position": (
                ("member", "component"),
                np.where(strands[:, None], 1.0 + 0.3 * heading, np.nan),
            ),
            "position": ((dim, "time", "component"), position[:kept]),
            "wind_velocity": (
                (dim, "wind_time", "component"),
                rng.normal(0.0, 4.0, (kept, 12, 2)),
                {"units": "m s-1"},
            ),
        },
        coords={"component": ["x", "y"], "time": time, "wind_time": np.linspace(0.0, 1.0, 12)},
        attrs={
            "wind_label": "synthetic climate, June to August",
            "wind_synthetic": 1,
            "release": "[1.0, 1.0]",
            "tide_period_h": 12.5,
            "epsilon": 0.02,
            "duration": 1.0,
            "wind_unit": 3.0,
        }
        | ({} if coast is None else {"coast": json.dumps(coast)})
        | attrs,
    )
    return dataset if dim == "member" else dataset.assign_coords(kept_member=np.arange(kept))


class LinearPath:
    """Wind (t, -2 t), whose mean over any window is its value at the middle."""

    window = np.nan

    def at(self, t: Floats) -> Floats:
        return np.stack([t, -2.0 * t], axis=-1)

    def mean(self, t: Floats, window: float) -> Floats:
        self.window = window
        return self.at(t)


def make_trajectories() -> tuple[xr.Dataset, xr.Dataset]:
    """Make a full trajectory, and an averaged one off by (3e-4, 4e-4)."""
    time = np.linspace(0.0, 1.0, 201)
    slow = np.stack([1.0 + 0.1 * time, 1.0 - 0.2 * time], axis=-1)
    tide = 0.02 * np.sin(2 * np.pi * time / 0.1)[:, None] * [1.0, 0.5]
    dims, error = ("time", "component"), np.array([3e-4, 4e-4])
    coords = {"time": time, "component": ["x", "y"]}
    attrs = {"epsilon": 0.02, "tide_period_h": 12.5, "wind_unit": 3.0, "wind_synthetic": 1}
    full = xr.Dataset(
        {"position": (dims, slow + tide), "velocity": (dims, 2 * slow + tide)}, coords, attrs
    )
    averaged = xr.Dataset(
        {
            "position": (dims, slow + tide + error),
            "velocity": (dims, 2 * slow + tide - error),
            "mean_position": (dims, slow),
            "mean_velocity": (dims, 2 * slow),
        },
        coords,
        {**attrs, "model": "paper", "order": 1, "window": 0.015},
    )
    return full, averaged


def figure_of(artists: list[Any]) -> Figure:
    """Take the figure that the artists are on."""
    figure = artists[0].figure
    assert isinstance(figure, Figure)
    return figure


def texts(figure: Figure) -> list[str]:
    """Read everything written on a figure."""
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


def labelled(artists: list[Any], label: str) -> Any:
    """Take the one artist with this legend entry."""
    (found,) = [artist for artist in artists if artist.get_label() == label]
    return found


def heights(bars: list[Any], classes: int = 1) -> Floats:
    """Read the lengths of a rose's bars, shape (sector, class)."""
    assert all(isinstance(bar, Rectangle) for bar in bars)
    return np.reshape([bar.get_height() for bar in bars], (16, classes))


def draw(artists: list[Any]) -> None:
    """Lay out and render, where warnings about a figure come up."""
    figure_of(artists).canvas.draw()


def test_trajectories_draw_the_paths_by_fate() -> None:
    forecast = make_forecast()
    artists = plot.trajectories(forecast)
    stranded = labelled(artists, "stranded").get_segments()
    afloat = labelled(artists, "afloat at the end").get_segments()
    assert [len(stranded), len(afloat)] == [20, 20]
    for member in range(20):
        path = forecast["position"][member].to_numpy()
        path = path[np.isfinite(path[:, 0])]
        np.testing.assert_array_equal(stranded[member][:-1], path)
        np.testing.assert_array_equal(
            stranded[member][-1], forecast["stranding_position"][member].to_numpy()
        )
        np.testing.assert_array_equal(afloat[member], forecast["position"][20 + member])
    stars = labelled(artists, "stranding point")
    assert stars.get_marker() == "*"
    np.testing.assert_array_equal(stars.get_xydata(), forecast["stranding_position"][:20])
    np.testing.assert_array_equal(labelled(artists, "release").get_xydata(), [[1.0, 1.0]])
    draw(artists)


def test_trajectories_draw_no_more_members_than_the_limit() -> None:
    artists = plot.trajectories(make_forecast(), limit=25)
    assert len(labelled(artists, "stranded").get_segments()) == 20
    assert len(labelled(artists, "afloat at the end").get_segments()) == 5
    assert "20 of 40 members stranded (50.0 %), 25 drawn" in figure_of(artists).axes[0].get_title()
    with pytest.raises(ScenarioError, match=r"limit: got 0 .* 1 or more"):
        plot.trajectories(make_forecast(), limit=0)


def test_trajectories_match_kept_members_with_their_fate() -> None:
    forecast = make_forecast(kept=30).isel(kept_member=[3, 25, 28])
    artists = plot.trajectories(forecast)
    np.testing.assert_array_equal(
        labelled(artists, "stranding point").get_xydata(), forecast["stranding_position"][[3]]
    )
    assert len(labelled(artists, "stranded").get_segments()) == 1
    assert len(labelled(artists, "afloat at the end").get_segments()) == 2


def test_every_fate_has_its_own_colour() -> None:
    forecast = make_forecast()
    forecast["status"][20:25] = 2
    forecast["status"][25:30] = 3
    lines = [a for a in plot.trajectories(forecast) if isinstance(a, LineCollection)]
    assert {line.get_label() for line in lines} == {
        "afloat at the end",
        "stranded",
        "left the domain",
        "failed",
    }
    assert len(np.unique([line.get_edgecolor() for line in lines], axis=0)) == 4


def test_circular_coast() -> None:
    (coast,) = [a for a in plot.trajectories(make_forecast()) if isinstance(a, Circle)]
    assert list(coast.get_patch_transform().transform((0.0, 0.0))) == [1.0, 1.0]
    assert coast.get_radius() == 0.3


def test_polygons_are_drawn_without_widening_the_view() -> None:
    artists = plot.trajectories(make_forecast(coast=POLYGONS))
    draw(artists)
    coast: Any = labelled(artists, "coast")
    assert isinstance(coast, PolyCollection)
    assert [np.asarray(path.vertices)[0, 0] for path in coast.get_paths()] == [-9, 5]
    low, high = figure_of(artists).axes[0].get_ylim()
    assert 0.5 < low < 0.7
    assert 1.3 < high < 1.5


@pytest.mark.parametrize("side", ["inside", "outside"])
def test_rings_within_rings_alternate_between_land_and_sea(side: str) -> None:
    rings = [[[-r, -r], [r, -r], [r, r], [-r, r]] for r in (2, 3, 1)] + [[[7, 7], [8, 7], [8, 8]]]
    artists = plot.trajectories(
        make_forecast(coast={"kind": "polygons", "rings": rings, "side": side})
    )
    coast: Any = labelled(artists, "coast")
    assert isinstance(coast, PolyCollection)
    assert [np.asarray(path.vertices)[0, 0] for path in coast.get_paths()] == [-3, 7, -2, -1]
    outer, apart, middle, inner = map(tuple, np.asarray(coast.get_facecolor()))
    assert outer == apart == inner != middle
    white = (1.0, 1.0, 1.0, 1.0)
    assert (outer == white) is (side == "inside")
    assert (middle == white) is (side == "outside")
    assert (figure_of(artists).axes[0].get_facecolor() == white) is (side == "outside")


def test_unknown_coast_and_bad_json_are_refused() -> None:
    with pytest.raises(ScenarioError, match="coast: got kind 'ellipse'"):
        plot.trajectories(make_forecast(coast={"kind": "ellipse"}))
    with pytest.raises(ScenarioError, match="release: got 'here'"):
        plot.trajectories(make_forecast(release="here"))


def test_plane_has_equal_scales_and_units() -> None:
    axes = figure_of(plot.trajectories(make_forecast())).axes[0]
    assert axes.get_aspect() == 1.0
    assert axes.get_xlabel() == "x, eastward [scenario units]"
    assert axes.get_ylabel() == "y, northward [scenario units]"


def test_stranding_points_alone_where_no_path_is_kept() -> None:
    artists = plot.trajectories(make_forecast().drop_vars("position"))
    assert not [a for a in artists if isinstance(a, LineCollection)]
    assert len(labelled(artists, "stranding point").get_xydata()) == 20


def test_stranding_rose_adds_up_to_the_stranded_share() -> None:
    for share in (0.25, 1.0):
        bars = plot.stranding_rose(make_forecast(members=80, stranded=share))
        assert heights(bars).sum() == pytest.approx(100 * share)


@pytest.mark.parametrize(
    ("coast", "point", "sector"),
    [
        (CIRCLE, [1.0, 1.3], 0),  # north of the centre
        (CIRCLE, [1.3, 1.0], 4),  # east
        (CIRCLE, [1.0 - 0.3 * np.sin(np.pi / 8), 1.0 - 0.3 * np.cos(np.pi / 8)], 9),  # SSW
        (POLYGONS, [1.0, 0.7], 14),  # north-west of the release, which is at (1.3, 0.4)
        (None, [1.0, 0.7], 14),
    ],
)
def test_stranding_rose_points_at_the_stranding_point(
    coast: dict[str, Any] | None, point: list[float], sector: int
) -> None:
    forecast = make_forecast(members=4, stranded=0.25, coast=coast, release="[1.3, 0.4]")
    forecast["stranding_position"][0] = point
    lengths = heights(plot.stranding_rose(forecast))[:, 0]
    assert lengths[sector] == pytest.approx(25.0)
    assert lengths.sum() == pytest.approx(25.0)


def test_bars_stand_where_the_compass_says() -> None:
    forecast = make_forecast(members=1, stranded=1.0)
    forecast["stranding_position"][0] = [1.3, 1.0]
    artists: list[Any] = plot.stranding_rose(forecast)
    (east,) = [bar for bar in artists if bar.get_height() > 0]
    axes = figure_of(artists).axes[0]
    labels = dict(zip(axes.get_xticks(), axes.get_xticklabels(), strict=True))
    middle = (east.get_x() + east.get_width() / 2) % (2 * np.pi)
    nearest = min(labels, key=lambda tick: abs(np.angle(np.exp(1j * (tick - middle)))))
    assert labels[nearest].get_text() == "E"


def test_wind_rose_shows_where_the_wind_blows_from_in_percent() -> None:
    forecast = make_forecast(members=2)
    wind = np.zeros((2, 12, 2))
    wind[0] = [0.0, -4.0]  # toward the south, so from the north; 3 to 6 m/s
    wind[1, :6] = [10.0, 0.0]  # from the west; above 9 m/s
    wind[1, 6:] = [-1.0, 0.0]  # from the east; below 3 m/s
    forecast["wind_velocity"] = forecast["wind_velocity"].copy(data=wind)
    table = heights(plot.wind_rose(forecast), classes=4)
    expected = np.zeros((16, 4))
    expected[0, 1], expected[12, 3], expected[4, 0] = 50.0, 25.0, 25.0
    np.testing.assert_allclose(table, expected)


def test_wind_rose_counts_calms_and_unknown_values_apart() -> None:
    forecast = make_forecast(members=1)
    wind = np.full((1, 12, 2), [0.0, -4.0])
    wind[0, :2] = 0.0
    wind[0, 2:4] = np.nan
    forecast["wind_velocity"] = forecast["wind_velocity"].copy(data=wind)
    artists = plot.wind_rose(forecast)
    assert heights(artists, classes=4).sum() == pytest.approx(80.0)
    assert "10 values, 1 member, calm 20.0 %" in figure_of(artists).axes[0].get_title()


def test_wind_rose_speed_classes() -> None:
    artists = plot.wind_rose(make_forecast(), speed_classes=(0, 5))
    assert heights(artists, classes=2).sum() == pytest.approx(100.0)
    assert {"wind speed [m/s]", "0 to 5", "≥ 5"} <= set(texts(figure_of(artists)))
    for bad in ((), (1, 2), (0, 3, 3)):
        with pytest.raises(ScenarioError, match="speed_classes: got"):
            plot.wind_rose(make_forecast(), speed_classes=bad)


def test_roses_side_by_side() -> None:
    forecast = make_forecast()
    artists = plot.roses(forecast)
    draw(artists)
    left, right = figure_of(artists).axes
    assert len(artists) == 16 * 4 + 16
    assert all(artist.axes is left for artist in artists[:64])
    assert all(artist.axes is right for artist in artists[64:])
    assert heights(artists[:64], classes=4).sum() == pytest.approx(100.0)
    assert heights(artists[64:]).sum() == pytest.approx(50.0)
    assert {"wind speed [m/s]", "share of all members"} <= set(texts(figure_of(artists)))
    for axes in (left, right):
        assert all(label.get_text().endswith(" %") for label in axes.get_yticklabels())


def test_roses_need_rose_axes_and_an_origin() -> None:
    with pytest.raises(ScenarioError, match=r"ax: got projection 'rectilinear'.*'windrose'"):
        plot.wind_rose(make_forecast(), ax=Figure().subplots())
    forecast = make_forecast(coast=None)
    del forecast.attrs["release"]
    with pytest.raises(ScenarioError, match="release: absent"):
        plot.stranding_rose(forecast)


def test_stranding_times_are_the_empirical_distribution() -> None:
    forecast = make_forecast()
    line = plot.stranding_times(forecast)[0]
    assert isinstance(line, Line2D)
    assert line.get_drawstyle() == "steps-post"
    t, percent = np.asarray(line.get_xydata()).T
    times = forecast["stranding_time"].to_numpy()
    np.testing.assert_allclose(
        percent[:-1], [100 * np.mean(times <= s) for s in t[:-1]], rtol=1e-12
    )
    assert [t[0], percent[0], t[-1], percent[-1]] == [0.0, 0.0, 1.0, 50.0]


def test_stranding_times_carry_wilson_intervals() -> None:
    # 643 of 1000: interval from the score equation |p - 0.643| = z sqrt(p (1 - p) / 1000).
    band: Any = plot.stranding_times(make_forecast(members=1000, stranded=0.643))[1]
    vertices = band.get_paths()[0].vertices
    at_end = vertices[vertices[:, 0] == 1.0][:, 1] / 100
    for p in (at_end.min(), at_end.max()):
        assert abs(p - 0.643) == pytest.approx(1.959964 * np.sqrt(p * (1 - p) / 1000), rel=1e-5)
    assert at_end.min() < 0.643 < at_end.max()


def test_failed_members_do_not_count() -> None:
    forecast = make_forecast()
    forecast["status"][30:] = 3
    assert heights(plot.stranding_rose(forecast)).sum() == pytest.approx(100 * 20 / 30)
    line = plot.stranding_times(forecast)[0]
    assert isinstance(line, Line2D)
    assert np.asarray(line.get_ydata())[-1] == pytest.approx(100 * 20 / 30)
    title = figure_of([line]).axes[0].get_title()
    assert title.startswith("20 of 30 members stranded (66.7 %), 10 failed")


def test_stranding_times_have_axes_in_both_units() -> None:
    artists: list[Any] = plot.stranding_times(make_forecast())
    draw(artists)
    axes = figure_of(artists).axes[0]
    assert axes.get_xlabel() == "time [scenario units]"
    assert axes.get_ylabel() == "cumulative probability\nof stranding [%]"
    days = artists[-1]
    assert days.get_xlabel() == "time [days]"
    assert days.get_xlim() == pytest.approx((0.0, 12.5 * 50 / 24))
    without = make_forecast()
    del without.attrs["tide_period_h"]
    assert len(plot.stranding_times(without)) == 2


def test_time_series_draw_wind_position_and_error() -> None:
    full, averaged = make_trajectories()
    t = full["time"].to_numpy()
    artists: list[Any] = plot.time_series(full, averaged, LinearPath())
    draw(artists)
    wind, solid, dashed, error, scale = artists[:5]
    np.testing.assert_array_equal(wind.get_xydata(), np.stack([t, t], axis=-1))
    np.testing.assert_array_equal(solid.get_ydata(), full["position"][:, 0])
    np.testing.assert_array_equal(dashed.get_ydata(), averaged["mean_position"][:, 0])
    np.testing.assert_allclose(error.get_ydata(), 5e-4, rtol=1e-9)
    np.testing.assert_allclose(scale.get_ydata(), 4e-4)
    assert [solid.get_linestyle(), dashed.get_linestyle()] == ["-", "--"]
    labels = [axes.get_ylabel() for axes in figure_of(artists).axes]
    assert labels == [
        "wind, x\n[unit: 3 m/s]",
        "position, x\n[scenario units]",
        "position error\n[scenario units]",
    ]


def test_speeds_in_units_are_called_so() -> None:
    """Where a trajectory comes from elsewhere."""
    full, averaged = make_trajectories()
    full["velocity"].attrs["units"] = "m s-1"
    artists: list[Any] = plot.time_series(full, averaged, LinearPath())
    assert figure_of(artists).axes[0].get_ylabel() == "wind, x\n[m s-1]"


def test_velocity_series_smooth_the_wind_over_the_window() -> None:
    full, averaged = make_trajectories()
    path = LinearPath()
    artists: list[Any] = plot.velocity_series(full, averaged, path, component="y")
    wind, solid, dashed, error = artists[:4]
    assert path.window == 0.015
    np.testing.assert_array_equal(wind.get_ydata(), -2.0 * full["time"])
    np.testing.assert_array_equal(solid.get_ydata(), full["velocity"][:, 1])
    np.testing.assert_array_equal(dashed.get_ydata(), averaged["mean_velocity"][:, 1])
    np.testing.assert_allclose(error.get_ydata(), 5e-4, rtol=1e-9)
    del averaged.attrs["window"]
    plot.velocity_series(full, averaged, path)
    assert path.window == 0.01
    del averaged.attrs["epsilon"]
    with pytest.raises(ScenarioError, match="window: absent"):
        plot.velocity_series(full, averaged, path)


def test_plane_draws_solid_dotted_and_dashed() -> None:
    full, averaged = make_trajectories()
    artists: list[Any] = plot.plane(full, averaged)
    draw(artists)
    assert [line.get_linestyle() for line in artists[:3]] == ["-", ":", "--"]
    for line, points in zip(
        artists, (full["position"], averaged["position"], averaged["mean_position"]), strict=False
    ):
        np.testing.assert_array_equal(line.get_xydata(), points)
    np.testing.assert_array_equal(artists[3].get_xydata(), full["position"][:1])
    assert artists[0].axes.get_aspect() == 1.0


def test_series_refuse_what_cannot_be_compared() -> None:
    full, averaged = make_trajectories()
    with pytest.raises(ScenarioError, match=r"time: 201 times .* 101"):
        plot.time_series(full, averaged.isel(time=slice(101)), LinearPath())
    with pytest.raises(ScenarioError, match="component: got 'z'"):
        plot.time_series(full, averaged, LinearPath(), component="z")
    with pytest.raises(ScenarioError, match="mean_position: not in the dataset"):
        plot.time_series(full, full, LinearPath())


def every_figure(forecast: xr.Dataset) -> list[list[Any]]:
    """Call every function that draws."""
    full, averaged = make_trajectories()
    return [
        plot.trajectories(forecast),
        plot.wind_rose(forecast),
        plot.stranding_rose(forecast),
        plot.roses(forecast),
        plot.stranding_times(forecast),
        plot.time_series(full, averaged, LinearPath()),
        plot.velocity_series(full, averaged, LinearPath()),
        plot.plane(full, averaged),
    ]


def test_convergence_is_logarithmic_and_tells_curves_apart() -> None:
    x = [0.01, 0.1]
    curves = {f"curve {k}": (x, [10.0 ** -(k + 2), 10.0**-k]) for k in range(8)}
    lines = plot.convergence(curves, "step", "error")
    axes = figure_of(lines).axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    assert {"step", "error", *curves} <= set(texts(figure_of(lines)))
    assert labelled(lines, "curve 1").get_xydata().tolist() == [[0.01, 1e-3], [0.1, 0.1]]
    assert len({line.get_color() for line in lines}) == 8
    assert len({line.get_marker() for line in lines}) == 8


def test_likelihood_marks_what_was_chosen() -> None:
    h = [0.1, 0.3, 0.9]
    curves = {"one": (h, [-1.0, 0.0, -0.5]), "other": (h, [-2.0, -1.0, 0.0])}
    artists = plot.likelihood(curves, {"one": (0.3, 0.0), "other": (0.3, -1.0)}, "h", "nats")
    axes = figure_of(artists).axes[0]
    draw(artists)
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    assert {"h", "nats", "0.2", "0.5", *curves} <= set(texts(figure_of(artists)))
    assert labelled(artists, "other").get_xydata().tolist() == [[0.1, -2], [0.3, -1], [0.9, 0]]
    assert artists[1].get_xydata().tolist() == [[0.3, 0.0]]
    assert artists[1].get_color() == artists[0].get_color() != artists[2].get_color()


def test_figures_are_legible_and_leave_global_state_alone() -> None:
    before = dict(mpl.rcParams)
    label = "synthetic climate fitted to six summers of a hindcast, the seventh left out " * 2
    for artists in every_figure(make_forecast(wind_label=label)):
        draw(artists)
        figure = figure_of(artists)
        assert figure.get_figwidth() <= 7.0
        for text in figure.findobj(Text):
            if text.get_text() and text.get_visible():
                assert float(text.get_fontsize()) >= 8.0
                if "synthetic" in text.get_text():
                    box = text.get_window_extent()
                    assert box.x0 >= 0
                    assert box.x1 <= figure.bbox.x1
                    assert box.y1 <= figure.bbox.y1
    assert dict(mpl.rcParams) == before
    assert plt.get_fignums() == []


@pytest.mark.parametrize("label", ["synthetic climate", "Bay of Biscay", ""])
def test_figures_say_that_the_wind_is_synthetic(label: str) -> None:
    forecast = make_forecast(members=4, wind_label=label)
    full, averaged = make_trajectories()
    full.attrs["wind_label"] = label
    for artists in (
        plot.trajectories(forecast),
        plot.roses(forecast),
        plot.wind_rose(forecast),
        plot.stranding_rose(forecast),
        plot.stranding_times(forecast),
        plot.time_series(full, averaged, LinearPath()),
        plot.plane(full, averaged),
    ):
        words = " ".join(texts(figure_of(artists)))
        assert words.count("synthetic") == 1
        assert label in words


def test_figures_do_not_call_a_recorded_wind_synthetic() -> None:
    forecast = make_forecast(wind_label="hindcast", wind_synthetic=0)
    for artists in (plot.trajectories(forecast), plot.roses(forecast)):
        words = " ".join(texts(figure_of(artists)))
        assert "Wind: hindcast" in words
        assert "synthetic" not in words


def test_figures_draw_on_given_axes() -> None:
    figure = Figure()
    axes = figure.add_subplot(1, 2, 1)
    rose = figure.add_subplot(1, 2, 2, projection="windrose")
    forecast = make_forecast()
    for artists in (plot.trajectories(forecast, ax=axes), plot.stranding_times(forecast, ax=axes)):
        assert all(artist.figure is figure for artist in artists)
    assert all(artist.axes is rose for artist in plot.stranding_rose(forecast, ax=rose))
    other = Figure()
    assert all(artist.figure is other for artist in plot.roses(forecast, fig=other))


@pytest.mark.parametrize(
    "forecast",
    [
        pytest.param(make_forecast(stranded=0.0), id="none stranded"),
        pytest.param(make_forecast(stranded=1.0), id="all stranded"),
        pytest.param(make_forecast(members=1, stranded=0.0), id="one member afloat"),
        pytest.param(make_forecast(members=1, stranded=1.0), id="one member stranded"),
        pytest.param(make_forecast(stranded=0.0, coast=None), id="no coast"),
        pytest.param(make_forecast(coast=POLYGONS), id="polygons"),
        pytest.param(
            make_forecast().drop_vars(["position", "wind_velocity", "time", "wind_time"]),
            id="nothing kept",
        ),
    ],
)
def test_edges(forecast: xr.Dataset) -> None:
    for function in (plot.trajectories, plot.roses, plot.stranding_times):
        draw(function(forecast))
    rose: list[Any] = plot.stranding_rose(forecast)
    if (forecast["status"] == 1).any():
        assert heights(rose).sum() == pytest.approx(100 * float(forecast["status"].mean()))
    else:
        assert [note.get_text() for note in rose] == ["no stranding points"]


def test_a_rose_without_wind_says_so() -> None:
    (note,) = plot.wind_rose(make_forecast().drop_vars("wind_velocity"))
    assert isinstance(note, Text)
    assert note.get_text() == "no wind kept\nin this forecast"


def test_other_datasets_are_refused() -> None:
    with pytest.raises(ScenarioError, match="status: not in the dataset"):
        plot.trajectories(make_trajectories()[0])
    with pytest.raises(ScenarioError, match="status: none of 0 members could be followed"):
        plot.stranding_times(make_forecast().isel(member=slice(0)))


def test_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "windrose", None)
    with pytest.raises(DriftCoreError, match=r'windrose.*pip install "driftcore\[plot\]"'):
        plot.roses(make_forecast())
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(DriftCoreError, match=r'matplotlib.*pip install "driftcore\[plot\]"'):
        plot.trajectories(make_forecast())


def test_save_all_writes_print_quality(tmp_path: Path) -> None:
    paths = plot.save_all(make_forecast(), tmp_path / "new" / "folder")
    assert [path.name for path in paths] == FILES
    assert sorted(path.name for path in (tmp_path / "new" / "folder").iterdir()) == sorted(FILES)
    for path in paths:
        assert plt.imread(path).shape[1] == 1400


def test_save_all_draws_each_map(tmp_path: Path) -> None:
    grid = MapGrid(x=(0.5, 1.0, 1.5), y=(0.5, 1.0, 1.5), times=(0.5, 1.0))
    present, nobody = np.array([20, 10, 5, 5, 0, 5, 20, 15]), np.zeros(2, dtype=np.uint32)
    arrived = np.concatenate([present, nobody, nobody])
    forecast = with_maps(make_forecast(), grid, [present, arrived, nobody, nobody])
    paths = plot.save_all(forecast, tmp_path)
    assert [path.name for path in paths] == [*FILES, "presence_1.png", "presence_2.png"]
    first, second = (plt.imread(path) for path in paths[-2:])
    assert first.shape == second.shape
    assert (first != second).any()


def test_save_all_refuses_to_overwrite_and_then_writes_nothing(tmp_path: Path) -> None:
    (tmp_path / "roses.png").write_text("mine")
    with pytest.raises(OutputError, match=r"roses\.png: exists; .*overwrite"):
        plot.save_all(make_forecast(), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["roses.png"]
    assert (tmp_path / "roses.png").read_text() == "mine"
    plot.save_all(make_forecast(), tmp_path, overwrite=True)
    assert plt.imread(tmp_path / "roses.png").shape[1] == 1400


def test_save_all_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "trajectories.png").write_text("old")
    calls = []

    def fail_second(_figure: Figure, target: BytesIO, **_keywords: Any) -> None:
        target.write(b"half")
        calls.append(target)
        if len(calls) == 2:
            raise RuntimeError("no font")

    monkeypatch.setattr(Figure, "savefig", fail_second)
    with pytest.raises(RuntimeError, match="no font"):
        plot.save_all(make_forecast(), tmp_path, overwrite=True)
    assert len(calls) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["trajectories.png"]
    assert (tmp_path / "trajectories.png").read_text() == "old"


def test_save_all_survives_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "trajectories.png").write_text("old")

    def fail_half_way(path: Path, data: bytes) -> int:
        with path.open("wb") as file:
            file.write(data[: len(data) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pathlib.Path, "write_bytes", fail_half_way)
    with pytest.raises(OutputError, match=r"trajectories\.png: .*No space left"):
        plot.save_all(make_forecast(), tmp_path, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["trajectories.png"]
    assert (tmp_path / "trajectories.png").read_text() == "old"


def test_save_all_names_a_folder_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file: cannot be made a folder"):
        plot.save_all(make_forecast(), tmp_path / "file")
