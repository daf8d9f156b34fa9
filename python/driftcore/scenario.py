"""What is forecast: the body, its release, the sea and the coast; and how: wind and ensemble."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Integral
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PositiveFloat, field_validator, model_validator

from driftcore.configuration import NOTHING, Configuration
from driftcore.errors import ScenarioError
from driftcore.maps import MapGrid
from driftcore.sea import AcademicSea, HarmonicSea, Pair

ModelName = Literal["full", "paper", "mean-flow"]
Side = Literal["inside", "outside"]

# A century, of semidiurnal tides or of days.
_LONGEST_TIDES = 70_000
_LONGEST_DAYS = 36_525
_MOST_MEMBERS = 10**8
# The models step explicitly: their steps are no longer than some times of a body's response.
_STIFFEST = 1e6
# 16 GB of them.
MOST_POSITIONS = 10**9


def check_order(model: str, order: int | None) -> int | None:
    """Give the order of a model's expansion, its default where none is named.

    Raises
    ------
    ValueError
        The model does not exist, or not in this order.
    """
    orders = {"full": (None,), "paper": (1, 0), "mean-flow": (1, 2)}
    if model not in orders:
        raise ValueError(f"model: {model!r} is not accepted; one of {', '.join(orders)}")
    if order is None:
        return orders[model][0]
    if isinstance(order, bool | float) or order not in orders[model]:
        known = " or ".join(str(o) for o in sorted(o for o in orders[model] if o is not None))
        accepted = f"orders {known} exist" if known else "it is exact and has no order"
        raise ValueError(f"order: {order} is not accepted for model {model!r}; {accepted}")
    return order


class Circle(Configuration):
    """A circular coast line, paper section 5."""

    kind: Literal["circle"] = "circle"
    center: Pair = Field(default=(1.0, 1.0), description="centre of the circle")
    radius: PositiveFloat = Field(default=0.3, description="radius of the circle")


class Polygons(Configuration):
    """Coast lines from closed rings of points; a ring inside another is an island or a lake."""

    kind: Literal["polygons"] = "polygons"
    rings: Annotated[
        tuple[Annotated[tuple[Pair, ...], Field(min_length=3)], ...], Field(min_length=1)
    ] = Field(description="each ring a list of [x, y]; it closes itself")


class Scenario(Configuration):
    """A body adrift: equations.md (1), in units where one run is one unit of time.

    `epsilon` is the tide period over the run; a velocity of 1 is `wind_unit`; a time of 1 is
    `tide_period_h / epsilon` hours.
    """

    name: str = Field(default="paper", description="a name for people")
    epsilon: Annotated[float, Field(gt=0, le=0.5)] = Field(
        default=1 / 50, description="tide period, in units of the run"
    )
    duration: PositiveFloat = Field(default=1.0, description="length of the run; 1 in the paper")
    drag: Annotated[float, Field(gt=0, le=1e6)] = Field(
        default=1.0, description="drag rate Λ, per unit of time"
    )
    position: Pair = Field(default=(1.0, 1.0), description="position at the release")
    velocity: Pair = Field(default=(0.0, 0.0), description="velocity at the release")
    wind_unit: PositiveFloat = Field(default=3.0, description="the unit of velocity [m/s]")
    tide_period_h: PositiveFloat = Field(default=12.5, description="tide period [h]")
    side: Side = Field(
        default="inside",
        description='"inside": strands on leaving the coast line; "outside": on entering',
    )
    sea: Annotated[AcademicSea | HarmonicSea, Field(description="m = M + epsilon N")] = (
        AcademicSea()
    )
    coast: Circle | Polygons | None = Field(
        default=Circle(),
        discriminator="kind",
        description=f'where the body may strand; coast = "{NOTHING}": nowhere',
    )

    @field_validator("sea", mode="before")
    @classmethod
    def _sea_from_table(cls, value: Any) -> Any:
        if isinstance(value, dict):
            return AcademicSea(**value)
        if not isinstance(value, AcademicSea | HarmonicSea):
            raise ValueError(
                f"{value!r} is not accepted; it should be a table, or a sea given in Python"
            )
        return value

    @field_validator("coast", mode="before")
    @classmethod
    def _coast_from_table(cls, value: Any) -> Any:
        if isinstance(value, dict):
            return {"kind": "circle", **value}
        return None if value == NOTHING else value

    @model_validator(mode="after")
    def _run_is_finite(self) -> Scenario:
        """Refuse what no computer follows: most likely a unit or a power of ten is wrong."""
        if self.drag * self.duration > _STIFFEST:
            raise ValueError(
                f"drag: {self.drag} is not accepted; with duration = {self.duration} a body would "
                f"answer the wind within {1 / (self.drag * self.duration):.3g} of the run; at most "
                f"{_STIFFEST:g} over the duration"
            )
        tides = self.duration / self.epsilon
        if tides > _LONGEST_TIDES or self.duration_days > _LONGEST_DAYS:
            raise ValueError(
                f"epsilon: {self.epsilon} is not accepted; with duration = {self.duration} and "
                f"tide_period_h = {self.tide_period_h} the run would last {tides:.3g} tides, "
                f"{self.duration_days:.3g} days; at most {_LONGEST_TIDES} and {_LONGEST_DAYS}"
            )
        return self

    def _repr_html_(self) -> str:
        from driftcore.html import scenario_table

        return scenario_table(self)

    @property
    def period(self) -> float:
        """Tide period [scenario time]."""
        return self.epsilon

    @property
    def hours_per_unit(self) -> float:
        """Hours in one unit of scenario time."""
        return self.tide_period_h / self.epsilon

    @property
    def duration_days(self) -> float:
        """Length of the run [d]."""
        return self.duration * self.hours_per_unit / 24


class WindConfiguration(Configuration):
    """Where the wind comes from and how it is resampled: docs/equations.md (18)–(24)."""

    record: str = Field(
        default="embedded",
        description='CSV file of u10, v10 [m/s]; "embedded": a synthetic climate',
    )
    months: Annotated[tuple[Annotated[int, Field(ge=1, le=12)], ...], Field(min_length=1)] = Field(
        default=(6, 7, 8), description="calendar months resampled"
    )
    gaps: Literal["error", "segment"] = Field(
        default="error", description='what a gap in the record is: an "error", or a new "segment"'
    )
    mode: Literal["residual", "lgb"] = Field(
        default="residual", description='"residual", or "lgb" as in the paper'
    )
    order: Annotated[int, Field(ge=1, le=8)] = Field(default=2, description="Markov order")
    h: PositiveFloat | None = Field(
        default=None, description="bandwidth; chosen by likelihood if absent"
    )
    b: Annotated[float, Field(ge=0)] | None = Field(
        default=None, description='noise of mode "lgb"; chosen by likelihood if absent'
    )
    share: Annotated[float, Field(ge=0, lt=1)] = Field(
        default=0.1, description="share of the small scale in the standard deviation"
    )
    memory_h: PositiveFloat = Field(default=3.0, description="memory of the small scale [h]")


class MembersConfiguration(Configuration):
    """What every ensemble is told."""

    members: int | Literal["auto"] = Field(
        default=1000, description='number of winds drawn; "auto": as many as precision takes'
    )
    # So that never more members are needed than may be asked for.
    precision: Annotated[float, Field(ge=1e-4, lt=0.5)] | None = Field(
        default=None,
        description="half-width of the 95 % interval of the probability of stranding, "
        'members = "auto" only; 0.01 if absent',
    )
    seed: Annotated[int, Field(ge=0, lt=2**64)] = Field(
        default=1, description="names the winds drawn"
    )
    model: ModelName = Field(default="mean-flow", description='"mean-flow", "paper" or "full"')
    order: Annotated[int, Field(ge=0, le=2)] | None = Field(
        default=None, description='order of the expansion: 1 or 2 ("mean-flow"), 0 or 1 ("paper")'
    )
    rtol: Annotated[float, Field(ge=1e-15, lt=0.1)] = Field(
        default=1e-6, description="relative tolerance"
    )
    keep: Annotated[int, Field(ge=0)] = Field(
        default=1000, description="members whose trajectories are kept, from the first on"
    )

    @field_validator("members", mode="plain")
    @classmethod
    def _number_or_auto(cls, value: Any) -> int | str:
        whole = isinstance(value, Integral) and not isinstance(value, bool)
        if value != "auto" and not (whole and 1 <= value <= _MOST_MEMBERS):
            raise ValueError(
                f"{value!r} is not accepted; it should be a whole number from 1 to "
                f'{_MOST_MEMBERS}, or "auto"'
            )
        return "auto" if value == "auto" else int(value)

    @model_validator(mode="after")
    def _order_exists(self) -> Self:
        check_order(self.model, self.order)
        return self

    @model_validator(mode="after")
    def _precision_is_sought(self) -> Self:
        if self.precision is not None and self.members != "auto":
            raise ValueError(
                f"precision: {self.precision} is not accepted with members = {self.members}; "
                'with members = "auto" it is'
            )
        return self

    @property
    def most_kept(self) -> int:
        """How many members' trajectories are kept at most."""
        return self.keep if self.members == "auto" else min(self.keep, self.members)


class EnsembleConfiguration(MembersConfiguration):
    """How the members are followed, and what is kept of them."""

    window: PositiveFloat | None = Field(
        default=None, description='averaging window of the wind, "paper" only; epsilon/2 if absent'
    )
    wind_terms: bool = Field(default=True, description='keep the terms B_W, "paper" only')
    outputs_per_tide: PositiveFloat = Field(default=8, description="positions kept per tide")


def area_of(name: str, shape: Any) -> Polygons:
    """Polygons from a ring of points, from Polygons, or from a polygon of another library."""
    if isinstance(shape, Polygons):
        return shape
    fields: Any = shape
    geometry: Any = getattr(shape, "__geo_interface__", None)
    if geometry is not None:
        kind, parts = geometry["type"], geometry["coordinates"]
        if kind not in ("Polygon", "MultiPolygon"):
            raise ValueError(f"{name}: a {kind} is not accepted; give a polygon")
        parts = [parts] if kind == "Polygon" else parts
        fields = {"rings": [ring for rings in parts for ring in rings]}
    elif not isinstance(shape, Mapping):
        fields = {"rings": (shape,)}
    try:
        return Polygons(**fields)
    except ScenarioError as error:
        raise ScenarioError(f"{name}.{error}") from None


def areas_of(value: Any) -> Any:
    """Areas by name, each as `area_of` takes it."""
    if not isinstance(value, Mapping):
        raise ValueError(f"{value!r} is not accepted; it should be a table of name = ring")
    return {str(name): area_of(str(name), shape) for name, shape in value.items()}


class RunConfiguration(Configuration):
    """Everything that names a forecast: what `driftcore run` reads."""

    scenario: Scenario = Field(default=Scenario())
    wind: WindConfiguration = Field(default=WindConfiguration())
    ensemble: EnsembleConfiguration = Field(default=EnsembleConfiguration())
    maps: MapGrid | None = Field(
        default=None, description="x, y, times, interval: maps of where members are and have been"
    )
    targets: dict[str, Polygons] = Field(
        default={}, description="name = [[x, y], ...]: areas whose first entry is noted"
    )

    _targets_from_rings = field_validator("targets", mode="before")(areas_of)

    @model_validator(mode="after")
    def _maps_fit_the_run(self) -> RunConfiguration:
        if self.maps is not None:
            self.maps.check(self.scenario.duration, self.scenario.period)
        return self

    @model_validator(mode="after")
    def _fits_memory(self) -> RunConfiguration:
        ensemble = self.ensemble
        tides = self.scenario.duration / self.scenario.epsilon
        # The times themselves are there even if nobody is kept.
        kept = max(1, ensemble.most_kept) * ensemble.outputs_per_tide * tides
        if kept > MOST_POSITIONS:
            raise ValueError(
                f"ensemble.keep: {ensemble.keep} is not accepted; with outputs_per_tide = "
                f"{ensemble.outputs_per_tide} the run would keep {kept:.3g} positions; "
                f"at most {MOST_POSITIONS:.0e}"
            )
        return self
