"""Runs as a configuration names them: the wind fitted, then the forecast, stored as it grows."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from driftcore.compiled import regular_times, scenario_core, solver_of
from driftcore.ensemble_winds import fitted_wind
from driftcore.errors import ScenarioError
from driftcore.forecast import forecast
from driftcore.members import Progress
from driftcore.results import Forecast, forecast_of
from driftcore.scenario import RunConfiguration

if TYPE_CHECKING:
    from dask.distributed import Client

    from driftcore.geographic_configuration import GeographicConfiguration
    from driftcore.geographic_forecast import GeographicForecast


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
