"""The one family of errors a user can meet: each says what, where, expected, got and what to do next."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable


def printable(text: str) -> str:
    r"""Return a text whose control characters, line breaks and halves of surrogates are written out, such as \x1b.

    Names come from files: shown as they are, they would move the cursor, recolour a terminal or turn words around.
    """
    if text.isprintable():
        return text
    return "".join(
        c if c.isprintable() or unicodedata.category(c) == "Zs" else c.encode("unicode_escape").decode() for c in text
    )


class P2OError(Exception):
    """Root of all errors that p2o raises on purpose; its text is one line, ready to show.

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
        text = what if where is None else f"{where}: {what}"
        if expected is not None:
            text += f"; expected {expected}"
        if got is not None:
            text += f"; got {got}"
        if hint is not None:
            text += f"; {hint}"
        super().__init__(" ".join(text.split()))


class InputError(P2OError):
    """A file, array or option from outside is not what it must be."""


class UnknownNameError(InputError):
    """A method, option, dataset, frame or split that does not exist; names the nearest ones."""

    def __init__(self, kind: str, name: str, known: Iterable[str], *, where: object = None, hint: str = "") -> None:
        self.kind, self.name, self.known = kind, name, sorted(known)
        near = difflib.get_close_matches(name, self.known, n=3, cutoff=0.5)
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
