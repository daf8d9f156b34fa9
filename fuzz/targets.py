"""What is fed, and what must hold of what is accepted: one target for each way in."""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import driftcore as dc
from driftcore import _core
from driftcore.geographic_configuration import GeographicConfiguration
from driftcore.grids import read_vector_grid, read_wind_grid
from driftcore.scenario import RunConfiguration
from driftcore.tides import from_atlas

# Numbers at which something changes, for somebody.
NUMBERS = [
    *(0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 1e-3, 1e3, 1e6, 1e9, 1e12, 1e15, 1e18, 1e-9, 1e-15),
    *(1e300, -1e300, 1e-300, 1.7976931348623157e308, 5e-324, 2.2250738585072014e-308),
    *(math.inf, -math.inf, math.nan, 90.0, -90.0, 180.0, -180.0, 360.0, 361.0, 89.9999, 1e-12),
]
WHOLE = [0, 1, -1, 2, 3, 12, 13, 255, 256, 2**31, 2**32, 2**53, 2**63 - 1, 2**63, 2**64, 10**30]
WORDS = ["", "none", "paper", "full", "embedded", "é\u0000", "x" * 300, "1", "nan", "[]", "*", ".."]


@dataclass(frozen=True)
class Target:
    """A way in: `make` gives a case from random numbers, `run` feeds it."""

    name: str
    make: Callable[[Random], Any]
    run: Callable[[Any], None]
    # What refuses beside `DriftCoreError`.
    refusals: tuple[type[Exception], ...] = ()
    prepare: Callable[[], object] = field(default=lambda: None)


def number(rng: Random) -> float:
    """Give a number, a hostile one now and then."""
    kind = rng.random()
    if kind < 0.3:
        return rng.choice(NUMBERS)
    if kind < 0.5:
        return float(rng.randint(-3, 30))
    return rng.choice([-1, 1]) * 10 ** rng.uniform(-6, 6)


def mutated_bytes(rng: Random, data: bytes) -> bytes:
    """Flip, insert, remove, repeat and cut bytes."""
    changed = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 4, 16])):
        at = rng.randrange(len(changed) + 1)
        kind = rng.randrange(6)
        if kind == 0 and at < len(changed):
            changed[at] ^= 1 << rng.randrange(8)
        elif kind == 1 and at < len(changed):
            changed[at] = rng.choice([0, 255, 127, 128, rng.randrange(256)])
        elif kind == 2:
            changed[at:at] = bytes(rng.randrange(256) for _ in range(rng.randrange(9)))
        elif kind == 3:
            del changed[at : at + rng.choice([1, 2, 8, 64])]
        elif kind == 4:
            changed[at:at] = changed[at : at + rng.choice([1, 8, 64, 512])]
        elif rng.random() < 0.1:
            del changed[at:]
        else:
            width = rng.choice([1, 2, 4, 8])
            value = rng.choice(WHOLE) % 256**width
            changed[at : at + width] = value.to_bytes(width, rng.choice(["little", "big"]))
    return bytes(changed)


def mutated(rng: Random, value: Any, depth: int = 0) -> Any:
    """Change one place or several of a tree of lists and tables."""
    kind = rng.random()
    if kind < 0.02 or (depth and kind < 0.1):
        return hostile(rng)
    if isinstance(value, dict) and value:
        changed = dict(value)
        key = rng.choice(list(changed))
        if kind < 0.15:
            del changed[key]
        elif kind < 0.2:
            changed[rng.choice([*WORDS, *changed])] = changed[key]
        elif kind < 0.25:
            changed[rng.choice(list(changed))] = changed[key]
        else:
            changed[key] = mutated(rng, changed[key], depth + 1)
        return changed
    if isinstance(value, list) and value:
        changed_list = list(value)
        at = rng.randrange(len(value))
        if kind < 0.15:
            del changed_list[at]
        elif kind < 0.25:
            changed_list[at:at] = [changed_list[at]] * rng.choice([1, 2, 50])
        else:
            changed_list[at] = mutated(rng, value[at], depth + 1)
        return changed_list
    if isinstance(value, bool | str):
        return hostile(rng)
    if isinstance(value, int) and kind < 0.7:
        return rng.choice([rng.choice(WHOLE), rng.randint(-2, 40)])
    if isinstance(value, float) and kind < 0.8:
        return rng.choice([number(rng), value * number(rng), -value])
    return hostile(rng)


def hostile(rng: Random) -> Any:
    """Give what nobody asked for."""
    return rng.choice(
        [
            lambda: number(rng),
            lambda: rng.choice(WHOLE),
            lambda: rng.choice(WORDS),
            lambda: rng.random() < 0.5,
            list,
            dict,
            lambda: [[[number(rng)]]],
            lambda: [number(rng), number(rng)],
            lambda: [[number(rng), number(rng)] for _ in range(rng.randrange(6))],
            lambda: {"kind": rng.choice(WORDS)},
            lambda: datetime(rng.choice([1, 1677, 1970, 2026, 2262, 2263, 9999]), 1, 1),
        ]
    )()


@cache
def scratch() -> Path:
    """Give a folder in memory, where there is one, for the files of a process."""
    shm = Path("/dev/shm")  # noqa: S108
    return Path(tempfile.mkdtemp(prefix="driftcore-fuzz-", dir=shm if shm.is_dir() else None))


@contextlib.contextmanager
def file_of(data: bytes, suffix: str) -> Any:
    """Give a file that holds `data`, and remove it."""
    path = scratch() / f"{os.getpid()}{suffix}"
    path.write_bytes(data)
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)


def require(holds: object, what: str) -> None:
    """Complain of what was accepted and is not sane."""
    if not holds:
        raise AssertionError(what)


# TOML

PAPER: dict[str, Any] = {
    "scenario": {
        "name": "paper",
        "epsilon": 0.02,
        "duration": 1.0,
        "drag": 1.0,
        "position": [1.0, 1.0],
        "velocity": [0.0, 0.0],
        "wind_unit": 3.0,
        "tide_period_h": 12.5,
        "side": "inside",
        "sea": {
            "kind": "academic",
            "tide": {
                "mean": 2.0,
                "modulation": 1.0,
                "wave": "sin",
                "cycles": 3.0,
                "proportional_to": "x",
                "harmonics": [[1.0, 0.5], [0.25, 0.0]],
            },
            "residual": {"wave": "cos", "proportional_to": "y", "harmonics": [[1.0, 1.0]]},
        },
        "coast": {"kind": "circle", "center": [1.0, 1.0], "radius": 0.3},
    },
    "wind": {"record": "embedded", "months": [6, 7, 8], "order": 2, "h": 0.4, "share": 0.1},
    "ensemble": {
        "members": 16,
        "seed": 1,
        "model": "mean-flow",
        "rtol": 1e-6,
        "keep": 4,
        "outputs_per_tide": 2.0,
    },
    "maps": {"x": [0.0, 1.0, 2.0], "y": [0.0, 1.0, 2.0], "times": [0.5, 1.0], "interval": 0.01},
    "targets": {"a": [[0.9, 0.9], [1.1, 0.9], [1.1, 1.1]]},
}
SEA: dict[str, Any] = {
    "kind": "geographic",
    "name": "drift",
    "days": 10.0,
    "wind_current": [0.02, 10.0],
    "release": {
        "kind": "polygon",
        "coordinates": [[-4.2, 47.1], [-4.0, 47.1], [-4.0, 47.3]],
        "start": datetime(2026, 7, 1, 6),
        "end": datetime(2026, 7, 1, 9),
        "radius_m": 100.0,
        "position_error_m": 100.0,
        "time_error_h": 1.0,
        "contained_percent": 95.0,
    },
    "object": {
        "kind": "floating-body",
        "response_time_h": {"kind": "lognormal", "center": 1.0, "spread": 0.3, "high": 5.0},
        "wind_factor": 0.03,
    },
    "tides": {"kind": "biscay"},
    "coast": {"divide_km": 100.0},
    "wind": {"record": "embedded", "months": [7]},
    "ensemble": {"members": 10, "seed": 1, "model": "mean-flow", "outputs_h": 3.0, "keep": 10},
    "maps": {"region": [-6.0, 44.0, -1.0, 48.0], "cell": 0.25, "days": [5.0, 10.0]},
    "targets": {"a": [[-4.5, 47.0], [-4.0, 47.0], [-4.0, 47.5]]},
}
OTHER_SEA: dict[str, Any] = {
    "kind": "geographic",
    "releases": [
        {"kind": "line", "coordinates": [[-4.2, 47.1], [-4.0, 47.1]], "start": "2026-07-01"},
        {"coordinates": [-4.1, 47.2], "start": "2026-07-01T06:00Z"},
    ],
    "weights": [1.0, 2.0],
    "object": {"kind": "leeway", "category": "PIW-1", "jibing_per_hour": 0.04},
    "tides": {"kind": "atlas", "files": ["m2.nc"], "units": "cm/s", "constituents": ["M2"]},
    "current": {"files": "c*.nc", "names": ["u", "v"], "region": [-6.0, 44.0, -1.0, 48.0]},
    "coast": {"file": "land.gpkg", "stretches": {"a": [-6.0, 44.0, -1.0, 48.0]}},
    "wind": {"record": "wind.csv", "gaps": "segment", "mode": "lgb", "b": 0.1},
    "ensemble": {"order": 1, "rtol": 1e-6},
}


def toml_of(value: Any) -> str:
    """Write a value in TOML, tables inline."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {toml_of(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml_of, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, bool):
        return str(value).lower()
    return value.isoformat() if isinstance(value, datetime) else repr(value)


def _key(name: str) -> str:
    return json.dumps(name)


def make_toml(rng: Random) -> bytes:
    """Give a scenario file with some values changed, and some bytes."""
    tree = rng.choice([PAPER, PAPER, SEA, OTHER_SEA])
    for _ in range(rng.choice([0, 1, 1, 1, 2, 3])):
        tree = mutated(rng, tree)
        if not isinstance(tree, dict):
            tree = {"scenario": tree}
    text = "".join(f"{_key(name)} = {toml_of(value)}\n" for name, value in tree.items())
    data = text.encode()
    return mutated_bytes(rng, data) if rng.random() < 0.25 else data


def run_toml(data: bytes) -> None:
    """Read it; what is accepted is written and read back the same, now and then."""
    with file_of(data, ".toml") as path:
        configuration = dc.read_configuration(path)
    require(isinstance(configuration, RunConfiguration | GeographicConfiguration), "another type")
    if zlib.crc32(data) % 20 == 0:
        again = type(configuration).from_toml(configuration.to_toml())
        require(again == configuration, "written to TOML it reads back as another")
    elif isinstance(configuration, GeographicConfiguration):
        configuration.rooted(scratch())


# Wind records


@cache
def wind_csv() -> bytes:
    """Give a good record."""
    times = pd.date_range("2001-06-01", periods=120, freq="6h", tz="UTC")
    values = np.random.default_rng(1).normal(0, 5, (120, 2)).round(2)
    frame = pd.DataFrame(values, times.strftime("%Y-%m-%dT%H:%M:%SZ"), ["u10", "v10"])
    return frame.to_csv(index_label="time").encode()


def make_csv(rng: Random) -> bytes:
    """Give a record with lines and cells changed, and some bytes."""
    lines = wind_csv().decode().splitlines()[: rng.choice([1, 2, 3, 10, 121])]
    rows = [line.split(",") for line in lines]
    for _ in range(rng.choice([0, 1, 1, 2, 5])):
        row = rng.randrange(len(rows))
        kind = rng.random()
        if kind < 0.5 and rows[row]:
            cell = rng.randrange(len(rows[row]))
            odd = ["", "NaT", "1994-06-31", "99999-01-01", "06/01/1994", "--", "1e400", '"', "0x1"]
            odd += ["2001-06-01T00:00:00+23:59", "0001-01-01", "1677-01-01", "\x00", "9" * 400]
            rows[row][cell] = rng.choice([*odd, repr(number(rng)), str(rng.choice(WHOLE))])
        elif kind < 0.6:
            rows[row] = rows[row][: rng.randrange(4)]
        elif kind < 0.7:
            rows[row] = rows[row] + ["1"] * rng.choice([1, 3, 50])
        elif kind < 0.8:
            rows[row], rows[-1] = rows[-1], rows[row]
        elif kind < 0.9:
            rows.insert(row, rows[row])
        elif len(rows) > 1:
            del rows[row]
    data = "\n".join(",".join(row) for row in rows).encode()
    return mutated_bytes(rng, data) if rng.random() < 0.3 else data


def check_record(record: dc.WindRecord) -> None:
    """Require that a record is regular and finite."""
    require(np.isfinite(record.velocity).all(), "a velocity that is not finite")
    require(len(record) == len(record.velocity) >= 1, "lengths differ")
    require((np.diff(record.times) > np.timedelta64(0)).all(), "times that do not increase")
    require(24 / record.step_h % 1 == 0, "a step that does not divide the day")
    record.describe()


def run_csv(data: bytes) -> None:
    """Read it, as a whole or some months with gaps."""
    with file_of(data, ".csv") as path:
        check_record(dc.read_record(path))
        check_record(dc.read_record(path, months=(6, 7), gaps="segment"))


# NetCDF in memory


def odd_values(rng: Random, shape: tuple[int, ...]) -> Any:
    """Give an array of some type and shape."""
    size = math.prod(shape)
    values = np.array([number(rng) for _ in range(size)]).reshape(shape)
    kind = rng.choice(
        ["f8", ">f8", "f4", "i2", "u1", "O", "M8[ns]", "m8[ns]", "S3", "U3", "?", "c"]
    )
    with np.errstate(all="ignore"):
        if kind == "M8[ns]":
            return np.datetime64("2001-01-01", "ns") + np.arange(size).reshape(shape)
        if kind == "m8[ns]":
            return np.arange(size).reshape(shape).astype("m8[ns]")
        if kind == "c":
            return values.astype(complex)
        return values.astype(kind)


ATTRIBUTES = {
    "units": ["m/s", "cm/s", "knots", "", "degrees", "hours since 2001-06-01", 3, b"m/s", [1, 2]],
    "_FillValue": [0.0, math.nan, -9999.0, 1, "x", 1e300],
    "missing_value": [0.0, [1.0, 2.0], "x"],
    "scale_factor": [0.0, 1e300, -1.0, "x", math.nan],
    "add_offset": [1e300, math.inf, "x"],
    "calendar": ["noleap", "standard", "360_day", 5, "julian"],
    "standard_name": ["eastward_wind", "longitude", "x_wind", "time", 5],
    "axis": ["X", "Z", 7],
    "positive": ["up"],
    "grid_mapping": ["u10", "crs", "x" * 50],
    "coordinates": ["lon lat", "u10", "time time", 5],
    "bounds": ["u10", "nowhere"],
    "dtype": ["bool", "O"],
    "_Unsigned": ["true", 1],
}


def mutated_dataset(rng: Random, dataset: xr.Dataset) -> xr.Dataset:
    """Change variables, axes, attributes and dimensions of a dataset, in memory."""
    for _ in range(rng.choice([0, 1, 1, 1, 2, 3])):
        names = [str(name) for name in dataset.variables]
        if not names:
            break
        name = rng.choice(names)
        variable = dataset[name].variable
        kind = rng.randrange(10)
        # What xarray itself does not make is no case.
        with contextlib.suppress(
            *(ValueError, LookupError, TypeError, OverflowError, AttributeError)
        ):
            if kind == 0:
                dataset = dataset.drop_vars(name)
            elif kind == 1:
                dataset = dataset.rename({name: rng.choice([*names, "lon", "u", "time", "é", "x"])})
            elif kind in (2, 3):
                key = rng.choice(list(ATTRIBUTES))
                dataset = dataset.copy()
                dataset[name].attrs[key] = rng.choice(ATTRIBUTES[key])
            elif kind == 4:
                values = odd_values(rng, variable.shape)
                dataset = dataset.assign({name: (variable.dims, values, variable.attrs)})
            elif kind in (5, 6) and variable.size and variable.dtype.kind in "fi":
                values = np.array(variable.values, dtype=float)
                values.flat[rng.randrange(values.size)] = number(rng)
                dataset = dataset.assign({name: (variable.dims, values, variable.attrs)})
            elif kind == 7 and dataset.sizes:
                dim = rng.choice(list(dataset.sizes))
                keep = rng.choice([slice(0, 0), slice(0, 1), slice(None, None, -1), 0, slice(1, 3)])
                dataset = dataset.isel({dim: keep})
            elif kind == 8 and dataset.sizes:
                dataset = dataset.rename({rng.choice(list(dataset.sizes)): rng.choice(WORDS[1:])})
            elif kind == 9:
                if rng.random() < 0.5:
                    dataset = dataset.expand_dims(
                        {rng.choice(["depth", "z", "m"]): rng.choice([1, 2])}
                    )
                else:
                    dataset = dataset.transpose(*reversed(list(dataset.sizes)))
    return dataset


@cache
def grid(kind: str) -> xr.Dataset:
    """Give a good dataset of each kind that is read."""
    rng = np.random.default_rng(3)
    longitude, latitude = np.linspace(-6, -3, 7), np.linspace(45, 47, 5)
    axes: dict[str, Any] = {
        "latitude": ("latitude", latitude, {"units": "degrees_north"}),
        "longitude": ("longitude", longitude, {"units": "degrees_east"}),
    }
    space = ("latitude", "longitude")
    if kind == "atlas":
        parts = {}
        for component in "uv":
            parts[f"{component.upper()}a"] = (
                ("con", *space),
                rng.uniform(10, 50, (2, 5, 7)),
                {"units": "cm/s"},
            )
            parts[f"{component.upper()}g"] = (
                ("con", *space),
                rng.uniform(0, 360, (2, 5, 7)),
                {"units": "degrees"},
            )
        return xr.Dataset(parts, {**axes, "con": ["m2", "s2"]})
    about = {"units": "hours since 2001-06-01 00:00:00", "calendar": "standard"}
    time = ("time", np.arange(0, 48, 6.0), about)
    names = {"wind": ("u10", "v10"), "current": ("uo", "vo"), "record": ("u10", "v10")}[kind]
    if kind == "record":
        values = {n: ("time", rng.normal(0, 3, 8), {"units": "m s-1"}) for n in names}
        return xr.decode_cf(xr.Dataset(values, {"time": time}))
    values = {
        n: (("time", *space), rng.normal(0, 0.5, (8, 5, 7)), {"units": "m s-1"}) for n in names
    }
    return xr.Dataset(values, {**axes, "time": time})


def make_dataset(rng: Random) -> tuple[str, xr.Dataset, dict[str, Any]]:
    """Give a reader's dataset, changed, and options for it."""
    # An atlas takes as long as five of the others.
    kind = rng.choice(["wind", "current", "record"] * 3 + ["atlas"])
    dataset = mutated_dataset(rng, grid(kind))
    options: dict[str, Any] = {}
    if kind in ("wind", "current") and rng.random() < 0.4:
        box = (number(rng), number(rng), number(rng), number(rng))
        if rng.random() < 0.5:
            box = (-5.5, -3.5, 45.2, 46.8)
        options["region"] = box
    if kind in ("wind", "current") and rng.random() < 0.1:
        options["period"] = rng.choice([("2001-06-01", "2001-06-02"), ("x", 5), ("2001", "1999")])
    return kind, dataset, options


def check_grid(read: Any) -> None:
    """Require that a grid is regular, and finite where it is not missing."""
    require(read.u.shape == (len(read.times), len(read.latitude), len(read.longitude)), "shape")
    require(not np.isinf(read.u).any() and not np.isinf(read.v).any(), "infinite values")
    require((np.isnan(read.u) == np.isnan(read.v)).all(), "one component missing")
    require((np.diff(read.longitude) > 0).all() and np.ptp(read.longitude) <= 360, "longitudes")
    require(
        (np.diff(read.latitude) > 0).all() and np.abs(read.latitude).max() < 90.001, "latitudes"
    )
    require((np.diff(read.times) > np.timedelta64(0)).all(), "times that do not increase")
    read.describe()


def feed(kind: str, source: Any, options: dict[str, Any]) -> None:
    """Read by the reader of a kind."""
    if kind == "wind":
        check_grid(read_wind_grid(source, **options))
    elif kind == "current":
        check_grid(read_vector_grid(source, "current", **options))
    elif kind == "record":
        check_record(dc.read_record(source, **options))
    else:
        atlas = from_atlas(source, **options)
        values = np.stack([atlas.dataset[name].values for name in "uv"])
        require(not np.isinf(values).any(), "infinite values")
        repr(atlas)


def run_dataset(case: tuple[str, xr.Dataset, dict[str, Any]]) -> None:
    """Read it."""
    feed(*case)


# NetCDF files


@cache
def netcdf(kind: str, form: str) -> bytes:
    """Give a good file: NetCDF-4 (HDF5), or NetCDF-3."""
    path = scratch() / f"good{os.getpid()}.nc"
    if kind == "forecast":
        calm = dc.WindPath([-1.0, 2.0], np.zeros((2, 2)))
        scenario = dc.paper.scenario(epsilon=0.2)
        dc.forecast(scenario, [calm] * 3, times=[0.0, 1.0]).to_netcdf(path, overwrite=True)
    elif form == "4":
        grid(kind).to_netcdf(path, engine="h5netcdf")
    else:
        grid(kind).to_netcdf(path, engine="scipy", format="NETCDF3_64BIT")
    data = path.read_bytes()
    path.unlink()
    return data


def make_netcdf(rng: Random) -> bytes:
    """Give the bytes of a file, changed; the first two tell the reader."""
    kind = rng.choice(["wind", "current", "record"] * 3 + ["atlas", "forecast", "forecast"])
    form = "4" if kind == "forecast" else rng.choice("34")
    data = netcdf(kind, form)
    return kind[:2].encode() + mutated_bytes(rng, data)


def run_netcdf(data: bytes) -> None:
    """Read it by the reader that its first bytes name."""
    kinds = {name[:2]: name for name in ("wind", "current", "record", "atlas", "forecast")}
    kind = kinds[data[:2].decode()]
    with file_of(data[2:], ".nc") as path:
        if kind == "forecast":
            forecast = dc.open_forecast(path)
            check_forecast(forecast)
        else:
            feed(kind, path, {})


def check_forecast(forecast: dc.Forecast) -> None:
    """Require that what is told of a forecast are probabilities."""
    if forecast.followed:
        p = forecast.stranding_probability()
        require(0 <= p.low <= p.estimate <= p.high <= 1, f"no probabilities: {p}")
    repr(forecast)


# Coasts

LAND: dict[str, Any] = {
    "type": "FeatureCollection",
    "features": [
        {
            "type": "Feature",
            "properties": {"name": "a"},
            "geometry": {
                "type": "Polygon",
                "coordinates": [
                    [[-2.0, 46.0], [-1.0, 46.0], [-1.0, 47.0], [-2.0, 47.0], [-2.0, 46.0]],
                    [[-1.8, 46.2], [-1.2, 46.2], [-1.2, 46.8], [-1.8, 46.2]],
                ],
            },
        },
        {
            "type": "Feature",
            "properties": None,
            "geometry": {
                "type": "MultiPolygon",
                "coordinates": [[[[179.0, 1.0], [-179.0, 1.0], [-179.0, 2.0], [179.0, 1.0]]]],
            },
        },
    ],
}


def make_geojson(rng: Random) -> bytes:
    """Give a map, changed."""
    tree: Any = LAND
    if rng.random() < 0.2:
        tree = rng.choice(LAND["features"])
    for _ in range(rng.choice([0, 1, 1, 2, 3])):
        tree = mutated(rng, tree)
    if rng.random() < 0.1 and isinstance(tree, dict):
        systems = ["EPSG:3857", "EPSG:32630", "x", 5, "", "+proj=merc", None]
        tree = {**tree, "crs": {"properties": {"name": rng.choice(systems)}}}
    data = json.dumps(tree, default=str).encode()
    return mutated_bytes(rng, data) if rng.random() < 0.3 else data


def run_geojson(data: bytes) -> None:
    """Read it, cut it, make the core's coast of it."""
    with file_of(data, ".geojson") as path:
        land = dc.LandCoast.from_file(path)
    require(len(land) > 0, "no land")
    cut = land.cut(-3.0, 0.0, 45.0, 48.0)
    rings = cut.rings()
    require(all(np.isfinite(ring).all() for ring in rings), "coordinates that are not finite")
    if rings:
        coast = _core.Coast.polygons([np.ascontiguousarray(ring) for ring in rings], False)
        require(math.isfinite(coast.clearance(-1.5, 46.5)), "no clearance")


# Whole forecasts


def make_forecast(rng: Random) -> dict[str, Any]:
    """Give a scenario of the paper, changed but for how much is followed, and a wind."""
    tree = {name: PAPER[name] for name in ("scenario", "maps", "targets")}
    for _ in range(rng.choice([1, 1, 2, 3, 5])):
        part = rng.choice(["scenario", "scenario", "scenario", "maps", "targets"])
        tree = {**tree, part: mutated(rng, tree[part])}
    if rng.random() < 0.5:
        del tree["maps"]
    if rng.random() < 0.5:
        del tree["targets"]
    models = [("mean-flow", None), ("mean-flow", 2), ("full", None), ("paper", None), ("paper", 0)]
    model, order = rng.choice(models)
    speed = rng.choice([0.0, 1.0, 3.0, 30.0, abs(number(rng))])
    tree["options"] = {
        "model": model,
        "order": order,
        "rtol": rng.choice([1e-6, 1e-6, 1e-3, 1e-9, number(rng)]),
        "keep": rng.choice([0, 1, 3]),
        "threads": rng.choice([1, 1, 2]),
        "seed": rng.choice([0, 1, 2**63, 2**64 - 1]),
        "steps_per_tide": rng.choice([None, None, None, 8.0, number(rng)]),
        "times": rng.choice([None, [0.0, 1.0], [0.5], [number(rng)]]),
        "window": rng.choice([None, None, None, number(rng)]),
    }
    tree["wind"] = (
        rng.choice(["paths", "list", "drawn"]),
        speed if math.isfinite(speed) else 1e300,
    )
    return tree


@cache
def drawn() -> Any:
    """Fit a wind, once for all."""
    return dc.LocalGridBootstrap.fit(dc.climate.synthetic_record(2), h=0.4)


def run_forecast(tree: dict[str, Any]) -> None:
    """Follow three members; nobody is afloat at no place, and what is counted adds up."""
    parts = {name: value for name, value in tree.items() if name in ("scenario", "maps", "targets")}
    configuration = RunConfiguration(**parts)
    scenario, (kind, speed) = configuration.scenario, tree["wind"]
    # What is asked for is followed, however long it takes: here it should not.
    if scenario.duration / scenario.epsilon > 1000:
        return
    span = max(8 * scenario.epsilon, 0.1 * scenario.duration)
    times = np.linspace(-span, scenario.duration + span, 40)
    velocity = speed * np.random.default_rng(1).uniform(-1, 1, (3, 40, 2))
    winds: Any = dc.WindPaths(times, velocity)
    if kind == "list":
        winds = [dc.WindPath(times, values) for values in velocity]
    elif kind == "drawn":
        winds = drawn()
    options = {name: value for name, value in tree["options"].items() if value is not None}
    forecast = dc.forecast(
        scenario,
        winds,
        members=3,
        maps=configuration.maps,
        targets=configuration.targets,
        **options,
    )
    check_forecast(forecast)
    data = forecast.dataset
    status = data["status"].values
    stranded = status == 1
    require((np.isfinite(data["stranding_time"].values) == stranded).all(), "time of stranding")
    places = data["stranding_position"].values
    require((np.isfinite(places).all(axis=1) == stranded).all(), "place of stranding")
    kept = data["position"].values
    afloat = kept[status[: len(kept)] == 0]
    require(np.isfinite(afloat).all(), "afloat where no place is")
    if configuration.maps is not None and forecast.followed:
        total = data["presence"].sum(("y", "x")) + data["outside"] + data["ashore"]
        require(np.allclose(total, 1), f"maps add up to {total.values}")


# The compiled core


def array(rng: Random, shape: tuple[int, ...], kind: str = "f8") -> Any:
    """Give an array that fits, most often."""
    generator = np.random.default_rng(rng.getrandbits(32))
    values: Any = generator.normal(0, 1, shape)
    if kind == "c16":
        values = values + 1j * generator.normal(0, 1, shape)
    elif kind != "f8":
        values = np.sort(np.abs(10 * values), axis=None).reshape(shape).astype(kind)
    odd = rng.randrange(200)
    if odd == 0:
        return values[..., None]
    if odd == 1:
        return values.astype(rng.choice(["f4", ">f8", "O", "i4", "U4", "?", "c8"]))
    if odd == 2:
        return np.repeat(values, 2, axis=0)[::2]
    if odd == 3:
        return np.asfortranarray(values)
    if odd == 4:
        return values[::-1]
    if odd == 5:
        return values[:0]
    if odd == 6 and values.size and kind in ("f8", "c16"):
        values.flat[rng.randrange(values.size)] = rng.choice(NUMBERS)
        return values
    if odd == 7:
        return values * rng.choice([1e300, 1e-300, 0.0])
    if odd == 8:
        values.flags.writeable = False
        return values
    if odd == 9:
        return rng.choice([None, 3.0, "x", [], values.tolist(), np.array(1.0)])
    if odd == 10:
        return np.broadcast_to(np.float64(1.0), (*shape[:-1], 10**6))
    return values


def times_array(rng: Random, end: float = 1.0) -> Any:
    """Give increasing times, most often."""
    values = array(rng, (rng.choice([1, 2, 5, 40]),))
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and rng.random() < 0.95:
        values = np.sort(np.abs(values)) / 3 * end
    return values


def real(rng: Random, usual: float) -> Any:
    """Give about the usual number, most often."""
    odd = rng.random()
    if odd < 0.02:
        return number(rng)
    if odd < 0.023:
        return hostile(rng)
    return usual * rng.uniform(0.5, 2)


def count(rng: Random, usual: int) -> Any:
    """Give the usual number, most often."""
    odd = rng.random()
    return hostile(rng) if odd < 0.003 else rng.choice(WHOLE) if odd < 0.02 else usual


def core_sea(rng: Random, period: Any) -> Any:
    """Make a sea of some kind."""
    kind = rng.randrange(4)
    if kind == 0:
        current = (real(rng, 2), real(rng, 1), real(rng, 3), real(rng, 0.1), count(rng, 0))
        parts = [(current, array(rng, (2, 2))) for _ in range(2)]
        return _core.Sea.academic(period, *parts, real(rng, 0.02))
    sizes = [rng.choice([1, 4, 6]) for _ in range(3)]
    axes = [(real(rng, -5), real(rng, 3), count(rng, n)) for n in sizes]
    x, y, time = (1 if n == 1 else n + 2 for n in sizes)
    if kind == 1:
        values = array(rng, (time, y, x, 4), "c16")
        return _core.Sea.gridded(period, axes, count(rng, rng.choice([0, 1, 2])), values)
    if kind == 2:
        lines = [(real(rng, 300), count(rng, 2)), (real(rng, 310), count(rng, 2))]
        values = array(rng, (time, y, x, 4), "c16")
        return _core.Sea.constituents(period, axes, lines, values)
    return _core.Sea.sum([core_sea(rng, period) for _ in range(rng.choice([0, 1, 2]))])


def core_coast(rng: Random) -> Any:
    """Make a coast, or none."""
    if rng.random() < 0.3:
        return None
    if rng.random() < 0.5:
        return _core.Coast.circle((real(rng, 1), real(rng, 1)), real(rng, 2), rng.random() < 0.5)
    rings = [array(rng, (rng.choice([2, 3, 8]), 2)) for _ in range(rng.choice([0, 1, 2]))]
    return _core.Coast.polygons(rings, rng.random() < 0.5)


def core_solver(rng: Random) -> Any:
    """Make a solver."""
    euler = rng.choice([None, None, None, real(rng, 0.01)])
    tolerances = (real(rng, 1e-4), real(rng, 1e-4))
    kind = rng.randrange(3)
    if kind == 0:
        return _core.Solver.full(rng.random() < 0.5, *tolerances, euler)
    if kind == 1:
        return _core.Solver.mean_flow(count(rng, rng.choice([1, 2])), *tolerances, euler)
    order = count(rng, rng.choice([0, 1]))
    return _core.Solver.paper(order, real(rng, 0.01), rng.random() < 0.5, *tolerances, euler)


@cache
def bootstrap_arguments() -> list[Any]:
    """Give what a bootstrap is made of."""
    rng = np.random.default_rng(5)
    n = 40
    return [
        rng.normal(0, 3, (n, 4)),
        np.eye(4) / 3,
        rng.normal(0, 3, (n, 2)),
        np.zeros((2, 5)),
        np.zeros((2, 2)),
        np.arange(1, n + 1),
        np.arange(n) % 4,
        np.full(n, True),
        np.zeros((4, 2)),
        0.4,
    ]


def core_bootstrap(rng: Random) -> Any:
    """Make a bootstrap, one of its arrays changed now and then."""
    arguments = list(bootstrap_arguments())
    if rng.random() < 0.3:
        at = rng.randrange(len(arguments))
        value = arguments[at]
        if not isinstance(value, np.ndarray):
            arguments[at] = real(rng, 0.4)
        elif rng.random() < 0.5:
            arguments[at] = array(rng, value.shape, value.dtype.str[1:])
        else:
            value = value.copy()
            with contextlib.suppress(OverflowError, ValueError):
                value.flat[rng.randrange(value.size)] = number(rng)
            arguments[at] = value
    return _core.Bootstrap(*arguments)


def core_hand_over(rng: Random) -> Any:
    """Make a hand-over, or none."""
    if rng.random() < 0.7:
        return None
    steps = rng.choice([1, 2, 5])
    matrices = [[[real(rng, 1) for _ in range(2)] for _ in range(2)] for _ in range(3)]
    return _core.HandOver(array(rng, (2, steps, 2)), array(rng, (steps,)), *matrices)


def core_generator(rng: Random, step: Any) -> Any:
    """Make a generator of winds."""
    phase = rng.choice([None, None, count(rng, 1)])
    return _core.WindGenerator(
        core_bootstrap(rng),
        step,
        real(rng, 3),
        real(rng, 0.1),
        real(rng, 0.01),
        count(rng, rng.choice([1, 4])),
        count(rng, rng.choice([0, 3])),
        phase,
        core_hand_over(rng),
    )


def either_precision(rng: Random, values: Any) -> Any:
    """Give numbers of double precision in single, a third of the times."""
    single = getattr(values, "dtype", 0) == "f8" and rng.randrange(3) == 0
    return values.astype("f4") if single else values


def core_path(rng: Random) -> Any:
    """Make a wind path that covers a run, most often."""
    knots = rng.choice([2, 5, 30])
    times: Any = np.linspace(-1, 3, knots) if rng.random() < 0.9 else array(rng, (knots,))
    return _core.WindPath(times, array(rng, (knots, 2)))


def core_particles(rng: Random, members: int) -> Any:
    """Make particles, and branches of some of them."""
    particles = _core.Particles(array(rng, (members,), "u8"), count(rng, 3))
    for _ in range(rng.choice([0, 0, 1, 3])):
        particles = core_branched(rng, particles, members)
    return particles


def core_branched(rng: Random, particles: Any, members: int) -> Any:
    """Replace some particles by branches of others."""
    parents, places = (array(rng, (2,), "i8") % members for _ in range(2))
    branches = particles.branched(parents, array(rng, (2,), "i8"), array(rng, (2,), "u8"))
    return particles.replaced(places, branches)


def core_winds(rng: Random, step: Any) -> Any:
    """Make winds of an ensemble of some kind, for nine members most often."""
    kind = rng.randrange(6)
    members = rng.choice([1, 4, 9, 9, 9, 9])
    if kind == 0:
        return core_generator(rng, step), count(rng, 7)
    if kind == 1:
        return core_path(rng)
    if kind == 2:
        return [core_path(rng) for _ in range(rng.choice([0, 1, *[members] * 8]))]
    if kind == 3:
        values = either_precision(rng, array(rng, (members, 20, 2)))
        return _core.WindPaths(real(rng, -1), real(rng, 0.3), values)
    if kind == 4:
        return core_generator(rng, step), count(rng, 7), core_particles(rng, members)
    small = (real(rng, 0.1), real(rng, 0.1), count(rng, 3), count(rng, 1))
    sizes = [rng.choice([1, 4]) for _ in range(2)]
    axes = [(real(rng, -5), real(rng, 3), count(rng, n)) for n in sizes]
    x, y = (1 if n == 1 else n + 2 for n in sizes)
    return _core.FieldWinds(
        axes,
        array(rng, (y, x, 2, 2)),
        (real(rng, -1), real(rng, 0.5)),
        count(rng, 0),
        array(rng, (members, 12, 2)),
        rng.choice([None, small]),
    )


def core_maps(rng: Random) -> Any:
    """Make maps, or none."""
    if rng.random() < 0.6:
        return None
    samples: Any = np.linspace(0, 1, 20) if rng.random() < 0.9 else times_array(rng)
    times: Any = samples[[9, 19]] if rng.random() < 0.9 and len(samples) == 20 else times_array(rng)
    axes = [(real(rng, -3), real(rng, 1), count(rng, 5)) for _ in range(2)]
    return _core.Maps(*axes, times, samples, count(rng, 2))


def make_core(rng: Random) -> int:
    """Give the seed of a sequence of calls: they are made as they are run."""
    return rng.getrandbits(64)


def run_core(seed: int) -> None:
    """Call a constructor or two, and what there is to call on them."""
    rng = Random(seed)
    kind = rng.randrange(12)
    if kind == 0:
        path = core_path(rng)
        t = times_array(rng)
        rng.choice([path.velocity, path.integral])(t)
        path.mean(t, real(rng, 0.1))
    elif kind == 1:
        boot = core_bootstrap(rng)
        boot.sample(
            count(rng, 3),
            count(rng, 20),
            count(rng, 1),
            count(rng, 0),
            rng.choice([None, count(rng, 1)]),
            core_hand_over(rng),
        )
        boot.draws_at(array(rng, (4,)), count(rng, 10), count(rng, 1), rng.random() < 0.5)
    elif kind == 2:
        step, end = real(rng, 0.01), real(rng, 1)
        if not takes_long(end, step):
            core_generator(rng, step).path(count(rng, 1), count(rng, 0), end)
    elif kind == 3:
        core_sea(rng, real(rng, 0.02)).velocity(array(rng, (5,)), array(rng, (5, 2)))
    elif kind == 4:
        coast = core_coast(rng)
        if coast is not None:
            coast.clearance(real(rng, 1), real(rng, 1))
            coast.clearances(array(rng, (5, 2)))
    elif kind == 5:
        core_solver(rng).wind_needed(real(rng, 1), real(rng, 0.02))
    elif kind == 6:
        shape = (rng.choice([1, 9]), 20, rng.choice([2, 2, 2, 1, 3]))
        values = either_precision(rng, array(rng, shape))
        _core.WindPaths(real(rng, -1), real(rng, 0.3), values).velocity(
            count(rng, 1), times_array(rng)
        )
    elif kind == 7:
        maps = core_maps(rng)
        if maps is not None:
            maps.counts()
    else:
        core_run(rng, kind >= 10)


def takes_long(end: Any, *steps: Any) -> bool:
    """Tell whether a run has so many steps of some length that it takes long, yet is allowed."""
    numbers = [value for value in (end, *steps) if isinstance(value, float) and value > 0]
    return len(numbers) == 1 + len(steps) and 1e4 < end / min(steps) < 1e8


def core_run(rng: Random, fleet: bool) -> None:
    """Follow members, or one body."""
    coast, solver = core_coast(rng), core_solver(rng)
    period, step, end = real(rng, 0.02), real(rng, 0.01), real(rng, 1)
    jibing_rate = real(rng, 3)
    # What is asked for is followed, however long it takes: here it should not.
    if takes_long(end, period, step) or (
        isinstance(jibing_rate, float) and takes_long(end, 1 / (abs(jibing_rate) + 1e-300))
    ):
        return
    sea, winds = core_sea(rng, period), core_winds(rng, step)
    members = rng.choice([1, 3, 9])
    released: Any = np.zeros(members)
    if fleet:
        latitude = rng.choice([None, real(rng, 40)])
        bodies = array(rng, (members, 10))
        if isinstance(bodies, np.ndarray) and bodies.dtype == np.float64:
            bodies = np.abs(bodies) / 10
        velocities = rng.choice([None, array(rng, (members, 2))])
        seed = count(rng, 1)
        if rng.random() < 0.05:
            released = np.abs(array(rng, (members,))) / 10
        floating: Any = _core.Fleet(
            sea,
            coast,
            latitude,
            end,
            count(rng, 0),
            released,
            array(rng, (members, 2)),
            velocities,
            bodies,
            jibing_rate,
            seed,
        )
    else:
        place, velocity = (real(rng, 1), real(rng, 1)), (real(rng, 1), real(rng, 1))
        floating = _core.Scenario(sea, coast, real(rng, 1), end, place, velocity)
    times = times_array(rng, 0.4)
    if rng.random() < 0.3:
        wind = winds if fleet else core_path(rng)
        for values in floating.trajectory(wind, solver, times)[0]:
            require(np.isfinite(values).all(), "a trajectory that is not finite")
        return
    keep = count(rng, rng.choice([0, 1, members]))
    targets = [c for c in [core_coast(rng) for _ in range(rng.choice([0, 1]))] if c is not None]
    outputs = times.shape[0] if isinstance(times, np.ndarray) and times.ndim else 1
    into: list[Any] = [
        np.zeros(members, dtype=np.int8),
        np.full(members, np.nan),
        np.full((members, 2), np.nan),
        np.full(
            (min(keep, members) if isinstance(keep, int) and keep >= 0 else 0, outputs, 2), np.nan
        ),
        np.full((members, len(targets)), np.nan),
    ]
    if rng.random() < 0.1:
        at = rng.randrange(5)
        into[at] = array(rng, into[at].shape, into[at].dtype.str[1:])
    more: dict[str, Any] = {"maps": core_maps(rng)}
    if not fleet and rng.random() < 0.2:
        more["steps_per_tide"] = real(rng, 8)
    first = count(rng, 0)
    threads = count(rng, rng.choice([1, 2]))
    floating.run(winds, solver, first, times, keep, tuple(into), threads, targets, **more)
    if isinstance(winds, tuple) and len(winds) == 3:
        generator, seed, particles = winds
        for _ in range(rng.choice([0, 1, 3])):
            particles = core_branched(rng, particles, members)
            again = (generator, seed, particles)
            floating.run(again, solver, first, times, keep, tuple(into), threads, targets)
        require(0 <= particles.followed() < np.inf, "a share of the run that is none")
        require(particles.seen().shape[2] == 6, "what particles are seen at")
    status, place = into[0], into[2]
    stranded = status == 1
    require((np.isfinite(place).all(axis=1) == stranded).all(), "place of stranding")
    kept = into[3][: max(0, keep - first)]
    afloat = kept[status[: len(kept)] == 0]
    # Before its release a member is nowhere, and a branch before it begins.
    later = np.any(released) or (isinstance(winds, tuple) and len(winds) == 3)
    require(later or np.isfinite(afloat).all(), "afloat where no place is")


CORE_REFUSALS = (TypeError, ValueError, OverflowError, RuntimeError)

TARGETS = {
    target.name: target
    for target in (
        Target("toml", make_toml, run_toml),
        Target("csv", make_csv, run_csv, prepare=wind_csv),
        Target("dataset", make_dataset, run_dataset, prepare=lambda: grid("atlas")),
        Target("netcdf", make_netcdf, run_netcdf),
        Target("geojson", make_geojson, run_geojson),
        Target("forecast", make_forecast, run_forecast, prepare=drawn),
        Target("core", make_core, run_core, CORE_REFUSALS),
    )
}
