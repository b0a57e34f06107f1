"""6-PUS with upright linear drives, the active wrist: run to write its files.

J.-P. Merlet and C. Gosselin, Nouvelle architecture pour un manipulateur parallèle à six degrés de
liberté, Mechanism and Machine Theory 26, 1991. Dimensions are our own.
"""

from math import pi, radians
from pathlib import Path

import pincal
from pincal import Joint, Placement

PARAMETERS = {
    "OA": 0.7,  # where the carriage reads zero: radius [m], angle from z and azimuth [rad]
    "alpha": pi / 2,
    "beta": radians(20),
    "pitch": 0.0,  # of the drive about y and x of the base, as seen by leg 1 [rad]
    "roll": 0.0,
    "L": 0.8,  # rod [m]
    "ob": 0.4,  # platform point: radius [m], angle from z and azimuth [rad]
    "alpha_b": pi / 2,
    "beta_b": radians(50),
    "k": 1.0,  # sensor gain
}
LABELS = dict(zip(PARAMETERS, (
    "rail, radius", "rail, angle from z", "rail, azimuth", "drive, turn about y",
    "drive, turn about x", "rod", "platform joint, radius", "platform joint, angle from z",
    "platform joint, azimuth", "gain of the reading"), strict=True))  # fmt: skip
GROUP = tuple(
    element
    for k, turn in enumerate(pincal.cyclic(3))
    for element in (turn, pincal.Element.mirror((k + 1) * pi / 3))
)


def mechanism() -> pincal.Mechanism:
    """Return the mechanism: leg 1 carried by the rotations and mirrors of D_6."""
    drive = Placement.of(PARAMETERS, ry="pitch", rx="roll")
    ball = Placement.of(PARAMETERS, spherical=("ob", "alpha_b", "beta_b"))
    leg = pincal.Leg(
        name="leg_1",
        joints=(
            Joint("rail", "fixed", Placement.of(PARAMETERS, spherical=("OA", "alpha", "beta"))),
            Joint("drive", "prismatic", drive, lower=0.0, upper=0.6, home=0.3),
            Joint("universal_x", "revolute", Placement(), (1.0, 0.0, 0.0), -0.75, 0.75),
            Joint("universal_y", "revolute", Placement(), (0.0, 1.0, 0.0), -0.75, 0.75),
            Joint("tip", "fixed", Placement.of(PARAMETERS, z="L")),
        ),
        point=Joint("b_1", "fixed", ball),
        sensors=(pincal.Sensor("drive", form="joint", gain="k"),),
        parameters=tuple(PARAMETERS.items()),
    )
    platform = pincal.Platform("spatial", home=(0.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    what = "Active wrist (Merlet, Gosselin, 1991)."
    return pincal.generate("6PUS", leg, GROUP, platform, what, LABELS)


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
