"""Meshes of a URDF as an arm's links: where they are, how coarse, what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from arms import ARMS, loaded, robot, urdf
from command_line import run

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
VISUAL = (
    '<link name="l1"><visual><origin xyz="0 0 0.05"/><geometry>'
    '<mesh filename="package://own/meshes/link.obj" scale="0.1 0.1 0.2"/>'
    "</geometry></visual></link>"
)


@pytest.fixture
def made(tmp_path: Path) -> Path:
    """A URDF of two joints in a package, with a mesh for the link between them."""
    (tmp_path / "own" / "meshes").mkdir(parents=True)
    (tmp_path / "own" / "meshes" / "link.obj").write_text(BOX, encoding="utf-8")
    path = tmp_path / "own" / "arm.urdf"
    path.write_text(robot(ARM).replace('<link name="l1"/>', VISUAL), encoding="utf-8")
    return path


def test_a_mesh_moves_with_the_link_behind_its_joint(made: Path) -> None:
    """Its corners are the file's, scaled, shifted by the visual's origin, on the joint's link."""
    mechanism = pincal.Mechanism.from_urdf(made, "l2")
    view = pincal.view(mechanism).with_meshes(made)
    body = view.scene.body
    (shape,) = list(body.parts.values())[body.chains[0][0]]
    assert shape.points is not None
    assert shape.faces is not None
    corners = shape.points @ shape.T_link_shape[:3, :3].T + shape.T_link_shape[:3, 3]
    expected = [[0, 0, 0.05], [0.1, 0, 0.05], [0, 0.1, 0.05], [0, 0, 0.25]]
    assert sorted(map(tuple, corners.round(9))) == sorted(map(tuple, expected))
    assert len(shape.faces) == 4
    assert "link.obj" not in view.html()


def test_meshes_are_made_coarser_and_stay_where_they_are(made: Path) -> None:
    """A ball of 20,000 triangles becomes one of 3,000 or fewer, within a cell of the same place."""
    u, v = np.meshgrid(np.linspace(0, np.pi, 101), np.linspace(0, 2 * np.pi, 101), indexing="ij")
    corners = np.stack((np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)), -1).reshape(-1, 3)
    i = (np.arange(100)[:, None] * 101 + np.arange(100)).ravel()
    faces = np.concatenate(
        (np.stack((i, i + 1, i + 101), 1), np.stack((i + 1, i + 102, i + 101), 1))
    )
    view = pincal.view(pincal.Mechanism.from_urdf(made, "l2"))

    def seen(count: int) -> np.ndarray:
        """Return the corners of triangles, shape (n, 3, 3), of so many as they are drawn."""
        ball = trimesh.Trimesh(corners, faces[:count], process=False)
        ball.export(made.parent / "meshes" / "link.obj")
        body = view.with_meshes(made).scene.body
        (shape,) = list(body.parts.values())[body.chains[0][0]]
        assert shape.points is not None
        return shape.points[shape.faces] / (0.1, 0.1, 0.2)

    coarse = seen(20_000)
    assert 500 < len(coarse) <= 3000
    assert np.abs(np.linalg.norm(coarse, axis=2) - 1.0).max() < 2 / 15
    np.testing.assert_allclose(seen(3000), corners[faces[:3000]], atol=1e-7)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("meshes/link.obj", "meshes/none.obj"), "is not found beside it"),
        (("<robot", "<robo"), "other.urdf"),
        (('name="j', 'name="k'), "expected the URDF that the mechanism was read from"),
    ],
)
def test_what_is_not_there_is_said(change: tuple[str, str], said: str, made: Path) -> None:
    """Exit code 2 and no page: a mesh that is missing, no URDF, the URDF of another arm."""
    mechanism = pincal.Mechanism.from_urdf(made, "l2")
    mechanism.save(made.parent / "arm")
    other = made.with_name("other.urdf")
    other.write_text(made.read_text("utf-8").replace(*change), encoding="utf-8")
    page = made.with_name("view.html")
    outcome = run("view", made.parent / "arm", "--meshes", other, "-o", page)
    assert outcome.code == 2
    assert said in outcome.err
    assert not page.exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_arms_of_others_are_small_pages(name: str) -> None:
    """Under 5 MB, every link that has a mesh drawn by it."""
    view = pincal.view(loaded(name)).with_meshes(urdf(ARMS[name][0]))
    body = view.scene.body
    every = list(body.parts.values())
    kinds = [{shape.kind for shape in every[place]} for place in body.chains[0]]
    assert sum(own == {"mesh"} for own in kinds) >= 6
    assert len(view.html().encode()) < 5e6


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


@pytest.mark.parametrize("collision", [False, True])
@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_mesh_is_refused_by_its_name(name: str, collision: bool, tmp_path: Path) -> None:
    """Empty, cut off, or with NaN: nothing is drawn of it, and nothing said to be free of it."""
    data, words = BROKEN[name]
    file = f"link{Path(name).suffix}"
    (tmp_path / file).write_bytes(data)
    kind = "collision" if collision else "visual"
    link = f'<link name="l1"><{kind}><geometry><mesh filename="{file}"/></geometry></{kind}></link>'
    path = tmp_path / "arm.urdf"
    path.write_text(robot(ARM).replace('<link name="l1"/>', link), encoding="utf-8")
    view = pincal.view(pincal.Mechanism.from_urdf(path, "l2"))

    def use() -> object:
        if collision:
            return free_of_collision(path, ["j1", "j2"], np.zeros((3, 2)))
        return view.with_meshes(path)

    with pytest.raises(pincal.FileError, match=words):
        use()
