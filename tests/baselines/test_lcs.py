"""`lcs` keeps what forms lines, circles and squares, and leaves clutter out."""

from __future__ import annotations

import numpy as np
import p2o
import pytest
from p2o_baselines.edges import canny, lcs

BACKGROUND = 40
LINE, CIRCLE, SQUARE, CLUTTER = (
    (slice(0, 85), slice(0, 170)),
    (slice(10, 110), slice(230, 330)),
    (slice(110, 150), slice(20, 60)),
    (slice(115, 240), slice(100, 360)),
)
"""Rows and columns of the picture."""


def image(grey: np.ndarray) -> p2o.Image:
    height, width = grey.shape
    rgb = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
    return p2o.Image(rgb, p2o.Camera.pinhole(100, 100, width / 2, height / 2, width, height))


def shown(*, clutter: bool = True) -> np.ndarray:
    """A picture (240, 360) of a bar, a disc, a square of 20 px and scribbles."""
    import cv2

    grey = np.full((240, 360), BACKGROUND, np.uint8)
    cv2.line(grey, (20, 20), (150, 60), 220, 6, cv2.LINE_AA)
    cv2.circle(grey, (280, 60), 35, 220, -1, cv2.LINE_AA)
    cv2.rectangle(grey, (30, 120), (50, 140), 220, -1)
    rng = np.random.default_rng(0)
    for _ in range(12 if clutter else 0):
        at, way, points = rng.uniform((125, 130), (340, 230)), rng.uniform(0, 2 * np.pi), []
        for _ in range(40):
            way += rng.normal(0, 0.9)
            at = np.clip(at + 3 * np.array([np.cos(way), np.sin(way)]), (120, 130), (345, 232))
            points.append(np.rint(at))
        cv2.polylines(grey, [np.array(points, np.int32)], False, int(rng.integers(120, 255)), 1, cv2.LINE_AA)
    return grey


def kept(grey: np.ndarray) -> np.ndarray:
    """Which pixels are kept."""
    edges = lcs.METHOD.build(canny.CannyOptions())(image(grey)).edges
    assert edges is not None
    out = np.zeros(grey.shape, bool)
    u, v = edges.uv.astype(int).T
    out[v, u] = True
    return out


def share(found: np.ndarray, where: tuple[slice, slice], grey: np.ndarray) -> float:
    """The share of Canny's edges of a part of the picture that is kept."""
    before = canny.edge_pixels(image(grey), canny.CannyOptions())
    assert not (found & ~before).any()
    assert before[where].sum() > 50
    return float(found[where].sum() / before[where].sum())


def test_line_circle_and_square_stay_and_clutter_goes() -> None:
    grey = shown()
    found = kept(grey)
    assert share(found, LINE, grey) > 0.85  # its round ends are no line
    assert share(found, CIRCLE, grey) > 0.85
    assert share(found, SQUARE, grey) > 0.9
    assert share(found, CLUTTER, grey) < 0.1


@pytest.mark.parametrize(
    ("limit", "value", "gone"),
    [("_MIN_LINE_PX", 200.0, LINE), ("_MAX_RADIUS_PX", 20.0, CIRCLE), ("_MIN_SIDE_PX", 25.0, SQUARE)],
)
def test_each_layer_keeps_its_own_shape(
    limit: str, value: float, gone: tuple[slice, slice], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lcs, limit, value)
    grey = shown(clutter=False)
    found = kept(grey)
    for where in (LINE, CIRCLE, SQUARE):
        assert share(found, where, grey) < 0.1 if where is gone else share(found, where, grey) > 0.85


def test_a_line_that_clutter_crosses_stays_whole() -> None:
    pixels = np.zeros((60, 120), bool)
    pixels[30, 10:110] = True
    for column in (30, 52, 71):
        pixels[25:36, column] = True
    found = lcs.shapes(pixels)
    assert found[30, 10:110].sum() >= 97  # but where the others cross
    assert found.sum() < 110


def test_three_sides_are_no_square() -> None:
    pixels = np.zeros((60, 60), bool)
    pixels[20, 20:36] = pixels[35, 20:36] = True
    pixels[20:36, 20] = True
    assert not lcs.shapes(pixels).any()
    pixels[20:36, 35] = True
    assert lcs.shapes(pixels).sum() == 60
