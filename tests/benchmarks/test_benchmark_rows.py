"""The synthetic rows of `benchmarks/benchmark_rows.py` are valid measurements of their suite."""

from __future__ import annotations

from pathlib import Path

import pytest
from benchmark_rows import write
from p2o.cli import main


def test_synthetic_rows_are_valid_and_fresh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path, 200)
    places = ["--results", str(tmp_path / "results"), "--suites", str(tmp_path / "suites")]
    assert main(["benchmark", "status", "many", *places]) == 0
    assert "many: 200 fresh" in capsys.readouterr().out
    assert main(["benchmark", "page", *places, "--out", str(tmp_path / "page"), "--quiet"]) == 0
    assert "20 rows, 200 runs" in capsys.readouterr().out
