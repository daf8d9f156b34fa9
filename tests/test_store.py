"""Long runs: stopped anywhere and gone on with, they are bit for bit what they would have been."""

# ruff: noqa: S603 (what is started is named here)

from __future__ import annotations

import json
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import driftcore as dc
from driftcore.climate import synthetic_record
from driftcore.errors import DriftCoreWarning, OutputError, ScenarioError
from driftcore.geographic_configuration import read_configuration
from driftcore.store import Job
from test_combined import identical

pytest.importorskip("zarr", minversion="3", reason="the stores' zarr is 3 or later")

MEMBERS, CHUNK = 90, 20
PLANE = f"""
[wind]
record = "wind.csv"
[scenario]
epsilon = 0.05
[ensemble]
members = {MEMBERS}
seed = 3
keep = 50
[maps]
x = {np.linspace(0.75, 1.23, 17).tolist()}
y = {np.linspace(0.8, 1.27, 12).tolist()}
times = [0.2, 0.9]
[targets]
triangle = [[1.05, 1.0], [1.2, 1.05], [1.05, 1.15]]
"""
GEOGRAPHIC = f"""
kind = "geographic"
days = 4
[release]
kind = "point"
coordinates = [-4.6, 47.9]
start = 2026-07-01T06:00:00Z
end = 2026-07-01T18:00:00Z
radius_m = 9000
[wind]
record = "wind.csv"
[object]
category = "PIW-1"
[tides]
kind = "biscay"
[ensemble]
members = {MEMBERS}
seed = 3
keep = 50
[maps]
region = [-5, 47.5, -4, 48.5]
cell = 0.1
days = [1, 3.9]
[targets]
box = [[-4.5, 47.8], [-4.2, 47.8], [-4.2, 48.0], [-4.5, 48.0]]
"""
pytestmark = pytest.mark.filterwarnings("ignore:averaging takes for small")


class StopError(Exception):
    """Where a run is stopped."""


Case = tuple[Path, xr.Dataset]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scenario files, and the record of a wind that is fitted at once."""
    folder = tmp_path_factory.mktemp("scenarios")
    synthetic_record(3).to_csv(folder / "wind.csv")
    (folder / "plane.toml").write_text(PLANE, encoding="utf-8")
    (folder / "geographic.toml").write_text(GEOGRAPHIC, encoding="utf-8")
    return folder


def one_go(scenario: Path) -> xr.Dataset:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DriftCoreWarning)
        return dc.run(read_configuration(scenario), folder=scenario.parent).dataset


@pytest.fixture(scope="module", params=["plane", "geographic"])
def case(request: pytest.FixtureRequest, folder: Path) -> Case:
    """A scenario file, and what a run in one go gives."""
    scenario = folder / f"{request.param}.toml"
    return scenario, one_go(scenario)


@pytest.fixture(scope="module")
def plane(folder: Path) -> Case:
    return folder / "plane.toml", one_go(folder / "plane.toml")


def run(scenario: Path, store: Path, **how: Any) -> xr.Dataset:
    configuration = read_configuration(scenario)
    how = {"chunk": CHUNK, **how}
    return dc.run(configuration, folder=scenario.parent, store=store, **how).dataset


def stopped(scenario: Path, store: Path, after: int, **how: Any) -> None:
    """Run until so many members are finished."""

    def progress(done: int, _: int) -> None:
        if done >= after:
            raise StopError

    with pytest.raises(StopError):
        run(scenario, store, progress=progress, **how)


def test_a_store_is_the_run_in_one_go(case: Case, tmp_path: Path) -> None:
    scenario, whole = case
    store = tmp_path / "out.zarr"
    seen: list[tuple[int, int]] = []
    found = run(scenario, store, progress=lambda *at: seen.append(at))
    assert identical(found.load(), whole)
    assert seen[0] == (0, MEMBERS)
    assert seen[-1] == (MEMBERS, MEMBERS)
    assert seen == sorted(seen)
    assert [path.name for path in tmp_path.iterdir()] == ["out.zarr"]
    # As anyone opens it.
    with xr.open_zarr(store) as opened:
        np.testing.assert_array_equal(opened["status"], whole["status"])
    again = dc.open_forecast(store)
    assert again.followed == MEMBERS
    assert ("stranding_longitude" in whole) == isinstance(again, dc.GeographicForecast)


@pytest.mark.parametrize("keep", [0, 10, 40, MEMBERS])
def test_kept_members(keep: int, plane: Case, tmp_path: Path) -> None:
    scenario = plane[0].with_name(f"keep{keep}.toml")
    scenario.write_text(PLANE.replace("keep = 50", f"keep = {keep}"), encoding="utf-8")
    assert identical(run(scenario, tmp_path / "out.zarr").load(), one_go(scenario))


def test_stopped_again_and_again(case: Case, tmp_path: Path) -> None:
    scenario, whole = case
    store = tmp_path / "out.zarr"
    for after in (0, 30, 60, MEMBERS):
        stopped(scenario, store, after, resume=True)
        with pytest.raises(
            OutputError, match=r"is unfinished; \d+ of 90 members are there; driftc"
        ):
            dc.open_forecast(store)
    assert identical(run(scenario, store, resume=True).load(), whole)
    # What is finished is opened.
    before = (store / "manifest.json").stat().st_mtime_ns
    assert identical(run(scenario, store, resume=True).load(), whole)
    assert (store / "manifest.json").stat().st_mtime_ns == before


def test_killed_after_the_store_got_its_name(plane: Case, tmp_path: Path) -> None:
    scenario, whole = plane
    store, part = tmp_path / "out.zarr", tmp_path / "out.zarr.part"
    run(scenario, store)
    part.mkdir()
    (part / "manifest.json").write_bytes((store / "manifest.json").read_bytes())
    (part / "lock").touch()
    assert identical(run(scenario, store, resume=True).load(), whole)
    assert not part.exists()


def command(scenario: Path, store: Path, *more: str) -> list[str]:
    start = "from driftcore.cli import main; main()"
    how = ["run", str(scenario), "-o", str(store), "--chunk", str(CHUNK), *more]
    return [sys.executable, "-c", start, *how]


def test_killed_at_random_moments(plane: Case, tmp_path: Path) -> None:
    """SIGKILL, of a process whose chunks are slowed down so that most kills meet the writing."""
    scenario, whole = plane
    store, rng = tmp_path / "out.zarr", random.Random(1)  # noqa: S311 (no secret)
    manifest = tmp_path / "out.zarr.part" / "manifest.json"
    kills = 0
    while kills < 5:
        process = subprocess.Popen(command(scenario, store, "--resume", "-q"))
        began = manifest.stat().st_mtime_ns if manifest.exists() else 0
        while process.poll() is None and not (
            manifest.exists() and manifest.stat().st_mtime_ns > began
        ):
            time.sleep(0.001)
        time.sleep(rng.uniform(0, 0.02))
        process.kill()
        if process.wait() == 0:
            break
        kills += 1
    assert kills > 0
    assert identical(run(scenario, store, resume=True).load(), whole)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("seed = 3", "seed = 4", "ensemble.seed is 4, and was 3 when"),
        ("members = 90", "members = 91", "ensemble.members is 91, and was 90"),
        ("keep = 50", "keep = 50\nrtol = 1e-5", "ensemble.rtol is 1e-05, and was 1e-06"),
        ("[0.2, 0.9]", "[0.2, 0.8]", r"maps.times is \[0.2, 0.8\], and was \[0.2, 0.9\]"),
        ("triangle", "area", "targets.triangle[.a-z]* is 'absent', and was "),
    ],
)
def test_a_changed_scenario_is_refused(
    old: str, new: str, message: str, plane: Case, tmp_path: Path
) -> None:
    scenario, _ = plane
    store, changed = tmp_path / "out.zarr", scenario.with_name("changed.toml")
    stopped(scenario, store, 30)
    assert old in PLANE
    changed.write_text(PLANE.replace(old, new), encoding="utf-8")
    with pytest.raises(OutputError, match=message):
        run(changed, store, resume=True)


def test_other_differences_are_refused(
    plane: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario, whole = plane
    store, record = tmp_path / "out.zarr", scenario.with_name("wind.csv")
    stopped(scenario, store, 30)
    with pytest.raises(OutputError, match="chunk is 21, and was 20 when the run began"):
        run(scenario, store, resume=True, chunk=21)
    with pytest.raises(OutputError, match=r"an unfinished run is in .*--resume goes on with it"):
        run(scenario, store)
    known = record.read_bytes()
    record.write_bytes(known + b"\n")
    with pytest.raises(OutputError, match=r"SHA-256 of .*wind.csv is '[0-9a-f]+', and was '"):
        run(scenario, store, resume=True)
    record.write_bytes(known)
    with monkeypatch.context() as patch:
        patch.setattr("driftcore.__version__", "9.9")
        with pytest.raises(OutputError, match=r"version is '9.9', and was '"):
            run(scenario, store, resume=True)
    # The number of members in a chunk is known.
    assert identical(run(scenario, store, resume=True, chunk=None).load(), whole)
    with pytest.raises(OutputError, match="exists; choose another name or ask to overwrite"):
        run(scenario, store)
    stopped(scenario, store, 30, overwrite=True)
    assert identical(dc.open_forecast(store).dataset.load(), whole)
    assert identical(run(scenario, store, overwrite=True, resume=True).load(), whole)
    assert identical(run(scenario, store, overwrite=True, chunk=7).load(), whole)


@pytest.fixture(scope="module")
def half(plane: Case, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run that was stopped after three chunks."""
    folder = tmp_path_factory.mktemp("half")
    stopped(plane[0], folder / "out.zarr", 60)
    return folder / "out.zarr.part"


def damaged(file: Path, how: str) -> None:
    data = bytearray(file.read_bytes())
    if how == "gone":
        file.unlink()
        return
    data[len(data) // 2] ^= 1
    file.write_bytes(data[:-3] if how == "truncated" else data)


@pytest.mark.parametrize("how", ["flipped", "truncated", "gone"])
@pytest.mark.parametrize(
    "file", ["data.zarr/stranding_time/1", "data.zarr/position/1.0.0", "counts/1.npz"]
)
def test_damaged_chunks_are_followed_again(
    how: str, file: str, plane: Case, half: Path, tmp_path: Path
) -> None:
    scenario, whole = plane
    store = tmp_path / "out.zarr"
    shutil.copytree(half, tmp_path / "out.zarr.part")
    damaged(tmp_path / "out.zarr.part" / file, how)
    with pytest.warns(DriftCoreWarning, match=r"chunk 1 \(members 20 to 39\) is damaged"):
        found = run(scenario, store, resume=True)
    assert identical(found.load(), whole)


@pytest.mark.parametrize("how", ["flipped", "truncated", "gone"])
@pytest.mark.parametrize("file", ["manifest.json", "data.zarr/position/.zarray"])
def test_damage_that_cannot_be_mended_is_told(
    how: str, file: str, plane: Case, half: Path, tmp_path: Path
) -> None:
    scenario, whole = plane
    store, part = tmp_path / "out.zarr", tmp_path / "out.zarr.part"
    shutil.copytree(half, tmp_path / "out.zarr.part")
    if file == "manifest.json" and how == "flipped":
        (part / file).write_text("{}")
    else:
        damaged(part / file, how)
    if file == "manifest.json" and how == "gone":
        with pytest.raises(OutputError, match=r"no manifest.json; put it back .* --overwrite"):
            run(scenario, store, resume=True)
    else:
        with pytest.raises(OutputError, match="put it back from a copy, or begin anew"):
            run(scenario, store, resume=True)
    assert (part / "data.zarr").exists()
    assert identical(run(scenario, store, overwrite=True).load(), whole)


def test_two_processes_do_not_write_one_store(plane: Case, tmp_path: Path) -> None:
    scenario, _ = plane
    store = tmp_path / "out.zarr"

    def other(_: int, __: int) -> None:
        end = subprocess.run(
            command(scenario, store, "--resume"), capture_output=True, text=True, check=False
        )
        assert end.returncode == 2
        assert "another process is writing it" in end.stderr
        raise StopError

    with pytest.raises(StopError):
        run(scenario, store, progress=other)


def test_a_full_disk_loses_nothing(plane: Case, tmp_path: Path) -> None:
    """No file may grow beyond what the first chunks take: the manifest, at some chunk."""
    scenario, whole = plane
    store = tmp_path / "out.zarr"
    manifest = tmp_path / "out.zarr.part" / "manifest.json"

    def fill(done: int, _: int) -> None:
        if done == 2 * CHUNK:
            limit = manifest.stat().st_size + 20
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, unlimited))

    _, unlimited = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(OutputError, match=r"cannot be written: .*; 20 of 90 members are kept"):
            run(scenario, store, progress=fill)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (unlimited, unlimited))
    assert identical(run(scenario, store, resume=True).load(), whole)


def test_refused_names(plane: Case, tmp_path: Path) -> None:
    scenario, _ = plane
    with pytest.raises(OutputError, match=r"the name of a store ends in \.zarr"):
        run(scenario, tmp_path / "out.nc")
    with pytest.raises(OutputError, match=r"folder .* does not exist"):
        run(scenario, tmp_path / "none" / "out.zarr")
    (tmp_path / "mine.zarr").mkdir()
    with pytest.raises(OutputError, match="no store of driftcore"):
        run(scenario, tmp_path / "mine.zarr", overwrite=True)
    (tmp_path / "other.zarr.part").mkdir()
    (tmp_path / "other.zarr.part" / "letter.txt").touch()
    with pytest.raises(OutputError, match=r"letter.txt: is not of a driftcore run; move it away"):
        run(scenario, tmp_path / "other.zarr")
    with pytest.raises(OutputError, match="cannot be read as Zarr"):
        dc.open_forecast(tmp_path / "none.zarr")
    xr.Dataset({"a": ("x", [1.0])}).to_zarr(tmp_path / "a.zarr", zarr_format=2)
    with pytest.raises(OutputError, match="is not a driftcore forecast"):
        dc.open_forecast(tmp_path / "a.zarr")
    with pytest.raises(ScenarioError, match="chunk: 0 is not accepted; a whole number from 1 up"):
        run(scenario, tmp_path / "out.zarr", chunk=0)
    with pytest.raises(ScenarioError, match="resume: True is not accepted without a store"):
        dc.run(read_configuration(scenario), folder=scenario.parent, resume=True)


def test_the_command_goes_on_where_it_was_interrupted(plane: Case, tmp_path: Path) -> None:
    scenario, whole = plane
    store = tmp_path / "out.zarr"
    process = subprocess.Popen(
        command(scenario, store, "-q"),
        stderr=subprocess.PIPE,
        text=True,
        # A shell that runs the tests in the background makes them deaf to the signal.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    while not (tmp_path / "out.zarr.part" / "manifest.json").exists():
        assert process.poll() is None
        time.sleep(0.001)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate()
    assert process.returncode == 130
    assert " ".join(told.split()).endswith("--resume")
    end = subprocess.run(
        command(scenario, store, "--resume", "--json"), capture_output=True, text=True, check=True
    )
    assert json.loads(end.stdout)["failed"] == 0
    assert identical(dc.open_forecast(store).dataset.load(), whole)
    end = subprocess.run(
        command(scenario, tmp_path / "out.nc"), capture_output=True, text=True, check=False
    )
    assert end.returncode == 2
    assert "--chunk: is of a store" in end.stderr


def test_work_of_another_version_is_refused(plane: Case) -> None:
    """As a worker with another driftcore is given it."""
    scenario, _ = plane
    job = Job.of(read_configuration(scenario), scenario.parent)
    with pytest.raises(OutputError, match=rf"version: {dc.__version__} of .* the run is of 9\.9"):
        job._replace(version="9.9").follow(0, 2)


@pytest.fixture
def at_sea(folder: Path, tmp_path: Path) -> Path:
    """A scenario file of a real sea, with a coast, a current and a wind in files."""
    shutil.copy(folder / "wind.csv", tmp_path)
    pyogrio = pytest.importorskip("pyogrio")
    shapely = pytest.importorskip("shapely")
    pyogrio.raw.write(
        tmp_path / "land.shp",
        geometry=shapely.to_wkb(np.array([shapely.box(-4, 46, -3, 49)])),
        field_data=[np.array(["Brittany"], dtype=object)],
        fields=np.array(["name"], dtype=object),
        geometry_type="Polygon",
        crs="EPSG:4326",
    )
    text = GEOGRAPHIC + '[coast]\nfile = "land.shp"\n'
    (tmp_path / "sea.toml").write_text(text, encoding="utf-8")
    return tmp_path / "sea.toml"


def test_files_beside_a_shapefile_are_of_it(at_sea: Path, tmp_path: Path) -> None:
    names = {Path(file).name for file, _ in Job.of(read_configuration(at_sea), tmp_path).inputs}
    assert {"wind.csv", "land.shp", "land.shx", "land.dbf", "land.prj"} <= names
    stopped(at_sea, tmp_path / "out.zarr", 30)
    with (tmp_path / "land.dbf").open("ab") as file:
        file.write(b" ")
    with pytest.raises(OutputError, match=r"SHA-256 of .*land\.dbf is '[0-9a-f]+', and was '"):
        run(at_sea, tmp_path / "out.zarr", resume=True)


def test_files_that_cannot_be_read_are_told(tmp_path: Path) -> None:
    scenario = tmp_path / "plane.toml"
    scenario.write_text(PLANE, encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"wind\.csv: no such file"):
        run(scenario, tmp_path / "out.zarr")
    (tmp_path / "wind.csv").mkdir()
    with pytest.raises(OutputError, match=r"wind\.csv: cannot be read: Is a directory"):
        run(scenario, tmp_path / "out.zarr")
    assert not (tmp_path / "out.zarr.part").exists()


def test_a_lock_that_cannot_be_made_is_told(plane: Case, tmp_path: Path) -> None:
    (tmp_path / "out.zarr.part").write_text("a file", encoding="utf-8")
    with pytest.raises(OutputError, match=r"out\.zarr\.part: cannot be written: .*File exists"):
        run(plane[0], tmp_path / "out.zarr")


def test_each_warning_is_said_once(folder: Path, tmp_path: Path) -> None:
    """However many chunks meet it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run(folder / "geographic.toml", tmp_path / "out.zarr")
    told = [str(warning.message) for warning in caught]
    assert len(told) == len({*told}) > 0
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        dc.run(read_configuration(folder / "geographic.toml"), folder=folder)
    assert told == [str(warning.message) for warning in caught]


def test_without_the_libraries_of_stores(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("driftcore.store._installed", lambda name: name != "filelock")
    with pytest.raises(dc.DriftCoreError, match=r'filelock, which is not .* "driftcore\[store\]"'):
        dc.open_forecast(tmp_path / "out.zarr")
