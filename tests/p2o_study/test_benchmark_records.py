"""What a measuring command prints is recorded with its origin, and pages show it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from p2o.cli import main
from p2o_study.benchmark.record import read_record

PRINT = [sys.executable, "-c"]


def record(folder: Path, name: str, code: str) -> int:
    return main(["benchmark", "record", "--results", str(folder), name, *PRINT, code])


def docs(folder: Path, page: Path, *words: str) -> int:
    return main(["benchmark", "docs", str(page), "--results", str(folder), *words])


def test_a_page_shows_what_a_command_printed_with_command_and_date(tmp_path: Path) -> None:
    assert record(tmp_path, "memory", "print('peak  412 MiB')") == 0
    page = tmp_path / "page.md"
    page.write_text("Before\n\n<!-- record: memory -->\n<!-- /record -->\n\nAfter\n")
    assert docs(tmp_path, page, "--check") == 1
    assert docs(tmp_path, page) == 0
    text = page.read_text()
    stored = read_record(tmp_path, "memory")
    origin = f"Output of `{stored.command}`: {stored.finished[:10]}, "
    assert f"```text\npeak  412 MiB\n```\n\n{origin}" in text
    assert text.endswith("<!-- /record -->\n\nAfter\n")
    assert docs(tmp_path, page, "--check") == 0
    assert record(tmp_path, "memory", "print('peak  500 MiB')") == 0
    assert docs(tmp_path, page, "--check") == 1


def test_a_printed_table_is_a_table_of_the_page_also_after_a_line_of_text(tmp_path: Path) -> None:
    assert record(tmp_path, "rates", "print('| a | b |\\n|--|--|\\n| 1 | 2 |')") == 0
    assert read_record(tmp_path, "rates").markdown().startswith("| a | b |\n|--|--|\n| 1 | 2 |\n\nOutput of `")
    assert record(tmp_path, "rates", "print('one core\\n\\n| a | b |\\n|--|--|\\n| 1 | 2 |')") == 0
    assert "one core\n\n| a | b |\n|--|--|\n| 1 | 2 |\n\n" in read_record(tmp_path, "rates").markdown()
    assert record(tmp_path, "rates", "print('one core\\n| a | b |\\n|--|--|\\n| 1 | 2 |')") == 0
    assert "```text\none core\n" in read_record(tmp_path, "rates").markdown()


def test_a_mark_selects_tables_of_a_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert record(tmp_path, "rates", "print('one\\n\\n| a |\\n|--|\\n\\n| b |\\n|--|\\n\\n| c |\\n|--|')") == 0
    page = tmp_path / "page.md"
    page.write_text("<!-- record: rates; tables: 1, 3 -->\n<!-- /record -->\n")
    assert docs(tmp_path, page) == 0
    assert "-->\n| a |\n|--|\n\n| c |\n|--|\n\nOutput of `" in page.read_text()
    page.write_text("<!-- record: rates; tables: 4 -->\n<!-- /record -->\n")
    assert docs(tmp_path, page) == 2
    assert "record rates: a table is missing" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("raise SystemExit(3)", "the command failed; expected exit status 0; got 3"),
        ("pass", "the output is no record; expected 1 to 20000 characters on standard output; got 0"),
        ("print('x' * 30000)", "the output is no record"),
    ],
)
def test_a_command_that_fails_or_prints_nothing_is_no_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], code: str, message: str
) -> None:
    assert record(tmp_path, "memory", code) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "records").exists()


def test_a_missing_command_and_a_missing_record_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["benchmark", "record", "--results", str(tmp_path), "memory", "no-such-command"]) == 2
    assert "no-such-command: the command cannot be run" in capsys.readouterr().err
    page = tmp_path / "page.md"
    page.write_text("<!-- record: memory -->\n<!-- /record -->\n")
    assert docs(tmp_path, page) == 2
    assert "unknown record 'memory'" in capsys.readouterr().err


def test_an_edited_record_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert record(tmp_path, "memory", "print(1)") == 0
    path = tmp_path / "records" / "memory.json"
    path.write_text(path.read_text().replace('"output"', '"outputs"'))
    page = tmp_path / "page.md"
    page.write_text("<!-- record: memory -->\n<!-- /record -->\n")
    assert docs(tmp_path, page) == 2
    assert "memory.json" in capsys.readouterr().err
