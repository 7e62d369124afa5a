"""The page of `p2o data show`: the sweep on the image of some frames, in one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from p2o.arrays import UInt8
from p2o.errors import printable
from p2o.report.one_file import filled, jpeg_uri, part

PAGE = "index.html"
_MOST_CHARS = 24_000_000


@dataclass(frozen=True, eq=False)
class ShownSweep:
    """One frame: the file of its picture (H, W, 3), at what pose, and how many of its points are in the image."""

    name: str
    file: str
    at: str
    seen: int
    points: int
    picture: UInt8


def sweep_page(data: str, shown: Sequence[ShownSweep], total: int) -> str:
    """Return the page; once pictures take 24 MB, further frames name their file only."""
    blocks, size = [], 0
    for one in shown:
        uri = jpeg_uri(one.picture) if size < _MOST_CHARS else ""
        size += len(uri)
        name, file, at = map(_text, (one.name, one.file, one.at))
        image = f'<img src="{uri}" alt="the sweep on the image, {name}">' if uri else f"<p>see {file}</p>"
        told = f"{one.seen} of {one.points} points in the image, at {at}; {file}"
        blocks.append(f"<article><h2>{name}</h2><figure>{image}<figcaption>{told}</figcaption></figure></article>")
    parts = {
        "title": "The sweep on the image",
        "style": part("run_page.css"),
        "summary": _text(f"{data}: {len(shown)} of {total} frames"),
        "frames": "\n".join(blocks),
    }
    return filled("sweep_page.html", parts, scripts=())


def _text(text: str) -> str:
    return escape(printable(text, 2000))
