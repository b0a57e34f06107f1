"""What is said: numbers to the digits that are known, tables by one description, sentences."""

# ruff: noqa: E501  (a line a code)

from __future__ import annotations

import io
import math
import re
from typing import Any

import numpy as np
import pytest
from jinja2 import meta
from lxml import html as lxml_html
from rich.console import Console

from pincal.words.findings import WORDINGS, finding, sentence, sentences
from pincal.words.numbers import (
    amount,
    capital,
    fixed,
    listed,
    measured,
    percent,
    rounded,
    uncertainty,
)
from pincal.words.table import Cell, Table, quantity
from pincal.words.wording import sentence_templates

EVIL = '<b>"é"\'&amp;|*_$x$\0'
BANNED = ("told", "tell", "hollow", "accused", "doubtful", "stands", "eased", "shaken", "settled")


@pytest.mark.parametrize("half", [3.21e-7, 1e-6, 9.99e-5, 0.0123, 0.5, 4.7, 99.0])
def test_two_digits_of_the_uncertainty(half: float) -> None:
    """The last digit shown is the second of the uncertainty, or the first before the point."""
    step = 10.0 ** -len(fixed(math.pi, half, "1").partition(".")[2])
    assert step <= half
    assert half < 100 * step
    assert float(fixed(math.pi, half, "1")) == pytest.approx(math.pi, abs=0.5001 * step)


def test_numbers_as_people_read_them() -> None:
    """Lengths in mm, small angles in mrad, a value with its ± in one unit."""
    assert amount(1.234e-4, "m") == "0.123 mm"
    assert amount(1.234e-4, "rad") == "0.123 mrad"
    assert amount(0.5, "1") == "0.5"
    assert measured(0.512345, 1.234e-5, "m") == "512.345 ± 0.012 mm"
    assert measured(0.512345, 0.0, "m") == "512.345 mm"
    assert measured(1.0, math.inf) == "1.000000"
    assert (rounded(12.345), rounded(1234.5), percent(0.0123)) == ("12", "1200", "1.2 %")
    assert (listed("a"), listed("abc"), listed("ab", "or")) == ("a", "a, b and c", "a or b")
    assert capital("noise was") == "Noise was"
    assert capital("held-out rows") == "Held-out rows"
    assert [capital(one) for one in ("l of", "leg_1.l is", "2 rows")] == [
        "l of",
        "leg_1.l is",
        "2 rows",
    ]


def test_no_digits_beyond_what_anybody_measures() -> None:
    """No ± 0.000044 mm, no ± 2e-9 rad, no 1e+04: bounds, and digits that mean something."""
    assert measured(0.5, 4.4e-8, "m") == "500.0000 ± < 0.0001 mm"
    assert measured(0.5, 2e-9, "rad") == "28.64789 ± < 0.00001 deg"
    assert measured(0.05213, 0.041) == "0.052 ± 0.041"
    assert amount(4.4e-8, "m") == "< 0.0001 mm"
    assert amount(0.0, "m") == "0 mm"
    assert amount(12.345, "m") == "12300 mm"
    assert amount(1e-12, "1") == "1e-12"
    assert [
        rounded(one, 3) for one in (6.88e-5, 1.234e7, 100.0, -0.5, 0.0, math.inf, math.nan)
    ] == [
        "0.0000688",
        "12300000",
        "100",
        "-0.5",
        "0",
        "inf",
        "nan",
    ]
    for unit, units in (("m", "mm"), ("rad", "mrad")):
        for exponent in np.linspace(-12, 3, 61):
            for text in (
                amount(10.0**exponent, unit),
                measured(1.0, 10.0**exponent, unit),
                uncertainty(10.0**exponent, unit),
            ):
                assert len(text.partition(".")[2].split(" ")[0]) <= 7, (text, units)
                assert "e-" not in text
                assert not re.search(r"0\.0+( |$)", text.partition("±")[2])


def test_a_bound_is_said_of_an_uncertainty_alone_and_has_no_sign() -> None:
    """Not '-< 0.0001 +0.0000', nor a bound in place of a value that equals its uncertainty."""
    assert uncertainty(1e-9, "m") == "< 0.0001"
    assert uncertainty(1.25e-5, "m") == "0.013"
    assert fixed(1e-9, 1e-9, "m") == "0.0000"
    assert fixed(1e-9, 1e-9, "m", sign="+") == "+0.0000"


@pytest.fixture
def table() -> Table:
    """A table of every kind of cell."""
    columns = ("leg", "name", "rms [m]:.4f", "poses", "value", "unit")
    rows = [
        (EVIL, "l", 1.25e-3, 12, quantity(0.5, "m", 1e-5), Cell("m", "mm")),
        (EVIL, "L", math.nan, 9, Cell(0.25, "a quarter"), None),
        ("b", "l", 0.0, 8, Cell(1e-9, uncertainty(1e-9, "m")), ""),
    ]
    return Table("A title", columns, rows, caption="A caption.")


def test_a_table_shows_the_same_everywhere(table: Table) -> None:
    """Terminal and page hold the same cells."""
    cells = table.cells()
    assert [row[0] for row in cells] == [EVIL, EVIL, "b"]
    assert cells[0][2:] == ["1.2500", "12", "500.000", "mm"]
    assert cells[1][2:] == ["", "9", "a quarter", ""]
    assert cells[2][4] == "< 0.0001"
    page = lxml_html.fromstring(table.__html__())
    assert [one.text_content() for one in page.iter("th")][:6] == [
        "leg", "name", "rms [mm]", "poses", "value", "unit",
    ]  # fmt: skip
    shown = [[cell.text_content() for cell in row] for row in page.xpath(".//tbody/tr")]
    assert shown == [[cell.replace("\0", "\ufffd") for cell in row] for row in cells]
    assert not list(page.iter("b"))
    assert table.aligned == ("left", "left", "right", "right", "right", "left")
    numbers = [cell.get("class") for cell in page.xpath(".//tbody/tr")[0]]
    assert numbers == [None, None, "n", "n", "n", None]
    text = str(table)
    assert text.startswith("A title")
    assert text.rstrip().endswith("A caption.")
    assert "500.000" in text


@pytest.mark.parametrize("width", [60, 80, 100])
def test_words_of_a_table_are_whole(width: int) -> None:
    """Where the longest words of all columns fit, cells are broken between words alone."""
    words = [f"leg_{i}.backlash" for i in range(9)]
    rows = [(words[i], " ".join(words), " and ".join(words[:3]), 1e-3 * i) for i in range(3)]
    heads = ("reading", "amplitudes", "likely cause", "F [m]")
    buffer = io.StringIO()
    Console(file=buffer, width=width).print(Table("A title", heads, rows))
    lines = buffer.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    assert set(" ".join(lines).split()) <= {"A", "title", "and", "reading", "amplitudes", "likely",
        "cause", "F", "[mm]", "0", "1", "2", *words, *(word for line in lines for word in line.split()
        if set(word) == {"─"})}  # fmt: skip


def test_a_table_without_rows() -> None:
    """Heads alone are a table too."""
    empty = Table("None", ("a", "b [m]"), [])
    assert empty.aligned == ("left", "left")
    assert "b [mm]" in str(empty)
    assert "<tbody>" in empty.__html__()


#: What all hypotheses have.
COMMON: dict[str, Any] = {
    "legs": (),
    "left": 1e-4,
    "unknown_frame": False,
    "given": 0.051,
    "other_side": 0.0,
}
#: Values of each code, the finding's rows and parameters, and what must be said of them.
SAID: dict[str, tuple[dict[str, Any], tuple[int, ...], tuple[str, ...], str]] = {
    "no-noise": ({}, (), (), "residuals are mere rounding errors: real measurements have noise"),
    "noise-estimated": ({"position": 1e-4, "orientation": None, "reading": 0.0, "units": ["rad"], "pixel": None}, (), (), "0.1 mm in position, readings exact"),
    "chi2-too-large": ({"chi2": 4.0, "dof": 30, "source": "given"}, (), (), "reduced χ² is 4 where 1 is expected: the noise is larger than given, or the model is incomplete; the uncertainties assume that noise"),
    "chi2-too-small": ({"chi2": 0.1, "dof": 30, "source": "repeats"}, (), (), "the noise is smaller than repeated rows show; the uncertainties"),
    "noise-in-other-proportion": ({"ratios": {"positions": 1.4}, "p_value": 1e-5, "reading": 2e-5, "unit": "rad"}, (), (), "the proportions of the given noise are wrong (p = 1e-05): residuals show 140 % of it in positions, and 0.02 mrad in readings, taken as exact"),
    "readings-exact": ({"reading": 1.55e-5, "unit": "rad", "total": 10}, (), (), "readings are taken as exact: if their noise is above 0.0155 mrad, ± of parameters are over a quarter too small, and 10 rows need not show it"),
    "reference-moved": ({"pose": "reference", "quantity": "x", "size": 1.2e-4, "unit": "m", "p_value": 1e-5}, (0, 5, 11), (), "the pose 'reference', measured 3 times, moved: x by 0.12 mm from data row 1 to 12 (p = 1e-05)"),
    "model-lacks": ({"quantity": "reading of leg_1", "term": "angle", "p_value": 1e-5}, (), (), "reading of leg_1: residuals follow the reading itself (p = 1e-05), which the model does not include; likely an eccentric encoder disc, an uneven gear or lead screw"),
    "rows-alike": ({"quantity": "measured x", "correlation": 0.62, "p_value": 1e-5}, (), (), "measured x: residuals of successive rows are correlated (0.62, p = 1e-05), and neither a step nor a steady drift explains it"),
    "step": ({"what": "reading", "name": "leg_2", "size": 1e-3, "unit": "rad", "p_value": 1e-5}, (29,), (), "the reading of leg_2 is off by 1 mrad from data row 30 on (p = 1e-05)"),
    "outliers": ({"total": 60, "sigma": 7.0, "quantity": "x", "off": 6.5, "lacking": False}, (4,), (), "1 of 60 rows does not fit the others: data row 5, by 7.0 σ (x off by 6.5 σ)"),
    "wrong-rows": ({"total": 72, "chi2": 217.0, "without": 1.02, "sigma": 152.0, "quantity": "measured x", "off": 150.0}, (7,), (), "data row 8 does not fit the others, by 152 σ (measured x off by 150 σ): reduced χ² is 217 with it and 1.02 without; this result includes it"),
    "photos-shifted": ({"shift": 1, "given": 0.06, "missed": 6e-5}, (), (), "the photos are 1 row above their readings: corrected for that, the machine as drawn misses the points by 0.06 mm (median) instead of 60 mm"),
    "photos-turned": ({"turn": 90, "given": 0.06, "missed": 6e-5}, (), (), "the photos are turned by 90°: corrected for that"),
    "board-mirrored": ({"board": "b", "given": 0.06, "missed": 6e-5}, (), (), "board 'b' is a mirror image of what it should be: corrected"),
    "board-behind": ({"board": "b"}, (), (), "board 'b' is seen from behind: the print or its points in the setup are mirrored"),
    "boards-exchanged": ({"boards": ("a", "b"), "given": 0.06, "missed": 6e-5}, (), (), "boards 'a' and 'b' are swapped: corrected"),
    "board-scale": ({"board": "b", "scale": 1.016, "given": 0.06, "missed": 6e-5}, (), (), "judged by the machine as drawn, board 'b' is 1.6 % larger than the setup says (an inch for 25 mm?): corrected"),
    "points-left-out": ({"names": ("front a", "side b")}, (3, 8), (), "left out: 2 points in photos: front a of data row 4 and side b of data row 9"),
    "many-outliers": ({"share": 0.2}, (1, 2), (), "20 % of the rows do not fit the others, worst data row 2"),
    "few-poses": ({"legs": ("leg_1", "leg_2"), "poses": 8, "unknowns": 8}, (), (), "leg_1, leg_2: only 8 poses for 8 parameters"),
    "terms-chosen": ({}, (), ("leg_1.sin", "leg_1.cos"), "leg_1.sin, leg_1.cos were added because they fit these measurements"),
    "weakly-determined": ({"parameter": "leg_1.l", "half": 0.12, "unit": "m", "option": "--strict"}, (), ("leg_1.l", "leg_2.l"), "2 parameters are weakly determined, leg_1.l only to ± 0.12 m"),
    "undetermined-held": ({"groups": (("leg_1.l", "leg_1.L"), ("leg_2.k",)), "weak": ("leg_3.l", "leg_3.k")}, (), (), "these measurements do not determine all parameters: leg_1.l and leg_1.L move together; leg_2.k has no effect; leg_3.l and leg_3.k are weakly determined"),
    "far-from-nominal": ({"parameter": "leg_1.gamma", "change": 0.123, "unit": "rad", "options": ("unknown-target",)}, (), ("leg_1.gamma",), "leg_1.gamma changed by +0.123 rad, more than a machine usually differs from its drawing"),
    "zeros-found": ({"changes": (("leg_1.gamma", 0.7, "rad"),)}, (), ("leg_1.gamma",), "reading zeros are far from nominal: leg_1.gamma by 0.7 rad"),
    "held-out-worse": ({"kind": "held-out", "fold": 2, "folds": 5, "held_out": 3.0, "expected": 1.1, "p_value": 1e-6}, (), (), "held-out rows (fold 2 of 5) miss by 3.00 σ where 1.10 σ is expected (p = 1e-06): the model fits its own rows better than the machine"),
    "wrong-verification": ({"total": 6, "sigma": 190.2, "quantity": "measured phi", "off": 199.0}, (32,), (), "1 of 6 verification rows does not fit: data row 33, by 190 σ (measured phi off by 199 σ); the others fit"),
    "bad-rows": ({"worst": 7, "times": 123.4}, (7, 8), (), "data row 8 misses the nominal mechanism by 123 times the median, 1 more row by over 10 times"),
    "readings-still": ({"readings": (("leg_1", 0.5, "rad", 0.3),)}, (), (), "leg_1 reads the same in all rows (0.5 rad), but should vary by 0.3 rad over these poses"),
    "whole-turns": ({"leg": "leg_1", "reading": 6.5, "nominal": 0.25}, (2, 4), (), "leg_1: 2 readings are off by whole turns, the first in data row 3: 6.5 rad in place of 0.25 rad"),
    "other-working-mode": ({"legs": (("leg_1", ("elbow",), 5, 6),)}, (), (), "readings and poses fit if these legs bend the other way than at home in mechanism.yaml: leg_1 (elbow, in 5 of 6 rows)"),
    "not-this-mechanism": ({"leg": "leg_2", "gap": 0.3}, (), (), "leg_2: the measurements miss the nominal mechanism by 30.0 % of a leg's length (median)"),
    "readings-do-not-follow": ({"leg": "leg_1", "left": 0.01, "stroke": 0.02}, (), (), "leg_1: the readings do not follow the poses (mechanisms near the nominal one miss them by 1 % of the leg's length; the stroke is 2 %)"),
    "rows-copied": ({"first": (1, 4), "pairs": 3}, (1, 2, 4), (), "data rows 2 and 5 are identical (and 2 more such pairs) and count once"),
    "noise-too-large": ({"what": "position", "given": 0.1, "unit": "m", "most": 0.02, "size": 1.0}, (), (), "the noise given for the position is 0.1 m, more than 2 % of a leg's length (1 m)"),
    "gauge-base-frame": ({"freedoms": 3, "unknown_frame": True}, (), (), "the base frame (3 freedoms), since the frame of the measurements is unknown"),
    "gauge-platform-frame": ({"freedoms": 1}, (), (), "the platform frame (1 freedom), since the measurements do not show where the platform's points lie in it"),
    "gauge-scale": ({}, (), (), "the scale (1 freedom), since points touched at unknown places"),
    "redundant-parameters": ({"count": 1, "groups": (("cam.x", *(f"tool.{n}_x" for n in range(30))),)}, (), (), "1 parameter is redundant whatever is measured: 1 parameter of cam and 30 parameters of tool move together"),
}  # fmt: skip
#: Values of each hypothesis, and the cause that it names.
CLAUSES: dict[str, tuple[dict[str, Any], str]] = {
    "sign-of-readings": ({"legs": ("leg_1",)}, "the readings of leg_1 have the opposite sign"),
    "sign-of-column": ({"column": "a"}, "a has the opposite sign"),
    "slip": ({"quantity": "reading of leg_1"}, "the reading of leg_1 alone is wrong"),
    "columns-exchanged": ({"columns": ("a", "b")}, "a and b are swapped"),
    "columns-coupled": ({"columns": ("a", "b"), "sign": -1.0}, "a turns by its reading less b"),
    "legs-exchanged": ({"order": (("leg_1", "leg_2"), ("leg_2", "leg_1"))}, "legs are swapped: column leg_2 fits leg_1 and column leg_1 fits leg_2"),
    "unit": ({"units": (("positions", "m", "mm"), ("readings", "rad", "deg"))}, "the positions are in mm under a metre header (1000 times too large) and the readings are in degrees under a radian header (57.3 times too large)"),
    "left-handed-frame": ({"axis": "xy", "orientations_right": True}, "x and y are swapped and the orientations are right"),
    "sign-of-angle": ({"column": "torsion"}, "torsion has the opposite sign"),
    "angles-exchanged": ({"order": (("yaw", "roll"), ("roll", "yaw"))}, "yaw and roll are swapped"),
    "scale-of-readings": ({"factors": (("a", 10.0, "rad"), ("b", 0.25, "m"))}, "the readings of a are 10 times too large, those of b are 4 times too small"),
    "vector-is-angles": ({}, "rx, ry, rz are roll, pitch, yaw"),
    "orientation-inverted": ({}, "the orientations are inverted (those of the base in the platform's frame)"),
    "pose-inverted": ({}, "the poses are inverted (those of the base in the platform's frame)"),
    "rows-shifted": ({"shift": -2}, "the readings are 2 rows above their poses"),
    "reading-offset": ({"offsets": (("leg_1", 0.5, "rad"),)}, "the reading zeros are off: leg_1 by about 0.5 rad"),
    "unknown-frame": ({"unknown_frame": True}, "the poses are in another frame than the base's"),
}  # fmt: skip


def values_of(code: str) -> set[str]:
    """Return the names of the values of a code's findings."""
    return {*SAID[code][0]} if code in SAID else {*COMMON, *CLAUSES[code][0]}


def test_every_code_is_tried() -> None:
    """No code without a test and a sentence."""
    assert set(SAID) | set(CLAUSES) == set(WORDINGS)
    assert all(code == code.lower().replace("_", "-") for code in WORDINGS)


@pytest.mark.parametrize("code", SAID)
def test_what_each_finding_says(code: str) -> None:
    """Its numbers stand in its sentence, in units that people read, in the words of the field."""
    values, rows, parameters, words = SAID[code]
    text = sentence(finding(code, rows, parameters, **values))
    assert words in text
    assert not any(f" {word} " in f" {text} " for word in BANNED)
    assert not text.endswith(".")
    assert "  " not in text


@pytest.mark.parametrize("code", CLAUSES)
def test_what_each_hypothesis_says(code: str) -> None:
    """It begins with its cause, says what that explains, and ends with its remedy."""
    values, words = CLAUSES[code]
    one = finding(code, **(COMMON | values))
    text = sentence(one)
    miss = "the measurements fit the mechanism to 0.01 % of a leg's length (median)"
    assert text.startswith(words)
    assert f": corrected for that, {miss}; as they are, they miss it by 5.1 %. " in text
    assert text.endswith(WORDINGS[code].remedy)


def test_hypotheses_that_explain_alike_are_one_sentence() -> None:
    """Causes and remedies are listed once each; the frame is said of those that need it."""
    sign = finding("sign-of-readings", **COMMON)
    framed = {"left": 2e-4, "legs": ("leg_1",), "unknown_frame": True}
    unit = finding("unit", units=(("readings", "m", "mm"),), **(COMMON | framed))
    (text,) = sentences([sign, unit])
    assert text == (
        "the readings have the opposite sign, or the readings of leg_1 are in mm under a metre "
        "header (1000 times too large) and the poses are in another frame than the base: corrected "
        "for that, the measurements fit the mechanism to 0.01 % of a leg's length "
        "(median); as they are, they miss it by 5.1 %. Change their sign, or the sensor's 'direction' in "
        "mechanism.yaml; or: Correct the units in the headers; or: Give --unknown-frame (in Python "
        "Setup(unknown_frame=True))"
    )
    assert len(sentences([sign, unit, finding("many-outliers", (3,), share=0.2)])) == 2


def test_findings_have_what_their_sentences_need() -> None:
    """A sentence names its finding's values and no other, whichever of its branches is taken."""
    reader = sentence_templates()
    for code, wording in WORDINGS.items():
        named = meta.find_undeclared_variables(reader.parse(f"{wording.says} {wording.remedy}"))
        named -= {"rows", "row", "them", "parameters", *reader.globals}
        unsaid = {"dof"} if code.startswith("chi2") else set(COMMON) if code in CLAUSES else set()
        assert named | unsaid == values_of(code), code


def test_findings_of_some_severities_can_be_asked_for() -> None:
    """Each code has its severity; a code that there is not makes no finding."""
    with pytest.raises(KeyError):
        finding("no-such-code")
    found = [finding("few-poses", legs=("leg_1",), poses=1, unknowns=8)]
    found += [finding("terms-chosen", parameters=("leg_1.sin",))]
    assert [one.severity for one in found] == ["warning", "info"]
    assert len(sentences(found)) == 2
    assert sentences(found, "warning")[0].startswith("leg_1: only 1 pose for 8 parameters")
