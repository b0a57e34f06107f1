"""``pincal.picture``: a view's scene as a flat picture, for pages that nothing moves on.

Mechanisms in a plane are seen from above, others from the side, in parallel projection.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from pincal.errors import MeasurementError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.configurations import home_of
from pincal.model.measurements import Plan
from pincal.show.pictures.figure import draw_scene, scene_figure
from pincal.show.pictures.files import figure_bytes, save_figure
from pincal.show.view.scene import MAGNIFY, Scene, plan_of, scene


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of a scene: the mechanism at one pose, all other poses as faint lines."""

    scene: Scene
    row: int = 0
    """Which pose the mechanism is drawn at."""
    dimensions: str = ""
    """Leg whose parameters are drawn as dimensions, if any."""

    def draw(self, axes: Axes) -> Axes:
        """Draw into axes, best inside ``pincal.show.pictures.files.drawing()``."""
        return draw_scene(axes, self.scene, self.row, self.dimensions)

    def figure(self) -> Figure:
        """Return a figure of its own."""
        return scene_figure(self.scene, self.row, self.dimensions)

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the picture as .svg, .png or .pdf, whole or not at all, and return its path.

        The same picture gives the same bytes.

        Raises:
            FileError: the name ends otherwise, or the file exists and ``force`` is not set, or
                it cannot be written.
        """
        return save_figure(self.figure(), path, force=force)

    def _repr_png_(self) -> bytes:
        """Return the picture for notebooks."""
        return figure_bytes(self.figure(), "png")


def picture(
    mechanism: GivenMechanism,
    poses: Plan | ArrayLike | RigidTransform | None = None,
    *,
    row: int = 0,
    identified: GivenMechanism | None = None,
    magnify: float = MAGNIFY,
    dimensions: str = "",
) -> Picture:
    """Return a picture of a mechanism: ``save(path)``, ``figure()``, ``draw(axes)``.

    What ``view`` shows, without a browser: mechanisms in a plane from above, others from the
    side.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        poses: As for ``view``; home if not given.
        row: Which of them the mechanism is drawn at; all others are faint lines, by set.
        identified: The calibrated mechanism, drawn over the nominal one.
        magnify: Factor on what differs between its parameters and the nominal ones.
        dimensions: Name of a leg whose parameters are drawn as lengths and angles.

    Raises:
        MechanismError: poses of a wrong shape, or not finite; an identified mechanism that
            is not one of this mechanism; no such leg.
        MeasurementError: no poses, too many or not whole, no such row; a factor that is not
            positive.
    """
    mechanism = as_mechanism(mechanism)
    plan = plan_of(mechanism, home_of(mechanism) if poses is None else poses)
    if not 0 <= row < max(len(plan.poses), 1):
        raise MeasurementError(
            f"pose {row + 1} is not among the poses; expected 1 to {len(plan.poses)}"
        )
    leg = mechanism.leg(dimensions).name if dimensions else ""
    return Picture(scene(mechanism, plan, None, identified, magnify), row, leg)
