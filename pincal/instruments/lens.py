"""Lenses: projection of points in front of a camera into its image, with derivatives.

A lens is a pinhole with the distortion of D. C. Brown (1971) and A. E. Conrady (1919), or an
equidistant fisheye (J. Kannala and S. Brandt 2006); coefficients have OpenCV's names, order and
signs. Camera axes point right, down and ahead; (0, 0) is the centre of the upper left pixel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pincal.errors import MeasurementError
from pincal.model import Parameter
from pincal.model.checks import array_of, check_kinds, count_of, number_of
from pincal.types import Array, Mask

PLANE = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE = ("k1", "k2", "k3", "k4")
_COUNTS = {False: (0, 4, 5, 8), True: (0, 4)}  # numbers of coefficients in OpenCV, by fisheye
_USUAL_FOCAL = 0.8  # default focal length, over the longer side of the image
_NEWTON = 30  # largest number of Newton steps from a pixel to its ray
_NEAR = 1e-13


@dataclass(frozen=True)
class Lens:
    """A lens and its sensor: known, known roughly, or unknown.

    Example:
        >>> import pincal
        >>> lens = pincal.Lens((1600, 1200), focal=1500.0, unknown={"fx": 20.0, "fy": 20.0})
        >>> lens.project([[0.1, -0.2, 1.0]])[0].round(1).tolist()
        [[949.5, 299.5]]
    """

    size: tuple[int, int]
    """Width and height of the image, [px]."""
    focal: float | tuple[float, float] | None = None
    """Focal length, or one along x and one along y, [px]; by default 0.8 of the longer side."""
    centre: tuple[float, float] | None = None
    """Principal point, where the axis meets the image, [px]; by default the image's centre."""
    distortion: tuple[float, ...] | None = None
    """Coefficients in OpenCV's order: k1, k2, p1, p2[, k3[, k4, k5, k6]], of a fisheye k1 to k4.
    None means no distortion if the lens is known, otherwise unknown k1 to k3, p1, p2."""
    fisheye: bool = False
    """Whether the projection is equidistant, by angles, instead of onto a plane."""
    unknown: bool | Mapping[str, float] = False
    """Whether all numbers are to be identified; or prior standard deviations by name (fx, fy, cx,
    cy, k1, …), infinite for an unknown number; numbers that are not named are known."""
    name: str = "lens"
    """Owner of the lens's parameters; cameras with lenses of the same name share them."""
    focus: tuple[float, float] | None = None
    """Nearest and farthest distance at which points are sharp, [m]; by default any."""
    sigmas: dict[str, float] = field(init=False, repr=False, compare=False)
    """Prior standard deviations of the numbers to identify, infinite for unknown ones."""

    def __post_init__(self) -> None:
        def keep(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        error = MeasurementError
        check_kinds(vars(self), Lens, error)
        size = tuple(count_of(side, "a side of an image [px]", error, 1) for side in self.size)
        focal = _USUAL_FOCAL * max(size) if self.focal is None else self.focal
        pair = (focal, focal) if np.ndim(focal) == 0 else focal
        f = array_of(pair, (2,), "focal length [px]", error)
        if not (f > 0.0).all():
            raise MeasurementError(
                f"the focal length of lens {self.name!r} is {self.focal}; expected more than 0"
            )
        middle = [(side - 1) / 2 for side in size] if self.centre is None else self.centre
        d = self._coefficients()
        keep("size", size)
        keep("focal", tuple(f.tolist()))
        keep("centre", tuple(array_of(middle, (2,), "centre of an image [px]", error).tolist()))
        keep("distortion", tuple(number_of(k, "a coefficient of distortion", error) for k in d))
        sigmas = self.unknown
        if isinstance(sigmas, bool):
            sigmas = dict.fromkeys(self.names, np.inf) if sigmas else {}
        for name, sigma in sigmas.items():
            if name not in self.names or not sigma > 0.0:
                raise MeasurementError(
                    f"unknown of lens {self.name!r}: {name}: {sigma}; expected standard deviations "
                    f"above 0 of some of {', '.join(self.names)}"
                )
        keep("sigmas", dict(sigmas))

    def _coefficients(self) -> tuple[float, ...]:
        """Return the coefficients of distortion, zero if they are unknown."""
        counts = _COUNTS[self.fisheye]
        if self.distortion is None:
            return (0.0,) * (4 if self.fisheye else 5) if self.unknown else ()
        if len(self.distortion) not in counts:
            raise MeasurementError(
                f"lens {self.name!r} has {len(self.distortion)} coefficients of distortion; "
                f"expected {' or '.join(map(str, counts))}, in OpenCV's order "
                f"{', '.join(FISHEYE if self.fisheye else PLANE)}"
            )
        return self.distortion

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all numbers of the lens, known or not."""
        coefficients = FISHEYE if self.fisheye else PLANE
        return ("fx", "fy", "cx", "cy", *coefficients[: len(self.distortion or ())])

    @property
    def values(self) -> Array:
        """Nominal values of all numbers of the lens, shape (n,)."""
        parts = (self.focal, self.centre, self.distortion)
        return np.concatenate([np.array(part, dtype=np.float64) for part in parts])

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Numbers of the lens that are to be identified."""
        return tuple(
            Parameter(self.name, name, "px" if name[0] in "fc" else "1", value)
            for name, value in zip(self.names, self.values.tolist(), strict=True)
            if name in self.sigmas
        )

    def project(self, points: Array, values: Array | None = None) -> tuple[Array, Array, Array]:
        """Return pixels of points, (…, 2), and derivatives by points and by the lens's numbers.

        Points behind a pinhole are NaN. Derivatives: (…, 2, 3), [px/m], and (…, 2, n).

        Args:
            points: Points in the camera's axes, shape (…, 3), [m].
            values: Values of all numbers of the lens, shape (n,); by default nominal.
        """
        values = self.values if values is None else values
        points = np.asarray(points, dtype=float)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            plane, by_point, by_lens = (self._by_angle if self.fisheye else self._on_plane)(
                points, values[4:]
            )
        f = values[:2]
        by_values = np.zeros((*plane.shape, len(values)))
        by_values[..., 0, 0], by_values[..., 1, 1] = plane[..., 0], plane[..., 1]
        by_values[..., 0, 2] = by_values[..., 1, 3] = 1.0
        by_values[..., 4:] = f[:, None] * by_lens
        return f * plane + values[2:4], f[:, None] * by_point, by_values

    def _on_plane(self, points: Array, k: Array) -> tuple[Array, Array, Array]:
        """Return the pinhole projection of points at focal length 1: see ``project``."""
        depth = np.where(points[..., 2] > 0.0, points[..., 2], np.nan)
        x, y = (points[..., :2] / depth[..., None]).T
        a1, a2, p1, p2, a3, b1, b2, b3 = np.append(k, np.zeros(8 - len(k))).tolist()
        s = x * x + y * y
        top, bottom = 1 + s * (a1 + s * (a2 + s * a3)), 1 + s * (b1 + s * (b2 + s * b3))
        radial = top / bottom
        slope = (a1 + s * (2 * a2 + 3 * s * a3)) - radial * (b1 + s * (2 * b2 + 3 * s * b3))
        slope /= bottom
        u = x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x)
        v = y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y
        across = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        u_x = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        v_y = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        z = depth.T
        by_point = np.array(
            [
                [u_x / z, across / z, -(u_x * x + across * y) / z],
                [across / z, v_y / z, -(across * x + v_y * y) / z],
            ]
        )
        upper, lower = (np.array((s, s * s, s**3)) * c for c in (1 / bottom, -radial / bottom))
        columns = [(x * c, y * c) for c in upper[:2]]
        columns += [(2 * x * y, s + 2 * y * y), (s + 2 * x * x, 2 * x * y)]
        columns += [(x * c, y * c) for c in (upper[2], *lower)]
        by_lens = np.array(columns[: len(k)]).reshape(len(k), 2, *x.shape).swapaxes(0, 1)
        return np.array((u, v)).T, _last(by_point), _last(by_lens)

    def _by_angle(self, points: Array, k: Array) -> tuple[Array, Array, Array]:
        """Return the fisheye projection of points at focal length 1: see ``project``."""
        x, y, z = points.T
        rho = np.hypot(x, y)
        square, angle = rho * rho + z * z, np.arctan2(rho, z)
        a = np.append(k, np.zeros(4 - len(k)))
        t = angle * angle
        bent = angle * (1 + t * (a[0] + t * (a[1] + t * (a[2] + t * a[3]))))
        slope = 1 + t * (3 * a[0] + t * (5 * a[1] + t * (7 * a[2] + 9 * t * a[3])))
        on_axis = rho == 0.0
        safe = np.where(on_axis, 1.0, rho)
        g = np.where(on_axis, 1.0 / z, bent / safe)
        h = np.where(on_axis, 0.0, (slope * z / square - g) / safe**2)
        down = -slope / square
        by_point = np.array(
            [[g + x * x * h, x * y * h, x * down], [x * y * h, g + y * y * h, y * down]]
        )
        powers = np.array([angle ** (2 * i + 3) for i in range(len(k))]).reshape(len(k), *x.shape)
        powers = np.where(on_axis, 0.0, powers / safe)
        return (
            np.array((x * g, y * g)).T,
            _last(by_point),
            _last(np.array((x * powers, y * powers))),
        )

    def rays(self, pixels: Array) -> Array:
        """Return the unit vectors of rays from the camera through pixels, (…, 2) to (…, 3).

        Newton's method inverts the nominal lens; pixels that no ray has give NaN. The projection
        does not change along the ray, J ray = 0, so that a step is Jᵀ (J Jᵀ)⁻¹ missed.
        """
        f, centre, k = np.split(self.values, [2, 4])
        distorted = (np.asarray(pixels, dtype=float) - centre) / f
        around = np.linalg.norm(distorted, axis=-1, keepdims=True)
        angle = np.minimum(around, np.pi) if self.fisheye else np.arctan(around)
        across = distorted / np.where(around > 0.0, around, 1.0)
        ray = np.concatenate((across * np.sin(angle), np.cos(angle)), axis=-1)
        formed = self._by_angle if self.fisheye else self._on_plane
        for _ in range(_NEWTON):
            plane, J, _ = formed(ray, k)
            missed = plane - distorted
            step = (J.mT @ np.linalg.solve(J @ J.mT, missed[..., None]))[..., 0]
            ray = ray - np.clip(np.nan_to_num(step), -1.0, 1.0)
            ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
            if not np.nanmax(np.abs(step), initial=0.0) > _NEAR:
                break
        ray[~(np.abs(missed).max(axis=-1) < 1e-6)] = np.nan
        return ray

    def sees(self, points: Array, values: Array | None = None) -> Mask:
        """Return the mask of points that are in the image and sharp, (…, 3) to (…)."""
        pixels, by_point, _ = self.project(points, values)
        far = np.linalg.norm(points, axis=-1)
        near, farthest = self.focus or (0.0, np.inf)
        with np.errstate(invalid="ignore"):
            inside = ((pixels >= -0.5) & (pixels <= np.array(self.size) - 0.5)).all(axis=-1)
            # where distortion folds the image, the determinant of the derivative is negative
            upright = np.linalg.det(by_point[..., :2]) > 0.0
        return np.asarray(inside & (upright | self.fisheye) & (far >= near) & (far <= farthest))


def _last(array: Array) -> Array:
    """Return an array (2, k, …) with its first two axes last: (…, 2, k)."""
    return np.moveaxis(array.transpose(0, 1, *range(array.ndim - 1, 1, -1)), (0, 1), (-2, -1))
