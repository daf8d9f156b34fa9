"""Forecasts for other programs: tables, map layers, and the trajectory files of others' tools.

* `members_table`: one row per member, for pandas, spreadsheets and Parquet.
* `strandings`, `trajectories`, `presence_cells`: layers of geometries for QGIS and its kind.
* `opendrift_dataset`: trajectories as OpenDrift writes them, which its tools and TrajAn read.
* `ragged_dataset`: trajectories as a CF contiguous ragged array, which clouddrift reads.

`export` writes any of these by the name of the file.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftcore.coast import near_longitude
from driftcore.dataset import STATUSES, is_geographic, write_netcdf
from driftcore.errors import DriftCoreError, ScenarioError, need_geo
from driftcore.files import check_writable, replacing
from driftcore.results import Forecast

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

__all__ = [
    "export",
    "members_table",
    "opendrift_dataset",
    "presence_cells",
    "ragged_dataset",
    "strandings",
    "trajectories",
]

Floats = NDArray[np.float64]
Format = Literal["opendrift", "clouddrift"]

_STRANDED = STATUSES.index("stranded")
_DRIVERS = {".geojson": "GeoJSON", ".gpkg": "GPKG"}
_TABLES = (".csv", ".parquet")
_DATES = "seconds since 1970-01-01 00:00:00"
# What stands for a status where a member is not, or no longer, adrift.
_NO_STATUS = np.int32(-999)


class Layer(NamedTuple):
    """Geometries and what is known of each, in longitude and latitude."""

    name: str
    kind: str
    """Type of its geometries."""
    geometries: NDArray[np.object_]
    columns: dict[str, NDArray[Any]]


def export(
    forecast: Forecast | xr.Dataset,
    path: str | Path,
    format: Format | None = None,  # noqa: A002 (the word that the command has)
    overwrite: bool = False,
) -> Path:
    """Write a forecast for another program.

    Parameters
    ----------
    forecast : Forecast or xarray.Dataset
        Any; on the real sea for all but tables.
    path : str or pathlib.Path
        By its end: ``.csv`` or ``.parquet``, a row for each member; ``.geojson``, the strandings
        as points; ``.gpkg``, these, the kept trajectories as lines and the cells of the maps as
        polygons, a layer each; ``.nc`` in one of the formats below.
    format : {"opendrift", "clouddrift"}, optional
        Of ``.nc``: kept trajectories as OpenDrift writes them, or as a ragged array.
    overwrite : bool
        Replace a file that is there.

    Returns
    -------
    pathlib.Path
        Of the file.

    Raises
    ------
    DriftCoreError
        A library is not installed; the message says what brings it.
    OutputError
        The file exists and `overwrite` is not set, or it cannot be written.
    ScenarioError
        The ending or the format is not accepted, or the forecast holds nothing of the kind.
    """
    dataset = forecast.dataset if isinstance(forecast, Forecast) else forecast
    path = Path(path)
    suffix = path.suffix.lower()
    known = (*_TABLES, *_DRIVERS, ".nc")
    if suffix not in known:
        raise ScenarioError(f"path: '{path}' is not accepted; a name ending in {', '.join(known)}")
    if (suffix == ".nc") != (format is not None) or format not in (None, "opendrift", "clouddrift"):
        given = "is missing" if format is None else f"{format!r} is not accepted"
        raise ScenarioError(
            f"format: {given} for {suffix}; 'opendrift' or 'clouddrift' for .nc, none for others"
        )
    check_writable(path, overwrite)
    if suffix == ".csv":
        with replacing(path, overwrite) as temporary:
            members_table(dataset).to_csv(temporary, date_format="%Y-%m-%dT%H:%M:%SZ")
    elif suffix == ".parquet":
        _write_parquet(members_table(dataset), path, overwrite)
    elif suffix == ".nc":
        made = opendrift_dataset(dataset) if format == "opendrift" else ragged_dataset(dataset)
        write_netcdf(made, path, overwrite)
    else:
        layers = [strandings(dataset)]
        if suffix == ".gpkg":
            layers += [trajectories(dataset)] if _kept(dataset) else []
            layers += [presence_cells(dataset)] if "presence" in dataset else []
        _write_layers(layers, path, _DRIVERS[suffix], overwrite)
    return path


def members_table(forecast: Forecast | xr.Dataset) -> pd.DataFrame:
    """Give a row for each member.

    Parameters
    ----------
    forecast : Forecast or xarray.Dataset
        Any.

    Returns
    -------
    pandas.DataFrame
        By `member`: `status`, a category; `stranding_time`, and on the real sea
        `stranding_longitude`, `stranding_latitude`, `release_time`, `release_longitude`,
        `release_latitude` [degrees, UTC], in the paper's case `stranding_x`, `stranding_y`
        [scenario units]; `entry_NAME`, the time of the first entry, for each target. What did not
        happen is NaN or NaT.
    """
    import pandas as pd

    dataset = forecast.dataset if isinstance(forecast, Forecast) else forecast
    codes = dataset["status"].values
    columns: dict[str, Any] = {
        "status": pd.Categorical.from_codes(codes.tolist(), pd.Index(STATUSES)),
        "stranding_time": dataset["stranding_time"].values,
    }
    if is_geographic(dataset):
        for name in ("stranding_longitude", "stranding_latitude", "release_time"):
            columns[name] = dataset[name].values
        for name in ("release_longitude", "release_latitude"):
            columns[name] = dataset[name].values
    else:
        columns["stranding_x"], columns["stranding_y"] = dataset["stranding_position"].values.T
    if "entry_time" in dataset:
        for target in dataset["target"].values:
            columns[f"entry_{target}"] = dataset["entry_time"].sel(target=target).values
    return pd.DataFrame(columns, index=pd.Index(dataset["member"].values, name="member"))


def strandings(forecast: Forecast | xr.Dataset) -> Layer:
    """Give the places of stranding as points, with member, time and days since the release."""
    import shapely

    dataset = _sea(forecast)
    table = members_table(dataset)
    table = table[table["status"] == "stranded"]
    places = table[["stranding_longitude", "stranding_latitude"]].to_numpy()
    points = np.asarray(shapely.points(places), dtype=object)
    times, releases = (table[name].to_numpy() for name in ("stranding_time", "release_time"))
    columns = {
        "member": table.index.to_numpy(),
        "time": table["stranding_time"].to_numpy("datetime64[ms]"),
        "days": (times - releases) / np.timedelta64(1, "D"),
    }
    return Layer("strandings", "Point", points, columns)


def trajectories(forecast: Forecast | xr.Dataset) -> Layer:
    """Give the kept members' paths as lines, up to the place of stranding, cut at the dateline."""
    import shapely

    dataset = _sea(forecast)
    paths = _paths(dataset)
    lines, rows = [], []
    for row, path in enumerate(paths):
        if len(path.times) > 1:
            lines.append(_cut_at_dateline(path.places))
            rows.append(row)
    kept = [paths[row] for row in rows]
    columns = {
        "member": np.array([path.member for path in kept], dtype=np.int64),
        "status": np.array([STATUSES[path.status] for path in kept], dtype=object),
        "start": np.array([path.times[0] for path in kept], dtype="datetime64[ms]"),
        "end": np.array([path.times[-1] for path in kept], dtype="datetime64[ms]"),
    }
    geometries = np.array([shapely.MultiLineString(parts) for parts in lines], dtype=object)
    return Layer("trajectories", "MultiLineString", geometries, columns)


def presence_cells(forecast: Forecast | xr.Dataset) -> Layer:
    """Give the cells of the maps that hold a member, as polygons with their probability."""
    import shapely

    dataset = _sea(forecast)
    if "presence" not in dataset:
        raise ScenarioError("presence: not in the dataset, accepted is a forecast with maps")
    presence = dataset["presence"].values
    time, row, column = np.nonzero(presence)
    west, east = dataset["map_longitude_bounds"].values[column].T
    south, north = dataset["map_latitude_bounds"].values[row].T
    turn = near_longitude((west + east) / 2, 0.0) - (west + east) / 2
    columns = {
        "time": dataset["map_time"].values[time].astype("datetime64[ms]"),
        "probability": presence[time, row, column],
        "standard_error": dataset["presence_standard_error"].values[time, row, column],
    }
    cells = np.asarray(shapely.box(west + turn, south, east + turn, north), dtype=object)
    return Layer("presence", "Polygon", cells, columns)


def opendrift_dataset(forecast: Forecast | xr.Dataset) -> xr.Dataset:
    """Give the kept members' paths as OpenDrift writes trajectories.

    Returns
    -------
    xarray.Dataset
        `lon`, `lat`, `z`, `status`, `age_seconds`, `moving`, `origin_marker` of shape (trajectory,
        time), and `trajectory`, numbers from 1 on. A member is absent before its release; it has
        status `stranded`, at its place of stranding, at the first output time from its stranding
        on, and is absent after that.

    Raises
    ------
    ScenarioError
        The forecast is not on the real sea, or no paths were kept.

    Notes
    -----
    After the CF conventions, multidimensional array of trajectories (H.4.1), with the names of
    https://opendrift.github.io/output.html.
    """
    import xarray as xr

    dataset = _sea(forecast)
    fate, longitude, latitude = _kept_arrays(dataset)
    times = dataset["time"].values
    stranded = fate["status"].values == _STRANDED
    # The first output time from the stranding on: the last one is the end of the run.
    last = np.minimum(np.searchsorted(times, fate["stranding_time"].values), len(times) - 1)
    rows = np.flatnonzero(stranded)
    columns = last[rows]
    longitude[rows, columns] = fate["stranding_longitude"].values[rows]
    latitude[rows, columns] = fate["stranding_latitude"].values[rows]
    adrift = np.isfinite(longitude)
    status = np.where(adrift, 0, _NO_STATUS).astype(np.int32)
    status[rows, columns] = 1
    age = (times - fate["release_time"].values[:, None]) / np.timedelta64(1, "s")

    dims = ("trajectory", "time")

    def of_each(values: Any, **attributes: Any) -> Any:
        return dims, np.where(adrift, values, np.nan).astype(np.float32), attributes

    flags = ["active", "stranded"]
    variables = {
        "lon": of_each(longitude, units="degrees_east", standard_name="longitude"),
        "lat": of_each(latitude, units="degrees_north", standard_name="latitude"),
        "z": of_each(0.0, units="m", standard_name="z", positive="up"),
        "age_seconds": of_each(age, units="s"),
        "moving": of_each(1.0, units="1"),
        "origin_marker": of_each(0.0, units="1"),
        "status": (
            dims,
            status,
            {
                "flag_values": np.arange(len(flags), dtype=np.int32),
                "flag_meanings": " ".join(flags),
                "valid_range": np.array([0, len(flags) - 1], dtype=np.int32),
                "_FillValue": _NO_STATUS,
            },
        ),
    }
    steps = np.unique(np.diff(times))
    names = ("time_step_output", "time_step_calculation") if len(steps) == 1 else ()
    attributes = {
        **_about(dataset),
        "opendrift_module": "opendrift.models.oceandrift",
        "opendrift_class": "OceanDrift",
        "time_coverage_start": str(times[0].astype("datetime64[s]")).replace("T", " "),
        "time_coverage_end": str(times[-1].astype("datetime64[s]")).replace("T", " "),
        **{name: str(steps[0].astype("timedelta64[s]").item()) for name in names},
    }
    return xr.Dataset(
        variables,
        {
            "trajectory": (
                "trajectory",
                np.arange(1, len(status) + 1, dtype=np.int32),
                {"cf_role": "trajectory_id", "units": "1"},
            ),
            "time": ("time", _seconds(times), {"units": _DATES, "standard_name": "time"}),
        },
        attributes,
    )


def ragged_dataset(forecast: Forecast | xr.Dataset) -> xr.Dataset:
    """Give the kept members' paths one after the other, as clouddrift takes them.

    Returns
    -------
    xarray.Dataset
        By `obs`: `time`, `lon`, `lat`, the last of a stranded member being its stranding; by
        `traj`: `id`, the member, `rowsize`, how many observations it has, and `status`.

    Raises
    ------
    ScenarioError
        The forecast is not on the real sea, or no paths were kept.

    Notes
    -----
    CF conventions, contiguous ragged array of trajectories (H.4.3).
    """
    import xarray as xr

    dataset = _sea(forecast)
    paths = _paths(dataset)
    places = np.concatenate([path.places for path in paths])
    times = np.concatenate([path.times for path in paths])
    status = np.array([path.status for path in paths], dtype=np.int8)
    variables = {
        "rowsize": (
            "traj",
            np.array([len(path.times) for path in paths], dtype=np.int64),
            {"long_name": "number of observations", "sample_dimension": "obs"},
        ),
        "status": ("traj", status, dict(dataset["status"].attrs)),
        "lon": ("obs", places[:, 0], {"standard_name": "longitude", "units": "degrees_east"}),
        "lat": ("obs", places[:, 1], {"standard_name": "latitude", "units": "degrees_north"}),
    }
    member = np.array([path.member for path in paths], dtype=np.int64)
    coordinates: dict[str, Any] = {
        "id": ("traj", member, {"cf_role": "trajectory_id", "long_name": "member"}),
        "time": ("obs", _seconds(times), {"units": _DATES, "standard_name": "time"}),
    }
    return xr.Dataset(variables, coordinates, _about(dataset))


class _Path(NamedTuple):
    """A member while it is adrift."""

    member: int
    status: int
    times: NDArray[np.datetime64]
    places: Floats
    """Longitude and latitude, shape (n, 2)."""


def _sea(forecast: Forecast | xr.Dataset) -> xr.Dataset:
    dataset = forecast.dataset if isinstance(forecast, Forecast) else forecast
    if not is_geographic(dataset):
        raise ScenarioError(
            "forecast: it is of the paper's plane, which has no longitudes and latitudes; "
            f"accepted are files ending in {' or '.join(_TABLES)}"
        )
    need_geo("shapely", "pyogrio")
    return dataset


def _kept(dataset: xr.Dataset) -> int:
    """Count the members whose paths were kept."""
    return int(dataset["longitude"].shape[dataset["longitude"].dims.index(_dim(dataset))])


def _dim(dataset: xr.Dataset) -> str:
    return "kept_member" if "kept_member" in dataset.dims else "member"


def _kept_arrays(dataset: xr.Dataset) -> tuple[xr.Dataset, Floats, Floats]:
    """Give the fates of the kept members, and copies of their longitudes and latitudes."""
    if not _kept(dataset):
        raise ScenarioError("forecast: no paths were kept; run it with keep above 0")
    dim = _dim(dataset)
    longitude, latitude = (
        dataset[name].transpose(dim, "time").values.astype(float)
        for name in ("longitude", "latitude")
    )
    return dataset.sel(member=dataset[dim].values), longitude.copy(), latitude.copy()


def _paths(dataset: xr.Dataset) -> list[_Path]:
    """Give the kept members' paths, each with its stranding as its end."""
    fate, longitude, latitude = _kept_arrays(dataset)
    times = dataset["time"].values
    paths = []
    for k, member in enumerate(fate["member"].values):
        adrift = np.isfinite(longitude[k])
        when, places = times[adrift], np.column_stack([longitude[k], latitude[k]])[adrift]
        status = int(fate["status"].values[k])
        if status == _STRANDED:
            end = [fate[f"stranding_{name}"].values[k] for name in ("longitude", "latitude")]
            when = np.append(when, fate["stranding_time"].values[k])
            places = np.concatenate([places, [end]])
        paths.append(_Path(int(member), status, when, places))
    return paths


def _cut_at_dateline(places: Floats) -> list[Floats]:
    """Give a path in parts whose longitudes stay within ±180 degrees (RFC 7946, 3.1.9)."""
    longitude = np.unwrap(places[:, 0], period=360.0)
    path = np.column_stack([longitude, places[:, 1]])
    first, last = (np.floor((edge + 180) / 360) for edge in (longitude.min(), longitude.max()))
    if first == last:
        return [places]
    import shapely

    parts = []
    for turn in np.arange(first, last + 1):
        clipped = shapely.clip_by_rect(
            shapely.LineString(path), 360 * turn - 180, -90.0, 360 * turn + 180, 90.0
        )
        lines = [part for part in shapely.get_parts(clipped) if part.geom_type == "LineString"]
        parts += [shapely.get_coordinates(line) - [360 * turn, 0.0] for line in lines]
    return parts


def _seconds(times: NDArray[np.datetime64]) -> Floats:
    return np.asarray((times - np.datetime64(0, "s")) / np.timedelta64(1, "s"))


def _about(dataset: xr.Dataset) -> dict[str, Any]:
    """Attributes that stay true of the paths alone."""
    names = ("title", "source", "history", "references", "seed", "model", "wind_label")
    kept = {name: dataset.attrs[name] for name in names if name in dataset.attrs}
    return {"Conventions": "CF-1.11", "featureType": "trajectory", **kept}


def _write_layers(layers: list[Layer], path: Path, driver: str, overwrite: bool) -> None:
    import pyogrio  # type: ignore[import-untyped]  # has no types
    import shapely

    with replacing(path, overwrite) as temporary:
        # GDAL takes the empty file that keeps the name for a damaged one.
        temporary.unlink()
        for number, layer in enumerate(layers):
            try:
                pyogrio.raw.write(
                    str(temporary),
                    geometry=shapely.to_wkb(layer.geometries),
                    field_data=list(layer.columns.values()),
                    fields=list(layer.columns),
                    geometry_type=layer.kind,
                    crs="EPSG:4326",
                    driver=driver,
                    layer=layer.name,
                    append=number > 0,
                )
            except pyogrio.errors.DataSourceError as error:
                raise OSError(str(error)) from None


def _write_parquet(table: pd.DataFrame, path: Path, overwrite: bool) -> None:
    from importlib.util import find_spec

    if find_spec("pyarrow") is None:
        raise DriftCoreError(
            'Parquet needs pyarrow, which is not installed: pip install "driftcore[parquet]"'
        )
    with replacing(path, overwrite) as temporary:
        table.to_parquet(temporary, engine="pyarrow")
