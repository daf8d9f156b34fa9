"""No file that is read runs anything, or writes: SECURITY.md."""

import ast
import io
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import driftcore as dc
from driftcore.geographic_configuration import GeographicConfiguration
from driftcore.grids import read_vector_grid

PACKAGE = Path(dc.__file__).parent


class Bomb:
    """Runs when it is unpickled."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return os.mkdir, (os.environ["DRIFTCORE_BOMB"],)


@pytest.fixture
def bomb(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Bytes that make a folder where they are unpickled; that it works, and then that none was."""
    proof = tmp_path / "proof"
    monkeypatch.setenv("DRIFTCORE_BOMB", str(proof))
    data = pickle.dumps(Bomb())
    pickle.loads(data)  # noqa: S301 (our own)
    assert proof.is_dir()
    proof.rmdir()
    yield data
    assert not proof.exists()


def readers() -> list[Any]:
    from driftcore.tides import from_atlas

    return [
        dc.read_record,
        lambda path: read_vector_grid(path, "wind"),
        from_atlas,
        dc.open_forecast,
        lambda path: dc.read_configuration(Path(path)),
        dc.LandCoast.from_file,
    ]


@pytest.mark.parametrize("suffix", [".nc", ".csv", ".toml", ".geojson", ".gpkg", ".npy", ".pkl"])
def test_a_pickle_by_any_name_is_no_data(suffix: str, bomb: bytes, tmp_path: Path) -> None:
    pytest.importorskip("pyTMD")
    array = io.BytesIO()
    np.save(array, np.array([Bomb()], dtype=object))
    for data in (bomb, array.getvalue()):
        path = tmp_path / f"file{suffix}"
        path.write_bytes(data)
        for read in readers():
            with pytest.raises(dc.DriftCoreError):
                read(str(path))


def test_pickles_inside_of_netcdf_stay_bytes(bomb: bytes, tmp_path: Path) -> None:
    """As a variable of opaque bytes or of text, and as an attribute."""
    pytest.importorskip("pyTMD")
    for kind in (np.void(bomb), bomb.hex()):
        path = tmp_path / "file.nc"
        with h5py.File(path, "w") as file:
            for name in ("u10", "v10", "time", "status", "stranding_time", "Ua", "Ug"):
                file[name] = [kind] * 3 if isinstance(kind, str) else np.array([kind] * 3)
                file[name].attrs["units"] = kind
            file.attrs["configuration"] = kind
        for read in readers()[:4]:
            with pytest.raises(dc.DriftCoreError):
                read(str(path))


def test_nothing_in_the_package_can_run_a_file() -> None:
    """No pickle, no eval, no shell, no YAML, no joblib, in any of its modules."""
    modules = {"pickle", "dill", "shelve", "marshal", "joblib", "yaml", "subprocess", "ctypes"}
    calls = {"eval", "exec", "compile", "system", "popen", "read_pickle"}
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = {alias.name.split(".")[0] for alias in node.names}
                names |= {(getattr(node, "module", None) or "").split(".")[0]}
                assert not names & modules, f"{file}:{node.lineno}"
            if isinstance(node, ast.Call):
                name = getattr(node.func, "id", getattr(node.func, "attr", ""))
                owner = getattr(getattr(node.func, "value", None), "id", "")
                assert name not in calls or owner in ("re", "platform"), f"{file}:{node.lineno}"
                keywords = {k.arg: ast.unparse(k.value) for k in node.keywords}
                assert keywords.get("allow_pickle", "False") == "False", f"{file}:{node.lineno}"
                assert keywords.get("shell", "False") == "False", f"{file}:{node.lineno}"


def test_the_core_has_no_unsafe_code() -> None:
    root = Path(__file__).parents[1]
    assert 'unsafe_code = "forbid"' in (root / "Cargo.toml").read_text(encoding="utf-8")
    for file in (root / "rust").rglob("*.rs"):
        assert "unsafe " not in file.read_text(encoding="utf-8"), file


GUARDED = """
import os, sys
from pathlib import Path
written = []
def watch(event, arguments):
    if event == "open":
        path, mode, flags = arguments
        if flags is not None and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            written.append(str(path))
    elif event in ("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.symlink", "os.link"):
        written.append(str(arguments[0]))
    elif event.split(".")[0] in ("subprocess", "socket") or event in ("os.system", "os.exec"):
        written.append(event)
sys.dont_write_bytecode = True
import driftcore as dc, driftcore.forecast, driftcore.paper, pandas, pyTMD, shapely, scipy
from driftcore.coast import LandCoast
from driftcore.tides import biscay
biscay(); LandCoast.default()
sys.addaudithook(watch)
for name in sys.argv[1:]:
    try:
        configuration = dc.read_configuration(Path(name))
        dc.run(configuration, folder=Path(name).parent, threads=1)
    except dc.DriftCoreError as error:
        print("refused", error)
    else:
        print("ran")
outside = [path for path in written if path not in ("/dev/null",)]
assert not outside, outside
"""


@pytest.mark.skipif(sys.platform == "win32", reason="paths are written otherwise there")
def test_no_key_of_a_scenario_writes(tmp_path: Path) -> None:
    """Each text of a scenario in turn names a file to write; running it opens none for writing."""
    pytest.importorskip("pyTMD")
    target = tmp_path / "target"
    target.mkdir()
    run = {"members": 2, "keep": 2}
    bases: list[tuple[Any, dict[str, Any]]] = [
        (dc.RunConfiguration, {"ensemble": run, "wind": {"h": 0.4}}),
        (
            GeographicConfiguration,
            {
                "kind": "geographic",
                "days": 2.0,
                "release": {"coordinates": [-5.0, 46.0], "start": "2026-07-01"},
                "object": {"response_time_h": 1.0, "wind_factor": 0.03},
                "tides": {"kind": "biscay"},
                "wind": {"h": 0.4},
                "ensemble": run,
            },
        ),
    ]
    files = []
    for kind, values in bases:
        text = kind(**values).to_toml()
        files.append(tmp_path / f"{kind.__name__}.toml")
        files[-1].write_text(text, encoding="utf-8")
        for number, line in enumerate(text.splitlines()):
            name, _, value = line.partition(" = ")
            if value.startswith('"'):
                hostile = text.replace(line, f'{name} = "{target / "written.nc"}"')
                files.append(tmp_path / f"{kind.__name__}{number}.toml")
                files[-1].write_text(hostile, encoding="utf-8")
    assert len(files) > 15
    done = subprocess.run(  # noqa: S603 (our own interpreter)
        [sys.executable, "-c", GUARDED, *map(str, files)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told = done.stdout.splitlines()
    assert len(told) == len(files)
    assert told.count("ran") >= 4  # the two as they are, and names for people
    assert not list(target.iterdir())
