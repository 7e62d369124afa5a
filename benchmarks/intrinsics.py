"""Measure whether wrong intrinsics are noticed: false accepts, false accusations, and how well the error is named.

    python benchmarks/intrinsics.py [--rigs street:hdl-64e ...] [--seeds 1 2] [--frames 10] [--out FILE.json]
    python benchmarks/intrinsics.py --data kitti-raw:PATH ... [--seeds 1 2] [--frames 10]

Every rig is a simulated drive with exact ground truth (scenes of the place with the LiDAR), calibrated jointly from an
initial error of 1 deg and 10 cm, with the true camera and with wrong ones: the focal length 1, 3 and 5 % too long or
too short, the principal point 10 and 30 px off, a radial distortion that the calibration lacks. Features are extracted
once. Printed by kind of error: n, results that are trusted although the error exceeds the 95 % bound (false accepts of
the bound) or 1 deg or 30 cm, results in which the camera is in doubt, in which the wrong parameter is named, and in
which all four parameters are within 1.96 of their standard deviations; the median errors as given and with
`pipeline.camera=refine`.

With `--data`, the rigs are real drives whose camera is taken as correct: successive frames of one folder, without
overlap, at most `--frames` and at least five jointly, with the camera as given and with the errors in `REAL_CASES`.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from p2o import Registry
from p2o.arrays import Float
from p2o.calibration.options import PipelineOptions
from p2o.frames.frame import Frame
from p2o.geometry.perturb import parse_perturbation
from p2o.geometry.pose_error import pose_error
from p2o.geometry.radial_error import RadialError
from p2o.results.result import Result
from p2o.results.verdict import Doubt
from p2o.run.assembly import Assembly
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe, open_dataset

RIGS = ("street:hdl-64e", "suburb:hdl-64e", "highway:hdl-64e", "street:os1-64", "suburb:os1-64", "yard:hdl-64e")
CASES: dict[str, tuple[RadialError, ...]] = {
    "correct": (RadialError(),),
    "focal length 1 %": (RadialError(focal=0.01), RadialError(focal=-0.01)),
    "focal length 3 %": (RadialError(focal=0.03), RadialError(focal=-0.03)),
    "focal length 5 %": (RadialError(focal=0.05), RadialError(focal=-0.05)),
    "principal point x 10 px": (RadialError(x_px=10.0), RadialError(x_px=-10.0)),
    "principal point x 30 px": (RadialError(x_px=30.0), RadialError(x_px=-30.0)),
    "principal point y 10 px": (RadialError(y_px=10.0), RadialError(y_px=-10.0)),
    "principal point y 30 px": (RadialError(y_px=30.0), RadialError(y_px=-30.0)),
    "radial distortion 0.05": (RadialError(radial=0.05), RadialError(radial=-0.05)),
    "radial distortion 0.19": (RadialError(radial=0.19), RadialError(radial=-0.19)),
}
REAL_CASES = ("correct", "focal length 3 %", "principal point x 10 px")
LEAST_FRAMES = 5
INITIAL = parse_perturbation("1deg 0.1m")


@dataclass(frozen=True)
class Row:
    """One calibration: the rig, the kind of error, and what the result states."""

    rig: str
    seed: int
    case: str
    trusted: bool
    in_doubt: bool
    wrong: tuple[str, ...]
    within: bool
    rotation_deg: float
    translation_m: float
    bound_deg: float
    bound_m: float
    refined_deg: float
    refined_m: float

    @property
    def false_accept(self) -> bool:
        """Whether the result is trusted and its error exceeds 1 deg or 30 cm."""
        return self.trusted and (self.rotation_deg > 1.0 or self.translation_m > 0.3)

    @property
    def outside(self) -> bool:
        """Whether the result is trusted and its error exceeds the 95 % bound."""
        return self.trusted and (self.rotation_deg > self.bound_deg or self.translation_m > self.bound_m)


def rows_of(rig: str, seed: int, frames: int) -> Iterator[Row]:
    """Yield the rows of one rig."""
    place, lidar = rig.split(":")
    registry = Registry.load()
    dataset = open_dataset(f"synthetic:?scenes={frames}&place={place}&lidar={lidar}&seed={seed}&right=false", registry)
    yield from _rows(rig, seed, _pipeline(registry), [dataset[number] for number in range(frames)], CASES)


def rows_of_drives(data: str, seed: int, frames: int) -> Iterator[Row]:
    """Yield the rows of all groups of successive frames of one folder of a data set."""
    registry = Registry.load()
    dataset, pipeline, drives = open_dataset(data, registry), _pipeline(registry), defaultdict(list)
    for number, name in enumerate(dataset.names):
        drives[name.rpartition("/")[0]].append(number)
    for drive, numbers in drives.items():
        for first in range(0, len(numbers), frames):
            group = numbers[first : first + frames]
            if len(group) >= LEAST_FRAMES:
                its = [dataset[number] for number in group]
                yield from _rows(f"{drive}:{len(group)}", seed, pipeline, its, REAL_CASES)


def _pipeline(registry: Registry) -> Pipeline:
    assembly = Assembly.of(Recipe.of(data=None, joint=True).resolve(registry).parts, PipelineOptions())
    assert isinstance(assembly.calibrator, Pipeline)
    return assembly.calibrator


def _rows(rig: str, seed: int, pipeline: Pipeline, frames: Sequence[Frame], cases: Iterable[str]) -> Iterator[Row]:
    """Yield the rows of frames that are calibrated jointly."""
    truth = frames[0].camera_from_lidar
    assert truth is not None
    views = [pipeline.prepare(frame) for frame in frames]
    start = INITIAL.start(truth, np.random.default_rng([seed, 0]))
    for case in cases:
        for error in CASES[case]:
            wrong = [replace(view, camera=error.corrected(view.camera)) for view in views]
            result = pipeline.solve(wrong, start)
            refine = replace(pipeline, options=pipeline.options.model_copy(update={"camera": "refine"}))
            yield _row(rig, seed, case, error, truth, result, refine.solve(wrong, start))


def _row(rig: str, seed: int, case: str, error: RadialError, truth: Float, result: Result, refined: Result) -> Row:
    off, after = (pose_error(r.camera_from_lidar, truth) for r in (result, refined))
    [check] = result.cameras or [None]
    within = False
    if check is not None:
        expected = (1 / (1 + error.focal) - 1, -error.radial, -error.x_px, -error.y_px)
        values = (check.focal, check.radial, check.x_px, check.y_px)
        sigmas = (check.focal_sigma, check.radial_sigma, check.x_sigma_px, check.y_sigma_px)
        within = all(abs(v - e) < 1.96 * s for v, e, s in zip(values, expected, sigmas, strict=True))
    accuracy = result.accuracy
    return Row(
        rig,
        seed,
        case,
        result.verdict.trusted,
        any(reason.doubt is Doubt.CAMERA for reason in result.verdict.reasons),
        () if check is None else check.wrong,
        within,
        off.rotation_deg,
        off.translation_m,
        np.inf if accuracy is None else accuracy.rotation_deg_95,
        np.inf if accuracy is None else accuracy.translation_m_95,
        after.rotation_deg,
        after.translation_m,
    )


def table(rows: Sequence[Row]) -> str:
    """Return the figures by kind of error as a table in Markdown."""
    by_case: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        by_case[row.case].append(row)
    lines = [
        "| error of the intrinsics | n | trusted | trusted, over 1 deg or 30 cm | trusted, outside the 95 % bound |"
        " camera in doubt | parameter named | all within 1.96 sigma | median error | with `camera=refine` |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for case, its in by_case.items():
        named = sum(any(case.startswith(name) for name in row.wrong) for row in its)
        median = [float(np.median([getattr(row, name) for row in its])) for name in
                  ("rotation_deg", "translation_m", "refined_deg", "refined_m")]  # fmt: skip
        counts = [
            len(its),
            sum(row.trusted for row in its),
            sum(row.false_accept for row in its),
            sum(row.outside for row in its),
            sum(row.in_doubt for row in its),
            named if case != "correct" else "-",
            sum(row.within for row in its),
        ]
        errors = [f"{d:.2f} deg, {100 * m:.1f} cm" for d, m in (median[:2], median[2:])]
        lines.append(f"| {case} | {' | '.join(map(str, counts))} | {' | '.join(errors)} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Calibrate all rigs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", nargs="+", default=list(RIGS), metavar="PLACE:LIDAR")
    parser.add_argument("--data", nargs="+", metavar="DATASET:PATH", help="real drives instead of the rigs")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--out", type=Path, help="write the rows as JSON")
    options = parser.parse_args(arguments)
    rows = []
    for rig in options.data or options.rigs:
        for seed in options.seeds:
            rows += list((rows_of_drives if options.data else rows_of)(rig, seed, options.frames))
            print(f"{rig} {seed}: {len(rows)} results", file=sys.stderr, flush=True)
            if options.out is not None:
                options.out.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    print(table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
