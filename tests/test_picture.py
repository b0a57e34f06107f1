"""Pictures: outlines as geometry says, the near over the far, the docs' pictures as commanded."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from command_line import contents, done, run
from lxml import etree
from marks import some_slow
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import pincal
from pincal.files.mechanism_folders import bundled
from pincal.show.picture import Picture, paint
from pincal.show.style import ACTIVE
from pincal.show.view.bodies import Shape, body

IMAGES = Path(__file__).parents[1] / "docs" / "images"
RED, BLUE = "#ff0000", "#0000ff"
EVIL = "<script>Ω\"é'$x$</script>"


def turned(seed: int) -> np.ndarray:
    """Return a random rotation, shape (3, 3)."""
    Q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return np.asarray(Q * np.linalg.det(Q))


def painted(shapes: list[Shape], V: np.ndarray) -> tuple[Figure, PolyCollection]:
    """Return shapes painted one unit wide, and the polygons."""
    figure = Figure(figsize=(8, 8), dpi=125)
    axes = figure.add_axes((0, 0, 1, 1))
    paint(axes, [(shape, np.eye(4)) for shape in shapes], V)
    axes.set(xlim=(-1, 1), ylim=(-1, 1))
    axes.set_axis_off()
    return figure, axes.collections[0]


def colours(figure: Figure, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the colours that are seen at places of ``painted``, shape (n, 3), 0 to 1."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())
    rows, columns = image.shape[:2]
    return image[((1 - y) / 2 * rows).astype(int), ((1 + x) / 2 * columns).astype(int), :3] / 255


def covered(figure: Figure) -> float:
    """Return the area that is painted."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[:, :, :3] / 255.0
    return float(4 * (1 - image[:, :, 1]).mean())  # of red and blue on white


@pytest.mark.parametrize("seed", range(3))
def test_outlines_have_the_areas_of_geometry(seed: int) -> None:
    """Shadows: a box Σ |n·v| of its faces, a cylinder 2rl sin θ + πr² cos θ, a ball πr²."""
    V = turned(seed)
    a, b, c, r, length = 0.5, 0.3, 0.7, 0.2, 0.9
    across = np.abs(V[2])
    box = across @ [b * c, a * c, a * b]
    sixteen = 16 / 2 * np.sin(2 * np.pi / 16)  # of a circle with sixteen corners, for π
    cylinder = 2 * r * length * np.hypot(*V[2, :2]) + sixteen * r**2 * across[2]
    for kind, size, area in (
        ("box", (a, b, c), box),
        ("cylinder", (r, length), cylinder),
        ("sphere", (r,), sixteen * r**2),
    ):
        # the dark outline is red alone as well: green is 0 in all of it
        figure, _ = painted([Shape(kind, size, np.eye(4), RED)], V)
        assert covered(figure) == pytest.approx(area, rel=0.02)


@pytest.mark.parametrize("swap", [False, True])
def test_of_two_rods_that_cross_the_nearer_is_seen(swap: bool) -> None:
    """Where long tilted rods cross, the one in front is painted over, whichever came first."""
    along_x, along_y = np.eye(4), np.eye(4)
    along_x[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    along_y[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    tilt = np.eye(4)
    tilt[2, 0] = 0.8  # the red rod rises to the right, through 0.1 in the middle
    tilt[2, 3] = 0.1
    along_x = tilt @ along_x
    shapes = [
        Shape("cylinder", (0.04, 1.8), along_x, RED),
        Shape("cylinder", (0.04, 1.8), along_y, BLUE),
    ]
    figure, _ = painted(shapes[::-1] if swap else shapes, np.eye(3))
    seen = colours(figure, np.zeros(2), np.array([0.0, 0.5]))
    assert np.allclose(seen, [to_rgb(RED), to_rgb(BLUE)], atol=0.02)


@pytest.mark.parametrize("stroke", [1e-12, 1e-8, 0.9e-5, 1.1e-5, 1e-3])
def test_a_rod_may_vanish(stroke: float) -> None:
    """The rod of a prismatic joint that has hardly moved is drawn from 0.0001 of its radius.

    Its shadow is that of a cylinder as long as the stroke, however it is seen.
    """
    place, radius = np.diag([1.0, 1.0, stroke, 1.0]), 0.1
    for V in (np.eye(3), np.roll(np.eye(3), 1, axis=0), turned(1)):
        axes = Figure().subplots()
        paint(axes, [(Shape("cylinder", (radius, 1.0), np.eye(4), RED), place)], V)
        areas = []
        for path in axes.collections[0].get_paths():
            x, y = path.vertices.T
            areas.append(abs(float(x[:-1] @ y[1:] - x[1:] @ y[:-1]) / 2))
        if stroke < 1e-4 * radius:
            assert not areas
            continue
        circle = 16 / 2 * np.sin(2 * np.pi / 16) * radius**2
        shadow = 2 * radius * stroke * np.hypot(*V[2, :2]) + circle * abs(V[2, 2])
        assert areas == [pytest.approx(shadow, rel=0.02)]


@pytest.mark.parametrize("name", sorted(bundled()))
def test_what_drives_stands_out(name: str) -> None:
    """Of each leg its motor, cylinder or winch has the legend's colour, and nothing else."""
    mechanism = pincal.load_mechanism(name)
    drawn = body(mechanism, np.array([mechanism.platform.home]))
    for number, leg in enumerate(mechanism.legs, 1):
        place = [joint.name for joint in leg.joints].index(leg.sensors[0].joint)
        joint = leg.joints[place]
        motor = f"link {place + 1}"
        if joint.kind == "prismatic":
            winch = "cable" in name
            motor = "base" if winch else f"cylinder {place + 1}" if joint.home else motor
        coloured = {
            path
            for path, shapes in drawn.parts.items()
            if path.startswith(f"leg {number}/") and any(s.colour == ACTIVE for s in shapes)
        }
        assert coloured == {f"leg {number}/{motor}"}


def numbers(svg: bytes) -> tuple[list[bytes], np.ndarray]:
    """Return what stands between the numbers of an SVG, and the numbers."""
    pattern = rb"(?<![#\w])-?\d+(?:\.\d+)?(?!\w)"
    text = re.sub(rb"#?p[0-9a-f]{10}\b", b"", svg)  # ids made from the paths
    return re.split(pattern, text), np.array([float(x) for x in re.findall(pattern, text)])


@pytest.mark.parametrize("name", sorted(bundled()))
def test_pictures_of_the_docs_are_what_the_command_makes(name: str, tmp_path: Path) -> None:
    """``pincal view NAME -o docs/images/NAME.svg`` gives the file that is there, and small."""
    made = tmp_path / f"{name}.svg"
    done("view", name, "-o", made)
    there = (IMAGES / f"{name}.svg").read_bytes()
    words, values = numbers(made.read_bytes())
    expected_words, expected_values = numbers(there)
    assert words == expected_words, f"make docs/images/{name}.svg anew"
    assert np.allclose(values, expected_values, atol=0.02)  # points
    assert len(there) < 200_000


@pytest.mark.slow
def test_same_pictures_are_the_same_bytes(tmp_path: Path) -> None:
    """Every format, twice: no dates, no random names."""
    mechanism = pincal.load_mechanism("6UPS")
    for kind in ("svg", "png", "pdf"):
        paths = [tmp_path / f"{i}.{kind}" for i in "ab"]
        for path in paths:
            pincal.picture(mechanism).save(path)
        assert paths[0].read_bytes() == paths[1].read_bytes()


def seen(picture: Picture) -> tuple[set[str], int]:
    """Return the texts of a picture, and how many polygons it has."""
    axes = picture.figure().axes[0]
    texts = {text.get_text() for text in (*axes.texts, *axes.get_legend().get_texts())}
    solid = [one for one in axes.collections if isinstance(one, PolyCollection)]
    return texts, sum(len(one.get_paths()) for one in solid)


def test_planar_mechanisms_are_seen_from_above() -> None:
    """The five-bar's active joints are painted where the base joints are in x and y."""
    mechanism = pincal.load_mechanism("5R")
    axes = pincal.picture(mechanism).figure().axes[0]
    (solid,) = (one for one in axes.collections if isinstance(one, PolyCollection))
    active = np.array(to_rgb(ACTIVE))
    own = [
        path.vertices[:-1].mean(axis=0)
        for path, colour in zip(solid.get_paths(), solid.get_facecolors(), strict=True)
        if np.allclose(colour[:3], active)
    ]
    feet = [leg.joints[0].placement.xyz[:2] for leg in mechanism.legs]
    assert np.allclose(sorted(map(tuple, own)), sorted(feet), atol=1e-6)


def test_poses_sets_and_result_are_in_the_picture() -> None:
    """Dots by set with their counts, the identified machine with its factor."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.1], [0.0, 0.1, 0.0]]
    plan = pincal.Plan(np.array(poses), ("leg_1", "leg_2", "leg_1"))
    true = pincal.disturb(mechanism, 1e-3, seed=0)
    picture = pincal.picture(mechanism, plan, identified=true, magnify=20)
    texts, count = seen(picture)
    assert {"2 poses for leg_1", "1 pose for leg_2", "identified, errors × 20"} <= texts
    assert count > seen(pincal.picture(mechanism))[1]
    assert seen(pincal.picture(mechanism, poses))[0] >= {"3 poses"}


def test_a_leg_out_of_reach_is_left_out() -> None:
    """What a pose does not allow is not drawn; the rest is."""
    mechanism = pincal.load_mechanism("3RRR")
    whole = seen(pincal.picture(mechanism, [[0.0, 0.0, 0.0]]))[1]
    assert 0 < seen(pincal.picture(mechanism, [[1.6, 0.9, 0.0]]))[1] < whole
    assert 0 < seen(pincal.picture(mechanism, [[50.0, 0.0, 0.0]]))[1] < whole


def test_names_are_text(tmp_path: Path) -> None:
    """Names that hold tags, quotes, dollars and letters from elsewhere are text of the SVG."""
    mechanism = pincal.load_mechanism("5R")
    legs = tuple(replace(leg, name=f"{EVIL}{i}") for i, leg in enumerate(mechanism.legs))
    pincal.picture(replace(mechanism, legs=legs)).save(tmp_path / "p.svg")
    root = etree.parse(tmp_path / "p.svg").getroot()
    texts = {text.text for text in root.iter("{*}text")}
    assert {f"{EVIL}0", f"{EVIL}1"} <= texts
    assert not list(root.iter("{*}script"))
    legs = tuple(replace(leg, name="long" * 70 + f"{i}") for i, leg in enumerate(mechanism.legs))
    plan = pincal.Plan(np.array([[0.0, 1.1]] * 2), tuple(leg.name for leg in legs))
    texts, _ = seen(pincal.picture(replace(mechanism, legs=legs), plan))
    shown = [f"longlonglonglonglon…onglong{i}" for i in range(2)]
    assert {shown[0], f"1 pose for {shown[1]}"} <= texts


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["5R", "-o", "p.gif"], ".html, .svg, .png or .pdf"),
        (["5R", "nothing.csv", "-o", "p.svg"], "cannot read"),
        (["5R", "-o", "nowhere/p.svg"], "does not exist"),
    ],
)
def test_wrong_input_leaves_nothing(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Wrong input: exit code 2, a message that says what, and no file."""
    monkeypatch.chdir(tmp_path)
    outcome = run("view", *arguments)
    assert outcome.code == 2
    assert said in outcome.err
    assert not contents(tmp_path)


@pytest.mark.slow
def test_matplotlib_is_imported_where_it_is_needed() -> None:
    """``import pincal`` stays quick: neither plots nor the browser's viewer come with it."""
    code = "import sys, pincal; print(sorted({'matplotlib', 'meshcat'} & set(sys.modules)))"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "name", some_slow(sorted(bundled()), *(set(bundled()) - {"3RRR", "6UPS", "delta"}))
)
def test_no_two_names_overlap(name: str) -> None:
    """Names of legs and of axes each have their place, as drawn."""
    mechanism = pincal.load_mechanism(name)
    figure = pincal.picture(mechanism).figure()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    texts = [text for text in figure.axes[0].texts if text.get_text()]
    assert {"x", *mechanism.leg_names} <= {text.get_text() for text in texts}
    boxes = [text.get_window_extent(canvas.get_renderer()) for text in texts]
    for (a, first), (b, second) in combinations(zip(texts, boxes, strict=True), 2):
        assert not first.overlaps(second), (a.get_text(), b.get_text())
