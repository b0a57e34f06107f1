"""3-PUU, three linear drives at right angles, as in the Orthoglide: run to write its files.

P. Wenger and D. Chablat, Design of a three-axis isotropic parallel manipulator for machining
applications: the Orthoglide, Quebec, 2002. Each parallelogram counts as one rod; the drives'
common diagonal is the base's z. Dimensions are our own.
"""

from math import acos, pi, sqrt
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

DIAGONAL = acos(1 / sqrt(3))  # angle between z and each drive [rad]
PARAMETERS = {
    "OA": 0.5,  # where the carriage reads zero: radius [m], angle from z and azimuth [rad]
    "alpha": DIAGONAL,
    "beta": 0.0,
    "yaw": 0.0,  # of the drive's direction [rad]
    "pitch": 0.0,
    "L": 0.31,  # rods of the parallelogram [m]
    "k": 1.0,  # sensor gain; an offset would move the zero along the drive
}
LABELS = {
    "OA": "rail, radius",
    "alpha": "rail, angle from z",
    "beta": "rail, azimuth",
    "yaw": "direction of the drive, yaw",
    "pitch": "direction of the drive, pitch",
    "L": "rods",
    "k": "gain of the reading",
}
LEGS = cyclic(3)
GROUP: tuple[Element, ...] = (*LEGS, *(Element.mirror(k * pi / 3) for k in range(3)))


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1, which a mirror maps onto itself, carried by three rotations."""
    inward = Placement.of({}, ry=pi / 2 + DIAGONAL).displacement({})  # turns x towards the centre
    base = Placement.of(PARAMETERS, spherical=("OA", "alpha", "beta")).at(PARAMETERS, inward)
    rail = Placement.of(PARAMETERS, rz="yaw", ry="pitch")
    leg = Leg(
        name="leg_1",
        joints=(
            Joint("rail", "fixed", base),
            Joint("drive", "prismatic", rail, (1.0, 0.0, 0.0), lower=0.04, upper=0.24, home=0.14),
            Joint("rod_y", "revolute", Placement(), (0.0, 1.0, 0.0), lower=-0.5, upper=0.5),
            Joint("rod_z", "revolute", Placement(), (0.0, 0.0, 1.0), lower=-0.5, upper=0.5),
            Joint("tip", "fixed", Placement.of(PARAMETERS, x="L")),
        ),
        point=Joint("b_1", "fixed", Placement.of(PARAMETERS, spherical=(0.05, DIAGONAL, 0.0))),
        sensors=(Sensor("drive", form="joint", gain="k"),),
        parameters=tuple(PARAMETERS.items()),
    )
    platform = Platform("translational", home=(0.0, 0.0, 0.0))
    return generate(
        "3PUU", leg, LEGS, platform, "Orthogonal 3-PUU (Wenger, Chablat, 2002).", LABELS
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
