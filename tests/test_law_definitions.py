"""The acceptance statistics of simulated winds against their definitions, counted value by value.

Records with gaps, and simulations whose law differs from theirs; of each family the largest |z|
is known, and each of some simulations has it elsewhere.
"""

from collections import defaultdict
from collections.abc import Callable
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray

import driftcore as dc
from driftcore import law
from driftcore.climate import synthetic_record
from reference import Floats

Integers = NDArray[np.int64]
Sums = dict[str, list[tuple[float, float]]]  # of each family: sum and number of terms by feature

LEVELS = (0.02, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.98)
SEED = 5


def six_hourly() -> pd.DataFrame:
    """Seven summers, a twelfth of whose rows are gone."""
    frame = synthetic_record(years=7, seed=3)
    return frame[np.arange(len(frame)) % 60 > 4]


def three_hourly() -> pd.DataFrame:
    """Six Julys, the second half of one of them missing, rounded to whole m/s."""
    july = [pd.date_range(f"{year}-07-01", periods=248, freq="3h") for year in range(1990, 1996)]
    times = july[0].append([july[1][:130], *july[2:]])
    noise = np.random.default_rng(8).standard_normal((len(times), 2)) * 3 + [1.0, -1.0]
    smooth = pd.DataFrame(noise, times, ["u10", "v10"]).ewm(halflife=2).mean() * 2
    return smooth.round(0).rename_axis("time")


RECORDS: dict[str, Callable[[], pd.DataFrame]] = {
    "6-hourly": six_hourly,
    "3-hourly": three_hourly,
}


@pytest.fixture(scope="module", params=RECORDS)
def record(request: pytest.FixtureRequest) -> dc.WindRecord:
    return dc.read_record(RECORDS[request.param](), gaps="segment")


class Simulation(NamedTuple):
    """A first-order autoregression of its own mean, spread and memory for each seed.

    Every fifth value but the first repeats the record, and most draws continue the one before.
    """

    record: dc.WindRecord
    seed: int
    starts: list[int | None]

    def __call__(self, members: int, steps: int, start: int | None) -> tuple[Floats, Integers]:
        self.starts.append(start)
        rng = np.random.default_rng([self.seed, members, steps])
        memory, spread = rng.uniform(0.4, 0.95), rng.uniform(2.0, 4.0)
        noise = rng.standard_normal((members, steps, 2)) @ [[1.0, rng.uniform(-0.5, 0.5)], [0, 0.8]]
        values = noise * spread
        for k in range(1, steps):
            values[:, k] = memory * values[:, k - 1] + np.sqrt(1 - memory**2) * values[:, k]
        values += rng.uniform(-1.5, 1.5, 2)
        copied = rng.integers(len(self.record), size=values[:, 1::5].shape[:2])
        values[:, 1::5] = self.record.velocity[copied]
        drawn = rng.integers(len(self.record), size=(members, steps))
        for k in range(1, steps):
            next_row = np.minimum(drawn[:, k - 1] + 1, len(self.record) - 1)
            drawn[:, k] = np.where(rng.random(members) < 0.7, next_row, drawn[:, k])
        return values, drawn


# T1 and T2, by loops


def pieces_by_year(record: dc.WindRecord) -> dict[int, list[Floats]]:
    """Values (steps, 2) that follow each other by one step, in one season."""
    pieces: dict[int, list[list[Floats]]] = defaultdict(list)
    step = np.timedelta64(round(record.step_h * 3600), "s")
    last = None
    for time, value in zip(record.times, record.velocity, strict=True):
        year = int(str(time)[:4])
        if last is None or time - last != step or int(str(last)[:4]) != year:
            pieces[year].append([])
        pieces[year][-1].append(value)
        last = time
    return {year: [np.array(p) for p in of_year] for year, of_year in pieces.items()}


def half_way(values: Floats, level: float) -> float:
    """Middle between the quantile's place among the values that occur and the next of them."""
    quantile = np.quantile(values, level)
    known = sorted(set(values.tolist()))
    lower = max(value for value in known if value <= quantile)
    if lower == known[-1]:
        return (known[-2] + lower) / 2
    return (lower + min(value for value in known if value > lower)) / 2


def with_speed(piece: Floats) -> Floats:
    return np.column_stack([piece, np.hypot(piece[:, 0], piece[:, 1])])


def step_changes(piece: Floats) -> Floats:
    difference = piece[1:] - piece[:-1]
    return np.asarray(np.hypot(difference[:, 0], difference[:, 1]))


class Naive:
    """Statistics of T1 and T2 of what a record and a simulation have in common."""

    def __init__(self, pieces: list[Floats], step_h: float) -> None:
        values = np.concatenate([with_speed(piece) for piece in pieces])
        speed = values[:, 2]
        changes = np.concatenate([step_changes(piece) for piece in pieces])
        self.day = round(24 / step_h)
        self.mean, self.deviation = values.mean(axis=0), values.std(axis=0)
        self.levels = [[half_way(values[:, k], level) for level in LEVELS] for k in range(3)]
        self.change_levels = [half_way(changes, level) for level in LEVELS]
        self.persistence = [half_way(speed, level) for level in (0.1, 0.25, 0.5, 0.75, 0.9)]
        self.classes = [half_way(speed, level) for level in (0.25, 0.5, 0.75)]
        # Every quarter of a day up to ten days, or to the longest piece.
        longest = min(10 * self.day, max(map(len, pieces)) - 1)
        self.lags = [0, 1, *range(self.day // 4, longest + 1, self.day // 4)]
        self.lags = sorted(set(self.lags))
        cells = [self.cell(value) for value in values]
        every = product(range(16), range(4))
        self.common = [cell for cell in every if cells.count(cell) >= 0.01 * len(cells)]

    def cell(self, value: Floats) -> tuple[int, int]:
        """Sector that a wind blows from, the first centred on north, and class of speed."""
        u, v, speed = value
        sector = round(np.degrees(np.arctan2(-u, -v)) / 22.5) % 16
        return sector, sum(speed > level for level in self.classes)

    def sums(self, pieces: list[Floats]) -> Sums:
        values = np.concatenate([with_speed(piece) for piece in pieces])
        changes = np.concatenate([step_changes(piece) for piece in pieces])
        cells = [self.cell(value) for value in values]
        counts = [cells.count(cell) for cell in self.common]
        normal = [(with_speed(piece) - self.mean) / self.deviation for piece in pieces]
        return {
            law.QUANTILES: [
                (float((values[:, k] < level).sum()), len(values))
                for k in range(3)
                for level in self.levels[k]
            ],
            law.ROSE: [(count, len(cells)) for count in [*counts, len(cells) - sum(counts)]],
            law.CHANGES: [(float((changes < c).sum()), len(changes)) for c in self.change_levels],
            law.PERSISTENCE: [
                self.stays(pieces, level, above, steps)
                for level in self.persistence
                for above in (True, False)
                for steps in (1, self.day)
            ],
            "mean": [(float(sum(n[:, k].sum() for n in normal)), len(values)) for k in range(3)],
            "product": [paired(normal, lag, k, k) for lag in self.lags for k in range(3)],
            "crossed": [
                paired(normal, lag, *pair) for lag in self.lags for pair in ((0, 1), (1, 0))
            ],
        }

    def stays(
        self, pieces: list[Floats], level: float, above: bool, steps: int
    ) -> tuple[float, float]:
        """How often a speed on one side of a level stays there, of how often it is followed."""
        stayed = entered = 0
        for piece in pieces:
            side = (with_speed(piece)[:, 2] > level) == above
            for k in range(len(side) - steps):
                entered += int(side[k])
                stayed += int(side[k : k + steps + 1].all())
        return stayed, entered

    def families(self, sums: Sums) -> dict[str, Floats]:
        of = {
            name: np.array([total / max(number, 1) for total, number in features])
            for name, features in sums.items()
        }
        mean, lags = of.pop("mean"), np.array(self.lags)
        covariance = of.pop("product").reshape(-1, 3) - mean**2
        correlation = covariance / covariance[0]
        cross = of.pop("crossed").reshape(-1, 2) - mean[0] * mean[1]
        below = lags < 3 * self.day
        return of | {
            law.SHORT_ACF: correlation[below & (lags > 0)].ravel(),
            law.LONG_ACF: correlation[~below].ravel(),
            law.CROSS: cross[below].ravel() / np.sqrt(covariance[0, 0] * covariance[0, 1]),
            law.LAG_ONE: correlation[1, :2],
        }


def paired(pieces: list[Floats], lag: int, first: int, second: int) -> tuple[float, float]:
    total, number = 0.0, 0
    for piece in pieces:
        pairs = max(0, len(piece) - lag)
        total += float(piece[:pairs, first] @ piece[lag : lag + pairs, second])
        number += pairs
    return total, number


def added(parts: list[tuple[int, Sums]]) -> Sums:
    """Sums of parts taken so many times."""
    return {
        name: [
            (sum(n * s[name][k][0] for n, s in parts), sum(n * s[name][k][1] for n, s in parts))
            for k in range(len(features))
        ]
        for name, features in parts[0][1].items()
    }


class Measured(NamedTuple):
    """What holds for every simulation."""

    naive: Naive
    found: dict[str, Floats]
    error: dict[str, Floats]


def measure(record: dc.WindRecord) -> Measured:
    years = pieces_by_year(record)
    naive = Naive([piece for pieces in years.values() for piece in pieces], record.step_h)
    of_years = [naive.sums(pieces) for pieces in years.values()]
    found = naive.families(added([(1, sums) for sums in of_years]))
    # The very seasons that are drawn: other thousand would differ by some percent.
    share = np.full(len(years), 1 / len(years))
    draws = np.random.default_rng(SEED).multinomial(len(years), share, size=1000)
    replicates = [
        naive.families(added(list(zip(draw.tolist(), of_years, strict=True)))) for draw in draws
    ]
    error = {name: np.std([r[name] for r in replicates], axis=0) for name in found}
    for name in (law.QUANTILES, law.ROSE, law.CHANGES, law.PERSISTENCE):
        for k in range(len(error[name])):
            number = sum(sums[name][k][1] for sums in of_years)
            error[name][k] = max(error[name][k], 1 / max(number, 1))
    return Measured(naive, found, error)


@pytest.fixture(scope="module")
def measured(record: dc.WindRecord) -> Measured:
    return measure(record)


@pytest.mark.parametrize("seed", range(6))
def test_z_by_definition(record: dc.WindRecord, measured: Measured, seed: int) -> None:
    simulation = Simulation(record, seed, [])
    statistics = {s.name: s for s in law.assess(simulation, record, seasons=2, seed=SEED)}
    years = len(np.unique(record.season))
    values, _ = simulation(2, round(len(record) / years), None)
    expected = measured.naive.families(measured.naive.sums(list(values)))
    for name, found in measured.found.items():
        z = (expected[name] - found) / measured.error[name]
        assert statistics[name].measured == pytest.approx(np.abs(z).max(), rel=1e-9), name
        assert statistics[name].high == law.limit(name, years)


def test_missing_values_make_no_cell_of_the_rose_common() -> None:
    """Weak winds from the north, which the record lacks as it lacks half a July."""
    frame = three_hourly()
    frame["u10"] = np.abs(frame["u10"]) + 1
    record = dc.read_record(frame, gaps="segment")
    whole = np.stack([p for of_year in pieces_by_year(record).values() for p in of_year[-1:]][2:])
    whole[:, ::40] = [0.0, -0.5]

    def simulate(members: int, steps: int, start: int | None) -> tuple[Floats, Integers]:
        values = np.resize(whole if start is None else 0 * whole, (members, steps, 2))
        return values, np.zeros((members, steps), np.int64)

    naive, found, error = measure(record)
    assert (0, 0) not in naive.common
    statistics = {s.name: s.measured for s in law.assess(simulate, record, seasons=4, seed=SEED)}
    values, _ = simulate(4, round(len(record) / 6), None)
    expected = naive.families(naive.sums(list(values)))
    z = (expected[law.ROSE] - found[law.ROSE]) / error[law.ROSE]
    assert statistics[law.ROSE] == pytest.approx(np.abs(z).max(), rel=1e-9)
    assert np.abs(z).argmax() == len(naive.common)


# T3 to T7


def test_the_others_by_definition(record: dc.WindRecord) -> None:
    simulation = Simulation(record, 1, [])
    measured = {s.name: s.measured for s in law.assess(simulation, record, seasons=3)}
    values, drawn = simulation(3, round(len(record) / len(np.unique(record.season))), None)

    for k, name in enumerate("uv"):
        ratio = values[..., k].std() / record.velocity[:, k].std()
        assert measured[law.DEVIATION.format(name)] == pytest.approx(ratio - 1)

    continued = [[b == a + 1 for a, b in pairwise(rows)] for rows in drawn.tolist()]
    assert measured[law.CONTINUED] == pytest.approx(np.mean(continued))
    runs = ["".join("x" if c else " " for c in rows).split() for rows in continued]
    assert measured[law.LONGEST] == max(len(run) for rows in runs for run in rows)
    known = {tuple(value) for value in record.velocity.tolist()}
    repeated = [tuple(value) in known for rows in values.tolist() for value in rows[1:]]
    assert measured[law.REPEATED] == pytest.approx(np.mean(repeated))
    assert 0.19 < np.mean(repeated) < 0.3
    ends = {*np.flatnonzero(np.diff(record.segment)), len(record) - 1}
    assert measured[law.JOINED] == sum(row in ends for rows in drawn.tolist() for row in rows)


def test_the_spread_after_a_month_by_definition(record: dc.WindRecord) -> None:
    simulation = Simulation(record, 2, [])
    measured = {s.name: s.measured for s in law.assess(simulation, record, seasons=2)}
    # The windiest row that any Markov order up to 8 knows, with a successor.
    segment, speed = record.segment, np.hypot(*record.velocity.T)
    rows = range(7, len(record) - 1)
    windiest = max((k for k in rows if segment[k - 7] == segment[k + 1]), key=lambda k: speed[k])
    assert simulation.starts == [None, windiest]
    day = round(24 / record.step_h)
    values, _ = simulation(200, 32 * day, windiest)
    hour = record.times.astype("datetime64[h]").astype(int) % 24
    anomaly = record.velocity.copy()
    for h in np.unique(hour):
        anomaly[hour == h] -= anomaly[hour == h].mean(axis=0)
    for k, name in enumerate("uv"):
        steps = [np.var(values[:, step, k], ddof=1) for step in range(28 * day, 32 * day)]
        ratio = np.sqrt(np.mean(steps) / anomaly[:, k].var())
        assert measured[law.SPREAD.format(name)] == pytest.approx(ratio - 1)
