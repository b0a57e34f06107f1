"""Meshes of a URDF against which an arm is checked for collisions: what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from arms import robot

import pincal
from pincal import free_of_collision

ARM = """
j1 | revolute | 0 0 1 | 0 0 0.1
j2 | revolute | 0 1 0 | 0 0 0.2
"""
BOX = """
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


def stl(count: int, value: float = 1.0) -> bytes:
    """Return a binary STL of some triangles."""
    corners = np.zeros((count, 4, 3), dtype="<f4")
    corners[:, 1:] = np.eye(3) * value
    triangles = b"".join(one.tobytes() + b"\0\0" for one in corners)
    return b"\0" * 80 + count.to_bytes(4, "little") + triangles


BROKEN = {
    "empty.stl": (stl(0), "link.stl"),
    "nothing.stl": (b"", "link.stl"),
    "nan.stl": (stl(4, np.nan), "not finite"),
    "truncated.stl": (stl(8)[:-120], "link.stl"),
    "text.stl": (
        b"solid a\n facet normal 0 0 1\n outer loop\n vertex 0 0 0\n vertex 1 0 0\n"
        b" vertex 0 1 0\n endloop\n endfacet\n facet normal 0 0 1\n outer",
        "link.stl",
    ),
    "empty.obj": (b"", "link.obj"),
    "corners.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "link.obj"),
    "nan.obj": (BOX.replace("1", "nan", 1).encode(), "link.obj"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_mesh_is_refused_by_its_name(name: str, tmp_path: Path) -> None:
    """Empty, cut off, or with NaN: nothing is said to be free of it."""
    data, words = BROKEN[name]
    file = f"link{Path(name).suffix}"
    (tmp_path / file).write_bytes(data)
    mesh = f'<geometry><mesh filename="{file}"/></geometry>'
    link = f'<link name="l1"><collision>{mesh}</collision></link>'
    path = tmp_path / "arm.urdf"
    path.write_text(robot(ARM).replace('<link name="l1"/>', link), encoding="utf-8")
    with pytest.raises(pincal.FileError, match=words):
        free_of_collision(path, ["j1", "j2"], np.zeros((3, 2)))
