"""Films show each time of a forecast, say which it is, and are written whole or not at all."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import driftcore as dc
from driftcore import animation

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def plane(small_wind: dc.LocalGridBootstrap) -> dc.Forecast:
    grid = tuple(np.linspace(0.65, 1.35, 15))
    maps = dc.MapGrid(x=grid, y=grid, times=(0.25, 0.5, 1.0))
    times = np.linspace(0, 1, 9)
    return dc.forecast(dc.paper.scenario(), small_wind, members=40, keep=30, maps=maps, times=times)


@pytest.fixture(scope="module")
def sea(small_wind: dc.LocalGridBootstrap) -> dc.Forecast:
    shapely = pytest.importorskip("shapely")
    land = shapely.box(-2.0, 44.0, 0.0, 49.0)
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-3, 46.7, "2026-07-01T06:00", radius_m=1000),
        days=10,
        drifter=dc.FloatingBody(response_time_h=1.0, wind_factor=0.03),
        coast=dc.LandCoast.from_geometries(land, label="straight"),
        name="a crate",
    )
    times = np.datetime64("2026-07-01T06:00", "ns") + np.arange(11) * np.timedelta64(1, "D")
    return dc.forecast(scenario, small_wind, members=30, times=times)


def animate(forecast: dc.Forecast, **given: Any) -> Any:
    """Make an animation that may go without having been shown as a whole."""
    moving: Any = animation.animate(forecast, **given)
    moving._draw_was_started = True
    return moving


def frame(moving: Any, index: int) -> Any:
    """Draw a frame; give its axes."""
    artists = moving._func(index)
    return artists[0].axes


def points(axes: Any, label: str) -> Any:
    (line,) = [line for line in axes.lines if line.get_label() == label]
    return line.get_xydata()


def test_members_are_where_they_are_at_each_time(plane: dc.Forecast) -> None:
    dataset = plane.dataset
    kept = dataset["position"].values
    moving = animate(plane, kind="members")
    for index, time in enumerate(dataset["time"].values):
        axes = frame(moving, index)
        stranded = dataset["stranding_time"].values[:30] <= time
        np.testing.assert_allclose(points(axes, "adrift"), kept[~stranded, index])
        if stranded.any():
            np.testing.assert_allclose(
                points(axes, "stranded"), dataset["stranding_position"].values[:30][stranded]
            )
        assert f"time {time:.3f}, {26.04 * time:.1f} days" in axes.get_title()
        assert f"{100 * stranded.mean():.1f} % of 30 members ashore" in axes.get_title()
    assert stranded.any()


def test_maps_have_one_scale(plane: dc.Forecast) -> None:
    moving = animate(plane)
    first, last = (moving._func(k)[0] for k in (0, 2))
    assert first.norm is last.norm
    presence = 100 * plane.dataset["presence"].values
    assert last.norm.vmax == pytest.approx(presence.max())
    np.testing.assert_allclose(last.get_array().filled(0.0), presence[2])
    assert "time 1, 26.0 days" in last.axes.get_title()
    # What was drawn before is gone.
    assert [m for m in last.axes.collections if m is first] == []


def test_frames_say_the_date_and_are_no_more_than_asked(sea: dc.Forecast) -> None:
    moving = animate(sea, frames=3)
    assert list(moving.new_frame_seq()) == [0, 5, 10]
    axes = frame(moving, 5)
    assert "a crate, 2026-07-06 06:00 UTC, 5.0 days" in axes.get_title()


@pytest.mark.parametrize("suffix", [".gif", ".mp4"])
def test_a_film_is_written(plane: dc.Forecast, tmp_path: Path, suffix: str) -> None:
    told: list[tuple[int, int]] = []
    path = animation.save(
        plane, tmp_path / f"film{suffix}", frames=2, progress=lambda *now: told.append(now)
    )
    start = path.read_bytes()[:12]
    assert start[:6] == b"GIF89a" if suffix == ".gif" else start[4:8] == b"ftyp"
    assert told == [(1, 2), (2, 2)]
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(dc.OutputError, match="exists"):
        animation.save(plane, path, frames=2)


def test_a_film_that_fails_leaves_nothing(
    plane: dc.Forecast, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matplotlib.animation import PillowWriter

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(PillowWriter, "finish", full)
    with pytest.raises(dc.OutputError, match="No space left"):
        animation.save(plane, tmp_path / "film.gif", frames=2)
    assert list(tmp_path.iterdir()) == []


def test_without_ffmpeg_the_error_says_what_to_install(
    plane: dc.Forecast, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.which", lambda _: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(dc.DriftCoreError, match=r'pip install "driftcore\[animation\]"'):
        animation.save(plane, tmp_path / "film.mp4")


def test_the_ffmpeg_of_a_package_serves(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.setattr("shutil.which", lambda _: None)
    binary = animation._writer(".mp4", 10).bin_path()
    assert subprocess.run([binary, "-version"], capture_output=True, check=True).stdout  # noqa: S603


def test_the_ffmpeg_of_the_system_goes_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda name: f"/somewhere/{name}")
    assert animation._writer(".mp4", 10).bin_path() == "/somewhere/ffmpeg"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"fps": 0}, "fps: 0 is not accepted"),
        ({"frames": 0}, "frames: 0 is not accepted"),
        ({"kind": "film"}, "kind: 'film' is not accepted"),
        ({"coast": "a coast"}, "coast: is not accepted in the paper's plane, whose forecast"),
        ({"coast": "a coast", "kind": "members"}, "coast: is not accepted in the paper's plane"),
    ],
)
def test_what_is_refused(plane: dc.Forecast, given: dict[str, Any], message: str) -> None:
    with pytest.raises(dc.ScenarioError, match=message):
        animation.animate(plane, **given)


def test_refused_files(plane: dc.Forecast, sea: dc.Forecast, tmp_path: Path) -> None:
    with pytest.raises(dc.ScenarioError, match=r"path: .*film.avi' is not accepted"):
        animation.save(plane, tmp_path / "film.avi")
    with pytest.raises(dc.ScenarioError, match=r"kind: .* has none \(`\[maps\]`"):
        animation.animate(sea, kind="maps")
    none = plane.dataset.isel(kept_member=slice(0))
    with pytest.raises(dc.ScenarioError, match="no paths were kept"):
        animation.animate(none, kind="members")
