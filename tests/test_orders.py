"""Orders of convergence of the expansions and of explicit Euler, measured by regression."""

from functools import cache
from typing import Any

import numpy as np
import pytest
import xarray as xr

import driftcore as dc
from reference import Floats

TIDES = np.array([25, 50, 100, 200])  # in a run, 1/ε
MEMBERS = 3
# Higher powers of ε are there too: at these ε they move a slope by up to 0.08.
SLACK = 0.1

CALM = dc.WindPath([-1, 2], np.zeros((2, 2)))


@cache
def winds(tides: int) -> tuple[dc.WindPath, ...]:
    scenario, wind = dc.paper.scenario(1 / tides), dc.paper.default_wind()
    return tuple(dc.member_path(scenario, wind, member) for member in range(MEMBERS))


def times(tides: int) -> Floats:
    return (np.arange(40 * tides) + 0.5) / (40 * tides)


@cache
def full(tides: int, member: int) -> xr.Dataset:
    path = winds(tides)[member] if member >= 0 else CALM
    scenario = dc.paper.scenario(1 / tides)
    return dc.trajectory(scenario, path, model="full", times=times(tides), rtol=1e-11)


def largest_distances(one: xr.Dataset, two: xr.Dataset) -> list[float]:
    return [
        float(np.linalg.norm(one[name].values - two[name].values, axis=1).max())
        for name in ("velocity", "position")
    ]


def slopes(x: Floats, errors: list[Any]) -> Floats:
    slope: Floats = np.polyfit(np.log(x), np.log(errors), 1)[0]
    return slope


def errors(tides: int, members: range, settings: dict[str, Any]) -> Floats:
    """Mean over the members of the errors of velocity and position."""
    scenario, found = dc.paper.scenario(1 / tides), []
    for member in members:
        path = winds(tides)[member] if member >= 0 else CALM
        averaged = dc.trajectory(scenario, path, times=times(tides), **settings)
        found.append(largest_distances(full(tides, member), averaged))
    return np.mean(found, axis=0)


@pytest.mark.parametrize("order", [0, 1])
def test_paper_without_wind(order: int) -> None:
    settings = {"model": "paper", "order": order}
    found = [errors(t, range(-1, 0), settings) for t in TIDES]
    assert slopes(1 / TIDES, found) == pytest.approx([order + 1] * 2, abs=SLACK)


@pytest.mark.parametrize("order", [0, 1])
def test_paper_with_wind_but_without_its_wind_terms(order: int) -> None:
    # A tenth of a tide: the wider the window, the more the smoothing of the wind shows, which is
    # of order 1.
    settings = [
        {"model": "paper", "order": order, "wind_terms": False, "window": 0.1 / t} for t in TIDES
    ]
    found = [errors(t, range(MEMBERS), s) for t, s in zip(TIDES, settings, strict=True)]
    assert slopes(1 / TIDES, found) == pytest.approx([order + 1] * 2, abs=SLACK)


def test_the_wind_terms_spoil_order_1() -> None:
    settings = [{"model": "paper", "order": 1, "window": 0.1 / t} for t in TIDES]
    found = [errors(t, range(MEMBERS), s) for t, s in zip(TIDES, settings, strict=True)]
    assert (slopes(1 / TIDES, found) < 1.3).all()


@pytest.mark.parametrize("order", [1, 2])
def test_mean_flow_with_wind(order: int) -> None:
    settings = {"model": "mean-flow", "order": order}
    found = [errors(t, range(MEMBERS), settings) for t in TIDES]
    assert slopes(1 / TIDES, found) == pytest.approx([order + 1] * 2, abs=SLACK)


@pytest.mark.parametrize(
    "settings",
    [
        {"model": "full", "formulation": "A"},
        {"model": "full"},
        {"model": "paper"},
        {"model": "paper", "wind_terms": False},
        {"model": "mean-flow", "order": 1},
        {"model": "mean-flow", "order": 2},
    ],
    ids=lambda settings: " ".join(map(str, settings.values())),
)
def test_euler(settings: dict[str, Any]) -> None:
    scenario, path = dc.paper.scenario(1 / 50), winds(50)[0]
    exact = dc.trajectory(scenario, path, times=times(50), rtol=1e-10, **settings)
    steps = 1600 * 2 ** np.arange(4)
    found = [
        dc.trajectory(scenario, path, times=times(50), euler_step=1 / n, **settings) for n in steps
    ]
    assert [run.attrs["evaluations"] for run in found] == [run.attrs["steps"] for run in found]
    assert [run.attrs["steps"] for run in found] == steps.tolist()
    distances = [largest_distances(exact, run) for run in found]
    # The second-order part of the error is below 2 % at the coarsest of these steps.
    assert slopes(1 / steps, distances) == pytest.approx([1, 1], abs=0.05)
