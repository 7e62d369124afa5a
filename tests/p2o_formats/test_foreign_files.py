"""Files as other tools write them, and files that are damaged, hostile or of another direction."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from p2o import Camera, InputError, Result, Status, se3
from p2o.calibration_files.calibration import Calibration
from p2o.host.calibration_file import read_calibration, read_calibration_file, read_camera_file
from p2o.results.result_json import result_to_json
from p2o_formats.formats import FORMATS

from tests.p2o_datasets.opened import refused
from tests.p2o_formats.calibrations import KITTI_LIKE, PINHOLE, read_back, read_text, sample, written

CAMCHAIN = sample("camchain.yaml")
CHAIN = CAMCHAIN.replace("cam1:", "  T_cam_lidar: [0, -1, 0, 0.06, 0, 0, -1, -0.08, 1, 0, 0, -0.27, 0, 0, 0, 1]\ncam1:")
OPENCV_JSON = json.dumps(
    {"image_width": 1280,
     "camera_matrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": [0] * 9},
     "T_cam_lidar": {"type_id": "opencv-matrix", "rows": 4, "cols": 4, "dt": "d",
                     "data": [0, -1, 0, 0.06, 0, 0, -1, -0.08, 1, 0, 0, -0.27, 0, 0, 0, 1]}}
)  # fmt: skip
OPENCV_XML = sample("opencv.xml")
CAMERA_INFO = sample("camera_info.yaml")
ECHO = sample("camera_info_echo.yaml")
KIT = sample("sensor_kit.yaml")
JOINT = (
    '<robot><joint name="a" type="fixed"><parent link="velodyne"/><child link="camera_link"/>'
    '<origin xyz="0.3 0 0" rpy="0 0 0"/></joint></robot>'
)
LIVO_CONFIG = sample("fast_livo.yaml")
LIVO_RESULT = sample("fast_calib.txt")
LIVO_FISHEYE = sample("vikit_fisheye.yaml")
CALIB_ANYTHING = sample("calib_anything.json")
TRACKING = sample("kitti_tracking.txt")
AUTOWARE_AI = f"""%YAML:1.0
---
CameraExtrinsicMat: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: {se3.inverse(KITTI_LIKE).ravel().tolist()}
CameraMat: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 700., 0., 320., 0., 700., 240., 0., 0., 1. ]
DistCoeff: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.1, 0.01, 0., 0., 0. ]
ImageSize: [ 640, 480 ]
DistModel: plumb_bob
"""
KITTI_RAW = sample("kitti_raw.txt")
LIVO_SEVERAL = LIVO_RESULT.replace("\n\n", "\nRMSE: 0.0041 m\nScenes_used: 3\n")
LIVO_TWO = LIVO_CONFIG.replace("extrin_calib", "left") + LIVO_CONFIG.replace("extrin_calib", "right").replace(
    "0.06", "0.5"
)
LIVO_FISHEYE_LENS = (351.3, 351.4, 367.8, 253.8, -0.037, -0.009, 0.009, -0.004)
LIVO_FISHEYE_WITHOUT_SIZE = LIVO_FISHEYE.replace("cam_width: 720\ncam_height: 540\n", "")
CALIB_ANYTHING_RESULT = f"Estimate extrinsic Matrix: \n{KITTI_LIKE.tolist()}".replace("], [", "],\n[")
KITTI_DISTORTION = (-0.3, 0.1, 0.001, 0.001, -0.05, 0, 0, 0)


@pytest.mark.parametrize(
    ("text", "reading", "pose"),
    [
        (
            "static_transform_publisher --frame-id cam0 --child-frame-id lidar --roll 0 --pitch 0 --z -0.3",
            {},
            se3.make(translation=[0, 0, -0.3]),
        ),
        (AUTOWARE_AI, {}, KITTI_LIKE),
        (json.dumps({"T_lidar_cam": se3.inverse(KITTI_LIKE).tolist()}), {}, KITTI_LIKE),
        (LIVO_RESULT, {}, KITTI_LIKE),
        (LIVO_SEVERAL, {}, KITTI_LIKE),
        (LIVO_TWO, {"name": "right"}, se3.make(KITTI_LIKE[:3, :3], [0.5, -0.08, -0.27])),
        (CALIB_ANYTHING, {}, KITTI_LIKE),
        (CALIB_ANYTHING_RESULT, {}, KITTI_LIKE),
        (OPENCV_JSON, {}, KITTI_LIKE),
        # Kalibr: the camera has the LiDAR of the previous one.
        (CHAIN, {"name": "cam1"}, se3.make(translation=[-0.11, 0, 0]) @ KITTI_LIKE),
        ("\n".join(f"- {row}  # row" for row in KITTI_LIKE.tolist()), {}, KITTI_LIKE),
    ],
)
def test_transforms_as_other_tools_write_them(text: str, reading: dict[str, str], pose: np.ndarray) -> None:
    np.testing.assert_allclose(read_text(text, **reading).extrinsic(), pose, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "inverted"),
    [("calib_cam_to_velo", True), ("T_lidar_camera", True), ("lidar2cam0", False), ("cam_to_cam", False), ("a", False)],
)
def test_the_name_of_a_matrix_states_its_direction(tmp_path: Path, name: str, inverted: bool) -> None:
    path = tmp_path / f"{name}.txt"
    path.write_text(" ".join(map(str, KITTI_LIKE[:3].ravel())))
    found = read_calibration_file(path)
    np.testing.assert_allclose(found.extrinsic(), se3.inverse(KITTI_LIKE) if inverted else KITTI_LIKE, atol=1e-12)
    assert len(found.remarks) == 1
    stated = read_calibration_file(path, options={"direction": "camera_from_lidar"})
    np.testing.assert_array_equal(stated.extrinsic(), KITTI_LIKE)


def test_bytes_that_are_no_text_and_transforms_of_the_imu_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_bytes("T_lidar_cam: é".encode("utf-16"))
    with refused("got bytes that are not UTF-8 text"):
        read_calibration_file(path)
    path = tmp_path / "calib_imu_to_velo.txt"
    path.write_text("R: 1 0 0 0 1 0 0 0 1\nT: -0.81 0.32 -0.8\n")
    with refused("map the IMU to the LiDAR"):
        read_calibration_file(path)


LIVO_LENS = (1293.56944, 1293.3155, 626.91359, 522.799224, -0.076160, 0.123001, -0.00113, 0.000251)
ANYTHING_LENS = (1200, 1201, 960.5, 540.25, -0.1, 0.02, 0.001, -0.002)
RADTAN = CAMCHAIN, {"name": "cam0"}
EQUIDISTANT = CAMCHAIN.replace("equidistant", "KannalaBrandt4"), {"name": "cam1"}


@pytest.mark.parametrize(
    ("text", "reading", "model", "width", "height", "params"),
    [
        (*RADTAN, "OPENCV", 752, 480, (458.6, 457.3, 367.2, 248.4, -0.28, 0.07, 0.0002, 0.00002)),
        (*EQUIDISTANT, "OPENCV_FISHEYE", 752, 480, (457.6, 456.1, 379.9, 255.2, 0.01, 0.02, 0.03, 0.04)),
        # The camera of the raw image, not of the rectified one.
        (CAMERA_INFO, {}, "OPENCV", 1280, 720, (700, 705, 640, 360, -0.28, 0.08, 0.001, -0.002)),
        (ECHO, {}, "OPENCV_FISHEYE", 1280, 720, (700, 705, 640, 360, 0.1, 0.01, 0, 0)),
        (ECHO + ECHO, {}, "OPENCV_FISHEYE", 1280, 720, (700, 705, 640, 360, 0.1, 0.01, 0, 0)),
        (ECHO.replace("height: 0, width: 0", "height: 720, width: 1280"), {}, "OPENCV_FISHEYE", 1280, 720,
         (700, 705, 640, 360, 0.1, 0.01, 0, 0)),
        (OPENCV_XML, {}, "OPENCV", 1280, 720, (700, 705, 640, 360, -0.28, 0.08, 0.001, -0.002)),
        (OPENCV_XML.replace("<camera_", "<fisheye_model>1</fisheye_model><camera_", 1), {}, "OPENCV_FISHEYE", 1280, 720,
         (700, 705, 640, 360, -0.28, 0.08, 0.001, -0.002)),
        (KITTI_RAW.replace("02:", "00:"), {}, "PINHOLE", 1242, 375, (700, 700, 600, 180)),
        (KITTI_RAW, {}, "PINHOLE", 1242, 375, (700, 700, 600, 180)),
        (KITTI_RAW, {"name": "02-raw"}, "FULL_OPENCV", 1392, 512, (900, 900, 700, 250, *KITTI_DISTORTION)),
        (AUTOWARE_AI, {}, "OPENCV", 640, 480, (700, 700, 320, 240, -0.1, 0.01, 0, 0)),
        (LIVO_RESULT, {}, "OPENCV", 1280, 1024, LIVO_LENS),
        (LIVO_FISHEYE, {}, "OPENCV_FISHEYE", 720, 540, LIVO_FISHEYE_LENS),
        (LIVO_FISHEYE_WITHOUT_SIZE, {"width": 720, "height": 540}, "OPENCV_FISHEYE", 720, 540, LIVO_FISHEYE_LENS),
        (CALIB_ANYTHING, {"width": 1920, "height": 1080}, "OPENCV", 1920, 1080, ANYTHING_LENS),
    ],
)  # fmt: skip
def test_cameras_of_other_tools(
    text: str, reading: dict[str, Any], model: str, width: int, height: int, params: tuple[float, ...]
) -> None:
    assert read_text(text, **reading).camera == Camera(model, width, height, params)


@pytest.mark.parametrize("text", [CALIB_ANYTHING, LIVO_FISHEYE_WITHOUT_SIZE + LIVO_CONFIG])
def test_a_camera_without_its_size_is_left_out(text: str) -> None:
    assert read_text(text).lacks_image_size


def test_files_name_their_frames_and_state_a_small_skew() -> None:
    assert read_text(CAMERA_INFO).camera_frame == "front"
    assert read_text(ECHO).camera_frame == "camera_front_optical"
    (remark,) = read_text(ECHO.replace("[700.0, 0.0,", "[700.0, 1.0,", 1)).remarks
    assert "the skew 1 of K is neglected; its largest effect in the image is 0.51 px" in remark


def test_sensors_of_a_kit_are_told_by_their_names() -> None:
    with pytest.raises(InputError, match=r"2 frame names denote the camera.*camera0/camera_link, camera1/camera_link"):
        read_text(KIT)
    found = read_text(KIT, name="camera0/camera_link")
    assert found.lidar_frame == "velodyne_top_base_link"
    # By hand: the chain of the three rotations, and the shift of a LiDAR in the kit's origin.
    kit_from_link = se3.make(_rotation(-0.025, 0.315, 1.035), [0.10731, 0.56343, -0.27697])
    kit_from_lidar = se3.make(_rotation(0, 0, 1.575))
    optical_from_link = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]])
    np.testing.assert_allclose(found.extrinsic(), optical_from_link @ se3.inverse(kit_from_link) @ kit_from_lidar)


def _rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix())


def test_names_that_say_nothing_are_asked_for() -> None:
    text = "static_transform_publisher --x 0.3 --frame-id sensor_a --child-frame-id sensor_b"
    for named in ({}, {"camera_frame": "sensor_b"}, {"lidar_frame": "sensor_b"}):
        with pytest.raises(InputError, match=r"no frame names denote the.*sensor_a, sensor_b.*FILE\?lidar_frame=NAME"):
            read_text(text, **named)
    found = read_text(text, lidar_frame="sensor_a", camera_frame="sensor_b")
    np.testing.assert_allclose(found.extrinsic(), se3.make(translation=[-0.3, 0, 0]))
    assert "assumed to be x right, y down" in found.remarks[0]
    found = read_text(text, lidar_frame="sensor_b", camera_frame="sensor_a")
    np.testing.assert_allclose(found.extrinsic(), se3.make(translation=[0.3, 0, 0]))


def test_a_result_of_p2o_says_pose_and_camera(tmp_path: Path) -> None:
    result = Result(("a",), np.eye(4), KITTI_LIKE, Status.CONVERGED, "done", intrinsics=PINHOLE)
    path = tmp_path / "result.json"
    path.write_text(result_to_json(result))
    found = read_calibration_file(path)
    np.testing.assert_array_equal(found.extrinsic(), KITTI_LIKE)
    assert found.camera == PINHOLE
    refused = Result(("a",), np.eye(4), np.eye(4), Status.TOO_FEW_MATCHES, "3 pairs")
    path.write_text(result_to_json(refused))
    with pytest.raises(InputError, match=r"no estimated pose.*too-few-matches"):
        read_calibration_file(path)


def test_the_size_may_be_said_beside_a_file(tmp_path: Path) -> None:
    text = json.loads(written("koide", Calibration(PINHOLE, KITTI_LIKE)))
    del text["camera"]["width"], text["camera"]["height"]
    path = tmp_path / "calib.json"
    path.write_text(json.dumps(text))
    assert read_calibration(str(path)).camera is None
    with pytest.raises(InputError, match=r"no camera in it.*FILE\?width=W&height=H"):
        read_camera_file(str(path))
    assert read_camera_file(f"{path}?width=640&height=240") == PINHOLE


def test_a_file_without_a_camera_is_not_blamed_on_the_size(tmp_path: Path) -> None:
    path = tmp_path / "pose.npy"
    np.save(path, KITTI_LIKE)
    assert read_calibration(str(path)).remarks
    with pytest.raises(InputError, match=r"the file has no camera; expected intrinsics of a camera$"):
        read_camera_file(str(path))


# ---- damaged and hostile

TEXT = written("text", Calibration(None, KITTI_LIKE))
STATED = written("matrix", Calibration(None, KITTI_LIKE), direction="lidar_from_camera")
BAD = {
    "mirrors space": KITTI_LIKE @ np.diag([1.0, 1, -1, 1]),
    "not orthonormal": KITTI_LIKE @ np.diag([1.1, 1, 1, 1]),
    "too long": se3.make(KITTI_LIKE[:3, :3], [1e12, 0, 0]),
    "last row": KITTI_LIKE + np.array([[0, 0, 0, 0]] * 3 + [[1, 0, 0, 0]]),
    "last row .* is wrong; expected 0 0 0 1; .*transpose the matrix.*rigid3d": KITTI_LIKE.T,
}


@pytest.mark.parametrize("name", ["fast-livo", "kalibr", "kitti", "matrix", "npy", "opencalib", "opencv", "text"])
@pytest.mark.parametrize("fault", BAD)
def test_what_is_no_rigid_transform_is_refused(name: str, fault: str) -> None:
    if name in ("fast-livo", "kitti") and "last row" in fault:
        return  # These formats have three rows.
    calibration = Calibration(PINHOLE, KITTI_LIKE)
    object.__setattr__(calibration, "camera_from_lidar", BAD[fault])
    form = FORMATS[name]
    data = f"camera_from_lidar: {BAD[fault].tolist()}".encode() if name == "text" else form.written(calibration)
    with refused(fault, "calibration."):
        read_back(form, data)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("static_transform_publisher --x nan --frame-id lidar --child-frame-id camera", "--x is not a number"),
        ("static_transform_publisher --x 1e999 --frame-id lidar --child-frame-id camera", "--x is not a number"),
        ("static_transform_publisher --qx 1 --qw 1 --frame-id lidar --child-frame-id cam", "not a rotation"),
        ("static_transform_publisher --x 1 --frame-id lidar", "--child-frame-id"),
        ("static_transform_publisher", "the file has no transform"),
        (JOINT.replace("0.3 0 0", "0.3 0"), "translation_m"),
        ('<!DOCTYPE a [<!ENTITY b "c">]>' + JOINT, "DOCTYPE"),
        ("<robot><joint>", "not XML"),
        (CAMERA_INFO.replace("700.,", ".nan,"), "not an intrinsic matrix"),
        (CAMERA_INFO.replace("-0.28, 0.08, ", ""), "does not fit plumb_bob"),
        (CAMERA_INFO.replace("image_width: 1280", "image_width: 1e9"), "image size|too many pixels"),
        (CAMCHAIN, r"contains several cameras.*FILE#NAME with one of cam0, cam1"),
        (CAMCHAIN.partition("cam1")[0].replace("camera_model: pinhole", "camera_model: omni"), "omni with radtan"),
        (ECHO.replace("binning_x: 0", "binning_x: 2"), "binned or cropped"),
        (ECHO.replace("width: 0,", "width: 100,"), "binned or cropped"),
        (KIT.replace("yaw: 1.575", "yaw: .inf").replace("camera1/camera_link", "radar_link"), "rpy_rad"),
        ('{"results": {"T_lidar_camera": [0, 0, 0, 0, 0, 0, 0]}}', "quaternion"),
        ('{"results": {"T_lidar_camera": [0, 0, 0, 1]}}', "x y z qx qy qz qw"),
        ('{"results": {"T_lidar_camera": [NaN, 0, 0, 0, 0, 0, 1]}}', "x y z qx qy qz qw"),
        ("1 PINHOLE 640 480 500 500 320", "a different number of parameters"),
        ("1 NOSUCH 640 480 500 500 320 240", "NOSUCH"),
        ("1 PINHOLE 640 480 500 inf 320 240", "not numbers"),
        ("hello", "no calibration reader recognises this file"),
        ("{" * 2000, "no calibration reader recognises this file"),
        ("a: &x [1]\nb: *x", "alias"),
        ("camera_from_lidar: !!python/object:os.system []", "objects"),
        ('[{"cameras": [{"image_prefix": "a/", "ref_sensor": true}, {"image_prefix": "b/"}]}]',
         "no frame names denote the LiDAR"),
        (json.dumps(dict.fromkeys(("T_cam_lidar", "T_lidar_cam"), KITTI_LIKE.tolist())), "are not the same transform"),
        (TEXT.replace("rpy_deg: [0.0, -90.0", "rpy_deg: [1.0, -90.0"), "are not the same transform"),
        (LIVO_RESULT.replace("Pinhole", "ATANCamera"), "cam_model is not supported; expected Pinhole or Equidistant"),
        (LIVO_RESULT.replace("1293.3155", ".nan"), "cam_fy .* are not numbers"),
        (LIVO_CONFIG.replace("-0.27", ".inf"), "translation_m is not valid"),
        (LIVO_CONFIG.replace("1.0, 0.0, 0.0]", "1.0, 0.5, 0.0]"), "not orthonormal"),
        (LIVO_TWO, "several cameras; expected FILE#SECTION with one of left, right"),
        (CALIB_ANYTHING.replace("[1, 0, 0, -0.27]", "[1, 0, -0.27]"), "T_lidar_to_cam is not a pose"),
        ("Estimate extrinsic Matrix: \n[[1, 2], [3, 4]]", "the extrinsic is not a pose"),
        (TRACKING.replace("R_rect 0.9999239", "R_rect x"), "this is not a KITTI calibration file"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(text: str, message: str) -> None:
    with refused(message):
        read_text(text)


@pytest.mark.parametrize(
    ("text", "reading", "message"),
    [
        (CAMCHAIN, {"name": "cam7"}, "there is no camera 'cam7'"),
        (CALIB_ANYTHING, {"name": "gt"}, "T_lidar_to_cam_gt is not available"),
        (STATED, {"direction": "camera_from_lidar"}, "the file states another direction"),
        (
            TEXT,
            {"direction": "lidar_from_camera"},
            "direction does not apply to text; expected no field; got lidar_from",
        ),
        (TEXT, {"name": "cam7"}, "name does not apply to text"),
        (
            KITTI_RAW,
            {"direction": "lidar_from_camera"},
            "direction does not apply to kitti; expected height, name, width",
        ),
        (JOINT, {"direction": "lidar_from_camera"}, "the frames of the file state the direction"),
        (CAMERA_INFO, {"width": 640, "height": 720}, "the file states another image size; expected 1280 px; got 640"),
    ],
)
def test_a_reading_that_contradicts_the_file_is_refused(text: str, reading: dict[str, str], message: str) -> None:
    with refused(message):
        read_text(text, **reading)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    with path.open("wb") as file:
        file.truncate(17 << 20)
    with pytest.raises(InputError, match="too large"):
        read_calibration_file(path)


def test_launch_files_are_never_run(tmp_path: Path) -> None:
    trap = tmp_path / "trap"
    text = f"open({str(trap)!r}, 'w')\n" + written("ros2", Calibration(None, KITTI_LIKE), form="launch")
    np.testing.assert_allclose(read_text(text).extrinsic(), KITTI_LIKE, atol=1e-9)
    assert not trap.exists()


def test_names_of_frames_cannot_hold_commands() -> None:
    for name in ("a; rm -rf /", "a b", '"', "$(x)", "a\nb", "", "-x"):
        with pytest.raises(ValueError, match="camera_frame"):
            FORMATS["ros2"].options(camera_frame=name)


@pytest.mark.parametrize("sections", [["extrin_calib"], ["camera"], ["/**", "ros__parameters", "extrin_calib"], []])
def test_rcl_and_pcl_of_fast_livo_are_camera_from_lidar_in_every_section(sections: list[str]) -> None:
    tree = yaml.safe_load(LIVO_CONFIG)["extrin_calib"]
    for section in reversed(sections):
        tree = {section: tree, "common": {"img_en": 1}}
    found = read_text(yaml.safe_dump(tree))
    np.testing.assert_allclose(found.extrinsic(), KITTI_LIKE, atol=1e-12)
    assert found.camera is None


def test_the_keys_of_kitti_tracking_have_no_colon() -> None:
    found = read_text(TRACKING, name="P2", width=1242, height=375)
    position = se3.inverse(found.extrinsic())[:3, 3]
    np.testing.assert_allclose(position, [0.270, 0.058, -0.072], atol=5e-4)
    assert found.camera == Camera.pinhole(721.5377, 721.5377, 609.5593, 172.854, 1242, 375)
    with_colons = TRACKING.replace("R_rect", "R0_rect:").replace("Tr_velo_cam", "Tr_velo_to_cam:")
    with_colons = with_colons.replace("Tr_imu_velo", "Tr_imu_to_velo:")
    np.testing.assert_array_equal(read_text(with_colons).extrinsic(), found.extrinsic())


@pytest.mark.parametrize(("skew", "said"), [("-0.2359", "0.066 px"), ("2.0", "0.56 px")])
def test_the_skew_of_a_projection_of_kitti_is_stated(skew: str, said: str) -> None:
    text = TRACKING.replace("721.5377 0 609.5593 44", f"721.5377 {skew} 609.5593 44")
    (remark,) = read_text(text, name="P2", width=1242, height=375).remarks
    assert f"the skew {float(skew):g} of P2 is neglected; its largest effect in the image is {said}" in remark
    with pytest.raises(InputError, match=r"skew of 8, which shifts pixels by up to 2\.2 px"):
        read_text(text.replace(skew, "8.0"), name="P2", width=1242, height=375)
