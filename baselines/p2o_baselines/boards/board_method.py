"""A whole method of boards: find, pair, closed form, least squares, likely error, and every refusal in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Accuracy, Result, Status, se3
from p2o.arrays import Float

from p2o_baselines.boards.adjustment import Cost, adjusted, covariance_of
from p2o_baselines.boards.pairing import Hypotheses, Pair, Pairing, by_outline, paired
from p2o_baselines.boards.sight import BoardOptions, Sight, sight_of

_LEAST_TURN_DEG = 5.0
"""Normals that all lie this near to one plane leave a direction open, where only planes are used."""
_RARE = 1.9
"""Nineteen of twenty errors are below so many deviations: 1.96 of one direction, 1.61 of three that are alike."""


@dataclass(frozen=True)
class Way:
    """What is a method's own.

    `least` boards are needed, `planes_only` if borders say nothing. `closed(pairs, rough pose)` is the closed form,
    `cost(pairs, pose)` what is then minimised, with weights as they are at a pose; `rounds` is how often these are
    taken anew. `hypotheses` proposes poses for the choice of pairs; `kept(pairs, pose)` are those that go on after the
    closed form. `kind` is what it looks for and `beside` what else a piece of a sweep has to show, in words;
    `sight(frame, options)` finds that.
    """

    least: int
    planes_only: bool
    closed: Callable[[Sequence[Pair], Float], Float]
    cost: Callable[[Sequence[Pair], Float], Cost]
    rounds: int = 1
    hypotheses: Hypotheses = by_outline
    kept: Callable[[Sequence[Pair], Float], Sequence[Pair]] = lambda pairs, pose: pairs
    kind: str = "checkerboard"
    beside: str = ""
    sight: Callable[[p2o.Frame, BoardOptions], Sight] = sight_of


@dataclass(frozen=True)
class BoardMethod:
    """The whole method, but for what is its own."""

    options: BoardOptions
    way: Way

    def prepare(self, frame: p2o.Frame) -> Sight:
        """Return the boards in the picture and what may be boards in the sweep."""
        return self.way.sight(frame, self.options)

    def solve(self, prepared: Sequence[Sight], camera_from_lidar: Float) -> Result:
        """Return the pose at which the boards of both sensors are the same."""
        options, way, start = self.options, self.way, np.asarray(camera_from_lidar, np.float64)
        blank = Result(tuple(sight.name for sight in prepared), start, start, Status.NO_FEATURES, "")
        nothing = _nothing(prepared, way)
        if nothing:
            return _refused(blank, Status.NO_FEATURES, nothing)
        pairing = paired(prepared, start, way.hypotheses)
        if pairing is None or len(pairing.pairs) < way.least:
            return _refused(blank, Status.TOO_FEW_MATCHES, _too_few(prepared, pairing, way))
        pairs = pairing.pairs
        told = replace(
            blank,
            matches={"boards": len(pairs), "points": sum(len(pair.patch.xyz) for pair in pairs)},
            warnings=_remarks(prepared, pairing),
        )
        flat = _flat(pairs) if way.planes_only else ""
        if flat:
            return _refused(told, Status.NOT_OBSERVABLE, flat)
        pose = way.closed(pairs, pairing.camera_from_lidar)
        pairs = tuple(way.kept(pairs, pose))
        told = replace(told, matches={"boards": len(pairs), "points": sum(len(pair.patch.xyz) for pair in pairs)})
        for _ in range(way.rounds):
            cost = way.cost(pairs, pose)
            pose = adjusted(pairs, cost, pose)
        cost = way.cost(pairs, pose)
        covariance = covariance_of(pairs, cost, pose, range_bias_m=options.range_bias_m, camera_px=options.camera_px)
        remark = unsure(covariance, pose, options)
        if covariance is None or remark:
            return _refused(told, Status.NOT_OBSERVABLE, remark)
        before, after = (_off_m(pairs, each) for each in (start, pose))
        return Result(
            told.frames,
            start,
            pose,
            Status.CONVERGED,
            f"points of {len(pairs)} boards lie {1000 * after:.1f} mm off their planes (root mean square)",
            covariance=covariance,
            accuracy=likely(covariance, pose),
            matches=told.matches,
            judged=p2o.Judged("points off boards", "m", before, after),
            warnings=told.warnings,
        )


def likely(covariance: Float, camera_from_lidar: Float) -> Accuracy:
    """Return how wrong a pose (4, 4) is whose left update has a covariance (6, 6)."""
    axes = by_axis(covariance, camera_from_lidar)
    rotation_deg, translation_m = float(np.degrees(np.linalg.norm(axes[:3]))), float(np.linalg.norm(axes[3:]))
    pitch, yaw, roll = np.degrees(axes[:3]).tolist()
    return Accuracy(
        rotation_deg, translation_m, _RARE * rotation_deg, _RARE * translation_m, roll, pitch, yaw, *axes[3:].tolist()
    )


def by_axis(covariance: Float, camera_from_lidar: Float) -> Float:
    """Return deviations (6,) about the camera's axes in rad and of the LiDAR's place along them in m.

    A turn w about the camera moves the LiDAR at t by w x t, which counts as translation.
    """
    by_update = np.eye(6)
    by_update[3:, :3] = -se3.skew(camera_from_lidar[:3, 3])
    return np.asarray(np.sqrt(np.diag(by_update @ covariance @ by_update.T)))


def _refused(result: Result, status: Status, reason: str) -> Result:
    return Result(
        result.frames,
        result.start,
        result.start,
        status,
        reason,
        matches=result.matches,
        warnings=result.warnings,
    )


def _nothing(sights: Sequence[Sight], way: Way) -> str:
    """Return in words that there are no boards to pair; "" where there are."""
    asked = next((sight.asked for sight in sights if sight.asked != "none"), "none")
    if asked == "none":
        return f"no frame says that it shows a {way.kind}: state it in `targets` of frame.yaml"
    seen = [sight for sight in sights if sight.boards]
    if not seen:
        return f"no picture of {len(sights)} shows a board of {asked}"
    if not any(sight.patches for sight in seen):
        sizes = {f"{b.target.width_m:g} x {b.target.height_m:g} m" for sight in seen for b in sight.boards}
        return (
            f"{len(seen)} of {len(sights)} pictures show boards, but no sweep has a plane piece of "
            f"{' or '.join(sorted(sizes))} that three rings meet and that stands by itself{way.beside}"
        )
    return ""


def _too_few(sights: Sequence[Sight], pairing: Pairing | None, way: Way) -> str:
    count = 0 if pairing is None else len(pairing.pairs)
    shown = sum(len(sight.boards) for sight in sights)
    facing = " that face different ways" if way.planes_only else ""
    return (
        f"{count} of {shown} boards in pictures are found in sweeps by one pose, {way.least} or more{facing} are needed"
    )


def _flat(pairs: Sequence[Pair]) -> str:
    """Return in words that the planes of boards leave a direction open; "" where they do not."""
    normals = np.array([pair.patch.normal for pair in pairs])
    values = np.linalg.svd(normals, compute_uv=False) / np.sqrt(len(normals))
    least = np.sin(np.radians(_LEAST_TURN_DEG))
    if values[1] < least:
        return (
            f"all {len(pairs)} boards are parallel within {_LEAST_TURN_DEG:g} deg: turn them left, right, up and down"
        )
    if values[2] < least / 3:
        return f"the normals of all {len(pairs)} boards lie in one plane: tilt some of them the other way too"
    return ""


def unsure(covariance: Float | None, pose: Float, options: BoardOptions) -> str:
    """Return in words that a pose is too unsure, and in what; "" where it is not."""
    if covariance is None or not np.isfinite(covariance).all():
        return "the boards leave a direction of the pose open: more of them, or sides that rings cross, are needed"
    axes = by_axis(covariance, pose)
    deg, metres = float(np.degrees(axes[:3].max())), float(axes[3:].max())
    if deg > options.worst_deg or metres > options.worst_m:
        return (
            f"the boards tell the pose to {deg:.1f} deg and {metres:.2f} m about and along its worst axes only: "
            "more of them, turned in different ways, are needed"
        )
    return ""


def _remarks(sights: Sequence[Sight], pairing: Pairing) -> tuple[str, ...]:
    """Return what is worth a line: boards that were found by one sensor alone, and poses that fit as well."""
    lines = []
    used = {(pair.frame, id(pair.board)) for pair in pairing.pairs}
    alone = [s.name for number, s in enumerate(sights) for b in s.boards if (number, id(b)) not in used]
    if alone:
        lines.append(f"boards in pictures that no sweep shows at this pose: {', '.join(alone[:5])} ({len(alone)})")
    none = [sight.name for sight in sights if not sight.boards]
    if none:
        lines.append(f"pictures in which no board is found: {', '.join(none[:5])} ({len(none)})")
    if pairing.others:
        lines.append(f"{1 + len(pairing.others)} poses fit the boards about as well: the nearest to the start is taken")
    return tuple(lines)


def off_m(pose: Float, other: Float) -> float:
    """Return how far apart in m two poses (4, 4) put the LiDAR."""
    return float(np.linalg.norm(pose[:3, 3] - other[:3, 3]))


def _off_m(pairs: Sequence[Pair], pose: Float) -> float:
    """Return the root mean square distance in m of the points of sweeps from the planes of pictures."""
    off = [(se3.apply(pose, pair.patch.xyz) @ pair.board.normal - pair.board.offset_m) for pair in pairs]
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))
