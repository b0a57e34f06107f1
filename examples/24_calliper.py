"""A calliper is enough: a five-bar plots 20 marks, and the distances between them calibrate it.

No pose is measured. Where the paper lies does not matter, so the base frame stays free.
"""

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("5R")
truth = pincal.disturb(robot, 1e-3, seed=1)
noise = pincal.Noise(position=5e-5)  # of each distance, the plotted dots included
marks = pincal.Plan(pincal.sample_workspace(robot, 20, seed=0))
rows = [str(1 + row) for row in range(len(marks))]
axes = (figure := Figure(figsize=(7, 4), layout="constrained")).subplots()
for per_mark in (2, 4, 9):
    to = {f"distance_{k + 1}_to": np.roll(rows, -1 - k).tolist() for k in range(per_mark)}
    plan = pincal.Plan(marks.poses, contacts={"row": rows, **to})
    data = pincal.simulate(robot, truth, plan, noise, seed=2).measurements
    result = pincal.calibrate(robot, data, noise=noise)
    error = result.expected_error(pincal.sample_workspace(robot, 500, seed=3))
    print(f"{20 * per_mark} distances: platform to {1e3 * error.position:.3f} mm, shape only")
    lengths = np.sort([1e3 * p.std for p in result.parameters if p.unit == "m"])
    axes.plot(lengths, label=f"{20 * per_mark} distances")
print("free:", ", ".join(free.code for free in result.gauge))
axes.set(xlabel="lengths, sorted", ylabel="standard error [mm]", title="5R, calliper to 0.05 mm")
axes.legend()
figure.savefig("24_calliper.png", dpi=120)
print("wrote 24_calliper.png")
