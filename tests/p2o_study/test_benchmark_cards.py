"""Cards of data: every data set of a suite has one, and pages equal them."""

from __future__ import annotations

import json
from pathlib import Path

import p2o
import pytest
from p2o.cli import main
from p2o.run.words import split_data
from p2o_study.benchmark.card import FOLDER, cards_text, read_cards
from p2o_study.benchmark.measure import status_of
from p2o_study.benchmark.suite import find_suite, suites
from p2o_study.rows import Rows
from p2o_study.study import DatasetTable
from p2o_study.worker import Plugins

from tests.study_bench import PLUGIN

ROOT = Path(__file__).parents[2]
SUITES = ROOT / "baselines/p2o_baselines/suites"
SIZE = {"scenes": 1, "width_px": 128, "height_px": 64}
CARD = """title: Tiny frames
sensor: none
camera: none
place: nowhere
frames: "3"
licence: Apache-2.0
shown: true
source: the plugin of the tests
truth: exact
faults: none
learned: nothing
"""


def command(*words: str) -> int:
    return main(["benchmark", "cards", *words, "--plugin", str(PLUGIN)])


def folder(tmp_path: Path, text: str = CARD) -> str:
    (tmp_path / "tiny.yaml").write_text(text)
    return str(tmp_path)


# ---- the cards of the repository


@pytest.mark.parametrize("name", suites(p2o.Registry.load(environ={})))
def test_every_data_set_of_a_suite_has_one_card(name: str) -> None:
    suite = find_suite(name, p2o.Registry.load(environ={}), SUITES)
    cards = read_cards(ROOT / FOLDER)
    for table in suite.dataset:
        owners = [card for card in cards if cards[card].covers(table)]
        assert len(owners) == 1, f"{table.name}: {owners}"
        assert set(table.split) <= set(cards[owners[0]].lists)


def test_every_list_of_frames_has_a_card() -> None:
    splits, cards = json.loads((SUITES / "splits.json").read_text()), read_cards(ROOT / FOLDER)
    assert set(splits) <= {label for card in cards.values() for label in card.lists}


def test_the_page_of_cards_equals_the_cards() -> None:
    page = (ROOT / "docs/data-cards.md").read_text(encoding="utf-8")
    assert page.endswith(f"<!-- cards -->\n{cards_text(read_cards(ROOT / FOLDER), page=True)}<!-- /cards -->\n")


# ---- suites


def small(table: DatasetTable) -> DatasetTable:
    """Return a simulated dataset with images of a few pixels and two frames at most; others without a path."""
    name, options = split_data(table.data)
    if name != "synthetic":
        return table
    size = {**SIZE, "frames_per_scene": min(2, int(options.get("frames_per_scene", 1)))}
    return table.model_copy(update={"data": "synthetic:", "options": {**options, **table.options, **size}})


@pytest.mark.system
@pytest.mark.parametrize("name", [name for name in suites(p2o.Registry.load(environ={})) if name != "smoke"])
def test_every_suite_is_planned_without_data(name: str, tmp_path: Path) -> None:
    file = find_suite(name, p2o.Registry.load(environ={}), SUITES)
    real = {table.name for table in file.dataset if not table.data.startswith("synthetic:")}
    reduced = file.model_copy(update={"dataset": tuple(map(small, file.dataset))})
    status = status_of(reduced, Rows(tmp_path), plugins=Plugins())
    assert set(status.unchecked) == real
    assert (status.unreadable, status.removable) == (0, [])
    planned = {(row.dataset.name, row.label) for row in file.all_rows() if row.dataset.name not in real}
    assert {(entry.row.dataset, entry.row.row) for entry in status.entries} == planned
    seeds = set(file.all_rows()[0].seeds)
    assert all({e.row.seed for e in status.entries if e.row.row == label} == seeds for _, label in planned)


# ---- the command


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (CARD.replace("truth: exact\n", ""), "tiny.yaml: truth is missing"),
        (CARD + "accuracy: good\n", "tiny.yaml: unknown key 'accuracy'"),
        ("- a list\n", "tiny.yaml: the card is not valid; expected keys with values"),
    ],
)
def test_an_invalid_card_is_refused_with_its_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    assert command("--cards", folder(tmp_path, text)) == 2
    assert message in capsys.readouterr().err


def test_cards_are_written_between_the_marks_of_a_page(tmp_path: Path) -> None:
    (tmp_path / "cards").mkdir()
    cards = folder(tmp_path / "cards", CARD + "lists: [tiny]\n")
    page = tmp_path / "page.md"
    page.write_text("# Before\n\n<!-- cards -->\nold\n<!-- /cards -->\n\nafter\n")
    words = ["benchmark", "docs", str(page), "--cards", cards]
    assert main([*words, "--check"]) == 1
    assert main(words) == 0
    assert main([*words, "--check"]) == 0
    text = page.read_text()
    assert text.startswith("# Before\n\n<!-- cards -->\n| card |")
    assert "\n## tiny\n\n- **truth**: exact\n" in text
    assert text.endswith("\n<!-- /cards -->\n\nafter\n")
