"""What a scenario, its areas, its times and its model become for the compiled core."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore import _core
from driftcore.errors import ScenarioError
from driftcore.memory import require_room, require_room_for
from driftcore.scenario import Circle, Scenario, check_order

if TYPE_CHECKING:
    from driftcore.geographic import GeographicScenario

Floats = NDArray[np.float64]

# Narrowest averaging window, in tides: a mean over less is a difference of equal numbers.
_NARROWEST = 1e-6


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


def area_core(field: str, rings: Iterable[ArrayLike]) -> _core.Coast:
    """Build the core's shape of an area that is entered from outside, by its rings."""
    try:
        return _core.Coast.polygons([np.array(ring) for ring in rings], inside=False)
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


def refuse_paper_options(options: dict[str, Any], wind_terms: bool) -> None:
    """Refuse on the real sea what only a scenario of the paper's kind has."""
    for name, value in options.items():
        if value is not None:
            raise ScenarioError(f"{name}: {value!r} is not accepted on a geographic scenario")
    if not wind_terms:
        raise ScenarioError('wind_terms: only the model "paper" has them')


def regular_times(duration: float, interval: float) -> Floats:
    """Regular times from 0 to the end of a run, both included, about `interval` apart."""
    require_room("times", duration / interval, 3 * 8, f"times {interval:g} apart")
    return np.linspace(0.0, duration, max(1, math.ceil(duration / interval - 1e-9)) + 1)


def output_times(times: ArrayLike, duration: float) -> Floats:
    """Check times within a run: finite and increasing."""
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
