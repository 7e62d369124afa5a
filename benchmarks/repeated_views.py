"""Joint calibrations to which frames of one view are added: how far the pose moves, and whether a wrong one is trusted.

    python benchmarks/repeated_views.py

Distinct frames of a drive are calibrated jointly, and again with many frames of one view added, as of a vehicle that
waits: copies of one real frame (KITTI raw, drive 0005 later, every 1st, 2nd and 4th ring), or frames of a simulated rig
at rest, with noise of their own. The pose should move by less than its predicted error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from limits_and_tables import START_DEG, START_M, is_wrong
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import PoseError, pose_error
from p2o.results.result import Result
from rigs import Rig, Sample, rig_of

COPIES = 25
FEATURES = Path("build/repeated-views")


@dataclass(frozen=True, eq=False)
class Case:
    """Frames of distinct views, frames of one view, and the rig of both."""

    name: str
    rig: Rig
    distinct: Sequence[Sample]
    still: Sequence[Sample]


@dataclass(frozen=True)
class Outcome:
    """A joint result with its error."""

    result: Result
    error: PoseError

    @property
    def false_accept(self) -> bool:
        """Whether the result is trusted and has a large error."""
        return self.result.verdict.trusted and is_wrong(self.error.rotation_deg, self.error.translation_m)

    def __str__(self) -> str:
        trusted = "yes" if self.result.verdict.trusted else "no"
        return f"{self.error.rotation_deg:11.3f}{100 * self.error.translation_m:6.1f}{trusted:>6}"


def cases() -> Iterator[Case]:
    """Yield the cases."""
    for name in ("drive-hdl64", "drive-32-rings", "drive-16-rings"):
        for weights in ("free", "kitti"):
            rig = replace(rig_of(name), weights=weights)
            frames = rig.samples(FEATURES, most=14)
            for at in (2, 7, 12):
                yield Case(f"{name} {weights} frame {at}", rig, frames, [frames[at]] * COPIES)
    for lidar in ("vlp-16", "hdl-32e", "hdl-64e"):
        for place in ("street", "traffic"):
            data = f"synthetic:?right=false&lidar={lidar}&place={place}&width_px=800&height_px=300"
            for weights in ("free", "kitti"):
                moving = Rig("moving", f"{data}&scenes=10&seed=11", weights=weights)
                frames = moving.samples(FEATURES)
                for seed in (1, 2, 3):
                    still = f"{data}&scenes=1&frames_per_scene=12&period_s=1&speed_m_s=0&seed={seed}"
                    stop = replace(moving, data=still).samples(FEATURES)
                    yield Case(f"{lidar} {place} {weights} stop {seed}", moving, frames, stop)


def solved(rig: Rig, frames: Sequence[Sample]) -> Outcome:
    """Calibrate frames jointly from an initial guess with an error of 2 deg and 15 cm."""
    truth = frames[0].truth
    start = wrong_start(truth, START_DEG, START_M, np.random.default_rng(0))
    views = [replace(sample.view, name=f"{number}") for number, sample in enumerate(frames)]
    result = rig.plan.calibrator().solve(views, start)
    return Outcome(result, pose_error(result.camera_from_lidar, truth))


def main() -> None:
    """Print one line for each case, and the counts."""
    print(f"{'case':38}{'alone: deg':>11}{'cm':>6}{'trust':>6}{'added: deg':>11}{'cm':>6}{'trust':>6}", end="")
    print(f"{'moved: deg':>11}{'cm':>6}{'95 %: deg':>10}{'cm':>6}")
    before: dict[tuple[str, str], Outcome] = {}
    within, false, count = 0, 0, 0
    for case in cases():
        key = (case.rig.data, case.rig.weights)
        if key not in before:
            before[key] = solved(case.rig, case.distinct)
        alone, added = before[key], solved(case.rig, [*case.distinct, *case.still])
        moved = pose_error(added.result.camera_from_lidar, alone.result.camera_from_lidar)
        bound = added.result.accuracy
        limits = (bound.rotation_deg_95, bound.translation_m_95) if bound is not None else (np.inf, np.inf)
        count, false = count + 1, false + (added.false_accept and not alone.false_accept)
        within += moved.rotation_deg <= limits[0] and moved.translation_m <= limits[1]
        figures = f"{moved.rotation_deg:11.3f}{100 * moved.translation_m:6.1f}{limits[0]:10.3f}{100 * limits[1]:6.1f}"
        print(f"{case.name:38}{alone}{added}{figures}", flush=True)
    print(f"{within} of {count} moved by less than the 95 % bound; {false} became false accepts")


if __name__ == "__main__":
    main()
