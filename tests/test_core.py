"""The boundary of the core: what it refuses, and with which exception."""

import numpy as np
import pytest
import xarray as xr

import driftcore as dc
from driftcore import _core


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
