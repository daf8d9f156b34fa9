"""Forecasts on the real sea: geographic scenarios through the compiled core to CF datasets."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore import _core
from driftcore.compiled import area_core, solver_of
from driftcore.configuration import read_toml
from driftcore.dataset import (
    STATUS_ATTRIBUTES,
    STATUSES,
    ensemble_attributes,
    member_coordinates,
    provenance,
    with_maps,
    with_targets,
)
from driftcore.errors import ScenarioError, told_by_the_core
from driftcore.geographic import GeographicScenario
from driftcore.geographic_winds import core_path, winds_of
from driftcore.grids import VectorGrid
from driftcore.maps import MapGrid
from driftcore.members import (
    Fates,
    checked_count,
    checked_threads,
    chunk_of,
    follow_in_chunks,
    kept_of,
    members_of,
    warn_of_failures,
)
from driftcore.memory import require_room_for
from driftcore.precision import until_precise
from driftcore.results import Forecast, time_quantiles
from driftcore.scenario import ModelName, Polygons
from driftcore.statistics import Probability, probability, wilson
from driftcore.times import Times, nanoseconds
from driftcore.wind import WindPath

if TYPE_CHECKING:
    import xarray as xr

    from driftcore.coast import LandCoast
    from driftcore.geographic_winds import GeographicWind

Floats = NDArray[np.float64]
_OUTPUTS_H = 3.0


def geographic_trajectory(
    scenario: GeographicScenario,
    path: WindPath | VectorGrid,
    *,
    model: ModelName,
    times: ArrayLike,
    order: int | None = None,
    rtol: float = 1e-8,
    atol: float | None = None,
    seed: int = 1,
) -> xr.Dataset:
    """Follow the first member under a given wind, whatever coast there is: see `trajectory`."""
    import xarray as xr

    _require_geographic(scenario)
    order, solver = _solver(scenario, model, order, rtol, atol)
    instants = _instants(scenario, times)
    wind: Any = (
        winds_of(scenario, path, solver, seed).core(0, 1)
        if isinstance(path, VectorGrid)
        else [core_path(scenario, path)]
    )
    fleet, _, _ = scenario.core_fleet(scenario.core_sea(), None, 0, 1, seed)
    with told_by_the_core():
        arrays, work = fleet.trajectory(wind, solver, instants)
    variables: dict[str, Any] = {}
    labels = {"": arrays[0:2], "mean_": arrays[2:4]}
    for prefix, (position, velocity) in labels.items():
        if not len(position):
            continue
        longitude, latitude = _degrees(scenario, position)
        named = prefix + "{}"
        variables |= {
            named.format("longitude"): ("time", longitude, _LONGITUDE),
            named.format("latitude"): ("time", latitude, _LATITUDE),
            named.format("eastward_velocity"): ("time", velocity[:, 0], {"units": "m s-1"}),
            named.format("northward_velocity"): ("time", velocity[:, 1], {"units": "m s-1"}),
        }
    steps = dict(zip(("steps", "rejected_steps", "evaluations"), work, strict=True))
    attributes = {
        "Conventions": "CF-1.11",
        "featureType": "trajectory",
        "model": model,
        **({} if order is None else {"order": order}),
        "rtol": rtol,
        **steps,
        **scenario.describe(),
        **provenance("trajectory"),
    }
    return xr.Dataset(variables, {"time": ("time", scenario.instants(instants))}, attributes)


@until_precise
def geographic_forecast(
    scenario: GeographicScenario,
    wind: GeographicWind,
    *,
    members: int | Literal["auto"] | None = None,
    precision: float | None = None,
    first_member: int = 0,
    model: ModelName = "mean-flow",
    order: int | None = None,
    seed: int = 1,
    keep: int = 1000,
    times: ArrayLike | None = None,
    maps: MapGrid | None = None,
    targets: Mapping[str, Any] | None = None,
    rtol: float = 1e-6,
    atol: float | None = None,
    threads: int | None = None,
    chunk: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    configuration: str = "# made in Python",
) -> GeographicForecast:
    """Follow an ensemble on the real sea: see `forecast`.

    `times` are UTC, by default every 3 hours. A map's `x` are longitudes, `y` latitudes, its
    `times` days after the earliest release, and `interval` is in days. A target is a polygon of
    [longitude, latitude] points, or `Polygons`. `configuration` is the TOML text, if any, that the
    arguments come from: it is stored, so that `driftcore run` repeats it.
    """
    del precision  # sought by what calls this
    _require_geographic(scenario)
    order, solver = _solver(scenario, model, order, rtol, atol)
    if model == "mean-flow":
        scenario.warn()
    seed = checked_count("seed", seed, least=0)
    winds = winds_of(scenario, wind, solver, seed)
    members = members_of(members, first_member, winds.members)
    keep = checked_count("keep", keep, least=0)
    threads = checked_threads(threads)
    chunk = chunk_of(members, chunk)
    if times is None:
        steps = math.ceil(scenario.days * 24 / _OUTPUTS_H - 1e-9)
        start = scenario.since_origin(scenario.start)
        instants = np.linspace(start, scenario.duration, max(1, steps) + 1)
    else:
        instants = _instants(scenario, times)
    sea, coast = scenario.core_sea(), scenario.core_coast()
    areas = [_area(scenario, name, ring) for name, ring in (targets or {}).items()]
    counted, grid = _maps(scenario, maps, threads)

    kept = kept_of(first_member, members, keep)
    fates = Fates.empty(members, kept, len(instants), len(areas))
    release = np.full((members, 2), np.nan)
    release_time = np.full(members, np.nan)

    def follow(rows: slice, into: Fates) -> str | None:
        first, number = first_member + rows.start, rows.stop - rows.start
        fleet, release[rows], release_time[rows] = scenario.core_fleet(
            sea, coast, first, number, seed
        )
        chosen = winds.core(first, number)
        return fleet.run(chosen, solver, first, instants, keep, into, threads, areas, counted)

    failure = follow_in_chunks(fates, chunk, progress, follow)
    warn_of_failures(fates.status, failure, first_member)
    dataset = _dataset(scenario, first_member, fates, instants, release, release_time)
    dataset.attrs |= {
        **ensemble_attributes(scenario.name, members),
        "model": model,
        **({} if order is None else {"order": order}),
        "rtol": rtol,
        "seed": np.uint64(seed),
        **winds.attributes(),
        **scenario.describe(),
        "configuration": configuration,
    }
    if counted is not None and grid is not None and maps is not None:
        dataset = with_maps(dataset, grid, counted.counts())
        dataset = _geographic_maps(scenario, dataset, maps)
    if targets:
        entries = scenario.instants(fates.entry_time)
        dataset = with_targets(dataset, list(targets), fates.entry_time)
        dataset["entry_time"] = (("member", "target"), entries, {"long_name": "first entry"})
    return GeographicForecast(dataset)


@dataclass(frozen=True, repr=False)
class GeographicForecast(Forecast):
    """A forecast on the real sea.

    Attributes
    ----------
    dataset : xarray.Dataset
        By `member`: `status`, `stranding_time` (UTC, NaT where not stranded),
        `stranding_longitude`, `stranding_latitude`, `release_time`, `release_longitude`,
        `release_latitude`; `longitude` and `latitude` (member or kept_member, time) [degrees].
    """

    @property
    def days_per_unit(self) -> float:
        """1: on the real sea times are counted in days."""
        return 1.0

    def coast(self) -> LandCoast | None:
        """Read the coast of its configuration again, with the stretches named there.

        Returns
        -------
        LandCoast or None
            None where the forecast has no coast, or was made in Python and no file names it.

        Raises
        ------
        DriftCoreError
            The file is no longer there, or does not serve.
        """
        from driftcore.geographic_configuration import GeographicConfiguration

        text = self.configuration()
        if "kind" not in read_toml(text):  # made in Python
            return None
        return GeographicConfiguration.from_toml(text).divided_coast()

    def stranding_probability(self, by: Any = None) -> Probability:
        """Probability of having stranded by a time (UTC; default: the end of the run)."""
        return self._counted(self.dataset["stranding_time"].values, by)

    def entry_probability(self, target: str, by: Any = None) -> Probability:
        """Probability of having entered a target by a time (UTC; default: the end of the run)."""
        self._require_target(target)
        times = self.dataset["entry_time"].sel(target=target).values
        return self._counted(times, by)

    def _counted(self, times: Times, by: Any) -> Probability:
        limit = np.datetime64("2262-01-01", "ns") if by is None else _utc("by", by)[0]
        # NaT is not before anything.
        return probability(int((times <= limit).sum()), self.followed)

    @property
    def stranded(self) -> NDArray[np.bool_]:
        """Which members stranded."""
        flags: NDArray[np.bool_] = self.dataset["status"].values == STATUSES.index("stranded")
        return flags

    @property
    def _stranding_days(self) -> Floats:
        """Time from the earliest release to each stranding [d]."""
        start = np.datetime64(self.dataset.attrs["start"], "ns")
        times = self.dataset["stranding_time"].values[self.stranded]
        return np.asarray((times - start) / np.timedelta64(1, "D"))

    def stranding_by_stretch(self, coast: LandCoast) -> xr.Dataset:
        """Probability of stranding, and when, by stretch of a coast.

        Parameters
        ----------
        coast : LandCoast
            With stretches: named (`with_stretches`) or of equal length (`divide`).

        Returns
        -------
        xarray.Dataset
            By `stretch`: `probability`, `low`, `high` (95 % Wilson) and `time_quantile`
            (quantile, stretch) of the stranding time since the earliest release [d], with
            `time_low` and `time_high` as in `stranding_time_quantiles`. What strands outside all
            stretches is called "elsewhere".
        """
        import xarray as xr

        dataset = self.dataset
        names = [*coast.stretch_names, "elsewhere"]
        points = np.column_stack(
            [dataset["stranding_longitude"].values, dataset["stranding_latitude"].values]
        )[self.stranded]
        stretch = np.full(len(points), -1)
        if len(points):
            stretch = coast.stretch_of(points)
        stretch = np.where(stretch < 0, len(names) - 1, stretch)
        days = self._stranding_days
        counts = np.bincount(stretch, minlength=len(names))
        low, high = wilson(counts, self.followed)
        levels = [0.05, 0.5, 0.95]
        when = xr.concat(
            [time_quantiles(days[stretch == k], levels, "days") for k in range(len(names))],
            "stretch",
            coords=["low", "high"],
        ).transpose("quantile", "stretch")
        return xr.Dataset(
            {
                "probability": ("stretch", counts / self.followed),
                "low": ("stretch", low),
                "high": ("stretch", high),
                "time_quantile": when.variable,
                "time_low": when["low"].variable,
                "time_high": when["high"].variable,
            },
            {"stretch": names, "quantile": levels},
        )

    def stranding_time_quantiles(self, levels: Sequence[float] = (0.05, 0.5, 0.95)) -> xr.DataArray:
        """Quantiles of the time from the earliest release to the stranding [d]: see `Forecast`."""
        return time_quantiles(self._stranding_days, levels, "days")

    def _places(self) -> Floats:
        """Places of stranding relative to the middle of the releases, in local degrees of arc."""
        dataset = self.dataset
        longitude = dataset["stranding_longitude"].values - dataset["release_longitude"].values
        longitude -= 360 * np.round(longitude / 360)
        latitude = dataset["stranding_latitude"].values - dataset["release_latitude"].values
        shrink = np.cos(np.radians(dataset["release_latitude"].values))
        return np.column_stack([longitude * shrink, latitude])[self.stranded]


_LONGITUDE = {"standard_name": "longitude", "units": "degrees_east", "axis": "X"}
_LATITUDE = {"standard_name": "latitude", "units": "degrees_north", "axis": "Y"}
# Name of the variable that says what they refer to, for programs that lay maps over others.
_CRS = "crs"


def _require_geographic(scenario: object) -> None:
    if not isinstance(scenario, GeographicScenario):
        raise ScenarioError(
            f"scenario: {type(scenario).__name__} is not accepted; a Scenario or GeographicScenario"
        )


def _degrees(scenario: GeographicScenario, positions: Floats) -> tuple[Floats, Floats]:
    """Give longitude in [-180, 180) and latitude of positions relative to the reference."""
    longitude, latitude = np.moveaxis(positions + np.array(scenario.reference), -1, 0)
    return (longitude + 180) % 360 - 180, latitude


def _solver(
    scenario: GeographicScenario,
    model: ModelName,
    order: int | None,
    rtol: float,
    atol: float | None,
) -> tuple[int | None, _core.Solver]:
    order, solver = solver_of(scenario, model, order, None, True, "A", rtol, atol)
    if model == "paper" or order == 2:
        raise ScenarioError(
            f"model: {model!r} of order {order} is not accepted; on a geographic scenario it is "
            '"full", or "mean-flow" of order 1'
        )
    return order, solver


def _utc(name: str, times: Any) -> Times:
    """Give times as UTC without a zone, shape (n,); what names no zone is UTC."""
    import pandas as pd

    require_room_for(name, times)
    values = np.atleast_1d(times)
    try:
        if values.ndim != 1 or not len(values) or values.dtype.kind not in "MOU":
            raise ValueError
        instants = pd.to_datetime(values, utc=True, format="ISO8601").tz_localize(None)
    except (TypeError, ValueError):
        raise ScenarioError(f"{name}: must be UTC times, datetime64") from None
    if instants.isna().any():
        raise ScenarioError(f"{name}: must be UTC times, datetime64")
    return nanoseconds(name, instants.to_numpy())


def _instants(scenario: GeographicScenario, times: ArrayLike) -> Floats:
    """Give UTC times as days since the origin."""
    instants = _utc("times", times)
    if (np.diff(instants) < np.timedelta64(0, "ns")).any():
        raise ScenarioError("times: must increase")
    if instants[0] < scenario.start or instants[-1] > scenario.end:
        raise ScenarioError(
            f"times: {instants[0]} to {instants[-1]} is not accepted; the run covers "
            f"{scenario.start} to {scenario.end}"
        )
    return np.asarray(np.minimum(scenario.since_origin(instants), scenario.duration))


def _area(scenario: GeographicScenario, name: str, area: Any) -> _core.Coast:
    rings = []
    for ring in area.rings if isinstance(area, Polygons) else (area,):
        points = np.asarray(getattr(getattr(ring, "exterior", ring), "coords", ring), dtype=float)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ScenarioError(
                f"targets.{name}: must be a polygon, or [longitude, latitude] points"
            )
        points = points - np.array(scenario.reference)
        points[:, 0] -= 360 * np.round(points[:, 0].mean() / 360)
        rings.append(points)
    return area_core(f"targets.{name}", rings)


def _maps(
    scenario: GeographicScenario, maps: MapGrid | None, threads: int
) -> tuple[_core.Maps | None, MapGrid | None]:
    """Give maps in the coordinates of the run."""
    if maps is None:
        return None, None
    longitude = np.array(maps.x) - scenario.reference[0]
    longitude -= 360 * np.round(longitude.mean() / 360)
    start = float(scenario.since_origin(scenario.start))
    grid = MapGrid(
        x=tuple(longitude),
        y=tuple(np.array(maps.y) - scenario.reference[1]),
        times=tuple(start + np.array(maps.times)),
        interval=maps.interval,
    )
    try:
        grid.check(scenario.duration, scenario.period)
    except ValueError as error:
        raise ScenarioError(str(error)) from None
    interval = maps.interval or scenario.period / 8
    steps = math.ceil(scenario.days / interval - 1e-9)
    samples = np.linspace(start, scenario.duration, steps + 1)
    return grid.core(np.union1d(samples, grid.times), threads), grid


def _geographic_maps(
    scenario: GeographicScenario, dataset: xr.Dataset, maps: MapGrid
) -> xr.Dataset:
    """Name the axes of maps by what they are."""
    import pyproj

    x, y = np.array(maps.x), np.array(maps.y)
    times = scenario.instants(scenario.since_origin(scenario.start) + np.array(maps.times))
    names = {
        name + suffix: f"map_{axis}{suffix}"
        for name, axis in (("x", "longitude"), ("y", "latitude"))
        for suffix in ("", "_bounds")
    }
    dataset = dataset.rename(names)
    for variable in dataset.data_vars.values():
        if "map_longitude" in variable.dims:
            variable.attrs["grid_mapping"] = _CRS
    on_maps = ("map_longitude", x, _LONGITUDE), ("map_latitude", y, _LATITUDE)
    coordinates: dict[str, Any] = {}
    for name, edges, about in on_maps:
        bounds = f"{name}_bounds"
        coordinates[name] = (name, (edges[1:] + edges[:-1]) / 2, {**about, "bounds": bounds})
        coordinates[bounds] = ((name, "bound"), np.stack([edges[:-1], edges[1:]], axis=1))
    about = {"standard_name": "time", "axis": "T", "bounds": "map_time_bounds"}
    before = np.append(scenario.start, times[:-1])
    coordinates["map_time"] = ("map_time", times, about)
    coordinates["map_time_bounds"] = (("map_time", "bound"), np.stack([before, times], axis=1))
    system = pyproj.CRS(4326).to_cf()
    return dataset.assign({_CRS: ((), np.int32(0), system)}).assign_coords(coordinates)


def _dataset(
    scenario: GeographicScenario,
    first_member: int,
    fates: Fates,
    instants: Floats,
    release: Floats,
    release_time: Floats,
) -> xr.Dataset:
    import xarray as xr

    import driftcore.accessor  # noqa: F401 (gives the dataset its `.driftcore`)

    longitude, latitude = _degrees(scenario, fates.position)
    stranded = _degrees(scenario, fates.stranding_position)
    released = _degrees(scenario, release)
    dim, coordinates = member_coordinates(first_member, len(fates.status), len(fates.position))
    variables: dict[str, Any] = {
        "status": ("member", fates.status, STATUS_ATTRIBUTES),
        "stranding_time": (
            "member",
            scenario.instants(fates.stranding_time),
            {"long_name": "time of stranding"},
        ),
        "stranding_longitude": ("member", stranded[0], _LONGITUDE),
        "stranding_latitude": ("member", stranded[1], _LATITUDE),
        "release_time": ("member", scenario.instants(release_time)),
        "release_longitude": ("member", released[0], _LONGITUDE),
        "release_latitude": ("member", released[1], _LATITUDE),
        "longitude": ((dim, "time"), longitude, _LONGITUDE),
        "latitude": ((dim, "time"), latitude, _LATITUDE),
    }
    about = {"standard_name": "time", "axis": "T"}
    coordinates["time"] = ("time", scenario.instants(instants), about)
    attributes = {
        "Conventions": "CF-1.11",
        "featureType": "trajectory",
        "reference": json.dumps(scenario.reference),
    }
    return xr.Dataset(variables, coordinates, attributes)
