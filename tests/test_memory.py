"""What does not fit into memory is refused before it is made, by the argument that asks for it."""

import math
import os
import re
import resource
import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import driftcore as dc
from driftcore import _core, memory
from driftcore.climate import synthetic_record
from driftcore.members import Fates

SCENARIO = dc.paper.scenario(epsilon=0.1)
CALM = dc.WindPath([-1.0, 2.0], np.zeros((2, 2)))
NUMBERS = np.broadcast_to(0.5, 10**12)


@cache
def fitted() -> dc.LocalGridBootstrap:
    return dc.LocalGridBootstrap.fit(synthetic_record(3), h=0.4)


def release() -> Any:
    pytest.importorskip("shapely")
    return dc.GeographicScenario(
        dc.Release.point(-4.1, 47.2, "2026-07-01"), 10, dc.FloatingBody(response_time_h=1.0)
    )


@pytest.mark.parametrize(
    ("field", "ask"),
    [
        ("times", lambda: dc.trajectory(SCENARIO, CALM, model="full", times=NUMBERS)),
        ("times", lambda: dc.trajectory(SCENARIO, CALM, model="full", times=range(10**12))),
        ("times", lambda: dc.forecast(SCENARIO, [CALM], times=NUMBERS)),
        (
            "keep",
            lambda: dc.forecast(
                SCENARIO, fitted(), members=900_000, keep=900_000, times=np.ones(1000)
            ),
        ),
        ("members", lambda: fitted().sample(10**12, 10, 1)),
        ("members", lambda: fitted().sample(10, 10**12, 1)),
        ("velocity", lambda: dc.WindPath([0.0, 1.0], np.broadcast_to(0.0, (10**12, 2)))),
        ("velocity", lambda: dc.WindPaths([0.0, 1.0], np.broadcast_to(0.0, (10**12, 2, 2)))),
        ("threads", lambda: full_map().core(np.linspace(0, 1, 3), 1024)),
        (
            "times",
            lambda: dc.forecast(
                release(), fitted(), times=np.broadcast_to(np.datetime64("2026-07-02"), 10**12)
            ),
        ),
    ],
)
def test_refused_with_what_it_takes_and_what_there_is(field: str, ask: Any) -> None:
    fitted()
    start = time.process_time()
    with pytest.raises(dc.ScenarioError, match=rf"^{field}: .* are not accepted; ") as caught:
        ask()
    wanted, free = map(float, re.findall(r"([\d.e+]+) GB", str(caught.value)))
    assert wanted > free
    assert free == pytest.approx(memory.available() / 1e9, rel=0.5)
    assert time.process_time() - start < 3


def full_map() -> dc.MapGrid:
    """As many values as a map may hold."""
    edges = tuple(float(k) for k in range(10_001))
    return dc.MapGrid(x=edges, y=edges, times=(1.0,))


def test_a_map_of_a_million_by_a_million_cells() -> None:
    edges = tuple(map(float, range(1_000_001)))
    with pytest.raises(dc.ScenarioError, match=r"1000000 x 1000000 cells .* 8e\+03 GB, at most 1e"):
        dc.MapGrid(x=edges, y=edges, times=(1.0,))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[ensemble]\nkeep = 100000\nmembers = 100000\noutputs_per_tide = 1e6", "ensemble.keep: "),
        ("[ensemble]\nkeep = 0\noutputs_per_tide = 1e12", "ensemble.keep: 0 is not accepted"),
        ("[scenario]\nduration = 1e9", "scenario.drag: "),
        ("[ensemble]\nmembers = 1000000000", "ensemble.members: "),
    ],
)
def test_a_scenario_that_asks_for_too_much(text: str, told: str) -> None:
    with pytest.raises(dc.ScenarioError, match=told):
        dc.RunConfiguration.from_toml(text)


@pytest.mark.parametrize(
    ("told", "ask"),
    [
        ("map cells", lambda: maps(10**6, 10**6)),
        ("map cells", lambda: maps(2**40, 2**40)),
        ("threads: 100000000 ", lambda: maps(5, 5, 10**8)),
        ("members", lambda: fitted().core.sample(10**12, 10, 1)),
        ("members", lambda: fitted().core.sample(2**63, 2**63, 1)),
        ("member", lambda: fitted().core.sample(5, 5, 1, 2**64 - 1)),
        ("count", lambda: fitted().core.draws_at(np.zeros(4), 2**62, 1)),
        ("substeps", lambda: generator(10**9, 0)),
        ("end of the wind path", lambda: generator(1, 0).path(1, 0, 1e18)),
        ("end of the wind path", lambda: generator(1, 2**62).path(1, 0, 1.0)),
        ("times", lambda: paths().velocity(4, np.broadcast_to(0.5, 10**12))),
    ],
)
def test_the_core_refuses_instead_of_giving_up(told: str, ask: Any) -> None:
    with pytest.raises(ValueError, match=told):
        ask()


def maps(columns: int, rows: int, threads: int = 1) -> _core.Maps:
    instants = np.array([0.5, 1.0])
    return _core.Maps((0.0, 1.0, columns), (0.0, 1.0, rows), instants, instants, threads)


def generator(substeps: int, lead_in: int) -> _core.WindGenerator:
    return _core.WindGenerator(fitted().core, 0.01, 3.0, 0.1, 0.01, substeps, lead_in)


def paths() -> _core.WindPaths:
    return _core.WindPaths(0.0, 1.0, np.zeros((4, 2, 2)))


@pytest.mark.parametrize("tide", [1e-3, 0.1, 1e6])
def test_a_tide_that_no_record_resolves(tide: float) -> None:
    scenario = SCENARIO.replace(tide_period_h=tide, duration=1e-4)
    with pytest.raises(
        dc.ScenarioError, match=r"tide_period_h: .* with a wind every 6 h it should"
    ):
        dc.forecast(scenario, fitted(), members=2)


def test_small_things_are_made_without_a_look_at_the_system(monkeypatch: Any) -> None:
    monkeypatch.setattr(memory, "available", lambda: 0.0)
    memory.require_room("members", 1000, 8, "members")
    with pytest.raises(dc.ScenarioError, match=r"members: 1e\+07 members are .* 0.08 GB, 0 GB are"):
        memory.require_room("members", 10**7, 8, "members")


def test_a_container_leaves_what_it_does_not_use(monkeypatch: Any, tmp_path: Path) -> None:
    """Of two limits the tighter holds; what says "max", or is not there, limits nothing."""
    files = {"max": "max", "wide": f"{2**21}\n", "tight": f"{2**20}\n", "used": f"{2**19}\n"}
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="ascii")

    def left(*limits: str) -> float:
        groups = [(str(tmp_path / limit), str(tmp_path / "used")) for limit in limits]
        monkeypatch.setattr(memory, "_GROUPS", groups)
        return memory.available()

    assert left("max", "absent") > 2**21
    assert left("max", "wide") == 2**21 - 2**19
    assert left("wide", "tight") == left("tight", "wide") == 2**19
    # Used beyond the limit, which happens for a moment.
    (tmp_path / "used").write_text(f"{2**22}", encoding="ascii")
    assert left("tight") == 0


def test_a_limit_of_the_process_leaves_what_it_does_not_use(monkeypatch: Any) -> None:
    """`ulimit -v`: the whole address space of the process counts against it."""
    before = memory.available()
    taken = resource.getpagesize() * int(Path("/proc/self/statm").read_text().split()[0])
    limit = taken + 2**28
    limits = {resource.RLIMIT_AS: (limit, resource.RLIM_INFINITY)}
    monkeypatch.setattr(resource, "getrlimit", limits.__getitem__)
    assert memory.available() == pytest.approx(2**28, abs=2**27)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    assert memory.available() == pytest.approx(before, rel=0.5)


def test_without_what_linux_tells_it_is_all_of_the_machine(monkeypatch: Any) -> None:
    monkeypatch.setattr(memory, "_GROUPS", ())

    def absent(path: Path, **_: Any) -> str:
        raise FileNotFoundError(path)

    monkeypatch.setattr(Path, "read_text", absent)
    assert memory.available() == os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    monkeypatch.delattr(os, "sysconf")
    assert memory.available() == math.inf


def test_members_take_their_fates_and_a_dataset_of_them(monkeypatch: Any) -> None:
    """Twice a status of one byte, a time, a place and a time for each target, of eight a number."""
    monkeypatch.setattr(memory, "available", lambda: 0.0)
    each = 1 + 3 * 8
    for targets in (0, 2):
        bytes_ = 2 * (each + 8 * targets) * 10**6
        with pytest.raises(dc.ScenarioError, match=f"^members: .* take {bytes_ / 1e9:.3g} GB"):
            Fates.empty(10**6, 0, 1, targets)
    with pytest.raises(dc.ScenarioError, match=r"^keep: 1e\+06 positions .* take 0\.032 GB"):
        Fates.empty(1, 1000, 1000, 0)
