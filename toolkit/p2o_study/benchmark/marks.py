"""Parts of Markdown pages that are written from rows, records and cards of data, between marks.

A part is between `<!-- KIND: SUBJECT; NAME: VALUES; ... -->` and `<!-- /KIND -->`, both on lines of their own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from p2o.errors import InputError

MARKS = {
    "rows": "<!-- rows: SUITE, SECTION; data: A, B; methods: X, Y -->",
    "record": "<!-- record: NAME; tables: 1, 3 -->",
    "cards": "<!-- cards -->",
    "published": "<!-- published: SUITE, SECTION -->",
    "methods": "<!-- methods -->",
}
"""The first line of a part by its kind; only SUITE and NAME are needed."""
_HEAD = re.compile(rf"^<!-- (?:{'|'.join(MARKS)})\b", re.MULTILINE)
_PART = re.compile(
    rf"^<!-- (?P<kind>{'|'.join(MARKS)})(?:: (?P<subject>[^>;\n]+?)(?P<choices>(?:; [^>;\n]+?)*))? -->\n"
    rf"(?P<text>(?:(?!{_HEAD.pattern}).)*?)^<!-- /(?P=kind) -->$",
    re.DOTALL | re.MULTILINE,
)
Writer = Callable[[str, Mapping[str, str]], str]
"""Returns the text of a part by its subject and choices; raises KeyError or ValueError for choices that are unknown."""


def rendered(text: str, where: str, writers: Mapping[str, Writer]) -> str:
    """Return a page with its marked parts replaced by what the writer of each kind returns.

    Raises InputError, with file and line, for a mark that is not valid or not closed.
    """
    parts = {part.start(): part for part in _PART.finditer(text)}
    pieces, end = [], 0
    for head in _HEAD.finditer(text):
        try:
            part = parts[head.start()]
            choices = dict(words.split(": ", 1) for words in filter(None, (part["choices"] or "").split("; ")))
            written = writers[part["kind"]](part["subject"] or "", choices)
        except (KeyError, ValueError) as problem:
            place = f"{where}:{text.count(chr(10), 0, head.start()) + 1}"
            expected = f"{' or '.join(MARKS.values())} on its own line and <!-- /rows --> and so on after it"
            raise InputError("a marked part is not valid", where=place, expected=expected) from problem
        pieces += [text[end : part.start("text")], written]
        end = part.end("text")
    return "".join([*pieces, text[end:]])
