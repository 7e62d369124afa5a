"""Which frames to use together: rich ones first, the same place once, and what is missing is named."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from p2o import Camera
from p2o.confidence.frame_choice import SeenEdges, choose, open_axes, shortage
from p2o.features.side import Side
from p2o.geometry import se3
from p2o.problems.point_to_line import PointToLine

CAMERA = Camera.pinhole(700.0, 700.0, 600.0, 180.0, 1200, 360)
UPRIGHT, LEVEL = (Side.LEFT, Side.RIGHT), (Side.UPPER, Side.BOTTOM)
POSE = np.array([[0, -1, 0, 0.1], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]], dtype=float)


def frame(
    name: str, sides: Sequence[Side], *, seed: int, count: int = 150, depth_m: tuple[float, float] = (5, 40)
) -> SeenEdges:
    """Return a frame with edges of these directions, spread over the image."""
    rng = np.random.default_rng(seed)
    uv = rng.uniform([20, 20], [1180, 340], (count, 2))
    z = rng.uniform(*depth_m, count)
    xyz = np.column_stack([(uv - [600, 180]) / 700 * z[:, None], z])
    side = rng.choice(np.array(sides, np.int8), count)
    normal = np.where(np.isin(side, UPRIGHT)[:, None], [1.0, 0.0], [0.0, 1.0])
    seen = se3.apply(se3.inverse(POSE), xyz)
    same = np.ones(count), side, np.zeros(count, np.int64), (CAMERA,)
    return SeenEdges(name, PointToLine(seen, uv, normal, *same, sigma_px=np.ones(count)), POSE)


def test_frames_rich_in_edges_and_those_that_see_what_others_lack_come_before_those_of_one_direction() -> None:
    walls = [frame(f"wall {i}", LEVEL, seed=i, count=60) for i in range(4)]
    rich = [frame(f"rich {i}", (*UPRIGHT, *LEVEL), seed=10 + i) for i in range(2)]
    steps = choose([*walls, *rich], count=2)
    assert {step.name for step in steps} == {"rich 0", "rich 1"}
    level = [frame(f"level {i}", LEVEL, seed=i) for i in range(4)]
    poles = frame("poles", UPRIGHT, seed=20, count=60)
    assert "poles" in {step.name for step in choose([*level, poles], count=2)}


def test_of_two_equal_frames_the_second_is_not_chosen_before_another_place() -> None:
    best = frame("best", (*UPRIGHT, *LEVEL), seed=1, count=200)
    twin = SeenEdges("twin", best.problem, best.camera_from_lidar)
    other = frame("other", (*UPRIGHT, *LEVEL), seed=2, count=100)
    steps = choose([best, twin, other], count=3)
    assert [step.name for step in steps][:2] in (["best", "other"], ["twin", "other"])
    assert steps[2].places == 0


def test_known_poses_tell_places_apart_and_together() -> None:
    one = frame("one", (*UPRIGHT, *LEVEL), seed=1)
    here, far = np.eye(4), np.eye(4)
    far[0, 3] = 30.0
    still = SeenEdges("still", one.problem, POSE, "drive", here)
    moved = SeenEdges("moved", one.problem, POSE, "drive", far)
    assert still.same_place(SeenEdges("again", frame("x", LEVEL, seed=9).problem, POSE, "drive", here))
    assert not still.same_place(moved)
    assert still.same_place(SeenEdges("elsewhere", one.problem, POSE, "other drive", far)), "it sees the same"


def test_likely_errors_fall_with_every_frame_and_the_choice_ends_when_they_are_small_enough() -> None:
    frames = [frame(f"{i}", (*UPRIGHT, *LEVEL), seed=i) for i in range(8)]
    sizes = [step.accuracy.translation_m for step in choose(frames, count=8) if step.accuracy is not None]
    assert len(sizes) == 8
    assert sizes == sorted(sizes, reverse=True)
    wanted = (90.0, (sizes[1] + sizes[2]) / 2)
    assert len(choose(frames, wanted=wanted)) == 3
    assert len(choose(frames, least_gain=0.9)) == 1
    assert [len({step.name for step in choose(frames, count=count)}) for count in (1, 3, 5)] == [1, 3, 5]


def test_what_stays_open_is_named_with_its_reason() -> None:
    poles = [frame(f"{i}", UPRIGHT, seed=i) for i in range(3)]
    (*_, last) = choose(poles, count=3)
    assert last.accuracy.pitch_deg > last.accuracy.yaw_deg
    words = open_axes(last.accuracy, (90.0, 0.05))
    assert words == ["height"]
    assert "0 of" in shortage(poles, words)
    assert "level edges" in shortage(poles, words)


def test_the_information_does_not_depend_on_how_many_pairs_a_place_has_and_no_pair_gives_none() -> None:
    one = frame("one", (*UPRIGHT, *LEVEL), seed=1, count=40)
    names = ("xyz", "centre", "normal", "weight", "side", "frame", "sigma_px")
    doubled = {name: np.concatenate([getattr(one.problem, name)] * 2) for name in names}
    twice = SeenEdges("twice", PointToLine(**doubled, cameras=(CAMERA,)), POSE)
    np.testing.assert_allclose(twice.by_place, one.by_place, rtol=1e-9)
    empty = SeenEdges("empty", PointToLine.empty((CAMERA,)), POSE)
    assert [step.accuracy for step in choose([empty])] == [None]
    assert choose([empty, frame("one", (*UPRIGHT, *LEVEL), seed=1)])[0].name == "one"


def test_the_same_place_again_does_not_pretend_that_beams_lie_elsewhere() -> None:
    one = frame("one", (*UPRIGHT, *LEVEL), seed=1)
    twins = [SeenEdges(name, one.problem, POSE) for name in ("a", "b", "c", "d")]
    others = [frame(f"{i}", (*UPRIGHT, *LEVEL), seed=i) for i in range(4)]
    again, elsewhere = (choose(frames, count=4)[-1].accuracy for frames in (twins, others))
    first = choose(twins, count=1)[-1].accuracy
    assert None not in (first, again, elsewhere)
    assert again.rotation_deg > 0.85 * first.rotation_deg
    assert elsewhere.rotation_deg < 0.75 * first.rotation_deg
    assert "of 1 scene" in shortage(twins, ["roll", "pitch", "yaw", "height"])
