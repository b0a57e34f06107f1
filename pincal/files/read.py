"""What people hand over: an object, or the name, file or DataFrame that it is read from."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from scipy.spatial.transform import RigidTransform

from pincal.errors import MeasurementError
from pincal.files.measurements import read_measurements, read_poses
from pincal.files.table import is_dataframe
from pincal.files.yaml import read_setup
from pincal.model.checks import array_of, must_be
from pincal.model.measurements import Measurements, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Setup


def as_plan(source: Any, mechanism: Mechanism, *, partial: bool = False) -> Plan:
    """Return a plan that is given as such, as poses, by a CSV file, or as a DataFrame.

    Args:
        source: A ``Plan``; poses, coordinates of shape (N, dof) or a ``RigidTransform``; a path;
            or a pandas DataFrame.
        mechanism: The mechanism.
        partial: Whether columns or cells of the pose may be missing in a table.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: something else, or a column or cell that is wrong.
    """
    if isinstance(source, Plan):
        return source
    if isinstance(source, RigidTransform):
        return Plan(mechanism.platform.coordinates_of(source))
    if isinstance(source, str | Path) or is_dataframe(source):
        return read_poses(source, mechanism, partial=partial)
    dof = mechanism.platform.dof
    return Plan(array_of(source, ("N", dof), "poses, a plan or its file", MeasurementError))


def as_measurements(
    source: Any,
    mechanism: Mechanism,
    setup: Setup | None = None,
    *,
    partial: bool = False,
    influences: Collection[str] | None = (),
) -> Measurements:
    """Return measurements that are given as such, by a CSV file, or as a DataFrame.

    Args:
        source: ``Measurements``, a path, or a pandas DataFrame.
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
    if not isinstance(source, Measurements):
        kinds = (Measurements, str, Path)
        if not is_dataframe(source):
            must_be(source, kinds, "measurements, their CSV file or DataFrame", MeasurementError)
        return read_measurements(source, mechanism, setup, partial=partial, influences=influences)
    for name, count in (
        ("poses", mechanism.platform.dof),
        ("readings", len(mechanism.reading_names)),
    ):
        purpose = f"{name} of {mechanism.name!r}"
        array_of(getattr(source, name), ("N", count), purpose, MeasurementError)
    return source


def as_setup(source: Setup | str | Path | None) -> Setup:
    """Return a setup that is given as such or by its file; without one, the default.

    Raises:
        FileError: the file is missing or cannot be read.
        MeasurementError: something else, or a file that does not say what it should.
    """
    if source is None or isinstance(source, Setup):
        return source or Setup()
    return read_setup(must_be(source, (Setup, str, Path), "a setup or its file", MeasurementError))


def as_noise(noise: Noise | None) -> Noise:
    """Return the noise that is given; without one, the default.

    Raises:
        MeasurementError: something else.
    """
    if noise is None:
        return Noise()
    return must_be(noise, (Noise,), "noise, pincal.Noise(…)", MeasurementError)
