"""The comparison of methods without ground truth as text and as one HTML file."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from p2o.errors import printable
from p2o.page import page as html
from p2o.page.page import Column, brief, cell

from p2o_study.compare import BLIND, Comparison
from p2o_study.comparison import Standing
from p2o_study.row import NORMS
from p2o_study.statistics import Statistics
from p2o_study.tables import ENTRIES, aligned, shown, text_of, unit_of

_LENGTHS = {
    "repeatability": "repeatability",
    "guesses": "from other guesses",
    "groups": "from other frames",
    "consensus": "to other families",
}
"""Headers of the figures that have a rotation and a translation."""
_PAGE_ONLY = ("from other guesses", "from other frames")
_ERROR = "error (truth, not used)"
_GROUPS = (
    "Group 1: methods that cannot be distinguished from the best at 95 %. In brackets: 95 % intervals from bootstrap "
    "samples of the groups."
)
_LEGEND = (
    "Repeatability: standard deviation of one calibration about the mean pose of its method; its parts are the spread "
    "within a group over the initial guesses, and between the means of the groups.",
    "Held-out: cost of the poses of one group on the frames of the others (edges: pixels; nid: information distance). "
    "A judge marked * uses features of the method itself.",
    "To other families: distance of the mean pose from the median of methods that rely on something else.",
    "Failed: calibrations without an estimate; they count with their initial guess.",
)


def ranking_columns(comparison: Comparison) -> list[Column]:
    """Return the columns of the ranking."""
    outcomes = comparison.outcomes
    stuck = any(outcome.unmoved for outcome in outcomes.values())
    columns = [
        Column("method", text=True, hide=0, of=lambda s: s.name),
        Column("group", hide=0, of=lambda s: s.tier),
        Column("family", text=True, hide=2, of=lambda s: s.family),
    ]
    lengths = [name for name in _LENGTHS if f"{name}_deg" in comparison.ranking[0].figures]
    for hide, name in enumerate(lengths, 1):
        for unit, key, factor, digits in (("deg", f"{name}_deg", 1.0, 3), ("cm", f"{name}_m", 100.0, 1)):
            of = partial(_interval, key=key, factor=factor)
            columns.append(Column(_LENGTHS[name], unit, digits, hide=hide, of=of))
    columns += [
        Column(f"held-out {judge}", hide=2, of=partial(_held_out, judge=judge, shared=shared))
        for judge, shared in comparison.shares.items()
    ]
    return [
        *columns,
        Column("failed", hide=1, of=lambda s: ENTRIES["not solved"].page_cell(outcomes[s.name])),
        *(
            [Column("not moved", hide=1, of=lambda s: ENTRIES["not moved"].page_cell(outcomes[s.name]))]
            if stuck
            else []
        ),
        Column("time", "s", hide=4, of=lambda s: ENTRIES["time [s]"].page_cell(outcomes[s.name])),
        *(
            Column(_ERROR, *unit_of(norm)[::2], hide=3, of=partial(_error, outcomes=outcomes, norm=norm))
            for norm in NORMS
        ),
    ]


def _interval(standing: Standing, key: str, factor: float) -> Any:
    value = standing.figures[key]
    return html.interval([None if x is None else factor * x for x in (value.value, value.low, value.high)])


def _held_out(standing: Standing, judge: str, shared: Mapping[str, bool]) -> Any:
    """Return the held-out cost; a * marks a judge that shares features with the method."""
    first, *below = shown(standing.figures[judge], "px_deg").split(" ", 1)
    return cell(brief(standing.figures[judge].value), first + "*" * shared[standing.name], *below)


def _error(standing: Standing, outcomes: Mapping[str, Statistics], norm: str) -> float | None:
    return brief(unit_of(norm)[1] * outcomes[standing.name].average(norm))


def comparison_text(comparison: Comparison) -> str:
    """Return the ranking without intervals, the sentence and the remarks for a terminal."""
    known = any(len(outcome.errors(NORMS[0])) for outcome in comparison.outcomes.values())
    left_out = (*_PAGE_ONLY, *(() if known else (_ERROR,)))
    columns = [column for column in ranking_columns(comparison) if column.name not in left_out]
    # Headers of several words take several lines.
    heads = [f"{column.name} {column.unit or ''}".split() for column in columns]
    lines = [[head[i] if i < len(head) else "" for head in heads] for i in range(max(map(len, heads)))]
    lines += [[text_of(column, standing) for column in columns] for standing in comparison.ranking]
    text = [*aligned(lines), "", comparison.sentence, *comparison.remarks, BLIND]
    return "\n".join(map(printable, text)) + "\n"


def comparison_page(comparison: Comparison) -> str:
    """Return the page: it works offline and loads nothing."""
    names = [s.name for s in comparison.ranking]
    apart = {
        frozenset((a, b)): cell(deg, f"{deg:.2f} deg", f"{100 * m:.1f} cm") for a, b, deg, m in comparison.distances
    }
    pairs = [[a, *(apart.get(frozenset((a, b))) for b in names)] for a in names]
    frames = (
        f"{comparison.frames} frames in {comparison.groups} disjoint groups, each calibrated jointly by every method"
    )
    blocks = [
        html.text(f"{frames}, from initial guesses that are off by {comparison.perturb}.", "quiet"),
        html.text(comparison.sentence, "lead"),
        html.section(
            "Ranking",
            html.table(ranking_columns(comparison), comparison.ranking, name="ranking", search=True),
            html.text(_GROUPS),
            html.items(_LEGEND),
        ),
        html.section(
            "Distances between mean poses",
            html.table([Column("method", text=True, hide=0), *map(Column, names)], pairs, name="distances"),
        ),
        html.section("Remarks", html.items([*comparison.remarks, BLIND])),
    ]
    return html.page("Comparison of methods without ground truth", blocks)
