"""Sources of packages as hashes see them after an edit; the files themselves and what was imported stay."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from p2o_study import revision

Edit = Callable[[str, str, str], None]
"""`edit("package/folder/module.py", old, new)`: the first `old` of the file is `new` for every later hash."""


@contextmanager
def edited_sources(monkeypatch: pytest.MonkeyPatch) -> Iterator[Edit]:
    """Yield the function that edits; afterwards hashes are those of the files again."""
    edits: dict[str, tuple[str, str]] = {}
    original = revision.read_source

    def read(path: Path) -> bytes:
        content = original(path)
        for file, (old, new) in edits.items():
            if path.as_posix().endswith(file):
                content = content.replace(old.encode(), new.encode(), 1)
        return content

    def replace(file: str, old: str, new: str) -> None:
        package, _, rest = file.partition("/")
        home = revision.path_of(package)
        assert home is not None
        assert old in (home.parent / rest).read_text(encoding="utf-8"), f"{file} has no {old!r}"
        edits[file] = old, new
        revision._code_of.cache_clear()

    with monkeypatch.context() as patch:
        patch.setattr(revision, "read_source", read)
        revision._code_of.cache_clear()
        yield replace
    revision._code_of.cache_clear()
