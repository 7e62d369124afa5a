"""Read your own data: a folder with one image, one sweep and one frame.yaml, or a folder of such folders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import p2o
from p2o import Dataset, Float, Frame, Image, InputError, Options, Target, field, reading
from p2o.reading import layout, listing, naming, parse_yaml, read_extrinsic, read_text, validated
from p2o_formats.camera_entry import CAMERA_FORMS, read_camera_entry
from p2o_formats.plain_text import states_quaternion
from pydantic import Field

from p2o_datasets.cloud_file import NAMED_SUFFIXES, read_fields, read_points
from p2o_datasets.lazy_dataset import Listed, file_inside, read_image
from p2o_datasets.point_fields import PointClock, Unit

FRAME_FILE = "frame.yaml"
_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


class FolderOptions(Options):
    """Options of a folder of your own frames."""

    root: Path = field(Path("."), help="Folder with an image, a sweep and frame.yaml, or a folder of such folders.")


_EXTRINSICS = ("start", "truth")
_NO_CALIBRATION = (
    "without a calibration, use model PINHOLE with params [f, f, width / 2, height / 2], f = width / 2 / "
    "tan(horizontal field of view / 2), and calibrate several frames jointly with --set pipeline.camera=refine"
)
_WORLDS = ("lidar_world_from_lidar", "camera_world_from_camera")
_SAME_MOMENT_S = 1.0
"""Largest plausible time between image and sweep; a larger one indicates another scene or another clock."""


# Bounds of plausible rates, speeds and times, which keep products of them finite.
_Rate = Annotated[float, Field(ge=-100, le=100)]
_Speed = Annotated[float, Field(ge=-1000, le=1000)]
_Seconds = Annotated[float, Field(ge=-1e12, le=1e12)]
_Length = Annotated[float, Field(gt=0, le=100)]


class _TargetEntry(Options):
    """Target in frame.yaml; its keys are the arguments of the target, in order."""

    made: ClassVar[type[Target]]

    def target(self) -> Target:
        """Return the target; raises InputError for sizes that contradict each other."""
        return self.made(*(getattr(self, key) for key in type(self).model_fields))


class CheckerboardEntry(_TargetEntry):
    """Target of kind checkerboard in frame.yaml."""

    made = p2o.Checkerboard
    columns: int = field(..., ge=2, le=1000, help="Inner corners in a row.")
    rows: int = field(..., ge=2, le=1000, help="Inner corners in a column.")
    square_m: _Length = field(..., help="Side of a square in metres.")
    width_m: _Length = field(..., help="Width of the whole board in metres.")
    height_m: _Length = field(..., help="Height of the whole board in metres.")


class HolesEntry(_TargetEntry):
    """Target of kind holes in frame.yaml: a board with round holes."""

    made = p2o.HoleBoard
    width_m: _Length = field(..., help="Width of the board in metres.")
    height_m: _Length = field(..., help="Height of the board in metres.")
    holes: Annotated[tuple[tuple[float, float, float], ...], Field(min_length=1, max_length=1000)] = field(
        ..., help="x, y and radius of each hole in metres; origin at the centre of the board, y down."
    )


class SphereEntry(_TargetEntry):
    """Target of kind sphere in frame.yaml."""

    made = p2o.Sphere
    radius_m: _Length = field(..., help="Radius of the sphere in metres.")


class BoxEntry(_TargetEntry):
    """Target of kind box in frame.yaml."""

    made = p2o.Box
    width_m: _Length = field(..., help="Width of the box in metres.")
    height_m: _Length = field(..., help="Height of the box in metres.")
    depth_m: _Length = field(..., help="Depth of the box in metres.")


_TARGETS: dict[str, type[_TargetEntry]] = {
    "checkerboard": CheckerboardEntry, "holes": HolesEntry, "sphere": SphereEntry, "box": BoxEntry
}  # fmt: skip


class FrameEntry(Options):
    """Content of frame.yaml; file names are relative to its folder."""

    camera: Any = field(..., help="Camera of the image: a model with parameters, K and D, or a calibration file.")
    image: str | None = field(None, help="File of the image; default: image.*, or the only image of the folder.")
    cloud: str | None = field(None, help="File of the sweep; default: cloud.*, or the only point cloud of the folder.")
    cloud_columns: tuple[str, ...] | None = field(
        None, help="Columns of a .bin, .npy or .txt sweep: x y z intensity ring time, _ for others; default: inferred."
    )
    cloud_scale: float = field(1.0, gt=0, le=1e6, help="Metres per unit of the points; 0.001 for millimetres.")
    point_times: Unit = field(
        "auto", help="Unit of the points' times; auto: the unit in which a sweep takes 4 to 400 ms; none: ignore them."
    )
    start: Any = field(None, help="Initial camera_from_lidar: rows, rotation and translation, words, or a file.")
    truth: Any = field(None, help="Ground truth of camera_from_lidar, if known, in the forms of start, or a file.")
    right: str | None = field(None, help="File of the right image of a rectified stereo pair.")
    baseline_m: float | None = field(None, gt=0, le=1000, help="Distance to the right camera in metres.")
    depth: str | None = field(None, help="Depth along the optical axis: 16 bit PNG (m x 256, 0 unknown) or .npy (m).")
    image_time_s: _Seconds | None = field(None, help="Time of the image in seconds on the clock of the points' times.")
    twist: tuple[_Rate, _Rate, _Rate, _Speed, _Speed, _Speed] | None = field(
        None, help="Velocity of the LiDAR in its frame, rad/s about x y z, then m/s; compensates the raw sweep."
    )
    camera_name: str = field("", help="Name of the camera on its rig, such as CAM_FRONT, the same in all its frames.")
    sequence: str = field("", help="Name of the drive of the frame; frames are in temporal order of their names.")
    time_s: _Seconds | None = field(None, help="Time of the image in seconds, on one clock for the sequence.")
    lidar_world_from_lidar: Any = field(None, help="Pose of the LiDAR at the image in its world, no ground truth.")
    camera_world_from_camera: Any = field(None, help="Pose of the camera in its own world, no ground truth.")
    targets: tuple[dict[str, Any], ...] = field((), help="Targets in view: kind, and the keys of that kind.")


def build(options: FolderOptions) -> Dataset:
    """Return the frame of a folder, or one for each of its sub-folders with a frame.yaml; names are folder names.

    Sub-folders without a frame.yaml are listed in `skipped`. A frame that is not later than the previous one of its
    sequence is refused when it is read.

    Raises InputError if the folder is missing, cannot be read or has no frame.yaml.
    """
    root = reading.existing_folder(options.root, "frames").resolve()
    inside = listing(root, "frames")
    frames = Listed({root.name: root} if root / FRAME_FILE in inside else {})
    for folder in [] if frames.entries else inside:
        if folder.name.startswith(".") or not folder.is_dir():
            continue
        try:
            reason = "" if folder / FRAME_FILE in listing(folder, "a frame") else f"{folder / FRAME_FILE} is missing"
        except InputError as problem:
            reason = str(problem)
        frames.add(folder.name, folder, reason)
    read = partial(_read, root, _falling_times(frames.entries.values()))
    return frames.lazy("frames", root, read, expected=f"{FRAME_FILE} in it or in its sub-folders")


def read_frame_file(path: Path) -> FrameEntry:
    """Read a frame.yaml.

    Raises InputError if it is missing or not YAML, contains objects or aliases (never constructed), or lacks a key, and
    UnknownNameError for an unknown key.
    """
    content = parse_yaml(read_text(path, "frame file"), "frame file", path)
    if not isinstance(content, dict):
        raise InputError("the frame file has no keys", where=path, expected="camera: ...", got=type(content).__name__)
    if content.get("camera") is None:
        raise InputError("the camera is missing", where=path, expected=f"camera: {CAMERA_FORMS}", hint=_NO_CALIBRATION)
    return validated(FrameEntry, content, where=path)


def _falling_times(folders: Iterable[Path]) -> dict[Path, InputError]:
    """Return errors, by folder, for frames not later than the previous one of their camera and sequence."""
    faults: dict[Path, InputError] = {}
    before: dict[tuple[str, str], tuple[str, float]] = {}
    for folder in folders:
        try:
            # Parsing YAML is slow, and most folders have no sequences.
            text = read_text(folder / FRAME_FILE, "frame file")
            entry = read_frame_file(folder / FRAME_FILE) if "sequence" in text and "time_s" in text else None
        except InputError:
            continue
        if entry is None or not entry.sequence or entry.time_s is None:
            continue
        drive = (entry.sequence, entry.camera_name)
        name, time_s = before.get(drive, ("", -np.inf))
        if entry.time_s <= time_s:
            fault = f"the times of sequence '{entry.sequence}' do not increase from frame to frame"
            expected, got = f"time_s after {time_s:.9g} of frame '{name}'", f"{entry.time_s:.9g}"
            hint, where = "frames are in the order of their folders' names", folder / FRAME_FILE
            faults[folder] = InputError(fault, where=where, expected=expected, got=got, hint=hint)
        else:
            before[drive] = (folder.name, entry.time_s)
    return faults


def _read(root: Path, faults: Mapping[Path, InputError], folder: Path) -> Frame:
    path = _inside(root, folder, FRAME_FILE)
    if folder in faults:
        raise faults[folder]
    entry = read_frame_file(path)
    resolve = partial(_inside, root, folder)
    camera, camera_remarks = _camera(entry.camera, path, resolve)
    if (entry.right is None) != (entry.baseline_m is None):
        fault = "a rectified pair needs its right image and its baseline"
        raise InputError(fault, where=path, expected="right, baseline_m")
    values = {name: getattr(entry, name) for name in (*_EXTRINSICS, *_WORLDS)}
    read = {name: _posed(name, value, path, resolve) for name, value in values.items() if value is not None}
    poses = {name: pose for name, (pose, *_) in read.items()}
    with naming(path):
        targets = tuple(_target(f"targets.{number}", values, path) for number, values in enumerate(entry.targets))
    image, warnings = _image(root, folder, entry, camera)
    warnings += camera_remarks + tuple(warning for _, remarks, _ in read.values() for warning in remarks)
    cloud_path = _file(root, folder, entry.cloud, "cloud", NAMED_SUFFIXES)
    clock = PointClock.of_image(entry.image_time_s, entry.point_times)
    required = clock.required or entry.twist is not None
    clock = replace(clock, required=required, setting=f"in {FRAME_FILE}, point_times: ")
    fields = read_fields(cloud_path, entry.cloud_columns)
    cloud, cloud_warnings, unused = read_points(fields, cloud_path, clock, entry.cloud_scale)
    warnings += cloud_warnings
    if entry.image_time_s is not None and cloud.time_s is not None and np.abs(cloud.time_s).min() > _SAME_MOMENT_S:
        expected = f"image_time_s within {_SAME_MOMENT_S:g} s of a time of {cloud_path.name}, on the same clock"
        got = f"{np.abs(cloud.time_s).min():.3g} s apart"
        raise InputError("image and sweep are not of the same time", where=path, expected=expected, got=got)
    twist = None if entry.twist is None else np.array(entry.twist)
    if twist is not None:
        if cloud.time_s is None:
            fault = "a sweep without times cannot be compensated for motion"
            got, hint = f"twist in {FRAME_FILE}", "omit twist if the sweep is already compensated"
            raise InputError(fault, where=cloud_path, expected="a time per point", got=got, hint=hint)
        with naming(path):
            cloud = cloud.untwisted(twist)
    elif entry.image_time_s is None:
        # Times without a relation to the image's clock carry no information; compensated sweeps may keep theirs.
        cloud = replace(cloud, time_s=None)
    for name in (name for name in _EXTRINSICS if name in poses):
        pose, _, quaternion = read[name]
        warnings += reading.check_direction(cloud, camera, pose, name=name, where=path, quaternion=quaternion)
    parts: dict[str, Any] = {"camera_from_lidar": poses.pop("truth", None), **poses, "twist": twist, "targets": targets}
    parts["unused_fields"] = unused
    parts |= entry.model_dump(include={"sequence", "time_s", "camera_name"})
    return Frame(folder.name, image, cloud, warnings=warnings, **parts)


def _camera(value: Any, path: Path, resolve: Callable[[str], Path]) -> tuple[p2o.Camera, tuple[str, ...]]:
    """Return the camera of a value of frame.yaml, which may name a calibration file, and remarks on it."""
    if isinstance(value, str):
        calibration = reading.read_calibration(value, path, resolve)
        return calibration.intrinsics(value), calibration.remarks
    return read_camera_entry(value, path)


def _posed(name: str, value: Any, path: Path, resolve: Callable[[str], Path]) -> tuple[Float, tuple[str, ...], bool]:
    """Return a pose (4, 4) of frame.yaml, remarks, and whether it is a camera_from_lidar given as a quaternion.

    The text of a camera_from_lidar is words or a calibration file.
    """
    if name in _WORLDS:
        return (*reading.read_pose(name, value, path), False)
    if isinstance(value, str) and reading.names_file(value):
        calibration = reading.read_calibration(value, path, resolve)
        return calibration.extrinsic(value), calibration.remarks, calibration.quaternion
    if isinstance(value, str) and name == "start":
        return (*reading.read_initial_guess(value, path, resolve), False)
    return (*read_extrinsic(name, value, path), states_quaternion(value))


def _target(name: str, values: Mapping[str, Any], path: Path) -> Target:
    """Return a target of frame.yaml; raises InputError for an unknown kind, wrong keys, and contradictory sizes."""
    if "kind" not in values:
        raise InputError(f"{name}.kind is missing", where=path, expected=" or ".join(_TARGETS))
    if (kind := str(values["kind"])) not in _TARGETS:
        raise p2o.UnknownNameError("kind of target", kind, _TARGETS, where=path)
    sizes = {key: value for key, value in values.items() if key != "kind"}
    return validated(_TARGETS[kind], sizes, name, where=path, noun=f"key of {name}").target()


def _image(root: Path, folder: Path, entry: FrameEntry, camera: p2o.Camera) -> tuple[Image, tuple[str, ...]]:
    others = {name for name in (entry.right, entry.depth) if name is not None}
    path = _file(root, folder, entry.image, "image", _IMAGE_SUFFIXES, others)
    right = None if entry.right is None else (_inside(root, folder, entry.right), entry.baseline_m)
    depth = None if entry.depth is None else (_inside(root, folder, entry.depth), _read_depth)
    return read_image(path, camera, right=right, depth=depth)


def _read_depth(path: Path, size: tuple[int, int]) -> Float:
    if path.suffix.lower() != ".npy":
        return reading.read_uint16(path, "depth", size)
    values = reading.read_npy(reading.read_bytes(path, "depth", reading.MAX_BYTES), path)
    if values.dtype.kind not in "iuf":
        raise InputError("the .npy file has no numbers", where=path, expected="(H, W) float", got=values.dtype)
    if values.shape != size[::-1]:
        fault = "the depth size does not fit the camera"
        raise InputError(fault, where=path, expected=f"{size[0]}x{size[1]} px", got=f"an array {values.shape}")
    # Signalling NaN and numbers beyond double precision would emit warnings.
    with np.errstate(invalid="ignore", over="ignore"):
        depth: Float = values.astype(np.float64)
    depth[depth == 0] = np.nan
    return depth


def _file(
    root: Path, folder: Path, name: str | None, default: str, suffixes: Iterable[str], others: Iterable[str] = ()
) -> Path:
    """Return the named file, else default.*, else the only file of the folder with one of the suffixes but .npy."""
    if name is not None:
        return _inside(root, folder, name)
    files = [path for path in listing(folder, "a frame") if path.suffix.lower() in suffixes]
    names = sorted(path.name for path in files if path.name not in set(others))
    names = [n for n in names if Path(n).stem == default] or [n for n in names if Path(n).suffix.lower() != ".npy"]
    if len(names) != 1:
        fault = f"the {default} is ambiguous" if names else f"there is no {default}"
        expected = f"{default} with one of {' '.join(suffixes)}"
        hint = f"name it in {FRAME_FILE}: '{default}: FILE'"
        raise InputError(fault, where=folder, expected=expected, got=", ".join(names[:5]) or "none", hint=hint)
    return _inside(root, folder, names[0])


def _inside(root: Path, folder: Path, name: str) -> Path:
    return file_inside(root, folder, name, folder / FRAME_FILE)


METHOD = p2o.Method(
    name="folder",
    build=build,
    options=FolderOptions,
    summary="Your own frames: an image, a sweep and a frame.yaml in one folder each.",
    gives=frozenset({"rings", "intensity", "time"}),
    parallel=True,
    recognises=layout("frame.yaml", "*/frame.yaml"),
)
