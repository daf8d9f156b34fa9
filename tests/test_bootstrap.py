"""The compiled bootstrap draws from exactly the law that its catalogue defines."""

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

import driftcore as dc
from driftcore.climate import synthetic_record
from driftcore.record import Integer
from driftcore.wind import Mode
from reference import Floats, lgb_weights


class Case(NamedTuple):
    mode: Mode
    h: float
    order: int


# From bandwidths that leave a handful of rows to ones that weigh the whole record alike.
CASES = [
    Case("residual", 0.34, 2),
    Case("residual", 0.1, 1),
    Case("residual", 1.0, 3),
    Case("residual", 4.0, 1),
    Case("lgb", 0.12, 1),
    Case("lgb", 0.5, 2),
    Case("lgb", 2.0, 2),
]
B = 0.05


@lru_cache
def fitted(case: Case) -> dc.LocalGridBootstrap:
    """Three summers: 1,104 rows, of which a proposal table lists 256 one by one."""
    return dc.LocalGridBootstrap.fit(
        synthetic_record(years=3),
        mode=case.mode,
        h=case.h,
        b=B if case.mode == "lgb" else None,
        order=case.order,
    )


class Chains(NamedTuple):
    """Simulated chains, put together again from the rows drawn."""

    value: Floats  # (members, steps, 2) [m/s]
    drawn: Integer  # (members, steps) record rows; at step 0 the one before the start
    row: Integer  # (members, steps) the same in the catalogue; -1 where it is not there
    state: Floats  # (members, steps, 2p) at each value
    predicted: Floats  # (members, steps - 1, 2) the values after the first, but for the noise


def chains(wind: dc.LocalGridBootstrap, members: int, steps: int, seed: int) -> Chains:
    value, drawn = wind.sample(members, steps, seed, return_indices=True)
    place = np.full(len(wind.record), -1)
    place[wind.row] = np.arange(len(wind.row))
    start = place[drawn[:, 0] + 1]
    mean = wind.cycle[(wind.phase[start][:, None] + np.arange(steps)) % len(wind.cycle)]
    # Newest first in the catalogue; here the past goes before, in the order of time.
    past = wind.states[start].reshape(members, wind.order, 2)[:, :0:-1]
    anomaly = np.concatenate([past, value - mean], axis=1)
    lags = [anomaly[:, wind.order - 1 - lag :][:, :steps] for lag in range(wind.order)]
    state = np.concatenate(lags, axis=-1)
    row = place[drawn]
    c, a = wind.predictor[:, 0], wind.predictor[:, 1:]
    predicted = mean[:, 1:] + c + state[:, :-1] @ a.T + wind.target[row[:, 1:]]
    return Chains(value, drawn, row, state, predicted)


# The law of one draw


@pytest.mark.parametrize("case", CASES, ids=str)
def test_weights_by_definition(case: Case) -> None:
    wind = fitted(case)
    for state in (wind.states[300], wind.states[5:7].mean(axis=0), 3 * wind.states[700]):
        expected = lgb_weights(wind.states, wind.whitening, case.h, state)
        # Distances in single precision.
        assert np.allclose(wind.weights(state), expected, rtol=1e-3, atol=1e-6)
        assert wind.weights(state).sum() == pytest.approx(1, abs=1e-12)


def chi_square(counts: Integer, weights: Floats, least: float) -> float:
    """p-value of counts per row; rows with fewer than ``least`` expected are grouped by weight."""
    order = np.argsort(-weights)
    counts, expected = counts[order], weights[order] * counts.sum()
    heavy = expected >= least
    light = heavy.sum() + np.cumsum(np.where(heavy, 0, expected)) // least
    group = np.unique(np.where(heavy, np.arange(len(order)), light), return_inverse=True)[1]
    observed, expected = (np.bincount(group, weights=v) for v in (counts, expected))
    if expected[-1] < 8:  # what is left over joins the group before
        observed, expected = (np.append(v[:-2], v[-2:].sum()) for v in (observed, expected))
    return float(stats.chisquare(observed, expected).pvalue)


def p_values(counts: Integer, weights: Floats) -> tuple[float, float]:
    """For single rows, and for the shape of the kernel: ten groups by weight."""
    return chi_square(counts, weights, 8), chi_square(counts, weights, counts.sum() / 10)


def counts_at(
    wind: dc.LocalGridBootstrap, state: Floats, weigh_all: bool, draws: int, seed: int
) -> Integer:
    drawn = wind.core.draws_at(state, draws, seed, weigh_all)
    assert np.isin(drawn, wind.row).all()
    return np.bincount(np.searchsorted(wind.row, drawn), minlength=len(wind.row))


@lru_cache
def p_values_of(case: Case) -> Floats:
    """Draws at states as a chain meets them and in the record: by the leaves, by weighing all."""
    wind = fitted(case)
    chain = chains(wind, 1, 40, seed=12)
    probes = [
        *(chain.state[0, step] for step in (3, 5, 17, 28, 39)),
        wind.states[700],
        wind.states[0],
        0 * wind.states[0],
    ]
    found = []
    for seed, state in enumerate(probes):
        weights = lgb_weights(wind.states, wind.whitening, case.h, state)
        found.append(p_values(counts_at(wind, state, False, 20_000, 2 * seed), weights))
        found.append(p_values(counts_at(wind, state, True, 5_000, 2 * seed + 1), weights))
    return np.array(found)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_draws_follow_the_weights(case: Case) -> None:
    assert (p_values_of(case) > 0.001).all(), p_values_of(case)


def test_p_values_of_all_draws_are_uniform() -> None:
    """A law slightly wrong everywhere shows here, though it passes at each state."""
    for one_kind in np.concatenate([p_values_of(case) for case in CASES]).T:
        assert stats.kstest(one_kind, "uniform").pvalue > 0.001


@pytest.mark.parametrize("case", CASES[:3], ids=str)
def test_a_wrong_bandwidth_would_be_seen(case: Case) -> None:
    wind = fitted(case)
    state = wind.states[300]
    counts = counts_at(wind, state, False, 20_000, seed=1)
    for h in (0.97 * case.h, 1.03 * case.h):
        weights = lgb_weights(wind.states, wind.whitening, h, state)
        assert min(p_values(counts, weights)) < 0.001


def test_a_light_tail_would_be_seen() -> None:
    wind = fitted(CASES[-1])
    state = wind.states[300]
    counts = counts_at(wind, state, False, 20_000, seed=1)
    weights = lgb_weights(wind.states, wind.whitening, wind.h, state)
    weights[np.argsort(-weights)[256:]] *= 0.9
    assert min(p_values(counts, weights / weights.sum())) < 0.001


@pytest.mark.parametrize("mode", ["residual", "lgb"])
def test_chains_follow_the_weights(embedded_wind: dc.LocalGridBootstrap, mode: Mode) -> None:
    """Each draw of a chain, as its place in the distribution function of the weights."""
    wind = embedded_wind if mode == "residual" else fitted(Case("lgb", 0.5, 2))
    chain = chains(wind, 4, 300, seed=5)
    uniform = np.random.default_rng(5)
    by_row, by_distance = [], []
    for m, k in np.ndindex(chain.row[:, 1:].shape):
        weights = lgb_weights(wind.states, wind.whitening, wind.h, chain.state[m, k])
        drawn = chain.row[m, k + 1]
        share = uniform.random() * weights[drawn]
        by_row.append(weights[:drawn].sum() + share)
        by_distance.append(weights[weights > weights[drawn]].sum() + share)
    for places in (by_row, by_distance):
        assert stats.kstest(places, "uniform").pvalue > 0.001


# The chain


@pytest.mark.parametrize("case", [c for c in CASES if c.mode == "residual"], ids=str)
def test_values_are_prediction_plus_residual(case: Case) -> None:
    chain = chains(fitted(case), 5, 200, seed=1)
    assert np.allclose(chain.value[:, 1:], chain.predicted, rtol=0, atol=1e-11)


def test_values_without_noise_are_successors() -> None:
    wind = dc.LocalGridBootstrap.fit(synthetic_record(3), mode="lgb", h=0.5, b=0.0, order=3)
    chain = chains(wind, 5, 200, seed=1)
    assert np.allclose(chain.value[:, 1:], chain.predicted, rtol=0, atol=1e-12)


@pytest.mark.parametrize("case", [c for c in CASES if c.mode == "lgb"], ids=str)
def test_noise_is_a_share_of_the_anomalies(case: Case) -> None:
    wind = fitted(case)
    chain = chains(wind, 10, 300, seed=2)
    noise = chain.value[:, 1:] - chain.predicted
    anomaly = wind.record.velocity - wind.cycle[np.arange(len(wind.record)) % len(wind.cycle)]
    factor = B * np.linalg.cholesky(np.cov(anomaly.T))
    xi = np.linalg.solve(factor, noise.reshape(-1, 2).T)
    for component in xi:
        assert stats.kstest(component, "norm").pvalue > 0.001
    # 2,990 values: 4 standard errors, of the correlation with the other and with the last one.
    assert abs(np.corrcoef(xi)[0, 1]) < 0.075
    assert abs(np.corrcoef(xi[0, 1:], xi[0, :-1])[0, 1]) < 0.075


def test_the_start_is_a_row_of_the_record(embedded_wind: dc.LocalGridBootstrap) -> None:
    chain = chains(embedded_wind, 50, 1, seed=9)
    start = chain.drawn[:, 0] + 1
    expected = embedded_wind.record.velocity[start]
    assert np.allclose(chain.value[:, 0], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("phase", [None, 2])
def test_starts_are_uniform(phase: int | None) -> None:
    wind = fitted(CASES[0])
    _, drawn = wind.core.sample(30_000, 1, 4, phase=phase)
    counts = np.bincount(drawn[:, 0] + 1, minlength=len(wind.record))
    starts = wind.row[wind.start & ((wind.phase == phase) | (phase is None))]
    assert counts[starts].sum() == 30_000
    assert stats.chisquare(counts[starts]).pvalue > 0.001


def with_gaps(every: int) -> pd.DataFrame:
    """Four summers without each n-th row."""
    record = synthetic_record(years=4)
    return record.drop(record.index[::every])


@pytest.mark.parametrize("order", [1, 2, 3])
def test_segment_ends_have_no_successor(order: int) -> None:
    wind = dc.LocalGridBootstrap.fit(with_gaps(7), h=0.5, order=order, gaps="segment")
    segment = wind.record.segment
    assert segment[-1] > 200
    _, drawn = wind.sample(50, 200, 3, return_indices=True)
    assert (segment[drawn] == segment[drawn + 1]).all()
    # Nor does a state reach over the gap before it, or a simulation begin there.
    assert (segment[drawn[:, 1:] - (order - 1)] == segment[drawn[:, 1:]]).all()
    ends = np.flatnonzero(np.diff(segment, append=-1))
    assert not np.isin(drawn, ends).any()
    assert len(np.unique(drawn)) > 0.9 * len(wind.row)


def in_record(wind: dc.LocalGridBootstrap, values: Floats) -> NDArray[np.bool_]:
    """Whether each value (..., 2) is one of the record, but for rounding."""
    known = set(map(tuple, np.round(wind.record.velocity, 9)))
    pairs = np.round(values, 9).reshape(-1, 2)
    return np.array([tuple(pair) in known for pair in pairs]).reshape(values.shape[:-1])


def test_no_value_of_the_record_is_repeated(embedded_wind: dc.LocalGridBootstrap) -> None:
    """But for the start: residuals are standardised, so that even the very next row differs."""
    found = in_record(embedded_wind, chains(embedded_wind, 100, 368, seed=7).value)
    assert found[:, 0].all()
    assert not found[:, 1:].any()


def test_noise_leaves_no_value_of_the_record() -> None:
    wind = fitted(Case("lgb", 0.5, 2))
    assert not in_record(wind, chains(wind, 50, 200, seed=7).value[:, 1:]).any()


# Random streams


@given(cuts=st.sets(st.integers(1, 11)), seed=st.integers(0, 2**64 - 1), steps=st.integers(1, 30))
def test_members_and_prefixes_do_not_depend_on_the_rest(
    cuts: set[int], seed: int, steps: int
) -> None:
    core = fitted(CASES[1]).core
    values, rows = core.sample(12, 30, seed)
    for first, stop in pairwise([0, *sorted(cuts), 12]):
        part, part_rows = core.sample(stop - first, steps, seed, first_member=first)
        assert np.array_equal(part, values[first:stop, :steps])
        assert np.array_equal(part_rows, rows[first:stop, :steps])


def test_members_and_seeds_are_independent() -> None:
    core = fitted(CASES[0]).core
    runs = [core.sample(4_000, 3, seed)[0][:, -1, 0] for seed in (0, 1, 2**64 - 1)]
    pairs = [(runs[0], runs[1]), (runs[1], runs[2]), (runs[0][1:], runs[0][:-1])]
    for one, other in pairs:
        assert not np.isclose(one, other, rtol=0, atol=1e-9).mean() > 0.01
        assert abs(np.corrcoef(one, other)[0, 1]) < 4 / np.sqrt(4_000)
