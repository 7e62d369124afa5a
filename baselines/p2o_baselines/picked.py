"""Points that a person picked in image and sweep, `--calibrator picked`, after Scaramuzza, Harati and Siegwart 2007.

The paper shows the sweep as a bearing-angle image, in which a person finds the corners that the camera sees, and takes
the pose from pairs of points by a perspective-n-point method, refined by Levenberg-Marquardt on the angles between the
two rays of each pair. So does this, with `p2o pick` for the picture and the clicks.

Ours: three-point poses with RANSAC (the paper trusts its picks); angles weighted by the scale of the image at each
pick, so that they are pixels; picks that do not agree are left out and told; every pick is left out in turn, and the
spread of the poses is the covariance. Points on a line or in a plane are refused. Pairs of several frames taken
together (`--joint`) give one pose. The start is not used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.picks.pairs import Pairs, read_pairs
from p2o.picks.solve import PickedFrame, Solved, picks_off_px, solve_picks

EXAMPLE = Path(__file__).with_name("picked-example.yaml")
"""Pairs of the first frame of `synthetic:`, 1.5 px and 1 cm beside the truth, two of twelve wrong."""

_ODD, _ODD_PX = 4.0, 4.0
"""A pick is told of that the others put so many times as far off as is usual, and so many pixels at least."""


class PickedOptions(p2o.Options):
    """Options of `picked`."""

    pairs: str = p2o.field(
        "example", help="File of picked pairs, YAML or JSON (`p2o pick` writes it); example: those of `synthetic:`."
    )
    reach_px: float = p2o.field(10.0, gt=0, le=1000, help="Picks that are off by more pixels than this are left out.")
    trials: int = p2o.field(500, ge=1, le=100_000, help="Triples of picks that are tried, at most.")
    seed: int = p2o.field(0, ge=0, help="Seed of the triples, where there are more.")


@dataclass(frozen=True)
class Picked:
    """The whole method: `frames` are all pairs of the file by name of frame."""

    options: PickedOptions
    frames: Mapping[str, Pairs]

    def prepare(self, frame: p2o.Frame) -> PickedFrame:
        """Return the pairs of a frame, none where the file has none, and its camera."""
        return PickedFrame(frame.name, frame.camera, self.frames.get(frame.name, Pairs.none()))

    def solve(self, prepared: Sequence[PickedFrame], camera_from_lidar: Float) -> p2o.Result:
        """Return the pose that all pairs give together."""
        options = self.options
        solved = solve_picks(prepared, reach_px=options.reach_px, trials=options.trials, seed=options.seed)
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
            judged=p2o.Judged("picks", "px", float(np.sqrt((before**2).mean())), solved.rms_px),
            **_rivalry(solved),
        )


def _names(solved: Solved) -> list[str]:
    """Return what each pick is called: its number, after the name of its frame where there are several."""
    several, count, names = len(solved.frames) > 1, dict.fromkeys(range(len(solved.frames)), 0), []
    for frame in solved.frame_of.tolist():
        count[frame] += 1
        names.append(f"{solved.frames[frame]} pick {count[frame]}" if several else f"pick {count[frame]}")
    return names


def _remarks(solved: Solved, prepared: Sequence[PickedFrame]) -> list[str]:
    """Return a line for each pick that was left out, or that the others contradict."""
    places = np.concatenate([frame.pairs.uv for frame in prepared])
    typical, lines = float(np.median(solved.left_out_px[solved.agrees])) if solved.agrees.any() else 0.0, []
    for name, (u, v), off, alone, agrees in zip(
        _names(solved), places, solved.off_px, solved.left_out_px, solved.agrees, strict=True
    ):
        at = f"{name} at ({u:.1f}, {v:.1f})"
        if not agrees and np.isfinite(off):
            lines.append(f"{at} is {off:.1f} px off" + (", left out" if solved.camera_from_lidar is not None else ""))
        elif alone > max(_ODD * typical, _ODD_PX):
            lines.append(f"{at} is {alone:.1f} px off by the other picks alone: look at it again")
    return lines


def _rivalry(solved: Solved) -> dict[str, object]:
    """Return the fields of a result that tell of another pose which the picks may show as well."""
    if solved.rival is None or solved.camera_from_lidar is None:
        return {}
    pose, rms_px = solved.rival
    step = p2o.se3.inverse(pose) @ solved.camera_from_lidar
    away = p2o.se3.angle_deg(step), p2o.se3.distance_m(step)
    rival = p2o.Rival(rms_px - solved.rms_px, "px", *away)
    text = f"another pose, {away[0]:.2f} deg and {away[1]:.2f} m away, fits the picks nearly as well; pick more points"
    return {"rival": rival, "verdict": p2o.Verdict((p2o.Reason(p2o.Doubt.RIVAL_POSE, text),))}


def build(options: PickedOptions) -> p2o.Calibrator:
    """Return the calibrator; the file is read here. Raises InputError if it cannot be."""
    return Picked(options, read_pairs(EXAMPLE if options.pairs == "example" else options.pairs))


METHOD = p2o.Method(
    name="picked",
    build=build,
    options=PickedOptions,
    summary="Pixels and LiDAR points that a person paired: RANSAC, least squares on angles, leave-one-out spread.",
    cite="Scaramuzza, Harati and Siegwart, Extrinsic self calibration of a camera and a 3D laser range finder from "
    "natural scenes, IROS 2007",
    example=p2o.Example("synthetic:", "5deg 0.5m", "0.3deg 0.06m"),
)
