"""Points of boards in photos, with standard deviations, and the reasons of points left out.

Markers, or the corners of a chessboard, locate a board roughly: a homography from the nearest of
them predicts each point. There the model of a corner with straight, blurred edges is fitted by
least squares to the grey values of a window at pixels p,

        I(p) = a + b (E₁ E₂ + 4 s)  of a saddle,  a + b ((1 + E₁)(1 + E₂) / 4 + s)  of a marker,
        Eᵢ = erf(dᵢ / √2),    dᵢ = nᵢᵀ(p − c) / w,    s = ρ φ(d₁) φ(d₂) (1 + ρ d₁ d₂ / 2 + …),

with unknown place c, normals nᵢ of the edges, blur w, and grey values a and b; s is the tetrachoric
series of a blurred corner that is not square, ρ = n₁ᵀn₂ (K. Pearson 1900). The standard deviation
of c is the residual variance times (JᵀJ)⁻¹, enlarged where residuals of neighbouring pixels are
correlated, as in sharpened and compressed photos.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture
from scipy.special import erf

from pincal.errors import MeasurementError
from pincal.files.text import check_name, read_bytes
from pincal.instruments.board import CHEQUERED, Board, cv2, marker_dictionary
from pincal.instruments.camera import SMALLEST_WINDOW, windows
from pincal.model.checks import listed
from pincal.types import Array

Picture8: TypeAlias = NDArray[np.uint8]
_EXPOSURE, _TAKEN, _FRACTION, _CHANGED = 0x8769, 0x9003, 0x9291, 0x0132  # EXIF
_LARGEST = 2**28  # bytes of a photo's file
_LARGEST_WINDOW = 10  # half the side of a window [px]
_NEAREST = 16  # corners of markers that predict a point
_STEPS = 25  # largest number of Levenberg-Marquardt steps
_SIDE = 480  # side of a small picture [px]
#: Limits of good corners: misfit of grey values over the contrast, contrast over the range of grey
#: values, standard deviation [px], blur over half the window.
_MISFIT, _CONTRAST, _SIGMA, _BLUR = 0.12, 0.04, 0.3, 0.5
_MODEL = 0.002  # error of the model without noise [px]: pixels are squares, lenses bend edges
_BLURRED = 2.0  # blur over the median blur, above which a photo is left out
_SHARP = 1.5  # blur with which no photo is left out [px]


@dataclass
class PhotoPoints:
    """Points of boards that one photo shows."""

    name: str
    size: tuple[int, int]
    """Width and height, [px]."""
    points: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """u, v and their standard deviation by the name of the point, [px]; the middles of pixels have
    whole numbers."""
    omitted: dict[str, tuple[float, float, str]] = field(default_factory=dict)
    """u, v and the reason of points that are left out."""
    reason: str = ""
    """Reason why no point of the photo is used; empty if points are used."""
    blur: float = 0.0
    """Median standard deviation of the blur, [px]."""
    taken: datetime | None = None
    small: Array = field(default_factory=lambda: np.empty((0, 0)))
    """Small picture for the contact sheet, grey values."""


def read_photo(path: Path) -> tuple[Array, datetime | None]:
    """Return grey values of a photo, black 0 and white 1, (height, width), and when it was taken.

    The picture is as on the sensor: a turn that the file asks viewers to make (EXIF) is not made,
    so that a lens is the same in all photos.

    Raises:
        FileError: the file is missing or too large, or its name is not UTF-8.
        MeasurementError: it is no picture.
    """
    marker_dictionary("4X4_50")  # raises an error without OpenCV
    check_name(path.name)
    data = np.frombuffer(read_bytes(path, _LARGEST, MeasurementError), np.uint8)
    try:  # OpenCV would print its libraries' messages on a damaged file
        with Picture.open(path) as file:
            file.verify()
    except (OSError, ValueError, SyntaxError):
        data = data[:0]
    kind = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    picture = cv2.imdecode(data, kind) if len(data) else None
    if picture is None:
        raise MeasurementError(
            f"{path} is no picture that can be read; give JPEG, PNG or TIFF files (raw files of "
            "cameras are to be converted)"
        )
    taken = None
    with suppress(OSError, ValueError, SyntaxError), Picture.open(path) as file:
        tags = file.getexif()
        exposure = tags.get_ifd(_EXPOSURE)
        fraction = str(exposure.get(_FRACTION, "")).strip() or "0"
        text = f"{exposure.get(_TAKEN, tags.get(_CHANGED, ''))}.{fraction}"
        taken = datetime.strptime(text, "%Y:%m:%d %H:%M:%S.%f")
    white = 255 if picture.dtype == np.uint8 else max(int(picture.max()), 4095)
    return picture / np.float64(white), taken


def points_in(boards: Sequence[Board], paths: Iterable[Path]) -> Iterator[PhotoPoints]:
    """Yield the points of boards in photos, photo by photo; then ``checked`` compares photos."""
    numbers = [number for board in boards for number in board.markers]
    if shared := sorted({n for n in numbers if numbers.count(n) > 1}):
        raise MeasurementError(
            f"boards {listed(board.name for board in boards)} share markers "
            f"({listed(map(str, shared))}); print one again, by 'pincal board --first "
            f"{max(numbers) + 1}'"
        )
    if len(boards) > 1 and any(board.kind == "chessboard" for board in boards):
        raise MeasurementError("chessboards look all alike; several boards need markers")
    for path in paths:
        grey, taken = read_photo(path)
        height, width = grey.shape
        result = PhotoPoints(path.name, (width, height), taken=taken)
        blurs: list[float] = []
        reasons = [_see(board, grey, result, blurs) for board in boards]
        if not result.points:
            result.reason = next(filter(None, reasons), "every corner is doubtful")
        result.blur = float(np.median(blurs)) if blurs else 0.0
        ratio = min(1.0, _SIDE / max(width, height))
        small = cv2.resize(grey, None, fx=ratio, fy=ratio, interpolation=cv2.INTER_AREA)
        result.small = np.asarray(small, dtype=float)
        yield result


def checked(photos: Sequence[PhotoPoints]) -> None:
    """Leave out photos that are blurred, or turned, compared with most others, and copies."""
    blurs = [photo.blur for photo in photos if photo.points]
    sizes = [photo.size for photo in photos]
    usual = max(sizes, key=sizes.count) if sizes else (0, 0)
    names: dict[bytes, str] = {}
    for photo in photos:
        original = names.setdefault(photo.small.tobytes(), photo.name)
        if original != photo.name:
            photo.reason = f"the same picture as {original}"
        elif photo.size != usual:
            turned = ": some program has turned it" * (photo.size == usual[::-1])
            photo.reason = "{}x{} pixels, the others {}x{}".format(*photo.size, *usual) + turned
        elif photo.points and photo.blur > max(_SHARP, _BLURRED * float(np.median(blurs))):
            photo.reason = f"blurred over {photo.blur:.1f} px, usual are {np.median(blurs):.1f} px"
        if photo.reason:
            photo.omitted |= {n: (u, v, photo.reason) for n, (u, v, _) in photo.points.items()}
            photo.points = {}


def _see(board: Board, grey: Array, result: PhotoPoints, blurs: list[float]) -> str:
    """Add the points of a board in a photo to the result; return the reason if there are none."""
    picture = np.clip(grey * 255.0, 0, 255).astype(np.uint8)
    anchors = _chessboard(board, picture) if not board.markers else _markers(board, picture)
    if isinstance(anchors, str):
        return anchors
    on_board, in_image = anchors
    names, places = list(board.points), np.array(list(board.points.values()))[:, :2] / board.scale
    if board.kind not in CHEQUERED:  # only corners of markers that were found
        near = np.abs(places[:, None] - on_board).max(axis=2).min(axis=1) < 1e-9
        names, places = [n for n, ok in zip(names, near, strict=True) if ok], places[near]
    count = 4 if board.kind == "markers" else _NEAREST
    starts, directions = _predicted(places, on_board, in_image, min(count, len(on_board)))
    half = np.minimum(windows(board.clear, directions), _LARGEST_WINDOW)
    signs = np.ones((len(names), 2))
    if board.kind not in CHEQUERED:
        by_letter = {"a": (1, -1), "b": (-1, -1), "c": (-1, 1), "d": (1, 1)}
        signs = np.array([by_letter[name[-1]] for name in names])
    limits = np.array(result.size) - 1.0
    inside = ((starts >= half[:, None]) & (starts <= limits - half[:, None])).all(axis=1)
    large = half >= SMALLEST_WINDOW
    for i in np.flatnonzero(inside & ~large):
        result.omitted[names[i]] = (float(starts[i, 0]), float(starts[i, 1]), "too small")
    rows = np.flatnonzero(inside & large)
    if not len(rows):
        return "squares too small in the photo" if inside.any() else "no corner inside the photo"
    corners = _Corners(grey, starts[rows], directions[rows], half[rows], signs[rows])
    saddle = board.kind in CHEQUERED
    for row, u, v, sigma, blur, reason in corners.fitted(saddle=saddle):
        if reason:
            result.omitted[names[rows[row]]] = (u, v, reason)
        else:
            result.points[names[rows[row]]] = (u, v, sigma)
            blurs.append(blur)
    return ""


def _markers(board: Board, picture: Picture8) -> tuple[Array, Array] | str:
    """Return places on the board, and pixels, of corners of markers that lie as on the board."""
    corners, numbers = _detected(board.dictionary, picture)
    known = [i for i, number in enumerate(numbers) if number in board.markers]
    on_board = np.array([board.markers[numbers[i]] for i in known]).reshape(-1, 4, 2)
    in_image = np.array([corners[i] for i in known]).reshape(-1, 4, 2)
    lying = np.ones(len(known), dtype=np.bool_)
    if known and board.kind != "markers":
        sides = np.linalg.norm(np.diff(in_image, axis=1), axis=2)
        far = max(3.0, 0.4 * float(np.median(sides)) * board.square / board.marker)
        flat = (on_board.reshape(-1, 2), in_image.reshape(-1, 2))
        _, agree = cv2.findHomography(*flat, cv2.RANSAC, far)
        lying = np.asarray(agree, dtype=np.bool_).reshape(-1, 4).min(axis=1)
    if lying.sum() < max(1, 0.6 * len(known)):
        return _why_nothing(board, picture, numbers)
    return on_board[lying].reshape(-1, 2), in_image[lying].reshape(-1, 2)


def _detected(dictionary: str, picture: Picture8) -> tuple[list[Array], list[int]]:
    """Return the corners, (4, 2) each, and numbers of a dictionary's markers in a picture."""
    settings = cv2.aruco.DetectorParameters()
    settings.minMarkerPerimeterRate = 0.015
    detector = cv2.aruco.ArucoDetector(marker_dictionary(dictionary), settings)
    corners, numbers, _ = detector.detectMarkers(picture)
    marker_numbers: list[int] = np.ravel([] if numbers is None else numbers).astype(int).tolist()
    return [np.asarray(corner[0], dtype=float) for corner in corners], marker_numbers


def _why_nothing(board: Board, picture: Picture8, numbers: Sequence[int]) -> str:
    """Return the reason why no marker of a board was found in a photo."""
    mirrored = _detected(board.dictionary, np.ascontiguousarray(picture[:, ::-1]))[1]
    if len(mirrored) > max(2, len(numbers)):
        return "markers are mirrored: print the board, or take the photo, the right way round"
    if strange := sorted(set(numbers) - set(board.markers)):
        shown = listed(map(str, strange))
        return f"markers {shown} are none of {board.name}: it is another board"
    if len(numbers) > 1:
        return f"markers do not lie as on {board.name}: it is another board, or it is bent"
    for name in ("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "APRILTAG_36h11"):
        if name != board.dictionary and len(_detected(name, picture)[1]) > 2:
            return f"the markers are of the dictionary {name}, {board.name} has {board.dictionary}"
    return "no marker is found: is the board in the photo, sharp and large enough?"


def _chessboard(board: Board, picture: Picture8) -> tuple[Array, Array] | str:
    """Return places and pixels of a chessboard's corners; its colours tell which way is up."""
    columns, rows = board.squares[0] - 1, board.squares[1] - 1
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE
    ok, corners = cv2.findChessboardCornersSB(picture, (columns, rows), flags=flags)
    if not ok:
        ok, corners = cv2.findChessboardCorners(picture, (columns, rows))
    if not ok:
        return f"no chessboard with {columns}x{rows} corners is found as a whole"
    grid = corners.reshape(rows, columns, 2).astype(float)
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0.0:  # count as in an image that is not mirrored
        grid = grid[::-1]
    places = np.array(list(board.points.values()))[:, :2] / board.scale
    middle = grid[:2, :2].mean(axis=(0, 1)), grid[:2, 1:3].mean(axis=(0, 1))
    (u0, v0), (u1, v1) = np.rint(middle).astype(int)
    if picture[v0, u0] > picture[v1, u1]:  # the upper left square is black
        grid = grid[::-1, ::-1]
    return places, grid.reshape(-1, 2)


def _predicted(places: Array, on_board: Array, in_image: Array, count: int) -> tuple[Array, Array]:
    """Return pixels of places on the board, (n, 2), and their derivatives, (n, 2, 2), [px/m].

    Each place has a homography of its own, from the nearest points with known pixels.
    """
    starts, slopes = np.empty((len(places), 2)), np.empty((len(places), 2, 2))
    for i, place in enumerate(places):
        nearest = np.argsort(((on_board - place) ** 2).sum(axis=1), kind="stable")[:count]
        local = on_board[nearest] - place
        size = np.abs(local).max()
        H, _ = cv2.findHomography(local / size, in_image[nearest])
        starts[i], slopes[i] = H[:2, 2], (H[:2, :2] - np.outer(H[:2, 2], H[2, :2])) / size
    return starts, slopes


class _Corners:
    """Windows of a photo around corners, and the fit of the corners: see the module."""

    def __init__(
        self, grey: Array, starts: Array, directions: Array, half: Array, signs: Array
    ) -> None:
        self.half, self.starts = half, starts
        reach = int(np.ceil(half.max())) + 1
        steps, middle = np.arange(-reach, reach + 1), np.rint(starts).astype(int)
        u = np.clip(middle[:, 0, None] + np.tile(steps, len(steps)), 0, grey.shape[1] - 1)
        v = np.clip(middle[:, 1, None] + np.repeat(steps, len(steps)), 0, grey.shape[0] - 1)
        self.side = len(steps)
        self.values, self.u, self.v = grey[v, u], u - starts[:, 0, None], v - starts[:, 1, None]
        self.weights = (np.hypot(self.u, self.v) <= half[:, None]).astype(float)
        along_x, along_y = directions[:, :, 0], directions[:, :, 1]
        flip = np.sign(np.linalg.det(directions))[:, None] * signs
        self.first = np.arctan2(-along_y[:, 0] * flip[:, 0], along_y[:, 1] * flip[:, 0])
        self.second = np.arctan2(along_x[:, 0] * flip[:, 1], -along_x[:, 1] * flip[:, 1])

    def _model(self, x: Array, saddle: bool) -> tuple[Array, Array]:
        """Return grey values, (n, m), and derivatives, (n, m, 7), by u, v, angles, ln w, a, b."""
        u, v, width = self.u - x[:, :1], self.v - x[:, 1:2], np.exp(x[:, 4:5])
        far, slopes = [], []
        for angle in (x[:, 2:3], x[:, 3:4]):
            c, s = np.cos(angle), np.sin(angle)
            far.append((c * u + s * v) / width)
            slopes.append((-c / width, -s / width, (c * v - s * u) / width, -far[-1]))
        b, rho = x[:, 6:7], np.cos(x[:, 2:3] - x[:, 3:4])
        first, second = (erf(distance / np.sqrt(2.0)) for distance in far)
        bells = [np.exp(-(distance**2) / 2) / np.sqrt(2 * np.pi) for distance in far]
        corner = bells[0] * bells[1] * rho * (1 + rho * far[0] * far[1] / 2)
        factor, weight, level = (1.0, 4.0, 0.0) if saddle else (0.25, 1.0, 1.0)
        first, second = level + first, level + second
        shape = factor * first * second + weight * corner
        by_first, by_second = (
            b * (2 * factor * bell * edge - distance * weight * corner)
            for bell, edge, distance in zip(bells, (second, first), far, strict=True)
        )
        (u1, v1, t1, w1), (u2, v2, t2, w2) = slopes
        columns = (
            by_first * u1 + by_second * u2,
            by_first * v1 + by_second * v2,
            by_first * t1,
            by_second * t2,
            by_first * w1 + by_second * w2,
            np.ones_like(shape),
            shape,
        )
        return x[:, 5:6] + b * shape, np.stack(columns, axis=2)

    def fitted(self, *, saddle: bool) -> Iterator[tuple[int, float, float, float, float, str]]:
        """Yield number, u, v, standard deviation, blur, and reason for doubt of each corner."""
        n, w = len(self.values), self.weights
        x = np.zeros((n, 7))
        x[:, 2], x[:, 3] = self.first, self.second
        x[:, 6] = 1.0
        design = w[:, :, None] * self._model(x, saddle)[1][:, :, 5:]  # grey values are linear
        x[:, 5:] = (np.linalg.pinv(design) @ (w * self.values)[:, :, None])[:, :, 0]
        damping, cost = np.full(n, 1e-3), np.full(n, np.inf)
        trial = x
        for _ in range(_STEPS):
            model, J = self._model(trial, saddle)
            r = (self.values - model) * w
            new = (r**2).sum(axis=1)
            better = new <= cost
            damping = np.where(better, damping / 5, damping * 10)
            if better.all() and (new > cost * (1 - 1e-9)).all():
                break
            x, cost = np.where(better[:, None], trial, x), np.where(better, new, cost)
            if better.any():
                model, J = self._model(x, saddle)
                r = (self.values - model) * w
                J = J * w[:, :, None]
                normal, right = J.transpose(0, 2, 1) @ J, (J.transpose(0, 2, 1) @ r[:, :, None])
            diagonal = np.einsum("nii->ni", normal)[:, :, None] * np.eye(7) + 1e-12 * np.eye(7)
            step = np.linalg.solve(normal + damping[:, None, None] * diagonal, right)[:, :, 0]
            trial = x + np.clip(step, -1.0, 1.0)
            trial[:, 4] = np.clip(trial[:, 4], np.log(0.2), np.log(8.0))
        freedoms = np.maximum(w.sum(axis=1) - 7, 1.0)
        variance = cost / freedoms * _correlation_factor(r.reshape(n, self.side, self.side))
        inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
        sigma = np.sqrt(variance * (inverse[:, 0, 0] + inverse[:, 1, 1]) / 2 + _MODEL**2)
        moved, blur = np.hypot(x[:, 0], x[:, 1]), np.exp(x[:, 4])
        contrast = np.abs(x[:, 6])
        misfit = np.sqrt(cost / freedoms) / np.maximum(contrast, 1e-9)
        for i in range(n):
            faults = {
                "low contrast": contrast[i] < _CONTRAST,
                "does not look like a corner": misfit[i] > _MISFIT or moved[i] > self.half[i] / 2,
                "blurred": blur[i] > _BLUR * self.half[i],
                "not certain enough": not sigma[i] < _SIGMA,
            }
            reason = next((text for text, doubtful in faults.items() if doubtful), "")
            u, v = self.starts[i] + x[i, :2]
            yield i, float(u), float(v), float(sigma[i]), float(blur[i]), reason


def _correlation_factor(residuals: Array) -> float:
    """Return the factor of the variance of a fit by correlated residuals, over white noise."""
    total, factor = (residuals**2).sum(), 1.0
    for axis in (1, 2):
        pairs = residuals * np.roll(residuals, 1, axis=axis)
        correlation = float(np.clip(pairs.sum() / max(total, 1e-300), 0.0, 0.8))
        factor *= (1 + correlation) / (1 - correlation)
    return factor
