"""The bounds of `benchmarks/bound.py`: no pose of a box costs less, and no edge moves farther."""

from __future__ import annotations

import numpy as np
import pytest
from bound import TOLERANCE_PX, Bound, certify, certify_all, tiles
from p2o import se3
from p2o.solving import DirectedCost

from tests import edge_scene

TURN, SHIFT_M = np.radians(2.0), 0.15
_CORNERS = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 6), axis=-1).reshape(-1, 6)


def cost_around(start: np.ndarray, views: int = 1, **scene: float) -> DirectedCost:
    seen = [edge_scene.view(seed=seed, noise_px=0.7, **scene) for seed in range(views)]
    # Edges beyond the picture may come in, and those at its border leave.
    return DirectedCost.of(seen, start, 4.0, smooth=False, margin_px=20.0)


@pytest.fixture(scope="module")
def bound() -> Bound:
    start = se3.exp(np.array([0.012, -0.015, 0.01, 0.04, -0.05, 0.08])) @ edge_scene.TRUTH
    return Bound(cost_around(start, views=2), TURN, SHIFT_M)


def boxes_with_poses(bound: Bound, rng: np.random.Generator):
    """Give boxes of all sizes, each with centres of it (K, 6) that are poses of the domain, its corners among them."""
    for halvings in range(13):
        for _ in range(8):
            half = bound.half / 2.0**halvings * rng.uniform(0.2, 1, 6) * (rng.random(6) < 0.8)
            centre = rng.uniform(-1, 1, 6) * (bound.half - half)
            steps = np.concatenate([_CORNERS, rng.uniform(-1, 1, (30, 6))])
            inside = centre + steps * half
            yield halvings, centre, half, inside[~bound.outside(inside, np.zeros(6))]


def test_no_pose_of_a_box_costs_less_than_its_bound(bound: Bound) -> None:
    rng, told = np.random.default_rng(0), 0.0
    for _, centre, half, inside in boxes_with_poses(bound, rng):
        lower = bound.lower(centre[None], half)[0]
        if len(inside):
            assert bound.values(inside).min() >= lower - TOLERANCE_PX
            told = max(told, lower)
    # A bound that says nothing would hold as well.
    assert told > 1.0


def test_no_edge_moves_farther_than_its_box_allows(bound: Bound) -> None:
    rng, share = np.random.default_rng(1), 0.0
    for halvings, centre, half, inside in boxes_with_poses(bound, rng):
        for part, most in zip(bound.cost.parts, bound.motion_px(half), strict=True):
            poses = bound.poses(np.concatenate([centre[None], inside])) @ bound.cost.lidar_from_around
            pixels = np.stack([part.camera.project(se3.apply(pose, part.xyz)) for pose in poses])
            seen = np.isfinite(pixels).all(axis=(0, 2)) & np.isfinite(most).all(axis=0)
            moved = np.abs(pixels[1:] - pixels[0])[:, seen].max(axis=0, initial=0.0)
            assert (moved <= most.T[seen] + 1e-6).all()
            if halvings == 12 and half.all() and len(inside) > 50:
                share = max(share, float((moved / most.T[seen]).max()))
    # In small boxes the bound is nearly met by some edge.
    assert share > 0.8


def test_the_bound_of_a_single_pose_is_its_cost(bound: Bound) -> None:
    centres = np.random.default_rng(2).uniform(-0.5, 0.5, (40, 6)) * bound.half
    lower, values = bound.lower(centres, np.zeros(6)), bound.values(centres)
    # What is less is of edges that are at the edge of a cell.
    np.testing.assert_allclose(lower, values, atol=0.05)


def test_halving_a_box_never_lowers_its_bound_by_more_than_rounding_of_windows(bound: Bound) -> None:
    half = bound.half / 2**6
    smaller = half.copy()
    axis = bound.axis(half)
    smaller[axis] /= 2
    step = np.zeros(6)
    step[axis] = smaller[axis]
    centres = np.random.default_rng(3).uniform(-0.9, 0.9, (50, 6)) * bound.half
    of_halves = np.minimum(bound.lower(centres - step, smaller), bound.lower(centres + step, smaller))
    assert of_halves.mean() > bound.lower(centres, half).mean()


def test_a_centre_is_the_pose_it_was_made_of(bound: Bound) -> None:
    centres = np.random.default_rng(4).uniform(-1, 1, (5, 6)) * bound.half
    for centre, pose in zip(centres, bound.poses(centres), strict=True):
        np.testing.assert_allclose(bound.centre_of(pose), centre, atol=1e-9)


def turned(*deg: float) -> np.ndarray:
    """Return a start from which only a turn about the camera's centre is wrong."""
    return se3.exp(np.array([*np.radians(deg), 0, 0, 0])) @ edge_scene.TRUTH


def test_the_true_rotation_is_proved_to_be_the_only_one() -> None:
    bound = Bound(cost_around(turned(0.8, -0.6, 0.5)), TURN, 0.0)
    proof = certify(bound, edge_scene.TRUTH, np.radians(0.5))
    assert proof.certain
    assert se3.angle_deg(proof.pose @ se3.inverse(edge_scene.TRUTH)) < 0.5
    grid = np.stack(np.meshgrid(*[np.linspace(-TURN, TURN, 9)] * 3), axis=-1).reshape(-1, 3)
    values = bound.values(np.concatenate([grid, np.zeros((len(grid), 3))], axis=1))
    assert proof.cost_px <= values.min()


def test_a_wrong_pose_is_not_proved_and_the_right_one_is_found() -> None:
    start = turned(0.8, -0.6, 0.5)
    bound = Bound(cost_around(start), TURN, 0.0)
    proof = certify(bound, start, np.radians(0.3), sample=300)
    assert not proof.certain
    assert proof.cost_px < bound.values(np.zeros((1, 6)))[0]
    assert se3.angle_deg(proof.pose @ se3.inverse(edge_scene.TRUTH)) < 0.3


def test_where_time_is_up_nothing_is_certain_and_what_is_left_is_bounded() -> None:
    bound = Bound(cost_around(turned(0.8, -0.6, 0.5)), TURN, SHIFT_M)
    proof = certify(bound, edge_scene.TRUTH, np.radians(0.5), limit_s=0.0)
    assert not proof.certain
    assert proof.lowest_px <= proof.cost_px


def test_a_sample_of_the_boxes_estimates_how_many_there_are() -> None:
    bound = Bound(cost_around(turned(0.8, -0.6, 0.5)), TURN, 0.0)
    whole = certify(bound, edge_scene.TRUTH, np.radians(0.4))
    parts = [certify(bound, edge_scene.TRUTH, np.radians(0.4), sample=100, seed=seed).boxes for seed in range(12)]
    assert np.mean(parts) == pytest.approx(whole.boxes, rel=0.3)


def test_tiles_hold_every_pose_of_a_wide_domain() -> None:
    wide = np.radians(5.0)
    bounds = tiles(cost_around(edge_scene.TRUTH), wide, 0.0)
    updates = np.concatenate([np.random.default_rng(5).uniform(-wide, wide, (300, 3)), np.zeros((300, 3))], axis=1)
    for pose in se3.exp(np.concatenate([updates, wide * _CORNERS * [1, 1, 1, 0, 0, 0]])) @ edge_scene.TRUTH:
        centres = [bound.centre_of(pose) for bound in bounds]
        assert any((np.abs(at) <= bound.half + 1e-9).all() for at, bound in zip(centres, bounds, strict=True))


def test_a_tile_costs_what_the_whole_costs() -> None:
    cost = cost_around(turned(0.8, -0.6, 0.5))
    for bound in tiles(cost, np.radians(5.0), 0.0)[::9]:
        centre = bound.half * [0.3, -0.7, 0.2, 0, 0, 0]
        pose = bound.poses(centre[None])
        assert bound.values(centre[None])[0] == pytest.approx(cost(pose)[0], abs=1e-3)


def test_the_true_rotation_is_proved_to_be_the_only_one_of_a_wide_domain() -> None:
    bounds = tiles(cost_around(turned(2.0, -1.6, 1.5)), np.radians(4.0), 0.0)
    proof = certify_all(bounds, edge_scene.TRUTH, np.radians(1.0))
    assert proof.certain
    assert proof.looked_at > len(bounds)
