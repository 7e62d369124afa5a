"""List the numbered files of KITTI folders, pair images with sweeps, and read rectified images and time stamps."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from p2o import Float, Image, InputError
from p2o.reading import RadialError, listing, read_text, read_uint16
from p2o_formats.kitti_calibration import MAX_BASELINE_M, baseline_m, rectified_camera, refuse_cut_off

from p2o_datasets.lazy_dataset import Listed, read_image

_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")


def is_number(text: str) -> bool:
    """Return whether a text consists of the digits 0 to 9, as frame ids do; other Unicode digits do not count."""
    return text.isascii() and text.isdecimal()


def images_in(folder: Path) -> Mapping[str, Path]:
    """Return the images of a folder by frame id, sorted; PNG has priority over JPEG with the same id.

    Hidden files are ignored. Raises InputError if the folder cannot be read.
    """
    return _by_id(folder, _IMAGE_SUFFIXES)


def image_in(folder: Path, frame: str) -> Path | None:
    """Return the image of one frame id, or None if the folder has none."""
    return next((path for suffix in reversed(_IMAGE_SUFFIXES) if (path := folder / (frame + suffix)).exists()), None)


def sweeps(folder: Path) -> Mapping[str, Path]:
    """Return the sweeps of a folder by frame id, sorted: .bin, or .txt in unsynchronised recordings."""
    return _by_id(folder, (".txt", ".bin"))


def add_pairs(
    frames: Listed,
    image_folder: Path,
    cloud_folder: Path,
    prefix: str = "",
    drive: tuple[Any, ...] = (),
    *,
    clouds: Mapping[str, Path] | None = None,
    numbered: bool = True,
    lacking: str = "",
) -> None:
    """Add the entries (*drive, image, sweep) of ids with both files to the frames, and skip other ids with the reason.

    Names are the ids with `prefix`. `clouds` are the sweeps by the ids of their images (default: those of the folder);
    `lacking` is the reason to skip images without one (default: the file of this id is missing).
    If the ids are `numbered`, files with other names are skipped, too.
    """
    images, clouds = images_in(image_folder), sweeps(cloud_folder) if clouds is None else clouds
    for frame in sorted({*images, *clouds}):
        reason = ""
        if numbered and not is_number(frame):
            reason = f"{images.get(frame, clouds.get(frame))}: the name of the file is not a number"
        elif frame not in clouds:
            reason = f"{images[frame]}: {lacking}" if lacking else f"{cloud_folder / frame}.bin is missing"
        elif frame not in images:
            reason = f"{image_folder / frame}.png is missing"
        frames.add(prefix + frame, (*drive, images.get(frame), clouds.get(frame)), reason)


def _by_id(folder: Path, suffixes: tuple[str, ...]) -> Mapping[str, Path]:
    if not folder.is_dir():
        return {}
    # Sorted by suffix last, so that later suffixes replace earlier ones.
    files = [
        (path.stem, suffixes.index(path.suffix.lower()), path)
        for path in listing(folder, "KITTI's files")
        if path.suffix.lower() in suffixes and not path.name.startswith(".")
    ]
    return {stem: path for stem, _, path in sorted(files)}


_STAMP = re.compile(r"(19[7-9]|20\d|21\d)\d-\d\d-\d\d[ T]\d\d:\d\d:\d\d(\.\d{1,9})?", re.ASCII)


def seconds_of(span: np.timedelta64) -> float:
    """Return a time span in seconds."""
    return float(span / np.timedelta64(1, "s"))


def read_stamp(path: Path, line: int) -> np.datetime64 | None:
    """Return one time stamp, or None if the file or its line is missing or blank; raises as `read_stamps`."""
    stamps = read_stamps(path)
    return stamps[line] if line < len(stamps) and not np.isnat(stamps[line]) else None


def read_stamps(path: Path) -> NDArray[np.datetime64]:
    """Return the time stamps of a file (N,), NaT for blank lines (lost sweeps); empty without the file.

    Raises InputError for lines without a valid time and for a file that ends within a time.
    """
    if not path.exists():
        return np.array([], dtype="datetime64[ns]")
    text = read_text(path, "file of time stamps")
    refuse_cut_off(text, path, words_per_line=2)
    lines = [line.strip() for line in text.splitlines()]
    try:
        # NumPy also accepts "now" and time zones, and years that overflow 64 bit.
        wrong = next((i for i, line in enumerate(lines) if line and not _STAMP.fullmatch(line)), None)
        if wrong is None:
            return np.array([line or "NaT" for line in lines], dtype="datetime64[ns]")
        got = f"line {wrong + 1}: {lines[wrong][:40]}"
    except ValueError as problem:
        got = str(problem)
    raise InputError("a line is not a time", where=path, expected="YYYY-MM-DD HH:MM:SS.nnnnnnnnn", got=got)


def read_rectified(
    path: Path,
    projection: Float,
    *,
    size: tuple[int, int] | None = None,
    right: tuple[Float, Path | None] | None = None,
    disparity_path: Path | None = None,
) -> tuple[Image, tuple[str, ...]]:
    """Return the image of a rectified camera with projection (3, 4), and warnings; raises as `read_image`.

    `size` is (width, height) in pixels if the calibration states it. `right` is the projection (3, 4) of the right
    camera and the path of its image. The right image and the disparity (uint16 / 256 px, 0 for unknown; converted to
    depth_m with NaN), which needs `right`, are read if their paths are given.
    """
    right_projection, right_path = right or (projection, None)
    baseline = baseline_m(projection, right_projection)
    if (right_path or disparity_path) and right is not None and not 0 < baseline <= MAX_BASELINE_M:
        fault = "the right camera is not to the right of the left one"
        expected = f"a baseline of up to {MAX_BASELINE_M:g} m from the two projections"
        raise InputError(fault, where=path, expected=expected, got=f"{baseline:g} m")

    def depth_m(path: Path, size: tuple[int, int]) -> Float:
        return np.asarray(projection[0, 0] * baseline / read_uint16(path, "disparity", size))

    return read_image(
        path,
        partial(rectified_camera, projection),
        size,
        right=None if right_path is None else (right_path, baseline),
        depth=None if disparity_path is None or right is None else (disparity_path, depth_m),
    )


def without_radial_error(image: Image, error: RadialError) -> Image:
    """Return the image with the corrected camera, given the radial `error` of its calibration.

    A depth map contains projected returns at the pixels of the erroneous calibration and is resampled accordingly.
    """
    if not error:
        return image
    depth_m = image.depth_m
    if depth_m is not None:
        height, width = depth_m.shape
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float64)
        calibrated = error.calibrated(image.camera, pixels)
        inside = image.camera.in_image(calibrated)
        u, v = np.rint(np.where(inside[..., None], calibrated, 0.0)).astype(np.int64).transpose(2, 0, 1)
        depth_m = np.where(inside, depth_m[v, u], np.nan)
    return replace(image, camera=error.corrected(image.camera), depth_m=depth_m)
