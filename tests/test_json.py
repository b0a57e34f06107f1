"""``--json``: what a command found, on stdout alone, in SI units."""

from __future__ import annotations

import json

import numpy as np
from command_line import done

import pincal


def test_check_tells_what_the_library_finds() -> None:
    """Nominal parameters, rank and symmetry; numbers as numbers, and what is not finite as null."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is no JSON")

    found = json.loads(done("check", "3RRR", "--json").out, parse_constant=refuse)
    mechanism = pincal.load_mechanism("3RRR")
    assert found["mechanism"] == "3RRR"
    assert found["symmetry"] == pincal.symmetry_group(mechanism).name == "C3"
    told = [value for leg in found["legs"] for value in leg["parameters"].values()]
    np.testing.assert_array_equal(told, mechanism.parameters.values)
    assert [leg["rank"] for leg in found["legs"]] == [len(mechanism.legs[0].parameters)] * 3
    assert found["legs"][0]["turns_back_at"] == [None]
