"""Which box of a sweep is which of its picture, and how it is turned: the choice that one pose explains best."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
import p2o
from p2o import Box, se3
from p2o.arrays import Float

from p2o_baselines.bodies.body_options import BodyOptions
from p2o_baselines.bodies.box_in_picture import BoxInPicture, boxes_in_picture
from p2o_baselines.bodies.box_in_sweep import BoxInSweep, boxes_in_sweep
from p2o_baselines.bodies.box_shape import symmetries
from p2o_baselines.bodies.sphere_pairing import from_points

_LEVER_M = 3.0  # sensors are no farther apart
_WIDE, _NARROW = (0.5, 15.0), (0.25, 8.0)
"""Middle (m) and turn (deg) of a box of a sweep are within this of the picture's: before and after refinement."""
_MIDDLE_M, _TURN_DEG = 0.03, 1.5
_ALIKE = 4.0
"""Poses whose misfits differ by less, in squares of deviations a box, fit about as well."""
_START_DEG, _START_M = 10.0, 0.3
_APART_DEG = 5.0


@dataclass(frozen=True)
class BoxSight:
    """One frame: `asked` says which boxes were looked for, `pictures` and `sweeps` what was found."""

    name: str
    asked: str
    pictures: tuple[BoxInPicture, ...]
    sweeps: tuple[BoxInSweep, ...]


@dataclass(frozen=True)
class BoxPair:
    """A box of a picture with that of the sweep; `lidar_from_box` (4, 4) is its pose there, corners as in the picture.

    `turn` (4, 4) is how the sweep's own box frame is turned for that; `frame` is the number of its frame.
    """

    frame: int
    picture: BoxInPicture
    sweep: BoxInSweep
    turn: Float

    @property
    def lidar_from_box(self) -> Float:
        """The pose (4, 4) of the box in the LiDAR frame, numbered as the picture's."""
        return np.asarray(self.sweep.lidar_from_box @ self.turn)


@dataclass(frozen=True)
class BoxPairing:
    """The pairs that a pose (4, 4) explains, and how many other poses explain as many as well."""

    pairs: tuple[BoxPair, ...]
    camera_from_lidar: Float
    others: int


_found: WeakKeyDictionary[p2o.Cloud, dict[Hashable, tuple[BoxInSweep, ...]]] = WeakKeyDictionary()
"""What was found in sweeps that are still in use: all methods of boxes ask the same."""


def box_sight_of(frame: p2o.Frame, options: BodyOptions) -> BoxSight:
    """Return what a frame shows of its boxes; the sweep is searched only where the picture shows one."""
    targets = list(dict.fromkeys(target for target in frame.targets if isinstance(target, Box)))
    asked = ", ".join(f"a box of {t.width_m:g} x {t.height_m:g} x {t.depth_m:g} m" for t in targets) or "none"
    pictures = boxes_in_picture(frame.image, targets)
    sizes = tuple((t.width_m, t.height_m, t.depth_m) for t in targets) if pictures else ()
    key = (sizes, options.farthest_m, options.scatter_m)
    known = _found.setdefault(frame.cloud, {})
    if key not in known:
        known[key] = boxes_in_sweep(frame.cloud, sizes, farthest_m=key[1], sigma_m=key[2]) if sizes else ()
    return BoxSight(frame.name, asked, pictures, known[key])


def paired_boxes(sights: Sequence[BoxSight], start: Float) -> BoxPairing | None:
    """Return the pairs that most frames agree on; None where no sweep has a box of a picture's size.

    Of poses that fit about as well the one nearest to the start (4, 4) is taken.
    """
    found: list[tuple[int, float, Float, list[BoxPair]]] = []
    for number, sight in enumerate(sights):
        for picture in sight.pictures:
            for sweep in sight.sweeps:
                for turn in _turns(picture, sweep):
                    pose = picture.camera_from_box @ se3.inverse(sweep.lidar_from_box @ turn)
                    if np.linalg.norm(pose[:3, 3]) > _LEVER_M or any(_close(pose, each[2]) for each in found):
                        continue
                    pairs = _matches(sights, pose, *_WIDE) or [BoxPair(number, picture, sweep, turn)]
                    for _ in range(2):
                        pose = _refined(pairs)
                        pairs = _matches(sights, pose, *_NARROW) or pairs
                    found.append((len(pairs), _misfit(pairs, pose), pose, pairs))
    if not found:
        return None
    most = max(count for count, *_ in found)
    least = min(misfit for count, misfit, *_ in found if count == most)
    alike = [each for each in found if each[0] == most and each[1] < least + _ALIKE * most]
    _, _, pose, pairs = min(alike, key=lambda each: (_from_start(each[2], start), each[1]))
    others: list[Float] = []
    for each in alike:
        if not _close(each[2], pose) and not any(_close(each[2], other) for other in others):
            others.append(each[2])
    return BoxPairing(tuple(pairs), pose, len(others))


def _turns(picture: BoxInPicture, sweep: BoxInSweep) -> list[Float]:
    return symmetries(picture.target.size_m) if np.allclose(picture.target.size_m, sweep.size_m) else []


def _off(picture: BoxInPicture, sweep: BoxInSweep, pose: Float) -> tuple[float, float, Float]:
    """Return how far in m and deg a pose brings a box of a sweep from the picture's, turned as fits best."""
    camera_from_box = pose @ sweep.lidar_from_box
    away = float(np.linalg.norm(camera_from_box[:3, 3] - picture.camera_from_box[:3, 3]))
    there = se3.inverse(picture.camera_from_box) @ camera_from_box
    turn = max(_turns(picture, sweep), key=lambda each: float(np.trace(there[:3, :3] @ each[:3, :3])))
    return away, se3.angle_deg(there @ turn), turn


def _matches(sights: Sequence[BoxSight], pose: Float, within_m: float, within_deg: float) -> list[BoxPair]:
    out = []
    for number, sight in enumerate(sights):
        free = list(sight.sweeps)
        for picture in sight.pictures:
            near = []
            for sweep in free:
                if not _turns(picture, sweep):
                    continue
                away, angle, turn = _off(picture, sweep, pose)
                if away < within_m and angle < within_deg:
                    near.append((away / within_m + angle / within_deg, BoxPair(number, picture, sweep, turn)))
            if near:
                pair = min(near, key=lambda each: each[0])[1]
                free = [each for each in free if each is not pair.sweep]
                out.append(pair)
    return out


def _refined(pairs: Sequence[BoxPair]) -> Float:
    """Return the pose that takes the corners of boxes of sweeps nearest to those of pictures."""
    to = np.concatenate([se3.apply(p.picture.camera_from_box, p.picture.target.outline) for p in pairs])
    return from_points(to, np.concatenate([se3.apply(p.lidar_from_box, p.picture.target.outline) for p in pairs]))


def _misfit(pairs: Sequence[BoxPair], pose: Float) -> float:
    offs = [_off(pair.picture, pair.sweep, pose) for pair in pairs]
    return float(sum((away / _MIDDLE_M) ** 2 + (angle / _TURN_DEG) ** 2 for away, angle, _ in offs))


def _from_start(pose: Float, start: Float) -> float:
    apart = float(np.linalg.norm(se3.inverse(pose)[:3, 3] - se3.inverse(start)[:3, 3]))
    return se3.angle_deg(pose @ se3.inverse(start)) / _START_DEG + apart / _START_M


def _close(a: Float, b: Float) -> bool:
    step = a @ se3.inverse(b)
    return se3.angle_deg(step) < _APART_DEG and float(np.linalg.norm(a[:3, 3] - b[:3, 3])) < 0.25


def nothing_of(sights: Sequence[BoxSight]) -> str:
    """Return in words that there are no boxes to pair; "" where there are."""
    asked = next((sight.asked for sight in sights if sight.asked != "none"), "none")
    if asked == "none":
        return "no frame says that it shows a box: state it in `targets` of frame.yaml"
    seen = [sight for sight in sights if sight.pictures]
    if not seen:
        return (
            f"no picture of {len(sights)} shows {asked}: a region of one strong colour with the outline of a box whose "
            "corner is turned to the camera"
        )
    if not any(sight.sweeps for sight in seen):
        return (
            f"{len(seen)} of {len(sights)} pictures show boxes, but no sweep has {asked} that stands by itself and "
            "shows three faces: is the size right?"
        )
    return ""


def remarks_of(sights: Sequence[BoxSight], pairing: BoxPairing) -> tuple[str, ...]:
    """Return what is worth a line: boxes that one sensor alone found, and poses that fit as well."""
    lines = []
    used = {id(pair.picture) for pair in pairing.pairs}
    alone = [sight.name for sight in sights for box in sight.pictures if id(box) not in used]
    none = [sight.name for sight in sights if not sight.pictures]
    if alone:
        lines.append(f"boxes in pictures that no sweep shows at this pose: {', '.join(alone[:5])} ({len(alone)})")
    if none:
        lines.append(f"pictures in which no box is found: {', '.join(none[:5])} ({len(none)})")
    if pairing.others:
        lines.append(f"{1 + pairing.others} poses fit the boxes about as well: the nearest to the start is taken")
    return tuple(lines)
