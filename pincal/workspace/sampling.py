"""Sampling of workspaces, in a box that tightens around the poses that count.

A pose counts if it meets the criteria and is connected with home by poses that meet them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from pincal.blas import one_thread
from pincal.errors import WorkspaceError
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.instruments.setup_file import read_setup
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closing import close
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.configurations import command, shifted
from pincal.kinematics.forward import reading_range
from pincal.kinematics.singularity import margins
from pincal.model import Mechanism, Plan, Platform, Setup
from pincal.model.checks import count_of, generator_of, must_be
from pincal.model.relations import missed
from pincal.types import Array, Mask, Point
from pincal.workspace.criteria import Margins, as_margins, criteria_of, in_workspace
from pincal.workspace.grid import MOST, reach_box

_RARE = 0.05  # part of drawn readings that count below which the next are drawn nearer to home
_HALVINGS = 24  # largest number of halvings of the range of readings
_BATCH, _PART = 16_384, 2048  # poses that are drawn, and tested, together
_PILOT = 1_500  # accepted poses from which the box is tightened and connected
_WIDEN = 0.1  # widening of the box around the accepted poses, on each side, over its size
_MOST = 400  # batches without enough poses before giving up
_FAR, _HITS = 64, 8  # after so many batches with at most so many hits, draw nearer to home
_ROUNDS = 6  # rounds of joining neighbours, nearest first; joined poses are not joined again


def home_component(
    platform: Platform, samples: Array, counts: Callable[[Array], Mask]
) -> Callable[[Array], Mask]:
    """Return a function that masks the poses, (N, dof), that are connected with home.

    Samples, (M, dof), are joined if the pose halfway counts; other poses belong to the nearest.
    """
    home = np.array([platform.home])

    def twists(poses: Array) -> Array:
        """Return poses as twists from home, shape (N, dof), so that distances have a meaning."""
        return platform.twists_between(np.repeat(home, len(poses), axis=0), poses)

    samples = np.concatenate((home, samples))
    points = twists(samples)
    scale = np.ptp(points, axis=0)
    scale[scale == 0.0] = 1.0
    tree = KDTree(points / scale)
    neighbours = min(len(samples), 4 * samples.shape[1] + 1)
    near = np.asarray(tree.query(points / scale, neighbours)[1]).reshape(len(samples), -1)
    labels, joined = np.arange(len(samples)), np.empty((2, 0), dtype=near.dtype)
    for columns in np.array_split(near, _ROUNDS, axis=1):
        pairs = np.stack((np.repeat(np.arange(len(samples)), columns.shape[1]), columns.ravel()))
        pairs = pairs[:, (pairs[0] < pairs[1]) & (labels[pairs[0]] != labels[pairs[1]])]
        first, second = samples[pairs]
        halfway = platform.moved(first, platform.twists_between(first, second) / 2)
        joined = np.hstack((joined, pairs[:, counts(halfway)]))
        graph = coo_array((np.ones(joined.shape[1]), tuple(joined)), [len(samples)] * 2)
        _, labels = connected_components(graph, directed=False)
    connected = labels == labels[0]
    return lambda poses: connected[tree.query(twists(poses) / scale)[1]]


@one_thread()
def sample_configurations(
    mechanism: GivenMechanism,
    count: int,
    seed: int | np.random.Generator = 0,
    least: Margins | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> Plan:
    """Return configurations: poses, and readings if poses do not determine them.

    In that case readings are spread evenly between the limits of the active joints, and forward
    kinematics gives the poses; other mechanisms have the poses of ``sample_workspace``.

    Args:
        mechanism: The mechanism.
        count: Number of configurations.
        seed: Seed or generator.
        least: Margins from singularities; not used for serial arms.
        progress: Function that is called with the number of configurations found so far.

    Raises:
        WorkspaceError: no configurations count, or too few.
    """
    mechanism = as_mechanism(mechanism)
    if not mechanism.by_readings:
        return Plan(sample_workspace(mechanism, count, seed, least, progress))
    count_of(count, "the number of poses", WorkspaceError, 1, MOST)
    must_be(progress, Callable, "progress", WorkspaceError)
    rng, criteria, platform = generator_of(seed, WorkspaceError), None, mechanism.platform
    if any(leg.passive for leg in mechanism.legs):
        criteria = criteria_of(mechanism, as_margins(least))
    low, high, home = reading_range(mechanism)
    start = near = np.tile(platform.home, (2 * count, 1))
    reach = np.where([unit == "m" for unit in platform.units], mechanism.size, 1.0)
    poses, readings, halved = np.empty((0, platform.dof)), np.empty((0, len(low))), 0
    while halved < _HALVINGS:
        drawn = rng.uniform(low, high, (len(start), len(low)))
        if mechanism.constraints < platform.dof:  # readings do not say where it is
            near = platform.moved(start, 0.5**halved * rng.uniform(-reach, reach, start.shape))
        reached, driven, reasons = command(mechanism, Plan(near, readings=drawn))
        rows = np.flatnonzero([not reason for reason in reasons])
        if criteria:
            rows = rows[criteria.at_readings(reached[rows], driven[rows])]
        if len(rows) < _RARE * len(drawn):  # joints without limits have wide ranges: draw nearer
            low, high = 0.5 * (low + home), 0.5 * (high + home)
            halved += 1
        poses = np.concatenate((poses, reached[rows]))
        readings = np.concatenate((readings, driven[rows]))
        progress(min(len(poses), count))
        if len(poses) >= count:
            return Plan(poses[:count], readings=readings[:count])
    if criteria and not in_workspace(mechanism, start[:1], as_margins(least))[0]:
        raise WorkspaceError(_why_not_home(mechanism, as_margins(least)))
    reason = "legs do not close within their joints' limits, or are too near to singularities"
    if all(reasons):
        reason = Counter(reasons).most_common(1)[0][0]
    raise WorkspaceError(
        f"only {len(poses)} of {count} configurations of {mechanism.name!r} found between the "
        f"limits of the active joints and near home: {reason}. Check home and limits by 'pincal "
        "check'"
    )


@one_thread()
def sample_contacts(
    mechanism: GivenMechanism, setup: Setup, count: int, seed: int | np.random.Generator = 0
) -> tuple[Plan, Setup]:
    """Return configurations whose targets meet contacts' features, and the setup with their places.

    Each of ``count`` configurations is moved, in its orientation, to the feature nearest to its
    target; those that still count are returned. A feature of unknown position is planned amid the
    targets' positions, far from the others; an unknown radius is a quarter of their extent.

    Args:
        mechanism: The mechanism.
        setup: Setup with contacts and targets; positions are in the base frame.
        count: Number of configurations that are moved to a feature.
        seed: Seed or generator.

    Raises:
        WorkspaceError: the setup has no contacts, or a feature is out of reach.

    Example:
        >>> import pincal
        >>> sockets = pincal.Contact({"A": (0.02, 0.0, 1.8), "B": None})
        >>> setup = pincal.Setup(contacts={"socket": sockets})
        >>> plan, planned = pincal.sample_contacts("6UPS", setup, 40)
        >>> sorted(set(plan.contacts["socket"])), planned.contacts["socket"].points["B"] is None
        (['A', 'B'], False)
    """
    mechanism, setup = as_mechanism(mechanism), read_setup(setup)
    platform, planned = mechanism.platform, sample_configurations(mechanism, count, seed)
    if not setup.contacts:
        raise WorkspaceError("the setup has no contacts; name the features that targets touch")
    matrices, contacts, names, gaps = platform.matrices(planned.poses), {}, [], []
    for column, contact in setup.contacts.items():
        tips = matrices[:, :3, 3] + matrices[:, :3, :3] @ setup.targets[contact.target].offset
        places, radius = _amid(contact.points, tips), contact.radius
        if contact.shape in ("circle", "sphere") and radius is None:
            radius = 0.25 * float(np.ptp(tips, axis=0).max())
        contacts[column] = contact = replace(contact, points=places, radius=radius)
        names += [(column, name) for name in places]
        relation = contact.relation(column, platform.space)
        for name in places:
            feature = np.tile(contact.place(name, platform.space)[0], (count, 1))
            axes = np.broadcast_to(contact.axes, (count, 3, 3))
            missed_by, slopes, _ = missed(relation, tips, feature, axes)
            gaps.append(-np.einsum("nkd,nk->nd", slopes, missed_by))
    moves = np.array(gaps)
    nearest = np.argmin(np.linalg.norm(moves, axis=2), axis=0)
    touched = {c: tuple(names[k][1] * (names[k][0] == c) for k in nearest) for c in contacts}
    moved = shifted(mechanism, planned, lambda _: moves[nearest, range(count)])
    if moved.readings is None:
        counts: Mask = in_workspace(mechanism, moved.poses)
    else:
        low, high, _ = reading_range(mechanism)
        counts = np.all((moved.readings >= low) & (moved.readings <= high), axis=1)
    for column, name in (names[k] for k in {*range(len(names))} - {*nearest[counts]}):
        raise WorkspaceError(
            f"{mechanism.name!r} brings no target to {column} {name!r}; place it within reach"
        )
    plan = Plan(moved.poses, readings=moved.readings, contacts=touched)
    return plan.rows(np.flatnonzero(counts)), replace(setup, contacts=contacts)


def _amid(points: Mapping[str, Point | None], tips: Array) -> dict[str, Point]:
    """Return positions of points; unknown ones are amid ``tips``, (N, 3), far from the others."""
    far = np.linalg.norm(tips - np.median(tips, axis=0), axis=1)
    amid = tips[np.argsort(far)[len(far) // 4 : -(-3 * len(far) // 4)]]
    places = {name: place for name, place in points.items() if place is not None}
    for name in points:
        if name not in places:
            others = np.array([*places.values()] or [tips[np.argmin(far)]])
            x, y, z = amid[np.argmax(KDTree(others).query(amid)[0])].tolist()
            places[name] = (x, y, z)
    return places


@one_thread()
def sample_workspace(
    mechanism: GivenMechanism,
    count: int,
    seed: int | np.random.Generator = 0,
    least: Margins | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> Array:
    """Return poses spread evenly over a mechanism's workspace, coordinates of shape (count, dof).

    A seed gives the same poses again; ``least`` and ``progress``: see ``sample_configurations``.

    Raises:
        WorkspaceError: no poses count, or too few.
    """
    mechanism = as_mechanism(mechanism)
    if mechanism.by_readings:
        return sample_configurations(mechanism, count, seed, least).poses
    count_of(count, "the number of poses", WorkspaceError, 1, MOST)
    must_be(progress, Callable, "progress", WorkspaceError)
    if not isinstance(seed, int | np.integer):
        seed = int(generator_of(seed, WorkspaceError).integers(2**63))
    rng, least = generator_of(seed, WorkspaceError), as_margins(least)
    low, high, connected, rng.bit_generator.state = _explore(mechanism, int(seed), least)
    accepted = np.empty((0, mechanism.platform.dof))
    for _ in range(_MOST * (_batch(mechanism) + count) // _PART):
        poses = rng.uniform(low, high, (_PART, mechanism.platform.dof))
        counting = poses[in_workspace(mechanism, poses, least)]
        accepted = np.concatenate((accepted, counting[connected(counting)]))
        progress(min(len(accepted), count))
        if len(accepted) >= count:
            return accepted[:count]
    raise WorkspaceError(
        f"only {len(accepted)} of {count} poses found in the workspace; lower the margins or the "
        "count"
    )


def _batch(mechanism: Mechanism) -> int:
    """Return the number of poses drawn together: fewer if legs are closed by a search."""
    return _BATCH if all(map(closed_form, nominal_legs(mechanism))) else _PART


@lru_cache(maxsize=128)
def _explore(
    mechanism: Mechanism, seed: int, least: Margins | None
) -> tuple[Array, Array, Callable[[Array], Mask], Any]:
    """Return the corners of a box around the workspace, and the test of connection with home.

    The state of the seed's generator afterwards follows.
    """
    rng = np.random.default_rng(seed)
    platform, home = mechanism.platform, np.array([mechanism.platform.home])
    (lowest, highest), n = np.array(platform.bounds).T, platform.lengths
    lowest[:n], highest[:n] = (ends[:n] for ends in reach_box(mechanism))
    low, high = lowest, highest
    size = np.where([unit == "m" for unit in platform.units], highest - lowest, 1.0)
    counts = partial(in_workspace, mechanism, least=least)
    if not counts(home)[0]:
        raise WorkspaceError(_why_not_home(mechanism, least or Margins()))

    def around(poses: Array, widen: float) -> tuple[Array, Array]:
        """Return the box around poses, widened relative to its size, within reach."""
        low, high = poses.min(axis=0), poses.max(axis=0)
        wider = widen * (high - low)
        return np.maximum(low - wider, lowest), np.minimum(high + wider, highest)

    accepted, batch = home, _batch(mechanism)
    for turn in range(_MOST):
        if turn < _FAR or len(accepted) > _HITS:
            poses = rng.uniform(low, high, (batch, len(low)))
        else:  # the workspace may be small against the machine
            near = 0.5 ** (turn - _FAR) * size
            twists = rng.uniform(-near, near, (batch, platform.dof))
            poses = platform.moved(np.repeat(home, batch, axis=0), twists)
        accepted = np.concatenate((accepted, poses[counts(poses)]))
        if len(accepted) >= min(_PILOT, batch // 4):
            break
        if len(accepted) > _HITS:  # too few yet: draw in the box around them
            low, high = around(accepted, 0.5)
    connected = home_component(platform, accepted, counts)
    for _ in range(2):  # tighten to the part around home, and widen where the box cut it
        low, high = around(accepted[connected(accepted)], _WIDEN)
        poses = rng.uniform(low, high, (2 * batch, len(low)))
        accepted = np.concatenate((accepted, poses[counts(poses)]))
        connected = home_component(platform, accepted[-2 * _PILOT :], counts)
    low, high = around(accepted[connected(accepted)], _WIDEN / 4)
    return low, high, connected, rng.bit_generator.state


def _why_not_home(mechanism: Mechanism, least: Margins) -> str:
    """Return why the home pose does not count."""
    name, platform = mechanism.name, mechanism.platform
    start = f"the home pose of {name!r} is not in the workspace: "
    for closure in nominal_legs(mechanism):
        leg, closed = closure.leg, close((closure,), platform.home_pose.as_matrix())
        if not closed.reached[0]:
            return start + f"{leg.name} does not reach it on the side where it bends at home"
        for joint, value in zip(leg.moving, closed.joints[0], strict=True):
            if joint.limited and not joint.lower <= value <= joint.upper:
                return start + (
                    f"joint {joint.name!r} of {leg.name} is at {value:.4g} there, outside its "
                    f"limits {joint.lower:.4g} to {joint.upper:.4g}"
                )
    if in_workspace(mechanism, platform.home_pose, replace(least, tension=None))[0]:
        return start + f"its cables cannot all be kept at {least.tension:g} N (--margin-tension)"
    distance = margins(mechanism, platform.home_pose)
    type1, type2 = least.least_type1(mechanism), least.least_type2(mechanism)
    return start + (
        f"its distances from singularities are {distance.type1.min():.3g} (type 1, the drives' "
        f"grip) and {distance.type2[0]:.3g} (type 2, the platform's stiffness), the margins "
        f"{type1:.3g} and {type2:.3g}. Lower the margins ('pincal "
        "workspace --margin-type1 … --margin-type2 …') or move home"
    )
