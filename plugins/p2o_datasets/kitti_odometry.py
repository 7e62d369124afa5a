"""Read the KITTI odometry layout: sequences/NN/{image_2, velodyne, calib.txt, times.txt}, poses/NN.txt.

Its sweeps are already motion-compensated.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from p2o import Dataset, Float, Frame, InputError, Method, Options, field, se3
from p2o.reading import existing_folder, layout, numbers, read_text
from p2o_formats.kitti_calibration import camera_offset, read_calibration, rectified_extrinsic, refuse_cut_off

from p2o_datasets.kitti_folder import add_pairs, image_in, read_rectified
from p2o_datasets.lazy_dataset import Listed
from p2o_datasets.velodyne_file import read_sweep


class KittiOdometryOptions(Options):
    """Options of the KITTI odometry layout."""

    root: Path = field(Path("."), help="Folder that contains sequences/, or sequences/ itself, or one sequence.")
    camera: int = field(2, ge=0, le=3, help="Camera: 0 and 1 are grey, 2 and 3 colour; 0 and 2 are left.")
    right: bool = field(True, help="Read the right image of the pair (0 with 1, 2 with 3) if it exists.")
    pykitti_compat: bool = field(False, help="Approximate the camera offset by P[0,3]/P[0,0] as pykitti (mm error).")
    elevation_fix_deg: float = field(0.0, ge=-1, le=1, help="Angle in degrees added to the elevation of every point.")


def build(options: KittiOdometryOptions) -> Dataset:
    """Return the frames of one or all sequences; names are "NN/FRAME". Raises InputError without a frame."""
    root = existing_folder(options.root, "KITTI odometry sequences")
    folder = root / "sequences" if (root / "sequences").is_dir() else root
    sequences = [folder] if (folder / "velodyne").is_dir() else sorted(p.parent for p in folder.glob("*/velodyne"))
    frames = Listed()
    image_folder = f"image_{options.camera}"
    for sequence in sequences:
        add_pairs(frames, sequence / image_folder, sequence / "velodyne", f"{sequence.resolve().name}/")
    expected = f"frames with NN/{image_folder}/ID.png and NN/velodyne/ID.bin"
    return frames.lazy("KITTI odometry frames", folder, partial(_read, options), expected=expected)


def _read(options: KittiOdometryOptions, entry: tuple[Path, Path]) -> Frame:
    image_path, sweep_path = entry
    sequence = sweep_path.parents[1]
    name = f"{sequence.resolve().name}/{image_path.stem}"
    calibration = read_calibration(sequence / "calib.txt")
    projection = calibration.projection(f"P{options.camera}")
    right = None
    if options.right and options.camera in (0, 2):
        other = options.camera + 1
        right = (calibration.projection(f"P{other}"), image_in(sequence / f"image_{other}", image_path.stem))
    image, warnings = read_rectified(image_path, projection, right=right)
    number = int(image_path.stem)
    time = _line(sequence / "times.txt", "file of times", number, 1)
    time_s = None if time is None else float(time[0])
    pose = _camera_pose(sequence, number, camera_offset(projection, pykitti_compat=options.pykitti_compat))
    for path, value in ((sequence / "times.txt", time_s), (_poses_file(sequence), pose)):
        if value is None and path.exists():
            warnings += (f"{path}: the file ends before line {number + 1}, the line of this frame",)
    camera0_from_lidar = calibration.rigid_12("Tr")
    warnings += calibration.remarks(camera0_from_lidar)
    extrinsic = rectified_extrinsic(projection, camera0_from_lidar, pykitti_compat=options.pykitti_compat)
    # Motion-compensated points have no times.
    cloud, cloud_warnings = read_sweep(sweep_path, sweep_s=None, elevation_fix_deg=options.elevation_fix_deg)
    warnings += cloud_warnings
    drive: dict[str, Any] = {"sequence": sequence.resolve().name, "time_s": time_s, "camera_world_from_camera": pose}
    return Frame(name, image, cloud, camera_from_lidar=extrinsic, warnings=warnings, **drive)


def _camera_pose(sequence: Path, frame: int, offset_m: Float) -> Float | None:
    """Return camera_world_from_camera (4, 4) of a frame, or None if poses/NN.txt or its line is missing."""
    # The poses are those of camera 0, at `offset_m` in the camera; the world is the camera at the first line.
    path = _poses_file(sequence)
    lines = [(number, _line(path, "file of poses", number, 12)) for number in (0, frame)]
    rows = [(f"line {number + 1}", values.reshape(3, 4)) for number, values in lines if values is not None]
    if len(rows) < len(lines):
        return None
    first, pose = (se3.check_rigid(name, se3.make(row[:, :3], row[:, 3]), where=path) for name, row in rows)
    camera_from_camera0 = se3.make(translation=offset_m)
    return camera_from_camera0 @ se3.inverse(first) @ pose @ se3.inverse(camera_from_camera0)


def _poses_file(sequence: Path) -> Path:
    folder = sequence.resolve()
    return folder.parent.parent / "poses" / f"{folder.name}.txt"


def _line(path: Path, what: str, frame: int, count: int) -> Float | None:
    """Return the numbers (count,) in the line of a frame, or None without the file or the line."""
    text = read_text(path, what) if path.exists() else ""
    lines = text.splitlines()
    if frame == len(lines) - 1:
        refuse_cut_off(text, path)
    if frame >= len(lines):
        return None
    values = numbers(lines[frame].split(), (count,))
    if values is None:
        got = lines[frame].strip()[:60] or "none"
        raise InputError(f"line {frame + 1} of the {what} does not contain {count} finite numbers", where=path, got=got)
    return values


METHOD = Method(
    name="kitti-odometry",
    build=build,
    options=KittiOdometryOptions,
    summary="KITTI odometry sequences, sweeps already motion-compensated.",
    gives=frozenset({"rings", "intensity"}),
    cite="Geiger, Lenz, Urtasun: Are we ready for autonomous driving? The KITTI vision benchmark suite. CVPR 2012",
    recognises=layout("sequences/*/velodyne", "[0-9][0-9]/velodyne", "../[0-9][0-9]/velodyne"),
)
