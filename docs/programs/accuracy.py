"""Errors of forty calibrated machines beside what was promised."""

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("5R")
candidates = pincal.sample_workspace(robot, 400, seed=0)
plan = pincal.Plan(candidates[:20])
noise = pincal.Noise(position=1e-4)
promised, true = [], []
for seed in range(40):
    truth = pincal.disturb(robot, 1e-3, seed=seed)
    data = pincal.simulate(robot, truth, plan, noise, seed=seed).measurements
    result = pincal.calibrate(robot, data, noise=noise)
    promised.append(1e3 * result.expected_error(candidates).position)
    true.append(1e3 * pincal.accuracy(result.identified, truth, candidates).position)
figure = Figure(figsize=(6, 3.6), layout="constrained")
axes = figure.subplots()
axes.hist(true, bins=12, label="true errors")
axes.axvline(np.sqrt(np.mean(np.square(promised))), color="k", label="promised, root mean square")
axes.set(xlabel="platform error [mm]", ylabel="machines")
axes.legend()
figure.savefig("concept_promises.png", dpi=90)
print(f"promised {np.sqrt(np.mean(np.square(promised))):.3f} mm (root mean square of all)")
print(f"true     {np.sqrt(np.mean(np.square(true))):.3f} mm")
