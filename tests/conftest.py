"""What the tests share: hypothesis profiles, the embedded wind and the real wind record."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

import driftcore as dc
from driftcore.climate import synthetic_record

# The gate gives the same verdict twice; the slow profile looks elsewhere each time.
settings.register_profile("fast", max_examples=25, deadline=None, derandomize=True)
settings.register_profile("slow", max_examples=200, deadline=None)
settings.load_profile(os.environ.get("DRIFTCORE_HYPOTHESIS", "fast"))

_WIND = Path(__file__).parents[2] / "shared/data/wind"


@pytest.fixture(scope="session")
def belle_ile_csv() -> Path:
    """Six years of 6-hourly wind at Belle-Île, which its licence keeps out of the repository."""
    path = _WIND / "wind_resourcecode_belleile_6h_1994_1999.csv"
    if not path.is_file():
        pytest.skip(f"the Belle-Île record is not at {path}")
    return path


@pytest.fixture(scope="session")
def embedded_wind() -> dc.LocalGridBootstrap:
    """The embedded synthetic climate, fitted."""
    return dc.paper.default_wind()


@pytest.fixture(scope="session")
def small_wind() -> dc.LocalGridBootstrap:
    """A wind of few summers and a given bandwidth, fitted at once: for figures and files."""
    return dc.LocalGridBootstrap.fit(synthetic_record(3), h=0.3)
