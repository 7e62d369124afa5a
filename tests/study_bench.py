"""Studies of the tests' own plugin: in this process or by the command, with a count of the calls of its methods."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from p2o.cache import FeatureCache
from p2o_study.ablate import Ablation, ablate
from p2o_study.parallel import Workers
from p2o_study.row import Row, rounded_pose
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
"""
# The intrinsics are not what these tests are about, and checking them takes most of a calibration.
TRUSTED = 'options.pipeline.camera = "trust"\n'
STAGED = HEAD + TRUSTED + '[[product]]\nmatcher = ["ogm", "nearest"]\nsolver = ["lm", "scipy"]\n'
QUICK = HEAD + '[[row]]\nlabel = "quick"\ncalibrator = "quick"\nwitness = "none"\n'


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

    def cli(self, text: str, *words: str, out: str = "out") -> subprocess.CompletedProcess[str]:
        file = self.root / "study.toml"
        file.write_text(text)
        command = [
            sys.executable,
            "-m",
            "p2o",
            "ablate",
            str(file),
            "--plugin",
            str(PLUGIN),
            "--out",
            str(self.root / out),
        ]
        environ = {**os.environ, "P2O_CACHE": str(self.root)}
        return subprocess.run([*command, *words], capture_output=True, text=True, check=False, env=environ)


def bits(rows: Sequence[Row]) -> list[tuple[object, ...]]:
    """Return all that a row states, except for the time it took."""
    return [
        (r.key, r.row, r.seed, r.frames, r.status, r.reason, repr(r.rounds), r.matches)
        + (json.dumps(r.method.options, sort_keys=True),)
        + tuple(None if pose is None else tuple(rounded_pose(pose)) for pose in (r.estimate, r.start, r.truth))
        for r in rows
    ]
