"""Grids of currents and winds: what is found in files of the common makes, and what is refused."""

import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import driftcore as dc
from driftcore import RecordError
from driftcore.grids import Kind, VectorGrid, read_vector_grid, read_wind_grid

REAL = Path(__file__).parents[2] / "shared/data/grid"

LON = np.arange(-6.0, 4.0, 0.5)
LAT = np.arange(44.0, 49.0, 0.25)
TIMES = pd.date_range("2020-06-01", periods=9, freq="6h")


def truth(
    longitude: np.ndarray[Any, Any] = LON, latitude: np.ndarray[Any, Any] = LAT, scale: float = 1.0
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """A velocity that tells every place and time apart, (nt, ny, nx)."""
    t = np.arange(len(TIMES))[:, None, None]
    # The same however the meridian is written.
    angle = np.deg2rad(longitude)
    u = np.sin(angle) + 0.1 * t + 0.01 * latitude[:, None]
    v = np.cos(angle) - 0.2 * t + 0.02 * latitude[:, None]
    return scale * u, scale * v


def era5() -> xr.Dataset:
    """As the Climate Data Store writes it: from north to south, 0 to 360, packed."""
    longitude, latitude = LON[LON >= 0], LAT[::-1]
    longitude = np.concatenate([longitude, LON[LON < 0] + 360])
    u, v = truth(longitude, latitude)
    dims = ("valid_time", "latitude", "longitude")
    attrs = {"units": "m s**-1"}
    return xr.Dataset(
        {
            "u10": (dims, u, attrs | {"long_name": "10 metre U wind component"}),
            "v10": (dims, v, attrs | {"long_name": "10 metre V wind component"}),
        },
        {
            "valid_time": ("valid_time", TIMES, {"standard_name": "time"}),
            "latitude": ("latitude", latitude, {"units": "degrees_north"}),
            "longitude": ("longitude", longitude, {"units": "degrees_east"}),
            "number": 0,
        },
    )


def cmems() -> xr.Dataset:
    """As the Copernicus Marine Service writes it: several depths, standard names, fill values."""
    u, v = truth()
    land = (LON > 2) & (LAT[:, None] < 46)
    u[:, land] = v[:, land] = np.nan
    depth = np.array([0.494, 1.541, 25.2])
    dims = ("time", "depth", "latitude", "longitude")
    slower = np.exp(-depth / 50)[:, None, None]
    return xr.Dataset(
        {
            name: (
                dims,
                values[:, None] * slower,
                {"standard_name": f"{toward}_sea_water_velocity", "units": "m s-1"},
            )
            for name, toward, values in (("uo", "eastward", u), ("vo", "northward", v))
        },
        {
            "time": ("time", TIMES),
            "depth": ("depth", depth, {"units": "m", "positive": "down", "axis": "Z"}),
            "latitude": ("latitude", LAT, {"standard_name": "latitude"}),
            "longitude": ("longitude", LON, {"standard_name": "longitude"}),
        },
    )


def hycom() -> xr.Dataset:
    """As HYCOM's servers write it: names of its own, cm/s in some."""
    u, v = truth(scale=100)
    return xr.Dataset(
        {
            "water_u": (("time", "lat", "lon"), u, {"units": "cm/s"}),
            "water_v": (("time", "lat", "lon"), v, {"units": "cm/s"}),
        },
        {"time": TIMES, "lat": LAT, "lon": LON},
    )


PACKED = {
    name: {"dtype": "int16", "scale_factor": 2e-4, "add_offset": 0.5, "_FillValue": -32768}
    for name in ("u10", "v10")
}


def written(folder: Path, dataset: xr.Dataset, **how: Any) -> Path:
    path = folder / "file.nc"
    dataset.to_netcdf(path, **({"engine": "h5netcdf"} | how))
    return path


def same(grid: VectorGrid, atol: float = 1e-9) -> None:
    u, v = truth()
    np.testing.assert_array_equal(grid.times, TIMES.to_numpy().astype("datetime64[ns]"))
    np.testing.assert_allclose(grid.longitude, LON, atol=1e-9)
    np.testing.assert_allclose(grid.latitude, LAT, atol=1e-9)
    known = ~np.isnan(grid.u)
    np.testing.assert_allclose(grid.u[known], u[known], atol=atol)
    np.testing.assert_allclose(grid.v[known], v[known], atol=atol)


# What is read


def test_era5(tmp_path: Path) -> None:
    """A packed value is off by half a step of packing."""
    grid = read_wind_grid(written(tmp_path, era5(), encoding=PACKED))
    same(grid, atol=1.01e-4)
    assert grid.step_h == 6
    assert not grid.missing.any()
    assert grid.source == str(tmp_path / "file.nc")


@pytest.mark.parametrize(("index", "size"), [(0, 0), (1, 2**64 - 16)])
def test_a_heap_without_end_is_refused(tmp_path: Path, index: int, size: int) -> None:
    """HDF5 would step through it by 0 bytes, for ever."""
    path = written(tmp_path, era5())
    read_wind_grid(path)
    data = path.read_bytes()
    first = data.index(b"GCOL") + 16
    damaged = struct.pack("<H6xQ", index, size)
    path.write_bytes(data[:first] + damaged + data[first + len(damaged) :])
    with pytest.raises(RecordError, match="is damaged: a heap in it has no end"):
        read_wind_grid(path)
    with pytest.raises(dc.OutputError, match=r"cannot be read .* a heap in it has no end"):
        dc.open_forecast(path)


@pytest.mark.parametrize("kind", ["NETCDF3_CLASSIC", "NETCDF3_64BIT"])
def test_netcdf_3(tmp_path: Path, kind: str) -> None:
    path = written(tmp_path, era5().drop_vars("number"), engine="scipy", format=kind)
    same(read_vector_grid(path, "wind"))


def test_cmems(tmp_path: Path) -> None:
    grid = read_vector_grid(written(tmp_path, cmems()), "current")
    factor = np.exp(-0.494 / 50)
    u, _ = truth()
    sea = ~grid.missing
    np.testing.assert_allclose(grid.u[:, sea], factor * u[:, sea])
    assert grid.missing.sum() == 8 * 3
    assert any("depth = 0.494 m of 3" in note for note in grid.notes)
    deep = read_vector_grid(cmems(), "current", depth=20)
    assert np.nanmax(deep.u) < np.nanmax(grid.u)


def test_hycom() -> None:
    grid = read_vector_grid(hycom(), "current")
    same(grid)
    assert "converted from cm/s to m/s" in grid.describe()


def test_one_component_missing_is_both() -> None:
    dataset = hycom()
    dataset["water_u"][0, 0, 0] = np.nan
    grid = read_vector_grid(dataset, "current")
    assert np.isnan(grid.v[0, 0, 0])
    assert not grid.missing.any()


def test_knots_and_stated_units() -> None:
    dataset = hycom()
    for name in dataset.data_vars:
        dataset[name].attrs = {}
    with pytest.raises(RecordError, match=r"units: 'water_u' of dataset states none.*units='m/s'"):
        read_vector_grid(dataset, "current")
    same(read_vector_grid(dataset, "current", units="cm/s"))
    for name in dataset.data_vars:
        dataset[name] = dataset[name] / 100 * 3600 / 1852
        dataset[name].attrs["long_name"] = "speed (kt)"
    same(read_vector_grid(dataset, "current"))


def test_units_above_those_stated() -> None:
    dataset = hycom() / 100
    for name in dataset.data_vars:
        dataset[name].attrs["units"] = "cm/s"
    grid = read_vector_grid(dataset, "current", units="m/s")
    same(grid)
    assert "though water_u states 'cm/s'" in grid.describe()


def test_one_time_without_dimension() -> None:
    grid = read_vector_grid(hycom().isel(time=3), "current")
    assert grid.times.tolist() == [TIMES[3].value]
    assert grid.u.shape == (1, len(LAT), len(LON))
    assert grid.step_h is None


def test_dimensions_in_another_order() -> None:
    same(read_vector_grid(hycom().transpose("lon", "time", "lat"), "current"))


def test_a_dimension_of_one() -> None:
    """Such as the number of the only member of an ensemble."""
    same(read_vector_grid(hycom().expand_dims(member=1, axis=1), "current"))


def test_names_given() -> None:
    dataset = hycom().rename(water_u="a", water_v="b")
    with pytest.raises(RecordError, match="no current is found among 'a', 'b'"):
        read_vector_grid(dataset, "current")
    same(read_vector_grid(dataset, "current", names=("a", "b")))
    with pytest.raises(RecordError, match=r"names: \('a', 'c'\) is not accepted"):
        read_vector_grid(dataset, "current", names=("a", "c"))


def test_wind_and_current_in_one_file() -> None:
    """`u` of a wind is not taken for a current."""
    dataset = hycom().rename(water_u="u", water_v="v")
    dataset["u"].attrs["standard_name"] = "eastward_wind"
    dataset["v"].attrs["standard_name"] = "northward_wind"
    assert read_vector_grid(dataset, "wind").kind == "wind"
    with pytest.raises(RecordError, match="no current is found"):
        read_vector_grid(dataset, "current")


def test_one_of_two_standard_names() -> None:
    dataset = cmems()
    dataset = dataset.assign(utotal=2 * dataset["uo"], vtotal=2 * dataset["vo"])
    for name, of in (("utotal", "uo"), ("vtotal", "vo")):
        dataset[name].attrs = dataset[of].attrs
    alias = read_vector_grid(dataset, "current")
    other = read_vector_grid(dataset, "current", names=("utotal", "vtotal"))
    np.testing.assert_allclose(other.u, 2 * alias.u)
    with pytest.raises(RecordError, match="all have the standard names"):
        read_vector_grid(dataset.rename(uo="here", vo="there"), "current")


# Axes


@pytest.mark.parametrize("shift", [0, 360, -360])
def test_longitudes_are_continuous(shift: int) -> None:
    dataset = hycom().assign_coords(lon=LON + shift)
    same(read_vector_grid(dataset, "current"))
    same(read_vector_grid(dataset.isel(lon=slice(None, None, -1)), "current"))


def test_across_the_date_line() -> None:
    dataset = hycom().assign_coords(lon=(LON + 180 + 180) % 360 - 180)
    grid = read_vector_grid(dataset, "current")
    np.testing.assert_allclose(grid.longitude, LON + 180)
    cut = read_vector_grid(dataset, "current", region=(179, 45, -179, 46))
    np.testing.assert_allclose(cut.longitude, np.arange(179, 181.1, 0.5))


def whole_earth(longitude: np.ndarray[Any, Any]) -> xr.Dataset:
    u, v = truth(longitude)
    dims = ("time", "lat", "lon")
    return xr.Dataset(
        {"u": (dims, u, {"units": "m/s"}), "v": (dims, v, {"units": "m/s"})},
        {"time": TIMES, "lat": LAT, "lon": longitude},
    )


@pytest.mark.parametrize(
    "longitude", [np.arange(0, 360, 0.5), np.arange(-180, 180.5, 0.5), np.arange(0, 361, 1.0)]
)
@pytest.mark.parametrize("region", [(-3, 45, 2, 47), (357, 45, 2, 47), (-183, 45, -178, 47)])
def test_region_of_the_whole_earth(
    longitude: np.ndarray[Any, Any], region: tuple[float, float, float, float]
) -> None:
    grid = read_vector_grid(whole_earth(longitude), "wind", region=region)
    west = (region[0] + 180) % 360 - 180
    assert -180 <= grid.longitude[0] <= west + 1e-9
    assert west + 5 - 1e-9 <= grid.longitude[-1] < west + 6
    assert (grid.latitude[0], grid.latitude[-1]) == (45, 47)
    u, _ = truth(grid.longitude, grid.latitude)
    np.testing.assert_allclose(grid.u, u, atol=1e-12)


def test_whole_earth_stays_whole() -> None:
    grid = read_vector_grid(whole_earth(np.arange(0, 360, 0.5)), "wind")
    np.testing.assert_allclose(grid.longitude, np.arange(0, 360, 0.5))
    closed = read_vector_grid(whole_earth(np.arange(-180, 180.5, 0.5)), "wind")
    np.testing.assert_allclose(closed.longitude, np.arange(-180, 180, 0.5))


def test_region_has_the_cells_around_it() -> None:
    """Between the nodes at its edge a velocity is interpolated."""
    grid = read_vector_grid(hycom(), "current", region=(-3.3, 45.1, 1.2, 46.2))
    np.testing.assert_allclose(grid.longitude, np.arange(-3.5, 1.6, 0.5))
    np.testing.assert_allclose(grid.latitude, np.arange(45, 46.3, 0.25))


@pytest.mark.parametrize(
    "region", [(0, 50, 1, 60), (100, 45, 120, 46), (-3, 46, 2, 45), (0, 0), (0, 45, 400, 46)]
)
def test_region_refused(region: Any) -> None:
    with pytest.raises(RecordError, match="region: "):
        read_vector_grid(hycom(), "current", region=region)


def test_irregular_axis() -> None:
    with pytest.raises(RecordError, match=r"latitude: its steps go from .*cdo remapbil"):
        read_vector_grid(hycom().assign_coords(lat=LAT**2 / 50), "current")


# Time


def test_period() -> None:
    grid = read_vector_grid(hycom(), "current", period=("2020-06-01T12:00", "2020-06-02"))
    np.testing.assert_array_equal(grid.times, TIMES[2:8].to_numpy())
    with pytest.raises(RecordError, match="leaves no time"):
        read_vector_grid(hycom(), "current", period=("2021", "2022"))
    for period in (("2021", "2020"), ("soon", "later")):
        with pytest.raises(RecordError, match=r"period: .* is not accepted"):
            read_vector_grid(hycom(), "current", period=period)


def test_times_are_put_in_order() -> None:
    grid = read_vector_grid(hycom().isel(time=[3, 0, 2, 1, 8, 7, 6, 5, 4]), "current")
    same(grid)
    assert "times were put in order" in grid.notes


def test_no_times() -> None:
    dataset = hycom().isel(time=slice(0))
    for times in (dataset.time.values, np.array([], dtype=object)):
        with pytest.raises(RecordError, match=r"time: 'time' of .* is empty"):
            read_vector_grid(dataset.assign_coords(time=times), "current")


@pytest.mark.parametrize("far", ["2270-07-25", "1600-01-01"])
def test_times_beyond_nanoseconds(far: str) -> None:
    times = np.array(TIMES, dtype="datetime64[us]")
    times[3] = np.datetime64(far)
    counted = (times - times[0]) / np.timedelta64(1, "h")
    attributes = {"units": "hours since 2020-06-01"}
    for values in (times, ("time", counted, attributes), list(times.astype(object))):
        with pytest.raises(RecordError, match=f"time: {far} is not accepted"):
            read_vector_grid(hycom().assign_coords(time=values), "current")
    with pytest.raises(RecordError, match=f"period: {far} is not accepted"):
        read_vector_grid(hycom(), "current", period=tuple(sorted([far, "2020-06-01"])))


def test_time_twice() -> None:
    with pytest.raises(RecordError, match="2020-06-01T06:00Z occurs more than once"):
        read_vector_grid(hycom().isel(time=[0, 1, 1, 2]), "current")


@pytest.mark.parametrize(
    ("units", "hours"),
    [
        ("hours since 2020-06-01 00:00:00", 0),
        ("Hours since 2020-06-01", 0),
        ("hours since 2020-06-01T00:00:00Z", 0),
        ("hours since 2020-06-01 00:00:00 UTC", 0),
        ("hours since 2020-06-01 01:00:00 +01:00", 0),
        ("hours since 2020-05-31 18:00:00.0 -06", 0),
        ("hours since 2020-06-01 01:00:00", 1),
    ],
)
def test_time_units(units: str, hours: int) -> None:
    dataset = hycom().assign_coords(time=("time", 6.0 * np.arange(9), {"units": units}))
    grid = read_vector_grid(dataset, "current")
    np.testing.assert_array_equal(grid.times, (TIMES + pd.Timedelta(hours, "h")).to_numpy())
    assert any("to UTC" in note for note in grid.notes) == units.endswith(("+01:00", "-06"))


@pytest.mark.parametrize(
    ("attributes", "message"),
    [
        ({}, "states no units"),
        ({"units": "hours since yesterday"}, "states 'hours since yesterday'"),
        ({"units": "hours since 2020-06-01 00:00:00 CET"}, "CET'; accepted are UTC"),
        ({"units": "hours since 2020-06-01", "time_zone": "CET"}, "the zone 'CET'"),
        ({"units": "hours since 2020-06-01", "calendar": "noleap"}, r"calendar 'noleap'.*convert"),
    ],
)
def test_times_refused(attributes: dict[str, str], message: str) -> None:
    dataset = hycom().assign_coords(time=("time", 6.0 * np.arange(9), attributes))
    with pytest.raises(RecordError, match=message):
        read_vector_grid(dataset, "current")


def test_times_of_a_zone() -> None:
    zoned = np.array(list(TIMES.tz_localize("UTC").tz_convert("Europe/Paris")), dtype=object)
    grid = read_vector_grid(hycom().assign_coords(time=("time", zoned)), "current")
    same(grid)
    assert any("Europe/Paris to UTC" in note for note in grid.notes)


# Several files


def test_files_are_joined(tmp_path: Path) -> None:
    dataset = hycom()
    for name, rows in (("b", slice(0, 4)), ("a", slice(4, 9))):
        dataset.isel(time=rows).to_netcdf(tmp_path / f"{name}.nc", engine="h5netcdf")
    paths = [tmp_path / "a.nc", tmp_path / "b.nc"]
    joined = read_vector_grid(paths, "current")
    same(joined)
    assert joined.sha256 == read_vector_grid(str(tmp_path / "?.nc"), "current").sha256
    assert joined.sha256 == read_vector_grid(dataset, "current").sha256
    later = read_vector_grid(paths, "current", period=("2020-06-03", "2020-06-03"))
    assert len(later.times) == 1
    with pytest.raises(RecordError, match="occurs more than once"):
        read_vector_grid([*paths, paths[0]], "current")


def test_files_of_two_grids(tmp_path: Path) -> None:
    hycom().isel(time=[0]).to_netcdf(tmp_path / "a.nc", engine="h5netcdf")
    hycom().isel(time=[1], lon=slice(1, None)).to_netcdf(tmp_path / "b.nc", engine="h5netcdf")
    with pytest.raises(RecordError, match="files that are joined need one grid"):
        read_vector_grid(str(tmp_path / "*.nc"), "current")


# What is refused


def staggered() -> xr.Dataset:
    dataset = hycom()
    dataset["water_v"] = dataset["water_v"].rename(lat="lat_v").assign_coords(lat_v=LAT + 0.125)
    return dataset


def curvilinear() -> xr.Dataset:
    longitude, latitude = np.meshgrid(LON, LAT)
    dataset = hycom().rename(lat="y", lon="x").drop_vars(["x", "y"])
    return dataset.assign_coords(
        longitude=(("y", "x"), longitude + 0.1 * latitude), latitude=(("y", "x"), latitude)
    )


def in_terms_of(name: str, values: Any, **attributes: str) -> xr.Dataset:
    """A dataset whose axis has other values and attributes."""
    return hycom().assign_coords({name: (name, values, attributes)})


def on_a_map() -> xr.Dataset:
    """Mercator's meridians and parallels are straight, and so have one dimension each."""
    dataset = hycom().assign_coords(crs=((), 0, {"grid_mapping_name": "Mercator"}))
    dataset["water_u"].attrs["grid_mapping"] = "crs"
    return dataset


@pytest.mark.parametrize(
    ("dataset", "message"),
    [
        (staggered, r"grid: .* staggered \(C\) grid"),
        (curvilinear, r"longitude: 'longitude' has dimensions .*cdo remapbil.*xesmf"),
        (lambda: hycom().expand_dims(member=2), r"dimensions: .* 2 of 'member'.*isel\(member=0\)"),
        (lambda: hycom().drop_vars("time").isel(time=0), "time: .* no time; give it one"),
        (lambda: hycom().where(False), "values: .* no value in the region"),
        (lambda: hycom().where(LON[:, None] != LON[3], 1e4), "stands for a missing value"),
        (lambda: cmems().isel(depth=[2]).assign_coords(depth=[500.0]), None),
        (on_a_map, "grid: 'water_u' is on a mercator map; turn the components toward east and nor"),
        (
            lambda: hycom().drop_vars("lon").rename(lon="i"),
            r"longitude: 'water_u' has dimensions \('time', 'lat', 'i'\); missing is a 1-D, reg",
        ),
        (
            lambda: (
                hycom()
                .expand_dims(s=[-0.9, -0.1])
                .assign_coords(s=("s", [-0.9, -0.1], {"standard_name": "ocean_s_coordinate_g2"}))
            ),
            "levels: 's' follows the terrain",
        ),
        (
            lambda: cmems().assign_coords(depth=("depth", [0.0, 1.0, 25.0], {"units": "dbar"})),
            "levels: 'depth' is in 'dbar'; select one level first, e.g. dataset.isel",
        ),
        (lambda: in_terms_of("lat", LAT + 50), "latitude: 94 to 98.75 is not accepted; it should"),
        (
            lambda: in_terms_of("lat", np.where(LAT == 45, np.nan, LAT)),
            "latitude: 20 value.s., 1 missing; at least 2, all finite, are needed",
        ),
        (lambda: hycom().isel(lat=[3]), "latitude: 1 value.s., 0 missing; at least 2"),
        (
            lambda: hycom().isel(lon=[0, 1]).assign_coords(lon=[0.0, 360.0]),
            "longitude: all values are one meridian; at least 2 are needed",
        ),
        (
            lambda: hycom().assign_coords(time=[pd.NaT, *TIMES[1:]]),
            r"time: 1 of 9 are missing; drop them, e.g. dataset.dropna\('time'\)",
        ),
        (
            lambda: in_terms_of("time", np.arange(9.0), units="fortnights since 2020-06-01"),
            "time: units 'fortnights since 2020-06-01' of 'time' cannot be decoded: ",
        ),
        (
            lambda: hycom().assign(water_u=hycom()["water_u"].assign_attrs(units="furlong/h")),
            "units of 'water_u': 'furlong/h' is not accepted; use 'm/s', .*, as units= if the file",
        ),
    ],
)
def test_refused(dataset: Callable[[], xr.Dataset], message: str | None) -> None:
    made = dataset()
    if message is None:
        made["depth"].attrs["units"] = "m"
        message = "levels: 0 m is wanted and the nearest of 'depth' is 500 m"
    with pytest.raises(RecordError, match=message):
        read_vector_grid(made, "current")


def test_units_given_are_known() -> None:
    with pytest.raises(RecordError, match=r"units: 'mph' is not accepted; use .* or 'knots'$"):
        read_vector_grid(hycom(), "current", units="mph")


def test_wind_needs_every_value() -> None:
    dataset = era5()
    dataset["u10"][2, 3, 4] = np.nan
    with pytest.raises(RecordError, match=r"values: 1 of 3600 are missing, .*cdo fillmiss2"):
        read_wind_grid(dataset)


def test_files_refused(tmp_path: Path) -> None:
    for name, content, message in (
        ("a.grib", b"GRIB....", "cdo -f nc4 copy"),
        ("b.nc", b"CDF\x05....", "nccopy -k nc4"),
        ("c.nc", b"not NetCDF", "cannot be read"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(RecordError, match=message):
            read_vector_grid(tmp_path / name, "wind")
    for source in (tmp_path, tmp_path / "absent.nc", [], 3, str(tmp_path / "no*.nc")):
        with pytest.raises(RecordError, match="source: "):
            read_vector_grid(source, "wind")  # type: ignore[arg-type]
    with pytest.raises(RecordError, match=r"kind: 'tide' is not accepted"):
        read_vector_grid(hycom(), "tide")  # type: ignore[arg-type]


def test_netcdf_3_without_scipy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, era5().drop_vars("number"), engine="scipy")
    monkeypatch.setitem(sys.modules, "scipy.io", None)
    with pytest.raises(RecordError, match=r'needs scipy: pip install "driftcore\[geo\]"'):
        read_vector_grid(path, "wind")


# Files that nobody here wrote


def real(name: str) -> Path:
    path = REAL / name
    if not path.is_file():
        pytest.skip(f"the file is not at {path}")
    return path


@pytest.mark.parametrize(
    ("name", "kind", "shape"),
    [
        ("gridded_current.nc", "current", (17, 52, 26)),
        ("wa_RTOFS_global.nc", "current", (64, 38, 34)),
        ("GFS_Global_0p25deg.nc", "wind", (17, 7, 7)),
        (
            "20030101000000-GLOBCURRENT-L4-CUReul_hs-ALT_SUM-v02.0-fv01.0.nc",
            "current",
            (1, 41, 81),
        ),
    ],
)
def test_real_files(name: str, kind: Kind, shape: tuple[int, ...]) -> None:
    grid = read_vector_grid(real(name), kind)
    assert grid.u.shape == shape
    assert grid.step_h == (3 if shape[0] > 1 else None)
    # These are stored from south to north and in m/s: xarray reads the same without us.
    with xr.open_dataset(real(name), decode_times=False) as dataset:
        for values, variable in zip((grid.u, grid.v), dataset.data_vars.values(), strict=True):
            np.testing.assert_array_equal(values, variable.values)


def test_real_files_refused() -> None:
    with pytest.raises(RecordError, match=r"lambert_conformal_conic map.*remapbil"):
        read_vector_grid(real("AROME_MetCoOp_00_DEF_20160114_subset.nc"), "wind")
    with pytest.raises(RecordError, match=r"staggered \(C\) grid and terrain-following levels"):
        read_vector_grid(real("Nordic_subset_day1.nc"), "current")


# The lines of the guide, run on the files that are refused


def lines(name: str) -> str:
    text = (Path(__file__).parents[1] / "docs/guide/data.md").read_text()
    return text.split(f"<!-- {name} -->\n```python\n")[1].split("```\n<!-- end -->")[0]


def test_curvilinear_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The axes of a Lambert map turn by sin(63°) for each degree off its central meridian."""
    path = real("AROME_MetCoOp_00_DEF_20160114_subset.nc")
    (tmp_path / "arome.nc").symlink_to(path)
    monkeypatch.chdir(tmp_path)
    room: dict[str, Any] = {}
    exec(lines("curvilinear") + lines("arome"), room)  # noqa: S102 - the guide's own lines
    lon = room["lon"]
    along = room["turned"](np.ones_like(lon), np.zeros_like(lon), lon, room["lat"])
    expected = np.deg2rad(15 - lon) * np.sin(np.deg2rad(63))
    np.testing.assert_allclose(np.angle(along), expected, atol=2e-3)
    grid = read_wind_grid("wind.nc")
    speed = np.hypot(grid.u, grid.v)
    with xr.open_dataset(path) as file:
        known = np.hypot(file["x_wind_10m"].values, file["y_wind_10m"].values)
        j, i = np.unravel_index(np.hypot(lon - 6.0, room["lat"] - 62.0).argmin(), lon.shape)
    near = speed[:, 20, 20]  # 6 E, 62 N
    np.testing.assert_allclose(near, known[:, j, i], rtol=0.1)


def test_roms_lines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "roms.nc").symlink_to(real("Nordic_subset_day1.nc"))
    monkeypatch.chdir(tmp_path)
    room: dict[str, Any] = {}
    exec(lines("curvilinear") + lines("roms"), room)  # noqa: S102 - the guide's own lines
    # The angle that the file states is that of its coordinates.
    ones = np.ones_like(room["lon"])
    along = room["turned"](ones, 0 * ones, room["lon"], room["lat"])
    with xr.open_dataset("roms.nc") as file:
        np.testing.assert_allclose(np.angle(along), file["angle"].values, atol=0.01)
    grid = read_vector_grid("current.nc", "current")
    assert 0.3 < np.isfinite(grid.u).mean() < 1
    assert 0.05 < np.nanmax(np.hypot(grid.u, grid.v)) < 0.7
