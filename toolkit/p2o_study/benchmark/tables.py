"""Tables of a suite in Markdown, rendered from its rows, and the marked parts of pages that they replace."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import read_text

from p2o_study.benchmark.outcomes import Outcomes, split_by
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.suite import SuiteFile
from p2o_study.benchmark.summary import RowSummary, clusters_of, dataset_clusters, summarised
from p2o_study.report.bootstrap import MIN_FRAMES, Interval
from p2o_study.report.summary import NORMS
from p2o_study.report.tables import NONE, md_text, shown
from p2o_study.tally import brief_seconds

_WORDS = {"data": None, "methods": None, "columns": ("all", "brief"), "sections": ("apart", "together")}
"""Words of a mark and their values, None for names of the suite."""
_PART = re.compile(
    r"^(?P<head><!-- rows: (?P<suite>[a-z0-9._-]+)(?:, (?P<section>[^>;\n]+?))?(?P<filters>(?:; [^>;\n]+?)*) -->\n)"
    r"(?:(?!^<!-- rows:).)*?(?P<tail>^<!-- /rows -->$)",
    re.DOTALL | re.MULTILINE,
)
_VALUE = re.compile(r"(?P<head>(?<!`)<!-- value: (?P<named>[^>\n]+?) -->)[^\n]*?(?P<tail><!-- /value -->)")
_HEAD = re.compile(r"^<!-- rows:|(?<!`)<!-- value:", re.MULTILINE)
_MARK = re.compile(r"^<!-- (?:rows:|record:|cards -->)|(?<!`)<!-- value:", re.MULTILINE)
VALUES = ("n", "groups", "refused", "trusted", "false accepts", "within 67 %", "within 95 %", "time")
"""Names of the values of a row, beside mean, median and interval of a norm (`rotation mean`)."""


class Key(NamedTuple):
    """Names of a row of a table; `label` is without "@ DATA SET"."""

    section: str
    label: str
    dataset: str


def _key(section: str, label: str, dataset: str) -> Key:
    return Key(section, label.removesuffix(f" @ {dataset}"), dataset)


@dataclass(frozen=True)
class Choice:
    """What a page takes of a suite: one section (None: all), and some of the data sets and labels (empty: all).

    `columns` are all, or of a brief table without "solved only" and coverage. The rows of all sections are in one table
    with `sections` "together".
    """

    suite: str
    section: str | None = None
    data: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    columns: Literal["all", "brief"] = "all"
    sections: Literal["apart", "together"] = "apart"

    def has(self, key: Key) -> bool:
        """Return whether a row is among the chosen data sets and methods."""
        return key.dataset in (self.data or (key.dataset,)) and key.label in (self.methods or (key.label,))


@dataclass(frozen=True)
class SuiteTables:
    """The last measured rows of a suite with their errors, from which its tables are rendered; no data are read.

    `lines` are the figures by section, label and data set, in the order of the suite, with those of external methods
    last; `protocols` the draws of their initial guesses. `asked` are the rows of the suite. Labels are without
    "@ DATA SET".
    """

    suite: SuiteFile
    lines: Mapping[Key, RowSummary]
    protocols: Mapping[Key, frozenset[str]]
    asked: Sequence[Key]

    @classmethod
    def read(cls, suite: SuiteFile, results: Results) -> SuiteTables:
        """Return the tables of a suite; raises InputError for a row whose frame is not listed."""
        outcomes = Outcomes.read(results, suite.name, results.frames)
        clusters = clusters_of(outcomes, suite.suite.groups)
        asked = {(row.label, row.dataset.name): _key(row.section, row.label, row.dataset.name) for row in suite.rows}
        figures: dict[Key, RowSummary] = {}
        protocols: dict[Key, frozenset[str]] = {}
        for runs in split_by(outcomes.runs[outcomes.latest], "row", "dataset"):
            label, dataset = outcomes.rows[runs["row"][0]], outcomes.datasets[runs["dataset"][0]]
            # The rows of an external method are those of all sections together, in the first one.
            external = outcomes.methods[runs["method"][0]][0].external
            key = (
                Key(outcomes.sections[runs["section"][0]], label, dataset) if external else asked.get((label, dataset))
            )
            if key is not None:
                figures[key] = summarised(runs, dataset_clusters(runs, clusters))
                protocols[key] = frozenset(outcomes.protocols[number] for number in np.unique(runs["protocol"]))
        keys = [key for key in asked.values() if key in figures]
        keys += [key for key in figures if key not in set(keys)]
        data = list(dict.fromkeys(key.dataset for key in keys))
        keys.sort(key=lambda key: data.index(key.dataset))
        return cls(suite, {key: figures[key] for key in keys}, protocols, list(asked.values()))

    def markdown(self, choice: Choice) -> str:
        """Return the tables in Markdown, one for each section; raises InputError for a name that the suite lacks."""
        self._check(choice)
        keys = [key for key in (*self.asked, *self.lines) if choice.has(key)]
        if choice.sections == "together":
            return self._table(self.suite.suite.name, keys, choice)
        sections = dict.fromkeys(key.section for key in keys if choice.section in (None, key.section))
        return "\n".join(self._table(name, [key for key in keys if key.section == name], choice) for name in sections)

    def labels_in(self, words: Sequence[str]) -> tuple[str, ...]:
        """Return the labels of words that were separated by commas, which labels may contain."""
        known = {key.label for key in (*self.asked, *self.lines)}
        labels = []
        first = 0
        while first < len(words):
            ends = [end for end in range(len(words), first + 1, -1) if ", ".join(words[first:end]) in known]
            end = ends[0] if ends else first + 1
            labels.append(", ".join(words[first:end]))
            first = end
        return tuple(labels)

    def _check(self, choice: Choice) -> None:
        keys = [*self.asked, *self.lines]
        asked = [
            *(("section", word, {key.section for key in keys}) for word in (choice.section,) if word is not None),
            *(("data set", word, {table.name for table in self.suite.study.study.dataset}) for word in choice.data),
            *(("method", word, {key.label for key in keys}) for word in choice.methods),
        ]
        for kind, word, known in asked:
            if word not in known:
                raise UnknownNameError(kind, word, sorted(known), where=self.suite.source)

    def _table(self, caption: str, keys: Sequence[Key], choice: Choice) -> str:
        """Return the table of some rows with its caption."""
        wanted = set(keys)
        lines = {key: row for key, row in self.lines.items() if key in wanted}
        drawn = frozenset[str]().union(*(self.protocols[key] for key in lines)) - {""}
        start = f", initial error {next(iter(drawn))}" if len(drawn) == 1 else ""
        text = [f"**{md_text(caption or 'all rows')}{md_text(start)}**", ""]
        datasets = {key.dataset for key in lines}
        form = _Form(
            refused=any(row.refused for row in lines.values()),
            judged=any(row.trusted is not None for row in lines.values()),
            brief=choice.columns == "brief",
        )
        if lines:
            header = [*(["data"] if len(datasets) > 1 else []), "method", *form.header]
            text += [_line(header), _line([":--", *["--:"] * (len(header) - 1)])]
            for key, row in lines.items():
                cells = [key.dataset, key.label][len(datasets) < 2 :]
                text.append(_line([*map(md_text, cells), *form.cells(row)]))
        missing = sum(key in wanted and key not in lines for key in self.asked)
        if missing:
            text += [*([""] if lines else []), f"Rows not measured: {missing}."]
        return "\n".join([*text, ""])

    def value(self, section: str, label: str, dataset: str, name: str) -> str:
        """Return one figure of a row as text with its unit, "not measured" without the row.

        `name` is one of `VALUES`, or "rotation" or "translation" with "mean", "median" or "interval". Raises
        InputError for a name that the suite lacks.
        """
        self._check(Choice(self.suite.name, section, (dataset,), (label,)))
        row = self.lines.get(Key(section, label, dataset))
        return "not measured" if row is None else _named_value(row, name, str(self.suite.source))


def _line(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


@dataclass(frozen=True)
class _Form:
    """The columns of a table: some have no entries without `refused` or `judged` runs."""

    refused: bool
    judged: bool
    brief: bool

    @property
    def header(self) -> list[str]:
        """The columns behind the method."""
        header = ["n (groups)", *(["refused"] if self.refused else [])]
        for name, unit in (("rotation", "deg"), ("translation", "cm")):
            header += [f"{name} mean [{unit}]", "median"]
            header += ["solved only"] if self.refused and not self.brief else []
        header += ["trusted", "false accepts"] if self.judged else []
        header += ["within 67 %", "within 95 %"] if self.judged and not self.brief else []
        return [*header, "time [s]"]

    def cells(self, row: RowSummary) -> list[str]:
        """Return the cells of a row behind its label."""
        cells = [f"{row.count} ({row.groups})", *([str(row.refused)] if self.refused else [])]
        for norm in NORMS:
            cells += [shown(row.mean.get(norm), norm), _value(norm, row.median.get(norm))]
            cells += [_value(norm, row.solved_only.get(norm))] if self.refused and not self.brief else []
        counts = (row.trusted, row.false_accepts) if self.judged else ()
        cells += [NONE if count is None else str(count) for count in counts]
        cells += [row.coverage.text_67, row.coverage.text_95] if self.judged and not self.brief else []
        return [*cells, brief_seconds(row.seconds)]


def _value(norm: str, value: float | None) -> str:
    return shown(None if value is None else Interval(value), norm)


def _named_value(row: RowSummary, name: str, where: str) -> str:
    """Return a figure of a row by its name, with its unit."""
    plain: dict[str, object] = {
        "n": row.count,
        "groups": row.groups,
        "refused": row.refused,
        "trusted": NONE if row.trusted is None else row.trusted,
        "false accepts": NONE if row.false_accepts is None else row.false_accepts,
        "within 67 %": row.coverage.text_67,
        "within 95 %": row.coverage.text_95,
        "time": f"{brief_seconds(row.seconds)} s",
    }
    if name in plain:
        return str(plain[name])
    for norm, unit in zip(NORMS, ("deg", "cm"), strict=True):
        average = row.mean.get(norm)
        mean = _value(norm, None if average is None else average.value)
        texts = {"mean": mean, "median": _value(norm, row.median.get(norm)), "interval": shown(average, norm)}
        word, _, statistic = name.partition(" ")
        if norm.startswith(word) and statistic in texts:
            return f"{texts[statistic]} {unit}"
    kinds = [f"{word} {kind}" for word in ("rotation", "translation") for kind in ("mean", "median", "interval")]
    raise UnknownNameError("value", name, [*VALUES, *kinds], where=where)


NOTE = (
    "n is the number of calibrations, in parentheses that of independent groups (frames or drives). In brackets: 95 % "
    f"interval by bootstrap over groups, none for fewer than {MIN_FRAMES}. Means and medians contain refused "
    "calibrations with the error of their initial guess; solved only: the mean without them. Within 67 % and 95 %: "
    "rotation errors, then translation errors, within the predicted ones. Methods whose intervals overlap have no "
    "order."
)
"""How to read the tables."""


def rendered(text: str, where: str, tables: Callable[[str], SuiteTables]) -> str:
    """Return a page with its marked parts replaced; `tables` returns the tables of a suite.

    A table is between `<!-- rows: SUITE -->` and `<!-- /rows -->`. The mark may name a section and choose data sets and
    methods: `<!-- rows: SUITE, SECTION; data: A, B; methods: X, Y; columns: brief -->`, and
    `sections: together` makes one table of all. One figure is between
    `<!-- value: SUITE; SECTION; METHOD; DATA; NAME -->` and `<!-- /value -->` in a line. Raises InputError for a mark
    that is not valid or not closed.
    """
    starts = {part.start() for pattern in (_PART, _VALUE) for part in pattern.finditer(text)}
    for head in _HEAD.finditer(text):
        if head.start() not in starts:
            raise InputError("a marked part is not valid", where=_place(text, where, head), expected=_EXPECTED)

    def table(part: re.Match[str]) -> str:
        filters: dict[str, Any] = {}
        for words in filter(None, part["filters"].split("; ")):
            name, _, values = words.partition(": ")
            known = _WORDS.get(name, ())
            if not values or (known is not None and values not in known):
                raise InputError("a marked part is not valid", where=_place(text, where, part), expected=_EXPECTED)
            filters[name] = tuple(values.split(", ")) if known is None else values
        filters["methods"] = tables(part["suite"]).labels_in(filters.get("methods", ()))
        choice = Choice(part["suite"], part["section"], **filters)
        return f"{part['head']}{tables(choice.suite).markdown(choice)}{part['tail']}"

    def value(part: re.Match[str]) -> str:
        words = part["named"].split("; ")
        if len(words) != 5:
            raise InputError("a marked part is not valid", where=_place(text, where, part), expected=_EXPECTED)
        suite, section, label, dataset, name = words
        return f"{part['head']}{tables(suite).value(section, label, dataset, name)}{part['tail']}"

    return _VALUE.sub(value, _PART.sub(table, text))


_EXPECTED = (
    "<!-- rows: SUITE, SECTION; data: A, B; methods: X, Y --> on its own line (all but SUITE optional) and "
    "<!-- /rows --> after it, or <!-- value: SUITE; SECTION; METHOD; DATA; NAME --> and <!-- /value --> in one line"
)


def _place(text: str, where: str, part: re.Match[str]) -> str:
    return f"{where}:{text.count(chr(10), 0, part.start()) + 1}"


def pages_with_marks(paths: Sequence[Path]) -> dict[Path, str]:
    """Return the text of the pages that have a marked part, of rows, records or cards."""
    texts = {path: read_text(path, "page") for path in paths}
    return {path: text for path, text in texts.items() if _MARK.search(text)}
