"""Kinematic calibration of parallel robots, on Pinocchio."""

from pincal.errors import PincalError
from pincal.model.files import bundled, load_mechanism
from pincal.model.leg import Joint, Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Placement, along, cartesian, placed, polar, spherical
from pincal.model.platform import Platform
from pincal.model.sensor import Sensor
from pincal.symmetry.detect import SymmetryGroup, symmetry_group
from pincal.symmetry.elements import Element, mirror, rotations
from pincal.symmetry.generate import generate
