"""Scenario files of the real sea: what they name is read, told in full, refused by name."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import driftcore as dc
from driftcore.climate import synthetic_record
from driftcore.errors import DriftCoreError, DriftCoreWarning, ScenarioError
from driftcore.runs import planned

LAND = (
    '{"type": "Polygon", "coordinates": [[[-4.2, 46], [-3, 46], [-3, 48], [-4.2, 48], [-4.2, 46]]]}'
)


def toml(
    top: str = "",
    release: str = 'coordinates = [-5.0, 47.0]\nstart = "2026-07-01T06:00"',
    body: str = "response_time_h = 1\nwind_factor = 0.03",
    rest: str = "",
) -> str:
    """A scenario of eight days, with something else in one place."""
    return f'kind = "geographic"\ndays = 8\n{top}\n[release]\n{release}\n[object]\n{body}\n{rest}\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a wind, a coast, an atlas and a current of one's own."""
    synthetic_record(3).to_csv(tmp_path / "wind.csv")
    (tmp_path / "land.geojson").write_text(LAND, encoding="utf-8")
    atlas = dc.tides.biscay(0.25).dataset
    parts = {
        f"{name}_{part}": (atlas[name].dims, values, {"units": units})
        for name in "uv"
        for part, values, units in (
            ("amplitude", np.abs(atlas[name].values), "m/s"),
            ("phase", np.degrees(-np.angle(atlas[name].values)), "degrees"),
        )
    }
    axes = {name: atlas[name] for name in ("constituent", "latitude", "longitude")}
    xr.Dataset(parts, axes).to_netcdf(tmp_path / "tide.nc", engine="h5netcdf")
    hours = np.arange(4) * np.timedelta64(24, "h")
    east = np.broadcast_to(np.array([0.1, 0.2, 0.3, 0.2])[:, None, None], (4, 5, 6))
    units = {"units": "m/s"}
    xr.Dataset(
        {
            name: (("time", "lat", "lon"), part, units)
            for name, part in (("uo", east), ("vo", east))
        },
        {
            "time": np.datetime64("2026-06-30", "ns") + hours,
            "lat": np.linspace(45, 49, 5),
            "lon": np.linspace(-8, -3, 6),
        },
    ).to_netcdf(tmp_path / "current.nc", engine="h5netcdf")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    return tmp_path


WHOLE = toml(
    top='name = "container"\nwind_current = [0.01, 10]',
    body='category = "container-2"',
    rest="""
[tides]
files = "t*.nc"
constituents = ["M2", "S2"]
[current]
files = ["current.nc"]
names = ["uo", "vo"]
mean = true
[coast]
file = "land.geojson"
stretches = {north = [-4.3, 47, -3, 48.5], "the south" = [-4.3, 45, -3, 47]}
[wind]
record = "wind.csv"
h = 0.3
[ensemble]
members = 40
keep = 5
outputs_h = 12
[maps]
region = [-8, 46, -4, 48]
cell = 0.5
days = [1, 5]
[targets]
port = [[-5.1, 46.9], [-4.9, 46.9], [-4.9, 47.1]]
""",
)


def configured(text: str) -> dc.GeographicConfiguration:
    return dc.GeographicConfiguration.from_toml(text)


# What a file says is what is forecast


def test_a_file_is_the_same_forecast_as_python(folder: Path) -> None:
    """Each source that a file names, given in Python instead."""
    (folder / "a.toml").write_text(WHOLE, encoding="utf-8")
    read = dc.read_configuration(folder / "a.toml")
    from_file = dc.run(read, folder=folder)
    atlas = dc.tides.from_atlas(folder / "tide.nc", constituents=["M2", "S2"])
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-5.0, 47.0, "2026-07-01T06:00"),
        days=8,
        drifter=dc.objects.leeway("CONTAINER-2"),
        tides=atlas,
        current=dc.currents.from_netcdf(folder / "current.nc").mean(),
        coast=dc.LandCoast.from_file(folder / "land.geojson"),
        wind_current=(0.01, 10.0),
        name="container",
    )
    wind = dc.LocalGridBootstrap.fit(folder / "wind.csv", h=0.3)
    times = np.datetime64("2026-07-01T06:00", "ns") + np.arange(17) * np.timedelta64(12, "h")
    in_python = dc.forecast(
        scenario,
        wind,
        members=40,
        keep=5,
        times=times,
        maps=dc.MapGrid(x=np.arange(-8, -3.5, 0.5), y=np.arange(46, 48.5, 0.5), times=(1.0, 5.0)),  # type: ignore[arg-type]
        targets={"port": [[-5.1, 46.9], [-4.9, 46.9], [-4.9, 47.1]]},
    )
    xr.testing.assert_equal(from_file.dataset, in_python.dataset)
    assert from_file.entry_probability("port").estimate == 1
    assert (from_file.dataset["status"] == 1).any()


def test_what_is_stored_repeats_the_forecast_from_anywhere(folder: Path) -> None:
    first = dc.run(configured(WHOLE), folder=folder)
    text = first.configuration()
    assert str(folder / "tide.nc") in text
    again = dc.run(configured(text))
    xr.testing.assert_equal(again.dataset, first.dataset)
    assert again.configuration() == text


def test_stretches_sum_up_what_strands(folder: Path) -> None:
    forecast = dc.run(configured(WHOLE.replace("members = 40", "members = 200")), folder=folder)
    assert isinstance(forecast, dc.GeographicForecast)
    coast = configured(WHOLE).stretches(folder)
    assert coast is not None
    table = forecast.stranding_by_stretch(coast)
    found = table["probability"]
    when = table.sel(quantile=0.5, stretch="north")
    assert when["time_low"] < when["time_quantile"] < when["time_high"]
    assert table["time_low"].dims == table["time_high"].dims == ("quantile", "stretch")
    assert found["stretch"].values.tolist() == ["north", "the south", "elsewhere"]
    assert found.sum() == pytest.approx(forecast.stranding_probability().estimate)
    assert found.sel(stretch="north") > found.sel(stretch="the south")
    divided = configured(toml(rest='[coast]\nfile = "land.geojson"\ndivide_km = 100'))
    lines = divided.stretches(folder)
    assert lines is not None
    # 2 degrees of latitude and 1.2 of longitude, twice: 222 + 2 * 90 + 222 km.
    assert len(lines.stretch_names) == 6
    assert configured(toml()).stretches(folder) is None


def test_several_releases_and_their_weights(folder: Path) -> None:
    table = '[[releases]]\ncoordinates = {}\nstart = "{}"\n'
    text = (
        'kind = "geographic"\nweights = [3, 1]\ncoast = "none"\n'
        + table.format("[[-5, 47], [-5, 48]]", "2026-07-01").replace(
            "coord", 'kind = "line"\ncoord', 1
        )
        + table.format("[-6, 47]", "2026-07-02T00:00+02:00")
        + "[object]\nresponse_time_h = {kind = 'uniform', low = 1, high = 5}\n"
    )
    read = configured(text)
    scenario = read.scenario(folder)
    places, times, which = scenario.release.sample(0, 400, 1)
    assert np.bincount(which) == pytest.approx([300, 100], abs=2)
    assert set(times) == {np.datetime64("2026-07-01T00"), np.datetime64("2026-07-01T22")}
    assert (places[which == 1] == [-6, 47]).all()
    assert scenario.coast is None
    assert configured(read.to_toml()) == read


# TOML


@pytest.mark.parametrize("text", [WHOLE, toml(), toml(top='tides = "none"\ncoast = "none"')])
def test_toml_gives_the_same_configuration_back(text: str) -> None:
    read = configured(text)
    assert configured(read.to_toml()) == read


def test_toml_explains_every_number() -> None:
    text = dc.GeographicConfiguration.example().to_toml()
    assert text.startswith('kind = "geographic"')
    values = [line for line in text.splitlines() if "=" in line and not line.startswith("[")]
    assert len(values) > 50
    bare = [line for line in values if " # " not in line]
    assert bare == ['kind = "floating-body"', 'kind = "biscay"']
    assert "coordinates = [-4.1, 47.2] #" in text


def test_absent_tables_are_shown_as_comments() -> None:
    """What is told of a table that is absent can be switched on by taking the signs away."""
    text = configured(toml()).to_toml()
    assert "# [[releases]]" in text
    lines = text[text.index("# [maps]") :].splitlines()
    shown = [line.removeprefix("# ") for line in lines[:4]]
    values = {"region": "[-8, 46, -4, 48]", "days": "[1]"}
    for k, line in enumerate(shown):
        name = line.split(" =")[0]
        if name in values:
            shown[k] = f"{name} = {values[name]}"
    maps = configured(toml(rest="\n".join(shown))).maps
    assert maps is not None
    assert (maps.cell, maps.days) == (0.25, (1.0,))


def test_kind_tells_the_two_sorts_of_files_apart(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text("[scenario]\nepsilon = 0.02\n", encoding="utf-8")
    assert isinstance(dc.read_configuration(path), dc.RunConfiguration)
    path.write_text(toml(), encoding="utf-8")
    assert isinstance(dc.read_configuration(path), dc.GeographicConfiguration)
    for text in (toml().replace('kind = "geographic"', ""), toml().replace("graphic", "grafic")):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ScenarioError, match='put kind = "geographic" at the top'):
            dc.read_configuration(path)


def test_example_takes_the_files_and_the_months_of_the_run() -> None:
    example = dc.GeographicConfiguration.example(
        (-4.1, 47.2, "2026-11-20"), 60, "PIW-1", wind="w.csv", tides="t.nc", current="c.nc"
    )
    assert example.wind.months == (1, 11, 12)
    assert (example.wind.record, example.tides.files) == ("w.csv", ("t.nc",))  # type: ignore[union-attr]
    assert example.object.category == "PIW-1"  # type: ignore[union-attr]
    assert dc.GeographicConfiguration.example((0, 0, "2026-01-01")).tides is None


# Refusals

BISCAY = '[tides]\nkind = "biscay"'
REFUSED: dict[str, tuple[str, ...]] = {
    # An object that is not in the table.
    toml(body='category = "LIFERAFT"'): ("object.category: 'LIFERAFT'", "LIFE-RAFT-SB-9"),
    toml(body='kind = "leeway"'): ("object.category: is missing", "driftcore objects"),
    toml(body='kind = "boat"'): ("object.kind: 'boat'", "'floating-body' or 'leeway'"),
    # No release, two, one on land, one outside the data, with its numbers exchanged.
    'kind = "geographic"\n[object]\nresponse_time_h = 1': ("release: is missing", "[[releases]]"),
    toml(rest='[[releases]]\ncoordinates = [-4, 47]\nstart = "2026-07-01"'): ("beside releases",),
    toml(release='coordinates = [-2, 48]\nstart = "2026-07-01"'): ("lies on land", "km from the"),
    toml(release='coordinates = [47, -5]\nstart = "2026-07-01"', rest=BISCAY): (
        "release: (47.0000, -5.0000) lies outside the data",
        "longitudes -10.00 to 0.00",
    ),
    toml(release='coordinates = [-5, 147]\nstart = "2026-07-01"'): ("147", "less than or equal"),
    toml(release='coordinates = [-5, 47]\nstart = "yesterday"'): ("release.start: 'yesterday'",),
    # Files that are not there, or something else.
    toml(rest='[tides]\nfiles = "no.nc"'): ("tides.files: 'no.nc'", "no such file"),
    toml(rest='[tides]\nfiles = "wind.csv"'): ("[tides]", "cannot be read as NetCDF"),
    toml(rest='[tides]\nkind = "tpxo"'): ("tides.kind: 'tpxo'", "'atlas' or 'biscay'"),
    toml(rest='[current]\nfiles = "."'): ("current.files: '.'", "is a folder"),
    toml(rest='[current]\nfiles = "current.nc"\nnames = ["u", "v"]'): ("[current] names:", "'uo'"),
    toml(rest='[current]\nfiles = "current.nc"'): ("current: it covers", "mean = true"),
    toml(rest='[current]\nfiles = "current.nc"\ndetide = true'): ("[current] time: the tide",),
    toml(rest='[coast]\nfile = "no.geojson"'): ("coast.file: 'no.geojson'", "no such file"),
    toml(rest='[coast]\nfile = "land.geojson"\nname_column = "n"'): ("[coast] name_column: 'n'",),
    toml(rest=f'[coast]\nfile = "{"n" * 5000}"'): ("coast.file: 'nnn", "File name too long"),
    toml(rest='[coast]\nname_column = "n"'): ("[coast] name_column: 'n'", "has no names"),
    toml(rest="[coast]\nstretches = {a = [0, 1, 1, 0]}"): ("coast.stretches.a", "south"),
    toml(rest="[coast]\ndivide_km = 9\nstretches = {a = [0, 0, 1, 1]}"): ("coast.divide_km",),
    toml(rest='[wind]\nrecord = "w.csv"'): ("wind.record: 'w.csv'", "no such file"),
    # Keys and numbers.
    toml(top="dayz = 5"): ("dayz: unknown key", "'days'"),
    toml(rest="[ensemble]\nwindow = 0.1"): ("ensemble.window: unknown key",),
    toml(rest='[ensemble]\nmodel = "paper"'): ("ensemble.model: 'paper'", "'full'"),
    toml(rest='[ensemble]\nmodel = "full"\norder = 1'): ("ensemble.order: 1",),
    toml(rest="[ensemble]\nmembers = 100000000\nkeep = 100000000"): ("ensemble.keep", "1e+09"),
    toml(rest="[maps]\nregion = [-8, 44, 0, 49.1]\ndays = [1]"): ("maps.region: 5.1 degrees",),
    toml(rest="[maps]\nregion = [-8, 44, 0, 49]\ndays = [9]"): ("maps.days: 9", "8 days"),
    toml(rest="[targets]\nport = [[1, 2], [3, 4]]"): ("targets.port", "at least 3"),
}


@pytest.mark.parametrize(("text", "words"), REFUSED.items())
def test_refusals_name_field_value_and_what_is_accepted(
    folder: Path, text: str, words: tuple[str, ...]
) -> None:
    with pytest.raises(DriftCoreError) as told:
        configured(text).scenario(folder)
    for word in words:
        assert word in str(told.value)
    assert not str(told.value).startswith(".")
    assert ".." not in str(told.value)


def test_a_wind_of_other_months_is_told(folder: Path) -> None:
    text = toml(rest='[wind]\nrecord = "wind.csv"\nh = 0.3').replace("2026-07", "2026-11")
    with pytest.warns(DriftCoreWarning, match="the run starts in month 11"):
        planned(configured(text), folder)(members=1)


def test_doubts_are_what_no_real_forecast_would_have() -> None:
    def doubts(text: str) -> list[str]:
        return [doubt.split(":")[0] for doubt in configured(text).doubts()]

    paper_like = toml(body="response_time_h = 1", top='coast = "none"')
    assert doubts(paper_like) == ["wind", "tides", "coast", "object.wind_factor"]
    assert doubts(WHOLE) == []
    assert doubts(toml(rest=BISCAY + '\n[wind]\nrecord = "w.csv"')) == ["tides"]
    law = "response_time_h = 1\nwind_factor = {kind = 'uniform', low = 0.2, high = 0.4}"
    assert doubts(toml(body=law))[-1] == "object.wind_factor"


def test_tides_leave_warnings_as_they_are() -> None:
    """A library that the tides need silences the warnings of everybody who imports it."""
    before: list[Any] = list(warnings.filters)
    dc.tides.biscay()
    assert warnings.filters == before


@pytest.mark.parametrize(
    ("region", "cell", "message"),
    [
        ((-6.0, 44.0, -1.0, 48.0), 4.8e-7, "cell: 4.8e-07 is not accepted"),
        ((-6.0, 44.0, -1.0, 48.0), 5.6e-309, "cell: 5.6"),
        ((6.0, 44.0, -1.0, 48.0), 5.6e-309, "region: "),
    ],
)
def test_absurd_cells_are_refused(
    region: tuple[float, float, float, float], cell: float, message: str
) -> None:
    from driftcore.geographic_configuration import MapConfiguration

    with pytest.raises(dc.ScenarioError, match=message):
        MapConfiguration(region=region, cell=cell, days=(5.0,))


def test_a_scenario_without_a_coast_has_none() -> None:
    assert configured(toml()).replace(coast=None).divided_coast() is None
