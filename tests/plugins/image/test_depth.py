"""The oracle `depth` puts directed edges where a known depth map has its silhouettes."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, Image, ImageEdges, InputError, Side
from p2o_plugins.image.depth import METHOD, DepthOptions

CAMERA = Camera.pinhole(200, 200, 49.5, 39.5, 100, 80)


def image(depth_m: np.ndarray | None, masked: np.ndarray | None = None, level: int = 0) -> Image:
    return Image(np.full((80, 100, 3), level, np.uint8), CAMERA, depth_m=depth_m, masked=masked)


def edges(picture: Image, **options: object) -> ImageEdges:
    found = METHOD.build(DepthOptions(**options))(picture).edges
    assert found is not None
    return found


def board(left: float, right: float, top: float, bottom: float) -> np.ndarray:
    """Depth of a board 5 m away, 20 m behind it, whose outline lies at these pixel coordinates."""
    v, u = np.mgrid[:80, :100]
    return np.where((u > left) & (u < right) & (v > top) & (v < bottom), 5.0, 20.0)


def test_edges_lie_half_way_to_the_background() -> None:
    found = edges(image(board(29.5, 59.5, 19.5, 49.5)))
    for side, axis, outline in (
        (Side.LEFT, 0, 29.5),
        (Side.RIGHT, 0, 59.5),
        (Side.UPPER, 1, 19.5),
        (Side.BOTTOM, 1, 49.5),
    ):
        assert (found.uv[found.side == side, axis] == outline).all()
        assert (found.side == side).sum() == 30


def test_pieces_shorter_than_the_limit_are_dropped_side_by_side() -> None:
    high, low = (image(board(29.5, 59.5, 19.5, bottom)) for bottom in (24.5, 23.5))  # 30 px wide, 5 and 4 px high
    assert {Side(int(s)) for s in edges(high).side} == set(Side) - {Side.NONE}
    assert {Side(int(s)) for s in edges(low).side} == {Side.UPPER, Side.BOTTOM}


def test_masked_foreground_gives_no_edge_and_masked_background_does() -> None:
    depth_m = board(29.5, 59.5, 19.5, 49.5)
    everything = edges(image(depth_m))
    assert len(edges(image(depth_m, masked=depth_m == 5))) == 0
    kept = edges(image(depth_m, masked=depth_m == 20))
    np.testing.assert_array_equal(kept.uv, everything.uv)


def test_small_steps_count_only_when_asked_for() -> None:
    depth_m = np.where(board(29.5, 59.5, 19.5, 49.5) == 5, 19.7, 20.0)
    assert len(edges(image(depth_m))) == 0
    assert len(edges(image(depth_m), min_jump_m=0.2)) == 4 * 30


def test_unknown_depth_gives_no_edge() -> None:
    depth_m = board(29.5, 59.5, 19.5, 49.5)
    depth_m[:, 25:30] = np.nan  # what lies left of the board is unknown
    sides = {Side(int(s)) for s in edges(image(depth_m)).side}
    assert sides == {Side.RIGHT, Side.UPPER, Side.BOTTOM}
    assert len(edges(image(np.full((80, 100), np.nan)))) == 0


def test_a_picture_without_depth_is_refused_with_a_way_out() -> None:
    with pytest.raises(InputError, match=r"^depth: the image has no depth.*--extractor"):
        edges(image(None))
