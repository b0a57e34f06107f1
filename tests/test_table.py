"""CSV tables: what is written reads back bit for bit, units convert, bad cells are named."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import unnamed
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from sheets import sheet

import pincal
from pincal import FileError, MeasurementError, PincalError
from pincal.files.columns import reading_columns
from pincal.files.measurements import read_readings
from pincal.files.table import read_table, write_table

Array = NDArray[np.float64]
KINDS = {name: pincal.load_mechanism(name) for name in ("3RRR", "5R")}
THREE = KINDS["3RRR"]
LARGEST = 1e12  # that a number in a file may be
FINITE = st.floats(-LARGEST, LARGEST)
HEADER = "x [m],y [m],phi [rad],leg_1 [rad],leg_2 [rad],leg_3 [rad]"


@st.composite
def measurements(draw: st.DrawFn) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a mechanism and measurements of any numbers, with or without sets and sigmas."""
    mechanism = KINDS[draw(st.sampled_from(sorted(KINDS)))]
    count, legs = draw(st.integers(1, 6)), len(mechanism.legs)

    def numbers(columns: int, values: st.SearchStrategy[float]) -> Array:
        rows = st.lists(values, min_size=count * columns, max_size=count * columns)
        return np.array(draw(rows)).reshape(count, columns)

    dof, positive = mechanism.platform.dof, st.floats(0.0, LARGEST)
    names = st.sampled_from((*mechanism.leg_names, "all", ""))
    sets = tuple(draw(names) for _ in range(count)) if draw(st.booleans()) else None
    return mechanism, pincal.Measurements(
        poses=numbers(dof, FINITE),
        sets=sets,
        readings=numbers(legs, FINITE),
        sigma_poses=numbers(dof, positive) if draw(st.booleans()) else None,
        sigma_readings=numbers(legs, positive) if draw(st.booleans()) else None,
    )


def bits(values: Array | None) -> bytes | None:
    """Return the bytes of an array, in which -0.0 and 0.0 differ."""
    return None if values is None else np.ascontiguousarray(values).tobytes()


def names(folder: Path) -> list[str]:
    """Return the names of what is in a folder."""
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def spare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Path of a table that each example writes anew."""
    return tmp_path_factory.mktemp("tables") / "spare.csv"


@given(drawn=measurements())
@settings(max_examples=100, deadline=None)
def test_measurements_read_back_bit_for_bit(
    spare: Path, drawn: tuple[pincal.Mechanism, pincal.Measurements]
) -> None:
    """Poses, readings, sets and standard deviations are the same bits after a file."""
    mechanism, data = drawn
    data.to_csv(spare, mechanism, force=True)
    back = pincal.Measurements.from_csv(spare, mechanism)
    assert bits(back.poses) == bits(data.poses)
    assert bits(back.readings) == bits(data.readings)
    assert bits(back.sigma_poses) == bits(data.sigma_poses)
    assert bits(back.sigma_readings) == bits(data.sigma_readings)
    assert back.sets == data.sets


@given(drawn=measurements())
@settings(max_examples=50, deadline=None)
def test_poses_and_readings_read_back_bit_for_bit(
    spare: Path, drawn: tuple[pincal.Mechanism, pincal.Measurements]
) -> None:
    """Plans and tables of readings alone are the same bits after a file."""
    mechanism, data = drawn
    pincal.Plan(data.poses, data.sets, data.readings).to_csv(spare, mechanism, force=True)
    plan = pincal.Plan.from_csv(spare, mechanism)
    assert bits(plan.poses) == bits(data.poses)
    assert plan.sets == data.sets
    write_table(spare, reading_columns(mechanism, data.readings), force=True)
    assert bits(read_readings(spare, mechanism)[0]) == bits(data.readings)


def poses_of(path: Path, text: str, encoding: str = "utf-8") -> Array:
    """Return the 3-RRR poses of a file with the given text."""
    path.write_bytes(text.encode(encoding))
    return pincal.Plan.from_csv(path, THREE).poses


@pytest.mark.parametrize(
    ("unit", "factor"),
    [
        ("m", 1.0),
        ("cm", 1e-2),
        ("mm", 1e-3),
        ("um", 1e-6),
        ("\u00b5m", 1e-6),
        ("\u03bcm", 1e-6),
        ("in", 0.0254),
    ],
)
def test_length_units_convert(unit: str, factor: float, tmp_path: Path) -> None:
    """A length in any unit is metres inside; µ may be the micro sign or the Greek letter."""
    poses = poses_of(tmp_path / "t.csv", f"x [{unit}],y [m],phi [rad]\n12.5,-2,3\n-4,5,6\n")
    expected = [[12.5 * factor, -2.0, 3.0], [-4.0 * factor, 5.0, 6.0]]
    np.testing.assert_allclose(poses, expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("unit", "factor"), [("rad", 1.0), ("mrad", 1e-3), ("deg", np.pi / 180), ("°", np.pi / 180)]
)
def test_angle_units_convert(unit: str, factor: float, tmp_path: Path) -> None:
    """An angle in any unit is radians inside."""
    poses = poses_of(tmp_path / "t.csv", f"x [m],y [m],phi [{unit}]\n1,2,-90\n")
    np.testing.assert_allclose(poses, [[1.0, 2.0, -90.0 * factor]], rtol=1e-15)


def test_units_of_sigmas_convert(tmp_path: Path) -> None:
    """Standard deviations are converted as the columns they belong to."""
    sigmas = "sigma_x [mm],sigma_y [um],sigma_phi [deg]," + ",".join(
        f"sigma_leg_{i} [mrad]" for i in (1, 2, 3)
    )
    path = tmp_path / "t.csv"
    path.write_text(f"{HEADER},{sigmas}\n0,0,0,0,0,0,2,3,180,5,6,7\n")
    data = pincal.Measurements.from_csv(path, THREE)
    np.testing.assert_allclose(data.sigma_poses, [[2e-3, 3e-6, np.pi]], rtol=1e-15)
    np.testing.assert_allclose(data.sigma_readings, [[5e-3, 6e-3, 7e-3]], rtol=1e-15)


PLAIN = "x [m],y [m],phi [rad]\n1,2,3\n4,5,6\n"


@pytest.mark.parametrize(
    "text",
    [
        pytest.param("\ufeff" + PLAIN, id="byte-order-mark"),
        pytest.param(PLAIN.replace("\n", "\r\n"), id="crlf"),
        pytest.param(("\ufeff" + PLAIN).replace("\n", "\r\n"), id="excel"),
        pytest.param(PLAIN.rstrip("\n"), id="no-last-newline"),
        pytest.param(PLAIN.replace("4,", "\n ,,\n4,") + "\n\n", id="blank-rows"),
        pytest.param(PLAIN.replace(" [", "["), id="no-space-before-unit"),
        pytest.param(PLAIN.replace(",", " , ").replace("[m]", "[ m ]"), id="more-spaces"),
        pytest.param('"x [m]","y [m]","phi [rad]"\n"1","2","3"\n4.0,5e0,+6\n', id="quoted"),
        pytest.param(
            "phi [rad],note,y [m],x [m]\n3,first,2,1\n6,,5,4\n", id="other-order-and-notes"
        ),
    ],
)
def test_ways_of_writing_one_table(text: str, tmp_path: Path) -> None:
    """Byte order mark, line ends, spaces, quotes, order and further columns change nothing."""
    assert poses_of(tmp_path / "t.csv", text).tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]


def test_written_table_is_plain_text(tmp_path: Path) -> None:
    """A table has units in its header, shortest numbers that read back, and newlines."""
    plan = pincal.Plan(np.array([[0.1, -0.0, 1e-300], [2.0, 1 / 3, 1e22]]), ("leg_1", "all"))
    plan.to_csv(tmp_path / "t.csv", THREE)
    assert (tmp_path / "t.csv").read_bytes() == (
        b"set,x [m],y [m],phi [rad]\nleg_1,0.1,-0.0,1e-300\nall,2.0,0.3333333333333333,1e+22\n"
    )


ROW = "1,2,3,4,5,6"
SIGMAS = ",sigma_x [m],sigma_y [m],sigma_phi [rad]"


def table(*rows: str, header: str = HEADER) -> bytes:
    """Return a measurements file."""
    return "\n".join((header, *rows, "")).encode()


def under(old: str, new: str) -> bytes:
    """Return a measurements file of one row with something else in its header."""
    assert old in HEADER
    return table(ROW, header=HEADER.replace(old, new))


#: What is wrong: the file, and what the message must name besides it.
BAD: dict[str, tuple[bytes, list[str]]] = {
    "empty-file": (b"", ["empty"]),
    "blank-file": (b"\n\n", ["header"]),
    "header-only": (table(), ["rows"]),
    "column-missing": (
        table("1,2,4,5,6", header=HEADER.replace("phi [rad],", "")),
        ["'phi'", "'phi [rad]'", "leg_1", "measured in part"],
    ),
    "reading-missing": (
        table("1,2,3,4,5", header=HEADER.replace(",leg_3 [rad]", "")),
        ["'leg_3'", "[rad]"],
    ),
    "unit-missing": (under("x [m]", "x"), ["'x'", "unit", "'x [m]'"]),
    "unit-empty": (under("x [m]", "x []"), ["'x'", "[m]"]),
    "unit-of-length-for-angle": (under("phi [rad]", "phi [mm]"), ["'phi'", "[mm]", "[deg]"]),
    "unit-of-angle-for-length": (under("x [m]", "x [deg]"), ["'x'", "[deg]", "[mm]"]),
    "unit-unknown": (under("leg_2 [rad]", "leg_2 [turns]"), ["'leg_2'", "[turns]", "[rad]"]),
    "header-malformed": (under("x [m]", "x [m"), ["'x [m'", "unit"]),
    "unit-wrong-in-parentheses": (under("x [m]", "x (°)"), ["'x (°)'", "write 'x [m]'"]),
    "header-nameless": (under("x [m]", "[m]"), ["'[m]'", "name"]),
    "header-twice": (under("y [m]", "x [mm]"), ["'x'", "twice"]),
    "cell-text": (
        table(ROW, "1,two,3,4,5,6"),
        ["line 3: 'two' in column 'y' is not a finite number;"],
    ),
    "cell-empty": (table(ROW, ROW, "1,2,,4,5,6"), ["line 4: empty cell in column 'phi';"]),
    "cell-nan": (table("1,2,3,nan,5,6"), ["line 2", "'nan'", "'leg_1'"]),
    "cell-inf": (table(ROW, "-inf,2,3,4,5,6"), ["line 3", "'-inf'", "'x'"]),
    "cell-overflow": (table("1,1e999,3,4,5,6"), ["line 2", "'1e999'", "'y'"]),
    "cell-after-blank-rows": (table("", ROW, "", "1,2,x,4,5,6"), ["line 5", "'x'", "'phi'"]),
    "cell-comma-decimal": (
        table('"1,5",2,3,4,5,6'),
        ["line 2", "'1,5'", "'x'", "one decimal point"],
    ),
    "cell-with-unit": (table("0.02mm,2,3,4,5,6"), ["line 2", "'x'", "no unit (in the header)"]),
    "cell-comma-decimal-bare": (table("1,5,2,3,4,5,6"), ["line 2", "7 cells", "6"]),
    "cell-underscore": (table("1_0,2,3,4,5,6"), ["line 2", "'1_0'", "'x'"]),
    "row-short": (table(ROW, "1,2,3"), ["line 3", "3 cells", "6"]),
    "column-unnamed": (table(ROW + ",", header=HEADER + ","), ["column 7 has no header"]),
    "row-long": (table("1,2,3,4,5,6,"), ["line 2", "7 cells", "6", "commas at the end"]),
    "quote-open": (table('"1,2,3,4,5,6'), ["CSV", "line 2"]),
    "utf-16": (table(ROW).decode().encode("utf-16"), ["UTF-16 text", "CSV UTF-8"]),
    "utf-16-big": (b"\xfe\xff" + table(ROW).decode().encode("utf-16-be"), ["UTF-16 text"]),
    "utf-16-bare": (table(ROW).decode().encode("utf-16-le"), ["UTF-16 text", "CSV UTF-8"]),
    "utf-16-bare-big": (table(ROW).decode().encode("utf-16-be"), ["UTF-16 text"]),
    "nul": (table(ROW, "1,2,\0,4,5,6"), ["line 3", "NUL"]),
    "binary": (bytes(range(256)), ["UTF-8"]),
    "set-unknown": (
        table("leg_1," + ROW, "leg_9," + ROW, header="set," + HEADER),
        ["line 3", "'leg_9'", "leg_2"],
    ),
    "sigma-negative": (
        table(ROW + ",1,1,1", ROW + ",1,-1,1", header=HEADER + SIGMAS),
        ["line 3", "sigma_y", "negative"],
    ),
    "sigma-missing": (table(ROW + ",1", header=HEADER + ",sigma_x [m]"), ["'sigma_y'"]),
    "sigma-nan": (
        table(ROW + ",1,1,nan", header=HEADER + SIGMAS),
        ["line 2", "'sigma_phi'", "'nan'"],
    ),
}


def _semicolons(data: bytes) -> bytes:
    return data.replace(b",", b";").replace(b".", b",")


OTHERWISE = {
    "semicolons, decimal commas": (_semicolons, "separated by semicolons, decimal commas"),
    "tabs": (lambda data: data.replace(b",", b"\t"), "separated by tabs"),
    "cp1252": (lambda data: data.replace(b"phi [mrad]", b"phi [\xb0]"), "read as cp1252"),
    "Excel in Europe": (
        lambda data: _semicolons(data.replace(b"phi [mrad]", b"phi [\xb0]")),
        "decimal commas",
    ),
    "parentheses": (lambda data: data.replace(b"x [mm]", b"x (mm)"), "as 'x [mm]'"),
    "underscore": (lambda data: data.replace(b"x [mm]", b"x_mm"), "as 'x [mm]'"),
    "blank": (lambda data: data.replace(b"x [mm]", b"x mm"), "as 'x [mm]'"),
    "slash": (lambda data: data.replace(b"x [mm]", b"x/mm"), "as 'x [mm]'"),
    "capitals": (lambda data: data.replace(b"x [mm]", b"X [mm]"), "as 'x [mm]'"),
}


@pytest.mark.parametrize("case", OTHERWISE)
def test_tables_as_people_and_programs_write_them(
    case: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """What can mean one thing only is read, bit for bit alike, and said."""
    header = HEADER.replace("x [m]", "x [mm]").replace("phi [rad]", "phi [mrad]")
    usual = table("1.5,-2,3e-1,4,5,6", "1,2.25,3,0.125,5,6", header=header)
    change, said = OTHERWISE[case]
    logging.getLogger("pincal").propagate = True
    for name, data in (("usual.csv", usual), ("other.csv", change(usual))):
        (tmp_path / name).write_bytes(data)
    with caplog.at_level(logging.INFO, "pincal"):
        other = pincal.Measurements.from_csv(tmp_path / "other.csv", THREE)
    assert said in caplog.text
    if "cp1252" in case or "Europe" in case:
        usual = usual.replace(b"phi [mrad]", b"phi [deg]")
        (tmp_path / "usual.csv").write_bytes(usual)
    expected = pincal.Measurements.from_csv(tmp_path / "usual.csv", THREE)
    assert np.array_equal(other.poses, expected.poses)
    assert np.array_equal(other.readings, expected.readings)


def test_points_and_commas_are_not_mixed(tmp_path: Path) -> None:
    """1,5 beside 2.5 may mean other things elsewhere: the cell is named."""
    path = tmp_path / "mixed.csv"
    path.write_text(HEADER.replace(",", ";") + "\n1,5;2.5;3;4;5;6\n")
    with pytest.raises(MeasurementError, match="one decimal point"):
        pincal.Measurements.from_csv(path, THREE)


@pytest.mark.parametrize(
    ("separator", "cells"),
    [
        (",", ['"1,234.5"', "-0.25", '"12,000"']),
        (";", ["1.234,5", "-0,25", "12.000"]),
        (";", ["1 234,5", "-0,25", "12\u00a0000"]),
        (";", ["1'234.5", "-0.25", "12’000"]),
    ],
)
def test_thousands_are_separated_in_any_way(
    separator: str, cells: list[str], tmp_path: Path
) -> None:
    """1234.5, -0.25 and 12000 as people and programs write them, under titles of their own."""
    path = tmp_path / "thousands.csv"
    head, row = HEADER.replace(",", separator), separator.join([*cells, "4", "5", "6"])
    for titles in (
        "",
        "Measured on Monday\n",
        f"# tracker{separator} day 2\n\nline 2\n",
        "sep=,\n",
    ):
        path.write_text(f"{titles}{head.replace('[rad]', '[deg]').replace('[m]', '[mm]')}\n{row}\n")
        data = pincal.Measurements.from_csv(path, THREE)
        np.testing.assert_allclose(data.poses[0, :2], [1.2345, -0.25e-3])
        np.testing.assert_allclose(np.degrees(data.poses[0, 2]), 12000.0)


@pytest.mark.parametrize("titles", ["", "Measured on Monday\n", "# tracker;day 2\n\n", "sep=;\n"])
def test_no_cell_decides_how_a_number_is_read(titles: str, tmp_path: Path) -> None:
    """A note of 1.234,5 leaves 0.123 and 1.469 as they are; measured beside them it is refused."""
    path = tmp_path / "t.csv"
    head = HEADER.replace(",", ";")
    path.write_text(f"{titles}{head};note\n0.123;1.469;-0.25;4;5;6;1.234,5\n")
    data = pincal.Measurements.from_csv(path, THREE)
    assert data.poses.tolist() == [[0.123, 1.469, -0.25]]
    for decimal in ("0.123", "1.46", "-12.5"):
        path.write_text(f"{titles}{head}\n1.234,5;{decimal};1.469;4;5;6\n")
        with pytest.raises(MeasurementError, match="is not a finite number"):
            pincal.Measurements.from_csv(path, THREE)


def test_columns_of_other_programs_are_mapped(tmp_path: Path) -> None:
    """A header and its name here, with or without a unit, in Python and in a setup's file."""
    path, file = tmp_path / "log.csv", tmp_path / "setup.yaml"
    header = HEADER.replace("leg_1 [rad]", "Actuator 1").replace("x [m]", "Pos X [mm]")
    path.write_bytes(b"Log 7\n" + table(ROW, header=header))
    file.write_text(
        "pincal_setup: 1\ncolumns: {Actuator 1: 'leg_1 [deg]', Pos X: x}\n", encoding="utf-8"
    )
    headers = {"Actuator 1": "leg_1 [deg]", "Pos X": "x"}
    for setup in (pincal.Setup(headers=headers), pincal.Setup.from_yaml(file)):
        data = pincal.Measurements.from_csv(path, THREE, setup)
        np.testing.assert_allclose(data.poses, [[1e-3, 2.0, 3.0]])
        np.testing.assert_allclose(data.readings, [[np.radians(4.0), 5.0, 6.0]])
    for wrong, message in (({"Actuator 9": "leg_1"}, "'Actuator 9'"), ({"y": "x"}, "'x'")):
        with pytest.raises(MeasurementError, match=message):
            pincal.Measurements.from_csv(path, THREE, pincal.Setup(headers={**headers, **wrong}))


def test_two_columns_for_one_are_refused(tmp_path: Path) -> None:
    """X (mm) beside X [mm]: neither is taken."""
    path = tmp_path / "twice.csv"
    path.write_bytes(table("1,2,3,4,5,6,7", header=HEADER.replace("x [m]", "x (mm),X [mm]")))
    with pytest.raises(MeasurementError, match="X"):
        pincal.Measurements.from_csv(path, THREE)


@pytest.mark.parametrize("case", BAD)
def test_bad_table_is_refused_by_name(case: str, tmp_path: Path) -> None:
    """A fault raises MeasurementError; its message names the file, the place and the offender."""
    data, named = BAD[case]
    path = tmp_path / "measured.csv"
    path.write_bytes(data)
    with pytest.raises(MeasurementError) as caught:
        pincal.Measurements.from_csv(path, THREE)
    message = str(caught.value)
    assert isinstance(caught.value, PincalError)
    assert message.startswith(str(path))
    assert unnamed(named, message) == [], message


def test_missing_file_is_named(tmp_path: Path) -> None:
    """A file that is not there raises FileError with its path."""
    with pytest.raises(FileError, match=r"absent\.csv: No such file"):
        pincal.Measurements.from_csv(tmp_path / "absent.csv", THREE)


def test_directory_is_named(tmp_path: Path) -> None:
    """A folder in place of a file raises FileError with its path."""
    with pytest.raises(FileError, match=f"{tmp_path}: Is a directory"):
        pincal.Plan.from_csv(tmp_path, THREE)


def test_file_below_a_file_is_named(tmp_path: Path) -> None:
    """A path that leads through a file raises FileError with its path."""
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match=r"t\.csv"):
        read_table(tmp_path / "file" / "t.csv")


def test_existing_table_is_refused(tmp_path: Path) -> None:
    """Without force an existing file is refused by name and stays as it was."""
    (tmp_path / "t.csv").write_text("keep")
    with pytest.raises(FileError, match=r"t\.csv exists"):
        write_table(tmp_path / "t.csv", {"x [m]": [1.0]})
    assert (tmp_path / "t.csv").read_text() == "keep"
    write_table(tmp_path / "t.csv", {"x [m]": [1.0]}, force=True)
    assert (tmp_path / "t.csv").read_text() == "x [m]\n1.0\n"
    assert (tmp_path / "t.csv.bak").read_text() == "keep"
    assert names(tmp_path) == ["t.csv", "t.csv.bak"]


@pytest.mark.parametrize("force", [False, True])
def test_folder_is_not_replaced_by_a_table(force: bool, tmp_path: Path) -> None:
    """A folder is refused as a table's path, with force as without, and keeps what it holds."""
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "measured.csv").write_text("a week of work")
    with pytest.raises(FileError, match="data"):
        write_table(tmp_path / "data", {"x [m]": [1.0]}, force=force)
    assert (tmp_path / "data" / "measured.csv").read_text() == "a week of work"


@pytest.mark.parametrize("force", [False, True])
def test_failed_writing_leaves_nothing(force: bool, tmp_path: Path) -> None:
    """After a failure in mid-writing there is no new file, no scratch, and the old one stays."""
    (tmp_path / "old.csv").write_text("keep")

    def values() -> Iterator[float]:
        yield 1.0
        raise OSError(28, "No space left on device")

    with pytest.raises(FileError, match="No space left"):
        write_table(
            tmp_path / ("old.csv" if force else "new.csv"), {"x [m]": values()}, force=force
        )
    assert names(tmp_path) == ["old.csv"]
    assert (tmp_path / "old.csv").read_text() == "keep"


def test_missing_parent_is_refused(tmp_path: Path) -> None:
    """A table below a folder that does not exist raises FileError that names the folder."""
    with pytest.raises(FileError, match=r"absent does not exist"):
        write_table(tmp_path / "absent" / "t.csv", {"x [m]": [1.0]})
    assert names(tmp_path) == []


def test_columns_without_a_meaning_are_logged(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Columns that nothing reads are named; sets, sigmas and readings are known."""
    extra = ",leg_4 [rad],temperature [degC],set,sigma_phi [rad]"
    path = tmp_path / "t.csv"
    path.write_text(f"{HEADER}{extra}\n{ROW},7,21,all,1\n")
    monitored = logging.getLogger("pincal")
    monitored.propagate = True  # the command line, if it ran before, keeps them to itself
    with caplog.at_level(logging.INFO, logger="pincal"):
        pincal.Plan.from_csv(path, THREE)
    messages = {record.getMessage() for record in caplog.records}
    assert messages == {f"{path}: columns not used: leg_4, temperature"}


CELLS: list[list[str | float]] = [
    [one.strip() for one in HEADER.split(",")],
    [1.5, -2, 3e-1, 4, 5, 6],
    [1, 2.25, 3, 0.125, 5, 6],
]


@pytest.mark.parametrize("commas", [False, True])
def test_spreadsheets_give_what_their_csv_files_give(commas: bool, tmp_path: Path) -> None:
    """Also with blank rows, a margin, and decimal commas in cells that Excel holds for text."""
    (tmp_path / "m.csv").write_bytes(table("1.5,-2,3e-1,4,5,6", "1,2.25,3,0.125,5,6"))
    head, *rows = CELLS
    texts = [[str(one).replace(".", ",") for one in row] for row in rows] if commas else rows
    blank: list[str | float] = [""] * 7
    cells = [blank, [*head, ""], [*texts[0], ""], blank, [*texts[1], ""]]
    sheet(tmp_path / "m.xlsx", cells)
    expected = pincal.Measurements.from_csv(tmp_path / "m.csv", THREE)
    found = pincal.Measurements.from_csv(tmp_path / "m.xlsx", THREE)
    assert np.array_equal(found.poses, expected.poses)
    assert np.array_equal(found.readings, expected.readings)


def test_numbers_of_sheets_have_points_whatever_is_typed_beside_them(tmp_path: Path) -> None:
    """Decimal commas that Excel holds for text, beside numbers and a note of 1.234,5."""
    row = ["1,5", -2, "0,3", 0.123, 5, 6]
    sheet(tmp_path / "m.xlsx", [[*CELLS[0], "note"], [*row, "a"], [*row, "1.234,5"]])
    data = pincal.Measurements.from_csv(tmp_path / "m.xlsx", THREE)
    assert data.poses.tolist() == [[1.5, -2.0, 0.3]] * 2
    assert data.readings.tolist() == [[0.123, 5.0, 6.0]] * 2


def test_cells_that_are_no_numbers_are_quoted_as_they_stand(tmp_path: Path) -> None:
    """One decimal comma beside decimal points: the cell as in the file, its thousands too."""
    path = tmp_path / "t.csv"
    path.write_text(f"{HEADER}\n{ROW}\n".replace(",", ";") + "0.5;1.469,3503;3;4;5;6\n")
    with pytest.raises(MeasurementError, match=r"line 3: '1\.469,3503' in column"):
        pincal.Plan.from_csv(path, THREE)


def test_messages_on_spreadsheets_name_the_row_of_the_sheet(tmp_path: Path) -> None:
    """A cell that is no number below a title, which is skipped: as Excel counts rows."""
    sheet(tmp_path / "m.xlsx", [["Messung vom 3. Mai"], *CELLS, ["n/a", *CELLS[1][1:]]])
    with pytest.raises(MeasurementError, match=r"m.xlsx, row 5: 'n/a'"):
        pincal.Measurements.from_csv(tmp_path / "m.xlsx", THREE)


FLAWS = {
    "error": ('<c t="e"><v>#DIV/0!</v></c>', "#DIV/0! in cell A2 of sheet Messung"),
    "missing": ('<c r="A2" t="e"><f>NA()</f><v>#N/A</v></c>', "#N/A in cell A2 of sheet Messung"),
    "formula": ("<c><f>B2*2</f></c>", "formula that was never computed in cell A2"),
    "openpyxl": ("<c><f>B2*2</f><v></v></c>", "formula that was never computed in cell A2"),
}


@pytest.mark.parametrize("partial", [True, False])
@pytest.mark.parametrize("rows", [1, 2])
@pytest.mark.parametrize("flaw", FLAWS)
def test_cells_without_a_value_are_no_empty_cells(
    flaw: str, rows: int, partial: bool, tmp_path: Path
) -> None:
    """Errors and formulas that were never computed, a whole column too: refused by their cell."""
    cell, words = FLAWS[flaw]
    head, *numbers = CELLS
    sheet(tmp_path / "m.xlsx", [head, *[[cell, *one[1:]] for one in numbers[:rows]]])
    with pytest.raises(MeasurementError) as caught:
        pincal.Measurements.from_csv(tmp_path / "m.xlsx", THREE, partial=partial)
    assert words in str(caught.value)
    assert "correct it or remove the row" in str(caught.value)


def test_formulas_with_values_are_read(tmp_path: Path) -> None:
    """Also those that give an empty text."""
    head, row, _ = CELLS
    value = "<c><f>B2*2</f><v>1.5</v></c>"
    sheet(tmp_path / "m.xlsx", [[*head, "note"], [value, *row[1:], '<c t="str"><f>""</f><v/></c>']])
    assert pincal.Measurements.from_csv(tmp_path / "m.xlsx", THREE).poses[0, 0] == 1.5


def test_a_far_cell_of_a_spreadsheet_is_refused(tmp_path: Path) -> None:
    """A cell in the last column and row takes no memory for all cells before it."""
    sheet(tmp_path / "m.xlsx", [*CELLS, ['<c r="XFD1048576"><v>1</v></c>']])
    text = (tmp_path / "m.xlsx").read_bytes()
    assert len(text) < 3000
    with pytest.raises(MeasurementError, match="too far from the other cells"):
        pincal.Measurements.from_csv(tmp_path / "m.xlsx", THREE)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("m.xlsx", "m.xlsx: no .xlsx file"),
        ("m.xls", "save the table as .xlsx"),
        ("m.ods", "save the table as .xlsx"),
        ("m.parquet", "save the table as CSV"),
    ],
)
def test_files_of_other_kinds_are_refused(name: str, words: str, tmp_path: Path) -> None:
    """The message says what to make of the file, or that it is none of its kind."""
    (tmp_path / name).write_bytes(b"a sheet")
    with pytest.raises(MeasurementError, match=words):
        pincal.Measurements.from_csv(tmp_path / name, THREE)


def test_texts_of_a_spreadsheet_may_be_shared(tmp_path: Path) -> None:
    """Excel holds texts once, in pieces if they are formatted; cells name them by number."""
    head, row, _ = CELLS
    cells = [f'<c t="s"><v>{place}</v></c>' for place in range(len(head))]
    shared = "".join(
        f'<si><r><t>{one[:1]}</t></r><r><t>{one[1:]}</t></r><rPh sb="0" eb="1"><t>n</t></rPh></si>'
        for one in head
    )
    sheet(tmp_path / "m.xlsx", [cells, row], shared)
    (tmp_path / "m.csv").write_bytes(table(",".join(map(str, row))))
    expected = pincal.Measurements.from_csv(tmp_path / "m.csv", THREE)
    found = pincal.Measurements.from_csv(tmp_path / "m.xlsx", THREE)
    assert np.array_equal(found.poses, expected.poses)
