"""How accurate will it be? Ask before anything is measured, for several numbers of poses."""

from matplotlib.figure import Figure

import pincal

robot = pincal.load_mechanism("3RRR")
candidates = pincal.sample_workspace(robot, 5000, seed=0)
noise = pincal.Noise(position=1e-4, orientation=1e-4)  # [m], [rad]

counts, chosen, random = (9, 12, 18, 24, 36), [], []
for count in counts:
    selection = pincal.select_poses(robot, candidates, count)
    for plan, found in ((selection.plan, chosen), (candidates[: 3 * count], random)):
        forecast = pincal.forecast(robot, plan, noise)
        found.append(1e3 * forecast.platform_error(candidates[:500]).position)
    print(f"{3 * count} poses: {chosen[-1]:.3f} mm chosen, {random[-1]:.3f} mm at random")

figure = Figure(figsize=(7, 4), layout="constrained")
axes = figure.subplots()
axes.plot([3 * n for n in counts], random, "o-", label="at random")
axes.plot([3 * n for n in counts], chosen, "o-", label="chosen")
axes.set(xlabel="poses", ylabel="platform error to expect [mm]", ylim=(0, None))
axes.set_title("3-RRR, poses good to 0.1 mm and 0.1 mrad")
axes.legend()
figure.savefig("13_forecast.png", dpi=120)
print("wrote 13_forecast.png")
