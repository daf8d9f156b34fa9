"""What the simulated winds are measured to be: their law, and that of their small scale."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any, get_args

import numpy as np

from driftcore import law, paper
from driftcore.check import Check
from driftcore.climate import synthetic_record
from driftcore.record import Float, WindRecord, read_record
from driftcore.small_scale import (
    Moments,
    SmallScale,
    brute_force_cells,
    brute_force_strandings,
    coarse_strandings,
    member_cells,
)
from driftcore.statistics import kolmogorov_smirnov
from driftcore.wind import LocalGridBootstrap, Mode
from driftcore.wrong_winds import WRONG

EMBEDDED = "the embedded climate"
# The default small scale, one whose memory decides what strands, and that one with a wrong memory.
DEFAULT, STRONG, FORGETFUL = SmallScale(0.1, 3.0), SmallScale(0.5, 60.0), SmallScale(0.5, 3.0)
_MOMENTS_OF = (DEFAULT, SmallScale(0.5, 20.0))
# Five numbers of each law: one in 3,000 right ones is rejected.
_LARGEST_Z = 4.0
_LEAST_P = 0.001
_CANDIDATE = ("h", "b", "log_likelihood")


@dataclass(frozen=True)
class LawOfWind:
    """Tests T1 to T9 of a bootstrap fitted to a record.

    Attributes
    ----------
    name : str
        Of the record.
    wind : LocalGridBootstrap
        As it was fitted, its bandwidths chosen by likelihood.
    checks : list of Check
        See `driftcore.law.assess`.
    """

    name: str
    wind: LocalGridBootstrap
    checks: list[Check]

    @property
    def seasons(self) -> int:
        """Number of seasons in the record."""
        return len(np.unique(self.wind.record.season))

    def warns(self, check: Check) -> bool:
        """Whether a test only warns: the paper's mode may copy its record, the default must not."""
        return self.wind.mode == "lgb" and check.name in law.COPIES

    @property
    def summary(self) -> Check:
        """How many tests are required and not passed: none."""
        missed = [c for c in self.checks if not c.passed and not self.warns(c)]
        return Check(
            f"law of the wind, {self.name}, {self.wind.mode}: tests missed", len(missed), 0
        )

    def to_dict(self) -> dict[str, Any]:
        """Everything as numbers, text, lists and dictionaries, for JSON."""
        wind = self.wind
        # In mode `residual` there is no b: its field is not a number.
        candidates = [
            {name: float(row[name]) for name in _CANDIDATE if row[name] == row[name]}
            for row in wind.likelihood
        ]
        return {
            "name": self.name,
            "record": wind.record.describe(),
            "seasons": self.seasons,
            "mode": wind.mode,
            "h": wind.h,
            "b": wind.b,
            "order": wind.order,
            "checks": [
                {**asdict(c), "passed": c.passed, "warns": self.warns(c)} for c in self.checks
            ],
            "likelihood": candidates,
        }


@dataclass(frozen=True)
class ExactInLaw:
    """The small scale, sampled coarsely by the core and simulated step by step.

    Attributes
    ----------
    moments : dict
        By small scale: moments of the core's and of the brute-force paths.
    strandings : dict
        By small scale: stranding times of the members, infinite if afloat.
    brute_strandings : dict
        The same under winds simulated step by step.
    """

    moments: dict[SmallScale, tuple[Moments, Moments]]
    strandings: dict[SmallScale, Float]
    brute_strandings: dict[SmallScale, Float]

    def p_value(self, coarse: SmallScale, brute: SmallScale) -> float:
        """Of the two-sample Kolmogorov–Smirnov test of stranding times."""
        return kolmogorov_smirnov(self.strandings[coarse], self.brute_strandings[brute])

    @property
    def checks(self) -> list[Check]:
        """Give what is required, and what was measured."""
        return [*self._moments(), *self._stranding_times()]

    def _moments(self) -> Iterable[Check]:
        for scale, (coarse, brute) in self.moments.items():
            name = f"small scale of memory {scale.memory_h:g} h, moments, largest z"
            yield Check(name, float(abs(coarse.z_scores(brute)).max()), _LARGEST_Z)

    def _stranding_times(self) -> Iterable[Check]:
        for scale in self.brute_strandings:
            words = f"stranding times, small scale of share {scale.share:g}, {scale.memory_h:g} h"
            yield Check(f"{words}: p-value", self.p_value(scale, scale), 1.0, _LEAST_P)
        # A test that cannot tell anything apart would pass as well.
        words = f"coarse {FORGETFUL.memory_h:g} h against {STRONG.memory_h:g} h"
        yield Check(f"stranding times, {words}: p-value", self.p_value(FORGETFUL, STRONG), _LEAST_P)

    def to_dict(self) -> dict[str, Any]:
        """Everything as numbers, text, lists and dictionaries, for JSON."""
        return {
            "moments": [
                {
                    **asdict(scale),
                    "coarse": {name: value.tolist() for name, value in vars(coarse).items()},
                    "brute_force": {name: value.tolist() for name, value in vars(brute).items()},
                    "z": coarse.z_scores(brute).tolist(),
                }
                for scale, (coarse, brute) in self.moments.items()
            ],
            "strandings": [
                {
                    "coarse": asdict(coarse),
                    "brute_force": asdict(brute),
                    "stranded": float(np.isfinite(self.strandings[coarse]).mean()),
                    "brute_force_stranded": float(np.isfinite(self.brute_strandings[brute]).mean()),
                    "p": self.p_value(coarse, brute),
                }
                for coarse, brute in product(self.strandings, self.brute_strandings)
            ],
        }


def laws_of_wind(record: WindRecord | None) -> list[LawOfWind]:
    """Measure T1 to T9 in both modes, of the embedded climate and of a record.

    Parameters
    ----------
    record : WindRecord, optional
        Another record than the embedded one.
    """
    embedded = paper.default_wind()
    fitted = []
    # The user's first: if it does not serve, little was done in vain.
    if record is not None:
        fitted += [(record.label, _fitted(record, mode)) for mode in get_args(Mode)]
    fitted += [(EMBEDDED, embedded), (EMBEDDED, _fitted(embedded.record, "lgb"))]
    return [LawOfWind(name, wind, law.assess(wind)) for name, wind in fitted]


def tests_that_find(summers: int) -> dict[str, list[Check]]:
    """Try the wrong generators on summers of the embedded climate: T1 to T7 of each."""
    record = read_record(synthetic_record(years=summers), months=(6, 7, 8))
    return {name: law.assess(wrong(record), record) for name, wrong in WRONG.items()}


def exact_in_law(paths: int, members: int) -> ExactInLaw:
    """Compare the small scale as it is sampled with its simulation step by step.

    Parameters
    ----------
    paths : int
        Paths of members, each of 117 synoptic steps for both components.
    members : int
        Members of the ensembles whose strandings are compared.
    """
    wind = paper.default_wind()
    step_h = wind.record.step_h
    moments = {}
    for scale in _MOMENTS_OF:
        coarse = member_cells(wind, scale, paths, seed=8)
        brute = brute_force_cells(scale, 4 * len(coarse), step_h, seed=1)
        moments[scale] = (Moments.of(coarse, step_h), Moments.of(brute, step_h))
    return ExactInLaw(
        moments,
        {s: coarse_strandings(wind, s, members) for s in (DEFAULT, STRONG, FORGETFUL)},
        {s: brute_force_strandings(wind, s, members) for s in (DEFAULT, STRONG)},
    )


def _fitted(record: WindRecord, mode: Mode) -> LocalGridBootstrap:
    return LocalGridBootstrap.fit(record, months=None, mode=mode)
