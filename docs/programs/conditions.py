"""Standard errors of the same poses, used leg by leg and all together."""

from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("3RRR")
truth = pincal.disturb(robot, 1e-3, seed=2)
poses = pincal.sample_workspace(robot, 40, seed=3)
noise = pincal.Noise(position=1e-4, orientation=2e-4, reading=2e-5)
data = pincal.simulate(robot, truth, pincal.Plan(poses), noise, seed=1).measurements
fits = {
    "each leg alone": pincal.calibrate(robot, data, noise=noise, method="per-leg"),
    "all legs together": pincal.calibrate(robot, data, noise=noise),
}
figure = Figure(figsize=(7, 3.6), layout="constrained")
axes = figure.subplots()
for name, fit in fits.items():
    axes.plot([1e3 * p.std for p in fit.parameters if p.unit == "m"], "o-", label=name)
axes.set(xlabel="lengths of all legs", ylabel="standard error [mm]", ylim=(0, None))
axes.legend()
figure.savefig("concept_conditions.png", dpi=90)
for name, fit in fits.items():
    print(f"{name}: standard error of leg_1.L {1e3 * fit['leg_1.L'].std:.3f} mm")
