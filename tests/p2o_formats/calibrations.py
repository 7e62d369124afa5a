"""Poses and cameras that calibration files are tested with, and files read back from bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from p2o import Camera, se3
from p2o.calibration_files.calibration import Calibration, Reading, Source
from p2o.geometry.rpy import rotation_of
from p2o.host.calibration_file import recognised
from p2o.host.guard import build
from p2o.host.registry import Registry
from p2o_formats.format import Format
from p2o_formats.formats import FORMATS

KITTI_LIKE = se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0.06, -0.08, -0.27])
REGISTRY = Registry.load(["p2o-calib"], environ={})
PINHOLE = Camera.pinhole(700, 701, 320.25, 119.75, 640, 240)

SAMPLES = Path(__file__).with_name("samples")
"""Files as other tools write them."""


def sample(name: str) -> str:
    return (SAMPLES / name).read_text(encoding="utf-8")


def coordinates() -> st.SearchStrategy[float]:
    return st.floats(-50, 50, allow_nan=False)


def rotations() -> st.SearchStrategy[np.ndarray]:
    """Any rotation: by quaternion, by right angles (gimbal lock among them), and within rounding of those."""
    quaternion = st.tuples(*(st.floats(-1, 1) for _ in range(4))).filter(lambda q: np.linalg.norm(q) > 0.1)
    quarter = st.tuples(*(st.integers(-2, 2) for _ in range(3)))
    near = st.tuples(quarter, st.floats(-1e-6, 1e-6), st.floats(-1e-9, 1e-9), st.floats(-4, 4))
    return st.one_of(
        quaternion.map(_of_quaternion),
        quarter.map(lambda n: rotation_of(*(np.pi / 2 * k for k in n))),
        near.map(lambda v: rotation_of(np.pi / 2 * v[0][0] + v[3], np.pi / 2 * v[0][1] + v[1], v[0][2] + v[2])),
    )


def _of_quaternion(q: tuple[float, ...]) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(q).as_matrix())


def poses() -> st.SearchStrategy[np.ndarray]:
    return st.builds(se3.make, rotations(), st.tuples(coordinates(), coordinates(), coordinates()))


def cameras(*models: str) -> st.SearchStrategy[Camera]:
    focal, k, p = st.floats(50, 3000), st.floats(-0.3, 0.3), st.floats(-0.01, 0.01)
    parts = {
        "SIMPLE_PINHOLE": (focal, *_middle()),
        "PINHOLE": (focal, focal, *_middle()),
        "SIMPLE_RADIAL": (focal, *_middle(), k),
        "RADIAL": (focal, *_middle(), k, k),
        "OPENCV": (focal, focal, *_middle(), k, k, p, p),
        "FULL_OPENCV": (focal, focal, *_middle(), k, k, p, p, k, k, k, k),
        "SIMPLE_FISHEYE": (focal, *_middle()),
        "FISHEYE": (focal, focal, *_middle()),
        "SIMPLE_RADIAL_FISHEYE": (focal, *_middle(), k),
        "RADIAL_FISHEYE": (focal, *_middle(), k, k),
        "OPENCV_FISHEYE": (focal, focal, *_middle(), k, k, k, k),
        "FOV": (focal, focal, *_middle(), st.floats(0.1, 1.5)),
        "EUCM": (focal, focal, *_middle(), st.floats(0.1, 0.9), st.floats(0.5, 2)),
        "DIVISION": (focal, focal, *_middle(), k),
    }
    chosen = [st.tuples(st.just(model), st.tuples(*parts[model])) for model in models]
    return st.one_of(chosen).map(lambda both: Camera(both[0], 640, 480, both[1]))


def _middle() -> tuple[st.SearchStrategy[float], ...]:
    return st.floats(100, 500), st.floats(100, 400)


def read_back(form: Format, data: bytes, **reading: Any) -> Calibration:
    """Return the content of a file of the format, which is recognised by its content."""
    source = Source(Path(f"calibration{form.suffix}"), data)
    offer = recognised(source, REGISTRY)
    assert offer.name == form.name
    return build(offer, Reading(**reading)).read(source)


def read_text(text: str, **reading: Any) -> Calibration:
    source = Source(Path("calibration.txt"), text.encode())
    return build(recognised(source, REGISTRY), Reading(**reading)).read(source)


def written(name: str, calibration: Calibration, **options: Any) -> str:
    form = FORMATS[name]
    return form.written(calibration, form.options(**options)).decode()
