"""Data sets opened by name as users open them, and refusals in one line."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from p2o import InputError
from p2o.frames.frame import LazyFrames


def opened(name: str, root: Path, **options: Any) -> LazyFrames:
    """Return the data set of a name."""
    method = importlib.import_module(f"p2o_datasets.{name.replace('-', '_')}").METHOD
    found = method.build(method.options(root=root, **options))
    assert isinstance(found, LazyFrames)
    return found


@contextmanager
def refused(words: str, *names: str) -> Iterator[None]:
    """Expect an InputError of one line that matches a pattern and contains names."""
    with pytest.raises(InputError, match=words) as caught:
        yield
    assert "\n" not in str(caught.value)
    assert all(name in str(caught.value) for name in names)
