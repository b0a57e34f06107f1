"""6-RUS, the hexapod with rotary drives: run to write its files.

One of the architectures of K. H. Hunt, Structural kinematics of in-parallel-actuated robot-arms,
J. Mechanisms, Transmissions and Automation in Design 105, 1983. Dimensions are our own.
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
    "OA": 0.4,  # middle of the crank's axis: radius [m], angle from z and azimuth [rad]
    "alpha": pi / 2,
    "beta": radians(10),
    "yaw": 0.0,  # of the axis about z and about the crank's zero direction [rad]
    "roll": 0.0,
    "l": 0.13,  # crank [m]
    "L": 0.55,  # rod [m]
    "ob": 0.26,  # platform point: radius [m], angle from z and azimuth [rad]
    "alpha_b": pi / 2,
    "beta_b": radians(50),
    "gamma": 0.0,  # crank's angle below the horizontal where the drive reads zero [rad]
}
LABELS = {
    "OA": "crank's axis, radius",
    "alpha": "crank's axis, angle from z",
    "beta": "crank's axis, azimuth",
    "yaw": "crank's axis, turn about z",
    "roll": "crank's axis, turn about the crank's zero",
    "l": "crank",
    "L": "rod",
    "ob": "platform joint, radius",
    "alpha_b": "platform joint, angle from z",
    "beta_b": "platform joint, azimuth",
    "gamma": "crank below the horizontal at reading zero",
}
GROUP: tuple[Element, ...] = tuple(
    element
    for k, turn in enumerate(cyclic(3))
    for element in (turn, Element.mirror((k + 1) * pi / 3))
)


def mechanism() -> Mechanism:
    """Return the mechanism: leg 1 carried by the rotations and mirrors of D_6."""
    tangent = Placement.of({}, rz=PARAMETERS["beta"] + pi / 2).displacement({})  # towards leg 2
    foot = Placement.of(PARAMETERS, spherical=("OA", "alpha", "beta")).at(PARAMETERS, tangent)
    axis = Placement.of(PARAMETERS, rz="yaw", rx="roll")
    wrist = Placement.of(PARAMETERS, x="l")
    leg = Leg(
        name="leg_1",
        joints=(
            Joint("base", "fixed", foot),
            Joint("drive", "revolute", axis, (0.0, 1.0, 0.0), lower=-1.4, upper=1.4),
            Joint("universal_y", "revolute", wrist, (0.0, 1.0, 0.0), home=-2.2),
            Joint("universal_z", "revolute", Placement(), lower=-0.9, upper=0.9),
            Joint("tip", "fixed", Placement.of(PARAMETERS, x="L")),
        ),
        point=Joint(
            "b_1", "fixed", Placement.of(PARAMETERS, spherical=("ob", "alpha_b", "beta_b"))
        ),
        sensors=(Sensor("drive", form="joint", offset="gamma"),),
        parameters=tuple(PARAMETERS.items()),
    )
    platform = Platform("spatial", home=(0.0, 0.0, 0.51, 0.0, 0.0, 0.0))
    return generate(
        "6RUS", leg, GROUP, platform, "Hexapod with rotary drives (Hunt, 1983).", LABELS
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
