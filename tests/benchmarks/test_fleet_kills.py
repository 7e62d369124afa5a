"""A few kills of runs over a small fleet; `python benchmarks/fleet.py kills --kills 100` is the long form."""

from __future__ import annotations

import importlib.util
import os

import pytest
from fleet_kills import kills, kills_of_cluster


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that are forked")
def test_a_run_that_is_killed_loses_no_finished_check_and_counts_none_twice() -> None:
    lines, failed = kills(4, 3, drives=10)
    assert not failed, lines


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that are forked")
@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason='needs pip install ".[dask]"')
def test_a_cluster_whose_scheduler_workers_and_runs_are_killed_loses_no_finished_check() -> None:
    lines, failed = kills_of_cluster(6, 2, drives=20)
    assert not failed, lines
