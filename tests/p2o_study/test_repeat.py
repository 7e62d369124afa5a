"""The commands that `p2o benchmark table --commands` prints repeat rows: the same initial guess and the same pose."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o.cli import main
from p2o_study.ablate import open_session
from p2o_study.benchmark.suite import find_suite
from p2o_study.rows import Rows
from p2o_study.worker import Plugins

from tests.p2o_study.benchmark_board import QUICK_ROW, Board
from tests.study_bench import HEAD, PLUGIN

SAME = 1e-6
"""Largest difference of an entry of a pose (rad, m)."""


def commands(text: str) -> list[list[str]]:
    """Return the words of the commands after "p2o"."""
    return [shlex.split(line)[1:] for line in text.splitlines() if not line.startswith("#")]


def poses(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[np.ndarray, np.ndarray]:
    """Run a command; return its initial guess and its result."""
    capsys.readouterr()
    assert main([*words, "--json"]) in (0, 1)
    [result] = json.loads(capsys.readouterr().out)["results"]
    return np.array(result["start"]), np.array(result["camera_from_lidar"])


def test_commands_repeat_single_and_joint_rows_of_the_smoke_suite(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Groups of frames do not begin with the first frame of the data: each has an initial guess of its own."""
    suite = find_suite("smoke", p2o.Registry.load(environ={})).overridden(frames="1-3", seeds=(2, 0, 1, 3, 4))
    rows = Rows(tmp_path)
    rows.make_folder()
    with open_session(suite, Plugins.of()) as session:
        cells = session.cells()
        chosen = [n for n, cell in enumerate(cells) if cell.row.seed == 0 and cell.row.place.startswith("scene-0001")]
        computed = {row.row: row for row in session.calibrated(cells, chosen)}
    for row in computed.values():
        rows.put("smoke", row)
    assert {row.case.joint for row in computed.values()} == {0, 3}
    assert main(["benchmark", "table", "smoke", "--commands", "--results", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert len(commands(printed)) == len(computed) == 5
    labels = [line for line in printed.splitlines() if line.startswith("#")]
    for words, comment in zip(commands(printed), labels, strict=True):
        [row] = [row for row in computed.values() if f": {row.row}, {row.place}, seed 0: " in comment]
        start, pose = poses(words, capsys)
        assert np.allclose(start, row.case.start, rtol=0, atol=SAME)
        assert row.pose is not None
        assert np.allclose(pose, row.pose, rtol=0, atol=SAME), comment


@pytest.mark.parametrize("joint", ["true", "2", '"camera"'])
def test_every_kind_of_group_has_the_initial_guess_of_its_command(
    board: Board, capsys: pytest.CaptureFixture[str], joint: str
) -> None:
    board.write(study=HEAD.replace("frames = 3 }", 'frames = 4 }\nframes = "1-3"') + QUICK_ROW + f"joint = {joint}\n")
    board.measured()
    capsys.readouterr()
    assert board.command("table", "--commands") == 0
    [words] = commands(capsys.readouterr().out)
    start, pose = poses([*words, "--plugin", str(PLUGIN)], capsys)
    first = min((row for row in board.rows() if row.seed == 0), key=lambda row: row.frames)
    assert np.allclose(start, first.case.start, rtol=0, atol=SAME)
    assert np.allclose(pose, first.pose, rtol=0, atol=SAME)


@pytest.mark.parametrize("words", [(), ("--section", "other")])
def test_commands_of_no_row_are_refused(
    board: Board, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    if words:
        board.measured()
    capsys.readouterr()
    assert board.command("table", "--commands", *words) == 2
    printed = capsys.readouterr()
    assert not printed.out
    assert "there are no measured rows" in printed.err


def test_rows_without_a_command_say_why(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    starts = board.root / "starts.csv"
    board.measured()
    assert board.command("starts", "--out", str(starts)) == 0
    assert board.command("score", str(starts), "--name", "foreign") == 0
    board.write(study=HEAD + QUICK_ROW)
    capsys.readouterr()
    assert board.command("table", "--commands") == 0
    text = capsys.readouterr().out
    assert "# no command: a method outside p2o" in text
    assert "# no command: the suite no longer has this row" in text
    assert len(commands(text)) == 1
