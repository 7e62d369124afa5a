"""What extractors found, kept by content: the bytes of image or sweep, the method, its options, its code.

Deleting the folder is always safe.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import platformdirs

from p2o.arrays import parts
from p2o.errors import InputError
from p2o.files.array_file import read_npz
from p2o.files.input_file import expanded, read_bytes
from p2o.files.parsed_text import parse_json
from p2o.host.guard import check_features
from p2o.host.registry import GROUP, Offer
from p2o.work.sources import code_hash

if TYPE_CHECKING:
    from p2o.run.recipe import Part

_FORMAT = 3
_KINDS = "biuf"
"""Kinds of numbers that arrays may be of: switches, integers, floats."""

_CONTAINERS: dict[str, type] = {kind.__name__: kind for kind in (tuple, list, dict)}
_PLUGIN_FILE = "p2o_plugin_file_"
"""What the modules of `--plugin FILE` are called begins with this."""


def cache_folder() -> Path:
    """Return where p2o keeps what can be computed again: `P2O_CACHE`, else p2o in the user's cache folder."""
    named = os.environ.get("P2O_CACHE")
    return expanded(named) if named else platformdirs.user_cache_path("p2o", appauthor=False)


def content_hash(value: Any) -> str:
    """Return the hash of a value made of arrays, dataclasses, numbers, texts, mappings and sequences.

    Equal bytes of equal types give equal hashes, on every machine. Raises TypeError for anything else.
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
        # The length keeps "ab", "c" apart from "a", "bc".
        text = f"{type(value).__name__} {value!r}"
        yield f"{len(text)}:{text};".encode()
    else:
        raise TypeError(f"{type(value).__name__} has no content hash")


def features_key(part: Part, data_hash: str) -> str:
    """Return the key of what an extractor finds in the image or sweep with this content hash."""
    offer = part.offer
    return content_hash(
        {
            "format": _FORMAT,
            "data": data_hash,
            "kind": offer.kind.value,
            "method": offer.full_name,
            "version": offer.version,
            "code": code_hash(offer.method.build),
            "options": (options := part.options.model_dump(mode="json")),
            "files": named_files(options),
        }
    )


def named_files(options: Any) -> dict[str, str]:
    """Return content hashes of the files that options (JSON) name, by what they say: weights change in place."""
    found: dict[str, str] = {}
    if isinstance(options, Mapping):
        options = list(options.values())
    if isinstance(options, str):
        try:
            if 0 < len(options) < 4096 and Path(options).is_file():
                with Path(options).open("rb") as file:
                    found[options] = hashlib.file_digest(file, "sha256").hexdigest()
        except (OSError, ValueError):
            # What cannot be read fails where it is used, with a better message.
            pass
    elif isinstance(options, Sequence):
        for value in options:
            found |= named_files(value)
    return found


@dataclass(frozen=True)
class Kept:
    """Features from the cache, and how many seconds they took when they were extracted."""

    features: Any
    seconds: float


@dataclass(frozen=True)
class FeatureCache:
    """A folder of features, one file a key; any number of processes may use it at once."""

    root: Path

    @classmethod
    def of_user(cls) -> FeatureCache:
        """Return the cache in the user's cache folder."""
        return cls(cache_folder() / "features")

    def path(self, key: str) -> Path:
        """Return the file of a key."""
        return self.root / key[:2] / f"{key}.npz"

    def has(self, key: str) -> bool:
        """True where there is a file for the key."""
        return os.path.isfile(self.path(key))

    def get(self, key: str, offer: Offer | None = None) -> Kept | None:
        """Return what is kept, or None where there is nothing, or nothing that can be read.

        With `offer`, nothing that its method may not return counts as none.
        """
        try:
            # As it is written: nothing in it is packed, so that nothing is larger than the file.
            data = read_bytes(self.path(key), "file of the cache")
            # Copies lie in memory as what was extracted does.
            arrays = {name: array.copy("K") for name, array in read_npz(data, most=len(data)).items()}
            if not all(array.dtype.kind in _KINDS for array in arrays.values()):
                return None
            head = parse_json(arrays.pop("head").tobytes(), "file of the cache")
            kept = Kept(_unpacked(head["features"], arrays), float(head["seconds"]))
            if not 0 <= kept.seconds < float("inf"):
                return None
            if offer is not None:
                check_features(offer, kept.features)
        # Whatever a cut-off or foreign file is like, the features can be extracted again.
        except Exception:
            return None
        return kept

    def put(self, key: str, features: Any, seconds: float) -> bool:
        """Keep features whole or not at all; False where they are of a form that cannot be kept.

        Raises InputError where the folder cannot be written.
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
            # A name of its own for every writer: threads of one process may extract the same frame.
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
            raise InputError(
                "the cache of features cannot be written",
                where=problem.filename or path,
                got=problem.strerror or str(problem),
                hint="free some space, or name another folder in P2O_CACHE",
            ) from problem
        return True


def why_not_kept(value: Any) -> str:
    """Return why features are of a form that cannot be kept, or an empty text."""
    try:
        _packed(value, {})
    except TypeError as problem:
        return str(problem)
    except RecursionError:
        return "it nests without end"
    return ""


def _packed(value: Any, arrays: dict[str, Any]) -> Any:
    """Return a value as JSON, its arrays put aside; TypeError for what has no such form."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in _KINDS:
            raise TypeError(f"an array of {value.dtype} is not kept")
        name = f"array{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    inner, kind = parts(value), type(value)
    if inner is None:
        if value is None or kind in (str, bool, int, float):
            return {"value": value}
        raise TypeError(f"{kind.__name__} is not kept")
    if isinstance(value, Mapping) and not is_dataclass(value):
        if not all(isinstance(key, str) for key in value):
            raise TypeError("a key that is no text is not kept")
        kind = dict
    named: Any = kind.__name__
    if kind not in _CONTAINERS.values():
        named = [kind.__module__, kind.__qualname__]
        if _kind(named) is not kind:
            raise TypeError(f"{kind.__qualname__} would not be found again")
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
    """Return the container or the dataclass of this name; TypeError for any other.

    Whoever can write into the folder can name any type, so nothing is imported, and dataclasses are looked for in
    modules of p2o and of plugins alone.
    """
    if isinstance(named, str):
        return _CONTAINERS[named]
    module, name = named
    if module.partition(".")[0] not in _packages() and not module.startswith(_PLUGIN_FILE):
        raise TypeError(f"{module} is no module of p2o or of a plugin")
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        # Unlike `getattr`, this runs nothing: a module may import what it is asked for.
        found = vars(found).get(part)
    if not (isinstance(found, type) and is_dataclass(found) and found.__module__ == module):
        raise TypeError(f"{name} is no dataclass of {module}")
    return found


@cache
def _packages() -> frozenset[str]:
    """Return the packages that p2o and the installed plugins are in."""
    return frozenset({"p2o", *(entry.module.partition(".")[0] for entry in entry_points(group=GROUP))})
