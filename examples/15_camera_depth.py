"""A camera is poor along its axis: give each row its own noise, and poor rows do no harm."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("delta")
truth = pincal.disturb(robot, 5e-4, seed=2)
rng = np.random.default_rng(1)
spread = np.array([0.15, 0.15, 0.08])
plan = pincal.Plan(robot.platform.home + spread * rng.uniform(-1.0, 1.0, (60, 3)))
exact = pincal.simulate(robot, truth, plan, pincal.Noise(0.0)).measurements

# It looks down from 0.5 m over the platform: depth is ten times worse, and grows with distance.
distance = 0.5 + robot.platform.home[2] + 0.08 - exact.poses[:, 2]
sigma = 1e-4 * np.column_stack((distance, distance, 10.0 * distance))
data = replace(exact, poses=exact.poses + sigma * rng.standard_normal(sigma.shape))

fits = {
    "one noise for all": pincal.calibrate(robot, data),
    "noise of each row": pincal.calibrate(robot, replace(data, sigma_poses=sigma)),
}
there = robot.platform.home + spread * rng.uniform(-1.0, 1.0, (500, 3))
figure = Figure(figsize=(8, 3.8), layout="constrained")
panels = figure.subplots(1, 2, sharey=True)
for axes, (name, fit) in zip(panels, fits.items(), strict=True):
    reached = pincal.forward(truth, pincal.inverse(fit.identified, there).readings, there).poses
    off = 1e3 * np.linalg.norm(reached - there, axis=1)
    promised = 1e3 * fit.expected_error(there).position
    print(f"{name}: off by {np.sqrt((off**2).mean()):.3f} mm, promised {promised:.3f} mm")
    axes.hist(off, bins=25)
    axes.set(title=name, xlabel="platform off by [mm]")
panels[0].set_ylabel("poses")
figure.savefig("15_camera_depth.png", dpi=120)
