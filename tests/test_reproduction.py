"""A machine is saved only if it reproduces its fit: read back, its residuals are those reported."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import ARMS, loaded
from marks import slow_or_fuzz
from measured import NOISE, seen_from_elsewhere
from test_loads import PAYLOAD, heavy

import pincal

FRAME = pincal.Setup(unknown_frame=True)
TARGET = pincal.Setup(unknown_frame=True, targets={"platform": pincal.Target(unknown=True)})
TIP = pincal.Setup(
    targets={"tip": pincal.Target((0.05, 0.0, 0.05))},
    contacts={"socket": pincal.Contact(dict.fromkeys("ABC"), "tip")},
)
WAYS: dict[str, dict[str, Any]] = {
    "plain": {},
    "noise estimated": {"noise": None},
    "frame": {"setup": FRAME},
    "frame and target": {"setup": TARGET},
    "contacts": {"setup": TIP},
    "per leg": {"method": "per-leg"},
    "rejecting": {"loss": "reject"},
    "tolerance": {"tolerance": {"m": 1e-3, "rad": 1e-3}},
    "harmonics": {"terms": ["harmonics:1"], "tolerance": {"m": 1e-3, "rad": 1e-3}},
    "backlash": {"terms": ["backlash"]},
    "gravity": {"terms": ["gravity"]},
    "gravity in a frame": {"terms": ["gravity"], "setup": FRAME},
    "growth": {"terms": ["growth=temperature"]},
    "held": {"terms": ["polynomial:2"]},
}
MACHINES = ["3PRR", "3PUU", "3RPR", "3RPS", "3RRR", "4cable", "5R", "6PUS", "6RUS"]
MACHINES += ["6UPS", "8cable", "delta", "linear_delta", "ur5"]
QUICK = {
    ("5R", "per leg"),
    ("3PRR", "growth"),
}
#: Each way of two machines, each machine in one or two ways; all others with -m fuzz.
SLOW = [
    case
    for i, way in enumerate(WAYS)
    for shift in (0, 5)
    if (case := (MACHINES[(i + shift) % len(MACHINES)], way)) not in QUICK
]
REST = [case for case in product(MACHINES, WAYS) if case not in {*QUICK, *SLOW}]


def measured(name: str, setup: pincal.Setup) -> tuple[pincal.Mechanism, pincal.Measurements]:
    """Return a machine whose links weigh, and noisy measurements of a machine 1e-3 off."""
    if name in ARMS:
        machine = replace(loaded(name), load=PAYLOAD)
        readings = np.random.default_rng(0).uniform(-1.0, 1.0, (60, len(machine.reading_names)))
        plan = pincal.Plan(pincal.forward(machine, readings).poses, readings=readings)
    else:
        machine = heavy(pincal.load_mechanism(name))
        plan = pincal.sample_configurations(machine, 60, 0)
    if setup.contacts:
        plan = pincal.sample_contacts(machine, setup, 600)[0]
        plan = plan.rows(np.arange(len(plan)) < 60)
    truth = pincal.disturb(machine, 1e-3, 1)
    data = pincal.simulate(machine, truth, plan, NOISE, 0, setup).measurements
    data = replace(data, influences={"temperature": np.linspace(15.0, 25.0, len(data))})
    return machine, seen_from_elsewhere(machine, data) if setup.unknown_frame else data


@pytest.mark.parametrize(("name", "way"), [*sorted(QUICK), *slow_or_fuzz(SLOW, REST)])
def test_what_is_saved_gives_the_residuals_that_are_reported(
    name: str, way: str, tmp_path: Path
) -> None:
    """Predicted less measured readings by the loaded machine's inverse kinematics, to 1e-8.

    At the poses that were estimated, with what its terms follow there; reported are those of first
    order, 1e-9 from them. To 1e-9 all that is reported of legs is compared by ``save``, which
    refuses what differs.
    """
    options = pincal.Options.of(None, **{"noise": NOISE} | WAYS[way])
    machine, data = measured(name, options.setup)
    try:
        result = pincal.calibrate(machine, data, options)
    except pincal.PincalError as error:
        pytest.skip(str(error))
    if not result.converged:
        pytest.skip(result.message)
    result.save(tmp_path / "result")
    saved = pincal.load_mechanism(tmp_path / "result" / "mechanism")
    if saved.by_readings or not options.latent:
        return
    influences = {name: result.measurements.influences[name] for name in saved.influences}
    readings = pincal.inverse(saved, result.poses, influences or None).readings
    for leg, columns in zip(result.legs, saved.reading_columns, strict=True):
        if leg.quantity == "reading":
            off = (readings - data.readings)[np.unique(leg.rows), columns]
            np.testing.assert_allclose(off.ravel(), leg.residuals, rtol=0.0, atol=1e-8)


def test_a_machine_that_does_not_reproduce_its_fit_is_not_saved(tmp_path: Path) -> None:
    """One length a micrometre off: an error that says whose fault it is, and no folder."""
    machine, data = measured("5R", pincal.Setup())
    result = pincal.calibrate(machine, data, noise=NOISE)
    lengths = result.legs[0].identified + np.eye(len(result.legs[0].parameters))[0] * 1e-6
    vars(result)["identified"] = result.identified.with_parameters({"leg_1": lengths})
    with pytest.raises(
        pincal.PincalError, match="fault of pincal, not of the measurements"
    ) as said:
        result.save(tmp_path / "result")
    assert len(str(said.value)) < 300
    assert not (tmp_path / "result").exists()
