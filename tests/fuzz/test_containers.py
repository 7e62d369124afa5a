"""The drawing of cases at the structure of files."""

from __future__ import annotations

from pathlib import Path
from random import Random

from tests.fuzz import containers
from tests.fuzz.bases import Bases
from tests.p2o_datasets import argoverse2_files, waymo_files


def test_columns_get_names_that_are_no_unicode_or_keep_theirs(tmp_path: Path) -> None:
    bases = Bases(tmp_path / "bases")
    argoverse2_files.Log(bases.layouts["argoverse2"]).write()
    waymo_files.Segment(bases.layouts["waymo"]).write()
    for number in range(200):
        home = tmp_path / str(number)
        (home / "in").mkdir(parents=True)
        containers.columns(Random(number), bases, home)
        assert any((home / "in/data").rglob("*"))
