"""Select drives and names of a data set, resolve its file names, and build frames that are read on demand."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from p2o import Camera, Cloud, Float, Frame, Image, InputError, UnknownNameError, field
from p2o.reading import LazyFrames, listing, naming, read_rgb
from p2o_formats.kitti_calibration import far_apart
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
        """Return the frames ("KITTI raw frames"), read from their entries on demand.

        Raises InputError without entries, with the first reason of `skipped`, else `got`.
        """
        if not self.entries:
            got = next(iter(self.skipped.values()), got)
            raise InputError(f"no {title}", where=root, expected=expected, got=got)
        return LazyFrames(self.entries, read, self.skipped)


def cameras_field(default: str, cameras: Iterable[str]) -> Any:
    """Return the option with the names of one or more of the `cameras` of a data set."""
    return field((default,), min_length=1, help=f"Cameras, separated by commas, or all: {', '.join(cameras)}.")


def read_image(
    path: Path,
    camera: Camera | Callable[[int, int], Camera],
    size: tuple[int, int] | None = None,
    *,
    right: tuple[Path, float | None] | None = None,
    depth: tuple[Path, Callable[[Path, tuple[int, int]], Float]] | None = None,
) -> tuple[Image, tuple[str, ...]]:
    """Return the image of a camera, and warnings.

    The camera may be a function of width and height in px; `size` is (width, height) if a calibration states it.
    `right` is the file of the right image with the baseline in metres, `depth` a file with the function that reads it.

    Raises InputError, with the file, for images that are missing, damaged, or do not fit the camera.
    """
    rgb, warnings = read_rgb(path, (camera.width, camera.height) if isinstance(camera, Camera) else size)
    size = (rgb.shape[1], rgb.shape[0])
    with naming(path):
        image = Image(rgb, camera if isinstance(camera, Camera) else camera(*size))
    if right is not None:
        right_rgb, more = read_rgb(right[0], size)
        warnings += more
        with naming(right[0]):
            image = replace(image, right=right_rgb, baseline_m=right[1])
    if depth is not None:
        depth_m = depth[1](depth[0], size)
        with naming(depth[0]):
            image = replace(image, depth_m=depth_m)
    return image, warnings


def rig_frame(
    name: str, time_s: float, image: Image, cloud: Cloud, extrinsic: Float, pose: Float | None, *warnings: str,
    twist: Float | None = None,
) -> Frame:  # fmt: skip
    """Return a frame of a drive, whose name is "sequence/camera/image", with a remark on an implausible extrinsic.

    `pose` is that of the LiDAR in the world. The pose of the camera is not given: together with that of the LiDAR it
    would reveal the ground truth.
    """
    sequence, camera, _ = name.rsplit("/", 2)
    drive: dict[str, Any] = {"sequence": sequence, "camera_name": camera, "lidar_world_from_lidar": pose}
    warnings += far_apart(name, extrinsic)
    return Frame(name, image, cloud, extrinsic, twist=twist, warnings=warnings, time_s=time_s, **drive)


def finite_number(value: Any, name: str, path: Path) -> float:
    """Return a number of a file; raises InputError unless it is finite and at most 1e300."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < 1e300:
        raise InputError(f"{name} is not a number", where=path, expected="a finite number", got=str(value)[:40])
    return value


def drives_in(
    root: Path, noun: str, title: str, wanted: Iterable[str], is_drive: Callable[[Path], bool], expected: str
) -> list[Path]:
    """Return the folders of the wanted drives in a folder, which may be a drive itself; `noun` is what they are called.

    Raises InputError without drives, and UnknownNameError for an unknown name.
    """
    if is_drive(root):
        chosen(noun, wanted, (root.name,), where=root.parent)
        return [root]
    folders = [folder for folder in listing(root, title) if folder.is_dir()]
    drives = {folder.name: folder for folder in folders if is_drive(folder)}
    if not drives:
        below = [folder for folder in folders if any(map(is_drive, listing(folder, title)[:20]))]
        hint = f"give the folder of {noun}s: {below[0]}" if below else None
        raise no_sequences(f"{noun}s of {title}", root, expected, hint)
    return [drives[name] for name in chosen(noun, wanted, drives, where=root)]


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


def file_inside(root: Path, folder: Path, name: str, where: Path) -> Path:
    """Return the path of a file in a folder of the data set, whose resolved folder is `root`.

    Raises InputError if the path, after resolving links, is outside the root; `where` is the file that names it.
    """
    path = folder / name
    try:
        inside = path.resolve().is_relative_to(root)
    except (OSError, RuntimeError, ValueError) as problem:
        raise InputError(f"bad file name {ascii(name)[:80]}", where=where) from problem
    if not inside:
        fault = f"the path '{name[:200]}' leaves the folder of the data set"
        hint = "copy the file into the folder"
        raise InputError(fault, where=where, expected=f"a file below {root}", got=path.resolve(), hint=hint)
    return path


@contextmanager
def damage_explained(path: Path, fault: str, expected: str, *errors: type[BaseException]) -> Iterator[None]:
    """Convert the exceptions of a reader for damaged bytes to InputError."""
    try:
        yield
    except InputError:
        raise
    except errors as problem:
        got = str(problem)[:200] or type(problem).__name__
        raise InputError(fault, where=path, expected=expected, got=got, hint="download it again") from problem


def optional_package(name: str, extra: str, what: str, path: Path) -> Any:
    """Return a module that an extra of p2o installs; raises InputError, with `what` needs it, if it is missing."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as problem:
        fault = f"reading {what} needs {name}, which is not installed"
        raise InputError(fault, where=path, hint=f'run: pip install "p2o-calib[{extra}]"') from problem
