"""Faults of photos: hypotheses that are judged by the nominal machine.

Each hypothesis corrects pixels or boards and places cameras and boards anew, as a search begins. It
is judged by the median miss of the nominal machine. The hypothesis with the smallest miss explains
the photos if it at least halves the miss. Single points and moved cameras are judged by fits.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from pincal.calibration.calibration import Calibration
from pincal.calibration.fits import Fits, fitted, with_misfit_as_noise
from pincal.errors import MisfitError, PincalError
from pincal.estimation.observability.residuals import Residuals
from pincal.estimation.solver import solve_poses
from pincal.estimation.system import FALSE_ALARM, cauchy, robust_scale, suspected
from pincal.estimation.unknowns import External
from pincal.finding import Finding
from pincal.instruments.camera import Camera, Markers
from pincal.kinematics.forward import forward
from pincal.types import Array
from pincal.words.findings import finding, sentence

_RATIO = 2.0  # by which a hypothesis divides the miss if it explains photos
_ROWS = 40  # number of rows by which hypotheses are judged
_SHIFTS = (1, -1, 2, -2)
_UNSURE = 0.2  # relative standard deviation of the pitch of a board, if that is sought
_FAR = 5e-3  # of the machine's size: a median miss that errors of the machine do not explain
_ROUNDS = 5  # of fits, each followed by a new choice of the points that do not fit
_PITCH, _FAR_PITCH = 5e-3, 1e-2  # relative errors of a pitch, clear and large

Judged = tuple[float, str, dict[str, Any]]
"""The median miss [m] under a hypothesis, and the code and values of its finding."""


def photo_faults(calibration: Calibration) -> tuple[Finding, ...]:
    """Return the fault that explains a misfit of photos, as a finding; empty if none does."""
    sample = _sample(calibration)
    judged = [(_missed(c)[0], code, values) for code, values, c in _hypotheses(calibration)]
    return _explaining(_missed(sample)[0], [*judged, *_scaled(sample)])


def check_photos(calibration: Calibration) -> None:
    """Raise a MisfitError if a fault explains why photos do not fit the nominal machine."""
    if _missed(_sample(calibration))[0] > _FAR * calibration.mechanism.size:
        for fault in photo_faults(calibration):
            raise MisfitError(sentence(fault))


def pitch_faults(calibration: Calibration) -> tuple[Finding, ...]:
    """Return the finding that a board has another pitch than its file says, if it has.

    A wrong pitch scales all lengths of the machine, so the fit does not show it. A large error is
    reported if it reduces the miss at all: drawings are not wrong by so much in all lengths.
    """
    sample = _sample(calibration)
    scaled = [*_scaled(sample)]
    is_far = any(abs(values["scale"] - 1.0) > _FAR_PITCH for _, _, values in scaled)
    return _explaining(_missed(sample)[0], scaled, 1.0 if is_far else _RATIO)


def boards_behind(
    calibration: Calibration, poses: Array, external: External
) -> tuple[Finding, ...]:
    """Return the flat boards that a fit sees from behind at poses (N, dof): mirrored prints."""
    matrices = external.frame @ calibration.mechanism.platform.matrices(poses)
    ids, extra = calibration.options.setup.device_parameters, calibration.measurements.extra
    values, behind = dict(zip(ids, external.instruments.tolist(), strict=True)), dict[str, None]()
    for camera in _cameras(calibration):
        seen = np.isfinite(np.column_stack([extra[right] for right, _ in camera.marks.values()]))
        of_camera = np.array([values[parameter.id] for parameter in camera.parameters])
        if np.nanmedian(camera.facing(matrices, of_camera)[seen]) < 0.0:
            behind[camera.markers.name] = None
    return tuple(finding("board-behind", board=name) for name in behind)


def moved_cameras(fits: Fits) -> list[Finding]:
    """Return the clearest step of a camera's pose between two rows as a finding, if there is one.

    An error of the machine moves everything that cameras see. The step is therefore tested with the
    misfit of the machine as noise of its readings, also as drawn, since a fitted one bends to it.
    Residuals that stay correlated from row to row are no step, nor is a displacement of points
    below their noise. The size is the root mean square displacement across the line of sight, [m].
    """
    if not any(chance < FALSE_ALARM for chance, *_ in _camera_steps(fits)):
        return []
    drawn = fits.calibration.with_options(fixed=("*",), priors={}, tied=())
    return _camera_step(fits) or _camera_step(fitted(drawn))


def _camera_step(fits: Fits) -> list[Finding]:
    """Return the clearest step of a camera, the misfit of the machine being noise of readings."""
    fits = with_misfit_as_noise(fits)
    chance, _, correlated, name, row, moved = min(_camera_steps(fits), key=lambda case: case[:2])
    fit, state = fits.fits[0], fits.fits[0].last.state
    observation = fit.problem.observation.at(np.arange(row, len(fit.rows)))
    metres = observation.metres_per_pixel(state.matrices[row:], state.external)
    pixels, sigma = moved[:, -metres.shape[1] :], observation.sigma
    seen = pixels != 0.0
    if chance >= FALSE_ALARM or correlated or not np.mean((pixels[seen] / sigma[seen]) ** 2) > 1.0:
        return []
    size = float(np.sqrt(2.0 * np.mean((pixels * metres)[seen] ** 2)))
    rows, camera = (int(fit.rows[row]),), {"what": "camera", "name": name, "unit": "m"}
    return [finding("step", rows, size=size, p_value=chance, **camera)]


def _camera_steps(fits: Fits) -> Iterator[tuple[float, float, bool, str, int, Array]]:
    """Yield the clearest step of the pose of each camera at an unknown place.

    A step is the p-value over all rows and cameras, minus the χ² that it explains, whether the
    residuals after it are correlated from row to row, the camera's name, the first row after it,
    and the change of all conditions from that row on, shape (n, k).
    """
    fit, linear = fits.fits[0], fits.fits[0].last
    cameras = [camera for camera in _cameras(fits.calibration) if not camera.known]
    if not cameras:
        return
    residuals, jacobian = Residuals.of(fit), linear.jacobian[fit.good]
    for camera in cameras:
        columns = [fit.unknowns.labels.index(number.id) for number in camera.parameters[:6]]
        J = jacobian[:, :, columns]
        scaled = np.linalg.pinv(np.linalg.qr(J.reshape(-1, 6), mode="r"))  # all six alike
        row, after, step = residuals.step(J @ scaled)
        correlated = residuals.alike_after(after, J @ scaled) != 0.0
        moved = linear.by_parameter[row:][:, :, columns] @ (scaled @ step.values)
        yield step.p_value * len(cameras), -step.inside, correlated, camera.name, row, moved


def _explaining(
    nominal_miss: float, judged: list[Judged], ratio: float = _RATIO
) -> tuple[Finding, ...]:
    missed, code, values = min(judged, key=lambda case: case[0], default=(np.inf, "", {}))
    if not missed * ratio <= nominal_miss:
        return ()
    return (finding(code, given=nominal_miss, missed=missed, **values),)


def _sample(calibration: Calibration) -> Calibration:
    """Return the calibration on some of its rows, with the pitch of boards taken as exact."""
    count = len(calibration.measurements)
    rows = np.unique(np.linspace(0, count - 1, min(count, _ROWS)).astype(int))
    boards = {c.markers.name: replace(c.markers, scale=0.0) for c in _cameras(calibration)}
    return _with_boards(calibration.rows(rows), boards)


def _cameras(calibration: Calibration) -> list[Camera]:
    return [d for d in calibration.options.setup.instruments if isinstance(d, Camera)]


def _hypotheses(calibration: Calibration) -> Iterator[tuple[str, dict[str, Any], Calibration]]:
    """Yield each hypothesis with its code, its values and the corrected calibration."""
    data, sample = calibration.measurements, _sample(calibration)
    columns = [column for camera in _cameras(sample) for column in camera.columns]
    for shift in _SHIFTS:
        moved = {name: np.roll(data.extra[name], shift) for name in columns}
        for values in moved.values():
            values[slice(shift) if shift > 0 else slice(shift, None)] = np.nan
        shifted = replace(data, extra={**data.extra, **moved})
        changed = _sample(replace(calibration, measurements=shifted))
        yield "photos-shifted", {"shift": shift}, changed
    for quarters in (1, 2, 3):  # turned back, by so many anticlockwise
        extra = dict(sample.measurements.extra)
        for camera in _cameras(sample):
            width, height = np.array(camera.lens.size) - 1.0
            for right, down in camera.marks.values():
                u, v = extra[right], extra[down]
                ways = ((v, height - u), (width - u, height - v), (width - v, u))
                extra[right], extra[down] = ways[quarters - 1]
        turned = replace(sample, measurements=replace(sample.measurements, extra=extra))
        yield "photos-turned", {"turn": 90 * quarters}, turned
    yield from _boards(sample)


def _boards(sample: Calibration) -> Iterator[tuple[str, dict[str, Any], Calibration]]:
    """Yield the hypotheses of mirrored boards and of two exchanged boards."""
    boards = {camera.markers.name: camera.markers for camera in _cameras(sample)}
    for name, board in boards.items():
        mirrored = {p: xyz and (-xyz[0], *xyz[1:]) for p, xyz in board.points.items()}
        mirror = {name: replace(board, points=mirrored)}
        yield "board-mirrored", {"board": name}, _with_boards(sample, mirror)
    for first, second in combinations(boards.values(), 2):
        if len(first.points) == len(second.points):
            exchanged = {
                a.name: replace(a, points=dict(zip(a.points, b.points.values(), strict=True)))
                for a, b in ((first, second), (second, first))
            }
            names = (first.name, second.name)
            yield "boards-exchanged", {"boards": names}, _with_boards(sample, exchanged)


def _scaled(sample: Calibration) -> Iterator[Judged]:
    """Yield the hypothesis of another pitch for each board, as the nominal machine shows it."""
    for name, board in {c.markers.name: c.markers for c in _cameras(sample)}.items():
        if any(point is not None for point in board.points.values()):
            case = _with_boards(sample, {name: replace(board, scale=_UNSURE)})
            missed, values = _missed(case)
            scale = values.get(f"{name}.scale", 1.0)
            if abs(scale - 1.0) > _PITCH:
                yield missed, "board-scale", {"board": name, "scale": scale}


def _missed(calibration: Calibration) -> tuple[float, dict[str, float]]:
    """Return the median distance by which the nominal machine misses points, [m].

    The second value has the unknowns of the cameras by id.
    """
    machine, data = calibration.mechanism, calibration.measurements
    observation, ids = calibration.observation, calibration.options.setup.device_parameters
    try:
        problem = calibration.started(calibration.latent_problem)
    except (PincalError, np.linalg.LinAlgError):
        return np.inf, {}
    external = problem.start(calibration.unknowns.start).external
    poses = forward(machine, data.readings, influences=calibration.influences).poses
    matrices = machine.platform.matrices(poses)
    pixels = observation.measured & (np.array(observation.units) == "px")
    missed = np.abs(observation.residuals(matrices, external)[0])
    missed *= observation.metres_per_pixel(matrices, external)
    values = zip(ids, external.instruments.tolist(), strict=True)
    return float(np.median(np.nan_to_num(missed[pixels], nan=np.inf))), dict(values)


def _with_boards(calibration: Calibration, boards: dict[str, Markers]) -> Calibration:
    setup = calibration.options.setup
    devices = tuple(
        replace(d, markers=boards.get(d.markers.name, d.markers)) if isinstance(d, Camera) else d
        for d in setup.instruments
    )
    return calibration.with_options(setup=replace(setup, instruments=devices))


def without_false_points(calibration: Calibration) -> Calibration:
    """Return a calibration without the single points in photos that do not fit.

    Fits alternate with weights of the points by Cauchy's loss until the same points do not fit. A
    photo in which most points do not fit is kept: it is an outlying row.
    """
    data, setup = calibration.measurements, calibration.options.setup
    pairs = [p for device in setup.instruments for p in getattr(device, "marks", {}).values()]
    pairs = [pair for pair in pairs if data.extra.keys() >= {*pair}]
    judged = calibration.at_this_noise().with_options(loss="none")
    names, near = judged.observation.names, None
    columns = np.array([[names.index(name) for name in pair] for pair in pairs])
    sigma = judged.observation.row_noise(data, judged.noise.noise).sigma[:, columns]
    measured = judged.observation.measured[:, columns].all(axis=2)
    problem = judged.started(judged.latent_problem)
    linear = solve_poses(problem.evaluate(problem.start(judged.unknowns.start)))
    weights, false = np.ones(measured.shape), np.zeros(measured.shape, dtype=bool)
    for _ in range(_ROUNDS):
        missed = linear.noise[:, problem.leg_block.n_readings + columns] ** 2 / weights[:, :, None]
        squares, two = missed.sum(axis=2)[measured], np.full(int(measured.sum()), 2)
        scale = robust_scale(squares, two, 1.0)
        squares = squares / max(scale, 1.0 if judged.noise.known else scale) ** 2
        weights[measured], before = cauchy(squares, two), false.copy()
        false[measured] = suspected(squares, two)
        if near is not None and (false == before).all():
            break
        noise = (sigma / np.sqrt(weights)[:, :, None]).reshape(len(data), -1)
        by_name = dict(zip(np.ravel(pairs).tolist(), noise.T, strict=True))
        weighted = replace(data, sigma_extra={**data.sigma_extra, **by_name})
        near = fitted(replace(judged, measurements=weighted), near)
        linear = near.fits[0].last
    false &= 2 * false.sum(axis=1, keepdims=True) <= measured.sum(axis=1, keepdims=True)
    extra = dict(data.extra)
    for pair, rows in zip(pairs, false.T, strict=True):
        extra |= {name: np.where(rows, np.nan, extra[name]) for name in pair}
    return replace(calibration, measurements=replace(data, extra=extra))
