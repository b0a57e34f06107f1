"""Limits of poses: a box for the coordinates, a floor, and bodies that are kept out.

All bodies are convex: a floor is a half-space, a box has six, a mesh counts as its convex hull. A
body is the intersection of half-spaces A x < b, shifted outward by the clearance. Points of the
machine, and their straight paths between poses, stay outside.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from pincal.errors import FileError, MeasurementError
from pincal.files.text import in_si
from pincal.kinematics.configurations import as_plan, joints_at
from pincal.model import Mechanism, Plan, Setup
from pincal.option import option
from pincal.types import Array, Mask

_BOX = "'x=0.2..0.5, y=0..1'"
_SPACE = dict.fromkeys("xyz", "m")
_ANY = (-np.inf, np.inf)
_NEXT = re.compile(r",(?=\s*(?:\w+\s*=|$))")  # a comma that no decimal follows


@dataclass(frozen=True)
class Limits:
    """Limits of poses; the clearance is that of points, not of the bodies of links."""

    box: str = option(
        "",
        "Ranges of the platform's coordinates: 'x=-0.1..0.1, z=1.6..1.8, phi=-20deg..20deg'; an "
        "end may be left out.",
        metavar="RANGES",
    )
    floor: float | None = option(
        None,
        "Height above which the platform, its targets and all joints that move stay [m].",
        unit="m",
    )
    keep_out: tuple[str, ...] = option(
        (),
        f"Box, such as {_BOX}, or mesh (.stl, .obj, in m; its hull counts), that the "
        "same points stay out of; may be repeated.",
        metavar="RANGES|MESH",
    )
    clearance: float = option(
        0.0,
        "Distance kept from floor and --keep-out, at poses and on straight paths between [m].",
        unit="m",
    )

    @cached_property
    def bodies(self) -> dict[str, tuple[Array, Array]]:
        """Bodies that points stay out of: A, shape (k, 3), and b, shape (k,), [m], by option.

        Raises:
            MeasurementError: a range cannot be read, or the floor or clearance is not finite.
            FileError: a mesh cannot be read, or has no inside.
        """
        if not np.isfinite(self.floor or 0.0) or not 0.0 <= self.clearance < np.inf:
            raise MeasurementError(
                f"--floor {self.floor}, --clearance {self.clearance}: expected a finite height, "
                "and a distance of 0 or more"
            )
        bodies = dict[str, tuple[Array, Array]]()
        if self.floor is not None:
            bodies[f"--floor {self.floor:g} m"] = np.eye(3)[2:], np.array([self.floor])
        for text in self.keep_out:
            if "=" in text:
                low, high = np.array([_ranges(text, _SPACE).get(n, _ANY) for n in "xyz"]).T
                A, b = np.vstack((np.eye(3), -np.eye(3))), np.append(high, -low)
            else:
                try:
                    Path(text).stat()
                    mesh: Any = trimesh.load(text, force="mesh", process=False)
                    planes = ConvexHull(np.asarray(mesh.vertices)).equations
                except Exception as error:  # readers of meshes raise many types
                    raise FileError(
                        f"--keep-out {text}: neither a box, such as {_BOX}, nor a mesh "
                        f"that has an inside: {str(error).strip().partition(chr(10))[0]}"
                    ) from error
                A, b = planes[:, :3], -planes[:, 3]
            bodies[f"--keep-out {text}"] = A, b
        return {name: (A, b + self.clearance) for name, (A, b) in bodies.items()}

    def allow(self, mechanism: Mechanism, offered: Plan, setup: Setup) -> Mask:
        """Return the mask of the configurations within all limits, shape (N,)."""
        masks = self.within(mechanism, offered, setup).values()
        return np.logical_and.reduce([np.ones(len(offered), dtype=bool), *masks])

    def within(self, mechanism: Mechanism, offered: Plan, setup: Setup) -> dict[str, Mask]:
        """Return which configurations each limit allows, shape (N,), by words on the limit."""
        platform, allowed = mechanism.platform, dict[str, Mask]()
        units = dict(zip(platform.coordinates, platform.units, strict=True))
        for name, (low, high) in _ranges(self.box, units).items():
            values = offered.poses[:, platform.coordinates.index(name)]
            asked, reached = (
                f"{name}={a:.4g}..{b:.4g}".replace("-inf", "").replace("inf", "")
                for a, b in ((low, high), (values.min(), values.max()))
            )
            words = f"--box {asked} {units[name]}, where candidates span {reached}"
            allowed[words] = (values >= low) & (values <= high)
        if not self.bodies:
            return allowed
        points, owners = moving_points(mechanism, offered, setup)
        for body, (A, b) in self.bodies.items():
            inside = np.all(points @ A.T < b, axis=2)
            words = f"{body} with --clearance {self.clearance:g} m" if self.clearance else body
            words += f", most often because of {owners[int(inside.sum(axis=0).argmax())]}"
            allowed[words] = ~inside.any(axis=1)
        return allowed

    def blocked(self, mechanism: Mechanism, plan: Plan, setup: Setup) -> Mask:
        """Return which straight paths between N rows lead a point through a body, (N, N)."""
        blocked = np.zeros((len(plan), len(plan)), dtype=bool)
        points = moving_points(mechanism, plan, setup)[0] if self.bodies else np.empty(0)
        for A, b in self.bodies.values():
            heights = points @ A.T  # inside the body where all are below b
            for row, begin in enumerate(heights):
                along, room = heights - begin, b - begin  # inside where t · along < room
                with np.errstate(divide="ignore", invalid="ignore"):
                    at = room / along
                first = np.where(along < 0.0, at, 0.0).max(axis=2).clip(min=0.0)
                last = np.where(along > 0.0, at, 1.0).min(axis=2).clip(max=1.0)
                inside = (first < last) & ((along != 0.0) | (room > 0.0)).all(axis=2)
                blocked[row] |= inside.any(axis=1)
        return blocked


def moving_points(mechanism: Mechanism, plan: Plan, setup: Setup) -> tuple[Array, list[str]]:
    """Return positions, (N, P, 3), [m], base frame, of platform, targets and joints that move.

    Their P names follow.
    """
    plan = as_plan(mechanism, plan)
    joints, T = joints_at(mechanism, plan).joints, mechanism.platform.matrices(plan.poses)
    offsets = np.array([(0.0, 0.0, 0.0), *(target.offset for target in setup.targets.values())])
    tips = T[:, None, :3, 3] + offsets @ T[:, :3, :3].transpose(0, 2, 1)
    points, names = [tips], ["the platform", *setup.targets]
    for leg in mechanism.legs:
        places = leg.link_placements(joints[leg.name])[:, :, :3, 3]
        moving = np.ptp(places, axis=0).max(axis=1) > 0.0
        points.append(places[:, moving])
        names += [f"{j.name} of {leg.name}" for j, m in zip(leg.joints, moving, strict=True) if m]
    return np.concatenate(points, axis=1), names


def _ranges(text: str, units: Mapping[str, str]) -> dict[str, tuple[float, float]]:
    """Return lowest and highest values, SI, by name, of a text ``x=-0.1..0.1, z=..1.8``."""
    ranges: dict[str, tuple[float, float]] = {}
    for part in filter(None, map(str.strip, _NEXT.split(text))):
        name, _, ends = (word.strip() for word in part.partition("="))
        low, dots, high = (word.strip() for word in ends.partition(".."))
        unit = units.get(name)
        if not dots or unit is None:
            raise MeasurementError(
                f"{part!r} is no range; expected for example 'x=-0.1..0.1' or 'x=-100mm..100mm', "
                f"with a name of {', '.join(units)}"
            )
        ranges[name] = in_si(low or "-inf", unit), in_si(high or "inf", unit)
        if not ranges[name][0] < ranges[name][1]:
            raise MeasurementError(f"{part!r}: expected the lower end first")
    return ranges
