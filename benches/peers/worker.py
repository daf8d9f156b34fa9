"""One peer in a process of its own: builds a job, runs it, and says what the run alone cost.

Started by `run.py` in the peer's environment as `worker.py MODULE PEER FOLDER`; it reads requests,
`{"members": 64, "setting": 1e-6, "repeats": 2}`, and answers each with one line of JSON.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import sys
import time
from typing import Any

# One core and one thread for everybody; set before any library starts its pool.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ[name] = "1"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def answer(peer: Any, members: int, setting: Any, repeats: int) -> dict[str, Any]:
    """Run the job asked for and give its mean time, its preparation left out."""
    job = peer(members, setting)
    wall, cpu = time.perf_counter(), time.process_time()
    for _ in range(repeats):
        positions, evaluations = job()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # of kilobytes, on Linux
    return {
        "cpu": cpu / repeats,
        "wall": wall / repeats,
        "positions": positions,
        "evaluations": evaluations,
        "peak_megabytes": peak,
    }


def main() -> None:
    """Serve requests until standard input ends."""
    module, name, folder = sys.argv[1:]
    # Libraries print what they like: to the log, not between the answers.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    peer = importlib.import_module(module).PEERS[name](folder)
    start = time.process_time()  # what importing and setting up cost
    for line in sys.stdin:
        print(
            json.dumps(answer(peer, **json.loads(line)) | {"start": start}),
            file=answers,
            flush=True,
        )


if __name__ == "__main__":
    main()
