"""Scenes of views and pictures: a mechanism at poses, the identified one beside it, and layers.

A scene consists of moving parts (``bodies``) and of layers of static dots and lines.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from pincal.calibration.result import CalibrationResult
from pincal.errors import MeasurementError, MechanismError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.configurations import command
from pincal.kinematics.forward import forward
from pincal.model import EVERY_LEG, ORIGIN, VERIFY, Mechanism, Plan
from pincal.model.checks import LARGEST, number_of
from pincal.show.misses import by_row
from pincal.show.style import DIMENSION, EVERY, GROUND, IDENTIFIED, OUTLIER, leg_colour
from pincal.show.view.bodies import Body, body
from pincal.types import Array, Index, Mask

MOST_POSES = 2000
VERIFICATION = "verification"  # displayed name of the set "verify"
_TOWARDS_VIEWER = np.array([0.45, -0.85, 0.42])  # for mechanisms in space: slightly from above
_SEEN = 0.03  # size of visible errors, over the scene's size
_LONG, _LONGEST = 0.08, 0.5  # lengths of a long arrow and of a cut arrow, over the scene's size
_TOUCHED = 7  # pixels of a point that targets touch
_HEAD = 0.2  # length of an arrow's head, over the arrow's


class Layer(NamedTuple):
    """Static dots or lines."""

    path: str
    """Place in the scene's tree."""
    name: str
    points: Array
    """Dots, shape (n, 3), or segments, shape (n, 2, 3), in the base frame, [m]."""
    colour: str
    pixels: int = 2
    """Diameter of a dot in pixels."""
    scale: float = 1.0
    """Factor on the lengths of segments."""


@dataclass(frozen=True, eq=False)
class Scene:
    """The contents of a view."""

    mechanism: Mechanism
    plan: Plan
    body: Body
    identified: Mechanism | None = None
    """The calibrated mechanism."""
    magnify: float = 1.0
    """Factor on the differences between its parameters and the nominal ones."""
    magnified: Body | None = None
    """The machine with magnified differences, as driven by the nominal model's readings."""
    layers: tuple[Layer, ...] = ()
    """Results of a calibration, beside the ground and the poses."""
    misses: Array | None = None
    """Distance from measured to predicted point for each row of a result, [m], or NaN."""

    @property
    def sets(self) -> tuple[str, ...]:
        """Set of each pose: a leg's name, ``"all"`` for every leg, or ``"verification"``.

        The names are empty if the plan has no sets.
        """
        if self.plan.sets is None:
            return ("",) * len(self.plan.poses)
        words = {"": EVERY_LEG, VERIFY: VERIFICATION}
        return tuple(words.get(name, name) for name in self.plan.sets)

    @property
    def axes(self) -> Array:
        """Directions to the right, up and to the viewer, rows in the base frame, shape (3, 3)."""
        if self.mechanism.platform.space == 2:
            return np.eye(3)
        towards = _TOWARDS_VIEWER / np.linalg.norm(_TOWARDS_VIEWER)
        right = np.cross([0.0, 0.0, 1.0], towards)
        right /= np.linalg.norm(right)
        return np.stack((right, np.cross(towards, right), towards))

    def dots(self) -> list[Layer]:
        """Return the positions of the platform as dots, a layer for each set."""
        positions, sets = self.body.platform[:, :3, 3], np.array(self.sets)
        return [
            Layer(f"sets/{number}", name, positions[sets == name], self.colour(name), pixels=6)
            for number, name in enumerate(dict.fromkeys(self.sets), 1)
        ]

    def colour(self, name: str) -> str:
        """Return the colour of a set: its leg's, or dark for the poses of every leg."""
        names = self.mechanism.leg_names
        return leg_colour(names.index(name)) if name in names else EVERY

    def points(self) -> Array:
        """Return the positions of feet and parts, shape (n, 3), [m]; NaN if not drawn."""
        bodies = filter(None, (self.body, self.magnified))
        parts = [shown.placements[:, :, :3, 3].reshape(-1, 3) for shown in bodies]
        feet = [leg.joints[0].placement.xyz for leg in self.mechanism.legs]
        return np.concatenate((feet, *parts))

    def bounds(self) -> Array:
        """Return the least and largest coordinates of ``points()``, shape (2, 3), [m]."""
        points = self.points()
        return np.stack((np.nanmin(points, axis=0), np.nanmax(points, axis=0)))

    @property
    def size(self) -> float:
        """Diagonal of the bounds, [m]; the mechanism's size if all axes meet in a point."""
        return float(np.linalg.norm(np.ptp(self.bounds(), axis=0))) or self.mechanism.size

    @property
    def level(self) -> float:
        """Height of the ground, [m]: the base's, unless most of a mechanism hangs below."""
        low, high = self.bounds()[:, 2]
        return float(low) if self.mechanism.platform.space == 3 and low + high < 0.0 else 0.0

    def ground(self) -> Layer:
        """Return a grid of lines on the ground, at steps of 1, 2 or 5 times a power of ten."""
        low, high = self.bounds()[:, :2]
        step = rounded_down((float((high - low).max()) or self.size) / 6)
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
    magnify: float | None = None,
) -> Scene:
    """Return the scene of a mechanism at poses; arguments are those of ``view``."""
    plan = poses if isinstance(poses, Plan) else Plan(mechanism.platform.coordinates_of(poses))
    if not 0 < len(plan.poses) <= MOST_POSES:
        raise MeasurementError(
            f"{len(plan.poses)} poses to step through; expected 1 to {MOST_POSES}"
        )
    if (lacking := ~np.isfinite(plan.poses)).any():
        rows = np.flatnonzero(lacking.any(axis=1))
        names = np.array(mechanism.platform.coordinates)[lacking[rows[0]]]
        raise MeasurementError(
            f"{len(rows)} of {len(plan)} rows have no whole pose, the first is "
            f"{plan.place(int(rows[0]))}, without {', '.join(names)}; show the RESULT of a "
            "calibration, which estimates them (result.estimated_poses), not its measurements"
        )
    drawn = body(mechanism, plan)
    if identified is None:
        return Scene(mechanism, plan, drawn)
    machine = as_mechanism(identified)
    driven = partial(_driven, mechanism, plan, drawn.readings, machine)
    if magnify is None:
        plain, size = driven(1.0), Scene(mechanism, plan, drawn).size
        distances = np.linalg.norm((plain.placements - drawn.placements)[..., :3, 3], axis=2)
        usual = max(float(np.nanquantile(distances, 0.9)), 1e-12)
        magnify = rounded_down(float(np.clip(_SEEN * size / usual, 1.0, 1000.0)))
        while driven(magnify).problems.count("") < plain.problems.count(""):
            magnify = rounded_down(magnify / 2)
    return Scene(mechanism, plan, drawn, machine, magnify, driven(magnify))


def _driven(
    mechanism: Mechanism, plan: Plan, readings: Array, identified: Mechanism, magnify: float
) -> Body:
    """Return the identified machine, with magnified differences, driven by the nominal readings.

    Differences of parameters are magnified, so that the drawn mechanism has closed loops; to first
    order the error of its platform is magnified by the same factor.
    """
    names = [[(leg.name, leg.parameter_names) for leg in m.legs] for m in (mechanism, identified)]
    if names[0] != names[1] or mechanism.platform.kind != identified.platform.kind:
        raise MechanismError(
            f"the identified {identified.name!r} has other legs or parameters than "
            f"{mechanism.name!r}; expected a calibration of the mechanism that is viewed"
        )
    if not 0.0 < number_of(magnify, "magnify", MeasurementError) <= LARGEST:
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
    """Return the scene at a single pose, which is the pose of a row (from 0) moved by a shift.

    The shift is a twist of the platform in its freedoms, in base axes at its origin, or changes of
    the readings if poses do not determine them; [m] and [rad].

    Raises:
        MechanismError: the shift is not finite or has a wrong shape, or no pose has the readings.
    """
    mechanism, platform = shown.mechanism, shown.mechanism.platform
    pose, readings = shown.plan.poses[[row]], shown.body.readings[[row]]
    width = readings.shape[1] if mechanism.by_readings else platform.dof
    if shift.shape != (width,) or not np.isfinite(shift).all():
        raise MechanismError(f"moved by an array of shape {shift.shape}; expected ({width},)")
    if mechanism.by_readings:
        plan = Plan(pose, readings=readings + shift)
        poses, _, (reason,) = command(mechanism, plan)
        if reason:
            raise MechanismError(reason)
        plan = Plan(poses, readings=plan.readings)
    else:
        matrices = platform.displaced(platform.matrices(pose), shift[None])
        measured = None if shown.plan.readings is None else np.full_like(readings, np.nan)
        plan = Plan(platform.from_matrices(matrices), readings=measured)
    moved_scene = scene(mechanism, plan, shown.identified, shown.magnify)
    if problem := moved_scene.body.problems[0]:
        raise MechanismError(problem)
    return moved_scene


# Results of a calibration


def calibrated(shown: Scene, result: CalibrationResult) -> Scene:
    """Return a scene with the results of a calibration of its mechanism.

    These are the places of instruments and, if the fit converged, arrows of rows that fit and of
    outliers, each magnified to be seen.
    """
    measured, shifts, outlying = misses_of(result)
    known = np.isfinite(np.hstack((measured, shifts))).all(axis=1) & result.converged
    layers = _arrow_layers(measured[known], shifts[known], outlying[known], shown.size)
    for number, (name, T) in enumerate(stations(result), 1):
        ends = T[:3, 3] + shown.body.axis * T[:3, :3].T
        axes = np.stack((np.broadcast_to(T[:3, 3], (3, 3)), ends), axis=1)
        text = f"{name}, {np.linalg.norm(T[:3, 3]):.3g} m from the base frame"
        layers.append(Layer(f"stations/{number}", text, axes, DIMENSION))
    for number, (name, place, _, _) in enumerate(touched_points(result), 1):
        layers.append(Layer(f"touched/{number}", name, place[None], IDENTIFIED, pixels=_TOUCHED))
    misses = np.where(known, np.linalg.norm(shifts, axis=1), np.nan)
    of_rows = len(misses) == len(shown.plan)  # its poses are those of the result's rows
    return replace(shown, layers=(*shown.layers, *layers), misses=misses if of_rows else None)


def _arrow_layers(begin: Array, shifts: Array, outlying: Mask, size: float) -> list[Layer]:
    """Return layers of arrows of limited length, each of three segments, shafts first."""
    if not len(begin):
        return []
    lengths = np.linalg.norm(shifts, axis=1)
    usual = lengths if outlying.all() else lengths[~outlying]
    magnify = rounded_down(_LONG * size / max(float(np.quantile(usual, 0.95)), 1e-12 * size))
    cut = magnify * lengths > _LONGEST * size
    along = shifts * np.where(cut, _LONGEST * size / np.maximum(lengths, 1e-300), magnify)[:, None]
    upright = np.abs(along[:, [2]]) > 0.9 * np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, np.where(upright, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]))
    tips = begin + along
    ends = (begin, *(tips - _HEAD * (along + side * across) for side in (-0.5, 0.5)))
    layers = []
    for path, name, rows, colour in (
        ("misses", "measured → predicted", ~outlying, IDENTIFIED),
        ("outlying", "outliers", outlying, OUTLIER),
    ):
        if rows.any():
            lines = np.concatenate([np.stack((tips[rows], end[rows]), axis=1) for end in ends])
            text = f"{name}, errors × {magnify:,.12g}"
            text += f", {cut[rows].sum()} longer than drawn" if cut[rows].any() else ""
            layers.append(Layer(path, text, lines, colour, scale=magnify))
    return layers


def misses_of(result: CalibrationResult) -> tuple[Array, Array, Mask]:
    """Return measured points, predicted minus measured points, and a mask of outliers, by row.

    Base frame, (n_rows, 3), [m]; NaN where unknown. Differences are the residuals of x, y and z, or
    else forward kinematics minus fully measured poses. Rows that touch a point have that point.
    """
    platform, outside = result.nominal.platform, result.outside
    axes = ("x", "y", "z")[: platform.space]
    measured, shifts = np.zeros((2, len(result.measurements), 3))
    if result.estimated_poses is not None and {*axes} <= {block.name for block in result.observed}:
        shifts[:, : len(axes)] = by_row(result, axes)
        offset = np.array(result.options.setup.targets[ORIGIN].offset)
        if outside is not None:
            shifts, offset = shifts @ outside.frame[:3, :3], outside.offsets[0]
        matrices = platform.matrices(result.estimated_poses)
        measured = matrices[:, :3, 3] + matrices[:, :3, :3] @ offset - shifts
    else:
        data, lengths, machine = result.measurements, platform.lengths, result.identified
        whole = np.asarray(np.isfinite(np.hstack((data.poses, data.readings))).all(axis=1))
        known = {name: data.influences[name][whole] for name in machine.influences}
        poses = forward(machine, data.readings[whole], data.poses[whole], known).poses
        measured[:, :lengths] = np.where(whole[:, None], data.poses[:, :lengths], np.nan)
        shifts[whole, :lengths] = poses[:, :lengths] - measured[whole, :lengths]
    for _, place, rows, missed in touched_points(result):
        measured[rows], shifts[rows] = place, missed
    return measured, shifts, np.isin(np.arange(len(shifts)), [row.row for row in result.outliers])


def touched_points(result: CalibrationResult) -> list[tuple[str, Array, Index, Array]]:
    """Return name, place, rows and misses of each point that targets touch, base frame, [m]."""
    setup, outside = result.options.setup, result.outside
    outside = outside or result.calibration.observation.external.start
    turn, origin, points = outside.frame[:3, :3], outside.frame[:3, 3], []
    for (name, (_, _, contact)), place in zip(
        setup.touched.items(), outside.features[:, :3], strict=False
    ):
        axes = [f"{name}_{axis}" for axis in "xyz"[: result.nominal.platform.space]]
        missed = by_row(result, axes)
        rows = np.flatnonzero(np.isfinite(missed).all(axis=1))
        if contact.shape == "point" and len(rows):
            points.append((name, (place - origin) @ turn, rows, missed[rows] @ turn[: len(axes)]))
    return points


def stations(result: CalibrationResult) -> list[tuple[str, Array]]:
    """Return names and ``T_base_station``, (4, 4), of the tracker and instruments.

    Without a tracker an unknown frame of the measurements takes its place. Instruments have a place
    if their method ``stand(values)`` returns T_frame_instrument.

    Raises:
        MeasurementError: the place of an instrument is no rigid transform.
    """
    setup, outside = result.options.setup, result.outside
    T_base_frame = np.eye(4) if outside is None else np.asarray(np.linalg.inv(outside.frame))
    every: list[tuple[str, Array]] = []
    if setup.tracker is not None:
        T_frame_tracker = np.eye(4)
        T_frame_tracker[:3, 3] = setup.tracker.at
        every.append(("tracker", T_base_frame @ T_frame_tracker))
    elif setup.unknown_frame:
        every.append(("frame of the measurements", T_base_frame))
    for device in setup.instruments:
        values = np.array([result[parameter.id].identified for parameter in device.parameters])
        if not hasattr(device, "stand") or (standing := device.stand(values)) is None:
            continue
        T = np.asarray(standing, dtype=np.float64)
        if T.shape != (4, 4) or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6):
            raise MeasurementError(
                f"instrument {device.name!r} stands at an array of shape {T.shape}; expected "
                "T_frame_instrument, a rigid transform of shape (4, 4)"
            )
        every.append((device.name, T_base_frame @ T))
    return every
