"""A few seconds of hostile input for each way in: `fuzz/run.py` feeds more."""

import faulthandler
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "fuzz"))

from run import run
from targets import TARGETS

pytest.importorskip("shapely")
pytest.importorskip("pyTMD")
pytestmark = pytest.mark.filterwarnings("ignore")
CASES = {"toml": 3000, "csv": 1000, "dataset": 150, "netcdf": 150, "geojson": 1500}


@pytest.mark.parametrize("name", TARGETS)
def test_hostile_input_is_sane_or_refused(name: str, tmp_path: Path) -> None:
    cases = CASES.get(name, 2000)
    report = run(name, cases, seed=1, folder=tmp_path)
    assert not report.findings, report
    assert report.cases == cases
    # What nothing passes tests nothing, and so does what all passes.
    assert 0.02 < report.accepted / cases < 0.9, report


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "process ended by SIGSEGV"),
        ("raise KeyError('x')", "KeyError at "),
        ("bytearray(2**40)", "MemoryError at "),
        ("raise dc.ScenarioError('')", "AssertionError at "),
    ],
)
def test_a_fault_is_found_and_kept(fault: str, told: str, tmp_path: Path) -> None:
    from targets import Target

    import driftcore as dc

    def feed(_: object) -> None:
        faulthandler.disable()  # in the child: this crash is meant
        exec(fault, {"dc": dc})  # noqa: S102

    TARGETS["faulty"] = Target("faulty", lambda rng: rng.random(), feed)
    try:
        report = run("faulty", 3, seed=1, folder=tmp_path)
    finally:
        del TARGETS["faulty"]
    assert report.cases == 3
    ((what, file),) = report.findings.items()
    assert what.startswith(told)
    assert "--seed 1 --only 0" in file.read_text()


def test_a_case_that_cannot_be_made_ends_the_run(tmp_path: Path) -> None:
    """It is no finding, and is not tried for ever."""
    from targets import Target

    TARGETS["unmade"] = Target("unmade", lambda _: 1 / 0, lambda _: None)
    try:
        with pytest.raises(RuntimeError, match="unmade: case 0 of seed 1 could not be made"):
            run("unmade", 3, seed=1, folder=tmp_path)
    finally:
        del TARGETS["unmade"]
