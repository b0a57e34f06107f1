"""Calibrate a delta printer by touching its bed, and write the parameters for Klipper."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

printer = pincal.load_mechanism("linear_delta")
noise = pincal.Noise(position=2e-5)  # of a probed height [m]

# A printer as it was built: towers, rods and endstops are not quite where the drawing has them.
rng = np.random.default_rng(3)
sigma = [3e-4, 2e-3, 1e-4, 5e-4]  # of radius [m], angle [rad], arm [m], endstop [m]
truth = printer.with_parameters(
    {leg.name: leg.nominal + sigma * rng.standard_normal(4) for leg in printer.legs}
)


def disc(count: int, radius: float = 0.12) -> np.ndarray:
    """Return points spread evenly over the bed, shape (count, 3)."""
    k = np.arange(count)
    r, turn = radius * np.sqrt(k / (count - 1)), np.pi * (3 - np.sqrt(5)) * k
    return np.column_stack((r * np.cos(turn), r * np.sin(turn), np.zeros(count)))


data = pincal.simulate(printer, truth, pincal.Plan(disc(41)), noise, seed=1).measurements
heights = data.poses * [np.nan, np.nan, 1.0]  # a probe tells the height alone
data = replace(data, poses=heights)

forecast = pincal.forecast(printer, disc(41), noise, measured=["z"])
print(f"by heights alone the radius within {1e3 * forecast.std[0]:.2f} mm")

# So rods were measured with calipers, to 0.1 mm.
result = pincal.calibrate(printer, data, noise=noise, tied=["radius"], priors={"arm": 1e-4})
print(result)
result.save("07_result", force=True)
export = ["export", "07_result", "-o", "calibrated.cfg", "--force", "--quiet"]
subprocess.run([sys.executable, "-m", "pincal", *export], check=True)

bed = disc(2000)
figure = Figure(figsize=(9, 4), layout="constrained")
models = {"nominal": printer, "calibrated": result.identified}
for axes, (name, model) in zip(figure.subplots(1, 2), models.items(), strict=True):
    reached = pincal.forward(truth, pincal.inverse(model, bed).readings, bed).poses
    off = 1e3 * reached[:, 2]
    print(f"{name}: nozzle over the bed off by {np.sqrt((off**2).mean()):.3f} mm rms")
    most = np.abs(off).max()
    shown = axes.scatter(*1e3 * bed[:, :2].T, c=off, s=12, cmap="PuOr", vmin=-most, vmax=most)
    axes.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title=name)
    figure.colorbar(shown, ax=axes, label="height over the bed [mm]")
figure.savefig("07_delta_printer.png", dpi=120)
print("wrote calibrated.cfg and 07_delta_printer.png")
