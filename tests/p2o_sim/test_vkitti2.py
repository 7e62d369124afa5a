"""Virtual KITTI 2: the official layout, its units and its classes, and the LiDAR that is made from its depth."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from p2o import Dataset, InputError, se3
from p2o_sim.vkitti2 import METHOD, VirtualKitti2Options, build
from pydantic import ValidationError

from tests.p2o_sim.flat_scene import BOARD_M, CAMERA, ROAD_M, depth_m

BASELINE_M = 0.532725
# world-to-camera of a camera somewhere in its scene; the right one stands 0.53 m to the right of it.
LEFT = se3.exp(np.array([0.1, -0.4, 0.05, 3.0, -1.0, 20.0]))
RIGHT = se3.make(translation=(-BASELINE_M, 0.0, 0.0)) @ LEFT


def stored(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels if pixels.ndim == 2 else pixels[:, :, ::-1])


def table(header: str, rows: list[list[float]]) -> str:
    return header + "\n" + "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in rows)


def official(
    root: Path, scene: str = "Scene01", variation: str = "clone", frames: int = 2, image_suffix: str = "jpg"
) -> Path:
    """Write frames in the official layout: both cameras, depth in centimetres, classes by colour."""
    base = root / scene / variation
    depth = depth_m(sky=True)
    centimetres = np.where(np.isinf(depth), 65535, np.rint(100 * depth)).astype(np.uint16)
    classes = np.full((CAMERA.height, CAMERA.width, 3), (140, 140, 140), np.uint8)
    classes[:20, :100], classes[:20, 100:200], classes[20:40, :100] = (0, 199, 0), (90, 240, 0), (210, 0, 200)
    for frame in range(frames):
        for camera in (0, 1):
            rgb = np.full((CAMERA.height, CAMERA.width, 3), (200, 100 * camera, 10 * frame), np.uint8)
            stored(base / f"frames/rgb/Camera_{camera}/rgb_{frame:05d}.{image_suffix}", rgb)
            stored(base / f"frames/depth/Camera_{camera}/depth_{frame:05d}.png", centimetres)
            stored(base / f"frames/classSegmentation/Camera_{camera}/classgt_{frame:05d}.png", classes)
    pairs = [(frame, camera) for frame in range(frames) for camera in (0, 1)]
    rows = [[*p, *CAMERA.params] for p in pairs]
    (base / "intrinsic.txt").write_text(table("frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]", rows))
    rows = [[*p, *(LEFT, RIGHT)[p[1]].ravel()] for p in pairs]
    (base / "extrinsic.txt").write_text(table("frame cameraID r1,1 ...", rows))
    return base


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames in the official layout, which no test changes."""
    root = tmp_path_factory.mktemp("vkitti2")
    official(root)
    return root


def opened(root: Path, **options: Any) -> Any:
    return build(VirtualKitti2Options(root=root, **options))


def test_the_official_layout_is_read_with_its_names(tmp_path: Path) -> None:
    official(tmp_path)
    official(tmp_path, "Scene20", frames=1)
    official(tmp_path, "Scene02", "fog", frames=3)
    dataset = opened(tmp_path)
    assert isinstance(dataset, Dataset)
    assert list(dataset.names) == ["Scene01/clone/00000", "Scene01/clone/00001", "Scene20/clone/00000"]
    assert list(opened(tmp_path, scenes=[20]).names) == ["Scene20/clone/00000"]
    assert len(opened(tmp_path, variation="fog")) == 3
    assert list(opened(tmp_path / "Scene20").names) == ["Scene20/clone/00000"]


def test_a_frame_has_depth_in_centimetres_its_right_picture_and_foliage_masked(tree: Path) -> None:
    """Depth is along the axis and its largest value is sky; camera 1 has no camera to its right."""
    image = opened(tree)[1].image
    np.testing.assert_array_equal(np.isinf(image.depth_m), np.isinf(depth_m(sky=True)))
    known = np.isfinite(image.depth_m)
    np.testing.assert_allclose(image.depth_m[known], depth_m(sky=True)[known], atol=0.005 + 1e-9)
    assert image.camera == CAMERA
    assert image.baseline_m == pytest.approx(BASELINE_M, abs=1e-6)
    assert np.abs(image.rgb.mean(axis=(0, 1)) - (200, 0, 10)).max() < 3
    assert np.abs(image.right.mean(axis=(0, 1)) - (200, 100, 10)).max() < 3
    expected = np.zeros((CAMERA.height, CAMERA.width), bool)
    expected[:20, :200] = True
    np.testing.assert_array_equal(image.masked, expected)
    image = opened(tree, camera=1, mask_foliage=False)[0].image
    assert (image.right, image.masked) == (None, None)
    assert np.abs(image.rgb.mean(axis=(0, 1)) - (200, 100, 0)).max() < 3


@pytest.mark.parametrize(("mount", "place"), [("kitti", (0.27, 0.06, -0.08)), ("camera", (0.0, 0.0, 0.0))])
def test_the_sweep_lies_on_the_surfaces_at_the_documented_mounting(
    tree: Path, mount: str, place: tuple[float, ...]
) -> None:
    frame = opened(tree, mount=mount, noise_m=0.0)[0]
    lidar_from_camera = se3.inverse(frame.camera_from_lidar)
    np.testing.assert_allclose(lidar_from_camera[:3, 3], place, atol=1e-12)
    np.testing.assert_allclose(lidar_from_camera[:3, 2], [1, 0, 0], atol=1e-12)
    xyz = se3.apply(frame.camera_from_lidar, frame.cloud.xyz)
    road, board = np.abs(xyz[:, 1] - ROAD_M), np.abs(xyz[:, 2] - BOARD_M)
    # Rounding of the depth to 1 cm moves the road by up to 0.5 cm / z * height.
    assert np.mean(np.minimum(road, board) < 0.01) > 0.97
    assert (board < 0.01).sum() > 500
    assert METHOD.gives == {"depth", "truth", "rings"}


def test_the_lidar_and_its_noise_are_those_of_the_options_and_each_frame_draws_its_own(tree: Path) -> None:
    exact, noisy, again, other_seed = (
        opened(tree, noise_m=noise, seed=seed, mount="camera", lidar="hdl-32e")[0].cloud
        for noise, seed in ((0.0, 0), (0.1, 0), (0.1, 0), (0.1, 1))
    )
    assert len(np.unique(exact.ring)) in range(10, 33)
    off = np.linalg.norm(noisy.xyz, axis=1) - np.linalg.norm(exact.xyz, axis=1)
    assert off.std() == pytest.approx(0.1, rel=0.05)
    other_frame = opened(tree, noise_m=0.1, mount="camera", lidar="hdl-32e")[1].cloud
    assert again.xyz.tobytes() == noisy.xyz.tobytes()
    assert len({cloud.xyz.tobytes() for cloud in (noisy, other_seed, other_frame)}) == 3


def test_frames_without_depth_are_left_out_and_without_class_segmentation_nothing_is_masked(tmp_path: Path) -> None:
    base = official(tmp_path)
    (base / "frames/depth/Camera_0/depth_00001.png").unlink()
    (base / "frames/classSegmentation/Camera_0/classgt_00000.png").unlink()
    dataset = opened(tmp_path)
    assert list(dataset.names) == ["Scene01/clone/00000"]
    assert "depth_00001.png is missing" in dataset.skipped["Scene01/clone/00001"]
    frame = dataset[0]
    assert frame.image.masked is None
    assert frame.warnings == ("foliage is not masked: no class segmentation",)


def test_a_png_wins_over_a_jpeg(tmp_path: Path) -> None:
    base = official(tmp_path)
    lossless = np.full((CAMERA.height, CAMERA.width, 3), (1, 2, 3), np.uint8)
    stored(base / "frames/rgb/Camera_0/rgb_00000.png", lossless)
    assert len(opened(tmp_path)) == 2
    np.testing.assert_array_equal(opened(tmp_path)[0].image.rgb, lossless)


def test_missing_scenes_and_folders_without_frames_are_refused(tmp_path: Path) -> None:
    official(tmp_path)
    with pytest.raises(InputError, match="Scene06 is missing"):
        opened(tmp_path, scenes=[1, 6])
    with pytest.raises(InputError, match="no Virtual KITTI 2 frames"):
        opened(tmp_path, variation="rain")
    with pytest.raises(InputError, match="no scene"):
        opened(tmp_path / "Scene01" / "clone")
    with pytest.raises(InputError, match="no such folder"):
        opened(tmp_path / "nowhere")


TURNED = se3.exp(np.array([0.0, 0.1, 0.0, -BASELINE_M, 0.0, 0.0])) @ LEFT


@pytest.mark.parametrize(
    ("name", "text", "error"),
    [
        ("extrinsic.txt", table("frame ...", [[0, 0, *LEFT.ravel()], [0, 1, *TURNED.ravel()]]), "not rectified"),
        (
            "extrinsic.txt",
            table("frame ...", [[0, 0, *RIGHT.ravel()], [0, 1, *LEFT.ravel()]]),
            r"extrinsic\.txt: camera 1 is not to the right of camera 0",
        ),
        ("intrinsic.txt", "frame cameraID\n0 0 1 2\n", "not a calibration file"),
        ("intrinsic.txt", "frame cameraID\n5 0 1 1 1 1\n", "frame 0 of camera 0 is not calibrated"),
        ("intrinsic.txt", "frame cameraID\n0 0 nan 1 1 1\n", "not calibrated"),
        ("intrinsic.txt", "frame cameraID\n0 0 x 1 1 1\n", "not a calibration file"),
        ("extrinsic.txt", "frame\n" + "".join(f"0 {c} " + "2 " * 16 + "\n" for c in (0, 1)), "last row"),
    ],
)
def test_broken_calibration_files_are_named(tmp_path: Path, name: str, text: str, error: str) -> None:
    base = official(tmp_path, frames=1)
    (base / name).write_text(text)
    with pytest.raises(InputError, match=error) as caught:
        opened(tmp_path)[0]
    assert name in str(caught.value)


def test_depth_that_is_not_16_bit_is_refused(tmp_path: Path) -> None:
    base = official(tmp_path, frames=1)
    stored(base / "frames/depth/Camera_0/depth_00000.png", np.full((CAMERA.height, CAMERA.width), 7, np.uint8))
    with pytest.raises(InputError, match="16 bit"):
        opened(tmp_path)[0]


@pytest.mark.parametrize("wrong", [{"camera": 2}, {"lidar": "mid-40"}, {"variation": "snow"}, {"noise_m": -1}])
def test_options_out_of_bounds_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        VirtualKitti2Options(**wrong)


def test_pictures_whose_names_hold_no_number_are_left_out_and_named(tmp_path: Path) -> None:
    base = official(tmp_path, frames=1)
    images = base / "frames/rgb/Camera_0"
    for name in ("rgb_²²²²².jpg", "rgb_7.jpg", "rgb_.png", "rgb_-0001.jpg"):
        (images / name).write_bytes((images / "rgb_00000.jpg").read_bytes())
    found = opened(tmp_path)
    assert found.names == ("Scene01/clone/00000",)
    assert len(found.skipped) == 4
    with pytest.raises(InputError, match=r"rgb_7\.jpg: the name of the file has no frame number"):
        found.frame("Scene01/clone/rgb_7.jpg")


def test_a_scene_whose_name_is_not_utf_8_is_read(tmp_path: Path) -> None:
    name = os.fsdecode(b"Scene\xff")
    official(tmp_path, frames=1)
    (tmp_path / "Scene01").rename(tmp_path / name)  # OpenCV cannot write below it
    assert opened(tmp_path)[0].name == f"{name}/clone/00000"


def test_a_camera_that_no_beam_meets_is_refused_by_the_folder(tmp_path: Path) -> None:
    base = official(tmp_path, frames=1)
    fx, _fy, cx, cy = CAMERA.params
    rows = [[0, camera, fx, 1e6, cx, 50 * cy] for camera in (0, 1)]
    (base / "intrinsic.txt").write_text(table("frame ...", rows))
    with pytest.raises(InputError, match=r"Scene01/clone: the depth map gives no LiDAR returns"):
        opened(tmp_path, noise_m=0, mount="camera", lidar="vlp-16")[0]
