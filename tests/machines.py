"""Machines with closed loops, from their dimensions: what people build beside the bundled ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

import pincal
from pincal import End, Follows, Joint, Leg, Mechanism, Placement, Platform, Sensor
from pincal.files.urdf import leg_links, leg_urdf
from pincal.kinematics.configurations import joints_at
from pincal.model.placement import Coordinate, placement_of

Array = NDArray[np.float64]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def four_bar_pose(readings: Array, a: float, b: float, c: float, d: float) -> Array:
    """Return crank end and coupler angle of a four-bar, shape (N, 3), by the cosine law."""
    crank = a * np.exp(1j * readings)
    across = d - crank
    angle = (b**2 + np.abs(across) ** 2 - c**2) / (2 * b * np.abs(across))
    return np.stack((crank.real, crank.imag, np.angle(across) + np.arccos(angle)), axis=1)


def four_bar() -> Mechanism:
    """Return a four-bar whose platform is its coupler; the follower has no drive."""
    a, b, c, d = 0.3, 0.8, 0.6, 0.9
    home = four_bar_pose(np.array([0.7]), a, b, c, d)[0]
    knee = home[0] + 1j * home[1] + b * np.exp(1j * home[2])
    values = {"l": a, "gamma": 0.0}
    crank = Leg(
        "crank",
        (
            Joint("drive", "revolute", home=0.7),
            Joint("crank_tip", "fixed", Placement.of(values, x="l")),
        ),
        (Sensor("drive", offset="gamma"),),
        tuple(values.items()),
        Joint("crank_point", "fixed"),
    )
    values = {"dx": d, "dy": 0.0, "c": c, "b": b}
    follower = Leg(
        "follower",
        (
            Joint(
                "foot",
                "revolute",
                Placement.of(values, x="dx", y="dy"),
                home=float(np.angle(knee - d)),
            ),
            Joint("follower_tip", "fixed", Placement.of(values, x="c")),
        ),
        (),
        tuple(values.items()),
        Joint("follower_point", "fixed", Placement.of(values, x="b")),
    )
    return Mechanism("four_bar", Platform("planar", tuple(home)), (crank, follower))


def strut(number: int, *, spins: bool) -> Leg:
    """Return a UPS leg of a Tricept, whose slide may spin about itself."""
    angle = 2 * np.pi * number / 3
    foot = 0.5 * np.array([np.cos(angle), np.sin(angle), 0.0])
    point = 0.4 * foot + np.array([0.0, 0.03 * (number + 1), 0.0])
    rod = point + np.array(Z) - foot
    length = float(np.linalg.norm(rod))
    second = float(np.arcsin(rod[0] / length))
    values = dict(zip(("ax", "ay", "az", "bx", "by", "bz"), (*foot, *point), strict=True))
    values["gamma"] = 0.0
    first = float(np.arctan2(-rod[1], rod[2]))
    spin = Joint("spin", "revolute", axis=Z, lower=-np.inf, upper=np.inf)
    return Leg(
        f"leg_{number + 1}",
        (
            Joint("u1", "revolute", Placement.of(values, x="ax", y="ay", z="az"), X, home=first),
            Joint("u2", "revolute", axis=Y, home=second),
            Joint("slide", "prismatic", axis=Z, lower=0.3, upper=2.0, home=length),
            *([spin] * spins),
            Joint("tip", "fixed"),
        ),
        (Sensor("slide", offset="gamma"),),
        tuple(values.items()),
        Joint(f"point_{number + 1}", "fixed", Placement.of(values, x="bx", y="by", z="bz")),
    )


def tricept(*, spins: bool = True) -> Mechanism:
    """Return three struts and a centre leg UP without a drive, whose axes miss each other."""
    values = {"cz": 0.0, "off": 0.02}
    centre = Leg(
        "centre",
        (
            Joint("c1", "revolute", Placement.of(values, z="cz"), X),
            Joint("c2", "revolute", Placement.of(values, x="off"), Y),
            Joint("c3", "prismatic", axis=Z, lower=0.3, upper=2.0, home=1.0),
            Joint("c4", "fixed", Placement(xyz=(-0.02, 0.0, 0.0))),
        ),
        (),
        tuple(values.items()),
        Joint("end", "fixed"),
        "frame",
    )
    struts = (strut(number, spins=spins) for number in range(3))
    home = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    return Mechanism("tricept", Platform("spatial", home), (*struts, centre))


def six_rods() -> Mechanism:
    """Return a delta of three arms and six rods that may spin, at a platform of six freedoms."""
    foot, point, arm, rod, half, height = 0.2, 0.05, 0.15, 0.4, 0.04, -0.38
    reach, way = foot - point, np.hypot(foot - point, height)
    bend = np.arccos((way**2 + arm**2 - rod**2) / (2 * arm * way))
    drive = -float(np.arctan2(height, -reach) + bend)
    along = point - foot - arm * np.cos(drive), height + arm * np.sin(drive)
    legs = []
    for number in range(3):
        turn = 2 * np.pi * number / 3
        values = {"R": foot, "turn": turn, "a": arm, "L1": rod, "L2": rod, "gamma": 0.0}
        values |= {f"z{i}": 0.0 for i in (1, 2)}
        joints = [
            Joint(
                "drive",
                "revolute",
                Placement.of(values, polar=("R", "turn"), rz="turn"),
                Y,
                home=drive,
            )
        ]
        points = []
        for i, side in ((1, half), (2, -half)):
            joints += [
                Joint(
                    f"u{i}",
                    "revolute",
                    Placement.of(values, x="a", y=side),
                    Y,
                    home=float(np.arctan2(-along[1], along[0])) - drive,
                    parent=None if i == 1 else "drive",
                ),
                Joint(f"v{i}", "revolute", axis=Z),
                Joint(f"spin{i}", "revolute", axis=X),
                Joint(f"end{i}", "fixed", Placement.of(values, x=f"L{i}")),
            ]
            place = Placement.of(
                values,
                x=point * np.cos(turn) - side * np.sin(turn),
                y=point * np.sin(turn) + side * np.cos(turn),
                z=f"z{i}",
            )
            points.append(Joint(f"p{number}_{i}", "fixed", place))
        legs.append(
            Leg(
                f"leg_{number + 1}",
                tuple(joints),
                (Sensor("drive", offset="gamma"),),
                tuple(values.items()),
                points[1],
                ends=(End("end1", points[0]),),
            )
        )
    return Mechanism(
        "six_rods", Platform("spatial", (0.0, 0.0, height, 0.0, 0.0, 0.0)), tuple(legs)
    )


def agile_eye() -> Mechanism:
    """Return three legs of three axes that meet in a point, at right angles; it only turns."""
    legs, values = [], {"a_rx": 0.0, "a_ry": 0.0, "alpha": np.pi / 2, "beta": np.pi / 2}
    values |= {"gamma": 0.0}
    for number in range(3):
        u, w, v = np.roll(np.eye(3), number, axis=1)
        base = Rotation.from_matrix(np.column_stack((v, -w, u)))  # its z is the drive's axis
        tip = base * Rotation.from_euler("xzx", (np.pi / 2, np.pi / 2, np.pi / 2))
        tilts = Coordinate("rx", ("a_rx",)), Coordinate("ry", ("a_ry",))
        base_turn, tip_turn = (
            placement_of(RigidTransform.from_rotation(R).as_matrix()) for R in (base, tip.inv())
        )
        joints = (
            Joint("base", "fixed", base_turn),
            Joint("drive", "revolute", Placement(tilts), lower=-1.2, upper=1.2),
            Joint("elbow", "revolute", Placement.of(values, rx="alpha"), home=np.pi / 2),
            Joint("wrist", "revolute", Placement.of(values, rx="beta")),
            Joint("tip", "fixed", tip_turn),
        )
        sensors, point = (Sensor("drive", offset="gamma"),), Joint(f"hand_{number}", "fixed")
        name = f"leg_{number + 1}"
        legs.append(Leg(name, joints, sensors, tuple(values.items()), point, "frame"))
    return Mechanism("eye", Platform("wrist", (0.0,) * 3, ("rx", "ry", "rz")), tuple(legs))


def hexapod(*, spins: bool = True) -> Mechanism:
    """Return six struts with a ball at either end: 6-SPS, each of which spins about itself."""
    turns = np.radians([10, 50, 130, 170, 250, 290])
    legs = []
    for number, turn in enumerate(turns):
        foot = 0.5 * np.array([np.cos(turn), np.sin(turn), 0.0])
        towards = turn + (0.5 if number % 2 else -0.5)
        point = 0.25 * np.array([np.cos(towards), np.sin(towards), 0.0])
        legs.append(rod_leg(f"leg_{number + 1}", foot, point, np.array([0.0, 0.0, 0.6]), spins))
    return Mechanism("hexapod", Platform("spatial", (0.0, 0.0, 0.6, 0.0, 0.0, 0.0)), tuple(legs))


def rod_leg(name: str, foot: Array, point: Array, origin: Array, spins: bool) -> Leg:
    """Return a leg with a slide between two balls, of which one may spin about it."""
    rod = point + origin - foot
    length = float(np.linalg.norm(rod))
    values = dict(zip(("ax", "ay", "az", "bx", "by", "bz"), (*foot, *point), strict=True))
    values["gamma"] = 0.0
    first, second = float(np.arctan2(-rod[1], rod[2])), float(np.arcsin(rod[0] / length))
    joints = (
        Joint("u1", "revolute", Placement.of(values, x="ax", y="ay", z="az"), X, home=first),
        Joint("u2", "revolute", axis=Y, home=second),
        Joint("slide", "prismatic", axis=Z, lower=0.5 * length, upper=1.5 * length, home=length),
        *([Joint("spin", "revolute", axis=Z, lower=-np.inf, upper=np.inf)] * spins),
        Joint("tip", "fixed"),
    )
    met = Joint(f"{name}_point", "fixed", Placement.of(values, x="bx", y="by", z="bz"))
    sensors = (Sensor("slide", offset="gamma"),)
    return Leg(name, joints, sensors, tuple(values.items()), met)


def quattro() -> Mechanism:
    """Return four arms with parallelograms at two half plates, which a link of the platform joins.

    Behind a rod joints follow those before it, so what it carries never turns: half of an
    articulated plate, in which the link is pivoted at either end. The platform is the link.
    """
    foot, arm, rod, height, half, plate = 0.275, 0.37, 0.8, -0.6, 0.08, 0.1
    legs = []
    for number in range(4):
        turn = np.pi / 4 + np.pi / 2 * number
        end = half if number in (0, 3) else -half
        in_leg = end * np.array([np.cos(turn), -np.sin(turn)])
        behind = in_leg - (plate, 0.0)  # from where the rods meet the half plate to its pivot
        drive, swing = two_links(plate - foot, -height, arm, rod)
        values = {"R": foot, "turn": float(turn), "h": 0.0, "l": arm, "L": rod, "gamma": 0.0}
        values |= {"ax": end, "ay": 0.0}
        frame = Placement.of(values, polar=("R", "turn"), z="h", rz="turn")
        joints = (
            Joint("base", "fixed", frame),
            Joint("drive", "revolute", axis=Y, lower=-1.5, upper=3.5, home=drive),
            Joint("swing", "revolute", Placement.of(values, x="l"), Y, home=swing),
            Joint("side", "revolute", axis=Z),
            Joint("side_back", "revolute", Placement.of(values, x="L"), Z, follows=back("side")),
            Joint("swing_back", "revolute", axis=Y, follows=back("swing")),
            Joint("drive_back", "revolute", axis=Y, follows=back("drive")),
            Joint("unturned", "fixed", placement_of(turned_by(-turn, *behind))),
        )
        point = Joint(f"pivot_{number + 1}", "fixed", Placement.of(values, x="ax", y="ay"))
        sensors = (Sensor("drive", offset="gamma"),)
        legs.append(Leg(f"leg_{number + 1}", joints, sensors, tuple(values.items()), point))
    platform = Platform("3T1R", (0.0, 0.0, height, 0.0), ("x", "y", "z", "rz"))
    return Mechanism("quattro", platform, tuple(legs))


def back(name: str) -> Follows:
    """Return what turns a joint back as far as another one turns."""
    return Follows(name, -1.0)


def turned_by(angle: float, x: float, y: float) -> Array:
    """Return a pose in the plane, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("z", angle).as_matrix()
    matrix[:2, 3] = x, y
    return matrix


def two_links(x: float, down: float, first: float, second: float) -> tuple[float, float]:
    """Return angles about y, the second from the first, that reach x and so far down; out first."""
    way = float(np.hypot(x, down))
    bend = np.arccos((way**2 + first**2 - second**2) / (2 * first * way))
    drive = float(np.arctan2(down, x) - bend)
    rest = x - first * np.cos(drive), down - first * np.sin(drive)
    return drive, float(np.arctan2(rest[1], rest[0])) - drive


def upu() -> Mechanism:
    """Return a 3-UPU: slides between universal joints whose axes are parallel in pairs."""
    legs = []
    for number in range(3):
        turn = 2 * np.pi * number / 3
        values = {"R": 0.5, "turn": float(turn), "r": 0.2, "tilt": 0.0, "lean": 0.0, "gamma": 0.0}
        out, height = values["r"] - values["R"], 0.7
        first, length = float(np.arctan2(out, height)), float(np.hypot(out, height))
        tip = Placement((Coordinate("rx", ("tilt",)), Coordinate("rz", ("lean",))))
        joints = (
            Joint("base", "fixed", Placement.of(values, polar=("R", "turn"), rz="turn")),
            Joint("u1", "revolute", axis=Y, home=first),
            Joint("u2", "revolute", axis=X),
            Joint("slide", "prismatic", axis=Z, lower=0.4, upper=1.2, home=length),
            Joint("u3", "revolute", axis=X),
            Joint("u4", "revolute", axis=Y, home=-first),
            Joint("tip", "fixed", tip),
        )
        point = Joint(
            f"corner_{number + 1}", "fixed", Placement.of(values, polar=("r", "turn"), rz="turn")
        )
        sensors = (Sensor("slide", offset="gamma"),)
        legs.append(
            Leg(f"leg_{number + 1}", joints, sensors, tuple(values.items()), point, "frame")
        )
    return Mechanism("upu", Platform("spatial", (0.0, 0.0, 0.7, 0.0, 0.0, 0.0)), tuple(legs))


def ankle() -> Mechanism:
    """Return a foot on a universal joint without drives, and two motors that turn it by rods."""
    values = {"cx": 0.0, "cy": 0.0, "cz": -0.35, "off": 0.0}
    legs = [
        Leg(
            "centre",
            (
                Joint("pitch", "revolute", Placement.of(values, x="cx", y="cy", z="cz"), Y),
                Joint("roll", "revolute", Placement.of(values, x="off"), X),
                Joint("foot", "fixed"),
            ),
            (),
            tuple(values.items()),
            Joint("sole", "fixed"),
            "frame",
        )
    ]
    for number, (side, above) in enumerate(((0.05, 0.25), (-0.05, 0.17))):
        values = {"mx": 0.0, "my": side, "mz": above - 0.35, "l": 0.05, "L": above, "gamma": 0.0}
        values |= {"bx": -0.05, "by": side, "bz": 0.0}
        rod = Placement.of(values, x="l")
        joints = (
            Joint("motor", "revolute", Placement.of(values, x="mx", y="my", z="mz"), Y, home=np.pi),
            Joint("rod_1", "revolute", rod, Y, home=np.pi / 2),
            Joint("rod_2", "revolute", axis=Z),
            Joint("heel", "fixed", Placement.of(values, x="L")),
        )
        joints = (joints[0], replace(joints[1], home=-np.pi / 2), *joints[2:])
        point = Joint(f"heel_{number + 1}", "fixed", Placement.of(values, x="bx", y="by", z="bz"))
        sensors = (Sensor("motor", offset="gamma"),)
        legs.append(Leg(f"motor_{number + 1}", joints, sensors, tuple(values.items()), point))
    return Mechanism("ankle", Platform("spatial", (0.0, 0.0, -0.35, 0.0, 0.0, 0.0)), tuple(legs))


def hybrid() -> Mechanism:
    """Return an arm whose boom and stick are turned by cylinders: loops within its one leg."""
    values = {"h": 0.0, "yaw": 0.0, "l": 1.0, "L": 0.8}
    cylinders = {
        "fx": 0.3,
        "gx": 0.5,
        "gz": 0.1,
        "c1": 0.0,
        "kx": 0.35,
        "mx": -0.15,
        "mz": 0.1,
        "c2": 0.0,
    }
    values |= cylinders
    boom, stick = -0.6, 1.3  # about y: up, and down again
    hook = np.array([values["gx"], 0.0, values["gz"]])
    way = Rotation.from_euler("y", boom).apply(hook) - (values["fx"], 0.0, -0.3)
    second = Rotation.from_euler("y", stick).apply((values["mx"], 0.0, values["mz"]))
    along = second - (values["kx"] - values["l"], 0.0, 0.15)
    joints = [
        Joint("turret", "revolute", Placement.of(values, z="h"), Z),
        Joint("boom", "revolute", Placement.of(values, z=0.4), Y, home=boom),
        Joint("hook_1", "fixed", Placement.of(values, x="gx", z="gz")),
        *cylinder(values, 1, Placement.of(values, x="fx", z=0.1), way, "turret"),
        *cylinder(values, 2, Placement.of(values, x="kx", z=0.15), along, "boom"),
        Joint("stick", "revolute", Placement.of(values, x="l"), Y, home=stick, parent="boom"),
        Joint("hook_2", "fixed", Placement.of(values, x="mx", z="mz")),
        Joint("tool", "fixed", Placement.of(values, x="L"), parent="stick"),
    ]
    sensors = (
        Sensor("turret", offset="yaw"),
        Sensor("slide_1", offset="c1"),
        Sensor("slide_2", offset="c2"),
    )
    ends = (End("rod_1", "hook_1", ("x", "z")), End("rod_2", "hook_2", ("x", "z")))
    leg = Leg(
        "arm",
        tuple(joints),
        sensors,
        tuple(values.items()),
        Joint("flange", "fixed"),
        "frame",
        ends=ends,
    )
    T = leg.link_placements(leg.home[None])[0, -1]
    platform = Platform.at_origin("spatial")
    home = platform.from_matrices(T[None])[0]
    return Mechanism("hybrid", Platform("spatial", tuple(home.tolist())), (leg,))


def cylinder(
    values: dict[str, float], number: int, foot: Placement, way: Array, on: str
) -> list[Joint]:
    """Return a cylinder in the x-z plane, from a foot on a joint's link along a way at home."""
    length, angle = float(np.linalg.norm(way)), float(np.arctan2(way[0], way[2]))
    slide = Joint(
        f"slide_{number}", "prismatic", axis=Z, lower=0.6 * length, upper=1.4 * length, home=length
    )
    return [
        Joint(f"foot_{number}", "revolute", foot, Y, home=angle, parent=on),
        slide,
        Joint(f"rod_{number}", "fixed"),
    ]


MACHINES = {
    make.__name__: make
    for make in (six_rods, tricept, ankle, four_bar, agile_eye, quattro, hexapod, upu, hybrid)
}
"""Machines by their names."""


def configurations(mechanism: Mechanism, count: int) -> pincal.Plan:
    """Return poses and readings about home in which all legs close, by forward kinematics."""
    exact = pincal.Noise(0.0, 0.0, 0.0)
    home = np.concatenate([leg.home[leg.active] for leg in mechanism.legs])
    turning = np.array([unit == "rad" for unit in mechanism.reading_units])
    reach = np.where(turning, 0.25, 0.1 * mechanism.size)
    shares = np.random.default_rng(3).uniform(-1.0, 1.0, (2 * count, len(home)))
    for nearer in 0.5 ** np.arange(6):
        readings = home + nearer * reach * shares
        poses = np.tile(mechanism.platform.home, (2 * count, 1))
        if mechanism.constraints >= mechanism.platform.dof:  # else a pose nearby is taken
            poses = pincal.forward(mechanism, readings).poses
        plan = pincal.Plan(poses, readings=readings).rows(np.isfinite(poses).all(axis=1))
        closed = pincal.simulate(mechanism, mechanism, plan, exact).measurements
        if len(closed) >= count:
            return pincal.Plan(closed.poses[:count], readings=closed.readings[:count])
    raise ValueError(f"{mechanism.name} closes nowhere about home")


def pinocchio_gap(mechanism: Mechanism, plan: pincal.Plan) -> float:
    """Return how far ends are apart that Pinocchio places by URDFs of the legs, [m] and [rad]."""
    matrices, gap = mechanism.platform.matrices(plan.poses), 0.0
    joints = joints_at(mechanism, plan).joints
    for leg in mechanism.legs:
        model = pin.buildModelFromXML(leg_urdf(leg), mimic=True)
        data, links = model.createData(), leg_links(leg)
        for row, T_platform in enumerate(matrices):
            q = pin.neutral(model)
            for joint, value in zip(leg.moving, joints[leg.name][row], strict=True):
                moved = model.joints[model.getJointId(joint.name)]
                turn = (np.cos(value), np.sin(value))
                q[moved.idx_q : moved.idx_q + moved.nq] = value if moved.nq == 1 else turn
            pin.framesForwardKinematics(model, data, q)
            for end in leg.every_end:
                tip = data.oMf[model.getFrameId(links[leg.index(end.tip) + 1])].homogeneous
                if isinstance(end.meets, str):
                    met = data.oMf[model.getFrameId(links[leg.index(end.meets) + 1])].homogeneous
                else:
                    met = T_platform @ end.meets.placement.origin()
                    if end.closes == "point":
                        met[:3, :3] = T_platform[:3, :3]
                apart = np.linalg.inv(met) @ tip
                turn = Rotation.from_matrix(apart[:3, :3]).as_rotvec()
                rows = list(mechanism.platform.closing(end))
                gap = max(gap, float(np.abs(np.concatenate((apart[:3, 3], turn))[rows]).max()))
    return gap


def standardised(mechanism: Mechanism, plan: pincal.Plan, sets: int) -> list[Array]:
    """Return squares of errors over their variances, of each set in all directions that vary.

    The noise is low, so that curvature counts for little; what rows do not determine is held.
    """
    noise, squares = pincal.Noise(position=1e-6, orientation=1e-6, reading=1e-7), []
    for seed in range(sets):
        truth = pincal.disturb(mechanism, 1e-4, seed=seed)
        data = pincal.simulate(mechanism, truth, plan, noise, seed=seed).measurements
        result = pincal.calibrate(mechanism, data, noise=noise, folds=0)
        true = {parameter.id: parameter.nominal for parameter in truth.parameters}
        errors = np.array([p.identified - true[p.id] for p in result.parameters])
        values, axes = np.linalg.eigh(result.parameter_covariance)
        varies = values > 1e-12 * values[-1]
        squares.append((axes.T @ errors)[varies] ** 2 / values[varies])
    return squares
