"""Two cameras see three marks of a platform: residuals as arrows over their images.

Where the cameras stand and their focal lengths are unknown; a mark that was mistaken stands out.
"""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

MARKS = np.array([[0.1, 0.0, 0.0], [-0.1, 0.1, 0.0], [-0.05, -0.12, 0.03]])  # on the platform


class Camera:
    """A pinhole: R points right, down and ahead; columns are right and down over 1500 px."""

    def __init__(self, name, at, R):
        """Say its columns, its unknowns and what its columns are in its image."""
        pairs = {mark: (f"{name}_{mark}_u", f"{name}_{mark}_v") for mark in "abc"}
        unknowns = zip("xyzf", ("m", "m", "m", "1"), (*at, 1.0), strict=True)
        self.name, self.R = name, np.array(R, dtype=float)
        self.columns = {column: "rad" for pair in pairs.values() for column in pair}
        self.parameters = tuple(pincal.Parameter(name, n, unit, v) for n, unit, v in unknowns)
        self.image = pincal.Image((1600, 1200), pairs, scale=1500.0)

    def evaluate(self, poses, values, measured):
        """Return predicted less measured, by the platform's twist, by place and focal length."""
        arms = MARKS @ poses[:, :3, :3].transpose(0, 2, 1)  # (N, marks, 3)
        p = (arms + poses[:, None, :3, 3] - values[:3]) @ self.R.T
        uv = p[..., :2] / p[..., 2:]
        by_point = (self.R[:2] - uv[..., None] * self.R[2]) * values[3] / p[..., 2, None, None]
        uv, by_point = uv.reshape(len(poses), -1), by_point.reshape(len(poses), -1, 3)
        by_turn = np.cross(np.repeat(arms, 2, axis=1), by_point)
        by_own = np.concatenate((-by_point, uv[..., None]), axis=2)
        by_twist = np.concatenate((by_point, by_turn), axis=2)
        return values[3] * uv - measured, by_twist, by_own


robot = pincal.load_mechanism("6UPS")
front = Camera("front", (0.0, -2.5, 1.8), [[1, 0, 0], [0, 0, -1], [0, 1, 0]])
side = Camera("side", (2.5, 0.0, 1.8), [[0, 1, 0], [0, 0, -1], [-1, 0, 0]])
truth, draw = pincal.disturb(robot, 2e-4, seed=1), np.random.default_rng(0)
plan = pincal.Plan(robot.platform.home + 0.4 * draw.uniform(-1.0, 1.0, (50, 6)))
data, extra = pincal.simulate(robot, truth, plan, pincal.Noise(0.0, 0.0)).measurements, {}
for one in (front, side):
    values = np.add([p.nominal for p in one.parameters], (0.02, -0.03, 0.01, 0.004))
    poses = robot.platform.transforms(data.poses).as_matrix()
    seen = one.evaluate(poses, values, 0.2 / 1500 * draw.standard_normal((50, 6)))[0]
    extra |= dict(zip(one.columns, seen.T, strict=True))
extra["side_b_u"][8] += 3.0 / 1500  # something else that looked like it
sigma = {column: np.full(50, 0.2 / 1500) for column in extra}
data = replace(data, poses=np.full_like(data.poses, np.nan), extra=extra, sigma_extra=sigma)
result = pincal.calibrate(robot, data, setup=pincal.Setup(instruments=(front, side)))
print(f"focal length: {1500 * result['front.f'].identified:.1f} px, true 1506 px")
result.plot.images((figure := Figure(figsize=(9, 3.5), layout="compressed")).subplots())
figure.savefig("23_camera_images.png", dpi=120)
