"""The built methods of a plan: what they prepare of each frame, and the calibration from it.

A run and a row of a study share this code; a study takes what is prepared of frames from its cache.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from p2o.arrays import Float
from p2o.calibration.algorithm import Algorithm
from p2o.calibration.options import PipelineOptions
from p2o.confidence.assessment import witnessed
from p2o.errors import P2OError
from p2o.features.view import View
from p2o.frames.frame import Frame
from p2o.frames.scale import camera_at_scale, image_at_scale
from p2o.host.slots import EXTRACTORS, WIDE, WITNESS, WITNESS_STAGES
from p2o.host.stages import Initializer, InitializerBase
from p2o.options import Options
from p2o.results.result import Result
from p2o.run.pipeline import STAGES, Clock, Pipeline, with_remarks
from p2o.run.read_again import FrameInfo, cache_key, without_truth
from p2o.run.wide import solve_widely
from p2o.runtime.native import for_each, keep_freed_memory
from p2o.runtime.stages import counted

if TYPE_CHECKING:
    from p2o.host.guard import GuardedCalibrator
    from p2o.run.part import Part

INPUTS = {"extractor": "image", "cloud": "cloud", "calibrator": "frame", "init": "frame"}
INPUTS |= {"witness": "image", "witness-cloud": "sweep"}
"""The input of each stage that prepares something of a frame."""


def given(frame: Frame, stage: str) -> Any:
    """Return the input of a stage from a frame, without its truth; images are downsampled (`p2o.frames.scale`)."""
    kind = INPUTS[stage]
    if kind == "frame":
        return frame.without_truth()
    if kind == "sweep":
        return frame.cloud if frame.sweep is None else frame.sweep
    return image_at_scale(frame.image) if kind == "image" else frame.cloud


@dataclass(frozen=True, eq=False)
class Assembly:
    """Built methods of a plan: a `Pipeline` of stages or a whole method, and the extractors of the independent check.

    `stages` prepare something of a frame, by stage; the outcome follows from the content of their inputs (`INPUTS`), so
    it may be cached. Where all of them are `parallel`, several frames are prepared at once. `witness` are the stages
    that correct a pose by the edges of the independent check; None if these edges have no directions. `wide` searches
    again where the result of a rough initial guess is not trusted. `twists` (6,) are known velocities during the raw
    sweeps of frames, by name, for which a pipeline compensates their edges.
    """

    calibrator: Pipeline | GuardedCalibrator
    stages: Mapping[str, Callable[[Any], Any]]
    options: PipelineOptions
    parallel: bool = False
    witness: Algorithm | None = None
    wide: Initializer | None = None
    twists: Mapping[str, Float] = field(default_factory=dict)

    @classmethod
    def of(
        cls, parts: Mapping[str, Part], options: Options | None, build: Callable[[Part], Any] | None = None
    ) -> Assembly:
        """Return the assembly of the parts of a plan; `build` makes a stage of a part (default: `Part.build`).

        `options` are those of the pipeline; a whole method takes the defaults for what is judged of its results.
        """
        keep_freed_memory()
        make = build if build is not None else lambda part: part.build()
        built = {stage: make(part) for stage, part in parts.items() if stage not in ("data", "accumulate")}
        options = options if isinstance(options, PipelineOptions) else PipelineOptions()
        extractors = [stage for stage in ("extractor", "cloud", *WITNESS) if stage in built]
        stages: dict[str, Callable[[Any], Any]] = {stage: remembering(built[stage]) for stage in extractors}
        asked = [stage for stage in built if stage in INPUTS and stage not in (*WITNESS, "init")]
        parallel = all(parts[stage].offer.method.parallel for stage in asked)
        if "calibrator" in built:
            whole: GuardedCalibrator = built["calibrator"]
            own = {"calibrator": whole.prepare} if whole.prepares else {}
            return cls(whole, {**own, **stages}, options, parallel, _witness(parts, built))
        initializer = built["init"]
        if isinstance(initializer, InitializerBase) and initializer.prepares:
            stages["init"] = initializer.prepare
            parallel = parallel and parts["init"].offer.method.parallel
        needs = parts["matcher"].offer.method.needs
        pipeline = Pipeline(
            image_extractor=stages["extractor"],
            cloud_extractor=stages["cloud"],
            matcher=built["matcher"],
            solver=built["solver"],
            initializer=built["init"],
            options=options,
            directed="side" in needs,
            needs=frozenset(needs | parts["init"].offer.method.needs),
        )
        return cls(pipeline, stages, options, parallel, _witness(parts, built), built.get(WIDE))

    @property
    def reads_frames(self) -> bool:
        """Whether the method is a plain function of frames, for which nothing is prepared."""
        return not isinstance(self.calibrator, Pipeline) and not self.calibrator.prepares

    @property
    def has_witness(self) -> bool:
        """Whether other extractors check the results."""
        return all(stage in self.stages for stage in WITNESS)

    def __call__(self, frames: Sequence[Frame], camera_from_lidar: Float, /) -> Result:
        """Calibrate frames jointly from an initial extrinsic (4, 4), and apply the independent check to the result."""
        clock = Clock()
        with clock.of("extract"):
            # One access a frame: large sets of frames are read again at each.
            prepare = counted(STAGES["extract"], self._prepare, len(frames))
            prepared = for_each(prepare, frames, parallel=self.parallel)
        infos, own_pieces = zip(*prepared, strict=True)
        pieces = without_truth(frames) if self.reads_frames else own_pieces
        result = self.calibrated(infos, pieces, camera_from_lidar)
        result = self.checked(result, infos, lambda number: self._pieces(frames[number], WITNESS))
        return with_remarks(replace(result, seconds={**clock.seconds, **result.seconds}), infos)

    def _prepare(self, frame: Frame) -> tuple[FrameInfo, dict[str, Any]]:
        """Return the info of a frame and the outputs of all stages except the independent check."""
        own = [stage for stage in self.stages if stage not in WITNESS]
        return FrameInfo.of(frame, "twist"), self._pieces(frame, own)

    def _pieces(self, frame: Frame, stages: Iterable[str]) -> dict[str, Any]:
        """Return what stages prepare of a frame."""
        return {stage: self.stages[stage](given(frame, stage)) for stage in stages}

    def calibrated(self, frames: Sequence[FrameInfo], pieces: Sequence[Any], camera_from_lidar: Float) -> Result:
        """Return the joint calibration of frames from what was prepared of each of them, by stage.

        Where the method `reads_frames`, `pieces` are the frames, without truth.
        """
        if isinstance(self.calibrator, Pipeline):
            views = self.views(self.calibrator, frames, pieces)
            return solve_widely(self.calibrator, self.wide, views, camera_from_lidar)
        if not self.reads_frames:
            pieces = [piece["calibrator"] for piece in pieces]
        result = self.calibrator.solve(pieces, camera_from_lidar)
        # A whole method knows only what it prepared, which may lack the names.
        return replace(result, frames=tuple(info.name for info in frames))

    def views(self, pipeline: Pipeline, frames: Sequence[FrameInfo], pieces: Sequence[Any]) -> list[View]:
        """Return the views of frames from what was prepared of each of them, by stage."""
        views = []
        for info, piece in zip(frames, pieces, strict=True):
            features = piece["extractor"], piece["cloud"]
            view = pipeline.view(info.name, info.camera, *features, info.twist, piece.get("init"))
            known = self.twists.get(info.name)
            views.append(view if known is None else view.untwisted(known))
        return views

    def checked(
        self, result: Result, frames: Sequence[FrameInfo], extract: Callable[[int], Mapping[str, Any]]
    ) -> Result:
        """Return a result with the verdict by the edges of the independent check, if the method has one.

        `extract` gives the features of the independent check by stage, for a frame by its number; it is called only if
        the result needs the check.
        """
        if not result.status.solved or (result.agreement is not None and not self.has_witness):
            return result
        clock = Clock()
        with clock.of("witness"):
            views = [self._witness_view(info, partial(extract, number)) for number, info in enumerate(frames)]
            result = witnessed(result, [view for view in views if view is not None], self.options, self.witness)
        return replace(result, seconds={**clock.seconds, **result.seconds})

    def _witness_view(self, info: FrameInfo, extract: Callable[[], Mapping[str, Any]]) -> View | None:
        """Return the features of the independent check; None without a check or if its extractors fail."""
        if not self.has_witness:
            return None
        try:
            pieces = extract()
        # The independent check may be a default: if it fails, the verdict reports that the result was not checked.
        except P2OError:
            return None
        image, cloud = (pieces[stage] for stage in WITNESS)
        return View(info.name, camera_at_scale(info.camera), image, cloud, info.twist)

    def view(self, frame: Frame) -> View | None:
        """Return the features of a frame to draw: of the pipeline or of the independent check; None without either."""
        if isinstance(self.calibrator, Pipeline):
            # What an initializer prepares is not drawn.
            pieces = self._pieces(frame, EXTRACTORS)
            view = self.calibrator.view(frame.name, frame.camera, pieces["extractor"], pieces["cloud"], frame.twist)
            if view.image.edges is not None or not self.has_witness:
                return view
        return self._witness_view(FrameInfo.of(frame, "twist"), lambda: self._pieces(frame, WITNESS))


def _witness(parts: Mapping[str, Part], built: Mapping[str, Any]) -> Algorithm | None:
    """Return the stages that correct a pose by the edges of the independent check; None if a plan has none."""
    if not all(stage in built for stage in (*WITNESS, *WITNESS_STAGES.values())):
        return None
    matcher, solver, initializer = (built[WITNESS_STAGES[stage]] for stage in ("matcher", "solver", "init"))
    needs = frozenset(need for stage in ("matcher", "init") for need in parts[WITNESS_STAGES[stage]].offer.method.needs)
    return Algorithm(matcher=matcher, solver=solver, initializer=initializer, needs=needs)


def remembering(extract: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return the extractor with a memory as long as the image or sweep lives, so that overlays reuse its features.

    For frames that are read again it lasts as long as they can be read (`p2o.run.read_again`).
    """
    known: WeakKeyDictionary[Any, Any] = WeakKeyDictionary()

    def remembered(data: Any, /) -> Any:
        key = cache_key(data)
        if key not in known:
            known[key] = extract(data)
        return known[key]

    return remembered
