"""The KITTI odometry layout: sequences/NN/{image_2, velodyne, calib.txt, times.txt}, poses/NN.txt.

Its sweeps are already untwisted.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
from p2o import Dataset, Frame, InputError, Method, Options, field, se3
from p2o.arrays import Float
from p2o.files.input_file import existing_folder, read_text
from p2o.formats.kitti_calibration import camera_offset, read_calibration, rectified_extrinsic

from p2o_plugins.data.kitti_folder import paired, picture, pictures, sweeps
from p2o_plugins.data.kitti_image import read_rectified
from p2o_plugins.data.lazy_frames import LazyFrames
from p2o_plugins.data.velodyne_file import read_sweep


class KittiOdometryOptions(Options):
    """Options of the KITTI odometry layout."""

    root: Path = field(Path("."), help="Folder that holds sequences/, or sequences/ itself, or one sequence.")
    camera: int = field(2, ge=0, le=3, help="Camera: 0 and 1 are grey, 2 and 3 colour; 0 and 2 are left.")
    right: bool = field(True, help="Read the right picture of the pair (0 with 1, 2 with 3) where it is present.")
    pykitti_compat: bool = field(False, help="Shorten the camera offset to P[0,3]/P[0,0] as pykitti does (mm off).")
    elevation_fix_deg: float = field(0.0, ge=-1, le=1, help="Angle in degrees added to the elevation of every point.")


def build(options: KittiOdometryOptions) -> Dataset:
    """Return the frames of one or all sequences; names are "NN/FRAME".

    Raises InputError if the folder is missing or holds no frame with both image and sweep.
    """
    root = existing_folder(options.root, "KITTI odometry sequences")
    folder = root / "sequences" if (root / "sequences").is_dir() else root
    sequences = [folder] if (folder / "velodyne").is_dir() else sorted(p.parent for p in folder.glob("*/velodyne"))
    entries: dict[str, tuple[str, Path, Path]] = {}
    skipped: dict[str, str] = {}
    image_folder = f"image_{options.camera}"
    for sequence in sequences:
        more, without = paired(
            pictures(sequence / image_folder),
            sweeps(sequence / "velodyne"),
            sequence,
            image_folder,
            "velodyne",
            prefix=f"{sequence.resolve().name}/",
        )
        entries.update(more)
        skipped.update(without)
    if not entries:
        raise InputError(
            "no KITTI odometry frames",
            where=folder,
            expected=f"frames with NN/{image_folder}/ID.png and NN/velodyne/ID.bin",
            got=next(iter(skipped.values()), None),
        )
    return LazyFrames(entries, partial(_read, options), skipped)


def _read(options: KittiOdometryOptions, entry: tuple[str, Path, Path]) -> Frame:
    name, image_path, sweep_path = entry
    sequence = sweep_path.parents[1]
    calibration = read_calibration(sequence / "calib.txt")
    projection = calibration.projection(f"P{options.camera}")
    has_right = options.right and options.camera in (0, 2)
    other = options.camera + 1
    image, warnings = read_rectified(
        image_path,
        projection,
        right_projection=calibration.projection(f"P{other}") if has_right else None,
        right_path=picture(sequence / f"image_{other}", image_path.stem) if has_right else None,
    )
    number = int(image_path.stem)
    time_s = _time_s(sequence, number)
    # No pose of the LiDAR: it would be this one and the truth.
    pose = _camera_pose(sequence, number, camera_offset(projection, pykitti_compat=options.pykitti_compat))
    for path, value in ((sequence / "times.txt", time_s), (_poses_file(sequence), pose)):
        if value is None and path.exists():
            warnings += (f"{path}: the file ends before line {number + 1}, which is this frame's",)
    # Untwisted points no longer tell when they were measured.
    cloud, cloud_warnings = read_sweep(sweep_path, sweep_s=None, elevation_fix_deg=options.elevation_fix_deg)
    return Frame(
        name,
        image,
        cloud,
        camera_from_lidar=rectified_extrinsic(
            projection, calibration.rigid_12("Tr"), pykitti_compat=options.pykitti_compat
        ),
        warnings=(*warnings, *cloud_warnings),
        sequence=sequence.resolve().name,
        time_s=time_s,
        camera_world_from_camera=pose,
    )


def _time_s(sequence: Path, frame: int) -> float | None:
    """Return the time of a frame in seconds, or None where times.txt or its line is absent."""
    values = _line(sequence / "times.txt", "file of times", frame, 1)
    return None if values is None else float(values[0])


def _camera_pose(sequence: Path, frame: int, offset_m: Float) -> Float | None:
    """Return camera_world_from_camera (4, 4) of a frame, or None where poses/NN.txt or its line is absent.

    The file holds the poses of camera 0; `offset_m` (3,) is where that lies in the camera. The world is the frame that
    the camera had in the first line.
    """
    path = _poses_file(sequence)
    poses: list[Float] = []
    for number in (0, frame):
        values = _line(path, "file of poses", number, 12)
        if values is None:
            return None
        matrix = np.vstack([values.reshape(3, 4), [0, 0, 0, 1]])
        poses.append(se3.check_rigid(f"line {number + 1}", matrix, where=path))
    first, pose = poses
    camera_from_camera0 = se3.make(translation=offset_m)
    return camera_from_camera0 @ se3.inverse(first) @ pose @ se3.inverse(camera_from_camera0)


def _poses_file(sequence: Path) -> Path:
    folder = sequence.resolve()
    return folder.parent.parent / "poses" / f"{folder.name}.txt"


def _line(path: Path, what: str, frame: int, count: int) -> Float | None:
    """Return the numbers (count,) in the line of a frame, or None without the file or the line.

    Raises InputError if the line holds anything else.
    """
    lines = read_text(path, what).splitlines() if path.exists() else []
    if frame >= len(lines):
        return None
    try:
        values = np.array(lines[frame].split(), dtype=np.float64)
    except ValueError:
        values = np.empty(0)
    if values.size != count or not np.isfinite(values).all():
        raise InputError(
            f"line {frame + 1} of the {what} does not hold {count} finite numbers",
            where=path,
            got=lines[frame].strip()[:60] or "none",
        )
    return values


METHOD = Method(
    name="kitti-odometry",
    build=build,
    options=KittiOdometryOptions,
    summary="KITTI odometry sequences, sweeps already motion-compensated.",
    gives=frozenset({"rings", "intensity"}),
    cite="Geiger, Lenz, Urtasun: Are we ready for autonomous driving? The KITTI vision benchmark suite. CVPR 2012",
)
