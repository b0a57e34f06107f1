"""Eight cables that carry a platform with six freedoms: run to write its files.

The arrangement of suspended cable robots such as CoGiRo (M. Gouttefarde, J.-F. Collard, N. Riehl
and C. Baradat, Geometry selection of a redundantly actuated cable-suspended parallel robot, IEEE
Trans. Robotics 31, 2015): two cables from the top of each post, crossed at the platform. Dimensions
are our own. A cable is a universal joint at its anchor and a line, zeroed at home. All of them
hold a weight of 20 kg from above, each by a tension of 1 to 1000 N.
"""

from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np

import pincal
from pincal import Element, Joint, Mechanism, Placement

HOME = (0.0, 0.0, 1.5)  # [m]
PARAMETERS = {
    "A_x": 3.0,  # anchor [m]
    "A_y": 2.6,
    "A_z": 4.0,
    "b_x": 1.2,  # platform point [m]
    "b_y": -0.8,
    "b_z": 0.4,
    "k": 1.0,  # sensor gain
}
LOAD = pincal.Load(mass=20.0)
TENSIONS = pincal.Cables(least=1.0, most=1000.0)
LABELS = {
    "A_x": "anchor, x",
    "A_y": "anchor, y",
    "A_z": "anchor, z",
    "b_x": "platform's point, x",
    "b_y": "platform's point, y",
    "b_z": "platform's point, z",
    "k": "gain of the reading",
}


def group(posts: int) -> tuple[Element, ...]:
    """Return D_2n: rotations carry post to post, mirrors one cable of a post to the other."""
    turns = pincal.cyclic(posts)
    return tuple(e for t in turns for e in (t, t.after(pincal.Element.mirror(pi / posts))))


GROUP = group(4)


def mechanism(posts: int = 4) -> Mechanism:
    """Return a robot of two cables a post: one cable carried by the elements of D_2n."""
    values = list(PARAMETERS.values())
    cable = np.add(HOME, values[3:6]) - values[:3]
    length = float(np.linalg.norm(cable))
    frame = np.eye(4)  # z along the cable, y level: the universal joint is far from singular
    frame[:3, 2] = cable / length
    frame[:3, 1] = np.cross((0.0, 0.0, 1.0), cable) / np.hypot(*cable[:2])
    frame[:3, 0] = np.cross(frame[:3, 1], frame[:3, 2])
    placement = Placement.of(PARAMETERS, x="A_x", y="A_y", z="A_z").at(PARAMETERS, frame)
    line = pincal.Leg(
        name="line",
        joints=(
            Joint("universal_x", "revolute", placement, (1.0, 0.0, 0.0), -0.45, 0.45),
            Joint("universal_y", "revolute", Placement(), (0.0, 1.0, 0.0), -0.45, 0.45),
            Joint("line", "prismatic", lower=3.7, upper=5.1, home=length),
            Joint("tip", "fixed"),
        ),
        point=Joint("b_1", "fixed", Placement.of(PARAMETERS, x="b_x", y="b_y", z="b_z")),
        sensors=(pincal.Sensor("line", form="reading", gain="k", zero="home"),),
        parameters=tuple(PARAMETERS.items()),
    )
    platform = pincal.Platform("spatial", home=(*HOME, 0.0, 0.0, 0.0))
    what = "Cable robot, two lines from each post to a platform, zeroed at home."
    robot = pincal.generate(f"{2 * posts}cable", line, group(posts), platform, what, LABELS)
    return replace(robot, load=LOAD, cables=TENSIONS)


if __name__ == "__main__":
    mechanism().save(Path(__file__).with_suffix(""), force=True)
