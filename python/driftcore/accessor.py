"""A forecast's dataset that knows what it is: ``dataset.driftcore``.

Registered with xarray when driftcore makes or opens the first dataset, so that ``import driftcore``
does not wait for xarray. Of a file that xarray opened itself: ``import driftcore.accessor`` first.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import xarray as xr

from driftcore.errors import ScenarioError
from driftcore.results import Forecast, forecast_of

__all__ = ["ForecastAccessor"]


@xr.register_dataset_accessor("driftcore")  # type: ignore[no-untyped-call]
class ForecastAccessor:
    """What `Forecast` or `GeographicForecast` says of a dataset, and its figures.

    Examples
    --------
    >>> import driftcore.accessor, xarray
    >>> dataset = xarray.open_dataset("out.nc")
    >>> dataset.driftcore.stranding_probability()
    >>> dataset.driftcore.plot.arrival_curve()
    """

    def __init__(self, dataset: xr.Dataset) -> None:
        self._dataset = dataset

    @cached_property
    def forecast(self) -> Forecast:
        """The forecast that the dataset is.

        Raises
        ------
        ScenarioError
            It is none.
        """
        if "status" not in self._dataset or "stranding_time" not in self._dataset:
            raise ScenarioError(
                "dataset: it holds no status and stranding_time; accepted is a driftcore forecast"
            )
        return forecast_of(self._dataset)

    @property
    def plot(self) -> Figures:
        """Figures: the functions of `driftcore.plot_map` or `driftcore.plot`, of this dataset."""
        return Figures(self.forecast)

    def __getattr__(self, name: str) -> Any:
        # xarray and notebooks ask for much that begins so.
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.forecast, name)

    def __dir__(self) -> list[str]:
        return ["forecast", "plot", *(n for n in dir(self.forecast) if not n.startswith("_"))]

    def _repr_html_(self) -> str:
        return self.forecast._repr_html_()


class Figures:
    """Figures of one forecast, each a function of what else it is told."""

    def __init__(self, forecast: Forecast) -> None:
        self._forecast = forecast

    @cached_property
    def _module(self) -> Any:
        from driftcore import plot, plot_map
        from driftcore.dataset import is_geographic

        return plot_map if is_geographic(self._forecast.dataset) else plot

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name.startswith("_") or name not in self._module.__all__:
            raise AttributeError(f"no figure {name!r}; there are {', '.join(dir(self))}")
        return partial(getattr(self._module, name), self._forecast.dataset)

    def __dir__(self) -> list[str]:
        # What is drawn of other things than a forecast.
        others = {"convergence", "likelihood", "plane", "save_member", "set_up", "time_series"}
        others |= {"velocity_series", "wind_law"}
        return [name for name in self._module.__all__ if name not in others]
