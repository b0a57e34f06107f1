"""Four cables and a plate in the plane: its lengths alone, and the poses that they give."""

from dataclasses import replace

import numpy as np

import pincal

robot = pincal.new_mechanism("cable-4")
truth = pincal.disturb(robot, 1e-3, seed=4).with_parameters(
    {f"{leg.name}.k": 1.0 for leg in robot.legs}
)
rng = np.random.default_rng(2)
poses = robot.platform.home + np.array([0.3, 0.3, 0.15]) * rng.uniform(-1, 1, (80, 3))
noise = pincal.Noise(position=0.0, orientation=0.0, reading=1e-4)
data = pincal.simulate(robot, truth, pincal.Plan(poses), noise, seed=1).measurements
lengths = replace(data, poses=np.full_like(data.poses, np.nan))  # nobody looked
result = pincal.calibrate(robot, lengths, noise=noise, fixed=["k"])
print(f"reduced χ² {result.reduced_chi2:.2f}; fixed by choice:", *(f.code for f in result.gauge))

found, true = (one[:, 0] + 1j * one[:, 1] for one in (result.estimated_poses, poses))
found, true = found - found.mean(), true - true.mean()
turn = np.vdot(found, true) / abs(np.vdot(found, true))  # of the chosen frame against the true one
off = 1e3 * np.sqrt(np.mean(np.abs(turn * found - true) ** 2))
print(f"poses found: {off:.2f} mm from the true ones, once both are in one frame")
