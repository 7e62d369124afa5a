"""Tables of a suite in Markdown, rendered from its rows, and the marked parts of pages that they replace."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from p2o.arrays import Int
from p2o.errors import InputError
from p2o.files.input_file import read_text

from p2o_study.benchmark.outcomes import Outcomes, Runs, split_by
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.suite import SuiteFile
from p2o_study.benchmark.summary import clusters_of, dataset_clusters, summarised
from p2o_study.report.bootstrap import MIN_FRAMES, Interval
from p2o_study.report.summary import NORMS
from p2o_study.report.tables import NONE, md_text, shown
from p2o_study.tally import brief_seconds

_HEADER = (
    "method",
    "n",
    "groups",
    "refused",
    "rotation mean [deg]",
    "median",
    "solved only",
    "translation mean [cm]",
    "median",
    "solved only",
    "trusted",
    "false accepts",
    "coverage 67 %",
    "coverage 95 %",
    "time [s]",
)
_PART = re.compile(
    r"^(?P<head><!-- rows: (?P<suite>[a-z0-9._-]+)(?:, (?P<section>[^>\n]+?))? -->\n)"
    r"(?:(?!^<!-- rows:).)*?(?P<tail>^<!-- /rows -->$)",
    re.DOTALL | re.MULTILINE,
)
_HEAD = re.compile(r"^<!-- rows:", re.MULTILINE)
_MARK = re.compile(r"^<!-- (?:rows:|cards -->)", re.MULTILINE)


class _Labelled(NamedTuple):
    """The runs of one label, and the draws of their initial guesses."""

    runs: Runs
    protocols: tuple[str, ...]


def table_of(suite: SuiteFile, results: Results, section: str | None = None) -> str:
    """Return the tables of a suite in Markdown, one for each section, from its last measured rows; no data are read.

    Raises InputError for a section that the suite lacks, and for a row whose frame is not listed.
    """
    outcomes = Outcomes.read(results, suite.name, results.frames)
    clusters = clusters_of(outcomes, suite.suite.groups)
    runs, external = _by_label(outcomes)
    sections: dict[str, list[str]] = {}
    for study_row in suite.rows:
        sections.setdefault(study_row.section, []).append(study_row.label)
    if section is not None and section not in sections:
        raise InputError("unknown section", where=suite.source, expected=" or ".join(map(repr, sections)), got=section)
    parts = []
    for name, labels in sections.items():
        measured = [label for label in (*labels, *external.get(name, ())) if label in runs]
        if section in (None, name):
            parts.append(_section(name, measured, len(labels) - sum(label in runs for label in labels), runs, clusters))
    return "\n".join(parts)


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _by_label(outcomes: Outcomes) -> tuple[dict[str, _Labelled], dict[str, list[str]]]:
    """Return the last measured runs of each label, and the labels of external methods by section."""
    latest = outcomes.runs[outcomes.latest]
    runs = {
        outcomes.rows[own["row"][0]]: _Labelled(own, tuple(outcomes.protocols[i] for i in np.unique(own["protocol"])))
        for own in split_by(latest, "row")
    }
    # The rows of an external method are those of all sections together, in the first one.
    foreign = np.array([method.external for method, _ in outcomes.methods], bool)
    external: dict[str, list[str]] = {}
    for run in latest[foreign[latest["method"]]] if len(latest) else ():
        known = external.setdefault(outcomes.sections[run["section"]], [])
        if outcomes.rows[run["row"]] not in known:
            known.append(outcomes.rows[run["row"]])
    return runs, external


def _section(
    name: str,
    labels: Sequence[str],
    unmeasured: int,
    runs: Mapping[str, _Labelled],
    clusters: Int,
) -> str:
    """Return the table of a section with its caption."""
    own = {protocol for label in labels for protocol in runs[label].protocols}
    start = f", from {', '.join(sorted(filter(None, own)))}" if len(own) == 1 else ""
    lines = [f"**{md_text(name or 'all rows')}{md_text(start)}**", ""]
    if labels:
        lines += [_line(_HEADER), _line([":--", *["--:"] * (len(_HEADER) - 1)])]
        lines += [_line([md_text(label), *_figures(runs[label].runs, clusters)]) for label in labels]
    if unmeasured:
        lines += [""] if labels else []
        lines.append(f"{unmeasured} rows are not measured.")
    return "\n".join([*lines, ""])


def _figures(runs: Runs, clusters: Int) -> list[str]:
    """Return the cells of a row behind its label."""
    row = summarised(runs, dataset_clusters(runs, clusters))
    cells = [str(row.count), str(row.groups), str(row.refused)]
    for norm in NORMS:
        cells += [shown(row.mean.get(norm), norm), _value(norm, row.median.get(norm))]
        cells.append(_value(norm, row.solved_only.get(norm)))
    cells += [NONE if count is None else str(count) for count in (row.trusted, row.false_accepts)]
    return [*cells, row.coverage.text_67, row.coverage.text_95, brief_seconds(row.seconds)]


def _value(norm: str, value: float | None) -> str:
    return shown(None if value is None else Interval(value), norm)


NOTE = (
    "n is the number of calibrations, groups that of independent groups (frames or drives). In brackets: 95 % interval "
    f"by bootstrap over groups, none for fewer than {MIN_FRAMES}. Means and medians contain refused calibrations with "
    "the error of their initial guess; solved only: the mean without them. Methods whose intervals overlap have no "
    "order."
)
"""How to read the tables."""


def rendered(text: str, where: str, table: Callable[[str, str | None], str]) -> str:
    """Return a page with its marked parts replaced; `table` returns that of a suite and section.

    A part is marked by `<!-- rows: SUITE -->` or `<!-- rows: SUITE, SECTION -->` and `<!-- /rows -->`. Raises
    InputError for a mark that is not closed.
    """
    parts = list(_PART.finditer(text))
    starts = {part.start() for part in parts}
    for head in _HEAD.finditer(text):
        if head.start() not in starts:
            line = text.count("\n", 0, head.start()) + 1
            expected = (
                "<!-- rows: SUITE -->, or <!-- rows: SUITE, SECTION -->, on its own line, and <!-- /rows --> after it"
            )
            raise InputError("a marked part is not valid", where=f"{where}:{line}", expected=expected)
    return _PART.sub(lambda part: f"{part['head']}{table(part['suite'], part['section'])}{part['tail']}", text)


def pages_with_marks(paths: Sequence[Path]) -> dict[Path, str]:
    """Return the text of the pages that have a marked part, of rows or cards."""
    texts = {path: read_text(path, "page") for path in paths}
    return {path: text for path, text in texts.items() if _MARK.search(text)}
