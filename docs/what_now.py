"""Runs the commands of what_now.md and writes what they answer: ``python docs/what_now.py``.

The measurements are simulated: four 3-RRRs, each with an error of its own.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import pincal

PAGE = Path(__file__).with_suffix(".md")
_BLOCK = re.compile(r"(<!-- run by what_now\.py -->\n```\n)(.*?)(```\n<!-- end -->)", re.DOTALL)
NOISE = pincal.Noise(2e-5, 5e-5, 2e-5)


def measured(
    truth: pincal.Mechanism, plan: pincal.Plan, noise: pincal.Noise
) -> pincal.Measurements:
    """Return measurements of a machine at poses that the drawing commands."""
    return pincal.simulate("3RRR", truth, plan, noise, seed=1).measurements


def write_measurements(folder: Path) -> None:
    """Write a machine that warms up, one whose encoder slips, two wrong rows, few poor poses."""
    drawing = pincal.load_mechanism("3RRR")
    machine = pincal.disturb(drawing, 1e-3, seed=1)
    poses = pincal.sample_workspace(drawing, 60, seed=1)
    time = np.linspace(0.0, 1.0, len(poses))
    warm = {"temperature": np.round(20.0 + 6.0 * (1.0 - np.exp(-3.0 * time)), 1)}
    basis = pincal.Share(6.0, 20.0)
    legs = []
    for leg in machine.legs:
        grows = tuple(
            (name, pincal.Term(f"{name}_grows", basis, of="temperature")) for name in "lL"
        )
        more = tuple((term.parameter, 4e-5) for _, term in grows)
        legs.append(replace(leg, terms=grows, parameters=(*leg.parameters, *more)))
    warming = replace(machine, legs=tuple(legs))
    data = measured(warming, pincal.Plan(poses, influences=warm), NOISE)
    data.to_csv(folder / "warm.csv", drawing)
    sound = measured(machine, pincal.Plan(poses), NOISE)
    readings = sound.readings.copy()
    readings[30:, 1] += 6e-4
    slipped = replace(sound, readings=readings)
    slipped.to_csv(folder / "slipped.csv", drawing)
    after = {"after": (np.arange(len(poses)) >= 30).astype(float)}
    replace(slipped, influences=after).to_csv(folder / "named.csv", drawing)
    wrong = sound.poses.copy()
    wrong[[11, 40], 0] += 1e-3
    replace(sound, poses=wrong).to_csv(folder / "wrong.csv", drawing)
    small = pincal.disturb(drawing, 5e-4, seed=3)
    few = measured(small, pincal.Plan(poses[:12]), pincal.Noise(1e-3, 1e-3, 0.0))
    few.to_csv(folder / "few.csv", drawing)


def answered(command: str, folder: Path) -> str:
    """Return what a command prints, as it is."""
    line = [sys.executable, "-m", *shlex.split(command)]
    own = {**os.environ, "NO_COLOR": "1", "PYTHONPATH": str(PAGE.parents[1])}
    done = subprocess.run(
        line, cwd=folder, env=own, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )
    text = done.stdout.decode("utf-8")
    return "\n".join(one.rstrip() for one in text.strip("\n").splitlines())


def filled(text: str, folder: Path) -> str:
    """Return the page with the answers of its commands."""

    def block(found: re.Match[str]) -> str:
        commands = [one for one in found[2].splitlines() if one.startswith("$ pincal ")]
        parts = [f"{one}\n{answered(one[2:], folder)}\n" for one in commands]
        return found[1] + "\n".join(parts) + found[3]

    return _BLOCK.sub(block, text)


def main() -> None:
    """Write the page."""
    with TemporaryDirectory() as folder:
        write_measurements(Path(folder))
        PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), Path(folder)), encoding="utf-8")


if __name__ == "__main__":
    main()
