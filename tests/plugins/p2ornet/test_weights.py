"""Weights files: half precision there and back, and one clear line for every file that is something else."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from p2o import InputError
from p2o.training_loop import write_tensors
from p2o_plugins.p2ornet.design import Shape
from p2o_plugins.p2ornet.network import P2ORNet
from p2o_plugins.p2ornet.weights import load_weights, save_weights
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from tests.plugins.p2ornet.bomb import Bomb

THIN = Shape("efficientnet-lite0", (4, 4, 4, 4, 4), 2, 4, {"data": "made up", "steps": "7"})


@pytest.fixture(scope="module")
def network() -> P2ORNet:
    torch.manual_seed(0)
    return P2ORNet.of(THIN).eval()


@pytest.fixture(scope="module")
def saved(network: P2ORNet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights") / "thin.safetensors"
    save_weights(network.tensors(), THIN, path)
    return path


def rewritten(saved: Path, path: Path, **shape: Any) -> Path:
    """Write the weights again with a header whose shape says something else."""
    save_file(load_file(saved), path, metadata={"kind": "p2ornet", "shape": json.dumps({**_shape(), **shape})})
    return path


def _shape() -> dict[str, Any]:
    return {"encoder": THIN.encoder, "widths": list(THIN.widths), "cell": 2, "connectivity": 4, "about": {}}


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_weights(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    assert len(text) < 1000
    return text


def test_weights_come_back_in_half_precision_ready_to_predict(network: P2ORNet, saved: Path) -> None:
    tensors, shape = load_weights(saved)
    assert shape == THIN
    loaded = P2ORNet.of(shape, tensors)
    assert not loaded.training
    for name, value in network.state_dict().items():
        back = loaded.state_dict()[name]
        assert back.dtype == value.dtype
        # Half precision: eleven bits of mantissa, 6e-8 near zero.
        torch.testing.assert_close(back, value, rtol=2**-11, atol=6e-8)
    assert saved.stat().st_size < 2.2 * sum(v.numel() for v in network.state_dict().values()) + 100_000


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_full_precision_comes_back_exactly(layout: torch.memory_format, tmp_path: Path) -> None:
    network = P2ORNet.of(THIN).to(memory_format=layout)
    save_weights(network.tensors(), THIN, tmp_path / "full.safetensors", half=False)
    loaded = P2ORNet.of(THIN, load_weights(tmp_path / "full.safetensors")[0])
    for name, value in network.state_dict().items():
        torch.testing.assert_close(loaded.state_dict()[name], value, rtol=0, atol=0)


def test_missing_and_damaged_files_are_told(saved: Path, tmp_path: Path) -> None:
    assert "no weights file" in refusal(tmp_path / "nothing.safetensors")
    assert "no weights file" in refusal(tmp_path)
    whole = saved.read_bytes()
    path = tmp_path / "damaged.safetensors"
    for content in (b"", b"\x00" * 7, whole[:100], whole[:-50], b"no weights at all" * 99, b"\xff" * 200):
        path.write_bytes(content)
        assert "cannot be read" in refusal(path)


def test_pickled_files_are_refused_and_nothing_in_them_runs(tmp_path: Path) -> None:
    trace = tmp_path / "it-ran"
    path = tmp_path / "bomb.safetensors"
    path.write_bytes(pickle.dumps(Bomb(trace)))
    assert "cannot be read" in refusal(path)
    torch.save({"state": Bomb(trace)}, path)
    assert "cannot be read" in refusal(path)
    assert not trace.exists()
    pickle.loads(pickle.dumps(Bomb(trace)))  # noqa: S301  (the bomb is a real one)
    assert trace.exists()


@pytest.mark.parametrize(
    "shape",
    [
        *("{", "[1, 2]", "null", "[" * 5000),
        *({}, {"format": "pt"}, {"kind": "p2ornet"}, {"kind": "another", "shape": json.dumps(_shape())}),
        {"encoder": "vgg"},
        {"encoder": None},
        {"connectivity": 6},
        {"connectivity": float("nan")},
        {"cell": 3},
        {"cell": 1},
        {"cell": float("inf")},
        {"encoder": "resnet50"},
        {"widths": [4, 4, 4, 4]},
        {"widths": []},
        {"widths": 4},
        {"widths": [4, 4, 4, 4, -4]},
        {"widths": [4, 4, 4, 4, 0]},
        {"widths": [4, 4, 4, 4, 10**12]},
        {"widths": ["a", 4, 4, 4, 4]},
        {"about": "text"},
        {"about": None},
    ],
    ids=lambda shape: str(shape)[:50],
)
def test_headers_of_other_things_and_shapes_that_no_network_has_are_told(
    shape: Any, saved: Path, tmp_path: Path
) -> None:
    path = rewritten(saved, tmp_path / "w.safetensors", **(shape if isinstance(shape, dict) else {}))
    if isinstance(shape, str):
        save_file(load_file(saved), path, metadata={"kind": "p2ornet", "shape": shape})
    elif not shape or {"format", "kind"} & shape.keys():
        save_file(load_file(saved), path, metadata=shape)
    assert "no weights of P2ORNet" in refusal(path)


def test_weights_of_another_network_are_told_with_a_name_and_its_size(saved: Path, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    assert "heads.bias (48,)" in refusal(rewritten(saved, path, connectivity=8))
    assert "do not fit" in refusal(rewritten(saved, path, widths=[4, 4, 4, 4, 5]))
    assert "do not fit" in refusal(rewritten(saved, path, encoder="resnet50", cell=1))
    state = load_file(saved)
    counts = next(name for name, value in state.items() if value.dtype == torch.int64)
    for changed in (
        {**state, "surplus": torch.zeros(1)},
        {k: v for k, v in state.items() if k != "heads.bias"},
        {**state, counts: state[counts].to(torch.complex64)},
        {**state, counts: state[counts].to(torch.float32)},
        {**state, "heads.bias": state["heads.bias"].to(torch.int64)},
    ):
        save_file(changed, path, metadata={"kind": "p2ornet", "shape": json.dumps(_shape())})
        assert "do not fit" in refusal(path)


def test_a_file_far_too_large_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "w.safetensors").open("wb") as file:
        file.truncate(1 << 40)
    assert "too large" in refusal(tmp_path / "w.safetensors")


def test_a_header_cannot_make_the_loader_take_memory_for_a_huge_network(saved: Path, tmp_path: Path) -> None:
    path = rewritten(saved, tmp_path / "w.safetensors", widths=[2048] * 5)
    tracemalloc.start()
    try:
        assert "do not fit" in refusal(path)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # The network that the header describes has 2 GB of weights, the file 7 MB.
    assert most < 5e6


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_that_are_not_finite_are_told(value: float, saved: Path, tmp_path: Path) -> None:
    state = load_file(saved)
    state["middle.0.weight"][0, 0, 0, 0] = value
    save_file(state, tmp_path / "w.safetensors", metadata={"kind": "p2ornet", "shape": json.dumps(_shape())})
    assert "not finite" in refusal(tmp_path / "w.safetensors")


def test_the_same_weights_are_the_same_bytes(tmp_path: Path) -> None:
    tensors = {"a": np.ones(3, np.float32), "b": np.zeros((2, 2), np.float32), "c": np.array(7)}
    header = {word: word for word in ("kind", "shape", "step", "options", "more")}
    for number in range(4):
        write_tensors(tmp_path / f"{number}", tensors, header)
    assert len({(tmp_path / f"{number}").read_bytes() for number in range(4)}) == 1
    with safe_open(tmp_path / "0", framework="pt") as file:
        assert file.metadata() == header
        assert torch.equal(file.get_tensor("a"), torch.ones(3))
        assert file.get_tensor("c").shape == ()


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float64])
def test_other_precisions_are_read_too_and_without_torch(dtype: torch.dtype, saved: Path, tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    state = {name: value.to(dtype) if value.is_floating_point() else value for name, value in load_file(saved).items()}
    save_file(state, path, metadata={"kind": "p2ornet", "shape": json.dumps(_shape())})
    tensors, _ = load_weights(path)
    for name, value in state.items():
        wanted = value.float() if value.is_floating_point() else value
        np.testing.assert_array_equal(tensors[name], wanted.numpy(), strict=True)
    if dtype is torch.bfloat16:
        code = "import sys; from pathlib import Path; from p2o_plugins.p2ornet.weights import load_weights; "
        code += f"print(len(load_weights(Path({str(path)!r}))[0]), 'torch' in sys.modules)"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stdout == f"{len(state)} False\n"
