"""A result is kept: saved, loaded, asked again, compared with a second run, and drawn."""

from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("5R")
poses = pincal.sample_workspace(robot, 60, seed=1)
noise = pincal.Noise(position=5e-5)
truth = pincal.disturb(robot, 5e-4, seed=2)
runs = []
for seed in (1, 2):
    data = pincal.simulate(robot, truth, pincal.Plan(poses[:24]), noise, seed=seed).measurements
    result = pincal.calibrate(robot, data, pincal.Options(noise=noise))
    result.save(f"run_{seed}", force=True)
    runs.append(pincal.load_result(f"run_{seed}"))

first, second = runs
print(first)
held_out = second.validated(folds=5).validation
print(f"held-out rows miss by {held_out.held_out:.2f} σ")

names = [one.id for one in first.parameters]
change = [
    (first[name].identified - second[name].identified) / (2**0.5 * first[name].std)
    for name in names
]
figure = Figure(figsize=(8, 4), layout="constrained")
axes = figure.subplots()
axes.bar(names, change)
axes.axhspan(-2, 2, color="0.9", zorder=0)
axes.set(ylabel="difference of two runs / standard error", title="Two runs of one machine agree")
axes.tick_params(axis="x", rotation=70)
figure.savefig("21_two_runs.png", dpi=120)
