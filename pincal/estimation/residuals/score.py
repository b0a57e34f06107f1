"""What a model lacks, seen in its residuals: score tests of terms, and steps from one row on.

An error b(n) of one measured quantity appears in the white rows as w = L⁻¹Nᵀ s b, s how the
conditions follow that quantity. With M the projection on what parameters do not take up, the part
of the residuals that lies in M w is, if the model lacks nothing, a share of χ² like any other: an F
test without a new fit (C. R. Rao's score test).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from pincal.estimation.fit import Fit
from pincal.estimation.linear import Orthonormal
from pincal.estimation.observability.indices import RANK_TOLERANCE

Array = NDArray[np.float64]
_HARMONICS = (1, 2, 3)
ALL = "readings"  # all of them together


@dataclass(frozen=True)
class Score:
    """One test: which quantity, which term, and how probable by chance."""

    quantity: str
    """Reading or measured quantity, as ``Problem.quantities`` names it; ``"readings"``, all,
    or ``"lengths"`` of the legs."""
    term: str
    """``"angle"``, ``"pose"``, ``"order"``, ``"approach"``, ``"step"`` or ``"again"``."""
    p_value: float
    """Of so much of the residuals, or more, in this term; of a step, anywhere."""
    row: int = 0
    """Of a step: the first row after it, among those of the fit."""
    size: float = 0.0
    """Of a step: by how much the quantity is off after it, [rad] or [m]; of a pose that was
    measured again: by how much it moved from the first time to the last."""
    place: str = ""
    """Of a pose that was measured again: its name."""


@dataclass(frozen=True)
class Amplitudes:
    """What residuals say of terms, to first order."""

    values: Array
    """Shape (f,)."""
    std: Array
    """Standard errors, shape (f,); infinite where parameters take the term up."""
    F: float
    """χ² along the terms by its degrees of freedom, over that of the rest."""
    rank: int
    """Degrees of freedom: directions that parameters do not take up."""
    inside: float
    """χ² along the terms."""
    p_value: float
    """Of so much, or more, by chance."""


@dataclass(frozen=True)
class Change:
    """The clearest step of some errors, from one row on."""

    p_value: float
    """Of such a step anywhere, by chance."""
    row: int
    """The first row after it, among those of the fit."""
    size: Array
    """How large the errors are after it, shape (f,)."""
    inside: float
    """χ² that it takes off."""


@dataclass(frozen=True)
class Residuals:
    """White residuals and derivatives of rows that count, flat; parameters projected out."""

    used: NDArray[np.intp]
    left: Array
    """M r, shape (n_used, m)."""
    Q: Array
    """Shape (n_used, m, n_free)."""
    chi2: float
    degrees_of_freedom: int

    @classmethod
    def of(cls, one: Fit) -> Residuals:
        """Return those of a fit."""
        used = np.flatnonzero(one.good)
        r, J = one.last.value[used], one.last.jacobian[used] @ one.unknowns.map
        _, prior = one.unknowns.prior_rows(one.unknowns.start)
        Q = Orthonormal.of(J, prior)(J)
        left = r - Q @ np.einsum("nmi,nm->i", Q, r)
        return cls(used, left, Q, float((left**2).sum()), one.degrees_of_freedom)

    def chance(self, inside: Array | float, rank: int) -> Array:
        """Return the probability of a part of χ² of some rank, or of a larger one."""
        free = self.degrees_of_freedom - rank
        ratio = inside / rank / (np.maximum(self.chi2 - inside, 1e-300) / free)
        return np.asarray(fdtrc(rank, free, ratio))

    def along(self, W: Array) -> float:
        """Return the probability of residuals so far along the white rows of errors.

        Args:
            W: Of each error, shape (n_used, m, f).
        """
        flat, Q = W.reshape(-1, W.shape[2]), self.Q.reshape(-1, self.Q.shape[2])
        lengths = np.linalg.norm(flat, axis=0)
        flat = flat[:, lengths > 0.0] / lengths[lengths > 0.0]
        flat = flat - Q @ (Q.T @ flat)
        U, s, _ = np.linalg.svd(flat, full_matrices=False)
        U = U[:, s > RANK_TOLERANCE]
        if not 0 < U.shape[1] < self.degrees_of_freedom:
            return 1.0
        return float(self.chance(float(((U.T @ self.left.ravel()) ** 2).sum()), U.shape[1]))

    def amplitudes(self, W: Array) -> Amplitudes:
        """Return the amplitudes that residuals ask for along the white rows of terms.

        Args:
            W: Of each term, shape (n_used, m, f).
        """
        lengths = np.linalg.norm(W, axis=(0, 1))
        lengths = np.where(lengths > 0.0, lengths, 1.0)
        flat = (W - self.Q @ np.einsum("nmi,nmf->if", self.Q, W)).reshape(-1, W.shape[2]) / lengths
        U, s, V = np.linalg.svd(flat, full_matrices=False)
        kept = s > RANK_TOLERANCE
        rank = int(kept.sum())
        if not 0 < rank < self.degrees_of_freedom:
            none = np.full(W.shape[2], np.inf)
            return Amplitudes(np.zeros(W.shape[2]), none, 0.0, 0, 0.0, 1.0)
        along = U[:, kept].T @ self.left.ravel()
        inside = float(along @ along)
        rest = max(self.chi2 - inside, 1e-300) / (self.degrees_of_freedom - rank)
        back = V[kept].T / s[kept] / lengths[:, None]
        taken = (V[~kept] ** 2).sum(axis=0) > RANK_TOLERANCE  # along what geometry takes up
        std = np.where(taken, np.inf, np.sqrt(rest * (back**2).sum(axis=1)))
        p_value = float(self.chance(inside, rank))
        return Amplitudes(-back @ along, std, inside / rank / rest, rank, inside, p_value)

    def size(self, w: Array) -> float:
        """Return how large an error is that has these white rows if it is 1, shape (n_used, m)."""
        taken = np.einsum("nmi,nm->i", self.Q, w)
        length = float((w**2).sum() - (taken**2).sum())
        return float((w * self.left).sum() / length) if length > 0.0 else 0.0

    def step(self, w: Array) -> tuple[float, int, float]:
        """Return the probability of the clearest step anywhere, its first row and its size."""
        found = self.change(w[:, :, None])
        return found.p_value, found.row, float(found.size[0])

    def change(self, W: Array) -> Change:
        """Return the clearest step of several errors at once, from one row on.

        Args:
            W: White rows of the unit errors, shape (n_used, m, f).
        """
        f = W.shape[2]
        none = Change(1.0, 0, np.zeros(f), 0.0)
        if len(W) < 2 or self.degrees_of_freedom <= f:
            return none
        own = np.einsum("nmf,nmg->nfg", W, W)
        by = np.einsum("nmi,nmf->nif", self.Q, W)
        along = np.einsum("nmf,nm->nf", W, self.left)
        after, squares, taken = (np.cumsum(one[::-1], axis=0)[::-1][1:] for one in (along, own, by))
        lengths = squares - taken.transpose(0, 2, 1) @ taken
        least = RANK_TOLERANCE * max(float(np.trace(squares[0])), 1e-300)
        known = np.linalg.eigvalsh(lengths)[:, 0] > least
        if not known.any():
            return none
        places = np.flatnonzero(known)
        sizes = np.linalg.solve(lengths[known], after[known][:, :, None])[:, :, 0]
        inside = np.einsum("nf,nf->n", sizes, after[known])
        best = int(np.argmax(inside))
        chance = min(1.0, float(self.chance(float(inside[best]), f)) * len(places))
        row = int(self.used[places[best] + 1])
        return Change(chance, row, sizes[best], float(inside[best]))

    def without(self, W: Array) -> Residuals:
        """Return the residuals with errors of white rows W taken up, shape (n_used, m, f)."""
        flat, Q = W.reshape(-1, W.shape[2]), self.Q.reshape(-1, self.Q.shape[2])
        lengths = np.linalg.norm(flat, axis=0)
        flat = flat / np.where(lengths > 0.0, lengths, 1.0)
        U, s, _ = np.linalg.svd(flat - Q @ (Q.T @ flat), full_matrices=False)
        U = U[:, s > RANK_TOLERANCE]
        left = self.left - (U @ (U.T @ self.left.ravel())).reshape(self.left.shape)
        every = np.concatenate((Q, U), axis=1).reshape(*self.left.shape, -1)
        free = self.degrees_of_freedom - U.shape[1]
        return Residuals(self.used, left, every, float((left**2).sum()), free)


def scores(one: Fit, again: Mapping[str, NDArray[np.intp]] | None = None) -> Iterator[Score]:
    """Yield the score tests of a fit.

    Each reading by each term, and each quantity by steps. What all motors have in common is
    clearer in all readings together: each term with the same amplitudes in every reading, and
    their own angles also with amplitudes of their own. And all lengths that grow with time.

    Args:
        one: The fit.
        again: Rows of poses that were measured again and again, among those of the fit: whether
            what was measured there moved with time.
    """
    if not one.problem.weighted or one.degrees_of_freedom < 2 or not one.chi2 > 0.0:
        return
    left, problem = Residuals.of(one), one.problem
    n_readings = problem.reading_columns[-1].stop
    alike: dict[tuple[str, int], Array] = {}
    angles: list[Array] = []
    for column, (name, w) in enumerate(errors_of(one, left.used)):
        terms = [("order", np.linspace(-1.0, 1.0, len(w))[:, None])]
        yield Score(name, "step", *left.step(w))
        if column < n_readings:
            terms += _terms(one, column, left.used)
        for term, b in terms:
            W = w[:, :, None] * b[:, None]
            yield Score(name, term, left.along(W))
            if column < n_readings > 1:
                kind = term, b.shape[1]
                alike[kind] = alike.get(kind, 0.0) + W
                angles += [W] if term == "angle" else []
        for place, rows in (again or {}).items():
            moved = w * _since(left.used, rows)[:, None]
            p_value = left.along(moved[:, :, None])
            yield Score(name, "again", p_value, size=left.size(moved), place=place)
    time = np.linspace(-1.0, 1.0, len(left.used))[:, None]
    yield Score("lengths", "order", left.along((_grown(one, left.used) * time)[:, :, None]))
    for (term, _), W in alike.items():
        yield Score(ALL, term, left.along(W))
    if angles:
        yield Score(ALL, "angle", left.along(np.concatenate(angles, axis=2)))


def errors_of(one: Fit, used: NDArray[np.intp]) -> Iterator[tuple[str, Array]]:
    """Yield each measured quantity and the white rows of its unit error, shape (n_used, m)."""
    problem, stack = one.problem, one.last.stack
    names = iter(problem.quantities)
    for index, (demand, rows, columns) in enumerate(
        zip(stack.demands, problem.leg_rows, problem.reading_columns, strict=True)
    ):
        for place in range(columns.stop - columns.start):
            error = np.zeros((*stack.value.shape, 1))
            error[:, rows, 0] = np.where(
                problem.used[:, index, None], demand.reading[:, :, place], 0.0
            )
            yield next(names), one.last.white(error)[used, :, 0]
    if problem.latent:
        n_legs = problem.leg_rows[-1].stop
        for column in range(problem.observation.measured.shape[1]):
            error = np.zeros((*stack.value.shape, 1))  # residuals are predicted less measured
            error[:, n_legs + column, 0] = -problem.observation.measured[:, column].astype(float)
            yield next(names), one.last.white(error)[used, :, 0]


def _since(used: NDArray[np.intp], rows: NDArray[np.intp]) -> Array:
    """Return the time at rows of one pose about its mean, 1 from first to last; 0 at others."""
    own = np.flatnonzero(np.isin(used, rows))
    when = np.zeros(len(used))
    if len(own) > 1:
        when[own] = (used[own] - used[own].mean()) / np.ptp(used[own])
    return when


def _grown(one: Fit, used: NDArray[np.intp]) -> Array:
    """Return the white rows of legs whose lengths all grow by one part, shape (n_used, m)."""
    J, lengths = one.last.jacobian[used], np.zeros(len(one.unknowns.names))
    for leg, columns in zip(one.problem.legs, one.problem.columns, strict=True):
        own = {name for name, unit in leg.units.items() if unit == "m"} - leg.amplitudes
        long = np.array([name in own for name in leg.parameter_names])
        lengths[columns] = long * one.parameters[columns]
    return np.asarray(J @ lengths)


def _terms(one: Fit, column: int, used: NDArray[np.intp]) -> Iterator[tuple[str, Array]]:
    """Yield what an error of a reading may follow: its angle, the pose, the side of approach."""
    problem = one.problem
    reading = problem.readings[used, column]
    spread = float(np.ptp(reading)) or 1.0
    leg = next(i for i, own in enumerate(problem.reading_columns) if own.start <= column < own.stop)
    unit = problem.legs[leg].reading_units[column - problem.reading_columns[leg].start]
    if unit == "rad":
        turns = [k * reading for k in _HARMONICS]
        yield "angle", np.stack([f(turn) for turn in turns for f in (np.sin, np.cos)], axis=1)
    else:
        along = (reading - reading.mean()) / spread
        yield "angle", np.stack([along**2, along**3], axis=1)
    poses = problem.platform.from_matrices(one.last.state.matrices[used])
    scale = np.ptp(poses, axis=0)
    x = (poses - poses.mean(axis=0)) / np.where(scale > 0.0, scale, 1.0)
    i, j = np.triu_indices(x.shape[1])
    yield "pose", np.concatenate((x, x[:, i] * x[:, j]), axis=1)
    side = np.sign(np.diff(problem.readings[:, column], prepend=np.nan))[used]
    yield "approach", np.nan_to_num(side)[:, None]
