"""Fitting the bootstrap, the synthetic climate, and wind paths given by the user."""

import math
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

from driftcore import climate
from driftcore.errors import DriftCoreWarning, RecordError, ScenarioError
from driftcore.record import WindRecord, read_record
from driftcore.wind import LocalGridBootstrap, WindPath

Floats = NDArray[np.float64]


@pytest.fixture(scope="module")
def record() -> WindRecord:
    """Three short summers of the synthetic climate."""
    frame = climate.synthetic_record(years=3, seed=4)
    first_half = pd.DatetimeIndex(frame.index).day <= 16
    return read_record(frame[first_half], months=(6, 7, 8), gaps="segment")


@pytest.fixture(scope="module")
def residual(record: WindRecord) -> LocalGridBootstrap:
    return LocalGridBootstrap.fit(record)


@pytest.fixture(scope="module")
def lgb(record: WindRecord) -> LocalGridBootstrap:
    return LocalGridBootstrap.fit(record, mode="lgb")


def anomalies(fit: LocalGridBootstrap) -> Floats:
    """Record minus its mean day, by definition."""
    hour = fit.record.times.astype("datetime64[h]").astype(int) % 24
    anomaly = fit.record.velocity.copy()
    for h in np.unique(hour):
        anomaly[hour == h] -= anomaly[hour == h].mean(axis=0)
    return anomaly


# Catalogue


@pytest.mark.parametrize("order", [1, 2, 3])
def test_catalogue_rows_are_states_with_a_successor(record: WindRecord, order: int) -> None:
    fit = LocalGridBootstrap.fit(record, mode="lgb", order=order, h=0.1, b=0.05)
    anomaly = anomalies(fit)
    expected = [
        j
        for j in range(len(record))
        if j - order + 1 >= 0
        and j + 1 < len(record)
        and record.segment[j - order + 1] == record.segment[j + 1]
    ]
    assert fit.row.tolist() == expected
    for lag in range(order):
        assert np.allclose(fit.states[:, 2 * lag : 2 * lag + 2], anomaly[fit.row - lag])
    assert np.allclose(fit.target, anomaly[fit.row + 1])
    has_predecessor = [j > 0 and record.segment[j] == record.segment[j - 1] for j in expected]
    assert fit.start.tolist() == has_predecessor
    assert fit.start.all() == (order > 1)


def test_the_mean_day_is_removed(residual: LocalGridBootstrap) -> None:
    assert residual.cycle.shape == (4, 2)
    hour = residual.record.times.astype("datetime64[h]").astype(int) % 24
    assert np.array_equal(residual.phase, hour[residual.row] // 6)
    for phase in range(4):
        rows = hour == 6 * phase
        assert np.allclose(residual.cycle[phase], residual.record.velocity[rows].mean(axis=0))


def test_the_mean_day_of_a_record_that_starts_at_three_utc() -> None:
    frame = climate.synthetic_record(years=3)
    shifted = LocalGridBootstrap.fit(frame.shift(freq="3h"), h=0.3, gaps="segment")
    assert np.allclose(shifted.cycle, LocalGridBootstrap.fit(frame, h=0.3).cycle, atol=0.03)


def test_long_seasons_lose_an_annual_harmonic_too() -> None:
    times = pd.date_range("2001-01-01", "2004-12-31 18:00", freq="6h")
    day = np.minimum(times.day_of_year.to_numpy() - 1 + times.hour.to_numpy() / 24, 365.0)
    noise = np.random.default_rng(3).standard_normal((len(times), 2))
    season = 4 * np.cos(2 * np.pi * (day - 20) / 365)
    breeze = 1.5 * (times.hour.to_numpy() == 12)
    frame = pd.DataFrame({"u": season + noise[:, 0], "v": breeze + noise[:, 1]}, index=times)
    year = LocalGridBootstrap.fit(frame, months=None, h=0.3)
    assert year.cycle.shape == (365 * 4, 2)
    of_year = np.arange(365 * 4) / 4
    assert np.allclose(year.cycle[:, 0], 4 * np.cos(2 * np.pi * (of_year - 20) / 365), atol=0.15)
    assert np.allclose(year.cycle[2::4, 1] - year.cycle[::4, 1], 1.5, atol=0.15)
    # Six months from autumn on: the cycle runs through them in the order of the season.
    winter = LocalGridBootstrap.fit(frame, months=(10, 11, 12, 1, 2, 3), h=0.3)
    assert winter.cycle.shape == (182 * 4, 2)
    assert winter.cycle[:, 0].argmax() == pytest.approx((92 + 20) * 4, abs=40)
    first_of_october = winter.phase[np.isin(winter.row, np.flatnonzero(_is(winter, 10, 1)))]
    assert set(first_of_october) == {1, 2, 3}  # at 00 UTC there is no row before it yet


def _is(fit: LocalGridBootstrap, month: int, day: int) -> NDArray[np.bool_]:
    times = pd.DatetimeIndex(fit.record.times)
    return np.asarray((times.month == month) & (times.day == day))


def test_whitened_states_have_unit_covariance(residual: LocalGridBootstrap) -> None:
    whitened = residual.states @ residual.whitening.T
    assert np.allclose(np.cov(whitened.T), np.eye(4), atol=1e-10)


@pytest.mark.parametrize("h", [1e-3, 0.3, 5.0])
def test_residual_mode_keeps_what_least_squares_misses(record: WindRecord, h: float) -> None:
    residual = LocalGridBootstrap.fit(record, h=h)
    design = np.column_stack([np.ones(len(residual.states)), residual.states])
    successor = anomalies(residual)[residual.row + 1]
    expected, *_ = np.linalg.lstsq(design, successor, rcond=None)
    assert np.allclose(residual.predictor, expected.T)
    missed = successor - design @ expected
    # Shifted and scaled, all alike: with one row only per state not at all.
    affine = np.column_stack([np.ones(len(missed)), missed])
    fitted, *_ = np.linalg.lstsq(affine, residual.target, rcond=None)
    assert np.allclose(affine @ fitted, residual.target)
    assert np.allclose(residual.target, missed) == (h < 0.1)
    # What is drawn at the states of the record has mean zero and the covariance of all.
    z = residual.states @ residual.whitening.T
    drawn = np.zeros(len(z))
    for state in z:
        weight = np.exp(-((z - state) ** 2).sum(axis=1) / (2 * h**2))
        drawn += weight / weight.sum() / len(z)
    assert np.allclose(drawn @ residual.target, 0, atol=1e-5)
    covariance = (residual.target.T * drawn) @ residual.target
    assert np.allclose(covariance, missed.T @ missed / len(missed), rtol=1e-4)
    assert not residual.noise.any()
    assert residual.b is None


def test_lgb_mode_draws_successors_with_a_little_noise(lgb: LocalGridBootstrap) -> None:
    assert not lgb.predictor.any()
    assert lgb.b is not None
    assert np.allclose(lgb.noise @ lgb.noise.T, lgb.b**2 * np.cov(anomalies(lgb).T))


# Bandwidths


def naive_log_likelihood(fit: LocalGridBootstrap, h: float, b: float) -> float:
    """Leave-one-season-out log-likelihood, a row at a time."""
    successor = anomalies(fit)[fit.row + 1]
    season = fit.record.season[fit.row]
    z = fit.states @ fit.whitening.T
    design = np.column_stack([np.ones(len(z)), fit.states])
    total = 0.0
    for j in range(len(z)):
        kept = season != season[j]
        mean = np.zeros_like(successor)
        if fit.mode == "residual":
            fitted, *_ = np.linalg.lstsq(design[kept], successor[kept], rcond=None)
            mean = design @ fitted
        missed = successor - mean
        distance2 = ((z[kept] - z[j]) ** 2).sum(axis=1)
        weight = np.exp(-(distance2 - distance2.min()) / (2 * h**2))
        weight /= weight.sum()
        width2 = (weight**2).sum() ** (1 / 3) if fit.mode == "residual" else b**2
        covariance = width2 * np.cov(missed[kept].T)
        gap = missed[j] - missed[kept]
        exponent = -0.5 * np.einsum("ni,ij,nj->n", gap, np.linalg.inv(covariance), gap)
        largest = exponent.max()
        total += np.log((weight * np.exp(exponent - largest)).sum()) + largest
        total -= np.log(2 * np.pi * np.sqrt(np.linalg.det(covariance)))
    return total / len(z)


@pytest.mark.parametrize("mode", ["residual", "lgb"])
def test_likelihood_against_its_definition(mode: str, request: pytest.FixtureRequest) -> None:
    fit: LocalGridBootstrap = request.getfixturevalue(mode)
    for candidate in fit.likelihood[[8, -1]]:
        expected = naive_log_likelihood(fit, candidate["h"], candidate["b"])
        assert candidate["log_likelihood"] == pytest.approx(expected, abs=1e-3)


def test_lgb_bandwidths_respect_their_limits(lgb: LocalGridBootstrap) -> None:
    record, anomaly = lgb.record, anomalies(lgb)
    same = np.flatnonzero(np.diff(record.segment) == 0)
    seasons = np.unique(record.season)

    def correlation(rows: NDArray[np.int64]) -> Floats:
        now, after = anomaly[rows], anomaly[rows + 1]
        rho: Floats = 2 * (now * after).sum(axis=0) / (now**2 + after**2).sum(axis=0)
        return rho

    rho = correlation(same)
    without = np.array([correlation(same[record.season[same] != y]) for y in seasons])
    error = np.sqrt((len(seasons) - 1) / len(seasons) * ((without - without.mean(0)) ** 2).sum(0))
    tried = lgb.likelihood
    assert (tried["h"][:, None] ** 2 * rho <= error * (1 + 1e-9)).all()
    assert (tried["b"][:, None] ** 2 <= 0.02 * (1 - rho**2) * (1 + 1e-9)).all()
    best = tried[tried["log_likelihood"].argmax()]
    assert (lgb.h, lgb.b) == (best["h"], best["b"])


def test_residual_bandwidth_is_the_most_likely_below_its_limit(
    residual: LocalGridBootstrap,
) -> None:
    curve = residual.likelihood
    assert (np.diff(curve["h"]) > 0).all()
    assert curve["h"][0] < 0.11
    assert curve["h"][-1] > 1.5
    assert np.isnan(curve["b"]).all()
    allowed = curve[curve["h"] <= 0.5]
    assert residual.h == allowed["h"][allowed["log_likelihood"].argmax()]


def test_given_bandwidths_are_used_as_they_are(record: WindRecord) -> None:
    both = LocalGridBootstrap.fit(record, mode="lgb", h=0.7, b=0.0)
    assert (both.h, both.b, len(both.likelihood)) == (0.7, 0.0, 0)
    assert not both.noise.any()
    only_h = LocalGridBootstrap.fit(record, mode="lgb", h=0.2)
    assert only_h.h == 0.2
    assert set(only_h.likelihood["h"]) == {0.2}
    assert only_h.b in only_h.likelihood["b"]
    only_b = LocalGridBootstrap.fit(record, mode="lgb", b=0.03)
    assert only_b.b == 0.03
    assert only_b.h in only_b.likelihood["h"]


def test_long_records_are_scored_on_some_rows_of_every_hour() -> None:
    frame = climate.synthetic_record(years=60)
    fit = LocalGridBootstrap.fit(frame)
    every_row = LocalGridBootstrap.fit(frame[: 368 * 6])
    assert fit.likelihood["log_likelihood"].max() == pytest.approx(
        every_row.likelihood["log_likelihood"].max(), abs=0.15
    )


# Arguments


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("mode", "kernel"),
        ("order", 0),
        ("order", 9),
        ("order", 1.5),
        ("order", True),
        ("h", 0.0),
        ("h", -0.1),
        ("h", math.nan),
        ("h", "wide"),
        ("b", -0.01),
        ("b", math.inf),
        ("share", 1.0),
        ("share", -0.1),
        ("memory_h", 0.0),
    ],
)
def test_arguments_out_of_range(record: WindRecord, field: str, value: Any) -> None:
    settings: dict[str, Any] = {"mode": "lgb", "h": 0.1, field: value}
    with pytest.raises(ScenarioError, match=rf"^{field}: {value!r} is not accepted; use "):
        LocalGridBootstrap.fit(record, **settings)


def test_noise_belongs_to_lgb(record: WindRecord) -> None:
    with pytest.raises(ScenarioError, match=r"b: 0\.05 is given, but only mode 'lgb'"):
        LocalGridBootstrap.fit(record, b=0.05)
    with pytest.raises(ScenarioError, match="b: without noise there is no density"):
        LocalGridBootstrap.fit(record, mode="lgb", b=0.0)


def test_short_records() -> None:
    frame = climate.synthetic_record(years=2)
    with pytest.raises(RecordError, match=r"48 rows have 1 row\(s\) before .* at least 200"):
        LocalGridBootstrap.fit(frame[:50])
    with (
        pytest.warns(DriftCoreWarning, match=r"has 1 season\(s\)"),
        pytest.raises(RecordError, match="h: it is chosen by leaving out one season of at least 2"),
    ):
        LocalGridBootstrap.fit(frame[:368])
    with pytest.warns(DriftCoreWarning, match=r"has 1 season\(s\)"):
        assert LocalGridBootstrap.fit(frame[:368], h=0.3).h == 0.3
    with pytest.warns(DriftCoreWarning, match=r"has 2 season\(s\)"):
        assert LocalGridBootstrap.fit(frame).h <= 0.5


def test_winds_that_do_not_vary() -> None:
    frame = climate.synthetic_record(years=3)
    frame["v10"] = 2.0
    with pytest.raises(RecordError, match=r"states do not vary in every direction .*rank 2 in 4"):
        LocalGridBootstrap.fit(frame)


def test_a_missing_hour_of_the_day() -> None:
    frame = climate.synthetic_record(years=3)
    short_days = frame[pd.DatetimeIndex(frame.index).hour < 18]
    with pytest.raises(RecordError, match=r"no row from 18 to 24 h UTC of any day"):
        LocalGridBootstrap.fit(short_days, order=1, gaps="segment")


def test_months_of_a_record_already_cut(record: WindRecord) -> None:
    assert LocalGridBootstrap.fit(record, months=None, h=0.3).record is record
    july = LocalGridBootstrap.fit(climate.synthetic_record(years=4), months=(7,), h=0.3)
    assert july.record.months == (7,)
    with pytest.raises(RecordError, match=r"months: \(12,\) leaves no row"):
        LocalGridBootstrap.fit(record, months=(12,))


# What the fit tells


def test_standard_deviations(residual: LocalGridBootstrap) -> None:
    variance = residual.record.velocity.var(axis=0).mean()
    assert residual.standard_deviation == pytest.approx(math.sqrt(variance))
    small = residual.small_scale_sd
    assert small / math.hypot(small, residual.standard_deviation) == pytest.approx(residual.share)


@pytest.mark.parametrize(
    ("months", "days"),
    [((6, 7, 8), 92), ((2,), 28), ((1, 6, 7, 12), 62), ((12, 1, 2, 5), 90), (None, math.inf)],
)
def test_span_of_the_season(months: tuple[int, ...] | None, days: float) -> None:
    times = pd.date_range("2001-01-01", "2004-12-31 18:00", freq="6h")
    wind = np.random.default_rng(1).standard_normal((len(times), 2))
    frame = pd.DataFrame(wind, index=times, columns=["u", "v"])
    assert LocalGridBootstrap.fit(frame, months=months, h=0.3).span_days == days


@pytest.mark.parametrize("mode", ["residual", "lgb"])
def test_configuration_fits_the_same_again(tmp_path: Path, record: WindRecord, mode: Any) -> None:
    csv = tmp_path / "wind.csv"
    pd.DataFrame(record.velocity, pd.Index(record.times, name="time"), ["u10", "v10"]).to_csv(csv)
    fit = LocalGridBootstrap.fit(csv, mode=mode, order=1, gaps="segment", share=0.2, memory_h=5.0)
    known = fit.config()
    assert None not in known.values()
    assert known.pop("sha256") == record.sha256
    assert (known.pop("label"), known.pop("synthetic")) == ("wind.csv", False)
    again = LocalGridBootstrap.fit(known.pop("source"), **known)
    assert np.array_equal(again.states, fit.states)
    assert np.array_equal(again.target, fit.target)
    assert (again.h, again.b, again.small_scale_sd) == (fit.h, fit.b, fit.small_scale_sd)


def test_repr_names_record_and_choices(lgb: LocalGridBootstrap) -> None:
    text = repr(lgb)
    assert "synthetic climate" in text
    assert "mode='lgb'" in text
    assert f"b={lgb.b:.3g}" in text


# Sampling


def test_samples_have_a_shape_and_a_seed(residual: LocalGridBootstrap) -> None:
    values, indices = residual.sample(5, 30, seed=7, return_indices=True)
    assert values.shape == (5, 30, 2)
    assert indices.shape == (5, 30)
    assert indices.dtype == np.int64
    assert np.array_equal(residual.sample(5, 30, 7), values)
    assert np.array_equal(residual.sample(2, 10, 7), values[:2, :10])
    assert not np.array_equal(residual.sample(5, 30, 8), values)


@pytest.mark.parametrize("mode", ["residual", "lgb"])
def test_samples_follow_the_recursion(
    mode: str, record: WindRecord, request: pytest.FixtureRequest
) -> None:
    fit: LocalGridBootstrap = request.getfixturevalue(mode)
    values, drawn = fit.sample(20, 40, seed=3, return_indices=True)
    place = np.full(len(record), -1)
    place[fit.row] = np.arange(len(fit.row))
    hour = record.times.astype("datetime64[h]").astype(int) % 24 // 6
    phase = (hour[drawn[:, :1] + 1] + np.arange(40)) % 4
    anomaly = values - fit.cycle[phase]
    # A member begins at a row of the record, the one after the first index.
    assert np.allclose(values[:, 0], record.velocity[drawn[:, 0] + 1])
    assert (place[drawn[:, 1:]] >= 0).all()
    state = np.concatenate([anomaly[:, 1:-1], anomaly[:, :-2]], axis=2)
    predicted = (
        fit.predictor[:, 0] + state @ fit.predictor[:, 1:].T + fit.target[place[drawn[:, 2:]]]
    )
    missed = anomaly[:, 2:] - predicted
    if mode == "residual":
        assert np.allclose(missed, 0, atol=1e-12)
    else:
        noise = missed @ np.linalg.inv(fit.noise).T
        assert np.allclose(np.cov(noise.reshape(-1, 2).T), np.eye(2), atol=0.15)


@pytest.mark.parametrize(
    ("field", "value"),
    [("members", 0), ("members", 2.0), ("steps", 0), ("seed", -1), ("seed", 2**64), ("seed", None)],
)
def test_sampling_arguments_out_of_range(
    residual: LocalGridBootstrap, field: str, value: Any
) -> None:
    arguments: dict[str, Any] = {"members": 2, "steps": 3, "seed": 1, field: value}
    with pytest.raises(ScenarioError, match=rf"^{field}: {value!r} is not accepted; use a whole"):
        residual.sample(**arguments)


def test_a_fit_survives_pickling(residual: LocalGridBootstrap) -> None:
    expected = residual.sample(3, 20, 1)
    copy = pickle.loads(pickle.dumps(residual))  # noqa: S301 (made in this line)
    assert np.array_equal(copy.sample(3, 20, 1), expected)


def test_the_real_record(belle_ile_csv: Path) -> None:
    fit = LocalGridBootstrap.fit(belle_ile_csv)
    assert len(fit.row) == 6 * (368 - 2)
    assert fit.h == pytest.approx(0.476, abs=0.001)
    paper = LocalGridBootstrap.fit(belle_ile_csv, mode="lgb")
    assert 0.08 < paper.h < 0.15
    assert paper.b is not None
    assert 0.04 < paper.b < 0.09
    sea_breeze = fit.cycle[3] - fit.cycle[1]
    assert np.allclose(sea_breeze, [3.04, 0.26], atol=0.02)
    values = fit.sample(200, 368, seed=1)
    # Monte-Carlo errors of these ratios are about 1 %, of the means 0.05 and 0.03 m/s.
    ratio = values.std(axis=(0, 1)) / fit.record.velocity.std(axis=0)
    assert np.allclose(ratio, 1, atol=0.04)
    assert np.allclose(values.mean(axis=(0, 1)), fit.record.velocity.mean(axis=0), atol=0.15)


# Synthetic climate


def test_the_synthetic_climate_is_labelled() -> None:
    frame = climate.synthetic_record(years=2)
    record = read_record(frame, months=(6, 7, 8))
    assert record.synthetic
    assert record.label == "synthetic climate (VAR fitted to Belle-Île summers 1994–1999)"
    assert len(record) == 2 * 368
    assert np.array_equal(np.unique(record.season), [2001, 2002])


def test_the_synthetic_climate_is_the_same_everywhere() -> None:
    record = read_record(climate.synthetic_record(), months=(6, 7, 8))
    assert record.sha256 == "0e064d6958bb3bbaf7d3174e2ab43c445cb195043b9a18ee0f4ae86d44f061c0"
    other = read_record(climate.synthetic_record(seed=2), months=(6, 7, 8))
    assert other.sha256 != record.sha256


def test_the_autoregression_is_stable() -> None:
    companion = np.block([[climate.LAG_1, climate.LAG_2], [np.eye(2), np.zeros((2, 2))]])
    assert np.abs(np.linalg.eigvals(companion)).max() == pytest.approx(0.859, abs=0.001)
    assert (np.linalg.eigvalsh(climate.INNOVATION) > 0).all()


def test_the_synthetic_climate_resembles_its_source() -> None:
    wind = climate.synthetic_record().to_numpy().reshape(20, 368, 2)
    day = wind.reshape(20, 92, 4, 2).mean(axis=(0, 1))
    # Figures of the six real summers; two seeds in three stay within these bands.
    assert np.allclose(wind.mean(axis=(0, 1)), [2.004, -1.242], atol=0.01)
    assert np.allclose(day, climate.MEAN_DAY, atol=0.15)
    assert np.allclose(wind.std(axis=(0, 1)), [4.295, 3.229], atol=0.14)
    flat = wind.reshape(-1, 2)
    assert np.corrcoef(flat.T)[0, 1] == pytest.approx(0.337, abs=0.06)
    for lag, expected in ((1, (0.784, 0.769)), (4, (0.574, 0.486)), (12, (0.173, 0.209))):
        deviation = wind - flat.mean(axis=0)
        product = (deviation[:, lag:] * deviation[:, :-lag]).mean(axis=(0, 1))
        assert np.allclose(product / flat.var(axis=0), expected, atol=0.07)
    # Sectors the wind blows from, N to NW, percent: smoother than the real ones, by 6 % in all.
    sector = np.degrees(np.arctan2(-flat[:, 0], -flat[:, 1])) % 360
    rose = np.bincount(((sector + 22.5) // 45).astype(int) % 8, minlength=8) / len(flat) * 100
    real = [12.5, 17.7, 4.7, 2.6, 2.9, 12.0, 27.7, 19.9]
    assert np.abs(rose - real).sum() / 2 < 7


@pytest.mark.parametrize("settings", [{"years": 0}, {"years": 2.5}, {"seed": -1}, {"seed": 2**32}])
def test_synthetic_arguments_out_of_range(settings: dict[str, Any]) -> None:
    (field,) = settings
    with pytest.raises(ScenarioError, match=f"^{field}: .* is not accepted"):
        climate.synthetic_record(**settings)


# Wind paths


def test_paths_are_linear_between_knots() -> None:
    times = np.array([0.0, 0.1, 0.4, 1.0])
    velocity = np.array([[0.0, 1.0], [1.0, 1.0], [-2.0, 0.0], [0.0, 3.0]])
    path = WindPath(times, velocity)
    t = np.linspace(0, 1, 41).reshape(1, 41)
    expected = np.stack([np.interp(t, times, velocity[:, k]) for k in (0, 1)], axis=-1)
    assert np.allclose(path.at(t), expected, atol=1e-14)
    assert path.at(0.25).shape == (2,)
    whole = np.trapezoid(velocity, times, axis=0)
    assert np.allclose(path.integral(1.0), whole)
    assert np.allclose(path.mean(0.5, 1.0), whole)
    steps = np.diff(path.integral(t[0]), axis=0)
    assert np.allclose(path.mean(t[0, :-1] + 0.0125, 0.025), steps / 0.025)
    assert repr(path) == "WindPath(4 knots on [0, 1])"


def test_a_path_keeps_its_own_knots() -> None:
    velocity = np.ones((2, 2))
    path = WindPath([0, 1], velocity)
    velocity[:] = 5
    assert np.array_equal(path.velocity, np.ones((2, 2)))
    assert np.array_equal(path.at([0.0, 1.0]), np.ones((2, 2)))
    with pytest.raises(ValueError, match="read-only"):
        path.times[0] = 3


@pytest.mark.parametrize(
    ("times", "velocity", "message"),
    [
        ([0.0], [[1, 1]], r"times: shape \(1,\) is not accepted; give at least 2 knots"),
        ([[0.0, 1.0]], [[1, 1]], r"times: shape \(1, 2\)"),
        ([0, 1], [[1, 1]], r"velocity: shape \(1, 2\) is not accepted; 2 times need \(2, 2\)"),
        ([0, 1], [1, 1], r"velocity: shape \(2,\)"),
        ([0, math.nan], [[1, 1], [1, 1]], r"times: nan at \(1,\) is not accepted"),
        ([0, 1], [[1, 1], [1, math.inf]], r"velocity: inf at \(1, 1\) is not accepted"),
        ([0, 1, 1], [[1, 1]] * 3, r"times: knot 2 \(1\) does not come after knot 1 \(1\)"),
        (["a", "b"], [[1, 1]] * 2, "times: .*give an array of numbers"),
    ],
)
def test_paths_that_are_refused(times: Any, velocity: Any, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        WindPath(times, velocity)


def test_paths_are_not_continued_beyond_their_knots() -> None:
    path = WindPath([0.0, 1.0], np.ones((2, 2)))
    with pytest.raises(ScenarioError, match=r"t: 1\.5 is not covered .* known on \[0, 1\]"):
        path.at([0.5, 1.5])
    with pytest.raises(ScenarioError, match=r"t: -0\.5 is not covered"):
        path.integral(-0.5)
    with pytest.raises(ScenarioError, match=r"t: 0\.95 with 0\.1 on each side is not covered"):
        path.mean(0.95, 0.2)
    with pytest.raises(ScenarioError, match=r"window: 0\.0 is not accepted"):
        path.mean(0.5, 0.0)
    assert np.allclose(path.at(1.0 + 1e-12), 1)
