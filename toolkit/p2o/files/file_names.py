"""Names of frames as names of files: safe on every system, and two frames never share one."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Sequence

_LONGEST = 120


def folder_name(frame: str) -> str:
    """Return a frame's name as one folder name: date/drive/frame becomes date_drive_frame."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", frame).strip("._") or "frame"


def distinct_names(frames: Sequence[str]) -> dict[str, str]:
    """Return by frame a file name without suffix; where two would be one file, or too long, a hash tells them apart.

    Case does not tell files apart on every system, so it does not count.
    """
    slugs = {frame: folder_name(frame) for frame in frames}
    count = Counter(slug.lower() for slug in slugs.values())
    found = {f: slug for f, slug in slugs.items() if count[slug.lower()] == 1 and len(slug) <= _LONGEST}
    taken = {name.lower() for name in found.values()}
    for frame, slug in slugs.items():
        if frame not in found:
            digest = hashlib.sha256(frame.encode("utf-8", "surrogatepass")).hexdigest()
            # A frame may be called just like another one with its hash.
            names = (f"{slug[:_LONGEST]}-{digest[:length]}" for length in range(10, len(digest) + 1))
            found[frame] = next(name for name in names if name.lower() not in taken)
            taken.add(found[frame].lower())
    return {frame: found[frame] for frame in slugs}
