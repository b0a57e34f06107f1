"""The symmetrical workspace of the 6-UPS, and its calibration by symmetry (6-UPS paper)."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.axes3d import Axes3D
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import pincal
from pincal import Element

from . import drawing
from .hexapod_calibration import COMMON, calibration
from .study import Study, at_most, by_rows
from .trials import paired

Array = NDArray[np.float64]
POSE = np.array([[0.5, 0.6, 1.9, 0.2, 0.3, 0.4]])
MATRIX = np.array(
    [
        [0.87816, -0.380722, 0.289629],
        [0.380722, 0.922824, 0.0587108],
        [-0.289629, 0.0587108, 0.955336],
    ]
)
#: What the paper prints: equation, element of the group, leg lengths [m].
PRINTED = (
    ("36", Element(0.0), (2.0096, 2.0358, 2.0740, 2.1695, 2.1457, 1.9637)),
    ("38", Element(2 * np.pi / 3), (2.1457, 1.9637, 2.0096, 2.0358, 2.0740, 2.1695)),
    ("38", Element(4 * np.pi / 3), (2.0740, 2.1695, 2.1457, 1.9637, 2.0096, 2.0358)),
    ("40", Element(0.0, reflection=True), (1.9637, 2.1457, 2.1695, 2.0740, 2.0358, 2.0096)),
)
NONE = pincal.Margins.none()


def run(study: Study) -> None:
    """Check the symmetry of the hexapod, and calibrate it."""
    drawing.parameters(study, "Fig. 1")
    study.progress("sampling the workspace")
    poses = pincal.sample_workspace(study.mechanism, 1_000 if study.quick else 10_000, study.seed)
    equal = _lengths(study, poses[:300])
    study.progress("total orientation workspaces")
    workspaces, kept = _workspaces(study)
    study.progress("what symmetry saves")
    saved = _savings(study)
    study.progress("choosing poses and calibrating")
    outcome = calibration(study, poses)
    first = list(outcome)[1]
    times, verdict = paired(outcome[first][:, 0], outcome[COMMON][:, 0])
    tilts, zyx = (workspaces[name] for name in ("tilt and torsion", "Z-Y-X angles"))
    stay, leave = kept["tilt and torsion"], 1 - kept["Z-Y-X angles"]
    study.claims(
        ("leg lengths, Eqs. 36 to 41", "four decimals", equal, "with θa = π/3 − 0.3"),
        *_equations(study.mechanism),
        (
            "total orientation workspace by tilt and torsion (Fig. 5)",
            "symmetric as the structure",
            f"{tilts.measure:.3f} m² at z = 1.8 m, {100 * stay:.4g} % kept by every element",
            "holds" if stay == 1.0 else "does not hold",
        ),
        (
            "by RPY angles (Fig. 6)",
            "symmetric about one plane only",
            f"{zyx.measure:.3f} m², {100 * leave:.1f} % leave under some element",
            "holds" if leave > 0.0 else "does not hold",
        ),
        (
            "computation reduced by 5/6",
            "six times",
            f"{saved:.2f} times fewer positions",
            "on a grid of radius and bearing; positions on mirror planes have smaller orbits",
        ),
        (
            f"{first} (144 poses) against {COMMON}, position",
            "(not in the paper)",
            f"error of the common ones {times}",
            verdict,
        ),
    )


def _equations(mechanism: pincal.Mechanism) -> list[tuple[str, str, str, str]]:
    """Return what Eqs. 15, 29 and 39 print, and what holds."""
    (place,) = mechanism.platform.transforms(POSE)
    (image,) = mechanism.platform.transforms(
        Element(0.0, reflection=True).poses(mechanism.platform, POSE)
    )
    A = np.array([leg.joints[0].placement.xyz for leg in mechanism.legs])
    b = np.array([leg.point.placement.xyz for leg in mechanism.legs])
    mirrored = (image.apply(b) - A)[::-1] * [1.0, -1.0, 1.0]  # legs i and n − i + 1 change places
    off = {sign: float(np.abs(mirrored - (place.apply(b) + sign * A)).max()) for sign in (-1, 1)}
    lengths = [np.array(printed) for _, _, printed in PRINTED[:3]]
    shifts = [float(np.abs(np.roll(lengths[k], 2) - lengths[k + 1]).max()) for k in (0, 1)]
    turned = {}
    for steps, angle in ((1, np.pi / 3), (2, 2 * np.pi / 3)):
        turn = Rotation.from_euler("z", angle)
        pairs = [(np.roll(points, -steps, axis=0), turn.apply(points)) for points in (A, b)]
        turned[steps] = max(float(np.abs(there - here).max()) for there, here in pairs)
    return [
        (
            "Eq. 15: a_i+1 = R_z(α) a_i, b alike",
            "from each leg to the next",
            f"off by {turned[1]:.2g} m with α = 60°; to the leg after, with α = 120°, by "
            f"at most {at_most(turned[2])} m",
            "holds from leg i to leg i + 2: the joints lie in pairs",
        ),
        (
            "Eqs. 29, 30: leg vectors of the mirrored pose",
            "+ x_b, + y_b, + z_b",
            f"off by {off[1]:.2g} m as printed, by at most {at_most(off[-1])} m with "
            "− x_b, − y_b, − z_b",
            "holds with the sign of Eq. 1: a leg goes from the base point",
        ),
        (
            "Eq. 39: L(u′₁) = P² L(u′₁) = P⁴ L(u₀)",
            "u′₁ twice",
            f"lengths of Eqs. 36, 38 shifted by two legs: u₀ to u′₁ and u′₁ to "
            f"u′₂ off by at most {at_most(max(shifts))} m",
            "holds with u′₂ on the left: L(u′₂) = P² L(u′₁) = P⁴ L(u₀)",
        ),
    ]


def _lengths(study: Study, poses: Array) -> str:
    """Check the example of Eqs. 35 to 41 (Fig. 4), and return how many lengths are as printed."""
    mechanism = study.mechanism
    platform, group = mechanism.platform, pincal.symmetry_group(mechanism)
    R = platform.transforms(POSE).rotation.as_matrix()[0]
    rows, digits = [], []
    for equation, element, printed in PRINTED:
        found = pincal.inverse(mechanism, element.poses(platform, POSE)).readings[0]
        off = float(np.abs(found - printed).max())
        digits += np.abs(found.round(4) - printed).round(4).tolist()
        rows.append((equation, str(element), *(f"{v:.4f}" for v in found), f"{off:.1e}"))
    study.heading("A pose and its images (Eqs. 35 to 41, Fig. 4)")
    study.say(
        f"""The orientation matrix of azimuth 0.2, tilt 0.3 and torsion 0.4 is that of Eq. 35 within
        {np.abs(R - MATRIX).max():.1e}. The platform's half angle is θa = π/3 − 0.3 as in the
        paper's figures; Section 4 prints θa = 0.3."""
    )
    headers = ("equation", "element", *(f"L{i} [m]" for i in range(1, 7)), "off by [m]")
    caption = "Leg lengths at the pose and its images, and how far off they are."
    study.table("eqs_36_to_41_lengths", caption, by_rows(headers, rows), headers)
    before, deviation = pincal.inverse(mechanism, poses).readings, 0.0
    for element, permutation in zip(group.elements, group.permutations, strict=True):
        after = pincal.inverse(mechanism, element.poses(platform, poses)).readings
        deviation = max(deviation, float(np.abs(after[:, list(permutation)] - before).max()))
    study.say(
        f"""On 300 poses of the workspace, all {len(group.elements)} elements of D₆ permute the leg
        lengths (Eqs. 18, 33) within
        {at_most(deviation)} m."""
    )
    figure = Figure(figsize=(13, 8.6), layout="constrained")
    for place, (element, permutation) in enumerate(
        zip(group.elements, group.permutations, strict=True), 1
    ):
        axes = figure.add_subplot(2, 3, place, projection="3d")
        _draw(axes, mechanism, element.poses(platform, POSE), permutation)
        axes.set_title(str(element), fontsize=10)
    study.figure(
        "fig_4_symmetrical_poses",
        "Fig. 4: the pose of Eq. 35 and its five images; each leg keeps the colour of the leg that "
        "was carried to it",
        figure,
    )
    same = sum(d == 0.0 for d in digits)
    return f"{same} of {len(digits)} lengths as printed, the others off by {max(digits):.0e} m"


def _draw(
    axes: Axes3D, mechanism: pincal.Mechanism, pose: Array, permutation: tuple[int, ...]
) -> None:
    """Draw the hexapod in space; leg κ's colour goes where the element carries leg κ."""
    (place,) = mechanism.platform.transforms(pose)
    bases = np.array([leg.joints[0].placement.xyz for leg in mechanism.legs])
    corners = place.apply([leg.point.placement.xyz for leg in mechanism.legs])
    for index, ends in enumerate(zip(bases, corners, strict=True)):
        colour = drawing.COLOURS[permutation.index(index)]
        axes.plot(*np.transpose(ends), "-", color=colour, lw=2.5)
    for ring in (bases, corners):
        axes.plot(*np.vstack((ring, ring[:1])).T, "-", color="0.3", lw=1)
    axes.set(xlim=(-0.9, 0.9), ylim=(-0.9, 0.9), zlim=(0, 2.1))
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set(xticks=(-0.8, 0.0, 0.8), yticks=(-0.8, 0.0, 0.8), zticks=(0.0, 1.0, 2.0))
    axes.set_box_aspect((1.8, 1.8, 2.1), zoom=0.9)


def _workspaces(study: Study) -> tuple[dict[str, pincal.Workspace], dict[str, float]]:
    """Compare tilt and torsion with Z-Y-X angles (Figs. 5, 6)."""
    mechanism, quick = study.mechanism, study.quick
    platform, group = mechanism.platform, pincal.symmetry_group(mechanism)
    step = 0.06 if quick else 0.02
    sides = [f"{name}=-1.5:1.5:{step}" for name in "xy"]
    tilts = pincal.Orientations.of(
        platform, "azimuth [deg]=-170:180:10", "tilt=0:0.6:0.1", "torsion=-0.6:0.6:0.1"
    )
    zyx = pincal.Orientations.of(platform, *(f"{n}=-0.6:0.6:0.1" for n in ("yaw", "pitch", "roll")))
    section = pincal.Grid.of(*sides, "z=1.8")
    coarse = [f"{name}=-2.4:2.4:{0.15 if quick else 0.06}" for name in "xy"]
    space = pincal.Grid.of(*coarse, f"z=0:2.6:{0.2 if quick else 0.05}")
    free, bar = _legs_alone(mechanism)
    found, clouds, alone = {}, {}, {}
    for name, turns in (("tilt and torsion", tilts), ("Z-Y-X angles", zyx)):
        found[name] = pincal.compute_workspace(mechanism, "total-orientation", section, turns, NONE)
        clouds[name] = pincal.compute_workspace(mechanism, "total-orientation", space, turns, NONE)
        alone[name] = pincal.compute_workspace(free, "total-orientation", space, turns, NONE)
    kept = {
        name: min(float(w.test(w.positions @ e.matrix.T).mean()) for e in group.elements)
        for name, w in found.items()
    }
    study.heading("Total orientation workspace (Figs. 5, 6)")
    study.say(
        f"""Legs between 1.6 and 2.6 m, universal joints within ± {bar:.0f}° (the paper does not
        bound them), no margins from singularities, a grid of {1e3 * step:.0f} mm. Tilt and torsion:
        36 azimuths, 7 tilts up to 0.6 rad, 13 torsions within ± 0.6 rad, mapped onto themselves by
        the whole group. Z-Y-X: 13 values of each angle within ± 0.6 rad, mapped by y → −y only."""
    )
    study.table(
        "figs_5_6_workspaces",
        """Section at z = 1.8 m, volume with z ≥ 0, the volume if the legs' lengths alone bound it,
        and the share of the section's cells that every element keeps inside.""",
        {
            "orientations": list(found),
            "cells": [w.count for w in found.values()],
            "area [m²]": [w.measure for w in found.values()],
            "± of the area [m²]": [w.uncertainty for w in found.values()],
            "volume [m³]": [w.measure for w in clouds.values()],
            "± of the volume [m³]": [w.uncertainty for w in clouds.values()],
            "at the rim": [
                "yes" if found[name].cut or clouds[name].cut else "no" for name in found
            ],
            "legs alone [m³]": [w.measure for w in alone.values()],
            "kept by the group": list(kept.values()),
        },
        ["cells", "± of the area [m²]", "at the rim"],
    )
    for number, name in ((5, "tilt and torsion"), (6, "Z-Y-X angles")):
        figure = Figure(figsize=(11, 5), layout="constrained")
        cloud = figure.add_subplot(1, 2, 1, projection="3d")
        points = clouds[name].positions
        cloud.scatter(*points.T, c=points[:, 2], s=2, lw=0, cmap="cividis", rasterized=True)
        cloud.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
        flat = figure.add_subplot(1, 2, 2)
        w = found[name]
        stay = w.test(w.positions @ Element(2 * np.pi / 3).matrix.T)
        drawing.draw_workspace(flat, w, stay.astype(float))
        for colour, label in (
            (drawing.CARRIED, "stays under a rotation by 120°"),
            (drawing.DOMAIN, "leaves"),
        ):
            flat.plot([], [], "s", color=colour, label=label)
        drawing.from_above(flat, "z = 1.8 m")
        drawing.legend(figure)
        study.figure(
            f"fig_{number}_workspace",
            f"Fig. {number}: total orientation workspace by {name}",
            figure,
        )
    return found, kept


def _legs_alone(mechanism: pincal.Mechanism) -> tuple[pincal.Mechanism, float]:
    """Return the mechanism without limits of its universal joints, and their largest, [deg]."""
    turning = [joint for leg in mechanism.legs for joint in leg.joints if joint.turns]
    bar = max(max(-joint.lower, joint.upper) for joint in turning)
    legs = tuple(
        replace(
            leg,
            joints=tuple(
                replace(joint, lower=-np.inf, upper=np.inf) if joint.turns else joint
                for joint in leg.joints
            ),
        )
        for leg in mechanism.legs
    )
    return replace(mechanism, legs=legs), float(np.degrees(bar))


def _savings(study: Study) -> float:
    """Measure what symmetry saves, and return the factor in positions."""
    mechanism = study.mechanism
    turns = pincal.Orientations.of(
        mechanism.platform, "azimuth [deg]=-170:180:10", "tilt=0:0.6:0.05", "torsion=-0.6:0.6:0.05"
    )
    grids = {
        "x, y": pincal.Grid.of("x=-1.5:1.5:0.02", "y=-1.5:1.5:0.02", "z=1.8"),
        "radius, bearing": pincal.Grid.of("radius=0.01:1.5:0.02", "bearing [deg]=0:359:1", "z=1.8"),
    }
    if study.quick:
        grids = {
            "x, y": pincal.Grid.of("x=-1.5:1.5:0.1", "y=-1.5:1.5:0.1", "z=1.8"),
            "radius, bearing": pincal.Grid.of(
                "radius=0.05:1.5:0.1", "bearing [deg]=0:355:5", "z=1.8"
            ),
        }
    rows = []
    seconds, factor = {}, 1.0
    for name, grid in grids.items():
        begin = perf_counter()
        region = pincal.compute_workspace(mechanism, "total-orientation", grid, turns, NONE)
        seconds[f"{name}: with symmetry"] = perf_counter() - begin
        begin = perf_counter()
        parts = np.array_split(np.arange(grid.size), -(-grid.size * len(turns) // 100_000))
        inside = np.concatenate([region.test(grid.at(part)) for part in parts])
        seconds[f"{name}: without symmetry"] = perf_counter() - begin
        factor = grid.size / region.computed
        same, used = bool((region.inside == inside).all()), len(region.elements)
        rows.append((name, used, grid.size, region.computed, factor, "yes" if same else "no"))
    study.heading("What symmetry saves")
    study.say(
        f"""The paper's factor of six needs a grid that the group maps onto itself: radius and
        bearing. A square one is mapped by y → −y only. {len(turns):,} orientations."""
    )
    headers = ("grid", "elements used", "positions", "computed", "factor", "same set")
    caption = "Positions to compute, with the symmetry of grid and mechanism."
    study.table("savings", caption, by_rows(headers, rows))
    study.figure("savings_times", "Time with and without symmetry", drawing.times(seconds))
    return factor
