"""Arrays to CF datasets, and datasets to files and back."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from driftcore.errors import OutputError
from driftcore.files import replacing
from driftcore.statistics import standard_error

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import NDArray

    from driftcore.maps import MapGrid
    from driftcore.scenario import Scenario

STATUSES = ("afloat", "stranded", "left_domain", "failed")
STATUS_ATTRIBUTES = {
    "long_name": "how the member ended",
    "flag_values": np.arange(len(STATUSES), dtype=np.int8),
    "flag_meanings": " ".join(STATUSES),
}
# Bytes that a NetCDF file holds besides its values, generously.
_FILE_OVERHEAD = 10**6
# Of times, and how many nanoseconds each is.
_TIME_UNITS = {"seconds": 10**9, "milliseconds": 10**6, "microseconds": 10**3, "nanoseconds": 1}
_NO_TIME = np.int64(np.iinfo(np.int64).min)
_TIME = {
    "long_name": "time since the release, in units of the run",
    "units": "1",
    "axis": "T",
}


def scenario_attributes(scenario: Scenario) -> dict[str, Any]:
    """Attributes that tell a reader what was followed where."""
    attributes: dict[str, Any] = {
        "Conventions": "CF-1.11",
        "featureType": "trajectory",
        "scenario": scenario.name,
        "epsilon": scenario.epsilon,
        "duration": scenario.duration,
        "drag": scenario.drag,
        "tide_period_h": scenario.tide_period_h,
        "wind_unit": scenario.wind_unit,
        "release": json.dumps(scenario.position),
    }
    if scenario.coast is not None:
        attributes["coast"] = json.dumps({**scenario.coast.model_dump(), "side": scenario.side})
    return attributes


def is_geographic(dataset: xr.Dataset) -> bool:
    """Say whether a forecast is one on the real sea."""
    return "stranding_longitude" in dataset


def _variable(dims: tuple[str, ...], values: Any, long_name: str, units: str = "1") -> Any:
    return (dims, values, {"long_name": long_name, "units": units})


def trajectory_dataset(
    scenario: Scenario,
    times: NDArray[np.float64],
    arrays: dict[str, NDArray[np.float64]],
    attributes: dict[str, Any],
) -> xr.Dataset:
    """One body: `arrays` holds (time, 2) values by variable name."""
    import xarray as xr

    names = {
        "position": "position",
        "velocity": "velocity",
        "mean_position": "position without the tidal oscillation",
        "mean_velocity": "velocity without the tidal oscillation",
    }
    dims = ("time", "component")
    variables = {name: _variable(dims, values, names[name]) for name, values in arrays.items()}
    coordinates = {"time": ("time", times, _TIME), "component": ["x", "y"]}
    return xr.Dataset(variables, coordinates, {**scenario_attributes(scenario), **attributes})


def forecast_dataset(
    scenario: Scenario,
    *,
    status: NDArray[np.int8],
    stranding_time: NDArray[np.float64],
    stranding_position: NDArray[np.float64],
    times: NDArray[np.float64],
    position: NDArray[np.float64],
    wind_times: NDArray[np.float64],
    wind: NDArray[np.float64],
    attributes: dict[str, Any],
) -> xr.Dataset:
    """All members: shapes (member,), (member, 2), kept (kept, time, 2), (kept, wind_time, 2)."""
    import xarray as xr

    import driftcore.accessor  # noqa: F401 (gives the dataset its `.driftcore`)

    members, kept = len(status), len(position)
    dim = "member" if kept == members else "kept_member"
    variables = {
        "status": (("member",), status, STATUS_ATTRIBUTES),
        "stranding_time": _variable(("member",), stranding_time, "time of stranding"),
        "stranding_position": _variable(
            ("member", "component"), stranding_position, "position of stranding"
        ),
        "position": _variable(
            (dim, "time", "component"), position, "position of the kept members while adrift"
        ),
        "wind_velocity": _variable(
            (dim, "wind_time", "component"),
            wind,
            "synoptic wind of the kept members, toward x and y",
            "m s-1",
        ),
    }
    member_attributes = {"cf_role": "trajectory_id", "long_name": "member of the ensemble"}
    coordinates: dict[str, Any] = {
        "member": ("member", np.arange(members), member_attributes),
        "component": ["x", "y"],
        "time": ("time", times, _TIME),
        "wind_time": ("wind_time", wind_times, {**_TIME, "long_name": "time of the wind"}),
    }
    if dim != "member":
        coordinates[dim] = (dim, np.arange(kept), {"long_name": "member whose path was kept"})
    return xr.Dataset(variables, coordinates, {**scenario_attributes(scenario), **attributes})


def with_maps(
    dataset: xr.Dataset, grid: MapGrid, counts: Iterable[NDArray[np.uint32]], followed: int
) -> xr.Dataset:
    """Add maps: numbers of members, flat, as the core counts them, among those followed."""
    times, rows, columns = grid.shape
    cells = ("y", "x")
    present, arrived, outside, stranded = counts
    present = present.reshape(times, rows, columns)
    # The last interval follows the last map.
    arrived = arrived.reshape(times + 1, rows, columns)
    visited = arrived.sum(axis=0)

    def share(count: NDArray[Any]) -> NDArray[np.float64]:
        return count / followed if followed else np.full(count.shape, np.nan)

    def variable(dims: tuple[str, ...], values: Any, name: str, method: str | None = None) -> Any:
        dims, values, attributes = _variable(dims, values, name)
        return (
            dims,
            values,
            attributes | ({"cell_methods": f"map_time: {method}"} if method else {}),
        )

    def error(count: NDArray[Any]) -> NDArray[np.float64]:
        return standard_error(count, followed) if followed else share(count)

    half_width = "half-width of its Wilson interval at one standard deviation"
    variables = {
        "presence": variable(
            ("map_time", *cells), share(present), "probability of being afloat in the cell", "point"
        ),
        "presence_standard_error": variable(
            ("map_time", *cells), error(present), f"presence: {half_width}", "point"
        ),
        "arrival": variable(
            ("map_time", *cells),
            share(arrived[:-1]),
            "probability of entering the cell for the first time within the interval",
            "sum",
        ),
        "visit": variable(
            cells,
            share(visited),
            "probability of entering the cell within the run, or starting there",
        ),
        "visit_standard_error": variable(cells, error(visited), f"visit: {half_width}"),
        "outside": variable(
            ("map_time",), share(outside), "probability of being afloat beyond the maps", "point"
        ),
        "ashore": variable(
            ("map_time",), share(stranded), "probability of having stranded", "point"
        ),
    }
    coordinates: dict[str, Any] = {}
    for name, edges in (("x", grid.x), ("y", grid.y)):
        lines = np.linspace(edges[0], edges[-1], len(edges))
        about = {
            "long_name": f"{name} of the centre of the cell",
            "units": "1",
            "axis": name.upper(),
            "bounds": f"{name}_bounds",
        }
        coordinates[name] = (name, (lines[:-1] + lines[1:]) / 2, about)
        coordinates[f"{name}_bounds"] = ((name, "bound"), np.stack([lines[:-1], lines[1:]], axis=1))
    instants = np.array(grid.times)
    about = {**_TIME, "long_name": "time of the map", "bounds": "map_time_bounds"}
    coordinates["map_time"] = ("map_time", instants, about)
    coordinates["map_time_bounds"] = (
        ("map_time", "bound"),
        np.stack([np.append(0.0, instants[:-1]), instants], axis=1),
    )
    return dataset.assign(variables).assign_coords(coordinates)


def with_targets(
    dataset: xr.Dataset, names: list[str], entry_time: NDArray[np.float64]
) -> xr.Dataset:
    """Add the time of the first entry of each target: shape (member, target), NaN where never."""
    entered = _variable(("member", "target"), entry_time, "time of first being in the target")
    return dataset.assign(entry_time=entered).assign_coords(target=names)


def wind_label(dataset: xr.Dataset) -> str:
    """Say which wind a dataset was computed with, and that it is synthetic where it is."""
    label = str(dataset.attrs.get("wind_label", "")).strip()
    if dataset.attrs.get("wind_synthetic", 0) and "synthetic" not in label.lower():
        label = f"{label} (synthetic)" if label else "synthetic"
    return label


def provenance(command: str) -> dict[str, str]:
    """Attributes that say what wrote a file, and when."""
    from driftcore import __version__

    now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    return {
        "source": f"driftcore {__version__}",
        "driftcore_version": __version__,
        "history": f"{now} {command}",
        "references": "Ailliot, Frénod & Monbet (2006), Long term object drift forecast in the "
        "ocean with tide and wind",
    }


def write_netcdf(dataset: xr.Dataset, path: Path, overwrite: bool) -> None:
    """Write NetCDF-4, whole or not at all.

    Raises
    ------
    OutputError
        As `driftcore.files.replacing`.
    """
    encoding: dict[Any, dict[str, Any]] = {
        name: {"zlib": True, "complevel": 4} for name, v in dataset.items() if v.ndim > 1
    }
    # A coordinate has no missing values (CF 2.5.1), and so none that stands for them.
    encoding |= {name: {"_FillValue": None} for name in dataset.coords}
    dataset = _times_as_numbers(dataset)
    with replacing(path, overwrite) as temporary:
        # The HDF5 library brings the process down when the disk fills up under it.
        needed, free = dataset.nbytes + _FILE_OVERHEAD, shutil.disk_usage(temporary.parent).free
        if free < needed:
            raise OSError(f"it needs up to {needed / 1e6:.0f} MB, {free / 1e6:.0f} MB are free")
        dataset.to_netcdf(temporary, engine="h5netcdf", encoding=encoding)


def _times_as_numbers(dataset: xr.Dataset) -> xr.Dataset:
    """Give times as whole numbers of the longest unit in which none of them is rounded.

    Programs read seconds more widely than nanoseconds. All times have the same unit and origin:
    bounds must have those of what they bound (CF 7.1).
    """
    # What a dataset was read with would stand beside what is set here.
    dataset = dataset.drop_encoding()
    for names in (set(dataset.coords), set(dataset.data_vars)):
        times = {name: dataset[name] for name in names if dataset[name].dtype.kind == "M"}
        known = [v.values[~np.isnat(v.values)] for v in times.values()]
        instants = np.concatenate([*known, np.zeros(0, dtype="datetime64[ns]")])
        first = instants.min() if len(instants) else np.datetime64(0, "ns")
        day = first.astype("datetime64[D]")
        origin = day.astype("datetime64[ns]")
        unit, length = next(
            (unit, length)
            for unit, length in _TIME_UNITS.items()
            if not ((instants - origin).astype(np.int64) % length).any()
        )
        attributes = {"units": f"{unit} since {day} 00:00:00", "calendar": "proleptic_gregorian"}
        for name, variable in times.items():
            numbers = (variable.values - origin).astype(np.int64)
            missing = np.isnat(variable.values)
            numbers = np.where(missing, _NO_TIME, numbers // length)
            fill = {} if name in dataset.coords else {"_FillValue": _NO_TIME}
            dataset[name] = (variable.dims, numbers, variable.attrs | attributes | fill)
    return dataset


def read_netcdf(path: Path) -> xr.Dataset:
    """Read a forecast wholly into memory and close the file.

    Raises
    ------
    OutputError
        The file is missing, is not NetCDF, or was not written by driftcore.
    """
    import xarray as xr

    import driftcore.accessor  # noqa: F401 (gives the dataset its `.driftcore`)

    try:
        if not path.exists():
            raise FileNotFoundError("no such file")
        if path.is_dir():
            raise IsADirectoryError("it is a folder")
        with xr.open_dataset(path, engine="h5netcdf", decode_timedelta=False) as dataset:
            loaded = dataset.load()
    except Exception as error:
        # The HDF5 library answers a damaged file with whatever the damage leads it to.
        raise OutputError(f"{path}: cannot be read as NetCDF-4: {error}") from None
    held = {*loaded.variables, *loaded.attrs}
    place = "stranding_longitude" if is_geographic(loaded) else "stranding_position"
    expected = ("status", "stranding_time", place, "configuration")
    missing = [name for name in expected if name not in held]
    if missing:
        raise OutputError(f"{path}: is not a driftcore forecast (no {', '.join(missing)})")
    return loaded
