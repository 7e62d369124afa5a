"""The simulated scheduler of `benchmarks/scaling.py`, where its outcome is known."""

from __future__ import annotations

import pytest
from scaling import simulated


def test_one_worker_waits_for_the_scheduler_and_the_scheduler_for_it() -> None:
    outcome = simulated(1000, 1, [0.9], 0.1)
    assert outcome.rows_a_minute == pytest.approx(60.0, rel=2e-3)
    assert outcome.workers_busy == pytest.approx(0.9, abs=2e-3)
    assert outcome.scheduler_busy == pytest.approx(0.1, abs=2e-3)


def test_rows_grow_with_workers_until_the_scheduler_is_always_busy() -> None:
    rates = [simulated(20_000, workers, [0.9, 1.1], 0.01).rows_a_minute for workers in (1, 10, 50, 1000, 4000)]
    assert rates[1] == pytest.approx(10 * rates[0], rel=0.05)
    assert rates[2] == pytest.approx(50 * rates[0], rel=0.05)
    assert rates[3] == pytest.approx(60 / 0.01, rel=0.02)
    assert rates[4] == pytest.approx(rates[3], rel=0.02)
