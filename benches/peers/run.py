"""Compare driftcore with its peers, in one run, on the machine at hand: see README.md.

    python benches/peers/run.py [--quick] [--only NAME ...] [-o results.json]

Makes the environments it needs outside the repository, then starts every contender in a process
of its own on one core. First each is tuned; then all are timed in turn, A B C A B C, so that what
slows the machine for a while slows all of them. Ratios are of median CPU times.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import platform
import shutil
import subprocess
import sys
import venv
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parents[1]

# Installed one by one, so that one that fails leaves the others.
ENVIRONMENTS = {
    "solvers": (str(CHECKOUT), "scipy", "numba", "jax", "diffrax"),
    "parcels": ("parcels>=4,<5",),
    "opendrift": ("opendrift",),
}
LIBRARIES = {
    "odeint": ("g++", "-O3", "-march=native", "-shared", "-fPIC", "odeint.cpp"),
    "rust-lanes": (
        *("rustc", "--edition=2024", "-O", "-Ctarget-cpu=native", "--crate-type=cdylib"),
        "rk4_lanes.rs",
    ),
}
TOLERANCES = tuple(10.0 ** (-k / 2) for k in range(12, 25))
TARGET = 1e-6  # matched error in position
RUN_DAYS = 12.5 * 50 / 24
STEPS_A_DAY = 96


@dataclass(frozen=True)
class Effort:
    """How long to measure."""

    members: int  # winds at hand
    few: int  # of them for the slowest solver
    rounds: int
    seconds: float  # CPU time of one timed call, where enough members are at hand
    steps: int
    particles: tuple[int, ...]


FULL = Effort(8192, 8, 7, 1.0, 100, (1000, 10_000))
QUICK = Effort(4096, 2, 3, 0.2, 20, (1000,))
BATCH = 64  # least number of members of a call: what vectors, lanes and lockstep need
BATCHED = ("jax", "diffrax")  # their cost depends on it


class UnavailableError(Exception):
    """A contender that cannot be installed, built or run; says why."""


@dataclass
class Entry:
    """One row of a table: what a contender does at one setting, and its times."""

    peer: str
    label: str
    members: int
    setting: Any
    note: str
    answer: dict[str, Any]
    repeats: int = 1
    rounds: list[dict[str, float]] = field(default_factory=list)

    def micros(self, clock: str = "cpu") -> list[float]:
        """Time of each round [µs] per member."""
        return [1e6 * times[clock] / self.members for times in self.rounds]


class Worker:
    """A contender's process."""

    def __init__(self, python: Path, module: str, peer: str, folder: Path) -> None:
        self.log = folder / f"{module}-{peer}.log"
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                [python, HERE / "worker.py", module, peer, folder],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                cwd=folder,
            )

    def ask(self, **request: Any) -> dict[str, Any]:
        """Have a job done."""
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # if it has ended, its log says why
            print(json.dumps(request), file=self.process.stdin, flush=True)
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise UnavailableError(reason(self.log.read_text()))
        return dict(json.loads(line))

    def stop(self) -> None:
        """End the process."""
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()
        self.process.wait()


class Contest:
    """Who takes part: workers by name, and why the others do not."""

    def __init__(self, pythons: dict[str, Path], folder: Path, only: list[str] | None) -> None:
        self.pythons, self.folder, self.only = pythons, folder, only
        self.workers: dict[tuple[str, str], Worker] = {}
        self.absent: dict[str, str] = {}

    def takes_part(self, peer: str) -> bool:
        """Whether the contender was asked for and has not failed."""
        asked = self.only is None or peer in self.only or peer.startswith("driftcore")
        return asked and peer not in self.absent

    def ask(
        self, module: str, peer: str, members: int, setting: Any, repeats: int = 1
    ) -> dict[str, Any]:
        """Have a job done, by a new worker if there is none."""
        key = module, peer
        if key not in self.workers:
            environment = peer if peer in self.pythons else "solvers"
            self.workers[key] = Worker(self.pythons[environment], module, peer, self.folder)
        return self.workers[key].ask(members=members, setting=setting, repeats=repeats)

    def stop(self) -> None:
        """End all processes."""
        for worker in self.workers.values():
            worker.stop()
        self.workers.clear()


def say(text: str) -> None:
    """Tell what is going on."""
    print(text, file=sys.stderr, flush=True)


def reason(text: str) -> str:
    """Give the last line that tells of an error, or that says anything."""
    lines = [line.strip() for line in text.splitlines() if line.strip()] or ["no reason given"]
    return next((line for line in reversed(lines) if "error:" in line.lower()), lines[-1])


def install(folder: Path, pythons: dict[str, Path]) -> dict[str, str]:
    """Make the environments; give what could not be installed."""
    failed = {}
    cargo = os.environ | {"CARGO_TARGET_DIR": str(folder / "target")}
    for name, requirements in ENVIRONMENTS.items():
        if not pythons[name].exists():
            venv.create(folder / name, with_pip=True)
        for requirement in requirements:
            say(f"installing {requirement}")
            command = [pythons[name], "-m", "pip", "install", "-q", requirement]
            done = subprocess.run(command, env=cargo, capture_output=True, text=True)
            if done.returncode:
                package = "driftcore" if requirement == str(CHECKOUT) else requirement
                failed[package.split(">")[0]] = reason(done.stderr)
    return failed


def build(folder: Path) -> dict[str, str]:
    """Compile the two libraries; give what could not be."""
    failed = {}
    for peer, (compiler, *options) in LIBRARIES.items():
        if shutil.which(compiler) is None:
            failed[peer] = f"{compiler} is not installed"
            continue
        command = [compiler, *options, "-o", folder / f"{peer}.so"]
        done = subprocess.run(command, cwd=HERE, capture_output=True, text=True)
        if done.returncode:
            errors = [line for line in done.stderr.splitlines() if "error" in line]
            failed[peer] = errors[0] if errors else reason(done.stderr)
    return failed


def full_system(contest: Contest, effort: Effort, reference: list[list[float]]) -> list[Entry]:
    """Tune every solver of the paper's full system; give what is to be timed."""
    tolerances = [(setting, f"rtol {setting:.1e}") for setting in TOLERANCES]
    steps = [(n, f"{n} steps a tide") for n in (4, 5, 6, 8, 10, 12, 16, 20, 25, 32, 40, 50)]
    knots = [(0, "steps on the knots")]
    contenders = (
        ("driftcore-fixed", "driftcore, fixed steps", steps),
        ("driftcore", "driftcore, adaptive", tolerances),
        ("driftcore-drawn", "driftcore, fixed steps, winds drawn too", steps),
        ("rust-lanes", "Rust, 16 lanes, RK4, 4-D form", knots),
        ("jax", "JAX scan, RK4, 4-D form", knots),
        ("odeint", "Boost odeint runge_kutta4, 4-D form", knots),
        ("odeint", "Boost odeint dopri5, 4-D form", tolerances),
        ("numba", "numba Dormand–Prince, 4-D form", tolerances),
        ("diffrax", "diffrax Dopri5 stepping to the knots, 4-D form", knots),
        ("diffrax", "diffrax Dopri5, 4-D form", tolerances),
        ("scipy", "SciPy RK45, 4-D form", tolerances),
    )
    entries = []
    for peer, label, settings in contenders:
        if not contest.takes_part(peer):
            continue
        say(f"tuning {label}")
        try:
            entries += tuned(contest, effort, reference, peer, label, settings)
        except UnavailableError as error:
            contest.absent[peer] = str(error)
    return entries


def tuned(
    contest: Contest,
    effort: Effort,
    reference: list[list[float]],
    peer: str,
    label: str,
    settings: list[tuple[Any, str]],
) -> Iterator[Entry]:
    """Give a solver at the customary tolerance, and at the first setting to reach the target."""
    least = effort.few if peer == "scipy" else BATCH

    def solved(members: int, setting: Any) -> dict[str, Any]:
        answer = contest.ask("solvers", peer, members, setting)
        misses = zip(answer.pop("positions"), reference, strict=False)
        answer["error"] = max(abs(a - b) for x, y in misses for a, b in zip(x, y, strict=True))
        answer["each"] = answer["cpu"] / members
        return answer

    def sized(setting: Any, each: float) -> tuple[int, dict[str, Any]]:
        most = min(effort.members, max(least, int(effort.seconds / each)))
        sizes = [n for n in (least, 4 * least) if n < most and peer in BATCHED] + [most]
        answers = [(members, solved(members, setting)) for members in sizes]
        return min(answers, key=lambda sized: sized[1]["each"])

    for setting, note in settings:
        trial = solved(least, setting)
        customary = setting == TOLERANCES[0]
        if not customary and trial["error"] > TARGET:
            continue
        # Twice: a short call says little of what each of many costs.
        members, answer = sized(setting, trial["each"])
        members, answer = sized(setting, answer["each"])
        reached = answer["error"] <= TARGET
        if customary or reached:
            repeats = max(1, round(effort.seconds / answer["cpu"]))
            yield Entry(peer, label, members, setting, note, answer, repeats)
        if reached:
            return


def drift_models(contest: Contest, effort: Effort) -> list[Entry]:
    """Give the rows of the second table."""
    entries = []
    for peer, label, wind in (
        ("driftcore", "driftcore, mean-flow, paper's fields", "in memory, no coast"),
        ("driftcore-full", "driftcore, full, paper's fields", "in memory, no coast"),
        ("driftcore-gridded", "driftcore, mean-flow, gridded harmonics", "in memory, coast"),
        (
            "driftcore-full-gridded",
            "driftcore, full, gridded harmonics",
            "in memory, coast",
        ),
        ("driftcore-drawn", "driftcore, mean-flow, paper's fields", "drawn, coast"),
        ("driftcore-full-drawn", "driftcore, full, paper's fields", "drawn, coast"),
        ("driftcore-gridded-drawn", "driftcore, mean-flow, gridded harmonics", "drawn, coast"),
        (
            "driftcore-full-gridded-drawn",
            "driftcore, full, gridded harmonics",
            "drawn, coast",
        ),
    ):
        say(f"sizing {label}, winds {wind}")
        contest.ask("domain", peer, 10, None)  # what is loaded at first use
        for particles in effort.particles:
            answer = contest.ask("domain", peer, particles, None)
            answer.pop("positions")
            repeats = max(1, round(effort.seconds / answer["cpu"]))
            note = f"26 days, winds {wind}"
            entries.append(Entry(peer, label, particles, None, note, answer, repeats))
    places = {}
    for peer, label in (
        ("numpy", "NumPy loop"),
        ("parcels", "Parcels"),
        ("opendrift", "OpenDrift"),
    ):
        for particles in effort.particles:
            if not contest.takes_part(peer):
                continue
            say(f"trying {label} with {particles} particles")
            try:
                answer = contest.ask("domain", peer, particles, effort.steps)
            except UnavailableError as error:
                contest.absent[peer] = str(error)
                continue
            found = answer.pop("positions")
            if peer == "numpy":
                places[particles] = found
            else:
                misses = zip(found, places.get(particles, found), strict=True)
                answer["apart_degrees"] = max(
                    abs(a - b) for x, y in misses for a, b in zip(x, y, strict=True)
                )
            note = f"{effort.steps} steps of 15 min"
            entries.append(Entry(peer, label, particles, effort.steps, note, answer))
    return entries


def race(contest: Contest, module: str, entries: list[Entry], rounds: int) -> list[Entry]:
    """Time all entries in turn, round after round."""
    for k in range(rounds):
        say(f"round {k + 1} of {rounds}")
        for entry in entries:
            if entry.peer in contest.absent:
                continue
            try:
                answer = contest.ask(
                    module, entry.peer, entry.members, entry.setting, entry.repeats
                )
            except UnavailableError as error:
                contest.absent[entry.peer] = str(error)
                continue
            entry.rounds.append({clock: answer[clock] for clock in ("cpu", "wall")})
    contest.stop()
    return [entry for entry in entries if len(entry.rounds) == rounds]


def ratio(entry: Entry, base: Entry, scale: float = 1.0) -> list[float]:
    """Give the ratio of the medians, and the least and greatest ratio within one round."""
    each = [a / b / scale for a, b in zip(entry.micros(), base.micros(), strict=True)]
    return [median(entry.micros()) / median(base.micros()) / scale, min(each), max(each)]


def ratios(entry: Entry, bases: dict[str, Entry], days: Callable[[Entry], float]) -> dict[str, Any]:
    """Give how many times as much as each base it takes, of members and days."""
    return {name: ratio(entry, base, days(entry) / days(base)) for name, base in bases.items()}


def solver_rows(entries: list[Entry]) -> list[dict[str, Any]]:
    """Give what was measured of the solvers, against driftcore's cheapest at the target."""

    def cheapest(*peers: str) -> Entry:
        matched = [e for e in entries if e.peer in peers and e.answer["error"] <= TARGET]
        if not matched:
            sys.exit("no setting of driftcore reached the target")
        return min(matched, key=lambda e: median(e.micros()))

    bases = {
        "winds in memory": cheapest("driftcore-fixed", "driftcore"),
        "winds drawn": cheapest("driftcore-drawn"),
    }
    return [
        {
            "contender": entry.label,
            "setting": entry.note,
            "trajectories": entry.members,
            "microseconds": median(entry.micros()),
            "microseconds_spread": [min(entry.micros()), max(entry.micros())],
            "microseconds_wall": median(entry.micros("wall")),
            "evaluations": entry.answer["evaluations"],
            "error": entry.answer["error"],
            "matched": entry.answer["error"] <= TARGET,
            "ratios": ratios(entry, bases, lambda _: 1.0),
        }
        for entry in entries
    ]


def drift_rows(entries: list[Entry]) -> list[dict[str, Any]]:
    """Give what was measured of the drift models, per particle and day adrift."""

    def days(entry: Entry) -> float:
        if entry.setting is None:
            return RUN_DAYS * float(entry.answer["evaluations"])
        return entry.setting / STEPS_A_DAY

    bases = {
        name: next(e for e in entries if e.peer == peer)
        for name, peer in (
            ("winds in memory", "driftcore"),
            ("winds drawn", "driftcore-drawn"),
            ("gridded tide, winds in memory", "driftcore-gridded"),
        )
    }
    rows = []
    for entry in entries:
        each = [t / days(entry) for t in entry.micros()]
        steps = None if entry.setting is None else 1e6 * entry.setting / median(entry.micros())
        rows.append(
            {
                "contender": entry.label,
                "setting": entry.note,
                "particles": entry.members,
                "days": days(entry),
                "microseconds_per_day": median(each),
                "microseconds_per_day_spread": [min(each), max(each)],
                "particle_steps_per_second": steps,
                "ratios": ratios(entry, bases, days),
                "apart_degrees": entry.answer.get("apart_degrees"),
                "start_seconds": entry.answer["start"],
                "peak_megabytes": entry.answer["peak_megabytes"],
            }
        )
    return rows


def number(value: float | None) -> str:
    """Write three digits, or a dash."""
    if value is None:
        return "–"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def markdown(results: dict[str, Any]) -> str:
    """Write the tables."""

    def spread(middle: float, ends: list[float]) -> str:
        return f"{number(middle)} [{number(ends[0])}–{number(ends[1])}]"

    def times(row: dict[str, Any]) -> list[str]:
        ratios = [[1.0] if min(r) == max(r) else r for r in row["ratios"].values()]
        return ["1" if len(r) == 1 else spread(r[0], r[1:]) for r in ratios]

    def heading(rows: list[dict[str, Any]], before: str, after: str) -> list[str]:
        columns = [before, *(f"times driftcore, {name}" for name in rows[0]["ratios"]), after]
        line = f"| {' | '.join(columns)} |"
        return [line, "| --- " * (line.count("|") - 1) + "|"]

    machine = results["machine"]
    lines = [
        f"{machine['processor']}, one core; driftcore at {machine['commit']}; "
        f"{results['effort']['rounds']} rounds, CPU time: median [least–greatest]. "
        + ", ".join(f"{name} {version}" for name, version in results["versions"].items()),
        "",
        "## The paper's full system, ε = 1/50",
        "",
        f"Error: greatest of |ΔX| over the trajectories at t = 1; matched at {TARGET:g}.",
        "",
        *heading(
            results["full_system"],
            "contender | setting | µs/trajectory",
            "rhs evaluations | error | trajectories",
        ),
    ]
    for row in results["full_system"]:
        cells = (
            row["contender"],
            row["setting"],
            spread(row["microseconds"], row["microseconds_spread"]),
            *(text if row["matched"] else f"({text})" for text in times(row)),
            number(row["evaluations"]),
            f"{row['error']:.1e}",
            f"{row['trajectories']:,}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    lines += [
        "",
        "In brackets: not at the target. The reference differs from SciPy's DOP853 by "
        f"{results['reference_check']:.1e}.",
        "",
        "## Drift models, the nearest same work",
        "",
        *heading(
            results["drift_models"],
            "contender | run | particles | days adrift | µs per particle and day",
            "particle-steps/s | from the NumPy loop | start | peak",
        ),
    ]
    for row in results["drift_models"]:
        apart = row["apart_degrees"]
        cells = (
            row["contender"],
            row["setting"],
            f"{row['particles']:,}",
            number(row["days"]),
            spread(row["microseconds_per_day"], row["microseconds_per_day_spread"]),
            *times(row),
            number(row["particle_steps_per_second"]),
            "–" if apart is None else f"{apart:.1e}°",
            f"{row['start_seconds']:.1f} s",
            f"{row['peak_megabytes']:,.0f} MB",
        )
        lines.append(f"| {' | '.join(cells)} |")
    if results["absent"]:
        lines += ["", "Absent:", ""]
        lines += [f"* {name}: {reason}" for name, reason in results["absent"].items()]
    return "\n".join(lines) + "\n"


def machine() -> dict[str, Any]:
    """Say where and of what this was measured."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.exists() else []
    models = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    git = ["git", "-C", CHECKOUT, "describe", "--always", "--dirty"]
    described = subprocess.run(git, capture_output=True, text=True)
    return {
        "processor": models[0] if models else platform.processor(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "load": os.getloadavg() if hasattr(os, "getloadavg") else None,
        "commit": described.stdout.strip() or "an unknown commit",
    }


def versions(pythons: dict[str, Path]) -> dict[str, str]:
    """Give the versions of what was compared."""
    found = {}
    for name, python in pythons.items():
        command = [python, "-m", "pip", "list", "--format=json"]
        listed = subprocess.run(command, capture_output=True, text=True)
        known = {
            package["name"]: package["version"] for package in json.loads(listed.stdout or "[]")
        }
        wanted = ("numpy", "scipy", "numba", "jax", "diffrax") if name == "solvers" else (name,)
        found |= {package: known[package] for package in wanted if package in known}
    return found


def main() -> None:
    """Install, compare, report."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "driftcore-peers"
    parser = argparse.ArgumentParser(description="Compare driftcore with its peers.")
    parser.add_argument("--quick", action="store_true", help="a few minutes, coarse numbers")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these peers beside driftcore")
    parser.add_argument("--envs", type=Path, default=cache, help="folder of the environments")
    parser.add_argument(
        "--no-install", action="store_true", help="use the environments as they are"
    )
    parser.add_argument("-o", "--output", type=Path, help="default: results.json beside those")
    arguments = parser.parse_args()
    effort = QUICK if arguments.quick else FULL

    folder = arguments.envs.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    pythons = {name: folder / name / "bin" / "python" for name in ENVIRONMENTS}
    absent = {} if arguments.no_install else install(folder, pythons)
    absent |= build(folder)
    if "driftcore" in absent:
        sys.exit(f"driftcore cannot be installed: {absent['driftcore']}")

    say(f"drawing {effort.members} winds, solving for the reference")
    command = [pythons["solvers"], HERE / "solvers.py", folder, str(effort.members)]
    prepared = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    preparation = json.loads(prepared.stdout)

    contest = Contest(pythons, folder, arguments.only)
    contest.absent |= absent
    solvers = full_system(contest, effort, preparation["reference"])
    solvers = race(contest, "solvers", solvers, effort.rounds)
    models = race(contest, "domain", drift_models(contest, effort), effort.rounds)

    results = {
        "machine": machine(),
        "versions": versions(pythons),
        "effort": vars(effort),
        "reference_check": preparation["check"],
        "full_system": solver_rows(solvers),
        "drift_models": drift_rows(models),
        "absent": contest.absent,
    }
    tables = markdown(results)
    output = arguments.output or folder / "results.json"
    output.write_text(json.dumps(results, indent=1) + "\n")
    output.with_suffix(".md").write_text(tables)
    print(tables)
    say(f"written to {output} and {output.with_suffix('.md').name}")


if __name__ == "__main__":
    main()
