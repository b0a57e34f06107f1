"""Delta robot with rotary drives: run to write its files.

R. Clavel, Delta, a fast robot with parallel geometry, 18th Int. Symp. on Industrial Robots, 1988.
Its parallelograms keep the platform level, so each counts as one rod. Dimensions are our own.
A leg sees its base and platform radii only by their difference: the platform's is a number.
"""

from math import pi
from pathlib import Path

from pincal import (
    Element,
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
    "OA": 0.2,  # middle of the drive's axis: radius [m], azimuth [rad] and height [m]
    "beta": 0.0,
    "h": 0.0,
    "yaw": 0.0,  # of the drive's axis about z and about the radius [rad]
    "roll": 0.0,
    "l": 0.25,  # arm [m]
    "L": 0.55,  # rods of the parallelogram [m]
    "gamma": 0.0,  # arm's angle below the horizontal where the drive reads zero [rad]
}
LABELS = {
    "OA": "drive's axis, radius",
    "beta": "drive's axis, azimuth",
    "h": "drive's axis, height",
    "yaw": "drive's axis, turn about z",
    "roll": "drive's axis, turn about the radius",
    "l": "arm",
    "L": "rods",
    "gamma": "arm below the horizontal at reading zero",
}
LEGS = cyclic(3)
GROUP: tuple[Element, ...] = (*LEGS, *(Element.mirror(k * pi / 3) for k in range(3)))


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1, which a mirror maps onto itself, carried by three rotations."""
    base = Placement.of(PARAMETERS, polar=("OA", "beta"), z="h")
    axis = Placement.of(PARAMETERS, rz="yaw", rx="roll")
    elbow = Placement.of(PARAMETERS, x="l")
    leg = Leg(
        name="leg_1",
        joints=(
            Joint("base", "fixed", base),
            Joint("drive", "revolute", axis, (0.0, 1.0, 0.0), lower=-0.6, upper=1.4, home=0.3),
            Joint("elbow_y", "revolute", elbow, (0.0, 1.0, 0.0), home=1.5),
            Joint("elbow_z", "revolute", Placement(), (0.0, 0.0, 1.0), lower=-0.8, upper=0.8),
            Joint("tip", "fixed", Placement.of(PARAMETERS, x="L")),
        ),
        point=Joint("b_1", "fixed", Placement.of(PARAMETERS, polar=(0.06, 0.0))),
        sensors=(Sensor("drive", form="joint", offset="gamma"),),
        parameters=tuple(PARAMETERS.items()),
    )
    platform = Platform("translational", home=(0.0, 0.0, -0.5))
    return generate(
        "delta", leg, LEGS, platform, "Delta robot with rotary drives (Clavel, 1988).", LABELS
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
