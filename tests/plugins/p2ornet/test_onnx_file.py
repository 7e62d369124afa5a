"""Messages are those of the package onnx, to the last byte, and whole networks are valid models."""

from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from p2o_plugins.p2ornet import graph, onnx_file
from p2o_plugins.p2ornet.design import PLANS, Shape, tensor_sizes


@pytest.mark.parametrize("length", [0, 1, 127, 128, 16383, 16384, 2**31, 2**62])
def test_integers_and_texts_of_any_length(length: int) -> None:
    wanted = helper.make_node("Kind", ["a" * min(length, 20000)], ["b"], axis=length, sizes=[length, 7], mode="CRD")
    made = onnx_file.node("Kind", ["a" * min(length, 20000)], "b", axis=length, sizes=[length, 7], mode="CRD")
    assert b"".join(made) == wanted.SerializeToString(deterministic=True)


@pytest.mark.parametrize("kind", [np.float32, np.uint8, np.int64])
@pytest.mark.parametrize("size", [(), (3,), (2, 300, 1)])
def test_constants(kind: type, size: tuple[int, ...]) -> None:
    values = np.arange(np.prod(size, dtype=int)).reshape(size).astype(kind)
    made = TensorProto.FromString(b"".join(onnx_file.constant("c0", values)))
    assert made == numpy_helper.from_array(np.ascontiguousarray(values), "c0")
    turned = TensorProto.FromString(b"".join(onnx_file.constant("c0", values.T)))
    np.testing.assert_array_equal(numpy_helper.to_array(turned), np.atleast_1d(values.T))


def test_a_model_of_the_package_has_the_same_bytes() -> None:
    ends = [helper.make_tensor_value_info(name, kind, [2, 300]) for name, kind in (("a", 2), ("b", 1))]
    nodes = [helper.make_node("Cast", ["a"], ["f"], to=1), helper.make_node("Add", ["f", "c"], ["b"])]
    values = np.float32([1.5, 2])[:, None]
    made = helper.make_graph(nodes, "net", ends[:1], ends[1:], [numpy_helper.from_array(values, "c")])
    wanted = helper.make_model(made, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    ours = [onnx_file.node("Cast", ["a"], "f", to=onnx_file.FLOAT), onnx_file.node("Add", ["f", "c"], "b")]
    parts = onnx_file.tensor("a", onnx_file.UINT8, (2, 300)), onnx_file.tensor("b", onnx_file.FLOAT, (2, 300))
    assert onnx_file.model("net", ours, [onnx_file.constant("c", values)], parts, 17) == wanted.SerializeToString()


@pytest.mark.parametrize("encoder", PLANS)
def test_networks_are_valid_models(encoder: str) -> None:
    rng, shape = np.random.default_rng(0), Shape.of(encoder)
    sizes = tensor_sizes(shape)
    tensors = {name: np.abs(rng.normal(size=size)).astype(np.float32) for name, size in sizes.items()}
    content = graph.model(tensors, shape, (64, 96))
    onnx.checker.check_model(onnx.load_model_from_string(content), full_check=True)
