"""Random mechanisms of two to eight legs that have closed forms, closed at home by construction.

A leg is drawn from its joints' positions at home; what they reach is computed here, by products
of matrices, and the base put where it meets the platform point. Nothing uses pincal's kinematics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pincal
from pincal import Joint, Leg, Mechanism, Placement, Platform, Sensor

Array = NDArray[np.float64]
Generator = np.random.Generator
Parameters = dict[str, float]
X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Inner:
    """What a leg has between base and platform point."""

    joints: tuple[Joint, ...]
    parameters: Parameters
    active: str
    sensor: tuple[str, ...]
    """Which of gain k and offset gamma are sought: an offset may be the base's place on a rail."""


def _bend(rng: Generator) -> float:
    """Return an elbow angle that is far from stretched and folded, of either side."""
    return float(rng.choice((-1.0, 1.0)) * rng.uniform(0.6, 2.3))


def dyad(rng: Generator) -> Inner:
    """RRR in the plane."""
    p = {"l": rng.uniform(0.5, 1.0), "L": rng.uniform(0.5, 1.0)}
    return Inner(
        (
            Joint("drive", "revolute", home=rng.uniform(-3.0, 3.0)),
            Joint("elbow", "revolute", Placement.of(p, x="l"), home=_bend(rng)),
            Joint("tip", "fixed", Placement.of(p, x="L")),
        ),
        p,
        "drive",
        ("k", "gamma"),
    )


def rail(rng: Generator) -> Inner:
    """PRR in the plane."""
    p = {"delta": rng.uniform(-0.3, 0.3), "L": rng.uniform(0.7, 1.2)}
    turn = rng.choice((0.0, np.pi)) + rng.uniform(-1.0, 1.0)  # the rod is not across the rail
    return Inner(
        (
            _slide("drive", Placement.of(p, rz="delta"), X, rng.uniform(-0.5, 0.5)),
            Joint("rod", "revolute", home=float(turn)),
            Joint("tip", "fixed", Placement.of(p, x="L")),
        ),
        p,
        "drive",
        ("k",),
    )


def strut(rng: Generator) -> Inner:
    """RPR in the plane."""
    return Inner(
        (
            Joint("swing", "revolute", home=rng.uniform(-3.0, 3.0)),
            _slide("drive", Placement(), X, rng.uniform(0.7, 1.5)),
            Joint("tip", "fixed"),
        ),
        {},
        "drive",
        ("k", "gamma"),
    )


def hexapod_strut(rng: Generator) -> Inner:
    """UPS in space."""
    a, b = rng.uniform(-0.8, 0.8, 2)
    return Inner(
        (
            Joint("first", "revolute", axis=X, home=a),
            Joint("second", "revolute", axis=Y, home=b),
            _slide("drive", Placement(), Z, rng.uniform(0.7, 1.5)),
            Joint("tip", "fixed"),
        ),
        {},
        "drive",
        ("k", "gamma"),
    )


def crank(rng: Generator) -> Inner:
    """RUS in space."""
    p = {"yaw": rng.uniform(-0.3, 0.3), "roll": rng.uniform(-0.3, 0.3)}
    p |= {"l": rng.uniform(0.3, 0.6), "L": rng.uniform(0.8, 1.2)}
    place = Placement.of(p, rz="yaw", rx="roll")
    return Inner(
        (
            Joint("drive", "revolute", place, Y, home=rng.uniform(-1.0, 1.0)),
            Joint("first", "revolute", Placement.of(p, x="l"), Y, home=_bend(rng)),
            Joint("second", "revolute", axis=Z, home=rng.uniform(-0.6, 0.6)),
            Joint("tip", "fixed", Placement.of(p, x="L")),
        ),
        p,
        "drive",
        ("k", "gamma"),
    )


def carriage(rng: Generator) -> Inner:
    """PUS in space."""
    p = {"yaw": rng.uniform(-0.3, 0.3), "pitch": rng.uniform(-0.3, 0.3)}
    p |= {"L": rng.uniform(0.8, 1.2)}
    place = Placement.of(p, rz="yaw", ry="pitch")
    a, b = rng.uniform(-0.9, 0.9, 2)
    return Inner(
        (
            _slide("drive", place, X, rng.uniform(-0.3, 0.3)),
            Joint("first", "revolute", axis=Y, home=a),
            Joint("second", "revolute", axis=Z, home=b),
            Joint("tip", "fixed", Placement.of(p, x="L")),
        ),
        p,
        "drive",
        ("k",),
    )


def _slide(name: str, placement: Placement, axis: tuple[float, float, float], home: float) -> Joint:
    return Joint(name, "prismatic", placement, axis, lower=-4.0, upper=4.0, home=home)


Draw = Callable[[Generator], Inner]
#: By platform: how many legs, and of which families.
KINDS: dict[str, tuple[tuple[int, ...], tuple[Draw, ...]]] = {
    "point": ((2, 3), (dyad, rail, strut)),
    "planar": ((3, 4, 8), (dyad, rail, strut)),
    "translational": ((3, 4), (hexapod_strut, crank, carriage)),
    "spatial": ((6, 7, 8), (hexapod_strut, crank, carriage)),
}


def reached(joints: tuple[Joint, ...]) -> Array:
    """Return where a chain of joints has its tip at home, shape (4, 4)."""
    T = np.eye(4)
    for joint in joints:
        T = T @ joint.placement.origin()
        motion = np.eye(4)
        if joint.kind == "revolute":
            turn = Rotation.from_rotvec(joint.home * np.array(joint.axis))
            motion[:3, :3] = turn.as_matrix()
        elif joint.kind == "prismatic":
            motion[:3, 3] = joint.home * np.array(joint.axis)
        T = T @ motion
    return T


def random_leg(name: str, draw: Draw, platform: Platform, rng: Generator) -> Leg:
    """Return a leg of a family whose base is put where it closes at the platform's home."""
    inner, plane = draw(rng), platform.space == 2
    turn = np.eye(4)
    if not plane:
        turn[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    elif inner.joints[0].kind == "prismatic":
        turn[:3, :3] = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-3.0, 3.0)]).as_matrix()
    b = np.append(rng.uniform(-0.4, 0.4, 2), 0.0 if plane else rng.uniform(-0.2, 0.2))
    axes = "xy" if plane else "xyz"
    parameters = dict(inner.parameters)
    b_names = [f"b_{axis}" for axis in axes]
    if platform.kind == "point":
        b, point = np.zeros(3), Placement()
    elif platform.kind == "translational":  # not to be told from the base point
        point = Placement(xyz=tuple(b.tolist()))
    else:
        parameters |= dict(zip(b_names, b.tolist(), strict=False))
        point = Placement.of(parameters, **dict(zip("xyz", b_names, strict=False)))
    home = platform.home_pose.as_matrix()[0]
    base = home[:3, 3] + home[:3, :3] @ b - (turn @ reached(inner.joints))[:3, 3]
    A_names = [f"A_{axis}" for axis in axes]
    parameters |= dict(zip(A_names, base.tolist(), strict=False))
    foot = Placement.of(parameters, **dict(zip("xyz", A_names, strict=False))).at(parameters, turn)
    own = {"k": rng.uniform(0.8, 1.25), "gamma": rng.uniform(-0.5, 0.5)}
    parameters |= {name: own[name] for name in inner.sensor}
    return Leg(
        name=name,
        joints=(Joint("foot", "fixed", foot), *inner.joints),
        point=Joint(name.replace("leg", "b"), "fixed", point),
        sensors=(
            Sensor(
                inner.active,
                form=str(rng.choice(("joint", "reading"))),  # type: ignore[arg-type]
                gain="k",
                offset="gamma" if "gamma" in inner.sensor else 0.0,
                direction=int(rng.choice((-1, 1))),
            ),
        ),
        parameters=tuple(parameters.items()),
    )


def random_mechanism(kind: str, legs: int, seed: int, least: float = 0.05) -> Mechanism:
    """Return a random mechanism whose home is not near a type-2 singularity."""
    rng = np.random.default_rng(seed)
    families = KINDS[kind][1]
    while True:
        place = rng.uniform(-0.3, 0.3, len(Platform(kind, _zeros(kind)).coordinates))
        platform = Platform(kind, tuple(np.abs(place).tolist()))
        drawn = [
            random_leg(f"leg_{i + 1}", families[rng.integers(len(families))], platform, rng)
            for i in range(legs)
        ]
        mechanism = Mechanism("random", platform, tuple(drawn))
        if pincal.margins(mechanism, [platform.home]).type2[0] > least:
            return mechanism


def _zeros(kind: str) -> tuple[float, ...]:
    return (0.0,) * {"point": 2, "planar": 3, "translational": 3, "spatial": 6}[kind]


def poses_near_home(mechanism: Mechanism, count: int, seed: int, size: float = 0.15) -> Array:
    """Return poses around home that all legs reach, far from singularities of both types."""
    rng, platform = np.random.default_rng(seed), mechanism.platform
    found = np.empty((0, platform.dof))
    home = pincal.margins(mechanism, [platform.home])
    while len(found) < count:
        twists = rng.uniform(-size, size, (4 * count, platform.dof))
        poses = platform.moved(np.tile(platform.home, (4 * count, 1)), twists)
        there = pincal.margins(mechanism, poses)
        with np.errstate(invalid="ignore"):
            good = (there.type1 > 0.1).all(axis=1) & (there.type2 > 0.2 * home.type2)
        found = np.concatenate((found, poses[good]))
        size *= 0.9
    return found[:count]


@st.composite
def mechanisms(draw: st.DrawFn, kinds: tuple[str, ...] = tuple(KINDS)) -> Mechanism:
    """Random mechanisms, each leg its own family."""
    kind = draw(st.sampled_from(kinds))
    return random_mechanism(
        kind, draw(st.sampled_from(KINDS[kind][0])), draw(st.integers(0, 2**32 - 1))
    )
