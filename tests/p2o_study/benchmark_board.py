"""A suite of the tests' own plugin with a folder of results, measured by the command."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from p2o.cli import main
from p2o_study.row import Row
from p2o_study.rows import Rows

from tests.study_bench import HEAD, PLUGIN, TRUSTED, Bench

QUICK_ROW = '[[row]]\nlabel = "quick"\ncalibrator = "quick"\nwitness = "none"\n'
STUDY = HEAD + QUICK_ROW + '[[row]]\nlabel = "nearest"\nmatcher = "nearest"\nwitness = "none"\n' + TRUSTED
SUITE = 'name = "tiny"\nquestion = "Which is better?"\nstudy = "study.toml"\nseeds = 5\n'


class Board(Bench):
    """A bench with a suite and a folder of results."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.results = Rows(root / "results")
        self.write()

    def write(self, study: str = STUDY, suite: str = SUITE) -> None:
        (self.root / "study.toml").write_text(study)
        (self.root / "tiny.toml").write_text(suite)

    def command(self, word: str, *words: str) -> int:
        """Run a command that takes the suite as its argument, or as an option."""
        suite = str(self.root / "tiny.toml")
        named = ["--suite", suite] if word == "score" else [suite]
        folders = [] if word == "starts" else ["--results", str(self.results.folder)]
        quiet = [] if word == "table" else ["--quiet"]
        plugin = ["--plugin", str(PLUGIN)]
        return main(["benchmark", word, *words, *named, *plugin, *folders, *quiet])

    def measured(self, *words: str) -> list[Row]:
        """Run the suite, and return the rows that are new."""
        before = len(self.rows())
        assert self.command("run", *words) == 0
        return self.rows()[before:]

    def rows(self, suite: str = "tiny") -> list[Row]:
        """Return the rows of the suite in the order of the file."""
        return list(Rows(self.results.folder).each(suite))

    def outdated(self, capsys: pytest.CaptureFixture[str]) -> list[tuple[str, str]]:
        """Return label and state of the calibrations without a fresh row."""
        capsys.readouterr()
        code = self.command("status", "--json")
        [state] = json.loads(capsys.readouterr().out)["suites"]
        assert code == (1 if state["outdated"] else 0)
        return [(entry["row"], entry["state"]) for entry in state["outdated"]]
