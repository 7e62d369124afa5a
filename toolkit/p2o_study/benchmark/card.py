"""Cards of data: YAML files on the data sets of the benchmark, their ground truth and who learned from them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from p2o.errors import InputError
from p2o.files.input_file import listing, read_text
from p2o.files.parsed_text import parse_yaml
from p2o.options import Options, validated
from pydantic import StringConstraints

from p2o_study.study import DatasetTable, Label
from p2o_study.tables import md_text

FOLDER = Path("benchmarks/cards")
_FACTS = ("sensor", "camera", "place", "frames", "licence", "source", "truth", "faults", "learned")
_COLUMNS = ("sensor", "camera")
_OF_PAGE = ("truth", "faults", "learned")

Text = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=4000)]


class Card(Options):
    """The description of one data set.

    `frames` states their number, `shown` whether images may be published, `truth` the accuracy of the ground truth and
    how it is known, `learned` which of our methods were trained, tuned or chosen on it. `lists` are the lists of
    splits.json of the suites and the datasets of suites that it describes.
    """

    title: Label
    sensor: Text
    camera: Text
    place: Text
    frames: Text
    licence: Text
    shown: bool
    source: Text
    truth: Text
    faults: Text
    learned: Text
    lists: tuple[Label, ...] = ()

    def covers(self, dataset: DatasetTable) -> bool:
        """Return whether it describes one of the lists of a dataset of a suite, or the dataset by its name."""
        return bool(set(self.lists) & set(dataset.split or (dataset.name,)))

    @property
    def facts(self) -> dict[str, str]:
        """The texts of the card by heading."""
        return {fact: getattr(self, fact) for fact in _FACTS}


def read_cards(folder: Path = FOLDER) -> dict[str, Card]:
    """Return the cards of a folder by name, sorted.

    Raises InputError for a missing folder and an invalid card, UnknownNameError for an unknown key, with the file.
    """
    cards = {}
    for path in listing(folder, "cards"):
        if path.suffix == ".yaml":
            values = parse_yaml(read_text(path, "card"), "card", path)
            if not isinstance(values, dict):
                raise InputError("the card is not valid", where=path, expected="keys with values")
            cards[path.stem] = validated(Card, values, where=path)
    return dict(sorted(cards.items()))


def cards_text(cards: Mapping[str, Card], *, page: bool = False) -> str:
    """Return cards in Markdown: a table of all, then a section for each with its other facts.

    A `page` of cards has sections of those whose frames are measured, with what decides of them.
    """
    sections = [name for name, card in cards.items() if card.lists or not page]
    facts = _OF_PAGE if page else [fact for fact in _FACTS if fact not in _COLUMNS]
    lines = ["| card | data | LiDAR | camera | images may be shown |", "|:--|:--|:--|:--|:--|"]
    for name, card in cards.items():
        columns = [md_text(text) for text in (card.title, card.sensor, card.camera)]
        title = f"[{name}](#{name})" if name in sections else name
        columns.append("yes" if card.shown else "no")
        lines.append(f"| {' | '.join([title, *columns])} |")
    for name in sections:
        lines += ["", f"## {name}", ""]
        lines += [f"- **{fact}**: {md_text(cards[name].facts[fact])}" for fact in facts]
    return "\n".join([*lines, ""])
