"""What many machines show: how errors are distributed, what makes them, who is out of family."""

from __future__ import annotations

from collections import Counter

import numpy as np
from scipy.special import stdtrit

from pincal.calibration.many import FAILURE, Columns, Row
from pincal.calibration.montecarlo import MonteCarlo
from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.show import answers
from pincal.show.misses import workspace_errors
from pincal.words.numbers import amount, fixed, measured
from pincal.words.table import Cell, Table, Value

_QUANTILES = {"median": 0.5, "95 %": 0.95, "99 %": 0.99, "worst": 1.0}
_FAMILY, _ALARM = 5, 0.01  # machines of a family at least; chance that a sound one has any outside
_HEADS = {
    "before": "before calibration",
    "after": "after calibration",
    "worst": "after calibration, worst pose",
}


def montecarlo_lines(study: MonteCarlo) -> list[str | Table]:
    """Return the verdict of a study, why machines failed, how errors are distributed, and why."""
    name, fine = study.mechanism.name, study.columns[FAILURE] == ""
    if not fine.any():
        return [f"✗ {name}: no machine could be calibrated", *failure_lines(study.columns)]
    unit = study.mechanism.platform.units[0]
    before, after = (amount(float(np.quantile(e, 0.95)), unit) for e in study.known)
    verdict = (
        f"{'✓' if fine.all() else '⚠'} {name}: 95 % of calibrated machines are within {after} "
        f"({before} before calibration)"
    )
    rows: list[list[Value]] = []
    for head, errors in study.columns.items():
        key, _, unit = head.removesuffix("]").partition(" [")
        if key in _HEADS and not np.isnan(errors[fine]).any():
            sizes = np.quantile(errors[fine], [*_QUANTILES.values()]).tolist()
            rows.append([_HEADS[key], *(Cell(size, amount(size, unit)) for size in sizes)])
    title = f"Errors of the platform of {fine.sum()} machines, each over the workspace (RMS)"
    return [
        verdict,
        *failure_lines(study.columns),
        Table(title, ["", *_QUANTILES], rows),
        _costs(study),
    ]


def failure_lines(columns: Columns) -> list[str]:
    """Return how many machines have no result, and why, the most frequent cause first."""
    causes = Counter(cause for cause in columns[FAILURE] if cause)
    total = len(columns[FAILURE])
    return [f"{count} of {total} have no result: {cause}" for cause, count in causes.most_common(3)]


def _costs(study: MonteCarlo) -> Table:
    """Return which tolerance makes which share of the mean square error."""
    costs = study.costs()
    rows: list[list[Value]] = [
        [
            cost.name,
            Cell(cost.sigma, amount(cost.sigma, cost.unit)),
            *(100.0 * share for share in cost[3:]),
        ]
        for cost in costs
    ]
    rows.append(
        ["noise of the measurements", None, None, 100.0 * (1.0 - sum(cost.after for cost in costs))]
    )
    columns = ["", "tolerance (σ)", "before [%]:.0f", "after [%]:.0f"]
    return Table("What makes the mean square error", columns, rows)


def montecarlo_text(study: MonteCarlo) -> str:
    """Return what ``pincal montecarlo`` prints."""
    return "\n".join(map(str, montecarlo_lines(study)))


def row_kinds(mechanism: Mechanism) -> dict[str, type]:
    """Return the columns of a table of calibrations, and what they hold."""
    texts = dict.fromkeys(["file", "sha256", FAILURE, "verdict"], str)
    units = dict.fromkeys(mechanism.platform.units)
    errors = [f"{name} [{unit}]" for unit in units for name in ("before", "after", "limit")]
    values = [name for p in mechanism.parameters for name in (p.column, f"std {p.column}")]
    return texts | dict.fromkeys(["rows", "chi2", "p_value", *errors, *values], float)


def row_of_result(result: CalibrationResult, workspace: Plan | None) -> Row:
    """Return what a table says of a calibration: verdict, accuracy, χ², parameters.

    Raises:
        MeasurementError: it did not converge.
    """
    if not result.converged:
        raise MeasurementError(f"the fit {result.message}")
    errors = workspace_errors(result, workspace)
    row: Row = {
        "verdict": answers.verdict(result, errors)[0].replace(f" {result.nominal.name}:", ""),
        "rows": len(result.measurements),
        "chi2": result.reduced_chi2,
        "p_value": result.chi2_p_value,
    }
    parts = (errors.mean_before(), errors.mean_after(), errors.inside.limit)
    for name, sizes in zip(("before", "after", "limit"), parts, strict=True):
        row |= {f"{name} [{unit}]": size for unit, size in zip(("m", "rad"), sizes, strict=True)}
    for p in (p for leg in result.legs for p in leg.parameters):
        row |= {p.column: p.identified, f"std {p.column}": p.std}
    return row


def out_of_family(columns: Columns, mechanism: Mechanism) -> list[tuple[str, str]]:
    """Return files whose parameters lie outside the control limits of the others, and how far.

    Each is compared with the mean of the others, by Student's distribution of such a difference
    (externally studentised); a sound family has one outside in a hundred cases.
    """
    fine = columns[FAILURE] == ""
    n, outside = int(fine.sum()), list[tuple[str, str]]()
    if n < _FAMILY:
        return outside
    limit = float(stdtrit(n - 2, 1.0 - _ALARM / (2.0 * n * len(mechanism.parameters))))
    for p in mechanism.parameters:
        x = columns[p.column][fine]
        centred = x - x.mean()
        variances = (centred @ centred - n / (n - 1) * centred**2) / (
            n - 2
        )  # variance of the others
        sigma = np.sqrt(np.maximum(variances, 1e-12 * np.mean(centred**2)) * (1.0 + 1.0 / (n - 1)))
        differences = x - (x.sum() - x) / (n - 1)
        for i in np.flatnonzero(np.abs(differences) > limit * sigma):
            half = float(limit * sigma[i])
            limits = measured(float(x[i] - differences[i]), half, p.unit)
            value = fixed(float(x[i]), half, p.unit)
            outside.append(
                (columns["file"][fine][i], f"{p.id} is {value}, outside {limits} of the others")
            )
    return outside


def batch_lines(columns: Columns, mechanism: Mechanism) -> list[str | Table]:
    """Return the verdict of many calibrations, what failed, who is out of family, and a table."""
    fine, unit = columns[FAILURE] == "", mechanism.platform.units[0]
    outside = out_of_family(columns, mechanism)
    bad = [text.startswith("✗") for text in columns["verdict"]]
    mark = "✓" if fine.all() and not any(bad) and not outside else "⚠" if fine.any() else "✗"
    parts = [f"{fine.sum() - sum(bad)} of {len(fine)} machines calibrated"]
    if fine.any():
        worst = float(np.max(columns[f"after [{unit}]"][fine]))
        parts.append(f"the worst to {amount(worst, unit)}")
    parts.append(f"{len({name for name, _ in outside})} out of family")
    lines: list[str | Table] = [f"{mark} {mechanism.name}: {' · '.join(parts)}"]
    lines += [f"out of family: {name}: {text}" for name, text in outside]
    texts = zip(columns["file"], columns["verdict"], columns[FAILURE], strict=True)
    rows = [[name, verdict or f"✗ no result: {cause}"] for name, verdict, cause in texts]
    return [*lines, Table("", ["machine", "verdict"], rows)]
