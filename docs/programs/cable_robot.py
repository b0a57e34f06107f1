"""Four cables: 45 poses, of which a camera saw nine."""

from dataclasses import replace
from pathlib import Path

import numpy as np

import pincal

robot = pincal.load_mechanism("4cable")
rng = np.random.default_rng(0)
truth = robot.with_parameters(
    {leg.name: leg.nominal + np.append(0.05 * rng.standard_normal(3), -0.01) for leg in robot.legs}
)
plan = pincal.Plan(rng.uniform([-0.7, -0.7, -0.05], [0.7, 0.7, 1.6], (45, 3)))
noise = pincal.Noise(position=1e-3, reading=5e-4)
data = pincal.simulate(robot, truth, plan, noise, seed=1).measurements
poses = data.poses.copy()
poses[9:] = np.nan
replace(data, poses=poses).to_csv("lines.csv", robot)
truth.save("truth")
np.savetxt("true.txt", plan.poses)
table = Path("lines.csv").read_text().splitlines()
print(table[0], *table[9:11], sep="\n")
