"""The boundary of the core: what it refuses, and with which exception."""

import contextlib
from typing import Any

import numpy as np
import pytest
import xarray as xr

import driftcore as dc
from driftcore import _core
from driftcore.compiled import scenario_core, solver_of
from driftcore.ensemble_winds import Resampled
from driftcore.members import Fates


def refused(told: str | None) -> contextlib.AbstractContextManager[object]:
    """Expect a refusal, or none."""
    return contextlib.nullcontext() if told is None else pytest.raises(ValueError, match=told)


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


@pytest.mark.parametrize("given", ["one by one", "on common knots", "of particles", "in space"])
@pytest.mark.parametrize("first", [3, 8, 2**34])
def test_each_member_has_a_wind(
    given: str, first: int, embedded_wind: dc.LocalGridBootstrap
) -> None:
    """Else a member has none although others that it shares its steps with have, or is far off."""
    case = dc.paper.scenario()
    _, solver = solver_of(case, "mean-flow", None, None, True, "B", 1e-6, None)
    calm = _core.WindPath(np.array([-1.0, 2.0]), np.zeros((2, 2)))
    line = (0.0, 1.0, 1)
    winds: Any = {
        "one by one": [calm] * 5,
        "on common knots": _core.WindPaths(-1.0, 0.1, np.zeros((5, 31, 2))),
        "of particles": (
            *Resampled(case, embedded_wind, solver, 1).core,
            _core.Particles(np.full(5, 7, dtype=np.uint64), 1),
        ),
        "in space": _core.FieldWinds(
            [line, line], np.ones((1, 1, 1, 2)), (0.0, 1.0), 0, np.zeros((5, 2, 1))
        ),
    }[given]
    position = np.ones((4, 2))
    fleet = _core.Fleet(
        case.sea.core(0.02, 0.02, 1.0),
        *(None, None, 1.0, first, np.zeros(4), position, None, np.zeros((1, 10)), 0.0, 1),
    )
    for core in (scenario_core(case), fleet):
        for start in (first, 1):
            fates = Fates.empty(4, 0, 0, 0)
            told = rf"winds: of members 0\.\.5 is not accepted; the run is of members {start}\.\."
            with refused(None if start == 1 else told):
                core.run(winds, solver, start, np.zeros(0), 0, fates, 1, [])


def test_no_particle_has_members_beyond_their_numbers() -> None:
    """Their random streams would be those of others."""
    beyond = np.array([2**62], dtype=np.uint64)
    told = r"member: 4611686018427387904 is .* to 2⁶²"
    with pytest.raises(ValueError, match=told):
        _core.Particles(beyond, 1)
    particles = _core.Particles(np.array([3], dtype=np.uint64), 1)
    with pytest.raises(ValueError, match=told):
        particles.branched(np.array([0]), np.array([5]), beyond)


def test_no_sea_changes_faster_than_any_tide() -> None:
    """Such a change is noise, which steps were made for."""
    steady = ((2.0, 1.0, 3.0, 0.0, 0), np.ones((1, 2)))
    axis, still = (0.0, 1.0, 4), np.zeros((1, 6, 6, 4), dtype=complex)
    for excess, told in (
        (0.99, None),
        (1.01, "is not accepted; a tide has at most 100 of its cycl"),
    ):
        cycles = 100 * excess / 0.02
        fast = ((2.0, 1.0, -cycles, 0.0, 0), np.ones((1, 2)))
        for currents in ((steady, fast), (fast, steady)):
            with refused(told and f"cycles: .* {told}"):
                _core.Sea.academic(0.02, *currents, 0.02)
        with refused(told and f"constituent: .* {told}"):
            axes = [axis, axis, (0.0, 1.0, 1)]
            _core.Sea.constituents(0.02, axes, [(2 * np.pi * cycles, 2)], still)


def test_no_run_has_more_response_times_than_steps_can_be() -> None:
    sea = dc.paper.scenario().sea.core(0.02, 0.02, 1.0)
    still = (0.0, 0.0)
    for drag, told in ((1e6 / 3, None), (1.1e6 / 3, "drag: .* at most 1000000 response times")):
        with refused(told):
            _core.Scenario(sea, None, drag, 3.0, still, still)


def test_what_a_shell_completes_is_there() -> None:
    assert dir(dc) == sorted(dc.__all__)
    assert all(hasattr(dc, name) for name in dc.__all__)


@pytest.mark.parametrize(("step", "lead_in"), [(0.01, 2**40), (1e-12, 0)])
def test_members_side_by_side_have_no_more_knots_than_others(
    step: float, lead_in: int, embedded_wind: dc.LocalGridBootstrap
) -> None:
    case = dc.paper.scenario()
    _, solver = solver_of(case, "mean-flow", None, None, True, "B", 1e-6, None)
    generator = _core.WindGenerator(embedded_wind.core, step, 3.0, 0.1, 0.01, 1, lead_in)
    fates = Fates.empty(9, 0, 0, 0)
    told = scenario_core(case).run((generator, 1), solver, 0, np.zeros(0), 0, fates, 1, [])
    assert "a wind path has at most 20000000 knots" in str(told)
    assert (fates.status == 3).all()


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
    for dtype in (np.float64, np.float32):
        with pytest.raises(ValueError, match=r"velocity: shape \(4, 2, 1\) .* two components"):
            _core.WindPaths(0.0, 1.0, np.zeros((4, 2, 1), dtype))
    paths = _core.WindPaths(0.0, 1.0, np.zeros((4, 2, 2)))
    assert paths.velocity(4, np.array([0.5])).shape == (4, 1, 2)
    with pytest.raises(ValueError, match="members: 5 is not accepted; there are fewer"):
        paths.velocity(5, np.array([0.5]))
