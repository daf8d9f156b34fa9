"""NetCDF files opened by what they are, not by what libraries happen to be installed."""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from driftcore.errors import RecordError

if TYPE_CHECKING:
    import xarray as xr


# Files up to this size [bytes] are searched for heaps that HDF5 would read for ever.
_SCANNED = 2**28
_HEAP = b"GCOL\x01"


def refuse_endless(path: Path) -> None:
    """Refuse a damaged HDF5 file that the library would read for ever, if it is of usual size.

    It walks through a global heap by the sizes of what is in it, and free space may have size 0.
    The layout is that of the HDF5 file format specification 3.0, section III.E.

    Raises
    ------
    RecordError
        A heap has no end.
    """
    if not 0 < path.stat().st_size <= _SCANNED:
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        heap = data.find(_HEAP)
        while 0 <= heap <= len(data) - 16:
            at, end = heap + 16, heap + struct.unpack_from("<Q", data, heap + 8)[0]
            while at + 16 <= min(end, len(data)):
                index, size = struct.unpack_from("<H6xQ", data, at)
                step = (16 + (size + 7) // 8 * 8 if index else size) % 2**64
                if step == 0:
                    raise RecordError(f"source: {str(path)!r} is damaged: a heap in it has no end")
                at += step
            heap = data.find(_HEAP, heap + 4)


def coder_of_times() -> xr.coders.CFDatetimeCoder:
    """Give what decodes times in microseconds; nanoseconds would wrap far ones around."""
    import xarray as xr

    return xr.coders.CFDatetimeCoder(time_unit="us")


def open_netcdf(path: Path, *, decode_times: bool = True) -> xr.Dataset:
    """Open a file lazily: NetCDF-4 by h5netcdf, NetCDF-3 by scipy.

    Raises
    ------
    RecordError
        It is no file, or of a kind that is not read; the message says what to run first. What the
        libraries answer to a damaged file is theirs: see `driftcore.errors.reading`.
    """
    import xarray as xr

    if not path.is_file():
        kind = "a folder" if path.is_dir() else "no file"
        raise RecordError(
            f"source: {str(path)!r} is {kind}; give NetCDF files, or open the data with xarray "
            "and give the dataset"
        )
    with path.open("rb") as file:
        magic = file.read(8)
    if magic[:4] == b"GRIB":
        raise RecordError(
            f"source: {str(path)!r} is a GRIB file; convert it first: cdo -f nc4 copy in.grib "
            "out.nc"
        )
    if magic[:4] == b"CDF\x05":
        raise RecordError(
            f"source: {str(path)!r} is a NetCDF file of type CDF-5; convert it first: "
            "nccopy -k nc4 in.nc out.nc"
        )
    if magic[:4] == b"\x89HDF":
        refuse_endless(path)
    engine: Literal["scipy", "h5netcdf"] = "scipy" if magic[:3] == b"CDF" else "h5netcdf"
    if engine == "scipy":
        try:
            import scipy.io  # noqa: F401
        except ImportError:
            raise RecordError(
                f"source: {str(path)!r} is a NetCDF-3 file, which needs scipy: "
                'pip install "driftcore[geo]"; or convert it: nccopy -k nc4 in.nc out.nc'
            ) from None
    times = coder_of_times() if decode_times else False
    return xr.open_dataset(path, engine=engine, decode_times=times)
