"""Read the KITTI object detection layout: training/{image_2, velodyne, calib}, one calibration per frame."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from p2o import Dataset, Frame, Method, Options, field
from p2o.reading import existing_folder, layout
from p2o_formats.kitti_calibration import read_calibration, rectified_extrinsic

from p2o_datasets.kitti_folder import add_pairs, image_in, read_rectified
from p2o_datasets.lazy_dataset import Listed
from p2o_datasets.velodyne_file import IMAGE_DELAY_S, NOT_UNTWISTED, SWEEP_S, read_sweep


class KittiObjectOptions(Options):
    """Options of the KITTI object layout."""

    root: Path = field(Path("."), help="Folder that contains training/, or training/ (or testing/) itself.")
    right: bool = field(True, help="Read the right image (image_3) if it exists.")
    pykitti_compat: bool = field(False, help="Approximate the camera offset by P[0,3]/P[0,0] as pykitti (mm error).")
    elevation_fix_deg: float = field(0.0, ge=-1, le=1, help="Angle in degrees added to the elevation of every point.")


def build(options: KittiObjectOptions) -> Dataset:
    """Return the frames of a KITTI object folder by frame id; raises InputError without a frame."""
    root = existing_folder(options.root, "KITTI object frames")
    folder = root / "training" if (root / "training").is_dir() else root
    frames = Listed()
    add_pairs(frames, folder / "image_2", folder / "velodyne", numbered=False)
    expected = "frames with image_2/ID.png and velodyne/ID.bin"
    return frames.lazy("KITTI object frames", folder, partial(_read, folder, options), expected=expected)


def _read(folder: Path, options: KittiObjectOptions, entry: tuple[Path, Path]) -> Frame:
    image_path, sweep_path = entry
    name = image_path.stem
    calibration = read_calibration(folder / "calib" / f"{name}.txt")
    projection = calibration.projection("P2")
    camera0_from_lidar = calibration.rigid_12("Tr_velo_to_cam")
    rectified_from_lidar = calibration.rigid("R0_rect") @ camera0_from_lidar
    right = (calibration.projection("P3"), image_in(folder / "image_3", name)) if options.right else None
    image, warnings = read_rectified(image_path, projection, right=right)
    cloud, cloud_warnings = read_sweep(sweep_path, sweep_s=SWEEP_S, elevation_fix_deg=options.elevation_fix_deg)
    if cloud.time_s is not None:
        cloud = replace(cloud, time_s=cloud.time_s - IMAGE_DELAY_S)
    extrinsic = rectified_extrinsic(projection, rectified_from_lidar, pykitti_compat=options.pykitti_compat)
    warnings = (*warnings, *calibration.remarks(camera0_from_lidar), *cloud_warnings, NOT_UNTWISTED)
    return Frame(name, image, cloud, camera_from_lidar=extrinsic, warnings=warnings)


METHOD = Method(
    name="kitti-object",
    build=build,
    options=KittiObjectOptions,
    summary="KITTI object detection frames, each with its own calibration.",
    gives=frozenset({"rings", "intensity", "time"}),
    cite="Geiger, Lenz, Urtasun: Are we ready for autonomous driving? The KITTI vision benchmark suite. CVPR 2012",
    recognises=layout("training/velodyne", "calib/[0-9]*.txt"),
)
