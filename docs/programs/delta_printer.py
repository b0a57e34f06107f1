"""A printer whose bed is probed: towers, rods and endstops are off by tenths of a millimetre."""

from dataclasses import replace

import numpy as np

import pincal

printer = pincal.load_mechanism("kossel")
k = np.arange(41)
radius, turn = 0.12 * np.sqrt(k / 40), np.pi * (3 - np.sqrt(5)) * k
plan = pincal.Plan(np.column_stack((radius * np.cos(turn), radius * np.sin(turn), 0 * k)))
sigma = {"m": 3e-4, "rad": 1e-3}
rng = np.random.default_rng(3)
truth = printer.with_parameters(
    {
        leg.name: [
            value + sigma[leg.units[name]] * rng.standard_normal() for name, value in leg.parameters
        ]
        for leg in printer.legs
    }
)
noise = pincal.Noise(position=2e-5)
data = pincal.simulate(printer, truth, plan, noise, seed=1).measurements
heights = replace(data, poses=data.poses * [np.nan, np.nan, 1.0])
heights.to_csv("probing.csv", printer)
pincal.Plan(plan.poses).to_csv("points.csv", printer)
