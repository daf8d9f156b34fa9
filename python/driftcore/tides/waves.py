"""Tides by formula: waves on a plane sea, and an idealised Bay of Biscay."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore.earth import RADIUS_M
from driftcore.errors import ScenarioError
from driftcore.tides.atlas import TidalAtlas, atlas_of
from driftcore.tides.constituents import Complex, Float, checked_constituents, frequency_of

_EARTH_ROTATION = 7.292e-5  # rad/s
_GRAVITY = 9.81  # m/s²


def kelvin_wave(
    longitude: ArrayLike,
    latitude: ArrayLike,
    levels: Mapping[str, complex] | None = None,
    *,
    depth: float = 100.0,
    heading: float = 0.0,
    origin: tuple[float, float] | None = None,
) -> TidalAtlas:
    """Kelvin waves along a straight coast in a sea of one depth, equation (30).

    `η = a exp(−|f| n/c − i k s)`, `U = η √(g/H)` along the coast, `c = √(gH)`, `k = ω/c`; the
    coast is to the right of the wave in the northern hemisphere, behind it is land. Gill (1982),
    chapter 10.

    Parameters
    ----------
    longitude, latitude : array_like, shapes (m,) and (n,)
        Axes of the grid [degrees], regular and increasing.
    levels : mapping of str to complex, optional
        Level at the origin by constituent, amplitude · exp(−i · Greenwich lag) [m]; default: M2 of
        1 m and lag 0.
    depth : float
        Water depth [m].
    heading : float
        Where the wave runs to [degrees clockwise from north].
    origin : (longitude, latitude), optional
        A point of the coast [degrees], where the plane touches the globe; default: the middle of
        the grid.

    Raises
    ------
    ScenarioError
        An axis, a constituent or a number is not accepted.
    """
    plane = _Plane(longitude, latitude, levels, depth, heading, origin)
    offshore = plane.left * math.copysign(1, plane.rotation)
    decay = np.exp(-abs(plane.rotation) * offshore / plane.speed)
    return plane.atlas(
        lambda level, omega: (
            level * plane.ratio * decay * np.exp(-1j * omega / plane.speed * plane.along),
            0j * decay,
        ),
        offshore >= 0,
    )


def progressive_wave(
    longitude: ArrayLike,
    latitude: ArrayLike,
    levels: Mapping[str, complex] | None = None,
    *,
    depth: float = 100.0,
    heading: float = 0.0,
    origin: tuple[float, float] | None = None,
) -> TidalAtlas:
    """Plane waves on an open rotating sea of one depth (Sverdrup, Poincaré), equation (31).

    `η = a exp(−i k s)`, `U = η ω/(kH)` along and `i U f/ω` to the left of the heading, with
    `ω² = f² + gH k²`. Gill (1982), chapter 8; LeBlond & Mysak (1978), chapter 3. Parameters as in
    `kelvin_wave`.

    Raises
    ------
    ScenarioError
        As in `kelvin_wave`, and if a constituent is slower than the inertial frequency: it does
        not propagate.
    """
    plane = _Plane(longitude, latitude, levels, depth, heading, origin)

    def current(level: complex, omega: float) -> tuple[Complex, Complex]:
        if omega <= abs(plane.rotation):
            raise ScenarioError(
                f"levels: a constituent of {omega:.3g} rad/s does not propagate where the inertial "
                f"frequency is {abs(plane.rotation):.3g} rad/s; use a kelvin_wave"
            )
        k = math.sqrt(omega**2 - plane.rotation**2) / plane.speed
        along = level * omega / (k * plane.depth) * np.exp(-1j * k * plane.along)
        return along, 1j * plane.rotation / omega * along

    return plane.atlas(current)


def standing_wave(
    longitude: ArrayLike,
    latitude: ArrayLike,
    levels: Mapping[str, complex] | None = None,
    *,
    depth: float = 100.0,
    heading: float = 0.0,
    origin: tuple[float, float] | None = None,
) -> TidalAtlas:
    """Standing waves before a wall at the origin, without rotation, equation (32).

    `η = a cos ks`, `U = −i a √(g/H) sin ks` along the heading, `k = ω/√(gH)`: two waves that run
    against each other. Gill (1982), chapter 5. Parameters as in `kelvin_wave`; there is no land.

    Raises
    ------
    ScenarioError
        As in `kelvin_wave`.
    """
    plane = _Plane(longitude, latitude, levels, depth, heading, origin)
    return plane.atlas(
        lambda level, omega: (
            -1j * level * plane.ratio * np.sin(omega / plane.speed * plane.along),
            0j * plane.along,
        )
    )


def amphidrome(
    longitude: ArrayLike,
    latitude: ArrayLike,
    levels: Mapping[str, complex] | None = None,
    *,
    width: float,
    depth: float = 100.0,
    heading: float = 0.0,
    origin: tuple[float, float] | None = None,
) -> TidalAtlas:
    """Two Kelvin waves that pass each other in a channel, with amphidromic points, equation (33).

    `η = a [exp(−n/R − iks) + exp(−(b − n)/R + iks)]`, `U = √(g/H) a [exp(−n/R − iks) −
    exp(−(b − n)/R + iks)]`, `R = c/|f|`. Amphidromic points lie in the middle, `n = b/2`, where
    `cos ks = 0`. Taylor (1922), without the waves that reflection at a head of the channel adds;
    LeBlond & Mysak (1978), chapter 5. Parameters as in `kelvin_wave`; the origin is a point of the
    coast to the right of the heading, `width` that of the channel [m].

    Raises
    ------
    ScenarioError
        As in `kelvin_wave`.
    """
    _positive("width", width)
    plane = _Plane(longitude, latitude, levels, depth, heading, origin)
    across = plane.left * math.copysign(1, plane.rotation)
    radius = plane.speed / abs(plane.rotation)

    def current(level: complex, omega: float) -> tuple[Complex, Complex]:
        phase = 1j * omega / plane.speed * plane.along
        there = np.exp(-across / radius - phase)
        back = np.exp(-(width - across) / radius + phase)
        return level * plane.ratio * (there - back), 0 * phase

    return plane.atlas(current, (across >= 0) & (across <= width))


class _Plane:
    """A grid on the plane that touches the globe at the origin, and what waves on it share."""

    def __init__(
        self,
        longitude: ArrayLike,
        latitude: ArrayLike,
        levels: Mapping[str, complex] | None,
        depth: float,
        heading: float,
        origin: tuple[float, float] | None,
    ) -> None:
        _positive("depth", depth)
        self.longitude = np.asarray(longitude, dtype=float)
        self.latitude = np.asarray(latitude, dtype=float)
        self.levels = {"M2": 1.0} if levels is None else dict(levels)
        self.depth = depth
        self.speed = math.sqrt(_GRAVITY * depth)
        self.ratio = math.sqrt(_GRAVITY / depth)
        for name, axis in (("longitude", self.longitude), ("latitude", self.latitude)):
            if axis.ndim != 1 or not axis.size:
                raise ScenarioError(f"{name}: shape {axis.shape} is not accepted; give an axis")
        middle = origin or (self.longitude.mean(), self.latitude.mean())
        self.rotation = 2 * _EARTH_ROTATION * math.sin(math.radians(middle[1]))
        if self.rotation == 0:
            raise ScenarioError("origin: the equator is not accepted, the wave needs rotation")
        x = _metres(self.longitude - middle[0]) * math.cos(math.radians(middle[1]))
        y = _metres(self.latitude - middle[1])[:, None]
        self.ahead = np.array([math.sin(math.radians(heading)), math.cos(math.radians(heading))])
        self.along = self.ahead[0] * x + self.ahead[1] * y
        self.left = -self.ahead[1] * x + self.ahead[0] * y

    def atlas(
        self,
        current: Callable[[complex, float], tuple[Complex, Complex]],
        sea: NDArray[np.bool_] | None = None,
    ) -> TidalAtlas:
        """Atlas of the current along the heading and to its left that belongs to each level."""
        names = checked_constituents(self.levels)
        pairs = zip(self.levels.values(), frequency_of(names), strict=True)
        along, left = (np.array(part) for part in zip(*(current(*p) for p in pairs), strict=True))
        land = False if sea is None else ~sea
        return atlas_of(
            names,
            self.longitude,
            self.latitude,
            np.where(land, np.nan, self.ahead[0] * along - self.ahead[1] * left),
            np.where(land, np.nan, self.ahead[1] * along + self.ahead[0] * left),
        )


def _metres(degrees: Float) -> Float:
    return np.asarray(RADIUS_M * np.radians(degrees))


def _positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0):
        raise ScenarioError(f"{name}: {value!r} is not accepted; give a number of metres above 0")


# Level at Belle-Île: amplitude [m] and Greenwich phase lag [degrees].
_BISCAY_LEVELS = {"M2": (1.60, 99.0), "S2": (0.59, 132.0), "N2": (0.33, 80.0)}
_BELLE_ILE_LATITUDE = 47.3
_SHELF_DEPTH, _OCEAN_DEPTH = 110.0, 4500.0  # m
_SLOPE_WIDTH, _COAST_WIDTH = 20e3, 20e3  # m


def biscay(step: float = 0.125) -> TidalAtlas:
    """Return an idealised tide of the Bay of Biscay: M2, S2 and N2, 10° W to 0°, 43 to 50° N.

    **This is no tide atlas.** It is a formula, equation (34), whose currents have realistic sizes
    and phases for examples and trials: do not forecast a real drift with it. A Kelvin wave of the
    deep ocean runs northward along a smooth coast (roughly the French one) over a shelf (roughly
    its own: 60 km wide in the south, 200 km in the north, 110 m deep), and the shelf is filled and
    emptied from the ocean, which sets its currents (Clarke & Battisti 1981; for this shelf Le Cann
    1990). Those of M2 are 5–8 cm/s in the deep ocean and 0.1–0.24 m/s on the outer shelf; levels
    at Belle-Île are 1.60 m (M2), 0.59 m (S2) and 0.33 m (N2), from a hindcast. The field is
    smooth and goes on over the land, so that any coast can be laid over it. Neither the Spanish
    coast nor the Channel is in it.

    Parameters
    ----------
    step : float
        Spacing of the grid [degrees], 0.1 to 0.25 (the edge of the shelf is 20 km wide).

    Raises
    ------
    ScenarioError
        The step is outside 0.1 to 0.25, or does not divide 7° and 10°.
    """
    rows, columns = round(7 / step) if step else 0, round(10 / step) if step else 0
    if not (
        0.1 <= step <= 0.25 and math.isclose(rows * step, 7) and math.isclose(columns * step, 10)
    ):
        raise ScenarioError(
            f"step: {step!r} is not accepted; it is 0.1 to 0.25 and divides 1, such as 0.125"
        )
    longitude = np.linspace(-10, 0, columns + 1)
    latitude = np.linspace(43, 50, rows + 1)
    y = latitude[:, None]
    coast = -1.2 - 1.9 * (1 + np.tanh(y - 47.2))
    shelf = 60e3 + 70e3 * (1 + np.tanh((y - 45.3) / 0.7))
    west = _metres(coast - longitude) * np.cos(np.radians(y))
    # The distance from the coast, smoothly zero behind it.
    offshore = (west + np.hypot(west, _COAST_WIDTH)) / 2
    # Share of the water column that is not there, 1 − H/H₀, and its integral from the coast.
    steepness = (offshore - shelf) / _SLOPE_WIDTH
    missing = (1 - _SHELF_DEPTH / _OCEAN_DEPTH) * (1 - np.tanh(steepness)) / 2
    filled = (
        (1 - _SHELF_DEPTH / _OCEAN_DEPTH)
        / 2
        * (offshore - _SLOPE_WIDTH * np.log(np.cosh(steepness) / np.cosh(shelf / _SLOPE_WIDTH)))
    )
    speed = math.sqrt(_GRAVITY * _OCEAN_DEPTH)
    rotation = 2 * _EARTH_ROTATION * math.sin(math.radians(_BELLE_ILE_LATITUDE))
    names = list(_BISCAY_LEVELS)
    u, v = [], []
    for name, omega in zip(names, frequency_of(names), strict=True):
        amplitude, lag = _BISCAY_LEVELS[name]
        level = amplitude * np.exp(
            -1j * math.radians(lag)
            - rotation * offshore / speed
            - 1j * omega / speed * _metres(y - _BELLE_ILE_LATITUDE)
        )
        u.append(1j * omega * level * filled / (_OCEAN_DEPTH * (1 - missing)))
        v.append(level * math.sqrt(_GRAVITY / _OCEAN_DEPTH))
    return atlas_of(names, longitude, latitude, np.array(u), np.array(v))
