"""The network on the processor: the same probabilities as of the module that is trained, on any number of threads."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from p2o import Camera, Image, ImageEdges
from p2o.arrays import UInt8
from p2o_plugins.image import p2ornet
from p2o_plugins.image.p2ornet import P2ORNetOptions, build
from p2o_plugins.p2ornet import graph
from p2o_plugins.p2ornet.design import PLANS, Shape
from p2o_plugins.p2ornet.graph import Predictor
from p2o_plugins.p2ornet.network import P2ORNet, order_probabilities
from p2o_plugins.p2ornet.shipped import weights_named
from p2o_plugins.p2ornet.weights import load_weights
from p2o_sim import synthetic

from tests.plugins.p2ornet.stirred_norms import stir

pytestmark = pytest.mark.usefixtures("one_torch_thread")


def thin(encoder: str, cell: int, connectivity: int) -> Shape:
    """Return a shape with the real encoder and a decoder of few channels, all of them different."""
    strides = PLANS[encoder].strides
    widths = (4, 5, 6, 7, 8, 9)[: len(strides) + (strides[0] != cell)]
    return Shape(encoder, widths, cell, connectivity)


def stirred(shape: Shape) -> P2ORNet:
    """Return a network of random weights and batch norms whose answers are far from even."""
    torch.manual_seed(0)
    network = P2ORNet.of(shape).eval()
    stir(network)
    for name, parameter in network.named_parameters():
        if name.endswith("deconv.weight"):
            parameter.data.mul_(4.0)  # what is coarse counts
    network.get_parameter("heads.weight").data.mul_(8.0)
    return network


def picture(height: int, width: int, seed: int = 0) -> UInt8:
    """Return a random picture (H, W, 3) with coarse and fine detail."""
    rng = np.random.default_rng(seed)
    coarse = np.kron(rng.integers(0, 160, (height // 8 + 1, width // 8 + 1, 3)), np.ones((8, 8, 1), np.int64))
    return (coarse[:height, :width] + rng.integers(0, 96, (height, width, 3))).astype(np.uint8)


# ---- the same as the module that is trained


@pytest.mark.parametrize("encoder", PLANS)
@pytest.mark.parametrize("cell", [1, 2])
@pytest.mark.parametrize("connectivity", [4, 8])
def test_the_graph_and_the_module_give_the_same_probabilities(encoder: str, cell: int, connectivity: int) -> None:
    shape = thin(encoder, cell, connectivity)
    network = stirred(shape)
    predict = Predictor(network.tensors(), shape)
    for size in ((37, 53), (32, 64), (1, 1), (33, 2)):
        wanted, found = order_probabilities(network, picture(*size)), predict(picture(*size))
        assert found.shape == wanted.shape == (connectivity // 2, 2, *size)
        np.testing.assert_allclose(found, wanted, atol=1e-4)
    assert wanted.std() > 0.01, "the weights make a difference"


@pytest.mark.parametrize("weights", ["free", "kitti"])
def test_shipped_weights_give_the_same_probabilities_and_nearly_the_same_edges(
    weights: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rounding moves an edge over a threshold here and there: one in a thousand at most, together with its line."""
    tensors, shape = load_weights(weights_named(weights).path)
    network = P2ORNet.of(shape, tensors)
    options = synthetic.SyntheticOptions(place="street", seed=206, width_px=621, height_px=188, right=False)
    rgb = synthetic.build(options)[0].image.rgb
    np.testing.assert_allclose(Predictor(tensors, shape)(rgb), order_probabilities(network, rgb), atol=1e-4)
    found = edges(weights, rgb)
    monkeypatch.setattr(p2ornet, "_predictor", lambda *_: (partial(order_probabilities, network), shape))
    wanted = edges(weights, rgb)
    ours, theirs = (
        {(side, *np.rint(2 * uv)): (*uv, weight) for side, uv, weight in zip(e.side, e.uv, e.weight, strict=True)}
        for e in (found, wanted)
    )
    both = ours.keys() & theirs.keys()
    assert len(theirs) > 1000
    assert len(both) > 0.999 * max(len(ours), len(theirs)) - 5
    np.testing.assert_allclose([ours[one] for one in both], [theirs[one] for one in both], atol=1e-3)


def test_a_picture_is_read_whatever_its_layout_in_memory() -> None:
    shape = thin("efficientnet-lite0", 2, 4)
    predict, rgb = Predictor(stirred(shape).tensors(), shape), picture(40, 50)
    direct, flipped = predict(rgb), np.ascontiguousarray(rgb[:, ::-1])
    np.testing.assert_array_equal(predict(flipped[:, ::-1]), direct)
    np.testing.assert_array_equal(predict(np.asfortranarray(rgb)), direct)
    rgb.flags.writeable = False
    np.testing.assert_array_equal(predict(rgb), direct)


# ---- threads and sizes


def test_the_number_of_threads_does_not_change_a_single_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    tensors, shape = load_weights(weights_named("free").path)
    found, rgb = [], picture(96, 320)
    for threads in (1, 2, 3, 4):
        monkeypatch.setattr(graph, "cores", lambda threads=threads: threads)
        found.append(Predictor(tensors, shape)(rgb))
    for other in found[1:]:
        np.testing.assert_array_equal(found[0], other)


def test_graphs_are_made_once_a_size_and_kept_up_to_so_many_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    original = graph.model

    def counted(tensors: object, shape: Shape, size: tuple[int, int]) -> bytes:
        made.append(size)
        return original(tensors, shape, size)  # type: ignore[arg-type]

    monkeypatch.setattr(graph, "model", counted)
    monkeypatch.setattr(graph, "KEPT_PX", 32 * (128 + 160 + 192))
    shape = thin("efficientnet-lite0", 2, 4)
    predict = Predictor(stirred(shape).tensors(), shape)
    with ThreadPoolExecutor(4) as threads:
        list(threads.map(predict, [picture(20 + number, 40) for number in range(8)]))
    assert made == [(32, 64)]
    for width in (40, 90, 120, 40, 150, 180, 40, 150):
        predict(picture(20, width))
    assert made == [(32, 64), (32, 96), (32, 128), (32, 160), (32, 192)]
    predict(picture(20, 90))
    assert made[5:] == [(32, 96)], "the one that was not asked for the longest had to go"
    predict(picture(200, 200))
    predict(picture(200, 200))
    assert made[6:] == [(224, 224)], "one is kept, however large"


# ---- what it takes


def edges(weights: Path | str, rgb: UInt8) -> ImageEdges:
    camera = Camera.pinhole(100, 100, (rgb.shape[1] - 1) / 2, (rgb.shape[0] - 1) / 2, rgb.shape[1], rgb.shape[0])
    found = build(P2ORNetOptions(weights=str(weights), device="cpu"))(Image(rgb, camera)).edges
    assert found is not None
    return found


def test_on_the_processor_neither_torch_nor_onnx_is_imported() -> None:
    code = (
        "import sys, numpy as np\n"
        "from p2o import Camera, Image\n"
        "from p2o_plugins.image.p2ornet import P2ORNetOptions, build\n"
        "rgb = np.random.default_rng(0).integers(0, 256, (64, 96, 3), dtype=np.uint8)\n"
        "image = Image(rgb, Camera.pinhole(100, 100, 47.5, 31.5, 96, 64))\n"
        "print(len(build(P2ORNetOptions(device='cpu'))(image).edges) >= 0)\n"
        "print(*(name for name in sys.modules if name.partition('.')[0] in ('torch', 'kornia', 'onnx')))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("True\n\n", "")


def test_nothing_is_opened_but_the_weights_once_its_packages_are_loaded() -> None:
    code = (
        "import sys, numpy as np, onnxruntime, safetensors\n"
        "from p2o_plugins.p2ornet.graph import Predictor\n"
        "from p2o_plugins.p2ornet.shipped import weights_named\n"
        "from p2o_plugins.p2ornet.weights import load_weights\n"
        "rgb = np.zeros((40, 60, 3), np.uint8)\n"
        "path, seen = weights_named('free').path, set()\n"
        "watched = ('open', 'socket.connect', 'subprocess.Popen', 'os.system', 'exec', 'import')\n"
        "sys.addaudithook(lambda event, words: event in watched and seen.add((event, str(words[0]))))\n"
        "print(Predictor(*load_weights(path))(rgb).shape, seen - {('open', str(path))})\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "(2, 2, 40, 60) set()\n"
