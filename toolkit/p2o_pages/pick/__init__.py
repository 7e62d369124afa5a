"""The page of `p2o pick`: pairs of pixels and LiDAR points that a person clicks (docs/how-to/pick-points.md)."""
