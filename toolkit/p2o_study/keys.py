"""Keys of extracted features: the content of the image or sweep, and the method with options, code and data files."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from p2o.cache import content_hash
from p2o.calibration.version import ALGORITHM
from p2o.errors import P2OError
from p2o.files.input_file import expanded
from p2o.host.registry import plugin_packages
from p2o.run.part import Part

from p2o_study.revision import Code, code_of, data_digest

_FORMAT = 5
_RECENT_S = 2.0


def features_key(part: Part, data_hash: str) -> str:
    """Return the cache key of the features of an image or sweep with this content hash."""
    key = {"format": _FORMAT, "algorithm": ALGORITHM, "data": data_hash, "kind": part.offer.kind.value}
    return content_hash({**key, "version": part.offer.version, "method": method_content(part)})


def method_content(part: Part) -> dict[str, Any]:
    """Return everything of a method that affects its results, except p2o: name, options, code and data files.

    For a method that resolves other methods by name, this includes all code and data files of all plugins.
    """
    method, options = part.offer.method, part.options.model_dump(mode="json")
    code = code_of(method, type(part.options))
    content: dict[str, Any] = {"name": part.offer.full_name, "options": options, "code": code.digest}
    content |= {"needs": sorted(method.needs), "gives": sorted(method.gives)}
    content |= {"files": named_files(options), "data files": _data_files(part, code)}
    if code.resolves_methods:
        content["other methods"] = [data_digest(package) for package in sorted(plugin_packages())]
    return content


def _data_files(part: Part, code: Code) -> list[str]:
    """Return the hashes of the declared data files of a method, else of all in the packages whose folder it locates."""
    if part.offer.method.data_files is None:
        return [data_digest(package) for package in sorted(code.locates_files)]
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
