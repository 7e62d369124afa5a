"""Read and write calib.json of Koide's direct_visual_lidar_calibration: camera and T_lidar_camera.

Source: the README of the tool and the output of its `calibrate`. `results.T_lidar_camera` is lidar_from_camera as
[x, y, z, qx, qy, qz, qw]. Camera models are `plumb_bob` (k1 k2 p1 p2 k3) and `fisheye` (also called `equidistant`;
k1 k2 k3 k4). The tool takes the image size from the images; p2o adds `width` and `height`, which the tool ignores.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from p2o import InputError, Options, se3
from p2o.reading import Calibration, Reading, Source, numbers, plain, quaternion_xyzw, read_pose

from p2o_formats.camera_entry import Lens, lens_of, unsupported_model
from p2o_formats.format import BOTH, Format, size_of

_RESULTS = ("T_lidar_camera", "init_T_lidar_camera", "init_T_lidar_camera_auto")
"""Key of the result, and the keys of the manual and automatic initial guesses, which are used without a result."""


def write(calibration: Calibration, options: Options) -> bytes:
    """Return the JSON text."""
    camera = calibration.intrinsics()
    lens = lens_of(camera, "koide")
    if lens.model == "rational_polynomial":
        raise unsupported_model(camera, "koide", "plumb_bob or fisheye")
    lidar_from_camera = se3.inverse(calibration.extrinsic())
    tree = {
        "camera": {
            "camera_model": "fisheye" if lens.model == "equidistant" else lens.model,
            "intrinsics": plain((lens.fx, lens.fy, lens.cx, lens.cy)),
            "distortion_coeffs": plain(lens.coefficients),
            "width": lens.width,
            "height": lens.height,
        },
        "meta": {
            "direction": "T_lidar_camera takes points of the camera to the LiDAR (lidar_from_camera)",
            "axes": "camera x right, y down, z forward; LiDAR as its points",
            "units": "metres, quaternion x y z w, pixels",
            **({"comment": calibration.comment} if calibration.comment else {}),
        },
        "results": {"T_lidar_camera": plain(lidar_from_camera[:3, 3]) + quaternion_xyzw(lidar_from_camera)},
    }
    return (json.dumps(tree, indent=2, allow_nan=False) + "\n").encode()


def recognises(source: Source) -> bool:
    """Return whether the file contains results, or a camera with `camera_model`."""
    results, camera = (source.tree.get(key) for key in ("results", "camera"))
    with_pose = isinstance(results, Mapping) and any(key in results for key in _RESULTS)
    return with_pose or (isinstance(camera, Mapping) and "camera_model" in camera and "distortion_coeffs" in camera)


def read(source: Source, reading: Reading) -> Calibration:
    """Return camera and extrinsic; the camera is None if neither file nor reading gives its image size.

    Raises InputError for unsupported camera models, invalid cameras and invalid transforms.
    """
    camera, lacks_size, entry = None, False, source.tree.get("camera")
    if isinstance(entry, Mapping):
        lacks_size = not {"width", "height"} <= entry.keys() and None in (reading.width, reading.height)
        camera = None if lacks_size else _lens(entry, reading, source).camera()
    results = source.tree.get("results")
    key = next((key for key in _RESULTS if isinstance(results, Mapping) and key in results), None)
    if results is None or key is None:
        return Calibration(camera, lacks_image_size=lacks_size)
    values = numbers(results[key], (7,))
    if values is None:
        got = str(results[key])[:60]
        raise InputError(f"results.{key} is not a transform", where=source.path, expected="x y z qx qy qz qw", got=got)
    parts = {"translation_m": values[:3].tolist(), "rotation_xyzw": values[3:].tolist()}
    lidar_from_camera, remarks = read_pose(f"results.{key}", parts, source.path)
    if key != _RESULTS[0]:
        remarks = (*remarks, f"{source.path}: the file has no result, so that the initial guess {key} is used")
    pose = se3.inverse(lidar_from_camera)
    return Calibration(camera, pose, remarks=remarks, lacks_image_size=lacks_size, quaternion=True)


def _lens(entry: Mapping[str, Any], reading: Reading, source: Source) -> Lens:
    model = entry.get("camera_model")
    if not isinstance(model, str):
        expected, got = "plumb_bob or fisheye", repr(model)[:60]
        raise InputError("camera.camera_model is not a name", where=source.path, expected=expected, got=got)
    pinhole = numbers(entry.get("intrinsics"), (4,))
    d = entry.get("distortion_coeffs", [])
    coefficients = numbers(d, (len(d),)) if isinstance(d, list) else None
    if pinhole is None or coefficients is None:
        fault = "camera.intrinsics or camera.distortion_coeffs are not numbers"
        raise InputError(fault, where=source.path, expected="fx fy cx cy, and k1 k2 p1 p2 k3 or k1 k2 k3 k4")
    size = size_of(entry.get("width"), entry.get("height"), reading, source.path)
    fx, fy, cx, cy = pinhole.tolist()
    return Lens(*size, fx, fy, cx, cy, model, tuple(coefficients.tolist()))


FORMAT = Format(
    name="koide",
    summary="calib.json of direct_visual_lidar_calibration: camera, and T_lidar_camera.",
    rank=25,
    cite="Koide et al., ICRA 2023",
    needs=BOTH,
    direction="lidar_from_camera (T_lidar_camera)",
    suffix=".json",
    recognises=recognises,
    read=read,
    write=write,
)
