"""Read and write calib.json of Koide's direct_visual_lidar_calibration: camera and T_lidar_camera.

Source: the README of the tool and the output of its `calibrate`. `results.T_lidar_camera` is lidar_from_camera as
[x, y, z, qx, qy, qz, qw]. Camera models are `plumb_bob` (k1 k2 p1 p2 k3) and `fisheye` (also called `equidistant`;
k1 k2 k3 k4). The tool takes the image size from the images; p2o adds `width` and `height`, which the tool ignores.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from p2o import InputError, Options, se3
from p2o.reading import Calibration, Reading, Source, plain, quaternion_xyzw, read_pose

from p2o_formats.camera_entry import Lens, lens_of, unsupported_model
from p2o_formats.format import BOTH, SIZE, Format, json_text, required_numbers, size_of

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
    return json_text(tree)


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
        size = size_of(entry.get("width"), entry.get("height"), reading, source.path)
        lacks_size, camera = size is None, None if size is None else _lens(entry, size, source).camera()
    results = source.tree.get("results")
    key = next((key for key in _RESULTS if isinstance(results, Mapping) and key in results), None)
    if results is None or key is None:
        return Calibration(camera, lacks_image_size=lacks_size)
    values = required_numbers(f"results.{key}", results[key], 7, source.path, "x y z qx qy qz qw")
    parts = {"translation_m": values[:3], "rotation_xyzw": values[3:]}
    lidar_from_camera, remarks = read_pose(f"results.{key}", parts, source.path)
    if key != _RESULTS[0]:
        remarks = (*remarks, f"{source.path}: the file has no result, so that the initial guess {key} is used")
    pose = se3.inverse(lidar_from_camera)
    return Calibration(camera, pose, remarks=remarks, lacks_image_size=lacks_size, quaternion=True)


def _lens(entry: Mapping[str, Any], size: tuple[int, int], source: Source) -> Lens:
    model = entry.get("camera_model")
    if not isinstance(model, str):
        expected, got = "plumb_bob or fisheye", repr(model)[:60]
        raise InputError("camera.camera_model is not a name", where=source.path, expected=expected, got=got)
    given = entry.get("intrinsics")
    fx, fy, cx, cy = required_numbers("camera.intrinsics", given, 4, source.path, "fx fy cx cy")
    d = entry.get("distortion_coeffs", [])
    d = required_numbers("camera.distortion_coeffs", d, None, source.path, "k1 k2 p1 p2 k3, or k1 k2 k3 k4")
    return Lens(*size, fx, fy, cx, cy, model, tuple(d))


FORMAT = Format(
    name="koide",
    summary="calib.json of direct_visual_lidar_calibration: camera, and T_lidar_camera.",
    rank=25,
    cite="Koide et al., ICRA 2023",
    needs=BOTH,
    direction="lidar_from_camera (T_lidar_camera)",
    suffix=".json",
    fields=SIZE,
    recognises=recognises,
    read=read,
    write=write,
)
