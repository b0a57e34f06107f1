"""Faults of the machine around: full disks, kills, interrupts, closed pipes, bare environments."""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from command_line import contents, done, run
from marks import quick
from measured import workspace

import pincal
from pincal import FileError
from pincal.files.output import writing

PINCAL = [sys.executable, "-W", "error", "-m", "pincal"]
HERE = {"OPENBLAS_NUM_THREADS": "1"}


@contextmanager
def disk_of(size: int) -> Iterator[None]:
    """Let no file grow beyond a size, [bytes], as on a disk that fills up."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with candidates, a plan and measurements of the 5R."""
    folder = tmp_path_factory.mktemp("measured")
    candidates, plan = folder / "candidates.csv", folder / "plan.csv"
    done("workspace", "5R", "--count", 200, "-o", candidates)
    done("select", "5R", "--count", 12, "--candidates", candidates, "--starts", 1, "-o", plan)
    done("simulate", "5R", plan, "-o", folder / "data.csv")
    return folder


@pytest.mark.parametrize(
    ("line", "size"),
    [
        ("workspace 5R --count 100 -o {}/new.csv", 1000),
        ("workspace 5R --count 100 -o {}/new.xlsx", 2000),
        ("calibrate 5R {data} -o {}/new", 0),
        ("calibrate 5R {data} -o {}/new", 1000),
        pytest.param(
            "calibrate 5R {data} -o {}/new", 50_000, marks=pytest.mark.slow
        ),  # all but the report
        ("inverse 5R {plan} -o {}/new.csv", 100),
        ("montecarlo 5R {plan} -o {}/new.csv --machines 1 --tolerance 1mm,1mrad,0.001", 100),
        ("view 5R -o {}/new.png", 1000),
        ("simulate 5R {plan} -o {0}/new.csv --truth {0}/new --disturb 0.001", 1800),
        ("export 3RRR -o {}/new.xml", 2000),
        ("view 5R -o {}/new.html", 100_000),
    ],
)
def test_a_full_disk_leaves_nothing(line: str, size: int, measured: Path, tmp_path: Path) -> None:
    """Writing that fails at any byte: the file is named, exit code 2, nothing stays behind."""
    names = {"data": measured / "data.csv", "plan": measured / "plan.csv"}
    with disk_of(size):
        outcome = run(*line.format(tmp_path, **names).split())
    assert outcome.code == 2
    assert "new" in outcome.trouble
    assert "File too large" in outcome.trouble
    assert contents(tmp_path) == {}


def test_a_folder_that_takes_no_files_is_named() -> None:
    """Where nothing can be created: the file is named, exit code 2."""
    outcome = run("workspace", "5R", "--count", 5, "-o", "/proc/self/new.csv")
    assert outcome.code == 2
    assert "/proc/self/new.csv" in outcome.trouble


@pytest.mark.parametrize("folder", [False, True])
def test_who_comes_second_does_not_replace(folder: bool, tmp_path: Path) -> None:
    """What another process wrote while this one was at work stays, unless --force was said."""
    path = tmp_path / "new"
    for force in (False, True):
        try:
            files = ("result.json",) if folder else ()
            with writing(path, force=force, folder=files) as scratch:
                with writing(path, force=force, folder=files) as other:
                    (other / "result.json" if folder else other).write_text("first")
                (scratch / "result.json" if folder else scratch).write_text("second")
        except FileError as error:
            assert not force
            assert "new exists" in str(error)  # noqa: PT017
        found = (path / "result.json" if folder else path).read_text()
        assert found == ("second" if force else "first")
    backups = [
        tmp_path / name for name in ("new.bak", "new.bak2")
    ]  # the first, and the first again
    assert sorted(tmp_path.iterdir()) == [path, *backups]
    for backup in backups:
        assert (backup / "result.json" if folder else backup).read_text() == "first"


SAVE = """
import os, sys, time
import pincal
mechanism = pincal.load_mechanism("5R")
data = pincal.Measurements.from_csv(sys.argv[1], mechanism)
result = pincal.calibrate(mechanism, data)
text = result.report().html()
class Report:
    def html(self):
        return text
report = Report()
begun = time.monotonic()
result.save(sys.argv[2] + ".timed", force=True, report=report)
print(time.monotonic() - begun, flush=True)
for number in range(int(sys.argv[3])):
    if not sys.stdin.readline():
        break
    child = os.fork()
    if child:
        print(child, flush=True)
        os.waitpid(child, 0)
        print("dead", flush=True)
        continue
    while True:
        try:
            result.save(sys.argv[2], force=True, report=report)
        except pincal.FileError:
            pass
"""


def assert_whole(folder: Path, *, killed: bool = False) -> None:
    """Check that a result folder is whole; a kill may leave the old report as ``.bak``, or none."""
    names = {path.name for path in folder.iterdir()}
    if killed:
        left = (".pincal-", "report.html.bak")  # a second kill leaves .bak2
        names = {name for name in names if not name.startswith(left)} | {"report.html"}
    files = {"result.json", "residuals.csv", "poses.csv", "report.html"}
    assert names == files | {"mechanism", "nominal"}
    json.loads((folder / "result.json").read_text(encoding="utf-8"))
    pincal.load_mechanism(folder / "mechanism")
    report = folder / "report.html"
    if report.exists() or not killed:
        assert report.read_text(encoding="utf-8").endswith("</html>\n")


def _told(saver: subprocess.Popen[str], line: str = "") -> str:
    """Say a line to a process and return the next of its own."""
    assert saver.stdin
    assert saver.stdout
    saver.stdin.write(line)
    saver.stdin.flush()
    return saver.stdout.readline().strip()


@pytest.mark.slow
def test_killed_while_writing(measured: Path, tmp_path: Path) -> None:
    """Two processes write one folder and are killed at any time: it is whole, or not there.

    ``kill -9`` may leave a hidden scratch folder behind, never a result that is not whole.
    """
    times = 50
    rng, target, whole = random.Random(times), tmp_path / "result", 0
    command = [sys.executable, "-c", SAVE, measured / "data.csv", target, str(times)]
    with ExitStack() as running:
        savers = [
            running.enter_context(
                subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            )
            for _ in range(2)
        ]
        longest = 2 * max(float(_told(saver)) for saver in savers)  # two at once take that long
        for _ in range(times):
            children = [int(_told(saver, "\n")) for saver in savers]
            time.sleep(rng.uniform(0.0, longest))
            for child in children:
                os.kill(child, signal.SIGKILL)
                time.sleep(0.002)
            assert [_told(saver) for saver in savers] == ["dead", "dead"]  # not only about to die
            if target.exists():
                assert_whole(target, killed=True)
                whole += 1
    assert whole > times // 4
    allowed = (target.name, ".pincal-")
    assert all(path.name.startswith(allowed) for path in tmp_path.iterdir())


REGION = "workspace 6UPS --kind total-orientation --axis tilt=0:0.05:0.001"
REGION += " --axis torsion=-0.05:0.05:0.005"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "sent"),
    [
        (REGION, signal.SIGINT),
        (REGION, signal.SIGTERM),
        ("select 5R --count 12 --candidates {}/candidates.csv --starts 1000", signal.SIGINT),
        ("calibrate 5R {}/many.csv", signal.SIGINT),
    ],
)
def test_an_interrupt_leaves_nothing(
    line: str, sent: signal.Signals, measured: Path, tmp_path: Path
) -> None:
    """Ctrl-C or a termination once work has begun, which stderr says: no traceback, no file.

    The exit code is that of the signal.
    """
    if "many" in line:  # minutes of work
        mechanism = pincal.load_mechanism("5R")
        poses = workspace("5R", 60_000)
        noise = pincal.Noise(1e-4, 1e-4, 1e-5)
        plan = pincal.simulate(mechanism, mechanism, pincal.Plan(poses), noise).measurements
        plan.to_csv(measured / "many.csv", mechanism, force=True)
    process = subprocess.Popen(
        [*PINCAL, *line.format(measured).split(), "-o", "new"],
        cwd=tmp_path,
        env=os.environ | HERE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr
    while " …" not in (said := process.stderr.readline()):
        assert said, process.wait()
    time.sleep(0.3)
    assert process.poll() is None  # still at work
    process.send_signal(sent)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + sent, err
    assert "Traceback" not in err
    assert contents(tmp_path) == {}


@pytest.mark.parametrize(
    ("redirected", "code"),
    quick(0, [("| true", 0), ("> /dev/full", 4), (">&-", 0), (">&- 2>&- <&-", 0)]),
)
def test_output_that_goes_nowhere(redirected: str, code: int) -> None:
    """A pipe that was closed, a full disk, no output at all: no traceback, a sensible end."""
    line = " ".join([*PINCAL, "mechanisms", redirected])
    ended = subprocess.run(
        ["/bin/sh", "-c", line], env=os.environ | HERE, capture_output=True, text=True, check=False
    )
    assert "Traceback" not in ended.stderr
    assert "Exception" not in ended.stderr
    assert ended.returncode == code, ended.stderr
    assert ("No space left" in ended.stderr) == (code == 4)


CHOOSE = "select 5R --count 6 --candidates {}/candidates.csv --starts 1 -o new.csv"


@pytest.mark.slow
def test_pictures_need_no_cache_and_no_screen(tmp_path: Path) -> None:
    """Matplotlib's notice of where it keeps its fonts is not printed; its backend is no matter."""
    ended = subprocess.run(
        [*PINCAL, "view", "5R", "-o", "a.svg"],
        cwd=tmp_path,
        env=os.environ | HERE | {"MPLCONFIGDIR": "/proc/nothing", "MPLBACKEND": "nonsense"},
        capture_output=True,
        text=True,
    )
    assert (ended.returncode, ended.stderr.splitlines()) == (0, ["drawing …", "wrote a.svg"])


FIT = "calibrate 5R {}/data.csv --no-report --folds 0 -o new.csv"


@pytest.mark.parametrize(
    ("command", "redirected", "code"),
    quick(0, [(FIT, "> /dev/full", 4), (CHOOSE, "2> /dev/full", 0)]),
)
def test_a_result_is_written_though_nothing_can_be_printed(
    command: str, redirected: str, code: int, measured: Path, tmp_path: Path
) -> None:
    """A full stdout has an exit code of its own and one message; a full stderr changes nothing."""
    line = " ".join([*PINCAL, command.format(measured), redirected])
    ended = subprocess.run(
        ["/bin/sh", "-c", line], cwd=tmp_path, env=os.environ | HERE, capture_output=True, text=True
    )
    assert ended.returncode == code, ended.stderr
    assert ("the work is done" in ended.stderr) == (code == 4)
    assert "Traceback" not in ended.stderr
    made = tmp_path / "new.csv"
    # a header, twelve poses, the first again
    assert (made / "result.json").is_file() or len(made.read_text().splitlines()) == 14


@pytest.mark.parametrize("begin", ["-m pincal", "-c 'from pincal_command import main; main()'"])
def test_ctrl_c_is_quiet_from_the_start(begin: str) -> None:
    """Ctrl-C at the first module that the command loads ends it without a traceback."""
    early = (
        "import builtins, os, runpy, signal, sys\n"
        "load = builtins.__import__\n"
        "def interrupted(name, *rest, **named):\n"
        "    if name == 'pincal.cli':\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    return load(name, *rest, **named)\n"
        "builtins.__import__ = interrupted\n"
        "sys.argv[:] = ['pincal', 'mechanisms']\n"
    )
    run_it = "from pincal_command import main\nmain()"
    if begin == "-m pincal":
        run_it = "runpy.run_module('pincal', run_name='__main__')"
    ended = subprocess.run([sys.executable, "-c", early + run_it], capture_output=True, text=True)
    assert ended.returncode in (-signal.SIGINT, 130)
    assert ended.stderr == ""


@pytest.mark.parametrize(
    "line",
    [
        "check 5R",
        pytest.param("calibrate 5R {}/data.csv -o result 2>&1", marks=pytest.mark.slow),
        pytest.param("--help", marks=pytest.mark.slow),
    ],
)
def test_a_reader_that_leaves(line: str, measured: Path, tmp_path: Path) -> None:
    """The reader of ``| head -1`` leaves: the work is done, exit code 0, no noise."""
    command = " ".join([*PINCAL, line.format(measured)])
    ended = subprocess.run(
        ["/bin/bash", "-c", f"set -o pipefail; {command} | (read -r line; echo $line; exec 0<&-)"],
        cwd=tmp_path,
        env=os.environ | HERE,
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0
    assert len(ended.stdout.splitlines()) == 1
    assert "Exception" not in ended.stderr
    assert "Broken" not in ended.stderr
    if "calibrate" in line:
        assert_whole(tmp_path / "result")


@pytest.mark.slow
def test_a_bare_environment(measured: Path, tmp_path: Path) -> None:
    """POSIX locale, no home, display, terminal or PATH, names beyond ASCII: a result as usual.

    Nothing is written into the package.
    """
    bare = {"PATH": "", "HOME": "/nonexistent", "LC_ALL": "C", "MPLBACKEND": "TkAgg"}
    bare |= {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONDONTWRITEBYTECODE": "1"}
    folder = tmp_path / "Messung é 漢"
    folder.mkdir()
    (folder / "données.csv").write_bytes((measured / "data.csv").read_bytes())
    package = Path(pincal.__file__).parent
    before = {path: path.stat().st_mtime_ns for path in package.rglob("*")}
    ended = subprocess.run(
        [*PINCAL, "calibrate", "5R", folder / "données.csv", "-o", folder / "résultat"],
        env=bare | HERE,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        start_new_session=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert b"Traceback" not in ended.stderr
    assert_whole(folder / "résultat")
    assert {path: path.stat().st_mtime_ns for path in package.rglob("*")} == before


def test_no_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a browser the address is printed, with what to do."""
    monkeypatch.setattr("webbrowser.open", lambda _: False)

    class Interrupted:
        def wait(self) -> None:
            raise KeyboardInterrupt

    monkeypatch.setattr("pincal.cli.view.Event", Interrupted)
    monkeypatch.setattr("pincal.show.view.view.PageServer.__init__", lambda *_: None)
    monkeypatch.setattr("pincal.show.view.view.PageServer.url", "http://here/", raising=False)
    monkeypatch.setattr("pincal.show.view.view.PageServer.close", lambda *_: None)
    outcome = run("view", "5R")
    assert outcome.code == 0
    assert outcome.out == "http://here/\n"
    assert "no browser was found" in outcome.err
