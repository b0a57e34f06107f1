"""A laser tracker is better along its beam than across it: say so, and gain accuracy."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("6UPS")
truth = pincal.disturb(robot, 2e-4, seed=1)
rng = np.random.default_rng(0)
spread = np.repeat([0.1, 0.25], 3)
plan = pincal.Plan(robot.platform.home + spread * rng.uniform(-1.0, 1.0, (50, 6)))
exact = pincal.simulate(robot, truth, plan, pincal.Noise(0.0, 0.0)).measurements

# It stands six metres away: 5 µm along the beam, 60 µm across it.
tracker = pincal.Tracker(at=(6.0, 0.0, 0.5), range=5e-6, azimuth=1e-5, elevation=1e-5)
away = exact.poses[:, :3] - np.array(tracker.at)
distance = np.linalg.norm(away, axis=1, keepdims=True)
along = away / distance
noise = 1e-5 * distance * rng.standard_normal(away.shape)
noise += (
    5e-6 * rng.standard_normal((len(away), 1)) - (noise * along).sum(1, keepdims=True)
) * along
seen = exact.poses.copy()
seen[:, :3] += noise
seen[:, 3:] += 2e-5 * rng.standard_normal(away.shape)
data = replace(exact, poses=seen)

same = pincal.Noise(position=6e-5, orientation=2e-5)
fits = {
    "alike in all directions": pincal.calibrate(robot, data, noise=same),
    "as the tracker measures": pincal.calibrate(
        robot, data, noise=same, setup=pincal.Setup(tracker=tracker)
    ),
}
axes = (figure := Figure(figsize=(7, 4), layout="constrained")).subplots()
there = robot.platform.home + spread * rng.uniform(-1.0, 1.0, (300, 6))
for name, fit in fits.items():
    true = pincal.accuracy(fit.identified, truth, there)
    print(f"{name}: platform off by {1e6 * true.position:.1f} µm")
    axes.plot(np.sort([1e6 * p.std for p in fit.parameters if p.unit == "m"]), label=name)
axes.set(xlabel="lengths, sorted", ylabel="standard error [µm]", title="6UPS, 50 poses")
axes.legend()
figure.savefig("14_tracker_beam.png", dpi=120)
