"""Pages: to save, or to see in a notebook; what mechanisms and results show there and in print."""

from __future__ import annotations

import html
from functools import cached_property
from pathlib import Path
from typing import ClassVar

from pincal.calibration.result import CalibrationResult
from pincal.files.output import writing
from pincal.model.mechanism import Mechanism
from pincal.show import answers, tables
from pincal.show.pictures.files import page_figure
from pincal.show.pictures.picture import picture
from pincal.words.wording import rendered


class Page:
    """A page, made when it is first asked for."""

    sandbox: ClassVar[str] = ""
    """What its scripts may do in a notebook."""
    height: ClassVar[str] = "800px"
    """Of the frame in a notebook."""

    def html(self) -> str:
        """Return the page, which needs no server, no other file and no network."""
        return self._page

    @cached_property
    def _page(self) -> str:
        raise NotImplementedError

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the page to a file, whole or not at all, and return its path.

        Raises:
            FileError: the file exists and ``force`` is not set, or cannot be written.
        """
        with writing(path, force=force) as scratch:
            scratch.write_text(self.html(), encoding="utf-8")
        return Path(path)

    def _repr_html_(self) -> str:
        """Return the page in a frame, for notebooks."""
        return (
            f'<iframe sandbox="{self.sandbox}" style="width: 100%; height: {self.height}; '
            f'border: 0" srcdoc="{html.escape(self.html())}"></iframe>'
        )


def mechanism_text(mechanism: Mechanism) -> str:
    """Return a mechanism as a page of text: platform, legs, nominal parameters."""
    platform = mechanism.platform
    home = zip(platform.coordinates, platform.home, platform.units, strict=True)
    lines = [
        f"{mechanism.name}{': ' * bool(mechanism.description)}{mechanism.description}",
        f"platform {platform.kind}, at home "
        + ", ".join(f"{name} = {value:.6g} {unit}" for name, value, unit in home),
    ]
    lines += [
        f"{leg.name}: {leg.joint_letters}, reads {', '.join(leg.reading_names)}, closes a "
        f"{leg.closes}"
        for leg in mechanism.legs
    ]
    return "\n".join([*lines, "", str(tables.nominal_table(mechanism))])


def mechanism_html(mechanism: Mechanism) -> str:
    """Return a mechanism: a picture and its nominal parameters."""
    caption = f"{mechanism.name} at home"
    drawn = page_figure("mechanism", picture(mechanism).draw, caption)
    coordinates = ", ".join(mechanism.platform.coordinates)
    title = f"{mechanism.name}: {len(mechanism.legs)} legs, {coordinates}"
    parts = [*filter(None, [mechanism.description]), drawn, tables.nominal_table(mechanism)]
    return rendered("notebook.html", title=title, warnings=[], parts=parts)


def result_html(result: CalibrationResult) -> str:
    """Return a calibration: what to know first, what supports it, its tables."""
    shown = tables.calibration_tables(result) if result.converged else []
    title = f"{result.nominal.name}: calibration, {result.message}"
    parts = [answers.supporting_lines(result, None), *shown]
    return rendered("notebook.html", title=title, warnings=answers.warnings(result), parts=parts)
