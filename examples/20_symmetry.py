"""The group of a hexapod, and an orbit: one pose with its images serves all legs."""

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.new_mechanism("hexapod")
group = pincal.symmetry_group(robot)
print(group)
turns, all_of_d3 = pincal.cyclic(3), pincal.dihedral(3)
print(f"C3 has {len(turns)} elements, D3 has {len(all_of_d3)}")
broken = robot.with_parameters({"leg_1.OA": robot.legs[0].nominal[0] + 0.01})
print("with one base joint 10 mm off:", pincal.symmetry_group(broken).name)

pose = robot.platform.home + np.array([0.06, 0.02, 0.02, 0.0, 0.0, 0.2])
figure = Figure(figsize=(10, 5), layout="constrained")
for place, (name, poses) in enumerate({"home": robot.platform.home, "a pose": pose}.items()):
    axes = figure.add_subplot(1, 2, place + 1)
    pincal.picture(robot, [poses]).draw(axes)
    axes.set_title(name)
figure.savefig("20_symmetry.png", dpi=100)
