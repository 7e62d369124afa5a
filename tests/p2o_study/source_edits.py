"""Sources of packages as hashes see them after an edit; the files themselves and what was imported stay."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from p2o_study import sources

Edit = Callable[[str, str, str], None]
"""`edit("package/folder/module.py", old, new)`: the first `old` of the file is `new` for every later hash."""


def forget() -> None:
    for cached in (sources._code_of, sources.package_hash, sources.module_named):
        cached.cache_clear()


@contextmanager
def edited_sources(monkeypatch: pytest.MonkeyPatch) -> Iterator[Edit]:
    """Yield the function that edits; afterwards hashes are those of the files again."""
    edits: dict[str, tuple[str, str]] = {}
    original = sources.read_source

    def read(path: Path) -> bytes:
        content = original(path)
        for file, (old, new) in edits.items():
            if path.as_posix().endswith(file):
                content = content.replace(old.encode(), new.encode(), 1)
        return content

    def replace(file: str, old: str, new: str) -> None:
        package, _, rest = file.partition("/")
        home = sources.path_of(package)
        assert home is not None
        assert old in (home.parent / rest).read_text(encoding="utf-8"), f"{file} has no {old!r}"
        edits[file] = old, new
        forget()

    with monkeypatch.context() as patch:
        patch.setattr(sources, "read_source", read)
        forget()
        yield replace
    forget()
