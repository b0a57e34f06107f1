"""A camera: pixels of points that a platform carries past it, or that it is carried past.

A point P of the markers is at X = R_b s P + t_b in the frame of what holds them. In the axes of a
camera at (R, t) in the frame of what holds that, it is at

        Rᵀ (T X − t),       T = T_frame_platform, or its inverse if the platform holds the camera,

and its lens makes pixels of that. Camera, lens and markers may each be known, or not, or roughly.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from pincal.errors import MeasurementError
from pincal.instruments.lens import Lens
from pincal.instruments.placing import board_in_camera, by_hand_eye, placed_by_rays
from pincal.model import Parameter
from pincal.model.checks import array_of, check_kinds, check_sizes, named_points, set_point
from pincal.model.relations import Residuals
from pincal.types import Array, Mask, Point

_PLACE = (("x", "m"), ("y", "m"), ("z", "m"), ("rx", "rad"), ("ry", "rad"), ("rz", "rad"))
_AXES = "xyz"
_FEWEST = 3  # photos from which hand–eye calibration finds anything
_STEEPEST = np.cos(np.radians(75.0))  # angle from the normal at which markers are still read
SMALLEST_WINDOW = 3  # half the side of what a corner is found by [px]


def windows(clear: float, slopes: Array) -> Array:
    """Return half the sides of the windows around points that show nothing else, (…,), [px].

    ``clear`` is the radius on the board in which nothing else is printed, [m]; ``slopes`` are the
    derivatives of pixels by x and y of the board at the points, shape (…, 2, 2), [px/m].
    """
    return np.asarray(0.9 * clear * np.linalg.svd(slopes, compute_uv=False)[..., 1] - 0.5)


@dataclass(frozen=True)
class Markers:
    """Points that cameras see, as on a board or a tool, in a frame of their own.

    Example:
        >>> import pincal
        >>> board = pincal.Markers({"a": (0, 0, 0), "b": (0.1, 0, 0), "c": (0, 0.1, 0)}, scale=1e-3)
        >>> [parameter.id for parameter in board.parameters][5:]
        ['board.rz', 'board.scale']
    """

    points: Mapping[str, Point | None]
    """Where they are in the frame of the markers, [m], by name; None: to be identified."""
    name: str = "board"
    """The owner of what is unknown of them. Cameras share markers by this name."""
    at: Point = (0.0, 0.0, 0.0)
    """Where the frame of the markers is on the platform, or in the frame of the measurements if the
    platform holds the camera, [m]; where the search may begin if that is unknown."""
    rotation: Point = (0.0, 0.0, 0.0)
    """How that frame is turned there: a rotation vector, [rad]."""
    known: bool = False
    """Whether place and rotation are known. They are no unknowns if all points are."""
    tolerance: float = 0.0
    """Standard deviation of each coordinate of a known point, [m]."""
    scale: float = 0.0
    """Standard deviation of all lengths between points together, relative: of a print's pitch."""
    stretch: float = 0.0
    """Standard deviation of lengths along y over those along x: printers feed paper unevenly."""
    normal: Point | None = None
    """Direction from which they can be read, in their frame; any if not said."""
    clear: float = 0.0
    """Radius around a point, in x and y, in which nothing else is printed, [m]: points of which an
    image shows less than some pixels cannot be read. Any size can if it is 0."""

    def __post_init__(self) -> None:
        error, label = MeasurementError, f"markers {self.name!r}"
        object.__setattr__(self, "points", named_points(self.points, label, error))
        for name in ("at", "rotation", *["normal"] * (self.normal is not None)):
            set_point(self, name, f"{name} of {label}", error)
        check_sizes(self, ("tolerance", "scale", "stretch", "clear"), f"{label}'s", error)

    @cached_property
    def priors(self) -> dict[str, float]:
        """Of each number of the markers that is unknown its standard deviation, infinite if so."""
        unplaced = not self.known and any(point is not None for point in self.points.values())
        sigmas = dict.fromkeys((name for name, _ in _PLACE), np.inf) if unplaced else {}
        sigmas |= {n: s for n in ("scale", "stretch") if (s := getattr(self, n))}
        for name, point in self.points.items():
            sigma = np.inf if point is None else self.tolerance
            if sigma:
                sigmas |= dict.fromkeys((f"{name}_{axis}" for axis in _AXES), sigma)
        return sigmas

    @cached_property
    def values(self) -> dict[str, float]:
        """Nominal values of all numbers of the markers; points that are unknown at zero."""
        points = [point or (0.0, 0.0, 0.0) for point in self.points.values()]
        numbers = [*self.at, *self.rotation, 1.0, 1.0, *np.ravel(points)]
        of_points = (f"{name}_{axis}" for name in self.points for axis in _AXES)
        names = [*(name for name, _ in _PLACE), "scale", "stretch", *of_points]
        return dict(zip(names, map(float, numbers), strict=True))

    @property
    def lengths_known(self) -> bool:
        """Whether known points are farther apart than each of them is uncertain."""
        points = [point for point in self.points.values() if point is not None]
        return len(points) > 1 and np.ptp(points, axis=0).max() > self.tolerance

    def placed_at(self, places: Array) -> dict[str, float]:
        """Return the numbers of the markers' frame and points by id, from places of the points.

        The places are in the frame of what holds the markers, shape (M, 3), [m]; NaN if unknown.
        """
        listed = np.array([point is not None for point in self.points.values()])
        points = np.reshape([point or (0.0, 0.0, 0.0) for point in self.points.values()], (-1, 3))
        usable = listed & np.isfinite(places).all(axis=1)
        place = np.array([*self.at, *self.rotation])
        if "x" in self.priors and usable.sum() >= 3:
            middles = places[usable].mean(axis=0), points[usable].mean(axis=0)
            arms = places[usable] - middles[0], points[usable] - middles[1]
            turn, _ = Rotation.align_vectors(*arms)
            place = np.concatenate((middles[0] - turn.apply(middles[1]), turn.as_rotvec()))
        numbers, frame = _numbers_of(self.name, place), _matrix(place)
        inside = (places - frame[:3, 3]) @ frame[:3, :3]
        for name, point, is_listed in zip(self.points, inside, listed, strict=True):
            if not is_listed and np.isfinite(point).all():
                ids = (f"{self.name}.{name}_{axis}" for axis in _AXES)
                numbers |= dict(zip(ids, point.tolist(), strict=True))
        return numbers

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is unknown of them."""
        units = {**dict(_PLACE), "scale": "1", "stretch": "1"}
        return tuple(
            Parameter(self.name, name, units.get(name, "m"), self.values[name])
            for name in self.priors
        )


@dataclass(frozen=True)
class Camera:
    """An instrument that measures where points are in its image.

    Its columns are ``front_P1_u [px]`` and ``front_P1_v [px]`` of camera ``front`` and point P1,
    which tables of corners fill (``Setup.corners``).

    Example:
        >>> import pincal
        >>> board = pincal.Markers({"a": (0.0, 0.0, 0.0), "b": (0.1, 0.0, 0.0)})
        >>> lens = pincal.Lens((1600, 1200), focal=1500.0)
        >>> front = pincal.Camera("front", lens, board, at=(0, -2, 1), towards=(0, 0, 0.5))
        >>> list(front.columns)
        ['front_a_u', 'front_a_v', 'front_b_u', 'front_b_v']
    """

    name: str
    lens: Lens
    markers: Markers
    on_platform: bool = False
    """Whether the platform holds the camera, and markers are in the room; else the reverse."""
    at: Point | None = None
    """Where it is in the frame of the measurements, or in that of the platform if this holds it,
    [m]; found from the nominal machine if not said."""
    towards: Point | None = None
    """A point on its axis, the image's lower side being down (−z) there; or give a rotation."""
    rotation: Point | None = None
    """How its axes (right, down, ahead) are turned there: a rotation vector, [rad]."""
    known: bool = False
    """Whether place and rotation are known."""
    columns: dict[str, str] = field(init=False, repr=False, compare=False)
    """Its columns in the measurements, and their unit."""
    parameters: tuple[Parameter, ...] = field(init=False, repr=False, compare=False)
    """Its unknowns: its place, then those of lens and markers."""

    def __post_init__(self) -> None:
        error = MeasurementError
        check_kinds(vars(self), Camera, error)
        if self.towards is not None and self.rotation is None and self.at is not None:
            object.__setattr__(self, "rotation", _looking(self.at, self.towards))
        if self.known and (self.at is None or self.rotation is None):
            raise MeasurementError(
                f"camera {self.name!r}: its place is known, and not said; give 'at', and 'towards' "
                "or 'rotation'"
            )
        place = [*(self.at or (0.0,) * 3), *(self.rotation or (0.0,) * 3)]
        array_of(place, (6,), f"place of camera {self.name!r}", error)
        numbers = zip(_PLACE, place, strict=True)
        placed = [Parameter(self.name, n, unit, float(v)) for (n, unit), v in numbers]
        unknown = (*placed * (not self.known), *self.lens.parameters, *self.markers.parameters)
        object.__setattr__(self, "parameters", unknown)
        columns = dict.fromkeys((column for pair in self.marks.values() for column in pair), "px")
        object.__setattr__(self, "columns", columns)

    @property
    def shared(self) -> tuple[str, ...]:
        """Owners of parameters that other cameras may share."""
        return self.lens.name, self.markers.name

    @property
    def priors(self) -> dict[str, float]:
        """Standard deviations of nominal values by id, of what is known roughly."""
        owners = {self.lens.name: self.lens.sigmas, self.markers.name: self.markers.priors}
        every = ((f"{o}.{n}", s) for o, sigmas in owners.items() for n, s in sigmas.items())
        return {id_: sigma for id_, sigma in every if np.isfinite(sigma)}

    @property
    def unplaced(self) -> bool:
        """Whether neither its place nor that of the markers is known."""
        return not self.known and ("x" in self.markers.priors or not self.markers.lengths_known)

    @property
    def marks(self) -> dict[str, tuple[str, str]]:
        """Columns of right and down by the name of the point."""
        return {p: (f"{self.name}_{p}_u", f"{self.name}_{p}_v") for p in self.markers.points}

    @cached_property
    def _numbers(self) -> tuple[Array, Array]:
        """All numbers of place, lens and markers, and the indices of the parameters in them."""
        place = [*(self.at or (0.0,) * 3), *(self.rotation or (0.0,) * 3)]
        markers = self.markers.values
        every = np.array([*place, *self.lens.values, *markers.values()])
        names = [f"{self.name}.{name}" for name, _ in _PLACE]
        names += [f"{self.lens.name}.{name}" for name in self.lens.names]
        names += [f"{self.markers.name}.{name}" for name in markers]
        return every, np.array([names.index(p.id) for p in self.parameters], dtype=int)

    def _parts(self, values: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return the camera's place, the lens, and the markers' place, scales (3,) and points."""
        every, places = self._numbers
        numbers = every.copy()
        numbers[places] = values
        place, lens, markers = np.split(numbers, [6, 6 + len(self.lens.values)])
        scales = markers[6] * np.array([1.0, markers[7], 1.0])
        return place, lens, markers[:6], scales, markers[8:].reshape(-1, 3)

    def stand(self, values: Array) -> Array | None:
        """Return T_frame_camera, shape (4, 4); none if the platform holds it."""
        return None if self.on_platform else _matrix(self._parts(values)[0])

    def _carried(self, poses: Array, values: Array) -> tuple[Array, Array, Array]:
        """Return T, (N, 4, 4), markers X in their holder's frame, (M, 3), and T X, (N, M, 3)."""
        _, _, on_holder, scales, points = self._parts(values)
        T: Array = np.linalg.inv(poses) if self.on_platform else poses  # type: ignore[assignment]
        X = (scales * points) @ _matrix(on_holder)[:3, :3].T + on_holder[:3]
        return T, X, X @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]

    def evaluate(self, poses: Array, values: Array, measured: Array) -> Residuals:
        """Return predicted less measured pixels, with derivatives: see ``Instrument``.

        NaN where a point is behind a pinhole.
        """
        place, lens, on_holder, scales, points = self._parts(values)
        T, X, moved = self._carried(poses, values)
        (N, M), turned, turn = moved.shape[:2], X - on_holder[:3], _matrix(on_holder)[:3, :3]
        R, ray = _matrix(place)[:3, :3], moved - place[:3]
        pixels, by_seen, by_lens = self.lens.project(ray @ R, lens)
        by_moved = by_seen @ R.T  # by T X, (N, M, 2, 3)
        by_X = by_moved @ T[:, None, :3, :3]
        if self.on_platform:  # the room moves past it, the other way round
            arms, by_shift = X - poses[:, None, :3, 3], -by_X
        else:
            arms, by_shift = moved - poses[:, None, :3, 3], by_moved
        by_twist = np.concatenate((by_shift, np.cross(arms[:, :, None], by_shift)), axis=3)
        every, places = self._numbers
        by_every = np.zeros((N, M, 2, len(every)))
        by_every[..., :3] = -by_moved
        by_every[..., 3:6] = -np.cross(ray[:, :, None], by_moved) @ _jacobian(place[3:])
        by_markers = by_every[..., 6 + len(lens) :]  # a view
        by_every[..., 6 : 6 + len(lens)] = by_lens
        by_markers[..., :3] = by_X
        by_markers[..., 3:6] = np.cross(turned[:, None], by_X) @ _jacobian(on_holder[3:])
        by_markers[..., 6] = (by_X * turned[:, None]).sum(axis=3) / scales[0]
        by_points = by_X @ turn * scales
        by_markers[..., 7] = by_points[..., 1] * (points[:, 1] * scales[0] / scales[1])[:, None]
        if (places >= 6 + len(lens) + 8).any():
            for m in range(M):
                by_markers[:, m, :, 8 + 3 * m : 11 + 3 * m] = by_points[:, m]
        rows = (N, 2 * M)
        by_parameters = by_every[..., places].reshape(*rows, len(places))
        return pixels.reshape(rows) - measured, by_twist.reshape(*rows, 6), by_parameters

    def metres_per_pixel(self, poses: Array, values: Array) -> Array:
        """Return the size of a pixel across the line of sight at the points, (N, r), [m/px]."""
        place, lens, *_ = self._parts(values)
        ray = self._carried(poses, values)[2] - place[:3]
        by_seen = self.lens.project(ray @ _matrix(place)[:3, :3], lens)[1]
        areas = np.linalg.det(by_seen @ by_seen.swapaxes(2, 3))  # squared, [px⁴/m⁴]
        return np.repeat(areas**-0.25, 2, axis=1)

    def visible(self, poses: Array, values: Array) -> Mask:
        """Return which columns the camera could measure at poses, shape (N, r).

        Of points in its image, in focus, large enough, seen from the side on which they are
        printed.

        Raises:
            MeasurementError: nobody said where it is.
        """
        if self.rotation is None or self.at is None:
            raise MeasurementError(
                f"what camera {self.name!r} would see depends on where it is; say that roughly: "
                "'at', and 'towards' or 'rotation'"
            )
        place, lens, on_holder, *_ = self._parts(values)
        T, _, moved = self._carried(poses, values)
        R = _matrix(place)[:3, :3]
        seen = (moved - place[:3]) @ R
        visible = self.lens.sees(seen, lens) & (self.facing(poses, values) > _STEEPEST)
        if self.markers.clear:
            axes = R.T @ T[:, None, :3, :3] @ _matrix(on_holder)[:3, :2]
            slopes = np.nan_to_num(self.lens.project(seen, lens)[1] @ axes)
            visible &= windows(self.markers.clear, slopes) >= SMALLEST_WINDOW
        return np.repeat(visible, 2, axis=1)

    def facing(self, poses: Array, values: Array) -> Array:
        """Return cosines between lines of sight and the normal, (N, M); negative from behind."""
        place, _, on_holder, *_ = self._parts(values)
        T, _, moved = self._carried(poses, values)
        if self.markers.normal is None:
            return np.ones(moved.shape[:2])
        ray, normals = moved - place[:3], T[:, :3, :3] @ _matrix(on_holder)[:3, :3]
        normals = normals @ (np.array(self.markers.normal) / np.linalg.norm(self.markers.normal))
        return np.asarray(-(ray * normals[:, None]).sum(axis=2) / np.linalg.norm(ray, axis=2))

    def by_hand_eye(self, poses: Array, measured: Array) -> tuple[Array, Array] | None:
        """Return the misses of hand–eye calibration in photos that it has not seen, (N, r).

        They are in pixels and, across the line of sight, in metres; every second photo is predicted
        by the others. The result is None for too few photos of known points. Poses of the nominal
        machine are T_frame_platform, (N, 4, 4); measured pixels are NaN where not seen.

        Raises:
            ModuleNotFoundError: OpenCV is not installed.
        """
        free = replace(self, known=False, markers=replace(self.markers, known=False))
        listed = [point is not None for point in self.markers.points.values()]
        points = np.array([point for point in self.markers.points.values() if point is not None])
        rays = self.lens.rays(measured.reshape(len(poses), -1, 2))[:, listed]
        boards = [board_in_camera(points, of_photo) for of_photo in rays]
        rows = np.array([row for row, board in enumerate(boards) if board is not None])
        begun = {parameter.id: parameter.nominal for parameter in free.parameters}
        T = free._carried(poses, np.array([*begun.values()]))[0]
        missed = np.full((2, *measured.shape), np.nan)
        for half, unseen in ((rows[::2], rows[1::2]), (rows[1::2], rows[::2])):
            if len(half) < _FEWEST:
                return None
            ends = by_hand_eye(T[half], np.array([boards[i] for i in half]))
            for owner, end in zip((self.name, self.markers.name), ends, strict=True):
                turn = Rotation.from_matrix(end[:3, :3]).as_rotvec()
                begun |= _numbers_of(owner, np.concatenate((end[:3, 3], turn)))
            values = np.array([begun[parameter.id] for parameter in free.parameters])
            missed[0, unseen] = free.evaluate(poses[unseen], values, measured[unseen])[0]
            missed[1, unseen] = missed[0, unseen] * free.metres_per_pixel(poses[unseen], values)
        return missed[0], missed[1]

    def begin(self, poses: Array, measured: Array, known: Mapping[str, float]) -> Array:
        """Return values of its parameters from which a search begins, (p,): see ``Instrument``."""
        values = np.array([known.get(p.id, p.nominal) for p in self.parameters])
        if self.known:
            return values
        board, ids = self.markers, [parameter.id for parameter in self.parameters]
        T, X, _ = self._carried(poses, values)
        rays = self.lens.rays(measured.reshape(len(poses), -1, 2))
        unknown = {f"{board.name}.{name}" for name in {*board.priors} - {"scale", "stretch"}}
        begun = placed_by_rays(T, rays, None if unknown - {*known} else X)
        if begun is None:
            return values
        changes = _numbers_of(self.name, begun[0])
        if unknown - {*known}:
            changes |= board.placed_at(begun[1])
        return np.array([changes.get(id_, value) for id_, value in zip(ids, values, strict=True)])


def _numbers_of(name: str, place: Array) -> dict[str, float]:
    """Return the numbers of a position and a rotation vector, shape (6,), by id."""
    ids = (f"{name}.{axis}" for axis, _ in _PLACE)
    return dict(zip(ids, place.tolist(), strict=True))


def _matrix(place: Array) -> Array:
    """Return the transform of a position and a rotation vector, shapes (6,) and (4, 4)."""
    rotation = Rotation.from_rotvec(place[3:])
    return RigidTransform.from_components(place[:3], rotation).as_matrix()


def _jacobian(vector: Array) -> Array:
    """Return the turn of a change of a rotation vector, shape (3, 3): its left Jacobian."""
    angle, S = np.linalg.norm(vector), np.cross(vector, np.eye(3)).T
    sine, half = np.sinc(angle / np.pi), np.sinc(angle / (2.0 * np.pi))
    along = (1.0 - sine) / angle**2 if angle > 1e-4 else 1.0 / 6.0
    return np.asarray(sine * np.eye(3) + 0.5 * half**2 * S + along * np.outer(vector, vector))


def _looking(position: Point, towards: Point) -> Point:
    """Return the rotation vector of an upright camera that looks from one point to another."""
    ahead = np.subtract(towards, position) / np.linalg.norm(np.subtract(towards, position))
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    if np.linalg.norm(right) < 1e-6:  # straight up or down: y is up in the image
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    axes = np.column_stack((right, np.cross(ahead, right), ahead))
    x, y, z = Rotation.from_matrix(axes).as_rotvec().tolist()
    return x, y, z
