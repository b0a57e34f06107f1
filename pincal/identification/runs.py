"""Runs of an experiment compared: do they say the same, within their own standard errors?"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as f_law

from pincal.errors import MeasurementError
from pincal.identification.calibrate import calibrate
from pincal.identification.trust import RunConsistency
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]


def compare_runs(
    mechanism: Mechanism, measurements: Measurements, **options: Any
) -> RunConsistency:
    """Return how well the runs of an experiment agree, each calibrated alone.

    Args:
        mechanism: The nominal mechanism.
        measurements: What was measured, with the run of each row.
        **options: Of ``calibrate``.

    Raises:
        MeasurementError: no runs, or only one; a run whose fit does not converge.
        ObservabilityError: a run that does not determine the parameters alone.
    """
    names = tuple(dict.fromkeys(measurements.runs or ()))
    if len(names) < 2:
        raise MeasurementError("runs are compared by a column 'run' with at least two runs in it")
    of_rows = np.array(measurements.runs)
    values, covariances, freedoms, known = [], [], 0, True
    for name in names:
        result = calibrate(mechanism, measurements.rows(of_rows == name), **options)
        if not result.converged:
            raise MeasurementError(f"run {name!r}: {result.message}")
        values.append(np.concatenate([leg.identified for leg in result.legs]))
        covariances.append(result.covariance)
        freedoms += result.degrees_of_freedom
        known = known and result.noise_source != "estimated"
    found, C = np.array(values), np.array(covariances)
    scale = np.sqrt(np.einsum("rii->ri", C).mean(axis=0))
    scale[scale == 0.0] = 1.0
    weights = np.linalg.pinv(C / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    relative = found / scale
    mean = np.linalg.pinv(weights.sum(axis=0), rcond=1e-12, hermitian=True) @ np.einsum(
        "rij,rj->i", weights, relative
    )
    off = relative - mean
    statistic = float(np.einsum("ri,rij,rj->", off, weights, off))
    rank = int(np.linalg.matrix_rank(weights.sum(axis=0), hermitian=True))
    dof = rank * (len(names) - 1)
    return RunConsistency(
        runs=names,
        names=tuple(f"{leg.name}.{name}" for leg in mechanism.legs for name in leg.parameter_names),
        values=found,
        spread=found.std(axis=0, ddof=1),
        predicted=np.sqrt(np.einsum("rii->ri", C).mean(axis=0)),
        ratio=float(np.sqrt(statistic / dof)),
        p_value=float(
            chi2.sf(statistic, dof) if known else f_law.sf(statistic / dof, dof, max(freedoms, 1))
        ),
    )
