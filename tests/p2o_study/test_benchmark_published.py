"""Pages show the figures of publications that a suite lists."""

from __future__ import annotations

import pytest
from p2o.cli import main

from tests.p2o_study.benchmark_board import SUITE, Board
from tests.study_bench import PLUGIN

LISTED = """
[[published]]
label = "Net | 1"
section = "far"
training = "KITTI"
start = "20 deg, 1.5 m"
frames = "4541 single"
figure = "median"
values = { rotation_deg = 0.08, translation_m = 0.019 }
source = "arXiv 2402.00129"

[[published]]
label = "other"
section = "near"
values = { rotation_deg = 2 }
source = "a paper"
note = "of a third party"
"""
HEAD = "| method | training | initial error | frames | figure | rotation [deg] | translation [cm] | source |\n"


def docs(board: Board, mark: str) -> tuple[int, str]:
    page = board.root / "page.md"
    page.write_text(f"<!-- published: {board.root / 'tiny.toml'}{mark} -->\nold\n<!-- /published -->\n")
    status = main(["benchmark", "docs", str(page), "--plugin", str(PLUGIN)])
    return status, page.read_text()


def test_a_mark_shows_the_figures_of_a_section_in_degrees_and_centimetres(board: Board) -> None:
    board.write(suite=SUITE + LISTED)
    status, text = docs(board, ", far")
    assert status == 0
    row = "| Net \\| 1 | KITTI | 20 deg, 1.5 m | 4541 single | median | 0.08 | 1.9 | arXiv 2402.00129 |\n"
    assert text.splitlines(keepends=True)[1:4] == [HEAD, "|:--|:--|:--|:--|:--|--:|--:|:--|\n", row]
    assert "other" not in text
    _, text = docs(board, "")
    assert "| other |  |  |  |  | 2 |  | a paper; of a third party |\n" in text


@pytest.mark.parametrize(
    ("mark", "message"), [(", middle", "unknown section 'middle'"), ("; columns: brief", "a marked part is not valid")]
)
def test_a_mark_that_is_wrong_is_refused_and_the_page_unchanged(
    board: Board, mark: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    board.write(suite=SUITE + LISTED)
    status, text = docs(board, mark)
    assert status == 2
    assert message in capsys.readouterr().err
    assert "\nold\n" in text
