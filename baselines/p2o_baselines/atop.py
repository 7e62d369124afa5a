"""Objects that both sensors box, laid upon each other by two particle swarms: `atop`, after Sun et al. 2022.

    p2o run --calibrator atop --set calibrator.boxes=FOLDER

What is left out, because it is learned: the network that predicts the overlap of both fields of view, the detectors,
and the matching of objects by attention. Boxes are given, a file a frame (`object_boxes`), or written from the
simulator (`python benchmarks/simulated_boxes.py`). A cuboid and a rectangle of one kind belong together at a pose
where each is the other's nearest.

1. Ground: lower faces of cuboids are put onto the plane of the ground (RANSAC), if that is within `ground_m`: boxes by
   eye and by detectors float.
2. First swarm, over the whole range: the middles of the lower and upper edges of a projected cuboid and of its
   rectangle, apart by how many heights of the rectangle, at most one.
3. Second swarm, over `second_share` of the range: one minus the overlap (intersection over union) of the rectangle
   around the projected cuboid with its own.
Costs are means over the cuboids that are in the picture at the start, so that no pose gains by losing one.

The figures of the swarms, and the two costs, are ours; the paper's code is not public.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Judged, Result, Status
from p2o.arrays import Bool, Float
from p2o.problems.chart import pose_at
from p2o.problems.swarm import swarmed

from p2o_baselines.ground import ground_of
from p2o_baselines.object_boxes import Objects, read_objects

_MARGIN_PX = 100.0  # cuboids whose middle is so far outside of the picture at the start count too


class AtopOptions(p2o.Options):
    """Options of `atop`."""

    boxes: str = p2o.field("", help="Folder of the boxes of both sensors, NAME.json a frame.")
    range_deg: float = p2o.field(3.0, gt=0, le=180, help="Half width of the first swarm's box in each rotation.")
    range_m: float = p2o.field(0.2, gt=0, le=100, help="Half width of the first swarm's box in each shift.")
    second_share: float = p2o.field(0.3, gt=0, le=1, help="Size of the second swarm's box as a share of the first's.")
    particles: int = p2o.field(80, ge=2, le=100_000, help="Particles of each swarm.")
    steps: int = p2o.field(80, ge=1, le=100_000, help="Steps of each swarm.")
    ground_m: float = p2o.field(0.5, ge=0, le=10, help="Cuboids that end so near to the ground are put onto it.")
    least_objects: int = p2o.field(3, ge=1, help="Fewer matched objects, over all frames, are too few.")
    seed: int = p2o.field(0, ge=0, help="Seed of the swarms, and of the ground planes that are tried.")


@dataclass(frozen=True, eq=False)
class Road:
    """What is prepared of a frame: its name, its camera, and the ground (4,) under its sweep, empty where unknown."""

    name: str
    camera: p2o.Camera
    ground: Float


@dataclass(frozen=True, eq=False)
class Sight:
    """One frame with its objects; costs are told for `corners` (M, 8, 3) of cuboids near the picture."""

    camera: p2o.Camera
    boxes: Float
    corners: Float
    alike: Bool

    def apart(self, poses: Float) -> tuple[Float, Float]:
        """Return for poses (B, 4, 4) how far cuboids are from boxes (B, M, N), in heights, and one minus their overlap.

        Both are 1 at most, and 1 for what is not of one kind.
        """
        uv = self.camera.project(p2o.se3.apply(poses, self.corners.reshape(-1, 3)))
        uv = uv.reshape(len(poses), -1, 8, 2)
        low, high = uv.min(axis=2)[:, :, None], uv.max(axis=2)[:, :, None]
        size = np.array([self.camera.width - 1.0, self.camera.height - 1.0])
        # Rectangles end at the border of the picture.
        low, high = np.clip(low, 0.0, size), np.clip(high, 0.0, size)
        first, last = self.boxes[:, :2], self.boxes[:, 2:]
        height = np.maximum(last[:, 1] - first[:, 1], 1.0)
        across = (low[..., 0] + high[..., 0] - first[:, 0] - last[:, 0]) / 2
        lower, upper = high[..., 1] - last[:, 1], low[..., 1] - first[:, 1]
        off = (np.hypot(across, lower) + np.hypot(across, upper)) / (2 * height)
        shared = np.prod(np.maximum(np.minimum(high, last) - np.maximum(low, first), 0.0), axis=-1)
        whole = np.prod(high - low, axis=-1) + np.prod(last - first, axis=-1) - shared
        overlap = shared / np.maximum(whole, 1e-9)
        known = self.alike & np.isfinite(off)
        return np.where(known, np.minimum(off, 1.0), 1.0), np.where(known, 1.0 - overlap, 1.0)

    def costs(self, poses: Float, *, overlap: bool) -> Float:
        """Return the cost (B, M) of each cuboid; 1 for one that is not its nearest rectangle's nearest."""
        off = self.apart(poses)[int(overlap)]
        least = off.min(axis=2)
        mutual = np.take_along_axis(off.min(axis=1), off.argmin(axis=2), axis=1) >= least
        return np.where(mutual, least, 1.0)


def grounded(corners: Float, ground: Float, within_m: float) -> Float:
    """Return corners (M, 8, 3) of cuboids whose lower faces lie on the ground (4,), where they are nearly there."""
    if not len(ground) or not len(corners):
        return corners
    height = (corners[:, :4] @ ground[:3] + ground[3]).mean(axis=1)
    drop = np.where(np.abs(height) < within_m, height, 0.0)
    out = corners.copy()
    out[:, :4] -= drop[:, None, None] * ground[:3]
    return out


@dataclass(frozen=True)
class Atop:
    """The whole method."""

    options: AtopOptions

    def prepare(self, frame: p2o.Frame) -> Road:
        """Return the ground under the sweep; boxes are read when the frames are solved."""
        xyz = frame.cloud.xyz[np.lexsort(frame.cloud.xyz.T)]
        ground = ground_of(xyz, np.random.default_rng(self.options.seed))
        return Road(frame.name, frame.camera, np.zeros(0) if ground is None else ground)

    def solve(self, prepared: Sequence[Road], camera_from_lidar: Float) -> Result:
        """Return the pose at which the boxes of both sensors lie upon each other."""
        options, start = self.options, np.asarray(camera_from_lidar, np.float64)
        blank = Result(tuple(road.name for road in prepared), start, start, Status.NO_FEATURES, "")
        if not options.boxes:
            return _refused(blank, Status.NO_FEATURES, "no boxes are given: --set calibrator.boxes=FOLDER")
        objects = [(road, read_objects(options.boxes, road.name)) for road in prepared]
        sights = [each for road, found in objects if found is not None and (each := self._sight(road, found, start))]
        if not sights:
            return _refused(blank, Status.NO_FEATURES, "no frame has objects of one kind in picture and sweep")

        def cost(poses: Float, overlap: bool) -> Float:
            return np.concatenate([sight.costs(poses, overlap=overlap) for sight in sights], axis=1).mean(axis=1)

        rng, half = np.random.default_rng(options.seed), np.repeat([np.radians(options.range_deg), options.range_m], 3)
        pose = self._swarm(lambda poses: cost(poses, False), start, half, rng)
        pose = self._swarm(lambda poses: cost(poses, True), pose, half * options.second_share, rng)
        matched = sum(int((sight.costs(pose[None], overlap=True) < 0.7).sum()) for sight in sights)
        before, after = (float(cost(each[None], True)[0]) for each in (start, pose))
        judged = Judged("atop", "1 - overlap", before, after)
        known = replace(blank, matches={"objects": matched}, judged=judged)
        if matched < options.least_objects:
            return _refused(known, Status.TOO_FEW_MATCHES, f"{matched} objects, {options.least_objects} are needed")
        if not after < before:
            return _refused(known, Status.NO_IMPROVEMENT, "no pose lays boxes better upon each other than the start")
        reason = f"{matched} objects overlap by {1 - after:.2f} on average"
        return Result(known.frames, start, pose, Status.CONVERGED, reason, matches=known.matches, judged=judged)

    def _swarm(self, cost: Callable[[Float], Float], start: Float, half: Float, rng: np.random.Generator) -> Float:
        options = self.options
        found, _, _ = swarmed(
            lambda places: cost(pose_at(start, places)),
            -half,
            half,
            rng,
            first=np.zeros(6),
            particles=options.particles,
            moves=options.steps,
        )
        return pose_at(start, found)

    def _sight(self, road: Road, objects: Objects, start: Float) -> Sight | None:
        corners = grounded(objects.corners, road.ground, self.options.ground_m)
        middle = road.camera.project(p2o.se3.apply(start, corners.mean(axis=1)))
        near = road.camera.in_image(middle, _MARGIN_PX)
        near &= objects.alike.any(axis=1) if objects.alike.size else False
        if not near.any():
            return None
        return Sight(road.camera, objects.boxes, corners[near], objects.alike[near] > 0)


def _refused(result: Result, status: Status, reason: str) -> Result:
    return Result(
        result.frames, result.start, result.start, status, reason, matches=result.matches, judged=result.judged
    )


_BOXES = "the boxes of objects are files of the user, and the stage has none"
METHOD = p2o.Method(
    name="atop",
    build=Atop,
    options=AtopOptions,
    summary="Objects that both sensors box are laid upon each other by two particle swarms.",
    cite="Sun et al., ATOP: an attention-to-optimization approach for automatic LiDAR-camera calibration, T-IV 2022",
    expected_failures=(("calibrator_comes_near_the_truth", _BOXES),),
)
