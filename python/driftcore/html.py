"""Small tables for notebooks: no colours of their own, so that light and dark pages suit."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from html import escape
from typing import TYPE_CHECKING

from driftcore.dataset import is_geographic
from driftcore.words import how, set_up

if TYPE_CHECKING:
    from driftcore.geographic import GeographicScenario
    from driftcore.results import Forecast
    from driftcore.scenario import Scenario

_SHOWN = 120


def table(title: str, rows: Iterable[tuple[str, object]]) -> str:
    """Write a table of two columns, everything escaped."""
    cells = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(_short(str(value)))}</td></tr>'
        for name, value in rows
    )
    return f"<table><caption>{escape(title)}</caption><tbody>{cells}</tbody></table>"


def _minute(instant: str) -> str:
    return instant[:16].replace("T", " ")


def _short(words: str) -> str:
    return words if len(words) <= _SHOWN else f"{words[: _SHOWN - 1]}…"


def forecast_table(forecast: Forecast) -> str:
    """Write what a forecast says."""
    return table("Drift forecast", _of_forecast(forecast))


def _of_forecast(forecast: Forecast) -> Iterator[tuple[str, object]]:
    attributes, unit = forecast.dataset.attrs, forecast.days_per_unit
    yield from ((name, text) for name, text in set_up(forecast) if name != "scaling")
    if is_geographic(forecast.dataset):
        yield "run", f"{attributes['days']:g} days from {_minute(attributes['start'])} UTC"
    else:
        yield "run", f"{attributes['duration'] * unit:.1f} days"
    members = ", ".join(f"{n:,} {name}" for name, n in forecast.counts.items() if n)
    yield "members", members.replace("_", " ")
    if forecast.followed:
        yield "strands", f"{forecast.stranding_probability()} (95 % interval)"
        early, middle, late = forecast.stranding_time_quantiles().values * unit
        if middle == middle:  # NaN where nothing strands
            yield "when", f"median {middle:.1f} days, 5 to 95 %: {early:.1f} to {late:.1f}"
        for target in forecast.dataset.get("target", ()):
            name = str(target.item())
            yield f"enters {name}", f"{forecast.entry_probability(name)}"
    yield from how(forecast)


def scenario_table(scenario: Scenario | GeographicScenario) -> str:
    """Write what a scenario sets up."""
    from driftcore.scenario import Scenario

    rows = _of_plane(scenario) if isinstance(scenario, Scenario) else _of_sea(scenario)
    return table("Scenario", rows)


def _of_plane(scenario: Scenario) -> Iterator[tuple[str, object]]:
    yield "name", scenario.name
    yield "run", f"{scenario.duration_days:.1f} days"
    yield "release", f"{scenario.position}, in units of the paper"
    yield "drag rate", f"{scenario.drag:g}"
    yield "tide", f"{scenario.tide_period_h:g} h, epsilon {scenario.epsilon:.4g}"
    yield "coast", "none" if scenario.coast is None else f"{scenario.coast.kind}, {scenario.side}"


def _of_sea(scenario: GeographicScenario) -> Iterator[tuple[str, object]]:
    about = scenario.describe()
    yield "name", scenario.name
    yield "run", f"{scenario.days:g} days from {_minute(about['start'])} UTC"
    yield "release", about["release"]
    # TOML, whose comments explain.
    lines = (line.split(" #")[0].strip() for line in about["drifter"].split("\n"))
    yield "object", ", ".join(filter(None, lines))
    for name in ("tides", "current", "coast"):
        yield name, about[name]
    tide = about["tide_period_h"]
    yield "epsilon", f"{scenario.epsilon:.2g}, a tide of {tide:.2f} h over the run"
