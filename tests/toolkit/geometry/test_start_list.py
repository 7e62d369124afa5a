"""Lists of starts: every frame takes its own line, and a list that cannot be meant is refused with file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.geometry.perturb import Perturbation
from p2o.geometry.start_list import StartList, parse_starts

NAMES = tuple(f"00/{number:06d}" for number in range(5))
ERRORS = np.random.default_rng(0).uniform(-0.2, 0.2, (5, 6))
NUMBERS = [" ".join(f"{value:.9f}" for value in row) for row in ERRORS]


def written(folder: Path, *lines: str) -> StartList:
    path = folder / "starts.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return StartList(str(path))


def of_lines(starts: StartList, names: tuple[str, ...], *indices: int) -> list[int]:
    """Return which of ERRORS each of these frames takes."""
    found = starts.errors(names, indices)
    differences = [np.abs(se3.exp(ERRORS) - found[index]).max(axis=(1, 2)) for index in indices]
    assert all(d.min() < 1e-8 for d in differences)
    return [int(d.argmin()) for d in differences]


def test_a_line_is_the_logarithm_with_the_rotation_first_and_words_say_file_and_side(tmp_path: Path) -> None:
    truth, error = se3.exp(np.array([0.3, -1.0, 0.4, 1, 2, 3])), np.array([0, 0, 0.5, 0.1, 0.2, 0.3])
    found = written(tmp_path, "0 0 0.5 0.1 0.2 0.3").errors(("a",), [0])[0]
    np.testing.assert_allclose(se3.log(found), error, atol=1e-12)
    np.testing.assert_array_equal(StartList("a").start(truth, found), truth @ found)
    np.testing.assert_array_equal(StartList("a", in_camera=True).start(truth, found), found @ truth)
    assert parse_starts("@a list.txt") == StartList("a list.txt")
    assert parse_starts(" camera @a.csv ") == StartList("a.csv", in_camera=True)
    assert parse_starts(str(StartList("a.csv", in_camera=True))) == StartList("a.csv", in_camera=True)
    assert parse_starts("2deg 0.15m") == Perturbation(2, 0.15)
    for text in ("@", "camera @ ", "uniform @a.txt", "camera"):  # name no file
        with pytest.raises(InputError, match="--perturb"):
            parse_starts(text)


def test_commas_headings_remarks_and_blank_lines_are_no_starts(tmp_path: Path) -> None:
    lines = ["# drawn by us", "r1,r2,r3,t1,t2,t3", "", *(line.replace(" ", ", ") for line in NUMBERS), "  "]
    assert of_lines(written(tmp_path, *lines), NAMES, 0, 4) == [0, 4]
    for width in (12, 16):  # matrices are read, too
        lines = [" ".join(map(repr, matrix.reshape(-1)[:width].tolist())) for matrix in se3.exp(ERRORS)]
        assert of_lines(written(tmp_path, *lines), NAMES, 3) == [3]
        assert of_lines(written(tmp_path, f"00/000001 {lines[2]}"), NAMES, 1) == [2]


def test_frames_take_the_line_of_their_number_or_order_and_gaps_are_refused(tmp_path: Path) -> None:
    starts = written(tmp_path, *NUMBERS)
    assert of_lines(starts, ("00/000002", "00/000004"), 0, 1) == [2, 4]
    assert of_lines(starts, ("000003",), 0) == [3]
    assert of_lines(starts, ("gate", "hill", "7"), 2, 1) == [2, 1]
    assert of_lines(starts, ("a/0", "a/1", "b/0", "b/1"), 2, 3) == [2, 3]
    with pytest.raises(InputError, match=r"starts.txt: the lines cannot be assigned.*frame b/2 after 1"):
        starts.errors(("a/0", "a/1", "b/0", "b/2"), [0])


def test_lines_may_name_their_frames_in_any_order(tmp_path: Path) -> None:
    starts = written(tmp_path, *(f"{name} {line}" for name, line in reversed(list(zip(NAMES, NUMBERS, strict=True)))))
    assert of_lines(starts, NAMES, 0, 3) == [0, 3]
    short = written(tmp_path, f"000003,{NUMBERS[1].replace(' ', ',')}")
    assert of_lines(short, NAMES, 3) == [1]
    with pytest.raises(InputError, match="frame 00/000002 has no start in the list"):
        short.errors(NAMES, [3, 2])
    with pytest.raises(InputError, match=r"too short.*expected 94 starts, the last for frame 00/000093; got 5"):
        written(tmp_path, *NUMBERS).errors(("00/000093",), [0])
    with pytest.raises(InputError, match="line 1: frames a/000000 and b/000000 use the same line"):
        written(tmp_path, f"000000 {NUMBERS[0]}").errors(("a/000000", "b/000000"), [0, 1])


ROW = NUMBERS[0]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([ROW, "1 2 3 4 5"], "line 2: a start has an invalid form.*got 5 words"),
        ([ROW, f"name {ROW}"], "line 2: a start differs in form from previous ones.*expected 6 words; got 7"),
        ([ROW, "0 0 nan 0 0 0"], "line 2: a start contains a word that is not a finite number.*'nan'"),
        (["0 0 1e999 0 0 0"], "line 1: a start contains a word that is not a finite number"),
        ([ROW, "0 0 0,1 0 0 0"], "line 2: a start has an invalid form"),
        ([ROW, "0 0 O.1 0 0 0"], "line 2: a start contains a word that is not a finite number.*'O.1'"),
        ([ROW, "0 0 1_0 0 0 0"], "line 2: a start contains a word that is not a finite number"),
        ([ROW, "a b c d e f"], "line 2: a start contains a word that is not a finite number"),
        ([f"a {ROW}", f"a {ROW}"], "line 2: a frame has two starts; got 'a'"),
        (["r1 r2 r3 t1 t2 t3"], "is empty"),
        (["id,tx,ty,tz,rx,ry,rz", "0,0,0,0,0,0,0"], "line 1: the columns of starts are in another order"),
        ([ROW, "0 0 4 0 0 0"], "line 2: the rotation of a start is too large.*multiply degrees"),
        ([ROW, "0 0 0 -4 -76 -270"], "line 2: the translation of a start is too long.*millimetres"),
        ([ROW, "0 0 0 0 0 101"], "line 2: the translation of a start is too long.*100 m"),
        (["1 0 0 0 0 1 0 0 0 0 2 0"], "line 1: .*the start"),
        (["1 0 0 200 0 1 0 0 0 0 1 0"], "line 1: the translation of a start is too long"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_its_line(tmp_path: Path, lines: list[str], message: str) -> None:
    with pytest.raises(InputError, match=f"(?s){message}") as caught:
        written(tmp_path, *lines).errors(("a",), [0])
    assert "\n" not in str(caught.value)
    assert "starts.txt" in str(caught.value)
    for path in (tmp_path / "absent.txt", tmp_path):
        with pytest.raises(InputError, match="the list of starts is"):
            StartList(str(path)).errors(("a",), [0])
