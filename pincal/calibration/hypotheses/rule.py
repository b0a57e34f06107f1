"""The numbers of the rule by which hypotheses are judged, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rule:
    """What measurements are questioned by, and what explains them."""

    questioned: float = 0.02
    """Misfit over the stroke that was measured, from which measurements are questioned."""
    each: float = 3.0
    """By which each fault that is put right divides the misfit."""
    equal: float = 2.0
    """Times the misfit that the best leaves: cannot be separated from it."""
    precise: float = 1e-4
    """Gaps that are none, of the leg's size."""
    still: float = 1e-3
    """Readings that differ by less hardly move, of a leg's size and [rad]."""
    follows: float = 0.5
    """What is left of readings that follow the nominal ones, of the stroke."""
    past: float = 0.1
    """Past half a turn from home that a joint may be read, [rad]: readings have their cut there."""
    round: float = 0.03
    """Share by which readings may miss a whole multiple of what they should be."""
    scales: tuple[float, ...] = (2.0, 4.0, 10.0, 100.0, 0.5, 0.25, 0.1, 0.01)
    """Times that readings may be too large, where poses do not say it."""
    slip: float = 10.0
    """Times the median that a row misses by, if fewer than one row in so many does."""
    shifts: tuple[int, ...] = (1, -1, 2, -2)
    """Rows by which logs of poses and readings are out of step."""
    chance: float = 1e-5
    """Probability of so much motion as one body by chance, above which it is none."""
    matters: float = 0.25
    """Of the platform's error: a motion of less is not worth a warning."""
    rows: int = 500
    """Enough to judge by."""
    rows_forward: int = 100
    """Enough, where forward kinematics is needed."""
    rows_framed: int = 40
    """Enough, where another frame is tried."""
    rows_moved: int = 200
    """Enough, where the motion of a body is looked for."""
    rows_zeros: int = 12
    """Enough, where zeros of motors are tried in an unknown frame."""
    zeros: int = 12
    """Of a motor that are tried at a time, over a turn first, then over a cell of the last."""
    alignments: int = 30
    """Steps by which frame and target are aligned together."""
    times: int = 3
    """That zeros are tried."""


RULE = Rule()
