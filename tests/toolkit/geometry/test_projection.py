"""Projections in closed form are those of pycolmap, to rounding, in both precisions, with the same folds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera
from p2o.geometry.projection import LENSES

from tests.toolkit.geometry.test_camera import MODELS

each_lens = pytest.mark.parametrize("camera", [MODELS[name] for name in LENSES], ids=LENSES)


def by_pycolmap(camera: Camera) -> Camera:
    """Return an equal camera that asks pycolmap, as models without a closed form do."""
    other = replace(camera)
    other.__dict__.update(_closed=None)
    return other


def points(camera: Camera) -> np.ndarray:
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 80, (4000, 1))
    plane = rng.normal(0, 0.8, (4000, 2))
    plane[:200] *= 10 ** rng.uniform(-9, -1, (200, 1))  # close to the axis
    return np.concatenate([plane * depth, depth], axis=1) * np.where(rng.random((4000, 1)) < 0.05, -1, 1)


@each_lens
def test_pixels_and_derivatives_are_those_of_pycolmap(camera: Camera) -> None:
    if camera.is_pinhole:  # its own path
        np.testing.assert_allclose(camera.project(points(camera))[0], camera._colmap.img_from_cam(points(camera))[0])
        return
    ours, theirs = camera.project(points(camera)), by_pycolmap(camera).project(points(camera))
    assert np.isfinite(ours).any()
    np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-9)
    uv, ours = camera.project_with_jacobian(points(camera))
    _, theirs = by_pycolmap(camera).project_with_jacobian(points(camera))
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
    np.testing.assert_array_equal(np.isnan(ours[:, 0, 0]), np.isnan(uv[:, 0]))
    near = np.abs(uv).max(axis=1) < 1e4
    np.testing.assert_allclose(ours[near], theirs[near], rtol=2e-6, atol=2e-5)


@each_lens
def test_rays_are_those_of_pycolmap_and_lead_back_to_the_pixel(camera: Camera) -> None:
    """Also of a lens whose projection folds within the image: the pixels without a ray are the same."""
    for k in (None, -0.35):
        params = camera.params if k is None else tuple(k if i == 4 else p for i, p in enumerate(camera.params))
        camera = replace(camera, params=params)
        uv = np.random.default_rng(0).uniform(0, (camera.width, camera.height), (2000, 2))
        ours, theirs = camera.rays(uv), by_pycolmap(camera).rays(uv)
        np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-8)
        known = np.isfinite(ours[:, 0])
        np.testing.assert_allclose(camera.project(ours[known]), uv[known], rtol=0, atol=1e-9)


@each_lens
def test_a_shift_moves_all_pixels_and_another_size_changes_the_same_parameters(camera: Camera) -> None:
    at, other = camera.project(points(camera)[:50]), by_pycolmap(camera)
    for moved in (camera.shifted(2.5), other.shifted(2.5)):
        np.testing.assert_allclose(moved.project(points(camera)[:50]), at + 2.5)
    np.testing.assert_allclose(camera.resized(701, 333).params, other.resized(701, 333).params, rtol=1e-14)


@each_lens
def test_single_precision_is_kept_and_is_as_good_as_it_gets(camera: Camera) -> None:
    xyz = points(camera)
    fine = camera.project(xyz)
    u, v = camera.pixels_of(*xyz.T.astype(np.float32))
    assert u.dtype == v.dtype == np.float32
    inside = camera.in_image(fine)
    assert inside.any()
    np.testing.assert_allclose(np.stack([u, v], axis=1)[inside], fine[inside], atol=2e-3)
