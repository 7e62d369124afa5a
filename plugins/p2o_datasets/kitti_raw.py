"""Read the KITTI raw layout: DATE/DATE_drive_NNNN_sync/{image_02, velodyne_points, oxts}, calibration files by day."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from p2o import Dataset, Float, Frame, Image, InputError, Method, Options, field, se3
from p2o.reading import RadialError, existing_folder, layout
from p2o_formats.kitti_calibration import KittiCalibration, read_calibration, rectified_extrinsic
from pydantic import Field, field_validator

from p2o_datasets import kitti_folder
from p2o_datasets.disparity_speed import forward_speed
from p2o_datasets.kitti_folder import images_in, is_number, read_stamp, read_stamps, seconds_of, without_radial_error
from p2o_datasets.kitti_oxts import has_fix, lidar_pose, read_packet, twist_of
from p2o_datasets.lazy_dataset import Listed, read_image
from p2o_datasets.velodyne_file import IMAGE_DELAY_S, SWEEP_S, compensated, read_sweep

_DRIVE = re.compile(r"(\d{4}_\d\d_\d\d)_drive_(\d{4})_(sync|extract)", re.ASCII)
# Half a revolution apart, a sweep belongs to another image; KITTI's cameras are stamped 10 ms after straight ahead.
_SAME_MOMENT_S = 0.03


class KittiRawOptions(Options):
    """Options of the KITTI raw layout."""

    root: Path = field(Path("."), help="Folder that contains the days, or one day, or one drive.")
    camera: int = field(2, ge=0, le=3, help="Camera: 0 and 1 are grey, 2 and 3 colour; 0 and 2 are left.")
    right: bool = field(True, help="Read the right image of the pair (0 with 1, 2 with 3) if it exists.")
    depth: bool = field(True, help="Read depth of camera 2 from disparity/data/FRAME.png if it exists.")
    deskew: bool = field(True, help="Compensate the sweep for the vehicle's motion if it is known (oxts data).")
    image_delay_s: Annotated[float, Field(ge=-0.05, le=0.05)] | None = field(
        None,
        help="Time of the image after the LiDAR points straight ahead, in seconds; a sweep is compensated to this "
        "time. null: 0.004 (KITTI), or 0 if image and sweep have the same time stamp.",
    )
    speed_from_disparity: bool = field(
        False,
        help="Without oxts data, estimate the forward speed from the disparity ground truth of the frame. Only for "
        "labels and evaluation: a calibration from such a sweep depends on ground truth.",
    )
    pykitti_compat: bool = field(False, help="Approximate the camera offset by P[0,3]/P[0,0] as pykitti (mm error).")
    elevation_fix_deg: float = field(0.0, ge=-1, le=1, help="Angle in degrees added to the elevation of every point.")
    radial_error: tuple[float, float] = field(
        (0.0, 0.0),
        help="Relative errors of focal length and radial distortion to correct (as of `pipeline.camera=refine`).",
    )

    @field_validator("radial_error")
    @classmethod
    def _possible(cls, value: tuple[float, float]) -> tuple[float, float]:
        try:
            RadialError(*value)
        except InputError as problem:
            raise ValueError("errors of at most 0.2") from problem
        return value


@dataclass(frozen=True)
class _Drive:
    """One drive: its folder, "date/number", and whether images are rectified and streams synchronised."""

    folder: Path
    name: str
    synchronised: bool


def build(options: KittiRawOptions) -> Dataset:
    """Return the frames of all drives below the root; names are "date/drive/frame".

    A drive that exists both synchronised and as `_extract` is read synchronised. Raises InputError without a frame.
    """
    root = existing_folder(options.root, "KITTI raw drives")
    drives: dict[str, _Drive] = {}
    for folder in sorted([root.resolve(), *root.glob("*_drive_*"), *root.glob("*/*_drive_*")]):
        if (match := _DRIVE.fullmatch(folder.name)) and folder.is_dir():
            date, number, kind = match.groups()
            # "_extract" sorts before "_sync", which replaces it.
            drives[f"{date}/{number}"] = _Drive(folder, f"{date}/{number}", kind == "sync")
    frames = Listed()
    image_folder = f"image_{options.camera:02d}"
    for drive in sorted(drives.values(), key=lambda drive: drive.name):
        clouds = None if drive.synchronised else _nearest_in_time(drive.folder, image_folder)
        folders = (drive.folder / image_folder / "data", drive.folder / "velodyne_points/data")
        lacking = f"no sweep within {_SAME_MOMENT_S:g} s of the image, by their files timestamps.txt"
        why = "" if drive.synchronised else lacking
        kitti_folder.add_pairs(frames, *folders, f"{drive.name}/", (drive,), clouds=clouds, lacking=why)
    expected = f"DATE/DATE_drive_NNNN_sync with {image_folder}/data and velodyne_points/data"
    got = f"{len(drives)} drives" if drives else "no drive"
    return frames.lazy("KITTI raw frames", root, partial(_read, options), expected=expected, got=got)


def _read(options: KittiRawOptions, entry: tuple[_Drive, Path, Path]) -> Frame:
    drive, image_path, sweep_path = entry
    day = drive.folder.parent
    cameras = read_calibration(day / "calib_cam_to_cam.txt")
    mounting = read_calibration(day / "calib_velo_to_cam.txt")
    cam0_from_lidar = mounting.rigid("R", "T")
    if drive.synchronised:
        image, warnings, extrinsic = _rectified(options, drive, image_path, cameras, cam0_from_lidar)
    else:
        image, warnings, extrinsic = _unrectified(options, image_path, cameras, cam0_from_lidar)
    turn_s = _turn_s(sweep_path)
    cloud, cloud_warnings = read_sweep(sweep_path, sweep_s=turn_s, elevation_fix_deg=options.elevation_fix_deg)
    delay_s = _image_delay_s(options, image_path, sweep_path)
    twist, pose, missing = _oxts(drive, image_path, sweep_path, delay_s)
    if twist is None and options.speed_from_disparity and image.depth_m is not None:
        speed = forward_speed(cloud, image.depth_m, image.camera, extrinsic)
        twist = None if speed is None else np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0])
    image = without_radial_error(image, RadialError(*options.radial_error))
    if cloud.time_s is not None:
        cloud = replace(cloud, time_s=cloud.time_s - delay_s)
    cloud, remarks = compensated(cloud, twist, asked=options.deskew, lacking=f"no {missing}")
    warnings = (*warnings, *mounting.remarks(cam0_from_lidar), *cloud_warnings, *remarks)
    name = f"{drive.name}/{image_path.stem}"
    moment: dict[str, Any] = {"time_s": _time_s(image_path), "lidar_world_from_lidar": pose, "sequence": drive.name}
    return Frame(name, image, cloud, camera_from_lidar=extrinsic, twist=twist, warnings=warnings, **moment)


def _rectified(
    options: KittiRawOptions, drive: _Drive, path: Path, cameras: KittiCalibration, cam0_from_lidar: Float
) -> tuple[Image, tuple[str, ...], Float]:
    """Return image, warnings and camera_from_lidar of a synchronised drive."""
    projection = cameras.projection(f"P_rect_{options.camera:02d}")
    right = None
    if options.camera in (0, 2):
        other = f"{options.camera + 1:02d}"
        right_path = kitti_folder.image_in(drive.folder / f"image_{other}/data", path.stem) if options.right else None
        right = (cameras.projection(f"P_rect_{other}"), right_path)
    disparity = drive.folder / "disparity/data" / f"{path.stem}.png"
    depth = disparity if options.depth and options.camera == 2 and disparity.exists() else None
    size = cameras.size(f"S_rect_{options.camera:02d}")
    image, warnings = kitti_folder.read_rectified(path, projection, size=size, right=right, disparity_path=depth)
    rectified_from_lidar = cameras.rigid("R_rect_00") @ cam0_from_lidar
    return image, warnings, rectified_extrinsic(projection, rectified_from_lidar, pykitti_compat=options.pykitti_compat)


def _unrectified(
    options: KittiRawOptions, path: Path, cameras: KittiCalibration, cam0_from_lidar: Float
) -> tuple[Image, tuple[str, ...], Float]:
    """Return image, warnings and camera_from_lidar of an `_extract` drive, with lens distortion."""
    number = f"{options.camera:02d}"
    camera, remarks = cameras.distorted_camera(number, cameras.size(f"S_{number}"))
    image, warnings = read_image(path, camera)
    return image, (*warnings, *remarks), cameras.rigid(f"R_{number}", f"T_{number}") @ cam0_from_lidar


def _stamp(path: Path, end: str = "") -> np.datetime64 | None:
    """Return the time stamp of an image, a packet or a sweep, also that of its "_start" or "_end"; None without one."""
    return read_stamp(path.parents[1] / f"timestamps{end}.txt", int(path.stem))


def _image_delay_s(options: KittiRawOptions, image_path: Path, sweep_path: Path) -> float:
    """Return the time of the image after straight ahead, in seconds."""
    if options.image_delay_s is not None:
        return options.image_delay_s
    image, sweep = _stamp(image_path), _stamp(sweep_path)
    same = image is not None and sweep is not None and abs(image - sweep) < np.timedelta64(1, "ms")
    return 0.0 if same else IMAGE_DELAY_S


def _turn_s(sweep_path: Path) -> float:
    """Return the duration of the sweep from its start and end stamps, or the nominal duration without stamps."""
    start, end = (_stamp(sweep_path, which) for which in ("_start", "_end"))
    seconds = SWEEP_S if start is None or end is None else seconds_of(end - start)
    return seconds if 0.5 * SWEEP_S < seconds < 2 * SWEEP_S else SWEEP_S


def _time_s(image_path: Path) -> float | None:
    """Return the time of the image in seconds after the first stamp of its camera in the drive."""
    stamps, stamp = read_stamps(image_path.parents[1] / "timestamps.txt"), _stamp(image_path)
    return None if stamp is None else seconds_of(stamp - stamps[~np.isnat(stamps)][0])


def _oxts(drive: _Drive, image_path: Path, sweep_path: Path, delay_s: float) -> tuple[Float | None, Float | None, str]:
    """Return velocity (6,) of the LiDAR, its pose (4, 4) in the frame of the first packet, and the missing input."""
    folder, number = drive.folder / "oxts/data", int(image_path.stem)
    if not drive.synchronised:
        # The packet that is nearest in time.
        stamp, stamps = _stamp(image_path), read_stamps(drive.folder / "oxts/timestamps.txt")
        number = -1 if stamp is None or (near := _nearest(stamps, stamp)) is None else near
    if not (path := folder / f"{number:010d}.txt").exists():
        return None, None, "oxts data"
    mounting = drive.folder.parent / "calib_imu_to_velo.txt"
    if not mounting.exists():
        return None, None, mounting.name
    lidar_from_imu = read_calibration(mounting).rigid("R", "T")
    packet, first = (read_packet(p) for p in (path, min(p for p in folder.glob("*.txt") if is_number(p.stem))))
    twist = twist_of(packet, lidar_from_imu)
    later_s = _after_packet_s(path, image_path, sweep_path, delay_s)
    if later_s is None or not (has_fix(packet) and has_fix(first)):
        return twist, None, ""
    return twist, lidar_pose(packet, first, lidar_from_imu) @ se3.exp(later_s * twist), ""


def _after_packet_s(packet_path: Path, image_path: Path, sweep_path: Path, delay_s: float) -> float | None:
    """Return the time of the image after an oxts packet: 0 without stamps, None for different moments."""
    # Packets deviate by up to 10 ms; the image is taken `delay_s` after the stamp of its sweep.
    packet, sweep = _stamp(packet_path), _stamp(sweep_path)
    if packet is not None and sweep is not None:
        later_s = seconds_of(sweep - packet) + delay_s
    else:
        image = _stamp(image_path)
        later_s = 0.0 if packet is None or image is None else seconds_of(image - packet)
    return later_s if abs(later_s) < SWEEP_S else None


def _nearest_in_time(drive: Path, image_folder: str) -> Mapping[str, Path]:
    """Return the sweep of each image id of an unsynchronised drive by the nearest time stamp."""
    image_stamps, cloud_stamps = (
        read_stamps(drive / of / "timestamps.txt") for of in (image_folder, "velodyne_points")
    )
    clouds = kitti_folder.sweeps(drive / "velodyne_points/data")
    pairs: dict[str, Path] = {}
    for name in images_in(drive / image_folder / "data"):
        if not is_number(name) or int(name) >= len(image_stamps):
            continue
        nearest = _nearest(cloud_stamps, image_stamps[int(name)])
        sweep = None if nearest is None else clouds.get(f"{nearest:010d}")
        if sweep is not None and abs(seconds_of(cloud_stamps[nearest] - image_stamps[int(name)])) < _SAME_MOMENT_S:
            pairs[name] = sweep
    return pairs


def _nearest(stamps: NDArray[np.datetime64], stamp: np.datetime64) -> int | None:
    """Return the index of the nearest time stamp, or None if there is none or `stamp` is NaT."""
    gaps = np.abs(stamps - stamp) / np.timedelta64(1, "s")
    return None if np.isnan(gaps).all() else int(np.nanargmin(gaps))


METHOD = Method(
    name="kitti-raw",
    build=build,
    options=KittiRawOptions,
    summary="KITTI raw recordings, any day and drive, synchronised or extracted.",
    gives=frozenset({"rings", "intensity", "time"}),
    cite="Geiger, Lenz, Stiller, Urtasun: Vision meets robotics: the KITTI dataset. IJRR 2013",
    recognises=layout("*_drive_*/velodyne_points", "*/*_drive_*/velodyne_points", "../*_drive_*/velodyne_points"),
)
