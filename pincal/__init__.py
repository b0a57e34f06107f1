"""Kinematic calibration of parallel robots, on Pinocchio.

It selects poses to measure, identifies the kinematic parameters, and states their uncertainties.
The public names are in ``__init__.pyi``; each is imported at its first use.
"""

from lazy_loader import attach_stub

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
