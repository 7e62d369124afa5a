"""The page of the benchmark: top groups, names, and what is written."""

from __future__ import annotations

from pathlib import Path

import pytest
from p2o.cli import main
from p2o_study.benchmark import page as pages
from p2o_study.curves import common_name

from tests.p2o_study.benchmark_pages import command, rows_of, written
from tests.page_description import description, table, texts

ROOT = Path(__file__).parents[2]


def test_the_common_name_of_a_method_is_that_of_its_labels_in_whole_words() -> None:
    assert common_name(["ours from 1deg 0.08m", "ours from 1deg 0.3m", "ours from 20deg 1.5m"]) == "ours"
    assert common_name(["edges, search", "edges, search, 5 frames"]) == "edges, search"
    assert common_name(["alone, 2 frames"]) == "alone, 2 frames"
    assert common_name(["one", "other"]) == "one"


def test_an_earlier_page_leaves_no_runs_behind(tmp_path: Path) -> None:
    written(tmp_path, rows_of("quick", [0.1]))
    (tmp_path / "page/data/tiny-7.js").write_text("old")
    assert main(command(tmp_path)) == 0
    assert [path.name for path in (tmp_path / "page/data").iterdir()] == ["tiny-0.js"]


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "page").write_text("a file")
    with pytest.raises(AssertionError):
        written(tmp_path, rows_of("quick", [0.1]))
    assert "cannot write the page" in capsys.readouterr().err


def test_rows_beyond_the_size_of_the_page_are_left_out_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pages, "MAX_ROWS", 4)
    page = written(tmp_path, [row for number in range(9) for row in rows_of(f"method {number}", [0.1], external=True)])
    out = capsys.readouterr().out
    assert "rows left out" in out
    data = description(page)
    assert len(table(data, "rows")["rows"]) == 4
    assert any("the first 4 rows; 5 further ones" in text for text in texts(data))
