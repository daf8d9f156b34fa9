"""The one rule for large arrays: what does not fit into memory is refused before it is made."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from driftcore.errors import ScenarioError

# What a control group (a container) may use and uses, in the second version and the first.
_GROUPS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    (
        "/sys/fs/cgroup/memory/memory.limit_in_bytes",
        "/sys/fs/cgroup/memory/memory.usage_in_bytes",
    ),
)


def available() -> float:
    """Give the bytes that this process may still take; infinite where the system does not tell."""
    least = math.inf
    with contextlib.suppress(OSError, ValueError, AttributeError):
        least = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with contextlib.suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        free = next(line for line in lines if line.startswith("MemAvailable:"))
        least = 1024.0 * int(free.split()[1])
    for files in _GROUPS:
        with contextlib.suppress(OSError, ValueError):  # "max" where there is no limit
            limit, used = (int(Path(file).read_text(encoding="ascii")) for file in files)
            least = min(least, float(limit - used))
    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        most = resource.getrlimit(resource.RLIMIT_AS)[0]
        if most != resource.RLIM_INFINITY:
            pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
            least = min(least, float(most - pages * resource.getpagesize()))
    return max(0.0, least)


def require_room_for(field: str, values: Any) -> None:
    """Refuse an argument whose arrays would not fit, however small it is itself, like a range.

    Raises
    ------
    ScenarioError
        As `require_room`: for a few arrays of numbers, as many as there are values.
    """
    sized = isinstance(values, Sequence) and not isinstance(values, str)
    count = getattr(values, "size", len(values) if sized else 1)
    require_room(field, count, 4 * 8, "values")


def require_room(field: str, count: float, each: float, what: str) -> None:
    """Refuse what does not fit into memory.

    Parameters
    ----------
    field : str
        Argument that asks for it.
    count, each : float
        Number of things, and bytes of each.
    what : str
        What they are, in the plural.

    Raises
    ------
    ScenarioError
        They take more than is available; the message has both.
    """
    wanted = float(count) * each
    # A look at the system takes longer than to make what is small.
    if wanted > 2**24 and wanted > (free := available()):
        raise ScenarioError(
            f"{field}: {count:.6g} {what} are not accepted; they take {wanted / 1e9:.3g} GB, "
            f"{free / 1e9:.3g} GB are available"
        )
