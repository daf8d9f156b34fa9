"""Whether probabilities come true: the tables and figures of docs/calibration.md.

    python benches/calibration.py [--quick] [--record wind.csv] [--figures docs/figures]

Forecasts of the paper's case from many days, five places and for sixteen events are verified under
winds that the fit has not seen: fresh summers of the embedded climate; each summer of the embedded
record, and of the real one where it is found, forecast from the others. Last, the hand-over from a
wind forecast of known skill beside the climate alone.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import driftcore as dc
from driftcore import drawing, hindcast, plot, verification
from driftcore.climate import synthetic_record
from driftcore.errors import DriftCoreWarning
from driftcore.hand_over import HandOver
from driftcore.hindcast import leave_one_season_out
from driftcore.markdown import table
from driftcore.record import phase_of_day

RECORD = Path(__file__).parents[2] / "shared/data/wind/wind_resourcecode_belleile_6h_1994_1999.csv"
PLACES = ((1.0, 1.0), (1.12, 1.0), (0.88, 1.0), (1.0, 1.12), (1.0, 0.88))
SCENARIOS = [dc.paper.scenario(x=place) for place in PLACES]
BY = (0.25, 0.5, 0.75, 1.0)
TARGET = {"square": [(1.05, 0.8), (1.2, 0.8), (1.2, 0.95), (1.05, 0.95)]}
CENTER = (1.0, 1.0)
FRESH = 4711  # seed of the summers that no fit has seen
H = 0.4  # bandwidth where there are many fits: the one that the embedded record chooses is near

HORIZON, HALF_LIFE_H = 40, 168.0  # steps of 6 h, and hours
LEADS = np.arange(0.5, 20.1, 0.5)  # days
Folds = Iterable[tuple[dc.WindRecord, dc.LocalGridBootstrap]]

SO_FAR = "wind so far"
ISSUES = {SO_FAR: hindcast.from_present, "climate": hindcast.from_climate}


def embedded(years: int, seed: int = 1) -> dc.WindRecord:
    """Summers of the embedded climate."""
    return dc.read_record(synthetic_record(years, seed), (6, 7, 8))


def fresh(years: int, factor: float = 1.0) -> Folds:
    """Summers of the embedded climate, and the bootstrap of twenty others, times a factor."""
    known = embedded(20)
    climate = dc.LocalGridBootstrap.fit(replace(known, velocity=factor * known.velocity), h=H)
    record = embedded(years, FRESH)
    for season in np.unique(record.season):
        yield record._keep(record.season == season), climate


def forecasts(folds: Folds, **options: Any) -> xr.Dataset:
    """Hindcasts of the paper's case, season by season."""
    parts = [
        hindcast.hindcast(SCENARIOS, season, climate, targets=TARGET, **options)
        for season, climate in folds
    ]
    return xr.concat(parts, "release")


def verify(found: xr.Dataset) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
    """Events, their reliability, and the ranks of the stranding times, by whole summers."""
    events = hindcast.events(found, BY, 8, CENTER)
    season = found["season"].to_numpy()[:, None]
    groups = np.broadcast_to(season, events["probability"].shape)
    return (
        events,
        verification.reliability(events["probability"], events["happened"], 10, groups),
        verification.pit(
            found["stranding_time"],
            found["observed_stranding_time"],
            10,
            groups[..., 0],
        ),
    )


def false_alarms(events: xr.Dataset, summers: int, draws: int = 300) -> list[float]:
    """Share of calibrated sets of so few summers that are called uncalibrated at 5 %."""
    season = events["season"].to_numpy()
    names, random = np.unique(season), np.random.default_rng(5)
    alarms = np.zeros(2)
    for _ in range(draws):
        some = events.isel(release=np.isin(season, random.choice(names, summers, replace=False)))
        p, o = some["probability"].to_numpy(), some["happened"].to_numpy()
        groups = np.broadcast_to(some["season"].to_numpy()[:, None], p.shape)
        fine = verification.reliability(p, o, 10, groups)
        place = np.minimum((p * 10).astype(int), 9)
        sums = np.bincount(place.ravel(), (o - p).ravel(), 10)
        count = np.bincount(place.ravel(), minlength=10)
        spread = np.bincount(place.ravel(), (p * (1 - p)).ravel(), 10)
        # As if all cases were independent: the statistic is a sum of squares of normal numbers.
        normal = random.standard_normal((500, 10)) * np.sqrt(spread)
        as_cases = ((normal**2 / count).sum(axis=1) >= (sums**2 / count).sum()).mean()
        alarms += np.array([fine.attrs["p_value"], as_cases]) <= 0.05
    return list(alarms / draws)


def imperfect_forecast(
    climate: dc.LocalGridBootstrap,
    record: dc.WindRecord,
    row: int,
    members: int,
    steps: int,
    seed: int,
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Winds handed over from a forecast that is the truth, spoilt to a known skill."""
    rows = slice(row, row + HORIZON + 1)
    step = np.arange(HORIZON + 1)
    phase = phase_of_day(climate.record, record.times[row]) + step
    mean = climate.cycle[phase % len(climate.cycle)]
    r = 2.0 ** -((step * record.step_h / HALF_LIFE_H) ** 2)[:, None]
    # The error has the climate's law: the same days of another summer, of each its own.
    names = np.unique(climate.record.season)
    name = names[np.random.default_rng(seed).integers(len(names))]
    other = np.flatnonzero(climate.record.season == name)[rows]
    given = hindcast.table(record, rows)
    error = climate.record.velocity[other] - mean
    given[:] = mean + r * (record.velocity[rows] - mean) + np.sqrt(1 - r**2) * error
    over = HandOver(given, climate, skill={"half_life_h": HALF_LIFE_H})
    return over.sample(members, steps, seed)[1]


def hand_over_skill(folds: Folds, **options: Any) -> tuple[xr.Dataset, xr.Dataset]:
    """CRPS of the handed-over wind, and of the drift under it, as a share of the climate's."""
    scenario = dc.paper.scenario(coast=None)
    scenario = scenario.replace(duration=LEADS[-1] * 24 / scenario.hours_per_unit)
    times = LEADS * 24 / scenario.hours_per_unit
    scores: dict[tuple[str, bool], list[Any]] = {}
    seasons = []
    for season, climate in folds:
        for handed, issue in ((True, imperfect_forecast), (False, hindcast.from_climate)):
            found = hindcast.hindcast(
                [scenario],
                season,
                climate,
                issue=issue,
                times=times,
                seed=1000 * int(season.season[0]),
                **options,
            ).isel(scenario=0)
            for name in ("wind", "position"):
                members = found[name].transpose("member", "release", "time", "component")
                truth = found[f"observed_{name}"].transpose("release", "time", "component")
                score = verification.crps(members, truth).mean(axis=-1)
                scores.setdefault((name, handed), []).append(score)
        seasons.append(found["season"].to_numpy())
    groups = np.concatenate(seasons)
    wind, drift = (
        verification.score_ratio(
            *(np.concatenate(scores[name, handed]) for handed in (True, False)), groups
        ).assign_coords(lead=LEADS)
        for name in ("wind", "position")
    )
    return wind, drift


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the cases")
    parser.add_argument("--record", type=Path, default=RECORD)
    parser.add_argument("--figures", type=Path, help="folder to write the figures to")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", DriftCoreWarning)
    quick = arguments.quick
    members = 100 if quick else 150
    real = dc.read_record(arguments.record, (6, 7, 8)) if arguments.record.is_file() else None
    if real is None:
        print(f"The real record is not at {arguments.record}: that part is left out.\n")

    years = 8 if quick else 30
    record = embedded(6 if quick else 20)
    cases = {
        ("synthetic truth, summers never seen", SO_FAR): fresh(years),
        ("synthetic record, one summer left out", SO_FAR): leave_one_season_out(record, h=H),
    }
    if real is not None:
        by_summer = list(leave_one_season_out(real))
        cases |= {("Belle-Île, one summer left out", issued): by_summer for issued in ISSUES}
    found = {}
    rows = []
    for (name, issued), folds in cases.items():
        every = 4 if name.startswith("Belle") and not quick else 11
        part = forecasts(folds, issue=ISSUES[issued], every_days=every, members=members)
        events, reliability, ranks = verify(part)
        found[name, issued] = events, reliability, ranks
        inside = (reliability["observed"] >= reliability["low"]) & (
            reliability["observed"] <= reliability["high"]
        )
        attrs = reliability.attrs
        rows.append(
            [
                name,
                issued,
                f"{attrs['independent']}",
                f"{part.sizes['release']}",
                f"{int(inside.sum())} of {inside.size}",
                f"{attrs['p_value']:.2f}",
                *(f"{attrs[key]:.4f}" for key in ("brier", "reliability", "resolution")),
                f"{attrs['uncertainty']:.4f}",
                f"{attrs['skill']:.2f}",
                f"{ranks.attrs['p_value']:.2f}",
            ]
        )
        print(*rows[-1], sep=" | ", flush=True)
    known_law = found[next(iter(cases))][0]
    odds = known_law["probability"] ** 2
    sharpened = odds / (odds + (1 - known_law["probability"]) ** 2)
    strong = forecasts(fresh(years, 1.15), every_days=11, members=members)
    must_fail = {
        "odds squared: too sure": known_law.assign(probability=sharpened),
        "wind of the climate 15 % too strong": verify(strong)[0],
    }
    for name, events in must_fail.items():
        groups = np.broadcast_to(events["season"].to_numpy()[:, None], events["happened"].shape)
        wrong = verification.reliability(events["probability"], events["happened"], 10, groups)
        print(f"Must not pass: {name}: p = {wrong.attrs['p_value']:.4f}", flush=True)
    head = ["truth", "known at the release", "summers", "releases", "bins in their bands", "p"]
    head += ["Brier", "reliability", "resolution", "uncertainty", "skill", "p, ranks"]
    print("\n" + table(head, rows) + "\n")
    for (name, issued), (_, reliability, _) in found.items():
        if issued == SO_FAR:
            print(f"{name}:\n")
            print(reliability.to_dataframe().round(3).to_string() + "\n")
    by_group, by_case = false_alarms(known_law, 6)
    print(f"False alarms at 5 % of six calibrated summers: {by_group:.3f}; ", end="")
    print(f"as if cases were independent: {by_case:.3f}\n", flush=True)

    skills = {"synthetic truth": hand_over_skill(fresh(years), every_days=14, members=members)}
    if real is not None:
        every = 14 if quick else 4
        skills["Belle-Île"] = hand_over_skill(by_summer, every_days=every, members=members)
    shown = [1.0, 3.0, 5.0, 10.0, 15.0, 20.0]
    rows = [
        [
            name,
            what,
            *(
                f"{ratio:.3f} [{low:.3f}–{high:.3f}]"
                for ratio, low, high in zip(
                    *(curve[key].sel(lead=shown).to_numpy() for key in ("ratio", "low", "high")),
                    strict=True,
                )
            ),
        ]
        for name, pair in skills.items()
        for what, curve in zip(("wind", "drift position"), pair, strict=True)
    ]
    print(table(["truth", "of", *(f"{day:g} d" for day in shown)], rows))
    if arguments.figures:
        shown_cases = {name: part for (name, issued), part in found.items() if issued == SO_FAR}
        draw(shown_cases, skills, arguments.figures)


def draw(found: dict[str, Any], skills: dict[str, Any], folder: Path) -> None:
    """Draw the three figures."""
    width = len(found)
    diagrams = drawing.new_figure((7.0, 7.0 / width + 0.55))
    ranks = drawing.new_figure((7.0, 2.6))
    for k, (panels, function) in enumerate(
        ((diagrams, plot.reliability_diagram), (ranks, plot.pit_histogram))
    ):
        for axes, (name, parts) in zip(
            panels.subplots(1, width, sharey=True), found.items(), strict=True
        ):
            dataset = parts[1 + k]
            function(dataset, axes)
            attrs = dataset.attrs
            words = f"{attrs['independent']} summers, {attrs['cases']:,} cases, p = "
            axes.set_title(
                "\n".join([*name.split(", "), f"{words}{attrs['p_value']:.2f}"]),
                fontsize=drawing.SMALL,
            )
            axes.label_outer()
    figures = {"reliability": diagrams, "pit": ranks, "hand_over_skill": skill_figure(skills)}
    drawing.save_figures(figures, folder, overwrite=True)


def skill_figure(skills: dict[str, Any]) -> Any:
    """Draw wind and drift side by side."""
    curves = drawing.new_figure((7.0, 3.0))
    panels = curves.subplots(1, 2, sharey=True)
    for axes, title, k in zip(panels, ("10 m wind", "drift position"), (0, 1), strict=True):
        plot.score_ratios(
            {name: pair[k] for name, pair in skills.items()},
            "lead [days]",
            "CRPS, handed over / climate",
            axes,
        )
        axes.axvline(HORIZON / 4, color="0.5", linewidth=0.8, linestyle=":")
        axes.text(
            HORIZON / 4 - 0.2, 1.09, "horizon", ha="right", fontsize=drawing.SMALL, color="0.3"
        )
        axes.set(ylim=(0, 1.2), xticks=np.arange(0, 21, 5))
        axes.set_title(title, fontsize=drawing.TITLE)
        axes.label_outer()
    return curves


if __name__ == "__main__":
    main()
