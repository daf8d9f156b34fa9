"""Forecasts of things adrift on the sea, weeks to months ahead, as probabilities.

Examples
--------
>>> import driftcore as dc
>>> scenario = dc.paper.scenario(epsilon=1 / 50)
>>> forecast = dc.forecast(scenario, members=200)
>>> print(forecast.stranding_probability())
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from driftcore import _core, paper
from driftcore.ensemble_winds import member_path, record_paths
from driftcore.errors import (
    DriftCoreError,
    DriftCoreWarning,
    OutputError,
    RecordError,
    ScenarioError,
)
from driftcore.forecast import forecast
from driftcore.maps import MapGrid
from driftcore.multifidelity import MultifidelityProbability, multifidelity_probability
from driftcore.record import WindRecord, read_record
from driftcore.results import Forecast, open_forecast
from driftcore.runs import run
from driftcore.scenario import Circle, Polygons, RunConfiguration, Scenario
from driftcore.sea import AcademicSea, HarmonicSea
from driftcore.statistics import Probability
from driftcore.trajectories import member_trajectories, trajectory
from driftcore.wind import LocalGridBootstrap, WindPath, WindPaths

if TYPE_CHECKING:
    from driftcore import coast, currents, hindcast, objects, report, tides, verification
    from driftcore.coast import LandCoast
    from driftcore.geographic import GeographicScenario
    from driftcore.geographic_configuration import GeographicConfiguration, read_configuration
    from driftcore.geographic_forecast import GeographicForecast
    from driftcore.grids import VectorGrid, read_vector_grid, read_wind_grid
    from driftcore.hand_over import HandOver
    from driftcore.objects import FloatingBody, Leeway
    from driftcore.rare import RareProbability, rare_probability
    from driftcore.releases import Release, Releases
    from driftcore.wind_fields import FieldBootstrap, GriddedWindRecord

__version__ = _core.VERSION

# The real sea, and what few need, is imported when it is used: a run of the paper's case waits for
# none of it.
_IMPORTED_WHEN_USED = {
    "FieldBootstrap": "wind_fields",
    "FloatingBody": "objects",
    "GeographicConfiguration": "geographic_configuration",
    "GeographicForecast": "geographic_forecast",
    "GeographicScenario": "geographic",
    "GriddedWindRecord": "wind_fields",
    "HandOver": "hand_over",
    "LandCoast": "coast",
    "Leeway": "objects",
    "RareProbability": "rare",
    "Release": "releases",
    "Releases": "releases",
    "VectorGrid": "grids",
    "rare_probability": "rare",
    "read_configuration": "geographic_configuration",
    "read_vector_grid": "grids",
    "read_wind_grid": "grids",
}


def __getattr__(name: str) -> Any:
    if name in ("coast", "currents", "hindcast", "objects", "report", "tides", "verification"):
        return import_module(f"driftcore.{name}")
    if name in _IMPORTED_WHEN_USED:
        return getattr(import_module(f"driftcore.{_IMPORTED_WHEN_USED[name]}"), name)
    raise AttributeError(f"module 'driftcore' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__


__all__ = [
    "AcademicSea",
    "Circle",
    "DriftCoreError",
    "DriftCoreWarning",
    "FieldBootstrap",
    "FloatingBody",
    "Forecast",
    "GeographicConfiguration",
    "GeographicForecast",
    "GeographicScenario",
    "GriddedWindRecord",
    "HandOver",
    "HarmonicSea",
    "LandCoast",
    "Leeway",
    "LocalGridBootstrap",
    "MapGrid",
    "MultifidelityProbability",
    "OutputError",
    "Polygons",
    "Probability",
    "RareProbability",
    "RecordError",
    "Release",
    "Releases",
    "RunConfiguration",
    "Scenario",
    "ScenarioError",
    "VectorGrid",
    "WindPath",
    "WindPaths",
    "WindRecord",
    "__version__",
    "coast",
    "currents",
    "forecast",
    "hindcast",
    "member_path",
    "member_trajectories",
    "multifidelity_probability",
    "objects",
    "open_forecast",
    "paper",
    "rare_probability",
    "read_configuration",
    "read_record",
    "read_vector_grid",
    "read_wind_grid",
    "record_paths",
    "report",
    "run",
    "tides",
    "trajectory",
    "verification",
]
