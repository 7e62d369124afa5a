"""The arrays inside of a value are found wherever they are, each under the way that leads to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from p2o.arrays import leaves, parts


@dataclass(frozen=True)
class Box:
    """Something with parts."""

    inside: object
    size: int = 1


def test_leaves_are_named_by_field_place_and_key() -> None:
    a, b = np.zeros(2), np.ones(3)
    found = dict(leaves(Box([Box(a), {"left": b, "none": {}}], 7)))
    assert list(found) == ["inside.0.inside", "inside.0.size", "inside.1.left", "size"]
    assert found["inside.0.inside"] is a
    assert found["inside.1.left"] is b
    assert found["size"] == 7


def test_a_value_without_parts_is_its_own_leaf_and_what_is_empty_has_none() -> None:
    for value in (np.zeros(3), "text", 1.5, None, Box, {1, 2}):
        [(name, leaf)] = leaves(value)
        assert name == ""
        assert leaf is value
        assert parts(value) is None
    for value in ((), [], {}):
        assert parts(value) == []
        assert list(leaves(value)) == []
