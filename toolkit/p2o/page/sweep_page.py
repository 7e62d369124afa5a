"""The page of `p2o data show`: the sweep on the image of some frames, in one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from p2o.arrays import UInt8
from p2o.draw.image_uri import jpeg_uri
from p2o.page import page

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
    guide = (
        "Objects of the sweep and of the image must coincide up to the error of the initial guess: a pole on the "
        "pole, the road on the road. A rotated sweep, or one in the sky, indicates a wrong pose, other axes or "
        "another camera."
    )
    blocks = [page.text(f"{data}: {len(shown)} of {total} frames", "quiet"), page.text(guide)]
    size = 0
    for one in shown:
        source = jpeg_uri(one.image) if size < _MOST_CHARS else ""
        size += len(source)
        caption = f"{one.seen} of {one.points} points in the image, at {one.at}; {one.file}"
        image = {"kind": "image", "source": source, "name": caption} if source else page.text(f"see {one.file}")
        blocks.append(page.section(one.name, image, *([] if source else [page.text(caption, "quiet")]), ruled=True))
    return page.page("The sweep on the image", blocks)
