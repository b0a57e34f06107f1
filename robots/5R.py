"""Five-bar (5R) of the divide-and-conquer paper, Section 5: run to write its files."""

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
    generate,
)

PARAMETERS = {
    "l": 0.75,  # driving link [m]
    "L": 1.1,  # conducted link [m]
    "A_x": -0.5,  # base point [m]
    "A_y": 0.0,
    "k": 1.0,  # sensor gain and offset [rad], Eq. 9
    "gamma": 0.0,
}
LABELS = {
    "l": "driving link",
    "L": "conducted link",
    "A_x": "motor, x",
    "A_y": "motor, y",
    "k": "gain of the reading",
    "gamma": "offset of the reading",
}


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1 and its mirror image, elbows outward."""
    leg = Leg(
        name="leg_1",
        joints=(
            Joint(
                "shoulder",
                "revolute",
                Placement.of(PARAMETERS, x="A_x", y="A_y"),
                lower=pi / 4,
                upper=5 * pi / 4,
                home=2.2,
            ),
            Joint("elbow", "revolute", Placement.of(PARAMETERS, x="l"), home=-1.6),
            Joint("tip", "fixed", Placement.of(PARAMETERS, x="L")),
        ),
        point=Joint("end_effector", "fixed"),
        sensors=(Sensor("shoulder", form="reading", gain="k", offset="gamma"),),
        parameters=tuple(PARAMETERS.items()),
    )
    return generate(
        "5R",
        leg,
        (Element(0.0), Element.mirror(pi / 2)),
        Platform("point", home=(0.0, 1.1)),
        "Planar symmetrical five-bar, elbows outward (divide-and-conquer paper, Fig. 2).",
        LABELS,
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
