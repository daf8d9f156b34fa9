"""The Python of the guides runs, on files like those that a user brings, with few members."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import driftcore as dc
from driftcore.climate import synthetic_record

GUIDES = Path(__file__).parents[1] / "docs/guide"


def run(
    guide: str, room: dict[str, Any], *names: str, fewer: dict[str, str] | None = None
) -> dict[str, Any]:
    """Run the named blocks of a guide, with smaller numbers where these stand in for its own."""
    text = (GUIDES / guide).read_text("utf-8")
    for number, small in (fewer or {}).items():
        assert number in text, f"{guide}: {number} is no longer there"
        text = text.replace(number, small)
    for name in names:
        found = re.search(rf"<!-- {name} -->\n```python\n(.*?)```\n<!-- end -->", text, re.DOTALL)
        assert found, f"{guide}: no block named {name}"
        exec(found[1], room)  # noqa: S102 (the guide's own lines)
    return room


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    mpl.use("Agg")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_wind(here: Path) -> None:
    table = synthetic_record(6)
    point = xr.Dataset(
        {name: ("valid_time", table[name].to_numpy(), {"units": "m s**-1"}) for name in table},
        {"valid_time": pd.DatetimeIndex(table.index).tz_localize(None).to_numpy()},
    )
    point.to_netcdf(here / "era5_point.nc")
    axes = {"longitude": [-4.5, -4.0], "latitude": [47.0, 46.5]}
    point.expand_dims(axes, axis=(1, 2)).to_netcdf(here / "era5_box.nc")
    speed = np.hypot(table["u10"], table["v10"])
    direction = np.rad2deg(np.arctan2(-table["u10"], -table["v10"])) % 360
    station = pd.DataFrame({"speed": speed, "direction": direction})
    station.rename_axis("time").to_csv(here / "station.csv")

    room = run("wind.md", {}, "point")
    from_point = room["record"].velocity
    assert isinstance(room["wind"], dc.LocalGridBootstrap)
    room = run("wind.md", room, "box", "station")
    summer = from_point[: len(room["record"])]
    np.testing.assert_allclose(room["record"].velocity[: len(summer)], summer, atol=1e-9)


@pytest.mark.usefixtures("here")
def test_tides() -> None:
    atlas = dc.tides.biscay(step=0.25)
    axes = {"latitude": atlas.latitude[7:10], "longitude": atlas.longitude[3:7]}
    amplitude = {"units": "m/s"}
    phase = {"units": "degrees"}
    dims = ("constituent", "latitude", "longitude")
    parts = {}
    for name in "uv":
        z = atlas.dataset[name].sel(axes).values
        lag = -np.rad2deg(np.angle(z)) % 360
        parts |= {f"{name}_amplitude": (dims, np.abs(z), amplitude)}
        parts |= {f"{name}_phase": (dims, lag, phase)}
    xr.Dataset(parts, {"constituent": list(atlas.constituents), **axes}).to_netcdf("atlas.nc")

    # The guide reads a region that the whole atlas covers; here it is what there is.
    read = dc.tides.from_atlas("atlas.nc")
    np.testing.assert_allclose(read.dataset["u"], atlas.dataset["u"].sel(axes), atol=1e-12)

    times = pd.date_range("2023-05-01", "2023-07-20", freq="h").to_numpy()
    current = atlas.velocity(
        times[:, None, None], axes["longitude"][None, None], axes["latitude"][:, None]
    )
    dims = ("time", "latitude", "longitude")
    flow = {name: (dims, current[..., k], amplitude) for k, name in enumerate("uv")}
    xr.Dataset(flow, {"time": times, **axes}).to_netcdf("my_run.nc")
    room = run("tides.md", {"dc": dc}, "fit", "residual")
    assert float(room["found"].explained.min()) > 0.99
    assert float(np.abs(room["current"].u).max()) < 0.01


@pytest.fixture(scope="module")
def container(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Forecast of few members, with maps, as `driftcore run` writes it."""
    example = dc.read_configuration(GUIDES.parents[1] / "examples/container.toml")
    assert isinstance(example, dc.GeographicConfiguration)
    small = example.replace(
        days=21.0,
        maps=example.maps and example.maps.replace(days=(10.0, 20.0)),
        ensemble=example.ensemble.replace(members=40, keep=10),
        wind=example.wind.replace(h=0.3),
    )
    path = tmp_path_factory.mktemp("container") / "out.nc"
    dc.run(small).to_netcdf(path)
    return path


@pytest.fixture
def sea() -> dc.GeographicScenario:
    return dc.GeographicScenario(
        release=dc.Release.point(-4.1, 47.2, "2026-07-01T06:00"),
        days=12,
        drifter=dc.FloatingBody(response_time_h=0, wind_factor=0.03),
        tides=dc.tides.biscay(),
    )


def test_hand_over(here: Path, sea: dc.GeographicScenario) -> None:
    synthetic_record(5).to_csv(here / "wind_1994_2024.csv")
    times = pd.date_range("2026-07-01", periods=33, freq="3h", name="time")
    ahead = pd.DataFrame({"u10": np.linspace(2, 9, 33), "v10": 1.0}, times)
    ahead.to_csv(here / "forecast.csv")
    room = run("hand_over.md", {"scenario": sea}, "hand over", fewer={"members=1000": "members=30"})
    assert room["forecast"].counts["afloat"] == 30
    assert room["wind"].describe()


# clouddrift imports tenacity in a way that it deprecates.
@pytest.mark.filterwarnings("ignore:The 'initial' parameter:DeprecationWarning")
def test_pages_pictures_and_files(here: Path, container: Path) -> None:
    for name in ("out.nc", "container.nc"):
        shutil.copy(container, here / name)
    run("report.md", {}, "report")
    assert "<html" in (here / "container.html").read_text("utf-8")
    room = run("pictures.md", {}, "map", "projected")
    assert (here / "day_20.png").stat().st_size > 10_000
    assert type(room["axes"]).__name__ == "GeoAxes"
    plt.close("all")
    room = run("exports.md", {}, "python")
    dc.export.export(room["forecast"], "tracks.nc", "clouddrift")
    kept = room["forecast"].dataset.sizes["kept_member"]
    tracks = run("exports.md", {}, "clouddrift")
    steps = tracks["tracks"]["rowsize"].values
    assert len(steps) == kept
    assert len(tracks["along"]) == steps.sum()
    tracks["tracks"].close()


def test_long_runs(here: Path) -> None:
    (here / "my.toml").write_text("[ensemble]\nmembers = 20\n[wind]\nh = 0.3\n")
    with pytest.raises(dc.ScenarioError, match=r"configuration: str is not .*read_configuration"):
        dc.run("my.toml")  # type: ignore[arg-type]  # what is refused
    room = run("long_runs.md", {}, "store")
    assert room["forecast"].followed == 20
    room |= {"scenario": dc.paper.scenario(), "wind": dc.paper.default_wind()}
    few = {"members=500": "members=10", "(0, 500)": "(0, 10)"}
    whole = run("long_runs.md", room, "parts", fewer=few)["whole"]
    once = dc.forecast(room["scenario"], room["wind"], members=20).dataset
    xr.testing.assert_equal(whole, once)


@pytest.mark.usefixtures("here")
def test_rare_events_and_two_levels() -> None:
    fewer = {"scenario))": "scenario, particles=20, replicates=5))"}
    fewer |= {"particles=1000": "particles=20, replicates=5"}
    found = run("../rare_events.md", {}, "rare", fewer=fewer)["found"]
    assert 0 <= found.low <= found.estimate <= found.high < 1e-3
    room = {"dc": dc, "scenario": dc.paper.scenario(), "wind": dc.paper.default_wind()}
    fewer = {"(1_000, 200)": "(100, 50)", "precision=0.005": "precision=0.05"}
    p = run("../trust.md", room, "two levels", fewer=fewer)["p"]
    assert p.low < 0.65 < p.high


def test_spill(here: Path) -> None:
    room = run("spill.md", {}, "spill")
    assert room["forecast"].stranding_probability().estimate > 0.2
    assert (here / "day_10.png").stat().st_size > 10_000
