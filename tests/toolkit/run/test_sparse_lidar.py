"""A simulated VLP-16, whose rings are 2 deg apart, is calibrated to the exact truth by its intervals."""

from __future__ import annotations

import p2o
import pytest
from p2o.results.result import DIRECTED, INTERVALS


@pytest.mark.parametrize(
    ("lidar", "judge"), [("vlp-16", INTERVALS), pytest.param("os1-64", DIRECTED, marks=pytest.mark.system)]
)
def test_a_simulated_sweep_is_calibrated_by_the_measure_of_its_rings(lidar: str, judge: str) -> None:
    done = p2o.calibrate(
        f"synthetic:?scenes=3&place=street&right=false&seed=3&lidar={lidar}&width_px=828&height_px=250",
        joint=True,
        perturb="2deg 0.15m",
        extractor="depth/rings",
    )
    error = done.rows[0].error
    assert error.rotation_deg < 0.2
    assert error.translation_m < 0.04
    assert done.result.judged.judge == judge
