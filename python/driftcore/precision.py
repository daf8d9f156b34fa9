"""As many members as it takes: an ensemble that grows until its interval is narrow enough."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from driftcore.dataset import combined
from driftcore.errors import ScenarioError, warn
from driftcore.statistics import Probability, members_needed

if TYPE_CHECKING:
    import xarray as xr

    from driftcore.members import Progress
    from driftcore.results import Forecast

_P = ParamSpec("_P")
_F = TypeVar("_F", bound="Forecast")

# Members of the first look at a probability, and the growth from one look to the next at least.
FIRST_LOOK, _LEAST_GROWTH = 1000, 1.05
# Half-width sought where none is named.
PRECISION = 0.01


def until_precise(follow: Callable[_P, _F]) -> Callable[_P, _F]:
    """Let a forecast be asked for members = "auto": in parts until its interval is narrow enough.

    The number of members is decided a few times, each time from all that is known: where the
    interval is too wide still, as many follow as (51) tells from its centre. Looking so seldom
    leaves the coverage of the interval as it is (docs/trust.md).
    """

    @wraps(follow)
    def found(*args: _P.args, **kwargs: _P.kwargs) -> _F:
        options: dict[str, Any] = dict(kwargs)
        if options.get("members") != "auto":
            if options.get("precision") is not None:
                raise ScenarioError(
                    f"precision: {options['precision']!r} is not accepted with members = "
                    f'{options.get("members")!r}; with members = "auto" it is'
                )
            return follow(*args, **kwargs)
        if options.get("first_member"):
            raise ScenarioError('first_member: with members = "auto" only 0 is accepted')
        precision = options["precision"] = options.get("precision") or PRECISION
        if not (isinstance(precision, float) and 1e-4 <= precision < 0.5):
            raise ScenarioError(
                f"precision: {precision!r} is not accepted; a number from 0.0001 to 0.5 is"
            )
        progress: Progress | None = options.get("progress")
        parts: list[xr.Dataset] = []
        told: dict[str, warnings.WarningMessage] = {}
        members, wanted = 0, FIRST_LOOK
        while True:

            def report(done: int, _: int, before: int = members, planned: int = wanted) -> None:
                if progress is not None:
                    progress(before + done, planned)

            options |= {"first_member": members, "members": wanted - members, "progress": report}
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                part = follow(*args, **options)
            told |= {str(warning.message): warning for warning in caught}
            parts.append(part.dataset)
            whole = type(part)(combined(parts))
            members, wanted = (
                wanted,
                next_look(whole.stranding_probability(), wanted, precision),
            )
            if wanted == members:
                break
        for warning in told.values():
            warn(str(warning.message), warning.category)
        return whole

    return found


def next_look(found: Probability, members: int, precision: float) -> int:
    """Give the number of members to look at next: equations.md (51); no more if precise enough."""
    if found.half_width <= precision:
        return members
    # Members that fail do not count.
    needed = members_needed((found.low + found.high) / 2, precision) * members / found.members
    return math.ceil(max(needed, _LEAST_GROWTH * members))
