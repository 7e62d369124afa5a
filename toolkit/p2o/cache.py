"""Cache of extracted features: one file per key, in a folder that can be deleted at any time; hashes of content."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs

from p2o.arrays import parts
from p2o.errors import InputError
from p2o.files.array_file import read_npz
from p2o.files.input_file import expanded, read_bytes
from p2o.files.parsed_text import parse_json
from p2o.host.guard import check_features
from p2o.host.registry import Offer, plugin_packages

_KINDS = "biuf"
"""Kinds of array types: booleans, integers, floats."""
_MAX_BYTES = 512 << 20
"""Maximum size of a file; a larger one counts as invalid: a sparse file could exhaust memory."""

_CONTAINERS: dict[str, type] = {kind.__name__: kind for kind in (tuple, list, dict)}
_PLUGIN_FILE = "p2o_plugin_file_"
"""Prefix of the module names of `--plugin FILE`."""


def cache_folder() -> Path:
    """Return the cache folder of p2o: `P2O_CACHE`, else p2o in the user's cache folder."""
    named = os.environ.get("P2O_CACHE")
    return expanded(named) if named else platformdirs.user_cache_path("p2o", appauthor=False)


def content_hash(value: Any) -> str:
    """Return the hash of a value of arrays, dataclasses, numbers, texts, mappings and sequences.

    Equal bytes of equal types give equal hashes on every machine. Raises TypeError for other types.
    """
    digest = hashlib.sha256()
    for part in _bytes_of(value):
        digest.update(part)
    return digest.hexdigest()


def _bytes_of(value: Any) -> Iterator[bytes]:
    inner = parts(value)
    if isinstance(value, np.ndarray):
        yield f"array {value.dtype.str} {value.shape};".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif isinstance(value, Mapping):
        yield b"{"
        for key in sorted(value):
            yield from _bytes_of(key)
            yield from _bytes_of(value[key])
        yield b"}"
    elif inner is not None:
        named = is_dataclass(value)
        yield f"{type(value).__name__}(".encode() if named else b"["
        for name, part in inner:
            yield f"{name}=".encode() if named else b""
            yield from _bytes_of(part)
        yield b")" if named else b"]"
    elif isinstance(value, np.generic):
        yield from _bytes_of(value.item())
    elif value is None or isinstance(value, str | bool | int | float):
        # The length distinguishes "ab", "c" from "a", "bc".
        text = f"{type(value).__name__} {value!r}"
        yield f"{len(text)}:{text};".encode()
    else:
        raise TypeError(f"{type(value).__name__} has no content hash")


@dataclass(frozen=True)
class Kept:
    """Features from the cache, and the time of their extraction in s."""

    features: Any
    seconds: float


@dataclass(frozen=True)
class FeatureCache:
    """A folder of features with one file per key, safe for concurrent processes."""

    root: Path

    @classmethod
    def of_user(cls) -> FeatureCache:
        """Return the cache in the user's cache folder."""
        return cls(cache_folder() / "features")

    def path(self, key: str) -> Path:
        """Return the file of a key."""
        return self.root / key[:2] / f"{key}.npz"

    def has(self, key: str) -> bool:
        """Return whether there is a file for the key."""
        return os.path.isfile(self.path(key))

    def get(self, key: str, offer: Offer | None = None) -> Kept | None:
        """Return the cached features, None if there are none or the file is invalid.

        With `offer`, features that its method may not return are invalid, too.
        """
        try:
            # Cache files are not compressed: their content is not larger than the file.
            data = read_bytes(self.path(key), "file of the cache", _MAX_BYTES)
            # Copies have the memory layout of extracted arrays.
            arrays = {name: array.copy("K") for name, array in read_npz(data, most=len(data)).items()}
            if not all(array.dtype.kind in _KINDS for array in arrays.values()):
                return None
            head = parse_json(arrays.pop("head").tobytes(), "file of the cache")
            kept = Kept(_unpacked(head["features"], arrays), float(head["seconds"]))
            if not 0 <= kept.seconds < float("inf"):
                return None
            if offer is not None:
                check_features(offer, kept.features)
        # Truncated and foreign files raise various exceptions; features are then extracted again.
        except Exception:
            return None
        return kept

    def put(self, key: str, features: Any, seconds: float) -> bool:
        """Write features atomically; return False if their types cannot be cached.

        Raises InputError if the folder cannot be written.
        """
        arrays: dict[str, Any] = {}
        try:
            tree = _packed(features, arrays)
        except (TypeError, RecursionError):
            return False
        head = json.dumps({"features": tree, "seconds": seconds}).encode()
        path = self.path(key)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # A unique temporary name, because threads of one process may extract the same frame.
            handle, part = tempfile.mkstemp(dir=path.parent, prefix=f".{key[:8]}.", suffix=".part")
            try:
                with os.fdopen(handle, "wb") as file:
                    np.savez(file, head=np.frombuffer(head, np.uint8), **arrays)
                os.replace(part, path)
            except BaseException:
                with contextlib.suppress(OSError):
                    os.unlink(part)
                raise
        except OSError as problem:
            text, got = "the cache of features cannot be written", problem.strerror or str(problem)
            hint = "free some space, or name another folder in P2O_CACHE"
            raise InputError(text, where=problem.filename or path, got=got, hint=hint) from problem
        return True


def why_not_kept(value: Any) -> str:
    """Return the reason why features cannot be cached, or an empty text."""
    try:
        _packed(value, {})
    except TypeError as problem:
        return str(problem)
    except RecursionError:
        return "it is nested too deeply"
    return ""


def _packed(value: Any, arrays: dict[str, Any]) -> Any:
    """Return a value as JSON, with its arrays moved to `arrays`; raises TypeError for unsupported types."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in _KINDS:
            raise TypeError(f"an array of {value.dtype} cannot be cached")
        name = f"array{len(arrays)}"
        with np.errstate(over="ignore"):
            arrays[name] = value.astype(np.float32) if value.dtype == np.float64 else value
        if value.dtype == np.float64 and np.array_equal(arrays[name], value, equal_nan=True):
            return {"array": name, "type": "float64"}  # of single precision, in half the size
        arrays[name] = value
        return {"array": name}
    inner, kind = parts(value), type(value)
    if inner is None:
        if value is None or kind in (str, bool, int, float):
            return {"value": value}
        raise TypeError(f"{kind.__name__} cannot be cached")
    if isinstance(value, Mapping) and not is_dataclass(value):
        if not all(isinstance(key, str) for key in value):
            raise TypeError("a key that is not a text cannot be cached")
        kind = dict
    named: Any = kind.__name__
    if kind not in _CONTAINERS.values():
        named = [kind.__module__, kind.__qualname__]
        if _kind(named) is not kind:
            raise TypeError(f"{kind.__qualname__} is not found by its name")
    return {"kind": named, "parts": {str(key): _packed(part, arrays) for key, part in inner}}


def _unpacked(tree: Mapping[str, Any], arrays: Mapping[str, Any]) -> Any:
    if "array" in tree:
        array = arrays[tree["array"]]
        return array.astype(np.float64) if tree.get("type") == "float64" else array
    if "value" in tree:
        return tree["value"]
    made = {key: _unpacked(part, arrays) for key, part in tree["parts"].items()}
    kind = _kind(tree["kind"])
    if kind in _CONTAINERS.values():
        return kind(made if kind is dict else made.values())
    return kind(**made)


def _kind(named: Any) -> Any:
    """Return the container or dataclass of this name, of loaded modules of p2o and plugins only; else TypeError."""
    if isinstance(named, str):
        return _CONTAINERS[named]
    module, name = named
    if module.partition(".")[0] not in plugin_packages() and not module.startswith(_PLUGIN_FILE):
        raise TypeError(f"{module} is not a module of p2o or of a plugin")
    named_type: Any = sys.modules.get(module)
    for part in name.split("."):
        # Unlike `getattr`, this does not run the `__getattr__` of a module.
        named_type = vars(named_type).get(part)
    if not (isinstance(named_type, type) and is_dataclass(named_type) and named_type.__module__ == module):
        raise TypeError(f"{name} is not a dataclass of {module}")
    return named_type
