"""What measures a platform: features that its targets meet, instruments that read its pose.

Points, planes, lines, circles and spheres are met, whose places rows share.

A feature that stands still has a frame of its own, at p and turned by R, about x and then y, in
axes A whose z is its nominal direction. The target of a row, at u in the frame of the measurements,
is there at

        w = Rᵀ (Aᵀ u − p),

and misses the feature by coordinates of w, or by how far w is from its axis or origin, less the
radius: a point by x, y and z, a plane by z, a line by x and y, a circle by r and z, a sphere by r.
Where another row's target stood is a feature, too: a distance to it is r, the height of a step z.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol, TypeAlias, runtime_checkable

import numpy as np
from scipy.spatial.transform import Rotation

from pincal.errors import MeasurementError
from pincal.model.checks import check_sizes, listed, must_be, named_points, number_of, set_point
from pincal.model.parameter import Parameter
from pincal.types import Array, Point

ORIGIN = "platform"
"""The target whose position is x, y, z."""
ROW = "row"
"""The contact of points at which rows stood, by their names: what others are measured from."""
TO = "_to"
"""Ends the column that says from which row another column is measured."""
COORDINATES = {"x": "m", "y": "m", "z": "m", "rx": "rad", "ry": "rad", "radius": "m"}
"""What says where a feature is, and its units; p is x, y, z, and R turns by rx, then ry."""
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
"""By dimensions of space: by what a shape is missed, and what may be unknown of it."""


class Relation(NamedTuple):
    """A condition between the target of a row and a feature that rows share."""

    name: str
    target: str
    shape: str
    column: str
    """Has the name of the feature that each row meets; empty if all meet the same."""
    owner: str
    """Owns the features: ``socket`` has ``socket_A``."""
    quantities: tuple[str, ...]
    """By what it is missed, or read."""
    ways: str
    """What each of them is: a coordinate x, y or z of w, or r."""
    read: tuple[str, ...]
    """Those that columns have; the others are zero."""
    noise: float | None
    """Their standard deviation, [m], if the setup says it."""


@dataclass(frozen=True)
class Distance:
    """A measured distance from a known point to a target, or from where the target stood."""

    point: Point | None
    """In the frame of the measurements, [m]; None: where it stood in the row that a column names
    (see ``Setup.of_rows``)."""
    target: str = ORIGIN
    along: int | None = None
    """Axis of that frame along which it is measured, 0 to 2; None: all the way."""
    noise: float | None = None
    """Standard deviation, [m]; that of positions if not given."""

    def __post_init__(self) -> None:
        if self.point is not None:
            set_point(self, "point", "point of a distance", MeasurementError)
        must_be(self.target, str, "target of a distance", MeasurementError)
        check_sizes(self, ("noise",) * (self.noise is not None), "distance's", MeasurementError)

    def relation(self, name: str, _space: int) -> Relation:
        """Return what it says of rows, read in the column of its name."""
        way = "r" if self.along is None else "xyz"[self.along]
        owner, leads = (name, "") if self.point else (ROW, f"{name}{TO}")
        return Relation(
            name, self.target, "sphere", leads, owner, (name,), way, (name,), self.noise
        )


@dataclass(frozen=True)
class Contact:
    """A target that meets again and again what stands still: sockets, a plate, an edge, a ring.

    Which of them it meets in a row stands in the column of the contact's name. A gauge reads by how
    much it is missed: ``plate_z [mm]`` along a plane's normal, ``bar_r [mm]`` of a ball bar's
    length.

    >>> import pincal
    >>> sockets = pincal.Contact({"A": None, "B": (0.3, 0.1, 0.05)}, noise=2e-5)
    >>> pincal.Setup(contacts={"socket": sockets}).contacts["socket"].points["B"]
    (0.3, 0.1, 0.05)
    >>> plate = pincal.Contact({"lower": None, "upper": None}, shape="plane", gauge=True)
    >>> list(pincal.Setup(contacts={"plate": plate}).required)
    ['plate', 'plate_z']
    """

    points: Mapping[str, Point | None]
    """Where they are in the frame of the measurements, [m], by name: points, centres, or points on
    planes and lines; None: to be identified, as is how they are turned."""
    target: str = ORIGIN
    tolerance: float = 0.0
    """Standard deviation of each coordinate of the points whose place is known, [m]."""
    noise: float | None = None
    """By how much the target misses them, along each axis, or the gauge's noise, [m]; as positions
    if not given."""
    shape: str = "point"
    """``point``, ``plane``, ``line``, ``circle`` or ``sphere``."""
    axis: Point | None = None
    """Normal of planes, direction of lines, axis of circles, about; z, of lines x if not given."""
    radius: float | None = None
    """Of circles and spheres, [m]; None: to be identified."""
    gauge: bool = False
    """Whether a column says by how much a plane, circle or sphere is missed; else it is touched."""

    def __post_init__(self) -> None:
        error, radius = MeasurementError, self.radius
        object.__setattr__(self, "points", named_points(self.points, "a contact", error))
        must_be(self.target, str, "target of a contact", error)
        must_be(self.gauge, bool, "gauge of a contact", error)
        check_sizes(self, ["tolerance", *["noise"] * (self.noise is not None)], "contact's", error)
        if self.axis is not None:
            set_point(self, "axis", "axis of a contact", error)
        is_round, is_point = self.shape in ("circle", "sphere"), self.shape == "point"
        no_direction = self.axis is not None and (is_point or not any(self.axis))
        no_radius = radius is not None and not (is_round and number_of(radius, "radius", error) > 0)
        for fault, text in (
            (self.shape not in SHAPES[3], f"shape is {self.shape!r}; expected {listed(SHAPES[3])}"),
            (no_direction, f"axis is {self.axis}; expected a direction, and none of points"),
            (
                self.gauge and not (is_round or self.shape == "plane"),
                f"gauge reads no {self.shape}",
            ),
            (no_radius, f"radius is {radius}; expected one above 0, of a circle or sphere"),
        ):
            if fault:
                raise MeasurementError(f"a contact's {text}")

    @property
    def axes(self) -> Array:
        """Axes whose z is the nominal direction and whose x is level, columns, shape (3, 3)."""
        axis = self.axis or ((1.0, 0.0, 0.0) if self.shape == "line" else (0.0, 0.0, 1.0))
        z = np.array(axis) / np.linalg.norm(axis)
        x = np.array([-z[1], z[0], 0.0]) if z[:2].any() else np.array([1.0, 0.0, 0.0])
        x /= np.linalg.norm(x)
        return np.column_stack((x, np.cross(z, x), z))

    def relation(self, name: str, space: int) -> Relation:
        """Return what it says of rows that name in the column of its name what they meet."""
        ways = SHAPES[space].get(self.shape, SHAPES[3][self.shape])[0]
        missed_by = tuple(f"{name}_{way}" for way in ways)
        read = missed_by[: self.gauge]
        return Relation(
            name, self.target, self.shape, name, name, missed_by, ways, read, self.noise
        )

    def place(self, name: str, space: int) -> tuple[Array, Array]:
        """Return coordinates of what has a name, and standard deviations, 0 if known, (6,) each.

        Raises:
            MeasurementError: a shape that a machine that moves in ``space`` dimensions cannot meet.
        """
        upright = abs(self.axes[2, 2]) == float(self.shape != "line")
        if self.shape not in SHAPES[space] or not (space == 3 or upright):
            raise MeasurementError(
                f"a planar machine meets no {self.shape} along {self.axis or 'z'}; expected "
                f"{listed(SHAPES[2])}, lines along an axis in its plane"
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
    """Return by how much points miss features of a relation's shape, its radius included.

    Args:
        relation: What they are to meet.
        points: Targets in the frame of the measurements, shape (N, 3), [m].
        features: Coordinates of what each of them meets, shape (N, 6), [m] and [rad].
        axes: Nominal axes of these, columns, shape (N, 3, 3).

    Returns:
        The misses, shape (N, k), [m], and their derivatives by points, (N, k, 3), orthonormal rows,
        and by the features' coordinates, (N, k, 6).
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
    """Anything that reads the platform's pose, in its own columns and with its own unknowns.

    One that says where it stands is drawn there by a view of the result: by a method
    ``stand(values)`` that returns T_frame_instrument, shape (4, 4), at values of its parameters;
    None if the platform holds it. Further, if it has them: ``priors``, standard deviations of
    nominal values by id; ``shared``, owners of parameters that other instruments have, too;
    ``begin(poses, measured, known)``, values from which a search begins, at poses of the nominal
    machine and values by id that others share; ``visible(poses, values)``, which columns it could
    measure at poses, shape (N, r), for plans and simulations; ``metres_per_pixel(poses, values)``,
    what one of its pixels is at what it sees, shape (N, r), [m/px]; ``marks``, columns of right and
    down by the names of points, which tables of corners fill.

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
        """Its name, which owns its parameters: ``gauge_1``."""

    @property
    def columns(self) -> Mapping[str, str]:
        """Its columns in the measurements, and their units: m, rad or px."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Its unknowns; the search starts at their nominal values."""

    def evaluate(self, poses: Array, values: Array, measured: Array) -> Residuals:
        """Return its residuals, their derivatives by the pose, and those by its own parameters.

        Residuals are predicted less measured, in the columns' units, angles within ±π, shape
        (N, r). The pose is the twist of the platform at its origin, linear first, in the axes of
        the frame of the measurements: shape (N, r, 6). Parameters: shape (N, r, p).

        Args:
            poses: T_frame_platform, in the frame of the measurements, shape (N, 4, 4).
            values: Of its parameters, shape (p,).
            measured: What it read, shape (N, r); NaN where it did not.
        """


def evaluated(instrument: Instrument, poses: Array, values: Array, measured: Array) -> Residuals:
    """Return what an instrument evaluates, its shapes checked: see ``Instrument.evaluate``."""
    arrays = instrument.evaluate(poses, values, measured)
    rows = (len(poses), len(instrument.columns))
    shapes = (rows, (*rows, 6), (*rows, len(instrument.parameters)))
    shown = tuple(map(np.shape, arrays)) if isinstance(arrays, tuple) else type(arrays).__name__
    if shown != shapes:
        raise MeasurementError(
            f"evaluate of instrument {instrument.name!r} gave {shown}; expected residuals, and "
            "their derivatives by the platform's twist and by its parameters, of the shapes "
            f"{', '.join(map(str, shapes))}"
        )
    return arrays


def fault_of(instrument: Instrument, names: set[str]) -> str:
    """Return what is wrong with an instrument beside others with names; empty if nothing is."""
    name = instrument.name
    if name in names or not name.isidentifier():
        return (
            f"an instrument is named {name!r}; expected a word that no target and no other "
            "instrument has"
        )
    for column, unit in instrument.columns.items():
        if unit not in ("m", "rad", "px"):
            return f"column {column!r} of instrument {name!r} is in {unit!r}; expected m, rad or px"
    for parameter in instrument.parameters:
        if parameter.owner not in (name, *getattr(instrument, "shared", ())):
            return (
                f"parameter {parameter.id!r} is of instrument {name!r}; expected "
                f"'{name}.{parameter.name}'"
            )
    return ""


POLAR = ("range", "azimuth", "elevation")
"""What a tracker measures."""


@dataclass(frozen=True)
class Tracker:
    """An instrument that measures positions by a range and two angles."""

    at: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where its axes meet, in the frame of the measurements, [m]; azimuth is about z."""
    range: float = 0.0
    """Standard deviation of the range, [m]."""
    azimuth: float = 0.0
    """Of the azimuth, [rad]."""
    elevation: float = 0.0
    """Of the elevation, [rad]."""

    def __post_init__(self) -> None:
        set_point(self, "at", "place of the tracker", MeasurementError)
        check_sizes(self, POLAR, "noise of the tracker's", MeasurementError)
