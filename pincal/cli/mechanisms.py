"""``pincal mechanisms`` and ``pincal check``: what there is, and whether it is sound."""

from __future__ import annotations

import numpy as np

from pincal.cli.app import Mech, answer, command, stdout, working
from pincal.estimation.observability import identifiability
from pincal.files.mechanism_folders import bundled, load_mechanism
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.derivatives import leg_demand
from pincal.kinematics.readers import tips_by_reader
from pincal.show.tables import nominal_table
from pincal.symmetry.detect import symmetry_group
from pincal.workspace.sampling import sample_configurations


@command(answers=True)
def mechanisms() -> None:
    """List the mechanisms that come with pincal."""
    found = []
    for name, folder in bundled().items():
        mechanism = load_mechanism(folder)
        legs, platform = len(mechanism.legs), mechanism.platform
        stdout.print(f"{name:12s} {legs} legs, {', '.join(platform.coordinates)}", markup=False)
        stdout.print(f"{'':12s} {mechanism.description}", markup=False)
        coordinates = dict(zip(platform.coordinates, platform.units, strict=True))
        found.append(
            {
                "name": name,
                "legs": mechanism.leg_names,
                "coordinates": coordinates,
                "description": mechanism.description,
            }
        )
    answer({"mechanisms": found})


@command(answers=True)
def check(mech: Mech) -> None:
    """Say whether a mechanism is sound.

    Loops closed at home, URDFs read alike by others, parameters observable, symmetry.
    """
    mechanism = load_mechanism(mech)
    stdout.print(nominal_table(mechanism))
    platform, legs = mechanism.platform, []
    home = platform.home_pose.as_matrix()
    for leg in mechanism.legs:
        closure = LegClosure(leg, platform)
        gap = float(np.abs(closure.evaluate(leg.home[None], home).gap).max())
        tips = tips_by_reader(leg)
        own = closure.tips(leg.home[None])[0]
        off = max(float(np.abs(tip - own).max()) for tip in tips.values())
        close = f"closes at home within {gap:.2g} m"
        if gap > 1e-2 * closure.size:
            close = (
                f"home is rough, it closes within {gap:.2g} m only and fixes the side of bending"
            )
        stdout.print(f"{leg.name}: {close}", markup=False)
        readers = " and ".join(tips)
        stdout.print(f"{leg.name}: URDF read alike by {readers} within {off:.2g} m", markup=False)
        legs.append({"name": leg.name, "home_gap": gap, "readers_differ_by": off})
    with working("sampling the workspace"):
        plan = sample_configurations(mechanism, 500)
    for leg, told, own in zip(mechanism.legs, legs, mechanism.reading_columns, strict=True):
        readings = None if plan.readings is None else plan.readings[:, own]
        rows = leg_demand(mechanism, leg.name, plan.poses, readings=readings)
        if rows.value.shape[1] == len(leg.sensors):
            rows = rows.as_joint()
        C = rows.parameter.reshape(-1, len(leg.parameters))
        found = identifiability(C, [f"{leg.name}.{name}" for name in leg.parameter_names])
        words = "" if found.complete else f": {found.describe()}"
        stdout.print(
            f"{leg.name}: {found.rank} of {found.n_params} parameters observable from full poses "
            f"(condition {found.condition:.3g}){words}",
            markup=False,
        )
        told |= {
            "parameters": dict(zip(leg.parameter_names, leg.nominal.tolist(), strict=True)),
            "rank": found.rank,
            "condition": found.condition,
            "not_told_apart": found.groups,
        }
    group = symmetry_group(mechanism)
    if len(mechanism.legs) > 1:
        stdout.print(f"symmetry: {group}", markup=False)
    answer({"mechanism": mechanism.name, "legs": legs, "symmetry": group.name})
