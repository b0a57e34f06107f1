"""Pages: to save, or to see in a notebook, where they stand in a frame of their own."""

from __future__ import annotations

import html
from functools import cached_property
from pathlib import Path
from typing import ClassVar

from pincal.files.output import writing


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
