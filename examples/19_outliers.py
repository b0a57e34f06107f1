"""Three rows are wrong: they are named, and do no harm."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("3RRR")
poses = pincal.sample_workspace(robot, 400, seed=2)
noise = pincal.Noise(position=1e-4, orientation=1e-4)
truth = pincal.disturb(robot, 1e-3, seed=3)
data = pincal.simulate(robot, truth, pincal.Plan(poses[:40]), noise, seed=1).measurements
wrong = data.poses.copy()
wrong[[4, 17, 31], 0] += [3e-3, -2e-3, 4e-3]  # a marker that was touched, a typing error
data = replace(data, poses=wrong)

figure = Figure(figsize=(6, 4), layout="constrained")
axes = figure.subplots()
for place, loss in enumerate(("none", "reject")):
    fit = pincal.calibrate(robot, data, noise=noise, loss=loss, rough=True)
    error = 1e3 * pincal.accuracy(fit.identified, truth, poses).position
    named = sorted({one.row + 1 for one in fit.outliers})
    print(f"loss {loss}: off by {error:.2f} mm, outliers named: {named}")
    axes.bar(place, error, color="C0")
axes.set_xticks(range(2), ["none", "reject"])
axes.set(ylabel="platform off by [mm]", title="3 wrong rows of 40")
figure.savefig("19_outliers.png", dpi=120)
print("rows that are wrong:", np.array([4, 17, 31]) + 1)
