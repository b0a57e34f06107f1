"""``pincal.explain``: what geometry does not explain in measurements, and which terms pay."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pincal.blas import on_one_thread
from pincal.calibration.calibrate import prepared, run, started
from pincal.calibration.calibration import Calibration
from pincal.calibration.options import AUTO, Options
from pincal.calibration.terms.choice import Explanation, choose
from pincal.calibration.terms.kinds import every_pair, parse_terms
from pincal.model.measurements import Measurements
from pincal.model.mechanism import Mechanism


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
    return Explanation(result, *choose(started(plain), pairs))
