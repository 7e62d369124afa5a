"""Methods outside p2o enter the benchmark with a file of poses."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.p2o_study.benchmark_board import QUICK_ROW, Board
from tests.study_bench import HEAD
from tests.study_plugin import TRUTH

FOREIGN = """
import csv, sys
assert "p2o" not in sys.modules
# Keeps the orientation of the initial guess, knows the position, and refuses seed 4.
truth_t = sys.argv[3:]
with open(sys.argv[1], newline="") as file, open(sys.argv[2], "w", newline="") as out:
    writer = csv.writer(out)
    writer.writerow(["group", "protocol", "seed", "qx", "qy", "qz", "qw", "tx", "ty", "tz", "seconds"])
    for line in csv.DictReader(file):
        m = [[float(line[f"m{i}{j}"]) for j in range(4)] for i in range(4)]
        w = (1 + m[0][0] + m[1][1] + m[2][2]) ** 0.5 / 2
        q = [(m[2][1] - m[1][2]) / 4 / w, (m[0][2] - m[2][0]) / 4 / w, (m[1][0] - m[0][1]) / 4 / w, w]
        pose = [""] * 7 if line["seed"] == "4" else [*q, *truth_t]
        writer.writerow([line["group"], line["protocol"], line["seed"], *pose, "" if line["seed"] == "4" else 0.25])
"""


@pytest.fixture
def poses(board: Board) -> Path:
    """Return the file of poses of a program that cannot import p2o."""
    starts, script, out = (board.root / name for name in ("starts.csv", "foreign.py", "poses.csv"))
    assert board.command("starts", "--out", str(starts)) == 0
    script.write_text(FOREIGN)
    # -I: without PYTHONPATH and the user's packages.
    subprocess.run([sys.executable, "-I", str(script), str(starts), str(out), *map(str, TRUTH[:3, 3])], check=True)
    return out


def test_the_initial_guesses_are_those_of_the_measured_rows(board: Board, poses: Path) -> None:
    with (board.root / "starts.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == 15
    written = {
        (line["frames"], int(line["seed"])): [float(line[f"m{i}{j}"]) for i in range(4) for j in range(4)]
        for line in lines
    }
    assert len({tuple(start) for start in written.values()}) == 15
    for row in board.measured():
        assert np.allclose(np.ravel(row.case.start), written[row.frames[0], row.seed], rtol=0, atol=1e-9)


def test_a_foreign_method_is_scored(board: Board, poses: Path, capsys: pytest.CaptureFixture[str]) -> None:
    board.measured()
    assert board.command("score", str(poses), "--name", "PnP", "--source", "https://example.org/pnp", "--by", "me") == 0
    assert "15 rows of 'PnP' added, 3 refused" in capsys.readouterr().out
    rows = [row for row in board.rows() if row.row == "PnP"]
    assert len(rows) == 15
    for row in rows:
        error = row.error
        assert error is not None
        assert (row.estimate is None) == (row.seed == 4)
        # Orientation of the initial guess (1 deg), position of the truth; a refused one keeps the initial guess.
        assert error.rotation_deg == pytest.approx(1.0, abs=1e-6)
        assert error.translation_m == pytest.approx(0.05 if row.seed == 4 else 0.0, abs=1e-6)
    assert rows[0].total_s == 0.25
    assert rows[0].method.source == "https://example.org/pnp"
    assert board.outdated(capsys) == []


def test_a_foreign_method_is_in_every_section_that_makes_its_calibrations(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    """Single and joint calibrations of one section, and the same single ones of another, are rows of their own."""
    row = QUICK_ROW.replace("witness", 'section = "{0}"\n{1}witness').replace('label = "quick"', 'label = "{2}"')
    rows = (("one", "", "a"), ("one", "joint = true\n", "b"), ("two", "", "c"))
    board.write(study=HEAD + "".join(row.format(*words) for words in rows))
    starts = board.root / "starts.csv"
    assert board.command("starts", "--out", str(starts)) == 0
    assert board.command("score", str(starts), "--name", "foreign") == 0
    counts = Counter((row.section, row.case.joint > 0) for row in board.rows())
    assert counts == {("one", False): 15, ("one", True): 5, ("two", False): 15}
    capsys.readouterr()
    assert board.command("table", "--section", "two") == 0
    [line] = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| foreign")]
    assert line.split(" | ")[1:3] == ["15", "3"]


def test_rows_of_a_foreign_method_are_stale_where_the_data_changed(
    board: Board, poses: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert board.command("score", str(poses), "--name", "PnP") == 0
    study = (board.root / "study.toml").read_text()
    board.write(study=study.replace("frames = 3 }", "frames = 3, salt = 1 }"))
    assert ("PnP", "data changed") in board.outdated(capsys)


def without_first(text: str) -> str:
    lines = text.splitlines()
    return "\n".join([lines[0], *lines[2:]])


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (without_first, "1 of 15 poses are missing; expected a line for each initial guess of the suite"),
        (lambda t: t + t.splitlines()[1], "poses.csv:17: a second pose for tiny: tiny/000, 1deg 0.05m, seed 0;"),
        (lambda t: t.replace("tiny/000", "tiny/0000", 1), "poses.csv:2: unknown calibration 'tiny: tiny/0000, 1deg"),
        (lambda t: t.replace("1deg", "2deg", 1), "poses.csv:2: unknown calibration 'tiny: tiny/000, 2deg 0.05m, 0'"),
        (lambda t: t.replace(",0,", ",77,", 1), "poses.csv:2: unknown calibration 'tiny: tiny/000, 1deg 0.05m, 77'"),
        (lambda t: re.sub(r"m,0,[^,]*", "m,0,0.9", t, count=1), "poses.csv:2: the quaternion is no rotation"),
        (lambda t: re.sub(r"m,0,[^,]*", "m,0,nan", t, count=1), "poses.csv:2: column qx is not a number"),
        (lambda t: re.sub(r"m,0,[^,]*", "m,0,", t, count=1), "poses.csv:2: column qx is not a number"),
        (lambda t: t.replace("qw,", "qq,", 1), "poses.csv:1: the columns are not those of poses"),
        (lambda t: t.replace("\n", ",1\n", 2), "poses.csv:3: wrong number of columns"),
        (lambda t: "", "the file of poses is empty"),
    ],
)  # fmt: skip
def test_a_wrong_file_of_poses_is_refused_and_changes_nothing(
    board: Board, poses: Path, capsys: pytest.CaptureFixture[str], edit: Callable[[str], str], message: str
) -> None:
    poses.write_text(edit(poses.read_text().replace("\r\n", "\n")))
    assert board.command("score", str(poses), "--name", "PnP") == 2
    assert message in capsys.readouterr().err
    assert board.rows() == []


def test_matrices_are_read_and_a_mirror_image_is_refused(
    board: Board, poses: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    starts = board.root / "starts.csv"
    assert board.command("score", str(starts), "--name", "nothing") == 0
    rows = board.rows()
    assert all(np.allclose(row.estimate, row.case.start, rtol=0, atol=1e-9) for row in rows if row.estimate is not None)
    with starts.open(newline="") as file:
        lines = list(csv.reader(file))
    lines[1][4:8] = [str(-float(x)) for x in lines[1][4:8]]
    mirrored = board.root / "mirrored.csv"
    mirrored.write_text("\n".join(",".join(line) for line in lines))
    assert board.command("score", str(mirrored), "--name", "mirror") == 2
    assert "mirrored.csv:2: the rotation of the pose mirrors space" in capsys.readouterr().err


def test_a_foreign_method_cannot_take_the_name_of_a_row(
    board: Board, poses: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert board.command("score", str(poses), "--name", "quick") == 2
    assert "'quick' is a row of the suite" in capsys.readouterr().err
