"""Old name of ``batches``, for its turns."""

from pincal.kinematics.batches import inverse_left_jacobian as inverse_left_jacobian
from pincal.kinematics.batches import turn_between as turn_between
