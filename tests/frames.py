"""Tables of measurements as pandas reads them, whose columns tests change."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pandas

import pincal


def frame_of(data: pincal.Plan, mechanism: pincal.Mechanism, **ways: Any) -> pandas.DataFrame:
    """Return the table that measurements are written to, to change its columns."""
    with TemporaryDirectory() as folder:
        data.to_csv(Path(folder, "m.csv"), mechanism, **ways)
        return pandas.read_csv(
            Path(folder, "m.csv"),
            dtype={"pose": str},
            keep_default_na=False,
        )
