"""The boundary of the core: what it refuses, and with which exception."""

from typing import Any

import numpy as np
import pytest
import xarray as xr

import driftcore as dc
from driftcore import _core
from driftcore.members import Fates


def test_a_path_knows_its_ends() -> None:
    path = _core.WindPath(np.array([-0.5, 0.25, 2.0]), np.zeros((3, 2)))
    assert (path.start, path.end) == (-0.5, 2.0)


def test_a_velocity_has_two_components() -> None:
    with pytest.raises(ValueError, match=r"wind path velocity: shape \(2, 3\).*two columns"):
        _core.WindPath(np.array([0.0, 1.0]), np.zeros((2, 3)))


def test_each_position_has_its_time() -> None:
    sea = dc.paper.scenario().sea.core(0.02, 0.02, 1.0)
    with pytest.raises(ValueError, match="times: 3 is not accepted; one for each position"):
        sea.velocity(np.zeros(3), np.ones((2, 2)))


def test_a_slow_start_that_does_not_converge_is_an_error() -> None:
    """With `M = -ωx sin ωt` the excursion at the start is `a(0, Y) = Y`: no iteration settles."""
    epsilon = 1 / 50
    space = np.linspace(-2.0, 2.0, 5)
    tide = np.zeros((1, 2, 5, 5), dtype=complex)
    tide[0, 0] = 2j * np.pi / epsilon * space  # the last axis is x
    coordinates = {"harmonic": [1], "component": ["x", "y"], "y": space, "x": space}
    sea = dc.HarmonicSea(xr.DataArray(tide, coordinates, ("harmonic", "component", "y", "x")))
    scenario = dc.Scenario(sea=sea, position=(1.0, 1.0), epsilon=epsilon, coast=None)
    calm = dc.WindPath(np.array([-1.0, 2.0]), np.zeros((2, 2)))
    with pytest.raises(dc.DriftCoreError, match="did not converge"):
        dc.trajectory(scenario, calm, model="mean-flow", order=1, times=np.array([0.0, 1.0]))


def test_what_a_shell_completes_is_there() -> None:
    assert dir(dc) == sorted(dc.__all__)
    assert all(hasattr(dc, name) for name in dc.__all__)


def fleet(times: Any = (0.0, 0.0), bodies: int = 10) -> _core.Fleet:
    """Two bodies on the sea of the paper, which at first are where it is calm."""
    sea = dc.paper.scenario().sea.core(0.02, 0.02, 1.0)
    body = np.zeros((1, bodies))
    return _core.Fleet(
        sea, None, None, 1.0, 0, np.array(times), np.ones((2, 2)), None, body, 0.0, 1
    )


def test_a_fleet_takes_a_time_for_each_place_and_ten_numbers_of_a_body() -> None:
    with pytest.raises(ValueError, match="times: 3 is not accepted; one for each of the 2 positi"):
        fleet(times=np.zeros(3))
    with pytest.raises(ValueError, match="bodies: 9 is not accepted; 10 columns"):
        fleet(bodies=9)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([0.5, 0.2], "times: 0.2 is not accepted; they must not decrease"),
        ([0.5, 1.2], r"times: 1\.2 is not accepted; the run covers \[0, 1\]"),
        ([-0.1, 0.2], r"times: -0\.1 is not accepted; the run covers"),
        ([0.1, np.nan], "times: NaN is not accepted"),
    ],
)
def test_outputs_lie_in_the_run_in_order(times: list[float], message: str) -> None:
    calm = _core.WindPath(np.array([0.0, 1.0]), np.zeros((2, 2)))
    solver = _core.Solver.full(False, 1e-6, 1e-6, None)
    with pytest.raises(ValueError, match=message):
        fleet().trajectory([calm], solver, np.array(times))


def test_what_is_filled_in_fits_what_is_asked_for() -> None:
    calm = _core.WindPath(np.array([0.0, 1.0]), np.zeros((2, 2)))
    solver = _core.Solver.full(False, 1e-6, 1e-6, None)
    times = np.array([0.0, 1.0])
    fitting = Fates.empty(2, 1, 2, 0)
    assert fleet().run([calm, calm], solver, 0, times, 1, fitting, 1, []) is None
    assert np.isfinite(fitting.position).all()
    for change in (
        {"stranding_time": np.zeros(3)},
        {"stranding_position": np.zeros((2, 3))},
        {"position": np.zeros((0, 2, 2))},
        {"position": np.zeros((1, 3, 2))},
        {"entry_time": np.zeros((2, 1))},
    ):
        into = fitting._replace(**change)
        with pytest.raises(ValueError, match="2 members, 1 kept at 2 times, 0 targets"):
            fleet().run([calm, calm], solver, 0, times, 1, into, 1, [])


def test_patterns_and_paths_are_of_what_is_asked_for() -> None:
    axes = [(0.0, 1.0, 1)] * 2
    with pytest.raises(ValueError, match=r"wind patterns: .* two components each"):
        _core.FieldWinds(axes, np.zeros((1, 1, 2, 3)), (0.0, 1.0), 0, np.zeros((1, 2, 2)))
    with pytest.raises(ValueError, match=r"wind patterns: .* two components each"):
        _core.FieldWinds(axes, np.zeros((1, 1, 2, 2)), (0.0, 1.0), 0, np.zeros((1, 2, 3)))
    paths = _core.WindPaths(0.0, 1.0, np.zeros((4, 2, 2)))
    assert paths.velocity(4, np.array([0.5])).shape == (4, 1, 2)
    with pytest.raises(ValueError, match="members: 5 is not accepted; there are fewer"):
        paths.velocity(5, np.array([0.5]))
