"""Forecasts of things adrift on the sea, weeks to months ahead, as probabilities.

Examples
--------
>>> import driftcore as dc
>>> scenario = dc.paper.scenario(epsilon=1 / 50)
>>> forecast = dc.forecast(scenario, members=200)
>>> print(forecast.stranding_probability())
"""

from driftcore import _core, paper
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
from driftcore.maps import MapGrid
from driftcore.record import WindRecord, read_record
from driftcore.scenario import Circle, Polygons, RunConfiguration, Scenario
from driftcore.sea import AcademicSea, HarmonicSea
from driftcore.statistics import Probability
from driftcore.wind import LocalGridBootstrap, WindPath, WindPaths

__version__ = _core.VERSION

__all__ = [
    "AcademicSea",
    "Circle",
    "DriftCoreError",
    "DriftCoreWarning",
    "Forecast",
    "HarmonicSea",
    "LocalGridBootstrap",
    "MapGrid",
    "OutputError",
    "Polygons",
    "Probability",
    "RecordError",
    "RunConfiguration",
    "Scenario",
    "ScenarioError",
    "WindPath",
    "WindPaths",
    "WindRecord",
    "__version__",
    "forecast",
    "member_path",
    "member_trajectories",
    "open_forecast",
    "paper",
    "read_record",
    "record_paths",
    "run",
    "trajectory",
]
