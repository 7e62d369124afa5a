"""Basins: a study over sizes of wrong starts, and the shares of those that arrive."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from p2o import InputError, Registry, UnknownNameError
from p2o.cli import main
from p2o.geometry.perturb import Perturbation, parse_perturbation
from p2o.results.verdict import Trust
from p2o.run.presets import Preset
from p2o_study.basin import Grid, basin_of, basin_study, contender_of, label
from p2o_study.study import check_study, parse_study

from tests.fake_study import run_of

GRID = Grid((1.0, 4.0), (0.1, 0.5, 2.0), parse_perturbation("0.5deg 0.2m"))


def test_a_basin_is_a_study_of_every_method_from_every_size_of_start() -> None:
    registry = Registry.load()
    contenders = [contender_of(name, None, registry) for name in ("ogm", "nearest")]
    file = basin_study(contenders, GRID, "synthetic:", "0", 3, False)
    rows = check_study(file, registry)
    assert {row.label for row in rows} == {label(c, cell) for c in contenders for cell in GRID.cells}
    assert len(rows) == 2 * 2 * 3
    assert {row.words["perturb"] for row in rows} == {str(cell) for cell in GRID.cells}
    assert all(row.seeds == (0, 1, 2) for row in rows)


def test_a_row_of_a_study_comes_with_its_words_and_options() -> None:
    text = """
    name = "s"
    title = "S"
    [[dataset]]
    name = "d"
    data = "synthetic:"
    [[row]]
    label = "simple"
    extractor = "depth/rings"
    matcher = "nearest"
    options.matcher.huber_px = 2.5
    options.pipeline.rounds = 3
    """
    registry = Registry.load()
    contender = contender_of("simple", parse_study(text), registry)
    assert contender.words["extractor"] == "depth/rings"
    [row, *_] = check_study(basin_study([contender], GRID, "synthetic:", "0", 1, True), registry)
    assert row.words["options"]["matcher"]["huber_px"] == 2.5
    assert row.words["options"]["pipeline"]["rounds"] == 3
    assert row.joint == -1


def test_a_name_that_is_no_method_is_told_with_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="did you mean nearest"):
        contender_of("neares", None, Registry.load())


def test_shares_count_what_arrives_what_is_refused_and_what_deceives() -> None:
    contender = Preset("ours", {"matcher": "ogm"}, {})
    first, second = GRID.cells[:2]
    common = {"trust": Trust.TRUSTED}
    rows = [
        run_of(label(contender, first), "a", 0, 0.1, 0.05, **common),  # type: ignore[arg-type]
        run_of(label(contender, first), "b", 0, 0.1, 0.25, **common),  # type: ignore[arg-type]
        run_of(label(contender, first), "c", 0, 0.6, 0.05, trust=Trust.DOUBTFUL),
        run_of(label(contender, first), "d", 0, 0.1, 0.05, status="no-edges", trust=Trust.REFUSED),
        run_of(label(contender, second), "a", 0, 0.1, 0.05, **common),  # type: ignore[arg-type]
    ]
    basin = basin_of(contender, GRID, rows)
    assert basin.success.shape == (2, 3)
    assert basin.success[0, 0] == 0.25
    assert basin.refused[0, 0] == 0.25
    assert basin.deceived[0, 0] == 0.25
    assert basin.success[0, 1] == 1
    assert np.isnan(basin.success[1]).all()
    assert basin.count.tolist() == [[4, 1, 0], [0, 0, 0]]
    assert json.loads(json.dumps(basin.as_dict(), allow_nan=False))["success"][1] == [None] * 3


@pytest.mark.parametrize("sizes", [(), (1.0, 1.0), (-1.0,), (float("nan"),), (181.0,)])
def test_sizes_that_make_no_grid_are_told(sizes: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="form no grid"):
        Grid(sizes, (1.0,), Perturbation(1, 1))


def test_the_command_writes_a_heat_map_and_its_numbers_and_goes_on_where_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = "synthetic:?width_px=310&height_px=94&place=street"
    words = ["basin", "ogm", "--data", data, "--rotations", "0.5,170", "--translations", "0.05", "--within", "3deg 1m"]
    assert main([*words, "--out", str(tmp_path), "--quiet"]) == 0
    told = json.loads((tmp_path / "basin.json").read_text())
    assert told["methods"][0]["success"] == [[1.0], [0.0]], "near starts arrive, starts that look away do not"
    assert (tmp_path / "basin.png").read_bytes().startswith(b"\x89PNG")
    assert "ogm: % within 3deg 1m of 1 calibrations each" in capsys.readouterr().out
    kept = (tmp_path / "basin.json").read_bytes()
    assert main([*words, "--out", str(tmp_path)]) == 0
    assert "seed 0" not in capsys.readouterr().err, "no row is computed again"
    assert (tmp_path / "basin.json").read_bytes() == kept


def test_the_command_refuses_sizes_that_are_none(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["basin", "ogm", "--rotations", "wide"]) == 2
    assert "--rotations: cannot read the sizes" in capsys.readouterr().err
