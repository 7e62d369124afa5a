"""Measure whether wrong intrinsics are detected: false accepts, false alarms, and whether the error is named.

    python benchmarks/intrinsics.py [--seeds 1 2]
    python benchmarks/intrinsics.py --data kitti-raw:PATH ... [--seeds 1 2]

Every rig is a simulated drive with exact ground truth (ten scenes of the place with the LiDAR), calibrated jointly from
an initial error of 1 deg and 10 cm, with the true camera and with wrong ones: the focal length 1, 3 and 5 % too long or
too short, the principal point shifted by 10 and 30 px, a radial distortion that the calibration lacks. Features are
extracted once. Printed by kind of error: n, results that are trusted although the error exceeds 1 deg or 30 cm, or the
95 % bound, results in which the camera is in doubt, in which the wrong parameter is named, and in which all four
parameters are within 1.96 of their standard deviations; the median errors as given and with `pipeline.camera=refine`.

With `--data`, the rigs are real drives whose camera is taken as correct: successive frames of one folder, without
overlap, five to ten jointly, with the camera as given and with the errors in `REAL_CASES`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from limits_and_tables import grouped, is_wrong, size, table
from p2o import Registry
from p2o.frames.frame import Frame
from p2o.geometry.perturb import parse_perturbation
from p2o.geometry.pose_error import PoseError, pose_error
from p2o.geometry.radial_error import RadialError
from p2o.results.result import Result
from p2o.results.verdict import Doubt
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe, open_dataset

RIGS = ("street:hdl-64e", "suburb:hdl-64e", "highway:hdl-64e", "street:os1-64", "suburb:os1-64", "yard:hdl-64e")


def _both(**error: float) -> tuple[RadialError, RadialError]:
    return RadialError(**error), RadialError(**{name: -value for name, value in error.items()})


CASES: dict[str, tuple[RadialError, ...]] = {
    "correct": (RadialError(),),
    **{f"focal length {percent} %": _both(focal=percent / 100) for percent in (1, 3, 5)},
    **{f"principal point x {px} px": _both(x_px=px) for px in (10, 30)},
    **{f"principal point y {px} px": _both(y_px=px) for px in (10, 30)},
    **{f"radial distortion {radial}": _both(radial=radial) for radial in (0.05, 0.19)},
}
REAL_CASES = ("correct", "focal length 3 %", "principal point x 10 px")
LEAST_FRAMES, FRAMES = 5, 10
INITIAL = parse_perturbation("1deg 0.1m")
HEAD = (
    "error of the intrinsics", "n", "trusted", "trusted, over 1 deg or 30 cm", "trusted, outside the 95 % bound",
    "camera in doubt", "parameter named", "all within 1.96 sigma", "median error", "with `camera=refine`"
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Row:
    """A calibration with an error of the intrinsics: its result and error, and the error with a refined camera."""

    case: str
    intrinsics: RadialError
    result: Result
    error: PoseError
    refined: PoseError

    @property
    def false_accept(self) -> bool:
        """Whether the result is trusted and its error exceeds 1 deg or 30 cm."""
        return self.result.verdict.trusted and is_wrong(self.error.rotation_deg, self.error.translation_m)

    @property
    def outside(self) -> bool:
        """Whether the result is trusted and its error exceeds the 95 % bound."""
        bound = self.result.accuracy
        if bound is None or not self.result.verdict.trusted:
            return False
        error = self.error
        return error.rotation_deg > bound.rotation_deg_95 or error.translation_m > bound.translation_m_95

    @property
    def in_doubt(self) -> bool:
        """Whether the verdict doubts the camera."""
        return any(reason.doubt is Doubt.CAMERA for reason in self.result.verdict.reasons)

    @property
    def named(self) -> bool:
        """Whether the result names the wrong parameter."""
        return any(self.case.startswith(name) for check in self.result.cameras for name in check.wrong)

    @property
    def within(self) -> bool:
        """Whether all parameters are within 1.96 of their standard deviations."""
        error = self.intrinsics
        expected = (1 / (1 + error.focal) - 1, -error.radial, -error.x_px, -error.y_px)
        for check in self.result.cameras:
            values = (check.focal, check.radial, check.x_px, check.y_px)
            sigmas = (check.focal_sigma, check.radial_sigma, check.x_sigma_px, check.y_sigma_px)
            return all(abs(v - e) < 1.96 * s for v, e, s in zip(values, expected, sigmas, strict=True))
        return False


def simulated(rig: str, seed: int, registry: Registry) -> list[Frame]:
    """Return the frames of a simulated drive."""
    place, lidar = rig.split(":")
    data = f"synthetic:?scenes={FRAMES}&place={place}&lidar={lidar}&seed={seed}&right=false"
    return list(open_dataset(data, registry))


def real(data: str, registry: Registry) -> Iterator[list[Frame]]:
    """Yield the groups of successive frames of each folder of a data set."""
    dataset = open_dataset(data, registry)
    for numbers in grouped(range(len(dataset)), lambda number: dataset.names[number].rpartition("/")[0]).values():
        for first in range(0, len(numbers) - LEAST_FRAMES + 1, FRAMES):
            yield [dataset[number] for number in numbers[first : first + FRAMES]]


def rows_of(seed: int, pipeline: Pipeline, frames: Sequence[Frame], cases: Iterable[str]) -> Iterator[Row]:
    """Yield the rows of frames that are calibrated jointly."""
    truth = frames[0].camera_from_lidar
    assert truth is not None
    views = [pipeline.prepare(frame) for frame in frames]
    start = INITIAL.start(truth, np.random.default_rng([seed, 0]))
    refine = replace(pipeline, options=pipeline.options.model_copy(update={"camera": "refine"}))
    for case in cases:
        for error in CASES[case]:
            wrong = [replace(view, camera=error.corrected(view.camera)) for view in views]
            results = [one.solve(wrong, start) for one in (pipeline, refine)]
            yield Row(case, error, results[0], *(pose_error(result.camera_from_lidar, truth) for result in results))


def tables(rows: Sequence[Row]) -> str:
    """Return the figures by kind of error as a table in Markdown."""
    lines = []
    for case, group in grouped(rows, lambda row: row.case).items():
        errors = ([row.error for row in group], [row.refined for row in group])
        medians = [size(*np.median([(e.rotation_deg, e.translation_m) for e in each], axis=0)) for each in errors]
        counts = [sum(getattr(row, name) for row in group) for name in ("false_accept", "outside", "in_doubt", "named")]
        counts[3:] = ["-"] if case == "correct" else counts[3:]
        trusted, within = sum(row.result.verdict.trusted for row in group), sum(row.within for row in group)
        lines.append((case, len(group), trusted, *counts, within, *medians))
    return table(HEAD, lines)


def main() -> None:
    """Calibrate all rigs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", nargs="+", metavar="DATASET:PATH", help="real drives instead of the rigs")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    options = parser.parse_args()
    registry, rows = Registry.load(), list[Row]()
    pipeline = Recipe.of(data=None, joint=True).resolve(registry).calibrator()
    assert isinstance(pipeline, Pipeline)
    for rig in options.data or RIGS:
        for seed in options.seeds:
            groups = real(rig, registry) if options.data else [simulated(rig, seed, registry)]
            for frames in groups:
                rows += rows_of(seed, pipeline, frames, REAL_CASES if options.data else CASES)
            print(f"{rig} {seed}: {len(rows)} results", file=sys.stderr, flush=True)
    print(tables(rows))


if __name__ == "__main__":
    main()
