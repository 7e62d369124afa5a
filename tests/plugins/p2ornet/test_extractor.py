"""The extractor `p2ornet`: the contract of its slot, masks, sizes that nobody thinks of, and errors of one line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from p2o import SIDES, Camera, Image, ImageEdges, InputError, Side, UnknownNameError
from p2o_plugins.image import depth
from p2o_plugins.image.p2ornet import P2ORNetOptions, build
from p2o_plugins.p2ornet.design import Shape
from p2o_plugins.p2ornet.network import P2ORNet
from p2o_plugins.p2ornet.shipped import weights_named
from p2o_plugins.p2ornet.weights import save_weights
from p2o_sim import synthetic

pytestmark = pytest.mark.usefixtures("one_torch_thread")
THIN = Shape("efficientnet-lite0", (8, 4, 4, 4, 4), 2)


def contrast_network() -> P2ORNet:
    """Return a network with random weights that calls an edge what grows brighter (L, U) or darker (R, B).

    The branch at the picture's resolution is set by hand to the difference of neighbouring cells; all the rest of the
    network is random and reaches the heads only faintly.
    """
    torch.manual_seed(3)
    network = P2ORNet.of(THIN).eval()
    faint = 1e-3
    for name in ("picture.0", "picture.3", "ups.0.conv.0", "ups.0.conv.3"):
        network.get_parameter(f"{name}.weight").data.mul_(faint)
        network.get_parameter(f"{name}.bias").data.zero_()
    first = network.get_parameter(
        "picture.0.weight"
    ).data  # of the 12 values of a cell: colour x 4 pixels (row, column)
    for colour in range(3):
        for out, sign in ((0, 1.0), (1, -1.0)):
            first[out, 4 * colour + 1, 1, 1] += -sign  # from the right pixel of the cell ...
            first[out, 4 * colour, 1, 2] += sign  # ... to the left pixel of the next
        for out, sign in ((2, 1.0), (3, -1.0)):
            first[out, 4 * colour + 2, 1, 1] += -sign
            first[out, 4 * colour, 2, 1] += sign
    for name in ("picture.3", "ups.0.conv.0", "ups.0.conv.3"):
        for channel in range(4):
            network.get_parameter(f"{name}.weight").data[channel, channel, 1, 1] += 1.0
    heads, bias = (network.get_parameter(f"heads.{part}").data for part in ("weight", "bias"))
    heads.mul_(faint)
    bias.zero_()
    bias.view(2, 3, 4)[:, 1] = 8.0
    weight = heads.view(2, 3, 4, -1)
    for plane, pixels in ((0, (1, 3)), (1, (2, 3))):
        for pixel in pixels:
            weight[plane, 0, pixel, 2 * plane] += 4.0
            weight[plane, 2, pixel, 2 * plane + 1] += 4.0
    return network


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "contrast.safetensors"
    save_weights(contrast_network().tensors(), THIN, path)
    return path


def camera(width: int, height: int) -> Camera:
    return Camera.pinhole(100, 100, (width - 1) / 2, (height - 1) / 2, width, height)


def image(rgb: np.ndarray, masked: np.ndarray | None = None) -> Image:
    return Image(rgb, camera(rgb.shape[1], rgb.shape[0]), masked=masked)


def edges(picture: Image, weights: Path, **options: object) -> ImageEdges:
    found = build(P2ORNetOptions(weights=str(weights), device="cpu", **options))(picture).edges
    assert found is not None
    return found


def board() -> np.ndarray:
    rgb = np.full((64, 96, 3), 40, np.uint8)
    rgb[20:44, 30:70] = 220
    return rgb


def test_edges_lie_half_way_between_the_pixels_of_the_pairs_that_say_so(weights: Path) -> None:
    found = edges(image(board()), weights)
    # The network calls a pair L where it grows brighter: the board is in front.
    for side, axis, place, low, high in (
        (0, 0, 29.5, 20, 43),
        (1, 0, 69.5, 20, 43),
        (2, 1, 19.5, 30, 69),
        (3, 1, 43.5, 30, 69),
    ):
        own = found.uv[found.side == side]
        np.testing.assert_allclose(own[:, axis], place, atol=0.05)
        assert sorted(own[:, 1 - axis].tolist()) == list(range(low, high + 1))
    assert found.weight.min() >= P2ORNetOptions().min_confidence
    assert found.weight.max() <= 1


def test_masked_pixels_give_no_edges_and_masked_background_does(weights: Path) -> None:
    rgb = board()
    front = rgb[..., 0] > 100
    everything = edges(image(rgb), weights)
    assert len(everything) == 2 * 24 + 2 * 40
    assert len(edges(image(rgb, masked=np.ones_like(front)), weights)) == 0
    assert len(edges(image(rgb, masked=front), weights)) == 0
    behind = edges(image(rgb, masked=~front), weights)
    np.testing.assert_array_equal(behind.uv, everything.uv)
    left = np.zeros_like(front)
    left[:, :40] = True
    partly = edges(image(rgb, masked=left), weights)
    assert set(partly.side.tolist()) == {1, 2, 3}
    assert partly.uv[:, 0].min() >= 40


def test_less_certain_and_shorter_edges_are_dropped_on_request(weights: Path) -> None:
    picture = image(board())
    weight = edges(picture, weights).weight
    middle = float(np.median(weight))
    kept = edges(picture, weights, min_confidence=middle)
    assert kept.weight.min() >= middle
    assert 0 < len(kept) <= (weight >= middle).sum()
    assert set(edges(picture, weights, min_line_px=25).side.tolist()) == {2, 3}
    assert len(edges(picture, weights, min_line_px=41)) == 0
    assert len(edges(picture, weights, min_confidence=1.0)) <= len(kept)


@pytest.mark.parametrize("size", [(8, 8), (1, 40), (40, 1), (1, 1), (2, 2), (37, 53)])
def test_tiny_grey_and_odd_pictures_are_no_crash(weights: Path, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    grey = np.repeat(rng.integers(0, 256, (*size, 1), dtype=np.uint8), 3, axis=2)
    for rgb in (grey, np.zeros_like(grey), np.full_like(grey, 255)):
        picture = image(rgb)
        found = edges(picture, weights, min_confidence=0.0, min_line_px=1)
        assert picture.camera.in_image(found.uv).all()


def test_any_random_network_keeps_its_edges_in_the_image(tmp_path: Path) -> None:
    torch.manual_seed(1)
    network = P2ORNet.of(THIN)
    network.get_parameter("heads.weight").data.mul_(100)  # certain of anything, at borders too
    save_weights(network.tensors(), THIN, tmp_path / "wild.safetensors")
    rgb = np.random.default_rng(0).integers(0, 256, (41, 67, 3), dtype=np.uint8)
    picture = image(rgb)
    found = edges(picture, tmp_path / "wild.safetensors", min_confidence=0.0, min_line_px=1)
    assert len(found) > 100
    assert picture.camera.in_image(found.uv).all()
    assert set(found.side.tolist()) <= {0, 1, 2, 3}


def test_eight_neighbours_give_the_same_edges_as_their_first_four(weights: Path, tmp_path: Path) -> None:
    shape = replace(THIN, connectivity=8)
    four, eight = contrast_network(), P2ORNet.of(shape).eval()
    state = four.state_dict()
    for name in ("heads.weight", "heads.bias"):
        state[name] = torch.cat([state[name], eight.state_dict()[name][len(state[name]) :]])
    eight.load_state_dict(state)
    save_weights(eight.tensors(), shape, tmp_path / "eight.safetensors")
    picture = image(board())
    np.testing.assert_array_equal(edges(picture, tmp_path / "eight.safetensors").uv, edges(picture, weights).uv)


@pytest.mark.parametrize("weights", ["free", "kitti"])
def test_shipped_weights_find_edges_of_a_street_they_have_not_seen_on_their_own_side(weights: str) -> None:
    """Within 2 px of the surest edges there is far more often an exact edge of their side than one of the other."""
    frame = synthetic.build(
        synthetic.SyntheticOptions(place="street", seed=206, width_px=621, height_px=188, right=False)
    )[0]
    found = build(P2ORNetOptions(weights=weights, min_confidence=0.7))(frame.image).edges
    exact = depth.METHOD.build(depth.METHOD.options())(frame.image).edges
    assert len(found) > 200

    def share(side_of: dict[Side, Side]) -> float:
        near = [
            exact.trees[side_of[side]].query(found.uv[found.index[side]])[0] < 2.0
            for side in SIDES
            if side in found.index
        ]
        return float(np.concatenate(near).mean())

    mirrored = {Side.LEFT: Side.RIGHT, Side.RIGHT: Side.LEFT, Side.UPPER: Side.BOTTOM, Side.BOTTOM: Side.UPPER}
    own = share({side: side for side in SIDES})
    assert own > 0.4
    assert own > 2.5 * share(mirrored)


@pytest.mark.parametrize("weights", ["free", "kitti"])
def test_there_is_no_edge_where_nothing_changes(weights: str) -> None:
    """Half of the picture is black: the network invents edges there, the extractor drops them."""
    rgb = np.zeros((96, 192, 3), np.uint8)
    rgb[:, 96:] = np.random.default_rng(0).integers(0, 256, (96, 1, 3)).repeat(96, axis=1)
    image = Image(rgb, Camera.pinhole(100, 100, 95.5, 47.5, 192, 96))
    invented, found = (build(P2ORNetOptions(weights=weights, min_contrast=c))(image).edges for c in (0, 2))
    assert (invented.uv[:, 0] < 96 - 5).any()
    assert not (found.uv[:, 0] < 96 - 5).any()


# ---- what goes wrong


def test_unknown_weights_are_told_with_the_names_that_exist(tmp_path: Path) -> None:
    with pytest.raises(
        UnknownNameError, match=r"^p2ornet: unknown weights 'fre'; expected one of: free.*did you mean free"
    ):
        build(P2ORNetOptions(weights="fre"))
    missing = str(tmp_path / "w.safetensors")
    with pytest.raises(InputError, match=r"expected one of: free.*path") as caught:
        build(P2ORNetOptions(weights=missing))
    assert "\n" not in str(caught.value)
    assert weights_named("free").path.name == "p2ornet-free.safetensors"


@pytest.mark.parametrize("text", ["", "1", "a b", "1 2 3", "nan 0", "0 1", "-1 0"])
def test_a_calibration_that_is_none_is_told(text: str, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    save_weights(P2ORNet.of(THIN).tensors(), replace(THIN, about={"calibration": text}), path)
    with pytest.raises(InputError, match="unknown calibration"):
        build(P2ORNetOptions(weights=str(path)))


def test_a_calibration_moves_the_confidence_alone(weights: Path, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    save_weights(contrast_network().tensors(), replace(THIN, about={"calibration": "0.5 -0.2"}), path)
    picture = image(board())
    plain, other = (edges(picture, p, min_confidence=0.0) for p in (weights, path))
    np.testing.assert_array_equal(plain.uv, other.uv)
    odds = np.log(np.clip(plain.weight, 1e-4, 1 - 1e-4) / np.clip(1 - plain.weight, 1e-4, 1 - 1e-4))
    np.testing.assert_allclose(other.weight, 1 / (1 + np.exp(-(0.5 * odds - 0.2))), atol=1e-6)


def test_a_gpu_that_is_not_there_is_told(weights: Path) -> None:
    with pytest.raises(InputError, match=r"^device: the GPU does not exist.*got cuda:99"):
        build(P2ORNetOptions(weights=str(weights), device="cuda:99"))
