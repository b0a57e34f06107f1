"""How a platform is measured: in which frame, at which points of it, from where.

By default positions are those of the platform's origin in the robot's base frame. A tracker
is elsewhere, a reflector sits somewhere on the platform, a cable measures a distance.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot
from pathlib import Path
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np

from pincal.attached import attached
from pincal.errors import MeasurementError
from pincal.model.checks import array_of, count_of, listed, must_be, number_of, one_line
from pincal.model.consistency import RESERVED
from pincal.model.mechanism import Mechanism
from pincal.model.option import option
from pincal.model.parameter import Parameter
from pincal.model.platform import Platform
from pincal.types import Array

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
    measure at poses, shape (N, r), for plans and simulations.

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


@dataclass(frozen=True)
class Image:
    """What columns of an instrument are in the picture that it takes, for plots of residuals.

    An instrument that has one as its ``image`` is a camera to ``result.plot.images()``.

    Example:
        >>> import pincal
        >>> image = pincal.Image((1600, 1200), {"tip": ("tip_u", "tip_v")}, scale=1500.0)
        >>> image.at([0.1], [-0.2]).tolist()
        [[950.0, 300.0]]
    """

    size: tuple[int, int]
    """Width and height, [px]."""
    points: Mapping[str, tuple[str, str]]
    """Columns that point right and down, by the names of the points seen."""
    scale: float
    """Pixels per unit of the columns: of tangents of angles the focal length, [px]."""
    centre: tuple[float, float] | None = None
    """Where both columns are zero, from the upper left corner, [px]; the middle if not given."""

    def __post_init__(self) -> None:
        size = must_be(self.size, (tuple, list), "size of an image", MeasurementError)
        pixels = [count_of(side, "size of an image [px]", MeasurementError, 1) for side in size]
        if len(pixels) != 2:
            raise MeasurementError(f"size of an image is {size!r}; expected width and height in px")
        if not number_of(self.scale, "scale of an image", MeasurementError) > 0.0:
            raise MeasurementError(f"scale of an image is {self.scale:g}; expected more than 0")
        for name, columns in must_be(
            self.points, Mapping, "points of an image", MeasurementError
        ).items():
            if isinstance(columns, str) or len(columns) != 2:
                raise MeasurementError(
                    f"point {name!r} of an image has the columns {columns!r}; expected two: one "
                    "that points right, one that points down"
                )

    def at(self, right: Array, down: Array) -> Array:
        """Return places in the image, shape (N, 2), [px], of values of columns, shape (N,)."""
        middle = np.array(self.size) / 2 if self.centre is None else np.array(self.centre)
        return np.asarray(middle + self.scale * np.column_stack((right, down)))


def image_of(instrument: Instrument) -> Image | None:
    """Return what the columns of an instrument are in its pictures, if it is a camera."""
    return getattr(instrument, "image", None)


POLAR = ("range", "azimuth", "elevation")
"""What a tracker measures."""
STEEL = 11.5e-6
"""Thermal expansion of steel, [1/K]."""


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
        _set_point(self, "at", "place of the tracker")
        _check_sizes(self, POLAR, "noise of the tracker's")

    def by_polar(self, points: Array) -> Array:
        """Return how points move by range [1], azimuth and elevation [m/rad], shape (N, 3, 3).

        Points are positions in the frame of the measurements, shape (N, 3), [m].
        """
        x, y, z = ray = (points - self.at).T
        azimuth, level = np.arctan2(y, x), np.hypot(x, y)
        c, s = np.cos(azimuth), np.sin(azimuth)
        length = np.hypot(level, z)
        along = ray / np.where(length > 0.0, length, 1.0)
        turned = np.column_stack((-y, x, 0 * z))
        raised = np.column_stack((-z * c, -z * s, level))
        return np.stack((along.T, turned, raised), axis=2)


@dataclass(frozen=True)
class Systematic:
    """Standard uncertainties of what is off by the same in all rows (type B, GUM 4.3).

    More rows do not make them smaller: they are taken into what is promised, not into weights.

    Example:
        >>> import pincal
        >>> tracker = pincal.Systematic(scale=2e-6, temperature=1.0)
        >>> pincal.Setup(systematic=tracker).systematic.temperature
        1.0
    """

    scale: float = 0.0
    """Of measured lengths, relative: 20e-6 for 20 µm/m."""
    temperature: float = 0.0
    """Of the machine against that at which it is to be right, [K]."""
    expansion: float = STEEL
    """Thermal expansion of the machine, [1/K]."""
    target: float = 0.0
    """Of the offset of each target that is taken as known, along each axis, [m]."""

    def __post_init__(self) -> None:
        _check_sizes(self, tuple(vars(self)), "systematic uncertainty, its")

    @property
    def relative(self) -> float:
        """Standard uncertainty of all lengths together, relative."""
        return hypot(self.scale, self.temperature * self.expansion)


def _check_sizes(owner: object, names: Iterable[str], label: str) -> None:
    for name in names:
        value = number_of(getattr(owner, name), f"the {label} {name}", MeasurementError)
        object.__setattr__(owner, name, value)
        if not 0.0 <= value < np.inf:
            raise MeasurementError(f"the {label} {name} is {value:g}; expected 0 or more")


Point = tuple[float, float, float]
_FAR = 3.0  # times the longest leg: no target is that far from its platform
ORIGIN = "platform"  # the target whose position is x, y, z


def _set_point(owner: object, name: str, label: str) -> None:
    point = array_of(getattr(owner, name), (3,), label, MeasurementError)
    object.__setattr__(owner, name, tuple(point.tolist()))


@dataclass(frozen=True)
class Target:
    """A point of the platform whose position is measured."""

    offset: Point = (0.0, 0.0, 0.0)
    """In the platform frame, [m]; where the search starts if unknown."""
    unknown: bool = option(
        False, "Where the measured point sits on the platform is unknown.", name="unknown_target"
    )
    """The offset is then identified; of ``platform``, also how the measured orientation is turned
    against the platform's."""

    def __post_init__(self) -> None:
        _set_point(self, "offset", "offset of a target")
        must_be(self.unknown, bool, "unknown of a target", MeasurementError)


ROW = "row"
"""The contact of points at which rows stood, by their names: what others are measured from."""
TO = "_to"
"""Ends the column that says from which row another column is measured."""


@dataclass(frozen=True)
class Distance:
    """A measured distance from a known point to a target, or from where the target stood."""

    point: Point | None
    """In the frame of the measurements, [m]; None: where it stood in the row that a column names
    (see ``Setup.of_rows``)."""
    target: str = ORIGIN
    along: int | None = None
    """Axis of that frame along which it is measured, 0 to 2; None: all the way."""

    def __post_init__(self) -> None:
        if self.point is not None:
            _set_point(self, "point", "point of a distance")
        must_be(self.target, str, "target of a distance", MeasurementError)


@dataclass(frozen=True)
class Contact:
    """A target that is brought again and again to points that stand still: sockets, balls.

    Which of them it touches in a row stands in the column of the contact's name.

    >>> import pincal
    >>> sockets = pincal.Contact({"A": None, "B": (0.3, 0.1, 0.05)}, noise=2e-5)
    >>> pincal.Setup(contacts={"socket": sockets}).contacts["socket"].points["B"]
    (0.3, 0.1, 0.05)
    """

    points: Mapping[str, Point | None]
    """Where they are in the frame of the measurements, [m], by name; None: to be identified."""
    target: str = ORIGIN
    tolerance: float = 0.0
    """Standard deviation of each coordinate of the points whose place is known, [m]."""
    noise: float | None = None
    """By how much the target misses a point, along each axis, [m]; as positions if not given."""

    def __post_init__(self) -> None:
        points = dict(must_be(self.points, Mapping, "points of a contact", MeasurementError))
        if not points:
            raise MeasurementError("a contact has no points; name those that its target touches")
        for name, point in points.items():
            label = f"point {must_be(name, str, 'the name of a point', MeasurementError)!r}"
            if point is not None:
                points[name] = tuple(array_of(point, (3,), label, MeasurementError).tolist())
        object.__setattr__(self, "points", points)
        must_be(self.target, str, "target of a contact", MeasurementError)
        _check_sizes(self, ("tolerance",) + ("noise",) * (self.noise is not None), "contact's")


@dataclass(frozen=True)
class Setup:
    """What measured numbers mean."""

    unknown_frame: bool = option(False, "The pose of the base in the measurement frame is unknown.")
    targets: Mapping[str, Target] = field(default_factory=lambda: {ORIGIN: Target()})
    """``platform`` is the target of x, y, z; another target t of the columns t_x, t_y, t_z."""
    distances: Mapping[str, Distance] = field(default_factory=dict)
    """By column."""
    contacts: Mapping[str, Contact] = field(default_factory=dict)
    """By column: each row has the name of the point that is touched, or nothing."""
    mark: str = ORIGIN
    """Target that marks where rows stood, such as a pen, of distances between them."""
    headers: Mapping[str, str] = field(default_factory=dict)
    """Columns of other programs by their headers, as ``leg_1``, or ``leg_1 [mm]``."""
    instruments: tuple[Instrument, ...] = ()
    """Instruments of one's own, each with its columns and unknowns."""
    corners: str | None = None
    """File of what cameras saw: a table with the columns ``point``, ``u [px]``, ``v [px]`` and
    ``row`` (of the measurements, from 1) or ``image`` (a column of these), further ``camera`` and
    ``sigma [px]``. Without one, pixels are in columns of the measurements."""
    tracker: Tracker | None = None
    """What measures positions by a range and angles, if their noise is to be said so."""
    systematic: Systematic = field(default_factory=Systematic)
    """Uncertainties of what is off by the same in all rows."""

    def __post_init__(self) -> None:
        must_be(self.unknown_frame, bool, "unknown_frame", MeasurementError)
        groups = (("targets", Target), ("distances", Distance), ("contacts", Contact))
        for group, kind in groups:
            named = must_be(getattr(self, group), Mapping, group, MeasurementError)
            for name, entry in named.items():
                must_be(name, str, f"a name in {group}", MeasurementError)
                must_be(entry, kind, f"{group}, {name!r}", MeasurementError)
        if self.mark not in {ORIGIN, *self.targets}:
            raise MeasurementError(f"mark is {self.mark!r}; expected one of {listed(self.targets)}")
        object.__setattr__(self, "targets", {ORIGIN: Target(), **self.targets})
        measured: dict[str, Distance | Contact] = {**self.distances, **self.contacts}
        for column, entry in measured.items():
            if entry.target not in self.targets:
                raise MeasurementError(
                    f"{column!r} is measured to a target {entry.target!r}; expected one of "
                    f"{', '.join(self.targets)}"
                )
        must_be(self.corners, (str, type(None)), "corners", MeasurementError)
        must_be(self.tracker, (Tracker, type(None)), "tracker", MeasurementError)
        must_be(self.systematic, Systematic, "systematic", MeasurementError)
        object.__setattr__(self, "instruments", tuple(self.instruments))
        names = {"tracker", "target", *self.targets}
        if shared := names & {*self.contacts, *self.touched}:
            raise MeasurementError(f"{min(shared)!r} is a contact and a target; rename one of them")
        names |= {*self.contacts, *self.touched}
        for instrument in self.instruments:
            must_be(instrument, Instrument, "an instrument", MeasurementError)
            if fault := _fault(instrument, names):
                raise MeasurementError(fault)
            names.add(instrument.name)

    @staticmethod
    @attached
    def from_yaml(path: str | Path) -> Setup:
        """Return the setup that a YAML file says.

        Raises:
            FileError: the file is missing or cannot be read.
            MeasurementError: it does not parse, or says something else than it should.
        """

    def __repr__(self) -> str:
        targets = [n + " (unknown)" * t.unknown for n, t in self.targets.items() if t != Target()]
        named = {
            "targets": targets,
            "distances": self.distances,
            "contacts": self.contacts,
            "instruments": [instrument.name for instrument in self.instruments],
        }
        return one_line(
            "Setup",
            "unknown frame" if self.unknown_frame else "base frame",
            *(f"{kind} {listed(names)}" for kind, names in named.items() if names),
            "tracker" if self.tracker else "",
            "systematic uncertainties" if self.systematic != Systematic() else "",
        )

    def anywhere(self, *, frame: bool = False, target: bool = False) -> Setup:
        """Return the setup with the frame unknown, or where on the platform the target sits."""
        point = replace(self.targets[ORIGIN], unknown=target or self.targets[ORIGIN].unknown)
        targets = {**self.targets, ORIGIN: point}
        return replace(self, unknown_frame=frame or self.unknown_frame, targets=targets)

    def of_rows(self, names: Mapping[str, Sequence[str]]) -> Setup:
        """Return the setup with all that rows are measured from each other.

        In the column ``distance_1`` from the row whose name stands in that of ``distance_1_to``;
        ``dx_1``, ``dy_1``, ``dz_1`` are coordinates less those of that row.

        Args:
            names: Names by column, ``row`` and those ending in ``_to``, empty for none.
        """
        columns = [name for name in names if name.endswith(TO)]
        if not columns:
            return self
        rows = dict.fromkeys(name for column in columns for name in names[column] if name)
        if not rows:
            return self
        between = {}
        for column in columns:
            axis = {"dx": 0, "dy": 1, "dz": 2}.get(column.partition("_")[0])
            between[column.removesuffix(TO)] = Distance(None, self.mark, axis)
        contacts = {**self.contacts, ROW: Contact(dict.fromkeys(rows), self.mark)}
        return replace(self, distances={**self.distances, **between}, contacts=contacts)

    @property
    def between(self) -> list[str]:
        """Columns that are measured from another row."""
        return [name for name, distance in self.distances.items() if distance.point is None]

    @property
    def plain(self) -> bool:
        """Whether poses are those of the platform in the base frame, and nothing else."""
        further = (self.distances, self.contacts, self.instruments)
        return not (self.unknown_frame or any(further) or self.targets != {ORIGIN: Target()})

    @property
    def pixels(self) -> set[str]:
        """Columns that cameras measure, in pixels."""
        every = (column for device in self.instruments for column in device.columns.items())
        return {name for name, unit in every if unit == "px"}

    @property
    def device_parameters(self) -> dict[str, tuple[Parameter, float]]:
        """Parameters of all instruments by id, shared ones once, and their standard deviations."""
        parameters = dict[str, tuple[Parameter, float]]()
        for instrument in self.instruments:
            priors: Mapping[str, float] = getattr(instrument, "priors", {})
            for parameter in instrument.parameters:
                entry = parameter, priors.get(parameter.id, np.inf)
                if parameters.setdefault(parameter.id, entry) != entry:
                    raise MeasurementError(
                        f"parameter {parameter.id!r} is shared by instruments that say different "
                        "things of it; give one name to what is one, another to what is not"
                    )
        return parameters

    @property
    def frameless(self) -> bool:
        """Whether what measures has neither a frame of its own nor a measure of length."""
        return bool(self.contacts or self.pixels)

    @property
    def required(self) -> dict[str, str]:
        """Columns that tables of measurements must have, and whose they are; not of corners."""
        apart = self.pixels if self.corners else set()
        named = dict.fromkeys(self.distances, "a distance that the setup names")
        named |= dict.fromkeys(self.contacts, "which says what is touched in each row")
        return named | {
            column: f"which instrument {instrument.name!r} reads"
            for instrument in self.instruments
            for column in instrument.columns
            if column not in apart
        }

    @property
    def touched(self) -> dict[str, tuple[str, str, Contact]]:
        """Column, name and contact of each point that is touched, as ``socket_A`` of ``A``."""
        return {
            f"{column}_{name}": (column, name, contact)
            for column, contact in self.contacts.items()
            for name in contact.points
        }

    @property
    def touched_places(self) -> tuple[Array, Array]:
        """Places of the points touched, (n, 3), [m], zero if unknown, and how well known, (n,)."""
        points = [(contact, contact.points[name]) for _, name, contact in self.touched.values()]
        sigmas = [np.inf if place is None else contact.tolerance for contact, place in points]
        places = np.reshape([place or (0.0, 0.0, 0.0) for _, place in points], (-1, 3))
        return places, np.array(sigmas)

    def quantities(self, platform: Platform, names: Iterable[str]) -> tuple[str, ...]:
        """Return names of quantities, in place of a contact's those that it stands for."""
        axes = self.contact_axes(platform)
        return tuple(name for part in names for name in axes.get(part, [part]))

    def contact_axes(self, platform: Platform) -> dict[str, list[str]]:
        """Return the quantities of each contact: by how much what is touched is missed."""
        return {name: [f"{name}_{a}" for a in "xyz"[: platform.space]] for name in self.contacts}

    def positions(self, platform: Platform) -> dict[str, list[str]]:
        """Return the columns of each target's position."""
        axes = "xyz"[: platform.space]
        stems = {name: "" if name == ORIGIN else f"{name}_" for name in self.targets}
        return {name: [f"{stem}{axis}" for axis in axes] for name, stem in stems.items()}

    def points(self, platform: Platform) -> dict[str, str]:
        """Return the columns of further targets' positions, and their units."""
        further = {**self.positions(platform), ORIGIN: []}
        return {name: "m" for columns in further.values() for name in columns}

    def columns(self, mechanism: Mechanism) -> dict[str, str]:
        """Return columns that this setup adds to those of the pose, and their units.

        Raises:
            MeasurementError: a column that means something else; a target far off the mechanism.
        """
        size = mechanism.size
        for name, target in self.targets.items():
            if (far := hypot(*target.offset)) > _FAR * size:
                raise MeasurementError(
                    f"target {name!r} is {far:.4g} m from the platform's origin, and the longest "
                    f"leg of {mechanism.name!r} is {size:.3g} m; expected metres: is this "
                    "millimetres?"
                )
        if shared := {item.name for item in self.instruments} & set(mechanism.leg_names):
            raise MeasurementError(
                f"an instrument is named {min(shared)!r}, as a leg of {mechanism.name!r}; choose "
                "another name"
            )
        platform = mechanism.platform
        groups: list[Mapping[str, str]] = [self.points(platform)]
        groups.append(dict.fromkeys(self.distances, "m"))
        groups += [dict.fromkeys(axes, "m") for axes in self.contact_axes(platform).values()]
        groups += [item.columns for item in self.instruments]
        named = [*self.contacts, *(name for group in groups for name in group)]
        taken = {*mechanism.leg_names, *mechanism.reading_names, *platform.freedoms}
        taken |= RESERVED - {"x", "y", "z", "phi"}
        odd = {name for name in named if name.startswith("sigma_") or named.count(name) > 1}
        if odd := odd | (taken | {*platform.coordinates}).intersection(named):
            raise MeasurementError(
                f"the setup names a column {min(odd)!r}, which means something else in "
                "measurements; choose another name"
            )
        return {name: unit for group in groups for name, unit in group.items()}


def _fault(instrument: Instrument, names: set[str]) -> str:
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
    image = image_of(instrument)
    pairs = image.points.values() if image else ()
    if unknown := sorted({c for pair in pairs for c in pair} - set(instrument.columns)):
        return (
            f"the image of instrument {name!r} has a column {unknown[0]!r}; expected its own: "
            f"{listed(instrument.columns)}"
        )
    for parameter in instrument.parameters:
        if parameter.owner not in (name, *getattr(instrument, "shared", ())):
            return (
                f"parameter {parameter.id!r} is of instrument {name!r}; expected "
                f"'{name}.{parameter.name}'"
            )
    return ""
