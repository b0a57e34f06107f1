"""Writing loses nothing: what was there stays or is kept as .bak, after kills too."""

from __future__ import annotations

import os
import random
import shutil
import signal
import socket
import stat
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from command_line import done, run
from marks import some_slow

import pincal
from pincal import FileError
from pincal.files.output import writing, writing_together

MARKER = "result.json"
WRITTEN = (MARKER, "poses.csv", "residuals.csv", "part/a.urdf")


def held(folder: Path) -> set[bytes]:
    """Return what is in the files below a folder, but for what a kill left hidden."""
    return {
        one.read_bytes()
        for one in folder.rglob("*")
        if stat.S_ISREG(one.lstat().st_mode) and ".pincal-" not in str(one)
    }


def write(target: Path, text: str, *, folder: bool, force: bool = True) -> None:
    """Write a file, or a folder of three files."""
    with writing(target, force=force, folder=WRITTEN if folder else ()) as made:
        if not folder:
            made.write_text(text)
            return
        (made / "part").mkdir()
        (made / MARKER).write_text(f"{text} result")
        (made / "residuals.csv").write_text(f"{text} residuals")
        (made / "part" / "a.urdf").write_text(f"{text} urdf")


def result(target: Path) -> Path:
    """Make a folder that pincal wrote."""
    write(target, "old", folder=True)
    (target / "poses.csv").write_text("old poses")
    return target


def users(target: Path) -> Path:
    """Make a folder that pincal wrote, and to which a user added their own."""
    result(target)
    (target / "notes.txt").write_text("notes")
    (target / "part" / "mine.txt").write_text("mine in part")
    (target / ".hidden").write_text("hidden")
    (target / "data" / "empty").mkdir(parents=True)
    (target / "data" / "measured.csv").write_text("measured")
    (target / "data" / "link").symlink_to("../notes.txt")
    (target / "data" / "nowhere").symlink_to("nowhere")
    return target


def test_a_folder_keeps_what_pincal_did_not_write(tmp_path: Path) -> None:
    """Files, folders and links of the user stay; pincal's are new, the old ones are in .bak."""
    target = users(tmp_path / "res")
    before = {str(p.relative_to(target)) for p in target.rglob("*")}
    write(target, "new", folder=True)
    after = {str(p.relative_to(target)) for p in target.rglob("*")}
    assert after == before - {"poses.csv"}  # of the old result, not of the new one
    assert (target / MARKER).read_text() == "new result"
    assert (target / "part" / "mine.txt").read_text() == "mine in part"
    assert (target / "data" / "link").read_text() == "notes"
    backup = tmp_path / "res.bak"
    assert {str(p.relative_to(backup)) for p in backup.rglob("*")} == before
    assert (backup / MARKER).read_text() == "old result"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["res", "res.bak"]


@pytest.mark.parametrize("folder", [False, True])
def test_no_backup_is_ever_replaced(folder: bool, tmp_path: Path) -> None:
    """All that was ever replaced is kept, and what somebody changed in it."""
    target, file = tmp_path / "out", MARKER if folder else ""
    for text in ("one", "two", "three"):
        write(target, text, folder=folder)
    (tmp_path / "out.bak2" / file).write_text("changed by hand")
    write(target, "four", folder=folder)
    texts = {place.name: (place / file).read_text().split()[0] for place in tmp_path.iterdir()}
    assert texts == {"out": "four", "out.bak": "one", "out.bak2": "changed", "out.bak3": "three"}


def test_modes_and_other_names_stay(tmp_path: Path) -> None:
    """A private file stays private; another name of a replaced file keeps what it was."""
    target = tmp_path / "out"
    target.write_text("old")
    target.chmod(0o600)
    os.link(target, tmp_path / "other")
    write(target, "new", folder=False)
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    assert (tmp_path / "other").read_text() == "old"


def _socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as one:
        here = Path.cwd()
        os.chdir(path.parent)  # a socket's path is short
        one.bind(path.name)
        os.chdir(here)


def _below_users(name: str, make: Callable[[Path], object]) -> Callable[[Path], object]:
    """Return what makes a folder of a result and of the user, with something odd in it."""

    def made(target: Path) -> None:
        one = users(target) / name
        if one.is_file():
            one.unlink()
        make(one)

    return made


def _beside(name: str, make: Callable[[Path], object], folder: bool) -> Callable[[Path], object]:
    """Return what makes a target, and something beside it."""

    def made(target: Path) -> None:
        users(target) if folder else target.write_text("old")
        make(target.with_name(name))

    return made


def _link(where: str) -> Callable[[Path], object]:
    return lambda target: target.symlink_to(where)


def _nothing(_: Path) -> None:
    pass


def _text(target: Path) -> None:
    target.write_text(f"{target.name} of the user")


def _folder(target: Path) -> None:
    target.mkdir()
    (target / "user.txt").write_text(f"in {target.name} of the user")


def _pair(target: Path) -> None:
    target.symlink_to("pair")
    target.with_name("pair").symlink_to(target.name)


def _private(target: Path) -> None:
    users(target)
    (target / "data").chmod(0o500)


ODD: dict[str, tuple[str, Callable[[Path], object]]] = {
    "nothing": ("out", _nothing),
    "file": ("out", _text),
    "empty": ("out", lambda target: target.touch()),
    "read-only": ("out", lambda target: (_text(target), target.chmod(0o400))),
    "empty folder": ("out", lambda target: target.mkdir()),
    "folder": ("out", _folder),
    "result": ("out", result),
    "users": ("out", users),
    "marker is a folder": ("out", lambda target: _folder(target / "..") or (target / MARKER).mkdir()
                           if target.is_dir() else target.mkdir() or _folder(target / MARKER)),
    "link to file": ("out", _link("kept.txt")),
    "link to folder": ("out", _link("kept")),
    "link to result": ("out", _link("kept-result")),
    "link to link": ("out", _link("kept-link")),
    "dangling": ("out", _link("absent")),
    "dangling below": ("out", _link("absent/absent")),
    "loop": ("out", _link("out")),
    "pair": ("out", _pair),
    "link to device": ("out", _link("/dev/null")),
    "pipe": ("out", lambda target: os.mkfifo(target)),
    "socket": ("out", _socket),
    "two names": ("out", lambda target: os.link(target.parent / "kept.txt", target)),
    "spaces": ("a b ", _text),
    "newline": ("a\nb", _text),
    "dash": ("-o", _text),
    "unicode": ("ä→", _text),
    "long": ("n" * 255, _text),
    "long, room for bak": ("n" * 251, _text),
    "too long": ("n" * 256, _nothing),
    "dots": (".", _nothing),
    "parent": ("..", _nothing),
    "below a file": ("kept.txt/out", _nothing),
    "below a link": ("kept-link/out", _nothing),
    "absent/..": ("absent/../out", _nothing),
    "through a folder": ("kept/../out", _text),
    "bak file": ("out", _beside("out.bak", _text, False)),
    "bak folder": ("out", _beside("out.bak", _folder, False)),
    "bak link": ("out", _beside("out.bak", _link("kept.txt"), False)),
    "bak nowhere": ("out", _beside("out.bak", _link("absent"), False)),
    "result, bak file": ("out", _beside("out.bak", _text, True)),
    "result, bak folder": ("out", _beside("out.bak", _folder, True)),
    "result, bak empty": ("out", _beside("out.bak", lambda one: one.mkdir(), True)),
    "result, bak users": ("out", _beside("out.bak", users, True)),
    "result, bak link": ("out", _beside("out.bak", _link("kept"), True)),
    "hidden of the user": ("out", _beside(".pincal-notes", _folder, True)),
    "hidden file": ("out", _beside(".pincal-notes", _text, True)),
    "hidden as before": ("out", _beside(".pincal-backup", lambda one: one.mkdir()
                                        or _folder(one / "kept"), True)),
    "hidden empty": ("out", _beside(".pincal-mine", lambda one: one.mkdir(), True)),
    "hidden of 0.1": ("out", _beside(".pincal-abc", lambda one: one.mkdir() or _folder(one / "old"),
                                     True)),
    "file is a folder": ("out", _below_users("residuals.csv", _folder)),
    "own is a folder": ("out", _below_users("poses.csv", _folder)),
    "file is a link": ("out", _below_users("residuals.csv", _link("../kept.txt"))),
    "marker is a link": ("out", _below_users(MARKER, _link("../kept.txt"))),
    "link to itself inside": ("out", _below_users("self", _link("."))),
    "pipe inside": ("out", _below_users("pipe", lambda one: os.mkfifo(one))),
    "socket inside": ("out", _below_users("socket", _socket)),
    "git inside": ("out", _below_users(".git", _folder)),
    "bak inside": ("out", _below_users("result.json.bak", _text)),
    "private inside": ("out", _private),
}  # fmt: skip


@pytest.mark.parametrize("force", [True, False])
@pytest.mark.parametrize("folder", [True, False])
@pytest.mark.parametrize("odd", ODD)
def test_odd_targets(
    odd: str, folder: bool, force: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing that was there is lost; links are followed or refused; nothing hidden is left."""
    place = tmp_path / "here" / "work"
    place.mkdir(parents=True)
    monkeypatch.chdir(place)
    _text(place / "kept.txt")
    _folder(place / "kept")
    result(place / "kept-result")
    (place / "kept-link").symlink_to("kept.txt")
    name, make = ODD[odd]
    make(place / name)
    before = held(tmp_path) - ({b"old residuals"} if odd == "file is a folder" else set())
    links = {p: p.readlink() for p in place.iterdir() if p.is_symlink()}
    hidden = set(place.glob(".pincal-*"))
    with suppress(FileError):
        write(Path(name), "new", folder=folder, force=force)
        write(Path(name), "newer", folder=folder, force=force)
    lost = before - held(tmp_path) - {b"new"} - set(_bytes("new"))
    assert not lost
    if not force:
        assert before <= held(tmp_path)
    assert {p: p.readlink() for p in links if p.is_symlink()} == links
    assert set(place.glob(".pincal-*")) == hidden


def _bytes(text: str) -> list[bytes]:
    return [f"{text} {one}".encode() for one in ("result", "residuals", "urdf")]


def die_at(step: int, folder: Path) -> Callable[[str, tuple[object, ...]], None]:
    """Return a hook that kills the process at a step of its work on the files of a folder."""
    left = [step]

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event.startswith(("os.", "shutil.", "open")) and str(folder) in repr(arguments):
            left[0] -= 1
            if left[0] < 0:
                os.kill(os.getpid(), signal.SIGKILL)

    return hook


def killed(work: Callable[[], object], step: int, folder: Path) -> bool:
    """Do some work in a process that is killed at a step of it; return whether it was."""
    child = os.fork()
    if not child:
        sys.addaudithook(die_at(step, folder))
        work()
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


@pytest.mark.parametrize("folder", some_slow([True, False], True))
def test_killed_at_every_step(folder: bool, tmp_path: Path) -> None:
    """A kill at any step of replacing: the old is there, or the new, or the old as .bak."""
    for step in range(1000):
        place = tmp_path / str(step)
        place.mkdir()
        target = place / "out"
        write(target, "older", folder=folder)
        write(target, "old", folder=folder)
        if folder:
            (target / "notes.txt").write_text(f"notes {step}")
        before = held(target) if folder else {target.read_bytes()}
        dead = killed(partial(write, target, "new", folder=folder), step, place)
        assert before <= held(place), step
        if target.exists() and folder:
            text = (target / MARKER).read_text().split()[0]
            assert set(_bytes(text)) <= held(target), step  # whole
            assert (target / "notes.txt").read_text() == f"notes {step}"
        names = {one.name for one in place.iterdir() if not one.name.startswith(".pincal-")}
        assert names <= {"out", "out.bak", "out.bak2"}
        if not dead:
            break
    assert 10 < step < 999


@pytest.mark.parametrize("kills", some_slow([10, 100], 100))
def test_kills_at_random_moments(kills: int, tmp_path: Path) -> None:
    """Mechanisms are saved over one another and killed at any time: nothing is lost.

    After each the user's own file is there, and a mechanism that loads: at its place, or as the
    last .bak.
    """
    first = pincal.load_mechanism("5R")
    second = pincal.disturb(first, 1e-3, 1)
    target, rng, whole = tmp_path / "mech", random.Random(0), 0
    first.save(target)
    for number in range(kills):
        (target / "notes.txt").write_text(f"notes {number}")
        child = os.fork()
        if not child:
            while True:
                second.save(target, force=True)
                first.save(target, force=True)
        time.sleep(rng.uniform(0.0, 0.03))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        backups = sorted(tmp_path.glob("mech.bak*"), key=lambda one: (len(one.name), one.name))
        last = target if target.exists() else backups[-1]
        whole += last == target
        assert (last / "notes.txt").read_text() == f"notes {number}"
        assert pincal.load_mechanism(last) in (first, second)
        if last != target:
            last.rename(target)
        for one in (*tmp_path.glob("mech.bak*"), *tmp_path.glob(".pincal-*")):
            shutil.rmtree(one)
    assert whole > kills // 2


def test_calibrate_keeps_what_lies_in_the_result(tmp_path: Path) -> None:
    """A user's notes and measurements in an earlier result stay when it is calibrated anew."""
    res, data = tmp_path / "res", tmp_path / "res" / "measured.csv"
    done("workspace", "5R", "--count", 60, "-o", tmp_path / "plan.csv")
    done("simulate", "5R", tmp_path / "plan.csv", "-o", tmp_path / "measured.csv")
    known = ("--noise-position", 1e-4, "--folds", 0, "--no-report")
    done("calibrate", "5R", tmp_path / "measured.csv", *known, "-o", res)
    (tmp_path / "measured.csv").rename(data)
    (res / "notes.txt").write_text("years of work")
    before = data.read_bytes()
    outcome = done("calibrate", "5R", data, *known, "--method", "per-leg", "-o", res, "--force")
    assert data.read_bytes() == before
    assert (res / "notes.txt").read_text() == "years of work"
    assert "replaced res; the old one is now res.bak" in outcome.err
    # its own input is not replaced
    for mech in (res, res / "mechanism"):
        outcome = run("calibrate", mech, data, *known, "-o", res, "--force")
        assert outcome.code == 2
        assert "which this command reads" in outcome.trouble


@pytest.mark.parametrize(
    "line",
    [
        "inverse 5R poses.csv -o poses.csv",
        "forward 5R poses.csv -o ./poses.csv",
        "select 5R --count 12 --candidates poses.csv -o poses.csv",
        "simulate 5R poses.csv -o poses.csv",
        "simulate mech poses.csv -o data.csv --truth mech --disturb 0.001",
        "calibrate mech poses.csv -o mech",
        "import mech/leg_1.urdf --tip tip -o mech/leg_1.urdf",
        "export mech --original mech/leg_1.urdf -o mech/leg_1.urdf",
        "view 5R poses.csv -o poses.csv",
        "select 5R --count 12 --candidates poses.csv -o plan.csv --sheet poses.csv",
    ],
)
def test_inputs_are_not_replaced(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """--force over what the same command reads, by whatever name: refused, all is as it was."""
    monkeypatch.chdir(tmp_path)
    pincal.load_mechanism("5R").save("mech")
    Path("poses.csv").write_text("x [m],y [m]\n0,0.3\n")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert run(*line.split(), "--force").code == 2
    assert {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()} == before


@pytest.mark.parametrize("name", ["mech/mechanism.yaml", "mech/leg_2.urdf", "link.yaml"])
def test_files_of_a_mechanism_that_is_read_are_not_replaced(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files inside a folder that a command reads are its inputs too, by whatever name."""
    monkeypatch.chdir(tmp_path)
    pincal.load_mechanism("5R").save("mech")
    Path("link.yaml").symlink_to("mech/mechanism.yaml")
    Path("poses.csv").write_text("x [m],y [m]\n0,0.3\n")
    before = held(tmp_path)
    outcome = run("inverse", "mech", "poses.csv", "-o", name, "--force")
    assert outcome.code == 2
    assert "which this command reads" in outcome.trouble
    assert held(tmp_path) == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["link.yaml", "mech", "poses.csv"]


def test_what_a_command_does_not_read_may_be_written_beside_its_inputs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table in the folder of the mechanism is the user's, and is made anew by --force."""
    monkeypatch.chdir(tmp_path)
    pincal.load_mechanism("5R").save("mech")
    Path("poses.csv").write_text("x [m],y [m]\n0,0.3\n")
    for _ in range(2):
        done("inverse", "mech", "poses.csv", "-o", "mech/readings.csv", "--force")


def write_pair(place: Path, text: str) -> None:
    """Write a file and a folder that belong together."""
    outputs: list[tuple[Path, tuple[str, ...]]] = [(place / "a", ()), (place / "b", (MARKER,))]
    with writing_together(outputs, force=True) as (file, folder):
        file.write_text(text)
        (folder / MARKER).write_text(text)


@pytest.mark.parametrize("exists", some_slow([True, False], False))
def test_outputs_that_belong_together_never_differ(exists: bool, tmp_path: Path) -> None:
    """A kill at any step of writing two: the first is never beside what it does not belong to."""
    for step in range(1000):
        place = tmp_path / str(step)
        place.mkdir()
        if exists:
            write_pair(place, "old")
        dead = killed(partial(write_pair, place, "new"), step, place)
        first, second = place / "a", place / "b" / MARKER
        if first.exists():
            assert first.read_text() == second.read_text(), step
        assert not exists or {b"old"} <= held(place), step
        if not dead:
            break
    assert 5 < step < 999


def test_what_lies_below_a_folder_of_others_is_not_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is refused at once, however much it holds: a home, or a whole disk."""
    (tmp_path / "home" / "below").mkdir(parents=True)
    monkeypatch.setattr(Path, "rglob", lambda *_: pytest.fail("it was walked through"))
    outcome = run("deploy", "5R", "-o", tmp_path / "home", "--force")
    assert outcome.code == 2
    assert "is not a folder that pincal wrote" in outcome.trouble


def test_outputs_that_belong_together_fail_together(tmp_path: Path) -> None:
    """If the second cannot take its place, the first is as it was, and there is no backup."""
    write_pair(tmp_path, "old")
    with (
        pytest.raises(FileError, match="cannot write"),
        writing_together([(tmp_path / "a", ()), (tmp_path / "c", ())], force=True) as (a, _),
    ):
        a.write_text("new")
    assert (tmp_path / "a").read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "b"]


@pytest.mark.parametrize(
    "line",
    [
        "simulate 5R poses.csv -o out/data.csv --truth out --disturb 0.001",
        "select 5R --count 12 --candidates poses.csv -o plan.csv --sheet ./plan.csv",
    ],
)
def test_outputs_of_one_command_have_places_of_their_own(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One output in another, or twice the same: refused, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    pincal.load_mechanism("5R").save("out")
    Path("poses.csv").write_text("x [m],y [m]\n0,0.3\n")
    before = held(tmp_path)
    assert run(*line.split(), "--force").code == 2
    assert held(tmp_path) == before


def test_temporary_names_are_in_no_message(tmp_path: Path) -> None:
    """What fails below a temporary folder is named as people know it."""
    plan, mechanism = pincal.Plan(np.zeros((1, 2))), pincal.load_mechanism("5R")

    def fail() -> None:
        with writing(tmp_path / "out", folder=WRITTEN) as made:
            (made / "part.csv").mkdir()
            plan.to_csv(made / "part.csv", mechanism)

    with pytest.raises(FileError) as caught:
        fail()
    assert str(tmp_path / "out" / "part.csv") in str(caught.value)
    assert ".pincal-" not in str(caught.value)
