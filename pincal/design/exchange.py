"""Exchange of candidates: one of a set is swapped for another, the swap that gains most, till none.

Fedorov (1972); of robot poses Sun and Hollerbach (2008). Candidates contribute one row or several,
and any criterion says what adding or dropping one changes. What the swaps of a set would gain at
most is one product of matrices for all pairs (``criteria``), and is what they gain where candidates
have one row. All starts are swapped at once. The criteria are concave in M, so that a swap gains
less than it does to first order: a candidate that promises less than the least of a set does not
improve it, and no swap is overlooked by leaving it out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pincal.design.criteria import (
    Criterion,
    Determinant,
    Held,
    Parts,
    Rows,
    grams,
    most_of,
    squares,
)
from pincal.errors import ObservabilityError
from pincal.kinematics.batches import chunks, solve
from pincal.model.checks import ROUNDING
from pincal.types import Array, Index


@dataclass(frozen=True)
class Effort:
    """How far exchanges of candidates go."""

    exchanges: int
    """Between two looks at all candidates, at most."""
    pool: int
    """Candidates that are looked at between two looks at all, and by which they grow."""
    times: int = 4
    """Of those in a set, at least."""
    others: int = 0
    """Any others that are looked at from the first."""
    rounds: int = 1
    """Looks at all, at most."""
    tolerance: float = 0.0
    """Of the bound on det^(1/n), where it ends."""
    at_once: int = 1
    """Of the best sets, those that are exchanged against all candidates."""
    out: int = 24
    """Of a set, those that it would miss least, which are swapped."""
    few: int = 100
    """Swaps of candidates of several rows whose gains are looked at together."""
    weighted: tuple[float, float] = (0.95, 0.3)
    """Share of weights by which starts are drawn, of the first and the last of them; the rest is
    the same for all candidates."""


_STEEP = 300.0  # slopes of sets that lack rank; those of their own are no more than their rows
_LEAST = 1e-15  # of 1, that a set keeps of a direction which only one of it determines
_EFFORT = Effort(exchanges=1000, pool=200, others=50, rounds=100, tolerance=1e-9, at_once=2)


def exchange(
    given: Rows | Parts,
    count: int,
    priority: Array,
    rng: np.random.Generator,
    starts: int,
    criterion: Criterion | None = None,
) -> tuple[Index, float]:
    """Return the best set of candidates found from several starts, and its value.

    The first start rounds the continuous design, the others are drawn by its weights. Swaps run in
    a pool; the best sets are then exchanged against all candidates, the pool growing by those that
    would improve them, until none does.

    Args:
        given: Rows of candidates; or those that each contributes, of each part of the parameters,
            shape (M, r, n); together of rank n.
        count: Size of the set, without repetition.
        priority: By which candidates come first into the pool, shape (M,): the continuous design;
            −∞ for those that do not count.
        rng: Source of the random starts.
        starts: Number of starts.
        criterion: What is made large; log det if not given.

    Raises:
        ObservabilityError: fewer candidates than the set is to have.
    """
    rows = Held(given) if isinstance(given, tuple) else given
    return _Exchange(rows, count, priority, rng, criterion or Determinant()).best(starts)


class _Exchange:
    """Candidates that are looked at, the pool, and the sets among them."""

    def __init__(
        self,
        rows: Rows,
        count: int,
        priority: Array,
        rng: np.random.Generator,
        criterion: Criterion,
    ) -> None:
        """Fill the pool: see ``exchange``.

        Raises:
            ObservabilityError: fewer candidates than the set is to have.
        """
        self.all_rows, self.count, self.rng = rows, count, rng
        self.places = places = np.flatnonzero(np.isfinite(priority))
        if len(places) < count:
            raise ObservabilityError(
                f"{len(places)} of {rows.total} candidates are in reach, no two of them alike; "
                f"{count} are to be chosen"
            )
        self.size = size = max(_EFFORT.pool, _EFFORT.times * count)
        first = places[most_of(priority[places], size)]
        others = places[rng.integers(len(places), size=_EFFORT.others)]
        self.pool = np.union1d(first, others)
        self.priority = priority[self.pool]
        self.rows = rows(self.pool)
        self.scales = tuple(
            np.linalg.norm(one.reshape(-1, one.shape[2]), axis=0) for one in self.rows
        )
        self.rows, self.widths = self._scaled(self.rows), tuple(one.shape[1] for one in self.rows)
        self.grams = tuple(grams(one) for one in self.rows)
        self.criterion, self.lacking = criterion.scaled(self.scales)

    def _scaled(self, rows: Parts) -> Parts:
        return tuple(one / scale for one, scale in zip(rows, self.scales, strict=True))

    def best(self, starts: int) -> tuple[Index, float]:
        """Return the best set found, places of candidates, and its value."""
        sets, best = self._starts(starts), -np.inf
        for _ in range(_EFFORT.rounds):
            sets = np.unique(np.sort(self._swapped(sets), axis=1), axis=0)
            chosen = [
                tuple(part[one].reshape(-1, part.shape[2]) for part in self.rows) for one in sets
            ]
            values = np.array([self.criterion.value(one) for one in chosen])
            order = np.argsort(-values, kind="stable")[: _EFFORT.at_once]
            sets, values = sets[order], values[order]
            if not values[0] > best + _EFFORT.tolerance:
                break
            best = values[0]
            self._grow(sets)
        return np.sort(self.pool[sets[0]]), float(values[0]) + self.lacking

    def _starts(self, starts: int) -> Index:
        """Return the first sets, shape (starts, count): the foremost, and some drawn."""
        weights = np.maximum(self.priority, 0.0)
        share = np.linspace(*_EFFORT.weighted, starts)[:, None]
        even = 1.0 / len(weights)
        chances = share * weights / max(weights.sum(), ROUNDING) + (1.0 - share) * even
        keys = np.log(chances) + self.rng.gumbel(size=(starts, len(weights)))
        keys[0] = self.priority
        return np.argsort(-keys, axis=1, kind="stable")[:, : self.count]

    def _grow(self, sets: Index) -> None:
        """Add the candidates to the pool that would improve sets most, to first order."""
        pairs = zip(self.criterion.turns(_inverses(self.rows, sets)), self.scales, strict=True)
        turns = tuple(turn / scale[:, None] for turn, scale in pairs)
        more = []
        for index, own in enumerate(sets):
            by = tuple(one[index] for one in turns)
            gain = squares(self.all_rows, self.places, by)
            least = gain[np.searchsorted(self.places, self.pool[own])].min()
            better = np.flatnonzero(gain > least)
            more.append(self.places[better[most_of(gain[better], self.size)]])
        others = np.setdiff1d(np.concatenate(more), self.pool)
        rows = self._scaled(self.all_rows(others))
        self.pool = np.concatenate((self.pool, others))
        self.rows = tuple(np.concatenate(pair) for pair in zip(self.rows, rows, strict=True))
        self.grams = tuple(
            np.concatenate((one, grams(more)), axis=1)
            for one, more in zip(self.grams, rows, strict=True)
        )

    def _swapped(self, sets: Index) -> Index:
        """Return sets, shape (S, count), that no swap of one of each for another one improves.

        Where a set without one of it lacks rank, gains are those beside a ridge: some may be
        missed.
        """
        sets = sets.copy()
        active = np.arange(len(sets) if self.count < len(self.pool) else 0)
        for _ in range(_EFFORT.exchanges):
            if not len(active):
                break
            out, into, gain = self._best_swap(sets[active])
            gains = gain > _EFFORT.tolerance
            active = active[gains]
            sets[active, out[gains]] = into[gains]
        return sets

    def _best_swap(self, sets: Index) -> tuple[Index, Index, Array]:
        """Return where in each set a candidate goes, which one comes, and what that gains, (S,)."""
        each, inverse = np.arange(len(sets))[:, None], _inverses(self.rows, sets)
        loss = self.criterion.change(tuple(one[sets] for one in self.rows), inverse, -1.0)
        out = np.argsort(-loss, axis=1, kind="stable")[:, : _EFFORT.out]
        loss, gone = loss[each, out], sets[each, out]
        less = _without(inverse, self.rows, gone)
        factor = self.criterion.most(self.grams, less, self.widths).reshape(*out.shape, -1)
        factor[each[:, :, None], np.arange(out.shape[1])[:, None], sets[:, None]] = 0.0
        factor *= np.exp(loss)[:, :, None]
        if set(self.widths) == {1}:
            flat = factor.reshape(len(sets), -1)
            place = flat.argmax(axis=1)
            gain = np.log(np.maximum(flat[each[:, 0], place], ROUNDING))
        else:
            slope = np.exp(self.criterion.slope(self.grams, inverse).clip(0.0, _STEEP))
            first = slope[:, None] / slope[each, gone][:, :, None]
            place, gain = self._best_of(np.minimum(factor, first, out=factor), less, loss)
        which, into = np.divmod(place, len(self.pool))
        return out[each[:, 0], which], into, gain

    def _best_of(self, most: Array, less: Parts, loss: Array) -> tuple[Index, Array]:
        """Return of each set the swap that gains most, (S,), and the gain: those that may, tried.

        Args:
            most: exp of what swaps gain at most, shape (S, k, P); overwritten.
            less: M⁻¹ of the set without each, shape (S k, n, n).
            loss: What leaving each out changes, shape (S, k).
        """
        each, total = np.arange(len(most)), len(self.pool)
        into = most.argmax(axis=2)  # for each that goes the one that promises most
        gains = self._gains(np.arange(loss.size), into.ravel(), less).reshape(loss.shape) + loss
        which = gains.argmax(axis=1)
        place, best = which * total + into[each, which], gains[each, which]
        np.put_along_axis(most, into[:, :, None], 0.0, axis=2)
        flat = most.reshape(len(most), -1)
        for one in np.flatnonzero(flat.max(axis=1) > np.exp(best)):
            left = np.flatnonzero(flat[one] > np.exp(best[one]))
            left = left[np.argsort(-flat[one, left], kind="stable")]
            for some in (left[part] for part in chunks(len(left), _EFFORT.few)):
                if flat[one, some[0]] <= np.exp(best[one]):
                    break
                which, into = np.divmod(some, total)
                gain = self._gains(one * loss.shape[1] + which, into, less) + loss[one, which]
                top = int(gain.argmax())
                if gain[top] > best[one]:
                    place[one], best[one] = some[top], gain[top]
        return place, best

    def _gains(self, which: Index, into: Index, inverse: Parts) -> Array:
        """Return what candidates change, each added to a choice of its own, shape (m,)."""
        rows = tuple(one[into][:, None] for one in self.rows)
        return self.criterion.change(rows, tuple(one[which] for one in inverse), 1.0)[:, 0]


def _inverses(rows: Parts, sets: Index) -> Parts:
    """Return (Σ Aᵀ A)⁻¹ of sets (S, n, n), with a ridge: a random start may lack rank."""
    found = []
    for one in rows:
        flat = one[sets].reshape(len(sets), -1, one.shape[2])
        M = flat.swapaxes(1, 2) @ flat
        _diagonal(M)[:] += ROUNDING
        found.append(np.asarray(np.linalg.inv(M), np.float64))
    return tuple(found)


def _without(inverse: Parts, rows: Parts, gone: Index) -> Parts:
    """Return (M − Aᵀ A)⁻¹ of sets and candidates that go (S, k), shape (S k, n, n) (Woodbury)."""
    found = []
    for one, candidates in zip(inverse, rows, strict=True):
        A = candidates[gone]
        (count, k, r, n), by = A.shape, one[:, None]
        product = A @ by
        middle = -(product @ A.swapaxes(2, 3)).reshape(-1, r, r)
        _diagonal(middle)[:] += 1.0 + _LEAST
        product = product.reshape(-1, r, n)
        less = product.swapaxes(1, 2) @ solve(middle, product)
        found.append((by + less.reshape(count, k, n, n)).reshape(-1, n, n))
    return tuple(found)


def _diagonal(matrices: Array) -> Array:
    """Return the diagonals of matrices (S, n, n) that lie together in memory, a view, (S, n)."""
    return matrices.reshape(len(matrices), -1)[:, :: matrices.shape[2] + 1]


_EFFORT_accuracy_bound = Effort(exchanges=100, pool=400, rounds=40, tolerance=1e-2)


@dataclass(frozen=True)
class AccurateDesign:
    """Weights on candidates, near the L-optimal ones, and the bound that they prove."""

    weights: Array
    """Shape (M,), sum 1."""
    least: float
    """Lower bound of tr L M⁻¹ of any weights."""

    def efficiency(self, variance: float, count: int) -> float:
        """Return the bound over tr L M⁻¹ of a set of so many candidates, at most 1."""
        return self.least / count / variance


def accurate_design(blocks: Array, C: Array) -> AccurateDesign:
    """Return a nearly L-optimal continuous design and its bound.

    Multiplicative steps wⱼ ← wⱼ √(ψⱼ / Φ) (Fellman 1974) in a pool that grows by the candidates
    that would improve it most.

    Args:
        blocks: Rows that each candidate contributes, shape (M, r, n); together of rank n.
        C: L = C Cᵀ, shape (n, q).
    """
    count, r, n = blocks.shape
    factor = np.asarray(np.linalg.qr(blocks.reshape(-1, n), mode="r"))  # M(1 / count) becomes 1
    rows = np.linalg.solve(factor.T, blocks.reshape(-1, n).T).T.reshape(count, r, n)
    C = np.linalg.solve(factor.T, C)

    def share(pool: Index, weights: Array) -> Array:
        """Return ψⱼ / Φ of all candidates at weights of some, and Φ behind."""
        used = rows[pool].reshape(-1, n)
        M = (used * np.repeat(weights, r)[:, None]).T @ used
        half = np.linalg.solve(M, C)
        psi = ((rows.reshape(-1, n) @ half) ** 2).sum(axis=1).reshape(count, r).sum(axis=1)
        total = float((half * C).sum())
        return np.append(psi / total, total)

    pool, weights = np.arange(count), np.full(count, 1.0 / count)
    least = 0.0
    for _ in range(_EFFORT_accuracy_bound.rounds):
        psi = share(pool, weights)
        least = max(least, psi[-1] / psi[:-1].max())
        if psi[:-1].max() <= 1.0 + _EFFORT_accuracy_bound.tolerance:
            break
        every = np.zeros(count)
        every[pool] = weights
        first = len(pool) == count > _EFFORT_accuracy_bound.pool
        heavy = np.flatnonzero(every > (np.inf if first else 1e-3 / n))
        more = np.argsort(-psi[:-1], kind="stable")[: _EFFORT_accuracy_bound.pool if first else 50]
        pool = np.union1d(heavy, more)
        weights = np.maximum(every[pool], _EFFORT_accuracy_bound.tolerance / len(pool))
        weights = _multiplied(rows[pool], C, weights / weights.sum())
    found = np.zeros(count)
    found[pool] = weights
    return AccurateDesign(found, least)


def _multiplied(rows: Array, C: Array, weights: Array) -> Array:
    """Return weights after multiplicative steps, shape (M,)."""
    n = rows.shape[2]
    flat = rows.reshape(-1, n)
    for _ in range(_EFFORT_accuracy_bound.exchanges):
        M = (flat * np.repeat(weights, rows.shape[1])[:, None]).T @ flat
        half = np.linalg.solve(M, C)
        psi = ((flat @ half) ** 2).sum(axis=1).reshape(len(rows), -1).sum(axis=1)
        weights = weights * np.sqrt(psi / (half * C).sum())
        weights = weights / weights.sum()
    return np.asarray(weights)
