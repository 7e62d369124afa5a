"""Every camera model projects, unprojects and differentiates; what it cannot see it says."""

from __future__ import annotations

import copy
import pickle
import sys
from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera, InputError, MethodUnavailable
from p2o.geometry.camera import intrinsics_remark
from p2o.geometry.projection import LENSES

WIDTH, HEIGHT = 1242, 375
PARAMS: dict[str, tuple[float, ...]] = {
    "PINHOLE": (700, 710, 620, 187),
    "SIMPLE_PINHOLE": (700, 620, 187),
    "SIMPLE_RADIAL": (700, 620, 187, -0.1),
    "RADIAL": (700, 620, 187, -0.2, 0.03),
    "OPENCV": (700, 705, 620, 187, -0.3, 0.1, 0.001, -0.002),
    "FULL_OPENCV": (700, 705, 620, 187, -0.3, 0.1, 0.001, -0.002, 0.01, 0.02, 0.01, 0.001),
    "OPENCV_FISHEYE": (480, 480, 620, 187, 0.02, -0.006, 0.001, -0.0002),
    "SIMPLE_RADIAL_FISHEYE": (480, 620, 187, 0.02),
    "RADIAL_FISHEYE": (480, 620, 187, 0.02, -0.005),
    "FOV": (600, 600, 620, 187, 0.9),
    "THIN_PRISM_FISHEYE": (480, 480, 620, 187, 0.02, -0.006, 0.0005, -0.0003, 0.001, -0.0002, 0.0004, -0.0002),
    "RAD_TAN_THIN_PRISM_FISHEYE": (
        *(480, 480, 620, 187),
        *(0.02, -0.006, 0.001, 0, 0, 0),
        *(0.0005, -0.0003),
        *(0.0004, 0, -0.0002, 0),
    ),
    "SIMPLE_DIVISION": (700, 620, 187, -0.1),
    "DIVISION": (700, 705, 620, 187, -0.1),
    "SIMPLE_FISHEYE": (480, 620, 187),
    "FISHEYE": (480, 485, 620, 187),
    "EUCM": (600, 605, 620, 187, 0.6, 1.1),
}
MODELS = {name: Camera(name, WIDTH, HEIGHT, params) for name, params in PARAMS.items()}
each_model = pytest.mark.parametrize("camera", MODELS.values(), ids=MODELS)


def pixels(camera: Camera, count: int = 300, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform((-0.5, -0.5), (camera.width - 0.5, camera.height - 0.5), (count, 2))


def test_every_model_of_pycolmap_is_tried_here() -> None:
    import pycolmap

    assert set(PARAMS) == set(pycolmap.CameraModelId.__members__) - {"INVALID", "EQUIRECTANGULAR"}


INSIDE = [(-0.5, -0.5), (1241.5, 374.5)]
OUTSIDE = [(-0.51, 100), (1241.51, 100), (100, -0.51), (100, 374.51), (np.nan, 100), (100, np.nan)]


def test_the_image_reaches_half_a_pixel_beyond_the_outer_centres_and_a_margin_grows_it_on_all_sides() -> None:
    assert MODELS["PINHOLE"].in_image(np.array([*INSIDE, *OUTSIDE])).tolist() == [True] * 2 + [False] * 6
    camera = MODELS["PINHOLE"]
    outside = np.array([[-5.0, 100], [1246, 100], [600, -5], [600, 379]])
    assert not camera.in_image(outside, margin_px=4).any()
    assert camera.in_image(outside, margin_px=5).all()


@each_model
def test_the_ray_of_a_pixel_leads_back_to_it_from_any_distance(camera: Camera) -> None:
    uv = pixels(camera)
    before = uv.copy()
    rays = camera.rays(uv)
    np.testing.assert_array_equal(uv, before)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-12)
    assert (rays[:, 2] > 0).all()
    distance = np.random.default_rng(1).uniform(0.3, 90, (len(uv), 1))
    np.testing.assert_allclose(camera.project(rays * distance), uv, atol=1e-6)


@each_model
def test_the_axis_meets_the_principal_point_and_right_is_right_and_down_is_down(camera: Camera) -> None:
    np.testing.assert_allclose(camera.project(np.array([0, 0, 5.0])), [620, 187], atol=1e-9)
    right, down = camera.project(np.array([[0.5, 0, 5], [0, 0.5, 5]]))
    assert right[0] > 640
    assert right[1] == pytest.approx(187, abs=0.5)
    assert down[1] > 200
    assert down[0] == pytest.approx(620, abs=0.5)


@each_model
def test_the_jacobian_is_the_slope_of_the_projection_and_zero_along_the_ray(camera: Camera) -> None:
    xyz = camera.rays(pixels(camera, 100)) * np.random.default_rng(2).uniform(0.5, 80, (100, 1))
    before = xyz.copy()
    uv, jacobian = camera.project_with_jacobian(xyz)
    np.testing.assert_allclose(np.einsum("kij,kj->ki", jacobian, xyz), 0, atol=1e-4)
    np.testing.assert_allclose(uv, camera.project(xyz), atol=1e-12)
    distance = np.linalg.norm(xyz, axis=1)[:, None]
    for axis in range(3):
        offset = 1e-4 * distance * np.eye(3)[axis]  # not the step of the code
        slope = (camera.project(xyz + offset) - camera.project(xyz - offset)) / (2e-4 * distance)
        # Both times the distance: pixels per radian, some hundreds; truncation is 1e-8 of that.
        np.testing.assert_allclose(jacobian[:, :, axis] * distance, slope * distance, atol=1e-3)
    np.testing.assert_array_equal(xyz, before)


@each_model
def test_what_lies_behind_is_not_seen(camera: Camera) -> None:
    xyz = np.array([[0, 0, -5.0], [1, 1, -5], [1, 0, 0], [0, 0, 0], [0.1, 0.1, 5]])
    uv, jacobian = camera.project_with_jacobian(xyz)
    for values in (camera.project(xyz), uv, jacobian):
        assert np.isnan(values[:4]).all()
        assert np.isfinite(values[4]).all()
    assert not camera.in_image(uv[:4]).any()


@each_model
def test_points_come_in_stacks_of_any_shape(camera: Camera) -> None:
    uv = pixels(camera, 6).reshape(2, 3, 2)
    rays = camera.rays(uv)
    assert rays.shape == (2, 3, 3)
    np.testing.assert_allclose(camera.project(rays), uv, atol=1e-6)
    np.testing.assert_allclose(camera.project(rays[1, 2]), uv[1, 2], atol=1e-6)
    assert camera.project(np.zeros((0, 3))).shape == (0, 2)
    assert camera.rays(np.zeros((0, 2))).shape == (0, 3)
    assert camera.project_with_jacobian(np.zeros((0, 3)))[1].shape == (0, 2, 3)


FOLDING = {
    # Inside the image, far inside it, and with tangential terms.
    "corner": Camera("OPENCV", 1000, 800, (500, 500, 499.5, 399.5, -0.35, 0, 0, 0)),
    "middle": Camera("OPENCV", 1000, 800, (300, 300, 499.5, 399.5, -0.3, 0, 0, 0)),
    "tangential": Camera("OPENCV", 1242, 375, (700, 700, 620, 187, -0.37, 0.02, 0.004, -0.003)),
    "radial": Camera("SIMPLE_RADIAL", 1242, 375, (700, 620, 187, -0.35)),
    "fisheye": Camera("OPENCV_FISHEYE", 1000, 1000, (400, 400, 499.5, 499.5, -0.2, 0, 0, 0)),
    "rational": Camera("FULL_OPENCV", 1000, 800, (500, 500, 499.5, 399.5, 0.1, 0, 0, 0, 0, -0.2, 0, 0)),
}
each_folding = pytest.mark.parametrize("camera", FOLDING.values(), ids=FOLDING)


@each_folding
def test_what_lies_far_outside_does_not_come_back_into_the_image(camera: Camera) -> None:
    """Along every way out from the axis pixels move outwards, and once they are gone they stay away."""
    tangent = np.linspace(0.01, 60, 3000)[:, None]
    for azimuth in np.radians(np.arange(0, 360, 15)):
        out = np.array([np.cos(azimuth), np.sin(azimuth)])
        uv = camera.project(np.concatenate([tangent * out, np.ones_like(tangent)], axis=1))
        seen = np.isfinite(uv).all(axis=1)
        assert seen[0]
        assert not seen[np.argmin(seen) :].any()  # never again
        centre = camera.project(np.array([0, 0, 1.0]))
        radius = np.linalg.norm(uv[seen] - centre, axis=1)
        assert (np.diff(radius) > 0).all()
    # Otherwise this says nothing: ways out end before the image plane does.
    assert np.isnan(camera.project(np.array([[50.0, 0, 1], [0, 50, 1], [-50, 0, 1]]))).all()


@pytest.mark.parametrize(("name", "k"), [("corner", -0.35), ("middle", -0.3), ("radial", -0.35)])
def test_the_fold_is_where_the_slope_ends_and_not_before(name: str, k: float) -> None:
    """Closed form for one radial coefficient: r (1 + k r^2) turns at r = 1 / sqrt(-3 k)."""
    turn = 1 / np.sqrt(-3 * k)
    before, after = FOLDING[name].project(np.array([[0.99 * turn, 0, 1], [1.01 * turn, 0, 1]]))
    assert np.isfinite(before).all()
    assert np.isnan(after).all()


@each_folding
def test_every_pixel_has_a_true_ray_or_none(camera: Camera) -> None:
    uv = pixels(camera, 3000)
    rays = camera.rays(uv)
    seen = np.isfinite(rays).all(axis=1)
    assert np.isnan(rays[~seen]).all()
    np.testing.assert_allclose(camera.project(rays[seen]), uv[seen], atol=0.01)
    near = np.linalg.norm(uv - uv.mean(axis=0), axis=1) < 0.3 * min(camera.width, camera.height) / 2
    assert seen[near].all()


def test_a_fisheye_of_half_the_sphere_sees_up_to_the_image_plane() -> None:
    camera = Camera("OPENCV_FISHEYE", 1000, 1000, (300, 300, 499.5, 499.5, 0, 0, 0, 0))
    angle = np.radians([60, 85, 89, 89.9, 90.1, 95])
    uv = np.stack([499.5 + 300 * angle, np.full(6, 499.5)], axis=1)  # equidistant: 300 px a radian
    rays = camera.rays(uv)
    np.testing.assert_allclose(rays[:4], np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=1)[:4], atol=1e-9)
    assert np.isnan(rays[4:]).all()
    np.testing.assert_allclose(camera.project(5 * rays[:4]), uv[:4], atol=1e-6)
    _, jacobian = camera.project_with_jacobian(5 * rays[:4])
    # 300 px a radian: along the image 60 px/m across the ray at 5 m, whatever the angle.
    across = np.stack([np.cos(angle), 0 * angle, -np.sin(angle)], axis=1)[:4]
    np.testing.assert_allclose(np.einsum("kij,kj->ki", jacobian, across), [[60, 0]] * 4, atol=1e-4)


@each_model
def test_the_camera_of_an_enlarged_image_projects_to_the_enlarged_pixels(camera: Camera) -> None:
    # Pixel centres are at whole numbers: the image begins at -0.5 px in both sizes.
    xyz = camera.rays(pixels(camera, 100)) * 10
    expected = 3 * (camera.project(xyz) + 0.5) - 0.5
    np.testing.assert_allclose(camera.resized(3 * WIDTH, 3 * HEIGHT).project(xyz), expected, rtol=1e-9)
    # By another factor in each direction.
    camera = Camera.pinhole(700, 710, 620, 187, WIDTH, HEIGHT)
    assert camera.resized(2 * WIDTH, 4 * HEIGHT) == Camera.pinhole(1400, 2840, 1240.5, 749.5, 2 * WIDTH, 4 * HEIGHT)


@each_model
def test_the_focal_length_is_the_size_of_a_radian_at_the_centre(camera: Camera) -> None:
    uv = camera.project(np.array([[-1e-4, 0, 1], [1e-4, 0, 1], [0, -1e-4, 1], [0, 1e-4, 1]]))
    sizes = np.linalg.norm(uv[1::2] - uv[::2], axis=1) / 2e-4
    assert camera.focal_px == pytest.approx(sizes.mean(), rel=1e-5)


@each_model
def test_a_used_camera_can_be_copied_and_sent_to_another_process_without_pycolmap(camera: Camera) -> None:
    """Its import in the thread that receives results of workers would replace the handler of SIGTERM."""
    points = np.array([[1.0, 1, 5], [0.3, -0.2, 2]])
    rays = camera.rays(camera.project(points))
    data = pickle.dumps(camera)
    assert b"pycolmap" not in data
    for again in (pickle.loads(data), copy.deepcopy(camera)):  # noqa: S301  (our own bytes)
        assert again == camera
        assert len({again, camera, replace(camera, width=99)}) == 2
        np.testing.assert_array_equal(again.rays(again.project(points)), rays)


@pytest.mark.parametrize(
    ("model", "width", "height", "params", "text"),
    [
        ("PINHOLE", 10, 10, (1, 1, 5), "PINHOLE has a different number of parameters; expected fx, fy, cx, cy; got 3"),
        ("OPENCV", 10, 10, (1, 1, 5, 5), "OPENCV has a different number of parameters; expected fx, fy, cx, cy, k1"),
        ("INVALID", 10, 10, (1,), "unknown camera model 'INVALID'"),
        ("PINHOLE", 0, 10, (1, 1, 5, 5), "is not positive; expected positive integers width and height; got 0x10"),
        ("PINHOLE", 10, -3, (1, 1, 5, 5), "is not positive.*10x-3"),
        ("PINHOLE", 10.5, 10, (1, 1, 5, 5), "is not positive.*10.5x10"),
        ("PINHOLE", 10, 10, (-1, 1, 5, 5), "focal length is not positive; expected > 0 px"),
        ("PINHOLE", 10, 10, (1, 0, 5, 5), "focal length is not positive"),
        ("FOV", 10, 10, (1, -1, 5, 5, 0.5), "focal length is not positive"),
        ("SIMPLE_RADIAL", 10, 10, (-1, 5, 5, 0.5), "focal length is not positive"),
        ("PINHOLE", 10, 10, (1, np.nan, 5, 5), "not finite"),
        ("OPENCV", 10, 10, (1, 1, 5, 5, np.inf, 0, 0, 0), "not finite"),
        ("PINHOLE", 10, 10, ("a", 1, 5, 5), "parameters are not numbers"),
        ("PINHOLE", 10, 10, None, "parameters are not numbers"),
        ("EQUIRECTANGULAR", 10, 10, (10, 10), "no image plane.*panorama"),
        ("OPENCV_FISHYEYE", 10, 10, (1, 1, 5, 5, 0, 0, 0, 0), "unknown .*'OPENCV_FISHYEYE'.*mean OPENCV_FISHEYE"),
        # Cameras that nobody has.
        ("PINHOLE", 30_001, 10, (5, 5, 2, 2), "too many pixels"),
        ("PINHOLE", 20_000, 20_000, (5, 5, 2, 2), "too many .*at most 30000 px per side and 200 million in total"),
        ("PINHOLE", 10**400, 10, (5, 5, 2, 2), "too many pixels"),
        ("PINHOLE", float("inf"), 10, (5, 5, 2, 2), "parameters are not numbers"),
        ("PINHOLE", 10, 10, (10**400, 5, 2, 2), "parameters are not numbers"),
        ("PINHOLE", 10, 10, (5, 5, 1e300, 2), "a camera parameter is too large"),
        ("PINHOLE", 10, 10, (1e-300, 5, 2, 2), "the focal length is too short"),
    ],
)
def test_what_is_no_camera_is_refused(model: str, width: int, height: int, params: object, text: str) -> None:
    with pytest.raises(InputError, match=text):
        Camera(model, width, height, params)


def test_without_pycolmap_common_models_work_and_others_say_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    for name in LENSES:
        camera = Camera(name, WIDTH, HEIGHT, PARAMS[name])
        assert np.isfinite(camera.rays(pixels(camera))).any()
        assert camera.shifted(0.5).resized(99, 30).extent() is not None
    with pytest.raises(MethodUnavailable, match=r"^camera model FOV needs the package pycolmap.*p2o-calib\[colmap\]"):
        Camera("FOV", WIDTH, HEIGHT, PARAMS["FOV"])


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV_FISHEYE"])
@pytest.mark.parametrize("scale", [0.5, 0.25, 2.0])
def test_the_intrinsics_of_an_image_of_another_size_are_named_with_the_factor(model: str, scale: float) -> None:
    width, height = round(1242 * scale), round(375 * scale)
    params = (720.0, 720.0, 609.0, 173.0, *((0.0,) * 4 if model != "PINHOLE" else ()))
    (text,) = intrinsics_remark(Camera(model, width, height, params))
    assert "if the images were resized, scale fx, fy, cx, cy by about" in text
    assert float(text.rpartition(" ")[2]) == pytest.approx(scale, rel=0.1)


@pytest.mark.parametrize(
    ("fx", "fy", "words"),
    [
        (7210, 7210, "7210 px, the image is 1242 px wide"),
        (72, 72, "72 px, the image"),
        (721, 1442, "721 and 1442 px: "),
    ],
)
def test_focal_lengths_that_hardly_any_camera_has_are_named(fx: float, fy: float, words: str) -> None:
    (text,) = intrinsics_remark(Camera.pinhole(fx, fy, 609, 173, 1242, 375))
    assert words in text
    assert "verify" in text


@pytest.mark.parametrize(("model", "params"), PARAMS.items())
def test_no_usual_camera_has_a_remark(model: str, params: tuple[float, ...]) -> None:
    assert intrinsics_remark(Camera(model, WIDTH, HEIGHT, params)) == ()


def test_a_centre_outside_the_image_is_named_no_other_doubted_and_the_extent_that_of_the_corners_up_to_60_degrees() -> (
    None
):
    for size, centre in (((1242, 375), (609, 173)), ((1600, 900), (816, 491)), ((1920, 886), (961, 587))):
        assert intrinsics_remark(Camera.pinhole(700, 700, *centre, *size)) == ()
    (text,) = intrinsics_remark(Camera.pinhole(700, 700, 700, 190, 640, 375))
    assert text.startswith("the principal point (700, 190) is outside the image of 640x375 px")
    assert text.endswith("scale fx, fy, cx, cy with the image")
    low, high = Camera.pinhole(100.0, 100.0, 49.5, 29.5, 100, 60).extent()
    np.testing.assert_allclose([low, high], [[-0.495, -0.295], [0.495, 0.295]])
    low, high = Camera.pinhole(10.0, 10.0, 49.5, 29.5, 100, 60).extent()
    np.testing.assert_allclose([low, high], [[-1.7, -1.7], [1.7, 1.7]])
