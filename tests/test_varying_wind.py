"""Mean-flow orders of the paper's body where the wind varies in space: measured slopes."""

import numpy as np
import pytest

from driftcore import _core
from driftcore.members import Fates
from driftcore.sea import spline_coefficients

_AXIS = (-2.0, 0.05, 121)
_X, _Y = np.meshgrid(*[np.linspace(-2, 4, 121)] * 2)
_TIMES = np.linspace(0, 1, 401)
EXACT = _core.Solver.full(True, 1e-11, 1e-11, None)


def sea(epsilon: float) -> _core.Sea:
    """Two harmonics and a mean residual, nonlinear in the position."""

    def amplitude(a: float, b: float, phase: float) -> np.ndarray:
        return np.asarray(
            a * np.sin(0.8 * _X + b * _Y + phase) + 1j * b * np.cos(0.6 * _Y - a * _X + 2 * phase)
        )

    tide = [(1.0, 0.7, 0.1), (0.8, -0.6, 0.5), (0.5, 0.4, 0.9), (-0.4, 0.5, 1.3)]
    residual = [epsilon * (0.6 + 0.3 * np.sin(_Y)), epsilon * (-0.4 + 0.3 * np.cos(_X))]
    fields = np.stack([*(amplitude(*numbers) for numbers in tide), *residual], axis=-1)[None]
    for dimension in range(3):
        fields = spline_coefficients(fields, dimension)
    still = (0.0, 1.0, 1)
    return _core.Sea.gridded(epsilon, [_AXIS, _AXIS, still], 2, np.ascontiguousarray(fields))


def wind(amplitudes: np.ndarray) -> _core.FieldWinds:
    patterns = np.stack(
        [
            np.stack([np.sin(_X + 0.5 * _Y), np.cos(0.7 * _Y - _X)], axis=-1),
            np.stack([np.cos(0.8 * _X), 0.5 * np.sin(_X * _Y / 2)], axis=-1),
            np.stack([1 + 0 * _X, 0.5 + 0 * _X], axis=-1),
        ],
        axis=2,
    )
    for dimension in range(2):
        patterns = spline_coefficients(patterns, dimension)
    step = 1 / (len(amplitudes) - 1)
    axes = [_AXIS, _AXIS]
    return _core.FieldWinds(axes, np.ascontiguousarray(patterns), (0.0, step), 0, amplitudes[None])


def errors(winds: _core.FieldWinds, order: int, epsilon: float) -> tuple[float, float]:
    """Largest differences in position and velocity from the full model."""
    body = np.array([[1.0, 1.0, 1.0, 0, 0, 0, 0, 0, 0, 0]])
    release = np.array([[1.0, 1.0]])
    fleet = _core.Fleet(
        sea(epsilon), None, None, 1.0, 0, np.zeros(1), release, np.zeros((1, 2)), body, 0.0, 1
    )
    averaged = _core.Solver.mean_flow(order, 1e-11, 1e-11, None)
    full, mean = (fleet.trajectory(winds, solver, _TIMES)[0] for solver in (EXACT, averaged))
    return tuple(float(np.abs(full[k] - mean[k]).max()) for k in range(2))  # type: ignore[return-value]


@pytest.mark.parametrize(("order", "low", "high"), [(1, 1.85, 2.25), (2, 2.9, 3.15)])
def test_slopes_in_a_wind_smooth_in_time(order: int, low: float, high: float) -> None:
    s = np.linspace(0, 1, 801)[:, None]
    smooth = wind(np.cos(np.array([2.0, 5.0, 3.0]) * s + np.array([0.3, 1.0, 2.0])))
    found = np.array([errors(smooth, order, epsilon) for epsilon in (1 / 20, 1 / 40, 1 / 80)])
    slopes = np.log2(found[:-1] / found[1:])
    assert (slopes > low).all(), slopes
    assert (slopes < high).all(), slopes


def test_order_two_in_a_wind_with_corners() -> None:
    """Its corners fall anywhere in the tide: regression over eight times in epsilon."""
    rough = wind(np.random.default_rng(3).standard_normal((26, 3)))
    epsilons = 1 / np.array([20.0, 40.0, 80.0, 160.0])
    found = np.log([errors(rough, 2, epsilon)[0] for epsilon in epsilons])
    assert np.polyfit(np.log(epsilons), found, 1)[0] > 2.7


def test_order_two_is_of_the_papers_body_only() -> None:
    body = np.array([[1.0, 0.5, 0.5, 0, 0, 0, 0, 0, 0, 0]])
    fleet = _core.Fleet(
        sea(0.02), None, None, 1.0, 0, np.zeros(1), np.ones((1, 2)), None, body, 0.0, 1
    )
    with pytest.raises(ValueError, match="only the paper's body"):
        fleet.trajectory(wind(np.ones((3, 3))), _core.Solver.mean_flow(2, 1e-6, 1e-6, None), _TIMES)


@pytest.mark.parametrize("moving", [False, True])
def test_order_two_strands_as_by_the_papers_body_in_a_uniform_wind(moving: bool) -> None:
    """Two programs of one expansion, and the full model within its order."""
    epsilon, water = 1 / 40, sea(1 / 40)
    start = np.array([[1.0, 1.0]])
    own = water.velocity(np.zeros(1), start)
    coast = _core.Coast.circle((1.0, 1.0), 0.6, True)
    path = _core.WindPath(np.linspace(-1.0, 2.0, 4), np.array([[3.0, 1.0], [1.0, 2.0]] * 2))
    body = np.array([[1.0, 1.0, 1.0, 0, 0, 0, 0, 0, 0, 0]])
    given = own if moving else None
    fleet = _core.Fleet(water, coast, None, 1.0, 0, np.zeros(1), start, given, body, 0.0, 1)
    alone = _core.Scenario(water, coast, 1.0, 1.0, (1.0, 1.0), tuple(own[0]))
    averaged = _core.Solver.mean_flow(2, 1e-9, 1e-9, None)
    times = np.zeros(1)
    found = []
    for followed, solver in ((fleet, averaged), (alone, averaged), (fleet, EXACT)):
        fates = Fates.empty(1, 1, 1, 0)
        assert followed.run([path], solver, 0, times, 1, fates, 1, []) is None
        assert fates.status.tolist() == [1]
        found.append(np.array([fates.stranding_time[0], *fates.stranding_position[0]]))
    np.testing.assert_allclose(found[0], found[1], atol=1e-7)
    np.testing.assert_allclose(found[0], found[2], atol=20 * epsilon**3)
