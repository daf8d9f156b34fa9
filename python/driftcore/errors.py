"""Exceptions and warnings of driftcore; their messages name the field, the value and what fits."""


class DriftCoreError(Exception):
    """Root of every error that driftcore raises on purpose."""


class ScenarioError(DriftCoreError, ValueError):
    """A configuration or an argument is not one that driftcore accepts."""


class RecordError(DriftCoreError, ValueError):
    """A record of wind or current cannot be read, or is not fit for what is asked of it."""


class OutputError(DriftCoreError, OSError):
    """A result cannot be written or read back."""


class DriftCoreWarning(UserWarning):
    """Something suspicious that does not stop the work."""
