"""Real frames: how wrong a result says it may be, and how wrong it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import p2o

# Drives that the default weights were not trained on.
STANDING = tuple(f"0018/{number:010d}" for number in (46, 76, 96, 106, 133))
FAST = tuple(f"0028/{number:010d}" for number in (71, 228, 284, 303, 378))


def test_errors_are_within_the_predicted_bounds_and_joint_results_have_smaller_ones(kitti_raw: Path) -> None:
    data = f"kitti-raw:{kitti_raw}?right=false&depth=false"
    singles = p2o.calibrate(data, frames=",".join(STANDING + FAST), perturb="2deg 0.15m", seed=3)
    told = [(row.result.accuracy, row.error) for row in singles.rows if row.result.accuracy is not None]
    assert len(told) >= 9
    both = [(a, e) for a, e in told if e is not None]
    # 19 of 20 should be; 10 calibrations may have bad luck.
    assert sum(e.rotation_deg < a.rotation_deg_95 for a, e in both) >= 8
    assert sum(e.translation_m < a.translation_m_95 for a, e in both) >= 8
    bounds = {row.result.frames[0]: row.result.accuracy for row in singles.rows if row.result.accuracy is not None}
    single_error = np.median([e.translation_m for _, e in both])
    for frames in (STANDING, FAST):
        joint = p2o.calibrate(data, frames=",".join(frames), joint=True, perturb="2deg 0.15m", seed=3).rows[0]
        assert joint.result.accuracy is not None
        assert joint.error is not None
        # Those of the same frames: the speed of a drive is a common unknown.
        single_bound = np.median([bounds[name].translation_m for name in joint.result.frames if name in bounds])
        assert joint.result.accuracy.translation_m < single_bound
        assert joint.error.translation_m < min(single_error, joint.result.accuracy.translation_m_95)
