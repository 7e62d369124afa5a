"""The calib.json of Koide's direct_visual_lidar_calibration: intrinsics, distortion, and T_lidar_camera.

Source: the tool's README and what its `calibrate` writes. `results.T_lidar_camera` is [x, y, z, qx, qy, qz, qw] of
lidar_from_camera: it takes points of the camera to the LiDAR. Camera models are `plumb_bob` (k1 k2 p1 p2 k3) and
`fisheye` (also called `equidistant`; k1 k2 k3 k4). The size of the image stands in its pictures, not in the file: p2o
adds `width` and `height`, which the tool does not look at.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from p2o.errors import InputError
from p2o.formats.calibration import Calibration
from p2o.formats.format import BOTH, Format, Reading, plain, quaternion_xyzw, size_of
from p2o.formats.lens import Lens, lens_of, no_word_for
from p2o.formats.source import Source
from p2o.geometry import se3
from p2o.geometry.pose_text import numbers, read_pose
from p2o.options import Options

_MODELS = {"plumb_bob": "plumb_bob", "fisheye": "equidistant", "equidistant": "equidistant"}
_RESULTS = ("T_lidar_camera", "init_T_lidar_camera", "init_T_lidar_camera_auto")
"""The result, and the starts by hand and by the tool, which are read where there is no result yet."""


def write(calibration: Calibration, options: Options) -> bytes:
    """Return the JSON text."""
    camera = calibration.intrinsics()
    lens = lens_of(camera, "koide")
    if lens.model == "rational_polynomial":
        raise no_word_for(camera, "koide", "plumb_bob or fisheye")
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
        },
        "results": {"T_lidar_camera": plain(lidar_from_camera[:3, 3]) + quaternion_xyzw(lidar_from_camera)},
    }
    return (json.dumps(tree, indent=2, allow_nan=False) + "\n").encode()


def recognises(source: Source) -> bool:
    """Return whether results, or a camera by `camera_model`, stand in it."""
    results, camera = (source.tree.get(key) for key in ("results", "camera"))
    with_pose = isinstance(results, Mapping) and any(key in results for key in _RESULTS)
    return with_pose or (isinstance(camera, Mapping) and "camera_model" in camera and "distortion_coeffs" in camera)


def read(source: Source, reading: Reading) -> Calibration:
    """Return camera and extrinsic; the camera is None where neither file nor reading says the size of its image.

    Raises InputError for models that have no counterpart here, and values that are no camera or no transform.
    """
    camera = None
    remarks: tuple[str, ...] = ()
    told = source.tree.get("camera")
    if isinstance(told, Mapping):
        sized = {"width", "height"} <= told.keys() or (reading.width is not None and reading.height is not None)
        if sized:
            camera = _lens(told, reading, source).camera()
        else:
            remarks = (
                f"{source.path}: the camera is left out, as the size of its image is not said (?width=W&height=H)",
            )
    results = source.tree.get("results")
    key = next((key for key in _RESULTS if isinstance(results, Mapping) and key in results), None)
    if results is None or key is None:
        return Calibration(camera, remarks=remarks)
    values = numbers(results[key], (7,))
    if values is None:
        raise InputError(
            f"results.{key} is no transform",
            where=source.path,
            expected="x y z qx qy qz qw",
            got=str(results[key])[:60],
        )
    told_pose = {"translation_m": values[:3].tolist(), "rotation_xyzw": values[3:].tolist()}
    lidar_from_camera, more = read_pose(f"results.{key}", told_pose, source.path)
    if key != _RESULTS[0]:
        more = (*more, f"{source.path}: there is no result yet, and {key} is taken, which is a start")
    return Calibration(camera, se3.inverse(lidar_from_camera), remarks=remarks + more)


def _lens(told: Mapping[str, Any], reading: Reading, source: Source) -> Lens:
    model = told.get("camera_model")
    if not isinstance(model, str) or model not in _MODELS:
        raise InputError(
            "camera.camera_model has no counterpart", where=source.path, expected=" or ".join(_MODELS), got=repr(model)
        )
    pinhole = numbers(told.get("intrinsics"), (4,))
    d = told.get("distortion_coeffs", [])
    coefficients = numbers(d, (len(d),)) if isinstance(d, list) else None
    if pinhole is None or coefficients is None:
        raise InputError(
            "camera.intrinsics or camera.distortion_coeffs are no numbers",
            where=source.path,
            expected="fx fy cx cy, and k1 k2 p1 p2 k3 or k1 k2 k3 k4",
        )
    size = size_of(told.get("width"), told.get("height"), reading, source.path)
    fx, fy, cx, cy = pinhole.tolist()
    return Lens(*size, fx, fy, cx, cy, _MODELS[model], tuple(coefficients.tolist()))


FORMAT = Format(
    name="koide",
    summary="calib.json of direct_visual_lidar_calibration: camera, and T_lidar_camera.",
    holds=BOTH,
    needs=BOTH,
    direction="lidar_from_camera (T_lidar_camera)",
    suffix=".json",
    recognises=recognises,
    read=read,
    write=write,
)
