"""The study of the paper's Table 1: what it states resolves, and its driver runs on data written to disk."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from p2o import Recipe, Registry
from p2o.metrics import AXES
from p2o.simulate import write_vkitti2
from p2o.testing import stage

DRIVER = Path(__file__).parents[2] / "benchmarks/table1.py"
STUDY = tomllib.loads(DRIVER.with_suffix(".toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("row", STUDY["row"], ids=lambda row: row["name"])
@pytest.mark.parametrize("data", ["synthetic:", "vkitti2:somewhere"])
def test_every_row_is_a_recipe_whose_options_exist(row: dict, data: str) -> None:
    words = {name: STUDY[name] for name in ("seed", "extractor", "matcher", "solver", "init", "perturb")}
    plan = Recipe.of(**words, data=data, options={name: row[name] for name in ("data", "pipeline")}).resolve(
        Registry.load()
    )
    for name, value in row["data"].items():
        assert getattr(plan.parts["data"].options, name) == value
    assert plan.pipeline.missing_edges == row["pipeline"]["missing_edges"]
    assert set(row["paper"]) == set(AXES)


def test_the_rows_are_those_of_the_paper() -> None:
    """Sec. IV-B: 64 beams with 0, 25, 45 % missing edges, doubled noise, 32 beams; at least 40 scenes."""
    assert STUDY["scenes"] >= 40
    assert STUDY["perturb"] == "2deg 0.15m"
    assert [row["name"] for row in STUDY["row"]] == [f"test{i}" for i in range(1, 6)]
    assert [row["pipeline"]["missing_edges"] for row in STUDY["row"]] == [0, 0.25, 0.45, 0, 0]
    assert [row["data"]["noise_m"] for row in STUDY["row"]] == [0.02, 0.02, 0.02, 0.04, 0.02]
    assert [row["data"]["angle_noise_deg"] for row in STUDY["row"]] == [0, 0, 0, 0.005, 0]
    assert [row["data"]["lidar"] for row in STUDY["row"]] == ["hdl-64e"] * 4 + ["hdl-32e"]


def test_the_driver_prints_means_beside_the_papers_and_counts_them(tmp_path: Path) -> None:
    list(write_vkitti2.write([stage.frame()] * 10, tmp_path))
    words = ["--data", f"vkitti2:{tmp_path}?mount=camera", "--scenes", "10", "--rows", "test1,test3", "--init", "given"]
    done = subprocess.run([sys.executable, DRIVER, *words], capture_output=True, text=True, check=True)
    cells = [[cell.strip() for cell in line.split("|")[1:-1]] for line in done.stdout.splitlines() if "|" in line]
    labels = [row[1] for row in cells[2:]]
    assert labels == ["mean", "paper", "median", "joint mean"] * 2
    for number, name in enumerate(("test1", "test3")):
        mean, paper = cells[2 + 4 * number], cells[3 + 4 * number]
        published = next(row for row in STUDY["row"] if row["name"] == name)["paper"]
        assert [float(cell) for cell in paper[2:8]] == [published[axis] for axis in AXES]
        assert mean[0].startswith(name)
        for cell, axis in zip(mean[2:8], AXES, strict=True):
            value = float(cell.removeprefix("> "))
            if abs(value - published[axis]) > 1e-3:
                assert cell.startswith(">") == (value > published[axis])
    marked = sum(cell.startswith(">") for row in cells for cell in row)
    assert re.search(rf"^{12 - marked} of 12 means", done.stdout, re.MULTILINE)
