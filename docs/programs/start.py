"""How far the platform is off over the workspace, before and after the calibration."""

import numpy as np
from matplotlib.figure import Figure

import pincal

nominal, truth = pincal.load_mechanism("3RRR"), pincal.load_mechanism("truth")
result = pincal.load_result("result")
poses = pincal.sample_workspace(nominal, 800, seed=1)
figure = Figure(figsize=(9, 4), layout="constrained")
panels = figure.subplots(1, 2, sharey=True)
for axes, name, model in zip(
    panels, ("before", "after"), (nominal, result.identified), strict=True
):
    reached = pincal.forward(truth, pincal.inverse(model, poses).readings, poses).poses
    off = 1e3 * np.linalg.norm(reached[:, :2] - poses[:, :2], axis=1)
    shown = axes.scatter(*poses[:, :2].T, c=off, s=8, cmap="cividis", vmin=0.0, vmax=10.0)
    axes.set(title=f"{name}: {off.mean():.2f} mm on average", aspect="equal", xlabel="x [m]")
panels[0].set_ylabel("y [m]")
figure.colorbar(shown, ax=panels, label="off by [mm]", extend="max")
figure.savefig("start_after.png", dpi=90)
before = pincal.accuracy(nominal, truth, poses)
after = pincal.accuracy(result.identified, truth, poses)
promised = result.expected_error(poses)
print(f"true error: {1e3 * before.position:.2f} mm before, {1e3 * after.position:.3f} mm after")
print(f"promised: {1e3 * promised.position:.3f} mm")
