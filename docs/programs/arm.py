"""How far the tool of an arm is off, before and after its calibration."""

import numpy as np

import pincal

truth, nominal = pincal.load_mechanism("truth"), pincal.load_mechanism("arm")
result = pincal.load_result("result")
joints = np.random.default_rng(1).uniform(-1.0, 1.0, (200, 6)) - [0, 1, 0, 0, 0, 0]
there = pincal.forward(truth, joints).poses
for name, model in {"nominal": nominal, "calibrated": result.identified}.items():
    off = np.linalg.norm(pincal.forward(model, joints).poses[:, :3] - there[:, :3], axis=1)
    print(f"{name}: tool off by {1e3 * np.sqrt((off**2).mean()):.3f} mm (rms)")
