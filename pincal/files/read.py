"""What people hand over: an object, or the name, file or DataFrame that it is read from."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from scipy.spatial.transform import RigidTransform

from pincal.errors import MeasurementError
from pincal.files.measurements import read_measurements, read_poses
from pincal.files.table import is_dataframe
from pincal.model.checks import array_of, must_be
from pincal.model.measurements import Measurements, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Setup


def as_plan(given: Any, mechanism: Mechanism, *, partial: bool = False) -> Plan:
    """Return a plan that is given as such, as poses, by a CSV file, or as a DataFrame.

    Args:
        given: A ``Plan``; poses, coordinates of shape (N, dof) or a ``RigidTransform``; a path;
            or a pandas DataFrame.
        mechanism: The mechanism.
        partial: Whether columns or cells of the pose may be missing in a table.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: something else, or a column or cell that is wrong.
    """
    if isinstance(given, Plan):
        return given
    if isinstance(given, RigidTransform):
        return Plan(mechanism.platform.coordinates_of(given))
    if isinstance(given, str | Path) or is_dataframe(given):
        return read_poses(given, mechanism, partial=partial)
    dof = mechanism.platform.dof
    return Plan(array_of(given, ("N", dof), "poses, a plan or its file", MeasurementError))


def as_measurements(
    given: Any,
    mechanism: Mechanism,
    setup: Setup | None = None,
    *,
    partial: bool = False,
    influences: Collection[str] | None = (),
) -> Measurements:
    """Return measurements that are given as such, by a CSV file, or as a DataFrame.

    Args:
        given: ``Measurements``, a path, or a pandas DataFrame.
        mechanism: The mechanism.
        setup: What else was measured than the platform's pose.
        partial: Whether columns or cells of the pose may be missing.
        influences: Further columns to read, those that no term depends on yet; None for all
            columns of numbers.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: something else, numbers of another mechanism, or a column or cell that
            is wrong.
    """
    if not isinstance(given, Measurements):
        kinds = (Measurements, str, Path)
        if not is_dataframe(given):
            must_be(given, kinds, "measurements, their CSV file or DataFrame", MeasurementError)
        return read_measurements(given, mechanism, setup, partial=partial, influences=influences)
    for name, count in (
        ("poses", mechanism.platform.dof),
        ("readings", len(mechanism.reading_names)),
    ):
        what = f"{name} of {mechanism.name!r}"
        array_of(getattr(given, name), ("N", count), what, MeasurementError)
    return given


def as_setup(given: Setup | str | Path | None) -> Setup:
    """Return a setup that is given as such or by its file; without one, the default.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: something else, or a file that does not say what it should.
    """
    if given is None or isinstance(given, Setup):
        return given or Setup()
    from pincal.files.yaml import read_setup  # reads files: slow to load

    return read_setup(must_be(given, (Setup, str, Path), "a setup or its file", MeasurementError))


def as_noise(given: Noise | None) -> Noise:
    """Return the noise that is given; without one, the default.

    Raises:
        MeasurementError: something else.
    """
    if given is None:
        return Noise()
    return must_be(given, (Noise,), "noise, pincal.Noise(…)", MeasurementError)
