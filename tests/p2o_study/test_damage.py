"""Circle patches take image edges away: as many as asked, in patches, the same ones for the same seed and frame."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from p2o import Camera, ImageEdges, ImageFeatures, P2OError, Registry
from p2o_study.damage import Damage, frame_rng, without_patches
from p2o_study.study import check_study, parse_study
from scipy.spatial import cKDTree

WIDTH, HEIGHT, RADIUS = 1242, 375, 40.0


def edges(count: int = 6000, seed: int = 0) -> ImageEdges:
    rng = np.random.default_rng(seed)
    uv = rng.uniform((-0.5, -0.5), (WIDTH - 0.5, HEIGHT - 0.5), (count, 2))
    return ImageEdges(uv, rng.integers(0, 4, count), rng.uniform(0.5, 1, count))


def thinned(rate: float, seed: int = 0, radius_px: float = RADIUS) -> ImageEdges:
    return without_patches(edges(), WIDTH, HEIGHT, rate, np.random.default_rng(seed), radius_px=radius_px)


@pytest.mark.parametrize("rate", [0.0, 0.1, 0.25, 0.45, 0.95])
@pytest.mark.parametrize("seed", range(4))
def test_the_share_that_is_gone_is_the_rate_to_less_than_one_circle(rate: float, seed: int) -> None:
    whole = edges()
    gone = len(whole) - len(thinned(rate, seed))
    # More than the fullest circle can hold: centres every 4 px, a radius that makes up for what lies between them.
    centres = np.stack(np.meshgrid(np.arange(0, WIDTH, 4), np.arange(0, HEIGHT, 4)), -1).reshape(-1, 2)
    fullest = cKDTree(whole.uv).query_ball_point(centres, RADIUS + 3, return_length=True).max()
    assert rate * len(whole) <= gone < rate * len(whole) + fullest
    assert fullest < 0.03 * len(whole)
    assert gone == 0 or rate > 0


def test_what_is_left_is_unchanged_and_in_order() -> None:
    whole, left = edges(), thinned(0.45)
    rows = cKDTree(whole.uv).query(left.uv)[1]
    assert (np.diff(rows) > 0).all()
    for name in ("uv", "side", "weight"):
        np.testing.assert_array_equal(getattr(left, name), getattr(whole, name)[rows])


def test_edges_go_in_patches_not_one_by_one() -> None:
    whole, left = edges(), thinned(0.25)
    kept = np.isin(np.arange(len(whole)), cKDTree(whole.uv).query(left.uv)[1])
    nearest = cKDTree(whole.uv).query(whole.uv, k=2)[1][:, 1]
    # Dropped one by one, a quarter of the neighbours of a missing edge would be missing.
    assert (~kept[nearest])[~kept].mean() > 0.85


def test_the_rim_of_the_picture_loses_as_much_as_its_middle() -> None:
    whole = edges()
    rim = (np.minimum(whole.uv, (WIDTH, HEIGHT) - whole.uv) < 20).any(axis=1)
    lost_rim, lost = 0.0, 0.0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        left = without_patches(whole, WIDTH, HEIGHT, 0.4, rng, radius_px=RADIUS)
        kept = np.isin(np.arange(len(whole)), cKDTree(whole.uv).query(left.uv)[1])
        lost_rim, lost = lost_rim + (~kept[rim]).mean(), lost + (~kept).mean()
    assert lost_rim == pytest.approx(lost, rel=0.1)


def test_directions_at_one_pixel_stay_or_go_together() -> None:
    one = edges(500)
    both = ImageEdges(np.repeat(one.uv, 2, axis=0), np.tile([0, 1], 500))
    left = without_patches(both, WIDTH, HEIGHT, 0.5, np.random.default_rng(0), radius_px=RADIUS)
    np.testing.assert_array_equal(left.uv[0::2], left.uv[1::2])
    assert len(left) <= 500


def test_no_edges_stay_no_edges() -> None:
    assert len(without_patches(ImageEdges.empty(), WIDTH, HEIGHT, 0.5, np.random.default_rng(0))) == 0


def test_the_generator_of_a_frame_is_the_same_in_another_process_and_differs_by_seed_and_name() -> None:
    code = "from p2o_study.damage import frame_rng; print(frame_rng(7, 'day/drive/0001').integers(1 << 62))"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    number = int(frame_rng(7, "day/drive/0001").integers(1 << 62))
    assert number == int(other.stdout)
    assert number != frame_rng(8, "day/drive/0001").integers(1 << 62)
    assert number != frame_rng(7, "day/drive/0002").integers(1 << 62)


CAMERA = Camera.pinhole(700, 700, 600, 180, WIDTH, HEIGHT)


def damaged(name: str = "day/drive/0001", **options) -> ImageEdges:
    left = Damage(**options).image_features(ImageFeatures(edges()), CAMERA, name).edges
    assert left is not None
    return left


def test_the_patches_follow_from_seed_and_name_of_the_frame() -> None:
    whole, left = damaged(), damaged(missing_edges=0.45)
    assert len(whole) == len(edges())
    assert 0.45 <= 1 - len(left) / len(whole) < 0.5
    assert left.uv.tobytes() == damaged(missing_edges=0.45).uv.tobytes()
    for other in (
        damaged(missing_edges=0.45, seed=1),
        damaged(missing_edges=0.45, name="another"),
        damaged(missing_edges=0.45, radius_px=80),
    ):
        assert other.uv.tobytes() != left.uv.tobytes()


def test_other_features_and_images_without_edges_are_left_alone() -> None:
    none = ImageFeatures()
    assert Damage(missing_edges=0.5).image_features(none, CAMERA, "a") is none


ROW = """
name = "few"
title = "Few edges"
[[dataset]]
name = "scenes"
data = "synthetic:?scenes=2&right=false"
[[row]]
label = "whole"
extractor = "depth/rings"
init = "given"
[[row]]
label = "few"
extractor = "depth/rings"
init = "given"
options.damage.missing_edges = 0.45
"""


def test_the_seed_of_the_row_seeds_the_patches_unless_they_have_their_own() -> None:
    study = parse_study(ROW).overridden(seeds=[5])
    _, few = check_study(study, Registry.load())
    assert few.damage(5) == Damage(missing_edges=0.45, seed=5)
    own = parse_study(ROW + "options.damage.seed = 9\n").rows()[1]
    assert own.damage(5).seed == 9


def test_damage_is_no_option_of_a_recipe() -> None:
    few = parse_study(ROW).rows()[1]
    assert "damage" not in few.recipe(0).options


@pytest.mark.parametrize("wrong", ["missing_edges = 0.96", "missing_edges = -0.1", "radius_px = 0", "patches = 3"])
def test_options_that_do_not_exist_or_are_out_of_bounds_are_refused_by_row(wrong: str) -> None:
    study = parse_study(ROW.replace("missing_edges = 0.45", wrong))
    with pytest.raises(P2OError, match=r"row 'few'.*damage"):
        check_study(study, Registry.load())
