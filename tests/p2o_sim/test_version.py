"""A change that alters frames of the simulator raises `p2o_sim.VERSION`: its frames are compared with stored ones.

    python -m tests.p2o_sim.test_version

writes the stored values again, after VERSION was raised.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import p2o_sim
import pytest
from p2o import Float, Frame
from p2o_sim.synthetic import SyntheticOptions, build

STORED = Path(__file__).with_name("frames.json")
SIZE: dict[str, Any] = {"width_px": 128, "height_px": 64, "right": False}
FRAMES: dict[str, dict[str, Any]] = {
    "street": {"place": "street", "lidar": "vlp-16"},
    "rain": {"place": "trees", "lidar": "os1-64", "weather": "rain", "camera": "opencv-distorted"},
    "room": {"place": "room", "lidar": "mid-360", "camera": "fisheye"},
    "board": {"place": "yard", "lidar": "vlp-16", "targets": "checkerboard"},
}
GREY, RANGE_M, POSE = 0.02, 2e-4, 1e-6
"""Tolerances: far below the effect of other noise, and above that of other last bits."""
MAX_DIFFERENT = 0.05
"""Share of values that may differ between processors: a ray may hit the other side of an edge."""


def summary(frame: Frame) -> dict[str, Float]:
    """Return mean grey values of blocks of 8 x 8 px, mean ranges by direction of the beams in m, and both poses."""
    height, width = frame.image.rgb.shape[:2]
    grey = frame.image.rgb.reshape(height // 8, 8, width // 8, 8, 3).mean(axis=(1, 3, 4))
    x, y, z = frame.cloud.xyz.T.astype(np.float64)
    ranges = np.sqrt(x**2 + y**2 + z**2)
    azimuth = np.floor((np.arctan2(y, x) / np.pi + 1) * 16).astype(int) % 32
    place = azimuth + 32 * (z > -0.05 * ranges)
    means = np.bincount(place, ranges, 64) / np.maximum(np.bincount(place, minlength=64), 1)
    assert frame.start is not None
    return {"grey": grey.ravel(), "range_m": means, "pose": np.ravel([frame.camera_from_lidar, frame.start])}


def rendered(name: str) -> Frame:
    frame: Frame = build(SyntheticOptions(**SIZE, **FRAMES[name]))[0]
    return frame


def different(known: dict[str, Any], frame: Frame) -> float:
    """Return the share of values of a frame that differ from the stored ones."""
    values = summary(frame)
    tolerances = {"grey": GREY, "range_m": RANGE_M, "pose": POSE}
    return float(np.mean(np.concatenate([abs(values[key] - known[key]) > tolerances[key] for key in values])))


@pytest.mark.parametrize("name", FRAMES)
def test_frames_are_those_of_the_version(name: str) -> None:
    stored = json.loads(STORED.read_text())
    hint = "if this is intended, raise p2o_sim.VERSION and run: python -m tests.p2o_sim.test_version"
    assert stored["version"] == p2o_sim.VERSION, hint
    share = different(stored["frames"][name], rendered(name))
    assert share <= MAX_DIFFERENT, (
        f"{share:.0%} of the values of frame '{name}' differ from version {p2o_sim.VERSION}: {hint}"
    )


@pytest.mark.parametrize("change", [{"noise_m": 0.021}, {"grain": 2.1, "blur_px": 0.55}, {"exposure_ev": 0.3}])
def test_a_small_change_is_noticed(change: dict[str, Any]) -> None:
    frame: Frame = build(SyntheticOptions(**{**SIZE, **FRAMES["street"], **change}))[0]
    assert different(json.loads(STORED.read_text())["frames"]["street"], frame) > MAX_DIFFERENT


if __name__ == "__main__":
    frames = {
        name: {key: np.round(values, 6).tolist() for key, values in summary(rendered(name)).items()} for name in FRAMES
    }
    STORED.write_text(json.dumps({"version": p2o_sim.VERSION, "frames": frames}) + "\n")
