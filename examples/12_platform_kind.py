"""A platform kind from outside: three translations and a turn about z, as to pick and place."""

from math import pi

import numpy as np

import pincal

# Freedoms are rows of a twist; the coordinates x, y, z and phi follow from them.
home, twist = (0.0, 0.0, -0.47, 0.0), ("x", "y", "z", "rz")
platform = pincal.Platform("3T1R", home, twist)

# One leg: a driven crank, and a rod that turns both ways at the elbow. It is set askew, else
# no leg would feel phi.
values = {"R": 0.25, "beta": pi / 4, "l": 0.3, "L": 0.6, "r": 0.1, "beta_b": pi / 4, "gamma": 0.0}
foot = pincal.Placement.of(values, polar=("R", "beta"), rz=pi / 4 + 0.35)
elbow = pincal.Placement.of(values, x="l")
leg = pincal.Leg(
    name="leg_1",
    joints=(
        pincal.Joint("drive", "revolute", foot, (0.0, 1.0, 0.0), -1.5, 1.5, home=0.2),
        pincal.Joint("elbow_y", "revolute", elbow, (0.0, 1.0, 0.0), home=2.2),
        pincal.Joint("elbow_z", "revolute", lower=-1.5, upper=1.5, home=0.1),
        pincal.Joint("tip", "fixed", pincal.Placement.of(values, x="L")),
    ),
    point=pincal.Joint("b_1", "fixed", pincal.Placement.of(values, polar=("r", "beta_b"))),
    sensors=(pincal.Sensor("drive", offset="gamma"),),
    parameters=tuple(values.items()),
)
turn, mirror = pincal.cyclic(2), pincal.Element.mirror
elements = (turn[0], mirror(0.0), turn[1], mirror(pi / 2))
robot = pincal.generate("four_cranks", leg, elements, platform, "Four cranks, 3T1R.")
print(robot)

# Inverse kinematics: readings of poses.
poses = np.array([[0.0, 0.0, -0.47, 0.0], [0.05, -0.03, -0.45, 0.2]])
print(np.degrees(pincal.inverse(robot, poses).readings).round(2))

# Calibration: simulate a machine that is a little off, measure it at 40 poses, identify it.
low, high = np.array([[-0.1, -0.1, -0.52, -0.3], [0.1, 0.1, -0.4, 0.3]])
plan = pincal.Plan(np.random.default_rng(0).uniform(low, high, (40, 4)))
truth = pincal.disturb(robot, 1e-3, seed=1)
noise = pincal.Noise(position=2e-5, orientation=5e-5, reading=1e-5)
data = pincal.simulate(robot, truth, plan, noise, seed=2).measurements
result = pincal.calibrate(robot, data, noise=noise)
for name, machine in (("nominal", robot), ("identified", result.identified)):
    error = pincal.accuracy(machine, truth, plan.poses)
    print(f"{name}: {1e3 * error.position:.4f} mm, {1e3 * error.orientation:.4f} mrad")
pincal.picture(robot).save("12_platform_kind.png", force=True)
print("wrote 12_platform_kind.png")
