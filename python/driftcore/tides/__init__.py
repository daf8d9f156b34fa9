"""Tidal currents by constituent: read from an atlas, fitted to a current, or analytic.

One convention holds everywhere (docs/equations.md (26)): the current toward east or north at the
time `t` is

`Σ_k Re[f_k(t) c_k exp(i(V_k(t) + u_k(t)))]`, `c_k = A_k exp(−i G_k)`,

with the amplitude `A_k`, the Greenwich phase lag `G_k`, the equilibrium argument `V_k` at
Greenwich, and the nodal factor `f_k` and angle `u_k`. Arguments and nodal corrections are those of
pyTMD, after Schureman (1958) as the FES atlases use them.
"""

from driftcore.tides.atlas import TidalAtlas
from driftcore.tides.harmonic import TidalFit, fit
from driftcore.tides.reading import from_atlas
from driftcore.tides.waves import (
    amphidrome,
    biscay,
    kelvin_wave,
    progressive_wave,
    standing_wave,
)

__all__ = [
    "TidalAtlas",
    "TidalFit",
    "amphidrome",
    "biscay",
    "fit",
    "from_atlas",
    "kelvin_wave",
    "progressive_wave",
    "standing_wave",
]
