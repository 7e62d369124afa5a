from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import InputError
from p2o_datasets import number_text
from p2o_datasets.number_text import as_stored, read_table

PATH = Path("a.txt")


def test_pieces_of_a_long_text_make_one_table(monkeypatch: pytest.MonkeyPatch) -> None:
    table = np.random.default_rng(0).normal(size=(500, 3))
    text = "\n".join(" ".join(map(str, row)) for row in table.tolist()).encode()
    monkeypatch.setattr(number_text, "_PIECE", 300)
    assert np.array_equal(read_table(text, 3, PATH), table)
    assert np.array_equal(read_table(text, 3, PATH, most=77), table[:77])


def test_blank_lines_do_not_count_and_nan_and_inf_are_numbers() -> None:
    table = read_table(b"\n1 nan\n\n  \n-inf 1e999\n", 2, PATH)
    assert np.array_equal(table, [[1, np.nan], [-np.inf, np.inf]], equal_nan=True)
    assert read_table(b" \n\n", 2, PATH).shape == (0, 2)


@pytest.mark.parametrize("text", [b"1 2 x", b"1 2 0x10", b"1 2 " + b"9" * 100000 + b"e"])
def test_what_is_no_number_is_refused_by_name(text: bytes) -> None:
    with pytest.raises(InputError, match=r"a\.txt: the points are not numbers") as refusal:
        read_table(text, 3, PATH)
    assert len(str(refusal.value)) < 300


@pytest.mark.parametrize("text", [b"1 2 3 4\n1 2 3 4\n", b"1 2 3\n4 5 6\n7 8\n", b"1 2 3\n4 5 6 7 8 9\n"])
def test_lines_of_another_length_are_refused_even_if_the_numbers_would_do(text: bytes) -> None:
    with pytest.raises(InputError, match=r"truncated or has other columns; expected 3 numbers per line"):
        read_table(text, 3, PATH)


def test_lines_that_never_end_and_too_many_numbers_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="a line of more than"):
        read_table(b"1 " * (1 << 20), 2, PATH)
    monkeypatch.setattr(number_text, "MAX_NUMBERS", 9)
    with pytest.raises(InputError, match="too many numbers; expected at most 9"):
        read_table(b"1 2\n" * 5, 2, PATH)


def test_whole_numbers_stay_so_unless_they_are_too_large() -> None:
    assert as_stored(np.array([1.0, -2.0]), "u").dtype == np.int64
    assert as_stored(np.array([1.0, 1e19]), "u").dtype == np.float64
    assert as_stored(np.array([1.0, np.nan]), "i").dtype == np.float64
    assert as_stored(np.array([1.0]), "f").dtype == np.float64
