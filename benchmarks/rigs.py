"""Real and simulated rigs with the accuracy of their ground truth, and the features of their frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from limits_and_tables import SPLITS, cached
from p2o.arrays import Float
from p2o.cache import FeatureCache, content_hash
from p2o.features.view import View
from p2o.frames.frame import Frame
from p2o.frames.selection import select, spread
from p2o.host.registry import Registry
from p2o.run.recipe import Plan, Recipe
from p2o_study.keys import features_key

KITTI_RAW = "kitti-raw:build/data/kitti_raw"
DDAD = {"cloud": {"origin_m": [1.65, 0, 1.35]}}


@dataclass(frozen=True)
class Rig:
    """One pair of sensors with frames, or several that are never solved together (`apart`, or by `camera_at`).

    `one_place` states that all frames show the same scene, so that the sweep of another frame is not a wrong pair;
    `camera_at` which letter of a frame's name identifies its camera.

    `truth_deg` and `truth_m` are the accuracy of the truth. `crop` (width, height) is the middle of the image that is
    kept: simulated cameras have one field of view, and a crop is one with a longer lens.
    """

    name: str
    data: str
    frames: str = "all"
    weights: str = "free"
    truth_deg: float = 0.0
    truth_m: float = 0.0
    seeds: int = 1
    extractor: str = "p2ornet/rings"
    crop: tuple[int, int] | None = None
    apart: bool = False
    one_place: bool = False
    camera_at: int | None = None
    options: dict[str, dict[str, object]] = field(default_factory=dict)

    @property
    def is_real(self) -> bool:
        """Whether its frames are of real sensors."""
        return is_real(self.name)

    @property
    def plan(self) -> Plan:
        """What to run on it."""
        options = {**self.options, "extractor": {"weights": self.weights}}
        return Recipe.of(data=self.data, extractor=self.extractor, options=options).resolve(Registry.load())

    def groups(self, names: Sequence[str]) -> list[list[int]]:
        """Return the numbers of frames that may be solved together."""
        if self.apart:
            return []
        words = ["" if self.camera_at is None else name[self.camera_at] for name in names]
        return [[at for at, word in enumerate(words) if word == camera] for camera in sorted(set(words))]

    def samples(self, features: Path, most: int | None = None) -> list[Sample]:
        """Return at most `most` of its frames, evenly spaced; `features` is a folder of extracted features."""
        plan = self.plan
        dataset, pipeline = plan.dataset(), plan.calibrator()
        numbers = select(dataset.names, self.frames.format(splits=SPLITS), skipped=dataset.skipped)
        parts = [features_key(plan.parts[stage], self.data) for stage in ("extractor", "cloud")]

        def extracted(number: int) -> tuple[View, Float | None]:
            frame = cropped(dataset[number], self.crop)
            return pipeline.prepare(frame), frame.camera_from_lidar

        return [
            Sample(
                *cached(FeatureCache(features), content_hash([*parts, self.crop, number]), partial(extracted, number))
            )
            for number in spread(numbers, most or len(numbers))
        ]


@dataclass(frozen=True, eq=False)
class Sample:
    """The features of one frame, and its ground truth camera_from_lidar (4, 4)."""

    view: View
    truth: Float


def _synthetic(name: str, words: str, scenes: int = 7, **rest: object) -> Rig:
    number = sum(map(ord, name))
    data = f"synthetic:?right=false&scenes={scenes}&frames_per_scene=2&period_s=1.5&seed={number}&{words}"
    return Rig(f"sim-{name}", data, **rest)  # type: ignore[arg-type]


def _folder(name: str, **rest: object) -> Rig:
    return Rig(name, f"folder:build/data/rigs/{name}", **rest)  # type: ignore[arg-type]


def _drive(name: str, words: str) -> Rig:
    data = f"{KITTI_RAW}?{words}".rstrip("?")
    return Rig(f"drive-{name}", data, "@{splits}#drive_0005_later", truth_deg=0.1, truth_m=0.01)


def _random(name: str) -> Rig:
    words = "rig=random-rings&place=anywhere&weather=any&megapixels=1"
    data = f"synthetic:?right=false&scenes=12&{words}&seed={500 + ord(name)}"
    return Rig(f"sim-random-{name}", data, apart=True)


LIDARS = {
    "vlp16": ("acfr_vlp16", "hitsz", "hitsz_sim", "boards_sim", "sim-vlp16"),
    "hdl32": ("nuscenes", "sim-hdl32"),
    "hdl64": ("kitti", "drive-hdl64", "drive-no-rings", "sim-hdl64"),
    "hdl64-decimated": ("drive-32", "drive-16"),
    "os1": ("sim-os1",),
    "pandar64": ("pjlab", "sim-pandar64"),
}
"""How the names of rigs begin that have one kind of LiDAR; others have one of their own."""


def lidar_of(rig: str) -> str:
    """Return the kind of LiDAR of a rig."""
    return next((kind for kind, names in LIDARS.items() if rig.startswith(names)), rig)


def is_real(rig: str) -> bool:
    """Return whether frames of the rig of this name are of real sensors."""
    return not rig.startswith("sim-") and not rig.endswith("_sim")


RIGS: Sequence[Rig] = (
    _folder("nuscenes", truth_deg=0.15, truth_m=0.05, seeds=3, apart=True, one_place=True),
    _folder("waymo", truth_deg=0.1, truth_m=0.08),
    _folder("pjlab", truth_deg=0.3, truth_m=0.2, seeds=2, apart=True, one_place=True),
    _folder("acfr_vlp16", truth_deg=0.3, truth_m=0.02, one_place=True),
    _folder("hitsz", truth_deg=0.1, truth_m=0.05, seeds=2, one_place=True),
    _folder("hitsz_sim", truth_deg=0.2, truth_m=0.011, one_place=True),
    _folder("boards_sim", one_place=True),
    _folder(
        "ddad", extractor="p2ornet/range-view", options=DDAD, truth_deg=0.15, truth_m=0.05, one_place=True, camera_at=-1
    ),
    Rig("kitti-odometry", "kitti-odometry:build/data/kitti_odometry", truth_deg=0.1, truth_m=0.01),
    Rig("kitti-raw", KITTI_RAW, "@{splits}#train", truth_deg=0.1, truth_m=0.01),
    _drive("hdl64", ""),
    _drive("32-rings", "keep_rings=2"),
    _drive("16-rings", "keep_rings=4"),
    _drive("no-rings", "forget_rings=true"),
    _synthetic("hdl64-f465", "lidar=hdl-64e&width_px=800&height_px=300"),
    _synthetic("hdl64-left", "lidar=hdl-64e&width_px=800&height_px=500&mount=[0.3,0.4,-0.3,3,-50,4]"),
    _synthetic("hdl64-raw", "lidar=hdl-64e&width_px=1242&height_px=375&deskew=false"),
    _synthetic("hdl32-f580", "lidar=hdl-32e&width_px=1000&height_px=560"),
    _synthetic("hdl32-f1000", "lidar=hdl-32e&width_px=1722&height_px=950", crop=(1100, 700)),
    _synthetic("vlp16-f465", "lidar=vlp-16&width_px=800&height_px=500"),
    _synthetic("vlp16-f900", "lidar=vlp-16&width_px=1550&height_px=850&place=suburb", crop=(1000, 640)),
    _synthetic("vlp16-yard", "lidar=vlp-16&width_px=1242&height_px=700&place=yard&targets=checkerboard&boards=2"),
    _synthetic("vlp16-hall", "lidar=vlp-16&width_px=1000&height_px=560&place=hall"),
    _synthetic("hdl32-suburb", "lidar=hdl-32e&width_px=1000&height_px=560&place=suburb"),
    _synthetic("pandar64-f1100", "lidar=pandar64&width_px=1900&height_px=900", crop=(1000, 640)),
    _synthetic("pandar64-fisheye", "lidar=pandar64&width_px=1000&height_px=600&camera=fisheye"),
    _synthetic("os1-64-f400", "lidar=os1-64&width_px=690&height_px=480&camera=opencv-distorted"),
    _synthetic("os1-64-f1450", "lidar=os1-64&width_px=2500&height_px=900&place=street", crop=(1100, 650)),
    _synthetic("os1-128-f580", "lidar=os1-128&width_px=1000&height_px=560"),
    _synthetic("os1-128-f1500", "lidar=os1-128&width_px=2600&height_px=800", crop=(1100, 650)),
    _random("a"),
    _random("b"),
    _synthetic("mid40-f700", "lidar=mid-40&width_px=1200&height_px=600"),
)


def rig_of(name: str) -> Rig:
    """Return a rig by its name."""
    return next(rig for rig in RIGS if rig.name == name)


def cropped(frame: Frame, crop: tuple[int, int] | None) -> Frame:
    """Return the frame with the middle of its image alone."""
    if crop is None:
        return frame
    camera, (width, height) = frame.camera, crop
    left, top = (camera.width - width) // 2, (camera.height - height) // 2
    fx, fy, cx, cy, *rest = camera.params
    smaller = replace(camera, width=width, height=height, params=(fx, fy, cx - left, cy - top, *rest))
    rgb = frame.image.rgb[top : top + height, left : left + width]
    return replace(frame, image=type(frame.image)(rgb, smaller))
