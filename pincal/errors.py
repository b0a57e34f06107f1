"""Errors that pincal raises on purpose: one root, each also the natural built-in.

``docs/errors.md`` is made of their docstrings, which say what causes them and what to do.
"""

from __future__ import annotations

import re

_LONG_VALUE = re.compile(r"(?<!\w)(['\"])(?:(?!\1).){200,}\1|\S{300,}", re.DOTALL)
_LONGEST = 1500  # characters of a message


class PincalError(Exception):
    """Root of every error raised on purpose; its text says what, where, expected, what to do.

    Causes: those of its kinds. Raised itself it is a fault of pincal, found before anything was
    written.

    What to do: read the message. ``except pincal.PincalError`` catches all of them.

    Example:
        >>> import pincal
        >>> try:
        ...     pincal.load_mechanism("9RRR")
        ... except pincal.PincalError as error:
        ...     print(type(error).__name__)
        FileError
    """

    def __init__(self, message: str = "") -> None:
        """Take a message, long values in it and what is beyond 1,500 characters cut out."""
        message = _LONG_VALUE.sub(lambda value: f"{value[0][:100]}…{value[0][-20:]}", message)
        if len(message) > _LONGEST:
            message = f"{message[: _LONGEST - 300]} … {message[-290:]}"
        super().__init__(message)


class MechanismError(PincalError, ValueError):
    """A mechanism, leg, URDF or mechanism.yaml that cannot be used.

    Causes: a file that says something else than it should, or that disagrees with another one;
    numbers that are none, or above 1e12; poses or parameters of a wrong shape; a leg that does
    not close at home. So too a printer's configuration that is not of a delta.

    What to do: correct the place that the message names (file and line, or leg and joint);
    ``pincal check`` says whether all is well. docs/mechanism_files.md says what files may hold.

    Example:
        >>> import pincal
        >>> try:
        ...     pincal.new_mechanism("hexapod", base_radius=-1.0)
        ... except pincal.MechanismError:
        ...     print("a length is above zero")
        a length is above zero
    """


class MeasurementError(PincalError, ValueError):
    """A table of poses, readings or measurements that cannot be used.

    Causes: a column that is missing, has no unit or the wrong one; a cell that is no number; rows
    that cannot have been measured on this mechanism (units, signs, legs exchanged); noise, a
    setup or a choice of what was measured that does not fit the columns.

    What to do: correct the line and column that the message names. Where it says what would
    explain the measurements, look at the machine and the tracker before the numbers.
    docs/measuring.md says what tables may hold.

    Example:
        >>> import pincal
        >>> try:
        ...     pincal.Noise(position=-1.0)
        ... except pincal.MeasurementError:
        ...     print("a standard deviation is not negative")
        a standard deviation is not negative
    """


class MisfitError(MeasurementError):
    """Measurements that no mechanism like the nominal one can have made.

    Causes: a wrong unit, sign, order, frame or mechanism; logs out of step; single bad rows.

    What to do: what the message names; or let ``pincal doctor`` try all of it and print the
    command that works.
    """


class ObservabilityError(PincalError, ValueError):
    """Poses that leave a parameter, or a combination of parameters, undetermined.

    Causes: too few poses, or poses too much alike; parameters that no pose can distinguish by
    what is measured.

    What to do: choose poses by ``pincal select``, ask ``pincal identifiability`` what they
    determine, measure more of the pose, or fix, tie or give a prior to a parameter that the
    message names.

    Example:
        >>> import pincal
        >>> candidates = pincal.sample_workspace("5R", 50, seed=0)
        >>> try:
        ...     pincal.select_poses("5R", candidates, 2)
        ... except pincal.ObservabilityError as error:
        ...     print(str(error).partition(";")[0])
        2 poses give 2 equations for the 6 parameters of leg_1
    """


class WorkspaceError(PincalError, ValueError):
    """A workspace that is empty or cannot be sampled as asked.

    Causes: margins or joint limits that no pose keeps; axes, steps or orientations that the
    platform does not have; a home pose that is singular.

    What to do: lower the margins or the count, correct the axis that the message names, or widen
    the joint limits in the URDFs if the machine has others.

    Example:
        >>> import pincal
        >>> try:
        ...     pincal.Grid.of("x=1:0:0.1", "y=0:1:0.1")
        ... except pincal.WorkspaceError:
        ...     print("an axis ends behind its start")
        an axis ends behind its start
    """


class SymmetryError(PincalError, ValueError):
    """A symmetry that the mechanism does not have.

    Causes: selecting by symmetry, or generating legs, where geometry, limits, working modes or
    sensors break it.

    What to do: ``pincal symmetry`` says what breaks it and by how much; mend that, or choose
    poses for each leg alone.

    Example:
        >>> import pincal
        >>> robot = pincal.load_mechanism("5R")
        >>> robot = robot.with_parameters({"leg_1.l": 1.1 * dict(robot.legs[0].parameters)["l"]})
        >>> try:
        ...     pincal.symmetry_group(robot).carriers()
        ... except pincal.SymmetryError:
        ...     print("these legs differ")
        these legs differ
    """


class FileError(PincalError, OSError):
    """A file or folder that cannot be read, or must not be overwritten.

    Causes: it is not there, is something else (a folder, a device), may not be read or written;
    the disk is full; or it exists and was not to be replaced.

    What to do: correct the name or its rights, or say ``--force`` (``force=True``) to replace a
    file, or a folder that pincal wrote.

    Example:
        >>> import pincal
        >>> try:
        ...     pincal.load_result("nowhere")
        ... except pincal.FileError as error:
        ...     print("cannot read" in str(error))
        True
    """
