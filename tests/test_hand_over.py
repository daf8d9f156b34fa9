"""From a forecast to the climate: the law at all leads, who gets what, and what is refused."""

import pickle
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import driftcore as dc
from driftcore import _core
from driftcore.climate import synthetic_record
from driftcore.grids import VectorGrid
from driftcore.record import mean_cycle, phase_of_day
from driftcore.verification import crps, score_ratio

Floats = np.ndarray[Any, np.dtype[np.float64]]

START = np.datetime64("2026-07-01T00:00:00", "s")
STEP = np.timedelta64(6, "h")
# Sampled moments of this many independent members are compared at 4.5 standard errors.
MEMBERS = 4000


@lru_cache
def climate(share: float = 0.1, order: int = 2) -> dc.LocalGridBootstrap:
    return dc.LocalGridBootstrap.fit(synthetic_record(years=8), h=0.4, share=share, order=order)


@lru_cache
def anomalies() -> Floats:
    record = climate().record
    phase, cycle = mean_cycle(record)
    return np.asarray(record.velocity - cycle[phase])


def mean_day(steps: int, first: int = 0) -> Floats:
    """The climate's mean from `START` on."""
    phase = phase_of_day(climate().record, START)
    return climate().cycle[(phase + first + np.arange(steps)) % len(climate().cycle)]


def drawn(members: int, steps: int, seed: int) -> Floats:
    """Winds of the climate alone, from `START` on."""
    phase = phase_of_day(climate().record, START)
    return climate().core.sample(members, steps, seed, phase=phase)[0]


def table(wind: Floats, start: np.datetime64 = START, step: np.timedelta64 = STEP) -> pd.DataFrame:
    times = pd.DatetimeIndex(start + np.arange(len(wind)) * step, name="time")
    return pd.DataFrame({"u10": wind[:, 0], "v10": wind[:, 1]}, index=times)


def gale(days: float = 5.0, **options: Any) -> pd.DataFrame:
    """A strong forecast, far from the climate's mean, that turns."""
    turn = 0.15 * np.arange(round(days * 4) + 1)
    return table(np.column_stack([9 * np.cos(turn), 8 * np.sin(turn)]), **options)


def scenario(days: float = 10.0, **changes: Any) -> dc.GeographicScenario:
    values: dict[str, Any] = {
        "release": dc.Release.point(-4.1, 47.5, "2026-07-01T09:00"),
        "days": days,
        "drifter": dc.FloatingBody(response_time_h=1.0, wind_factor=0.03),
        **changes,
    }
    return dc.GeographicScenario(**values)


# The law


def test_certain_forecast_is_followed_to_its_horizon() -> None:
    forecast = gale()
    over = dc.HandOver(forecast, climate(), skill=1)
    times, wind = over.sample(50, len(forecast) + 20, seed=1)
    np.testing.assert_array_equal(times[: len(forecast)], forecast.index.to_numpy())
    expected = np.broadcast_to(forecast.to_numpy(), (50, *forecast.shape))
    np.testing.assert_allclose(wind[:, : len(forecast)], expected, rtol=0, atol=1e-13)
    spread = wind.std(axis=0)
    assert (spread[len(forecast)] > 0.5).all()
    assert (spread[-1] > 2).all()


def test_bootstrap_goes_on_from_the_last_states() -> None:
    """The first value after the horizon is the predictor's, and a residual drawn by the weights."""
    over, bootstrap = dc.HandOver(gale(), climate(), skill=1), climate()
    steps = len(over.times)
    _, wind = over.sample(MEMBERS, steps + 1, seed=2)
    last = (wind - mean_day(steps + 1))[:, [steps - 1, steps - 2]].reshape(MEMBERS, 4)
    predicted = bootstrap.predictor[:, 0] + last @ bootstrap.predictor[:, 1:].T
    made = wind[:, steps] - mean_day(1, steps) - predicted
    known = bootstrap.target
    assert np.abs(made[:, None] - known[None]).max(axis=2).min(axis=1).max() < 1e-9
    share = bootstrap.weights(last[0])
    mean = share @ known
    error = np.sqrt(share @ (known - mean) ** 2 / MEMBERS)
    assert (np.abs(made.mean(axis=0) - mean) < 4.5 * error).all()


def test_useless_forecast_is_the_climate_at_all_leads() -> None:
    over = dc.HandOver(gale(), climate(), skill=0)
    steps = len(over.times) + 30
    _, wind = over.sample(MEMBERS, steps, seed=3)
    x = wind - mean_day(steps)
    x0 = anomalies()
    sd = x0.std(axis=0)
    pairs = np.flatnonzero(np.diff(climate().record.segment) == 0)
    lagged = (x0[pairs] * x0[pairs + 1]).mean(axis=0) / sd**2
    handed = slice(0, len(over.times))
    # Given over, the law is exact; the bootstrap's own variance and mean are those of the record
    # within 5 % and 0.1 sd (its own tests say how well).
    error = 4.5 / np.sqrt(MEMBERS)
    assert np.abs(x[:, handed].mean(axis=0) / sd).max() < error
    assert np.abs(x[:, handed].std(axis=0) / sd - 1).max() < error / np.sqrt(2)
    assert np.abs(x.mean(axis=0) / sd).max() < error + 0.1
    assert np.abs(x.std(axis=0) / sd - 1).max() < error / np.sqrt(2) + 0.05
    correlation = (x[:, 1:] * x[:, :-1]).mean(axis=0) / (
        x[:, 1:].std(axis=0) * x[:, :-1].std(axis=0)
    )
    assert np.abs(correlation - lagged).max() < error * (1 - lagged.min() ** 2) + 0.02
    crossed = (x[..., 0] * x[..., 1]).mean(axis=0) / sd.prod()
    assert np.abs(crossed[handed] - np.corrcoef(x0.T)[0, 1]).max() < error


def test_mean_and_errors_by_lead() -> None:
    """Mean c + r (F - c), covariance (1 - r²) Σ, with the forecast's own lead in r."""
    forecast = gale(8)
    issued = START - np.timedelta64(12, "h")
    over = dc.HandOver(forecast, climate(), skill={"half_life_h": 120}, issued=issued)
    steps = len(forecast)
    r = 2.0 ** -(((12 + 6 * np.arange(steps)) / 120) ** 2)
    np.testing.assert_allclose(over.correlation(over.times), r, rtol=1e-14)
    _, wind = over.sample(MEMBERS, steps, seed=4)
    c, covariance = mean_day(steps), np.cov(anomalies().T)
    sd = np.sqrt((1 - r**2)[:, None] * np.diag(covariance))
    mean = c + r[:, None] * (forecast.to_numpy() - c)
    assert (np.abs(wind.mean(axis=0) - mean) < 4.5 * sd / np.sqrt(MEMBERS)).all()
    assert (np.abs(wind.std(axis=0) / sd - 1) < 4.5 / np.sqrt(2 * MEMBERS)).all()


@pytest.mark.parametrize(("step_h", "order"), [(6, 1), (3, 3)])
def test_mean_follows_the_season_across_the_year(step_h: int, order: int) -> None:
    """A climate of all months, and a forecast that knows nothing, from 29 December on."""
    times = pd.date_range("2001-01-01", "2003-12-31T23:00", freq=f"{step_h}h")
    noise = np.random.default_rng(1).normal(size=(len(times), 2)) * [2, 3]
    angle = 2 * np.pi * (times.day_of_year.to_numpy() + times.hour.to_numpy() / 24 - 1) / 365.25
    season = np.column_stack([3 + 4 * np.cos(angle), -5 * np.sin(angle)])
    record = pd.DataFrame(season + noise, columns=["u10", "v10"], index=times.rename("time"))
    year = dc.LocalGridBootstrap.fit(record, months=None, h=0.5, order=order)
    start = np.datetime64("2026-12-29T15:00", "s")
    over = dc.HandOver(gale(8, start=start), year, skill=0)
    when, wind = over.sample(MEMBERS, 8 * 24 // step_h - 3, seed=1)
    assert when[0] == np.datetime64("2026-12-29T15:00" if step_h == 3 else "2026-12-29T18:00")
    days = (when - np.datetime64("2026-01-01", "s")) / np.timedelta64(1, "D")
    expected = np.column_stack(
        [3 + 4 * np.cos(2 * np.pi * days / 365), -5 * np.sin(2 * np.pi * days / 365)]
    )
    # The mean day of three years of white noise is known to 0.09; 4,000 members' mean to 0.05.
    assert np.abs(wind.mean(axis=0) - expected).max() < 0.5
    sd = wind.std(axis=0)
    np.testing.assert_allclose(sd, np.broadcast_to([2, 3], sd.shape), rtol=0.08)


def test_law_does_not_jump_at_the_horizon() -> None:
    """Of forecasts with the climate's law, W keeps that law, also where r of 0.5 is left."""
    forecasts = drawn(2 * MEMBERS, 21, seed=5)
    skill = {"lead_h": [0, 120], "r": [1, 0.5]}
    over = dc.HandOver([table(wind) for wind in forecasts], climate(), skill=skill)
    steps = 21 + 20
    _, wind = over.sample(16 * MEMBERS, steps, seed=6)
    x = wind - mean_day(steps)
    spread = x.std(axis=0) / anomalies().std(axis=0)
    assert np.abs(spread - 1).max() < 0.08
    correlation = (x[:, 1:] * x[:, :-1]).mean(axis=0) / (
        x[:, 1:].std(axis=0) * x[:, :-1].std(axis=0)
    )
    # Twice the standard error of a difference of neighbours, and no step at 20 → 21.
    assert np.abs(np.diff(spread, axis=0)).max() < 0.025
    assert np.abs(np.diff(correlation, axis=0)).max() < 0.03
    assert np.abs(correlation - correlation.mean(axis=0)).max() < 0.03


@lru_cache
def winds(cases: int, members: int, half_life_h: float = 120.0) -> tuple[Floats, Floats, Floats]:
    """What came, and members handed over and of the climate; horizon 10 of 20 days."""
    steps, handed = 81, 41
    truth, other = drawn(cases, steps, seed=7), drawn(cases, steps, seed=8)
    r = 2.0 ** -((6 * np.arange(handed) / half_life_h) ** 2)[:, None]
    mean = mean_day(handed)
    # Correlation r with the truth, and the climate's variance.
    pseudo = mean + r * (truth[:, :handed] - mean) + np.sqrt(1 - r**2) * (other[:, :handed] - mean)
    skill = {"half_life_h": half_life_h}
    over = dc.HandOver([table(wind) for wind in pseudo], climate(), skill=skill)
    _, wind = over.sample(cases * members, steps, seed=9)
    climatic = drawn(cases * members, steps, seed=10)
    found, known = (w.reshape(members, cases, steps, 2) for w in (wind, climatic))
    return truth, found, known


def test_handed_over_wind_beats_the_climate_and_becomes_it() -> None:
    truth, found, known = winds(cases=300, members=40)
    scores = (crps(members, truth).mean(axis=2) for members in (found, known))
    share = score_ratio(*scores, np.arange(300))
    ratio = share["ratio"].to_numpy()
    assert ratio[0] < 1e-9  # r = 1
    # With Gaussian errors the CRPS goes as the sd: √(1 - r²) of the climate's.
    leads = np.array([24, 48, 72, 96, 120])
    expected = np.sqrt(1 - 4.0 ** -((leads / 120) ** 2))
    np.testing.assert_allclose(ratio[leads // 6], expected, rtol=0.1)
    assert share["high"].to_numpy()[:21].max() < 1  # by pairs
    assert abs(ratio[-24:].mean() - 1) < 0.01
    assert share["low"].to_numpy()[-24:].min() < 1 < share["high"].to_numpy()[-24:].max()


def test_drift_under_handed_over_wind_beats_the_climates() -> None:
    """A position remembers the wind of the first days, so the climate's is never as good."""
    truth, found, known = winds(cases=300, members=40)
    scenario = dc.paper.scenario(coast=None).replace(duration=480 / 625)
    days = np.array([1, 3, 5, 10, 20])

    def ends(wind: Floats) -> Floats:
        paths = dc.WindPaths(np.arange(81) * 6 / 625, wind.reshape(-1, 81, 2) / 3)
        run = dc.forecast(scenario, paths, keep=len(paths), times=days * 24 / 625)
        return run.dataset["position"].to_numpy().reshape(*wind.shape[:-2], len(days), 2)

    came = ends(truth)
    scores = (crps(ends(members), came).mean(axis=2) for members in (found, known))
    share = score_ratio(*scores, np.arange(300))
    assert (share["high"] < 1).all()
    assert (np.diff(share["ratio"]) > 0).all()
    assert share["high"][0] < 0.1


# Members, models, threads


def test_forecasts_are_dealt_in_turn() -> None:
    forecasts = drawn(3, 13, seed=11)
    over = dc.HandOver([table(wind) for wind in forecasts], climate())
    _, wind = over.sample(7, 13, seed=1)
    # An ensemble is reliable unless skill says something else.
    np.testing.assert_allclose(wind, forecasts[np.arange(7) % 3], atol=1e-13)


def test_drift_is_the_forecasts_until_the_horizon() -> None:
    forecast = gale(4)
    over = dc.HandOver(forecast, climate(share=0.0), skill=1)
    path = dc.WindPath(
        np.concatenate([START + np.arange(-8, 0) * STEP, forecast.index.to_numpy()]),
        np.concatenate([np.tile(forecast.to_numpy()[0], (8, 1)), forecast.to_numpy()]),
    )
    run = scenario(days=3)
    for model in ("full", "mean-flow"):
        found = dc.forecast(run, over, members=3, model=model, rtol=1e-9)  # type: ignore[arg-type]
        alone = dc.forecast(run, [path] * 3, model=model, rtol=1e-9)  # type: ignore[arg-type]
        for name in ("longitude", "latitude"):
            np.testing.assert_allclose(found.dataset[name], alone.dataset[name], atol=1e-7)
    assert "followed from 2026-07-01T00:00:00Z" in found.dataset.attrs["wind_forecast"]


def test_members_do_not_depend_on_threads_chunks_or_their_number() -> None:
    over = dc.HandOver([gale(), gale() * 0.5, gale() * -1.0], climate(), {"half_life_h": 72})
    runs = [
        dc.forecast(scenario(), over, members=members, threads=threads, chunk=chunk, seed=3)
        for members, threads, chunk in ((40, 1, 1000), (40, 2, 7), (23, 2, 16))
    ]
    for run in runs[1:]:
        for name in ("longitude", "latitude"):
            found = run.dataset[name].values
            np.testing.assert_array_equal(found, runs[0].dataset[name].values[: len(found)])
    assert runs[0].dataset["longitude"].values[:, -1].std() > 0.01


def test_one_member_is_one_wind() -> None:
    """The fine path meets the synoptic wind at its knots; both come from (seed, member) alone."""
    bootstrap = climate(share=0.0)
    over = dc.HandOver(gale(), bootstrap, {"half_life_h": 72})
    phase = phase_of_day(bootstrap.record, START)
    core = over.core(START, 3)
    before = bootstrap.phase_before(phase, 3)
    generator = _core.WindGenerator(bootstrap.core, 0.25, 1.0, 0.0, 0.1, 5, 3, before, core)
    wind, rows = bootstrap.core.sample(4, 40, 5, phase=before, hand_over=core)
    for member in range(4):
        times, path = generator.path(5, member, 9.0)
        np.testing.assert_allclose(path[::5], wind[member], atol=1e-12)
        assert times[0] == -0.75
    handed = 3 + len(over.times)
    assert (rows[:, :handed] == -1).all()
    assert (rows[:, handed:] >= 0).all()


def test_models_get_one_wind() -> None:
    """A slow body under a weak sea: full model and mean flow go to one place, member by member."""
    over = dc.HandOver(gale(), climate(), {"half_life_h": 72})
    body = dc.FloatingBody(response_time_h=0.0, wind_factor=0.03)
    ends = [
        dc.forecast(scenario(8, drifter=body), over, members=8, model=model, seed=2).dataset
        for model in ("full", "mean-flow")
    ]
    for name in ("longitude", "latitude"):
        full, mean = (end[name].values[:, -1] for end in ends)
        assert np.abs(full - mean).max() < 0.02 * full.std()


def test_forecast_before_its_first_time_persists() -> None:
    late = gale(start=np.datetime64("2026-07-01T07:00", "s"), step=np.timedelta64(3, "h"))
    over = dc.HandOver(late, climate(), skill=1)
    bootstrap = climate()
    phase = bootstrap.phase_before(phase_of_day(bootstrap.record, START), 2)
    wind, _ = bootstrap.core.sample(1, 5, 1, phase=phase, hand_over=over.core(START, 2))
    u = late["u10"].to_numpy()
    expected = [u[0]] * 4 + [u[1] + (u[2] - u[1]) * 2 / 3]  # 12 h before, … , midday
    np.testing.assert_allclose(wind[0, :, 0], expected, atol=1e-13)


def test_pickles() -> None:
    over = dc.HandOver(gale(), climate())
    again = pickle.loads(pickle.dumps(over))  # noqa: S301 (made above)
    np.testing.assert_array_equal(over.sample(2, 40, 1)[1], again.sample(2, 40, 1)[1])
    assert repr(over) == repr(again)


# Reading


def test_forms_of_a_forecast(tmp_path: Path) -> None:
    first, second = gale(), gale() * 0.5
    both = np.stack([first.to_numpy(), second.to_numpy()])
    long = pd.concat([first.assign(number=0), second.assign(number=1)])
    long.to_csv(tmp_path / "ensemble.csv")
    datasets = [xr.Dataset.from_dataframe(part) for part in (first, second)]
    ensemble = xr.concat(datasets, "member")
    for forecast in ([first, second], long, tmp_path / "ensemble.csv", ensemble):
        over = dc.HandOver(forecast, climate())  # type: ignore[arg-type]
        np.testing.assert_allclose(over.velocity, both)
        np.testing.assert_array_equal(over.times, first.index.to_numpy())
    zoned = first.tz_localize("UTC").tz_convert("Europe/Paris")
    over = dc.HandOver(zoned, climate())
    np.testing.assert_array_equal(over.times, first.index.to_numpy())
    assert over.correlation(over.times[0] + np.timedelta64(168, "h")) == pytest.approx(0.5)


def test_point_of_a_grid() -> None:
    times = (START + np.arange(9) * STEP).astype("datetime64[ns]")
    longitude, latitude = np.array([-6.0, -5.0, -4.0]), np.array([46.0, 47.0])
    u = np.arange(9)[:, None, None] + 0.5 * longitude + 2 * latitude[:, None]
    grid = VectorGrid(times, longitude, latitude, u - 90, 90 - u, "made", "wind")
    over = dc.HandOver(grid, climate(), at=(355.7, 46.25))
    expected = np.arange(9) + 0.5 * -4.3 + 2 * 46.25 - 90
    np.testing.assert_allclose(over.velocity[0], np.column_stack([expected, -expected]))
    with pytest.raises(dc.ScenarioError, match=r"at: longitude -3 .* -6 to -4"):
        dc.HandOver(grid, climate(), at=(-3, 46.25))
    with pytest.raises(dc.ScenarioError, match="give at="):
        dc.HandOver(grid, climate())


def test_steps_may_change_and_are_resampled() -> None:
    hourly = gale(10, step=np.timedelta64(1, "h"))
    kept = hourly.index[(np.arange(len(hourly)) < 20) | (np.arange(len(hourly)) % 3 == 0)]
    over = dc.HandOver(hourly.loc[kept], climate(), skill=1)
    _, wind = over.sample(1, 5, seed=1)
    np.testing.assert_allclose(wind[0], hourly.to_numpy()[[0, 6, 12, 18, 24]], atol=1e-13)


# Refused


def _shifted(hours: int) -> list[pd.DataFrame]:
    return [gale(), gale(start=START + np.timedelta64(hours, "h"))]


@pytest.mark.parametrize(
    ("forecast", "options", "message"),
    [
        (gale(), {"climatology": "climate"}, "climatology: str is not accepted"),
        (gale(), {"skill": 1.2}, "skill: 1.2 is not accepted; numbers from 0 to 1"),
        (gale(), {"skill": float("nan")}, "skill: nan is not accepted"),
        (gale(), {"skill": "good"}, "skill: 'good' is not accepted; a number"),
        (gale(), {"skill": {"half_life_h": 0}}, "half_life_h: 0 is not accepted"),
        (gale(), {"skill": {"lead_h": [0, 120], "r": [0.5, 0.6]}}, "0.6 after 0.5 .* not increase"),
        (gale(), {"skill": {"lead_h": [0, 120], "r": [1, -0.1]}}, "-0.1 is not accepted"),
        (gale(), {"skill": {"lead_h": [0, 96], "r": [1, 0.6]}}, "its last lead, 96 h"),
        (gale(), {"skill": {"lead_h": [6, 0], "r": [1, 1]}}, "lead_h must increase"),
        (gale(), {"skill": {"lead_h": ["a"], "r": [1]}}, "skill.lead_h: must be"),
        (gale(), {"horizon_h": 200}, "horizon_h: 200 .* ends 120 h after"),
        (gale(), {"horizon_h": 6}, "order 2 needs at least 12 h"),
        (gale(0.25), {}, "order 2 needs at least 12 h"),
        (gale(), {"issued": "2026-07-02"}, "issued: .* begins before"),
        (gale(), {"issued": "soon"}, "issued: 'soon' is not accepted"),
        (gale(step=np.timedelta64(12, "h")), {}, "a step of 12 h is not accepted; at most 6 h"),
        (gale(step=np.timedelta64(7, "h")), {}, "forecast: time: the step is 7 h"),
        (gale().reset_index(drop=True), {}, "forecast: time: the index .* holds numbers"),
        (gale().rename(columns={"u10": "east"}), {}, "forecast: columns: found 'east', 'v10'"),
        (_shifted(6), {}, "forecast: number 1 is for 21 times from 2026-07-01T06"),
        ([], {}, "forecast: the list is empty"),
        (12, {}, "forecast: source: int is not accepted"),
    ],
)
def test_refused(forecast: Any, options: dict[str, Any], message: str) -> None:
    arguments = {"climatology": climate(), **options}
    with pytest.raises((dc.ScenarioError, dc.RecordError), match=message):
        dc.HandOver(forecast, **arguments)


@pytest.mark.parametrize("release", ["2026-06-30T23:00", "2026-07-06T01:00"])
def test_forecast_must_cover_the_release(release: str) -> None:
    run = scenario(release=dc.Release.point(-4.1, 47.5, release))
    with pytest.raises(dc.ScenarioError, match=f"the release at {release}.* must lie between"):
        dc.forecast(run, dc.HandOver(gale(), climate()), members=2)


def test_other_scenarios_refuse_it() -> None:
    over: Any = dc.HandOver(gale(), climate())
    with pytest.raises(dc.ScenarioError, match="wind: HandOver is not accepted"):
        dc.forecast(dc.paper.scenario(), over, members=2)


def test_core_refuses_what_does_not_fit() -> None:
    bootstrap, unit = climate(), [[1.0, 0.0], [0.0, 1.0]]

    def over(values: Floats, spread: Floats) -> _core.HandOver:
        return _core.HandOver(values, spread, unit, unit, unit)

    with pytest.raises(ValueError, match="forecasts: shape"):
        over(np.zeros((2, 3, 2)), np.zeros(4))
    with pytest.raises(ValueError, match="must be finite"):
        over(np.full((1, 3, 2), np.nan), np.zeros(3))
    short = over(np.zeros((1, 1, 2)), np.zeros(1))
    with pytest.raises(ValueError, match="forecast steps: 1"):
        bootstrap.core.sample(1, 3, 1, phase=0, hand_over=short)
    fitting = over(np.zeros((1, 3, 2)), np.zeros(3))
    for phase in (None, 99):
        with pytest.raises(ValueError, match="start phase"):
            bootstrap.core.sample(1, 3, 1, phase=phase, hand_over=fitting)
