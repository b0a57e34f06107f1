"""Numbers, poses, units and default classes of MJCF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lxml import etree
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pincal.errors import MechanismError
from pincal.files.input import plain_number
from pincal.model.checks import LARGEST

Array = NDArray[np.float64]
_TURNS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")


@dataclass(frozen=True)
class Compiler:
    """What the file's numbers mean."""

    angle: float = np.pi / 180
    """Size of the unit of angles, [rad]."""
    eulerseq: str = "xyz"
    autolimits: bool = True

    @staticmethod
    def of(root: etree._Element, path: Path) -> Compiler:
        """Return what all <compiler> elements say together.

        Raises:
            MechanismError: global coordinates, or a sequence of axes that is none.
        """
        said: dict[str, str] = {}
        for one in root.iterfind("compiler"):
            said |= attributes(one)
        if said.get("coordinate", "local") != "local":
            raise MechanismError(f"{path}: global coordinates are not read (nor by MuJoCo now)")
        sequence = said.get("eulerseq", "xyz")
        if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
            raise MechanismError(f"{path}: eulerseq={sequence!r} is no sequence of three axes")
        degrees = said.get("angle", "degree") == "degree"
        return Compiler(
            np.pi / 180 if degrees else 1.0, sequence, said.get("autolimits", "true") == "true"
        )

    def rotation(self, kind: str, values: tuple[float, ...]) -> Array:
        """Return the rotation, shape (3, 3), that an attribute gives."""
        if kind == "quat":
            w, x, y, z = values
            return Rotation.from_quat([x, y, z, w]).as_matrix()
        if kind == "axisangle":
            axis = np.array(values[:3]) / np.linalg.norm(values[:3])
            return Rotation.from_rotvec(self.angle * values[3] * axis).as_matrix()
        if kind == "euler":
            matrix = np.eye(3)
            for letter, value in zip(self.eulerseq, values, strict=True):
                unit = np.eye(3)["xyz".index(letter.lower())]
                turn = Rotation.from_rotvec(self.angle * value * unit).as_matrix()
                matrix = matrix @ turn if letter.islower() else turn @ matrix
            return matrix
        if kind == "xyaxes":
            x_axis = np.array(values[:3]) / np.linalg.norm(values[:3])
            y_axis = np.array(values[3:]) - (x_axis @ values[3:]) * x_axis
            y_axis = y_axis / np.linalg.norm(y_axis)
            return np.stack((x_axis, y_axis, np.cross(x_axis, y_axis)), axis=1)
        z_axis = np.array(values) / np.linalg.norm(values)
        axis = np.cross((0.0, 0.0, 1.0), z_axis)
        size = float(np.linalg.norm(axis))
        axis = axis / size if size > 0.0 else np.array([1.0, 0.0, 0.0])
        return Rotation.from_rotvec(float(np.arctan2(size, z_axis[2])) * axis).as_matrix()


class Defaults:
    """Attributes that elements have by their class."""

    def __init__(self, root: etree._Element, path: Path) -> None:
        self._path = path
        self._classes: dict[str, dict[str, dict[str, str]]] = {"main": {}}
        for one in root.iterfind("default"):
            self._enter(one, one.get("class", "main"), {})

    def _enter(
        self, element: etree._Element, name: str, above: Mapping[str, Mapping[str, str]]
    ) -> None:
        own = {tag: dict(values) for tag, values in above.items()}
        for child in element:
            if isinstance(child.tag, str) and child.tag != "default":
                own[child.tag] = own.get(child.tag, {}) | attributes(child)
        self._classes[name] = own
        for child in element.iterfind("default"):
            self._enter(child, child.get("class", ""), own)

    def of(self, element: etree._Element, own: str) -> dict[str, str]:
        """Return an element's attributes, those of its class below.

        Args:
            element: A joint or a site.
            own: Its class if it names none.

        Raises:
            MechanismError: there is no such class.
        """
        name = element.get("class", own)
        if name not in self._classes:
            raise MechanismError(
                f"{self._path}, line {element.sourceline}: no default class {name!r}"
            )
        return self._classes[name].get(str(element.tag), {}) | attributes(element)


def attributes(element: etree._Element) -> dict[str, str]:
    """Return an element's attributes."""
    return {str(key): str(value) for key, value in element.attrib.items()}


def pose(
    element: etree._Element, values: Mapping[str, str], compiler: Compiler, path: Path
) -> Array:
    """Return the pose, shape (4, 4), that an element's attributes give.

    Raises:
        MechanismError: not numbers, several orientations, or one of length zero.
    """
    matrix = np.eye(4)
    matrix[:3, 3] = numbers(element, values, "pos", "0 0 0", 3, path)
    said = [key for key in _TURNS if key in values]
    if len(said) > 1:
        raise MechanismError(
            f"{path}, line {element.sourceline}: {' and '.join(said)} both say the orientation"
        )
    if said:
        counts = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}
        own = numbers(element, values, said[0], None, counts[said[0]], path)
        zero = said[0] != "euler" and not any(own[:3] if said[0] != "quat" else own)
        if zero:
            raise MechanismError(f"{path}, line {element.sourceline}: {said[0]} of length zero")
        matrix[:3, :3] = compiler.rotation(said[0], own)
    return matrix


def numbers(
    element: etree._Element,
    values: Mapping[str, str],
    key: str,
    default: str | None,
    count: int,
    path: Path,
) -> tuple[float, ...]:
    """Return the numbers of an attribute.

    Raises:
        MechanismError: missing without a default, not finite numbers, or another count of them.
    """
    text = values.get(key, default)
    where = f"{path}, line {element.sourceline}"
    if text is None:
        raise MechanismError(f"{where}: <{element.tag}> needs {key}")
    found = tuple(plain_number(word) for word in text.split())
    if len(found) != count or not all(abs(value) <= LARGEST for value in found):
        raise MechanismError(f"{where}: {key}={text[:80]!r} should hold {count} finite numbers")
    return found
