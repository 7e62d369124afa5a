"""Build a sparse map from the images of a drive, up to scale: camera poses and landmarks, from corners alone.

1. Corners are tracked from image to image, and new ones are detected in empty regions (`corner_tracks`).
2. Key frames are far enough apart for parallax. Essential matrices give the step of the camera from each to the next
   (`visual_odometry`); landmarks that two steps share give their relative scale.
3. Landmarks are triangulated from tracks; one bundle adjustment (pycolmap, with a robust loss) over all poses and
   landmarks follows, then another one without outliers.

COLMAP's own incremental mapping was rejected: on a synthetic street with traffic it lost track where the car turned
(one trial, no command). All constants are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import p2o
from p2o import Bool, Float, Int, UInt8
from p2o.solving import import_keeping_signals

from p2o_baselines.motion.visual_odometry import CameraStep, camera_step, follow

_APART_PX = 8.0
_PARALLAX_PX = 2.0  # median motion of corners from one key frame to the next
_SHARED = 12  # landmarks that two steps need in common for their scales to be compared
_LOSS_PX = 0.4
_OFF_PX = (6.0, 2.0)  # larger residuals are dropped before the first and before the second adjustment
_ANGLE_DEG = 0.7  # least angle between the rays of a landmark that determines its position
_USUAL_PX = 0.3


@dataclass(frozen=True, eq=False)
class Tracks:
    """Corners tracked through images: observation n is of `track` (N,) in image `image` (N,), along `ray` (N, 3)."""

    track: Int
    image: Int
    ray: Float

    def of(self, image: int) -> tuple[Int, Float]:
        """Return the tracks (M,), rising, and their rays (M, 3) in one image."""
        here = self.image == image
        return self.track[here], self.ray[here]

    def shared(self, first: int, second: int) -> tuple[Int, Float, Float]:
        """Return the tracks (M,) that two images share, and their rays (M, 3) in each."""
        (one, one_ray), (other, other_ray) = self.of(first), self.of(second)
        both, here, later = np.intersect1d(one, other, assume_unique=True, return_indices=True)
        return both, one_ray[here], other_ray[later]


@dataclass(frozen=True, eq=False)
class VisualMap:
    """Poses and landmarks in a world of unknown scale.

    `key_frames` (K,) are the numbers of images, `camera_from_world` (K, 4, 4) their poses. Landmark m is at `xyz` (M,
    3) with covariance (M, 3, 3); observation n is of `landmark` (N,) in key frame `moment` (N,). `off_px` is the root
    mean square residual.
    """

    key_frames: Int
    camera_from_world: Float
    xyz: Float
    covariance: Float
    landmark: Int
    moment: Int
    off_px: float

    def __len__(self) -> int:
        return len(self.xyz)

    def in_camera(self) -> tuple[Float, Float]:
        """Return the landmark of each observation in its camera frame (N, 3), and its covariance there (N, 3, 3)."""
        pose = self.camera_from_world[self.moment]
        turn = pose[:, :3, :3]
        here = np.einsum("nij,nj->ni", turn, self.xyz[self.landmark]) + pose[:, :3, 3]
        return here, turn @ self.covariance[self.landmark] @ np.swapaxes(turn, 1, 2)


def corner_tracks(
    images: Sequence[UInt8], camera: p2o.Camera, masked: Sequence[Bool | None], *, most: int = 1500
) -> Tracks:
    """Return the tracked corners of consecutive grey images (H, W), at most `most` in each."""
    import cv2

    uv, track, next_track = np.zeros((0, 2)), np.zeros(0, np.int64), 0
    tracks, numbers, places = [], [], []
    for number, (image, hidden) in enumerate(zip(images, masked, strict=True)):
        if number:
            tracked = follow(images[number - 1], image, uv)
            kept = np.isfinite(tracked).all(axis=1)
            uv, track = tracked[kept], track[kept]
        free = np.full(image.shape, 255, np.uint8) if hidden is None else np.where(hidden, 0, 255).astype(np.uint8)
        for u, v in np.rint(uv).astype(int).tolist():
            cv2.circle(free, (u, v), int(_APART_PX), 0, -1)
        if len(uv) < most:
            grey = np.ascontiguousarray(image)
            corners = cv2.goodFeaturesToTrack(grey, most - len(uv), 0.005, _APART_PX, mask=free)
            new = np.zeros((0, 2)) if corners is None else corners.reshape(-1, 2).astype(np.float64)
            uv = np.concatenate([uv, new])
            track = np.concatenate([track, next_track + np.arange(len(new))])
            next_track += len(new)
        tracks.append(track)
        numbers.append(np.full(len(track), number))
        places.append(uv)
    rays = camera.rays(np.concatenate(places))
    # On the plane at unit depth; points beside or behind the camera are omitted.
    ahead = np.isfinite(rays).all(axis=1) & (rays[:, 2] > 0.1)
    rays = rays[ahead] / rays[ahead, 2:]
    return Tracks(np.concatenate(tracks)[ahead], np.concatenate(numbers)[ahead], rays)


def visual_map(tracks: Tracks, focal_px: float) -> VisualMap | None:
    """Return the map of the first images with consecutive steps, `focal_px` the size of a radian, or None."""
    key_frames, steps = key_steps(tracks, focal_px)
    poses = chained(tracks, key_frames, steps) if len(steps) > 1 else []
    if len(poses) < 3:
        return None
    return adjusted(tracks, np.array(key_frames[: len(poses)]), np.array(poses), focal_px)


def key_steps(tracks: Tracks, focal_px: float) -> tuple[list[int], list[CameraStep]]:
    """Return the images of key frames and the camera's step from each to the next, up to the first unknown step."""
    key_frames: list[int] = [0]
    steps: list[CameraStep] = []
    for number in range(1, int(tracks.image.max(initial=0)) + 1):
        _, here, later = tracks.shared(key_frames[-1], number)
        step = camera_step(here, later, focal_px) if len(here) else None
        if step is None:
            break
        if step.parallax_px >= _PARALLAX_PX:
            key_frames.append(number)
            steps.append(step)
    return key_frames, steps


def chained(tracks: Tracks, key_frames: Sequence[int], steps: Sequence[CameraStep]) -> list[Float]:
    """Return camera_from_world (4, 4) of key frames with a first step of unit length, up to the first unknown scale."""
    poses = [np.eye(4), np.array(steps[0].second_from_first)]
    length = 1.0
    for number, (before, after) in enumerate(pairwise(steps), start=1):
        first, here, second = key_frames[number - 1 : number + 2]
        one, one_first, one_here = tracks.shared(first, here)
        other, other_here, other_second = tracks.shared(here, second)
        near = _depths(one_first, one_here, before.second_from_first)[1] * length
        far = _depths(other_here, other_second, after.second_from_first)[0]
        _, row, column = np.intersect1d(one, other, assume_unique=True, return_indices=True)
        ratio = near[row] / far[column]
        ratio = ratio[np.isfinite(ratio) & (ratio > 0)]
        if len(ratio) < _SHARED:
            break
        length = float(np.median(ratio))
        step = np.array(after.second_from_first)
        step[:3, 3] *= length
        poses.append(step @ poses[-1])
    return poses


def _depths(here: Float, later: Float, second_from_first: Float) -> tuple[Float, Float]:
    """Return the distances along z (N,) from both cameras of what two rays (N, 3), z = 1, see; NaN with no parallax."""
    turned, direction = here @ second_from_first[:3, :3].T, second_from_first[:3, 3]
    # depth * turned + direction is parallel to `later`
    left, right = np.cross(later, turned), -np.cross(later, np.broadcast_to(direction, later.shape))
    square = (left**2).sum(axis=1)
    depth = (left * right).sum(axis=1) / np.maximum(square, 1e-18)
    depth = np.where((square > 1e-7) & (depth > 0), depth, np.nan)
    return depth, depth * turned[:, 2] + direction[2]


def adjusted(tracks: Tracks, key_frames: Int, camera_from_world: Float, focal_px: float) -> VisualMap | None:
    """Return the map after bundle adjustment of approximate poses (K, 4, 4); None if it is empty."""
    place = np.full(int(tracks.image.max()) + 1, -1)
    place[key_frames] = np.arange(len(key_frames))
    used = place[tracks.image] >= 0
    moment, ray = place[tracks.image[used]], tracks.ray[used]
    _, landmark = np.unique(tracks.track[used], return_inverse=True)
    poses, xyz = np.array(camera_from_world), np.zeros((int(landmark.max(initial=-1)) + 1, 3))
    for off_px in _OFF_PX:
        kept = np.bincount(landmark, minlength=len(xyz)) > 1
        xyz = _meeting(poses, moment, ray, landmark, len(xyz))
        kept &= _widest_deg(poses, moment, xyz, landmark) > _ANGLE_DEG
        seen = kept[landmark]
        moment, ray, landmark = moment[seen], ray[seen], landmark[seen]
        near = np.linalg.norm(_off_px(poses, moment, ray, xyz[landmark], focal_px), axis=1) < off_px
        kept = np.bincount(landmark[near], minlength=len(xyz)) > 1
        near &= kept[landmark]
        moment, ray = moment[near], ray[near]
        numbers, landmark = np.unique(landmark[near], return_inverse=True)
        if len(numbers) < _SHARED or (np.bincount(moment, minlength=len(poses)) < 6).any():
            return None
        poses, xyz = _bundle(poses, moment, ray, xyz[numbers], landmark, focal_px)
    off = _off_px(poses, moment, ray, xyz[landmark], focal_px)
    near = np.linalg.norm(off, axis=1) < _OFF_PX[-1]
    near &= (np.bincount(landmark[near], minlength=len(xyz)) > 1)[landmark]
    moment, ray, off = moment[near], ray[near], off[near]
    numbers, landmark = np.unique(landmark[near], return_inverse=True)
    xyz = xyz[numbers]
    covariance = _covariances(poses, moment, landmark, xyz, focal_px)
    off_px = float(np.sqrt((off**2).sum(axis=1).mean())) if len(off) else 0.0
    return VisualMap(np.asarray(key_frames), poses, xyz, covariance, landmark, moment, off_px)


def _meeting(poses: Float, moment: Int, ray: Float, landmark: Int, count: int) -> Float:
    """Return the points (count, 3) nearest to all rays of each landmark; NaN for parallel rays."""
    back = p2o.se3.inverse(poses)[moment]
    direction = np.einsum("nij,nj->ni", back[:, :3, :3], ray / np.linalg.norm(ray, axis=1)[:, None])
    across = np.eye(3) - np.einsum("ni,nj->nij", direction, direction)
    normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(normal, landmark, across)
    np.add.at(right, landmark, np.einsum("nij,nj->ni", across, back[:, :3, 3]))
    flat = np.linalg.eigvalsh(normal)[:, 0] < 1e-7
    normal[flat] = np.eye(3)
    points = np.linalg.solve(normal, right[..., None])[..., 0]
    points[flat] = np.nan
    return np.asarray(points)


def _widest_deg(poses: Float, moment: Int, xyz: Float, landmark: Int) -> Float:
    """Return the largest angle in degrees between the first ray of each landmark and any other one."""
    centre = p2o.se3.inverse(poses)[moment, :3, 3]
    direction = xyz[landmark] - centre
    direction /= np.maximum(np.linalg.norm(direction, axis=1), 1e-12)[:, None]
    first = np.zeros((len(xyz), 3))
    first[landmark[::-1]] = direction[::-1]
    cosine = np.full(len(xyz), 1.0)
    np.minimum.at(cosine, landmark, np.nan_to_num((direction * first[landmark]).sum(axis=1), nan=1.0))
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _off_px(poses: Float, moment: Int, ray: Float, xyz: Float, focal_px: float) -> Float:
    """Return residuals (N, 2) px of points (N, 3) from their observed rays (N, 3); large behind the camera."""
    here = np.einsum("nij,nj->ni", poses[moment, :3, :3], xyz) + poses[moment, :3, 3]
    ahead = np.isfinite(here).all(axis=1) & (here[:, 2] > 1e-3)
    depth = np.where(ahead, here[:, 2], 1.0)
    return np.where(ahead[:, None], (here[:, :2] / depth[:, None] - ray[:, :2]) * focal_px, 1e6)


def _bundle(poses: Float, moment: Int, ray: Float, xyz: Float, landmark: Int, focal_px: float) -> tuple[Float, Float]:
    """Return poses (K, 4, 4) and landmarks (M, 3) with the least reprojection errors and a robust loss."""
    pycolmap = import_keeping_signals("pycolmap")
    scene = pycolmap.Reconstruction()
    # Rays are on a plane: whatever the lens, a pinhole does.
    model = {"model": "SIMPLE_PINHOLE", "width": 10_000, "height": 10_000, "params": [focal_px, 5000.0, 5000.0]}
    camera = pycolmap.Camera(camera_id=1, **model)
    scene.add_camera_with_trivial_rig(camera)
    uv = ray[:, :2] * focal_px + 5000.0
    row = np.zeros(len(moment), np.int64)
    for number, pose in enumerate(poses):
        here = np.flatnonzero(moment == number)
        row[here] = np.arange(len(here))
        image = pycolmap.Image(image_id=number + 1, name=str(number), camera_id=1, keypoints=uv[here])
        scene.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    order = np.argsort(landmark, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(landmark[order])) + 1)
    identities = []
    for point, sights in zip(xyz, parts, strict=True):
        track = pycolmap.Track()
        for sight in sights:
            track.add_element(int(moment[sight]) + 1, int(row[sight]))
        identities.append(scene.add_point3D(point, track))
    fixed = {"refine_focal_length": False, "refine_extra_params": False, "print_summary": False}
    options = pycolmap.BundleAdjustmentOptions(**fixed)
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = _LOSS_PX
    # More threads add up in another order each time.
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.max_num_iterations = 60
    options.ceres.solver_options.function_tolerance = 1e-7
    config = pycolmap.BundleAdjustmentConfig()
    for number in range(len(poses)):
        config.add_image(number + 1)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(options, config, scene).solve()
    poses_out = [np.vstack([scene.images[n + 1].cam_from_world().matrix(), [0, 0, 0, 1]]) for n in range(len(poses))]
    return np.array(poses_out), np.array([scene.points3D[identity].xyz for identity in identities])


def _covariances(poses: Float, moment: Int, landmark: Int, xyz: Float, focal_px: float) -> Float:
    """Return the covariance (M, 3, 3) of each landmark from typical residuals, with fixed poses."""
    turn = poses[moment, :3, :3]
    here = np.einsum("nij,nj->ni", turn, xyz[landmark]) + poses[moment, :3, 3]
    depth = np.maximum(here[:, 2], 1e-3)
    slope = np.zeros((len(here), 2, 3))
    slope[:, 0, 0] = slope[:, 1, 1] = 1.0 / depth
    slope[:, :, 2] = -here[:, :2] / depth[:, None] ** 2
    slope = slope @ turn * (focal_px / _USUAL_PX)
    normal = np.zeros((len(xyz), 3, 3))
    np.add.at(normal, landmark, np.swapaxes(slope, 1, 2) @ slope)
    return np.asarray(np.linalg.inv(normal + 1e-12 * np.eye(3)))
