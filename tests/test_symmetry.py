"""Dihedral elements, carried legs, generated and detected mechanisms."""

from __future__ import annotations

import io
import re
import runpy
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from marks import quick
from measured import workspace
from moved import equivariance
from rich.console import Console
from scipy.spatial.transform import Rotation

import pincal
from pincal.files.mechanism_folders import bundled
from pincal.show.tables import symmetry_table
from pincal.symmetry.carry import canonical, carry
from pincal.symmetry.elements import isometry

ROBOTS = Path(__file__).parents[1] / "robots"


def dihedral(n: int) -> list[pincal.Element]:
    """Return the 2n elements of D_2n."""
    return [*pincal.cyclic(n), *(pincal.Element.mirror(np.pi * k / n) for k in range(n))]


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_group_axioms(n: int) -> None:
    """D_2n is closed, has an identity and inverses, and composes as its matrices do."""
    group = dihedral(n)
    matrices = [g.matrix for g in group]
    for g, h in product(group, group):
        composed = g.after(h)
        np.testing.assert_allclose(composed.matrix, g.matrix @ h.matrix, atol=1e-12)
        assert sum(np.allclose(composed.matrix, m, atol=1e-9) for m in matrices) == 1
    for g in group:
        np.testing.assert_allclose(g.after(g.inverse()).matrix, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("kind", ["planar", "point"])
def test_action_on_poses_is_an_action(kind: str) -> None:
    """Acting by g h is acting by h, then by g; the inverse undoes it."""
    rng = np.random.default_rng(0)
    platform = pincal.Platform(kind, home=(0.0,) * (3 if kind == "planar" else 2))
    poses = rng.uniform(-1, 1, (20, platform.dof))
    for g, h in product(dihedral(3), dihedral(3)):
        twice = g.poses(platform, h.poses(platform, poses))
        np.testing.assert_allclose(g.after(h).poses(platform, poses), twice, atol=1e-14)
        back = g.inverse().poses(platform, g.poses(platform, poses))
        np.testing.assert_allclose(back, poses, atol=1e-14)


def test_the_group_found_on_the_3rrr_is_c3() -> None:
    """Three rotations; the mirrors fail because all dyads bend to the same side."""
    group = pincal.symmetry_group(pincal.load_mechanism("3RRR"))
    assert [str(e) for e in group.elements] == ["identity", "rotation by 120°", "rotation by 240°"]
    assert group.permutations == ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    ((difference, mirrors),) = group.breaks.items()
    assert "'elbow'" in difference
    assert len(mirrors) == 3
    assert all(element.reflection for element in mirrors)


def test_the_group_found_on_the_5r_is_the_mirror() -> None:
    """Identity and the mirror across the base line's middle; half a turn fails."""
    group = pincal.symmetry_group(pincal.load_mechanism("5R"))
    assert [str(e) for e in group.elements] == ["identity", "mirror at azimuth 90°"]
    assert group.permutations == ((0, 1), (1, 0))
    (broken,) = group.breaks.values()
    assert {str(element) for element in broken} == {"rotation by 180°", "mirror at azimuth 0°"}


def test_readings_are_equivariant(
    mechanism: pincal.Mechanism, candidates: dict[str, np.ndarray]
) -> None:
    """F(λ q) = λ F(q) on 1000 poses to rounding (3-RRR paper, Eq. 5)."""
    poses = candidates[mechanism.name][:1000]
    assert equivariance(pincal.symmetry_group(mechanism), poses) < 1e-12


@pytest.mark.parametrize("name", ["k", "gamma"])
def test_sensors_break_no_symmetry(mechanism: pincal.Mechanism, name: str) -> None:
    """Gains and offsets change readings, not how legs move."""
    value = mechanism.legs[1].nominal_by_name[name] + 1e-3
    changed = mechanism.with_parameters({"leg_2": {name: value}})
    group = pincal.symmetry_group(changed)
    assert group.permutations == pincal.symmetry_group(mechanism).permutations


@pytest.mark.parametrize("name", ["l", "L"])
def test_a_disturbed_parameter_breaks_the_group(mechanism: pincal.Mechanism, name: str) -> None:
    """1e-3 more on one parameter of leg 2 leaves the identity, and what differs is said."""
    value = mechanism.legs[1].nominal_by_name[name] + 1e-3
    group = pincal.symmetry_group(mechanism.with_parameters({"leg_2": {name: value}}))
    assert [str(e) for e in group.elements] == ["identity"]
    broken = {e: text for text, elements in group.breaks.items() for e in elements}
    for element in pincal.symmetry_group(mechanism).elements[1:]:
        reason = next(text for e, text in broken.items() if e.equals(element))
        assert reason.startswith("position of ")
    with pytest.raises(pincal.SymmetryError, match=r"carries leg_1 onto leg_2 \((rotation|mirror)"):
        group.carriers()


def test_a_deviation_within_tolerance_is_forgiven(mechanism: pincal.Mechanism) -> None:
    """A tolerance of 1e-2 finds the group of a mechanism disturbed by 1e-4."""
    disturbed = pincal.disturb(mechanism, 1e-4, seed=1)
    assert len(pincal.symmetry_group(disturbed).elements) == 1
    found = pincal.symmetry_group(disturbed, tolerance=1e-2).elements
    assert len(found) == len(pincal.symmetry_group(mechanism).elements)


@pytest.mark.parametrize("n", [2, 3, 4, 5, 8])
def test_generated_mechanisms_are_detected_as_generated(n: int) -> None:
    """A leg carried by n rotations gives a mechanism whose group is those rotations."""
    leg = pincal.load_mechanism("3RRR").legs[0]
    platform = pincal.Platform("planar", (0.0, 0.0, 0.0))
    mechanism = pincal.generate(f"{n}RRR", leg, pincal.cyclic(n), platform)
    group = pincal.symmetry_group(mechanism)
    assert len(group.elements) == n
    assert not any(e.reflection for e in group.elements)
    carried = {p[0] for p in group.permutations}
    assert carried == set(range(n))


def rounded(text: str) -> str:
    """Return a text with its numbers rounded to 9 digits: libraries differ in the last ones."""
    return re.sub(r"-?\d+\.\d+(e-?\d+)?", lambda m: f"{float(m[0]):.9g}", text)


@pytest.mark.parametrize("name", sorted(bundled()))
def test_bundled_robots_are_generated_not_typed(name: str, tmp_path: Path) -> None:
    """Running a robot's definition writes the files that are bundled."""
    made = runpy.run_path(str(ROBOTS / f"{name}.py"))["mechanism"]()
    made.save(tmp_path / "made")
    folder = ROBOTS / name
    bundled = sorted(path.name for path in folder.iterdir())
    assert bundled == sorted(path.name for path in (tmp_path / "made").iterdir())
    for file in bundled:
        text = (folder / file).read_text()
        assert rounded((tmp_path / "made" / file).read_text()) == rounded(text)


def test_generated_parameters_are_the_papers() -> None:
    """3-RRR: γ of Eq. 19, β at -150°, -30°, 90°; 5R: leg 2 reads k(π - ψ) + γ (Eq. 9)."""
    legs = pincal.load_mechanism("3RRR").legs
    np.testing.assert_allclose(
        [leg.nominal_by_name["gamma"] for leg in legs], [np.pi / 6, 5 * np.pi / 6, -np.pi / 2]
    )
    for name in ("beta", "beta_b"):
        degrees = np.degrees([leg.nominal_by_name[name] for leg in legs])
        np.testing.assert_allclose(degrees, [-150, -30, 90])
    first, second = pincal.load_mechanism("5R").legs
    assert (second.nominal_by_name["A_x"], first.nominal_by_name["A_x"]) == (0.5, -0.5)
    five_bar = pincal.load_mechanism("5R").with_parameters({second.name: {"k": 1.3, "gamma": 0.2}})
    solved = pincal.inverse(five_bar, workspace("5R", 5))
    theta = solved.joints[second.name][:, second.active[0]]
    np.testing.assert_allclose(solved.readings[:, 1], 1.3 * (np.pi - theta) + 0.2)


def test_canonical_form_of_a_leg_is_the_same_leg(mechanism: pincal.Mechanism) -> None:
    """A leg written with turned and reversed joints has the same readings, and one canonical form.

    The leg carried by an element and back again is the leg itself.
    """
    for leg, element in product(mechanism.legs, dihedral(4)):
        away = carry(leg, element)
        back = carry(away, element.inverse())
        home = canonical(leg)
        np.testing.assert_allclose(back.nominal, home.nominal, atol=1e-12)
        np.testing.assert_allclose(back.home, home.home, atol=1e-12)
        assert back.sensors[0].direction == home.sensors[0].direction


def test_carried_leg_reads_the_same_at_carried_poses(mechanism: pincal.Mechanism) -> None:
    """Any element, in the group or not: the carried leg's readings at carried poses are equal."""
    platform = mechanism.platform
    poses = np.array(platform.home) + np.random.default_rng(0).uniform(
        -0.1, 0.1, (20, platform.dof)
    )
    for leg, element in product(mechanism.legs, dihedral(5)):
        carried = carry(leg, element)
        one = replace(mechanism, legs=(leg,))
        other = replace(mechanism, legs=(carried,))
        before = pincal.inverse(one, poses).readings
        after = pincal.inverse(other, element.poses(platform, poses)).readings
        assert np.isfinite(before).all()
        np.testing.assert_allclose(after, before, atol=1e-12)


@pytest.mark.parametrize("name", ["6UPS", "6RUS"])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_leg_is_carried_by_any_isometry(name: str, side: float) -> None:
    """Base and platform turned, mirrored and shifted at random: readings follow, numbers stay."""
    mechanism, rng = pincal.load_mechanism(name), np.random.default_rng(7)
    turns = side * Rotation.random(2, rng=rng).as_matrix()
    element = pincal.Element.of(*map(isometry, turns, rng.uniform(-1.0, 1.0, (2, 3))))
    legs = tuple(carry(leg, element) for leg in mechanism.legs)
    home = element.poses(mechanism.platform, np.array([mechanism.platform.home]))[0]
    platform = replace(mechanism.platform, home=tuple(home.tolist()))
    poses = pincal.sample_configurations(mechanism, 10).poses
    before = pincal.inverse(mechanism, poses).readings
    carried = replace(mechanism, legs=legs, platform=platform)
    after = pincal.inverse(carried, element.poses(platform, poses)).readings
    np.testing.assert_allclose(after, before, atol=1e-12)
    sizes = [[np.abs(leg.nominal) for leg in machine.legs] for machine in (mechanism, carried)]
    np.testing.assert_allclose(sizes[1], sizes[0], atol=1e-12)


def test_a_leg_that_misses_home_is_refused() -> None:
    """Generating from a leg that does not reach the home pose raises."""
    leg = pincal.load_mechanism("3RRR").legs[0]
    with pytest.raises(pincal.MechanismError, match="does not reach the home pose"):
        pincal.generate("far", leg, pincal.cyclic(3), pincal.Platform("planar", (9.0, 0.0, 0.0)))


def on_its_mirror_plane(n: int) -> pincal.Mechanism:
    """Return n universal-prismatic legs, each in a plane of symmetry of the full D_2n."""
    leg = pincal.load_mechanism("6UPS").legs[0]
    leg = leg.with_parameters({"beta": 0.0, "beta_b": 0.0})
    platform = pincal.Platform("spatial", (0.0, 0.0, 2.0, 0.0, 0.0, 0.0))
    return pincal.generate(f"{n}UPS", leg, pincal.cyclic(n), platform)


@pytest.mark.parametrize("n", quick(5, range(2, 9)))
def test_all_2n_elements_of_generated_mechanisms_are_found(n: int) -> None:
    """Rotations and mirrors, and each element carries the legs as it carries their bases."""
    mechanism = on_its_mirror_plane(n)
    group = pincal.symmetry_group(mechanism)
    assert len(group.elements) == 2 * n
    assert sum(e.reflection for e in group.elements) == n
    bases = np.array([leg.joints[0].placement.xyz for leg in mechanism.legs])
    for element, permutation in zip(group.elements, group.permutations, strict=True):
        np.testing.assert_allclose(bases @ element.matrix.T, bases[list(permutation)], atol=1e-12)


@pytest.mark.parametrize("n", quick(1, [3, 4, 5]))
@pytest.mark.parametrize("name", ["OA", "ob"])
def test_a_length_off_by_a_millimetre_costs_what_moves_its_leg(n: int, name: str) -> None:
    """Leg 2 longer by 1e-3: what stays is the mirror that leaves it; the others say why."""
    exact = on_its_mirror_plane(n)
    value = exact.legs[1].nominal_by_name[name] + 1e-3
    group = pincal.symmetry_group(exact.with_parameters({"leg_2": {name: value}}))
    assert {str(e) for e in group.elements} == {"identity", f"mirror at azimuth {360 / n:.4g}°"}
    assert sum(map(len, group.breaks.values())) == 2 * n - 2
    assert all("position of " in text and ", by 1 mm" in text for text in group.breaks)


def test_limits_break_a_symmetry_too() -> None:
    """A leg of less stroke is another leg."""
    exact = on_its_mirror_plane(3)
    first = exact.legs[0]
    joints = tuple(replace(j, upper=2.5) if j.kind == "prismatic" else j for j in first.joints)
    shorter = replace(exact, legs=(replace(first, joints=joints), *exact.legs[1:]))
    group = pincal.symmetry_group(shorter)
    assert [str(e) for e in group.elements] == ["identity", "mirror at azimuth 0°"]
    (difference,) = group.breaks
    assert "limits of " in difference
    assert ", by 100 mm" in difference
    counts = [len(pincal.symmetry_group(shorter, t).elements) for t in (0.04, 0.06)]
    assert counts == [2, 6]  # 0.1 m of a machine of 2 m


def five_bar(**changes: object) -> pincal.Leg:
    """Return leg 1 of the five-bar without joint limits, with changes of its fields."""
    leg = pincal.load_mechanism("5R").legs[0]
    joints = tuple(
        replace(joint, lower=-2 * np.pi, upper=2 * np.pi) if joint.kind != "fixed" else joint
        for joint in leg.joints
    )
    return replace(leg, **({"joints": joints} | changes))


def test_a_coaxial_five_bar_has_its_mirror() -> None:
    """Legs that start in the same place are told apart by the side on which they bend."""
    leg = five_bar().with_parameters({"A_x": 0.0, "l": 0.5, "L": 1.2})
    platform = pincal.Platform("point", (0.0, 1.1))
    elements = (pincal.Element(0.0), pincal.Element.mirror(np.pi / 2))
    group = pincal.symmetry_group(pincal.generate("coaxial", leg, elements, platform))
    assert [str(e) for e in group.elements] == ["identity", "mirror at azimuth 90°"]
    assert group.permutations == ((0, 1), (1, 0))


def test_legs_above_each_other_do_not_repeat_elements() -> None:
    """Three legs at one azimuth have the identity and one mirror, each once."""
    first = pincal.load_mechanism("6UPS").legs[0].with_parameters({"beta": 0.0, "beta_b": 0.0})
    legs = tuple(
        replace(
            first.with_parameters({"alpha": np.pi / 2 - 0.2 * index}),
            name=f"leg_{index + 1}",
            point=replace(first.point, name=f"point_{index + 1}"),
        )
        for index in range(3)
    )
    platform = pincal.Platform("translational", (0.0, 0.0, 2.0))
    group = pincal.symmetry_group(pincal.Mechanism("stack", platform, legs))
    assert [str(e) for e in group.elements] == ["identity", "mirror at azimuth 0°"]


def test_what_breaks_elements_is_said_once_and_can_be_followed() -> None:
    """One sentence a reason: which elements, which legs, in what, by how much."""
    group = pincal.symmetry_group(pincal.load_mechanism("3RRR"))
    mirrors = "mirror at azimuth 30°, mirror at azimuth 90° and mirror at azimuth 150°"
    (line,) = str(group).splitlines()[1:]
    assert line == (
        f"  no symmetry: {mirrors}: leg_1, leg_2 and leg_3 differ from what is carried there in "
        "position of 'elbow', by 1500 mm"
    )


def test_a_narrow_terminal_loses_no_letter() -> None:
    """Elements and legs of eight cables, in 80 columns."""
    group = pincal.symmetry_group(pincal.load_mechanism("8cable"))
    out = io.StringIO()
    Console(file=out, width=80).print(symmetry_table(group))
    words = set(out.getvalue().split())
    assert {"270°", "135°", *group.mechanism.leg_names} <= words


@pytest.mark.slow
def test_a_leg_that_branches_is_carried_branch_by_branch() -> None:
    """Six rods have the delta's group, D6, whose mirrors swap a leg's rods; readings follow.

    One longer rod leaves the identity; two rods of one leg alike longer, the mirror through it.
    """
    mechanism = pincal.load_mechanism("six_rod_delta")
    group = pincal.symmetry_group(mechanism)
    assert group.name == pincal.symmetry_group(pincal.load_mechanism("delta")).name == "D6"
    assert group.permutations[1] == (1, 2, 0)
    poses = pincal.sample_configurations(mechanism, 40, seed=1).poses
    assert equivariance(group, poses) < 1e-9
    leg = mechanism.legs[0].nominal_by_name
    longer = {name: leg[name] + 1e-3 for name in ("L_1", "L_2")}
    one = pincal.symmetry_group(mechanism.with_parameters({"leg_1": {"L_1": longer["L_1"]}}))
    assert [str(element) for element in one.elements] == ["identity"]
    both = pincal.symmetry_group(mechanism.with_parameters({"leg_1": longer}))
    assert [str(element) for element in both.elements] == ["identity", "mirror at azimuth 0°"]
