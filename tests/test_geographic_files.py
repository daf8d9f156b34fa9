"""A forecast on the real sea comes back from its file bit by bit, and others can read it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import shapely
import xarray as xr

import driftcore as dc

if TYPE_CHECKING:
    from pathlib import Path

EDGES = {"x": np.linspace(-5, -1, 21), "y": np.linspace(45.5, 48.5, 16)}


@pytest.fixture(scope="module")
def forecast(embedded_wind: dc.LocalGridBootstrap) -> dc.GeographicForecast:
    """Some strand within the run and some do not; half of the paths are kept."""
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-4.1, 47.2, "2026-07-01T06:00", radius_m=1000, time_error_h=2.0),
        days=20,
        drifter=dc.FloatingBody(response_time_h=6.0, wind_factor=0.03),
        tides=dc.tides.biscay(step=0.25),
        coast=dc.LandCoast.from_geometries(shapely.box(-3, 46, -1, 48), label="a box"),
    )
    made = dc.forecast(
        scenario,
        embedded_wind,
        members=40,
        keep=20,
        maps=dc.MapGrid(**EDGES, times=(5, 10, 20)),
        targets={"near": [[-3.9, 47], [-3.6, 47], [-3.6, 47.4], [-3.9, 47.4]]},
    )
    assert isinstance(made, dc.GeographicForecast)
    return made


@pytest.fixture
def file(forecast: dc.GeographicForecast, tmp_path: Path) -> Path:
    path = tmp_path / "forecast.nc"
    forecast.to_netcdf(path)
    return path


def assert_same_bits(one: xr.Dataset, other: xr.Dataset) -> None:
    xr.testing.assert_identical(one, other)
    for name, variable in one.variables.items():
        assert variable.dtype == other[name].dtype, name
        assert variable.values.tobytes() == other[name].values.tobytes(), name


def test_it_comes_back_bit_by_bit(forecast: dc.GeographicForecast, file: Path) -> None:
    back = dc.open_forecast(file)
    assert isinstance(back, dc.GeographicForecast)
    assert 0 < back.counts["stranded"] < 40
    assert_same_bits(forecast.dataset, back.dataset)
    day = np.datetime64("2026-07-15")
    assert back.stranding_probability(by=day) == forecast.stranding_probability(by=day)
    assert back.entry_probability("near", by=day) == forecast.entry_probability("near", by=day)


def test_what_was_read_is_written_again(file: Path, tmp_path: Path) -> None:
    back = dc.open_forecast(file)
    back.to_netcdf(tmp_path / "again.nc")
    assert_same_bits(back.dataset, dc.open_forecast(tmp_path / "again.nc").dataset)


def test_never_is_nat(forecast: dc.GeographicForecast, file: Path) -> None:
    back = dc.open_forecast(file).dataset
    afloat = back["status"].values != 1
    assert afloat.any()
    np.testing.assert_array_equal(np.isnat(back["stranding_time"].values), afloat)
    times = forecast.dataset["entry_time"].values
    assert np.isnat(times).any()
    assert not np.isnat(times).all()


def test_plain_xarray_reads_times_and_places(forecast: dc.GeographicForecast, file: Path) -> None:
    with xr.open_dataset(file) as plain:
        made = forecast.dataset
        for name in ("time", "map_time", "map_time_bounds", "stranding_time", "release_time"):
            np.testing.assert_array_equal(plain[name].values, made[name].values)
            assert plain[name].dtype.kind == "M"
        assert plain["presence"].dims == ("map_time", "map_latitude", "map_longitude")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("time", {"standard_name": "time", "units": "seconds since 2026-07-01 00:00:00"}),
        ("map_time", {"standard_name": "time", "bounds": "map_time_bounds", "axis": "T"}),
        ("stranding_time", {"calendar": "proleptic_gregorian", "long_name": "time of stranding"}),
        ("map_longitude", {"standard_name": "longitude", "units": "degrees_east", "axis": "X"}),
        ("map_latitude", {"units": "degrees_north", "bounds": "map_latitude_bounds"}),
        ("presence", {"grid_mapping": "crs", "units": "1"}),
        ("crs", {"grid_mapping_name": "latitude_longitude", "semi_major_axis": 6378137.0}),
    ],
)
def test_metadata_follow_the_cf_conventions(
    file: Path, name: str, expected: dict[str, Any]
) -> None:
    with xr.open_dataset(file, decode_cf=False) as raw:
        attributes = raw[name].attrs
        assert {key: attributes[key] for key in expected} == expected


def test_cells_and_intervals_are_bounded(forecast: dc.GeographicForecast) -> None:
    dataset = forecast.dataset
    for name, edges in (("map_longitude", EDGES["x"]), ("map_latitude", EDGES["y"])):
        bounds = dataset[f"{name}_bounds"].values
        np.testing.assert_allclose(bounds, np.stack([edges[:-1], edges[1:]], axis=1))
        np.testing.assert_allclose(dataset[name].values, bounds.mean(axis=1))
    start = np.datetime64(dataset.attrs["start"])
    days = (dataset["map_time_bounds"].values - start) / np.timedelta64(1, "D")
    np.testing.assert_array_equal(days, [[0, 5], [5, 10], [10, 20]])


def test_a_time_keeps_its_nanoseconds(forecast: dc.GeographicForecast, tmp_path: Path) -> None:
    odd = forecast.dataset.copy(deep=True)
    odd["stranding_time"].values[0] = np.datetime64("2026-07-03T04:05:06.123456789", "ns")
    dc.GeographicForecast(odd).to_netcdf(tmp_path / "odd.nc")
    assert_same_bits(odd, dc.open_forecast(tmp_path / "odd.nc").dataset)


def test_nothing_happened_comes_back_too(forecast: dc.GeographicForecast, tmp_path: Path) -> None:
    calm = forecast.dataset.copy(deep=True)
    calm["stranding_time"].values[:] = np.datetime64("NaT")
    dc.GeographicForecast(calm).to_netcdf(tmp_path / "calm.nc")
    assert_same_bits(calm, dc.open_forecast(tmp_path / "calm.nc").dataset)


def test_a_file_without_places_is_refused(forecast: dc.GeographicForecast, tmp_path: Path) -> None:
    part = forecast.dataset.drop_vars("stranding_time")
    dc.GeographicForecast(part).to_netcdf(tmp_path / "part.nc")
    with pytest.raises(dc.OutputError, match=r"not a driftcore forecast \(no stranding_time\)"):
        dc.open_forecast(tmp_path / "part.nc")
