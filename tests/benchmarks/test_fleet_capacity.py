"""The simulated cluster of `python benchmarks/fleet.py capacity`."""

from __future__ import annotations

import numpy as np
import pytest
from fleet import _clusters


def test_one_worker_is_limited_by_its_work_and_many_by_the_link_to_the_logs() -> None:
    lines = _clusters(np.array([4.0]), [100.0], link_gbit=10.0, checks=2000)
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    per_hour = {int(row[0]): float(row[2].replace(",", "")) for row in rows}
    limit = {int(row[0]): row[4] for row in rows}
    # A log of 100 MB needs 0.08 s of a link of 10 Gbit/s, and a check 1 ms of the scheduler.
    assert per_hour[1] == pytest.approx(3600 / (4.0 + 0.08 + 0.001), rel=0.001)
    assert per_hour[10] == pytest.approx(10 * per_hour[1], rel=0.03)
    assert per_hour[1000] == pytest.approx(3600 / 0.08, rel=0.03)
    assert limit == {1: "workers", 10: "workers", 100: "link", 1000: "link"}
