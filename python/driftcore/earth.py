"""The sphere that distances are measured on."""

import math

RADIUS_M = 6_371_008.8
"""Mean radius of the earth [m], as in rust/src/geometry.rs."""
KM_PER_DEGREE = math.radians(1) * RADIUS_M / 1e3
"""A degree of a great circle."""
