"""Tables are rendered from rows alone, and pages of the docs equal the rows."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from p2o.cli import main
from p2o.errors import UnknownNameError
from p2o_study.benchmark.marks import rendered
from p2o_study.benchmark.suite import find_suite
from p2o_study.benchmark.tables import Choice, SuiteTables, rows_text
from p2o_study.worker import Plugins

from tests.p2o_study.benchmark_board import QUICK_ROW, SUITE, Board
from tests.study_bench import HEAD, PLUGIN

ROOT = Path(__file__).parents[2]


def cells(text: str, label: str) -> dict[str, str]:
    """Return the cells of a row of a Markdown table by their heading; of equal headings the first."""
    lines = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("|")]
    [row] = [line for line in lines if line[0] == label]
    return dict(zip(reversed(lines[0]), reversed(row), strict=True))


def table(board: Board, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    capsys.readouterr()
    assert board.command("table", *words) == 0
    return capsys.readouterr().out


def test_a_table_needs_no_data_and_contains_what_the_rows_do(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    board.write(study=HEAD.replace("frames = 3", "frames = 6") + QUICK_ROW)
    rows = board.measured()
    board.write(study=(board.root / "study.toml").read_text().replace("tiny:", "tiny:/nowhere"))
    row = cells(table(board, capsys), "quick")
    mean = np.mean([known.error.rotation_deg for known in rows if known.error is not None])
    assert (row["runs"], row["frames"], row["groups"]) == ("30", "6", "6")
    assert row["rotation mean [deg]"].startswith(f"{mean:.3f} [")
    assert row["rotation median [deg]"] == "0.500"
    assert "not solved" not in row
    board.write(study=(board.root / "study.toml").read_text(), suite=SUITE + 'groups = "drive"\n')
    row = cells(table(board, capsys), "quick")
    assert (row["runs"], row["groups"]) == ("30", "1")
    assert "[" not in row["rotation mean [deg]"], "intervals are over groups, not over calibrations"


def test_refused_calibrations_count_with_their_initial_guess_and_are_apart_in_solved_only(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    board.write(study=HEAD + QUICK_ROW + 'options.calibrator.status = "not-observable"\n')
    board.measured()
    row = cells(table(board, capsys), "quick")
    assert (row["not solved"], row["solved only"]) == ("15", "-")
    assert row["rotation mean [deg]"] == "1.000"


def test_rows_that_are_not_measured_are_counted(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    assert "Rows not measured: 2." in table(board, capsys)


def test_rows_of_seeds_and_initial_errors_that_the_suite_lacks_do_not_count(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    board.write(study=HEAD + QUICK_ROW)
    board.measured()
    assert cells(table(board, capsys), "quick")["runs"] == "15"
    fewer = SUITE.replace("seeds = 5", "seeds = 2")
    board.write(study=HEAD + QUICK_ROW, suite=fewer)
    assert cells(table(board, capsys), "quick")["runs"] == "6"
    board.write(study=HEAD + QUICK_ROW + 'perturb = "3deg 0.3m"\n', suite=fewer)
    assert "Rows not measured: 1." in table(board, capsys)


def opened(board: Board) -> SuiteTables:
    registry = Plugins.of((), (str(PLUGIN),)).registry()
    return SuiteTables.read(find_suite(str(board.root / "tiny.toml"), registry), board.results)


def test_each_data_set_has_rows_of_its_own_and_a_page_chooses_some(board: Board) -> None:
    board.write(study=HEAD + '[[dataset]]\nname = "other"\ndata = "tiny:?frames=2"\n' + QUICK_ROW)
    board.measured()
    tables = opened(board)
    lines = [line for line in tables.markdown(Choice()).splitlines() if line.startswith("| ")]
    assert [line.split(" | ")[:3] for line in lines[1:]] == [
        ["| quick @ tiny", "15", "3"],
        ["| quick @ other", "10", "2"],
    ]
    [only] = [line for line in tables.markdown(Choice(data=("other",))).splitlines() if "quick" in line]
    assert only.startswith("| quick | 10 | 2 |")
    assert "predicted 67 %" not in tables.markdown(Choice(columns=("brief",)))
    with pytest.raises(UnknownNameError, match="othr"):
        tables.markdown(Choice(data=("othr",)))


def test_labels_with_commas_are_chosen_by_their_whole_words(board: Board) -> None:
    board.write(study=HEAD + QUICK_ROW.replace('"quick"', '"quick, 3 frames"', 1) + QUICK_ROW)
    board.measured()
    page = "<!-- rows: tiny; methods: quick, 3 frames -->\n<!-- /rows -->\n"
    tables = opened(board)
    writers = {"rows": rows_text(lambda suite: tables)}
    first = {line.split(" | ")[0] for line in rendered(page, "page.md", writers).splitlines()}
    assert "| quick, 3 frames" in first
    assert "| quick" not in first
    text = HEAD + QUICK_ROW.replace("witness", 'section = "one"\nwitness')
    text += QUICK_ROW.replace('"quick"', '"other"', 1).replace("witness", 'section = "two"\nwitness')
    board.write(study=text)
    apart = opened(board)
    assert apart.markdown(Choice()).count("**") == 4
    assert apart.markdown(Choice(sections="together")).count("**") == 2
    both = rendered(page.replace("frames", "frames, quick"), "page.md", writers)
    assert "| quick |" in both


def test_a_pooled_line_has_the_rows_of_all_data_sets_and_counts_those_of_development(board: Board) -> None:
    """Three frames of one data set and two of another; the mean is over all 25 runs."""
    second = '[[dataset]]\nname = "other"\ndata = "tiny:?frames=2"\ndevelopment = true\n'
    board.write(study=HEAD + second + QUICK_ROW)
    rows = board.measured()
    mean = np.mean([row.error.rotation_deg for row in rows if row.error is not None])
    below = opened(board).markdown(Choice(pooled="below"))
    line = cells(below, "quick @ 2 data sets, 1 of them †")
    assert (line["runs"], line["frames"], line["groups"]) == ("25", "5", "5")
    assert line["rotation mean [deg]"].startswith(f"{mean:.3f} [")
    assert cells(below, "quick @ other †")["runs"] == "10"
    only = opened(board).markdown(Choice(pooled="only"))
    assert [text.split(" | ")[0] for text in only.splitlines() if text.startswith("| q")] == [
        "| quick @ 2 data sets, 1 of them †"
    ]


def test_columns_are_chosen_by_name_in_their_order(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    board.write(study=HEAD + QUICK_ROW)
    board.measured()
    text = table(board, capsys, "--columns", "rotation per axis mean, runs, not moved, translation mean [cm]")
    head = next(line for line in text.splitlines() if line.startswith("| row"))
    assert head == "| row | rotation per axis mean [deg] | runs | not moved | translation mean [cm] |"
    assert board.command("table", "--columns", "rotation meen") == 2
    assert "did you mean rotation mean" in capsys.readouterr().err


PUBLISHED_ROW = """
[[published]]
label = "theirs"
beside = "quick"
source = "A Journal"
values = { rotation_deg = 0.7, translation_m = 0.05 }
[[published]]
label = "of another row"
beside = "nearest"
source = "A Journal"
values = { rotation_deg = 0.1 }
"""


def test_published_figures_are_beside_the_row_that_they_compare_with(board: Board) -> None:
    """A suite has the published figures of its study as far as it has their rows; both readings are of one figure."""
    own = '[[row]]\nlabel = "quick"\ncalibrator = "quick"\nwitness = "none"\n'
    nearest = '[[row]]\nlabel = "nearest"\nmatcher = "nearest"\nwitness = "none"\n'
    board.write(study=HEAD + own + nearest + PUBLISHED_ROW, suite=SUITE + own)
    board.measured()
    text = opened(board).markdown(Choice(columns=("rotation mean", "rotation per axis mean", "roll mean")))
    assert "*theirs (published: A Journal)* | *0.700* | *0.700* | - |" in text
    assert "of another row" not in text


def frames_suite(board: Board) -> None:
    rows = [
        QUICK_ROW.replace('"quick"', f'"quick, {size} frame{"s" * (size > 1)}"', 1)
        + f'section = "{size} frames"\n'
        + (f"joint = {size}\n" if size > 1 else "")
        for size in (1, 2, 4)
    ]
    board.write(study=HEAD.replace("frames = 3", "frames = 4") + "".join(rows))


def test_errors_over_the_number_of_frames_are_by_method_with_the_number_that_a_target_needs(
    board: Board, tmp_path: Path
) -> None:
    """The test's method halves any initial error: 1 deg and 5 cm become 0.5 deg and 2.5 cm whatever the frames."""
    frames_suite(board)
    board.measured()
    tables = opened(board)
    text = tables.markdown(Choice(over="frames", target="0.51deg 0.03m", reference="0.1deg 0.01m"))
    first, *_ = text.splitlines()
    assert first.endswith("with 1 frame quick; with 2 frames quick; with 4 frames quick.")
    line = cells(text, "quick").values()
    assert list(line)[::-1][1:] == [*["0.500 deg, 2.5 cm"] * 3, "1"]
    assert "| not reached with 4 |" in tables.markdown(Choice(over="frames", target="0.49deg 0.03m"))
    assert board.command("table", "--figures", str(tmp_path / "figures")) == 0
    names = sorted(path.name for path in (tmp_path / "figures").iterdir())
    assert names == [f"tiny-over-frames.{form}" for form in ("pdf", "png", "svg")]


def test_lines_of_a_foreign_method_are_apart_as_those_of_every_method(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    """One section with single frames, pairs and all frames, from two initial errors: five kinds of calibrations."""
    kinds = (("a", ""), ("b", "joint = 2\n"), ("c", "joint = true\n"), ("d", 'perturb = "2deg 0.1m"\n'))
    rows = [QUICK_ROW.replace('"quick"', f'"{name}"', 1) + f'section = "one"\n{words}' for name, words in kinds]
    rows.append(QUICK_ROW.replace('"quick"', '"e"', 1) + 'section = "two"\n')
    board.write(study=HEAD.replace("frames = 3", "frames = 4") + "".join(rows))
    board.measured()
    starts = board.root / "starts.csv"
    assert board.command("starts", "--out", str(starts)) == 0
    assert board.command("score", str(starts), "--name", "foreign | own") == 0
    text = table(board, capsys).replace(r"foreign \| own", "foreign")
    runs = {line.split(" | ")[0][2:]: line.split(" | ") for line in text.splitlines() if line.startswith("| foreign")}
    assert {name: words[2 if " from " in name else 1] for name, words in runs.items()} == {
        "foreign, single frames from 1deg 0.05m": "20",
        "foreign, 2 frames from 1deg 0.05m": "10",
        "foreign, jointly from 1deg 0.05m": "5",
        "foreign, single frames from 2deg 0.1m": "20",
        "foreign": "20",
    }


def test_marked_parts_are_replaced_and_nothing_else(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    board.measured()
    suites = board.root / "suites"
    suites.mkdir()
    shutil.copy(board.root / "tiny.toml", suites)
    shutil.copy(board.root / "study.toml", suites)
    page = board.root / "page.md"
    page.write_text("# Before\n\n<!-- rows: tiny -->\nold\n<!-- /rows -->\n\nAfter `<b>`\n")
    words = (str(page), "--suites", str(suites))
    plugin = ["--plugin", str(ROOT / "tests/study_plugin.py"), "--results", str(board.results.folder)]
    assert main(["benchmark", "docs", *words, "--check", *plugin]) == 1
    assert "old" in page.read_text()
    assert main(["benchmark", "docs", *words, *plugin]) == 0
    text = page.read_text()
    assert text.startswith("# Before\n\n<!-- rows: tiny -->\n**all rows")
    assert text.endswith("<!-- /rows -->\n\nAfter `<b>`\n")
    assert "old" not in text
    assert main(["benchmark", "docs", *words, "--check", *plugin]) == 0
    wrong = ("sensor: a", "section: a", "sections: some", "pooled: above")
    parts = [f"<!-- rows: tiny; {words} -->\n<!-- /rows -->\n" for words in wrong]
    for part in ("<!-- rows: tiny -->\nnever closed\n", *parts):
        page.write_text(f"\n\n{part}")
        assert main(["benchmark", "docs", *words, *plugin]) == 2
        assert "page.md:3: a marked part is not valid" in capsys.readouterr().err


def test_the_marked_parts_of_readme_and_docs_equal_the_committed_rows(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    assert main(["benchmark", "docs", "--check"]) == 0, capsys.readouterr().out + " (p2o benchmark docs)"
    pages = [page for page in ROOT.glob("docs/**/*.md") if re.search("<!-- rows: smoke", page.read_text("utf-8"))]
    assert pages
