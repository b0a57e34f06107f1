"""What runs talks to nobody and warns of nothing; what is shipped is whole."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
#: Runs commands after one another where to connect, bind or resolve a name is an error.
_ALONE = """
import socket
import sys

def watch(event, arguments):
    if event in {"socket.connect", "socket.bind", "socket.getaddrinfo", "socket.gethostbyname",
                 "socket.sendto", "socket.sendmsg", "urllib.Request"}:
        print("NETWORK", event, arguments, file=sys.__stderr__, flush=True)
        raise PermissionError(event)

sys.addaudithook(watch)
try:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
    sys.exit("not even loopback is watched")
except PermissionError:
    print("WATCHED", file=sys.stderr)

from pincal.cli import main
for command in sys.argv[1].split(";"):
    try:
        main(command.split())
    except SystemExit as left:
        if left.code:
            raise
"""


@pytest.mark.slow
def test_commands_need_no_network_and_warn_of_nothing(tmp_path: Path) -> None:
    """Workspace, selection, simulation, calibration, report and view: no socket, no warning."""
    commands = ("check 5R", "demo 5R -o {}/demo", "view 5R {}/demo/result -o {}/a.html")
    line = ";".join(commands).replace("{}", str(tmp_path))
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", _ALONE, line], capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    watched, _, rest = run.stderr.partition("WATCHED")
    assert watched.count("NETWORK") == 1  # the test's own
    assert "NETWORK" not in rest
    assert all((tmp_path / name).is_file() for name in ("demo/result/report.html", "a.html"))


def tool(folder: Path, *line: object) -> subprocess.CompletedProcess[str]:
    """Return what a module printed that ``built`` has installed in a folder."""
    command, path = [sys.executable, "-m", *map(str, line)], {"PYTHONPATH": str(folder / "tools")}
    return subprocess.run(command, env=os.environ | path, capture_output=True, text=True)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with sdist and wheel, the wheel built from the sdist; needs the package index."""
    folder = tmp_path_factory.mktemp("built")
    requirements = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["build-system"]
    tools = [*requirements["requires"], "build", "cyclonedx-bom", "twine"]
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-compile", "--target"]
    subprocess.run([*install, folder / "tools", *tools], check=True)
    names = ("pincal", "robots", "studies", "tests", "docs", "examples", "benchmarks", "tools")
    names = (*names, "packaging")
    for name in names:
        ignored = shutil.ignore_patterns("__pycache__", ".*")
        shutil.copytree(ROOT / name, folder / "source" / name, ignore=ignored)
    for path in ROOT.glob("*.*"):
        if path.is_file() and not path.name.startswith("."):
            shutil.copy(path, folder / "source")
    shutil.copy(ROOT / "LICENSE", folder / "source")
    made = tool(folder, "build", "--no-isolation", "-o", folder / "dist", folder / "source")
    assert made.returncode == 0, made.stderr
    return folder / "dist"


@pytest.mark.slow
def test_wheel_and_sdist_hold_what_they_should(built: Path) -> None:
    """The wheel has every module, page asset and robot and no tests; the sdist has these too."""
    (wheel,), (sdist,) = built.glob("*.whl"), built.glob("*.tar.gz")
    names = set(zipfile.ZipFile(wheel).namelist())
    source = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "pincal").rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    robots = {
        f"pincal/{path.relative_to(ROOT)}"
        for path in (ROOT / "robots").rglob("*")
        if path.is_file() and path.suffix != ".pyc"
    }
    assert source <= names
    assert {name for name in robots if name.endswith((".yaml", ".urdf"))} <= names
    assert {name.split("/")[0].split("-")[0] for name in names} == {
        "pincal",
        "pincal_command.py",
        "pincal_studies",
    }
    with tarfile.open(sdist) as file:
        held = {name.partition("/")[2] for name in file.getnames()}
    assert {
        "tests/test_supply.py",
        "docs/dependencies.md",
        "LICENSE",
        "pyproject.toml",
        "CITATION.cff",
    } <= held
    assert source <= held


@pytest.mark.slow
def test_index_will_show_what_was_built(built: Path) -> None:
    """Twine finds nothing to mend: the description renders, and metadata are whole."""
    run = tool(built.parent, "twine", "check", "--strict", *built.iterdir())
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stdout.count("PASSED") == 2


@pytest.mark.slow
def test_built_again_it_is_the_same(built: Path, tmp_path: Path) -> None:
    """Sdist and wheel of the same files are the same bytes, whenever they are built."""
    tool(built.parent, "build", "--no-isolation", "-o", tmp_path, built.parent / "source")

    def sums(folder: Path) -> dict[str, str]:
        return {one.name: hashlib.sha256(one.read_bytes()).hexdigest() for one in folder.iterdir()}

    assert sums(tmp_path) == sums(built)


@pytest.mark.slow
def test_bill_of_materials_names_all_that_comes_along(built: Path, tmp_path: Path) -> None:
    """Each dependency stands in the CycloneDX file with its version and licence."""
    made, project = tmp_path / "sbom.json", ROOT / "pyproject.toml"
    given = ("--no-validate", "--pyproject", project, "-o", made, sys.executable)
    assert tool(built.parent, "cyclonedx_py", "environment", *given).returncode == 0
    parts = {one["name"].lower(): one for one in json.loads(made.read_text())["components"]}
    for name in ("pin", "numpy", "scipy", "lxml", "libpinocchio"):
        assert parts[name]["version"]
        assert parts[name].get("licenses")


@pytest.mark.slow
@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13", "3.14"])
def test_wheel_installs_and_runs_elsewhere(built: Path, version: str, tmp_path: Path) -> None:
    """In a clean environment of each Python there is, the wheel runs without warnings.

    The Python of the tests has its dependencies already; a clean one of it is made by ``.ci/run``.
    """
    python = shutil.which(f"python{version}")
    if python is None or subprocess.run([python, "-V"], capture_output=True).returncode:
        pytest.skip(f"no python{version}")
    (wheel,) = built.glob("*.whl")
    commands = [
        ["-c", "from pincal.files.mechanism_folders import bundled; assert len(bundled()) > 9"],
        ["-m", "pincal", "check", "3RRR"],
    ]
    install, environment = ["-m", "pip", "install", "-q", "--no-compile", wheel], dict(os.environ)
    if version == f"{sys.version_info.major}.{sys.version_info.minor}":
        python, install = sys.executable, [*install, "--no-deps", "--target", tmp_path / "site"]
        environment["PYTHONPATH"] = str(tmp_path / "site")
    else:
        subprocess.run([python, "-m", "venv", tmp_path / "venv"], check=True)
        python = str(tmp_path / "venv" / "bin" / "python")
        demo = str(tmp_path / "venv" / "bin" / "pincal")
        commands.append([demo, "demo", "5R", "-o", str(tmp_path / "demo")])
    subprocess.run([python, *install], check=True)
    for arguments in commands:
        run = subprocess.run(
            [python, "-W", "error", *arguments],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert run.returncode == 0, run.stderr


def test_commands_need_no_extra_package(tmp_path: Path) -> None:
    """Without what the extras install, a command runs, and MJCF says which extra it needs."""
    extras = ("mujoco", "cv2", "distributed")
    code = f"import sys; sys.modules.update(dict.fromkeys({extras}))\n"
    code += "from pincal_command import main\nmain()"
    (tmp_path / "robot.xml").write_text("<mujoco/>")
    new = [sys.executable, "-c", code, "new", "five-bar", "-o", str(tmp_path / "m")]
    assert subprocess.run(new, check=False, capture_output=True).returncode == 0
    read = [sys.executable, "-c", code, "import", str(tmp_path / "robot.xml"), "-o", "none"]
    outcome = subprocess.run(read, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert (outcome.returncode, "pincal[mujoco]" in outcome.stderr) == (2, True)
