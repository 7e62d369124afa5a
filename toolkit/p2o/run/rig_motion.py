"""Use one motion per sweep in all cameras that share the sweep."""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from p2o.calibration.nuisance import motion_prior_of
from p2o.calibration.options import PipelineOptions
from p2o.confidence.common_motion import CommonMotion
from p2o.frames.frame import Frame
from p2o.results.result import Result, SweepMotion
from p2o.results.verdict import Doubt, Reason
from p2o.run.assembly import Assembly
from p2o.run.pipeline import Pipeline


@dataclass(frozen=True, eq=False)
class CameraSweeps:
    """The result of one camera, and the sweeps (keys by frame name) of which it estimated a motion."""

    camera: str
    result: Result
    sweeps: Mapping[str, str]

    @classmethod
    def of(cls, camera: str, frames: Sequence[Frame], result: Result) -> CameraSweeps:
        """Return the sweeps of a result; frames without an estimated motion are left out."""
        moving = {motion.frame for motion in result.motions}
        sweeps = {frame.name: _sweep_key(frame) for frame in frames if frame.name in moving} if moving else {}
        return cls(camera, result, sweeps)


Solve = Callable[[int, Assembly], Result]
"""Calibrate the camera of a number with these methods."""


def with_common_motions(cameras: Sequence[CameraSweeps], assembly: Assembly, solve: Solve) -> list[Result]:
    """Return the results of all cameras with one motion for each sweep that several of them share.

    Where the estimates agree within their deviations, their mean, weighted by information, replaces them: the frames of
    each of these cameras are calibrated again by `solve`, compensated for it, with its standard deviation as the prior
    of what is left. Otherwise results are kept, and their verdicts state the contradiction.
    """
    results = [camera.result for camera in cameras]
    if not isinstance(assembly.calibrator, Pipeline):
        return results
    options = assembly.options
    by_sweep: dict[str, list[tuple[int, SweepMotion]]] = defaultdict(list)
    for number, camera in enumerate(cameras):
        for motion in camera.result.motions:
            by_sweep[camera.sweeps[motion.frame]].append((number, motion))
    shared: dict[int, dict[str, CommonMotion]] = defaultdict(dict)
    reasons: dict[int, Reason] = {}
    for its in by_sweep.values():
        if len({number for number, _ in its}) < 2:
            continue
        common = CommonMotion.of([motion for _, motion in its], motion_prior_of(options))
        for number, motion in its:
            shared[number][motion.frame] = common
            if not common.consistent:
                reasons.setdefault(number, _contradiction(its, cameras))
    for number, motions in shared.items():
        if number not in reasons:
            results[number] = _solved_again(number, cameras[number].result, motions, assembly, solve)
    for number, reason in reasons.items():
        results[number] = replace(results[number], verdict=results[number].verdict.having(reason))
    return results


def _solved_again(
    number: int, result: Result, motions: Mapping[str, CommonMotion], assembly: Assembly, solve: Solve
) -> Result:
    """Return the result of a camera whose sweeps are compensated for known motions."""
    prior = motion_prior_of(assembly.options)
    reported = [
        motions[motion.frame].reported(motion, prior) if motion.frame in motions else motion
        for motion in result.motions
    ]
    known = compensated(assembly.options, reported)
    assert isinstance(assembly.calibrator, Pipeline)
    twists = {motion.frame: np.array(motion.twist) for motion in reported}
    again = replace(assembly, calibrator=replace(assembly.calibrator, options=known), options=known, twists=twists)
    solved = solve(number, again)
    if solved.status.solved:
        return replace(solved, motions=tuple(reported))
    text = f"with the motion that all cameras have in common there is no result ({solved.reason}): its own is used"
    return replace(result, warnings=(*result.warnings, text))


def compensated(options: PipelineOptions, motions: Sequence[SweepMotion]) -> PipelineOptions:
    """Return the options for sweeps that are compensated for these motions: what is left has their deviations."""
    if not motions:
        return options
    remaining = {
        "speed_m_s": 0.0,
        "speed_sigma_m_s": max(motion.speed_sigma for motion in motions),
        "turn_sigma_deg_s": max(motion.turn_sigma for motion in motions),
    }
    return PipelineOptions.model_validate(options.model_dump() | remaining)


def _contradiction(its: Sequence[tuple[int, SweepMotion]], cameras: Sequence[CameraSweeps]) -> Reason:
    parts = [
        f"{cameras[number].camera} {motion.speed_m_s:.1f} +- {motion.speed_sigma:.1f} m/s and "
        f"{motion.turn_deg_s:.1f} +- {motion.turn_sigma:.1f} deg/s"
        for number, motion in its
    ]
    text = f"cameras contradict each other on the motion during one sweep ({its[0][1].frame}): " + ", ".join(parts)
    return Reason(Doubt.CONTRADICTION, text)


def _sweep_key(frame: Frame) -> str:
    """Return a key of the measured points of a frame: frames of several cameras share the sweep, not its times."""
    return hashlib.blake2b(np.ascontiguousarray(frame.cloud.xyz).tobytes(), digest_size=16).hexdigest()
