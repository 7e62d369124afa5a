"""The page of `p2o data show`: the sweep on the image of some frames, in one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from p2o.arrays import UInt8
from p2o.draw.one_file import filled, jpeg_uri, part
from p2o.errors import printable

PAGE = "index.html"
_MOST_CHARS = 24_000_000


@dataclass(frozen=True, eq=False)
class ShownSweep:
    """One frame: the file of its overlay (H, W, 3), the name of the pose, and the number of points in the image."""

    name: str
    file: str
    at: str
    seen: int
    points: int
    image: UInt8


def sweep_page(data: str, shown: Sequence[ShownSweep], total: int) -> str:
    """Return the page; above 24 MB of overlays, further frames only name their file."""
    blocks, size = [], 0
    for one in shown:
        uri = jpeg_uri(one.image) if size < _MOST_CHARS else ""
        size += len(uri)
        name, file, at = map(_text, (one.name, one.file, one.at))
        element = f'<img src="{uri}" alt="the sweep on the image, {name}">' if uri else f"<p>see {file}</p>"
        caption = f"{one.seen} of {one.points} points in the image, at {at}; {file}"
        blocks.append(f"<article><h2>{name}</h2><figure>{element}<figcaption>{caption}</figcaption></figure></article>")
    parts = {
        "title": "The sweep on the image",
        "style": part("run_page.css"),
        "summary": _text(f"{data}: {len(shown)} of {total} frames"),
        "frames": "\n".join(blocks),
    }
    return filled(part("sweep_page.html"), parts, scripts=())


def _text(text: str) -> str:
    return escape(printable(text, 2000))
