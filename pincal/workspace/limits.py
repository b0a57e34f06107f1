"""Limits of poses: a box for the coordinates, a floor, and bodies that are kept out.

All bodies are convex: a floor is a half-space, a box has six, a mesh counts as its convex hull. A
body is the intersection of half-spaces A x < b, shifted outward by the clearance. Points of the
machine, and their straight paths between poses, stay outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import trimesh
from scipy.spatial import ConvexHull

from pincal.errors import FileError, MeasurementError
from pincal.files.text import in_si
from pincal.kinematics.configurations import as_plan, joints_at
from pincal.model.measurements import Plan
from pincal.model.mechanism import Mechanism
from pincal.model.setup import Setup
from pincal.option import option
from pincal.types import Array, Mask

_SPACE = dict.fromkeys("xyz", "m")
_ANY = (-np.inf, np.inf)


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
        "Box, such as 'x=0.2..0.5, y=0..1', or mesh (.stl, .obj, in m; its hull counts), that the "
        "same points stay out of; may be repeated.",
        metavar="RANGES|MESH",
    )
    clearance: float = option(
        0.0,
        "Distance kept from floor and --keep-out, at poses and on straight paths between [m].",
        unit="m",
    )

    @cached_property
    def bodies(self) -> list[tuple[Array, Array]]:
        """Bodies that points stay out of: A, shape (k, 3), and b, shape (k,), [m], of each.

        Raises:
            MeasurementError: a range cannot be read, or the floor or clearance is not finite.
            FileError: a mesh cannot be read, or has no inside.
        """
        if not np.isfinite(self.floor or 0.0) or not 0.0 <= self.clearance < np.inf:
            raise MeasurementError(
                f"--floor {self.floor}, --clearance {self.clearance}: expected a finite height, "
                "and a distance of 0 or more"
            )
        bodies = []
        if self.floor is not None:
            bodies.append((np.array([[0.0, 0.0, 1.0]]), np.array([self.floor])))
        for text in self.keep_out:
            if "=" in text:
                low, high = np.array([_ranges(text, _SPACE).get(n, _ANY) for n in "xyz"]).T
                bodies.append((np.vstack((np.eye(3), -np.eye(3))), np.append(high, -low)))
            else:
                try:
                    mesh: Any = trimesh.load(text, force="mesh", process=False)
                    planes = ConvexHull(np.asarray(mesh.vertices)).equations
                except Exception as error:  # readers of meshes raise many types
                    raise FileError(
                        f"--keep-out {text}: neither a box, such as 'x=0.2..0.5, y=0..1', nor a "
                        f"mesh that has an inside: {str(error).strip().partition(chr(10))[0]}"
                    ) from error
                bodies.append((planes[:, :3], -planes[:, 3]))
        return [(A, b + self.clearance) for A, b in bodies]

    def allow(self, mechanism: Mechanism, offered: Plan, setup: Setup) -> Mask:
        """Return the mask of the configurations within the limits, shape (N,)."""
        platform, within = mechanism.platform, np.ones(len(offered), dtype=bool)
        ranges = _ranges(self.box, dict(zip(platform.coordinates, platform.units, strict=True)))
        for name, (low, high) in ranges.items():
            values = offered.poses[:, platform.coordinates.index(name)]
            within &= (values >= low) & (values <= high)
        if self.bodies:
            points = moving_points(mechanism, offered, setup)
            for A, b in self.bodies:
                within &= ~np.any(np.all(points @ A.T < b, axis=2), axis=1)
        return within

    def blocked(self, points: Array) -> Mask:
        """Return which straight paths between N configurations lead a point through a body, (N, N).

        ``points`` are the positions of P points, shape (N, P, 3), [m].
        """
        blocked = np.zeros((len(points), len(points)), dtype=bool)
        for A, b in self.bodies:
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


def moving_points(mechanism: Mechanism, plan: Plan, setup: Setup) -> Array:
    """Return positions of moving joints, platform and targets, (N, P, 3), [m], base frame."""
    plan = as_plan(mechanism, plan)
    joints, T = joints_at(mechanism, plan).joints, mechanism.platform.matrices(plan.poses)
    offsets = np.array([(0.0, 0.0, 0.0), *(target.offset for target in setup.targets.values())])
    tips = T[:, None, :3, 3] + offsets @ T[:, :3, :3].transpose(0, 2, 1)
    links = [leg.link_placements(joints[leg.name])[:, :, :3, 3] for leg in mechanism.legs]
    still = [np.ptp(points, axis=0).max(axis=1) == 0.0 for points in links]
    return np.concatenate((tips, *(p[:, ~s] for p, s in zip(links, still, strict=True))), axis=1)


def _ranges(text: str, units: Mapping[str, str]) -> dict[str, tuple[float, float]]:
    """Return lowest and highest values, SI, by name, of a text ``x=-0.1..0.1, z=..1.8``."""
    ranges: dict[str, tuple[float, float]] = {}
    for part in filter(None, map(str.strip, text.split(","))):
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
