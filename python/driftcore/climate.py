"""The embedded synthetic climate: a wind record for those who have none yet.

It stands in for a real record in demonstrations and tests, and says so wherever it is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from driftcore.errors import ScenarioError

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

LABEL = "synthetic climate (VAR fitted to Belle-Île summers 1994–1999)"

# Source of every figure below: 10 m wind at Belle-Île (47.43 N, 3.07 W), 6-hourly, June to August
# 1994-1999, of Ifremer's RESOURCECODE hindcast (forced by ERA5): six summers, 2,208 rows. Mean
# day, then least squares for the anomalies; order 2 has the least BIC of orders 1 to 8.

# Mean wind toward east and north [m/s] at 00, 06, 12 and 18 UTC: the sea breeze of the afternoon.
MEAN_DAY = np.array([[1.242, -1.992], [0.7120, -1.612], [2.311, -0.01504], [3.751, -1.347]])
# Anomaly [m/s] from those 6 h and 12 h before.
LAG_1 = np.array([[0.8328, 0.2483], [-0.09482, 0.8595]])
LAG_2 = np.array([[-0.01992, -0.1058], [0.09570, -0.03662]])
# Covariance of what they leave unexplained [m²/s²].
INNOVATION = np.array([[4.470, 0.3358], [0.3358, 3.199]])

_STEP_H = 6
_STEPS_OF_SUMMER = 92 * 24 // _STEP_H
# The largest root of the autoregression is 0.859: 100 steps forget all but 3e-7 of a start.
_STEPS_TO_FORGET = 100
_FIRST_YEAR = 2001


def synthetic_record(years: int = 20, seed: int = 1) -> pd.DataFrame:
    """Simulate summers of a Gaussian vector autoregression of order 2 around a mean day.

    The mean over all summers is that of the source; each summer has its own. Moments, memory and
    sea breeze are those of the summers at Belle-Île; the wind rose is smoother than the real one,
    and calms and strong winds are a little more frequent.

    Parameters
    ----------
    years : int
        Number of summers (June to August), 1 to 200; their calendar years, from 2001 on, are
        names only.
    seed : int
        From 0 to 2³² - 1. The values are the same on every machine.

    Returns
    -------
    pandas.DataFrame
        Columns `u10`, `v10` [m/s, toward east and north, to 0.01], every 6 h on a UTC index
        `time`; `attrs` carry `wind_label` and `wind_synthetic`, which `read_record` honours.

    Raises
    ------
    ScenarioError
        If `years` or `seed` is out of its range.
    """
    import pandas as pd

    if years not in range(1, 201):
        raise ScenarioError(f"years: {years!r} is not accepted; use a whole number from 1 to 200")
    if seed not in range(2**32):
        raise ScenarioError(f"seed: {seed!r} is not accepted; use a whole number below 2³²")
    summers = _anomalies(years, seed) + np.tile(MEAN_DAY, (_STEPS_OF_SUMMER // 4, 1))
    times = [
        pd.date_range(f"{year}-06-01", periods=_STEPS_OF_SUMMER, freq=f"{_STEP_H}h", tz="UTC")
        for year in range(_FIRST_YEAR, _FIRST_YEAR + years)
    ]
    table = pd.DataFrame(
        # Rounded, because the last bits of logarithms and sums depend on the machine.
        np.round(summers.reshape(-1, 2), 2),
        index=times[0].append(times[1:]).rename("time"),
        columns=["u10", "v10"],
    )
    table.attrs = {"wind_label": LABEL, "wind_synthetic": 1}
    return table


def _anomalies(years: int, seed: int) -> NDArray[np.float64]:
    """Stationary summers of the autoregression, zero on average [m/s], (years, steps, 2)."""
    # The legacy generator is frozen: Generator's normals may change from one NumPy to the next.
    random = np.random.RandomState(seed)
    steps = _STEPS_TO_FORGET + _STEPS_OF_SUMMER
    shocks = random.standard_normal((years, steps, 2)) @ np.linalg.cholesky(INNOVATION).T
    anomaly = np.zeros((years, steps, 2))  # zero also before the first step, at index -1 and -2
    for k in range(steps):
        anomaly[:, k] = shocks[:, k] + anomaly[:, k - 1] @ LAG_1.T + anomaly[:, k - 2] @ LAG_2.T
    stationary: NDArray[np.float64] = anomaly[:, _STEPS_TO_FORGET:]
    # Twenty summers alone leave a chance mean of 0.2 m/s, which decides where things strand.
    stationary -= stationary.mean(axis=(0, 1))
    return stationary
