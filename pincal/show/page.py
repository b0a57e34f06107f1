"""Pages: to save, or to see in a notebook, where they stand in a frame of their own."""

from __future__ import annotations

import html
from pathlib import Path
from typing import ClassVar

from pincal.files.output import writing


class Page:
    """A page, which needs no other file and no network."""

    sandbox: ClassVar[str] = ""
    """What its scripts may do in a notebook."""
    height: ClassVar[str] = "800px"
    """Of the frame in a notebook."""

    def html(self) -> str:
        """Return the page."""
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
