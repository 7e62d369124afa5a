"""A small segment of Waymo's true format (v2), written by pyarrow alone: components as Parquet files."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pyarrow as pa
from pyarrow import parquet
from scipy.spatial.transform import Rotation

from .drive import SPEED_M_S, TURN_RAD_S, car, mounted, through, tilted

SEGMENT = "10017090168044687777_6380_000_6400_000"
START_US = 1_550_083_467_346_370
WIDTH, HEIGHT = 96, 64
LENS = {"f_u": 80.0, "f_v": 81.0, "c_u": 47.6, "c_v": 31.2}
LENS |= {"k1": 0.04, "k2": -0.3, "p1": 0.002, "p2": -0.001, "k3": 0.1}
CAMERAS = {1: mounted(tilted((0.5, -1, 0.8)), 1.5, 0.0, 2.1), 4: mounted(tilted((0, 1, 90)), 1.4, 0.1, 2.1)}
LIDARS = {1: mounted(tilted((0.4, -0.3, 148)), 1.43, 0.0, 2.18), 5: mounted(tilted((0, 1, 178)), -1.1, 0.0, 0.5)}
ROWS, COLUMNS = 16, 180
INCLINATIONS = np.linspace(-0.3, 0.05, ROWS) ** 3 * 2 + np.linspace(-0.25, 0.04, ROWS)
SHUTTER_S, READOUT_S = 0.002, 0.042
EXTRINSIC = "[CameraCalibrationComponent].extrinsic.transform"


def seconds(time_us: float) -> float:
    return (time_us - START_US) * 1e-6


def ranges(laser: int, frame_us: int) -> Any:
    row, column = np.meshgrid(np.arange(ROWS), np.arange(COLUMNS), indexing="ij")
    far = 9 + 5 * np.sin(column / 17 + laser) ** 2 + 3 * np.cos(row * 1.3 + frame_us % 7) ** 2
    return np.where((row + column) % 11 == 0, 0.0, far).astype(np.float32)


def time_of(frame_us: int, column: Any) -> Any:
    """Return when a column is measured: the frame's stamp is the start of the turn."""
    return seconds(frame_us) + 0.1 * np.asarray(column) / COLUMNS


def world_points(laser: int, frame_us: int) -> Any:
    """Return what a laser sees, pixel by pixel (ROWS, COLUMNS, 3), in the world; NaN where nothing."""
    far = ranges(laser, frame_us).astype(float)
    lidar = LIDARS[laser]
    yaw = np.arctan2(lidar[1, 0], lidar[0, 0])
    angles = INCLINATIONS if laser == 1 else -0.4 + 0.6 * (np.arange(ROWS) + 0.5) / ROWS
    found = np.full((ROWS, COLUMNS, 3), np.nan)
    for column in range(COLUMNS):
        azimuth = np.pi - 2 * np.pi * (column + 0.5) / COLUMNS - yaw
        pose = car(float(time_of(frame_us, column))) if laser == 1 else frame_pose(frame_us)
        for row in range(ROWS):
            up = angles[ROWS - 1 - row]
            ray = np.array([np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up)])
            if far[row, column] > 0:
                found[row, column] = through(pose @ lidar, far[row, column] * ray[None])[0]
    return found


def frame_pose(frame_us: int) -> Any:
    """Return the pose of a frame: that at the middle of the turn."""
    return car(seconds(frame_us) + 0.05)


class Segment:
    """Rows of the components; tests change them before `write`."""

    def __init__(self, root: Path, name: str = SEGMENT) -> None:
        self.root, self.name = root, name
        self.frames = [START_US + number * 100_000 for number in range(3)]
        self.components: dict[str, list[dict[str, Any]]] = {
            "camera_calibration": [self.camera_calibration(number) for number in CAMERAS],
            "lidar_calibration": [self.lidar_calibration(number) for number in LIDARS],
            "vehicle_pose": [self.vehicle_pose(frame) for frame in self.frames],
            "camera_image": [self.image(frame, number) for frame in self.frames for number in CAMERAS],
            "lidar": [self.sweep(frame, number) for frame in self.frames for number in LIDARS],
            "lidar_pose": [self.pixel_pose(frame) for frame in self.frames],
        }

    def row(self, component: str, values: dict[str, Any], frame_us: int | None = None, **number: int) -> dict[str, Any]:
        """Return a row with the names of a component's columns."""
        frame = {} if frame_us is None else {"key.frame_timestamp_micros": frame_us}
        keys = {"key.segment_context_name": self.name, **frame, **{f"key.{k}": v for k, v in number.items()}}
        return keys | {f"[{component}Component].{name}": value for name, value in values.items()}

    def vehicle_pose(self, frame_us: int) -> dict[str, Any]:
        pose = {"world_from_vehicle.transform": frame_pose(frame_us).ravel().tolist()}
        return self.row("VehiclePose", pose, frame_us)

    def camera_calibration(self, number: int) -> dict[str, Any]:
        values = {f"intrinsic.{name}": value for name, value in LENS.items()}
        values |= {"extrinsic.transform": CAMERAS[number].ravel().tolist()}
        values |= {"width": WIDTH, "height": HEIGHT, "rolling_shutter_direction": 2}
        return self.row("CameraCalibration", values, camera_name=number)

    def lidar_calibration(self, number: int) -> dict[str, Any]:
        values = {
            "extrinsic.transform": LIDARS[number].ravel().tolist(),
            "beam_inclination.min": float(INCLINATIONS[0]) if number == 1 else -0.4,
            "beam_inclination.max": float(INCLINATIONS[-1]) if number == 1 else 0.2,
            "beam_inclination.values": INCLINATIONS.tolist() if number == 1 else None,
        }
        return self.row("LiDARCalibration", values, laser_name=number)

    def image(self, frame_us: int, number: int) -> dict[str, Any]:
        jpeg = io.BytesIO()
        grey = (frame_us // 100_000 * 7 + number * 40) % 256
        PIL.Image.fromarray(np.full((HEIGHT, WIDTH, 3), grey, np.uint8)).save(jpeg, "JPEG")
        opened_s = frame_us * 1e-6 + 0.03 + 0.01 * number
        pose = car(opened_s + 0.01 - START_US * 1e-6)
        linear = pose[:3, :3] @ [SPEED_M_S, 0, 0.2]
        values = {"image": jpeg.getvalue(), "pose.transform": pose.ravel().tolist()}
        for kind, velocity in (("linear", linear.tolist()), ("angular", (0.0, 0.0, TURN_RAD_S))):
            values |= {f"velocity.{kind}_velocity.{axis}": v for axis, v in zip("xyz", velocity, strict=True)}
        values |= {
            "pose_timestamp": opened_s + 0.01,
            "rolling_shutter_params.shutter": SHUTTER_S,
            "rolling_shutter_params.camera_trigger_time": opened_s,
            "rolling_shutter_params.camera_readout_done_time": opened_s + SHUTTER_S + READOUT_S,
        }
        return self.row("CameraImage", values, frame_us, camera_name=number)

    def sweep(self, frame_us: int, number: int) -> dict[str, Any]:
        pixels = np.zeros((ROWS, COLUMNS, 4), np.float32)
        pixels[..., 0], pixels[..., 1] = ranges(number, frame_us), 0.25
        grid = {"values": pixels.ravel().tolist(), "shape": list(pixels.shape)}
        values = {f"range_image_return{which}.{part}": value for which in (1, 2) for part, value in grid.items()}
        return self.row("LiDAR", values, frame_us, laser_name=number)

    def pixel_pose(self, frame_us: int) -> dict[str, Any]:
        six = np.zeros((ROWS, COLUMNS, 6), np.float32)
        for column in range(COLUMNS):
            pose = car(float(time_of(frame_us, column)))
            yaw, pitch, roll = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX")
            six[:, column] = roll, pitch, yaw, *pose[:3, 3]
        values = {"range_image_return1.values": six.ravel().tolist(), "range_image_return1.shape": list(six.shape)}
        return self.row("LiDARPose", values, frame_us, laser_name=1)

    def write(self) -> Path:
        for component, rows in self.components.items():
            folder = self.root / component
            folder.mkdir(parents=True, exist_ok=True)
            names = list(dict.fromkeys(name for row in rows for name in row))
            table = pa.table({name: pa.array([row.get(name) for row in rows], kind(name)) for name in names})
            parquet.write_table(table, folder / f"{self.name}.parquet", row_group_size=2)
        return self.root


def kind(name: str) -> Any:
    """Return the type of a column as the public code declares it, None where Arrow tells it from Python's."""
    if name.endswith(".transform"):
        return pa.list_(pa.float64(), 16)
    if ".range_image_" in name:
        return pa.list_(pa.float32()) if name.endswith(".values") else pa.list_(pa.int32(), 3)
    small = {"key.camera_name": pa.int8(), "key.laser_name": pa.int8(), "key.frame_timestamp_micros": pa.int64()}
    return small.get(name, pa.list_(pa.float64()) if name.endswith("inclination.values") else None)
