"""Linear delta, the 3-D printer with three towers: run to write its files.

The model and the dimensions are those of the printer firmware Klipper (``kinematics/delta.py``,
``config/example-delta.cfg``): carriages on vertical towers, and rods to a nozzle that does not
turn. A parallelogram of rods is one rod, the effector a point: the delta radius is that of the
towers less the offsets of carriage and effector.
"""

from math import acos, asin, pi, radians, sqrt
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
    "radius": 0.17475,  # delta radius [m] and angle of the tower [rad]
    "angle": radians(-150),
    "arm": 0.333,  # length of the rod [m]
    "endstop": 0.29705,  # height of the nozzle over the bed, carriages at their endstops [m]
}
LABELS = {
    "radius": "delta radius",
    "angle": "tower, azimuth",
    "arm": "rods",
    "endstop": "nozzle over the bed, at the endstops",
}
LEGS = cyclic(3)
GROUP: tuple[Element, ...] = (*LEGS, *(Element.mirror(pi / 6 + k * pi / 3) for k in range(3)))
PRINT_RADIUS = 0.12  # that the limits of carriages and rods leave on the bed [m]


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1, which a mirror maps onto itself, carried by three rotations."""
    radius, arm = PARAMETERS["radius"], PARAMETERS["arm"]
    home = sqrt(arm**2 - radius**2)  # of the carriage, nozzle on the bed
    reach = radius + PRINT_RADIUS
    tilt = asin(reach / arm)
    tower = Placement.of(PARAMETERS, polar=("radius", "angle"))
    tower = Placement(tower.coordinates, tower.xyz, (0.0, 0.0, PARAMETERS["angle"] + pi))
    leg = Leg(
        name="leg_1",
        joints=(
            Joint(
                "carriage",
                "prismatic",
                tower,  # x towards the axis of the printer
                lower=sqrt(arm**2 - reach**2),
                upper=home + PARAMETERS["endstop"],
                home=home,
            ),
            Joint(  # 0 is a level rod, pi / 2 one that hangs
                "swing",
                "revolute",
                axis=(0.0, 1.0, 0.0),
                lower=pi / 2 - tilt,
                upper=pi / 2 + tilt,
                home=acos(radius / arm),
            ),
            Joint("sway", "revolute", lower=-tilt, upper=tilt),
            Joint("tip", "fixed", Placement.of(PARAMETERS, x="arm")),
        ),
        point=Joint("nozzle", "fixed"),
        sensors=(Sensor("carriage", offset="endstop", direction=-1, zero="home"),),
        parameters=tuple(PARAMETERS.items()),
    )
    return generate(
        "linear_delta",
        leg,
        LEGS,
        Platform("translational", home=(0.0, 0.0, 0.0)),
        "Linear delta printer of Klipper's example; readings: way down from the endstops.",
        LABELS,
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
