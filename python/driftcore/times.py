"""UTC times in nanoseconds, as datasets hold them."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from driftcore.errors import DriftCoreError, ScenarioError

Times: TypeAlias = NDArray[np.datetime64]

# The whole years that 64 bits of nanoseconds hold; beyond, NumPy wraps them around in silence.
_YEARS = (1678, 2261)


def nanoseconds(name: str, times: Any, error: type[DriftCoreError] = ScenarioError) -> Times:
    """Give times, or a time, in nanoseconds.

    Parameters
    ----------
    name : str
        What they are called in an error.
    times : array_like of datetime64
        UTC, none missing.
    error : type
        What is raised.

    Raises
    ------
    ScenarioError, or `error`
        A time is not from the years 1678 to 2261.
    """
    values = np.asarray(times)
    years = values.astype("datetime64[Y]").astype(np.int64) + 1970
    beyond = (years < _YEARS[0]) | (years > _YEARS[1])
    if beyond.any():
        bad = np.datetime_as_string(values[beyond].flat[0], unit="D")
        first, last = _YEARS
        raise error(f"{name}: {bad} is not accepted; it must be of the years {first} to {last}")
    return values.astype("datetime64[ns]")
