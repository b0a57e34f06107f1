"""Ratios, measured in one run: what pincal adds to Pinocchio, and what batches save.

``python -m pytest benchmarks/bench_*.py -n 0 --docs`` writes docs/benchmarks.md. Bounds
are not asserted: a benchmark is not a test.
"""

from __future__ import annotations

import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import pincal
from pincal.kinematics.chain import leg_chain
from pincal.kinematics.forest import Forest
from pincal.kinematics.influences import gravity_loads
from pincal.model.terms import Load

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from closed_forms import angles, jacobian
from conftest import in_turn

Array = NDArray[np.float64]
POSES = 30_000


@pytest.fixture(scope="module")
def mechanism() -> pincal.Mechanism:
    return pincal.load_mechanism("3RRR")


@pytest.fixture(scope="module")
def poses(mechanism: pincal.Mechanism) -> Array:
    return pincal.sample_workspace(mechanism, POSES, seed=0)


def identification_jacobians(
    mechanism: pincal.Mechanism, poses: pincal.model.platform.Poses
) -> None:
    """Compute the identification Jacobians of all legs, inverse kinematics included."""
    for leg in mechanism.leg_names:
        pincal.identification_jacobian(mechanism, leg, poses)


def pinocchio_columns(mechanism: pincal.Mechanism, count: int) -> Callable[[], None]:
    """Return a call of Pinocchio alone for the joint columns of all legs: no copy, no NumPy.

    Of all elementary joints, those too that pincal evaluates once since they stand still.
    """
    work = []
    for leg in mechanism.legs:
        chain = leg_chain(leg, spatial=False)
        joints = (chain.still.chain if chain.still else ()) + chain.forest.chain
        tree = Forest(joints, (), spatial=False, copies=40 // len(joints))
        model, data = tree._model, tree._data
        q = np.random.default_rng(0).uniform(-1, 1, model.nq)
        work.append((model, data, q, -(-count // tree.copies)))

    def run() -> None:
        evaluate = pin.computeJointJacobians
        for model, data, q, blocks in work:
            for _ in range(blocks):
                evaluate(model, data, q)

    return run


def closed_form_jacobians(mechanism: pincal.Mechanism, poses: Array) -> None:
    """Compute the same Jacobians by central differences of the vectorised closed form."""
    for index, leg in enumerate(mechanism.legs):
        p = leg.nominal_by_name
        turn = angles("3RRR", p, poses, -1)[0]
        jacobian("3RRR", index, p, poses, -1, turn)


def test_against_pinocchio_alone(
    benchmark: Any, ratios: Any, mechanism: pincal.Mechanism, poses: Array
) -> None:
    transforms = mechanism.platform.transforms(poses)
    own, alone = in_turn(
        lambda: identification_jacobians(mechanism, transforms), pinocchio_columns(mechanism, POSES)
    )
    ratios(
        "Jacobians of three legs at 30,000 poses, inverse kinematics included, over "
        "Pinocchio alone for the same joint columns",
        own / alone,
        "<= 3",
    )
    benchmark.extra_info["ratio"] = own / alone
    benchmark(identification_jacobians, mechanism, transforms)


def test_loads_by_gravity(ratios: Any) -> None:
    machine = replace(pincal.load_mechanism("6UPS"), load=Load(10.0, (0.01, 0.02, 0.05)))
    poses = pincal.sample_workspace(machine, 4000, seed=0)
    readings = pincal.inverse(machine, poses).readings
    matrices = machine.platform.matrices(poses)
    loads, columns = in_turn(
        lambda: gravity_loads(machine, readings, matrices),
        lambda: identification_jacobians(machine, poses),
    )
    ratios(
        "loads by gravity of all joints, lengths and angles of a 6-UPS over the geometry's columns",
        loads / columns,
        "<= 1",
    )


def test_against_vectorised_closed_form(
    benchmark: Any, ratios: Any, mechanism: pincal.Mechanism, poses: Array
) -> None:
    own, closed = in_turn(
        lambda: identification_jacobians(mechanism, poses),
        lambda: closed_form_jacobians(mechanism, poses),
    )
    ratios(
        "the same over the vectorised NumPy closed form with central differences",
        own / closed,
        "<= 2",
    )
    benchmark.extra_info["ratio"] = own / closed
    benchmark(closed_form_jacobians, mechanism, poses)


def test_against_one_pose_at_a_time(
    benchmark: Any, ratios: Any, mechanism: pincal.Mechanism, poses: Array
) -> None:
    few = 300

    def singly() -> None:
        for pose in poses[:few]:
            identification_jacobians(mechanism, pose[None])

    together, alone = in_turn(lambda: identification_jacobians(mechanism, poses), singly, runs=5)
    ratio = (alone / few) / (together / POSES)
    ratios("the same calls one pose at a time over batches, per pose", ratio, ">= 10")
    benchmark.extra_info["ratio"] = ratio
    benchmark.pedantic(singly, rounds=1)


def test_symmetric_against_independent_selection(
    benchmark: Any, ratios: Any, mechanism: pincal.Mechanism, poses: Array
) -> None:
    symmetric, independent = in_turn(
        lambda: pincal.select_poses(mechanism, poses, 24, "symmetric"),
        lambda: pincal.select_poses(mechanism, poses, 24, "independent"),
    )
    ratios(
        "symmetric over independent selection for three legs, 24 of 30,000 poses",
        symmetric / independent,
        "<= 0.37",
    )
    benchmark.extra_info["ratio"] = symmetric / independent
    benchmark.pedantic(lambda: pincal.select_poses(mechanism, poses, 24), rounds=3)


@pytest.mark.parametrize("count", [100_000, 1_000_000])
def test_memory_besides_the_result(
    benchmark: Any, ratios: Any, mechanism: pincal.Mechanism, poses: Array, count: int
) -> None:
    many = np.resize(poses, (count, 3))
    transforms = mechanism.platform.transforms(many)
    del many
    tracemalloc.start()
    C = pincal.identification_jacobian(mechanism, "leg_1", transforms)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    extra = (peak - C.nbytes) / 2**20
    ratios(f"memory besides the result at {count:,} poses [MiB]", extra, "flat")
    benchmark.extra_info["extra_mib"] = extra
    benchmark.pedantic(pincal.identification_jacobian, (mechanism, "leg_1", transforms), rounds=1)
