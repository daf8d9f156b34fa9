"""A forecast on the real sea as a file: TOML to a geographic scenario, its wind and its ensemble.

Paths are relative to the folder of the TOML file; boxes are west, south, east, north [degrees].
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, field_validator, model_validator

from driftcore.configuration import NOTHING, Configuration, read_toml
from driftcore.errors import DriftCoreError, ScenarioError
from driftcore.geographic import GeographicScenario
from driftcore.maps import MapGrid
from driftcore.objects import Distribution, FloatingBody, Leeway
from driftcore.releases import Release, Releases
from driftcore.scenario import (
    MOST_POSITIONS,
    MembersConfiguration,
    Polygons,
    RunConfiguration,
    WindConfiguration,
    areas_of,
)

if TYPE_CHECKING:
    from driftcore.coast import LandCoast
    from driftcore.currents import Current
    from driftcore.tides import TidalAtlas

KIND = "geographic"
# In a row of a map: finer ones would not fit into memory.
_MOST_CELLS = 1e5
_NATURAL_EARTH = "natural-earth"
# Bodies afloat follow a few percent of the wind; 1 is the paper's.
_LARGEST_WIND_FACTOR = 0.1

Longitude = Annotated[float, Field(ge=-360, le=360)]
Latitude = Annotated[float, Field(ge=-90, le=90)]
Box = tuple[Longitude, Latitude, Longitude, Latitude]
Files = Annotated[tuple[str, ...], Field(min_length=1)]


def _files(value: Any) -> Any:
    return (value,) if isinstance(value, str) else value


class AtlasTides(Configuration):
    """Tidal currents read from an atlas: `driftcore.tides.from_atlas`."""

    kind: Literal["atlas"] = "atlas"
    files: Files = Field(description='NetCDF file, list of files, or pattern such as "fes/*.nc"')
    names: dict[str, str] = Field(
        default={}, description='variables by role, such as u_amplitude = "Ua"; found if absent'
    )
    units: str | None = Field(default=None, description='"m/s" or "cm/s"; of the file if absent')
    phase_units: str | None = Field(
        default=None, description='"degrees" or "radians"; of the file if absent'
    )
    constituents: tuple[str, ...] | None = Field(
        default=None, description='such as ["M2", "S2"]; all but the long periods if absent'
    )
    region: Box | None = Field(default=None, description="box to read; all if absent")

    _one_file = field_validator("files", mode="before")(_files)

    def atlas(self) -> TidalAtlas:
        """Read it."""
        from driftcore.tides import from_atlas

        return from_atlas(
            self.files if len(self.files) > 1 else self.files[0],
            self.names,
            constituents=self.constituents,
            region=self.region,
            units=self.units,
            phase_units=self.phase_units,
        )


class BiscayTides(Configuration):
    """The idealised tide of the Bay of Biscay: `driftcore.tides.biscay`."""

    kind: Literal["biscay"] = "biscay"

    def atlas(self) -> TidalAtlas:
        """Make it."""
        from driftcore.tides import biscay

        return biscay()


class CurrentConfiguration(Configuration):
    """A residual current from files: `driftcore.currents.from_netcdf`."""

    files: Files = Field(description="NetCDF file, list of files, or pattern; joined in time")
    names: tuple[str, str] | None = Field(
        default=None, description="variables toward east and north; found if absent"
    )
    units: str | None = Field(
        default=None, description='"m/s", "cm/s", "km/h" or "knots"; of the file if absent'
    )
    region: Box | None = Field(default=None, description="box to read; all if absent")
    period: tuple[str, str] | None = Field(
        default=None, description='first and last day to read, ["2026-07-01", "2026-08-31"]'
    )
    depth: float = Field(default=0.0, description="level to read [m]")
    detide: bool = Field(
        default=False, description="remove the tide: where [tides] brings it, or it counts twice"
    )
    mean: bool = Field(
        default=False, description="use the mean over time: where the files end before the run"
    )

    _one_file = field_validator("files", mode="before")(_files)

    def current(self) -> Current:
        """Read it and make it ready."""
        from driftcore.currents import from_netcdf

        current = from_netcdf(
            self.files,
            names=self.names,
            units=self.units,
            region=self.region,
            period=self.period,
            depth=self.depth,
        )
        if self.detide:
            current = current.detided()
        return current.mean() if self.mean else current


class CoastConfiguration(Configuration):
    """Land from a file, or the land of the package; and how strandings are summed up."""

    file: str = Field(
        default=_NATURAL_EARTH,
        description=f'GeoJSON, Shapefile or GeoPackage of land polygons; "{_NATURAL_EARTH}": '
        "1:50 million, true to 1-2 km",
    )
    layer: str | None = Field(default=None, description="layer, where the file has several")
    name_column: str | None = Field(default=None, description="column of the names of polygons")
    divide_km: PositiveFloat | None = Field(
        default=None, description="sum up by stretches of this length [km]"
    )
    stretches: dict[str, Box] = Field(
        default={}, description="sum up by boxes: name = [west, south, east, north]"
    )

    @model_validator(mode="after")
    def _one_way_to_divide(self) -> Self:
        if self.divide_km is not None and self.stretches:
            raise ValueError("divide_km: is not accepted beside stretches; give one of them")
        for name, (west, south, east, north) in self.stretches.items():
            if not south < north or west == east:
                raise ValueError(
                    f"stretches.{name}: {[west, south, east, north]} is not accepted; it should be "
                    "[west, south, east, north]"
                )
        return self

    def land(self) -> LandCoast:
        """Read it."""
        from driftcore.coast import LandCoast

        if self.file == _NATURAL_EARTH:
            if self.name_column is not None:
                raise ScenarioError(
                    f"name_column: {self.name_column!r} is not accepted; {_NATURAL_EARTH} has no "
                    "names"
                )
            return LandCoast.default()
        return LandCoast.from_file(self.file, self.name_column, self.layer)

    def divided(self) -> LandCoast:
        """Read it, with its stretches."""
        if self.divide_km is not None:
            return self.land().divide(self.divide_km)
        boxes = {name: (w, e, s, n) for name, (w, s, e, n) in self.stretches.items()}
        return self.land().with_stretches(boxes)


class GeographicEnsemble(MembersConfiguration):
    """How the members are followed on the real sea, and what is kept of them."""

    model: Literal["mean-flow", "full"] = Field(
        default="mean-flow", description='"mean-flow" or "full"'
    )
    order: Annotated[int, Field(ge=1, le=2)] | None = Field(
        default=None, description='order of "mean-flow", 1 or 2'
    )
    outputs_h: PositiveFloat = Field(default=3.0, description="hours between positions kept")


class MapConfiguration(Configuration):
    """Maps of where members are and have been, on cells of longitude and latitude."""

    region: Box = Field(description="box of the maps")
    cell: PositiveFloat = Field(default=0.25, description="side of a cell [degrees]")
    days: Annotated[tuple[float, ...], Field(min_length=1)] = Field(
        description="days after the release, one map each"
    )
    interval_h: PositiveFloat | None = Field(
        default=None, description="hours between two sampled positions; a tide/8 if absent"
    )

    @model_validator(mode="after")
    def _whole_cells(self) -> Self:
        west, south, east, north = self.region
        for name, length in (("west to east", east - west), ("south to north", north - south)):
            count = length / self.cell
            if count > _MOST_CELLS:
                raise ValueError(
                    f"cell: {self.cell:g} is not accepted; {length:g} degrees would hold "
                    f"{count:.3g} cells in a row, at most {_MOST_CELLS:.0e}"
                )
            if not (count >= 0.5 and abs(count - round(count)) < 1e-6 * count):
                raise ValueError(
                    f"region: {length:g} degrees from {name} are not accepted; it should be a "
                    f"whole number of cells of {self.cell:g}"
                )
        return self

    def grid(self) -> MapGrid:
        """Give the grid that is counted on."""
        west, south, east, north = self.region
        columns, rows = round((east - west) / self.cell), round((north - south) / self.cell)
        return MapGrid(
            x=tuple(np.linspace(west, east, columns + 1)),
            y=tuple(np.linspace(south, north, rows + 1)),
            times=self.days,
            interval=None if self.interval_h is None else self.interval_h / 24,
        )


class GeographicConfiguration(Configuration):
    """Everything that names a forecast on the real sea: what `driftcore run` reads.

    A file is one of these where it says `kind = "geographic"`.
    """

    kind: Literal["geographic"] = Field(
        default="geographic", description="a forecast on the real sea"
    )
    name: str = Field(default="drift", description="a name for people")
    days: Annotated[float, Field(gt=0, le=36_525)] = Field(
        default=60.0, description="length of the run, from the earliest release on"
    )
    wind_current: tuple[Annotated[float, Field(ge=0, lt=1)], float] = Field(
        default=(0.0, 0.0),
        description="surface current that the wind drives: its share of the wind, and degrees to "
        "the right of it",
    )
    weights: tuple[float, ...] | None = Field(
        default=None, description="relative number of members of each of [[releases]]"
    )
    release: Release | None = Field(
        default=None, description="where and when; instead of it: several [[releases]]"
    )
    releases: tuple[Release, ...] = Field(default=(), description="several of them, each as above")
    object: FloatingBody | Leeway = Field(
        discriminator="kind",
        description='"floating-body", or kind = "leeway" and a category, such as "PIW-1"',
    )
    tides: AtlasTides | BiscayTides | None = Field(
        default=None,
        discriminator="kind",
        description='"atlas" of files; "biscay": an idealised one, to try; "none"',
    )
    current: CurrentConfiguration | None = Field(
        default=None, description="residual current: without the tide"
    )
    coast: CoastConfiguration | None = Field(
        default=CoastConfiguration(), description=f'coast = "{NOTHING}": nothing strands'
    )
    wind: WindConfiguration = Field(default=WindConfiguration())
    ensemble: GeographicEnsemble = Field(default=GeographicEnsemble())
    maps: MapConfiguration | None = Field(
        default=None, description="maps of where members are and have been"
    )
    targets: dict[str, Polygons] = Field(
        default={},
        description="name = [[longitude, latitude], ...]: areas whose first entry is noted",
    )

    @field_validator("object", mode="before")
    @classmethod
    def _object_of_a_kind(cls, value: Any) -> Any:
        if not isinstance(value, Mapping):
            return value
        kind = "leeway" if "category" in value else "floating-body"
        if value.get("kind") == "leeway" and "category" not in value:
            raise ScenarioError("category: is missing; driftcore objects lists them")
        return {"kind": kind, **value}

    @field_validator("tides", mode="before")
    @classmethod
    def _tides_of_a_kind(cls, value: Any) -> Any:
        if isinstance(value, Mapping):
            value = {"kind": "atlas", **value}
            return None if value["kind"] == NOTHING else value
        return None if value == NOTHING else value

    @field_validator("current", "coast", mode="before")
    @classmethod
    def _switched_off(cls, value: Any) -> Any:
        return None if isinstance(value, str) and value == NOTHING else value

    _targets_from_rings = field_validator("targets", mode="before")(areas_of)

    @model_validator(mode="after")
    def _released_one_way(self) -> Self:
        if self.release is None and not self.releases:
            raise ValueError("release: is missing; give [release], or several [[releases]]")
        if self.release is not None and (self.releases or self.weights):
            raise ValueError("release: is not accepted beside releases or weights; give one")
        if self.releases:
            Releases(self.releases, self.weights)
        return self

    @model_validator(mode="after")
    def _fits_memory(self) -> Self:
        ensemble = self.ensemble
        kept = max(1, ensemble.most_kept) * self.days * 24 / ensemble.outputs_h
        if kept > MOST_POSITIONS:
            raise ValueError(
                f"ensemble.keep: {ensemble.keep} is not accepted; with outputs_h = "
                f"{ensemble.outputs_h:g} the run would keep {kept:.3g} positions; "
                f"at most {MOST_POSITIONS:.0e}"
            )
        return self

    @model_validator(mode="after")
    def _maps_fit_the_run(self) -> Self:
        if self.maps is not None:
            self.maps.grid()
            if self.maps.days[-1] > self.days:
                raise ValueError(
                    f"maps.days: {self.maps.days[-1]:g} is not accepted; the run lasts "
                    f"{self.days:g} days"
                )
        return self

    def rooted(self, folder: Path | None = None) -> GeographicConfiguration:
        """Give the same with absolute paths, which start at a folder; patterns become files.

        Raises
        ------
        ScenarioError
            A file is not there.
        """
        start = (folder or Path()).resolve()
        changes: dict[str, Any] = {}
        for table, field, word in (
            ("tides", "files", None),
            ("current", "files", None),
            ("coast", "file", _NATURAL_EARTH),
            ("wind", "record", "embedded"),
        ):
            part = getattr(self, table)
            given: Any = getattr(part, field, word)
            if given == word:
                continue
            where = f"{table}.{field}"
            if isinstance(given, str):
                found: Any = _existing(where, start, given)[0]
            else:
                found = tuple(path for name in given for path in _existing(where, start, name))
            changes[table] = part.replace(**{field: found})
        return self.replace(**changes)

    def scenario(self, folder: Path | None = None) -> GeographicScenario:
        """Read what it names, and put it together.

        Parameters
        ----------
        folder : Path, optional
            Where relative paths start; default the working folder.

        Raises
        ------
        ScenarioError, RecordError
            A file is missing or does not serve, grids do not cover the release, or it is on land.
        """
        here = self.rooted(folder)
        coast = tides = current = None
        if here.coast is not None:
            with _told("coast"):
                coast = here.coast.land()
        if here.tides is not None:
            with _told("tides"):
                tides = here.tides.atlas()
        if here.current is not None:
            with _told("current"):
                current = here.current.current()
        return GeographicScenario(
            release=here.release or Releases(here.releases, here.weights),
            days=here.days,
            drifter=here.object,
            tides=tides,
            current=current,
            coast=coast,
            wind_current=here.wind_current,
            name=here.name,
        )

    def divided_coast(self, folder: Path | None = None) -> LandCoast | None:
        """Read the coast, with the stretches that strandings are summed up by where any are named.

        Raises
        ------
        ScenarioError
            Its file is missing or does not serve; the others need not be there.
        """
        alone = self.replace(wind=WindConfiguration(), tides=None, current=None)
        coast = alone.rooted(folder).coast
        if coast is None:
            return None
        with _told("coast"):
            return coast.divided()

    def stretches(self, folder: Path | None = None) -> LandCoast | None:
        """Read the coast with its stretches, if any are named."""
        coast = self.divided_coast(folder)
        return coast if coast is not None and coast.stretches else None

    @classmethod
    def example(
        cls,
        release: tuple[float, float, str] | None = None,
        days: float = 60.0,
        drifter: str | None = None,
        *,
        wind: str | None = None,
        tides: str | None = None,
        current: str | None = None,
        coast: str | None = None,
    ) -> Self:
        """Give a configuration to start from; left out, what runs without any file.

        Parameters
        ----------
        release : tuple of float, float and str, optional
            Longitude, latitude and time; default in the Bay of Biscay, today at 6 h UTC.
        days : float
            Length of the run.
        drifter : str, optional
            Category of a search object; default a body that follows 3 % of the wind.
        wind, current, coast : str, optional
            Files, relative to the folder that the configuration will stand in. The wind's months
            become those of the run.
        tides : str, optional
            File of an atlas, "biscay" or "none"; default "biscay" without a release of one's own.
        """
        longitude, latitude, time = release or (-4.1, 47.2, f"{datetime.now(UTC):%Y-%m-%d}T06:00")
        try:
            place = Release.point(longitude, latitude, time)
        except ScenarioError as error:
            raise ScenarioError(f"release.{error}") from None
        kind = tides or ("biscay" if release is None else NOTHING)
        if kind not in ("biscay", NOTHING):
            tidal: dict[str, Any] = {"kind": "atlas", "files": kind}
        else:
            tidal = {"kind": kind}
        body = {"category": drifter} if drifter else {"response_time_h": 1.0, "wind_factor": 0.03}
        run: dict[str, Any] = {"release": place, "days": days, "object": body, "tides": tidal}
        if wind is not None:
            last = place.start + timedelta(days=days)
            count = 12 * (last.year - place.start.year) + last.month - place.start.month
            months = {(place.start.month - 1 + k) % 12 + 1 for k in range(count + 1)}
            run["wind"] = {"record": wind, "months": sorted(months)}
        if current is not None:
            run["current"] = {"files": current}
        if coast is not None:
            run["coast"] = {"file": coast}
        return cls(**run)

    def doubts(self) -> Iterator[str]:
        """Say what no real forecast would have."""
        if self.wind.record == "embedded":
            yield "wind: it is of a synthetic climate, which says nothing about a real sea"
        if self.tides is None:
            yield "tides: there are none"
        elif isinstance(self.tides, BiscayTides):
            yield "tides: the idealised ones of the Bay of Biscay are there to try, no atlas"
        if self.coast is None:
            yield "coast: there is none, so that nothing strands"
        if isinstance(self.object, FloatingBody):
            factor = self.object.wind_factor
            middle = float(
                factor.quantile(np.array([0.5]))[0] if isinstance(factor, Distribution) else factor
            )
            if middle > _LARGEST_WIND_FACTOR:
                yield (
                    f"object.wind_factor: {middle:g} of the wind is the paper's body; what floats "
                    "in the water follows some percent of it"
                )


@contextmanager
def _told(table: str) -> Iterator[None]:
    """Name the table in what the reading of its files refuses."""
    try:
        yield
    except DriftCoreError as error:
        raise type(error)(f"[{table}] {error}") from None


def _existing(where: str, start: Path, name: str) -> list[str]:
    """Files of a path or pattern, absolute."""
    path = start / name
    try:
        found = [str(path)] if path.exists() else sorted(glob(str(path)))  # noqa: PTH207 (absolute)
    except (OSError, ValueError) as error:  # too long, or with a zero byte
        raise ScenarioError(f"{where}: {name!r} is not accepted; {error}") from None
    if not found or path.is_dir():
        what = "is a folder" if path.is_dir() else f"there is no such file in {path.parent}"
        raise ScenarioError(f"{where}: {name!r} is not accepted; {what}")
    return found


def read_configuration(path: str | Path) -> GeographicConfiguration | RunConfiguration:
    """Read a scenario file, or its text: `kind = "geographic"` makes it one of the real sea.

    Raises
    ------
    ScenarioError
        The file is missing or not TOML, or a value is not accepted.
    """
    values = read_toml(path)
    if values.get("kind") == KIND:
        return GeographicConfiguration(**values)
    of_the_sea = sorted({"release", "releases", "days", "object"} & set(values))
    if "kind" in values or of_the_sea:
        told = f"{values['kind']!r} is not accepted" if "kind" in values else "is missing"
        raise ScenarioError(
            f'kind: {told}; put kind = "{KIND}" at the top of a scenario of the real sea (found: '
            f"{', '.join(of_the_sea) or 'nothing of it'}), and no kind into one of the paper"
        )
    return RunConfiguration(**values)
