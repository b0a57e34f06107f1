"""What a calibration means, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from pincal.calibration.checks.validation import MISSES, Validation
from pincal.calibration.result import CalibrationResult
from pincal.design.platform_error import platform_error
from pincal.estimation.observability.weak import WeakPair
from pincal.model.mechanism import Mechanism
from pincal.show.results import gauge, noise_said, turns, unpromised
from pincal.show.workspace_errors import WorkspaceErrors
from pincal.words.numbers import amount, chance, number, rounded, size
from pincal.words.results import missed, systematic
from pincal.words.sentences import finding, sentence

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
    if result.shift is not None and result.outliers:
        count = len(result.outliers)
        rows = "the row that does" if count == 1 else f"the {count} rows that do"
        lines.append(
            f"with {rows} not fit, parameters would move by up to {result.shift:.1f} standard "
            "errors"
        )
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
    own = result.measurements.sets is not None and not options.every_pose
    return f"each leg alone by {'the poses of its set' if own else 'all poses'}, taken as measured"


def noise_line(result: CalibrationResult) -> str:
    """Return what the noise is, or how the residuals compare with it."""
    dof, chi2 = result.degrees_of_freedom, result.reduced_chi2
    if result.noise_source in ("estimated", "repeats") and result.noise:
        where = "the residuals" if result.noise_source == "estimated" else "repeated rows"
        text = f"noise estimated from {where}: {noise_said(result, result.noise)}"
        if result.noise_source == "estimated":
            return text
        return f"{text}; {f'reduced χ² {rounded(chi2, 3)}' if dof else _NO_FREEDOM}"
    if not dof:
        return _NO_FREEDOM
    return (
        f"reduced χ² {rounded(chi2, 3)} on {dof} degrees of freedom; near 1 the residuals are as "
        "large as the noise given makes them"
    )


def tolerance_lines(result: CalibrationResult) -> list[str]:
    """Return how far the machine is from its drawing, where that was found by the measurements."""
    return [sentence(one) for one in result.findings if one.code == "tolerance-found"]


def systematic_lines(result: CalibrationResult) -> list[str]:
    """Return what is off by the same in all rows, if anything is said to be."""
    if result.systematic is None or not result.converged:
        return []
    part, whole = (
        platform_error(
            result.identified, one, result.poses, frames=result.frames_moved
        ).where_determined[0]
        for one in (result.systematic, result.covariance)
    )
    own, share = result.options.setup.systematic, (part / whole) ** 2 if whole else 0.0
    return [systematic({"relative": own.relative, "target": own.target, "share": share})]


def tie_lines(result: CalibrationResult) -> list[str]:
    """Return whether ties hold."""
    return [
        f"tie of {one.name}: {'holds' if one.holds else 'contradicted'} "
        f"({chance(one.p_value)}, {one.restrictions} parameters fewer)"
        for one in result.ties
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
    found = ", its zeros as found," if result.begun is not result.nominal else ""
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
            f"{text}the nominal model{found} was off by {before}, the calibrated one by {after} or "
            f"more{frames}; no limit is promised: {unpromised(result)}"
        )
    limit = platform_size(errors.limit, turning)
    return (
        f"{text}the nominal model{found} was off by {before}, the calibrated one by about "
        f"{after}{frames} (expected by the parameters' uncertainties; 95 of 100 such "
        f"calibrations stay below {limit}; ± of single parameters may be larger where they "
        "compensate each other)"
    )


def platform_size(sizes: tuple[float, float], turns: bool) -> str:
    """Return errors of the platform, [m] and [rad]."""
    return size(sizes[0], sizes[1] if turns else None)


def check_lines(result: CalibrationResult) -> list[str]:
    """Return how held-out rows and runs compare."""
    lines, one = [], result.validation
    if one is not None:
        by = f"{one.folds} folds" if one.folds > 1 else f"{one.rows} rows of the set verify"
        lines.append(f"{held_out_line(one)} ({by})")
        lines += missed_lines(one)
    if result.runs is not None:
        lines.append(
            f"{len(result.runs.runs)} runs: parameters spread {result.runs.ratio:.2f} times as "
            f"much as their standard errors say ({chance(result.runs.p_value)})"
        )
    return lines


def held_out_line(one: Validation) -> str:
    """Return how rows that a fit has not seen compare with its own, where these fit at all."""
    if one.fit > MISSES:
        return (
            f"held-out rows show nothing: the fit misses even its own rows by {one.fit:.3g} σ. "
            "Look at the warnings first"
        )
    return (
        f"held-out rows miss by {one.held_out:.2f} σ, those of the fit by {one.fit:.2f} σ; "
        f"{one.expected:.2f} σ are expected held out"
    )


def missed_lines(one: Validation) -> list[str]:
    """Return how far targets are missed at held-out rows, measuring noise included."""
    return [missed(vars(own)) for own in one.targets] if one.fit <= MISSES else []


def weak_lines(pairs: Sequence[WeakPair], mechanism: Mechanism) -> list[str]:
    """Return which pairs of parameters are weakly determined; legs alike in one line."""
    alike: dict[tuple[str, ...], list[WeakPair]] = {}
    for pair in pairs:
        (leg, name), (other_leg, other) = _split(pair)
        key = (name, other) if leg == other_leg else (pair.first, pair.second)
        alike.setdefault(key, []).append(pair)
    lines = [_weak_line(own, mechanism) for own in alike.values()]
    more = len(lines) - 3
    return lines if more <= 0 else [*lines[:3], f"{more} more such pairs (--json)"]


def _split(pair: WeakPair) -> list[tuple[str, str]]:
    """Return leg and name of both parameters."""
    return [(leg, name) for leg, _, name in (i.rpartition(".") for i in (pair.first, pair.second))]


def _weak_line(pairs: Sequence[WeakPair], mechanism: Mechanism) -> str:
    """Return a line on a pair of parameters, of one leg or alike of several; the weakest counts."""
    worst, both, whose = pairs[0], _split(pairs[0]), ""
    legs = list(dict.fromkeys(_split(pair)[0][0] for pair in pairs))
    ids = [worst.first, worst.second]
    if len(legs) > 1 and both[0][0] == both[1][0]:
        ids = [name for _, name in both]
        whose = " of every leg" if len(legs) == len(mechanism.legs) else f" of {', '.join(legs)}"
    units = [mechanism.leg(leg).units[name] for leg, name in both]
    known = [
        f"{amount(now, unit)} instead of {number(std, unit)} for {id_}"
        for now, std, unit, id_ in zip(worst.known, worst.std, units, ids, strict=True)
        if number(now, unit) != number(std, unit)
    ]
    return (
        f"{ids[0]} and {ids[1]}{whose} are weakly determined together, correlation "
        f"{worst.correlation:+.3f}: if the other one were known, the standard error would be "
        f"{' and '.join(known)}"
    )
