"""Kinematic calibration of parallel robots, on Pinocchio.

Which poses to measure, what the kinematic parameters are, and how sure that is. The names are in
``__init__.pyi``; each is imported when it is first used.
"""

from lazy_loader import attach_stub

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
