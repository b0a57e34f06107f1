"""What parameters are, beside their names: kept wherever they go, shown where people read."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import done

import pincal
from pincal.files.mechanism_folders import bundled
from pincal.show.report import report
from pincal.show.tables import nominal_table, parameters_table

FIVE_BAR = pincal.load_mechanism("5R")
OWN = replace(FIVE_BAR, labels={"l": "crank", "leg_2.l": "short crank", "none": "of nothing"})


@pytest.fixture(scope="module")
def result() -> pincal.CalibrationResult:
    """Return a calibration of the five-bar with labels of one's own."""
    poses = pincal.sample_workspace(OWN, 12, seed=0)
    data = pincal.simulate(OWN, pincal.disturb(OWN, 1e-3, seed=1), poses, seed=2).measurements
    return pincal.calibrate(OWN, data)


@pytest.mark.parametrize("name", bundled())
def test_every_parameter_of_a_bundled_mechanism_has_a_label(name: str) -> None:
    mechanism = pincal.load_mechanism(name)
    assert all(one.label for one in mechanism.parameters)
    labels = {pair.partition(": ")[0] for pair in mechanism.labelled.split("; ")}
    assert labels == {one.name for one in mechanism.parameters}


def test_a_label_of_an_id_goes_before_that_of_a_name() -> None:
    """Labels are no numbers: parameters that differ in them alone are equal."""
    found = OWN.parameters
    assert (found["leg_1.l"].label, found["leg_2.l"].label) == ("crank", "short crank")
    assert found["leg_1.L"].label == ""
    assert found["leg_1.l"] == FIVE_BAR.parameters["leg_1.l"]
    assert "none" not in OWN.labelled


def test_labels_are_saved_and_loaded_and_kept_by_other_values(tmp_path: Path) -> None:
    assert pincal.load_mechanism(OWN.save(tmp_path / "own")) == OWN
    assert OWN.with_parameters({"leg_1.l": 0.7}).labels == OWN.labels
    assert pincal.disturb(OWN, 1e-3, seed=0).labels == OWN.labels


def test_files_without_labels_load(tmp_path: Path) -> None:
    """What was written before there were labels is read as it was."""
    bare = replace(FIVE_BAR, labels=())
    folder = bare.save(tmp_path / "bare")
    assert "labels" not in (folder / "mechanism.yaml").read_text()
    assert pincal.load_mechanism(folder) == bare
    assert nominal_table(bare).caption == ""


def test_a_result_keeps_labels(result: pincal.CalibrationResult, tmp_path: Path) -> None:
    folder = result.save(tmp_path / "result")
    again = pincal.load_result(folder)
    assert again["leg_2.l"].label == "short crank"
    assert again.identified.labels == OWN.labels
    kept = json.loads((folder / "result.json").read_text())
    assert kept["legs"][0]["parameters"][0]["label"] == "crank"
    stored = kept["data"]["legs"][0]["parameters"][0]
    del stored["label"]  # as results were saved before
    (folder / "result.json").write_text(json.dumps(kept))
    assert pincal.load_result(folder)["leg_1.l"].label == ""


def test_labels_are_shown(result: pincal.CalibrationResult) -> None:
    """In tables, on pages, in print."""
    for text in (
        str(parameters_table(result)),
        str(nominal_table(OWN)),
        str(OWN),
        str(OWN.parameters),
        report(result).html(),
        *map(str, result.tables()[:1]),
    ):
        assert "short crank" in text
        assert "of nothing" not in text


def test_commands_show_labels(tmp_path: Path) -> None:
    folder = OWN.save(tmp_path / "own")
    assert "leg_2.l: short crank" in done("check", folder).out


def test_printers_that_are_imported_have_the_labels_of_their_template(tmp_path: Path) -> None:
    config = tmp_path / "config.g"
    config.write_text("M665 L333 R174.75 H297.05 B120\nM666 X0 Y0 Z0\n")
    done("import", config, "-o", tmp_path / "printer")
    assert pincal.load_mechanism(tmp_path / "printer").parameters["tower_a.arm"].label == "rods"


@pytest.mark.parametrize(
    "labels", [5, {"l": 3}, {"l": ""}, {"l": "a\nb"}, {"l": "x" * 61}, ("l", "L")]
)
def test_labels_that_cannot_be_shown_are_refused(labels: object) -> None:
    with pytest.raises(pincal.MechanismError, match="labels"):
        replace(FIVE_BAR, labels=labels)


def test_generated_legs_share_labels() -> None:
    elements = (pincal.Element(0.0), pincal.Element.mirror(np.pi / 2))
    made = pincal.generate(
        "bar", FIVE_BAR.legs[0], elements, FIVE_BAR.platform, labels={"L": "rod"}
    )
    assert [made.parameters[f"{leg}.L"].label for leg in made.leg_names] == ["rod", "rod"]
