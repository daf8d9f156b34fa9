"""Draws of members: their law, and that they depend on the seed, the stream and the member only."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import driftcore as dc
from driftcore.draws import Stream, member_uniforms

seeds = st.integers(0, 2**64 - 1)


@given(seeds, st.integers(0, 2**60), st.integers(0, 40), st.integers(0, 40), st.integers(1, 9))
def test_chunks_join_to_the_same_bits(
    seed: int, first: int, left: int, right: int, per_member: int
) -> None:
    whole = member_uniforms(seed, first, left + right, per_member, Stream.RELEASE)
    parts = [
        member_uniforms(seed, first, left, per_member, Stream.RELEASE),
        member_uniforms(seed, first + left, right, per_member, Stream.RELEASE),
    ]
    assert whole.shape == (left + right, per_member)
    np.testing.assert_array_equal(whole, np.concatenate(parts))


def test_a_member_owns_numbers_of_the_advanced_generator() -> None:
    generator = np.random.Philox(key=np.array([7, Stream.DRIFTER], dtype=np.uint64))
    generator.advance(3 * 2)  # three members, of two counts each
    raw = generator.random_raw(5).astype(np.uint64)
    drawn = member_uniforms(7, 3, 1, 5, Stream.DRIFTER)[0]
    # 52 bits of each, to half their spacing.
    np.testing.assert_allclose(drawn, raw / 2.0**64, rtol=0, atol=2.0**-52)


def test_numbers_are_uniform_and_independent() -> None:
    draws = member_uniforms(1, 0, 20_000, 3, Stream.RELEASE)
    other = member_uniforms(1, 0, 20_000, 3, Stream.DRIFTER)
    # Fixed seed; a true generator would fail one of seven such tests once in 140.
    for column in draws.T:
        assert stats.kstest(column, "uniform").pvalue > 1e-3
    correlations = np.corrcoef(np.hstack([draws, other]), rowvar=False)[np.triu_indices(6, 1)]
    # Four standard deviations of 1/√n, for 15 pairs.
    assert np.abs(correlations).max() < 4 / np.sqrt(len(draws))
    assert draws.min() > 0
    assert draws.max() < 1


def test_seeds_and_streams_differ() -> None:
    drawn = [member_uniforms(seed, 0, 4, 4, stream) for seed in (1, 2) for stream in Stream]
    assert len(np.unique(np.concatenate(drawn))) == 4 * 16


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seed": -1}, "seed: -1 is not accepted; it should be an integer from 0 to 184467440737"),
        ({"seed": 2**64}, "seed: 18446744073709551616 is not"),
        ({"first": 1.0}, "first: 1.0 is not accepted"),
        ({"count": True}, "count: True is not accepted"),
        ({"per_member": 0}, "per_member: 0 is not accepted; it should be an integer from 1 to"),
        ({"stream": -2}, "stream: -2 is not accepted"),
    ],
)
def test_what_is_no_member_is_refused(changes: dict[str, int], message: str) -> None:
    arguments = {"seed": 1, "first": 0, "count": 1, "per_member": 1, "stream": 1}
    with pytest.raises(dc.ScenarioError, match=message):
        member_uniforms(**{**arguments, **changes})
