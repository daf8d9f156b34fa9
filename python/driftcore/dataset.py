"""Arrays to CF datasets, and datasets to files and back."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from driftcore.errors import OutputError, ScenarioError
from driftcore.files import replacing
from driftcore.netcdf import refuse_endless
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
# Maps of whole numbers of members, as shares; the errors follow from them.
_COUNTED = ("presence", "arrival", "visit", "outside", "ashore")
# Dimension of what is kept of members where that is not all of them.
KEPT = "kept_member"
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
    first_member: int,
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

    dim, coordinates = member_coordinates(first_member, len(status), len(position))
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
    coordinates |= {
        "component": ["x", "y"],
        "time": ("time", times, _TIME),
        "wind_time": ("wind_time", wind_times, {**_TIME, "long_name": "time of the wind"}),
    }
    return xr.Dataset(variables, coordinates, {**scenario_attributes(scenario), **attributes})


def member_coordinates(first: int, members: int, kept: int) -> tuple[str, dict[str, Any]]:
    """Give the dimension of what is kept of members, and the indices of all and of the kept."""
    about = {"cf_role": "trajectory_id", "long_name": "member of the ensemble"}
    coordinates: dict[str, Any] = {"member": ("member", first + np.arange(members), about)}
    if kept == members:
        return "member", coordinates
    about = {"long_name": "member whose path was kept"}
    return KEPT, coordinates | {KEPT: (KEPT, first + np.arange(kept), about)}


def with_maps(
    dataset: xr.Dataset, grid: MapGrid, counts: Iterable[NDArray[np.uint32]]
) -> xr.Dataset:
    """Add maps: numbers of members, flat, as the core counts them."""
    times, rows, columns = grid.shape
    cells = ("y", "x")
    present, arrived, outside, stranded = counts
    # The last interval follows the last map.
    arrived = arrived.reshape(times + 1, rows, columns)
    shares = map_shares(
        {
            "presence": present.reshape(times, rows, columns),
            "arrival": arrived[:-1],
            "visit": arrived.sum(axis=0),
            "outside": outside,
            "ashore": stranded,
        },
        followed_of(dataset),
    )

    on_maps = ("map_time", *cells)
    mapped: dict[str, tuple[tuple[str, ...], str, str | None]] = {
        "presence": (on_maps, "of being afloat in the cell", "point"),
        "arrival": (on_maps, "of entering the cell for the first time within the interval", "sum"),
        "visit": (cells, "of entering the cell within the run, or starting there", None),
        "outside": (("map_time",), "of being afloat beyond the maps", "point"),
        "ashore": (("map_time",), "of having stranded", "point"),
    }
    half_width = "half-width of its Wilson interval at one standard deviation"
    variables = {}
    for name, (dims, event, method) in mapped.items():
        told = {name: f"probability {event}", f"{name}_standard_error": f"{name}: {half_width}"}
        for key, meaning in told.items():
            variables[key] = _variable(dims, shares[key], meaning)
            if method:
                variables[key][2]["cell_methods"] = f"map_time: {method}"
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


def map_shares(counts: dict[str, NDArray[Any]], followed: int) -> dict[str, NDArray[np.float64]]:
    """Give the shares of counts on maps among those followed, each with its standard error."""
    shares = {}
    for name, count in counts.items():
        none = np.full(count.shape, np.nan)
        shares[name] = count / followed if followed else none
        error = standard_error(count, followed) if followed else none
        shares[f"{name}_standard_error"] = error
    return shares


def combined(parts: Sequence[xr.Dataset]) -> xr.Dataset:
    """Put parts of one ensemble together: the dataset of one run of all their members.

    Parameters
    ----------
    parts : sequence of xarray.Dataset
        Datasets of forecasts of the same arguments but for the range of members, in any order;
        each range begins where another ends.

    Returns
    -------
    xarray.Dataset
        Bit for bit that of one run of all members, but for the time in `history`.

    Raises
    ------
    ScenarioError
        They are not of one ensemble, or members are missing or come twice.
    """
    import xarray as xr

    if not parts:
        raise ScenarioError("parts: an empty list is not accepted; one forecast at least")
    parts = sorted(parts, key=lambda part: int(part["member"][0]))
    for part in parts:
        _require_same(parts[0], part)
    one, last = parts[0], parts[-1]
    first, members = int(one["member"][0]), sum(part.sizes["member"] for part in parts)
    # Where not all are kept, some part keeps fewer than all: it tells what is kept at all.
    kept = {n for part in parts for n, v in part.data_vars.items() if KEPT in v.dims}
    number = sum(part.sizes.get(KEPT, part.sizes["member"]) for part in parts) if kept else members
    dim, coordinates = member_coordinates(first, members, number)
    for index in coordinates:
        found = [part[index if index in part.coords else "member"].values for part in parts]
        if not np.array_equal(np.concatenate(found), coordinates[index][1]):
            raise ScenarioError(f"parts: of {index}, some are missing or come twice")
    shares = {}
    if "presence" in one:
        counted = [map_counts(part) for part in parts]
        counts = {name: np.sum([c[name] for c in counted], axis=0) for name in counted[0]}
        shares = map_shares(counts, sum(map(followed_of, parts)))
    variables = {}
    for name, variable in one.variables.items():
        dims, values = variable.dims, variable.values
        if name in ("member", KEPT):
            continue
        if name in kept or "member" in dims:
            values = np.concatenate([part[name].values for part in parts])
            dims = (dim if name in kept else "member", *dims[1:])
        elif name in shares:
            values = shares[name]
        variables[name] = (dims, values, variable.attrs)
    told = ensemble_attributes(one.attrs["scenario"], members)
    # The configuration of a part is that of a run from member 0 on that ends with it.
    told["configuration"] = last.attrs["configuration"]
    whole = xr.Dataset(variables, coordinates, one.attrs | told)
    return whole.set_coords([name for name in one.coords if name in variables])


def _require_same(one: xr.Dataset, other: xr.Dataset) -> None:
    """Refuse parts that differ in more than their members."""
    of_members = {"title", "members", "history", "configuration"}
    for name in sorted({*one.attrs, *other.attrs} - of_members):
        values = [repr(part.attrs.get(name)) for part in (one, other)]
        if values[0] != values[1]:
            raise ScenarioError(
                f"parts: {name} is {values[0]} and {values[1]}; they are not of one ensemble"
            )
    for name in map(str, {**one.variables, **other.variables}):
        if name in ("member", KEPT):
            continue
        if not (name in one and name in other):
            raise ScenarioError(f"parts: {name} is in some of them and not in others")
        if name in one.coords and not one[name].equals(other[name]):
            raise ScenarioError(f"parts: {name} differs; they are not of one ensemble")


def followed_of(dataset: xr.Dataset) -> int:
    """Count the members that could be followed: all but the failed ones."""
    return int((dataset["status"].values != STATUSES.index("failed")).sum())


def map_counts(dataset: xr.Dataset) -> dict[str, NDArray[np.int64]]:
    """Give the numbers of members that the shares on maps are of, exactly.

    A share is a quotient of whole numbers: times the divisor it is off by two roundings, which is
    less than half a member up to 2⁵¹ of them.
    """
    followed = followed_of(dataset)
    return {
        name: np.rint(np.nan_to_num(dataset[name].values) * followed).astype(np.int64)
        for name in _COUNTED
    }


def with_targets(
    dataset: xr.Dataset, names: list[str], entry_time: NDArray[np.float64]
) -> xr.Dataset:
    """Add the time of the first entry of each target: shape (member, target), NaN where never."""
    entered = _variable(("member", "target"), entry_time, "time of first being in the target")
    return dataset.assign(entry_time=entered).assign_coords(target=names)


def ensemble_attributes(scenario: str, members: int) -> dict[str, Any]:
    """Attributes that say how many members of what there are, and what followed them."""
    return {
        "title": f"Drift forecast: {scenario}, {members} members",
        "members": members,
        **provenance(f"forecast of {members} members"),
    }


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
    dataset = times_as_numbers(dataset)
    with replacing(path, overwrite) as temporary:
        # The HDF5 library brings the process down when the disk fills up under it.
        needed, free = dataset.nbytes + _FILE_OVERHEAD, shutil.disk_usage(temporary.parent).free
        if free < needed:
            raise OSError(f"it needs up to {needed / 1e6:.0f} MB, {free / 1e6:.0f} MB are free")
        dataset.to_netcdf(temporary, engine="h5netcdf", encoding=encoding)


def times_as_numbers(dataset: xr.Dataset, since: np.datetime64 | None = None) -> xr.Dataset:
    """Give times as whole numbers of the longest unit in which none of them is rounded.

    Programs read seconds more widely than nanoseconds. All times have the same unit and origin:
    bounds must have those of what they bound (CF 7.1). Or as nanoseconds `since` a day, whatever
    they are: the same for every part of an ensemble.
    """
    # What a dataset was read with would stand beside what is set here.
    dataset = dataset.drop_encoding()
    for names in (set(dataset.coords), set(dataset.data_vars)):
        times = {name: dataset[name] for name in names if dataset[name].dtype.kind == "M"}
        known = [v.values[~np.isnat(v.values)] for v in times.values()]
        instants = np.concatenate([*known, np.zeros(0, dtype="datetime64[ns]")])
        first = instants.min() if len(instants) else np.datetime64(0, "ns")
        day = first.astype("datetime64[D]") if since is None else since
        origin = day.astype("datetime64[ns]")
        unit, length = next(
            (unit, length)
            for unit, length in _TIME_UNITS.items()
            if (since is None or length == 1)
            and not ((instants - origin).astype(np.int64) % length).any()
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
    import h5py  # type: ignore[import-untyped]  # has no types
    import xarray as xr

    import driftcore.accessor  # noqa: F401 (gives the dataset its `.driftcore`)

    try:
        if not path.exists():
            raise FileNotFoundError("no such file")
        if path.is_dir():
            raise IsADirectoryError("it is a folder")
        if not h5py.is_hdf5(path):
            raise ValueError("it is another kind of file; name one that `driftcore run` wrote")
        refuse_endless(path)
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
