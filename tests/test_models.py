"""The three models of a drifting body against the naive reference and their own invariants."""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

import driftcore as dc
from driftcore.errors import ScenarioError
from reference import (
    Floats,
    NaiveWind,
    PaperSea,
    Path,
    RandomSea,
    full_4d,
    mean_flow,
    mean_flow_terms,
    random_sea,
    stroboscopic,
)
from strategies import Run, numbers, runs
from test_sea import amplitudes, harmonic_sea

CALM = dc.WindPath([-1.0, 2.0], np.zeros((2, 2)))
MODELS: list[dict[str, Any]] = [
    {"model": "full", "formulation": "A"},
    {"model": "full", "formulation": "B"},
    {"model": "mean-flow", "order": 1},
    {"model": "mean-flow", "order": 2},
    {"model": "paper", "order": 0},
    {"model": "paper", "order": 1},
]
EXACT = [kwargs for kwargs in MODELS if kwargs["model"] == "full"]
MEAN_FLOW = [kwargs for kwargs in MODELS if kwargs["model"] == "mean-flow"]
# The reference spends about a second on each run.
few_examples = settings(max_examples=max(1, settings().max_examples // 4))


def name(kwargs: dict[str, Any]) -> str:
    return "-".join(str(value) for value in kwargs.values())


def scenario_of(run: Run) -> dc.Scenario:
    return dc.Scenario(
        epsilon=run.sea.period,
        duration=run.times[-1],
        drag=run.drag,
        position=run.x,
        velocity=run.v,
        sea=harmonic_sea(run.sea, space=np.linspace(-3, 5, 6)),
        coast=None,
    )


def path_of(wind: NaiveWind) -> dc.WindPath:
    return dc.WindPath(wind.knots, wind.velocity)


def follow(run: Run, **kwargs: Any) -> xr.Dataset:
    kwargs = {"rtol": 1e-11, **kwargs}
    return dc.trajectory(scenario_of(run), path_of(run.wind), times=run.times, **kwargs)


def largest_difference(dataset: xr.Dataset, expected: Path) -> float:
    """Over all the times of all variables that the dataset has."""
    differences = [np.abs(v - getattr(expected, str(k))).max() for k, v in dataset.items()]
    return float(max(differences))


# The full system


def noisy_wind(seed: int = 2006) -> NaiveWind:
    """Mean, synoptic swings and AR(1) noise: 5,001 knots in [0, 1], a hundred per tide."""
    rng = np.random.default_rng(seed)
    knots = np.linspace(-0.1, 1.1, 6001)
    swing = NaiveWind(np.linspace(-0.1, 1.1, 61), rng.standard_normal((61, 2))).value(knots)
    noise = np.zeros((6001, 2))
    for k, shock in enumerate(rng.standard_normal((6000, 2))):
        noise[k + 1] = 0.96 * noise[k] + 0.03 * shock
    return NaiveWind(knots, np.array([0.3, -1.0]) + swing + noise)


class NoisyRun(NamedTuple):
    wind: NaiveWind
    times: Floats
    exact: Path


@pytest.fixture(scope="module")
def noisy_run() -> NoisyRun:
    """The paper's 4-D form at ε = 1/50, stopped at every knot: some 15 s."""
    wind, times = noisy_wind(), np.linspace(0, 1, 251)
    exact = full_4d(PaperSea(1 / 50), wind, 1.0, (1, 1), (0, 0), times, rtol=1e-10, atol=1e-11)
    return NoisyRun(wind, times, exact)


@pytest.mark.parametrize("kwargs", EXACT, ids=name)
def test_full_model_is_the_paper_s_system(noisy_run: NoisyRun, kwargs: dict[str, Any]) -> None:
    case, path = dc.paper.scenario(1 / 50), path_of(noisy_run.wind)
    found = dc.trajectory(case, path, times=noisy_run.times, rtol=1e-10, **kwargs)
    assert largest_difference(found, noisy_run.exact) < 1e-7


@few_examples
@given(run=runs(max_tides=1))
def test_full_model_on_any_sea(run: Run) -> None:
    exact = full_4d(run.sea, run.wind, run.drag, run.x, run.v, run.times, rtol=1e-10, atol=1e-11)
    for kwargs in EXACT:
        assert largest_difference(follow(run, **kwargs), exact) < 2e-8


@pytest.mark.parametrize(
    ("kwargs", "slow"),
    [
        *((kwargs, "") for kwargs in EXACT),
        *((kwargs, "mean_") for kwargs in MEAN_FLOW),
        ({"model": "paper", "order": 0}, "mean_"),
    ],
    ids=str,
)
def test_velocity_is_the_derivative_of_position(kwargs: dict[str, Any], slow: str) -> None:
    """Differences of order 4 over ±ε/500, inside steps and across them, under a noisy wind."""
    epsilon = 1 / 50
    case, path = dc.paper.scenario(epsilon), path_of(noisy_wind())
    middle, d = np.linspace(0.0137, 0.9871, 200), epsilon / 1000
    times = np.add.outer(middle, d * np.arange(-2, 3)).ravel()
    found = dc.trajectory(case, path, times=times, rtol=1e-12, **kwargs)
    x = found[f"{slow}position"].to_numpy().reshape(200, 5, 2)
    slope = (x[:, 0] - 8 * x[:, 1] + 8 * x[:, 3] - x[:, 4]) / (12 * d)
    velocity = found[f"{slow}velocity"].to_numpy()[2::5]
    assert np.allclose(slope, velocity, rtol=0, atol=1e-6)


# Errors of the expansions


def sup_errors(exact: xr.Dataset, approximate: xr.Dataset) -> tuple[float, float]:
    """Largest distances of velocity and of position."""
    distances = [
        np.linalg.norm(exact[key].to_numpy() - approximate[key].to_numpy(), axis=-1).max()
        for key in ("velocity", "position")
    ]
    return float(distances[0]), float(distances[1])


# Largest over [0, 1] without wind, tides: V of order 0 and 1, X of order 0 and 1.
STROBOSCOPIC_ERRORS = {
    25: (0.2274, 0.00603, 0.0358, 0.00283),
    50: (0.1132, 0.00149, 0.0174, 0.00070),
    100: (0.0565, 0.00037, 0.0086, 0.00017),
    200: (0.0282, 0.00009, 0.0042, 0.00004),
}


@pytest.mark.parametrize("tides", STROBOSCOPIC_ERRORS)
def test_table_without_wind(tides: int) -> None:
    case, times = dc.paper.scenario(1 / tides), np.linspace(0, 1, 400 * tides + 1)
    full = dc.trajectory(case, CALM, model="full", times=times, rtol=1e-11)
    for order in (0, 1):
        found = dc.trajectory(case, CALM, model="paper", order=order, times=times, rtol=1e-11)
        errors = sup_errors(full, found)
        rounded = tuple(round(error, 4 + order) for error in errors)
        assert rounded == STROBOSCOPIC_ERRORS[tides][order::2]


@pytest.mark.parametrize("tides", [25, 50, 100])
def test_mean_flow_under_a_noisy_wind(tides: int) -> None:
    case, times = dc.paper.scenario(1 / tides), np.linspace(0, 1, 100 * tides + 1)
    for path in (path_of(noisy_wind(seed)) for seed in (2006, 1, 2)):
        full = dc.trajectory(case, path, model="full", times=times, rtol=1e-11)
        for order, limits in ((1, (3.5, 2.0)), (2, (5.0, 2.5))):
            found = dc.trajectory(case, path, model="mean-flow", order=order, times=times)
            errors = np.array(sup_errors(full, found)) * tides ** (order + 1)
            assert (errors <= limits).all(), errors


@pytest.mark.parametrize(
    ("kwargs", "slope"),
    [
        ({"model": "mean-flow", "order": 1}, 2),
        ({"model": "mean-flow", "order": 2}, 3),
        ({"model": "paper", "order": 0}, 1),
        ({"model": "paper", "order": 1}, 2),
    ],
    ids=str,
)
def test_orders_of_convergence(kwargs: dict[str, Any], slope: int) -> None:
    """Velocity and position, on a random sea whose every term matters, under a noisy wind.

    The paper's order 1 needs that the wind is taken as slow, with a short window.
    """
    path = path_of(noisy_wind())
    epsilons = 1 / np.array([20, 40, 80])
    errors = []
    for epsilon in epsilons:
        case = dc.Scenario(
            epsilon=epsilon,
            drag=1.4,
            position=(1.1, 0.9),
            velocity=(0.2, -0.1),
            sea=harmonic_sea(random_sea(np.random.default_rng(3), 2, epsilon)),
            coast=None,
        )
        slow_wind = {"wind_terms": False, "window": epsilon / 50}
        options = kwargs | (slow_wind if kwargs["model"] == "paper" else {})
        times = np.linspace(0, 1, round(40 / epsilon) + 1)
        full = dc.trajectory(case, path, model="full", times=times, rtol=1e-11)
        found = dc.trajectory(case, path, times=times, rtol=1e-9, **options)
        errors.append(sup_errors(full, found))
    slopes = np.polyfit(np.log(epsilons), np.log(errors), 1)[0]
    assert slopes == pytest.approx([slope, slope], abs=0.2 if slope == 3 else 0.15)


# The averaged models, term by term


def stroboscopic_of(run: Run, order: int, window: float, wind_terms: bool) -> Path:
    return stroboscopic(
        run.sea, run.wind, run.x, run.v, run.drag, run.times, order, window, wind_terms
    )


def mean_flow_of(run: Run, order: int) -> Path:
    return mean_flow(run.sea, run.wind, run.x, run.v, run.drag, run.times, order)


def smoke_run() -> Run:
    """Three harmonics, drag 2.2, a wind with few irregular knots."""
    rng = np.random.default_rng(8)
    sea = random_sea(rng, 3, 0.05)
    knots = np.append(np.sort(rng.uniform(-0.1, 0.2, 9)), 0.2)
    knots[0] = -0.1
    wind = NaiveWind(knots, rng.uniform(-2, 2, (10, 2)))
    return Run(sea, wind, 2.2, (0.8, 1.3), (0.5, -0.7), np.linspace(0, 0.1, 9))


@pytest.mark.parametrize("wind_terms", [True, False])
@pytest.mark.parametrize("order", [0, 1])
def test_paper_model_on_a_random_sea(order: int, wind_terms: bool) -> None:
    run, window = smoke_run(), 0.03
    found = follow(run, model="paper", order=order, window=window, wind_terms=wind_terms)
    expected = stroboscopic_of(run, order, window, wind_terms)
    assert largest_difference(found, expected) < 2e-8


@few_examples
@given(
    run=runs(),
    order=st.sampled_from([0, 1]),
    tides=numbers(0.05, 2.0),
    wind_terms=st.booleans(),
)
def test_paper_model_on_any_sea(run: Run, order: int, tides: float, wind_terms: bool) -> None:
    window = tides * run.sea.period
    found = follow(run, model="paper", order=order, window=window, wind_terms=wind_terms)
    assert largest_difference(found, stroboscopic_of(run, order, window, wind_terms)) < 2e-8


@pytest.mark.parametrize("order", [1, 2])
def test_mean_flow_on_a_random_sea(order: int) -> None:
    run = smoke_run()
    found = follow(run, model="mean-flow", order=order)
    assert largest_difference(found, mean_flow_of(run, order)) < 2e-8


@few_examples
@given(run=runs(), order=st.sampled_from([1, 2]))
def test_mean_flow_on_any_sea(run: Run, order: int) -> None:
    found = follow(run, model="mean-flow", order=order)
    assert largest_difference(found, mean_flow_of(run, order)) < 2e-8


@pytest.mark.parametrize("order", [1, 2])
def test_mean_flow_oscillates_about_its_mean(order: int) -> None:
    """X = Y + a(t, θ, Y) and V = m(t, X) + Q - ΛX, from the slow path alone."""
    run = smoke_run()
    found = follow(run, model="mean-flow", order=order)
    q0 = run.v - run.sea.velocity(0.0, np.array(run.x)) + run.drag * np.array(run.x)
    for now in run.times:
        x, v, y, rate = (
            found[key].sel(time=now).to_numpy()
            for key in ("position", "velocity", "mean_position", "mean_velocity")
        )
        q = q0 + run.drag * run.wind.integral(0, now)
        a, _, expected_rate, _ = mean_flow_terms(run.sea, run.wind, run.drag, now, y, q, order)
        assert np.allclose(x, y + a, rtol=0, atol=1e-13)
        assert np.allclose(rate, expected_rate, rtol=0, atol=1e-11)
        expected = run.sea.velocity(now, x) + q - run.drag * x
        assert np.allclose(v, expected, rtol=0, atol=1e-12)


# Invariants


@given(run=runs())
def test_a_run_begins_at_the_release(run: Run) -> None:
    run = run._replace(times=np.array([0.0, run.times[-1]]))
    for kwargs in MODELS:
        found = follow(run, rtol=1e-6, **kwargs).isel(time=0)
        assert np.allclose(found["position"], run.x, rtol=0, atol=2e-15)
        assert np.allclose(found["velocity"], run.v, rtol=0, atol=1e-13)


@given(run=runs())
def test_drag_invariant_of_the_full_model(run: Run) -> None:
    """V - m + ΛX - Λ∫W is constant."""
    run = run._replace(times=np.linspace(0, run.times[-1], 50))
    work = run.wind.cumulative(run.times) - run.wind.cumulative(0)
    for kwargs in EXACT:
        found = follow(run, **kwargs)
        x, v = found["position"].to_numpy(), found["velocity"].to_numpy()
        m = np.array([run.sea.velocity(t, p) for t, p in zip(run.times, x, strict=True)])
        invariant = v - m + run.drag * (x - work)
        assert np.allclose(invariant, invariant[0], rtol=0, atol=1e-8)


def drag_solution(run: Run) -> Path:
    """X'' = Λ(W - X') in closed form from knot to knot."""
    ends = np.union1d(run.wind.knots[run.wind.knots > 0], np.append(run.times, 0.0))
    ends = ends[ends <= run.times[-1]]
    velocity = [np.array(run.v)]
    for start, stop in pairwise(ends):
        w, following = run.wind.value([start, stop])
        lag = (following - w) / (stop - start) / run.drag
        decay = np.exp(-run.drag * (stop - start))
        velocity.append(following - lag + decay * (velocity[-1] - w + lag))
    v = np.array(velocity)[np.searchsorted(ends, run.times)]
    work = run.wind.cumulative(run.times) - run.wind.cumulative(0)
    return Path(run.x + work - (v - run.v) / run.drag, v)


def still(run: Run) -> Run:
    return run._replace(sea=RandomSea(run.sea.period, 0 * run.sea.z, 0 * run.sea.p))


@given(run=runs())
def test_without_sea_there_is_drag_alone(run: Run) -> None:
    exact = drag_solution(run)
    for kwargs in (*EXACT, *MEAN_FLOW):
        found = follow(still(run), **kwargs)[["position", "velocity"]]
        assert largest_difference(found, exact) < 1e-8


@given(run=runs(), tides=numbers(0.05, 4.0))
def test_averaging_a_steadily_changing_wind_changes_nothing(run: Run, tides: float) -> None:
    wind = NaiveWind([-1, 2], run.wind.velocity[:2])
    run = still(run._replace(wind=wind))
    exact = drag_solution(run)
    window = tides * run.sea.period
    for order in (0, 1):
        found = follow(run, model="paper", order=order, window=window, wind_terms=False)
        assert largest_difference(found[["position", "velocity"]], exact) < 1e-8


class Twin(NamedTuple):
    """A scenario with its wind, and the sea's grid [x, y, time] and values to change."""

    tide: xr.DataArray
    perturbation: xr.DataArray
    wind: NaiveWind
    settings: dict[str, Any]


def twin() -> Twin:
    run = smoke_run()
    space, time = np.linspace(-1, 3, 6), np.linspace(0, 1, 5)
    tide, perturbation = run.sea.sample_on_grid(space, space, time)
    return Twin(
        amplitudes(tide, 1, space, time),
        amplitudes(perturbation / run.sea.period, 0, space, time),
        run.wind,
        {
            "epsilon": run.sea.period,
            "duration": run.times[-1],
            "drag": run.drag,
            "position": run.x,
            "velocity": run.v,
        },
    )


def follow_twin(twin: Twin, times: Floats, **kwargs: Any) -> xr.Dataset:
    case = dc.Scenario(
        sea=dc.HarmonicSea(twin.tide, twin.perturbation), coast=None, **twin.settings
    )
    return dc.trajectory(case, path_of(twin.wind), times=times, **{"rtol": 1e-11, **kwargs})


TIMES = np.linspace(0, 0.1, 9)


def turned(field: xr.DataArray) -> xr.DataArray:
    """A quarter turn to the left about the origin: (u, v)(x, y) becomes (-v, u)(-y, x)."""
    values = field.transpose("harmonic", "time", "x", "y", "component").to_numpy()
    east, north = values[..., 0], values[..., 1]
    moved = np.stack([-north, east], axis=-1).swapaxes(2, 3)[:, :, ::-1]
    coordinates = {
        "harmonic": field.harmonic,
        "time": field.time,
        "x": -field.y.to_numpy()[::-1],
        "y": field.x.to_numpy(),
        "component": ["x", "y"],
    }
    return xr.DataArray(moved, coordinates, ("harmonic", "time", "x", "y", "component"))


@pytest.mark.parametrize("kwargs", MODELS, ids=name)
def test_a_quarter_turn_turns_the_trajectory(kwargs: dict[str, Any]) -> None:
    here = twin()
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    there = Twin(
        turned(here.tide),
        turned(here.perturbation),
        NaiveWind(here.wind.knots, here.wind.velocity @ quarter.T),
        here.settings
        | {key: tuple(quarter @ here.settings[key]) for key in ("position", "velocity")},
    )
    expected = follow_twin(here, TIMES, **kwargs)
    for key, values in follow_twin(there, TIMES, **kwargs).items():
        assert np.allclose(values, expected[key].to_numpy() @ quarter.T, rtol=0, atol=1e-8)


@pytest.mark.parametrize("kwargs", MODELS, ids=name)
def test_the_origin_does_not_matter(kwargs: dict[str, Any]) -> None:
    here = twin()
    shift = np.array([0.7, -0.4])
    tide, perturbation = (
        field.assign_coords(x=field.x + shift[0], y=field.y + shift[1])
        for field in (here.tide, here.perturbation)
    )
    position = tuple(here.settings["position"] + shift)
    there = Twin(tide, perturbation, here.wind, here.settings | {"position": position})
    expected = follow_twin(here, TIMES, **kwargs)
    for key, values in follow_twin(there, TIMES, **kwargs).items():
        moved = shift if "position" in str(key) else 0
        assert np.allclose(values, expected[key] + moved, rtol=0, atol=1e-8)


@pytest.mark.parametrize("kwargs", MODELS, ids=name)
def test_any_consistent_units_will_do(kwargs: dict[str, Any]) -> None:
    """A unit of length three times smaller, and one of time four times smaller."""
    here, length, time = twin(), 3.0, 4.0
    speed = length / time

    def scaled(field: xr.DataArray, factor: float) -> xr.DataArray:
        axes = {"x": length * field.x, "y": length * field.y, "time": time * field.time}
        return field.assign_coords(axes) * factor

    there = Twin(
        scaled(here.tide, speed),
        scaled(here.perturbation, speed / time),  # εN is the current
        NaiveWind(time * here.wind.knots, speed * here.wind.velocity),
        {
            "epsilon": time * here.settings["epsilon"],
            "duration": time * here.settings["duration"],
            "drag": here.settings["drag"] / time,
            "position": tuple(length * np.array(here.settings["position"])),
            "velocity": tuple(speed * np.array(here.settings["velocity"])),
        },
    )
    expected = follow_twin(here, TIMES, **kwargs)
    for key, values in follow_twin(there, time * TIMES, **kwargs).items():
        factor = length if "position" in str(key) else speed
        assert np.allclose(values / factor, expected[key], rtol=0, atol=1e-8)


@pytest.mark.parametrize("kwargs", [*EXACT, *MEAN_FLOW], ids=name)
def test_a_run_may_be_taken_up_at_any_time(kwargs: dict[str, Any]) -> None:
    """From the position and velocity then, with the sea's phase and the wind of then."""
    here = twin()
    whole = follow_twin(here, TIMES, **kwargs)
    now, then = 3, TIMES[3]
    harmonic = here.tide.harmonic * 2j * np.pi * then / here.settings["epsilon"]
    mean = here.perturbation.harmonic * 2j * np.pi * then / here.settings["epsilon"]
    time = here.tide.time.to_numpy() - then
    settings = here.settings | {
        "duration": TIMES[-1] - then,
        "position": tuple(whole["position"].to_numpy()[now]),
        "velocity": tuple(whole["velocity"].to_numpy()[now]),
    }
    there = Twin(
        (here.tide * np.exp(harmonic)).assign_coords(time=time),
        (here.perturbation * np.exp(mean)).assign_coords(time=time),
        NaiveWind(here.wind.knots - then, here.wind.velocity),
        settings,
    )
    rest = follow_twin(there, (TIMES - then)[now:].clip(0, settings["duration"]), **kwargs)
    for key, values in rest.items():
        assert np.allclose(values, whole[key][now:], rtol=0, atol=1e-8)


# Output times and refusals


@pytest.mark.parametrize(
    "kwargs", [*MODELS, {"model": "paper", "order": 0, "euler_step": 0.003}], ids=name
)
def test_every_time_is_answered(kwargs: dict[str, Any]) -> None:
    """Also the last one, which the last step may miss by a rounding error."""
    rng = np.random.default_rng(0)
    wind = dc.WindPath([-5, 5], [[1, 1], [1, 1]])
    for epsilon in rng.uniform(0.01, 0.5, 200):
        duration = epsilon * rng.uniform(0.05, 4)
        case = dc.Scenario(epsilon=epsilon, duration=duration, coast=None)
        times = [0.0, duration / 2, duration]
        found = dc.trajectory(case, wind, times=times, rtol=1e-5, **kwargs)
        assert found["position"].shape == (3, 2)
        assert np.isfinite(found["position"]).all()


def test_times_may_repeat_or_be_one() -> None:
    case = dc.paper.scenario()
    found = dc.trajectory(case, CALM, model="full", times=[0.5, 0.5, 0.5])
    alone = dc.trajectory(case, CALM, model="full", times=0.5)
    assert (found["position"] == alone["position"].to_numpy()).all()


@pytest.mark.parametrize(
    ("kwargs", "start", "end"),
    [
        ({"model": "full"}, 0, 1),
        ({"model": "mean-flow"}, 0, 1),
        ({"model": "paper", "window": 0.04}, -0.04, 1.03),
        ({"model": "paper", "window": 0.04, "wind_terms": False}, -0.02, 1.02),
        ({"model": "paper"}, -0.025, 1.015),
    ],
    ids=str,
)
def test_the_wind_must_cover_the_run(kwargs: dict[str, Any], start: float, end: float) -> None:
    case = dc.paper.scenario(1 / 50)
    dc.trajectory(case, dc.WindPath([start, end], np.ones((2, 2))), times=[1], **kwargs)
    for knots in ([start + 1e-6, end], [start, end - 1e-6]):
        with pytest.raises(ScenarioError, match="wind"):
            dc.trajectory(case, dc.WindPath(knots, np.ones((2, 2))), times=[1], **kwargs)


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"model": "slow"}, "model: 'slow' is not accepted"),
        ({"model": "full", "order": 1}, "order: 1 is not accepted for model 'full'"),
        ({"model": "paper", "order": 2}, "order: 2 .* orders 0 or 1"),
        ({"model": "mean-flow", "order": 0}, "order: 0 .* orders 1 or 2"),
        ({"model": "mean-flow", "window": 0.1}, "window: model 'mean-flow' has none"),
        ({"model": "paper", "window": 0.0}, "window: 0.0 .* above 0"),
        ({"model": "paper", "window": np.nan}, "window: nan"),
        ({"model": "full", "formulation": "C"}, "formulation: 'C' is not accepted"),
        ({"model": "full", "rtol": 0.0}, "rtol: 0.0 .* above 0"),
        ({"model": "full", "atol": -1.0}, "atol: -1.0 .* above 0"),
        ({"model": "full", "times": [0.5, 0.4]}, "times: must increase"),
        ({"model": "full", "times": [0.5, 1.1]}, r"times: .* the run covers \[0, 1\]"),
        ({"model": "full", "times": [-0.1]}, "times: "),
        ({"model": "full", "times": []}, "times: "),
        ({"model": "full", "times": [np.nan]}, "times: .*finite"),
    ],
    ids=str,
)
def test_bad_arguments_are_refused(kwargs: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        dc.trajectory(dc.paper.scenario(), CALM, **{"times": [0.0, 1.0], **kwargs})
