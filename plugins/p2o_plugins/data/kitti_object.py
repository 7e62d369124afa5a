"""The KITTI object detection layout: training/{image_2, velodyne, calib}, one calibration a frame."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

from p2o import Dataset, Frame, InputError, Method, Options, field
from p2o.files.input_file import existing_folder
from p2o.formats.kitti_calibration import read_calibration, rectified_extrinsic

from p2o_plugins.data.kitti_folder import paired, picture, pictures, sweeps
from p2o_plugins.data.kitti_image import read_rectified
from p2o_plugins.data.lazy_frames import LazyFrames
from p2o_plugins.data.velodyne_file import IMAGE_DELAY_S, NOT_UNTWISTED, SWEEP_S, read_sweep


class KittiObjectOptions(Options):
    """Options of the KITTI object layout."""

    root: Path = field(Path("."), help="Folder that holds training/, or training/ (or testing/) itself.")
    right: bool = field(True, help="Read the right picture (image_3) where it is present.")
    pykitti_compat: bool = field(False, help="Shorten the camera offset to P[0,3]/P[0,0] as pykitti does (mm off).")
    elevation_fix_deg: float = field(0.0, ge=-1, le=1, help="Angle in degrees added to the elevation of every point.")


def build(options: KittiObjectOptions) -> Dataset:
    """Return the frames of a KITTI object folder; names are the frame ids.

    Raises InputError if the folder is missing or holds no frame with both image and sweep.
    """
    root = existing_folder(options.root, "KITTI object frames")
    folder = root / "training" if (root / "training").is_dir() else root
    entries, skipped = paired(
        pictures(folder / "image_2"), sweeps(folder / "velodyne"), folder, "image_2", "velodyne", numbered=False
    )
    if not entries:
        raise InputError(
            "no KITTI object frames",
            where=folder,
            expected="frames with image_2/ID.png and velodyne/ID.bin",
            got=next(iter(skipped.values()), None),
        )
    return LazyFrames(entries, partial(_read, folder, options), skipped)


def _read(folder: Path, options: KittiObjectOptions, entry: tuple[str, Path, Path]) -> Frame:
    name, image_path, sweep_path = entry
    calibration = read_calibration(folder / "calib" / f"{name}.txt")
    projection = calibration.projection("P2")
    rectified_from_lidar = calibration.rigid("R0_rect") @ calibration.rigid_12("Tr_velo_to_cam")
    image, warnings = read_rectified(
        image_path,
        projection,
        right_projection=calibration.projection("P3") if options.right else None,
        right_path=picture(folder / "image_3", name) if options.right else None,
    )
    cloud, cloud_warnings = read_sweep(sweep_path, sweep_s=SWEEP_S, elevation_fix_deg=options.elevation_fix_deg)
    if cloud.time_s is not None:
        cloud = replace(cloud, time_s=cloud.time_s - IMAGE_DELAY_S)
    return Frame(
        name,
        image,
        cloud,
        camera_from_lidar=rectified_extrinsic(projection, rectified_from_lidar, pykitti_compat=options.pykitti_compat),
        warnings=(*warnings, *cloud_warnings, NOT_UNTWISTED),
    )


METHOD = Method(
    name="kitti-object",
    build=build,
    options=KittiObjectOptions,
    summary="KITTI object detection frames, each with its own calibration.",
    gives=frozenset({"rings", "intensity", "time"}),
    cite="Geiger, Lenz, Urtasun: Are we ready for autonomous driving? The KITTI vision benchmark suite. CVPR 2012",
)
