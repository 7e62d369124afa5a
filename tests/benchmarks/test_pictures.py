"""The pictures of the pages are small, shown somewhere, and have the signs that they say."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import p2o
import pytest
from explain import CAMERA_FROM_LIDAR, ERRORS, wrong_by

from tests.pages import ROOT, pages, text_of

GALLERY = ROOT / "docs/gallery"
PICTURES = sorted(path for path in GALLERY.iterdir() if path.suffix in (".jpg", ".png", ".webp"))
MOST_BYTES = {".jpg": 200_000, ".png": 200_000, ".webp": 500_000}


@pytest.mark.parametrize("picture", PICTURES, ids=lambda path: path.name)
def test_a_picture_is_small_and_some_page_shows_it(picture: Path) -> None:
    assert picture.stat().st_size <= MOST_BYTES[picture.suffix]
    assert any(f"gallery/{picture.name}" in text_of(page) for page in pages())


def test_a_picture_of_real_sensors_has_its_notice() -> None:
    real = [path.name for path in PICTURES if path.suffix == ".webp" and not path.name.startswith("record-")]
    assert real == ["crossing.webp", "published-acfr.webp", "published-pjlab-1.webp", "published-pjlab-2.webp"]
    notice = (GALLERY / "NOTICE").read_text(encoding="utf-8")
    assert all(name in notice for name in real)
    assert notice.startswith("crossing.webp")
    assert "Apache License, Version 2.0" in notice
    assert "Apache License" in (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert re.search(r"crossing\.webp\).*\[notice\]\(docs/gallery/NOTICE\)", text_of("README.md"), re.DOTALL)


@pytest.mark.parametrize(("name", "size", "unit"), ERRORS)
def test_the_drawing_of_the_axes_errs_on_one_axis_alone(name: str, size: float, unit: str) -> None:
    error = p2o.pose_error(wrong_by(name, size), CAMERA_FROM_LIDAR)
    expected = dict.fromkeys(error.per_axis, 0.0) | {f"{name}_{unit}": size}
    assert error.per_axis == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "size", "moves"),
    [("pitch", 4.0, (0, -1)), ("yaw", 4.0, (1, 0)), ("x", 0.5, (1, 0)), ("y", 0.5, (0, 1)), ("roll", 10.0, (0, 1))],
)
def test_points_move_in_the_image_as_the_drawing_shows(name: str, size: float, moves: tuple[int, int]) -> None:
    camera = p2o.Camera.pinhole(700, 700, 450, 300, 900, 600)
    # On the right of the middle, where a roll moves things down.
    xyz = p2o.se3.apply(p2o.se3.inverse(CAMERA_FROM_LIDAR), camera.rays(np.array([[800.0, 300]])) * 8)
    before, after = (camera.project(p2o.se3.apply(pose, xyz))[0] for pose in (CAMERA_FROM_LIDAR, wrong_by(name, size)))
    moved = (after - before) / np.linalg.norm(after - before)
    assert moved @ moves > 0.95
