"""Architecture of P2ORNet without torch: shapes, encoders, and one traversal of all layers.

The traversal (`network`) names every layer with its sizes and calls a `Layers` for each: a graph for inference
(`graph.py`), the trainable module (`network.py`), or the list of tensors of a weights file (`tensor_sizes`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, TypeVar

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
INCLINATIONS = {4: ("east", "south"), 8: ("east", "south", "south_east", "north_east")}
"""By connectivity, the neighbours whose order relative to a pixel is predicted; the order of the heads."""
CLASSES = 3
"""Per pair: 0 its first pixel is occluded by the second, 1 neither, 2 the first pixel occludes the second."""
DECODERS: dict[str, tuple[tuple[int, ...], int]] = {
    "resnet50": ((64, 64, 64, 256, 512), 1),
    "efficientnet-lite0": ((32, 48, 64, 96, 128), 2),
}
"""By encoder, the widths of the decoder and the side of its finest cells: the paper's, and one a laptop can run."""


class Block(NamedTuple):
    """A bottleneck of an encoder, by the name of its module: `inputs` to `width` to `outputs` channels."""

    name: str
    inputs: int
    width: int
    outputs: int
    kernel: int
    stride: int


@dataclass(frozen=True)
class EncoderPlan:
    """Properties of an encoder that the rest of the network needs, and its blocks.

    Its maps have `channels` and `strides`, from fine to coarse; odd sizes are rounded up at every step. The size of an
    image must be a multiple of `multiple`, so that maps are aligned independently of the size: SAME padding shifts them
    by half a cell for odd sizes. Normalisation of the image (`mean`, `std`, per colour of an RGB in 0..1) belongs to
    the pretrained weights; `unused` are prefixes of their parameters that the encoder does not have. `epsilon` and
    `momentum` are those of its batch norms. A map is passed on after each of the blocks `taps`.
    """

    channels: tuple[int, ...]
    strides: tuple[int, ...]
    multiple: int
    mean: tuple[float, float, float]
    std: tuple[float, float, float]
    epsilon: float
    blocks: tuple[Block, ...]
    taps: tuple[int, ...]
    momentum: float = 0.1
    unused: tuple[str, ...] = ()


def _resnet50() -> Iterator[Block]:
    inputs = 64
    for layer, (width, count) in enumerate(((64, 3), (128, 4), (256, 6)), start=1):
        for number in range(count):
            stride = 2 if layer > 1 and not number else 1
            yield Block(f"layer{layer}.{number}", inputs, width, 4 * width, 3, stride)
            inputs = 4 * width


_LITE0 = (
    # repeats, kernel, stride, expansion, outputs
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)


def _lite0() -> Iterator[Block]:
    inputs, at = 32, 0
    for repeats, kernel, stride, expansion, outputs in _LITE0:
        for number in range(repeats):
            yield Block(f"_blocks.{at}", inputs, inputs * expansion, outputs, kernel, 1 if number else stride)
            inputs, at = outputs, at + 1


PLANS: dict[str, EncoderPlan] = {
    "resnet50": EncoderPlan(
        channels=(64, 256, 512, 1024),
        strides=(2, 4, 8, 16),
        multiple=1,
        mean=IMAGENET_MEAN,
        std=IMAGENET_STD,
        epsilon=1e-5,
        blocks=tuple(_resnet50()),
        taps=(2, 6, 12),
        unused=("layer4.", "fc."),
    ),
    "efficientnet-lite0": EncoderPlan(
        channels=(16, 24, 40, 112, 320),
        strides=(2, 4, 8, 16, 32),
        multiple=32,
        mean=(127 / 255,) * 3,
        std=(128 / 255,) * 3,
        epsilon=1e-3,
        blocks=tuple(_lite0()),
        taps=(0, 2, 4, 10, 15),
        momentum=0.01,
        unused=("_conv_head.", "_bn1.", "_fc."),
    ),
}
"""The encoders by their name in weights files and in `p2o train`."""


@dataclass(frozen=True)
class Shape:
    """The network described by a weights file: see `network.P2ORNet`.

    `about` is free text by key (data, licence, steps).
    """

    encoder: str
    widths: tuple[int, ...]
    cell: int
    connectivity: int = 4
    about: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, encoder: str, connectivity: int = 4) -> Shape:
        """Return the usual shape with this encoder."""
        widths, cell = DECODERS[encoder]
        return cls(encoder, widths, cell, connectivity)

    @property
    def multiple(self) -> int:
        """Multiple to which the size of an image is padded, in pixels, by repeating its border."""
        return max(self.cell, PLANS[self.encoder].multiple)


Map = TypeVar("Map")


class Conv(NamedTuple):
    """A convolution padded by half a kernel (`same`: as TensorFlow does), then batch norm `norm`, then ReLU to `relu`.

    `name` is that of the module with the weights. With a `cell` over 1, the kernel runs over the cells of the image,
    whose pixels count as channels.
    """

    name: str
    outputs: int
    kernel: int = 1
    stride: int = 1
    depthwise: bool = False
    same: bool = False
    bias: bool = False
    norm: str = ""
    epsilon: float = 1e-5
    cell: int = 1
    relu: float | None = None


class Layers(Protocol[Map]):
    """The operation of each layer of the traversal.

    Layers have biases if no batch norm follows, and in the decoder.
    """

    def convolution(self, x: Map, layer: Conv) -> Map:
        """Convolve."""
        ...

    def deconvolution(self, x: Map, name: str, outputs: int, like: Map) -> Map:
        """Double the size of a map to that of another one: a transposed convolution of 3 x 3."""
        ...

    def pooled(self, x: Map) -> Map:
        """Return the maximum over 3 x 3 at every second place."""
        ...

    def added(self, x: Map, y: Map, *, relu: bool) -> Map:
        """Return the sum of two maps."""
        ...

    def joined(self, x: Map, y: Map) -> Map:
        """Return the channels of two maps, those of the first one first."""
        ...

    def heads(self, x: Map, name: str, inclinations: int, cell: int) -> Map:
        """Return the answers, whose channels run over inclinations, CLASSES and pixels of a cell, the last fastest."""
        ...


INFINITY = float("inf")
"""The bound of a ReLU without one."""


def network(on: Layers[Map], image: Map, shape: Shape) -> Map:
    """Return the outputs of the heads for a normalised image, whose size is a multiple of `shape.multiple`."""
    plan, cell, widths = PLANS[shape.encoder], shape.cell, shape.widths
    maps = ENCODERS[shape.encoder](on, image, plan)
    finest = _doubled(on, image, "picture", widths[0], cell)
    if plan.strides[0] == cell:  # the encoder's own finest map has the resolution of the image's
        maps[0] = on.joined(finest, maps[0])
    else:
        maps = [finest, *maps]
    y, inputs = _doubled(on, maps[-1], "middle", widths[-1]), widths[-1]
    for number in reversed(range(len(maps) - 1)):
        lifted = on.deconvolution(y, f"ups.{number}.deconv", inputs, maps[number])
        inputs = widths[number]
        y = _doubled(on, on.joined(maps[number], lifted), f"ups.{number}.conv", inputs)
    return on.heads(y, "heads", len(INCLINATIONS[shape.connectivity]), cell)


def _doubled(on: Layers[Map], x: Map, name: str, outputs: int, cell: int = 1) -> Map:
    x = on.convolution(x, Conv(f"{name}.0", outputs, 3, bias=True, norm=f"{name}.1", cell=cell, relu=INFINITY))
    return on.convolution(x, Conv(f"{name}.3", outputs, 3, bias=True, norm=f"{name}.4", relu=INFINITY))


def _resnet_maps(on: Layers[Map], x: Map, plan: EncoderPlan) -> list[Map]:
    """ResNet (He et al., CVPR 2016), version 1.5: the stride is that of the 3x3 convolution; torchvision's names."""
    half = on.convolution(x, Conv("encoder.conv1", 64, 7, 2, norm="encoder.bn1", relu=INFINITY))
    maps, x = [half], on.pooled(half)
    for number, block in enumerate(plan.blocks):
        name, y = f"encoder.{block.name}", x
        y = on.convolution(y, Conv(f"{name}.conv1", block.width, norm=f"{name}.bn1", relu=INFINITY))
        y = on.convolution(y, Conv(f"{name}.conv2", block.width, 3, block.stride, norm=f"{name}.bn2", relu=INFINITY))
        y = on.convolution(y, Conv(f"{name}.conv3", block.outputs, norm=f"{name}.bn3"))
        if block.stride != 1 or block.inputs != block.outputs:
            down = f"{name}.downsample"
            x = on.convolution(x, Conv(f"{down}.0", block.outputs, 1, block.stride, norm=f"{down}.1"))
        x = on.added(y, x, relu=True)
        if number in plan.taps:
            maps.append(x)
    return maps


def _lite0_maps(on: Layers[Map], x: Map, plan: EncoderPlan) -> list[Map]:
    """EfficientNet-lite0 without squeeze-and-excitation; names are those of the weights' package."""
    e, maps = plan.epsilon, []
    x = on.convolution(x, Conv("encoder._conv_stem", 32, 3, 2, same=True, norm="encoder._bn0", epsilon=e, relu=6))
    for number, block in enumerate(plan.blocks):
        name, y, width = f"encoder.{block.name}", x, block.width
        if width != block.inputs:
            y = on.convolution(y, Conv(f"{name}._expand_conv", width, norm=f"{name}._bn0", epsilon=e, relu=6))
        depthwise = Conv(f"{name}._depthwise_conv", width, block.kernel, block.stride, depthwise=True, same=True)
        y = on.convolution(y, depthwise._replace(norm=f"{name}._bn1", epsilon=e, relu=6))
        y = on.convolution(y, Conv(f"{name}._project_conv", block.outputs, norm=f"{name}._bn2", epsilon=e))
        x = on.added(x, y, relu=False) if block.stride == 1 and block.inputs == block.outputs else y
        if number in plan.taps:
            maps.append(x)
    return maps


ENCODERS = {"resnet50": _resnet_maps, "efficientnet-lite0": _lite0_maps}
"""The traversals of the encoders by name, which return their maps from fine to coarse."""


class TensorSizes:
    """Layers that record only the tensors they need; a map is represented by its number of channels."""

    def __init__(self) -> None:
        self.tensors: dict[str, tuple[int, ...]] = {}

    def convolution(self, x: int, layer: Conv) -> int:
        inputs = 1 if layer.depthwise else x * layer.cell * layer.cell
        self.tensors[f"{layer.name}.weight"] = (layer.outputs, inputs, layer.kernel, layer.kernel)
        if layer.bias:
            self.tensors[f"{layer.name}.bias"] = (layer.outputs,)
        if layer.norm:
            parts = ("weight", "bias", "running_mean", "running_var")
            self.tensors |= {f"{layer.norm}.{part}": (layer.outputs,) for part in parts}
            self.tensors[f"{layer.norm}.num_batches_tracked"] = ()
        return layer.outputs

    def deconvolution(self, x: int, name: str, outputs: int, like: int) -> int:
        self.tensors |= {f"{name}.weight": (x, outputs, 3, 3), f"{name}.bias": (outputs,)}
        return outputs

    def pooled(self, x: int) -> int:
        return x

    def added(self, x: int, y: int, *, relu: bool) -> int:
        return x

    def joined(self, x: int, y: int) -> int:
        return x + y

    def heads(self, x: int, name: str, inclinations: int, cell: int) -> int:
        return self.convolution(x, Conv(name, inclinations * CLASSES * cell * cell, bias=True))


def tensor_sizes(shape: Shape) -> dict[str, tuple[int, ...]]:
    """Return the sizes of the tensors of a network by name; those named `num_batches_tracked` are integers."""
    wanted = TensorSizes()
    network(wanted, 3, shape)
    return wanted.tensors
