"""Define a mechanism in Python: a planar 3-RPR, one leg carried by three rotations."""

from math import atan2, hypot, pi

from matplotlib.figure import Figure

import pincal
from pincal import Joint, Placement

# Nominal parameters of leg 1: lengths in m, angles in rad.
parameters = {
    "OA": 1.0,  # base point: radius and azimuth
    "beta": -pi / 2,
    "ob": 0.3,  # platform point: radius and azimuth in the platform's frame
    "beta_b": -pi / 6,
    "gamma": 0.5,  # length of the slide at reading zero
}
x, y = 0.3 * 3**0.5 / 2, 1.0 - 0.3 / 2  # from base point to platform point at home
foot = Placement.of(parameters, polar=("OA", "beta"))
leg = pincal.Leg(
    name="leg_1",
    joints=(  # base first; a placement says by which parameters a joint sits on its link
        Joint("swing", "revolute", foot, home=atan2(y, x)),
        Joint(
            "slide",
            "prismatic",
            Placement(),
            axis=(1.0, 0.0, 0.0),
            lower=0.5,
            upper=1.4,
            home=hypot(x, y),
        ),
        Joint("tip", "fixed"),
    ),
    point=Joint("b_1", "fixed", Placement.of(parameters, polar=("ob", "beta_b"))),
    sensors=(pincal.Sensor("slide", form="joint", gain=1.0, offset="gamma"),),  # gain not sought
    parameters=tuple(parameters.items()),
)
platform = pincal.Platform("planar", home=(0.0, 0.0, 0.0))
mechanism = pincal.generate("3RPR", leg, pincal.cyclic(3), platform, "An example.")
print(pincal.symmetry_group(mechanism))

mechanism.save("04_3RPR", force=True)  # 'pincal demo 04_3RPR' calibrates it
print("saved and loaded alike:", pincal.load_mechanism("04_3RPR") == mechanism)

candidates = pincal.sample_workspace(mechanism, 3000)
selection = pincal.select_poses(mechanism, candidates, 12)
print(f"{len(selection.plan.poses)} poses, efficiency {selection.efficiency:.3f}")

figure = Figure(figsize=(5, 5), layout="constrained")
pincal.picture(mechanism).draw(figure.subplots()).set_title("3-RPR")
figure.savefig("04_mechanism.png", dpi=120)
print("wrote 04_3RPR and 04_mechanism.png")
