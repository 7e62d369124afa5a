"""Stretches of pairs: what sparse depth and sweeps say of them is what dense truth says, where there is some."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from p2o import Camera, Cloud, Frame, occlusion
from p2o_plugins.p2ornet.augment import draw
from p2o_plugins.p2ornet.example import UNKNOWN, example_of
from p2o_plugins.p2ornet.spans import EAST, SOUTH, Spans, depth_spans, lidar_spans
from p2o_sim.synthetic import SyntheticOptions, build
from scipy import ndimage

NAN = np.nan


def table(spans: Spans, order: int | None = None) -> list[tuple[float, ...]]:
    """Return (axis, order, line, start, end) of the stretches of an order, sorted."""
    rows = spans.rows if order is None else spans.rows[spans.rows["order"] == order]
    return sorted(tuple(float(row[name]) for name in ("axis", "order", "line", "start", "end")) for row in rows)


def occlusions(spans: Spans) -> Spans:
    return Spans(spans.rows[spans.rows["order"] != 0])


# ---- arithmetic


def test_moving_scales_about_the_corner_of_the_image_then_shifts_then_mirrors() -> None:
    east = Spans.of(EAST, 1, np.array([10.0]), np.array([4.0]), np.array([6.0]))
    south = Spans.of(SOUTH, -1, np.array([10.0]), np.array([4.0]), np.array([6.0]))
    # A picture of 20 px doubled: the corner at -1/2 stays, so 4 -> 8.5 and 10 -> 20.5.
    assert table(east.moved(2.0, (3.0, 1.0))) == [(0, 1, 19.5, 5.5, 9.5)]
    assert table(south.moved(2.0, (3.0, 1.0))) == [(1, -1, 17.5, 7.5, 11.5)]
    # 40 columns: column c becomes 39 - c, and what hid the pixel to its right now hides the one to its left.
    assert table(east.moved(2.0, (3.0, 1.0), 40)) == [(0, -1, 19.5, 29.5, 33.5)]
    assert table(south.moved(2.0, (3.0, 1.0), 40)) == [(1, -1, 21.5, 7.5, 11.5)]


# ---- sparse depth


@pytest.mark.parametrize("axis", [EAST, SOUTH])
def test_a_box_in_sparse_depth_has_an_edge_on_each_side_between_the_last_known_pixels(axis: int) -> None:
    depth = np.full((7, 26), NAN)
    depth[3, 2:9] = 20.0  # wall
    depth[3, 10:16] = 5.0  # box; pixel 9 is unknown
    depth[3, 18:24] = 20.0  # pixels 16 and 17 are unknown
    found = depth_spans(depth if axis == EAST else depth.T)
    # From half a pixel inside of the last known pixel of the box to half a pixel beyond the first of the wall.
    assert table(occlusions(found)) == [(axis, -1, 3, 7.5, 10.5), (axis, 1, 3, 14.5, 18.5)]
    smooth = [(axis, 0, 3, u, u + 1) for u in [*range(2, 8), *range(10, 15), *range(18, 23)]]
    assert table(found, 0) == smooth
    assert (found.rows["weight"] == 1).all()


def test_far_apart_thin_or_unequal_pixels_say_nothing() -> None:
    def orders(values: dict[int, float], **options: float) -> list[int]:
        depth = np.full((1, 30), NAN)
        for u, z in values.items():
            depth[0, u] = z
        return sorted(int(order) for order in depth_spans(depth, **options).rows["order"])  # type: ignore[arg-type]

    near = dict.fromkeys(range(4), 5.0)
    assert orders({**near, 4: 20.0}) == [0, 0, 0, 1]
    assert orders({**near, 7: 20.0}) == [0, 0, 0, 1]
    assert orders({**near, 8: 20.0}) == [0, 0, 0]  # five pixels apart
    assert orders({**near, 8: 20.0}, reach_px=5) == [0, 0, 0, 1]
    assert orders({1: 5.0, 2: 5.0, 3: 5.0, 4: 20.0}) == [0, 0]  # three pixels: the edge and two behind it
    assert orders({0: 5.0, 2: 5.0, 3: 5.0, 4: 5.0, 5: 20.0}) == [0, 0, 0]  # a hole in the surface
    assert orders({**near, 4: 5.3}) == [0, 0, 0]  # neither smooth nor a jump
    assert orders({**near, 4: 5.3}, min_jump_m=0.1) == [0, 0, 0, 1]
    assert orders({}) == []
    assert orders({3: 5.0}) == []


def road(height: int = 120, width: int = 20, horizon: int = 40, known: float = 1.0, seed: int = 0) -> np.ndarray:
    """Depth of a flat road 1.65 m below a camera of f = 721 px, unknown above the horizon and at random."""
    v = np.arange(height)[:, None] + np.zeros(width)
    with np.errstate(divide="ignore"):
        depth = np.where(v > horizon + 8, 721 * 1.65 / (v - horizon), NAN)
    depth[np.random.default_rng(seed).random(depth.shape) >= known] = NAN
    return depth


@pytest.mark.parametrize("known", [1.0, 0.9, 0.6])
def test_a_slanted_road_has_no_edges(known: float) -> None:
    found = depth_spans(road(known=known))
    assert len(found) > 200
    assert len(occlusions(found)) == 0
    assert len(occlusions(depth_spans(road(known=known).T))) == 0


def test_a_box_on_a_slanted_road_has_only_its_own_edges() -> None:
    depth = road()
    depth[60:100, 6:14] = depth[99, 0]  # it stands where the road has the depth of its lower border
    found = table(occlusions(depth_spans(depth)))
    assert {row[:2] for row in found} == {(SOUTH, -1), (EAST, -1), (EAST, 1)}
    assert [row for row in found if row[0] == SOUTH] == [(SOUTH, -1, u, 58.5, 60.5) for u in range(6, 14)]
    for order, start in ((-1, 4.5), (1, 12.5)):
        lines = [row for row in found if row[:2] == (EAST, order)]
        assert {row[3] for row in lines} == {start}
        assert next(row[2] for row in lines) == 60  # down to where the road comes near: less than 0.4 m behind
        jump = depth[[int(row[2]) for row in lines], 0] - depth[99, 0]
        assert jump.min() > 0.4


# ---- sweeps, against dense truth


@cache
def frame(place: str, seed: int = 0) -> Frame:
    """Return a synthetic frame without noise of any kind, with leaves masked; frames cannot be changed."""
    options = SyntheticOptions(
        place=place, seed=seed, right=False, noise_m=0.0, angle_noise_deg=0.0, divergence_mrad=0.0, mask_foliage=True
    )
    return build(options)[0]


@cache
def labels(place: str) -> Spans:
    made = frame(place)
    assert made.camera_from_lidar is not None
    return lidar_spans(made.cloud, made.camera, made.camera_from_lidar)


@cache
def truth(place: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the orders (2, H, W) by the dense rule, and which pixels are at most 2 px away from leaves."""
    image = frame(place).image
    orders = occlusion.occlusion_orders(image.depth_m, image.camera)
    assert image.masked is not None
    return np.stack([orders.east, orders.south]), ndimage.binary_dilation(image.masked, iterations=2)


@pytest.mark.parametrize("axis", [EAST, SOUTH])
def test_where_the_sweep_goes_on_there_is_no_occlusion(axis: int) -> None:
    """At least 99 % of the pairs told to be none are none; the rest lies on outlines that pass between two beams."""
    orders, leaves = truth("street")
    classes = np.full(orders.shape, UNKNOWN, np.int8)
    draw(labels("street"), classes)
    told = (classes[axis] == 1) & ~leaves
    assert told.sum() > 5000
    assert np.mean(orders[axis][told] == 0) >= 0.99


def test_the_sides_of_the_sweep_have_the_orders_of_the_picture() -> None:
    """A wall 8 m away with a plate 4 m away: the plate hides what is beside it, on every side of it."""
    camera = Camera.pinhole(300, 300, 199.5, 99.5, 400, 200)
    camera_from_lidar = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    ring, column = (a.ravel() for a in np.mgrid[0:64, 0:1800])
    azimuth, slope = 2 * np.pi * column / 1800, np.tan(np.radians(12 - 24 * ring / 63))
    direction = np.column_stack([np.cos(azimuth), np.sin(azimuth), slope])
    forward = np.maximum(direction[:, 0], 1e-3)
    inside = (np.abs(direction[:, 1]) / forward < 0.3) & (np.abs(slope) / forward < 0.12) & (direction[:, 0] > 0.5)
    xyz = direction * np.where(inside, 4 / forward, np.minimum(8 / forward, 15.0))[:, None]
    spans = lidar_spans(Cloud(xyz, ring=ring, column=column), camera, camera_from_lidar)
    found = occlusions(spans).rows
    for axis, order, place, half in (
        (EAST, -1, 199.5 - 90, 36),
        (EAST, 1, 199.5 + 90, 36),
        (SOUTH, -1, 99.5 - 36, 90),
        (SOUTH, 1, 99.5 + 36, 90),
    ):
        one = found[(found["axis"] == axis) & (found["order"] == order)]
        middle = 99.5 if axis == EAST else 199.5
        # Rings and columns are bent on the plate: the outermost ones leave it through its other sides.
        inner = one[np.abs(one["line"] - middle) < half - 5]
        assert len(inner) > 15
        # Each stretch holds the outline, is no longer than beams are apart (1 or 2 px) and its margins, and lies on it.
        assert ((inner["start"] <= place) & (place <= inner["end"])).all()
        assert (one["end"] - one["start"]).max() < 1.5 + (3 if axis == EAST else 3.5)
        assert np.abs(one["line"] - middle).max() <= half + 2
    assert set(found["axis"].tolist()) == {EAST, SOUTH}


def test_a_camera_that_sees_nothing_of_the_sweep_learns_nothing() -> None:
    made = frame("street")
    away = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # looks straight up or down
    for flip in (1, -1):
        pose = np.diag([1.0, flip, flip, 1.0]) @ away
        pose[2, 3] = -500.0  # everything is behind it
        assert len(lidar_spans(made.cloud, made.camera, pose)) == 0


# ---- dense depth


def test_dense_depth_gives_the_dense_rule_and_masked_pairs_are_unknown() -> None:
    made = frame("street")
    orders, _ = truth("street")
    ignoring = example_of(made)
    assert ignoring.classes is not None
    assert len(ignoring.spans) == 0
    assert ignoring.classes.shape == orders.shape
    inside = np.ones(orders.shape, bool)
    inside[EAST, :, -1] = inside[SOUTH, -1] = False
    assert (ignoring.classes[~inside] == UNKNOWN).all()
    known = ignoring.classes != UNKNOWN
    np.testing.assert_array_equal(ignoring.classes[known], orders[known] + 1)
    lost = inside & ~known
    assert lost.sum() > 100
    # All but the neighbours of lone spikes, which masking a neighbour makes spikes no more.
    assert np.mean(orders[lost] != 0) > 0.9
