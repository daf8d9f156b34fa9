"""Members of an ensemble: which are followed, on how many threads, and what became of them."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from driftcore.dataset import STATUSES
from driftcore.errors import ScenarioError, told_by_the_core, warn
from driftcore.memory import require_room

Progress = Callable[[int, int], None]
Floats = NDArray[np.float64]

# Members between two reports of progress, at least: what is shared is prepared anew for each.
_LEAST_CHUNK = 1024
# As in rust/src/python.rs: more than any machine has processors.
_MOST_THREADS = 1024


class Fates(NamedTuple):
    """What became of the members, filled in by the core."""

    status: NDArray[np.int8]
    """Shape (members,), an index of `STATUSES`."""
    stranding_time: Floats
    """Shape (members,), NaN where not stranded."""
    stranding_position: Floats
    """Shape (members, 2)."""
    position: Floats
    """Shape (kept members, output times, 2), NaN where not adrift."""
    entry_time: Floats
    """Shape (members, targets), NaN where not entered."""

    @classmethod
    def empty(cls, members: int, keep: int, outputs: int, targets: int) -> Fates:
        """Of members not followed yet; what does not fit into memory is refused.

        Twice over, for a dataset is made of them.
        """
        require_room("members", members, 2 * (25 + 8 * targets), "members")
        require_room("keep", float(keep) * outputs, 2 * 16, "positions of members kept")
        return cls(
            np.zeros(members, dtype=np.int8),
            np.full(members, np.nan),
            np.full((members, 2), np.nan),
            np.full((keep, outputs, 2), np.nan),
            np.full((members, targets), np.nan),
        )

    def rows(self, rows: slice) -> Fates:
        """Those of some members, as views."""
        return Fates(
            self.status[rows],
            self.stranding_time[rows],
            self.stranding_position[rows],
            self.position[rows],
            self.entry_time[rows],
        )


def follow_in_chunks(
    fates: Fates,
    chunk: int,
    progress: Progress | None,
    follow: Callable[[slice, Fates], str | None],
) -> str | None:
    """Follow all members, some at a time; give the first failure.

    Parameters
    ----------
    fates : Fates
        Filled in.
    chunk : int
        Members at a time.
    progress : callable, optional
        Called with (members done, members) after each chunk.
    follow : callable
        Follows the members of a slice into their part of the fates; gives the first failure.

    Raises
    ------
    ScenarioError
        The core refuses an argument.
    DriftCoreError
        What all members share cannot be worked out.
    """
    members, failure = len(fates.status), None
    for first in range(0, members, chunk):
        rows = slice(first, min(first + chunk, members))
        with told_by_the_core():
            failed = follow(rows, fates.rows(rows))
        failure = failure or failed
        if progress is not None:
            progress(rows.stop, members)
    return failure


def checked_count(field: str, value: Any, least: int = 1) -> int:
    """Refuse what is not a whole number from `least` up."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ScenarioError(f"{field}: {value!r} is not accepted; a whole number from {least} up")
    return int(value)


def members_of(members: int | str | None, first_member: int, paths: int | None = None) -> int:
    """Check a range of members, of as many as there are paths where the wind is given by them."""
    first = checked_count("first_member", first_member, least=0)
    if paths is None:
        return 1000 if members is None else checked_count("members", members)
    if first >= paths:
        raise ScenarioError(f"first_member: {first} is not accepted; {paths} paths were given")
    members = paths - first if members is None else checked_count("members", members)
    if first + members > paths:
        after = f"; {first} come before" if first else ""
        raise ScenarioError(f"members: {members} is not accepted; {paths} paths were given{after}")
    return members


def chunk_of(members: int, chunk: int | None = None) -> int:
    """Give the number of members followed between two reports: a hundredth of all, or as asked."""
    return max(_LEAST_CHUNK, members // 100) if chunk is None else checked_count("chunk", chunk)


def kept_of(first_member: int, members: int, keep: int) -> int:
    """Give the number of members in a range whose index is below `keep`."""
    return min(max(keep - first_member, 0), members)


def checked_threads(threads: int | None) -> int:
    """Give the number of threads, all processors if it is left open."""
    number = default_threads() if threads is None else checked_count("threads", threads)
    if number > _MOST_THREADS:
        raise ScenarioError(f"threads: {number} is not accepted; at most {_MOST_THREADS}")
    return number


def default_threads() -> int:
    """Give the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def warn_of_failures(status: NDArray[np.int8], first: str | None, first_member: int = 0) -> None:
    """Warn of members that could not be followed, with the first failure."""
    failed = np.flatnonzero(status == STATUSES.index("failed"))
    if len(failed):
        warn(
            f"{len(failed)} of {len(status)} members failed; member "
            f"{first_member + failed[0]}: {first}"
        )
