"""Load a mechanism, ask it where its joints are, and draw it."""

from matplotlib.figure import Figure

import pincal

mechanism = pincal.load_mechanism("3RRR")
for leg in mechanism.legs:
    values = ", ".join(f"{name} = {value:.4g} {leg.units[name]}" for name, value in leg.parameters)
    print(f"{leg.name}: {values}")

poses = [[0.0, 0.0, 0.0], [0.1, -0.05, 0.2], [2.0, 0.0, 0.0]]  # x [m], y [m], phi [rad]
solution = pincal.inverse(mechanism, poses)
for row, readings in enumerate(solution.readings):
    print(poses[row], "->", readings.round(6), solution.reason(row))

back = pincal.forward(mechanism, solution.readings[:2])
print("forward kinematics from home:", back.poses.round(12).tolist())

margins = pincal.margins(mechanism, poses[:2])
print("distance from type-1 singularities, by leg:", margins.type1.round(3).tolist())
print("distance from type-2 singularities:", margins.type2.round(3).tolist())
print("symmetry:", pincal.symmetry_group(mechanism))

figure = Figure(figsize=(10, 5), layout="constrained")
for axes, pose in zip(figure.subplots(1, 2), poses[:2], strict=True):
    pincal.picture(mechanism, [pose]).draw(axes).set_title(f"pose {pose}")
figure.savefig("01_mechanism.png", dpi=120)
print("wrote 01_mechanism.png")
