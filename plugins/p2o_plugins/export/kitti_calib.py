"""The extrinsic in the text formats of KITTI's calibration files.

All three hold camera_from_lidar of the camera that was calibrated, in metres, row by row, with 17 digits. KITTI's own
files go through camera 0 and projections P0 to P3; here the camera itself takes that place: use them with
P = [K | 0] and R_rect = identity, so that x = K . [I | 0] . Tr . X. A stereo partner keeps its own shift in its P.

- object: `R0_rect` (identity) and `Tr_velo_to_cam`, as in training/calib/NNNNNN.txt
- raw: `R` and `T`, as in calib_velo_to_cam.txt
- odometry: `Tr`, as in sequences/NN/calib.txt
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from p2o import Exporter, InputError, Method, Options, Result, field
from p2o.arrays import Float
from p2o.files.whole_file import write_whole


class KittiCalibOptions(Options):
    """Which of KITTI's files is written."""

    layout: Literal["object", "raw", "odometry"] = field("object", help="The data set of KITTI whose file it is like.")


def build(options: KittiCalibOptions) -> Exporter:
    """Return the exporter; it raises InputError for a result without a pose, which such a file could not tell apart."""

    def export(result: Result, path: Path) -> None:
        if not result.status.solved:
            raise InputError(
                "this result has no new pose to export",
                where=path,
                expected="a solved calibration",
                got=f"{result.status.value} ({result.reason})",
                hint="export it with json, which keeps the status",
            )
        write_whole(path, calibration_text(result.camera_from_lidar, options.layout).encode())

    return export


def calibration_text(camera_from_lidar: Float, layout: Literal["object", "raw", "odometry"]) -> str:
    """Return the lines "key: numbers" of a transform (4, 4) in one of the layouts."""
    rotation, translation, both = camera_from_lidar[:3, :3], camera_from_lidar[:3, 3], camera_from_lidar[:3]
    lines: dict[str, Float]
    match layout:
        case "object":
            lines = {"R0_rect": np.eye(3), "Tr_velo_to_cam": both}
        case "raw":
            lines = {"R": rotation, "T": translation}
        case "odometry":
            lines = {"Tr": both}
    return "".join(f"{key}: {' '.join(f'{v:.16e}' for v in values.ravel())}\n" for key, values in lines.items())


METHOD = Method(
    name="kitti",
    build=build,
    options=KittiCalibOptions,
    summary="The extrinsic as text in the layout of KITTI's calibration files (Tr_velo_to_cam).",
    cite="Geiger et al., IJRR 2013",
)
