"""The file of pairs: what is written is read again, by hand or by the page, and anything else is refused in a line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from p2o import InputError
from p2o.problems.picked_pairs import PickedPairs, read_pairs, write_pairs

PAIRS = PickedPairs(np.array([[1.5, 2.25], [300, 7]]), np.array([[1.0, -2, 3], [10.123456, 0, -1.5]]))


@pytest.mark.parametrize("name", ["pairs.yaml", "pairs.json", "pairs.yml"])
def test_what_is_written_is_read_again(tmp_path: Path, name: str) -> None:
    frames = {"2011_09_26/drive_0005/0000000000": PAIRS, 'odd: "name" #1\n': PickedPairs.none(), "0001": PAIRS}
    write_pairs(tmp_path / name, frames)
    again = read_pairs(tmp_path / name)
    assert list(again) == list(frames)
    for key, pairs in frames.items():
        np.testing.assert_array_equal(again[key].uv, pairs.uv)
        np.testing.assert_array_equal(again[key].xyz, pairs.xyz)
    if name != "pairs.json":
        line = '    - {"uv": [1.5, 2.25], "xyz": [1.0, -2.0, 3.0]}'
        assert line in (tmp_path / name).read_text().splitlines(), "a pair is a line"
    write_pairs(tmp_path / name, {})
    assert read_pairs(tmp_path / name) == {}


def test_a_file_written_by_hand_is_read_and_more_pairs_than_anyone_picks_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "pairs.yaml"
    path.write_text("frames:\n  street:\n    - {uv: [10, 20.5], xyz: [5, 0, -1]}\n")
    np.testing.assert_array_equal(read_pairs(path)["street"].xyz, [[5, 0, -1]])
    path = tmp_path / "pairs.json"
    path.write_text(json.dumps({"frames": {"a": [{"uv": [1, 2], "xyz": [1, 2, 3]}] * 10_001}}))
    with pytest.raises(InputError, match=r"frames\.a"):
        read_pairs(path)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("[1, 2]", "another form"),
        ("{}", "another form"),
        ("{frames: [1]}", "another form"),
        ("{frames: {1: []}}", "quotation marks"),
        ("{frames: {a: []}, more: 1}", "more"),
        ("{frames: {a: [{uv: [1, 2]}]}}", "frames.a.0.xyz"),
        ("{frames: {a: [{uv: [1, 2, 3], xyz: [1, 2, 3]}]}}", "frames.a.0.uv"),
        ("{frames: {a: [{uv: [1, .nan], xyz: [1, 2, 3]}]}}", "frames.a.0.uv"),
        ("{frames: {a: [{uv: [1, .inf], xyz: [1, 2, 3]}]}}", "frames.a.0.uv"),
        ("{frames: {a: [{uv: [1, 1.0e+30], xyz: [1, 2, 3]}]}}", "frames.a.0.uv"),
        ("{frames: {a: [{uv: [1, '2'], xyz: [1, 2, 3]}]}}", "frames.a.0.uv"),
        ("{frames: {a: [{uv: [1, true], xyz: [1, 2, 3]}]}}", "frames.a.0.uv"),
        ("{frames: {a: {}}}", "frames.a"),
        ("{frames: {a: [&x {uv: [1, 2], xyz: [1, 2, 3]}, *x]}}", "alias"),
    ],
)
def test_anything_else_is_refused_with_its_place(tmp_path: Path, text: str, word: str) -> None:
    path = tmp_path / "pairs.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=word) as told:
        read_pairs(path)
    assert "pairs.yaml" in str(told.value)


_plain = st.floats(-1e7, 1e7).map(lambda x: round(x, 3))


@settings(max_examples=40)
@given(st.lists(st.tuples(*[_plain] * 5), max_size=5))
def test_any_numbers_are_read_again(tmp_path_factory: pytest.TempPathFactory, rows: list[tuple[float, ...]]) -> None:
    table = np.reshape(rows, (-1, 5))
    path = tmp_path_factory.mktemp("pairs") / "pairs.yaml"
    write_pairs(path, {"a": PickedPairs(table[:, :2], table[:, 2:])})
    again = read_pairs(path)["a"]
    np.testing.assert_array_equal(again.uv, table[:, :2])
    np.testing.assert_array_equal(again.xyz, table[:, 2:])
