"""Suites of the benchmark: TOML files that name a study and add the question, the protocol and independent groups.

A suite takes datasets, defaults and variants of its study; rows and products of the suite replace those of the study.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from p2o.errors import InputError
from p2o.files.input_file import existing_folder, read_text
from p2o.files.parsed_text import parse_toml
from p2o.host.registry import Registry
from p2o.options import validated
from p2o.run.protocol import PROTOCOLS

from p2o_study.statistics import GroupOf, by_drive, by_frames
from p2o_study.study import DatasetTable, Label, Line, Seeds, Study, StudyRow, find_study, named_file, shipped_toml

FOLDER = "suites"
"""Folder of suites in a package: PACKAGE/suites/NAME.toml."""


class Suite(Study):
    """The content of a suite file, completed by its study; `file` is its path.

    Published figures of the study stay where they compare with a row of the suite.

    `study` is the name of a study, or a path relative to the suite file. `protocol` replaces that of the study: the
    name of a publication's protocol, or a size such as "2deg 0.15m". `groups` are the units of the bootstrap:
    "frames" (each frame or joint group of frames) or "drive" (all frames whose names differ after the last "/").
    `splits` is a file of splits, relative to the suite file, from which datasets take the lists in their `split`.
    `share` allows rows that another suite has measured: not for a suite of seconds.
    """

    question: Line
    study: Line
    groups: Literal["frames", "drive"] = "frames"
    splits: Line = ""
    share: bool = True
    title: Label = "suite"
    dataset: tuple[DatasetTable, ...] = ()
    seeds: Seeds = 1
    file: Path = Path()

    @property
    def group_of(self) -> GroupOf:
        """The function that names the independent group of a row."""
        return by_drive if self.groups == "drive" else by_frames

    def over(self, study: Study) -> Suite:
        """Return the suite with everything of its study that it does not replace."""
        own = {*self.model_fields_set, "seeds", "published"}
        own |= {"row", "product"} if own & {"row", "product"} else set()
        changes: dict[str, Any] = {name: getattr(study, name) for name in Study.model_fields if name not in own}
        changes |= {"title": self.name, "note": self.question, "variant": (*study.variant, *self.variant)}
        if self.protocol:
            named = self.protocol in PROTOCOLS
            changes |= {"protocol": self.protocol if named else None, "perturb": None if named else self.protocol}
        suite = self.model_copy(update=changes)
        labels = [row.label for row in suite.all_rows()] if study.published else []
        compared = (one for one in study.published if any(map(one.compares_with, labels)))
        return suite.model_copy(update={"published": (*self.published, *compared)})

    def all_rows(self) -> list[StudyRow]:
        """Return the rows on all datasets, also on those without a path."""
        tables = tuple(table.model_copy(update={"optional": False}) for table in self.dataset)
        return self.model_copy(update={"dataset": tables}).rows()


def suites(registry: Registry, folder: str | Path | None = None) -> dict[str, Path]:
    """Return the files of suites by name: those in a folder, or those that loaded plugins ship (PACKAGE/suites)."""
    if folder is None:
        return shipped_toml(registry, FOLDER)
    return {path.stem: path for path in sorted(existing_folder(Path(folder), "suites").glob("*.toml"))}


def find_suite(word: str, registry: Registry, folder: str | Path | None = None) -> Suite:
    """Return the suite of a path, or of a name in `suites`.

    Raises UnknownNameError for an unknown name or key, InputError for a file that cannot be read, is not valid, or
    whose rows differ in seeds.
    """
    path = named_file(word, suites(registry, folder), "suite", folder)
    suite = validated(Suite, parse_toml(read_text(path, "suite"), "suite", path), where=path)
    named = path.parent / suite.study if suite.study.endswith(".toml") else suite.study
    suite = suite.over(find_study(str(named), registry)).with_methods(registry).model_copy(update={"file": path})
    if suite.splits:
        spec = f"@{path.parent / suite.splits}"
        suite = suite.overridden(frames=[f"{table.name}={spec}" for table in suite.dataset if table.split])
    first, *others = suite.all_rows()
    for row in others:
        if row.seeds != first.seeds:
            expected = f"the seeds of the first row, {list(first.seeds)}"
            raise InputError(f"seeds of row '{row.label}'", where=path, expected=expected, got=list(row.seeds))
    return suite
