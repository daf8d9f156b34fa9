"""Files written whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from driftcore.errors import OutputError


def check_writable(path: Path, overwrite: bool) -> None:
    """Fail before any long work if `path` cannot be written.

    Raises
    ------
    OutputError
        It exists and may not be overwritten or is no plain file, or its folder is missing or
        read-only.
    """
    folder = path.parent
    try:
        if path.is_dir():
            raise OutputError(f"{path}: is a folder; name a file")
        if path.exists() and not path.is_file():
            raise OutputError(f"{path}: is a device or a pipe; name a file")
        if path.exists() and not overwrite:
            raise OutputError(
                f"{path}: exists; choose another name or ask to overwrite (--overwrite)"
            )
        if not folder.is_dir():
            raise OutputError(f"{path}: folder {folder} does not exist")
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from None


@contextmanager
def replacing(path: Path, overwrite: bool) -> Iterator[Path]:
    """Give a temporary name beside `path` that is renamed to it when the block succeeds.

    Raises
    ------
    OutputError
        As `check_writable`, or the block raises an OSError; nothing is left behind then.
    """
    check_writable(path, overwrite)
    # The suffix stays last: libraries tell the format by it.
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error}") from None
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def filling(folder: Path, overwrite: bool, expected: str | None = None) -> Iterator[Path]:
    """Give a temporary folder whose files and subfolders move into `folder` if the block succeeds.

    Parameters
    ----------
    folder : Path
        Made if absent, with its parents, but not before there is something to move.
    overwrite : bool
        Replace files that are there.
    expected : str, optional
        Name of a file to come, so that one already there is met before the block's work.

    Raises
    ------
    OutputError
        The folder cannot be made or written, or a file is there and may not be replaced; nothing
        is left behind then.
    """
    try:
        nearest = next(path for path in (folder, *folder.parents) if path.exists())
        if expected is not None and nearest == folder:
            check_writable(folder / expected, overwrite)
        temporary = Path(tempfile.mkdtemp(dir=nearest, prefix=".driftcore-"))
    except OutputError:
        raise
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None
    try:
        yield temporary
        files = sorted(file for file in temporary.rglob("*") if file.is_file())
        targets = [folder / file.relative_to(temporary) for file in files]
        for parent in {folder, *(target.parent for target in targets)}:
            try:
                parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(f"{parent}: cannot be made: {error.strerror}") from None
        for target in targets:
            check_writable(target, overwrite)
        for file, target in zip(files, targets, strict=True):
            file.replace(target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
