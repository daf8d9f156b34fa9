"""What other programs are given holds what the forecast does, in the form that they expect."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import driftcore as dc
from driftcore import export
from driftcore.html import table

shapely = pytest.importorskip("shapely")


@pytest.fixture(scope="module")
def sea(small_wind: dc.LocalGridBootstrap) -> dc.GeographicForecast:
    """Some strand within the run and some do not; half of them are kept; released in a window."""
    land = shapely.box(-2.0, 44.0, 0.0, 49.0)
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-3, 46.7, ("2026-07-01T06:00", "2026-07-02T06:00"), 1000),
        days=12,
        drifter=dc.FloatingBody(response_time_h=1.0, wind_factor=0.03),
        coast=dc.LandCoast.from_geometries(land, label="straight"),
        name="a <crate>",
    )
    made = dc.forecast(
        scenario,
        small_wind,
        members=40,
        keep=20,
        maps=dc.MapGrid(x=np.linspace(-5, -1, 21), y=np.linspace(44.5, 48.5, 21), times=(5, 10)),
        targets={"gate": [[-2.6, 46], [-2.4, 46], [-2.4, 47], [-2.6, 47]]},
    )
    assert isinstance(made, dc.GeographicForecast)
    assert 0 < (made.dataset["status"].values[:20] == 1).sum() < 20
    return made


@pytest.fixture(scope="module")
def plane(small_wind: dc.LocalGridBootstrap) -> dc.Forecast:
    return dc.forecast(dc.paper.scenario(), small_wind, members=30, keep=5)


@pytest.fixture(params=["opendrift", "clouddrift"])
def of_others(request: pytest.FixtureRequest) -> Any:
    return request.param


def test_a_row_for_each_member(sea: dc.GeographicForecast, plane: dc.Forecast) -> None:
    rows = sea.to_dataframe()
    dataset = sea.dataset
    assert rows.index.name == "member"
    assert rows["status"].value_counts().to_dict() == sea.counts
    stranded = rows[rows["status"] == "stranded"]
    np.testing.assert_array_equal(
        stranded["stranding_time"], dataset["stranding_time"].values[sea.stranded]
    )
    assert rows["stranding_longitude"].notna().sum() == len(stranded)
    entered = rows["entry_gate"].notna().mean()
    assert entered == pytest.approx(sea.entry_probability("gate").estimate)
    rows = plane.to_dataframe()
    np.testing.assert_array_equal(
        rows[["stranding_x", "stranding_y"]], plane.dataset["stranding_position"]
    )


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_tables_come_back(sea: dc.GeographicForecast, tmp_path: Path, suffix: str) -> None:
    path = export.export(sea, tmp_path / f"members.{suffix}")
    if suffix == "csv":
        back = pd.read_csv(path, index_col="member", parse_dates=["stranding_time"])
        expected = sea.to_dataframe()["stranding_time"].dt.floor("s").dt.tz_localize("UTC")
        assert (back["stranding_time"].dropna() == expected.dropna()).all()
        assert back["status"].tolist() == sea.to_dataframe()["status"].tolist()
    else:
        pytest.importorskip("pyarrow")
        pd.testing.assert_frame_equal(pd.read_parquet(path), sea.to_dataframe())


def test_strandings_as_geojson(sea: dc.GeographicForecast, tmp_path: Path) -> None:
    path = export.export(sea, tmp_path / "strandings.geojson")
    features = json.loads(path.read_text(encoding="utf-8"))["features"]
    dataset = sea.dataset.isel(member=np.flatnonzero(sea.stranded))
    places = [feature["geometry"]["coordinates"] for feature in features]
    np.testing.assert_allclose(np.array(places)[:, 0], dataset["stranding_longitude"])
    np.testing.assert_allclose(np.array(places)[:, 1], dataset["stranding_latitude"])
    told = [feature["properties"] for feature in features]
    assert [one["member"] for one in told] == dataset["member"].values.tolist()
    days = (dataset["stranding_time"] - dataset["release_time"]) / np.timedelta64(1, "D")
    np.testing.assert_allclose([one["days"] for one in told], days)
    for one, time in zip(told, dataset["stranding_time"].values, strict=True):
        assert abs(np.datetime64(one["time"]) - time) <= np.timedelta64(1, "ms")
    with pytest.raises(dc.OutputError, match="exists"):
        export.export(sea, path)


def test_layers_of_a_geopackage(sea: dc.GeographicForecast, tmp_path: Path) -> None:
    pyogrio = pytest.importorskip("pyogrio")
    path = export.export(sea, tmp_path / "forecast.gpkg")
    assert list(tmp_path.iterdir()) == [path]
    layers = dict(pyogrio.list_layers(path))
    assert layers == {
        "strandings": "Point",
        "trajectories": "MultiLineString",
        "presence": "Polygon",
    }
    read: Any = {}
    for name in layers:
        meta, _, wkb, values = pyogrio.raw.read(path, layer=name)
        assert meta["crs"] == "EPSG:4326"
        read[name] = shapely.from_wkb(wkb), dict(zip(meta["fields"], values, strict=True))
    lines, told = read["trajectories"]
    assert told["member"].tolist() == list(range(20))
    for member, line in enumerate(lines):
        path_kept = sea.dataset["longitude"].values[member]
        expected = path_kept[np.isfinite(path_kept)]
        if told["status"][member] == "stranded":
            expected = np.append(expected, sea.dataset["stranding_longitude"].values[member])
        np.testing.assert_allclose(shapely.get_coordinates(line)[:, 0], expected)
    cells, told = read["presence"]
    presence = sea.dataset["presence"].values
    assert told["probability"].sum() == pytest.approx(presence.sum())
    assert shapely.area(cells) == pytest.approx(np.full((presence > 0).sum(), 0.2**2))


def test_lines_are_cut_at_the_dateline(sea: dc.GeographicForecast) -> None:
    dataset = sea.dataset.copy(deep=True)
    for name in ("longitude", "stranding_longitude"):
        dataset[name].values[:] = (dataset[name].values + 183 + 180) % 360 - 180
    before = export.trajectories(sea).geometries
    after = export.trajectories(dataset).geometries
    assert max(shapely.get_num_geometries(after)) > 1
    assert np.abs(shapely.bounds(after)).max() <= 180
    parts = shapely.get_parts(after)
    assert (shapely.bounds(parts)[:, 2] - shapely.bounds(parts)[:, 0]).max() < 10
    np.testing.assert_allclose(shapely.length(after), shapely.length(before))


def test_opendrifts_form(sea: dc.GeographicForecast, tmp_path: Path) -> None:
    path = export.export(sea, tmp_path / "od.nc", "opendrift")
    with xr.open_dataset(path, engine="h5netcdf", mask_and_scale=False) as made:
        made.load()
    assert dict(made.sizes) == {"trajectory": 20, "time": sea.dataset.sizes["time"]}
    assert made["lon"].dims == made["status"].dims == ("trajectory", "time")
    assert made["trajectory"].attrs["cf_role"] == "trajectory_id"
    assert made["trajectory"].values.tolist() == list(range(1, 21))
    assert made["status"].attrs["flag_meanings"].split() == ["active", "stranded"]
    assert made.attrs["featureType"] == "trajectory"
    assert made.attrs["time_step_output"] == "3:00:00"
    with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as raw:
        assert raw["time"].attrs["units"] == "seconds since 1970-01-01 00:00:00"
    status, adrift = made["status"].values, np.isfinite(made["lon"].values)
    times = made["time"].values
    for member in range(20):
        fate = sea.dataset.isel(member=member)
        now = np.flatnonzero(adrift[member])
        assert (np.diff(now) == 1).all()
        assert times[now[0]] >= fate["release_time"].values
        assert status[member, now[:-1]].tolist() == [0] * (len(now) - 1)
        if int(fate["status"]) == 1:
            assert status[member, now[-1]] == 1
            assert times[now[-1] - 1] < fate["stranding_time"].values <= times[now[-1]]
            np.testing.assert_allclose(
                made["lat"].values[member, now[-1]], fate["stranding_latitude"], rtol=1e-6
            )
        else:
            assert status[member, now[-1]] == 0
            assert now[-1] == len(times) - 1


def test_clouddrift_reads_ragged_arrays(sea: dc.GeographicForecast, tmp_path: Path) -> None:
    clouddrift = pytest.importorskip("clouddrift")
    path = export.export(sea, tmp_path / "cd.nc", "clouddrift")
    ragged = clouddrift.RaggedArray.from_netcdf(str(path), "traj", "obs")
    assert set(ragged.metadata) == {"rowsize", "status"}
    assert set(ragged.data) == {"lon", "lat"}
    with xr.open_dataset(path, engine="h5netcdf") as made:
        made.load()
    assert made["rowsize"].attrs["sample_dimension"] == "obs"
    assert int(made["rowsize"].sum()) == made.sizes["obs"]
    paths = clouddrift.ragged.unpack(made["lon"], made["rowsize"])
    times = clouddrift.ragged.unpack(made["time"], made["rowsize"])
    for member in range(20):
        kept = sea.dataset["longitude"].values[member]
        kept = kept[np.isfinite(kept)]
        np.testing.assert_array_equal(paths[member][: len(kept)], kept)
        fate = sea.dataset.isel(member=member)
        if int(fate["status"]) == 1:
            assert float(paths[member][-1]) == float(fate["stranding_longitude"])
            gap = times[member].values[-1] - fate["stranding_time"].values
            assert abs(gap) < np.timedelta64(1, "us")


@pytest.mark.parametrize(
    ("name", "form", "message"),
    [
        ("a.shp", None, "path: .*a.shp' is not accepted; .* .gpkg"),
        ("a.nc", None, "format: is missing for .nc"),
        ("a.nc", "csv", "format: 'csv' is not accepted for .nc"),
        ("a.csv", "opendrift", "format: 'opendrift' is not accepted for .csv"),
    ],
)
def test_refused_names(
    sea: dc.GeographicForecast, tmp_path: Path, name: str, form: Any, message: str
) -> None:
    with pytest.raises(dc.ScenarioError, match=message):
        export.export(sea, tmp_path / name, form)


def test_the_plane_has_no_map_layers(plane: dc.Forecast, tmp_path: Path, of_others: Any) -> None:
    for name, form in (("a.geojson", None), ("a.nc", of_others)):
        with pytest.raises(dc.ScenarioError, match="the paper's plane"):
            export.export(plane, tmp_path / name, form)
    assert list(tmp_path.iterdir()) == []


def test_without_paths_there_is_nothing_to_give(
    sea: dc.GeographicForecast, tmp_path: Path, of_others: Any
) -> None:
    none = sea.dataset.isel(kept_member=slice(0))
    with pytest.raises(dc.ScenarioError, match="no paths were kept"):
        export.export(none, tmp_path / "a.nc", of_others)


def test_without_maps_there_are_no_cells(sea: dc.GeographicForecast) -> None:
    with pytest.raises(dc.ScenarioError, match="presence: not in the dataset, accepted is a fore"):
        export.presence_cells(sea.dataset.drop_vars("presence"))


def test_what_gdal_cannot_write_is_told(sea: dc.GeographicForecast, tmp_path: Path) -> None:
    """A driver that this GDAL lacks; no file is left."""
    layers = [export.presence_cells(sea)]
    with pytest.raises(dc.OutputError, match=r"cells\.gpkg: cannot be written: .*no such driver"):
        export._write_layers(layers, tmp_path / "cells.gpkg", "no such driver", False)
    assert list(tmp_path.iterdir()) == []


def test_parquet_says_what_to_install(
    sea: dc.GeographicForecast, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(dc.DriftCoreError, match=r'pip install "driftcore\[parquet\]"'):
        export._write_parquet(sea.to_dataframe(), tmp_path / "a.parquet", False)


def test_the_accessor_says_what_the_forecast_does(
    sea: dc.GeographicForecast, plane: dc.Forecast
) -> None:
    for forecast in (sea, plane):
        accessor = forecast.dataset.driftcore
        assert accessor.stranding_probability() == forecast.stranding_probability()
        assert accessor.counts == forecast.counts
        pd.testing.assert_frame_equal(accessor.to_dataframe(), forecast.to_dataframe())
        assert "stranding_probability" in dir(accessor)
        drawn = accessor.plot.running_estimate(checkpoints=[10])
        assert drawn[0].axes.get_xlabel() == "members"
        assert "running_estimate" in dir(accessor.plot)
        # What notebooks ask any object for, which must not cost a forecast.
        assert not hasattr(accessor, "_repr_png_")
        with pytest.raises(AttributeError, match="no figure 'pie'"):
            _ = accessor.plot.pie
    assert "arrival_curve" in dir(sea.dataset.driftcore.plot)
    with pytest.raises(dc.ScenarioError, match="it holds no status"):
        _ = xr.Dataset().driftcore.forecast


def test_the_accessor_is_there_when_asked_and_costs_nothing_before() -> None:
    lines = [
        "import sys, driftcore",
        "assert 'xarray' not in sys.modules and 'matplotlib' not in sys.modules",
        "import driftcore.accessor, xarray",
        "assert xarray.Dataset.driftcore",
    ]
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True)  # noqa: S603


def test_notebooks_show_small_escaped_tables(
    sea: dc.GeographicForecast, plane: dc.Forecast
) -> None:
    shown = sea._repr_html_()
    assert "a &lt;crate&gt;" in shown
    assert "<crate>" not in shown
    assert str(sea.stranding_probability()) in shown
    assert "enters gate" in shown
    assert "12 days from 2026-07-01 06:00 UTC" in shown
    assert "color" not in shown
    shown = plane._repr_html_()
    assert "26.0 days" in shown
    assert "synthetic" in shown
    assert shown == plane.dataset.driftcore._repr_html_()
    assert "epsilon 0.02" in dc.paper.scenario()._repr_html_()
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-3, 46.7, "2026-07-01T06:00"),
        days=5,
        drifter=dc.FloatingBody(response_time_h=1.0, wind_factor=0.03),
        name="<i>",
    )
    shown = scenario._repr_html_()
    assert "&lt;i&gt;" in shown
    assert "wind_factor = 0.03</td>" in shown
    assert table("t", [("n", "x" * 500)]).count("x") < 130
