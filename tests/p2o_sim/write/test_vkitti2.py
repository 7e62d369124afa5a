"""Frames in the layout of Virtual KITTI 2: depth in centimetres, classes by colour."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import PIL.Image
from p2o import Camera, Cloud, Frame, Image
from p2o_sim.write.vkitti2 import write

CAMERA = Camera.pinhole(30.0, 31.0, 20.0, 8.0, 40, 16)


def frame(depth_m: np.ndarray | None) -> Frame:
    rgb = np.random.default_rng(0).integers(0, 256, (16, 40, 3), dtype=np.uint8)
    masked = np.zeros((16, 40), np.bool_)
    masked[3, 4] = True
    return Frame("a", Image(rgb, CAMERA, depth_m=depth_m, masked=masked), Cloud(np.ones((1, 3))))


def sloped() -> np.ndarray:
    """Return depth from 1 m to 60 m, with an unknown pixel, one of sky, one too far and one too near."""
    depth = np.linspace(1.0, 60.0, 640).reshape(16, 40)
    depth[0, :4] = np.nan, np.inf, 900.0, 1e-4
    return depth


def test_depth_is_stored_in_centimetres_with_codes_for_unknown_and_sky(tmp_path: Path) -> None:
    assert list(write([frame(sloped())], tmp_path)) == ["Scene01/clone/00000"]
    stored = np.array(PIL.Image.open(tmp_path / "Scene01/clone/frames/depth/Camera_0/depth_00000.png"))
    assert stored[0, :4].tolist() == [0, 65535, 65535, 1]
    np.testing.assert_allclose(stored[1:], 100 * sloped()[1:], atol=0.5)
