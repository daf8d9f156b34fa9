"""One body under one wind, followed closely."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from numpy.typing import ArrayLike

from driftcore.compiled import (
    output_times,
    refuse_paper_options,
    regular_times,
    scenario_core,
    solver_of,
)
from driftcore.dataset import provenance, trajectory_dataset
from driftcore.ensemble_winds import fitted_wind, member_path
from driftcore.errors import ScenarioError, told_by_the_core
from driftcore.results import Forecast
from driftcore.scenario import ModelName, RunConfiguration, Scenario
from driftcore.wind import WindPath

if TYPE_CHECKING:
    import xarray as xr

    from driftcore.geographic import GeographicScenario


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

        refuse_paper_options({"window": window, "euler_step": euler_step}, wind_terms)
        return geographic_trajectory(
            scenario, path, model=model, times=times, order=order, rtol=rtol, atol=atol
        )
    if not isinstance(path, WindPath):
        raise ScenarioError(f"path: {type(path).__name__} is not accepted; give a WindPath")
    instants = output_times(times, scenario.duration)
    order, solver = solver_of(
        scenario, model, order, window, wind_terms, formulation, rtol, atol, euler_step
    )
    compiled = scenario_core(scenario)
    with told_by_the_core():
        arrays, work = compiled.trajectory(path.core, solver, instants)
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
