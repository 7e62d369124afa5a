"""Trihedra: the exact pose of any three planes without noise, what one view leaves open, and refusals in words."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Status, se3
from p2o.arrays import Float
from p2o_baselines.boards import adjustment
from p2o_baselines.bodies.box_in_picture import Line, flat_at
from p2o_baselines.bodies.box_in_sweep import Face
from p2o_baselines.bodies.bundle import adjusted
from p2o_baselines.bodies.trihedron import TrihedronInPicture, of_faces
from p2o_baselines.targets import gong
from p2o_baselines.targets.gong import Corner, edge_offsets, matched, rotation_of, translation_of

from tests.baselines.board_scene import AWAY, CAMERA, TRUTH, assert_near
from tests.baselines.body_scene import CUBOID, corner_on, frame


def any_corner(seed: int) -> tuple[Float, Float]:
    """Return a place (3,) m in the camera frame and edges (3, 3) from there, away from us, not square to each other."""
    rng = np.random.default_rng(seed)
    at = np.array([*rng.uniform(-0.8, 0.8, 2), rng.uniform(2.5, 4.5)])
    turn = rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(3) / 3 + rng.uniform(-0.3, 0.3, 3)
    side = np.cross(at, [0.0, 1.0, 0.0]) / np.linalg.norm(np.cross(at, [0.0, 1.0, 0.0]))
    away = at / np.linalg.norm(at)
    ways = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(away, side)
    ways = ways + rng.uniform(0.4, 1.0, (3, 1)) * away
    return at, ways / np.linalg.norm(ways, axis=1)[:, None]


def seen(at: Float, ways: Float, noise_px: float = 0.0, rng: np.random.Generator | None = None) -> TrihedronInPicture:
    flat = flat_at(CAMERA, CAMERA.project(at[None])[0])
    assert flat is not None
    lines = []
    for way in ways:
        first, last = flat.seen(np.array([at + 0.05 * way, at + 0.5 * way]))
        if rng is not None:
            across = np.array([[-1.0, 1.0]]) * (last - first)[::-1] / np.linalg.norm(last - first)
            first, last = np.array([first, last]) + across * rng.normal(0, noise_px, (2, 1))
        along = (last - first) / np.linalg.norm(last - first)
        half = np.linalg.norm(last - first) / 2
        sigma = max(noise_px, 0.01) / np.sqrt(2)
        lines.append(Line((first + last) / 2, along, sigma, sigma / half))
    a, b, c = lines
    return TrihedronInPicture(flat, (a, b, c), np.array([line.along for line in lines]))


def scanned(at: Float, ways: Float, noise_m: float = 0.0, rng: np.random.Generator | None = None) -> object:
    """Return the trihedron of 60 points on each face, faces numbered as the edges that they do not hold."""
    lidar_from_camera = se3.inverse(TRUTH)
    faces = []
    for k in range(3):
        one, two = ways[k - 1], ways[k - 2]
        share = np.random.default_rng(k).uniform(0.05, 0.6, (60, 2))
        xyz = se3.apply(lidar_from_camera, at + share[:, :1] * one + share[:, 1:] * two)
        normal = lidar_from_camera[:3, :3] @ np.cross(one, two)
        normal /= np.linalg.norm(normal)
        normal = -normal if normal @ xyz.mean(axis=0) > 0 else normal
        if rng is not None:
            xyz = xyz + rng.normal(0, noise_m, (60, 1)) * normal
            middle = xyz.mean(axis=0)
            fitted = np.linalg.svd(xyz - middle)[2][2]
            normal = fitted * np.sign(fitted @ normal)
        faces.append(Face(xyz, normal, float(normal @ xyz.mean(axis=0)), max(noise_m, 1e-3)))
    return of_faces((faces[0], faces[1], faces[2]))


def corners(count: int, noise_px: float = 0.0, noise_m: float = 0.0, seed: int = 0) -> list[Corner]:
    rng = np.random.default_rng(seed) if noise_px or noise_m else None
    out = []
    for number in range(count):
        at, ways = any_corner(100 * seed + number)
        out.append(Corner(number, seen(at, ways, noise_px, rng), scanned(at, ways, noise_m, rng)))  # type: ignore[arg-type]
    return out


@pytest.mark.parametrize("count", [2, 5])
def test_any_three_planes_give_the_pose_in_closed_form_without_noise_and_one_view_none(count: int) -> None:
    found = corners(count)
    assert adjusted(found[:1], TRUTH, [np.zeros(9)]).covariance is None
    rotation = rotation_of(found, AWAY[:3, :3])
    pose = se3.make(rotation, translation_of(found, rotation))
    assert_near(pose, np.degrees(1e-6), 1e-6)
    assert all(np.abs(edge_offsets(c.image, c.sweep, TRUTH)).max() < 1e-6 for c in found)


def test_the_start_tells_which_edge_is_which() -> None:
    found = corners(3)
    mixed = [gong._numbered(c.sweep, order) for c, order in zip(found, [(1, 2, 0), (2, 1, 0), (0, 2, 1)], strict=True)]
    told = matched(AWAY, [(c.frame, c.image) for c in found], {c.frame: [s] for c, s in zip(found, mixed, strict=True)})
    assert len(told) == 3
    for corner, truth in zip(told, found, strict=True):
        assert corner.sweep.ways == pytest.approx(truth.sweep.ways)
    # A start that is half a turn off has none of them.
    around = TRUTH @ se3.exp(np.array([0, 0, np.pi, 0, 0, 0]))
    assert matched(around, [(c.frame, c.image) for c in found], {c.frame: [c.sweep] for c in found}) == []


def test_noise_moves_a_pose_by_what_its_covariance_says(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adjustment, "RANGE_BIAS_M", 0.0)
    monkeypatch.setattr(adjustment, "CAMERA_PX", 0.0)
    size = []
    for seed in range(1, 13):
        found = corners(5, 0.3, 0.01, seed)
        fit = adjusted(found, TRUTH, [np.zeros(9)] * 5)
        step = se3.log(fit.camera_from_lidar @ se3.inverse(TRUTH))
        assert fit.covariance is not None
        size.append(step @ np.linalg.solve(fit.covariance, step))
    # A sum of six squares: 6 on average, to 1.0 over twelve draws; a scatter that widens makes it smaller.
    assert 2.0 < np.mean(size) < 9.0


def test_drawn_frames_are_calibrated_from_picture_and_sweep_and_one_is_refused() -> None:
    method = gong.METHOD.build(gong.METHOD.options())
    prepared = [method.prepare(frame(k, [pose], CUBOID)) for k, pose in enumerate(corner_on(3, 3))]
    result = method.solve(prepared, AWAY)
    assert result.status is Status.CONVERGED, result.reason
    # Planes of some hundred points off by 1.5 cm over half a metre tilt by 0.3 deg each.
    assert_near(result.camera_from_lidar, 0.6, 0.04)
    one = method.solve(prepared[:1], AWAY)
    assert one.status is Status.TOO_FEW_MATCHES
    assert "2 or more are needed" in one.reason
    assert np.array_equal(one.camera_from_lidar, AWAY)
    around = TRUTH @ se3.exp(np.array([0, 0, np.pi, 0, 0, 0]))
    assert "the start has to be within" in method.solve(prepared, around).reason
