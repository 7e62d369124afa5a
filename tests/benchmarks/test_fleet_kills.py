"""Four kills of runs over a small fleet; `python benchmarks/fleet.py kills --kills 100` is the long form."""

from __future__ import annotations

import os

import pytest
from fleet_kills import kills


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that are forked")
def test_a_run_that_is_killed_loses_no_finished_check_and_counts_none_twice() -> None:
    lines, failed = kills(4, 3, drives=10)
    assert not failed, lines
