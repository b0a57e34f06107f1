"""The view's page in a real browser: what is on the screen is where kinematics says."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pytest
from neighbours import skeleton

import pincal
from pincal.files.mechanism_folders import bundled
from pincal.show.view.scene import scene
from pincal.show.view.view import View
from pincal.words.numbers import POSES, per_si

pytestmark = pytest.mark.slow

MECHANISMS = ["5R", "3RRR", "6UPS", "4cable"]
FAR = {
    "5R": [0.0, 3.0],
    "3RRR": [1.6, 0.9, 0.0],
    "6UPS": [0.0, 0.0, 1.2, 0.0, 0.0, 0.0],
    "4cable": [9.0, 9.0, 9.0],
}
EVIL = "<script>document.title='Ω'</script><b>\"é\"'&amp;"
_MATRICES = """(paths) => {
  const { viewer } = window.pincal;
  viewer.scene.updateMatrixWorld(true);
  const back = viewer.scene.matrixWorld.clone().invert();
  return paths.map((path) => {
    const { object } = viewer.scene_tree.find(path.split("/"));
    return object.visible ? back.clone().multiply(object.matrixWorld).elements : null;
  });
}"""
_ON_SCREEN = """(points) => points.map(([x, y, z]) => {
  const at = new MeshCat.THREE.Vector3(x, z, -y).project(window.pincal.viewer.camera);
  return [at.x, at.y];
})"""


@dataclass
class Window:
    """A page in the browser, and what it did beside showing itself."""

    page: Any
    said: list[str] = field(default_factory=list)
    """Console messages and errors."""
    asked: list[str] = field(default_factory=list)
    """Addresses it asked for, but its own."""
    seconds: float = np.nan
    """From opening to the first pose drawn."""

    def matrices(self, view: View, root: str = "mechanism") -> np.ndarray:
        """Return ``T_base_part`` from the scene graph, shape (n_parts, 4, 4); NaN if hidden."""
        paths = [f"meshcat/{root}/{path}" for path in view.scene.body.parts]
        found = self.page.evaluate(_MATRICES, paths)
        hidden = [float("nan")] * 16
        return np.array([m or hidden for m in found]).reshape(-1, 4, 4).swapaxes(1, 2)

    def pose(self) -> int:
        """Return the place of the pose that is shown."""
        return int(self.page.evaluate("() => window.pincal.pose()"))

    def values(self, head: str) -> list[float]:
        """Return the numbers in the panel's table below a head."""
        lines = self.page.locator("#rows tr").all_inner_texts()
        below = lines[lines.index(head) + 1 :]
        cells = [line.split("\t") for line in below]
        count = next((i for i, line in enumerate(cells) if len(line) < 2), len(cells))
        return [float(line[1].split()[0]) for line in cells[:count]]

    def slide(self, place: int) -> None:
        """Move the slider."""
        self.page.locator("#slider").fill(str(place + 1))

    def clean(self) -> bool:
        """Return whether the page said nothing and asked for nothing."""
        return not self.said and not self.asked


@pytest.fixture
def opened(browser: Any, tmp_path: Path) -> Iterator[Any]:
    """Function that opens a view in a browser without network: its file, or as it is served."""
    context = browser.new_context(viewport={"width": 1200, "height": 760})

    def open_(view: View, *, served: bool = False) -> Window:
        address = view.url if served else view.save(tmp_path / "view.html", force=True).as_uri()
        window = Window(context.new_page())
        window.page.on("console", lambda message: window.said.append(message.text))
        window.page.on("pageerror", lambda error: window.said.append(str(error)))

        def route(route: Any) -> None:
            if route.request.url == address or (served and route.request.url.startswith(address)):
                route.continue_()
            else:
                window.asked.append(route.request.url)
                route.abort()

        window.page.route("**/*", route)
        begin = perf_counter()
        window.page.goto(address)
        window.page.wait_for_function("() => window.pincal && window.pincal.drawn()")
        window.seconds = perf_counter() - begin
        return window

    yield open_
    context.close()


def plan(name: str, count: int = 6) -> tuple[pincal.Mechanism, pincal.Plan]:
    """Return a mechanism, poses of it with sets, the last one out of reach."""
    mechanism = pincal.load_mechanism(name)
    shifts = np.random.default_rng(4).uniform(0.0, 0.15, (count, mechanism.platform.dof))
    poses = np.concatenate((mechanism.platform.home + shifts, [FAR[name]]))
    sets = (*(mechanism.leg_names[i % 2] for i in range(count)), "all")
    return mechanism, pincal.Plan(poses, sets)


@pytest.mark.parametrize("name", MECHANISMS)
def test_slider_moves_the_mechanism(name: str, opened: Any) -> None:
    """At every pose, parts are where inverse kinematics puts them, tips at platform points."""
    mechanism, poses = plan(name)
    view = pincal.view(mechanism, poses)
    window = opened(view)
    solution = pincal.inverse(mechanism, poses.poses)
    points = list(dict.fromkeys(leg.point.name for leg in mechanism.legs))
    body = view.scene.body
    for place in range(len(poses.poses)):
        window.slide(place)
        assert window.pose() == place
        matrices = window.matrices(view)
        for leg, chain in zip(mechanism.legs, body.chains, strict=True):
            joints = solution.joints[leg.name][place]
            origins = matrices[list(chain), :3, 3]
            if not np.isfinite(joints).all():
                assert np.isnan(origins).any()
                continue
            moving = [i for i, j in enumerate(leg.joints) if j.kind != "fixed"]
            assert np.allclose(origins[[*moving, -1]], skeleton(leg, joints), atol=1e-9)
            point = matrices[body.part(f"platform/point {points.index(leg.point.name) + 1}")]
            assert np.linalg.norm(point[:3, 3] - origins[-1]) < 1e-6
        assert np.allclose(matrices, body.placements[place], atol=1e-9, equal_nan=True)
    assert window.clean(), (window.said, window.asked)


@pytest.mark.parametrize("name", MECHANISMS)
def test_all_is_on_the_screen(name: str, opened: Any, tmp_path: Path) -> None:
    """Every link at every pose is projected into the picture; a picture is taken."""
    mechanism, poses = plan(name)
    view = pincal.view(mechanism, pincal.Plan(poses.poses[:-1], (poses.sets or ())[:-1]))
    window = opened(view)
    points = view.scene.body.placements[:, :, :3, 3].reshape(-1, 3)
    on_screen = np.array(window.page.evaluate(_ON_SCREEN, points.tolist()))
    assert np.abs(on_screen).max() < 0.98
    if view.scene.mechanism.platform.space == 2:  # seen from above: x to the right, y up
        shift = np.array(window.page.evaluate(_ON_SCREEN, [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]))
        assert shift[1, 0] > shift[0, 0]
        assert shift[2, 1] > shift[0, 1]
        assert np.allclose(shift[1, 1], shift[0, 1], atol=1e-5)
    window.page.screenshot(path=tmp_path / f"{name}.png")
    assert (tmp_path / f"{name}.png").stat().st_size > 20_000
    for tag in window.page.locator(".tag").all():
        box = tag.bounding_box()
        assert box["x"] > 270
        assert box["x"] + box["width"] < 1200
        assert box["y"] + box["height"] < 760


@pytest.mark.parametrize("name", sorted(set(bundled()) - set(MECHANISMS)))
def test_every_family_is_connected_and_on_the_screen(
    name: str, opened: Any, tmp_path: Path
) -> None:
    """At home and over the workspace, tips are at platform points and inside the picture."""
    mechanism = pincal.load_mechanism(name)
    view = pincal.view(mechanism)
    window, body = opened(view), view.scene.body
    points = list(dict.fromkeys(p.name for leg in mechanism.legs for p in leg.points))
    for place in range(0, len(view.scene.plan.poses), 4):
        window.slide(place)
        matrices = window.matrices(view)
        assert np.allclose(matrices, body.placements[place], atol=1e-9)
        for leg, chain in zip(mechanism.legs, body.chains, strict=True):
            point = matrices[body.part(f"platform/point {points.index(leg.point.name) + 1}")]
            assert np.linalg.norm(point[:3, 3] - matrices[chain[-1], :3, 3]) < 1e-6
    shown = body.placements[:, :, :3, 3].reshape(-1, 3)
    on_screen = np.array(window.page.evaluate(_ON_SCREEN, shown.tolist()))
    assert np.abs(on_screen).max() < 0.98
    window.page.screenshot(path=tmp_path / f"{name}.png")
    assert window.clean(), (window.said, window.asked)


def test_what_is_not_reached_is_said(opened: Any) -> None:
    """Legs out of reach are hidden and named; the words go where the pose is left."""
    mechanism, poses = plan("3RRR")
    view = pincal.view(mechanism, poses)
    window = opened(view)
    problem = window.page.locator("#problem")
    assert not problem.is_visible()
    window.page.keyboard.press("End")
    assert problem.inner_text() == f"Not drawn: {view.scene.body.problems[-1]}"
    assert "leg_1" in problem.inner_text()
    assert window.page.locator("#rows td", has_text="–").count() > 0
    window.page.keyboard.press("Home")
    assert not problem.is_visible()


def test_keys_buttons_and_play(opened: Any) -> None:
    """Keys and buttons step, to the ends and not beyond; play goes on by itself, and stops."""
    window = opened(pincal.view(*plan("5R")))
    page, last = window.page, 6
    for key, place in (
        ("ArrowRight", 1),
        ("ArrowUp", 2),
        ("ArrowLeft", 1),
        ("ArrowDown", 0),
        ("ArrowLeft", 0),
        ("End", last),
        ("ArrowRight", last),
        ("Home", 0),
    ):
        page.keyboard.press(key)
        assert window.pose() == place, key
    page.locator("#slider").focus()  # one step, though the slider has keys of its own
    page.keyboard.press("ArrowRight")
    assert window.pose() == 1
    page.locator("#forth").click()
    assert window.pose() == 2
    page.locator("#back").click()
    assert page.locator("#count").inner_text() == "2 of 7"
    page.locator("#slider").focus()
    page.keyboard.press(" ")
    page.wait_for_function("() => window.pincal.pose() >= 3")
    page.locator("#play").click()
    stopped = window.pose()
    page.wait_for_timeout(1200)
    assert window.pose() == stopped
    assert window.clean(), window.said


_GO = "(wanted) => window.pincal.jog.go(wanted)"


@pytest.mark.parametrize("name", ["3RRR", "6UPS", "delta", "8cable", "3RPS"])
def test_a_served_page_moves_off_its_poses(name: str, opened: Any) -> None:
    """Parts, both machines' and readings are those of inverse kinematics at the moved pose.

    Sliders move the platform, or the readings where these do not follow from poses. Out of reach
    nothing moves, and it is said. A step leads back to the pose.
    """
    mechanism = pincal.load_mechanism(name)
    true = pincal.disturb(mechanism, 1e-3, seed=1)
    view = pincal.view(mechanism, identified=true, magnify=3.0)
    window, first = opened(view, served=True), view.scene.plan.rows([0])
    if mechanism.by_readings:
        shift = np.array([0.02, -0.01, 0.03])
        readings = view.scene.body.readings[:1] + shift
        pose = pincal.forward(mechanism, readings).poses
    else:
        shift = np.array([0.02, -0.01, 0.03, 0.02, -0.03, 0.04])[
            list(mechanism.platform.twist_rows)
        ]
        moved = mechanism.platform.displaced(mechanism.platform.matrices(first.poses), shift[None])
        pose = mechanism.platform.from_matrices(moved)
        readings = pincal.inverse(mechanism, pose).readings
    window.page.evaluate(_GO, shift.tolist())
    plan = pincal.Plan(np.concatenate((view.scene.plan.poses, pose)))
    if view.scene.plan.readings is not None:
        plan = replace(plan, readings=np.concatenate((view.scene.plan.readings, readings)))
    there = scene(mechanism, plan, true, 3.0)
    assert there.magnified is not None
    for own, root in ((there.body, "mechanism"), (there.magnified, "identified")):
        assert np.allclose(window.matrices(view, root), own.placements[-1], atol=1e-6)
    head = "readings, as given" if mechanism.by_readings else "readings of the nominal model"
    for title, units, numbers in (
        ("pose", mechanism.platform.units, pose[0]),
        (head, mechanism.reading_units, readings[0]),
    ):
        expected = np.array([per_si(unit, POSES) for unit in units]) * numbers
        assert window.values(title) == pytest.approx(expected.tolist(), abs=6e-3)
    if name in ("3RRR", "delta"):  # sliders of the others have no end
        window.page.evaluate(_GO, [10.0, *[0.0] * (len(shift) - 1)])
        assert window.page.get_by_text("Out of reach.").is_visible()
        assert np.allclose(window.matrices(view), there.body.placements[-1], atol=1e-6)
    window.page.evaluate("() => window.pincal.show(0)")
    assert np.allclose(window.matrices(view), view.scene.body.placements[0], atol=1e-9)
    assert not window.page.get_by_text("Out of reach.").is_visible()
    assert window.clean(), window.said


def test_a_file_shows_its_poses_alone(opened: Any) -> None:
    """Nothing moves a saved page off its poses: it has no sliders, and its policy bars asking."""
    window = opened(pincal.view(*plan("3RRR")))
    assert not window.page.locator("#jog").count()
    assert window.page.evaluate("() => window.pincal.jog") is None


def test_the_platform_follows_the_pointer(opened: Any) -> None:
    """Dragging the platform moves it as the pointer goes, does not turn the view, and is said.

    *reset* leads back to the pose.
    """
    mechanism = pincal.load_mechanism("3RRR")
    view = pincal.view(mechanism)
    window = opened(view, served=True)
    page, pane = window.page, window.page.locator("main").bounding_box()
    x, y = page.evaluate(_ON_SCREEN, [[0.05, 0.05, 0.0]])[0]
    place = (
        pane["x"] + (x + 1) / 2 * pane["width"],
        pane["y"] + (1 - y) / 2 * pane["height"],
    )
    before = page.evaluate(_ON_SCREEN, [[0, 0, 0]])
    page.mouse.move(*place)
    page.mouse.down()
    page.mouse.move(place[0] + 20, place[1] - 10)
    page.mouse.up()
    page.evaluate("() => window.pincal.jog.idle()")
    x, y = window.matrices(view)[view.scene.body.part("platform/body"), :2, 3]
    assert x > 0.02
    assert y == pytest.approx(x / 2, rel=0.05)
    assert window.values("pose")[:2] == pytest.approx([1e3 * x, 1e3 * y], abs=6e-3)
    assert np.allclose(page.evaluate(_ON_SCREEN, [[0, 0, 0]]), before, atol=1e-6)
    assert page.locator("#count").inner_text() == "moved by hand"
    page.get_by_role("button", name="reset").click()
    assert not page.get_by_role("button", name="reset").is_visible()
    assert page.locator("#count").inner_text() == f"1 of {len(view.scene.plan.poses)}"
    assert np.allclose(window.matrices(view), view.scene.body.placements[0], atol=1e-9)
    assert window.clean(), window.said


def test_a_dot_says_which_pose_it_is_and_leads_there(opened: Any) -> None:
    """The pointer over a dot shows row, set and miss; a click goes there, a drag does not."""
    mechanism, poses = plan("6UPS", 12)
    many = pincal.Plan(poses.poses[:-1], (poses.sets or ())[:-1])
    true = pincal.disturb(mechanism, 1e-3, seed=1)
    noise = pincal.Noise(1e-4, 1e-4)
    data = pincal.simulate(mechanism, true, many, noise, 3).measurements
    result = pincal.calibrate(mechanism, data, noise=noise)
    view = pincal.view(mechanism, many, identified=true).with_result(result)
    window = opened(view)
    page, pane = window.page, window.page.locator("main").bounding_box()
    on_screen = np.array(page.evaluate(_ON_SCREEN, many.poses[:, :3].tolist()))
    pixels = (on_screen * [1, -1] + 1) / 2 * [pane["width"], pane["height"]]
    x, y = pane["x"] + pixels[:, 0], pane["y"] + pixels[:, 1]
    apart = np.linalg.norm(pixels[:, None] - pixels, axis=2) + 1e3 * np.eye(len(pixels))
    row = 1 + int(np.argmax(apart.min(axis=1)[1:]))
    miss = data.poses[row] - pincal.forward(result.identified, data.readings, data.poses).poses[row]
    page.mouse.move(x[row], y[row])
    told = page.locator(".tip").inner_text()
    assert told.startswith(f"row {row + 1}, set {many.sets[row]}, missed by ")
    assert float(told.split()[-2]) == pytest.approx(1e3 * np.linalg.norm(miss[:3]), rel=0.05)
    page.mouse.click(x[row], y[row])
    assert window.pose() == row
    page.keyboard.press("Home")
    page.mouse.down()
    page.mouse.move(x[row] + 6, y[row])
    page.mouse.up()
    assert window.pose() == 0
    page.mouse.move(pane["x"] + 3, pane["y"] + 3)
    assert not page.locator(".tip").is_visible()
    assert window.clean(), window.said


def test_layers_and_sets_can_be_hidden(opened: Any) -> None:
    """Check boxes hide what they name; sets have their legs' names."""
    mechanism, poses = plan("3RRR")
    true = pincal.disturb(mechanism, 1e-3, seed=1)
    view = pincal.view(mechanism, poses, identified=true, magnify=30)
    window = opened(view)

    def visible(path: str) -> bool:
        return bool(window.page.evaluate(_MATRICES, [f"meshcat/{path}"])[0])

    for label, path, shown in (
        ("poses, as dots", "sets", True),
        ("identified, errors × 30", "identified", True),
        ("leg_1, 3 poses", "sets/1", True),
    ):
        box = window.page.get_by_label(label)
        assert visible(path) == shown == box.is_checked()
        box.set_checked(not shown)
        assert visible(path) == (not shown)
    window.slide(2)
    identified = view.scene.magnified
    assert identified is not None
    found = window.matrices(view, "identified")
    assert np.allclose(found, identified.placements[2], atol=1e-9)
    assert window.clean(), window.said


def test_names_are_text(opened: Any) -> None:
    """Names that hold code, quotes and letters from elsewhere are shown as they are."""
    mechanism = pincal.load_mechanism("5R")
    legs = tuple(replace(leg, name=f"{EVIL}{i}") for i, leg in enumerate(mechanism.legs))
    mechanism = replace(mechanism, name=EVIL, legs=legs, description=EVIL)
    poses = [[0.0, 1.1], [0.0, 3.0]]
    view = pincal.view(mechanism, pincal.Plan(np.array(poses), mechanism.leg_names))
    window = opened(view)
    window.slide(1)
    assert window.page.title() == EVIL
    for place in ("#name", "#description"):
        assert window.page.locator(place).text_content() == EVIL
    assert window.page.locator(".tag").all_text_contents() == list(mechanism.leg_names)
    assert mechanism.leg_names[1] in window.page.locator("#set").text_content()
    assert mechanism.leg_names[1] in window.page.locator("#problem").text_content()
    assert mechanism.leg_names[0] in window.page.locator("#rows").text_content()
    assert window.page.locator("script").count() == 3
    assert window.page.locator("aside b").count() == 0
    assert window.clean(), window.said


def test_notebooks_and_browsers_show_the_mechanism(browser: Any) -> None:
    """A notebook's frame and the served address show the mechanism; nothing else is asked."""
    view = pincal.view(*plan("5R"))
    page = browser.new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.set_content(f"<h1>notebook</h1>{view._repr_html_()}")
    frame = page.frames[1]
    frame.wait_for_function("() => window.pincal && window.pincal.drawn()")
    frame.locator("#forth").click()
    assert frame.locator("#count").inner_text() == "2 of 7"
    assert set(asked) <= {"about:srcdoc"}
    asked.clear()
    page.goto(view.url)
    page.wait_for_function("() => window.pincal && window.pincal.drawn()")
    assert asked == [view.url]
    page.close()
    view.close()


def test_policy_bars_requests(opened: Any) -> None:
    """Even if the page were made to ask another host, it could not."""
    window = opened(pincal.view(*plan("5R")))
    ask = "() => fetch('http://127.0.0.1:9/').then(() => 'asked', (error) => String(error))"
    assert "Failed to fetch" in window.page.evaluate(ask)
    assert not window.asked
    assert any("Content Security Policy" in text for text in window.said)


def test_large_views_stay_small_and_quick(opened: Any, record_property: Any) -> None:
    """100 poses of a hexapod: under 5 MB, drawn and stepped in seconds."""
    mechanism = pincal.load_mechanism("6UPS")
    rng = np.random.default_rng(0)
    poses = np.tile(mechanism.platform.home, (100, 1))
    poses[:, :3] += rng.uniform(-0.1, 0.1, (100, 3))
    view = pincal.view(mechanism, poses)
    size = len(view.html().encode())
    window = opened(view)
    begin = perf_counter()
    window.page.evaluate("() => { for (let i = 0; i < 100; i++) window.pincal.show(i); }")
    steps = perf_counter() - begin
    report = {"megabytes": size / 1e6, "load [s]": window.seconds, "step [s]": steps / 100}
    record_property("view", json.dumps(report))
    print(report)
    assert size < 5e6
    assert window.seconds < 30  # without a graphics card, on a busy machine
    assert steps / 100 < 0.1


@pytest.mark.parametrize("name", MECHANISMS)
def test_a_telephone_shows_all_of_the_mechanism(name: str, opened: Any) -> None:
    """Upright and narrow: pane and panel one above the other, all points and names in the pane."""
    view = pincal.view(pincal.load_mechanism(name))
    page = opened(view, served=True).page
    page.set_viewport_size({"width": 390, "height": 800})
    page.reload()
    page.wait_for_function("() => window.pincal")
    page.wait_for_timeout(200)
    pane, panel = (page.locator(one).bounding_box() for one in ("main", "aside"))
    canvas = page.locator("main canvas").first.bounding_box()
    assert (canvas["width"], canvas["height"]) == pytest.approx((pane["width"], pane["height"]))
    assert panel["y"] >= pane["y"] + pane["height"] - 1
    assert panel["width"] == 390
    points = view.scene.points()
    assert np.abs(page.evaluate(_ON_SCREEN, points.tolist())).max() < 1
    for tag in page.locator(".tag").all():
        box = tag.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390
    assert not page.get_by_text("Open Controls").is_visible()
    for one in page.locator("button:visible, input[type=range]:visible").all():
        assert one.bounding_box()["height"] >= 36  # for thumbs
    scale = page.locator("#scale").bounding_box()
    for tag in page.locator(".tag").all():
        box = tag.bounding_box()
        beside = box["x"] >= scale["x"] + scale["width"] or box["x"] + box["width"] <= scale["x"]
        assert beside or box["y"] + box["height"] <= scale["y"] + 1
    sliders, values = page.locator("#jog input"), page.locator("#jog output")
    for index in range(sliders.count()):
        sliders.nth(index).evaluate("(one) => { one.value = one.min / 50; }")
        sliders.nth(index).dispatch_event("input")
        page.evaluate("() => window.pincal.jog.idle()")
    lines = [one.bounding_box()["height"] for one in values.all()]
    assert all(high < 30 for high in lines)  # values are not broken
    panel = page.locator("aside")
    assert panel.evaluate("(one) => one.scrollWidth <= one.clientWidth")


AXE = Path(__file__).parents[1] / "node_modules" / "axe-core" / "axe.min.js"
_AXE = """async () => {
  const { violations } = await axe.run();
  return violations.map((one) => `${one.id}: ${one.nodes.map((node) => node.html).join(" ")}`);
}"""


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_pages_can_be_used_by_everyone(theme: str, browser: Any, tmp_path: Path) -> None:
    """No violation of axe's rules in view and report, also on a phone, contrast among them.

    Needs ``npm install --no-save axe-core``.
    """
    if not AXE.is_file():
        pytest.skip("no axe-core (npm install --no-save axe-core)")
    mechanism, poses = plan("3RRR")
    true = pincal.disturb(mechanism, 1e-3, seed=1)
    noise = pincal.Noise(1e-4, 1e-4)
    many = pincal.sample_configurations(mechanism, 30, 0)
    data = pincal.simulate(mechanism, true, many, noise, 3).measurements
    result = pincal.calibrate(mechanism, data, noise=noise)
    pages = pincal.view(mechanism, poses, identified=true), result.report(date="today")
    for page, width in product(pages, (1280, 390)):
        path = page.save(tmp_path / "page.html", force=True)
        size = {"width": width, "height": 800}
        context = browser.new_context(color_scheme=theme, bypass_csp=True, viewport=size)
        shown = context.new_page()
        shown.goto(path.as_uri())
        shown.wait_for_timeout(500)
        shown.evaluate(AXE.read_text("utf-8"))
        assert shown.evaluate(_AXE) == []
        context.close()


def test_a_dark_theme_inverts_the_drawing_and_its_swatches(opened: Any) -> None:
    """Both alike, so that a colour means the same; text of the panel has the theme's colours."""
    window = opened(pincal.view(*plan("3RRR")))
    page = window.page
    looks = """() => ["main", "aside .swatch"].map(
      (of) => getComputedStyle(document.querySelector(of)).filter)"""
    assert page.evaluate(looks) == ["none", "none"]
    page.emulate_media(color_scheme="dark")
    drawing, swatch = page.evaluate(looks)
    assert "invert" in drawing
    assert drawing == swatch
    assert window.clean(), window.said


def test_slider_goes_from_nominal_to_identified(opened: Any) -> None:
    """At its ends the identified machine is the nominal one and itself, between in between."""
    mechanism, poses = plan("3RRR")
    true = pincal.disturb(mechanism, 1e-3, seed=1)
    view = pincal.view(mechanism, poses, identified=true)
    window = opened(view)
    identified = view.scene.magnified
    assert identified is not None
    ends = view.scene.body.placements[0], identified.placements[0]
    for share in (0.0, 0.5, 1.0):
        window.page.locator("#share").fill(str(share))
        expected = (1 - share) * ends[0] + share * ends[1]
        assert np.allclose(window.matrices(view, "identified"), expected, atol=1e-9)
