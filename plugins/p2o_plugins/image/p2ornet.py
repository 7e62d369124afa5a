"""Directed occlusion edges from one picture by a network (paper Sec. III-B): `--extractor p2ornet`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from p2o import (
    SIDES,
    Frame,
    Image,
    ImageEdges,
    ImageExtractor,
    ImageFeatures,
    InputError,
    Method,
    Options,
    Trainer,
    TrainingGroup,
    TrainingProgress,
    field,
)
from p2o.arrays import Float, UInt8
from p2o.native import has_gpu_driver

from p2o_plugins.p2ornet.options import PRESETS, TrainingOptions
from p2o_plugins.p2ornet.shipped import path_of

if TYPE_CHECKING:
    import torch

    from p2o_plugins.p2ornet.design import Shape


class P2ORNetOptions(Options):
    """Which network looks for occlusion edges, and how certain it has to be."""

    weights: str = field(
        "kitti",
        help="Weights: kitti (shipped; for research only), synthetic (shipped; have seen synthetic streets only), or a "
        "file that p2o train wrote.",
    )
    min_confidence: float = field(0.05, ge=0, le=1, help="Edges less certain than this are dropped.")
    min_line_px: int = field(5, ge=1, help="Connected edges of fewer pixels than this are dropped, side by side.")
    min_contrast: float = field(
        2.0,
        ge=0,
        le=255,
        help="Edges are dropped where the picture changes by less than this within 3 px, in grey levels; 0: off.",
    )
    device: str = field(
        "auto",
        pattern="^(auto|cpu|cuda(:[0-9]+)?)$",
        help="auto takes a GPU where PyTorch sees one, which is asked only where a driver of one is installed; the "
        "processor needs no PyTorch.",
    )


def build(options: P2ORNetOptions) -> ImageExtractor:
    """Return the extractor; the weights are read here. Raises InputError if they cannot be."""
    path = path_of(options.weights)
    predict, shape = _predictor(options.device, path)
    slope, offset = _calibration(shape.about.get("calibration", "1 0"), path)

    def extract(image: Image) -> ImageFeatures:
        from p2o_plugins.p2ornet.thinning import peaks, side_probabilities

        maps = side_probabilities(predict(image.rgb))
        # The threshold on confidence, undone through its calibration, keeps the lists short from the start.
        found = peaks(maps, min_score=0.02)
        confidence = calibrated(found.score, slope, offset)
        keep = confidence >= options.min_confidence
        height, width = image.rgb.shape[:2]
        u, v = np.clip(found.pixel.T.astype(np.int64), 0, [[width - 1], [height - 1]])
        if options.min_contrast > 0:
            keep &= contrast(image.rgb)[v, u] >= options.min_contrast
        if image.masked is not None:
            keep &= ~image.masked[v, u]
        found, confidence = found.select(keep), confidence[keep]
        long = long_enough(found.pixel, found.side, image.rgb.shape[:2], options.min_line_px)
        return ImageFeatures(ImageEdges(found.uv[long], found.side[long], confidence[long]))

    return extract


def _calibration(text: str, path: Path) -> tuple[float, float]:
    """Return slope and offset of what a weights file says of its scores."""
    try:
        slope, offset = (float(x) for x in text.split())
    except ValueError:
        slope = offset = np.nan
    if not (np.isfinite([slope, offset]).all() and slope > 0):
        raise InputError("unknown calibration of the weights", where=path, expected="slope > 0, offset", got=text)
    return slope, offset


def contrast(rgb: UInt8) -> UInt8:
    """Return how much any channel of a picture (H, W, 3) changes within 3 px of each pixel (H, W), in grey levels.

    Where nothing changes (white on white, a lens cap), no outline can be seen, whatever a network makes of it.
    """
    import cv2

    window = np.ones((7, 7), np.uint8)
    red, green, blue = cv2.split(cv2.subtract(cv2.dilate(rgb, window), cv2.erode(rgb, window)))
    return np.asarray(cv2.max(cv2.max(red, green), blue))


def calibrated(score: Float, slope: float, offset: float) -> Float:
    """Return the share of edges of this score that are there: Platt scaling, fitted on validation drives."""
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
        there = np.zeros(size, np.uint8)
        there.reshape(-1)[at] = 1
        _, piece = cv2.connectedComponents(there, connectivity=8)
        # Pixels are counted, not points, where several points share one.
        pixels = np.bincount(piece.reshape(-1)[np.unique(at)], minlength=1)
        out[own] = pixels[piece.reshape(-1)[at]] >= min_line_px
    return out


def _predictor(device: str, path: Path) -> tuple[Callable[[UInt8], Float], Shape]:
    """Return what makes probabilities of a picture (see `graph.Predictor`) with a weights file, and its shape."""
    from p2o_plugins.p2ornet.weights import load_weights

    tensors, shape = load_weights(path)
    gpu = _gpu(device)
    if gpu is None:
        from p2o_plugins.p2ornet.graph import Predictor

        return Predictor(tensors, shape), shape
    from p2o_plugins.p2ornet.network import P2ORNet, order_probabilities, placed

    return partial(order_probabilities, placed(P2ORNet.of(shape, tensors), gpu)), shape


def _gpu(device: str) -> torch.device | None:
    """Return the GPU that computes, or None for the processor, for which torch is not imported."""
    if device == "cpu" or (device == "auto" and not has_gpu_driver()):
        return None
    import torch

    if device == "auto":
        return torch.device("cuda") if torch.cuda.is_available() else None
    if int(device.partition(":")[2] or 0) >= torch.cuda.device_count():
        raise InputError(
            "there is no such GPU",
            where="device",
            expected=f"cpu, or one of {torch.cuda.device_count()} GPUs",
            got=device,
        )
    return torch.device(device)


def label(frame: Frame) -> bytes:
    """Return the content of a label file of a frame; raises InputError where the frame teaches nothing."""
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
    """Return the picture (H, W, 3) of a label file."""
    from p2o_plugins.p2ornet.example import Example
    from p2o_plugins.p2ornet.picture import drawn

    return drawn(Example.load(path))


def train(
    options: TrainingOptions,
    groups: Sequence[TrainingGroup],
    validation: Sequence[Path],
    out: Path,
    report: Callable[[TrainingProgress], None],
) -> Path:
    """Train on label files and return the weights: see `p2o.Trainer`."""
    from p2o_plugins.p2ornet import training

    return training.train(options, groups, validation, out, report)


METHOD = Method(
    name="p2ornet",
    build=build,
    options=P2ORNetOptions,
    summary="Directed occlusion edges of one picture, labelled by a network.",
    gives={"image-edges", "side"},
    parallel=True,
    trainer=Trainer(options=TrainingOptions, presets=PRESETS, label=label, draw=draw, train=train, label_version=3),
    cite="Wang et al., P2O-Calib, 2023, Sec. III-B; Qiu, Xiao, Wang, Marlet, P2ORM, ECCV 2020",
)
