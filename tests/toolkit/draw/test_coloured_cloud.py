"""The coloured cloud: the pixel's colour where the image shows the point, grey elsewhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import Camera, Cloud, InputError, se3
from p2o.draw.coloured_cloud import GREY, colours_of, write_coloured_cloud
from p2o_datasets.cloud_file import read_cloud

CAMERA = Camera.pinhole(100.0, 100.0, 100.0, 50.0, 200, 100)
LEFT_RED = np.zeros((100, 200, 3), np.uint8)
LEFT_RED[:, :100, 0] = 200
LEFT_RED[:, 100:, 2] = 200


def test_points_take_the_colour_of_their_pixel_at_the_pose() -> None:
    cloud = Cloud(np.array([[-2.0, 0, 10], [2.0, 0, 10], [50.0, 0, 10], [0.0, 0, -10]]))
    colours, seen = colours_of(LEFT_RED, cloud, CAMERA, np.eye(4))
    np.testing.assert_array_equal(colours, [[200, 0, 0], [0, 0, 200], GREY, GREY])
    assert seen.tolist() == [True, True, False, False]
    colours, _ = colours_of(LEFT_RED, cloud.select(np.array([0])), CAMERA, se3.make(translation=[4, 0, 0]))
    np.testing.assert_array_equal(colours, [[0, 0, 200]])


def test_what_a_nearer_wall_hides_is_grey() -> None:
    u = np.linspace(-2, 2, 81)
    wall = np.stack(np.broadcast_arrays(u[:, None], np.linspace(-1, 1, 41), 5.0), -1).reshape(-1, 3)
    behind = np.array([[0.0, 0.0, 20.0]])
    colours, seen = colours_of(LEFT_RED, Cloud(np.vstack([behind, wall])), CAMERA, np.eye(4))
    assert tuple(colours[0]) == GREY
    assert not seen[0]
    assert seen[1:].all()


def test_the_file_is_a_sweep_that_is_read_again(tmp_path: Path) -> None:
    cloud = Cloud(np.array([[-2.0, 0, 10], [2.0, 0.5, 10]]), intensity=np.array([0.25, 0.5]))
    path = tmp_path / "cloud.ply"
    write_coloured_cloud(path, LEFT_RED, cloud, CAMERA, np.eye(4))
    again, _ = read_cloud(path)
    np.testing.assert_allclose(again.xyz, cloud.xyz)
    np.testing.assert_allclose(again.intensity, cloud.intensity)
    assert b"property uchar red" in path.read_bytes()
    with pytest.raises(InputError, match="the image"):
        write_coloured_cloud(tmp_path / "a.ply", LEFT_RED[:50], Cloud(np.ones((1, 3))), CAMERA, np.eye(4))
