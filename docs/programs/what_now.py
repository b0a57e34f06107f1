"""Measurements of machines that are not as they should be: the tables of the page what now."""

from dataclasses import replace

import numpy as np

import pincal

drawing = pincal.load_mechanism("3RRR")
machine = pincal.disturb(drawing, 1e-3, seed=1)
poses = pincal.sample_workspace(drawing, 60, seed=1)
noise = pincal.Noise(2e-5, 5e-5, 2e-5)


def measure(truth, plan, noise=noise):
    """Return what is measured on a machine."""
    return pincal.simulate(drawing, truth, plan, noise, seed=1).measurements


# links that grow with temperature
temperature = np.round(20.0 + 6.0 * (1.0 - np.exp(-3.0 * np.linspace(0.0, 1.0, 60))), 1)
grow = tuple(
    (name, pincal.Term(f"{name}_grows", pincal.Share(6.0, 20.0), of="temperature")) for name in "lL"
)
amplitudes = tuple((term.parameter, 4e-5) for _, term in grow)
legs = [replace(leg, terms=grow, parameters=(*leg.parameters, *amplitudes)) for leg in machine.legs]
warm = pincal.Plan(poses, influences={"temperature": temperature})
measure(replace(machine, legs=tuple(legs)), warm).to_csv("warm.csv", drawing)
# an encoder that slips after row 30, without and with a column that says so
sound = measure(machine, pincal.Plan(poses))
readings = sound.readings + 6e-4 * np.outer(np.arange(60) >= 30, [0, 1, 0])
slipped = replace(sound, readings=readings)
slipped.to_csv("slipped.csv", drawing)
after = {"after": (np.arange(60) >= 30).astype(float)}
replace(slipped, influences=after).to_csv("named.csv", drawing)
# two wrong rows
wrong = sound.poses.copy()
wrong[[11, 40], 0] += 1e-3
replace(sound, poses=wrong).to_csv("wrong.csv", drawing)
# few poses of a machine that is 0.5 mm off
few = measure(
    pincal.disturb(drawing, 5e-4, seed=3), pincal.Plan(poses[:12]), pincal.Noise(1e-3, 1e-3, 0.0)
)
few.to_csv("few.csv", drawing)
