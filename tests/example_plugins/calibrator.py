"""A calibrator from docs/plugins.md alone: range jumps on steps of the grey level, by a downhill simplex."""

import numpy as np
import p2o
from p2o.solving import pose_from_chart
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.optimize import minimize


class Options(p2o.Options):
    gap_m: float = p2o.field(0.5, gt=0, le=50, help="Smallest range jump of a LiDAR edge, in metres.")


class Jumps:
    def __init__(self, options):
        self.options = options

    def prepare(self, frame):
        edge = np.hypot(*np.gradient(frame.image.grey.astype(float))) >= 10
        distance = distance_transform_edt(~edge) if edge.any() else np.zeros(edge.shape)
        xyz, ring, range_m = frame.cloud.xyz, frame.cloud.ring, np.linalg.norm(frame.cloud.xyz, axis=1)
        order = np.lexsort((np.arctan2(xyz[:, 1], xyz[:, 0]), ring))
        gap = np.where(np.diff(ring[order]) == 0, np.diff(range_m[order]), 0.0)
        near = np.union1d(order[:-1][gap > self.options.gap_m], order[1:][gap < -self.options.gap_m])
        return {"name": frame.name, "camera": frame.camera, "distance": distance, "xyz": xyz[near]}

    def solve(self, prepared, camera_from_lidar):
        start, names = np.asarray(camera_from_lidar), tuple(frame["name"] for frame in prepared)
        unit, reach_px = np.repeat([np.radians(1.0), 0.1], 3), 20.0
        parts = [(f["camera"], f["distance"], visible(f["camera"], f["xyz"], start)) for f in prepared]
        parts = [part for part in parts if len(part[2]) and part[1].any()]
        if not parts:
            return p2o.Result(names, start, start, p2o.Status.NO_FEATURES, "no frame has edges of both sensors")

        def cost(x, reach):
            return float(np.mean([mean_distance(*part, pose_from_chart(start, x * unit), reach) for part in parts]))

        x = np.zeros(6)
        for reach in (reach_px, reach_px / 2, reach_px / 4, reach_px / 8):
            simplex = x + np.vstack([np.zeros(6), reach / reach_px * np.eye(6)])
            x = minimize(cost, x, (reach,), "Nelder-Mead", options={"initial_simplex": simplex, "maxiter": 600}).x
        reason = f"mean distance of edges {cost(np.zeros(6), reach_px):.2f} px before, {cost(x, reach_px):.2f} px after"
        if cost(x, reach_px) >= cost(np.zeros(6), reach_px):
            return p2o.Result(names, start, start, p2o.Status.NO_IMPROVEMENT, reason)
        return p2o.Result(names, start, pose_from_chart(start, x * unit), p2o.Status.CONVERGED, reason)


def visible(camera, xyz, pose):
    return xyz[camera.in_image(camera.project(p2o.se3.apply(pose, xyz)))]


def mean_distance(camera, distance_px, xyz, pose, reach):
    uv = camera.project(p2o.se3.apply(pose, xyz))
    inside = np.where(camera.in_image(uv)[:, None], uv, -9.0)
    return np.minimum(map_coordinates(distance_px, inside.T[::-1], order=1, cval=reach), reach).mean()


@p2o.hookimpl
def p2o_calibrators():
    yield p2o.Method(name="jumps", build=Jumps, options=Options, summary="Jumps on grey steps.", needs={"rings"})
