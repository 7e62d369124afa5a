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


def test_edges_lie_half_way_to_the_background_and_on_request_on_the_foreground_pixel() -> None:
    picture = image(board(29.5, 59.5, 19.5, 49.5))
    between, on = edges(picture), edges(picture, subpixel=False)
    for side, axis, outline, foreground in (
        (Side.LEFT, 0, 29.5, 30),
        (Side.RIGHT, 0, 59.5, 59),
        (Side.UPPER, 1, 19.5, 20),
        (Side.BOTTOM, 1, 49.5, 49),
    ):
        assert (between.uv[between.side == side, axis] == outline).all()
        assert (on.uv[on.side == side, axis] == foreground).all()
        assert (between.side == side).sum() == 30


def test_half_way_is_right_on_average_and_the_foreground_pixel_is_half_a_pixel_inside() -> None:
    rng = np.random.default_rng(0)
    miss: dict[bool, list[float]] = {True: [], False: []}
    for left, right in zip(rng.uniform(20, 30, 100), rng.uniform(60, 70, 100), strict=True):
        picture = image(board(left, right, 19.5, 49.5))
        for subpixel, errors in miss.items():
            found = edges(picture, subpixel=subpixel)
            errors.append(found.uv[found.side == Side.LEFT, 0].mean() - left)
            errors.append(right - found.uv[found.side == Side.RIGHT, 0].mean())
    assert np.abs(miss[True]).max() <= 0.5
    # Uniform within a pixel: the mean of 200 has a standard deviation of 0.02 px.
    assert np.mean(miss[True]) == pytest.approx(0, abs=0.1)
    assert np.mean(miss[False]) == pytest.approx(0.5, abs=0.1)


def test_pieces_shorter_than_the_limit_are_dropped_side_by_side() -> None:
    picture = image(board(29.5, 59.5, 19.5, 25.5))  # 30 px wide, 6 px high
    assert {Side(int(s)) for s in edges(picture).side} == set(Side) - {Side.NONE}
    assert {Side(int(s)) for s in edges(picture, min_length_px=7).side} == {Side.UPPER, Side.BOTTOM}
    assert len(edges(picture, min_length_px=31)) == 0


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
    assert len(edges(image(depth_m), min_jump_m=0.2, relative_jump=0.05)) == 0


def test_a_road_is_no_staircase_of_edges_unless_planes_are_ignored() -> None:
    v = np.arange(80)[:, None] * np.ones(100)
    road = image(1.65 * 200 / (v + 5.0))
    assert len(edges(road)) == 0
    flooded = edges(road, planes=False)
    assert len(flooded) > 1000
    assert (flooded.side == Side.UPPER).all()


def test_unknown_depth_gives_no_edge() -> None:
    depth_m = board(29.5, 59.5, 19.5, 49.5)
    depth_m[:, 25:30] = np.nan  # what lies left of the board is unknown
    sides = {Side(int(s)) for s in edges(image(depth_m)).side}
    assert sides == {Side.RIGHT, Side.UPPER, Side.BOTTOM}
    assert len(edges(image(np.full((80, 100), np.nan)))) == 0


def test_the_sky_is_a_background() -> None:
    depth_m = np.where(board(29.5, 59.5, 19.5, 49.5) == 5, 5.0, np.inf)
    assert len(edges(image(depth_m))) == 4 * 30


def test_the_picture_itself_plays_no_part() -> None:
    depth_m = board(29.5, 59.5, 19.5, 49.5)
    dark, bright = edges(image(depth_m, level=0)), edges(image(depth_m, level=200))
    np.testing.assert_array_equal(dark.uv, bright.uv)
    assert (dark.weight == 1).all()


def test_a_picture_without_depth_is_refused_with_a_way_out() -> None:
    with pytest.raises(InputError, match=r"^depth: the image has no depth.*--extractor"):
        edges(image(None))


def test_the_method_says_what_it_needs_and_gives() -> None:
    assert METHOD.gives == {"image-edges", "side"}
    assert METHOD.needs == {"depth"}
