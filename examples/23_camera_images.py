"""Two cameras see three marks of a platform: residuals as arrows over their images.

Where the cameras stand and their focal lengths are unknown; a mark that was mistaken stands out.
"""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

MARKS = {"a": (0.1, 0.0, 0.0), "b": (-0.1, 0.1, 0.0), "c": (-0.05, -0.12, 0.03)}  # on the platform
marks = pincal.Markers(MARKS, "marks", known=True)
lenses = [pincal.Lens((1600, 1200), focal=1506.0, name=name) for name in ("wide", "long")]
front = pincal.Camera("front", lenses[0], marks, at=(0.02, -2.53, 1.81), towards=(0.0, 0.0, 1.8))
side = pincal.Camera("side", lenses[1], marks, at=(2.52, -0.03, 1.81), towards=(0.0, 0.0, 1.8))

robot = pincal.load_mechanism("6UPS")
truth, draw = pincal.disturb(robot, 2e-4, seed=1), np.random.default_rng(0)
plan = pincal.Plan(robot.platform.home + 0.4 * draw.uniform(-1.0, 1.0, (50, 6)))
true_setup, noise = pincal.Setup(instruments=(front, side)), pincal.Noise(0.0, 0.0, pixel=0.2)
data = pincal.simulate(robot, truth, plan, noise, setup=true_setup).measurements
mistaken = data.extra["side_b_u"] + 3.0 * (np.arange(len(data)) == 8)  # something that looked alike
data = replace(data, extra={**data.extra, "side_b_u": mistaken})
# What is known: the marks, and lenses roughly; not where cameras stand.
rough = {"focal": 1500.0, "unknown": {"fx": 50.0, "fy": 50.0}}
cameras = [
    pincal.Camera("front", pincal.Lens((1600, 1200), name="wide", **rough), marks),
    pincal.Camera("side", pincal.Lens((1600, 1200), name="long", **rough), marks),
]
result = pincal.calibrate(robot, data, noise=noise, setup=pincal.Setup(instruments=cameras))
print(f"focal length: {result['wide.fx'].text}, true 1506 px")
print(result.tables()[3])
result.plot.images((figure := Figure(figsize=(9, 3.5), layout="compressed")).subplots())
figure.savefig("23_camera_images.png", dpi=120)
