"""The unknowns: their values, which of them are free, and how steps move them.

Unknown are the parameters of legs, the poses, and quantities outside the mechanism: the base frame
in the frame of the measurements, T_frame_base; offsets of targets in the platform frame; the
rotation of a measured orientation against the platform; features that targets touch; and the
parameters of instruments. Fixed parameters, tied parameters and gauge freedoms are one thing:
φ = φ₀ + T z with fewer z than φ. Priors are rows beside those of the measurements.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from scipy.linalg import qr
from scipy.spatial.transform import Rotation

from pincal.errors import MeasurementError
from pincal.kinematics.batches import inverse_left_jacobian
from pincal.model import ORIGIN, Leg, Platform, Setup, means
from pincal.model.checks import ROUNDING
from pincal.model.relations import COORDINATES
from pincal.types import Array, Index

_PIXELS = 1e3  # order of focal lengths, [px]


@dataclass(frozen=True)
class External:
    """Values of the unknowns outside the mechanism."""

    frame: Array = field(default_factory=lambda: np.eye(4))
    """T_frame_base, shape (4, 4); the identity where poses are measured in the base frame."""
    offsets: Array = field(default_factory=lambda: np.zeros((1, 3)))
    """Positions of the targets in the platform frame, shape (n_targets, 3), [m]."""
    turn: Array = field(default_factory=lambda: np.eye(3))
    """R_platform_target of the measured orientation, shape (3, 3)."""
    features: Array = field(default_factory=lambda: np.zeros((0, 6)))
    """Coordinates of touched features, each along its own axes, shape (n_features, 6), [m] and
    [rad]: see ``pincal.model.relations``."""
    instruments: Array = field(default_factory=lambda: np.zeros(0))
    """Parameters of the instruments, in their order, shape (n_own,)."""


@dataclass(frozen=True)
class State:
    """Values of all unknowns."""

    parameters: Array
    """Parameters of the legs, shape (n_params,)."""
    matrices: Array
    """Poses ``T_base_platform``, shape (N, 4, 4)."""
    joints: tuple[Array, ...] = ()
    """Joint positions of each leg and its deformations, shape (N, n_joints [+ n_deformed]); empty
    before the first evaluation."""
    external: External = field(default_factory=External)
    """Unknowns outside the mechanism."""

    def rows(self, chosen: Index) -> Self:
        """Return the state at some poses."""
        joints = tuple(positions[chosen] for positions in self.joints)
        return replace(self, matrices=self.matrices[chosen], joints=joints)


class BlockRows(NamedTuple):
    """Residuals of a block at a state: k rows at each of N poses, zero where not active."""

    value: Array
    """Residuals, shape (N, k), [m] and [rad]."""
    by_pose: Array
    """Derivatives by the platform's twist, shape (N, k, dof)."""
    by_parameter: Array
    """Derivatives by the block's unknowns: parameters of all legs, or external ones, (N, k, n)."""
    by_measured: Array
    """Derivatives by the measurements: readings, or quantities of the platform, (N, k, m)."""
    joints: tuple[Array, ...] = ()
    """Joint positions of each leg and its deformations, shape (N, n_joints [+ n_deformed])."""


class ExternalUnknowns:
    """Which external values are unknown, in which order, and how steps move them.

    One vector holds all external values: six of the frame, three of each target and of the
    orientation's turn, six of each touched feature, then the parameters of instruments. The
    unknowns are some of its entries.
    """

    def __init__(self, platform: Platform, setup: Setup, oriented: bool) -> None:
        """List the unknowns of a setup, in which orientations are measured or not."""
        self.setup, planar, targets = setup, platform.space == 2, setup.targets
        devices = setup.device_parameters
        self.turned = oriented and targets[ORIGIN].unknown
        """Whether the measured orientation is turned against the platform's."""
        in_space = np.array([True, True, not planar])
        turns = np.array([not planar, not planar, True])
        free = [in_space & setup.unknown_frame, turns & setup.unknown_frame]
        free += [in_space & target.unknown for target in targets.values()]
        free += [turns & self.turned]
        features, sigmas, self.axes = setup.feature_places(platform.space)
        """Nominal axes of features as columns, shape (n_features, 3, 3)."""
        free += [sigmas.ravel() > 0.0]
        free += [np.ones(len(devices), dtype=bool)]
        self.free = np.flatnonzero(np.concatenate(free))
        """Indices of the unknowns in the vector of external values."""
        self.offsets = slice(6, 6 + 3 * len(targets))
        self.turn = slice(self.offsets.stop, self.offsets.stop + 3)
        self.features = slice(self.turn.stop, self.turn.stop + features.size)
        self.own = slice(self.features.stop, self.features.stop + len(devices))
        """Slices of the targets' offsets, the turn, the features and the instruments."""
        self.sigmas = sigmas
        """Standard deviations of the features' coordinates, 0 if known, shape (n_features, 6)."""
        priors = np.full(self.own.stop, np.inf)
        priors[self.features] = sigmas.ravel()
        priors[self.own] = [sigma for _, sigma in devices.values()]
        self.priors = priors[self.free]
        """Prior standard deviations of the unknowns, infinite without a prior."""
        stems = [("tracker.", "m"), ("tracker.r", "rad")]
        stems += [(f"{owner(name)}.", "m") for name in targets] + [("target.r", "rad")]
        every = [(f"{stem}{axis}", unit) for stem, unit in stems for axis in "xyz"]
        every += [(f"{name}.{c}", u) for name in setup.features for c, u in COORDINATES.items()]
        every += [(parameter.id, parameter.unit) for parameter, _ in devices.values()]
        self.names = tuple(every[place][0] for place in self.free)
        """Ids of the unknowns."""
        self.units = tuple(every[place][1] for place in self.free)
        offsets = np.array([target.offset for target in targets.values()], dtype=float)
        nominal = np.array([parameter.nominal for parameter, _ in devices.values()], dtype=float)
        self.start = External(np.eye(4), offsets, np.eye(3), features, nominal)
        """Nominal values by the setup, with the base frame equal to that of the measurements."""

    def __len__(self) -> int:
        return len(self.names)

    def sizes(self, size: float) -> Array:
        """Return the plausible magnitude of each unknown, (n,), for a machine's size [m]."""
        return np.array([{"m": size, "px": _PIXELS}.get(unit, 1.0) for unit in self.units])

    @cached_property
    def of_instruments(self) -> list[Index]:
        """Indices of each instrument's parameters among all of them; instruments may share some."""
        ids = list(self.setup.device_parameters)
        return [
            np.array([ids.index(parameter.id) for parameter in instrument.parameters], np.intp)
            for instrument in self.setup.instruments
        ]

    def begun(self, values: External, poses: Array, measured: Array) -> External:
        """Return values with the instruments' parameters where the search starts.

        ``poses`` are T_base_platform of the nominal machine, shape (N, 4, 4); ``measured`` is what
        all instruments read, shape (N, r).
        """
        begun, known, in_frame = values.instruments.copy(), dict[str, float](), values.frame @ poses
        for instrument, places in zip(self.setup.instruments, self.of_instruments, strict=True):
            width = len(instrument.columns)
            if begin := getattr(instrument, "begin", None):
                begun[places] = begin(in_frame, measured[:, :width], known)
                ids = (parameter.id for parameter in instrument.parameters)
                known |= dict(zip(ids, begun[places].tolist(), strict=True))
            measured = measured[:, width:]
        return replace(values, instruments=begun)

    def moved(self, values: External, step: Array) -> External:
        """Return the values after a step, (n,); the frame turns about its own origin."""
        change, frame = np.zeros(self.own.stop), values.frame.copy()
        change[self.free] = step
        frame[:3, 3] += change[:3]
        frame[:3, :3] = Rotation.from_rotvec(change[3:6]).as_matrix() @ frame[:3, :3]
        return External(
            frame,
            values.offsets + change[self.offsets].reshape(-1, 3),
            Rotation.from_rotvec(change[self.turn]).as_matrix() @ values.turn,
            values.features + change[self.features].reshape(-1, 6),
            values.instruments + change[self.own],
        )

    def coordinates(self, values: External) -> Array:
        """Return the unknowns as numbers, (n,), [m] and [rad]; rotations as rotation vectors."""
        turns = Rotation.from_matrix([values.frame[:3, :3], values.turn]).as_rotvec()
        parts = [values.frame[:3, 3], turns[0], values.offsets.ravel(), turns[1]]
        return np.concatenate([*parts, values.features.ravel(), values.instruments])[self.free]

    def coordinates_by_step(self, values: External) -> Array:
        """Return the derivative of ``coordinates`` by the steps of ``moved``, shape (n, n)."""
        turns = Rotation.from_matrix([values.frame[:3, :3], values.turn]).as_rotvec()
        D = np.eye(self.own.stop)
        D[3:6, 3:6], D[self.turn, self.turn] = inverse_left_jacobian(turns)
        return D[np.ix_(self.free, self.free)]


def owner(target: str) -> str:
    """Return the owner in the ids of a target's coordinates: ``target`` for the platform's own."""
    return "target" if target == ORIGIN else target


_SMALLEST_PRIOR = 1e-15  # [m], [rad] or [1]; rounding is larger than smaller priors
_TIED_WITHIN = 0.1  # relative or [m], [rad]: largest difference of nominal values that are tied


@dataclass(frozen=True)
class Unknowns:
    """All parameters of a problem, leg by leg, then the external ones, and which are free."""

    labels: tuple[str, ...]
    """Ids such as ``leg_1.l``, or ``tracker.x`` of an external unknown, length n."""
    start: Array
    """φ₀: nominal values, tied parameters at their mean, external ones zero, shape (n,)."""
    map: Array
    """T, shape (n, n_free)."""
    priors: Array
    """Prior standard deviations about the nominal values, infinite without a prior, shape (n,)."""
    nominal: Array
    """Nominal values, shape (n,)."""
    free_labels: tuple[str, ...]
    """Ids of the free parameters, length n_free."""

    @property
    def n_free(self) -> int:
        """Number of free unknowns."""
        return self.map.shape[1]

    def prior_rows(self, values: Array) -> tuple[Array, Array]:
        """Return residuals of the priors at values (n,), in σ, and their derivatives by z."""
        known = np.flatnonzero(np.isfinite(self.priors))
        sigma = self.priors[known]
        return (values[known] - self.nominal[known]) / sigma, self.map[known] / sigma[:, None]

    def free_rows(self, J: Array) -> Array:
        """Return derivatives by all unknowns, (…, n), as rows by the free ones, priors below."""
        _, prior = self.prior_rows(self.start)
        return np.concatenate((J.reshape(-1, J.shape[-1]) @ self.map, prior))

    def held(self, directions: Array) -> Self:
        """Return the unknowns restricted to g · z = 0 for directions g of shape (k, n_free)."""
        lost = len(directions)
        _, R, order = qr(directions, mode="economic", pivoting=True)
        follow, lead = order[:lost], np.sort(order[lost:])
        place = np.argsort(order)
        basis = np.zeros((len(order), len(lead)))
        basis[lead, np.arange(len(lead))] = 1.0
        basis[follow] = -np.linalg.solve(R[:, :lost], R[:, place[lead]])
        T = self.map @ basis
        T[np.abs(T) <= ROUNDING * np.abs(T).max(axis=0, initial=0.0)] = 0.0
        return replace(self, map=T, free_labels=tuple(self.free_labels[i] for i in lead))

    def part(self, legs: Sequence[str]) -> Self:
        """Return the unknowns of some legs."""
        owners = [label.partition(".")[0] for label in self.labels]
        rows = np.flatnonzero(np.isin(owners, list(legs)))
        columns = np.flatnonzero((self.map[rows] != 0.0).any(axis=0))
        return replace(
            self,
            labels=tuple(self.labels[i] for i in rows),
            start=self.start[rows],
            map=self.map[np.ix_(rows, columns)],
            priors=self.priors[rows],
            nominal=self.nominal[rows],
            free_labels=tuple(self.free_labels[i] for i in columns),
        )


def unknowns(
    legs: Sequence[Leg],
    external: Sequence[str] = (),
    *,
    fixed: Iterable[str] = (),
    tied: Iterable[str] = (),
    priors: Mapping[str, float] | None = None,
) -> Unknowns:
    """Return the unknowns of some legs, and external ones by their ids.

    Parameters are fixed at their nominal values, tied to one value for all legs, or have prior
    standard deviations about nominal values, [m], [rad] or [1]. A parameter is named ``l`` (of
    every leg that has one) or ``leg_1.l``; patterns such as ``leg_1.*`` or ``A_*`` name several.

    Raises:
        MeasurementError: a name is unknown, a tie is of one leg only, a parameter is both fixed
            and tied, or a standard deviation is not above zero.
    """
    pairs = [(leg.name, name) for leg in legs for name in leg.parameter_names]
    nominal = np.concatenate([*(leg.nominal for leg in legs), np.zeros(len(external))])
    start = nominal.copy()
    held = {i for name in fixed for i in _places(pairs, name)}
    if len(held) == len(pairs) and not external:
        raise MeasurementError("every parameter is fixed; leave one of them to be identified")
    groups, bound = list[list[int]](), set(held)
    for name in tied:
        places = _tied_places(pairs, name, nominal, bound)
        bound |= set(places)
        start[places] = nominal[places].mean()
        groups.append(places)
    sigmas = _prior_sigmas(pairs, priors or {}, len(nominal))
    sigmas[list(held)] = np.inf
    groups = sorted([*groups, *([i] for i in range(len(nominal)) if i not in bound)])
    T, ids = np.zeros((len(nominal), len(groups))), [*map(".".join, pairs), *external]
    for column, places in enumerate(groups):
        T[places, column] = 1.0
    free_labels = [
        ids[first] + (f" (tied to {len(further)} more)" if further else "")
        for first, *further in groups
    ]
    return Unknowns(tuple(ids), start, T, sigmas, nominal, tuple(free_labels))


def _tied_places(
    pairs: list[tuple[str, str]], name: str, nominal: Array, bound: set[int]
) -> list[int]:
    """Return the indices of tied parameters; several legs must have the same parameter."""
    places = _places(pairs, name)
    if len({pairs[place][1] for place in places}) > 1 or len(places) < 2 or "." in name:
        raise MeasurementError(
            f"{name!r} cannot be tied; give the name of a parameter that several legs have, "
            "such as 'l'"
        )
    if np.ptp(nominal[places]) > _TIED_WITHIN * max(1.0, float(np.abs(nominal[places]).max())):
        raise MeasurementError(
            f"{name!r} cannot be tied: its nominal values differ from leg to leg by up to "
            f"{np.ptp(nominal[places]):.3g}"
        )
    if fixed_too := bound & set(places):
        raise MeasurementError(f"{pairs[fixed_too.pop()][1]!r} is both fixed and tied; choose one")
    return places


def _prior_sigmas(pairs: list[tuple[str, str]], priors: Mapping[str, float], count: int) -> Array:
    """Return prior standard deviations, infinite without a prior, shape (count,)."""
    sigmas = np.full(count, np.inf)
    for name, sigma in priors.items():
        if not _SMALLEST_PRIOR <= sigma < np.inf:
            raise MeasurementError(
                f"the prior of {name!r} is {sigma:g}; expected a standard deviation above 0, at "
                f"least {_SMALLEST_PRIOR:g} (for a parameter that is known exactly, fix it)"
            )
        sigmas[_places(pairs, name)] = sigma
    return sigmas


def _places(pairs: list[tuple[str, str]], wanted_name: str) -> list[int]:
    """Return the indices of the parameters that a name or pattern means."""
    places = [i for i, (leg, name) in enumerate(pairs) if means(wanted_name, leg, name)]
    if not places:
        known = dict.fromkeys(name for _, name in pairs)
        raise MeasurementError(
            f"no parameter {wanted_name!r}; expected one of {', '.join(known)}, or of one leg as "
            f"'{pairs[0][0]}.{pairs[0][1]}'"
        )
    return places
