"""Inverse and forward kinematics of one machine, between poses and readings, in plain Python.

Poses are rigid transforms T_base_platform: three rows of a rotation and a position, 12 numbers,
[1] and [m]; ``pose`` makes one of coordinates. Readings are in [rad] or [m], in the order of
``MACHINE["readings"]``. Influences are the quantities that terms depend on, in the order of
``MACHINE["influences"]``; an unknown one is nan: its terms are 0, but loads of an arm are computed.

    >>> T = pose(*MACHINE["home"])
    >>> readings, joints, reason = inverse(T)
    >>> T, joints, reason = forward(readings)
"""

from __future__ import annotations

from math import atan2, copysign, cos, hypot, inf, isfinite, nan, pi, sin, sqrt  # noqa: F401
from typing import Any, NamedTuple

MACHINE: dict[str, Any] = {}

Row = list[float]
Matrix = list[Row]
STEPS = 40  # largest number of Newton steps
WITHIN = 20  # first steps that stay within limits, if no joints near by are given
WAY = 10  # steps of readings on the way from home
LARGEST = 0.3  # largest step of a joint, [rad] or over the leg's size
SMALL = 1e-10  # step after which the remaining error is rounding
CLOSED = 1e-10  # largest gap of a closed leg, over its size
DAMPING = 1e-6  # over the largest entry, where joints are more than rows
BOUND = 1e12  # largest size of an argument
ROUNDED = 1e-3  # largest error of a rotation whose numbers have few digits
UNSOUND = "arguments are not finite numbers up to 1e12, or the pose is no rigid transform"


class Solution(NamedTuple):
    """Solution of inverse or forward kinematics."""

    values: Row
    """Readings, or the pose; invalid if there is a reason."""
    joints: Matrix
    """Positions of each leg's joints, [rad] or [m], for ``near`` of the next call."""
    reason: str
    """Reason why there is no solution; empty if there is one."""


def pose(*coordinates: float) -> Row:
    """Return the pose of coordinates, which are in the order of ``MACHINE["coordinates"]``."""
    lengths, turns = MACHINE["lengths"], MACHINE["turns"]
    T = [1.0, 0, 0, 0, 0, 1.0, 0, 0, 0, 0, 1.0, 0]
    for axis in range(lengths):
        T[4 * axis + 3] = coordinates[axis]
    if len(turns) == 1:
        return compose(T, turned(turns[0], coordinates[lengths]))
    if len(turns) == 3:
        azimuth, tilt, torsion = coordinates[lengths:]
        T = compose(T, turned((0.0, 0.0, 1.0), azimuth))
        T = compose(T, turned((0.0, 1.0, 0.0), tilt))
        T = compose(T, turned((0.0, 0.0, 1.0), torsion - azimuth))
    return T


def coordinates(T: Row) -> Row:
    """Return the platform's coordinates of a pose."""
    lengths, turns = MACHINE["lengths"], MACHINE["turns"]
    values = [T[4 * axis + 3] for axis in range(lengths)]
    if len(turns) == 1:
        axis = turns[0].index(1.0)
        j, k = (axis + 1) % 3, (axis + 2) % 3
        values.append(atan2(T[4 * k + j], T[4 * j + j]))
    elif len(turns) == 3:
        flat, steep = hypot(T[2], T[6]), T[10]
        azimuth = atan2(T[6], T[2]) if flat > 1e-13 else 0.0
        torsion = atan2(T[4] - T[1], T[0] + T[5])
        if flat <= 1e-13 and steep < 0.0:
            azimuth, torsion = atan2(-T[1], -T[0]) / 2.0, 0.0
        values += [azimuth, atan2(flat, steep), torsion]
    return values


def in_base(T: Row) -> Row:
    """Return T_base_platform of a pose of the tool in the frame of the measurements."""
    return compose(compose(inverted(MACHINE["frame"]), T), inverted(MACHINE["tool"]))


def in_frame(T: Row) -> Row:
    """Return the pose of the tool in the frame of the measurements from T_base_platform."""
    return compose(compose(MACHINE["frame"], T), MACHINE["tool"])


def corrected(T: Row) -> Row:
    """Return the pose to command to a controller with other geometry to reach a pose."""
    grid, home = MACHINE["grid"], pose(*MACHINE["home"])
    offset = [T[i] - home[i] for i in (3, 7, 11)] + rotation_vector(compose(T, inverted(home)))
    count, dof, corners = grid["count"], len(MACHINE["twist"]), [(0, 1.0)]
    for row, low, high in zip(MACHINE["twist"], grid["low"], grid["high"], strict=True):
        place = min(max((offset[row] - low) / (high - low), 0.0), 1.0) * (count - 1)
        cell = min(int(place), count - 2)
        sides = (cell, 1.0 - place + cell), (cell + 1, place - cell)
        corners = [(node * count + i, w * share) for node, w in corners for i, share in sides]
    values = grid["twists"]
    return displaced(T, [sum(w * values[n * dof + i] for n, w in corners) for i in range(dof)])


def inverse(T: Row, influences: Row | None = None, near: Matrix | None = None) -> Solution:
    """Return the readings of a pose, in the working modes of home.

    The joints are the solution near ``near``; without it, an arm's are within limits if possible.
    """
    known = influences or [nan] * len(MACHINE["influences"])
    if not _sound(T, known, *near or ()):
        return Solution([nan] * len(MACHINE["readings"]), [], UNSOUND)
    solution = _inverse(T, known, near)
    for _ in range(20 * bool(MACHINE["load"]["bodies"])):  # loads depend on readings, but weakly
        before = solution
        near = near if before.reason else before.joints
        solution = _inverse(T, _with_loads(known, before.values), near)
        if all(abs(a - b) <= SMALL for a, b in zip(solution.values, before.values, strict=True)):
            break
    return solution


def forward(
    readings: Row, influences: Row | None = None, near: tuple[Row, Matrix] | None = None
) -> Solution:
    """Return the pose of readings, in the assembly mode of home, or near a pose and its joints.

    With more readings than freedoms it is the pose of least gaps.
    """
    known = influences or [nan] * len(MACHINE["influences"])
    from_pose, joints = near or (pose(*MACHINE["home"]), [leg["home"] for leg in MACHINE["legs"]])
    if not _sound(from_pose, known, readings, *joints):
        return Solution([nan] * 12, [], UNSOUND)
    known = _with_loads(known, readings)
    solution = _forward(readings, known, from_pose, joints)
    if solution.reason and near is None:
        for step in range(1, WAY + 1):
            pairs = zip(MACHINE["home_readings"], readings, strict=True)
            stage = [start + step / WAY * (end - start) for start, end in pairs]
            solution = _forward(stage, known, from_pose, joints)
            if not solution.reason:
                from_pose, joints = solution.values, solution.joints
    return solution


def _bounded(*parts: Row) -> bool:
    """Return whether all numbers are finite and not too large to compute with."""
    return all(abs(value) <= BOUND for part in parts for value in part)


def _sound(T: Row, known: Row, *parts: Row) -> bool:
    """Return whether a pose is a rigid transform, other numbers are bounded, influences or nan."""
    x, y, z = T[:3], T[4:7], T[8:11]  # each of the other two, by their cross product
    pairs = zip([_dot(x, x), *_cross(x, y), *_cross(y, z)], [1.0, *z, *x], strict=True)
    rigid = len(T) == 12 and all(abs(a - b) <= ROUNDED for a, b in pairs)
    return rigid and _bounded(T, *parts) and not any(abs(value) > BOUND for value in known)


def beyond_limits(joints: Matrix) -> list[str]:
    """Return the names of joints that are outside their limits."""
    pairs = zip(MACHINE["legs"], joints, strict=True)
    return [f"{leg['name']} {leg['joints'][i]}" for leg, q in pairs for i in _outside(leg, q)]


def _outside(leg: dict[str, Any], q: Row) -> list[int]:
    """Return the indices of a leg's joints that are outside their limits."""
    pairs = enumerate(zip(q, leg["limits"], strict=True))
    return [i for i, (value, (low, high)) in pairs if not low - 1e-9 <= value <= high + 1e-9]


def _inverse(T: Row, known: Row, near: Matrix | None) -> Solution:
    readings: Row = []
    joints: Matrix = []
    reason = ""
    for index, leg in enumerate(MACHINE["legs"]):
        q, reached = _close(leg, T, _deformations(leg, known), near[index] if near else None)
        joints.append(q)
        for row, sensor in enumerate(leg["sensors"]):
            value, settled = _reading(sensor, q[leg["active"][row]], known)
            readings.append(value)
            reached = reached and settled and isfinite(value)
        if not reached and not reason:
            reason = f"no joints of {leg['name']} found that reach it in its working mode"
    return Solution(readings, joints, reason)


def _close(leg: dict[str, Any], T: Row, bent: Row, near: Row | None) -> tuple[Row, bool]:
    """Return joints that close a leg at a pose, and whether they do, in its working mode.

    The search begins at ``near``; without it, at the starts, the nearest first, and takes the first
    solution within limits, or else the first solution.
    """
    if near is not None:
        return _solve(leg, T, near, bent, near)
    beyond = list(leg["home"]), False
    for _, start in sorted((_apart(T, S), i) for i, S in enumerate(MACHINE["starts"])):
        q, closed = _solve(leg, T, leg["starts"][start], bent)
        if closed and not _outside(leg, q):
            return q, True
        beyond = (q, True) if closed and not beyond[1] else beyond
    return beyond


def _apart(T: Row, S: Row) -> float:
    """Return the squared distance of poses, [m²]; angles count times the machine's size."""
    weights = [0.5 * MACHINE["size"] ** 2] * 3 + [1.0]  # |R − R'|² is twice the squared angle
    return sum(weights[i % 4] * (a - b) ** 2 for i, (a, b) in enumerate(zip(T, S, strict=True)))


def _solve(
    leg: dict[str, Any], T: Row, start: Row, bent: Row, near: Row | None = None
) -> tuple[Row, bool]:
    """Return joints by Newton's method, and whether they close the leg in its working mode."""
    values, n = [*start, *bent], len(leg["unknown"])
    for k in range(STEPS):
        rows = [[*row[:n], row[-1]] for row in _closure(leg, T, values)]
        step = _least_squares(rows, n)
        length = _length(leg, leg["unknown"], step)
        for i, change in zip(leg["unknown"], step, strict=True):
            values[i] += min(1.0, LARGEST / max(length, LARGEST)) * change
        if not length > SMALL:
            break
        for i, (low, high) in enumerate(leg["limits"] if near is None and k < WITHIN else ()):
            values[i] = max(low, min(high, values[i]))
    _turn_back(leg, values, leg["home"] if near is None else near, near is None)
    rows = _closure(leg, T, values)
    closed = max(abs(row[-1]) for row in rows) <= CLOSED * leg["size"]
    return values[: len(start)], closed and _mode(leg, rows) == leg["mode"]


def _forward(readings: Row, known: Row, T: Row, near: Matrix) -> Solution:
    """Return the pose of readings by Newton's method from a pose and joints; exact for an arm."""
    legs, places = MACHINE["legs"], iter(range(len(readings)))
    states = [[*q, *_deformations(leg, known)] for leg, q in zip(legs, near, strict=True)]
    for leg, values in zip(legs, states, strict=True):
        for place, sensor in zip(leg["active"], leg["sensors"], strict=False):
            values[place] = _position(sensor, readings[next(places)], known)
        if leg["arm"]:
            end = leg["ends"][0]
            T = compose(_chain(end["tip"], values)[0], inverted(_chain(end["met"], values)[0]))
    moved, mode, square = 1.0, 0.0, True
    for _ in range(STEPS):
        T, moved, mode, square = _stepped(T, states)
        if not moved > SMALL:
            break
    gaps, in_mode = 0.0, mode == MACHINE["assembly"] or not square
    for leg, values in zip(legs, states, strict=True):
        rows = _closure(leg, T, values)
        gaps = max(gaps, *(abs(row[-1]) for row in rows))
        in_mode = in_mode and _mode(leg, rows) == leg["mode"]
        del values[len(leg["joints"]) :]
    largest = (CLOSED if square else 0.1) * MACHINE["size"]
    if not all((moved <= SMALL, gaps <= largest, _bounded(T))):
        return Solution(T, states, "no pose found that closes all legs")
    return Solution(T, states, "" if in_mode else "left the working or assembly mode of home")


def _stepped(T: Row, states: Matrix) -> tuple[Row, float, float, bool]:
    """Return a pose after a Newton step, which moves passive joints in place.

    Also return the largest step, the sign of the determinant, and whether there are as many
    equations as freedoms. Passive joints are eliminated leg by leg.
    """
    legs, sign = MACHINE["legs"], 1.0
    rows: Matrix = []
    reduced: list[Matrix] = []
    for leg, values in zip(legs, states, strict=True):
        A, count = _closure(leg, T, values, len(leg["active"])), len(leg["passive"])
        sign *= _triangularise(A, count)
        reduced.append(A)
        rows += [row[count:] for row in A[count:]]
    dof = len(rows[0]) - 1
    sign *= _triangularise(rows, dof)
    twist = _back_substituted(rows, dof)
    lengths = [abs(value) / MACHINE["size"] for value in twist[: MACHINE["lengths"]]]
    moved = max(*lengths, *map(abs, twist[MACHINE["lengths"] :]), 0.0)
    share = min(1.0, LARGEST / max(moved, LARGEST))
    for leg, values, A in zip(legs, states, reduced, strict=True):
        count = len(leg["passive"])
        for row in A:
            row[-1] -= share * _dot(row[count:-1], twist)
        step = _back_substituted(A, count)
        moved = max(moved, _length(leg, leg["passive"], step))
        for i, change in zip(leg["passive"], step, strict=True):
            values[i] += change
    return displaced(T, [share * value for value in twist]), moved, sign, len(rows) == dof


def _closure(leg: dict[str, Any], T: Row, values: Row, first: int = 0) -> Matrix:
    """Return rows of a leg's ends: derivatives, by unknown joints and the pose, and minus the gap.

    Gaps are in [m]. ``values`` are joints, then deformations; unknown joints count from ``first``.
    """
    rows: Matrix = []
    unknown, origin = leg["unknown"][first:], [T[3], T[7], T[11]]
    freedoms = [Move(f > 2, _unit(f % 3), origin, []) for f in MACHINE["twist"]]
    for end in leg["ends"]:
        tip, moves = _chain(end["tip"], values)
        met, returning = _chain(end["met"], values)
        axes = [[met[i], met[4 + i], met[8 + i]] for i in range(3)]
        if not end["loop"]:  # the end meets the platform, in the axes of the base
            met, axes, returning = compose(T, met), [_unit(i) for i in range(3)], []
        columns = _columns(len(leg["joints"]), moves, returning, [tip[3], tip[7], tip[11]])
        gap, place = [tip[i] - met[i] for i in (3, 7, 11)], [met[3], met[7], met[11]]
        turn = rotation_vector(compose(tip, inverted(met))) if max(end["rows"]) > 2 else gap
        for row in end["rows"]:
            axis, angular = axes[row % 3], row > 2
            scale = leg["size"] if angular else 1.0
            sign = 0.0 if end["loop"] else -scale
            by_joints = [scale * _dot(axis, columns[i][angular]) for i in unknown]
            by_pose = [sign * _dot(axis, _twist(f, place)[angular]) for f in freedoms]
            rows.append([*by_joints, *by_pose, -scale * _dot(axis, turn if angular else gap)])
    return rows


def _unit(axis: int) -> Row:
    return [float(axis == i) for i in range(3)]


def _columns(n: int, moves: list[Move], returning: list[Move], place: Row) -> list[Matrix]:
    """Return velocity and spin of a tip, at a place, relative to a frame, by each of n joints."""
    columns = [[[0.0] * 3, [0.0] * 3] for _ in range(n)]
    for sign, motion in (*((1.0, move) for move in moves), *((-1.0, move) for move in returning)):
        for part, vector in enumerate(_twist(motion, place)):
            for source, rate in motion.rates:
                for i in range(3 if source < n else 0):
                    columns[source][part][i] += sign * rate * vector[i]
    return columns


class Move(NamedTuple):
    """A joint of a chain at its present place: its kind, axis, and a point on it, base frame."""

    turns: bool
    axis: Row
    point: Row
    rates: list[tuple[int, float]]
    """Indices of joints, then deformations, that move it, each with its rate."""


def _chain(chain: dict[str, Any], values: Row) -> tuple[Row, list[Move]]:
    """Return the pose of a chain's tip, and the chain's joints as moves."""
    T, moves = chain["start"], []
    for turns, axis, _, rates, behind in chain["moves"]:
        position = sum(rate * values[source] for source, rate in rates)
        along = [_dot(T[i : i + 3], axis) for i in (0, 4, 8)]
        moves.append(Move(turns, along, [T[3], T[7], T[11]], rates))
        T = compose(T, turned(axis, position)) if turns else list(T)
        for i in range(0 if turns else 3):
            T[4 * i + 3] += position * along[i]
        T = compose(T, behind)
    return T, moves


def _twist(move: Move, place: Row) -> tuple[Row, Row]:
    """Return velocity at a place and spin of a joint's motion."""
    if not move.turns:
        return move.axis, [0.0, 0.0, 0.0]
    return _cross(move.axis, [a - b for a, b in zip(place, move.point, strict=True)]), move.axis


def _position(sensor: dict[str, Any], reading: float, known: Row) -> float:
    """Return a joint's position at a reading."""
    terms = (
        a * _basis(form, reading if place < 0 else known[place])
        for a, place, *form in sensor["terms"]
    )
    return float(sensor["slope"] * reading + sensor["start"] + sum(terms))


def _reading(sensor: dict[str, Any], position: float, known: Row) -> tuple[float, bool]:
    """Return the reading of a joint's position, and whether the search for it converged."""
    reading = (position - sensor["start"]) / sensor["slope"]
    step = 0.0
    for _ in range(50 * bool(sensor["terms"])):
        slope = sensor["slope"] + sum(
            a * _basis(form, reading, True) for a, place, *form in sensor["terms"] if place < 0
        )
        step = (position - _position(sensor, reading, known)) / (slope or 1e-300)
        reading += step
        if abs(step) <= 1e-15 * max(1.0, abs(reading)):
            break
    return reading, abs(step) <= 1e-8 * max(1.0, abs(reading))


def _deformations(leg: dict[str, Any], known: Row) -> Row:
    """Return the deformations of a leg's lengths and angles, [m] or [rad]."""
    return [
        float(sum(a * _basis(form, known[place]) for a, place, *form in deformation["terms"]))
        for deformation in leg["deformations"]
    ]


def _basis(form: Row, value: float, slope: bool = False) -> float:
    """Return a term's function, or its derivative; 0 if its influence is unknown."""
    a, b, exponent = form
    if not abs(value) <= BOUND:
        return 0.0
    if not exponent:
        return a * cos(a * value + b) if slope else sin(a * value + b)
    relative = max(-1e6, min(1e6, (value - b) / a))  # so that its powers do not overflow
    return float(exponent / a * relative ** (exponent - 1) if slope else relative**exponent)


def _with_loads(known: Row, readings: Row) -> Row:
    """Return influences; an arm's gravity loads, as drawn, are computed where not given."""
    load = MACHINE["load"]
    pairs = zip(load["sensors"], readings, strict=False)
    q = [0.0] * load["width"]
    for place, (sensor, reading) in zip(load["active"], pairs, strict=False):
        q[place] = _position(sensor, reading, [])
    weights = [0.0] * load["width"]
    for mass, chain in load["bodies"]:
        centre, moves = _chain(chain, q)
        place = [centre[3], centre[7], centre[11]]
        for move in moves:
            power = mass * _dot(load["gravity"], _twist(move, place)[0])
            for source, rate in move.rates:
                weights[source] += rate * power
    completed = list(known)
    for place, source in load["columns"]:
        if not isfinite(completed[place]):
            completed[place] = weights[source]
    return completed


def _turn_back(leg: dict[str, Any], q: Row, centre: Row, within_limits: bool) -> None:
    """Remove full turns of joints, in place: near a centre, and within limits if possible."""
    for i, (turns, (low, high)) in enumerate(zip(leg["turns"], leg["limits"], strict=True)):
        if turns and isfinite(q[i]):
            q[i] = centre[i] + atan2(sin(q[i] - centre[i]), cos(q[i] - centre[i]))
            if within_limits and not low - 1e-9 <= q[i] <= high + 1e-9:
                unwound = low - 1e-9 + (q[i] - low + 1e-9) % (2.0 * pi)
                q[i] = unwound if unwound <= high + 1e-9 else q[i]


def _mode(leg: dict[str, Any], rows: Matrix) -> float:
    """Return the sign of the determinant by all joints; 1 if not square, or no joint is passive."""
    n = len(leg["unknown"])
    return 1.0 if n != len(rows) or not leg["passive"] else _triangularise(rows, n)


def _length(leg: dict[str, Any], places: list[int], step: Row) -> float:
    """Return the largest step of joints, [rad] or over the leg's size."""
    pairs = zip(places, step, strict=True)
    lengths = [abs(value) / (1.0 if leg["turns"][i] else leg["size"]) for i, value in pairs]
    return max(lengths, default=0.0)


def _least_squares(rows: Matrix, n: int) -> Row:
    """Return x that minimises |A x − b|, of rows [A b]; the shortest one of fewer rows than n."""
    if len(rows) < n:
        largest = max(max(map(abs, row[:n])) for row in rows)
        rows += [[DAMPING * largest * (i == j) for j in range(n)] + [0.0] for i in range(n)]
    _triangularise(rows, n)
    return _back_substituted(rows, n)


def _triangularise(A: Matrix, columns: int) -> float:
    """Make the first columns of A triangular by reflections, in place.

    Return the sign of the determinant of these columns and the remaining reflected axes.
    """
    sign = 1.0
    for k in range(min(columns, len(A))):
        size = sqrt(sum(row[k] ** 2 for row in A[k:]))
        if size == 0.0 or k == len(A) - 1:
            sign *= copysign(1.0, A[k][k])
            continue
        pivot = A[k][k]
        end = -copysign(size, pivot)
        v = [pivot - end, *(row[k] for row in A[k + 1 :])]
        half = size * (size + abs(pivot))  # half of |v|²
        sign *= -copysign(1.0, end)
        for j in range(k, len(A[0])):
            share = sum(value * row[j] for value, row in zip(v, A[k:], strict=True)) / half
            for value, row in zip(v, A[k:], strict=True):
                row[j] -= share * value
    return sign


def _back_substituted(A: Matrix, n: int) -> Row:
    """Return x of R x = b, with a triangular R; the last column of A is b."""
    x = [0.0] * n
    for i in reversed(range(min(n, len(A)))):
        remainder = A[i][-1] - sum(A[i][j] * x[j] for j in range(i + 1, n))
        x[i] = remainder / A[i][i] if A[i][i] else 0.0
    return x


def displaced(T: Row, twist: Row) -> Row:
    """Return a pose moved by a twist in the platform's freedoms, base axes."""
    shift, turn = [0.0] * 3, [0.0] * 3
    for row, value in zip(MACHINE["twist"], twist, strict=True):
        (shift if row < 3 else turn)[row % 3] = value
    size = sqrt(_dot(turn, turn))
    moved = compose(turned([value / (size or 1.0) for value in turn], size), T)
    for i in range(3):
        moved[4 * i + 3] = T[4 * i + 3] + shift[i]
    return moved


def compose(A: Row, B: Row) -> Row:
    """Return A B of two rigid transforms."""
    product = []
    for i in (0, 4, 8):
        a, b, c = A[i : i + 3]
        product += [a * B[j] + b * B[4 + j] + c * B[8 + j] for j in range(4)]
        product[-1] += A[i + 3]
    return product


def inverted(T: Row) -> Row:
    """Return the inverse of a rigid transform."""
    rows = [[T[i], T[4 + i], T[8 + i]] for i in range(3)]
    place = [T[3], T[7], T[11]]
    return [value for row in rows for value in (*row, -_dot(row, place))]


def turned(axis: Any, angle: float) -> Row:
    """Return the rotation about a unit axis through the origin."""
    (x, y, z), c, s = axis, cos(angle), sin(angle)
    d = 1.0 - c
    first = [c + x * x * d, x * y * d - z * s, x * z * d + y * s, 0.0]
    second = [y * x * d + z * s, c + y * y * d, y * z * d - x * s, 0.0]
    return [*first, *second, z * x * d - y * s, z * y * d + x * s, c + z * z * d, 0.0]


def rotation_vector(T: Row) -> Row:
    """Return the rotation vector, axis times angle, of a rigid transform's rotation."""
    skew = [T[9] - T[6], T[2] - T[8], T[4] - T[1]]
    double = sqrt(_dot(skew, skew))
    angle = atan2(double, T[0] + T[5] + T[10] - 1.0)
    if double > 1e-7:
        return [angle / double * value for value in skew]
    if angle < 1.0:
        return [0.5 * value for value in skew]
    i = max(range(3), key=lambda i: T[5 * i])  # half a turn
    size = sqrt(max(T[5 * i] + 1.0, 0.0) / 2.0)
    column = [(T[4 * i + j] + T[4 * j + i]) / (4.0 * size) for j in range(3)]
    column[i] = size
    return [angle * value for value in column]


def _dot(a: Any, b: Any) -> float:
    return float(sum(x * y for x, y in zip(a, b, strict=True)))


def _cross(a: Row, b: Row) -> Row:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
