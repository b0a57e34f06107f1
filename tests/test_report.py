"""The report of a calibration: what it says is what was found, as text, in one file."""

from __future__ import annotations

import io
import math
import re
from base64 import b64decode
from collections import Counter
from dataclasses import replace
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from command_line import done, run
from lxml import etree
from lxml import html as lxml_html
from marks import some_slow
from measured import validated, workspace
from rich.console import Console

import pincal
from pincal.calibration.result_files import as_json
from pincal.estimation.fit import Outlier
from pincal.show.answers import answers, check_lines, summary, supporting_lines
from pincal.show.misses import errors_at, noisy_residuals
from pincal.show.report import Report
from pincal.show.tables import parameters_table, residuals_table
from pincal.words.findings import finding

EVIL = "<script>document.title='Ω'</script><b>\"é\"'&amp;$x_1$ 漢"
NOISE = pincal.Noise(1e-4, 1e-4)
FACTORS = {"mm": 1e3, "deg": 180 / math.pi, "": 1.0}
QUESTIONS = ["Is it better?", "By how much?", "Can I rely on it?", "What next?"]
DATE = "2001-02-03 04:05 +0000"


def measured(
    name: str, count: int, noise: pincal.Noise = NOISE, sigma: float = 2e-3
) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a mechanism and measurements of a disturbed one at poses around home."""
    mechanism = pincal.load_mechanism(name)
    truth = pincal.disturb(mechanism, sigma, seed=1)
    spread = 0.15 if mechanism.platform.kind == "spatial" else 0.3
    shift = np.random.default_rng(2).uniform(-spread, spread, (count, mechanism.platform.dof))
    poses = mechanism.platform.moved(np.tile(mechanism.platform.home, (count, 1)), shift)
    return mechanism, pincal.simulate(mechanism, truth, pincal.Plan(poses), noise, 3).measurements


def drawn(page: Any, name: str) -> Any:
    """Return the SVG of a report's figure as a tree."""
    (image,) = page.get_element_by_id(f"figure-{name}").iter("img")
    return etree.fromstring(b64decode(image.get("src").partition("base64,")[2]))


def page_of(report: Report) -> Any:
    """Return a report as a tree."""
    return lxml_html.fromstring(report.html())


@pytest.fixture(scope="module")
def planar() -> tuple[pincal.CalibrationResult, pincal.Measurements, Report]:
    """Calibration of a 3-RRR with a wrong row, held-out rows, and its report."""
    mechanism, data = measured("3RRR", 40)
    poses = data.poses.copy()
    poses[6, 0] += 3e-3
    data = replace(data, poses=poses)
    options: dict[str, Any] = {"noise": NOISE, "loss": "reject"}
    result = pincal.calibrate(mechanism, data, **options)
    result = replace(result, validation=validated(mechanism, data, **options))
    return result, data, result.report(command="pincal", date=DATE)


@pytest.fixture(scope="module")
def hexapod() -> Report:
    """Report of a 6-UPS, all legs together."""
    mechanism, data = measured("6UPS", 30)
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    errors = errors_at(result, data.poses)  # at poses at hand: to sample the workspace takes long
    return Report(result, errors, date=DATE)


@pytest.fixture(scope="module")
def cables() -> Report:
    """Report of a cable robot: heights measured in part, an unknown frame, latent poses."""
    noise = pincal.Noise(1e-3, 0.0, 1e-3)
    mechanism, data = measured("4cable", 50, noise, 5e-3)
    poses = data.poses + np.array([0.5, -0.3, 0.1])
    poses[::3, 2] = np.nan
    data, setup = replace(data, poses=poses), pincal.Setup(unknown_frame=True)
    result = pincal.calibrate(mechanism, data, noise=noise, setup=setup)
    return result.report(date=DATE)


def measured_region(report: Report) -> Any:
    """Return the poses of the workspace that lie in the measured region, over which means are."""
    errors = report.errors
    assert errors is not None
    return errors.poses[errors.expected.within]


@pytest.mark.slow
def test_the_first_section_answers(planar: Any) -> None:
    """Better, by how much, to be trusted: with the platform's errors, χ² and held-out rows."""
    result, _, report = planar
    first = page_of(report).get_element_by_id("answers")
    assert [head.text_content() for head in first.iter("h2")] == QUESTIONS
    poses = measured_region(report)
    before = pincal.accuracy(result.nominal, result.identified, poses)
    after = result.expected_error(poses)
    cells = [[cell.text for cell in row[1:]] for row in first.xpath(".//tbody/tr")]
    shown = [[float(number) for number in re.findall(r"[\d.]+", " ".join(row))] for row in cells]
    held_out = [missed.rms for missed in result.validation.targets]
    limit = report.errors.inside.limit
    np.testing.assert_allclose(shown[0], [1e3 * before.position, 1e3 * before.orientation], 6e-3)
    sizes = np.column_stack(([after.position, after.orientation], limit)).ravel()
    np.testing.assert_allclose(shown[1], 1e3 * sizes, 6e-3)
    with_noise = [missed.limit for missed in result.validation.targets]
    sizes = np.column_stack((held_out, with_noise)).ravel()
    np.testing.assert_allclose(shown[2], 1e3 * sizes, 6e-3)
    text = first.text_content()
    assert f"Reduced χ² {result.reduced_chi2:.3g}" in text
    assert f"Held-out error {result.validation.held_out:.2f} σ" in text
    assert f"in the fit {result.validation.fit:.2f} σ" in text
    order = [one.get("id") for one in page_of(report).iter("section")]
    assert order[:4] == ["answers", "measured", "parameters", "residuals"]
    assert order[-1] == "reproduction"


def verdicts_of(report: Any) -> tuple[list[str], str]:
    """Return the verdicts of a report, and all of its first section's text."""
    first = page_of(report).get_element_by_id("answers")
    return [one.text_content() for one in first.find_class("verdict")], first.text_content()


@pytest.mark.slow
def test_residuals_beyond_the_noise_are_no_success(planar: Any) -> None:
    """Where χ² contradicts the noise, no limit is promised, and no error is below what was seen."""
    result, _, report = planar
    dof = result.degrees_of_freedom
    larger = finding("chi2-too-large", chi2=4.0, dof=dof, source="given")
    poor = replace(
        result,
        reduced_chi2=4.0,
        chi2_p_value=0.0,
        covariance=4.0 * result.covariance,
        findings=(larger,),
    )
    errors = errors_at(poor, poor.poses)
    verdicts, text = verdicts_of(Report(poor, errors, date=DATE))
    after = 1e3 * errors.mean_after()[0]
    assert after >= 2e3 * errors_at(result, poor.poses).mean_after()[0]
    assert 1e-3 * after >= poor.misses[0] * 0.99
    assert verdicts[0] == "Probably"
    assert verdicts[1].endswith(" mm at held-out poses")
    unchecked = verdicts_of(Report(replace(poor, validation=None), errors, date=DATE))[0]
    assert unchecked[1].endswith(f"→ {after:.3g} mm or more")
    assert verdicts[2] == "Not yet reliable"
    assert "No limit is stated: residuals larger than the noise" in text
    assert np.isinf(poor.expected_error().limit).all()
    assert "no limit: something contradicts" in str(poor.expected_error())
    assert any("no limit is stated" in str(line) for line in summary(poor, errors))
    assert verdicts_of(report)[0][::2] == ["Yes", "No problems"]
    for each, tones in ((poor, ["care", "", "bad", ""]), (result, ["good", "", "good", ""])):
        assert [answer.tone for answer in answers(each, errors, ["pincal explain"])] == tones


@pytest.mark.slow
def test_a_fit_that_fails_is_not_compared_with_held_out_rows(planar: Any) -> None:
    """Where rows of the fit miss by hundreds of σ, those held out are not said to be better."""
    result, _, report = planar
    lost = replace(result.validation, fit=316.2, held_out=1361.71, expected=405.02)
    poor = replace(result, reduced_chi2=1e5, chi2_p_value=0.0, validation=lost)
    made = Report(poor, report.errors, date=DATE)
    page = re.sub("<(path|use)[^>]*>", "", made.html())  # strokes hold all kinds of numbers
    for text in (page, poor._repr_html_(), " ".join(check_lines(poor))):
        assert ("misses even its own rows by 316 σ" in text) == ("<div>" not in text[:9])
        assert "1361.71" not in text
        assert "405.02" not in text


@pytest.mark.slow
def test_a_fit_that_failed_promises_nothing(planar: Any) -> None:
    """Residuals far beyond the noise: no number after; if they hardly fell, it is not better."""
    result, _, report = planar
    far = replace(result, reduced_chi2=1e4, chi2_p_value=0.0)
    legs = tuple(replace(leg, residuals=0.9 * leg.residuals_before) for leg in result.legs)
    for poor, verdict in ((far, "Not shown"), (replace(far, legs=legs), "No")):
        failed = Report(poor, report.errors, date=DATE)
        verdicts, text = verdicts_of(failed)
        assert verdicts[0] == verdict
        assert verdicts[1].endswith(" mm at held-out poses")
        assert "100 times as large as the noise" in text
        assert "→" not in text
        assert ("fit no better" in text) == (verdict == "No")
        supported = supporting_lines(poor)
        assert not any("region" in line or "limit" in line for line in supported)


@pytest.mark.parametrize("frame", some_slow([False, True], True))
def test_residuals_before_of_noisy_readings(frame: bool) -> None:
    """Readings and platform share what the nominal model misses, however exact the readings are."""
    noise = pincal.Noise(1e-4, 1e-4, 1e-6)
    mechanism, data = measured("3RRR", 30, noise)
    poses = data.poses + np.array([0.4, 0.2, 0.0]) * frame
    poses[:, 2] = np.nan
    setup = pincal.Setup(unknown_frame=frame)
    result = pincal.calibrate(mechanism, replace(data, poses=poses), noise=noise, setup=setup)
    series = noisy_residuals(result)
    assert [one.name for one in series] == [*mechanism.leg_names, "x", "y"]
    for one in series:
        before, after, sigma = one.rms_before, one.rms_after, one.rms_noise
        assert before > 4 * after
        assert after < 1.3 * sigma
    assert all(
        f"\n {one.name} " in str(residuals_table(result)).partition("rms before")[2]
        for one in series
    )


def test_parameters_are_those_of_the_result(planar: Any) -> None:
    """Every number is the result's, in its unit; what moves the platform most is first."""
    result, _, report = planar
    rows = page_of(report).get_element_by_id("parameters").xpath(".//tbody/tr")
    assert {row[0].text_content() for row in rows} == {p.id for p in result.parameters}
    moved = [float(row[6].text_content()) for row in rows]
    assert moved == sorted(moved, reverse=True)
    for row in rows:
        cells = [cell.text_content() for cell in row]
        p, factor = result[cells[0]], FACTORS[cells[4]]
        half = (p.high - p.low) / 2
        for place, value in ((1, p.nominal), (2, p.identified), (3, half), (5, p.change)):
            digits = len(cells[place].partition(".")[2])
            assert float(cells[place]) == pytest.approx(factor * value, abs=0.5001 * 10**-digits)


@pytest.mark.slow
def test_names_are_not_capitalised() -> None:
    """A 3-RRR has l and L: lines and notes that begin with a name keep it as it is."""
    mechanism, data = measured("3RRR", 20)
    result = pincal.calibrate(mechanism, data, noise=NOISE)
    made = result.report()
    made.notes = ["l of the second run was 1.5 m"]
    page = page_of(made)
    assert "l of the second run" in page.get_element_by_id("answers").text_content()


@pytest.mark.slow
def test_fixed_parameters_look_fixed() -> None:
    """What was given is no measurement: fixed, tied and known ones are named, everywhere."""
    mechanism, data = measured("3RRR", 30)
    given: dict[str, Any] = {"fixed": ["k", "leg_2.gamma"], "tied": ["ob"], "priors": {"OA": 1e-3}}
    result = pincal.calibrate(mechanism, data, noise=NOISE, **given)
    page = page_of(result.report())
    text = io.StringIO()
    Console(file=text, width=100).print(parameters_table(result))
    printed = [line.split() for line in text.getvalue().splitlines()]
    rows = page.get_element_by_id("parameters").xpath(".//tbody/tr")
    shown = {row[0].text_content(): [cell.text_content() for cell in row] for row in rows}
    found = [(leg.name, p) for leg in result.legs for p in leg.parameters]
    for leg, p in found:
        fixed = p.name == "k" or (leg, p.name) == ("leg_2", "gamma")
        assert p.given == {"ob": "tied", "OA": "prior"}.get(p.name, "fixed" if fixed else "")
        assert (p.id in shown) is not fixed
        assert fixed or any(" ".join(shown[p.id][:4]) in " ".join(line) for line in printed)
    flat = " ".join(text.getvalue().split())
    assert "fixed: leg_1.k, leg_2.k, leg_2.gamma and leg_3.k" in flat
    assert "tied: leg_1.ob, leg_2.ob and leg_3.ob" in flat
    assert "prior: leg_1.OA, leg_2.OA and leg_3.OA" in flat
    kept = [p["given"] for leg in as_json(result)["legs"] for p in leg["parameters"]]
    assert kept == [p.given or None for _, p in found]


def test_rejected_rows_are_listed_and_marked(planar: Any) -> None:
    """The wrong row stands in the table with its weight and reason, and in the figure."""
    result, _, report = planar
    page = page_of(report)
    rows = page.get_element_by_id("residuals").xpath(".//table")[-1].xpath("./tbody/tr")
    assert [row[0].text for row in rows] == [str(one.row + 1) for one in result.outliers]
    worst = {one.row + 1: one for one in result.outliers}[7]
    cells = next([cell.text for cell in row] for row in rows if row[0].text == "7")
    why = f"{worst.quantity} off by {worst.off:.1f} σ"
    assert cells == ["7", f"{worst.sigma:.1f}", "rejected", why]
    assert "7" in list(drawn(page, "residuals").itertext())


@pytest.mark.parametrize("which", some_slow(["planar", "cables", "hexapod"], "cables", "hexapod"))
def test_one_sound_file(which: str, request: pytest.FixtureRequest) -> None:
    """Tags close, ids are unique, figures say what they show, and nothing lies elsewhere."""
    made = request.getfixturevalue(which)
    report = made[2] if isinstance(made, tuple) else made
    text = report.html()
    assert len(text.encode()) < 2e6
    assert "//" not in re.sub(r"data:image/svg\+xml;base64,[\w+/=]*", "", text)
    _Balanced().check(text)
    page = page_of(report)
    ids = Counter(page.xpath("//@id"))
    assert max(ids.values()) == 1
    links = page.xpath("//@href | //@src")
    assert all(link.startswith(("#", "data:image/svg+xml;base64,")) for link in links)
    assert {link[1:] for link in links if link[0] == "#"} <= set(ids)
    figures = page.xpath("//figure")
    assert len(figures) >= 2
    for one in figures:
        (image,) = one.iter("img")
        assert len(image.get("alt")) > 20
        svg = etree.fromstring(b64decode(image.get("src").partition("base64,")[2]))
        links = svg.xpath("//@*[local-name() = 'href']")
        assert all(link.startswith(("#", "data:image/png;base64,")) for link in links)
        assert one.xpath("./figcaption")[0].text_content()


class _Balanced(HTMLParser):
    """Checks that every tag that opens closes, in order."""

    def check(self, text: str) -> None:
        self.open: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, _: Any) -> None:
        if tag not in ("meta", "br", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.slow
def test_names_are_text() -> None:
    """Names of code, quotes and letters from elsewhere are shown as they are, everywhere."""
    mechanism, data = measured("5R", 30)
    names = ("_" + EVIL, EVIL + "2")
    legs = tuple(replace(leg, name=name) for leg, name in zip(mechanism.legs, names, strict=True))
    mechanism = replace(mechanism, name=EVIL, description=EVIL, legs=legs)
    data = replace(data, sets=(*names, "all") * 10)
    result = pincal.calibrate(mechanism, data, noise=NOISE, poses="all")
    result = replace(
        result,
        findings=(finding("model-lacks", quantity=EVIL, term="order", p_value=1e-9),),
        gauge=(finding("redundant-parameters", count=1, groups=((EVIL, "k"),)),),
        outliers=(Outlier(3, 9.0, 1.0, EVIL, 9.0),),
    )
    report = result.report(command=EVIL)
    report.notes = [EVIL + "\0"]
    page = page_of(report)
    assert not list(page.iter("script", "b"))
    assert page.find(".//title").text == f"{EVIL}: calibration"
    assert page.get_element_by_id("reproduction").find(".//pre").text_content() == EVIL
    assert EVIL in page.get_element_by_id("warnings").text_content()
    listed = [row[0].text_content() for row in page.get_element_by_id("parameters").iter("tr")]
    assert all(any(head.startswith(name) for head in listed) for name in names)
    assert "\ufffd" in page.get_element_by_id("answers").text_content()
    for shown in (mechanism._repr_html_(), result._repr_html_()):
        tree = lxml_html.fromstring(shown)
        assert not list(tree.iter("script", "b"))
        assert EVIL in tree.text_content()


@pytest.mark.slow
def test_the_same_bytes_but_for_the_date(planar: Any) -> None:
    """Made anew, in whatever style the user draws, a report is the same."""
    result, _, report = planar
    with mpl.rc_context({"font.size": 20, "svg.fonttype": "path"}):
        again = result.report(command="pincal", date=DATE)
        assert again.html() == report.html()
        assert mpl.rcParams["font.size"] == 20


@pytest.mark.slow
def test_as_many_unknowns_as_values_prove_nothing() -> None:
    """Eight poses for eight parameters: no χ², no boast of zero residuals, one warning for all."""
    mechanism, data = measured("3RRR", 8)
    result = pincal.calibrate(mechanism, data, noise=NOISE, strict=True)
    assert result.degrees_of_freedom == 0
    page = page_of(result.report())
    first = page.get_element_by_id("answers").text_content()
    assert "as many unknowns as measured values" in first
    assert "nan" not in page.get_element_by_id("answers").text_content()
    assert "e-1" not in first
    assert first.count("Yes") == 0
    warned = [one.text_content() for one in page.xpath("//*[@id='warnings']//li")]
    assert sum("8 poses for 8 parameters" in text for text in warned) == 1
    assert any(text.startswith("leg_1, leg_2, leg_3: ") for text in warned)
    assert "nan" not in result._repr_html_()


@pytest.mark.slow
def test_exact_readings_are_no_proof() -> None:
    """Latent poses and exact readings: residuals are those of what was measured, with noise."""
    mechanism, data = measured("3RRR", 30, pincal.Noise(1e-4, 0.0))
    poses = data.poses.copy()
    poses[:, 2] = np.nan
    data = replace(data, poses=poses)
    result = pincal.calibrate(mechanism, data, noise=pincal.Noise(1e-4, 0.0))
    page = page_of(result.report())
    (x, y) = result.observed
    facts = page.get_element_by_id("measured").text_content()
    assert "σ 0.1 mm in position, readings exact" in facts
    words = page.get_element_by_id("residuals").text_content()
    assert "Readings are exact" in words
    assert "leg_1" not in words
    rows = page.get_element_by_id("residuals").xpath(".//tbody/tr")
    sizes = [[float(cell.text) for cell in row[2:5]] for row in rows]
    both = [[np.sqrt((v**2).mean()) for v in (q.residuals_before, q.residuals)] for q in (x, y)]
    np.testing.assert_allclose(sizes, [[*(1e3 * np.array(v)), 0.1] for v in both], atol=5.1e-5)
    text = io.StringIO()
    Console(file=text, width=100).print(residuals_table(result))
    assert "exact" in text.getvalue()
    assert "0.0000" not in text.getvalue()


@pytest.mark.slow
def test_the_limit_holds_in_95_of_100_calibrations(planar: Any) -> None:
    """Of machines whose parameters differ by the covariance; and the report names the limit."""
    result, _, report = planar
    poses = measured_region(report)[:40]
    found = errors_at(result, poses)
    n, draws = len(result.covariance), 200
    values, axes = np.linalg.eigh(result.covariance)
    shifts = (axes * np.sqrt(values.clip(0.0))) @ np.random.default_rng(0).standard_normal(
        (n, draws)
    )
    sizes = np.cumsum([len(leg.parameters) for leg in result.legs])[:-1]
    actual = []
    for shift in shifts.T:
        changed = {
            leg.name: leg.identified + own
            for leg, own in zip(result.legs, np.split(shift, sizes), strict=True)
        }
        one = pincal.accuracy(result.identified, result.nominal.with_parameters(changed), poses)
        actual.append((one.position, one.orientation))
    below = (np.array(actual) < found.inside.limit).mean(axis=0)
    assert (np.abs(below - 0.95) < 0.055).all()  # 3.5 standard deviations
    assert (np.array(found.inside.limit) > found.mean_after()).all()
    text = page_of(report).get_element_by_id("answers").text_content()
    assert f"(95 %: ≤\xa0{1e3 * report.errors.inside.limit[0]:.3g})" in text
    assert "with 95 % confidence" in text


def test_no_convergence_no_mechanism(planar: Any, tmp_path: Path) -> None:
    """A fit that did not converge says so first, and shows and writes no calibrated mechanism."""
    result, _, _ = planar
    failed = replace(result, converged=False, left=123.0)
    report = failed.report()
    page = page_of(report)
    main = page.find(".//main")
    assert [one.get("id") for one in main][1:3] == ["warnings", "answers"]
    said = f"The fit {failed.message}"
    assert said.startswith("The fit did not converge: ")
    assert said in page.get_element_by_id("warnings").text_content()
    assert "the next step would be 1.2e+02 standard errors" in said
    assert "There is no result" in page.get_element_by_id("answers").text_content()
    assert not page.xpath("//*[@id='parameters' or @id='platform']")
    assert f"{result.legs[0].parameters[0].identified * 1e3:.1f}" not in report.html()
    failed.save(tmp_path / "result", report=report)
    assert not (tmp_path / "result/mechanism").exists()
    assert (tmp_path / "result/report.html").read_text(encoding="utf-8") == report.html()
    assert "did not converge" in failed._repr_html_()


def test_a_result_reports_itself(planar: Any) -> None:
    """It holds what it was made from; a file that cannot be hashed is refused."""
    result, _, report = planar
    assert result.report(command="pincal", date=DATE).html() == report.html()
    with pytest.raises(pincal.FileError, match="cannot read"):
        result.report(files=["/nowhere/at.all"])


@pytest.mark.slow
def test_unknown_frames(cables: Report) -> None:
    """Errors leave out motions of the frames; poses measured elsewhere are shown in the base."""
    found, result = cables, cables.result
    assert found.errors is not None
    poses = measured_region(cables)
    expected = result.expected_error(poses)
    assert found.errors.mean_after()[0] == pytest.approx(expected.position, rel=1e-9)
    before = pincal.accuracy(result.nominal, result.identified, poses)
    assert found.errors.mean_before()[0] < before.position
    words = page_of(cables).text_content()
    assert "z (33 rows)" in words
    assert "tracker.rx" in words
    assert "best-fit frames" in words

    mechanism, data = measured("3RRR", 30)
    moved, setup = data.poses + np.array([0.4, 0.2, 0.0]), pincal.Setup(unknown_frame=True)
    given = replace(data, poses=moved)
    aligned = pincal.calibrate(mechanism, given, noise=NOISE, setup=setup)
    np.testing.assert_allclose(aligned.poses, data.poses, atol=0.02)


def test_without_a_workspace(planar: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Means are then over the measured poses; the report says so."""
    result, _, _ = planar

    def fail(*_: object) -> None:
        raise pincal.WorkspaceError("no workspace was found")

    monkeypatch.setattr("pincal.show.misses.sample_configurations", fail)
    report = result.report()
    text = page_of(report).get_element_by_id("answers").text_content()
    assert "over measured poses" in text


def test_errors_where_poses_are_out_of_reach(planar: Any) -> None:
    """Poses out of reach are NaN, and means are taken over the others."""
    result, data, _ = planar
    far = np.concatenate((data.poses[:3], [[9.0, 9.0, 0.0]]))
    found = errors_at(result, far)
    assert np.isnan(found.before[3]).all()
    assert np.isnan(found.expected.sizes[3]).all()
    assert found.mean_after()[0] == pytest.approx(result.expected_error(data.poses[:3]).position)


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Working folder with a 5R and measurements of it."""
    mechanism, data = measured("5R", 30)
    mechanism.save(tmp_path / "robot")
    data.to_csv(tmp_path / "measured.csv", mechanism)
    monkeypatch.chdir(tmp_path)
    return tmp_path


CALIBRATE = ["calibrate", "robot", "measured.csv", "--noise-position", 1e-4]
CALIBRATE += ["--noise-orientation", 1e-4, "--folds", 0]


def test_calibrate_writes_the_report(work: Path) -> None:
    """'calibrate' writes it into the result, with the command and the hashes of the files read.

    What comes next are commands to copy, of which the terminal shows the first.
    """
    outcome = done(*CALIBRATE, "-o", "a result")
    page = lxml_html.parse(work / "a result/report.html").getroot()
    steps = [block.text_content() for block in page.get_element_by_id("answers").iter("pre")]
    assert steps[:2] == [
        "pincal deploy 'a result' -o controller",
        "pincal inverse 'a result' POSES.csv -o READINGS.csv",
    ]
    assert outcome.out.splitlines()[-1] == f"next: {steps[0]}"
    typed = page.get_element_by_id("reproduction").find(".//pre").text_content()
    assert typed.startswith("pincal calibrate robot measured.csv --noise-position 0.0001")
    assert typed.endswith("-o 'a result'")
    rows = page.get_element_by_id("reproduction").xpath(".//tbody/tr")
    hashes = {row[0].text: row[1].text for row in rows}
    assert {"mechanism.yaml", "measured.csv", "platform.urdf"} <= set(hashes)
    for path in (work / "measured.csv", work / "robot/mechanism.yaml"):
        assert hashes[path.name] == sha256(path.read_bytes()).hexdigest()
    assert page.get_element_by_id("parameters") is not None
    assert "wrote a result" in outcome.err
    warned = done(*CALIBRATE[:3], "-o", "again", "--quiet", "--folds", 0)
    assert warned.out == ""
    assert warned.err.startswith("warning: no noise was given")
    assert warned.err.count("\n") == 1


@pytest.mark.slow
def test_answers_are_short() -> None:
    """A hexapod in a tracker's frame takes 60 words; one wrong row, named, leaves one verdict line.

    What comes next offers to measure it again, too; in a height alone the check says so.
    """
    mechanism, data = measured("6UPS", 42, pincal.Noise(5e-5, 1e-4, 2e-5))
    data = replace(data, sets=("",) * 36 + ("verify",) * 6)

    def reported(poses: np.ndarray) -> Report:
        setup = pincal.Setup(unknown_frame=bool(np.isfinite(poses).all()))
        noise = pincal.Noise(5e-5, 1e-4, 2e-5)
        rows = replace(data, poses=poses)
        result = pincal.calibrate(mechanism, rows, noise=noise, setup=setup)
        return result.validated().report(date=DATE)

    sound = reported(data.poses)
    assert len(str(sound).split()) <= 60, str(sound)
    assert "verification 6" in sound.html()
    poses = data.poses.copy()
    poses[40, 4] += 0.02
    wrong = reported(poses)
    first, *_, last = str(wrong).splitlines()
    assert first.startswith("✗")
    assert len(first) <= 80
    assert last.startswith("next: measure again, or pincal calibrate")
    assert "data row 41" in str(wrong)
    assert verdicts_of(wrong)[0][0] == "Probably"
    poses[:, [0, 1, 3, 4, 5]] = np.nan
    heights = str(reported(poses))
    assert "z alone, 6 verification poses, with noise" in heights
    assert "x, y, the orientation: forecast, not measured" in heights


def test_errors_can_be_stated_over_poses_of_ones_own(work: Path) -> None:
    """They are those that ``expected_error`` gives there; a good calibration takes 60 words."""
    data = pincal.Measurements.from_csv(work / "measured.csv", pincal.load_mechanism("robot"))
    pincal.Plan(data.poses[:9]).to_csv("poses.csv", pincal.load_mechanism("robot"))
    outcome = done(*CALIBRATE[:-2], "--no-report", "--workspace", "poses.csv", "-o", "mine")
    assert "% of the poses given" in outcome.out
    assert len(outcome.out.split()) <= 60
    result = pincal.load_result("mine")
    plan = pincal.Plan.from_csv("poses.csv", result.nominal)
    error = result.expected_error(plan.rows(result.expected_error(plan).within))
    expected, limit = (1e3 * value for value in (error.position, error.limit[0]))
    assert f"{expected:.3g} (≤ {limit:.3g})" in outcome.out
    printed = str(result.report(workspace="poses.csv")).splitlines()
    assert [*map(str.split, printed[:-1])] == [*map(str.split, outcome.out.splitlines()[:-1])]
    refused = run(*CALIBRATE, "--workspace", "measured.csvx", "-o", "none")
    assert (refused.code, (work / "none").exists()) == (2, False)


_CUT = """() => [...document.querySelectorAll("svg")].flatMap((svg) => {
  const all = svg.getBoundingClientRect();
  return [...svg.querySelectorAll("tspan, text:not(:has(tspan))")].filter((text) => {
    const box = text.getBoundingClientRect();
    return box.left < all.left - 2 || box.right > all.right + 2
      || box.top < all.top - 2 || box.bottom > all.bottom + 2;
  }).map((text) => `${svg.id}: ${text.textContent}`);
})"""


_SPILLED = """() => [...document.querySelectorAll("article, dd, li, pre")].filter(
  (one) => one.scrollWidth > one.clientWidth + 1).length"""


@pytest.mark.slow
@pytest.mark.parametrize("which", ["planar", "cables", "hexapod"])
def test_in_a_browser(
    which: str, browser: Any, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """No request, no complaint, nothing wider than the page or cut off; it prints."""
    made = request.getfixturevalue(which)
    path = (made[2] if isinstance(made, tuple) else made).save(tmp_path / "report.html")
    page = browser.new_page(viewport={"width": 1024, "height": 768})
    said: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(path.as_uri())
    foot = page.evaluate("() => document.querySelector('#answers').getBoundingClientRect().bottom")
    assert foot < 768  # the answers are on the first screen
    figures = page.locator("img").evaluate_all("(all) => all.map((one) => one.naturalWidth > 0)")
    assert figures
    assert all(figures)
    page.screenshot(path=tmp_path / "wide.png", full_page=True)
    assert len(page.pdf(prefer_css_page_size=True)) > 30_000
    for width, media in ((1024, "screen"), (400, "screen"), (680, "print")):
        page.emulate_media(media=media)
        page.set_viewport_size({"width": width, "height": 768})
        assert page.evaluate("() => document.documentElement.scrollWidth") <= width
        assert page.evaluate(_SPILLED) == 0
    assert said == []
    assert [url for url in asked if not url.startswith("data:")] == [path.as_uri()]
    for source in page.locator("img").evaluate_all("(all) => all.map((one) => one.src)"):
        (tmp_path / "figure.svg").write_bytes(b64decode(source.partition("base64,")[2]))
        page.goto((tmp_path / "figure.svg").as_uri())
        assert page.evaluate(_CUT) == []
    page.close()


@pytest.mark.slow
def test_a_leg_that_was_never_read_has_no_residuals() -> None:
    """Its parameters are held; page and report say nothing of its residuals, and nothing warns."""
    mechanism, noise = pincal.load_mechanism("6UPS"), pincal.Noise(1e-4, 1e-4, 1e-5)
    truth = pincal.disturb(mechanism, 2e-3, 1)
    plan = pincal.Plan(workspace("6UPS", 40))
    data = pincal.simulate(mechanism, truth, plan, noise, 2).measurements
    readings = data.readings.copy()
    readings[:, 2] = np.nan
    data = replace(data, readings=readings)
    result = pincal.calibrate(mechanism, data, noise=noise)
    assert "nan" not in f"{result}{[*map(str, result.tables())]}"
    assert "leg_3" in result.report().html()
