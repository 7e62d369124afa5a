"""Frames of a rig that stands still count as one view."""

from __future__ import annotations

import numpy as np
import pytest
from p2o.confidence.assessment import standing_still
from p2o.problems import distinct_views
from p2o.problems.distinct_views import view_count


def edges(frames: int, *, still: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places, sides and frames of 300 edges a frame, of which a share `still` lies where it lay in all others."""
    rng = np.random.default_rng(seed)
    kept, keeps = rng.uniform(-20, 20, (300, 3)), rng.random(300) < still
    xyz = [np.where(keeps[:, None], kept, rng.uniform(-20, 20, (300, 3))) for _ in range(frames)]
    side = np.tile(np.arange(4, dtype=np.int8), 75 * frames)
    return np.concatenate(xyz), side, np.repeat(np.arange(frames), 300)


@pytest.mark.parametrize(("frames", "still", "views"), [(7, 1.0, 1.0), (5, 0.0, 5.0), (4, 0.5, 4 * (0.5 + 0.5 / 4))])
def test_the_same_frame_again_is_one_view_and_half_of_it_moving_gives_views_between(
    frames: int, still: float, views: float
) -> None:
    assert view_count(*edges(frames, still=still)) == pytest.approx(views, rel=0.08)


def test_noise_makes_no_other_view_another_direction_does_and_most_frames_of_one_are_warned_of() -> None:
    xyz, side, frame = edges(2, still=1.0)
    noisy = xyz + np.random.default_rng(1).normal(0, 0.02, xyz.shape)
    assert view_count(noisy, side, frame) < 1.1
    assert view_count(xyz, np.where(frame == 0, side, (side + 1) % 4), frame) == pytest.approx(2.0, abs=0.1)
    assert standing_still(1.0, 1) == standing_still(3.0, 4) == ()
    (text,) = standing_still(2.61, 20)
    assert "20 frames" in text
    assert "2.6 different views" in text


@pytest.mark.parametrize("still", [0.0, 0.5, 1.0])
def test_some_of_very_many_edges_tell_the_same(monkeypatch: pytest.MonkeyPatch, still: float) -> None:
    of_all = view_count(*edges(20, still=still))
    monkeypatch.setattr(distinct_views, "_MOST_LOOKED_UP", 20_000)
    assert view_count(*edges(20, still=still)) == pytest.approx(of_all, rel=0.05)


@pytest.mark.parametrize("frames", [0, 1])
def test_one_frame_is_one_view_and_none_is_none(frames: int) -> None:
    assert view_count(*(part[: 300 * frames] for part in edges(1, still=0.0))) == frames
