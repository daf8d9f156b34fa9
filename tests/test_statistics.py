"""Statistics that the package computes itself, against SciPy's."""

import numpy as np
import pytest
from scipy import stats

from driftcore.statistics import (
    chi_square,
    chi_square_p,
    kolmogorov_smirnov,
    quantile_interval,
    wilson,
)


@pytest.mark.parametrize("freedom", [1, 2, 3, 10, 600, 1401])
def test_tail_of_chi_square(freedom: int) -> None:
    for p in (0.999, 0.5, 0.01, 1e-9):
        statistic = stats.chi2.isf(p, freedom)
        assert chi_square_p(statistic, freedom) == pytest.approx(p, rel=1e-9)
    assert chi_square_p(0.0, freedom) == 1.0


def test_chi_square_of_many_expected() -> None:
    expected = np.array([20.0, 50.0, 8.0, 22.0])
    counts = np.array([25, 44, 9, 22])
    statistic, freedom = chi_square(counts, expected)
    assert statistic == pytest.approx(stats.chisquare(counts, expected).statistic)
    assert freedom == 3


def test_chi_square_counts_the_rare_together() -> None:
    # From the least on: 1 + 3 + 5 reach 8, then 30 alone.
    statistic, freedom = chi_square([4, 3, 27, 5], [3.0, 1.0, 30.0, 5.0])
    assert freedom == 1
    assert statistic == pytest.approx((12 - 9) ** 2 / 9 + (27 - 30) ** 2 / 30)
    # 4 + 4 reach 8; the last 4 are too few alone, and join them.
    assert chi_square([6, 3, 3], [4.0, 4.0, 4.0]) == (0.0, 0)


def test_chi_square_is_uniform_under_its_law() -> None:
    random = np.random.default_rng(1)
    weights = random.dirichlet(np.full(300, 0.3))
    p = [
        chi_square_p(*chi_square(counts, 2_000 * weights))
        for counts in random.multinomial(2_000, weights, size=500)
    ]
    assert stats.kstest(p, "uniform").pvalue > 0.001


def test_kolmogorov_smirnov() -> None:
    random = np.random.default_rng(2)
    one = random.normal(size=900)
    one[:100] = np.inf
    for shift in (0.0, 0.05, 0.1, 0.2):
        other = shift + random.normal(size=1_500)
        other[:150] = np.inf
        expected = stats.ks_2samp(one, other, method="exact").pvalue
        assert kolmogorov_smirnov(one, other) == pytest.approx(expected, rel=0.15)
    assert kolmogorov_smirnov(one, one) == 1.0
    assert kolmogorov_smirnov(one, one + 10) < 1e-9


@pytest.mark.parametrize("members", [5, 40, 300])
@pytest.mark.parametrize("quantile", [0.05, 0.5, 0.9])
def test_intervals_of_quantiles_cover_whatever_the_law(members: int, quantile: float) -> None:
    random = np.random.default_rng(members)
    held = 0
    for values in random.exponential(size=(2_000, members)):
        low, high = quantile_interval(values, [quantile])
        # What the sample cannot tell is no bound.
        held += not low[0] > stats.expon.ppf(quantile) and not high[0] < stats.expon.ppf(quantile)
    assert held / 2_000 > 0.935


def test_intervals_of_quantiles_are_values_of_the_sample() -> None:
    low, high = quantile_interval(np.arange(1.0, 101)[::-1], [0.0, 0.5, 1.0])
    # 50 -+ (1.96 * 5 + 0.5), the upper one up to the next rank.
    assert low.tolist() == pytest.approx([np.nan, 40, 100], nan_ok=True)
    assert high.tolist() == pytest.approx([1, 61, np.nan], nan_ok=True)
    assert np.isnan(quantile_interval([], [0.5])).all()


@pytest.mark.parametrize("p", [0.02, 0.3, 0.6])
@pytest.mark.parametrize("members", [1_000, 10_000])
def test_wilson_covers_as_often_as_it_says(p: float, members: int) -> None:
    """Exactly, over all counts."""
    counts = np.arange(members + 1)
    low, high = wilson(counts, members)
    held = stats.binom.pmf(counts, members, p)[(low <= p) & (p <= high)].sum()
    assert 0.94 < held < 0.96
