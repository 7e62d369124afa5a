"""The far search finds the pose anywhere in its box, for one frame and many, whatever the camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, CloudEdges, CloudFeatures, ImageEdges, ImageFeatures, se3
from p2o.geometry.perturb import parse_perturbation
from p2o_plugins.initialize import far

from tests import edge_scene


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(far, "_SCATTER", 16384)
    monkeypatch.setattr(far, "_KEPT", 800)


def far_start(seed: int, size: str = "euler camera 20deg 1.5m") -> np.ndarray:
    return parse_perturbation(size).start(edge_scene.TRUTH, np.random.default_rng(seed))


def off(pose: np.ndarray) -> tuple[float, float]:
    """Return how far a pose is from the truth: degrees, and metres between the two cameras."""
    places = (se3.inverse(at)[:3, 3] for at in (pose, edge_scene.TRUTH))
    return se3.angle_deg(pose @ se3.inverse(edge_scene.TRUTH)), float(np.linalg.norm(np.subtract(*places)))


@pytest.mark.parametrize(
    ("camera", "seed"),
    [(edge_scene.PINHOLE, 0), (edge_scene.DISTORTED, 1), (edge_scene.FISHEYE, 0)],
    ids=lambda value: getattr(value, "model", None),
)
def test_the_best_proposal_is_the_right_basin_from_anywhere_in_the_box(camera: Camera, seed: int) -> None:
    view = edge_scene.view(camera, seed=seed)
    best = far.Far(far.FarOptions())([view], far_start(seed))[0]
    deg, metres = off(best)
    assert deg < 1.0
    assert metres < 0.2


def test_frames_that_tell_too_little_alone_tell_it_together() -> None:
    views = [edge_scene.view(seed=seed, boxes=4, name=str(seed)) for seed in range(8)]
    deg, metres = off(far.Far(far.FarOptions())(views, far_start(3))[0])
    assert deg < 1.0
    assert metres < 0.2


def test_of_a_large_group_some_frames_are_searched_with(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame that is not used may be wrong: only the second of three is left out here."""
    good, wrong = edge_scene.view(seed=0), edge_scene.view(seed=1, truth=far_start(5))
    start, options = far_start(0), far.FarOptions()
    monkeypatch.setattr(far, "_MAX_FRAMES", 2)
    monkeypatch.setattr(far, "_SCATTER", 512)
    with_wrong = far.Far(options)([good, wrong, good], start)
    without = far.Far(options)([good, good], start)
    assert all(map(np.array_equal, with_wrong, without))


def test_edges_without_directions_are_found_too() -> None:
    view = edge_scene.view(boxes=60).without_sides()
    start = far_start(2, "euler camera 5deg 0.3m")
    deg, metres = off(far.Far(far.FarOptions(reach_deg=5.0, reach_m=0.3))([view], start)[0])
    assert deg < 1.0
    assert metres < 0.2


def test_proposals_stay_within_reach_of_the_start() -> None:
    start = far_start(0)
    found = far.Far(far.FarOptions(reach_deg=3.0, reach_m=0.2))([edge_scene.view()], start)
    moves = far._tangents(np.stack([pose @ se3.inverse(start) for pose in found]))
    assert (np.abs(moves[:, :3]) < np.radians(3.0 * 1.5)).all()
    assert (np.abs(moves[:, 3:]) < 0.2 * 1.5).all()


def test_another_seed_gives_other_poses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(far, "_SCATTER", 512)
    view, start = edge_scene.view(), far_start(0)
    once, other = (far.Far(far.FarOptions(seed=seed))([view], start) for seed in (0, 1))
    assert [pose.tobytes() for pose in once] != [pose.tobytes() for pose in other]


@pytest.mark.parametrize("lacks", ["image", "cloud", "reach"])
def test_without_edges_that_could_meet_the_given_pose_is_proposed(lacks: str) -> None:
    view, start = edge_scene.view(), far_start(0)
    if lacks == "image":
        view = replace(view, image=ImageFeatures(ImageEdges.empty()))
    elif lacks == "cloud":
        view = replace(view, cloud=CloudFeatures(CloudEdges.empty()))
    else:
        start = se3.exp(np.array([0, np.pi, 0, 0, 0, 0])) @ start
    found = far.Far(far.FarOptions(reach_deg=10.0))([view], start)
    assert len(found) == 1
    assert np.array_equal(found[0], start)
