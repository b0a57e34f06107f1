"""Kinematics as a controller has them: the Python file run, the C header compiled."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pincal.formats.deployed import Deployed, c_header, python_file

Kinematics = tuple[Callable[..., Any], Callable[..., Any]]
"""Inverse and forward kinematics of one row: values, joints, and whether there is a solution."""
_GLUE = """
#include "m.h"
int inverse(const double *T, const double *i, const double *n, double *r, double *j) {
    return m_inverse(T, i, n, r, j);
}
int forward(const double *r, const double *i, double *T, double *j) {
    return m_forward(r, i, NULL, NULL, T, j);
}
"""


def in_python(deployed: Deployed) -> Kinematics:
    """Return the kinematics of the Python file."""
    names: dict[str, Any] = {}
    exec(compile(python_file(deployed), "kinematics.py", "exec"), names)

    def inverse(T: np.ndarray, influences: Any, near: Any) -> tuple[Any, Any, bool]:
        solution = names["inverse"](T.tolist(), influences, near)
        return solution.values, solution.joints, not solution.reason

    def forward(readings: np.ndarray, influences: Any) -> tuple[Any, Any, bool]:
        solution = names["forward"](readings.tolist(), influences)
        return solution.values, solution.joints, not solution.reason

    return inverse, forward


def in_c(deployed: Deployed, folder: Path) -> Kinematics:
    """Return the kinematics of the C header, compiled without a warning."""
    (folder / "m.h").write_text(c_header(deployed, "m"))
    (folder / "m.c").write_text(_GLUE)
    strict = ("-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC")
    subprocess.run(["cc", *strict, "-o", folder / "m.so", folder / "m.c", "-lm"], check=True)
    library = ctypes.CDLL(str(folder / "m.so"))
    machine = deployed.mechanism
    n, m = len(machine.reading_names), sum(len(leg.moving) for leg in machine.legs)

    def given(values: Any) -> Any:
        """Return numbers, or lists of them, one after the other; NULL for none."""
        if values is None:
            return None
        numbers = [float(value) for part in values for value in np.ravel(part)]
        return (ctypes.c_double * max(1, len(numbers)))(*numbers)

    def inverse(T: np.ndarray, influences: Any, near: Any) -> tuple[Any, Any, bool]:
        readings, joints = (ctypes.c_double * n)(), (ctypes.c_double * m)()
        lost = library.inverse(given(T), given(influences), given(near), readings, joints)
        return list(readings), list(joints), not lost

    def forward(readings: np.ndarray, influences: Any) -> tuple[Any, Any, bool]:
        T, joints = (ctypes.c_double * 12)(), (ctypes.c_double * m)()
        lost = library.forward(given(readings), given(influences), T, joints)
        return list(T), list(joints), not lost

    return inverse, forward
