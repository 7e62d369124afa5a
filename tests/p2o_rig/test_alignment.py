"""Sweeps of two LiDARs are aligned over several moments, with a covariance that its errors confirm."""

from __future__ import annotations

import sys
from functools import cache
from typing import Any

import numpy as np
import pytest
from p2o import Cloud, Float, InputError, se3
from p2o.errors import MethodUnavailable
from p2o_rig import alignment
from p2o_rig.alignment import align_sweeps
from p2o_rig.extrinsics import simultaneous
from p2o_sim.synthetic import SyntheticOptions, body_from_lidar, build

STREET: dict[str, Any] = {
    "place": "street",
    "width_px": 64,
    "height_px": 64,
    "right": False,
    "speed_m_s": 0.0,
    "seed": 3,
}
TOP: dict[str, Any] = {**STREET, "lidar": "hdl-32e"}
SIDE: dict[str, Any] = {**STREET, "lidar": "vlp-16", "lidar_at": (-0.8, 0.6, -0.3, 12.0, 0.0, 60.0)}
TRUTH = body_from_lidar(SyntheticOptions(**SIDE))
GUESS = se3.exp(np.array([0.01, -0.008, 0.01, 0.08, -0.08, 0.05])) @ TRUTH


@cache
def sweeps(moments: int = 4) -> list[tuple[Cloud, Cloud]]:
    first, second = (build(SyntheticOptions(**options, scenes=moments)) for options in (TOP, SIDE))
    return simultaneous(first, second, moments)


def in_sigmas(found: alignment.Alignment, truth: Float) -> float:
    """Return the squared Mahalanobis distance from the truth, six degrees of freedom."""
    error = se3.log(truth @ se3.inverse(found.first_from_second))
    return float(error @ np.linalg.solve(found.covariance, error))


def test_sweeps_of_several_moments_give_the_pose_within_its_predicted_error() -> None:
    pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    found = align_sweeps(sweeps(), GUESS)
    error = se3.inverse(TRUTH) @ found.first_from_second
    assert se3.angle_deg(error) < 0.15
    assert se3.distance_m(error) < 0.02
    assert in_sigmas(found, TRUTH) < 22.5, "exceeded once in 1,000 alignments"
    assert found.moments == 4
    assert 0.3 < found.overlap <= 1.0
    # An alignment and its inverse agree, although the roles of both sweeps differ.
    back = align_sweeps([pair[::-1] for pair in sweeps()], se3.inverse(GUESS))
    around = found.first_from_second @ back.first_from_second
    assert se3.angle_deg(around) < 0.1
    assert se3.distance_m(around) < 0.01


def test_a_moment_with_another_pose_is_an_outlier() -> None:
    pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    pairs = sweeps()
    slipped = se3.exp(np.array([0.0, 0.0, 0.02, 0.2, 0.0, 0.0]))
    wrong = (Cloud(se3.apply(slipped, pairs[0][0].xyz), ring=pairs[0][0].ring), pairs[0][1])
    found = align_sweeps([wrong, *pairs[1:]], GUESS)
    assert found.used == found.moments - 1
    assert se3.angle_deg(se3.inverse(TRUTH) @ found.first_from_second) < 0.15


def test_sweeps_without_a_common_view_and_too_few_moments_are_refused() -> None:
    pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    apart = [(first, Cloud(second.xyz + [500.0, 0.0, 0.0])) for first, second in sweeps()[:2]]
    with pytest.raises(InputError, match=r"too few sweeps overlap; .* got 0 of 2"):
        align_sweeps(apart, GUESS)
    with pytest.raises(InputError, match=r"too few sweeps overlap; .* got 2 of 2"):
        align_sweeps(sweeps()[:2], GUESS)


def test_alignments_that_scatter_are_refused() -> None:
    pytest.importorskip("small_gicp", reason='needs pip install ".[gicp]"')
    turned = []
    for number, (first, second) in enumerate(sweeps()):
        step = se3.exp(np.array([0.0, 0.0, 0.03 * (number - 1.5), 0.0, 0.3 * number, 0.0]))
        turned.append((Cloud(se3.apply(step, first.xyz), ring=first.ring), second))
    with pytest.raises(InputError, match="the alignments of the moments differ; expected a scatter of at most"):
        align_sweeps(turned, GUESS)


def test_without_small_gicp_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(MethodUnavailable, match=r"small_gicp, which is not installed; run: pip install .*\[gicp\]"):
        align_sweeps(sweeps(), GUESS)


def test_frames_of_one_name_are_simultaneous_and_sweeps_of_several_cameras_count_once() -> None:
    rig = build(SyntheticOptions(**{**TOP, "lidar": "vlp-16"}, scenes=2, cameras="front,left"))
    other = build(SyntheticOptions(**SIDE, scenes=2, cameras="front,left"))
    pairs = simultaneous(rig, other, 10)
    assert len(pairs) == 2
    np.testing.assert_array_equal(pairs[0][1].xyz, other[0].cloud.xyz)
    assert len(simultaneous(rig, other, 1)) == 1
    with pytest.raises(InputError, match="no frames of the two LiDARs have the same name"):
        simultaneous(rig, build(SyntheticOptions(**SIDE)), 10)


def test_raw_sweeps_are_compensated_for_a_known_velocity() -> None:
    moving: dict[str, Any] = {**SIDE, "speed_m_s": 8.0}
    raw, compensated = (build(SyntheticOptions(**moving, deskew=deskew)) for deskew in (False, True))
    [(first, second)] = simultaneous(raw, compensated, 10)
    np.testing.assert_array_equal(first.xyz, second.xyz)
