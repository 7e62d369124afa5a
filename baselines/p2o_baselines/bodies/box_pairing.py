"""Which box of a sweep is which of its image, and how it is turned: the choice that one pose explains best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Box, Float, se3

from p2o_baselines.boards.pairing import best_explained, from_points, is_close
from p2o_baselines.bodies.box_in_picture import BoxInPicture, boxes_in_picture
from p2o_baselines.bodies.box_in_sweep import BoxInSweep, boxes_in_sweep, symmetries
from p2o_baselines.target_method import Sight, TargetOptions, missing_targets, once_per_sweep, pairing_warnings

_LEVER_M = 3.0  # maximum distance between the sensors
_WIDE, _NARROW = (0.5, 15.0), (0.25, 8.0)
"""Middle (m) and turn (deg) of a box of a sweep are within this of the image's: before and after refinement."""
_MIDDLE_M, _TURN_DEG = 0.03, 1.5
_FIT_MARGIN = 4.0  # poses whose misfits differ by less, in squares of deviations a box, fit about as well
_APART_DEG = 5.0


@dataclass(frozen=True)
class BoxPair:
    """A box of an image with that of the sweep, whose own frame is rotated by `turn` (4, 4) to that of the image."""

    frame: int
    image: BoxInPicture
    sweep: BoxInSweep
    turn: Float

    @property
    def lidar_from_box(self) -> Float:
        """The pose (4, 4) of the box in the LiDAR frame, numbered as the image's."""
        return np.asarray(self.sweep.lidar_from_box @ self.turn)


@dataclass(frozen=True)
class BoxPairing:
    """The pairs that a pose (4, 4) explains, and the number of other poses that explain equally many pairs as well."""

    pairs: tuple[BoxPair, ...]
    camera_from_lidar: Float
    others: int


def box_sight_of(frame: p2o.Frame, options: TargetOptions) -> Sight:
    """Detect the boxes of a frame; the sweep is searched only if the image shows one."""
    targets = list(dict.fromkeys(target for target in frame.targets if isinstance(target, Box)))
    asked = ", ".join(f"a box of {t.width_m:g} x {t.height_m:g} x {t.depth_m:g} m" for t in targets) or "none"
    images = boxes_in_picture(frame.image, targets)
    sizes = tuple((t.width_m, t.height_m, t.depth_m) for t in targets) if images else ()
    return Sight(frame.name, asked, images, once_per_sweep(frame.cloud, boxes_in_sweep, sizes, options))


def paired_boxes(sights: Sequence[Sight], start: Float) -> BoxPairing | None:
    """Return the pairs that most frames agree on, nearest to the initial extrinsic if ambiguous; None without any."""
    explained: list[tuple[int, float, Float, list[BoxPair]]] = []
    candidates = (
        BoxPair(number, box, sweep, turn)
        for number, sight in enumerate(sights)
        for box in sight.in_image
        for sweep in sight.in_sweep
        for turn in _turns(box, sweep)
    )
    for pair in candidates:
        pose = pair.image.camera_from_box @ se3.inverse(pair.lidar_from_box)
        if np.linalg.norm(pose[:3, 3]) > _LEVER_M or any(is_close(pose, each[2], _APART_DEG) for each in explained):
            continue
        pairs = _matches(sights, pose, *_WIDE) or [pair]
        for _ in range(2):
            pose = _refined(pairs)
            pairs = _matches(sights, pose, *_NARROW) or pairs
        explained.append((len(pairs), _misfit(pairs, pose), pose, pairs))
    best = best_explained(explained, start, _FIT_MARGIN, _APART_DEG)
    return None if best is None else BoxPairing(tuple(best[1]), best[0], len(best[2]))


def _turns(box: BoxInPicture, sweep: BoxInSweep) -> list[Float]:
    return symmetries(box.target.size_m) if np.allclose(box.target.size_m, sweep.size_m) else []


def _off(box: BoxInPicture, sweep: BoxInSweep, pose: Float) -> tuple[float, float, Float]:
    """Return how far in m and deg a pose brings a box of a sweep from the image's, turned as fits best."""
    camera_from_box = pose @ sweep.lidar_from_box
    away = float(np.linalg.norm(camera_from_box[:3, 3] - box.camera_from_box[:3, 3]))
    moved_box = se3.inverse(box.camera_from_box) @ camera_from_box
    turn = max(_turns(box, sweep), key=lambda each: float(np.trace(moved_box[:3, :3] @ each[:3, :3])))
    return away, se3.angle_deg(moved_box @ turn), turn


def _matches(sights: Sequence[Sight], pose: Float, within_m: float, within_deg: float) -> list[BoxPair]:
    out = []
    for number, sight in enumerate(sights):
        free = list(sight.in_sweep)
        for box in sight.in_image:
            near = []
            for sweep in (each for each in free if _turns(box, each)):
                away, angle, turn = _off(box, sweep, pose)
                if away < within_m and angle < within_deg:
                    near.append((away / within_m + angle / within_deg, BoxPair(number, box, sweep, turn)))
            if near:
                pair = min(near, key=lambda each: each[0])[1]
                free = [each for each in free if each is not pair.sweep]
                out.append(pair)
    return out


def _refined(pairs: Sequence[BoxPair]) -> Float:
    """Return the pose that takes the corners of boxes of sweeps nearest to those of images."""
    to = np.concatenate([se3.apply(p.image.camera_from_box, p.image.target.outline) for p in pairs])
    return from_points(to, np.concatenate([se3.apply(p.lidar_from_box, p.image.target.outline) for p in pairs]))


def _misfit(pairs: Sequence[BoxPair], pose: Float) -> float:
    offs = [_off(pair.image, pair.sweep, pose) for pair in pairs]
    return float(sum((away / _MIDDLE_M) ** 2 + (angle / _TURN_DEG) ** 2 for away, angle, _ in offs))


def missing_boxes(sights: Sequence[Sight]) -> str:
    """Return why there are no boxes to pair; "" if both sensors show some."""
    outline = "{}: a region of one saturated colour with the outline of a box whose corner faces the camera"
    bodies = "boxes, but no sweep has {} that is isolated and shows three faces: check the size"
    return missing_targets(sights, "box", outline, bodies)


def warnings_of(sights: Sequence[Sight], pairing: BoxPairing) -> tuple[str, ...]:
    """Return warnings about boxes that only one sensor sees and about other poses that fit as well."""
    used = {id(pair.image) for pair in pairing.pairs}
    unmatched = [sight.name for sight in sights for box in sight.in_image if id(box) not in used]
    return pairing_warnings("box", "boxes", sights, unmatched=unmatched, alternatives=pairing.others)
