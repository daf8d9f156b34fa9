"""From a scenario and its winds through the compiled core to a forecast."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from driftcore.compiled import (
    area_core,
    output_times,
    refuse_paper_options,
    regular_times,
    scenario_core,
    solver_of,
)
from driftcore.dataset import ensemble_attributes, forecast_dataset, with_maps, with_targets
from driftcore.ensemble_winds import Given, Resampled
from driftcore.errors import ScenarioError
from driftcore.maps import MapGrid
from driftcore.members import (
    Fates,
    Progress,
    checked_threads,
    chunk_of,
    follow_in_chunks,
    kept_of,
    members_of,
    warn_of_failures,
)
from driftcore.precision import until_precise
from driftcore.results import Forecast
from driftcore.scenario import (
    EnsembleConfiguration,
    ModelName,
    Polygons,
    RunConfiguration,
    Scenario,
)
from driftcore.wind import LocalGridBootstrap, WindPath, WindPaths

if TYPE_CHECKING:
    from driftcore.geographic import GeographicScenario
    from driftcore.hand_over import HandOver


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
        refuse_paper_options(paper_only, wind_terms)
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
    winds: Resampled | Given
    if isinstance(wind, LocalGridBootstrap):
        winds = Resampled(scenario, wind, solver, seed)
        members = members_of(members, first_member)
    else:
        paths: Any = wind  # anything else is refused by its name
        winds = Given(scenario, paths, solver)
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
    instants = output_times(times, scenario.duration)
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
    chunk = chunk_of(members, chunk)
    compiled = scenario_core(scenario)
    shapes: Any = targets or {}  # of which the configuration makes polygons
    configuration = RunConfiguration(
        scenario=scenario,
        wind=winds.configuration(),
        ensemble=settings,
        maps=maps,
        targets=shapes,
    )
    areas = [
        area_core(f"targets.{name}", area.rings) for name, area in configuration.targets.items()
    ]
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
