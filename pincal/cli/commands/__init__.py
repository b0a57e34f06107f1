"""The commands, a module for each that belong together, in the order in which help lists them."""

from importlib import import_module

for module in (
    "mechanisms",
    "new",
    "view",
    "kinematics",
    "workspace",
    "selection",
    "simulation",
    "identifiability",
    "calibration",
    "doctor",
    "explain",
    "importing",
    "plot",
    "exporting",
    "demo",
):
    import_module(f"{__name__}.{module}")
