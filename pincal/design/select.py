"""Choosing poses to measure, for one leg and mapped to all, or for all legs at once.

- ``independent``: each leg its own poses (5R paper);
- ``symmetric``: leg 1's poses, carried to the other legs by the group (3-RRR paper, Eqs. 14, 22);
- ``orbits``: whole orbits of the group, so that each measured pose serves every leg;
- ``common``: poses that are best for the parameters of all legs together (the papers'
  traditional identification).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pincal.design.search import Search, SelectionOptions
from pincal.errors import MeasurementError
from pincal.estimation.observability.indices import Indices, identifiability, indices, r_diagonal
from pincal.files.mechanism_folders import GivenMechanism, as_mechanism
from pincal.kinematics.derivatives import leg_demand
from pincal.model.checks import count_of, described
from pincal.model.measurements import EVERY_LEG, Plan
from pincal.model.mechanism import Mechanism
from pincal.symmetry.detect import symmetry_group
from pincal.symmetry.elements import Element

if TYPE_CHECKING:
    from pandas import DataFrame

Array = NDArray[np.float64]
Protocol = Literal["independent", "symmetric", "orbits", "common"]


@dataclass(frozen=True)
class LegDesign:
    """What a selection gives one leg."""

    leg: str
    poses: int
    """Poses that serve the leg."""
    efficiency: float
    """(det/det of the continuous bound)^(1/n) of the search that chose them."""
    indices: Indices
    """Of the identification Jacobian in readings, not weighted."""
    r_diagonal: Array
    """|R_ii| of the same, shape (n_params,)."""
    condition: float


@dataclass(frozen=True, repr=False)
class Selection:
    """Selected poses and how good they are."""

    plan: Plan
    protocol: Protocol
    legs: tuple[LegDesign, ...]
    candidates: int
    """Candidate poses that all legs reach."""
    unreachable: int
    """Candidate poses that were left out, not being reached."""

    @property
    def efficiency(self) -> float:
        """Smallest efficiency of all legs."""
        return min(leg.efficiency for leg in self.legs)

    def to_dataframe(self) -> DataFrame:
        """Return a row for each leg: poses, efficiency, observability indices, condition."""
        import pandas as pd  # optional

        rows = [
            {"poses": leg.poses, "efficiency": leg.efficiency}
            | asdict(leg.indices)
            | {"condition": leg.condition}
            for leg in self.legs
        ]
        return pd.DataFrame(rows, index=pd.Index([leg.leg for leg in self.legs], name="leg"))

    def __repr__(self) -> str:
        what = f"{self.protocol}, {len(self.plan.poses)} poses of {self.candidates}"
        return f"Selection({what}, efficiency {self.efficiency:.3f})"

    def __str__(self) -> str:
        rows = [
            f"  {leg.leg:<12} {leg.poses:5d} {leg.efficiency:11.4f} {leg.condition:10.3g}"
            for leg in self.legs
        ]
        return "\n".join([repr(self), "  leg          poses  efficiency  condition", *rows])


def select_poses(
    mechanism: GivenMechanism,
    candidates: Array,
    count: int = 24,
    protocol: Protocol = "symmetric",
    **options: Any,
) -> Selection:
    """Return poses chosen from candidates for D-optimality, with a certificate.

    Rows are weighted by the noise they carry, so that poses near type-1 singularities do
    not look better than they are.

    Args:
        mechanism: The mechanism.
        candidates: Poses to choose from, coordinates of shape (M, dof), [m] and [rad]; one that
            is there twice counts once, whatever its whole turns and its last digits.
        count: Poses for each leg; with ``orbits``, number of orbits; with ``common``, poses.
        protocol: See the module.
        **options: ``noise``, ``seed``, ``starts``, ``progress``: see ``SelectionOptions``.

    Raises:
        ObservabilityError: too few poses for the parameters, too few candidates in reach, or
            candidates that leave a parameter undetermined.
        SymmetryError: the mechanism lacks the symmetry that ``symmetric`` or ``orbits`` needs.
        MeasurementError: a residual without noise.
    """
    mechanism = as_mechanism(mechanism)
    count_of(count, "count", MeasurementError)
    if not isinstance(protocol, str) or protocol not in get_args(Protocol):
        known = ", ".join(get_args(Protocol))
        raise MeasurementError(f"no protocol {described(protocol)}; expected one of {known}")
    search = Search(mechanism, candidates, SelectionOptions(**options))
    names = mechanism.leg_names
    if protocol == "independent":
        parts = [search.own(name, count) for name in names]
        poses = np.concatenate([search.candidates[chosen] for chosen, _ in parts])
        sets = tuple(name for name in names for _ in range(count))
        efficiencies = [efficiency for _, efficiency in parts]
    elif protocol == "common":
        chosen, efficiency = search.common(count)
        poses, sets = search.candidates[chosen], (EVERY_LEG,) * count
        efficiencies = [efficiency] * len(names)
    else:
        carriers = symmetry_group(mechanism).carriers()
        if protocol == "symmetric":
            chosen, efficiency = search.own(names[0], count)
            sets = tuple(name for name in names for _ in range(count))
        else:
            carriers = _closed(carriers)
            chosen, efficiency = search.orbits(names[0], count, carriers)
            sets = (EVERY_LEG,) * (count * len(carriers))
        first = search.candidates[chosen]
        poses = np.concatenate([g.poses(mechanism.platform, first) for g in carriers])
        efficiencies = [efficiency] * len(names)
    plan = Plan(poses, sets)
    legs = tuple(
        _leg_design(mechanism, name, plan, efficiency)
        for name, efficiency in zip(names, efficiencies, strict=True)
    )
    return Selection(plan, protocol, legs, search.usable, search.unreachable)


def _closed(elements: tuple[Element, ...]) -> tuple[Element, ...]:
    """Return the group that elements generate."""
    found = list(elements)
    for a in found:
        for b in elements:
            product = a.after(b)
            if not any(np.allclose(product.matrix, g.matrix, atol=1e-6) for g in found):
                found.append(product)
    return tuple(found)


def _leg_design(mechanism: Mechanism, leg: str, plan: Plan, efficiency: float) -> LegDesign:
    poses = plan.poses[plan.serves(leg)]
    rows = leg_demand(mechanism, leg, poses).as_joint()
    C = -rows.parameter.reshape(-1, rows.parameter.shape[2])
    names = [f"{leg}.{name}" for name in mechanism.leg(leg).parameter_names]
    condition = identifiability(C, names).condition
    return LegDesign(leg, len(poses), efficiency, indices(C), r_diagonal(C), condition)
