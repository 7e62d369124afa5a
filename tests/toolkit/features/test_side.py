"""The letters of the four sides, as docs/conventions.md has them; and that page's own blocks."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from p2o import SIDES, Camera, Side
from p2o.features.occlusion import edges_from_orders, occlusion_orders

PAGE = Path(__file__).parents[3] / "docs" / "conventions.md"

TABLE = [
    (Side.LEFT, 0, "L", (-1, 0)),
    (Side.RIGHT, 1, "R", (1, 0)),
    (Side.UPPER, 2, "U", (0, -1)),
    (Side.BOTTOM, 3, "B", (0, 1)),
    (Side.NONE, -1, "-", (0, 0)),
]


@pytest.mark.parametrize(("side", "number", "letter", "arrow"), TABLE, ids=[row[2] for row in TABLE])
def test_number_letter_and_arrow_are_those_of_the_table(
    side: Side, number: int, letter: str, arrow: tuple[int, int]
) -> None:
    assert (side, side.letter, side.background) == (number, letter, arrow)
    row = next(line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith(f"| `{side.name}`"))
    assert row.split("|")[2:5] == [f" {number} ", f" {letter} ", f" {arrow} "]


def test_a_flip_exchanges_left_and_right_and_nothing_else() -> None:
    for side in Side:
        du, dv = side.background
        assert side.mirrored.background == (-du, dv)
        assert side.mirrored.mirrored is side


def test_a_box_in_front_of_a_wall_has_its_letters_on_its_own_pixels() -> None:
    depth_m = np.full((7, 8), 10.0)
    depth_m[2:5, 3:5] = 5.0
    uv, side = edges_from_orders(occlusion_orders(depth_m, Camera.pinhole(100, 100, 3.5, 3, 8, 7)))
    for (u, v), s in zip(uv.astype(int), side, strict=True):  # the arrow leads to something farther
        du, dv = Side(int(s)).background
        assert (depth_m[v, u], depth_m[v + dv, u + du]) == (5, 10)
    found = {s: sorted(map(tuple, uv[side == s].astype(int).tolist())) for s in SIDES}
    assert found == {
        Side.LEFT: [(3, 2), (3, 3), (3, 4)],
        Side.RIGHT: [(4, 2), (4, 3), (4, 4)],
        Side.UPPER: [(3, 2), (4, 2)],
        Side.BOTTOM: [(3, 4), (4, 4)],
    }


def test_the_conventions_page_has_a_block_a_section_that_asserts_what_it_says() -> None:
    """And tests/test_pages.py runs them."""
    text = PAGE.read_text(encoding="utf-8")
    assert all("assert " in block for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    sections = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    assert [s.splitlines()[0] for s in sections if "```python" not in s] == ["Units and names"]
