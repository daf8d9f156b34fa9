"""NetCDF files opened by what they are, not by what libraries happen to be installed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from driftcore.errors import RecordError

if TYPE_CHECKING:
    import xarray as xr


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
    engine: Literal["scipy", "h5netcdf"] = "scipy" if magic[:3] == b"CDF" else "h5netcdf"
    if engine == "scipy":
        try:
            import scipy.io  # noqa: F401
        except ImportError:
            raise RecordError(
                f"source: {str(path)!r} is a NetCDF-3 file, which needs scipy: "
                'pip install "driftcore[geo]"; or convert it: nccopy -k nc4 in.nc out.nc'
            ) from None
    return xr.open_dataset(path, engine=engine, decode_times=decode_times)
