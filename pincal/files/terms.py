"""Terms in ``mechanism.yaml``: the name of the amplitude, and what it multiplies.

Of a sensor under its ``terms``; of a leg's parameters, which follow influences only (``of``), under
the leg's: ``terms: {l: {grow: {of: temperature}}}``.

terms:
a_sin: {sine: 50}                          # sin 50 ψ; cosine likewise
screw: {power: 2, range: 0.25}             # (ψ / 0.25 m)²; centre: 0
e1: {knots: [0.0, 0.1, 0.2, 0.3], knot: 1} # table of errors, cubic between; periodic: false
warm: {of: temperature, per: 10, reference: 20}
sag: {of: time, power: 2, range: 100}      # any of these forms, of a column
play: {of: approach}
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from pincal.errors import MechanismError
from pincal.files.strict import Number, Strict
from pincal.model.sensors.terms import Harmonic, Knot, Power, Share, Term

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
