"""The first screen of a report: is it better, by how much, can it be relied on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import gammaincinv

from pincal.calibration.result import CalibrationResult
from pincal.estimation.observability.indices import r_diagonal
from pincal.kinematics.derivatives import leg_demand
from pincal.show import summary
from pincal.show.result_tables import noisy_series, turns, unpromised, warnings
from pincal.show.workspace_answers import ErrorMaps, WorkspaceErrors, error_maps, workspace_errors
from pincal.types import Array
from pincal.words.numbers import SMALL, amount, capital, counted, rounded, shown_in
from pincal.words.sentences import WORDINGS
from pincal.words.wording import rendered


@dataclass(frozen=True)
class ReportFacts:
    """A calibration, what it was made from, and what follows from it."""

    result: CalibrationResult
    errors: WorkspaceErrors | None
    """None if the fit did not converge."""

    @cached_property
    def poses(self) -> Array:
        """Poses of all rows in the base frame, shape (N, dof)."""
        return self.result.poses

    @property
    def turns(self) -> bool:
        """Whether the platform has an orientation."""
        return turns(self.result)

    @cached_property
    def observability(self) -> dict[str, dict[str, float]]:
        """|R_ii| of each identified parameter at the poses used, by leg.

        Of what it moves the readings by, [rad/unit] or [m/unit]; where poses do not determine
        readings, of what it moves the leg's end by, [m/unit].
        """
        by_leg, machine = {}, self.result.identified
        for leg, columns in zip(self.result.legs, machine.reading_columns, strict=True):
            free = [i for i, p in enumerate(leg.parameters) if p.std > 0.0]
            rows = np.unique(leg.rows)
            read = self.result.measurements.readings
            readings = read[rows][:, columns] if machine.by_readings else None
            demand = leg_demand(machine, leg.name, self.poses[rows], readings=readings)
            demand = demand if machine.by_readings else demand.as_joint()
            C = demand.parameter.reshape(-1, len(leg.parameters))
            C = C[np.isfinite(C).all(axis=1)][:, free]
            names = [leg.parameters[i].name for i in free]
            by_leg[leg.name] = dict(zip(names, r_diagonal(C).tolist(), strict=True))
        return by_leg

    @cached_property
    def maps(self) -> ErrorMaps | None:
        """Errors over the workspace; None where none was found, or none can be promised."""
        return None if self.errors is None else error_maps(self.result, self.errors)


def report_facts(result: CalibrationResult) -> ReportFacts:
    """Return what follows from a calibration."""
    return ReportFacts(result, workspace_errors(result) if result.converged else None)


def warning_lines(result: CalibrationResult) -> list[str]:
    """Return what the reader should know first."""
    if result.converged:
        return warnings(result)
    return [f"The fit {result.message}", *warnings(result)]


@dataclass(frozen=True)
class Answers:
    """The three answers; their sentences are the page's."""

    facts: ReportFacts
    notes: Sequence[str]
    """What was not done, and why."""

    def __html__(self) -> str:
        """Return the section for a page."""
        return rendered(
            "answers.html",
            answers=self,
            result=self.facts.result,
            errors=self.facts.errors,
            unpromised=unpromised(self.facts.result),
            wordings=WORDINGS,
            summary=summary,
            amount=amount,
            shown_in=shown_in,
            small=SMALL,
            capital=capital,
            counted=counted,
        )

    @cached_property
    def _ratios(self) -> dict[str, list[float]]:
        """By what the errors of position and orientation fall: as expected, and surely."""
        if (errors := self.facts.errors) is None:
            return {}
        sizes = errors.mean_before(), errors.mean_after(), errors.limit
        before, after, limit = np.array(sizes)[:, : 1 + self.facts.turns]
        ratios = {"expected": before / after, "sure": before / limit}
        return {name: factors.tolist() for name, factors in ratios.items()}

    def times(self, name: str) -> str:
        """Return factors in position and, where the platform turns, in orientation."""
        shown = [f"{rounded(ratio)} times" for ratio in self._ratios[name]]
        if len(set(shown)) == 1:
            return shown[0]
        return f"{shown[0]} (position) and {shown[1]} (orientation)"

    @property
    def better(self) -> tuple[str, str]:
        """Whether it is better, and the look of that: ``"good"``, ``"care"`` or ``"bad"``."""
        result, ratios = self.facts.result, self._ratios["expected"]
        if not result.explained:
            return "Not shown" if result.corrects else "No", "bad"
        if min(ratios) >= 2.0:
            checked = bool(result.degrees_of_freedom) and result.promises
            return ("Yes", "good") if checked else ("Probably", "care")
        return "Hardly" if max(ratios) > 1.0 else "No sign of it", "bad"

    @property
    def residuals(self) -> str:
        """What became of the residuals, where they could have been anything else than zero."""
        if not self.facts.result.degrees_of_freedom:
            return "Residuals are zero, since there are as many unknowns as measured values."
        series = noisy_series(self.facts.result)
        quantities = [block.name for block in series if not block.of_leg]
        names = ", ".join([*(["all legs"] if len(quantities) < len(series) else []), *quantities])
        if len(units := {block.unit for block in series}) > 1:
            before, after = (np.sqrt(np.mean(block**2)) for block in self.facts.result.whitened)
            unit = "standard deviations"
        else:
            (si,) = units
            sizes = np.sqrt(np.mean([np.square(block.rms) for block in series], axis=0))
            before, after, unit = shown_in(sizes[0], si), shown_in(sizes[1], si), SMALL[si]
        return (
            f"At the {'estimated' if quantities else 'measured'} poses, residuals went from "
            f"{before:.3g} to {after:.3g} {unit} (root mean square, {names})."
        )

    @property
    def reliable(self) -> tuple[str, str]:
        """Whether it can be relied on, and the look of that."""
        result = self.facts.result
        if count := len(warnings(result)):
            warned = f"{'one warning' if count == 1 else f'{count} warnings'} above"
            sound = result.promises
            return (f"With care: {warned}", "care") if sound else (f"Not as it is: {warned}", "bad")
        if result.validation is None:
            return "Not tested on rows left out", "care"
        return "Nothing speaks against it", "good"

    @property
    def chi2(self) -> str:
        """How the residuals compare with the noise."""
        result, dof = self.facts.result, self.facts.result.degrees_of_freedom
        line = capital(summary.noise_line(result))
        if result.noise_source == "estimated":
            return f"{line}; so residuals cannot contradict it."
        if not dof:
            return f"{line}."
        text = f"Reduced χ² {rounded(result.reduced_chi2, 3)} on {dof} degrees of freedom"
        if result.loss == "none":
            free = result.chi2_freedoms
            low, high = 2.0 * gammaincinv(free / 2.0, (0.025, 0.975)) / free
            text += f"; {low:.2f} to {high:.2f} is expected by the noise"
        return text + "."
