"""Units of currents and transports as files spell them."""

from __future__ import annotations

import re

VELOCITIES = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3}
TRANSPORTS = {"m2/s": 1.0, "cm2/s": 1e-4}


def plain_unit(text: str) -> str:
    """Bring the spellings of a velocity or a transport to "m/s", "cm2/s", …."""
    text = re.sub(r"centi\s*", "c", text.strip().lower())
    text = re.sub(r"milli\s*", "m", text)
    text = re.sub(r"met(er|re)s?", "m", text)
    text = re.sub(r"sec(ond)?s?", "s", text)
    text = re.sub(r"\s*(/|\bper\b)\s*", "/", text)
    text = re.sub(r"[\s.^*()]", "", text)
    return re.sub(r"(?<!/)s-1$", "/s", text)
