"""A sparse map from the pictures of a drive, up to scale: poses of the camera and landmarks, by corners alone.

1. Corners are followed from picture to picture, new ones begin where there are none (`corner_tracks`).
2. Moments far enough apart that corners move between them (parallax) are key moments. Essential matrices tell the
   camera's step from each to the next (`visual_odometry`); landmarks that two steps share tell their common scale.
3. Landmarks are where the rays of a track meet; one bundle adjustment (pycolmap, with a robust loss) over all poses and
   landmarks, then again without what is far off.

COLMAP's own incremental mapping was tried and left: on a simulated street with traffic it lost the way where the car
turned (looked at once, no command). All constants are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import p2o
from p2o.arrays import Bool, Float, Int, UInt8
from p2o.native import import_keeping_signals

from p2o_baselines.visual_odometry import CameraStep, camera_step, follow

_APART_PX = 8.0
_PARALLAX_PX = 2.0
"""Corners move by this much, in the median, from one key moment to the next."""
_SHARED = 12
"""Landmarks that two steps need in common for their scales to be compared."""
_LOSS_PX = 0.4
_OFF_PX = (6.0, 2.0)
"""Sights farther off than this are left out, before the first and before the second adjustment."""
_ANGLE_DEG = 0.7
"""Rays of a landmark that meet at less do not say where."""
_USUAL_PX = 0.3


@dataclass(frozen=True, eq=False)
class Tracks:
    """Corners followed through pictures: sight n is of `track` (N,) in picture `picture` (N,), along `ray` (N, 3)."""

    track: Int
    picture: Int
    ray: Float

    def of(self, picture: int) -> tuple[Int, Float]:
        """Return the tracks (M,), rising, and their rays (M, 3) in one picture."""
        here = self.picture == picture
        return self.track[here], self.ray[here]

    def shared(self, first: int, second: int) -> tuple[Int, Float, Float]:
        """Return the tracks (M,) that two pictures share, and their rays (M, 3) in each."""
        (one, one_ray), (other, other_ray) = self.of(first), self.of(second)
        both, here, there = np.intersect1d(one, other, assume_unique=True, return_indices=True)
        return both, one_ray[here], other_ray[there]


@dataclass(frozen=True, eq=False)
class VisualMap:
    """Poses and landmarks in a world of unknown scale.

    `pictures` (K,) are the numbers of the key moments, `camera_from_world` (K, 4, 4) their poses. Landmark m is at
    `xyz` (M, 3) with the covariance (M, 3, 3) that its sights leave; sight n is of `landmark` (N,) in key moment
    `moment` (N,). They are off by `off_px`, root mean square.
    """

    pictures: Int
    camera_from_world: Float
    xyz: Float
    covariance: Float
    landmark: Int
    moment: Int
    off_px: float

    def __len__(self) -> int:
        return len(self.xyz)

    def in_camera(self) -> tuple[Float, Float]:
        """Return the landmark of each sight in its camera frame (N, 3), and its covariance there (N, 3, 3)."""
        pose = self.camera_from_world[self.moment]
        turn = pose[:, :3, :3]
        here = np.einsum("nij,nj->ni", turn, self.xyz[self.landmark]) + pose[:, :3, 3]
        return here, turn @ self.covariance[self.landmark] @ np.swapaxes(turn, 1, 2)


def corner_tracks(
    pictures: Sequence[UInt8], camera: p2o.Camera, masked: Sequence[Bool | None], *, most: int = 1500
) -> Tracks:
    """Return the corners of grey pictures (H, W) that follow one another, at most so many in each."""
    import cv2

    uv, track, next_track = np.zeros((0, 2)), np.zeros(0, np.int64), 0
    tracks, numbers, places = [], [], []
    for number, (picture, hidden) in enumerate(zip(pictures, masked, strict=True)):
        if number:
            there = follow(pictures[number - 1], picture, uv)
            kept = np.isfinite(there).all(axis=1)
            uv, track = there[kept], track[kept]
        free = np.full(picture.shape, 255, np.uint8) if hidden is None else np.where(hidden, 0, 255).astype(np.uint8)
        for u, v in np.rint(uv).astype(int).tolist():
            cv2.circle(free, (u, v), int(_APART_PX), 0, -1)
        if len(uv) < most:
            found = cv2.goodFeaturesToTrack(np.ascontiguousarray(picture), most - len(uv), 0.005, _APART_PX, mask=free)
            new = np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)
            uv = np.concatenate([uv, new])
            track = np.concatenate([track, next_track + np.arange(len(new))])
            next_track += len(new)
        tracks.append(track)
        numbers.append(np.full(len(track), number))
        places.append(uv)
    rays = camera.rays(np.concatenate(places))
    # On the plane one unit ahead; what is beside or behind the camera is left out.
    ahead = np.isfinite(rays).all(axis=1) & (rays[:, 2] > 0.1)
    rays = rays[ahead] / rays[ahead, 2:]
    return Tracks(np.concatenate(tracks)[ahead], np.concatenate(numbers)[ahead], rays)


def visual_map(tracks: Tracks, focal_px: float) -> VisualMap | None:
    """Return the map of the first stretch of pictures in which steps follow one another; None where there is none.

    `focal_px` is the size of a radian in pixels.
    """
    pictures, steps = key_steps(tracks, focal_px)
    if len(steps) < 2:
        return None
    poses = chained(tracks, pictures, steps)
    if len(poses) < 3:
        return None
    return adjusted(tracks, np.array(pictures[: len(poses)]), np.array(poses), focal_px)


def key_steps(tracks: Tracks, focal_px: float) -> tuple[list[int], list[CameraStep]]:
    """Return the pictures of key moments and the camera's step from each to the next; they end where none is known."""
    last = int(tracks.picture.max(initial=0))
    pictures: list[int] = [0]
    steps: list[CameraStep] = []
    for number in range(1, last + 1):
        _, here, there = tracks.shared(pictures[-1], number)
        step = camera_step(here, there, focal_px) if len(here) else None
        if step is None:
            break
        if step.parallax_px >= _PARALLAX_PX:
            pictures.append(number)
            steps.append(step)
    return pictures, steps


def chained(tracks: Tracks, pictures: Sequence[int], steps: Sequence[CameraStep]) -> list[Float]:
    """Return camera_from_world (4, 4) of key moments, the first step one unit long; they end where scales are lost."""
    poses = [np.eye(4), np.array(steps[0].second_from_first)]
    length = 1.0
    for number, (before, after) in enumerate(pairwise(steps), start=1):
        first, here, second = pictures[number - 1 : number + 2]
        one, one_ray, one_there = tracks.shared(first, here)
        other, other_ray, other_there = tracks.shared(here, second)
        near = _depths(one_ray, one_there, before.second_from_first)[1] * length
        far = _depths(other_ray, other_there, after.second_from_first)[0]
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


def _depths(here: Float, there: Float, second_from_first: Float) -> tuple[Float, Float]:
    """Return the distances along z (N,) from both cameras of what two rays (N, 3), z = 1, see; NaN with no parallax."""
    turned, way = here @ second_from_first[:3, :3].T, second_from_first[:3, 3]
    # depth * turned + way lies along there
    left, right = np.cross(there, turned), -np.cross(there, np.broadcast_to(way, there.shape))
    square = (left**2).sum(axis=1)
    depth = (left * right).sum(axis=1) / np.maximum(square, 1e-18)
    depth = np.where((square > 1e-7) & (depth > 0), depth, np.nan)
    return depth, depth * turned[:, 2] + way[2]


def adjusted(tracks: Tracks, pictures: Int, camera_from_world: Float, focal_px: float) -> VisualMap | None:
    """Return the map that one bundle adjustment makes of poses (K, 4, 4) that are about right; None if it is empty."""
    place = np.full(int(tracks.picture.max()) + 1, -1)
    place[pictures] = np.arange(len(pictures))
    used = place[tracks.picture] >= 0
    moment, ray = place[tracks.picture[used]], tracks.ray[used]
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
    return VisualMap(
        np.asarray(pictures),
        poses,
        xyz,
        _covariances(poses, moment, landmark, xyz, focal_px),
        landmark,
        moment,
        float(np.sqrt((off**2).sum(axis=1).mean())) if len(off) else 0.0,
    )


def _meeting(poses: Float, moment: Int, ray: Float, landmark: Int, count: int) -> Float:
    """Return the points (count, 3) nearest to all rays of each landmark; NaN where rays are parallel."""
    back = p2o.se3.inverse(poses)[moment]
    way = np.einsum("nij,nj->ni", back[:, :3, :3], ray / np.linalg.norm(ray, axis=1)[:, None])
    across = np.eye(3) - np.einsum("ni,nj->nij", way, way)
    normal, right = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(normal, landmark, across)
    np.add.at(right, landmark, np.einsum("nij,nj->ni", across, back[:, :3, 3]))
    flat = np.linalg.eigvalsh(normal)[:, 0] < 1e-7
    normal[flat] = np.eye(3)
    found = np.linalg.solve(normal, right[..., None])[..., 0]
    found[flat] = np.nan
    return np.asarray(found)


def _widest_deg(poses: Float, moment: Int, xyz: Float, landmark: Int) -> Float:
    """Return the widest angle between the first ray of each landmark and any other one, degrees."""
    centre = p2o.se3.inverse(poses)[moment, :3, 3]
    way = xyz[landmark] - centre
    way /= np.maximum(np.linalg.norm(way, axis=1), 1e-12)[:, None]
    first = np.zeros((len(xyz), 3))
    first[landmark[::-1]] = way[::-1]
    cosine = np.full(len(xyz), 1.0)
    np.minimum.at(cosine, landmark, np.nan_to_num((way * first[landmark]).sum(axis=1), nan=1.0))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def _off_px(poses: Float, moment: Int, ray: Float, xyz: Float, focal_px: float) -> Float:
    """Return how far points (N, 3) lie from the rays (N, 3) on which they are seen, (N, 2) px; far where behind."""
    here = np.einsum("nij,nj->ni", poses[moment, :3, :3], xyz) + poses[moment, :3, 3]
    ahead = np.isfinite(here).all(axis=1) & (here[:, 2] > 1e-3)
    depth = np.where(ahead, here[:, 2], 1.0)
    return np.where(ahead[:, None], (here[:, :2] / depth[:, None] - ray[:, :2]) * focal_px, 1e6)


def _bundle(poses: Float, moment: Int, ray: Float, xyz: Float, landmark: Int, focal_px: float) -> tuple[Float, Float]:
    """Return poses (K, 4, 4) and landmarks (M, 3) with the least distances in the pictures, wrong ones damped."""
    pycolmap = import_keeping_signals("pycolmap")
    scene = pycolmap.Reconstruction()
    # Rays are on a plane: whatever the lens, a pinhole does.
    camera = pycolmap.Camera(
        camera_id=1, model="SIMPLE_PINHOLE", width=10_000, height=10_000, params=[focal_px, 5000.0, 5000.0]
    )
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
    options = pycolmap.BundleAdjustmentOptions(
        refine_focal_length=False, refine_extra_params=False, print_summary=False
    )
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
    found = [np.vstack([scene.images[n + 1].cam_from_world().matrix(), [0, 0, 0, 1]]) for n in range(len(poses))]
    return np.array(found), np.array([scene.points3D[identity].xyz for identity in identities])


def _covariances(poses: Float, moment: Int, landmark: Int, xyz: Float, focal_px: float) -> Float:
    """Return the covariance (M, 3, 3) that sights off by a usual error leave to each landmark, poses taken as known."""
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
