from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from p2o import UnknownNameError, se3

from .kitti_files import HEIGHT, PROJECTIONS, R_RECT, VELO_TO_CAM, WIDTH, numbers, write_image, write_lines, write_sweep
from .opened import opened, refused


def calib(**changes: object) -> dict[str, object]:
    return {
        **{f"P{number}": numbers(projection) for number, projection in PROJECTIONS.items()},
        "R0_rect": numbers(R_RECT[:3, :3]),
        "Tr_velo_to_cam": numbers(VELO_TO_CAM[:3]),
        **changes,
    }


def write_frame(folder: Path, name: str, **changes: object) -> np.ndarray:
    write_lines(folder / f"calib/{name}.txt", calib(**changes))
    write_sweep(folder / f"velodyne/{name}.bin")
    return write_image(folder / f"image_2/{name}.png", seed=int(name))


dataset = partial(opened, "kitti-object")


def test_every_frame_has_its_own_calibration(tmp_path: Path) -> None:
    write_frame(tmp_path, "000000")
    right = write_image(tmp_path / "image_3/000000.png", seed=9)
    other = PROJECTIONS[2].copy()
    other[0, 0] = other[1, 1] = 44.0
    pixels = write_frame(tmp_path, "000001", P2=numbers(other))
    first, second = dataset(tmp_path)
    assert (first.camera.params[0], second.camera.params[0]) == (50, 44)
    assert np.array_equal(second.image.rgb, pixels)
    assert np.array_equal(first.image.right, right)
    assert (first.image.baseline_m, second.image.right) == (pytest.approx(0.54), None)
    assert dataset(tmp_path, right=False)[0].image.right is None
    offset = np.linalg.solve(other[:, :3], other[:, 3])
    assert np.allclose(second.camera_from_lidar, se3.make(translation=offset) @ R_RECT @ VELO_TO_CAM, atol=1e-11)
    assert second.cloud.ring.max() == 63
    # From the moment of the picture, 4 ms after straight ahead.
    assert np.ptp(second.cloud.time_s) == pytest.approx(0.1, abs=2e-3)
    assert second.cloud.time_s.min() == pytest.approx(-0.054, abs=1e-3)
    raised = dataset(tmp_path, pykitti_compat=True, elevation_fix_deg=0.2)[0]
    assert np.allclose(raised.camera_from_lidar[2, 3], first.camera_from_lidar[2, 3] - 0.003, atol=1e-11)
    assert (raised.cloud.xyz[:, 2] - first.cloud.xyz[:, 2]).mean() == pytest.approx(10 * np.radians(0.2), rel=0.01)


def test_frames_may_have_any_names_but_hidden_files_are_none(tmp_path: Path) -> None:
    write_frame(tmp_path / "training", "000000")
    for name in ("left-²", "._000000"):
        write_lines(tmp_path / f"training/calib/{name}.txt", calib())
        write_sweep(tmp_path / f"training/velodyne/{name}.bin")
        write_image(tmp_path / f"training/image_2/{name}.png")
    found = dataset(tmp_path)
    assert found.names == dataset(tmp_path / "training").names == ("000000", "left-²")
    assert found[1].name == "left-²"


def test_missing_files_and_keys_and_wrong_cameras_are_named(tmp_path: Path) -> None:
    with refused(r"no KITTI object frames; expected frames with image_2/ID\.png"):
        dataset(tmp_path)
    write_frame(tmp_path, "000000")
    write_image(tmp_path / "image_2/000001.png")
    found = dataset(tmp_path)
    assert found.names == ("000000",)
    with refused(r"velodyne/000001\.bin is missing"):
        found.frame("000001")
    for size in ((20, 32), (WIDTH // 2, HEIGHT // 2), (2 * WIDTH, 2 * HEIGHT)):
        write_image(tmp_path / "image_2/000000.png", size=size)
        with refused(r"000000\.png: the image size does not fit the camera"):
            found[0]
    write_frame(tmp_path, "000000", P3=numbers(PROJECTIONS[2] + [[0, 0, 0, 9.0], [0] * 4, [0] * 4]))
    write_image(tmp_path / "image_3/000000.png")
    with refused("the right camera is not to the right of the left one"):
        found[0]
    lines = calib()
    del lines["R0_rect"]
    write_lines(tmp_path / "calib/000000.txt", lines)
    with pytest.raises(UnknownNameError, match=r"calib/000000\.txt: unknown key 'R0_rect'"):
        found[0]
    (tmp_path / "calib/000000.txt").unlink()
    with refused(r"calib/000000\.txt: the calibration file is missing"):
        found[0]
