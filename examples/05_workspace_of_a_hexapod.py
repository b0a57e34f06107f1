"""Where a hexapod reaches every tilt up to 20 degrees, from a sixth of the work."""

from matplotlib.figure import Figure

import pincal

mechanism = pincal.load_mechanism("6UPS")
# Each value is the middle of a cell around it: radii begin half a step from the axis.
grid = pincal.Grid.of("radius=0.04:2.6:0.08", "bearing [deg]=0:360:5", "z=0:2.7:0.1")
tilts = pincal.Orientations.of(mechanism.platform, "tilt [deg]=0:20:5", "torsion [deg]=-10,0,10")
workspace = pincal.compute_workspace(
    mechanism, "total-orientation", grid, tilts, pincal.Margins.none()
)  # no margins: legs and joints alone, as in the paper
print(workspace)
print(f"{workspace.computed} of {grid.size} positions computed, the others follow by symmetry:")
print(", ".join(str(element) for element in workspace.elements))

workspace.save("workspace_of_a_hexapod.csv", force=True)

figure = Figure(figsize=(7, 6), layout="constrained")
axes = figure.add_subplot(projection="3d")
x, y, z = workspace.positions.T
half = y >= 0.0  # cut open
axes.scatter(x[half], y[half], z[half], c=z[half], s=3, alpha=0.3)
axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]", aspect="equal")
figure.savefig("workspace_of_a_hexapod.png", dpi=80)
