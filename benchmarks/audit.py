"""Does `p2o check` report the extrinsics that are wrong, and no others? Published ones and simulated ones.

    python benchmarks/audit.py collect --out DIR               # continues where it was stopped
    python benchmarks/audit.py table --rows DIR                # false alarms, detected errors, detection limits
    python benchmarks/audit.py published --rows DIR            # what it reports about the reference of each rig
    python benchmarks/audit.py watch --out DIR                 # drives with slips: frames until one is detected

`collect` takes groups of 20, 5 and 1 frames of each rig (`RIGS`; all frames of a rig with fewer), and checks each group
at its reference, and at extrinsics with an error on one axis: 0.2 to 2 deg or 2 to 30 cm, with a random sign. Features
are extracted once, only the extrinsic changes. A JSON line for each case is added to DIR/rows.jsonl; it contains the
evidence, and the tables apply the current rules of `p2o.confidence.audit`. `watch` adds slips to the steps of single
frames of a simulated drive, at many places and on every axis.
"""

from __future__ import annotations

import argparse
import json
import re
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from limits_and_tables import add_row, read_rows, table
from p2o.arrays import Float
from p2o.confidence.audit import AXES, EdgeStep, Evidence, Rates, audit, edge_step
from p2o.confidence.explanation import corrected
from p2o.confidence.watch import CLIP, Rule, autocorrelation, watched
from p2o.results.check import AxisCheck, Check, CheckStatus
from p2o.results.evidence import Agreement
from p2o.run.pipeline import Pipeline
from rigs import Rig, Sample, rig_of

ANGLES_DEG, SHIFTS_M = (0.2, 0.5, 1.0, 2.0), (0.02, 0.05, 0.1, 0.3)
GROUPS = {20: (0, 1, 1, 2, 3), 5: (1, 2), 1: (2, 3)}
"""Number of frames in a group, and which of these errors are put on each of its axes; 0.5 deg and 5 cm twice."""
CORRECT = 12
"""Cases at the reference for each rig and number of frames."""
DRIVE = Rig(
    "drive",
    "synthetic:?right=false&scenes=1&frames_per_scene=120&seed=77&lidar=hdl-64e&width_px=800&height_px=300",
)
DRIVE_0005 = "kitti-raw:build/data/kitti_raw"


def _scenes(name: str, words: str) -> Rig:
    return Rig(name, f"synthetic:?right=false&scenes=24&frames_per_scene=1&{words}")


def _ddad(camera: int, name: str) -> Rig:
    return replace(rig_of("ddad"), name=name, frames=f"@{{splits}}#ddad-dev-CAMERA_0{camera}")


RIGS: Mapping[str, Rig] = {
    rig.name: rig
    for rig in (
        Rig("drive-0005", DRIVE_0005, "@{splits}#drive_0005_later"),
        rig_of("kitti-odometry"),
        replace(rig_of("kitti-raw"), name="kitti-train"),
        _scenes("sim-hdl64", "seed=203&lidar=hdl-64e&width_px=800&height_px=300"),
        _scenes("sim-os1-64", "seed=201&lidar=os1-64&width_px=690&height_px=480&camera=opencv-distorted"),
        _scenes("sim-hdl32", "seed=202&lidar=hdl-32e&width_px=1000&height_px=560"),
        _scenes("sim-vlp16", "seed=204&lidar=vlp-16&width_px=1000&height_px=560"),
        Rig("drive-0005-16", f"{DRIVE_0005}?keep_rings=4", "@{splits}#drive_0005_later_even"),
        *map(rig_of, ("waymo", "nuscenes", "hitsz", "hitsz_sim", "boards_sim", "acfr_vlp16", "pjlab")),
        _ddad(1, "ddad-front"),
        _ddad(5, "ddad-left"),
        _ddad(6, "ddad-right"),
    )
}
MOST_FRAMES = {"kitti-train": 24}
IN_QUESTION = ("acfr_vlp16", "pjlab", "ddad-front", "ddad-left", "ddad-right", "waymo")
"""Rigs whose cards (benchmarks/cards) state that the reference may be wrong by more than the errors that are put in."""


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    collecting = commands.add_parser("collect", help="check known extrinsics")
    collecting.add_argument("--out", type=Path, required=True, help="folder of rows.jsonl, and of features")
    for name, content in (("table", "false alarms, detected errors, limits"), ("published", "references of the rigs")):
        reporting = commands.add_parser(name, help=content)
        reporting.add_argument("--rows", type=Path, required=True, help="folder of rows.jsonl")
    watching = commands.add_parser("watch", help="frames until a slip is detected")
    watching.add_argument("--out", type=Path, required=True, help="folder of steps.jsonl, and of features")
    options = parser.parse_args()
    if options.command == "collect":
        for rig in RIGS.values():
            collect(rig, options.out)
    elif options.command == "watch":
        print(watch(options.out))
    else:
        report = tables if options.command == "table" else published
        print(report(read_rows(options.rows / "rows.jsonl")))


@dataclass(frozen=True)
class Case:
    """Frames of a rig, and the error of their extrinsic on one axis (deg or m); None for the reference itself."""

    rig: str
    frames: tuple[int, ...]
    axis: int | None = None
    size: float = 0.0

    @property
    def key(self) -> str:
        """What identifies a case."""
        return json.dumps([self.rig, self.frames, self.axis, self.size])

    def extrinsic(self, reference: Float) -> Float:
        """Return the extrinsic (4, 4) to check."""
        return reference if self.axis is None else corrected(reference, self.axis, np.array([-self.size]))[0]


def cases_of(rig: Rig, names: Sequence[str]) -> list[Case]:
    """Return the cases of a rig: all frames at the reference, then groups at it and at wrong extrinsics.

    Frames that are never solved together are single groups; a rig with fewer frames than a group has one of all.
    """
    rng = np.random.default_rng(sum(map(ord, rig.name)))
    together = rig.groups(names) or [[at] for at in range(len(names))]
    cases = [Case(rig.name, tuple(group)) for group in together]
    most = max(map(len, together))
    for size, errors in GROUPS.items():
        if size == max(GROUPS) and (most < size or rig.name in IN_QUESTION):
            continue
        count = min(size, most)
        pools = [group for group in together if len(group) >= count]

        def drawn(pools: Sequence[Sequence[int]] = pools, count: int = count) -> tuple[int, ...]:
            pool = pools[int(rng.integers(len(pools)))]
            return tuple(sorted(int(at) for at in rng.choice(pool, count, replace=False)))

        cases += [Case(rig.name, drawn()) for _ in range(CORRECT)]
        for axis, (_, unit) in enumerate(AXES):
            sizes = ANGLES_DEG if unit == "deg" else SHIFTS_M
            for number in errors:
                cases.append(Case(rig.name, drawn(), axis, sizes[number] * (1 if rng.random() < 0.5 else -1)))
    return list(dict.fromkeys(cases))


def collect(rig: Rig, out: Path) -> None:
    """Check the cases of a rig that have no row yet."""
    file = out / "rows.jsonl"
    done = {row["key"] for row in read_rows(file)}
    frames, pipeline = rig.samples(out / "features", MOST_FRAMES.get(rig.name)), rig.plan.calibrator()
    assert isinstance(pipeline, Pipeline)
    for case in cases_of(rig, [frame.view.name for frame in frames]):
        if case.key not in done:
            add_row(file, row_of(case, [frames[at] for at in case.frames], pipeline))


def row_of(case: Case, frames: Sequence[Sample], pipeline: Pipeline) -> dict[str, Any]:
    """Return the evidence of a case, for the tables to judge."""
    begin = time.process_time()
    evidence = Evidence.of([frame.view for frame in frames], case.extrinsic(frames[0].truth), pipeline)
    return {
        "key": case.key,
        "rig": case.rig,
        "names": evidence.frames,
        "axis": case.axis,
        "size": case.size,
        "given": evidence.camera_from_lidar.tolist(),
        "near": evidence.near if isinstance(evidence.near, str) else plain(evidence.near),
        "far": None if evidence.far is None else plain(evidence.far),
        "lead": evidence.lead_edges,
        "seconds": round(time.process_time() - begin, 2),
    }


def plain(step: EdgeStep) -> dict[str, Any]:
    """Return a step as JSON."""
    agreement = step.agreement
    arrays = {name: getattr(step, name).tolist() for name in ("pose", "error", "covariance")}
    counts = [agreement.near, agreement.chance, agreement.points, agreement.places]
    return {**arrays, "agreement": counts, "places": step.places}


def step_of(value: Any) -> EdgeStep:
    """Return the step that `plain` wrote."""
    pose, error, covariance = (np.array(value[name]) for name in ("pose", "error", "covariance"))
    return EdgeStep(pose, error, covariance, Agreement(*value["agreement"]), value["places"])


def judged(row: Mapping[str, Any]) -> Check:
    """Return the check of a row by the current rules."""
    near = row["near"] if isinstance(row["near"], str) else step_of(row["near"])
    far = None if row["far"] is None else step_of(row["far"])
    evidence = Evidence(tuple(row["names"]), np.array(row["given"]), near, far, row["lead"])
    return audit(evidence, Rates())


@dataclass(frozen=True, eq=False)
class Judged:
    """A case with its check: `axis` is None for a reference."""

    rig: str
    count: int
    axis: int | None
    size: float
    check: Check

    @classmethod
    def of(cls, row: Mapping[str, Any]) -> Judged:
        """Judge a row."""
        return cls(row["rig"], len(row["names"]), row["axis"], abs(row["size"]), judged(row))

    @property
    def is_off(self) -> bool:
        """Whether the check reports an error."""
        return self.check.holding is CheckStatus.OFF

    @property
    def frames(self) -> str:
        """The column of the tables."""
        return "1" if self.count == 1 else "20" if self.count >= 20 else "3 to 12"

    @property
    def above_limit(self) -> bool:
        """Whether the error that was put in is above the detection limit that the check states for its axis."""
        limit = None if self.axis is None else self.check.axes[self.axis].limit
        return limit is not None and self.size >= limit

    @property
    def named(self) -> str:
        """Which axes a report names: only the right one, it among others (or alternatives), others alone, or none."""
        named = re.findall(r"\b(roll|pitch|yaw|x|y|z) [+-]", self.check.reason.partition(";")[0])
        right = "" if self.axis is None else AXES[self.axis][0]
        return NAMED[0] if named == [right] else NAMED[1] if right in named else NAMED[2] if named else NAMED[3]


NAMED = ("only", "among", "other", "none")
COLUMNS = ("20", "3 to 12", "1")
AXIS_NAMES = tuple(name for name, _ in AXES)
Table = Iterator[Sequence[object]]
"""The head of a table, then its rows."""


def tables(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the tables of all cases: by rig, by error, and the detection limits."""
    cases = [Judged.of(row) for row in rows]
    trusted = [case for case in cases if case.rig not in IN_QUESTION]
    parts = (_by_rig(cases, trusted), _by_error(trusted), _limits(cases))
    return "\n\n".join(table(next(part), part) for part in parts)


def _by_rig(cases: Sequence[Judged], trusted: Sequence[Judged]) -> Table:
    """Yield a row for each rig and number of frames: references and wrong extrinsics."""
    yield "rig", "frames", "references", "`off`", "`cannot tell`", "wrong", "`off`", "above the limit", "of these `off`"
    groups = {f"{rig} (in question)" if rig in IN_QUESTION else rig: _where(cases, rig=rig) for rig in RIGS}
    for rig, group in [*groups.items(), ("all but references in question", trusted)]:
        for frames in COLUMNS:
            if own := _where(group, frames=frames):
                right = [case for case in own if case.axis is None]
                wrong = [case for case in own if case.axis is not None]
                above = [case for case in wrong if case.above_limit]
                unclear = sum(case.check.holding is CheckStatus.CANNOT_TELL for case in right)
                yield rig, frames, len(right), _off(right), unclear, len(wrong), _off(wrong), len(above), _off(above)


def _by_error(cases: Sequence[Judged]) -> Table:
    """Yield the detected errors by size, axis and number of frames, and whether the report names the axis."""
    yield "error", "frames", *AXIS_NAMES, "all", "only the right axis named", "among others", "others", "none"
    for sizes, unit, scale in ((ANGLES_DEG, "deg", 1), (SHIFTS_M, "cm", 100)):
        for size in sizes:
            for frames in COLUMNS:
                own = [case for case in _where(cases, size=size, frames=frames) if case.axis is not None]
                own = [case for case in own if (case.axis < 3) is (unit == "deg")]
                by_axis = [_where(own, axis=axis) for axis in range(len(AXES))]
                names = Counter(case.named for case in own if case.is_off)
                shares = [_share(group) if group else "" for group in [*by_axis, own]]
                if own:
                    yield f"{scale * size:g} {unit}", frames, *shares, *(names[w] for w in NAMED)


def _limits(cases: Sequence[Judged]) -> Table:
    """Yield the median detection limit of each axis, by rig and number of frames."""
    yield "detected from (median, deg and cm)", "frames", *AXIS_NAMES
    for rig in RIGS:
        for frames in COLUMNS:
            checks = [case.check.axes for case in _where(cases, rig=rig, frames=frames)]
            limits = np.array([[axis.limit for axis in axes] for axes in checks if axes[0].limit is not None], float)
            if len(limits):
                values = np.median(limits, axis=0) * [1, 1, 1, 100, 100, 100]
                yield rig, frames, *(f"{value:.2g}" for value in values)


def _where(cases: Sequence[Judged], **values: object) -> list[Judged]:
    """Return the cases with these values of their fields."""
    return [case for case in cases if all(getattr(case, name) == value for name, value in values.items())]


def _off(cases: Sequence[Judged]) -> int:
    return sum(case.is_off for case in cases)


def _share(cases: Sequence[Judged]) -> str:
    return f"{_off(cases)} of {len(cases)}"


def published(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return what the check reports about the reference of each rig, with all frames that may be solved together."""
    lines: list[tuple[object, ...]] = []
    for rig in RIGS:
        references = [row for row in rows if row["rig"] == rig and row["axis"] is None]
        most = max((len(row["names"]) for row in references), default=0)
        for row in references:
            if len(row["names"]) == most and (most == 1 or row is references[0]):
                check = judged(row)
                frames = f"{most}" if most > 1 else row["names"][0]
                lines.append((rig, frames, check.holding.value, *map(_bounded, check.axes), check.reason))
    return table(("rig", "frames", "reference", *AXIS_NAMES, "explanation"), lines)


_Z_95 = 1.96


def _bounded(axis: AxisCheck) -> str:
    """Return the error of a reference with its 95 % bound, in deg or cm."""
    if axis.off is None or axis.sigma is None:
        return ""
    scale, digits = (1, 2) if axis.unit == "deg" else (100, 1)
    return f"{scale * axis.off:+.{digits}f} +- {_Z_95 * scale * axis.sigma:.{digits}f}"


def steps_of_drive(out: Path) -> list[EdgeStep | None]:
    """Return the steps of the single frames of the drive at its true extrinsic; they are stored in a file."""
    file = out / "steps.jsonl"
    if not file.exists():
        pipeline = DRIVE.plan.calibrator()
        assert isinstance(pipeline, Pipeline)
        for frame in DRIVE.samples(out / "features"):
            step = edge_step([frame.view], frame.truth, pipeline.matcher, pipeline.options)
            add_row(file, None if isinstance(step, str) else plain(step))
    return [None if value is None else step_of(value) for value in read_rows(file)]


def watch(out: Path) -> str:
    """Return the number of frames until slips are detected, and the false alarms without a slip."""
    steps, rule = steps_of_drive(out), Rule()
    values = np.array([np.full(6, np.nan) if s is None else np.clip(s.error / s.sigma, -CLIP, CLIP) for s in steps])
    correlation, spread = autocorrelation(values), np.nanstd(values, axis=0).round(2).tolist()
    text = (
        f"{len(steps)} frames, {sum(s is None for s in steps)} without a step; correlation with the next "
        f"{correlation:.2f}; root mean square about the mean {spread}\n"
        f"false alarms without a slip: {len(_slips(steps, rule))}\n\n"
    )
    back = [*steps, *reversed(steps)]
    drives = (("once", steps, range(30, 61, 10)), ("forth and back, twice", back + back, range(180, 301, 40)))
    slips = ((0.3, range(3)), (0.6, range(3)), (0.03, range(3, 6)), (0.06, range(3, 6)))
    lines = [
        (f"{size:g} {'deg' if axes[0] < 3 else 'm'}", name, *_detected(drive, begins, axes, size, rule))
        for size, axes in slips
        for name, drive, begins in drives
    ]
    return text + table(("slip", "drive", "noticed", "right axis", "frames until then (median, most)"), lines)


def _slips(steps: Sequence[EdgeStep | None], rule: Rule) -> Sequence[Any]:
    return watched([str(at) for at in range(len(steps))], steps, rule).slips


def _detected(
    steps: Sequence[EdgeStep | None], begins: Sequence[int], axes: Sequence[int], size: float, rule: Rule
) -> tuple[str, int, str]:
    """Return the columns for slips of a size on each axis, to both sides, beginning at each of these frames."""
    delays, right, count = [], 0, 0
    for axis in axes:
        for sign in (1, -1):
            for begin in begins:
                count += 1
                slipped = [_slipped(step, at, begin, axis, sign * size) for at, step in enumerate(steps)]
                if slips := [slip for slip in _slips(slipped, rule) if slip.noticed >= begin]:
                    delays.append(slips[0].noticed - begin)
                    right += slips[0].axis == AXES[axis][0]
    return f"{len(delays)} of {count}", right, f"{np.median(delays):.0f}, {max(delays)}" if delays else ""


def _slipped(step: EdgeStep | None, at: int, begin: int, axis: int, size: float) -> EdgeStep | None:
    """Return the step of a frame after the mounting has slipped: the error of the given extrinsic grows by `size`."""
    if step is None or at < begin:
        return step
    return replace(step, error=step.error + size * np.eye(6)[axis])


if __name__ == "__main__":
    main()
