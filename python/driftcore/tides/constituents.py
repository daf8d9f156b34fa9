"""Tidal constituents: their names, frequencies, arguments and nodal corrections, by pyTMD."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore.errors import DriftCoreError, ScenarioError
from driftcore.record import listed

if TYPE_CHECKING:
    from types import ModuleType

Float: TypeAlias = NDArray[np.float64]
Complex: TypeAlias = NDArray[np.complex128]
Times: TypeAlias = NDArray[np.datetime64]

_NODAL = "FES"
_OTHER_NAMES = {
    "E2": "EPS2",
    "LA2": "LAMBDA2",
    "LAM2": "LAMBDA2",
    "LDA2": "LAMBDA2",
    "RO1": "RHO1",
    "SIG1": "SIGMA1",
    "THE1": "THETA1",
}
# What `fit` tries, the more important first. S1 is left out: more weather than tide, and authors
# differ about its argument.
RANKED = (
    *("M2", "S2", "N2", "K1", "O1", "K2", "P1", "Q1", "M4", "MS4", "NU2", "MN4"),
    *("MU2", "2N2", "L2", "T2", "M6", "2MS6", "J1", "M3", "MK3", "OO1", "LAMBDA2"),
)


def pytmd() -> ModuleType:
    """Give the astronomy of pyTMD, or say what to install."""
    try:
        # Its import turns off every UserWarning of the process, ours too.
        with warnings.catch_warnings():
            from pyTMD import constituents
    except ImportError as error:
        raise DriftCoreError(
            f'tides need {error.name}, which is not installed: pip install "driftcore[geo]"'
        ) from error
    return constituents  # type: ignore[no-any-return]


def standard_name(name: object) -> str:
    """Bring the spellings of a constituent to one, such as "M2"."""
    text = name.decode() if isinstance(name, bytes) else str(name)
    text = text.strip("\x00 \t").upper()
    return _OTHER_NAMES.get(text, text)


@lru_cache(maxsize=1024)  # pyTMD reads its table from a file at each call
def _species(name: str) -> int | None:
    """First Doodson number of a standard name; None if pyTMD does not know it."""
    try:
        return int(pytmd().coefficients_table([name.lower()], corrections=_NODAL)[0][0])
    except ValueError:
        return None


def is_known(name: str) -> bool:
    """Tell whether pyTMD knows a standard name."""
    return _species(name) is not None


def _ids(names: Iterable[str]) -> list[str]:
    return [name.lower() for name in names]


def species_of(names: Sequence[str]) -> NDArray[np.int64]:
    """Cycles per lunar day, the first Doodson number: 0 for long periods."""
    return np.array([_species(name) for name in names], dtype=np.int64)


def frequency_of(names: Sequence[str]) -> Float:
    """Angular frequency [rad/s]."""
    return np.asarray(pytmd().frequency(_ids(names), corrections=_NODAL), dtype=float)


def arguments(names: Sequence[str], times: Times) -> tuple[Complex, Complex]:
    """Nodal factors `f e^{iu}` and equilibrium arguments `e^{iV}`, each (time, constituent)."""
    days = (times - np.datetime64("1858-11-17")) / np.timedelta64(1, "D")
    angle, factor, argument = pytmd().arguments(days, _ids(names), corrections=_NODAL)
    return factor * np.exp(1j * angle), np.exp(1j * np.radians(argument))


def checked_times(name: str, times: ArrayLike) -> Times:
    """Refuse what is not a time, or missing."""
    values = np.asarray(times)
    if values.dtype.kind != "M" or np.isnat(values).any():
        raise ScenarioError(
            f"{name}: {np.atleast_1d(values).ravel()[:1]} is not accepted; give datetime64, UTC"
        )
    return values


def refuse_unknown(names: Iterable[str]) -> None:
    """Refuse the first standard name that pyTMD does not know."""
    for name in names:
        if not is_known(name):
            raise ScenarioError(
                f"constituents: {name!r} is not known; use names such as {listed(RANKED[:5])}"
            )


def checked_constituents(names: Iterable[object]) -> list[str]:
    """Give the standard names of the constituents, none twice, unknown or of long period."""
    found = [standard_name(name) for name in names]
    if not found:
        raise ScenarioError("constituents: none is given; name at least one, such as 'M2'")
    for name in found:
        if found.count(name) > 1:
            raise ScenarioError(f"constituents: {name!r} occurs twice; give each once")
    refuse_unknown(found)
    for name, species in zip(found, species_of(found), strict=True):
        if species == 0:
            raise ScenarioError(
                f"constituents: {name!r} has a long period; it is slow enough to be part of the "
                "residual current, leave it out here"
            )
    return found
