"""Costs of mutual information over poses: gradients, bounds, which points count, and the methods made of them."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.reading import RingsUnknownError
from p2o.solving import Objective
from p2o_baselines.information import gom, grey, mi, nid, nmi, reflectance
from p2o_baselines.information.gom import gradients
from p2o_baselines.information.histogram import presence, presence_slope
from p2o_baselines.information.information import Sighting, sightings
from p2o_testing import stage

TRUTH = stage.camera_from_lidar()
OFF = se3.exp(np.array([0.004, -0.006, 0.003, 0.03, -0.02, 0.04])) @ TRUTH
every = pytest.mark.parametrize("method", [gom, mi, nid, nmi], ids=lambda m: m.METHOD.name)
smooth = pytest.mark.parametrize(
    ("method", "options"),
    [(mi, {"bins": 32}), (mi, {"bins": 32, "estimator": "james-stein"}), (nid, {"bins": 8})],
    ids=["mi", "mi-shrunk", "nid"],
)


def views() -> list[p2o.View]:
    """Return the stage as the extractors see it, with a wider blur: costs without steps."""
    frame = stage.frame()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grey, "_BLUR_SIGMA_PX", 2.0)
        image = grey.extract(frame.image)
    cloud = reflectance.METHOD.build(reflectance.ReflectanceOptions())(frame.cloud)
    return [p2o.View("stage", stage.camera(), image, cloud)]


def problem(method: ModuleType, seen: list[p2o.View], pose: np.ndarray = OFF, **options: Any) -> Objective:
    return method.build(method.METHOD.options(**options))(seen, pose, 5.0)


@smooth
def test_gradients_are_those_of_differences_also_where_points_leave_the_image(
    method: ModuleType, options: dict[str, Any]
) -> None:
    posed = problem(method, views(), **options)
    step = 2e-7
    ahead, behind = posed.cost(se3.exp(step * np.concatenate([np.eye(6), -np.eye(6)])) @ OFF).reshape(2, 6)
    assert posed.gradient is not None
    assert posed.gradient(OFF) == pytest.approx((ahead - behind) / (2 * step), rel=1e-3, abs=3e-3)


def test_points_count_less_towards_the_border_and_not_at_all_outside() -> None:
    uv = np.array([[50.0, 50.0], [5.0, 50.0], [50.0, 97.5], [0.0, 50.0], [-3.0, 50.0], [np.nan, 50.0]])
    slope = presence_slope(uv, 101, 101, 0.0)
    assert presence(uv, 101, 101, 0.0) == pytest.approx([1, 0.5, 0.25, 0, 0, 0])
    assert slope.tolist() == [[0, 0], [0.1, 0], [0, -0.1], [0, 0], [0, 0], [0, 0]]


def test_a_frame_twice_tells_as_much_as_once_with_a_histogram_for_each() -> None:
    seen = views()
    once, twice = (problem(mi, seen * n, OFF, per_frame=True, estimator="counts") for n in (1, 2))
    poses = np.stack([TRUTH, OFF])
    assert twice.cost(poses) == pytest.approx(once.cost(poses))


@pytest.mark.parametrize("method", [mi, nid, nmi], ids=lambda m: m.METHOD.name)
def test_a_picture_with_light_and_dark_exchanged_tells_as_much(method: ModuleType) -> None:
    [seen] = views()
    negative = p2o.GreyMap(255.0 - seen.get("image-grey").values)
    other = replace(seen, image=p2o.ImageFeatures(features=[negative]))
    costs = [problem(method, [view]).cost(np.stack([TRUTH, OFF])) for view in (seen, other)]
    assert costs[0] == pytest.approx(costs[1], rel=0.02)


@pytest.mark.parametrize("method", [nid, nmi, gom], ids=lambda m: m.METHOD.name)
def test_only_the_order_of_reflectances_matters(method: ModuleType) -> None:
    [seen] = views()
    points = seen.get("cloud-points")
    other = replace(seen, cloud=p2o.CloudFeatures(points=replace(points, intensity=np.exp(5 * points.intensity))))
    costs = [problem(method, [view]).cost(np.stack([TRUTH, OFF])) for view in (seen, other)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-9)


def test_twice_the_frames_halve_the_bound_of_cramer_and_rao() -> None:
    seen = views()
    once, twice = (problem(mi, seen * n, TRUTH) for n in (1, 2))
    assert once.covariance is not None
    assert twice.covariance is not None
    # Not exactly: kernels of more points are narrower.
    ratio = np.diagonal(twice.covariance(TRUTH)) / np.diagonal(once.covariance(TRUTH))
    assert ratio == pytest.approx(np.full(6, 0.5), rel=0.3)


def test_the_bound_is_none_where_the_picture_tells_nothing() -> None:
    [seen] = views()
    flat = replace(seen, image=p2o.ImageFeatures(features=[p2o.GreyMap(np.full((240, 480), 90.0))]))
    posed = problem(mi, [flat], TRUTH)
    assert posed.covariance is not None
    assert posed.covariance(TRUTH) is None


def test_steepness_needs_normals_and_says_how_to_get_them() -> None:
    points = stage.view().get("cloud-points")
    bare = replace(stage.view(), cloud=p2o.CloudFeatures(points=replace(points, normal=None)))
    [seen] = sightings([stage.view()], "normals")
    assert set(np.round(seen.value).tolist()) <= {0.0, 90.0}
    with pytest.raises(p2o.InputError, match="normal_neighbours"):
        list(sightings([bare], "normals"))


def test_gradients_of_a_slope_are_the_slope() -> None:
    turns, tilts = np.meshgrid(np.linspace(-0.2, 0.2, 41), np.linspace(-0.1, 0.1, 21))
    xyz = 7.0 * np.stack([np.ones_like(turns), np.tan(turns), np.tan(tilts)], -1).reshape(-1, 3)
    found = gradients(xyz, (xyz[:, 1] / np.linalg.norm(xyz, axis=1)) * 3.0, 8)[21 * 10]
    beam = xyz / np.linalg.norm(xyz, axis=1, keepdims=True)
    assert (found * beam[21 * 10]).sum() == pytest.approx(0.0, abs=1e-9)
    inner = gradients(xyz, 3.0 * beam[:, 1], 8).reshape(21, 41, 3)[10, 20]
    assert inner == pytest.approx([0, 3, 0], abs=0.2)  # a few per cent less: what keeps single rings solvable


def test_normals_are_those_of_the_surface_and_look_at_the_lidar() -> None:
    exact = stage.view().get("cloud-points")
    found = reflectance.METHOD.build(reflectance.ReflectanceOptions(normal_neighbours=12))(stage.frame().cloud)
    points = found.get("cloud-points")
    order = np.lexsort(exact.xyz.T)
    assert points.xyz == pytest.approx(exact.xyz[order])
    cosine = (points.normal * exact.normal[order]).sum(axis=1)
    assert np.mean(cosine > 0.99) > 0.9
    assert ((points.normal * points.xyz).sum(axis=1) <= 0).all()


def cloud_with_lasers(ring: np.ndarray, intensity: np.ndarray) -> p2o.Cloud:
    """Return points that are the same surfaces for every laser, with the given intensities."""
    angle = np.linspace(-1.0, 1.0, len(intensity))
    xyz = 10.0 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    return p2o.Cloud(xyz, ring=ring, intensity=intensity)


def test_reflectance_ranked_in_each_ring_does_not_depend_on_the_response_of_a_laser() -> None:
    surface = np.random.default_rng(0).permutation(400) / 400
    ring = np.arange(400) % 4
    gain, offset = np.array([1.0, 0.2, 0.5, 0.9])[ring], np.array([0.0, 0.7, 0.3, 0.1])[ring]
    find = reflectance.METHOD.build(reflectance.ReflectanceOptions(equalise="auto"))
    even, uneven = (
        find(cloud_with_lasers(ring, each)).get("cloud-points") for each in (surface, np.sqrt(surface) * gain + offset)
    )
    assert uneven.intensity == pytest.approx(even.intensity)
    for number in range(4):
        assert sorted(even.intensity[ring == number]) == pytest.approx((np.arange(100) + 0.5) / 100)


def test_without_observable_rings_reflectance_is_ranked_in_the_sweep() -> None:
    random = np.random.default_rng(1)
    surface = random.permutation(5000) / 5000
    xyz = random.normal(size=(5000, 3)) * [10, 10, 3]
    xyz = xyz[np.linalg.norm(xyz, axis=1) > 1.5]
    cloud = p2o.Cloud(xyz, intensity=surface[: len(xyz)])
    with pytest.raises(RingsUnknownError):
        reflectance.rings(cloud)
    points = reflectance.METHOD.build(reflectance.ReflectanceOptions(equalise="auto"))(cloud).get("cloud-points")
    found, given = points.intensity[np.lexsort(points.xyz.T)], cloud.intensity[np.lexsort(cloud.xyz.T)]
    assert np.argsort(found).tolist() == np.argsort(given).tolist()
    assert sorted(points.intensity) == pytest.approx((np.arange(len(xyz)) + 0.5) / len(xyz))


def test_what_stands_behind_is_hidden_and_what_is_far_out_of_the_image_is_left_out() -> None:
    camera = p2o.Camera.pinhole(100.0, 100.0, 50.0, 50.0, 101, 101)
    xyz = np.array([[0.0, 0, 5], [0, 0, 5.05], [0, 0, 6], [1.0, 0, 6], [0, 0, -3]])
    black = p2o.GreyMap(np.zeros((101, 101)))
    assert Sighting(camera, black, xyz, np.arange(5.0)).visible(np.eye(4), 1.0, 0.1).value.tolist() == [0, 1, 3]
    x = np.linspace(-20, 20, 401)
    xyz = np.column_stack([x, np.zeros(401), np.full(401, 10.0)])
    seen = Sighting(camera, black, xyz, x).near_image(np.eye(4), 10**6)
    # 50 px and 5 degrees of a focal length of 100 px to either side, 0.1 m a pixel.
    assert np.abs(seen.value).max() == pytest.approx(10 * (0.505 + np.tan(np.radians(5))), abs=0.1)
    assert len(seen.near_image(np.eye(4), 7).value) == 7


def test_reflectance_keeps_its_bounds_and_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reflectance, "_POINTS", 500)
    options = reflectance.ReflectanceOptions(min_range_m=8, max_range_m=15, equalise="sweep")
    points = reflectance.METHOD.build(options)(stage.frame().cloud).get("cloud-points")
    distance = np.linalg.norm(points.xyz, axis=1)
    assert (len(points), distance.min() >= 8, distance.max() <= 15) == (500, True, True)
    assert points.intensity.mean() == pytest.approx(0.5, abs=0.05)
