"""Compare methods on frames without ground truth: calibrate disjoint groups of frames and evaluate the poses.

The calibrations are rows of a study with a dataset per group, so they are stored and resumed (`p2o_study.ablate`).
`p2o_study.comparison` computes the figures. Ground truth in the data is shown, and used for nothing else.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from p2o.arrays import Float
from p2o.cache import FeatureCache
from p2o.calibration.algorithm import EDGES
from p2o.calibration.judge import DirectedJudge
from p2o.errors import InputError, P2OError
from p2o.frames.selection import select
from p2o.geometry import se3
from p2o.geometry.perturb import Perturbation, parse_perturbation
from p2o.host.calibration_file import read_initial_guess
from p2o.host.registry import Registry
from p2o.host.slots import EXTRACTORS
from p2o.page.page import brief
from p2o.run.assembly import INPUTS
from p2o.run.initial_guess import start_of
from p2o.run.pipeline import Pipeline
from p2o.run.presets import Preset, preset_of, presets
from p2o.run.recipe import Plan, Recipe, open_dataset

from p2o_study import ablate as studies
from p2o_study import comparison as figures
from p2o_study import worker
from p2o_study.ablate import MAX_CALIBRATIONS, Ablation
from p2o_study.cells import OpenRow, open_rows
from p2o_study.comparison import MIN_GROUPS
from p2o_study.keys import features_key
from p2o_study.parallel import Workers
from p2o_study.row import Row
from p2o_study.statistics import Statistics
from p2o_study.study import Study, check_study, study_of
from p2o_study.worker import FrameRecord, Plugins, Source

JUDGES = {"edges": "ours", "nid": "nid"}
"""Methods whose cost evaluates poses on other frames, by the name of the judge."""
BLIND = (
    "None of these figures can see an error that all groups share: wrong intrinsics, a time offset, an initial guess "
    "used as a prior, or a bias of edges or reflectances. Frames of one drive resemble each other, so intervals are "
    "too narrow. Where the absolute error matters, use calibration boards."
)
_SAME_DEG, _SAME_M = 1e-3, 1e-4


def contenders_of(names: Sequence[str], registry: Registry) -> list[Preset]:
    """Return the methods of these names (`preset_of`).

    Raises UnknownNameError, with similar names, for an unknown one, and InputError if one is named twice.
    """
    if len(set(names)) < len(names):
        raise InputError("a method is named twice", where="--methods", got=", ".join(names))
    return [preset_of(name, registry, "--methods") for name in names]


def split_frames(data: str, frames: str, groups: int, registry: Registry) -> list[list[int]]:
    """Return the indices of the frames of each group: frame i of the selection, in time order, is in group i mod G.

    Raises InputError for fewer groups than an interval needs, and for fewer frames than groups.
    """
    dataset = open_dataset(data, registry, {})
    indices = sorted(select(dataset.names, frames, where="--frames", skipped=dataset.skipped))
    if not MIN_GROUPS <= groups <= len(indices):
        raise InputError(
            f"too few groups: an interval needs {MIN_GROUPS}" if groups < MIN_GROUPS else "too few frames",
            where="--groups" if groups < MIN_GROUPS else "--frames",
            expected=f"{MIN_GROUPS} groups or more, and at least one frame for each, better three",
            got=f"{groups} groups of {len(indices)} frames",
        )
    return [indices[first::groups] for first in range(groups)]


def compare_study(contenders: Sequence[Preset], data: str, groups: Sequence[Sequence[int]], seeds: Any) -> Study:
    """Return the study: a row per method, a dataset per group, each calibrated jointly."""
    content = {
        "name": "compare",
        "title": "Comparison without ground truth",
        "joint": True,
        "seeds": seeds,
        # Slices, because a number may be the name of a frame.
        "dataset": [
            {"name": _group(number), "data": data, "frames": ",".join(f"{i}:{i + 1}" for i in indices)}
            for number, indices in enumerate(groups)
        ],
        "row": [{"label": c.name, "section": c.name, **c.words, "options": c.options} for c in contenders],
    }
    return study_of(content, "compare")


def _group(number: int) -> str:
    return f"group-{number:05d}"


@dataclass(eq=False)
class Guesses:
    """Initial guesses, the same for all methods: `given` or that of the data, off by `size` in random directions.

    They differ from group to group: otherwise a method that returns its initial guess would repeat perfectly.
    """

    given: Float | None
    size: Perturbation
    centre: Float | None = None

    @classmethod
    def of(cls, start: str | None, perturb: str, registry: Registry) -> Guesses:
        """Return the guesses around a file or words; raises InputError for a `perturb` with a zero part."""
        size = parse_perturbation(perturb)
        if not (size.angle_deg > 0 and size.distance_m > 0):
            raise InputError(
                "the initial guesses do not differ, so a method that returns its initial guess would repeat perfectly",
                where="--perturb",
                expected='an angle and a length, "1deg 0.1m"',
                got=perturb,
            )
        return cls(None if start is None else read_initial_guess(start, "--start", registry=registry)[0], size)

    def __call__(self, dataset: str, records: Sequence[FrameRecord], truth: Float | None, seed: int) -> Float:
        """Return camera_from_lidar (4, 4); raises InputError if the frames belong to several rigs."""
        frames: Any = records
        centre = self.given
        if centre is None:
            centre, _ = start_of(frames, truth, Recipe(), None, records[0].source.index, {})
        self.centre = centre if self.centre is None else self.centre
        step = se3.inverse(self.centre) @ centre
        if se3.angle_deg(step) > _SAME_DEG or se3.distance_m(step) > _SAME_M:
            raise InputError("the frames have different extrinsics", where="--frames", expected="frames of one rig")
        return self.size.start(centre, np.random.default_rng([seed, int(dataset.rpartition("-")[2])]), seed)


@dataclass(frozen=True, eq=False)
class Comparison:
    """The comparison of methods: `ranking` is best first, `unranked` are methods without a single estimate.

    `shares` states by judge and method whether they share features; `distances` are pairs of methods with the distance
    of their mean poses in deg and m. `interrupted`: this is the ranking of what was finished.
    """

    sentence: str
    remarks: Sequence[str]
    frames: int
    groups: int
    perturb: str
    ranking: Sequence[figures.Standing]
    unranked: Sequence[str]
    outcomes: Mapping[str, Statistics]
    shares: Mapping[str, Mapping[str, bool]]
    distances: Sequence[tuple[str, str, float, float]]
    interrupted: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison for JSON."""
        outcomes = {
            name: {
                **{key: getattr(one, key) for key in ("solved", "crashed", "unmoved")},
                "runs": one.count,
                "seconds": brief(one.seconds),
                "error_deg": brief(one.average("rotation_deg")),
                "error_m": brief(one.average("translation_m")),
            }
            for name, one in self.outcomes.items()
        }
        return {**asdict(replace(self, outcomes={})), "outcomes": outcomes, "not_observable": BLIND}


def compare(
    contenders: Sequence[Preset],
    data: str,
    folder: str | Path,
    *,
    frames: str = "all",
    groups: int = 6,
    seeds: int | Sequence[int] = 3,
    start: str | None = None,
    perturb: str = "1deg 0.1m",
    judges: Mapping[str, Preset] | None = None,
    plugins: Plugins | None = None,
    workers: Workers | None = None,
    cache: FeatureCache | None = None,
    **words: Any,
) -> tuple[Ablation, Comparison | None]:
    """Calibrate disjoint groups of frames by each method and compare the poses.

    An interrupted comparison is one of the methods, groups and seeds that are finished, without costs on other groups;
    None if they are too few for a ranking.

    `start` is a calibration file or words as in `p2o run`, `perturb` the distance of the initial guesses from it (or
    from the initial guess of the data, or from their known calibration). `judges` are the methods whose cost evaluates
    poses (default: `JUDGES`). The other words are those of `ablate`.

    Raises as `ablate`, `split_frames` and `Guesses.of`, and InputError if fewer than `MIN_GROUPS` groups can be read or
    no method gives an estimate.
    """
    plugins = Plugins.of() if plugins is None else plugins
    workers, cache, registry = workers or Workers(), cache or FeatureCache.of_user(), plugins.registry()
    guesses = Guesses.of(start, perturb, registry)
    parts = split_frames(data, frames, groups, registry)
    study = compare_study(contenders, data, parts, seeds if isinstance(seeds, int) else list(seeds))
    words |= {"plugins": plugins, "workers": workers, "cache": cache, "initial_guess": guesses, "seeds_first": True}
    done = studies.ablate(study, folder, **words)
    plans = {row.section: row.resolve(registry, row.seeds[0]) for row in study.rows()}
    readable = [n for n in range(groups) if all(r.case.start is not None for r in done.rows if r.dataset == _group(n))]
    rows = [row for row in done.rows if row.dataset in set(map(_group, readable))]
    if done.interrupted or done.missing:
        rows = _complete(rows)
        plans = {name: plan for name, plan in plans.items() if any(row.section == name for row in rows)}
        if not any(row.solved for row in rows):
            return done, None
        comparison = _compared(rows, plans, {}, workers, cache, str(guesses.size))
        left = f"interrupted: {len(done.rows)} of {len(done.rows) + len(done.missing)} calibrations are finished"
        seeds_done = len({row.seed for row in rows})
        used = f"{len(plans)} methods, {comparison.groups} groups and {seeds_done} initial guesses are ranked"
        remarks = (f"{left}; {used}, without held-out agreement", *comparison.remarks)
        return done, replace(comparison, remarks=remarks, interrupted=True)
    if len(readable) < MIN_GROUPS:
        reason = next(row.reason for row in done.rows if row.case.start is None)
        raise InputError("too few groups of frames can be read", expected=f"at least {MIN_GROUPS}", got=reason)
    if judges is None:
        published = presets(registry)
        judges = {judge: _evaluating(published[name]) for judge, name in JUDGES.items() if name in published}
    judging = {}
    for judge, contender in judges.items():
        judge_study = compare_study([contender], data, [parts[n] for n in readable], 1)
        judging[judge] = open_rows(check_study(judge_study, registry), plugins, MAX_CALIBRATIONS)
    return done, _compared(rows, plans, judging, workers, cache, str(guesses.size))


def _complete(rows: Sequence[Row]) -> list[Row]:
    """Return the rows of most methods, then most calibrations, that have the same groups and seeds; none if too few."""
    finished = {(row.section, row.dataset, row.seed) for row in rows}
    counts = Counter(row.section for row in rows)
    methods = sorted(counts, key=lambda name: -counts[name])
    groups, seeds = {row.dataset for row in rows}, {row.seed for row in rows}
    while methods:
        common = {(g, s) for g in groups for s in seeds if all((name, g, s) in finished for name in methods)}
        by_seed = Counter(seed for _, seed in common)
        best: set[tuple[str, int]] = set()
        for count in range(1, len(by_seed) + 1):
            chosen = [seed for seed, _ in by_seed.most_common(count)]
            whole = [g for g in groups if all((g, seed) in common for seed in chosen)]
            if len(whole) >= MIN_GROUPS and len(whole) * count > len(best):
                best = {(g, seed) for g in whole for seed in chosen}
        if best:
            return [row for row in rows if row.section in methods and (row.dataset, row.seed) in best]
        methods.pop()
    return []


def _evaluating(method: Preset) -> Preset:
    """Return a method that only evaluates poses: its solver is not called, and must not need an extra."""
    words = method.merged({"solver": "nelder-mead"})
    return replace(method, options=words.pop("options", {}), words=words)


def _compared(
    rows: Sequence[Row],
    plans: Mapping[str, Plan],
    judging: Mapping[str, Sequence[OpenRow]],
    workers: Workers,
    cache: FeatureCache,
    perturb: str,
) -> Comparison:
    """Return the comparison of calibrations by methods, groups and seeds; `judging` has the frames of each group."""
    by_name = {name: [row for row in rows if row.section == name] for name in plans}
    names = [name for name, own in by_name.items() if any(row.solved for row in own)]
    if not names:
        raise InputError("no method gives an estimate on these frames", got=rows[0].reason or rows[0].status)
    groups = len({row.dataset for row in rows})
    shape = len(names), groups, len(rows) // len(plans) // groups
    # The result of a refused calibration is its initial guess.
    ranked = [row for name in names for row in by_name[name]]
    estimates = np.array([row.pose for row in ranked], np.float64)
    reference = figures.reference_pose(estimates)
    jobs = [
        JudgeJob(judge, number, row.first.recipe, row.sources, cache.root, reference, estimates)
        for judge, each in judging.items()
        for number, row in enumerate(each)
    ]
    costs, absent = _judged(jobs, workers, shape) if jobs else ({}, [])
    features = {judge: _features(judging[judge][0].first.plan) for judge in costs}
    shares = {judge: {n: bool(_features(plans[n]) & own) for n in names} for judge, own in features.items()}
    samples = figures.Samples(
        names,
        [family_of(plans[name]) for name in names],
        figures.to_tangents(estimates, reference).reshape(*shape, 6),
        figures.to_tangents(np.array([row.case.start for row in ranked]), reference).reshape(*shape, 6),
        costs,
        {judge: np.array([*by.values()]) for judge, by in shares.items()},
    )
    ranking, distances = figures.standings(samples), figures.distances(samples)
    frames = len({frame for row in rows for frame in row.frames})
    unranked = [name for name in plans if name not in names]
    absent += [f"{name} gives no estimate: {by_name[name][0].reason}" for name in unranked]
    return Comparison(
        figures.sentence(ranking, distances, frames),
        [*figures.remarks(ranking, shares), *absent],
        frames,
        groups,
        perturb,
        ranking,
        unranked,
        {name: Statistics(own, name) for name, own in by_name.items()},
        shares,
        distances,
    )


def family_of(plan: Plan) -> str:
    """Return what a method relies on: edges, information, segments, motion, targets or a network, else its own name."""
    if "calibrator" in plan.parts:
        method = plan.parts["calibrator"].offer.method
        if method.trainer is not None:
            return "network"
        return "targets" if "targets" in method.needs else "motion" if "sequence" in method.needs else method.name
    needs = plan.parts["matcher"].offer.method.needs
    return "information" if "image-grey" in needs else "segments" if "image-masks" in needs else "edges"


def _features(plan: Plan) -> set[str]:
    """Return the extractors of a plan, without those of the independent check."""
    return {plan.parts[stage].offer.full_name for stage in EXTRACTORS if stage in plan.parts}


@dataclass(frozen=True, eq=False)
class JudgeJob:
    """A job to evaluate `poses` (P, 4, 4) on the frames of one group; features visible from `around` (4, 4) count."""

    judge: str
    group: int
    recipe: str
    sources: tuple[Source, ...]
    cache: Path
    around: Float
    poses: Float


def _judged(jobs: Sequence[JudgeJob], workers: Workers, shape: tuple[int, ...]) -> tuple[dict[str, Float], list[str]]:
    """Return the costs (M, G, S, H) by judge, NaN if unknown, and remarks on judges that cannot judge these frames."""
    costs = {job.judge: np.full((*shape, shape[1]), np.nan) for job in jobs}
    reasons = {job.judge: "no features" for job in jobs}
    with workers.start() as run:
        for job, values, reason in run(judged, jobs, _lost):
            costs[job.judge][..., job.group] = values.reshape(shape) if len(values) else np.nan
            reasons[job.judge] = reason or reasons[job.judge]
    usable = {judge: each for judge, each in costs.items() if np.isfinite(each).all(axis=(0, 1, 2)).sum() > 1}
    return usable, [f"no held-out agreement by {j}: {reason}" for j, reason in reasons.items() if j not in usable]


def judged(job: JudgeJob) -> tuple[JudgeJob, Float, str]:
    """Return the job, the cost of each pose (P,), empty if the judge fails, and the reason."""
    try:
        return job, _costs(job), ""
    except (P2OError, SystemExit) as problem:
        return _lost(job, problem)


def _lost(job: JudgeJob, problem: BaseException) -> tuple[JudgeJob, Float, str]:
    return job, np.empty(0), str(problem)


def _costs(job: JudgeJob) -> Float:
    """Return the costs (P,): of directed edges if the judge has edges, else of its matcher; the features are cached."""
    plan, cache = worker.plan_of(job.sources[0].plugins, job.recipe), worker.BestEffortCache(job.cache)
    pipeline, views = plan.calibrator(), []
    assert isinstance(pipeline, Pipeline)
    for source in job.sources:
        record = worker.read(source, job.cache)
        if record.failure is not None or record.camera is None:
            raise InputError(record.reason, where=record.name)
        parts = [(stage, plan.parts[stage]) for stage in EXTRACTORS]
        keys = [features_key(part, record.inputs[INPUTS[stage]]) for stage, part in parts]
        image, cloud = (
            worker.prepared(cache, key, source, part, stage)[0] for key, (stage, part) in zip(keys, parts, strict=True)
        )
        views.append(pipeline.view(record.name, record.camera, image, cloud, record.twist))
    seen = pipeline.visible(views, job.around).corrected
    if pipeline.needs >= EDGES:
        return DirectedJudge.of(seen, job.around, list(job.poses), pipeline.options.judge_px).cost(job.poses)
    return np.asarray(pipeline.matcher(seen, job.around, pipeline.options.min_reach_px).cost(job.poses), np.float64)
