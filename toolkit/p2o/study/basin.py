"""Basins: from how far away a method still finds its way, as the share of starts over their rotation and translation.

A basin is a study whose rows are methods x sizes of the start's error, so it is kept, resumed and computed like one.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError, UnknownNameError
from p2o.geometry.perturb import Perturbation
from p2o.host.method import Example
from p2o.host.registry import Registry
from p2o.host.slots import METHOD_WORDS, Kind
from p2o.results.verdict import Trust
from p2o.run.words import parse_settings
from p2o.study.store import StoredRow
from p2o.study.study import Study, StudyFile, parse_study
from p2o.study.tally import near

_BESIDE = ("extractor", "solver", "init")
"""What a matcher's example says of the stages that go with it."""


@dataclass(frozen=True)
class Contender:
    """A method under the name that heat maps show: words of a recipe, and options by stage."""

    name: str
    words: Mapping[str, str]
    options: Mapping[str, Mapping[str, Any]]

    @classmethod
    def of(cls, text: str, study: Study | None, registry: Registry) -> Contender:
        """Return the method that a text names: a row of the study, else a matcher or calibrator that is installed.

        A matcher comes with the extractor, solver and init that its example names, and a recipe's own else; both with
        what the example sets besides. Raises UnknownNameError.
        """
        rows = {} if study is None else {row.label: row for row in study.rows()}
        if text in rows:
            words = {word: value for word, value in rows[text].words.items() if word in (*METHOD_WORDS, "accumulate")}
            return cls(text, words, rows[text].words.get("options", {}))
        for kind, word in ((Kind.MATCHER, "matcher"), (Kind.CALIBRATOR, "calibrator")):
            offer = next((offer for offer in registry.of_kind(kind) if offer.name == text), None)
            if offer is None:
                continue
            example = offer.method.example
            if example is None:
                return cls(text, {word: text}, {})
            beside = _companions(example) if kind is Kind.MATCHER else {}
            return cls(text, {word: text, **beside}, parse_settings(example.settings))
        known = [o.name for kind in (Kind.MATCHER, Kind.CALIBRATOR) for o in registry.of_kind(kind)]
        raise UnknownNameError("method", text, [*rows, *known], hint="name a matcher, a calibrator or a row of --study")


def _companions(example: Example) -> dict[str, str]:
    return {word: value for word in _BESIDE if (value := getattr(example, word))}


@dataclass(frozen=True)
class Grid:
    """The sizes of wrong starts, and what is near enough to the truth for a success.

    Raises InputError for sizes that are negative, double or too many.
    """

    rotations_deg: tuple[float, ...]
    translations_m: tuple[float, ...]
    within: Perturbation

    def __post_init__(self) -> None:
        for field in fields(self)[:2]:
            sizes = getattr(self, field.name)
            if not sizes or len(set(sizes)) < len(sizes) or not all(0 <= size <= 180 for size in sizes):
                raise InputError(
                    "the sizes of starts make no grid",
                    where=field.name,
                    expected="different numbers from 0 to 180",
                    got=" ".join(f"{size:g}" for size in sizes) or "none",
                )

    @property
    def cells(self) -> list[Perturbation]:
        """The wrong starts, row by row of one rotation."""
        return [Perturbation(a, d) for a, d in itertools.product(self.rotations_deg, self.translations_m)]


def basin_study(
    contenders: Sequence[Contender], grid: Grid, data: str, frames: str, seeds: int, joint: int | bool
) -> StudyFile:
    """Return the study of a basin: one row for each method and size, named by `label`."""
    lines = [
        'name = "basin"',
        'title = "Basins: which starts arrive"',
        f"seeds = {seeds}",
        f"joint = {json.dumps(joint)}",
        "[[dataset]]",
        'name = "data"',
        f"data = {json.dumps(data)}",
        f"frames = {json.dumps(frames)}",
    ]
    for contender, cell in itertools.product(contenders, grid.cells):
        lines += ["[[row]]", f"label = {json.dumps(label(contender, cell))}", f"section = {json.dumps(contender.name)}"]
        lines += [f"{word} = {json.dumps(value)}" for word, value in contender.words.items()]
        lines.append(f'perturb = "{cell}"')
        for stage, values in contender.options.items():
            lines += [f"options.{stage}.{name} = {_toml(value)}" for name, value in values.items()]
    text = "\n".join(lines) + "\n"
    return StudyFile(parse_study(text, "basin"), text, "basin")


def label(contender: Contender, cell: Perturbation) -> str:
    """Return the label of a method's row from a start of this size."""
    return f"{contender.name} from {cell}"


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{name} = {_toml(inner)}" for name, inner in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value)


@dataclass(frozen=True, eq=False)
class Basin:
    """What one method came to: by rotation and translation (R, T) of the start, shares of the calibrations.

    `success` of all calibrations ended near the truth, `refused` gave no estimate, and `deceived` are wrong and called
    trusted. `count` is how many there were; shares are NaN where there was none.
    """

    name: str
    success: Float
    refused: Float
    deceived: Float
    count: Float

    def as_dict(self) -> dict[str, Any]:
        """Return the shares as lists, for JSON; NaN becomes null."""
        shares = {name: getattr(self, name) for name in ("success", "refused", "deceived", "count")}
        plain = {
            name: [[None if np.isnan(x) else float(x) for x in row] for row in values]
            for name, values in shares.items()
        }
        return {"name": self.name, **plain}


def basin_of(contender: Contender, grid: Grid, rows: Sequence[StoredRow]) -> Basin:
    """Return the basin of one method from the finished rows of the study."""
    by_label: dict[str, list[StoredRow]] = {}
    for row in rows:
        by_label.setdefault(row.row, []).append(row)
    shape = (len(grid.rotations_deg), len(grid.translations_m))
    told = []
    for cell in grid.cells:
        found = by_label.get(label(contender, cell), [])
        arrived = [near(row, grid.within) for row in found]
        wrong = [row.trust is Trust.TRUSTED and not good for row, good in zip(found, arrived, strict=True)]
        count = len(found)
        shares = (sum(arrived), sum(not row.solved for row in found), sum(wrong))
        told.append([*(x / count if count else np.nan for x in shares), count])
    table = np.array(told, dtype=np.float64).T.reshape(4, *shape)
    return Basin(contender.name, *table)
