"""Where a hexapod reaches every tilt up to 20 degrees, from a sixth of the work."""

import numpy as np

import pincal
from pincal.show.workspace_plots import workspace_figure

mechanism = pincal.load_mechanism("6UPS")
grid = pincal.Grid.of("radius=0.02:1.6:0.04", "bearing [deg]=0:360:3", "z=1.4:2.6:0.15")
tilts = pincal.Orientations.of(mechanism.platform, ["tilt [deg]=0:20:5", "torsion [deg]=-10,0,10"])
workspace = pincal.compute_workspace(
    mechanism, "total-orientation", grid, tilts, pincal.Margins.none()
)
print(f"{workspace.measure:.2f} m³, within {workspace.uncertainty:.2f} m³")
print(f"{workspace.computed} of {grid.size} positions computed, the others follow by symmetry:")
print(", ".join(str(element) for element in workspace.elements))

ball = pincal.largest_inscribed(workspace)
print(f"largest ball inside: radius {ball.radius:.3f} m, centre {np.abs(ball.centre.round(3))} m")
workspace_figure(workspace, ball).savefig("workspace_of_a_hexapod.png", dpi=80)
