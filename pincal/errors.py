"""Errors that pincal raises on purpose: one root, each also the natural built-in."""


class PincalError(Exception):
    """Root of every error raised on purpose; its text says what, where, expected, what to do."""


class MechanismError(PincalError, ValueError):
    """A mechanism, leg, URDF or mechanism.yaml that cannot be used."""


class MeasurementError(PincalError, ValueError):
    """A table of poses, readings or measurements that cannot be used."""


class ObservabilityError(PincalError, ValueError):
    """Poses that leave a parameter, or a combination of parameters, undetermined."""


class WorkspaceError(PincalError, ValueError):
    """A workspace that is empty or cannot be sampled as asked."""


class SymmetryError(PincalError, ValueError):
    """A symmetry that the mechanism does not have."""


class FileError(PincalError, OSError):
    """A file or folder that cannot be read, or must not be overwritten."""
