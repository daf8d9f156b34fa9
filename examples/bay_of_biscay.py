"""A container and a person lost in the Bay of Biscay on 1 July: where, when and how surely ashore.

The coast is Natural Earth's, the wind is resampled from a record at Belle-Île, uniform in space.
The tide is a documented idealisation (M2, S2, N2), and there is no residual current: an example of
the method, not a forecast to act on.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from pathlib import Path

import numpy as np

import driftcore as dc
from driftcore import plot_map

DATA = Path(__file__).parents[2] / "shared/data"
WIND = DATA / "wind/wind_resourcecode_belleile_6h_1994_1999.csv"
FINE_COAST = DATA / "coast/natural_earth_10m_biscay_land.geojson"

RELEASE = dc.Release.point(-4.1, 47.2, "2026-07-01T06:00", radius_m=1000)
DAYS = 60
MAP_DAYS = (10, 20, 40)
DRIFTERS = {
    "container": dc.FloatingBody(response_time_h=6.0, wind_factor=0.03),
    "person in water": dc.objects.leeway("PIW-1"),
}
# West, east, south, north [degrees]: near the borders of departments and provinces; the first one
# that holds a place counts.
STRETCHES = {
    "Finistère": (-5.3, -3.53, 47.6, 48.8),
    "Loire-Atlantique": (-2.65, -1.5, 47.03, 47.45),
    "Morbihan": (-3.53, -2.3, 47.2, 47.9),
    "Vendée": (-2.5, -1.0, 46.3, 47.03),
    "Charente-Maritime": (-1.8, -0.7, 45.58, 46.3),
    "Gironde, Landes": (-1.7, -0.4, 43.53, 45.58),
    "Basque coast": (-3.16, -1.4, 43.1, 43.53),
    "Cantabria, Asturias": (-7.05, -3.16, 43.1, 43.8),
}


def wind() -> dc.LocalGridBootstrap:
    """Give the wind of Belle-Île in July and August, or say that it is absent."""
    if WIND.exists():
        label = "Belle-Île 1994-1999, July and August, resampled"
        return dc.LocalGridBootstrap.fit(dc.read_record(WIND, months=(7, 8), label=label))
    print(f"the wind record {WIND} is absent: a synthetic climate takes its place")
    return dc.paper.default_wind()


def land() -> dc.LandCoast:
    """Give the coast around the bay, as fine as there is."""
    if FINE_COAST.exists():
        coast = dc.LandCoast.from_file(FINE_COAST)
    else:
        print(f"the fine coast {FINE_COAST} is absent: the one in the package takes its place")
        coast = dc.LandCoast.default()
    return coast.with_stretches(STRETCHES)


def report(name: str, forecast: dc.GeographicForecast, coast: dc.LandCoast) -> None:
    """Print the probability of each stretch of coast, and where the thing is while it floats."""
    print(f"\n{name}: {dict(forecast.counts)}")
    print(
        f"{'stretch of coast':<20}{'probability':>12}{'95 % interval':>18}{'days, 5/50/95 %':>18}"
    )
    table = forecast.stranding_by_stretch(coast)
    for stretch in table["stretch"].values:
        row = table.sel(stretch=stretch)
        days = row["time_quantile"].values
        when = "-" if np.isnan(days).any() else "/".join(f"{d:.0f}" for d in days)
        interval = f"[{float(row['low']):.4f}, {float(row['high']):.4f}]"
        print(f"{stretch:<20}{float(row['probability']):>12.4f}{interval:>18}{when:>18}")
    total = forecast.stranding_probability()
    when = "/".join(f"{d:.0f}" for d in forecast.stranding_time_quantiles().values)
    interval = f"[{total.low:.4f}, {total.high:.4f}]"
    print(f"{'anywhere':<20}{total.estimate:>12.4f}{interval:>18}{when:>18}")
    for day, here in zip(MAP_DAYS, forecast.dataset["presence"], strict=True):
        best = here.argmax(...)
        place = here.isel(best)
        print(
            f"day {day}: {float(here.sum()):.3f} afloat on the map, most probably in the cell at "
            f"{float(place['map_longitude']):.2f}, {float(place['map_latitude']):.2f} "
            f"({float(place):.4f})"
        )


def draw(name: str, forecast: dc.GeographicForecast, coast: dc.LandCoast, folder: Path) -> None:
    """Write the figures of one thing."""
    divided = coast.cut(-7.9, -0.5, 43.1, 49.5).divide(length_km=25)
    drawn = {
        **{f"presence_{d}": plot_map.presence_map(forecast, d, coast) for d in MAP_DAYS},
        "coast": plot_map.stranding_coast(forecast, divided),
        "stretches": plot_map.stranding_bars(forecast, coast),
        "paths": plot_map.spaghetti(forecast, coast),
    }
    for kind, artists in drawn.items():
        artists[0].figure.savefig(folder / f"{name.replace(' ', '_')}_{kind}.png", dpi=150)


def main() -> None:
    """Forecast both, print, and write files and figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("bay-of-biscay"))
    parser.add_argument("--members", type=int, default=10_000)
    options = parser.parse_args()
    folder = options.output
    folder.mkdir(parents=True, exist_ok=True)

    coast, climate = land(), wind()
    curves = None
    for name, drifter in DRIFTERS.items():
        scenario = dc.GeographicScenario(
            release=RELEASE,
            days=DAYS,
            drifter=drifter,
            tides=dc.tides.biscay(),
            coast=coast,
            name=name,
        )
        maps = dc.MapGrid(
            x=np.linspace(-8.0, -0.8, 73), y=np.linspace(43.2, 49.4, 63), times=MAP_DAYS
        )
        began = time.perf_counter()
        forecast = dc.forecast(scenario, climate, members=options.members, maps=maps)
        seconds = time.perf_counter() - began
        # In bytes on macOS, in kilobytes elsewhere.
        unit = 1e6 if sys.platform == "darwin" else 1e3
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
        report(name, forecast, coast)
        print(f"{options.members} members in {seconds:.1f} s, peak memory so far {peak:.0f} MB")
        forecast.to_netcdf(folder / f"{name.replace(' ', '_')}.nc", overwrite=True)
        draw(name, forecast, coast, folder)
        curves = plot_map.arrival_curve(forecast, curves, label=name)[0].axes
    curves.figure.savefig(folder / "arrival.png", dpi=150)


if __name__ == "__main__":
    main()
