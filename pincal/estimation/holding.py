"""Fits in which directions that the measurements do not determine are held, or refused."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import fdtrc

from pincal.errors import ObservabilityError
from pincal.estimation.fit import Fit, robust_fit
from pincal.estimation.observability.identifiable import (
    DIFFER,
    HeldUnknowns,
    hold_unobservable,
    plausible_changes,
)
from pincal.estimation.problem import Linear
from pincal.estimation.system import System
from pincal.model import Mechanism
from pincal.types import Array
from pincal.words.findings import WORDINGS, finding
from pincal.words.wording import filled

_HELD_MOST = 100.0  # how far machines differ over the standard error: such directions are free
_CONTRADICTED = 1e-4  # p-value below which rows contradict that directions are as drawn
_PATIENCE = 75  # steps after which a search may be running away; twice as many if near
_GOOD = 10.0  # reduced χ² up to which a fit says something about its poses


def fit_strictly(mechanism: Mechanism, system: System, start: Linear | None) -> Fit:
    """Return a fit in which no direction is held, even if it is weakly determined.

    Raises:
        ObservabilityError: a direction is unobservable even without noise, or parameters are
            arbitrary (see ``checked``).
    """
    linear = start or system.problem.evaluate(system.problem.start(system.unknowns.start))
    lost = hold_unobservable(mechanism, system, linear, None, 0).groups
    if lost:
        raise _undetermined(lost, (), "--strict")
    fit = robust_fit(system, linear, near=bool(start))
    return checked(mechanism, fit, "--strict")


def checked(mechanism: Mechanism, fit: Fit, option: str) -> Fit:
    """Return the fit; raise if its search ran away, or if its parameters are arbitrary.

    A search ran away where noise moves parameters farther than machines differ from their drawing.
    Parameters are arbitrary if they moved so far, and two standard errors are longer than the
    machine, or more than a radian: no linear covariance holds that far. A fit
    that contradicts a known noise is returned: its rows are wrong, not too few.

    Raises:
        ObservabilityError: see above; without ``option`` parameters would be held.
    """
    legs = fit.problem.legs
    limit = plausible_changes(mechanism, legs)
    std = np.sqrt(np.diagonal(fit.covariance))[: len(limit)]
    moved = np.abs(fit.parameters - np.concatenate([leg.nominal for leg in legs])) > limit
    arbitrary = moved & (2.0 * std > limit / DIFFER) if fit.converged else std > limit
    misfits = fit.system.known and fit.chi2 > _GOOD * max(fit.degrees_of_freedom, 1)
    if misfits or not arbitrary.any():
        return fit
    ids = np.array([id_ for leg in legs for id_ in leg.parameter_ids])
    raise _undetermined((), ids[std > limit].tolist(), option)


def _undetermined(
    groups: Sequence[Sequence[str]], weak: Sequence[str], option: str
) -> ObservabilityError:
    held = finding("undetermined-held", groups=groups, weak=weak)
    return ObservabilityError(
        f"{filled(WORDINGS[held.code].says, held)}. Measure poses that separate them, fix one of "
        f"them, or hold them (leave out {option})"
    )


def fit_holding(
    mechanism: Mechanism, system: System, start: Linear | None, held_before: HeldUnknowns | None
) -> tuple[Fit, HeldUnknowns]:
    """Return a fit with weak directions held, one more each time until it converges; and these.

    The search may ``start`` elsewhere than at nominal; ``held_before`` is what was held at other
    noise, of the same rows.
    """
    held = held_before
    fewest, problem, near = held.fewest if held else 0, system.problem, start is not None
    nominal = held.nominal if held else problem.evaluate(problem.start(system.unknowns.start))
    nominal = replace(nominal, problem=problem)
    begin, farthest = start or nominal, plausible_changes(mechanism, problem.legs)
    bounds = nominal.state.parameters + np.outer((-1.0, 1.0), farthest)
    while True:
        held = hold_unobservable(mechanism, system, nominal, held, fewest)
        if start and not held_before:  # held directions start at nominal
            n = len(start.state.parameters)
            T, values = held.unknowns.map[:n], held.unknowns.start[:n]
            z = np.linalg.lstsq(T, start.state.parameters - values, rcond=None)[0]
            begin = problem.evaluate(replace(start.state, parameters=values + T @ z))
        elif held_before and held.directions.shape[1] > held_before.directions.shape[1]:
            begin, near = nominal, False  # where the additional directions are at nominal
        may_hold_more = held.weakest < _HELD_MOST
        holding = replace(system, unknowns=held.unknowns)
        try:
            if may_hold_more:
                fit = _fit_unless_astray(holding, begin, bounds, near=near)
            else:
                fit = robust_fit(holding, begin, near=near)
            if fit.converged or not may_hold_more:
                return _fit_of_its_axes(mechanism, system, fit, held)
        except ObservabilityError:
            if not may_hold_more:
                raise
        fewest = held.observable.n_free - held.unknowns.n_free + 1


def _fit_of_its_axes(
    mechanism: Mechanism, system: System, fit: Fit, held: HeldUnknowns
) -> tuple[Fit, HeldUnknowns]:
    """Return a fit with fewer directions held, if the rows contradict the others; and what is held.

    Axes that are parallel as drawn leave directions open that the machine's axes determine.
    """
    if not (fit.converged and held.groups):
        return fit, held
    unknowns, state = system.unknowns, fit.last.state
    values = np.concatenate((state.parameters, unknowns.start[len(state.parameters) :]))
    problem = replace(system.problem, first=state)
    ended = replace(system, problem=problem, unknowns=replace(unknowns, start=values))
    fewer = hold_unobservable(mechanism, ended, fit.last, None, held.fewest)
    if (count := fewer.unknowns.n_free - held.unknowns.n_free) <= 0:
        return fit, held
    freed = replace(system, unknowns=fewer.unknowns, max_steps=_PATIENCE)
    refit = robust_fit(freed, fit.last, near=True)
    freedoms, least = max(refit.degrees_of_freedom, 1), float(np.finfo(float).tiny)
    gain = max(fit.chi2 - refit.chi2, 0.0) / max(refit.chi2, least) * freedoms / count
    contradicted = fdtrc(count, freedoms, gain) < _CONTRADICTED
    refit = replace(refit, first=fit.first)
    return (refit, fewer) if refit.converged and contradicted else (fit, held)


def _fit_unless_astray(system: System, begin: Linear, bounds: Array, *, near: bool) -> Fit:
    """Return a fit; unfinished if its search soon leaves the parameters' bounds, (2, n_params)."""
    patience = _PATIENCE * (1 + near)
    fit = robust_fit(replace(system, max_steps=patience), begin, near=near)
    if fit.converged or (fit.parameters < bounds[0]).any() or (fit.parameters > bounds[1]).any():
        return fit
    return replace(robust_fit(system, fit.last, near=near), first=fit.first)
