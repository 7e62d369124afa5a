"""Words say where a camera looks: known rigs come out as their matrices, and turns compose as they should."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.geometry.rough_start import rough_start

KITTI = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
AXES = "roughly x forward, z up; camera looks "


def rotation(look: str) -> np.ndarray:
    return rough_start(AXES + look)[:3, :3]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("roughly x forward, z up; camera looks forward", KITTI),
        ("Roughly X forward,Y left,Z up; Camera looks Forward", KITTI),
        # nuScenes: x right, y forward.
        ("roughly x right, y forward; camera looks forward", [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        ("roughly x right, y forward; camera looks back", [[-1, 0, 0], [0, 0, -1], [0, -1, 0]]),
        # A LiDAR with the camera's axes.
        ("roughly x right, y down; camera looks forward", np.eye(3)),
        # One that hangs upside down.
        ("roughly x forward, z down; camera looks forward", [[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    ],
)
def test_the_axes_of_known_rigs_give_their_matrices_exactly(text: str, expected: object) -> None:
    pose = rough_start(text)
    assert np.array_equal(pose[:3, :3], expected)
    assert np.array_equal(pose[:, 3], [0, 0, 0, 1])


def test_the_camera_looks_where_it_is_said_to_look() -> None:
    """What lies there is straight ahead: its camera z is its distance."""
    for look, ahead in {
        "180 deg right, 90 deg down, upside down": [0, 0, -1],
        "left": [0, 1, 0],
        "right": [0, -1, 0],
        "back": [-1, 0, 0],
        "up": [0, 0, 1],
        "45 deg left": [np.sqrt(0.5), np.sqrt(0.5), 0],
        "120 deg right": [-0.5, -np.sqrt(0.75), 0],
        "forward, 30 deg down": [np.sqrt(0.75), 0, -0.5],
        "90 deg left, 30deg up, turned 10 deg clockwise": [0, np.sqrt(0.75), 0.5],
    }.items():
        se3.check_rigid("start", rough_start(AXES + look))
        assert np.allclose(rotation(look) @ ahead, [0, 0, 1], atol=1e-12), look


def test_a_camera_that_is_not_turned_has_a_level_horizon_with_the_sky_above() -> None:
    for look in ("70 deg left, 20 deg down", "back, 60 deg up", "forward"):
        right, down, _ = rotation(look)
        assert np.isclose(right[2], 0), look
        assert down[2] < 0, look
    # Turned clockwise it has its right side below.
    assert np.allclose(rotation("forward, turned 90 deg clockwise")[0], [0, 0, -1])
    assert np.allclose(rotation("forward, turned 90 deg counterclockwise")[0], [0, 0, 1])
    upside_down = rotation("forward, upside down")
    assert np.array_equal(upside_down, np.diag([-1, -1, 1]) @ KITTI)
    assert np.array_equal(upside_down, rotation("upside down"))
    assert np.allclose(rotation("left, turned 180 deg clockwise"), rotation("left, upside down"))


def test_a_place_of_the_camera_moves_it_there_whichever_way_it_looks() -> None:
    """The camera's own place is its origin."""
    for look in ("forward", "135 deg right, 10 deg up, upside down"):
        pose = rough_start(f"{AXES}{look}; camera 0.3 m forward, 120cm down, 5 mm right of the lidar")
        assert np.allclose(se3.apply(pose, np.array([[0.3, -0.005, -1.2]])), 0, atol=1e-12)
    # KITTI's camera as docs/conventions.md has it.
    told = rough_start("roughly x forward, z up; camera looks forward; camera 0.27 m forward, 8 cm down of lidar")
    assert np.allclose(told, se3.make(KITTI, [0, -0.08, -0.27]), atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x forward, z up; camera looks forward", 'cannot read the initial guess; expected "roughly x forward, z up'),
        ("roughly camera looks forward", "directions of the LiDAR's axes are missing.*x forward, z up"),
        ("roughly x forward, z up", "viewing direction of the camera is missing.*camera looks 45 deg left"),
        ("roughly x forward; camera looks forward", "two axes of x, y, z"),
        ("roughly x forwards, z up; camera looks forward", "each with one of forward, back"),
        ("roughly x forward, x up; camera looks forward", "two axes of x, y, z"),
        ("roughly x forward, z back; camera looks forward", "right angles.*z back"),
        ("roughly x forward, y right, z up; camera looks forward", "right-handed"),
        (AXES + "ahead", "forward, back, left, right or"),
        (AXES + "left, 20 deg right", "forward, back, left, right or"),
        (AXES + "100 deg down", "10 deg down"),
        (AXES + "90 deg clockwise", "turned 90 deg clockwise"),
        (AXES + "turned 90 deg left", "turned 90 deg clockwise"),
        (AXES + "forward; camera looks back", "is repeated.*camera looks back"),
        (AXES + "forward; camera 3 feet up of lidar", "camera 0.3 m forward, 1.2 m down of lidar"),
        (AXES + "forward; camera 1 m up, 1 m down of lidar", "camera 0.3 m forward"),
        (AXES + "forward; camera 500 m up of lidar", "too far away.*at most 100 m"),
        (AXES + "forward; ", "two axes|is repeated"),
    ],
)
def test_what_cannot_be_read_is_shown_beside_what_can(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        rough_start(text, "--start")
