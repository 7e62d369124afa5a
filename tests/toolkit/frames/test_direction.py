from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, Cloud, InputError, se3
from p2o.frames.direction import Direction, check_direction, pose_direction, range_remark, vertical
from scipy.spatial.transform import Rotation

from tests.p2o_datasets.kitti_files import VELO_TO_CAM

CAMERA = Camera.pinhole(600, 600, 500, 200, 1000, 400)


def cloud(sector_deg: float) -> Cloud:
    rng = np.random.default_rng(0)
    azimuth = np.radians(rng.uniform(-sector_deg, sector_deg, 4000))
    return Cloud(np.column_stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), rng.uniform(-2, 2, 4000)]))


# LiDAR axes of others, from those of KITTI (x forward, y left, z up): nuScenes has x right, y forward, z up.
NUSCENES = se3.make([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
HANGING = se3.make(np.diag([1.0, -1.0, -1.0]))
Z_FORWARD_Y_UP = se3.make([[0, 1, 0], [0, 0, 1], [1, 0, 0]])


def street(axes: np.ndarray | None = None, below_deg: float = 25, above_deg: float = 15) -> Cloud:
    """Return a sweep all around: a road 1.7 m below, and walls and trees that end at many heights."""
    rng = np.random.default_rng(1)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, 8000), np.radians(rng.uniform(-below_deg, above_deg, 8000))
    reach = rng.choice([12.0, 18.0, 25.0], 8000)
    road = np.where(elevation < 0, 1.7 / np.maximum(np.tan(-elevation), 1e-6), np.inf)
    flat = np.minimum(reach, road)
    xyz = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), flat * np.tan(elevation)])
    return Cloud(xyz if axes is None else se3.apply(axes, xyz))


@pytest.mark.parametrize("axes", [np.eye(4), NUSCENES, HANGING, Z_FORWARD_Y_UP])
def test_up_is_told_by_the_points_whatever_the_axes_are(axes: np.ndarray) -> None:
    up = vertical(street(axes))
    assert up.points_up
    assert up.axis @ axes[:3, 2] > 0.98


@pytest.mark.parametrize("xyz", [np.zeros((500, 3)), np.ones((20, 3)), np.random.default_rng(0).normal(size=(500, 3))])
def test_points_that_spread_alike_or_are_few_tell_no_vertical(xyz: np.ndarray) -> None:
    assert vertical(Cloud(xyz)) is None


@pytest.mark.parametrize("axes", [np.eye(4), NUSCENES, HANGING])
def test_a_swapped_pose_is_doubted_for_lidars_of_other_axes_too(axes: np.ndarray) -> None:
    camera_from_lidar = VELO_TO_CAM @ se3.inverse(axes)
    assert check_direction(street(axes), CAMERA, camera_from_lidar) == ()
    (warning,) = check_direction(street(axes), CAMERA, se3.inverse(camera_from_lidar))
    assert warning.startswith("start may be lidar_from_camera: its inverse stands upright")


@pytest.mark.parametrize("axes", [np.eye(4), NUSCENES, HANGING, Z_FORWARD_Y_UP])
def test_a_start_that_is_20_degrees_off_is_not_doubted(axes: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        turn = rng.normal(size=3)
        wrong = se3.exp(np.concatenate([np.radians(20) * turn / np.linalg.norm(turn), rng.normal(size=3) * 0.3]))
        warnings = check_direction(street(axes), CAMERA, wrong @ VELO_TO_CAM @ se3.inverse(axes))
        assert not any("lidar_from_camera" in warning for warning in warnings)


def test_a_start_that_looks_past_a_narrow_sweep_is_not_refused() -> None:
    """Turned up by 20 degrees it shows next to nothing of a flat sweep, and its inverse may well show points."""
    wrong = se3.exp(np.array([np.radians(-25), 0, 0, 0, 0, 0])) @ VELO_TO_CAM
    flat = street().select(np.abs(street().xyz[:, 2]) < 0.5)
    assert not any("lidar_from_camera" in warning for warning in check_direction(flat, CAMERA, wrong))


def test_the_inverse_is_refused_where_the_sweep_looks_ahead_only_and_doubted_where_it_goes_all_around() -> None:
    assert check_direction(cloud(45), CAMERA, VELO_TO_CAM) == ()
    with pytest.raises(InputError, match=r"frame\.yaml: start looks like lidar_from_camera; expected camera_from_lid"):
        check_direction(cloud(45), CAMERA, se3.inverse(VELO_TO_CAM), where="frame.yaml")
    (warning,) = check_direction(cloud(180), CAMERA, se3.inverse(VELO_TO_CAM), name="truth", where="frame.yaml")
    assert warning.startswith("frame.yaml: truth may be lidar_from_camera: its inverse stands upright")
    # Each outcome is a value with its warnings.
    down = se3.make(np.diag([1.0, -1.0, -1.0]))
    outcomes = [pose_direction(cloud(180), CAMERA, pose) for pose in (VELO_TO_CAM, se3.inverse(VELO_TO_CAM), down)]
    assert outcomes == [Direction.PLAUSIBLE, Direction.POSSIBLY_INVERSE, Direction.NOTHING_VISIBLE]
    assert [len(outcome.warnings("start")) for outcome in outcomes] == [0, 1, 1]
    assert outcomes[2].warnings("start") == ("no point of the sweep lies in the image at start",)


@pytest.mark.parametrize("yaw_deg", [0, 45, 90, 180])
def test_an_upright_camera_that_looks_elsewhere_is_not_doubted(yaw_deg: float) -> None:
    turned = VELO_TO_CAM @ se3.exp(np.array([0, 0, np.radians(yaw_deg), 0, 0, 0]))
    assert check_direction(cloud(180), CAMERA, turned) == ()


@pytest.mark.parametrize("yaw_deg", [60, 90, 180, -45])
@pytest.mark.parametrize("inverse", [False, True])
def test_a_quaternion_in_the_other_order_is_named(yaw_deg: float, inverse: bool) -> None:
    body = se3.make(Rotation.from_euler("zyx", [yaw_deg, 2, -3], degrees=True).as_matrix())
    good = VELO_TO_CAM @ se3.inverse(body)
    assert check_direction(street(), CAMERA, good) == ()
    written = se3.inverse(good) if inverse else good
    x, y, z, w = Rotation.from_matrix(written[:3, :3]).as_quat()
    bad = se3.make(Rotation.from_quat([w, x, y, z]).as_matrix(), written[:3, 3])
    for quaternion in (True, False):  # a matrix has no order of a quaternion
        try:
            texts = check_direction(street(), CAMERA, se3.inverse(bad) if inverse else bad, quaternion=quaternion)
        except InputError as problem:
            texts = (str(problem),)
        assert ("p2o and ROS have x y z w" in " ".join(texts)) == quaternion
        assert quaternion or "quaternion" not in " ".join(texts)


def test_a_translation_in_millimetres_is_named_and_a_camera_on_its_side_warned_of_but_not_refused() -> None:
    wrong = VELO_TO_CAM.copy()
    wrong[:3, 3] = (-4.0, -76.0, -270.0)
    texts = check_direction(street(), CAMERA, wrong, name="truth", where="frame.yaml")
    assert "frame.yaml: the translation of truth is 280.5 m long: if it is in millimetres, divide it by 1000" in texts
    for angle_deg in (90, 180, -90):
        c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
        rolled = se3.make([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ VELO_TO_CAM
        assert all("unless that is right" in text for text in check_direction(street(), CAMERA, rolled))


@pytest.mark.parametrize(
    ("range_m", "texts"),
    [
        (2200.0, ["millimetres (then 2.2 m: cloud_scale: 0.001", "centimetres (then 22 m: cloud_scale: 0.01"]),
        (1200.0, ["millimetres (then 1.2 m", "centimetres (then 12 m"]),
        (250.0, ["probably in centimetres (then 2.5 m"]),
        (0.02, ["kilometres (then 20 m"]),
        (1e-8, ["scale the points to metres"]),
    ],
)
def test_points_in_another_unit_than_metres_are_named(range_m: float, texts: list[str]) -> None:
    rays = np.random.default_rng(0).normal(size=(500, 3))
    cloud = Cloud(range_m * rays / np.linalg.norm(rays, axis=1)[:, None])
    [remark] = range_remark(cloud)
    assert "which no scene has" in remark
    assert all(text in remark for text in texts)


@pytest.mark.parametrize("range_m", [0.3, 2.0, 8.0, 60.0, 140.0])
def test_ranges_of_scenes_give_no_remark(range_m: float) -> None:
    assert range_remark(Cloud([[range_m, 0, 0], [0, range_m, 0]])) == ()


def narrow(half_deg: float, axes: np.ndarray | None = None) -> Cloud:
    """Return a sweep with a circular field of view about the x axis of the LiDAR: walls and a ground."""
    rng = np.random.default_rng(3)
    angle, about = np.radians(half_deg) * np.sqrt(rng.random(6000)), rng.uniform(-np.pi, np.pi, 6000)
    rays = np.column_stack([np.cos(angle), np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about)])
    ground = np.where(rays[:, 2] < 0, -1.5 / np.minimum(rays[:, 2], -1e-6), np.inf)
    xyz = np.minimum(rng.choice([8.0, 15.0], 6000), ground)[:, None] * rays
    return Cloud(xyz if axes is None else se3.apply(axes, xyz))


@pytest.mark.parametrize("half_deg", [19, 35, 50])
@pytest.mark.parametrize("focal_px", [350, 600, 1200])
@pytest.mark.parametrize("axes", [np.eye(4), NUSCENES, HANGING])
def test_the_inverse_is_refused_for_narrow_lidars(half_deg: float, focal_px: float, axes: np.ndarray) -> None:
    """A Livox Mid-40, an Avia and a wider LiDAR: starts with an error of 20 degrees pass, inverses do not."""
    camera = Camera.pinhole(focal_px, focal_px, 480, 360, 960, 720)
    sweep, right = narrow(half_deg, axes), VELO_TO_CAM @ se3.inverse(axes)
    rng = np.random.default_rng(4)
    for angle_deg in (0.0, 5.0, 20.0):
        turn = rng.normal(size=3)
        turn *= np.radians(angle_deg) / np.linalg.norm(turn)
        start = se3.exp(np.concatenate([turn, rng.normal(size=3) * 0.05])) @ right
        assert not any("lidar_from_camera" in warning for warning in check_direction(sweep, camera, start))
        if half_deg < 50 and angle_deg < 20:  # a wider sweep is in the image at the inverse, too
            with pytest.raises(InputError, match="start looks like lidar_from_camera"):
                check_direction(sweep, camera, se3.inverse(start))


def room(above_deg: float, below_deg: float, axes: np.ndarray | None = None) -> Cloud:
    """Return a sweep in a room of 6 x 8 m: a ceiling 1.6 m above, furniture before walls, a floor 0.9 m below."""
    rng = np.random.default_rng(6)
    azimuth, elevation = rng.uniform(-np.pi, np.pi, 12_000), np.radians(rng.uniform(-below_deg, above_deg, 12_000))
    wall = np.minimum(3 / np.maximum(np.abs(np.sin(azimuth)), 1e-6), 4 / np.maximum(np.abs(np.cos(azimuth)), 1e-6))
    wall = np.where(elevation < 0, wall * rng.uniform(0.4, 1.0, 12_000), wall)
    height = np.where(elevation < 0, 0.9, 1.6) / np.maximum(np.abs(np.tan(elevation)), 1e-6)
    flat = np.minimum(wall, height)
    xyz = np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), flat * np.tan(elevation)])
    return Cloud(xyz if axes is None else se3.apply(axes, xyz))


@pytest.mark.parametrize(("above_deg", "below_deg"), [(22.5, 22.5), (45, 45), (15, 15), (40, 10), (11, 30)])
@pytest.mark.parametrize("axes", [np.eye(4), NUSCENES, HANGING])
def test_a_right_pose_in_a_room_gives_no_remark(above_deg: float, below_deg: float, axes: np.ndarray) -> None:
    """The ceiling may be sharper than the ground; the sign of the vertical is then unknown, and never wrong."""
    sweep, right = room(above_deg, below_deg, axes), VELO_TO_CAM @ se3.inverse(axes)
    up = vertical(sweep)
    assert up is None or not up.points_up or up.axis @ axes[:3, 2] > 0.98
    for angle_deg in (0, 10, 20):
        start = se3.exp(np.array([0, 0, np.radians(angle_deg), 0, 0, 0])) @ right
        assert check_direction(sweep, CAMERA, start) == ()


def test_a_sweep_that_looks_up_has_no_wrong_vertical() -> None:
    """A Livox Mid-360 observes 52 degrees above and 7 below: more points above are no sign of an upside-down LiDAR."""
    sweep, rng = street(below_deg=7, above_deg=35), np.random.default_rng(7)
    elevation = np.arcsin(sweep.xyz[:, 2] / np.linalg.norm(sweep.xyz, axis=1))
    up = vertical(sweep.select(rng.random(len(sweep)) >= elevation / 0.7))
    assert not up.points_up or up.axis[2] > 0.98
