from collections.abc import Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

VERSION: str

_Floats = NDArray[np.float64]
_Integers = NDArray[np.int64]
_Counts = NDArray[np.uint32]
_Fates = tuple[NDArray[np.int8], _Floats, _Floats, _Floats, _Floats]
_Current = tuple[tuple[float, float, float, float, int], _Floats]

@final
class WindPath:
    def __new__(cls, times: _Floats, velocity: _Floats) -> WindPath: ...
    @property
    def start(self) -> float: ...
    @property
    def end(self) -> float: ...
    def velocity(self, times: _Floats) -> _Floats: ...
    def integral(self, times: _Floats) -> _Floats: ...
    def mean(self, times: _Floats, window: float) -> _Floats: ...

@final
class WindPaths:
    def __new__(
        cls, start: float, spacing: float, velocity: _Floats | NDArray[np.float32]
    ) -> WindPaths: ...
    def velocity(self, members: int, times: _Floats) -> _Floats: ...

@final
class Bootstrap:
    def __new__(
        cls,
        states: _Floats,
        whitening: _Floats,
        target: _Floats,
        predictor: _Floats,
        noise: _Floats,
        row: _Integers,
        phase: _Integers,
        start: NDArray[np.bool_],
        cycle: _Floats,
        bandwidth: float,
    ) -> Bootstrap: ...
    def sample(
        self,
        members: int,
        steps: int,
        seed: int,
        first_member: int = 0,
        phase: int | None = None,
        hand_over: HandOver | None = None,
    ) -> tuple[_Floats, _Integers]: ...
    def draws_at(
        self, state: _Floats, count: int, seed: int, weigh_all: bool = False
    ) -> _Integers: ...

@final
class HandOver:
    def __new__(
        cls,
        forecasts: _Floats,
        spread: _Floats,
        memory: list[list[float]],
        innovation: list[list[float]],
        scale: list[list[float]],
    ) -> HandOver: ...

@final
class WindGenerator:
    def __new__(
        cls,
        bootstrap: Bootstrap,
        step: float,
        unit: float,
        small_scale_sd: float,
        memory: float,
        substeps: int,
        lead_in: int,
        phase: int | None = None,
        hand_over: HandOver | None = None,
    ) -> WindGenerator: ...
    def path(self, seed: int, member: int, end: float) -> tuple[_Floats, _Floats]: ...

@final
class Particles:
    def __new__(cls, members: NDArray[np.uint64], parts: int) -> Particles: ...
    def branched(
        self, parents: _Integers, steps: _Integers, members: NDArray[np.uint64]
    ) -> Particles: ...
    def replaced(self, places: _Integers, others: Particles) -> Particles: ...
    def seen(self) -> _Floats: ...
    def followed(self) -> float: ...

@final
class Sea:
    @staticmethod
    def academic(
        period: float, tide: _Current, residual: _Current, residual_scale: float
    ) -> Sea: ...
    @staticmethod
    def gridded(
        period: float,
        axes: list[tuple[float, float, int]],
        tide_harmonics: int,
        coefficients: NDArray[np.complex128],
    ) -> Sea: ...
    @staticmethod
    def constituents(
        period: float,
        axes: list[tuple[float, float, int]],
        constituents: list[tuple[float, int]],
        coefficients: NDArray[np.complex128],
    ) -> Sea: ...
    @staticmethod
    def sum(seas: list[Sea]) -> Sea: ...
    def velocity(self, times: _Floats, positions: _Floats) -> _Floats: ...

@final
class Coast:
    @staticmethod
    def circle(center: tuple[float, float], radius: float, inside: bool) -> Coast: ...
    @staticmethod
    def polygons(rings: list[_Floats], inside: bool) -> Coast: ...
    def clearance(self, x: float, y: float) -> float: ...
    def clearances(self, positions: _Floats) -> _Floats: ...

@final
class Maps:
    def __new__(
        cls,
        x: tuple[float, float, int],
        y: tuple[float, float, int],
        times: _Floats,
        samples: _Floats,
        threads: int,
    ) -> Maps: ...
    def counts(self) -> tuple[_Counts, _Counts, _Counts, _Counts]: ...

@final
class Solver:
    @staticmethod
    def full(general: bool, rtol: float, atol: float, euler_step: float | None) -> Solver: ...
    @staticmethod
    def paper(
        order: int,
        window: float,
        wind_terms: bool,
        rtol: float,
        atol: float,
        euler_step: float | None,
    ) -> Solver: ...
    @staticmethod
    def mean_flow(order: int, rtol: float, atol: float, euler_step: float | None) -> Solver: ...
    def wind_needed(self, duration: float, period: float) -> tuple[float, float]: ...

@final
class Scenario:
    def __new__(
        cls,
        sea: Sea,
        coast: Coast | None,
        drag: float,
        duration: float,
        position: tuple[float, float],
        velocity: tuple[float, float],
    ) -> Scenario: ...
    def trajectory(self, wind: WindPath, solver: Solver, times: _Floats) -> list[_Floats]: ...
    def run(
        self,
        winds: tuple[WindGenerator, int]
        | tuple[WindGenerator, int, Particles]
        | list[WindPath]
        | WindPaths,
        solver: Solver,
        first: int,
        times: _Floats,
        keep: int,
        into: _Fates,
        threads: int,
        targets: Sequence[Coast],
        steps_per_tide: float | None = None,
        maps: Maps | None = None,
    ) -> str | None: ...

@final
class FieldWinds:
    def __new__(
        cls,
        axes: list[tuple[float, float, int]],
        patterns: _Floats,
        times: tuple[float, float],
        first: int,
        amplitudes: _Floats,
        small_scale: tuple[float, float, int, int] | None = None,
    ) -> FieldWinds: ...

_Winds = tuple[WindGenerator, int] | WindPath | list[WindPath] | WindPaths | FieldWinds

@final
class Fleet:
    def __new__(
        cls,
        sea: Sea,
        coast: Coast | None,
        latitude: float | None,
        end: float,
        first: int,
        times: _Floats,
        positions: _Floats,
        velocities: _Floats | None,
        bodies: _Floats,
        jibing_rate: float,
        seed: int,
    ) -> Fleet: ...
    def trajectory(self, winds: _Winds, solver: Solver, times: _Floats) -> list[_Floats]: ...
    def run(
        self,
        winds: _Winds,
        solver: Solver,
        first: int,
        times: _Floats,
        keep: int,
        into: _Fates,
        threads: int,
        targets: Sequence[Coast],
        maps: Maps | None = None,
    ) -> str | None: ...
