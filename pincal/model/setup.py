"""Measuring setup: the frame of the measurements, targets on the platform, and instruments.

By default positions are those of the platform's origin in the robot's base frame. But a tracker
stands elsewhere, a reflector sits somewhere on the platform, and a cable measures a distance.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot
from pathlib import Path

import numpy as np

from pincal.attached import attached
from pincal.errors import MeasurementError
from pincal.model.checks import check_kinds, check_sizes, choice_of, listed, one_line, set_point
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
    """Standard uncertainties of systematic errors, the same in all rows (type B, GUM 4.3).

    More rows do not reduce them: they enter the stated uncertainties, not the weights of the fit.

    Example:
        >>> import pincal
        >>> tracker = pincal.Systematic(scale=2e-6, temperature=1.0)
        >>> pincal.Setup(systematic=tracker).systematic.temperature
        1.0
    """

    scale: float = 0.0
    """Uncertainty of the scale of measured lengths, relative: 20e-6 for 20 µm/m."""
    temperature: float = 0.0
    """Uncertainty of the machine's temperature relative to that of its later use, [K]."""
    expansion: float = STEEL
    """Thermal expansion of the machine, [1/K]."""
    target: float = 0.0
    """Uncertainty of the offset of each target that counts as known, along each axis, [m]."""

    def __post_init__(self) -> None:
        check_sizes(self, tuple(vars(self)), "systematic uncertainty, its", MeasurementError)

    @property
    def relative(self) -> float:
        """Relative standard uncertainty that all lengths share."""
        return hypot(self.scale, self.temperature * self.expansion)


_FAR = 3.0  # targets farther from the platform, in lengths of the longest leg, are refused


@dataclass(frozen=True)
class Target:
    """A point of the platform whose position is measured."""

    offset: Point = (0.0, 0.0, 0.0)
    """Position in the platform frame, [m]; if unknown, the search starts there."""
    unknown: bool = option(
        False, "Where the measured point sits on the platform is unknown.", name="unknown_target"
    )
    """Whether to identify the offset; for the target ``platform``, also the rotation of the
    measured orientation relative to the platform's."""

    def __post_init__(self) -> None:
        set_point(self, "offset", "offset of a target", MeasurementError)
        check_kinds(vars(self), Target, MeasurementError)


@dataclass(frozen=True)
class Setup:
    """Meaning of the measured columns: frame, targets, contacts, distances and instruments."""

    unknown_frame: bool = option(False, "The pose of the base in the measurement frame is unknown.")
    targets: Mapping[str, Target] = field(default_factory=lambda: {ORIGIN: Target()})
    """Targets by name; ``platform`` has the columns x, y, z, another target t t_x, t_y, t_z."""
    distances: Mapping[str, Distance] = field(default_factory=dict)
    """Distances by column."""
    contacts: Mapping[str, Contact] = field(default_factory=dict)
    """Contacts by column; each row has the name of the touched feature, or is empty."""
    mark: str = ORIGIN
    """Target, such as a pen, between whose positions in two rows distances are measured."""
    headers: Mapping[str, str] = field(default_factory=dict)
    """Meaning of other programs' headers: ``leg_1``, or with its unit ``leg_1 [mm]``."""
    instruments: tuple[Instrument, ...] = ()
    """Further instruments, each with its columns and unknowns."""
    corners: str | None = None
    """File of points in cameras' images: a table with the columns ``point``, ``u [px]``, ``v [px]``
    and ``row`` (of the measurements, from 1) or ``image`` (named in them), and optionally
    ``camera`` and ``sigma [px]``. Without it, pixels are in columns of the measurements."""
    tracker: Tracker | None = None
    """Tracker that measures positions, if the noise of its range and angles is to be used."""
    systematic: Systematic = field(default_factory=Systematic)
    """Standard uncertainties of systematic errors."""

    def __post_init__(self) -> None:
        check_kinds(vars(self), Setup, MeasurementError)
        choice_of(self.mark, {ORIGIN: 0, **self.targets}, "mark", MeasurementError)
        object.__setattr__(self, "targets", {ORIGIN: Target(), **self.targets})
        for relation in self.relations(3):
            label = f"target to which {relation.name!r} is measured"
            choice_of(relation.target, self.targets, label, MeasurementError)
        object.__setattr__(self, "instruments", tuple(self.instruments))
        names = {"tracker", "target", *self.targets}
        if shared := names & {*self.contacts, *self.touched}:
            raise MeasurementError(f"{min(shared)!r} is a contact and a target; rename one of them")
        names |= {*self.contacts, *self.touched}
        for instrument in self.instruments:
            if fault := fault_of(instrument, names):
                raise MeasurementError(fault)
            names.add(instrument.name)

    @staticmethod
    @attached
    def from_yaml(path: str | Path) -> Setup:
        """Return the setup in a YAML file.

        Raises:
            FileError: the file is missing or cannot be read.
            MeasurementError: the file does not parse, or an entry is wrong.
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
        """Return the setup with the frame, or the offset of the target ``platform``, unknown."""
        point = replace(self.targets[ORIGIN], unknown=target or self.targets[ORIGIN].unknown)
        targets = {**self.targets, ORIGIN: point}
        return replace(self, unknown_frame=frame or self.unknown_frame, targets=targets)

    def of_rows(self, names: Mapping[str, Sequence[str]]) -> Setup:
        """Return the setup with the distances that are measured between rows.

        The column ``distance_1`` is the distance from the row that ``distance_1_to`` names;
        ``dx_1``, ``dy_1`` and ``dz_1`` are the coordinates less those of that row.

        Args:
            names: Names of rows by column, ``row`` and those ending in ``_to``; empty for none.
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
    def only_touched(self) -> Setup:
        """The setup with only the contacts to which the machine is led, those without a gauge."""
        contacts = {n: c for n, c in self.contacts.items() if n != ROW and not c.gauge}
        return replace(self, distances={}, contacts=contacts)

    @property
    def between_rows(self) -> list[str]:
        """Columns that are measured from another row."""
        return [name for name, distance in self.distances.items() if distance.point is None]

    @property
    def plain(self) -> bool:
        """Whether poses are of the platform in the base frame, and nothing else is measured."""
        further = (self.distances, self.contacts, self.instruments)
        return not (self.unknown_frame or any(further) or self.targets != {ORIGIN: Target()})

    @property
    def pixels(self) -> set[str]:
        """Columns that cameras measure, in pixels."""
        every = (column for device in self.instruments for column in device.columns.items())
        return {name for name, unit in every if unit == "px"}

    @property
    def device_parameters(self) -> dict[str, tuple[Parameter, float]]:
        """Instruments' parameters and prior standard deviations by id, shared parameters once."""
        parameters = dict[str, tuple[Parameter, float]]()
        for instrument in self.instruments:
            priors: Mapping[str, float] = getattr(instrument, "priors", {})
            for parameter in instrument.parameters:
                entry = parameter, priors.get(parameter.id, np.inf)
                if parameters.setdefault(parameter.id, entry) != entry:
                    raise MeasurementError(
                        f"instruments share the parameter {parameter.id!r} with other values or "
                        "priors; make them equal, or give the parameters different names"
                    )
        return parameters

    @property
    def frameless(self) -> bool:
        """Whether the setup has contacts or cameras, which alone measure no pose."""
        return bool(self.contacts or self.pixels)

    @property
    def required(self) -> dict[str, str]:
        """Columns that measurements must have, with their meaning, without pixels in corners."""
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
        """Column, name and contact of each touched feature by id: ``socket_A`` for ``A``."""
        return {
            f"{column}_{name}": (column, name, contact)
            for column, contact in self.contacts.items()
            for name in contact.points
        }

    @property
    def features(self) -> dict[str, tuple[str, str, Contact]]:
        """All features by id: touched ones, then the known points of distances."""
        known = {column: d.point for column, d in self.distances.items() if d.point}
        points = {c: (c, c, Contact({c: point})) for c, point in known.items()}
        return {**self.touched, **points}

    def feature_places(self, space: int) -> tuple[Array, Array, Array]:
        """Return the features' coordinates, their standard deviations (0 if known), and axes.

        Their shapes are (n, 6), (n, 6) and (n, 3, 3): see ``Contact.place``.
        """
        parts = [c.place(name, space) for _, name, c in self.features.values()]
        values, sigmas = np.reshape(parts, (-1, 2, 6)).transpose(1, 0, 2)
        axes = [contact.axes for _, _, contact in self.features.values()]
        return values, sigmas, np.reshape(axes, (-1, 3, 3))

    def relations(self, space: int) -> list[Relation]:
        """Return all relations, distances first, of a machine in space (3) or the plane (2)."""
        parts: dict[str, Distance | Contact] = {**self.distances, **self.contacts}
        return [part.relation(name, space) for name, part in parts.items()]

    @property
    def read_lengths(self) -> list[str]:
        """Columns of the lengths that are read, of distances and gauges."""
        return [name for relation in self.relations(3) for name in relation.read]

    def measured(self, mechanism: Mechanism) -> tuple[str, ...]:
        """Return the quantities measured by default: no pose with contacts or cameras."""
        if not self.frameless:
            return (*mechanism.platform.freedoms, *self.columns(mechanism))
        instruments = (column for device in self.instruments for column in device.columns)
        return tuple(dict.fromkeys((*self.required, *instruments)))

    def quantities(self, platform: Platform, names: Iterable[str]) -> tuple[str, ...]:
        """Return names of quantities; a contact's name is replaced by its quantities."""
        axes = self.contact_axes(platform)
        return tuple(dict.fromkeys(name for part in names for name in axes.get(part, [part])))

    def contact_axes(self, platform: Platform) -> dict[str, list[str]]:
        """Return the quantities of each contact: the misses of the touched features."""
        relations = self.relations(platform.space)
        return {r.name: list(r.quantities) for r in relations if r.name in self.contacts}

    def noises(self, platform: Platform) -> dict[str, float]:
        """Return the standard deviations that the setup gives, by quantity, [m]."""
        relations = self.relations(platform.space)
        return {q: r.noise for r in relations if r.noise is not None for q in r.quantities}

    def positions(self, platform: Platform) -> dict[str, list[str]]:
        """Return the columns of each target's position."""
        axes = "xyz"[: platform.space]
        stems = {name: "" if name == ORIGIN else f"{name}_" for name in self.targets}
        return {name: [f"{stem}{axis}" for axis in axes] for name, stem in stems.items()}

    def points(self, platform: Platform) -> dict[str, str]:
        """Return the columns of further targets' positions, with their units."""
        further = {**self.positions(platform), ORIGIN: []}
        return {name: "m" for columns in further.values() for name in columns}

    def columns(self, mechanism: Mechanism) -> dict[str, str]:
        """Return the columns that this setup adds to those of the pose, with their units.

        Raises:
            MeasurementError: a column already has a meaning, or a target is far off the mechanism.
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
                f"an instrument is named {min(shared)!r}, like a leg of {mechanism.name!r}; choose "
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
