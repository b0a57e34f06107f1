"""Choose the poses to measure: by symmetry, and by orbits in which each pose serves every leg."""

from matplotlib.figure import Figure

import pincal
from pincal.show.plots import draw_mechanism, draw_observability, draw_poses

mechanism = pincal.load_mechanism("3RRR")
candidates = pincal.sample_workspace(mechanism, 30_000, seed=0)

for protocol, count in (("symmetric", 24), ("orbits", 24), ("orbits", 8)):
    selection = pincal.select_poses(mechanism, candidates, count, protocol)
    leg = selection.legs[0]
    print(
        f"{protocol:10s} {len(selection.plan.poses):3d} poses in all, {leg.poses:3d} for each leg: "
        f"efficiency {selection.efficiency:.3f} of the bound, condition {leg.condition:.0f}"
    )

selection = pincal.select_poses(mechanism, candidates, 24, "symmetric")
pincal.write_poses("02_plan.csv", mechanism, selection.plan, force=True)

figure = Figure(figsize=(15, 4.6), layout="constrained")
left, middle, right = figure.subplots(1, 3)
draw_mechanism(left, mechanism).set_title("3-RRR at home")
draw_poses(middle, mechanism, selection.plan, candidates).set_title(
    "24 poses for leg 1, carried to legs 2 and 3"
)
draw_observability(right, mechanism, selection).set_title("observability is symmetric")
figure.savefig("02_poses.png", dpi=120)
print("wrote 02_plan.csv and 02_poses.png")
