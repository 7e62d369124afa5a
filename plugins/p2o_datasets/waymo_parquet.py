"""A segment of Waymo's release v2: one Parquet file per component, with one row per frame and sensor.

The format follows waymo-research/waymo-open-dataset: src/waymo_open_dataset/v2/component.py (names of columns) and
v2/perception/base.py, camera_image.py, context.py, lidar.py, pose.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from p2o import InputError

from p2o_datasets.arrow_file import ParquetTable
from p2o_datasets.waymo_range_image import LENS, SHUTTER, STAMPS, VELOCITY, grid

COMPONENTS = ("camera_image", "lidar", "camera_calibration", "lidar_calibration", "lidar_pose", "vehicle_pose")
_FRAME, _CAMERA, _LASER = (f"key.{name}" for name in ("frame_timestamp_micros", "camera_name", "laser_name"))
_TOP = 1
_Value = TypeVar("_Value")


@dataclass(frozen=True, eq=False)
class ParquetSegment:
    """A segment, whose files are read on demand. Sensors are identified by their numbers."""

    root: Path
    name: str

    def where(self, part: str) -> Path:
        """Return the path of a component's file."""
        return self.root / part / f"{self.name}.parquet"

    def images(self, camera: int) -> Mapping[int, int]:
        """Return the rows of a camera's images by the time stamps of their frames in microseconds."""
        return self._numbered("camera_image", _CAMERA, camera)

    def sweeps(self, lidar: int) -> Mapping[int, int]:
        """Return the rows of a LiDAR's sweeps by the time stamps of their frames in microseconds."""
        return self._numbered("lidar", _LASER, lidar)

    @cached_property
    def camera_rows(self) -> Mapping[int, Mapping[str, Any]]:
        """Calibration of each camera: `LENS`, extrinsic.transform, width, height and `SHUTTER`."""
        fields = (*(f"intrinsic.{name}" for name in LENS), "extrinsic.transform", "width", "height", SHUTTER)
        return self._rows("camera_calibration", _CAMERA, "CameraCalibrationComponent", fields)

    @cached_property
    def lidar_rows(self) -> Mapping[int, Mapping[str, Any]]:
        """Calibration of each LiDAR: extrinsic.transform and the inclinations of its beams."""
        fields = ("extrinsic.transform", *(f"beam_inclination.{name}" for name in ("min", "max", "values")))
        return self._rows("lidar_calibration", _LASER, "LiDARCalibrationComponent", fields)

    def image(self, row: int, camera: int) -> Mapping[str, Any]:
        """Return the JPEG (`image`), `pose.transform`, `VELOCITY` and `STAMPS` of an image."""
        names = ("image", "pose.transform", *VELOCITY, *STAMPS)
        cells = self._table("camera_image").row(row, [f"[CameraImageComponent].{name}" for name in names])
        return dict(zip(names, cells.values(), strict=True))

    def ranges(self, row: int, lidar: int, where: Path) -> Any:
        """Return the first returns (H, W, 4) of a sweep: range in metres, intensity, elongation, a flag."""
        return self._grid("lidar", row, "LiDARComponent", 4, where)

    def pixel_poses(self, frame_us: int) -> Any:
        """Return the poses (H, W, 6) of the top LiDAR's pixels, None if the frame has none."""
        row = self._pose_rows.get(frame_us)
        return None if row is None else self._grid("lidar_pose", row, "LiDARPoseComponent", 6, self.where("lidar_pose"))

    def frame_pose(self, frame_us: int) -> Any:
        """Return the numbers of a frame's world_from_vehicle, None if the frame has none."""
        row = self._frame_rows.get(frame_us)
        column = "[VehiclePoseComponent].world_from_vehicle.transform"
        return None if row is None else self._table("vehicle_pose").row(row, [column])[column]

    @cached_property
    def _frame_rows(self) -> Mapping[int, int]:
        """Rows of vehicle_pose by the time stamps of frames."""
        return self._by_key("vehicle_pose", ((time, row) for row, time in enumerate(self._key("vehicle_pose", _FRAME))))

    @cached_property
    def _pose_rows(self) -> Mapping[int, int]:
        """Rows of lidar_pose by the time stamps of frames."""
        return self._numbered("lidar_pose", _LASER, _TOP)

    def _table(self, component: str) -> ParquetTable:
        return ParquetTable(self.where(component), f"component {component}")

    def _key(self, component: str, key: str) -> list[int]:
        values: list[int] = self._table(component).columns({key: "integer"})[key].tolist()
        return values

    def _numbered(self, component: str, key: str, number: int) -> dict[int, int]:
        """Return the rows of one sensor by the time stamps of their frames."""
        keys = self._table(component).columns({_FRAME: "integer", key: "integer"})
        rows = np.flatnonzero(keys[key] == number)
        return self._by_key(component, zip(keys[_FRAME][rows].tolist(), rows.tolist(), strict=True))

    def _by_key(self, component: str, pairs: Iterable[tuple[int, _Value]]) -> dict[int, _Value]:
        """Return the pairs as a mapping; raises InputError for a frame or sensor with several rows."""
        values: dict[int, _Value] = {}
        for key, value in pairs:
            if key in values:
                raise InputError("two rows have the same key", where=self.where(component), expected="one", got=key)
            values[key] = value
        return values

    def _rows(self, component: str, key: str, prefix: str, fields: Sequence[str]) -> Mapping[int, Mapping[str, Any]]:
        table, names = self._table(component), [f"[{prefix}].{name}" for name in fields]
        keys = enumerate(self._key(component, key))
        rows = ((number, dict(zip(fields, table.row(row, names).values(), strict=True))) for row, number in keys)
        return self._by_key(component, rows)

    def _grid(self, component: str, row: int, prefix: str, channels: int, where: Path) -> Any:
        names = [f"[{prefix}].range_image_return1.{part}" for part in ("values", "shape")]
        values, shape = self._table(component).row(row, names).values()
        sizes = shape.tolist() if isinstance(shape, np.ndarray) and shape.dtype.kind == "i" else []
        return grid(values, sizes, channels, where)
