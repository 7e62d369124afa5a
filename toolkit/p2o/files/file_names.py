"""Names of frames as names of files: safe on every system, and two frames never share one."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Collection, Sequence

_LONGEST = 120
_DEVICES = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
"""No file can be called so on Windows, whatever its suffix."""


def folder_name(frame: str) -> str:
    """Return a frame's name as one folder name: date/drive/frame becomes date_drive_frame."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", frame).strip("._") or "frame"


def distinct_names(frames: Sequence[str], taken: Collection[str] = ()) -> dict[str, str]:
    """Return by frame a file name without suffix; a hash stands behind it where two would be one file.

    So it does where a name is too long, one of `taken`, or a device on some systems. Case does not tell files apart
    everywhere, so it does not count.
    """
    slugs = {frame: folder_name(frame) for frame in frames}
    devices = {frame: slug.replace(".", "_") for frame, slug in slugs.items() if _DEVICES.fullmatch(slug)}
    slugs |= devices
    count = Counter([*(slug.lower() for slug in slugs.values()), *(name.lower() for name in taken)])
    return {
        frame: slug
        if count[slug.lower()] == 1 and len(slug) <= _LONGEST and frame not in devices
        else f"{slug[:_LONGEST]}-{hashlib.sha256(frame.encode('utf-8', 'surrogatepass')).hexdigest()[:10]}"
        for frame, slug in slugs.items()
    }
