"""P2ORNet: pairwise occlusion orders of neighbouring pixels (P2ORM, ECCV 2020; P2O-Calib, Sec. III-B)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from p2o import Float, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from p2o_plugins.p2ornet import design
from p2o_plugins.p2ornet.design import CLASSES, PLANS, Conv, Shape, TensorSizes


class SamePadded(nn.Conv2d):
    """A convolution with TensorFlow's SAME padding, which pads the far side more for odd paddings."""

    def forward(self, x: Tensor) -> Tensor:
        """Return the convolved maps, of size ceil(size / stride)."""
        if self.groups > 1 and self.training and x.device.type == "cpu" and torch.is_autocast_enabled("cpu"):
            # Backward of depthwise convolutions in bfloat16 is several times slower than in single precision.
            with torch.autocast("cpu", enabled=False):
                return self._padded(x.float()).to(x.dtype)
        return self._padded(x)

    def _padded(self, x: Tensor) -> Tensor:
        if self.stride[0] == 1:
            return F.conv2d(x, self.weight, self.bias, 1, self.kernel_size[0] // 2, 1, self.groups)
        pads: list[int] = []
        for size, kernel, stride in zip(x.shape[:1:-1], self.kernel_size[::-1], self.stride[::-1], strict=True):
            total = max((-(-size // stride) - 1) * stride + kernel - size, 0)
            pads += [total // 2, total - total // 2]
        return F.conv2d(F.pad(x, pads), self.weight, self.bias, self.stride, 0, 1, self.groups)


class _Modules(TensorSizes):
    """Layers that record how to create the modules of their weights, by name."""

    def __init__(self) -> None:
        super().__init__()
        self.created_by: dict[str, Callable[[], nn.Module]] = {}

    def convolution(self, x: int, layer: Conv) -> int:
        inputs = x * layer.cell * layer.cell
        self.created_by[layer.name] = partial(
            SamePadded if layer.same else nn.Conv2d,
            inputs,
            layer.outputs,
            layer.kernel,
            layer.stride,
            layer.kernel // 2,
            groups=inputs if layer.depthwise else 1,
            bias=layer.bias,
        )
        if layer.norm:
            self.created_by[layer.norm] = partial(nn.BatchNorm2d, layer.outputs, eps=layer.epsilon)
        return layer.outputs

    def deconvolution(self, x: int, name: str, outputs: int, like: int) -> int:
        self.created_by[name] = partial(nn.ConvTranspose2d, x, outputs, 3, 2, 1)
        return outputs


class Operations:
    """Layers of maps (N, C, h, w), which apply the modules of their names."""

    def __init__(self, modules: nn.Module) -> None:
        self.module = modules.get_submodule

    def convolution(self, x: Tensor, layer: Conv) -> Tensor:
        y: Tensor = self.module(layer.name)(F.pixel_unshuffle(x, layer.cell) if layer.cell > 1 else x)
        y = self.module(layer.norm)(y) if layer.norm else y
        return y if layer.relu is None else F.hardtanh(y, 0, layer.relu, inplace=True)

    def deconvolution(self, x: Tensor, name: str, outputs: int, like: Tensor) -> Tensor:
        y: Tensor = self.module(name)(x, output_size=like.shape[2:])
        return y

    def pooled(self, x: Tensor) -> Tensor:
        return F.max_pool2d(x, 3, 2, 1)

    def added(self, x: Tensor, y: Tensor, *, relu: bool) -> Tensor:
        return F.relu(x + y) if relu else x + y

    def joined(self, x: Tensor, y: Tensor) -> Tensor:
        return torch.cat([x, y], dim=1)

    def heads(self, x: Tensor, name: str, inclinations: int, cell: int) -> Tensor:
        return F.pixel_shuffle(self.module(name)(x), cell)


class P2ORNet(nn.Module):
    """A U-Net over an encoder, with one 3-class head per inclination, as `design.network` describes it.

    `widths` of its shape are the channels of the decoder from fine to coarse, the middle last. `cell` is the side in
    pixels of the finest map's cells: 1 works at full resolution as the paper does; 2 works at half and lets every cell
    answer for its 2 x 2 pixels, which costs a quarter. The image itself enters at that resolution too.
    """

    mean: Tensor
    std: Tensor
    encoder: nn.Module

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.shape, plan = shape, PLANS[shape.encoder]
        self.register_buffer("mean", torch.tensor(plan.mean).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(plan.std).view(1, 3, 1, 1), persistent=False)
        modules = _Modules()
        design.network(modules, 3, shape)
        # The decoder's steps are created, and therefore get random weights, from fine to coarse.
        steps = sorted((name for name in modules.created_by if name.startswith("ups.")), key=lambda n: n.split(".")[1])
        others = [name for name in modules.created_by if not name.startswith("ups.")]
        for name in (*others[:-1], *steps, others[-1]):
            parent: nn.Module = self
            *path, last = name.split(".")
            for part in path:
                if part not in dict(parent.named_children()):
                    parent.add_module(part, nn.Module())
                parent = parent.get_submodule(part)
            parent.add_module(last, modules.created_by[name]())
        for module in self.encoder.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.momentum = plan.momentum

    @classmethod
    def of(cls, shape: Shape, tensors: Mapping[str, NDArray[Any]] | None = None) -> P2ORNet:
        """Return a network of this shape, with random weights or, ready to predict, with those of a file."""
        network = cls(shape)
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
        step = self.shape.multiple
        x = F.pad(x, (0, -width % step, 0, -height % step), mode="replicate")
        logits = design.network(Operations(self), x, self.shape)[..., :height, :width]
        return logits.reshape(len(rgb), -1, CLASSES, height, width)


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
