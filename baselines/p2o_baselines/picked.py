"""Calibrate from manually picked points, `--calibrator picked`, after Scaramuzza, Harati and Siegwart 2007.

In the paper, a person picks corners in a bearing-angle image of the sweep and in the camera image; the pose follows
from the pairs by a perspective-n-point method, refined by Levenberg-Marquardt on the angles between the two rays of
each pair. `p2o pick` provides both images.

Ours: three-point poses with RANSAC (the paper has no outlier rejection); angles weighted by the scale of the image at
each pick, so that residuals are in pixels; outliers are excluded and reported; the covariance is the spread of the
poses in leave-one-out. Points on a line or in a plane are refused. Pairs of several frames (`--joint`) give one pose.
The initial extrinsic is not used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o import Float, field, solving
from p2o.reading import expanded
from p2o.solving import PickedFrame, PickedPairs, PickedPose, Rival, Verdict, picks_off_px, read_pairs, solve_picks

EXAMPLE = Path(__file__).with_name("picked-example.yaml")
"""Pairs of the first frame of `synthetic:` with noise of 1.5 px and 1 cm; two of twelve are wrong."""

_MOST_OFF, _MOST_OFF_PX = 4.0, 4.0  # a pick is reported whose error predicted by the others exceeds both
_TRIALS = 500  # triples of picks that are tried, at most


class PickedOptions(p2o.Options):
    """Options of `picked`."""

    pairs: str = field("example", help="File of picked pairs, YAML or JSON, of `p2o pick`; example: of `synthetic:`.")
    reach_px: float = field(10.0, gt=0, le=1000, help="Largest residual of an inlier, in pixels.")
    seed: int = field(0, ge=0, help="Seed of the sampled triples.")


@dataclass(frozen=True)
class Picked:
    """The calibrator: `frames` are all pairs of the file by name of frame."""

    options: PickedOptions
    frames: Mapping[str, PickedPairs]

    def prepare(self, frame: p2o.Frame) -> PickedFrame:
        """Return the pairs of a frame, empty if the file has none, and its camera."""
        return PickedFrame(frame.name, frame.camera, self.frames.get(frame.name, PickedPairs.none()))

    def solve(self, prepared: Sequence[PickedFrame], camera_from_lidar: Float) -> p2o.Result:
        """Return the pose that all pairs give together."""
        options = self.options
        solved = solve_picks(prepared, reach_px=options.reach_px, trials=_TRIALS, seed=options.seed)
        reason, names = solved.reason, tuple(frame.name for frame in prepared)
        if not any(len(frame.pairs) for frame in prepared):
            known = ", ".join(list(self.frames)[:3]) or "none"
            reason = f"{options.pairs} has no picks of {names[0]}; it has of: {known}"
        result = p2o.Result(
            names,
            camera_from_lidar,
            camera_from_lidar if solved.camera_from_lidar is None else solved.camera_from_lidar,
            solved.status,
            reason,
            matches={"picks": int(solved.agrees.sum())},
            warnings=tuple(_remarks(solved, prepared)),
        )
        if solved.camera_from_lidar is None:
            return result
        before = picks_off_px(prepared, camera_from_lidar)[solved.agrees]
        return replace(
            result,
            covariance=solved.covariance,
            accuracy=solved.accuracy,
            residual_px=dict(zip(_names(solved), solved.off_px.tolist(), strict=True)),
            judged=solving.Judged("picks", "px", float(np.sqrt((before**2).mean())), solved.rms_px),
            **_rivalry(solved),
        )


def _names(solved: PickedPose) -> list[str]:
    """Return the name of each pick: its number, after the name of its frame if there are several frames."""
    several, count, names = len(solved.frames) > 1, dict.fromkeys(range(len(solved.frames)), 0), []
    for frame in solved.frame_of.tolist():
        count[frame] += 1
        names.append(f"{solved.frames[frame]} pick {count[frame]}" if several else f"pick {count[frame]}")
    return names


def _remarks(solved: PickedPose, prepared: Sequence[PickedFrame]) -> list[str]:
    """Return a line for each pick that is an outlier or that the others contradict."""
    places = np.concatenate([frame.pairs.uv for frame in prepared])
    typical, lines = float(np.median(solved.left_out_px[solved.agrees])) if solved.agrees.any() else 0.0, []
    rows = zip(_names(solved), places, solved.off_px, solved.left_out_px, solved.agrees, strict=True)
    for name, (u, v), off, alone, agrees in rows:
        at = f"{name} at ({u:.1f}, {v:.1f})"
        if not agrees and np.isfinite(off):
            lines.append(f"{at} is {off:.1f} px off" + (", an outlier" if solved.camera_from_lidar is not None else ""))
        elif alone > max(_MOST_OFF * typical, _MOST_OFF_PX):
            lines.append(f"{at} is {alone:.1f} px off in the pose of the other picks: check it")
    return lines


def _rivalry(solved: PickedPose) -> dict[str, Any]:
    """Return the fields of a result that describe a second pose which fits the picks."""
    if solved.rival is None or solved.camera_from_lidar is None:
        return {}
    pose, rms_px = solved.rival
    step = p2o.se3.inverse(pose) @ solved.camera_from_lidar
    away = p2o.se3.angle_deg(step), p2o.se3.distance_m(step)
    rival = Rival(rms_px - solved.rms_px, "px", *away)
    text = f"another pose, {away[0]:.2f} deg and {away[1]:.2f} m away, fits the picks nearly as well"
    return {"rival": rival, "verdict": Verdict((solving.Reason(solving.Doubt.RIVAL_POSE, text),))}


def build(options: PickedOptions) -> p2o.Calibrator:
    """Return the calibrator; the file is read here. Raises InputError if it is invalid."""
    return Picked(options, read_pairs(_pairs_file(options)))


def _pairs_file(options: PickedOptions) -> Path:
    return EXAMPLE if options.pairs == "example" else expanded(options.pairs)


METHOD = p2o.Method(
    name="picked",
    build=build,
    data_files=lambda options: [_pairs_file(options)],
    options=PickedOptions,
    summary="Manually picked pairs of pixels and LiDAR points: RANSAC, angular least squares, jackknife covariance.",
    cite="Scaramuzza, Harati and Siegwart, Extrinsic self calibration of a camera and a 3D laser range finder from "
    "natural scenes, IROS 2007",
    example=p2o.Example("synthetic:", "5deg 0.5m", "0.3deg 0.06m"),
)
