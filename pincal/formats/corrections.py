"""Corrections for controllers that know a machine without its terms, over poses.

Such a controller takes the plain machine, geometry, gains and offsets, to a pose by readings
ψ_plain; the machine with all its terms is there at ψ, so that it needs ψ − ψ_plain. Or it is sent
to another pose x', at which its own readings are ψ.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pincal.files.columns import Columns, columns_of, reason_column
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.configurations import as_plan, inverse, joints_at
from pincal.kinematics.forward import forward
from pincal.kinematics.influences import own_influences
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.types import Array

CORRECTION, COMMAND = "correction_", "command_"


@dataclass(frozen=True, repr=False)
class Corrections:
    """What takes the whole machine to N poses by a controller that knows the plain one.

    Example:
        >>> import pincal
        >>> pincal.corrections("5R", [[0.0, 1.1]]).readings.tolist()  # no terms: nothing to add
        [[0.0, 0.0]]
    """

    plan: Plan
    """The poses; and the readings of the plain machine, where poses do not determine them."""
    readings: Array
    """What to add to readings of the plain machine, shape (N, n_readings), [rad] or [m]; NaN where
    there is none."""
    commands: Array | None
    """Poses to command instead, shape (N, dof), [m] and [rad]; NaN where there is none. None if
    the legs demand more than there are freedoms: no pose has just these readings then."""
    reasons: tuple[str, ...]
    """Why a row has no correction or command; empty strings where it has both."""

    def __repr__(self) -> str:
        return f"Corrections: {self.reasons.count('')} of {len(self.reasons)} poses"


def corrections(mechanism: GivenMechanism, planned: Plan | Array) -> Corrections:
    """Return what a controller lacks at poses that knows the mechanism without its terms.

    Args:
        mechanism: The mechanism, at its nominal parameters.
        planned: N poses, shape (N, dof), [m] and [rad]; or a plan with columns of influences, NaN
            or none at their reference, and with the plain machine's readings if poses follow these.

    Raises:
        MechanismError: poses or readings of a wrong shape, or not finite; a homed sensor and a
            home pose out of its leg's reach.
    """
    mechanism = as_mechanism(mechanism)
    plain, plan = mechanism.without_terms, as_plan(mechanism, planned)
    safe = poses = plan.poses
    reasons_plain: tuple[str, ...] = ("",) * len(plan)
    if plan.readings is not None:
        plain_poses = forward(plain, plan.readings, poses)
        poses, reasons_plain = plain_poses.poses, plain_poses.reasons
        safe = np.where(np.isfinite(poses), poses, mechanism.platform.home)
    started = joints_at(plain, Plan(safe, readings=plan.readings))
    influences = own_influences(mechanism, plan.influences)
    reached = inverse(mechanism, safe, influences, started.joints)
    reasons = [reason or reached.reason(row) for row, reason in enumerate(reasons_plain)]
    has_readings = np.array([not reason for reason in reasons], dtype=bool)
    commands = None if mechanism.redundant else np.full(poses.shape, np.nan)
    if commands is not None:
        commanded = forward(plain, reached.readings[has_readings], safe[has_readings])
        commands[has_readings] = commanded.poses
        for row, reason in zip(np.flatnonzero(has_readings), commanded.reasons, strict=True):
            reasons[row] = reason
    readings = started.readings if mechanism.by_readings else None
    return Corrections(
        Plan(poses, readings=readings, influences=influences),
        np.where(has_readings[:, None], reached.readings - started.readings, np.nan),
        commands,
        tuple(reasons),
    )


def correction_columns(
    mechanism: Mechanism, lacking: Corrections, orientation: str = "tilt-torsion"
) -> Columns:
    """Return poses, ``correction_leg_1 [rad]``, ``command_x [m]``, reasons, as columns."""
    columns = columns_of(mechanism, lacking.plan, orientation)
    named = zip(mechanism.reading_names, mechanism.reading_units, lacking.readings.T, strict=True)
    columns |= {f"{CORRECTION}{name} [{unit}]": values for name, unit, values in named}
    if lacking.commands is not None:
        commands = columns_of(mechanism, Plan(lacking.commands), orientation)
        columns |= {f"{COMMAND}{header}": values for header, values in commands.items()}
    return columns | reason_column(lacking.reasons)
