"""Compares what was found of the cable robot with the truth."""

import numpy as np

import pincal

truth, result = pincal.load_mechanism("truth"), pincal.load_result("result")
for leg, true in zip(result.identified.legs, truth.legs, strict=True):
    off = 1e3 * np.linalg.norm(leg.nominal[:3] - true.nominal[:3])
    print(f"{leg.name}: anchor {off:.1f} mm from the truth")
off = np.linalg.norm(result.estimated_poses - np.loadtxt("true.txt"), axis=1)
print(f"poses that nobody measured: {1e3 * np.median(off[9:]):.1f} mm off (median)")
