"""The small scale is exact in law, however coarsely it is sampled: docs/equations.md (22)-(24)."""

import dataclasses
from functools import lru_cache

import numpy as np
import pytest
from scipy import stats

import driftcore as dc
from driftcore.climate import synthetic_record
from driftcore.small_scale import (
    Moments,
    SmallScale,
    brute_force_cells,
    brute_force_strandings,
    coarse_strandings,
    member_cells,
)
from driftcore.statistics import kolmogorov_smirnov
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


LAWS = [SmallScale(0.1, 3.0), SmallScale(0.5, 20.0), SmallScale(0.3, 0.5, 12.42)]


@lru_cache
def cells(wind: dc.LocalGridBootstrap, law: SmallScale) -> Floats:
    return member_cells(wind, law, members=40, seed=8)


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_moments_are_those_of_the_path_step_by_step(
    wind: dc.LocalGridBootstrap, law: SmallScale
) -> None:
    found = Moments.of(cells(wind, law), 6)
    brute = Moments.of(brute_force_cells(law, 40_000, 6, seed=1), 6)
    assert (abs(found.z_scores(brute)) < 4).all()
    other = dataclasses.replace(law, memory_h=1.3 * law.memory_h)
    brute = Moments.of(brute_force_cells(other, 40_000, 6, seed=1), 6)
    assert abs(found.z_scores(brute)).max() > 4


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_brute_force_is_the_naive_path(law: SmallScale) -> None:
    """And its moments have the closed form, with standard errors that are right."""
    n = law.substeps(6)
    a = np.exp(-6 / n / law.memory_h)
    path = law.simulated(50, n, 6, seed=2)
    start, *normals = np.random.default_rng(2).standard_normal((n + 1, 50))
    expected = ar1_path(start, a, np.sqrt(1 - a**2), np.array(normals))
    assert np.allclose(path, expected, rtol=0, atol=1e-12)

    mean, covariance = ar1_moments(n, a, np.sqrt(1 - a**2), 6 / n)
    closed = np.concatenate([mean, covariance[np.triu_indices(2)]])
    z = []
    for seed in range(100):
        found = Moments.of(brute_force_cells(law, 1_000, 6, seed), 6)
        errors = [found.mean_error, found.covariance_error[np.triu_indices(2)]]
        z.append((found.listed() - closed) / np.concatenate(errors))
    # Four standard errors, of a mean and of a standard deviation.
    assert (abs(np.mean(z, axis=0)) < 0.4).all()
    assert (abs(np.std(z, axis=0) - 1) < 4 / np.sqrt(200)).all()


def innovations(cell: Floats, law: SmallScale, memory_h: float) -> Floats:
    """What is new in (value, integral) of each cell, normal if the memory is right: (cells, 2)."""
    n = law.substeps(6)
    step = 6 / n
    a = np.exp(-step / memory_h)
    mean, covariance = ar1_moments(n, a, np.sqrt(1 - a**2), step)
    found = np.stack([cell[:, -1], np.trapezoid(cell, dx=step, axis=1)])
    missed = found - mean[:, None] * cell[:, 0]
    return np.linalg.solve(np.linalg.cholesky(covariance), missed).T


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_values_and_integrals_have_the_closed_law(
    wind: dc.LocalGridBootstrap, law: SmallScale
) -> None:
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
def test_a_wrong_memory_would_be_seen(wind: dc.LocalGridBootstrap, law: SmallScale) -> None:
    for factor in (0.75, 1.3):
        new = innovations(cells(wind, law), law, factor * law.memory_h)
        deviation = abs(np.cov(new.T) - np.eye(2)).max()
        assert deviation > 4 * np.sqrt(2 / len(new))


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_the_path_inside_a_step_is_a_bridge(wind: dc.LocalGridBootstrap, law: SmallScale) -> None:
    """What was filled in later has the law given both ends and the integral."""
    cell = cells(wind, law)
    n = law.substeps(6)
    step = 6 / n
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


# What it does to the forecast: strandings under coarse members and under winds step by step

RIGHT, STRONG, FORGETFUL = SmallScale(0.1, 3.0), SmallScale(0.5, 60.0), SmallScale(0.5, 3.0)


@lru_cache
def strandings(wind: dc.LocalGridBootstrap, law: SmallScale, coarse: bool) -> Floats:
    return (coarse_strandings if coarse else brute_force_strandings)(wind, law, 2_000)


@pytest.mark.parametrize("law", [RIGHT, STRONG], ids=str)
def test_stranding_times_have_one_law(wind: dc.LocalGridBootstrap, law: SmallScale) -> None:
    coarse, brute = (strandings(wind, law, how) for how in (True, False))
    assert 0.3 < np.isfinite(coarse).mean() < 0.9
    assert kolmogorov_smirnov(coarse, brute) > 0.001


def test_stranding_times_of_another_memory_have_not(wind: dc.LocalGridBootstrap) -> None:
    brute = strandings(wind, STRONG, coarse=False)
    for law in (RIGHT, FORGETFUL):
        assert kolmogorov_smirnov(strandings(wind, law, coarse=True), brute) < 1e-6
