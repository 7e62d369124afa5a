"""The figures of publications, each against its own closed form."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import se3
from p2o.geometry.pose_error import half_sample_mode, pose_metrics
from scipy.spatial.transform import Rotation

TRUTH = se3.make(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), [0.1, -0.2, -0.3])


def _estimates(euler_deg: list[list[float]], shifts: list[list[float]]) -> np.ndarray:
    turns = Rotation.from_euler("xyz", euler_deg, degrees=True).as_matrix()
    return np.stack(
        [se3.make(r @ TRUTH[:3, :3], TRUTH[:3, 3] + s) for r, s in zip(turns, np.array(shifts), strict=True)]
    )


def test_each_kind_of_rotation_error_is_a_figure_of_its_own() -> None:
    estimates = _estimates([[3, 0, 0], [0, -4, 0]], [[0.3, 0, 0], [0, 0.4, 0]])
    found = pose_metrics(estimates, np.stack([TRUTH, TRUTH]), {"hit": (3.5, 0.35), "all": (5, 1)})
    assert found["rotation_deg_mean"] == pytest.approx(3.5)
    assert found["rotation_deg_rmse"] == pytest.approx(np.sqrt(12.5))
    assert found["euler_deg_mean"] == pytest.approx(7 / 6)
    assert found["euler_deg_norm"] == pytest.approx(3.5)
    assert [found[f"euler_deg_{a}"] for a in "xyz"] == pytest.approx([1.5, 2, 0])
    assert found["shift_m_mean"] == pytest.approx(0.7 / 6)
    assert found["translation_m_median"] == pytest.approx(0.35)
    assert (found["hit"], found["all"]) == (0.5, 1)
    assert pose_metrics(estimates[:0], estimates[:0]) == {}


def test_one_extrinsic_of_many_frames_is_better_than_the_frames_and_the_mode_is_where_most_are() -> None:
    rng = np.random.default_rng(0)
    estimates = _estimates(rng.normal(0, 1, (400, 3)).tolist(), rng.normal(0, 0.1, (400, 3)).tolist())
    found = pose_metrics(estimates, np.repeat(TRUTH[None], 400, axis=0))
    # A median of n has the deviation 1.25 / sqrt(n): the norm of three is far below five of them.
    assert found["median_rotation_deg"] < 5 * 1.25 / 20
    assert found["median_translation_m"] < 5 * 0.125 / 20
    assert found["median_rotation_deg"] < 0.2 * found["rotation_deg_mean"]
    rng = np.random.default_rng(1)
    values = np.concatenate([rng.normal(2.0, 0.01, 60), rng.uniform(-50, 50, 40)])
    assert half_sample_mode(values) == pytest.approx(2.0, abs=0.05)
    assert half_sample_mode([1.0]) == 1.0
