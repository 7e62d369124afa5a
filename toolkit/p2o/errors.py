"""The one family of errors a user can meet: each says what, where, expected, got and what to do next."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable

_UNSEEN = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Categories of characters that a terminal obeys instead of showing them, or that no encoding holds."""
_JOINERS = "\u200c\u200d"
"""Characters of these categories that ordinary words of some languages hold."""
LONGEST = 1000
"""So many characters of each part of an error are shown."""


def printable(text: object, longest: int | None = None) -> str:
    """Return a text that a terminal only shows: control and direction characters and surrogates as Python escapes.

    With `longest`, the middle of a longer text is left out. Names of frames and files come from outside: one of them
    must not move the cursor, change colours, or end a program that prints it.
    """
    said = _text(text)
    if longest is not None and len(said) > longest:
        said = f"{said[: longest // 2]} ... {said[-(longest // 2) :]}"
    if said.isascii() and said.isprintable():
        return said
    return "".join(c if c in _JOINERS or unicodedata.category(c) not in _UNSEEN else _escaped(c) for c in said)


def one_line(text: object, longest: int | None = None) -> str:
    """Return a text as `printable`, in one line: white space of any kind is one blank."""
    return printable(" ".join(_text(text).split()), longest)


def _text(value: object) -> str:
    try:
        return str(value)
    except ValueError:  # more digits than Python writes
        return "a number of too many digits to write"


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")


class P2OError(Exception):
    """Root of all errors that p2o raises on purpose; its text is one line, ready to show, and has a bound.

    `exit_code` is what the command line returns for it: 2 for wrong input or usage.
    """

    exit_code = 2

    def __init__(
        self,
        what: str,
        *,
        where: object = None,
        expected: object = None,
        got: object = None,
        hint: str | None = None,
    ) -> None:
        self.what, self.where, self.expected, self.got, self.hint = what, where, expected, got, hint
        text = "" if where is None else f"{one_line(where, LONGEST)}: "
        text += one_line(what, LONGEST)
        for word, part in (("expected ", expected), ("got ", got), ("", hint)):
            if part is not None:
                text += f"; {word}{one_line(part, LONGEST)}"
        super().__init__(text)


class InputError(P2OError):
    """A file, array or option from outside is not what it must be."""


class UnknownNameError(InputError):
    """A method, option, dataset, frame or split that does not exist; names the nearest ones, then the `advice`."""

    def __init__(self, kind: str, name: str, known: Iterable[str], *, where: object = None, hint: str = "") -> None:
        self.kind, self.name, self.known, self.advice = kind, name, sorted(known), hint
        # Comparing takes time by length and number: nobody mistypes a page of text.
        near = difflib.get_close_matches(name, self.known[:5000], n=3, cutoff=0.5) if len(name) <= 200 else []
        listed = ", ".join(self.known[:20]) + (", ..." if len(self.known) > 20 else "")
        hints = [f"did you mean {' or '.join(near)}?"] if near else []
        hints += [hint] if hint else []
        super().__init__(
            f"unknown {kind} '{name}'",
            where=where,
            expected=f"one of: {listed or '(none available)'}",
            hint="; ".join(hints) or None,
        )


class PluginError(P2OError):
    """A plugin fails to import, clashes with another, raises, or returns what it must not."""


class MethodUnavailable(P2OError):  # noqa: N818  (a state of the installation, not a defect)
    """A method needs a package that is not installed; the text tells the pip command."""
