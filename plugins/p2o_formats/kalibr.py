"""Read and write Kalibr's camchain.yaml: cameras with intrinsics, distortion, resolution and T_cam_lidar.

Source: the output of Kalibr (its wiki, "YAML formats"), in which T_b_a maps points of a to b. Kalibr itself writes
the transforms of the IMU and of the previous camera (`T_cam_imu`, `T_cn_cnm1`); tools that extend its chains add
`T_cam_lidar`, p_cam = T_cam_lidar p_lidar, as p2o does. `T_lidar_cam` is read, too. Models: pinhole with radtan
(k1 k2 p1 p2), equidistant, fov or none, and eucm (alpha beta fu fv pu pv); p2o has no equivalent of omni and ds.
A camera without T_cam_lidar takes that of the previous ones through T_cn_cnm1.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Camera, Float, InputError, Options, field
from p2o.reading import Calibration, FrameName, Reading, Source, listed, read_pose

from p2o_formats.camera_entry import colmap_model, lens_of, unsupported_model
from p2o_formats.format import NAMED_SIZE, ONLY_CAMERA, Format, comment_lines, required_numbers, select_camera, size_of
from p2o_formats.frame_names import named_transform

_KNOWN = "pinhole with radtan (k1 k2 p1 p2), equidistant, fov or none, and eucm"


class KalibrOptions(Options):
    """Name of the camera in the chain."""

    camera_frame: FrameName = field("cam0", help="Name of the camera in the chain.")


def write(calibration: Calibration, options: KalibrOptions) -> bytes:
    """Return the YAML text; T_cam_lidar is omitted if the calibration has no extrinsic."""
    camera = calibration.intrinsics()
    model, intrinsics, distortion, coefficients = _kalibr(camera)
    lines = [
        "# A camera chain as Kalibr writes it. T_b_a takes points of a to b: p_cam = T_cam_lidar p_lidar, in metres.",
        "# Camera x right, y down, z forward; LiDAR as its points. Pixels, centres at whole numbers.",
        *comment_lines(calibration),
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
        raise unsupported_model(camera, "kalibr", _KNOWN)
    return "pinhole", pinhole, "radtan", lens.coefficients[:4]


def _cameras(source: Source) -> dict[str, Mapping[str, Any]]:
    entries = {str(name): value for name, value in source.tree.items() if isinstance(value, Mapping)}
    return {name: value for name, value in entries.items() if "camera_model" in value and "intrinsics" in value}


def recognises(source: Source) -> bool:
    """Return whether the file contains named cameras with `camera_model` and `intrinsics`."""
    return any("resolution" in value or "distortion_model" in value for value in _cameras(source).values())


def read(source: Source, reading: Reading) -> Calibration:
    """Return the camera that the reading names, or the only one, and its T_cam_lidar if the file contains it.

    Raises InputError for unsupported camera models, invalid cameras and invalid transforms.
    """
    where = source.path
    cameras = _cameras(source)
    name = select_camera(cameras, reading.name or reading.camera_frame, "FILE#NAME", where)
    entry = cameras[name]
    pose, remarks = _extrinsic(cameras, name, where)
    width, height = None, None
    if "resolution" in entry:
        width, height = required_numbers(f"{name}: resolution", entry["resolution"], 2, where, "width and height in px")
    size = size_of(width, height, reading, where)
    camera = None if size is None else _camera(entry, name, size, where)
    return Calibration(camera, pose, camera_frame=name, remarks=remarks, lacks_image_size=size is None)


def _extrinsic(
    cameras: Mapping[str, Mapping[str, Any]], name: str, where: Path
) -> tuple[Float | None, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) of a camera, through the previous cameras if they have it, and remarks."""
    names, link = list(cameras), np.eye(4)
    remarks: tuple[str, ...] = ()
    for key in reversed(names[: names.index(name) + 1]):
        pose, more = named_transform(cameras[key], where, key)
        remarks += more
        if pose is not None:
            return link @ pose, remarks
        if "T_cn_cnm1" not in cameras[key]:
            break
        step, more = read_pose(f"{key}.T_cn_cnm1", cameras[key]["T_cn_cnm1"], where)
        link, remarks = link @ step, remarks + more
    return None, ()


def _camera(entry: Mapping[str, Any], name: str, size: tuple[int, int], where: Path) -> Camera:
    model, distortion = (str(entry.get(key, "none")) for key in ("camera_model", "distortion_model"))
    if model not in ("pinhole", "eucm") or (model == "eucm" and distortion != "none"):
        got = f"{model}, {distortion}"
        raise InputError(f"{name}: {model} with {distortion} is not supported", where=where, expected=_KNOWN, got=got)
    expected = "alpha beta fu fv pu pv" if model == "eucm" else "fu fv pu pv"
    count = len(expected.split())
    *projection, fx, fy, cx, cy = required_numbers(f"{name}: intrinsics", entry["intrinsics"], count, where, expected)
    given, fits = entry.get("distortion_coeffs") or [], f"the coefficients of {distortion}"
    d = required_numbers(f"{name}: distortion_coeffs", given, 1 if distortion == "fov" else None, where, fits)
    if model == "eucm":
        return Camera("EUCM", *size, (fx, fy, cx, cy, *projection))
    if distortion == "fov":
        return Camera("FOV", *size, (fx, fy, cx, cy, *d))
    model, params = colmap_model(distortion, d, (fx, fy, cx, cy))
    return Camera(model, *size, params)


FORMAT = Format(
    name="kalibr",
    summary="Camera chain of Kalibr: intrinsics, distortion, resolution and T_cam_lidar.",
    rank=40,
    needs=ONLY_CAMERA,
    direction="camera_from_lidar (T_cam_lidar)",
    options=KalibrOptions,
    fields=NAMED_SIZE | {"camera_frame"},
    recognises=recognises,
    read=read,
    write=write,
)
