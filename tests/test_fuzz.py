"""Any bytes give what saves and loads equal, or an error that names the file; nothing else.

``python -m pytest -m fuzz`` does the same for minutes, with new bytes each time.
"""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import fields
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mangled import mangled
from neighbours import MJCF
from test_formats import CONFIG

import pincal
from pincal import PincalError
from pincal.calibration import result_files
from pincal.files import measurements
from pincal.files.columns import reading_columns
from pincal.files.mechanism_folders import bundled
from pincal.files.table import write_table
from pincal.formats.arm import serial_arm
from pincal.formats.delta_printer import DeltaPrinter
from pincal.formats.firmware import read_klipper, read_reprap, write_klipper, write_reprap
from pincal.formats.mjcf import read_mjcf

PLANE, SPACE = pincal.load_mechanism("3RRR"), pincal.load_mechanism("6UPS")
HEIGHTS = """\
#*# [delta_calibrate]
#*# height0 = 0.1
#*# height0_pos = 25600.000,25600.000,25600.000
#*# height1 = -0.05
#*# height1_pos = 24000.000,26000.000,25000.000
"""
SETUP = """\
pincal_setup: 1
frame: unknown
targets:
  platform: {offset: [0.0, 0.0, 0.1], unknown: true}
  rim: {offset: [0.1, 0.0, 0.05]}
distances:
  cable: {from: [1.0, 2.0, 3.0], target: rim}
"""


def equal(first: object, second: object) -> bool:
    """Return whether two objects of dataclasses hold the same, NaN being NaN."""
    if isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        return np.array_equal(np.asarray(first), np.asarray(second), equal_nan=True)
    if isinstance(first, dict) and isinstance(second, dict):
        return set(first) == set(second) and all(equal(first[k], second[k]) for k in first)
    if isinstance(first, (pincal.Plan, pincal.Measurements)):
        names = [field.name for field in fields(first) if field.name not in ("lines", "written")]
        pairs = [(getattr(first, name), getattr(second, name)) for name in names]
        return all(equal(a, b) for a, b in pairs)
    return first == second


def check_mechanism(mechanism: pincal.Mechanism, folder: Path) -> None:
    """Check that a mechanism is whole: finite, and equal after saving and loading."""
    joints = [joint for leg in mechanism.legs for joint in (*leg.joints, leg.point)]
    numbers = [(*j.placement.xyz, *j.placement.rpy, *j.axis, j.home) for j in joints]
    assert np.isfinite(numbers).all()
    assert np.isfinite([leg.nominal.sum() for leg in mechanism.legs]).all()
    assert np.isfinite(mechanism.platform.home_pose.as_matrix()).all()
    assert pincal.load_mechanism(mechanism.save(folder / "saved", force=True)) == mechanism


def read_mechanism(path: Path) -> None:
    check_mechanism(pincal.load_mechanism(path.parent), path.parent)


def read_arm(path: Path) -> None:
    check_mechanism(pincal.Mechanism.from_urdf(path, "tip"), path.parent)


def read_mjcf_arm(path: Path) -> None:
    check_mechanism(serial_arm(read_mjcf(path), "c"), path.parent)


def read_plan(path: Path) -> None:
    plan = pincal.Plan.from_csv(path, SPACE)
    assert np.isfinite(plan.poses).all()
    plan.to_csv(path, SPACE, force=True)
    assert equal(pincal.Plan.from_csv(path, SPACE), plan)


def read_readings(path: Path) -> None:
    readings = measurements.read_readings(path, PLANE)[0]
    assert np.isfinite(readings).all()
    write_table(path, reading_columns(PLANE, readings), force=True)
    assert equal(measurements.read_readings(path, PLANE)[0], readings)


def read_measurements(path: Path) -> None:
    data = pincal.Measurements.from_csv(path, PLANE)
    assert np.isfinite(data.poses).all()
    assert np.isfinite(data.readings).all()
    data.to_csv(path, PLANE, force=True)
    assert equal(pincal.Measurements.from_csv(path, PLANE), data)


def read_partial(path: Path) -> None:
    data = pincal.Measurements.from_csv(path, SPACE, partial=True)
    data.to_csv(path, SPACE, force=True)
    assert equal(pincal.Measurements.from_csv(path, SPACE, partial=True), data)


def read_setup(path: Path) -> None:
    setup = pincal.Setup.from_yaml(path)
    numbers = [target.offset for target in setup.targets.values()]
    numbers += [distance.point for distance in setup.distances.values()]
    assert np.isfinite(numbers).all()
    assert pincal.Setup(setup.unknown_frame, setup.targets, setup.distances) == setup


def read_result(path: Path) -> None:
    data = result_files.read_result(path.parent)
    assert all(math.isfinite(value) for value in floats(data))
    path.write_text(json.dumps(data), encoding="utf-8")
    assert result_files.read_result(path.parent) == data


def floats(data: object) -> Iterator[float]:
    """Yield the numbers with a point in JSON data."""
    if isinstance(data, float):
        yield data
    for value in data.values() if isinstance(data, dict) else data if type(data) is list else ():
        yield from floats(value)


def check_printer(
    printer: DeltaPrinter,
    path: Path,
    write: Callable[[DeltaPrinter], str],
    read: Callable[[Path], DeltaPrinter],
) -> None:
    """Check that a printer is written and read to its digits, and a whole mechanism if any."""
    path.write_text(write(printer), encoding="utf-8")
    again = read(path)
    for name in ("radius", "arms", "endstops"):
        np.testing.assert_allclose(getattr(again, name), getattr(printer, name), 1e-12, 2e-7)
    turn = np.subtract(again.angles, printer.angles)
    np.testing.assert_allclose(np.exp(1j * turn), 1.0, atol=2e-6)
    check_mechanism(printer.mechanism("printer"), path.parent)


def read_printer_cfg(path: Path) -> None:
    printer, probed = read_klipper(path)
    assert np.isfinite(probed.readings).all()
    assert probed.readings.shape == (len(probed), 3)
    heights, related = probed.poses[:, 2], "distance_1" in probed.extra
    assert np.isfinite(heights).all() or (related and not np.isinf(heights).any())
    check_printer(printer, path, write_klipper, lambda p: read_klipper(p)[0])


def read_config_g(path: Path) -> None:
    def read(file: Path) -> DeltaPrinter:
        return read_reprap(file, "reprap")

    check_printer(read(path), path, write_reprap, read)


def sound(name: str) -> bytes:
    """Return a file of the bundled 3-RRR."""
    return (bundled()["3RRR"] / name).read_bytes()


def rows(header: str, count: int) -> bytes:
    """Return a table of numbers under a header; a column 'set' names legs."""
    names = header.split(",")
    cells = [
        ["leg_1" if name == "set" else f"{0.1 * i - 0.03 * j:.3f}" for j, name in enumerate(names)]
        for i in range(count)
    ]
    return "\n".join([header, *(",".join(row) for row in cells), ""]).encode()


LEGS = ",".join(f"leg_{i} [m]" for i in range(1, 7))
ARM = """\
<robot name="arm"><link name="base"/><link name="upper"/><link name="tip"/><link name="side"/>
<joint name="one" type="revolute"><parent link="base"/><child link="upper"/>
<origin xyz="0.1 0 0.3" rpy="0 0 0.2"/><axis xyz="0 0 1"/><limit lower="-3" upper="3"/></joint>
<joint name="two" type="prismatic"><parent link="upper"/><child link="tip"/>
<origin xyz="0 0.2 0" rpy="0.1 0 0"/><axis xyz="0 1 1"/><limit lower="0.1" upper="0.5"/></joint>
<joint name="off" type="fixed"><parent link="upper"/><child link="side"/></joint></robot>
"""
#: For each reader: the file's name, sound contents, and what reads, checks and writes them.
READERS: dict[str, tuple[str, bytes, Callable[[Path], None]]] = {
    "mechanism": ("mechanism.yaml", sound("mechanism.yaml"), read_mechanism),
    "leg": ("leg_1.urdf", sound("leg_1.urdf"), read_mechanism),
    "platform": ("platform.urdf", sound("platform.urdf"), read_mechanism),
    "arm": ("arm.urdf", ARM.encode(), read_arm),
    "mjcf": ("robot.xml", MJCF.encode(), read_mjcf_arm),
    "plan": ("plan.csv", rows("set,x [mm],y [m],z [m],rx [rad],ry [deg],rz [rad]", 4), read_plan),
    "readings": ("r.csv", rows("leg_1 [rad],leg_2 [rad],leg_3 [deg]", 4), read_readings),
    "measurements": (
        "m.csv",
        rows(
            "set,x [m],y [mm],phi [deg],leg_1 [rad],leg_2 [rad],leg_3 [rad],"
            "sigma_leg_1 [rad],sigma_leg_2 [rad],sigma_leg_3 [rad],run,note",
            4,
        ).replace(b"-", b""),
        read_measurements,
    ),
    "partial": (
        "p.csv",
        rows(f"x [m],y [mm],z [m],yaw [deg],pitch [deg],roll [deg],{LEGS},pose", 4).replace(
            b"0.000", b""
        ),
        read_partial,
    ),
    "setup": ("setup.yaml", SETUP.encode(), read_setup),
    "result": (
        "result.json",
        json.dumps(
            {
                "pincal_result": result_files.FORMAT,
                "legs": [{"name": "leg_1", "rms": 1.5e-5}],
                "x": [1, None],
            }
        )
        .replace(" ", "\n")
        .encode(),
        read_result,
    ),
    "klipper": ("printer.cfg", (CONFIG + HEIGHTS).encode(), read_printer_cfg),
    "reprap": (
        "config.g",
        b"; delta\nM665 L361.676:361.7:361.6 R180.679 H470.070 B150.0 X-0.105 Y0.161 Z0.000\n"
        b"G28 (home)\nM666 X-0.748 Y-0.006 Z0.755 A0.00 B0.00\nn3 m665 r180.5 *71\n",
        read_config_g,
    ),
}
_LONGEST = timedelta(seconds=10)  # of one file, on a machine that others use too
_QUIET = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.function_scoped_fixture]
SHORT = settings(
    max_examples=15,
    deadline=_LONGEST,
    derandomize=True,
    database=None,
    suppress_health_check=_QUIET,
)
LONG = settings(max_examples=3000, deadline=_LONGEST, suppress_health_check=_QUIET)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Copy of the bundled 3-RRR folder, in which each example writes its file anew."""
    return Path(shutil.copytree(bundled()["3RRR"], tmp_path_factory.mktemp("f") / "copy"))


def answers(reader: str, data: bytes, folder: Path) -> None:
    """Check that bytes are read whole, or refused by a PincalError that names the file."""
    name, usual, read = READERS[reader]
    path = folder / name
    path.write_bytes(data)
    try:
        read(path)
    except PincalError as error:
        assert str(folder) in str(error), str(error)  # noqa: PT017
        assert type(error) is not PincalError  # noqa: PT017
    finally:
        path.write_bytes(usual)


@pytest.mark.parametrize("reader", READERS)
def test_sound_files_are_read(reader: str, folder: Path) -> None:
    """What is mangled below is read, saved and read again as it stands."""
    name, usual, read = READERS[reader]
    (folder / name).write_bytes(usual)
    read(folder / name)


@pytest.mark.parametrize("reader", READERS)
@given(data=st.data())
@SHORT
def test_any_bytes_are_read_whole_or_refused_by_name(
    reader: str, folder: Path, data: st.DataObject
) -> None:
    """Fifteen files a reader, the same ones in every run."""
    answers(reader, data.draw(mangled(READERS[reader][1])), folder)


@pytest.mark.fuzz
@pytest.mark.parametrize("reader", READERS)
@given(data=st.data())
@LONG
def test_many_bytes_are_read_whole_or_refused_by_name(
    reader: str, folder: Path, data: st.DataObject
) -> None:
    """Thousands of files a reader, others in every run."""
    answers(reader, data.draw(mangled(READERS[reader][1])), folder)
