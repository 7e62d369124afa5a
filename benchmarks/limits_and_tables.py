"""Limits of good and wrong poses, Markdown tables, and files of rows that are continued, for the scripts."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:  # bench.py measures the time of imports
    from p2o.cache import FeatureCache

_Key, _Item = TypeVar("_Key", bound=Hashable), TypeVar("_Item")
START_DEG, START_M = 2.0, 0.15
"""Error of the initial guess."""
GOOD_DEG, GOOD_M = 0.5, 0.15
WRONG_DEG, WRONG_M = 1.0, 0.3
"""A trusted result with a larger error is a false accept."""
SPLITS = Path(__file__).parents[1] / "baselines/p2o_baselines/suites/splits.json"


STUDY = """name = "{name}"
title = "{name}"
perturb = "1deg 0.05m"
seeds = {seeds}
[[dataset]]
name = "streets"
data = "{data}"
"""
"""A study file without its rows."""


def is_good(rotation_deg: float, translation_m: float) -> bool:
    """Return whether the error of a pose is small."""
    return rotation_deg < GOOD_DEG and translation_m < GOOD_M


def is_wrong(rotation_deg: float, translation_m: float) -> bool:
    """Return whether the error of a pose is large: if it is trusted, it is a false accept."""
    return rotation_deg > WRONG_DEG or translation_m > WRONG_M


def size(rotation_deg: float, translation_m: float) -> str:
    """Return an error for a table."""
    return f"{rotation_deg:.2f} deg, {100 * translation_m:.1f} cm"


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table."""
    return "\n".join(f"| {' | '.join(map(str, row))} |" for row in (head, ["---"] * len(head), *rows))


def grouped(items: Iterable[_Item], key: Callable[[_Item], _Key]) -> dict[_Key, list[_Item]]:
    """Return items by key, in the order of their first occurrence."""
    groups: dict[_Key, list[_Item]] = defaultdict(list)
    for item in items:
        groups[key(item)].append(item)
    return dict(groups)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a file of JSON lines; none if it does not exist."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def add_row(path: Path, row: object) -> None:
    """Append a row to a file of JSON lines."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


def cached(cache: FeatureCache | None, key: str, extract: Callable[[], Any]) -> Any:
    """Return features from the cache, extracted if they are not in it."""
    if cache is None:
        return extract()
    entry = cache.get(key)
    if entry is None:
        cache.put(key, extract(), 0.0)
        entry = cache.get(key)
    assert entry is not None
    return entry.features


def write_webp(path: str, images: Sequence[Any], **options: Any) -> None:
    """Write images (H, W, 3) as a figure, several as an animation; `options` are those of Pillow."""
    from PIL import Image

    first, *others = map(Image.fromarray, images)
    more = {"save_all": True, "append_images": others} if others else {}
    first.save(path, "webp", method=6, **more, **options)
