"""3-PRR, planar: carriages on a triangle, rods to the platform: run to write its files.

The architecture of C. Gosselin, S. Lemieux and J.-P. Merlet, A new architecture of planar
three-degree-of-freedom parallel manipulator, ICRA 1996. Dimensions are our own.
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
    "OA": 1.2,  # where the carriage reads zero: radius [m] and azimuth [rad]
    "beta": -pi / 2,
    "delta": 0.0,  # direction of the rail [rad]
    "L": 1.2,  # rod [m]
    "ob": 0.4,  # platform point: radius [m] and azimuth [rad]
    "beta_b": -pi / 2,
    "k": 1.0,  # sensor gain; an offset would move the zero along the rail
}
LABELS = {
    "OA": "rail, radius",
    "beta": "rail, azimuth",
    "delta": "direction of the rail",
    "L": "rod",
    "ob": "platform joint, radius",
    "beta_b": "platform joint, azimuth",
    "k": "gain of the reading",
}
GROUP: tuple[Element, ...] = cyclic(3)


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1 carried by three rotations."""
    leg = Leg(
        name="leg_1",
        joints=(
            Joint("rail", "fixed", Placement.of(PARAMETERS, polar=("OA", "beta"))),
            Joint(
                "carriage",
                "prismatic",
                Placement.of(PARAMETERS, rz="delta"),
                axis=(1.0, 0.0, 0.0),
                lower=-1.6,
                upper=1.6,
                home=-0.9,
            ),
            Joint("rod", "revolute", home=0.6),
            Joint("tip", "fixed", Placement.of(PARAMETERS, x="L")),
        ),
        point=Joint("b_1", "fixed", Placement.of(PARAMETERS, polar=("ob", "beta_b"))),
        sensors=(Sensor("carriage", form="joint", gain="k"),),
        parameters=tuple(PARAMETERS.items()),
    )
    platform = Platform("planar", home=(0.0, 0.0, 0.0))
    return generate(
        "3PRR", leg, GROUP, platform, "Planar 3-PRR (Gosselin, Lemieux, Merlet, 1996).", LABELS
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
