"""Read and write JSON files of OpenCalib (PJLab-ADG, SensorsCalibration): one for the extrinsic, one for the camera.

Source: samples and loaders of its `lidar2camera` tools. `param.sensor_calib.data` of "LIDAR-to-CAMERA-extrinsic" is
camera_from_lidar (4, 4), in metres; `cam_K` and `cam_dist` of "CAMERA-intrinsic" are K and k1 k2 p1 p2 [k3] of
OpenCV, or the four coefficients of `cv::fisheye` if `device_type` contains fisheye.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from p2o import InputError, Options, field
from p2o.reading import Calibration, FrameName, Reading, Source, matrix_rows, read_pose

from p2o_formats import format as common
from p2o_formats.camera_entry import lens_of, unsupported_model
from p2o_formats.camera_info import lens_from_matrix
from p2o_formats.format import FRAMES, NAMED_SIZE, ONLY_CAMERA, ONLY_EXTRINSIC, Format, data_of, described
from p2o_formats.frame_tree import Edge, calibration_of


class OpenCalibOptions(Options):
    """Names of the sensors in the file."""

    lidar_frame: FrameName = field("top_center_lidar", help="Name of the LiDAR.")
    camera_frame: FrameName = field("center_camera", help="Name of the camera.")


def write(calibration: Calibration, options: OpenCalibOptions) -> bytes:
    """Return the JSON text of the extrinsic."""
    lidar, camera = options.lidar_frame, options.camera_frame
    text = "data maps points of the LiDAR to the camera (x right, y down, z forward), in metres"
    comment = described(calibration, text)
    param = {"time_lag": 0, "sensor_calib": _matrix(calibration.extrinsic())}
    return _json(f"{lidar}-to-{camera}-extrinsic", (lidar, camera), "relational", comment, param)


def write_camera(calibration: Calibration, options: OpenCalibOptions) -> bytes:
    """Return the JSON text of the camera; raises InputError for models other than plumb_bob."""
    camera = calibration.intrinsics()
    lens = lens_of(camera, "opencalib-camera")
    if lens.model != "plumb_bob":
        raise unsupported_model(camera, "opencalib-camera", "a pinhole with k1 k2 p1 p2 k3")
    name = options.camera_frame
    param = {"img_dist_w": lens.width, "img_dist_h": lens.height, "cam_K": _matrix(lens.matrix)}
    param["cam_dist"] = _matrix([lens.coefficients])
    comment = described(calibration, "pixels, centres at integers; cam_dist is k1 k2 p1 p2 k3 of OpenCV")
    return _json(f"{name}-intrinsic", (name, name), "camera", comment, param)


def _json(key: str, names: tuple[str, str], device: str, comment: str, param: Mapping[str, Any]) -> bytes:
    """Return the JSON text of one entry; its key ends in the type of the parameters."""
    entry = {"sensor_name": names[0], "target_sensor_name": names[1], "device_type": device}
    entry |= {"param_type": key.rpartition("-")[2], "comment": comment}
    return common.json_text({key: {**entry, "param": param}})


def _matrix(values: Any) -> dict[str, Any]:
    rows = matrix_rows(values)
    return {"rows": len(rows), "cols": len(rows[0]), "type": 6, "continuous": True, "data": rows}


def _entries(source: Source, kind: str) -> dict[str, Mapping[str, Any]]:
    """Return the sensors of one kind ("extrinsic", "intrinsic") by their keys."""
    return {
        str(key): value
        for key, value in source.tree.items()
        if isinstance(value, Mapping)
        and isinstance(value.get("param"), Mapping)
        and value.get("param_type", kind) == kind
        and ("sensor_calib" in value["param"]) == (kind == "extrinsic")
    }


def recognises(source: Source) -> bool:
    """Return whether the file contains an extrinsic of OpenCalib."""
    return bool(_entries(source, "extrinsic"))


def recognises_camera(source: Source) -> bool:
    """Return whether the file contains a camera of OpenCalib."""
    return any("cam_K" in value["param"] for value in _entries(source, "intrinsic").values())


def read(source: Source, reading: Reading) -> Calibration:
    """Return the extrinsic; raises InputError unless the file has exactly one, between a LiDAR and a camera."""
    key, entry = _only(_entries(source, "extrinsic"), reading, source)
    names = (entry.get("sensor_name"), entry.get("target_sensor_name"))
    if not all(isinstance(name, str) for name in names):
        parts = key.removesuffix("-extrinsic").split("-to-")
        names = (parts[0], parts[-1])
    sensor, target = (str(name)[:120] for name in names)
    pose = partial(read_pose, f"{key}.sensor_calib", data_of(entry["param"].get("sensor_calib")), source.path)
    optical = reading.model_copy(update={"camera_axes": "optical"})
    return calibration_of([Edge(target, sensor, pose)], optical, source.path)


def read_camera(source: Source, reading: Reading) -> Calibration:
    """Return the camera; raises InputError for an invalid camera."""
    _, entry = _only(_entries(source, "intrinsic"), reading, source)
    matrix, d = (data_of(entry["param"].get(key)) for key in ("cam_K", "cam_dist"))
    width, height = (entry["param"].get(key) for key in ("img_dist_w", "img_dist_h"))
    size = common.size_of(width, height, reading, source.path)
    if size is None:
        return Calibration(lacks_image_size=True)
    model = "equidistant" if "fisheye" in str(entry.get("device_type", "")).lower() else None
    lens = lens_from_matrix("cam_K", matrix, "cam_dist", d, model, size, source)
    return Calibration(lens.camera(), camera_frame=str(entry.get("sensor_name", "")), remarks=lens.remarks)


def _only(entries: Mapping[str, Mapping[str, Any]], reading: Reading, source: Source) -> tuple[str, Mapping[str, Any]]:
    matching = {key: value for key, value in entries.items() if not reading.name or reading.name in key}
    if len(matching) != 1:
        fault, got = f"{len(matching) or 'none'} of the entries match", ", ".join(list(entries)[:6])
        raise InputError(fault, where=source.path, expected="one, or FILE#NAME", got=got)
    return next(iter(matching.items()))


FORMAT = Format(
    name="opencalib",
    summary="Extrinsic JSON of OpenCalib (SensorsCalibration): LIDAR-to-CAMERA-extrinsic.",
    rank=26,
    cite="Yan et al., 2022",
    holds=ONLY_EXTRINSIC,
    direction="camera_from_lidar (LIDAR-to-CAMERA)",
    suffix=".json",
    options=OpenCalibOptions,
    fields=FRAMES | {"name"},
    recognises=recognises,
    read=read,
    write=write,
)

CAMERA_FORMAT = Format(
    name="opencalib-camera",
    summary="Camera JSON of OpenCalib (SensorsCalibration): CAMERA-intrinsic.",
    rank=27,
    holds=ONLY_CAMERA,
    suffix=".json",
    options=OpenCalibOptions,
    fields=NAMED_SIZE,
    recognises=recognises_camera,
    read=read_camera,
    write=write_camera,
)
