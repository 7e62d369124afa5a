"""Read and write calibrations of FAST-LIVO and FAST-LIVO2: Rcl, Pcl and a camera; FAST-Calib writes its results so.

Source: the configuration files of FAST-LIVO (section `camera`) and FAST-LIVO2 (section `extrin_calib`, also below
`ros__parameters`), the camera files of its library vikit, and the results of FAST-Calib (`single_calib_result.txt`,
`multi_calib_result.txt`). p_camera = Rcl p_lidar + Pcl, in metres. `cam_model` Pinhole has cam_d0 to cam_d3 = k1 k2 p1
p2, EquidistantCamera k1 to k4 of `cv::fisheye`. FAST-LIVO scales images by `scale` when it reads them; the camera is
that of the whole image. extrinsic_R and extrinsic_T are of the IMU and are ignored.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Literal

from p2o import Camera, InputError, Options, field
from p2o.reading import Calibration, Reading, Source, digits, listed, read_pose

from p2o_formats.camera_entry import Lens, lens_of, unsupported_model
from p2o_formats.format import NAMED_SIZE, Format, comment_lines, required_numbers, select_camera, size_of

_DEPTH = 4
"""Number of levels of sections in which the keys are looked for."""
_PINHOLE = ("cam_fx", "cam_fy", "cam_cx", "cam_cy")
_COEFFICIENTS = {
    "plumb_bob": (("cam_d0", "cam_d1", "cam_d2", "cam_d3"), ("cam_k1", "cam_k2", "cam_p1", "cam_p2")),
    "equidistant": (("k1", "k2", "k3", "k4"), ("cam_k1", "cam_k2", "cam_k3", "cam_k4")),
}
_MODELS = {"pinhole": "plumb_bob", "equidistant": "equidistant"}


class FastLivoOptions(Options):
    """Layout of the file."""

    layout: Literal["result", "config"] = field(
        "result",
        help="result: keys as FAST-Calib writes them; config: Rcl and Pcl below extrin_calib, as in FAST-LIVO2.",
    )


def write(calibration: Calibration, options: FastLivoOptions) -> bytes:
    """Return the text; raises InputError for camera models that vikit does not have."""
    head = "# Maps points of the LiDAR to the camera: p_camera = Rcl p_lidar + Pcl, in metres. Camera x right, y down."
    lines = [head, *comment_lines(calibration)]
    if calibration.camera is not None:
        lines += _camera_lines(calibration.camera)
    if calibration.camera_from_lidar is not None:
        pose = calibration.camera_from_lidar
        indent = "  " if options.layout == "config" else ""
        lines += ["extrin_calib:"] if indent else []
        rows = f",\n{indent}      ".join(listed(row)[1:-1] for row in pose[:3, :3])
        lines += [f"{indent}Rcl: [{rows}]", f"{indent}Pcl: {listed(pose[:3, 3])}"]
    return ("\n".join(lines) + "\n").encode()


def _camera_lines(camera: Camera) -> list[str]:
    lens = lens_of(camera, "fast-livo")
    if lens.model not in _COEFFICIENTS or (lens.model == "plumb_bob" and lens.coefficients[4]):
        raise unsupported_model(camera, "fast-livo", "a pinhole with k1 k2 p1 p2, or an equidistant fisheye")
    name = "Pinhole" if lens.model == "plumb_bob" else "EquidistantCamera"
    keys = (*_PINHOLE, *_COEFFICIENTS[lens.model][0])
    values = (lens.fx, lens.fy, lens.cx, lens.cy, *lens.coefficients[:4])
    size = [f"cam_width: {lens.width}", f"cam_height: {lens.height}", "scale: 1.0"]
    return [f"cam_model: {name}", *size, *(f"{k}: {digits(v)}" for k, v in zip(keys, values, strict=True))]


def _sections(tree: Mapping[str, Any], name: str = "", depth: int = _DEPTH) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the mapping of a file and those in it, with the names of their keys."""
    yield name, tree
    for key, value in tree.items() if depth else ():
        if isinstance(value, Mapping):
            yield from _sections(value, str(key)[:120], depth - 1)


def _with(keys: set[str], source: Source) -> dict[str, Mapping[str, Any]]:
    """Return the sections that contain all keys, by name."""
    return {name: tree for name, tree in _sections(source.tree) if keys <= tree.keys()}


def recognises(source: Source) -> bool:
    """Return whether the file contains Rcl and Pcl, or a camera of vikit."""
    return bool(_with({"Rcl", "Pcl"}, source) or _with({"cam_model", *_PINHOLE}, source))


def read(source: Source, reading: Reading) -> Calibration:
    """Return the camera and the extrinsic; of several sections the one that the reading names.

    Raises InputError for other camera models, and for values that are no numbers or not rigid.
    """
    camera, lacks_size, pose = None, False, None
    remarks: tuple[str, ...] = ()
    cameras, transforms = _with({"cam_model", *_PINHOLE}, source), _with({"Rcl", "Pcl"}, source)
    if cameras:
        entry = cameras[_selected(cameras, reading, source)]
        size = size_of(entry.get("cam_width"), entry.get("cam_height"), reading, source.path)
        lacks_size, camera = size is None, None if size is None else _lens(entry, size, source).camera()
    if transforms:
        entry = transforms[_selected(transforms, reading, source)]
        parts = {"rotation": entry["Rcl"], "translation_m": entry["Pcl"]}
        pose, remarks = read_pose("Rcl, Pcl", parts, source.path)
    return Calibration(camera, pose, remarks=remarks, lacks_image_size=lacks_size)


def _selected(sections: Mapping[str, Any], reading: Reading, source: Source) -> str:
    wanted = reading.name if len(sections) > 1 else None
    return select_camera(sections, wanted, "FILE#SECTION", source.path)


def _lens(entry: Mapping[str, Any], size: tuple[int, int], source: Source) -> Lens:
    name = str(entry["cam_model"])[:60]
    model = _MODELS.get(name.lower().removesuffix("camera"))
    if model is None:
        expected = "Pinhole or EquidistantCamera"
        raise InputError("cam_model is not supported", where=source.path, expected=expected, got=name)
    keys = next((keys for keys in _COEFFICIENTS[model] if keys[0] in entry), _COEFFICIENTS[model][0])
    given = [entry.get(key, 0.0) for key in (*_PINHOLE, *keys)]
    fx, fy, cx, cy, *d = required_numbers(" ".join((*_PINHOLE, *keys)), given, None, source.path, "px")
    return Lens(*size, fx, fy, cx, cy, model, tuple(d))


FORMAT = Format(
    name="fast-livo",
    summary="FAST-LIVO, FAST-LIVO2 and results of FAST-Calib: Rcl, Pcl, and the camera (cam_model, cam_fx, ...).",
    rank=28,
    cite="Zheng et al., IROS 2022 (FAST-LIVO); Zheng and Zhou, 2025 (FAST-Calib)",
    direction="camera_from_lidar (Rcl, Pcl)",
    suffix=".txt",
    options=FastLivoOptions,
    fields=NAMED_SIZE,
    recognises=recognises,
    read=read,
    write=write,
)
