"""Is a calibration to be trusted? Errors at rows it has not seen, and drift.

Held-out rows are judged like those of the fit, whitened by their noise; of them more is
expected by what the fit does not know: r has the covariance 1 + J C Jᵀ. What then exceeds the
fit's own χ² says that the model follows its rows more closely than the machine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_law
from scipy.stats import spearmanr

from pincal.errors import MeasurementError
from pincal.estimation.observation import Observation
from pincal.identification.alignment import placed, settle
from pincal.identification.calibrate import calibration_task, estimate
from pincal.identification.estimate import Estimate
from pincal.identification.fit import Fit
from pincal.identification.latent_fit import unaligned_problem
from pincal.identification.measured import given_poses, group_problem
from pincal.identification.problem import Linear
from pincal.identification.task import Task
from pincal.identification.trust import UNLIKELY, Validation
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
FOLDS = 5


def validate(
    mechanism: Mechanism,
    measurements: Measurements,
    *,
    folds: int = FOLDS,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> Validation:
    """Return the errors at rows that a calibration has not seen, by cross-validation.

    Rows are dealt to the folds in turn, those of each ``set`` alike; rows of one ``pose`` stay
    together. Rows that a robust loss finds outlying are left out.

    Args:
        mechanism: The nominal mechanism.
        measurements: What was measured.
        folds: How many times a share of the rows is held out.
        progress: Called with what is being done.
        **options: Of ``calibrate``.

    Raises:
        MeasurementError: fewer rows than folds, or fewer than two folds; a fold does not converge.
        ObservabilityError: what is left does not determine the parameters.
    """
    task = calibration_task(mechanism, measurements, **options)
    whole = estimate(task)
    if task.loss != "none":
        out = [outlier.row for one in whole.fits for outlier in one.outliers]
        task = _part(task, ~np.isin(np.arange(len(task.data)), out))
        task = replace(task, loss="none")
        whole = estimate(task)
    groups = _folds(task.data, folds)
    total, spread, extra, equations = 0.0, 0.0, 0.0, 0
    misfits: list[Array] = []
    for fold in range(folds):
        if progress:
            progress(f"held-out rows, fold {fold + 1} of {folds}")
        found = estimate(_part(task, groups != fold))
        unseen = _part(task, groups == fold)
        for one, linear in _judged(found, unseen):
            judged = _Judged.of(one, linear)
            total, spread = total + judged.statistic, spread + judged.squares
            extra, equations = extra + judged.unknown, equations + judged.equations
        misfits.append(_misfit(unseen, found))
    dof = sum(one.fit.degrees_of_freedom for one in whole.fits)
    own = sum(one.fit.chi2 for one in whole.fits) / max(dof, 1)
    fitted, held_out = _misfit(task, whole), np.concatenate(misfits)
    linear_units = np.array([unit == "m" for unit in mechanism.platform.units])
    unit = 1.0 if task.noise.known else max(own, 1e-300)  # noise that was assumed was estimated
    return Validation(
        folds=folds,
        rows=len(task.data),
        fit=float(np.sqrt(own / unit)),
        held_out=float(np.sqrt(spread / equations / unit)),
        expected=float(np.sqrt(own / unit * (1.0 + extra / equations))),
        p_value=float(f_law.sf(total / equations / own, equations, dof)) if own > 0 else 1.0,
        position=_both(fitted, held_out, linear_units),
        orientation=_both(fitted, held_out, ~linear_units),
        drift=_drift(whole),
    )


def _part(task: Task, chosen: NDArray[np.bool_]) -> Task:
    """Return the task on some of its rows."""
    noise = replace(
        task.noise, poses=task.noise.poses[chosen], readings=task.noise.readings[chosen]
    )
    return replace(task, data=task.data.rows(chosen), noise=noise)


def _folds(data: Measurements, folds: int) -> NDArray[np.intp]:
    """Return the fold of each row, shape (N,).

    Raises:
        MeasurementError: too few rows, or fewer than two folds.
    """
    places = [row.tobytes() for row in data.readings] if data.places is None else data.places
    places = [place or str(row) for row, place in enumerate(places)]  # an empty one is its own
    sets = data.sets or ("",) * len(data)
    first: dict[tuple[str, str | bytes], int] = {}
    counts: dict[str, int] = {}
    for key in zip(sets, places, strict=True):
        if key not in first:
            first[key] = counts.setdefault(key[0], 0)
            counts[key[0]] += 1
    if not 2 <= folds <= max(counts.values()):
        raise MeasurementError(
            f"{folds} folds of {max(counts.values())} poses; expected at least two folds, and no "
            "more than there are poses"
        )
    return np.array([first[key] % folds for key in zip(sets, places, strict=True)])


@dataclass(frozen=True)
class _Judged:
    """Residuals of a fit at rows that it has not seen."""

    statistic: float
    """Σ rᵀ (1 + J C Jᵀ)⁻¹ r."""
    squares: float
    """Σ rᵀ r."""
    unknown: float
    """Σ tr(J C Jᵀ): growth of the squares by what the fit does not know."""
    equations: int

    @classmethod
    def of(cls, one: Fit, linear: Linear) -> _Judged:
        """Return how a fit does at rows, noise of unit variance."""
        scale = 1.0 if one.known else one.chi2 / one.degrees_of_freedom
        J, r = linear.jacobian, linear.white
        spread = J @ (one.covariance / scale) @ J.transpose(0, 2, 1)
        weighed = np.linalg.solve(np.eye(J.shape[1]) + spread, r[:, :, None])[:, :, 0]
        return cls(
            float((r * weighed).sum()),
            float((r**2).sum()),
            float(np.einsum("nkk->", spread)),
            int(linear.equations.sum()),
        )


def _judged(found: Estimate, unseen: Task) -> list[tuple[Fit, Linear]]:
    """Return fits with their residuals and derivatives at rows that they have not seen."""
    fits = [robust.fit for robust in found.fits]
    if found.latent is not None:
        latent = unaligned_problem(unseen)
        state = placed(latent, unseen.data, fits[0].parameters, fits[0].last.state.external)
        settled = settle(latent, settle(latent.eased(), state))
        return [(fits[0], latent.linearise(settled))]
    names = list(unseen.mechanism.leg_names)
    pairs: list[tuple[Fit, Linear]] = []
    for one in fits:
        group = [names.index(leg.name) for leg in one.problem.legs]
        problem, _ = group_problem(unseen, group, *_given(unseen, found))
        pairs.append((one, problem.linearise(problem.start(one.parameters))))
    return pairs


def _given(task: Task, found: Estimate) -> tuple[Array, Array]:
    """Return measured poses in the base frame, and roots of their covariance."""
    known = found.external is None
    seen = None if known else Observation(task.mechanism, task.data, task.setup)
    return given_poses(task, seen, found.external)


def _misfit(task: Task, found: Estimate) -> Array:
    """Return by how much the platform misses measured poses, shape (N, dof); NaN where not told.

    The twist that closes all legs at the measured readings, to first order.
    """
    mechanism = task.mechanism
    if task.setup.distances or len(task.setup.targets) > 1:
        return np.full(task.data.poses.shape, np.nan)
    data = task.data
    whole = np.asarray(np.isfinite(data.poses).all(axis=1) & np.isfinite(data.readings).all(axis=1))
    twists = np.full(data.poses.shape, np.nan)
    rows = np.flatnonzero(whole)
    if len(rows):
        poses, _ = _given(_part(task, whole), found)
        matrices = mechanism.platform.transforms(poses).as_matrix()
        parameters = found.parameters(mechanism)
        demands = [
            task.residual(i, rows=rows)(parameters[leg.name], matrices)[0]
            for i, leg in enumerate(mechanism.legs)
        ]
        by_pose = np.concatenate([d.pose for d in demands], axis=1)
        gaps = np.concatenate([d.value for d in demands], axis=1)
        twists[rows] = -(np.linalg.pinv(by_pose) @ gaps[:, :, None])[:, :, 0]
    return twists


def _both(fitted: Array, held_out: Array, columns: Mask) -> tuple[float, float] | None:
    """Return root mean square sizes of some columns of twists, or None where there are none."""
    sizes = []
    for twists in (fitted, held_out):
        told = twists[np.isfinite(twists).all(axis=1)][:, columns]
        if not told.size:
            return None
        sizes.append(float(np.sqrt((told**2).sum(axis=1).mean())))
    return sizes[0], sizes[1]


def _drift(whole: Estimate) -> tuple[str, ...]:
    """Return legs whose residuals rise or fall with the order of the rows, in words."""
    words = []
    for robust in whole.fits:
        one = robust.fit
        for index, leg in enumerate(one.problem.legs):
            own = one.problem.used[:, index] & (one.weights > 0.0)
            rows = one.problem.leg_residual(one.last, index)
            values = rows.value[own]
            if len(values) < 10 or not np.ptp(values, axis=0).all():
                continue
            trends = [spearmanr(np.arange(len(values)), column) for column in values.T]
            found = min(trends, key=lambda trend: trend.pvalue)
            if found.pvalue < UNLIKELY / len(one.problem.legs) / len(trends):
                words.append(
                    f"{leg.name}: residuals follow the order of the rows (rank correlation "
                    f"{found.statistic:+.2f}, p = {found.pvalue:.1g}): drift, of temperature or "
                    "of a reference, is likely"
                )
    return tuple(words)
