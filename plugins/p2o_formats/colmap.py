"""Read and write COLMAP's cameras.txt and rig_config.json.

Source: COLMAP's documentation ("Output format", "Rigs"). COLMAP puts the centre of the first pixel at (0.5, 0.5), so
that its principal points are 0.5 px larger. Quaternions are w x y z. The frame of a rig is that of its reference
sensor. p2o writes the LiDAR as a reference sensor without images, so that `cam_from_rig` of the camera is
camera_from_lidar, and adds `width` and `height`, which COLMAP takes from the images.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from p2o import Camera, Options, field, se3
from p2o.reading import Calibration, FrameName, Reading, Source, plain, quaternion_xyzw, read_pose, spaced

from p2o_formats import format as common
from p2o_formats.format import FRAMES, NAMED_SIZE, ONLY_CAMERA, ONLY_EXTRINSIC, Format, comment_lines, required_numbers
from p2o_formats.frame_names import is_lidar
from p2o_formats.frame_tree import Edge, Posed, calibration_of

_HEAD = "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"


class ColmapOptions(Options):
    """Names of the sensors in a rig, which are their image folders."""

    lidar_frame: FrameName = field("lidar", help="Name of the LiDAR in the rig.")
    camera_frame: FrameName = field("camera", help="Name of the camera in the rig, the folder of its images.")


def write_cameras(calibration: Calibration, options: Options) -> bytes:
    """Return the text of cameras.txt with one camera."""
    camera = calibration.intrinsics()
    params = spaced(camera.shifted(0.5).params)
    text = _HEAD + "# Pixels; the centre of the first pixel is at (0.5, 0.5).\n# Number of cameras: 1\n"
    text += "".join(f"{line}\n" for line in comment_lines(calibration))
    return f"{text}1 {camera.model} {camera.width} {camera.height} {params}\n".encode()


def _rows(source: Source) -> Iterator[list[str]]:
    for line in source.lines:
        words = line.replace(",", " ").split()
        if len(words) > 4 and words[0].isdigit() and words[2].isdigit() and words[3].isdigit() and words[1].isupper():
            yield words


def recognises_cameras(source: Source) -> bool:
    """Return whether the first line contains an ID, a model name, an image size and parameters."""
    return bool(source.lines) and next(_rows(source), None) is not None and source.lines[0].split()[0].isdigit()


def read_cameras(source: Source, reading: Reading) -> Calibration:
    """Return the camera with the ID of the reading, or the only camera.

    Raises UnknownNameError for an unknown model, and InputError for a missing ID or invalid values.
    """
    rows = {words[0]: words for words in _rows(source)}
    wanted = common.select_camera(rows, reading.name, "FILE#ID", source.path)
    words = rows[wanted]
    params = required_numbers("the parameters", words[4:], None, source.path, f"parameters of {words[1]}")
    width, height = (int(word[:9]) for word in words[2:4])
    return Calibration(_camera(words[1], (width, height), params))


def _camera(model: str, size: tuple[int, int], params: Sequence[float]) -> Camera:
    return Camera(model, *size, tuple(params)).shifted(-0.5)


def write_rig(calibration: Calibration, options: ColmapOptions) -> bytes:
    """Return the JSON text of a rig with the LiDAR as reference sensor and cam_from_rig of the camera."""
    pose = calibration.extrinsic()
    x, y, z, w = quaternion_xyzw(pose)
    camera: dict[str, Any] = {"image_prefix": f"{options.camera_frame}/", "cam_from_rig_rotation": [w, x, y, z]}
    camera["cam_from_rig_translation"] = plain(pose[:3, 3])
    if calibration.camera is not None:
        camera["camera_model_name"] = calibration.camera.model
        camera["camera_params"] = plain(calibration.camera.shifted(0.5).params)
        camera |= {"width": calibration.camera.width, "height": calibration.camera.height}
    axes = "the camera (x right, y down, z forward); m, w x y z"
    text = f"cam_from_rig maps points of {options.lidar_frame} to {axes}"
    camera["comment"] = common.described(calibration, text)
    tree = [{"cameras": [{"image_prefix": f"{options.lidar_frame}/", "ref_sensor": True}, camera]}]
    return common.json_text(tree)


def recognises_rig(source: Source) -> bool:
    """Return whether the file is a list of rigs with cameras."""
    value = source.value
    rigs = value if isinstance(value, list) else []
    return bool(rigs) and all(isinstance(rig, Mapping) and isinstance(rig.get("cameras"), list) for rig in rigs)


def read_rig(source: Source, reading: Reading) -> Calibration:
    """Return the camera of a rig and its pose relative to the LiDAR, which may be the reference or another sensor.

    The camera is None if neither file nor reading gives its image size. Raises InputError if no image prefix denotes a
    LiDAR, and for invalid cameras and transforms.
    """
    where = source.path
    sensors = {name: entry for rig in source.value for name, entry in _sensors(rig)}
    cameras = [name for name in sensors if name != reading.lidar_frame and not is_lidar(name)]
    wanted = reading.camera_frame or reading.name or (cameras[0] if len(cameras) == 1 else None)
    # Sensors of a rig have axes as in COLMAP, whatever their names are.
    named = reading.model_copy(update={"camera_frame": wanted, "camera_axes": "optical"})
    poses = {name: partial(_place, name, entry, source) for name, entry in sensors.items()}
    edges = [Edge("the rig", name, pose, quaternion=True) for name, pose in poses.items()]
    calibration = calibration_of(edges, named, where)
    entry = sensors[calibration.camera_frame]
    if "camera_model_name" not in entry:
        return calibration
    values = required_numbers("camera_params", entry.get("camera_params"), None, where, "parameters of the model")
    size = common.size_of(entry.get("width"), entry.get("height"), reading, where)
    camera = None if size is None else _camera(str(entry["camera_model_name"]), size, values)
    return replace(calibration, camera=camera, lacks_image_size=size is None)


def _sensors(rig: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for entry in rig["cameras"]:
        if isinstance(entry, Mapping) and isinstance(entry.get("image_prefix"), str):
            yield entry["image_prefix"].strip("/")[:120], entry


def _place(name: str, entry: Mapping[str, Any], source: Source) -> Posed:
    """Return rig_from_sensor (4, 4) and remarks."""
    if entry.get("ref_sensor") is True:
        return np.eye(4), ()
    rotation = entry.get("cam_from_rig_rotation")
    w, x, y, z = required_numbers(f"cam_from_rig_rotation of {name}", rotation, 4, source.path, "w x y z")
    value = {"rotation_xyzw": [x, y, z, w], "translation_m": entry.get("cam_from_rig_translation")}
    pose, remarks = read_pose(f"cam_from_rig of {name}", value, source.path)
    return se3.inverse(pose), remarks


FORMAT = Format(
    name="colmap",
    summary="Rig of COLMAP (rig_config.json): the LiDAR as reference sensor, cam_from_rig, camera parameters.",
    rank=30,
    needs=ONLY_EXTRINSIC,
    direction="camera_from_lidar (cam_from_rig)",
    suffix=".json",
    options=ColmapOptions,
    fields=FRAMES | NAMED_SIZE,
    recognises=recognises_rig,
    read=read_rig,
    write=write_rig,
)

CAMERAS_FORMAT = Format(
    name="colmap-cameras",
    summary="Camera of COLMAP (cameras.txt), of any model.",
    rank=31,
    holds=ONLY_CAMERA,
    suffix=".txt",
    fields=frozenset({"name"}),
    recognises=recognises_cameras,
    read=read_cameras,
    write=write_cameras,
)
