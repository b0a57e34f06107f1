"""3-RPS of Hunt (Structural kinematics of in-parallel-actuated robot arms, 1983): run to write.

Each leg swings in a plane and ends in a ball joint of the platform: two equations a leg, one more
than its drive gives, so that the platform moves in three of its six freedoms.
"""

from math import pi
from pathlib import Path

from pincal import (
    Joint,
    Leg,
    Mechanism,
    Placement,
    Platform,
    Sensor,
    cyclic,
    generate,
)

PARAMETERS = {
    "OA": 0.5,  # base point: radius [m], angle from z and azimuth [rad]
    "alpha": pi / 2,
    "beta": 0.0,
    "psi": 0.0,  # azimuth of the plane in which the leg swings [rad]
    "ob": 0.35,  # platform point, as the base point
    "alpha_b": pi / 2,
    "beta_b": 0.0,
    "k": 1.0,  # sensor gain and offset [m]
    "gamma": 0.0,
}
LABELS = {
    "OA": "hinge, radius",
    "alpha": "hinge, angle from z",
    "beta": "hinge, azimuth",
    "psi": "plane of the leg, azimuth",
    "ob": "platform joint, radius",
    "alpha_b": "platform joint, angle from z",
    "beta_b": "platform joint, azimuth",
    "k": "gain of the reading",
    "gamma": "length at reading zero",
}


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1 carried by the rotations of D_6."""
    hinge = Placement.of(PARAMETERS, spherical=("OA", "alpha", "beta"), rz="psi")
    leg = Leg(
        name="leg_1",
        joints=(
            Joint("hinge", "revolute", hinge, (0.0, 1.0, 0.0), -1.0, 1.0),
            Joint("slide", "prismatic", Placement(), lower=0.68, upper=0.92, home=0.8),
            Joint("tip", "fixed", Placement()),
        ),
        point=Joint(
            "b_1", "fixed", Placement.of(PARAMETERS, spherical=("ob", "alpha_b", "beta_b"))
        ),
        sensors=(Sensor("slide", form="joint", gain="k", offset="gamma"),),
        parameters=tuple(PARAMETERS.items()),
    )
    return generate(
        "3RPS",
        leg,
        cyclic(3),
        Platform("spatial", home=(0.0, 0.0, 0.786, 0.0, 0.0, 0.0)),
        "3-RPS parallel manipulator (Hunt 1983): one translation and two tilts.",
        LABELS,
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
