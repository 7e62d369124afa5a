"""Errors are one line that any terminal only shows, and that has a bound."""

from __future__ import annotations

import unicodedata

import pytest
from p2o import InputError, UnknownNameError
from p2o.errors import one_line, printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("drive/0001", "drive/0001"),
        ("Straße 東京 ﷽", "Straße 東京 ﷽"),
        ("\x1b[31mred\x07", r"\x1b[31mred\x07"),
        ("c1 \x9b2J, del \x7f, nul \x00", r"c1 \x9b2J, del \x7f, nul \x00"),
        ("\u202egnp.exe\u2066", r"\u202egnp.exe\u2066"),
        ("a\nb\tc\u2028", r"a\nb\tc\u2028"),
        ("not utf-8 \udcff", r"not utf-8 \udcff"),
        ("a\u200cb\u200dc", "a\u200cb\u200dc"),
    ],
)
def test_what_a_terminal_would_obey_is_shown_as_an_escape(text: str, shown: str) -> None:
    assert printable(text) == shown
    shown.encode()


def test_every_part_of_an_error_is_shown_in_one_line_of_bounded_length_with_both_ends() -> None:
    bad = "a\x1b[2J\u202e\udcff\nb"
    problem = InputError(bad, where=bad, expected=bad, got=bad, hint=bad)
    said = r"a\x1b[2J\u202e\udcff b"
    assert str(problem) == f"{said}: {said}; expected {said}; got {said}; {said}"
    assert (problem.where, problem.got) == (bad, bad), "the parts themselves stay as they are"
    assert not [c for c in str(problem) if unicodedata.category(c) in ("Cc", "Cf", "Cs")]
    long = "begin" + 10_000_000 * "x" + "end"
    text = str(InputError(long, where=long, got=long))
    assert len(text) < 4000
    assert text.startswith("beginxxx")
    assert text.endswith("xxxend")
    assert len(str(UnknownNameError("frame", long, [f"{i}" * 1000 for i in range(1000)]))) < 4000
    assert str(InputError("too large", got=10**10000)) == "too large; got a number of too many digits to write"


@pytest.mark.parametrize("raised", [RuntimeError, SystemExit, RecursionError, ValueError])
def test_an_exception_whose_text_raises_is_named(raised: type[BaseException]) -> None:
    class TextlessError(Exception):
        def __str__(self) -> str:
            raise raised

    assert one_line(TextlessError()) == f"no text, because TextlessError.__str__ raises {raised.__name__}"
    assert str(InputError("failed", got=TextlessError())).endswith(f"raises {raised.__name__}")
