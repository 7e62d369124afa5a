"""Frames of other rigs that are made of frames of one: pictures, points and truths change alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import p2o
import pytest
import regressors
from p2o import se3
from p2o.arrays import Float


def painted() -> p2o.Frame:
    """Return a frame whose picture and reflectance are one smooth function of the direction of sight."""
    camera = p2o.Camera.pinhole(300.0, 300.0, 249.5, 74.5, 500, 150)
    v, u = np.indices((150, 500))
    rays = camera.rays(np.stack([u, v], axis=-1).astype(np.float64))
    rgb = np.repeat(np.rint(255 * paint(rays))[..., None], 3, axis=2).astype(np.uint8)
    rng = np.random.default_rng(0)
    xyz = np.column_stack([rng.uniform(-1.2, 1.2, 5000), rng.uniform(-0.5, 0.5, 5000), np.ones(5000)]) * 20
    pose = se3.exp(np.array([1.0, -1.2, 0.4, 0.1, 0.2, -0.3]))
    cloud = p2o.Cloud(se3.apply(se3.inverse(pose), xyz), intensity=paint(xyz))
    return p2o.Frame("x", p2o.Image(rgb, camera), cloud, pose)


def paint(xyz: Float) -> Float:
    at = xyz[..., :2] / xyz[..., 2:]
    return np.asarray(0.5 + 0.25 * np.sin(4 * at[..., 0]) + 0.2 * np.cos(6 * at[..., 1]))


@pytest.mark.parametrize("how", ["turned", "reexpressed", "cut"])
def test_points_keep_their_place_in_the_picture(how: str) -> None:
    made = getattr(regressors, how)
    frame = painted()
    rng = np.random.default_rng(1)
    other = made(frame) if how == "cut" else made(frame, rng)
    there = se3.apply(other.camera_from_lidar, other.cloud.xyz)
    uv = other.camera.project(there)
    u, v = np.rint(uv[other.camera.in_image(uv, -2.0)]).astype(int).T
    known = np.ones(len(u), np.bool_) if other.image.masked is None else ~other.image.masked[v, u]
    seen = other.cloud.intensity[other.camera.in_image(uv, -2.0)][known]
    assert len(seen) > 600
    # Not at the border of what is known, which the picture blends with black.
    off = np.abs(other.image.rgb[v[known], u[known], 0] / 255 - seen)
    assert np.quantile(off, 0.98) < 0.03


def test_a_turned_camera_is_another_rig() -> None:
    frame = painted()
    turned = regressors.turned(frame, np.random.default_rng(1))
    assert 0.5 < se3.angle_deg(turned.camera_from_lidar @ se3.inverse(frame.camera_from_lidar)) < 5.2
    assert turned.camera == frame.camera


def test_errors_are_told_in_the_cameras_axes() -> None:
    truth = painted().camera_from_lidar
    assert regressors.axes(truth, truth) == pytest.approx([0] * 6)
    off = se3.make(se3.exp(np.r_[np.radians([1.0, 2.0, -3.0]), 0, 0, 0])[:3, :3], np.zeros(3)) @ truth
    assert regressors.axes(off, truth)[:3] == pytest.approx([1.0, 2.0, -3.0])


def test_another_picture_leaves_the_sweep() -> None:
    frame = painted()
    grey = regressors.with_picture(frame, None)
    assert np.ptp(grey.image.rgb) == 0
    assert grey.cloud is frame.cloud
    other = regressors.with_picture(frame, replace(frame.image, rgb=255 - frame.image.rgb).rgb[:100])
    assert (other.image.rgb[:100] == 255 - frame.image.rgb[:100]).all()
