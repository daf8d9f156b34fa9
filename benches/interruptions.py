"""Kill a run at random moments, go on with it, and compare with a run that nothing stopped.

    python benches/interruptions.py [--kills 50] [--members 1000] [--seed 1]

Each kill is a SIGKILL at a moment drawn evenly from the whole length of a run, its start and its
end too. Prints one line for each, and exits with 1 if a result is not bit for bit the same.
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import xarray as xr

import driftcore as dc
from driftcore.climate import synthetic_record

SCENARIO = """
[scenario]
epsilon = 0.02
[wind]
record = "wind.csv"
[ensemble]
members = {members}
keep = 500
[maps]
x = [0.0, 0.5, 1.0, 1.5, 2.0]
y = [0.0, 0.5, 1.0, 1.5, 2.0]
times = [0.25, 0.5, 1.0]
[targets]
triangle = [[1.05, 1.0], [1.2, 1.05], [1.05, 1.15]]
"""
MAIN = "from driftcore.cli import main; main()"


def started(scenario: Path, store: Path, chunk: int) -> subprocess.Popen[bytes]:
    """Run, or go on."""
    how = ["run", str(scenario), "-o", str(store), "--resume", "-q", "--chunk", str(chunk)]
    return subprocess.Popen([sys.executable, "-c", MAIN, *how])


def timeless(path: Path) -> xr.Dataset:
    """All of a store but the time of its making."""
    dataset = dc.open_forecast(path).dataset.load()
    del dataset.attrs["history"]
    return dataset


def main() -> None:
    """Kill, go on, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--members", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    chunk = max(1, chosen.members // 40)
    rng = random.Random(chosen.seed)  # noqa: S311 (no secret)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        synthetic_record(3).to_csv(folder / "wind.csv")
        scenario = folder / "scenario.toml"
        scenario.write_text(SCENARIO.format(members=chosen.members), encoding="utf-8")
        start = time.perf_counter()
        assert started(scenario, folder / "whole.zarr", chunk).wait() == 0
        length = time.perf_counter() - start
        whole = timeless(folder / "whole.zarr")
        print(f"{chosen.members} members without a stop: {length:.1f} s")
        same = met = 0
        for k in range(chosen.kills):
            store = folder / f"{k}.zarr"
            process = started(scenario, store, chunk)
            moment = rng.uniform(0, length)
            time.sleep(moment)
            process.kill()
            killed = process.wait() != 0
            chunks = len(list((folder / f"{k}.zarr.part" / "counts").glob("[0-9]*.npz")))
            assert started(scenario, store, chunk).wait() == 0
            equal = timeless(store).identical(whole)
            same, met = same + equal, met + killed
            print(
                f"{k + 1}: {'SIGKILL' if killed else 'already finished'} after {moment:.2f} s, "
                f"{chunks} chunks written; gone on with: {'equal' if equal else 'DIFFERENT'}",
                flush=True,
            )
    print(f"{met} kills met a running process; {same} of {chosen.kills} results bitwise equal")
    sys.exit(same != chosen.kills)


if __name__ == "__main__":
    main()
