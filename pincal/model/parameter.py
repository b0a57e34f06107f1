"""Kinematic parameters: each has an owner, a name, and one id that is used everywhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any

import numpy as np

from pincal.errors import MechanismError
from pincal.model.checks import listed
from pincal.types import Array

#: Largest number of characters of a parameter's label.
LONGEST_LABEL = 60


def means(wanted_name: str, leg: str, name: str) -> bool:
    """Return whether a pattern (``l``, ``leg_1.l``, ``leg_1.*``) matches a leg's parameter."""
    leg_pattern, _, pattern = wanted_name.rpartition(".")
    return fnmatchcase(name, pattern) and fnmatchcase(leg, leg_pattern or "*")


@dataclass(frozen=True)
class Parameter:
    """One identified quantity and its nominal value."""

    owner: str
    """Name of the leg or instrument that has the parameter, such as ``"leg_1"``."""
    name: str
    """Name of the parameter within its owner, such as ``"l"``."""
    unit: str
    """Unit: m, rad, or 1 for a gain."""
    nominal: float
    """Nominal value, SI units."""
    label: str = field(default="", kw_only=True, compare=False)
    """Description for people, ``"radius of the base joint"``; empty if there is none."""

    @property
    def id(self) -> str:
        """Unique id, owner and name: ``"leg_1.l"``."""
        return f"{self.owner}.{self.name}"

    @property
    def column(self) -> str:
        """Header of the parameter's column in a table: ``"leg_1.l [m]"``."""
        return f"{self.id} [{self.unit}]"


class Parameters(tuple[Parameter, ...]):
    """Parameters in order, accessed by index or by id: ``parameters["leg_1.l"].nominal``."""

    @cached_property
    def _by_id(self) -> dict[str, Parameter]:
        return {parameter.id: parameter for parameter in self}

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the parameters, in order."""
        return tuple(self._by_id)

    @cached_property
    def values(self) -> Array:
        """Nominal values, shape (n_params,), SI units; not writable."""
        values = np.array([parameter.nominal for parameter in self], dtype=np.float64)
        values.setflags(write=False)
        return values

    def __getitem__(self, key: Any) -> Any:
        """Return the parameter of an index or id, or the parameters of a slice.

        Raises:
            MechanismError: no parameter has this id; the message names similar ids.
        """
        if isinstance(key, str):
            if key in self._by_id:
                return self._by_id[key]
            of_name = [i for i in self.ids if i.partition(".")[2] == key][:3]
            near = " or ".join(map(repr, get_close_matches(key, self.ids, 3) or of_name))
            meant = f"did you mean {near}?" if near else f"ids are {listed(self.ids)}"
            raise MechanismError(f"no parameter {key!r}; {meant}")
        selected = super().__getitem__(key)
        return Parameters(selected) if isinstance(key, slice) else selected

    def __contains__(self, key: object) -> bool:
        return key in self._by_id if isinstance(key, str) else super().__contains__(key)

    def __repr__(self) -> str:
        return f"Parameters({len(self)}: {listed(self.ids)})"

    def __str__(self) -> str:
        width = max(map(len, self.ids), default=0)
        lines = (f"{p.id:{width}}  {p.nominal: .6g} {p.unit:3} {p.label}" for p in self)
        return "\n".join(line.rstrip() for line in lines)


def labels_of(labels: Any, name: str) -> tuple[tuple[str, str], ...]:
    """Return a mechanism's labels of parameters as pairs of key and text, checked."""
    pairs = tuple(labels.items()) if isinstance(labels, Mapping) else labels
    for pair in pairs if isinstance(pairs, tuple) else (pairs,):
        match pair:
            case (str(), str(text)) if text.isprintable() and 0 < len(text) <= LONGEST_LABEL:
                continue
        raise MechanismError(
            f"mechanism {name!r}: one of its labels is {ascii(pair)[:80]}; expected a few words, "
            f"at most {LONGEST_LABEL} characters, by name or id of a parameter: {{'l': 'crank'}}"
        )
    return pairs
