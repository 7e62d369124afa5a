"""Tables of a suite in Markdown, rendered from its rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from p2o.errors import UnknownNameError

from p2o_study.benchmark.marks import Writer
from p2o_study.benchmark.suite import Suite
from p2o_study.row import GIVEN, Row
from p2o_study.rows import Rows
from p2o_study.statistics import MIN_FRAMES, WRONG_TEXT, Statistics
from p2o_study.tables import error_table, figures_of, markdown_table, md_text

_WORDS = {"data": None, "methods": None, "columns": ("all", "brief"), "sections": ("apart", "together")}
"""Words of a mark and their values, None for names of the suite."""
_BRIEF = {"coverage 67 %", "coverage 95 %", "predicted 67 %"}
"""Columns that brief tables leave out."""


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
    last. `asked` are the rows of the suite. Labels are without "@ DATA SET".
    """

    suite: Suite
    lines: Mapping[Key, Statistics]
    asked: Sequence[Key]

    @classmethod
    def read(cls, suite: Suite, results: Rows) -> SuiteTables:
        """Return the tables of a suite; rows that it does not ask for are left out."""
        asked = [_key(row.section, row.label, row.dataset.name) for row in suite.all_rows()]
        rows: dict[Key, list[Row]] = {key: [] for key in asked}
        for row in results.latest(suite.name):
            key = _key(row.section, row.row, row.dataset)
            if row.method.external or key in rows:
                rows.setdefault(key, []).append(row)
        data = list(dict.fromkeys(key.dataset for key, own in rows.items() if own))
        keys = sorted((key for key, own in rows.items() if own), key=lambda key: data.index(key.dataset))
        return cls(suite, {key: Statistics(rows[key], key.label, suite.group_of) for key in keys}, asked)

    def markdown(self, choice: Choice) -> str:
        """Return the tables in Markdown, one for each section; raises InputError for a name that the suite lacks."""
        self._check(choice)
        keys = [key for key in dict.fromkeys((*self.asked, *self.lines)) if choice.has(key)]
        if choice.sections == "together":
            return self._table(self.suite.name, keys, choice)
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
            *(("data set", word, {table.name for table in self.suite.dataset}) for word in choice.data),
            *(("method", word, {key.label for key in keys}) for word in choice.methods),
        ]
        for kind, word, known in asked:
            if word not in known:
                raise UnknownNameError(kind, word, sorted(known), where=self.suite.file)

    @property
    def _development(self) -> set[str]:
        return {table.name for table in self.suite.dataset if table.development}

    def _shown(self, key: Key) -> str:
        return f"{key.dataset} †" if key.dataset in self._development else key.dataset

    def _table(self, caption: str, keys: Sequence[Key], choice: Choice) -> str:
        """Return the table of some rows with its caption."""
        wanted = set(keys)
        lines = {key: row for key, row in self.lines.items() if key in wanted}
        drawn = {protocol for row in lines.values() for protocol in row.protocols} - {GIVEN}
        start = f", initial error {next(iter(drawn))}" if len(drawn) == 1 else ""
        several = len({key.dataset for key in lines}) > 1
        marked = self._development & {key.dataset for key in lines}
        mark = "" if not marked else ", † development frames" if several else ", development frames"
        text = [f"**{md_text(caption or 'all rows')}{md_text(start)}{mark}**", ""]
        if lines:
            left_out = {"within", "worse", "ambiguous", "doubtful", *(_BRIEF if choice.columns == "brief" else ())}
            figures = figures_of(lines.values(), left_out | ({"start"} if len(drawn) < 2 else set()))
            rows = [
                Statistics(row.rows, f"{key.label} @ {self._shown(key)}" if several else key.label, row.group_of)
                for key, row in lines.items()
            ]
            table = error_table(caption, rows, figures=figures, solved_only=choice.columns == "all", comparable=False)
            text.append(markdown_table(table).rstrip("\n"))
        missing = sum(key in wanted and key not in lines for key in self.asked)
        if missing:
            text += [*([""] if lines else []), f"Rows not measured: {missing}."]
        return "\n".join([*text, ""])


NOTE = (
    "Runs are calibrations, frames distinct frames, groups independent ones (frames or drives). In brackets: 95 % "
    f"interval by bootstrap over groups, none for fewer than {MIN_FRAMES}. Means and medians contain refused "
    "calibrations with the error of their initial guess; solved only: the mean without them. False accepts: trusted "
    f"results {WRONG_TEXT}; outside 95 %: trusted results whose error exceeds their own 95 % bound. Coverage: rotation "
    "errors, then translation errors, within the predicted ones. Methods whose intervals overlap have no order."
)
"""How to read the tables."""


def rows_text(tables: Callable[[str], SuiteTables]) -> Writer:
    """Return the writer of marked parts with rows; `tables` returns the tables of a suite."""

    def text(subject: str, choices: Mapping[str, str]) -> str:
        suite, _, section = subject.partition(", ")
        words: dict[str, Any] = {}
        for name, value in choices.items():
            known = _WORDS[name]
            if known is not None and value not in known:
                raise ValueError(value)
            words[name] = tuple(value.split(", ")) if known is None else value
        words["methods"] = tables(suite).labels_in(words.get("methods", ()))
        return tables(suite).markdown(Choice(section or None, **words))

    return text
