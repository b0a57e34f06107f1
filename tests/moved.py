"""Mechanisms whose frames stand elsewhere, and machines of other groups than the bundled ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

import pincal
from pincal import Element, Placement
from pincal.model.placement import Coordinate
from pincal.symmetry.detect import SymmetryGroup
from pincal.symmetry.elements import isometry

AXES = ("x", "y", "z", "rz", "ry", "rx")


def equivariance(group: SymmetryGroup, poses: np.ndarray) -> float:
    """Return the largest |reading of a carried leg at carried poses − reading| (Eq. 5)."""
    mechanism, worst = group.mechanism, 0.0
    before, columns = pincal.inverse(mechanism, poses).readings, mechanism.reading_columns
    for element, permutation in zip(group.elements, group.permutations, strict=True):
        after = pincal.inverse(mechanism, element.poses(mechanism.platform, poses)).readings
        order = np.concatenate([np.r_[columns[index]] for index in permutation])
        worst = max(worst, float(np.abs(after[:, order] - before).max()))
    return worst


def random_motion(
    platform: pincal.Platform, rng: np.random.Generator, scale: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return motions (4, 4) of base and platform frame that leave the platform its freedoms."""
    motions = []
    for _ in range(2):
        turn, shift = rng.uniform(-1.0, 1.0, 3), scale * rng.uniform(-1.0, 1.0, 3)
        if platform.space == 2:
            turn[:2] = shift[2] = 0.0
        motion = np.eye(4)
        motion[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        motion[:3, 3] = shift
        motions.append(motion)
    if not platform.turns:
        motions[1][:3, :3] = motions[0][:3, :3]
    if platform.kind == "point":
        motions[1][:3, 3] = 0.0
    return motions[0], motions[1]


def constants(motion: np.ndarray) -> tuple[Coordinate, ...]:
    """Return a motion (4, 4) as coordinates without parameters, to stand before others."""
    angles = Rotation.from_matrix(motion[:3, :3]).as_euler("ZYX", suppress_warnings=True)
    values = (*motion[:3, 3], *angles)
    return tuple(Coordinate(kind, (float(v),)) for kind, v in zip(AXES, values, strict=True))


def moved(mechanism: pincal.Mechanism, base: np.ndarray, platform: np.ndarray) -> pincal.Mechanism:
    """Return the same machine in other frames: what was at p of a frame is at G p.

    Parameters keep their meaning: the motion stands before them, as constants.
    """

    def put(placement: Placement, motion: np.ndarray, values: dict[str, float]) -> Placement:
        first = constants(motion)
        if not placement.coordinates:
            frame = Placement(first).displacement({})
            return Placement().at({}, frame @ placement.origin())
        return Placement((*first, *placement.coordinates)).at(values, placement.rest(values, ""))

    legs = []
    for leg in mechanism.legs:
        values = leg.nominal_by_name

        def put_point(joint: pincal.Joint, values: dict[str, float] = values) -> pincal.Joint:
            return replace(joint, placement=put(joint.placement, platform, values))

        joints = tuple(
            replace(joint, placement=put(joint.placement, base, values)) if carrier < 0 else joint
            for joint, carrier in zip(leg.joints, leg.carriers, strict=True)
        )
        ends = tuple(end.moved(put_point) for end in leg.ends)
        legs.append(replace(leg, joints=joints, point=put_point(leg.point), ends=ends))
    home = base @ mechanism.platform.home_pose.as_matrix() @ np.linalg.inv(platform)
    coordinates = mechanism.platform.from_matrices(home)[0]
    return replace(
        mechanism,
        legs=tuple(legs),
        platform=pincal.Platform(mechanism.platform.kind, tuple(coordinates.tolist())),
    )


def box() -> tuple[Element, ...]:
    """Return D_2h: half a turn and two mirrors, each with and without the mirror across z."""
    flip = isometry(np.diag([1.0, 1.0, -1.0]))
    return tuple(one for e in pincal.dihedral(2) for one in (e, e.after(Element.of(flip, flip))))


def cable_box(home: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> pincal.Mechanism:
    """Return a platform on eight cables from the corners of a box, Cartesian parameters."""
    values = {"A_x": 3.0, "A_y": 2.6, "A_z": 2.0, "b_x": 0.5, "b_y": 0.3, "b_z": 0.2, "k": 1.0}
    A, b = np.array(list(values.values())[:3]), np.array(list(values.values())[3:6])
    length = float(np.linalg.norm(b - A))
    frame = np.eye(4)
    frame[:3, 2] = (b - A) / length
    frame[:3, 1] = np.cross((0.0, 0.0, 1.0), frame[:3, 2])
    frame[:3, 1] /= np.linalg.norm(frame[:3, 1])
    frame[:3, 0] = np.cross(frame[:3, 1], frame[:3, 2])
    corner = [Coordinate(axis, (f"A_{axis}",)) for axis in "xyz"]
    point = [Coordinate(axis, (f"b_{axis}",)) for axis in "xyz"]
    leg = pincal.Leg(
        name="line",
        joints=(
            pincal.Joint(
                "universal_x",
                "revolute",
                Placement(tuple(corner)).at(values, frame),
                (1.0, 0.0, 0.0),
                -0.6,
                0.6,
            ),
            pincal.Joint("universal_y", "revolute", Placement(), (0.0, 1.0, 0.0), -0.6, 0.6),
            pincal.Joint("line", "prismatic", lower=2.0, upper=6.0, home=length),
            pincal.Joint("tip", "fixed"),
        ),
        point=pincal.Joint("b_1", "fixed", Placement(tuple(point)).at(values, np.eye(4))),
        sensors=(pincal.Sensor("line", form="reading", gain="k"),),
        parameters=tuple(values.items()),
    )
    platform = pincal.Platform("spatial", (*home, 0.0, 0.0, 0.0))
    return pincal.generate("cable_box", leg, box(), platform)
