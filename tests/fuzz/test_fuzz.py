"""A hundred mutated inputs, always the same ones; `make fuzz` runs many more."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
CASES = 100


def test_every_promise_is_kept_on_a_hundred_mutated_inputs(tmp_path: Path) -> None:
    # In a process of its own: cases are forks of it, which must not hold what other tests have loaded.
    words = ["--cases", str(CASES), "--jobs", "1", "--out", str(tmp_path / "fuzz")]
    done = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", *words], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
