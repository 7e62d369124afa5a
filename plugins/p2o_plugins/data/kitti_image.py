"""Reading a rectified KITTI picture with what stands beside it: the right picture and a disparity file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from p2o import Image, InputError, RadialError
from p2o.arrays import Float
from p2o.files.input_file import naming
from p2o.formats.kitti_calibration import MAX_BASELINE_M, baseline_m, rectified_camera

from p2o_plugins.data.image_file import read_rgb, read_uint16


def read_rectified(
    path: Path,
    projection: Float,
    *,
    size: tuple[int, int] | None = None,
    right_projection: Float | None = None,
    right_path: Path | None = None,
    disparity_path: Path | None = None,
) -> tuple[Image, tuple[str, ...]]:
    """Return the picture of a rectified camera with projection (3, 4), and warnings.

    `size` is (width, height) in pixels where the calibration knows it. The right picture and the disparity (uint16 /
    256 px, 0 where unknown; becomes depth_m with NaN) are read where a path is given; they need `right_projection`.

    Raises InputError, naming the file, for pictures that are missing, damaged, or do not fit the camera.
    """
    rgb, warnings = read_rgb(path, size)
    size = size or (rgb.shape[1], rgb.shape[0])
    right = depth_m = baseline = None
    if right_projection is not None and (right_path is not None or disparity_path is not None):
        baseline = baseline_m(projection, right_projection)
        if not 0 < baseline <= MAX_BASELINE_M:
            raise InputError(
                "the right camera does not stand to the right of the left one",
                where=path,
                expected=f"a baseline of up to {MAX_BASELINE_M:g} m from the two projections",
                got=f"{baseline:g} m",
            )
    if right_path is not None:
        right, more = read_rgb(right_path, size)
        warnings += more
    if disparity_path is not None and baseline is not None:
        depth_m = projection[0, 0] * baseline / read_uint16(disparity_path, "disparity", size)
    with naming(path):
        camera = rectified_camera(projection, *size)
        image = Image(rgb, camera)
    for beside, values in (
        (right_path, {"right": right, "baseline_m": baseline}),
        (disparity_path, {"depth_m": depth_m}),
    ):
        if beside is not None:
            with naming(beside):
                Image(rgb, camera, **values)
    if right_path is not None or disparity_path is not None:
        image = Image(rgb, camera, right, baseline if right is not None else None, depth_m)
    return image, warnings


def without_radial_error(image: Image, error: RadialError) -> Image:
    """Return the picture with the camera that has taken it, once the radial `error` of its calibration is known.

    A depth map holds projected returns, at the pixels that the wrong calibration gives: they move with it.
    """
    if not error:
        return image
    depth_m = image.depth_m
    if depth_m is not None:
        height, width = depth_m.shape
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float64)
        place = error.calibrated(image.camera, pixels)
        inside = image.camera.in_image(place)
        u, v = np.rint(np.where(inside[..., None], place, 0.0)).astype(np.int64).transpose(2, 0, 1)
        depth_m = np.where(inside, depth_m[v, u], np.nan)
    return replace(image, camera=error.corrected(image.camera), depth_m=depth_m)
