"""A measured number beside what is required of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self


@dataclass(frozen=True)
class Check:
    """A measured number beside the range that it must lie in.

    Attributes
    ----------
    name : str
        What was measured, in words.
    measured : float
        The number; one that is not a number does not pass.
    high, low : float
        Greatest and least value accepted.
    """

    name: str
    measured: float
    high: float
    low: float = 0.0

    @classmethod
    def within(cls, name: str, measured: float, limit: float) -> Self:
        """Require of a number that has a sign that its magnitude is at most `limit`."""
        return cls(name, measured, limit, -limit)

    @property
    def passed(self) -> bool:
        """Whether the number lies in the range."""
        return self.low <= self.measured <= self.high

    @property
    def required(self) -> str:
        """The range in words."""
        if self.low:
            return f"{self.low:.5g} to {self.high:.5g}"
        return f"≤ {self.high:.4g}"
