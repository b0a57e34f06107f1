"""Conditions on a platform: features that its targets meet, and instruments that read its pose.

Features are points, planes, lines, circles and spheres that stand still, the same for many rows.

A feature has its own frame, at p and turned by R, about x and then y, in axes A whose z is the
nominal direction. In this frame, the target of a row, at u in the frame of the measurements, is at

        w = Rᵀ (Aᵀ u − p).

It misses the feature by coordinates of w, or by r, the distance of w from the axis or origin less
the radius: a point by x, y and z, a plane by z, a line by x and y, a circle by r and z, a sphere by
r. The target's position in another row is a feature, too: the distance from it is r, a height z.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MeasurementError
from pincal.model.checks import check_kinds, check_sizes, listed, named_points, number_of, set_point
from pincal.model.parameter import Parameter
from pincal.types import Array, Point

ORIGIN = "platform"
"""Name of the target whose position is in the columns x, y, z."""
ROW = "row"
"""Column, and contact, of the names of rows to which other rows' distances are measured."""
TO = "_to"
"""Suffix of the column that names the row from which another column is measured."""
COORDINATES = {"x": "m", "y": "m", "z": "m", "rx": "rad", "ry": "rad", "radius": "m"}
"""Coordinates of a feature, with units; p is x, y, z, and R turns by rx, then ry."""
SHAPES = {
    3: {
        "point": ("xyz", "x y z"),
        "plane": ("z", "z rx ry"),
        "line": ("xy", "x y rx ry"),
        "circle": ("rz", "x y z rx ry radius"),
        "sphere": ("r", "x y z radius"),
    },
    2: {
        "point": ("xy", "x y"),
        "line": ("x", "x ry"),
        "circle": ("r", "x y radius"),
    },
}
"""Misses of each shape and its coordinates that may be unknown, by dimension of space."""


class Relation(NamedTuple):
    """Condition between the target of a row and a feature that rows share."""

    name: str
    target: str
    shape: str
    column: str
    """Column that names the feature that each row meets; empty if all rows meet the same."""
    owner: str
    """Prefix of the features' names: ``socket`` owns ``socket_A``."""
    quantities: tuple[str, ...]
    """Names of the misses, whether they are read or zero."""
    ways: str
    """Kind of each quantity: a coordinate x, y or z of w, or r."""
    read: tuple[str, ...]
    """Quantities that have a column; the others are zero."""
    noise: float | None
    """Standard deviation of the quantities, [m], if the setup gives it."""


@dataclass(frozen=True)
class Distance:
    """Measured distance to a target from a known point, or from the target in another row."""

    point: Point | None
    """Known point in the frame of the measurements, [m]; None for the target's position in the row
    that a column names (see ``Setup.of_rows``)."""
    target: str = ORIGIN
    along: int | None = None
    """Axis, 0 to 2, of that frame along which it is measured; None for the straight distance."""
    noise: float | None = None
    """Standard deviation, [m]; by default that of positions."""

    def __post_init__(self) -> None:
        if self.point is not None:
            set_point(self, "point", "point of a distance", MeasurementError)
        check_kinds(vars(self), Distance, MeasurementError)
        check_sizes(self, ("noise",) * (self.noise is not None), "distance's", MeasurementError)

    def relation(self, name: str, _space: int) -> Relation:
        """Return the relation of this distance, which is read in the column ``name``."""
        way = "r" if self.along is None else "xyz"[self.along]
        owner, leads = (name, "") if self.point else (ROW, f"{name}{TO}")
        return Relation(
            name, self.target, "sphere", leads, owner, (name,), way, (name,), self.noise
        )


@dataclass(frozen=True)
class Contact:
    """Contact of a target with features that stand still: sockets, a plate, an edge, a ring.

    The column of the contact's name has the name of the feature that the target meets in each row.
    With a gauge, a further column has the miss: ``plate_z [mm]`` along a plane's normal,
    ``bar_r [mm]`` of a ball bar's length.

    >>> import pincal
    >>> sockets = pincal.Contact({"A": None, "B": (0.3, 0.1, 0.05)}, noise=2e-5)
    >>> pincal.Setup(contacts={"socket": sockets}).contacts["socket"].points["B"]
    (0.3, 0.1, 0.05)
    >>> plate = pincal.Contact({"lower": None, "upper": None}, shape="plane", gauge=True)
    >>> list(pincal.Setup(contacts={"plate": plate}).required)
    ['plate', 'plate_z']
    """

    points: Mapping[str, Point | None]
    """Positions of the features by name, in the frame of the measurements, [m]: points, centres, or
    points on planes and lines; None if it is to be identified, together with the orientation."""
    target: str = ORIGIN
    tolerance: float = 0.0
    """Standard deviation of each coordinate of the points whose position is known, [m]."""
    noise: float | None = None
    """Standard deviation of the miss along each axis, or of the gauge, [m]; by default that of
    positions."""
    shape: str = "point"
    """Shape of the features: ``point``, ``plane``, ``line``, ``circle`` or ``sphere``."""
    axis: Point | None = None
    """Nominal normal of planes, direction of lines, axis of circles; by default z, of lines x."""
    radius: float | None = None
    """Radius of circles and spheres, [m]; None if it is to be identified."""
    gauge: bool = False
    """Whether a column has the miss of a plane, circle or sphere; otherwise it is touched."""

    def __post_init__(self) -> None:
        error, radius = MeasurementError, self.radius
        object.__setattr__(self, "points", named_points(self.points, "a contact", error))
        check_kinds(vars(self), Contact, error)
        check_sizes(self, ["tolerance", *["noise"] * (self.noise is not None)], "contact's", error)
        if self.axis is not None:
            set_point(self, "axis", "axis of a contact", error)
        is_round, is_point = self.shape in ("circle", "sphere"), self.shape == "point"
        no_direction = self.axis is not None and (is_point or not any(self.axis))
        no_radius = radius is not None and not (is_round and number_of(radius, "radius", error) > 0)
        for fault, text in (
            (self.shape not in SHAPES[3], f"shape is {self.shape!r}; expected {listed(SHAPES[3])}"),
            (no_direction, f"axis is {self.axis}; expected a direction, and no axis for points"),
            (
                self.gauge and not (is_round or self.shape == "plane"),
                f"gauge cannot read a {self.shape}; expected a plane, circle or sphere",
            ),
            (no_radius, f"radius is {radius}; expected one above 0, and a circle or sphere"),
        ):
            if fault:
                raise MeasurementError(f"a contact's {text}")

    @property
    def axes(self) -> Array:
        """Axes A as columns, shape (3, 3): z is the nominal direction, x is horizontal."""
        axis = self.axis or ((1.0, 0.0, 0.0) if self.shape == "line" else (0.0, 0.0, 1.0))
        z = np.array(axis) / np.linalg.norm(axis)
        x = np.array([-z[1], z[0], 0.0]) if z[:2].any() else np.array([1.0, 0.0, 0.0])
        x /= np.linalg.norm(x)
        return np.column_stack((x, np.cross(z, x), z))

    def relation(self, name: str, space: int) -> Relation:
        """Return the relation of this contact, whose features the column ``name`` names."""
        ways = SHAPES[space].get(self.shape, SHAPES[3][self.shape])[0]
        missed_by = tuple(f"{name}_{way}" for way in ways)
        read = missed_by[: self.gauge]
        return Relation(
            name, self.target, self.shape, name, name, missed_by, ways, read, self.noise
        )

    def place(self, name: str, space: int) -> tuple[Array, Array]:
        """Return a feature's coordinates and their standard deviations, 0 if known, (6,) each.

        Raises:
            MeasurementError: a machine that moves in ``space`` dimensions cannot meet the shape.
        """
        upright = abs(self.axes[2, 2]) == float(self.shape != "line")
        if self.shape not in SHAPES[space] or not (space == 3 or upright):
            raise MeasurementError(
                f"a planar machine meets no {self.shape} along {self.axis or 'z'}; expected "
                f"{listed(SHAPES[2])}, with lines in its plane and circles about z"
            )
        values, sigmas, point = np.zeros(6), np.zeros(6), self.points[name]
        unknown = SHAPES[space][self.shape][1].split()
        free = np.isin([*COORDINATES], unknown)
        sigmas[free] = np.inf
        if point is not None:
            values[:3] = self.axes.T @ point
            sigmas[:5] = np.where(np.arange(5) < 3, self.tolerance, 0.0) * free[:5]
        if self.radius is not None:
            values[5], sigmas[5] = self.radius, 0.0
        return values, sigmas


def missed(
    relation: Relation, points: Array, features: Array, axes: Array
) -> tuple[Array, Array, Array]:
    """Return the misses of points from features of a relation's shape, with derivatives.

    Args:
        relation: The relation between the points and the features.
        points: Targets in the frame of the measurements, shape (N, 3), [m].
        features: Coordinates of the feature that each point meets, shape (N, 6), [m] and [rad].
        axes: Nominal axes A of these features as columns, shape (N, 3, 3).

    Returns:
        The misses, shape (N, k), [m], and their derivatives by the points, shape (N, k, 3), with
        orthonormal rows, and by the features' coordinates, shape (N, k, 6).
    """
    inward, turn = np.swapaxes(axes, 1, 2), np.eye(3)
    w = (inward @ points[:, :, None])[:, :, 0] - features[:, :3]
    by_turn = np.zeros((len(w), 3, 2))
    if relation.shape in ("plane", "line", "circle"):
        turn = Rotation.from_euler("XY", features[:, 3:5]).inv().as_matrix()
        w, inward = (turn @ w[:, :, None])[:, :, 0], turn @ inward
        about = np.broadcast_to(np.eye(3)[:2], (len(w), 2, 3)).copy()
        about[:, 0, 0], about[:, 0, 2] = np.cos(features[:, 4]), np.sin(features[:, 4])
        by_turn = np.cross(w[:, None], about).transpose(0, 2, 1)
    slopes = np.zeros((len(w), len(relation.ways), 3))
    for row, way in enumerate(relation.ways):
        if way == "r":
            flat = w * [1.0, 1.0, float(relation.shape != "circle")]
            size = np.linalg.norm(flat, axis=1, keepdims=True)
            slopes[:, row] = flat / np.where(size == 0.0, 1.0, size)
        else:
            slopes[:, row, "xyz".index(way)] = 1.0
    by_radius = -np.array([float(way == "r") for way in relation.ways])
    value = (slopes @ w[:, :, None])[:, :, 0] + by_radius * features[:, 5:]
    by_feature = np.zeros((*value.shape, 6))
    by_feature[:, :, :3] = -slopes @ turn
    by_feature[:, :, 3:5] = slopes @ by_turn
    by_feature[:, :, 5] = by_radius
    return value, slopes @ inward, by_feature


Residuals: TypeAlias = tuple[Array, Array, Array]


@runtime_checkable
class Instrument(Protocol):
    """Device that reads the platform's pose, with its own columns and its own unknowns.

    Optional members: ``stand(values)`` returns T_frame_instrument, shape (4, 4), at values of its
    parameters, or None if the platform holds it; a view of the result draws it there. ``priors``
    are standard deviations of nominal values by id. ``shared`` are the owners of parameters that
    other instruments have, too. ``begin(poses, measured, known)`` returns the values from which the
    search starts, at poses of the nominal machine; ``known`` are values, by id, of parameters that
    others share. ``visible(poses, values)`` returns which columns it could measure, shape (N, r),
    for plans and simulations. ``metres_per_pixel(poses, values)`` returns the size of a pixel at
    the seen points, shape (N, r), [m/px]. ``marks`` are the columns of right and down by the names
    of points, which tables of corners fill.

    Example:
        >>> import numpy as np, pincal
        >>> class Height:
        ...     name, columns = "table", {"gauge": "m"}
        ...     parameters = (pincal.Parameter("table", "z", "m", 0.0),)
        ...
        ...     def evaluate(self, poses, values, measured):
        ...         by_twist = np.tile([0.0, 0, 1, 0, 0, 0], (len(poses), 1, 1))
        ...         by_own = -np.ones((len(poses), 1, 1))
        ...         height = poses[:, 2, 3:]
        ...         return height - values[0] - measured, by_twist, by_own
        >>> isinstance(Height(), pincal.Instrument)
        True
    """

    @property
    def name(self) -> str:
        """Name of the instrument, the owner of its parameters: ``gauge_1``."""

    @property
    def columns(self) -> Mapping[str, str]:
        """Columns of the instrument in the measurements, with their units: m, rad or px."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Unknowns of the instrument; the search starts at their nominal values."""

    def evaluate(self, poses: Array, values: Array, measured: Array) -> Residuals:
        """Return the residuals, and their derivatives by the pose and by the own parameters.

        Residuals, shape (N, r), are predicted less measured, in the columns' units, angles within
        ±π. Derivatives by the pose, shape (N, r, 6), are by the twist of the platform at its
        origin, linear first, in the axes of the frame of the measurements. Derivatives by the
        parameters have the shape (N, r, p).

        Args:
            poses: T_frame_platform, in the frame of the measurements, shape (N, 4, 4).
            values: Values of the parameters, shape (p,).
            measured: Readings of the instrument, shape (N, r); NaN where it has none.
        """


def evaluated(instrument: Instrument, poses: Array, values: Array, measured: Array) -> Residuals:
    """Return ``instrument.evaluate(...)``; raise MeasurementError if its shapes are wrong."""
    arrays = instrument.evaluate(poses, values, measured)
    rows = (len(poses), len(instrument.columns))
    shapes = (rows, (*rows, 6), (*rows, len(instrument.parameters)))
    shown = tuple(map(np.shape, arrays)) if isinstance(arrays, tuple) else type(arrays).__name__
    if shown != shapes:
        raise MeasurementError(
            f"evaluate of instrument {instrument.name!r} returned {shown}; expected residuals, and "
            "their derivatives by the platform's twist and by its parameters, of the shapes "
            f"{', '.join(map(str, shapes))}"
        )
    return arrays


def fault_of(instrument: Instrument, names: set[str]) -> str:
    """Return the fault of an instrument, beside names that are taken; empty if it has none."""
    name = instrument.name
    if name in names or not name.isidentifier():
        return (
            f"an instrument is named {name!r}; expected a word that names no target, contact or "
            "other instrument"
        )
    for column, unit in instrument.columns.items():
        if unit not in ("m", "rad", "px"):
            return f"column {column!r} of instrument {name!r} is in {unit!r}; expected m, rad or px"
    for parameter in instrument.parameters:
        if parameter.owner not in (name, *getattr(instrument, "shared", ())):
            return (
                f"instrument {name!r} has the parameter {parameter.id!r}; expected "
                f"'{name}.{parameter.name}'"
            )
    return ""


POLAR = ("range", "azimuth", "elevation")
"""Quantities that a tracker measures."""


@dataclass(frozen=True)
class Tracker:
    """Instrument that measures positions by a range and two angles."""

    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Point where its axes meet, in the frame of the measurements, [m]; azimuth is about z."""
    range: float = 0.0
    """Standard deviation of the range, [m]."""
    azimuth: float = 0.0
    """Standard deviation of the azimuth, [rad]."""
    elevation: float = 0.0
    """Standard deviation of the elevation, [rad]."""

    def __post_init__(self) -> None:
        set_point(self, "at", "place of the tracker", MeasurementError)
        check_sizes(self, POLAR, "noise of the tracker's", MeasurementError)
