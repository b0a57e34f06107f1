"""The studies run, say what they should, and give the same files for the same seed."""

from __future__ import annotations

import csv
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import contents
from matplotlib.figure import Figure

from studies.__main__ import main
from studies.study import Study, markdown
from studies.trials import root_mean_square

pytestmark = pytest.mark.slow

FIGURES = {
    "5R": {"fig_2", "fig_4", "fig_5", "fig_6", "table_3"},
    "3RRR": {"fig_5", "fig_7", "fig_8", "fig_9", "fig_10", "fig_11"},
    "6UPS": {"fig_4", "fig_5", "fig_6", "savings", "observability"},
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A quick run of every study; figures are drawn in one of their two forms."""
    root, draw = tmp_path_factory.mktemp("studies"), Figure.savefig

    def save(figure: Figure, path: Path, **options: Any) -> None:
        if path.suffix == ".png":
            draw(figure, path, **options)
        path.touch()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", save)
        for name in (*FIGURES, "errors"):
            assert main([name, "--quick", "-o", str(root / name)]) == 0
    return {name: root / name for name in FIGURES}


def column(folder: Path, table: str, name: str) -> list[str]:
    """Return the cells of one column of a table, named without its unit."""
    with (folder / "tables" / f"{table}.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    (header,) = (one for one in rows[0] if one.partition(" [")[0] == name)
    return [row[header] for row in rows]


@pytest.mark.parametrize(
    "table", ["5R/table_1_costs", "5R/table_3_costs", "6UPS/eqs_36_to_41_lengths"]
)
def test_tables_of_the_docs_are_as_they_come_now(folders: dict[str, Path], table: str) -> None:
    """Those that a quick run has in full; all of them: ``-m fuzz`` in test_docs."""
    name, _, file = table.partition("/")
    docs = Path(__file__).parents[1] / "docs/studies" / name / "tables" / f"{file}.csv"
    assert (folders[name] / "tables" / docs.name).read_bytes() == docs.read_bytes()


@pytest.mark.parametrize("name", FIGURES)
def test_page_tables_and_figures_belong_together(folders: dict[str, Path], name: str) -> None:
    """Every figure that the page names is there in both forms, every table as CSV."""
    folder = folders[name]
    page = (folder / "study.md").read_text(encoding="utf-8")
    figures = {p.stem for p in (folder / "figures").glob("*.png")}
    assert figures == {p.stem for p in (folder / "figures").glob("*.svg")}
    for figure in figures:
        assert f"(figures/{figure}.png)" in page
    assert all(any(f.startswith(wanted) for f in figures) for wanted in FIGURES[name])
    tables = {p.stem for p in (folder / "tables").glob("*.csv")}
    for table in tables:
        assert f"`tables/{table}.csv`" in page
    assert "against_the_paper" in tables
    assert "--quick" in page


def test_five_bar(folders: dict[str, Path]) -> None:
    """The circle of the papers; no way beats its bound; Table 3's costs."""
    folder = folders["5R"]
    errors = np.array(column(folder, "table_3_parameter_errors", "error"), dtype=float)
    spread = np.array(column(folder, "table_3_parameter_errors", "±"), dtype=float)
    bounds = np.array(column(folder, "table_3_parameter_errors", "Cramér-Rao bound"), dtype=float)
    assert (errors > bounds - 4 * spread).all()
    assert (errors < 2 * bounds).all()
    page = (folder / "study.md").read_text(encoding="utf-8")
    assert "radius 0.645" in page or "radius 0.646" in page
    assert column(folder, "table_3_costs", "cost of inversion")[:2] == ["432", "1728"]


def test_three_rrr(folders: dict[str, Path]) -> None:
    """Permuted readings are reached; orbits gain over the paper's own sets."""
    folder = folders["3RRR"]
    table = "fig_7_articular_symmetry"
    assert column(folder, table, "at the carried pose") == column(folder, table, "readings")
    assert column(folder, "fig_5_workspaces", "kept by rotations") == ["1", "1", "1"]
    gains = dict(
        zip(
            column(folder, "cramer_rao_bounds", "way"),
            map(float, column(folder, "cramer_rao_bounds", "gain")),
            strict=True,
        )
    )
    assert 1.3 < gains["symmetric, all 72 for every leg"] < 1.7
    assert 1.4 < gains["24 orbits (72 poses)"] < 1.8
    before, after = column(folder, "fig_10_accuracy", "position")[:2]
    assert float(before) / float(after) > 20


def test_hexapod(folders: dict[str, Path]) -> None:
    """Leg lengths as printed, workspaces as symmetric as said, a calibration that helps."""
    folder = folders["6UPS"]
    off = [float(v) for v in column(folder, "eqs_36_to_41_lengths", "off by")]
    assert max(off) < 1e-4
    kept = [float(v) for v in column(folder, "figs_5_6_workspaces", "kept by the group")]
    assert kept[0] == 1.0
    assert column(folder, "figs_5_6_workspaces", "at the rim") == ["no", "no"]
    volume, alone = (
        [float(v) for v in column(folder, "figs_5_6_workspaces", name)]
        for name in ("volume", "legs alone")
    )
    assert all(legs > 1.05 * limited for legs, limited in zip(alone, volume, strict=True))
    assert "universal joints within ± 90°" in (folder / "study.md").read_text(encoding="utf-8")
    assert kept[1] == pytest.approx(0.91, abs=0.02)
    assert column(folder, "savings", "same set") == ["yes", "yes"]
    position = [float(v) for v in column(folder, "calibration", "position")]
    assert position[0] > 50 * position[1]


def test_two_runs_give_the_same_files(
    folders: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """``python -m studies`` writes the same text and tables again, in any case of the name.

    Byte for byte, from the same seed. Figures are not drawn again.
    """
    monkeypatch.setattr(Figure, "savefig", lambda _, path, **__: Path(path).touch())
    monkeypatch.delitem(sys.modules, "studies.__main__")  # as in a process of its own
    monkeypatch.setattr(sys, "argv", ["studies", "6ups", "--quick", "-o", str(tmp_path / "again")])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("studies", run_name="__main__")
    assert not ended.value.code
    first, again = contents(folders["6UPS"]), contents(tmp_path / "again")
    assert set(again) == set(first)
    text = [name for name in first if name.endswith((".md", ".csv"))]
    assert len(text) > 5
    for name in text:
        assert first[name] == again[name], name


def test_wrong_studies_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An unknown name, a folder that exists, a missing folder."""
    (tmp_path / "mine").mkdir()
    for name, folder, word in (
        ("delta", "a", "5R, 3RRR, 6UPS"),
        ("5R", "mine", "exists"),
        ("5R", "none/5R", "parent does not"),
    ):
        assert main([name, "-o", str(tmp_path / folder)]) == 2
        assert word in capsys.readouterr().err
    assert contents(tmp_path) == {"mine": None}


def test_tables_in_markdown() -> None:
    """Numbers to four digits and to the right, text to the left."""
    text = markdown({"way": ["a", "b"], "error [m]": [0.000123456, 2.0], "n": [1, 20]})
    assert text.splitlines() == [
        "| way | error [m] | n |",
        "|---|---:|---:|",
        "| a | 0.0001235 | 1 |",
        "| b | 2 | 20 |",
    ]
    study = Study("x", "Title", "Paper")
    study.table("t", "A  table.", {"a": [1]})
    assert "A table. (`tables/t.csv`)" in study.page()


def test_root_mean_square_and_its_standard_error() -> None:
    """The standard error is the spread of the estimate over repeated sets of draws."""
    rng = np.random.default_rng(0)
    found = [root_mean_square(rng.normal(size=(200, 12))) for _ in range(400)]
    means, errors = np.array(found).T
    assert means.mean() == pytest.approx(1.0, abs=0.01)
    assert errors.mean() == pytest.approx(means.std(), rel=0.1)


def test_beyond_geometry(folders: dict[str, Path]) -> None:
    """Errors withdraw the promise, are named, and mended: the limit is kept with their terms."""
    folder = folders["5R"].parent / "errors"
    promised = column(folder, "simulated", "promised")
    assert promised[0] == "1 of 1"
    assert promised[1] == "0 of 1"
    named = column(folder, "simulated", "named")
    assert named[:2] == ["nothing (1)", "readings gravity (1)"]
    before, after, limits = (
        np.array(column(folder, "simulated", name), dtype=float)
        for name in ("off", "off then", "limit then")
    )
    assert (before[1:] > 1.2 * after[1:]).all()
    assert (after < limits).all()
