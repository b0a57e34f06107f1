"""What a view and a picture have in common besides their mechanism: colours, axes, the ground."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pincal.show.style import look
from pincal.show.view.scene import Scene
from pincal.show.view.shapes import Shape

Array = NDArray[np.float64]
#: Where a mechanism in space is seen from: slightly from above.
TOWARDS_VIEWER = (0.45, -0.85, 0.28)
_EVERY = "#333333"
_AXES = ("#CC2626", "#1A8C1A", "#2640D9")


def set_colour(scene: Scene, name: str) -> str:
    """Return the colour of a set, that of its leg; dark for the poses of every leg."""
    names = scene.mechanism.leg_names
    return look(names.index(name)).colour if name in names else _EVERY


def frame_axes(scene: Scene) -> tuple[Shape, ...]:
    """Return the axes of a frame, x red, y green, z blue, of a length that suits the scene."""
    platform = scene.body.parts[scene.body.part("platform/body")]
    length = 5 * platform.shapes[0].size[0]
    axes = []
    for place, colour in enumerate(_AXES):
        T = np.zeros((4, 4))
        T[:3, :3] = np.roll(np.eye(3), 2 - place, axis=1)  # z of the cylinder along the axis
        T[3, 3] = 1.0
        T[place, 3] = length / 2
        axes.append(Shape("cylinder", (0.03 * length, length), T, colour))
    return tuple(axes)


def grid_step(scene: Scene) -> float:
    """Return the lines' distance on the ground, 1, 2 or 5 times a power of ten, [m]."""
    width = float(np.ptp(scene.bounds()[:, :2], axis=0).max())
    wanted = max(width, 1e-9) / 6
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(max(s for s in (1.0, 2.0, 5.0) if s <= wanted / decade * (1 + 1e-9)) * decade)


def ground(scene: Scene) -> Array:
    """Return lines on the ground under all that is drawn, shape (n, 2, 3), [m]."""
    step = grid_step(scene)
    low, high = scene.bounds()[:, :2]
    begin, end = np.floor(low / step) * step, np.ceil(high / step) * step
    lines = []
    for axis in (0, 1):
        at = np.arange(begin[axis], end[axis] + step / 2, step)
        ends = np.zeros((len(at), 2, 3))
        ends[:, :, axis] = at[:, None]
        ends[:, :, 1 - axis] = begin[1 - axis], end[1 - axis]
        lines.append(ends)
    return np.concatenate(lines)
