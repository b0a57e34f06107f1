"""A term of a sensor of one's own: encoders that sit off their axes, once round a motor's turn."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

import pincal

GEAR = 5.0  # turns of the motor for one of the joint


def motor_sine(reading):
    """Return the sine of the motor's angle."""
    return np.sin(GEAR * reading)


def motor_cosine(reading):
    """Return the cosine of the motor's angle."""
    return np.cos(GEAR * reading)


# q = k ψ + γ + a_sin sin 5ψ + a_cos cos 5ψ: each basis function with its slope.
terms = (
    pincal.Term("a_sin", motor_sine, lambda psi: GEAR * motor_cosine(psi)),
    pincal.Term("a_cos", motor_cosine, lambda psi: -GEAR * motor_sine(psi)),
)
plain = pincal.load_mechanism("3RRR")
legs = [
    replace(
        leg,
        sensors=(replace(leg.sensors[0], terms=terms),),
        parameters=(*leg.parameters, ("a_sin", 0.0), ("a_cos", 0.0)),
    )
    for leg in plain.legs
]
robot = replace(plain, legs=tuple(legs))
truth = pincal.disturb(robot, 1e-3, seed=1)  # parameters of terms, too

draw = np.random.default_rng(0)
poses = plain.platform.home + [0.08, 0.08, 0.4] * draw.uniform(-1.0, 1.0, (80, 3))
noise = pincal.Noise(position=2e-5, orientation=1e-4, reading=1e-5)
data = pincal.simulate(robot, truth, pincal.Plan(poses), noise, seed=2).measurements

axes = (figure := Figure(figsize=(7, 4), layout="constrained")).subplots()
for label, machine in (("without terms", plain), ("with terms", robot)):
    result = pincal.calibrate(machine, data, noise=noise)
    error = 1e6 * pincal.accuracy(result.identified, truth, poses).position
    print(f"{label}: {error:.1f} µm, reduced χ² {result.reduced_chi2:.2f}")
    axes.bar(label, error)
print(result["leg_1.a_sin"].identified, truth.parameters["leg_1.a_sin"].nominal)
axes.set(ylabel="error of the platform [µm]", title="3-RRR with eccentric encoders")
figure.savefig("11_own_sensor_term.png", dpi=120)
print("wrote 11_own_sensor_term.png")
