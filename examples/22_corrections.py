"""What a controller lacks that knows geometry alone: which poses to command instead."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("5R")
wave = pincal.Harmonic(order=1, phase="sine")
legs = tuple(
    replace(
        leg,
        sensors=tuple(replace(one, terms=(pincal.Term("sine", wave),)) for one in leg.sensors),
        parameters=(*leg.parameters, ("sine", 2e-3 * (1 - 2 * place))),
    )
    for place, leg in enumerate(robot.legs)
)
machine = replace(robot, legs=legs)  # both encoders sit off their axes
poses = pincal.sample_workspace(machine, 300, seed=1)
readings = pincal.inverse(machine, poses).readings  # that take it there, terms included
commands = pincal.forward(robot, readings, poses).poses  # where the controller believes it
shift = 1e3 * (commands - poses)
print(f"commands are moved by {np.linalg.norm(shift, axis=1).mean():.2f} mm on average")

figure = Figure(figsize=(6, 4.6), layout="constrained")
axes = figure.subplots()
arrows = axes.quiver(*poses.T, *shift.T, np.linalg.norm(shift, axis=1), angles="xy")
figure.colorbar(arrows, ax=axes, label="command moved by [mm]")
axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]", title="5R, encoders off their axes")
figure.savefig("22_corrections.png", dpi=120)
