"""Every picture of docs/guide/pictures.md, from what comes with the package alone.

A container lost in the Bay of Biscay under a synthetic wind and an idealised tide, and the paper's
case: pictures of the method, not of a real forecast. `python examples/pictures.py --output
docs/figures/pictures` draws them anew.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import driftcore as dc
from driftcore import plot, plot_map

DPI = 100
MEMBERS = 2000
STRETCHES = {
    "Brittany": (-5.3, -2.3, 47.2, 48.8),
    "Loire-Atlantique, Vendée": (-2.65, -1.0, 46.3, 47.45),
    "Charente-Maritime": (-1.8, -0.7, 45.58, 46.3),
    "Gironde, Landes": (-1.7, -0.4, 43.53, 45.58),
    "Spain": (-9.5, -1.4, 43.0, 43.53),
}
MOUTH = {"Gironde": [[-1.6, 45.3], [-1.0, 45.3], [-1.0, 45.8], [-1.6, 45.8]]}


def pictures() -> dict[str, list[Any]]:
    """Draw them; by name, what was drawn."""
    coast, wind = dc.LandCoast.default(), dc.paper.default_wind()
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-4.1, 47.2, "2026-07-01T06:00", radius_m=10_000),
        days=60,
        drifter=dc.FloatingBody(response_time_h=6.0, wind_factor=0.03),
        tides=dc.tides.biscay(),
        coast=coast,
        name="container",
    )
    maps = dc.MapGrid(x=np.linspace(-8, -0.8, 73), y=np.linspace(43.2, 49.4, 63), times=(10, 20))
    sea = dc.forecast(scenario, wind, members=MEMBERS, keep=200, maps=maps, targets=MOUTH)
    grid = tuple(np.linspace(0.65, 1.35, 36))
    plane = dc.forecast(
        dc.paper.scenario(), wind, keep=100, maps=dc.MapGrid(x=grid, y=grid, times=(0.5, 1.0))
    )
    divided = coast.cut(-7.9, -0.5, 43.1, 49.5).divide(length_km=25)
    return {
        "set_up": plot_map.set_up(scenario, wind, maps, MOUTH),
        "presence": plot_map.presence_map(sea, 20, coast),
        "paths": plot_map.spaghetti(sea, coast, members=40),
        "coast": plot_map.stranding_coast(sea, divided),
        "stretches": plot_map.stranding_bars(sea, coast.with_stretches(STRETCHES)),
        "arrival": plot_map.arrival_curve(sea),
        "estimate": plot_map.running_estimate(sea),
        "stranding_rose": plot_map.stranding_rose(sea),
        "wind_rose": plot.wind_rose(wind.record),
        "wind_law": plot.wind_law(wind),
        "presence_plane": plot.presence_map(plane, 0.5),
    }


def main() -> None:
    """Write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("pictures"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    for name, drawn in pictures().items():
        drawn[0].figure.savefig(folder / f"{name}.png", dpi=DPI)
        print(folder / f"{name}.png")


if __name__ == "__main__":
    main()
