"""Long runs: forecasts that grow on disk, some members at a time, and outlive what stops them.

A run that is to become `out.zarr` grows in the folder `out.zarr.part`:

* `data.zarr`, the whole forecast laid out in Zarr, so far without the members to come;
* `counts/K.npz`, what chunk K of the members counts on maps;
* `manifest.json`, what is run, and the checksum of each finished chunk;
* `lock`, held by the process that writes.

A chunk is finished once the manifest says so. The manifest is replaced whole, after all that it
tells has reached the disk; what is found beside it is written anew. When all chunks are finished,
`data.zarr` gets the maps and becomes `out.zarr` by one renaming.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import threading
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from driftcore.dataset import (
    KEPT,
    STATUS_ATTRIBUTES,
    STATUSES,
    ensemble_attributes,
    map_counts,
    map_shares,
    member_coordinates,
    times_as_numbers,
)
from driftcore.errors import DriftCoreError, DriftCoreWarning, OutputError, ScenarioError, warn
from driftcore.files import check_writable
from driftcore.geographic_configuration import GeographicConfiguration, read_configuration
from driftcore.members import checked_count, kept_of
from driftcore.runs import planned
from driftcore.scenario import RunConfiguration

if TYPE_CHECKING:
    import xarray as xr
    from dask.distributed import Client
    from numpy.typing import NDArray

# Members that are lost at most when a run is stopped, if the user names no number: a hundredth of
# all within these bounds, and no more than this many positions kept at once.
_LEAST, _MOST, _POSITIONS = 2**10, 2**16, 2**24
_MANIFEST = "manifest.json"

Configuration = RunConfiguration | GeographicConfiguration
Part = tuple["xr.Dataset", list[str]]


class Job(NamedTuple):
    """What is run, as it is told to another process, perhaps on another machine."""

    configuration: str
    """TOML, with absolute paths."""
    inputs: tuple[tuple[str, str], ...]
    """Path and SHA-256 of each file that it names."""
    version: str
    """Of driftcore."""

    @classmethod
    def of(cls, configuration: Configuration, folder: Path | None = None) -> Job:
        """Describe a configuration whose relative paths start at a folder."""
        from driftcore import __version__

        whole = _rooted(configuration, folder)
        return cls(whole.to_toml(), tuple(_checksums(whole).items()), __version__)

    def follow(
        self,
        first: int,
        members: int,
        threads: int | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Part:
        """Follow some members; give the dataset of their forecast, and what was warned of."""
        # One at a time, and so the memory of one: a worker may be asked for several at once.
        with _one_at_a_time:
            plan = _plan(self)
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", DriftCoreWarning)
                forecast = plan(
                    first_member=first, members=members, threads=threads, progress=progress
                )
        return forecast.dataset, [str(warning.message) for warning in caught]


_one_at_a_time = threading.Lock()


@lru_cache(maxsize=1)
def _plan(job: Job) -> Any:
    """Prepare a job, once in a process.

    Raises
    ------
    OutputError
        This machine has another driftcore, or other files.
    """
    configuration = read_configuration(job.configuration)
    here = Job.of(configuration)
    if here.version != job.version:
        raise OutputError(
            f"version: {here.version} of driftcore is not accepted; the run is of {job.version}"
        )
    for path, checksum in job.inputs:
        if dict(here.inputs).get(path) != checksum:
            raise OutputError(f"{path}: differs from the file that the run began with")
    return planned(configuration)


def _rooted(configuration: Configuration, folder: Path | None) -> Configuration:
    if isinstance(configuration, GeographicConfiguration):
        return configuration.rooted(folder)
    wind = configuration.wind
    if wind.record == "embedded":
        return configuration
    record = str((folder or Path()).resolve() / wind.record)
    return configuration.replace(wind=wind.replace(record=record))


def _checksums(configuration: Configuration) -> dict[str, str]:
    """SHA-256 of the files that a configuration names."""
    named: list[str] = [configuration.wind.record]
    if isinstance(configuration, GeographicConfiguration):
        for part in (configuration.tides, configuration.current):
            named.extend(getattr(part, "files", ()))
        if configuration.coast is not None:
            named.append(configuration.coast.file)
    files = [Path(name) for name in named if name not in ("embedded", "natural-earth")]
    # What lies beside a shapefile is of it.
    beside = [p for f in files if f.suffix == ".shp" for p in f.parent.glob(f"{f.stem}.*")]
    return {str(path): _checksum([path]) for path in sorted({*files, *beside})}


def _checksum(files: Iterable[Path], root: Path | None = None) -> str:
    """SHA-256 of files, and of their names from `root` on; one that is not there counts as such."""
    digest = hashlib.sha256()
    for path in files:
        if root is not None:
            digest.update(str(path.relative_to(root)).encode())
        try:
            with path.open("rb") as file:
                while block := file.read(2**20):
                    digest.update(block)
        except FileNotFoundError:
            if root is None:
                raise ScenarioError(f"{path}: no such file") from None
        except OSError as error:
            raise OutputError(f"{path}: cannot be read: {error.strerror}") from None
    return digest.hexdigest()


def run_stored(
    configuration: Configuration,
    path: Path,
    *,
    folder: Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    chunk: int | None = None,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
    client: Client | None = None,
) -> xr.Dataset:
    """Run a configuration into a Zarr store, or go on with it: see `driftcore.run`."""
    need_store()
    if path.suffix != ".zarr":
        raise OutputError(f"{path}: is not accepted; the name of a store ends in .zarr")
    job = Job.of(configuration, folder)
    part = _part(path)
    if resume and _is_finished(path):
        _require_same(path, _read(path / _MANIFEST), _identity(job, chunk))
        shutil.rmtree(part, ignore_errors=True)
        return open_store(path)
    _check_free(path, overwrite)
    with _locked(part):
        store = _Growing.opened(path, job, resume, overwrite, chunk)
        todo = store.unfinished()
        if progress is not None:
            progress(store.done, store.members)
        told: set[str] = set()
        if client is None:
            parts = _followed_here(store, job, todo, threads, progress)
        else:
            from driftcore.distributed import followed

            parts = followed(client, job, todo)
        try:
            for number, (dataset, messages) in parts:
                store.write(number, dataset)
                for message in messages:
                    if message not in told:
                        told.add(message)
                        warn(message)
                if progress is not None:
                    progress(store.done, store.members)
            store.finish()
        except OSError as error:
            if isinstance(error, DriftCoreError):
                raise
            raise OutputError(
                f"{path}: cannot be written: {error}; {store.done} of {store.members} members are "
                f"kept in {part}, to go on with: --resume"
            ) from None
        shutil.rmtree(part, ignore_errors=True)
    return open_store(path)


def _followed_here(
    store: _Growing,
    job: Job,
    todo: dict[int, tuple[int, int]],
    threads: int | None,
    progress: Callable[[int, int], None] | None,
) -> Iterator[tuple[int, Part]]:
    """Follow chunk by chunk in this process."""
    for number, (first, members) in todo.items():
        done = store.done

        def within(some: int, _: int, done: int = done) -> None:
            if progress is not None:
                progress(done + some, store.members)

        yield number, job.follow(first, members, threads, within)


def open_store(path: Path) -> xr.Dataset:
    """Open a finished store lazily: values are read when they are asked for.

    Raises
    ------
    OutputError
        It is not there, is unfinished, or is no store of driftcore.
    """
    need_store()
    import xarray as xr

    part = _part(path)
    if not path.exists() and part.exists():
        manifest = _read(part / _MANIFEST)
        done = sum(_sizes(manifest)[int(number)][1] for number in manifest["chunks"])
        raise OutputError(
            f"{path}: is unfinished; {done} of {manifest['members']} members are there; "
            "driftcore run --resume goes on"
        )
    try:
        chunks: Any = {} if _installed("dask") else None
        dataset = xr.open_dataset(path, engine="zarr", chunks=chunks, decode_timedelta=False)
    except Exception as error:
        # As of NetCDF: a damaged store is answered with whatever the damage leads to.
        raise OutputError(f"{path}: cannot be read as Zarr: {error}") from None
    if not {"status", "stranding_time"} <= {*dataset.variables}:
        raise OutputError(f"{path}: is not a driftcore forecast")
    # JSON knows no types of numbers.
    dataset.attrs["seed"] = np.uint64(dataset.attrs["seed"])
    dataset["status"].attrs |= STATUS_ATTRIBUTES
    return dataset


class _Growing:
    """A store that is written, of which this process holds the lock."""

    def __init__(self, path: Path, job: Job, manifest: dict[str, Any]) -> None:
        self.path, self.job, self.manifest = path, job, manifest
        self.part = _part(path)
        self.data = self.part / "data.zarr"
        self.members: int = manifest["members"]
        self.keep = min(manifest["keep"], self.members)
        self.sizes = _sizes(manifest)

    @classmethod
    def opened(
        cls, path: Path, job: Job, resume: bool, overwrite: bool, chunk: int | None
    ) -> _Growing:
        """Begin anew, or open what is there and look for damage."""
        part, identity = _part(path), _identity(job, chunk)
        file = part / _MANIFEST
        if file.exists() and resume:
            manifest = _read(file)
            _require_same(path, manifest, identity)
            store = cls(path, job, manifest)
            store._drop_damaged()
            return store
        if not file.exists() and (part / "counts").exists() and not overwrite:
            raise OutputError(
                f"{part}: has finished members but no {_MANIFEST}; put it back from a copy, or "
                "begin anew with --overwrite"
            )
        if file.exists() and not overwrite:
            raise OutputError(
                f"{path}: an unfinished run is in {part}; --resume goes on with it, "
                "--overwrite begins anew"
            )
        plan = _plan(job)
        identity["chunk"] = identity["chunk"] or _chunk(plan)
        identity["wind_sha256"] = plan.args[1].record.sha256
        _clear(part, but=("lock",))
        store = cls(path, job, {**identity, "keep": plan.keywords["keep"], "chunks": {}})
        store._save(store.manifest)
        return store

    @property
    def done(self) -> int:
        """Number of members that are finished."""
        return sum(self.sizes[int(number)][1] for number in self.manifest["chunks"])

    def unfinished(self) -> dict[int, tuple[int, int]]:
        """First member and number of members of each chunk to come."""
        return {k: v for k, v in enumerate(self.sizes) if str(k) not in self.manifest["chunks"]}

    def write(self, number: int, dataset: xr.Dataset) -> None:
        """Write a chunk, and only then say so."""
        import zarr

        if not self.manifest["chunks"]:
            self._lay_out(dataset)
        first, members = self.sizes[number]
        rows = {"member": slice(first, first + members)}
        rows[KEPT] = slice(first, first + kept_of(first, members, self.keep))
        numbers = self._numbers(dataset)
        for name in self._of_members(numbers):
            variable = numbers.variables[name]
            if variable.size:
                array = zarr.open_array(self.data / name, mode="r+")
                array[rows[str(variable.dims[0])]] = variable.values
        if "presence" in dataset:
            with _whole_file(self.part / "counts" / f"{number}.npz") as temporary:
                counts: dict[str, Any] = dict(map_counts(dataset))
                np.savez_compressed(temporary, **counts)
        files = self._files(number)
        _to_disk(files)
        chunks = {**self.manifest["chunks"], str(number): _checksum(files, self.part)}
        self._save(self.manifest | {"chunks": chunks})

    def finish(self) -> None:
        """Add the maps, and give the store its name."""
        import zarr

        counted = [self.part / "counts" / f"{number}.npz" for number in range(len(self.sizes))]
        if counted[0].exists():
            counts: dict[str, NDArray[np.int64]] = {}
            for file in counted:
                with np.load(file) as part:
                    for name in part.files:
                        counts[name] = counts.get(name, 0) + part[name]
            status, failed = zarr.open_array(self.data / "status"), STATUSES.index("failed")
            followed = sum(
                int(np.count_nonzero(np.asarray(status[first : first + members]) != failed))
                for first, members in self.sizes
            )
            for name, values in map_shares(counts, followed).items():
                zarr.open_array(self.data / name, mode="r+")[...] = values
        shutil.copy(self.part / _MANIFEST, self.data / _MANIFEST)
        _to_disk(file for file in self.data.rglob("*") if file.is_file())
        old = self.part / "old.zarr"
        if self.path.exists():
            shutil.rmtree(old, ignore_errors=True)
            self.path.rename(old)
        self.data.rename(self.path)
        _to_disk([self.path])

    def _numbers(self, dataset: xr.Dataset) -> xr.Dataset:
        """Give times as numbers of one unit; what is kept along a dimension of its own."""
        kept = [
            name
            for name, variable in dataset.data_vars.items()
            if {"time", "wind_time"} & {*variable.dims} and variable.dims[0] == "member"
        ]
        if self.keep < self.members and kept:
            along = {name: dataset[name].variable for name in kept}
            dataset = dataset.drop_vars(kept).assign(
                {
                    name: ((KEPT, *variable.dims[1:]), variable.values, variable.attrs)
                    for name, variable in along.items()
                }
            )
            dataset = dataset.assign_coords({KEPT: (KEPT, dataset["member"].values)})
        day = np.datetime64(dataset.attrs["start"], "D") if "start" in dataset.attrs else None
        return times_as_numbers(dataset, day)

    def _of_members(self, numbers: xr.Dataset) -> list[str]:
        """Variables that are written chunk by chunk."""
        return [
            str(name)
            for name, variable in numbers.variables.items()
            if variable.dims and variable.dims[0] in ("member", KEPT)
        ]

    def _lay_out(self, dataset: xr.Dataset) -> None:
        """Make the arrays of all members, and all that tells of them."""
        import zarr

        numbers = self._numbers(dataset)
        names, chunk = self._of_members(numbers), self.manifest["chunk"]
        whole = dataset.attrs | ensemble_attributes(dataset.attrs["scenario"], self.members)
        # What a run without a store says: without what the file left out.
        configuration = read_configuration(whole["configuration"])
        members = configuration.ensemble.replace(members=self.members)
        whole["configuration"] = configuration.replace(ensemble=members).to_toml()
        _, coordinates = member_coordinates(0, 0, 1 if self.keep < self.members else 0)
        numbers = numbers.assign_attrs(whole)
        for name in {*coordinates} & {*numbers.coords}:
            numbers[name].attrs = coordinates[name][2]
        encoding: dict[Any, Any] = {
            name: {"chunks": (chunk, *numbers[name].shape[1:])} for name in names
        }
        for other in {*numbers.variables} - {*names}:
            encoding[other] = {"chunks": tuple(max(1, size) for size in numbers[other].shape)}
        encoding = {n: e for n, e in encoding.items() if numbers[n].ndim}
        shutil.rmtree(self.data, ignore_errors=True)
        # Version 2 of the format: a file for each chunk, which is what the checksums are of.
        numbers.to_zarr(self.data, mode="w-", zarr_format=2, consolidated=False, encoding=encoding)
        for name in names:
            array = zarr.open_array(self.data / name, mode="r+")
            rows = self.members if numbers[name].dims[0] == "member" else self.keep
            array.resize((rows, *array.shape[1:]))
        zarr.consolidate_metadata(self.data, zarr_format=2)
        (self.part / "counts").mkdir(exist_ok=True)
        _to_disk(file for file in self.data.rglob("*") if file.is_file())
        self.manifest["arrays"] = {name: numbers[name].ndim for name in names}
        self.manifest["about"] = _checksum(self._about(), self.part)

    def _files(self, number: int) -> list[Path]:
        """Files that hold a chunk, in their order; those of fill values alone may be absent."""
        files = [
            self.data / name / ".".join([str(number)] + ["0"] * (dimensions - 1))
            for name, dimensions in self.manifest["arrays"].items()
        ]
        files.append(self.part / "counts" / f"{number}.npz")
        return [file for file in files if file.exists()]

    def _about(self) -> list[Path]:
        """Files that tell of the arrays."""
        return sorted(self.data.rglob(".z*"))

    def _drop_damaged(self) -> None:
        """Forget the chunks that are not what was written: they are followed again."""
        if self.manifest["chunks"] and (
            _checksum(self._about(), self.part) != self.manifest["about"]
        ):
            raise OutputError(
                f"{self.data}: what tells of its arrays (.zarray, .zattrs, ...) is damaged; put it "
                "back from a copy, or begin anew with --overwrite"
            )
        for number, checksum in list(self.manifest["chunks"].items()):
            if _checksum(self._files(int(number)), self.part) != checksum:
                first, members = self.sizes[int(number)]
                warn(
                    f"{self.part}: chunk {number} (members {first} to {first + members - 1}) is "
                    "damaged; they are followed again"
                )
                del self.manifest["chunks"][number]

    def _save(self, manifest: dict[str, Any]) -> None:
        with _whole_file(self.part / _MANIFEST) as temporary:
            temporary.write_text(json.dumps(manifest, indent=1), encoding="utf-8")
        self.manifest = manifest


def _part(path: Path) -> Path:
    """Folder in which a store grows."""
    return path.with_name(f"{path.name}.part")


def _is_finished(path: Path) -> bool:
    """Whether a store got its name, if only just before the process that gave it was killed."""
    part, manifest = _part(path), path / _MANIFEST
    if not manifest.is_file() or (part / "data.zarr").exists():
        return False
    left = part / _MANIFEST
    return not left.exists() or left.read_bytes() == manifest.read_bytes()


def _sizes(manifest: dict[str, Any]) -> list[tuple[int, int]]:
    """First member and number of members of each chunk."""
    members, chunk = manifest["members"], manifest["chunk"]
    return [(first, min(chunk, members - first)) for first in range(0, members, chunk)]


def _chunk(plan: Any) -> int:
    """Members in a chunk where the user names no number."""
    kept = max(_LEAST // 4, _POSITIONS // len(plan.keywords["times"]))
    return int(min(max(_LEAST, plan.keywords["members"] // 100), _MOST, kept))


def _identity(job: Job, chunk: int | None) -> dict[str, Any]:
    """Give what a manifest says of a run."""
    ensemble = read_configuration(job.configuration).ensemble
    return {
        "driftcore": "forecast",
        **job._asdict(),
        "members": ensemble.members,
        "seed": ensemble.seed,
        "chunk": None if chunk is None else checked_count("chunk", chunk),
    }


def _require_same(path: Path, manifest: dict[str, Any], identity: dict[str, Any]) -> None:
    """Refuse to go on with another run than the one that was begun.

    Raises
    ------
    OutputError
        It says what differs, and both values.
    """

    def told(known: dict[str, Any]) -> dict[str, Any]:
        values = _flat(tomllib.loads(known["configuration"]))
        values |= {f"SHA-256 of {path}": checksum for path, checksum in known["inputs"]}
        return {"version": known["version"], **values, "chunk": known["chunk"]}

    then, now = told(manifest), told(identity)
    now["chunk"] = now["chunk"] or then["chunk"]
    for name in {**then, **now}:
        if then.get(name) != now.get(name):
            raise OutputError(
                f"{path}: {name} is {now.get(name, 'absent')!r}, and was "
                f"{then.get(name, 'absent')!r} when the run began; run it as it began, or begin "
                "anew with --overwrite"
            )


def _flat(table: dict[str, Any], before: str = "") -> dict[str, Any]:
    """Values of tables in tables by their dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= (
            _flat(value, f"{before}{key}.") if isinstance(value, dict) else {before + key: value}
        )
    return flat


def _read(file: Path) -> dict[str, Any]:
    """Read a manifest."""
    try:
        manifest = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(manifest, dict) or manifest.get("driftcore") != "forecast":
            raise ValueError("it is none")
        manifest["chunks"].items(), _sizes(manifest), manifest["keep"], manifest["configuration"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise OutputError(
            f"{file}: cannot be read as the manifest of a run: {error!r}; put it back from a copy, "
            "or begin anew with --overwrite"
        ) from None
    return manifest


def _check_free(path: Path, overwrite: bool) -> None:
    """Refuse, before any work, a store that cannot be written."""
    if path.is_dir():
        if not overwrite:
            raise OutputError(
                f"{path}: exists; choose another name or ask to overwrite (--overwrite)"
            )
        if not (path / _MANIFEST).is_file():
            raise OutputError(
                f"{path}: is a folder, but no store of driftcore; choose another name"
            )
    else:
        check_writable(path, overwrite=False)


@contextmanager
def _locked(part: Path) -> Iterator[None]:
    """Hold the lock of a growing store: it ends with the process, however that ends."""
    from filelock import FileLock, Timeout

    try:
        part.mkdir(exist_ok=True)
        lock = FileLock(part / "lock")
        lock.acquire(timeout=0)
    except Timeout:
        raise OutputError(f"{part}: another process is writing it") from None
    except OSError as error:
        raise OutputError(f"{part}: cannot be written: {error}") from None
    try:
        yield
    finally:
        lock.release()


def _clear(folder: Path, but: tuple[str, ...]) -> None:
    """Remove what an earlier run left."""
    for entry in folder.iterdir():
        if entry.name in but:
            continue
        if entry.name not in (_MANIFEST, "data.zarr", "counts", "old.zarr") and not (
            entry.name.startswith(".")
        ):
            raise OutputError(f"{entry}: is not of a driftcore run; move it away")
        shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


@contextmanager
def _whole_file(file: Path) -> Iterator[Path]:
    """Give a temporary name beside a file that replaces it once it has reached the disk."""
    temporary = file.with_name(f".{file.name}{file.suffix}")
    yield temporary
    _to_disk([temporary])
    temporary.replace(file)
    _to_disk([file])


def _to_disk(files: Iterable[Path]) -> None:
    """Wait until files, and the folders that name them, have reached the disk."""
    files = list(files)
    for path in [*files, *{file.parent for file in files}]:
        handle = os.open(path, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _installed(module: str) -> bool:
    from importlib.util import find_spec

    return find_spec(module) is not None


def need_store() -> None:
    """Refuse to go on where the libraries of stores are not installed.

    Raises
    ------
    DriftCoreError
        They are not; the message says what brings them.
    """
    for module in ("zarr", "filelock"):
        if not _installed(module):
            raise DriftCoreError(
                f'a store needs {module}, which is not installed: pip install "driftcore[store]"'
            )
