"""From a mechanism to a plan that can be driven: candidates, the choice among them, the order."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pincal.design.orbits import merged
from pincal.design.order import in_rounds, with_distances, with_verification
from pincal.design.select import Goal, Protocol, Selection, select_configurations, select_poses
from pincal.errors import MeasurementError, SymmetryError, WorkspaceError
from pincal.estimation.noise import assumed_noise, check_noise
from pincal.files.measurements import as_noise, read_poses
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.instruments.setup_file import read_setup
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closure import nominal_legs
from pincal.kinematics.collision import arm_free_of_collision
from pincal.kinematics.configurations import check_reached
from pincal.model import Mechanism, Noise, Plan, Setup
from pincal.model.checks import check_kinds, listed, must_be
from pincal.option import option
from pincal.words.numbers import amount
from pincal.workspace.criteria import Margins, in_workspace
from pincal.workspace.limits import Limits
from pincal.workspace.sampling import sample_configurations, sample_contacts

CONFIGURATIONS = 3000
"""Number of candidates, where poses serve all parameters together or legs close by a search."""
_POSES = 30_000  # candidates, where legs of closed forms have poses of their own
_FEW = 4  # if limits leave fewer than one in so many candidates, more are drawn
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PlanningOptions(Limits):
    """Options on the choice of poses, and on the order in which they are driven."""

    count: int = option(
        24,
        "Number of poses for each leg; orbits with --protocol orbits; poses for all legs with "
        "--protocol common, --goal platform, --measure or an unknown frame.",
        least=1,
    )
    protocol: Protocol | None = option(
        None,
        "independent: each leg its own poses; symmetric: leg 1's poses, mapped to the other legs; "
        "orbits: whole orbits, every pose serves every leg; common: COUNT poses for the parameters "
        "of all legs together.",
    )
    candidates: Any = option(
        None,
        "Poses to choose from; by default 30000 are sampled, 3000 for all legs together or where "
        "legs have no closed form.",
        metavar="CSV",
        kind=Path | None,
    )
    collision: Path | None = option(
        None, "Avoid self-collisions of an arm, by this file's geometry.", metavar="ROBOT.urdf"
    )
    goal: Goal = option("parameters", "Best for the parameters, or for the calibrated platform.")
    starts: int = option(5, "Number of starts of the search; the best result is kept.", least=1)
    distances: int = option(
        0,
        "Measure this many distances from each pose to others, by calliper or tape, not positions.",
        least=0,
    )
    verify: int = option(0, "Additional random poses to verify the calibration with.", least=0)
    rounds: int = option(
        3, "Drive in so many rounds, each over a random share of poses; 1 is shortest.", least=1
    )
    reference: int | None = option(
        None,
        "Repeat the middle pose every so many rows, to show drift [default: at both ends and "
        "between rounds]; 0 for never.",
        least=0,
    )
    seed: int = option(0, "Seed of all random choices.", least=0)


def select(
    mechanism: GivenMechanism,
    *,
    measured: Sequence[str] | None = None,
    setup: Setup | None = None,
    noise: Noise | None = None,
    margins: Margins | None = None,
    progress: Callable[[str], None] = lambda _: None,
    **options: Any,
) -> Selection:
    """Return chosen poses as a plan that can be driven, as ``pincal select`` does.

    Candidates are given, or sampled from the workspace; those outside the limits are left out. The
    plan is in rounds (``design.order``), with poses for verification and repetitions of the middle
    pose.

    Args:
        mechanism: The mechanism.
        measured: Quantities of the platform to measure (see ``forecast``); the pose by default.
        setup: Meaning of the measured numbers.
        noise: Standard deviations of the future measurements.
        margins: Least distances from singularities, and tensions of cables, of candidates.
        progress: Function that is called with the name of each step.
        **options: Options of the command: ``count``, ``protocol``, ``candidates`` (a plan, poses or
            their file), ``goal``, ``starts``, ``seed``, ``collision``, ``box``, ``floor``,
            ``keep_out``, ``clearance``, ``verify``, ``rounds``, ``reference``, ``distances``.

    Raises:
        ObservabilityError: there are too few poses for the parameters, or too few candidates.
        WorkspaceError: no candidate is within the limits.
        MeasurementError: options contradict each other.
        FileError: a file cannot be read.

    Example:
        >>> import pincal
        >>> selection = pincal.select("5R", count=8, starts=1, box="y=0.6..1.2", verify=4)
        >>> selection.count, selection.plan.sets.count("verify")
        (16, 4)
    """
    mechanism, choice = as_mechanism(mechanism), PlanningOptions(**options)
    check_kinds(vars(choice), PlanningOptions, MeasurementError)
    must_be(progress, Callable, "progress", MeasurementError)
    if mechanism.influences:
        _log.info(
            "planned with %s at their reference; to identify their terms, vary them between rows",
            ", ".join(mechanism.influences),
        )
        mechanism = mechanism.at_reference
    setup = read_setup(Setup() if setup is None else setup)
    if choice.distances:  # they hold the information of positions in an unknown frame
        setup = setup.anywhere(frame=True)
        measured = mechanism.platform.freedoms[: mechanism.platform.lengths]
    noise = with_reading_noise(as_noise(noise), mechanism)
    partial = measured is not None or not setup.plain or choice.goal == "platform"
    together = mechanism.by_readings or partial or choice.collision is not None
    if together and choice.protocol not in (None, "common"):
        raise MeasurementError(
            f"--protocol {choice.protocol} needs whole poses measured in the base frame, and the "
            "goal 'parameters'; leave it out: poses are then common to all legs"
        )
    progress("sampling the workspace")
    quick = not together and all(map(closed_form, nominal_legs(mechanism)))
    offered = _candidates(mechanism, choice, setup, margins, _POSES if quick else CONFIGURATIONS)
    progress("choosing poses")
    search: dict[str, Any] = {"noise": noise, "seed": choice.seed, "starts": choice.starts}
    if together:
        if isinstance(choice.candidates, str | Path):
            check_reached(mechanism, offered, str(choice.candidates))
        search |= {"measured": measured, "setup": setup, "goal": choice.goal}
        selection = select_configurations(mechanism, offered, choice.count, **search)
    else:
        selection = _of_legs(mechanism, offered, choice, search)
    if selection.unreachable:
        _log.info("%d candidate poses are out of reach and left out", selection.unreachable)
    return replace(selection, plan=_driven(mechanism, selection.plan, offered, choice, setup))


def _of_legs(
    mechanism: Mechanism, offered: Plan, choice: PlanningOptions, search: dict[str, Any]
) -> Selection:
    """Return poses chosen leg by leg; the default protocol is symmetric where that is possible."""
    protocol, given = choice.protocol, (mechanism, offered.poses, choice.count)
    try:
        selection = select_poses(*given, protocol or "symmetric", **search)
        if not choice.allow(mechanism, selection.plan, Setup()).all():
            raise SymmetryError(
                "poses are mapped out of the limits: choose limits with the mechanism's symmetry, "
                "or poses for each leg alone (--protocol independent)"
            )
    except SymmetryError as error:
        if protocol is not None:
            raise
        _log.info("independent selection: %s", error)
        selection = select_poses(*given, "independent", **search)
    if selection.protocol == "independent":  # a pose that several legs need is driven to once
        plan = merged(mechanism, selection.plan.poses, selection.plan.sets or ())
        return replace(selection, plan=plan, count=len(plan))
    return selection


def _candidates(
    mechanism: Mechanism, choice: PlanningOptions, setup: Setup, margins: Margins | None, count: int
) -> Plan:
    """Return candidates within limits and margins: the given ones, or about ``count`` samples."""
    if choice.candidates is not None:
        offered = read_poses(choice.candidates, mechanism, setup=setup)
    else:
        offered = sampled(mechanism, setup, count, choice.seed, margins)
    if margins is not None and not mechanism.by_readings:
        offered = offered.rows(in_workspace(mechanism, offered.poses, margins))
    total, within = len(offered), offered.rows(choice.allow(mechanism, offered, setup))
    if choice.candidates is None and 0 < _FEW * len(within) < total:
        offered = sampled(mechanism, setup, 2 * _FEW * count, choice.seed, margins)
        within = offered.rows(choice.allow(mechanism, offered, setup))
    for words, allowed in Limits(choice.box).within(mechanism, offered, setup).items():
        if allowed.all():
            _log.info("nothing is left out by %s (numbers without a unit: in m or rad)", words)
    if not len(within):
        limits = choice.within(mechanism, offered, setup).items()
        lost = [f"{(~ok).sum()} are left out by {words}" for words, ok in limits if not ok.all()]
        raise WorkspaceError(
            f"none of {len(offered)} candidates is within the limits: {'; '.join(lost)}"
        )
    if choice.collision is not None:
        total, within = len(within), arm_free_of_collision(mechanism, within, choice.collision)
    if len(within) < total:
        _log.info("%d of %d candidates are within the limits", len(within), total)
    return within


def sampled(
    mechanism: Mechanism, setup: Setup, count: int, seed: int, margins: Margins | None = None
) -> Plan:
    """Return samples of the workspace, at the points of contacts if the setup has any."""
    if not setup.contacts:
        return sample_configurations(mechanism, count, seed, margins)
    plan, placed = sample_contacts(mechanism, setup, count, seed)
    planned = [
        f"{column} {point} at ({', '.join(f'{x:.3g}' for x in contact.points[point] or ())}) m"
        for column, point, contact in placed.touched.values()
        if setup.contacts[column].points[point] is None
    ]
    if planned:
        _log.info("planned with %s: give their places in the setup if they differ", listed(planned))
    return plan


def _driven(
    mechanism: Mechanism, plan: Plan, offered: Plan, choice: PlanningOptions, setup: Setup
) -> Plan:
    """Return a plan in driving order, with poses for verification and distances."""
    if choice.verify:
        plan = with_verification(mechanism, plan, offered, choice.verify, choice.seed)
        _log.info("%d more poses, in the set 'verify', are kept for verification", choice.verify)
    rows, blocked = len(plan), choice.blocked(mechanism, plan, setup)
    plan = in_rounds(mechanism, plan, choice.rounds, choice.reference, choice.seed, blocked)
    if repeated := len(plan) - rows:
        _log.info("one pose is measured %d times more, as the pose 'reference'", repeated)
    if blocked.any():
        ways = np.diagonal(choice.blocked(mechanism, plan, setup), 1)
        if through := [f"{row + 1} to {row + 2}" for row in np.flatnonzero(ways)]:
            _log.info("ways pass through --keep-out: from row %s", listed(through))
    return with_distances(plan, choice.distances)


def with_reading_noise(noise: Noise, mechanism: Mechanism) -> Noise:
    """Return plausible noise, with a noise of readings, which machines with surplus readings need.

    Raises:
        MeasurementError: the noise is so large that its unit must be wrong.
    """
    if noise != Noise():
        check_noise(mechanism, noise)
    if noise.reading or not mechanism.redundant:
        return noise
    reading = assumed_noise(mechanism, exact=False).reading
    size = amount(reading, mechanism.reading_units[0]).replace(" ", "")
    _log.info("more readings than freedoms cannot all be exact: assumed --noise-reading %s", size)
    return replace(noise, reading=reading)
