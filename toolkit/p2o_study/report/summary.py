"""Summarise a study from its single runs: rows with means, medians and intervals, and paired comparisons of rows."""

from __future__ import annotations

import contextlib
import itertools
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from p2o.errors import InputError
from p2o.files.parsed_text import parse_toml
from p2o.geometry.perturb import Perturbation
from p2o.geometry.pose_error import AXES

from p2o_study.columns import METRICS
from p2o_study.coverage import pooled, predicted
from p2o_study.report.bootstrap import Interval, interval
from p2o_study.report.series import Convergence, Histories
from p2o_study.store import Planned, Store, StoredRow, StoredStudy
from p2o_study.study import Published, limits_of
from p2o_study.tally import Counts, RunningCounts

NORMS = ("rotation_deg", "translation_m")
NOT_RUN = "not run"
"""Failure of calibrations that are planned but not computed."""
_ALL_PAIRS = 6
"""Up to this number of rows, all pairs are compared; otherwise each row with the best one."""


@dataclass(frozen=True)
class Measured(Counts):
    """One row of a table, from all its runs.

    `mean` and `median` are of absolute errors by metric, in degrees and metres; a refused run counts with the error of
    its initial guess, a run that raised has no error. `failures` counts runs that are not solved by status. `complete`
    is True if every run of the row has an error. `perturb` are the sizes of start errors, `places` the frames (or
    groups of jointly calibrated frames). `predicted` is the median predicted error (67 %) by norm, where there is any.
    """

    label: str
    runs: int
    places: tuple[str, ...]
    seeds: int
    perturb: tuple[str, ...]
    failures: Mapping[str, int]
    mean: Mapping[str, Interval]
    median: Mapping[str, Interval]
    complete: bool
    predicted: Mapping[str, float]


@dataclass(frozen=True)
class Difference:
    """The difference of two rows in one metric: negative is better; `better` and `tied` are shares of the pairs."""

    median: Interval
    better: float
    tied: float


@dataclass(frozen=True)
class Comparison:
    """Two rows on their common frames and seeds (`pairs`). `other_start`: the sizes of their start errors differ."""

    row: str
    against: str
    pairs: int
    differences: Mapping[str, Difference]
    other_start: bool


@dataclass(frozen=True)
class Group:
    """Comparable rows: one section, one dataset, single frames or joint ones. `runs` and `convergence` are by label.

    Runs that a store gives by `brief_rows` lack some fields and, to save memory, their rounds: see `Summary.completed`.
    """

    heading: str
    rows: tuple[Measured | Published, ...]
    comparisons: tuple[Comparison, ...]
    runs: Mapping[str, tuple[StoredRow, ...]]
    convergence: Mapping[str, Convergence | None]

    @property
    def measured(self) -> tuple[Measured, ...]:
        """The measured rows."""
        return tuple(row for row in self.rows if isinstance(row, Measured))


def _unchanged(runs: Sequence[StoredRow]) -> Sequence[StoredRow]:
    return runs


@dataclass(frozen=True)
class Summary:
    """A study with its rows.

    `norms` and `axes` are the metrics to show, `within` the limits of the study file as text, or empty. `pooled` are
    lines on the coverage of predicted errors and on false accepts over all runs. `completed` returns runs of `groups`
    with all fields.
    """

    name: str
    title: str
    note: str
    norms: tuple[str, ...]
    axes: tuple[str, ...]
    within: str
    groups: tuple[Group, ...]
    pooled: tuple[str, ...] = ()
    completed: Callable[[Sequence[StoredRow]], Sequence[StoredRow]] = _unchanged


def error_of(run: StoredRow, metric: str) -> float | None:
    """Return the absolute error of a run in a metric, None if unknown."""
    value = getattr(run, metric)
    return None if value is None else abs(value)


def summarise_stored(store: Store, study: StoredStudy) -> Summary | None:
    """Return the summary of a study in a store, which has to stay open; None without finished runs."""
    histories: defaultdict[str, Histories] = defaultdict(Histories)
    runs = list(store.brief_rows(study.name, lambda label, rounds: histories[label].add(rounds)))
    summary = summarise_study(study, runs, store.each_missing(study.name), histories) if runs else None
    return None if summary is None else replace(summary, completed=store.completed)


def summarise_study(
    study: StoredStudy,
    runs: Sequence[StoredRow],
    missing: Iterable[Planned] = (),
    histories: Mapping[str, Histories] | None = None,
) -> Summary:
    """Return the summary of a study from its runs, in the order of its table; `missing` are not computed yet.

    `histories` are the rounds by label of the row (default: those of the runs).
    """
    words = _study_words(study)
    asked = words.get("metrics", ())
    metrics = [metric for metric in METRICS if isinstance(asked, list) and metric in asked]
    norms = tuple(metric for metric in NORMS if metric in metrics) or NORMS
    axes = tuple(metric for metric in AXES if metric in metrics) or AXES
    kinds = {run.row: "jointly solved frames" if run.joint else "each frame alone" for run in runs}
    waiting: Counter[str] = Counter()
    members: dict[tuple[str, str, str], list[str]] = {}
    for planned in itertools.chain(runs, missing):
        waiting[planned.row] += not isinstance(planned, StoredRow)
        # A row without runs is grouped with those of single frames.
        key = (planned.section, planned.dataset, kinds.setdefault(planned.row, "each frame alone"))
        if planned.row not in members.setdefault(key, []):
            members[key].append(planned.row)
    by_label: dict[str, list[StoredRow]] = {label: [] for labels in members.values() for label in labels}
    for run in runs:
        by_label[run.row].append(run)
    headings = _headings(list(members))
    published = [_published(entry) for entry in study.published]
    places = _places(published, list(members.values()))
    within = _limits(words.get("within"))
    groups = []
    for number, (heading, labels) in enumerate(zip(headings, members.values(), strict=True)):
        measured = [measured_row(label, by_label[label], waiting[label], within) for label in labels]
        rows: list[Measured | Published] = []
        for row in measured:
            rows.append(row)
            rows += [p for p, place in zip(published, places, strict=True) if (number, row.label) in place]
        rows += [p for p, place in zip(published, places, strict=True) if not place and number == 0]
        own = {label: tuple(by_label[label]) for label in labels}
        known = {label: Histories.of(own[label]) if histories is None else histories.get(label) for label in labels}
        rounds = {label: None if history is None else history.convergence() for label, history in known.items()}
        groups.append(Group(heading, tuple(rows), _comparisons(measured, own), own, rounds))
    title, note = (str(words.get(word, "")) for word in ("title", "note"))
    limits, note = "" if within is None else str(within), " ".join(note.split())
    return Summary(study.name, title or study.name, note, norms, axes, limits, tuple(groups), tuple(pooled(runs)))


def best(rows: Iterable[Measured], metric: str, statistic: str, digits: int) -> float | None:
    """Return the smallest value among complete rows, rounded as printed; None for fewer than two rows."""
    values = [getattr(row, statistic)[metric].value for row in rows if row.complete and metric in row.mean]
    return round(min(values), digits) if len(values) > 1 else None


def _study_words(study: StoredStudy) -> Mapping[str, Any]:
    # The text is empty in a store written from Python and arbitrary in a foreign one; the report works without it.
    try:
        return parse_toml(study.toml, "study")
    except InputError:
        return {}


def _limits(within: object) -> Perturbation | None:
    # A foreign store may contain any value.
    with contextlib.suppress(InputError):
        return limits_of(within, "within") if isinstance(within, str) else None
    return None


def _headings(keys: Sequence[tuple[str, str, str]]) -> list[str]:
    """Return a distinct heading per group: section, dataset if there are several, kind if it is needed."""
    several = len({dataset for _, dataset, _ in keys}) > 1
    places = Counter((section, dataset) for section, dataset, _ in keys)
    parts = [(s, d if several else "", kind if places[s, d] > 1 else "") for s, d, kind in keys]
    return [", ".join(filter(None, part)) for part in parts]


def _published(entry: Mapping[str, Any]) -> Published:
    values = {metric: float(value) for metric, value in entry.get("values", {}).items() if metric in METRICS}
    texts = {word: entry.get(word, "") for word in ("label", "source", "start", "note", "beside")}
    # Not validated: a foreign store may contain any text.
    return Published.model_construct(values=values, **texts)


def _places(published: Iterable[Published], groups: Sequence[Sequence[str]]) -> list[set[tuple[int, str]]]:
    """Return for each published row the rows (index of the group, label) that it compares with."""
    return [
        {(number, label) for number, labels in enumerate(groups) for label in labels if row.compares_with(label)}
        for row in published
    ]


def measured_row(
    label: str,
    runs: Sequence[StoredRow],
    waiting: int,
    within: Perturbation | None,
) -> Measured:
    """Return one row of a table from its runs; `waiting` further ones are missing."""
    failures = Counter(run.status for run in runs if not run.solved)
    solved = [run for run in runs if run.solved]
    bounds = {norm: [value for run in solved if (value := predicted(run, norm)) is not None] for norm in NORMS}
    means, medians = {}, {}
    complete = bool(runs) and not waiting
    counts = RunningCounts(within)
    for run in runs:
        counts.add(run)
    for metric in METRICS:
        known = [(value, run.place) for run in runs if (value := error_of(run, metric)) is not None]
        values, places = [value for value, _ in known], [place for _, place in known]
        mean, median = (interval(values, places, statistic) for statistic in ("mean", "median"))
        if mean is not None and median is not None:
            means[metric], medians[metric] = mean, median
        complete &= len(known) == len(runs)
    return Measured(
        **vars(counts.counts()),
        label=label,
        runs=len(runs),
        places=tuple(dict.fromkeys(run.place for run in runs)),
        seeds=len({run.seed for run in runs}),
        perturb=tuple(dict.fromkeys(run.perturb or "" for run in runs)),
        failures={**dict(sorted(failures.items())), **({NOT_RUN: waiting} if waiting else {})},
        mean=means,
        median=medians,
        complete=complete,
        predicted={norm: float(np.median(known)) for norm, known in bounds.items() if known},
    )


def _comparisons(rows: Sequence[Measured], runs: Mapping[str, Sequence[StoredRow]]) -> tuple[Comparison, ...]:
    known = [row for row in rows if "rotation_deg" in row.mean]
    if len(known) < 2:
        return ()
    if len(known) <= _ALL_PAIRS:
        pairs = [(b, a) for a, b in itertools.combinations(known, 2)]
    else:
        first = min(known, key=lambda row: (not row.complete, row.mean["rotation_deg"].value))
        pairs = [(row, first) for row in known if row is not first]
    comparisons = [_comparison(row, against, runs[row.label], runs[against.label]) for row, against in pairs]
    return tuple(comparison for comparison in comparisons if comparison is not None)


def _comparison(
    row: Measured, against: Measured, runs: Sequence[StoredRow], others: Sequence[StoredRow]
) -> Comparison | None:
    """Return the comparison of two rows, None without common frames and seeds."""
    other_runs = {(run.frames, run.seed): run for run in others if run.rotation_deg is not None}
    pairs = [
        (run, other_runs[run.frames, run.seed])
        for run in runs
        if run.rotation_deg is not None and (run.frames, run.seed) in other_runs
    ]
    if not pairs:
        return None
    places = [run.place for run, _ in pairs]
    differences = {}
    for metric in NORMS:
        steps = np.array([(error_of(a, metric) or 0.0) - (error_of(b, metric) or 0.0) for a, b in pairs])
        median = interval(steps, places, "median")
        if median is not None:
            differences[metric] = Difference(median, float((steps < 0).mean()), float((steps == 0).mean()))
    return Comparison(row.label, against.label, len(pairs), differences, row.perturb != against.perturb)
