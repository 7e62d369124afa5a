"""Your own data: a folder with one image, one sweep and one frame.yaml, or a folder of such folders."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from p2o import (
    Box,
    Camera,
    Checkerboard,
    Dataset,
    Frame,
    HoleBoard,
    Image,
    InputError,
    Method,
    Options,
    Sphere,
    Target,
    UnknownNameError,
    field,
)
from p2o.arrays import Float
from p2o.files.array_file import MAX_BYTES, read_npy
from p2o.files.input_file import existing_folder, listing, naming, read_bytes, read_text
from p2o.files.parsed_text import parse_yaml
from p2o.formats.camera_entry import read_camera
from p2o.formats.files import camera_words, extrinsic_words, names_file, start_words
from p2o.frames.direction import check_direction
from p2o.geometry.pose_text import read_extrinsic, read_pose
from p2o.host.validation import validated
from pydantic import Field

from p2o_plugins.data.cloud_file import SUFFIXES as CLOUD_SUFFIXES
from p2o_plugins.data.cloud_file import read_cloud
from p2o_plugins.data.image_file import read_rgb, read_uint16
from p2o_plugins.data.lazy_frames import LazyFrames

FRAME_FILE = "frame.yaml"
_IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")


class FolderOptions(Options):
    """Options of a folder of your own frames."""

    root: Path = field(Path("."), help="Folder with an image, a sweep and frame.yaml, or a folder of such folders.")


_EXTRINSICS = ("start", "truth")
_WORLDS = ("lidar_world_from_lidar", "camera_world_from_camera")
_SAME_MOMENT_S = 1.0
"""No sweep takes longer, so an image that is further away is not of its scene, or its clock is another."""


# Nothing that is driven turns or goes faster, and no clock in seconds counts further: products of these stay finite.
_Rate = Annotated[float, Field(ge=-100, le=100)]
_Speed = Annotated[float, Field(ge=-1000, le=1000)]
_Seconds = Annotated[float, Field(ge=-1e12, le=1e12)]


class CheckerboardEntry(Options):
    """A target of kind checkerboard in frame.yaml."""

    columns: int = field(..., ge=2, le=1000, help="Inner corners in a row.")
    rows: int = field(..., ge=2, le=1000, help="Inner corners in a column.")
    square_m: float = field(..., gt=0, le=100, help="Side of a square in metres.")
    width_m: float = field(..., gt=0, le=100, help="Width of the whole board in metres.")
    height_m: float = field(..., gt=0, le=100, help="Height of the whole board in metres.")

    def target(self) -> Checkerboard:
        """Return the target; raises InputError if the pattern does not fit its board."""
        return Checkerboard(self.columns, self.rows, self.square_m, self.width_m, self.height_m)


class HolesEntry(Options):
    """A target of kind holes in frame.yaml: a board with round holes."""

    width_m: float = field(..., gt=0, le=100, help="Width of the board in metres.")
    height_m: float = field(..., gt=0, le=100, help="Height of the board in metres.")
    holes: tuple[tuple[float, float, float], ...] = field(
        ...,
        min_length=1,
        max_length=1000,
        help="x, y and radius of each hole in metres; origin in the middle of the board, y down.",
    )

    def target(self) -> HoleBoard:
        """Return the target; raises InputError if a hole has no size or reaches beyond the board."""
        return HoleBoard(self.width_m, self.height_m, self.holes)


class SphereEntry(Options):
    """A target of kind sphere in frame.yaml."""

    radius_m: float = field(..., gt=0, le=100, help="Radius of the sphere in metres.")

    def target(self) -> Sphere:
        """Return the target."""
        return Sphere(self.radius_m)


class BoxEntry(Options):
    """A target of kind box in frame.yaml."""

    width_m: float = field(..., gt=0, le=100, help="Width of the box in metres.")
    height_m: float = field(..., gt=0, le=100, help="Height of the box in metres.")
    depth_m: float = field(..., gt=0, le=100, help="Depth of the box in metres.")

    def target(self) -> Box:
        """Return the target."""
        return Box(self.width_m, self.height_m, self.depth_m)


_TARGETS: dict[str, type[CheckerboardEntry | HolesEntry | SphereEntry | BoxEntry]] = {
    "checkerboard": CheckerboardEntry,
    "holes": HolesEntry,
    "sphere": SphereEntry,
    "box": BoxEntry,
}


class FrameEntry(Options):
    """What frame.yaml holds; file names are relative to its folder."""

    camera: Any = field(..., help="The camera that took the image: a model with parameters, K and D, or a file.")
    image: str | None = field(None, help="File of the image; default: image.*, or the only picture of the folder.")
    cloud: str | None = field(None, help="File of the sweep; default: cloud.*, or the only point cloud of the folder.")
    cloud_columns: tuple[str, ...] | None = field(
        None,
        help="Columns of a .bin or .txt sweep: x y z intensity ring time, _ for others; default: the values tell.",
    )
    start: Any = field(
        None, help="First guess of camera_from_lidar: rows of numbers, rotation and translation, words, or a file."
    )
    truth: Any = field(None, help="True camera_from_lidar where it is known, as start, or a file.")
    right: str | None = field(None, help="File of the right picture of a rectified pair.")
    baseline_m: float | None = field(
        None, gt=0, le=1000, help="Distance in metres from the image's camera to the right one."
    )
    depth: str | None = field(None, help="File of depth along the axis: 16 bit PNG (m x 256, 0 unknown) or .npy (m).")
    image_time_s: _Seconds | None = field(None, help="Time of the image in seconds on the clock of the points' times.")
    twist: tuple[_Rate, _Rate, _Rate, _Speed, _Speed, _Speed] | None = field(
        None,
        help="Velocity of the LiDAR in its own frame, about x y z in rad/s, then along x y z in m/s: the sweep, as "
        "measured, is corrected by it.",
    )
    camera_name: str = field(
        "", help="Word for the camera on its rig, such as CAM_FRONT; frames of one camera say the same."
    )
    sequence: str = field("", help="Name of the drive that the frame is of; its frames follow in order of their names.")
    time_s: _Seconds | None = field(None, help="When the image was taken, in seconds on one clock for the sequence.")
    lidar_world_from_lidar: Any = field(
        None, help="Pose of the LiDAR when the image was taken, in a world of its own; never made from the truth."
    )
    camera_world_from_camera: Any = field(
        None, help="Pose of the camera when the image was taken, in a world of its own; never made from the truth."
    )
    targets: tuple[dict[str, Any], ...] = field(
        (), help="Calibration targets in view, what they are and not where: kind, and the keys of that kind."
    )


def build(options: FolderOptions) -> Dataset:
    """Return the one frame of a folder, or one for each of its sub-folders that holds a frame.yaml.

    Names are folder names. Sub-folders without a frame.yaml are listed in `skipped`.

    A frame that is not later than the one before it in its sequence is refused when it is read.

    Raises InputError if the folder is missing, cannot be read or holds no frame.yaml.
    """
    root = existing_folder(options.root, "frames").resolve()
    entries: dict[str, Path] = {}
    skipped: dict[str, str] = {}
    inside = listing(root, "frames")
    if root / FRAME_FILE in inside:
        entries[root.name] = root
    else:
        for folder in inside:
            if folder.name.startswith(".") or not folder.is_dir():
                continue
            try:
                if folder / FRAME_FILE in listing(folder, "a frame"):
                    entries[folder.name] = folder
                else:
                    skipped[folder.name] = f"{folder / FRAME_FILE} is missing"
            except InputError as problem:
                skipped[folder.name] = str(problem)
    if not entries:
        raise InputError(
            "no frames",
            where=root,
            expected=f"{FRAME_FILE} in it or in its sub-folders",
            got=next(iter(skipped.values()), None),
        )
    return LazyFrames(entries, partial(_read, root, _falling_times(entries.values())), skipped)


def read_frame_file(path: Path) -> FrameEntry:
    """Return what a frame.yaml says.

    Raises InputError if it is missing, not YAML, holds objects or aliases (never built), or lacks or misspells a key.
    """
    content = parse_yaml(read_text(path, "frame file"), "frame file", path)
    if not isinstance(content, dict):
        raise InputError("the frame file has no keys", where=path, expected="camera: ...", got=type(content).__name__)
    return validated(FrameEntry, content, where=path)


def _falling_times(folders: Iterable[Path]) -> dict[Path, InputError]:
    """Return what is wrong with frames of a sequence that are not later than the frame of their camera before them.

    It is by folder. Files that cannot be read are left for the frame itself to refuse.
    """
    found: dict[Path, InputError] = {}
    before: dict[tuple[str, str], tuple[str, float]] = {}
    for folder in folders:
        try:
            # Most folders hold no sequences, and YAML is slow to read.
            text = read_text(folder / FRAME_FILE, "frame file")
            entry = read_frame_file(folder / FRAME_FILE) if "sequence" in text and "time_s" in text else None
        except InputError:
            continue
        if entry is None or not entry.sequence or entry.time_s is None:
            continue
        drive = (entry.sequence, entry.camera_name)
        name, time_s = before.get(drive, ("", -np.inf))
        if entry.time_s <= time_s:
            found[folder] = InputError(
                f"the times of sequence '{entry.sequence}' do not rise from frame to frame",
                where=folder / FRAME_FILE,
                expected=f"time_s after {time_s:.9g} of frame '{name}'",
                got=f"{entry.time_s:.9g}",
                hint="frames follow in the order of their folders' names",
            )
        else:
            before[drive] = (folder.name, entry.time_s)
    return found


def _read(root: Path, faults: Mapping[Path, InputError], folder: Path) -> Frame:
    path = _inside(root, folder, FRAME_FILE)
    if folder in faults:
        raise faults[folder]
    entry = read_frame_file(path)
    place = partial(_inside, root, folder)
    said = entry.camera
    camera = camera_words(said, path, place) if isinstance(said, str) else read_camera(said, path)
    if (entry.right is None) != (entry.baseline_m is None):
        raise InputError(
            "a rectified pair needs its right picture and its baseline", where=path, expected="right, baseline_m"
        )
    read = {
        **{
            name: _extrinsic(name, value, path, place)
            for name in _EXTRINSICS
            if (value := getattr(entry, name)) is not None
        },
        **{name: read_pose(name, value, path) for name in _WORLDS if (value := getattr(entry, name)) is not None},
    }
    poses = {name: pose for name, (pose, _) in read.items()}
    with naming(path):
        targets = tuple(_target(f"targets.{number}", values, path) for number, values in enumerate(entry.targets))
    image, warnings = _image(root, folder, entry, camera)
    warnings += tuple(warning for _, remarks in read.values() for warning in remarks)
    cloud_path = _file(root, folder, entry.cloud, "cloud", CLOUD_SUFFIXES)
    cloud, cloud_warnings = read_cloud(cloud_path, entry.image_time_s, entry.cloud_columns)
    warnings += cloud_warnings
    if entry.image_time_s is not None and cloud.time_s is not None and np.abs(cloud.time_s).min() > _SAME_MOMENT_S:
        raise InputError(
            "image and sweep are not of the same moment",
            where=path,
            expected=f"image_time_s within {_SAME_MOMENT_S:g} s of a time of {cloud_path.name}, on the same clock",
            got=f"{np.abs(cloud.time_s).min():.3g} s apart",
        )
    twist = None if entry.twist is None else np.array(entry.twist)
    if twist is not None:
        if cloud.time_s is None:
            raise InputError(
                "a sweep without times cannot be corrected for motion",
                where=cloud_path,
                expected="a time per point",
                got=f"twist in {FRAME_FILE}",
                hint="leave twist out if the sweep is corrected already",
            )
        with naming(path):
            cloud = cloud.untwisted(twist)
    if twist is None and entry.image_time_s is None:
        # Times that nobody placed on the image's clock say nothing, and sweeps that were corrected may keep theirs.
        cloud = replace(cloud, time_s=None)
    for name in (name for name in _EXTRINSICS if name in poses):
        warnings += check_direction(cloud, camera, poses[name], name=name, where=path)
    return Frame(
        folder.name,
        image,
        cloud,
        camera_from_lidar=poses.get("truth"),
        start=poses.get("start"),
        twist=twist,
        warnings=warnings,
        sequence=entry.sequence,
        time_s=entry.time_s,
        **{name: poses.get(name) for name in _WORLDS},
        targets=targets,
        camera_name=entry.camera_name,
    )


def _extrinsic(name: str, value: Any, path: Path, place: Callable[[str], Path]) -> tuple[Float, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) of a value of frame.yaml, and remarks; a text is words or a calibration file."""
    if isinstance(value, str) and name == "start":
        return start_words(value, path, place)
    if isinstance(value, str) and names_file(value):
        return extrinsic_words(value, path, place)
    return read_extrinsic(name, value, path)


def _target(name: str, values: Mapping[str, Any], path: Path) -> Target:
    """Return a target of frame.yaml; raises InputError for an unknown kind, wrong keys, and sizes that do not fit."""
    if "kind" not in values:
        raise InputError(f"{name}.kind is not said", where=path, expected=" or ".join(_TARGETS))
    kind = str(values["kind"])
    if kind not in _TARGETS:
        raise UnknownNameError("kind of target", kind, _TARGETS, where=path)
    sizes = {key: value for key, value in values.items() if key != "kind"}
    return validated(_TARGETS[kind], sizes, name, where=path, noun=f"key of {name}").target()


def _image(root: Path, folder: Path, entry: FrameEntry, camera: Camera) -> tuple[Image, tuple[str, ...]]:
    others = {name for name in (entry.right, entry.depth) if name is not None}
    path = _file(root, folder, entry.image, "image", _IMAGE_SUFFIXES, others)
    size = (camera.width, camera.height)
    rgb, warnings = read_rgb(path, size)
    with naming(path):
        image = Image(rgb, camera)
    right = depth_m = None
    if entry.right is not None:
        right_path = _inside(root, folder, entry.right)
        right, more = read_rgb(right_path, size)
        warnings += more
        with naming(right_path):
            Image(rgb, camera, right=right, baseline_m=entry.baseline_m)
    if entry.depth is not None:
        depth_path = _inside(root, folder, entry.depth)
        depth_m = _read_depth(depth_path, size)
        with naming(depth_path):
            Image(rgb, camera, depth_m=depth_m)
    if right is None and depth_m is None:
        return image, warnings
    return Image(rgb, camera, right=right, baseline_m=entry.baseline_m, depth_m=depth_m), warnings


def _read_depth(path: Path, size: tuple[int, int]) -> Float:
    if path.suffix.lower() != ".npy":
        return read_uint16(path, "depth", size)
    values = read_npy(read_bytes(path, "depth", MAX_BYTES), path)
    if values.dtype.kind not in "iuf":
        raise InputError("this is not an .npy file of numbers", where=path, expected="(H, W) float", got=values.dtype)
    if values.shape != size[::-1]:
        raise InputError(
            "the depth size does not fit the camera",
            where=path,
            expected=f"{size[0]}x{size[1]} px",
            got=f"an array {values.shape}",
        )
    # Signalling NaN would warn, and numbers beyond double precision.
    with np.errstate(invalid="ignore", over="ignore"):
        depth = values.astype(np.float64)
    depth[depth == 0] = np.nan
    return depth


def _file(
    root: Path, folder: Path, name: str | None, default: str, suffixes: Iterable[str], others: Iterable[str] = ()
) -> Path:
    """Return the named file, else default.*, else the only file of the folder with one of the suffixes."""
    if name is not None:
        return _inside(root, folder, name)
    found = sorted(
        p.name for p in listing(folder, "a frame") if p.suffix.lower() in suffixes and p.name not in set(others)
    )
    found = [n for n in found if Path(n).stem == default] or found
    if len(found) != 1:
        raise InputError(
            f"no single file can be the {default}",
            where=folder,
            expected=f"{default} with one of {' '.join(suffixes)}",
            got=", ".join(found[:5]) or "none",
            hint=f"name it in {FRAME_FILE}: '{default}: FILE'",
        )
    return _inside(root, folder, found[0])


def _inside(root: Path, folder: Path, name: str) -> Path:
    """Return the path of a file name of frame.yaml; raises InputError if it, links followed, leaves the root."""
    path = folder / name
    try:
        inside = path.resolve().is_relative_to(root)
    except (OSError, RuntimeError, ValueError) as problem:
        raise InputError(f"bad file name {name!r}", where=folder / FRAME_FILE) from problem
    if not inside:
        raise InputError(
            f"the path '{name}' leaves the folder of the dataset",
            where=folder / FRAME_FILE,
            expected=f"a file below {root}",
            got=path.resolve(),
            hint="copy the file into the folder",
        )
    return path


METHOD = Method(
    name="folder",
    build=build,
    options=FolderOptions,
    summary="Your own frames: an image, a sweep and a frame.yaml in one folder each.",
    gives=frozenset({"rings", "intensity", "time"}),
    parallel=True,
)
