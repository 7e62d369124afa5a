"""COLMAP's cameras.txt and rig_config.json.

Source: COLMAP's documentation ("Output format", "Rigs"). COLMAP puts the centre of the first pixel at (0.5, 0.5), so
that principal points there are 0.5 px larger. Quaternions are w x y z. A rig's frame is that of its reference sensor,
which is an image stream in COLMAP: the LiDAR stands there as a sensor without images, and `cam_from_rig` of the camera
is camera_from_lidar. `width` and `height`, which COLMAP takes from the images, are written for p2o.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import naming
from p2o.formats.calibration import Calibration
from p2o.formats.format import BOTH, ONLY_CAMERA, ONLY_EXTRINSIC, Format, Reading, plain, quaternion_xyzw, spaced
from p2o.formats.frame_names import FrameName, is_camera, is_lidar
from p2o.formats.source import Source
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.pose_text import numbers, read_pose
from p2o.native import import_keeping_signals
from p2o.options import Options, field

_HEAD = "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"


class ColmapOptions(Options):
    """Names in a rig, which are the folders of its images."""

    lidar_frame: FrameName = field("lidar", help="Name of the LiDAR in the rig.")
    camera_frame: FrameName = field("camera", help="Name of the camera in the rig, the folder of its images.")


def _shifted(model: str, params: tuple[float, ...], by_px: float) -> tuple[float, ...]:
    """Return parameters with the principal point moved along both axes."""
    pycolmap = import_keeping_signals("pycolmap")
    if model not in pycolmap.CameraModelId.__members__ or model == "INVALID":
        raise UnknownNameError("camera model", model, (m for m in pycolmap.CameraModelId.__members__ if m != "INVALID"))
    blank = pycolmap.Camera.create_from_model_name(0, model, 1.0, 10, 10)
    middle = set(blank.principal_point_idxs())
    return tuple(value + by_px if at in middle else value for at, value in enumerate(params))


def write_cameras(calibration: Calibration, options: Options) -> bytes:
    """Return cameras.txt with one camera."""
    camera = calibration.intrinsics()
    params = spaced(_shifted(camera.model, camera.params, 0.5))
    text = _HEAD + "# Pixels; the centre of the first pixel is at (0.5, 0.5).\n# Number of cameras: 1\n"
    return f"{text}1 {camera.model} {camera.width} {camera.height} {params}\n".encode()


def _rows(source: Source) -> Iterator[list[str]]:
    for line in source.lines:
        words = line.replace(",", " ").split()
        if len(words) > 4 and words[0].isdigit() and words[2].isdigit() and words[3].isdigit() and words[1].isupper():
            yield words


def recognises_cameras(source: Source) -> bool:
    """Return whether its first line is an id, the name of a model, a size and parameters."""
    return bool(source.lines) and next(_rows(source), None) is not None and source.lines[0].split()[0].isdigit()


def read_cameras(source: Source, reading: Reading) -> Calibration:
    """Return the camera of the id that is asked for, or the only one.

    Raises UnknownNameError for an unknown model, InputError for ids that are not there and values that are no camera.
    """
    rows = {words[0]: words for words in _rows(source)}
    wanted = reading.name or (next(iter(rows)) if len(rows) == 1 else "")
    if wanted not in rows:
        raise InputError(
            "which camera of the list?" if not wanted else f"there is no camera {wanted!r}",
            where=source.path,
            expected=f"FILE#ID with one of {', '.join(list(rows)[:8])}",
            got=wanted or f"{len(rows)} cameras",
        )
    words = rows[wanted]
    params = numbers(words[4:], (len(words) - 4,))
    if params is None:
        raise InputError("the parameters are no numbers", where=source.path, got=" ".join(words[4:])[:80])
    width, height = (int(word[:9]) for word in words[2:4])
    with naming(source.path):
        return Calibration(Camera(words[1], width, height, _shifted(words[1], tuple(params.tolist()), -0.5)))


def write_rig(calibration: Calibration, options: ColmapOptions) -> bytes:
    """Return rig_config.json: the LiDAR as reference, and cam_from_rig of the camera."""
    pose = calibration.extrinsic()
    x, y, z, w = quaternion_xyzw(pose)
    camera: dict[str, Any] = {
        "image_prefix": f"{options.camera_frame}/",
        "cam_from_rig_rotation": [w, x, y, z],
        "cam_from_rig_translation": plain(pose[:3, 3]),
    }
    if calibration.camera is not None:
        model = calibration.camera.model
        camera["camera_model_name"] = model
        camera["camera_params"] = plain(_shifted(model, calibration.camera.params, 0.5))
        camera |= {"width": calibration.camera.width, "height": calibration.camera.height}
    camera["comment"] = (
        f"cam_from_rig takes points of {options.lidar_frame} to the camera (x right, y down, z forward); m, w x y z"
    )
    tree = [{"cameras": [{"image_prefix": f"{options.lidar_frame}/", "ref_sensor": True}, camera]}]
    return (json.dumps(tree, indent=2, allow_nan=False) + "\n").encode()


def recognises_rig(source: Source) -> bool:
    """Return whether it is a list of rigs with cameras."""
    value = source.value
    rigs = value if isinstance(value, list) else []
    return bool(rigs) and all(isinstance(rig, Mapping) and isinstance(rig.get("cameras"), list) for rig in rigs)


def read_rig(source: Source, reading: Reading) -> Calibration:
    """Return the camera and the extrinsic of a rig whose reference, or another sensor of it, is the LiDAR.

    A size that neither file nor reading states leaves the camera out. Raises InputError for rigs without a LiDAR among
    the image prefixes, and values that are no camera or no transform.
    """
    where = source.path
    sensors = {name: entry for rig in source.value for name, entry in _sensors(rig)}
    cameras = [name for name in sensors if (reading.lidar_frame or name) != name or not _lidar(name, reading)]
    lidar = [name for name in sensors if _lidar(name, reading)]
    wanted = reading.camera_frame or reading.name or (cameras[0] if len(cameras) == 1 else "")
    if wanted not in sensors or len(lidar) != 1 or wanted == lidar[0]:
        raise InputError(
            "which sensors of the rig are the LiDAR and the camera?",
            where=where,
            expected="one image_prefix of a LiDAR, and FILE#NAME of a camera",
            got=", ".join(list(sensors)[:8]) or "no sensors",
            hint="say it: FILE?lidar_frame=NAME&camera_frame=NAME",
        )
    camera_from_rig, remarks = _place(wanted, sensors[wanted], source)
    lidar_from_rig, more = _place(lidar[0], sensors[lidar[0]], source)
    camera = None
    told = sensors[wanted]
    if "camera_model_name" in told:
        width, height = (told.get(key, getattr(reading, key)) for key in ("width", "height"))
        params = told.get("camera_params")
        values = numbers(params, (len(params),)) if isinstance(params, list) else None
        if values is None:
            raise InputError(f"camera_params of {wanted} are no numbers", where=where, got=str(params)[:60])
        if isinstance(width, int) and isinstance(height, int):
            model = str(told["camera_model_name"])
            with naming(where):
                camera = Camera(model, width, height, _shifted(model, tuple(values.tolist()), -0.5))
        else:
            more = (*more, f"{where}: the camera is left out, as the size of its image is not said (?width=W&height=H)")
    pose = camera_from_rig @ se3.inverse(lidar_from_rig)
    return Calibration(camera, pose, lidar[0], wanted, remarks + more)


def _lidar(name: str, reading: Reading) -> bool:
    if reading.lidar_frame is not None:
        return name == reading.lidar_frame
    return is_lidar(name) and not is_camera(name)


def _sensors(rig: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for entry in rig["cameras"]:
        if isinstance(entry, Mapping) and isinstance(entry.get("image_prefix"), str):
            yield entry["image_prefix"].rstrip("/")[:120], entry


def _place(name: str, told: Mapping[str, Any], source: Source) -> tuple[Float, tuple[str, ...]]:
    if told.get("ref_sensor") is True:
        return np.eye(4), ()
    quaternion = numbers(told.get("cam_from_rig_rotation"), (4,))
    if quaternion is None:
        raise InputError(
            f"cam_from_rig_rotation of {name} is no quaternion", where=source.path, expected="w x y z, finite"
        )
    w, x, y, z = quaternion.tolist()
    pose = {"rotation_xyzw": [x, y, z, w], "translation_m": told.get("cam_from_rig_translation")}
    return read_pose(f"cam_from_rig of {name}", pose, source.path)


FORMAT = Format(
    name="colmap",
    summary="Rig of COLMAP (rig_config.json): the LiDAR as reference sensor, cam_from_rig, camera parameters.",
    holds=BOTH,
    needs=ONLY_EXTRINSIC,
    direction="camera_from_lidar (cam_from_rig)",
    suffix=".json",
    options=ColmapOptions,
    recognises=recognises_rig,
    read=read_rig,
    write=write_rig,
)

CAMERAS_FORMAT = Format(
    name="colmap-cameras",
    summary="Camera of COLMAP (cameras.txt), of any model.",
    holds=ONLY_CAMERA,
    needs=ONLY_CAMERA,
    direction="",
    suffix=".txt",
    recognises=recognises_cameras,
    read=read_cameras,
    write=write_cameras,
)
