"""What a calibration means, and what a plan promises, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pincal.calibration.result import CalibrationResult
from pincal.calibration.validation import MISSES, Validation
from pincal.design.forecast import SCALE, Drift, Forecast, ScaleEffect
from pincal.design.platform_error import PlatformError, platform_error
from pincal.estimation.observability.identifiable import WeakPair
from pincal.estimation.residuals.losses import CLEAR
from pincal.model.measurements import Noise
from pincal.model.mechanism import Mechanism
from pincal.show.result_tables import gauge, noise_said, turns, unpromised
from pincal.show.workspace_answers import WorkspaceErrors
from pincal.words.numbers import amount, capital, chance, listed, number, rounded, size
from pincal.words.sentences import finding, sentence
from pincal.words.wording import LISTED, group_in_words, missed_line

_NO_FREEDOM = (
    "as many unknowns as measured values: residuals vanish whatever the machine is, and show "
    "nothing; measure more poses"
)
FRAMES = ", but for where the base and platform frames lie"


def verdict_lines(result: CalibrationResult, errors: WorkspaceErrors | None) -> list[str]:
    """Return what to read first: how accurate the machine is, and whether that is so.

    Arguments are those of ``calibration_summary``, which has these lines too.
    """
    first = [result.message] if errors is None else platform_lines(result, errors)
    return [*first, *check_lines(result), noise_line(result), *systematic_lines(result)]


def calibration_summary(result: CalibrationResult, errors: WorkspaceErrors | None) -> list[str]:
    """Return what a calibration means.

    Args:
        result: The calibration.
        errors: The platform's over the workspace; None if the fit did not converge.
    """
    data = result.measurements
    lines = [f"{method_line(result)}; {result.message}", noise_line(result)]
    lines += systematic_lines(result)
    lines += tolerance_lines(result)
    if result.gauge:
        lines.append(
            "fixed by choice, of equal parameters those nearest to nominal: "
            + "; ".join(gauge(result))
        )
    lines += tie_lines(result)
    if result.converged:
        lines += weak_lines(result.weak, result.nominal)
    if errors is not None:
        lines += platform_lines(result, errors)
    lines += check_lines(result)
    unused = len(data) - min(leg.n_poses for leg in result.legs)
    if unused and not result.options.every_pose and data.sets is not None:
        lines.append(sentence(finding("unused-poses", unused=unused, total=len(data))))
    return lines


def method_line(result: CalibrationResult) -> str:
    """Return how parameters were identified."""
    options = result.options
    if options.latent:
        return "all legs together, the poses estimated with the parameters"
    if options.method == "all-legs":
        return "all legs together, the poses taken as measured"
    has_sets = result.measurements.sets is not None and not options.every_pose
    poses = "the poses of its set" if has_sets else "all poses"
    return f"each leg alone by {poses}, taken as measured"


def noise_line(result: CalibrationResult) -> str:
    """Return what the noise is, or how the residuals compare with it."""
    dof, chi2 = result.degrees_of_freedom, result.reduced_chi2
    if result.noise_source in ("estimated", "repeats") and result.noise:
        origin = "the residuals" if result.noise_source == "estimated" else "repeated rows"
        text = f"noise estimated from {origin}: {noise_said(result, result.noise)}"
        if result.noise_source == "estimated":
            return text
        return f"{text}; {f'reduced χ² {rounded(chi2, 3)}' if dof else _NO_FREEDOM}"
    if not dof:
        return _NO_FREEDOM
    return (
        f"reduced χ² {rounded(chi2, 3)} on {dof} degrees of freedom; near 1 the residuals are as "
        "large as the noise given makes them"
    )


_NOISE_SOURCES = {
    "given": "as given",
    "rows": "of each row, in the measurements",
    "repeats": "from rows that were measured repeatedly",
    "estimated": "estimated from the residuals, since none was given",
}


def noise_source(result: CalibrationResult) -> str:
    """Return where the noise comes from."""
    return _NOISE_SOURCES.get(result.noise_source, result.noise_source)


def noise_sizes(result: CalibrationResult) -> str:
    """Return standard deviations of what was measured."""
    if result.noise is not None:
        return f"σ {noise_said(result, result.noise)}"
    data, units = result.measurements, np.array(result.nominal.platform.units)
    sigma = data.sigma_poses
    parts = [None if sigma is None else sigma[:, units == unit] for unit in ("m", "rad")]
    medians = [
        0.0 if part is None or not np.isfinite(part).any() else float(np.nanmedian(part))
        for part in (*parts, data.sigma_readings)
    ]
    return f"σ, median of the rows: {noise_said(result, Noise(*medians))}"


def tolerance_lines(result: CalibrationResult) -> list[str]:
    """Return how far the machine is from its drawing, where that was found by the measurements."""
    return [sentence(finding) for finding in result.findings if finding.code == "tolerance-found"]


def systematic_lines(result: CalibrationResult) -> list[str]:
    """Return what is off by the same in all rows, if anything is said to be."""
    if result.systematic is None or not result.converged:
        return []
    part, total = (
        platform_error(
            result.identified, covariance, result.poses, frames=result.frames_moved
        ).where_determined[0]
        for covariance in (result.systematic, result.covariance)
    )
    scale, share = result.options.setup.systematic, (part / total) ** 2 if total else 0.0
    parts = [f"{1e6 * scale.relative:.3g} µm/m of all lengths"] if scale.relative else []
    parts += [f"{amount(scale.target, 'm')} of each known target"] if scale.target else []
    return [
        f"every ± holds what more rows do not make smaller, {listed(parts)}: {100 * share:.2g} % "
        "of the platform's expected mean square error of position"
    ]


def tie_lines(result: CalibrationResult) -> list[str]:
    """Return whether ties hold."""
    return [
        f"tie of {tie.name}: {'holds' if tie.holds else 'contradicted'} "
        f"({chance(tie.p_value)}, {tie.restrictions} parameters fewer)"
        for tie in result.ties
    ]


def platform_lines(result: CalibrationResult, errors: WorkspaceErrors) -> list[str]:
    """Return how accurate the platform is, where no limit is promised, and what it leaves out."""
    lines = [_platform(result, errors)]
    if result.explained and errors.beyond is not None:
        lines.append(sentence(errors.beyond))
    if result.promises and errors.inside.uncovered:
        lines.append(sentence(finding("promise-leaves-out", what=errors.inside.uncovered)))
    return lines


def _platform(result: CalibrationResult, errors: WorkspaceErrors) -> str:
    """Return by how much the platform was off, and by about how much it should be now."""
    turning = turns(result)
    if not errors.expected.determined.any():
        return "platform: not determined anywhere, since what was held moves it at every pose"
    before = platform_size(errors.mean_before(), turning)
    text = f"platform, root mean square {errors.where}: "
    zeros = ", its zeros as found," if result.begun is not result.nominal else ""
    if not result.explained:
        return (
            f"{text}the calibrated model differs from the nominal one by {before}, but no accuracy "
            f"can be promised of it: residuals are {result.excess:.3g} times as large as the noise "
            f"given makes them{'' if result.corrects else ', and hardly fell'}"
        )
    frames = FRAMES if result.moves_frames else ""
    after = platform_size(errors.mean_after(), turning)
    if not result.promises:
        return (
            f"{text}the nominal model{zeros} was off by {before}, the calibrated one by {after} or "
            f"more{frames}; no limit is promised: {unpromised(result)}"
        )
    limit = platform_size(errors.limit, turning)
    return (
        f"{text}the nominal model{zeros} was off by {before}, the calibrated one by about "
        f"{after}{frames} (expected by the parameters' uncertainties; 95 of 100 such "
        f"calibrations stay below {limit}; ± of single parameters may be larger where they "
        "compensate each other)"
    )


def platform_size(sizes: tuple[float, float], turns: bool) -> str:
    """Return errors of the platform, [m] and [rad]."""
    return size(sizes[0], sizes[1] if turns else None)


def check_lines(result: CalibrationResult) -> list[str]:
    """Return how held-out rows and runs compare."""
    lines, validation = [], result.validation
    if validation is not None:
        rows = (
            f"{validation.folds} folds"
            if validation.folds > 1
            else f"{validation.rows} rows of the set verify"
        )
        lines.append(f"{held_out_line(validation)} ({rows})")
        lines += missed_lines(validation)
    if result.runs is not None:
        lines.append(
            f"{len(result.runs.runs)} runs: parameters spread {result.runs.ratio:.2f} times as "
            f"much as their standard errors say ({chance(result.runs.p_value)})"
        )
    return lines


def checks(result: CalibrationResult, notes: Sequence[str]) -> list[str]:
    """Return what ties, held-out rows and runs show, and notes on what was not done."""
    lines = [capital(line) for line in (*tie_lines(result), *check_lines(result))]
    return [f"{line}." for line in (*lines, *notes)]


def held_out_line(validation: Validation) -> str:
    """Return how rows that a fit has not seen compare with its own, where these fit at all."""
    if validation.fit > MISSES:
        return (
            "held-out rows show nothing: the fit misses even its own rows by "
            f"{validation.fit:.3g} σ. Look at the warnings first"
        )
    return (
        f"held-out rows miss by {validation.held_out:.2f} σ, those of the fit by "
        f"{validation.fit:.2f} σ; {validation.expected:.2f} σ are expected held out"
    )


def missed_lines(validation: Validation) -> list[str]:
    """Return how far targets are missed at held-out rows, measuring noise included."""
    return (
        [missed_line(**vars(target)) for target in validation.targets]
        if validation.fit <= MISSES
        else []
    )


def weak_lines(pairs: Sequence[WeakPair], mechanism: Mechanism) -> list[str]:
    """Return which pairs of parameters are weakly determined; legs alike in one line."""
    groups: dict[tuple[str, ...], list[WeakPair]] = {}
    for pair in pairs:
        (leg, name), (other_leg, second) = _split(pair)
        key = (name, second) if leg == other_leg else (pair.first, pair.second)
        groups.setdefault(key, []).append(pair)
    lines = [_weak_line(group, mechanism) for group in groups.values()]
    omitted = len(lines) - 3
    return lines if omitted <= 0 else [*lines[:3], f"{omitted} more such pairs (--json)"]


def _split(pair: WeakPair) -> list[tuple[str, str]]:
    """Return leg and name of both parameters."""
    return [(leg, name) for leg, _, name in (i.rpartition(".") for i in (pair.first, pair.second))]


def _weak_line(pairs: Sequence[WeakPair], mechanism: Mechanism) -> str:
    """Return a line on a pair of parameters, of one leg or alike of several; the weakest counts."""
    worst, names, owner = pairs[0], _split(pairs[0]), ""
    legs = list(dict.fromkeys(_split(pair)[0][0] for pair in pairs))
    ids = [worst.first, worst.second]
    if len(legs) > 1 and names[0][0] == names[1][0]:
        ids = [name for _, name in names]
        owner = " of every leg" if len(legs) == len(mechanism.legs) else f" of {', '.join(legs)}"
    units = [mechanism.leg(leg).units[name] for leg, name in names]
    known = [
        f"{amount(known_std, unit)} instead of {number(std, unit)} for {id_}"
        for known_std, std, unit, id_ in zip(worst.known, worst.std, units, ids, strict=True)
        if number(known_std, unit) != number(std, unit)
    ]
    return (
        f"{ids[0]} and {ids[1]}{owner} are weakly determined together, correlation "
        f"{worst.correlation:+.3f}: if the other one were known, the standard error would be "
        f"{' and '.join(known)}"
    )


_BEST = "the best that any calibration can reach; 'pincal calibrate' does"
_SAY_SCALE = (
    "no poses separate it from gains and lengths. Say how well the scale is known "
    "(systematic: {scale: …} in the setup), or measure lengths that are known"
)
_MATTERS = 0.5, 1.0  # standard errors: a bias by drift that adds an eighth to what noise leaves
_VERDICTS = (
    "that does not matter beside the noise",
    "that matters little; a drift twice as large would",
    "that matters: measure in turns (pincal select writes such an order), or again in parts",
)
_PER_LEG = "with --method per-leg, which takes each leg alone by the poses of its set"


def forecast_lines(
    forecast: Forecast, error: PlatformError, planned: int, alone: PlatformError | None
) -> list[str]:
    """Return what a plan determines, and what error of the platform that gives.

    Arguments are those of ``forecast_table``.
    """
    turning = "rad" in forecast.mechanism.platform.units
    lines = [*_rank(forecast), *weak_lines(forecast.weak, forecast.mechanism)]
    best = f"; {_BEST}" if error.position < np.inf else ""
    lines.append(f"platform over the workspace: {_expected(error, turning)}{best}")
    if alone is not None:
        lines.append(f"{_PER_LEG}: {_expected(alone, turning)}")
    if forecast.poses < planned:
        lines.append(f"{planned - forecast.poses} of {planned} poses are out of reach")
    return lines


def drift_lines(drifts: Sequence[Drift]) -> list[str]:
    """Return what a drift over the run would do, of all legs together and of each leg alone."""
    heads = (
        "a drift of each measured quantity by one σ over the run, in this order",
        "the same with --method per-leg",
    )
    lines = []
    for head, drift in zip(heads, drifts, strict=False):
        if not np.isfinite(drift.most):  # nothing is determined that could be off
            continue
        text = f"{head}: {drift.worst} off by {drift.most:.2g} standard errors"
        if np.isfinite(drift.share):
            text += f", the platform by {drift.share:.2g} of its expected error"
        size = max(drift.most, float(np.nan_to_num(drift.share)))
        text += f": {_VERDICTS[int(np.searchsorted(_MATTERS, size))]}"
        lines.append(text)
    return lines


def scale_line(effect: ScaleEffect | None) -> list[str]:
    """Return what a wrong scale of the instrument would do.

    Nothing if no lengths are measured, or the platform is not determined in the first place.
    """
    if effect is None or not np.isfinite(effect.platform.position):
        return []
    displacement = amount(effect.platform.position, "m")
    text = (
        f"all lengths measured {1e6 * SCALE:.0f} µm/m too long: the platform off by {displacement}"
    )
    if effect.seen > CLEAR:
        return [f"{text}; residuals would show it, by {effect.seen:.2g} standard deviations"]
    known = "that is taken into what is promised" if effect.said else _SAY_SCALE
    return [f"{text}, and no residual shows it ({effect.seen:.2g} standard deviations): {known}"]


def _rank(forecast: Forecast) -> list[str]:
    """Return what is not determined: first what is no fault of the plan, then what is."""
    rank, count = forecast.rank, forecast.gauge.shape[1]
    start = f"rank {rank.rank} of {rank.n_params}"
    groups = [group_in_words(group) for group in rank.groups]
    lines = [start if count else f"{start}, condition {rank.condition:.3g}"]
    if count:
        group_name = f" ({groups[0]})" if len(groups) == 1 else ""
        lines = [
            f"{start}: {count} {'is a freedom' if count == 1 else 'are freedoms'} of frames, or of "
            f"redundant parameters{group_name}, which such measurements cannot determine. Of "
            "equal parameters those nearest to nominal are meant, and errors of the platform are "
            "what no motion of the base or platform frame explains"
        ]
    if forecast.lost.shape[1]:
        omitted = f"; and {len(groups) - LISTED} more (--json)" if len(groups) > LISTED else ""
        lines.append(f"not determined (—): {'; '.join(groups[:LISTED])}{omitted}")
    return lines


def _expected(error: PlatformError, turning: bool) -> str:
    """Return an error of the platform, and what of it is not determined."""
    sizes = {"position": (error.position, "m")}
    if turning:
        sizes["orientation"] = (error.orientation, "rad")
    known = [amount(value, unit) for value, unit in sizes.values() if value < np.inf]
    lost = [f"{name} not determined" for name, (value, _) in sizes.items() if not value < np.inf]
    return ", ".join([*([f"root mean square {listed(known)}"] if known else []), *lost])


def poses_line(accuracy: float, needed: float, alone: float | None = None) -> str:
    """Return how many poses an accuracy [m] takes, also with each leg alone if that is known."""
    poses = f"{needed:,.0f} poses like these" if np.isfinite(needed) else "no number of poses"
    text = f"for {amount(accuracy, 'm', 6)}: {poses}"
    text += "" if alone is None else f", {alone:,.0f} with --method per-leg"
    if 1e5 < needed < np.inf:
        text += ", which nobody measures: that takes less noise, not more poses"
    return text
