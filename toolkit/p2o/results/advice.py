"""What to do next with a result, by what speaks against it; docs/how-to/is-my-result-good.md says more."""

from __future__ import annotations

from collections.abc import Mapping

from p2o.results.result import Result, Status
from p2o.results.verdict import Doubt

_LOOK = (
    "Look at the pictures: another moment, another camera, mirrored axes or a transform in the wrong direction are the "
    "usual causes; frames full of leaves are the harmless one."
)
_MORE = "Take more frames together (--joint); `p2o data suggest` says which."
BY_DOUBT: Mapping[Doubt, tuple[str, ...]] = {
    Doubt.NOT_SOLVED: (),
    Doubt.LITTLE_AGREEMENT: (_LOOK, _MORE),
    Doubt.NOT_CHECKED: ("Nothing could check this result: name extractors that can (--witness IMAGE/CLOUD).",),
    Doubt.RIVAL_POSE: (_MORE, "Or begin nearer to the truth: one frame of a bare road often fits in two places."),
    Doubt.TOO_FEW_PLACES: (_MORE, "Choose frames with edges all over the picture: poles, cars, corners of houses."),
    Doubt.TOO_UNSURE: (_MORE, "See which axis is open below: level edges tell pitch and height, upright ones yaw."),
    Doubt.LED_AWAY: (
        "Let edges calibrate the same frames (the defaults of `p2o run`), and compare; or give the method more frames.",
    ),
    Doubt.CAMERA: (
        "Calibrate the lens anew, or let the edges do it: --set pipeline.camera=refine with many frames together.",
    ),
    Doubt.CONTRADICTION: ("Cameras or frames contradict each other: look at each of them by itself.",),
    Doubt.TOO_FEW_CAMERAS: ("A rig needs two cameras with a pose of their own: look at those that were left out.",),
}
"""What to do about each doubt."""
BY_STATUS: Mapping[Status, tuple[str, ...]] = {
    Status.NO_IMPROVEMENT: ("No pose fits better than the start: it may be right already. " + _LOOK,),
    Status.TOO_FEW_MATCHES: (_MORE, "Or begin nearer to the truth (--start)."),
    Status.NOT_OBSERVABLE: (_MORE, "All edges seen run one way: choose frames with upright and level ones."),
    Status.NO_EDGES: ("Look at the pictures: does the camera see anything that the LiDAR sees, too?", _MORE),
    Status.NO_FEATURES: ("The method found nothing to work with: try other frames or another extractor.",),
    Status.STAGE_FAILED: ("A method failed; P2O_DEBUG=1 shows where.",),
}
"""What to do about each refusal."""
_GOOD = (
    "Look at the pictures: lines and circles of one colour must meet, near things and far ones.",
    "The best evidence is another group of frames: calibrate several, --joint, and compare.",
)


def next_steps(result: Result) -> tuple[str, ...]:
    """Return what to do next, each sentence once; of a result that nothing speaks against how to be surer."""
    steps = [] if result.status.solved else [*BY_STATUS.get(result.status, ())]
    for reason in result.verdict.reasons:
        steps += BY_DOUBT[reason.doubt]
    if result.verdict.trusted:
        steps += _GOOD
    return tuple(dict.fromkeys(steps))
