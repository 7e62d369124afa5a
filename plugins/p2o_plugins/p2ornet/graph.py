"""P2ORNet on the CPU without torch: its layers as an ONNX graph, run by ONNX Runtime.

A graph is built in memory for one image size from the tensors of a weights file: batch norms are folded into the
preceding convolutions, and paddings are those of the convolutions.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from p2o import Float, UInt8
from p2o.solving import cores

from p2o_plugins.p2ornet.design import CLASSES, INFINITY, PLANS, Conv, Shape, network
from p2o_plugins.p2ornet.onnx_file import FLOAT, UINT8, Message, constant, node, tensor
from p2o_plugins.p2ornet.onnx_file import model as onnx_model

_Float32 = NDArray[np.float32]
_OPSET = 17
"""ONNX opset of 2022, which any ONNX Runtime accepted by this package supports."""
_PICTURE = "rgb"
KEPT_PX = 1_500_000
"""Largest number of pixels of the image sizes whose graphs are kept, most recently used first, at least one.

A graph keeps the memory of its maps, 0.5 GB for a million pixels, and is faster for it.
"""


class Predictor:
    """A network with fixed weights. Thread-safe; results do not depend on the number of threads.

    A single image uses all cores; concurrent images use one core each (`p2o.runtime.native.cores`).
    """

    def __init__(self, tensors: Mapping[str, _Float32], shape: Shape) -> None:
        self._tensors, self._shape = tensors, shape
        self._sessions: OrderedDict[tuple[int, int, int], Any] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, rgb: UInt8) -> Float:
        """Return probabilities (inclinations, 2, H, W) of each pair of pixels of an image (H, W, 3).

        That the first pixel of the pair is occluded by the second, and that it occludes it.
        """
        height, width = rgb.shape[:2]
        step = self._shape.multiple
        filled = np.pad(np.ascontiguousarray(rgb), ((0, -height % step), (0, -width % step), (0, 0)), mode="edge")
        (probabilities,) = self._session(filled.shape[0], filled.shape[1]).run(None, {_PICTURE: filled})
        probability: Float = probabilities.reshape(2, -1, *filled.shape[:2])
        return probability[:, :, :height, :width].swapaxes(0, 1)

    def _session(self, height: int, width: int) -> Any:
        """Return the session for images of a size; concurrent threads wait for a session under construction."""
        threads = cores()
        key = (height, width, threads)
        with self._lock:
            if key not in self._sessions:
                self._sessions[key] = session(model(self._tensors, self._shape, (height, width)), threads)
                while len(self._sessions) > 1 and sum(h * w for h, w, _ in self._sessions) > KEPT_PX:
                    self._sessions.popitem(last=False)
            self._sessions.move_to_end(key)
            return self._sessions[key]


def session(content: bytes, threads: int) -> Any:
    """Return a session of ONNX Runtime that runs a model on the CPU with a number of threads."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.log_severity_level = 3
    # Idle threads sleep instead of spinning, because other frames and other programs need the cores.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


class _Map(NamedTuple):
    """Values of the graph of the same size, by name and number of channels: several for concatenated maps."""

    parts: tuple[tuple[str, int], ...]
    height: int
    width: int

    @property
    def name(self) -> str:
        ((name, _),) = self.parts
        return name


class _Graph:
    """Layers as nodes of an ONNX graph."""

    def __init__(self, tensors: Mapping[str, _Float32]) -> None:
        self.tensors = tensors
        self.nodes: list[Message] = []
        self.constants: list[Message] = []

    def node(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """Add a node with one output, and return that one's name."""
        output = f"v{len(self.nodes)}"
        self.nodes.append(node(kind, inputs, output, **attributes))
        return output

    def constant(self, values: NDArray[Any] | np.float32) -> str:
        """Add a constant, and return its name."""
        name = f"c{len(self.constants)}"
        self.constants.append(constant(name, values))
        return name

    def convolution(self, x: _Map, layer: Conv) -> _Map:
        weight = self.tensors[f"{layer.name}.weight"].astype(np.float64)
        shift = self.tensors[f"{layer.name}.bias"].astype(np.float64) if layer.bias else np.zeros(layer.outputs)
        if layer.norm:
            mean, variance, gain, offset = (
                self.tensors[f"{layer.norm}.{part}"].astype(np.float64)
                for part in ("running_mean", "running_var", "weight", "bias")
            )
            scale = gain / np.sqrt(variance + layer.epsilon)
            weight, shift = weight * scale[:, None, None, None], (shift - mean) * scale + offset
        return self._convolved(x, weight, shift, layer)

    def _convolved(self, x: _Map, weight: NDArray[Any], shift: NDArray[Any], layer: Conv) -> _Map:
        """Add a convolution with weights (outputs, inputs, k, k) and shifts (outputs,), those of a layer or a part."""
        outputs, kernel, stride, cell = len(weight), layer.kernel, layer.stride, layer.cell
        before = (kernel // 2) * cell
        if cell > 1:
            # Channels of a cell are its pixels: the same sums as of a larger kernel that steps from cell to cell.
            weight = weight.reshape(outputs, -1, cell, cell, kernel, kernel).transpose(0, 1, 4, 2, 5, 3)
            weight = weight.reshape(outputs, -1, kernel * cell, kernel * cell)
            stride = cell
        pads = [before, before, before, before]
        height, width = -(-x.height // stride), -(-x.width // stride)
        if layer.same:
            totals = [max((o - 1) * stride + kernel - i, 0) for o, i in ((height, x.height), (width, x.width))]
            pads = [t // 2 for t in totals] + [t - t // 2 for t in totals]
        y, first = "", 0
        for name, channels in x.parts:
            # Sums of convolutions instead of one of joined maps: nothing is copied, and maps keep their layout.
            constants = [weight if layer.depthwise else weight[:, first : first + channels]] + (
                [] if first else [shift]
            )
            part = self.node(
                "Conv",
                name,
                *(self.constant(values.astype(np.float32)) for values in constants),
                kernel_shape=weight.shape[2:],
                strides=[stride, stride],
                pads=pads,
                group=channels if layer.depthwise else 1,
            )
            y, first = self.node("Add", y, part) if y else part, first + channels
        if layer.relu == INFINITY:
            y = self.node("Relu", y)
        elif layer.relu is not None:
            y = self.node("Clip", y, self.constant(np.float32(0)), self.constant(np.float32(layer.relu)))
        return _Map(((y, outputs),), height, width)

    def deconvolution(self, x: _Map, name: str, outputs: int, like: _Map) -> _Map:
        y = self.node(
            "ConvTranspose",
            x.name,
            *(self.constant(self.tensors[f"{name}.{part}"]) for part in ("weight", "bias")),
            kernel_shape=[3, 3],
            strides=[2, 2],
            pads=[1, 1, 1, 1],
            output_padding=[like.height - (2 * x.height - 1), like.width - (2 * x.width - 1)],
        )
        return _Map(((y, outputs),), like.height, like.width)

    def pooled(self, x: _Map) -> _Map:
        y = self.node("MaxPool", x.name, kernel_shape=[3, 3], strides=[2, 2], pads=[1, 1, 1, 1])
        return _Map(((y, x.parts[0][1]),), (x.height + 1) // 2, (x.width + 1) // 2)

    def added(self, x: _Map, y: _Map, *, relu: bool) -> _Map:
        total = self.node("Add", x.name, y.name)
        return x._replace(parts=((self.node("Relu", total) if relu else total, x.parts[0][1]),))

    def joined(self, x: _Map, y: _Map) -> _Map:
        return x._replace(parts=x.parts + y.parts)

    def heads(self, x: _Map, name: str, inclinations: int, cell: int) -> _Map:
        """Return the probabilities of the first and of the last class, at the pixels: all inclinations of each."""
        weight, shift = (self.tensors[f"{name}.{part}"] for part in ("weight", "bias"))
        weight = weight.reshape(inclinations, CLASSES, -1, *weight.shape[1:])
        shift = shift.reshape(inclinations, CLASSES, -1)
        logits = [
            self._convolved(x, np.concatenate(weight[:, number]), np.concatenate(shift[:, number]), Conv(name, 0)).name
            for number in range(CLASSES)
        ]
        highest = self.node("Max", *logits)
        first, middle, last = (self.node("Exp", self.node("Sub", one, highest)) for one in logits)
        total = self.node("Add", self.node("Add", first, middle), last)
        y = self.node("Concat", self.node("Div", first, total), self.node("Div", last, total), axis=1)
        y = self.node("DepthToSpace", y, blocksize=cell, mode="CRD") if cell > 1 else y
        return _Map(((y, 2 * inclinations),), cell * x.height, cell * x.width)


def model(tensors: Mapping[str, _Float32], shape: Shape, size: tuple[int, int]) -> bytes:
    """Return an ONNX model from an image `rgb` (H, W, 3) uint8 to probabilities (1, 2 * inclinations, H, W).

    First those of all inclinations that the first pixel is occluded, then those that it occludes. `size` (H, W) is that
    of the image, a multiple of `shape.multiple`.
    """
    graph = _Graph(tensors)
    last = network(graph, _normalised(graph, shape, size), shape)
    ends = tensor(_PICTURE, UINT8, (*size, 3)), tensor(last.name, FLOAT, (1, last.parts[0][1], *size))
    return onnx_model("p2ornet", graph.nodes, graph.constants, ends, _OPSET)


def _normalised(graph: _Graph, shape: Shape, size: tuple[int, int]) -> _Map:
    """Return the image as a map of its three colours."""
    plan = PLANS[shape.encoder]
    mean, std = np.array(plan.mean), np.array(plan.std)
    gain, offset = (
        graph.constant(values.astype(np.float32)[:, None, None]) for values in (1 / (255 * std), -mean / std)
    )
    x = graph.node("Cast", graph.node("Transpose", _PICTURE, perm=[2, 0, 1]), to=FLOAT)
    x = graph.node("Add", graph.node("Mul", x, gain), offset)
    return _Map(((graph.node("Unsqueeze", x, graph.constant(np.array([0]))), 3),), *size)
