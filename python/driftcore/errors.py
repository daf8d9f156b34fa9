"""Exceptions and warnings of driftcore; their messages name the field, the value and what fits."""

import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PACKAGE = str(Path(__file__).parent)


class DriftCoreError(Exception):
    """Root of every error that driftcore raises on purpose."""


class ScenarioError(DriftCoreError, ValueError):
    """A configuration or an argument is not one that driftcore accepts."""


class RecordError(DriftCoreError, ValueError):
    """A record of wind or current cannot be read, or is not fit for what is asked of it."""


class OutputError(DriftCoreError, OSError):
    """A result cannot be written or read back."""


class DriftCoreWarning(UserWarning):
    """Something suspicious that does not stop the work."""


@contextmanager
def told_by_the_core() -> Iterator[None]:
    """Raise what the core refuses, or cannot work out, as an error of driftcore.

    Raises
    ------
    ScenarioError
        The core refuses an argument.
    DriftCoreError
        The core cannot follow what was asked for.
    """
    try:
        yield
    except ValueError as error:
        raise ScenarioError(str(error)) from None
    except RuntimeError as error:
        raise DriftCoreError(str(error)) from None


def warn(message: str, category: type[Warning] = DriftCoreWarning) -> None:
    """Warn whoever called the package, however deep within it the doubt arose."""
    level, frame = 2, sys._getframe(1)
    # "<string>" is where dataclasses keep their constructors.
    while frame.f_back and frame.f_code.co_filename.startswith((_PACKAGE, "<string>")):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


@contextmanager
def reading(what: str, kind: str = "") -> Iterator[None]:
    """Make one `RecordError` of whatever the libraries beneath answer to damaged data.

    Raises
    ------
    RecordError
        Anything but an error of driftcore was raised, which stays its cause.
    """
    try:
        yield
    except DriftCoreError:
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise RecordError(f"{what} cannot be read{kind}: {reason}") from error


def need_geo(*modules: str) -> None:
    """Refuse to go on where a library of the real sea is not installed.

    Raises
    ------
    DriftCoreError
        It is not; the message says what brings it.
    """
    from importlib.util import find_spec

    for module in modules:
        if find_spec(module) is None:
            raise DriftCoreError(
                f'the real sea needs {module}, which is not installed: pip install "driftcore[geo]"'
            )
