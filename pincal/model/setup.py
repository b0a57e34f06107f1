"""How a platform is measured: in which frame, at which points of it, from where.

By default positions are those of the platform's origin in the robot's base frame. A tracker
is elsewhere, a reflector sits somewhere on the platform, a cable measures a distance.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot
from pathlib import Path

import numpy as np

from pincal.attached import attached
from pincal.errors import MeasurementError
from pincal.model.checks import check_sizes, listed, must_be, one_line, set_point
from pincal.model.consistency import RESERVED
from pincal.model.mechanism import Mechanism
from pincal.model.parameter import Parameter
from pincal.model.platform import Platform
from pincal.model.relations import (
    ORIGIN,
    ROW,
    TO,
    Contact,
    Distance,
    Instrument,
    Relation,
    Tracker,
    fault_of,
)
from pincal.option import option
from pincal.types import Array, Point

STEEL = 11.5e-6
"""Thermal expansion of steel, [1/K]."""


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
        check_sizes(self, tuple(vars(self)), "systematic uncertainty, its", MeasurementError)

    @property
    def relative(self) -> float:
        """Standard uncertainty of all lengths together, relative."""
        return hypot(self.scale, self.temperature * self.expansion)


_FAR = 3.0  # times the longest leg: no target is that far from its platform


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
        set_point(self, "offset", "offset of a target", MeasurementError)
        must_be(self.unknown, bool, "unknown of a target", MeasurementError)


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
        for relation in self.relations(3):
            if relation.target not in self.targets:
                raise MeasurementError(
                    f"{relation.name!r} is measured to a target {relation.target!r}; expected one "
                    f"of {', '.join(self.targets)}"
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
            if fault := fault_of(instrument, names):
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
    def led(self) -> Setup:
        """The setup of the contacts alone to which a machine is led: those without a gauge."""
        contacts = {n: c for n, c in self.contacts.items() if n != ROW and not c.gauge}
        return replace(self, distances={}, contacts=contacts)

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
        elsewhere = self.pixels if self.corners else set()
        named = dict.fromkeys(self.distances, "a distance that the setup names")
        named |= dict.fromkeys(self.contacts, "which says what is touched in each row")
        named |= dict.fromkeys(self.read_lengths[len(self.distances) :], "which a gauge reads")
        return named | {
            column: f"which instrument {instrument.name!r} reads"
            for instrument in self.instruments
            for column in instrument.columns
            if column not in elsewhere
        }

    @property
    def touched(self) -> dict[str, tuple[str, str, Contact]]:
        """Column, name and contact of each feature that is met, as ``socket_A`` of ``A``."""
        return {
            f"{column}_{name}": (column, name, contact)
            for column, contact in self.contacts.items()
            for name in contact.points
        }

    @property
    def features(self) -> dict[str, tuple[str, str, Contact]]:
        """All features by id, those that are touched and known points of distances."""
        known = {column: d.point for column, d in self.distances.items() if d.point}
        points = {c: (c, c, Contact({c: point})) for c, point in known.items()}
        return {**self.touched, **points}

    def feature_places(self, space: int) -> tuple[Array, Array, Array]:
        """Return coordinates of features, their standard deviations, 0 if known, and axes.

        Shapes (n, 6), (n, 6) and (n, 3, 3): see ``Contact.place``.
        """
        parts = [c.place(name, space) for _, name, c in self.features.values()]
        values, sigmas = np.reshape(parts, (-1, 2, 6)).transpose(1, 0, 2)
        axes = [contact.axes for _, _, contact in self.features.values()]
        return values, sigmas, np.reshape(axes, (-1, 3, 3))

    def relations(self, space: int) -> list[Relation]:
        """Return what targets meet, distances first; in space or, 2, in the plane."""
        parts: dict[str, Distance | Contact] = {**self.distances, **self.contacts}
        return [part.relation(name, space) for name, part in parts.items()]

    @property
    def read_lengths(self) -> list[str]:
        """Columns of lengths that distances and gauges read."""
        return [name for relation in self.relations(3) for name in relation.read]

    def measured(self, mechanism: Mechanism) -> tuple[str, ...]:
        """Return what is measured if nobody says less: no pose where contacts or cameras are."""
        if not self.frameless:
            return (*mechanism.platform.freedoms, *self.columns(mechanism))
        instruments = (column for device in self.instruments for column in device.columns)
        return tuple(dict.fromkeys((*self.required, *instruments)))

    def quantities(self, platform: Platform, names: Iterable[str]) -> tuple[str, ...]:
        """Return names of quantities, in place of a contact's those that it stands for."""
        axes = self.contact_axes(platform)
        return tuple(dict.fromkeys(name for part in names for name in axes.get(part, [part])))

    def contact_axes(self, platform: Platform) -> dict[str, list[str]]:
        """Return the quantities of each contact: by how much what is touched is missed."""
        relations = self.relations(platform.space)
        return {r.name: list(r.quantities) for r in relations if r.name in self.contacts}

    def noises(self, platform: Platform) -> dict[str, float]:
        """Return standard deviations that the setup says, by quantity, [m]."""
        relations = self.relations(platform.space)
        return {q: r.noise for r in relations if r.noise is not None for q in r.quantities}

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
        groups += [dict.fromkeys(r.quantities, "m") for r in self.relations(platform.space)]
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
