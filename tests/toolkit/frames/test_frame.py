from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, Cloud, Dataset, Frame, Image, InputError, se3

CAMERA = Camera.pinhole(5, 5, 3, 2, 7, 5)
IMAGE = Image(np.zeros((5, 7, 3), np.uint8), CAMERA)
CLOUD = Cloud(np.ones((2, 3)))
POSE = se3.exp(np.array([0.1, 0.2, -0.3, 1.0, 2.0, 3.0]))


def test_without_truth_everything_else_stays() -> None:
    frame = Frame("a", IMAGE, CLOUD, camera_from_lidar=POSE, start=POSE, twist=np.ones(6), warnings=("w",))
    blind = frame.without_truth()
    assert blind.camera_from_lidar is None
    assert blind.camera is CAMERA
    assert frame.camera_from_lidar is not None
    assert (blind.name, blind.image, blind.cloud, blind.warnings) == ("a", IMAGE, CLOUD, ("w",))
    assert np.allclose(blind.start, POSE, atol=1e-14)
    assert np.array_equal(blind.twist, np.ones(6))


@pytest.mark.parametrize("name", ["camera_from_lidar", "start"])
@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.eye(3), "has the wrong shape"),
        (np.diag([1.0, 1, -1, 1]), "mirrors space; expected determinant"),
        (np.diag([1.0, 1.1, 1, 1]), "is not orthonormal"),
        (np.full((4, 4), np.nan), "not finite"),
        (np.ones((4, 4)), "the last row of"),
    ],
)
def test_a_pose_that_is_not_rigid_is_refused_with_the_frame(name: str, pose: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=rf"^frame-7: .*{message}"):
        Frame("frame-7", IMAGE, CLOUD, **{name: pose})


@pytest.mark.parametrize("twist", [np.ones(5), np.array([0, 0, 0, np.nan, 0, 0])])
def test_a_twist_has_six_finite_numbers(twist: np.ndarray) -> None:
    with pytest.raises(InputError, match="twist"):
        Frame("a", IMAGE, CLOUD, twist=twist)


def test_a_sequence_of_frames_with_names_is_a_dataset_and_a_list_is_not() -> None:
    class Frames(list[Frame]):
        @property
        def names(self) -> list[str]:
            return [frame.name for frame in self]

    assert isinstance(Frames([Frame("a", IMAGE, CLOUD)]), Dataset)
    assert not isinstance([Frame("a", IMAGE, CLOUD)], Dataset)
