"""The view without a browser: what it draws is where kinematics says, and its page is safe."""

from __future__ import annotations

import html
import http.client
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest
from arms import loaded
from command_line import contents, done, run
from neighbours import skeleton

import pincal
from pincal.show.view.bodies import Body, body
from pincal.show.view.scene import moved, scene

MECHANISMS = ["5R", "3RRR", "6UPS", "4cable"]
EVIL = "<script>alert('Ω \"é\"')</script>"


def some_poses(mechanism: pincal.Mechanism, count: int = 6) -> np.ndarray:
    """Return poses near home, shape (count, dof)."""
    shifts = np.random.default_rng(1).uniform(0.0, 0.15, (count, mechanism.platform.dof))
    return np.array(mechanism.platform.home) + shifts


def gaps(mechanism: pincal.Mechanism, drawn: Body) -> np.ndarray:
    """Return the distances of tips from their platform points, shape (N, n_legs)."""
    at = drawn.placements[:, :, :3, 3]
    points = list(dict.fromkeys(leg.point.name for leg in mechanism.legs))
    own = [
        drawn.part(f"platform/point {points.index(leg.point.name) + 1}") for leg in mechanism.legs
    ]
    tips = [chain[-1] for chain in drawn.chains]
    return np.linalg.norm(at[:, tips] - at[:, own], axis=2)


@pytest.mark.parametrize("name", MECHANISMS)
def test_links_are_where_pinocchio_puts_them(name: str) -> None:
    """Link placements of moving joints and tips are those of Pinocchio, reading the URDF."""
    mechanism = pincal.load_mechanism(name)
    solution = pincal.inverse(mechanism, some_poses(mechanism))
    for leg in mechanism.legs:
        joints = solution.joints[leg.name]
        own = leg.link_placements(joints)[:, :, :3, 3]
        moving = [i for i, j in enumerate(leg.joints) if j.kind != "fixed"]
        for row, values in zip(own, joints, strict=True):
            assert np.allclose(row[[*moving, -1]], skeleton(leg, values), atol=1e-12)


@pytest.mark.parametrize("name", MECHANISMS)
def test_tips_meet_platform_points(name: str) -> None:
    """Every leg's tip is at its platform point, at every pose, magnified errors or not."""
    mechanism = pincal.load_mechanism(name)
    true = pincal.disturb(mechanism, 1e-3, seed=2)
    found = scene(mechanism, pincal.Plan(some_poses(mechanism)), true, 5.0)
    assert gaps(mechanism, found.body).max() < 1e-9
    assert found.magnified is not None
    drawn = [not problem for problem in found.magnified.problems]
    assert any(drawn)
    assert gaps(mechanism, found.magnified)[drawn].max() < 1e-9


def test_what_is_not_reached_is_not_drawn_and_said() -> None:
    """Links of a leg out of reach are NaN, the rest is drawn, and the leg is named."""
    mechanism = pincal.load_mechanism("3RRR")
    drawn = body(mechanism, np.array([[0.0, 0.0, 0.0], [1.6, 0.9, 0.0]]))
    reached = pincal.inverse(mechanism, [[1.6, 0.9, 0.0]]).reached[0]
    assert not drawn.problems[0]
    assert not reached.all()
    for leg, ok, chain in zip(mechanism.legs, reached, drawn.chains, strict=True):
        assert np.isfinite(drawn.placements[1, list(chain)]).all() == ok
        assert (leg.name in drawn.problems[1]) == (not ok)
    assert np.isfinite(drawn.placements[1, drawn.part("platform/body")]).all()


def test_cylinder_and_piston_reach_from_the_universal_joint_to_the_slider() -> None:
    """Both together are as long as the stroke, at every pose; the cylinder keeps its length."""
    mechanism = pincal.load_mechanism("6UPS")
    poses = some_poses(mechanism)
    drawn = body(mechanism, poses)
    strokes = pincal.inverse(mechanism, poses).joints["leg_1"][:, 2]
    foot = drawn.placements[:, drawn.part("leg 1/link 1"), :3, 3]
    slider = drawn.placements[:, drawn.part("leg 1/link 3"), :3, 3]

    def ends(name: str) -> np.ndarray:
        place = drawn.part(f"leg 1/{name} 3")
        (shape,) = drawn.parts[f"leg 1/{name} 3"]
        half = shape.size[1] / 2
        tips = shape.T_link_shape @ np.array([[0, 0, -half, 1.0], [0, 0, half, 1.0]]).T
        return np.einsum("nij,jk->nki", drawn.placements[:, place], tips)[..., :3]

    piston, cylinder = ends("rod"), ends("cylinder")
    assert np.allclose(piston[:, 0], slider, atol=1e-12)
    assert np.allclose(piston[:, 1], cylinder[:, 1], atol=1e-12)
    assert np.allclose(cylinder[:, 0], foot, atol=1e-12)
    lengths = [np.linalg.norm(one[:, 1] - one[:, 0], axis=1) for one in (piston, cylinder)]
    assert np.allclose(sum(lengths), strokes)
    assert np.ptp(lengths[1]) < 1e-12
    assert 0.3 * strokes.min() < lengths[1][0] < strokes.min()


def test_cables_are_thin() -> None:
    """A line that pulls is half as thick as a piston or less, and has no cylinder."""
    cable, strut = (
        body(m, np.array([m.platform.home])) for m in map(pincal.load_mechanism, ("4cable", "6UPS"))
    )
    assert not any("cylinder" in path for path in cable.parts)
    thick = [
        one.parts["leg 1/rod 3"][0].size[0] / one.parts["leg 1/base"][0].size[2]
        for one in (cable, strut)
    ]
    assert thick[0] < thick[1] / 2


def test_errors_are_magnified_to_first_order() -> None:
    """Small errors of the platform, magnified tenfold, are drawn ten times as large."""
    mechanism = pincal.load_mechanism("3RRR")
    true = pincal.disturb(mechanism, 1e-6, seed=3)
    found = scene(mechanism, pincal.Plan(some_poses(mechanism)), true, 10.0)
    assert found.magnified is not None
    platform = found.body.part("platform/body")
    moved = found.magnified.placements - found.body.placements
    reached = pincal.forward(true, pincal.inverse(mechanism, found.plan.poses).readings).poses
    errors = (reached - found.plan.poses)[:, :2]
    assert np.allclose(
        moved[:, platform, :2, 3], 10 * errors, atol=1e-3 * np.abs(errors).max() * 10
    )


def evil(mechanism: pincal.Mechanism) -> pincal.Mechanism:
    """Return a mechanism whose names are code, quotes and letters from elsewhere."""
    legs = tuple(replace(leg, name=f"{EVIL}{i}") for i, leg in enumerate(mechanism.legs))
    return replace(
        mechanism, name=EVIL, legs=legs, description="</style><img src=x onerror=alert(1)>"
    )


def test_names_cannot_leave_the_page_data() -> None:
    """Names become JSON without any '<'; the title is escaped; the data reads back."""
    mechanism = evil(pincal.load_mechanism("5R"))
    plan = pincal.Plan(some_poses(mechanism), tuple(mechanism.leg_names[i % 2] for i in range(6)))
    page = pincal.view(mechanism, plan).html()
    block = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    assert block
    assert "<" not in block[1]
    data = json.loads(block[1])
    assert data["name"] == EVIL
    assert [one["name"] for one in data["sets"]] == list(mechanism.leg_names)
    outside = page.replace(block[0], "")
    title = re.search("<title>(.*?)</title>", outside)
    assert title
    assert html.unescape(title[1]) == EVIL
    assert not set("<>\"'") & set(title[1])
    assert EVIL not in outside
    assert "onerror=alert" not in outside


def test_notebooks_get_a_frame() -> None:
    """The notebook's frame holds the whole page as an attribute, shut off from the notebook."""
    view = pincal.view(pincal.load_mechanism("5R"))
    frame = view._repr_html_()
    assert 'sandbox="allow-scripts' in frame
    assert "allow-same-origin" not in frame
    srcdoc = re.search(r'srcdoc="([^"]*)"', frame)
    assert srcdoc
    assert html.unescape(srcdoc[1]) == view.html()


def test_page_is_served_to_this_machine_under_its_own_name_only() -> None:
    """The server binds to loopback, serves one page, refuses other hosts' names, and ends."""
    view = pincal.view(pincal.load_mechanism("5R"), [[0.0, 1.1]])
    place = urlsplit(view.url)
    assert place.hostname == "127.0.0.1"
    with urlopen(view.url) as answer:
        served = answer.read().decode()
    assert "connect-src 'self'" in served
    assert "connect-src" not in view.html()  # a file asks for nothing

    def status(path: str, host: str) -> int:
        connection = http.client.HTTPConnection("127.0.0.1", place.port)
        connection.request("GET", path, headers={"Host": host})
        code = connection.getresponse().status
        connection.close()
        return code

    assert status("/", f"localhost:{place.port}") == 200
    assert status("/", f"elsewhere.example:{place.port}") == 421
    assert status("/", "elsewhere.example") == 421
    assert status("/other", place.netloc) == 404
    assert status("/moved?row=0&by=0.01,0", place.netloc) == 200
    assert status("/moved?row=0&by=0.01,0", "elsewhere.example") == 421
    for wrong in ("", "?row=1&by=0,0", "?row=-1&by=0,0", "?row=0&by=x", "?row=0"):
        assert status(f"/moved{wrong}", place.netloc) == 400
    view.close()
    with pytest.raises(OSError):
        urlopen(f"http://{place.netloc}/")


def test_clients_that_say_nothing_or_hang_up_are_nothing_to_the_others(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """Hundreds of idle clients take no thread each, those that hang up leave no trace."""
    view = pincal.view("5R", [[0.0, 1.1]])
    place = urlsplit(view.url)
    threads = threading.active_count()
    with ExitStack() as stack:
        for _ in range(300):
            stack.enter_context(socket.create_connection((place.hostname, place.port)))
        for request in (
            b"",
            b"GET / HT",
            f"GET / HTTP/1.1\r\nHost: {place.netloc}\r\n\r\n".encode(),
        ):
            client = socket.create_connection((place.hostname, place.port))
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.sendall(request)
            client.close()  # with a reset, whatever is under way
        with urlopen(view.url) as answer:
            assert answer.read().decode().startswith("<!DOCTYPE html>")
        assert threading.active_count() <= threads + 1
    view.close()
    assert capfd.readouterr().err == ""


def test_text_that_no_page_holds_is_shown_all_the_same(tmp_path: Path) -> None:
    """What no text can hold is shown with a replacement, in a file and served."""
    view = pincal.view(replace(pincal.load_mechanism("5R"), description="p\udcff"), [[0.0, 1.1]])
    assert "p\ufffd" in view.save(tmp_path / "view.html").read_text("utf-8")
    with urlopen(view.url) as answer:
        assert "p\ufffd" in answer.read().decode()
    view.close()


def test_view_takes_poses_in_every_form() -> None:
    """Coordinates, transforms and plans give the same view; none gives home first."""
    mechanism = pincal.load_mechanism("3RRR")
    poses = some_poses(mechanism)
    forms = (poses, poses.tolist(), mechanism.platform.transforms(poses), pincal.Plan(poses))
    for form in forms:
        assert np.allclose(pincal.view(mechanism, form).scene.plan.poses, poses)
    assert tuple(pincal.view(mechanism).scene.plan.poses[0]) == mechanism.platform.home


def test_view_refuses_what_it_cannot_show() -> None:
    """Too many poses, none, wrong shapes, factors and machines are refused with a reason."""
    mechanism, other = pincal.load_mechanism("3RRR"), pincal.load_mechanism("5R")
    home = [mechanism.platform.home]
    for problem, arguments in (
        ("0 poses", {"poses": np.empty((0, 3))}),
        ("2001 poses", {"poses": np.zeros((2001, 3))}),
        ("shape", {"poses": [[0.0, 0.0]]}),
        ("1 of 2 rows have no whole pose", {"poses": [[0.0, 0.0, np.nan], home[0]]}),
        ("shape", {"poses": [0.0, 0.0, 0.0]}),
        ("other legs", {"poses": home, "identified": other}),
        ("above 0", {"poses": home, "identified": mechanism, "magnify": 0.0}),
    ):
        with pytest.raises(pincal.PincalError, match=problem):
            pincal.view(mechanism, **arguments)  # type: ignore[arg-type]


# The command


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a plan, a workspace, measurements and a result of the 3-RRR."""
    folder = tmp_path_factory.mktemp("view")
    noise = ["--noise-position", "1e-5", "--noise-orientation", "1e-5"]
    done("workspace", "3RRR", "--count", 300, "-o", folder / "workspace.csv")
    plan = ["--count", 8, "--candidates", folder / "workspace.csv", "-o", folder / "plan.csv"]
    done("select", "3RRR", *plan)
    done("simulate", "3RRR", folder / "plan.csv", *noise, "-o", folder / "measured.csv")
    noise.append("--no-report")
    done("calibrate", "3RRR", folder / "measured.csv", *noise, "-o", folder / "result")
    (folder / "empty").mkdir()
    shutil.copytree(folder / "result", folder / "failed")
    told = json.loads((folder / "result" / "result.json").read_text("utf-8"))
    told["data"]["converged"] = told["converged"] = False
    told["calibrated_mechanism"] = None
    (folder / "failed" / "result.json").write_text(json.dumps(told), "utf-8")
    (folder / "header.csv").write_text("x [m],y [m],phi [rad]\n", "utf-8")
    quoted = EVIL.replace('"', '""')
    (folder / "evil.csv").write_text(f'set,x [m],y [m],phi [rad]\n"{quoted}",0,0,0\n', "utf-8")
    return folder


def test_html_holds_plan_and_result(work: Path, tmp_path: Path) -> None:
    """The file has the plan's sets, or the identified machine, also of a result alone."""
    done("view", "3RRR", work / "plan.csv", "-o", tmp_path / "plan.html")
    done("view", "3RRR", work / "result", "-o", tmp_path / "view.html")
    done("view", work / "result", "-o", tmp_path / "alone.html")
    for name, texts in (
        ("plan.html", ('"leg_3"',)),
        ("view.html", ("identified, errors × ",)),
        ("alone.html", ("identified, errors × ",)),
    ):
        page = (tmp_path / name).read_text("utf-8")
        assert all(text in page for text in texts)
    assert run("view", "3RRR", "-o", tmp_path / "view.html").code == 2
    done("view", "3RRR", work / "measured.csv", "-o", tmp_path / "view.html", "--force")
    assert "errors ×" not in (tmp_path / "view.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nothing"], "no mechanism"),
        (["3RRR", "nothing.csv"], "cannot read"),
        (["3RRR", "{}/empty"], "no result.json"),
        (["5R", "{}/result"], "other legs"),
        (["3RRR", "{}/failed"], "did not converge"),
        (["3RRR", "{}/header.csv"], "no rows"),
        (["3RRR", "{}/evil.csv"], "is no leg"),
    ],
)
def test_wrong_input_leaves_nothing(
    arguments: list[str], said: str, work: Path, tmp_path: Path
) -> None:
    """Wrong input: exit code 2, a message that says what, and no file."""
    given = [text.format(work) for text in arguments]
    outcome = run("view", *given, "-o", tmp_path / "view.html")
    assert outcome.code == 2
    assert said in outcome.err
    assert not contents(tmp_path)


@pytest.mark.slow
def test_poses_in_part_are_shown_by_the_result_that_estimates_them(
    work: Path, tmp_path: Path
) -> None:
    """Rows without a whole pose are refused by their line; a latent fit's result gives all."""
    lines = (work / "measured.csv").read_text().splitlines()
    cells = [line.split(",") for line in lines]
    phi, count = [head.split()[0] for head in cells[0]].index("phi"), len(cells) - 1
    gone = [[c for i, c in enumerate(row) if i != phi] for row in cells]
    holes = [
        [("" if i == phi and n % 2 else c) for i, c in enumerate(r)] for n, r in enumerate(cells)
    ]
    for name, rows in (("gone", gone), ("holes", holes)):
        text = "\n".join(",".join([*row, "9" if n else "humidity"]) for n, row in enumerate(rows))
        (tmp_path / f"{name}.csv").write_text(text + "\n")
    page = tmp_path / "view.html"

    for name, lacking in (("holes", -(-count // 2)), ("gone", count)):
        refused = run("view", "3RRR", tmp_path / f"{name}.csv", "-o", page)
        assert refused.code == 2
        words = f"{lacking} of {count} rows have no whole pose, the first is line 2, without phi"
        assert words in refused.err
        assert "show the RESULT of a calibration" in refused.err
        assert refused.err.count("columns not used: humidity") == 1

    fit = ["--noise-position", 1e-5, "--folds", 0, "--no-report"]
    done("calibrate", "3RRR", tmp_path / "gone.csv", *fit, "-o", tmp_path / "latent")
    estimated = pincal.Plan.from_csv(
        tmp_path / "latent" / "poses.csv", pincal.load_mechanism("3RRR")
    ).poses
    done("view", "3RRR", tmp_path / "latent", "-o", page)
    assert np.allclose(shown_poses(page), estimated, atol=2e-6)


def test_a_bad_calibration_is_not_shown_without_its_warnings(tmp_path: Path) -> None:
    """What the result warns of stands in the page's data, as text."""
    mechanism = pincal.load_mechanism("5R")
    shift = np.random.default_rng(2).uniform(-0.3, 0.3, (30, 2))
    plan = pincal.Plan(mechanism.platform.home + shift)
    noise = pincal.Noise(1e-4)
    data = pincal.simulate(mechanism, pincal.disturb(mechanism, 1e-3), plan, noise, 3).measurements
    result = pincal.calibrate(mechanism, data, noise=pincal.Noise(1e-6))  # a hundredth of the truth
    assert result.warnings
    result.save(tmp_path / "result")
    done("view", "5R", tmp_path / "result", "-o", tmp_path / "view.html")
    page = (tmp_path / "view.html").read_text("utf-8")
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page)
    assert found
    notices = json.loads(found[1])["notices"]
    assert notices
    assert any("χ²" in text for text in notices)


def test_readings_are_told_apart(work: Path, tmp_path: Path) -> None:
    """Those of the nominal model and, of measurements, those read; of plans, no others."""
    mechanism, page = pincal.load_mechanism("3RRR"), tmp_path / "view.html"
    data = pincal.Measurements.from_csv(work / "measured.csv", mechanism)
    done("view", "3RRR", work / "measured.csv", "-o", page)
    assert np.allclose(shown_poses(page, "readings, as measured"), data.readings, atol=2e-6)
    nominal = pincal.inverse(mechanism, data.poses).readings
    assert np.allclose(shown_poses(page, "readings of the nominal model"), nominal, atol=2e-6)
    assert np.abs(nominal - data.readings).max() > 1e-3
    done("view", "3RRR", work / "plan.csv", "-o", page, "--force")
    assert not shown_poses(page, "readings, as measured").size
    pincal.view(mechanism, data).save(page, force=True)
    assert np.allclose(shown_poses(page, "readings, as measured"), data.readings, atol=2e-6)


def shown_poses(page: Path, head: str = "pose") -> np.ndarray:
    """Return the poses that a page steps through, or readings, shape (N, n), [m] and [rad]."""
    block = re.search(
        r'<script type="application/json" id="data">(.*?)</script>', page.read_text("utf-8"), re.S
    )
    assert block
    rows = [row for row in json.loads(block[1])["rows"] if row["head"] == head]
    factors = [{"mm": 1e-3, "°": np.pi / 180}[row["unit"]] for row in rows]
    return np.array([row["values"] for row in rows]).T * factors


@pytest.mark.slow
@pytest.mark.parametrize("date", ["garbage", "", "-5", "9" * 20])
def test_a_date_that_is_none_harms_nothing(date: str) -> None:
    """Libraries read ``SOURCE_DATE_EPOCH`` while they are loaded; garbage in it is as if unset."""
    command = [sys.executable, "-m", "pincal", "--version"]
    environment = os.environ | {"SOURCE_DATE_EPOCH": date}
    process = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (process.returncode, process.stderr) == (0, "")


@pytest.mark.slow
def test_interrupt_ends_the_server() -> None:
    """The command prints the page's address, serves it, and Ctrl-C ends it with exit code 0."""
    command = [sys.executable, "-W", "error", "-m", "pincal", "view", "5R", "--no-open"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        url = process.stdout.readline().strip()
        with urlopen(url) as answer:
            assert answer.status == 200
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=30)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors


def test_a_page_has_the_ending_of_one(tmp_path: Path) -> None:
    """What is neither a page nor a picture is refused before anything is drawn."""
    outcome = run("view", "5R", "-o", tmp_path / "page.txt")
    assert outcome.code == 2
    assert "page.txt: give it the ending .html, .svg, .png or .pdf" in outcome.trouble
    assert contents(tmp_path) == {}


def test_an_arm_is_moved_by_its_readings() -> None:
    """A UR5 goes where the moved readings lead; a shift of its tool is refused."""
    arm, turned = loaded("ur5"), np.full(6, 0.1)
    readings = np.array([[0.3, -1.0, 1.2, -0.5, 0.7, 0.2]])
    shown = scene(arm, pincal.Plan(pincal.forward(arm, readings).poses, readings=readings))
    reached = moved(shown, 0, turned).plan.poses
    np.testing.assert_allclose(reached, pincal.forward(arm, readings + turned).poses, atol=1e-9)
    with pytest.raises(pincal.MechanismError, match=r"shape \(3,\)"):
        moved(shown, 0, np.array([0.05, -0.03, 0.1]))
