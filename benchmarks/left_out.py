"""Choose weights, options and the error model on real rigs, each left out of the choice in turn.

    python benchmarks/left_out.py collect --out build/choice/free                     # calibrates frames of all rigs
    python benchmarks/left_out.py collect --out build/choice/kitti --weights kitti
    python benchmarks/left_out.py compare build/choice/free build/choice/kitti        # the choice without each rig
    python benchmarks/left_out.py fit --rows build/choice/free [--by lidar]           # the error model, its coverage

`collect` calibrates frames of real rigs (`rigs.py`; with --rigs also simulated ones) from 2 deg / 0.15 m, one at a
time and three and eight jointly, and wrong pairs of image and sweep: with the sweep of another frame, or turned, where
all frames show one place. It adds a JSON line for each to DIR/rows.jsonl, and continues where it was stopped. `compare`
prints the errors of each choice by rig, and for each rig the choice that is best on all others. `fit` fits error models
to all results of real rigs, trusted or not, without the rig (or all rigs of its LiDAR) of each line of the
table. Coverage in %: 67 % bound of rotation / translation, then 95 % bound; bound and error are medians. Good are
errors below 0.5 deg and 15 cm, false accepts trusted results with errors over 1 deg or 30 cm, and trusted wrong pairs.
Last are the models of all rigs, for `p2o.confidence.accuracy`. Errors are those to the published reference, whose own
error the bounds therefore contain.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import p2o.confidence.assessment as assessment
from limits_and_tables import START_DEG, START_M, add_row, grouped, is_good, is_wrong, read_rows, size, table
from p2o.arrays import Float
from p2o.calibration.options import PipelineOptions
from p2o.confidence.accuracy import DEFAULT_ERROR_MODEL, ErrorBudget, ErrorModel, likely_accuracy, or_rival
from p2o.confidence.verdict import verdict_of
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import place_by_update, pose_error
from p2o.results.evidence import Accuracy, Agreement, Rival
from p2o.results.result import Result
from rigs import RIGS, Rig, Sample, is_real, lidar_of

AXES = ("pitch_deg", "yaw_deg", "roll_deg", "x_m", "y_m", "z_m")
SHARES = (0.70, 0.955)
"""Shares of the errors that the 67 % and the 95 % bounds of a fit contain, where a rig with few results has a higher
weight than its number of results, and a rig that is left out has larger errors than the others.
"""
USUAL = {"pairs": 1.1, "by_odds": 0.5, "beams": 1.2, "rings": 0.65}
USUAL |= {"view_deg": 0.05, "view_m": 0.01, "floor_deg": 0.019, "floor_m": 0.007, "strong": 18.0, "by_strength": 1.5}
"""The parameters of a model at which a fit begins, and towards which it is drawn slightly."""
OBJECT_M = DEFAULT_ERROR_MODEL.object_m
"""The error of outlines of near objects; it is not fitted."""
BUDGET = ("pairs", "beams", "objects", "rings", "cameras", "absorbed")
IN_QUESTION = ("acfr_vlp16", "nuscenes", "pjlab")
"""Rigs whose references may have larger errors than the results; evaluated, but not used by a fit. All groups of edges
of acfr_vlp16 (near and far, horizontal and vertical) contradict the reference by about 1 deg of pitch; that of nuscenes
is mapped between moments of a moving car; two of the three of pjlab are published as doubtful.
"""
FREEDOM = 4.0
"""Degrees of freedom of Student's t for the errors: some edges are matched with others."""
MODELS = {"DEFAULT_ERROR_MODEL": False, "INTERVAL_ERROR_MODEL": True}
"""Models for `p2o.confidence.accuracy`, and whether they are for intervals of sparse rings."""


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    collecting = commands.add_parser("collect", help="calibrate the frames of all rigs")
    collecting.add_argument("--out", type=Path, required=True, help="folder of rows.jsonl, and of features")
    collecting.add_argument("--rigs", nargs="+", choices=[rig.name for rig in RIGS], metavar="RIG")
    collecting.add_argument("--weights", default="free", help="weights of the network: a name, or a file")
    collecting.add_argument("--most", type=int, default=12, help="frames of a rig, spread evenly")
    fitting = commands.add_parser("fit", help="fit the model, one rig left out at a time")
    fitting.add_argument("--rows", type=Path, required=True, help="folder of rows.jsonl")
    fitting.add_argument("--by", choices=("rig", "lidar"), default="rig", help="what is left out at a time")
    comparing = commands.add_parser("compare", help="errors of choices, and which is chosen without each rig")
    comparing.add_argument("choices", nargs="+", type=Path, help="folders of rows.jsonl")
    options = parser.parse_args()
    if options.command == "collect":
        for rig in RIGS:
            if rig.name in (options.rigs or [rig.name for rig in RIGS if rig.is_real]):
                collect(replace(rig, weights=options.weights), options.out, options.most)
    elif options.command == "compare":
        rows_of = {path.name: [Row.of(values) for values in read_rows(path / "rows.jsonl")] for path in options.choices}
        print(compared(rows_of))
    else:
        rows = [Row.of(values) for values in read_rows(options.rows / "rows.jsonl")]
        print(report(rows, lidar_of if options.by == "lidar" else str))


@dataclass(frozen=True)
class Job:
    """Frames by number to calibrate jointly; `others` are those whose sweeps they get, `turned_deg` turns these."""

    frames: tuple[int, ...]
    seed: int = 0
    others: tuple[int, ...] = ()
    turned_deg: float = 0.0

    def views(self, frames: Sequence[Sample]) -> list[View]:
        """Return what is calibrated."""
        views = [frames[number].view for number in self.frames]
        turn = se3.exp(np.array([0, 0, np.radians(self.turned_deg), 0, 0, 0]))
        if self.turned_deg:
            return [view.moved(turn) for view in views]
        sweeps = self.others or self.frames
        return [replace(view, cloud=frames[number].view.cloud) for view, number in zip(views, sweeps, strict=True)]


def jobs(rig: Rig, count: int, groups: Sequence[Sequence[int]]) -> Iterator[Job]:
    """Yield what to calibrate of `count` frames; `groups` are those that may be solved jointly."""
    for number in range(count):
        for seed in range(rig.seeds):
            yield Job((number,), seed)
        if rig.one_place:
            yield Job((number,), turned_deg=100.0 + 20 * number % 60)
        else:
            yield Job((number,), others=((number + 7) % count,))
    rng = np.random.default_rng(1)
    for group in groups:
        for number, times in ((3, 3), (8, 2)):
            for _ in range(times if len(group) > number else len(group) == number):
                drawn = tuple(sorted(rng.choice(group, number, replace=False).tolist()))
                yield Job(drawn, int(rng.integers(1000)))
        if len(group) > 4 and not rig.one_place:
            for _ in range(2):
                drawn = tuple(sorted(rng.choice(group, 3, replace=False).tolist()))
                yield Job(drawn, others=tuple((number + 1 + count // 2) % count for number in drawn))


def collect(rig: Rig, out: Path, most: int) -> None:
    """Calibrate a rig, and add a line for each job that has none yet."""
    file = out / "rows.jsonl"
    known = {row["key"] for row in read_rows(file)}
    frames, pipeline = rig.samples(out / "features", most), rig.plan.calibrator()
    for job in jobs(rig, len(frames), rig.groups([frame.view.name for frame in frames])):
        key = f"{rig.name} {job}"
        if key in known:
            continue
        truth, kind = frames[job.frames[0]].truth, "wrong" if job.others or job.turned_deg else "right"
        rng = np.random.default_rng([job.seed, job.frames[0], len(job.frames)])
        with _Recorded() as recorded:
            result = pipeline.solve(job.views(frames), wrong_start(truth, START_DEG, START_M, rng))
        row = {
            "key": key,
            "rig": rig.name,
            "frames": len(job.frames),
            "kind": kind,
            "truth_deg": rig.truth_deg,
            "truth_m": rig.truth_m,
        }
        add_row(file, row | measured(result, truth, recorded.budget))
    print(f"{rig.name}: {len(frames)} frames", flush=True)


class _Recorded:
    """Record the inputs of a pipeline's predicted error."""

    budget: ErrorBudget | None = None

    def __enter__(self) -> _Recorded:
        self._likely_accuracy = assessment.likely_accuracy
        assessment.likely_accuracy = self._record
        return self

    def __exit__(self, *problem: object) -> None:
        assessment.likely_accuracy = self._likely_accuracy

    def _record(self, budget: ErrorBudget, *rest: Any) -> Accuracy:
        self.budget = budget
        return self._likely_accuracy(budget, *rest)


def measured(result: Result, truth: Float, budget: ErrorBudget | None) -> dict[str, Any]:
    """Return what a fit needs to know about a result, as JSON."""
    error = pose_error(result.camera_from_lidar, truth)
    row: dict[str, Any] = {
        "status": result.status.value,
        "doubts": [reason.doubt.value for reason in result.verdict.reasons],
        "rotation_deg": error.rotation_deg,
        "translation_m": error.translation_m,
        "axes": [error.per_axis[axis] for axis in AXES],
        "pose": result.camera_from_lidar.tolist(),
        "budget": None,
    }
    for name in ("agreement", "rival"):
        part = getattr(result, name)
        row[name] = None if part is None else asdict(part)
    if budget is not None:
        row["budget"] = {name: getattr(budget, name).tolist() for name in BUDGET}
        row["budget"] |= {"views": budget.views, "intervals": budget.intervals}
    return row


@dataclass(frozen=True, eq=False)
class Row:
    """One line of rows.jsonl.

    `error` (6,) is by `AXES` in rad and m, `size` and `truth_size` are rotation and translation in deg and m. `doubted`
    states that the verdict doubts the pose for another reason than its predicted error, `intervals` that the pose is by
    the interval likelihood.
    """

    rig: str
    frames: int
    is_right: bool
    solved: bool
    doubted: bool
    intervals: bool
    error: Float
    size: tuple[float, float]
    truth_size: tuple[float, float]
    pose: Float
    budget: ErrorBudget | None
    agreement: Agreement
    rival: Rival | None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Row:
        """Return the row of a line."""
        axes, budget = np.array(values["axes"], np.float64), values["budget"]
        axes[:3] = np.radians(axes[:3])
        if budget is not None:
            budget = ErrorBudget(**budget | {name: np.array(budget[name]) for name in BUDGET})
        doubts = {"little-agreement", "rival-pose", "too-few-places", "camera"} & set(values["doubts"])
        return cls(
            values["rig"],
            values["frames"],
            values["kind"] == "right",
            values["status"] in ("converged", "rounds-spent"),
            bool(doubts),
            budget is not None and budget.intervals,
            axes,
            (values["rotation_deg"], values["translation_m"]),
            (values["truth_deg"], values["truth_m"]),
            np.array(values["pose"]),
            budget,
            *(part and kind(**part) for kind, part in ((Agreement, values["agreement"]), (Rival, values["rival"]))),
        )

    @property
    def usable(self) -> bool:
        """Whether a fit uses it: a right pair of a real rig whose reference is not in question, trusted or not."""
        return is_real(self.rig) and self.rig not in IN_QUESTION and self.is_right and self.budget is not None

    def predicted(self, model: ErrorModel) -> Accuracy | None:
        """Return the predicted error by a model."""
        if self.budget is None:
            return None
        accuracy = likely_accuracy(self.budget, self.pose, self.agreement, model)
        return or_rival(accuracy, self.rival)


@dataclass(frozen=True, eq=False)
class _Errors:
    """Results of right pairs: errors (K, 6) by axis, parts (K, 5, 6) of their variance, odds ratios over 10 and views
    (K,), weights (K,) and variances (K, 6) of the references.
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
        """Return the errors of rows of one kind; each rig counts as the root of its number of rows."""
        number = Counter(row.rig for row in rows)
        known = [[np.radians(row.truth_size[0])] * 3 + [row.truth_size[1]] * 3 for row in rows]
        return cls(
            rows,
            np.stack([row.error for row in rows]),
            np.stack([_variances(row) for row in rows]),
            np.clip([row.agreement.odds_ratio for row in rows], 1.5, 40.0) / 10.0,
            np.array([row.budget.views for row in rows if row.budget]),
            np.array([number[row.rig] ** -0.5 for row in rows]),
            np.square(known) / 3,
        )

    def variance(self, model: Mapping[str, float]) -> Float:
        """Return the variances (K, 6) by axis as `likely_covariance`; parameters that a model lacks are 0."""
        model = dict.fromkeys(USUAL, 0.0) | model
        floor = np.square([np.radians(model["floor_deg"])] * 3 + [model["floor_m"]] * 3)
        view = np.square([np.radians(model["view_deg"])] * 3 + [model["view_m"]] * 3) / self.views[:, None]
        pairs = np.square(model["pairs"] * self.odds ** -model["by_odds"])
        scales = [model["beams"] ** 2, OBJECT_M**2, model["rings"] ** 2, 1.0]
        parts = np.einsum("p,kpa->ka", scales, self.parts[:, 1:]) + pairs[:, None] * self.parts[:, 0]
        weak = DEFAULT_ERROR_MODEL._replace(strong=model["strong"], by_strength=model["by_strength"])
        inflation = [weak.inflation(row.agreement) for row in self.rows]
        return np.asarray(np.square(inflation)[:, None] * (parts + view + floor))

    def unlikely(self, model: Mapping[str, float]) -> float:
        """Return the mean of minus the log-likelihood of the errors as Student's t."""
        total = self.variance(model) + self.known
        surprise = 0.5 * np.log(total) + (FREEDOM + 1) / 2 * np.log1p(self.error**2 / total / FREEDOM)
        return float(self.weight @ surprise.sum(axis=1) / self.weight.sum())

    def factors(self, model: Mapping[str, float]) -> dict[str, Any]:
        """Return the factors of rotation, of translation and by axis within which `SHARES` of the errors are."""
        axes = np.sqrt(self.variance(model))
        sizes = np.linalg.norm(axes.reshape(-1, 2, 3), axis=2)
        ratios = np.array([row.size for row in self.rows]) / np.column_stack([np.degrees(sizes[:, 0]), sizes[:, 1]])
        beyond = np.abs(self.error) / axes
        rotation, translation = (tuple(_quantile(ratio, self.weight, share) for share in SHARES) for ratio in ratios.T)
        axis = _quantile(beyond.ravel(), np.repeat(self.weight, 6), SHARES[0])
        return {"rotation": rotation, "translation": translation, "axis": axis}


def fitted(rows: Sequence[Row], *, intervals: bool) -> ErrorModel:
    """Return the model of right pairs of real rigs, with or without intervals.

    Parts and floors make the errors by axis most likely as Student's t; then factors are set such that the bounds
    contain `SHARES` of the errors.
    """
    from scipy.optimize import minimize

    errors = _Errors.of([row for row in rows if row.usable and row.intervals is intervals])
    without = ("by_odds", "beams", "rings") if intervals else ()
    names = tuple(name for name in USUAL if name not in without)
    usual = np.log([USUAL[name] for name in names])

    def unlikely(logarithms: Float) -> float:
        # Parameters that the rows do not determine remain at their usual values. Weaker priors (0.01 to 0.3) covered
        # fewer errors of rigs that were left out.
        prior = float(np.square(logarithms - usual).sum())
        return errors.unlikely(dict(zip(names, np.exp(logarithms), strict=True))) + prior

    solution = np.exp(minimize(unlikely, usual, method="Powell", options={"xtol": 1e-3, "ftol": 1e-6}).x)
    model = {name: float(f"{value:.2g}") for name, value in zip(names, solution, strict=True)}
    return ErrorModel(**dict.fromkeys(USUAL, 0.0) | model, **errors.factors(model), object_m=OBJECT_M)


def _variances(row: Row) -> Float:
    """Return the variances (5, 6) by axis of pairs, beams, objects, rings and cameras, without their parameters."""
    place, budget = place_by_update(row.pose), row.budget
    assert budget is not None
    parts = (budget.pairs, budget.beams, budget.objects, budget.cameras)
    pairs, beams, objects, cameras = (np.diag(place @ part @ place.T) for part in parts)
    return np.stack([pairs, beams, objects, budget.rings**2, cameras])


def _quantile(values: Float, weight: Float, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return round(float(values[order][np.searchsorted(total, share * total[-1])]), 2)


def compared(rows_of: Mapping[str, Sequence[Row]]) -> str:
    """Return the table of errors by choice and rig, each with the choice that is best on all other rigs.

    Best has the lowest mean, over rigs whose reference is not in question, of the logarithm of the median errors in
    rotation and in translation; single frames and joint calibrations are rows of their own.
    """
    errors: dict[str, dict[str, Float]] = {}
    cells: dict[str, dict[str, str]] = {}
    for choice, rows in rows_of.items():
        right = [row for row in rows if row.is_right]
        for name, group in grouped(right, lambda row: f"{row.rig}{', jointly' * (row.frames > 1)}").items():
            middle = np.median([row.size for row in group], axis=0)
            mean = np.mean([row.size for row in group], axis=0)
            good = 100 * np.mean([is_good(*row.size) for row in group])
            errors.setdefault(name, {})[choice] = np.log(middle)
            cells.setdefault(name, {})[choice] = f"{size(*middle)} ({size(*mean)}), {good:.0f} %"
    known = {name: by_choice for name, by_choice in errors.items() if len(by_choice) == len(rows_of)}
    used = [name for name in known if name.partition(",")[0] not in IN_QUESTION]

    def best(names: Sequence[str]) -> str:
        return min(rows_of, key=lambda choice: float(np.mean([known[name][choice] for name in names])))

    lines = []
    for name in known:
        rig = name.partition(",")[0]
        chosen = best([other for other in used if other.partition(",")[0] != rig])
        lines.append((name, *(cells[name][choice] for choice in rows_of), chosen))
    means = (np.exp(np.mean([known[name][choice] for name in used], axis=0)) for choice in rows_of)
    lines.append(("all but references in question, geometric mean", *(size(*mean) for mean in means), best(used)))
    return table(("rig: median (mean), good", *rows_of, "best on the others"), lines)


def report(rows: Sequence[Row], part: Callable[[str], str]) -> str:
    """Return the table of predicted errors and verdicts, by `part` of the rigs' names, and the error models of all."""
    head = ("rig", "right, wrong pairs", "coverage", "95 % bound", "error", "good (trusted)", "trusted, outside 95 %")
    cells: dict[str, list[_Judged]] = {}
    for name, group in sorted(grouped(rows, lambda row: part(row.rig)).items()):
        others = [row for row in rows if part(row.rig) != name]
        models = [fitted(others, intervals=intervals) for intervals in (False, True)]
        cells[name] = [_Judged.of(row, models[row.intervals]) for row in group]
    every = [cell for group in cells.values() for cell in group]
    known = [cell for cell in every if cell.row.rig not in IN_QUESTION]
    cells["all but references in question"] = known
    cells["of these denser rings"] = [cell for cell in known if not cell.row.intervals]
    cells["of these intervals"] = [cell for cell in known if cell.row.intervals]
    cells["all"] = every
    models = [f"{name} = {fitted(rows, intervals=intervals)}" for name, intervals in MODELS.items()]
    lines = table((*head, "false accepts"), [_line(name, group) for name, group in cells.items()])
    return "\n".join([lines, "", *models])


@dataclass(frozen=True)
class _Judged:
    """A row with its predicted error by a model that was fitted without its rig; whether it would be trusted."""

    row: Row
    accuracy: Accuracy | None
    trusted: bool

    @classmethod
    def of(cls, row: Row, model: ErrorModel) -> _Judged:
        """Judge a row by a model."""
        accuracy, trusted = row.predicted(model), False
        if accuracy is not None and row.solved and not row.doubted:
            trusted = verdict_of(row.agreement, row.rival, (), PipelineOptions(), accuracy).trusted
        return cls(row, accuracy, trusted)

    @property
    def covered(self) -> list[bool]:
        """Whether rotation and translation are within their 67 % bounds, then within their 95 % bounds."""
        accuracy = self.accuracy
        assert accuracy is not None
        bounds = (accuracy.rotation_deg, accuracy.translation_m, accuracy.rotation_deg_95, accuracy.translation_m_95)
        return [error <= bound for error, bound in zip(self.row.size * 2, bounds, strict=True)]


def _line(name: str, cells: Sequence[_Judged]) -> tuple[object, ...]:
    right = [cell for cell in cells if cell.row.is_right and cell.accuracy is not None]
    coverage = bound = error = "-"
    if right:
        coverage = " / ".join(f"{100 * share:.0f}" for share in np.mean([cell.covered for cell in right], axis=0))
        bounds = [(cell.accuracy.rotation_deg_95, cell.accuracy.translation_m_95) for cell in right if cell.accuracy]
        bound, error = (size(*np.median(pairs, axis=0)) for pairs in (bounds, [cell.row.size for cell in right]))
    good = [cell.trusted for cell in right if is_good(*cell.row.size)]
    trusted = [cell for cell in right if cell.trusted]
    outside = f"{sum(not all(cell.covered[2:]) for cell in trusted)} of {len(trusted)}"
    pairs = f"{sum(cell.row.is_right for cell in cells)}, {sum(not cell.row.is_right for cell in cells)}"
    false = sum(cell.trusted and (not cell.row.is_right or is_wrong(*cell.row.size)) for cell in cells)
    return name, pairs, coverage, bound, error, f"{len(good)} ({sum(good)})", outside, false


if __name__ == "__main__":
    main()
