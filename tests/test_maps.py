"""Maps and targets: against a naive recount of kept trajectories, and whatever changes nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import driftcore as dc
from driftcore import _core
from driftcore.compiled import regular_times
from driftcore.errors import ScenarioError
from driftcore.maps import MapGrid
from driftcore.statistics import standard_error
from reference import Floats

# Regular, but not of a step that floats hold exactly; members leave it on all sides.
COLUMNS, ROWS = np.linspace(0.75, 1.23, 17), np.linspace(0.8, 1.27, 12)
TIMES = (0.0, 0.1237, 0.5, 0.9)
GRID = MapGrid(x=COLUMNS, y=ROWS, times=TIMES)  # type: ignore[arg-type]
SCENARIO = dc.paper.scenario(epsilon=1 / 30)
MODELS: list[dict[str, Any]] = [
    {"model": "mean-flow"},
    {"model": "mean-flow", "order": 2},
    {"model": "full"},
    {"model": "paper"},
]
TRIANGLE = [(1.05, 1.0), (1.2, 1.05), (1.05, 1.15)]


def crossed(a: Floats, b: Floats) -> set[tuple[int, int]]:
    """(row, column) of the cells on a line, from all its crossings of all lines of the grid."""
    origin = np.array([COLUMNS[0], ROWS[0]])
    size = np.array([COLUMNS[-1] - COLUMNS[0], ROWS[-1] - ROWS[0]]) / (16, 11)
    a, b = (a - origin) / size, (b - origin) / size
    cuts = [0.0, 1.0]
    for k, lines in enumerate((17, 12)):
        if a[k] != b[k]:
            cuts.extend((np.arange(lines) - a[k]) / (b[k] - a[k]))
    cuts = sorted(s for s in cuts if 0 <= s <= 1)
    middles = (np.array(cuts[:-1]) + cuts[1:]) / 2
    places = np.floor([a, b, *(a + s * (b - a) for s in middles)]).astype(int)
    return {(row, column) for column, row in places if 0 <= column < 16 and 0 <= row < 11}


def recount(fc: dc.Forecast) -> dict[str, Any]:
    """Counts of the kept trajectories, member by member; every one must be kept."""
    data = fc.dataset
    time = data["time"].values
    counts: dict[str, Any] = {name: np.zeros((4, 11, 16), int) for name in ("presence", "arrival")}
    counts |= {name: np.zeros(4, int) for name in ("outside", "ashore")}
    counts["visit"] = np.zeros((11, 16), int)
    for member in range(data.sizes["member"]):
        position = data["position"].values[member]
        stranding = data["stranding_time"].values[member]
        for k, t in enumerate(TIMES):
            at = position[np.searchsorted(time, t)]
            cells = [] if np.isnan(at[0]) else list(crossed(at, at))
            if stranding <= t:
                counts["ashore"][k] += 1
            elif cells:
                counts["presence"][k, *cells[0]] += 1
            else:
                counts["outside"][k] += 1
        adrift = np.isfinite(position[:, 0])
        stations = list(zip(time[adrift], position[adrift], strict=True))
        if np.isfinite(stranding):
            stations.append((stranding, data["stranding_position"].values[member]))
        been: set[tuple[int, int]] = set()
        before = stations[0][1] if stations else None
        for t, place in stations:
            interval = sum(end < t for end in TIMES)
            for cell in crossed(before, place) - been:
                counts["visit"][cell] += 1
                if interval < len(TIMES):
                    counts["arrival"][interval, *cell] += 1
            been |= crossed(before, place)
            before = place
    return counts


def mapped(wind: dc.LocalGridBootstrap, **how: Any) -> dc.Forecast:
    how = {"members": 120, "maps": GRID, "targets": {"harbour": TRIANGLE}} | how
    return dc.forecast(SCENARIO, wind, **how)


def counted(fc: dc.Forecast, name: str) -> Any:
    """The whole numbers behind a probability."""
    count = fc.dataset[name].values * fc.followed
    assert np.abs(count - np.round(count)).max() < 1e-9
    return np.round(count).astype(int)


@pytest.mark.parametrize("how", MODELS)
def test_maps_are_those_of_a_naive_recount(
    how: dict[str, Any], embedded_wind: dc.LocalGridBootstrap
) -> None:
    samples = np.union1d(regular_times(1.0, 1 / 240), TIMES)
    fc = mapped(embedded_wind, times=samples, **how)
    expected = recount(fc)
    assert expected["outside"].sum() > 0
    assert 0 < expected["ashore"][-1] < 120
    for name, counts in expected.items():
        assert np.array_equal(counted(fc, name), counts), name


def test_positions_kept_elsewhere_change_no_map(embedded_wind: dc.LocalGridBootstrap) -> None:
    every, none = mapped(embedded_wind), mapped(embedded_wind, keep=0, times=[0.3])
    for name in ("presence", "arrival", "visit", "outside", "ashore", "entry_time"):
        assert np.array_equal(every.dataset[name], none.dataset[name], equal_nan=True)


def test_maps_change_no_member(embedded_wind: dc.LocalGridBootstrap) -> None:
    with_maps, without = mapped(embedded_wind), mapped(embedded_wind, maps=None, targets=None)
    assert "presence" not in without.dataset
    assert "entry_time" not in without.dataset
    for name in without.dataset.variables:
        assert with_maps.dataset[name].equals(without.dataset[name]), name


@pytest.mark.parametrize("how", MODELS)
def test_threads_and_chunks_change_nothing(
    how: dict[str, Any], embedded_wind: dc.LocalGridBootstrap
) -> None:
    first = mapped(embedded_wind, members=90, threads=1, **how).dataset
    for work in ({"threads": 2}, {"threads": 3, "chunk": 7}, {"chunk": 33}):
        assert mapped(embedded_wind, members=90, **how, **work).dataset.equals(first)


def test_each_time_s_counts_sum_to_the_members(embedded_wind: dc.LocalGridBootstrap) -> None:
    fc = mapped(embedded_wind, members=500, keep=0)
    total = counted(fc, "presence").sum(axis=(1, 2)) + counted(fc, "outside")
    assert (total + counted(fc, "ashore")).tolist() == [500] * 4
    for k, t in enumerate(TIMES):
        assert counted(fc, "ashore")[k] == fc.stranding_probability(by=t).count
    # The release, and nobody anywhere twice.
    assert counted(fc, "presence")[0].max() == 500
    assert (counted(fc, "arrival").sum(axis=0) <= counted(fc, "visit")).all()
    assert counted(fc, "visit").max() == 500
    # Some come to cells after the last map.
    assert counted(fc, "arrival").sum() < counted(fc, "visit").sum()


def test_a_smaller_interval_finds_more_cells(embedded_wind: dc.LocalGridBootstrap) -> None:
    coarse, fine = (
        mapped(embedded_wind, model="full", maps=GRID.replace(interval=interval))
        for interval in (0.02, 0.0005)
    )
    assert np.array_equal(coarse.dataset["presence"], fine.dataset["presence"])
    assert counted(fine, "visit").sum() > counted(coarse, "visit").sum()


def test_members_that_leave_the_data_are_outside_and_failed_ones_are_not_counted() -> None:
    harmonic = dc.HarmonicSea(calm_sea())
    scenario = dc.Scenario(sea=harmonic, position=(1.0, 1.0), epsilon=1 / 20, coast=None)
    times = [-1.0, 2.0]
    winds = [dc.WindPath(times, np.full((2, 2), speed)) for speed in (0.0, 9.0)]
    grid = GRID.replace(x=np.linspace(0, 9, 10), y=np.linspace(0, 9, 10), times=[0.0, 1.0])
    for model in ("full", "mean-flow", "paper"):
        fc = dc.forecast(scenario, winds, model=model, maps=grid)
        assert fc.counts["left_domain"] == 1
        assert counted(fc, "presence").sum(axis=(1, 2)).tolist() == [2, 1]
        assert counted(fc, "outside").tolist() == [0, 1]


def test_before_its_release_a_member_is_outside(embedded_wind: dc.LocalGridBootstrap) -> None:
    """Through the core: three bodies released at different times, one of them a map time."""
    scenario, releases = SCENARIO, np.array([0.0, 0.5, 0.6])
    sea = scenario.sea.core(scenario.period, scenario.epsilon, 1.0)
    bodies = np.array([[1.0, 1.0, *[0.0] * 8]] * 3)
    fleet = _core.Fleet(
        sea, None, None, 1.0, 0, releases, np.ones((3, 2)), None, bodies, 0.0, seed=1
    )
    maps = GRID.core(np.union1d(regular_times(1.0, 1 / 240), TIMES), 2)
    entries = np.full((3, 1), np.nan)
    position = np.full((3, 2, 2), np.nan)
    around = _core.Coast.polygons([np.array([(0.9, 0.9), (1.1, 0.9), (1.0, 1.1)])], inside=False)
    failure = fleet.run(
        [dc.member_path(scenario, embedded_wind, k).core for k in range(3)],
        _core.Solver.full(True, 1e-6, 1e-6, None),
        0,
        np.array([0.2, 0.6]),
        3,
        (np.zeros(3, np.int8), np.full(3, np.nan), np.full((3, 2), np.nan), position, entries),
        2,
        [around],
        maps,
    )
    assert failure is None
    present, arrived, outside, _ = maps.counts()
    assert outside.tolist() == [2, 2, 1, 0]
    assert (present.reshape(4, -1).sum(axis=1) + outside).tolist() == [3] * 4
    assert arrived.reshape(5, 11, 16).sum(axis=0).max() == 3
    assert np.array_equal(entries[:, 0], releases)
    assert np.isfinite(position[..., 0]).tolist() == [[True, True], [False, True], [False, True]]


def calm_sea() -> Any:
    import xarray as xr

    space = np.linspace(0.0, 2.0, 5)
    coordinates = {"harmonic": [1], "component": ["x", "y"], "y": space, "x": space}
    values = np.zeros((1, 2, 5, 5), dtype=complex)
    return xr.DataArray(values, coordinates, ("harmonic", "component", "y", "x"))


# Targets


@pytest.mark.parametrize("how", MODELS)
def test_entries_are_first_crossings(
    how: dict[str, Any], embedded_wind: dc.LocalGridBootstrap
) -> None:
    """A coast of the same shape strands members where and when they would enter."""
    targets = {"harbour": TRIANGLE}
    fc = mapped(embedded_wind, **how)
    outside = SCENARIO.replace(coast=dc.Polygons(rings=(tuple(TRIANGLE),)), side="outside")
    stranded = dc.forecast(outside, embedded_wind, members=120, **how).dataset["stranding_time"]
    entered = fc.dataset["entry_time"].sel(target="harbour").values
    # Who strands on the circle first never enters.
    ashore = np.nan_to_num(fc.dataset["stranding_time"].values, nan=np.inf)
    first = np.where(stranded.values <= ashore, stranded.values, np.nan)
    assert np.isfinite(entered).sum() > 10
    assert np.array_equal(entered, first, equal_nan=True)
    p = fc.entry_probability("harbour")
    assert (p.count, p.members) == (np.isfinite(first).sum(), 120)
    assert fc.entry_probability("harbour", by=0.5).count == (first <= 0.5).sum()
    assert targets.keys() == set(fc.dataset["target"].values)


def test_targets_may_be_many_and_hold_the_release(embedded_wind: dc.LocalGridBootstrap) -> None:
    around = [(0.9, 0.9), (1.1, 0.9), (1.1, 1.1), (0.9, 1.1)]
    lake = dc.Polygons(rings=(tuple(around), ((0.95, 0.95), (1.05, 0.95), (1.05, 1.05))))
    far = [(5.0, 5.0), (6.0, 5.0), (6.0, 6.0)]
    targets = {"here": around, "far": np.array(far), "lake": lake, "harbour": TRIANGLE}
    fc = mapped(embedded_wind, maps=None, targets=targets)
    entries = fc.dataset["entry_time"]
    assert entries.dims == ("member", "target")
    assert entries["target"].values.tolist() == list(targets)
    assert (entries.sel(target="here") == 0).all()
    assert entries.sel(target="far").isnull().all()
    alone = mapped(embedded_wind).dataset["entry_time"]
    assert np.array_equal(entries.sel(target=["harbour"]), alone, equal_nan=True)
    with pytest.raises(ScenarioError, match="target: 'port' is not accepted; one of here, far"):
        fc.entry_probability("port")
    with pytest.raises(ScenarioError, match="run without any"):
        mapped(embedded_wind, targets=None, members=1).entry_probability("port")


class Region:
    """As other libraries hand over a polygon with a hole, and two polygons."""

    def __init__(self, kind: str) -> None:
        ring = [*TRIANGLE, TRIANGLE[0]]
        coordinates: Any = {"Polygon": [ring], "MultiPolygon": [[ring]], "Point": (0.0, 0.0)}
        self.__geo_interface__ = {"type": kind, "coordinates": coordinates[kind]}


def test_targets_of_other_libraries(embedded_wind: dc.LocalGridBootstrap) -> None:
    plain = mapped(embedded_wind, members=40).dataset["entry_time"]
    for kind in ("Polygon", "MultiPolygon"):
        found = mapped(embedded_wind, members=40, targets={"harbour": Region(kind)})
        assert np.array_equal(found.dataset["entry_time"], plain, equal_nan=True)
    with pytest.raises(ScenarioError, match=r"harbour: a Point is not accepted; give a polygon"):
        mapped(embedded_wind, targets={"harbour": Region("Point")})


# Datasets, files, configuration


def test_the_dataset_says_what_it_holds(
    embedded_wind: dc.LocalGridBootstrap, tmp_path: Path
) -> None:
    fc = mapped(embedded_wind)
    data = fc.dataset
    assert data["presence"].dims == data["arrival"].dims == ("map_time", "y", "x")
    assert data["visit"].dims == ("y", "x")
    assert all("long_name" in variable.attrs for variable in data.data_vars.values())
    for name in ("x", "y", "map_time"):
        low, high = data[data[name].attrs["bounds"]].values.T
        assert (low <= data[name].values).all()
        assert (data[name].values <= high).all()
        assert np.array_equal(low[1:], high[:-1])
    assert data["x_bounds"].values[0, 0] == COLUMNS[0]
    assert data["y_bounds"].values[-1, 1] == ROWS[-1]
    p = data["presence"].values
    for name in ("presence", "arrival", "visit", "outside", "ashore"):
        error = data[f"{name}_standard_error"]
        assert error.dims == data[name].dims
        assert error.values == pytest.approx(
            standard_error(120 * data[name].values, 120), abs=1e-15
        )
        assert (error.values > 0).all()
    error = data["presence_standard_error"].values
    binomial = np.sqrt(p * (1 - p) / 120)
    assert np.abs(error - binomial)[(p > 0.2) & (p < 0.8)].max() < 0.01
    fc.to_netcdf(tmp_path / "maps.nc")
    assert dc.open_forecast(tmp_path / "maps.nc").dataset.identical(data)


def test_the_configuration_repeats_the_run(embedded_wind: dc.LocalGridBootstrap) -> None:
    targets = {"harbour": TRIANGLE, "two words": dc.Polygons(rings=(tuple(TRIANGLE),))}
    fc = mapped(embedded_wind, members=30, targets=targets, maps=GRID.replace(interval=0.01))
    again = dc.run(dc.RunConfiguration.from_toml(fc.configuration()))
    assert again.dataset.equals(fc.dataset)


def test_targets_and_maps_from_toml() -> None:
    text = """
        [maps]
        x = [0, 1, 2]
        y = [0.0, 0.5]
        times = [0.5, 1]
        [targets]
        harbour = [[0, 0], [1, 0], [1, 1]]
        [targets.bay]
        rings = [[[0, 0], [1, 0], [1, 1]]]
    """
    run = dc.RunConfiguration.from_toml(text)
    assert run.maps == MapGrid(x=(0.0, 1.0, 2.0), y=(0.0, 0.5), times=(0.5, 1.0))
    assert run.targets["harbour"] == run.targets["bay"]
    assert dc.RunConfiguration.from_toml(run.to_toml()) == run


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"x": [0, 1, 3]}, "x: 3 edges from 0 to 3 are not accepted; they must be regular"),
        ({"y": [1, 0]}, "y: 2 edges from 1 to 0 are not accepted"),
        ({"x": [1]}, "x: "),
        ({"x": [0, np.nan]}, "x.1: "),
        ({"times": []}, "times: "),
        ({"times": [0.5, 0.5]}, "times: 2 times from 0.5 to 0.5 are not accepted; they must incr"),
        ({"times": [-0.1]}, "times: 1 times from -0.1"),
        ({"interval": 0}, "interval: 0 is not accepted"),
        (
            {"x": np.linspace(0, 1, 10001), "y": np.linspace(0, 1, 10001)},
            "4 maps of 10000 x 10000 cells are not accepted; they hold 4e\\+08 values, 3.2 GB",
        ),
    ],
)
def test_bad_maps_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=f"^{message}"):
        GRID.replace(**changes)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"maps": GRID.replace(times=[0.5, 1.1])}, r"maps.times: 1.1 is not accepted; .* \[0, 1\]"),
        ({"maps": GRID.replace(interval=1e-7)}, "maps.interval: 1e-07 is not accepted"),
        ({"targets": [TRIANGLE]}, "it should be a table of name = ring"),
        ({"targets": {"a": TRIANGLE[:2]}}, "a.rings.0: "),
        ({"targets": {"a": [TRIANGLE[0]] * 3}}, "targets.a: coast ring"),
        ({"maps": "everywhere"}, "maps: "),
    ],
)
def test_what_does_not_fit_the_run_is_refused(
    how: dict[str, Any], message: str, embedded_wind: dc.LocalGridBootstrap
) -> None:
    with pytest.raises(ScenarioError, match=message):
        mapped(embedded_wind, **how)
