"""What extractors found, kept by content: the bytes of image or sweep, the method, its options, its code.

Deleting the folder is always safe.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import json
import os
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import platformdirs

from p2o.errors import InputError
from p2o.work.sources import code_hash

if TYPE_CHECKING:
    from p2o.run.recipe import Part

_FORMAT = 2


def cache_folder() -> Path:
    """Return where p2o keeps what can be computed again: `P2O_CACHE`, else p2o in the user's cache folder."""
    named = os.environ.get("P2O_CACHE")
    return Path(named).expanduser() if named else platformdirs.user_cache_path("p2o", appauthor=False)


def content_hash(value: Any) -> str:
    """Return the hash of a value made of arrays, dataclasses, numbers, texts, mappings and sequences.

    Equal bytes of equal types give equal hashes, on every machine. Raises TypeError for anything else.
    """
    digest = hashlib.sha256()
    for part in _bytes_of(value):
        digest.update(part)
    return digest.hexdigest()


def _bytes_of(value: Any) -> Iterator[bytes]:
    if isinstance(value, np.ndarray):
        yield f"array {value.dtype.str} {value.shape};".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif is_dataclass(value) and not isinstance(value, type):
        yield f"{type(value).__name__}(".encode()
        for f in fields(value):
            yield f"{f.name}=".encode()
            yield from _bytes_of(getattr(value, f.name))
        yield b")"
    elif isinstance(value, Mapping):
        yield b"{"
        for key in sorted(value):
            yield from _bytes_of(key)
            yield from _bytes_of(value[key])
        yield b"}"
    elif isinstance(value, list | tuple):
        yield b"["
        for entry in value:
            yield from _bytes_of(entry)
        yield b"]"
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
        return self.path(key).is_file()

    def get(self, key: str) -> Kept | None:
        """Return what is kept, or None where there is nothing, or nothing that can be read."""
        try:
            with self.path(key).open("rb") as file, np.load(file, allow_pickle=False) as content:
                arrays = {name: content[name] for name in content.files}
            head = json.loads(arrays.pop("head").tobytes())
            return Kept(_unpacked(head["features"], arrays), float(head["seconds"]))
        # Whatever a cut-off or foreign file is like, the features can be extracted again.
        except (OSError, ValueError, KeyError, TypeError, AttributeError, ImportError, EOFError, zipfile.BadZipFile):
            return None
        except InputError:
            return None

    def put(self, key: str, features: Any, seconds: float) -> bool:
        """Keep features whole or not at all; False where they are of a form that cannot be kept.

        Raises InputError where the folder cannot be written.
        """
        arrays: dict[str, Any] = {}
        try:
            tree = _packed(features, arrays)
        except TypeError:
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


def _packed(value: Any, arrays: dict[str, Any]) -> Any:
    """Return a value as JSON, its arrays put aside; TypeError for what has no such form."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biuf":
            raise TypeError(f"an array of {value.dtype} is not kept")
        name = f"array{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    if is_dataclass(value) and not isinstance(value, type):
        inner = {f.name: _packed(getattr(value, f.name), arrays) for f in fields(value)}
        return {"type": [type(value).__module__, type(value).__qualname__], "fields": inner}
    if isinstance(value, Enum):
        raise TypeError("an enum is not kept")
    if isinstance(value, tuple | list):
        return {type(value).__name__: [_packed(entry, arrays) for entry in value]}
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        return {"dict": {key: _packed(entry, arrays) for key, entry in value.items()}}
    if value is None or type(value) in (str, bool, int, float):
        return {"value": value}
    raise TypeError(f"{type(value).__name__} is not kept")


def _unpacked(tree: Mapping[str, Any], arrays: Mapping[str, Any]) -> Any:
    if "array" in tree:
        return arrays[tree["array"]]
    if "type" in tree:
        module, name = tree["type"]
        kind: Any = importlib.import_module(module)
        for part in name.split("."):
            kind = getattr(kind, part)
        if not (isinstance(kind, type) and is_dataclass(kind)):
            raise TypeError(f"{name} is no dataclass")
        make: Any = kind
        return make(**{key: _unpacked(entry, arrays) for key, entry in tree["fields"].items()})
    if "tuple" in tree:
        return tuple(_unpacked(entry, arrays) for entry in tree["tuple"])
    if "list" in tree:
        return [_unpacked(entry, arrays) for entry in tree["list"]]
    if "dict" in tree:
        return {key: _unpacked(entry, arrays) for key, entry in tree["dict"].items()}
    return tree["value"]
