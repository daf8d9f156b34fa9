"""Random numbers that belong to members: the same in whatever number and chunks they are drawn."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from driftcore.errors import ScenarioError

_WORD = 2**64
# Philox makes four 64-bit numbers of one count: Salmon, Moraes, Dror & Shaw 2011, "Parallel random
# numbers: as easy as 1, 2, 3".
_NUMBERS_PER_COUNT = 4


class Stream(IntEnum):
    """What numbers are drawn for; the streams of one seed are independent."""

    RELEASE = 1
    DRIFTER = 2


def member_uniforms(
    seed: int, first: int, count: int, per_member: int, stream: int
) -> NDArray[np.float64]:
    """Draw the uniform numbers of some members.

    Each member owns a stretch of the counter of a Philox generator whose key is the seed and the
    stream: its numbers depend on nothing else.

    Parameters
    ----------
    seed : int
        From 0 to 2⁶⁴ - 1.
    first, count : int
        The members `first` … `first + count - 1`, from 0 on.
    per_member : int
        Numbers that each member owns; a part of them may be used.
    stream : int
        What they are for: a `Stream`.

    Returns
    -------
    ndarray, shape (count, per_member)
        Multiples of 2⁻⁵² plus 2⁻⁵³: inside (0, 1), never 0 or 1, so that every quantile is finite.

    Raises
    ------
    ScenarioError
        A number is not one of those.
    """
    for name, value, least, most in (
        ("seed", seed, 0, _WORD - 1),
        ("first", first, 0, _WORD - 1),
        ("count", count, 0, _WORD - 1),
        ("per_member", per_member, 1, 2**16),
        ("stream", stream, 0, _WORD - 1),
    ):
        whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
        if not (whole and least <= value <= most):
            raise ScenarioError(
                f"{name}: {value!r} is not accepted; it should be an integer from {least} to {most}"
            )
    counts = -(-per_member // _NUMBERS_PER_COUNT)
    generator = np.random.Philox(
        key=np.array([seed, stream], dtype=np.uint64), counter=int(first) * counts
    )
    owned = counts * _NUMBERS_PER_COUNT
    raw = np.asarray(generator.random_raw(int(count) * owned), dtype=np.uint64)
    bits = raw.reshape(int(count), owned)[:, :per_member]
    return ((bits >> np.uint64(12)).astype(np.float64) + 0.5) * 2.0**-52
