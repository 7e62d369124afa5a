"""The staged calibrator: extraction of features, Algorithm 1 of the paper, and the assessment of its estimate."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

from p2o.arrays import Float
from p2o.calibration.algorithm import Algorithm, is_far, missing_features
from p2o.confidence.assessment import assess, refused
from p2o.features.sets import CloudFeatures, ImageFeatures
from p2o.features.view import View
from p2o.frames.frame import Frame
from p2o.frames.scale import camera_at_scale, image_at_scale
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.host.stages import CloudExtractor, ImageExtractor, InitializerBase
from p2o.results.result import Result
from p2o.run.read_again import FrameInfo, frame_infos
from p2o.runtime.stages import counted, report_stage


def with_remarks(result: Result, frames: Sequence[Frame | FrameInfo]) -> Result:
    """Return a result with the warnings of its frames, and with their advice unless it is trusted."""
    remarks = [f"{frame.name}: {text}" for frame in frames for text in frame.warnings]
    if not result.verdict.trusted:
        remarks += [f"{frame.name}: {text}" for frame in frames for text in frame.advice]
    return replace(result, warnings=(*remarks, *result.warnings))


@dataclass(frozen=True, kw_only=True)
class Pipeline(Algorithm):
    """The staged calibrator: the paper's method with every stage replaceable.

    Calling it with frames and an initial extrinsic camera_from_lidar (4, 4) gives a Result. Views that lack a kind of
    feature in `needs` are refused. With `directed` False every edge direction is removed right after extraction, so
    that no stage of an ablation without directions can profit from them.
    """

    image_extractor: ImageExtractor
    cloud_extractor: CloudExtractor

    def __call__(self, frames: Sequence[Frame], camera_from_lidar: Float, /) -> Result:
        """Calibrate the frames jointly; a single frame is the common case."""
        clock = Clock()
        with clock.of("extract"):
            views = [*map(counted(STAGES["extract"], self.prepare, len(frames)), frames)]
        result = self.solve(views, camera_from_lidar)
        return with_remarks(replace(result, seconds={**clock.seconds, **result.seconds}), frame_infos(frames))

    def solve(self, views: Sequence[View], camera_from_lidar: Float) -> Result:
        """Calibrate prepared views jointly from an initial extrinsic (4, 4): Algorithm 1, then its assessment."""
        start, clock = se3.check_rigid("start", camera_from_lidar), Clock()
        missing = missing_features(views, start, self.needs)
        if missing is not None:
            return refused(views, start, *missing)
        with clock.of("initialize"):
            visible = self.visible(views, start)
            proposals = self.propose(visible, start)
        with clock.of("refine"):
            refined = self.refine(visible, start, proposals)
            if refined.solved and is_far(refined.start, refined.best.pose):
                refined = self.refine_again(views, refined)
            if refined.solved:
                refined = self.with_rivals(refined)
        if refined.solved:
            with clock.of("adjust"):
                estimate = self.estimate_nuisances(refined)
            with clock.of("agree"):
                result = assess(estimate, views, self.options, self.start_sigma)
        else:
            failed = refined.ends[0]
            result = refused(views, start, failed.status, failed.reason, failed.rounds)
        return replace(result, seconds=clock.seconds)

    @property
    def start_sigma(self) -> tuple[float, float] | None:
        """Standard deviation (deg, m) of the initial guess about and along each axis, or None if it is no prior."""
        return self.options.start_sigma

    def prepare(self, frame: Frame) -> View:
        """Extract the features of one frame; its true extrinsic is not used."""
        image, cloud = self.image_extractor(image_at_scale(frame.image)), self.cloud_extractor(frame.cloud)
        initializer = self.initializer
        prepared = initializer.prepare(frame.without_truth()) if isinstance(initializer, InitializerBase) else None
        return self.view(frame.name, frame.camera, image, cloud, frame.twist, prepared)

    def view(
        self,
        name: str,
        camera: Camera,
        image: ImageFeatures,
        cloud: CloudFeatures,
        twist: Float | None = None,
        prepared: Any = None,
    ) -> View:
        """Return the view of one frame from its extracted features, and its velocity (6,) where known.

        `camera` is that of the frame; image features are those of the downsampled image (`p2o.frames.scale`).
        `prepared` is what the initializer prepared of the frame.
        """
        scaled = camera_at_scale(camera)
        view = View(name, scaled, image, cloud, twist, None if scaled is camera else camera, prepared)
        return view if self.directed else view.without_sides()


STAGES = {
    "extract": "extracting features",
    "initialize": "searching poses",
    "refine": "refining poses",
    "adjust": "estimating motion, camera and time",
    "agree": "assessing the result",
    "witness": "independent check",
}
"""What stages do, in progress."""


@dataclass
class Clock:
    """Seconds by stage."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def of(self, stage: str) -> Iterator[None]:
        """Report the stage and add the duration of the block to its seconds."""
        report_stage(STAGES.get(stage, stage))
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - began
