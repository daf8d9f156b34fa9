"""Forecasts as results: probabilities and times, read from a CF dataset or its file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from driftcore.dataset import (
    STATUSES,
    followed_of,
    is_geographic,
    read_netcdf,
    write_netcdf,
)
from driftcore.errors import ScenarioError
from driftcore.members import checked_count
from driftcore.statistics import Probability, probability, quantile_interval, wilson

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Forecast:
    """An ensemble forecast: probabilities read from a CF dataset.

    Attributes
    ----------
    dataset : xarray.Dataset
        `status(member)`, `stranding_time(member)`, `stranding_position(member, component)`,
        `position(member, time, component)` and `wind_velocity(member, wind_time, component)` of
        the kept members (dimension `kept_member` where not all are kept). Its attributes hold the
        configuration, version and seed, enough to run it again. With maps: `presence`, `arrival`
        (map_time, y, x), `visit(y, x)`, `outside` and `ashore(map_time)`, each with its
        `..._standard_error`; with targets: `entry_time(member, target)`.
    """

    dataset: xr.Dataset

    @cached_property
    def counts(self) -> dict[str, int]:
        """Number of members by status."""
        status = self.dataset["status"].values
        return {name: int((status == flag).sum()) for flag, name in enumerate(STATUSES)}

    @property
    def followed(self) -> int:
        """Members that could be followed: all but the failed ones."""
        return followed_of(self.dataset)

    @property
    def days_per_unit(self) -> float:
        """Days in the unit of its stranding times."""
        attributes = self.dataset.attrs
        return float(attributes["tide_period_h"] / attributes["epsilon"] / 24)

    def stranding_probability(self, by: float | None = None) -> Probability:
        """Probability of having stranded by a time (default: the end of the run).

        Parameters
        ----------
        by : float, optional
            Scenario time.

        Returns
        -------
        Probability
            Estimate and 95 % Wilson interval; members that left the domain count as not stranded,
            failed members do not count.
        """
        times = self.dataset["stranding_time"].values
        limit = np.inf if by is None else by
        return probability(int((times <= limit).sum()), self.followed)

    def entry_probability(self, target: str, by: float | None = None) -> Probability:
        """Probability of having entered a target by a time (default: the end of the run).

        Parameters
        ----------
        target : str
            Its name.
        by : float, optional
            Scenario time.

        Returns
        -------
        Probability
            As `stranding_probability`.

        Raises
        ------
        ScenarioError
            The forecast has no such target.
        """
        self._require_target(target)
        times = self.dataset["entry_time"].sel(target=target).values
        limit = np.inf if by is None else by
        return probability(int((times <= limit).sum()), self.followed)

    def _require_target(self, target: str) -> None:
        names = self.dataset["target"].values.tolist() if "target" in self.dataset else []
        if target not in names:
            known = f"one of {', '.join(names)}" if names else "the forecast was run without any"
            raise ScenarioError(f"target: {target!r} is not accepted; {known}")

    def stranding_by_sector(self, sectors: int = 16) -> xr.Dataset:
        """Probability of stranding in each direction from the circle's centre, or the release.

        Parameters
        ----------
        sectors : int
            Number of equal sectors; the first is centred on north (+y), then clockwise.

        Returns
        -------
        xarray.Dataset
            `probability`, `low`, `high` of shape (direction,), `direction` in degrees.
        """
        import xarray as xr

        sectors = checked_count("sectors", sectors)
        self.stranding_probability()  # refuses where no member could be followed
        places = self._places()
        bearing = np.degrees(np.arctan2(places[:, 0], places[:, 1]))
        sector = np.round(bearing / (360 / sectors)).astype(int) % sectors
        count = np.bincount(sector, minlength=sectors)
        low, high = wilson(count, self.followed)
        direction = np.arange(sectors) * 360 / sectors
        return xr.Dataset(
            {
                "probability": ("direction", count / self.followed),
                "low": ("direction", low),
                "high": ("direction", high),
            },
            {"direction": ("direction", direction, {"units": "degree", "long_name": "toward"})},
        )

    def stranding_time_quantiles(self, levels: Sequence[float] = (0.05, 0.5, 0.95)) -> xr.DataArray:
        """Quantiles of the stranding time among the stranded members [scenario time].

        Parameters
        ----------
        levels : sequence of float
            Of the quantiles.

        Returns
        -------
        xarray.DataArray
            By `quantile`, NaN where none stranded; its coordinates `low` and `high` are the 95 %
            interval of each, NaN where too few stranded to tell.
        """
        times = self.dataset["stranding_time"].values
        return time_quantiles(times[np.isfinite(times)], levels)

    def _places(self) -> Floats:
        """Places of stranding relative to the circle's centre, or the release."""
        import json

        places = self.dataset["stranding_position"].values
        coast = json.loads(self.dataset.attrs.get("coast", "{}"))
        center = coast.get("center") or json.loads(self.dataset.attrs["release"])
        return np.asarray(places[np.isfinite(places[:, 0])] - np.array(center))

    def configuration(self) -> str:
        """TOML text of the run; `driftcore run` reads it."""
        return str(self.dataset.attrs["configuration"])

    def to_dataframe(self) -> pd.DataFrame:
        """Give a row for each member: see `driftcore.export.members_table`."""
        from driftcore.export import members_table

        return members_table(self)

    def _repr_html_(self) -> str:
        from driftcore.html import forecast_table

        return forecast_table(self)

    def to_netcdf(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the dataset as NetCDF-4: to a temporary name first, then renamed.

        Raises
        ------
        OutputError
            The file exists and `overwrite` is not set, or it cannot be written.
        """
        write_netcdf(self.dataset, Path(path), overwrite)

    def __repr__(self) -> str:
        strands = self.stranding_probability() if self.followed else "unknown"
        members = self.dataset.sizes["member"]
        return f"Forecast({members} members, probability of stranding {strands})"


def time_quantiles(times: Floats, levels: Sequence[float], units: str = "1") -> xr.DataArray:
    """Quantiles of times by `quantile`, with their 95 % intervals `low` and `high`."""
    import xarray as xr

    low, high = quantile_interval(times, levels)
    coordinates = {"quantile": list(levels), "low": ("quantile", low), "high": ("quantile", high)}
    values = np.quantile(times, levels) if len(times) else np.full(len(levels), np.nan)
    return xr.DataArray(
        values, coordinates, "quantile", name="stranding_time", attrs={"units": units}
    )


def open_forecast(path: str | os.PathLike[str]) -> Forecast:
    """Read a forecast written by `Forecast.to_netcdf`, or open a store lazily: a folder, .zarr.

    Returns
    -------
    Forecast
        A `GeographicForecast` where it is one.

    Raises
    ------
    OutputError
        The file is missing or is not a driftcore forecast, or the store is unfinished.
    """
    if Path(path).suffix == ".zarr":
        from driftcore.store import open_store

        return forecast_of(open_store(Path(path)))
    return forecast_of(read_netcdf(Path(path)))


def forecast_of(dataset: xr.Dataset) -> Forecast:
    """Give the forecast that a dataset is, a `GeographicForecast` where it is one."""
    if is_geographic(dataset):
        from driftcore.geographic_forecast import GeographicForecast

        return GeographicForecast(dataset)
    return Forecast(dataset)
