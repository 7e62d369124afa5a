"""Detect directed occlusion edges in one image by a network (paper Sec. III-B): `--extractor p2ornet`."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import p2o
from p2o import SIDES, Float, Frame, Image, ImageExtractor, ImageFeatures, InputError, Method, Options, UInt8, field
from p2o.solving import has_gpu_driver
from pydantic import Field

from p2o_plugins.p2ornet.options import PRESETS, TrainingOptions
from p2o_plugins.p2ornet.shipped import default_weights, weights_named

if TYPE_CHECKING:
    import torch

    from p2o_plugins.p2ornet.design import Shape


class P2ORNetOptions(Options):
    """Network and confidence threshold of the extractor."""

    weights: str = Field(
        default_factory=default_weights,
        description="Weights: free (shipped; trained on simulated places only), kitti (for research only; of the "
        "package p2o-kitti-weights), or a file that p2o train wrote. P2O_WEIGHTS sets another default.",
    )
    min_confidence: float = field(0.05, ge=0, le=1, help="Edges less certain than this are dropped.")
    min_line_px: int = field(5, ge=1, help="Connected edges of fewer pixels than this are dropped, side by side.")
    min_contrast: float = field(
        2.0,
        ge=0,
        le=255,
        help="Edges are dropped where the image changes by less than this within 3 px, in grey levels; 0: off.",
    )
    device: str = field(
        "auto",
        pattern="^(auto|cpu|cuda(:[0-9]+)?)$",
        help="auto takes a GPU where PyTorch sees one, which is asked only where a driver of one is installed; the "
        "processor needs no PyTorch.",
    )


def build(options: P2ORNetOptions) -> ImageExtractor:
    """Return the extractor; the weights are read by this call. Raises InputError if they cannot be read."""
    path = weights_named(options.weights).path
    predict, shape = _predictor(options.device, path)
    slope, offset = _calibration(shape.about.get("calibration", "1 0"), path)

    def extract(image: Image) -> ImageFeatures:
        from p2o_plugins.p2ornet.thinning import peaks, side_probabilities

        maps = side_probabilities(predict(image.rgb))
        # The confidence threshold is mapped back to a score through the calibration, which limits the number of
        # candidates.
        edges = peaks(maps, min_score=0.02)
        confidence = calibrated(edges.score, slope, offset)
        keep = confidence >= options.min_confidence
        height, width = image.rgb.shape[:2]
        u, v = np.clip(edges.pixel.T.astype(np.int64), 0, [[width - 1], [height - 1]])
        if options.min_contrast > 0:
            keep &= contrast(image.rgb)[v, u] >= options.min_contrast
        if image.masked is not None:
            keep &= ~image.masked[v, u]
        edges, confidence = edges.select(keep), confidence[keep]
        long = long_enough(edges.pixel, edges.side, image.rgb.shape[:2], options.min_line_px)
        return ImageFeatures(p2o.ImageEdges(edges.uv[long].astype(np.float32), edges.side[long], confidence[long]))

    return extract


def _calibration(text: str, path: Path) -> tuple[float, float]:
    """Return slope and offset of the score calibration stored in a weights file."""
    try:
        slope, offset = (float(x) for x in text.split())
    except ValueError:
        slope = offset = np.nan
    if not (np.isfinite([slope, offset]).all() and slope > 0):
        raise InputError("unknown calibration of the weights", where=path, expected="slope > 0, offset", got=text)
    return slope, offset


def contrast(rgb: UInt8) -> UInt8:
    """Return the largest change of any channel of an image (H, W, 3) within 3 px of each pixel (H, W), in grey levels.

    Where nothing changes (white on white, a lens cap), no outline is visible, and responses of the network are invalid.
    """
    import cv2

    window = np.ones((7, 7), np.uint8)
    red, green, blue = cv2.split(cv2.subtract(cv2.dilate(rgb, window), cv2.erode(rgb, window)))
    return np.asarray(cv2.max(cv2.max(red, green), blue))


def calibrated(score: Float, slope: float, offset: float) -> Float:
    """Return the probability that an edge of this score is correct: Platt scaling, fitted on validation drives."""
    s = np.clip(score, 1e-4, 1 - 1e-4)
    return np.asarray(1 / (1 + np.exp(-(slope * np.log(s / (1 - s)) + offset))))


def long_enough(pixel: Float, side: Any, size: tuple[int, int], min_line_px: int) -> Any:
    """Return which edge points (N,) belong to connected lines of enough foreground pixels (N, 2)."""
    import cv2

    height, width = size
    u, v = pixel.T.astype(np.int64)
    inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    out = np.zeros(len(pixel), bool)
    for one in SIDES:
        own = np.flatnonzero(inside & (side == one))
        at = v[own] * width + u[own]
        occupied = np.zeros(size, np.uint8)
        occupied.reshape(-1)[at] = 1
        _, piece = cv2.connectedComponents(occupied, connectivity=8)
        # Count pixels instead of points, because several points may share a pixel.
        pixels = np.bincount(piece.reshape(-1)[np.unique(at)], minlength=1)
        out[own] = pixels[piece.reshape(-1)[at]] >= min_line_px
    return out


def _predictor(device: str, path: Path) -> tuple[Callable[[UInt8], Float], Shape]:
    """Return a predictor (see `graph.Predictor`) with the weights of a file, and the shape of its network."""
    from p2o_plugins.p2ornet.weights import load_weights

    tensors, shape = load_weights(path)
    gpu = _gpu(device)
    if gpu is None:
        from p2o_plugins.p2ornet.graph import Predictor

        return Predictor(tensors, shape), shape
    from p2o_plugins.p2ornet.network import P2ORNet, order_probabilities, placed

    return partial(order_probabilities, placed(P2ORNet.of(shape, tensors), gpu)), shape


def _gpu(device: str) -> torch.device | None:
    """Return the GPU to compute on, or None for the CPU, which does not need torch."""
    if device == "cpu" or (device == "auto" and not (has_gpu_driver() and importlib.util.find_spec("torch"))):
        return None
    import torch

    if device == "auto":
        return torch.device("cuda") if torch.cuda.is_available() else None
    if int(device.partition(":")[2] or 0) >= torch.cuda.device_count():
        expected = f"cpu, or one of {torch.cuda.device_count()} GPUs"
        raise InputError("the GPU does not exist", where="device", expected=expected, got=device)
    return torch.device(device)


def label(frame: Frame) -> bytes:
    """Return the content of a label file of a frame; raises InputError for a frame without labels."""
    from p2o_plugins.p2ornet.example import example_of

    example = example_of(frame)
    if not len(example.spans) and (example.classes is None or (example.classes < 0).all()):
        raise InputError(
            "the frame teaches nothing",
            where=frame.name,
            expected="depth, or points that the camera sees",
            got="no pair of pixels of which anything is known",
        )
    return example.packed()


def draw(path: Path) -> UInt8:
    """Return the image (H, W, 3) of a label file."""
    from p2o_plugins.p2ornet.example import Example, drawn

    return drawn(Example.load(path))


def train(*arguments: Any) -> Path:
    """Train on label files and return the weights: see `p2o.Trainer` and `training.train`."""
    from p2o_plugins.p2ornet.training import train

    return train(*arguments)


METHOD = Method(
    name="p2ornet",
    build=build,
    data_files=lambda options: [weights_named(options.weights).path],
    data_licence=lambda options: weights_named(options.weights).licence,
    options=P2ORNetOptions,
    summary="Directed occlusion edges of one image, labelled by a network.",
    gives={"image-edges", "side"},
    parallel=True,
    trainer=p2o.Trainer(options=TrainingOptions, presets=PRESETS, label=label, draw=draw, train=train, label_version=4),
    cite="Wang et al., P2O-Calib, 2023, Sec. III-B; Qiu, Xiao, Wang, Marlet, P2ORM, ECCV 2020",
)
