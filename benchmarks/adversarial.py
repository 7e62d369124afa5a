"""Count trusted results among inputs whose result is wrong, or may be, and refusals among unchanged ones.

    python benchmarks/adversarial.py run --out rows.jsonl
    python benchmarks/adversarial.py table rows.jsonl

Frames of simulated and real rigs (`adversarial_cases.py`) are calibrated one at a time and four together from 2 deg and
15 cm, as they are and with every change that their source allows. A false accept is a trusted result where no pose is
right (another moment or camera, a mirrored image, wrong axes or units), and elsewhere one that is over 1 deg or 30 cm
from the truth. A false refusal is a result within 0.5 deg and 15 cm that is not trusted. `run` continues where it was
stopped.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from adversarial_cases import NO_POSE, NOT_OBSERVABLE, SOURCES, Change, Source, changes_of
from limits_and_tables import (
    SPLITS,
    START_DEG,
    START_M,
    add_row,
    cached,
    grouped,
    is_good,
    is_wrong,
    read_rows,
    size,
    table,
)
from p2o import Frame, InputError, Registry
from p2o.cache import FeatureCache, content_hash
from p2o.features.view import View
from p2o.frames.scale import image_at_scale
from p2o.frames.selection import select, spread
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import pose_error
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe

TOGETHER = 4
"""Number of frames of a joint calibration."""


@dataclass(frozen=True)
class Row:
    """One calibration: source, kind and variant of the change, names of the frames, and what the result states.

    `verdict` is that of the result, "error" where the input was refused with a message, which is the first of `why`.
    """

    source: str
    kind: str
    variant: str
    frames: tuple[str, ...]
    verdict: str
    why: tuple[str, ...] = ()
    rotation_deg: float = np.inf
    translation_m: float = np.inf
    bound_deg: float = np.inf
    bound_m: float = np.inf

    @property
    def key(self) -> tuple[str, str, str, tuple[str, ...]]:
        """What identifies the calibration."""
        return self.source, self.kind, self.variant, self.frames

    @property
    def trusted(self) -> bool:
        """Whether the result is trusted."""
        return self.verdict == "trusted"

    @property
    def wrong(self) -> bool:
        """Whether the error is large, or no pose is right."""
        return self.kind in NO_POSE or is_wrong(self.rotation_deg, self.translation_m)

    @property
    def good(self) -> bool:
        """Whether the error is small and a pose is right."""
        return self.kind not in NO_POSE and is_good(self.rotation_deg, self.translation_m)

    @property
    def outside(self) -> bool:
        """Whether the error exceeds the 95 % bound."""
        return self.rotation_deg > self.bound_deg or self.translation_m > self.bound_m


def read(path: Path) -> list[Row]:
    """Return the rows of a file."""
    lists = ("frames", "why")
    return [Row(**{**values, **{name: tuple(values[name]) for name in lists}}) for values in read_rows(path)]


class Bench:
    """Frames of one source, and their features with each change; `features` is the folder of the latter."""

    def __init__(self, source: Source, registry: Registry, features: Path | None) -> None:
        plan = Recipe.of(data=source.data).resolve(registry)
        calibrator, dataset = plan.calibrator(), plan.dataset()
        assert isinstance(calibrator, Pipeline)
        self.source, self.pipeline = source, calibrator
        self.cache = None if features is None else FeatureCache(features)
        numbers = list(select(dataset.names, source.frames.format(splits=SPLITS)))
        if source.after:
            numbers = [n for n in numbers[:-1] if n + 1 in set(numbers)]
            numbers = numbers[::2] if source.name.startswith("sim-") else numbers
        numbers = spread(numbers, source.most)
        self.frames = [dataset[n] for n in numbers]
        following = {dataset.names[n]: dataset[n + 1] for n in numbers} if source.after else {}
        self.changes: dict[str, dict[str, Change]] = changes_of(source, following)

    def view(self, frame: Frame) -> View:
        """Return the features of a frame, from the cache where they are known."""
        pipeline, image, cloud = self.pipeline, image_at_scale(frame.image), frame.cloud
        keys = (
            content_hash(["p2ornet/rings", "image", image.rgb]),
            content_hash(["p2ornet/rings", "sweep", cloud.xyz]),
        )
        edges = cached(self.cache, keys[0], partial(pipeline.image_extractor, image))
        sweep = cached(self.cache, keys[1], partial(pipeline.cloud_extractor, cloud))
        return pipeline.view(frame.name, frame.camera, edges, sweep, frame.twist)

    def groups(self, kind: str) -> list[list[int]]:
        """Return the numbers of frames that are calibrated jointly with a kind of change: each alone, and four."""
        if kind == "duplicated frames":
            return [[n] * 2 * TOGETHER for n in range(len(self.frames))]
        alone = [[n] for n in range(len(self.frames))]
        if not self.source.together or len(self.frames) < TOGETHER:
            return alone
        step = len(self.frames) // TOGETHER
        return alone + [[first + step * n for n in range(TOGETHER)] for first in range(step)]

    def jobs(self) -> list[tuple[Row, Change, list[int]]]:
        """Return the rows to measure, each with its change and the numbers of its frames."""
        return [
            (Row(self.source.name, kind, variant, tuple(self.frames[n].name for n in group), ""), change, group)
            for kind, variants in self.changes.items()
            for variant, change in variants.items()
            for group in self.groups(kind)
        ]

    def measured(self, row: Row, change: Change, group: Sequence[int]) -> Row:
        """Return the row with its result."""
        truth = self.frames[group[0]].camera_from_lidar
        assert truth is not None
        start = wrong_start(truth, START_DEG, START_M, np.random.default_rng([len(group), group[0]]))
        try:
            result = self.pipeline.solve([self.view(change(self.frames, n)) for n in group], start)
        except InputError as error:
            return replace(row, verdict="error", why=(str(error),))
        error, accuracy = pose_error(result.camera_from_lidar, truth), result.accuracy
        return replace(
            row,
            verdict=str(result.verdict.trust),
            why=tuple(str(reason.doubt) for reason in result.verdict.reasons),
            rotation_deg=round(error.rotation_deg, 4),
            translation_m=round(error.translation_m, 5),
            bound_deg=np.inf if accuracy is None else round(accuracy.rotation_deg_95, 4),
            bound_m=np.inf if accuracy is None else round(accuracy.translation_m_95, 5),
        )


HEAD = (
    "kind", "n (sources)", "trusted", "false accepts", "trusted, outside the 95 % bound", "good, not trusted",
    "median error of trusted", "reasons of the others"
)  # fmt: skip


def tables(rows: Sequence[Row]) -> str:
    """Return the counts by kind, and those of changed frames by source, as tables in Markdown."""
    changed = [row for row in rows if row.kind != "unchanged"]
    groups = grouped(rows, lambda row: row.kind)
    groups["all but unchanged"] = changed
    groups["of these observable"] = [row for row in changed if row.kind not in NOT_OBSERVABLE]
    by_kind = table(HEAD, [_line(kind, group) for kind, group in groups.items()])
    by_source = [
        (source, len(group), sum(row.trusted for row in group), _false_accepts(group))
        for source, group in grouped(changed, lambda row: row.source).items()
    ]
    return f"{by_kind}\n\n{table(('source', 'n', 'trusted', 'false accepts'), by_source)}"


def _false_accepts(rows: Sequence[Row]) -> str:
    wrong = sum(row.trusted and row.wrong for row in rows)
    return f"{wrong} ({100 * wrong / len(rows):.1f} %)"


def _line(kind: str, rows: Sequence[Row]) -> tuple[object, ...]:
    if not rows:
        return kind, *[""] * (len(HEAD) - 1)
    trusted, good = [row for row in rows if row.trusted], [row for row in rows if row.good]
    has_pose = kind not in NO_POSE
    error = np.median([(row.rotation_deg, row.translation_m) for row in trusted], axis=0) if trusted else None
    reasons = Counter("input error" if row.verdict == "error" else row.why[0] for row in rows if not row.trusted)
    return (
        kind,
        f"{len(rows)} ({len({row.source for row in rows})})",
        len(trusted),
        _false_accepts(rows),
        sum(row.outside for row in trusted) if has_pose else "-",
        f"{sum(not row.trusted for row in good)} of {len(good)}" if has_pose else "-",
        size(*error) if has_pose and error is not None else "-",
        ", ".join(f"{reason} {count}" for reason, count in reasons.most_common(4)),
    )


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="calibrate what has no row yet")
    running.add_argument("--out", type=Path, required=True, help="file of rows, JSON lines")
    running.add_argument("--features", type=Path, help="folder of extracted features (deleting it is safe)")
    tabling = commands.add_parser("table", help="print the tables")
    tabling.add_argument("rows", type=Path)
    options = parser.parse_args()
    if options.command == "run":
        registry, done = Registry.load(), {row.key for row in read(options.out)}
        for source in SOURCES:
            bench = Bench(source, registry, options.features)
            jobs = [job for job in bench.jobs() if job[0].key not in done]
            for job in jobs:
                add_row(options.out, asdict(bench.measured(*job)))
            print(f"{source.name}: {len(jobs)} results", file=sys.stderr, flush=True)
    print(tables(read(options.out if options.command == "run" else options.rows)))


if __name__ == "__main__":
    main()
