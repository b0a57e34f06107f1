"""Measurements of the platform, predicted from its pose, with derivatives.

Measured are positions of targets u = T_frame_base (r + R t), single coordinates of them,
orientations, relations, and what further instruments read. Residuals are predicted minus measured.
Derivatives are by the platform's twist in the frame of the measurements; those by the twist in base
axes and by the frame follow from them.

A relation (``pincal.model.relations``) is a distance by which u misses a feature that it touches,
or a distance from row to row, measured from one row's target to the point where the other row's
target was. It holds at the rows whose column names one of its features.
"""

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from typing import Self, TypeAlias

import numpy as np

from pincal.errors import MeasurementError
from pincal.estimation.noise import RowNoise, row_noise
from pincal.estimation.unknowns import BlockRows, External, ExternalUnknowns, State
from pincal.kinematics.batches import inverse_left_jacobian, point_velocity, turn_between
from pincal.kinematics.configurations import shifted
from pincal.model import ORIGIN, ROW, Measurements, Mechanism, Noise, Plan, Platform, Setup
from pincal.model.platform import in_part
from pincal.model.relations import Instrument, Relation, evaluated, missed
from pincal.types import Array, Index, Mask

Predicted: TypeAlias = tuple[Array, Array, Array]
"""Rows, shape (N, k), derivatives by the platform's twist in the frame of the measurements, (N, k,
6), and by external values except that frame, (N, k, n)."""
_TWIST = (0, 1, 2, 3, 4, 5)
_STEPS = 20  # largest number of steps of the features to least squares
_STILL = 1e-13  # relative change of their coordinates that is negligible


class Observation:
    """The residual block of what was measured of the platform at N poses."""

    def __init__(self, mechanism: Mechanism, data: Measurements, setup: Setup) -> None:
        """Collect the measured quantities.

        Raises:
            MeasurementError: a column of the setup is missing, or an orientation is measured in
                part.
        """
        platform = self.platform = mechanism.platform
        self.setup = setup
        for name, purpose in setup.required.items():
            if name not in {**data.extra, **data.contacts}:
                raise MeasurementError(f"no column {name!r}, {purpose}")
        none, lengths = np.full(len(data), np.nan), platform.lengths
        scalars = dict(zip(platform.coordinates[:lengths], data.poses.T, strict=False))
        scalars |= {name: data.extra.get(name, none) for name in setup.columns(mechanism)}
        lengths_read, self.meets = _meetings(platform, data, setup)
        """Index of the feature that each row touches, -1 for none, shape (N, n_relations)."""
        scalars |= lengths_read
        units = {name: u for device in setup.instruments for name, u in device.columns.items()}
        conditions = [scalars.pop(name) for name in units]
        oriented = np.isfinite(data.poses[:, lengths:]).all(axis=1) & (platform.turns > 0)
        self.orientations = np.full((len(data), 3, 3), np.nan)
        """Measured orientations, shape (N, 3, 3); NaN where not measured."""
        turned = platform.matrices(np.nan_to_num(data.poses[oriented]))
        self.orientations[oriented] = turned[:, :3, :3]
        if (part := np.isfinite(data.poses[:, lengths:]).any(axis=1) & ~oriented).any():
            what = in_part(platform.coordinates[lengths:])
            raise MeasurementError(f"{data.place(int(np.argmax(part)))}: {what}")
        turns = platform.freedoms[lengths:]
        self.names = (*scalars, *turns, *units)
        """Names of the r quantities: columns of the measurements, or freedoms of the platform."""
        self.units = (*["m"] * len(scalars), *["rad"] * len(turns), *units.values())
        known = [*scalars.values(), *[np.where(oriented, 0.0, np.nan)] * len(turns)]
        table = np.column_stack([np.empty((len(data), 0)), *known, *conditions])
        self.measured: Mask = np.isfinite(table)
        """Which quantities are measured in which rows, shape (N, r)."""
        self._values = np.where(self.measured, table, 0.0)
        self._values[:, len(scalars) :] = 0.0  # their predictions are residuals already
        self.conditions = table[:, len(known) :]
        """What instruments read, shape (N, …); NaN where they read nothing."""
        self._turn_rows = [row - 3 for row in platform.twist_rows if row >= 3]
        self.external = ExternalUnknowns(platform, setup, bool(oriented.any()))
        self.noise = RowNoise(np.zeros(self.measured.shape))
        """Noise of the quantities; zero until it is set."""

    @property
    def active(self) -> Mask:
        """Which rows were measured, shape (N, r)."""
        return self.measured

    @property
    def sigma(self) -> Array:
        """Standard deviations of the quantities, shape (N, r), [m] or [rad]."""
        return self.noise.sigma

    @property
    def quantities(self) -> dict[str, str]:
        """Names and units (m or rad) of the quantities whose noise the columns of S are."""
        return {f"measured {name}": u for name, u in zip(self.names, self.units, strict=True)}

    def named(self, quantity: str, row: int) -> str:
        """Return the name of a quantity in a row; a distance names the row it is measured from."""
        name = quantity.removeprefix("measured ")
        if name not in self.setup.between_rows:
            return quantity
        row_point = [*self.setup.touched][self.meets[row, [*self.setup.distances].index(name)]]
        return f"{name.partition('_')[0]} to {row_point.replace('_', ' ', 1)}"

    def only(self, names: Sequence[str]) -> Self:
        """Return the observation with only the named quantities measured."""
        return self.changed(measured=self.measured & np.isin(self.names, list(names)))

    def anywhere(self) -> Self:
        """Return the observation with every quantity measured in all rows if it is in some.

        Orientations are as predicted at any pose. Contacts and distances between rows are left as
        they are, since a feature that a row does not touch may be anywhere.
        """
        somewhere: Mask = np.asarray(self.measured.any(axis=0))
        somewhere[np.isin(self.names, self.setup.between_rows)] = False
        for columns in self.setup.contact_axes(self.platform).values():
            somewhere[np.isin(self.names, columns)] = False
        return self.changed(
            measured=self.measured | somewhere,
            orientations=np.full_like(self.orientations, np.nan),
        )

    def visible(self, matrices: Array, external: External) -> Self:
        """Return the observation without the points that cameras do not see at the poses.

        ``matrices`` are ``T_base_platform``, shape (N, 4, 4).
        """
        hidden = self._of_devices("visible", matrices, external) == 0.0
        return self.changed(measured=self.measured & ~hidden)

    def metres_per_pixel(self, matrices: Array, external: External) -> Array:
        """Return the size of a pixel at each seen point, (N, r), [m/px]; NaN of other columns."""
        return self._of_devices("metres_per_pixel", matrices, external)

    def _of_devices(self, method: str, matrices: Array, external: External) -> Array:
        values, poses = np.full(self.measured.shape, np.nan), external.frame @ matrices
        for instrument, columns, places in self._devices():
            if ask := getattr(instrument, method, None):
                values[:, columns] = ask(poses, external.instruments[places])
        return values

    def _devices(self) -> Iterator[tuple[Instrument, slice, Index]]:
        """Yield instruments, their columns among quantities, and indices of their parameters."""
        begin = len(self.names) - self.conditions.shape[1]
        pairs = zip(self.setup.instruments, self.external.of_instruments, strict=True)
        for instrument, places in pairs:
            columns = slice(begin, begin + len(instrument.columns))
            yield instrument, columns, places
            begin = columns.stop

    def at(self, rows: Index) -> Self:
        """Return the observation at some rows."""
        arrays = ("measured", "orientations", "_values", "conditions")
        parts = {name: getattr(self, name)[rows] for name in (*arrays, "meets")}
        return self.changed(noise=self.noise.rows(rows), **parts)

    def changed(self, **changes: object) -> Self:
        """Return the observation with other attributes, such as ``noise``."""
        changed = copy(self)
        vars(changed).update(changes)
        return changed

    def row_noise(self, data: Measurements, noise: Noise) -> RowNoise:
        """Return the noise of all quantities: each row's own, else the general one."""
        return row_noise(self.names, self.units, data, noise, self.setup, self.platform)

    @property
    def single(self) -> Mask:
        """Which quantities have independent noise (pixels), shape (r,)."""
        return np.array([unit == "px" and self.noise.correlation is None for unit in self.units])

    def noise_root(self, quantities: Index | None = None) -> Array:
        """Return the root of the rows' noise, shape (N, r, r); zero where nothing is measured.

        ``quantities`` restricts it to some that are not correlated with the others.
        """
        measured, noise = self.measured, self.noise
        if quantities is not None:
            measured, noise = measured[:, quantities], RowNoise(noise.sigma[:, quantities])
        return np.where(measured[:, :, None], noise.roots, 0.0)

    def systematic(self, matrices: Array, external: External) -> Array:
        """Return the errors of all quantities by one standard uncertainty of systematic errors.

        The q columns, shape (N, r, q), are the scale of lengths and, axis by axis, the offset of
        each known target; there are none without systematic uncertainties.
        """
        setup, r = self.setup, len(self.names)
        errors = [np.zeros((len(matrices), r, 0))]
        if setup.systematic.relative:
            lengths = np.array([unit == "m" for unit in self.units], dtype=bool)
            lengths[r - self.conditions.shape[1] :] = False
            value = self.residuals(matrices, external)[0] + self._values
            errors.append(setup.systematic.relative * np.where(lengths, value, 0.0)[:, :, None])
        if setup.systematic.target:
            axes = np.arange(self.external.own.stop)[self.external.offsets].reshape(-1, 3)
            known = np.setdiff1d(axes[:, : self.platform.space], self.external.free)
            _, _, by_external = self.residuals(matrices, external, known)
            errors.append(setup.systematic.target * by_external)
        return np.concatenate(errors, axis=2)

    def evaluate(self, state: State) -> BlockRows:
        """Return the residuals at a state; the unknowns are the external ones."""
        value, by_pose, by_external = self.residuals(state.matrices, state.external)
        by_measured = np.broadcast_to(-np.eye(value.shape[1]), (*value.shape, value.shape[1]))
        return BlockRows(value, by_pose, by_external, by_measured)

    def residuals(
        self, matrices: Array, external: External, columns: Index | None = None
    ) -> tuple[Array, Array, Array]:
        """Return predicted less measured quantities at poses, zero where nothing is measured.

        Poses are ``T_base_platform``, (N, 4, 4). Residuals, (N, r), [m] and [rad], come with their
        derivatives by the platform's twist, (N, r, dof), and by external values, (N, r, n): those
        with indices ``columns``, by default the unknown ones.
        """
        columns = self.external.free if columns is None else columns
        poses, frame = external.frame @ matrices, external.frame[:3, :3]
        rows = self._position_rows(poses, external)
        rows += [self._orientation_rows(poses[:, :3, :3], external)]
        rows += self._instrument_rows(poses, external)
        value, by_twist, by_external = (
            np.concatenate(part, axis=1) for part in zip(*rows, strict=True)
        )
        by_base, by_frame = np.zeros((6, 6)), np.zeros((len(matrices), 6, 6))
        by_base[:3, :3] = by_base[3:, 3:] = frame
        by_frame[:, :3] = point_velocity(matrices[:, :3, 3] @ frame.T, _TWIST)
        by_frame[:, 3:, 3:] = np.eye(3)
        by_external[:, :, :6] = by_twist @ by_frame
        measured = self.measured[:, :, None]
        return (
            np.where(self.measured, value - self._values, 0.0),
            np.where(measured, by_twist @ by_base[:, list(self.platform.twist_rows)], 0.0),
            np.where(measured, by_external[:, :, columns], 0.0),
        )

    def targets(self, poses: Array, external: External) -> dict[str, Predicted]:
        """Return rows of all targets' positions at poses ``T_frame_platform``, (N, 4, 4)."""
        R, points = poses[:, :3, :3], dict[str, Predicted]()
        for index, target in enumerate(self.setup.targets):
            arm = R @ external.offsets[index]
            by_external = np.zeros((len(R), 3, self.external.own.stop))
            by_external[:, :, self.external.offsets][:, :, 3 * index : 3 * index + 3] = R
            points[target] = (poses[:, :3, 3] + arm, point_velocity(arm, _TWIST), by_external)
        return points

    def touches(self) -> Iterator[tuple[str, Index, Mask]]:
        """Yield each touched feature's name, its columns of residuals, and rows that touch it."""
        axes = self.setup.contact_axes(self.platform)
        meets = self.meets[:, len(self.setup.distances) :]
        for place, (name, (contact, _, _)) in enumerate(self.setup.touched.items()):
            columns = np.flatnonzero(np.isin(self.names, axes[contact]))
            yield name, columns, np.asarray((meets == place).any(axis=1))

    def at_touch(self, matrices: Array, external: External) -> External:
        """Return the values with unknown features fitted by least squares to poses (N, 4, 4)."""
        outside, contacts = self.external, self.setup.touched
        unknown = np.isinf(outside.sigmas)
        every = np.arange(outside.features.start, outside.features.stop)
        if not unknown.any():
            return external
        points = self.targets(external.frame @ matrices, external)
        features = external.features.copy()
        met_by = [*self.touches()]
        for place, (name, _, rows) in enumerate(met_by):
            contact = contacts[name][2]
            if contact.shape in ("circle", "sphere") and unknown[place, 0] and rows.any():
                w = points[contact.target][0][rows] @ contact.axes
                features[place] = _circle(w, 2 if contact.shape == "circle" else 3, features[place])
        for _ in range(_STEPS):
            external = replace(external, features=features)
            value, _, by_features = self.residuals(matrices, external, every)
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

    def touching(
        self, mechanism: Mechanism, plan: Plan, external: External, errors: Array | float = 0.0
    ) -> Plan:
        """Return a plan with platforms shifted until they touch their features.

        They touch them up to errors, (N, 3), [m]; unknown features are fitted by least squares.
        """
        axes = self.setup.contact_axes(self.platform).values()
        columns = np.isin(self.names, [name for names in axes for name in names])
        linear = [row for row in self.platform.twist_rows if row < 3]

        def shifts(matrices: Array) -> Array:
            nearest = self.at_touch(matrices, external)
            value, by_pose, _ = self.residuals(matrices, nearest)
            along, shift = by_pose[:, columns, : len(linear)], np.zeros((len(matrices), 3))
            shift[:, linear] = -np.einsum("nkd,nk->nd", along, value[:, columns])
            return np.asarray(shift + np.broadcast_to(errors, shift.shape) @ external.frame[:3, :3])

        return shifted(mechanism, plan, shifts)

    def _position_rows(self, poses: Array, external: External) -> list[Predicted]:
        """Return rows of coordinates of targets, and of the features that they touch."""
        points, rows = self.targets(poses, external), []
        for target, (u, D, E) in points.items():  # of the origin only the axes it moves along
            axes = self.platform.lengths if target == ORIGIN else self.platform.space
            rows.append((u[:, :axes], D[:, :axes], E[:, :axes]))
        relations = self.setup.relations(self.platform.space)
        for relation, places in zip(relations, self.meets.T, strict=True):
            rows.append(_met(relation, places, points[relation.target], external, self.external))
        return rows

    def _orientation_rows(self, R: Array, external: External) -> Predicted:
        """Return rows of orientations, predicted minus measured, as rotation vectors."""
        error = np.zeros((len(R), 3))
        oriented = np.isfinite(self.orientations).all(axis=(1, 2))
        if self._turn_rows:
            predicted = R[oriented] @ external.turn
            error[oriented] = turn_between(predicted, self.orientations[oriented])
        by_turn = inverse_left_jacobian(error)[:, self._turn_rows]
        by_external = np.zeros((*by_turn.shape[:2], self.external.own.stop))
        by_external[:, :, self.external.turn] = by_turn @ R
        value = error[:, self._turn_rows]
        return value, np.pad(by_turn, ((0, 0), (0, 0), (3, 0))), by_external

    def _instrument_rows(self, poses: Array, external: External) -> list[Predicted]:
        rows, first = [], len(self.names) - self.conditions.shape[1]
        for instrument, columns, places in self._devices():
            read = self.conditions[:, columns.start - first : columns.stop - first]
            values = external.instruments[places]
            value, by_pose, by_own = evaluated(instrument, poses, values, read)
            by_external = np.zeros((*value.shape, self.external.own.stop))
            by_external[:, :, self.external.own.start + places] = by_own
            rows.append((value, by_pose, by_external))
        return rows


def _meetings(
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


def _met(
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


def _circle(w: Array, dimensions: int, feature: Array) -> Array:
    """Return a circle or sphere through points (N, 3) in the feature's axes (I. Kåsa 1976)."""
    flat = w[:, :dimensions]
    A = np.column_stack((2.0 * flat, np.ones(len(flat))))
    *centre, constant = np.linalg.lstsq(A, (flat**2).sum(axis=1))[0]
    place = w.mean(axis=0)
    place[:dimensions] = centre
    radius = np.sqrt(max(constant + np.sum(np.square(centre)), 0.0))
    return np.array([*place, 0.0, 0.0, feature[5] or radius])
