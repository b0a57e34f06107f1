"""The poses of base.csv as a tracker sees them that stands 2 m away, turned."""

from dataclasses import replace

from scipy.spatial.transform import RigidTransform, Rotation

import pincal

hexapod = pincal.load_mechanism("hexapod")
data = pincal.Measurements.from_csv("base.csv", hexapod)
T_tracker_base = RigidTransform.from_components([2.0, -1.0, 0.4], Rotation.from_rotvec([0.1, 0, 2]))
seen = T_tracker_base * hexapod.platform.transforms(data.poses)
poses = hexapod.platform.from_matrices(seen.as_matrix())
replace(data, poses=poses).to_csv("tracker.csv", hexapod)
print(f"first row: x {poses[0, 0]:.3f} m, y {poses[0, 1]:.3f} m in the tracker's frame")
