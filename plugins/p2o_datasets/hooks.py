"""Register the data sets of this package."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl, methods_at


@hookimpl
def p2o_datasets() -> Iterator[Method]:
    """Offer the data sets."""
    kitti = ("kitti_360", "kitti_object", "kitti_odometry", "kitti_raw")
    others = ("example", "folder", "argoverse2", "nuscenes", "once", "pandaset", "waymo", "ros")
    return methods_at("p2o_datasets", (*kitti, *others))
