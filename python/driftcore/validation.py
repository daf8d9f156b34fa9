"""What the models are measured to do on the paper's case, beside what is required of them.

Numbers only, those of the winds in `driftcore.validation_wind`; `driftcore.validation_report` puts
them into words and figures.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore import paper
from driftcore.check import Check
from driftcore.ensemble_winds import member_path
from driftcore.forecast import forecast
from driftcore.record import WindRecord
from driftcore.results import Forecast
from driftcore.scenario import ModelName, Scenario
from driftcore.statistics import Probability
from driftcore.trajectories import trajectory
from driftcore.validation_wind import (
    ExactInLaw,
    LawOfWind,
    exact_in_law,
    laws_of_wind,
    tests_that_find,
)
from driftcore.wind import WindPath

Floats = NDArray[np.float64]
Progress = Callable[[str], None]

TIDES = (25, 50, 100)  # in a run, 1/ε: those of the paper's tables
WINDOWS = (0.1, 0.5, 1.0, 4.0)  # averaging windows of the paper's tables [tides]
# The run of the orders, longest of all: four times shorter tides than in the first table.
TIDES_OF_ORDERS = (*TIDES, 200)
_NORMS = ("velocity", "position")

# Samples per tide: 60 find the greatest error to 0.2 % (measured against 400, see `resolution`).
SAMPLES, _FINE_SAMPLES = 60, 400
# The paper's system has a rough right-hand side: at 1e-6 its own error shows in the third digit.
_RTOL, _EXACT_RTOL = 1e-8, 1e-11
_CALM = WindPath([-1.0, 2.0], np.zeros((2, 2)))

# Largest mean error over the winds at ε = 1/50, by order of the mean-flow expansion.
REQUIRED = {1: {"velocity": 1.5e-3, "position": 7e-4}, 2: {"velocity": 4.5e-5, "position": 2e-5}}
# Errors without wind of the paper's expansion, orders 0 and 1 of velocity and of position, as found
# with SciPy's DOP853 before driftcore was written.
CALM = {
    25: ("0.2274", "0.00603", "0.0358", "0.00283"),
    50: ("0.1132", "0.00149", "0.0174", "0.00070"),
    100: ("0.0565", "0.00037", "0.0086", "0.00017"),
    200: ("0.0282", "0.00009", "0.0042", "0.00004"),
}
# Accepted distance of a measured order of convergence from the theory's.
_SLACK = 0.1
# Accepted change of the probability of stranding by averaging, as a share of the half-width of its
# interval: the error of the model is to be lost in that of the sampling.
_SHARE_OF_INTERVAL = 0.1


@dataclass(frozen=True)
class Effort:
    """How much is measured.

    Attributes
    ----------
    winds : int
        Members 0, 1, … of the embedded climate for the paper's tables.
    winds_of_orders, winds_of_costs, winds_of_printed : int
        As many of them for the orders of convergence, for the cost of integrating, and for the
        errors that are required to be those printed.
    members : int
        Members of the ensembles for the strandings.
    rounds : int
        Timings of each model; the median counts.
    halvings : int
        Halvings of the Euler step, from one tide on.
    paper_strandings : bool
        Follow the ensemble by the paper's system as well.
    summers : int
        Of the embedded climate, on which wrong generators of wind are tried; at least 6.
    small_scale_paths, small_scale_members : int
        Members whose small scale is compared with its simulation step by step: their winds, and
        their strandings.
    """

    winds: int = 100
    winds_of_orders: int = 20
    winds_of_costs: int = 5
    winds_of_printed: int = 1600
    members: int = 1000
    rounds: int = 15
    halvings: int = 10
    paper_strandings: bool = False
    summers: int = 6
    small_scale_paths: int = 40
    small_scale_members: int = 1000


DEFAULT = Effort()
FULL = Effort(
    winds_of_orders=100,
    winds_of_costs=10,
    rounds=45,
    halvings=12,
    paper_strandings=True,
    summers=20,
    small_scale_paths=200,
    small_scale_members=4000,
)


@dataclass(frozen=True)
class Case:
    """An averaged model, and what it is tried on.

    Attributes
    ----------
    tides : int
        Tides in the run, 1/ε.
    model, order, wind_terms
        As in `driftcore.trajectory`.
    window : float, optional
        Averaging window of the wind in tides, `"paper"` only.
    calm : bool
        Without wind.
    """

    tides: int
    model: ModelName
    order: int
    window: float | None = None
    wind_terms: bool = False
    calm: bool = False

    def settings(self) -> dict[str, Any]:
        """Keywords of `driftcore.trajectory`."""
        chosen: dict[str, Any] = {"model": self.model, "order": self.order}
        if self.model == "paper":
            chosen["wind_terms"] = self.wind_terms
            if self.window is not None:
                chosen["window"] = self.window / self.tides
        return chosen


@dataclass(frozen=True)
class Errors:
    """Largest distances over the run from the full model, one per wind, shape (winds,).

    Attributes
    ----------
    velocity, position : ndarray
        Euclidean norm, paper section 4.2 [scenario units].
    steps, evaluations : ndarray
        Work of the averaged model at relative tolerance 1e-8.
    eastmost : ndarray
        Greatest first component of the position; the tide is proportional to it.
    """

    velocity: Floats
    position: Floats
    steps: Floats
    evaluations: Floats
    eastmost: Floats


@dataclass(frozen=True)
class Integration:
    """One model integrated by one method, from coarse to fine.

    Attributes
    ----------
    label : str
        The model.
    work : ndarray of shape (winds, k)
        Euler steps, or evaluations of the right-hand side.
    error : ndarray of shape (winds, k)
        Largest distance of the position over the run from the same model solved exactly.
    """

    label: str
    work: Floats
    error: Floats

    def work_for(self, error: float) -> float:
        """Work that brings the error down to `error` for good; median over the winds."""
        found = []
        for work, errors in zip(self.work, self.error, strict=True):
            above = np.flatnonzero(errors > error)
            if not len(above):
                found.append(work[0])
                continue
            # Beyond the finest one, the line through the two finest goes on.
            left = min(above[-1], len(work) - 2)
            if work[left] == work[left + 1]:
                # A smaller tolerance that asks for the same steps.
                found.append(work[left])
                continue
            span = slice(left, left + 2)
            rate = -slope(work[span], errors[span])
            found.append(work[left] * (errors[left] / error) ** (1 / rate))
        return float(np.median(found))

    @property
    def order(self) -> float:
        """Exponent of the step in the error, from the four finest steps; mean over the winds."""
        pairs = zip(self.work[:, -4:], self.error[:, -4:], strict=True)
        return float(np.mean([-slope(work, error) for work, error in pairs]))


@dataclass(frozen=True)
class Strandings:
    """An ensemble of one model compared with that of the full model under the same winds.

    Attributes
    ----------
    label : str
        The model.
    probability : Probability
        Of stranding.
    seconds : float
        Wall-clock time of the ensemble on all processors.
    different : int
        Members that strand in one model and not in the other.
    delay : ndarray
        Distance in time of the two strandings, where both strand [tides].
    distance : ndarray
        Distance in space of the same.
    """

    label: str
    probability: Probability
    seconds: float
    different: int
    delay: Floats
    distance: Floats


@dataclass(frozen=True)
class Validation:
    """All that was measured.

    Attributes
    ----------
    effort : Effort
        How much was measured.
    errors : dict
        Errors of the averaged models by case.
    printed : dict
        Mean error of position of the paper's order 0, p = ε/10, by the tides in the run.
    resolution : float
        Largest relative change of an error of member 0 at ε = 1/50 when samples and tolerances are
        refined.
    euler, dormand_prince : list of Integration
        At ε = 1/50.
    step_costs : dict
        Time of an Euler step by model, one per round [s].
    strandings : list of Strandings
        The full model first.
    laws : list of LawOfWind
        Of every record, both modes.
    wrong : dict
        T1 to T7 of generators that are wrong in a known way, by what is wrong.
    exact : ExactInLaw
        The small-scale wind.
    seconds : float
        Time that the measurement took.
    """

    effort: Effort
    errors: dict[Case, Errors]
    printed: dict[int, float]
    resolution: float
    euler: list[Integration]
    dormand_prince: list[Integration]
    step_costs: dict[str, Floats]
    strandings: list[Strandings]
    laws: list[LawOfWind]
    wrong: dict[str, list[Check]]
    exact: ExactInLaw
    seconds: float

    @property
    def checks(self) -> list[Check]:
        """What is required, and what was measured."""
        return [
            *self._required_errors(),
            *self._printed_errors(),
            *self._orders(),
            *self._agreement(),
            *(law.summary for law in self.laws),
            *self._found_out(),
            *self.exact.checks,
        ]

    @property
    def passed(self) -> bool:
        """Whether all checks pass."""
        return all(check.passed for check in self.checks)

    def mean(self, case: Case, name: str) -> float:
        """Mean over the winds of an attribute of `Errors`."""
        return float(getattr(self.errors[case], name).mean())

    def fitted_order(self, cases: Sequence[Case], norm: str) -> float:
        """Exponent of ε in the mean error over the winds that all cases have.

        Parameters
        ----------
        cases : sequence of Case
            One model at several ε.
        norm : {"velocity", "position"}
            Of which error.
        """
        values = [getattr(self.errors[case], norm) for case in cases]
        shared = min(map(len, values))
        return slope([1 / case.tides for case in cases], [np.mean(v[:shared]) for v in values])

    def _required_errors(self) -> Iterable[Check]:
        for order, limits in REQUIRED.items():
            for norm, limit in limits.items():
                name = f"ε = 1/50, wind, mean-flow order {order}, {norm}, mean over the winds"
                yield Check(name, self.mean(Case(50, "mean-flow", order), norm), limit)

    def _printed_errors(self) -> Iterable[Check]:
        for tides, printed in CALM.items():
            for (norm, order), value in zip(product(_NORMS, (0, 1)), printed, strict=True):
                error = self.mean(Case(tides, "paper", order, calm=True), norm)
                # It rounds to the digits given.
                half = 0.5 * 10.0 ** -len(value.partition(".")[2])
                name = f"ε = 1/{tides}, no wind, paper order {order}, {norm}: {value}"
                yield Check(name, error, float(value) + half, float(value) - half)
        for tides in TIDES:
            given = printed_numbers(paper.PRINTED[tides, 0.1][2])[0]
            name = f"ε = 1/{tides}, p = ε/10, paper order 0, position: printed {given:.4f}"
            # Two units of the last digit printed: the winds are not the paper's.
            yield Check(name, self.printed[tides], given + 2e-4, given - 2e-4)

    def _orders(self) -> Iterable[Check]:
        for label, power, cases in order_cases():
            for norm in _NORMS:
                order = self.fitted_order(cases, norm)
                yield Check(f"order in ε, {label}, {norm}", order, power + _SLACK, power - _SLACK)
        for integration in self.euler:
            name = f"order in the step, Euler, {integration.label}"
            yield Check(name, integration.order, 1 + _SLACK, 1 - _SLACK)

    def _agreement(self) -> Iterable[Check]:
        full, *others = self.strandings
        allowed = _SHARE_OF_INTERVAL * (full.probability.high - full.probability.low) / 2
        for other in others:
            if other.label.startswith("mean-flow"):
                change = abs(other.probability.estimate - full.probability.estimate)
                name = f"probability of stranding, {other.label} against full"
                yield Check(name, change, allowed)

    def _found_out(self) -> Iterable[Check]:
        for name, checks in self.wrong.items():
            missed = sum(not check.passed for check in checks)
            yield Check(f"wrong wind, {name}: statistics that find it", missed, len(checks), 1)

    def to_dict(self) -> dict[str, Any]:
        """Everything as numbers, text, lists and dictionaries, for JSON."""
        return {
            "effort": asdict(self.effort),
            "seconds": self.seconds,
            "checks": [{**asdict(c), "passed": c.passed} for c in self.checks],
            "errors": [
                {**asdict(case), **{name: _summary(v) for name, v in vars(errors).items()}}
                for case, errors in self.errors.items()
            ],
            "resolution": self.resolution,
            "euler": [_lists(vars(i)) for i in self.euler],
            "dormand_prince": [_lists(vars(i)) for i in self.dormand_prince],
            "step_costs": _lists(self.step_costs),
            "strandings": [
                {
                    **vars(s),
                    "probability": asdict(s.probability),
                    "delay": _summary(s.delay),
                    "distance": _summary(s.distance),
                }
                for s in self.strandings
            ],
            "law_of_the_wind": [law.to_dict() for law in self.laws],
            "wrong_winds": {
                name: [{**asdict(c), "passed": c.passed} for c in checks]
                for name, checks in self.wrong.items()
            },
            "exact_in_law": self.exact.to_dict(),
        }


def measure(
    effort: Effort = DEFAULT,
    progress: Progress = lambda _: None,
    record: WindRecord | None = None,
) -> Validation:
    """Measure everything.

    Parameters
    ----------
    effort : Effort
        How much.
    progress : callable
        Called with the name of each part when it begins.
    record : WindRecord, optional
        Whose law is measured beside that of the embedded climate.

    Raises
    ------
    RecordError
        If the record cannot be fitted, or has fewer than 6 seasons.
    """
    began = time.perf_counter()
    progress("law of the wind")
    laws = laws_of_wind(record)
    wrong = tests_that_find(effort.summers)
    progress("small scale of the wind")
    exact = exact_in_law(effort.small_scale_paths, effort.small_scale_members)
    errors: dict[Case, Errors] = {}
    printed = {}
    for tides in TIDES_OF_ORDERS:
        progress(f"errors at ε = 1/{tides}")
        calm = [case for case in _calm_cases() if case.tides == tides]
        errors |= measured_errors(calm, 1, _FINE_SAMPLES)
        cases = [case for case in _windy_cases() if case.tides == tides]
        errors |= measured_errors(cases, effort.winds if tides in TIDES else effort.winds_of_orders)
        if tides in TIDES:
            case = Case(tides, "paper", 0, 0.1)
            found = measured_errors([case], effort.winds_of_printed)[case]
            printed[tides] = float(found.position.mean())
    progress("resolution")
    sampled = [case for case in _windy_cases() if case.tides == 50]
    resolution = _resolution(sampled)
    progress("cost of the methods")
    euler, dormand_prince = _integrations(effort)
    progress("cost of a step")
    step_costs = _step_costs(effort.rounds)
    progress("strandings")
    strandings = _strandings(effort)
    seconds = time.perf_counter() - began
    return Validation(
        effort=effort,
        errors=errors,
        printed=printed,
        resolution=resolution,
        euler=euler,
        dormand_prince=dormand_prince,
        step_costs=step_costs,
        strandings=strandings,
        laws=laws,
        wrong=wrong,
        exact=exact,
        seconds=seconds,
    )


def slope(x: ArrayLike, y: ArrayLike) -> float:
    """Exponent of `x` in `y`: least squares in logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def printed_numbers(entry: str) -> list[float]:
    """Numbers of an entry of the paper's tables: mean, least and greatest, or the mean alone."""
    return [float(number) for number in re.findall(r"[\d.]+", entry)]


def order_cases() -> list[tuple[str, int, list[Case]]]:
    """Models whose order in ε is known: label, order, and the cases to fit it from."""

    def over_tides(**settings: Any) -> list[Case]:
        return [Case(tides, **settings) for tides in TIDES_OF_ORDERS]

    calm = [
        (f"no wind, paper order {k}", k + 1, over_tides(model="paper", order=k, calm=True))
        for k in (0, 1)
    ]
    wind = [
        (
            f"wind, paper order {k}, p = ε/10" + (", without B_W" if k else ""),
            k + 1,
            over_tides(model="paper", order=k, window=0.1),
        )
        for k in (0, 1)
    ]
    mean_flow = [
        (f"wind, mean-flow order {k}", k + 1, over_tides(model="mean-flow", order=k))
        for k in (1, 2)
    ]
    return calm + wind + mean_flow


def paper_cases(tides: int, window: float) -> tuple[Case, Case, Case]:
    """Give the paper's expansion: order 0, order 1 with the wind terms B_W, and without."""
    return (
        Case(tides, "paper", 0, window),
        Case(tides, "paper", 1, window, wind_terms=True),
        Case(tides, "paper", 1, window),
    )


def measured_errors(
    cases: Sequence[Case], members: int, samples: int = SAMPLES, rtol: float = _RTOL
) -> dict[Case, Errors]:
    """Follow members by the full and by averaged models.

    Parameters
    ----------
    cases : sequence of Case
        Of one ε, and all with or all without wind.
    members : int
        Members 0, 1, … of the embedded climate.
    samples : int
        Samples per tide; two more stand around the start of each tide, where `B_W` jumps.
    rtol : float
        Relative tolerance of the averaged models.
    """
    tides, calm = cases[0].tides, cases[0].calm
    scenario, wind = paper.scenario(1 / tides), paper.default_wind()
    times = sample_times(tides, samples)

    def follow(member: int) -> list[list[float]]:
        path = _CALM if calm else member_path(scenario, wind, member)
        full = trajectory(scenario, path, model="full", times=times, rtol=_EXACT_RTOL)
        rows = []
        for case in cases:
            found = trajectory(scenario, path, times=times, rtol=rtol, **case.settings())
            distances = (
                np.linalg.norm(full[norm].values - found[norm].values, axis=-1).max()
                for norm in _NORMS
            )
            work = (found.attrs["steps"], found.attrs["evaluations"])
            rows.append([*distances, *work, full["position"].values[:, 0].max()])
        return rows

    with ThreadPoolExecutor() as pool:
        rows = np.array(list(pool.map(follow, range(members))))
    return {case: Errors(*rows[:, k].T) for k, case in enumerate(cases)}


def expanded_euler(
    scenario: Scenario, path: WindPath, blocks: int, steps: int
) -> tuple[Floats, Floats]:
    """Explicit Euler for the full system as the paper writes it, equations.md (1) written out.

    The unknowns are position and velocity, and the rate of the velocity holds the derivatives of
    the sea, of size 1/ε. The paper's sea is linear in the position, `m = B(t) x`, so that a step is
    an affine map, and so is any number of them: all blocks are gone through at once.

    Parameters
    ----------
    scenario : Scenario
        The paper's case: another sea is not linear in the position.
    path : WindPath
        The wind.
    blocks, steps : int
        The run has `blocks` of `steps` steps each.

    Returns
    -------
    times : ndarray of shape (blocks,)
        Ends of the blocks.
    position : ndarray of shape (blocks, 2)
        Position at these times.
    """
    sea = scenario.sea.core(scenario.period, scenario.epsilon, scenario.duration)
    h = scenario.duration / (blocks * steps)
    starts = np.arange(blocks) * np.float64(h * steps)

    def coefficients(t: Floats) -> Floats:
        units = [sea.velocity(t, np.tile(unit, (len(t), 1))) for unit in np.eye(2)]
        return np.stack(units, axis=-1)

    # Fourth-order differences: at a two-thousandth of a tide they err by less than 1e-8 of B'.
    d = scenario.period / 2000
    identity = np.tile(np.eye(5), (blocks, 1, 1))  # of position, velocity and the constant 1
    maps = identity.copy()
    for k in range(steps):
        t = starts + k * h
        near, far = (coefficients(t + j * d) - coefficients(t - j * d) for j in (1, 2))
        step = identity.copy()
        step[:, 0:2, 2:4] += h * np.eye(2)
        step[:, 2:4, 0:2] += h * (8 * near - far) / (12 * d)
        step[:, 2:4, 2:4] += h * (coefficients(t) - scenario.drag * np.eye(2))
        step[:, 2:4, 4] += h * scenario.drag * path.at(t)
        maps = step @ maps
    state = np.array([*scenario.position, *scenario.velocity, 1.0])
    states = np.array([state := block @ state for block in maps])
    return np.append(starts[1:], scenario.duration), states[:, :2]


def _calm_cases() -> list[Case]:
    return [Case(tides, "paper", k, calm=True) for tides in TIDES_OF_ORDERS for k in (0, 1)]


def _windy_cases() -> list[Case]:
    """Every case with wind: those of the tables, and for the shortest tide those of the orders."""
    tables = [case for t, window in product(TIDES, WINDOWS) for case in paper_cases(t, window)]
    longest = TIDES_OF_ORDERS[-1]
    mean_flow = [Case(t, "mean-flow", k) for t in TIDES_OF_ORDERS for k in (1, 2)]
    return [*tables, *paper_cases(longest, 0.1), *mean_flow]


def sample_times(tides: int, samples: int) -> Floats:
    """Give times within the run, dense, and just before and after the start of each tide."""
    count = samples * tides
    starts, edge = np.arange(tides + 1) / tides, 1e-6 / tides
    return np.sort(
        np.clip([*(np.arange(count) + 0.5) / count, *(starts - edge), *(starts + edge)], 0, 1)
    )


def _resolution(cases: Sequence[Case]) -> float:
    coarse = measured_errors(cases, 1)
    fine = measured_errors(cases, 1, _FINE_SAMPLES, _RTOL / 100)
    changes = [
        abs(getattr(coarse[case], norm) / getattr(fine[case], norm) - 1).max()
        for case, norm in product(cases, _NORMS)
    ]
    return float(max(changes))


FULL_EXPANDED, FULL_A, FULL_B = "full, as printed", "full, rewrite A", "full, rewrite B"
PAPER, PAPER_WITHOUT = "paper order 1, with B_W", "paper order 1, without B_W"
MEAN_FLOW_1, MEAN_FLOW_2 = "mean-flow order 1", "mean-flow order 2"
# The models whose work is compared; the paper's with the window that it recommends.
_INTEGRATED: dict[str, dict[str, Any]] = {
    FULL_A: {"model": "full", "formulation": "A"},
    FULL_B: {"model": "full"},
    PAPER: Case(50, "paper", 1, 0.5, wind_terms=True).settings(),
    PAPER_WITHOUT: Case(50, "paper", 1, 0.5).settings(),
    MEAN_FLOW_1: {"model": "mean-flow", "order": 1},
    MEAN_FLOW_2: {"model": "mean-flow", "order": 2},
}


def _integrations(effort: Effort) -> tuple[list[Integration], list[Integration]]:
    """Integrate every model with Euler steps and tolerances from coarse to fine, at ε = 1/50."""
    scenario, wind = paper.scenario(1 / 50), paper.default_wind()
    times = sample_times(50, 40)
    # The smallest steps are taken by the models that need them.
    counts = {
        label: 50 * 2 ** np.arange(effort.halvings + (1 if label.startswith("full") else -1))
        for label in _INTEGRATED
    }
    tolerances = 10.0 ** -np.arange(1.5, 9.1, 0.5)

    def follow(member: int) -> list[list[tuple[Floats, Floats]]]:
        path = member_path(scenario, wind, member)

        def run(settings: dict[str, Any], **method: Any) -> tuple[Floats, dict[str, Any]]:
            found = trajectory(scenario, path, times=times, **settings, **method)
            return found["position"].values, found.attrs

        by_euler, by_tolerance = [], []
        for label, settings in _INTEGRATED.items():
            own, _ = run(settings, rtol=1e-10)
            found = [run(settings, euler_step=1 / n) for n in counts[label]]
            by_euler.append(_work_and_errors(own, found, "steps"))
            found = [run(settings, rtol=rtol) for rtol in tolerances]
            by_tolerance.append(_work_and_errors(own, found, "evaluations"))
        by_euler.append(_expanded_errors(scenario, path, effort.halvings))
        return [by_euler, by_tolerance]

    with ThreadPoolExecutor() as pool:
        found = list(pool.map(follow, range(effort.winds_of_costs)))

    def gathered(method: int, labels: Iterable[str]) -> list[Integration]:
        return [
            Integration(label, *(np.array([row[method][k][j] for row in found]) for j in (0, 1)))
            for k, label in enumerate(labels)
        ]

    return gathered(0, [*_INTEGRATED, FULL_EXPANDED]), gathered(1, _INTEGRATED)


def _work_and_errors(
    exact: Floats, found: Sequence[tuple[Floats, dict[str, Any]]], unit: str
) -> tuple[Floats, Floats]:
    work = [attributes[unit] for _, attributes in found]
    errors = [np.linalg.norm(position - exact, axis=-1).max() for position, _ in found]
    return np.array(work, dtype=float), np.array(errors)


def _expanded_errors(scenario: Scenario, path: WindPath, halvings: int) -> tuple[Floats, Floats]:
    """Work and error of `expanded_euler`, which needs many more steps than the rewrites."""
    blocks, work, errors = 2000, [], []
    for steps in 2 ** np.arange(max(4, halvings - 3)):
        times, position = expanded_euler(scenario, path, blocks, int(steps))
        exact = trajectory(scenario, path, model="full", times=times, rtol=_EXACT_RTOL)
        errors.append(np.linalg.norm(position - exact["position"].values, axis=-1).max())
        work.append(float(blocks * steps))
    return np.array(work), np.array(errors)


def _step_costs(rounds: int) -> dict[str, Floats]:
    """Time of an Euler step of each model [s], the models one after another in every round."""
    scenario = paper.scenario(1 / 50)
    path = member_path(scenario, paper.default_wind(), 0)
    costs: dict[str, list[float]] = {label: [] for label in _INTEGRATED}
    for _ in range(rounds):
        for label, settings in _INTEGRATED.items():
            # Enough steps that what surrounds them does not count.
            steps = 100_000 if label.startswith("full") else 20_000
            began = time.perf_counter()
            found = trajectory(scenario, path, times=[1.0], euler_step=1 / steps, **settings)
            costs[label].append((time.perf_counter() - began) / found.attrs["steps"])
    return {label: np.array(values) for label, values in costs.items()}


def _strandings(effort: Effort) -> list[Strandings]:
    models: dict[str, dict[str, Any]] = {
        "full": {"model": "full"},
        MEAN_FLOW_1: {"model": "mean-flow", "order": 1},
        MEAN_FLOW_2: {"model": "mean-flow", "order": 2},
    }
    if effort.paper_strandings:
        models |= {label: _INTEGRATED[label] for label in (PAPER, PAPER_WITHOUT)}
    scenario = paper.scenario(1 / 50)
    paper.default_wind()  # fitted before the clock starts
    found: list[Strandings] = []
    full: Forecast | None = None
    for label, settings in models.items():
        began = time.perf_counter()
        ensemble = forecast(scenario, members=effort.members, keep=0, **settings)
        seconds = time.perf_counter() - began
        full = ensemble if full is None else full
        found.append(_compared(label, full, ensemble, seconds))
    return found


def _compared(label: str, full: Forecast, other: Forecast, seconds: float) -> Strandings:
    one, two = full.dataset, other.dataset
    stranded = [np.isfinite(dataset["stranding_time"].values) for dataset in (one, two)]
    both = stranded[0] & stranded[1]
    delay = abs(one["stranding_time"].values - two["stranding_time"].values)[both]
    apart = one["stranding_position"].values[both] - two["stranding_position"].values[both]
    return Strandings(
        label,
        other.stranding_probability(),
        seconds,
        int((stranded[0] != stranded[1]).sum()),
        delay / one.attrs["epsilon"],
        np.linalg.norm(apart, axis=-1),
    )


def _summary(values: Floats) -> dict[str, float]:
    """Mean, extremes and quantiles of the values, none where there are none."""
    if not len(values):
        return {}
    quantiles = {f"q{q}": float(np.quantile(values, q / 100)) for q in (5, 50, 95)}
    extremes = {"min": float(values.min()), "max": float(values.max())}
    return {"mean": float(values.mean()), **extremes, **quantiles}


def _lists(mapping: dict[str, Any]) -> dict[str, Any]:
    return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in mapping.items()}
