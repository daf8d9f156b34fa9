"""Reading wind records: what is accepted, what is refused and how the refusal is worded."""

import gzip
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from driftcore.errors import DriftCoreError, DriftCoreWarning, RecordError
from driftcore.record import Gaps, Source, WindRecord, read_record


def table(start: str = "2001-05-20", rows: int = 80, step: str = "6h") -> pd.DataFrame:
    """A gentle wind on a regular UTC axis."""
    times = pd.date_range(start, periods=rows, freq=step, tz="UTC", name="time")
    k = np.arange(rows)
    return pd.DataFrame({"u10": 3 + np.sin(k / 5), "v10": np.cos(k / 7)}, index=times)


def dataset(frame: pd.DataFrame, **attrs: str) -> xr.Dataset:
    return xr.Dataset.from_dataframe(frame.tz_localize(None)).assign_attrs(attrs)


def same(left: WindRecord, right: WindRecord) -> bool:
    return left.sha256 == right.sha256 and left.step_h == right.step_h


# What is accepted


def test_every_source_gives_the_same_record(tmp_path: Path) -> None:
    frame = table()
    frame.to_csv(tmp_path / "wind.csv", date_format="%Y-%m-%dT%H:%M:%SZ")
    packed = tmp_path / "wind.csv.gz"
    packed.write_bytes(gzip.compress((tmp_path / "wind.csv").read_bytes()))
    dataset(frame).to_netcdf(tmp_path / "wind.nc", engine="h5netcdf")
    renamed = frame.rename(columns={"u10": "u", "v10": "v"})
    sources: list[Source] = [
        tmp_path / "wind.csv",
        str(packed),
        tmp_path / "wind.nc",
        frame.reset_index(),
        renamed,
        dataset(frame),
        dataset(frame).rename(time="valid_time"),
        dataset(frame).expand_dims(latitude=[47.4], longitude=[-3.1]),
    ]
    first = read_record(frame)
    assert np.array_equal(first.velocity, frame.to_numpy())
    assert np.array_equal(
        first.times, np.datetime64("2001-05-20", "s") + 6 * 3600 * np.arange(len(frame))
    )
    assert first.step_h == 6
    for source in sources:
        assert same(read_record(source), first)


def test_time_zones_are_converted_and_their_absence_means_utc() -> None:
    frame = table()
    paris = frame.tz_convert("Europe/Paris")
    naive = frame.tz_localize(None)
    assert same(read_record(paris), read_record(frame))
    assert same(read_record(naive), read_record(frame))
    shifted = naive.tz_localize("Etc/GMT-2")
    assert read_record(shifted).times[0] == np.datetime64("2001-05-19T22:00")


def test_times_stored_as_fractions_of_a_day_are_rounded_to_the_second() -> None:
    frame = table().tz_localize(None)
    frame.index = frame.index - pd.to_timedelta(np.arange(len(frame)) % 3, unit="us")
    assert same(read_record(frame), read_record(table()))


def test_the_original_cannot_change_the_record() -> None:
    frame = table()
    record = read_record(frame)
    frame.iloc[0] = 99.0
    assert record.velocity[0, 0] == 3.0
    with pytest.raises(ValueError, match="read-only"):
        record.velocity[0, 0] = 1.0


def test_label_and_synthetic_flag_come_from_attributes(tmp_path: Path) -> None:
    frame = table()
    assert read_record(frame).label == "wind record in memory"
    assert not read_record(frame).synthetic
    frame.attrs = {"wind_label": "toy climate", "wind_synthetic": 1}
    assert read_record(frame).label == "toy climate"
    assert read_record(frame).synthetic
    assert read_record(frame, label="mine").label == "mine"
    assert read_record(dataset(table(), wind_label="a point")).label == "a point"
    table().to_csv(tmp_path / "north.csv")
    from_file = read_record(tmp_path / "north.csv")
    assert from_file.label == "north.csv"
    assert from_file.source == str(tmp_path / "north.csv")


def test_description_is_one_line() -> None:
    record = read_record(table(), months=(6,), label="toy")
    assert record.describe() == (
        "toy: 32 rows every 6 h from 2001-06-01T00:00Z to 2001-06-08T18:00Z, months 6, 1 segment(s)"
    )


def test_digest_sees_values_and_times() -> None:
    first = read_record(table()).sha256
    louder = table()
    louder["v10"] += 1e-12 * (np.arange(len(louder)) == 7)
    assert read_record(louder).sha256 != first
    assert read_record(table(start="2001-05-21")).sha256 != first
    assert len(first) == 64


# Months and segments


def test_months_cut_the_record_into_seasons() -> None:
    frame = pd.concat([table(f"{year}-01-01", 365 * 4) for year in (2001, 2002, 2003)])
    record = read_record(frame, months=(8, 6, 7, 6))
    assert record.months == (6, 7, 8)
    assert len(record) == 3 * 92 * 4
    assert np.array_equal(np.bincount(record.segment), [368, 368, 368])
    assert np.array_equal(np.unique(record.season), [2001, 2002, 2003])
    pieces = read_record(frame, months=(2, 6))
    assert np.array_equal(np.bincount(pieces.segment), [112, 120] * 3)
    assert same(read_record(frame).select((6, 7, 8)), record)


def test_a_winter_is_one_season_across_the_new_year() -> None:
    record = read_record(table("2001-07-01", 4 * 700), months=(12, 1, 2))
    assert np.array_equal(np.bincount(record.segment), [360, 360])
    assert np.array_equal(record.season, 2001 + record.segment)


@pytest.mark.parametrize(
    "months", [(0,), (6, 13), (-1,), (), (6.5,), "678", 6, (6, None)], ids=repr
)
def test_months_that_do_not_exist(months: Any) -> None:
    with pytest.raises(RecordError, match=r"^months: .* is not accepted; .*1 to 12"):
        read_record(table(), months=months)


def test_months_that_leave_nothing() -> None:
    with pytest.raises(RecordError, match=r"months: \(11, 12\) leaves no row .* \(5, 6\)"):
        read_record(table(), months=(11, 12))


def test_a_gap_is_refused_or_becomes_a_segment() -> None:
    frame = table().drop(table().index[20:23])
    with pytest.raises(RecordError, match=r"gap of 24 h after row 19 \(2001-05-24T18:00Z\)"):
        read_record(frame)
    record = read_record(frame, gaps="segment")
    assert np.array_equal(np.bincount(record.segment), [20, 57])
    assert record.gaps == "segment"


def test_gaps_outside_the_months_do_not_matter() -> None:
    frame = table().drop(table().index[20:23])
    assert read_record(frame, months=(6,)).segment[-1] == 0
    summers_only = pd.concat([table("2001-06-01", 368), table("2002-06-01", 368)])
    assert read_record(summers_only, months=(6, 7, 8)).segment[-1] == 1
    with pytest.raises(RecordError, match=r"gap of .* name the months"):
        read_record(summers_only)


def test_a_gap_at_the_edge_of_the_months_does_not_join_seasons() -> None:
    frame = pd.concat([table("2001-06-01", 60), table("2001-06-20", 60)])
    assert np.array_equal(
        np.bincount(read_record(frame, months=(6,), gaps="segment").segment), [60, 44]
    )


# Few enough that 6 h stays the commonest step.
@given(dropped=st.sets(st.integers(1, 78), max_size=25))
def test_segments_hold_every_row_and_no_gap(dropped: set[int]) -> None:
    frame = table().drop(table().index[sorted(dropped)])
    record = read_record(frame, gaps="segment")
    assert len(record) == 80 - len(dropped)
    joined = np.diff(record.segment) == 0
    assert (np.diff(record.times)[joined] == np.timedelta64(6, "h")).all()
    runs = sum(k in dropped and k + 1 not in dropped for k in range(80))
    assert record.segment[-1] == runs


# What is refused


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"source: there is no file '.*absent\.csv'"):
        read_record(tmp_path / "absent.csv")
    with pytest.raises(RecordError, match="source: there is no file"):
        read_record(tmp_path)


def test_unreadable_files(tmp_path: Path) -> None:
    (tmp_path / "empty.csv").write_bytes(b"")
    (tmp_path / "binary.csv").write_bytes(bytes(range(128, 256)))
    (tmp_path / "ragged.csv").write_text("time,u10,v10\n1,2,3\n1,2,3,4,5\n")
    (tmp_path / "false.csv.gz").write_text("time,u10,v10\n")
    (tmp_path / "false.nc").write_text("time,u10,v10\n")
    for name in ("empty.csv", "binary.csv", "ragged.csv", "false.csv.gz", "false.nc"):
        with pytest.raises(RecordError, match=rf"source: '.*{name}' cannot be read"):
            read_record(tmp_path / name)


def test_other_sources() -> None:
    with pytest.raises(RecordError, match=r"source: ndarray is not accepted; use .* DataFrame"):
        read_record(np.zeros((5, 3)))  # type: ignore[arg-type]


def test_missing_columns_are_named(tmp_path: Path) -> None:
    frame = table().rename(columns={"v10": "north"})
    with pytest.raises(RecordError, match=r"columns: found 'u10', 'north'; .*'u10' and 'v10'"):
        read_record(frame)
    with pytest.raises(RecordError, match=r"^columns: found 'u10', 'north'"):
        read_record(dataset(frame))
    dataset(frame).to_netcdf(tmp_path / "wind.nc", engine="h5netcdf")
    with pytest.raises(RecordError, match=r"^columns: found 'u10', 'north'"):
        read_record(tmp_path / "wind.nc")


def test_a_dataset_of_more_than_one_point() -> None:
    grid = dataset(table()).expand_dims(latitude=[47.0, 47.5])
    with pytest.raises(RecordError, match=r"dimensions: .*'latitude': 2.*select one point"):
        read_record(grid)


def test_missing_time_axis() -> None:
    numbered = table().reset_index(drop=True)
    with pytest.raises(RecordError, match=r"time: the index \(there is no column 'time'"):
        read_record(numbered)
    numbered["time"] = np.arange(len(numbered))
    with pytest.raises(RecordError, match="time: the column 'time' holds numbers"):
        read_record(numbered)
    with pytest.raises(RecordError, match="time: the dataset has no dimension time or valid_time"):
        read_record(dataset(table()).isel(time=0))


@pytest.mark.parametrize("bad", ["yesterday", "01/06/1994 06:00", None, np.nan], ids=repr)
def test_times_that_are_not_dates(bad: Any) -> None:
    frame = table().reset_index()
    frame["time"] = [bad if k in (0, 5) else str(time) for k, time in enumerate(frame["time"])]
    with pytest.raises(RecordError, match=r"time: row 0 is .*, one of 2 .*1994-06-01T06:00:00Z"):
        read_record(frame)


def test_values_that_are_not_numbers() -> None:
    frame = table().astype(object)
    frame.iloc[4, 1] = "calm"
    with pytest.raises(RecordError, match=r"v10: .*'calm'; accepted are numbers in m/s"):
        read_record(frame)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite(bad: float) -> None:
    frame = table()
    frame.iloc[[11, 12, 40], 1] = bad
    expected = rf"v10: row 11 \(2001-05-22T18:00Z\) is {bad}, one of 3 row"
    with pytest.raises(RecordError, match=expected):
        read_record(frame)
    with pytest.raises(RecordError, match=expected):
        read_record(frame, gaps="segment")
    assert len(read_record(frame.drop(frame.index[[11, 12, 40]]), gaps="segment")) == 77


def test_values_outside_the_months_need_not_be_finite() -> None:
    frame = table()
    frame.iloc[11, 0] = np.nan
    assert len(read_record(frame, months=(6,))) == 32


def test_times_that_do_not_increase() -> None:
    frame = table()
    swapped = frame.iloc[[0, 1, 3, 2, *range(4, 80)]]
    expected = r"row 3 \(2001-05-20T12:00Z\) is earlier than the row before it \(2001-05-20T18:00Z"
    with pytest.raises(RecordError, match=expected):
        read_record(swapped)
    with pytest.raises(RecordError, match=r"row 6 \(2001-05-21T06:00Z\) repeats the row before it"):
        read_record(frame.iloc[[*range(6), 5, *range(6, 80)]])


def test_irregular_steps() -> None:
    frame = table()
    late = pd.concat([frame[:30], frame[30:].shift(freq="90min")])
    for gaps in get_args(Gaps):
        with pytest.raises(RecordError, match=r"irregular step of 7\.5 h after row 29"):
            read_record(late, gaps=gaps)


def test_steps_that_do_not_divide_the_day() -> None:
    with pytest.raises(RecordError, match="the step is 5 h; accepted are steps that divide 24 h"):
        read_record(table(step="5h"))
    with pytest.raises(RecordError, match="the step is 48 h"):
        read_record(table(step="48h"))


def test_a_single_row() -> None:
    with pytest.raises(RecordError, match=r"has 1 row\(s\); at least 2"):
        read_record(table(rows=1))


def test_unknown_way_to_meet_gaps() -> None:
    with pytest.raises(RecordError, match="gaps: 'bridge' is not accepted; use 'error', 'segment'"):
        read_record(table(), gaps="bridge")  # type: ignore[arg-type]


def test_record_errors_are_driftcore_errors_and_value_errors() -> None:
    assert issubclass(RecordError, DriftCoreError)
    assert issubclass(RecordError, ValueError)


# What is doubted


def test_stated_units_other_than_metres_per_second() -> None:
    data = dataset(table())
    for name in ("u10", "v10"):
        data[name].attrs["units"] = "m s**-1"
    read_record(data)
    data["v10"].attrs["units"] = "knots"
    with pytest.warns(DriftCoreWarning, match=r"v10 states units 'knots'; .* taken as m/s"):
        record = read_record(data)
    assert len(record) == 80


def test_fill_values_are_doubted() -> None:
    frame = table()
    frame.iloc[5, 0] = -9999.0
    with pytest.warns(DriftCoreWarning, match="a speed of 9999 looks like a missing value"):
        read_record(frame)


@pytest.mark.parametrize(
    ("mean", "spread"), [(13.0, 0.5), (9.0, 9.5)], ids=["mean too high", "storms too strong"]
)
def test_winds_like_knots_are_doubted(mean: float, spread: float) -> None:
    rows = 4000
    frame = table(rows=rows)
    frame["u10"] = mean + spread * np.random.default_rng(1).standard_normal(rows)
    with pytest.warns(DriftCoreWarning, match="look like knots"):
        read_record(frame)


def test_a_gale_of_some_days_is_believed() -> None:
    frame = table(rows=40)
    frame["u10"] = 20.0
    assert len(read_record(frame)) == 40  # a warning would be an error here


def test_the_real_record_is_believed_in_metres_per_second_only(belle_ile_csv: Path) -> None:
    record = read_record(belle_ile_csv, months=(6, 7, 8))
    assert len(record) == 2208
    assert np.array_equal(np.bincount(record.segment), [368] * 6)
    # data/README: mean and standard deviation of the six summers.
    assert np.allclose(record.velocity.mean(axis=0), [2.00, -1.24], atol=0.005)
    assert np.allclose(record.velocity.std(axis=0), [4.30, 3.23], atol=0.005)
    knots = pd.read_csv(belle_ile_csv)
    knots[["u10", "v10"]] *= 1.943844
    with pytest.warns(DriftCoreWarning, match="look like knots"):
        read_record(knots, months=(6, 7, 8))
