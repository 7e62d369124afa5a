"""Whether the cache of features keeps a value: what is taken out again is what was put in."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from p2o.testing.same import difference
from p2o.testing.subject import require
from p2o.work.cache import FeatureCache, why_not_kept


def require_kept(value: Any, what: str) -> None:
    """Raise CheckFailed, with the reason, unless the cache gives back the same value."""
    reason = why_not_kept(value)
    require(not reason, f"{what} cannot be kept: {reason}")
    with tempfile.TemporaryDirectory() as folder:
        cache, key = FeatureCache(Path(folder)), "0" * 64
        cache.put(key, value, 0.0)
        kept = cache.get(key)
    require(kept is not None, f"{what} cannot be read again: its dataclasses do not take their own fields")
    assert kept is not None
    found = difference(value, kept.features)
    require(not found, f"{what} comes back from the cache changed: {found}")
