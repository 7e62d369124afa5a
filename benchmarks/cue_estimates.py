"""Estimates of a pose by cues that directed edges do not use, each with its covariance: for `cues.py`.

Every cue starts at a given pose and returns the step to its own optimum nearby, with the directions that it observes. A
step is a left update of camera_from_lidar in units of `UNIT`: 1 deg about and 10 cm along the axes of the camera.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any

import numpy as np
from p2o import Float, Frame, Int, Registry, View, se3
from p2o.confidence.audit import edge_step
from p2o.frames.scale import camera_at_scale, image_at_scale
from p2o.geometry.pose_error import place_by_update
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe
from p2o.solving import PointsOnRays
from p2o_baselines.edges.lsd import segments
from p2o_baselines.information.grey import METHOD as GREY
from p2o_baselines.information.histogram import MI, NID, Linear, Plain, Spline, ranked_levels
from p2o_baselines.information.information import SeenPoints, Sighting, SmoothInformation, Span, counts_of
from p2o_baselines.information.reflectance_view import facing, flattened
from p2o_baselines.learned.feature_networks import read_networks
from p2o_baselines.learned.matches import MatchesOptions, reflectances
from p2o_baselines.motion.hand_eye import HandEyeCalibration, HandEyeOptions

UNIT = np.array([np.radians(1.0)] * 3 + [0.1] * 3)
_MAX_SIGMA = 1.0
"""Directions with a larger standard deviation, in units of `UNIT`, are not observable."""
_LEAST_CURVATURE = 1e-3
"""Smallest curvature of an observable direction, relative to the largest one."""
_CELL_PX = 64.0
"""Errors of points in one cell of the image are not independent."""


@dataclass(frozen=True, eq=False)
class Cue:
    """The `step` (6,) from a given pose to the optimum of a cue, and the orthonormal `directions` (K, 6) it observes.

    `covariance` (K, K) is that of the step along the directions.
    """

    step: Float
    directions: Float
    covariance: Float

    @classmethod
    def of(cls, step: Float, covariance: Float, basis: Float) -> Cue | None:
        """Return the cue of a covariance (M, M) along an orthonormal basis (M, 6); None if nothing is observable."""
        values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
        sure = (values > 0) & (values < _MAX_SIGMA**2)
        if not sure.any() or not np.isfinite(step).all():
            return None
        return cls(step, vectors[:, sure].T @ basis, np.diag(values[sure]))

    @classmethod
    def by_scores(cls, step: Float, hessian: Float, scores: Float, extra: Float | float = 0.0) -> Cue | None:
        """Return the cue of a minimum with a Hessian (6, 6) and gradients (M, 6) of M independent parts of the cost.

        The covariance is that of an M-estimator, H^-1 (sum g g^T) H^-1; `extra` (6, 6) is added to sum g g^T.
        """
        values, vectors = np.linalg.eigh((hessian + hessian.T) / 2)
        sure = values > max(_LEAST_CURVATURE * float(values[-1]), 0.0)
        if len(scores) < 8 or not sure.any():
            return None
        basis = vectors[:, sure].T
        spread = basis @ (scores.T @ scores * (len(scores) / (len(scores) - 1)) + extra) @ basis.T
        return cls.of(step, spread / np.outer(values[sure], values[sure]), basis)

    def chi_square(self, covariance: Float, scale: float = 1.0) -> float:
        """Return the chi-square of the step, for a given pose of a covariance (6, 6) and errors `scale` times larger.

        Its degrees of freedom are the directions.
        """
        off = self.directions @ self.step
        return float(off @ np.linalg.solve(self._sum(covariance, scale), off))

    def fused(self, covariance: Float, scale: float = 1.0) -> Float:
        """Return the step (6,) from the given pose to the mean of both, weighted by their covariances."""
        off = self.directions @ self.step
        return np.asarray(covariance @ self.directions.T @ np.linalg.solve(self._sum(covariance, scale), off))

    def _sum(self, covariance: Float, scale: float) -> Float:
        return np.asarray(scale**2 * self.covariance + self.directions @ covariance @ self.directions.T)


def moved(pose: Float, step: Float) -> Float:
    """Return a pose (4, 4) after a step (6,)."""
    return np.asarray(se3.exp(step * UNIT) @ pose)


# ---- information of reflectance and grey

_DRAWS, _RADII = 96, (0.8, 0.4)
_FARTHEST = 2.0
_POINTS = 5000


def information(frames: Sequence[Frame], pose: Float, *, measure: str = "mi") -> Cue | None:
    """Return the optimum of the mutual information ("mi") or information distance ("nid") of each frame, averaged.

    The cost is rough: a parabola is fitted to random poses around the given one, and again, closer, around its minimum.
    """
    groups = tuple(group for frame in frames if (group := _seen_points(frame, pose, measure)) is not None)
    if not groups:
        return None
    cost = SmoothInformation(groups, (Plain(),) * len(groups), MI if measure == "mi" else NID)
    rng, step, hessian = np.random.default_rng(0), np.zeros(6), np.eye(6)
    for radius in _RADII:
        unit = rng.normal(size=(_DRAWS, 6))
        draws = radius * unit / np.linalg.norm(unit, axis=1, keepdims=True) * rng.uniform(0, 1, (_DRAWS, 1)) ** 0.3
        poses = np.array([moved(pose, step + draw) for draw in draws])
        fit = np.linalg.pinv(_parabola(draws))
        gradient, hessian = _derivatives(fit @ cost.cost(poses))
        values, vectors = np.linalg.eigh(hessian)
        sure = values > _LEAST_CURVATURE * max(float(values[-1]), 1e-12)
        newton = -vectors[:, sure] @ ((vectors[:, sure].T @ gradient) / values[sure])
        newton *= min(1.0, 2 * radius / max(float(np.linalg.norm(newton)), 1e-12))
        step = step + newton
        if np.linalg.norm(step) > _FARTHEST:
            return None
    parts = np.concatenate([_parts(group[0], poses, moved(pose, step)) for group in groups], axis=1) / len(groups)
    by_part = [_derivatives(column) for column in (fit @ parts).T]
    scores = np.array([gradient + curvature @ newton for gradient, curvature in by_part])
    return Cue.by_scores(step, hessian, scores - scores.mean(axis=0))


def _seen_points(frame: Frame, pose: Float, measure: str) -> tuple[SeenPoints] | None:
    if frame.cloud.intensity is None:
        return None
    far = np.linalg.norm(frame.cloud.xyz, axis=1) > 1.5
    grey = GREY.build(GREY.options())(image_at_scale(frame.image)).features[0]
    sighting = Sighting(camera_at_scale(frame.camera), grey, frame.cloud.xyz[far], frame.cloud.intensity[far])
    sighting = sighting.visible(pose, 2.0, 0.3).near_image(pose, _POINTS, 2.0)
    if len(sighting.xyz) < 500:
        return None
    if measure == "mi":
        levels, bins = Linear(grey.values * (31 / 255), 32), 32
        row = Span.of([sighting.value]).levels(sighting.value, bins)
    else:
        levels, bins = Spline(ranked_levels(grey.values, 16), 16), 16
        row = ranked_levels(sighting.value, bins)
    return (SeenPoints(sighting.camera, levels, sighting.xyz, row, bins),)


def _parts(seen: SeenPoints, poses: Float, best: Float) -> Float:
    """Return the parts (B, M) of minus the information at poses (B, 4, 4) that come from M cells of the image."""
    counts = counts_of((seen,), best[None])[0]
    shares = counts / counts.sum()
    alone = shares.sum(axis=1, keepdims=True) * shares.sum(axis=0, keepdims=True)
    table = np.where(counts > 0, np.log(np.maximum(shares, 1e-12) / np.maximum(alone, 1e-12)), 0.0)
    uv = np.nan_to_num(seen.camera.project(se3.apply(best, seen.xyz)), nan=-1.0)
    _, cell = np.unique(np.floor(uv / _CELL_PX), axis=0, return_inverse=True)
    out = np.zeros((len(poses), int(cell.max()) + 1))
    for number, pose in enumerate(poses):
        uv = seen.camera.project(se3.apply(pose, seen.xyz))
        weight, _ = seen.levels.presence(uv)
        uv = np.where(weight[:, None] > 0, uv, 2.0)
        value = sum(tap.weight * table[seen.row, tap.level] for tap in seen.levels.taps(uv)) * weight
        out[number] = -np.bincount(cell.ravel(), value, out.shape[1]) / counts.sum()
    return out


_UPPER = np.triu_indices(6)


def _parabola(draws: Float) -> Float:
    """Return the terms (B, 28) of a parabola at steps (B, 6)."""
    return np.column_stack([np.ones(len(draws)), draws, draws[:, _UPPER[0]] * draws[:, _UPPER[1]]])


def _derivatives(terms: Float) -> tuple[Float, Float]:
    """Return gradient (6,) and Hessian (6, 6) of a parabola (28,) at zero."""
    half = np.zeros((6, 6))
    half[_UPPER] = terms[7:]
    return terms[1:7], half + half.T


# ---- features of a reflectance image

_REACHES_PX = (40.0, 25.0, 15.0, 10.0, 6.0, 6.0, 6.0, 6.0)
_LEAST_MATCHES = 20


@cache
def _networks() -> Any:
    return read_networks("aliked", 1024, "cpu")


def matches(frames: Sequence[Frame], pose: Float) -> Cue | None:
    """Return the pose of keypoints of the image that are matched with those of a reflectance image.

    The reflectance image looks as the camera does at the given pose. Raises MethodUnavailable without weights.
    """
    options, parts = MatchesOptions(), []
    for frame in frames:
        image = flattened(frame.image, options.focal_px)
        if frame.cloud.intensity is None or image is None:
            continue
        view = reflectances(frame).seen(facing(pose[:3, :3], image))
        keypoints, others = _networks().detect(image.grey), _networks().detect(view.grey)
        uv, view_uv = _networks().match(keypoints, others)
        xyz = view.lift(view_uv)
        known = np.isfinite(xyz).all(axis=1)
        cell = np.floor(uv[known] / _CELL_PX) + [1000 * len(parts), 0]
        parts.append((xyz[known], image.rays(uv[known]), cell))
    if not parts:
        return None
    xyz, rays, cell = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return rays_cue(PointsOnRays(xyz, rays, np.full(len(xyz), options.focal_px)), cell, pose)


def rays_cue(problem: PointsOnRays, cell: Float, pose: Float) -> Cue | None:
    """Return the cue of points on rays, most of them right, by robust least squares; `cell` (N, 2) groups them."""
    step = np.zeros(6)
    if len(problem.xyz) < _LEAST_MATCHES:
        return None
    for reach in _REACHES_PX:
        residuals, jacobian = problem.residuals_with_jacobian(moved(pose, step))
        jacobian = jacobian * UNIT
        square = np.square(residuals.reshape(-1, 2)).sum(axis=1) / reach**2
        weight = np.repeat(1 / (1 + square) ** 2, 2)
        hessian = jacobian.T @ (jacobian * weight[:, None])
        step = step - np.linalg.solve(hessian + 1e-3 * np.eye(6), jacobian.T @ (residuals * weight))
        if not np.linalg.norm(step) < 2 * _FARTHEST:
            return None
    if (square < 1).sum() < _LEAST_MATCHES:
        return None
    _, number = np.unique(cell, axis=0, return_inverse=True)
    scores = np.zeros((int(number.max()) + 1, 6))
    np.add.at(scores, np.repeat(number.ravel(), 2), jacobian * (residuals * weight)[:, None])
    return Cue.by_scores(step, hessian, scores)


# ---- vertical directions

_UPRIGHT_DEG, _LEAST_LINES = 6.0, 8
_GROUND_M, _LEAST_GROUND = (3.0, 20.0), 200
_SLOPE = np.radians(0.3)
"""Deviation of the ground's normal from the vertical direction about each axis."""


def verticals(frames: Sequence[Frame], pose: Float) -> Cue | None:
    """Return the rotation by which vertical lines of the images run along the normal of the ground in the sweeps.

    The rotation about it is not observed.
    """
    hessian, scores, extra = np.zeros((3, 3)), [], np.zeros((3, 3))
    known = [(frame, up) for frame in frames if (up := _up(frame)) is not None]
    planes = [line_planes(frame) for frame, _ in known]
    turn = np.zeros(3)
    for last in (False,) * 6 + (True,):
        hessian, right, scores, extra = np.zeros((3, 3)), np.zeros(3), [], np.zeros((3, 3))
        for (_, up), (normal, sigma) in zip(known, planes, strict=True):
            rotation = se3.exp(np.concatenate([turn, np.zeros(3)]))[:3, :3] @ pose[:3, :3]
            seen = rotation @ up
            off = normal @ seen
            near = np.abs(off) < np.sin(np.radians(_UPRIGHT_DEG))
            rows, off, sigma_near = np.cross(seen, normal[near]), off[near], sigma[near]
            weight = 1 / sigma_near**2 / (1 + (off / (2 * sigma_near)) ** 2)
            its = rows.T @ (rows * weight[:, None])
            hessian, right = hessian + its, right - rows.T @ (weight * off)
            scores.append(rows * (weight * off)[:, None])
            extra += its @ its * _SLOPE**2
        if not scores or sum(map(len, scores)) < _LEAST_LINES:
            return None
        if not last:
            turn = turn + np.linalg.pinv(hessian, rcond=1e-3) @ right
    whole, spread, other = np.zeros((6, 6)), np.zeros((sum(map(len, scores)), 6)), np.zeros((6, 6))
    unit = UNIT[0]
    whole[:3, :3], spread[:, :3] = hessian * unit**2, np.concatenate(scores) * unit
    other[:3, :3] = extra * unit**2
    return Cue.by_scores(np.concatenate([turn, np.zeros(3)]) / UNIT, whole, spread, other)


@lru_cache(64)
def line_planes(frame: Frame) -> tuple[Float, Float]:
    """Return the normals (N, 3), in the camera frame, of planes through the segments of an image, and their deviation.

    The deviation (N,) is the angle in rad by which half a pixel at both ends turns a segment.
    """
    image = image_at_scale(frame.image)
    ends = segments(image, 25.0)
    rays = image.camera.rays(ends.reshape(-1, 2)).reshape(-1, 2, 3)
    normal = np.cross(rays[:, 0], rays[:, 1])
    length = np.linalg.norm(normal, axis=1)
    good = np.isfinite(length) & (length > 0)
    return normal[good] / length[good, None], np.hypot(0.7 / image.camera.focal_px / length[good], np.radians(0.2))


@lru_cache(64)
def _up(frame: Frame) -> Float | None:
    return ground_normal(frame.cloud.xyz)


def ground_normal(xyz: Float) -> Float | None:
    """Return the upward normal (3,) of the ground around a sweep (N, 3) whose z points roughly upwards.

    None if the lowest points within 20 m do not form a plane.
    """
    distance = np.linalg.norm(xyz[:, :2], axis=1)
    near = xyz[(distance > _GROUND_M[0]) & (distance < _GROUND_M[1])]
    if len(near) < _LEAST_GROUND:
        return None
    plane = np.array([0.0, 0.0, np.quantile(near[:, 2], 0.15)])
    for reach_m in (0.5, 0.3, 0.15, 0.1, 0.1, 0.1):
        terms = np.column_stack([near[:, :2], np.ones(len(near))])
        its = np.abs(terms @ plane - near[:, 2]) < reach_m
        if its.sum() < _LEAST_GROUND:
            return None
        plane = np.linalg.lstsq(terms[its], near[its, 2], rcond=None)[0]
    normal = np.array([-plane[0], -plane[1], 1.0])
    return np.asarray(normal / np.linalg.norm(normal))


# ---- other extractors


@cache
def pipeline_of(extractor: str, matcher: str) -> Pipeline:
    pipeline = Recipe.of(extractor=extractor, matcher=matcher).resolve(Registry.load()).calibrator()
    assert isinstance(pipeline, Pipeline)
    return pipeline


def other_image_edges(frames: Sequence[Frame], views: Sequence[View], pose: Float) -> Cue | None:
    """Return the pose of grey-level edges, which have no direction, and the LiDAR edges of views."""
    pipeline = pipeline_of("canny/rings", "nearest")
    images = [pipeline.image_extractor(image_at_scale(frame.image)) for frame in frames]
    return edges_cue([replace(v, image=i) for v, i in zip(views, images, strict=True)], pose, pipeline)


def other_cloud_edges(frames: Sequence[Frame], views: Sequence[View], pose: Float) -> Cue | None:
    """Return the pose of the image edges of views and LiDAR edges between returns that are nearest in angle."""
    pipeline = pipeline_of("p2ornet/range-view", "ogm")
    clouds = [pipeline.cloud_extractor(frame.cloud) for frame in frames]
    return edges_cue([replace(v, cloud=c) for v, c in zip(views, clouds, strict=True)], pose, pipeline)


def edges_cue(views: Sequence[View], pose: Float, pipeline: Pipeline) -> Cue | None:
    """Return the pose of edges with the predicted error of `p2o check`."""
    edges = edge_step(views, pose, pipeline.matcher, pipeline.options)
    if isinstance(edges, str):
        return None
    order = np.array([1, 2, 0, 3, 4, 5])  # of roll, pitch, yaw to rotations about x, y, z
    units = np.repeat([np.radians(1.0), 1.0], 3)
    by_update = np.linalg.inv(place_by_update(pose)) * units / UNIT[:, None]
    covariance = by_update @ edges.covariance[np.ix_(order, order)] @ by_update.T
    return Cue.of(se3.log(edges.pose @ se3.inverse(pose)) / UNIT, covariance, np.eye(6))


# ---- motion


def motion(frames: Sequence[Frame], pose: Float) -> tuple[Cue | None, float]:
    """Return the pose from the motion of both sensors on a drive, and the delay of the camera in s, NaN if unknown."""
    method = HandEyeCalibration(HandEyeOptions())
    result = method.solve([method.prepare(frame.without_truth()) for frame in frames], pose)
    delay = np.nan if result.time is None else result.time.offset_s
    if not result.status.solved or result.covariance is None:
        return None, delay
    step = se3.log(result.camera_from_lidar @ se3.inverse(pose)) / UNIT
    return Cue.of(step, result.covariance / np.outer(UNIT, UNIT), np.eye(6)), delay


Estimate = Callable[[Sequence[Frame], Sequence[View], Float], Cue | None]
"""The cue of frames, whose sweeps are compensated for motion where it is known, and of their views with edges."""
CUES: Mapping[str, Estimate] = {
    "mutual information": lambda frames, views, pose: information(frames, pose, measure="mi"),
    "information distance": lambda frames, views, pose: information(frames, pose, measure="nid"),
    "vertical directions": lambda frames, views, pose: verticals(frames, pose),
    "canny image edges": other_image_edges,
    "range-view LiDAR edges": other_cloud_edges,
    "matched features": lambda frames, views, pose: matches(frames, pose),
}


def compensated(frame: Frame, twist: Int | Float | None) -> Frame:
    """Return a frame with its sweep as if the LiDAR had not moved, for a twist (6,) of its own or an estimated one."""
    known = frame.twist if frame.twist is not None else twist
    if known is None:
        return frame
    return replace(frame, cloud=frame.cloud.untwisted(np.asarray(known)), sweep=None)
