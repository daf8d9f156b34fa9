"""Winds that vary in space, resampled: whole fields from a record of fields.

The anomalies of the record are written by principal components: with the mean cycle `M` and the
patterns `E`

    W(step, place) = M[phase(step)](place) + Σ_k c_k(step) E_k(place).

The two leading components, two numbers a step as the wind of one place, are resampled by
`LocalGridBootstrap`, which also tells the row `J` of the record whose successor each value comes
from. The others are, as they are in the record, a response to the leading ones of half a day
before and after, which are known once these are simulated, and a noise with a memory of its own:

    c_k = Σ_l g_kl · (c_1, c_2)(step + l) + n_k,    n(step + 1) = (B n)(step) + s_J.

So every component keeps its memory and its lag behind the others, as of weather that moves across
the grid, and what is new in a step is new everywhere at once. To take the other components from row
`J + 1` as they stand there would let them jump at every step.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from driftcore.check import Check
from driftcore.errors import RecordError, ScenarioError, warn
from driftcore.grids import GridSource, VectorGrid, read_wind_grid
from driftcore.record import Float, Gaps, Integer, WindRecord, mean_cycle, read_record
from driftcore.wind import (
    LocalGridBootstrap,
    Mode,
    _drawn_share,
    _least_squares,
    _predict,
    _standardized,
)

if TYPE_CHECKING:
    from driftcore.law import Simulator

_LEADING = 2
_CARRIED = 0.99
_LEAST_SHARE = 0.9
# Rows of the record for each number of a predictor.
_ROWS_FOR_EACH = 20
_RESPONSE_H = 12

SHARE = "share of the variance in the components"
CORRELATION = "correlation with the grid's centre, largest difference"
FIELD_DEVIATION = "standard deviation, largest relative error of a cell"
_LARGEST_CORRELATION_ERROR = 0.05
_LARGEST_DEVIATION_ERROR = 0.06
_COMPARED_MEMBERS, _COMPARED_DAYS, _COMPARED_FIELDS = 200, 30, 24_000


class Components(NamedTuple):
    """Leading principal components of a record of fields."""

    patterns: Float
    """Patterns of u and v, shape (k, 2, ny, nx), orthogonal, of area-mean square 1."""
    scores: Float
    """Components of each row [m/s], shape (n, k): for a uniform wind they are its components."""
    share: Float
    """Share of the variance that each carries, shape (k,)."""


class FieldSample(NamedTuple):
    """Draws of a `FieldBootstrap`: what makes up each field."""

    indices: Integer
    """Row of the record whose successor made each value, shape (members, steps)."""
    components: Float
    """Components [m/s], shape (members, steps, k)."""
    phase: Integer
    """Place in the mean cycle, shape (members, steps)."""


class Others(NamedTuple):
    """How the components but the leading two follow; see the module."""

    response: Float
    """`g`, shape (k - 2, 1 + 2 (2 reach + 1)): a constant, then earlier to later leading ones."""
    memory: Float
    """`B` of the noise, shape (k - 2, 1 + p (k - 2)): a constant first, newest states first."""
    missed: Float
    """`s` of each row of the catalogue, of mean zero as drawn [m/s], (rows, k - 2)."""
    noise: Float
    """`n` of each row of the record [m/s], NaN near the ends of segments, shape (n, k - 2)."""
    start: Integer
    """Rows of the record with p values of the noise, where one may begin."""

    @property
    def reach(self) -> int:
        """Steps that the response looks back and ahead."""
        return int(self.response.shape[1] - 3) // 4


@dataclass(frozen=True, eq=False)
class GriddedWindRecord:
    """A record of wind fields, regular in time and cut to months as a `WindRecord` is.

    Attributes
    ----------
    record : WindRecord
        The mean over the area, whose rows, segments and months are those of the fields.
    longitude, latitude : ndarray, shapes (nx,), (ny,)
        Regular axes [degrees].
    velocity : ndarray, shape (n, 2, ny, nx)
        Velocity toward east and north [m/s].
    """

    record: WindRecord
    longitude: Float
    latitude: Float
    velocity: Float

    @classmethod
    def from_grid(
        cls, grid: VectorGrid, months: Iterable[int] | None = None, *, gaps: Gaps = "error"
    ) -> Self:
        """Check the fields' times and keep some calendar months.

        Raises
        ------
        RecordError
            If it is no wind, has values missing, or its times or months do not serve
            (`read_record`).
        """
        import pandas as pd

        if grid.kind != "wind":
            raise RecordError(f"kind: {grid.kind!r} is not accepted; a wind is needed")
        if grid.missing.any():
            raise RecordError(
                f"values: {int(grid.missing.sum())} cells have none; give a region without gaps"
            )
        area = _area(grid.latitude, len(grid.longitude))
        means = {name: (getattr(grid, name) * area).sum(axis=(1, 2)) for name in "uv"}
        table = pd.DataFrame(means, index=pd.DatetimeIndex(grid.times, name="time"))
        record = read_record(table, months, gaps=gaps, label=grid.label)
        record = dataclasses.replace(record, source=grid.source)
        rows = np.isin(grid.times.astype("datetime64[s]"), record.times)
        velocity = np.stack([grid.u[rows], grid.v[rows]], axis=1)
        return cls(record, grid.longitude, grid.latitude, velocity)

    @cached_property
    def _cycle(self) -> tuple[Integer, Float]:
        flat = dataclasses.replace(
            self.record, velocity=self.velocity.reshape(len(self.record), -1)
        )
        phase, cycle = mean_cycle(flat)
        return phase, cycle.reshape(-1, *self.velocity.shape[1:])

    @property
    def phase(self) -> Integer:
        """Place of each row in the mean cycle, shape (n,)."""
        return self._cycle[0]

    @property
    def cycle(self) -> Float:
        """Mean cycle of each cell [m/s], shape (phases, 2, ny, nx); see `mean_cycle`."""
        return self._cycle[1]

    @cached_property
    def anomaly(self) -> Float:
        """Fields less their mean cycle [m/s], shape (n, 2, ny, nx)."""
        return np.asarray(self.velocity - self.cycle[self.phase])

    @property
    def standard_deviation(self) -> float:
        """Root of the mean variance of u and v over the area, daily cycle included [m/s]."""
        area = _area(self.latitude, len(self.longitude))
        return math.sqrt((self.velocity.var(axis=0) * area).sum() / 2)

    def components(self, wanted: float = _LEADING) -> Components:
        """Find the leading principal components of the anomalies, weighted by area.

        Parameters
        ----------
        wanted : int or float
            A number of components, or a share of the variance in (0, 1) that they carry at least.

        Raises
        ------
        ScenarioError
            If it is neither.
        """
        most = min(len(self.record), self.velocity[0].size)
        by_number = isinstance(wanted, int | np.integer) and not isinstance(wanted, bool)
        if not (1 <= wanted <= most if by_number else 0 < wanted < 1):
            raise ScenarioError(
                f"components: {wanted!r} is not accepted; use a whole number from 1 to {most}, or "
                "a share of the variance between 0 and 1"
            )
        share, patterns = self._principal
        # A share that equals a sum but for rounding is reached by it.
        count = int(wanted) if by_number else int((np.cumsum(share) < wanted - 1e-12).sum()) + 1
        kept = patterns[:count]
        area = _area(self.latitude, len(self.longitude))
        scores = np.tensordot(self.anomaly, kept * area, axes=((1, 2, 3), (1, 2, 3)))
        return Components(kept, np.ascontiguousarray(scores), share[:count])

    @cached_property
    def _principal(self) -> tuple[Float, Float]:
        """Shares of the variance, largest first, and patterns (k, 2, ny, nx)."""
        root = np.sqrt(_area(self.latitude, len(self.longitude)))
        weighted = (self.anomaly * root).reshape(len(self.record), -1)
        # The left singular vectors are not needed; the transpose is taken where it is smaller.
        if weighted.shape[0] >= weighted.shape[1]:
            triangle = np.linalg.qr(weighted, mode="r")
            _, singular, vectors = np.linalg.svd(triangle, full_matrices=False)
        else:
            _, singular, vectors = np.linalg.svd(weighted, full_matrices=False)
        if singular[0] == 0:
            raise RecordError("record: the wind does not vary; a bootstrap needs a varying wind")
        patterns = vectors.reshape(-1, *self.velocity.shape[1:]) / root
        # A pattern has no sign of its own: on the whole it blows toward the northeast.
        patterns *= np.where((patterns * root**2).sum(axis=(1, 2, 3)) < 0, -1, 1)[
            :, None, None, None
        ]
        return singular**2 / (singular**2).sum(), patterns


@dataclass(frozen=True, eq=False)
class FieldBootstrap:
    """Resampler of a record of wind fields; see the module.

    Attributes
    ----------
    gridded : GriddedWindRecord
    bootstrap : LocalGridBootstrap
        Fitted to the two leading components.
    patterns : ndarray, shape (k, 2, ny, nx)
        Patterns of u and v of all components.
    scores : ndarray, shape (n, k)
        Components of each row of the record [m/s].
    shares : ndarray, shape (k,)
        Share of the variance that each carries.
    others : Others
    """

    gridded: GriddedWindRecord
    bootstrap: LocalGridBootstrap
    patterns: Float
    scores: Float
    shares: Float
    others: Others

    @classmethod
    def fit(
        cls,
        grid: GridSource | VectorGrid | GriddedWindRecord,
        months: Iterable[int] | None = (6, 7, 8),
        mode: Mode = "residual",
        h: float | None = None,
        b: float | None = None,
        order: int = 2,
        *,
        gaps: Gaps = "error",
        share: float = 0.1,
        memory_h: float = 3.0,
        carried: float = _CARRIED,
    ) -> Self:
        """Fit the bootstrap to the principal components of a record of fields.

        Parameters are those of `LocalGridBootstrap.fit`, but for

        Parameters
        ----------
        grid : what `read_wind_grid` accepts or returned, or GriddedWindRecord
            The latter has settled `months` and `gaps`.
        carried : float
            Share of the variance that the components carry together, in (0, 1); at least two are
            kept, and not more than a record of this length tells a predictor of.

        Raises
        ------
        RecordError, ScenarioError
            As `read_wind_grid`, `GriddedWindRecord.from_grid` and `LocalGridBootstrap.fit`.

        Warns
        -----
        DriftCoreWarning
            If the components carry less than 0.9 of the variance, or the record has fewer than 3
            seasons.
        """
        if isinstance(grid, GriddedWindRecord):
            gridded = grid
        else:
            if not isinstance(grid, VectorGrid):
                grid = read_wind_grid(grid)
            gridded = GriddedWindRecord.from_grid(grid, months, gaps=gaps)
        found = gridded.components(carried)
        most = max(_LEADING, len(gridded.record) // (_ROWS_FOR_EACH * order))
        if not _LEADING <= len(found.share) <= most:
            found = gridded.components(min(max(_LEADING, len(found.share)), most))
        if found.share.sum() < _LEAST_SHARE:
            warn(
                f"{len(found.share)} components carry {found.share.sum():.2f} of the wind's "
                "variance, more cannot be told of this record; give a smaller region or more years"
            )
        leading = np.ascontiguousarray(found.scores[:, :_LEADING])
        bootstrap = LocalGridBootstrap.fit(
            dataclasses.replace(gridded.record, velocity=leading),
            None,
            mode,
            h,
            b,
            order,
            share=share,
            memory_h=memory_h,
        )
        others = _others(found.scores, bootstrap)
        return cls(gridded, bootstrap, found.patterns, found.scores, found.share, others)

    @property
    def share(self) -> float:
        """Share of the variance that the components carry."""
        return float(self.shares.sum())

    @property
    def small_scale_sd(self) -> float:
        """Standard deviation of each component of the small-scale part [m/s]."""
        share = self.bootstrap.share
        return share * self.gridded.standard_deviation / math.sqrt(1 - share**2)

    def sample(
        self,
        members: int,
        steps: int,
        seed: int,
        *,
        first_member: int = 0,
        phase: int | None = None,
    ) -> FieldSample:
        """Simulate the components.

        Parameters are those of `LocalGridBootstrap.sample`: a member depends on `seed` and its
        number only, and a step is the record's.

        Parameters
        ----------
        members, steps, seed
            As `LocalGridBootstrap.sample`.
        first_member : int
            Number of the first of them.
        phase : int, optional
            Place in the mean cycle at the first step; any, if absent.
        """
        return self._sample(self.bootstrap, members, steps, seed, first_member, phase)

    def _sample(
        self,
        bootstrap: LocalGridBootstrap,
        members: int,
        steps: int,
        seed: int,
        first_member: int = 0,
        start_phase: int | None = None,
    ) -> FieldSample:
        others, order = self.others, bootstrap.order
        ahead = steps + 2 * others.reach
        if start_phase is None and first_member == 0:
            values, indices = bootstrap.sample(members, ahead, seed, return_indices=True)
        else:
            before = None
            if start_phase is not None:
                before = bootstrap.phase_before(start_phase, others.reach)
            values, indices = bootstrap.core.sample(members, ahead, seed, first_member, before)
        begin = indices[:, 0] + 1
        phase = (self.gridded.phase[begin, None] + np.arange(ahead)) % len(self.gridded.cycle)
        # The components of anomalies have no mean cycle but for rounding, which is taken out.
        leading = values - bootstrap.cycle[phase]
        kept = slice(others.reach, others.reach + steps)
        indices = indices[:, kept]

        noise = np.empty((members, order - 1 + steps, self.scores.shape[1] - _LEADING))
        place = np.searchsorted(others.start, begin).clip(max=len(others.start) - 1)
        for lag in range(order):
            noise[:, order - 1 - lag] = others.noise[others.start[place] - lag]
        new = others.missed[np.searchsorted(bootstrap.row, indices[:, 1:])]
        for k in range(steps - 1):
            states = noise[:, k : k + order][:, ::-1].reshape(members, -1)
            noise[:, order + k] = _predict(others.memory, states) + new[:, k]
        followed = noise[:, order - 1 :] + others.response[:, 0]
        for lag in range(2 * others.reach + 1):
            of_lag = others.response[:, 1 + 2 * lag : 3 + 2 * lag]
            followed += leading[:, lag : lag + steps] @ of_lag.T
        components = np.concatenate([leading[:, kept], followed], axis=2)
        return FieldSample(indices, components, phase[:, kept])

    def fields(self, sample: FieldSample, member: int) -> tuple[Float, Float]:
        """Whole fields of a member: u and v [m/s], shape (steps, ny, nx) each."""
        whole = self.gridded.cycle[sample.phase[member]]
        whole += np.tensordot(sample.components[member], self.patterns, axes=1)
        return whole[:, 0], whole[:, 1]

    def series(self, sample: FieldSample, row: int, column: int) -> Float:
        """Wind of all members at a node of the grid [m/s], shape (members, steps, 2)."""
        members, steps = sample.indices.shape
        member, step = np.ogrid[:members, :steps]
        return self._at(sample, member, step, np.array(row), np.array(column))

    def velocity(
        self,
        sample: FieldSample,
        member: int,
        time_h: ArrayLike,
        longitude: ArrayLike,
        latitude: ArrayLike,
    ) -> Float:
        """Wind of a member at times and places, linear in time and in each direction.

        Parameters
        ----------
        time_h : array_like
            Time since the first step [h].
        longitude, latitude : array_like
            Places [degrees], which go with the times.

        Returns
        -------
        ndarray, shape (..., 2)
            Velocity toward east and north [m/s].

        Raises
        ------
        ScenarioError
            If a time or place is not covered.
        """
        grid = self.gridded
        west = grid.longitude[0]
        turned = np.mod(np.asarray(longitude, np.float64) - west + 1e-9, 360) + west - 1e-9
        steps = np.arange(sample.indices.shape[1], dtype=np.float64) * grid.record.step_h
        places = np.broadcast_arrays(
            _place("time_h", time_h, steps),
            _place("latitude", latitude, grid.latitude),
            _place("longitude", turned, grid.longitude),
        )
        wind = np.zeros((*places[0].shape, 2))
        before = [np.floor(place).astype(np.int64) for place in places]
        for corner in np.ndindex(2, 2, 2):
            weight = np.ones(places[0].shape)
            node = []
            for place, low, side in zip(places, before, corner, strict=True):
                share = place - low
                weight = weight * (share if side else 1 - share)
                node.append(low + side * (share > 0))  # the last node has none beyond it
            wind += weight[..., None] * self._at(sample, np.array(member), *node)
        return wind

    def _at(
        self, sample: FieldSample, member: Integer, step: Integer, row: Integer, column: Integer
    ) -> Float:
        """Wind at nodes, all indices broadcast, shape (..., 2)."""
        mean = self.gridded.cycle[sample.phase[member, step], :, row, column]
        patterns = self.patterns[:, :, row, column]  # (k, 2, ...)
        return np.asarray(
            mean + np.einsum("...k,kc...->...c", sample.components[member, step], patterns)
        )

    def __repr__(self) -> str:
        return f"FieldBootstrap({self.bootstrap!r}, share={self.share:.3f})"


def _others(scores: Float, bootstrap: LocalGridBootstrap) -> Others:
    record, order = bootstrap.record, bootstrap.order
    reach = max(1, round(_RESPONSE_H / record.step_h))
    rows = np.arange(reach, len(record) - reach)
    rows = rows[record.segment[rows - reach] == record.segment[rows + reach]]
    around = [scores[rows + lag, :_LEADING] for lag in range(-reach, reach + 1)]
    design = np.concatenate(around, axis=1)
    response = _least_squares(design, scores[rows, _LEADING:])
    noise = np.full_like(scores[:, _LEADING:], np.nan)
    noise[rows] = scores[rows, _LEADING:] - _predict(response, design)

    count = noise.shape[1]
    known = np.isin(np.arange(order, len(record)) - order, rows)
    fitted = np.arange(order, len(record))[known]
    fitted = fitted[
        np.isin(fitted, rows) & (record.segment[fitted - order] == record.segment[fitted])
    ]
    states = np.concatenate([noise[fitted - lag] for lag in range(1, order + 1)], axis=1)
    memory = _least_squares(states, noise[fitted])
    missed = noise[fitted] - _predict(memory, states)
    companion = np.eye(order * count, k=-count)
    companion[:count] = memory[:, 1:]
    radius = np.abs(np.linalg.eigvals(companion)).max(initial=0)
    if radius >= 1:
        raise RecordError(
            f"record: the noise of its components grows ({radius:.3g} a step): it is too short "
            f"({record.describe()}); give more years, or a lower order or carried"
        )
    # Near the end of a segment that of the next row that has one stands in.
    missed = missed[np.searchsorted(fitted, bootstrap.row + 1).clip(max=len(fitted) - 1)]
    if count:
        whitened = bootstrap.states @ bootstrap.whitening.T
        drawn = _drawn_share(whitened, bootstrap.h, round(24 / record.step_h))
        missed = _standardized(missed, drawn)
    return Others(response, memory, missed, noise, fitted)


def assess(wind: FieldBootstrap, *, seasons: int = 200, seed: int = 1) -> list[Check]:
    """Measure whether sampled fields have the law of their record.

    In space: the share of the variance that the components carry, the correlation of each
    cell with the grid's centre, and each cell's standard deviation. In time: tests T1 to T7 of
    `driftcore.law` at the centre.

    Raises
    ------
    RecordError
        If the record has fewer than 6 seasons: too few for standard errors.
    """
    from driftcore import law

    gridded = wind.gridded
    row, column = len(gridded.latitude) // 2, len(gridded.longitude) // 2
    centre = dataclasses.replace(
        gridded.record, velocity=np.ascontiguousarray(gridded.velocity[:, :, row, column])
    )
    return [
        Check(SHARE, wind.share, 1.0, _LEAST_SHARE),
        *_space(wind, row, column, seed),
        *law.assess(_simulator(wind, row, column, seed), centre, seasons=seasons, seed=seed),
    ]


def _space(wind: FieldBootstrap, row: int, column: int, seed: int) -> list[Check]:
    per_day = round(24 / wind.gridded.record.step_h)
    steps = _COMPARED_DAYS * per_day
    # Fields an hour apart tell little more than one; each hour of the day must be met.
    stride = math.ceil(_COMPARED_MEMBERS * steps / _COMPARED_FIELDS)
    while math.gcd(stride, per_day) > 1:
        stride += 1
    whole = wind.sample(_COMPARED_MEMBERS, steps, seed)
    kept = np.s_[:, ::stride]
    sample = FieldSample(whole.indices[kept], whole.components[kept], whole.phase[kept])
    found, expected = _Moments(row, column), _Moments(row, column)
    expected.add(wind.gridded.velocity)
    for member in range(_COMPARED_MEMBERS):
        found.add(np.stack(wind.fields(sample, member), axis=1))
    differences = found.correlation - expected.correlation
    errors = found.deviation / expected.deviation - 1
    return [
        Check(CORRELATION, float(np.abs(differences).max()), _LARGEST_CORRELATION_ERROR),
        Check(FIELD_DEVIATION, float(np.abs(errors).max()), _LARGEST_DEVIATION_ERROR),
    ]


class _Moments:
    """Moments of fields (n, 2, ny, nx) added one batch after the other."""

    def __init__(self, row: int, column: int) -> None:
        self.node = row, column
        self.number = 0
        self.sums: tuple[Float, Float, Float] | None = None

    def add(self, fields: Float) -> None:
        centre = fields[:, :, *self.node]
        products = np.einsum("nkyx,nk->kyx", fields, centre)
        new = fields.sum(axis=0), np.einsum("nkyx,nkyx->kyx", fields, fields), products
        self.sums = new if self.sums is None else tuple(map(np.add, self.sums, new))  # type: ignore[assignment]
        self.number += len(fields)

    @property
    def _means(self) -> tuple[Float, Float, Float]:
        assert self.sums is not None  # noqa: S101 - a batch was added
        mean, square, product = (values / self.number for values in self.sums)
        return mean, square - mean**2, product - mean * mean[:, *self.node][:, None, None]

    @property
    def deviation(self) -> Float:
        """Standard deviation, shape (2, ny, nx)."""
        return np.asarray(np.sqrt(self._means[1]))

    @property
    def correlation(self) -> Float:
        """Correlation of each cell's u and v with those of the node, shape (2, ny, nx)."""
        _, variance, covariance = self._means
        return np.asarray(covariance / np.sqrt(variance * variance[:, *self.node][:, None, None]))


def _simulator(wind: FieldBootstrap, row: int, column: int, seed: int) -> Simulator:
    """Give the wind at a node as `driftcore.law` wants it."""

    def simulate(members: int, steps: int, start: int | None) -> tuple[Float, Integer]:
        bootstrap = wind.bootstrap
        if start is not None:
            bootstrap = dataclasses.replace(bootstrap, start=bootstrap.row == start)
        sample = wind._sample(bootstrap, members, steps, seed)
        return wind.series(sample, row, column), sample.indices

    return simulate


def _area(latitude: Float, columns: int) -> Float:
    """Share of each cell in the area of the grid, shape (ny, nx)."""
    shrink = np.maximum(np.cos(np.deg2rad(latitude)), 1e-6)
    return np.repeat((shrink / shrink.sum() / columns)[:, None], columns, axis=1)


def _place(field: str, values: ArrayLike, axis: Float) -> Float:
    """Place along a regular axis, counted in nodes."""
    wanted = np.asarray(values, np.float64)
    step = axis[1] - axis[0] if len(axis) > 1 else 1.0
    place = (wanted - axis[0]) / step
    outside = ~((place >= -1e-6) & (place <= len(axis) - 1 + 1e-6))
    if outside.any():
        raise ScenarioError(
            f"{field}: {wanted[outside].flat[0]:g} is not covered; known is {axis[0]:g} to "
            f"{axis[-1]:g}"
        )
    return np.asarray(np.clip(place, 0, len(axis) - 1))
