"""Singularity margins and the sampled workspace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from closed_forms import angles, base_point, platform_point, poses_near_home
from marks import quick, some_slow

import pincal
from pincal.kinematics.singularity import rods_margin
from pincal.workspace.criteria import in_workspace
from pincal.workspace.sampling import home_component

BENDS = {"3RRR": [-1, -1, -1], "5R": [-1, 1]}


def closed_form_margins(mechanism: pincal.Mechanism, poses: np.ndarray) -> tuple:
    """Return elbow sines (N, n_legs) and the determinant of unit directions (N,)."""
    kind, sines, lines = mechanism.name, [], []
    for leg, bend in zip(mechanism.legs, BENDS[kind], strict=True):
        p = leg.nominal_by_name
        shoulder, elbow = angles(kind, p, poses, bend)
        sines.append(np.abs(np.sin(elbow)))
        tip = platform_point(kind, p, poses)
        u = (tip - base_point(kind, p) - p["l"] * np.exp(1j * shoulder)) / p["L"]
        arm = tip - poses[:, 0] - 1j * poses[:, 1]
        moment = [(np.conj(arm) * u).imag / p["ob"]] if kind == "3RRR" else []
        lines.append(np.stack([u.real, u.imag, *moment], axis=1))
    with np.errstate(invalid="ignore"):
        return np.stack(sines, axis=1), np.linalg.det(np.stack(lines, axis=1))


def test_margins_equal_closed_forms(mechanism: pincal.Mechanism) -> None:
    """Type 1 is the elbow's sine, type 2 the determinant of unit directions signed as home."""
    poses = poses_near_home(mechanism, np.random.default_rng(0), 500)
    found = pincal.margins(mechanism, poses)
    sines, determinant = closed_form_margins(mechanism, poses)
    _, at_home = closed_form_margins(mechanism, np.array([mechanism.platform.home]))
    ok = np.isfinite(sines).all(axis=1) & (sines > 0.05).all(axis=1)
    assert ok.sum() > 20
    np.testing.assert_allclose(found.type1[ok], sines[ok], atol=1e-12)
    np.testing.assert_allclose(found.type2[ok], (determinant * np.sign(at_home))[ok], atol=1e-12)
    unreachable = ~np.isfinite(sines)
    assert np.isnan(found.type1[unreachable]).all()


@pytest.mark.parametrize("kind", quick(5, ["5R", "3RRR", "3PRR", "6UPS", "delta", "8cable"]))
def test_margins_of_rods_are_those_of_closed_legs(kind: str) -> None:
    """Lines along rods and slides say before closing what closed legs say; both sides are met."""
    mechanism = pincal.load_mechanism(kind)
    poses = pincal.sample_workspace(mechanism, 200, 1, pincal.Margins.none())
    rods = rods_margin(mechanism, mechanism.platform.matrices(poses))
    assert rods is not None
    np.testing.assert_allclose(rods, pincal.margins(mechanism, poses).type2, atol=1e-12)
    assert (rods < 0.0).any() or kind in ("delta", "8cable")


@pytest.mark.parametrize("kind", some_slow(BENDS, "3RRR"))
def test_sampled_poses_keep_the_margins(
    mechanism: pincal.Mechanism, candidates: dict[str, np.ndarray]
) -> None:
    """All 30,000 poses keep the margins and the joint limits, and fill the workspace's box."""
    poses = candidates[mechanism.name]
    assert poses.shape == (30_000, mechanism.platform.dof)
    sines, determinant = closed_form_margins(mechanism, poses)
    assert sines.min() >= 0.23 - 1e-12
    assert np.abs(determinant).min() >= 0.2 - 1e-12
    joints = pincal.inverse(mechanism, poses).joints
    for leg in mechanism.legs:
        for joint, values in zip(leg.moving, joints[leg.name].T, strict=True):
            assert joint.lower <= values.min()
            assert values.max() <= joint.upper
    denser = pincal.sample_workspace(mechanism, 60_000, seed=7)
    low, high = denser.min(axis=0), denser.max(axis=0)
    assert (np.abs(poses.min(axis=0) - low) < 0.05 * (high - low)).all()
    assert (np.abs(poses.max(axis=0) - high) < 0.05 * (high - low)).all()


def test_the_symmetric_workspace(candidates: dict[str, np.ndarray]) -> None:
    """The group carries every sampled pose to a pose of the workspace (3-RRR paper, Eq. 2)."""
    for name, poses in candidates.items():
        mechanism = pincal.load_mechanism(name)
        for element in pincal.symmetry_group(mechanism).elements:
            carried = element.poses(mechanism.platform, poses)
            slack = pincal.Margins(0.23 - 1e-9, 0.2 - 1e-9)
            assert in_workspace(mechanism, carried, slack).all()


@pytest.mark.parametrize("kind", some_slow(BENDS, "3RRR"))
def test_same_seed_same_poses_whatever_the_global_seed(mechanism: pincal.Mechanism) -> None:
    """Sampling depends on its seed only, and fewer poses are the first of more."""
    np.random.seed(1)  # noqa: NPY002
    first = pincal.sample_workspace(mechanism, 300, seed=3)
    np.random.seed(2)  # noqa: NPY002
    np.testing.assert_array_equal(first, pincal.sample_workspace(mechanism, 300, seed=3))
    np.testing.assert_array_equal(first[:20], pincal.sample_workspace(mechanism, 20, seed=3))
    assert not np.array_equal(first, pincal.sample_workspace(mechanism, 300, seed=4))


def test_component_of_home_stops_at_a_gap() -> None:
    """Of two discs only the one that holds home is connected to it."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-2.5, 2.5, (4000, 2))

    def counts(poses: np.ndarray) -> np.ndarray:
        return (np.hypot(poses[:, 0] - 1.05, poses[:, 1]) < 1) | (
            np.hypot(poses[:, 0] + 1.05, poses[:, 1]) < 1
        )

    inside = points[counts(points)]
    platform = pincal.Platform("point", home=(1.0, 0.0))
    connected = home_component(platform, inside, counts)(inside)
    np.testing.assert_array_equal(connected, inside[:, 0] > 0)


def test_empty_workspace_is_an_error(mechanism: pincal.Mechanism) -> None:
    """Margins that home itself does not keep raise, and say what to do."""
    with pytest.raises(pincal.WorkspaceError, match="Lower the margins"):
        pincal.sample_workspace(mechanism, 10, least=pincal.Margins(0.99, 0.99))


@pytest.mark.parametrize("count", [0, -3])
def test_wrong_count_is_refused(mechanism: pincal.Mechanism, count: int) -> None:
    """A count below one raises."""
    with pytest.raises(pincal.WorkspaceError, match="expected 1 to 10,000,000"):
        pincal.sample_workspace(mechanism, count)


@pytest.mark.parametrize("margin", [-0.1, 1.0, float("nan")])
def test_wrong_margins_are_refused(margin: float) -> None:
    """Margins outside 0 to 1 raise."""
    with pytest.raises(pincal.WorkspaceError, match="expected 0 to 1"):
        pincal.Margins(type1=margin)


@pytest.mark.parametrize("kind", ["5R", "3RPS"])
@pytest.mark.parametrize("count", [0, -1, 10**11])
def test_numbers_of_poses_that_cannot_be_are_refused(kind: str, count: int) -> None:
    """None, fewer, or more than any memory holds: refused by number, before anything is drawn."""
    mechanism = pincal.load_mechanism(kind)
    for sample in (pincal.sample_workspace, pincal.sample_configurations):
        with pytest.raises(pincal.WorkspaceError, match=f"number of poses is {count}; expected"):
            sample(mechanism, count)


def test_nothing_counts_where_home_is_out_of_reach() -> None:
    """The side of type 2 is that of home: without it no pose is on the right one."""
    mechanism = pincal.load_mechanism("3RRR")
    home = mechanism.platform.home
    far = replace(mechanism, platform=replace(mechanism.platform, home=(30.0, *home[1:])))
    assert not in_workspace(far, np.array([home])).any()
