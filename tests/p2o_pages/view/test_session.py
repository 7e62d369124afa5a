"""State of `p2o view` without a page: known poses, the current pose, and the file of the initial guess."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from p2o import Frame, Image, InputError, se3
from p2o.draw.sweep_image import draw_sweep, sweep_colours
from p2o_pages.view.nudge import Nudge
from p2o_pages.view.session import KnownPose, Opened, ViewSession
from p2o_pages.view.shown_frame import LONGEST_PX, ShownFrame
from p2o_testing import stage

FRAME = stage.frame()
START = stage.camera_from_lidar()
RESULT = Nudge("LiDAR", (0.0, 0.0, 1.0), (0.1, 0.0, 0.0)).applied(START)


def opened(number: int) -> Opened:
    if number == 2:
        raise InputError("the image is cut short")
    result = KnownPose(RESULT, "trusted") if number == 0 else None
    return Opened(replace(FRAME, name=f"frame {number}"), KnownPose(START, "the start of the data"), result)


def calibrated(frame: Frame, start: np.ndarray) -> KnownPose:
    return KnownPose(START, f"{frame.name} from {'the result' if start is RESULT else 'elsewhere'}")


def session(out: Path, **words: int) -> ViewSession:
    return ViewSession(["a", "b", "c"], opened, calibrated, out / "start.yaml", **words)


def test_it_begins_at_the_result_where_there_is_one_else_at_the_start(tmp_path: Path) -> None:
    viewed = session(tmp_path)
    assert viewed.pose is RESULT
    viewed.begin_at("start")
    assert viewed.pose is START
    viewed.begin_at("result")
    assert viewed.pose is RESULT
    without = ViewSession(["b"], lambda _: opened(1), calibrated, tmp_path / "start.yaml")
    assert without.pose is START
    without.begin_at("result")
    assert without.pose is START


def test_the_overlay_is_the_whole_sweep_at_the_pose_that_the_sliders_say(tmp_path: Path) -> None:
    viewed = session(tmp_path, most_points=100)
    viewed.begin_at("start")
    viewed.nudge = Nudge("camera", (0.0, 1.5, 0.0), (0.0, 0.0, 0.2))
    pose = viewed.nudge.applied(START)
    assert np.array_equal(viewed.pose, pose)
    expected = draw_sweep(FRAME.image.rgb, FRAME.cloud, FRAME.camera, pose)
    assert np.array_equal(viewed.overlay(), expected)
    assert not np.array_equal(viewed.overlay("reflectance"), expected)
    viewed.begin_at("start")
    assert np.array_equal(viewed.overlay(), draw_sweep(FRAME.image.rgb, FRAME.cloud, FRAME.camera, START))


def test_the_pose_stays_when_other_axes_are_chosen(tmp_path: Path) -> None:
    viewed = session(tmp_path)
    viewed.nudge = Nudge("camera", (0.0, 1.5, 0.0), (0.0, 0.0, 0.2))
    pose = viewed.pose
    viewed.settle("LiDAR")
    assert np.array_equal(viewed.pose, pose)
    viewed.nudge = Nudge("LiDAR", (0.0, 0.0, 1.0))
    assert np.allclose(viewed.pose, Nudge("LiDAR", (0.0, 0.0, 1.0)).applied(pose))


def test_the_pose_stays_when_another_frame_is_looked_at_and_a_bad_one_changes_nothing(tmp_path: Path) -> None:
    viewed = session(tmp_path)
    viewed.nudge = Nudge("camera", (1.0, 0.0, 0.0))
    pose = viewed.pose
    viewed.look_at(1)
    assert viewed.shown.name == "frame 1"
    assert np.array_equal(viewed.pose, pose)
    assert viewed.result is None
    with pytest.raises(InputError, match="cut short"):
        viewed.look_at(2)
    assert (viewed.number, viewed.shown.name) == (1, "frame 1")


def test_it_says_how_far_the_pose_is_from_start_and_result(tmp_path: Path) -> None:
    viewed = session(tmp_path, most_points=1000)
    viewed.begin_at("start")
    viewed.nudge = Nudge("LiDAR", (0.0, 0.0, 2.0), (0.0, 0.0, 0.0))
    points, start, result = viewed.lines()
    seen = int(FRAME.camera.in_image(FRAME.camera.project(se3.apply(viewed.pose, FRAME.cloud.xyz))).sum())
    assert points == f"{seen} of {len(FRAME.cloud)} points of the sweep in the image; 1000 are shown in 3-D"
    assert start == "2.00 deg and 0.0 cm from the start (the start of the data)"
    assert result == "1.00 deg and 10.0 cm from the result (trusted)"


def test_a_calibration_from_here_is_the_result_of_its_frame_alone(tmp_path: Path) -> None:
    viewed = session(tmp_path)
    assert viewed.calibrate() == "frame 0 from the result"
    assert viewed.result is not None
    assert viewed.result.camera_from_lidar is START
    viewed.look_at(1)
    assert viewed.result is None
    viewed.look_at(0)
    assert viewed.result is not None
    assert viewed.result.description == "frame 0 from the result"


@pytest.mark.parametrize("name", ["start", "start.yaml#a", "a?b=.yaml"])
def test_a_file_that_start_would_not_take_for_one_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--start rejects"):
        ViewSession(["a"], opened, calibrated, str(tmp_path / name))
    with pytest.raises(InputError, match="folder of the start is missing"):
        ViewSession(["a"], opened, calibrated, tmp_path / "none" / "start.yaml")


# ---- what is shown


def test_a_large_picture_is_made_smaller_and_shows_the_same_places() -> None:
    factor = 6
    camera = FRAME.camera.resized(factor * FRAME.camera.width, factor * FRAME.camera.height)
    rgb = np.repeat(np.repeat(FRAME.image.rgb, factor, 0), factor, 1)
    large = Frame("large", Image(rgb, camera), FRAME.cloud, camera_from_lidar=START)
    shown = ShownFrame.of(large)
    assert max(shown.rgb.shape) <= LONGEST_PX < max(rgb.shape)
    assert shown.rgb.shape[:2] == (shown.camera.height, shown.camera.width)
    assert shown.overlay(START).shape == shown.rgb.shape
    xyz = se3.apply(START, FRAME.cloud.xyz)
    whole, small = camera.project(xyz), shown.camera.project(xyz)
    seen = camera.in_image(whole)
    assert np.allclose((whole[seen] + 0.5) * shown.camera.width / camera.width, small[seen] + 0.5, atol=1)


def test_the_cloud_is_coloured_by_range_reflectance_or_the_image_at_a_pose() -> None:
    shown = ShownFrame.of(FRAME, 2000)
    assert shown.colourings == ("range", "reflectance", "image")
    assert np.array_equal(shown.colours("range", START), sweep_colours(shown.thinned))
    distance = np.linalg.norm(shown.thinned.xyz, axis=1)
    near, far = shown.colours("range", START)[[distance.argmin(), distance.argmax()]].astype(int)
    assert near[0] > near[2], "red is near"
    assert far[2] > far[0], "blue is far"
    assert not np.array_equal(shown.colours("image", START), shown.colours("image", RESULT))
    dumb = ShownFrame.of(replace(FRAME, cloud=replace(FRAME.cloud, intensity=None)))
    assert dumb.colourings == ("range", "image")
    assert np.array_equal(dumb.overlay(START, "reflectance"), dumb.overlay(START))
    with pytest.raises(InputError, match="no reflectance"):
        sweep_colours(dumb.cloud, "reflectance")
