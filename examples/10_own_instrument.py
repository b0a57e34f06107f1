"""An instrument of one's own: a dial gauge on the platform feels a surface plate below it.

Where the plate lies is unknown. A camera sees poses to 0.1 mm; the gauge reads to 1 µm.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from matplotlib.figure import Figure

import pincal


@dataclass(frozen=True)
class DialGauge:
    """Reads the height of the platform's origin over z = height + a x + b y."""

    name: str = "plate"
    columns: ClassVar = {"gauge": "m"}  # of the table, and their units
    parameters: ClassVar = (
        pincal.Parameter("plate", "height", "m", 0.0),
        pincal.Parameter("plate", "a", "1", 0.0),
        pincal.Parameter("plate", "b", "1", 0.0),
    )

    def evaluate(self, poses, values, measured):
        """Return predicted less measured, by the platform's twist, by the parameters."""
        height, a, b = values
        x, y, z = poses[:, :3, 3].T
        by_twist = np.tile([-a, -b, 1.0, 0.0, 0.0, 0.0], (len(poses), 1, 1))
        by_own = np.column_stack((-np.ones_like(x), -x, -y))[:, None]
        return (z - height - a * x - b * y)[:, None] - measured, by_twist, by_own


robot = pincal.load_mechanism("6UPS")
truth = pincal.disturb(robot, 2e-4, seed=1)
spread, draw = np.repeat([0.07, 0.2], 3), np.random.default_rng(0)
plan = pincal.Plan(robot.platform.home + spread * draw.uniform(-1.0, 1.0, (60, 6)))
data = pincal.simulate(robot, truth, plan, pincal.Noise(0.0, 0.0)).measurements
plate, gauge = np.array([0.005, 2e-3, -1e-3]), DialGauge()
poses = robot.platform.transforms(data.poses).as_matrix()
read = gauge.evaluate(poses, plate, np.zeros((len(poses), 1)))[0][:, 0]
seen = robot.platform.moved(data.poses, 1e-4 * draw.standard_normal(data.poses.shape))
camera = replace(data, poses=seen, sigma_poses=np.full(seen.shape, 1e-4))
noisy, sigma = read + 1e-6 * draw.standard_normal(len(read)), np.full(len(read), 1e-6)
both = replace(camera, extra={"gauge": noisy}, sigma_extra={"gauge": sigma})
without = pincal.calibrate(robot, camera)
result = pincal.calibrate(robot, both, setup=pincal.Setup(instruments=(gauge,)))
for one, value in zip(result.external, plate, strict=True):
    print(f"{one.id}: {one.identified:.5f} ± {one.std:.5f}, true {value:.5f}")
axes = (figure := Figure(figsize=(7, 4), layout="constrained")).subplots()
for fit, label in ((without, "camera alone"), (result, "camera and dial gauge")):
    stds = np.sort([1e6 * p.std for p in fit.parameters if p.unit == "m" and "leg" in p.owner])
    axes.plot(stds, label=label)
axes.set(xlabel="lengths, sorted", ylabel="standard error [µm]", title="6UPS, 60 poses")
axes.legend()
figure.savefig("10_own_instrument.png", dpi=120)
print("wrote 10_own_instrument.png")
