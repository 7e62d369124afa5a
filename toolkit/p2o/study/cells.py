"""The calibrations of a study: which there are is known at once, each is worked out when it is asked for.

A study may ask for a million of them, and only a few are under way.
"""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import accumulate
from typing import Any

from p2o.arrays import Float
from p2o.errors import InputError, P2OError
from p2o.frames.selection import select
from p2o.geometry.pose_error import pose_error
from p2o.host.guard import GuardedDataset
from p2o.host.registry import Registry
from p2o.run.assembly import INPUTS
from p2o.run.recipe import Part, Plan, open_dataset
from p2o.run.run import common_pose, listed_errors, start_of
from p2o.run.words import split_data
from p2o.study import worker
from p2o.study.groups import group_size, groups_of
from p2o.study.store import Planned, StoredRow
from p2o.study.study import MOST_SEEDS, StudyRow, retold
from p2o.study.worker import Facts, Plugins, Source
from p2o.work.cache import content_hash, features_key, named_files
from p2o.work.sources import code_hash

_CORE = ("p2o.calibration.pipeline", "p2o.run.run", "p2o.geometry.pose_error", "p2o.geometry.perturb")
"""Modules that every row goes through, besides those of its methods."""


@dataclass(frozen=True, eq=False)
class Method:
    """The methods of one row and seed: `recipe` (JSON) for workers, `key` the hash of all that acts on a result."""

    recipe: str
    plan: Plan
    described: Mapping[str, Any]
    versions: Mapping[str, str]
    key: str

    @classmethod
    def of(cls, row: StudyRow, seed: int, data_options: str, versions: Mapping[str, str], registry: Registry) -> Method:
        """Return the methods of a seed; `data_options` are those of the dataset as JSON."""
        recipe = row.recipe(seed)
        options = {**recipe.options, "data": json.loads(data_options)}
        if not options["data"]:
            del options["data"]
        recipe = recipe.model_copy(update={"options": options})
        plan = recipe.resolve(registry)
        described = plan.described()
        builds = [part.offer.method.build for stage, part in plan.parts.items() if stage != "data"]
        # Where the frames come from does not act on the result: their content does.
        acting = {
            "methods": {stage: p.offer.full_name for stage, p in sorted(plan.parts.items()) if stage != "data"},
            "options": {stage: values for stage, values in described["options"].items() if stage != "data"},
            "seed": seed,
            "perturb": recipe.perturb,
            "versions": versions,
            "code": code_hash(*builds, *_CORE),
            "files": named_files({k: v for k, v in described["options"].items() if k != "data"}),
        }
        words = recipe.model_dump(mode="json", exclude_unset=True)
        return cls(json.dumps(words, sort_keys=True), plan, described, versions, content_hash(acting))

    @cached_property
    def prepared(self) -> tuple[tuple[str, str, Part], ...]:
        """Stage, name and part of what prepares something that may be kept; equal names prepare the same."""
        parts = self.plan.parts
        stages = worker.prepared_stages(self.plan)
        return tuple((stage, worker.part_name(parts[stage]), parts[stage]) for stage in stages)

    @property
    def extractors(self) -> dict[str, tuple[str, str]]:
        """By a name of method and options: recipe and stage that say how to prepare what may be kept."""
        return {name: (self.recipe, stage) for stage, name, _ in self.prepared}


@dataclass(frozen=True, eq=False)
class Opened:
    """One row with its frames; `method` says the methods of a seed, `listed` are errors of starts from a list."""

    row: StudyRow
    sources: tuple[Source, ...]
    method: Callable[[int], Method]
    listed: Mapping[int, Float]

    @property
    def first(self) -> Method:
        """The methods of the first seed."""
        return self.method(self.row.seeds[0])


def opened(rows: Sequence[StudyRow], plugins: Plugins, at_most: int) -> list[Opened]:
    """Return each row with its frames, none of which is read yet.

    Raises InputError for more than `at_most` calibrations before any of them is looked at.
    """
    registry = plugins.registry()
    datasets: dict[tuple[str, str], GuardedDataset] = {}
    sources: dict[tuple[str, str, str, str], tuple[Source, ...]] = {}
    out = []
    count = 0
    # Rows go through their frames seed by seed: the methods of all seeds of a row have to be at hand.
    method_of = lru_cache(maxsize=MOST_SEEDS)(partial(_method_of, registry))
    for row in rows:
        data, options = row.dataset.data, _data_options(row, registry)
        where = f"{row.where}, dataset '{row.dataset.name}'"
        if (data, options) not in datasets:
            try:
                datasets[data, options] = open_dataset(data, registry, json.loads(options))
            except P2OError as problem:
                raise retold(problem, where, f"say where they are: --data {data.partition(':')[0]}:PATH") from problem
        dataset = datasets[data, options]
        # Looked up in the metadata of packages, which takes its time; no seed changes them.
        plan = row.resolve(registry, row.seeds[0])
        versions, joins = plan.versions(), _joins(plan)
        chosen = data, options, row.dataset.frames, joins
        if chosen not in sources:
            indices = select(dataset.names, row.dataset.frames, where=where, skipped=dataset.skipped)
            sources[chosen] = tuple(
                Source(plugins, data, options, index, dataset.names[index], joins) for index in indices
            )
        size = group_size(row.joint, len(sources[chosen]))
        count += len(row.seeds) * math.ceil(len(sources[chosen]) / size)
        if count > at_most:
            raise InputError(
                "the study asks for too many calibrations",
                where=where,
                expected=f"at most {at_most}",
                got=f"{count} up to this row",
                hint="choose fewer frames or seeds (--frames, --seeds), or say that so many are meant: --at-most N",
            )
        method = partial(method_of, _Asked(row, options, versions))
        # An option that takes no such seed says so before any work.
        for seed in {min(row.seeds), max(row.seeds)}:
            method(seed)
        first = [source.index for source in sources[chosen][::size]]
        listed = listed_errors(row.recipe(row.seeds[0]), dataset.names, first)
        out.append(Opened(row, sources[chosen], method, listed))
    return out


@dataclass(frozen=True, eq=False)
class _Asked:
    row: StudyRow
    data_options: str
    versions: Mapping[str, str]


def _method_of(registry: Registry, asked: _Asked, seed: int) -> Method:
    return Method.of(asked.row, seed, asked.data_options, asked.versions, registry)


def _joins(plan: Plan) -> str:
    """Return name and options of the method that joins sweeps as JSON, or an empty text."""
    part = plan.parts.get("accumulate")
    if part is None:
        return ""
    return json.dumps([part.offer.full_name, part.options.model_dump(mode="json")], sort_keys=True)


def _data_options(row: StudyRow, registry: Registry) -> str:
    """Return the dataset's options as JSON; its seed is its own, so that all seeds of a row see the same frames."""
    options = {**row.dataset.options, **row.words["options"].get("data", {})}
    fields = row.resolve(registry, row.seeds[0]).parts["data"].options.model_fields
    if "seed" in fields and "seed" not in split_data(row.dataset.data)[1]:
        options.setdefault("seed", 0)
    return json.dumps(options, sort_keys=True)


@dataclass(frozen=True, eq=False)
class Group:
    """Frames of a row that are solved together, 0 `joint` for one alone; `check` is what frames are checked by."""

    facts: tuple[Facts, ...]
    joint: int
    check: str

    @cached_property
    def truth(self) -> Float | None:
        """Return camera_from_lidar (4, 4) of all frames, None where it is not known or a frame cannot be read."""
        return common_pose(self.poses, "camera_from_lidar") if self.readable else None

    @property
    def poses(self) -> Any:
        """The facts as frames: they know the poses of a frame by the same names."""
        return self.facts

    @property
    def readable(self) -> bool:
        """True where every frame can be read."""
        return all(fact.failure is None for fact in self.facts)

    @cached_property
    def content(self) -> str:
        """The hash of all that the frames have to do with a result."""
        frames = [{"name": fact.name, **fact.inputs} for fact in self.facts]
        return content_hash({"joint": bool(self.joint), "frames": frames, "truth": self.truth})

    @property
    def failure(self) -> tuple[str, str] | None:
        """Reason and traceback of the first frame that cannot be read, or lacks what the row needs."""
        for fact in self.facts:
            if fact.failure is not None:
                return fact.reason, fact.failure
            if self.check in fact.misfits:
                return fact.misfits[self.check], fact.misfits[self.check]
        return None


@dataclass(frozen=True, eq=False)
class Cell:
    """One calibration to be had: a row of the table, a seed, and the frames, from a start (4, 4) where there is one."""

    planned: Planned
    seed: int
    method: Method
    group: Group
    start: Float | None

    @property
    def stored(self) -> StoredRow:
        """The row with all that is known before it is computed."""
        facts, truth = self.group.facts, self.group.truth
        names = tuple(fact.name for fact in facts)
        before: dict[str, Any] = {}
        if truth is not None and self.start is not None:
            error = pose_error(self.start, truth)
            before = {"start_rotation_deg": error.rotation_deg, "start_translation_m": error.translation_m}
        return StoredRow(
            **{name: getattr(self.planned, name) for name in Planned.__dataclass_fields__},
            frames=names,
            joint=self.group.joint,
            seed=self.seed,
            perturb=self.method.described["perturb"],
            start=self.start,
            truth=truth,
            recipe={**self.method.described, "frames": ",".join(names), "joint": bool(self.group.joint)},
            versions=self.method.versions,
            inputs={fact.name: dict(fact.inputs) for fact in facts},
            **before,
        )


class Cells(Sequence[Cell]):
    """Every calibration of a study, by row, then frames, then seed; each is made when it is asked for."""

    def __init__(self, rows: Sequence[Opened], facts: Mapping[Source, Facts]) -> None:
        known: dict[tuple[int, int], list[tuple[Facts, ...]]] = {}
        self._rows = rows
        self._groups: list[list[tuple[Facts, ...]]] = []
        for entry in rows:
            # Rows on the same frames share them.
            its = entry.row.joint, id(entry.sources)
            if its not in known:
                known[its] = groups_of(entry.row.joint, [facts[source] for source in entry.sources])
            self._groups.append(known[its])
        counts = (len(groups) * len(entry.row.seeds) for entry, groups in zip(rows, self._groups, strict=True))
        self._ends = list(accumulate(counts))
        self._last: tuple[int, int, Group] | None = None

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, position: Any) -> Any:
        if isinstance(position, slice):
            return [self[number] for number in range(*position.indices(len(self)))]
        entry, group, seed = self.place(position)
        method, start = entry.method(seed), None
        if group.readable:
            first = group.facts[0].source.index
            start, _ = start_of(group.poses, group.truth, method.plan.recipe, None, first, entry.listed)
        row = entry.row
        planned = Planned(
            key=content_hash([method.key, group.content, start]),
            study=row.where.removeprefix("study "),
            row=row.label,
            section=row.section,
            dataset=row.dataset.name,
            **row.said,
        )
        return Cell(planned, seed, method, group, start)

    def place(self, position: int) -> tuple[Opened, Group, int]:
        """Return the row, the frames and the seed of a calibration, of which nothing else is worked out."""
        if not -len(self) <= position < len(self):
            raise IndexError(position)
        position %= len(self)
        at = bisect_right(self._ends, position)
        entry = self._rows[at]
        number, seed = divmod(position - (self._ends[at - 1] if at else 0), len(entry.row.seeds))
        last = self._last
        if last is None or last[:2] != (at, number):
            facts = self._groups[at][number]
            group = Group(facts, len(facts) if entry.row.joint else 0, entry.first.recipe)
            # The seeds of a row follow each other on the same frames.
            self._last = last = at, number, group
        return entry, last[2], entry.row.seeds[seed]


class FeatureKeys:
    """The keys of what is prepared of frames; each is worked out once, however many seeds and rows there are."""

    def __init__(self) -> None:
        self._known: dict[tuple[str, str], str] = {}

    def of(self, method: Method, facts: Facts) -> dict[str, str]:
        """Return the key of what each stage prepares of a frame, for those whose outcome may be kept."""
        found = {}
        for stage, name, part in method.prepared:
            seen = name, facts.inputs[INPUTS[stage]]
            if seen not in self._known:
                self._known[seen] = features_key(part, seen[1])
            found[stage] = self._known[seen]
        return found
