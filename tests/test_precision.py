"""As many members as a precision takes: in looks, whole, and with intervals that still cover."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import driftcore as dc
from driftcore.errors import DriftCoreWarning, ScenarioError
from driftcore.precision import until_precise
from driftcore.results import Forecast
from driftcore.statistics import members_needed, probability

GRID = dc.MapGrid(x=(0.7, 1.0, 1.3), y=(0.7, 1.0, 1.3), times=(0.5, 1.0))


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("half_width", [0.3, 0.03, 0.01, 0.0001])
def test_members_needed_are_the_least(share: float, half_width: float) -> None:
    needed = members_needed(share, half_width)

    def width(members: int) -> float:
        # The formula holds between whole counts too.
        return probability(share * members, members).half_width  # type: ignore[arg-type]

    if 0 < share < 1:
        assert width(needed) <= half_width * (1 + 1e-9)
        assert needed == 1 or width(needed - 1) > half_width
    assert needed <= members_needed(0.5, half_width)


def test_parts_are_one_run(embedded_wind: dc.LocalGridBootstrap) -> None:
    done: list[tuple[int, int]] = []
    options: dict[str, Any] = {"seed": 5, "keep": 1050, "maps": GRID}
    found = dc.forecast(
        dc.paper.scenario(),
        embedded_wind,
        members="auto",
        precision=0.025,
        progress=lambda now, planned: done.append((now, planned)),
        **options,
    )
    members = found.dataset.sizes["member"]
    p = found.stranding_probability()
    assert p.half_width <= 0.025
    first = dc.forecast(dc.paper.scenario(), embedded_wind, members=1000, seed=5, keep=0)
    before = first.stranding_probability()
    needed = members_needed((before.low + before.high) / 2, 0.025)
    assert done[:2] == [(1000, 1000), (needed, needed)]
    # It may turn out a little short.
    assert done[2:] in ([], [(math.ceil(1.05 * needed),) * 2])
    assert done[-1] == (members, members)
    whole = dc.forecast(dc.paper.scenario(), embedded_wind, members=members, **options)
    assert found.dataset.equals(whole.dataset)
    assert found.dataset.attrs["members"] == members
    assert 'members = "auto"' in found.configuration()
    assert "precision = 0.025" in found.configuration()


def test_where_the_first_look_will_do(embedded_wind: dc.LocalGridBootstrap) -> None:
    found = dc.forecast(dc.paper.scenario(coast=None), embedded_wind, members="auto", keep=0)
    assert found.dataset.sizes["member"] == 1000
    assert found.stranding_probability().half_width <= 0.01


def test_on_the_real_sea_warnings_are_said_once() -> None:
    scenario = dc.GeographicScenario(
        release=dc.Release.point(-4.1, 47.2, "2026-07-01T06:00", radius_m=20_000),
        days=2,
        drifter=dc.FloatingBody(response_time_h=6, wind_factor=0.03),
        tides=dc.tides.biscay(),
        coast=dc.LandCoast.default(),
    )
    with pytest.warns(DriftCoreWarning, match="averaging takes for small") as caught:
        found = dc.forecast(
            scenario, dc.paper.default_wind(), members="auto", precision=0.008, keep=0
        )
    assert len(caught) == 1
    assert isinstance(found, dc.GeographicForecast)
    p = found.stranding_probability()
    assert (p.half_width <= 0.008, p.members) == (True, found.dataset.sizes["member"])


@pytest.mark.parametrize("p", [0.02, 0.3, 0.6])
def test_intervals_cover_though_the_end_is_chosen(p: float) -> None:
    """The looks of `until_precise`, at members that are drawn outright."""
    random = np.random.default_rng(7)
    precision, replicates, held, looks = 0.02, 400, 0, []

    class Drawn(Forecast):
        pass

    template = dc.forecast(dc.paper.scenario(), [dc.WindPath([-1.0, 2.0], np.zeros((2, 2)))])
    base = template.dataset[["status"]].isel(member=0, drop=True)

    @until_precise
    def follow(*, members: Any, precision: Any, first_member: int = 0, progress: Any) -> Drawn:
        del precision
        progress(members, members)
        times = np.where(random.uniform(size=members) < p, 0.5, np.nan)
        dataset = base.drop_vars("status").assign(
            status=("member", np.isfinite(times).astype(np.int8)),
            stranding_time=("member", times),
        )
        return Drawn(dataset.assign_coords(member=first_member + np.arange(members)))

    for _ in range(replicates):
        done: list[int] = []
        found = follow(
            members="auto", precision=precision, progress=lambda now, _, d=done: d.append(now)
        ).stranding_probability()
        held += found.low <= p <= found.high
        looks.append(len(done))
        assert found.half_width <= precision
    # 95 % less three standard errors.
    assert held / replicates > 0.917
    assert max(looks) <= 4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"members": 10, "precision": 0.1}, "precision: 0.1 is not accepted with members = 10"),
        ({"precision": 0.1}, "precision: 0.1 is not accepted with members = None"),
        ({"members": "auto", "precision": 0.5}, "precision: 0.5 is not accepted; a number from"),
        ({"members": "auto", "precision": 1e-5}, "precision: 1e-05 is not accepted"),
        ({"members": "auto", "precision": "1"}, "precision: '1' is not accepted"),
        ({"members": "auto", "first_member": 3}, "first_member: with members"),
        ({"members": "many"}, "members: 'many' is not accepted"),
    ],
)
def test_refusals(
    options: dict[str, Any], message: str, embedded_wind: dc.LocalGridBootstrap
) -> None:
    with pytest.raises(ScenarioError, match=message):
        dc.forecast(dc.paper.scenario(), embedded_wind, **options)


@pytest.mark.parametrize("precision", [1e-4, 0.25, 0.4999])
def test_precisions_that_are_accepted(precision: float) -> None:
    class StopError(Exception):
        pass

    @until_precise
    def follow(*, members: Any, precision: Any, **_: Any) -> Forecast:
        raise StopError(members, precision)

    with pytest.raises(StopError) as asked:
        follow(members="auto", precision=precision)
    assert asked.value.args == (1000, precision)
