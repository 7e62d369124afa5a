"""Product, docs and benchmarks use the terms of docs/glossary.md: the words of wording.py may only become fewer."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.wording import IDENTIFIERS, PHRASES

ROOT = Path(__file__).parents[1]
LEFT = {
    "CONTRIBUTING.md": 0,
    "README.md": 0,
    "baselines": 3,
    "benchmarks": 0,
    "docs": 0,
    "plugins/p2o_datasets": 0,
    "plugins/p2o_formats": 0,
    "plugins/p2o_plugins": 1,
    "plugins/p2o_sim": 0,
    "toolkit/p2o": 0,
    "toolkit/p2o_fleet": 0,
    "toolkit/p2o_rig": 0,
    "toolkit/p2o_pages": 0,
    "toolkit/p2o_study": 0,
    "toolkit/p2o_train": 0,
    "toolkit/p2o_testing": 0,
}
"""Phrases and names that are left to replace in each part; lower the number with every part that is rewritten."""
PHRASE = re.compile(rf"\b(?:{'|'.join(PHRASES)})\b", re.IGNORECASE)
OUTPUT = re.compile(r"^ *```text$.*?^ *```$", re.MULTILINE | re.DOTALL)
"""Output of programs on pages: quoted as it is, and counted where the program prints it."""
SUFFIXES = {".py", ".pyi", ".md", ".toml", ".html", ".js", ".txt"}


def defined(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Return every name that code defines, with its line."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name, node.lineno
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno


def offences(text: str, *, code: bool) -> Iterator[str]:
    """Return the phrases of a text and the names that it defines which have a better term, with their lines."""
    text = OUTPUT.sub(lambda output: "\n" * output[0].count("\n"), text)
    for number, line in enumerate(text.splitlines(), start=1):
        yield from (f"{number}: '{match[0]}'" for match in PHRASE.finditer(line))
    if code:
        for name, number in defined(ast.parse(text)):
            if name in IDENTIFIERS:
                yield f"{number}: {name}, better {IDENTIFIERS[name]}"


@pytest.mark.parametrize("part", LEFT)
def test_words_with_a_better_term_become_fewer(part: str) -> None:
    place = ROOT / part
    paths = [place] if place.is_file() else sorted(p for p in place.rglob("*") if p.suffix in SUFFIXES)
    lines = [
        f"{path.relative_to(ROOT)}:{offence}"
        for path in paths
        for offence in offences(path.read_text(encoding="utf-8"), code=path.suffix == ".py")
    ]
    assert len(lines) <= LEFT[part], "\n".join(lines)
    assert len(lines) == LEFT[part], f"LEFT['{part}'] can be lowered to {len(lines)}"
