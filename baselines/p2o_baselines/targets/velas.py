"""Align circles, then edges of the whole scene, `--calibrator velas`, after Velas, Spanel, Materna and Herout 2014.

One frame of a board with four round holes. Coarse: the known size and spacing of the circles give their centres in both
sensors, which are aligned. Fine: near that pose the correlation of the edge image with range discontinuities along the
rings of the whole sweep is maximised. Rings are needed.

Departures: the coarse pose of the original is a translation of sensors with the same orientation; here it is a full
pose (closed form of `velo2cam`) without an initial guess. Circles in the image are detected by ellipses and rims, not
by Hough's transform of circles, which needs a frontal board. Edge image and jumps are Levinson and Thrun's
(`inverse_distance`, `ring_discontinuity`), as in the original except for constants. Its grid around the coarse pose
(mean of all better poses) is replaced by a walk among the 3^6 neighbours with decreasing steps, within bounds. The
predicted error is the scatter of results over resampled jumps plus common errors. The correlations of several frames
are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import p2o
from p2o import Float, Result, Status, se3
from p2o.solving import Judged

from p2o_baselines import examples
from p2o_baselines.boards.adjustment import CAMERA_PX, RANGE_BIAS_M
from p2o_baselines.boards.board_method import REMEDY, BoardMethod, hole_sight_of, off_m
from p2o_baselines.edges.inverse_distance import OnMap, edge_strength, inverse_distance
from p2o_baselines.edges.ring_discontinuity import ring_jumps
from p2o_baselines.target_method import Sight, TargetOptions, accuracy_of, uncertainty
from p2o_baselines.targets.velo2cam import ALGORITHM

_ALPHA, _GAMMA = 1 / 3, 0.9
_STEPS = ((0.2, 0.02), (0.1, 0.01), (0.05, 0.005))  # deg and m; no end is surer than the middle ones
_WALK = 12
_NEIGHBOURS = np.array([step for step in product((-1.0, 0.0, 1.0), repeat=6) if any(step)])  # steps (728, 6)
_SAMPLES, _PARTS = 8, 24  # number of resamplings of the jumps, and of the blocks of neighbours that are resampled
_FINE_DEG = 1.5  # the fine search turns by no more than this about an axis
_FINE_M = 0.1  # the fine search moves by no more than this along an axis
_MIN_JUMP_M = 0.3  # smallest range jump along a ring
_MAX_POINTS = 800  # largest number of jumps per frame


@dataclass(frozen=True)
class Scene:
    """One frame: what it shows of boards, its camera, the map (H, W) of its edges, jumps (N, 3) m and weights (N,)."""

    sight: Sight
    camera: p2o.Camera
    edges: Float
    xyz: Float
    weight: Float


@dataclass(frozen=True)
class Velas:
    """The calibrator."""

    options: TargetOptions

    def prepare(self, frame: p2o.Frame) -> Scene:
        """Return boards, edges of the image and jumps of the sweep."""
        sight = hole_sight_of(frame, self.options)
        if not sight.in_image or not sight.in_sweep:
            return Scene(sight, frame.camera, np.zeros((1, 1)), np.zeros((0, 3)), np.zeros(0))
        edges = inverse_distance(edge_strength(frame.image.grey), _ALPHA, _GAMMA)
        rows, jump_m = ring_jumps(frame.cloud, _MIN_JUMP_M, 0.6)
        return Scene(sight, frame.camera, edges, frame.cloud.xyz[rows], np.sqrt(jump_m))

    def solve(self, prepared: Sequence[Scene], camera_from_lidar: Float) -> Result:
        """Return the pose by circles, moved to the most correlation of edges."""
        options, sights = self.options, [scene.sight for scene in prepared]
        coarse = BoardMethod(options, replace(ALGORITHM, rounds=1)).solve(sights, camera_from_lidar)
        if not coarse.status.solved or coarse.covariance is None:
            return coarse
        centre = coarse.camera_from_lidar
        parts = [on_map(scene, centre, _MAX_POINTS) for scene in prepared if len(scene.xyz)]
        pose = best_pose(parts, centre, centre, _STEPS)
        rng = np.random.default_rng(0)
        drawn = ([_resampled(part, rng) for part in parts] for _ in range(_SAMPLES))
        ends = [se3.log(best_pose(each, pose, centre, _STEPS[1:]) @ se3.inverse(pose)) for each in drawn]
        steps = np.array([np.radians(_STEPS[1][0])] * 3 + [_STEPS[1][1]] * 3)
        covariance = np.cov(np.array(ends).T) + np.diag(steps**2) + self._shared(prepared)
        doubt = uncertainty(covariance, pose, REMEDY)
        if doubt:
            return replace(coarse, camera_from_lidar=coarse.start, status=Status.NOT_OBSERVABLE, reason=doubt)
        moved = pose @ se3.inverse(centre)
        by = f"{se3.angle_deg(moved):.2f} deg and {100 * off_m(pose, centre):.1f} cm"
        costs = (_cost(parts, coarse.start), _cost(parts, pose))
        return replace(
            coarse,
            camera_from_lidar=pose,
            reason=f"edges move the pose of the circles by {by}",
            covariance=covariance,
            accuracy=accuracy_of(covariance, pose),
            judged=Judged("correlation of edges, with its sign turned", "levels", *costs),
        )

    def _shared(self, prepared: Sequence[Scene]) -> Float:
        """Return the covariance (6, 6) of errors that all edges share: of the camera's calibration."""
        focal = float(np.median([scene.camera.focal_px for scene in prepared]))
        turn = CAMERA_PX / focal
        return np.diag([turn, turn, turn, RANGE_BIAS_M, RANGE_BIAS_M, 3 * turn]) ** 2


def on_map(scene: Scene, camera_from_lidar: Float, most: int) -> OnMap:
    """Return the jumps that a pose (4, 4) brings near the image, on the map of its edges."""
    uv = scene.camera.project(se3.apply(camera_from_lidar, scene.xyz))
    near = np.flatnonzero(scene.camera.in_image(uv, 50.0))
    near = near[:: max(1, -(-len(near) // most))]
    return OnMap(scene.camera, scene.edges, scene.xyz[near], scene.weight[near], float(scene.edges.mean()))


def _resampled(part: OnMap, rng: np.random.Generator) -> OnMap:
    """Resample the jumps in blocks of neighbours, whose errors are correlated."""
    runs = np.array_split(np.arange(len(part.xyz)), _PARTS)
    chosen = np.concatenate([runs[k] for k in rng.integers(0, len(runs), len(runs))])
    return replace(part, xyz=part.xyz[chosen], weight=part.weight[chosen])


def _cost(parts: Sequence[OnMap], pose: Float) -> float:
    weight = sum(float(part.weight.sum()) for part in parts)
    return -sum(float(part.sums(pose[None])[0]) for part in parts) / max(weight, 1e-12)


def best_pose(parts: Sequence[OnMap], pose: Float, centre: Float, steps: Sequence[tuple[float, float]]) -> Float:
    """Return the pose of the most correlation that a walk with shrinking steps reaches, within bounds of `centre`."""
    most = np.repeat([np.radians(_FINE_DEG), _FINE_M], 3)
    for deg, metres in steps:
        around = _NEIGHBOURS * np.repeat([np.radians(deg), metres], 3)
        for _ in range(_WALK):
            # A turn about the camera that leaves the LiDAR where it is, and a shift.
            poses = np.concatenate([pose[None], _moved(pose, around)])
            inside = (np.abs(_apart(poses, centre)) <= most + 1e-9).all(axis=1)
            poses = poses[inside | (np.arange(len(poses)) == 0)]
            best = int(np.argmax(sum(part.sums(poses) for part in parts)))
            if best == 0:
                break
            pose = poses[best]
    return pose


def _moved(pose: Float, steps: Float) -> Float:
    turned = se3.exp(np.concatenate([steps[:, :3], np.zeros((len(steps), 3))], axis=1))
    out = np.broadcast_to(pose, (len(steps), 4, 4)).copy()
    out[:, :3, :3] = turned[:, :3, :3] @ pose[:3, :3]
    out[:, :3, 3] += steps[:, 3:]
    return out


def _apart(poses: Float, centre: Float) -> Float:
    """Return turns and shifts (B, 6) between poses (B, 4, 4) and another."""
    turns = se3.rotation_vector(poses[:, :3, :3] @ centre[:3, :3].T)
    return np.concatenate([turns, poses[:, :3, 3] - centre[:3, 3]], axis=1)


METHOD = p2o.Method(
    name="velas",
    build=Velas,
    options=TargetOptions,
    summary="One board with round holes: centres first, then edges of image and sweep in a small neighbourhood.",
    needs=frozenset({"targets", "rings"}),
    cite="Velas, Spanel, Materna and Herout, Calibration of RGB camera with Velodyne LiDAR, WSCG 2014",
    example=examples.hole_boards("1.2deg 0.1m"),
)
