"""Enumerate the calibrations (cells) of a study without building them: a study may have a million of them."""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache, partial
from itertools import accumulate
from typing import Any

from p2o.arrays import Float
from p2o.cache import content_hash
from p2o.calibration.version import ALGORITHM
from p2o.errors import InputError, P2OError
from p2o.frames.selection import select
from p2o.host.guard import GuardedDataset
from p2o.host.registry import Registry
from p2o.run.assembly import INPUTS
from p2o.run.initial_guess import common_pose, listed_errors, start_of
from p2o.run.recipe import Part, Plan, open_dataset
from p2o.run.run import used_jointly
from p2o.run.words import split_data

from p2o_study import worker
from p2o_study.damage import STAGE as DAMAGE
from p2o_study.damage import Damage
from p2o_study.keys import features_key, method_content
from p2o_study.row import GIVEN, UNREADABLE, Case, Environment, Row, frame_digest, rounded_pose
from p2o_study.row import Frame as FrameOfCase
from p2o_study.row import Method as MethodOfRow
from p2o_study.study import ALL_JOINT, BY_CAMERA, BY_RIG, StudyRow, with_place
from p2o_study.worker import FrameRecord, Plugins, Source

_KEY_LENGTH = 20
_INPUT_STAGES = ("data", "accumulate")
"""Stages that affect a result only through the content of the frames."""

_OF_CASE = ("data", "frames", "perturb", "options")
"""Words of a recipe that describe what is calibrated, not the method."""


@dataclass(frozen=True, eq=False)
class Method:
    """The methods of one row and seed: `recipe` (JSON) for workers, `digest` the hash of code, weights and options."""

    recipe: str
    plan: Plan
    described: Mapping[str, Any]
    versions: Mapping[str, str]
    damage: Damage
    digest: str

    @classmethod
    def of(cls, row: StudyRow, data_options: str, versions: Mapping[str, str], registry: Registry, seed: int) -> Method:
        """Return the methods of a seed; `data_options` are the options of the dataset as JSON."""
        recipe = row.recipe(seed)
        options = {**recipe.options, "data": json.loads(data_options)}
        if not options["data"]:
            del options["data"]
        recipe = recipe.model_copy(update={"options": options})
        plan = recipe.resolve(registry)
        described, damage = plan.described(), row.damage(seed)
        if damage.missing_edges:
            described["options"][DAMAGE] = damage.model_dump(mode="json")
        content = {
            "methods": {
                # A result depends on the content of the frames, not on their source.
                stage: [part.offer.full_name, part.options.model_dump(mode="json")]
                if stage in _INPUT_STAGES
                else method_content(part)
                for stage, part in sorted(plan.parts.items())
                if stage != "data"
            },
            "pipeline": described["options"].get("pipeline"),
            "damage": damage.model_dump(mode="json") if damage.missing_edges else None,
            "rig": row.joint == BY_RIG,
            "algorithm": ALGORITHM,
        }
        words = recipe.model_dump(mode="json", exclude_unset=True)
        return cls(json.dumps(words, sort_keys=True), plan, described, versions, damage, content_hash(content))

    @cached_property
    def prepared(self) -> tuple[tuple[str, str, Part], ...]:
        """Stage, name and part of each stage whose output can be cached; equal names give equal outputs."""
        parts = self.plan.parts
        stages = worker.prepared_stages(self.plan)
        return tuple((stage, worker.part_name(parts[stage]), parts[stage]) for stage in stages)

    @cached_property
    def of_row(self) -> MethodOfRow:
        """The method as rows name it: without data, frames, seed and initial guess."""
        words = {w: str(v) for w, v in self.described.items() if v and w not in _OF_CASE and isinstance(v, str)}
        options = {stage: values for stage, values in self.described["options"].items() if stage != "data"}
        return MethodOfRow(self.digest, words, options)


@dataclass(frozen=True, eq=False)
class OpenRow:
    """One row with its frames; `method` returns the methods of a seed, `listed` holds start errors from a list."""

    row: StudyRow
    sources: tuple[Source, ...]
    method: Callable[[int], Method]
    listed: Mapping[int, Float]

    @property
    def first(self) -> Method:
        """The methods of the first seed."""
        return self.method(self.row.seeds[0])


def open_rows(rows: Sequence[StudyRow], plugins: Plugins, at_most: int) -> list[OpenRow]:
    """Return each row with its frames; no frame is read. Raises InputError for more than `at_most` calibrations."""
    registry = plugins.registry()
    datasets: dict[tuple[str, str], GuardedDataset] = {}
    sources: dict[tuple[str, str, str, str], tuple[Source, ...]] = {}
    out = []
    count = 0
    for row in rows:
        data, options = row.dataset.data, _data_options(row, registry)
        where = f"{row.where}, dataset '{row.dataset.name}'"
        if (data, options) not in datasets:
            try:
                datasets[data, options] = open_dataset(data, registry, json.loads(options))
            except P2OError as problem:
                raise with_place(problem, where, f"name the path: --data {data.partition(':')[0]}:PATH") from problem
        dataset = datasets[data, options]
        # Versions do not depend on the seed; reading the metadata of packages is slow.
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
                hint="choose fewer frames or seeds (--frames, --seeds), or confirm the number: --at-most N",
            )
        method = cache(partial(Method.of, row, options, versions, registry))
        # Raises before any work if an option does not accept such a seed.
        for seed in {min(row.seeds), max(row.seeds)}:
            method(seed)
        first = [source.index for source in sources[chosen][::size]]
        listed = listed_errors(row.recipe(row.seeds[0]), dataset.names, first)
        out.append(OpenRow(row, sources[chosen], method, listed))
    return out


def _joins(plan: Plan) -> str:
    """Return name and options of the accumulator as JSON, or an empty text."""
    part = plan.parts.get("accumulate")
    if part is None:
        return ""
    return json.dumps([part.offer.full_name, part.options.model_dump(mode="json")], sort_keys=True)


def _data_options(row: StudyRow, registry: Registry) -> str:
    """Return the options of the dataset as JSON; its seed is fixed, so that all seeds of a row use the same frames."""
    options = {**row.dataset.options, **row.words["options"].get("data", {})}
    fields = row.resolve(registry, row.seeds[0]).parts["data"].options.model_fields
    if "seed" in fields and "seed" not in split_data(row.dataset.data)[1]:
        options.setdefault("seed", 0)
    return json.dumps(options, sort_keys=True)


def group_size(joint: int, frames: int) -> int:
    """Return the number of frames per group out of `frames`; 1 where groups depend on the cameras."""
    return {0: 1, ALL_JOINT: frames, BY_CAMERA: 1, BY_RIG: frames}.get(joint, joint)


def groups_of(joint: int, records: Sequence[FrameRecord]) -> list[tuple[FrameRecord, ...]]:
    """Return the groups of frames for joint calibration; `joint` is that of a `StudyRow`.

    The frames of a group are in the order of the dataset, on which the last bits of the result depend. Groups of one
    camera have the frames that `p2o run --joint` uses.
    """
    if joint == BY_CAMERA:
        return [tuple(used_jointly(group)) for group in _by_camera(records)]
    size = group_size(joint, len(records))
    groups = [_in_order(records[first : first + size]) for first in range(0, len(records), size)]
    return groups if joint == BY_RIG else [tuple(used_jointly(group)) for group in groups]


def _in_order(records: Iterable[FrameRecord]) -> tuple[FrameRecord, ...]:
    return tuple(sorted(records, key=lambda record: record.source.index))


def _by_camera(records: Sequence[FrameRecord]) -> list[tuple[FrameRecord, ...]]:
    """Return one group per camera; a frame that cannot be read is its own group and does not affect the others."""
    groups: list[list[FrameRecord]] = []
    for record in records:
        own = None if record.failure is not None else next((g for g in groups if _of_one_camera(g[0], record)), None)
        if own is None:
            groups.append([record])
        else:
            own.append(record)
    return [_in_order(group) for group in groups]


def _of_one_camera(first: FrameRecord, other: FrameRecord) -> bool:
    if first.failure is not None or (first.camera_name, first.camera) != (other.camera_name, other.camera):
        return False
    try:
        # Records have the poses of a frame under the same names as the frame.
        poses: Any = (first, other)
        common_pose(poses, "camera_from_lidar")
    except InputError:
        return False
    return True


@dataclass(frozen=True, eq=False)
class Group:
    """Frames of one calibration of a row; `joint` is their number, 0 for a single frame.

    `plan` has the methods whose required inputs are checked. The frames of a `rig` are those of all its cameras;
    its poses are camera_from_lidar of the camera of the first frame.
    """

    records: tuple[FrameRecord, ...]
    joint: int
    plan: Plan
    rig: bool = False

    @cached_property
    def truth(self) -> Float | None:
        """The ground truth camera_from_lidar (4, 4) of all frames; None if unknown or a frame cannot be read."""
        return common_pose(self.poses, "camera_from_lidar") if self.readable else None

    @property
    def poses(self) -> Any:
        """The records as frames, of one camera: they have the poses of a frame under the same names."""
        return next(iter(self.cameras.values())) if self.rig else self.records

    @cached_property
    def cameras(self) -> dict[str, tuple[FrameRecord, ...]]:
        """The frames of a rig by camera; raises InputError for one camera and for a frame without ground truth."""
        where = self.records[0].name
        for record in self.records:
            if record.camera_from_lidar is None:
                text = "the transforms between the cameras of the rig are unknown"
                raise InputError(
                    text, where=record.name, expected="frames with ground truth", hint='joint = "camera" needs none'
                )
        cameras: dict[str, tuple[FrameRecord, ...]] = {}
        for frames in _by_camera(self.records):
            name = frames[0].camera_name or frames[0].name
            cameras[frames[0].name if name in cameras else name] = frames
        if len(cameras) < 2:
            raise InputError("frames of one camera are no rig", where=where, expected='joint = "camera", or true')
        return cameras

    @property
    def readable(self) -> bool:
        """True where every frame can be read."""
        return all(record.failure is None for record in self.records)

    @cached_property
    def content(self) -> str:
        """The hash of everything of the frames that a result depends on, the same on all machines."""
        frames = [[frame.name, frame.content] for frame in map(frame_of, self.records)]
        return content_hash({"joint": bool(self.joint), "frames": frames, "rig": self.rig})

    @cached_property
    def failure(self) -> tuple[str, str] | None:
        """Reason and traceback of the first frame that cannot be read or lacks a required input."""
        for record in self.records:
            if record.failure is not None:
                return record.reason, record.failure
            try:
                self.plan.check_contents(record.name, frozenset(record.contents))
            except InputError as problem:
                return str(problem), str(problem)
        return None


@lru_cache(maxsize=20_000)
def frame_of(record: FrameRecord) -> FrameOfCase:
    """Return content and ground truth of a frame that was read."""
    content = frame_digest(record.digests, record.camera_from_lidar) if record.digests else UNREADABLE
    return FrameOfCase("", record.name, content, record.camera_from_lidar)


InitialGuess = Callable[[str, Sequence[FrameRecord], Float | None, int], Float]
"""`(dataset, records of the frames, ground truth (4, 4) or None, seed) -> camera_from_lidar (4, 4)`."""


@dataclass(frozen=True, eq=False)
class Cell:
    """One calibration: the row with all values that are known before, frames, and the methods that compute it."""

    row: Row
    method: Method
    group: Group


class Cells(Sequence[Cell]):
    """All calibrations of a study, ordered by row, frames and seed; each is built on access."""

    def __init__(
        self,
        rows: Sequence[OpenRow],
        records: Mapping[Source, FrameRecord],
        initial_guess: InitialGuess | None = None,
    ) -> None:
        self._rows, self._initial_guess = rows, initial_guess
        self._groups: list[list[Group]] = []
        known: dict[tuple[int, int], list[tuple[FrameRecord, ...]]] = {}
        for entry in rows:
            joint, plan = entry.row.joint, entry.first.plan
            # Rows on the same frames share the groups.
            frames = joint, id(entry.sources)
            if frames not in known:
                known[frames] = groups_of(joint, [records[source] for source in entry.sources])
            own = [Group(some, len(some) if joint else 0, plan, joint == BY_RIG) for some in known[frames]]
            self._groups.append(own)
        counts = (len(groups) * len(entry.row.seeds) for entry, groups in zip(rows, self._groups, strict=True))
        self._ends = list(accumulate(counts))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def __getitem__(self, position: Any) -> Any:
        entry, group, seed = self.place(position)
        method, start = entry.method(seed), None
        if group.readable and self._initial_guess is not None:
            start = self._initial_guess(entry.row.dataset.name, group.records, group.truth, seed)
        elif group.readable:
            first = group.records[0].source.index
            start, _ = start_of(group.poses, group.truth, method.plan.recipe, None, first, entry.listed)
        row = entry.row
        source = group.records[0].source
        case = Case(
            row.dataset.name,
            tuple(replace(frame_of(record), dataset=row.dataset.name) for record in group.records),
            seed,
            start,
            protocol=method.described["perturb"] or GIVEN,
            joint=group.joint,
            rig=group.rig,
            data=source.data.partition(":")[0],
            options=json.loads(source.options),
        )
        guess = None if start is None else rounded_pose(start)
        key = content_hash([method.digest, seed, group.content, guess])[:_KEY_LENGTH]
        environment = Environment(versions=method.versions)
        planned = Row(key, row.label, case, method.of_row, row.section, environment=environment)
        return Cell(planned, method, group)

    def place(self, position: int) -> tuple[OpenRow, Group, int]:
        """Return row, frames and seed of a calibration without building the cell."""
        if not 0 <= position < len(self):
            raise IndexError(position)
        at = bisect_right(self._ends, position)
        entry = self._rows[at]
        number, seed = divmod(position - (self._ends[at - 1] if at else 0), len(entry.row.seeds))
        return entry, self._groups[at][number], entry.row.seeds[seed]


class FeatureKeys(dict[tuple[str, str], str]):
    """The cache keys of the features of frames; each is computed once for all seeds and rows."""

    def of(self, method: Method, record: FrameRecord) -> dict[str, str]:
        """Return by stage the cache key of the features of a frame, for stages whose output can be cached."""
        keys = {}
        for stage, name, part in method.prepared:
            content = record.inputs[INPUTS[stage]]
            if (name, content) not in self:
                self[name, content] = features_key(part, content)
            keys[stage] = self[name, content]
        return keys
