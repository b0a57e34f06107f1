"""Four cables that meet in a point, three anchored low and one high: run to write its files.

A cable is a leg: a universal joint at its anchor A, a prismatic line, the tip at the platform.
Lines are zeroed at home, p = 0: they read ψ = k (‖p − A‖ − ‖A‖). One line more than freedoms.
"""

from math import cos, pi, sin
from pathlib import Path

import numpy as np

from pincal import Joint, Leg, Mechanism, Placement, Platform, Sensor

RADIUS, HEIGHT = 1.6, -0.12  # of the low anchors [m]
HIGH = 2.35  # [m]
AZIMUTHS = {"line_A": -pi / 2, "line_B": pi / 6, "line_C": 5 * pi / 6}
LABELS = {
    "A_x": "anchor, x",
    "A_y": "anchor, y",
    "A_z": "anchor, z",
    "k": "gain of the reading",
}


def line(name: str, anchor: tuple[float, float, float], azimuth: float) -> Leg:
    """Return a line; its universal joint is at (0, 0), far from singular, where it points home."""
    parameters = dict(zip(("A_x", "A_y", "A_z"), anchor, strict=True)) | {"k": 1.0}
    length = float(np.linalg.norm(anchor))
    frame = np.eye(4)
    frame[:3, 2] = -np.array(anchor) / length  # z along the line, y level
    frame[:3, 1] = -sin(azimuth), cos(azimuth), 0.0
    frame[:3, 0] = np.cross(frame[:3, 1], frame[:3, 2])
    placement = Placement.of(parameters, x="A_x", y="A_y", z="A_z").at(parameters, frame)
    return Leg(
        name=name,
        joints=(
            Joint("universal_x", "revolute", placement, (1.0, 0.0, 0.0), -pi / 2, pi / 2),
            Joint("universal_y", "revolute", Placement(), (0.0, 1.0, 0.0), -pi / 2, pi / 2),
            Joint("line", "prismatic", Placement(), lower=0.05, upper=6.0, home=length),
            Joint("tip", "fixed"),
        ),
        point=Joint("end_effector", "fixed"),
        sensors=(Sensor("line", form="reading", gain="k", zero="home"),),
        parameters=tuple(parameters.items()),
    )


def mechanism() -> Mechanism:
    """Return the mechanism: three low lines a third of a turn apart, and one from above."""
    low = (
        line(name, (round(RADIUS * cos(a), 12), round(RADIUS * sin(a), 12), HEIGHT), a)
        for name, a in AZIMUTHS.items()
    )
    return Mechanism(
        "4cable",
        Platform("translational", home=(0.0, 0.0, 0.0)),
        (*low, line("line_D", (0.0, 0.0, HIGH), 0.0)),
        "Cable robot, four lines to a point, zeroed at home; one line more than freedoms.",
        tuple(LABELS.items()),
    )


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
