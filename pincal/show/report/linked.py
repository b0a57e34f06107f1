"""A report and a view side by side, as one page: what is pointed at in one is shown in the other.

Both panes are the pages that they are alone. An outlier's row leads the mechanism to its pose; a
parameter's row lights up its leg, and its dimension in the drawing.
"""

from __future__ import annotations

import json
from functools import cached_property

import numpy as np

from pincal.model.measuring.measurements import Plan
from pincal.show.page import Page
from pincal.show.report.report import Report
from pincal.show.report.verdicts import verdicts
from pincal.show.results import warnings
from pincal.show.view.calibrated import calibrated
from pincal.show.view.scene import MAGNIFY, MOST_POSES, plan_of, scene
from pincal.show.view.view import View
from pincal.words.pages import rendered


class LinkedPage(Page):
    """A report and the view of its rows."""

    sandbox = "allow-scripts allow-same-origin"

    def __init__(self, report: Report, magnify: float = MAGNIFY) -> None:
        self.report = report
        result = report.found.result
        whole = np.flatnonzero(np.isfinite(result.poses).all(axis=1))[:MOST_POSES]
        read = result.measurements.readings
        sets = result.measurements.sets
        plan = Plan(
            result.poses[whole],
            None if sets is None else tuple(sets[row] for row in whole),
            readings=None if read is None else read[whole],
        )
        identified = result.identified if result.converged else None
        shown = scene(result.nominal, plan_of(result.nominal, plan), None, identified, magnify)
        shown = calibrated(shown, result, report.found.errors)
        self.view = View(shown, "poses of the measurements", warnings(result))
        self.rows = {str(row + 1): place for place, row in enumerate(whole.tolist())}

    @cached_property
    def _page(self) -> str:
        return rendered(
            "linked.html",
            title=f"{self.report.found.result.nominal.name}: calibration",
            report=self.report.html(),
            view=self.view.html(),
            verdicts=verdicts(self.report.found.result),
            data=json.dumps({"rows": self.rows}),
        )
