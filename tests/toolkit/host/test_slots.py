"""One table of slots, and everything that names them agrees with it."""

from __future__ import annotations

import inspect

import p2o
import pytest
from p2o import Kind
from p2o.cli.run import command
from p2o.host import hookspecs, method
from p2o.host.slots import METHOD_WORDS, SLOT_OF, SLOTS, Slot
from p2o_study.study import Product, RowTable, Words


def test_every_kind_has_one_slot_and_one_stage() -> None:
    assert sorted(slot.kind for slot in SLOTS) == sorted(Kind)
    assert len({slot.stage for slot in SLOTS}) == len(SLOTS)
    assert all(hasattr(hookspecs, slot.kind.hook) for slot in SLOTS)
    assert method.Kind is p2o.Kind is Kind


@pytest.mark.parametrize("slot", [slot for slot in SLOTS if slot.in_recipe], ids=lambda slot: slot.stage)
def test_recipe_call_and_command_line_take_the_word_of_each_slot(slot: Slot) -> None:
    assert slot.word in p2o.Recipe.model_fields
    assert slot.word in inspect.signature(p2o.calibrate).parameters
    assert slot.option in {text for parameter in command.params for text in parameter.opts}


@pytest.mark.parametrize("word", METHOD_WORDS)
def test_study_files_and_stored_rows_take_the_word_of_each_slot(word: str) -> None:
    for table in (Words, RowTable, Product):
        assert word in table.model_fields


def test_an_extractor_is_written_beside_the_other_one_and_an_option_in_the_words_of_its_slot() -> None:
    others = {"extractor": "stereo", "cloud": "rings", "matcher": "ogm"}
    assert SLOT_OF[Kind.IMAGE_EXTRACTOR].spec("canny", others) == "canny/rings"
    assert SLOT_OF[Kind.CLOUD_EXTRACTOR].spec("depth", others) == "stereo/depth"
    assert SLOT_OF[Kind.MATCHER].spec("nearest", others) == "nearest"
    assert SLOT_OF[Kind.CLOUD_EXTRACTOR].setting("rings", "min_gap_m", "0.5") == "--set cloud.min_gap_m=0.5"
    assert SLOT_OF[Kind.EXPORTER].setting("kitti", "layout", "raw") == "--export kitti:PATH?layout=raw"
