"""Count trusted results among inputs whose result is wrong, or may be, and refusals among unchanged ones.

    python benchmarks/adversarial.py run --out rows.jsonl [--sources NAME ...] [--kinds KIND ...]
    python benchmarks/adversarial.py table rows.jsonl
    python benchmarks/adversarial.py worst rows.jsonl --out FOLDER     # overlays of the ten worst false accepts

Frames of simulated and real rigs (`adversarial_cases.py`) are calibrated one at a time and four together from 2 deg and
15 cm, as they are and with every change that their source allows. A false accept is a trusted result where no pose is
right (another moment or camera, a mirrored image, wrong axes or units), and elsewhere one that is over 1 deg or 30 cm
from the truth. A false refusal is a result within 0.5 deg and 15 cm that is not trusted. `run` goes on where it was
stopped; images may not be shown for all sources (KITTI and others), see docs/data-cards.md.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from json import dumps, loads
from pathlib import Path
from typing import Any

import numpy as np
from adversarial_cases import KINDS, NO_POSE, SOURCES, Change, Source, changes_of
from p2o import Frame, InputError, Registry
from p2o.cache import FeatureCache, content_hash
from p2o.draw.overlay import draw, write_png
from p2o.features.view import View
from p2o.frames.scale import image_at_scale
from p2o.frames.selection import select
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import pose_error
from p2o.results.result import Result
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe

START_DEG, START_M = 2.0, 0.15
WRONG_DEG, WRONG_M = 1.0, 0.3
GOOD_DEG, GOOD_M = 0.5, 0.15
TOGETHER = 4
SPLITS = Path(__file__).with_name("splits.json")


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
    pose: tuple[tuple[float, ...], ...] = ()

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
        """Whether the pose is over 1 deg or 30 cm off, or none is right."""
        return self.kind in NO_POSE or self.rotation_deg > WRONG_DEG or self.translation_m > WRONG_M

    @property
    def good(self) -> bool:
        """Whether the pose is within 0.5 deg and 15 cm where one is right."""
        return self.kind not in NO_POSE and self.rotation_deg < GOOD_DEG and self.translation_m < GOOD_M

    @property
    def outside(self) -> bool:
        """Whether the error exceeds the 95 % bound."""
        return self.rotation_deg > self.bound_deg or self.translation_m > self.bound_m


def read(path: Path) -> list[Row]:
    """Return the rows of a file."""
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        words = loads(line)
        words |= {name: tuple(words[name]) for name in ("frames", "why")}
        rows.append(Row(**words))
    return rows


class Bench:
    """Frames of one source, and features of whatever is calibrated."""

    def __init__(self, source: Source, registry: Registry, kept: Path | None) -> None:
        options = {name: dict(its) for name, its in source.options.items()}
        plan = Recipe.of(data=source.data, extractor=source.extractor, options=options).resolve(registry)
        calibrator = plan.calibrator()
        assert isinstance(calibrator, Pipeline)
        self.source, self.pipeline, self.dataset = source, calibrator, plan.dataset()
        names = list(self.dataset.names)
        numbers = list(select(names, source.frames.format(splits=SPLITS)))
        if source.after:
            numbers = [n for n in numbers[:-1] if n + 1 in set(numbers)]
            numbers = numbers[::2] if source.name.startswith("sim-") else numbers
        if len(numbers) > source.most:
            numbers = [numbers[at] for at in np.linspace(0, len(numbers) - 1, source.most).round().astype(int)]
        self.frames = [self.dataset[n] for n in numbers]
        self.following = {names[n]: self.dataset[n + 1] for n in numbers} if source.after else {}
        self.cache = None if kept is None else FeatureCache(kept)
        self.known: dict[str, View] = {}

    def view(self, frame: Frame) -> View:
        """Return the features of a frame, from the cache where they are known."""
        pipeline, word, image = self.pipeline, self.source.extractor, image_at_scale(frame.image)
        edges = self._kept([word, "image", image.rgb], lambda: pipeline.image_extractor(image))
        sweep = self._kept([word, "sweep", frame.cloud.xyz], lambda: pipeline.cloud_extractor(frame.cloud))
        return pipeline.view(frame.name, frame.camera, edges, sweep, frame.twist)

    def _kept(self, parts: Sequence[Any], made: Callable[[], Any]) -> Any:
        if self.cache is None:
            return made()
        key = content_hash(parts)
        entry = self.cache.get(key)
        if entry is None:
            self.cache.put(key, made(), 0.0)
            entry = self.cache.get(key)
        assert entry is not None
        return entry.features

    def groups(self) -> list[list[int]]:
        """Return the numbers of frames that are calibrated together: each alone, and four from all over."""
        alone = [[n] for n in range(len(self.frames))]
        if not self.source.together or len(self.frames) < TOGETHER:
            return alone
        step = len(self.frames) // TOGETHER
        return alone + [[first + step * n for n in range(TOGETHER)] for first in range(step)]

    def rows(self, kinds: Sequence[str] | None, done: set[Any]) -> Iterator[Row]:
        """Yield the rows that are not done."""
        for kind, variants in self.changes().items():
            if kinds and kind not in kinds:
                continue
            for variant, change in variants.items():
                for group in self.groups_of(kind):
                    row = Row(self.source.name, kind, variant, tuple(self.frames[n].name for n in group), "")
                    if row.key not in done:
                        yield self.measured(row, change, group)

    def changes(self) -> Mapping[str, Mapping[str, Change]]:
        """Return the changes for the source, by kind and variant."""
        changes: dict[str, dict[str, Change]] = changes_of(self.source, self.following)
        if self.source.kind == "unchanged":
            changes["duplicated frames"] = {"": lambda frames, n: frames[n]}
        return changes

    def groups_of(self, kind: str) -> list[list[int]]:
        """Return what is calibrated together with a kind of change."""
        if kind == "duplicated frames":
            return [[n] * 2 * TOGETHER for n in range(len(self.frames))]
        return self.groups()

    def result(self, change: Change, group: Sequence[int]) -> tuple[Result, list[Frame], list[View]]:
        """Return the result of a group with a change, its frames and views; raises InputError where it is refused."""
        frames = [change(self.frames, n) for n in group]
        views = [self.view(frame) for frame in frames]
        truth = self.frames[group[0]].camera_from_lidar
        assert truth is not None
        rng = np.random.default_rng([len(group), group[0]])
        return self.pipeline.solve(views, wrong_start(truth, START_DEG, START_M, rng)), frames, views

    def measured(self, row: Row, change: Change, group: Sequence[int]) -> Row:
        """Return the row with its result."""
        try:
            result, _, _ = self.result(change, group)
        except InputError as error:
            return replace(row, verdict="error", why=(str(error),))
        truth, accuracy = self.frames[group[0]].camera_from_lidar, result.accuracy
        assert truth is not None
        off = pose_error(result.camera_from_lidar, truth)
        return replace(
            row,
            verdict=str(result.verdict.trust),
            why=tuple(str(reason.doubt) for reason in result.verdict.reasons),
            rotation_deg=round(off.rotation_deg, 4),
            translation_m=round(off.translation_m, 5),
            bound_deg=np.inf if accuracy is None else round(accuracy.rotation_deg_95, 4),
            bound_m=np.inf if accuracy is None else round(accuracy.translation_m_95, 5),
            pose=tuple(tuple(line) for line in np.round(result.camera_from_lidar, 7).tolist()),
        )


def table(rows: Sequence[Row]) -> str:
    """Return the counts by kind, and those of unchanged frames by source, as tables in Markdown."""
    by_kind: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        by_kind[row.kind].append(row)
    lines = [
        "| kind | n (sources) | trusted | false accepts | trusted, outside the 95 % bound | good, not trusted "
        "| median error of trusted | reasons of the others |",
        "|---|---|---|---|---|---|---|---|",
    ]
    changed = [row for row in rows if row.kind != "unchanged"]
    lines += [_line(kind, its) for kind, its in by_kind.items()]
    lines.append(_line("all but unchanged", changed))
    by_source: dict[str, list[Row]] = defaultdict(list)
    for row in changed:
        by_source[row.source].append(row)
    lines += ["", "| source | n | trusted | false accepts |", "|---|---|---|---|"]
    for source, its in by_source.items():
        lines.append(f"| {source} | {len(its)} | {sum(r.trusted for r in its)} | {_share(its)} |")
    return "\n".join(lines)


def _share(rows: Sequence[Row]) -> str:
    wrong = sum(row.trusted and row.wrong for row in rows)
    return f"{wrong} ({100 * wrong / len(rows):.1f} %)"


def _line(kind: str, rows: Sequence[Row]) -> str:
    trusted = [row for row in rows if row.trusted]
    good = [row for row in rows if row.good]
    refused = sum(not row.trusted for row in good)
    bounds = "-" if kind in NO_POSE else str(sum(row.outside for row in trusted))
    error = "-"
    if trusted and kind not in NO_POSE:
        turn, shift = (float(np.median([getattr(r, n) for r in trusted])) for n in ("rotation_deg", "translation_m"))
        error = f"{turn:.2f} deg, {100 * shift:.1f} cm"
    why = Counter("input error" if row.verdict == "error" else row.why[0] for row in rows if not row.trusted)
    words = ", ".join(f"{reason} {count}" for reason, count in why.most_common(4))
    sources = len({row.source for row in rows})
    good_words = "-" if kind in NO_POSE else f"{refused} of {len(good)}"
    return (
        f"| {kind} | {len(rows)} ({sources}) | {len(trusted)} | {_share(rows)} | {bounds} | {good_words} "
        f"| {error} | {words} |"
    )


def draw_worst(rows: Sequence[Row], out: Path, kept: Path | None, count: int = 10) -> None:
    """Write overlays of the false accepts with the largest errors to a folder, and print what they show."""
    worst = sorted(
        (r for r in rows if r.trusted and r.wrong), key=lambda r: r.rotation_deg / WRONG_DEG + r.translation_m / WRONG_M
    )
    registry, sources = Registry.load(), {source.name: source for source in SOURCES}
    out.mkdir(parents=True, exist_ok=True)
    for number, row in enumerate(reversed(worst[-count:])):
        bench = Bench(sources[row.source], registry, kept)
        names = [frame.name for frame in bench.frames]
        change = bench.changes()[row.kind][row.variant]
        frame = change(bench.frames, names.index(row.frames[0]))
        view = bench.view(frame)
        path = out / f"{number}-{row.source}-{row.kind.replace(' ', '-')}.png"
        camera = view.camera
        rgb = image_at_scale(frame.image).rgb
        write_png(path, draw(rgb, view.image_edges, view.cloud_edges, camera, np.array(row.pose)))
        print(
            f"{path.name}: {row.kind} {row.variant}, {len(row.frames)} frames, "
            f"{row.rotation_deg:.2f} deg, {100 * row.translation_m:.0f} cm"
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    running = commands.add_parser("run", help="calibrate what has no row yet")
    running.add_argument("--out", type=Path, required=True, help="file of rows, JSON lines")
    running.add_argument("--sources", nargs="+", choices=[source.name for source in SOURCES], metavar="NAME")
    running.add_argument("--kinds", nargs="+", choices=KINDS, metavar="KIND")
    running.add_argument("--features", type=Path, help="folder in which features are kept (deleting it is safe)")
    tabling = commands.add_parser("table", help="print the tables")
    tabling.add_argument("rows", type=Path)
    drawing = commands.add_parser("worst", help="draw the ten worst false accepts")
    drawing.add_argument("rows", type=Path)
    drawing.add_argument("--out", type=Path, required=True)
    drawing.add_argument("--features", type=Path)
    options = parser.parse_args(arguments)
    if options.command == "table":
        print(table(read(options.rows)))
    elif options.command == "worst":
        draw_worst(read(options.rows), options.out, options.features)
    else:
        registry, done = Registry.load(), {row.key for row in read(options.out)}
        for source in SOURCES:
            if options.sources and source.name not in options.sources:
                continue
            bench, count = Bench(source, registry, options.features), 0
            for row in bench.rows(options.kinds, done):
                with options.out.open("a", encoding="utf-8") as file:
                    file.write(dumps(asdict(row)) + "\n")
                count += 1
            print(f"{source.name}: {count} results", file=sys.stderr, flush=True)
        print(table(read(options.out)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
