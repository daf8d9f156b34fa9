"""What would have been forecast in the past, and what came: probabilities to be verified."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from driftcore.errors import RecordError, ScenarioError
from driftcore.forecast import forecast
from driftcore.hand_over import HandOver
from driftcore.record import WindRecord, phase_of_day
from driftcore.scenario import Polygons, Scenario
from driftcore.wind import LocalGridBootstrap, WindPaths

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Floats = NDArray[np.float64]
Issue = Callable[[LocalGridBootstrap, WindRecord, int, int, int, int], Floats]
"""(climate, record, row of the release, members, steps, seed) -> winds (members, steps, 2) [m/s]"""


def leave_one_season_out(
    record: WindRecord, **options: Any
) -> Iterator[tuple[WindRecord, LocalGridBootstrap]]:
    """Each season of a record, and the bootstrap fitted to the others.

    Parameters
    ----------
    record : WindRecord
        Of at least 2 seasons.
    options
        Of `LocalGridBootstrap.fit`.

    Raises
    ------
    RecordError
        If there is a single season.
    """
    seasons = np.unique(record.season)
    if len(seasons) < 2:
        raise RecordError(f"record: a single season is not accepted ({record.describe()})")
    for season in seasons:
        left_out = record.season == season
        others = record._keep(~left_out)
        yield record._keep(left_out), LocalGridBootstrap.fit(others, None, **options)


def from_present(
    climate: LocalGridBootstrap, record: WindRecord, row: int, members: int, steps: int, seed: int
) -> Floats:
    """Winds that go on from the wind of the record at its row, and just before it."""
    known = table(record, slice(row - climate.order, row + 1))
    _, wind = HandOver(known, climate, skill=1).sample(members, climate.order + steps, seed)
    return wind[:, climate.order :]


def from_climate(
    climate: LocalGridBootstrap, record: WindRecord, row: int, members: int, steps: int, seed: int
) -> Floats:
    """Winds of the climate alone from the row of a record, which must be a midnight."""
    phase = phase_of_day(climate.record, record.times[row])
    wind: Floats = climate.core.sample(members, steps, seed, phase=phase)[0]
    return wind


def hindcast(
    scenarios: Sequence[Scenario],
    record: WindRecord,
    climate: LocalGridBootstrap,
    *,
    issue: Issue = from_present,
    every_days: int = 3,
    members: int = 500,
    targets: Mapping[str, ArrayLike | Polygons] | None = None,
    times: ArrayLike | None = None,
    seed: int = 1,
) -> xr.Dataset:
    """Forecast from many midnights of a record, and follow the same bodies under its own wind.

    Parameters
    ----------
    scenarios : sequence of Scenario
        Bodies that begin at each of those midnights: of one length and one set of units.
    record : WindRecord
        What came. The climate must not know it: see `leave_one_season_out`.
    climate : LocalGridBootstrap
        Its small scale is left out, as the record has none.
    issue : callable
        What is known at the release: `from_present`, `from_climate` or one's own.
    every_days : int
        Days between releases; the first is a day after the beginning of each segment.
    members : int
        Of each forecast.
    targets : mapping, optional
        As in `driftcore.forecast`.
    times : array_like, optional
        Times at which positions and winds are kept [scenario time], the wind at the nearest step
        of the record; default none.
    seed : int
        Of the first forecast; each has its own.

    Returns
    -------
    xarray.Dataset
        `stranding_time` and `stranding_position` by (scenario, release, member), with targets
        `entry_time`, with times `position` and `wind` [m/s]; the same of what came, without
        members, as `observed_…`; `season(release)`. Times of what never came are infinite.

    Raises
    ------
    RecordError
        If no segment of the record is as long as a run.
    ScenarioError
        If the scenarios differ in length or units, or an argument is not accepted.
    """
    import xarray as xr

    first = scenarios[0]
    if any(
        (s.hours_per_unit, s.duration, s.wind_unit)
        != (first.hours_per_unit, first.duration, first.wind_unit)
        for s in scenarios
    ):
        raise ScenarioError("scenarios: different lengths or units are not accepted")
    step = record.step_h / first.hours_per_unit
    steps = int(np.ceil(first.duration / step - 1e-9)) + 1
    rows = _releases(record, steps, every_days)
    knots = np.arange(steps) * step
    instants = np.empty(0) if times is None else np.asarray(times, dtype=float)

    names = ["stranding_time", "stranding_position"]
    names += ["entry_time"] if targets else []
    names += [] if times is None else ["position"]

    def followed(wind: Floats) -> xr.Dataset:
        """Follow all releases at once, (releases, members, steps, 2)."""
        paths = WindPaths(knots, wind.reshape(-1, steps, 2) / first.wind_unit)
        keep, at = (0, None) if times is None else (len(paths), instants)
        runs = [forecast(s, paths, keep=keep, targets=targets, times=at).dataset for s in scenarios]
        found = xr.concat([run[names] for run in runs], "scenario").drop_vars("member")
        for name in names:  # NaN is what never came
            values = (
                found[name].to_numpy().reshape(len(runs), *wind.shape[:2], *found[name].shape[2:])
            )
            dims = ("scenario", "release", "ensemble", *found[name].dims[2:])
            late = np.where(np.isnan(values), np.inf, values) if name.endswith("_time") else values
            found[name] = (dims, late)
        if times is not None:
            steps_kept = np.round(instants / step).astype(int)
            found["wind"] = (("release", "ensemble", "time", "component"), wind[:, :, steps_kept])
        return found.rename(ensemble="member")

    issued = [issue(climate, record, int(k), members, steps, seed + int(k)) for k in rows]
    found = followed(np.stack(issued))
    came = followed(np.stack([record.velocity[k : k + steps] for k in rows])[:, None])
    for name, values in came.isel(member=0).items():
        found[f"observed_{name}"] = values
    found.attrs = {"members": members, "wind_label": record.label}
    return found.assign_coords(
        release=record.times[rows].astype("datetime64[ns]"),
        season=("release", record.season[rows]),
    )


def events(
    hindcasts: xr.Dataset, by: Sequence[float], sectors: int, center: tuple[float, float]
) -> xr.Dataset:
    """Probabilities of events in hindcasts, and whether they happened.

    Parameters
    ----------
    hindcasts : xarray.Dataset
        As `hindcast` gives them.
    by : sequence of float
        Times by which to have stranded, and to have entered each target.
    sectors : int
        Equal sectors as seen from `center`, the first one centred on north, in which to strand.
    center : (x, y)

    Returns
    -------
    xarray.Dataset
        `probability` and `happened` of shape (scenario, release, event), `season(release)`.
    """
    import xarray as xr

    def of(prefix: str) -> xr.DataArray:
        stranded = hindcasts[f"{prefix}stranding_time"]
        found = {f"stranded by {t:g}": stranded <= t for t in by}
        place = hindcasts[f"{prefix}stranding_position"] - np.array(center)
        bearing = np.degrees(np.arctan2(place.isel(component=0), place.isel(component=1)))
        sector = np.round(bearing / (360 / sectors)) % sectors  # NaN of those afloat
        for k in range(sectors):
            found[f"stranded toward {k * 360 / sectors:g}°"] = sector == k
        if "entry_time" in hindcasts:
            entry = hindcasts[f"{prefix}entry_time"]
            for target in entry["target"].values:
                for t in by:
                    found[f"entered {target} by {t:g}"] = entry.sel(target=target, drop=True) <= t
        return xr.concat(list(found.values()), "event").assign_coords(event=list(found))

    order = ("scenario", "release", "event")
    return xr.Dataset(
        {
            "probability": of("").mean("member").transpose(*order),
            "happened": of("observed_").transpose(*order),
        }
    )


def table(record: WindRecord, rows: slice) -> pd.DataFrame:
    """Rows of a record as a forecast that `HandOver` reads."""
    import pandas as pd

    return pd.DataFrame(
        record.velocity[rows], columns=["u10", "v10"], index=pd.DatetimeIndex(record.times[rows])
    )


def _releases(record: WindRecord, steps: int, every_days: int) -> NDArray[np.int64]:
    """Rows of midnights that have a day before them and a run after them in their segment."""
    per_day = round(24 / record.step_h)
    if every_days < 1:
        raise ScenarioError(f"every_days: {every_days!r} is not accepted; at least 1")
    found = []
    for segment in np.unique(record.segment):
        rows = np.flatnonzero(record.segment == segment)
        midnight = record.times[rows] == record.times[rows].astype("datetime64[D]")
        usable = midnight & (rows >= rows[0] + per_day) & (rows + steps - 1 <= rows[-1])
        found.append(rows[usable][::every_days])
    releases = np.concatenate(found)
    if not len(releases):
        raise RecordError(f"record: no segment is as long as a day and a run ({record.describe()})")
    return releases
