"""What ``mechanism.yaml`` may say, read strictly: keys, types, and where a fault is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, ValidatorFunctionWrapHandler, WrapValidator

from pincal.errors import MechanismError
from pincal.files.text import Name, Number, Strict
from pincal.files.yaml import read_yaml
from pincal.model.terms import Harmonic, Knot, Power, Share, Term

#: Forms of what an amplitude multiplies: of the reading, or of a column (``of``).
_OWN = {
    "sine": ("period",),
    "cosine": ("period",),
    "power": ("range", "centre"),
    "knots": ("knot", "periodic"),
    "per": ("reference",),
}


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


def term_of(parameter: str, spec: TermSpec, where: str) -> Term:
    """Return a term of its description.

    Args:
        parameter: Name of the amplitude.
        spec: What it multiplies.
        where: For messages.

    Raises:
        MechanismError: none or several of the forms, a key that is missing or of another form, or
            a number that it cannot have.
    """
    said = {key: value for key, value in spec.model_dump().items() if value is not None}
    of = str(said.pop("of", ""))
    kinds = [key for key in _OWN if key in said] or ["per"] * bool(of)
    if len(kinds) != 1:
        raise MechanismError(
            f"{where}, term {parameter!r}: expected one of {', '.join(_OWN)}, or of alone; got "
            f"{' and '.join(kinds) or 'none'}"
        )
    kind = kinds[0]
    if odd := [key for key in said if key not in (kind, *_OWN[kind])]:
        raise MechanismError(
            f"{where}, term {parameter!r}: {odd[0]!r} does not go with {kind!r}; expected "
            f"{', '.join(_OWN[kind])}"
        )
    needed = {"power": "range", "knots": "knot"}.get(kind)
    if needed and needed not in said:
        raise MechanismError(f"{where}, term {parameter!r}: {kind!r} needs {needed!r} beside it")
    try:
        return Term(parameter, _basis(kind, said), of=of)
    except MechanismError as error:
        raise MechanismError(f"{where}, term {parameter!r}: {error}") from error


def _basis(kind: str, said: dict[str, Any]) -> Harmonic | Power | Knot | Share:
    """Return what an amplitude multiplies.

    Raises:
        MechanismError: a number that it cannot have.
    """
    if kind in ("sine", "cosine"):
        return Harmonic(said.pop(kind), kind, **said)  # type: ignore[arg-type]
    if kind == "power":
        return Power(said.pop(kind), **said)
    if kind == "knots":
        return Knot(tuple(said.pop(kind)), **said)
    return Share(**said)


def described(term: Term, where: str) -> dict[str, Any]:
    """Return a term as plain data, but for the name of its amplitude.

    Raises:
        MechanismError: it is a function of one's own, which is code.
    """
    basis, of = term.basis, {"of": term.of} if term.of else {}
    if not term.has_form:
        raise MechanismError(
            f"{where}: the term of {term.parameter!r} is code, which a mechanism's folder "
            "does not hold; save the mechanism without terms, and its parameters "
            "(mechanism.parameters)"
        )
    if isinstance(basis, Harmonic):
        return {**of, basis.phase: basis.order, **_changed(basis, "period")}
    if isinstance(basis, Power):
        return {**of, "power": basis.power, "range": basis.range, **_changed(basis, "centre")}
    if isinstance(basis, Knot):
        own = _changed(basis, "periodic")
        return {**of, "knots": list(basis.knots), "knot": basis.knot, **own}
    share = _changed(basis, "per", "reference")
    return {**of, **share} if of else {"per": 1.0, **share}


def _changed(basis: Any, *names: str) -> dict[str, Any]:
    """Return the fields that differ from their defaults."""
    fields = type(basis).__dataclass_fields__
    return {
        name: value for name in names if (value := getattr(basis, name)) != fields[name].default
    }


FORMAT = 1


Value = Name | Number


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


class KindSpec(Strict):
    """A kind of platform of the user's own."""

    name: str
    freedoms: list[str]


class PlatformSpec(Strict):
    """The platform."""

    kind: str | KindSpec
    urdf: str
    home: dict[str, Number]


class LoadSpec(Strict):
    """What weighs on the mechanism."""

    mass: Number = 0.0
    centre: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    gravity: tuple[Number, Number, Number] = (0.0, 0.0, -9.81)
    drawn: dict[str, Number] = Field(default_factory=dict)


class MechanismSpec(Strict):
    """The whole file."""

    pincal: Literal[1]
    name: str
    description: str = ""
    platform: PlatformSpec
    labels: dict[str, str] = Field(default_factory=dict)
    load: LoadSpec | None = None
    legs: list[LegSpec] = Field(min_length=1)


def read_spec(path: Path) -> MechanismSpec:
    """Return what a ``mechanism.yaml`` says.

    Raises:
        FileError: the file is missing or cannot be read.
        MechanismError: it does not parse, or says something else than it should.
    """
    return read_yaml(path, MechanismSpec, MechanismError)
