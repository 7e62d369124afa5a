"""Raw sweeps of KITTI tell how the car moved, with nothing but the edges of both sensors."""

from __future__ import annotations

from pathlib import Path

import p2o

# Drives that the default weights were not trained on: the car stands in one and does 18 m/s in the other.
STANDING = ["0018/0000000046", "0018/0000000086", "0018/0000000106"]
FAST = ["0028/0000000071", "0028/0000000228", "0028/0000000284", "0028/0000000313"]


def test_a_standing_car_and_a_fast_one_are_told_apart_along_with_the_pose(kitti_raw: Path) -> None:
    data = f"kitti-raw:{kitti_raw}?right=false&depth=false"
    run = p2o.calibrate(
        data, frames=",".join(STANDING + FAST), joint=True, perturb="1deg 0.1m", options=["extractor.weights=kitti"]
    )
    speed = {motion.frame.partition("/")[2]: motion.speed_m_s for motion in run.result.motions}
    assert sorted(speed) == sorted(STANDING + FAST)
    assert min(speed[name] for name in FAST) > max(speed[name] for name in STANDING) + 8.0
    error = run.rows[0].error
    assert error is not None
    assert error.rotation_deg < 0.15
    assert error.translation_m < 0.06
