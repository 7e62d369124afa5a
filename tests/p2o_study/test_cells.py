"""The calibrations of a study are known before one is worked out, and each is the same whenever it is asked for."""

from __future__ import annotations

import tracemalloc
from typing import Any

import pytest
from p2o import se3
from p2o_study.cells import Cells, FeatureKeys, open_rows
from p2o_study.study import check_study, parse_study
from p2o_study.worker import FrameRecord, Plugins

from tests.study_bench import HEAD, PLUGIN
from tests.study_plugin import CAMERA, TRUTH

HASHES = {"cloud": "c" * 64, "sweep": "c" * 64, "frame": "f" * 64}


def cells_of(frames: int, seeds: int, row: str, initial_guess: Any = None) -> Cells:
    plugins = Plugins(files=(str(PLUGIN),))
    text = HEAD.replace("seeds = 2", f"seeds = {seeds}").replace("frames = 3", f"frames = {frames}") + row
    rows = open_rows(check_study(parse_study(text), plugins.registry()), plugins, at_most=10**6)
    facts = {
        source: FrameRecord(source, {"image": f"{source.index:064d}", **HASHES}, CAMERA, TRUTH)
        for entry in rows
        for source in entry.sources
    }
    return Cells(rows, facts, initial_guess)


def test_a_million_calibrations_are_known_and_none_of_them_is_held() -> None:
    row = '[[row]]\nlabel = "quick"\ncalibrator = "quick"\nwitness = "none"\n'
    cells_of(1, 1, row)  # imports of plugins are neither measured nor slowed down by the measurement
    tracemalloc.start()
    try:
        cells = cells_of(1000, 1000, row)
        assert len(cells) == 10**6
        first, last = cells[0], cells[len(cells) - 1]
        some = [cells[position].row.key for position in range(0, 10**6, 50_000)]
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert (first.row.seed, first.group.records[0].name) == (0, "tiny/000")
    assert (last.row.seed, last.group.records[0].name) == (999, "tiny/999")
    assert len(set(some)) == len(some)
    assert peak < 50 * 2**20, "50 bytes for each of them"


def test_a_calibration_is_the_same_in_turn_and_by_its_place() -> None:
    rows = (
        '[[row]]\nlabel = "one"\nmatcher = "ogm"\n[[row]]\nlabel = "two"\nmatcher = "nearest"\njoint = 2\nseeds = 3\n'
    )
    cells = cells_of(5, 2, rows)
    assert len(cells) == 5 * 2 + 3 * 3
    in_turn = [(cell.row.key, cell.row.seed, [fact.name for fact in cell.group.records]) for cell in cells]
    assert len({key for key, _, _ in in_turn}) == len(cells)
    for position in (18, 3, 11, 0, 10, 9):
        cell = cells[position]
        assert (cell.row.key, cell.row.seed, [fact.name for fact in cell.group.records]) == in_turn[position]
    assert [(group.joint, seed) for _, group, seed in map(cells.place, (9, 10, 18))] == [(0, 1), (2, 0), (1, 2)]
    with pytest.raises(IndexError):
        cells[len(cells)]


def test_keys_of_features_hang_on_the_frame_and_the_extractor_and_on_no_seed() -> None:
    cells, keys = cells_of(2, 3, '[[row]]\nlabel = "one"\n'), FeatureKeys()
    found = [keys.of(cell.method, cell.group.records[0]) for cell in cells]
    assert [one["extractor"] for one in found] == 3 * [found[0]["extractor"]] + 3 * [found[3]["extractor"]]
    assert found[0]["extractor"] != found[3]["extractor"]
    assert found[0]["cloud"] == found[3]["cloud"], "both sweeps have the same content"


def test_a_calibration_from_another_initial_guess_has_another_key() -> None:
    row = '[[row]]\nlabel = "one"\n'
    near, same, far = (
        next(iter(cells_of(1, 1, row, lambda *_, x_m=x_m: se3.make(translation=[x_m, 0, 0]))))
        for x_m in (0.1, 0.1, 0.2)
    )
    assert near.method.digest == far.method.digest
    assert near.group.content == far.group.content
    assert near.row.key == same.row.key != far.row.key
