"""Weights files of P2ORNet: safetensors in half precision, with the shape of the network in their header; no torch."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from p2o import InputError
from p2o.reading import write_tensors

from p2o_plugins.p2ornet.design import INCLINATIONS, PLANS, Shape, tensor_sizes

_KIND = "p2ornet"
_MAX_BYTES = 512 << 20
_FLOATS = {"F16", "BF16", "F32", "F64"}
_OF_NUMPY = {"F16", "F32", "F64", "I64"}


def save_weights(tensors: Mapping[str, NDArray[Any]], shape: Shape, path: Path, *, half: bool = True) -> None:
    """Write the weights, in half precision or unchanged, atomically."""
    kept = {n: v.astype(np.float16) if half and v.dtype.kind == "f" else v for n, v in tensors.items()}
    write_tensors(path, kept, {"kind": _KIND, "shape": json.dumps(asdict(shape))})


def load_weights(path: Path) -> tuple[dict[str, NDArray[Any]], Shape]:
    """Return the tensors of a weights file, in single precision, and the shape of their network.

    Raises InputError for a file that is missing, damaged, or no weights of P2ORNet.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise InputError("no weights file", where=path, expected="a .safetensors file", got="no such file")
    if path.stat().st_size > _MAX_BYTES:
        raise InputError("a weights file is too large", where=path, expected=f"at most {_MAX_BYTES} bytes")
    try:
        with safe_open(path, framework="numpy") as file:
            shape = _shape(file.metadata() or {}, path)
            names = list(file.keys())
            _check_fit({name: _form(file.get_slice(name)) for name in names}, shape, path)
            if not {file.get_slice(name).get_dtype() for name in names} <= _OF_NUMPY:
                import ml_dtypes  # noqa: F401  NumPy learns bfloat16 from it
            read = {name: file.get_tensor(name) for name in names}
            tensors = {n: value if value.dtype == np.int64 else value.astype(np.float32) for n, value in read.items()}
    except (SafetensorError, OSError) as problem:
        raise InputError("a weights file cannot be read", where=path, expected="safetensors", got=problem) from problem
    if not all(np.isfinite(value).all() for value in tensors.values()):
        raise InputError("weights are not finite", where=path, expected="numbers", got="NaN or infinity")
    return tensors, shape


def _check_fit(stored: Mapping[str, tuple[object, ...]], shape: Shape, path: Path) -> None:
    """Compare names and sizes before memory is allocated for a network that the header may have invented."""
    wanted: dict[str, tuple[object, ...]] = {
        name: (*size, "whole") if name.endswith(".num_batches_tracked") else size
        for name, size in tensor_sizes(shape).items()
    }
    wrong = sorted(name for name in wanted.keys() | stored.keys() if wanted.get(name) != stored.get(name))
    if wrong:
        first = wrong[0]
        raise InputError(
            "weights do not fit the network their header describes",
            where=path,
            expected=f"{first} {wanted.get(first, 'absent')} with {shape.encoder}",
            got=f"{stored.get(first, 'none')}, and {len(wrong) - 1} more that differ",
        )


def _form(stored: Any) -> tuple[object, ...]:
    """Return the size of a stored tensor and whether it has integers; precision is ignored."""
    size, kind = tuple(stored.get_shape()), stored.get_dtype()
    return size if kind in _FLOATS else (*size, "whole" if kind == "I64" else kind)


def _shape(header: Mapping[str, str], path: Path) -> Shape:
    try:
        if header["kind"] != _KIND:
            raise ValueError(header["kind"])
        fields: dict[str, Any] = json.loads(header["shape"])
        shape = Shape(
            str(fields["encoder"]),
            tuple(int(w) for w in fields["widths"]),
            int(fields["cell"]),
            int(fields["connectivity"]),
            {str(k): str(v) for k, v in fields["about"].items()},
        )
        small = shape.cell in (1, 2) and all(0 < w <= 2048 for w in shape.widths)
        if shape.encoder not in PLANS or shape.connectivity not in INCLINATIONS or not small:
            raise ValueError(shape)
        # One width for the middle and one for each map above it, of which the image's may be the encoder's finest.
        strides = PLANS[shape.encoder].strides
        if len(shape.widths) != len(strides) + (strides[0] != shape.cell):
            raise ValueError(shape)
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError, RecursionError) as problem:
        raise InputError(
            "no weights of P2ORNet",
            where=path,
            expected="a file written by p2o train",
            got=f"a header without {problem}" if isinstance(problem, KeyError) else f"{problem}",
        ) from problem
    return shape
