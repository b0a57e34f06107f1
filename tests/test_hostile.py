"""Files made to harm: what is too large, endless, leads elsewhere or is ambiguous is refused."""

from __future__ import annotations

import logging
import os
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from shutil import copytree
from threading import Thread

import pytest
from command_line import run
from test_formats import CONFIG, config_file

import pincal
from pincal import FileError, MeasurementError, MechanismError, PincalError
from pincal.calibration.result_files import read_result
from pincal.files.mechanism_folders import bundled, mechanism_files
from pincal.files.table import read_table
from pincal.formats.firmware import read_klipper, read_reprap
from pincal.instruments.board import Board

YAML, LEG, PLATFORM = "mechanism.yaml", "leg_1.urdf", "platform.urdf"
THREE = pincal.load_mechanism("3RRR")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Copy of the bundled 3RRR folder."""
    return Path(copytree(bundled()["3RRR"], tmp_path / "copy"))


def edit(path: Path, old: str, new: str) -> None:
    """Replace a text in a file; it must be there."""
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


READERS: dict[str, Callable[[Path], object]] = {
    YAML: lambda path: pincal.load_mechanism(path.parent),
    LEG: lambda path: pincal.load_mechanism(path.parent),
    PLATFORM: lambda path: pincal.load_mechanism(path.parent),
    "arm.urdf": lambda path: pincal.Mechanism.from_urdf(path, "tip"),
    "poses.csv": lambda path: pincal.Plan.from_csv(path, THREE),
    "setup.yaml": pincal.Setup.from_yaml,
    "result.json": lambda path: read_result(path.parent),
    "printer.cfg": read_klipper,
    "config.g": read_reprap,
}


@pytest.mark.parametrize("name", READERS)
def test_a_gigabyte_is_refused_unread(name: str, folder: Path) -> None:
    """A file of 1 GB is refused by name for its size, in less than a megabyte of memory."""
    with (folder / name).open("wb") as file:
        file.truncate(10**9)
    tracemalloc.start()
    try:
        with pytest.raises(PincalError, match=f"{name}: larger than") as caught:
            READERS[name](folder / name)
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()
    assert str(folder) in str(caught.value)


@pytest.mark.parametrize("name", [YAML, LEG, PLATFORM, "arm.urdf", "setup.yaml", "result.json"])
def test_pipes_are_not_waited_for(name: str, folder: Path) -> None:
    """A pipe that nobody writes to is refused, not waited for."""
    (folder / name).unlink(missing_ok=True)
    os.mkfifo(folder / name)
    with pytest.raises(FileError, match="a device or a pipe"):
        READERS[name](folder / name)


def test_tables_may_come_through_a_pipe(tmp_path: Path) -> None:
    """``pincal inverse 3RRR <(…)`` reads a table."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    writer = Thread(target=path.write_text, args=("x [m],y [m],phi [rad]\n1,2,3\n",))
    writer.start()
    assert pincal.Plan.from_csv(path, THREE).poses.tolist() == [[1.0, 2.0, 3.0]]
    writer.join()


def test_endless_devices_are_left() -> None:
    """Of a device that never ends no more is read than a table may hold."""
    with pytest.raises(MeasurementError, match="/dev/zero: larger than 256 MiB"):
        read_table("/dev/zero")


@pytest.mark.parametrize("name", [YAML, LEG, PLATFORM])
def test_links_out_of_the_folder_are_refused(name: str, folder: Path) -> None:
    """A symbolic link that leaves the mechanism's folder is refused; one inside it is followed."""
    same = pincal.load_mechanism(folder)
    (folder / name).rename(folder / "inside")
    (folder / name).symlink_to("inside")
    assert pincal.load_mechanism(folder) == same
    assert len(mechanism_files(folder)) == 5
    (folder / "inside").rename(folder.parent / "outside")
    (folder / name).unlink()
    (folder / name).symlink_to("../outside")
    with pytest.raises(MechanismError, match=rf"'{name}' leads out of the mechanism's folder"):
        pincal.load_mechanism(folder)


@pytest.mark.parametrize("name", [YAML, LEG, PLATFORM])
def test_links_in_a_circle_are_refused(name: str, folder: Path) -> None:
    """Symbolic links that lead to each other raise one of pincal's errors that names them."""
    (folder / name).unlink()
    (folder / name).symlink_to("other")
    (folder / "other").symlink_to(name)
    with pytest.raises((FileError, MechanismError), match=name):
        pincal.load_mechanism(folder)


@pytest.mark.parametrize(
    "path", ["package://../../etc/passwd", "package://leg_1.urdf", "file:///x"]
)
def test_addresses_are_no_files_of_a_mechanism(path: str, folder: Path) -> None:
    """An address in the place of a leg's file is refused."""
    edit(folder / YAML, "urdf: leg_1.urdf", f"urdf: {path}")
    with pytest.raises((FileError, MechanismError)):
        pincal.load_mechanism(folder)


@pytest.mark.parametrize("name", ["package://../../secret", "../secret", "/dev/zero", "http://x/"])
def test_meshes_are_neither_opened_nor_kept(name: str, folder: Path) -> None:
    """Meshes that a URDF names, wherever they are, are left alone."""
    same = pincal.load_mechanism(folder)
    mesh = f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
    for file in (LEG, PLATFORM):
        root = "leg_1_base" if file == LEG else "platform"
        edit(folder / file, f'<link name="{root}"/>', f'<link name="{root}">{mesh}</link>')
    mechanism = pincal.load_mechanism(folder)
    assert mechanism == same
    saved = mechanism.save(folder.parent / "saved")
    assert not any(b"mesh" in path.read_bytes() for path in saved.iterdir())


@pytest.mark.parametrize("number", ["010", "1:30", "1_0", "0x10", "0b11", "１", "1,5", '"1_0"'])
def test_numbers_with_two_meanings_are_refused(number: str, folder: Path) -> None:
    """What YAML 1.1 or Python take for another number than people do is refused, in all files."""
    edit(folder / YAML, "    k: 1.0\n", f"    k: {number}\n")
    with pytest.raises(MechanismError, match=r"mechanism\.yaml"):
        pincal.load_mechanism(folder)


@pytest.mark.parametrize("number", ["1", "1.0", "+1.0", "1e0", "10.0e-1", "1.", '"1.0"'])
def test_plain_numbers_are_read(number: str, folder: Path) -> None:
    """Every common way to write a number is read."""
    same = pincal.load_mechanism(folder)
    edit(folder / YAML, "    k: 1.0\n", f"    k: {number}\n")
    assert pincal.load_mechanism(folder) == same


@pytest.mark.parametrize("number", ["1_5", "１.5", "1,5", "1.5e13", "-1e13", "0x1p0"])
def test_numbers_of_urdf_and_tables_are_plain(number: str, folder: Path) -> None:
    """Digits of other tongues, underscores, decimal commas and sizes beyond 1e12 are refused."""
    edit(folder / LEG, '"1.5 0.0 0.0"', f'"{number} 0.0 0.0"')
    with pytest.raises(MechanismError, match=r"leg_1\.urdf, line \d+: '.*' is not a finite number"):
        pincal.load_mechanism(folder)
    path = folder / "poses.csv"
    path.write_text(f'x [m],y [m],phi [rad]\n0,0,0\n0,"{number}",0\n', encoding="utf-8")
    with pytest.raises(MeasurementError, match=r"poses\.csv, line 3: '.*' in column 'y'"):
        pincal.Plan.from_csv(path, THREE)


def test_a_name_for_two_points_is_refused(folder: Path) -> None:
    """Points of a platform that share a name, of joint or link, are told by line."""
    edit(folder / PLATFORM, 'joint name="b_2"', 'joint name="b_1"')
    with pytest.raises(MechanismError, match=r"platform\.urdf: two joints are called 'b_1'"):
        pincal.load_mechanism(folder)


@pytest.mark.parametrize("tip", ["leg_1_base", "leg_1_shoulder_link", "leg_2", "a b", "<&\"'>"])
def test_a_tip_may_be_called_anything(tip: str, folder: Path) -> None:
    """Links that saving names itself do not take the tip's name."""
    escaped = tip.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    text = (folder / LEG).read_text().replace("leg_1_base", "b0").replace("shoulder_link", "s0")
    text = text.replace('link name="leg_1_tip"', f'link name="{escaped}"')
    (folder / LEG).write_text(text.replace('link="leg_1_tip"', f'link="{escaped}"'))
    first, rest = (folder / YAML).read_text().split("- name: leg_2")
    quoted = tip.replace("'", "''")
    (folder / YAML).write_text(
        first.replace("tip: leg_1_tip", f"tip: '{quoted}'") + "- name: leg_2" + rest
    )
    mechanism = pincal.load_mechanism(folder)
    assert pincal.load_mechanism(mechanism.save(folder.parent / "saved")) == mechanism


def test_a_point_may_be_called_platform(folder: Path) -> None:
    """The platform's own link does not take a point's name."""
    edit(folder / PLATFORM, '"platform"', '"root"')
    edit(folder / PLATFORM, '"b_1"', '"platform"')
    edit(folder / YAML, "platform_point: b_1", "platform_point: platform")
    edit(folder / YAML, "    b_1:", "    platform:")
    mechanism = pincal.load_mechanism(folder)
    assert pincal.load_mechanism(mechanism.save(folder.parent / "saved")) == mechanism


@pytest.mark.slow
def test_a_million_columns_are_refused(tmp_path: Path) -> None:
    """A header of a million cells, or a row of them, is refused by their number."""
    path = tmp_path / "wide.csv"
    path.write_text(",".join(f"c{i}" for i in range(10**6)) + "\n1\n")
    with pytest.raises(MeasurementError, match=r"wide\.csv: 1000000 columns"):
        read_table(path)
    path.write_text("x [m],y [m],phi [rad]\n1,2,3\n" + "1," * (10**6 - 1) + "1\n")
    with pytest.raises(MeasurementError, match="line 3: 1000000 cells under 3 headers"):
        pincal.Plan.from_csv(path, THREE)


@pytest.mark.parametrize(
    "header", [" " * 100_000 + "]", "x [" + " " * 100_000 + "[", "[" * 100_000]
)
def test_headers_take_no_time(header: str, tmp_path: Path) -> None:
    """A header made to be searched again and again is refused at once, in a short message."""
    (tmp_path / "t.csv").write_text(f"x,{header}\n1,2\n")
    with pytest.raises(MeasurementError, match="not a name with a unit") as caught:
        read_table(tmp_path / "t.csv")
    assert len(str(caught.value)) < 500


def test_mixed_encodings_are_named_by_line(tmp_path: Path) -> None:
    """A table that goes on in another encoding is refused by the line where it does."""
    text = "x [m],y [m],phi [°]\n1,2,3\n"
    (tmp_path / "t.csv").write_bytes(text.encode() + text.encode("latin-1"))
    with pytest.raises(MeasurementError, match=r"t\.csv: not UTF-8 text \(.* in line 3\)"):
        read_table(tmp_path / "t.csv")


def test_names_of_runs_can_be_printed(tmp_path: Path) -> None:
    """A run's name with a line end or an escape in it is refused by its line."""
    header = "x [m],y [m],phi [rad],leg_1 [rad],leg_2 [rad],leg_3 [rad],run\n"
    for name in ('"a\rb"', "\x1b[2J", "a\u2028b"):
        (tmp_path / "t.csv").write_text(f"{header}0,0,0,1,1,1,a\n0,0,0,1,1,1,{name}\n", newline="")
        with pytest.raises(MeasurementError, match=r"line [34]: run .* cannot be printed"):
            pincal.Measurements.from_csv(tmp_path / "t.csv", THREE)


def test_rows_that_tell_nothing_are_skipped_and_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A row with a note alone is none that was measured; a table of such rows is refused."""
    monkeypatch.setattr(logging.getLogger("pincal"), "propagate", True)
    text = "x [m],y [m],phi [rad],leg_1 [rad],leg_2 [rad],leg_3 [rad],note\n0,0,0,1,1,1,\n"
    (tmp_path / "t.csv").write_text(f"{text}, ,,,,,lost\n")
    with caplog.at_level(logging.INFO, "pincal"):
        found = pincal.Measurements.from_csv(tmp_path / "t.csv", THREE, partial=True)
    assert found.lines == (2,)
    assert "1 rows without anything measured or read are skipped" in caplog.text
    (tmp_path / "t.csv").write_text(f"{text.partition('0,0')[0]}, ,,,,,lost\n")
    with pytest.raises(MeasurementError, match="nothing was measured and nothing read"):
        pincal.Measurements.from_csv(tmp_path / "t.csv", THREE, partial=True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"pincal_result": 1, "x": NaN}', "NaN is not a finite number"),
        ('{"pincal_result": 1, "x": -Infinity}', "-Infinity is not a finite number"),
        ('{"pincal_result": 1, "x": 1e400}', "1e400 is not a finite number"),
        ('{"pincal_result": 1, "x": 1, "x": 2}', "'x' appears twice"),
        ('{"pincal_result": 1, "x": ' + "[" * 100_000, "recursion"),
        ('{"pincal_result": 1, "x": ' + "9" * 5000 + "}", "limit"),
        ('{"pincal_result": 1', "delimiter"),
        ("[1]", "not a result of pincal"),
        ('{"pincal_result": 2, "pincal": "0.2.0"}', "saved by pincal 0.2.0"),
    ],
)
def test_results_are_read_whole(text: str, words: str, tmp_path: Path) -> None:
    """Where and why a file is no result is said, such as repeated keys, and what to do."""
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(
        MeasurementError, match=f"{words}.*calibrate the measurements again"
    ) as caught:
        read_result(tmp_path)
    assert str(caught.value).startswith(str(tmp_path / "result.json"))


def test_lines_of_gcode_take_no_time(tmp_path: Path) -> None:
    """Lines made to be searched again and again are read at once."""
    delta = "M665 L300 R150 H270\n"
    text = delta + "(" * 2 * 10**5 + "\nM665 " + "R151 " * 5 * 10**4 + "\n; \u2028M665 R1\n"
    assert read_reprap(config_file(tmp_path, text, "config.g")).radius == pytest.approx(0.151)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("print_radius: 140", "print_radius: -5000", "print radius is -5000 mm"),
        ("print_radius: 140", "print_radius: 0", "print radius is 0 mm"),
        ("arm_length: 333.0", "arm_length: 1e200", "at most 1e"),
        ("gear_ratio: 3:1, 2:1", "gear_ratio: 1e-200:1e200", "travel per step is not above zero"),
        ("height0 = 0.1", "height0 = 1e300", "no number up to"),
        ("25600.000,25600", "1e300,1e300", "no number up to"),
        ("arm_length: 332.5", "arm_length: ３３２", "expected a finite number"),
    ],
)
def test_printers_that_cannot_be_are_refused(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    """Sizes that no arithmetic survives are refused by the file's name."""
    heights = "#*# [delta_calibrate]\n#*# height0 = 0.1\n#*# height0_pos = 25600.000,25600,25600\n"
    text = CONFIG + heights
    assert old in text
    with pytest.raises(MechanismError, match=words) as caught:
        read_klipper(config_file(tmp_path, text.replace(old, new)))
    assert str(tmp_path) in str(caught.value)


def test_names_that_no_file_can_have_are_refused() -> None:
    """A NUL in a path, or one too long, raises FileError from every reader."""
    for name in ("a\0b", "a" * 5000):
        for read in (*READERS.values(), read_table):
            with pytest.raises(FileError):
                read(Path(name) / "x")


@pytest.mark.parametrize("value", ["x" * 5000, "a long value " * 400, "'" * 5000, "é" * 5000])
def test_long_values_do_not_make_long_messages(value: str, tmp_path: Path) -> None:
    """A value of 5,000 characters is cut in the message, which still says where and what to do."""
    table = tmp_path / "poses.csv"
    quoted = value.replace('"', "")
    table.write_text(f'x [m],y [m]\n0,1.1\n0,"{quoted}"\n', encoding="utf-8")
    with pytest.raises(MeasurementError) as caught:
        pincal.Plan.from_csv(table, "5R")
    message = str(caught.value)
    assert len(message) <= 1500
    assert "line 3" in message
    assert "remove the row" in message


@pytest.mark.parametrize("option", ["--starts", "--count", "--verify", "--rounds", "--reference"])
def test_numbers_of_twenty_digits_are_refused(option: str, tmp_path: Path) -> None:
    """Of starts, poses, rounds and rows: refused in words before memory is asked for."""
    line = ("select", "5R", "-o", tmp_path / "plan.csv", option, "9" * 20)
    assert "9" * 20 in run(*line).trouble


@pytest.mark.parametrize("name", ["arm.urdf", "robot.xml", "config.g", "photo.png"])
def test_names_that_are_not_utf8_are_refused_where_they_go_into_files(
    name: str, tmp_path: Path
) -> None:
    """Models, printers and photos are to be renamed; nothing is written."""
    path = tmp_path / os.fsdecode(b"\xe9\xff" + name.encode())
    path.write_bytes(b"<robot name='a'><link name='tip'/></robot>")
    (board := tmp_path / "b.yaml").write_text(Board("b", "charuco", (3, 4), 0.03).yaml())
    words = ["detect", board] if name == "photo.png" else ["import"]
    refused = run(*words, path, "-o", tmp_path / "out")
    assert refused.code == 2
    assert "a name that is not UTF-8 text; rename it" in refused.trouble
    assert {file.name for file in tmp_path.iterdir()} == {path.name, "b.yaml"}
