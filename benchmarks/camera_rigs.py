"""Compare a calibration of the edges of all cameras of a rig with the mean of the cameras: docs/how-to/rig.md.

    python benchmarks/camera_rigs.py [--lidar vlp-16 ...] [--place street ...] [--moments 3] [--guesses 2]
        [--nuscenes build/data/rigs/nuscenes]

Simulated rigs have four cameras (front, left, right, back; 800x500 px) and one sweep; every moment is a rig of its own.
The six cameras of nuScenes took their images at different times from a car at 9.3 m/s. The initial guess of the LiDAR
on the body, one for all cameras, is 2 deg and 15 cm off, seeds 0, 1, ... Printed are mean and median errors of
body_from_lidar, how many results are trusted, of these false accepts (over 1 deg or 30 cm) and results within the 67 %
and the 95 % bound, and seconds of the common calibration.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Frame, Registry
from p2o.arrays import Float
from p2o.confidence.fusion import rig_result
from p2o.geometry.perturb import parse_perturbation
from p2o.geometry.pose_error import PoseError, pose_error
from p2o.results.evidence import Accuracy
from p2o.results.result import RigResult
from p2o.run.assembly import Assembly
from p2o.run.recipe import Recipe
from p2o.run.rig_solve import RigCameraFrames, solve_rig
from p2o.run.run import run

CAMERAS = "front,left,right,back"
FALSE_DEG, FALSE_M = 1.0, 0.3
GUESS = parse_perturbation("2deg 0.15m")
NUSCENES_TWIST = [0, 0, 0, 0, 9.3, 0]
"""Velocity of the car in the frame of the LiDAR, whose y axis is forward, in m/s."""


@dataclass
class Errors:
    """Errors of results with their predicted errors; `refused` are those without a pose."""

    error: list[PoseError] = field(default_factory=list)
    accuracy: list[Accuracy | None] = field(default_factory=list)
    trusted: list[bool] = field(default_factory=list)
    refused: int = 0

    def add(self, pose: Float | None, truth: Float, accuracy: Accuracy | None, *, trusted: bool) -> None:
        """Add a result (4, 4)."""
        if pose is None:
            self.refused += 1
            return
        self.error.append(pose_error(pose, truth))
        self.accuracy.append(accuracy)
        self.trusted.append(trusted)

    def line(self, label: str) -> str:
        """Return the row of the table."""
        turn, shift = np.array([(e.rotation_deg, 100 * e.translation_m) for e in self.error]).reshape(-1, 2).T
        known = [(e, a) for e, a, sure in zip(self.error, self.accuracy, self.trusted, strict=True) if sure and a]
        wrong = sum(e.rotation_deg > FALSE_DEG or e.translation_m > FALSE_M for e, _ in known)
        inside = [sum(_within(e, a, bound) for e, a in known) for bound in ("", "_95")]
        errors = f"{turn.mean():.3f}, {np.median(turn):.3f} | {shift.mean():.1f}, {np.median(shift):.1f}"
        counts = f"{sum(self.trusted)}, {wrong} | {inside[0]}, {inside[1]}"
        return f"| {label} | {len(turn)}, {self.refused} | {errors} | {counts} |"


def _within(error: PoseError, accuracy: Accuracy, bound: str) -> bool:
    turn, shift = (getattr(accuracy, f"{name}{bound}") for name in ("rotation_deg", "translation_m"))
    return bool(error.rotation_deg <= turn and error.translation_m <= shift)


def simulated(lidar: str, place: str, moment: int) -> tuple[str, dict[str, Any]]:
    """Return the data of one moment of a simulated rig, and what its rig file holds."""
    size = "width_px=800&height_px=500"
    data = f"synthetic:?cameras={CAMERAS}&place={place}&lidar={lidar}&scenes=1&seed={71 + moment}&right=false&{size}"
    return data, {}


def nuscenes(folder: Path) -> tuple[str, dict[str, Any]]:
    """Return the data of the real rig, and what its rig file holds."""
    return f"folder:{folder}", {"twist": NUSCENES_TWIST, "cameras": json.loads((folder / "rig.json").read_text())}


def measure(data: str, content: Mapping[str, Any], guesses: int, registry: Registry) -> Iterator[dict[str, Any]]:
    """Yield for each initial guess the run, the mean, the common calibration and its seconds, and the truth."""
    dataset = Recipe.of(data=data).resolve(registry).dataset()
    frames: Sequence[Frame] = [dataset[number] for number in range(len(dataset))]
    rig = dict(content) or {
        "cameras": {f.camera_name: {"camera_from_lidar": f.camera_from_lidar.tolist()} for f in frames}  # type: ignore[union-attr]
    }
    for seed in range(guesses):
        both: dict[str, Any] = {}

        def calibrated(
            assembly: Assembly,
            cameras: Sequence[RigCameraFrames],
            places: Mapping[str, Float],
            both: dict[str, Any] = both,
        ) -> RigResult:
            both["mean"] = rig_result({camera.name: camera.result for camera in cameras}, places)
            began = time.perf_counter()
            both["common"] = solve_rig(assembly, cameras, places)
            both["seconds"] = time.perf_counter() - began
            return both["common"]

        guess = GUESS.start(np.eye(4), np.random.default_rng(seed), seed)
        plan = Recipe.of(data=data, rig={**rig, "body_from_lidar": guess.tolist()}, seed=seed).resolve(registry)
        yield {"run": run(plan, frames, rig_calibration=calibrated), **both}


def table(label: str, rigs: Sequence[tuple[str, Mapping[str, Any]]], guesses: int, registry: Registry) -> list[str]:
    """Return the rows of rigs of one sort: each camera alone, the mean, and the common calibration."""
    kinds = {name: Errors() for name in ("one camera", "mean of the cameras", "all edges at once")}
    alone, mean, common = kinds.values()
    seconds = []
    for data, content in rigs:
        for done in measure(data, content, guesses, registry):
            for row in done["run"].rows:
                result = row.result
                pose = result.camera_from_lidar if result.status.solved else None
                alone.add(pose, row.truth, result.accuracy, trusted=result.verdict.trusted)
            # The body of these rigs is the LiDAR.
            for kind, one in ((mean, done["mean"]), (common, done["common"])):
                kind.add(one.body_from_lidar, np.eye(4), one.accuracy, trusted=one.verdict.trusted)
            seconds.append(done["seconds"])
    lines = [errors.line(f"{label}, {name}") for name, errors in kinds.items()]
    return [*lines[:2], f"{lines[2]} {np.median(seconds):.1f} |"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lidar", nargs="*", default=["vlp-16", "hdl-32e", "hdl-64e"])
    parser.add_argument("--place", nargs="*", default=["street", "hall"])
    parser.add_argument("--moments", type=int, default=3)
    parser.add_argument("--guesses", type=int, default=2)
    parser.add_argument("--nuscenes", type=Path)
    asked = parser.parse_args()
    registry = Registry.load()
    print("| rig | n, refused | rotation deg: mean, median | translation cm | trusted, false | in 67 %, 95 % | s |")
    print("|---|---|---|---|---|---|---|")
    sorts = {
        f"{lidar}, {place}": [simulated(lidar, place, moment) for moment in range(asked.moments)]
        for lidar in asked.lidar
        for place in asked.place
    }
    if asked.nuscenes is not None:
        sorts["nuScenes"] = [nuscenes(asked.nuscenes)]
    for label, rigs in sorts.items():
        print("\n".join(table(label, rigs, asked.guesses, registry)), flush=True)


if __name__ == "__main__":
    main()
