"""The pose of a camera from keypoints of its image that are matched with points of a sweep, most of them wrongly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from p2o import Float, Int, SolverStatus, se3
from p2o.solving import PointsOnRays, checked_solution, consensus

_LEAST_ANGLE = np.radians(2.0)
"""Smallest angle between two matches that determine a rotation."""
_PAIRS = 3000
_PAIRS_AT_ONCE = 100
_ROTATIONS, _DISTINCT = 2, np.radians(8.0)
"""Number of rotations that are tried, and the angle between them."""
_WIDEST = np.radians(12.0)
"""Largest angle that an offset of the camera explains: nearer points determine no rotation."""
_MAX_CONDITION = 1e6
_TRIALS, _STEPS = 200, 12
MIN_POINTS = 4


@dataclass(frozen=True, eq=False)
class Matches:
    """Keypoints of images matched with points: unit `rays` (N, 3) of the camera frame, `xyz` (N, 3) m of the LiDAR's.

    `cell` (N,) numbers the places of the images: one place may be matched several times, in several virtual views.
    """

    rays: Float
    xyz: Float
    cell: Int

    def __len__(self) -> int:
        return len(self.rays)


@dataclass(frozen=True, eq=False)
class MatchedPose:
    """A pose (4, 4) with the number of places that agree, their residual, and why they do not determine it, if so."""

    camera_from_lidar: Float
    agree: int
    off_px: float
    reason: str


def pose_of(matches: Matches, px_per_rad: float, reach_px: float, offset_m: float, seed: int) -> MatchedPose | None:
    """Return the pose on which most matches agree, None if there are too few.

    First the rotations on which many matches agree for a camera at most `offset_m` from the LiDAR; then for each of
    them, on the matches that agree with it, robust least squares and perspective-n-point by RANSAC.
    """
    best: MatchedPose | None = None
    rng, reach_rad = np.random.default_rng(seed), reach_px / px_per_rad
    for turn in rotations_of(matches, reach_rad, offset_m, seed):
        near = np.flatnonzero(_off_rad(matches, turn) < _reach(matches, reach_rad, offset_m))
        if len(near) < MIN_POINTS:
            continue
        problem = PointsOnRays(matches.xyz[near], matches.rays[near], np.full(len(near), px_per_rad))
        poses = [_narrowed(problem, se3.make(turn, np.zeros(3)), reach_px, offset_m)]
        if (candidate := consensus(problem, reach_px, rng, _TRIALS)) is not None:
            poses += [candidate.camera_from_lidar, *(rival for rival, _ in candidate.rivals)]
        for pose in poses:
            off_px = problem.off_px(pose)
            agree = off_px <= reach_px
            count = len(np.unique(matches.cell[near[agree]]))
            beside = float(np.linalg.norm(se3.inverse(pose)[:3, 3])) <= offset_m
            if beside and agree.sum() >= MIN_POINTS and (best is None or count > best.agree):
                error_px = float(np.sqrt(np.mean(np.square(off_px[agree]))))
                start, inliers = np.eye(4), problem.select(agree)
                solution = checked_solution(inliers, start, pose, 1, SolverStatus.CONVERGED, _MAX_CONDITION)
                best = MatchedPose(pose, count, error_px, solution.reason)
    return best


def _narrowed(problem: PointsOnRays, start: Float, reach_px: float, offset_m: float) -> Float:
    """Return the pose (4, 4) of robust least squares from a start (4, 4), whose reach decreases to `reach_px`.

    Weights are those of Geman and McClure; while the reach decreases, a prior of half of `offset_m` keeps the camera
    near the LiDAR. The last steps are least squares on the matches within reach.
    """
    widest = float(np.max(problem.px_per_rad)) * _WIDEST
    reaches = np.geomspace(max(widest, reach_px), reach_px, _STEPS)
    pose = start
    for number, reach in enumerate(np.concatenate([reaches, np.full(_STEPS, reach_px)])):
        residuals, jacobian = problem.residuals_with_jacobian(pose)
        off = np.linalg.norm(residuals.reshape(-1, 2), axis=1)
        weight = np.repeat(np.where(off < 2 * reach, 1 / (1 + (off / reach) ** 2) ** 2, 0.0), 2)
        if number >= _STEPS + _STEPS // 2:
            weight = np.repeat((off < reach).astype(np.float64), 2)
        hessian, gradient = jacobian.T @ (jacobian * weight[:, None]), jacobian.T @ (residuals * weight)
        if number < _STEPS:
            # The translation is as long as the offset, and a left update adds to it.
            prior = (reach / (0.5 * offset_m)) ** 2
            hessian[3:, 3:] += prior * np.eye(3)
            gradient[3:] += prior * pose[:3, 3]
        damping = 1e-9 * float(np.trace(hessian)) + 1e-6
        pose = se3.exp(np.linalg.solve(hessian + damping * np.eye(6), -gradient)) @ pose
    return pose


def rotations_of(matches: Matches, reach_rad: float, offset_m: float, seed: int) -> list[Float]:
    """Return rotations camera_from_lidar (3, 3) on which most matches agree, best first, from random pairs of matches.

    A match agrees within `reach_rad` and the angle of an offset of `offset_m` at its point.
    """
    rng, count = np.random.default_rng(seed), len(matches)
    if count < MIN_POINTS:
        return []
    reach, rays = _reach(matches, reach_rad, offset_m), matches.rays
    direction = matches.xyz / np.maximum(np.linalg.norm(matches.xyz, axis=1, keepdims=True), 1e-9)
    first, second = rng.integers(0, count, (2, 16 * _PAIRS))
    between = [np.arccos(np.clip((v[first] * v[second]).sum(axis=1), -1.0, 1.0)) for v in (rays, direction)]
    fits = (between[0] > _LEAST_ANGLE) & (np.abs(between[0] - between[1]) < reach[first] + reach[second])
    chosen = np.flatnonzero(fits)[:_PAIRS]
    if not len(chosen):
        return []
    here = _axes(rays[first[chosen]], rays[second[chosen]])
    turns = here @ np.swapaxes(_axes(direction[first[chosen]], direction[second[chosen]]), 1, 2)
    parts = (turns[i : i + _PAIRS_AT_ONCE] for i in range(0, len(turns), _PAIRS_AT_ONCE))
    scores = np.concatenate([_score(part, direction, rays, reach) for part in parts])
    best: list[Float] = []
    for row in np.argsort(-scores, kind="stable"):
        traces = [float((turns[row] * other).sum()) for other in best]
        if all(trace < 1 + 2 * np.cos(_DISTINCT) for trace in traces):
            best.append(turns[row])
        if len(best) == _ROTATIONS:
            break
    return best


def _reach(matches: Matches, reach_rad: float, offset_m: float) -> Float:
    """Return the angle (N,) within which each match agrees with a rotation."""
    distance = np.linalg.norm(matches.xyz, axis=1)
    return np.asarray(reach_rad + np.minimum(offset_m / np.maximum(distance, 1e-9), _WIDEST))


def _off_rad(matches: Matches, turn: Float) -> Float:
    """Return the angle (N,) between each ray and its point after a rotation."""
    direction = matches.xyz / np.maximum(np.linalg.norm(matches.xyz, axis=1, keepdims=True), 1e-9)
    return np.asarray(np.arccos(np.clip((direction @ turn.T * matches.rays).sum(axis=1), -1.0, 1.0)))


def _axes(first: Float, second: Float) -> Float:
    """Return rotations (N, 3, 3) whose columns are the bisector of unit vectors (N, 3), their normal and a third."""
    middle, normal = first + second, np.cross(first, second)
    middle /= np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-12)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.stack([middle, normal, np.cross(middle, normal)], axis=-1)


def _score(turns: Float, direction: Float, rays: Float, reach: Float) -> Float:
    """Return how well matches agree with rotations (B, 3, 3): the sum of 1 - (angle / reach)^2 within reach."""
    cosine = np.einsum("bij,nj,ni->bn", turns, direction, rays, optimize=True)
    square = 2 * (1 - np.clip(cosine, -1.0, 1.0)) / reach**2
    return np.asarray(np.maximum(1 - square, 0.0).sum(axis=1))
