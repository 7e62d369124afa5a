"""Lines of tables and of the page: the calibrations of one method on one data set in one section of a suite."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from p2o_study.benchmark.suite import Suite
from p2o_study.row import GIVEN, Row
from p2o_study.rows import Rows, latest
from p2o_study.statistics import Statistics
from p2o_study.study import ALL_JOINT, StudyRow


class Key(NamedTuple):
    """Names of a line; `label` is without "@ DATA SET"."""

    section: str
    label: str
    dataset: str


def key_of(row: StudyRow) -> Key:
    """Return the key of a row of a suite."""
    return _key(row.section, row.label, row.dataset.name)


def _key(section: str, label: str, dataset: str) -> Key:
    return Key(section, label.removesuffix(f" @ {dataset}"), dataset)


def read_lines(suite: Suite, results: Rows, *, only_asked: bool = True) -> dict[Key, Statistics]:
    """Return the last measured rows of a suite by line, in the order of the suite, those of external methods last.

    Rows, initial errors and seeds that the suite does not ask for are left out with `only_asked`. No data are read.
    """
    asked = suite.all_rows()
    rows: dict[Key, list[Row]] = {key_of(row): [] for row in asked}
    draws = {(key_of(row), row.words.get("perturb") or GIVEN, seed) for row in asked for seed in row.seeds}
    label_of = _external_labels(asked)
    for row in latest(results.each(suite.name)):
        key = _key(row.section, label_of(row) if row.method.external else row.row, row.dataset)
        if (key, row.case.protocol, row.seed) in draws or row.method.external or not only_asked:
            rows.setdefault(key, []).append(row)
    return {key: Statistics(own, key.label, suite.group_of) for key, own in rows.items() if own}


def _external_labels(asked: Sequence[StudyRow]) -> Callable[[Row], str]:
    """Return the function that names the line of a row of an external method.

    A section may ask for several numbers of frames and several initial errors, each a line of its own for every method.
    """
    kinds: dict[tuple[str, str], set[tuple[int, str]]] = {}
    for row in asked:
        kinds.setdefault((row.section, row.dataset.name), set()).add((row.joint, row.words.get("perturb") or GIVEN))

    def label_of(row: Row) -> str:
        known = kinds.get((row.section, row.dataset), set())
        case = row.case
        sizes = {size for size, protocol in known if protocol == case.protocol and bool(size) == bool(case.joint)}
        label = row.row
        if len({size for size, _ in known}) > 1:
            # The last group of a section may be smaller than the others.
            size = min((size for size in sizes if size >= case.joint), default=ALL_JOINT)
            label += f", {size} frames" if size > 0 else ", jointly" if case.joint else ", single frames"
        return f"{label} from {case.protocol}" if len({protocol for _, protocol in known}) > 1 else label

    return label_of
