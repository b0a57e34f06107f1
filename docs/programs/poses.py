"""How far the platform travels, and what a drift costs, by the order of a plan."""

from functools import cache

import numpy as np

import pincal

hexapod, planar = pincal.load_mechanism("6UPS"), pincal.load_mechanism("3RRR")
everywhere, noise = pincal.sample_workspace(planar, 60, seed=5), pincal.Noise(2e-5, 2e-5)


def wrong(plan: pincal.Plan, seed: int) -> float:
    """Return the position error of a machine measured while the tracker drifts [mm]."""
    truth, plan = pincal.disturb(planar, 2e-3, seed), pincal.Plan(plan.poses)
    data = pincal.simulate(planar, truth, plan, noise, seed).measurements
    data.poses[:, 0] += np.linspace(-1e-4, 1e-4, len(data))
    result = pincal.calibrate(planar, data, noise=noise)
    return 1e3 * pincal.accuracy(result.identified, truth, everywhere).position


def shuffled(plan: pincal.Plan) -> pincal.Plan:
    """Return its rows in random order."""
    return plan.rows(np.random.default_rng(0).permutation(len(plan)))


@cache
def chosen(robot: pincal.Mechanism, rounds: int) -> pincal.Plan:
    """Return the plan of a selection."""
    return pincal.select(robot, starts=1, rounds=rounds, reference=0).plan


for name, rounds in (("random order", 0), ("one round", 1), ("three rounds", 3)):
    plans = [chosen(robot, rounds or 1) for robot in (hexapod, planar)]
    plans = plans if rounds else list(map(shuffled, plans))
    metres = np.linalg.norm(np.diff(plans[0].poses[:, :3], axis=0), axis=1).sum()
    error = np.mean([wrong(plans[1], seed) for seed in range(3)])
    print(f"{name}: {metres:.0f} m, {error:.3f} mm")
