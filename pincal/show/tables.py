"""Tables for people: values in the units in which machines are built, mm and mrad."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Group
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from pincal.design.select import Selection
from pincal.design.select_configurations import ConfigurationChoice
from pincal.design.simulate import Accuracy
from pincal.estimation.weak import WeakPair
from pincal.model.mechanism import Mechanism
from pincal.symmetry.detect import SymmetryGroup

#: How small quantities are shown, errors and residuals: in what, and how many of it.
SHOWN = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "1": ("", 1.0)}
_WEAK_LINES = 3  # pairs of parameters in words


def plain_table() -> Table:
    """Return an empty table in the house's looks."""
    return Table(box=box.SIMPLE_HEAD, pad_edge=False)


def titled(title: str, table: Table, caption: str = "") -> Group:
    """Return a table under its title, with a caption as wide as the terminal."""
    return Group(Text(title, style="bold"), table, *([Text(caption + "\n")] if caption else []))


def parameters_table(mechanism: Mechanism) -> Group:
    """Return a table of nominal parameters, one column a leg, or one row where legs are more."""
    names = dict.fromkeys(name for leg in mechanism.legs for name in leg.parameter_names)
    grid = [["parameter", *mechanism.leg_names, "unit"]]
    for name in names:
        values = [leg.nominal_by_name.get(name) for leg in mechanism.legs]
        unit = next(leg.units[name] for leg in mechanism.legs if name in leg.units)
        grid.append([name, *("" if v is None else f"{v:.6f}" for v in values), unit])
    if len(mechanism.legs) > len(names):
        grid = [list(row) for row in zip(*grid, strict=True)]
    header, *rows = grid
    table = plain_table()
    for cell in header:
        table.add_column(cell, justify="left" if cell in ("parameter", "unit") else "right")
    for row in rows:
        table.add_row(*row)
    return titled(f"{mechanism.name}: nominal parameters", table)


def selection_table(selection: Selection) -> Group:
    """Return a table of what a selection gives each leg."""
    table = plain_table()
    for name in ("leg", "poses", "efficiency", "O1", "condition"):
        table.add_column(name, justify="left" if name == "leg" else "right")
    for leg in selection.legs:
        table.add_row(
            leg.leg,
            str(leg.poses),
            f"{leg.efficiency:.4f}",
            f"{leg.indices.O1_per_parameter:.4f}",
            f"{leg.condition:.3g}",
        )
    return titled(
        f"{len(selection.plan.poses)} poses, {selection.protocol} selection from "
        f"{selection.candidates} candidates",
        table,
        "efficiency: (det / det of the continuous D-optimal bound)^(1/n), at most 1; "
        "O1: of the unweighted Jacobian, over the number of parameters",
    )


def accuracy_table(before: Accuracy, after: Accuracy, turns: bool) -> Group:
    """Return a table of platform errors with nominal and with identified parameters."""
    table = plain_table()
    table.add_column("model")
    table.add_column(escape("position rms [mm]"), justify="right")
    table.add_column(escape("worst [mm]"), justify="right")
    if turns:
        table.add_column(escape("orientation rms [mrad]"), justify="right")
    table.add_column("not reached", justify="right")
    for name, one in (("nominal (before)", before), ("identified (after)", after)):
        cells = [f"{1e3 * one.position:.4f}", f"{1e3 * one.worst_position:.4f}"]
        cells += [f"{1e3 * one.orientation:.4f}"] if turns else []
        table.add_row(name, *cells, str(one.unreachable))
    ratio = [f"{before.position / after.position:.1f} times"]
    ratio += [f"{before.worst_position / after.worst_position:.1f} times"]
    ratio += [f"{before.orientation / after.orientation:.1f} times"] if turns else []
    table.add_row("better by", *ratio, "")
    return titled(f"platform error over the workspace, {before.poses} poses", table)


def symmetry_table(group: SymmetryGroup, equivariance: float) -> Group:
    """Return a table of a group's elements, where they carry the legs, and what breaks others."""
    names = group.mechanism.leg_names
    table = plain_table()
    table.add_column("element", no_wrap=True)
    for name in names:
        table.add_column(f"{name} to", no_wrap=True)
    for element, permutation in zip(group.elements, group.permutations, strict=True):
        table.add_row(str(element), *(names[i] for i in permutation))
    lines = [f"readings follow within {equivariance:.2g} (Eq. 5: F(λ q) = λ F(q))"]
    lines += [f"broken: {text}" for text in group.breaks]
    size = f"{group.name}, {len(group.elements)} elements"
    title = f"{group.mechanism.name}: {size}, nominal geometry and modes"
    return titled(title, table, "\n".join(lines))


def weak_in_words(pairs: Sequence[WeakPair], mechanism: Mechanism) -> list[str]:
    """Return which parameters are weakly told apart, and by how much; legs alike in one line."""
    alike: dict[tuple[str, ...], list[WeakPair]] = {}
    for pair in pairs:
        (leg, _, name), (other_leg, _, other) = (
            one.partition(".") for one in (pair.first, pair.second)
        )
        names = (name, other) if leg == other_leg else (pair.first, pair.second)
        alike.setdefault((*names, "" if leg == other_leg else leg), []).append(pair)
    lines = [_weak_line(key[:2], own, mechanism) for key, own in alike.items()]
    if len(lines) > _WEAK_LINES:
        lines[_WEAK_LINES:] = [f"{len(lines) - _WEAK_LINES} more such pairs (--json)"]
    return lines


def _weak_line(names: tuple[str, ...], pairs: Sequence[WeakPair], mechanism: Mechanism) -> str:
    """Return a line on a pair of parameters, of one leg or of several; the weakest counts."""
    worst = pairs[0]
    legs = list(dict.fromkeys(pair.first.partition(".")[0] for pair in pairs))
    every = "every leg" if len(legs) == len(mechanism.legs) > 1 else ", ".join(legs)
    own = worst.second.startswith(f"{worst.first.partition('.')[0]}.")
    if own and len(legs) == 1:
        names = tuple(f"{legs[0]}.{name}" for name in names)
    whose = f" of {every}" if own and len(legs) > 1 else ""
    parts = []
    for place, one in enumerate((worst.first, worst.second)):
        leg, _, name = one.partition(".")
        unit, factor = SHOWN[mechanism.leg(leg).units[name]]
        parts.append(
            f"{' '.join([f'{factor * worst.known[place]:.3g}', unit]).strip()} instead of "
            f"{factor * worst.std[place]:.3g} for {names[place]}"
        )
    return (
        f"{names[0]} and {names[1]}{whose} are weakly told apart, correlation "
        f"{worst.correlation:+.3f}: if the other one were known, the standard error would be "
        f"{' and '.join(parts)}"
    )


def choice_table(mechanism: Mechanism, chosen: ConfigurationChoice) -> Group:
    """Return how good chosen configurations are, and what they tell."""
    table = plain_table()
    for name, justify in (("poses", "right"), ("of", "right"), ("efficiency", "right")):
        table.add_column(name, justify=justify)  # type: ignore[arg-type]
    table.add_column("rank", justify="right")
    table.add_column("measured")
    rank = chosen.rank
    table.add_row(
        str(len(chosen.plan.poses)),
        f"{chosen.candidates:,}",
        f"{chosen.efficiency:.3f}",
        f"{rank.rank} of {rank.n_params}",
        ", ".join(chosen.measured),
    )
    lost = rank.n_params - rank.rank
    words = f"; {lost} directions are not told by any candidate" if lost else ""
    return titled(f"{mechanism.name}: configurations for all parameters together{words}", table)
