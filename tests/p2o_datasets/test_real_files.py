"""What the readers make of real files: no false alarms, and rows of sweeps by their right length."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from p2o.frames.image_file import read_rgb, read_uint16
from p2o_datasets.bin_file import KNOWN, columns_of
from p2o_datasets.cloud_file import read_cloud

pytestmark = pytest.mark.real


def test_every_sweep_of_kitti_is_told_by_its_values_to_have_four_columns(real_data: Path) -> None:
    paths = sorted(real_data.rglob("*.bin"))
    assert len(paths) > 10
    for path in paths[::3]:
        assert columns_of(np.fromfile(path, "<f4"), path) == KNOWN[4], path


@pytest.mark.parametrize("columns", [4, 5, 6])
@pytest.mark.parametrize("full_scale", [1, 255])
def test_sweeps_of_other_rigs_are_told_by_their_values(real_data: Path, columns: int, full_scale: int) -> None:
    """Each combination on every fifth sweep, each with another first one: most sweeps are in some combination."""
    rng = np.random.default_rng(0)
    paths = sorted(real_data.glob("rigs/*/*/cloud.npz"))
    for path in paths[(columns + (full_scale > 1)) % 5 :: 5]:
        cloud, _ = read_cloud(path)
        ring = rng.integers(0, 32, len(cloud)) if cloud.ring is None else cloud.ring
        intensity = rng.random(len(cloud)) if cloud.intensity is None else cloud.intensity / cloud.intensity.max()
        intensity = np.round(intensity * full_scale) if full_scale > 1 else intensity
        rows = np.column_stack([cloud.xyz, intensity, ring, np.linspace(0, 0.1, len(cloud))]).astype("<f4")[:, :columns]
        for dropped in range(3):
            for shown in (rows[dropped:], rng.permutation(rows[dropped:])):
                assert columns_of(shown.ravel(), path) == KNOWN[columns], (path, dropped)


@pytest.mark.system
def test_no_real_picture_is_called_damaged_and_all_have_the_pixels_that_opencv_finds(real_data: Path) -> None:
    paths = sorted(path for suffix in ("jpg", "png") for path in real_data.rglob(f"*.{suffix}"))
    assert len(paths) > 10
    for path in paths[::3]:
        wanted = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        if wanted.dtype == np.uint16:
            assert np.array_equal(np.nan_to_num(read_uint16(path, "disparity")), wanted / 256), path
        else:
            rgb, _ = read_rgb(path, (wanted.shape[1], wanted.shape[0]))
            assert np.array_equal(rgb, wanted[:, :, ::-1] if wanted.ndim == 3 else np.dstack([wanted] * 3)), path
