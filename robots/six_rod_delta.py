"""Delta robot with rotary drives and six rods: run to write its files.

R. Clavel, Delta, a fast robot with parallel geometry, 18th Int. Symp. on Industrial Robots, 1988.
Each parallelogram is its two rods with a ball at either end: unequal rods tilt the platform, which
a delta of one rod a leg cannot say. Dimensions are those of the bundled delta.
The platform hardly tilts, so that a leg sees its base and its first platform point only by their
difference: that point is a number.
"""

from math import atan2, hypot, pi
from pathlib import Path

from pincal import (
    Element,
    End,
    Joint,
    Leg,
    Mechanism,
    Placement,
    Platform,
    Sensor,
    cyclic,
    generate,
)

WIDTH = 0.08  # between the rods of a parallelogram [m]
POINT = (0.06, WIDTH / 2)  # where the first rod ends on the platform: along the radius, across [m]
PARAMETERS = {
    "OA": 0.2,  # middle of the drive's axis: radius [m], azimuth [rad] and height [m]
    "beta": 0.0,
    "h": 0.0,
    "yaw": 0.0,  # of the drive's axis about z and about the radius [rad]
    "roll": 0.0,
    "l": 0.25,  # arm [m]
    "gamma": 0.0,  # arm's angle below the horizontal where the drive reads zero [rad]
    "L_1": 0.55,  # rods of the parallelogram [m]
    "L_2": 0.55,
    "ob_2": hypot(*POINT),  # where the second rod ends on the platform: radius, azimuth, height
    "beta_2": -atan2(POINT[1], POINT[0]),
    "h_2": 0.0,
}
LABELS = {
    "OA": "drive's axis, radius",
    "beta": "drive's axis, azimuth",
    "h": "drive's axis, height",
    "yaw": "drive's axis, turn about z",
    "roll": "drive's axis, turn about the radius",
    "l": "arm",
    "gamma": "arm below the horizontal at reading zero",
    "L_1": "first rod",
    "L_2": "second rod",
    "ob_2": "platform's end of the second rod, radius",
    "beta_2": "platform's end of the second rod, azimuth",
    "h_2": "platform's end of the second rod, height",
}
LEGS = cyclic(3)
GROUP: tuple[Element, ...] = (*LEGS, *(Element.mirror(k * pi / 3) for k in range(3)))


def rod(number: int, parent: str | None) -> tuple[Joint, ...]:
    """Return the joints of a rod, from the arm's end on."""
    side = WIDTH / 2 if number == 1 else -WIDTH / 2
    elbow = Placement.of(PARAMETERS, x="l", y=side)
    y, z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    return (
        Joint(f"elbow_{number}_y", "revolute", elbow, y, home=1.5, parent=parent),
        Joint(f"elbow_{number}_z", "revolute", Placement(), z, lower=-0.8, upper=0.8),
        Joint(f"tip_{number}", "fixed", Placement.of(PARAMETERS, x=f"L_{number}")),
    )


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1, which a mirror maps onto itself, carried by three rotations."""
    base = Placement.of(PARAMETERS, polar=("OA", "beta"), z="h")
    axis = Placement.of(PARAMETERS, rz="yaw", rx="roll")
    first = Joint("b_1", "fixed", Placement.of(PARAMETERS, x=POINT[0], y=POINT[1]))
    second = Joint("c_1", "fixed", Placement.of(PARAMETERS, polar=("ob_2", "beta_2"), z="h_2"))
    drive = Joint("drive", "revolute", axis, (0.0, 1.0, 0.0), lower=-0.6, upper=1.4, home=0.3)
    leg = Leg(
        name="leg_1",
        joints=(Joint("base", "fixed", base), drive, *rod(2, None), *rod(1, "drive")),
        point=first,
        ends=(End("tip_2", second),),
        sensors=(Sensor("drive", form="joint", offset="gamma"),),
        parameters=tuple(PARAMETERS.items()),
    )
    home = (0.0, 0.0, -0.5, 0.0, 0.0, 0.0)
    text = "Delta robot with rotary drives and six rods (Clavel, 1988)."
    return generate("six_rod_delta", leg, LEGS, Platform("spatial", home), text, LABELS)


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
