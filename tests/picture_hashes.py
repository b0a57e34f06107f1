"""Pictures as difference hashes of 256 bits, kept in one file: changes of looks are found.

``python tests/picture_hashes.py`` writes the file anew, after pictures were looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import pincal
from pincal.files.mechanism_folders import bundled
from pincal.show.style import drawing, figure_bytes

KEPT = Path(__file__).with_name("picture_hashes.txt")
#: Bits by which two machines' letters may differ.
SAME = 6
NOISE = pincal.Noise(1e-4, 1e-4)
FIGURES = ("residuals",)


def difference_hash(png: bytes, across: int = 16) -> int:
    """Return whether each cell of a picture is brighter than its right neighbour, as bits.

    Args:
        png: The picture.
        across: Cells along each side.
    """
    grey = Image.open(BytesIO(png)).convert("L")
    cells = np.asarray(grey.resize((across + 1, across), Image.Resampling.BOX), dtype=np.int64)
    bits = (cells[:, :-1] - cells[:, 1:] > 1).ravel()  # paper is no brighter than paper
    return int("".join("1" if bit else "0" for bit in bits), 2)


def apart(one: int, other: int) -> int:
    """Return the number of bits in which two hashes differ."""
    return (one ^ other).bit_count()


def calibration() -> pincal.CalibrationResult:
    """Return the calibration whose figures are hashed."""
    mechanism = pincal.load_mechanism("5R")
    truth = pincal.disturb(mechanism, 2e-3, seed=1)
    shift = np.random.default_rng(2).uniform(-0.3, 0.3, (30, 2))
    plan = pincal.Plan(mechanism.platform.home + shift)
    data = pincal.simulate(mechanism, truth, plan, NOISE, 3).measurements
    return pincal.calibrate(mechanism, data, noise=NOISE)


def of_mechanism(name: str) -> bytes:
    """Return the picture of a bundled mechanism at home."""
    return figure_bytes(pincal.picture(name).figure(), "png")


def of_result(kind: str) -> bytes:
    """Return a figure of the calibration."""
    with drawing():
        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        getattr(calibration().plot, kind)(figure.subplots())
    return figure_bytes(figure, "png")


def pictures() -> dict[str, Callable[[], bytes]]:
    """Return what draws each picture, by name."""
    found: dict[str, Callable[[], bytes]] = {
        name: partial(of_mechanism, name) for name in bundled()
    }
    return found | {f"plot {kind}": partial(of_result, kind) for kind in FIGURES}


def kept() -> dict[str, int]:
    """Return the hashes of the file, by name."""
    lines = (line.rsplit(" ", 1) for line in KEPT.read_text("utf-8").splitlines())
    return {name: int(bits, 16) for name, bits in lines}


if __name__ == "__main__":
    text = [f"{name} {difference_hash(draw()):064x}" for name, draw in pictures().items()]
    KEPT.write_text("\n".join(text) + "\n", encoding="utf-8")
