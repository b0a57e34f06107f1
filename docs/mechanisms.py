"""Writes the table of mechanisms.md and the pictures: ``python docs/mechanisms.py``."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

import pincal
from pincal.files.mechanism_folders import bundled
from pincal.workspace.criteria import in_workspace

PAGE = Path(__file__).with_suffix(".md")
IMAGES = PAGE.parent / "images"
_POSES = 100
_BLOCK = re.compile(r"(<!-- made by mechanisms\.py -->\n).*?(<!-- end -->)", re.DOTALL)


def counted(mechanism: pincal.Mechanism) -> np.ndarray:
    """Return poses around home that count, shape (N, dof)."""
    if mechanism.by_readings:
        return pincal.sample_configurations(mechanism, _POSES).poses
    platform, rng = mechanism.platform, np.random.default_rng(0)
    size = 0.1 * min(np.linalg.norm(leg.joints[0].placement.xyz) for leg in mechanism.legs)
    spread = [max(size, 0.05) if unit == "m" else 0.25 for unit in platform.units]
    twists = rng.uniform(-1, 1, (_POSES, platform.dof)) * spread
    poses = platform.moved(np.tile(platform.home, (_POSES, 1)), twists)
    return poses[in_workspace(mechanism, poses)]


def n_identified(mechanism: pincal.Mechanism, poses: np.ndarray, lengths_only: bool) -> str:
    """Return how many parameters poses, or the positions of the platform's origin, determine."""
    platform = mechanism.platform
    kept = [f for f, unit in zip(platform.freedoms, platform.units, strict=True) if unit == "m"]
    noise = pincal.Noise(1e-4, 1e-4, 1e-4)  # of readings too: there may be more than freedoms
    rank = pincal.forecast(mechanism, poses, noise, kept if lengths_only else None).rank
    return "all" if rank.rank == rank.n_params else str(rank.rank)


def row(name: str) -> str:
    """Return a mechanism's row of the table."""
    mechanism = pincal.load_mechanism(name)
    poses, platform = counted(mechanism), mechanism.platform
    names = {leg.parameter_names: None for leg in mechanism.legs}
    total = sum(len(leg.parameters) for leg in mechanism.legs)
    turns = "rad" in platform.units
    cells = [
        f"[{name}](#{name.lower()})",
        f"{platform.kind}, {platform.dof}",
        str(len(mechanism.legs)),
        pincal.symmetry_group(mechanism).name,
        "; ".join(", ".join(f"`{p}`" for p in own) for own in names),
        str(total),
        n_identified(mechanism, poses, lengths_only=False),
        n_identified(mechanism, poses, lengths_only=True) if turns else "",
    ]
    return f"| {' | '.join(cells)} |"


def table() -> str:
    """Return the table of all bundled mechanisms."""
    head = (
        "| | platform, freedoms | legs | symmetry | parameters of a leg | in all | identified by "
        "full poses | by positions only |\n|---|---|---|---|---|---|---|---|\n"
    )
    return head + "".join(f"{row(name)}\n" for name in sorted(bundled(), key=str.lower))


def written(page: str) -> str:
    """Return the page with its generated block made anew."""
    return _BLOCK.sub(lambda m: f"{m[1]}{table()}{m[2]}", page)


if __name__ == "__main__":
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    for one in bundled():
        pincal.picture(pincal.load_mechanism(one)).save(IMAGES / f"{one}.svg", force=True)
