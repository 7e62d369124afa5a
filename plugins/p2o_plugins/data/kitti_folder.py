"""Listing the numbered files of KITTI folders and pairing pictures with sweeps."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from p2o.files.input_file import listing

_PICTURES = (".jpg", ".jpeg", ".png")


def is_number(text: str) -> bool:
    """Whether a text is a whole number in the digits 0 to 9, as the ids of frames are; other digits are no numbers."""
    return text.isascii() and text.isdecimal()


def pictures(folder: Path) -> Mapping[str, Path]:
    """Return the pictures of a folder by frame id, sorted; a PNG wins over a JPEG of the same id.

    Hidden files are left out, as in all these folders. Raises InputError if the folder cannot be read.
    """
    return _by_id(folder, _PICTURES)


def picture(folder: Path, frame: str) -> Path | None:
    """Return the picture of one frame id, or None where the folder has none."""
    return next((path for suffix in reversed(_PICTURES) if (path := folder / (frame + suffix)).exists()), None)


def sweeps(folder: Path) -> Mapping[str, Path]:
    """Return the sweeps of a folder by frame id, sorted: .bin, or .txt in unsynchronised recordings."""
    return _by_id(folder, (".txt", ".bin"))


def paired(
    images: Mapping[str, Path],
    clouds: Mapping[str, Path],
    folder: Path,
    image_folder: str,
    cloud_folder: str,
    prefix: str = "",
    *,
    numbered: bool = True,
) -> tuple[dict[str, tuple[str, Path, Path]], dict[str, str]]:
    """Return (name, image, sweep) by name for ids that have both, and what is missing by name for the others.

    Names are the ids with `prefix` in front. `folder`, `image_folder`, `cloud_folder` only say what is missing. Where
    the ids are `numbered`, files that are called otherwise are left out, too.
    """
    entries: dict[str, tuple[str, Path, Path]] = {}
    skipped: dict[str, str] = {}
    for frame in sorted({*images, *clouds}):
        name = prefix + frame
        if numbered and not is_number(frame):
            skipped[name] = f"{images.get(frame, clouds.get(frame))}: the name of the file is no number"
        elif frame not in clouds:
            skipped[name] = f"{folder / cloud_folder / frame}.bin is missing"
        elif frame not in images:
            skipped[name] = f"{folder / image_folder / frame}.png is missing"
        else:
            entries[name] = (name, images[frame], clouds[frame])
    return entries, skipped


def _by_id(folder: Path, suffixes: tuple[str, ...]) -> Mapping[str, Path]:
    if not folder.is_dir():
        return {}
    # Sorted by suffix order last, so that later suffixes win.
    found = [
        (path.stem, suffixes.index(path.suffix.lower()), path)
        for path in listing(folder, "KITTI's files")
        if path.suffix.lower() in suffixes and not path.name.startswith(".")
    ]
    return {stem: path for stem, _, path in sorted(found)}
