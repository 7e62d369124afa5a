"""Networks trained on several rigs: which frames they learn, and the whole experiment in a small size."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import many_rigs
import pytest
from many_rigs import Sizes, label_files, line, table


@pytest.mark.parametrize("rigs", [1, 10, 100])
def test_trainings_differ_in_the_number_of_rigs_and_in_nothing_else(rigs: int) -> None:
    sizes = Sizes()
    entries = list(label_files(Path("out"), rigs, 0, sizes).values())
    frames = {(scene, number) for scene in range(sizes.scenes) for number in range(sizes.frames)}
    assert {(scene, number) for scene, number, _ in entries} == frames
    assert len(entries) == len(frames)
    of_each = Counter(rig for *_, rig in entries)
    assert len(of_each) == rigs
    assert max(of_each.values()) - min(of_each.values()) <= 1


def test_rigs_of_tests_are_in_no_training() -> None:
    drawn = [many_rigs.options_of(stream, n, 1, 0.05).mount for stream in (0, many_rigs._TEST_RIGS) for n in range(5)]
    assert len(set(drawn)) == 10


ROW = {"test": "unseen rigs", "guess": "2deg 0.15m", "status": "converged", "trusted": True, "start_deg": 2.0}
ROW |= {"start_m": 0.15, "steps": 400, "seed": 0, "trained": 0}


def test_the_table_counts_failures_with_their_initial_error_and_resamples_rigs() -> None:
    rows = [
        {**ROW, "method": "10", "rig": f"0/{rig}", "scene": rig, "rotation_deg": float(rig), "translation_m": 0.1}
        for rig in range(5)
    ]
    rows.append({**rows[0], "status": "failed", "rotation_deg": 2.0})
    rows += [{**row, "method": "shipped", "steps": 0} for row in rows]
    cells = line(rows[:6], "rig", initial=False).split(" | ")
    assert cells[:4] == ["6 (5)", "1", "6, 4", "2"]
    assert cells[4].startswith("2.00 [")
    assert cells[5].startswith("2.00 [")
    assert "| network, 10 rigs, 400 steps |" in table(rows)


def test_differences_between_trainings_are_paired_by_frame_and_initial_guess() -> None:
    errors = {"1": (1.0, 2.0, 3.0, 4.0, 5.0), "10": (0.5, 1.5, 2.5, 3.5, 4.5, 99.0)}
    rows = [
        {**ROW, "method": method, "rig": f"0/{rig}", "scene": rig, "rotation_deg": error}
        for method, of in errors.items()
        for rig, error in enumerate(of)
    ]
    assert many_rigs.differences(rows)[2:] == [
        "| 10 rigs minus 1 | unseen rigs, 2deg 0.15m | -0.50 [-0.50, -0.50] |",
    ]
    assert many_rigs.differences(rows[:5]) == []


@pytest.mark.system
def test_the_experiment_runs_and_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = Sizes(
        rigs=(1, 2),
        scenes=1,
        frames=2,
        test_rigs=1,
        own_scenes=1,
        steps=2,
        batch=2,
        seeds=1,
        workers=1,
        test_megapixels=0.05,
    )
    monkeypatch.setattr(many_rigs, "CASES", (("unseen rigs", many_rigs.NEAR), ("training rig", many_rigs.NEAR)))
    monkeypatch.setattr(many_rigs, "OURS", {many_rigs.NEAR: {"init": "given"}})
    many_rigs.simulate(tmp_path, sizes)
    many_rigs.train(tmp_path, sizes)
    many_rigs.test(tmp_path, sizes)
    written = (tmp_path / "results.jsonl").read_text()
    many_rigs.simulate(tmp_path, sizes)
    many_rigs.test(tmp_path, sizes)
    assert (tmp_path / "results.jsonl").read_text() == written
    rows = many_rigs.read(tmp_path / "results.jsonl")
    # Two tests of one frame, by two networks, the shipped one and our method.
    assert len(rows) == 8
    assert {row["method"]: row["start_deg"] for row in rows} == {"1": 2.0, "2": 2.0, "shipped": 2.0, "ours": 2.0}
    assert table(rows).count("\n|---") == 2
