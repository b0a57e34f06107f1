"""What ``mechanism.yaml`` says of a mechanism: its keys, as they are read and as they are written.

The models are the format: keys that they do not have are refused, and the JSON schema of the
documentation is made of them. URDFs beside the file say how joints hang together
(``mechanism_folders.py``).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator

from pincal.errors import MechanismError
from pincal.files.text import Name, Number, Strict
from pincal.files.urdf import leg_links
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Coordinate
from pincal.model.platform import KINDS, Platform
from pincal.model.sensor import Sensor
from pincal.model.terms import Harmonic, Load, Power, Share, Term

FORMAT = 1
Value = Name | Number
#: Forms of terms by the key that names each, with the further keys that belong to it.
_FORM_KEYS = {
    "sine": ("period",),
    "cosine": ("period",),
    "power": ("range", "centre"),
    "per": ("reference",),
}
_FORMS: dict[str, Any] = {"sine": Harmonic, "cosine": Harmonic, "power": Power, "per": Share}
_BLOCKS = ("parameters", "labels", "load")  # mappings of which each key has a line of its own


class TermSpec(Strict):
    """A term, but for the name of its amplitude."""

    sine: Number | None = None
    cosine: Number | None = None
    period: Number | None = None
    power: int | None = None
    range: Number | None = None
    centre: Number | None = None
    of: Annotated[str, Field(min_length=1, max_length=100)] | None = None
    per: Number | None = None
    reference: Number | None = None

    def term(self, parameter: str, place: str) -> Term:
        """Return the term with an amplitude; messages say its place."""
        values = self.model_dump(exclude_none=True)
        influence = values.pop("of", "")
        forms = [key for key in _FORM_KEYS if key in values] or ["per"] * bool(influence)
        form = " and ".join(forms) or "none"
        keys = _FORM_KEYS.get(form, ())
        odd = [key for key in values if key not in (form, *keys)]
        try:
            if len(forms) != 1:
                raise MechanismError(
                    f"expected one of {', '.join(_FORM_KEYS)}, or of alone; got {form}"
                )
            if odd:
                raise MechanismError(
                    f"{odd[0]!r} does not go with {form!r}; expected {', '.join(keys)}"
                )
            if form == "power" and "range" not in values:
                raise MechanismError("'power' needs 'range' beside it")
            if form in ("sine", "cosine"):
                values |= {"order": values.pop(form), "phase": form}
            return Term(parameter, _FORMS[form](**values), of=influence)
        except MechanismError as error:
            raise MechanismError(f"{place}, term {parameter!r}: {error}") from error


def _described_terms(terms: Iterable[Term], place: str) -> dict[str, Any]:
    """Return the keys of terms by their amplitudes, as ``TermSpec`` reads them."""
    described = {}
    for term in terms:
        if not term.has_form:
            raise MechanismError(
                f"{place}: the term of {term.parameter!r} is code, which a mechanism's folder "
                "does not hold; save the mechanism without terms, and its parameters "
                "(mechanism.parameters)"
            )
        basis: Any = term.basis
        keys = {
            field.name: value
            for field in fields(basis)
            if (value := getattr(basis, field.name)) != field.default
        }
        if isinstance(basis, Harmonic):
            keys = {keys.pop("phase"): keys.pop("order")} | keys
        elif isinstance(basis, Share) and not term.of:
            keys = {"per": basis.per} | keys
        described[term.parameter] = {"of": term.of} | keys if term.of else keys
    return described


def _number_or_home(value: object, number: ValidatorFunctionWrapHandler) -> object:
    try:
        return value if value == "home" else number(value)
    except ValidationError as error:
        raise ValueError("a finite number or 'home' is expected") from error


Zero = Annotated[Literal["home"] | Number, WrapValidator(_number_or_home)]


class SensorSpec(Strict):
    """Sensor of a leg."""

    joint: str
    form: Literal["joint", "reading"] = "joint"
    gain: Value = 1.0
    offset: Value = 0.0
    direction: Literal[1, -1] = 1
    zero: Zero = 0.0
    counts_per_unit: Annotated[Number, Field(gt=0)] | None = None
    terms: dict[Name, TermSpec] = Field(default_factory=dict)

    def sensor(self, leg: str) -> Sensor:
        """Return the sensor of a leg."""
        terms = tuple(term.term(amplitude, leg) for amplitude, term in self.terms.items())
        return Sensor(**self.model_dump(exclude={"terms"}), terms=terms)


class LegSpec(Strict):
    """One leg."""

    name: Name
    urdf: str
    tip: str
    platform_point: str
    home: dict[str, Number]
    closes: Literal["point", "frame"] = "point"
    sensors: list[SensorSpec] = Field(min_length=1)
    parameters: dict[Name, Number]
    placements: dict[str, list[dict[str, Value | list[Value]]]]
    terms: dict[Name, dict[Name, TermSpec]] = Field(default_factory=dict)

    def coordinates(self, joint: str) -> tuple[Coordinate, ...]:
        """Return the coordinates that place a joint, none if it is placed by its URDF alone."""
        place = f"{self.name}, placement of {joint!r}"
        coordinates = []
        for entry in self.placements.get(joint, []):
            if len(entry) != 1:
                raise MechanismError(
                    f"{place}: each entry is one coordinate, such as '- polar: [OA, beta]'; got "
                    f"{list(entry)}"
                )
            ((kind, values),) = entry.items()
            try:
                values = values if isinstance(values, list) else [values]
                coordinates.append(Coordinate(kind, tuple(values)))
            except MechanismError as error:
                raise MechanismError(f"{place}: {error}") from error
        return tuple(coordinates)

    def parameter_terms(self) -> tuple[tuple[str, Term], ...]:
        """Return the terms of the leg's lengths and angles, each with the parameter's name."""
        return tuple(
            (name, term.term(amplitude, f"{self.name}, parameter {name!r}"))
            for name, terms in self.terms.items()
            for amplitude, term in terms.items()
        )


class KindSpec(Strict):
    """A kind of platform of the user's own."""

    name: str
    freedoms: list[str]


class PlatformSpec(Strict):
    """The platform."""

    kind: str | KindSpec
    urdf: str
    home: dict[str, Number]

    def platform(self) -> Platform:
        """Return the platform."""
        kind = self.kind
        name, twist = (kind, ()) if isinstance(kind, str) else (kind.name, tuple(kind.freedoms))
        platform = Platform(name, tuple(self.home.values()), twist)
        if tuple(self.home) != platform.coordinates:
            raise MechanismError(
                f"platform.home has {', '.join(self.home)}; expected "
                f"{', '.join(platform.coordinates)}"
            )
        return platform


class LoadSpec(Strict):
    """What weighs on the mechanism."""

    mass: Number = 0.0
    centre: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    gravity: tuple[Number, Number, Number] = (0.0, 0.0, -9.81)
    drawn: dict[str, Number] = Field(default_factory=dict)

    def load(self) -> Load:
        """Return the load."""
        return Load(self.mass, self.centre, self.gravity, tuple(self.drawn.items()))


class MechanismSpec(Strict):
    """The whole file."""

    pincal: Literal[1]
    name: str
    description: str = ""
    platform: PlatformSpec
    labels: dict[str, str] = Field(default_factory=dict)
    load: LoadSpec | None = None
    legs: list[LegSpec] = Field(min_length=1)


def mechanism_yaml(mechanism: Mechanism) -> str:
    """Return the text of a mechanism's ``mechanism.yaml``."""
    platform, load = mechanism.platform, mechanism.load
    kind: Any = platform.kind
    if kind not in KINDS:
        kind = {"name": platform.kind, "freedoms": platform.twist}
    home = dict(zip(platform.coordinates, platform.home, strict=True))
    keys = {
        "pincal": FORMAT,
        "name": mechanism.name,
        "description": mechanism.description,
        "platform": {"kind": kind, "urdf": "platform.urdf", "home": home},
        "legs": [_described_leg(leg) for leg in mechanism.legs],
        "labels": dict(mechanism.labels),
        "load": None if load is None else vars(load) | {"drawn": dict(load.drawn)},
    }
    header = "# A mechanism of pincal. Lengths in m, angles in rad. See docs/mechanism_files.md\n"
    return header + yaml.dump(_filled(keys), Dumper=_Dumper, sort_keys=False, width=100)


def _described_leg(leg: Leg) -> dict[str, Any]:
    """Return the keys of a leg."""
    of_parameters = {
        name: _described_terms((term for owner, term in leg.terms if owner == name), leg.name)
        for name in leg.deformed
    }
    return {
        "name": leg.name,
        "urdf": f"{leg.name}.urdf",
        "tip": leg_links(leg)[-1],
        "platform_point": leg.point.name,
        **({} if leg.closes == "point" else {"closes": leg.closes}),
        "home": {joint.name: joint.home for joint in leg.moving},
        "sensors": [
            _filled(vars(sensor) | {"terms": _described_terms(sensor.terms, leg.name)})
            for sensor in leg.sensors
        ],
        "parameters": dict(leg.parameters),
        "placements": {
            joint.name: [
                {c.kind: c.values[0] if len(c.values) == 1 else c.values}
                for c in joint.placement.coordinates
            ]
            for joint in (*leg.joints, leg.point)
            if joint.placement.coordinates
        },
        **({"terms": of_parameters} if of_parameters else {}),
    }


def _filled(keys: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys that say something."""
    return {key: value for key, value in keys.items() if value not in (None, "", {})}


class _Dumper(yaml.CSafeDumper):
    """Writes mappings that hold no others on one line, and NumPy's numbers as Python's."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002 - all is written out
        return True

    def represent_mapping(self, tag: str, mapping: Any, flow_style: Any = None) -> yaml.MappingNode:
        node = super().represent_mapping(tag, mapping, flow_style)
        node.flow_style = all(
            isinstance(part, yaml.ScalarNode)
            for _, value in node.value
            for part in (value.value if isinstance(value, yaml.SequenceNode) else [value])
        )
        for key, value in node.value:
            if key.value in _BLOCKS:
                value.flow_style = False
        return node


for _number in (np.floating, np.integer):
    _Dumper.add_multi_representer(_number, lambda dumper, n: dumper.represent_data(n.item()))
