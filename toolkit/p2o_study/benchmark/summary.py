"""The figures of a row of a table from its runs: errors with intervals, refusals, false accepts, coverage, seconds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from p2o.arrays import Int
from p2o.results.verdict import Trust

from p2o_study.benchmark.outcomes import SOLVED, TRUSTS, Outcomes, Runs, is_in
from p2o_study.benchmark.row import place_of
from p2o_study.coverage import WRONG, BoundCoverage
from p2o_study.report.bootstrap import Interval, interval
from p2o_study.report.summary import NORMS


@dataclass(frozen=True)
class RowSummary:
    """One row of a table, from `count` runs on `groups` independent groups of frames.

    `mean`, `median` and `solved_only` are by norm, in degrees and metres, without entries where no error is known.
    Refused runs count with the error of their initial guess, except in `solved_only`. `trusted` and `false_accepts` are
    None without verdicts. `seconds` is the median, NaN if unknown.
    """

    count: int
    groups: int
    refused: int
    mean: Mapping[str, Interval]
    median: Mapping[str, float]
    solved_only: Mapping[str, float]
    trusted: int | None
    false_accepts: int | None
    coverage: BoundCoverage
    seconds: float


def clusters_of(outcomes: Outcomes, unit: str) -> Int:
    """Return for each of `Outcomes.places` the number of its independent group; `unit` is "frames" or "drive"."""
    name = _UNITS[unit]
    numbers: dict[str, int] = {}
    return np.array([numbers.setdefault(name(place), len(numbers)) for place in outcomes.places], np.int64)


def _frames(place: Sequence[str]) -> str:
    return place_of(list(place))


def _drive(place: Sequence[str]) -> str:
    return place[0].rpartition("/")[0]


_UNITS: Mapping[str, Callable[[Sequence[str]], str]] = {"frames": _frames, "drive": _drive}


def summarised(runs: Runs, clusters: Int) -> RowSummary:
    """Return the figures of runs (N,) in groups `clusters` (N,), in which frames of two datasets differ."""
    solved = is_in(runs["status"], SOLVED)
    mean, median, solved_only = {}, {}, {}
    for norm in NORMS:
        known = ~np.isnan(runs[norm])
        values = runs[norm][known]
        average = interval(values, clusters[known], "mean")
        if average is not None:
            mean[norm], median[norm] = average, float(np.median(values))
        if (known & solved).any():
            solved_only[norm] = float(np.mean(runs[norm][known & solved]))
    trusted = runs["verdict"] == TRUSTS.index(Trust.TRUSTED)
    wrong = (runs["rotation_deg"] > WRONG.angle_deg) | (runs["translation_m"] > WRONG.distance_m)
    judged = bool((runs["verdict"] >= 0).any())
    seconds = runs["seconds"][~np.isnan(runs["seconds"])]
    return RowSummary(
        count=len(runs),
        groups=len(np.unique(clusters)),
        refused=int((~solved).sum()),
        mean=mean,
        median=median,
        solved_only=solved_only,
        trusted=int(trusted.sum()) if judged else None,
        false_accepts=int((trusted & wrong).sum()) if judged else None,
        coverage=_coverage(runs[solved]),
        seconds=float(np.median(seconds)) if len(seconds) else float("nan"),
    )


def _coverage(solved: Runs) -> BoundCoverage:
    bounds = {f"{norm}{suffix}": solved[f"predicted_{norm}{suffix}"] for suffix in ("", "_95") for norm in NORMS}
    errors = {name: solved[name.removesuffix("_95")] for name in bounds}
    known = ~np.any([np.isnan(values) for values in (*bounds.values(), *errors.values())], axis=0)
    within = {name: int((errors[name] <= bounds[name])[known].sum()) for name in bounds}
    return BoundCoverage(
        int(known.sum()),
        within["rotation_deg"],
        within["translation_m"],
        within["rotation_deg_95"],
        within["translation_m_95"],
    )


def dataset_clusters(runs: Runs, clusters: Int) -> Int:
    """Return the groups (N,) of runs from those of their places: equal names of two datasets are two groups."""
    return np.asarray(clusters[runs["place"]] * (int(runs["dataset"].max(initial=0)) + 1) + runs["dataset"])


def top_groups(intervals: Sequence[Interval | None]) -> list[int | None]:
    """Return the group of each mean, 1 for the smallest ones; None without an interval.

    Means whose intervals overlap are in one group, also through a third one whose interval overlaps with both: within
    a group there is no order.
    """
    known = [
        (each.low, each.high, i)
        for i, each in enumerate(intervals)
        if each is not None and each.low is not None and each.high is not None
    ]
    groups: list[int | None] = [None] * len(intervals)
    group, reach = 0, -math.inf
    for low, high, number in sorted(known, key=lambda entry: entry[0]):
        group += low > reach
        reach = max(reach, high)
        groups[number] = group
    return groups
