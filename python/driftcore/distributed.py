"""Runs over many machines: workers of dask follow the chunks of a store, and it is written here."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING
from uuid import uuid4

from driftcore.errors import DriftCoreError
from driftcore.members import default_threads
from driftcore.store import Job, Part

if TYPE_CHECKING:
    from dask.distributed import Client

# Chunks that a worker holds: one that it follows, one that waits or is fetched meanwhile.
_AHEAD = 2
_WAIT_S = 60


@contextmanager
def connected(scheduler: str | None = None, workers: int | None = None) -> Iterator[Client]:
    """Give a client of the scheduler at an address, or of that many workers on this machine.

    Raises
    ------
    DriftCoreError
        No scheduler answers there, or dask is not installed.
    """
    need_distributed()
    from dask.distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=_WAIT_S)
        except (OSError, ValueError) as error:
            raise DriftCoreError(f"scheduler: none answers at {scheduler}: {error}") from None
        with client:
            yield client
        return
    number = workers or 1
    threads = max(1, default_threads() // number)
    cluster = LocalCluster(
        n_workers=number,
        threads_per_worker=threads,
        dashboard_address="127.0.0.1:0",
        silence_logs=logging.ERROR,
    )
    with cluster, Client(cluster) as client:
        yield client


def followed(
    client: Client, job: Job, todo: dict[int, tuple[int, int]]
) -> Iterator[tuple[int, Part]]:
    """Follow chunks on the workers of a client; give them as they are finished.

    What a worker held when it died is followed by another. Workers may come and go.

    Parameters
    ----------
    client : dask.distributed.Client
        Its workers have this version of driftcore, and the files that the job names.
    job : Job
        What is run.
    todo : dict of int to (int, int)
        First member and number of members by the number of the chunk.

    Raises
    ------
    DriftCoreError
        There are no workers, one cannot do the work, or the scheduler is gone.
    """
    from dask.distributed import CancelledError, KilledWorker, as_completed
    from distributed.comm.core import CommClosedError

    if not todo:
        return
    try:
        client.wait_for_workers(1, timeout=_WAIT_S)
    except TimeoutError:
        raise DriftCoreError(
            f"scheduler: it has had no workers for {_WAIT_S} s; start some by: dask worker ADDRESS"
        ) from None
    run, waiting = uuid4().hex, iter(todo.items())
    numbers: dict[str, int] = {}
    finished = as_completed(loop=client.loop)

    def submit() -> None:
        while len(numbers) < _AHEAD * max(1, len(client.nthreads())):
            try:
                number, (first, members) = next(waiting)
            except StopIteration:
                return
            key = f"driftcore-{run}-{number}"
            numbers[key] = number
            finished.add(client.submit(_follow, job, first, members, key=key))

    try:
        submit()
        for future in finished:
            part = future.result()
            number = numbers.pop(future.key)
            # The worker need not hold it any longer.
            future.release()
            submit()
            yield number, part
    except KilledWorker as error:
        raise DriftCoreError(f"workers: several died over the same members: {error}") from None
    except (CancelledError, CommClosedError, ModuleNotFoundError) as error:
        raise DriftCoreError(f"workers: they cannot go on: {error}") from None
    finally:
        finished.clear()


def _follow(job: Job, first: int, members: int) -> Part:
    """Follow some members on a worker, with all its threads."""
    from dask.distributed import get_worker

    return job.follow(first, members, get_worker().state.nthreads)


def need_distributed() -> None:
    """Refuse to go on where dask's workers are not installed.

    Raises
    ------
    DriftCoreError
        They are not; the message says what brings them.
    """
    from importlib.util import find_spec

    if find_spec("distributed") is None:
        raise DriftCoreError(
            "runs over many machines need dask, which is not installed: pip install "
            '"driftcore[distributed]"'
        )
