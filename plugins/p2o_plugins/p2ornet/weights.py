"""Weights files of P2ORNet: safetensors in half precision, with the shape of the network in their header."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from p2o import InputError
from p2o.files.whole_file import write_whole
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from p2o_plugins.p2ornet.encoders import ENCODERS
from p2o_plugins.p2ornet.network import INCLINATIONS, P2ORNet

DECODERS: dict[str, tuple[tuple[int, ...], int]] = {
    "resnet50": ((64, 64, 64, 256, 512), 1),
    "efficientnet-lite0": ((32, 48, 64, 96, 128), 2),
}
"""By encoder, the widths of the decoder and the side of its finest cells: the paper's, and one a laptop can run."""
_KIND = "p2ornet"
_MAX_BYTES = 512 << 20


@dataclass(frozen=True)
class Shape:
    """What a weights file says of its network: see `P2ORNet`; `about` is free text by key (data, licence, steps)."""

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

    def network(self) -> P2ORNet:
        """Return a network of this shape with random weights."""
        return P2ORNet(ENCODERS[self.encoder](), self.widths, self.cell, self.connectivity)


def save_weights(network: P2ORNet, shape: Shape, path: Path, *, half: bool = True) -> None:
    """Write the weights, in half precision or as they are, as a whole or not at all."""
    state = {
        name: (value.half() if half and value.is_floating_point() else value).contiguous()
        for name, value in network.state_dict().items()
    }
    header = {"kind": _KIND, "shape": json.dumps(asdict(shape))}
    write_tensors(path, state, header)


def write_tensors(path: Path, tensors: dict[str, Tensor], header: Mapping[str, str]) -> None:
    """Write a safetensors file whole or not at all; the same content gives the same bytes.

    safetensors itself writes the entries of the header in an order of chance.
    """
    raw = save(tensors, metadata=dict(header))
    size = int.from_bytes(raw[:8], "little")
    entries = json.loads(raw[8 : 8 + size])
    entries["__metadata__"] = dict(sorted(entries["__metadata__"].items()))
    text = json.dumps(entries, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    write_whole(path, len(text).to_bytes(8, "little") + text + raw[8 + size :])


def load_weights(path: Path) -> tuple[P2ORNet, Shape]:
    """Return the network of a weights file, ready to predict, and its shape.

    Raises InputError for a file that is missing, damaged, or no weights of P2ORNet.
    """
    if not path.is_file():
        raise InputError("no weights file", where=path, expected="a .safetensors file", got="nothing of that name")
    if path.stat().st_size > _MAX_BYTES:
        raise InputError("a weights file is too large", where=path, expected=f"at most {_MAX_BYTES} bytes")
    try:
        with safe_open(path, framework="pt") as file:
            header = file.metadata() or {}
            state: dict[str, Tensor] = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as problem:
        raise InputError("a weights file cannot be read", where=path, expected="safetensors", got=problem) from problem
    shape = _shape(header, path)
    _check_fit(state, shape, path)
    network = shape.network()
    network.load_state_dict(
        {name: value.float() if value.is_floating_point() else value for name, value in state.items()}
    )
    if any(not bool(torch.isfinite(value).all()) for value in network.state_dict().values()):
        raise InputError("weights are not finite", where=path, expected="numbers", got="NaN or infinity")
    network.eval()
    return network, shape


def _check_fit(state: Mapping[str, Tensor], shape: Shape, path: Path) -> None:
    """Compare names and sizes before any memory is taken for a network that the header may have made up."""
    with torch.device("meta"):
        wanted = {name: _form(value) for name, value in shape.network().state_dict().items()}
    found = {name: _form(value) for name, value in state.items()}
    wrong = sorted(name for name in wanted.keys() | found.keys() if wanted.get(name) != found.get(name))
    if wrong:
        first = wrong[0]
        raise InputError(
            "weights do not fit the network their header describes",
            where=path,
            expected=f"{first} {wanted.get(first, 'absent')} with {shape.encoder}",
            got=f"{found.get(first, 'none')}, and {len(wrong) - 1} more that differ",
        )


def _form(value: Tensor) -> tuple[object, ...]:
    """Return the size of a tensor and whether it holds whole numbers or others; precision does not count."""
    if value.is_floating_point():
        return tuple(value.shape)
    return (*value.shape, "whole" if value.dtype == torch.int64 else str(value.dtype))


def _shape(header: Mapping[str, str], path: Path) -> Shape:
    try:
        if header["kind"] != _KIND:
            raise ValueError(header["kind"])
        said: dict[str, Any] = json.loads(header["shape"])
        shape = Shape(
            str(said["encoder"]),
            tuple(int(w) for w in said["widths"]),
            int(said["cell"]),
            int(said["connectivity"]),
            {str(k): str(v) for k, v in said["about"].items()},
        )
        small = shape.cell in (1, 2) and all(0 < w <= 2048 for w in shape.widths)
        if shape.encoder not in ENCODERS or shape.connectivity not in INCLINATIONS or not small:
            raise ValueError(shape)
        # One width for the middle and one for each map above it, of which the picture's may be the encoder's finest.
        strides = ENCODERS[shape.encoder].strides
        if len(shape.widths) != len(strides) + (strides[0] != shape.cell):
            raise ValueError(shape)
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError, RecursionError) as problem:
        raise InputError(
            "no weights of P2ORNet",
            where=path,
            expected="a file that p2o train wrote",
            got=f"a header without {problem}" if isinstance(problem, KeyError) else f"{problem}",
        ) from problem
    return shape
