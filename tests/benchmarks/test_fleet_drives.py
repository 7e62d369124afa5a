"""The fleet of `python benchmarks/fleet.py real`: pieces of drives, and drives after a slip of known size."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from fleet_drives import BEFORE, DRIVES, vehicles
from p2o import se3
from p2o.confidence.audit import AXES
from p2o.confidence.explanation import corrected
from p2o.frames.image import Image
from p2o.geometry.camera import Camera
from p2o.geometry.pose_error import pose_error
from p2o_testing import stage
from slipped_drives import slipped

from tests.pages import ROOT


@pytest.mark.parametrize("axis", range(6))
def test_a_drive_after_a_slip_has_an_extrinsic_with_exactly_this_error(axis: int) -> None:
    frame = stage.frame()
    frame = replace(frame, image=Image(_waves(frame.camera), frame.camera))
    size = 0.5 if axis < 3 else -0.05
    after = slipped(frame, axis, size)
    assert frame.camera_from_lidar is not None
    assert after.camera_from_lidar == pytest.approx(frame.camera_from_lidar, abs=1e-12)
    moved = after.cloud.xyz - frame.cloud.xyz
    np.testing.assert_allclose(
        moved, np.broadcast_to(moved[0], moved.shape), rtol=0, atol=1e-9, err_msg="the points keep their rings"
    )
    new = corrected(frame.camera_from_lidar, axis, np.array([size]))[0]
    name, unit = AXES[axis]
    error = pose_error(frame.camera_from_lidar, new)
    assert error.per_axis[f"{name}_{unit}"] == pytest.approx(size, rel=1e-3)
    assert error.rotation_deg == pytest.approx(abs(size) if axis < 3 else 0.0, abs=1e-6)
    # Where the corrected extrinsic projects the points of after, the images show what they showed of these points.
    camera = frame.camera
    turn = new[:3, :3] @ frame.camera_from_lidar[:3, :3].T
    before_in_camera = se3.apply(frame.camera_from_lidar, frame.cloud.xyz)
    np.testing.assert_allclose(se3.apply(new, after.cloud.xyz), before_in_camera @ turn.T, rtol=0, atol=1e-9)
    uv, uv_after = camera.project(before_in_camera), camera.project(se3.apply(new, after.cloud.xyz))
    seen = camera.in_image(uv, -12.0) & camera.in_image(uv_after, -12.0)
    assert seen.sum() > 50
    shown = _sampled(frame.image.rgb, uv[seen])
    np.testing.assert_allclose(_sampled(after.image.rgb, uv_after[seen]), shown, rtol=0, atol=6)


def _waves(camera: Camera) -> np.ndarray:
    """Return an image (H, W, 3) whose levels change by up to 26 per pixel, to the right, down and diagonally."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.asarray(127 + 100 * np.sin(np.stack([u, v, u + v], axis=-1) * 2 * np.pi / 24), np.uint8)


def _sampled(rgb: np.ndarray, uv: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.remap(rgb, *np.asarray(uv, np.float32).T, cv2.INTER_LINEAR), float)


def test_the_fleet_has_more_than_fifty_drives_and_no_frame_of_the_test_split() -> None:
    splits = json.loads((ROOT / "baselines/p2o_baselines/suites/splits.json").read_text())
    fleet = vehicles(Path("data"), splits, Path("simulated"))
    right = [vehicle for vehicle in fleet if vehicle.slip is None]
    assert sum(len(vehicle.drives) for vehicle in right) > 50
    used = [set(piece.frames.split(",")) for vehicle in fleet for piece in vehicle.drives]
    assert not any(frames & {*splits["test"], *splits["test-drives"]} for frames in used)
    for vehicle in fleet:
        texts = [row[4] for row in vehicle.rows()]
        changed = [text.startswith("slipped:") for text in texts]
        assert changed == [vehicle.slip is not None and number >= BEFORE for number in range(len(texts))]
        frames = Counter(name for piece in vehicle.drives for name in piece.frames.split(","))
        most = 1 if vehicle.type == "kitti" else 2
        assert vehicle.slip is None or (len(texts) == DRIVES and max(frames.values()) <= most)
