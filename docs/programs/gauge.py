"""Standard errors of lengths with the frame known, and unknown."""

from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("3RRR")
truth = pincal.disturb(robot, 2e-3, seed=6)
plan = pincal.Plan(pincal.sample_workspace(robot, 40, seed=1))
noise = pincal.Noise(position=1e-4, orientation=1e-4)
data = pincal.simulate(robot, truth, plan, noise, seed=1).measurements
known = pincal.calibrate(robot, data, noise=noise)
anywhere = pincal.calibrate(robot, data, noise=noise, setup=pincal.Setup(unknown_frame=True))
print(f"frame known: {len(known.gauge)} freedoms fixed; unknown: {len(anywhere.gauge)}")
figure = Figure(figsize=(7, 3.6), layout="constrained")
axes = figure.subplots()
for name, fit in {"frame known": known, "frame unknown": anywhere}.items():
    lengths = [p for p in fit.parameters if p.unit == "m" and p.owner.startswith("leg")]
    axes.plot([1e3 * p.std for p in lengths], "o-", label=name)
axes.set(xticks=range(len(lengths)), ylabel="standard error [mm]")
axes.set_xticklabels([p.id for p in lengths], rotation=70, fontsize=7)
axes.legend()
figure.savefig("concept_gauge.png", dpi=90)
