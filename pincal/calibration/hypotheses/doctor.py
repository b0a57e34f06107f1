"""The doctor: faults of measurements put right one by one, and the calibration that then works.

As measured; with what explains the misfit put right; each of these without rows that do not fit;
the same in an unknown frame, and of an unknown target too; of a machine known roughly. A remedy
works if its search converges and nothing contradicts it, rows held out included: as
``pincal calibrate`` has it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from pincal.blas import one_thread
from pincal.calibration.calibrate import run
from pincal.calibration.calibration import Calibration
from pincal.calibration.hypotheses.plausibility import check_noise, hypotheses_of
from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError, PincalError
from pincal.finding import Finding

_FEW = 0.25  # of the rows: more that do not fit are no outliers


@dataclass(frozen=True)
class Remedy:
    """What was put right, and what calibration then gives."""

    findings: tuple[Finding, ...]
    """What was wrong with the measurements, if this is what was; empty if nothing was."""
    calibration: Calibration
    """Measurements put right, and options that help."""
    result: CalibrationResult | None
    """None if calibration refused."""
    trouble: str
    """Why it was refused; empty if it was not."""
    whatever_the_loss: bool = False
    """Whether it was refused for what is so in most rows."""

    @property
    def works(self) -> bool:
        """Whether the search converged, nothing contradicts it, and every row that counts fits."""
        result = self.result
        if result is None or not result.converged or not result.promises:
            return False
        return all(outlier.weight == 0.0 for outlier in result.outliers)

    @property
    def mends(self) -> bool:
        """Whether the measurements themselves were put right: options do not do it."""
        return any(remark.code != "unknown-frame" for remark in self.findings)


def remedies(calibration: Calibration) -> Iterator[Remedy]:
    """Yield what was tried, the simplest first, until something works.

    Explanations that fit alike are all tried: several may work, and the measurements do not say
    which is true.
    """
    for stage in _stages(calibration):
        yield from stage
        if any(remedy.works for remedy in stage):
            return


def _stages(calibration: Calibration) -> Iterator[list[Remedy]]:
    setup = calibration.options.setup
    framed, placed = setup.anywhere(frame=True), setup.anywhere(frame=True, target=True)
    setups = [setup] + [framed] * (framed != setup) + [placed] * (placed != framed)
    for known in setups:  # the less is known of frame and target
        in_setup = calibration.with_options(setup=known)
        first = _attempt((), in_setup)
        yield [first]
        explained = []
        for fault, judged in hypotheses_of(in_setup):
            data = judged.hypothesis.right(calibration.measurements)
            judged_setup = known.anywhere(frame=judged.free)
            mended = replace(in_setup, measurements=data).with_options(setup=judged_setup)
            explained.append(_attempt((fault,), mended))
        yield explained
        if not explained and any(in_setup.short_legs()):
            return  # nothing else is wrong
        yield _rejecting([first, *explained])
    if not calibration.options.rough:
        rough = _attempt((), calibration.with_options(rough=True))
        yield [rough]
        yield _rejecting([rough])


def _rejecting(remedies: Sequence[Remedy]) -> list[Remedy]:
    """Return what remedies give without rows that do not fit, where these are few."""
    few = []
    for remedy in remedies:
        lost = remedy.result is not None and not remedy.result.converged
        if remedy.whatever_the_loss or lost or remedy.calibration.options.loss != "none":
            continue
        fewer = _attempt(remedy.findings, remedy.calibration.with_options(loss="reject"))
        if fewer.result is not None:
            left_out = sum(outlier.weight == 0.0 for outlier in fewer.result.outliers)
            few += [fewer] * (left_out <= _FEW * len(fewer.result.measurements))
    return few


@one_thread()
def _attempt(findings: tuple[Finding, ...], calibration: Calibration) -> Remedy:
    try:
        result, *_ = run(calibration)
    except PincalError as error:
        return Remedy(findings, calibration, None, str(error), isinstance(error, MeasurementError))
    try:
        check_noise(calibration.mechanism, result.noise)  # an estimate may be what went wrong
    except MeasurementError:
        return Remedy(findings, calibration, None, "residuals are too large for noise")
    remedy = Remedy(findings, calibration, result, "")
    if not remedy.works:
        return remedy
    try:
        return replace(remedy, result=result.validated())
    except (PincalError, ArithmeticError):
        return remedy
