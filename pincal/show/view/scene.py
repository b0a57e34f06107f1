"""What a view or a picture shows: a mechanism at poses, an identified one beside it, layers.

All of it is plain: parts that move (``bodies``), and layers of dots and lines that stand still.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from pincal.errors import MeasurementError, MechanismError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.forward import forward
from pincal.model.measurements import EVERY_LEG, Plan
from pincal.model.mechanism import Mechanism
from pincal.show.style import EVERY, GROUND, TOWARDS_VIEWER, look
from pincal.show.view.bodies import Body, body
from pincal.types import Array

MOST_POSES = 2000
MAGNIFY = 10.0


@dataclass(frozen=True, eq=False)
class Layer:
    """Dots or lines that stand still."""

    path: str
    """Place in the scene."""
    name: str
    points: Array
    """Dots, shape (n, 3), or segments, shape (n, 2, 3), base frame, [m]."""
    colour: str
    pixels: int = 2
    """Of a dot."""


@dataclass(frozen=True, eq=False)
class Scene:
    """All that a view shows."""

    mechanism: Mechanism
    plan: Plan
    body: Body
    identified: Mechanism | None = None
    """The calibrated mechanism."""
    magnify: float = MAGNIFY
    """Factor on what differs between its parameters and the nominal ones."""
    magnified: Body | None = None
    """The machine of these parameters where the nominal model's readings drive it."""
    layers: tuple[Layer, ...] = ()
    """Beside the ground and the poses: what a calibration found."""

    @property
    def sets(self) -> tuple[str, ...]:
        """Set of each pose: a leg's name, ``"all"`` for every leg, empty where there are none."""
        if self.plan.sets is None:
            return ("",) * len(self.plan.poses)
        return tuple(name or EVERY_LEG for name in self.plan.sets)

    @property
    def planar(self) -> bool:
        """Whether all moves in the x-y plane."""
        return self.mechanism.platform.space == 2

    @property
    def axes(self) -> Array:
        """What points right, up and towards the viewer, shape (3, 3), rows in the base frame."""
        if self.planar:
            return np.eye(3)
        towards = np.array(TOWARDS_VIEWER) / np.linalg.norm(TOWARDS_VIEWER)
        right = np.cross([0.0, 0.0, 1.0], towards)
        right /= np.linalg.norm(right)
        return np.stack((right, np.cross(towards, right), towards))

    def by_set(self) -> Iterator[tuple[str, str, Array, Array]]:
        """Yield name, colour, positions (n, 3) and legs' segments (k, 2, 3) of each set, [m]."""
        positions, skeletons = self.body.platform[:, :3, 3], self.body.skeletons()
        for name in dict.fromkeys(self.sets):
            in_set = np.array(self.sets) == name
            lines = skeletons[in_set].reshape(-1, 2, 3)
            drawn = np.isfinite(lines).all(axis=(1, 2))
            yield name, self.colour(name), positions[in_set], lines[drawn]

    def colour(self, name: str) -> str:
        """Return the colour of a set, that of its leg; dark for the poses of every leg."""
        names = self.mechanism.leg_names
        return look(names.index(name)).colour if name in names else EVERY

    def points(self) -> Array:
        """Return where parts, feet and positions are, shape (n, 3), [m]; NaN if not drawn."""
        bodies = filter(None, (self.body, self.magnified))
        parts = [shown.placements[:, :, :3, 3].reshape(-1, 3) for shown in bodies]
        feet = [leg.joints[0].placement.xyz for leg in self.mechanism.legs]
        return np.concatenate((feet, *parts))

    def bounds(self) -> Array:
        """Return least and largest coordinates of what ``points`` returns, shape (2, 3), [m]."""
        points = self.points()
        return np.stack((np.nanmin(points, axis=0), np.nanmax(points, axis=0)))

    @property
    def size(self) -> float:
        """Diagonal of the bounds, [m]."""
        return float(np.linalg.norm(np.ptp(self.bounds(), axis=0)))

    @property
    def level(self) -> float:
        """Height of the ground, [m]: in a plane that, in space as low as the lowest part."""
        return 0.0 if self.planar else float(self.bounds()[0, 2])

    def ground(self) -> Layer:
        """Return lines on the ground under all that is drawn, at steps of 1, 2 or 5 decades."""
        low, high = self.bounds()[:, :2]
        step = rounded_down(max(float((high - low).max()), 1e-9) / 6)
        begin, end = np.floor(low / step) * step, np.ceil(high / step) * step
        lines = []
        for axis in (0, 1):
            places = np.arange(begin[axis], end[axis] + step / 2, step)
            ends = np.full((len(places), 2, 3), self.level)
            ends[:, :, axis] = places[:, None]
            ends[:, :, 1 - axis] = begin[1 - axis], end[1 - axis]
            lines.append(ends)
        return Layer("grid", f"grid {1e3 * step:.6g} mm", np.concatenate(lines), GROUND)


def rounded_down(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(max(s for s in (1.0, 2.0, 5.0) if s <= value / decade * (1 + 1e-9)) * decade)


def scene(
    mechanism: Mechanism,
    poses: Plan | ArrayLike | RigidTransform,
    identified: GivenMechanism | None = None,
    magnify: float = MAGNIFY,
) -> Scene:
    """Return the scene of a mechanism at poses; all as of ``view``."""
    coordinates_of = mechanism.platform.coordinates_of
    plan = poses if isinstance(poses, Plan) else Plan(coordinates_of(poses))
    if not 0 < len(plan.poses) <= MOST_POSES:
        raise MeasurementError(
            f"{len(plan.poses)} poses to step through; expected 1 to {MOST_POSES}. Many positions "
            "are better seen in a picture of the workspace (pincal workspace --picture)"
        )
    if not np.isfinite(plan.poses).all():
        raise MeasurementError(
            f"{int((~np.isfinite(plan.poses).all(axis=1)).sum())} of {len(plan.poses)} poses are "
            "not whole; those that a calibration estimated can be drawn: "
            "result.estimated_poses, or poses.csv in the folder of the result"
        )
    drawn = body(mechanism, plan)
    if identified is None:
        return Scene(mechanism, plan, drawn)
    machine = as_mechanism(identified)
    magnified = _driven(mechanism, plan, drawn.readings, machine, magnify)
    return Scene(mechanism, plan, drawn, machine, magnify, magnified)


def _driven(
    mechanism: Mechanism, plan: Plan, readings: Array, identified: Mechanism, magnify: float
) -> Body:
    """Return where another machine goes when the nominal model commands poses by readings.

    Differences of parameters are magnified, not those of poses, so that what is drawn is a
    mechanism whose loops close; to first order its platform's error is magnified alike.
    """
    names = [[(leg.name, leg.parameter_names) for leg in m.legs] for m in (mechanism, identified)]
    if names[0] != names[1] or mechanism.platform.kind != identified.platform.kind:
        raise MechanismError(
            f"the identified {identified.name!r} has other legs or parameters than "
            f"{mechanism.name!r}; expected a calibration of the mechanism that is viewed"
        )
    if not (np.isfinite(magnify) and magnify > 0.0):
        raise MeasurementError(f"errors magnified by {magnify}; expected a factor above 0")
    magnified = {
        leg.name: leg.nominal + magnify * (identified.leg(leg.name).nominal - leg.nominal)
        for leg in mechanism.legs
    }
    machine = mechanism.with_parameters(magnified)
    known = np.flatnonzero(np.isfinite(readings).all(axis=1))
    solution = forward(machine, readings[known], plan.poses[known])
    reached = known[solution.converged]
    drawn = body(machine, Plan(solution.poses[solution.converged], readings=readings[reached]))
    placements = np.full((len(readings), *drawn.placements.shape[1:]), np.nan)
    placements[reached] = drawn.placements
    reasons = dict.fromkeys(range(len(readings)), "the nominal model does not reach this pose")
    reasons |= dict(zip(known.tolist(), solution.reasons, strict=True))
    reasons |= dict(zip(reached.tolist(), drawn.problems, strict=True))
    return replace(drawn, placements=placements, problems=tuple(reasons.values()))


def moved(shown: Scene, row: int, shift: Array) -> Scene:
    """Return the scene at a single pose, moved off one of its poses.

    Args:
        shown: The mechanism at poses.
        row: From which of them, counted from 0.
        shift: A twist of the platform in its freedoms, [m] and [rad], base axes at its origin;
            where readings do not follow from poses, changes of the readings, [m] and [rad].

    Raises:
        MechanismError: not finite, or of a wrong shape; readings that no pose has.
    """
    mechanism, platform = shown.mechanism, shown.mechanism.platform
    pose, readings = shown.plan.poses[[row]], shown.body.readings[[row]]
    width = readings.shape[1] if mechanism.by_readings else platform.dof
    if shift.shape != (width,) or not np.isfinite(shift).all():
        raise MechanismError(f"moved by an array of shape {shift.shape}; expected ({width},)")
    if mechanism.by_readings:
        solution = forward(mechanism, readings + shift, pose)
        if not solution.converged.all():
            raise MechanismError(solution.reasons[0])
        plan = Plan(solution.poses, readings=readings + shift)
    else:
        matrices = platform.displaced(platform.matrices(pose), shift[None])
        measured = None if shown.plan.readings is None else np.full_like(readings, np.nan)
        plan = Plan(platform.from_matrices(matrices), readings=measured)
    moved_scene = scene(mechanism, plan, shown.identified, shown.magnify)
    if problem := moved_scene.body.problems[0]:
        raise MechanismError(problem)
    return moved_scene
