"""How the cost of a forecast grows, and what it is at a few points: the tables of performance.md.

    python benches/scaling.py [--quick] [--figure docs/figures/scaling.png] [-o tables.md]
    python benches/scaling.py --only calls threads

CPU time of the process, one thread, least of some repeats. The growth with the members is that of
a whole call; the others are of following alone, without what is prepared once for all members.
"""

from __future__ import annotations

import argparse
import math
import platform
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

import driftcore as dc
from driftcore import _core
from driftcore.compiled import regular_times, scenario_core, solver_of
from driftcore.ensemble_winds import Resampled
from driftcore.errors import DriftCoreWarning
from driftcore.markdown import paragraphs, table
from driftcore.members import Fates

if TYPE_CHECKING:
    from numpy.typing import NDArray

WIDTH = 16  # members that the core steps side by side
MODELS = ("mean-flow", "full")
COLOURS = {"mean-flow": "#0072B2", "full": "#D55E00"}  # Okabe & Ito (2008)


@dataclass(frozen=True)
class Effort:
    """How much to measure."""

    repeats: int
    paper: int  # members in the paper's sea
    gridded: int  # members in a sea on a grid
    rounds: int  # of what is timed in turn
    most: float  # greatest number of members and of coast points
    compared: int  # members whose strandings are compared


DEFAULT = Effort(repeats=3, paper=1024, gridded=256, rounds=7, most=1e6, compared=512)
QUICK = Effort(repeats=1, paper=128, gridded=32, rounds=3, most=1e4, compared=64)


@dataclass(frozen=True)
class Sweep:
    """Cost against one size, by model."""

    title: str
    label: str
    sizes: Sequence[float]
    cost: dict[str, list[float]]  # [s]
    unit: str = "CPU time per member [ms]"
    scale: float = 1e3

    def exponent(self, model: str) -> float:
        """Slope of the line through the logarithms."""
        return float(np.polyfit(np.log(self.sizes), np.log(self.cost[model]), 1)[0])


def cpu(call: Callable[[], Any], repeats: int) -> float:
    """Least CPU time of some calls."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def follow(scenario: dc.Scenario, members: int, model: Any) -> dc.Forecast:
    """Forecast on one thread, nothing kept."""
    wind = dc.paper.default_wind()
    return dc.forecast(scenario, wind, members=members, model=model, keep=0, threads=1)


def per_member(scenario: dc.Scenario, members: int, model: Any, repeats: int) -> float:
    """CPU time of following a member, without what is prepared once for all of them."""
    compiled = scenario_core(scenario)
    _, solver = solver_of(scenario, model, None, None, True, "B", 1e-6, None)
    winds = Resampled(scenario, dc.paper.default_wind(), solver, seed=1)
    fates = Fates.empty(members, 0, 1, 0).rows(slice(members))
    return (
        cpu(
            lambda: compiled.run(winds.core, solver, 0, np.array([1.0]), 0, fates, 1, []),
            repeats,
        )
        / members
    )


def gridded_sea(harmonics: int = 3, points: int = 64) -> dc.HarmonicSea:
    """Give a tide that is not linear in the position: waves of the size of the paper's tide.

    Harmonic j has 1/j² of the amplitude and waves j times as short; the residual current has
    eddies and a first harmonic.
    """
    axis = np.linspace(0.4, 1.6, points)
    y, x = np.meshgrid(axis, axis, indexing="ij")

    def field(numbers: range, wave: Callable[[int], Sequence[NDArray[Any]]]) -> xr.DataArray:
        coordinates = {"harmonic": list(numbers), "component": ["x", "y"], "y": axis, "x": axis}
        values = np.array([wave(j) for j in numbers], dtype=complex)
        return xr.DataArray(values, coordinates, ("harmonic", "component", "y", "x"))

    def tide(j: int) -> Sequence[NDArray[Any]]:
        # Slack at the release, so that the body starts with the water.
        phase = j * (2 * (x - 1) + (y - 1)) + np.pi / 2
        return 2 / j**2 * np.exp(-1j * phase) * np.array([x, 0.5 * y + 0.3 * np.sin(3 * x)])

    def residual(j: int) -> Sequence[NDArray[Any]]:
        swirl = np.array([np.sin(4 * y) * np.cos(3 * x), -np.cos(4 * y) * np.sin(3 * x)])
        return swirl / (1 + j)

    return dc.HarmonicSea(field(range(1, harmonics + 1), tide), field(range(2), residual))


def wiggled_coast(points: int) -> dc.Polygons:
    """Give the paper's circle with wiggles a tenth of its radius high, down to its points."""
    angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
    bays = [
        math.sin(k) * np.sin(k * angle) / k for k in (5, 13, 34, 89, 233, 610) if 4 * k < points
    ]
    ring = 0.3 * (1 + 0.15 * np.sum(bays, axis=0))[:, None]
    return dc.Polygons(rings=(1 + ring * np.column_stack([np.cos(angle), np.sin(angle)]),))


def sweeps(effort: Effort) -> list[Sweep]:
    """Measure every growth."""

    def swept(
        title: str, label: str, sizes: Sequence[int], count: int, case: Callable[[int], dc.Scenario]
    ) -> Sweep:
        cost: dict[str, list[float]] = {model: [] for model in MODELS}
        for size in sizes:
            scenario = case(size)
            for model in MODELS:
                cost[model].append(per_member(scenario, count, model, effort.repeats))
        return Sweep(title, label, sizes, cost)

    def tens(first: int) -> list[int]:
        return [10**k for k in range(first, round(math.log10(effort.most)) + 1)]

    members = tens(2)
    # A second and more need no repeats.
    calls = [
        cpu(
            lambda count=count: follow(dc.paper.scenario(), count, "mean-flow"),
            effort.repeats if count < 10**5 else 1,
        )
        for count in members
    ]
    return [
        Sweep("members", "members", members, {"mean-flow": calls}, "CPU time of the call [s]", 1.0),
        swept(
            "length of the run",
            "tides in the run, 1/ε",
            [25, 50, 100, 200, 400],
            effort.paper,
            lambda tides: dc.paper.scenario(epsilon=1 / tides),
        ),
        swept(
            "coast",
            "points of the coast",
            tens(2),
            effort.paper,
            lambda points: dc.paper.scenario(coast=wiggled_coast(points)),
        ),
        swept(
            "harmonics of a gridded sea",
            "harmonics of the tide",
            [1, 2, 3, 4, 6, 8],
            effort.gridded,
            lambda count: dc.Scenario(sea=gridded_sea(count)),
        ),
        swept(
            "grid of a gridded sea",
            "grid points along each axis",
            [16, 32, 64, 128, 256, 512],
            effort.gridded,
            lambda points: dc.Scenario(sea=gridded_sea(3, points)),
        ),
    ]


def whole_calls(effort: Effort) -> list[list[str]]:
    """Cost of a forecast of 1,000 members from the call to its answer, by what it keeps."""
    rows = []
    wind = dc.paper.default_wind()
    for tides, keep in ((50, 0), (50, 1000), (200, 0), (200, 1000)):
        scenario = dc.paper.scenario(epsilon=1 / tides)

        def call(members: int, scenario: Any = scenario, keep: int = keep) -> dc.Forecast:
            return dc.forecast(scenario, wind, members=members, keep=keep, threads=1)

        thousand = cpu(partial(call, 1000), effort.rounds)
        one = cpu(partial(call, 1), 10 * effort.rounds)
        rows.append([f"1/{tides}", f"{keep:,}", f"{1e3 * thousand:.1f}", f"{1e3 * one:.1f}"])
    return rows


def threads(effort: Effort) -> list[list[str]]:
    """Two threads beside one, in turn: wall time."""
    rows = []
    wind = dc.paper.default_wind()
    for model in MODELS:
        members = 8 * effort.paper

        def wall(count: int, model: Any = model, members: int = members) -> float:
            start = time.perf_counter()
            dc.forecast(
                dc.paper.scenario(), wind, members=members, model=model, keep=0, threads=count
            )
            return time.perf_counter() - start

        rounds = [[wall(count) for count in (1, 2)] for _ in range(effort.rounds)]
        one, two = (median(column) for column in zip(*rounds, strict=True))
        ratio = sorted(one / two for one, two in rounds)
        rows.append(
            [
                model,
                f"{members / one:,.0f}",
                f"{members / two:,.0f}",
                f"{median(ratio):.2f} [{ratio[0]:.2f}–{ratio[-1]:.2f}]",
            ]
        )
    return rows


def in_memory(effort: Effort) -> list[list[str]]:
    """Full model under winds in memory, eight steps a tide: speed, and error against rtol 1e-12."""
    rows = []
    wind = dc.paper.default_wind()
    few = 64
    for tides in (50, 200):
        scenario = dc.paper.scenario(epsilon=1 / tides, coast=None)
        paths = [dc.member_path(scenario, wind, member) for member in range(few)]
        velocity = np.array([path.velocity for path in paths])
        members = max(few, effort.paper * 50 // tides)
        how: dict[str, Any] = {"model": "full", "threads": 1, "steps_per_tide": 8}
        call = partial(dc.forecast, scenario, keep=0, **how)
        times = regular_times(1.0, scenario.epsilon)
        exact = [
            dc.trajectory(scenario, path, model="full", times=times, rtol=1e-12).position.values
            for path in paths[: effort.rounds * 2]
        ]
        for precision, dtype in (("double", np.float64), ("single", np.float32)):
            known = velocity.astype(dtype)
            tiled = np.tile(known, (-(-members // few), 1, 1))[:members]
            many, first, all_few = (
                dc.WindPaths(paths[0].times, winds) for winds in (tiled, known[:WIDTH], known)
            )
            del tiled
            cost = [cpu(partial(call, winds), effort.repeats) for winds in (many, first)]
            rate = (members - WIDTH) / (cost[0] - cost[1])
            found = dc.forecast(scenario, all_few, times=times, **how).dataset["position"].values
            error = max(np.abs(f - e).max() for f, e in zip(found, exact, strict=False))
            rows.append(
                [f"1/{tides}", precision, f"{rate:,.0f}", f"{1e6 / rate:.1f}", f"{error:.1e}"]
            )
    return rows


def split(effort: Effort) -> list[list[str]]:
    """Share of the rewrite, the lanes, averaging and exact sampling, in the paper's case, ε = 1/50.

    The full model alone, in rewrite A (the four unknowns of the paper) and B (two), at the largest
    tolerance that brings the position within 1e-6; then sixteen members side by side; then the
    averaged model, whose error is its own; each under winds in memory. Last, both with their winds
    drawn: the averaged model needs no fine path.
    """
    scenario = dc.paper.scenario(coast=None)
    compiled = scenario_core(scenario)
    wind = dc.paper.default_wind()
    paths = [dc.member_path(scenario, wind, member) for member in range(16 * WIDTH)]
    lanes = dc.WindPaths(paths[0].times, np.array([path.velocity for path in paths]))
    singly = [path.core for path in paths]
    end, members = np.array([1.0]), len(paths)

    def run(winds: Any, solver: _core.Solver, steps: float | None = None) -> Fates:
        fates = Fates.empty(members, members, 1, 0)
        compiled.run(winds, solver, 0, end, members, fates, 1, [], steps)
        return fates

    def full(general: bool, rtol: float) -> _core.Solver:
        return _core.Solver.full(general, rtol, rtol, None)

    mean_flow = _core.Solver.mean_flow(1, 1e-6, 1e-6, None)
    drawn = [Resampled(scenario, wind, solver, 1).core for solver in (full(False, 1e-6), mean_flow)]
    exact = run(singly, full(False, 1e-12)).position

    def error(fates: Fates) -> float:
        return float(np.abs(fates.position - exact).max())

    def loosest(general: bool) -> float:
        for rtol in 10.0 ** np.arange(-5, -11, -0.5):
            if error(run(singly, full(general, rtol))) <= 1e-6:
                return float(rtol)
        raise AssertionError("no tolerance is tight enough")

    cases: list[tuple[str, Callable[[], Fates]]] = [
        ("full, rewrite A, alone", partial(run, singly, full(True, loosest(True)))),
        ("full, rewrite B, alone", partial(run, singly, full(False, loosest(False)))),
        ("full, rewrite B, side by side", partial(run, lanes.core, full(False, 1e-6), 5)),
        ("mean-flow 1, side by side", partial(run, lanes.core, mean_flow)),
        ("full, wind drawn", partial(run, drawn[0], full(False, 1e-6), 5)),
        ("mean-flow 1, wind drawn at coarse steps", partial(run, drawn[1], mean_flow)),
    ]
    rows = []
    before = math.nan
    for name, call in cases:
        cost = 1e6 * cpu(call, effort.repeats) / members
        apart = f"{error(call()):.0e}"
        gain = "" if math.isnan(before) or name == "full, wind drawn" else f"{before / cost:.1f}"
        rows.append([name, f"{cost:.1f}", gain, apart])
        before = cost
    return rows


def in_memory_cost(scenario: dc.Scenario, effort: Effort) -> list[float]:
    """CPU time of the models under the same winds, drawn beforehand."""
    wind = dc.paper.default_wind()
    paths = [dc.member_path(scenario, wind, member) for member in range(16 * WIDTH)]
    winds = dc.WindPaths(paths[0].times, np.array([path.velocity for path in paths]))
    follow = partial(dc.forecast, scenario, winds, keep=0, threads=1)
    return [cpu(partial(follow, model=model), effort.repeats) for model in MODELS]


def averaged_beside_full(effort: Effort) -> list[list[str]]:
    """Mean-flow beside the full model in a gridded tide, ε = 1/200: cost, and who strands."""
    rows = []
    for name, coast in (("circle", dc.Circle()), ("10,000 points", wiggled_coast(10_000))):
        scenario = dc.Scenario(sea=gridded_sea(), epsilon=1 / 200, coast=coast)
        cost = [per_member(scenario, effort.gridded, model, effort.repeats) for model in MODELS]
        fates = [follow(scenario, effort.compared, model).dataset for model in MODELS]
        status = [fate["status"].values for fate in fates]
        apart = np.abs(fates[0]["stranding_time"] - fates[1]["stranding_time"]).values
        known = in_memory_cost(scenario, effort)
        rows.append(
            [
                name,
                *(f"{1e3 * value:.2f}" for value in cost),
                f"{cost[1] / cost[0]:.1f}",
                f"{known[1] / known[0]:.1f}",
                f"{(status[1] == 1).mean():.3f}",
                f"{(status[0] == status[1]).sum()} of {effort.compared}",
                f"{np.nanmedian(apart):.1e}",
            ]
        )
    return rows


def draw(found: list[Sweep], path: Path) -> None:
    """One panel for each growth, and a line of its exponent through each."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    figure = Figure(figsize=(7.0, 4.9), layout="constrained", dpi=200)
    axes = figure.subplots(2, 3).ravel()
    for ax, sweep in zip(axes, found, strict=False):
        sizes = np.array(sweep.sizes, dtype=float)
        for model, cost in sweep.cost.items():
            exponent = sweep.exponent(model)
            values = sweep.scale * np.array(cost)
            line = (
                np.exp(np.log(values).mean()) * (sizes / np.exp(np.log(sizes).mean())) ** exponent
            )
            ax.loglog(sizes, line, color=COLOURS[model], linewidth=1, alpha=0.5)
            ax.loglog(sizes, values, "o", color=COLOURS[model], markersize=4)
            ax.annotate(
                f"{exponent:.2f}",
                (sizes[-1], values[-1]),
                xytext=(0, 7 if model == MODELS[-1] or len(sweep.cost) == 1 else -13),
                textcoords="offset points",
                ha="right",
                color=COLOURS[model],
                fontsize=8,
            )
        ax.set_title(sweep.title, fontsize=9.5)
        ax.set_xlabel(sweep.label, fontsize=8)
        ax.set_ylabel(sweep.unit, fontsize=8)
        ax.tick_params(labelsize=7)
        if max(map(max, sweep.cost.values())) < 100 * min(map(min, sweep.cost.values())):
            ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.grid(True, which="major", color="#DDDDDD", linewidth=0.6)
        if sizes[-1] / sizes[0] < 100:
            ax.set_xticks(sizes, [f"{size:g}" for size in sizes])
            ax.minorticks_off()
        low, high = ax.get_ylim()
        # At least a decade, so that noise on a level line does not fill the panel.
        middle, half = math.sqrt(low * high), max(math.sqrt(high / low) * 1.3, math.sqrt(10))
        ax.set_ylim(middle / half, middle * half)
    legend = axes[-1]
    legend.axis("off")
    for model in MODELS:
        legend.plot([], [], "o-", color=COLOURS[model], markersize=4, label=model)
    legend.legend(
        title="Numbers: exponents fitted\nto the points of a panel",
        title_fontsize=8,
        fontsize=9,
        loc="center",
        frameon=False,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def machine() -> str:
    """Name the processor and what else is needed to read the numbers."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    name = names[0] if names else platform.processor()
    return (
        f"{name}, {len(names) or 1} cores, Python {platform.python_version()}, NumPy "
        f"{np.__version__}, driftcore {dc.__version__}"
    )


def growth(found: list[Sweep]) -> list[list[str]]:
    """Give the first and last cost of each sweep, and its exponent."""
    return [
        [
            sweep.title,
            model,
            f"{sweep.sizes[0]:,} to {sweep.sizes[-1]:,}",
            f"{cost[0] * sweep.scale:.3g} to {cost[-1] * sweep.scale:.3g}",
            sweep.unit.split(" [")[1].rstrip("]"),
            f"{sweep.exponent(model):.2f}",
        ]
        for sweep in found
        for model, cost in sweep.cost.items()
    ]


# Headings and rows of the tables that need no sweep, by name.
TABLES: dict[str, tuple[list[str], Callable[[Effort], list[list[str]]]]] = {
    "calls": (["ε", "kept", "1,000 members [ms]", "one member [ms]"], whole_calls),
    "threads": (
        ["model", "members/s, 1 thread", "members/s, 2 threads", "gain [least–greatest]"],
        threads,
    ),
    "split": (["what", "µs/member", "times cheaper than the row above", "error"], split),
    "memory": (
        ["ε", "precision", "trajectories/s", "µs/trajectory", "largest error of position"],
        in_memory,
    ),
    "averaged": (
        [
            "coast",
            "mean-flow [ms/member]",
            "full [ms/member]",
            "ratio",
            "ratio, winds in memory",
            "strands (full)",
            "same fate",
            "stranding times apart, median",
        ],
        averaged_beside_full,
    ),
}


def report(effort: Effort, names: Sequence[str], found: list[Sweep]) -> str:
    """Write the tables."""
    head = f"{machine()}; CPU time, one thread, least of {effort.repeats} calls."
    grown = ["growth with", "model", "sizes", "cost", "unit", "exponent"]
    tables = [paragraphs(head), *([table(grown, growth(found))] if found else [])]
    for heading, rows in (TABLES[name] for name in names):
        tables.append(table(heading, rows(effort)))
    return "\n\n".join(tables)


def main() -> None:
    """Measure, draw and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--quick", action="store_true", help="Smaller sizes, one repeat.")
    parser.add_argument("--figure", type=Path, default=Path("docs/figures/scaling.png"))
    parser.add_argument("-o", "--output", type=Path, help="File for the tables; else printed.")
    parser.add_argument("--only", nargs="+", choices=TABLES, help="These tables, no sweeps.")
    arguments = parser.parse_args()
    effort = QUICK if arguments.quick else DEFAULT
    # Long runs outlast the months of the embedded climate: the cost is the same.
    warnings.simplefilter("ignore", DriftCoreWarning)
    dc.paper.default_wind()  # fitted before the clock starts
    found = []
    if arguments.only is None:
        found = sweeps(effort)
        draw(found, arguments.figure)
    text = report(effort, arguments.only or list(TABLES), found)
    if arguments.output is None:
        print(text)
    else:
        arguments.output.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
