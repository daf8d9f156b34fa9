"""What `driftcore.validation_wind` measured, in words and a figure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from driftcore import law, plot
from driftcore.check import Check
from driftcore.markdown import paragraphs, table
from driftcore.validation_wind import DEFAULT, FORGETFUL, STRONG, ExactInLaw, LawOfWind
from driftcore.wind import WIDEST_RESIDUAL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOMENTS = ("E value", "E integral [h]", "Var value", "Cov [h]", "Var integral [h²]")


def law_of_the_wind(
    laws: Sequence[LawOfWind], wrong: dict[str, list[Check]], summers: int, figure: str
) -> str:
    """Word the section.

    Parameters
    ----------
    laws : sequence of LawOfWind
        In pairs of modes, one pair per record.
    wrong : dict
        Checks of the wrong generators.
    summers : int
        Which those were fitted to.
    figure : str
        Path of the figure of the likelihoods.
    """
    fits = [
        [
            one.wind.record.describe() if k % 2 == 0 else "",
            str(one.seasons) if k % 2 == 0 else "",
            one.wind.mode,
            f"{one.wind.h:.3f}",
            "" if one.wind.b is None else f"{one.wind.b:.3f}",
        ]
        for k, one in enumerate(laws)
    ]
    return "\n\n".join(
        [
            "## The law of the wind",
            paragraphs(
                """
                The winds of an ensemble are resampled from a record, (18)–(20) of
                [equations.md](equations.md). Do they have the law of the record, without copying
                it? Two modes are asked: `residual`, which is the default, and `lgb`, the paper's.
                """
            ),
            table(["record", "seasons", "mode", "h", "b"], fits),
            paragraphs(
                """
                200 simulated seasons are compared with the record. z is the difference in standard
                errors of the record, which drawing whole seasons of it with replacement tells; of
                a family of statistics the largest |z| counts. T6 follows 200 members from the
                windiest state of the record. T8 counts the values of 12 members that change when
                they are simulated one by one or five at a time, for fewer steps, and in forecasts
                on one, two and three threads. T9 draws 20,000 rows at each of eight states and
                compares their numbers with the weights by χ².
                """
            ),
            _results(laws),
            paragraphs(_words_on_bands(laws), _words_on_copies(laws)),
            paragraphs(
                """
                Known limit: a Markov model of so low an order underestimates the memory beyond four
                days, which T1 lets pass with a wider band.
                """
            ),
            "### What finds a wrong wind",
            paragraphs(
                f"""
                Generators that are wrong in a known way, fitted to {summers} summers of the
                embedded climate, and which tests they fail. Each must fail one at least.
                """
            ),
            _found_out(wrong),
            paragraphs(
                """
                Copies pass every test of marginals and memory: T4 to T6 are there for them. T8 and
                T9 ask the compiled sampler itself. That T9 sees a bandwidth that is wrong by 3 %,
                and a light tail of the weights, is tested in `tests/test_bootstrap.py`.
                """
            ),
            "### The bandwidths",
            paragraphs(*_words_on_bandwidths(laws)),
            _residual_likelihoods([one for one in laws if one.wind.mode == "residual"]),
            *(
                part
                for one in laws
                if one.wind.mode == "lgb"
                for part in (
                    f"Mode `lgb`, {one.name}: h in rows, b in columns.",
                    _lgb_likelihoods(one),
                )
            ),
            f"![Log-likelihood against the bandwidth]({figure})",
            paragraphs(
                """
                How far the log-likelihood is below its greatest; stars: what was chosen. Left:
                mode `residual`, the dashed line is the widest kernel accepted. Right: mode `lgb`,
                with the b that was chosen.
                """
            ),
        ]
    )


def _results(laws: Sequence[LawOfWind]) -> str:
    def cell(one: LawOfWind, check: Check) -> str:
        number = f"{check.measured:.3g}"
        if check.passed:
            return number
        return f"{number} (warns)" if one.warns(check) else f"**{number}**"

    header, columns = ["test"], []
    for k, one in enumerate(laws):
        checks = sorted(one.checks, key=lambda check: check.name[:2])
        if k == 0:
            columns.append([check.name for check in checks])
        if k % 2 == 0:
            header.append(f"required, {one.name}")
            columns.append([check.required for check in checks])
        header.append(f"`{one.wind.mode}`")
        columns.append([cell(one, check) for check in checks])
    return table(header, zip(*columns, strict=True))


def _words_on_bands(laws: Sequence[LawOfWind]) -> str:
    few = {one.name: one.seasons for one in laws if one.seasons < law.MANY_SEASONS}
    if not few:
        return (
            f"The bands of T1 and T2 are those for {law.MANY_SEASONS} seasons or more. They are "
            "stricter than what another record of the same law would pass, as may be asked of a "
            "generator that was fitted to this one."
        )
    ((name, seasons),) = few.items()
    bands = ", ".join(f"{word} {law.limit(key, seasons):.3g}" for word, key in law.FAMILIES.items())
    strict = ", ".join(f"{law.limit(key, law.MANY_SEASONS):.3g}" for key in law.FAMILIES.values())
    return f"""
        **The bands of {name} are wider.** The {seasons} seasons of {name} tell their own standard
        errors poorly, and even a generator of exactly their law shows |z| far above 3. So the bands
        of T1 and T2 are the 99 % quantiles of what so short records show beside 200 seasons of
        their own law: a parametric bootstrap of the embedded climate, every 6 h,
        `driftcore.law.calibrate`, with 6 and with 10 seasons, in between interpolated. Here they
        are: {bands}. Of {law.MANY_SEASONS} seasons or more, as the embedded climate has, they are
        {strict} in the same order. Behind bands so wide only gross errors show.
        """


def _words_on_copies(laws: Sequence[LawOfWind]) -> str:
    copying = [one for one in laws if any(one.warns(c) and not c.passed for c in one.checks)]
    if not copying:
        return "Neither mode copies its record (T4)."
    found = []
    for one in copying:
        share, longest = (
            next(check.measured for check in one.checks if check.name == name)
            for name in (law.CONTINUED, law.LONGEST)
        )
        days = longest * one.wind.record.step_h / 24
        found.append(
            f"{100 * share:.0f} % of the draws continue {one.name}, for up to {days:.1f} days"
        )
    return f"""
        **Mode `lgb` copies long stretches**, and T4 only warns of it, where the default mode must
        pass: {"; ".join(found)}. In its narrow kernel there is often one row alone, the one that
        followed in the record. Its noise makes the values new (T5), not the sequence of weather: it
        is there to compare with the paper.
        """


def _found_out(wrong: dict[str, list[Check]]) -> str:
    tests = sorted({check.name[:2] for checks in wrong.values() for check in checks})
    rows = []
    for name, checks in wrong.items():
        failed = {check.name[:2] for check in checks if not check.passed}
        rows.append([name, *("fails" if test in failed else "" for test in tests)])
    return table(["generator", *tests], rows)


def _words_on_bandwidths(laws: Sequence[LawOfWind]) -> list[str]:
    widest = []
    for one in laws:
        if one.wind.mode == "residual":
            likelihood = one.wind.likelihood
            best = likelihood["h"][likelihood["log_likelihood"].argmax()]
            edge = ", the widest tried," if best == likelihood["h"].max() else ""
            widest.append(f"{best:.2g}{edge} for {one.name}")
    return [
        """
        h and b are those of the greatest log-likelihood of a season given the others, mean over the
        values [nats]. In bold: what was chosen.
        """,
        f"""
        In mode `residual` h is capped at {WIDEST_RESIDUAL:g}. The likelihood looks one step ahead
        and would have h = {" and ".join(widest)}; over a long series so wide a kernel forgets how
        the changes of the wind depend on its state, and the quantiles of the simulated speeds err
        the more, the wider it is: with h = 2.5 quantiles, rose and persistence of the real record
        are missed (`tests/test_law.py`). A narrow one copies the record (T4). In mode `lgb` the
        caps of h and b, the last row and column of its tables, follow from the standard error of
        the correlation at one step and from the variance that noise may add; the likelihood, to
        which the noise is too narrow, would go beyond both.
        """,
    ]


def _residual_likelihoods(laws: Sequence[LawOfWind]) -> str:
    rows = [
        [
            _marked(f"{h:.3f}", any(h == one.wind.h for one in laws)),
            *(
                _marked(f"{one.wind.likelihood['log_likelihood'][k]:.4f}", h == one.wind.h)
                for one in laws
            ),
        ]
        for k, h in enumerate(laws[0].wind.likelihood["h"])
    ]
    return table(["h, mode `residual`", *(one.name for one in laws)], rows)


def _lgb_likelihoods(one: LawOfWind) -> str:
    found = one.wind.likelihood
    b_tried = np.unique(found["b"])
    rows = [
        [
            f"{h:.3f}",
            *(
                _marked(
                    f"{found['log_likelihood'][(found['h'] == h) & (found['b'] == b)][0]:.4f}",
                    (h, b) == (one.wind.h, one.wind.b),
                )
                for b in b_tried
            ),
        ]
        for h in np.unique(found["h"])
    ]
    return table(["h", *(f"b = {b:.3f}" for b in b_tried)], rows)


def _marked(words: str, chosen: bool) -> str:
    return f"**{words}**" if chosen else words


def likelihood_figure(laws: Sequence[LawOfWind]) -> Figure:
    """Draw how far the log-likelihood is below its greatest against h, one panel per mode."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.4), layout="compressed")
    for panel, mode in zip(figure.subplots(1, 2), ("residual", "lgb"), strict=True):
        curves, chosen = {}, {}
        for one in laws:
            if one.wind.mode == mode:
                found = one.wind.likelihood
                if mode == "lgb":
                    found = found[found["b"] == one.wind.b]
                below = found["log_likelihood"] - found["log_likelihood"].max()
                curves[one.name] = found["h"], below
                chosen[one.name] = one.wind.h, below[found["h"] == one.wind.h][0]
        words = "log-likelihood less its greatest [nats]"
        plot.likelihood(curves, chosen, f"h, mode {mode}", words, panel)
        if mode == "residual":
            panel.axvline(WIDEST_RESIDUAL, color="0.4", linestyle="--", linewidth=0.8)
    return figure


def exact_in_law(exact: ExactInLaw) -> str:
    """Word the section."""
    moments, counts = [], []
    for scale, (coarse, brute) in exact.moments.items():
        counts.append(f"{scale.memory_h:g} h")
        numbers = zip(
            _MOMENTS, coarse.listed(), brute.listed(), coarse.z_scores(brute), strict=True
        )
        for k, (name, found, expected, z) in enumerate(numbers):
            memory = f"{scale.memory_h:g} h" if k == 0 else ""
            moments.append([memory, name, f"{found:.4f}", f"{expected:.4f}", f"{z:.2f}"])
    strandings = [
        [
            f"{100 * coarse.share:g} %, {coarse.memory_h:g} h",
            f"{100 * brute.share:g} %, {brute.memory_h:g} h",
            f"{np.isfinite(exact.strandings[coarse]).mean():.3f}",
            f"{np.isfinite(exact.brute_strandings[brute]).mean():.3f}",
            f"{exact.p_value(coarse, brute):.2g}",
        ]
        for coarse, brute in ((DEFAULT, DEFAULT), (STRONG, STRONG), (FORGETFUL, STRONG))
    ]
    members = len(exact.strandings[DEFAULT])
    return "\n\n".join(
        [
            "## Exact in law",
            paragraphs(
                """
                The small-scale wind has a hundred steps in a tide. The core draws its value at each
                synoptic step and its integral over it, by (22) and (23) of
                [equations.md](equations.md), and fills in the path between them, (24), only where a
                model asks for it. Is this the law of the path simulated step by step, (4.3) of the
                paper?
                """,
                f"""
                **Moments** of value and integral after a synoptic step, memories
                {" and ".join(counts)}, standard deviation 1: the mean per unit of the value at the
                start, and the covariance of what the start does not determine. z is the difference
                in standard errors of both; |z| may reach 4.
                """,
            ),
            table(["memory", "moment", "as the core draws it", "step by step", "z"], moments),
            paragraphs(
                f"""
                **Stranding times** by mean-flow order 1, ε = 1/50: {members:,} members on coarse
                winds beside {members:,} under winds drawn independently, whose small scale is
                simulated step by step. Share of the total standard deviation and memory of both; p
                of the two-sample Kolmogorov–Smirnov test, bodies that stay afloat counting as the
                latest. Laws that are the same must have p ≥ 0.001. In the last row they are not,
                the memory on the coarse side being too short: there p must be below, or the test
                would see nothing.
                """
            ),
            table(
                ["coarse", "step by step", "strands, coarse", "strands, step by step", "p"],
                strandings,
            ),
        ]
    )
