"""Wind paths given by the user, and the winds that members of a forecast have."""

import dataclasses
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import driftcore as dc
from driftcore.errors import ScenarioError
from reference import Floats, NaiveWind
from strategies import numbers, seeds, winds

# The piecewise-linear path


def regular_wind(seed: int) -> NaiveWind:
    """Knots that differ from a regular grid by rounding only: the core finds them by division."""
    rng = np.random.default_rng(seed)
    return NaiveWind(-0.3 + 0.1 * np.arange(20), rng.standard_normal((20, 2)))


@given(wind=st.one_of(winds(), seeds.map(regular_wind)), seed=seeds)
def test_value_and_integral(wind: NaiveWind, seed: int) -> None:
    path = dc.WindPath(wind.knots, wind.velocity)
    inside = np.random.default_rng(seed).uniform(wind.knots[0], wind.knots[-1], 30)
    times = np.concatenate([wind.knots, inside])
    assert np.allclose(path.at(times), wind.value(times), rtol=0, atol=1e-12)
    assert np.allclose(path.integral(times), wind.cumulative(times), rtol=0, atol=1e-13)
    for t in times[::7]:
        assert np.allclose(path.integral(t), wind.integral(wind.knots[0], t), rtol=0, atol=1e-13)


@given(wind=winds(), window=numbers(1e-3, 1.0), seed=seeds)
def test_window_mean(wind: NaiveWind, window: float, seed: int) -> None:
    path = dc.WindPath(wind.knots, wind.velocity)
    low, high = wind.knots[0] + window / 2, wind.knots[-1] - window / 2
    times = np.append(np.random.default_rng(seed).uniform(low, high, 30), [low, high])
    assert np.allclose(path.mean(times, window), wind.mean(times, window), rtol=0, atol=1e-11)
    middle = (low + high) / 2
    exact = wind.integral(middle - window / 2, middle + window / 2) / window
    assert np.allclose(path.mean(middle, window), exact, rtol=0, atol=1e-11)


def test_shapes_follow_the_times() -> None:
    path = dc.WindPath([0, 1, 3], [[0, 1], [2, 1], [0, 5]])
    assert path.at(0.5).tolist() == [1, 1]
    assert path.integral(3).tolist() == [3, 7]
    assert path.mean([[1, 2]], 2).shape == (1, 2, 2)
    assert path.at(np.zeros((3, 0, 2))).shape == (3, 0, 2, 2)


def test_the_path_keeps_its_own_knots() -> None:
    times, velocity = np.array([0.0, 1.0]), np.zeros((2, 2))
    path = dc.WindPath(times, velocity)
    velocity[:] = 9
    assert path.at(0.5).tolist() == [0, 0]
    with pytest.raises(ValueError, match="read-only"):
        path.velocity[0] = 9


@pytest.mark.parametrize(
    ("times", "velocity", "message"),
    [
        ([0.0], [[0, 0]], r"times: shape \(1,\)"),
        ([[0.0, 1.0]], [[0, 0]], r"times: shape \(1, 2\)"),
        ([0.0, 1.0], [[0, 0]], r"velocity: shape \(1, 2\) .* need \(2, 2\)"),
        ([0.0, 1.0], [[0, 0, 0]] * 2, r"velocity: shape \(2, 3\)"),
        ([0.0, 1.0, 1.0], [[0, 0]] * 3, "times: knot 2 .* increase strictly"),
        ([0.0, 1.0, 0.5], [[0, 0]] * 3, "times: knot 2"),
        ([0.0, np.nan], [[0, 0]] * 2, "times: nan at"),
        ([0.0, 1.0], [[0, 0], [np.inf, 0]], r"velocity: inf at \(1, 0\)"),
        (["a", "b"], [[0, 0]] * 2, "times: "),
    ],
)
def test_bad_knots_are_refused(times: list[float], velocity: list[float], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        dc.WindPath(times, velocity)


def test_times_beyond_the_knots_are_refused() -> None:
    path = dc.WindPath([0, 1], [[0, 0], [1, 1]])
    for t in (-0.01, 1.01, [0.5, 1.01]):
        with pytest.raises(ScenarioError, match=r"known on \[0, 1\]"):
            path.at(t)
        with pytest.raises(ScenarioError, match=r"known on \[0, 1\]"):
            path.integral(t)
    with pytest.raises(ScenarioError, match=r"0\.9 with 0\.2 on each side"):
        path.mean(0.9, 0.4)
    for window in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ScenarioError, match=r"window: .* a time above 0"):
            path.mean(0.5, window)


# Winds of the members

SEED = 3
SUBSTEPS = 48  # of a hundredth of a tide (7.5 min) in 6 h
LEAD_IN = 7  # steps of 6 h in 3 tides of 12.5 h, rounded up
MEMBERS = 60


def synoptic(scenario: dc.Scenario, wind: dc.LocalGridBootstrap, path: dc.WindPath) -> Floats:
    """The bootstrap's values [scenario units] for the members, linear at the path's knots."""
    steps = (len(path.times) - 1) // SUBSTEPS + 1
    values, _ = wind.core.sample(MEMBERS, steps, SEED)
    knots = path.times[::SUBSTEPS]
    at_knots = [NaiveWind(knots, member).value(path.times) for member in values]
    return np.array(at_knots) / scenario.wind_unit


@lru_cache(maxsize=1)
def small_scale(wind: dc.LocalGridBootstrap) -> Floats:
    """Member paths less their synoptic part [m/s], shape (members, knots, 2)."""
    scenario = dc.paper.scenario(1 / 50)
    paths = [dc.member_path(scenario, wind, member, SEED) for member in range(MEMBERS)]
    whole = np.array([path.velocity for path in paths])
    return (whole - synoptic(scenario, wind, paths[0])) * scenario.wind_unit


def test_knots_of_a_member(embedded_wind: dc.LocalGridBootstrap) -> None:
    scenario = dc.paper.scenario(1 / 50)
    path = dc.member_path(scenario, embedded_wind, 0)
    step = scenario.epsilon / 100
    assert np.allclose(path.times, step * (np.arange(len(path.times)) - LEAD_IN * SUBSTEPS))
    # A tide and half a window of 4 tides before, half a tide and half a window after.
    assert path.times[0] <= -3 * scenario.epsilon
    assert path.times[-1] >= 1 + 2.5 * scenario.epsilon - 1e-9
    # Where a hundredth of a tide does not divide 6 h, the small scale is sampled finer.
    shorter = dc.paper.scenario(1 / 50, tide_period_h=12.42)
    path = dc.member_path(shorter, embedded_wind, 0)
    assert np.diff(path.times) * shorter.hours_per_unit == pytest.approx(6 / 49)


def test_without_small_scale_it_is_the_synoptic_sample(
    embedded_wind: dc.LocalGridBootstrap,
) -> None:
    scenario = dc.paper.scenario(1 / 50)
    wind = dataclasses.replace(embedded_wind, share=0.0)
    path = dc.member_path(scenario, wind, 5, SEED)
    expected = synoptic(scenario, wind, path)[5]
    assert np.allclose(path.velocity, expected, rtol=0, atol=1e-13)


def test_small_scale_at_the_synoptic_steps(embedded_wind: dc.LocalGridBootstrap) -> None:
    small = small_scale(embedded_wind)[:, ::SUBSTEPS]
    # 60 members × 118 steps × 2 components, correlation 0.14 between steps: the standard error
    # of the standard deviation is 0.6 %.
    assert small.std() == pytest.approx(embedded_wind.small_scale_sd, rel=0.025)
    assert abs(small).max() < 5.5 * embedded_wind.small_scale_sd


def test_small_scale_law(embedded_wind: dc.LocalGridBootstrap) -> None:
    share = embedded_wind.share
    sd = share * embedded_wind.standard_deviation / np.sqrt(1 - share**2)
    assert share == 0.1
    small = small_scale(embedded_wind) / sd
    # Standard errors (MEMBERS × 2 × 702 h / (2 × 3 h) = 14,000 independent values): 0.009 of the
    # mean and 0.012 of a variance or covariance. All thresholds are 4 of them.
    assert abs(small.mean(axis=(0, 1))).max() < 0.05
    assert abs((small[..., 0] * small[..., 1]).mean()) < 0.05
    for lag in (0, 1, 5, 12, 24, SUBSTEPS, 2 * SUBSTEPS):
        stop = small.shape[1] - lag
        covariance = (small[:, :stop] * small[:, lag:]).mean(axis=(0, 1))
        correlation = np.exp(-lag * 7.5 / 60 / embedded_wind.memory_h)
        assert covariance == pytest.approx([correlation] * 2, abs=0.05)
    # The steps between synoptic ones are filled in later, and must not show: variance and lag-1
    # covariance at each place in the step, over 14,000 pairs (standard error 0.012).
    cells = small[:, :-1].reshape(MEMBERS, -1, SUBSTEPS, 2)
    assert np.allclose((cells**2).mean(axis=(0, 1, 3)), 1, rtol=0, atol=0.06)
    increments = np.diff(small, axis=1).reshape(MEMBERS, -1, SUBSTEPS, 2)
    expected = 2 * (1 - np.exp(-7.5 / 60 / embedded_wind.memory_h))
    assert np.allclose((increments**2).mean(axis=(0, 1, 3)), expected, rtol=0.06)


def test_members_and_seeds_are_independent(embedded_wind: dc.LocalGridBootstrap) -> None:
    small = small_scale(embedded_wind) / embedded_wind.small_scale_sd
    correlation = np.asarray(np.corrcoef(small[..., 0]))
    # 118 independent values each, 1,770 pairs of members: 5 standard errors.
    assert abs(correlation[np.triu_indices(MEMBERS, 1)]).max() < 5 / np.sqrt(118)
    scenario = dc.paper.scenario(1 / 50)
    paths = [
        dc.member_path(scenario, embedded_wind, member, seed).velocity
        for member, seed in ((0, 1), (1, 1), (0, 2), (1, 2))
    ]
    for i, path in enumerate(paths):
        for other in paths[:i]:
            assert (path != other).all()


def test_a_longer_run_begins_like_a_shorter_one(embedded_wind: dc.LocalGridBootstrap) -> None:
    scenario = dc.paper.scenario(1 / 50)
    short = dc.member_path(scenario.replace(duration=0.37), embedded_wind, 4, SEED)
    long = dc.member_path(scenario, embedded_wind, 4, SEED)
    assert len(short.times) < 0.5 * len(long.times)
    assert np.array_equal(short.times, long.times[: len(short.times)])
    assert np.array_equal(short.velocity, long.velocity[: len(short.velocity)])


@pytest.mark.parametrize("member", [-1, 1.5, True])
def test_bad_members_are_refused(embedded_wind: dc.LocalGridBootstrap, member: int) -> None:
    with pytest.raises(ScenarioError, match=r"member: .* a whole number from 0 up"):
        dc.member_path(dc.paper.scenario(), embedded_wind, member)


def test_every_model_of_a_forecast_has_the_member_s_wind(
    embedded_wind: dc.LocalGridBootstrap,
) -> None:
    scenario = dc.paper.scenario(1 / 50, coast=None)
    times = np.linspace(0, 1, 101)
    members = 3
    exact = [
        dc.trajectory(
            scenario, dc.member_path(scenario, embedded_wind, k, SEED), model="full", times=times
        )["position"].to_numpy()
        for k in range(members)
    ]

    def positions(model: dc.scenario.ModelName, order: int | None) -> Floats:
        forecast = dc.forecast(
            scenario, embedded_wind, members=members, seed=SEED, times=times,
            model=model, order=order,
        )  # fmt: skip
        return forecast.dataset["position"].to_numpy()

    # Ten steps a tide: 1e-8 at their ends, a few times that inside them.
    assert np.allclose(positions("full", None), exact, rtol=0, atol=1e-7)
    # Errors of the expansions; another member's wind leads elsewhere by some tenths.
    assert np.allclose(positions("paper", 1), exact, rtol=0, atol=0.01)
    assert np.allclose(positions("mean-flow", 1), exact, rtol=0, atol=2 * scenario.epsilon**2)
    assert np.allclose(positions("mean-flow", 2), exact, rtol=0, atol=2.5 * scenario.epsilon**3)
    assert abs(exact[0] - exact[1]).max() > 0.1


def test_coarse_sampling_loses_little(embedded_wind: dc.LocalGridBootstrap) -> None:
    """Order 1 knows the small scale's integrals over 6 h, not its path inside them."""
    scenario = dc.paper.scenario(1 / 50, coast=None)
    times = np.linspace(0, 1, 101)
    forecast = dc.forecast(scenario, embedded_wind, members=8, seed=SEED, times=times)
    fine = [
        dc.trajectory(
            scenario, dc.member_path(scenario, embedded_wind, k, SEED),
            model="mean-flow", order=1, times=times,
        )["position"].to_numpy()
        for k in range(8)
    ]  # fmt: skip
    difference = abs(forecast.dataset["position"].to_numpy() - fine).max()
    assert 0 < difference < 0.06 * scenario.epsilon**2  # 2.4e-5


# Many winds on common knots


def test_paths_together_are_the_paths_alone() -> None:
    """21 members: more than one group of lanes. Positions, strandings and winds kept agree."""
    rng = np.random.default_rng(7)
    times = np.linspace(-0.1, 1.1, 121)
    velocity = rng.normal(0.5, 2.0, (21, len(times), 2))
    together = dc.WindPaths(times, velocity)
    assert len(together) == 21
    assert "21 members, 121 knots" in repr(together)
    scenario = dc.paper.scenario()
    alone = [dc.WindPath(times, wind) for wind in velocity]
    for model in ("full", "mean-flow"):
        one, other = (
            dc.forecast(scenario, wind, model=model, rtol=1e-9).dataset
            for wind in (together, alone)
        )
        assert 0 < (one["status"] == 1).sum() < 21
        for name in ("stranding_time", "stranding_position", "position", "wind_velocity"):
            np.testing.assert_allclose(one[name], other[name], atol=2e-6, err_msg=name)


def test_single_precision_is_kept() -> None:
    """It is followed as it is, by lanes and alone; nearby winds may take other steps alone."""
    times = np.linspace(-0.1, 1.1, 6001)
    velocity = np.random.default_rng(9).normal(0.5, 2.0, (18, len(times), 2))
    double = dc.WindPaths(times, velocity)
    single = dc.WindPaths(times, velocity.astype(np.float32))
    rounded = dc.WindPaths(times, velocity.astype(np.float32).astype(float))
    scenario = dc.paper.scenario(coast=None)

    def positions(wind: dc.WindPaths, **settings: Any) -> Any:
        return dc.forecast(scenario, wind, rtol=1e-9, **settings).dataset["position"].values

    for model, most in (("full", 1e-8), ("mean-flow", 1e-6)):
        found = positions(single, model=model)
        np.testing.assert_array_equal(found, positions(rounded, model=model))
        assert 0 < np.abs(found - positions(double, model=model)).max() < most
    velocity[3, 5, 1] = np.inf
    with pytest.raises(dc.ScenarioError, match=r"velocity: inf at \(3, 5, 1\) is not accepted"):
        dc.WindPaths(times, velocity.astype(np.float32))


def test_steps_of_one_length() -> None:
    """Ten steps a tide are what the full model takes by itself; two are far off."""
    times = np.linspace(0.0, 1.0, 5001)
    wind = dc.WindPaths(times, np.random.default_rng(8).normal(size=(3, len(times), 2)))
    scenario = dc.paper.scenario(coast=None)

    def end(**settings: float) -> Any:
        run = dc.forecast(scenario, wind, model="full", times=[1.0], **settings)
        return run.dataset["position"].values

    np.testing.assert_array_equal(end(), end(steps_per_tide=10))
    assert 1e-4 < np.abs(end(steps_per_tide=2) - end()).max() < 1e-1
    for refused in (0, -1.0, np.nan, "many"):
        with pytest.raises(dc.ScenarioError, match=r"steps_per_tide: .* is not accepted"):
            end(steps_per_tide=refused)
    with pytest.raises(dc.ScenarioError, match=r"steps_per_tide: 4 .*only the full model"):
        dc.forecast(scenario, members=2, model="mean-flow", order=2, steps_per_tide=4)
    with pytest.raises(dc.ScenarioError, match=r"steps_per_tide: .*at most 1000000 steps"):
        end(steps_per_tide=1e9)


@pytest.mark.parametrize(
    ("times", "shape", "message"),
    [
        ([0.0], (2, 1, 2), r"times: shape \(1,\)"),
        ([0.0, 1.0], (2, 2), r"velocity: shape \(2, 2\)"),
        ([0.0, 1.0], (0, 2, 2), r"velocity: shape \(0, 2, 2\)"),
        ([0.0, 1.0], (3, 3, 2), "2 times need"),
        ([0.0, 1.0, 3.0], (1, 3, 2), "equally spaced"),
        ([1.0, 0.0], (1, 2, 2), "equally spaced"),
    ],
)
def test_paths_that_do_not_fit(times: list[float], shape: tuple[int, ...], message: str) -> None:
    with pytest.raises(dc.ScenarioError, match=message):
        dc.WindPaths(times, np.zeros(shape))


def test_paths_must_cover_the_run() -> None:
    short = dc.WindPaths([0.0, 0.9], np.zeros((2, 2, 2)))
    with pytest.raises(dc.ScenarioError, match=r"wind: they cover \[0, 0.9\]"):
        dc.forecast(dc.paper.scenario(), short)


@pytest.mark.parametrize("times", [["2026-07-01", "NaT"], []])
def test_times_of_a_path_are_times(times: list[str]) -> None:
    instants = np.array(times, dtype="datetime64[ns]")
    with pytest.raises(dc.ScenarioError, match="times: must be UTC times, at least 2, none"):
        dc.WindPath(instants, np.zeros((len(times), 2)))


def test_a_start_that_members_share_and_nobody_has_is_told() -> None:
    case = dc.paper.scenario()
    tide = case.sea.tide.model_copy(update={"mean": 300.576})
    fast = case.model_copy(update={"sea": case.sea.model_copy(update={"tide": tide})})
    told = "the slow initial position did not converge"
    with pytest.raises(dc.DriftCoreError, match=told):
        dc.forecast(fast, members=3, steps_per_tide=8)
    with pytest.warns(dc.DriftCoreWarning, match=f"3 of 3 members failed; .*{told}"):
        dc.forecast(fast, members=3)
