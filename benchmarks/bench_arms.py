"""Calibration of a UR10 from full poses: FIGAROH over pincal, on the same data in one process.

FIGAROH (PyPI) is used as its UR10 example has it: ``BaseCalibration`` with ``full_params``, base
and tip frames unknown, ``calc_updated_fkm`` and the residuals of SE(3) as cost, weighted alike for
metres and radians, which is right for the noise here; its parameters reduced to base parameters by
``initialize``, its search by SciPy's Levenberg-Marquardt with differences. pincal's time is all of
``calibrate``: checks, choice of parameters, search, covariance; FIGAROH's the same, ``initialize``
and ``solve``, and that of ``solve`` alone. Both are given 42 parameters, 30 of them observable.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from pathlib import Path
from time import process_time

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

import pincal

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from arms import loaded, urdf

NOISE = pincal.Noise(1e-4, 1e-4, 0.0)
COUNTS = (23, 100, 300, 1000)


def tools() -> tuple[type, Callable[..., np.ndarray], Callable[..., object]]:
    """Return FIGAROH's calibration class, forward kinematics and loader; skip without it."""
    pytest.importorskip("figaroh", reason="pip install figaroh, to compare with it")
    from figaroh.calibration.base_calibration import BaseCalibration
    from figaroh.calibration.calibration_tools import calc_updated_fkm
    from figaroh.tools.robot import load_robot

    class Calibration(BaseCalibration):
        def cost_function(self, var: np.ndarray) -> np.ndarray:
            found = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
            missed = self._compute_logmap_residuals(self.PEE_measured, found)
            return self.apply_measurement_weighting(missed, pos_weight=1.0, orient_weight=1.0)

    return Calibration, calc_updated_fkm, load_robot


def written(folder: Path, arm: pincal.Mechanism, data: pincal.Measurements) -> Path:
    """Write measurements and configuration as FIGAROH reads them; return the latter."""
    poses = arm.platform.transforms(data.poses).as_matrix()
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_euler("xyz")
    header = ",".join(["x1,y1,z1,phix1,phiy1,phiz1", *arm.reading_names])
    table = np.column_stack((poses[:, :3, 3], turns, data.readings))
    np.savetxt(folder / "data.csv", table, "%.17g", ",", header=header, comments="")
    calibration = {
        "enabled": True,
        "parameters": {
            "calibration_level": "full_params",
            "include_non_geometric": False,
            "outlier_threshold": 1.0,
        },
        "kinematics": {"base_frame": "base_link", "tool_frame": "ee_link"},
        "measurements": {
            "markers": [{"name": "tool", "measurable_dof": [True] * 6}],
            "poses": {"base_pose": [0.0] * 6, "tool_pose": [0.0] * 6},
        },
        "data": {
            "source_file": str(folder / "data.csv"),
            "number_of_samples": len(poses),
            "validation_data_file": "",
            "sample_configurations_file": "",
        },
    }
    joints = {"active_joints": list(arm.reading_names)}
    robot = {"name": "ur10", "properties": {"joints": joints}}
    file = folder / "config.yaml"
    file.write_text(yaml.safe_dump({"robot": robot, "tasks": {"calibration": calibration}}))
    return file


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.filterwarnings("ignore")
def test_against_figaroh(
    count: int, tmp_path: Path, ratios: Callable[[str, float, str], None]
) -> None:
    """Time and error at 500 held-out poses; both measured in turn, as time of the processor.

    Time of the processor, so that what else the machine does counts little, and one thread of BLAS
    for both: those of one would wait for work while the other is timed.
    """
    Calibration, forward, load_robot = tools()
    arm = loaded("ur10")
    truth, plan = pincal.disturb(arm, 2e-3, 1), pincal.sample_configurations(arm, count, 0)
    data = pincal.simulate(arm, truth, plan, NOISE, 2).measurements
    file = urdf("ur10_robot.urdf")
    robot = load_robot(str(file), package_dirs=str(file.parents[4]), load_by_urdf=True)
    config = written(tmp_path, arm, data)
    theirs, alone, own, results = [], [], [], None
    one_thread = threadpool_limits(1)
    for _ in range(4):
        start = process_time()
        one = Calibration(robot, str(config))
        one.calib_config["known_baseframe"] = one.calib_config["known_tipframe"] = False
        with redirect_stdout(io.StringIO()):
            one.initialize()
            begin = process_time()
            found = one.solve(enable_logging=False)
        theirs.append(process_time() - start)
        alone.append(process_time() - begin)
        begin = process_time()
        result = pincal.calibrate(arm, data, method="latent", noise=NOISE)
        own.append(process_time() - begin)
        results = one, found, result
    one_thread.restore_original_limits()
    one, found, result = results
    verification = pincal.sample_configurations(arm, 500, 9).readings
    true, mine = (
        arm.platform.transforms(pincal.forward(m, verification).poses).translation
        for m in (truth, result.identified)
    )
    settings = dict(one.calib_config, NbSample=500)
    other = forward(robot.model, robot.data, found.x, verification, settings).reshape(6, 500)[:3].T
    errors = [float(np.sqrt(((p - true) ** 2).sum(axis=1).mean())) for p in (mine, other)]
    print(
        f"\n{count} poses: {np.median(theirs[1:]):.3g} s and {np.median(own[1:]):.3g} s; held out"
    )
    print(f"{1e3 * errors[0]:.5f} mm by pincal, {1e3 * errors[1]:.5f} mm by FIGAROH")
    assert errors[0] <= errors[1] * (1 + 1e-6)
    what, asked = f"UR10, {count} poses", "≥ 20" if count >= 100 else "≥ 5"
    for how, times, wanted in (("", theirs, asked), (", its solve alone", alone, "")):
        ratio = float(np.median(times[1:]) / np.median(own[1:]))
        ratios(f"{what}: FIGAROH over pincal{how}", ratio, wanted)
