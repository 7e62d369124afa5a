"""The fleet of `python benchmarks/fleet.py real`: pieces of drives, and drives after a slip of known size."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import p2o
import pytest
from fleet_drives import BEFORE, DRIVES, FRAMES, consecutive, spread_out, vehicles
from p2o import se3
from p2o.confidence.audit import AXES
from p2o.geometry.pose_error import pose_error
from p2o_testing import stage
from slipped_drives import slipped

from tests.pages import ROOT


@pytest.mark.parametrize("axis", range(6))
def test_a_drive_after_a_slip_has_an_extrinsic_with_exactly_this_error(axis: int) -> None:
    frame = stage.frame()
    size = 0.5 if axis < 3 else -0.05
    after = slipped(frame, axis, size)
    assert frame.camera_from_lidar is not None
    assert after.camera_from_lidar == pytest.approx(frame.camera_from_lidar, abs=1e-12)
    # The points are where they were in the camera, seen from a LiDAR at its new place.
    in_camera = se3.apply(frame.camera_from_lidar, frame.cloud.xyz)
    new = frame.camera_from_lidar @ _rigid(after.cloud.xyz, frame.cloud.xyz)
    assert se3.apply(new, after.cloud.xyz) == pytest.approx(in_camera, abs=1e-9)
    name, unit = AXES[axis]
    error = pose_error(frame.camera_from_lidar, new)
    assert error.per_axis[f"{name}_{unit}"] == pytest.approx(size, rel=1e-3)
    assert error.rotation_deg == pytest.approx(abs(size) if axis < 3 else 0.0, abs=1e-6)


def _rigid(source: p2o.Float, target: p2o.Float) -> p2o.Float:
    """Return the transform (4, 4) of points (N, 3) to others."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    u, _, vt = np.linalg.svd(b.T @ a)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return se3.make(rotation, target.mean(axis=0) - rotation @ source.mean(axis=0))


def test_pieces_contain_every_frame_once() -> None:
    names = [f"{number:03d}" for number in range(70)]
    for pieces in (consecutive(names), spread_out(names)):
        assert sorted(name for piece in pieces for name in piece) == names
        assert min(map(len, pieces)) >= FRAMES


def test_the_fleet_has_more_than_fifty_drives_and_no_frame_of_the_test_split() -> None:
    splits = json.loads((ROOT / "benchmarks/splits.json").read_text())
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
        assert vehicle.slip is None or (len(texts) >= DRIVES - 2 and set(frames.values()) == {1})
