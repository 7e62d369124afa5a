"""Measure the coverage of predicted errors and verdicts on sensors that they were not fitted on.

    python benchmarks/verdicts.py collect --out DIR            # calibrates frames of many rigs: hours
    python benchmarks/verdicts.py fit --rows DIR               # the error model, and its coverage
    python benchmarks/verdicts.py fit --rows DIR --by lidar    # the same, all rigs with one kind of LiDAR left out

`collect` calibrates frames of simulated and real rigs (`verdict_rigs.py`) from 2 deg / 0.15 m, one at a time and three
and eight together, and wrong pairs of image and sweep: with the sweep of another frame, or turned, where all frames
show one place. It adds a JSON line for each to DIR/rows.jsonl, and goes on where it was stopped. `fit` fits error
models to results whose agreement is sufficient, without the rig of each line of the table. Coverage in %: 67 % bound of
rotation / translation, then 95 % bound; bound and error are medians. Good are errors below 0.5 deg and 15 cm, false
accepts trusted results over 1 deg or 30 cm off, and trusted wrong pairs. Last are the models of all rigs, for
`p2o.confidence.accuracy`. Errors below that of a rig's own truth count as covered.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import p2o.confidence.assessment as assessment
from p2o.arrays import Float
from p2o.calibration.options import PipelineOptions
from p2o.confidence.accuracy import ErrorBudget, ErrorModel, likely_accuracy, or_rival
from p2o.confidence.verdict import verdict_of
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import place_by_update, pose_error
from p2o.results.evidence import Accuracy, Agreement, Rival
from p2o.results.result import Result
from verdict_rigs import RIGS, Rig, Seen, lidar_of, seen

START_DEG, START_M = 2.0, 0.15
WRONG_DEG, WRONG_M = 1.0, 0.3
AXES = ("pitch_deg", "yaw_deg", "roll_deg", "x_m", "y_m", "z_m")
SHARES = (0.70, 0.95)
"""Of the errors, those that are to be within the first bounds and the second, where a rig with few results counts as
much more as it does here: of all results on rigs left out 0.72 and 0.97 are.
"""
USUAL = {
    "pairs": 1.1,
    "by_odds": 0.5,
    "beams": 1.2,
    "rings": 0.65,
    "view_deg": 0.05,
    "view_m": 0.01,
    "floor_deg": 0.019,
    "floor_m": 0.007,
}
"""The numbers of a model that a fit begins from."""
BUDGET = ("pairs", "beams", "objects", "rings", "cameras", "absorbed")
IN_QUESTION = ("acfr_vlp16", "nuscenes")
"""Rigs whose references may be wrong by more than the errors; evaluated, but no part of a fit. All groups of edges of
acfr_vlp16 (near and far, horizontal and vertical) contradict the reference by about 1 deg of pitch; that of nuscenes is
mapped between moments of a moving car.
"""
STRONG = (12.0, 12.0)
"""Strength of the agreement below which 95 % bounds are wider: without intervals, and with."""
FREEDOM = 4.0
"""Errors are fitted as Student's t of so few degrees of freedom: some edges are taken for others."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    collecting = commands.add_parser("collect", help="calibrate, and write what there is to know")
    collecting.add_argument("--out", type=Path, required=True, help="folder of rows.jsonl, and of features")
    collecting.add_argument("--rigs", help="names with commas; all by default")
    collecting.add_argument("--most", type=int, default=12, help="frames of a rig, spread evenly")
    collecting.add_argument("--splits", default="benchmarks/splits.json", help="file that names KITTI's train frames")
    fitting = commands.add_parser("fit", help="fit the model, one rig left out at a time")
    fitting.add_argument("--rows", type=Path, required=True, help="folder of rows.jsonl")
    fitting.add_argument("--by", choices=("rig", "lidar"), default="rig", help="what is left out at a time")
    arguments = parser.parse_args()
    if arguments.command == "collect":
        collect(arguments.out, arguments.rigs, arguments.most, arguments.splits)
    else:
        rows = [Row.of(line) for line in (arguments.rows / "rows.jsonl").read_text().splitlines()]
        print(report(rows, lidar_of if arguments.by == "lidar" else str))


@dataclass(frozen=True)
class Job:
    """Frames by number to calibrate together; `others` are those whose sweeps they get, `turned_deg` turns these."""

    frames: tuple[int, ...]
    seed: int = 0
    others: tuple[int, ...] = ()
    turned_deg: float = 0.0

    @property
    def kind(self) -> str:
        """Right, or wrong."""
        return "wrong" if self.others or self.turned_deg else "right"

    def views(self, frames: Sequence[Seen]) -> list[View]:
        """Return what is calibrated."""
        views = [frames[number].view for number in self.frames]
        turn = se3.exp(np.array([0, 0, np.radians(self.turned_deg), 0, 0, 0]))
        if self.turned_deg:
            return [view.moved(turn) for view in views]
        sweeps = self.others or self.frames
        return [replace(view, cloud=frames[number].view.cloud) for view, number in zip(views, sweeps, strict=True)]


def jobs(rig: Rig, count: int, groups: Sequence[Sequence[int]]) -> Iterator[Job]:
    """Give what to calibrate of `count` frames; `groups` are those that may be solved together."""
    for number in range(count):
        for seed in range(rig.seeds):
            yield Job((number,), seed)
        if rig.one_place:
            yield Job((number,), turned_deg=100.0 + 20 * number % 60)
        else:
            yield Job((number,), others=((number + 7) % count,))
    rng = np.random.default_rng(1)
    for group in groups:
        for size, times in ((3, 3), (8, 2)):
            for _ in range(times if len(group) > size else len(group) == size):
                drawn = tuple(sorted(rng.choice(group, size, replace=False).tolist()))
                yield Job(drawn, int(rng.integers(1000)))
        if len(group) > 4 and not rig.one_place:
            for _ in range(2):
                drawn = tuple(sorted(rng.choice(group, 3, replace=False).tolist()))
                yield Job(drawn, others=tuple((number + 1 + count // 2) % count for number in drawn))


def collect(out: Path, names: str | None, most: int, splits: str) -> None:
    """Calibrate all rigs that are asked for, and add a line for each job that has none yet."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "rows.jsonl"
    known = {json.loads(line)["key"] for line in path.read_text().splitlines()} if path.exists() else set()
    for rig in RIGS:
        if names is not None and rig.name not in names.split(","):
            continue
        frames = list(seen(rig, out / "features", splits, most))
        pipeline, count = rig.plan.calibrator(), len(frames)
        for job in jobs(rig, count, rig.groups([frame.view.name for frame in frames])):
            key = f"{rig.name} {job}"
            if key in known:
                continue
            truth = frames[job.frames[0]].truth
            rng = np.random.default_rng([job.seed, job.frames[0], len(job.frames)])
            with _Recorded() as recorded:
                result = pipeline.solve(job.views(frames), wrong_start(truth, START_DEG, START_M, rng))
            row = {"key": key, "rig": rig.name, "kind": job.kind, **measured(result, truth, recorded.budget)}
            cameras = [frames[number].view.camera for number in job.frames]
            row |= {"truth_deg": rig.truth_deg, "truth_m": rig.truth_m, "focal_px": cameras[0].focal_px}
            with path.open("a") as file:
                file.write(json.dumps(row) + "\n")
        print(f"{rig.name}: {count} frames", flush=True)


class _Recorded:
    """Record the inputs of a pipeline's predicted error."""

    budget: ErrorBudget | None = None

    def __enter__(self) -> _Recorded:
        self._made = assessment.likely_accuracy
        assessment.likely_accuracy = self._record
        return self

    def __exit__(self, *problem: object) -> None:
        assessment.likely_accuracy = self._made

    def _record(self, budget: ErrorBudget, *rest: Any) -> Accuracy:
        self.budget = budget
        return self._made(budget, *rest)


def measured(result: Result, truth: Float, budget: ErrorBudget | None) -> dict[str, Any]:
    """Return what there is to know about a result, as JSON."""
    error, moved = pose_error(result.camera_from_lidar, truth), se3.inverse(result.start) @ result.camera_from_lidar
    row: dict[str, Any] = {
        "frames": len(result.frames),
        "status": result.status.value,
        "trust": result.verdict.trust.value,
        "doubts": [reason.doubt.value for reason in result.verdict.reasons],
        "rotation_deg": error.rotation_deg,
        "translation_m": error.translation_m,
        "axes": [error.per_axis[axis] for axis in AXES],
        "pose": result.camera_from_lidar.tolist(),
        "moved_deg": se3.angle_deg(moved),
        "moved_m": se3.distance_m(moved),
        "pairs": sum(result.matches.values()),
        "residual_px": dict(result.residual_px),
    }
    for name in ("accuracy", "agreement", "rival", "judged"):
        part = getattr(result, name)
        row[name] = None if part is None else asdict(part)
    row["budget"] = None
    if budget is not None:
        row["budget"] = {name: getattr(budget, name).tolist() for name in BUDGET}
        row["budget"] |= {"views": budget.views, "intervals": budget.intervals}
    return row


@dataclass(frozen=True, eq=False)
class Row:
    """One line of rows.jsonl; `error` (6,) by `AXES` in rad and m."""

    values: Mapping[str, Any]
    error: Float
    budget: ErrorBudget | None
    pose: Float

    @classmethod
    def of(cls, line: str) -> Row:
        """Read a line."""
        values = json.loads(line)
        axes = np.array(values["axes"], np.float64)
        axes[:3] = np.radians(axes[:3])
        budget = values["budget"]
        if budget is not None:
            budget = ErrorBudget(**budget | {name: np.array(budget[name]) for name in BUDGET})
        return cls(values, axes, budget, np.array(values["pose"]))

    @property
    def rig(self) -> str:
        """The name of its rig."""
        return str(self.values["rig"])

    @property
    def right(self) -> bool:
        """True for an image with its own sweep."""
        return bool(self.values["kind"] == "right")

    @property
    def fits(self) -> bool:
        """True for right pairs whose agreement is sufficient, of rigs with a reference that is not in question."""
        return self.right and self.budget is not None and not self.weak and self.rig not in IN_QUESTION

    @property
    def weak(self) -> bool:
        """True where the verdict doubts the pose for another reason than its predicted error."""
        return bool({"little-agreement", "rival-pose", "too-few-places", "camera"} & set(self.values["doubts"]))

    @property
    def good(self) -> bool:
        """True for errors below 0.5 deg and 15 cm."""
        return bool(self.values["rotation_deg"] < GOOD_DEG and self.values["translation_m"] < GOOD_M)

    @property
    def intervals(self) -> bool:
        """True for poses by the interval likelihood."""
        return self.budget is not None and self.budget.intervals

    @property
    def agreement(self) -> Agreement:
        """How the edges meet."""
        return Agreement(**self.values["agreement"])

    @property
    def off(self) -> bool:
        """True for wrong pairs, and for errors over 1 deg or 30 cm."""
        values = self.values
        return not self.right or bool(values["rotation_deg"] > WRONG_DEG or values["translation_m"] > WRONG_M)

    @property
    def predicted(self) -> Accuracy | None:
        """What the result values."""
        return None if self.values["accuracy"] is None else Accuracy(**self.values["accuracy"])

    def likely(self, model: ErrorModel) -> Accuracy | None:
        """What it says by another model."""
        if self.budget is None:
            return None
        predicted = likely_accuracy(self.budget, self.pose, self.agreement, model)
        return or_rival(predicted, self.rival, PipelineOptions().min_lead_edges)

    @property
    def rival(self) -> Rival | None:
        """The next best pose."""
        return None if self.values["rival"] is None else Rival(**self.values["rival"])

    def covered(self, accuracy: Accuracy | None) -> list[bool]:
        """Return whether rotation and translation are within the first bounds, then within the second."""
        if accuracy is None:
            return [False] * 4
        rotation, translation = self.values["rotation_deg"], self.values["translation_m"]
        rotation, translation = (
            0.0 if error <= good else error
            for error, good in ((rotation, self.values["truth_deg"]), (translation, self.values["truth_m"]))
        )
        return [
            rotation <= accuracy.rotation_deg,
            translation <= accuracy.translation_m,
            rotation <= accuracy.rotation_deg_95,
            translation <= accuracy.translation_m_95,
        ]

    def trusted(self, accuracy: Accuracy | None, options: PipelineOptions) -> bool:
        """Return whether a result with this predicted error would be trusted."""
        if accuracy is None or self.values["status"] not in ("converged", "rounds-spent") or self.weak:
            return False
        return verdict_of(self.agreement, self.rival, (), options, accuracy).trusted


@dataclass(frozen=True, eq=False)
class _Errors:
    """Results of right pairs whose agreement is sufficient: errors (K, 6) by axis, parts (K, 3, 6) of their variance,
    odds ratios over 10 and views (K,), weights (K,) and variances (K, 6) of the references.
    """

    rows: Sequence[Row]
    error: Float
    parts: Float
    odds: Float
    views: Float
    weight: Float
    known: Float

    @classmethod
    def of(cls, rows: Sequence[Row]) -> _Errors:
        """Return the errors of rows of one kind; each rig counts as the root of its rows."""
        number = Counter(row.rig for row in rows)
        known = [[np.radians(row.values["truth_deg"])] * 3 + [row.values["truth_m"]] * 3 for row in rows]
        return cls(
            rows,
            np.stack([row.error for row in rows]),
            np.stack([_variances(row) for row in rows]),
            np.clip([row.agreement.odds_ratio for row in rows], 1.5, 40.0) / 10.0,
            np.array([row.budget.views for row in rows]),
            np.array([number[row.rig] ** -0.5 for row in rows]),
            np.square(known) / 3,
        )

    def variance(self, numbers: Mapping[str, float]) -> Float:
        """Return the variances (K, 6) of the errors by axis."""
        model = {name: numbers.get(name, 0.0) for name in USUAL}
        floor = np.square([np.radians(model["floor_deg"])] * 3 + [model["floor_m"]] * 3)
        view = np.square([np.radians(model["view_deg"])] * 3 + [model["view_m"]] * 3) / self.views[:, None]
        pairs = np.square(model["pairs"] * self.odds ** -model["by_odds"])[:, None] * self.parts[:, 0]
        beams, rings = model["beams"] ** 2 * self.parts[:, 1], model["rings"] ** 2 * self.parts[:, 2]
        return np.asarray(pairs + beams + rings + self.parts[:, 3] + view + floor)

    def unlikely(self, numbers: Mapping[str, float]) -> float:
        """Return the mean of minus the log-likelihood of the errors as Student's t."""
        total = self.variance(numbers) + self.known
        surprise = 0.5 * np.log(total) + (FREEDOM + 1) / 2 * np.log1p(self.error**2 / total / FREEDOM)
        return float(self.weight @ surprise.sum(axis=1) / self.weight.sum())

    def factors(self, numbers: Mapping[str, float], strong: float) -> tuple[Any, Any, float]:
        """Return the factors of rotation, of translation and by axis within which `SHARES` of the errors are."""
        axes = np.sqrt(self.variance(numbers))
        more = np.array([max(1.0, strong / max(np.nan_to_num(row.agreement.strength), 3.0)) for row in self.rows])
        ratios = []
        for part, name, good in ((slice(0, 3), "rotation_deg", "truth_deg"), (slice(3, 6), "translation_m", "truth_m")):
            size = np.linalg.norm(axes[:, part], axis=1)
            size = np.degrees(size) if name == "rotation_deg" else size
            wrong = np.array([row.values[name] if row.values[name] > row.values[good] else 0.0 for row in self.rows])
            within = zip((size, size * more), SHARES, strict=True)
            ratios.append(tuple(round(_quantile(wrong / its, self.weight, share), 2) for its, share in within))
        beyond = np.abs(self.error) / axes * (np.abs(self.error) > np.sqrt(self.known))
        return ratios[0], ratios[1], round(_quantile(beyond.ravel(), np.repeat(self.weight, 6), SHARES[0]), 2)


def fitted(rows: Sequence[Row], *, intervals: bool) -> ErrorModel:
    """Return the model of right pairs whose agreement is sufficient, with or without intervals.

    Parts and floors make the errors by axis most likely as Student's t; then factors are what holds for
    `SHARES` of the errors.
    """
    from scipy.optimize import minimize

    errors = _Errors.of([row for row in rows if row.fits and row.intervals is intervals])
    names = ("pairs", "view_deg", "view_m", "floor_deg", "floor_m") if intervals else tuple(USUAL)

    def unlikely(logarithms: Float) -> float:
        # A little towards what is usual: what the rows say nothing about stays there.
        drawn = 0.01 * np.square(logarithms - np.log([USUAL[name] for name in names])).sum()
        return errors.unlikely(dict(zip(names, np.exp(logarithms), strict=True))) + float(drawn)

    start = np.log([USUAL[name] for name in names])
    solution = np.exp(minimize(unlikely, start, method="Powell", options={"xtol": 1e-3, "ftol": 1e-6}).x)
    numbers = {name: float(f"{value:.2g}") for name, value in zip(names, solution, strict=True)}
    strong = STRONG[intervals]
    rotation, translation, axis = errors.factors(numbers, strong)
    model = {name: numbers.get(name, 0.0) for name in USUAL}
    return ErrorModel(**model, rotation=rotation, translation=translation, axis=axis, strong=strong)


def _variances(row: Row) -> Float:
    """Return the variances (4, 6) by axis that pairs, beams, rings and cameras make."""
    place, budget = place_by_update(row.pose), row.budget
    pairs, beams, cameras = (np.diag(place @ its @ place.T) for its in (budget.pairs, budget.beams, budget.cameras))
    return np.stack([pairs, beams, budget.rings**2, cameras])


def _quantile(values: Float, weight: Float, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])


def report(rows: Sequence[Row], part: Callable[[str], str]) -> str:
    """Return the table of predicted errors and verdicts, by `part` of the rigs' names, and the error models of all."""
    head = ("rig", "right (of these with agreement), wrong pairs", "coverage", "95 % bound", "error", "good (trusted)")
    lines = [f"| {' | '.join((*head, 'false accepts'))} |", "|---" * (len(head) + 1) + "|"]
    every: list[_Judged] = []
    for rig in sorted({part(row.rig) for row in rows}):
        others = [row for row in rows if part(row.rig) != rig]
        models = [fitted(others, intervals=intervals) for intervals in (False, True)]
        cells = [_Judged.of(row, models[row.intervals]) for row in rows if part(row.rig) == rig]
        every += cells
        lines.append(_line(rig, cells))
    known = [cell for cell in every if cell.row.rig not in IN_QUESTION]
    lines.append(_line("all but references in question", known))
    lines += [_line(name, [cell for cell in known if cell.row.intervals is its]) for name, its in KINDS.items()]
    lines.append(_line("all", every))
    models = [f"{name} = {fitted(rows, intervals=its)}" for name, its in MODELS.items()]
    return "\n".join([*lines, "", *models])


KINDS = {"of these denser rings": False, "of these intervals": True}
MODELS = {"DEFAULT_ERROR_MODEL": False, "INTERVAL_ERROR_MODEL": True}
GOOD_DEG, GOOD_M = 0.5, 0.15


@dataclass(frozen=True)
class _Judged:
    """A row with its predicted error by a model that was fitted without its rig; whether it would be trusted."""

    row: Row
    accuracy: Accuracy | None
    trusted: bool

    @classmethod
    def of(cls, row: Row, model: ErrorModel) -> _Judged:
        """Judge a row by a model."""
        accuracy = row.likely(model)
        return cls(row, accuracy, row.trusted(accuracy, PipelineOptions()))


def _line(name: str, cells: Sequence[_Judged]) -> str:
    right = [cell for cell in cells if cell.row.right and cell.accuracy is not None]
    sure = [cell for cell in right if not cell.row.weak]
    shares = bound = error = "-"
    if sure:
        covered = np.array([cell.row.covered(cell.accuracy) for cell in sure]).mean(axis=0)
        shares = " / ".join(f"{100 * share:.0f}" for share in covered)
        bounds = [(cell.accuracy.rotation_deg_95, cell.accuracy.translation_m_95) for cell in sure if cell.accuracy]
        errors = [(cell.row.values["rotation_deg"], cell.row.values["translation_m"]) for cell in sure]
        bound, error = (f"{its[0]:.2f} deg, {100 * its[1]:.1f} cm" for its in np.median([bounds, errors], axis=1))
    good = [cell.trusted for cell in right if cell.row.good]
    pairs = f"{sum(cell.row.right for cell in cells)} ({len(sure)}), {sum(not cell.row.right for cell in cells)}"
    off = f"{sum(cell.trusted and cell.row.off for cell in cells)}"
    return f"| {name} | {pairs} | {shares} | {bound} | {error} | {len(good)} ({sum(good)}) | {off} |"


if __name__ == "__main__":
    main()
