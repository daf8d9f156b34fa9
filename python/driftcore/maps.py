"""Maps of where members are and have been: what is counted, cell by cell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field, PositiveFloat, field_validator, model_validator

from driftcore.configuration import Configuration
from driftcore.memory import require_room

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from driftcore import _core

# 800 MB as the numbers that a dataset holds; each thread counts in a quarter of that.
_MOST_VALUES = 10**8
# As many positions of sixteen members are held by each thread.
_MOST_SAMPLES = 10**6

Numbers = tuple[float, ...]


class MapGrid(Configuration):
    """A regular grid on which members are counted while they are followed.

    The memory it takes does not depend on the number of members, and what is counted neither on
    threads nor on chunks. A cell holds its lower edges and not its upper ones. Cells crossed
    between two sampled positions are those on the straight line between them.

    Raises
    ------
    ScenarioError
        Edges are not regular, times do not increase, or the maps hold too many values.
    """

    x: Annotated[Numbers, Field(min_length=2)] = Field(
        description="edges of the columns, regular and increasing"
    )
    y: Annotated[Numbers, Field(min_length=2)] = Field(
        description="edges of the rows, regular and increasing"
    )
    times: Annotated[Numbers, Field(min_length=1)] = Field(
        description="times of the maps, increasing"
    )
    interval: PositiveFloat | None = Field(
        default=None, description="time between two sampled positions; epsilon/8 if absent"
    )

    @field_validator("x", "y")
    @classmethod
    def _regular(cls, edges: Numbers) -> Numbers:
        steps = np.diff(edges)
        if steps[0] <= 0 or np.abs(steps - steps[0]).max() > 1e-6 * steps[0]:
            raise ValueError(
                f"{len(edges)} edges from {edges[0]:g} to {edges[-1]:g} are not accepted; they "
                "must be regular and increase"
            )
        return edges

    @field_validator("times")
    @classmethod
    def _increasing(cls, times: Numbers) -> Numbers:
        if times[0] < 0 or (np.diff(times) <= 0).any():
            raise ValueError(
                f"{len(times)} times from {times[0]:g} to {times[-1]:g} are not accepted; they "
                "must increase from 0 or later on"
            )
        return times

    @model_validator(mode="after")
    def _fits_memory(self) -> MapGrid:
        values = np.prod([float(n) for n in self.shape])
        if values > _MOST_VALUES:
            times, rows, columns = self.shape
            raise ValueError(
                f"{times} maps of {rows} x {columns} cells are not accepted; they hold "
                f"{values:.3g} values, {values * 8 / 1e9:.3g} GB, at most {_MOST_VALUES:.0e}"
            )
        return self

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of map times, of rows and of columns."""
        return len(self.times), len(self.y) - 1, len(self.x) - 1

    def check(self, duration: float, period: float) -> None:
        """Refuse what does not fit a run, both in scenario time.

        Raises
        ------
        ValueError
            A map time lies beyond the run, or there are too many samples.
        """
        if self.times[-1] > duration:
            raise ValueError(
                f"maps.times: {self.times[-1]:g} is not accepted; the run covers [0, {duration:g}]"
            )
        interval = self.interval or period / 8
        if duration / interval > _MOST_SAMPLES:
            raise ValueError(
                f"maps.interval: {interval:g} is not accepted; a run of {duration:g} would have "
                f"{duration / interval:.3g} samples, at most {_MOST_SAMPLES:.0e}"
            )

    def core(self, samples: NDArray[np.float64], threads: int) -> _core.Maps:
        """Build the compiled maps, nothing counted yet; the map times are among the samples."""
        from driftcore import _core

        maps, rows, columns = self.shape
        cells = float(rows * columns)
        # Each thread counts presence and arrival, and where a member has been.
        require_room("threads", float(threads), cells * (4 * (2 * maps + 1) + 1), "threads' maps")
        require_room("maps", cells * (4 * maps + 2), 3 * 8, "cells of maps")
        x, y = (
            (edges[0], (edges[-1] - edges[0]) / (len(edges) - 1), len(edges) - 1)
            for edges in (self.x, self.y)
        )
        return _core.Maps(x, y, np.array(self.times), samples, threads)
