"""Joint centres and lengths of a machine, as a data sheet and as LinuxCNC's hexapod has them.

They are read off the closed forms of legs (``kinematics.closed_forms``): struts and cables, rods on
cranks and on carriages. Standard errors are those of the parameters, carried on to first order.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pincal.errors import MechanismError
from pincal.kinematics.closed_forms import ClosedForm, closed_form
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.model.leg import Leg
from pincal.model.mechanism import Mechanism
from pincal.model.platform import Platform
from pincal.types import Array

_STEP = 1e-6  # of parameters, for differences [m] or [rad]
_MOVED = 1e-6  # by a direction of length 1: it is not determined
Columns = dict[str, list[str] | Array]


def _geometry(leg: Leg, platform: Platform, parameters: Array) -> dict[str, tuple[str, Array]]:
    """Return what a leg's joints are and where, by name: unit, and one or three numbers."""
    closure = LegClosure(leg, platform, parameters)
    form, law = closed_form(closure), sensor_law(closure)
    if form is None or leg.active != [form.driven] or law.terms:
        return {}
    point = closure.targets(np.eye(4)[None])[0]
    start, slope = law.start[0], law.slope[0]
    gained = {"reading: gain": ("1", np.array([1.0 / slope]))}
    if form.frame is None:
        zero = form.mode * (start + form.length)
        return {
            "base joint": ("m", form.centre),
            "platform joint": ("m", point),
            "length at reading 0": ("m", np.array([zero])),
            "length by reading": ("1", np.array([form.mode * slope])),
        }
    rod = {"rod length": ("m", np.array([form.length])), "platform joint": ("m", point)}
    u, v, axis = form.frame.T
    if form.radius:
        zero = np.cos(start) * u + np.sin(start) * v
        crank = {
            "crank centre": ("m", form.centre),
            "crank axis": ("1", axis),
            "crank direction at reading 0": ("1", zero),
            "crank length": ("m", np.array([form.radius])),
        }
        return crank | rod | gained
    carriage = {
        "carriage joint at reading 0": ("m", form.centre + start * v),
        "carriage direction": ("1", v),
    }
    return carriage | rod | gained


def geometry_sheet(
    mechanism: Mechanism, uncertain: Mapping[str, tuple[Array, Array]] | None = None
) -> Columns:
    """Return joint centres, directions and lengths of all legs, with standard errors.

    Base joints are in the base frame, platform joints in the platform frame.

    Args:
        mechanism: The machine, at its nominal parameters.
        uncertain: By leg, covariance of its parameters, shape (n_params, n_params), and directions
            of them that nothing determines, (n_params, n_lost).

    Returns:
        Columns leg, what, axis, value, ± and unit; of a leg without a closed form, its parameters.
        NaN is the ± of what is not known or not determined.
    """
    rows: list[tuple[str, str, str, float, float, str]] = []
    for leg in mechanism.legs:
        nominal, platform = leg.nominal, mechanism.platform
        described = _geometry(leg, platform, nominal)
        if not described:
            described = {n: (leg.units[n], nominal[[i]]) for i, n in enumerate(leg.parameter_names)}
        flat = np.concatenate([values for _, values in described.values()])
        std = np.full(len(flat), np.nan)
        if uncertain is not None:
            by_parameter = np.zeros((len(flat), len(nominal)))
            for place, step in enumerate(_STEP * np.eye(len(nominal))):
                ends = []
                for moved in (nominal + step, nominal - step):
                    sheet = _geometry(leg, platform, moved)
                    parts = [v for _, v in sheet.values()] if sheet else [moved]
                    ends.append(np.concatenate(parts))
                by_parameter[:, place] = (ends[0] - ends[1]) / (2.0 * _STEP)
            covariance, lost = uncertain[leg.name]
            variance = np.einsum("ij,jk,ik->i", by_parameter, covariance, by_parameter)
            determined = ~(np.abs(by_parameter @ lost) > _MOVED).any(axis=1)
            std = np.where(determined, np.sqrt(np.maximum(variance, 0.0)), np.nan)
        errors = iter(std)
        for what, (unit, values) in described.items():
            axes = "xyz" if len(values) == 3 else ("",)
            for axis, value, error in zip(axes, values, errors, strict=False):
                rows.append((leg.name, what, axis, float(value), float(error), unit))
    leg_names, whats, axes_, values_, errors_, units = (list(c) for c in zip(*rows, strict=True))
    shown = [float(f"{error:.3g}") for error in errors_]
    numbers = {"value": np.round(values_, 10), "standard error": np.array(shown)}
    return {"leg": leg_names, "what": whats, "axis": axes_, **numbers, "unit": units}


def genhexkins(mechanism: Mechanism) -> str:
    """Return the lines of HAL that give LinuxCNC's ``genhexkins`` a hexapod's joint centres, [mm].

    Its joints are strut lengths, its pose X Y Z with A B C turns about fixed x, y, z, [deg].

    Raises:
        MechanismError: no hexapod with six struts on points.
    """
    closures = [LegClosure(leg, mechanism.platform) for leg in mechanism.legs]
    forms = [form for closure in closures if (form := _strut(closure))]
    if mechanism.platform.dof != 6 or not len(forms) == len(closures) == 6:
        raise MechanismError(
            f"{mechanism.name!r} is no hexapod with six struts between points, the machine that "
            "genhexkins is for"
        )
    lines = [f"# joint centres of {mechanism.name} [mm], for loadrt genhexkins"]
    for place, (form, closure) in enumerate(zip(forms, closures, strict=True)):
        point = closure.targets(np.eye(4)[None])[0]
        for owner, centre in (("base", form.centre), ("platform", point)):
            lines += [
                f"setp genhexkins.{owner}.{place}.{axis} {1e3 * value:.9f}"
                for axis, value in zip("xyz", centre, strict=True)
            ]
    lines.append("setp genhexkins.screw-lead 0")
    for place, (form, closure) in enumerate(zip(forms, closures, strict=True)):
        law = sensor_law(closure)
        zero, slope = form.mode * (law.start[0] + form.length), form.mode * law.slope[0]
        length = f"{1e3 * zero:.9f} + {slope:.12f} × reading of {closure.leg.name} [mm]"
        lines.append(f"# joint {place} [mm] = {length}{', without its terms' * bool(law.terms)}")
    return "\n".join(lines) + "\n"


def _strut(closure: LegClosure) -> ClosedForm | None:
    """Return the closed form of a leg that is a driven strut between two points."""
    form = closed_form(closure)
    driven = form is not None and form.frame is None and closure.leg.active == [form.driven]
    return form if driven else None
