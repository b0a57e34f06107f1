"""What geometry does not explain in measurements: a screen of what sensors lack, and what pays."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from pincal.attached import attached
from pincal.blas import on_one_thread
from pincal.calibration.calibrate import prepared, run, started
from pincal.calibration.calibration import Calibration
from pincal.calibration.options import AUTO, Options
from pincal.calibration.result import CalibrationResult
from pincal.calibration.terms.choice import Choice, choose
from pincal.calibration.terms.kinds import every_pair, parse_terms, term_text
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism

Verdict = Literal["as drawn", "rigid alignment", "geometry", "terms", "not compared"]


@dataclass(frozen=True, repr=False)
class Explanation:
    """What residuals of a calibration follow, and which model predicts rows best.

    Example:
        >>> import numpy as np, pincal
        >>> plan = pincal.Plan(pincal.sample_workspace("5R", 40, seed=0))
        >>> truth = pincal.disturb("5R", 1e-3, seed=1)
        >>> noise = pincal.Noise(position=1e-4)
        >>> data = pincal.simulate("5R", truth, plan, noise, seed=1).measurements
        >>> found = pincal.explain("5R", data, noise=noise, terms=["harmonics"])
        >>> found.terms  # geometry is all there is
        ()
    """

    result: CalibrationResult
    """The calibration of the geometry."""
    choice: Choice
    """Candidates of the screen, and the models compared."""

    @property
    def verdict(self) -> Verdict:
        """Which model to take; ``"not compared"`` where no fold can be identified."""
        if np.isnan(self.choice.model.held_out):
            return "not compared"
        if self.choice.chosen > 1:
            return "terms"
        name: Verdict = self.choice.model.name  # type: ignore[assignment]
        return name

    @property
    def terms(self) -> tuple[str, ...]:
        """The terms that pay, as options say them: ``leg_2=harmonics:1``, ``leg_1.l=warm``."""
        return tuple(term_text(*term) for term in self.choice.model.added)

    @attached
    def __str__(self) -> str:
        """Return a page: what residuals follow, the models compared, and what to do."""

    def __repr__(self) -> str:
        found = ", ".join(self.terms) or self.verdict
        return f"Explanation({self.result.nominal.name!r}: {found})"


def explain(
    mechanism: Mechanism | str | Path,
    measurements: Measurements | str | Path | Any,
    options: Options | None = None,
    **single_options: Any,
) -> Explanation:
    """Return what a calibration's residuals follow, and which terms pay.

    Args:
        mechanism: The nominal mechanism; or its name or folder.
        measurements: What was measured; or a CSV file or a DataFrame of it, whose other columns
            of numbers (temperature, time, …) are tried too.
        options: How to calibrate; ``terms`` are the kinds to try, all if none are given.
        **single_options: Single options by name, such as ``folds=``: see ``Options``.

    Raises:
        MeasurementError: measurements that cannot be this mechanism's, or an unknown kind of term.
        ObservabilityError: too few poses, or poses that leave parameters undetermined.
    """
    chosen = Options.of(options, **single_options)
    with_terms = replace(chosen, terms=chosen.terms or (AUTO,))
    return explained(prepared(mechanism, measurements, with_terms))


@on_one_thread
def explained(calibration: Calibration) -> Explanation:
    """Return what ``explain`` does, of a calibration to be done; its terms are those to try."""
    tried = calibration.options.terms
    plain = replace(calibration, options=replace(calibration.options, terms=()))
    named = parse_terms([term for term in tried if term != AUTO], plain.mechanism)
    every = every_pair(plain.mechanism, plain.measurements) if AUTO in tried else []
    pairs = list(dict.fromkeys((*named, *every)))
    result, _ = run(plain)
    return Explanation(result, choose(started(plain), pairs))
