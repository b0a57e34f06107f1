"""Files of neighbours: what is written reads back to its digits, and says what it cannot hold."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from command_line import done, run
from test_linear_delta import bed, drawn

import pincal
from pincal import FileError, MechanismError
from pincal.formats.delta_printer import DeltaPrinter, delta_printer
from pincal.formats.firmware import read_klipper, read_reprap, write_klipper, write_reprap

#: A ``printer.cfg`` with what Klipper allows: comments, macros, defaults, a SAVE_CONFIG block.
CONFIG = """\
[mcu]
serial: /dev/ttyACM0
[stepper_a]
step_pin: PC2
enable_pin: !PC3
microsteps: 16
rotation_distance: 40
gear_ratio: 3:1, 2:1
position_endstop: 297.05   # nozzle over the bed
arm_length: 333.0 ; rods
[stepper_b]
microsteps = 32
rotation_distance = 40
[stepper_c]
microsteps: 16
full_steps_per_rotation: 400
rotation_distance: 40
arm_length: 332.5
angle: 90.1
[gcode_macro PARK]
gcode:
    G28
    G0 X0 Y0 Z200  # away
[printer]
kinematics: delta
max_velocity: 300
print_radius: 140
#delta_radius: 180

#*# <---------------------- SAVE_CONFIG ---------------------->
#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.
#*#
#*# [printer]
#*# delta_radius = 174.750000
#*#
#*# [stepper_b]
#*# angle = 330.200000
#*# position_endstop = 297.100000
#*#
#*# [stepper_c]
#*# angle = 91.000000
"""


def trilaterate(centres: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Return the lower point on three spheres, shape (3,), by the textbook's formula."""
    p1, p2, p3 = centres
    ex = (p2 - p1) / np.linalg.norm(p2 - p1)
    i = ex @ (p3 - p1)
    ey = (p3 - p1 - i * ex) / np.linalg.norm(p3 - p1 - i * ex)
    ez = np.cross(ex, ey)
    d, j = np.linalg.norm(p2 - p1), ey @ (p3 - p1)
    x = (radii[0] ** 2 - radii[1] ** 2 + d**2) / (2 * d)
    y = (radii[0] ** 2 - radii[2] ** 2 + i**2 + j**2) / (2 * j) - i / j * x
    z = np.sqrt(radii[0] ** 2 - x**2 - y**2)
    points = [p1 + x * ex + y * ey + sign * z * ez for sign in (-1, 1)]
    return min(points, key=lambda point: point[2])


def nozzle(config: dict[str, list[float]], ways: np.ndarray) -> np.ndarray:
    """Return where a firmware believes the nozzle to be, shape (N, 3), [mm].

    Args:
        config: As firmwares hold it: radius, angle, arm, endstop, in mm and degrees.
        ways: Of the carriages down from their endstops, shape (N, 3), [mm].
    """
    (radius,), turn = config["radius"], np.radians(config["angle"])
    arms = np.array(config["arm"])
    tops = np.array(config["endstop"]) + np.sqrt(arms**2 - radius**2)
    towers = radius * np.stack((np.cos(turn), np.sin(turn)), axis=1)
    return np.array([trilaterate(np.column_stack((towers, tops - way)), arms) for way in ways])


write_marlin = partial(write_reprap, firmware="marlin")


def as_klipper(text: str) -> dict[str, list[float]]:
    """Return the numbers of a written ``printer.cfg``, line by line, without a parser."""
    keys = {
        "delta_radius": "radius",
        "angle": "angle",
        "arm_length": "arm",
        "position_endstop": "endstop",
    }
    found: dict[str, list[float]] = {name: [] for name in keys.values()}
    for line in text.splitlines():
        name, _, value = line.partition(": ")
        if name in keys:
            found[keys[name]].append(float(value))
    return found


def as_reprap(text: str) -> dict[str, list[float]]:
    """Return the numbers of written M665 and M666, as RepRapFirmware understands them."""
    lines = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line[0] == "M"}
    first, second = ({word[0]: word[1:] for word in lines[code]} for code in ("M665", "M666"))
    angles = [u + float(first[k]) for u, k in zip((210, 330, 90), "XYZ", strict=True)]
    return {
        "radius": [float(first["R"])],
        "angle": angles,
        "arm": [float(v) for v in first["L"].split(":")],
        "endstop": [float(first["H"]) + float(second[k]) for k in "XYZ"],
    }


def as_marlin(text: str) -> dict[str, list[float]]:
    """Return the numbers of written M665 and M666, as Marlin 2 understands them.

    It lowers each carriage from its endstop by M666, which must not be above 0, to the height H.
    """
    lines = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line[0] == "M"}
    first, second = (
        {word[0]: float(word[1:]) for word in lines[code]} for code in ("M665", "M666")
    )
    assert max(second.values()) == 0.0
    return {
        "radius": [first["R"]],
        "angle": [u + first[k] for u, k in zip((210, 330, 90), "XYZ", strict=True)],
        "arm": [first["L"] + first[k] for k in "ABC"],
        "endstop": [first["H"] - second[k] for k in "XYZ"],
    }


def config_file(folder: Path, text: str = CONFIG, name: str = "printer.cfg") -> Path:
    """Return a file with a text."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_klipper_configurations_are_read(tmp_path: Path) -> None:
    """Defaults of Klipper, its SAVE_CONFIG block, and the rule that options above it win."""
    printer, probing = read_klipper(config_file(tmp_path))
    assert printer.radius == pytest.approx(0.17475)
    np.testing.assert_allclose(np.degrees(printer.angles), [210.0, 330.2, 90.1])
    np.testing.assert_allclose(printer.arms, [0.333, 0.333, 0.3325])
    np.testing.assert_allclose(printer.endstops, [0.29705, 0.2971, 0.29705])
    assert printer.print_radius == pytest.approx(0.14)
    assert len(probing) == 0
    assert printer.remarks == ()


def test_klipper_heights_are_steps_down_from_the_endstops(tmp_path: Path) -> None:
    """Stable positions times the way per step, with gears and full steps; of distances two rows."""
    saved = CONFIG + (
        "#*#\n#*# [delta_calibrate]\n#*# height0 = 0.1\n#*# height0_pos = 1000.000,2000.0,3000.5\n"
        "#*# manual_height0 = -0.2\n#*# manual_height0_pos = 4000,5000,6000\n"
        "#*# distance0 = 65.1\n#*# distance0_pos1 = 1,2,3\n#*# distance0_pos2 = 4,5,6\n"
    )
    _, probing = read_klipper(config_file(tmp_path, saved))
    np.testing.assert_allclose(probing.poses[:, 2], [-2e-4, 1e-4, np.nan, np.nan])
    way = np.array([40 / (200 * 16 * 6), 40 / (200 * 32), 40 / (400 * 16)]) * 1e-3
    steps = [[4000, 5000, 6000], [1000, 2000, 3000.5], [1, 2, 3], [4, 5, 6]]
    np.testing.assert_allclose(probing.readings, steps * way)
    np.testing.assert_allclose(probing.extra["distance_1"], [np.nan] * 3 + [65.1e-3])
    assert probing.contacts["distance_1_to"] == ("", "", "", "3")


def test_what_klipper_includes_is_named(tmp_path: Path) -> None:
    """Included files are not read, whatever they are called, and that is said."""
    for name in ("/dev/zero", "../outside.cfg", "parts/*.cfg", "."):
        printer, _ = read_klipper(config_file(tmp_path, f"[include {name}]\n" + CONFIG))
        assert printer.radius == pytest.approx(0.17475)
        assert f"'include {name}' is not read" in printer.remarks[0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("kinematics: delta", "kinematics: corexy", "kinematics is 'corexy'; expected 'delta'"),
        ("kinematics: delta\n", "", "kinematics is 'not given'"),
        ("arm_length: 333.0 ; rods", "", "no option 'arm_length' in section"),
        ("position_endstop: 297.05 ", "position_endstop: high ", "is 'high'; expected a finite"),
        ("arm_length: 332.5", "arm_length: nan", "'nan'; expected a finite"),
        ("delta_radius = 174.75", "delta_radius = 374.75", "delta radius is 374.75 mm"),
        ("[mcu]", "mcu]", "not a configuration of Klipper"),
    ],
)
def test_what_klipper_would_refuse_is_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    """One message with the file, the section and the option."""
    assert old in CONFIG
    with pytest.raises(MechanismError, match=message) as caught:
        read_klipper(config_file(tmp_path, CONFIG.replace(old, new)))
    assert str(tmp_path / "printer.cfg") in str(caught.value)


def test_heights_without_a_way_per_step_are_refused(tmp_path: Path) -> None:
    """Steps mean nothing without rotation_distance; without heights it is not asked for."""
    text = CONFIG.replace("rotation_distance = 40\n", "")
    read_klipper(config_file(tmp_path, text))
    text += "#*# [delta_calibrate]\n#*# height0 = 0\n#*# height0_pos = 1,2,3\n"
    with pytest.raises(MechanismError, match="no option 'rotation_distance' in section"):
        read_klipper(config_file(tmp_path, text))
    with pytest.raises(MechanismError, match="gear_ratio is '3'"):
        read_klipper(config_file(tmp_path, text.replace("3:1, 2:1", "3")))
    with pytest.raises(FileError, match=r"none\.cfg"):
        read_klipper(tmp_path / "none.cfg")


@pytest.mark.parametrize("firmware", ["klipper", "reprap", "marlin"])
def test_exported_kinematics_are_those_of_the_mechanism(firmware: str) -> None:
    """A firmware's own formulas at the written digits give pincal's positions, less the origin.

    The mechanism has a radius of its own for each tower: their circle's centre is the origin.
    """
    mechanism = drawn(7)
    found = delta_printer(mechanism)
    assert np.linalg.norm(found.origin) > 1e-5
    assert "the printer's origin is at x = " in found.remarks[0]
    poses = np.concatenate([bed(20), bed(20) + np.array([0.01, 0.0, 0.2])])
    ways = 1e3 * pincal.inverse(mechanism, poses).readings
    write, read, digits = {
        "klipper": (write_klipper, as_klipper, 1e-5),
        "reprap": (write_reprap, as_reprap, 1e-3),
        "marlin": (write_marlin, as_marlin, 1e-3),
    }[firmware]
    believed = nozzle(read(write(found)), ways)
    expected = 1e3 * poses - [*(1e3 * np.array(found.origin)), 0.0]
    np.testing.assert_allclose(believed, expected, atol=digits)


@pytest.mark.parametrize(
    ("write", "read", "ending", "digits"),
    [
        (write_klipper, lambda path: read_klipper(path)[0], "cfg", 1e-9),
        (write_reprap, lambda path: read_reprap(path, "reprap"), "g", 1.1e-7),
        (write_marlin, lambda path: read_reprap(path, "marlin"), "g", 1.1e-7),
    ],
)
def test_what_is_exported_is_imported(tmp_path, write, read, ending, digits) -> None:
    """Numbers come back to the digits written; written again, they are the same text."""
    printer = delta_printer(drawn(8))
    text = write(replace(printer, remarks=()))
    path = config_file(tmp_path, text, f"printer.{ending}")
    back = read(path)
    for name in ("radius", "arms", "endstops"):
        np.testing.assert_allclose(getattr(back, name), getattr(printer, name), atol=digits)
    turn = np.subtract(back.angles, printer.angles)
    assert np.abs((turn + np.pi) % (2 * np.pi) - np.pi).max() < 1e-6
    assert write(delta_printer(back.mechanism("again"))) == text


def test_imported_printers_are_the_mechanisms_they_say() -> None:
    """A printer as a mechanism reads as the closed form says, towers wherever they stand."""
    printer = DeltaPrinter(
        0.1, tuple(np.radians([20.0, 150.0, 250.0])), (0.25, 0.26, 0.24), (0.3, 0.31, 0.29)
    )
    mechanism = printer.mechanism("turned")
    found = delta_printer(mechanism)
    for name in ("radius", "angles", "arms", "endstops"):
        wanted = np.array(getattr(printer, name))
        got = np.array(getattr(found, name))
        if name == "angles":
            wanted, got = np.exp(1j * wanted), np.exp(1j * got)
        np.testing.assert_allclose(got, wanted, atol=1e-12)
    poses = bed(20, 0.06) + np.array([0.0, 0.0, 0.05])
    config = {
        "radius": [100.0],
        "angle": [20.0, 150.0, 250.0],
        "arm": [250.0, 260.0, 240.0],
        "endstop": [300.0, 310.0, 290.0],
    }
    ways = 1e3 * pincal.inverse(mechanism, poses).readings
    np.testing.assert_allclose(nozzle(config, ways), 1e3 * poses, atol=1e-9)


def test_what_a_firmware_cannot_hold_is_said() -> None:
    """Gains are told as way per step; other mechanisms and tilted towers are refused."""
    mechanism = pincal.load_mechanism("linear_delta")
    first = mechanism.legs[0]
    gained = replace(first, sensors=(replace(first.sensors[0], gain=1.002),))
    stretched = replace(mechanism, legs=(gained, *mechanism.legs[1:]))
    found = delta_printer(stretched)
    (said,) = found.remarks
    assert "leg_1 moves 1.002000000 mm for each mm" in said
    carriage = mechanism.legs[0].joints[0]
    rpy = (0.001, *carriage.placement.rpy[1:])
    tilted = replace(carriage, placement=replace(carriage.placement, rpy=rpy))
    leg = replace(mechanism.legs[0], joints=(tilted, *mechanism.legs[0].joints[1:]))
    with pytest.raises(MechanismError, match="1 mrad off the vertical"):
        delta_printer(replace(mechanism, legs=(leg, *mechanism.legs[1:])))
    upwards = replace(leg.sensors[0], direction=1)
    leg = replace(mechanism.legs[0], sensors=(upwards,))
    with pytest.raises(MechanismError, match="readings grow upwards"):
        delta_printer(replace(mechanism, legs=(leg, *mechanism.legs[1:])))
    for other in ("3RRR", "4cable", "6UPS"):
        with pytest.raises(MechanismError, match="no linear delta"):
            delta_printer(pincal.load_mechanism(other))


def test_reprap_lines_are_read(tmp_path: Path) -> None:
    """As RepRapFirmware writes them; later lines win letter by letter; comments are none."""
    text = (
        "; M665 L1 R1 H1\nG28 (M665 R2)\n"
        "M665 L361.676:361.7:361.6 R180.679 H470.070 B150.0 X-0.105 Y0.161 Z0.000\n"
        "M666 X-0.748 Y-0.006 Z0.755 A0.00 B0.00\nn3 m665 r180.5 *71\nM92 X200 Y200 Z200\n"
    )
    printer = read_reprap(config_file(tmp_path, text, "config.g"), "reprap")
    assert printer.radius == pytest.approx(0.1805)
    np.testing.assert_allclose(printer.arms, [0.361676, 0.3617, 0.3616])
    np.testing.assert_allclose(np.degrees(printer.angles), [209.895, 330.161, 90.0])
    np.testing.assert_allclose(printer.endstops, [0.469322, 0.470064, 0.470825])
    one = read_reprap(config_file(tmp_path, "M665 L300 R153 H270\n", "config.g"))
    assert one.arms == (0.3, 0.3, 0.3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("M665 L300 H270", "no M665 with R"),
        ("G28", "no M665 with L, R, H"),
        ("M665 L300 R150 H270\nM666 A0.3 B0", "tilts the bed by 0.3 %"),
        ("M665 L300 R150 H270 D80", "line 1: 'D80' is not accepted by M665"),
        ("M665 L300:301 R150 H270", "2 lengths; expected 1, or 3"),
        ("M665 L300 R150 Hx", "'H' of M665 is not a letter and numbers"),
        ("M665 L300 R1-5 H270", "'R1-5' of M665 is not a letter and numbers"),
        ("M665 L300 R350 H270", "a radius above 0 and longer rods"),
    ],
)
def test_what_reprap_lines_do_not_say_is_said(tmp_path: Path, text: str, message: str) -> None:
    """One message with the file and, where there is one, the line."""
    with pytest.raises(MechanismError, match=message):
        read_reprap(config_file(tmp_path, text, "config.g"))


def printed(truth: DeltaPrinter, noise: float) -> str:
    """Return a ``printer.cfg`` of the nominal printer with 41 heights probed by the true one.

    Steps are those of Klipper's formula, rounded as it saves them.
    """
    way = 40 / (200 * 16)  # [mm]
    poses = 1e3 * bed()
    poses[:, 2] = noise * np.random.default_rng(0).normal(size=len(poses))
    turn, arms = np.array(truth.angles), 1e3 * np.array(truth.arms)
    radius = 1e3 * truth.radius
    tops = 1e3 * np.array(truth.endstops) + np.sqrt(arms**2 - radius**2)
    off = (poses[:, None, 0] - radius * np.cos(turn)) ** 2
    off += (poses[:, None, 1] - radius * np.sin(turn)) ** 2
    steps = (tops - poses[:, 2:] - np.sqrt(arms**2 - off)) / way
    motors = "".join(
        f"[stepper_{k}]\nmicrosteps: 16\nrotation_distance: 40\nposition_endstop: 297.05\n"
        "arm_length: 333\n"
        for k in "abc"
    )
    lines = [f"{motors}[printer]\nkinematics: delta\ndelta_radius: 174.75\n"]
    lines += ["#*# <---------------------- SAVE_CONFIG ---------------------->", "#*#"]
    lines += ["#*# [delta_calibrate]"]
    for number, row in enumerate(steps):
        lines += [f"#*# height{number} = 0.0"]
        lines += [f"#*# height{number}_pos = {row[0]:.3f},{row[1]:.3f},{row[2]:.3f}"]
    return "\n".join(lines) + "\n"


@pytest.mark.slow
def test_a_printer_is_calibrated_from_its_configuration(tmp_path: Path) -> None:
    """Import, calibrate, export: at the probed points the written kinematics give the bed.

    Before, they miss it by 0.3 mm and more; after, by 10 µm over the whole bed.
    """
    truth = DeltaPrinter(
        0.1752,
        tuple(np.radians([210.2, 330.1, 90.0])),
        (0.3332, 0.3328, 0.3331),
        (0.2965, 0.2975, 0.2971),
    )
    path = config_file(tmp_path, printed(truth, noise=0.005))
    printer, result, new = tmp_path / "kossel", tmp_path / "result", tmp_path / "new.cfg"
    said = done("import", path, "-o", printer)
    assert "tower b: angle 330.0000°, arm 333.0000 mm, endstop 297.0500 mm" in said.out
    assert "41 probed points" in said.err
    assert pincal.load_mechanism(printer).leg_names == ("tower_a", "tower_b", "tower_c")
    done(
        *("calibrate", "--no-report", printer, printer / "probing.csv", "-o", result),
        *("--noise-position", 5e-6, "--folds", 0),
    )
    said = done("export", result, "-o", new)
    assert "the printer's origin is at" in said.err
    ways = 1e3 * read_klipper(path)[1].readings
    before = nozzle(as_klipper(write_klipper(delta_printer(pincal.load_mechanism(printer)))), ways)
    after = nozzle(as_klipper(new.read_text()), ways)
    assert np.abs(before[:, 2]).max() > 0.3
    assert np.sqrt((after[:, 2] ** 2).mean()) < 0.006
    exact = 1e3 * pincal.inverse(truth.mechanism("truth"), bed(200)).readings
    assert np.abs(nozzle(as_klipper(new.read_text()), exact)[:, 2]).max() < 0.01


def test_import_and_export_refuse_in_words(tmp_path: Path) -> None:
    """Wrong uses end with exit code 2 and one message; nothing is written."""
    path = config_file(tmp_path)
    table = config_file(tmp_path, "x1,y1\n1,2\n", "data.csv")
    far = config_file(tmp_path, "x [mm],y [mm],z [mm]\n0,0,0\n900,0,0\n", "far.csv")
    out = tmp_path / "out"
    for words, message in [
        (("import", path, "-o", out, "--tip", "a"), "leave out --tip"),
        (("import", table, "-o", out), "a table of measurements needs no import"),
        (("import", path, "-o", out, "--probed", far), "point 2 is out of reach"),
        (("export", "5R", "-o", tmp_path / "a.cfg"), "no linear delta"),
        (("export", "linear_delta", "-o", out), "is not known; give it the ending"),
        (("export", "linear_delta", "-o", path), "exists"),
    ]:
        outcome = run(*words)
        assert outcome.code == 2
        assert message in " ".join(outcome.trouble.split())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data.csv", "far.csv", "printer.cfg"]


def test_points_that_a_firmware_believed_become_readings(tmp_path: Path) -> None:
    """``--probed``: where the nozzle was believed to be is where the carriages were; z is 0."""
    path = config_file(tmp_path, "M665 L333 R174.75 H297.05\n", "config.g")
    points = config_file(
        tmp_path, "x [mm],y [mm],z [mm]\n0,0,0.2\n50,0,-0.1\n0,-60,0.05\n", "points.csv"
    )
    done("import", path, "-o", tmp_path / "delta", "--probed", points)
    mechanism = pincal.load_mechanism(tmp_path / "delta")
    data = pincal.Measurements.from_csv(tmp_path / "delta" / "probing.csv", mechanism, partial=True)
    np.testing.assert_array_equal(data.poses[:, 2], 0.0)
    assert np.isnan(data.poses[:, :2]).all()
    config = {
        "radius": [174.75],
        "angle": [210, 330, 90],
        "arm": [333] * 3,
        "endstop": [297.05] * 3,
    }
    believed = nozzle(config, 1e3 * data.readings)
    np.testing.assert_allclose(believed, [[0, 0, 0.2], [50, 0, -0.1], [0, -60, 0.05]], atol=1e-9)
