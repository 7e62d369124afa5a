"""Joint calibrations to which frames of one view are added: how far the pose moves, and whether a wrong one is trusted.

    python benchmarks/repeated_views.py --root build/data --kept build/repeated-views

Distinct frames of a drive are calibrated jointly, and again with many frames of one view added, as of a vehicle that
waits: copies of one real frame (KITTI raw, drive 0005 later, every 1st, 2nd and 4th ring), or frames of a simulated rig
at rest, with noise of their own. The pose should move by less than its predicted error.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from p2o.features.view import View
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import PoseError, pose_error
from p2o.results.result import Result
from verdict_rigs import RIGS, Rig, Seen, seen

WRONG_DEG, WRONG_M = 1.0, 0.3
"""A trusted result with a larger error is a false accept."""
COPIES = 25


@dataclass(frozen=True, eq=False)
class Case:
    """Frames of distinct views, frames of one view, and the rig that both are of."""

    name: str
    rig: Rig
    distinct: Sequence[Seen]
    still: Sequence[Seen]


@dataclass(frozen=True)
class Outcome:
    """A joint result with its error and whether it is trusted."""

    result: Result
    error: PoseError

    @property
    def wrong(self) -> bool:
        """Whether the result is trusted and has a large error."""
        large = self.error.rotation_deg > WRONG_DEG or self.error.translation_m > WRONG_M
        return self.result.verdict.trusted and large


def cases(root: str, kept: Path, splits: str, only: str) -> Iterator[Case]:
    """Yield the cases whose names contain `only`."""
    for name in ("drive-hdl64", "drive-32-rings", "drive-16-rings"):
        rig = next(rig for rig in RIGS if rig.name == name)
        rig = replace(rig, data=rig.data.replace("build/data", root))
        for weights in ("kitti", "synthetic"):
            if only not in f"{name} {weights}":
                continue
            its = replace(rig, weights=weights)
            frames = list(seen(its, kept, splits, most=14))
            for at in (2, 7, 12):
                yield Case(f"{name} {weights} frame {at}", its, frames, [frames[at]] * COPIES)
    for lidar in ("vlp-16", "hdl-32e", "hdl-64e"):
        for place in ("street", "traffic"):
            words = f"right=false&lidar={lidar}&place={place}&width_px=800&height_px=300"
            for weights in ("kitti", "synthetic"):
                if only not in f"{lidar} {place} {weights}":
                    continue
                moving = Rig("moving", f"synthetic:?{words}&scenes=10&seed=11", weights=weights)
                frames = list(seen(moving, kept, splits))
                for seed in (1, 2, 3):
                    still = f"synthetic:?{words}&scenes=1&frames_per_scene=12&period_s=1&speed_m_s=0&seed={seed}"
                    yield Case(
                        f"{lidar} {place} {weights} stop {seed}",
                        moving,
                        frames,
                        list(seen(replace(moving, data=still), kept, splits)),
                    )


def solved(rig: Rig, frames: Sequence[Seen], seed: int) -> Outcome:
    """Calibrate frames jointly from an initial guess with an error of 2 deg and 15 cm."""
    truth = frames[0].truth
    start = wrong_start(truth, 2.0, 0.15, np.random.default_rng(seed))
    views: list[View] = [replace(one.view, name=f"{number}") for number, one in enumerate(frames)]
    result = rig.plan.calibrator().solve(views, start)
    return Outcome(result, pose_error(result.camera_from_lidar, truth))


def main() -> None:
    """Print one line for each case, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--root", default="build/data", help="folder of the real frames")
    parser.add_argument("--kept", type=Path, default=Path("build/repeated-views"), help="folder of extracted features")
    parser.add_argument("--splits", default="benchmarks/splits.json", help="file of the splits")
    parser.add_argument("--only", default="", help="only groups whose names contain this: 16-rings kitti")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(f"{'case':38}{'alone: deg':>11}{'cm':>6}{'trust':>6}{'added: deg':>11}{'cm':>6}{'trust':>6}", end="")
    print(f"{'moved: deg':>11}{'cm':>6}{'95 %: deg':>10}{'cm':>6}")
    before: dict[tuple[str, str], Outcome] = {}
    within, wrong, count = 0, 0, 0
    for case in cases(options.root, options.kept, options.splits, options.only):
        key = (case.rig.data, case.rig.weights)
        if key not in before:
            before[key] = solved(case.rig, case.distinct, options.seed)
        alone, added = before[key], solved(case.rig, [*case.distinct, *case.still], options.seed)
        moved = pose_error(added.result.camera_from_lidar, alone.result.camera_from_lidar)
        bound = added.result.accuracy
        count, wrong = count + 1, wrong + (added.wrong and not alone.wrong)
        limits = (bound.rotation_deg_95, bound.translation_m_95) if bound is not None else (np.inf, np.inf)
        within += moved.rotation_deg <= limits[0] and moved.translation_m <= limits[1]
        line = f"{case.name:38}"
        for one in (alone, added):
            line += f"{one.error.rotation_deg:11.3f}{100 * one.error.translation_m:6.1f}"
            line += f"{'yes' if one.result.verdict.trusted else 'no':>6}"
        line += f"{moved.rotation_deg:11.3f}{100 * moved.translation_m:6.1f}{limits[0]:10.3f}{100 * limits[1]:6.1f}"
        print(line, flush=True)
    print(f"{within} of {count} moved by less than the 95 % bound; {wrong} became false accepts")


if __name__ == "__main__":
    main()
