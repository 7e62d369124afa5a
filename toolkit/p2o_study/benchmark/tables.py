"""Tables of a suite in Markdown, rendered from its rows."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from p2o.errors import UnknownNameError
from p2o.geometry.perturb import Perturbation
from p2o.options import Options

from p2o_study.benchmark.lines import Key, key_of, read_lines
from p2o_study.benchmark.marks import Writer
from p2o_study.benchmark.suite import Suite
from p2o_study.curves import curves, frames_of
from p2o_study.row import GIVEN, NORMS
from p2o_study.rows import Rows
from p2o_study.statistics import Statistics
from p2o_study.study import Published, limits_of
from p2o_study.tables import (
    NONE,
    Cell,
    Figure,
    Table,
    entries_by_default,
    entries_of,
    error_table,
    figures_of,
    markdown_table,
    md_text,
    with_unit,
)

_LISTS = ("data", "methods", "columns")
"""Words of a mark with several values."""
_BRIEF = {"predicted 67 %"}
"""Columns that brief tables leave out."""


class Choice(Options):
    """What a page takes of a suite: one section (None: all), and some of the data sets and labels (empty: all).

    `columns` are "all", "brief" (no "solved only", no predicted errors), or names of columns. The rows of all sections
    are in one table with `sections` "together". `pooled` adds a line over all data sets, or shows nothing else.
    `over` "frames" gives mean errors by method and number of frames, which methods differ by less than the accuracy of
    the `reference` ("0.1deg 0.01m"), and how many frames each needs for errors of `target`.
    """

    section: str | None = None
    data: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()
    columns: tuple[str, ...] = ("all",)
    sections: Literal["apart", "together"] = "apart"
    pooled: Literal["", "below", "only"] = ""
    over: Literal["", "frames"] = ""
    target: str = "0.1deg 0.04m"
    reference: str = ""

    def has(self, key: Key) -> bool:
        """Return whether a row is among the chosen data sets and methods."""
        return key.dataset in (self.data or (key.dataset,)) and key.label in (self.methods or (key.label,))


@dataclass(frozen=True)
class SuiteTables:
    """The last measured rows of a suite with their errors, from which its tables are rendered; no data are read.

    `lines` are the figures by section, label and data set (`read_lines`). `asked` are the rows of the suite.
    """

    suite: Suite
    lines: Mapping[Key, Statistics]
    asked: Sequence[Key]

    @classmethod
    def read(cls, suite: Suite, results: Rows) -> SuiteTables:
        """Return the tables of a suite; rows that it does not ask for are left out."""
        lines = read_lines(suite, results)
        data = list(dict.fromkeys(key.dataset for key in lines))
        ordered = {key: lines[key] for key in sorted(lines, key=lambda key: data.index(key.dataset))}
        return cls(suite, ordered, list(map(key_of, suite.all_rows())))

    def markdown(self, choice: Choice) -> str:
        """Return the tables in Markdown, one for each section; raises InputError for a name that the suite lacks."""
        self._check(choice)
        keys = [key for key in dict.fromkeys((*self.asked, *self.lines)) if choice.has(key)]
        if choice.over:
            return self._over_frames(keys, choice)
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

    def _caption(self, name: str, keys: Collection[Key], protocols: Collection[str]) -> str:
        """Return the caption of a table: a name, the initial error if there is one, and whether frames are marked."""
        start = f", initial error {next(iter(protocols))}" if len(protocols) == 1 else ""
        sets = {key.dataset for key in keys}
        marked = self._development & sets
        mark = "" if not marked else ", † development frames" if len(sets) > 1 else ", development frames"
        return f"**{md_text(name or 'all rows')}{md_text(start)}{mark}**"

    def _table(self, caption: str, keys: Sequence[Key], choice: Choice) -> str:
        """Return the table of some rows with its caption."""
        wanted = set(keys)
        lines = {key: row for key, row in self.lines.items() if key in wanted}
        drawn = {protocol for row in lines.values() for protocol in row.protocols} - {GIVEN}
        several = len({key.dataset for key in lines}) > 1
        text = [self._caption(caption, lines, drawn), ""]
        if lines:
            rows: list[Statistics | Published] = []
            for key, row in lines.items() if choice.pooled != "only" else ():
                label = f"{key.label} @ {self._shown(key)}" if several else key.label
                rows += [replace(row, label=label), *(p for p in self.suite.published if p.compares_with(key.label))]
            rows += self._pooled(lines) if choice.pooled else []
            measured = [row for row in rows if isinstance(row, Statistics)]
            entries = self._entries(measured, choice, several_starts=len(drawn) > 1)
            text.append(markdown_table(error_table(caption, rows, entries, comparable=False)).rstrip("\n"))
        missing = sum(key in wanted and key not in lines for key in self.asked)
        if missing:
            text += [*([""] if lines else []), f"Rows not measured: {missing}."]
        return "\n".join([*text, ""])

    def _entries(self, rows: Sequence[Statistics], choice: Choice, *, several_starts: bool) -> list[Figure]:
        """Return the columns of a table."""
        if choice.columns not in (("all",), ("brief",)):
            return entries_of(choice.columns, str(self.suite.file))
        brief = choice.columns == ("brief",)
        left_out = {"within", "worse", "ambiguous", "doubtful", *(_BRIEF if brief else ())}
        figures = figures_of(rows, left_out if several_starts else left_out | {"start"})
        return entries_by_default(rows, figures=figures, solved_only=not brief)

    def _pooled(self, lines: Mapping[Key, Statistics]) -> list[Statistics]:
        """Return one line over all rows where each data set occurs once, else one for each label; frames are groups."""
        once = len({key.dataset for key in lines}) == len(lines)
        by_label: dict[str, list[Key]] = {}
        for key in lines:
            by_label.setdefault("" if once else key.label, []).append(key)
        pooled = []
        for label, keys in by_label.items():
            marked = sum(key.dataset in self._development for key in keys)
            name = label or " or ".join(dict.fromkeys(key.label for key in keys))
            development = f", {marked} of them †" if marked else ""
            title = f"{name} @ {len(keys)} data sets{development}"
            pooled.append(Statistics([row for key in keys for row in lines[key].rows], title))
        return pooled

    def _over_frames(self, keys: Sequence[Key], choice: Choice) -> str:
        """Return the mean errors by method and number of frames, after a sentence on those that are tied."""
        lines = [line for key, line in self.lines.items() if key in set(keys)]
        methods = {name: {frames_of(line): line for line in own} for name, own in curves(lines, "frames").items()}
        target = limits_of(choice.target, str(self.suite.file))
        sizes = sorted({size for own in methods.values() for size in own})
        header = ("method", *(f"{size} frame{'s' * (size > 1)}" for size in sizes), f"frames for {_size_text(target)}")
        rows = []
        for name, own in methods.items():
            cells = [_means_text(own[size]) if size in own else NONE for size in sizes]
            rows.append(tuple(map(Cell, (name, *cells, _needed(own, target)))))
        runs = ", ".join(str(max(own[size].count for own in methods.values() if size in own)) for size in sizes)
        drawn = {protocol for line in lines for protocol in line.protocols} - {GIVEN}
        caption = self._caption(f"mean errors over the number of frames ({runs} runs)", keys, drawn)
        table = markdown_table(Table(caption, header, tuple(rows))).rstrip("\n")
        first = (
            [_ties(methods, sizes, limits_of(choice.reference, str(self.suite.file))), ""] if choice.reference else []
        )
        return "\n".join([*first, caption, "", table, ""])


def _size_text(size: Perturbation) -> str:
    return f"{size.angle_deg:g} deg and {100 * size.distance_m:g} cm"


def _means_text(line: Statistics) -> str:
    texts = [with_unit(line.average(norm), norm) for norm in NORMS]
    return ", ".join(texts) + (f" ({line.unmoved} not moved)" if line.unmoved else "")


def _needed(lines: Mapping[int, Statistics], target: Perturbation) -> str:
    """Return the number of frames from which on both mean errors are at most those of the target."""
    limits = dict(zip(NORMS, (target.angle_deg, target.distance_m), strict=True))
    needed = None
    for size in sorted(lines, reverse=True):
        if not all(lines[size].average(norm) <= limit for norm, limit in limits.items()):
            break
        needed = size
    return f"not reached with {max(lines)}" if needed is None else str(needed)


def _ties(methods: Mapping[str, Mapping[int, Statistics]], sizes: Sequence[int], reference: Perturbation) -> str:
    """Return which methods have mean errors within the accuracy of the reference of the smallest ones."""
    margins = dict(zip(NORMS, (reference.angle_deg, reference.distance_m), strict=True))
    tied = []
    for size in sizes:
        lines = {name: own[size] for name, own in methods.items() if size in own}
        least = {norm: min(line.average(norm) for line in lines.values()) for norm in NORMS}
        names = [
            md_text(name)
            for name, line in lines.items()
            if all(line.average(norm) <= least[norm] + margin for norm, margin in margins.items())
        ]
        tied.append(f"with {size} frame{'s' * (size > 1)} {', '.join(names) or 'none'}")
    return f"Within the accuracy of the reference ({_size_text(reference)}) of the smallest errors: {'; '.join(tied)}."


def rows_text(tables: Callable[[str], SuiteTables]) -> Writer:
    """Return the writer of marked parts with rows; `tables` returns the tables of a suite."""

    def text(subject: str, choices: Mapping[str, str]) -> str:
        suite, _, section = subject.partition(", ")
        if "section" in choices:
            raise KeyError("section")
        words: dict[str, Any] = {n: tuple(v.split(", ")) if n in _LISTS else v for n, v in choices.items()}
        words["methods"] = tables(suite).labels_in(words.get("methods", ()))
        return tables(suite).markdown(Choice(section=section or None, **words))

    return text
