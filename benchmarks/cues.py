"""Measure what cues other than directed edges state about results: can they detect wrong ones, or improve right ones?

    python benchmarks/adversarial.py run --out rows.jsonl              # results, right and wrong
    python benchmarks/cues.py measure rows.jsonl --out cues.jsonl      # 10 s each; continues where it was stopped
    python benchmarks/cues.py table cues.jsonl
    python benchmarks/cues.py drives                                   # motion, on drives: 2 minutes for each

`measure` repeats good results (0.5 deg, 15 cm), trusted or not, and all false accepts. Every second good
result is evaluated again at a pose that is 0.3 to 1 deg and 10 to 30 cm from the truth. Each cue (`cue_estimates.py`)
starts there and returns its own optimum. `table` tests the difference by chi-square, with the covariances of cue and
edges added. The scale of the errors of a cue, and the bound of the test (1 % false alarms), come from good results of
TUNED; false alarms and the change by fusion are those of the other sources.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from json import dumps, loads
from pathlib import Path
from typing import Any

import numpy as np
from adversarial import SPLITS, Bench, Row, read
from adversarial_cases import CHANGES, RAW, SOURCES, Change, Source
from cue_estimates import CUES, UNIT, Cue, compensated, motion, moved
from p2o import Float, Frame, InputError, Registry
from p2o.confidence.fusion import Opinion
from p2o.features.view import View
from p2o.frames.selection import select
from p2o.geometry import se3
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import pose_error
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe
from scipy.stats import chi2

TUNED = ("kitti-raw", "drive-0005", "sim-street-hdl64", "sim-hall-os1", "sim-street-vlp16", "sim-street-os1")
ACFR = Source("acfr_vlp16", "folder:build/data/rigs/acfr_vlp16", "@{splits}#acfr_vlp16-dev", most=8)
ALARM = 0.01
_DRAWS = 2000


def chosen(rows: Iterable[Row], most: int) -> Iterator[Row]:
    """Yield the rows that are measured, at most `most` of each source, kind and number of frames."""
    seen: Counter[tuple[str, ...]] = Counter()
    for row in rows:
        wrong = row.trusted and row.wrong
        if wrong or (row.good and row.kind not in CHANGES):
            group = (row.source, row.kind, str(len(row.frames)), str(wrong))
            seen[group] += 1
            if seen[group] <= most:
                yield row


def measured(bench: Bench, row: Row, names: Sequence[str], *, again: bool) -> Iterator[dict[str, Any]]:
    """Yield what cues state about the result of a row and, with `again`, about a wrong pose near the truth."""
    numbers = [frame.name for frame in bench.frames]
    change, group = bench.changes()[row.kind][row.variant], [numbers.index(name) for name in row.frames]
    try:
        result, frames, views = bench.result(change, group)
        edges = Opinion.of("edges", result, np.eye(4))
    except InputError:
        return
    truth, rng = bench.frames[group[0]].camera_from_lidar, np.random.default_rng(group)
    assert truth is not None
    twists = {motion.frame: np.array(motion.twist) for motion in result.motions}
    frames = [compensated(frame, twists.get(frame.name)) for frame in frames]
    seen = [view.untwisted(twists[view.name]) if view.name in twists else view for view in views]
    words = {
        "source": row.source,
        "kind": row.kind,
        "variant": row.variant,
        "frames": row.frames,
        "trusted": result.verdict.trusted,
        "seconds": sum(result.seconds.values()),
        "truth": truth.tolist(),
        "edges": (edges.covariance / np.outer(UNIT, UNIT)).tolist(),
    }
    pose = edges.body_from_lidar
    yield words | {"case": "wrong" if row.wrong else "right", "pose": pose.tolist()} | stated(frames, seen, pose, names)
    if again:
        pose = wrong_start(truth, float(rng.uniform(0.3, 1.0)), float(rng.uniform(0.1, 0.3)), rng)
        yield words | {"case": "moved", "pose": pose.tolist()} | stated(frames, seen, pose, names)


def stated(frames: Sequence[Frame], views: Sequence[View], pose: Float, names: Sequence[str]) -> dict[str, Any]:
    """Return the cues of frames at a pose by name, None where one does not exist, and their seconds."""
    cues: dict[str, Any] = {}
    seconds = {}
    for name in names:
        began = time.process_time()
        cue = CUES[name](frames, views, pose)
        seconds[name] = time.process_time() - began
        parts = ("step", "directions", "covariance")
        cues[name] = None if cue is None else {part: getattr(cue, part).tolist() for part in parts}
    return {"cues": cues, "cue_seconds": seconds}


# ---- drives

_STREET = "frames_per_scene=13&period_s=0.2&speed_m_s=4&swing_deg=25&tilt_deg=3&sway=0&right=false"
DRIVES = {
    "simulated street": (f"synthetic:?place=street&seed=31&{_STREET}", 0),
    "simulated suburb": (f"synthetic:?place=suburb&seed=32&{_STREET}", 0),
    "KITTI drive 0005, 80 to 91": (RAW, 0),
    "KITTI drive 0005, 115 to 126": (RAW, 35),
}
_OF_DRIVE, _EVERY = 12, 3
"""Frames of a drive, all of which show its motion, and every n-th of which shows its edges."""
_NEXT = "unsynchronised"
_KINDS = ("focal length 3 %", "principal point 20 px")


def of_drives(names: Sequence[str]) -> Iterator[str]:
    """Yield the lines of a table: results of edges on drives, right and wrong, against the motion of all frames."""
    registry = Registry.load()
    columns = "motion: sigmas | error along its directions: motion, edges | chi-square / 99 % quantile | delay [ms]"
    yield f"| drive | change | edges: error, verdict | {columns} |"
    yield "|---|---|---|---|---|---|---|"
    for name in names:
        data, first = DRIVES[name]
        plan = Recipe.of(data=data).resolve(registry)
        pipeline, dataset = plan.calibrator(), plan.dataset()
        assert isinstance(pipeline, Pipeline)
        numbers = range(_OF_DRIVE + 1) if first == 0 and data != RAW else None
        if numbers is None:
            numbers = select(list(dataset.names), f"@{SPLITS}#drive_0005_later")[first : first + _OF_DRIVE + 1]
        whole = [dataset[number] for number in numbers]
        changes: dict[str, Change] = {"none": lambda frames, n: frames[n]}
        for kind in _KINDS:
            changes |= {f"{kind} {sign}": change for sign, change in CHANGES[kind].items() if "-" not in sign}
        changes[_NEXT] = lambda frames, n: replace(frames[n], image=frames[n + 1].image)
        for kind, change in changes.items():
            yield _of_drive(name, kind, [change(whole, n) for n in range(_OF_DRIVE)], pipeline)


def _of_drive(name: str, kind: str, frames: Sequence[Frame], pipeline: Pipeline) -> str:
    truth = frames[0].camera_from_lidar
    assert truth is not None
    result = pipeline(frames[::_EVERY], wrong_start(truth, 2.0, 0.15, np.random.default_rng(0)))
    error, edges = pose_error(result.camera_from_lidar, truth), Opinion.of("edges", result, np.eye(4))
    cue, delay = motion(frames, edges.body_from_lidar)
    start = (
        f"| {name} | {kind} | {error.rotation_deg:.2f} deg, {100 * error.translation_m:.1f} cm, {result.verdict.trust} "
    )
    if cue is None:
        return f"{start}| none | - | - | - |"
    covariance = (edges.covariance / np.outer(UNIT, UNIT)).tolist()
    parts = {part: getattr(cue, part).tolist() for part in ("step", "directions", "covariance")}
    words = {"pose": edges.body_from_lidar, "truth": truth, "edges": covariance, "cues": {"motion": parts}}
    stated_here = Stated(words, "motion")
    sigmas = ", ".join(f"{sigma:.2f}" for sigma in np.sqrt(np.diag(cue.covariance)))
    off = ", ".join(f"{value:.2f}" for value in stated_here.errors())
    return f"{start}| {sigmas} | {off} | {stated_here.surprise(1.0):.1f} | {1000 * delay:.0f} |"


# ---- table


class Stated:
    """One measured pose, and what one cue states about it."""

    def __init__(self, words: Mapping[str, Any], name: str) -> None:
        self.words, given = words, words["cues"].get(name)
        self.cue = None if given is None else Cue(*(np.array(given[p]) for p in ("step", "directions", "covariance")))
        self.pose, self.truth, self.edges = (np.array(words[key]) for key in ("pose", "truth", "edges"))
        self.to_truth = se3.log(self.truth @ se3.inverse(self.pose)) / UNIT

    def surprise(self, scale: float) -> float:
        """Return the chi-square relative to its 99 % quantile; 0 without the cue."""
        if self.cue is None:
            return 0.0
        return float(self.cue.chi_square(self.edges, scale) / chi2.ppf(1 - ALARM, len(self.cue.directions)))

    def off(self) -> Float:
        """Return the error (K,) of the cue along its directions."""
        assert self.cue is not None
        return np.asarray(self.cue.directions @ (self.to_truth - self.cue.step))

    def errors(self) -> tuple[float, float]:
        """Return the root mean square error of the cue and of the pose along the directions of the cue."""
        assert self.cue is not None
        cue, pose = (float(np.sqrt(np.mean(v**2))) for v in (self.off(), self.cue.directions @ self.to_truth))
        return cue, pose

    def gain(self, scale: float) -> tuple[float, float]:
        """Return by how much fusion changes the error of the pose, in deg and cm."""
        fused = self.pose if self.cue is None else moved(self.pose, self.cue.fused(self.edges, scale))
        before, after = pose_error(self.pose, self.truth), pose_error(fused, self.truth)
        return after.rotation_deg - before.rotation_deg, 100 * (after.translation_m - before.translation_m)


def scale_of(right: Sequence[Stated]) -> float:
    """Return the factor of the errors of a cue at which the median chi-square of its own error is as expected."""
    ratios = [
        float(np.square(off).sum() / chi2.ppf(0.5, len(off)))
        for each in right
        if each.cue is not None
        for off in [each.off() / np.sqrt(np.diag(each.cue.covariance))]
    ]
    return float(np.sqrt(np.median(ratios))) if ratios else 1.0


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of cues, and that of wrong results by kind, in Markdown."""
    names = [name for name in CUES if any(name in row["cues"] for row in rows)]
    lines = [
        "| cue | exists, right results | scale | median error along its directions: cue, edges | false alarms, other "
        "sources | false accepts, detected | moved poses, detected | fusion, other sources [deg] | [cm] | s |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    detected: dict[str, dict[str, str]] = defaultdict(dict)
    surprises: dict[int, list[float]] = defaultdict(list)
    for name in names:
        line, by_kind, every = _line(name, [row for row in rows if name in row["cues"]])
        lines.append(line)
        for kind, text in by_kind.items():
            detected[kind][name] = text
        for number, value in every.items():
            surprises[number].append(value)
    whole = {number: max(values) for number, values in surprises.items()}
    lines.append("| any of them | " + _any(rows, whole))
    short = " | ".join(names)
    lines += ["", f"| false accepts | {short} |", "|---|" + "---|" * len(names)]
    for kind, texts in sorted(detected.items()):
        lines.append(f"| {kind} | " + " | ".join(texts.get(name, "-") for name in names) + " |")
    return "\n".join(lines)


def _line(name: str, rows: Sequence[Mapping[str, Any]]) -> tuple[str, dict[str, str], dict[int, float]]:
    """Return a line of the table, detected wrong results by kind, and the surprise of each row by its identity."""
    every = [Stated(row, name) for row in rows]
    right, wrong, pushed = (_of(every, case) for case in ("right", "wrong", "moved"))
    tuned, others = [e for e in right if _tuned(e)], [e for e in right if not _tuned(e)]
    scale = scale_of(tuned)
    bound = _bound([each.surprise(scale) for each in tuned])

    def detections(some: Sequence[Stated]) -> str:
        return f"{sum(each.surprise(scale) > bound for each in some)} of {len(some)}"

    known = [each for each in right if each.cue is not None]
    errors = np.median([each.errors() for each in known], axis=0) if known else np.full(2, np.nan)
    seconds = np.median([row["cue_seconds"][name] / len(row["frames"]) for row in rows])
    turn, shift = (_interval([each.gain(scale)[at] for each in others]) for at in (0, 1))
    line = (
        f"| {name} | {len(known)} of {len(right)} | {scale:.1f} | {errors[0]:.2f}, {errors[1]:.2f} "
        f"| {detections(others)} | {detections(wrong)} | {detections(pushed)} | {turn} | {shift} | {seconds:.1f} |"
    )
    kinds: dict[str, list[Stated]] = defaultdict(list)
    for each in wrong:
        kinds[each.words["kind"] if each.words["source"] != ACFR.name else ACFR.name].append(each)
    surprises = {id(each.words): each.surprise(scale) / bound for each in every}
    return line, {kind: detections(its) for kind, its in kinds.items()}, surprises


def _any(rows: Sequence[Mapping[str, Any]], surprise: Mapping[int, float]) -> str:
    """Return the rest of the line of the largest surprise of all cues."""
    bound = _bound([surprise[id(r)] for r in rows if r["case"] == "right" and r["source"] in TUNED])
    chosen_rows: Callable[[str], list[Any]] = lambda case: [r for r in rows if r["case"] == case]  # noqa: E731
    others = [r for r in chosen_rows("right") if r["source"] not in TUNED]
    counts = [
        f"{sum(surprise[id(r)] > bound for r in its)} of {len(its)}"
        for its in (others, chosen_rows("wrong"), chosen_rows("moved"))
    ]
    return f"- | - | - | {' | '.join(counts)} | - | - | - |"


def _of(every: Sequence[Stated], case: str) -> list[Stated]:
    return [each for each in every if each.words["case"] == case]


def _tuned(each: Stated) -> bool:
    return each.words["source"] in TUNED


def _bound(values: Sequence[float]) -> float:
    return float(np.quantile(values, 1 - ALARM)) if values else 1.0


def _interval(gains: Sequence[float]) -> str:
    """Return the mean of paired differences with its 95 % interval by the bootstrap."""
    if not gains:
        return "-"
    draws = np.random.default_rng(0).choice(np.array(gains), (_DRAWS, len(gains))).mean(axis=1)
    low, high = np.quantile(draws, [0.025, 0.975])
    return f"{np.mean(gains):+.3f} [{low:+.3f}, {high:+.3f}]"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    measuring = commands.add_parser("measure", help="measure what has no row yet")
    measuring.add_argument("rows", type=Path, help="rows of adversarial.py")
    measuring.add_argument("--out", type=Path, required=True)
    measuring.add_argument("--cues", nargs="+", choices=CUES, default=list(CUES), metavar="CUE")
    measuring.add_argument("--most", type=int, default=8, help="results of each source, kind and number of frames")
    measuring.add_argument("--features", type=Path, help="folder in which features are kept (deleting it is safe)")
    driving = commands.add_parser("drives", help="print what motion states about results of drives")
    driving.add_argument("--drives", nargs="+", choices=DRIVES, default=list(DRIVES), metavar="DRIVE")
    tabling = commands.add_parser("table", help="print the tables")
    tabling.add_argument("rows", type=Path)
    options = parser.parse_args(arguments)
    if options.command == "drives":
        for line in of_drives(options.drives):
            print(line, flush=True)
        return 0
    done = [loads(line) for line in options.out.read_text().splitlines()] if _exists(options) else []
    if options.command == "table":
        print(table([loads(line) for line in options.rows.read_text(encoding="utf-8").splitlines()]))
        return 0
    measure(read(options.rows), options, {_key(words) for words in done})
    return 0


def _exists(options: argparse.Namespace) -> bool:
    return options.command == "measure" and options.out.exists()


def _key(words: Mapping[str, Any]) -> tuple[str, str, str, tuple[str, ...]]:
    return words["source"], words["kind"], words["variant"], tuple(words["frames"])


def measure(rows: Sequence[Row], options: argparse.Namespace, done: set[Any]) -> None:
    """Measure the chosen rows that are not done, and the frames of `acfr_vlp16`, whose reference is in question."""
    registry, by_source = Registry.load(), defaultdict(list)
    for number, row in enumerate(chosen(rows, options.most)):
        by_source[row.source].append((number, row))
    for source in (ACFR, *SOURCES):
        its = [(n, row) for n, row in by_source[source.name] if row.key not in done]
        if not its and source is not ACFR:
            continue
        bench = Bench(source, registry, options.features)
        if source is ACFR:
            own = chosen(bench.rows(["unchanged"], done), options.most)
            its = [(0, row) for row in own]
        for number, row in its:
            again = not row.wrong and number % 2 == 1
            for words in measured(bench, row, options.cues, again=again):
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(dumps(words) + "\n")
        print(f"{source.name}: {len(its)} results", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
