from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import InputError
from p2o_datasets import number_text
from p2o_datasets.number_text import read_table

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


def test_lines_that_never_end_and_too_many_numbers_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="a line of more than"):
        read_table(b"1 " * (1 << 20), 2, PATH)
    monkeypatch.setattr(number_text, "MAX_NUMBERS", 9)
    with pytest.raises(InputError, match="too many numbers; expected at most 9"):
        read_table(b"1 2\n" * 5, 2, PATH)
