"""The forward speed that a raw sweep and a depth map of one moment tell together."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from p2o import Frame, se3
from p2o_datasets.disparity_speed import forward_speed
from p2o_datasets.kitti_raw import KittiRawOptions
from p2o_datasets.kitti_raw import build as build_raw
from p2o_sim.synthetic import SyntheticOptions, build
from p2o_sim.write import kitti_raw as write_kitti_raw


@cache
def street(speed_m_s: float, deskew: bool = False) -> Frame:
    """Return a synthetic frame whose sweep is as a moving LiDAR measures it; frames cannot be changed.

    Its depth is that of the corrected returns, and unknown elsewhere, as in KITTI's disparity truth.
    """
    options = SyntheticOptions(place="street", seed=3, right=False, speed_m_s=speed_m_s, width_px=621, height_px=188)
    corrected = build(options)[0]
    xyz = se3.apply(corrected.camera_from_lidar, corrected.cloud.xyz)
    uv = corrected.camera.project(xyz)
    seen = corrected.camera.in_image(uv)
    u, v = np.rint(uv[seen]).astype(int).T
    depth = np.full((corrected.camera.height, corrected.camera.width), np.nan)
    depth[v, u] = xyz[seen, 2]
    frame = corrected if deskew else build(options.model_copy(update={"deskew": False}))[0]
    return replace(frame, image=replace(frame.image, depth_m=depth, masked=None))


def speed(frame: Frame) -> float | None:
    return forward_speed(frame.cloud, frame.image.depth_m, frame.camera, frame.camera_from_lidar)


@pytest.mark.parametrize("truth", [0.0, 6.0, 18.0])
def test_the_speed_of_the_car_is_found_in_raw_and_in_corrected_sweeps(truth: float) -> None:
    frame = street(truth)
    assert speed(frame) == pytest.approx(frame.twist[3], abs=0.5)
    if truth == 18.0:
        assert speed(street(truth, deskew=True)) == pytest.approx(speed(frame), abs=1e-2)


def test_dense_depth_too_little_depth_and_a_sweep_without_times_tell_nothing() -> None:
    frame = street(6.0)
    depth = frame.image.depth_m
    little = np.where(np.arange(depth.shape[1]) < 310, np.nan, depth)
    little[:, 320:] = np.nan
    for other in (np.full_like(depth, 20.0), np.full_like(depth, np.nan), little):
        assert speed(replace(frame, image=replace(frame.image, depth_m=other))) is None
    assert speed(replace(frame, cloud=replace(frame.cloud, time_s=None))) is None


def test_the_reader_takes_it_where_oxts_packets_are_missing_and_it_is_asked_to(tmp_path: Path) -> None:
    assert len(list(write_kitti_raw.write([street(18.0, deskew=True)], tmp_path))) == 1
    for packet in tmp_path.rglob("oxts/data/*.txt"):
        packet.unlink()
    raw, corrected = (
        build_raw(KittiRawOptions(root=tmp_path, speed_from_disparity=asked))[0] for asked in (False, True)
    )
    assert raw.twist is None
    assert raw.warnings
    assert corrected.twist[3] == pytest.approx(18.0, abs=0.7)
    assert np.abs(corrected.twist[[0, 1, 2, 4, 5]]).max() == 0
    assert not corrected.warnings
    truth = street(18.0, deskew=True).cloud.xyz

    def off(frame: Frame) -> float:
        return float(np.median(np.linalg.norm(frame.cloud.xyz - truth, axis=1)))

    assert off(corrected) < 0.1 * off(raw)


@pytest.mark.real
def test_on_real_frames_it_agrees_with_oxts(kitti_raw: Path) -> None:
    dataset = build_raw(KittiRawOptions(root=kitti_raw, deskew=False, image_delay_s=0.0))
    for number, within in ((10, 0.3), (59, 0.5)):
        frame = dataset[list(dataset.names).index(f"2011_09_26/0005/{number:010d}")]
        assert speed(frame) == pytest.approx(frame.twist[3], abs=within)
