"""``pincal explain``: what geometry does not explain, and which terms pay."""

from __future__ import annotations

import shlex
from dataclasses import asdict, replace

from pincal.calibration.options import AUTO
from pincal.calibration.terms.explain import explained
from pincal.cli.app import Measured, Mech, answer, command, stdout, typed, warn, working
from pincal.cli.commands.calibration import CalibrateOptions
from pincal.errors import MeasurementError
from pincal.show.explanation import explanation_lines, models_table, screen_table
from pincal.show.result_tables import warnings


@command(answers=True)
def explain(
    mech: Mech,
    measurements: Measured,
    how: CalibrateOptions,
) -> None:
    """Say what geometry does not explain, and which terms pay.

    Every reading is tried with harmonics of its angle, polynomials, backlash, gravity (where the
    mechanism says what weighs on it), and every other column of numbers; lengths with such columns,
    each alone and all as one, and links with gravity. Models are compared on poses that their fits
    have not seen. --terms says which kinds to try.
    """
    if how.folds < 2:
        raise MeasurementError("--folds: expected 2 or more: models are compared on held-out rows")
    mechanism = how.load(mech)
    asked = replace(how, terms=how.terms or [AUTO])
    with working("identifying parameters") as progress:
        calibration = asked.calibration(mechanism, measurements)
        options = replace(calibration.options, progress=progress)
        found = explained(replace(calibration, options=options))
    for text in warnings(found.result):
        warn(text)
    stdout.print(screen_table(found))
    stdout.print(models_table(found))
    for line in explanation_lines(found):
        stdout.print(line, markup=False, soft_wrap=True)
    line = _line(found.terms)
    if line:
        stdout.print(f"  {line}", markup=False, soft_wrap=True)
    answer(
        {
            "verdict": found.verdict,
            "terms": list(found.terms),
            "command": line or None,
            "candidates": screen_table(found).records(),
            "models": models_table(found).records(),
            "slips": [asdict(one) | {"size": one.size.tolist()} for one in found.choice.slips],
            "noise_at_least": [asdict(one) for one in found.choice.bounds],
            "folds_left_out": [fold + 1 for fold, _ in found.choice.lost],
        }
    )


def _line(terms: tuple[str, ...]) -> str:
    """Return the command that calibrates with terms, empty if there are none."""
    if not terms:
        return ""
    typed_in = shlex.split(typed())
    typed_in[typed_in.index("explain")] = "calibrate"
    while "--terms" in typed_in:  # those that were tried
        place = typed_in.index("--terms")
        del typed_in[place : place + 2]
    typed_in = [word for word in typed_in if not word.startswith("--terms=")]
    added = [word for one in terms for word in ("--terms", one)]
    return shlex.join([*typed_in, *added, "-o", "RESULT"])
