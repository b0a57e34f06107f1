"""An encoder off its axis: residuals follow the motor's angle, and a term explains them."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("5R")
poses = pincal.sample_workspace(robot, 60, seed=0)
noise = pincal.Noise(position=2e-5)
truth = pincal.disturb(robot, 5e-4, seed=1)
data = pincal.simulate(robot, truth, pincal.Plan(poses), noise, seed=1).measurements
off = data.readings.copy()
off[:, 0] += 4e-4 * np.sin(off[:, 0])  # the disc of the left encoder turns about another point
data = replace(data, readings=off)

explained = pincal.explain(robot, data, noise=noise)
print(explained)
plain = pincal.calibrate(robot, data, noise=noise)
better = pincal.calibrate(robot, data, noise=noise, terms=explained.terms)
print(f"reduced χ²: {plain.reduced_chi2:.1f} without, {better.reduced_chi2:.2f} with the term")

figure = Figure(figsize=(9, 4), layout="constrained")
panels = figure.subplots(1, 2, sharey=True)
fits = {"geometry": plain.identified, "and a term": better.identified}
for axes, (name, model) in zip(panels, fits.items(), strict=True):
    missed = pincal.inverse(model, data.poses).readings[:, 0] - data.readings[:, 0]
    axes.plot(np.degrees(data.readings[:, 0]), 1e3 * missed, "o")
    axes.set(title=name, xlabel="reading of the left motor [°]")
    axes.set_ylabel("predicted less read [mrad]")
figure.savefig("18_no_geometry.png", dpi=120)
