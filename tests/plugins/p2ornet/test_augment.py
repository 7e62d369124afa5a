"""Crops for training: whatever is done to a picture, its labels stay on its silhouettes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from p2o_plugins.p2ornet.augment import LONGEST, Augmentation, Crop, Light, crop, cut, draw, mirrored
from p2o_plugins.p2ornet.example import UNKNOWN, Example
from p2o_plugins.p2ornet.spans import EAST, SOUTH, Spans

STILL = Augmentation(scale=1, mirror=False, light=0, blur_px=0, noise=0)


def same(rgb: Any) -> Any:
    return rgb


def noisy_example(seed: int = 0, height: int = 24, width: int = 33) -> Example:
    """Random grey values and random classes: nothing is alike at two places."""
    rng = np.random.default_rng(seed)
    rgb = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    classes = rng.choice(np.array([-1, 0, 1, 2], np.int8), (2, height, width))
    classes[EAST, :, -1] = classes[SOUTH, -1] = UNKNOWN
    return Example("noise", rgb, classes, Spans.joined())


def step_example(axis: int, at: int, order: int, height: int = 90, width: int = 120) -> Example:
    """A picture that turns from black to white between pixels `at` - 1 and `at`, its class and a stretch around it."""
    rgb = np.zeros((height, width, 3), np.uint8)
    classes = np.ones((2, height, width), np.int8)
    if axis == EAST:
        rgb[:, at:] = 255
        classes[EAST, :, at - 1] = order + 1
    else:
        rgb[at:] = 255
        classes[SOUTH, at - 1] = order + 1
    classes[EAST, :, -1] = classes[SOUTH, -1] = UNKNOWN
    lines = np.arange(height if axis == EAST else width, dtype=float)
    spans = Spans.of(axis, order, lines, np.full(len(lines), at - 2.0), np.full(len(lines), at + 1.5))
    return Example("step", rgb, classes, spans)


# ---- the flip


def test_the_flip_turns_east_orders_and_shifts_them_by_one_column() -> None:
    classes = noisy_example().classes
    assert classes is not None
    flipped = mirrored(classes)
    width = classes.shape[2]
    for x in range(width - 1):
        there = classes[EAST, :, width - 2 - x]
        np.testing.assert_array_equal(flipped[EAST, :, x], np.where(there < 0, UNKNOWN, 2 - there))
    assert (flipped[EAST, :, -1] == UNKNOWN).all()
    for x in range(width):
        np.testing.assert_array_equal(flipped[SOUTH, :, x], classes[SOUTH, :, width - 1 - x])


# ---- crops at scale 1


def test_a_whole_shift_at_scale_one_is_a_plain_crop() -> None:
    example = noisy_example()
    assert example.classes is not None
    got = cut(example, (10, 12), 1.0, (5.0, 7.0), False, same)
    np.testing.assert_array_equal(got.rgb, example.rgb[7:17, 5:17])
    np.testing.assert_array_equal(got.classes[EAST, :, :-1], example.classes[EAST, 7:17, 5:16])
    np.testing.assert_array_equal(got.classes[SOUTH, :-1], example.classes[SOUTH, 7:16, 5:17])
    # Pairs that leave the crop are not there.
    assert (got.classes[EAST, :, -1] == UNKNOWN).all()
    assert (got.classes[SOUTH, -1] == UNKNOWN).all()


def test_the_mirrored_crop_is_the_crop_mirrored() -> None:
    example = noisy_example()
    for scale, shift in ((1.0, (3.0, 2.0)), (1.3, (4.6, 2.2)), (0.75, (1.1, 0.4))):
        plain = cut(example, (12, 16), scale, shift, False, same)
        flipped = cut(example, (12, 16), scale, shift, True, same)
        np.testing.assert_array_equal(flipped.rgb, plain.rgb[:, ::-1])
        np.testing.assert_array_equal(flipped.classes, mirrored(plain.classes))


def test_what_lies_beyond_the_picture_repeats_its_border_and_is_unknown() -> None:
    example = noisy_example()
    got = cut(example, (40, 50), 1.0, (-6.0, -5.0), False, same)
    assert (got.rgb[:5, :6] == example.rgb[0, 0]).all()
    known = got.classes != UNKNOWN
    outside = np.ones((40, 50), bool)
    outside[5:29, 6:39] = False
    assert not known[:, outside].any()
    assert not known[EAST, :, 38].any()  # this pair leaves the picture
    assert not known[SOUTH, 28].any()
    assert known.sum() == (example.classes != UNKNOWN).sum()


# ---- at any scale


@pytest.mark.parametrize("mirror", [False, True])
@pytest.mark.parametrize("order", [-1, 1])
@pytest.mark.parametrize("axis", [EAST, SOUTH])
def test_labels_stay_on_the_step_of_grey_at_any_scale_and_shift(axis: int, order: int, mirror: bool) -> None:
    rng = np.random.default_rng(axis + 2 * mirror)
    for scale in [0.715, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4, *rng.uniform(0.715, 1.4, 5)]:
        at = int(rng.integers(22, 27))
        shift = (float(rng.uniform(0, 8)), float(rng.uniform(0, 8)))
        dense = step_example(axis, at, order)
        sparse = Example("", dense.rgb, None, dense.spans)
        got = cut(sparse, (48, 64), float(scale), shift, mirror, same)
        grey = got.rgb[..., 0].astype(float)
        bags = got.bags
        flips = mirror and axis == EAST
        name = 1 + (-order if flips else order)
        place = scale * at - 0.5 - shift[axis]  # of the step: half a pixel before pixel `at`
        if axis == SOUTH:
            grey = grey.T
        if flips:
            grey, place = 255 - grey, 63 - place
        pair = int(np.floor(place))
        # The grey value crosses the middle inside of the pair that holds the place (warped to 1/32 px).
        assert (grey[:, pair] <= 127.5 + 20).all()
        assert (grey[:, pair + 1] >= 127.5 - 20).all()
        # So one of the pairs of each stretch is the edge, and it says so with the right order.
        assert len(bags) >= 32
        assert (got.bag_class == name).all()
        along = bags % 64 if axis == EAST else bags // 64 % 48
        assert ((along == pair) & (bags >= 0)).any(axis=1).all()
        # Without stretches the dense labels are left: one pair in each line, the same.
        only = cut(Example("", dense.rgb, dense.classes, Spans.joined()), (48, 64), float(scale), shift, mirror, same)
        lines = only.classes[axis] if axis == EAST else only.classes[axis].T
        line, where = np.nonzero((lines == 0) | (lines == 2))
        # Rounding alone may decide where the place falls on the border between two pairs.
        assert np.abs(where + 0.5 - place).max() <= 0.5 + 1e-6
        assert (lines[line, where] == name).all()
        np.testing.assert_array_equal(line, np.arange(len(lines)))  # one pair thick, no line left out


def test_a_slanted_silhouette_stays_one_pair_thick() -> None:
    height, width = 90, 120
    edge = 30 + np.arange(height) // 3
    classes = np.ones((2, height, width), np.int8)
    classes[EAST, np.arange(height), edge] = 2
    example = Example("", np.zeros((height, width, 3), np.uint8), classes, Spans.joined())
    for scale in (0.72, 0.93, 1.21, 1.4):
        got = cut(example, (60, 80), scale, (2.3, 1.7), False, same).classes[EAST]
        assert ((got == 2).sum(axis=1) == 1).all()


# ---- stretches


def rows(axis: int, order: int, line: float, start: float, end: float) -> Spans:
    return Spans.of(axis, order, np.array([line]), np.array([start]), np.array([end]), 0.7)


@pytest.mark.parametrize("axis", [EAST, SOUTH])
def test_a_smooth_stretch_knows_the_pairs_between_its_ends(axis: int) -> None:
    classes = np.full((2, 12, 12), UNKNOWN, np.int8)
    bags, *_ = draw(rows(axis, 0, 4.4, 3.0, 7.0), classes)
    expected = np.full((12, 12), UNKNOWN, np.int8)
    expected[4, 3:7] = 1  # between 3 and 4, ..., 6 and 7
    np.testing.assert_array_equal(classes[axis] if axis == EAST else classes[axis].T, expected)
    assert (classes[1 - axis] == UNKNOWN).all()
    assert len(bags) == 0


@pytest.mark.parametrize("axis", [EAST, SOUTH])
def test_a_stretch_with_an_occlusion_is_a_bag_of_the_pairs_between_its_ends(axis: int) -> None:
    classes = np.ones((2, 12, 15), np.int8)
    bags, number, weight = draw(rows(axis, -1, 5.0, 2.6, 5.4), classes)
    pairs = [(axis, 5, u) if axis == EAST else (axis, u, 5) for u in (3, 4)]  # 3.5 and 4.5
    assert bags.shape == (1, LONGEST)
    assert bags[0].tolist() == [int(np.ravel_multi_index(p, classes.shape)) for p in pairs] + [-1] * (LONGEST - 2)
    assert number.tolist() == [0]
    assert weight == pytest.approx([0.7])
    assert sorted(map(tuple, np.argwhere(classes == UNKNOWN).tolist())) == pairs


def test_an_occlusion_wins_over_smooth_stretches_that_overlap() -> None:
    classes = np.full((2, 12, 15), UNKNOWN, np.int8)
    draw(Spans.joined(rows(EAST, 1, 5, 4, 6), rows(EAST, 0, 5, 1, 5), rows(EAST, 0, 5, 5, 9)), classes)
    assert classes[EAST, 5].tolist() == [-1, 1, 1, 1, -1, -1, 1, 1, 1, -1, -1, -1, -1, -1, -1]


def test_stretches_that_leave_the_crop_or_say_too_little_are_left_out_and_smooth_ones_are_cut_off() -> None:
    classes = np.full((2, 30, 40), UNKNOWN, np.int8)
    outside = [
        rows(EAST, 1, 5, -3, 2),
        rows(EAST, 1, 5, 37, 42),
        rows(EAST, 1, 30, 5, 8),
        rows(EAST, 1, -1, 5, 8),
        rows(SOUTH, 1, 5, 28, 31),
        rows(SOUTH, 1, 40, 5, 8),
        rows(EAST, 1, 5, 10, 10 + LONGEST + 1),
        rows(EAST, 1, 5, 10.1, 10.3),  # holds no pair
    ]
    bags, *_ = draw(Spans.joined(*outside), classes)
    assert len(bags) == 0
    assert (classes == UNKNOWN).all()
    draw(Spans.joined(rows(EAST, 0, 5, -3, 2), rows(EAST, 0, 6, 37, 50), rows(SOUTH, 0, 9, -4, 99)), classes)
    assert np.flatnonzero(classes[EAST, 5] == 1).tolist() == [0, 1]
    assert np.flatnonzero(classes[EAST, 6] == 1).tolist() == [37, 38]
    assert np.flatnonzero(classes[SOUTH, :, 9] == 1).tolist() == list(range(29))
    assert (classes != UNKNOWN).sum() == 2 + 2 + 29


# ---- chance


def equal(a: Crop, b: Crop) -> bool:
    names = ("rgb", "classes", "bags", "bag_class", "bag_weight")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


def test_the_seed_decides_everything() -> None:
    example = step_example(EAST, 50, 1)
    first, again, other = (crop(example, (40, 60), Augmentation(), np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert equal(first, again)
    assert not equal(first, other)


def test_crops_lie_inside_of_the_picture_wherever_it_is_large_enough() -> None:
    example = Example("", np.zeros((60, 80, 3), np.uint8), np.ones((2, 60, 80), np.int8), Spans.joined())
    options = Augmentation(scale=1.2, light=0, blur_px=0, noise=0)
    for seed in range(40):
        got = crop(example, (50, 66), options, np.random.default_rng(seed))
        # At most the lines on which pairs leave the picture, or half a pixel of it, are unknown.
        assert (got.classes[EAST] == 1).sum() >= 48 * 64
        assert (got.classes[SOUTH] == 1).sum() >= 48 * 64


def floats(*pixels: tuple[float, float, float]) -> Any:
    return np.array([pixels], np.float32)


def test_each_part_of_a_light_does_what_it_is_called() -> None:
    colours = floats((200, 100, 40), (0, 0, 120), (90, 90, 90))
    luma = colours @ np.array([0.299, 0.587, 0.114], np.float32)
    np.testing.assert_allclose(Light(gain=(0.5, 1.0, 2.0)).on(colours)[0, 0], (100, 100, 80), atol=1e-3)
    np.testing.assert_allclose(Light(saturation=0.0).on(colours), np.repeat(luma[..., None], 3, 2), atol=1e-3)
    np.testing.assert_allclose(Light(contrast=0.0).on(colours), np.full_like(colours, luma.mean()), atol=1e-3)
    half = 0.5 * (colours + luma.mean())
    np.testing.assert_allclose(Light(contrast=0.5).on(colours), half, atol=1e-3)
    np.testing.assert_allclose(Light(gamma=2.0).on(colours), colours**2 / 255, atol=1e-2)


def test_painted_marks_change_a_part_of_the_picture_and_no_label() -> None:
    example = Example("grey", np.full((90, 120, 3), 128, np.uint8), np.ones((2, 90, 120), np.int8), Spans.joined())
    options = Augmentation(scale=1, mirror=False, light=0, blur_px=0, noise=0, marks=3)
    crops = [crop(example, (90, 120), options, np.random.default_rng(seed)) for seed in range(30)]
    painted = np.array([(c.rgb != 128).any(axis=2).mean() for c in crops])
    assert 0.3 < (painted > 0).mean() < 0.8
    assert painted.max() < 1
    for c in crops:
        assert (c.classes == crops[0].classes).all()
