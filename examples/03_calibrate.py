"""Calibrate a simulated five-bar, and see what the calibration is worth."""

from matplotlib.figure import Figure

import pincal
from pincal.show.plots import draw_changes

mechanism = pincal.load_mechanism("5R")
noise = pincal.Noise(position=1e-4, reading=2e-5)  # [m], [rad]
candidates = pincal.sample_workspace(mechanism, 20_000, seed=0)
plan = pincal.select_poses(mechanism, candidates, 18, noise=noise).plan

# A machine with errors that pincal does not know; with a real one, read the measurements:
# data = pincal.read_measurements("measurements.csv", mechanism)
truth = pincal.disturb(mechanism, 2e-3, seed=1)
data = pincal.simulate(mechanism, truth, plan, noise, seed=1).measurements

result = pincal.calibrate(mechanism, data, noise=noise)
print(result)

before = pincal.accuracy(mechanism, truth, candidates)
after = pincal.accuracy(result.identified, truth, candidates)
print(f"platform error {1e3 * before.position:.3f} mm before, {1e3 * after.position:.3f} mm after")

result.save("03_result", force=True)
calibrated = pincal.load_mechanism("03_result/mechanism")
print("calibrated mechanism saved and loaded alike:", calibrated == result.identified)

figure = Figure(figsize=(7, 4), layout="constrained")
draw_changes(figure.subplots(), result).set_title("5R: what the calibration changed")
figure.savefig("03_changes.png", dpi=120)
print("wrote 03_result and 03_changes.png")
