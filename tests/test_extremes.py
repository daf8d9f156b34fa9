"""Extreme but legal: stiff bodies, few and many tides, storms, long coasts, tangents, no wind."""

import math
import time
import warnings
from typing import Any

import numpy as np
import pytest

import driftcore as dc
from driftcore import _core
from driftcore.scenario import Circle, Polygons
from driftcore.sea import AcademicSea, SeparableCurrent


def winds(scenario: dc.Scenario, velocity: Any) -> dc.WindPaths:
    """Winds of four members on forty knots, beyond the run on both sides."""
    margin = 4 * scenario.epsilon
    times = np.linspace(-margin, scenario.duration + margin, 40)
    return dc.WindPaths(times, np.broadcast_to(velocity, (4, 40, 2)))


def still(**changes: Any) -> dc.Scenario:
    """The paper's case in a sea that does not move."""
    none = SeparableCurrent(mean=0.0, modulation=0.0)
    sea = AcademicSea(tide=none, residual=none)
    return dc.paper.scenario().replace(**{"sea": sea, **changes})


@pytest.mark.parametrize("drag", [1e-6, 1e3, 1e5])
@pytest.mark.parametrize("model", ["full", "mean-flow"])
def test_a_stiff_body_follows_the_wind(drag: float, model: Any) -> None:
    """In a still sea X'' = Λ(W − X'): X = Wt − W(1 − e^{−Λt})/Λ under a steady wind."""
    scenario = still(drag=drag, coast=None)
    forecast = dc.forecast(scenario, winds(scenario, [1.0, -0.5]), model=model, times=[0.5, 1.0])
    assert forecast.counts["afloat"] == 4
    t = np.array([0.5, 1.0])
    way = t + np.expm1(-drag * t) / drag
    expected = np.array(scenario.position) + way[:, None] * [1.0, -0.5]
    assert forecast.dataset["position"].values == pytest.approx(
        np.broadcast_to(expected, (4, 2, 2)), abs=1e-5
    )


def test_a_body_too_stiff_to_step_is_refused_at_once() -> None:
    for drag, duration in ((1e6, 1.0), (1.0, 1e4)):
        still(drag=drag, duration=duration, epsilon=0.5)
    with pytest.raises(dc.ScenarioError, match=r"drag: 1000000\.0 is not accepted; with duration"):
        still(drag=1e6, duration=2.0)


@pytest.mark.parametrize("epsilon", [0.5, 1 / 5000])
def test_few_tides_and_many(epsilon: float) -> None:
    """Where averaging holds, both models end together; where it does not, both still end."""
    scenario = dc.paper.scenario(epsilon=epsilon, coast=None)
    rng = np.random.default_rng(1)
    wind = winds(scenario, rng.normal(0, 0.5, (4, 40, 2)))
    ends = []
    for model in ("full", "mean-flow"):
        forecast = dc.forecast(scenario, wind, model=model, times=[1.0])
        assert forecast.counts["afloat"] == 4
        ends.append(forecast.dataset["position"].values)
    # Of order ε²; ten of it for the constants of this sea.
    assert np.abs(ends[0] - ends[1]).max() < max(10 * epsilon**2, 1e-5)


def test_storms_of_100_metres_a_second() -> None:
    """Who is blown at 33 units of velocity crosses a coast 0.3 away at once, and at its line."""
    scenario = dc.paper.scenario(wind_unit=3.0, drag=1e3)
    forecast = dc.forecast(scenario, winds(scenario, [100 / 3.0, 0.0]))
    assert forecast.counts["stranded"] == 4
    assert (forecast.dataset["stranding_time"] < 0.02).all()
    away = forecast.dataset["stranding_position"].values - scenario.position
    assert np.hypot(*away.T) == pytest.approx(0.3, abs=1e-12)


@pytest.mark.parametrize("model", ["full", "mean-flow", "paper"])
def test_no_wind_and_no_sea_is_no_motion(model: Any) -> None:
    scenario = still()
    forecast = dc.forecast(scenario, winds(scenario, 0.0), model=model, times=[0.0, 1.0])
    assert forecast.counts["afloat"] == 4
    assert (forecast.dataset["position"].values == 1.0).all()


def test_numbers_beyond_all_physics_are_never_afloat_nowhere() -> None:
    """Winds whose integrals overflow fail by name; those that do not, arrive somewhere."""
    scenario = dc.paper.scenario(epsilon=0.1, coast=None)
    rng = np.random.default_rng(1)
    for speed in (1e100, 1e160, 1e300, 3e307):
        for model in ("full", "mean-flow", "paper"):
            wind = winds(scenario, speed * rng.uniform(-1, 1, (4, 40, 2)))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", dc.DriftCoreWarning)  # of members that failed
                forecast = dc.forecast(scenario, wind, model=model, rtol=1e-3)
            status = forecast.dataset["status"].values
            assert np.isfinite(forecast.dataset["position"].values[status == 0]).all()
    with pytest.raises(dc.ScenarioError, match=r"wind unit|small-scale sd"):
        dc.forecast(scenario.replace(wind_unit=1e-320), members=2)


@pytest.mark.parametrize("model", ["full", "mean-flow", "paper"])
def test_a_start_on_the_coast_line_is_stranded_at_once(model: Any) -> None:
    x, y = 1.0 + 0.3 * math.cos(1.0), 1.0 + 0.3 * math.sin(1.0)
    square = Polygons(rings=[[(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)]])
    for coast, place, side in (
        (Circle(), (x, y), "inside"),
        (Circle(), (1.3, 1.0), "outside"),
        (square, (1.0, 1.5), "inside"),
        (square, (1.0, 1.0), "outside"),
    ):
        scenario = still(coast=coast, side=side, position=place)
        forecast = dc.forecast(scenario, winds(scenario, 0.0), model=model)
        # Rounding puts a place on a circle on either side of its line.
        if forecast.counts["stranded"] == 0:
            assert abs(math.dist(place, (1.0, 1.0)) - 0.3) < 1e-15
            continue
        assert forecast.counts["stranded"] == 4
        assert (forecast.dataset["stranding_time"] == 0.0).all()
        assert (forecast.dataset["stranding_position"] == place).all()


@pytest.mark.parametrize(("offset", "stranded"), [(0.2999, 4), (0.3, 4), (0.3001, 0)])
def test_a_tangent_touches_or_does_not(offset: float, stranded: int) -> None:
    """A straight way past a circle of radius 0.3, at its distance and a ten-thousandth beside."""
    scenario = still(
        side="outside", position=(0.0, 1.0 + offset), velocity=(2.0, 0.0), drag=1e3, epsilon=0.02
    )
    forecast = dc.forecast(scenario, winds(scenario, [2.0, 0.0]), rtol=1e-9)
    counted = forecast.counts["stranded"]
    assert counted == stranded or offset == 0.3  # at the tangent itself rounding decides
    if counted and offset < 0.3:
        place = forecast.dataset["stranding_position"].values[0]
        assert place == pytest.approx((1.0 - math.sqrt(0.3**2 - offset**2), 1.0 + offset), abs=1e-5)


def test_a_coast_of_a_million_points() -> None:
    """It is met at the same place as its circle, and asking where it is takes microseconds."""
    angle = np.linspace(0, 2 * np.pi, 1_000_000, endpoint=False)
    ring = np.ascontiguousarray(1.0 + 0.3 * np.column_stack([np.cos(angle), np.sin(angle)]))
    start = time.process_time()
    coast = _core.Coast.polygons([ring], True)
    built = time.process_time() - start
    start = time.process_time()
    for k in range(1000):
        assert coast.clearance(1.0 + 1e-4 * k, 1.0) == pytest.approx(0.3 - 1e-4 * k, abs=1e-9)
    asked = time.process_time() - start
    assert built < 20
    assert asked < 5
