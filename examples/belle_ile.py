"""The paper's case under a real wind, resampled and as it was.

Forecasts with 1,000 resampled winds, then follows the same body under every window of the record
itself: if the resampling is fair, both give the same probability within their sampling error.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import driftcore as dc
from driftcore import plot

HERE = Path(__file__).parent


def yearly_error(forecast: dc.Forecast, record: dc.WindRecord) -> float:
    """Give the standard error of the windows' probability: one summer is one observation."""
    status = forecast.dataset["status"].values
    summers = np.array_split(status, len(np.unique(record.segment)))
    shares = [np.mean(summer == 1) for summer in summers]
    return float(np.std(shares, ddof=1) / np.sqrt(len(shares)))


def main() -> None:
    """Run both and print them side by side."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("belle-ile"))
    folder = parser.parse_args().output

    configuration = dc.RunConfiguration.from_toml(HERE / "belle_ile.toml")
    path = HERE / configuration.wind.record
    if not path.exists():
        print(f"skipped: the wind record {path} is absent")
        return
    scenario = configuration.scenario
    resampled = dc.run(configuration, folder=HERE)
    folder.mkdir(parents=True, exist_ok=True)
    resampled.to_netcdf(folder / "belle_ile.nc", overwrite=True)
    plot.save_all(resampled.dataset, folder, overwrite=True)

    record = dc.read_record(path, months=configuration.wind.months)
    windows = dc.forecast(scenario, dc.record_paths(scenario, record), keep=0)

    print(f"resampled winds    {resampled.stranding_probability()}")
    estimate = windows.stranding_probability().estimate
    print(f"record's windows   {estimate:.3f}, standard error {yearly_error(windows, record):.3f}")
    print("by sector          " + "  ".join(("N", "NE", "E", "SE", "S", "SW", "W", "NW")))
    for name, forecast in (("resampled", resampled), ("windows", windows)):
        shares = forecast.stranding_by_sector(8)["probability"].values
        print(f"  {name:<16} " + "  ".join(f"{share:.2f}" for share in shares))


if __name__ == "__main__":
    main()
