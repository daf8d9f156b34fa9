"""Rare events by splitting against plain ensembles: bias, coverage and cost.

    python benches/rare_events.py plain FILE [MILLIONS]   # count the events among many members
    python benches/rare_events.py split FILE [REPETITIONS]  # splitting, against what FILE counted
    python benches/rare_events.py often [REPETITIONS]     # bias and coverage where p is about 1e-3

The case is half the paper's run: stranding on a circle that few reach, and two areas off the usual
tracks. `plain` adds to FILE and may be stopped at any time; it and `split` are of a Gaussian wind,
whose members cost a fraction of those of the embedded climate, which `often` takes.
"""

from __future__ import annotations

import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

import driftcore as dc
from driftcore.markdown import table
from driftcore.statistics import wilson

_CHUNK = 500_000
_FIRST_PLAIN_SEED = 1000


def square(x: float, y: float, half: float) -> list[tuple[float, float]]:
    """Give a square area by its centre and half its side."""
    return [(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)]


def case(radius: float) -> dc.Scenario:
    """Half the paper's run, within a circle."""
    scenario = dc.paper.scenario(coast=dc.Circle(radius=radius))
    return scenario.model_copy(update={"duration": 0.5})


RARE = case(0.39)
RARE_AREAS = {"north": square(1.05, 1.135, 0.02), "west": square(0.89, 1.075, 0.04)}
OFTEN = case(0.3)
OFTEN_AREAS = {"north": square(1.07, 1.08, 0.02), "west": square(0.93, 1.055, 0.04)}


def gaussian_wind() -> dc.LocalGridBootstrap:
    """Give the Gaussian AR(1) process nearest to the embedded climate, from its mean on.

    A catalogue of one row: its draws cost next to nothing, so that ten million members can be
    followed.
    """
    wind = dc.paper.default_wind()
    now = wind.states[:, :2]
    later = wind.target + np.column_stack([np.ones(len(now)), wind.states]) @ wind.predictor.T
    matrix = np.linalg.lstsq(now, later, rcond=None)[0].T
    missed = later - now @ matrix.T
    return replace(
        wind,
        order=1,
        states=np.zeros((1, 2)),
        whitening=np.eye(2),
        target=np.zeros((1, 2)),
        predictor=np.column_stack([np.zeros(2), matrix]),
        noise=np.linalg.cholesky(np.cov(missed.T)),
        row=np.array([1]),
        phase=np.array([0]),
        start=np.array([True]),
        cycle=wind.cycle.mean(axis=0, keepdims=True),
    )


def plain(file: Path, millions: float) -> None:
    """Count the events among members, chunk by chunk, each of a seed of its own."""
    wind = gaussian_wind()
    counts = json.loads(file.read_text()) if file.exists() else {"members": 0, "cpu_s": 0.0}
    while counts["members"] < millions * 1e6:
        seed = _FIRST_PLAIN_SEED + counts["members"] // _CHUNK
        began = time.process_time()
        forecast = dc.forecast(RARE, wind, members=_CHUNK, seed=seed, keep=0, targets=RARE_AREAS)
        counts["cpu_s"] += time.process_time() - began
        counts["members"] += _CHUNK
        found = {"stranding": forecast.counts["stranded"]}
        found |= {name: forecast.entry_probability(name).count for name in RARE_AREAS}
        for name, count in found.items():
            counts[name] = counts.get(name, 0) + count
        file.write_text(json.dumps(counts))
        print(counts, flush=True)


def split(file: Path, repetitions: int) -> None:
    """Estimate by splitting what was counted, and compare the costs at equal standard error.

    Estimates are repeated with other seeds: standard error and costs are the means of one.
    """
    counts = json.loads(file.read_text())
    wind, members = gaussian_wind(), counts["members"]
    rows = []
    for name, event in {"stranding": "stranding", **RARE_AREAS}.items():
        low, high = wilson(counts[name], members)
        began = time.process_time()
        found = [
            dc.rare_probability(RARE, wind, event=event, particles=500, replicates=20, seed=seed)
            for seed in range(1, repetitions + 1)
        ]
        cpu = (time.process_time() - began) / repetitions
        replicates = np.concatenate([one.replicates for one in found])
        mean, followed = replicates.mean(), np.mean([one.followed for one in found])
        error = replicates.std(ddof=1) / math.sqrt(20)
        plain = mean * (1 - mean) / error**2
        covered = sum(one.low <= high and one.high >= low for one in found)
        rows.append(
            [
                name,
                f"{counts[name] / members:.2e} [{low:.2e}, {high:.2e}]",
                f"{mean:.2e} ± {error / math.sqrt(repetitions):.1e}",
                f"{covered} of {repetitions}",
                f"{error / mean:.1%}",
                f"{followed:.0f}",
                f"{plain / followed:.0f}",
                f"{cpu:.2f}",
                f"{plain / members * counts['cpu_s'] / cpu:.0f}",
            ]
        )
    header = ["event", f"{members} plain members", "mean of splitting", "agree", "standard error"]
    print(table([*header, "whole runs followed", "ratio", "CPU [s]", "ratio"], rows))


def often(repetitions: int) -> None:
    """Repeat small estimates of what is easily counted: their mean, and how often they cover it."""
    wind = dc.paper.default_wind()
    plain = dc.forecast(OFTEN, wind, members=200_000, seed=99, keep=0, targets=OFTEN_AREAS)
    rows = []
    for name, event in {"stranding": "stranding", **OFTEN_AREAS}.items():
        by_count = name == "stranding"
        counted = plain.stranding_probability() if by_count else plain.entry_probability(name)
        found = [
            dc.rare_probability(OFTEN, wind, event=event, particles=100, seed=seed)
            for seed in range(repetitions)
        ]
        mean, error = np.mean([r.estimate for r in found]), np.std([r.estimate for r in found])
        covered = sum(r.low <= counted.estimate <= r.high for r in found)
        rows.append(
            [
                name,
                f"{counted.estimate:.2e} [{counted.low:.2e}, {counted.high:.2e}]",
                f"{mean:.2e} ± {error / math.sqrt(repetitions):.1e}",
                f"{covered} of {repetitions}",
            ]
        )
    print(table(["event", "200000 plain members", "mean of splitting", "covered"], rows))


if __name__ == "__main__":
    what, *arguments = sys.argv[1:]
    if what == "plain":
        plain(Path(arguments[0]), float(arguments[1]) if arguments[1:] else 10.0)
    elif what == "split":
        split(Path(arguments[0]), int(arguments[1]) if arguments[1:] else 10)
    elif what == "often":
        often(int(arguments[0]) if arguments else 50)
