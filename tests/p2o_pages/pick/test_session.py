"""State of `p2o pick` without a page: pairs, their file, and the pose that they yield."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import InputError, pose_error
from p2o.problems.picked_pairs import PickedPairs, read_pairs, write_pairs
from p2o_pages.pick.session import PickSession
from p2o_testing import stage

from tests.p2o_pages.pick.rig import places

FRAME = stage.frame()
POSE = stage.camera_from_lidar()


@pytest.fixture
def session(tmp_path: Path) -> PickSession:
    return PickSession([FRAME, FRAME], ["stage", "second"], [0, 1], tmp_path / "pairs.yaml")


def pick(session: PickSession, uv: Any, place: Any) -> None:
    session.pick_pixel(np.asarray(uv))
    session.pick_point(*place)


def test_a_pixel_and_a_point_become_a_pair_in_either_order_and_the_file_has_it_at_once(session: PickSession) -> None:
    for number, (uv, place) in enumerate(places(session, 4)):
        if number % 2:
            pick(session, uv, place)
        else:
            session.pick_point(*place)
            assert session.ranges.pixel_of(session.picked_xyz) == place
            assert len(session.pairs) == number
            session.pick_pixel(uv)
        assert session.picked_uv is session.picked_xyz is None
        written = read_pairs(session.path)["stage"]
        np.testing.assert_allclose(written.uv[-1], uv, atol=0.006)
        np.testing.assert_array_equal(written.xyz, session.pairs.xyz)
        point = session.ranges.xyz[session.ranges.index[place[1], place[0]]]
        np.testing.assert_allclose(written.xyz[-1], point, atol=1e-6)
        assert session.ranges.pixel_of(written.xyz[-1]) == place
    for count in (3, 2, 1, 0):
        expected = np.delete(session.pairs.uv, 1 if count else 0, axis=0)
        session.delete(1 if count else 0)
        np.testing.assert_array_equal(session.pairs.uv, expected)
        assert len(read_pairs(session.path).get("stage", PickedPairs.none())) == count
    assert [path.name for path in session.path.parent.iterdir()] == ["pairs.yaml"]


def test_a_second_click_in_the_same_picture_replaces_the_first_and_another_frame_discards_it(
    session: PickSession,
) -> None:
    session.pick_pixel(np.array([5.0, 6.0]))
    session.pick_pixel(np.array([7.0, 8.0]))
    assert session.picked_uv is not None
    assert session.picked_uv.tolist() == [7, 8]
    session.look_at(1)
    assert session.picked_uv is None
    assert session.count == 0


def test_an_existing_file_is_continued_and_keeps_other_frames(tmp_path: Path) -> None:
    path = tmp_path / "pairs.json"
    pairs = PickedPairs(np.array([[5.0, 6]]), FRAME.cloud.xyz[[50]])
    write_pairs(path, {"stage": pairs, "elsewhere": pairs})
    session = PickSession([FRAME], ["stage"], [0], path)
    assert session.pairs.uv.tolist() == [[5, 6]]
    pick(session, *places(session, 1)[0])
    assert {name: len(each) for name, each in read_pairs(path).items()} == {"stage": 2, "elsewhere": 1}
    assert session.count == 2


def test_exact_pairs_of_two_frames_yield_the_pose_and_the_residual_of_each(session: PickSession) -> None:
    picks = places(session, 9)
    for number, (uv, place) in enumerate(picks):
        session.look_at(int(number > 6))
        shift = np.array([(60 if uv[0] < FRAME.camera.width / 2 else -60) * (number == 4), 0])
        pick(session, uv + shift, place)
        assert (session.solved is None) == (number < 3), "from four pairs on, of all frames"
        assert np.isnan(session.residuals().off_px).all() == (number < 3)
    with pytest.raises(InputError, match="no point near"):
        session.pick_point(99999999, 99999999)
    solved = session.solved
    assert solved is not None
    assert solved.camera_from_lidar is not None
    assert pose_error(solved.camera_from_lidar, POSE).rotation_deg < 0.02
    assert session.residuals().agrees.tolist() == [True] * 2
    session.look_at(0)
    residuals = session.residuals()
    assert residuals.agrees.tolist() == [number != 4 for number in range(7)]
    assert residuals.off_px[4] > 20
    assert np.delete(residuals.off_px, 4).max() < 0.1
    assert residuals.projected is not None
    step = np.abs(residuals.projected - session.pairs.uv).max(axis=1)
    np.testing.assert_allclose(step, [60 if number == 4 else 0 for number in range(7)], atol=0.2)
    session.delete(4)
    assert session.residuals().agrees.all()


def test_if_the_file_cannot_be_written_the_pairs_are_unchanged(session: PickSession) -> None:
    session.path.mkdir()
    (uv, place), *_ = places(session, 1)
    session.pick_pixel(uv)
    with pytest.raises(InputError, match="cannot write"):
        session.pick_point(*place)
    assert session.count == 0
    session.path.rmdir()
    session.pick_point(*place)
    assert session.count == 1, "a second click tries again"


def test_a_missing_folder_and_another_file_are_errors_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="folder of the pairs is missing"):
        PickSession([FRAME], ["stage"], [0], tmp_path / "none" / "pairs.yaml")
    (tmp_path / "pairs.yaml").write_text("name: something else\n")
    with pytest.raises(InputError, match="another form"):
        PickSession([FRAME], ["stage"], [0], tmp_path / "pairs.yaml")
