from __future__ import annotations

import pytest
from p2o_formats.frame_names import has_body_axes, is_camera, is_lidar, is_optical

LIDARS = (
    "velodyne velo_link os_sensor os1_sensor front/os_lidar livox_frame hesai_lidar PandarXT-32 rslidar vlp16 "
    "laser_link LIDAR_TOP ouster mid360 rs_16 velodyne_top_base_link sick_scan avia lslidar points_frame"
)
CAMERAS = (
    "camera cam0 CAM_FRONT camera_link camera_color_optical_frame left_camera_optical usb_cam zed2_left_camera_frame "
    "zed_front realsense_d435 d435_link rgb_frame fisheye_rear basler_link kinect2_ir_optical_frame ptz_link"
)
NEITHER = (
    "base_link base_footprint map odom world imu_link os_imu camera_imu_optical_frame camera_gyro_frame camera_init "
    "body chassis gps_link radar_front wheel_left velocity_frame pos_link base_stabilized camera_mount "
    "lidar_mount_link camera_odom_frame velodyne_imu ${prefix}camera_link sensor_kit_base_link "
    "tool0 rear_axle at_home sonar_link"
)


@pytest.mark.parametrize(
    ("names", "lidar", "camera"), [(LIDARS, True, False), (CAMERAS, False, True), (NEITHER, False, False)]
)
def test_names_denote_a_lidar_a_camera_or_neither(names: str, lidar: bool, camera: bool) -> None:
    assert {name: (is_lidar(name), is_camera(name)) for name in names.split()} == dict.fromkeys(
        names.split(), (lidar, camera)
    )


@pytest.mark.parametrize(
    ("name", "body", "optical"),
    [
        ("camera_link", True, False),
        ("camera0/camera_link", True, False),
        ("link", True, False),
        ("camera_optical_link", False, True),
        ("camera_optical_frame", False, True),
        ("camera", False, False),
        ("blink", False, False),
        ("optical/camera_link", True, False),
    ],
)
def test_the_end_of_a_name_states_the_axes(name: str, body: bool, optical: bool) -> None:
    assert (has_body_axes(name), is_optical(name)) == (body, optical)
