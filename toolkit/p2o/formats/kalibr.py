"""Kalibr's camchain.yaml: cameras with intrinsics, distortion, resolution, and here T_cam_lidar.

Source: the output of Kalibr (its wiki, "YAML formats"). T_b_a takes points of a to b there. Kalibr itself knows the
IMU and the cameras before (`T_cam_imu`, `T_cn_cnm1`) and no LiDAR; tools that build on its chains write `T_cam_lidar`
beside them, p_cam = T_cam_lidar p_lidar, and so does p2o. `T_lidar_cam` is read too. Models: pinhole with radtan
(k1 k2 p1 p2), equidistant, fov or none, and eucm (alpha beta fu fv pu pv); omni and ds have no counterpart here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from p2o.errors import InputError
from p2o.formats.calibration import Calibration
from p2o.formats.format import BOTH, ONLY_CAMERA, Format, Reading, listed
from p2o.formats.frame_names import FrameName
from p2o.formats.lens import lens_of, no_word_for
from p2o.formats.source import Source
from p2o.formats.transform_names import named_transform
from p2o.geometry.camera import Camera
from p2o.geometry.pose_text import numbers
from p2o.options import Options, field

_KNOWN = "pinhole with radtan (k1 k2 p1 p2), equidistant, fov or none, and eucm"


class KalibrOptions(Options):
    """The name of the camera in the chain."""

    camera_frame: FrameName = field("cam0", help="Name of the camera in the chain.")


def write(calibration: Calibration, options: KalibrOptions) -> bytes:
    """Return the YAML text; without an extrinsic T_cam_lidar is left out."""
    camera = calibration.intrinsics()
    model, intrinsics, distortion, coefficients = _kalibr(camera)
    lines = [
        "# A camera chain as Kalibr writes it. T_b_a takes points of a to b: p_cam = T_cam_lidar p_lidar, in metres.",
        "# Camera x right, y down, z forward; LiDAR as its points. Pixels, centres at whole numbers.",
        f"{options.camera_frame}:",
        "  cam_overlaps: []",
        f"  camera_model: {model}",
        f"  intrinsics: {listed(intrinsics)}",
        f"  distortion_model: {distortion}",
        f"  distortion_coeffs: {listed(coefficients)}",
        f"  resolution: [{camera.width}, {camera.height}]",
    ]
    if calibration.camera_from_lidar is not None:
        lines += ["  T_cam_lidar:", *(f"  - {listed(row)}" for row in calibration.camera_from_lidar)]
    return ("\n".join(lines) + "\n").encode()


def _kalibr(camera: Camera) -> tuple[str, tuple[float, ...], str, tuple[float, ...]]:
    """Return camera_model, intrinsics, distortion_model and distortion_coeffs of a camera."""
    p = camera.params
    if camera.model == "EUCM":
        return "eucm", (*p[4:], *p[:4]), "none", ()
    if camera.model == "FOV":
        return "pinhole", p[:4], "fov", p[4:]
    lens = lens_of(camera, "kalibr")
    pinhole = (lens.fx, lens.fy, lens.cx, lens.cy)
    if lens.model == "equidistant":
        return "pinhole", pinhole, "equidistant", lens.coefficients
    if not any(lens.coefficients):
        return "pinhole", pinhole, "none", ()
    if lens.model == "rational_polynomial" or lens.coefficients[4]:
        raise no_word_for(camera, "kalibr", _KNOWN)
    return "pinhole", pinhole, "radtan", lens.coefficients[:4]


def _cameras(source: Source) -> dict[str, Mapping[str, Any]]:
    return {
        str(name): value
        for name, value in source.tree.items()
        if isinstance(value, Mapping) and "camera_model" in value and "intrinsics" in value
    }


def recognises(source: Source) -> bool:
    """Return whether cameras with `camera_model` and `intrinsics` stand in it by name."""
    return any("resolution" in value or "distortion_model" in value for value in _cameras(source).values())


def read(source: Source, reading: Reading) -> Calibration:
    """Return the camera that is asked for, or the only one, and its extrinsic where T_cam_lidar stands beside it.

    Raises InputError for models without a counterpart, and values that are no camera or no transform.
    """
    where = source.path
    cameras = _cameras(source)
    wanted = reading.name or reading.camera_frame or (next(iter(cameras)) if len(cameras) == 1 else "")
    if wanted not in cameras:
        raise InputError(
            "which camera of the chain?" if not wanted else f"there is no camera {wanted!r}",
            where=where,
            expected=f"FILE#NAME with one of {', '.join(list(cameras)[:8])}",
            got=wanted or f"{len(cameras)} cameras",
        )
    told = cameras[wanted]
    found = named_transform(told, where, wanted)
    camera = _camera(told, wanted, reading, source)
    if found is None:
        return Calibration(camera, camera_frame=wanted)
    return Calibration(camera, found[0], camera_frame=wanted, remarks=found[1])


def _camera(told: Mapping[str, Any], name: str, reading: Reading, source: Source) -> Camera:
    from p2o.formats.format import size_of

    where = source.path
    model, distortion = (str(told.get(key, "none")) for key in ("camera_model", "distortion_model"))
    d = told.get("distortion_coeffs") or []
    counts = {
        ("pinhole", "radtan"): 4,
        ("pinhole", "equidistant"): 4,
        ("pinhole", "fov"): 1,
        ("pinhole", "none"): 0,
        ("eucm", "none"): 0,
    }
    if (model, distortion) not in counts:
        raise InputError(
            f"{name}: {model} with {distortion} has no counterpart",
            where=where,
            expected=_KNOWN,
            got=f"{model}, {distortion}",
        )
    count = counts[model, distortion]
    intrinsics = numbers(told["intrinsics"], (6 if model == "eucm" else 4,))
    coefficients = numbers(d, (count,)) if count else () if isinstance(d, list) else None
    if intrinsics is None or coefficients is None:
        raise InputError(
            f"{name}: intrinsics or distortion_coeffs are no numbers of {model} with {distortion}",
            where=where,
            expected=f"{6 if model == 'eucm' else 4} and {count} numbers",
            got=f"{told['intrinsics']}, {d}"[:80],
        )
    resolution = numbers(told.get("resolution"), (2,))
    width, height = (None, None) if resolution is None else resolution.tolist()
    size = size_of(width, height, reading, where)
    values = tuple(float(value) for value in intrinsics)
    if model == "eucm":
        return Camera("EUCM", *size, (*values[2:], *values[:2]))
    words = {"radtan": "OPENCV", "equidistant": "OPENCV_FISHEYE", "fov": "FOV", "none": "PINHOLE"}
    if distortion == "radtan" and not any(coefficients):
        return Camera("PINHOLE", *size, values)
    return Camera(words[distortion], *size, (*values, *(float(value) for value in coefficients)))


FORMAT = Format(
    name="kalibr",
    summary="Camera chain of Kalibr: intrinsics, distortion, resolution and T_cam_lidar.",
    holds=BOTH,
    needs=ONLY_CAMERA,
    direction="camera_from_lidar (T_cam_lidar)",
    suffix=".yaml",
    options=KalibrOptions,
    recognises=recognises,
    read=read,
    write=write,
)
