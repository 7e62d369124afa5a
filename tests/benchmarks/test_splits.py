"""The frames of every benchmark are named in the repository, and its pages refer to nothing outside of it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import limits_and_tables
import pytest

ROOT = Path(__file__).parents[2]
SPLITS: dict[str, list[str]] = json.loads(limits_and_tables.SPLITS.read_text(encoding="utf-8"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "benchmarks").glob("*.py"))]


def test_a_list_names_each_of_its_frames_once() -> None:
    assert len(SPLITS["test"]) == 24
    for name, frames in SPLITS.items():
        assert frames, name
        assert len(set(frames)) == len(frames), name


def test_what_is_tuned_on_is_not_tested_on() -> None:
    drives = {split: {frame.split("/")[1] for frame in SPLITS[split]} for split in ("test", "train")}
    assert not set(SPLITS["test"]) & set(SPLITS["train"])
    assert not drives["test"] & drives["train"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_name_lists_that_are_there_and_no_folder_outside(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "../shared" not in text
    assert str(ROOT) not in text
    assert "@splits.json" not in text
    for split in re.findall(r"@baselines/p2o_baselines/suites/splits\.json#([\w-]+)", text):
        assert split in SPLITS
