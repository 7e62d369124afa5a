"""Cache of extracted features, keyed by the content of the image or sweep, the method, its options and its code.

The folder can be deleted at any time.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import platformdirs

from p2o.arrays import parts
from p2o.errors import InputError, P2OError
from p2o.files.array_file import read_npz
from p2o.files.input_file import expanded, read_bytes
from p2o.files.parsed_text import parse_json
from p2o.frames.frame import Frame
from p2o.frames.scale import image_at_scale
from p2o.host.guard import check_features
from p2o.host.registry import Offer
from p2o.work.sources import Code, code_of, package_hash, plugin_packages

if TYPE_CHECKING:
    from p2o.run.part import Part

_FORMAT = 4
_RECENT_S = 2.0
_KINDS = "biuf"
"""Kinds of array types: booleans, integers, floats."""

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


def features_key(part: Part, data_hash: str) -> str:
    """Return the cache key of the features of an image or sweep with this content hash."""
    key = {"format": _FORMAT, "data": data_hash, "kind": part.offer.kind.value, "version": part.offer.version}
    return content_hash({**key, "method": method_content(part), "input": code_of(Frame, image_at_scale).hash})


def method_content(part: Part) -> dict[str, Any]:
    """Return everything of a method that affects its results: name, options, code and data files.

    For a method that resolves other methods by name, this includes all code of all plugins.
    """
    method, options = part.offer.method, part.options.model_dump(mode="json")
    code = code_of(method.build, type(part.options))
    content: dict[str, Any] = {"name": part.offer.full_name, "options": options, "code": code.hash}
    content |= {"needs": sorted(method.needs), "gives": sorted(method.gives)}
    content |= {"files": named_files(options), "data files": _data_files(part, code)}
    if "p2o.host.registry:Registry" in code.definitions:
        packages = sorted(plugin_packages())
        content["other methods"] = [package_hash(name, code=is_code) for name in packages for is_code in (True, False)]
    return content


def _data_files(part: Part, code: Code) -> list[str]:
    """Return the hashes of the declared data files of a method, else of all in the packages whose folder it locates."""
    if part.offer.method.data_files is None:
        return [package_hash(package, code=False) for package in sorted(code.locates_files)]
    try:
        return [_file_hash(path) for path in part.offer.method.data_files(part.options)]
    except (P2OError, OSError, ImportError):
        # The method itself reports a missing file with a better message.
        return []


def named_files(options: Any) -> dict[str, str]:
    """Return content hashes of the files that options (JSON) name."""
    hashes: dict[str, str] = {}
    if isinstance(options, Mapping):
        options = list(options.values())
    if isinstance(options, str):
        with contextlib.suppress(P2OError, OSError, ValueError):
            if 0 < len(options) < 4096 and (path := expanded(options)).is_file():
                hashes[options] = _file_hash(path)
    elif isinstance(options, Sequence):
        for value in options:
            hashes |= named_files(value)
    return hashes


def _file_hash(path: Path) -> str:
    """Return the hash of a file, cached by its metadata unless it changed recently: timestamps are coarse."""
    state = path.stat()
    if abs(time.time() - state.st_mtime) < _RECENT_S:
        return _hash_of_state.__wrapped__(path)
    return _hash_of_state(path, state.st_ino, state.st_size, state.st_mtime_ns, state.st_ctime_ns)


@lru_cache(maxsize=256)
def _hash_of_state(path: Path, *_: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
            data = read_bytes(self.path(key), "file of the cache")
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
        return arrays[tree["array"]]
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
