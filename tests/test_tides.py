"""Tides: convention, atlases from files, fits to a current, analytic waves."""

import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import utide
import xarray as xr
from numpy.typing import NDArray

from driftcore import tides
from driftcore.errors import DriftCoreError, DriftCoreWarning, RecordError, ScenarioError
from driftcore.tides import TidalAtlas

START = np.datetime64("2026-03-01", "s")
NAMES = ["M2", "S2", "N2", "K1", "O1", "M4"]
COARSE = np.linspace(-6, -2, 5), np.linspace(44, 47, 4)
SAN_FRANCISCO = (
    Path(__file__).parents[2] / "shared/data/tide/current_obs_noaa_s08010_SF_bay_2016_2017.csv.gz"
)


def hours(count: int, step: float = 1.0) -> NDArray[np.datetime64]:
    return START + (np.arange(count) * step * 3600).astype("timedelta64[s]")


def random_atlas(
    names: list[str] = NAMES,
    longitude: NDArray[Any] = COARSE[0],
    latitude: NDArray[Any] = COARSE[1],
    seed: int = 1,
) -> TidalAtlas:
    """Amplitudes of 0.2 to 0.5 m/s, any phases, no land."""
    rng = np.random.default_rng(seed)
    shape = (len(names), len(latitude), len(longitude))
    u, v = (
        rng.uniform(0.2, 0.5, shape) * np.exp(-2j * np.pi * rng.uniform(size=shape)) for _ in "uv"
    )
    return TidalAtlas(
        xr.Dataset(
            {
                "u": (("constituent", "latitude", "longitude"), u),
                "v": (("constituent", "latitude", "longitude"), v),
            },
            {"constituent": names, "latitude": latitude, "longitude": longitude},
        )
    )


def predicted(atlas: TidalAtlas, times: NDArray[np.datetime64]) -> xr.Dataset:
    """The current of an atlas on its own grid."""
    east, north = np.meshgrid(atlas.longitude, atlas.latitude)
    current = atlas.velocity(times[:, None, None], east, north)
    dims = ("time", "latitude", "longitude")
    return xr.Dataset(
        {"u": (dims, current[..., 0]), "v": (dims, current[..., 1])},
        {"time": times, "latitude": atlas.latitude, "longitude": atlas.longitude},
    )


def amplitude_and_phase_errors(found: xr.Dataset, true: xr.Dataset) -> tuple[float, float]:
    """Largest relative error of amplitudes, and largest error of phases [degrees]."""
    ratios = np.concatenate([(found[n] / true[n]).values.ravel() for n in "uv"])
    assert np.isfinite(ratios).all()
    return float(abs(abs(ratios) - 1).max()), float(np.degrees(abs(np.angle(ratios))).max())


# Convention


def test_solar_tide_follows_the_clock() -> None:
    """S2 has V = 30° per hour of UTC and no nodal correction: a lag of 60° peaks at 2 o'clock."""
    atlas = random_atlas(["S2"])
    c = xr.full_like(atlas.dataset, 0.5 * np.exp(-1j * math.radians(60)))
    times = hours(24)
    found = TidalAtlas(c).velocity(times, -4.0, 45.0)
    expected = 0.5 * np.cos(np.radians(30 * np.arange(24) - 60))
    np.testing.assert_allclose(found, np.stack([expected, expected], axis=-1), atol=1e-9)


def test_lunar_tide_follows_the_mean_moon() -> None:
    """M2 has V = 2(T + h − s), f = cos⁴(I/2)/0.9154 and u = 2ξ − 2ν (Schureman 1958)."""
    time = np.datetime64("2017-05-06T07:12", "s")
    days = (time - np.datetime64("2000-01-01T12:00", "s")) / np.timedelta64(1, "D")
    # Mean longitudes of moon, sun and node: Meeus (1998), chapters 22, 25 and 47, linear in time.
    s, h = 218.3164477 + 13.17639648 * days, 280.46646 + 0.98564736 * days
    node = math.radians(125.04452 - 0.0529537648 * days)
    hour = (time - time.astype("datetime64[D]")) / np.timedelta64(1, "h")
    argument = 2 * math.radians(15 * hour + h - s)
    inclination = math.acos(0.91370 - 0.03569 * math.cos(node))
    # ν and ξ after Schureman's formulas for the orbit of the moon.
    one = math.atan(1.01883 * math.tan(node / 2))
    other = math.atan(0.64412 * math.tan(node / 2))
    angle = 2 * ((node - one - other) - (one - other))
    factor = math.cos(inclination / 2) ** 4 / 0.9154
    found = random_atlas(["M2"]).constituents_at(time, time)["factor"].item()
    assert abs(found) == pytest.approx(factor, rel=1e-3)
    assert abs(np.angle(found * np.exp(-1j * (argument + angle)), deg=True)) < 0.05


@pytest.mark.parametrize("time", ["2006-09-15", "2016-11-17", "2026-03-21"])
def test_arguments_are_those_of_utide(time: str) -> None:
    from utide._ut_constants import constit_index_dict
    from utide.harmonics import FUV

    names = ["M2", "S2", "N2", "K1", "O1", "K2", "P1", "M4", "MS4", "MN4", "M6"]
    moment = np.datetime64(time)
    table = random_atlas(names).constituents_at(moment, moment)
    day = np.array([(moment - np.datetime64("0000-12-31")) / np.timedelta64(1, "D")])
    indices = np.array([constit_index_dict[name] for name in names])
    factor, angle, argument = FUV(day, day[0], indices, 45.0, [0, 0, 0, 0])
    found = table["factor"].values
    # Foreman's satellites against Schureman's formulas: he also moves P1, by 1.2 %.
    np.testing.assert_allclose(abs(found), factor[0], rtol=0.015)
    apart = np.angle(found * np.exp(-2j * np.pi * (angle[0] + argument[0])), deg=True)
    assert abs(apart).max() < 0.6


def test_species_are_cycles_of_the_day() -> None:
    names = ["Q1", "O1", "K1", "MU2", "M2", "S2", "2SM2", "M3", "MK3", "M4", "S4", "M6", "M8"]
    table = random_atlas(names).constituents_at(START, START)
    assert table["species"].values.tolist() == [1, 1, 1, 2, 2, 2, 2, 3, 3, 4, 4, 6, 8]
    lunar_day = 24.8412 * 3600
    cycles = table["frequency"] * lunar_day / (2 * np.pi)
    assert abs(cycles - table["species"]).max() < 0.3
    period = 2 * np.pi / table["frequency"].sel(constituent="M2").item() / 3600
    assert period == pytest.approx(12.4206012, abs=1e-6)


def test_constituents_at_gives_the_velocity_of_a_run() -> None:
    """Nodal corrections of the middle, at the ends of 60 days: f and u change by 0.1 % and 0.1°."""
    atlas = random_atlas()
    middle, times = START + np.timedelta64(30, "D"), hours(1441)
    table = atlas.constituents_at(middle, START)
    seconds = np.arange(1441) * 3600.0
    c = atlas.dataset.sel(longitude=-3, latitude=46)
    phasors = table["factor"] * np.exp(1j * table["frequency"] * xr.DataArray(seconds, dims="t"))
    run = np.stack([(c[n] * phasors).sum("constituent").real for n in "uv"], axis=-1)
    exact = atlas.velocity(times, -3.0, 46.0)
    assert abs(run - exact).max() < 0.005 * abs(exact).max()
    assert abs(run - exact)[720].max() < 1e-6


# The atlas


def test_velocity_is_bilinear_and_broadcasts() -> None:
    atlas = random_atlas()
    times = hours(3)
    corners = atlas.velocity(times[:, None], [-4.0, -3.0, -4.0, -3.0], [45.0, 45.0, 46.0, 46.0])
    assert corners.shape == (3, 4, 2)
    weights = np.array([0.75 * 0.6, 0.25 * 0.6, 0.75 * 0.4, 0.25 * 0.4])
    np.testing.assert_allclose(
        atlas.velocity(times, -3.75, 45.4), np.einsum("p,tpc->tc", weights, corners), atol=1e-12
    )
    nearest = atlas.velocity(times, -3.75, 45.4, method="nearest")
    np.testing.assert_array_equal(nearest, corners[:, 0])
    assert atlas.velocity(times[0], -4, 45).shape == (2,)


def test_velocity_knows_longitudes_a_turn_apart_and_land() -> None:
    atlas = random_atlas()
    np.testing.assert_allclose(
        atlas.velocity(START, 356.5, 45.0), atlas.velocity(START, -3.5, 45.0), atol=1e-12
    )
    place = {"latitude": 45, "longitude": -4}
    land = TidalAtlas(
        atlas.dataset.where((atlas.dataset.latitude != 45) | (atlas.dataset.longitude != -4))
    )
    assert np.isnan(land.velocity(START, -4.1, 45.1)).all()
    assert np.isnan(land.dataset["u"].sel(place)).all()
    # On the grid line beside it the land has no weight.
    assert np.isfinite(land.velocity(START, -3.0, 45.0)).all()
    assert np.isfinite(land.velocity(START, -4.0, 46.0)).all()


def test_scales_are_the_largest_speeds_of_a_tide() -> None:
    atlas = random_atlas(["M2", "S2"])
    phase = np.exp(2j * np.pi * xr.DataArray(np.linspace(0, 1, 721), dims="phase"))
    speed = np.hypot((atlas.dataset["u"] * phase).real, (atlas.dataset["v"] * phase).real)
    largest = speed.max("phase")
    scales = atlas.scales()
    np.testing.assert_allclose(scales["maximum"], largest.max(("latitude", "longitude")), rtol=2e-5)
    area = np.cos(np.radians(atlas.latitude))
    mean = (largest.mean("longitude").values * area).sum(axis=-1) / area.sum()
    np.testing.assert_allclose(scales["mean"], mean, rtol=2e-5)
    assert atlas.reference == str(scales["maximum"].idxmax().item())
    strong = atlas.dataset.copy(deep=True)
    strong["u"].loc["S2"] *= 3
    assert TidalAtlas(strong).reference == "S2"
    assert "S2" in repr(TidalAtlas(strong))
    assert "longitude -6 to -2" in repr(atlas)


def test_a_region_is_covered_across_the_seam() -> None:
    globe = random_atlas(["M2"], np.arange(0.0, 360, 2), np.arange(-10.0, 11, 2))
    region = globe.sel_region(-5, 5, -1, 3)
    assert region.longitude.tolist() == [-6, -4, -2, 0, 2, 4, 6]
    assert region.latitude.tolist() == [-2, 0, 2, 4]
    np.testing.assert_allclose(
        region.velocity(START, [-5, 4.5], [3, 1.0]),
        [globe.velocity(START, 355, 3) * [1, 1], globe.velocity(START, 4.5, 1.0)],
    )
    with pytest.raises(ScenarioError, match="region"):
        globe.sel_region(5, -5, -1, 3)
    with pytest.raises(ScenarioError, match="no grid point"):
        random_atlas().sel_region(50, 60, 44, 45)


def test_a_bad_atlas_is_refused() -> None:
    good = random_atlas().dataset
    partly = good.copy(deep=True)
    partly["u"][0, 1, 1] = np.nan
    infinite = good.copy(deep=True)
    infinite["v"][0, 1, 1] = np.inf
    cases = {
        "'v' is missing": good.drop_vars("v"),
        "dimensions": good.isel(latitude=0, drop=True),
        "complex": good.map(abs),
        "no coordinate": good.drop_vars("longitude"),
        "'XX9' is not known": good.assign_coords(constituent=["XX9", *NAMES[1:]]),
        "occurs twice": good.assign_coords(constituent=["S2", *NAMES[1:]]),
        "'MF' has a long period": good.assign_coords(constituent=["Mf", *NAMES[1:]]),
        "latitude: steps": good.isel(latitude=slice(None, None, -1)),
        "longitude: steps": good.assign_coords(longitude=[0, 1, 2, 4, 5]),
        "only a part": partly,
        "infinite": infinite,
        "all is land": good * np.nan,
    }
    for message, dataset in cases.items():
        with pytest.raises(ScenarioError, match=message):
            TidalAtlas(dataset)
    atlas = random_atlas()
    with pytest.raises(ScenarioError, match="longitude: -10"):
        atlas.velocity(START, -10.0 - 360, 45)
    with pytest.raises(ScenarioError, match="latitude: 48 is outside"):
        atlas.velocity(START, -3, 48)
    with pytest.raises(ScenarioError, match="times"):
        atlas.velocity(0.0, -3, 45)
    with pytest.raises(ScenarioError, match="reference"):
        atlas.constituents_at(START, np.datetime64("NaT"))


def test_without_pytmd_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyTMD", None)
    with pytest.raises(DriftCoreError, match=r'pip install "driftcore\[geo\]"'):
        tides.biscay()


def test_names_are_standard() -> None:
    renamed = random_atlas(["M2", "LAMBDA2"]).dataset.assign_coords(constituent=["m2 ", "LDA2"])
    assert TidalAtlas(renamed).constituents == ("M2", "LAMBDA2")


# Files


def polar(atlas: TidalAtlas) -> xr.Dataset:
    """Amplitude and Greenwich lag [degrees 0 to 360] of both components, land as NaN."""
    c = atlas.dataset
    parts = {}
    for name in "uv":
        parts[f"{name}_amplitude"] = abs(c[name]).assign_attrs(units="m/s")
        lag = xr.apply_ufunc(lambda z: -np.angle(z, deg=True) % 360, c[name])
        parts[f"{name}_phase"] = lag.assign_attrs(units="degrees")
    return xr.Dataset(parts)


def land(atlas: TidalAtlas) -> TidalAtlas:
    c = atlas.dataset
    return TidalAtlas(c.where((c.latitude < 46) | (c.longitude < -3)))


def assert_same(found: TidalAtlas, expected: TidalAtlas, tolerance: float = 1e-12) -> None:
    assert set(found.constituents) == set(expected.constituents)
    np.testing.assert_allclose(found.longitude, expected.longitude, atol=1e-5)
    np.testing.assert_allclose(found.latitude, expected.latitude, atol=1e-5)
    for name in "uv":
        np.testing.assert_allclose(
            found.dataset[name].sel(constituent=list(expected.constituents)).values,
            expected.dataset[name].values,
            atol=tolerance,
        )


def test_fes_files_of_one_constituent_and_component(tmp_path: Path) -> None:
    """As FES: Ua, Ug, Va, Vg in cm/s and degrees, longitude 0 to 360, lower-case file names."""
    atlas = land(random_atlas(["M2", "S2", "MU2"]))
    files: dict[str, list[Path]] = {}
    for name in atlas.constituents:
        for letter, direction in (("u", "eastward"), ("v", "northward")):
            one = polar(atlas).sel(constituent=name, drop=True)
            one = one[[f"{letter}_amplitude", f"{letter}_phase"]]
            one = one.rename(
                {
                    f"{letter}_amplitude": f"{letter.upper()}a",
                    f"{letter}_phase": f"{letter.upper()}g",
                }
            )
            one[f"{letter.upper()}a"] = (100 * one[f"{letter.upper()}a"]).assign_attrs(units="cm/s")
            one = one.assign_coords(longitude=(one.longitude % 360).astype("f4"))
            one = one.rename(latitude="lat", longitude="lon")
            path = tmp_path / f"{direction}_velocity" / f"{name.lower()}.nc"
            path.parent.mkdir(exist_ok=True)
            one.to_netcdf(path)
            files.setdefault(name, []).append(path)
    by_mapping = tides.from_atlas(files)
    shifted = TidalAtlas(atlas.dataset.assign_coords(longitude=atlas.longitude + 360))
    assert_same(by_mapping, shifted)
    by_file_name = tides.from_atlas([path for pair in files.values() for path in pair])
    assert_same(by_file_name, shifted)
    assert_same(tides.from_atlas(files, region=(-6, -2, 44, 47)), atlas)
    some = tides.from_atlas(files, constituents=["mu2", "M2"])
    assert some.constituents == ("MU2", "M2")
    with pytest.raises(ScenarioError, match="'K1' not in the atlas"):
        tides.from_atlas(files, constituents=["K1"])
    with pytest.raises(RecordError, match="v of 'MU2' is not found"):
        tides.from_atlas([path for pair in files.values() for path in pair][:-1])


def test_one_file_with_packed_integers_and_descending_latitude(tmp_path: Path) -> None:
    """As a product on a server: CF attributes alone tell which variable is what."""
    atlas = land(random_atlas())
    backward = slice(None, None, -1)
    dataset = polar(atlas).isel(latitude=backward, longitude=backward)
    words = {"u": "eastward_sea_water_velocity", "v": "northward_sea_water_velocity"}
    encoding, renamed = {}, {}
    for k, name in enumerate(dataset):
        letter, part = str(name).split("_")
        dataset[name].attrs["standard_name"] = f"{words[letter]}_{part}_due_to_tides"
        renamed[name] = f"var{k}"
        scale = 1e-4 if part == "amplitude" else 0.01
        encoding[f"var{k}"] = {"dtype": "i4", "scale_factor": scale, "_FillValue": -999999}
    dataset.rename(renamed).to_netcdf(tmp_path / "tide.nc", encoding=encoding)
    assert_same(tides.from_atlas(tmp_path / "tide.nc"), atlas, tolerance=2e-4)


def test_tpxo_file_of_real_and_imaginary_parts(tmp_path: Path) -> None:
    """As TPXO: dims (constituent, x, y), 2-D axes, names as characters, zeros on land, 0 to 360."""
    atlas = land(random_atlas(longitude=np.linspace(178.0, 182.0, 5) - 176 + 354))
    c = atlas.dataset.fillna(0).transpose("constituent", "longitude", "latitude")
    east, north = np.meshgrid(atlas.longitude % 360, atlas.latitude, indexing="ij")
    names = np.array([list(name.lower().ljust(4)) for name in atlas.constituents], dtype="S1")
    dims = ("nc", "nx", "ny")
    parts = {
        f"{name}{part}": (dims, getattr(c[name], long).values, {"units": "meter/second"})
        for name in "uv"
        for part, long in (("Re", "real"), ("Im", "imag"))
    }
    dataset = xr.Dataset(
        {"con": (("nc", "nct"), names), "lon_u": (dims[1:], east), "lat_u": (dims[1:], north)}
        | {"lon_v": (dims[1:], east), "lat_v": (dims[1:], north)}
        | parts
    )
    assert_same(tides.from_atlas(dataset), atlas)
    dataset.to_netcdf(tmp_path / "u_tpxo.nc")
    assert_same(tides.from_atlas(tmp_path / "u_tpxo.nc"), atlas)


def test_tpxo_files_of_one_constituent_each(tmp_path: Path) -> None:
    """As the TPXO atlas: real and imaginary parts as integers, the name inside the file."""
    atlas = random_atlas(["M2", "O1"])
    paths = []
    for number, name in enumerate(atlas.constituents):
        one = atlas.dataset.sel(constituent=name, drop=True).transpose("longitude", "latitude")
        parts = {
            f"{n}{p}": getattr(one[n], q) for n in "uv" for p, q in (("Re", "real"), ("Im", "imag"))
        }
        file = xr.Dataset(parts).rename(latitude="lat", longitude="lon")
        file["con"] = ("nct", np.array(list(name.lower().ljust(4)), dtype="S1"))
        for part in parts:
            file[part].attrs["units"] = "m/s"
        paths.append(tmp_path / f"file{number}.nc")
        packed = {"dtype": "i4", "scale_factor": 1e-6, "_FillValue": 2**31 - 1}
        file.to_netcdf(paths[-1], encoding=dict.fromkeys(parts, packed))
    assert_same(tides.from_atlas(paths), atlas, tolerance=1e-6)


def test_transports_on_a_staggered_grid_take_a_depth() -> None:
    """Fields linear in the place: the mean of the two faces of a cell is the value between."""
    axis = np.arange(10.0, 16)
    wave = np.exp(1j * np.array([0.3, 1.1]))[:, None, None]
    north, east = np.meshgrid(axis, axis, indexing="ij")
    values = {
        "u": (2 + (east - 0.5) + 2 * north) * wave,
        "v": (1 + east - (north - 0.5)) * wave,
    }
    dataset = xr.Dataset(
        {"con": ("nc", ["m2", "k1"])}
        | {
            f"{name}{part}": (("nc", "y", "x"), 1e4 * array, {"units": "centimeter^2/sec"})
            for name, value in values.items()
            for part, array in (("Re", value.real), ("Im", value.imag))
        },
        {
            "lon_u": ("x", axis - 0.5),
            "lat_u": ("y", axis),
            "lon_v": ("x", axis),
            "lat_v": ("y", axis - 0.5),
        },
    )
    with pytest.raises(RecordError, match="transports"):
        tides.from_atlas(dataset)
    depth = xr.DataArray(20 + 0 * north, {"lat": axis, "lon": axis}, ("lat", "lon"))
    depth[0, 0] = 0
    with pytest.raises(ScenarioError, match="depth: dimensions"):
        tides.from_atlas(dataset, depth=depth.expand_dims(layer=2))
    atlas = tides.from_atlas(dataset, depth=depth)
    assert atlas.longitude.tolist() == [10, 11, 12, 13, 14]
    assert atlas.latitude.tolist() == [10, 11, 12, 13, 14]
    assert np.isnan(atlas.dataset["u"][:, 0, 0]).all()
    expected = ((2 + east + 2 * north) * wave / 20)[:, 1:-1, :-1]
    np.testing.assert_allclose(atlas.dataset["u"][:, 1:], expected, atol=1e-12)
    expected = ((1 + east - north) * wave / 20)[:, 1:-1, :-1]
    np.testing.assert_allclose(atlas.dataset["v"][:, 1:], expected, atol=1e-12)
    closed = dataset.copy(deep=True)
    closed["uRe"][:, 3, 3] = closed["uIm"][:, 3, 3] = np.nan  # between the cells x = 12 and 13
    half = tides.from_atlas(closed, depth=depth).dataset["u"].sel(latitude=13, longitude=[12, 13])
    open_face = values["u"][:, 3, [2, 4]] / 20
    np.testing.assert_allclose(half, open_face / 2, atol=1e-12)
    turned = depth.assign_coords(lon=axis - 360)
    assert_same(tides.from_atlas(dataset, depth=turned), atlas)
    # A region is covered although its bounds lie between the points of u and those of v.
    part = tides.from_atlas(dataset, depth=depth, region=(11.8, 12.9, 11.2, 12.0))
    assert part.longitude.tolist() == [11, 12, 13]
    assert part.latitude.tolist() == [11, 12]
    with pytest.raises(ScenarioError, match="depth: is not accepted"):
        tides.from_atlas(polar(random_atlas()), depth=depth)


def test_names_units_and_phases_may_be_told() -> None:
    atlas = random_atlas()
    dataset = polar(atlas).rename(u_amplitude="a", v_amplitude="b", u_phase="c", v_phase="d")
    names = {"u_amplitude": "a", "v_amplitude": "b", "u_phase": "c", "v_phase": "d"}
    assert_same(tides.from_atlas(dataset, names), atlas)
    for name in "cd":
        dataset[name] = np.radians(dataset[name])
    radians = dataset.drop_attrs()
    assert_same(tides.from_atlas(radians, names, units="m/s", phase_units="radians"), atlas)
    slower = tides.from_atlas(radians, names, units="cm s-1", phase_units="radians")
    np.testing.assert_allclose(slower.dataset["u"], atlas.dataset["u"] / 100)
    with pytest.warns(DriftCoreWarning, match="if they are radians"):
        tides.from_atlas(radians, names, units="m/s", phase_units="degrees")


@pytest.mark.parametrize(
    ("units", "factor"),
    [
        ("m s-1", 1.0),
        ("m.s-1", 1.0),
        ("meters/second", 1.0),
        ("metre per second", 1.0),
        ("m s**-1", 1.0),
        ("cm s^-1", 0.01),
        ("centimeter/sec", 0.01),
        ("mm/s", 0.001),
    ],
)
def test_units_have_many_spellings(units: str, factor: float) -> None:
    atlas = random_atlas(["M2"])
    dataset = polar(atlas)
    for name in "uv":
        dataset[f"{name}_amplitude"].attrs["units"] = units
    expected = TidalAtlas(atlas.dataset * factor)
    assert_same(tides.from_atlas(dataset), expected)


def test_integers_name_constituents_by_their_flags() -> None:
    atlas = random_atlas(["M2", "S2"])
    dataset = polar(atlas).assign_coords(constituent=[7, 9])
    with pytest.raises(RecordError, match="have no names"):
        tides.from_atlas(dataset)
    dataset["constituent"].attrs = {"flag_values": [9, 7], "flag_meanings": "s2 m2"}
    assert_same(tides.from_atlas(dataset), atlas)


def test_long_periods_are_left_out() -> None:
    atlas = random_atlas(["M2", "S2"])
    dataset = polar(atlas)
    dataset = xr.concat(
        [dataset, dataset.isel(constituent=[0]).assign_coords(constituent=["Mf"])], "constituent"
    )
    with pytest.warns(DriftCoreWarning, match="'MF'; they belong to the residual"):
        found = tides.from_atlas(dataset)
    assert_same(found, atlas)


def test_a_bad_atlas_file_is_refused(tmp_path: Path) -> None:
    good = polar(random_atlas())
    fast = good.copy(deep=True)
    fast["u_amplitude"] = (100 * fast["u_amplitude"]).assign_attrs(units="m/s")
    negative = good.copy(deep=True)
    negative["u_amplitude"][0, 0, 0] = -1
    no_units, odd_units, no_angle = (good.copy(deep=True) for _ in range(3))
    del no_units["v_amplitude"].attrs["units"]
    odd_units["u_amplitude"].attrs["units"] = "knots"
    no_angle["u_phase"].attrs["units"] = "hours"
    radians = good.copy(deep=True)
    radians["u_phase"].attrs["units"] = "radians"
    curved = good.rename(latitude="y", longitude="x").drop_vars(["x", "y"])
    curved = curved.assign_coords(
        lat=(("y", "x"), np.add.outer(np.arange(4.0), 0.1 * np.arange(5)) + 40),
        lon=(("y", "x"), np.add.outer(np.zeros(4), np.arange(5.0))),
    )
    track = good.isel(constituent=0, longitude=[0, 1, 2, 3], drop=True)
    track = track.isel(
        latitude=xr.DataArray(range(4), dims="p"), longitude=xr.DataArray(range(4), dims="p")
    )
    slow = good.isel(constituent=[0, 1]).assign_coords(constituent=["Mf", "SSA"])
    cases: dict[str, Any] = {
        "both run along 'p'": {"M2": track},
        "none but constituents of long period: 'MF', 'SSA'": slow,
        "no phase for u": good.drop_vars("u_phase"),
        "u is not found": good.drop_vars(["u_amplitude", "u_phase"]),
        "no tide runs faster": fast,
        "negative values": negative,
        "states no units": no_units,
        "'knots'": odd_units,
        "'hours'": no_angle,
        "no radian": radians,
        "curvilinear": curved,
        "latitude: steps": good.assign_coords(latitude=[44, 45, 46, 48]),
        "has no longitude": good.drop_vars("longitude"),
        "have no names": good.drop_vars("constituent"),
        "may be 'u_amplitude', 'ua'": good.assign(ua=good["u_amplitude"]),
        "does not tell its constituent": good.isel(constituent=0, drop=True),
        "has the dimensions": good.expand_dims(level=[0, 1]),
        "was given before": [good, good],
        "different grids": {
            "M2": good.isel(constituent=0, drop=True),
            "S2": good.isel(constituent=0, longitude=slice(1, None), drop=True),
        },
        "no staggered grid": [
            good[["u_amplitude", "u_phase"]],
            good[["v_amplitude", "v_phase"]].isel(latitude=slice(1, None)),
        ],
        "all is land": good.where(False).assign({name: good[name].where(False) for name in good}),
        "is no file": tmp_path / "absent.nc",
    }
    for message, source in cases.items():
        with pytest.raises(RecordError, match=message):
            tides.from_atlas(source)
    with pytest.raises(RecordError, match="u is not found"):
        tides.from_atlas(good, {"u_amplitude": "absent", "u_phase": "u_phase2"})
    with pytest.raises(ScenarioError, match="constituents: none"):
        tides.from_atlas(good, constituents=[])
    with pytest.raises(ScenarioError, match="'u_angle' is not accepted"):
        tides.from_atlas(good, {"u_angle": "u_phase"})
    with pytest.raises(ScenarioError, match="'XX9' is not known"):
        tides.from_atlas(good.assign_coords(constituent=["XX9", *NAMES[1:]]))
    with pytest.raises(ScenarioError, match="has no grid point"):
        tides.from_atlas(good, region=(20, 30, 44, 45))


# Fits


def test_a_year_with_noise_and_gaps_gives_amplitudes_and_phases() -> None:
    atlas = random_atlas()
    current = predicted(atlas, hours(365 * 24))
    rng = np.random.default_rng(2)
    noisy = current.map(lambda part: part + 0.1 + rng.normal(0, 0.03, part.shape))
    # A gap of a fortnight everywhere, and in half of the places one value in ten at random.
    noisy["u"][2000:2336] = np.nan
    random_gaps = rng.uniform(size=noisy["v"].shape) < 0.1
    random_gaps[:, :2] = False
    noisy["v"] = noisy["v"].where(~random_gaps)
    found = tides.fit(noisy, NAMES)
    amplitude, phase = amplitude_and_phase_errors(found.atlas.dataset, atlas.dataset)
    assert amplitude < 0.01
    assert phase < 1.0
    # Noise of variance s² over n values: the error of a cosine amplitude is s √(2/n).
    n = 8760 - 336
    expected = 0.03 * math.sqrt(2 / n)
    whole = found.standard_error["u"].isel(latitude=slice(2))
    scale = abs(found.atlas.constituents_at(START, START)["factor"])  # the nodal factor
    np.testing.assert_allclose(whole * scale, expected, rtol=0.05)
    errors = (found.atlas.dataset["u"] - atlas.dataset["u"]) / found.standard_error["u"]
    assert 0.7 < float(np.sqrt((abs(errors) ** 2 / 2).mean())) < 1.4
    np.testing.assert_allclose(found.residual["v"].mean("time"), 0.1, atol=0.003)
    total = (predicted(atlas, hours(365 * 24)).var("time").to_array().sum("variable")).values
    np.testing.assert_allclose(found.explained, total / (total + 2 * 0.03**2), atol=0.01)
    assert "M2" in repr(found)


def test_atlas_to_current_and_back_is_exact() -> None:
    atlas = land(random_atlas(["M2", "S2", "K1", "O1", "M4"]))
    current = predicted(atlas, hours(60 * 24))
    trend = xr.DataArray(np.linspace(-1, 1, current.sizes["time"]), dims="time")
    found = tides.fit(current + trend, atlas.constituents)
    assert_same(found.atlas, atlas, tolerance=1e-10)
    kept = found.residual["u"] - trend
    assert float(abs(kept).max()) < 1e-9
    assert np.isnan(found.residual["u"].sel(latitude=47, longitude=-2)).all()


def test_one_mooring_and_centimetres() -> None:
    atlas = random_atlas(["M2", "K1"])
    times = np.sort(np.random.default_rng(3).choice(hours(40 * 24 * 6, 1 / 6), 3000, False))
    u, v = atlas.velocity(times, -4.0, 45.0).T
    point = xr.Dataset(
        {"u": ("time", 100 * u, {"units": "cm s-1"}), "v": ("time", v)},
        {"time": times, "latitude": 45.0, "longitude": -4.0},
    )
    found = tides.fit(point, ["M2", "K1"]).atlas
    place = {"latitude": [45.0], "longitude": [-4.0]}
    assert_same(found, TidalAtlas(atlas.dataset.sel(place)), tolerance=1e-10)


@pytest.fixture(scope="module")
def san_francisco() -> xr.Dataset:
    """18,890 current samples at irregular times, 17 months."""
    if not SAN_FRANCISCO.is_file():
        pytest.skip(f"the San Francisco current is not at {SAN_FRANCISCO}")
    table = pd.read_csv(SAN_FRANCISCO)
    times = pd.to_datetime(table["time"]).dt.tz_localize(None).to_numpy()
    return xr.Dataset(
        {"u": ("time", table["u"]), "v": ("time", table["v"])},
        {"time": times, "latitude": 37.8, "longitude": -122.4},
    )


def test_measured_current_agrees_with_utide(san_francisco: xr.Dataset) -> None:
    main = ["M2", "S2", "N2", "K1", "O1", "K2"]
    found = tides.fit(san_francisco)
    names = list(found.atlas.constituents)
    assert set(main) < set(names)
    theirs = utide.solve(
        san_francisco["time"].values,
        san_francisco["u"].values,
        san_francisco["v"].values,
        lat=37.8,
        constit=[{"LAMBDA2": "LDA2"}.get(name, name) for name in names],
        method="ols",
        conf_int="none",
        nodal=True,
        trend=True,
        verbose=False,
    )
    lag, turn = np.exp(-1j * np.radians(theirs.g)), np.radians(theirs.theta)
    u = lag * (theirs.Lsmaj * np.cos(turn) + 1j * theirs.Lsmin * np.sin(turn))
    v = lag * (theirs.Lsmaj * np.sin(turn) - 1j * theirs.Lsmin * np.cos(turn))
    expected = xr.Dataset(
        {"u": ("constituent", u), "v": ("constituent", v)}, {"constituent": list(theirs.name)}
    )
    ours = found.atlas.dataset.isel(latitude=0, longitude=0).sel(constituent=main)
    amplitude, phase = amplitude_and_phase_errors(ours, expected.sel(constituent=main))
    assert amplitude < 0.01
    assert phase < 1.0
    assert 0.88 < found.explained.item() < 0.94


@pytest.mark.parametrize(
    ("days", "expected"),
    [
        (1.0, {"M2", "M4"}),
        (15.0, {"M2", "S2", "K1", "O1", "M4", "MS4"}),
        (30.0, {"M2", "S2", "N2", "K1", "O1", "Q1", "M4", "MS4", "MN4"}),
    ],
)
def test_rayleigh_chooses_constituents(days: float, expected: set[str]) -> None:
    atlas = random_atlas(["M2"])
    current = predicted(atlas, hours(round(24 * days)))
    chosen = set(tides.fit(current).atlas.constituents)
    assert expected <= chosen
    # What differs from an accepted one by less than a cycle over the record.
    too_near = {"K2", "P1", "T2"} | ({"S2", "N2", "K1", "O1"} if days < 14 else set())
    assert not chosen & too_near


def test_inseparable_constituents_are_named() -> None:
    atlas = random_atlas(["M2"])
    month = predicted(atlas, hours(30 * 24))
    with pytest.raises(ScenarioError, match=r"'S2' and 'K2' are not told apart.* 182\.6 days"):
        tides.fit(month, ["M2", "S2", "K2"])
    with pytest.raises(ScenarioError, match="'M2' and 'S2' are not told apart"):
        tides.fit(month, ["M2", "S2"], minimum_rayleigh=3.0)
    # 14.765 days are 354.4 hours, and each value stands for its hour.
    assert tides.fit(predicted(atlas, hours(355)), ["M2", "S2"]).atlas.constituents == ("M2", "S2")
    with pytest.raises(ScenarioError, match="not told apart"):
        tides.fit(predicted(atlas, hours(354)), ["M2", "S2"])
    with pytest.raises(ScenarioError, match=r"'M8' has 3\.11 h"):
        tides.fit(predicted(atlas, hours(100, 3.0)), ["M2", "M8"])
    assert "M6" not in tides.fit(predicted(atlas, hours(1000, 3.0))).atlas.constituents
    with pytest.raises(ScenarioError, match="do not tell M2"):
        tides.fit(predicted(atlas, hours(10)))


def test_places_with_too_few_values_are_left_out() -> None:
    atlas = random_atlas(["M2", "S2"])
    current = predicted(atlas, hours(30 * 24))
    current["u"][20:, 0, 0] = np.nan  # 20 hours: M2 and S2 look alike
    current["u"][2:, 1, 1] = np.nan
    current["u"][:, 2, 2] = np.nan  # land
    with pytest.warns(DriftCoreWarning, match="2 places"):
        found = tides.fit(current, ["M2", "S2"])
    left_out = np.isnan(found.atlas.dataset["u"].values)
    assert left_out[:, [0, 1, 2], [0, 1, 2]].all()
    assert left_out.sum() == 6
    np.testing.assert_array_equal(np.isnan(found.explained), left_out[0])
    np.testing.assert_array_equal(np.isnan(found.standard_error["v"]), left_out)


def test_a_bad_current_is_refused() -> None:
    good = predicted(random_atlas(["M2"]), hours(100))
    no_time = good.assign_coords(time=np.arange(100.0))
    infinite = good.copy(deep=True)
    infinite["u"][3, 0, 0] = np.inf
    knots = good.copy(deep=True)
    knots["u"].attrs["units"] = "knots"
    cases = {
        "variable 'v' is missing": good.drop_vars("v"),
        "coordinate 'latitude' is missing": good.isel(latitude=0, drop=True),
        "dimensions": good.expand_dims(depth=2),
        "datetime64": no_time,
        "infinite": infinite,
        "'knots'": knots,
        "at least 3": good.isel(time=slice(2)),
        "latitude: steps": good.isel(latitude=[0, 1, 3]),
        "no place has values enough": good.where(good.time < good.time[4]),
    }
    for message, dataset in cases.items():
        with pytest.raises(RecordError, match=message):
            tides.fit(dataset, ["M2"])
    with pytest.raises(ScenarioError, match="minimum_rayleigh: 0"):
        tides.fit(good, ["M2"], 0.0)
    with pytest.raises(ScenarioError, match="'MF' has a long period"):
        tides.fit(good, ["MF"])


# Analytic tides


LONGITUDE = np.linspace(-4.0, -2.0, 81)
LATITUDE = np.linspace(46.0, 48.0, 81)
LEVELS = {"M2": 1.5 * np.exp(-1j), "S2": 0.5 + 0j}
WAVES: dict[str, Callable[..., TidalAtlas]] = {
    "kelvin": tides.kelvin_wave,
    "progressive": tides.progressive_wave,
    "standing": tides.standing_wave,
    "amphidrome": lambda *a, **k: tides.amphidrome(*a, width=120e3, **k),
}


@pytest.mark.parametrize("heading", [0.0, 70.0, 200.0])
@pytest.mark.parametrize("wave", WAVES)
def test_waves_satisfy_the_shallow_water_equations(wave: str, heading: float) -> None:
    """With the level from continuity, both momentum equations hold up to the differences."""
    depth = 80.0
    atlas = WAVES[wave](
        LONGITUDE, LATITUDE, LEVELS, depth=depth, heading=heading, origin=(-3.0, 47.0)
    )
    rotation = 0.0 if wave == "standing" else 2 * 7.292e-5 * math.sin(math.radians(47))
    metre = 6.371e6 * math.pi / 180
    dx, dy = 0.025 * metre * math.cos(math.radians(47)), 0.025 * metre
    frequency = atlas.constituents_at(START, START)["frequency"].values[:, None, None]
    u, v = (atlas.dataset[name].values for name in "uv")

    def gradient(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        return np.gradient(values, dx, axis=2), np.gradient(values, dy, axis=1)

    level = -depth * (gradient(u)[0] + gradient(v)[1]) / (1j * frequency)
    slope = gradient(level)
    forces = [
        1j * frequency * u - rotation * v + 9.81 * slope[0],
        1j * frequency * v + rotation * u + 9.81 * slope[1],
    ]
    size = np.nanmax(abs(frequency * np.hypot(abs(u), abs(v))))
    inner = (slice(None), slice(2, -2), slice(2, -2))
    assert np.isfinite(forces[0][inner]).sum() > 1000
    for force in forces:
        assert np.nanmax(abs(force[inner])) < 0.01 * size
    # At the origin the level is the one asked for (the amphidrome adds the wave that returns).
    if wave != "amphidrome" and heading == 200.0:
        near = level[:, 40:41, 43:45] if wave == "kelvin" else level[:, 40:41, 40:41]
        wanted = np.array(list(LEVELS.values()))
        np.testing.assert_allclose(np.nanmean(near, axis=(1, 2)), wanted, rtol=0.1)


def test_the_amphidrome_lies_in_the_middle() -> None:
    width, depth = 120e3, 80.0
    atlas = tides.amphidrome(
        np.linspace(0, 1.5, 61), np.linspace(46, 49, 121), {"M2": 1.0}, width=width, depth=depth,
        origin=(0.0, 46.0), heading=0.0,
    )  # fmt: skip
    # North along the coast: the channel is to the left, that is west: all here is land but x = 0.
    assert np.isfinite(atlas.dataset["u"]).any("latitude").sum() == 1
    atlas = tides.amphidrome(
        np.linspace(-1.8, 0, 73), np.linspace(46, 49, 121), {"M2": 1.0}, width=width, depth=depth,
        origin=(0.0, 46.0), heading=0.0,
    )  # fmt: skip
    metre = 6.371e6 * math.pi / 180
    speed = np.abs(atlas.dataset["v"].values[0])
    omega = atlas.constituents_at(START, START)["frequency"].item()
    quarter = math.pi / 2 / (omega / math.sqrt(9.81 * depth)) / metre  # degrees
    x = -width / 2 / (metre * math.cos(math.radians(46)))
    column = int(abs(atlas.longitude - x).argmin())
    row = int(abs(atlas.latitude - 46 - quarter).argmin())
    # Where the level vanishes the two currents add up; at the origin latitude they cancel.
    assert speed[row, column] > 20 * speed[0, column]
    radius = math.sqrt(9.81 * depth) / (2 * 7.292e-5 * math.sin(math.radians(46)))
    largest = 2 * math.sqrt(9.81 / depth) * math.exp(-width / 2 / radius)
    assert speed[row, column] == pytest.approx(largest, rel=0.01)


def test_the_coast_changes_sides_with_the_hemisphere() -> None:
    for south, side in ((46.0, -1), (-48.0, 1)):
        atlas = tides.kelvin_wave(
            LONGITUDE, np.linspace(south, south + 2, 11), origin=(-3.0, south + 1)
        )
        sea = np.isfinite(atlas.dataset["v"][0, 5].values)
        assert (np.sign(LONGITUDE[sea] + 3.0001) == side).mean() > 0.97


def test_analytic_waves_refuse_bad_numbers() -> None:
    axes = (LONGITUDE, LATITUDE)
    cases: dict[str, Callable[[], object]] = {
        "depth": lambda: tides.kelvin_wave(*axes, depth=0.0),
        "width": lambda: tides.amphidrome(*axes, width=-1.0),
        "longitude: shape": lambda: tides.standing_wave(3.0, LATITUDE),
        "origin": lambda: tides.kelvin_wave(*axes, origin=(0.0, 0.0)),
        "does not propagate": lambda: tides.progressive_wave(*axes, {"K1": 1.0}),
        "'XX9' is not known": lambda: tides.kelvin_wave(*axes, {"XX9": 1.0}),
        "step": lambda: tides.biscay(0.13),
        "step: 0": lambda: tides.biscay(0),
    }
    for message, call in cases.items():
        with pytest.raises(ScenarioError, match=message):
            call()


def test_biscay_has_realistic_sizes_and_is_smooth() -> None:
    atlas = tides.biscay(0.1)
    assert atlas.constituents == ("M2", "S2", "N2")
    assert atlas.reference == "M2"
    assert (atlas.longitude[0], atlas.longitude[-1]) == (-10, 0)
    assert (atlas.latitude[0], atlas.latitude[-1]) == (43, 50)
    u, v = atlas.dataset["u"], atlas.dataset["v"]
    assert np.isfinite(u).all()
    speed = (abs(u + 1j * v) + abs(u - 1j * v)) / 2
    deep = speed.sel(constituent="M2", longitude=slice(-10, -6), latitude=slice(44, 46))
    assert 0.03 < float(deep.min()) < float(deep.max()) < 0.08
    assert 0.1 < speed.sel(constituent="M2").isel(longitude=55, latitude=40).item() < 0.3
    scales = atlas.scales()["maximum"]
    assert 0.2 < scales.sel(constituent="M2").item() < 0.3
    # Ratios of the level at Belle-Île: 0.357 and 0.207 before rounding.
    ratio = scales / scales.sel(constituent="M2")
    assert ratio.sel(constituent="S2").item() == pytest.approx(0.357 * 30 / 28.98, rel=0.05)
    assert ratio.sel(constituent="N2").item() == pytest.approx(0.207, rel=0.05)
    # Water runs toward the coast while the level rises, and northward while it is high.
    shelf = atlas.dataset.isel(longitude=55, latitude=40)  # 4.5° W, 47° N
    np.testing.assert_allclose(np.angle(shelf["u"] / shelf["v"], deg=True), 90, atol=1e-9)
    # The phase advances northward as that of a Kelvin wave in 4500 m: 21° in 6°.
    lag = -np.angle(v.sel(constituent="M2").sel(longitude=-9, method="nearest"), deg=True)
    climb = (lag[-6] - lag[4]) / (atlas.latitude[-6] - atlas.latitude[4])
    omega, metre = 1.405189e-4, 6.371e6 * math.pi / 180
    assert climb == pytest.approx(math.degrees(omega / math.sqrt(9.81 * 4500)) * metre, rel=1e-3)
    # Smooth: halving the step changes what lies between by a few per cent of the largest current.
    fine = tides.biscay(0.1).velocity(START, -4.55, 47.05)
    finer = tides.biscay(0.125).velocity(START, -4.55, 47.05)
    assert abs(fine - finer).max() < 0.02


def test_warnings_are_heard_beside_pytmd() -> None:
    """Importing pyTMD turns off every UserWarning of a process; importing it through us does not.

    In a process of its own, for it is imported once.
    """
    code = (
        "import warnings; from driftcore import tides; tides.constituents.pytmd(); "
        "from driftcore.errors import DriftCoreWarning; warnings.warn('heard', DriftCoreWarning)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
    assert "DriftCoreWarning: heard" in done.stderr
