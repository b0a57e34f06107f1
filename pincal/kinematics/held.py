"""Old names of what ``nearest_closure`` holds."""

from pincal.kinematics.nearest_closure import arm_poses as carried
from pincal.kinematics.nearest_closure import nearest_closure as held

__all__ = ["carried", "held"]
