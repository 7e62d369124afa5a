"""Select names of a data set, resolve its file names, build frames that are read on demand, and report missing ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from p2o import Camera, Float, Frame, Image, InputError, UnknownNameError, field
from p2o.reading import LazyFrames, listing, naming, read_rgb
from pydantic import BeforeValidator


@dataclass(frozen=True, eq=False)
class Listed:
    """Frames of a data set by name: `entries` to read, and the reasons why others are `skipped`."""

    entries: dict[str, Any] = dataclasses.field(default_factory=dict)
    skipped: dict[str, str] = dataclasses.field(default_factory=dict)

    def add(self, name: str, entry: object, reason: str = "") -> None:
        """Add a frame, which is skipped if there is a reason."""
        if reason:
            self.skipped[name] = reason
        else:
            self.entries[name] = entry

    def lazy(
        self, title: str, root: Path, read: Callable[[Any], Frame], *, expected: str, got: str | None = None
    ) -> LazyFrames:
        """Return the frames, read from their entries on demand.

        Raises InputError without entries, with the first reason of `skipped`, else `got`.
        """
        if not self.entries:
            got = next(iter(self.skipped.values()), got)
            raise InputError(f"no {title} frames", where=root, expected=expected, got=got)
        return LazyFrames(self.entries, read, self.skipped)


def cameras_field(default: str, cameras: Iterable[str]) -> Any:
    """Return the option with the names of one or more of the `cameras` of a data set."""
    return field((default,), min_length=1, help=f"Cameras, separated by commas, or all: {', '.join(cameras)}.")


def read_image(path: Path, camera: Camera) -> tuple[Image, tuple[str, ...]]:
    """Return the image of a camera, and warnings; raises InputError, with the file, if it does not fit the camera."""
    rgb, warnings = read_rgb(path, (camera.width, camera.height))
    with naming(path):
        return Image(rgb, camera), warnings


def in_drive(sequence: str, camera_name: str, time_s: float | None, pose: Float | None) -> dict[str, Any]:
    """Return the arguments of a frame of a drive: sequence, camera, time in s, and the pose of the LiDAR in the world.

    The pose of the camera is not given: together with that of the LiDAR it would reveal the ground truth.
    """
    return {"sequence": sequence, "camera_name": camera_name, "time_s": time_s, "lidar_world_from_lidar": pose}


def finite_number(value: Any, name: str, path: Path) -> float:
    """Return a number of a file; raises InputError unless it is finite and at most 1e300."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < 1e300:
        raise InputError(f"{name} is not a number", where=path, expected="a finite number", got=str(value)[:40])
    return value


def no_sequences(title: str, folder: Path, expected: str, hint: str | None = None) -> InputError:
    """Return the error for a folder without `title` ("drives of KITTI-360"), which lists its first entries."""
    got = ", ".join(path.name for path in listing(folder, title)[:8]) or "an empty folder"
    return InputError(f"there are no {title}", where=folder, expected=expected, got=got, hint=hint)


def _words(value: object) -> object:
    """Split a text at commas; return other values unchanged."""
    return [word.strip() for word in value.split(",") if word.strip()] if isinstance(value, str) else value


Words = Annotated[tuple[str, ...], BeforeValidator(_words)]
"""Option with several names, as a list or separated by commas."""


def chosen(kind: str, wanted: Iterable[str], known: Iterable[str], where: Path | None = None) -> tuple[str, ...]:
    """Return the wanted names without duplicates; "all", or no name, selects all known names.

    Raises UnknownNameError, with the most similar names, for an unknown name.
    """
    names, known = tuple(dict.fromkeys(wanted)), tuple(known)
    if names in ((), ("all",)):
        return known
    unknown = next((name for name in names if name not in known), None)
    if unknown is not None:
        raise UnknownNameError(kind, unknown, known, where=where, hint="or all")
    return names


def file_inside(root: Path, name: str) -> Path:
    """Return the path of a file in the resolved folder `root`.

    Raises InputError if the path, after resolving links, is outside the folder.
    """
    path = root / name
    try:
        inside = path.resolve().is_relative_to(root)
    except (OSError, RuntimeError, ValueError) as problem:
        raise InputError("a table contains an invalid file name", where=root, got=ascii(name)[:80]) from problem
    if not inside:
        raise InputError("a file named in a table is outside the folder", where=root, got=name[:200])
    return path
