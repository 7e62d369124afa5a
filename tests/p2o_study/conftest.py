"""The bench that studies are tried on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from unittest.mock import ANY

import pytest
import threadpoolctl
from p2o_study import worker

from tests.p2o_study.benchmark_board import Board
from tests.p2o_study.source_edits import Edit, edited_sources
from tests.study_bench import Bench


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setenv("TINY_CALLS", str(tmp_path / "calls"))
    monkeypatch.delenv("P2O_PLUGINS", raising=False)
    # What another test has left in this process would hide calls.
    worker._features.values.clear()
    worker._stages.clear()
    worker._frames.values.clear()
    # Two threads in this process, whatever OMP_NUM_THREADS says: whoever computes rows has to go back to one.
    with threadpoolctl.threadpool_limits(2):
        yield Bench(tmp_path)


@pytest.fixture
def board(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Board:
    monkeypatch.setenv("P2O_CACHE", str(bench.root / "cache"))
    # The plugin of the tests counts as ours, so that suites run in this process, which is faster and sees edits.
    monkeypatch.setattr("p2o_study.ablate.DISTRIBUTION", ANY)
    return Board(bench.root)


@pytest.fixture
def edit(monkeypatch: pytest.MonkeyPatch) -> Iterator[Edit]:
    with edited_sources(monkeypatch) as edit:
        yield edit
