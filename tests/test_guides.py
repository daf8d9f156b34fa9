"""The Python of the guides runs, on files like those that a user brings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import driftcore as dc
from driftcore.climate import synthetic_record

GUIDES = Path(__file__).parents[1] / "docs/guide"


def run(guide: str, room: dict[str, Any], *names: str) -> dict[str, Any]:
    """Run the named blocks of a guide."""
    text = (GUIDES / guide).read_text("utf-8")
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


def test_spill(here: Path) -> None:
    room = run("spill.md", {}, "spill")
    assert room["forecast"].stranding_probability().estimate > 0.2
    assert (here / "day_10.png").stat().st_size > 10_000
