"""A forecast in words, for the terminal and for a report."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING

from driftcore.configuration import read_toml
from driftcore.geographic import Scaling

if TYPE_CHECKING:
    from driftcore.results import Forecast


def set_up(forecast: Forecast) -> Iterator[tuple[str, str]]:
    """Tell what a forecast is of, from its attributes."""
    about = forecast.dataset.attrs
    yield "scenario", str(about["scenario"])
    if "days" not in about:
        yield "release", f"{about['release']}, in units of the paper"
        drag = about["drag"] / forecast.days_per_unit
        yield "object", f"floating body, drag rate {about['drag']:g} ({drag:.2g} per day)"
        yield "tide", f"{about['tide_period_h']:g} h, epsilon {about['epsilon']:.4g}"
        yield "coast", str(about.get("coast", "none"))
        return
    yield "release", str(about["release"])
    drifter = read_toml(about["drifter"])
    if "category" in drifter:
        known = f"leeway of {drifter['category']}"
    else:
        response, factor = (
            value["kind"] if isinstance(value, dict) else f"{value:g}"
            for value in (drifter["response_time_h"], drifter["wind_factor"])
        )
        known = f"floating body, response time {response} h, wind factor {factor}"
    yield "object", known
    for name in ("tides", "current", "coast"):
        yield name, re.sub(r"^<?[A-Z]\w+[ (](.*)[>)]$", r"\1", str(about[name]))
    scale = {key: about[f"scaling_{key}"] for key in Scaling._fields}
    yield (
        "scaling",
        f"epsilon {scale['epsilon']:.2g} (a tide of {about['tide_period_h']:.2f} h over "
        f"{about['days']:g} days); tide up to {scale['tide']:.2g} m/s, residual "
        f"{scale['residual']:.2g} m/s; tidal excursion {scale['excursion_km']:.1f} km, over which "
        f"the tide changes by {scale['steepness']:.0%}",
    )


def how(forecast: Forecast) -> Iterator[tuple[str, str]]:
    """Tell by which wind and model."""
    about = forecast.dataset.attrs
    order = f", order {about['order']}" if "order" in about else ""
    yield "wind", about["wind_label"]
    yield "model", f"{about['model']}{order}, seed {about['seed']}"
