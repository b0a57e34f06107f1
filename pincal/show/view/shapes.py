"""The simple shapes that a URDF's links are drawn with, as another reader finds them."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Shape:
    """A box, cylinder (along z) or sphere on a link."""

    kind: str
    size: tuple[float, ...]
    """Edges of a box; radius and length of a cylinder; radius of a sphere; [m]."""
    T_link_shape: Array
    """Shape (4, 4)."""
    colour: str
    """``"#rrggbb"``."""


def urdf_shapes(text: str) -> list[tuple[Shape, ...]]:
    """Return the visuals of a URDF that pincal wrote, link by link in the URDF's order."""
    import yourdfpy  # slow to import, and needed here only

    urdf = yourdfpy.URDF.load(BytesIO(text.encode()), load_meshes=False, build_scene_graph=False)
    return [tuple(map(_shape, link.visuals)) for link in urdf.robot.links]


def _shape(visual: Any) -> Shape:
    """Return a visual of yourdfpy's."""
    geometry = visual.geometry
    if geometry.box is not None:
        kind, size = "box", geometry.box.size
    elif geometry.cylinder is not None:
        kind, size = "cylinder", (geometry.cylinder.radius, geometry.cylinder.length)
    else:
        kind, size = "sphere", (geometry.sphere.radius,)
    origin = np.eye(4) if visual.origin is None else np.asarray(visual.origin, dtype=np.float64)
    colour = "#" + "".join(f"{round(255 * c):02x}" for c in visual.material.color.rgba[:3])
    return Shape(kind, tuple(map(float, size)), origin, colour)
