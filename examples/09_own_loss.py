"""A loss of one's own: the Welsch loss, by which a row counts exp(-u²), u the root of its χ²."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal


def welsch(u):
    """Return the weight of rows by the root of their χ² over the tuning constant."""
    return np.exp(-(u**2))


# Tuned as is usual: of one good residual, 2.985 standard deviations (95 % efficiency).
own = pincal.Loss("welsch", welsch, probability=0.99716)

robot = pincal.load_mechanism("3RRR")
truth = pincal.disturb(robot, 1e-3, seed=1)
noise = pincal.Noise(position=5e-5, orientation=2e-4, reading=5e-5)
draw = np.random.default_rng(0)
spread = np.array([0.06, 0.06, 0.3])
plan = pincal.Plan(robot.platform.home + spread * draw.uniform(-1.0, 1.0, (60, 3)))
data = pincal.simulate(robot, truth, plan, noise, seed=2).measurements
poses = data.poses.copy()
poses[::6, 0] += 3e-3  # at each sixth pose the camera saw something else
data = replace(data, poses=poses)

axes = (figure := Figure(figsize=(7, 4), layout="constrained")).subplots()
for place, loss in enumerate(("none", "huber", own)):
    result = pincal.calibrate(robot, data, noise=noise, loss=loss)
    error = pincal.accuracy(result.identified, truth, plan.poses)
    name = loss if isinstance(loss, str) else loss.name
    print(f"{name}: {1e6 * error.position:.1f} µm, {len(result.outliers)} outliers")
    axes.bar(place, 1e6 * error.position)
axes.set_xticks(range(3), ["none", "huber", "welsch"])
axes.set(ylabel="error of the platform [µm]", title="3-RRR, one row in six is wrong")
figure.savefig("09_own_loss.png", dpi=120)
print("wrote 09_own_loss.png")
