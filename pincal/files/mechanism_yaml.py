"""What ``mechanism.yaml`` says of a mechanism: its keys, as they are read and as they are written.

The models are the format: keys that they do not have are refused, and the JSON schema of the
documentation is made of them. URDFs beside the file say how joints hang together
(``mechanism_folders.py``).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator

from pincal.errors import MechanismError
from pincal.files.text import Name, Number, Strict
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.placement import Coordinate
from pincal.model.platform import KINDS, Platform, PlatformKind
from pincal.model.sensor import Sensor
from pincal.model.terms import Harmonic, Knot, Load, Power, Share, Term

FORMAT = 1
Value = Name | Number
#: Forms of terms by the key that names each, with the further keys that belong to it.
_FORM_KEYS = {
    "sine": ("period",),
    "cosine": ("period",),
    "power": ("range", "centre"),
    "knots": ("knot", "periodic"),
    "per": ("reference",),
}
_REQUIRED_KEYS = {"power": "range", "knots": "knot"}


class TermSpec(Strict):
    """A term, but for the name of its amplitude."""

    sine: Number | None = None
    cosine: Number | None = None
    period: Number | None = None
    power: int | None = None
    range: Number | None = None
    centre: Number | None = None
    knots: list[Number] | None = Field(default=None, max_length=1000)
    knot: int | None = None
    periodic: bool | None = None
    of: Annotated[str, Field(min_length=1, max_length=100)] | None = None
    per: Number | None = None
    reference: Number | None = None

    def term(self, parameter: str, place: str) -> Term:
        """Return the term with an amplitude.

        Args:
            parameter: Name of the amplitude.
            place: Where the term stands, for messages.

        Raises:
            MechanismError: none or several of the forms, a key that is missing or of another form,
                or a number that it cannot have.
        """
        values = self.model_dump(exclude_none=True)
        influence = values.pop("of", "")
        forms = [key for key in _FORM_KEYS if key in values] or ["per"] * bool(influence)
        where_named = f"{place}, term {parameter!r}"
        if len(forms) != 1:
            raise MechanismError(
                f"{where_named}: expected one of {', '.join(_FORM_KEYS)}, or of alone; got "
                f"{' and '.join(forms) or 'none'}"
            )
        (form,) = forms
        keys = _FORM_KEYS[form]
        if odd := [key for key in values if key not in (form, *keys)]:
            raise MechanismError(
                f"{where_named}: {odd[0]!r} does not go with {form!r}; expected {', '.join(keys)}"
            )
        if (required := _REQUIRED_KEYS.get(form, form)) not in values and form != "per":
            raise MechanismError(f"{where_named}: {form!r} needs {required!r} beside it")
        try:
            return Term(parameter, _basis(form, values), of=influence)
        except MechanismError as error:
            raise MechanismError(f"{where_named}: {error}") from error


def _basis(form: str, values: dict[str, Any]) -> Harmonic | Power | Knot | Share:
    """Return what an amplitude multiplies, of the keys of a term."""
    if form in ("sine", "cosine"):
        return Harmonic(values.pop(form), form, **values)  # type: ignore[arg-type]
    if form == "power":
        return Power(**values)
    if form == "knots":
        return Knot(tuple(values.pop(form)), **values)
    return Share(**values)


def _described_term(term: Term, place: str) -> _Flow:
    """Return the keys of a term, as ``TermSpec`` reads them; defaults are left out.

    Raises:
        MechanismError: it is a function of one's own, which is code.
    """
    if not term.has_form:
        raise MechanismError(
            f"{place}: the term of {term.parameter!r} is code, which a mechanism's folder "
            "does not hold; save the mechanism without terms, and its parameters "
            "(mechanism.parameters)"
        )
    basis: Any = term.basis
    keys: dict[str, Any] = {"of": term.of} if term.of else {}
    if isinstance(basis, Harmonic):
        keys |= {basis.phase: basis.order}
    elif isinstance(basis, Power):
        keys |= {"power": basis.power, "range": basis.range}
    elif isinstance(basis, Knot):
        keys |= {"knots": list(basis.knots), "knot": basis.knot}
    elif not term.of:
        keys |= {"per": basis.per}
    defaults = type(basis).__dataclass_fields__
    for name in ("period", "centre", "periodic", "per", "reference"):
        if name in defaults and (value := getattr(basis, name)) != defaults[name].default:
            keys[name] = value
    return _Flow(keys)


def _described_terms(terms: Iterable[Term], place: str) -> dict[str, Any]:
    return {term.parameter: _described_term(term, place) for term in terms}


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


def _described_sensor(sensor: Sensor, leg: str) -> dict[str, Any]:
    """Return the keys of a sensor, on one line unless it has terms."""
    names = ("joint", "form", "gain", "offset", "direction", "zero", "counts_per_unit")
    keys = {name: value for name in names if (value := getattr(sensor, name)) is not None}
    if not sensor.terms:
        return _Flow(keys)
    return keys | {"terms": _described_terms(sensor.terms, leg)}


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
        """Return the coordinates that place a joint, none if it is placed by its URDF alone.

        Raises:
            MechanismError: several coordinates in one entry, or one that there is not.
        """
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


def _described_leg(leg: Leg) -> dict[str, Any]:
    """Return the keys of a leg.

    Raises:
        MechanismError: a term that is code.
    """
    keys: dict[str, Any] = {
        "name": leg.name,
        "urdf": f"{leg.name}.urdf",
        "tip": leg.tip,
        "platform_point": leg.point.name,
        **({} if leg.closes == "point" else {"closes": leg.closes}),
        "home": _Flow((joint.name, joint.home) for joint in leg.moving),
        "sensors": [_described_sensor(sensor, leg.name) for sensor in leg.sensors],
        "parameters": dict(leg.parameters),
        "placements": {
            joint.name: [
                _Flow({c.kind: c.values[0] if len(c.values) == 1 else list(c.values)})
                for c in joint.placement.coordinates
            ]
            for joint in (*leg.joints, leg.point)
            if joint.placement.coordinates
        },
    }
    if leg.terms:
        keys["terms"] = {
            parameter: _described_terms((t for name, t in leg.terms if name == parameter), leg.name)
            for parameter in leg.deformed
        }
    return keys


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
        """Return the platform.

        Raises:
            MechanismError: a kind that there is not, or a home with other coordinates.
        """
        kind = self.kind
        form = kind if isinstance(kind, str) else PlatformKind(kind.name, tuple(kind.freedoms))
        platform = Platform(form, tuple(self.home.values()))
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
    """Return the text of a mechanism's ``mechanism.yaml``.

    Raises:
        MechanismError: a term that is code.
    """
    platform, load = mechanism.platform, mechanism.load
    kind: Any = platform.kind
    if kind not in KINDS:
        kind = _Flow(name=platform.kind, freedoms=list(platform.form.freedoms))
    keys: dict[str, Any] = {
        "pincal": FORMAT,
        "name": mechanism.name,
        **({"description": mechanism.description} if mechanism.description else {}),
        "platform": {
            "kind": kind,
            "urdf": "platform.urdf",
            "home": _Flow(zip(platform.coordinates, platform.home, strict=True)),
        },
        "legs": [_described_leg(leg) for leg in mechanism.legs],
        **({"labels": dict(mechanism.labels)} if mechanism.labels else {}),
    }
    if load is not None:
        keys["load"] = {
            "mass": load.mass,
            "centre": list(load.centre),
            "gravity": list(load.gravity),
            **({"drawn": dict(load.drawn)} if load.drawn else {}),
        }
    header = "# A mechanism of pincal. Lengths in m, angles in rad. See docs/mechanism_files.md\n"
    return header + yaml.dump(keys, Dumper=_Dumper, sort_keys=False, width=100)


class _Flow(dict[str, Any]):
    """A mapping that YAML writes on one line."""


class _Dumper(yaml.CSafeDumper):
    """Writes ``_Flow`` mappings on one line, and NumPy's numbers as Python's."""


_Dumper.add_representer(
    _Flow,
    lambda dumper, data: dumper.represent_mapping("tag:yaml.org,2002:map", data, flow_style=True),
)
for _number in (np.floating, np.integer):
    _Dumper.add_multi_representer(_number, lambda dumper, n: dumper.represent_data(n.item()))
