"""Winds of an ensemble in the plane: drawn by a fitted bootstrap, or given as paths."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from driftcore import _core
from driftcore.errors import RecordError, ScenarioError, warn
from driftcore.members import checked_count
from driftcore.memory import require_room
from driftcore.record import WindRecord
from driftcore.scenario import Scenario, WindConfiguration
from driftcore.wind import LocalGridBootstrap, WindPath, WindPaths

if TYPE_CHECKING:
    from driftcore.geographic import GeographicScenario

Floats = NDArray[np.float64]

# Tides of wind drawn before the release, the same for every model so that a member has one wind:
# the paper model with a window of 4 tides reaches back 3.
_LEAD_IN_TIDES = 3
# Small-scale steps in a tide, paper section 4.1.
_FINE_STEPS = 100
# Steps of the record that a tide may last, from and to: small-scale steps are worked out beforehand
# for one step, and winds are drawn some tides before the release.
_SHORTEST_TIDE, _LONGEST_TIDE = 1 / 40, 1e4


def fitted_wind(wind: WindConfiguration, folder: Path | None = None) -> LocalGridBootstrap:
    """Fit the wind that a configuration names; relative paths start at `folder`."""
    from driftcore.climate import synthetic_record

    record: Any = synthetic_record() if wind.record == "embedded" else Path(wind.record)
    if isinstance(record, Path) and folder is not None:
        record = folder / record
    return LocalGridBootstrap.fit(
        record,
        months=wind.months,
        mode=wind.mode,
        h=wind.h,
        b=wind.b,
        order=wind.order,
        gaps=wind.gaps,
        share=wind.share,
        memory_h=wind.memory_h,
    )


class Resampled:
    """Winds drawn by a fitted bootstrap, named by (seed, member)."""

    def __init__(
        self,
        scenario: Scenario | GeographicScenario,
        wind: LocalGridBootstrap,
        solver: _core.Solver,
        seed: int,
        phase: int | None = None,
        hand_over: Callable[[int], _core.HandOver] | None = None,
    ) -> None:
        """`hand_over` gives what the members begin with, so many steps before time 0."""
        self.scenario, self.wind, self.seed = scenario, wind, seed
        step = wind.record.step_h / scenario.hours_per_unit
        tide_h = scenario.period * scenario.hours_per_unit
        shortest, longest = (wind.record.step_h * k for k in (_SHORTEST_TIDE, _LONGEST_TIDE))
        if not (step > 0 and shortest <= tide_h <= longest):
            raise ScenarioError(
                f"tide_period_h: {tide_h:g} is not accepted; with a wind every "
                f"{wind.record.step_h:g} h it should be from {shortest:g} to {longest:g}"
            )
        substeps = substeps_of(step, scenario.period)
        lead_in = math.ceil(_LEAD_IN_TIDES * scenario.period / step - 1e-9)
        start, self.end = solver.wind_needed(scenario.duration, scenario.period)
        if start < -_LEAD_IN_TIDES * scenario.period * (1 + 1e-9):
            raise ScenarioError(
                f"window: the simulated wind starts {_LEAD_IN_TIDES} tides before the release, but "
                f"this window needs it {-start / scenario.period:.3g} tides before; "
                f"windows up to {4 * scenario.period:g} (4 tides) are accepted"
            )
        handed = None if hand_over is None else hand_over(lead_in)
        try:
            self.generator = _core.WindGenerator(
                wind.core,
                step,
                scenario.wind_unit,
                wind.small_scale_sd / scenario.wind_unit,
                wind.memory_h / scenario.hours_per_unit,
                substeps,
                lead_in,
                None if phase is None else wind.phase_before(phase, lead_in),
                handed,
            )
        except ValueError as error:
            raise ScenarioError(str(error)) from None
        self.lead_in = lead_in
        self.times = np.arange(math.ceil(self.end / step - 1e-9) + 1) * np.float64(step)

    @property
    def core(self) -> tuple[_core.WindGenerator, int]:
        """What the compiled core draws from."""
        return self.generator, self.seed

    def kept(self, first: int, count: int, instants: Floats) -> tuple[Floats, Floats]:
        """Give the synoptic wind [m/s] of `count` members from the release on."""
        del instants
        steps = self.lead_in + len(self.times)
        require_room("keep", count * float(steps), 3 * 24, "winds kept")
        wind, _ = self.wind.core.sample(count, steps, self.seed, first)
        return self.times, wind[:, self.lead_in :]

    def configuration(self) -> WindConfiguration:
        """Give what names the wind in a stored run."""
        known = self.wind.config()
        if self.wind.record.synthetic:
            known["record"] = "embedded"
        else:
            known["record"] = known.get("source", f"{self.wind.record.label} (given in Python)")
        fields = WindConfiguration.model_fields
        return WindConfiguration(**{name: known[name] for name in fields if name in known})

    def attributes(self) -> dict[str, Any]:
        """Give what tells a reader the record."""
        record = self.wind.record
        return {
            "wind_label": record.label,
            "wind_synthetic": int(record.synthetic),
            "wind_sha256": record.sha256,
        }

    def warn(self) -> None:
        """Warn where the run is longer than the season."""
        if self.scenario.duration_days > self.wind.span_days:
            warn(
                f"the run lasts {self.scenario.duration_days:.0f} days, the months chosen "
                f"{self.wind.span_days:.0f}: the simulated season goes on beyond its end"
            )


class Given:
    """Winds given as paths, one for each member: a list of them, or all on common knots."""

    def __init__(
        self, scenario: Scenario, paths: Sequence[WindPath] | WindPaths, solver: _core.Solver
    ) -> None:
        together = isinstance(paths, WindPaths)
        if not together and not (
            isinstance(paths, Sequence) and all(isinstance(p, WindPath) for p in paths)
        ):
            raise ScenarioError(
                f"wind: {type(paths).__name__} is not accepted; a fitted LocalGridBootstrap, a "
                "list of WindPath, or WindPaths"
            )
        if not len(paths):
            raise ScenarioError("wind: the list of paths is empty")
        start, end = solver.wind_needed(scenario.duration, scenario.period)
        slack = 1e-9 * (end - start)
        spans = [paths.times] if isinstance(paths, WindPaths) else [path.times for path in paths]
        for k, times in enumerate(spans):
            if times[0] > start + slack or times[-1] < end - slack:
                which = "they cover" if together else f"path {k} covers"
                raise ScenarioError(
                    f"wind: {which} [{times[0]:g}, {times[-1]:g}]; "
                    f"the run needs [{start:g}, {end:g}]"
                )
        self.scenario, self.paths = scenario, paths

    @property
    def core(self) -> list[_core.WindPath] | _core.WindPaths:
        """The compiled paths."""
        if isinstance(self.paths, WindPaths):
            return self.paths.core
        return [path.core for path in self.paths]

    def kept(self, first: int, count: int, instants: Floats) -> tuple[Floats, Floats]:
        """Give the wind [m/s] of `count` members at the output times."""
        if isinstance(self.paths, WindPaths):
            wind = self.paths.core.velocity(first + count if count else 0, instants)[first:]
        else:
            chosen = self.paths[first : first + count]
            wind = np.array([path.core.velocity(instants) for path in chosen])
        return instants, wind.reshape(count, len(instants), 2) * self.scenario.wind_unit

    def configuration(self) -> WindConfiguration:
        """Give what names the wind in a stored run."""
        return WindConfiguration(record=self.attributes()["wind_label"])

    def attributes(self) -> dict[str, Any]:
        """Give what tells a reader where the wind is from."""
        return {"wind_label": f"{len(self.paths)} wind paths given in Python", "wind_synthetic": 0}

    def warn(self) -> None:
        """Nothing: no season is simulated."""


def substeps_of(step: float, period: float) -> int:
    """Give the number of small-scale steps in a synoptic one, both times in one unit."""
    return max(1, math.ceil(step / (period / _FINE_STEPS) - 1e-9))


def member_path(
    scenario: Scenario, wind: LocalGridBootstrap, member: int, seed: int = 1
) -> WindPath:
    """Wind of one member of a forecast, in scenario units, on its fine knots.

    It covers the run and what any averaging window up to four tides wide needs around it.
    """
    solver = _core.Solver.paper(1, 4 * scenario.period, True, 1e-8, 1e-8, None)
    winds = Resampled(scenario, wind, solver, seed)
    member, seed = checked_count("member", member, least=0), checked_count("seed", seed, least=0)
    return WindPath(*winds.generator.path(seed, member, winds.end))


def record_paths(scenario: Scenario, record: WindRecord) -> list[WindPath]:
    """Every window of a record that is as long as a run, as wind paths in scenario units.

    What a forecast resamples from, without resampling: the windows overlap, so that they are far
    from independent.

    Parameters
    ----------
    scenario : Scenario
        Its units and the length of its run.
    record : WindRecord
        As `read_record` gives it; no window spans two of its segments.

    Raises
    ------
    RecordError
        No segment is as long as the run.
    """
    step = record.step_h / scenario.hours_per_unit
    length = math.ceil(scenario.duration / step - 1e-9) + 1
    times = np.arange(length) * step
    segment = record.segment
    first = np.arange(max(0, len(record) - length + 1))
    first = first[segment[first] == segment[first + length - 1]]
    if not len(first):
        raise RecordError(
            f"record: no segment lasts the {scenario.duration_days:.1f} days of the run"
        )
    velocity = record.velocity / scenario.wind_unit
    return [WindPath(times, velocity[k : k + length]) for k in first]
