"""Advice on what to do next, by the doubts about a result and by its status (docs/how-to/is-my-result-good.md)."""

from __future__ import annotations

from collections.abc import Mapping

from p2o.results.result import Result, Status
from p2o.results.verdict import Doubt

_LOOK = (
    "Inspect the overlays: images of another time, another camera, mirrored axes or a transform in the wrong direction "
    "are the usual causes; frames full of leaves are a harmless one."
)
_MORE = "Calibrate more frames jointly (--joint); `p2o data suggest` selects them."
BY_DOUBT: Mapping[Doubt, tuple[str, ...]] = {
    Doubt.NOT_SOLVED: (),
    Doubt.LITTLE_AGREEMENT: (_LOOK, _MORE),
    Doubt.NOT_CHECKED: ("No independent check was possible: name extractors for it (--witness IMAGE/CLOUD).",),
    Doubt.RIVAL_POSE: (_MORE, "Or use a better initial guess: one frame of an empty road often fits at two poses."),
    Doubt.TOO_FEW_PLACES: (_MORE, "Choose frames with edges in all parts of the image: poles, cars, buildings."),
    Doubt.TOO_UNSURE: (
        _MORE,
        "See the error by axis: horizontal edges determine pitch and height, vertical edges yaw.",
    ),
    Doubt.LED_AWAY: (
        "Calibrate the same frames with edges (the defaults of `p2o run`) and compare; or give the method more frames.",
    ),
    Doubt.CAMERA: (
        "Calibrate the intrinsics again, or estimate them from many frames jointly (--set pipeline.camera=refine).",
    ),
    Doubt.OUTSIDE_BOX: (
        _MORE,
        "If the initial guess may be that far off, enlarge the box (--set init.reach_deg, init.reach_m).",
    ),
    Doubt.CONTRADICTION: ("Cameras or frames contradict each other: inspect each of them separately.",),
    Doubt.TOO_FEW_CAMERAS: ("A rig needs two cameras with a pose of their own: inspect those that were left out.",),
}
"""Advice for each doubt."""
BY_STATUS: Mapping[Status, tuple[str, ...]] = {
    Status.NO_IMPROVEMENT: ("No pose fits better than the initial guess, which may be right. " + _LOOK,),
    Status.TOO_FEW_MATCHES: (_MORE, "Or use a better initial guess (--start)."),
    Status.NOT_OBSERVABLE: (_MORE, "All edges have one direction: choose frames with vertical and horizontal edges."),
    Status.NO_EDGES: ("Inspect the images: do camera and LiDAR observe the same objects?", _MORE),
    Status.NO_FEATURES: ("The method found no features: try other frames or another extractor.",),
    Status.STAGE_FAILED: ("A method failed; P2O_DEBUG=1 shows where.",),
}
"""Advice for each status without a new pose."""
_GOOD = (
    "Inspect the overlays: lines and circles of one colour must coincide for near and for far objects.",
    "The best check is a second group of frames: calibrate both jointly (--joint) and compare.",
)


def next_steps(result: Result) -> tuple[str, ...]:
    """Return the advice for a result, each sentence once; for a trusted result, how to confirm it.

    If the camera is in doubt, its advice is the first and more frames are not advised, because they repeat its error.
    """
    steps = [] if result.status.solved else [*BY_STATUS.get(result.status, ())]
    doubts = sorted((reason.doubt for reason in result.verdict.reasons), key=lambda doubt: doubt is not Doubt.CAMERA)
    for doubt in doubts:
        steps += BY_DOUBT[doubt]
    if Doubt.CAMERA in doubts:
        steps = [step for step in steps if step != _MORE]
    if result.verdict.trusted:
        steps += _GOOD
    return tuple(dict.fromkeys(steps))
