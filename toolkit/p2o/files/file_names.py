"""Convert names of frames to distinct file names that are valid on every system."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Collection, Sequence

_LONGEST = 120
_DEVICES = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
"""Reserved file names of Windows, with any suffix."""


def folder_name(frame: str) -> str:
    """Return the name of a frame as the name of one folder: date/drive/frame becomes date_drive_frame."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", frame).strip("._") or "frame"


def distinct_names(frames: Sequence[str], taken: Collection[str] = ()) -> dict[str, str]:
    """Return by frame a distinct file name without suffix.

    A hash is appended to names that would clash (ignoring case), are too long, in `taken`, or reserved.
    """
    slugs = {frame: folder_name(frame) for frame in frames}
    devices = {frame: slug.replace(".", "_") for frame, slug in slugs.items() if _DEVICES.fullmatch(slug)}
    slugs |= devices
    count = Counter([*(slug.lower() for slug in slugs.values()), *(name.lower() for name in taken)])
    names = {
        frame: slug
        for frame, slug in slugs.items()
        if count[slug.lower()] == 1 and len(slug) <= _LONGEST and frame not in devices
    }
    used = {name.lower() for name in (*names.values(), *taken)}
    for frame, slug in slugs.items():
        if frame not in names:
            digest = hashlib.sha256(frame.encode("utf-8", "surrogatepass")).hexdigest()
            # A longer part of the hash is used if another frame has the name with the hash.
            candidates = (f"{slug[:_LONGEST]}-{digest[:length]}" for length in range(10, len(digest) + 1))
            names[frame] = next(name for name in candidates if name.lower() not in used)
            used.add(names[frame].lower())
    return {frame: names[frame] for frame in slugs}
