"""Platform error to expect, of poses at random and of chosen ones."""

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("5R")
candidates = pincal.sample_workspace(robot, 4000, seed=0)
chosen = pincal.select_poses(robot, candidates, 12)
noise = pincal.Noise(position=1e-4)
counts, random = range(8, 41, 4), []
for count in counts:
    plan = candidates[np.random.default_rng(count).choice(len(candidates), count, replace=False)]
    random.append(
        1e3 * pincal.forecast(robot, plan, noise).platform_error(candidates[:300]).position
    )
best = 1e3 * pincal.forecast(robot, chosen.plan, noise).platform_error(candidates[:300]).position
figure = Figure(figsize=(7, 3.6), layout="constrained")
axes = figure.subplots()
axes.plot(counts, random, "o-", label="poses at random")
axes.plot(len(chosen.plan.poses), best, "r*", ms=14, label="chosen")
axes.set(xlabel="poses", ylabel="platform error to expect [mm]", ylim=(0, None))
axes.legend()
figure.savefig("concept_observability.png", dpi=90)
print(f"{len(chosen.plan.poses)} chosen poses: {best:.3f} mm; 40 at random: {random[-1]:.3f} mm")
