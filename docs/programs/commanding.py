"""A hexapod, measured by a tracker in an unknown frame."""

from dataclasses import replace

from scipy.spatial.transform import RigidTransform, Rotation

import pincal

robot = pincal.load_mechanism("6UPS")
noise = pincal.Noise(position=2e-5, orientation=5e-5)
plan = pincal.Plan(pincal.sample_workspace(robot, 40, seed=1))
data = pincal.simulate(robot, pincal.disturb(robot, 5e-4, seed=2), plan, noise, seed=3).measurements
tracker = RigidTransform.from_components([2.0, -1.0, 0.4], Rotation.from_rotvec([0.1, 0.0, 2.0]))
poses = robot.platform.from_matrices((tracker * robot.platform.transforms(data.poses)).as_matrix())
replace(data, poses=poses).to_csv("measured.csv", robot)
