"""Mechanisms of another size: the same angles, lengths times a factor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pincal import Joint, Leg, Mechanism, Placement, Sensor

Array = NDArray[np.float64]


def scaled(mechanism: Mechanism, factor: float) -> tuple[Mechanism, Array]:
    """Return a mechanism of another size, and the factors of its coordinates, shape (dof,)."""

    def place(placement: Placement) -> Placement:
        coordinates = tuple(
            replace(c, values=tuple(
                value
                if isinstance(value, str) or c.turns
                or (index and c.kind in ("polar", "spherical"))
                else value * factor
                for index, value in enumerate(c.values)
            ))
            for c in placement.coordinates
        )  # fmt: skip
        xyz = tuple(factor * x for x in placement.xyz)
        return replace(placement, coordinates=coordinates, xyz=xyz)  # type: ignore[arg-type]

    def joint(one: Joint) -> Joint:
        size = factor if one.kind == "prismatic" else 1.0
        limits = {"lower": size * one.lower, "upper": size * one.upper, "home": size * one.home}
        return replace(one, placement=place(one.placement), **limits)

    def sensor(one: Sensor, leg: Leg) -> Sensor:
        slides = {j.name for j in leg.joints if j.kind == "prismatic"}
        size = factor if one.joint in slides else 1.0
        offset = one.offset if isinstance(one.offset, str) else size * one.offset
        zero = one.zero if isinstance(one.zero, str) else size * one.zero
        return replace(one, offset=offset, zero=zero)

    legs = tuple(
        replace(
            leg,
            joints=tuple(joint(one) for one in leg.joints),
            point=joint(leg.point),
            sensors=tuple(sensor(one, leg) for one in leg.sensors),
            parameters=tuple(
                (name, value * (factor if leg.units[name] == "m" else 1.0))
                for name, value in leg.parameters
            ),
        )
        for leg in mechanism.legs
    )
    platform = mechanism.platform
    factors = np.array([factor if unit == "m" else 1.0 for unit in platform.units])
    home = tuple((factors * platform.home).tolist())
    return replace(mechanism, legs=legs, platform=replace(platform, home=home)), factors
