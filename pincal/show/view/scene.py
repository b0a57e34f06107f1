"""What a view shows: a mechanism at poses, an identified one beside it, what a calibration found.

All of it is numbers: parts and placements, a cloud of positions, arrows of misses, errors over the
workspace, where instruments stand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from pincal.design.simulate import platform_errors
from pincal.errors import MeasurementError, MechanismError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.configurations import joints_at
from pincal.kinematics.forward import forward
from pincal.model.checks import numbers_of
from pincal.model.measurements import EVERY_LEG, Plan
from pincal.model.mechanism import Mechanism
from pincal.show.style import DIMENSION, EVERY, TOWARDS_VIEWER, look
from pincal.show.view.bodies import PALE, Body, Shape, across, body, rod
from pincal.symmetry.detect import in_domain, symmetry_group
from pincal.types import Array, Mask


@dataclass(frozen=True, eq=False)
class Misses:
    """From the measured to the predicted point of each row, after the calibration."""

    measured: Array
    """Of the platform, shape (n, 3), base frame, [m]."""
    shifts: Array
    """Predicted less measured, shape (n, 3), [m]."""
    outlying: Mask
    """Which rows are outliers, shape (n,)."""
    magnify: float
    """With which shifts are drawn."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of the platform's position over the workspace, before and after, on one scale."""

    positions: Array
    """Shape (N, 3), base frame, [m]."""
    before: Array
    """Of the nominal model, shape (N,), [m]."""
    after: Array
    """To expect of the identified one, shape (N,), [m]."""

    @property
    def limits(self) -> tuple[float, float]:
        """Ends of the scale, which is one of decades, [m]."""
        sizes = np.concatenate((self.before, self.after))
        low, high = np.quantile(sizes[sizes > 0.0], (0.01, 0.99)).tolist()
        return low, max(high, low * 1.01)

    def shares(self, errors: Array) -> Array:
        """Return where on the scale errors are, from 0 to 1, shape (N,)."""
        low, high = np.log(self.limits)
        with np.errstate(divide="ignore"):
            return np.clip((np.log(errors) - low) / (high - low), 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Weakest:
    """The nominal machine moved along the direction that the measurements determine least."""

    body: Body
    """At one end of that motion, the same readings commanded."""
    magnify: float
    """How many standard errors away that is."""
    named: str
    """What moves most along it."""


@dataclass(frozen=True, eq=False)
class Instrument:
    """A tracker that is known to stand somewhere."""

    position: Array
    """Shape (3,), base frame, [m]."""
    T_base_frame: Array
    """The frame of the measurements, shape (4, 4), [m]."""


@dataclass(frozen=True, eq=False)
class Station:
    """A frame that the measurements were made in, or an instrument that says where it stands."""

    name: str
    T_base_station: Array
    """Shape (4, 4), [m]; a camera looks along z."""
    sees: tuple[float, float] | None = None
    """Half width and half height of what a camera sees at a distance of 1; None if it is none."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """All of it; None where there is none."""

    misses: Misses | None = None
    errors: Errors | None = None
    weakest: Weakest | None = None
    instrument: Instrument | None = None
    stations: tuple[Station, ...] = ()


MOST_POSES = 2000
MOST_POINTS = 100_000
MAGNIFY = 10.0


@dataclass(frozen=True, eq=False)
class Identified:
    """The identified machine, driven by the nominal model's readings, its errors magnified."""

    body: Body
    mechanism: Mechanism
    magnify: float
    errors: Array
    """Unmagnified twists from the nominal to the identified pose, shape (N, dof); NaN if none."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """Positions of a workspace."""

    positions: Array
    """Shape (N, 3), base frame, [m]; at most ``MOST_POINTS``, evenly drawn from all."""
    domain: Mask
    """Which lie in a fundamental domain, shape (N,); all where there is no symmetry."""
    group: str
    """Name of the mechanism's symmetry group."""
    total: int
    """Number of positions before some were left out."""


@dataclass(frozen=True, eq=False)
class Scene:
    """All that a view shows."""

    mechanism: Mechanism
    plan: Plan
    body: Body
    readings: Array
    """Sensor readings, shape (N, n_legs), [rad] or [m]; NaN where not reached."""
    identified: Identified | None = None
    cloud: Cloud | None = None
    overlay: Overlay | None = None
    """What a calibration adds."""

    @property
    def sets(self) -> tuple[str, ...]:
        """Set of each pose: a leg's name, ``"all"`` for every leg, empty where there are none."""
        if self.plan.sets is None:
            return ("",) * len(self.plan.poses)
        return tuple(name or EVERY_LEG for name in self.plan.sets)

    @property
    def planar(self) -> bool:
        """Whether all moves in the x-y plane."""
        return len(self.mechanism.platform.closure_rows) == 2

    def by_set(self) -> Iterator[tuple[str, str, Array, Array]]:
        """Yield name, colour, positions (n, 3) and legs' segments (k, 2, 3) of each set, [m]."""
        positions = self.body.placements[:, self.body.part("platform/body"), :3, 3]
        skeletons = self.body.skeletons()
        for name in dict.fromkeys(self.sets):
            in_set = np.array(self.sets) == name
            lines = skeletons[in_set].reshape(-1, 2, 3)
            yield (
                name,
                set_colour(self, name),
                positions[in_set],
                lines[np.isfinite(lines).all(axis=(1, 2))],
            )

    def points(self) -> Array:
        """Return where parts, feet and positions are, shape (n, 3), [m]; NaN if not drawn."""
        bodies = [self.body] + ([self.identified.body] if self.identified else [])
        feet = [leg.joints[0].placement.xyz for leg in self.mechanism.legs]
        parts = [shape_body.placements[:, :, :3, 3].reshape(-1, 3) for shape_body in bodies]
        clouds = [self.cloud.positions] if self.cloud else []
        return np.concatenate((feet, *parts, *clouds))

    @property
    def level(self) -> float:
        """Height of the ground, [m]: in space, what the lowest part stands on."""
        if self.planar:
            return 0.0
        frame = self.body.parts[self.body.part("base/frame")].shapes
        under = [float(shape.points[:, 2].min()) for shape in frame if shape.points is not None]
        return min([float(self.bounds()[0, 2]), *under])

    def bounds(self) -> Array:
        """Return least and largest coordinates of all that is drawn, shape (2, 3), [m]."""
        every = self.points()
        return np.stack((np.nanmin(every, axis=0), np.nanmax(every, axis=0)))


def scene(
    mechanism: Mechanism,
    plan: Plan,
    workspace: ArrayLike | None = None,
    identified: GivenMechanism | None = None,
    magnify: float = MAGNIFY,
) -> Scene:
    """Return the scene of a mechanism at the poses of a plan; all else as of ``view``."""
    if not 0 < len(plan.poses) <= MOST_POSES:
        raise MeasurementError(
            f"{len(plan.poses)} poses to step through; expected 1 to {MOST_POSES}. Many positions "
            "are better seen as a workspace cloud (--workspace)"
        )
    if not np.isfinite(plan.poses).all():
        raise MeasurementError(
            f"{int((~np.isfinite(plan.poses).all(axis=1)).sum())} of {len(plan.poses)} poses are "
            "not whole; those that a calibration estimated can be drawn: "
            "result.estimated_poses, or poses.csv in the folder of the result"
        )
    drawn_scene = Scene(mechanism, plan, body(mechanism, plan), joints_at(mechanism, plan).readings)
    if identified is not None:
        machine = driven(drawn_scene, as_mechanism(identified), magnify)
        drawn_scene = replace(drawn_scene, identified=machine)
    return (
        drawn_scene
        if workspace is None
        else replace(drawn_scene, cloud=_cloud(mechanism, workspace))
    )


def plan_of(mechanism: Mechanism, poses: Plan | ArrayLike | RigidTransform) -> Plan:
    """Return poses in any form as a plan.

    Raises:
        MechanismError: poses of a wrong shape.
    """
    if isinstance(poses, Plan):
        return poses
    plan = (
        poses if isinstance(poses, RigidTransform) else numbers_of(poses, "poses", MeasurementError)
    )
    return Plan(mechanism.platform.coordinates_of(plan))


def _cloud(mechanism: Mechanism, workspace: ArrayLike) -> Cloud:
    """Return the positions of a workspace, and which are of a fundamental domain."""
    lengths = mechanism.platform.units.count("m")
    points = numbers_of(workspace, "workspace", MeasurementError)
    if points.ndim != 2 or points.shape[1] < lengths or not np.isfinite(points).all():
        raise MeasurementError(
            f"a workspace has shape (M, {lengths}) or more, finite positions first; got "
            f"{points.shape}"
        )
    rows = np.arange(len(points))
    if len(points) > MOST_POINTS:
        rows = np.sort(np.random.default_rng(0).choice(len(points), MOST_POINTS, replace=False))
    positions = np.zeros((len(rows), 3))
    positions[:, :lengths] = points[rows, :lengths]
    group = symmetry_group(mechanism)
    return Cloud(positions, in_domain(group, positions), group.name, len(points))


def driven(scene: Scene, identified: Mechanism, magnify: float) -> Identified:
    """Return where another machine goes when the nominal model commands the poses.

    Differences of parameters are magnified, not those of poses, so that what is drawn is a
    mechanism whose loops close; to first order its platform's error is magnified alike.
    """
    mechanism, poses = scene.mechanism, scene.plan.poses
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
    known = np.flatnonzero(np.isfinite(scene.readings).all(axis=1))
    solution = forward(machine, scene.readings[known], poses[known])
    reached = known[solution.converged]
    plan_reached = Plan(solution.poses[solution.converged], readings=scene.readings[reached])
    drawn = body(machine, plan_reached, scene.body.barrels)
    placements = np.full((len(poses), *drawn.placements.shape[1:]), np.nan)
    placements[reached] = drawn.placements
    reasons = dict.fromkeys(range(len(poses)), "the nominal model does not reach this pose")
    reasons |= dict(zip(known.tolist(), solution.reasons, strict=True))
    reasons |= dict(zip(reached.tolist(), drawn.problems, strict=True))
    everywhere = replace(drawn, placements=placements, problems=tuple(reasons.values()))
    errors = platform_errors(mechanism, identified, scene.plan)
    return Identified(everywhere, identified, magnify, errors)


def moved(scene: Scene, row: int, shift: Array) -> Scene:
    """Return the scene at a single pose, moved off one of its poses.

    Args:
        scene: The mechanism at poses.
        row: From which of them, counted from 0.
        shift: A twist of the platform in its freedoms, [m] and [rad], base axes at its origin;
            where readings do not follow from poses, changes of the readings, [m] and [rad].

    Raises:
        MechanismError: not finite, or of a wrong shape; readings that no pose has.
    """
    mechanism, platform = scene.mechanism, scene.mechanism.platform
    pose, readings = scene.plan.poses[[row]], scene.readings[[row]]
    width = readings.shape[1] if mechanism.by_readings else platform.dof
    if shift.shape != (width,) or not np.isfinite(shift).all():
        raise MechanismError(f"moved by an array of shape {shift.shape}; expected ({width},)")
    if mechanism.by_readings:
        readings = readings + shift
        solution = forward(mechanism, readings, pose)
        if not solution.converged.all():
            raise MechanismError(solution.reasons[0])
        plan = Plan(solution.poses, readings=readings)
    else:
        matrices = platform.displaced(platform.matrices(pose), shift[None])
        plan = Plan(platform.from_matrices(matrices))
    drawn = body(mechanism, plan, scene.body.barrels)
    if drawn.problems[0]:
        raise MechanismError(drawn.problems[0])
    moved_scene = Scene(mechanism, plan, drawn, joints_at(mechanism, plan).readings)
    if scene.identified is None:
        return moved_scene
    machine = driven(moved_scene, scene.identified.mechanism, scene.identified.magnify)
    return replace(moved_scene, identified=machine)


def set_colour(scene: Scene, name: str) -> str:
    """Return the colour of a set, that of its leg; dark for the poses of every leg."""
    names = scene.mechanism.leg_names
    return look(names.index(name)).colour if name in names else EVERY


def frame_axes(scene: Scene) -> tuple[Shape, ...]:
    """Return the axes x, y and z of a frame, of a length that suits the scene."""
    platform = scene.body.parts[scene.body.part("platform/body")]
    length = 5 * platform.shapes[0].size[0]
    axes = []
    for place in range(3):
        T = np.zeros((4, 4))
        T[:3, :3] = np.roll(np.eye(3), 2 - place, axis=1)  # z of the cylinder along the axis
        T[3, 3] = 1.0
        T[place, 3] = length / 2
        axes.append(Shape("cylinder", (0.02 * length, length), T, DIMENSION))
    return tuple(axes)


def axes_of_view(planar: bool) -> Array:
    """Return what points right, up and towards the viewer, shape (3, 3), rows in the base frame."""
    if planar:
        return np.eye(3)
    towards = np.array(TOWARDS_VIEWER) / np.linalg.norm(TOWARDS_VIEWER)
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    return np.stack((right, np.cross(towards, right), towards))


def grid_step(scene: Scene) -> float:
    """Return the lines' distance on the ground, 1, 2 or 5 times a power of ten, [m]."""
    width = float(np.ptp(scene.bounds()[:, :2], axis=0).max())
    return rounded_down(max(width, 1e-9) / 6)


def rounded_down(value: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above a value."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(max(s for s in (1.0, 2.0, 5.0) if s <= value / decade * (1 + 1e-9)) * decade)


def ground(scene: Scene) -> Array:
    """Return lines on the ground under all that is drawn, shape (n, 2, 3), [m].

    In a plane the ground is that; in space it is as low as the lowest part.
    """
    step = grid_step(scene)
    low, high = scene.bounds()[:, :2]
    begin, end = np.floor(low / step) * step, np.ceil(high / step) * step
    lines = []
    for axis in (0, 1):
        places = np.arange(begin[axis], end[axis] + step / 2, step)
        ends = np.zeros((len(places), 2, 3))
        ends[:, :, axis] = places[:, None]
        ends[:, :, 1 - axis] = begin[1 - axis], end[1 - axis]
        ends[:, :, 2] = scene.level
        lines.append(ends)
    return np.concatenate(lines)


_LONGEST = 0.5  # of the scene's size: longer arrows are cut
_THIN = 0.0016  # half an arrow's width, of that size
_HEAD = 0.3  # of an arrow's length
_WIDE, _SLIM = 3.0, 14.0  # half width and length at most of a head, of the shaft's half width


def cut(misses: Misses, size: float) -> Mask:
    """Return which arrows are drawn shorter than they are, shape (n,)."""
    lengths = misses.magnify * np.linalg.norm(misses.shifts, axis=1)
    return np.asarray(lengths > _LONGEST * size)


def tips(misses: Misses, size: float) -> Array:
    """Return where arrows end as they are drawn, shape (n, 3), [m]."""
    lengths = misses.magnify * np.linalg.norm(misses.shifts, axis=1)
    shorter = np.minimum(1.0, _LONGEST * size / np.maximum(lengths, 1e-300))
    return misses.measured + (misses.magnify * shorter)[:, None] * misses.shifts


def arrows(misses: Misses, rows: Mask, size: float) -> Array:
    """Return the triangles of arrows, shape (m, 3, 3), [m].

    Args:
        misses: From where to where.
        rows: Which are drawn.
        size: Of the scene, [m].
    """
    parts = []
    for begin, shift in zip(misses.measured[rows], misses.shifts[rows], strict=True):
        length = float(np.linalg.norm(shift))
        drawn = min(misses.magnify * length, _LONGEST * size)
        if drawn > 0.0:
            parts.append(_arrow(begin, shift / length, drawn, min(_THIN * size, 0.08 * drawn)))
    return np.concatenate(parts) if parts else np.zeros((0, 3, 3))


def _arrow(begin: Array, along: Array, length: float, half: float) -> Array:
    """Return the triangles of an arrow: a square shaft and a pyramid, shape (14, 3, 3)."""
    first, second = across(along)
    ring = np.array([first, second, -first, -second])
    tip = begin + length * along
    neck = tip - min(_HEAD * length, _SLIM * half) * along
    low, high, wide = begin + half * ring, neck + half * ring, neck + _WIDE * half * ring
    faces = []
    for corner in range(4):
        two = (corner + 1) % 4
        faces += [
            (low[corner], low[two], high[two]),
            (low[corner], high[two], high[corner]),
            (wide[corner], wide[two], tip),
        ]
    faces += [(wide[0], wide[2], wide[1]), (wide[0], wide[3], wide[2])]
    return np.array(faces)


def stand(size: float, planar: bool) -> tuple[Shape, ...]:
    """Return an instrument whose axes meet at the origin: a head and, in space, three legs.

    Args:
        size: Of the scene, [m].
        planar: Whether all is seen from above.
    """
    radius = 0.018 * size
    head = Shape("sphere", (radius,), np.eye(4), DIMENSION)
    if planar:
        return (head,)
    turns = np.radians([90.0, 210.0, 330.0])
    ends = np.column_stack((2.2 * np.cos(turns), 2.2 * np.sin(turns), np.full(3, -5.0))) * radius
    return (head, *(rod(np.zeros(3), end, 0.16 * radius, PALE) for end in ends))


def frustum(sees: tuple[float, float], depth: float) -> Array:
    """Return what a camera sees up to a depth, as segments in its frame, shape (9, 2, 3), [m].

    Four edges from where it stands, the rectangle of its picture there, and a mark on the side
    of the picture's top, which is towards −y.

    Args:
        sees: Half width and half height of that rectangle at a depth of 1.
        depth: [m].
    """
    x, y = sees
    corners = depth * np.array([[-x, -y, 1.0], [x, -y, 1.0], [x, y, 1.0], [-x, y, 1.0]])
    edges = [(np.zeros(3), corner) for corner in corners]
    edges += [(corners[i], corners[i - 1]) for i in range(4)]
    edges.append((depth * np.array([0.0, -y, 1.0]), depth * np.array([0.0, -1.4 * y, 1.0])))
    return np.array(edges)
