"""Studies of the tests' own plugin: in this process or by the command, with a count of the calls of its methods."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from p2o.cache import FeatureCache
from p2o_study.ablate import Ablation, ablate
from p2o_study.parallel import Workers
from p2o_study.row import Row, rounded_pose
from p2o_study.rows import Rows
from p2o_study.study import parse_study
from p2o_study.worker import Plugins

PLUGIN = Path(__file__).with_name("study_plugin.py")
HEAD = """name = "tiny"
title = "Tiny"
perturb = "1deg 0.05m"
seeds = 2
[[dataset]]
name = "tiny"
data = "tiny:"
options = { frames = 3 }
[defaults]
extractor = "tiny/tiny"
init = "given"
witness = "none"
"""
# The intrinsics are not what these tests are about, and checking them takes most of a calibration.
TRUSTED = 'options.pipeline.camera = "trust"\n'
STAGED = HEAD + TRUSTED + '[[product]]\nmatcher = ["ogm", "nearest"]\nsolver = ["lm", "scipy"]\n'
QUICK = HEAD + '[[row]]\nlabel = "quick"\ncalibrator = "quick"\n'


class Bench:
    """A folder with a store, a cache and a count of calls."""

    def __init__(self, root: Path) -> None:
        self.root, self.calls_file = root, root / "calls"
        self.plugins = Plugins(files=(str(PLUGIN),))

    def run(self, text: str, out: str = "out", jobs: int = 1, **words: object) -> Ablation:
        cache = FeatureCache(self.root / "cache")
        return ablate(
            parse_study(text), self.root / out, plugins=self.plugins, workers=Workers(jobs), cache=cache, **words
        )

    def calls(self) -> Counter[str]:
        """Return how often each was called since the last time: image, cloud, quick, frame."""
        lines = self.calls_file.read_text().splitlines() if self.calls_file.exists() else []
        self.calls_file.unlink(missing_ok=True)
        return Counter(line.split()[0] for line in lines)

    def words(self, text: str, *words: str, out: str = "out") -> list[str]:
        """Return the words of the command that runs a study, whose file is written."""
        (self.root / "study.toml").write_text(text)
        file, folder = str(self.root / "study.toml"), str(self.root / out)
        return ["ablate", file, "--plugin", str(PLUGIN), "--out", folder, *words]

    def cli(self, text: str, *words: str, **options: Any) -> subprocess.CompletedProcess[str]:
        """Run the command in a process of its own."""
        environ = {**os.environ, "P2O_CACHE": str(self.root / "cache")}
        command = [sys.executable, "-m", "p2o", *self.words(text, *words)]
        return subprocess.run(command, capture_output=True, text=True, check=False, env=environ, **options)

    def started(
        self, text: str, rows: int, *words: str, python: Sequence[str] = ("-m", "p2o")
    ) -> subprocess.Popen[str]:
        """Start the command in a session of its own, and return when this number of rows is there."""
        process = subprocess.Popen(
            [sys.executable, *python, *self.words(text, "--quiet", *words)],
            env={**os.environ, "P2O_CACHE": str(self.root / "cache")},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        until = time.monotonic() + 120
        while process.poll() is None and time.monotonic() < until and len(self.keys()) < rows:
            time.sleep(0.05)
        assert process.poll() is None, process.communicate()[1]
        return process

    def keys(self) -> list[str]:
        """Return the keys of the rows, to which another process may write."""
        return [row.key for row in Rows(self.root / "out").each("tiny")]


def bits(rows: Sequence[Row]) -> list[tuple[object, ...]]:
    """Return all that a row states, except for the time it took."""
    return [
        (r.key, r.row, r.seed, r.frames, r.status, r.reason, repr(r.rounds), r.matches)
        + (json.dumps(r.method.options, sort_keys=True),)
        + tuple(None if p is None else tuple(rounded_pose(p)) for p in (r.estimate, r.case.start, r.case.truth))
        for r in rows
    ]
