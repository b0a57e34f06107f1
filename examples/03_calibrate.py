"""Calibrate a simulated five-bar, and see what the calibration is worth."""

from matplotlib.figure import Figure

import pincal

mechanism = pincal.load_mechanism("5R")
noise = pincal.Noise(position=1e-4, reading=2e-5)  # [m], [rad]
candidates = pincal.sample_workspace(mechanism, 20_000, seed=0)
plan = pincal.select_poses(mechanism, candidates, 18, noise=noise).plan

# A machine with errors that pincal does not know; with a real one, read the measurements:
# data = pincal.Measurements.from_csv("measurements.csv", mechanism)
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
axes = figure.subplots()
for leg, marker in zip(result.legs, "o^", strict=True):
    change = [1e3 * (p.identified - p.nominal) for p in leg.parameters]
    half = [1e3 * (p.high - p.low) / 2 for p in leg.parameters]
    names = [f"{p.name}\n[10⁻³ {p.unit}]" for p in leg.parameters]
    axes.errorbar(names, change, half, fmt=marker, capsize=4, label=leg.name)
axes.axhline(0.0, color="0.5", lw=0.8)
axes.set(ylabel="identified − nominal, ± 95 %", title="5R: what the calibration changed")
axes.legend()
figure.savefig("03_changes.png", dpi=120)
print("wrote 03_result and 03_changes.png")
