"""Forecasts of things adrift on the sea, weeks to months ahead, as probabilities.

Examples
--------
>>> import driftcore as dc
>>> scenario = dc.paper.scenario(epsilon=1 / 50)
>>> forecast = dc.forecast(scenario, members=200)
>>> print(forecast.stranding_probability())
"""

from driftcore import _core, coast, currents, objects, paper, tides
from driftcore.coast import LandCoast
from driftcore.errors import (
    DriftCoreError,
    DriftCoreWarning,
    OutputError,
    RecordError,
    ScenarioError,
)
from driftcore.forecast import (
    Forecast,
    forecast,
    member_path,
    member_trajectories,
    open_forecast,
    record_paths,
    run,
    trajectory,
)
from driftcore.geographic import GeographicScenario
from driftcore.geographic_configuration import GeographicConfiguration, read_configuration
from driftcore.geographic_forecast import GeographicForecast
from driftcore.grids import VectorGrid, read_vector_grid, read_wind_grid
from driftcore.maps import MapGrid
from driftcore.objects import FloatingBody, Leeway
from driftcore.record import WindRecord, read_record
from driftcore.releases import Release, Releases
from driftcore.scenario import Circle, Polygons, RunConfiguration, Scenario
from driftcore.sea import AcademicSea, HarmonicSea
from driftcore.statistics import Probability
from driftcore.wind import LocalGridBootstrap, WindPath, WindPaths
from driftcore.wind_fields import FieldBootstrap, GriddedWindRecord

__version__ = _core.VERSION

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
    "HarmonicSea",
    "LandCoast",
    "Leeway",
    "LocalGridBootstrap",
    "MapGrid",
    "OutputError",
    "Polygons",
    "Probability",
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
    "member_path",
    "member_trajectories",
    "objects",
    "open_forecast",
    "paper",
    "read_configuration",
    "read_record",
    "read_vector_grid",
    "read_wind_grid",
    "record_paths",
    "run",
    "tides",
    "trajectory",
]
