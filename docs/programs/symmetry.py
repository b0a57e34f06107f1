"""Poses of one leg, mapped to the others."""

from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("3RRR")
group = pincal.symmetry_group(robot)
print(group)
candidates = pincal.sample_workspace(robot, 6000, seed=0)
selection = pincal.select_poses(robot, candidates, 12)
figure = Figure(figsize=(5, 4.6), layout="constrained")
axes = figure.subplots()
axes.plot(*candidates[:, :2].T, ",", color="0.8")
poses, sets = selection.plan.poses, selection.plan.sets
for name in dict.fromkeys(sets):
    axes.plot(*poses[[one == name for one in sets], :2].T, "o", label=name)
axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
axes.legend()
figure.savefig("concept_symmetry.png", dpi=90)
