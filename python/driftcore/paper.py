"""The paper's own case: Ailliot, Frénod & Monbet (2006), sections 4 and 5."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from driftcore.climate import synthetic_record
from driftcore.scenario import Circle, Polygons, Scenario, Side
from driftcore.sea import Pair
from driftcore.wind import LocalGridBootstrap, WindPath

if TYPE_CHECKING:
    import xarray as xr


def scenario(
    epsilon: float = 1 / 50,
    x: Pair = (1.0, 1.0),
    v: Pair = (0.0, 0.0),
    drag: float = 1.0,
    coast: Circle | Polygons | None = Circle(),  # noqa: B008 (frozen)
    side: Side = "inside",
    wind_unit: float = 3.0,
    tide_period_h: float = 12.5,
) -> Scenario:
    """Give the paper's academic case.

    Parameters
    ----------
    epsilon : float
        Tide period over the length of the run.
    x, v : pair of float
        Position and velocity at the release.
    drag : float
        Drag rate Λ; 1 in the paper.
    coast : Circle or Polygons, optional
        Coast line; the paper's is the circle around (1, 1) of radius 0.3.
    side : {"inside", "outside"}
        Side of the coast line that the body floats on.
    wind_unit : float
        The unit of velocity [m/s], which the paper does not state.
    tide_period_h : float
        Tide period [h].

    Returns
    -------
    Scenario
        Dimensionless: one unit of time is the run.

    Raises
    ------
    ScenarioError
        A value is not accepted.
    """
    return Scenario(
        epsilon=epsilon,
        position=x,
        velocity=v,
        drag=drag,
        coast=coast,
        side=side,
        wind_unit=wind_unit,
        tide_period_h=tide_period_h,
    )


@lru_cache(maxsize=1)
def default_wind() -> LocalGridBootstrap:
    """Give the embedded synthetic climate, fitted: `driftcore.climate.synthetic_record`."""
    return LocalGridBootstrap.fit(synthetic_record())


@dataclass(frozen=True)
class Check:
    """A measured error beside the largest that is accepted."""

    name: str
    measured: float
    required: float

    @property
    def passed(self) -> bool:
        """Whether the measured error is small enough."""
        return self.measured <= self.required


def sup_errors(exact: xr.Dataset, approximate: xr.Dataset) -> tuple[float, float]:
    """Largest distance over the run of (velocity, position) between two trajectories.

    Both of the same times; Euclidean norm, paper section 4.2.
    """
    distances = (
        np.linalg.norm(exact[name].values - approximate[name].values, axis=-1)
        for name in ("velocity", "position")
    )
    velocity, position = (float(distance.max()) for distance in distances)
    return velocity, position


def validation(members: int = 5) -> list[Check]:
    """Measure the averaged models against the full one.

    Without wind, the stroboscopic expansion; with simulated winds, the mean-flow expansion.

    Parameters
    ----------
    members : int
        Number of winds; the largest error counts.
    """
    from driftcore.forecast import member_path, trajectory

    checks = []
    calm = WindPath([-1.0, 2.0], np.zeros((2, 2)))
    # Errors of orders 0 and 1 without wind: first and second power of epsilon, docs/validation.md.
    for period in (25, 50, 100, 200):
        case = scenario(1 / period)
        times = np.linspace(0, 1, 40 * period + 1)
        full = trajectory(case, calm, model="full", times=times, rtol=1e-10)
        for order, limits in ((0, (5.75, 0.92)), (1, (3.9, 1.85))):
            averaged = trajectory(case, calm, model="paper", order=order, times=times)
            for name, error, limit in zip(
                ("velocity", "position"), sup_errors(full, averaged), limits, strict=True
            ):
                label = f"no wind, epsilon 1/{period}, paper order {order}, {name}"
                checks.append(Check(label, error, limit / period ** (order + 1)))
    wind = default_wind()
    for period in (25, 50, 100):
        case = scenario(1 / period)
        times = np.linspace(0, 1, 40 * period + 1)
        paths = [member_path(case, wind, member) for member in range(members)]
        fulls = [trajectory(case, p, model="full", times=times, rtol=1e-10) for p in paths]
        for order, limits in ((1, (3.5, 2.0)), (2, (5.0, 2.5))):
            errors = [
                sup_errors(full, trajectory(case, p, model="mean-flow", order=order, times=times))
                for full, p in zip(fulls, paths, strict=True)
            ]
            for name, error, limit in zip(
                ("velocity", "position"), np.max(errors, axis=0), limits, strict=True
            ):
                label = f"wind, epsilon 1/{period}, mean-flow order {order}, {name}"
                checks.append(Check(label, float(error), limit / period ** (order + 1)))
    return checks
