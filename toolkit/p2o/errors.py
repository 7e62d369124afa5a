"""The exceptions for users: each states the fault, its place, expected and actual value, and the next step."""

from __future__ import annotations

import difflib
import unicodedata
from collections.abc import Iterable

_UNSEEN = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode categories of characters that terminals interpret or that cannot be encoded."""
_JOINERS = "\u200c\u200d"
"""Characters of these categories that occur in words of some languages."""
LONGEST = 1000
"""Maximum number of characters of each part of an error."""


def printable(text: object, longest: int | None = None) -> str:
    """Return a text with control and direction characters and surrogates as Python escapes, safe for terminals.

    With `longest`, the middle of a longer text is left out. Names of frames and files are untrusted: they must not
    move the cursor, change colours or cause encoding errors.
    """
    shown = _text(text)
    if longest is not None and len(shown) > longest:
        shown = f"{shown[: longest // 2]} ... {shown[-(longest // 2) :]}"
    if shown.isascii() and shown.isprintable():
        return shown
    hidden = {c for c in set(shown) - set(_JOINERS) if unicodedata.category(c) in _UNSEEN}
    return "".join(c.encode("unicode_escape", "surrogatepass").decode() if c in hidden else c for c in shown)


def one_line(text: object, longest: int | None = None) -> str:
    """Return a text as `printable`, with each sequence of white space replaced by one blank."""
    return printable(" ".join(_text(text).split()), longest)


def _text(value: object) -> str:
    """Return the text of any object: an exception of a plugin may raise while it is converted."""
    try:
        return str(value)
    except (Exception, SystemExit) as problem:
        if isinstance(value, int):  # more digits than Python writes
            return "a number of too many digits to write"
        return f"no text, because {type(value).__name__}.__str__ raises {type(problem).__name__}"


class P2OError(Exception):
    """Base of all exceptions for users; the text is one printable line of limited length.

    `exit_code` is the exit status of the command line: 2 for wrong input or usage.
    """

    exit_code = 2

    def __init__(
        self, what: str, *, where: object = None, expected: object = None, got: object = None, hint: str | None = None
    ) -> None:
        self.what, self.where, self.expected, self.got, self.hint = what, where, expected, got, hint
        text = "" if where is None else f"{one_line(where, LONGEST)}: "
        text += one_line(what, LONGEST)
        for word, part in (("expected ", expected), ("got ", got), ("", hint)):
            if part is not None:
                text += f"; {word}{one_line(part, LONGEST)}"
        super().__init__(text)


class InputError(P2OError):
    """A file, array or option is invalid."""


class UnknownNameError(InputError):
    """A method, option, dataset, frame or split does not exist; the text suggests similar names, then `advice`."""

    def __init__(self, kind: str, name: str, known: Iterable[str], *, where: object = None, hint: str = "") -> None:
        self.kind, self.name, self.known, self.advice = kind, name, sorted(known), hint
        # The time of the comparison grows with length and number, hence the limits.
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
    """A plugin fails to import, clashes with another one, raises, or returns an invalid value."""


class MethodUnavailable(P2OError):  # noqa: N818  (a state of the installation, not a defect)
    """A method needs a package that is not installed; the text contains the pip command."""


class Terminated(KeyboardInterrupt):
    """A signal asks the process to end, as Ctrl-C does; unlike KeyboardInterrupt no plugin raises it."""


def terminate(number: int, frame: object) -> None:
    """Raise Terminated: the handler of signals that end the process."""
    raise Terminated
