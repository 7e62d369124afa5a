"""What HTML pages describe: their blocks, tables and texts, for tests without a browser."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any


def description(page: Path | str) -> dict[str, Any]:
    """Return the description in a page, with shared values in their places."""
    html = page.read_text(encoding="utf-8") if isinstance(page, Path) else page
    data = json.loads(re.search(r'id="data">(.*?)</script>', html, re.DOTALL)[1])  # type: ignore[index]
    return _resolved(data, data["shared"])  # type: ignore[no-any-return]


def details(page: Path, file: Path) -> list[Any]:
    """Return what rows of a page open from a file of its data."""
    shared = json.loads(re.search(r'id="data">(.*?)</script>', page.read_text(), re.DOTALL)[1])["shared"]  # type: ignore[index]
    text = file.read_text(encoding="utf-8").removeprefix("receive(").removesuffix(");\n")
    return _resolved(json.loads(f"[{text}]")[1], shared)  # type: ignore[no-any-return]


def blocks(part: Any, kind: str) -> list[dict[str, Any]]:
    """Return all blocks of a kind in a part of a description, in their order."""
    return [one for one in _dicts(part) if one.get("kind") == kind]


def table(part: Any, name: str) -> dict[str, Any]:
    """Return the first table of a name."""
    return next(one for one in blocks(part, "table") if one.get("name") == name)


def column(one: dict[str, Any], name: str) -> list[Any]:
    """Return the values of a column of a table, those of cells by which they are sorted."""
    place = [column["name"] for column in one["columns"]].index(name)
    return [
        cell["v"] if isinstance(cell, dict) and "v" in cell else cell for cell in (row[place] for row in one["rows"])
    ]


def texts(part: Any) -> list[str]:
    """Return all texts in a part of a description."""
    if isinstance(part, str):
        return [part]
    values = part.values() if isinstance(part, dict) else part if isinstance(part, list) else ()
    return [text for value in values for text in texts(value)]


def _dicts(part: Any) -> Iterator[dict[str, Any]]:
    if isinstance(part, dict):
        yield part
    for value in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        yield from _dicts(value)


def _resolved(part: Any, shared: list[Any]) -> Any:
    if isinstance(part, dict):
        if part.keys() == {"use"}:
            return _resolved(shared[part["use"]], shared)
        return {name: _resolved(value, shared) for name, value in part.items()}
    return [_resolved(value, shared) for value in part] if isinstance(part, list) else part
