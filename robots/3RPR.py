"""3-RPR, planar: three struts from base to platform: run to write its files.

The architecture of J.-P. Merlet, C. Gosselin and N. Mouly, Workspaces of planar parallel
manipulators, Mechanism and Machine Theory 33, 1998. Dimensions are our own.
"""

from math import pi, radians
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
    "OA": 1.0,  # base point: radius [m] and azimuth [rad]
    "beta": -pi / 2,
    "ob": 0.3,  # platform point: radius [m] and azimuth [rad]
    "beta_b": radians(-30),
    "k": 1.0,  # sensor gain, and length of the strut [m] where it reads zero
    "gamma": 0.5,
}
LABELS = {
    "OA": "base joint, radius",
    "beta": "base joint, azimuth",
    "ob": "platform joint, radius",
    "beta_b": "platform joint, azimuth",
    "k": "gain of the reading",
    "gamma": "length at reading zero",
}
GROUP: tuple[Element, ...] = cyclic(3)


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1 carried by three rotations."""
    leg = Leg(
        name="leg_1",
        joints=(
            Joint("swing", "revolute", Placement.of(PARAMETERS, polar=("OA", "beta")), home=1.2),
            Joint("slide", "prismatic", Placement(), (1.0, 0.0, 0.0), 0.5, 1.4, home=0.9),
            Joint("tip", "fixed"),
        ),
        point=Joint("b_1", "fixed", Placement.of(PARAMETERS, polar=("ob", "beta_b"))),
        sensors=(Sensor("slide", form="joint", gain="k", offset="gamma"),),
        parameters=tuple(PARAMETERS.items()),
    )
    platform = Platform("planar", home=(0.0, 0.0, 0.0))
    return generate(
        "3RPR", leg, GROUP, platform, "Planar 3-RPR (Merlet, Gosselin, Mouly, 1998).", LABELS
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
