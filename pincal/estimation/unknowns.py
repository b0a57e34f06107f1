"""What is identified: all parameters as a linear map of the free ones.

Fixed parameters, parameters tied to one value, and gauge freedoms are one thing: φ = φ₀ + T z
with fewer z than φ. Priors are rows beside those of the measurements.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import qr

from pincal.errors import MeasurementError
from pincal.model.checks import ROUNDING
from pincal.model.leg import Leg
from pincal.types import Array

_SMALLEST_PRIOR = 1e-15  # [m], [rad] or [1], below which rounding is larger
_TIED_WITHIN = 0.1  # relative or [m], [rad]: nominal values that are tied differ by no more


@dataclass(frozen=True)
class Unknowns:
    """All parameters of a problem, leg by leg, then external ones, and which are free."""

    owners: tuple[str, ...]
    """Leg of each parameter; tracker or target of an external one, length n."""
    names: tuple[str, ...]
    """Length n."""
    start: Array
    """φ₀: nominal values, tied ones at their mean; zero for external ones, shape (n,)."""
    map: Array
    """T, shape (n, n_free)."""
    priors: Array
    """Standard deviations of the nominal values, infinite where there is none, shape (n,)."""
    nominal: Array
    """Shape (n,)."""
    free_labels: tuple[str, ...]
    """Ids of the free parameters, length n_free."""

    @property
    def labels(self) -> tuple[str, ...]:
        """Ids such as ``leg_1.l``, length n."""
        return tuple(map(".".join, zip(self.owners, self.names, strict=True)))

    @property
    def n_free(self) -> int:
        """Number of free unknowns."""
        return self.map.shape[1]

    def prior_rows(self, parameters: Array) -> tuple[Array, Array]:
        """Return residuals of the priors in standard deviations and their Jacobian in z.

        By parameters of the legs, shape (n_params,): external ones have no priors.
        """
        known = np.flatnonzero(np.isfinite(self.priors))
        sigma = self.priors[known]
        return (parameters[known] - self.nominal[known]) / sigma, self.map[known] / sigma[:, None]

    def free_rows(self, J: Array) -> Array:
        """Return rows of all unknowns, shape (…, n), by the free ones, those of priors below."""
        _, prior = self.prior_rows(self.start)
        return np.concatenate((J.reshape(-1, J.shape[-1]) @ self.map, prior))

    def held(self, directions: Array) -> Unknowns:
        """Return the unknowns with g · z = 0 from now on, for directions g of shape (k, n_free)."""
        lost = len(directions)
        _, R, order = qr(directions, mode="economic", pivoting=True)
        follow, lead = order[:lost], np.sort(order[lost:])
        place = np.argsort(order)
        basis = np.zeros((len(order), len(lead)))
        basis[lead, np.arange(len(lead))] = 1.0
        basis[follow] = -np.linalg.solve(R[:, :lost], R[:, place[lead]])
        T = self.map @ basis
        T[np.abs(T) <= ROUNDING * np.abs(T).max(axis=0, initial=0.0)] = 0.0
        return replace(self, map=T, free_labels=tuple(self.free_labels[i] for i in lead))

    def part(self, legs: Sequence[str]) -> Unknowns:
        """Return the unknowns of some legs."""
        rows = np.flatnonzero(np.isin(self.owners, list(legs)))
        columns = np.flatnonzero((self.map[rows] != 0.0).any(axis=0))
        return Unknowns(
            owners=tuple(self.owners[i] for i in rows),
            names=tuple(self.names[i] for i in rows),
            start=self.start[rows],
            map=self.map[np.ix_(rows, columns)],
            priors=self.priors[rows],
            nominal=self.nominal[rows],
            free_labels=tuple(self.free_labels[i] for i in columns),
        )


def unknowns(
    legs: Sequence[Leg],
    external: Sequence[str] = (),
    *,
    fixed: Iterable[str] = (),
    tied: Iterable[str] = (),
    priors: Mapping[str, float] | None = None,
) -> Unknowns:
    """Return the unknowns of some legs.

    A parameter is said as ``l``, of every leg that has one, or as ``leg_1.l``.

    Args:
        legs: The legs, at their nominal values.
        external: Ids of external unknowns.
        fixed: Parameters held at their nominal values.
        tied: Parameters that have one value for all legs.
        priors: Standard deviations of nominal values, [m], [rad] or [1].

    Raises:
        MeasurementError: an unknown name, a tie of one leg's parameter, a parameter that is both
            fixed and tied, or a standard deviation that is not above zero.
    """
    pairs = [(leg.name, name) for leg in legs for name in leg.parameter_names]
    nominal = np.concatenate([*(leg.nominal for leg in legs), np.zeros(len(external))])
    n, start = len(nominal), nominal.copy()
    held = {i for name in fixed for i in _places(pairs, name)}
    if len(held) == len(pairs):
        raise MeasurementError("every parameter is fixed; leave one of them to be identified")
    groups, bound = list[list[int]](), set(held)
    for name in tied:
        places = _tied_places(pairs, name, nominal)
        if fixed_too := bound & set(places):
            message = f"{pairs[fixed_too.pop()][1]!r} is both fixed and tied; choose one"
            raise MeasurementError(message)
        bound |= set(places)
        start[places] = nominal[places].mean()
        groups.append(places)
    groups = sorted([*groups, *([i] for i in range(n) if i not in bound)])
    T = np.zeros((n, len(groups)))
    for column, places in enumerate(groups):
        T[places, column] = 1.0
    sigmas = _prior_sigmas(pairs, priors or {}, n)
    sigmas[list(held)] = np.inf
    ids = [*map(".".join, pairs), *external]
    more = [f" (tied to {len(places) - 1} more)" if len(places) > 1 else "" for places in groups]
    owners, names = zip(*pairs, *(id_.split(".") for id_ in external), strict=True)
    free_labels = tuple(ids[places[0]] + tie for places, tie in zip(groups, more, strict=True))
    return Unknowns(owners, names, start, T, sigmas, nominal, free_labels)


def _tied_places(pairs: list[tuple[str, str]], name: str, nominal: Array) -> list[int]:
    """Return the places of parameters that are tied, of which several legs must have one alike."""
    places = _places(pairs, name)
    if len(places) < 2 or "." in name:
        raise MeasurementError(
            f"{name!r} cannot be tied; give the name of a parameter that several legs have, "
            "such as 'l'"
        )
    if np.ptp(nominal[places]) > _TIED_WITHIN * max(1.0, float(np.abs(nominal[places]).max())):
        raise MeasurementError(
            f"{name!r} cannot be tied: its nominal values differ from leg to leg by up to "
            f"{np.ptp(nominal[places]):.3g}"
        )
    return places


def _prior_sigmas(pairs: list[tuple[str, str]], priors: Mapping[str, float], count: int) -> Array:
    """Return standard deviations of nominal values, infinite where there is none, (count,)."""
    sigmas = np.full(count, np.inf)
    for name, sigma in priors.items():
        if not _SMALLEST_PRIOR <= sigma < np.inf:
            raise MeasurementError(
                f"the prior of {name!r} is {sigma:g}; expected a standard deviation above 0, at "
                f"least {_SMALLEST_PRIOR:g} (for a parameter that is known exactly, fix it)"
            )
        sigmas[_places(pairs, name)] = sigma
    return sigmas


def _places(pairs: list[tuple[str, str]], wanted_name: str) -> list[int]:
    """Return the places of the parameters that a name means."""
    leg, _, name = wanted_name.rpartition(".")
    places = [i for i, pair in enumerate(pairs) if pair[1] == name and leg in ("", pair[0])]
    if not places:
        known = dict.fromkeys(name for _, name in pairs)
        legs = dict.fromkeys(leg for leg, _ in pairs)
        raise MeasurementError(
            f"no parameter {wanted_name!r}; expected one of {', '.join(known)}, or of one leg as "
            f"'{next(iter(legs))}.{next(iter(known))}'"
        )
    return places
