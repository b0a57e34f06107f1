"""Draw-wires instead of a tracker: three distances from known points calibrate a cable robot."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("4cable")
truth = pincal.disturb(robot, 5e-3, seed=3)
rng = np.random.default_rng(0)
plan = pincal.Plan(rng.uniform([-0.7, -0.7, 0.0], [0.7, 0.7, 1.4], (60, 3)))
reading = pincal.Noise(position=0.0, reading=2e-4)
data = pincal.simulate(robot, truth, plan, reading, seed=1).measurements
data = replace(data, sigma_readings=np.full(data.readings.shape, 2e-4))

points = {"wire_1": (1.5, 0.0, 0.0), "wire_2": (-1.0, 1.4, 0.1), "wire_3": (-1.0, -1.4, 2.0)}
setup = pincal.Setup(distances={name: pincal.Distance(point) for name, point in points.items()})
extra, sigma = {}, {}
for name, point in points.items():
    exact = np.linalg.norm(plan.poses - point, axis=1)
    extra[name] = exact + 3e-4 * rng.standard_normal(len(exact))
    sigma[name] = np.full(len(exact), 3e-4)
missing = np.full_like(data.poses, np.nan)  # nobody measured x, y, z

there = rng.uniform([-0.7, -0.7, 0.0], [0.7, 0.7, 1.4], (300, 3))
figure = Figure(figsize=(7, 4), layout="constrained")
axes = figure.subplots()
for wires in (list(points)[:1], list(points)[:2], list(points)):
    kept = {name: extra[name] for name in wires}
    own = replace(
        data, poses=missing, extra=kept, sigma_extra={name: sigma[name] for name in wires}
    )
    some = replace(setup, distances={name: setup.distances[name] for name in wires})
    fit = pincal.calibrate(robot, own, setup=some)
    error = pincal.accuracy(fit.identified, truth, there)
    print(f"{len(wires)} wires: platform off by {1e3 * error.position:.2f} mm")
    axes.bar(len(wires), 1e3 * error.position, color="C0")
before = pincal.accuracy(robot, truth, there)
axes.axhline(1e3 * before.position, color="k", label="before")
axes.set(xticks=[1, 2, 3], xlabel="draw-wires", ylabel="platform off by [mm]", yscale="log")
axes.legend()
figure.savefig("16_draw_wires.png", dpi=120)
