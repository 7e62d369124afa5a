"""Array types, the validation of arrays in dataclasses, and iteration over the arrays of a nested value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from p2o.errors import InputError

Float = NDArray[np.float64]
Int = NDArray[np.int64]
Bool = NDArray[np.bool_]
UInt8 = NDArray[np.uint8]
Int8 = NDArray[np.int8]


def checked(name: str, value: Any, shape: tuple[int | None, ...], dtype: Any, *, finite: bool = True) -> Any:
    """Return `value` as a read-only, C-contiguous array of `dtype` after checking its shape.

    `shape` has one entry per axis; None allows any length. Memory is shared if no conversion is needed. Raises
    InputError if the value is not numeric, has another shape, or (with `finite`) contains NaN or infinity.
    """
    try:
        array = np.ascontiguousarray(value, dtype=dtype)
    except (TypeError, ValueError) as problem:
        text = f"{name} is not an array of numbers"
        raise InputError(text, expected=np.dtype(dtype).name, got=type(value).__name__) from problem
    if np.ndim(value) != len(shape) or any(
        want is not None and want != have for want, have in zip(shape, array.shape, strict=True)
    ):
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise InputError(f"{name} has the wrong shape", expected=wanted, got=np.shape(value))
    if finite and array.dtype.kind == "f" and not np.isfinite(array).all():
        bad = int(array.size - np.isfinite(array).sum())
        text = f"{name} contains values that are not finite"
        raise InputError(text, expected="finite numbers", got=f"{bad} NaN or infinite")
    view = array.view()
    view.flags.writeable = False
    return view


def parts(value: Any) -> list[tuple[Any, Any]] | None:
    """Return the parts of a dataclass, mapping, list or tuple with field, key or index; None for other types."""
    if is_dataclass(value) and not isinstance(value, type):
        return [(field.name, getattr(value, field.name)) for field in fields(value)]
    if isinstance(value, Mapping):
        return list(value.items())
    return list(enumerate(value)) if isinstance(value, list | tuple) else None


def leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the leaves of a nested value, such as arrays, each with its path "field.index.key"."""
    inner = parts(value)
    if inner is None:
        yield name, value
    for key, part in inner or ():
        yield from leaves(part, f"{name}.{key}" if name else str(key))
