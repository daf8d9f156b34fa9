"""Whether intervals hold what they say, and what two levels save: tables for docs/trust.md.

python benches/intervals.py [--quick] [part ...]
"""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from time import process_time

import numpy as np
from scaling import gridded_sea, machine
from scipy import stats

import driftcore as dc
from driftcore.errors import DriftCoreWarning
from driftcore.markdown import table
from driftcore.multifidelity import combined_probability
from driftcore.precision import FIRST_LOOK, next_look
from driftcore.statistics import members_needed, probability, quantile_interval, wilson

PROBABILITIES = (0.02, 0.3, 0.6)


@dataclass(frozen=True)
class Effort:
    """Sizes of what is measured."""

    replicates: int
    ensembles: int
    levels: int
    reference: int
    timed: int


DEFAULT = Effort(replicates=20_000, ensembles=20_000, levels=200, reference=5_000, timed=512)
QUICK = Effort(replicates=1_000, ensembles=1_000, levels=10, reference=500, timed=64)


def percent(share: float) -> str:
    """Write a coverage."""
    return f"{100 * share:.1f} %"


def exactly(members: int, p: float) -> float:
    """Probability that the Wilson interval covers, summed over all counts."""
    counts = np.arange(members + 1)
    low, high = wilson(counts, members)
    covers = (low <= p) & (p <= high)
    return float(stats.binom.pmf(counts[covers], members, p).sum())


def known_law(effort: Effort) -> str:
    """Give the coverage of (25) for a known probability."""
    random = np.random.default_rng(1)
    rows = []
    for members in (100, 1_000, 10_000):
        for p in PROBABILITIES:
            low, high = wilson(random.binomial(members, p, size=effort.replicates), members)
            share = float(((low <= p) & (p <= high)).mean())
            rows.append([f"{members:,}", f"{p}", percent(share), percent(exactly(members, p))])
    return table(["members", "p", f"covered, of {effort.replicates:,}", "by summation"], rows)


def real_members(effort: Effort) -> str:
    """Coverage over ensembles of the paper's case, the probability known from all of them."""
    size = 100
    scenario = dc.paper.scenario()
    pilot = dc.forecast(scenario, members=10_000, seed=2, keep=0).dataset
    fallen = pilot["stranding_time"].fillna(np.inf).values
    data = dc.forecast(scenario, members=size * effort.ensembles, keep=0).dataset
    when = data["stranding_time"].values
    rows = []
    for wanted in PROBABILITIES:
        by = float(np.quantile(fallen, wanted, method="inverted_cdf"))
        happened = when <= by
        p = float(happened.mean())
        for members in (size, 10 * size):
            low, high = wilson(happened.reshape(-1, members).sum(axis=1), members)
            share = float(((low <= p) & (p <= high)).mean())
            rows.append(
                [
                    f"{by:.3f}",
                    f"{p:.4f}",
                    f"{members:,}",
                    f"{len(low):,}",
                    percent(share),
                    percent(exactly(members, p)),
                ]
            )
    quantiles = []
    for members in (size, 10 * size):
        for q in (0.05, 0.5, 0.95):
            true = float(np.nanquantile(when, q))
            held = []
            for part in when.reshape(-1, members):
                low, high = quantile_interval(part[np.isfinite(part)], [q])
                # What the sample cannot tell is no bound.
                held.append(not low[0] > true and not high[0] < true)
            quantiles.append([f"{members:,}", f"{q}", percent(float(np.mean(held)))])
    return "\n\n".join(
        [
            table(["by", "p", "members", "ensembles", "covered", "binomial, by summation"], rows),
            table(["members", "quantile of the stranding time", "covered"], quantiles),
        ]
    )


def two_levels_by_law(effort: Effort) -> str:
    """Coverage of (50) where the probabilities of all outcomes are known."""
    random = np.random.default_rng(1)
    replicates = effort.replicates // 4
    rows = []
    for members, pairs in ((10_000, 300), (100_000, 1_000)):
        for p in PROBABILITIES:
            for gained, lost in ((0, 0), (1e-3, 0), (2e-3, 2e-3), (0.01, 0.005), (0.1, 0.015)):
                cells = [p - lost, lost, gained, 1 - p - gained]
                seen = random.multinomial(pairs, cells, size=replicates)
                rest = random.binomial(members - pairs, p, size=replicates)
                held = width = 0.0
                for (both, l, g, _), more in zip(seen, rest, strict=True):  # noqa: E741
                    found = combined_probability(
                        int(both + l + more), members, [(int(g), int(l), pairs)]
                    )
                    held += found[1] <= p + gained - lost <= found[2]
                    width += (found[2] - found[1]) / 2
                shares = gained + lost - (gained - lost) ** 2
                normal = 1.96 * math.sqrt(p * (1 - p) / members + shares / pairs)
                rows.append(
                    [
                        f"{members:,}",
                        f"{pairs:,}",
                        f"{p}",
                        f"{gained:g}",
                        f"{lost:g}",
                        f"{(1 - gained - lost) ** pairs:.2f}",
                        percent(held / replicates),
                        f"{width / replicates / normal:.2f}",
                    ]
                )
    return table(
        ["N", "n", "p cheap", "gained", "lost", "none seen", "covered", "width / normal width"],
        rows,
    )


def optimum(variance: float, disagreement: float, cost: float) -> float:
    """Give the best gain of two levels over the dear one alone."""
    spent = math.sqrt(disagreement * (1 + cost)) + math.sqrt(variance * cost)
    return variance / spent**2


def cost_ratio(scenario: dc.Scenario, effort: Effort) -> float:
    """Cost of a member by mean-flow over that by the full model, CPU time, in turn."""
    ratios = []
    for _ in range(5):
        times = []
        for model in ("mean-flow", "full"):
            start = process_time()
            dc.forecast(scenario, members=effort.timed, model=model, keep=0, threads=1)  # type: ignore[arg-type]
            times.append(process_time() - start)
        ratios.append(times[0] / times[1])
    return median(ratios)


def two_levels(
    name: str, scenario: dc.Scenario, members: tuple[int, int], reference: int, effort: Effort
) -> str:
    """Variance at equal cost beside the full model alone, bias, and coverage."""
    # All by both models: the full one alone, and how often they disagree.
    both = dc.multifidelity_probability(scenario, members=(reference, reference), threads=1)
    found = [
        dc.multifidelity_probability(scenario, members=members, seed=1000 + k, threads=1)
        for k in range(effort.levels)
    ]
    estimates = np.array([one.estimate for one in found])
    p, c = both.estimate, cost_ratio(scenario, effort)
    apart = sum(one.gained[0] + one.lost[0] for one in (both, *found))
    pairs = reference + members[1] * effort.levels
    v, d = p * (1 - p), apart / pairs
    variance = float(estimates.var(ddof=1))
    gain = v / (c * members[0] + members[1]) / variance
    noise = gain * math.sqrt(2 / (effort.levels - 1))
    theory = v / members[0] + d / members[1]
    best = optimum(v, d, c)
    error = math.sqrt(variance / effort.levels + v / reference)
    rows = [
        ["c, median of 5", f"{c:.3f}"],
        ["d", f"{100 * d:.3f} % ({apart} of {pairs:,})"],
        ["optimum of the gain", f"{best:.2f}"],
        ["gain, by the variance of the estimates", f"{gain:.2f} ± {noise:.2f}"],
        ["of the optimum", percent(gain / best)],
        ["gain, by p, c and d", f"{v / (c * members[0] + members[1]) / theory:.2f}"],
        [
            "bias",
            f"{estimates.mean():.4f} − {p:.4f}: {(estimates.mean() - p) / error:+.1f} "
            "standard errors",
        ],
        ["covered", percent(float(np.mean([one.low <= p <= one.high for one in found])))],
    ]
    title = f"{name}; N, n = {members[0]:,}, {members[1]}; {effort.levels} replicates"
    return table([title, ""], rows)


def two_levels_paper(effort: Effort) -> str:
    """In the paper's sea, where the full model costs little."""
    return two_levels("paper, ε = 1/50", dc.paper.scenario(), (500, 16), effort.reference, effort)


def two_levels_gridded(effort: Effort) -> str:
    """In a sea on a grid, where it costs much."""
    scenario = dc.Scenario(sea=gridded_sea(), epsilon=1 / 200)
    return two_levels(
        "gridded tide of 3 harmonics, ε = 1/200", scenario, (300, 16), effort.reference // 2, effort
    )


def precision(effort: Effort) -> str:
    """Coverage where members = "auto" chooses the end: its rule, at members drawn outright."""
    random = np.random.default_rng(1)
    rows = []
    for half_width in (0.02, 0.01, 0.005):
        for p in (0.005, *PROBABILITIES):
            held, total, looks = 0, 0, 0
            for _ in range(effort.replicates):
                members, wanted, count = 0, FIRST_LOOK, 0
                while wanted > members:
                    count += int(random.binomial(wanted - members, p))
                    members, looks = wanted, looks + 1
                    found = probability(count, members)
                    wanted = next_look(found, members, half_width)
                held += found.low <= p <= found.high
                total += members
            rows.append(
                [
                    f"{half_width}",
                    f"{p}",
                    percent(held / effort.replicates),
                    percent(exactly(max(FIRST_LOOK, members_needed(p, half_width)), p)),
                    f"{total / effort.replicates:,.0f}",
                    f"{max(FIRST_LOOK, members_needed(p, half_width)):,}",
                    f"{looks / effort.replicates:.1f}",
                ]
            )
    return table(
        [
            "precision",
            "p",
            "covered",
            "at the number needed, by summation",
            "members, mean",
            "needed",
            "looks",
        ],
        rows,
    )


PARTS: dict[str, Callable[[Effort], str]] = {
    "known-law": known_law,
    "real-members": real_members,
    "two-levels-by-law": two_levels_by_law,
    "two-levels-paper": two_levels_paper,
    "two-levels-gridded": two_levels_gridded,
    "precision": precision,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables of the parts that are asked for, or of all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", maxsplit=1)[0])
    parser.add_argument("--quick", action="store_true", help="Smaller sizes.")
    parser.add_argument("parts", nargs="*", help=f"Some of {', '.join(PARTS)}; default all.")
    asked = parser.parse_args(arguments)
    # Long runs outlast the months of the embedded climate: the intervals are the same.
    warnings.simplefilter("ignore", DriftCoreWarning)
    print(machine())
    for part in asked.parts or PARTS:
        print(f"\n### {part}\n\n{PARTS[part](QUICK if asked.quick else DEFAULT)}", flush=True)


if __name__ == "__main__":
    main()
