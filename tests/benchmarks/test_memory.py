"""The tables of `benchmarks/memory.py`, made from given numbers, and the memory of reading a bag."""

from __future__ import annotations

import pytest
from bench import Cost
from memory import Peak, bag, commands_table, names_of, per_frame, table

PEAKS = {
    50: Peak(Cost(60.0, 40.0, 2000.0), {"extract": 30.0, "refine": 5.25}),
    250: Peak(Cost(200.0, 150.0, 2400.0), {"extract": 100.0}),
    500: Peak(Cost(400.0, 300.0, 2650.0), {"extract": 210.0, "agree": 2.0}),
}


def test_names_stand_for_the_distinct_frames_in_turn() -> None:
    assert names_of(5, 2) == [(f"frame-{number:04d}", shown) for number, shown in enumerate((0, 1, 0, 1, 0))]


def test_a_frame_costs_by_how_much_the_last_two_peaks_differ() -> None:
    assert per_frame(PEAKS) == pytest.approx(1.0)


def test_each_number_of_frames_has_its_peak_and_the_seconds_of_all_stages() -> None:
    lines = table(PEAKS).splitlines()
    assert lines[0] == "| frames | peak MiB | wall s | processor s | extract s | refine s | agree s |"
    assert lines[2] == "| 50 | 2000 | 40 | 60 | 30.0 | 5.2 |  |"
    assert lines[4] == "| 500 | 2650 | 300 | 400 | 210.0 |  | 2.0 |"


def test_each_command_has_a_line() -> None:
    assert commands_table({"run": Cost(4.0, 3.25, 512.4)}).splitlines()[2] == "| `run` | 512 | 3.2 | 4.0 |"


@pytest.mark.system
def test_reading_a_bag_does_not_keep_its_frames_in_memory() -> None:
    peaks = []
    for size_gb in (0.05, 0.4):
        [_, read] = bag(size_gb).items()
        assert read[0].startswith("data check")
        peaks.append(read[1].peak_mib)
    assert peaks[1] < peaks[0] + 100, "350 MB more of messages"
