"""The tests that docs/reliability.md names exist, and every point has a test or is declared open."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
PAGE = (TESTS.parent / "docs/reliability.md").read_text(encoding="utf-8").partition("## Known defects")[2]
NAMED = sorted(set(re.findall(r"`([\w/]+\.py)::(\w+)`", PAGE)))
ROWS = [line for line in PAGE.splitlines() if line.startswith("| ") and line != "| point | test |"]


@pytest.mark.parametrize(("file", "name"), NAMED)
def test_a_named_test_exists(file: str, name: str) -> None:
    tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
    assert name.startswith("test_")
    assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("row", ROWS)
def test_a_point_names_a_test_or_is_open(row: str) -> None:
    _, point, tests, _ = (cell.strip() for cell in row.split("|"))
    assert point
    assert re.search(r"`[\w/]+\.py::\w+`", tests) or tests.startswith("open"), point


def test_the_page_has_the_three_tables() -> None:
    assert len(NAMED) > 30
    assert PAGE.count("| point | test |") == 3
