"""What `driftcore.validation` measured, in words and figures: Markdown, JSON and PNG."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from driftcore import _core, paper, plot
from driftcore.ensemble_winds import member_path
from driftcore.forecast import forecast
from driftcore.markdown import bullets, paragraphs, table
from driftcore.trajectories import trajectory
from driftcore.validation import (
    FULL,
    FULL_A,
    FULL_B,
    FULL_EXPANDED,
    MEAN_FLOW_1,
    MEAN_FLOW_2,
    PAPER,
    PAPER_WITHOUT,
    REQUIRED,
    SAMPLES,
    TIDES,
    TIDES_OF_ORDERS,
    WINDOWS,
    Case,
    Floats,
    Validation,
    order_cases,
    paper_cases,
    printed_numbers,
    sample_times,
    slope,
)
from driftcore.validation_wind import EMBEDDED
from driftcore.validation_wind_report import exact_in_law, law_of_the_wind, likelihood_figure

if TYPE_CHECKING:
    import xarray as xr

    from driftcore.scenario import Scenario
    from driftcore.wind import WindPath

REPORT = "validation.md"
_NUMBERS, _FIGURES = "validation.json", "figures"
_NORMS = ("velocity", "position")
_WINDOW_NAMES = {0.1: "ε/10", 0.5: "ε/2", 1.0: "ε", 4.0: "4ε"}


def write(validation: Validation, folder: Path) -> None:
    """Write the report, its numbers and its figures.

    Parameters
    ----------
    validation : Validation
        What was measured.
    folder : Path
        An existing folder; `validation.md`, `validation.json` and `figures/` go there.
    """
    about = {
        "version": _core.VERSION,
        "date": datetime.now(UTC).date().isoformat(),
        "machine": machine(),
    }
    member = _typical_member(validation)
    sections = [
        _heading(validation, about),
        _required(validation),
        _tables(validation),
        _orders(validation),
        _cost(validation),
        _strandings(validation),
        law_of_the_wind(
            validation.laws,
            validation.wrong,
            validation.effort.summers,
            f"{_FIGURES}/likelihood.png",
        ),
        exact_in_law(validation.exact),
        _figures(validation, member),
    ]
    _draw(validation, member, folder / _FIGURES)
    (folder / REPORT).write_text("\n\n".join(sections) + "\n", encoding="utf-8")
    numbers = json.dumps({**about, **_rounded(validation.to_dict())}, ensure_ascii=False, indent=1)
    (folder / _NUMBERS).write_text(numbers + "\n", encoding="utf-8")


def machine() -> str:
    """Describe processor, operating system and Python."""
    processor = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():  # Linux alone
        named = [
            line.partition(":")[2].strip()
            for line in cpuinfo.read_text(encoding="utf-8").splitlines()
            if line.startswith("model name")
        ]
        processor = named[0] if named else processor
    return (
        f"{processor}, {os.cpu_count()} processors, {platform.system()}, "
        f"Python {platform.python_version()}"
    )


def _heading(v: Validation, about: dict[str, str]) -> str:
    command = "driftcore validate" + (" --full" if v.effort == FULL else "")
    command += "".join(f" --record {name}" for name in _records(v))
    return "# Validation\n\n" + paragraphs(
        f"""
        What driftcore's models do on the paper's case: measured and written by `{command}`,
        nothing is edited by hand. Version {about["version"]}, {about["date"]};
        {about["machine"]}; measured in {v.seconds:.0f} s. All numbers:
        [{_NUMBERS}]({_NUMBERS}).
        """,
        f"""
        "Paper" is Ailliot, Frénod & Monbet (2006), sections 4 and 5; the models are those of
        [equations.md](equations.md). The sea is the paper's (4.1)–(4.2), the release (1, 1) at
        rest, one unit of time the run, ε the tide's share of it. **The winds are not the
        paper's**: members 0 to {v.effort.winds - 1} of the embedded climate, which is synthetic.
        An error is the largest Euclidean distance from the full model over the run, in scenario
        units, as in the paper. Entries are means over the winds, with [least, greatest].
        """,
        f"""
        The full model is solved to a relative tolerance of 1e-11, the averaged ones to 1e-8.
        Errors are looked at 60 times per tide (without wind 400 times), and just before and after
        each start of a tide, where the paper's terms $B_W$ jump. With 400 times, and a tolerance
        100 times smaller for the averaged models, no error of member 0 at ε = 1/50 changes by more
        than {100 * v.resolution:.1g} %.
        """,
    )


def _records(v: Validation) -> list[str]:
    """Give the names of the records beside the embedded one."""
    return sorted({one.name for one in v.laws} - {EMBEDDED})


def _required(v: Validation) -> str:
    rows = [
        [c.name, f"{c.measured:.4g}", c.required, "yes" if c.passed else "**no**"] for c in v.checks
    ]
    beyond = []
    for (order, limits), norm in product(REQUIRED.items(), _NORMS):
        errors = v.errors[Case(50, "mean-flow", order)]
        values, limit = getattr(errors, norm), limits[norm]
        count = int((values > limit).sum())
        if count:
            likeness = np.corrcoef(errors.eastmost, values)[0, 1]
            beyond.append(
                f"Of mean-flow order {order}, {count} of the {len(values)} {norm} errors lie above "
                f"{limit:g}, the greatest at {values.max():.3g}. These winds blow the body far "
                "east, where the paper's tide, in proportion to x, is stronger: error and "
                f"easternmost position correlate to {likeness:.2f}."
            )
    words = paragraphs(
        f"""
        The figures for ε = 1/50 with wind are compared with means over the winds, since the
        paper's own (0.0023 in position, 0.0460 in velocity) are such means.
        {" ".join(beyond) or "The greatest errors meet them as well."}
        """,
        """
        Errors without wind must round to what SciPy's DOP853 found from the same equations before
        driftcore was written. Orders may differ from the theory's by 0.1. Averaging may change the
        probability of stranding by a tenth of the half-width of its interval. What is required of
        the winds is told in [their section](#the-law-of-the-wind) and
        [the one after it](#exact-in-law).
        """,
    )
    found = table(["what", "measured", "required", "met"], rows)
    return f"## Measured against required\n\n{found}\n\n{words}"


def _tables(v: Validation) -> str:
    parts = [
        f"### ε = 1/{tides} (paper, table {1 if tides == 50 else 2})\n\n{_printed_table(v, tides)}"
        for tides in (50, 100, 25)
    ]
    rows = [
        [
            f"1/{tides}",
            str(order),
            *(_spread(getattr(v.errors[Case(tides, "mean-flow", order)], n)) for n in _NORMS),
        ]
        for tides, order in product(TIDES_OF_ORDERS, (1, 2))
    ]

    def smaller(norm: str, order: int, column: int) -> str:
        printed = printed_numbers(paper.PRINTED[50, 0.1][column])[0]
        return _two_digits(printed / v.mean(Case(50, "mean-flow", order), norm))

    begin = paragraphs(
        """
        The paper's entries, and ours by its expansion; order 1 with its wind terms $B_W$ and
        without. Order 0 has none.
        """
    )
    mean_flow = paragraphs(
        f"""
        It has no window: the wind enters by its exact integral. At ε = 1/{TIDES_OF_ORDERS[-1]}
        there are {v.effort.winds_of_orders} winds, and the run of 104 days is longer than the
        summer of the record, which goes on beyond its end.
        """,
        f"""
        At ε = 1/50 the velocity errors of orders 1 and 2 are {smaller("velocity", 1, 1)} and
        {smaller("velocity", 2, 1)} times smaller than those that the paper prints for order 1 and
        p = ε/10, the position errors {smaller("position", 1, 3)} and {smaller("position", 2, 3)}
        times.
        """,
    )
    return "\n\n".join(
        [
            "## The paper's tables",
            begin,
            *parts,
            "### The mean-flow expansion",
            mean_flow,
            table(["ε", "order", *_NORMS], rows),
            "### In words",
            _words_on_tables(v),
        ]
    )


def _printed_table(v: Validation, tides: int) -> str:
    def ours(zero: Case, one: Case) -> list[str]:
        return [
            text
            for norm in _NORMS
            for text in (
                _spread(getattr(v.errors[zero], norm), 4),
                _spread(getattr(v.errors[one], norm)),
            )
        ]

    rows = []
    for window in WINDOWS:
        zero, with_terms, without = paper_cases(tides, window)
        label = f"p = {_WINDOW_NAMES[window]}"
        if (tides, window) in paper.PRINTED:
            rows.append([label, "paper", *paper.PRINTED[tides, window]])
            label = ""
        rows.append([label, "ours", *ours(zero, with_terms)])
        velocity, position = (_spread(getattr(v.errors[without], norm)) for norm in _NORMS)
        rows.append(["", "ours, without B_W", "same", velocity, "same", position])
    label = "W ≡ 0"
    if (tides, None) in paper.PRINTED:
        rows.append([label, "paper", *paper.PRINTED[tides, None]])
        label = ""
    zero, one = (Case(tides, "paper", order, calm=True) for order in (0, 1))
    rows.append([label, "ours", *ours(zero, one)])
    columns = (f"{norm}, order {order}" for norm, order in product(_NORMS, (0, 1)))
    return table(["window", "", *columns], rows)


def _words_on_tables(v: Validation) -> str:
    def means(norm: str, window: float, *, terms: bool) -> list[float]:
        return [v.mean(Case(t, "paper", 1, window, wind_terms=terms), norm) for t in TIDES]

    def compared(norm: str, column: int) -> tuple[Floats, Floats]:
        """Mean errors of order 0 and the printed ones, windows up to a tide."""
        keys = [(t, w) for t, w in paper.PRINTED if w is not None and w <= 1]
        found = [v.mean(Case(t, "paper", 0, w), norm) for t, w in keys]
        return np.array(found), np.array(
            [printed_numbers(paper.PRINTED[k][column])[0] for k in keys]
        )

    position, printed_position = compared("position", 2)
    velocity, printed_velocity = compared("velocity", 0)
    ratio = velocity / printed_velocity
    equal = int(np.isclose(np.round(position, 4), printed_position).sum())
    apart = abs(position - printed_position).max()
    calm = v.errors[Case(50, "paper", 0, calm=True)]
    epsilon = [1 / t for t in TIDES]
    rows = []
    for window, (norm, column) in product((0.1, 0.5, 1.0), zip(_NORMS, (1, 3), strict=True)):
        printed = [printed_numbers(paper.PRINTED[t, window][column])[0] for t in TIDES]
        ours = [means(norm, window, terms=terms) for terms in (True, False)]
        exponents = [f"{slope(epsilon, errors):.2f}" for errors in (printed, *ours)]
        rows.append([f"p = {_WINDOW_NAMES[window]}", norm, *exponents])
    spoiled_velocity, spoiled_position = (
        means(norm, 0.1, terms=True)[1] / means(norm, 0.1, terms=False)[1] for norm in _NORMS
    )
    return "\n\n".join(
        [
            paragraphs(
                f"""
                **Order 0 agrees.** Without wind, at ε = 1/50, the position error is
                {calm.position[0]:.4f} here and {paper.PRINTED[50, None][2]} in the paper. With wind
                and windows up to a tide, {equal} of {len(position)} mean position errors are the
                printed ones to all four decimals, and none differs by more than {apart:.2g}.
                Velocity is {ratio.min():.3f} to {ratio.max():.3f} times what is printed, also
                without wind ({calm.velocity[0]:.4f} against {paper.PRINTED[50, None][0]}). At
                p = 4ε the error is what smoothing takes from the wind, and the winds differ.
                """,
                """
                **The paper's columns of order 1 do not fall like ε²**, although its text says so.
                Exponents of ε by regression of the means over ε = 1/25, 1/50, 1/100:
                """,
            ),
            table(["window", "order 1 of", "paper", "ours", "ours, without B_W"], rows),
            paragraphs(
                """
                Without $B_W$ ours do where the window is short. With windows in proportion to the
                tide the exponent sinks towards 1: $U^0$ follows the wind smoothed over p, which is
                an error of order p.
                """,
                f"""
                **$B_W$ spoils order 1.** At ε = 1/50 and p = ε/10 it makes the velocity error
                {spoiled_velocity:.0f} times and the position error {spoiled_position:.1f} times as
                large. The terms treat the wind as periodic in the tidal phase, which it is not.
                $U^0$ has followed the wind already, and $B_W$ counts its changes within the tide
                once more; what $B_W$ was at the release shifts the position for good
                ([equations.md, known limits](equations.md#known-limits)). That the paper's errors
                of order 1 without wind, 0.0096 and 0.0022 at ε = 1/50, exceed ours must have
                another cause, which its text does not tell.
                """,
                """
                **Misprints.** 0.680 in table 2 (ε = 1/100, p = 4ε) must be 0.0680. Those of the
                equations are listed in
                [equations.md, misprints](equations.md#misprints-of-the-paper); what is computed
                here has them corrected.
                """,
            ),
        ]
    )


def _orders(v: Validation) -> str:
    rows = [
        [label, str(power), *(f"{v.fitted_order(cases, norm):.2f}" for norm in _NORMS)]
        for label, power, cases in order_cases()
    ]
    steps = [[i.label, f"{i.order:.2f}"] for i in v.euler]
    return "\n\n".join(
        [
            "## Orders of convergence",
            paragraphs(
                f"""
                Exponent of ε by regression over 1/25, 1/50, 1/100, 1/200; with wind, of the mean
                over {v.effort.winds_of_orders} winds. All must lie within 0.1 of what is expected.
                """
            ),
            table(["model", "expected", *_NORMS], rows),
            paragraphs(
                """
                Exponent of the step in the position error of explicit Euler against the same model
                solved exactly, four finest steps, ε = 1/50 (expected: 1):
                """
            ),
            table(["model", "order"], steps),
            f"![Errors against ε, and against the work of the methods]({_FIGURES}/convergence.png)",
            paragraphs(
                """
                Above: mean errors of the models, with exponents. Below: mean errors of the methods
                at ε = 1/50, left explicit Euler, right Dormand–Prince at relative tolerances from
                0.03 to 1e-9. The curves of rewrites A and B lie on each other, as do those of
                mean-flow orders 1 and 2. Curves that are short have their longest step already,
                a tenth of a tide in the full model and a tide in the mean-flow ones, and a
                tolerance changes little. Dormand–Prince being adaptive, its orders are measured by
                the tests of the compiled core, `local_orders` in `rust/src/dopri5.rs`, by
                regression over seven step sizes: 5, of the embedded method 4, of the dense output
                4, each within 0.2.
                """
            ),
        ]
    )


def _cost(v: Validation) -> str:
    euler, adaptive = ({i.label: i for i in method} for method in (v.euler, v.dormand_prince))
    own = {label: v.mean(case, "position") for label, case in _averaged_cases().items()}
    printed = printed_numbers(paper.PRINTED[50, 0.5][3])[0]
    levels = [(PAPER, printed, "printed"), *((label, own[label], "ours") for label in own)]

    def counts(method: dict[str, Any], fulls: Sequence[str]) -> str:
        rows = []
        for label, level, source in levels:
            work = method[label].work_for(level)
            needed = [method[full].work_for(level) for full in fulls]
            cells = [f"{n:,.0f} (× {_two_digits(n / work)})" for n in needed]
            rows.append([label, f"{level:.2g} ({source})", f"{work:,.0f}", *cells])
        return table(["averaged model", "error E", "its own", *fulls], rows)

    def ratio(full: str, label: str, level: float) -> float:
        return euler[full].work_for(level) / euler[label].work_for(level)

    median = {label: float(np.median(times)) for label, times in v.step_costs.items()}
    costs = [
        [
            label,
            f"{1e6 * median[label]:.2f} [{1e6 * times.min():.2f},{1e6 * times.max():.2f}]",
            *(f"{median[label] / median[full]:.1f}" for full in (FULL_A, FULL_B)),
        ]
        for label, times in v.step_costs.items()
    ]
    windows = []
    for window in WINDOWS:
        cases = paper_cases(50, window)[1:]
        work = [f"{v.mean(c, unit):,.0f}" for c in cases for unit in ("steps", "evaluations")]
        windows.append([_WINDOW_NAMES[window], *work])
    evaluations = [v.mean(Case(50, "mean-flow", order), "evaluations") for order in (1, 2)]
    expanded = _two_digits(ratio(FULL_EXPANDED, PAPER, printed))
    expanded_mean_flow = _two_digits(ratio(FULL_EXPANDED, MEAN_FLOW_1, own[MEAN_FLOW_1]))
    rewriting = euler[FULL_EXPANDED].work_for(printed) / euler[FULL_A].work_for(printed)
    rest = _two_digits(ratio(FULL_A, PAPER, printed))
    rest_mean_flow = _two_digits(ratio(FULL_A, MEAN_FLOW_1, own[MEAN_FLOW_1]))
    fewer = adaptive[FULL_B].work_for(own[MEAN_FLOW_1]) / adaptive[MEAN_FLOW_1].work_for(
        own[MEAN_FLOW_1]
    )
    gain = {
        label: _two_digits(ratio(FULL_B, label, own[label]) * median[FULL_B] / median[label])
        for label in (PAPER_WITHOUT, MEAN_FLOW_1, MEAN_FLOW_2)
    }
    return "\n\n".join(
        [
            "## What averaging costs and saves",
            paragraphs(
                f"""
                The paper: by Euler's method the full system "requires about 1000 more iterations"
                than the averaged one at the same accuracy, and one of its iterations is 20 times
                cheaper. Here, at ε = 1/50, every model is integrated until the error of the
                integration is E, that of the averaging itself (in position; p = ε/2; medians over
                {v.effort.winds_of_costs} winds). In brackets: how many times the averaged model's
                count.
                """,
                "**Euler steps in a run**",
            ),
            counts(euler, (FULL_EXPANDED, FULL_A, FULL_B)),
            paragraphs(
                f"""
                "{FULL_EXPANDED}" is the paper's own form: unknowns X and V, and on the right-hand
                side the derivatives of the sea, of size 1/ε. Its counts beyond
                {euler[FULL_EXPANDED].work[0, -1]:,.0f} are extrapolated. Rewrites A and B are (4)
                and (5) of [equations.md](equations.md#the-full-model).
                """,
                f"""
                **Time of an Euler step** [µs], compiled; medians of {v.effort.rounds} rounds of one
                run, in each of which the models take turns:
                """,
            ),
            table(["model", "median [least, greatest]", "over A", "over B"], costs),
            paragraphs(
                """
                **Evaluations of the right-hand side by Dormand–Prince**, its tolerance chosen for
                the same errors:
                """
            ),
            counts(adaptive, (FULL_A, FULL_B)),
            paragraphs(
                f"""
                **Work of the paper's system against its window**, Dormand–Prince at a relative
                tolerance of 1e-8, means over {v.effort.winds} winds. Mean-flow orders 1 and 2 take
                {evaluations[0]:,.0f} and {evaluations[1]:,.0f} evaluations.
                """
            ),
            table(
                ["window", "steps", "evaluations", "steps, no B_W", "evaluations, no B_W"], windows
            ),
            "What this says:",
            bullets(
                f"""
                In the paper's own form the full system needs {expanded} times the Euler steps of
                the paper's averaged one at the error that the paper prints, and
                {expanded_mean_flow} times those of mean-flow order 1 at its error. "About 1000" is
                of the right size.
                """,
                f"""
                The exact rewrites change the comparison. With no derivative of the sea and no 1/ε
                on the right-hand side they need {rewriting:.0f} times fewer steps than the paper's
                form before anything is averaged. What is left for averaging to save is
                {rest} times the steps for the paper's system, {rest_mean_flow} times for the
                mean-flow expansion.
                """,
                f"""
                A step of the paper's averaged system takes {median[PAPER] / median[FULL_A]:.1f}
                times the time of one of rewrite A (the paper: 20 times that of its own form),
                without $B_W$ {median[PAPER_WITHOUT] / median[FULL_A]:.1f} times, a step of
                mean-flow order 1 {median[MEAN_FLOW_1] / median[FULL_A]:.1f} times. This depends on
                the sea, as the paper says; here it is a formula.
                """,
                f"""
                Together, Euler's method by rewrite B takes {gain[PAPER_WITHOUT]} times as long as
                by the paper's system without $B_W$, {gain[MEAN_FLOW_1]} times as long as by
                mean-flow order 1 and {gain[MEAN_FLOW_2]} times as long as by order 2, each at that
                model's error.
                """,
                f"""
                What limits Dormand–Prince here is the longest step allowed: a tenth of a tide in
                the full model, a tide in the averaged ones. At those the errors of the full and the
                mean-flow model are far below E already; the paper's system, whose right-hand side
                is as rough as the wind, just meets it. Mean-flow order 1 then needs
                {_two_digits(fewer)} times fewer evaluations than rewrite B, which together take
                {_two_digits(fewer * median[FULL_B] / median[MEAN_FLOW_1])} times less time.
                """,
                """
                The wider the window, the cheaper the paper's system, as the paper says, and the
                less accurate. The mean-flow expansion needs no such choice.
                """,
            ),
        ]
    )


def _strandings(v: Validation) -> str:
    def numbers(values: Iterable[float]) -> str:
        return ", ".join(f"{value:.2g}" for value in values)

    rows = [
        [
            s.label,
            str(s.probability),
            str(s.different),
            numbers([*np.quantile(s.delay, (0.5, 0.95)), s.delay.max()]) if len(s.delay) else "–",
            numbers([np.median(s.distance), s.distance.max()]) if len(s.delay) else "–",
            f"{s.seconds:.1f}",
        ]
        for s in v.strandings
    ]
    header = [
        "model",
        "strands [95 % interval]",
        "decided differently",
        "delay [tides]: median, 95 %, greatest",
        "distance: median, greatest",
        "time [s]",
    ]
    full, order_1, *_ = v.strandings
    late = int((order_1.delay > 0.5).sum())
    return "\n\n".join(
        [
            "## Stranding: the full model and the averaged ones",
            paragraphs(
                f"""
                The same {v.effort.members:,} winds, ε = 1/50, the paper's circle; each model beside
                the full one. "Decided differently" counts the members that strand in one and not in
                the other; delay and distance are those of strandings in both.
                """
            ),
            table(header, rows),
            paragraphs(
                f"""
                Mean-flow order 1 decides {order_1.different} of {v.effort.members:,} members
                differently and moves {late} strandings by more than half a tide: a body that a
                tide carries to within the error of the coast touches it in that tide or in another.
                The paper found {100 * paper.PRINTED_STRANDING:.1f} % stranded under its own winds;
                under the embedded climate the full model has {100 * full.probability.estimate:.1f}
                %. Times are of one run on all processors, drawing the winds included, no
                trajectories kept.
                """
            ),
        ]
    )


def _figures(v: Validation, member: int) -> str:
    errors = v.errors[Case(50, "paper", 1, 0.5, wind_terms=True)]
    in_epsilon_squared = errors.position[member] * 50**2

    def figure(name: str, title: str, caption: str) -> str:
        return f"![{title}]({_FIGURES}/{name}.png)\n\n{paragraphs(caption)}"

    return "\n\n".join(
        [
            "## The paper's figures",
            paragraphs(
                f"""
                The panels of the paper's figures, ε = 1/50. In the first three p = ε/2 and order 1
                with $B_W$, as in the paper, and member {member}, whose position error is the
                median over {len(errors.position)} winds.
                """
            ),
            figure(
                "member_plane",
                "A trajectory in the plane",
                """
                Figure 1. A trajectory in the plane. Solid: full model; dotted: reconstruction
                $X^0 + εX^1$; dashed: average path $Y^0 + εY^1$.
                """,
            ),
            figure(
                "member_position",
                "Wind, position and its error against time",
                f"""
                Figure 2. First component of the wind and of the position (solid: full model;
                dashed: average path), and the error. The error reaches {in_epsilon_squared:.1f} ε²;
                in the paper's example it is about 2.5 ε².
                """,
            ),
            figure(
                "member_velocity",
                "Smoothed wind, velocity and its error against time",
                """
                Figure 2-1. First component of the smoothed wind and of the velocity (solid: full
                model; dashed: average), and the error. It grows and falls back with $B_W$, which
                starts anew with each tide.
                """,
            ),
            figure(
                "trajectories",
                "Trajectories and stranding points",
                f"""
                Figure 3. The first 100 of {v.effort.members:,} trajectories (mean-flow order 1) and
                their stranding points.
                """,
            ),
            figure(
                "roses",
                "Roses of the wind and of the strandings",
                f"""
                Figure 4. Wind and stranding points of all {v.effort.members:,} members. In the
                paper most of the wind comes from the north, and most bodies strand in the
                south-south-west; the embedded climate's wind is westerly, and they strand in the
                east.
                """,
            ),
            figure(
                "stranding_times",
                "Probability of stranding against time",
                "Not in the paper: when they strand.",
            ),
            figure(
                "estimate",
                "Probability of stranding against the number of members",
                "Not in the paper: how the estimate settles, with its 95 % interval.",
            ),
        ]
    )


def _draw(v: Validation, member: int, folder: Path) -> None:
    from matplotlib.figure import Figure

    scenario = paper.scenario(1 / 50)
    plot.save_all(forecast(scenario, members=v.effort.members).dataset, folder)
    plot.save_member(*_followed(scenario, member), folder)
    figure = Figure(figsize=(7.0, 8.2), layout="compressed")
    panels = figure.subplots(2, 2)
    for panel, norm, column in zip(panels[0], _NORMS, (1, 3), strict=True):
        plot.convergence(_epsilon_curves(v, norm, column), "ε", f"{norm} error", panel)
        panel.set_xticks([1 / t for t in TIDES_OF_ORDERS], [f"1/{t}" for t in TIDES_OF_ORDERS])
        panel.minorticks_off()
    for panel, method, work in zip(
        panels[1], (v.euler, v.dormand_prince), ("Euler steps", "evaluations"), strict=True
    ):
        curves = {i.label: (i.work.mean(axis=0), i.error.mean(axis=0)) for i in method}
        plot.convergence(curves, f"{work} in the run", "position error of the method", panel)
    figure.savefig(folder / "convergence.png", dpi=200)
    likelihood_figure(v.laws).savefig(folder / "likelihood.png", dpi=200)
    for image in folder.glob("*.png"):
        _use_palette(image)


def _followed(scenario: Scenario, member: int) -> tuple[xr.Dataset, xr.Dataset, WindPath]:
    """Follow a member by the full model and by the paper's expansion, as in its figures."""
    wind = paper.default_wind()
    path = member_path(scenario, wind, member)
    times = sample_times(round(1 / scenario.epsilon), SAMPLES)
    full = trajectory(scenario, path, model="full", times=times)
    averaged = trajectory(scenario, path, times=times, **_averaged_cases()[PAPER].settings())
    for dataset in (full, averaged):
        dataset.attrs["wind_label"] = wind.record.label
        dataset.attrs["wind_synthetic"] = int(wind.record.synthetic)
    return full, averaged, path


def _use_palette(path: Path) -> None:
    """Keep 128 colours of a figure, which makes the file a third as large."""
    from PIL import Image

    with Image.open(path) as image:
        reduced = image.convert("RGB").quantize(128, dither=Image.Dither.NONE)
    reduced.save(path, optimize=True)


def _epsilon_curves(v: Validation, norm: str, column: int) -> dict[str, tuple[Any, Any]]:
    """Mean errors against ε by model, the exponent in its label."""
    settings: dict[str, dict[str, Any]] = {
        "paper order 0": {"model": "paper", "order": 0, "window": 0.1},
        PAPER: {"model": "paper", "order": 1, "window": 0.1, "wind_terms": True},
        PAPER_WITHOUT: {"model": "paper", "order": 1, "window": 0.1},
        MEAN_FLOW_1: {"model": "mean-flow", "order": 1},
        MEAN_FLOW_2: {"model": "mean-flow", "order": 2},
    }
    curves: dict[str, tuple[Any, Any]] = {}
    for label, chosen in settings.items():
        cases = [Case(tides, **chosen) for tides in TIDES_OF_ORDERS]
        curve = [1 / case.tides for case in cases], [v.mean(case, norm) for case in cases]
        curves[f"{label}: {v.fitted_order(cases, norm):.2f}"] = curve
        if chosen["order"] == 0:
            # Second, so that every averaged model has one colour in all panels.
            printed = [printed_numbers(paper.PRINTED[t, 0.1][column])[0] for t in TIDES]
            epsilon = [1 / t for t in TIDES]
            curves[f"paper order 1, as printed: {slope(epsilon, printed):.2f}"] = epsilon, printed
    return curves


def _averaged_cases() -> dict[str, Case]:
    """Give the averaged models whose cost is measured."""
    return {
        PAPER: Case(50, "paper", 1, 0.5, wind_terms=True),
        PAPER_WITHOUT: Case(50, "paper", 1, 0.5),
        MEAN_FLOW_1: Case(50, "mean-flow", 1),
        MEAN_FLOW_2: Case(50, "mean-flow", 2),
    }


def _typical_member(v: Validation) -> int:
    """Member whose position error by the paper's expansion is the (lower) median."""
    errors = v.errors[_averaged_cases()[PAPER]].position
    return int(np.argsort(errors)[(len(errors) - 1) // 2])


def _spread(values: Floats, decimals: int | None = None) -> str:
    """Word a mean with its extremes as the paper does; three digits unless decimals are given."""

    def word(value: float) -> str:
        return f"{value:#.3g}" if decimals is None else f"{value:.{decimals}f}"

    mean = word(float(values.mean()))
    return mean if len(values) == 1 else f"{mean} [{word(values.min())},{word(values.max())}]"


def _two_digits(value: float) -> str:
    """Word a ratio with two digits and no exponent."""
    return f"{value:.1f}" if value < 9.95 else f"{float(f'{value:.2g}'):,.0f}"


def _rounded(value: Any) -> Any:
    """Round every number within to six digits: beyond them there is noise."""
    match value:
        case dict():
            return {key: _rounded(item) for key, item in value.items()}
        case list():
            return [_rounded(item) for item in value]
        case float():
            return float(f"{value:.6g}")
    return value
