"""Register the data sets of this package."""

from __future__ import annotations

import importlib
from collections.abc import Iterator

from p2o import Method, hookimpl

# Modules are imported inside the hook, so that `p2o --help` loads none of them.


@hookimpl
def p2o_datasets() -> Iterator[Method]:
    """Yield the data sets."""
    kitti = ("kitti_360", "kitti_object", "kitti_odometry", "kitti_raw")
    for name in ("folder", *kitti, "argoverse2", "nuscenes", "once", "pandaset", "waymo", "ros"):
        yield importlib.import_module(f"p2o_datasets.{name}").METHOD
