"""Calibrate with boards: detection, assignment, closed form, least squares, covariance, and reasons of refusals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Checkerboard, Float, HoleBoard, Result, Status, se3
from p2o.solving import Judged

from p2o_baselines import target_method
from p2o_baselines.boards.adjustment import Cost, adjusted, covariance_of
from p2o_baselines.boards.board_in_picture import boards_in_picture
from p2o_baselines.boards.board_in_sweep import boards_in_sweep
from p2o_baselines.boards.holes_in_picture import hole_boards_in_picture
from p2o_baselines.boards.holes_in_sweep import hole_boards_in_sweep
from p2o_baselines.boards.pairing import Hypotheses, Pair, Pairing, by_outline, paired
from p2o_baselines.outcome import refused
from p2o_baselines.target_method import Sight, TargetOptions, missing_targets, once_per_sweep, pairing_warnings

_LEAST_TURN_DEG = 5.0  # normals within this angle of one plane leave a direction of the pose unobservable
REMEDY = "add boards with other orientations, or with sides that rings cross"


def sight_of(frame: p2o.Frame, options: TargetOptions) -> Sight:
    """Detect the checkerboards of a frame; the sweep is searched only if the image shows one."""
    targets = [target for target in frame.targets if isinstance(target, Checkerboard)]
    asked = (f"{t.columns} x {t.rows} corners on {t.width_m:g} x {t.height_m:g} m" for t in dict.fromkeys(targets))
    boards = boards_in_picture(frame.image, targets)
    sizes = tuple((board.target.width_m, board.target.height_m) for board in boards)
    patches = once_per_sweep(frame.cloud, boards_in_sweep, sizes, options)
    return Sight(frame.name, ", ".join(asked) or "none", boards, patches)


def hole_sight_of(frame: p2o.Frame, options: TargetOptions) -> Sight:
    """Detect the boards with holes of a frame; the sweep is searched only if the image shows one."""
    targets = [target for target in frame.targets if isinstance(target, HoleBoard)]
    kinds = {(t.width_m, t.height_m, t.holes): t for t in targets}.values()
    asked = ", ".join(f"{len(t.holes)} holes in {t.width_m:g} x {t.height_m:g} m" for t in kinds)
    boards = hole_boards_in_picture(frame.image, targets)
    wanted = tuple(dict.fromkeys(board.target for board in boards if isinstance(board.target, HoleBoard)))
    patches = once_per_sweep(frame.cloud, hole_boards_in_sweep, wanted, options)
    return Sight(frame.name, asked or "none", boards, patches)


@dataclass(frozen=True)
class BoardAlgorithm:
    """The steps in which methods with boards differ.

    At least `least` boards are needed; `planes_only` states that their borders are not used. `closed(pairs, pose)` is
    the closed form from a rough pose (4, 4); `cost(pairs, pose)` the cost to minimise from there, weighted at a pose
    and reweighted `rounds` times. `hypotheses` proposes poses for the assignment of boards; `kept(pairs, pose)` selects
    the pairs that are used after the closed form. `kind` is the name of the target and `feature` what a segment of a
    sweep must show in addition to its outline, for messages; `sight(frame, options)` detects both.
    """

    least: int
    planes_only: bool
    closed: Callable[[Sequence[Pair], Float], Float]
    cost: Callable[[Sequence[Pair], Float], Cost]
    rounds: int = 1
    hypotheses: Hypotheses = by_outline
    kept: Callable[[Sequence[Pair], Float], Sequence[Pair]] = lambda pairs, pose: pairs
    kind: str = "checkerboard"
    feature: str = ""
    sight: Callable[[p2o.Frame, TargetOptions], Sight] = sight_of


def same_cost(residuals: Cost) -> Callable[[Sequence[Pair], Float], Cost]:
    """Return the `cost` of an algorithm whose weights do not depend on pairs and pose."""
    return lambda pairs, pose: residuals


@dataclass(frozen=True)
class BoardMethod:
    """A calibrator with boards: detection, assignment, closed form, least squares and covariance."""

    options: TargetOptions
    algorithm: BoardAlgorithm

    def prepare(self, frame: p2o.Frame) -> Sight:
        """Detect the boards in the image and candidates in the sweep."""
        return self.algorithm.sight(frame, self.options)

    def solve(self, prepared: Sequence[Sight], camera_from_lidar: Float) -> Result:
        """Return the pose that aligns the boards of both sensors."""
        algorithm, start = self.algorithm, np.asarray(camera_from_lidar, np.float64)
        result = target_method.unsolved(prepared, start)
        missing = _missing(prepared, algorithm)
        if missing:
            return refused(result, missing)
        pairing = paired(prepared, start, algorithm.hypotheses)
        if pairing is None or len(pairing.pairs) < algorithm.least:
            return refused(result, _too_few(prepared, pairing, algorithm), Status.TOO_FEW_MATCHES)
        pairs = pairing.pairs
        result = replace(result, matches=_matches(pairs), warnings=_warnings(prepared, pairing))
        degenerate = _degenerate(pairs) if algorithm.planes_only else ""
        if degenerate:
            return refused(result, degenerate, Status.NOT_OBSERVABLE)
        pose = algorithm.closed(pairs, pairing.camera_from_lidar)
        pairs = tuple(algorithm.kept(pairs, pose))
        for _ in range(algorithm.rounds):
            pose = adjusted(pairs, algorithm.cost(pairs, pose), pose)
        cost = algorithm.cost(pairs, pose)
        covariance = covariance_of(pairs, cost, pose)
        before, after = (_off_m(pairs, each) for each in (start, pose))
        return target_method.solved(
            replace(result, matches=_matches(pairs)),
            pose,
            covariance,
            reason=f"points of {len(pairs)} boards are {1000 * after:.1f} mm from their planes (root mean square)",
            judged=Judged("points off boards", "m", before, after),
            remedy=REMEDY,
        )


def _matches(pairs: Sequence[Pair]) -> dict[str, int]:
    return {"boards": len(pairs), "points": sum(len(pair.patch.xyz) for pair in pairs)}


def _missing(sights: Sequence[Sight], algorithm: BoardAlgorithm) -> str:
    """Return why there are no boards to pair; "" if both sensors show some."""
    sizes = {f"{b.target.width_m:g} x {b.target.height_m:g} m" for sight in sights for b in sight.in_image}
    planes = f"an isolated plane of {' or '.join(sorted(sizes))} that three rings cross{algorithm.feature}"
    return missing_targets(sights, algorithm.kind, "a board of {}", f"boards, but no sweep has {planes}")


def _too_few(sights: Sequence[Sight], pairing: Pairing | None, algorithm: BoardAlgorithm) -> str:
    count = 0 if pairing is None else len(pairing.pairs)
    shown = sum(len(sight.in_image) for sight in sights)
    facing = " with different orientations" if algorithm.planes_only else ""
    match = f"{count} of {shown} boards in images match a sweep at one common pose"
    return f"{match}, {algorithm.least} or more{facing} are needed"


def _degenerate(pairs: Sequence[Pair]) -> str:
    """Return why the planes of the boards do not determine the pose; "" if they do."""
    normals = np.array([pair.patch.normal for pair in pairs])
    values = np.linalg.svd(normals, compute_uv=False) / np.sqrt(len(normals))
    least = np.sin(np.radians(_LEAST_TURN_DEG))
    if values[1] < least:
        within = f"{_LEAST_TURN_DEG:g} deg: turn them left, right, up and down"
        return f"all {len(pairs)} boards are parallel within {within}"
    if values[2] < least / 3:
        return f"the normals of all {len(pairs)} boards lie in one plane: tilt some of them the other way too"
    return ""


def _warnings(sights: Sequence[Sight], pairing: Pairing) -> tuple[str, ...]:
    used = {(pair.frame, id(pair.board)) for pair in pairing.pairs}
    unmatched = [s.name for number, s in enumerate(sights) for b in s.in_image if (number, id(b)) not in used]
    return pairing_warnings("board", "boards", sights, unmatched=unmatched, alternatives=len(pairing.others))


def off_m(pose: Float, other: Float) -> float:
    """Return the distance in m between the LiDAR positions of two poses (4, 4)."""
    return float(np.linalg.norm(pose[:3, 3] - other[:3, 3]))


def _off_m(pairs: Sequence[Pair], pose: Float) -> float:
    """Return the root mean square distance in m of the points of sweeps from the planes of images."""
    off = [(se3.apply(pose, pair.patch.xyz) @ pair.board.normal - pair.board.offset_m) for pair in pairs]
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))
