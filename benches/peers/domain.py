"""The nearest same work by domain peers and by driftcore: further jobs of `worker.py`.

OpenDrift, Parcels and a loop in NumPy move particles for `setting` steps of 15 minutes, by RK4 in
the paper's tide, which they get as hourly fields on 101 × 101 points, and by 3 % of a uniform
hourly wind. At the paper's scale, 3 m/s and 625 h, the map is 42° wide and high at the equator.

driftcore follows members over the paper's whole run of 26 days instead, each under an hourly wind
of its own, which is in memory or is drawn; its bodies have inertia. It averages the tide
(mean-flow, order 1), or resolves it, in the paper's fields or in a grid of harmonics. Where there
is a coast it says which strand where and when, and follows them no further: its second answer is
the share of the run that members were adrift.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import datetime, timedelta
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from solvers import EPSILON, sea

if TYPE_CHECKING:
    from solvers import Job, Peer

HOURS = 12.5 / EPSILON  # the run, 26 days: one unit of time
UNIT = 3.0 * 3600 * HOURS  # one unit of length [m]
DEGREE = 6_366_707.0 * math.pi / 180  # 60 nautical miles [m]
WINDAGE = 0.03
FULL_STEPS = 5  # a tide: what the first table needs for its error
STEP = 900.0  # [s]
POINTS = 101
RELEASE = datetime(2024, 6, 1)

GRID = np.linspace(0.65, 1.35, POINTS)  # x and y
DEGREES = (GRID - 1) * UNIT / DEGREE  # longitude and latitude


def hourly_current() -> Any:
    """Give the current (component, hour, latitude, longitude) [m/s], in single precision."""
    hours = np.arange(math.ceil(HOURS) + 2)[:, None, None]
    return (3.0 * sea(hours / HOURS, GRID[None, None, :], GRID[None, :, None])).astype(np.float32)


def hourly_wind() -> Any:
    """Give a uniform wind (component, hour) [m/s]: a breeze that turns once in four days."""
    angle = 2 * np.pi * np.arange(math.ceil(HOURS) + 2) / 96
    return np.stack([5 * np.cos(angle), 5 * np.sin(angle)])


def releases(count: int) -> Any:
    """Give longitudes and latitudes (2, count) scattered around the middle of the map."""
    return np.random.default_rng(1).uniform(-0.2, 0.2, (2, count))


def numpy_loop(folder: str) -> Peer:
    """Give a plain loop over the steps, all particles at once."""
    del folder

    def peer(members: int, setting: Any) -> Job:
        fields, wind, places = hourly_current(), hourly_wind(), releases(members)
        spacing = DEGREES[1] - DEGREES[0]

        def current(hour: float, at: Any) -> Any:
            index = (at - DEGREES[0]) / spacing
            cell = index.astype(int)
            (i, j), (a, b), k = cell, index - cell, int(hour)
            below, above = (
                (1 - b) * ((1 - a) * f[:, j, i] + a * f[:, j, i + 1])
                + b * ((1 - a) * f[:, j + 1, i] + a * f[:, j + 1, i + 1])
                for f in (fields[:, k], fields[:, k + 1])
            )
            velocity = below + (hour - k) * (above - below)
            return in_degrees(velocity, at)

        def in_degrees(velocity: Any, at: Any) -> Any:
            return velocity / DEGREE / np.stack([np.cos(np.radians(at[1])), np.ones_like(at[1])])

        def job() -> Any:
            at, step = places.copy(), STEP / 3600
            for k in range(setting):
                hour = k * step
                k1 = current(hour, at)
                k2 = current(hour + step / 2, at + STEP / 2 * k1)
                k3 = current(hour + step / 2, at + STEP / 2 * k2)
                k4 = current(hour + step, at + STEP * k3)
                part = hour - int(hour)
                breeze = (1 - part) * wind[:, int(hour)] + part * wind[:, int(hour) + 1]
                drift = in_degrees(np.repeat(WINDAGE * breeze[:, None], members, axis=1), at)
                at = at + STEP * ((k1 + 2 * (k2 + k3) + k4) / 6 + drift)
            return at.T.tolist(), None

        return job

    return peer


def dataset(fields: dict[str, tuple[str, Any]], degrees: Any, latitude: str, longitude: str) -> Any:
    """Give named hourly fields (standard name, values) as an xarray dataset of CF conventions."""
    import xarray as xr

    count = len(next(iter(fields.values()))[1])
    times = np.datetime64(RELEASE, "ns") + np.arange(count) * np.timedelta64(1, "h")
    return xr.Dataset(
        {
            name: (("time", latitude, longitude), values, {"standard_name": standard})
            for name, (standard, values) in fields.items()
        },
        {
            "time": ("time", times, {"standard_name": "time", "axis": "T"}),
            latitude: (
                latitude,
                degrees,
                {"standard_name": "latitude", "units": "degrees_north", "axis": "Y"},
            ),
            longitude: (
                longitude,
                degrees,
                {"standard_name": "longitude", "units": "degrees_east", "axis": "X"},
            ),
        },
    )


def datasets(names: tuple[str, str, str, str], latitude: str, longitude: str) -> tuple[Any, Any]:
    """Give the current, and the wind on the four corners of the map."""
    corners = np.ones((1, 2, 2), dtype=np.float32)
    values = [*hourly_current(), *(w[:, None, None] * corners for w in hourly_wind())]
    standard = [f"{d}ward_{m}" for m in ("sea_water_velocity", "wind") for d in ("east", "north")]
    if names[0].startswith("x_"):
        standard = list(names)
    fields = dict(zip(names, zip(standard, values, strict=True), strict=True))
    current = {name: fields[name] for name in names[:2]}
    wind = {name: fields[name] for name in names[2:]}
    return (
        dataset(current, DEGREES, latitude, longitude),
        dataset(wind, DEGREES[[0, -1]], latitude, longitude),
    )


def opendrift(folder: str) -> Peer:
    """OpenDrift's `OceanDrift`, scheme runge-kutta4, no land, no mixing, nothing written."""
    del folder
    from opendrift.models.oceandrift import OceanDrift
    from opendrift.readers.reader_netCDF_CF_generic import Reader

    names = ("x_sea_water_velocity", "y_sea_water_velocity", "x_wind", "y_wind")
    readers = [
        Reader(ds, name=name)
        for ds, name in zip(datasets(names, "lat", "lon"), ("current", "wind"), strict=True)
    ]

    def peer(members: int, setting: Any) -> Job:
        model = OceanDrift(loglevel=50)
        model.set_config("general:use_auto_landmask", False)
        model.set_config("environment:fallback:land_binary_mask", 0)
        model.set_config("drift:advection_scheme", "runge-kutta4")
        model.set_config("drift:vertical_mixing", False)
        model.set_config("drift:vertical_advection", False)
        model.set_config("drift:stokes_drift", False)
        model.add_reader(readers)
        longitude, latitude = releases(members)
        model.seed_elements(
            lon=longitude, lat=latitude, time=RELEASE, wind_drift_factor=WINDAGE, z=0
        )

        def job() -> Any:
            length = timedelta(seconds=STEP * setting)
            step = timedelta(seconds=STEP)
            model.run(duration=length, time_step=step, time_step_output=length)
            return np.stack([model.elements.lon, model.elements.lat], axis=-1).tolist(), None

        return job

    return peer


def parcels(folder: str) -> Peer:
    """Parcels 4: `AdvectionRK4` and a kernel of the windage, nothing written."""
    del folder
    import parcels

    def windage(particles: Any, fieldset: Any) -> None:
        u, v = fieldset.UV10[particles]
        particles.dx += WINDAGE * u * particles.dt
        particles.dy += WINDAGE * v * particles.dt

    current, wind = datasets(("U", "V", "U10", "V10"), "lat", "lon")
    convert = parcels.convert.copernicusmarine_to_sgrid
    read = partial(parcels.FieldSet.from_sgrid_conventions, mesh="spherical")
    fieldset = read(convert(fields={n: current[n] for n in ("U", "V")}))
    fieldset += read(
        convert(fields={n: wind[n] for n in ("U10", "V10")}),
        vector_fields={"UV10": ("U10", "V10")},
    )

    def peer(members: int, setting: Any) -> Job:
        longitude, latitude = releases(members)
        start = np.full(members, np.datetime64(RELEASE, "ns"))
        particles = parcels.ParticleSet(
            fieldset, x=longitude, y=latitude, z=np.zeros(members), t=start
        )

        def job() -> Any:
            particles.execute(
                [parcels.kernels.AdvectionRK4, windage],
                dt=np.timedelta64(int(STEP), "s"),
                runtime=np.timedelta64(int(STEP * setting), "s"),
                verbose_progress=False,
            )
            return np.stack([particles.x, particles.y], axis=-1).tolist(), None

        return job

    return peer


def harmonic_sea() -> Any:
    """Give the paper's sea by its harmonics on the same map."""
    import xarray as xr

    import driftcore as dc

    times = np.linspace(0, 1, 25)
    x, y = GRID[None, None, :], GRID[None, :, None]
    a = (2 + np.sin(6 * np.pi * times))[:, None, None] * x + 0 * y
    b = (2 + np.cos(6 * np.pi * times))[:, None, None] * y + 0 * x
    zero = np.zeros_like(a)
    tide = -1j * np.array([[a, a / 2], [a / 4, zero]])
    residual = -1j * np.array([[zero, zero], [b, b]])

    def field(values: Any, first: int) -> Any:
        axes = {"time": times, "y": GRID, "x": GRID}
        order = {"harmonic": first + np.arange(len(values)), "component": ["x", "y"]}
        return xr.DataArray(values, {**order, **axes}, ("harmonic", "component", *axes))

    return dc.HarmonicSea(field(tide, 1), field(residual, 0))


def driftcore_scenario(gridded: bool) -> Any:
    """Give the paper's case, or the same with its sea on the grid, whose splines are set-up."""
    import driftcore as dc

    scenario = dc.paper.scenario(EPSILON)
    if not gridded:
        return scenario
    sea = harmonic_sea()
    compiled = sea.core(scenario.period, scenario.epsilon, scenario.duration)
    sea.core = lambda *_: compiled
    return scenario.model_copy(update={"sea": sea})


def share_adrift(forecast: Any) -> float:
    """Give the mean share of the run that members were followed: to the end, or aground."""
    ends = forecast.dataset["stranding_time"].values
    if (forecast.dataset["status"].values > 1).any():
        raise ValueError("members left the map or failed")
    return float(np.where(np.isnan(ends), 1.0, ends).mean())


def drawn(model: str, gridded: bool, folder: str) -> Peer:
    """`driftcore.forecast` of the paper's case: winds drawn, strandings counted."""
    del folder
    import driftcore as dc

    scenario, climate = driftcore_scenario(gridded), dc.paper.default_wind()

    def peer(members: int, setting: Any) -> Job:
        del setting

        def job() -> Any:
            found = dc.forecast(scenario, climate, model=model, members=members, threads=1, keep=0)
            return [], share_adrift(found)

        return job

    return peer


def in_memory(model: str, gridded: bool, folder: str) -> Peer:
    """Give the same under hourly winds in memory, and the last places.

    Without a coast in the paper's fields, as the others. A map ends: there the coast is kept.
    """
    del folder
    import driftcore as dc

    scenario = driftcore_scenario(gridded)
    if not gridded:
        scenario = scenario.replace(coast=None)
    steps = FULL_STEPS if model == "full" else None
    hours = math.ceil(HOURS) + 1

    def peer(members: int, setting: Any) -> Job:
        del setting
        velocity = dc.paper.default_wind().sample(members, hours, 1) / scenario.wind_unit
        winds = dc.WindPaths(np.arange(hours) / HOURS, velocity)
        options: dict[str, Any] = {"times": [scenario.duration], "keep": members, "threads": 1}

        def job() -> Any:
            found = dc.forecast(scenario, winds, model=model, steps_per_tide=steps, **options)
            return found.dataset["position"].values[:, 0].tolist(), share_adrift(found)

        return job

    return peer


PEERS: dict[str, Callable[[str], Peer]] = {
    "driftcore": partial(in_memory, "mean-flow", False),
    "driftcore-full": partial(in_memory, "full", False),
    "driftcore-gridded": partial(in_memory, "mean-flow", True),
    "driftcore-full-gridded": partial(in_memory, "full", True),
    "driftcore-drawn": partial(drawn, "mean-flow", False),
    "driftcore-full-drawn": partial(drawn, "full", False),
    "driftcore-gridded-drawn": partial(drawn, "mean-flow", True),
    "driftcore-full-gridded-drawn": partial(drawn, "full", True),
    "numpy": numpy_loop,
    "parcels": parcels,
    "opendrift": opendrift,
}
