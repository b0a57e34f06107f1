"""A new mechanism: an architecture, its dimensions, and what a machine of them cannot do."""

from __future__ import annotations

import re
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

import numpy as np

from pincal.architectures.catalogue import ARCHITECTURES
from pincal.architectures.dimension import Architecture, Values, sized
from pincal.errors import MechanismError
from pincal.kinematics.configurations import beyond_limits
from pincal.kinematics.singularity import home_determinant
from pincal.model.checks import must_be
from pincal.model.mechanism import Mechanism
from pincal.symmetry.carry import at_home

_FLAT = 1e-3  # of what the legs' lines span at home


def new_mechanism(architecture: str, *, name: str = "", **dimensions: Any) -> Mechanism:
    """Return a mechanism of a data sheet's dimensions: ``new_mechanism("hexapod", height=0.4)``.

    Args:
        architecture: ``"hexapod"``, ``"delta"``, ``"linear-delta"``, ``"five-bar"``, ``"3-RRR"``,
            ``"cable-4"``, ``"cable-8"``, or ``"arm"``.
        name: Of the mechanism; that of the architecture if not given.
        **dimensions: By name (``pincal new --help`` lists them): lengths [m], angles [rad], texts.
            Those not given are in proportion to these.

    Raises:
        MechanismError: no such architecture or dimension; one that cannot be; dimensions with
            which a leg does not reach home, or is outside its limits there, or with which the
            legs do not hold the platform there.
        FileError: the table of an arm is missing or cannot be read.
        MeasurementError: a table of an arm with a column or cell that is missing or wrong.
    """
    kind = architecture_of(architecture)
    values = kind.complete(dimensions)
    made = kind.make(values)
    described = f"{kind.title}: {', '.join(kind.sheet(values))}."
    name, description = name or kind.name.replace("-", "_"), made.description or described
    made = replace(made, name=name, description=description)
    return made if made.by_readings else _at_home(made, kind, values)


def architecture_of(name: str) -> Architecture:
    """Return an architecture by its name."""
    known = {key.lower().replace("-", ""): kind for key, kind in ARCHITECTURES.items()}
    plain = re.sub("[-_]", "", must_be(name, str, "the architecture", MechanismError).lower())
    if plain not in known:
        near = get_close_matches(plain, known, 1)
        meant = f"; did you mean {known[near[0]].name!r}?" if near else ""
        raise MechanismError(
            f"no architecture {name!r}; expected one of {', '.join(ARCHITECTURES)}{meant}"
        )
    return known[plain]


def _at_home(made: Mechanism, kind: Architecture, values: Values) -> Mechanism:
    """Return a mechanism with its legs closed at home."""
    change = f"change one of {', '.join(kind.sheet(values))}"
    platform, legs = made.platform, []
    for leg in made.legs:
        try:
            legs.append(at_home(leg, platform))
        except MechanismError as error:
            raise MechanismError(
                f"{kind.name}: {leg.name} is too short or too long for the home pose; {change}"
            ) from error
        for place in np.flatnonzero(beyond_limits(legs[-1], legs[-1].home[None])[0]):
            joint = legs[-1].moving[place]
            ends = (joint.home, joint.lower, joint.upper)
            position, lower, upper = (sized(end, "rad" if joint.turns else "m") for end in ends)
            raise MechanismError(
                f"{kind.name}: at home joint {joint.name!r} of {leg.name} is at {position}, "
                f"outside its limits {lower} to {upper}; {change}"
            )
    made = replace(made, legs=tuple(legs))
    if not abs(home_determinant(made)) >= _FLAT:  # it is NaN where a leg misses home
        raise MechanismError(
            f"{kind.name}: the legs do not hold the platform at home, a singular pose; {change}"
        )
    return made
