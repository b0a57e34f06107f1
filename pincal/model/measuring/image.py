"""The pictures that an instrument takes: which of its columns are points of them, and where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pincal.errors import MeasurementError
from pincal.model.checks import count_of, must_be, number_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Image:
    """What columns of an instrument are in the picture that it takes, for plots of residuals.

    An instrument that has one as its ``image`` is a camera to ``result.plot.images()``.

    Example:
        >>> import pincal
        >>> image = pincal.Image((1600, 1200), {"tip": ("tip_u", "tip_v")}, scale=1500.0)
        >>> image.at([0.1], [-0.2]).tolist()
        [[950.0, 300.0]]
    """

    size: tuple[int, int]
    """Width and height, [px]."""
    points: Mapping[str, tuple[str, str]]
    """Columns that point right and down, by the names of the points seen."""
    scale: float
    """Pixels per unit of the columns: of tangents of angles the focal length, [px]."""
    centre: tuple[float, float] | None = None
    """Where both columns are zero, from the upper left corner, [px]; the middle if not given."""

    def __post_init__(self) -> None:
        size = must_be(self.size, (tuple, list), "size of an image", MeasurementError)
        if len(size) != 2:
            raise MeasurementError(f"size of an image is {size!r}; expected width and height in px")
        for one in size:
            count_of(one, "size of an image [px]", MeasurementError, 1)
        if not number_of(self.scale, "scale of an image", MeasurementError) > 0.0:
            raise MeasurementError(f"scale of an image is {self.scale:g}; expected more than 0")
        for name, columns in must_be(
            self.points, Mapping, "points of an image", MeasurementError
        ).items():
            if isinstance(columns, str) or len(columns) != 2:
                raise MeasurementError(
                    f"point {name!r} of an image has the columns {columns!r}; expected two: one "
                    "that points right, one that points down"
                )

    def at(self, right: Array, down: Array) -> Array:
        """Return places in the image, shape (N, 2), [px], of values of columns, shape (N,)."""
        middle = np.array(self.size) / 2 if self.centre is None else np.array(self.centre)
        return np.asarray(middle + self.scale * np.column_stack((right, down)))


@runtime_checkable
class Camera(Protocol):
    """An instrument that takes pictures."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def image(self) -> Image:
        """What its columns are in them."""
