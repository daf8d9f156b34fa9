"""The small scale is exact in law, however coarsely it is sampled: docs/equations.md (22)-(24)."""

import dataclasses
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pytest
from scipy import stats

import driftcore as dc
from driftcore.climate import synthetic_record
from reference import Floats, ar1_bridge, ar1_joint, ar1_moments, ar1_path

CASES = [(1, 0.9), (2, 0.5), (8, 0.97), (48, np.exp(-7.5 / 60 / 3)), (49, 0.3), (288, 0.999)]


@pytest.fixture(scope="module")
def wind() -> dc.LocalGridBootstrap:
    """Few summers, which are soon prepared for each small scale anew."""
    return dc.LocalGridBootstrap.fit(synthetic_record(years=6), h=0.4)


@pytest.mark.parametrize(("n", "a"), CASES)
def test_closed_form_against_the_whole_path(n: int, a: float) -> None:
    """Mean and covariance of (value, integral), summed up or from the matrix of all steps."""
    sigma, step = 0.7, 0.3
    mean, covariance = ar1_moments(n, a, sigma, step)
    every_mean, every_covariance = ar1_joint(n, a, sigma, step)
    assert np.allclose(mean, every_mean[n - 1 :], rtol=1e-9)
    assert np.allclose(covariance, every_covariance[n - 1 :, n - 1 :], rtol=1e-7)


def test_closed_form_against_brute_force() -> None:
    n, a, sigma, step, paths = 12, 0.8, 0.7, 0.3, 40_000
    normals = np.random.default_rng(1).standard_normal((n, paths))
    path = ar1_path(np.full(paths, 2.0), a, sigma, normals)
    found = np.stack([path[-1], np.trapezoid(path, dx=step, axis=0)])
    mean, covariance = ar1_moments(n, a, sigma, step)
    # Four standard errors.
    assert np.allclose(found.mean(axis=1), 2 * mean, atol=4 * np.sqrt(covariance[1, 1] / paths))
    assert np.allclose(np.cov(found), covariance, rtol=4 * np.sqrt(2 / paths))


# The small scale of members


class Law(NamedTuple):
    """A small-scale wind."""

    share: float
    memory_h: float
    tide_period_h: float = 12.5

    @property
    def substeps(self) -> int:
        """Fine steps, of a hundredth of a tide at most, in six hours."""
        return int(np.ceil(600 / self.tide_period_h))


LAWS = [Law(0.1, 3.0), Law(0.5, 20.0), Law(0.3, 0.5, 12.42)]
MEMBERS = 40


@lru_cache
def small_scale(wind: dc.LocalGridBootstrap, law: Law) -> Floats:
    """Member paths less those without a small scale, its sd being 1: (members, steps + 1, 2)."""
    scenario = dc.paper.scenario(1 / 50, tide_period_h=law.tide_period_h)
    with_it = dataclasses.replace(wind, share=law.share, memory_h=law.memory_h)
    without = dataclasses.replace(wind, share=0.0)

    def velocity(wind: dc.LocalGridBootstrap) -> Floats:
        paths = [dc.member_path(scenario, wind, member, 8) for member in range(MEMBERS)]
        return np.array([path.velocity for path in paths]) * scenario.wind_unit

    return (velocity(with_it) - velocity(without)) / with_it.small_scale_sd


def cells(wind: dc.LocalGridBootstrap, law: Law) -> Floats:
    """The same, cut at the synoptic steps: (cells, substeps + 1), both ends included."""
    n = law.substeps
    path = np.moveaxis(small_scale(wind, law), 2, 1)
    count = (path.shape[2] - 1) // n
    windows = np.lib.stride_tricks.sliding_window_view(path, n + 1, axis=2)
    return windows[:, :, : count * n : n].reshape(-1, n + 1)


def innovations(cell: Floats, law: Law, memory_h: float) -> Floats:
    """What is new in (value, integral) of each cell, normal if the memory is right: (cells, 2)."""
    n, step = law.substeps, 6 / law.substeps
    a = np.exp(-step / memory_h)
    mean, covariance = ar1_moments(n, a, np.sqrt(1 - a**2), step)
    found = np.stack([cell[:, -1], np.trapezoid(cell, dx=step, axis=1)])
    missed = found - mean[:, None] * cell[:, 0]
    return np.linalg.solve(np.linalg.cholesky(covariance), missed).T


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_values_and_integrals_have_the_closed_law(wind: dc.LocalGridBootstrap, law: Law) -> None:
    cell = cells(wind, law)
    count = len(cell)
    assert count > 9_000
    new = innovations(cell, law, law.memory_h)
    for component in new.T:
        assert stats.kstest(component, "norm").pvalue > 0.001
    # Four standard errors; independent of each other, of the value before and of the last cell.
    assert np.allclose(np.cov(new.T), np.eye(2), atol=4 * np.sqrt(2 / count))
    assert abs(new.T @ cell[:, 0] / count).max() < 4 / np.sqrt(count)
    assert abs(new[1:].T @ new[:-1] / count).max() < 4 / np.sqrt(count)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_a_wrong_memory_would_be_seen(wind: dc.LocalGridBootstrap, law: Law) -> None:
    for factor in (0.75, 1.3):
        new = innovations(cells(wind, law), law, factor * law.memory_h)
        deviation = abs(np.cov(new.T) - np.eye(2)).max()
        assert deviation > 4 * np.sqrt(2 / len(new))


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_the_path_inside_a_step_is_a_bridge(wind: dc.LocalGridBootstrap, law: Law) -> None:
    """What was filled in later has the law given both ends and the integral."""
    cell = cells(wind, law)
    n, step = law.substeps, 6 / law.substeps
    a = np.exp(-step / law.memory_h)
    sigma = np.sqrt(1 - a**2)
    area = np.trapezoid(cell, dx=step, axis=1)
    # The mean is linear in the start, the end and the integral; the covariance is the same for all.
    one = [ar1_bridge(n, a, sigma, step, *unit) for unit in np.eye(3)]
    mean = np.stack([cell[:, 0], cell[:, -1], area], axis=1) @ [m for m, _ in one]
    missed = (cell[:, 1:-1] - mean)[:, [0, n // 4, n // 2, n - 2]]
    covariance = one[0][1][np.ix_(*[[0, n // 4, n // 2, n - 2]] * 2)]
    new = np.linalg.solve(np.linalg.cholesky(covariance), missed.T)
    assert np.allclose(np.cov(new), np.eye(4), atol=4.5 * np.sqrt(2 / len(cell)))
    for component in new:
        assert stats.kstest(component, "norm").pvalue > 0.001


# What it does to the forecast: strandings under coarse members and under winds made by hand

N = 2_000
RIGHT, STRONG = Law(0.1, 3.0), Law(0.5, 60.0)


def until_stranded(forecast: dc.Forecast) -> Floats:
    """Stranding times (members,), infinite if afloat."""
    return np.asarray(np.nan_to_num(forecast.dataset["stranding_time"].to_numpy(), nan=np.inf))


@lru_cache
def coarse_strandings(wind: dc.LocalGridBootstrap, law: Law) -> Floats:
    """Of the mean-flow model of order 1."""
    scenario = dc.paper.scenario(1 / 50)
    wind = dataclasses.replace(wind, share=law.share, memory_h=law.memory_h)
    forecast = dc.forecast(scenario, wind, members=N, model="mean-flow", order=1, seed=3, keep=0)
    return until_stranded(forecast)


@lru_cache
def brute_force_strandings(wind: dc.LocalGridBootstrap, law: Law) -> Floats:
    """Of the full model under other winds, their small scale simulated step by step."""
    scenario = dc.paper.scenario(1 / 50)
    random = np.random.default_rng(17)
    hours = scenario.duration * scenario.hours_per_unit
    steps, n = int(np.ceil(hours / 6)), law.substeps
    a = np.exp(-6 / n / law.memory_h)
    sd = law.share * wind.standard_deviation / np.sqrt(1 - law.share**2)
    place = np.arange(steps * n + 1) / n
    strandings = []
    for part in range(10):  # not all paths at once in memory
        slow = wind.sample(N // 10, steps + 1, seed=100 + part)
        start, *normals = random.standard_normal((steps * n + 1, N // 10, 2))
        small = ar1_path(sd * start, a, sd * np.sqrt(1 - a**2), np.array(normals))
        paths = []
        for member in range(N // 10):
            synoptic = [np.interp(place, np.arange(steps + 1), w) for w in slow[member].T]
            velocity = (np.transpose(synoptic) + small[:, member]) / scenario.wind_unit
            paths.append(dc.WindPath(place * 6 / scenario.hours_per_unit, velocity))
        forecast = dc.forecast(scenario, paths, model="full", keep=0)
        strandings.append(until_stranded(forecast))
    return np.concatenate(strandings)


@pytest.mark.parametrize("law", [RIGHT, STRONG], ids=str)
def test_stranding_times_have_one_law(wind: dc.LocalGridBootstrap, law: Law) -> None:
    coarse = coarse_strandings(wind, law)
    brute = brute_force_strandings(wind, law)
    assert 0.3 < np.isfinite(coarse).mean() < 0.9
    assert stats.ks_2samp(coarse, brute).pvalue > 0.001


def test_stranding_times_of_another_memory_have_not(wind: dc.LocalGridBootstrap) -> None:
    brute = brute_force_strandings(wind, STRONG)
    for law in (RIGHT, STRONG._replace(memory_h=3.0)):
        assert stats.ks_2samp(coarse_strandings(wind, law), brute).pvalue < 1e-6
