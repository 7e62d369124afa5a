"""The built methods of a plan: what they prepare of each frame, and the result that they make of it.

One run and one row of a study go the same way; a study only looks up what was prepared before.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from p2o.arrays import Float
from p2o.calibration.options import PipelineOptions
from p2o.calibration.pipeline import Pipeline
from p2o.calibration.witness import witnessed
from p2o.errors import P2OError
from p2o.features.view import View
from p2o.frames.frame import Frame
from p2o.frames.scale import camera_at_scale, image_at_scale
from p2o.geometry.camera import Camera
from p2o.host.slots import WITNESS, WITNESS_STAGES
from p2o.options import Options
from p2o.results.result import Result
from p2o.run.read_again import lasting
from p2o.threads import for_each

if TYPE_CHECKING:
    from p2o.host.guard import GuardedCalibrator
    from p2o.run.part import Part

INPUTS = {
    "extractor": "image",
    "cloud": "cloud",
    "calibrator": "frame",
    "init": "frame",
    "witness": "image",
    "witness-cloud": "sweep",
}
"""What each stage that prepares something looks at."""


def given(frame: Frame, stage: str) -> Any:
    """Return the part of a frame that a stage prepares something from, its picture as it is looked at; no truth."""
    kind = INPUTS[stage]
    if kind == "frame":
        return frame.without_truth()
    if kind == "sweep":
        return frame.cloud if frame.sweep is None else frame.sweep
    return image_at_scale(frame.image) if kind == "image" else frame.cloud


@dataclass(frozen=True, eq=False)
class Assembly:
    """The methods of a plan, built: a `Pipeline` of stages or a whole method, and the extractors of the witness.

    `stages` are what prepares something of a frame, by stage; those in `kept` may be kept by the content that they look
    at (`INPUTS`). Where all of them are `parallel`, several frames are prepared at once. `witness` is the pipeline that
    tells where the edges of the witness lead; None where they have no directions.
    """

    calibrator: Pipeline | GuardedCalibrator
    stages: Mapping[str, Callable[[Any], Any]]
    options: PipelineOptions
    parallel: bool = False
    witness: Pipeline | None = None

    @classmethod
    def of(
        cls, parts: Mapping[str, Part], options: Options | None, build: Callable[[Part], Any] | None = None
    ) -> Assembly:
        """Return the assembly of the parts of a plan; `build` makes a stage of a part (default: `Part.build`).

        `options` are those of the pipeline; a whole method takes the defaults for what is judged of its results.
        """
        make = build if build is not None else lambda part: part.build()
        built = {stage: make(part) for stage, part in parts.items() if stage not in ("data", "accumulate")}
        options = options if isinstance(options, PipelineOptions) else PipelineOptions()
        stages: dict[str, Callable[[Any], Any]] = {
            stage: remembering(built[stage]) for stage in ("extractor", "cloud", *WITNESS) if stage in built
        }
        asked = [stage for stage in built if stage in INPUTS and stage not in (*WITNESS, "init")]
        parallel = all(parts[stage].offer.method.parallel for stage in asked)
        if "calibrator" in built:
            whole: GuardedCalibrator = built["calibrator"]
            return cls(whole, {"calibrator": whole.prepare, **stages}, options, parallel, _witness(parts, built))
        if (prepare := getattr(built["init"], "prepare", None)) is not None:
            stages["init"] = prepare
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
        return cls(pipeline, stages, options, parallel, _witness(parts, built))

    @property
    def kept(self) -> tuple[str, ...]:
        """The stages whose outcome may be kept; a whole method that prepares nothing needs its frames again."""
        if isinstance(self.calibrator, Pipeline) or self.calibrator.prepares:
            return tuple(self.stages)
        return tuple(stage for stage in self.stages if stage != "calibrator")

    def __call__(self, frames: Sequence[Frame], camera_from_lidar: Float, /) -> Result:
        """Return the joint calibration of frames from a start (4, 4)."""
        from p2o.calibration.pipeline import Clock

        clock = Clock()
        with clock.of("extract"):
            # Looked at once: very many frames are read again each time.
            seen = for_each(self._seen, frames, parallel=self.parallel)
        result = self.calibrated([one for one, _, _ in seen], [pieces for _, pieces, _ in seen], camera_from_lidar)
        if result.status.solved and result.agreement is None:
            with clock.of("witness"):
                views = [view for frame in frames if (view := self.witness_of_frame(frame)) is not None]
                result = witnessed(result, views, self.options, self.witness)
        warnings = tuple(text for _, _, texts in seen for text in texts)
        return replace(result, seconds={**clock.seconds, **result.seconds}, warnings=(*warnings, *result.warnings))

    def _seen(self, frame: Frame) -> tuple[tuple[str, Camera, Float | None], dict[str, Any], tuple[str, ...]]:
        """Return what stays of a frame: its name, camera and twist, its pieces by stage, and its warnings.

        The witness looks at frames later.
        """
        pieces = {stage: find(given(frame, stage)) for stage, find in self.stages.items() if stage not in WITNESS}
        return (frame.name, frame.camera, frame.twist), pieces, tuple(f"{frame.name}: {w}" for w in frame.warnings)

    def calibrated(
        self,
        frames: Sequence[tuple[str, Camera, Float | None]],
        pieces: Sequence[Mapping[str, Any]],
        camera_from_lidar: Float,
    ) -> Result:
        """Return the result of what was prepared: name, camera and twist of each frame, and its pieces by stage."""
        if isinstance(self.calibrator, Pipeline):
            views = [
                self.calibrator.view(name, camera, piece["extractor"], piece["cloud"], twist, piece.get("init"))
                for (name, camera, twist), piece in zip(frames, pieces, strict=True)
            ]
            return self.calibrator.solve(views, camera_from_lidar)
        return self.calibrator.solve([piece["calibrator"] for piece in pieces], camera_from_lidar)

    def witness_of_frame(self, frame: Frame) -> View | None:
        """Return the edges that a result is checked by, or None where there are none to be had of this frame."""
        if not all(stage in self.stages for stage in WITNESS):
            return None
        try:
            image, cloud = (self.stages[stage](given(frame, stage)) for stage in WITNESS)
        # The witness was not asked for by name: where it cannot work, the verdict says that nothing was checked.
        except P2OError:
            return None
        return View(frame.name, camera_at_scale(frame.camera), image, cloud, frame.twist)

    def view(self, frame: Frame) -> View | None:
        """Return the features to draw of a frame: those of the pipeline, or of the witness; None without either."""
        if isinstance(self.calibrator, Pipeline):
            # What an initializer prepares is not drawn.
            found = [self.stages[stage](given(frame, stage)) for stage in ("extractor", "cloud")]
            view = self.calibrator.view(frame.name, frame.camera, found[0], found[1], frame.twist)
            if view.image.edges is not None or not all(stage in self.stages for stage in WITNESS):
                return view
        return self.witness_of_frame(frame)


def _witness(parts: Mapping[str, Part], built: Mapping[str, Any]) -> Pipeline | None:
    """Return the pipeline that tells where the edges of a witness lead, or None where a plan has none."""
    if not all(stage in built for stage in (*WITNESS, *WITNESS_STAGES.values())):
        return None
    image, cloud = (built[stage] for stage in WITNESS)
    matcher, solver, initializer = (built[WITNESS_STAGES[stage]] for stage in ("matcher", "solver", "init"))
    needs = frozenset(need for stage in ("matcher", "init") for need in parts[WITNESS_STAGES[stage]].offer.method.needs)
    return Pipeline(image, cloud, matcher, solver, initializer, PipelineOptions(), needs=needs)


def remembering(extract: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return the extractor with a memory that lasts as long as the image or sweep: pictures reuse its features.

    Of frames that are read again it lasts as long as they may be.
    """
    known: WeakKeyDictionary[Any, Any] = WeakKeyDictionary()

    def remembered(data: Any, /) -> Any:
        key = lasting(data)
        if key not in known:
            known[key] = extract(data)
        return known[key]

    return remembered
