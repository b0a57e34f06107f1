"""Calibrate a cable robot of which hardly any pose was measured: the poses are found, too."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("4cable")
noise = pincal.Noise(position=1e-3, reading=5e-4)  # [m]

# The anchors stand centimetres from where they were planned, and spools have gains of their own.
rng = np.random.default_rng(0)
truth = robot.with_parameters(
    {leg.name: leg.nominal + np.append(0.05 * rng.standard_normal(3), -0.01) for leg in robot.legs}
)
low, high = np.array([-0.7, -0.7, -0.05]), np.array([0.7, 0.7, 1.6])
plan = pincal.Plan(rng.uniform(low, high, (45, 3)))
data = pincal.simulate(robot, truth, plan, noise, seed=1).measurements
true_poses = plan.poses.copy()
seen = data.poses.copy()
seen[9:] = np.nan  # a camera saw the first nine poses only
data = replace(data, poses=seen)

result = pincal.calibrate(robot, data, noise=noise, rough=True)
print(result)
found = result.estimated_poses
off = np.linalg.norm(found - true_poses, axis=1)
print(f"36 poses that nobody measured: {1e3 * np.median(off[9:]):.1f} mm off (median)")

figure = Figure(figsize=(6, 6), layout="constrained")
axes = figure.subplots()
for style, one in (("k+", truth), ("C7s", robot), ("C0o", result.identified)):
    anchors = np.array([leg.nominal[:2] for leg in one.legs])
    axes.plot(*anchors.T, style, markersize=12, fillstyle="none")
axes.plot(*true_poses[:, :2].T, "k.", markersize=3)
axes.plot(*found[9:, :2].T, "C0o", markersize=5, fillstyle="none")
axes.plot(*found[:9, :2].T, "C1o", markersize=5, fillstyle="none")
axes.legend(["anchors: true", "planned", "found", "poses: true", "found", "also measured"])
axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="A cable robot from above")
figure.savefig("06_cable_robot.png", dpi=120)
print("wrote 06_cable_robot.png")
