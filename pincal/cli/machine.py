"""``pincal simulate --serve``: a machine that does not exist, at the other end of a TCP line.

A line of JSON says which readings to drive to (``{"leg_1 [mm]": 812.4, …}``), as ``pincal measure
--tcp`` sends it; a line of JSON says what was measured there, or what the trouble was.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from socketserver import StreamRequestHandler, TCPServer

import numpy as np

from pincal import MeasurementError, Mechanism, Noise, PincalError, Plan, Setup, forward, simulate
from pincal.cli.app import say
from pincal.files.columns import columns_of
from pincal.words.units import UNITS, Units

_SLIP = 10.0  # standard deviations


class SimulatedMachine:
    """A true machine, driven by the readings of the nominal one; slips and drifts on request."""

    def __init__(
        self, mechanism: Mechanism, truth: Mechanism, noise: Noise, setup: Setup, units: Units
    ) -> None:
        self.mechanism, self.truth, self.noise, self.setup = mechanism, truth, noise, setup
        self.units = replace(units, names={"m": "mm", "rad": "deg", **units.names})
        self.rng = np.random.default_rng(0)
        self.slips, self.drift = 0.0, 0.0
        """Share of rows in which a number slips by ten standard deviations; [m] along x per row."""
        self._rows = 0

    def measured(self, set_points: Mapping[str, float]) -> dict[str, float]:
        """Return what is measured where the machine is driven to, columns with their units.

        Raises:
            MeasurementError: a reading without a set point, or no such pose.
        """
        points = {name: head for head in set_points for name in [head.partition(" [")[0]]}
        if missing := [name for name in self.mechanism.reading_names if name not in points]:
            raise MeasurementError(f"no set point of {', '.join(missing)}")
        heads = [points[name] for name in self.mechanism.reading_names]
        factors = [UNITS.get(head.partition(" [")[2][:-1], ("", 1.0))[1] for head in heads]
        readings = np.array([[float(set_points[head]) for head in heads]]) * factors
        plan = Plan(forward(self.mechanism, readings).poses)
        if not np.isfinite(plan.poses).all():
            raise MeasurementError("the machine does not reach that")
        plan = replace(plan, readings=readings if self.mechanism.by_readings else None)
        made = simulate(self.mechanism, self.truth, plan, self.noise, self.rng, self.setup)
        if not len(data := made.measurements):
            raise MeasurementError(f"the machine does not reach that: {made.unreachable[0][1]}")
        sigma = self.noise.of_poses(self.mechanism) * (self.rng.random() < self.slips)
        place = self.rng.choice(np.flatnonzero(self.noise.of_poses(self.mechanism)))
        poses, self._rows = data.poses.copy(), self._rows + 1
        poses[0, place] += _SLIP * sigma[place] * self.rng.choice((-1.0, 1.0))
        poses[0, 0] += self.drift * self._rows
        way = "zyx" if self.mechanism.platform.turns == 3 else "tilt-torsion"
        columns = columns_of(self.mechanism, replace(data, poses=poses), way, self.setup)
        written = self.units.written(columns).items()
        return {head: float(np.asarray(values, dtype=float)[0]) for head, values in written}

    def answer(self, line: str) -> str:
        """Return the line that answers one."""
        try:
            return json.dumps(self.measured(json.loads(line)))
        except (PincalError, ValueError, AttributeError) as error:
            return json.dumps({"trouble": str(error)})


def serve(machine: SimulatedMachine, port: int) -> None:
    """Answer on a port of this machine, one caller after another, until Ctrl-C."""

    class Line(StreamRequestHandler):
        def handle(self) -> None:
            for line in self.rfile:
                self.wfile.write(machine.answer(line.decode("utf-8", "replace")).encode() + b"\n")

    TCPServer.allow_reuse_address = True
    with TCPServer(("127.0.0.1", port), Line) as server:
        say(f"127.0.0.1:{server.server_address[1]}")
        server.serve_forever()
