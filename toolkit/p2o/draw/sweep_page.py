"""The page of `p2o data show`: the sweep on the image of some frames, in one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from p2o.arrays import UInt8
from p2o.draw.one_file import jpeg_uri, rendered

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
    uris: list[str] = []
    for one in shown:
        uris.append(jpeg_uri(one.image) if sum(map(len, uris)) < _MOST_CHARS else "")
    return rendered(
        "p2o.draw/sweep_page.html",
        style="p2o.draw/run_page.css",
        title="The sweep on the image",
        data=data,
        shown=list(zip(shown, uris, strict=True)),
        total=total,
    )
