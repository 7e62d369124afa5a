"""Search a wide box of poses where the edges do not confirm the result of a search near the initial guess."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from p2o.arrays import Float
from p2o.features.view import View
from p2o.geometry import se3
from p2o.host.stages import Initializer, InitializerBase
from p2o.results.result import Result, Status
from p2o.results.verdict import Doubt
from p2o.run.pipeline import Pipeline

_NEAR_DEG = 4.0
"""Two standard deviations of the search: from initial guesses farther away it may converge to another pose."""
_NOT_SEARCHED = (Status.NO_EDGES, Status.NO_FEATURES)


def solve_widely(
    pipeline: Pipeline, wide: Initializer | None, views: Sequence[View], camera_from_lidar: Float
) -> Result:
    """Calibrate prepared views jointly from an initial extrinsic (4, 4), and again by the `wide` search if needed.

    It is needed if there are edges and the result is not trusted or more than `_NEAR_DEG` from the initial extrinsic.
    The result of the higher strength of agreement is returned, and a warning reports the search. Where `wide` is None
    and edges do not agree at the result of a search near the initial guess, a warning names the option.
    """
    result = pipeline.solve(views, camera_from_lidar)
    if wide is None:
        return replace(result, warnings=(*result.warnings, *_small_box(result, pipeline)))
    cause = _cause(result)
    if not cause:
        return result
    wider = replace(pipeline, initializer=wide).solve(views, camera_from_lidar)
    better = _strength(wider) > _strength(result)
    outcome = "its result replaces that" if better else "edges do not agree better at its result"
    text = f"the search near the rough start gave {cause}: the wide search (init far) ran, and {outcome}"
    chosen = wider if better else result
    stages = dict.fromkeys([*result.seconds, *wider.seconds])
    seconds = {stage: result.seconds.get(stage, 0.0) + wider.seconds.get(stage, 0.0) for stage in stages}
    return replace(chosen, warnings=(*chosen.warnings, text), seconds=seconds)


def _cause(result: Result) -> str:
    """Return why a wider search may find a better pose, empty if it is not needed."""
    if result.status in _NOT_SEARCHED:
        return ""
    if not result.status.solved or any(reason.doubt is not Doubt.CAMERA for reason in result.verdict.reasons):
        return "no trusted result"
    away_deg = se3.angle_deg(result.camera_from_lidar @ se3.inverse(result.start))
    return f"a result {away_deg:.1f} deg from it" if away_deg > _NEAR_DEG else ""


def _small_box(result: Result, pipeline: Pipeline) -> tuple[str, ...]:
    """Return a warning that names the wide search if edges do not agree after a search near the initial guess."""
    near = pipeline.initializer.start_sigma if isinstance(pipeline.initializer, InitializerBase) else None
    agreed = all(reason.doubt is not Doubt.LITTLE_AGREEMENT for reason in result.verdict.reasons)
    if near is None or result.status in _NOT_SEARCHED or (result.status.solved and agreed):
        return ()
    box = f"more than about {2 * near[0]:g} deg or {200 * near[1]:g} cm on an axis"
    return (f"edges do not confirm the result: if the start may be wrong by {box}, run again with --init far",)


def _strength(result: Result) -> float:
    if not result.status.solved or result.agreement is None:
        return 0.0
    return float(np.nan_to_num(result.agreement.strength))
