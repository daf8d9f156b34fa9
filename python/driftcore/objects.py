"""What drifts: floating bodies, and search objects by their leeway."""

from __future__ import annotations

import difflib
import math
from abc import abstractmethod
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, FiniteFloat, NonNegativeFloat, field_validator, model_validator

from driftcore.configuration import Configuration
from driftcore.draws import Stream, member_uniforms
from driftcore.errors import ScenarioError, need_geo

if TYPE_CHECKING:
    import pandas as pd

Float = NDArray[np.float64]

# From cm/s and % of the wind to SI.
_PERCENT = 0.01
_SECONDS_PER_HOUR = 3600.0
_LINES = ("downwind", "right", "left")


def _normal_between(uniforms: Float, low: float, high: float) -> Float:
    """Quantiles of the standard normal law, cut to [low, high]."""
    need_geo("scipy")
    from scipy.special import ndtr, ndtri

    if low > 0:
        # The lower tail of the law is resolved, the upper is not: 1 - 1e-20 is 1.
        return -_normal_between(1 - uniforms, -high, -low)
    below, upto = ndtr(low), ndtr(high)
    return np.asarray(ndtri(below + uniforms * (upto - below)), dtype=np.float64)


class Distribution(Configuration):
    """Law of a number that differs from member to member.

    "uniform" between `low` and `high`; "normal" with mean `center` and standard deviation
    `spread`; "lognormal" with median `center` and standard deviation `spread` of the logarithm.
    Bounds cut the last two: what is outside is not set onto the bound, it does not occur.
    """

    kind: Literal["uniform", "normal", "lognormal"] = Field(
        description='"uniform", "normal" or "lognormal"'
    )
    center: FiniteFloat | None = Field(
        default=None, description='mean of "normal", median of "lognormal"'
    )
    spread: Annotated[float, Field(gt=0)] | None = Field(
        default=None,
        description='standard deviation, of "lognormal" that of the logarithm',
    )
    low: FiniteFloat | None = Field(default=None, description="no value is below")
    high: FiniteFloat | None = Field(default=None, description="no value is above")

    @model_validator(mode="after")
    def _is_a_law(self) -> Distribution:
        uniform = self.kind == "uniform"
        for name in ("low", "high") if uniform else ("center", "spread"):
            if getattr(self, name) is None:
                raise ValueError(f'{name}: is missing; "{self.kind}" needs it')
        for name in ("center", "spread") if uniform else ():
            if getattr(self, name) is not None:
                raise ValueError(f'{name}: is not accepted; "uniform" has low and high alone')
        if self.kind == "lognormal" and self.center is not None and self.center <= 0:
            raise ValueError(f"center: {self.center} is not accepted; a median is above 0")
        low, high = self.support
        if not low < high:
            raise ValueError(f"high: {self.high} is not accepted; it should be above low = {low}")
        if not uniform and np.ptp(self.quantile(np.array([0.01, 0.99]))) == 0:
            raise ValueError(
                f"low, high: [{low}, {high}] is not accepted; the law has nothing there"
            )
        return self

    @property
    def support(self) -> tuple[float, float]:
        """Bounds of the values."""
        least = 0.0 if self.kind == "lognormal" else -math.inf
        low = least if self.low is None else max(self.low, least)
        return low, math.inf if self.high is None else self.high

    def quantile(self, uniforms: Float) -> Float:
        """Give the values below which the shares `uniforms` of the law lie; same shape."""
        low, high = self.support
        if self.center is None or self.spread is None:
            values = low + uniforms * (high - low)
        elif self.kind == "normal":
            least, most = ((bound - self.center) / self.spread for bound in (low, high))
            values = self.center + self.spread * _normal_between(uniforms, least, most)
        else:
            with np.errstate(divide="ignore"):
                least, most = np.log(np.array([low, high]) / self.center) / self.spread
            values = self.center * np.exp(self.spread * _normal_between(uniforms, least, most))
        return np.asarray(np.clip(values, low, high), dtype=np.float64)


def _known_or_law(value: Any, low: float, high: float) -> float | Distribution:
    """Take a number, or a law whose values all lie in [low, high]."""
    accepted = f"within [{low:g}, {high:g}]"
    if isinstance(value, dict):
        value = Distribution(**value)
    if isinstance(value, Distribution):
        if value.support[0] < low or value.support[1] > high:
            raise ValueError(
                f"a law of values in [{value.support[0]:g}, {value.support[1]:g}] is not "
                f"accepted; its low and high should be {accepted}"
            )
        return value
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not number or not low <= value <= high:
        raise ValueError(
            f"{value!r} is not accepted; it should be a number {accepted}, or a distribution"
        )
    return float(value)


class Drifter(Configuration):
    """Base of what drifts: properties that may differ from member to member."""

    draws: ClassVar[int]

    @abstractmethod
    def sample(self, uniforms: Float) -> Float:
        """Give the properties of members from their uniform numbers, shape (n, `draws`)."""

    def members(self, seed: int, first: int, count: int) -> Float:
        """Give the properties of the members `first` … `first + count - 1`: see `sample`."""
        return self.sample(self.uniforms(seed, first, count))

    def uniforms(self, seed: int, first: int, count: int) -> Float:
        """Draw what `sample` makes properties of, shape (count, `draws`)."""
        return member_uniforms(seed, first, count, self.draws, Stream.DRIFTER)


class FloatingBody(Drifter):
    """A body that answers wind and sea with delay: X' = m + U, U' = (α(W - m) - U)/τ.

    The body of the paper is α = 1, τ = 1/Λ; τ = 0 follows α of the wind at once.
    """

    draws: ClassVar[int] = 2

    kind: Literal["floating-body"] = "floating-body"
    response_time_h: float | Distribution = Field(
        description="response time τ [h], or its distribution"
    )
    wind_factor: float | Distribution = Field(
        default=1.0, description="wind factor α, or its distribution; 1 in the paper"
    )

    @field_validator("response_time_h", mode="before")
    @classmethod
    def _a_century_at_most(cls, value: Any) -> float | Distribution:
        return _known_or_law(value, 0.0, 876_600.0)

    @field_validator("wind_factor", mode="before")
    @classmethod
    def _a_share(cls, value: Any) -> float | Distribution:
        return _known_or_law(value, 0.0, 1.0)

    def sample(self, uniforms: Float) -> Float:
        """Give response times [s] and wind factors of members.

        Parameters
        ----------
        uniforms : ndarray, shape (n, 2)
            Inside (0, 1).

        Returns
        -------
        ndarray, shape (n, 2)
            Response time τ [s], wind factor α.
        """
        columns = [
            value.quantile(column)
            if isinstance(value, Distribution)
            else np.full(len(column), value)
            for value, column in zip(
                (self.response_time_h, self.wind_factor), uniforms.T, strict=True
            )
        ]
        return np.column_stack(columns) * [_SECONDS_PER_HOUR, 1.0]


class LeewayLine(Configuration):
    """One component of leeway against wind speed, in the units of the published tables."""

    slope_percent: FiniteFloat = Field(description="slope [% of the wind speed]")
    offset_cm_s: FiniteFloat = Field(default=0.0, description="offset [cm/s]")
    sd_cm_s: NonNegativeFloat = Field(
        default=0.0, description="standard deviation about the line [cm/s]"
    )

    def perturbed(self, epsilon: Float) -> tuple[Float, Float]:
        """Slope [1] and offset [m/s] of members that lie `epsilon` [cm/s] off in a 10 m/s wind.

        a + ε/20 and b + ε/2: Breivik & Allen 2008, J. Marine Syst. 69, 99-113. Half of ε lies in
        the slope and half in the offset, so that the scatter grows with the wind as observed.
        """
        slope = (self.slope_percent + epsilon / 20) * _PERCENT
        return slope, (self.offset_cm_s + epsilon / 2) * _PERCENT


class Leeway(Drifter):
    """A search object by its leeway, the drift relative to the water: Allen & Plourde 1999.

    Downwind and crosswind leeway are lines of the wind speed at 10 m; a member drifts to the right
    or to the left of downwind, and changes side ("jibes") now and then. A category of the table
    brings its own lines; a craft that was measured brings all three and a name of its own.
    """

    draws: ClassVar[int] = 3

    kind: Literal["leeway"] = "leeway"
    category: str = Field(description="key of the table of categories, or a name of your own")
    downwind: LeewayLine = Field(description="downwind leeway")
    right: LeewayLine = Field(description="crosswind leeway on the right, positive to the right")
    left: LeewayLine = Field(description="crosswind leeway on the left, positive to the right")
    # Allen 2005 (CG-D-05-05) found that craft seldom jibe in a steady wind of middle strength and
    # often in calms, gales and shifts of it; open leeway models put the constant 4 % per hour.
    jibing_per_hour: Annotated[float, Field(ge=0, le=60)] = Field(
        default=0.04, description="rate of changes of side [1/h]"
    )

    @model_validator(mode="before")
    @classmethod
    def _lines_of_the_table(cls, values: Any) -> Any:
        if (
            not isinstance(values, dict)
            or not isinstance(values.get("category"), str)
            or any(line in values for line in _LINES)
        ):
            return values
        return {**values, **_row(values["category"])}

    @field_validator("downwind", "right", "left", mode="before")
    @classmethod
    def _line_from_table(cls, value: Any) -> Any:
        return LeewayLine(**value) if isinstance(value, dict) else value

    def sample(self, uniforms: Float, *, jibed: bool = False) -> Float:
        """Give the leeway coefficients of members.

        Parameters
        ----------
        uniforms : ndarray, shape (n, 3)
            Inside (0, 1): side, downwind scatter, crosswind scatter.
        jibed : bool
            Give each member the coefficients of its other side. Its scatter is mirrored: who
            diverges more than others does so on both sides.

        Returns
        -------
        ndarray, shape (n, 4)
            Downwind slope [1] and offset [m/s], crosswind slope [1] and offset [m/s]; crosswind is
            positive to the right of downwind. Half of the members start on the right. The downwind
            slope is never below 0: scatter that would make it so is not drawn.
        """
        line = self.downwind
        least = -math.inf if line.sd_cm_s == 0 else -20 * line.slope_percent / line.sd_cm_s
        slope, offset = line.perturbed(
            line.sd_cm_s * _normal_between(uniforms[:, 1], least, math.inf)
        )
        scatter = _normal_between(uniforms[:, 2], -math.inf, math.inf)
        right = self.right.perturbed(self.right.sd_cm_s * scatter)
        left = self.left.perturbed(-self.left.sd_cm_s * scatter)
        on_the_right = (uniforms[:, 0] < 0.5) != jibed
        crosswind = [np.where(on_the_right, *sides) for sides in zip(right, left, strict=True)]
        # At the bound the difference may round to -1e-18.
        return np.column_stack([np.maximum(slope, 0), offset, *crosswind])


def leeway(name: str, jibing_per_hour: float = 0.04) -> Leeway:
    """Give a search object of the table of categories.

    Parameters
    ----------
    name : str
        A key of `categories`, in capitals or not.
    jibing_per_hour : float
        Rate of changes of side [1/h].

    Raises
    ------
    ScenarioError
        There is no such category; the message names the nearest.
    """
    return Leeway(**_row(name), jibing_per_hour=jibing_per_hour)


def categories() -> pd.DataFrame:
    """Give the leeway categories of the US Coast Guard.

    Returns
    -------
    pandas.DataFrame
        Index `key`; columns `level` (0 is general), `parent` (key of the more general category,
        or missing), `description`, and of `downwind`, `right`, `left` each `_slope_percent`
        [% of the wind at 10 m], `_offset_cm_s` and `_sd_cm_s` [cm/s].
    """
    return _table().copy()


@cache
def _table() -> pd.DataFrame:
    import pandas as pd

    file = resources.files("driftcore") / "data" / "leeway_categories.csv"
    with file.open(encoding="utf-8") as stream:
        table = pd.read_csv(stream, comment="#", index_col="key")
    above: list[str] = []
    parents = []
    for key, level in table["level"].items():
        del above[level:]
        parents.append(above[-1] if above else None)
        above.append(str(key))
    table.insert(1, "parent", pd.Series(parents, index=table.index, dtype=object))
    return table


def _row(name: str) -> dict[str, Any]:
    """Category and lines of a row of the table."""
    table = _table()
    keys = {str(key).casefold(): str(key) for key in table.index}
    wanted = str(name).casefold()
    if wanted in keys:
        row = table.loc[keys[wanted]].to_dict()
        lines = {
            line: LeewayLine(**{part: row[f"{line}_{part}"] for part in LeewayLine.model_fields})
            for line in _LINES
        }
        return {"category": keys[wanted], **lines}
    described = table["description"].to_dict()
    near = [key for key, words in described.items() if wanted in words.casefold()]
    near += [keys[key] for key in difflib.get_close_matches(wanted, keys, n=3)]
    hint = "driftcore.objects.categories() lists them"
    if near:
        shown = (f"{key} ({described[key]})" for key in list(dict.fromkeys(near))[:5])
        hint = f"did you mean {' or '.join(shown)}"
    raise ScenarioError(f"category: {name!r} is not accepted; {hint}")
