"""Pictures look as they did when they were last looked at, by perceptual hash."""

from __future__ import annotations

import pytest
from picture_hashes import SAME, apart, difference_hash, kept, pictures

import pincal
from pincal.show.style import figure_bytes

KEPT = kept()


def test_all_pictures_are_kept() -> None:
    """The file holds a hash of each picture and of nothing else."""
    assert list(KEPT) == list(pictures())


@pytest.mark.slow
@pytest.mark.parametrize("name", KEPT)
def test_pictures_look_as_they_did(name: str) -> None:
    """A picture is the one kept to a few bits; ``python tests/picture_hashes.py`` keeps others."""
    assert apart(difference_hash(pictures()[name]()), KEPT[name]) <= SAME


def test_hashes_tell_pictures_apart() -> None:
    """Any two of the pictures differ by more than is let pass."""
    hashes = list(KEPT.values())
    apart_by = [apart(a, b) for i, a in enumerate(hashes) for b in hashes[:i]]
    assert min(apart_by) > 2 * SAME


def test_hashes_see_a_changed_machine_and_not_a_rounding() -> None:
    """A leg's link half as long is seen; a base point moved by 1e-5 of the machine is not."""
    mechanism = pincal.load_mechanism("5R")

    def hashed(change: float) -> int:
        leg = mechanism.legs[0]
        values = leg.nominal.copy()
        values[leg.parameter_names.index("l")] *= 1.0 + change
        return difference_hash(
            figure_bytes(
                pincal.picture(mechanism.with_parameters({leg.name: values})).figure(), "png"
            )
        )

    assert apart(hashed(0.0), KEPT["5R"]) <= SAME
    assert apart(hashed(1e-5), hashed(0.0)) <= SAME
    assert apart(hashed(0.5), hashed(0.0)) > SAME
