"""One HTML page in one file: its description as data, drawn by one script; its policy blocks all requests.

A page is a title and blocks. A block is a dict with the `kind` by which page.js draws it, from the functions here; all
texts become text nodes there, so that no name can be markup. Tables have columns that data describe; where a table is
wider than the page, its least important columns are hidden, and what a row opens begins with them.
"""

from __future__ import annotations

import base64
import hashlib
import importlib.resources
import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Literal

from p2o.errors import printable
from p2o.files.whole_file import write_errors, write_whole

Block = dict[str, Any]
Look = Literal["", "good", "warn", "bad", "quiet", "lead", "notice"]
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f7f")
"""Colours for colour-blind readers (Okabe and Ito); series also differ in their markers."""
TRUST_LOOKS = {"trusted": "good", "ambiguous": "warn", "doubtful": "warn", "refused": "bad"}
DATA = "data"
"""The folder of files that a page loads when a row is opened."""
_LONGEST = 5000
"""Maximum number of characters of a text on a page."""
_SIGNIFICANT = 6


@dataclass(frozen=True)
class Column:
    """A column: its name and unit, `digits` of numbers, and whether it contains `text`.

    Columns with a large `hide` are hidden first where there is too little space, those with 0 never. A column with an
    `option` is shown when the checkbox of that name is ticked, one that is `off` is for filters, search and plots only.
    `order` are its texts in their order, `looks` the look by text. `of` returns the cell of what a row shows.
    """

    name: str
    unit: str | None = None
    digits: int | None = None
    text: bool = False
    hide: int = 1
    option: str | None = None
    off: bool = False
    order: Sequence[str] | None = None
    looks: Mapping[str, str] | None = None
    of: Callable[[Any], Any] | None = None


def cell(value: Any, text: str | None = None, below: str | None = None, look: str | None = None) -> dict[str, Any]:
    """Return a cell: `value` is sorted by, `text` is shown (default: the value), `below` in a second line."""
    return _brief({"v": value, "t": text, "s": below, "c": look})


def interval(ends: Sequence[float | None], look: str | None = None) -> dict[str, Any]:
    """Return a cell of a number with its interval, if there is one: value, low, high."""
    return _brief({**dict(zip(("v", "lo", "hi"), map(brief, ends), strict=True)), "c": look})


def brief(value: float | str | None) -> float | None:
    """Return a number with 6 significant digits; None for None and non-finite values, which stores keep as text."""
    return None if value is None or not math.isfinite(float(value)) else float(f"{float(value):.{_SIGNIFICANT}g}")


def number_text(value: Any, places: int) -> str:
    """Return a number with these decimals, "-" for other values and numbers that are not finite."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "-"
    return f"{value:.{places}f}"


# ---- blocks


def text(words: str, look: Look = "", mark: str = "") -> Block:
    """Return a paragraph; `mark` is a verdict before it."""
    return _brief({"kind": "text", "text": words, "look": look or None, "mark": (mark and _mark(mark)) or None})


def _mark(word: str) -> dict[str, str]:
    return {"text": word, "look": TRUST_LOOKS.get(word, "bad")}


def items(texts: Sequence[str]) -> Block:
    """Return a list of texts."""
    return {"kind": "items", "texts": list(texts)}


def facts(rows: Sequence[tuple[str, str]]) -> Block:
    """Return a table of names and texts."""
    return {"kind": "facts", "rows": [list(row) for row in rows]}


def code(content: str, title: str = "", *, paste: bool = False) -> Block:
    """Return a text of several lines in a box; a click selects it if it is to `paste`."""
    return _brief({"kind": "code", "text": content, "title": title or None, "paste": paste or None})


def section(title: str, *blocks: Block, name: str = "", ruled: bool = False) -> Block:
    """Return blocks under a heading; `name` is the target of links."""
    return _brief({"kind": "section", "title": title, "blocks": blocks, "id": name or None, "ruled": ruled or None})


def part(title: str, *blocks: Block) -> Block:
    """Return blocks under a small heading."""
    return {"kind": "part", "title": title, "blocks": blocks}


def grid(*blocks: Block, least: int = 420) -> Block:
    """Return blocks side by side, each at least this number of px wide."""
    return {"kind": "grid", "blocks": blocks, "least": least}


def fold(title: str, *blocks: Block) -> Block:
    """Return blocks that a click unfolds."""
    return {"kind": "fold", "title": title, "blocks": blocks}


def choice(label: str, options: Mapping[str, Sequence[Block]], first: int = 0) -> Block:
    """Return blocks of which one sequence is shown, by name."""
    return _brief(
        {"kind": "choice", "label": label, "names": list(options), "options": [*options.values()], "first": first}
    )


def slides(
    name: str,
    left: Any,
    right: Any,
    ends: tuple[str, str] = ("before", "after"),
    size: tuple[int, int] | None = None,
    *,
    lazy: bool = False,
) -> Block:
    """Return two superimposed images, sources of `size` (width, height), with a slider between them."""
    width, height = size or (None, None)
    block = {"kind": "slides", "name": name, "ends": ends, "left": left, "right": right, "lazy": lazy or None}
    return _brief({**block, "width": width, "height": height})


def table(
    columns: Sequence[Column] | Mapping[str, int],
    rows: Sequence[Any],
    *,
    name: str = "",
    search: bool = False,
    filters: Sequence[str | tuple[str, str]] = (),
    tiles: str = "",
    group: str = "",
    opens: Sequence[Any] = (),
    looks: Sequence[str | None] = (),
    counted: str = "",
) -> Block:
    """Return a table; a click on a column sorts it.

    With `search` it has a search box and is saved as CSV, `filters` are columns whose values can be selected, with the
    first value if it is not all of them; that of `tiles` has a button for each value with the number of its rows.
    `group` is the column of the headings between rows. `opens` is what rows open: `detail`, `link`, `rows_of` or
    `row_of`; `looks` are those of rows. `rows` are lists of cells, or what the columns take cells of.
    `columns` may be shared.
    """
    if not isinstance(columns, Mapping) and columns[0].of is not None:
        rows = [cells(columns, row) for row in rows]
    pairs = [(one, None) if isinstance(one, str) else one for one in filters]
    chosen = [_brief({"column": column, "first": first, "tiles": column == tiles or None}) for column, first in pairs]
    return _brief(
        {
            "kind": "table",
            "columns": columns if isinstance(columns, Mapping) else columns_of(columns),
            "rows": rows,
            "name": name or None,
            "small": (not name) or None,
            "search": search or None,
            "filters": chosen or None,
            "group": group or None,
            "opens": opens if any(opens) else None,
            "looks": looks if any(looks) else None,
            "counted": counted or None,
        }
    )


def cells(columns: Sequence[Column], row: Any) -> list[Any]:
    """Return the cells of what a row shows."""
    return [None if column.of is None else column.of(row) for column in columns]


def columns_of(columns: Sequence[Column]) -> list[dict[str, Any]]:
    """Return columns as plain data."""
    return [_brief({**vars(one), "of": None, "text": one.text or None, "off": one.off or None}) for one in columns]


def detail(title: str, *blocks: Block) -> dict[str, Any]:
    """Return blocks that a row opens."""
    return {"title": title, "blocks": blocks}


def detail_of_file(title: str, file: str, place: int = 0) -> dict[str, Any]:
    """Return what a row opens from a file that `write_data` writes: the blocks at a place."""
    return {"title": title, "file": file, "place": place}


def link(target: str) -> dict[str, Any]:
    """Return the link to a section that a row opens."""
    return {"href": f"#{target}"}


def rows_of(name: str, **where: str) -> dict[str, Any]:
    """Return the rows of another table, by values of its filters, that a row shows."""
    return {"table": name, "where": where}


def row_of(name: str, row: int) -> dict[str, Any]:
    """Return the row of another table that a row opens."""
    return {"table": name, "row": row}


class Shared:
    """Values that several blocks use, each once on the page."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self._numbers: dict[str, int] = {}
        self.size = 0

    def use(self, value: Any) -> dict[str, int]:
        """Return the reference to a value, which is added if it is new."""
        key = json.dumps(value, sort_keys=True)
        if key not in self._numbers:
            self._numbers[key] = len(self.values)
            self.values.append(value)
            self.size += len(key)
        return {"use": self._numbers[key]}


# ---- the page and its files


def page(
    title: str,
    blocks: Sequence[Block],
    *,
    shared: Shared | None = None,
    script_files: bool = False,
    image_files: bool = False,
) -> str:
    """Return the HTML of a page; only its own script may run, and it may load nothing.

    With `script_files` it may load scripts from the folder of the page, and from nowhere else; with `image_files` it
    may load images from there.
    """
    script, style, template = (_part(name) for name in ("page.js", "page.css", "page.html"))
    # A file has no origin in all browsers: 'self' is that of a server, file: that of a page that is opened from disk.
    files = ("'self'", "file:")
    images = " ".join(["img-src", "data:", "blob:", *(files if image_files else ())])
    policy = f"default-src 'none'; {images}; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
    policy += " ".join(["script-src", _source_hash(script), *(files if script_files else ())])
    data = {"title": title, "blocks": blocks, "shared": shared.values if shared else [], "colours": COLOURS}
    values = {
        "policy": policy,
        "title": escape(printable(title, _LONGEST)),
        "style": style,
        "script": script,
        # No text can end the script element.
        "data": plain_json(data).replace("<", "\\u003c"),
    }
    return re.sub(r"\{\{ (\w+) \}\}", lambda match: values[match[1]], template)


def prepare_data(folder: Path) -> None:
    """Create the folder of a page and that of its data, and remove the data of an earlier page.

    Raises InputError if it cannot be written.
    """
    with write_errors("the page", folder, "choose another --out"):
        (folder / DATA).mkdir(parents=True, exist_ok=True)
        for path in (folder / DATA).glob("*.js"):
            path.unlink()


def write_data(folder: Path, name: str, details: Sequence[Sequence[Block]]) -> None:
    """Write the blocks that rows open, in a file that the page in a folder loads then."""
    write_whole(folder / DATA / f"{name}.js", f"receive({json.dumps(name)},{plain_json(details)});\n".encode())


def plain_json(value: Any) -> str:
    """Return JSON with control characters in texts escaped, except for newlines."""
    return json.dumps(_plain(value), allow_nan=False, ensure_ascii=False, separators=(",", ":"))


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        # The addresses of images are long.
        most = len(value) if value.startswith("data:image/") else _LONGEST
        return "\n".join(printable(line, most) for line in value.split("\n"))
    if isinstance(value, Mapping):
        return {_plain(key): _plain(one) for key, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value


def _brief(block: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in block.items() if value is not None}


def _part(name: str) -> str:
    return importlib.resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def _source_hash(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
