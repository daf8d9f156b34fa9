"""From a scenario through the compiled core to datasets: the one place that runs models."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore import _core
from driftcore.dataset import (
    STATUSES,
    combined,
    ensemble_attributes,
    forecast_dataset,
    is_geographic,
    provenance,
    read_netcdf,
    trajectory_dataset,
    with_maps,
    with_targets,
    write_netcdf,
)
from driftcore.errors import DriftCoreError, DriftCoreWarning, RecordError, ScenarioError
from driftcore.maps import MapGrid
from driftcore.memory import require_room, require_room_for
from driftcore.record import WindRecord
from driftcore.scenario import (
    Circle,
    EnsembleConfiguration,
    ModelName,
    Polygons,
    RunConfiguration,
    Scenario,
    WindConfiguration,
    check_order,
)
from driftcore.statistics import (
    Probability,
    members_needed,
    probability,
    quantile_interval,
    wilson,
)
from driftcore.wind import LocalGridBootstrap, WindPath, WindPaths

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from dask.distributed import Client

    from driftcore.geographic import GeographicScenario
    from driftcore.geographic_configuration import GeographicConfiguration
    from driftcore.geographic_forecast import GeographicForecast
    from driftcore.hand_over import HandOver

Progress = Callable[[int, int], None]
_P = ParamSpec("_P")
_F = TypeVar("_F", bound="Forecast")
Floats = NDArray[np.float64]

# Tides of wind drawn before the release, the same for every model so that a member has one wind:
# the paper model with a window of 4 tides reaches back 3.
_LEAD_IN_TIDES = 3
# Members between two reports of progress, at least: what is shared is prepared anew for each.
_LEAST_CHUNK = 1024
# Members of the first look at a probability, and the growth from one look to the next at least.
FIRST_LOOK, _LEAST_GROWTH = 1000, 1.05
# Half-width sought where none is named.
PRECISION = 0.01
# Small-scale steps in a tide, paper section 4.1.
_FINE_STEPS = 100
# Narrowest averaging window, in tides: a mean over less is a difference of equal numbers.
_NARROWEST = 1e-6
# As in rust/src/python.rs: more than any machine has processors.
_MOST_THREADS = 1024
# Steps of the record that a tide may last, from and to: small-scale steps are worked out beforehand
# for one step, and winds are drawn some tides before the release.
_SHORTEST_TIDE, _LONGEST_TIDE = 1 / 40, 1e4


def trajectory(
    scenario: Scenario | GeographicScenario,
    path: WindPath,
    *,
    model: ModelName,
    times: ArrayLike,
    order: int | None = None,
    window: float | None = None,
    wind_terms: bool = True,
    formulation: Literal["A", "B"] = "B",
    rtol: float = 1e-8,
    atol: float | None = None,
    euler_step: float | None = None,
) -> xr.Dataset:
    """Follow one body under a given wind, whatever coast there is.

    Parameters
    ----------
    scenario : Scenario
        The body, its release and the sea.
    path : WindPath
        Wind in scenario units; it must cover the run (and for `"paper"` a tide and half a window
        before it, half a tide and half a window after it).
    model : {"full", "paper", "mean-flow"}
        Full system (equations.md (4)–(6)), the paper's averaged system (14)–(17), or the
        mean-flow expansion (8)–(13).
    times : array_like of shape (n,)
        Increasing times within the run [scenario time].
    order : int, optional
        0 or 1 (`"paper"`, default 1), 1 or 2 (`"mean-flow"`, default 1).
    window : float, optional
        Averaging window of the wind, `"paper"` only; default half a tide.
    wind_terms : bool
        Whether `"paper"` keeps the wind terms `B_W`.
    formulation : {"A", "B"}
        Exact rewrite that `"full"` integrates.
    rtol, atol : float
        Tolerances of the adaptive integration; `atol` [scenario units] defaults to `rtol`.
    euler_step : float, optional
        Integrate by explicit Euler steps of this length [scenario time] instead: to compare only.

    Returns
    -------
    xarray.Dataset
        `position`, `velocity` of shape (time, component) in scenario units; the averaged models
        also give `mean_position` and `mean_velocity`, without the tidal oscillation. Attributes
        `steps`, `rejected_steps` and `evaluations` (of the right-hand side) tell the work.

    Raises
    ------
    ScenarioError
        An argument is not accepted, or the wind path is too short.
    DriftCoreError
        The integration failed.
    """
    if not isinstance(scenario, Scenario):
        from driftcore.geographic_forecast import geographic_trajectory

        _refuse_paper_options({"window": window, "euler_step": euler_step}, wind_terms)
        return geographic_trajectory(
            scenario, path, model=model, times=times, order=order, rtol=rtol, atol=atol
        )
    if not isinstance(path, WindPath):
        raise ScenarioError(f"path: {type(path).__name__} is not accepted; give a WindPath")
    instants = _output_times(times, scenario.duration)
    order, solver = solver_of(
        scenario, model, order, window, wind_terms, formulation, rtol, atol, euler_step
    )
    compiled = scenario_core(scenario)
    try:
        arrays, work = compiled.trajectory(path.core, solver, instants)
    except ValueError as error:
        raise ScenarioError(str(error)) from None
    except RuntimeError as error:
        raise DriftCoreError(str(error)) from None
    names = ("position", "velocity", "mean_position", "mean_velocity")
    found = {name: a for name, a in zip(names, arrays, strict=True) if len(a)}
    steps = zip(("steps", "rejected_steps", "evaluations"), work, strict=True)
    attributes: dict[str, Any] = {
        "model": model,
        "rtol": rtol,
        **dict(steps),
        **provenance("trajectory"),
    }
    if order is not None:
        attributes["order"] = order
    if model == "paper":
        attributes["window"] = scenario.period / 2 if window is None else window
        attributes["wind_terms"] = int(wind_terms)
    return trajectory_dataset(scenario, instants, found, attributes)


def until_precise(follow: Callable[_P, _F]) -> Callable[_P, _F]:
    """Let a forecast be asked for members = "auto": in parts until its interval is narrow enough.

    The number of members is decided a few times, each time from all that is known: where the
    interval is too wide still, as many follow as (51) tells from its centre. Looking so seldom
    leaves the coverage of the interval as it is (docs/trust.md).
    """

    @wraps(follow)
    def found(*args: _P.args, **kwargs: _P.kwargs) -> _F:
        options: dict[str, Any] = dict(kwargs)
        if options.get("members") != "auto":
            if options.get("precision") is not None:
                raise ScenarioError(
                    f"precision: {options['precision']!r} is not accepted with members = "
                    f'{options.get("members")!r}; with members = "auto" it is'
                )
            return follow(*args, **kwargs)
        if options.get("first_member"):
            raise ScenarioError('first_member: with members = "auto" only 0 is accepted')
        precision = options["precision"] = options.get("precision") or PRECISION
        if not (isinstance(precision, float) and 1e-4 <= precision < 0.5):
            raise ScenarioError(
                f"precision: {precision!r} is not accepted; a number from 0.0001 to 0.5 is"
            )
        progress: Progress | None = options.get("progress")
        parts: list[xr.Dataset] = []
        told: dict[str, warnings.WarningMessage] = {}
        members, wanted = 0, FIRST_LOOK
        while True:

            def report(done: int, _: int, before: int = members, planned: int = wanted) -> None:
                if progress is not None:
                    progress(before + done, planned)

            options |= {"first_member": members, "members": wanted - members, "progress": report}
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                part = follow(*args, **options)
            told |= {str(warning.message): warning for warning in caught}
            parts.append(part.dataset)
            whole = type(part)(combined(parts))
            members, wanted = (
                wanted,
                next_look(whole.stranding_probability(), wanted, precision),
            )
            if wanted == members:
                break
        for warning in told.values():
            warnings.warn(str(warning.message), warning.category, stacklevel=2)
        return whole

    return found


def next_look(found: Probability, members: int, precision: float) -> int:
    """Give the number of members to look at next: equations.md (51); no more if precise enough."""
    if found.half_width <= precision:
        return members
    # Members that fail do not count.
    needed = members_needed((found.low + found.high) / 2, precision) * members / found.members
    return math.ceil(max(needed, _LEAST_GROWTH * members))


@until_precise
def forecast(
    scenario: Scenario | GeographicScenario,
    wind: LocalGridBootstrap | HandOver | Sequence[WindPath] | WindPaths | None = None,
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
    targets: Mapping[str, ArrayLike | Polygons] | None = None,
    window: float | None = None,
    wind_terms: bool = True,
    rtol: float = 1e-6,
    atol: float | None = None,
    steps_per_tide: float | None = None,
    threads: int | None = None,
    chunk: int | None = None,
    progress: Progress | None = None,
) -> Forecast:
    """Follow an ensemble, each member under its own simulated wind, and count the strandings.

    Member `k` of a run depends on `seed` and `k` alone: not on the number of members, threads or
    chunks, and its wind not on the model.

    Parameters
    ----------
    scenario : Scenario
        The body, its release, the sea and the coast.
    wind : LocalGridBootstrap, sequence of WindPath, or WindPaths, optional
        The fitted wind; default `driftcore.paper.default_wind()`, a synthetic climate. Or the
        winds themselves, one member each. On the real sea also a `HandOver` from today's forecast.
    members : int or "auto", optional
        Number of members; default 1000, or as many as there are paths. "auto": as many as
        `precision` takes.
    precision : float, optional
        With members = "auto", the half-width of the 95 % interval of the probability of stranding
        that is to be reached, from 0.0001 to 0.5; default 0.01.
    first_member : int
        Index of the first of them: parts of one ensemble are made apart, of the same arguments
        else, and put together by `driftcore.dataset.combined`.
    model, order, window, wind_terms, rtol, atol
        As in `trajectory`; the default is the mean-flow expansion of order 1. It and `"full"` step
        on a time grid common to all members, two tides and a tenth of one at most; a member whose
        error is estimated above the tolerance is followed by adaptive steps of its own.
    steps_per_tide : float, optional
        Of one length, whatever the estimated error, for these two models: to compare.
    seed : int
        From 0 to 2⁶⁴ − 1.
    keep : int
        How many members' trajectories are kept, from member 0 of the ensemble on.
    times : array_like of shape (n,), optional
        Times at which they are kept; default eight per tide.
    maps : MapGrid, optional
        Count the members on maps while they are followed.
    targets : mapping of str to array_like of shape (n, 2) or Polygons, optional
        Areas by name, each a ring of points: the time of each member's first entry is noted.
        Entering stops nobody; a member released inside enters at 0.
    threads : int, optional
        Threads; default all processors.
    chunk : int, optional
        Members between two calls of `progress`.
    progress : callable, optional
        Called with (members done, members).

    Returns
    -------
    Forecast
        Around a CF dataset; see there.

    Raises
    ------
    ScenarioError
        An argument is not accepted: its name, value and what is accepted are in the message.
    """
    if not isinstance(scenario, Scenario):
        from driftcore.geographic_forecast import geographic_forecast

        paper_only = {"window": window, "steps_per_tide": steps_per_tide}
        _refuse_paper_options(paper_only, wind_terms)
        return geographic_forecast(
            scenario,
            wind,  # type: ignore[arg-type]  # refused there by its name
            members=members,
            first_member=first_member,
            model=model,
            order=order,
            seed=seed,
            keep=keep,
            times=times,
            maps=maps,
            targets=targets,
            rtol=rtol,
            atol=atol,
            threads=threads,
            chunk=chunk,
            progress=progress,
        )
    if wind is None:
        from driftcore.paper import default_wind

        wind = default_wind()
    order, solver = solver_of(scenario, model, order, window, wind_terms, "B", rtol, atol)
    winds: Resampled | _Given
    if isinstance(wind, LocalGridBootstrap):
        winds = Resampled(scenario, wind, solver, seed)
        members = members_of(members, first_member)
    else:
        paths: Any = wind  # anything else is refused by its name
        winds = _Given(scenario, paths, solver)
        members = members_of(members, first_member, len(paths))
    if steps_per_tide is not None and not (
        isinstance(steps_per_tide, int | float | np.number)
        and math.isfinite(steps_per_tide)
        and steps_per_tide > 0
    ):
        raise ScenarioError(
            f"steps_per_tide: {steps_per_tide!r} is not accepted; a finite number above 0 is"
        )
    if times is None:
        times = regular_times(scenario.duration, scenario.period / 8)
    instants = _output_times(times, scenario.duration)
    # A part names the run from member 0 on that ends with it: the last part names the whole.
    settings = EnsembleConfiguration(
        members="auto" if precision else first_member + members,
        precision=precision,
        seed=seed,
        model=model,
        order=order,
        window=window,
        wind_terms=wind_terms,
        rtol=rtol,
        keep=keep,
        outputs_per_tide=max(1, len(instants) - 1) * scenario.period / scenario.duration,
    )
    threads = checked_threads(threads)
    chunk = checked_count("chunk", max(_LEAST_CHUNK, members // 100) if chunk is None else chunk)
    compiled = scenario_core(scenario)
    shapes: Any = targets or {}  # of which the configuration makes polygons
    configuration = RunConfiguration(
        scenario=scenario,
        wind=winds.configuration(),
        ensemble=settings,
        maps=maps,
        targets=shapes,
    )
    areas = [area_core(f"targets.{name}", area) for name, area in configuration.targets.items()]
    counted = None
    if maps is not None:
        regular = regular_times(scenario.duration, maps.interval or scenario.period / 8)
        counted = maps.core(np.union1d(regular, maps.times), threads)
    winds.warn()

    kept = kept_of(first_member, members, keep)
    fates = Fates.empty(members, kept, len(instants), len(areas))

    def follow(rows: slice, into: Fates) -> str | None:
        return compiled.run(
            winds.core,
            solver,
            first_member + rows.start,
            instants,
            keep,
            into,
            threads,
            areas,
            steps_per_tide,
            counted,
        )

    failure = follow_in_chunks(fates, chunk, progress, follow)
    warn_of_failures(fates.status, failure, first_member)

    wind_times, kept_wind = winds.kept(first_member, kept, instants)
    dataset = forecast_dataset(
        scenario,
        first_member=first_member,
        status=fates.status,
        stranding_time=fates.stranding_time,
        stranding_position=fates.stranding_position,
        times=instants,
        position=fates.position,
        wind_times=wind_times,
        wind=kept_wind,
        attributes={
            **ensemble_attributes(scenario.name, members),
            "model": model,
            **({} if order is None else {"order": order}),
            "seed": np.uint64(seed),
            **winds.attributes(),
            "configuration": configuration.to_toml(),
        },
    )
    if maps is not None and counted is not None:
        dataset = with_maps(dataset, maps, counted.counts())
    if areas:
        dataset = with_targets(dataset, list(configuration.targets), fates.entry_time)
    return Forecast(dataset)


@dataclass(frozen=True)
class Forecast:
    """An ensemble forecast: probabilities read from a CF dataset.

    Attributes
    ----------
    dataset : xarray.Dataset
        `status(member)`, `stranding_time(member)`, `stranding_position(member, component)`,
        `position(member, time, component)` and `wind_velocity(member, wind_time, component)` of
        the kept members (dimension `kept_member` where not all are kept). Its attributes hold the
        configuration, version and seed, enough to run it again. With maps: `presence`, `arrival`
        (map_time, y, x), `visit(y, x)`, `outside` and `ashore(map_time)`, each with its
        `..._standard_error`; with targets: `entry_time(member, target)`.
    """

    dataset: xr.Dataset

    @cached_property
    def counts(self) -> dict[str, int]:
        """Number of members by status."""
        status = self.dataset["status"].values
        return {name: int((status == flag).sum()) for flag, name in enumerate(STATUSES)}

    @property
    def followed(self) -> int:
        """Members that could be followed: all but the failed ones."""
        return self.dataset.sizes["member"] - self.counts["failed"]

    @property
    def days_per_unit(self) -> float:
        """Days in the unit of its stranding times."""
        attributes = self.dataset.attrs
        return float(attributes["tide_period_h"] / attributes["epsilon"] / 24)

    def stranding_probability(self, by: float | None = None) -> Probability:
        """Probability of having stranded by a time (default: the end of the run).

        Parameters
        ----------
        by : float, optional
            Scenario time.

        Returns
        -------
        Probability
            Estimate and 95 % Wilson interval; members that left the domain count as not stranded,
            failed members do not count.
        """
        times = self.dataset["stranding_time"].values
        limit = np.inf if by is None else by
        return probability(int((times <= limit).sum()), self.followed)

    def entry_probability(self, target: str, by: float | None = None) -> Probability:
        """Probability of having entered a target by a time (default: the end of the run).

        Parameters
        ----------
        target : str
            Its name.
        by : float, optional
            Scenario time.

        Returns
        -------
        Probability
            As `stranding_probability`.

        Raises
        ------
        ScenarioError
            The forecast has no such target.
        """
        self._require_target(target)
        times = self.dataset["entry_time"].sel(target=target).values
        limit = np.inf if by is None else by
        return probability(int((times <= limit).sum()), self.followed)

    def _require_target(self, target: str) -> None:
        names = self.dataset["target"].values.tolist() if "target" in self.dataset else []
        if target not in names:
            known = f"one of {', '.join(names)}" if names else "the forecast was run without any"
            raise ScenarioError(f"target: {target!r} is not accepted; {known}")

    def stranding_by_sector(self, sectors: int = 16) -> xr.Dataset:
        """Probability of stranding in each direction from the circle's centre, or the release.

        Parameters
        ----------
        sectors : int
            Number of equal sectors; the first is centred on north (+y), then clockwise.

        Returns
        -------
        xarray.Dataset
            `probability`, `low`, `high` of shape (direction,), `direction` in degrees.
        """
        import xarray as xr

        sectors = checked_count("sectors", sectors)
        self.stranding_probability()  # refuses where no member could be followed
        places = self._places()
        bearing = np.degrees(np.arctan2(places[:, 0], places[:, 1]))
        sector = np.round(bearing / (360 / sectors)).astype(int) % sectors
        count = np.bincount(sector, minlength=sectors)
        low, high = wilson(count, self.followed)
        direction = np.arange(sectors) * 360 / sectors
        return xr.Dataset(
            {
                "probability": ("direction", count / self.followed),
                "low": ("direction", low),
                "high": ("direction", high),
            },
            {"direction": ("direction", direction, {"units": "degree", "long_name": "toward"})},
        )

    def stranding_time_quantiles(self, levels: Sequence[float] = (0.05, 0.5, 0.95)) -> xr.DataArray:
        """Quantiles of the stranding time among the stranded members [scenario time].

        Parameters
        ----------
        levels : sequence of float
            Of the quantiles.

        Returns
        -------
        xarray.DataArray
            By `quantile`, NaN where none stranded; its coordinates `low` and `high` are the 95 %
            interval of each, NaN where too few stranded to tell.
        """
        times = self.dataset["stranding_time"].values
        return time_quantiles(times[np.isfinite(times)], levels)

    def _places(self) -> Floats:
        """Places of stranding relative to the circle's centre, or the release."""
        import json

        places = self.dataset["stranding_position"].values
        coast = json.loads(self.dataset.attrs.get("coast", "{}"))
        center = coast.get("center") or json.loads(self.dataset.attrs["release"])
        return np.asarray(places[np.isfinite(places[:, 0])] - np.array(center))

    def configuration(self) -> str:
        """TOML text of the run; `driftcore run` reads it."""
        return str(self.dataset.attrs["configuration"])

    def to_dataframe(self) -> pd.DataFrame:
        """Give a row for each member: see `driftcore.export.members_table`."""
        from driftcore.export import members_table

        return members_table(self)

    def _repr_html_(self) -> str:
        from driftcore.html import forecast_table

        return forecast_table(self)

    def to_netcdf(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the dataset as NetCDF-4: to a temporary name first, then renamed.

        Raises
        ------
        OutputError
            The file exists and `overwrite` is not set, or it cannot be written.
        """
        write_netcdf(self.dataset, Path(path), overwrite)

    def __repr__(self) -> str:
        strands = self.stranding_probability() if self.followed else "unknown"
        members = self.dataset.sizes["member"]
        return f"Forecast({members} members, probability of stranding {strands})"


def time_quantiles(times: Floats, levels: Sequence[float], units: str = "1") -> xr.DataArray:
    """Quantiles of times by `quantile`, with their 95 % intervals `low` and `high`."""
    import xarray as xr

    low, high = quantile_interval(times, levels)
    coordinates = {"quantile": list(levels), "low": ("quantile", low), "high": ("quantile", high)}
    values = np.quantile(times, levels) if len(times) else np.full(len(levels), np.nan)
    return xr.DataArray(
        values, coordinates, "quantile", name="stranding_time", attrs={"units": units}
    )


def run(
    configuration: RunConfiguration | GeographicConfiguration,
    *,
    folder: Path | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    store: str | os.PathLike[str] | None = None,
    resume: bool = False,
    overwrite: bool = False,
    chunk: int | None = None,
    client: Client | None = None,
) -> Forecast:
    """Run a whole configuration: fit the wind it names, then forecast.

    Parameters
    ----------
    configuration : RunConfiguration or GeographicConfiguration
        As their `from_toml`, or `driftcore.read_configuration`, reads it.
    folder : Path, optional
        Where relative paths start; default the working folder.
    threads, progress
        As in `forecast`.
    store : path, optional
        Name of a Zarr store, ending in .zarr. Members are written to it chunk by chunk, so that
        memory does not grow with their number, and a run that is stopped, however, loses no
        finished chunk: it grows as `NAME.zarr.part` and gets its name when it is whole. The
        forecast is that of a run without a store, bit for bit, read lazily.
    resume : bool
        Go on with what is in the store, or begin where nothing is. A chunk that was damaged is
        followed again, which is warned of.
    overwrite : bool
        Replace a store that is there; begin anew where a run is unfinished, unless `resume`.
    chunk : int, optional
        Members in a chunk of the store; by default a hundredth of all, within bounds.
    client : dask.distributed.Client, optional
        Workers that follow the chunks, with all their threads; this process writes.

    Raises
    ------
    ScenarioError, RecordError
        As in `forecast`, and for a file that does not serve.
    OutputError
        The store cannot be written, is in use, or is of another run: what differs is told.
    """
    if not hasattr(configuration, "ensemble"):
        raise ScenarioError(
            f"configuration: {type(configuration).__name__} is not accepted; what "
            "driftcore.read_configuration(file) gives"
        )
    if store is None:
        given = {"resume": resume, "overwrite": overwrite, "chunk": chunk, "client": client}
        for name, value in given.items():
            if value:
                raise ScenarioError(f"{name}: {value!r} is not accepted without a store")
        return planned(configuration, folder)(threads=threads, progress=progress)
    from driftcore.store import run_stored

    dataset = run_stored(
        configuration,
        Path(store),
        folder=folder,
        resume=resume,
        overwrite=overwrite,
        chunk=chunk,
        threads=threads,
        progress=progress,
        client=client,
    )
    return forecast_of(dataset)


def planned(
    configuration: RunConfiguration | GeographicConfiguration, folder: Path | None = None
) -> partial[Forecast] | partial[GeographicForecast]:
    """Prepare the forecast that a configuration names, all but the members.

    Returns
    -------
    functools.partial
        `forecast`, or the one of the real sea; its `args` are the scenario and the fitted wind.
    """
    if not isinstance(configuration, RunConfiguration):
        from driftcore.geographic_forecast import geographic_forecast

        # Absolute paths, so that what is stored can be run again from anywhere.
        whole = configuration.rooted(folder)
        members, sea = whole.ensemble, whole.scenario()
        return partial(
            geographic_forecast,
            sea,
            fitted_wind(whole.wind),
            members=members.members,
            precision=members.precision,
            model=members.model,
            order=members.order,
            seed=members.seed,
            keep=members.keep,
            times=sea.instants(
                sea.since_origin(sea.start) + regular_times(sea.days, members.outputs_h / 24)
            ).clip(max=sea.end),
            rtol=members.rtol,
            maps=None if whole.maps is None else whole.maps.grid(),
            targets=whole.targets,
            configuration=whole.to_toml(),
        )
    settings = configuration.ensemble
    scenario = configuration.scenario
    solver_of(
        scenario,
        settings.model,
        settings.order,
        settings.window,
        settings.wind_terms,
        "B",
        settings.rtol,
        None,
    )
    scenario_core(scenario)
    interval = scenario.period / settings.outputs_per_tide
    return partial(
        forecast,
        scenario,
        fitted_wind(configuration.wind, folder),
        members=settings.members,
        precision=settings.precision,
        model=settings.model,
        order=settings.order,
        seed=settings.seed,
        keep=settings.keep,
        times=regular_times(scenario.duration, interval),
        window=settings.window,
        wind_terms=settings.wind_terms,
        rtol=settings.rtol,
        maps=configuration.maps,
        targets=configuration.targets,
    )


def fitted_wind(wind: WindConfiguration, folder: Path | None = None) -> LocalGridBootstrap:
    """Fit the wind that a configuration names; relative paths start at `folder`."""
    from driftcore.climate import synthetic_record

    record: Any = synthetic_record() if wind.record == "embedded" else Path(wind.record)
    if isinstance(record, Path) and folder is not None:
        record = folder / record
    return LocalGridBootstrap.fit(
        record,
        months=wind.months,
        mode=wind.mode,
        h=wind.h,
        b=wind.b,
        order=wind.order,
        gaps=wind.gaps,
        share=wind.share,
        memory_h=wind.memory_h,
    )


def open_forecast(path: str | os.PathLike[str]) -> Forecast:
    """Read a forecast written by `Forecast.to_netcdf`, or open a store lazily: a folder, .zarr.

    Returns
    -------
    Forecast
        A `GeographicForecast` where it is one.

    Raises
    ------
    OutputError
        The file is missing or is not a driftcore forecast, or the store is unfinished.
    """
    if Path(path).suffix == ".zarr":
        from driftcore.store import open_store

        return forecast_of(open_store(Path(path)))
    return forecast_of(read_netcdf(Path(path)))


def forecast_of(dataset: xr.Dataset) -> Forecast:
    """Give the forecast that a dataset is, a `GeographicForecast` where it is one."""
    if is_geographic(dataset):
        from driftcore.geographic_forecast import GeographicForecast

        return GeographicForecast(dataset)
    return Forecast(dataset)


def member_path(
    scenario: Scenario, wind: LocalGridBootstrap, member: int, seed: int = 1
) -> WindPath:
    """Wind of one member of a forecast, in scenario units, on its fine knots.

    It covers the run and what any averaging window up to four tides wide needs around it.
    """
    solver = _core.Solver.paper(1, 4 * scenario.period, True, 1e-8, 1e-8, None)
    winds = Resampled(scenario, wind, solver, seed)
    member, seed = checked_count("member", member, least=0), checked_count("seed", seed, least=0)
    return WindPath(*winds.generator.path(seed, member, winds.end))


def record_paths(scenario: Scenario, record: WindRecord) -> list[WindPath]:
    """Every window of a record that is as long as a run, as wind paths in scenario units.

    What a forecast resamples from, without resampling: the windows overlap, so that they are far
    from independent.

    Parameters
    ----------
    scenario : Scenario
        Its units and the length of its run.
    record : WindRecord
        As `read_record` gives it; no window spans two of its segments.

    Raises
    ------
    RecordError
        No segment is as long as the run.
    """
    step = record.step_h / scenario.hours_per_unit
    length = math.ceil(scenario.duration / step - 1e-9) + 1
    times = np.arange(length) * step
    segment = record.segment
    first = np.arange(max(0, len(record) - length + 1))
    first = first[segment[first] == segment[first + length - 1]]
    if not len(first):
        raise RecordError(
            f"record: no segment lasts the {scenario.duration_days:.1f} days of the run"
        )
    velocity = record.velocity / scenario.wind_unit
    return [WindPath(times, velocity[k : k + length]) for k in first]


def member_trajectories(
    forecast: Forecast, member: int = 0
) -> tuple[xr.Dataset, xr.Dataset, WindPath]:
    """Follow one member of a forecast again, closely, by the full and by an averaged model.

    Parameters
    ----------
    forecast : Forecast
        Made by `run` or `forecast`; its configuration names the wind.
    member : int
        Index of the member.

    Returns
    -------
    full, averaged : xarray.Dataset
        As `trajectory`, 40 times per tide; `averaged` by the forecast's model, or by mean-flow of
        order 1 where that was the full one.
    path : WindPath
        The member's wind.
    """
    configuration = RunConfiguration.from_toml(forecast.configuration())
    scenario, settings = configuration.scenario, configuration.ensemble
    wind = fitted_wind(configuration.wind)
    path = member_path(scenario, wind, member, settings.seed)
    times = regular_times(scenario.duration, scenario.period / 40)
    full = trajectory(scenario, path, model="full", times=times, rtol=1e-10)
    averaged = trajectory(
        scenario,
        path,
        model="mean-flow" if settings.model == "full" else settings.model,
        order=settings.order,
        times=times,
        window=settings.window,
        wind_terms=settings.wind_terms,
    )
    for dataset in (full, averaged):
        for name in ("wind_label", "wind_synthetic", "wind_sha256"):
            dataset.attrs[name] = forecast.dataset.attrs[name]
    return full, averaged, path


def _refuse_paper_options(options: dict[str, Any], wind_terms: bool) -> None:
    for name, value in options.items():
        if value is not None:
            raise ScenarioError(f"{name}: {value!r} is not accepted on a geographic scenario")
    if not wind_terms:
        raise ScenarioError('wind_terms: only the model "paper" has them')


def follow_in_chunks(
    fates: Fates,
    chunk: int,
    progress: Progress | None,
    follow: Callable[[slice, Fates], str | None],
) -> str | None:
    """Follow all members, some at a time; give the first failure.

    Parameters
    ----------
    fates : Fates
        Filled in.
    chunk : int
        Members at a time.
    progress : callable, optional
        Called with (members done, members) after each chunk.
    follow : callable
        Follows the members of a slice into their part of the fates; gives the first failure.

    Raises
    ------
    ScenarioError
        The core refuses an argument.
    """
    members, failure = len(fates.status), None
    for first in range(0, members, chunk):
        rows = slice(first, min(first + chunk, members))
        try:
            failed = follow(rows, fates.rows(rows))
        except ValueError as error:
            raise ScenarioError(str(error)) from None
        failure = failure or failed
        if progress is not None:
            progress(rows.stop, members)
    return failure


def substeps_of(step: float, period: float) -> int:
    """Give the number of small-scale steps in a synoptic one, both times in one unit."""
    return max(1, math.ceil(step / (period / _FINE_STEPS) - 1e-9))


def regular_times(duration: float, interval: float) -> Floats:
    """Regular times from 0 to the end of a run, both included, about `interval` apart."""
    require_room("times", duration / interval, 3 * 8, f"times {interval:g} apart")
    return np.linspace(0.0, duration, max(1, math.ceil(duration / interval - 1e-9)) + 1)


def scenario_core(scenario: Scenario) -> _core.Scenario:
    """Build the core's scenario, and refuse a release on the wrong side of the coast."""
    x, y = scenario.position
    try:
        sea = scenario.sea.core(scenario.period, scenario.epsilon, scenario.duration)
        coast = None
        if scenario.coast is not None:
            inside = scenario.side == "inside"
            if isinstance(scenario.coast, Circle):
                coast = _core.Coast.circle(scenario.coast.center, scenario.coast.radius, inside)
            else:
                rings = [np.array(ring) for ring in scenario.coast.rings]
                coast = _core.Coast.polygons(rings, inside)
        compiled = _core.Scenario(
            sea, coast, scenario.drag, scenario.duration, scenario.position, scenario.velocity
        )
        sea.velocity(np.zeros(1), np.array([[x, y]]))
    except ValueError as error:
        raise ScenarioError(str(error)) from None
    # On the line up to rounding is on the line: stranded at once.
    if coast is not None and coast.clearance(x, y) < -1e-12 * max(1.0, abs(x), abs(y)):
        found, wanted = ("outside", "within") if inside else ("within", "outside")
        raise ScenarioError(
            f"scenario.position: ({x:g}, {y:g}) lies {found} the coast line, by "
            f"{-coast.clearance(x, y):.4g}; with side = {scenario.side!r} it must lie {wanted} it"
        )
    return compiled


def area_core(field: str, area: Polygons) -> _core.Coast:
    """Build the core's shape of an area that is entered from outside."""
    try:
        return _core.Coast.polygons([np.array(ring) for ring in area.rings], inside=False)
    except ValueError as error:
        raise ScenarioError(f"{field}: {error}") from None


def solver_of(
    scenario: Scenario | GeographicScenario,
    model: str,
    order: int | None,
    window: float | None,
    wind_terms: bool,
    formulation: str,
    rtol: float,
    atol: float | None,
    euler_step: float | None = None,
) -> tuple[int | None, _core.Solver]:
    """Check a model and its numbers; give its order and the compiled solver."""
    try:
        order = check_order(model, order)
    except ValueError as error:
        raise ScenarioError(str(error)) from None
    atol = rtol if atol is None else atol
    numbers = {"rtol": rtol, "atol": atol, "euler_step": euler_step, "window": window}
    for field, value in numbers.items():
        number = isinstance(value, int | float | np.number)
        if value is not None and not (number and math.isfinite(value) and value > 0):
            raise ScenarioError(f"{field}: {value!r} is not accepted; a finite number above 0 is")
    if window is not None and model != "paper":
        raise ScenarioError(f'window: model {model!r} has none; only "paper" averages the wind')
    if window is not None and window < _NARROWEST * scenario.period:
        raise ScenarioError(
            f"window: {window:g} is not accepted; at least {_NARROWEST:g} of a tide, "
            f"{_NARROWEST * scenario.period:g}"
        )
    if formulation not in ("A", "B"):
        raise ScenarioError(f'formulation: {formulation!r} is not accepted; "A" or "B"')
    if model == "full":
        return order, _core.Solver.full(formulation == "A", rtol, atol, euler_step)
    assert order is not None  # noqa: S101 (for the type checker: both models below have a default)
    if model == "mean-flow":
        return order, _core.Solver.mean_flow(order, rtol, atol, euler_step)
    window = scenario.period / 2 if window is None else window
    return order, _core.Solver.paper(order, window, wind_terms, rtol, atol, euler_step)


class Fates(NamedTuple):
    """What became of the members, filled in by the core."""

    status: NDArray[np.int8]
    """Shape (members,), an index of `STATUSES`."""
    stranding_time: Floats
    """Shape (members,), NaN where not stranded."""
    stranding_position: Floats
    """Shape (members, 2)."""
    position: Floats
    """Shape (kept members, output times, 2), NaN where not adrift."""
    entry_time: Floats
    """Shape (members, targets), NaN where not entered."""

    @classmethod
    def empty(cls, members: int, keep: int, outputs: int, targets: int) -> Fates:
        """Of members not followed yet; what does not fit into memory is refused.

        Twice over, for a dataset is made of them.
        """
        require_room("members", members, 2 * (25 + 8 * targets), "members")
        require_room("keep", float(keep) * outputs, 2 * 16, "positions of members kept")
        return cls(
            np.zeros(members, dtype=np.int8),
            np.full(members, np.nan),
            np.full((members, 2), np.nan),
            np.full((keep, outputs, 2), np.nan),
            np.full((members, targets), np.nan),
        )

    def rows(self, rows: slice) -> Fates:
        """Those of some members, as views."""
        return Fates(
            self.status[rows],
            self.stranding_time[rows],
            self.stranding_position[rows],
            self.position[rows],
            self.entry_time[rows],
        )


class Resampled:
    """Winds drawn by a fitted bootstrap, named by (seed, member)."""

    def __init__(
        self,
        scenario: Scenario | GeographicScenario,
        wind: LocalGridBootstrap,
        solver: _core.Solver,
        seed: int,
        phase: int | None = None,
        hand_over: Callable[[int], _core.HandOver] | None = None,
    ) -> None:
        """`hand_over` gives what the members begin with, so many steps before time 0."""
        self.scenario, self.wind, self.seed = scenario, wind, seed
        step = wind.record.step_h / scenario.hours_per_unit
        tide_h = scenario.period * scenario.hours_per_unit
        shortest, longest = (wind.record.step_h * k for k in (_SHORTEST_TIDE, _LONGEST_TIDE))
        if not (step > 0 and shortest <= tide_h <= longest):
            raise ScenarioError(
                f"tide_period_h: {tide_h:g} is not accepted; with a wind every "
                f"{wind.record.step_h:g} h it should be from {shortest:g} to {longest:g}"
            )
        substeps = substeps_of(step, scenario.period)
        lead_in = math.ceil(_LEAD_IN_TIDES * scenario.period / step - 1e-9)
        start, self.end = solver.wind_needed(scenario.duration, scenario.period)
        if start < -_LEAD_IN_TIDES * scenario.period * (1 + 1e-9):
            raise ScenarioError(
                f"window: the simulated wind starts {_LEAD_IN_TIDES} tides before the release, but "
                f"this window needs it {-start / scenario.period:.3g} tides before; "
                f"windows up to {4 * scenario.period:g} (4 tides) are accepted"
            )
        handed = None if hand_over is None else hand_over(lead_in)
        try:
            self.generator = _core.WindGenerator(
                wind.core,
                step,
                scenario.wind_unit,
                wind.small_scale_sd / scenario.wind_unit,
                wind.memory_h / scenario.hours_per_unit,
                substeps,
                lead_in,
                None if phase is None else wind.phase_before(phase, lead_in),
                handed,
            )
        except ValueError as error:
            raise ScenarioError(str(error)) from None
        self.lead_in = lead_in
        self.times = np.arange(math.ceil(self.end / step - 1e-9) + 1) * np.float64(step)

    @property
    def core(self) -> tuple[_core.WindGenerator, int]:
        """What the compiled core draws from."""
        return self.generator, self.seed

    def kept(self, first: int, count: int, instants: Floats) -> tuple[Floats, Floats]:
        """Give the synoptic wind [m/s] of `count` members from the release on."""
        del instants
        steps = self.lead_in + len(self.times)
        require_room("keep", count * float(steps), 3 * 24, "winds kept")
        wind, _ = self.wind.core.sample(count, steps, self.seed, first)
        return self.times, wind[:, self.lead_in :]

    def configuration(self) -> WindConfiguration:
        """Give what names the wind in a stored run."""
        known = self.wind.config()
        if self.wind.record.synthetic:
            known["record"] = "embedded"
        else:
            known["record"] = known.get("source", f"{self.wind.record.label} (given in Python)")
        fields = WindConfiguration.model_fields
        return WindConfiguration(**{name: known[name] for name in fields if name in known})

    def attributes(self) -> dict[str, Any]:
        """Give what tells a reader the record."""
        record = self.wind.record
        return {
            "wind_label": record.label,
            "wind_synthetic": int(record.synthetic),
            "wind_sha256": record.sha256,
        }

    def warn(self) -> None:
        """Warn where the run is longer than the season."""
        if self.scenario.duration_days > self.wind.span_days:
            warnings.warn(
                f"the run lasts {self.scenario.duration_days:.0f} days, the months chosen "
                f"{self.wind.span_days:.0f}: the simulated season goes on beyond its end",
                DriftCoreWarning,
                stacklevel=4,
            )


class _Given:
    """Winds given as paths, one for each member: a list of them, or all on common knots."""

    def __init__(
        self, scenario: Scenario, paths: Sequence[WindPath] | WindPaths, solver: _core.Solver
    ) -> None:
        together = isinstance(paths, WindPaths)
        if not together and not (
            isinstance(paths, Sequence) and all(isinstance(p, WindPath) for p in paths)
        ):
            raise ScenarioError(
                f"wind: {type(paths).__name__} is not accepted; a fitted LocalGridBootstrap, a "
                "list of WindPath, or WindPaths"
            )
        if not len(paths):
            raise ScenarioError("wind: the list of paths is empty")
        start, end = solver.wind_needed(scenario.duration, scenario.period)
        slack = 1e-9 * (end - start)
        spans = [paths.times] if isinstance(paths, WindPaths) else [path.times for path in paths]
        for k, times in enumerate(spans):
            if times[0] > start + slack or times[-1] < end - slack:
                which = "they cover" if together else f"path {k} covers"
                raise ScenarioError(
                    f"wind: {which} [{times[0]:g}, {times[-1]:g}]; "
                    f"the run needs [{start:g}, {end:g}]"
                )
        self.scenario, self.paths = scenario, paths

    @property
    def core(self) -> list[_core.WindPath] | _core.WindPaths:
        """The compiled paths."""
        if isinstance(self.paths, WindPaths):
            return self.paths.core
        return [path.core for path in self.paths]

    def kept(self, first: int, count: int, instants: Floats) -> tuple[Floats, Floats]:
        """Give the wind [m/s] of `count` members at the output times."""
        if isinstance(self.paths, WindPaths):
            wind = self.paths.core.velocity(first + count if count else 0, instants)[first:]
        else:
            chosen = self.paths[first : first + count]
            wind = np.array([path.core.velocity(instants) for path in chosen])
        return instants, wind.reshape(count, len(instants), 2) * self.scenario.wind_unit

    def configuration(self) -> WindConfiguration:
        return WindConfiguration(record=self.attributes()["wind_label"])

    def attributes(self) -> dict[str, Any]:
        return {"wind_label": f"{len(self.paths)} wind paths given in Python", "wind_synthetic": 0}

    def warn(self) -> None:
        """Nothing: no season is simulated."""


def _output_times(times: ArrayLike, duration: float) -> Floats:
    require_room_for("times", times)
    try:
        instants = np.atleast_1d(np.asarray(times, dtype=float))
    except (TypeError, ValueError):
        raise ScenarioError("times: must be one finite number or a list of them") from None
    if instants.ndim != 1 or len(instants) == 0 or not np.isfinite(instants).all():
        raise ScenarioError("times: must be one finite number or a list of them")
    if (np.diff(instants) < 0).any():
        raise ScenarioError("times: must increase")
    if instants[0] < 0 or instants[-1] > duration:
        raise ScenarioError(
            f"times: [{instants[0]:g}, {instants[-1]:g}] is not accepted; "
            f"the run covers [0, {duration:g}]"
        )
    return np.ascontiguousarray(instants)


def checked_count(field: str, value: Any, least: int = 1) -> int:
    """Refuse what is not a whole number from `least` up."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ScenarioError(f"{field}: {value!r} is not accepted; a whole number from {least} up")
    return int(value)


def members_of(members: int | str | None, first_member: int, paths: int | None = None) -> int:
    """Check a range of members, of as many as there are paths where the wind is given by them."""
    first = checked_count("first_member", first_member, least=0)
    if paths is None:
        return 1000 if members is None else checked_count("members", members)
    if first >= paths:
        raise ScenarioError(f"first_member: {first} is not accepted; {paths} paths were given")
    members = paths - first if members is None else checked_count("members", members)
    if first + members > paths:
        after = f"; {first} come before" if first else ""
        raise ScenarioError(f"members: {members} is not accepted; {paths} paths were given{after}")
    return members


def kept_of(first_member: int, members: int, keep: int) -> int:
    """Give the number of members in a range whose index is below `keep`."""
    return min(max(keep - first_member, 0), members)


def checked_threads(threads: int | None) -> int:
    """Give the number of threads, all processors if it is left open."""
    number = default_threads() if threads is None else checked_count("threads", threads)
    if number > _MOST_THREADS:
        raise ScenarioError(f"threads: {number} is not accepted; at most {_MOST_THREADS}")
    return number


def default_threads() -> int:
    """Give the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def warn_of_failures(status: NDArray[np.int8], first: str | None, first_member: int = 0) -> None:
    """Warn of members that could not be followed, with the first failure."""
    failed = np.flatnonzero(status == STATUSES.index("failed"))
    if len(failed):
        warnings.warn(
            f"{len(failed)} of {len(status)} members failed; member "
            f"{first_member + failed[0]}: {first}",
            DriftCoreWarning,
            stacklevel=3,
        )
