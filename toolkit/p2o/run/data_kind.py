"""Infer the dataset of a path from the files in it."""

from __future__ import annotations

from pathlib import Path

from p2o.errors import InputError
from p2o.files.input_file import nearest, no_such_folder

_BAGS = (".bag", ".mcap", ".db3")
_SIGNS = {
    "folder": ("frame.yaml", "*/frame.yaml"),
    "ros": tuple(f"*{suffix}" for suffix in _BAGS),
    "kitti-raw": ("*_drive_*/velodyne_points", "*/*_drive_*/velodyne_points", "../*_drive_*/velodyne_points"),
    "kitti-odometry": ("sequences/*/velodyne", "[0-9][0-9]/velodyne", "../[0-9][0-9]/velodyne"),
    "kitti-object": ("training/velodyne", "calib/[0-9]*.txt"),
    "kitti-360": ("data_3d_raw",),
    "argoverse2": ("city_SE3_egovehicle.feather", "*/city_SE3_egovehicle.feather"),
    "nuscenes": ("v1.0-*/sample_data.json",),
    "once": ("lidar_roof", "*/lidar_roof", "data/*/lidar_roof"),
    "pandaset": ("lidar/poses.json", "*/lidar/poses.json"),
    "vkitti2": ("Scene[0-9]*/*/frames", "*/frames/rgb"),
    "waymo": ("lidar/*.parquet", "*/lidar/*.parquet", "*.tfrecord"),
}
"""Patterns of files and folders of which each dataset has at least one; those that begin with ../ match the path."""


def data_kind(path: Path) -> str:
    """Return the dataset of a file or folder; raises InputError if none or several are possible."""
    if not path.exists():
        expected = "DATASET:PATH, or an existing path"
        if path.suffix in _BAGS:
            raise InputError("no such file", where=path, expected=expected, hint=nearest(path))
        raise no_such_folder(path, expected)
    if path.is_file():
        kinds = ["ros"] if path.suffix in _BAGS else []
    else:
        try:
            kinds = [kind for kind, signs in _SIGNS.items() if any(_has(path, sign) for sign in signs)]
        except OSError as problem:
            raise InputError("cannot read the folder", where=path, got=problem.strerror or problem) from problem
    if len(kinds) != 1:
        text = (
            f"the path could be of several datasets: {', '.join(kinds)}" if kinds else "the dataset is not recognised"
        )
        hint = "name it: DATASET:PATH, such as " + (f"{kinds[0]}:{path}" if kinds else f"folder:{path}")
        raise InputError(text, where=path, hint=hint)
    return kinds[0]


def _has(path: Path, sign: str) -> bool:
    if sign.startswith("../"):
        # A single drive or sequence: its own name has to match.
        first, _, rest = sign[3:].partition("/")
        return path.resolve().match(first) and (path / rest).exists()
    return next(path.glob(sign), None) is not None
