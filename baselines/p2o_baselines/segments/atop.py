"""Align objects that both sensors detect, by two particle swarms: `--calibrator atop`, after Sun et al. 2022.

    p2o run --calibrator atop --set calibrator.boxes=FOLDER

Learned parts are left out: the network that predicts the overlap of the fields of view, the detectors, and the
attention that matches objects. Boxes are read from one file per frame (`BoxFile`) or written from the simulator
(`benchmarks/simulated_boxes.py` of commit `3c814d5`). A cuboid and a rectangle of the same class match at a
pose if each is the other's nearest.

1. Ground: the lower faces of cuboids are moved onto the ground plane (RANSAC) if it is within 0.5 m, because
   annotated and detected boxes float.
2. First swarm, over the whole range: the distance between the middles of the lower and upper edges of a projected
   cuboid and of its rectangle, in heights of the rectangle, truncated at one.
3. Second swarm, over 0.3 of the range: one minus the intersection over union of the bounding rectangle of
   the projected cuboid and the matched rectangle.

Costs are means over the cuboids that are in the image at the initial extrinsic, so that a pose cannot gain by losing
one.

The parameters of the swarms and both costs are ours; the code of the paper is not public.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import p2o
from p2o import Bool, Float, Result, Status, field
from p2o.reading import existing_folder, folder_name, parse_json, read_text, validated
from p2o.solving import Judged, pose_from_chart, swarmed
from pydantic import BaseModel, ConfigDict, Field

from p2o_baselines.outcome import decided, refused
from p2o_baselines.segments.cloud_segments import ground_of

Positive = Annotated[float, Field(gt=0)]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Rectangle(_Strict):
    """An object in the image."""

    kind: str
    uv: tuple[float, float, float, float]


class Cuboid(_Strict):
    """An object in the sweep."""

    kind: str
    centre: tuple[float, float, float]
    size: tuple[Positive, Positive, Positive]
    yaw_deg: float = 0.0

    @property
    def corners(self) -> Float:
        """The corners (8, 3) m, the four lower ones first."""
        x, y, z = (np.array(sign) * half for sign, half in zip(_SIGNS, np.array(self.size) / 2, strict=True))
        cos, sin = np.cos(np.radians(self.yaw_deg)), np.sin(np.radians(self.yaw_deg))
        return np.asarray(np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1) + np.array(self.centre))


_SIGNS = ((1, 1, -1, -1) * 2, (1, -1, 1, -1) * 2, (-1,) * 4 + (1,) * 4)


class BoxFile(_Strict):
    """The content of the file of a frame, with lengths in metres of the LiDAR frame.

        {"boxes": [{"kind": "car", "uv": [604.0, 170.5, 660.0, 220.0]}],
         "cuboids": [{"kind": "car", "centre": [21.3, 1.9, -0.9], "size": [4.2, 1.8, 1.5], "yaw_deg": 3.0}]}

    `uv` is left, top, right, bottom in px; `yaw_deg` turns the length from x towards y.
    """

    boxes: tuple[Rectangle, ...] = ()
    cuboids: tuple[Cuboid, ...] = ()


@dataclass(frozen=True, eq=False)
class Objects:
    """Boxes (N, 4) px and corners of cuboids (M, 8, 3) m; `same_kind` (M, N) is True for pairs of the same class."""

    boxes: Float
    corners: Float
    same_kind: Float

    @classmethod
    def of(cls, file: BoxFile) -> Objects:
        """Return the objects of a file."""
        same_kind = [[cuboid.kind == box.kind for box in file.boxes] for cuboid in file.cuboids]
        return cls(
            np.reshape([box.uv for box in file.boxes], (-1, 4)),
            np.reshape([cuboid.corners for cuboid in file.cuboids], (-1, 8, 3)),
            np.reshape(np.array(same_kind, np.float64), (len(file.cuboids), len(file.boxes))),
        )


def read_objects(folder: str, name: str) -> Objects | None:
    """Return the objects of the frame `name` from FOLDER/NAME.json; None without such a file.

    Characters that a file name cannot have are replaced by `_` (2011_09_26_0005_0000000010.json). Raises InputError for
    a missing folder and for an invalid file.
    """
    path = existing_folder(Path(folder), "boxes") / f"{folder_name(name)}.json"
    if not path.exists():
        return None
    values = parse_json(read_text(path, "file of boxes"), "file of boxes", path)
    if not isinstance(values, dict):
        expected = '{"boxes": [], "cuboids": []}'
        raise p2o.InputError("the file of boxes is not a JSON object", where=path, expected=expected)
    return Objects.of(validated(BoxFile, values, where=path))


_MARGIN_PX = 100.0  # cuboids whose middle is so far outside of the image at the start count too
_SECOND_SHARE = 0.3  # size of the second swarm's box as a share of the first's
_GROUND_M = 0.5  # cuboids that end so near to the ground are put onto it
_LEAST_OBJECTS = 3  # fewer matched objects, over all frames, are too few
_PARTICLES = 80  # particles of each swarm
_STEPS = 80  # steps of each swarm


class AtopOptions(p2o.Options):
    """Options of `atop`."""

    boxes: str = field("", help="Folder of the boxes of both sensors, NAME.json a frame.")
    range_deg: float = field(3.0, gt=0, le=180, help="Half width of the first swarm's box in each rotation.")
    range_m: float = field(0.2, gt=0, le=100, help="Half width of the first swarm's box in each shift.")
    seed: int = field(0, ge=0, help="Seed of the swarms, and of the ground planes that are tried.")


@dataclass(frozen=True, eq=False)
class Road:
    """The prepared part of a frame: name, camera, and the ground plane (4,) of its sweep, empty if unknown."""

    name: str
    camera: p2o.Camera
    ground: Float


@dataclass(frozen=True, eq=False)
class Sight:
    """One frame with its objects; costs are evaluated for the `corners` (M, 8, 3) of cuboids near the image."""

    camera: p2o.Camera
    boxes: Float
    corners: Float
    same_kind: Bool

    def apart(self, poses: Float) -> tuple[Float, Float]:
        """Return distances of cuboids from boxes (B, M, N) in heights and 1 - overlap, 1 for other kinds."""
        uv = self.camera.project(p2o.se3.apply(poses, self.corners.reshape(-1, 3)))
        uv = uv.reshape(len(poses), -1, 8, 2)
        low, high = uv.min(axis=2)[:, :, None], uv.max(axis=2)[:, :, None]
        size = np.array([self.camera.width - 1.0, self.camera.height - 1.0])
        # Rectangles end at the border of the image.
        low, high = np.clip(low, 0.0, size), np.clip(high, 0.0, size)
        first, last = self.boxes[:, :2], self.boxes[:, 2:]
        height = np.maximum(last[:, 1] - first[:, 1], 1.0)
        across = (low[..., 0] + high[..., 0] - first[:, 0] - last[:, 0]) / 2
        lower, upper = high[..., 1] - last[:, 1], low[..., 1] - first[:, 1]
        off = (np.hypot(across, lower) + np.hypot(across, upper)) / (2 * height)
        shared = np.prod(np.maximum(np.minimum(high, last) - np.maximum(low, first), 0.0), axis=-1)
        whole = np.prod(high - low, axis=-1) + np.prod(last - first, axis=-1) - shared
        overlap = shared / np.maximum(whole, 1e-9)
        known = self.same_kind & np.isfinite(off)
        return np.where(known, np.minimum(off, 1.0), 1.0), np.where(known, 1.0 - overlap, 1.0)

    def costs(self, poses: Float, *, overlap: bool) -> Float:
        """Return the cost (B, M) of each cuboid; 1 for one that is not its nearest rectangle's nearest."""
        off = self.apart(poses)[int(overlap)]
        least = off.min(axis=2)
        mutual = np.take_along_axis(off.min(axis=1), off.argmin(axis=2), axis=1) >= least
        return np.where(mutual, least, 1.0)


def grounded(corners: Float, ground: Float, within_m: float) -> Float:
    """Return corners (M, 8, 3) of cuboids with lower faces moved onto the ground plane (4,) if they are close to it."""
    if not len(ground) or not len(corners):
        return corners
    height = (corners[:, :4] @ ground[:3] + ground[3]).mean(axis=1)
    drop = np.where(np.abs(height) < within_m, height, 0.0)
    out = corners.copy()
    out[:, :4] -= drop[:, None, None] * ground[:3]
    return out


@dataclass(frozen=True)
class Atop:
    """The calibrator."""

    options: AtopOptions

    def prepare(self, frame: p2o.Frame) -> Road:
        """Return the ground under the sweep; boxes are read when the frames are solved."""
        xyz = frame.cloud.xyz[np.lexsort(frame.cloud.xyz.T)]
        ground = ground_of(xyz, np.random.default_rng(self.options.seed))
        return Road(frame.name, frame.camera, np.zeros(0) if ground is None else ground)

    def solve(self, prepared: Sequence[Road], camera_from_lidar: Float) -> Result:
        """Return the pose that aligns the boxes of both sensors."""
        options, start = self.options, np.asarray(camera_from_lidar, np.float64)
        blank = Result(tuple(road.name for road in prepared), start, start, Status.NO_FEATURES, "")
        if not options.boxes:
            return refused(blank, "no boxes are given: --set calibrator.boxes=FOLDER")
        objects = [(road, read_objects(options.boxes, road.name)) for road in prepared]
        sights = [each for road, boxes in objects if boxes is not None and (each := self._sight(road, boxes, start))]
        if not sights:
            return refused(blank, "no frame has objects of one kind in image and sweep")

        def cost(poses: Float, overlap: bool) -> Float:
            costs = np.concatenate([sight.costs(poses, overlap=overlap) for sight in sights], axis=1)
            return np.asarray(costs.mean(axis=1))

        rng, half = np.random.default_rng(options.seed), np.repeat([np.radians(options.range_deg), options.range_m], 3)
        pose = self._swarm(lambda poses: cost(poses, False), start, half, rng)
        pose = self._swarm(lambda poses: cost(poses, True), pose, half * _SECOND_SHARE, rng)
        matched = sum(int((sight.costs(pose[None], overlap=True) < 0.7).sum()) for sight in sights)
        before, after = (float(cost(each[None], True)[0]) for each in (start, pose))
        known = replace(blank, matches={"objects": matched}, judged=Judged("atop", "1 - overlap", before, after))
        if matched < _LEAST_OBJECTS:
            return refused(known, f"{matched} objects, {_LEAST_OBJECTS} are needed", Status.TOO_FEW_MATCHES)
        if not after < before:
            reason = "no pose has a higher overlap of boxes than the initial extrinsic"
            return refused(known, reason, Status.NO_IMPROVEMENT)
        reason = f"{matched} objects overlap by {1 - after:.2f} on average"
        return decided(known, camera_from_lidar=pose, status=Status.CONVERGED, reason=reason)

    @staticmethod
    def _swarm(cost: Callable[[Float], Float], start: Float, half: Float, rng: np.random.Generator) -> Float:
        def charted(places: Float) -> Float:
            return cost(pose_from_chart(start, places))

        best, _, _ = swarmed(charted, -half, half, rng, first=np.zeros(6), particles=_PARTICLES, moves=_STEPS)
        return pose_from_chart(start, best)

    def _sight(self, road: Road, objects: Objects, start: Float) -> Sight | None:
        corners = grounded(objects.corners, road.ground, _GROUND_M)
        middle = road.camera.project(p2o.se3.apply(start, corners.mean(axis=1)))
        near = road.camera.in_image(middle, _MARGIN_PX)
        near &= objects.same_kind.any(axis=1) if objects.same_kind.size else False
        if not near.any():
            return None
        return Sight(road.camera, objects.boxes, corners[near], objects.same_kind[near] > 0)


_BOXES = "the boxes of objects are files of the user, which the stage lacks"
METHOD = p2o.Method(
    name="atop",
    build=Atop,
    options=AtopOptions,
    summary="Aligns detected objects of both sensors by two particle swarms.",
    cite="Sun et al., ATOP: an attention-to-optimization approach for automatic LiDAR-camera calibration, T-IV 2022",
    expected_failures=(("calibrator_comes_near_the_truth", _BOXES),),
)
