"""Relations: rows that touch the same feature, and distances measured from row to row.

A relation holds at the rows whose column names one of its features. Its residuals depend on the
row's target and on that feature (``pincal.model.relations``). A distance between two rows is
measured from one row's target to the point where the other row's target was.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from pincal.errors import MeasurementError
from pincal.kinematics.configurations import shifted
from pincal.model.measurements import Measurements, Plan
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Platform
from pincal.model.relations import ROW, Relation, missed
from pincal.model.setup import Setup
from pincal.types import Array, Index, Mask

if TYPE_CHECKING:
    from pincal.estimation.observation import Observation
    from pincal.estimation.unknowns import External, ExternalUnknowns

Predicted: TypeAlias = tuple[Array, Array, Array]
"""Rows, shape (N, k), derivatives by the platform's twist in the frame of the measurements, (N, k,
6), and by external values except that frame, (N, k, n)."""
_STEPS = 20  # largest number of steps of the features to least squares
_STILL = 1e-13  # relative change of their coordinates that is negligible


def meetings(
    platform: Platform, data: Measurements, setup: Setup
) -> tuple[dict[str, Array], Index]:
    """Return the readings of each quantity, (N,), and indices of features, (N, n_relations).

    A contact reads zero. A row without a feature reads NaN and has index -1.

    Raises:
        MeasurementError: a column names a feature that the setup does not have.
    """
    ids = {name: place for place, name in enumerate(setup.features)}
    columns, meets = dict[str, Array](), list[list[int]]()
    for relation in setup.relations(platform.space):
        owner = relation.owner
        names, known = (owner,) * len(data), {owner: ids.get(owner, -1)}
        if relation.column:
            names = data.contacts[relation.column]
            known = {name: ids[f"{owner}_{name}"] for name in setup.contacts[owner].points}
        if owner != ROW and (strange := {*names} - {"", *known}):
            raise MeasurementError(
                f"{data.place(names.index(min(strange)))}: {relation.column} {min(strange)!r} is "
                f"no point of the setup, which has {', '.join(known)}; add it there as 'unknown', "
                "or correct the name"
            )
        meets.append([known.get(name, -1) for name in names])
        somewhere = np.array(meets[-1], dtype=np.intp) >= 0
        for name in relation.quantities:
            values = data.extra[name] if name in relation.read else np.zeros(len(data))
            columns[name] = np.where(somewhere, values, np.nan)
    return columns, np.reshape(meets, (len(meets), len(data))).T.astype(np.intp)


def met(
    relation: Relation,
    places: Index,
    target: Predicted,
    external: External,
    outside: ExternalUnknowns,
) -> Predicted:
    """Return the rows of a relation from those of its target and the indices of features (N,)."""
    point, by_twist, by_external = target
    places = np.maximum(places, 0)  # rows without a feature do not count
    value, by_point, by_feature = missed(
        relation, point, external.features[places], outside.axes[places]
    )
    by_external = by_point @ by_external
    columns = outside.features.start + 6 * places[:, None] + np.arange(6)
    by_external[np.arange(len(places))[:, None], :, columns] = by_feature.transpose(0, 2, 1)
    return value, by_point @ by_twist, by_external


def touches(observation: Observation) -> Iterator[tuple[str, Index, Mask]]:
    """Yield each touched feature's name, its columns of residuals, and the rows that touch it."""
    setup = observation.setup
    axes = setup.contact_axes(observation.platform)
    meets = observation.meets[:, len(setup.distances) :]
    for place, (name, (contact, _, _)) in enumerate(setup.touched.items()):
        columns = np.flatnonzero(np.isin(observation.names, axes[contact]))
        yield name, columns, np.asarray((meets == place).any(axis=1))


def at_touch(observation: Observation, matrices: Array, external: External) -> External:
    """Return the values with unknown features fitted by least squares to poses (N, 4, 4)."""
    outside, contacts = observation.external, observation.setup.touched
    unknown = np.isinf(outside.sigmas)
    every = np.arange(outside.features.start, outside.features.stop)
    if not unknown.any():
        return external
    points = observation.targets(external.frame @ matrices, external)
    features = external.features.copy()
    met_by = [*touches(observation)]
    for place, (name, _, rows) in enumerate(met_by):
        contact = contacts[name][2]
        if contact.shape in ("circle", "sphere") and unknown[place, 0] and rows.any():
            w = points[contact.target][0][rows] @ contact.axes
            features[place] = _circle(w, 2 if contact.shape == "circle" else 3, features[place])
    for _ in range(_STEPS):
        external = replace(external, features=features)
        value, _, by_features = observation.residuals(matrices, external, every)
        step = np.zeros_like(features)
        for place, (_, columns, rows) in enumerate(met_by):
            if rows.any() and (free := np.flatnonzero(unknown[place])).size:
                J = by_features[np.ix_(rows, columns, 6 * place + free)].reshape(-1, len(free))
                step[place, free] = -np.linalg.lstsq(J, value[np.ix_(rows, columns)].ravel())[0]
        features = features + step
        straight = all(contact.shape == "point" for _, _, contact in contacts.values())
        if straight or np.abs(step).max() <= _STILL * np.abs(features).max():
            break
    return replace(external, features=features)


def _circle(w: Array, dimensions: int, feature: Array) -> Array:
    """Return a circle or sphere through points (N, 3) in the feature's axes (I. Kåsa 1976)."""
    flat = w[:, :dimensions]
    A = np.column_stack((2.0 * flat, np.ones(len(flat))))
    *centre, constant = np.linalg.lstsq(A, (flat**2).sum(axis=1))[0]
    place = w.mean(axis=0)
    place[:dimensions] = centre
    radius = np.sqrt(max(constant + np.sum(np.square(centre)), 0.0))
    return np.array([*place, 0.0, 0.0, feature[5] or radius])


def touching(
    observation: Observation,
    mechanism: Mechanism,
    plan: Plan,
    external: External,
    errors: Array | float = 0.0,
) -> Plan:
    """Return a plan with platforms shifted until they touch their features up to errors (N, 3) [m].

    Unknown features are fitted by least squares.
    """
    platform, setup = observation.platform, observation.setup
    axes = setup.contact_axes(platform).values()
    columns = np.isin(observation.names, [name for names in axes for name in names])
    linear = [row for row in platform.twist_rows if row < 3]

    def shifts(matrices: Array) -> Array:
        nearest = at_touch(observation, matrices, external)
        value, by_pose, _ = observation.residuals(matrices, nearest)
        along, shift = by_pose[:, columns, : len(linear)], np.zeros((len(matrices), 3))
        shift[:, linear] = -np.einsum("nkd,nk->nd", along, value[:, columns])
        return np.asarray(shift + np.broadcast_to(errors, shift.shape) @ external.frame[:3, :3])

    return shifted(mechanism, plan, shifts)
