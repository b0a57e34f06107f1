"""A mechanism: a platform and the legs that connect it to the base."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, pairwise
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from pincal.attached import attached
from pincal.errors import MechanismError
from pincal.model.checks import check_kinds, choice_of, counted, must_be, one_line
from pincal.model.consistency import check_mechanism
from pincal.model.leg import Leg
from pincal.model.parameter import Parameter, Parameters, labels_of
from pincal.model.platform import Platform
from pincal.model.terms import LOAD, OF_JOINTS, Cables, Load
from pincal.types import Array


@dataclass(frozen=True)
class Mechanism:
    """Parallel mechanism: legs from a common base to a common platform."""

    name: str
    platform: Platform
    legs: tuple[Leg, ...]
    description: str = ""
    labels: tuple[tuple[str, str], ...] = ()
    """Descriptions of parameters, by name (for all legs) or by id (for one): ``("l", "crank")``,
    ``("leg_2.l", "short crank")``. A mapping will do; keys of no parameter are not shown."""
    load: Load | None = None
    """Weight of platform and payload, and gravity, if they are known."""
    cables: Cables | None = None
    """Limits of the legs' tensions, if the legs are cables, which only pull."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", labels_of(self.labels, self.name))
        check_kinds(vars(self), Mechanism, MechanismError)
        check_mechanism(self)

    def __repr__(self) -> str:
        kind = f"{self.platform.kind} platform"
        numbers = counted(len(self.legs), "leg"), counted(len(self.parameters), "parameter")
        return one_line("Mechanism", repr(self.name), kind, *numbers)

    @attached
    def __str__(self) -> str:
        """Return a text with the platform, the legs, and a table of nominal parameters."""

    @cached_property
    def leg_names(self) -> tuple[str, ...]:
        """Names of the legs, in order."""
        return tuple(leg.name for leg in self.legs)

    @cached_property
    def size(self) -> float:
        """Length of the longest stretched leg, [m]: the scale against which errors are small."""
        return max(leg.size for leg in self.legs)

    @cached_property
    def reading_names(self) -> tuple[str, ...]:
        """Names of the readings, leg by leg."""
        return tuple(name for leg in self.legs for name in leg.reading_names)

    @cached_property
    def reading_units(self) -> tuple[str, ...]:
        """Units of the readings, rad or m."""
        return tuple(unit for leg in self.legs for unit in leg.reading_units)

    @cached_property
    def influences(self) -> tuple[str, ...]:
        """Columns of the influence quantities on which terms depend, of all legs."""
        return tuple(dict.fromkeys(name for leg in self.legs for name in leg.influences))

    @cached_property
    def amplitudes(self) -> frozenset[str]:
        """Ids of the parameters that are amplitudes of terms."""
        return frozenset(f"{leg.name}.{name}" for leg in self.legs for name in leg.amplitudes)

    @cached_property
    def load_names(self) -> tuple[str, ...]:
        """Names of the quantities that bear a load: readings, then ids of lengths and angles."""
        placed = (f"{leg.name}.{name}" for leg in self.legs for name in leg.placed)
        return (*self.reading_names, *placed)

    @cached_property
    def weighs(self) -> bool:
        """Whether loads by gravity can be computed: a load is given, or a link has a mass."""
        return self.load is not None or any(j.mass for leg in self.legs for j in leg.joints)

    @cached_property
    def loaded(self) -> tuple[str, ...]:
        """Columns of the influence quantities that are loads."""
        load_columns = {f"{LOAD}_{name}" for name in self.load_names}
        return tuple(name for name in self.influences if name in load_columns)

    @cached_property
    def followed(self) -> frozenset[str]:
        """Columns that are computed where a table lacks them: sides of approach and loads."""
        joints = {f"{kind}_{name}" for kind in OF_JOINTS for name in self.reading_names}
        return frozenset(joints | {f"{LOAD}_{name}" for name in self.load_names})

    @cached_property
    def at_reference(self) -> Mechanism:
        """The mechanism without terms of influences: all influences are at their reference."""
        return replace(self, legs=tuple(leg.at_reference for leg in self.legs))

    @cached_property
    def without_terms(self) -> Mechanism:
        """The mechanism with geometry, gains and offsets alone, as in files of other programs."""
        return replace(self, legs=tuple(leg.without_terms for leg in self.legs))

    @cached_property
    def drawing(self) -> Mechanism:
        """The mechanism by which loads are computed: parameters as drawn, no terms."""
        drawn = {} if self.load is None else dict(self.load.drawn)
        return self.without_terms.with_parameters(drawn)

    def known(self, leg: int, readings: Array, influences: Array | None = None) -> Array:
        """Return what a leg's terms depend on, shape (N, n_active [+ n_influences of the leg]).

        They are columns of all legs' ``readings``, shape (N, n_readings), [rad] or [m], and of
        all ``influences``, shape (N, n_influences), which are at their reference if not given.
        """
        of_leg = readings[:, self.reading_columns[leg]]
        if influences is None:
            return of_leg
        return np.hstack((of_leg, self.influences_at(leg, influences)))

    def influences_at(self, leg: int, influences: Array) -> Array:
        """Return a leg's columns of all legs' influences, shape (N, n_influences of the leg)."""
        return influences[:, [self.influences.index(name) for name in self.legs[leg].influences]]

    @cached_property
    def counts(self) -> dict[str, float]:
        """Encoder counts per rad or m, by name of the readings whose sensors state them."""
        every = [sensor.counts_per_unit for leg in self.legs for sensor in leg.sensors]
        pairs = zip(self.reading_names, every, strict=True)
        return {name: per_unit for name, per_unit in pairs if per_unit is not None}

    @cached_property
    def reading_columns(self) -> tuple[slice, ...]:
        """Columns of each leg's readings among all readings."""
        ends = accumulate((len(leg.sensors) for leg in self.legs), initial=0)
        return tuple(slice(start, end) for start, end in pairwise(ends))

    @cached_property
    def constraints(self) -> int:
        """Number of equations by which the legs constrain the pose, passive joints eliminated."""
        return sum(max(self.platform.equations(leg), 0) for leg in self.legs)

    @cached_property
    def by_readings(self) -> bool:
        """Whether readings determine poses, but poses do not determine readings.

        Examples are an arm, with or without loops within it, whose inverse kinematics has many
        solutions, and a leg with fewer joints than closure rows, which reaches only a surface of
        poses. Poses of such mechanisms are generated by forward kinematics.
        """
        return len(self.legs) == 1 or any(
            not leg.passive or len(leg.moving) != self.platform.rows(leg) for leg in self.legs
        )

    @property
    def redundant(self) -> bool:
        """Whether there are more equations than freedoms, so that readings may contradict."""
        return self.constraints > self.platform.dof

    def leg(self, name: str) -> Leg:
        """Return a leg by name; raise MechanismError if there is none."""
        choice_of(name, self.leg_names, f"leg of {self.name!r}", MechanismError)
        return self.legs[self.leg_names.index(name)]

    def with_parameters(
        self, values: Mapping[str, float | Mapping[str, float] | Sequence[float] | Array]
    ) -> Mechanism:
        """Return the mechanism with other nominal parameters; those not named are kept.

        Args:
            values: Values by id (``{"leg_1.l": 0.31}``); or by leg, each by name or all in order.

        Raises:
            MechanismError: an unknown leg or parameter, a wrong number of values, or a non-number.
        """
        new, by_id = dict[str, Any](), dict[str, Any]()
        for key, value in must_be(values, Mapping, "parameters", MechanismError).items():
            if key in self.leg_names or not ("." in str(key) or isinstance(value, Real)):
                new[self.leg(key).name] = value
            else:
                by_id[str(key)] = value
        for key, value in by_id.items():
            parameter = self.parameters[key]
            of_leg = new.get(parameter.owner, {})
            if not isinstance(of_leg, Mapping):
                raise MechanismError(
                    f"{key!r} is given twice: by its id and in the values of {parameter.owner}"
                )
            new[parameter.owner] = {**of_leg, parameter.name: value}
        legs = tuple(leg.with_parameters(new.get(leg.name, {})) for leg in self.legs)
        if legs == self.legs:
            return self
        load = self.load
        if self.loaded and self.weighs and not (load and load.drawn):
            drawn = tuple((p.id, p.nominal) for p in self.without_terms.parameters)
            load = replace(load or Load(), drawn=drawn)
        return replace(self, legs=legs, load=load)

    @cached_property
    def parameters(self) -> Parameters:
        """Identified parameters of all legs, in order, also by id: ``parameters["leg_1.l"]``."""
        labels = dict(self.labels)
        return Parameters(
            Parameter(
                leg.name,
                name,
                leg.units[name],
                value,
                label=labels.get(f"{leg.name}.{name}", labels.get(name, "")),
            )
            for leg in self.legs
            for name, value in leg.parameters
        )

    @property
    def labelled(self) -> str:
        """Descriptions of the parameters on one line; empty if there are none."""
        keys = {key for parameter in self.parameters for key in (parameter.name, parameter.id)}
        return "; ".join(f"{key}: {text}" for key, text in self.labels if key in keys)

    @property
    def nominal(self) -> dict[str, Array]:
        """Nominal parameter values by leg, each of shape (n_params,), SI units."""
        return {leg.name: leg.nominal for leg in self.legs}

    @attached
    def _repr_html_(self) -> str:
        """Return HTML for notebooks: a picture and the nominal parameters."""

    @staticmethod
    @attached
    def from_urdf(path: str | Path, tip: str, base: str | None = None) -> Mechanism:
        """Return a serial arm from any URDF, as a mechanism to calibrate.

        Args:
            path: The URDF file; links that do not lie between base and tip are left out.
            tip: Name of the last link, whose frame is the platform.
            base: Name of the first link; by default the root of the URDF.

        Raises:
            FileError: the file is missing or cannot be read.
            MechanismError: the file is not well-formed, or no joints lead from base to tip.
        """

    @attached
    def pinocchio(self) -> tuple[Any, list[Any]]:
        """Return the whole mechanism as a Pinocchio model, and constraints that close its loops.

        The ``pin.Model`` has all joints of the legs, then the platform's (one joint per position;
        for the orientation one joint, or a ball). Each end has a ``pin.RigidConstraintModel``. A
        configuration is the ``joints`` of inverse kinematics, leg by leg, then the platform's
        position and angle, or quaternion x, y, z, w. Parameters are nominal, without terms; masses,
        load and gravity are included as far as they are known.

        Raises:
            MechanismError: a joint follows another, or an end closes neither a point nor a frame.

        Example:
            >>> import pincal
            >>> model, constraints = pincal.load_mechanism("3RRR").pinocchio()
            >>> model.nq, list(model.names)[-3:], len(constraints)
            (9, ['platform.x', 'platform.y', 'platform.rz'], 3)
        """

    @attached
    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """Write ``mechanism.yaml`` and the URDFs to a new folder, completely or not at all.

        Raises:
            FileError: the folder exists and ``force`` is not set, or cannot be written.
        """
