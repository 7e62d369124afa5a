"""What a study came to, from its single runs: rows with means, medians and intervals, and rows compared in pairs."""

from __future__ import annotations

import contextlib
import itertools
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from p2o.errors import InputError
from p2o.files.parsed_text import parse_toml
from p2o.geometry.perturb import Perturbation
from p2o.geometry.pose_error import AXES
from p2o.report.bootstrap import Interval, interval
from p2o.results.verdict import Trust
from p2o.study.columns import METRICS
from p2o.study.held import Held, held, pooled, trusted_wrong
from p2o.study.store import Planned, StoredRow, StoredStudy
from p2o.study.study import limits_of
from p2o.study.tally import farther, near, seconds_of, trust_of

NORMS = ("rotation_deg", "translation_m")
NOT_RUN = "not run"
"""Counted among the failures: what a study asks for and has not computed yet."""

# So many rows are compared each with each; of more, each with the best one.
_ALL_PAIRS = 6


@dataclass(frozen=True)
class Measured:
    """One row of a table, from all its runs.

    `mean` and `median` are of the errors by metric (of absolute values along and about axes), in degrees and metres;
    a refused run counts with the error of its start, a run that raised has none. `failures` counts runs by status,
    solved ones left out, `trust` by the word of their verdict, those without one left out. `complete` is True where
    every run of the row has an error. `seconds` is the median time of a run, NaN where none is known; `within` counts
    runs that came as near to the truth as the study asks for (None: it does not ask), `worse` those that ended farther
    from it than they began. `perturb` are the sizes of the starts, `places` the frames (or groups of frames that were
    solved jointly). `held` counts likely errors that held, `trusted_wrong` runs that were called trusted and are far
    off (`p2o.study.held`). `likely` is by norm the median of what two of three results should keep to, as the runs
    themselves say; of no run that says so there is none.
    """

    label: str
    runs: int
    places: tuple[str, ...]
    seeds: int
    perturb: tuple[str, ...]
    failures: Mapping[str, int]
    trust: Mapping[Trust, int]
    mean: Mapping[str, Interval]
    median: Mapping[str, Interval]
    complete: bool
    seconds: float
    within: int | None
    worse: int
    held: Held
    trusted_wrong: int
    likely: Mapping[str, float]


@dataclass(frozen=True)
class Published:
    """A row of a publication: values by metric as printed there, in degrees and metres; `start` as it says.

    `beside` is the label of the row that it compares with, or empty.
    """

    label: str
    source: str
    values: Mapping[str, float]
    start: str = ""
    note: str = ""
    beside: str = ""

    def compares_with(self, label: str) -> bool:
        """Return whether it stands beside the row of a label; one on several datasets is called "LABEL @ DATASET"."""
        return self.beside != "" and self.beside in (label, label.rpartition(" @ ")[0])


@dataclass(frozen=True)
class Difference:
    """How far a row is from another on the same frames and seeds, in one metric: negative is better.

    `better` and `tied` are shares of the pairs.
    """

    median: Interval
    better: float
    tied: float


@dataclass(frozen=True)
class Comparison:
    """Two rows on the frames and seeds that both have: `pairs` of them. `other_start`: their starts differ in size."""

    row: str
    against: str
    pairs: int
    differences: Mapping[str, Difference]
    other_start: bool


@dataclass(frozen=True)
class Group:
    """Rows that may be compared: one section, one dataset, alone or jointly solved frames. `runs` by label."""

    heading: str
    rows: tuple[Measured | Published, ...]
    comparisons: tuple[Comparison, ...]
    runs: Mapping[str, tuple[StoredRow, ...]]

    @property
    def measured(self) -> tuple[Measured, ...]:
        """The rows that were measured here."""
        return tuple(row for row in self.rows if isinstance(row, Measured))


@dataclass(frozen=True)
class Summary:
    """A study with its rows. `norms` and `axes` are the metrics to show, `within` what counts as near enough to the
    truth, as the study file says; empty where it says nothing. `pooled` are lines on whether likely errors held, and
    trust was deserved, in all runs together.
    """

    name: str
    title: str
    note: str
    norms: tuple[str, ...]
    axes: tuple[str, ...]
    within: str
    groups: tuple[Group, ...]
    pooled: tuple[str, ...] = ()


def error_of(run: StoredRow, metric: str) -> float | None:
    """Return the size of a run's error in a metric, or None where it has none."""
    value = getattr(run, metric)
    return None if value is None else abs(value)


def summarise_study(study: StoredStudy, runs: Sequence[StoredRow], missing: Sequence[Planned] = ()) -> Summary:
    """Return the summary of a study from its runs, in the order of its table; `missing` are those not there yet."""
    said = _said(study)
    asked = said.get("metrics", ())
    metrics = [metric for metric in METRICS if isinstance(asked, list) and metric in asked]
    norms = tuple(metric for metric in NORMS if metric in metrics) or NORMS
    axes = tuple(metric for metric in AXES if metric in metrics) or AXES
    kinds = {run.row: "jointly solved frames" if run.joint else "each frame alone" for run in runs}
    waiting = Counter(planned.row for planned in missing)
    members: dict[tuple[str, str, str], list[str]] = {}
    for planned in (*runs, *missing):
        # A row of which nothing is there yet is put beside those that are solved alone.
        key = (planned.section, planned.dataset, kinds.setdefault(planned.row, "each frame alone"))
        if planned.row not in members.setdefault(key, []):
            members[key].append(planned.row)
    by_label: dict[str, list[StoredRow]] = {label: [] for labels in members.values() for label in labels}
    for run in runs:
        by_label[run.row].append(run)
    headings = _headings(list(members))
    published = [_published(entry) for entry in study.published]
    places = _places(published, list(members.values()))
    within = _limits(said.get("within"))
    groups = []
    for number, (heading, labels) in enumerate(zip(headings, members.values(), strict=True)):
        measured = [_measured(label, by_label[label], waiting[label], within) for label in labels]
        rows: list[Measured | Published] = []
        for row in measured:
            rows.append(row)
            rows += [p for p, place in zip(published, places, strict=True) if (number, row.label) in place]
        rows += [p for p, place in zip(published, places, strict=True) if not place and number == 0]
        own = {label: tuple(by_label[label]) for label in labels}
        groups.append(Group(heading, tuple(rows), _comparisons(measured, own), own))
    title, note = (str(said.get(word, "")) for word in ("title", "note"))
    asked_for = "" if within is None else str(within)
    return Summary(
        study.name,
        title or study.name,
        " ".join(note.split()),
        norms,
        axes,
        asked_for,
        tuple(groups),
        tuple(pooled(runs)),
    )


def best(rows: Iterable[Measured], metric: str, statistic: str, digits: int) -> float | None:
    """Return the smallest value among complete rows, rounded as it is printed; None where there is no choice."""
    values = [getattr(row, statistic)[metric].value for row in rows if row.complete and metric in row.mean]
    return round(min(values), digits) if len(values) > 1 else None


def _said(study: StoredStudy) -> Mapping[str, Any]:
    # A store of Python's may know no file, and a foreign one anything: the words of columns are not needed.
    try:
        return parse_toml(study.toml, "study")
    except InputError:
        return {}


def _limits(said: object) -> Perturbation | None:
    # A foreign store may say anything here as well.
    with contextlib.suppress(InputError):
        return limits_of(said, "within") if isinstance(said, str) else None
    return None


def _headings(keys: Sequence[tuple[str, str, str]]) -> list[str]:
    """Return what tells each group from the others: its section, its dataset where there are several, its kind where
    the rest does not tell.
    """
    several = len({dataset for _, dataset, _ in keys}) > 1
    places = Counter((section, dataset) for section, dataset, _ in keys)
    parts = [(s, d if several else "", kind if places[s, d] > 1 else "") for s, d, kind in keys]
    return [", ".join(filter(None, part)) for part in parts]


def _published(entry: Mapping[str, Any]) -> Published:
    values = {metric: float(value) for metric, value in entry.get("values", {}).items() if metric in METRICS}
    texts = {word: entry.get(word, "") for word in ("label", "source", "start", "note", "beside")}
    return Published(values=values, **texts)


def _places(published: Iterable[Published], groups: Sequence[Sequence[str]]) -> list[set[tuple[int, str]]]:
    """Return for each published row the rows (number of the group, label) that it stands below."""
    return [
        {(number, label) for number, labels in enumerate(groups) for label in labels if row.compares_with(label)}
        for row in published
    ]


def _measured(label: str, runs: Sequence[StoredRow], waiting: int, within: Perturbation | None) -> Measured:
    failures = Counter(run.status for run in runs if not run.solved)
    means, medians = {}, {}
    complete = bool(runs) and not waiting
    for metric in METRICS:
        known = [(value, run.place) for run in runs if (value := error_of(run, metric)) is not None]
        values, places = [value for value, _ in known], [place for _, place in known]
        mean, median = (interval(values, places, statistic) for statistic in ("mean", "median"))
        if mean is not None and median is not None:
            means[metric], medians[metric] = mean, median
        complete &= len(known) == len(runs)
    return Measured(
        label=label,
        runs=len(runs),
        places=tuple(dict.fromkeys(run.place for run in runs)),
        seeds=len({run.seed for run in runs}),
        perturb=tuple(dict.fromkeys(run.perturb or "" for run in runs)),
        failures={**dict(sorted(failures.items())), **({NOT_RUN: waiting} if waiting else {})},
        trust=trust_of(runs),
        mean=means,
        median=medians,
        complete=complete,
        seconds=seconds_of(runs),
        within=None if within is None else sum(near(run, within) for run in runs),
        worse=sum(farther(run) for run in runs),
        held=held(runs),
        trusted_wrong=trusted_wrong(runs),
        likely={norm: value for norm in NORMS if (value := _likely(runs, norm)) is not None},
    )


def _likely(runs: Iterable[StoredRow], norm: str) -> float | None:
    """Return the median of the likely errors of the runs that were solved, or None where none says any."""
    # Stores hold infinities as texts.
    known = [float(value) for run in runs if run.solved and (value := getattr(run, f"likely_{norm}")) is not None]
    return float(np.median(known)) if known else None


def _comparisons(rows: Sequence[Measured], runs: Mapping[str, Sequence[StoredRow]]) -> tuple[Comparison, ...]:
    known = [row for row in rows if "rotation_deg" in row.mean]
    if len(known) < 2:
        return ()
    if len(known) <= _ALL_PAIRS:
        pairs = [(b, a) for a, b in itertools.combinations(known, 2)]
    else:
        first = min((row for row in known if row.complete), key=_mean_rotation, default=min(known, key=_mean_rotation))
        pairs = [(row, first) for row in known if row is not first]
    found = [_comparison(row, against, runs[row.label], runs[against.label]) for row, against in pairs]
    return tuple(comparison for comparison in found if comparison is not None)


def _mean_rotation(row: Measured) -> float:
    return row.mean["rotation_deg"].value


def _comparison(
    row: Measured, against: Measured, runs: Sequence[StoredRow], others: Sequence[StoredRow]
) -> Comparison | None:
    """Return the comparison of two rows, or None where they have no frame and seed in common."""
    there = {(run.frames, run.seed): run for run in others if run.rotation_deg is not None}
    pairs = [
        (run, there[run.frames, run.seed])
        for run in runs
        if run.rotation_deg is not None and (run.frames, run.seed) in there
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
