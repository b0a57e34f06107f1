"""Plan, measure and calibrate a serial arm: a UR10, from its URDF as it is."""

from importlib.metadata import files

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import pincal

# Any URDF will do; this one comes with the package example-robot-data.
urdf = next(str(f.locate()) for f in files("example-robot-data") if f.name == "ur10_robot.urdf")
arm = pincal.Mechanism.from_urdf(urdf, tip="ee_link", base="base_link")

# A reflector on the flange, seen by a tracker at an unknown place: positions only.
offset, noise = (0.05, 0.1, 0.02), pincal.Noise(position=5e-5)  # [m]
setup = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(offset)})


def reflector(model: pincal.Mechanism, readings: np.ndarray) -> np.ndarray:
    """Return where the reflector is in the base frame, shape (N, 3)."""
    poses = model.platform.transforms(pincal.forward(model, readings).poses)
    return poses.apply(np.array(offset))


offered = pincal.sample_configurations(arm, 1000, seed=0)
free = pincal.free_of_collision(urdf, arm.reading_names, offered.readings)
offered = pincal.Plan(offered.poses[free], readings=offered.readings[free])
choice = pincal.select_configurations(
    arm, offered, 40, noise=noise, measured=["x", "y", "z"], setup=setup, starts=5
)
print(f"{free.sum()} of {len(free)} configurations are free of collisions; 40 were chosen,")
print(f"{choice.efficiency:.2f} of what is possible, rank {choice.rank.rank}")

truth = pincal.disturb(arm, 1e-3, seed=1)  # an arm whose errors nobody knows
tracker, readings = Rotation.from_euler("z", 2.0), choice.plan.readings
poses = np.full((40, 6), np.nan)
poses[:, :3] = np.add(tracker.apply(reflector(truth, readings)), [2.0, 1.0, 0.5])
poses[:, :3] += 5e-5 * np.random.default_rng(2).standard_normal((40, 3))
data = pincal.Measurements(poses, readings=readings)

result = pincal.calibrate(arm, data, noise=noise, setup=setup)
print(f"{result.message}; reduced χ² {result.reduced_chi2:.2f}")
print(*(f"- {one.code}" for one in result.gauge), sep="\n")

axes = (figure := Figure(figsize=(7, 4), layout="constrained")).subplots()
for name, model in {"nominal": arm, "calibrated": result.identified}.items():
    a, b = (reflector(one, offered.readings) for one in (model, truth))
    turn, _ = Rotation.align_vectors(b - b.mean(axis=0), a - a.mean(axis=0))
    off = 1e3 * np.linalg.norm(turn.apply(a - a.mean(axis=0)) - (b - b.mean(axis=0)), axis=1)
    print(f"{name}: reflector off by {np.sqrt((off**2).mean()):.3f} mm rms, frames aligned")
    axes.hist(off, bins=np.geomspace(1e-3, 20, 60), alpha=0.7, label=name)
axes.set(xscale="log", xlabel="error of the reflector [mm]", ylabel="configurations")
axes.legend()
figure.savefig("08_serial_arm.png", dpi=120)
print("wrote 08_serial_arm.png")
