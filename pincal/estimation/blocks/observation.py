"""What is measured of the platform, predicted from its pose, with derivatives.

Positions of targets u = T_frame_base (r + R t), single coordinates of them, orientations,
single angles, distances |u − P|, and what further instruments read. Rows are predicted less
measured, in the frame of the measurements; derivatives are by the platform's twist in base axes
and by the external unknowns.

A single angle without a standard deviation of its own is part of an orientation, whose noise is
a small turn ω. Near a pole the angle follows it by J = ∂angle/∂ω, 1/h long. Its row is h times
the difference, the least turn that makes it up, and has the noise of ω along h J.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from pincal.errors import MeasurementError
from pincal.estimation.blocks.covariances import RowNoise, row_noise
from pincal.estimation.blocks.external import External, ExternalUnknowns
from pincal.kinematics.batches import inverse_left_jacobian, point_velocity, turn_between
from pincal.model.checks import wrapped
from pincal.model.measurements import Measurements, Noise
from pincal.model.mechanism import Mechanism
from pincal.model.orientation import SINGLE_ANGLES
from pincal.model.platform import Platform
from pincal.model.setup import Setup, checked
from pincal.types import Array, Index, Mask

Entry = tuple[Array, Array]
"""A function of orientations, shape (N,), and its derivative by turns, shape (N, 3)."""
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(0, 2, 1)  # matrices of e_a ×


def angle(name: str, R: Array) -> tuple[Entry, Entry]:
    """Return an angle of orientations and its h, each with its derivative by turns, outer axes.

    Args:
        name: ``yaw``, ``pitch``, ``roll`` (intrinsic Z-Y-X), ``azimuth``, ``tilt``, ``torsion``.
        R: Orientations, shape (N, 3, 3).

    Returns:
        The angle, [rad], and the h of which its derivative is 1/h long, 1 for pitch and tilt.
        Derivatives are zero where h is: the azimuth at tilt 0.
    """
    turned = _CROSS @ R[:, None]  # e_a × R, shape (N, 3, 3, 3)

    def entry(i: int, j: int, sign: float = 1.0) -> Entry:
        return sign * R[:, i, j], sign * turned[:, :, i, j]

    if name == "yaw":
        f, g = entry(1, 0), entry(0, 0)
    elif name == "pitch":
        f, g = entry(2, 0, -1.0), _length(entry(0, 0), entry(1, 0))
    elif name == "roll":
        f, g = entry(2, 1), entry(2, 2)
    elif name == "azimuth":
        f, g = entry(1, 2), entry(0, 2)
    elif name == "tilt":
        f, g = _length(entry(0, 2), entry(1, 2)), entry(2, 2)
    else:  # 1 + cos tilt, which is 2 h², times sine and cosine of the torsion
        f = _sum(entry(1, 0), entry(0, 1, -1.0))
        g = _sum(entry(0, 0), entry(1, 1))
    size, by_size = _length(f, g)
    safe = np.where(size > 0.0, size, 1.0)[:, None]
    slope = (g[0][:, None] * f[1] - f[0][:, None] * g[1]) / safe**2
    if name == "torsion":
        root = np.sqrt(0.5 * size)
        by_size = 0.25 * by_size / np.sqrt(0.5 * safe)
        size = root
    return (np.arctan2(f[0], g[0]), slope), (size, by_size)


def _length(a: Entry, b: Entry) -> Entry:
    size = np.hypot(a[0], b[0])
    safe = np.where(size > 0.0, size, 1.0)[:, None]
    return size, (a[0][:, None] * a[1] + b[0][:, None] * b[1]) / safe


def _sum(a: Entry, b: Entry) -> Entry:
    return a[0] + b[0], a[1] + b[1]


@dataclass(frozen=True)
class Rows:
    """Predicted less measured quantities at N poses; zero where nothing is measured."""

    value: Array
    """Shape (N, r), [m] and [rad]."""
    pose: Array
    """By the platform's twist, shape (N, r, dof)."""
    external: Array
    """By the external unknowns, shape (N, r, n_external)."""


class Observation:
    """What was measured of the platform at N poses."""

    def __init__(self, mechanism: Mechanism, data: Measurements, setup: Setup) -> None:
        """Hold what was measured.

        Args:
            mechanism: The mechanism.
            data: Measurements; NaN where nothing was measured.
            setup: What the numbers mean.

        Raises:
            MeasurementError: a column of the setup is missing.
        """
        platform = self.platform = mechanism.platform
        self.setup = setup
        axes, count = platform.space, len(data)
        lengths = platform.units.count("m")
        values = dict(zip(platform.coordinates[:lengths], data.poses.T, strict=False))
        for column in setup.columns(mechanism):
            values[column] = data.extra.get(column, np.full(len(data), np.nan))
        for name, whose in setup.required.items():
            if name not in data.extra:
                raise MeasurementError(f"no column {name!r}, {whose}")
        own = {c: unit for one in setup.instruments for c, unit in one.columns.items()}
        own_values = [values.pop(column) for column in own]
        self.orientations = _orientations(platform, data)
        """Measured orientations, shape (N, 3, 3); NaN where not measured in full."""
        whole = _whole(self.orientations)
        single = {name: data.extra[name] for name in SINGLE_ANGLES if name in data.extra}
        if platform.turns == 3:
            part = np.where(whole[:, None], np.nan, data.poses[:, lengths:])
            single |= dict(zip(platform.coordinates[lengths:], part.T, strict=True))
        single = {name: own for name, own in single.items() if np.isfinite(own).any()}
        self._angle_names = tuple(single)
        self._angles, self._parts = _angles(single, data, whole | (platform.turns < 3))
        """Measured single angles, [rad], and which are parts of an orientation, (N, angles)."""
        values |= single
        turn_names = platform.freedoms[lengths:]
        self.names = (*values, *turn_names, *own)
        self.units = ("m",) * (len(values) - len(single)) + ("rad",) * (
            len(single) + len(turn_names)
        )
        self.units += tuple(own.values())
        turned = np.repeat(whole[:, None], len(turn_names), axis=1)
        stacked = np.column_stack(list(values.values())) if values else np.empty((count, 0))
        self._own = np.column_stack(own_values) if own else np.empty((count, 0))
        self.measured: Mask = np.concatenate(
            (np.isfinite(stacked), turned, np.isfinite(self._own)), axis=1
        )
        """Which quantity is measured in which row, shape (N, r)."""
        self._values = np.where(self.measured[:, : stacked.shape[1]], stacked, 0.0)
        self._values[:, stacked.shape[1] - len(single) :] = 0.0
        self._turn_rows = [row - 3 for row in platform.twist_rows if row >= 3]
        oriented = bool(whole.any() or single)
        self.external = ExternalUnknowns(platform, setup, oriented)
        self._axes = axes

    def only(self, names: Sequence[str]) -> Observation:
        """Return the observation with nothing measured but the quantities named."""
        found = copy(self)
        found.measured = self.measured & np.isin(self.names, list(names))
        return found

    def anywhere(self) -> Observation:
        """Return the observation with every quantity measured that is measured in some row."""
        found = copy(self)
        found.measured = np.broadcast_to(self.measured.any(axis=0), self.measured.shape)
        whole = _whole(self.orientations)
        found.orientations = np.where(whole[:, None, None], self.orientations, np.eye(3))
        return found

    def rows(self, chosen: Index) -> Observation:
        """Return the observation at some rows."""
        found = copy(self)
        found.measured, found._values = self.measured[chosen], self._values[chosen]
        found.orientations, found._own = self.orientations[chosen], self._own[chosen]
        found._angles, found._parts = self._angles[chosen], self._parts[chosen]
        return found

    def noise(self, data: Measurements, noise: Noise) -> RowNoise:
        """Return the noise of all that is measured: each row's own, else that given.

        Raises:
            MeasurementError: covariances that no errors have.
        """
        return row_noise(self.names, self.units, data, noise, self.setup, self.platform)

    def noise_roots(self, roots: Array, matrices: Array, external: External) -> Array:
        """Return roots of the rows' noise, of those of what is measured, shape (N, r, r).

        Parts of an orientation follow the turn that is its noise, others their own.
        """
        if not self._parts.any():
            return roots
        predicted = external.frame[:3, :3] @ matrices[:, :3, :3] @ external.turn
        first = self.names.index(self.platform.freedoms[self.platform.lengths])
        by_turn, found = roots[:, first : first + len(self._turn_rows)], roots.copy()
        for column, name in enumerate(self._angle_names):
            along = self._angle(column, predicted)[2]
            part = self._parts[:, column] & along.any(axis=1)
            found[part, self.names.index(name)] = (along[part, None] @ by_turn[part])[:, 0]
        return found

    def systematic(self, matrices: Array, external: External) -> Array:
        """Return by how much all is off for one standard uncertainty of what is off in all rows.

        Columns are the scale of lengths and, axis by axis, the offset of each target that is taken
        as known.

        Returns:
            Shape (N, r, q); no columns where nothing is uncertain so.
        """
        setup, r = self.setup, len(self.names)
        off = [np.zeros((len(matrices), r, 0))]
        if setup.systematic.relative:
            lengths = np.array([unit == "m" for unit in self.units], dtype=bool)
            lengths[r - self._own.shape[1] :] = False  # instruments of one's own
            value = self.evaluate(matrices, external).value
            value[:, : self._values.shape[1]] += self._values
            off.append(setup.systematic.relative * np.where(lengths, value, 0.0)[:, :, None])
        if setup.systematic.target:
            free = {name: replace(one, unknown=True) for name, one in setup.targets.items()}
            every = copy(self)
            every.external = ExternalUnknowns(self.platform, replace(setup, targets=free), False)
            first = len(every.external.frame_rows)
            columns = [
                first + column
                for column, entry in enumerate(every.external.offset_entries)
                if entry not in self.external.offset_entries
            ]
            by = every.evaluate(matrices, external).external[:, :, columns]
            off.append(setup.systematic.target * by)
        return np.concatenate(off, axis=2)

    def evaluate(self, matrices: Array, external: External) -> Rows:
        """Return predicted less measured quantities and their derivatives.

        Args:
            matrices: Poses ``T_base_platform``, shape (N, 4, 4).
            external: Values of the external unknowns.
        """
        value, pose, outer = self._predicted(matrices, external)
        if self.setup.instruments:
            below = self._instruments(matrices, external)
            value, pose, outer = (
                np.concatenate(pair, axis=1)
                for pair in zip((value, pose, outer), below, strict=True)
            )
        n_scalar = self._values.shape[1]
        value[:, :n_scalar] -= self._values
        keep = self.measured
        return Rows(
            np.where(keep, value, 0.0),
            np.where(keep[:, :, None], pose, 0.0),
            np.where(keep[:, :, None], outer, 0.0),
        )

    def _predicted(self, matrices: Array, external: External) -> tuple[Array, Array, Array]:
        """Return predictions (of angles: less measured) and derivatives of all rows."""
        R, F = matrices[:, :3, :3], external.frame[:3, :3]
        unknowns, axes, n = self.external, self._axes, len(self.external.frame_rows)
        turned = self._turned(R, F, external)
        first = axes * len(self.setup.targets)  # of the rows after all positions
        count = first + len(self.setup.distances) + turned[0].shape[1]
        found = value, pose, outer = (
            np.empty((len(R), count)),
            np.empty((len(R), count, self.platform.dof)),
            np.empty((len(R), count, len(unknowns))),
        )
        points, by_pose, by_external = {}, {}, {}
        for index, target in enumerate(self.setup.targets):
            arm = R @ external.offsets[index]
            moved = (matrices[:, :3, 3] + arm) @ F.T
            points[target] = moved + external.frame[:3, 3]
            by_pose[target] = F @ point_velocity(arm, self.platform.twist_rows)
            by_external[target] = np.zeros((len(R), 3, len(unknowns)))
            by_external[target][:, :, :n] = point_velocity(moved, unknowns.frame_rows)
            for column, (other, axis) in enumerate(unknowns.offset_entries):
                if other == index:
                    by_external[target][:, :, n + column] = (F @ R)[:, :, axis]
            own = slice(index * axes, (index + 1) * axes)
            value[:, own], pose[:, own] = points[target][:, :axes], by_pose[target][:, :axes]
            outer[:, own] = by_external[target][:, :axes]
        for row, one in enumerate(self.setup.distances.values(), first):
            ray = points[one.target] - np.array(one.point)
            length = np.linalg.norm(ray, axis=1)
            with np.errstate(invalid="ignore", divide="ignore"):
                unit = (ray / length[:, None])[:, None]
            value[:, row], pose[:, row] = length, (unit @ by_pose[one.target])[:, 0]
            outer[:, row] = (unit @ by_external[one.target])[:, 0]
        for part, last in zip(found, turned, strict=True):
            part[:, count - last.shape[1] :] = last
        return found

    def _turned(self, R: Array, F: Array, external: External) -> tuple[Array, Array, Array]:
        """Return rows of single angles and of whole orientations, less what was measured."""
        unknowns, names = self.external, self._angle_names
        count, dof, n = len(names) + len(self._turn_rows), self.platform.dof, len(unknowns)
        value = np.empty((len(R), count))
        pose, outer = np.empty((len(R), count, dof)), np.empty((len(R), count, n))
        if not count:
            return value, pose, outer
        predicted = F @ R @ external.turn
        by_pose = np.zeros((len(R), 3, dof))  # turns of the prediction, outer axes
        for column, row in enumerate(self.platform.twist_rows):
            if row >= 3:
                by_pose[:, :, column] = F[:, row - 3]
        by_external = np.zeros((len(R), 3, n))
        for column, row in enumerate(unknowns.frame_rows):
            if row >= 3:
                by_external[:, row - 3, column] = 1.0
        last = unknowns.turn_columns.start
        for column, axis in enumerate(unknowns.turn_axes):
            by_external[:, :, last + column] = (F @ R)[:, :, axis]
        for row in range(len(names)):
            value[:, row], by_turn, _ = self._angle(row, predicted)
            pose[:, row] = (by_turn[:, None] @ by_pose)[:, 0]
            outer[:, row] = (by_turn[:, None] @ by_external)[:, 0]
        if not self._turn_rows:
            return value, pose, outer
        whole = _whole(self.orientations)
        error = np.zeros((len(R), 3))
        error[whole] = turn_between(predicted[whole], self.orientations[whole])
        spread, own = inverse_left_jacobian(error), list(self._turn_rows)
        value[:, len(names) :] = error[:, own]
        pose[:, len(names) :] = (spread @ by_pose)[:, own]
        outer[:, len(names) :] = (spread @ by_external)[:, own]
        return value, pose, outer

    def _angle(self, column: int, predicted: Array) -> tuple[Array, Array, Array]:
        """Return the row of a single angle, its derivative by turns, and by those that are noise.

        Shapes (N,), [rad], (N, 3), (N, 3).
        """
        (value, slope), (h, by_turn) = angle(self._angle_names[column], predicted)
        part = self._parts[:, column, None]
        missed, h = wrapped(value - self._angles[:, column])[:, None], h[:, None]
        row = np.where(part, h * missed, missed)[:, 0]
        along = h * slope
        return row, np.where(part, along + missed * by_turn, slope), along

    def _instruments(self, matrices: Array, external: External) -> tuple[Array, Array, Array]:
        """Return the conditions of the instruments, and derivatives as those of all rows."""
        platform, unknowns, frame = self.platform, self.external, external.frame
        count, r = self._own.shape
        value = np.empty((count, r))
        pose, outer = np.zeros((count, r, platform.dof)), np.zeros((count, r, len(unknowns)))
        # Twists of the platform in the frame's axes, by its own in base axes and by the frame's.
        by_base, by_frame = np.zeros((6, 6)), np.zeros((count, 6, 6))
        by_base[:3, :3] = by_base[3:, 3:] = frame[:3, :3]
        by_frame[:, :3] = point_velocity(matrices[:, :3, 3] @ frame[:3, :3].T, tuple(range(6)))
        by_frame[:, 3:, 3:] = np.eye(3)
        n_frame, first, begin = len(unknowns.frame_rows), 0, unknowns.own_columns.start
        for one in self.setup.instruments:
            end, last = first + len(one.columns), begin + len(one.parameters)
            values = external.own[begin - unknowns.own_columns.start :][: len(one.parameters)]
            given = one.condition(frame @ matrices, values, self._own[:, first:end])
            found = checked(given, one, count)
            value[:, first:end] = found.value
            pose[:, first:end] = found.by_pose @ by_base[:, list(platform.twist_rows)]
            outer[:, first:end, :n_frame] = (found.by_pose @ by_frame)[
                :, :, list(unknowns.frame_rows)
            ]
            outer[:, first:end, begin:last] = found.by_parameter
            first, begin = end, last
        return value, pose, outer


def _angles(single: dict[str, Array], data: Measurements, apart: Mask) -> tuple[Array, Mask]:
    """Return single angles, zero where not measured, and which have the noise of a turn.

    Those of rows apart, or with a standard deviation of their own, have not.
    """
    angles = np.reshape([*single.values()], (len(single), len(data))).T
    parts = np.isfinite(angles) & ~apart[:, None]
    for place, name in enumerate(single):
        parts[:, place] &= ~np.isfinite(data.sigma_extra.get(name, np.nan))
    parts &= parts.sum(axis=1, keepdims=True) <= 3
    return np.where(np.isfinite(angles), angles, 0.0), parts


def _whole(orientations: Array) -> Mask:
    """Return which orientations were measured, shape (N,)."""
    return np.asarray(np.isfinite(orientations).all(axis=(1, 2)))


def _orientations(platform: Platform, data: Measurements) -> Array:
    """Return measured orientations, shape (N, 3, 3); NaN where not measured in full."""
    turns = np.full((len(data), 3, 3), np.nan)
    rad = [i for i, unit in enumerate(platform.units) if unit == "rad"]
    if rad:
        whole = np.isfinite(data.poses[:, rad]).all(axis=1)
        full = np.zeros((int(whole.sum()), platform.dof))
        full[:, rad] = data.poses[whole][:, rad]
        turns[whole] = platform.matrices(full)[:, :3, :3]
    return turns
