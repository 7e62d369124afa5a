"""A matcher from docs/plugins.md alone: every LiDAR edge against the nearest image edge, as residuals in pixels."""

import numpy as np
import p2o
from p2o.solving import LeastSquares
from scipy.spatial import cKDTree

PLUGIN_API = 1


class Options(p2o.Options):
    huber_px: float = p2o.field(2.0, gt=0, le=100, help="Residual from which a pair counts linearly.")


class NearestEdges(LeastSquares):
    """Two residuals (u, v) for each LiDAR edge that has an image edge within the matching distance."""

    far = 200.0

    def __init__(self, views, camera_from_lidar, reach_px, huber_px):
        self.huber, self.parts, frame = huber_px, [], []
        for number, view in enumerate(views):
            uv = view.camera.project(p2o.se3.apply(camera_from_lidar, view.cloud_edges.xyz))
            rows = np.flatnonzero(view.camera.in_image(uv))
            if not len(view.image_edges.uv):
                rows = rows[:0]
            distance, index = cKDTree(view.image_edges.uv).query(uv[rows]) if len(rows) else (np.zeros(0), rows)
            near = distance <= reach_px
            self.parts.append((view.camera, view.cloud_edges.xyz[rows[near]], view.image_edges.uv[index[near]]))
            frame.append(np.full(2 * near.sum(), number))
        self.frame = np.concatenate(frame)
        self.weight = np.ones(len(self.frame))

    def residuals(self, camera_from_lidar):
        parts = []
        for camera, xyz, target in self.parts:
            off = camera.project(p2o.se3.apply(camera_from_lidar, xyz)) - target
            parts.append(off.reshape(*off.shape[:-2], -1))
        return np.concatenate(parts, axis=-1)


def build(options):
    def match(views, camera_from_lidar, reach_px):
        return NearestEdges(views, camera_from_lidar, reach_px, options.huber_px)

    return match


@p2o.hookimpl
def p2o_matchers():
    yield p2o.Method(
        name="nearest-edges",
        build=build,
        options=Options,
        summary="Nearest image edge of each LiDAR edge.",
        needs={"image-edges", "cloud-edges"},
        gives={"residuals"},
    )
