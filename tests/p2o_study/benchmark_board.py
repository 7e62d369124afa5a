"""A suite of the tests' own plugin with a folder of results, measured by the command."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from p2o.cli import main
from p2o_study.benchmark.results import Results
from p2o_study.benchmark.row import Row

from tests.study_bench import HEAD, PLUGIN, TRUSTED, Bench

QUICK_ROW = '[[row]]\nlabel = "quick"\ncalibrator = "quick"\nwitness = "none"\n'
STUDY = HEAD + QUICK_ROW + '[[row]]\nlabel = "nearest"\nmatcher = "nearest"\nwitness = "none"\n' + TRUSTED
SUITE = 'name = "tiny"\nquestion = "Which is better?"\nstudy = "study.toml"\n'


class Board(Bench):
    """A bench with a suite and a folder of results."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.results = Results(root / "results")
        self.write()

    def write(self, study: str = STUDY, suite: str = SUITE) -> None:
        (self.root / "study.toml").write_text(study)
        (self.root / "tiny.toml").write_text(suite)

    def command(self, word: str, *words: str) -> int:
        """Run a command that takes the suite as its argument, or as an option."""
        suite = str(self.root / "tiny.toml")
        named = ["--suite", suite] if word in ("score", "verify") else [suite]
        folders = [] if word in ("starts", "verify") else ["--results", str(self.results.folder)]
        folders += ["--store", str(self.root / "store")] if word == "run" else []
        quiet = [] if word == "table" else ["--quiet"]
        plugin = ["--plugin", str(PLUGIN)]
        return main(["benchmark", word, *words, *named, *plugin, *folders, *quiet])

    def measured(self, *words: str) -> list[Row]:
        """Run the suite, and return the rows that are new."""
        before = {known.line for known in self.results.rows("tiny")}
        assert self.command("run", *words) == 0
        return [new for new in self.results.rows("tiny") if new.line not in before]

    def outdated(self, capsys: pytest.CaptureFixture[str]) -> list[tuple[str, str]]:
        """Return label and state of the calibrations without a fresh row."""
        capsys.readouterr()
        code = self.command("status", "--json")
        [state] = json.loads(capsys.readouterr().out)["suites"]
        assert code == (1 if state["outdated"] else 0)
        return [(entry["row"], entry["state"]) for entry in state["outdated"]]
