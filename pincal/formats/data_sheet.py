"""Joint centres and lengths of a machine, as in data sheets and in LinuxCNC.

They come from the closed forms of legs (``kinematics.closed_forms``): struts, cables, and rods on
cranks or carriages. Standard errors are propagated from the parameters to first order.
"""

import numpy as np
from scipy.optimize import least_squares

from pincal.errors import MechanismError
from pincal.kinematics.closed_forms import closed_form
from pincal.kinematics.closing import sensor_law
from pincal.kinematics.closure import LegClosure
from pincal.kinematics.configurations import inverse
from pincal.kinematics.forward import forward
from pincal.model import Leg, Mechanism, Platform
from pincal.types import Array
from pincal.words.numbers import SI, UNITS, Units, amount

_ZERO = "length at reading 0"  # of struts and cables only
_STEP = 1e-6  # step of parameters for central differences, [m] or [rad]
_MOVED = 1e-6  # change by an undetermined unit direction from which a value is undetermined
Columns = dict[str, list[str] | Array]


def _geometry(leg: Leg, platform: Platform, parameters: Array) -> dict[str, tuple[str, Array]]:
    """Return a leg's dimensions by name: unit, and one or three numbers.

    A leg without a closed form has its parameters instead.
    """
    closure = LegClosure(leg, platform, parameters)
    form, law = closed_form(closure), sensor_law(closure)
    if form is None or leg.active != [form.driven] or law.terms:
        return {
            name: (leg.units[name], parameters[[i]]) for i, name in enumerate(leg.nominal_by_name)
        }
    point = closure.targets(np.eye(4)[None])[0]
    start, slope = law.intercept[0], law.slope[0]
    gained = {"reading: gain": ("1", np.array([1.0 / slope]))}
    if form.frame is None:
        zero = form.mode * (start + form.length)
        return {
            "base joint": ("m", form.centre),
            "platform joint": ("m", point),
            _ZERO: ("m", np.array([zero])),
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
    mechanism: Mechanism, uncertain: tuple[Array, Array | None] | None = None, units: Units = SI
) -> Columns:
    """Return joint centres, directions and lengths of all legs, with standard errors.

    Base joints are in the base frame, platform joints in the platform frame.

    Args:
        mechanism: The machine, at its nominal parameters.
        uncertain: Covariance of all legs' parameters, shape (n_params, n_params), and their
            undetermined directions, shape (n_params, n_lost) or None.
        units: Units of lengths and angles.

    Returns:
        Columns leg, what, axis, value, standard error and unit. Standard errors are NaN if not
        known or not determined.
    """
    rows: list[tuple[str, str, str, float, float, str]] = []
    end = 0
    for leg in mechanism.legs:
        nominal, platform = leg.nominal, mechanism.platform
        part, end = slice(end, end + len(nominal)), end + len(nominal)
        described = _geometry(leg, platform, nominal)
        flat = np.concatenate([values for _, values in described.values()])
        std = np.full(len(flat), np.nan)
        if uncertain is not None:
            by_parameter = np.zeros((len(flat), len(nominal)))
            for place, step in enumerate(_STEP * np.eye(len(nominal))):
                sheets = (_geometry(leg, platform, nominal + way * step) for way in (1.0, -1.0))
                ends = [np.concatenate([v for _, v in sheet.values()]) for sheet in sheets]
                by_parameter[:, place] = (ends[0] - ends[1]) / (2.0 * _STEP)
            covariance, lost = uncertain[0][part, part], uncertain[1]
            std = np.sqrt(np.einsum("ij,jk,ik->i", by_parameter, covariance, by_parameter).clip(0))
            if lost is not None:
                std[(np.abs(by_parameter @ lost[part]) > _MOVED).any(axis=1)] = np.nan
        errors = iter(std)
        for what, (unit, values) in described.items():
            shown = units.names.get(unit, unit)
            axes, scale = "xyz" if len(values) == 3 else ("",), UNITS.get(shown, ("", 1.0))[1]
            for axis, value, error in zip(axes, values / scale, errors, strict=False):
                rows.append((leg.name, what, axis, float(value), float(error) / scale, shown))
    heads = ("leg", "what", "axis", "value", "standard error", "unit")
    columns: Columns = dict(zip(heads, map(list, zip(*rows, strict=True)), strict=True))
    columns["value"] = np.round(np.asarray(columns["value"], float), 10)
    columns["standard error"] = np.array([float(f"{e:.3g}") for e in columns["standard error"]])
    return columns


def genhexkins(mechanism: Mechanism) -> str:
    """Return HAL lines that give LinuxCNC's ``genhexkins`` the joint centres of a hexapod, [mm].

    Its joints are strut lengths; its poses X, Y, Z and rotations A, B, C about fixed axes, [deg].

    Raises:
        MechanismError: the machine is no hexapod with six struts between points.
    """
    platform, plain = mechanism.platform, [leg.without_terms for leg in mechanism.legs]
    legs = [_geometry(leg, platform, leg.nominal) for leg in plain]
    if platform.dof != 6 or len(legs) != 6 or not all(_ZERO in leg for leg in legs):
        raise MechanismError(
            f"{mechanism.name!r} is no hexapod with six struts between points, the only kind of "
            "machine that genhexkins supports"
        )
    lines = [f"# joint centres of {mechanism.name} [mm], for loadrt genhexkins"]
    for place, described in enumerate(legs):
        for owner in ("base", "platform"):
            lines += [
                f"setp genhexkins.{owner}.{place}.{axis} {1e3 * value:.9f}"
                for axis, value in zip("xyz", described[f"{owner} joint"][1], strict=True)
            ]
    lines.append("setp genhexkins.screw-lead 0")
    for place, (leg, described) in enumerate(zip(mechanism.legs, legs, strict=True)):
        (zero,), (slope,) = described[_ZERO][1], described["length by reading"][1]
        length = f"{1e3 * zero:.9f} + {slope:.12f} × reading of {leg.name} [mm]"
        lines.append(
            f"# joint {place} [mm] = {length}{', without its terms' * bool(leg.amplitudes)}"
        )
    return "\n".join(lines) + "\n"


_AHEAD = {"lineardeltakins": 90.0, "rotarydeltakins": -90.0}  # azimuth of joint 0 [deg]
_NO_DELTA = "no delta that LinuxCNC has kinematics for"
_ALIKE = 0.05  # largest error of a delta's kinematics, over the size, for a machine to be one


def _delta_legs(mechanism: Mechanism) -> tuple[str, list[int], Array, list[float], float]:
    """Return a delta's kinematics, and the values from which its fit starts.

    They are the legs in the order of its joints, senses of the drives, lengths and the azimuth of
    the first leg; distances are net of the platform's points.

    Raises:
        MechanismError: the machine is no delta of three carriages or cranks.
    """
    closures = [LegClosure(leg, mechanism.platform) for leg in mechanism.legs]
    forms = [form for c in closures if (form := closed_form(c)) and c.leg.active == [form.driven]]
    ways = np.array([form.frame[2, 1] for form in forms if form.frame is not None])
    if mechanism.platform.kind != "translational" or not len(ways) == len(closures) == 3:
        raise MechanismError(f"{mechanism.name!r} is {_NO_DELTA}")
    points = np.array([closure.targets(np.eye(4)[None])[0] for closure in closures])
    towers = (np.array([form.centre for form in forms]) - points)[:, :2]
    turns = np.arctan2(towers[:, 1], towers[:, 0])
    order = np.argsort((turns - turns[0] + 0.1) % (2.0 * np.pi))  # counterclockwise
    lengths = [float(np.linalg.norm(towers, axis=1).mean()), forms[0].length]
    places, upward = order.tolist(), np.sign(ways)[order]
    if not forms[0].radius:
        return "lineardeltakins", places, upward, lengths, turns[0]
    return "rotarydeltakins", places, -upward, [*lengths, forms[0].radius], turns[0]


def deltakins(mechanism: Mechanism, poses: Array) -> str:
    """Return HAL lines for LinuxCNC's ``lineardeltakins`` or ``rotarydeltakins``, [mm].

    Their few parameters, a zero of each joint, and a frame shifted and turned about z are fitted to
    the machine's drives at poses (N, 3); the lines state the remaining error.

    Raises:
        MechanismError: the machine is no delta of three carriages or cranks above the platform.
    """
    kind, order, signs, sizes, azimuth = _delta_legs(mechanism)
    legs, turning = [mechanism.legs[place] for place in order], kind == "rotarydeltakins"
    solved = inverse(mechanism, poses).joints
    q = signs * np.transpose([solved[leg.name][:, leg.active[0]] for leg in legs])
    begin = np.array([0.0, 0.0, 0.0, azimuth - np.radians(_AHEAD[kind]), 0.0, 0.0, 0.0, *sizes])

    def drives(unknowns: Array) -> Array:
        """Return LinuxCNC's joints minus zeros, (N, 3), [m] or [rad].

        Unknowns are a frame (4), zeros (3), and radius and rod, or hip minus foot radius, shin and
        thigh, [m].
        """
        (x, y, z, turn), zeros, (radius, rod, *thigh) = np.split(unknowns, [4, 7])
        c, s = np.cos(turn), np.sin(turn)
        frame = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        shift = np.array([x, y, z * turning])  # a carriage's zero already shifts along z
        positions = (poses - shift) @ frame
        azimuths = np.radians(_AHEAD[kind] + np.array([0.0, 120.0, 240.0]))
        along, z = np.array([np.cos(azimuths), np.sin(azimuths)]), positions[:, 2:]
        ahead = positions[:, :2] @ along - radius
        aside = positions[:, :2] @ np.array([-along[1], along[0]])
        with np.errstate(invalid="ignore"):  # out of reach
            if not thigh:
                return np.asarray(z + np.sqrt(rod**2 - ahead**2 - aside**2)) - zeros
            reach = (thigh[0] ** 2 + ahead**2 + aside**2 + z**2 - rod**2) / (2.0 * thigh[0])
            return -np.arctan2(z, ahead) - np.arccos(reach / np.hypot(ahead, z)) - zeros

    def missed_by(unknowns: Array) -> Array:
        return np.nan_to_num(drives(unknowns) - q)

    begin[4:7] = missed_by(begin).mean(axis=0)

    fitted = least_squares(lambda unknowns: missed_by(unknowns).ravel(), begin, x_scale="jac").x
    laws = [sensor_law(LegClosure(leg, mechanism.platform)) for leg in legs]
    start, slope = np.array([(law.intercept[0], law.slope[0]) for law in laws]).T
    readings = np.empty_like(q)
    readings[:, order] = (signs * drives(fitted) - start) / slope
    missed = np.array([np.inf])
    if np.isfinite(readings).all():
        missed = np.linalg.norm(forward(mechanism, readings, poses).poses - poses, axis=1)
    if not missed.max() < _ALIKE * mechanism.size:
        raise MechanismError(f"{mechanism.name!r} is {_NO_DELTA}")
    (x, y, z, turn), zeros, lengths = np.split(fitted, [4, 7])
    values = dict(zip(("R", "L"), lengths, strict=False))
    start, unit, scale = start + signs * zeros, "mm", 1e3
    if turning:
        point = LegClosure(legs[0], mechanism.platform).targets(np.eye(4)[None])[0]
        foot = float(np.hypot(*point[:2]))
        values = {"platformradius": lengths[0] + foot, "thighlength": lengths[2]}
        values |= {"shinlength": lengths[1], "footradius": foot}
        unit, scale = "deg", np.degrees(1.0)
    c, s = np.cos(turn), np.sin(turn)
    origin = -1e3 * np.array([c * x + s * y, c * y - s * x, z * turning])
    usual, largest = amount(np.quantile(missed, 0.95), "m"), amount(missed.max(), "m")
    lines = [
        f"# {kind} of {mechanism.name} [mm]: INI [KINS] JOINTS = 3, KINEMATICS = {kind}",
        f"# these parameters are all that {kind} holds: it misses {len(poses)} poses by "
        f"{usual} (95 %), {largest} at most",
        *(f"setp {kind}.{name} {1e3 * value:.9f}" for name, value in values.items()),
    ]
    for joint, leg in enumerate(legs):
        zero, rate = signs[joint] * start[joint] * scale, signs[joint] * slope[joint]
        reading = f"reading of {leg.name} [{unit}]"
        lines.append(f"# joint {joint} [{unit}] = {zero:.9f} + {rate:.12f} × {reading}")
    lines.append(
        f"# the machine's base frame as a work offset: G10 L2 P1 X{origin[0]:.9f} Y{origin[1]:.9f} "
        f"Z{origin[2]:.9f} R{np.degrees(-turn):.9f}"
    )
    return "\n".join(lines) + "\n"
