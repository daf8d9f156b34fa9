"""The paper's own case: Ailliot, Frénod & Monbet (2006), sections 4 and 5."""

from __future__ import annotations

from functools import lru_cache

from driftcore.climate import synthetic_record
from driftcore.scenario import Circle, Polygons, Scenario, Side
from driftcore.sea import Pair
from driftcore.wind import LocalGridBootstrap

# Tables 1 and 2 as printed: mean [least, greatest] over 100 winds of the largest error over the run
# in velocity (orders 0 and 1) and in position (orders 0 and 1). Keys: tides in the run (1/ε), and
# window p in tides (none: W ≡ 0). The greatest velocity error of order 0 at (100, 4) misses a zero.
PRINTED: dict[tuple[int, float | None], tuple[str, str, str, str]] = {
    (50, 0.1): (
        "0.1115 [0.1115,0.1116]",
        "0.0460 [0.0454,0.0467]",
        "0.0174 [0.0173,0.0174]",
        "0.0023 [0.0021,0.0029]",
    ),
    (50, 0.5): (
        "0.1118 [0.1113,0.1134]",
        "0.0460 [0.0448,0.0473]",
        "0.0174 [0.0173,0.0174]",
        "0.0024 [0.0021,0.0032]",
    ),
    (50, 1.0): (
        "0.1125 [0.1108,0.1168]",
        "0.0460 [0.0441,0.0488]",
        "0.0173 [0.0171,0.0174]",
        "0.0026 [0.0020,0.0047]",
    ),
    (50, 4.0): (
        "0.1192 [0.1102,0.1280]",
        "0.0542 [0.0438,0.0691]",
        "0.0174 [0.0166,0.0196]",
        "0.0065 [0.0024,0.0144]",
    ),
    (50, None): ("0.1115", "0.0096", "0.0174", "0.0022"),
    (100, 0.1): (
        "0.0557 [0.0557,0.0557]",
        "0.0292 [0.0270,0.0358]",
        "0.0086 [0.0085,0.0086]",
        "0.0011 [0.0011,0.0014]",
    ),
    (100, 0.5): (
        "0.0558 [0.0554,0.0563]",
        "0.0294 [0.0270,0.0362]",
        "0.0086 [0.0085,0.0086]",
        "0.0012 [0.0010,0.0015]",
    ),
    (100, 1.0): (
        "0.0560 [0.0552,0.0574]",
        "0.0296 [0.0273,0.0363]",
        "0.0085 [0.0084,0.0086]",
        "0.0013 [0.0010,0.0020]",
    ),
    (100, 4.0): (
        "0.0595 [0.0552,0.680]",
        "0.0355 [0.0304,0.0516]",
        "0.0086 [0.0082,0.0098]",
        "0.0026 [0.0010,0.0072]",
    ),
    (25, 0.1): (
        "0.2254 [0.2249,0.2257]",
        "0.1143 [0.1022,0.1418]",
        "0.0358 [0.0358,0.0359]",
        "0.0046 [0.0040,0.0057]",
    ),
    (25, 0.5): (
        "0.2254 [0.2226,0.2277]",
        "0.1142 [0.1017,0.1410]",
        "0.0358 [0.0357,0.0359]",
        "0.0045 [0.0039,0.0058]",
    ),
    (25, 1.0): (
        "0.2257 [0.2201,0.2310]",
        "0.1142 [0.1011,0.1379]",
        "0.0358 [0.0356,0.0360]",
        "0.0044 [0.0037,0.0069]",
    ),
}
# Probability of stranding, section 5.
PRINTED_STRANDING = 0.643


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
