"""The comparison of methods without ground truth as text and as one HTML file."""

from __future__ import annotations

from p2o.draw.one_file import rendered
from p2o.errors import printable

from p2o_study.compare import BLIND, Comparison
from p2o_study.statistics import Interval, brief_seconds
from p2o_study.tables import NONE, shown

_LENGTHS = {
    "repeatability": "repeatability",
    "guesses": "from other guesses",
    "groups": "from other frames",
    "consensus": "to other families",
}
"""Headers of the figures that have a rotation and a translation."""
_BRIEF = ("repeatability", "consensus")
"""Those of the table of a terminal."""


def table_of(comparison: Comparison, *, brief: bool) -> list[list[str]]:
    """Return header and rows of the ranking, with all figures and intervals unless `brief`.

    A * marks held-out costs of judges that share features with the method.
    """
    names = _BRIEF if brief else _LENGTHS
    lengths = [name for name in names if f"{name}_deg" in comparison.ranking[0].figures]
    known = any(outcome.error_deg is not None for outcome in comparison.outcomes.values())
    header = ["method", "group", "family"]
    header += [f"{_LENGTHS[name]} {unit}" for name in lengths for unit in ("deg", "cm")]
    header += [f"held-out {judge}" for judge in comparison.shares] + ["failed", "s"]
    header += ["error deg (truth, not used)", "cm"] if known else []
    rows = [header]
    for s in comparison.ranking:
        keys = [f"{name}_{unit}" for name in lengths for unit in ("deg", "m")]
        values = {k: Interval(v.value) if brief else v for k, v in s.figures.items()}
        row = [s.name, str(s.tier), s.family, *(shown(values[key], key) for key in keys)]
        row += [shown(values[j], "px_deg") + "*" * shared[s.name] for j, shared in comparison.shares.items()]
        outcome = comparison.outcomes[s.name]
        failed = outcome.runs - outcome.solved
        row += [f"{failed} of {outcome.runs}" if failed else "0", brief_seconds(outcome.seconds or float("nan"))]
        if known:
            errors = outcome.error_deg, outcome.error_m
            row += [NONE if e is None else f"{e * f:.{d}f}" for e, f, d in zip(errors, (1, 100), (3, 1), strict=True)]
        rows.append(row)
    return rows


def comparison_text(comparison: Comparison) -> str:
    """Return the ranking, the sentence and the remarks for a terminal."""
    rows = table_of(comparison, brief=True)
    # Headers of several words take several lines.
    heads = [cell.split(" ") for cell in rows[0]]
    lines = [[head[i] if i < len(head) else "" for head in heads] for i in range(max(map(len, heads)))] + rows[1:]
    widths = [max(len(line[i]) for line in lines) for i in range(len(heads))]
    text = ["  ".join([line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])]).rstrip() for line in lines]
    return "\n".join(map(printable, [*text, "", comparison.sentence, *comparison.remarks, BLIND])) + "\n"


def comparison_page(comparison: Comparison) -> str:
    """Return the page: it works offline and loads nothing."""
    names = [s.name for s in comparison.ranking]
    apart = {frozenset((a, b)): f"{deg:.2f} deg {100 * m:.1f} cm" for a, b, deg, m in comparison.distances}
    pairs = [["", *names], *([a, *(apart.get(frozenset((a, b)), NONE) for b in names)] for a in names)]
    return rendered(
        "p2o_study.report/comparison.html",
        style="p2o.draw/run_page.css",
        title="Comparison of methods without ground truth",
        comparison=comparison,
        ranking=table_of(comparison, brief=False),
        distances=pairs,
        remarks=(*comparison.remarks, BLIND),
    )
