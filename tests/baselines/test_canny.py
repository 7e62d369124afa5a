"""`canny` finds grey-level steps, without direction."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import Camera, Image, ImageEdges, InputError
from p2o_baselines.edges.canny import METHOD, CannyOptions


def image(grey: np.ndarray, masked: np.ndarray | None = None) -> Image:
    height, width = grey.shape
    rgb = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
    return Image(rgb, Camera.pinhole(100, 100, width / 2, height / 2, width, height), masked=masked)


def edges(picture: Image, **options: object) -> ImageEdges:
    found = METHOD.build(CannyOptions(**options))(picture).edges
    assert found is not None
    return found


def step(contrast: float = 100.0) -> np.ndarray:
    """80 rows, 100 columns; brighter from column 50 on."""
    return np.where(np.arange(100) < 50, 60.0, 60.0 + contrast) * np.ones((80, 1))


def noisy(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.clip(step() + rng.normal(0, 25, (80, 100)), 0, 255)


def test_a_step_is_found_at_one_of_its_two_pixels_in_every_row() -> None:
    found = edges(image(step()))
    assert np.abs(found.uv[:, 0] - 49.5).max() == 0.5
    assert len(np.unique(found.uv[:, 1])) == len(found) >= 78  # a detector may leave out the image border


def test_a_step_below_the_threshold_is_not_an_edge() -> None:
    """Without blur the Sobel filter gives four times a step."""
    weak = image(step(contrast=30.0))
    assert len(edges(weak, low=10, high=119, blur_sigma_px=0)) > 0
    assert len(edges(weak, low=10, high=121, blur_sigma_px=0)) == 0


def test_blur_removes_the_edges_of_noise() -> None:
    def far(found: ImageEdges) -> int:
        return int((np.abs(found.uv[:, 0] - 49.5) > 4).sum())

    sharp, blurred = (edges(image(noisy()), low=30, high=80, blur_sigma_px=s) for s in (0.0, 2.5))
    assert far(sharp) > 500
    assert far(blurred) < far(sharp) / 20
    assert (np.abs(blurred.uv[:, 0] - 49.5) <= 4).sum() > 60


def test_short_pieces_are_dropped() -> None:
    grey = step()
    grey[20:24, 20:24] = 200  # an outline of some 16 px
    spot = edges(image(grey), min_length_px=5, blur_sigma_px=0)
    assert (spot.uv[:, 0] < 40).any()
    gone = edges(image(grey), min_length_px=40, blur_sigma_px=0)
    assert len(gone) > 0
    assert not (gone.uv[:, 0] < 40).any()


def test_masked_pixels_have_no_edges() -> None:
    masked = np.zeros((80, 100), bool)
    masked[:40] = True
    found = edges(image(step(), masked))
    assert found.uv[:, 1].min() == 40


def test_thresholds_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(InputError, match="low <= high = 50"):
        edges(image(step()), low=100, high=50)
