"""Two levels: what is counted, that nothing is biased, and intervals that stay honest."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr

import driftcore as dc
from driftcore.errors import ScenarioError
from driftcore.multifidelity import TWO_LEVELS, _combined, combined_probability
from driftcore.statistics import paired_difference, wilson

MEAN_FLOW_2: dict[str, Any] = {"model": "mean-flow", "order": 2}
# An expansion of order 0 in few tides: cheap in accuracy, so that the levels disagree.
ROUGH: tuple[dict[str, Any], ...] = ({"model": "paper", "order": 0}, {"model": "full"})
FEW_TIDES = dc.paper.scenario(epsilon=1 / 10)


def stranded(scenario: Any, wind: Any, members: int, seed: int, **options: Any) -> Any:
    found = dc.forecast(scenario, wind, members=members, seed=seed, keep=0, **options)
    return found.dataset["status"].values == 1


def test_counts_are_those_of_the_forecasts(embedded_wind: dc.LocalGridBootstrap) -> None:
    found = dc.multifidelity_probability(
        FEW_TIDES, embedded_wind, members=(400, 150), levels=ROUGH, seed=3
    )
    cheap, full = (
        stranded(FEW_TIDES, embedded_wind, n, 3, **level)
        for n, level in zip((400, 150), ROUGH, strict=True)
    )
    assert found.count == cheap.sum()
    assert found.gained == ((full & ~cheap[:150]).sum(),)
    assert found.lost == ((cheap[:150] & ~full).sum(),)
    assert found.gained[0] + found.lost[0] > 0
    assert found.estimate == pytest.approx(cheap.mean() + full.mean() - cheap[:150].mean())
    assert found.disagreement == pytest.approx(((full != cheap[:150]).mean(),))
    assert (found.members, found.followed) == ((400, 150), (400, 150))
    assert found.low < found.estimate < found.high
    assert str(found) == f"{found.estimate:.3f} [{found.low:.3f}, {found.high:.3f}]"
    assert found.cost[-1] == 1
    assert min(found.seconds) > 0
    # An interval as narrow by the full model alone, against what the two levels cost.
    p, z = found.estimate, 1.959963984540054
    alone = p * (1 - p) * (z / found.half_width) ** 2
    assert found.saving == pytest.approx(
        alone * found.seconds[1] / 150 / sum(found.seconds), rel=1e-12
    )


def test_members_are_the_same_winds_whatever_the_model(
    embedded_wind: dc.LocalGridBootstrap,
) -> None:
    """The coarse wind of the averaged model is that of the full one: strandings agree closely."""
    scenario = dc.paper.scenario()
    times = [
        dc.forecast(scenario, embedded_wind, members=200, keep=0, **level)
        .dataset["stranding_time"]
        .values
        for level in (*TWO_LEVELS, MEAN_FLOW_2)
    ]
    for other in times[1:]:
        both = np.isfinite(times[0]) & np.isfinite(other)
        assert both.sum() > 80
        assert np.median(np.abs(times[0] - other)[both]) < 2e-3
        assert (np.isfinite(times[0]) == np.isfinite(other)).mean() > 0.98


def test_three_levels_and_an_event(embedded_wind: dc.LocalGridBootstrap) -> None:
    done: list[tuple[int, int]] = []
    corner = {"corner": [(0.7, 0.7), (0.95, 0.7), (0.95, 0.95), (0.7, 0.95)]}
    found = dc.multifidelity_probability(
        dc.paper.scenario(),
        embedded_wind,
        members=(96, 64, 32),
        levels=({"model": "mean-flow"}, MEAN_FLOW_2, {"model": "full"}),
        event=lambda data: np.isfinite(data["entry_time"].sel(target="corner").values),
        targets=corner,
        progress=lambda now, total: done.append((now, total)),
    )
    entered = dc.forecast(
        dc.paper.scenario(), embedded_wind, members=96, targets=corner
    ).entry_probability("corner")
    assert found.count == entered.count > 0
    assert len(found.gained) == len(found.lost) == 2
    assert done == [(96, 192), (160, 192), (192, 192)]
    assert found.low <= found.estimate <= found.high


def test_no_bias_by_a_poor_cheap_level(embedded_wind: dc.LocalGridBootstrap) -> None:
    scenario = dc.paper.scenario(epsilon=1 / 5)

    def by(data: xr.Dataset) -> Any:
        return data["stranding_time"].values <= 0.7

    found = [
        dc.multifidelity_probability(
            scenario, embedded_wind, members=(64, 16), levels=ROUGH, event=by, seed=k
        ).estimate
        for k in range(1, 101)
    ]
    rough, full = (
        dc.forecast(scenario, embedded_wind, members=4000, seed=9, keep=0, **level)
        .stranding_probability(by=0.7)
        .estimate
        for level in ROUGH
    )
    error = math.hypot(np.std(found) / math.sqrt(len(found)), 0.5 / math.sqrt(4000))
    assert error < 0.02
    assert abs(np.mean(found) - full) < 3 * error
    assert full - rough > 0.15


def test_the_sea_of_the_world() -> None:
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-4.1, 47.2, "2026-07-01T06:00", radius_m=20_000),
        days=10,
        drifter=dc.FloatingBody(response_time_h=6, wind_factor=0.03),
        tides=dc.tides.biscay(),
        coast=dc.LandCoast.default(),
    )
    wind = dc.paper.default_wind()
    found = dc.multifidelity_probability(scenario, wind, members=(192, 48), seed=2)
    cheap = stranded(scenario, wind, 192, 2)
    full = stranded(scenario, wind, 48, 2, model="full")
    assert found.count == cheap.sum() > 0
    assert found.estimate == pytest.approx(cheap.mean() + full.mean() - cheap[:48].mean())
    assert found.disagreement[0] < 0.15


def test_the_wind_of_the_paper_if_none_is_named() -> None:
    scenario = dc.paper.scenario()
    found = dc.multifidelity_probability(scenario, members=(40, 10), seed=4)
    named = dc.multifidelity_probability(
        scenario, dc.paper.default_wind(), members=(40, 10), seed=4
    )
    assert (found.count, found.gained, found.lost) == (named.count, named.gained, named.lost)
    assert found.count > 0


def test_members_that_fail_count_on_no_level() -> None:
    """Ten of a hundred failed on the first level, two of them among the twenty of the next."""
    event = np.arange(100) % 2 == 0
    first = np.arange(100) % 10 != 7
    found = _combined([event, ~event[:20]], [first, np.ones(20, dtype=bool)], [1.0, 1.0], 0.95)
    assert found.followed == (90, 18)
    assert (found.count, found.gained, found.lost) == (50, (8,), (10,))
    none = np.zeros(20, dtype=bool)
    with pytest.raises(ScenarioError, match="members: of 20 on level 1 none could be followed"):
        _combined([event, event[:20]], [first, none], [1.0, 1.0], 0.95)


def test_winds_given_one_by_one(embedded_wind: dc.LocalGridBootstrap) -> None:
    scenario = dc.paper.scenario()
    paths = [dc.member_path(scenario, embedded_wind, k) for k in range(40)]
    found = dc.multifidelity_probability(scenario, paths, members=(40, 10))
    drawn = dc.multifidelity_probability(scenario, embedded_wind, members=(40, 10))
    assert abs(found.count - drawn.count) <= 1


# Intervals


@pytest.mark.parametrize(("gained", "lost", "pairs"), [(0, 0, 50), (9, 2, 100), (1, 30, 60)])
def test_paired_difference_is_where_the_score_is_z(gained: int, lost: int, pairs: int) -> None:
    """By the constrained maximum of the likelihood, found on a fine grid."""
    z = 1.959963984540054
    for bound in paired_difference(gained, lost, pairs):
        # Cells: gained q + bound, lost q, neither 1 - 2q - bound.
        q = np.linspace(max(0, -bound), (1 - bound) / 2, 2_000_003)[1:-1]
        chance = np.zeros_like(q)
        for count, share in ((gained, q + bound), (lost, q), (pairs - gained - lost, None)):
            if count:
                chance += count * np.log(1 - 2 * q - bound if share is None else share)
        best = q[chance.argmax()]
        deviation = math.sqrt((2 * best + bound - bound**2) / pairs)
        assert abs((gained - lost) / pairs - bound) / deviation == pytest.approx(z, rel=1e-3)


def test_paired_difference_at_the_ends() -> None:
    z2 = 1.959963984540054**2
    assert paired_difference(0, 0, 50) == pytest.approx((-z2 / (50 + z2), z2 / (50 + z2)))
    low, high = paired_difference(20, 0, 20)
    assert (low, high) == pytest.approx((20 / (20 + z2) - z2 / (20 + z2), 1.0), abs=0.2)
    assert paired_difference(3, 8, 40) == pytest.approx(
        tuple(-x for x in reversed(paired_difference(8, 3, 40)))
    )


def test_an_interval_keeps_a_width_where_no_disagreement_was_seen() -> None:
    p, low, high = combined_probability(3000, 10_000, [(0, 0, 200)])
    alone = wilson(3000, 10_000)
    z2 = 1.959963984540054**2
    assert p == 0.3
    assert p - low == pytest.approx(math.hypot(0.3 - alone[0], z2 / (200 + z2)))
    assert high - p == pytest.approx(math.hypot(alone[1] - 0.3, z2 / (200 + z2)))


@pytest.mark.parametrize(("gained", "lost"), [(0.0, 0.0), (0.003, 0.0), (0.004, 0.002), (0.1, 0.2)])
@pytest.mark.parametrize("pairs", [300, 2000])
def test_intervals_cover(gained: float, lost: float, pairs: int) -> None:
    random = np.random.default_rng(4)
    cheap, members, replicates = 0.3, 10_000, 2_000
    cells = [cheap - lost, lost, gained, 1 - cheap - gained]
    seen = random.multinomial(pairs, cells, size=replicates)
    rest = random.binomial(members - pairs, cheap, size=replicates)
    held = 0
    for (both, l, g, _), more in zip(seen.tolist(), rest.tolist(), strict=True):  # noqa: E741
        _, low, high = combined_probability(both + l + more, members, [(g, l, pairs)])
        held += low <= cheap + gained - lost <= high
    # 95 % less three standard errors; more where disagreements are hardly ever seen.
    assert held / replicates > 0.935


# Allocation


def example(**change: Any) -> dc.MultifidelityProbability:
    known: dict[str, Any] = {
        "estimate": 0.305,
        "low": 0.29,
        "high": 0.32,
        "level": 0.95,
        "members": (10_000, 2_000),
        "followed": (10_000, 2_000),
        "count": 3_000,
        "gained": (20,),
        "lost": (10,),
        "seconds": (1.0, 2.0),
    }
    return dc.MultifidelityProbability(**(known | change))


@pytest.mark.parametrize("precision", [0.02, 0.005, 0.001])
def test_allocation_reaches_its_precision_at_the_least_cost(precision: float) -> None:
    pilot = example()
    members, pairs = pilot.allocation(precision=precision)

    def half(members: int, pairs: int) -> float:
        seen = [(round(0.01 * pairs), round(0.005 * pairs), pairs)]
        _, low, high = combined_probability(round(0.3 * members), members, seen)
        return (high - low) / 2

    assert half(members, pairs) == pytest.approx(precision, rel=0.12)
    each = (1 / 10_000, 2 / 2_000)
    cost = members * each[0] + pairs * each[1]
    # Twice or half as many pairs, and what members that leaves, are no better.
    for other in (2 * pairs, pairs // 2):
        left = int((cost - other * each[1]) / each[0])
        assert left < other or half(left, other) > 0.98 * half(members, pairs)


def test_allocation_spends_what_is_given() -> None:
    members, pairs = example().allocation(seconds=60)
    assert members / 10_000 + pairs / 1_000 == pytest.approx(60, rel=1e-3)
    # Levels that hardly agree: as many of the first as of the last, at least.
    members, pairs = example(gained=(900,), lost=(900,), seconds=(10.0, 2.0)).allocation(seconds=60)
    assert members == pairs


# Refusals


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"members": (10, 20)}, r"members: \(10, 20\) is not accepted; 2 numbers"),
        ({"members": (10, 10, 10)}, "2 numbers, one for each level"),
        ({"members": 10}, "members: 10 is not accepted"),
        ({"members": (10, 0)}, "members: 0 is not accepted"),
        ({"levels": ({"model": "full"},), "members": (10,)}, "levels: 1 is not accepted"),
        ({"levels": ({"epsilon": 0.1}, {})}, "levels.0.epsilon: is not accepted; a level may"),
        ({"event": "sinking"}, "event: 'sinking' is not accepted"),
        ({"event": lambda data: data["status"]}, "event: gave int8 of shape"),
        ({"level": 95}, "level: 95 is not accepted"),
    ],
)
def test_refusals(
    change: dict[str, Any], message: str, embedded_wind: dc.LocalGridBootstrap
) -> None:
    arguments: dict[str, Any] = {"members": (20, 10)} | change
    with pytest.raises(ScenarioError, match=message):
        dc.multifidelity_probability(dc.paper.scenario(), embedded_wind, **arguments)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({}, "give one of the two"),
        ({"precision": 0.1, "seconds": 1.0}, "give one of the two"),
        ({"precision": 0.0}, "precision: 0.0 is not accepted"),
        ({"seconds": math.nan}, "seconds: nan is not accepted"),
    ],
)
def test_allocation_refuses(asked: dict[str, float], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        example().allocation(**asked)
