"""A study as groups of comparable rows: what its terminal table, its report and its page show."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

from p2o.geometry.perturb import Perturbation
from p2o.geometry.pose_error import AXES

from p2o_study.row import NORMS, Row
from p2o_study.rows import PlanRow, Rows, StoredStudy
from p2o_study.statistics import Comparison, Statistics, by_label, compared, pooled
from p2o_study.study import Published, Study, study_of

_ALL_PAIRS = 6
"""Up to this number of rows, all pairs are compared; otherwise each row with the best one."""
_SINGLE, _JOINT = "each frame alone", "jointly solved frames"


@dataclass(frozen=True, eq=False)
class Group:
    """Comparable rows: one section, one data set, single frames or joint ones.

    `rows` are measured rows, each followed by the published ones that it is compared with.
    """

    heading: str
    rows: tuple[Statistics | Published, ...]

    @cached_property
    def measured(self) -> tuple[Statistics, ...]:
        """The measured rows."""
        return tuple(row for row in self.rows if isinstance(row, Statistics))

    @cached_property
    def comparisons(self) -> tuple[Comparison, ...]:
        """The measured rows compared in pairs, on their common frames and seeds."""
        known = [row for row in self.measured if row.mean("rotation_deg") is not None]
        if len(known) <= _ALL_PAIRS:
            pairs = [(b, a) for a, b in itertools.combinations(known, 2)]
        else:
            first = min(known, key=lambda row: (not row.complete, row.average("rotation_deg")))
            pairs = [(row, first) for row in known if row is not first]
        comparisons = (compared(row, against) for row, against in pairs)
        return tuple(comparison for comparison in comparisons if comparison is not None)


@dataclass(frozen=True, eq=False)
class Summary:
    """A study with its rows; `norms` and `axes` are the metrics to show, `within` its limits.

    `has_axes` is True if the study asks for errors by axis.
    """

    name: str
    title: str
    note: str
    norms: tuple[str, ...]
    axes: tuple[str, ...]
    within: Perturbation | None
    groups: tuple[Group, ...]
    protocol: str | None = None
    has_axes: bool = False

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """All calibrations."""
        return tuple(row for group in self.groups for measured in group.measured for row in measured.rows)

    @cached_property
    def pooled(self) -> tuple[str, ...]:
        """Lines on the coverage of predicted errors and on false accepts over all calibrations."""
        return tuple(pooled(self.rows))


def summary_of_stored(rows: Rows, stored: StoredStudy) -> Summary | None:
    """Return the summary of a study in a folder; None without finished calibrations."""
    finished = rows.planned(stored.name)
    return summarised(study_of(stored.content, stored.name), finished, rows.missing(stored.name)) if finished else None


def summarised(study: Study, rows: Sequence[Row], missing: Iterable[PlanRow] = ()) -> Summary:
    """Return the summary of a study from its finished calibrations and the missing ones of its plan."""
    kinds = {row.row: _JOINT if row.case.joint else _SINGLE for row in rows}
    waiting: Counter[str] = Counter()
    members: dict[tuple[str, str, str], list[str]] = {}
    every: Iterable[Row | PlanRow] = itertools.chain(rows, missing)
    for planned in every:
        waiting[planned.row] += not isinstance(planned, Row)
        # A row without calibrations is grouped with those of single frames.
        key = (planned.section, planned.dataset, kinds.setdefault(planned.row, _SINGLE))
        if planned.row not in members.setdefault(key, []):
            members[key].append(planned.row)
    known, within = by_label(rows), study.limits
    labels = [label for own in members.values() for label in own]
    published = [p for p in study.published if p.beside is None or any(map(p.compares_with, labels))]
    groups = []
    for number, (heading, own) in enumerate(zip(_headings(list(members)), members.values(), strict=True)):
        lines: list[Statistics | Published] = []
        for label in own:
            lines.append(Statistics(known.get(label, ()), label, within=within, waiting=waiting[label]))
            lines += [p for p in published if p.compares_with(label)]
        lines += [p for p in published if p.beside is None and number == 0]
        groups.append(Group(heading, tuple(lines)))
    norms = tuple(metric for metric in study.metrics if metric in NORMS) or NORMS
    axes = tuple(metric for metric in study.metrics if metric in AXES)
    note = " ".join(study.note.split())
    return Summary(
        study.name, study.title, note, norms, axes or AXES, within, tuple(groups), study.protocol, bool(axes)
    )


def _headings(keys: Sequence[tuple[str, str, str]]) -> list[str]:
    """Return a distinct heading per group: section, data set if there are several, kind if it is needed."""
    several = len({dataset for _, dataset, _ in keys}) > 1
    places = Counter((section, dataset) for section, dataset, _ in keys)
    parts = [(s, d if several else "", kind if places[s, d] > 1 else "") for s, d, kind in keys]
    return [", ".join(filter(None, part)) for part in parts]
