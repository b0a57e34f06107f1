"""Define a mechanism in Python: a planar 4-RRR, one leg carried by four rotations."""

from math import pi

from matplotlib.figure import Figure

import pincal
from pincal import Joint, along, placed, polar
from pincal.show.plots import draw_mechanism

# Nominal parameters of leg 1: lengths in m, angles in rad.
parameters = {
    "l": 0.30,
    "L": 0.35,
    "OA": 0.60,
    "beta": -3 * pi / 4,
    "ob": 0.10,
    "beta_b": -3 * pi / 4,
    "gamma": 0.0,
}
leg = pincal.Leg(
    name="leg_1",
    joints=(  # base first; a placement says by which parameters a joint sits on its link
        Joint("shoulder", "revolute", placed(parameters, polar("OA", "beta")), home=1.3),
        Joint("elbow", "revolute", placed(parameters, along("x", "l")), home=-1.2),
        Joint("tip", "fixed", placed(parameters, along("x", "L"))),
    ),
    point=Joint("b_1", "fixed", placed(parameters, polar("ob", "beta_b"))),
    sensor=pincal.Sensor("shoulder", form="reading", gain=1.0, offset="gamma"),  # gain not sought
    parameters=tuple(parameters.items()),
)
platform = pincal.Platform("planar", home=(0.0, 0.0, 0.0))
mechanism = pincal.generate("4RRR", leg, pincal.rotations(4), platform, "An example.")
print(pincal.symmetry_group(mechanism))

mechanism.save("04_4RRR", force=True)
print("saved and loaded alike:", pincal.load_mechanism("04_4RRR") == mechanism)

candidates = pincal.sample_workspace(mechanism, 3000, least=pincal.Margins(0.2, 0.1))
selection = pincal.select_poses(mechanism, candidates, 14)
print(f"{len(selection.plan.poses)} poses, efficiency {selection.efficiency:.3f}")

figure = Figure(figsize=(5, 5), layout="constrained")
draw_mechanism(figure.subplots(), mechanism).set_title("4-RRR")
figure.savefig("04_mechanism.png", dpi=120)
print("wrote 04_4RRR and 04_mechanism.png")
