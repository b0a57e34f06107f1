"""Rods measured with a calliper, and legs of one drill jig: what is known beforehand."""

from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("3RRR")
truth = pincal.disturb(robot, 1e-3, seed=4)
poses = pincal.sample_workspace(robot, 500, seed=1)
noise = pincal.Noise(position=3e-4, orientation=3e-4)
data = pincal.simulate(robot, truth, pincal.Plan(poses[:16]), noise, seed=2).measurements

fits = {
    "nothing known": {},
    "rods to 0.1 mm": {"priors": {"l": 1e-4, "L": 1e-4}},
    "all to 1 mm and 1 mrad": {"tolerance": {"m": 1e-3, "rad": 1e-3}},
    "gains are one": {"fixed": ["k"]},
}
figure = Figure(figsize=(8, 4), layout="constrained")
axes = figure.subplots()
for name, known in fits.items():
    start = robot
    if "priors" in known:  # the calliper saw these rods, not the drawing's
        measured = {
            f"{leg.name}.{rod}": dict(leg.parameters)[rod] for leg in truth.legs for rod in "lL"
        }
        start = robot.with_parameters(measured)
    fit = pincal.calibrate(start, data, noise=noise, **known)
    true = 1e3 * pincal.accuracy(fit.identified, truth, poses).position
    promised = 1e3 * fit.expected_error(poses).position
    print(f"{name}: off by {true:.2f} mm, promised {promised:.2f} mm")
    axes.barh([name], [promised], color="C0", alpha=0.5)
    axes.plot(true, name, "ko")
axes.set(xlabel="platform error [mm]", title="3-RRR, 16 poses at 0.3 mm: bars promised, dots true")
figure.savefig("17_priors.png", dpi=120)
