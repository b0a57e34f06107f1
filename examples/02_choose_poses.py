"""Choose the poses to measure: by symmetry, and by orbits in which each pose serves every leg."""

import numpy as np
from matplotlib.figure import Figure

import pincal

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
selection.plan.to_csv("02_plan.csv", mechanism, force=True)

figure = Figure(figsize=(15, 5.0), layout="constrained")
left, middle, right = figure.subplots(1, 3)
pincal.picture(mechanism).draw(left).set_title("3-RRR at home")
middle.plot(*candidates[:, :2].T, ",", color="0.8")
plan, names = selection.plan, mechanism.legs[0].parameter_names
for index, (leg, marker, hatch) in enumerate(
    zip(selection.legs, "o^s", ("", "//", ".."), strict=True)
):
    colour = ("#0072B2", "#D55E00", "#009E73")[index]
    own = plan.poses[[chosen == leg.leg for chosen in plan.sets]]
    middle.plot(*own[:, :2].T, marker, color=colour, ms=4, label=leg.leg)
    middle.quiver(*own[:, :2].T, np.cos(own[:, 2]), np.sin(own[:, 2]), color=colour, width=2e-3)
    places = np.arange(len(names)) + 0.27 * (index - 1)
    right.bar(places, leg.r_diagonal, 0.27, color=colour, hatch=hatch, ec="white", label=leg.leg)
middle.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
middle.set_title("24 poses for leg 1, carried to legs 2 and 3")
middle.legend()
right.set_xticks(range(len(names)), names)
right.set(ylabel="observability |R_ii| [rad/unit]", title="observability is symmetric")
right.legend()
figure.savefig("02_poses.png", dpi=120)
print("wrote 02_plan.csv and 02_poses.png")
