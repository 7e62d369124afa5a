"""Points and the viewing rays that they lie on: the pose of a camera from picked points, with and without wrong ones.

Errors are angles between rays (Scaramuzza, Harati, Siegwart, IROS 2007), told in pixels by the scale of the image at
each pick: so a fisheye is as good as a pinhole, and no projection is needed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np

from p2o.arrays import Bool, Float, Int, checked
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.pose_error import SAME_POSE_DEG, SAME_POSE_M
from p2o.problems.problem import LeastSquares

MIN_POINTS = 4
"""Minimum number of points: three points have up to four solutions, the fourth selects one."""
_STEPS, _SMALLEST_STEP, _LEAST_GAIN = 100, 1e-12, 1e-14
_BEST = 8
_CHUNK = 1 << 18  # points at poses that are looked at together: some 20 MB


@dataclass(frozen=True, eq=False)
class PointsOnRays(LeastSquares):
    """Points `xyz` (N, 3) m in the LiDAR frame, each seen along one of the unit `rays` (N, 3) of the camera frame.

    Residuals 2 i and 2 i + 1 are the sine of the angle between ray i and the direction to point i, along two axes
    across the ray, times `px_per_rad` (N,): pixels, for small angles. `huber` is where they begin to count linearly.
    Raises InputError for arrays that do not fit, and rays that are not unit vectors (NaN: nothing is seen there).
    """

    xyz: Float
    rays: Float
    px_per_rad: Float
    huber: float = 1e6
    frame: Int = None  # type: ignore[assignment]  # filled in below

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz", checked("xyz", self.xyz, (None, 3), np.float64))
        object.__setattr__(self, "rays", checked("rays", self.rays, (len(self.xyz), 3), np.float64))
        object.__setattr__(self, "px_per_rad", checked("px_per_rad", self.px_per_rad, (len(self.xyz),), np.float64))
        if np.abs(np.linalg.norm(self.rays, axis=1) - 1).max(initial=0.0) > 1e-6:
            raise InputError("rays are not unit vectors", expected="length 1")
        number = np.zeros(len(self.xyz), np.int64) if self.frame is None else self.frame
        object.__setattr__(self, "frame", np.repeat(checked("frame", number, (len(self.xyz),), np.int64), 2))
        # Two axes across each ray: of the three unit vectors the one most across it is never along it.
        least = np.eye(3)[np.argmin(np.abs(self.rays), axis=1)]
        first = np.cross(self.rays, least)
        first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-12)
        across = np.stack([first, np.cross(self.rays, first)], axis=1)
        object.__setattr__(self, "_across", across)

    _across: Float = None  # type: ignore[assignment]  # (N, 2, 3)

    @property
    def weight(self) -> Float:  # type: ignore[override]
        """One for each residual."""
        return np.ones(2 * len(self.xyz))

    def select(self, keep: Int | Bool) -> PointsOnRays:
        """Return some of the points; all are of view 0 then."""
        return PointsOnRays(self.xyz[keep], self.rays[keep], self.px_per_rad[keep], self.huber)

    def residuals(self, camera_from_lidar: Float) -> Float:
        """Return residuals (2 N,) for one pose or (B, 2 N); where a point is behind its ray, as for a right angle."""
        seen = se3.apply(camera_from_lidar, self.xyz)
        direction = seen / np.maximum(np.linalg.norm(seen, axis=-1, keepdims=True), 1e-12)
        sines = np.einsum("nij,...nj->...ni", self._across, direction)
        behind = np.einsum("nj,...nj->...n", self.rays, direction) <= 0
        if behind.any():
            size = np.linalg.norm(sines, axis=-1, keepdims=True)
            away = np.where(size > 1e-9, sines / np.maximum(size, 1e-12), [1.0, 0.0])
            sines = np.where(behind[..., None], away, sines)
        scaled = sines * self.px_per_rad[:, None]
        return np.asarray(scaled.reshape(*scaled.shape[:-2], -1))

    def residuals_with_jacobian(self, camera_from_lidar: Float) -> tuple[Float, Float]:
        """Return residuals (2 N,) and their derivatives (2 N, 6), as `LeastSquares`."""
        seen = se3.apply(camera_from_lidar, self.xyz)
        length = np.maximum(np.linalg.norm(seen, axis=1), 1e-12)[:, None, None]
        direction = seen[:, :, None] / length
        turning = (np.eye(3) - direction @ direction.transpose(0, 2, 1)) / length
        by_update = np.concatenate([-se3.skew(seen), np.broadcast_to(np.eye(3), (len(seen), 3, 3))], axis=2)
        jacobian = self.px_per_rad[:, None, None] * (self._across @ turning @ by_update)
        return self.residuals(camera_from_lidar), jacobian.reshape(-1, 6)

    def depth_m(self, camera_from_lidar: Float) -> float:
        """Return the mean distance of the points from the camera."""
        return float(np.linalg.norm(se3.apply(camera_from_lidar, self.xyz), axis=1).mean()) if len(self.xyz) else 30.0

    def off_px(self, camera_from_lidar: Float) -> Float:
        """Return the distance in px of each point (..., N) from its ray, for poses (..., 4, 4)."""
        residuals = self.residuals(camera_from_lidar)
        return np.asarray(np.linalg.norm(residuals.reshape(*residuals.shape[:-1], -1, 2), axis=-1))


def px_per_rad(camera: Camera, uv: Float) -> Float:
    """Return the pixels per radian at pixels (N, 2), the geometric mean over all directions.

    Where the camera model does not reach half a pixel further it is the focal length.
    """
    uv = np.asarray(uv, dtype=np.float64)
    right, down = (camera.rays(uv + step) - camera.rays(uv - step) for step in ([0.5, 0.0], [0.0, 0.5]))
    area = np.linalg.norm(np.cross(right, down), axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1 / np.sqrt(area)
    return np.where(np.isfinite(scale), scale, camera.focal_px)


@dataclass(frozen=True, eq=False)
class Consensus:
    """A pose (4, 4) that many points agree on: `agree` (N,) are within reach, `cost` is the sum of squares in px^2.

    Points out of reach are charged with the reach. `rivals` are other places at which costs are low, best first, each
    with its cost.
    """

    camera_from_lidar: Float
    agree: Bool
    cost: float
    rivals: tuple[tuple[Float, float], ...] = ()


def consensus(problem: PointsOnRays, reach_px: float, rng: np.random.Generator, trials: int = 500) -> Consensus | None:
    """Return the pose that most points agree on within `reach_px`, refined, or None where three points give no pose.

    RANSAC: poses of three points (all triples if there are at most `trials`, else `trials` random ones) are ranked
    by truncated squares (MSAC), the best places refined on the points that agree.
    """
    poses = [pose for rows in _triples(len(problem.xyz), trials, rng) for pose in _three_point_poses(problem, rows)]
    if not poses:
        return None
    every = np.stack(poses)
    size = max(1, _CHUNK // max(len(problem.xyz), 1))
    costs = [_truncated(problem.off_px(every[i : i + size]), reach_px) for i in range(0, len(every), size)]
    left = np.argsort(np.concatenate(costs), kind="stable")
    refined_poses: list[tuple[Float, Bool, float]] = []
    while len(left) and len(refined_poses) < _BEST:
        pose, agree = _agreed(problem, every[left[0]], reach_px)
        refined_poses.append((pose, agree, float(_truncated(problem.off_px(pose), reach_px))))
        left = left[~_same_place(every[left], every[left[0]])]
    best = min(refined_poses, key=lambda each: each[2])
    others = sorted((each for each in refined_poses if not _same_place(each[0], best[0])), key=lambda each: each[2])
    return Consensus(*best, tuple((pose, cost) for pose, _, cost in others))


def refined(problem: PointsOnRays, camera_from_lidar: Float) -> Float:
    """Return the pose (4, 4) of least squares near a start (4, 4): Levenberg-Marquardt on all residuals."""
    pose, damping = np.asarray(camera_from_lidar, dtype=np.float64), 1e-6
    residuals, jacobian = problem.residuals_with_jacobian(pose)
    cost = float(residuals @ residuals)
    for _ in range(_STEPS):
        hessian = jacobian.T @ jacobian
        scale = np.maximum(np.diag(hessian), 1e-9 * max(float(np.trace(hessian)), 1e-300))
        step = np.linalg.solve(hessian + damping * np.diag(scale), -jacobian.T @ residuals).astype(np.float64)
        trial = se3.exp(step) @ pose
        after = problem.residuals(trial)
        won = cost - float(after @ after)
        if won >= 0:
            pose, damping = trial, max(damping / 10, 1e-12)
            residuals, jacobian = problem.residuals_with_jacobian(pose)
            cost = float(residuals @ residuals)
        else:
            damping *= 10
        if float(np.abs(step).max()) < _SMALLEST_STEP or 0 <= won < _LEAST_GAIN * cost or damping > 1e12:
            break
    return pose


def leave_one_out(problem: PointsOnRays, camera_from_lidar: Float) -> Float:
    """Return the poses (N, 4, 4) that the other points give when each is left out, near camera_from_lidar (4, 4)."""
    every = np.arange(len(problem.xyz))
    return np.stack([refined(problem.select(every != i), camera_from_lidar) for i in every])


def spread(poses: Float, camera_from_lidar: Float) -> Float:
    """Return the covariance (6, 6) of a left update in rad and m from poses (N, 4, 4) that each miss one of N points.

    The jackknife (Efron and Stein, The jackknife estimate of variance, 1981): (N - 1) / N times the sum of squares.
    """
    inverse = se3.inverse(camera_from_lidar)
    steps = np.stack([se3.log(pose @ inverse) for pose in poses])
    steps -= steps.mean(axis=0)
    return np.asarray((len(poses) - 1) / len(poses) * steps.T @ steps)


def shape(xyz: Float) -> Float:
    """Return the root mean square sizes (3,) m of points (N, 3) along their main axes, largest first.

    A second one near zero means that they lie on a line, a third one that they lie in a plane.
    """
    sizes: Float = np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False) / np.sqrt(max(len(xyz), 1))
    return np.concatenate([sizes, np.zeros(3 - len(sizes))])


def _triples(count: int, trials: int, rng: np.random.Generator) -> Iterator[Sequence[int]]:
    if comb(count, 3) <= trials:
        yield from combinations(range(count), 3)
        return
    for _ in range(trials):
        yield rng.choice(count, 3, replace=False).tolist()


def _three_point_poses(problem: PointsOnRays, rows: Sequence[int]) -> list[Float]:
    """Return up to four poses (4, 4) at which three points lie on their rays (Ke and Roumeliotis, CVPR 2017)."""
    import cv2

    rows = list(rows)
    rays, xyz = problem.rays[rows], problem.xyz[rows]
    if (rays[:, 2] < 1e-6).any():
        return []
    middle = xyz.mean(axis=0)  # digits are kept near zero
    try:
        image = rays[:, :2] / rays[:, 2:]
        _, turns, shifts = cv2.solveP3P(xyz - middle, image, np.eye(3), None, flags=cv2.SOLVEPNP_AP3P)
    except cv2.error:
        return []
    poses = []
    for turn, shift in zip(turns, shifts, strict=True):
        if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
            continue
        rotation = cv2.Rodrigues(turn)[0]
        poses.append(se3.make(rotation, np.ravel(shift) - rotation @ middle))
    return poses


def _agreed(problem: PointsOnRays, pose: Float, reach_px: float) -> tuple[Float, Bool]:
    """Refine a pose on its inliers, selected again until they do not change; return the pose and the inlier mask."""
    agree = problem.off_px(pose) <= reach_px
    for _ in range(20):
        if agree.sum() < 3:
            break
        pose = refined(problem.select(agree), pose)
        now = problem.off_px(pose) <= reach_px
        if (now == agree).all():
            break
        agree = now
    return pose, agree


def _truncated(off_px: Float, reach_px: float) -> Float:
    return np.asarray((np.minimum(off_px, reach_px) ** 2).sum(axis=-1))


def _same_place(poses: Float, other: Float) -> Bool:
    """Return which poses (..., 4, 4) are nearly another (4, 4)."""
    cosine = (np.einsum("...ij,ij->...", poses[..., :3, :3], other[:3, :3]) - 1) / 2
    near = np.linalg.norm(poses[..., :3, 3] - other[:3, 3], axis=-1) <= SAME_POSE_M
    return np.asarray(near & (cosine >= np.cos(np.radians(SAME_POSE_DEG))))
