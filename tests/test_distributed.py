"""Chunks followed by workers of dask: the same bits, however many, whoever of them is killed."""

# ruff: noqa: S603 (what is started is named here)

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NoReturn

import pytest
import xarray as xr

import driftcore as dc
from driftcore.climate import synthetic_record
from driftcore.distributed import connected, need_distributed
from driftcore.errors import DriftCoreError, OutputError
from driftcore.geographic_configuration import read_configuration
from test_combined import identical

pytest.importorskip("zarr", minversion="3", reason="the stores' zarr is 3 or later")
pytest.importorskip("distributed")

SCENARIO = """
[scenario]
epsilon = 0.05
[wind]
record = "wind.csv"
[ensemble]
members = 200
keep = 50
[maps]
x = [0.0, 0.5, 1.0, 1.5, 2.0]
y = [0.0, 0.5, 1.0, 1.5, 2.0]
times = [0.25, 0.5, 1.0]
"""
CHUNK = 10


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, xr.Dataset]:
    """A scenario file, and what a run in one go gives."""
    folder = tmp_path_factory.mktemp("scenario")
    synthetic_record(3).to_csv(folder / "wind.csv")
    scenario = folder / "scenario.toml"
    scenario.write_text(SCENARIO, encoding="utf-8")
    return scenario, dc.run(read_configuration(scenario), folder=folder).dataset


@contextmanager
def dask(*how: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process of dask, until the block ends."""
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *how], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@contextmanager
def scheduling(folder: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Address and process of a scheduler without workers: `dask scheduler`."""
    file = folder / "scheduler.json"
    how = ("--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    with dask("scheduler", *how) as process:
        deadline = time.monotonic() + 60
        while not file.exists():
            assert time.monotonic() < deadline
            time.sleep(0.05)
        time.sleep(0.1)
        yield json.loads(file.read_text())["address"], process


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with scheduling(tmp_path_factory.mktemp("scheduler")) as (address, _):
        yield address


def worker(address: str, threads: int = 1) -> contextmanager[subprocess.Popen[bytes]]:
    return dask(
        "worker", address, "--no-nanny", "--nthreads", str(threads), "--no-dashboard",
        "--death-timeout", "60",
    )  # fmt: skip


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_the_same_bits_from_any_number_of_workers_one_of_them_killed(
    workers: int, case: tuple[Path, xr.Dataset], scheduler: str, tmp_path: Path
) -> None:
    scenario, whole = case
    with ExitStack() as stack:
        processes = [stack.enter_context(worker(scheduler, 1 + k % 2)) for k in range(workers)]
        client = stack.enter_context(connected(scheduler))
        client.wait_for_workers(workers, timeout=60)
        seen = []

        def progress(done: int, members: int) -> None:
            seen.append((done, members))
            if done == 3 * CHUNK:
                processes[0].kill()
                if workers == 1:
                    processes.append(stack.enter_context(worker(scheduler)))

        forecast = dc.run(
            read_configuration(scenario),
            folder=scenario.parent,
            store=tmp_path / "out.zarr",
            chunk=CHUNK,
            client=client,
            progress=progress,
        )
        assert processes[0].wait(timeout=60) == -9
    assert identical(forecast.dataset.load(), whole)
    assert seen == [(done, 200) for done in range(0, 201, CHUNK)]


def test_workers_with_other_files_are_refused(
    case: tuple[Path, xr.Dataset], scheduler: str, tmp_path: Path
) -> None:
    """The record changes once the run has begun, before a worker reads it."""
    scenario, whole = case
    record = scenario.with_name("wind.csv")
    known = record.read_bytes()
    how = {"folder": scenario.parent, "store": tmp_path / "out.zarr"}
    configuration = read_configuration(scenario)
    with worker(scheduler), connected(scheduler) as client:

        def progress(_: int, __: int) -> None:
            record.write_bytes(known + b"\n")

        try:
            with pytest.raises(OutputError, match="differs from the file that the run began with"):
                dc.run(configuration, **how, client=client, progress=progress)
        finally:
            record.write_bytes(known)
    # And gone on with here.
    assert identical(dc.run(configuration, **how, resume=True).dataset.load(), whole)


def test_the_command_starts_workers(case: tuple[Path, xr.Dataset], tmp_path: Path) -> None:
    scenario, whole = case
    store = tmp_path / "out.zarr"
    how = ["run", str(scenario), "-o", str(store), "--workers", "2", "--chunk", "50", "-q"]
    start = "from driftcore.cli import main\nif __name__ == '__main__': main()"
    end = subprocess.run(
        [sys.executable, "-c", start, *how], capture_output=True, text=True, check=False
    )
    assert (end.returncode, end.stderr) == (0, "")
    assert identical(dc.open_forecast(store).dataset.load(), whole)


def test_where_no_scheduler_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("driftcore.distributed._WAIT_S", 1)
    with pytest.raises(DriftCoreError, match=r"scheduler: none answers at tcp://127.0.0.1:9"):
        connected("tcp://127.0.0.1:9").__enter__()


def test_a_scheduler_without_workers(
    case: tuple[Path, xr.Dataset],
    scheduler: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario, _ = case
    monkeypatch.setattr("driftcore.distributed._WAIT_S", 1)
    with (
        connected(scheduler) as client,
        pytest.raises(DriftCoreError, match="no workers for 1 s; start some by: dask worker"),
    ):
        dc.run(
            read_configuration(scenario),
            folder=scenario.parent,
            store=tmp_path / "out.zarr",
            client=client,
        )


class StopError(Exception):
    """Where a run is stopped."""


def test_all_followed_already_takes_no_workers(
    case: tuple[Path, xr.Dataset],
    scheduler: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A run that ended between its last chunk and its name."""
    scenario, whole = case
    how = {"folder": scenario.parent, "store": tmp_path / "out.zarr", "chunk": 50}

    def stopped(_: object) -> NoReturn:
        raise StopError

    with monkeypatch.context() as patched:
        patched.setattr("driftcore.store._Growing.finish", stopped)
        with pytest.raises(StopError):
            dc.run(read_configuration(scenario), **how)
    with connected(scheduler) as client:
        assert not client.nthreads()
        forecast = dc.run(read_configuration(scenario), **how, resume=True, client=client)
    assert identical(forecast.dataset.load(), whole)


def test_members_over_which_workers_die(
    case: tuple[Path, xr.Dataset], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import dask as settings

    def dying(*_: object) -> None:
        os._exit(1)

    monkeypatch.setattr("driftcore.distributed._follow", dying)
    with (
        settings.config.set({"distributed.scheduler.allowed-failures": 0}),
        connected(workers=1) as client,
        pytest.raises(DriftCoreError, match="workers: several died over the same members: "),
    ):
        dc.run(
            read_configuration(case[0]),
            folder=case[0].parent,
            store=tmp_path / "out.zarr",
            client=client,
        )


def test_workers_without_what_is_needed(
    case: tuple[Path, xr.Dataset],
    scheduler: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def lacking(*_: object) -> NoReturn:
        raise ModuleNotFoundError("No module named 'driftcore'")

    monkeypatch.setattr("driftcore.distributed._follow", lacking)
    with (
        worker(scheduler),
        connected(scheduler) as client,
        pytest.raises(DriftCoreError, match="workers: they cannot go on: No module named 'drift"),
    ):
        dc.run(
            read_configuration(case[0]),
            folder=case[0].parent,
            store=tmp_path / "out.zarr",
            client=client,
        )


def test_a_scheduler_that_is_gone(case: tuple[Path, xr.Dataset], tmp_path: Path) -> None:
    scenario, whole = case
    how = {"folder": scenario.parent, "store": tmp_path / "out.zarr", "chunk": CHUNK}
    with (
        scheduling(tmp_path) as (address, process),
        worker(address),
        connected(address) as client,
    ):

        def progress(done: int, _: int) -> None:
            if done == 3 * CHUNK:
                process.kill()

        with pytest.raises(DriftCoreError, match="workers: they cannot go on: "):
            dc.run(read_configuration(scenario), **how, client=client, progress=progress)
    # What was finished is kept.
    seen: list[int] = []
    forecast = dc.run(
        read_configuration(scenario), **how, resume=True, progress=lambda done, _: seen.append(done)
    )
    assert seen[0] >= 3 * CHUNK
    assert identical(forecast.dataset.load(), whole)


def test_without_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(DriftCoreError, match=r"not installed: pip install \"driftcore\[distrib"):
        need_distributed()
