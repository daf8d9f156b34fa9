"""Hostile input made at random: each case is sane or refused by name, soon, in bounded memory.

    python fuzz/run.py toml --cases 100000 --seed 1
    python fuzz/run.py toml --seed 1 --only 4711      # one case again, with its traceback

A case depends on target, seed and number alone. It runs in a child process, so that an abort, a
hang or a memory hog is a finding like any other; what was fed is kept in the folder of findings.
"""

from __future__ import annotations

import argparse
import mmap
import os
import random
import re
import resource
import signal
import struct
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import Any, NamedTuple

# Threads of linear algebra wait for each other where many small processes share few processors.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from targets import TARGETS, Target

import driftcore as dc

# Of processor time [s], and by the clock where a case waits for what never comes.
SECONDS = 10
WAITING = 600
# Beyond what the interpreter has with all libraries loaded.
MEMORY = 2 * 1024**3
# What a check of driftcore's own would have named, where it is raised in driftcore itself.
ACCIDENTS = (IndexError, KeyError, AttributeError, UnboundLocalError, ZeroDivisionError)
# The child is made anew after so many cases: libraries keep what they have read.
GENERATION = 50_000


class Report(NamedTuple):
    """What a run of cases came to."""

    cases: int
    accepted: int
    seconds: float
    findings: dict[str, Path]

    def __str__(self) -> str:
        share = self.accepted / max(1, self.cases)
        rate = self.cases / self.seconds
        lines = [
            f"{self.cases} cases in {self.seconds:.1f} s ({rate:.0f}/s), {share:.1%} accepted, "
            f"{len(self.findings)} kinds of findings"
        ]
        return "\n".join([*lines, *(f"  {what}: {file}" for what, file in self.findings.items())])


def one(target: Target, seed: int, number: int) -> bool:
    """Run a case; say whether it was accepted rather than refused."""
    case = target.make(random.Random(f"{seed}/{number}"))
    try:
        target.run(case)
    except (dc.DriftCoreError, *target.refusals) as error:
        if not re.search(r"\w", str(error)):
            raise AssertionError(f"a refusal that names nothing: {error!r}") from error
        frames = traceback.extract_tb(error.__cause__.__traceback__) if error.__cause__ else []
        if (
            frames
            and isinstance(error.__cause__, ACCIDENTS)
            and "/driftcore/" in frames[-1].filename
        ):
            raise error.__cause__ from None
        return False
    return True


def _child(target: Target, seed: int, numbers: range, shared: mmap.mmap, folder: Path) -> None:
    """Run cases; `shared` holds the number at hand, how many are done and how many accepted."""
    with Path("/proc/self/statm").open() as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY,) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    # The default is to end the process, which the parent sees.
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    done, accepted = struct.unpack_from("qq", shared, 8)
    for number in numbers:
        struct.pack_into("qqq", shared, 0, number, done, accepted)
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        signal.setitimer(signal.ITIMER_REAL, WAITING)
        try:
            accepted += one(target, seed, number)
        except BaseException as error:  # a panic is no Exception
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{Path(place.filename).name}:{place.lineno}"
            _keep(target, seed, number, folder, f"{type(error).__name__} at {where}", error)
        done += 1
    struct.pack_into("qqq", shared, 0, numbers.stop, done, accepted)


def _keep(
    target: Target,
    seed: int,
    number: int,
    folder: Path,
    what: str,
    error: BaseException | None = None,
) -> None:
    """Keep the first finding of a kind: what was fed, and how to feed it again."""
    file = folder / (re.sub(r"\W+", "-", f"{target.name} {what}") + ".txt")
    if file.exists():
        return
    case: Any = target.make(random.Random(f"{seed}/{number}"))
    if isinstance(case, bytes):
        file.with_suffix(".bin").write_bytes(case)
    told = "" if error is None else "".join(traceback.format_exception(error))
    again = f"python fuzz/run.py {target.name} --seed {seed} --only {number}"
    file.write_text(f"{what}\n{again}\n\n{str(case)[:20_000]}\n\n{told}")


def run(
    name: str, cases: int, seed: int, folder: Path, *, first: int = 0, most: int = 30
) -> Report:
    """Run cases of a target, until there are `most` kinds of findings."""
    target = TARGETS[name]
    target.prepare()
    folder.mkdir(parents=True, exist_ok=True)
    shared = mmap.mmap(-1, 24)
    start, end = time.perf_counter(), first + cases

    def findings() -> dict[str, Path]:
        files = sorted(folder.glob(f"{name}-*.txt"))
        return {file.read_text().split("\n", 1)[0]: file for file in files}

    at = first
    while at < end and len(findings()) < most:
        sys.stdout.flush()
        pid = os.fork()
        if pid == 0:
            code = 1
            try:
                _child(target, seed, range(at, min(at + GENERATION, end)), shared, folder)
                code = 0
            finally:
                os._exit(code)
        _, status = os.waitpid(pid, 0)
        at, done, accepted = struct.unpack("qqq", shared)
        if os.WIFEXITED(status) and os.WEXITSTATUS(status):
            raise RuntimeError(f"{name}: case {at} of seed {seed} could not be made")
        if os.WIFSIGNALED(status):
            ended_by = signal.Signals(os.WTERMSIG(status))
            hangs = {
                signal.SIGPROF: f"worked over {SECONDS} s {at}",
                signal.SIGALRM: f"waited over {WAITING} s {at}",
            }
            what = hangs.get(ended_by, f"process ended by {ended_by.name}")
            _keep(target, seed, at, folder, what)
            at, done = at + 1, done + 1
            struct.pack_into("qqq", shared, 0, at, done, accepted)
    _, done, accepted = struct.unpack("qqq", shared)
    return Report(done, accepted, time.perf_counter() - start, findings())


def main() -> int:
    """Parse the command line; 1 if something was found."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("target", choices=[*TARGETS, "all"])
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, help="this case alone, in this process")
    parser.add_argument("--findings", type=Path, default=Path("fuzz-findings"))
    asked = parser.parse_args()
    names = list(TARGETS) if asked.target == "all" else [asked.target]
    if asked.only is not None:
        target = TARGETS[asked.target]
        target.prepare()
        print("accepted" if one(target, asked.seed, asked.only) else "refused")
        return 0
    found = 0
    for name in names:
        report = run(name, asked.cases, asked.seed, asked.findings)
        found += len(report.findings)
        print(f"{name}: {report}", flush=True)
    return min(found, 1)


if __name__ == "__main__":
    sys.exit(main())
