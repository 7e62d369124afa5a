"""Sweeps that were motion-compensated elsewhere and come without the velocity."""

from __future__ import annotations

from dataclasses import replace

import pytest
from p2o.host.registry import Registry
from p2o.results.check import CheckStatus
from p2o.run.check import check
from p2o.run.recipe import open_dataset


@pytest.mark.system
def test_a_true_pose_holds_although_the_velocity_of_compensated_sweeps_is_unknown() -> None:
    data = open_dataset("synthetic:?scenes=4&seed=5&place=street&speed_m_s=8", Registry.load(), {})
    frames = [data[index] for index in range(4)]
    assert all(frame.cloud.twist is not None and frame.cloud.twist[3] > 7 for frame in frames)
    bare = [replace(f, cloud=replace(f.cloud, twist=None, time_s=None, column=None), sweep=None) for f in frames]
    outcome = check(bare, "truth")
    assert outcome.holding is CheckStatus.HOLDS
    assert all(abs(axis.off) < 0.02 for axis in outcome.axes if axis.unit == "m")
