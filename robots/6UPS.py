"""6-UPS hexapod of the symmetrical-workspace paper, Section 3: run to write its files.

Table 1 with θa = π/3 − 0.3: the printed θa = 0.3 does not give the leg lengths of Eq. 36.
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
    "OA": 0.4,  # base point: radius [m], angle from z and azimuth [rad]
    "alpha": pi / 2,
    "beta": 0.3,
    "ob": 0.3,  # platform point, alike
    "alpha_b": pi / 2,
    "beta_b": pi / 3 - 0.3,
    "k": 1.0,  # sensor gain and offset [m]
    "gamma": 0.0,
}
LABELS = {
    "OA": "base joint, radius",
    "alpha": "base joint, angle from z",
    "beta": "base joint, azimuth",
    "ob": "platform joint, radius",
    "alpha_b": "platform joint, angle from z",
    "beta_b": "platform joint, azimuth",
    "k": "gain of the reading",
    "gamma": "length at reading zero",
}


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1 carried by the rotations and mirrors of D_6."""
    leg = Leg(
        name="leg_1",
        joints=(
            Joint(
                "universal_x",
                "revolute",
                Placement.of(PARAMETERS, spherical=("OA", "alpha", "beta")),
                axis=(1.0, 0.0, 0.0),
                lower=-pi / 2,
                upper=pi / 2,
            ),
            Joint(
                "universal_y",
                "revolute",
                Placement(),
                axis=(0.0, 1.0, 0.0),
                lower=-pi / 2,
                upper=pi / 2,
            ),
            Joint("leg", "prismatic", Placement(), lower=1.6, upper=2.6, home=1.8),
            Joint("tip", "fixed", Placement()),
        ),
        point=Joint(
            "b_1", "fixed", Placement.of(PARAMETERS, spherical=("ob", "alpha_b", "beta_b"))
        ),
        sensors=(Sensor("leg", form="joint", gain="k", offset="gamma"),),
        parameters=tuple(PARAMETERS.items()),
    )
    elements: list[Element] = []
    for k, turn in enumerate(cyclic(3)):  # legs 1 to 6 around the base, as in Table 1
        elements += [turn, Element.mirror((k + 1) * pi / 3)]
    return generate(
        "6UPS",
        leg,
        elements,
        Platform("spatial", home=(0.0, 0.0, 1.8, 0.0, 0.0, 0.0)),
        "Hexapod (Gough-Stewart platform) of the symmetrical-workspace paper, Table 1.",
        LABELS,
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
