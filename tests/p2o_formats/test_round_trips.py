"""Whatever is written is read back: every form, any rotation, every camera that the form has a name for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from p2o import Camera, InputError
from p2o.calibration_files.calibration import CAMERA, EXTRINSIC, Calibration
from p2o_formats.formats import FORMATS

from tests.p2o_formats.calibrations import KITTI_LIKE, PINHOLE, cameras, poses, read_back

WRITERS = [form for form in FORMATS.values() if form.write is not None]
TRANSFORMS = [
    *((form.name, {}) for form in WRITERS if EXTRINSIC in form.holds),
    *(
        ("ros2", {"form": form, "parent": parent})
        for form in ("command", "launch", "ros1-command", "ros1-launch", "urdf")
        for parent in ("lidar", "camera")
    ),
    ("ros2", {"form": "urdf", "camera_frame": "front/camera_link"}),
    ("ros2", {"form": "ros1-launch", "camera_frame": "front/camera_link"}),
    ("ros2", {"form": "command", "camera_frame": "cam0", "lidar_frame": "velodyne"}),
    ("autoware", {"base_from_lidar": (0.5, -0.2, 1.1, 0.1, -0.2, 3.0)}),
    ("autoware", {"camera_frame": "camera3/camera_optical_link", "lidar_frame": "livox_front"}),
    *(("kitti", {"layout": layout}) for layout in ("object", "raw", "odometry", "tracking")),
    ("matrix", {"direction": "lidar_from_camera"}),
    ("fast-livo", {"layout": "config"}),
]
OPENCV = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
FISHEYES = ("SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE")
ALL = (*OPENCV, "FULL_OPENCV", *FISHEYES, "FOV", "EUCM", "DIVISION")
HELD = {
    "camera-info": (*OPENCV, "FULL_OPENCV", *FISHEYES),
    "opencv": (*OPENCV, "FULL_OPENCV", *FISHEYES),
    "koide": (*OPENCV, *FISHEYES),
    "fast-livo": (*OPENCV, *FISHEYES),
    "kalibr": (*OPENCV, *FISHEYES, "FOV", "EUCM"),
    "opencalib-camera": OPENCV,
    "colmap": ALL,
    "colmap-cameras": ALL,
    "text": ALL,
}
"""Models that each form has a name for."""
FEW = settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))


@pytest.mark.parametrize(("name", "options"), TRANSFORMS, ids=str)
@FEW
@given(pose=poses())
def test_a_transform_comes_back(name: str, options: dict[str, Any], pose: np.ndarray) -> None:
    form = FORMATS[name]
    data = form.written(Calibration(PINHOLE, pose), form.options(**options))
    found = read_back(form, data)
    np.testing.assert_allclose(found.extrinsic(), pose, rtol=0, atol=1e-9)


def test_a_bare_array_the_other_way_round_is_read_as_it_is_said() -> None:
    form = FORMATS["npy"]
    data = form.written(Calibration(None, KITTI_LIKE), form.options(direction="lidar_from_camera"))
    found = read_back(form, data, direction="lidar_from_camera")
    np.testing.assert_allclose(found.extrinsic(), KITTI_LIKE, atol=1e-12)


def test_every_form_with_room_for_a_camera_is_listed_here() -> None:
    assert {form.name for form in WRITERS if CAMERA in form.holds} == set(HELD)


@pytest.mark.parametrize("name", sorted(HELD))
@FEW
@given(data=st.data())
def test_a_camera_comes_back(name: str, data: st.DataObject) -> None:
    """What is read projects as what was written, and of the same model it has the same parameters."""
    camera = data.draw(cameras(*HELD[name]))
    form = FORMATS[name]
    found = read_back(form, form.written(Calibration(camera, KITTI_LIKE))).intrinsics()
    assert (found.width, found.height) == (camera.width, camera.height)
    if found.model == camera.model:
        np.testing.assert_allclose(found.params, camera.params, rtol=0, atol=1e-9)
    xyz = np.array([[0.1, -0.2, 1.0], [-0.3, 0.1, 2.0], [0.0, 0.0, 1.0], [0.2, 0.3, 1.5]])
    np.testing.assert_allclose(found.project(xyz), camera.project(xyz), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "model"), [(name, model) for name in sorted(HELD) for model in ALL if model not in HELD[name]]
)
def test_a_camera_without_a_name_is_refused(name: str, model: str) -> None:
    params = {"FULL_OPENCV": (0.1,) * 8, "DIVISION": (0.1,), "FOV": (0.9,), "EUCM": (0.5, 1.0)}.get(model, (0.1,) * 4)
    heads = {"SIMPLE_FISHEYE": (500.0,), "SIMPLE_RADIAL_FISHEYE": (500.0,), "RADIAL_FISHEYE": (500.0,)}
    head = heads.get(model, (500.0, 500.0))
    counts = {"SIMPLE_FISHEYE": 0, "FISHEYE": 0, "SIMPLE_RADIAL_FISHEYE": 1, "RADIAL_FISHEYE": 2}
    camera = Camera(model, 640, 480, (*head, 320.0, 240.0, *params[: counts.get(model, len(params))]))
    with pytest.raises(InputError, match=f"{name} has no name for the camera model {model}"):
        FORMATS[name].written(Calibration(camera, KITTI_LIKE))


@pytest.mark.parametrize("form", WRITERS, ids=lambda form: form.name)
def test_what_a_form_needs_has_to_be_there(form: Any) -> None:
    lacking = {CAMERA: Calibration(None, KITTI_LIKE), EXTRINSIC: Calibration(PINHOLE)}
    for part in (CAMERA, EXTRINSIC):
        if part in form.needs or (part in form.holds and len(form.holds) == 1):
            with pytest.raises(InputError, match=f"there is no {part}"):
                form.written(lacking[part])
        else:
            assert form.written(lacking[part] if part in form.holds else Calibration(PINHOLE, KITTI_LIKE))
