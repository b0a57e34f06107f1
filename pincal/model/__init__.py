"""Data model: mechanisms, legs, platforms, sensors and measurements; no kinematics.

Other packages import from here what many of their modules use.
"""

from pincal.model.joint import Closing, Follows, Joint
from pincal.model.leg import Leg
from pincal.model.measurements import EVERY_LEG, VERIFY, Measurements, Noise, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.parameter import Parameter, means
from pincal.model.placement import Placement, placement_of
from pincal.model.platform import WAYS, Platform, Poses
from pincal.model.relations import ORIGIN, ROW, TO
from pincal.model.sensor import Sensor
from pincal.model.setup import Setup, Target
from pincal.model.terms import LOAD, Load
