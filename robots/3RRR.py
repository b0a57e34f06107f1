"""3-RRR of Durango et al., Symmetrical observability, Section 5: run to write its files."""

from math import pi, radians, sqrt
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
    "l": 1.5,  # proximal link [m]
    "L": 1.5,  # distal link [m]
    "OA": 6.0 / sqrt(3.0),  # base point: radius [m] and azimuth [rad]
    "beta": radians(-150),
    "ob": 1.5 / sqrt(3.0),  # platform point: radius [m] and azimuth [rad]
    "beta_b": radians(-150),
    "k": 1.0,  # sensor gain and offset [rad], Eqs. 6 and 19
    "gamma": pi / 6,
}
LABELS = {
    "l": "proximal link",
    "L": "distal link",
    "OA": "base joint, radius",
    "beta": "base joint, azimuth",
    "ob": "platform joint, radius",
    "beta_b": "platform joint, azimuth",
    "k": "gain of the reading",
    "gamma": "angle at reading zero",
}


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1 carried by the rotations of D_6."""
    leg = Leg(
        name="leg_1",
        joints=(
            Joint("shoulder", "revolute", Placement.of(PARAMETERS, polar=("OA", "beta")), home=1.0),
            Joint("elbow", "revolute", Placement.of(PARAMETERS, x="l"), home=-1.0),
            Joint("tip", "fixed", Placement.of(PARAMETERS, x="L")),
        ),
        point=Joint("b_1", "fixed", Placement.of(PARAMETERS, polar=("ob", "beta_b"))),
        sensors=(Sensor("shoulder", form="joint", gain="k", offset="gamma"),),
        parameters=tuple(PARAMETERS.items()),
    )
    return generate(
        "3RRR",
        leg,
        cyclic(3),
        Platform("planar", home=(0.0, 0.0, 0.0)),
        "Planar 3-RRR, dyads [-1 -1 -1] (Durango et al., symmetrical observability, Fig. 5).",
        LABELS,
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
