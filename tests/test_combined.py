"""Parts of an ensemble, put together: bit for bit the run of all members at once."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

import driftcore as dc
from driftcore.dataset import combined, map_counts, map_shares
from driftcore.errors import DriftCoreWarning, ScenarioError
from driftcore.maps import MapGrid

MEMBERS = 60
Run = Callable[..., xr.Dataset]


def identical(one: xr.Dataset, other: xr.Dataset) -> bool:
    """Bit for bit, types and attributes too, but for the time of making."""

    def timeless(dataset: xr.Dataset) -> xr.Dataset:
        return dataset.assign_attrs(history=dataset.attrs["history"].split(" ", 1)[1])

    one, other = timeless(one), timeless(other)
    types = all(one[name].dtype == other[name].dtype for name in one.variables)
    return types and one.identical(other)


@pytest.fixture(scope="module")
def plane(embedded_wind: dc.LocalGridBootstrap) -> Run:
    """The paper's case, with maps and targets."""
    scenario = dc.paper.scenario(epsilon=1 / 20)
    maps = MapGrid(
        x=tuple(np.linspace(0.75, 1.23, 17)), y=tuple(np.linspace(0.8, 1.27, 12)), times=(0.2, 0.9)
    )
    targets = {"triangle": [(1.05, 1.0), (1.2, 1.05), (1.05, 1.15)]}

    def run(**how: Any) -> xr.Dataset:
        how = {"seed": 3, "maps": maps, "targets": targets} | how
        return dc.forecast(scenario, embedded_wind, **how).dataset

    return run


@pytest.fixture(scope="module")
def geographic(embedded_wind: dc.LocalGridBootstrap) -> Run:
    """Uncertain releases before the coast of Brittany, with maps and targets."""
    release = dc.Release.point(-4.6, 47.9, ("2026-07-01T06:00", "2026-07-01T18:00"), radius_m=9000)
    scenario = dc.GeographicScenario(
        release,
        4,
        dc.Leeway(category="PIW-1"),
        tides=dc.tides.biscay(),
        coast=dc.LandCoast.default(),
    )
    maps = MapGrid(
        x=tuple(np.arange(-5, -3.9, 0.1)), y=tuple(np.arange(47.5, 48.5, 0.1)), times=(1.0, 3.9)
    )
    targets = {"box": [(-4.5, 47.8), (-4.2, 47.8), (-4.2, 48.0), (-4.5, 48.0)]}

    def run(**how: Any) -> xr.Dataset:
        how = {"seed": 3, "maps": maps, "targets": targets} | how
        with warnings.catch_warnings():
            # Four days are short for averaging.
            warnings.simplefilter("ignore", DriftCoreWarning)
            return dc.forecast(scenario, embedded_wind, **how).dataset

    return run


splits = st.lists(st.integers(1, MEMBERS - 1), unique=True, min_size=1, max_size=4).map(sorted)


@pytest.mark.parametrize("case", ["plane", "geographic"])
@settings(max_examples=settings().max_examples // 5)
@given(cuts=splits, keep=st.sampled_from([0, 1, 25, MEMBERS]), data=st.data())
def test_parts_make_up_the_whole(
    request: pytest.FixtureRequest, case: str, cuts: list[int], keep: int, data: st.DataObject
) -> None:
    run: Run = request.getfixturevalue(case)
    edges = [0, *cuts, MEMBERS]
    parts = [
        run(first_member=first, members=last - first, keep=keep, chunk=17)
        for first, last in itertools.pairwise(edges)
    ]
    whole = run(members=MEMBERS, keep=keep)
    assert (whole["presence"] > 0).any()
    assert whole["entry_time"].notnull().any()
    assert identical(combined(data.draw(st.permutations(parts))), whole)


def test_given_paths_are_split_too(embedded_wind: dc.LocalGridBootstrap) -> None:
    scenario = dc.paper.scenario(epsilon=1 / 20)
    paths = [dc.member_path(scenario, embedded_wind, k) for k in range(5)]
    whole = dc.forecast(scenario, paths, keep=3).dataset
    parts = [
        dc.forecast(scenario, paths, keep=3, first_member=first, members=members).dataset
        for first, members in ((0, 2), (2, None))
    ]
    assert identical(combined(parts), whole)


def test_maps_without_a_member_that_could_be_followed() -> None:
    """A wind that no step size follows; the parts have no shares, and nor has the whole."""
    steep = dc.WindPath([-1, 2], [[1e300, 0], [1e300, 0]])
    maps = MapGrid(x=(0.0, 1.0, 2.0), y=(0.0, 1.0, 2.0), times=(0.5,))
    scenario = dc.paper.scenario(epsilon=1 / 20)

    def run(**how: Any) -> xr.Dataset:
        return dc.forecast(scenario, [steep, steep], maps=maps, model="full", **how).dataset

    with pytest.warns(DriftCoreWarning, match="2 of 2 members failed; member 0: "):
        whole = run()
    with pytest.warns(DriftCoreWarning, match="1 of 1 members failed; member 1: "):
        last = run(first_member=1)
    with pytest.warns(DriftCoreWarning, match="1 of 1 members failed; member 0: "):
        first = run(members=1)
    assert identical(combined([first, last]), whole)


def test_counts_of_many_members_are_whole_numbers_again() -> None:
    rng = np.random.default_rng(1)
    members = 2**33 + 12345
    counts = rng.integers(0, members + 1, (5, 10**5))
    counts[:, :4] = [0, 1, members - 1, members]
    names = ("presence", "arrival", "visit", "outside", "ashore")
    shares = map_shares(dict(zip(names, counts, strict=True)), members)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("driftcore.dataset.followed_of", lambda _: members)
        dataset = xr.Dataset({name: ("cell", share) for name, share in shares.items()})
        for name, count in zip(names, counts, strict=True):
            np.testing.assert_array_equal(map_counts(dataset)[name], count)


@pytest.mark.parametrize(
    ("ranges", "how", "message"),
    [
        ([], {}, "parts: an empty list is not accepted"),
        ([(0, 5), (6, 5)], {}, "parts: of member, some are missing or come twice"),
        ([(0, 5), (4, 5)], {}, "parts: of member, some are missing or come twice"),
        ([(0, 5), (5, 5)], {"seed": 4}, "parts: seed is .*3.* and .*4.*; they are not of one"),
        ([(0, 8), (8, 5)], {"keep": 20}, "parts: of kept_member, some are missing or come twice"),
        ([(0, 5), (5, 5)], {"times": [0.0, 1.0]}, "parts: time differs"),
        ([(0, 5), (5, 5)], {"maps": None}, "parts: [a-z_]+ is in some of them"),
    ],
)
def test_refused_parts(
    plane: Run, ranges: list[tuple[int, int]], how: dict[str, Any], message: str
) -> None:
    parts = [
        plane(**{"keep": 7, **(how if k else {})}, first_member=first, members=members)
        for k, (first, members) in enumerate(ranges)
    ]
    with pytest.raises(ScenarioError, match=message):
        combined(parts)


@pytest.mark.parametrize("first", [-1, 0.5, "0", True])
def test_refused_ranges(plane: Run, geographic: Run, first: Any) -> None:
    for run in (plane, geographic):
        with pytest.raises(ScenarioError, match=f"first_member: {first!r} is not accepted"):
            run(first_member=first)
