"""P2ORNet: pairwise occlusion orders of neighbouring pixels (P2ORM, ECCV 2020; P2O-Calib, Sec. III-B)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from p2o import Float, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from p2o_plugins.p2ornet.design import CLASSES, INCLINATIONS, Shape
from p2o_plugins.p2ornet.encoders import ENCODERS, EfficientNetLite0, ResNet50


class DoubleConv(nn.Sequential):
    """Twice a 3x3 convolution with batch norm and ReLU."""

    def __init__(self, inputs: int, outputs: int) -> None:
        layers: list[nn.Module] = []
        for c in (inputs, outputs):
            layers += [nn.Conv2d(c, outputs, 3, padding=1), nn.BatchNorm2d(outputs), nn.ReLU(inplace=True)]
        super().__init__(*layers)


class Up(nn.Module):
    """One step of the decoder: transposed convolution to the skip map's size, concatenation, double convolution."""

    def __init__(self, inputs: int, skip: int, outputs: int) -> None:
        super().__init__()
        self.deconv = nn.ConvTranspose2d(inputs, inputs, 3, 2, 1)
        self.conv = DoubleConv(skip + inputs, outputs)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        """Return features (N, outputs, h, w) of the size of `skip` (N, skip, h, w)."""
        y: Tensor = self.conv(torch.cat([skip, self.deconv(x, output_size=skip.shape[2:])], dim=1))
        return y


class P2ORNet(nn.Module):
    """A U-Net over an encoder, with one 3-class head per inclination.

    `widths` are the channels of the decoder from fine to coarse, the middle last. `cell` is the side in pixels of the
    finest map's cells: 1 works at full resolution as the paper does; 2 works at half and lets every cell answer for
    its 2 x 2 pixels, which costs a quarter. The image itself enters at that resolution too.
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self, encoder: ResNet50 | EfficientNetLite0, widths: tuple[int, ...], cell: int = 1, connectivity: int = 4
    ) -> None:
        super().__init__()
        plan = encoder.plan
        self.encoder, self.cell, self.inclinations = encoder, cell, INCLINATIONS[connectivity]
        self.register_buffer("mean", torch.tensor(plan.mean).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(plan.std).view(1, 3, 1, 1), persistent=False)
        self.picture = DoubleConv(3 * cell * cell, widths[0])
        skips = [widths[0], *plan.channels[:-1]]
        if plan.strides[0] == cell:  # the encoder's own finest map has the resolution of the image's
            skips = [widths[0] + plan.channels[0], *plan.channels[1:-1]]
        self.middle = DoubleConv(plan.channels[-1], widths[-1])
        below = (*widths[1:-1], widths[-1])
        self.ups = nn.ModuleList(
            Up(lower, skip, width) for lower, skip, width in zip(below, skips, widths[:-1], strict=True)
        )
        self.heads = nn.Conv2d(widths[0], CLASSES * len(self.inclinations) * cell * cell, 1)

    @classmethod
    def of(cls, shape: Shape, tensors: Mapping[str, NDArray[Any]] | None = None) -> P2ORNet:
        """Return a network of this shape, with random weights or, ready to predict, with those of a file."""
        network = cls(ENCODERS[shape.encoder](), shape.widths, shape.cell, shape.connectivity)
        if tensors is not None:
            network.load_state_dict({name: torch.from_numpy(value) for name, value in tensors.items()})
            network.eval()
        return network

    def tensors(self) -> dict[str, NDArray[Any]]:
        """Return weights and statistics by name, as in a weights file."""
        return {name: value.detach().cpu().numpy() for name, value in self.state_dict().items()}

    def forward(self, rgb: Tensor) -> Tensor:
        """Return logits (N, inclinations, 3, H, W) of images (N, 3, H, W) in 0..1, of any size."""
        height, width = rgb.shape[2:]
        x = (rgb - self.mean) / self.std
        step = max(self.cell, self.encoder.plan.multiple)
        x = F.pad(x, (0, -width % step, 0, -height % step), mode="replicate")
        maps = self.encoder(x)
        finest = self.picture(F.pixel_unshuffle(x, self.cell))
        if self.encoder.plan.strides[0] == self.cell:
            maps[0] = torch.cat([finest, maps[0]], dim=1)
        else:
            maps = [finest, *maps]
        y = self.middle(maps[-1])
        for up, skip in zip(reversed(self.ups), reversed(maps[:-1]), strict=True):
            y = up(y, skip)
        logits = F.pixel_shuffle(self.heads(y), self.cell)[..., :height, :width]
        return logits.reshape(len(rgb), len(self.inclinations), CLASSES, height, width)


def placed(network: P2ORNet, device: torch.device) -> P2ORNet:
    """Return the network on a device, in place, its maps with channels last: quicker, the same numbers."""
    # torch's stubs do not know this argument of Module.to.
    moved: P2ORNet = network.to(device, memory_format=torch.channels_last)  # type: ignore[call-overload]
    return moved


def order_probabilities(network: P2ORNet, rgb: UInt8) -> Float:
    """Return probabilities (inclinations, 2, H, W) of each pair of pixels of an image (H, W, 3).

    As `graph.Predictor` does, on the device of the network.
    """
    device = next(network.parameters()).device
    with torch.inference_mode():
        x = torch.from_numpy(np.array(rgb, order="C")).to(device).permute(2, 0, 1)[None]
        x = x.to(torch.float32).div_(255).contiguous(memory_format=torch.channels_last)
        probability = network(x).softmax(dim=2)[0, :, :: CLASSES - 1]
    return np.asarray(probability.cpu().numpy(), dtype=np.float32)
