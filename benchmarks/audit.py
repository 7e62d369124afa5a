"""Does `p2o check` call off what is off, and let hold what is right?

    python benchmarks/audit.py collect --out DIR --cases 360           # audits known extrinsics: an hour on one core
    python benchmarks/audit.py report --rows DIR                       # the table of cases
    python benchmarks/audit.py watch --out DIR                         # drives with slips: frames until it is noticed

`collect` takes groups of 1, 5 and 10 frames of simulated rigs and of KITTI (`train`, and odometry 00, on which nothing
was tuned), and gives each group its true extrinsic and ones that are off on one axis by a known amount. It adds a JSON
line for each case to DIR/rows.jsonl and goes on where it was stopped; features of frames are kept in DIR/features.
`report` applies the rules of `p2o.confidence.audit` as they are now. `watch` puts slips into the steps of single
frames of a simulated drive, at many places and on every axis.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.calibration.options import PipelineOptions
from p2o.confidence.audit import AXES, EdgeStep, Evidence, Rates, audit, edge_step
from p2o.confidence.watch import CLIP, Rule, autocorrelation, watched
from p2o.geometry import se3
from p2o.host.registry import Registry
from p2o.results.check import Check, CheckStatus
from p2o.results.evidence import Agreement
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe
from verdict_rigs import RIGS, Rig, Seen, seen

TUNED = ("sim-hdl64-f465", "kitti-raw")
"""Rigs that thresholds were chosen on; the others are measured only."""
MEASURED = ("kitti-odometry", "sim-os1-64-f400", "sim-hdl32-f580")
GROUPS = (1, 5, 10)
TURNS_DEG, SHIFTS_M = (0.15, 0.3, 0.6, 1.0), (0.02, 0.03, 0.05, 0.1)
DRIVE = Rig(
    "drive",
    "synthetic:?right=false&scenes=1&frames_per_scene=120&seed=77&lidar=hdl-64e&width_px=800&height_px=300",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    collecting = commands.add_parser("collect", help="audit known extrinsics")
    collecting.add_argument("--out", type=Path, required=True, help="folder of rows.jsonl, and of features")
    collecting.add_argument("--cases", type=int, default=360, help="how many in all")
    collecting.add_argument("--rigs", default=",".join(TUNED + MEASURED), help="names with commas")
    collecting.add_argument("--no-search", action="store_true", help="leave out the search for large slips: quicker")
    collecting.add_argument("--splits", default="benchmarks/splits.json", help="names KITTI's train frames")
    reporting = commands.add_parser("report", help="the table of cases")
    reporting.add_argument("--rows", type=Path, required=True, help="folder of rows.jsonl")
    watching = commands.add_parser("watch", help="frames until a slip is noticed")
    watching.add_argument("--out", type=Path, required=True, help="folder of steps.jsonl, and of features")
    arguments = parser.parse_args()
    if arguments.command == "collect":
        collect(
            arguments.out, arguments.cases, arguments.rigs.split(","), arguments.splits, search=not arguments.no_search
        )
    elif arguments.command == "report":
        print(report([json.loads(line) for line in (arguments.rows / "rows.jsonl").read_text().splitlines()]))
    else:
        print(watch(arguments.out))


@dataclass(frozen=True)
class Case:
    """Frames of a rig, and by how much one axis of their extrinsic is off (deg or m); None where it is right."""

    rig: str
    frames: tuple[int, ...]
    axis: int | None = None
    size: float = 0.0

    @property
    def key(self) -> str:
        """What tells cases apart."""
        return json.dumps([self.rig, self.frames, self.axis, self.size])

    def extrinsic(self, truth: Float) -> Float:
        """Return the extrinsic (4, 4) that is given, of the true one."""
        return truth if self.axis is None else slipped(truth, self.axis, self.size)


def slipped(truth: Float, axis: int, size: float) -> Float:
    """Return a pose (4, 4) that is off by `size` (deg or m) on one axis of `AXES`, as `p2o.pose_error` has it."""
    out = np.array(truth)
    if axis < 3:
        turn = np.zeros(6)
        turn[(2, 0, 1)[axis]] = np.radians(size)
        out[:3, :3] = se3.exp(turn)[:3, :3] @ truth[:3, :3]
    else:
        out[axis - 3, 3] += size
    return out


def cases_of(rig: str, count: int, most: int) -> list[Case]:
    """Return cases of a rig with N frames: a third correct, the others with errors of all sizes on all axes in turn."""
    rng = np.random.default_rng(0)
    sizes = [(axis, s) for s in range(4) for axis in range(6)]
    out: list[Case] = []
    number = 0
    while len(out) < most:
        group = GROUPS[number % 3] if count >= GROUPS[number % 3] else 1
        frames = tuple(sorted(rng.choice(count, group, replace=False).tolist()))
        out.append(Case(rig, frames))
        for _ in range(2):
            axis, at = sizes[int(rng.integers(len(sizes)))]
            sign = 1 if rng.random() < 0.5 else -1
            out.append(Case(rig, frames, axis, sign * (TURNS_DEG if axis < 3 else SHIFTS_M)[at]))
        number += 1
    return out[:most]


def _rig(name: str) -> Rig:
    return next(rig for rig in RIGS if rig.name == name)


def _pipeline() -> Pipeline:
    pipeline = Recipe.of(data=None).resolve(Registry.load()).calibrator()
    assert isinstance(pipeline, Pipeline)
    return pipeline


def collect(out: Path, count: int, rigs: Sequence[str], splits: str, *, search: bool) -> None:
    """Audit the cases that have no row yet."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "rows.jsonl"
    done = {json.loads(line)["key"] for line in file.read_text().splitlines()} if file.exists() else set()
    pipeline = _pipeline()
    frames = {name: list(seen(_rig(name), out / "features", splits)) for name in rigs}
    cases = [cases_of(name, len(its), -(-count // len(rigs))) for name, its in frames.items()]
    # In turn, so that every rig has cases where it is stopped.
    for case in (case for turn in zip(*cases, strict=True) for case in turn):
        if case.key not in done:
            row = row_of(case, [frames[case.rig][at] for at in case.frames], pipeline, search=search)
            with file.open("a") as stream:
                stream.write(json.dumps(row) + "\n")


def row_of(case: Case, frames: Sequence[Seen], pipeline: Pipeline, *, search: bool) -> dict[str, Any]:
    """Return what edges say of the extrinsic of a case, for `report` to judge."""
    given = case.extrinsic(frames[0].truth)
    evidence = Evidence.of([frame.view for frame in frames], given, pipeline, search=search)
    return {
        "key": case.key,
        "rig": case.rig,
        "group": len(case.frames),
        "axis": case.axis,
        "size": case.size,
        "near": evidence.near if isinstance(evidence.near, str) else plain(evidence.near),
        "far": None if evidence.far is None else plain(evidence.far),
        "lead": evidence.lead_edges,
        "searched": search,
    }


def plain(step: EdgeStep) -> dict[str, Any]:
    """Return a step as JSON takes it."""
    met = step.agreement
    return {
        "error": step.error.tolist(),
        "covariance": step.covariance.tolist(),
        "agreement": [met.near, met.chance, met.points, met.places],
        "places": step.places,
    }


def step_of(value: Any) -> EdgeStep:
    """Return the step of what `plain` gave; where it leads to is not kept."""
    met = Agreement(*value["agreement"])
    return EdgeStep(np.eye(4), np.array(value["error"]), np.array(value["covariance"]), met, value["places"])


def judged(row: dict[str, Any], rates: Rates) -> Check:
    """Return the check of a row by the rules as they are now."""
    near = row["near"] if isinstance(row["near"], str) else step_of(row["near"])
    far = None if row["far"] is None else step_of(row["far"])
    return audit(Evidence((row["rig"],), np.eye(4), near, far, row["lead"]), PipelineOptions(), rates)


def report(rows: Sequence[dict[str, Any]]) -> str:
    """Return the table: rigs by rig and group, then how errors by size were called."""
    rates = Rates()
    lines = ["| rig | frames | right | called off | cannot tell | wrong | missed above limit | of | cannot tell |"]
    lines.append("|---|---|---|---|---|---|---|---|---|")
    for rig in [*dict.fromkeys(row["rig"] for row in rows), "all"]:
        for group in [*GROUPS, None]:
            its = [r for r in rows if rig in (r["rig"], "all") and group in (r["group"], None)]
            if its and (rig == "all" or group is not None):
                lines.append(f"| {rig} | {group or 'any'} | " + " | ".join(counted(its, rates)) + " |")
    return "\n".join([*lines, "", *_spread(rows), "", *_by_size(rows, rates)])


def counted(rows: Sequence[dict[str, Any]], rates: Rates) -> list[str]:
    """Return the columns of the table for some rows."""
    right = [judged(row, rates) for row in rows if row["axis"] is None]
    wrong = [(row, judged(row, rates)) for row in rows if row["axis"] is not None]
    words, others = Counter(check.holding for check in right), Counter(check.holding for _, check in wrong)
    above = [(row, check) for row, check in wrong if _above(row, check)]
    missed = sum(check.holding is not CheckStatus.OFF for _, check in above)
    return [
        str(len(right)),
        str(words[CheckStatus.OFF]),
        str(words[CheckStatus.CANNOT_TELL]),
        str(len(wrong)),
        str(missed),
        str(len(above)),
        str(others[CheckStatus.CANNOT_TELL]),
    ]


def _above(row: dict[str, Any], check: Check) -> bool:
    """Return whether the error that was put in is above the limit that was stated for its axis."""
    limit = check.axes[row["axis"]].limit
    return limit is not None and abs(row["size"]) >= limit


def _spread(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Return how errors of single steps are spread, in their likely deviations, at right extrinsics."""
    for rigs, label in ((TUNED, "tuned on"), (MEASURED, "measured only")):
        steps = [step_of(r["near"]) for r in rows if r["rig"] in rigs and not isinstance(r["near"], str)]
        its = [r for r in rows if r["rig"] in rigs and not isinstance(r["near"], str)]
        if not steps:
            continue
        put = np.array([np.eye(6)[r["axis"] or 0] * r["size"] for r in its])
        z = np.array([(s.error - p) / s.sigma for s, p in zip(steps, put, strict=True)])
        top = np.percentile(np.abs(z).max(axis=1), [50, 90, 95, 99])
        lead = np.percentile(
            [r["lead"] for r in rows if r["rig"] in rigs and r["far"] is not None] or [0], [50, 90, 99]
        )
        yield (
            f"{label}: root mean square {np.sqrt((z**2).mean(axis=0)).round(2).tolist()}, largest of six "
            f"{top.round(2).tolist()} (50, 90, 95, 99 %), leads {lead.round(1).tolist()} (50, 90, 99 %)"
        )


def _by_size(rows: Sequence[dict[str, Any]], rates: Rates) -> Iterator[str]:
    """Return the detection rate of errors of each size, and of their axis, in joint calibration of N frames."""
    yield "| error | " + " | ".join(f"{group} frames: off, right axis, of" for group in GROUPS) + " |"
    yield "|---" * (1 + len(GROUPS)) + "|"
    for sizes, turns in ((TURNS_DEG, True), (SHIFTS_M, False)):
        for size in sizes:
            cells = []
            for group in GROUPS:
                its = [
                    (r, judged(r, rates))
                    for r in rows
                    if r["group"] == group
                    and r["axis"] is not None
                    and (r["axis"] < 3) is turns
                    and abs(r["size"]) == size
                ]
                off = sum(check.holding is CheckStatus.OFF for _, check in its)
                axis = sum(check.axes[row["axis"]].holding is CheckStatus.OFF for row, check in its)
                cells.append(f"{off}, {axis}, {len(its)}")
            yield f"| {size:g} {'deg' if turns else 'm'} | " + " | ".join(cells) + " |"


def steps_of_drive(out: Path) -> list[EdgeStep | None]:
    """Return the steps of the single frames of the drive at its true extrinsic; kept in a file."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "steps.jsonl"
    if not file.exists():
        pipeline = _pipeline()
        found = []
        for frame in seen(DRIVE, out / "features", ""):
            step = edge_step([frame.view], frame.truth, pipeline.matcher, pipeline.options)
            found.append(None if isinstance(step, str) else plain(step))
        file.write_text("".join(json.dumps(step) + "\n" for step in found))
    values = [json.loads(line) for line in file.read_text().splitlines()]
    return [None if value is None else step_of(value) for value in values]


def watch(out: Path) -> str:
    """Return how many frames pass until slips are noticed, and false alarms of noise."""
    steps, rule = steps_of_drive(out), Rule()
    values = np.array([np.full(6, np.nan) if s is None else np.clip(s.error / s.sigma, -CLIP, CLIP) for s in steps])
    back = [*steps, *reversed(steps)]
    lines = [
        f"{len(steps)} frames, {sum(s is None for s in steps)} without a step; correlation with the next "
        f"{autocorrelation(values):.2f}; root mean square about the mean "
        f"{np.nanstd(values, axis=0).round(2).tolist()}",
        f"false alarms without a slip: {len(watched(_names(steps), steps, rule).slips)}",
        false_alarms(autocorrelation(values), 5),
        "",
        "| slip | drive | noticed | right axis | frames until then (median, most) |",
        "|---|---|---|---|---|",
    ]
    drives = (("once", steps, range(30, 61, 10)), ("forth and back, twice", back + back, range(180, 301, 40)))
    for size, axes in ((0.3, range(3)), (0.6, range(3)), (0.03, range(3, 6)), (0.06, range(3, 6))):
        for name, its, begins in drives:
            unit = "deg" if axes[0] < 3 else "m"
            lines.append(f"| {size:g} {unit} | {name} | " + " | ".join(_noticed(its, begins, axes, size, rule)) + " |")
    return "\n".join(lines)


def _noticed(
    steps: Sequence[EdgeStep | None], begins: Sequence[int], axes: Sequence[int], size: float, rule: Rule
) -> list[str]:
    """Return the columns for slips of a size on each axis, to both sides, beginning at each of these frames."""
    delays, right, tried = [], 0, 0
    for axis in axes:
        for sign in (1, -1):
            for begin in begins:
                tried += 1
                slipped_ = [_slipped(step, at, begin, axis, sign * size) for at, step in enumerate(steps)]
                slips = [slip for slip in watched(_names(steps), slipped_, rule).slips if slip.noticed >= begin]
                if slips:
                    delays.append(slips[0].noticed - begin)
                    right += slips[0].axis == AXES[axis][0]
    return [f"{len(delays)} of {tried}", str(right), f"{np.median(delays):.0f}, {max(delays)}" if delays else ""]


def _names(steps: Sequence[object]) -> list[str]:
    return [str(at) for at in range(len(steps))]


def false_alarms(correlation: float, hours: int) -> str:
    """Return how many alarms drives of an hour raise whose steps are noise that goes on with this correlation."""
    # More often than anybody would have them, so that a few hours count some.
    rng, rule = np.random.default_rng(0), Rule(alarms_per_hour=6.0)
    raised, met, frames = 0, Agreement(0.5, 0.1, 1000, 100), int(3600 * rule.rate_hz)
    for _ in range(hours):
        fresh, values = rng.standard_normal((frames, 6)), np.zeros((frames, 6))
        for at in range(frames):
            values[at] = correlation * values[at - 1] + np.sqrt(1 - correlation**2) * fresh[at]
        steps = [EdgeStep(np.eye(4), row, np.eye(6), met, 100) for row in values]
        raised += len(watched(_names(steps), steps, rule).slips)
    return f"noise of the predicted errors, {hours} hours: {raised} alarms, {rule.alarms_per_hour:g} per hour expected"


def _slipped(step: EdgeStep | None, at: int, begin: int, axis: int, size: float) -> EdgeStep | None:
    """Return the step of a frame once the mounting has slipped: the given extrinsic is off by as much."""
    if step is None or at < begin:
        return step
    return replace(step, error=step.error + size * np.eye(6)[axis])


if __name__ == "__main__":
    main()
